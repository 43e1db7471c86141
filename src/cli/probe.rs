//! `stictiond probe`: what is there, for commissioning: registers as they could be meant, variables of a server, topics of a
//! broker.

use super::{Failure, print};
use clap::ValueEnum;
use std::path::{Path, PathBuf};
use std::time::Duration;
use stictiond::collect::modbus::{self, ProbeError, ProbeTarget};
use stictiond::collect::{Issue, mqtt, opcua};
use stictiond::config;

/// What is asked without a configuration.
const SERVER: &str = "server";
const BROKER: &str = "broker";

#[derive(clap::Args)]
pub struct Args {
    /// host:port of a Modbus device, opc.tcp://host:port/path, mqtt://host:port, or with --config the name of a section
    address: String,
    /// Where the section stands that says how the server or broker is reached
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// OPC UA: only variables whose path or node id holds this, with * for anything. MQTT: the topics to listen to (#)
    #[arg(long, value_name = "TEXT")]
    filter: Option<String>,
    /// Most variables or topics shown
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u16).range(1..))]
    most: u16,
    /// MQTT: how long to listen (s)
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=3600))]
    seconds: u64,
    /// Which table
    #[arg(long, value_enum, default_value_t = Register::Holding)]
    register: Register,
    /// First address, counted from the address base
    #[arg(long)]
    start: Option<u16>,
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

/// Who is asked.
enum Target {
    Modbus,
    Opcua(Box<opcua::Config>),
    Mqtt(Box<mqtt::Config>),
}

/// Asks once and prints what is there.
pub fn run(args: &Args) -> Result<(), Failure> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|error| Failure::Failed(format!("cannot start: {error}")))?;
    let most = usize::from(args.most);
    match target(args)? {
        Target::Modbus => registers(args, &runtime),
        Target::Opcua(server) => {
            let filter = args.filter.as_deref().unwrap_or("");
            let found = runtime.block_on(opcua::probe(&server, filter, most)).map_err(Failure::Failed)?;
            print(&found.to_string())
        }
        Target::Mqtt(broker) => {
            let filter = args.filter.as_deref().unwrap_or("#");
            let listen = Duration::from_secs(args.seconds);
            let found =
                runtime.block_on(mqtt::probe(&broker, filter, listen, most)).map_err(Failure::Failed)?;
            print(&found.to_string())
        }
    }
}

fn target(args: &Args) -> Result<Target, Failure> {
    if let Some(path) = &args.config {
        return named(path, &args.address);
    }
    let address = quoted(&args.address);
    if args.address.starts_with("opc.tcp://") {
        let text = format!("name = '{SERVER}'\nurl = {address}\nsecurity_policy = 'None'\n");
        return server(&text).map(Target::Opcua);
    }
    for (scheme, tls) in [("mqtt://", false), ("mqtts://", true)] {
        if let Some(host) = args.address.strip_prefix(scheme) {
            let host = quoted(host.trim_end_matches('/'));
            let text = format!("name = '{BROKER}'\naddress = {host}\ntls = {tls}\n");
            return broker(&text).map(Target::Mqtt);
        }
    }
    Ok(Target::Modbus)
}

fn quoted(text: &str) -> String {
    stictiond::collect::stub::quoted(text)
}

/// The section of that name. The rest of the file may still be empty: at commissioning there is no loop yet.
fn named(path: &Path, name: &str) -> Result<Target, Failure> {
    let file = config::tables(path).map_err(Failure::BadConfig)?;
    for kind in ["opcua", "mqtt"] {
        let mut sections = file.get(kind).and_then(toml::Value::as_array).into_iter().flatten();
        let is_named = |own: &&toml::Value| own.get("name").and_then(toml::Value::as_str) == Some(name);
        let Some(section) = sections.find(is_named) else { continue };
        let text = toml::to_string(section).map_err(|error| Failure::in_file(path, error))?;
        let target = match kind {
            "opcua" => server(&text).map(Target::Opcua),
            _ => broker(&text).map(Target::Mqtt),
        };
        return target.map_err(|failed| match failed {
            Failure::BadInput(why) => Failure::in_file(path, format!("[[{kind}]] {name:?}: {why}")),
            other => other,
        });
    }
    Err(Failure::in_file(
        path,
        format!("no [[opcua]] or [[mqtt]] is called {name:?}; a Modbus device is named by host:port"),
    ))
}

fn server(text: &str) -> Result<Box<opcua::Config>, Failure> {
    let config: opcua::Config = toml::from_str(text).map_err(|error| unreadable(&error))?;
    first_of(&config.validate()).map(|()| Box::new(config))
}

fn broker(text: &str) -> Result<Box<mqtt::Config>, Failure> {
    let config: mqtt::Config = toml::from_str(text).map_err(|error| unreadable(&error))?;
    first_of(&config.validate()).map(|()| Box::new(config))
}

fn unreadable(error: &toml::de::Error) -> Failure {
    Failure::BadInput(error.message().to_string())
}

fn first_of(issues: &[Issue]) -> Result<(), Failure> {
    let wrong = |issue: &Issue| Err(Failure::BadInput(format!("{}: {}", issue.field, issue.message)));
    issues.first().map_or(Ok(()), wrong)
}

fn registers(args: &Args, runtime: &tokio::runtime::Runtime) -> Result<(), Failure> {
    let start = args.start.ok_or_else(|| Failure::BadInput("of a Modbus device --start is needed".into()))?;
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
        start,
        count: args.count,
        timeout: Duration::from_millis(args.timeout_ms),
    };
    let table = runtime.block_on(modbus::probe(&target)).map_err(|error| match error {
        ProbeError::Arguments(_) => Failure::BadInput(error.to_string()),
        _ => Failure::Failed(error.to_string()),
    })?;
    print(&table.to_string())
}
