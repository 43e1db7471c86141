//! `stictiond probe`: registers of a device as they could be meant, for commissioning.

use super::{Failure, print};
use clap::ValueEnum;
use std::time::Duration;
use stictiond::collect::modbus::{self, ProbeError, ProbeTarget};

#[derive(clap::Args)]
pub struct Args {
    /// The device, host:port
    address: String,
    /// Which table
    #[arg(long, value_enum, default_value_t = Register::Holding)]
    register: Register,
    /// First address, counted from the address base
    #[arg(long)]
    start: u16,
    /// Number of addresses
    #[arg(long, default_value_t = 1)]
    count: u16,
    /// Unit identifier
    #[arg(long, default_value_t = 1)]
    unit_id: u8,
    /// 0 when the device's documentation counts from 0, 1 when from 1
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=1))]
    address_base: u8,
    /// Longest wait for the connection and for the answer (ms)
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u64).range(1..=60_000))]
    timeout_ms: u64,
}

#[derive(Clone, Copy, ValueEnum)]
enum Register {
    Holding,
    Input,
    Coil,
    Discrete,
}

/// Reads once and prints the table.
pub fn run(args: &Args) -> Result<(), Failure> {
    let target = ProbeTarget {
        address: args.address.clone(),
        unit_id: args.unit_id,
        address_base: args.address_base,
        register: match args.register {
            Register::Holding => modbus::Register::Holding,
            Register::Input => modbus::Register::Input,
            Register::Coil => modbus::Register::Coil,
            Register::Discrete => modbus::Register::Discrete,
        },
        start: args.start,
        count: args.count,
        timeout: Duration::from_millis(args.timeout_ms),
    };
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|error| Failure::Failed(format!("cannot start: {error}")))?;
    let table = runtime.block_on(modbus::probe(&target)).map_err(|error| match error {
        ProbeError::Arguments(_) => Failure::BadInput(error.to_string()),
        _ => Failure::Failed(error.to_string()),
    })?;
    print(&table.to_string())
}
