//! Why loops are not at rest: draws loops of known cause in plants, and fits or measures what is said of them.
//!
//! `cargo run --release -p stictiond-numerics --example causes -- rows --first 20000 --plants 1200 > rows.txt`.
//! Rows are made of plants of two units for 24 hours with one thing wrong, each loop of interest diagnosed as the daemon would.

#[path = "plantwide_rates/friction.rs"]
mod friction;
#[path = "calibrate/logistic.rs"]
mod logistic;

use clap::Parser;
use friction::friction;
use std::path::{Path, PathBuf};
use stictiond_numerics::detectors::tally;
use stictiond_numerics::plantwide::cause::{CLASSES, probabilities};
use stictiond_numerics::plantwide::signs::{SIGNS, Signs};
use stictiond_numerics::plantwide::{Cause, PlantLoop, analyse};
use stictiond_numerics::signal::Window;
use stictiond_numerics::sim::Run;
use stictiond_numerics::sim::units::{Plant, Source, plant};

/// Share of PV's variance by which a loop is a source's victim, and below which it is not.
const VICTIM: [f64; 2] = [0.3, 0.03];
const HOURS: f64 = 24.0;
/// Ridge of the fit: the best of 1e-4 to 3e-2 by five-fold cross-validation of the log likelihood on the rows of the fit.
const RIDGE: f64 = 1e-3;
const SOURCES: [(Source, Cause); 9] = [
    (Source::Valve, Cause::Valve),
    (Source::Tight, Cause::Tuning),
    (Source::Sluggish, Cause::Tuning),
    (Source::Load, Cause::Load),
    (Source::RandomLoad, Cause::Load),
    (Source::Quantised, Cause::Sensor),
    (Source::Noisy, Cause::Sensor),
    (Source::Frozen, Cause::Sensor),
    (Source::Saturated, Cause::Saturation),
];

/// Why loops are not at rest
#[derive(Parser)]
enum Asked {
    /// Draw loops, and print a line for each: its true class, what is said and how sure, the source, its signs
    Rows {
        /// Seed of the first plant
        #[arg(long, default_value_t = 20_000)]
        first: u64,
        /// Plants to draw
        #[arg(long, default_value_t = 1200)]
        plants: u64,
    },
    /// Print the weights that fit such lines best
    Fit {
        /// File with what `rows` has printed
        file: PathBuf,
    },
    /// Print the confusion matrix and the reliability diagram of such lines
    Measure {
        /// File with what `rows` has printed
        file: PathBuf,
    },
}

fn main() {
    match Asked::parse() {
        Asked::Rows { first, plants } => rows(first, plants),
        Asked::Fit { file } => fit(&read(&file)),
        Asked::Measure { file } => measure(&read(&file)),
    }
}

fn loops(of: &Plant, runs: &[Run]) -> Vec<PlantLoop> {
    let one = |(of, run): (&stictiond_numerics::sim::units::UnitLoop, &Run)| PlantLoop {
        name: of.name.clone(),
        window: Window {
            ts: run.ts,
            op: run.op.clone(),
            pv: run.pv.clone(),
            sp: Some(run.sp.clone()),
            ..Window::default()
        },
        op_limits: Some((0.0, 100.0)),
        ..PlantLoop::default()
    };
    of.loops.iter().zip(runs).map(one).collect()
}

/// The source of each plant, one loop that has nothing to do with it, and one that swings with it where there is one.
fn rows(first: u64, plants: u64) {
    for seed in first..first + plants {
        let (source, cause) = SOURCES[(seed % SOURCES.len() as u64) as usize];
        let of = plant(seed, 2, &[(source, None)]);
        let at = of.sources[0].1;
        let (runs, shares) = of.truth(HOURS);
        let clear = |i: &usize| *i != at && of.loops.iter().all(|other| other.master != Some(*i));
        let at_rest = (0..runs.len()).filter(clear).filter(|i| shares[*i][0] < VICTIM[1]);
        let victim = (0..runs.len()).filter(clear).find(|i| shares[*i][0] >= VICTIM[0]);
        let at_rest = at_rest.clone().nth((seed / 9) as usize % at_rest.count().max(1));
        let wanted = [
            Some((at, Some(cause))),
            at_rest.map(|i| (i, None)),
            victim.map(|i| (i, Some(Cause::Neighbour))),
        ];
        let mut plant = loops(&of, &runs);
        for (i, _) in wanted.iter().flatten() {
            plant[*i].friction = friction(&runs[*i]);
        }
        let found = analyse(&plant);
        for (i, cause) in wanted.into_iter().flatten() {
            let own = &found.loops[i];
            let said = own.reason.as_ref().map_or("rest", |reason| reason.cause.as_str());
            let p = own.reason.as_ref().and_then(|reason| reason.probability).unwrap_or(0.0);
            let signs: Vec<String> = own.signs.iter().map(|x| format!("{x:.5}")).collect();
            println!("{} {said} {p:.4} {source:?} {}", cause.map_or("rest", Cause::as_str), signs.join(" "));
        }
    }
}

struct Row {
    /// What is true; `None` for a loop at rest.
    cause: Option<Cause>,
    said: Option<Cause>,
    probability: f64,
    signs: Signs,
}

fn read(file: &Path) -> Vec<Row> {
    let text = std::fs::read_to_string(file).unwrap_or_default();
    let named = |name: &str| Cause::ALL.into_iter().find(|cause| cause.as_str() == name);
    let row = |line: &str| {
        let cells: Vec<&str> = line.split_whitespace().collect();
        let mut signs = [0.0; SIGNS];
        signs.iter_mut().zip(&cells[4..]).for_each(|(x, cell)| *x = cell.parse().unwrap_or(f64::NAN));
        Row {
            cause: named(cells[0]),
            said: named(cells[1]),
            probability: cells[2].parse().unwrap_or(0.0),
            signs,
        }
    };
    text.lines().map(row).collect()
}

fn fit(rows: &[Row]) {
    let class = |row: &Row| CLASSES.iter().position(|own| *own == row.cause);
    let (mut x, mut y) = (Vec::new(), Vec::new());
    for row in rows {
        if let Some(class) = class(row) {
            x.push(row.signs.to_vec());
            y.push(class);
        }
    }
    let w = logistic::fit(&x, &y, CLASSES.len(), RIDGE, false);
    for (w, class) in w.iter().zip(CLASSES) {
        let cells: Vec<String> = w.iter().map(|w| format!("{w:.3}")).collect();
        println!("    [{}], // {}", cells.join(", "), class.map_or("at rest", Cause::as_str));
    }
    println!("// from {} loops", x.len());
}

fn measure(rows: &[Row]) {
    let name = |cause: Option<Cause>| cause.map_or("at rest", Cause::as_str);
    let all: Vec<Option<Cause>> = Cause::ALL.into_iter().map(Some).chain([None]).collect();
    print!("| is |");
    all.iter().for_each(|said| print!(" {} |", name(*said)));
    println!("\n|---|{}", "---|".repeat(all.len()));
    for is in all.iter().filter(|is| **is != Some(Cause::Unknown)) {
        print!("| {} |", name(*is));
        for said in &all {
            print!(" {} |", rows.iter().filter(|row| row.cause == *is && row.said == *said).count());
        }
        println!();
    }
    let named = |row: &&Row| row.said.is_some_and(|cause| cause != Cause::Unknown);
    let told = |said: Option<Cause>| -> Vec<&Row> { rows.iter().filter(|row| row.said == said).collect() };
    let share = |some: &[&Row]| {
        let right = some.iter().filter(|row| row.said == row.cause).count();
        match tally::wilson(right, some.len()) {
            Some([low, high]) => {
                format!("{right} of {} ({:.0} to {:.0} %)", some.len(), 100.0 * low, 100.0 * high)
            }
            None => "none".into(),
        }
    };
    // Over all loops first: a share of those that got a name says nothing of those that got none.
    println!("\n| of all that are | told right |\n|---|---|");
    for is in all.iter().filter(|is| **is != Some(Cause::Unknown)) {
        let own: Vec<&Row> = rows.iter().filter(|row| row.cause == *is).collect();
        println!("| {} | {} |", name(*is), share(&own));
    }
    let moving: Vec<&Row> = rows.iter().filter(|row| row.cause.is_some()).collect();
    println!("| all that are not at rest | {} |", share(&moving));
    println!("| all | {} |", share(&rows.iter().collect::<Vec<_>>()));
    let sure: Vec<&Row> = rows.iter().filter(named).filter(|row| row.probability >= 0.8).collect();
    println!("\nnamed with probability 0.8 or more: {} right", share(&sure));
    println!("unknown: {} of {}", told(Some(Cause::Unknown)).len(), rows.len());
    println!("\n| probability | right |\n|---|---|");
    for low in [0.0, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95] {
        let high = [0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.01].into_iter().find(|high| *high > low).unwrap_or(1.01);
        let bin: Vec<&Row> =
            rows.iter().filter(named).filter(|row| (low..high).contains(&row.probability)).collect();
        println!("| {low} to {:.2} | {} |", high.min(1.0), share(&bin));
    }
    // With these every loop is in one row.
    println!("| told at rest, which has no probability | {} |", share(&told(None)));
    println!("| unknown | {} |", share(&told(Some(Cause::Unknown))));
    // What the signs alone say, without the group.
    let alone = rows.iter().filter(|row| row.cause != Some(Cause::Neighbour));
    let of = |row: &Row| probabilities(&row.signs).into_iter().enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
    let (mut right, mut all) = (0, 0);
    for row in alone {
        let Some((which, _)) = of(row) else { continue };
        (right, all) = (right + usize::from(CLASSES[which] == row.cause), all + 1);
    }
    println!("\nby the signs alone: {right} of {all} right");
}
