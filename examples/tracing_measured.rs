//! Tracing on measured records, as Markdown tables: `cargo run --release --example tracing_measured -- ../shared/data`.
//!
//! The folder holds `index.csv` with `isdb/` and `plant/`, `long/*.csv`, and `damadics/*.csv` with a measured stem.

#[path = "../numerics/tests/common/parallel.rs"]
mod parallel;

use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};
use stictiond::diagnosis::{Diagnosis, Settings, diagnose};
use stictiond::residual::{self, Findings, trace_record};
use stictiond::signal::Record;
use stictiond::table;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).map_or_else(|| PathBuf::from("../shared/data"), PathBuf::from);
    let mut records = listed(&folder)?;
    for file in files(&folder.join("long"))? {
        records.push((file_stem(&file), "-".into(), table::record(&file)?));
    }
    table("record", &records);
    for file in files(&folder.join("damadics"))? {
        damadics(&table::record(&file)?);
    }
    Ok(())
}

type Named = (String, String, Record);

/// The rows of the index that are loops: name, label, record.
fn listed(folder: &Path) -> Result<Vec<Named>, Box<dyn Error>> {
    let mut out = Vec::new();
    for line in fs::read_to_string(folder.join("index.csv"))?.lines() {
        let row: Vec<&str> = line.split(',').collect();
        if let [set, name, file, _, _, _, label, ..] = row[..]
            && matches!(set, "isdb" | "plant")
        {
            out.push((name.to_owned(), label.to_owned(), table::record(&folder.join(file))?));
        }
    }
    Ok(out)
}

fn files(folder: &Path) -> Result<Vec<PathBuf>, Box<dyn Error>> {
    let mut out: Vec<PathBuf> =
        fs::read_dir(folder)?.map(|f| f.map(|f| f.path())).collect::<Result<_, _>>()?;
    out.retain(|f| f.extension().is_some_and(|e| e == "csv"));
    out.sort();
    Ok(out)
}

fn file_stem(file: &Path) -> String {
    file.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned())
}

fn trace(record: &Record) -> (Diagnosis, Option<Findings>) {
    let settings = Settings::default();
    let d = diagnose(record, &settings);
    let found = trace_record(record, &d, &settings, &residual::Settings::default());
    (d, found)
}

fn effects(found: &Findings) -> String {
    let name = |e: &residual::Effect| match &e.tag {
        Some(tag) => format!("{} ({tag}) {}", e.kind, sure(e.posterior)),
        None => format!("{} {}", e.kind, sure(e.posterior)),
    };
    let all: Vec<String> = found.effects.iter().map(name).collect();
    let rest = if found.unexplained { "unexplained" } else { "white" };
    if all.is_empty() { format!("-; {rest}") } else { format!("{}; {rest}", all.join(", ")) }
}

fn table(what: &str, records: &[Named]) {
    println!(
        "| {what} | label | verdict | with the effects | f, with the effects | one step | after | free run | after | effects; residual |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    let found = parallel::each(records, |(_, _, record)| trace(record));
    let (mut better, mut worse) = (0, 0);
    for ((name, label, _), (d, found)) in records.iter().zip(&found) {
        let verdict = d.verdict.as_str();
        let Some(t) = found else {
            println!("| {name} | {label} | {verdict} | not traced | | | | | | {} |", d.reason);
            continue;
        };
        let ratio = t.after.free_run_rmse / t.before.free_run_rmse;
        better += usize::from(ratio < 0.999);
        worse += usize::from(ratio > 1.0001);
        println!(
            "| {name} | {label} | {verdict} | {} | {:.3}, {:.3} | {:.4} | {:.4} | {:.4} | {:.4} | {} |",
            t.verdict.as_str(),
            t.friction_before.f,
            t.friction_after.f,
            t.before.one_step_rmse,
            t.after.one_step_rmse,
            t.before.free_run_rmse,
            t.after.free_run_rmse,
            effects(t)
        );
    }
    println!("\nFree run better on {better} of {}, worse on {worse}.\n", records.len());
}

/// The actuator whose stem is measured: OP to the stem and to the flow, the other signals as tags, and f both ways.
fn damadics(all: &Record) {
    let Some(stem) = all.mv.clone() else { return };
    let flow = all.tags.iter().find(|(name, _)| name.starts_with("F_tph"));
    let others = |without: &str| {
        let mut tags = all.tags.clone();
        tags.retain(|(name, _)| !name.starts_with(without) && !name.starts_with("F_steam"));
        tags
    };
    // The controller's own PV and SP are another variable's: the stem and the flow have none.
    let of =
        |pv: Vec<_>, tags| Record { op: all.op.clone(), pv, tags, op_span: all.op_span, ..Record::default() };
    let mut records = vec![("OP to mv_stem".to_owned(), "-".to_owned(), of(stem.clone(), others("F_tph")))];
    if let Some((_, flow)) = flow {
        let mut record = of(flow.clone(), others("F_tph"));
        records.push(("OP to F_tph".to_owned(), "-".to_owned(), record.clone()));
        record.mv = Some(stem);
        print_stem("F_tph", &record);
    }
    print_stem("pv (level)", all);
    table("DAMADICS", &records);
}

/// f from OP and PV beside f from OP and the measured stem.
fn print_stem(what: &str, record: &Record) {
    let (d, found) = trace(record);
    let Some((t, stem)) = found.as_ref().and_then(|t| t.stem.as_ref().map(|stem| (t, stem))) else {
        println!("OP and {what}: not traced ({})\n", d.reason);
        return;
    };
    println!(
        "f from OP and {what}: {:.3}, with the effects {:.3} [{:.3}, {:.3}]; from OP and the stem {:.3} [{:.3}, {:.3}], lag {:.3}\n",
        t.friction_before.f,
        t.friction_after.f,
        t.friction_after.f_ci95[0],
        t.friction_after.f_ci95[1],
        stem.friction.f,
        stem.friction.f_ci95[0],
        stem.friction.f_ci95[1],
        stem.friction.lag
    );
}

/// A posterior; where samples that were not fitted speak against the effects there is none.
fn sure(posterior: f64) -> String {
    if posterior.is_nan() { "doubted".into() } else { format!("{posterior:.2}") }
}
