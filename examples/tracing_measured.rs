//! Tracing on measured records, as Markdown tables: `cargo run --release --example tracing_measured -- ../shared/data`; with
//! `--next` by the engine that is to come, whose effects have posteriors and whose free run is its own.
//!
//! The folder holds `index.csv` with `isdb/` and `plant/`, `long/*.csv`, and `damadics/*.csv` with a measured stem.

#[path = "../tests/diagnosis_common/parallel.rs"]
mod parallel;

use std::error::Error;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use stictiond::collect::csv;
use stictiond::diagnosis::{Settings, diagnose};
use stictiond::signal::Record;
use stictiond_numerics::{residual, residual_next};

fn main() -> Result<(), Box<dyn Error>> {
    let mut args: Vec<String> = std::env::args().skip(1).collect();
    let next = args.iter().any(|arg| arg == "--next");
    args.retain(|arg| arg != "--next");
    let trace: Trace = if next { of_next } else { of_residual };
    let folder = args.first().map_or_else(|| PathBuf::from("../shared/data"), PathBuf::from);
    let mut records = listed(&folder)?;
    for file in files(&folder.join("long"))? {
        records.push((file_stem(&file), "-".into(), csv::read(File::open(&file)?)?));
    }
    table("record", &records, trace);
    for file in files(&folder.join("damadics"))? {
        damadics(&csv::read(File::open(&file)?)?, trace);
    }
    Ok(())
}

/// An engine: a diagnosis of the record and what its residual was traced to.
type Trace = fn(&Record) -> Answer;

type Named = (String, String, Record);

/// The rows of the index that are loops: name, label, record.
fn listed(folder: &Path) -> Result<Vec<Named>, Box<dyn Error>> {
    let mut out = Vec::new();
    for line in fs::read_to_string(folder.join("index.csv"))?.lines() {
        let row: Vec<&str> = line.split(',').collect();
        if let [set, name, file, _, _, _, label, ..] = row[..]
            && matches!(set, "isdb" | "plant")
        {
            out.push((name.to_owned(), label.to_owned(), csv::read(File::open(folder.join(file))?)?));
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

/// What is said of a record.
struct Answer {
    verdict: &'static str,
    reason: String,
    traced: Option<Traced>,
}

struct Traced {
    verdict: &'static str,
    /// f without the effects and with them, and the latter's interval.
    f: [f64; 2],
    ci: [f64; 2],
    /// Errors on the samples held out, before and after, one step ahead and free.
    one: [f64; 2],
    free: [f64; 2],
    effects: Vec<String>,
    unexplained: bool,
    /// f from OP and the measured stem, its interval and the lag.
    stem: Option<[f64; 4]>,
}

/// The answer of `$engine`, whose effects `$name` writes.
macro_rules! answer {
    ($engine:ident, $record:expr, $name:expr) => {{
        let settings = Settings::default();
        let d = diagnose($record, &settings);
        let found = $engine::trace_record($record, &d, &settings, &$engine::Settings::default());
        let traced = found.map(|t| Traced {
            verdict: t.verdict.as_str(),
            f: [t.friction_before.f, t.friction_after.f],
            ci: t.friction_after.f_ci95,
            one: [t.before.one_step_rmse, t.after.one_step_rmse],
            free: [t.before.free_run_rmse, t.after.free_run_rmse],
            effects: t.effects.iter().map($name).collect(),
            unexplained: t.unexplained,
            stem: t.stem.map(|s| s.friction).map(|f| [f.f, f.f_ci95[0], f.f_ci95[1], f.lag]),
        });
        Answer { verdict: d.verdict.as_str(), reason: d.reason, traced }
    }};
}

fn of_residual(record: &Record) -> Answer {
    answer!(residual, record, |e: &residual::Effect| with_tag(e.kind, e.tag.as_deref()))
}

fn of_next(record: &Record) -> Answer {
    let name =
        |e: &residual_next::Effect| format!("{} {:.2}", with_tag(e.kind, e.tag.as_deref()), e.posterior);
    answer!(residual_next, record, name)
}

fn with_tag(kind: residual::Kind, tag: Option<&str>) -> String {
    tag.map_or_else(|| kind.to_string(), |tag| format!("{kind} ({tag})"))
}

fn table(what: &str, records: &[Named], trace: Trace) {
    println!(
        "| {what} | label | verdict | with the effects | f, with the effects | one step | after | free run | after | effects; residual |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    let found = parallel::each(records, |(_, _, record)| trace(record));
    let (mut better, mut worse) = (0, 0);
    for ((name, label, _), answer) in records.iter().zip(&found) {
        let verdict = answer.verdict;
        let Some(t) = &answer.traced else {
            println!("| {name} | {label} | {verdict} | not traced | | | | | | {} |", answer.reason);
            continue;
        };
        let ratio = t.free[1] / t.free[0];
        better += usize::from(ratio < 0.999);
        worse += usize::from(ratio > 1.0001);
        let effects = if t.effects.is_empty() { "-".to_owned() } else { t.effects.join(", ") };
        println!(
            "| {name} | {label} | {verdict} | {} | {:.3}, {:.3} | {:.4} | {:.4} | {:.4} | {:.4} | {effects}; {} |",
            t.verdict,
            t.f[0],
            t.f[1],
            t.one[0],
            t.one[1],
            t.free[0],
            t.free[1],
            if t.unexplained { "unexplained" } else { "white" }
        );
    }
    println!("\nFree run better on {better} of {}, worse on {worse}.\n", records.len());
}

/// The actuator whose stem is measured: OP to the stem and to the flow, the other signals as tags, and f both ways.
fn damadics(all: &Record, trace: Trace) {
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
        print_stem("F_tph", &record, trace);
    }
    print_stem("pv (level)", all, trace);
    table("DAMADICS", &records, trace);
}

/// f from OP and PV beside f from OP and the measured stem.
fn print_stem(what: &str, record: &Record, trace: Trace) {
    let answer = trace(record);
    let Some((t, [f, low, high, lag])) = answer.traced.and_then(|t| t.stem.map(|stem| (t, stem))) else {
        println!("OP and {what}: not traced ({})\n", answer.reason);
        return;
    };
    println!(
        "f from OP and {what}: {:.3}, with the effects {:.3} [{:.3}, {:.3}]; from OP and the stem {f:.3} [{low:.3}, {high:.3}], lag {lag:.3}\n",
        t.f[0], t.f[1], t.ci[0], t.ci[1]
    );
}
