//! How optimistic the published errors are: the held-out samples on which they are taken also reject effects.
//! `cargo run --release -p stictiond-numerics --example held_out_optimism -- --seeds 2 --first-seed 6400`.
//!
//! The first part of each record ([`DIAGNOSED`]) is diagnosed and traced as the daemon does. Behind its end the same loop goes on,
//! with its effects and its friction. The models that were published predict these samples one step ahead; they chose nothing.

#[path = "../../tests/common/generators/mod.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod generators;
mod optimism;
#[path = "../../tests/common/parallel.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod parallel;

use clap::Parser;
use generators::{Case, GENERATORS, Generator, Size};
use optimism::{Errors, mean_with_interval};
use stictiond_numerics::diagnosis::{self, diagnose};
use stictiond_numerics::residual::{self, Kind, trace_continued};
use stictiond_numerics::signal::{Record, Sample};

/// Share of a record that is diagnosed. No generator lets a change begin behind it. The rest is 18 % as long as this part, about as
/// long as the held-out samples: they are a fifth of the rows behind the start of the stem.
const DIAGNOSED: f64 = 0.85;
/// Faults of samples. They are repaired in the record, and would count where it goes on.
const FAULTS: [Kind; 3] = [Kind::Outliers, Kind::FrozenPv, Kind::ClockSkew];
/// Tags that have nothing to do with the loop.
const TAGS: usize = 3;

/// How optimistic the published errors are
#[derive(Parser)]
struct Options {
    /// Letters of the generators
    #[arg(long, default_value = "ABC")]
    generators: String,
    /// Number of seeds; each gives every effect on every variant of a loop
    #[arg(long, default_value_t = 2)]
    seeds: u64,
    /// First seed
    #[arg(long, default_value_t = 6400)]
    first_seed: u64,
    /// Cases traced at once
    #[arg(long, default_value_t = std::thread::available_parallelism().map_or(1, usize::from))]
    threads: usize,
    /// Print every record
    #[arg(long)]
    each: bool,
}

/// What became of a case.
enum Outcome {
    /// Nothing was traced, or the longer record has other rows.
    NotTraced,
    /// Wrong samples were told: the record is left out.
    Repaired,
    /// An error is 0, or not a number.
    NoLogarithm,
    /// It counts.
    Measured(Measured),
}

impl Options {
    fn range(&self) -> std::ops::Range<u64> {
        self.first_seed..self.first_seed + self.seeds
    }
}

/// One record with its errors.
struct Measured {
    errors: Errors,
    /// Whether an effect is named that the signals alone do not show.
    named: bool,
    /// Whether one was rejected: by the held-out samples, or because PV follows OP beyond a stop.
    rejected: bool,
    /// Whether the model with the effects is another than the declared one, by its error.
    differs: bool,
}

fn main() {
    let options = Options::parse();
    println!("seeds {:?}; 95 % bootstrap intervals in brackets\n", options.range());
    let mut table = Vec::new();
    let mut all = Vec::new();
    for generator in GENERATORS.iter().filter(|own| options.generators.contains(own.name)) {
        let cases = cases(generator, &options);
        let count = cases.len();
        let found = parallel::on(options.threads.max(1), cases, |case| (case, outcome(generator, &case)));
        if options.each {
            found.iter().for_each(|(case, outcome)| show(generator, case, outcome));
        }
        let left = |wanted: fn(&Outcome) -> bool| found.iter().filter(|own| wanted(&own.1)).count();
        println!(
            "{}: {count} records; left out: {} not traced, {} with wrong samples, {} without a logarithm",
            generator.name,
            left(|own| matches!(own, Outcome::NotTraced)),
            left(|own| matches!(own, Outcome::Repaired)),
            left(|own| matches!(own, Outcome::NoLogarithm)),
        );
        let measured = found.into_iter().filter_map(|(_, outcome)| match outcome {
            Outcome::Measured(measured) => Some(measured),
            _ => None,
        });
        let measured: Vec<Measured> = measured.collect();
        table.extend(rows(generator.name, &measured));
        all.extend(measured);
    }
    table.extend(rows("all", &all));
    println!();
    println!(
        "| records | number | declared model: ln(continuation / published) | with the effects: the same | ln(after / before), published | on the continuation | optimism | error falls: published, of these on the continuation |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    table.iter().for_each(|row| println!("{row}"));
}

/// Every effect that can be rejected, on every variant of a loop, for each seed.
fn cases(generator: &Generator, options: &Options) -> Vec<Case> {
    // A quantised PV is shown by the signals alone and has nothing that a held-out sample could reject.
    let kinds = Kind::ALL.into_iter().filter(|kind| !FAULTS.contains(kind) && *kind != Kind::QuantisedPv);
    let of_kind = |kind: Kind| {
        let of_seed = move |seed: u64| {
            let size = Size::Medium;
            let case = move |variant| Case { effect: Some(kind), size, variant, seed, tags: TAGS };
            (0..(generator.variants)(Some(kind))).map(case)
        };
        options.range().flat_map(of_seed)
    };
    kinds.flat_map(of_kind).collect()
}

/// Diagnoses and traces the first part of a case's record, and predicts the rest.
fn outcome(generator: &Generator, case: &Case) -> Outcome {
    let (longer, _) = (generator.record)(case);
    let record = first_part(&longer);
    let diagnosed = diagnosis::Settings::default();
    let diagnosis = diagnose(&record, &diagnosed);
    let settings = residual::Settings::default();
    let Some(found) = trace_continued(&record, &longer, &diagnosis, &diagnosed, &settings) else {
        return Outcome::NotTraced;
    };
    let (told, continued) = (&found.findings, found.one_step_rmse);
    if told.effects.iter().any(|effect| FAULTS.contains(&effect.kind)) {
        return Outcome::Repaired;
    }
    let held_out = [told.before.one_step_rmse, told.after.one_step_rmse];
    let errors = Errors { held_out, continued };
    if !errors.are_positive() {
        return Outcome::NoLogarithm;
    }
    Outcome::Measured(Measured {
        errors,
        named: told.effects.iter().any(|effect| effect.evidence.is_some()),
        rejected: !told.rejected.is_empty(),
        differs: held_out[0] != held_out[1],
    })
}

/// The samples of a record up to [`DIAGNOSED`] of its length.
fn first_part(record: &Record) -> Record {
    let ends = record.op.first().zip(record.op.last());
    let until = ends.map_or(0.0, |(first, last)| first.t + DIAGNOSED * (last.t - first.t));
    let cut = |series: &Vec<Sample>| series.iter().copied().filter(|sample| sample.t <= until).collect();
    Record {
        op: cut(&record.op),
        pv: cut(&record.pv),
        sp: record.sp.as_ref().map(cut),
        tags: record.tags.iter().map(|(name, series)| (name.clone(), cut(series))).collect(),
        ..record.clone()
    }
}

/// The rows of the table: records with an effect named, and the others whose model is not the declared one.
fn rows(label: &str, measured: &[Measured]) -> Vec<String> {
    let of = |what: &str, wanted: fn(&Measured) -> bool| {
        let own: Vec<Errors> = measured.iter().filter(|own| wanted(own)).map(|own| own.errors).collect();
        row(&format!("{label}, {what}"), &own)
    };
    vec![
        of("an effect named", |own| own.named),
        of("of these, another rejected", |own| own.named && own.rejected),
        of("none named, another model", |own| !own.named && own.differs),
    ]
}

fn row(label: &str, errors: &[Errors]) -> String {
    let told = |of: &dyn Fn(&Errors) -> f64| {
        let values: Vec<f64> = errors.iter().map(of).collect();
        mean_with_interval(&values)
            .map_or("-".into(), |(mean, [low, high])| format!("{mean:+.4} [{low:+.4}, {high:+.4}]"))
    };
    let falls: Vec<[f64; 2]> = errors.iter().map(Errors::gains).filter(|gains| gains[0] < 0.0).collect();
    let both = falls.iter().filter(|gains| gains[1] < 0.0).count();
    format!(
        "| {label} | {} | {} | {} | {} | {} | {} | {}, {both} |",
        errors.len(),
        told(&|own| own.grown()[0]),
        told(&|own| own.grown()[1]),
        told(&|own| own.gains()[0]),
        told(&|own| own.gains()[1]),
        told(&Errors::optimism),
        falls.len()
    )
}

/// One record in a line.
fn show(generator: &Generator, case: &Case, outcome: &Outcome) {
    let kind = case.effect.map_or("clean", Kind::as_str);
    let told = match outcome {
        Outcome::NotTraced => "not traced".into(),
        Outcome::Repaired => "wrong samples".into(),
        Outcome::NoLogarithm => "no logarithm".into(),
        Outcome::Measured(own) => format!(
            "published {:.4?}, continuation {:.4?}, optimism {:+.4}, named {}, rejected {}",
            own.errors.held_out,
            own.errors.continued,
            own.errors.optimism(),
            own.named,
            own.rejected
        ),
    };
    println!("  {} {kind} v{} seed {}: {told}", generator.name, case.variant, case.seed);
}
