//! Simulated records with an effect that is not declared, as CSV: `cargo run --example tracing_records -- FOLDER`.
//!
//! They are the worked examples of docs/closing-the-loop.md; `scripts/worked-examples` diagnoses and draws them.

#[path = "../tests/residual_common/plant.rs"]
#[allow(dead_code, reason = "the rates use what the records do not")]
mod plant;
#[path = "../tests/residual_common/valve.rs"]
mod valve;

use plant::{Case, LOOPS, Undeclared, VALVES, record};
use std::error::Error;
use std::fs;
use std::path::PathBuf;
use stictiond::residual::Kind;
use stictiond::signal::{Record, Sample};

/// Effect, loop, valve and seed.
const WORKED: [(Kind, &str, &str, u64); 3] = [
    (Kind::LoadStep, "temperature", "weak", 3004),
    (Kind::GainChange, "flow", "strong", 3000),
    (Kind::ValveSaturation, "flow", "strong", 3000),
];

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).map_or_else(|| PathBuf::from("target/worked"), PathBuf::from);
    fs::create_dir_all(&folder)?;
    for (kind, class, valve, seed) in WORKED {
        let at = |names: &[&str], name: &str| names.iter().position(|n| *n == name).unwrap_or(0);
        let valves = VALVES.map(|(name, ..)| name);
        let case = Case {
            class: at(&LOOPS, class),
            valve: at(&valves, valve),
            undeclared: Undeclared::Listed(kind),
            size: 1,
            seed,
            tags: 0,
        };
        let (drawn, f) = record(&case);
        let to = folder.join(format!("{}.csv", kind.as_str()));
        fs::write(&to, csv(&drawn))?;
        println!("{}: {class}, {valve} friction, f {f:.3} % OP", to.display());
    }
    Ok(())
}

fn csv(record: &Record) -> String {
    let mut out = String::from("t,op,pv,sp\n");
    let none: &[Sample] = &[];
    let sp = record.sp.as_deref().unwrap_or(none);
    for ((op, pv), sp) in record.op.iter().zip(&record.pv).zip(sp) {
        out += &format!("{},{:.4},{:.4},{:.4}\n", op.t, op.value, pv.value, sp.value);
    }
    out
}
