//! A day of a simulated plant as a folder of records, one loop a file, for pictures and for trying `stictiond plant`:
//! `cargo run --release -p stictiond-numerics --example plant_records -- --valve PIC205 --load FIC302 FOLDER`.

use clap::Parser;
use std::fmt::Write as _;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use stictiond_numerics::sim::Run;
use stictiond_numerics::sim::units::{Source, plant};

/// A day of a simulated plant as a folder of records, one loop a file
#[derive(Parser)]
struct Args {
    /// Folder of the records, made when it is not there
    folder: PathBuf,
    /// Loop whose valve sticks: PIC205 is loop 05 of unit 2
    #[arg(long, value_name = "LOOP")]
    valve: Option<String>,
    /// Loop into whose process a load swings
    #[arg(long, value_name = "LOOP")]
    load: Option<String>,
    /// Units of twelve loops
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u8).range(1..=9))]
    units: u8,
    /// Seed of the plant
    #[arg(long, default_value_t = 13)]
    seed: u64,
    /// Length of the records (h)
    #[arg(long, default_value_t = 24.0)]
    hours: f64,
}

fn main() -> Result<(), String> {
    let args = Args::parse();
    let units = usize::from(args.units);
    let names: Vec<String> = plant(args.seed, units, &[]).loops.into_iter().map(|own| own.name).collect();
    let mut sources = Vec::new();
    for (source, name) in [(Source::Load, &args.load), (Source::Valve, &args.valve)] {
        if let Some(name) = name {
            let at = names.iter().position(|own| own == name);
            let at = at.ok_or_else(|| format!("no loop {name}; the plant has {}", names.join(", ")))?;
            sources.push((source, Some(at)));
        }
    }
    let of = plant(args.seed, units, &sources);
    let runs = of.run(args.hours, &vec![true; sources.len()]);
    let failed = |path: &Path, error: io::Error| format!("{}: {error}", path.display());
    fs::create_dir_all(&args.folder).map_err(|error| failed(&args.folder, error))?;
    for (own, run) in of.loops.iter().zip(&runs) {
        let path = args.folder.join(&own.name).with_extension("csv");
        fs::write(&path, table(run)).map_err(|error| failed(&path, error))?;
    }
    println!("{} records in {}", runs.len(), args.folder.display());
    Ok(())
}

/// Time (s), OP, PV and set point of a loop as CSV.
fn table(run: &Run) -> String {
    let mut text = "t,op,pv,sp\n".to_string();
    for (((t, op), pv), sp) in run.t.iter().zip(&run.op).zip(&run.pv).zip(&run.sp) {
        // Writing into a String cannot fail.
        let _ = writeln!(text, "{t},{op:.4},{pv:.4},{sp:.4}");
    }
    text
}
