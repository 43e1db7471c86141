//! What a Modbus device answers, and the values that its registers become. The first two bytes say what was asked; the rest
//! is what the device sends.

use std::io::Cursor;
use std::sync::OnceLock;
use std::time::Duration;
use stictiond::collect::modbus::{
    Config, Framing, Plan, ProbeTarget, Register, TagSpec, Tolerated, probe_over,
};
use tokio::io::{join, sink};

const TABLES: [Register; 4] = [Register::Holding, Register::Input, Register::Coil, Register::Discrete];
const TYPES: [&str; 8] = ["u16", "i16", "u32", "i32", "u64", "i64", "f32", "f64"];
const ORDERS: [&str; 4] = ["ABCD", "CDAB", "BADC", "DCBA"];

/// One tag of every type and order.
fn plans() -> &'static [Plan] {
    static PLANS: OnceLock<Vec<Plan>> = OnceLock::new();
    PLANS.get_or_init(|| {
        let made = ORDERS.iter().map(|order| {
            let text = format!("name = 'd'\naddress = 'h:502'\naddress_base = 0\nbyte_order = '{order}'");
            let config: Config = toml::from_str(&text).expect("a device");
            let specs = TYPES.iter().enumerate().map(|(index, kind)| {
                let text = format!(
                    "device = 'd'\nregister = 'holding'\naddress = {}\ntype = '{kind}'\nscale = 0.1\nrange = [-10.0, 110.0]",
                    4 * index
                );
                let config = toml::from_str(&text).expect("a tag");
                TagSpec { index, name: (*kind).to_string(), role: None, config, frozen_after_s: None }
            });
            Plan::new(0, &config, specs.collect()).expect("a plan")
        });
        made.collect()
    })
}

/// Takes an answer.
pub fn run(bytes: &[u8]) {
    let Some(([asked, count], answer)) = bytes.split_first_chunk::<2>() else { return };
    let register = TABLES[usize::from(asked & 3)];
    let framing = if asked & 4 == 0 { Framing::Tcp } else { Framing::Rtu };
    let tolerate: &[Tolerated] =
        if asked & 8 == 0 { &[] } else { &[Tolerated::TransactionId, Tolerated::UnitId] };
    let target = ProbeTarget {
        address: "h:502".into(),
        unit_id: 1,
        address_base: 0,
        register,
        start: 0,
        count: u16::from(count % 125) + 1,
        timeout: Duration::from_secs(5),
    };
    let stream = join(Cursor::new(answer.to_vec()), sink());
    let Ok(table) = super::wait(probe_over(stream, framing, tolerate, &target)) else { return };
    assert_eq!(table.words.len(), usize::from(target.count), "not what was asked for");
    let _ = table.to_string();
    for tag in plans().iter().flat_map(|plan| &plan.tags) {
        if let Some(reading) = tag.decoder.decode(&table.words) {
            assert!(!reading.quality.is_good() || (-10.0..=110.0).contains(&reading.value), "{reading:?}");
        }
    }
}
