//! How often OP and PV are called read apart, where they are read together and where they are not, with other values of each limit
//! that decides it; and what is then said of the valves, all of which stick:
//! `cargo run --release -p stictiond-numerics --example read_apart -- --records 20 --first-seed 12000`.
//!
//! The valves are told to stick at the controller's ticks. So where `no_stiction` is told, the acquisition is the cause.

#[path = "../tests/common/acquired.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod acquired;
#[path = "../tests/common/generators/mod.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod generators;
#[path = "../tests/common/parallel.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod parallel;

use acquired::{Loop, Said, draw, judge, judge_by, kinds_of_gaps, scans};
use clap::Parser;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use stictiond_numerics::detectors::tally;
use stictiond_numerics::diagnosis::{NotIdentifiable, ReadingLimits, Settings, gate, prepare};
use stictiond_numerics::signal::{Record, Sample, Window};
use stictiond_numerics::sim::acquisition::{Acquisition, Poll, Scans, acquire};
use stictiond_numerics::sim::scenarios::table2_loop;
use stictiond_numerics::sim::{Friction, simulate};

/// One loop in so many is made without noise: there a record of polls looks most like one of changes alone.
const ONE_SMOOTH: u64 = 4;
/// Samples of such a loop, and those before them until it cycles.
const SMOOTH: (usize, usize) = (2000, 1000);
/// S of its valve (% OP): from the paper's weak to its strong one.
const S: [f64; 2] = [1.0, 5.0];
/// J as a share of S.
const J: [f64; 2] = [0.0, 0.6];
/// Largest share by which the clock of who polls differs from the controller's.
const CLOCK: f64 = 3e-4;
/// Scans from one poll to the next where OP and PV are read apart: shorter polls hardly miss a scan, and longer ones leave too few.
const SCANS: [f64; 2] = [2.0, 4.0];
/// Paces at which OP and PV are read, each on its own (scans).
const PACES: [(usize, usize); 4] = [(2, 1), (3, 1), (3, 2), (2, 3)];
/// Largest share of the other scans at which a tag is read besides, as when somebody looks at it.
const BESIDES: f64 = 0.1;

/// How often OP and PV are called read apart, with other values of the limits that decide it
#[derive(Parser)]
struct Args {
    /// Loops, each in every form of acquisition
    #[arg(long, default_value_t = 20)]
    records: usize,
    /// First seed
    #[arg(long, default_value_t = 12_000)]
    first_seed: u64,
    /// Records judged at once
    #[arg(long, default_value_t = std::thread::available_parallelism().map_or(1, usize::from))]
    threads: usize,
    /// Print every record of which no stiction is told
    #[arg(long)]
    each: bool,
}

/// A limit, the values that are tried, and where it stands.
struct Sweep {
    name: &'static str,
    values: &'static [f64],
    of: fn(&mut ReadingLimits) -> &mut f64,
}

const SWEEPS: [Sweep; 4] = [
    Sweep { name: "IN_STEP", values: &[0.8, 0.85, 0.9, 0.95, 0.98, 1.0], of: |limits| &mut limits.in_step },
    Sweep { name: "APART", values: &[0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5], of: |limits| &mut limits.apart },
    Sweep {
        name: "MOST_READ_APART",
        values: &[0.05, 0.1, 0.25, 0.4, 0.5, 0.75],
        of: |limits| &mut limits.most_read_apart,
    },
    Sweep { name: "FAST", values: &[0.5, 0.75, 0.9, 0.95, 0.99], of: |limits| &mut limits.fast },
];

/// Makes a record of a loop, of its scans and of chances of its own.
type Make = dyn Fn(&Loop, &Scans, &mut Pcg64Mcg) -> Record + Sync;

/// A form of acquisition.
struct Form {
    name: String,
    /// Whether OP and PV of a row are of one scan, or read at once.
    together: bool,
    make: Box<Make>,
}

/// A record to be judged.
struct Case<'a> {
    own: &'a Loop,
    form: &'a Form,
    record: Record,
}

/// What is said of a record by one choice of the limits.
#[derive(Clone, Copy, Default)]
struct Outcome {
    /// Whether OP and PV are called read apart.
    apart: bool,
    /// Whether no stiction is told.
    denied: bool,
    /// Where stiction is told, whether the interval of f contains S/2.
    covers: Option<bool>,
}

/// What was said of a window: limits that leave it the same, and the widening of its interval, change nothing else.
struct Known {
    window: Window,
    apart: bool,
    fast: Option<f64>,
    said: Said,
}

fn main() {
    let Args { records: count, first_seed, threads, each } = Args::parse();
    let threads = threads.max(1);
    let loops = sticking(count, first_seed, threads);
    let forms = forms();
    let mut cases: Vec<Case> = Vec::new();
    for own in &loops {
        let Some(scans) = scans(&own.record) else { continue };
        for (at, form) in forms.iter().enumerate() {
            let mut rng = Pcg64Mcg::seed_from_u64(own.seed.wrapping_mul(1000).wrapping_add(at as u64));
            cases.push(Case { own, form, record: (form.make)(own, &scans, &mut rng) });
        }
    }
    // The published limits come first.
    let mut tried = vec![ReadingLimits::default()];
    for sweep in &SWEEPS {
        tried.extend(sweep.values.iter().map(|value| with(sweep, *value)));
    }
    let found: Vec<Vec<Outcome>> = parallel::on(threads, &cases, |case| outcomes(case, &tried));
    println!(
        "{} sticking loops, seeds from {first_seed}, in {} forms of acquisition; Wilson 95 % intervals in brackets",
        loops.len(),
        forms.len()
    );
    by_form(&forms, &cases, &found);
    let mut first = 1;
    for sweep in &SWEEPS {
        by_value(sweep, first, &cases, &found);
        first += sweep.values.len();
    }
    for (case, outcomes) in cases.iter().zip(&found).filter(|(_, outcomes)| each && outcomes[0].denied) {
        println!("{}, {}: no stiction, apart {}", case.own.name, case.form.name, outcomes[0].apart);
    }
}

/// The published limits with another value of one.
fn with(sweep: &Sweep, value: f64) -> ReadingLimits {
    let mut limits = ReadingLimits::default();
    *(sweep.of)(&mut limits) = value;
    limits
}

/// Loops that are told to stick at the controller's ticks.
fn sticking(count: usize, first: u64, threads: usize) -> Vec<Loop> {
    let one = |i: u64| if i % ONE_SMOOTH == ONE_SMOOTH - 1 { smooth(first + i) } else { draw(i, first + i) };
    let drawn: Vec<Loop> = (0..).map(one).filter(|own| own.f > 0.0).take(2 * count).collect();
    let told = parallel::on(threads, &drawn, |own| judge(own, &own.record).sticks());
    drawn.into_iter().zip(told).filter(|(_, sticks)| *sticks).map(|(own, _)| own).take(count).collect()
}

/// The paper's level loop without noise, with a valve of its own.
fn smooth(seed: u64) -> Loop {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let s = rng.random_range(S[0]..S[1]);
    let j = s * rng.random_range(J[0]..J[1]);
    let (samples, before) = SMOOTH;
    let spec = table2_loop(true, Friction::Choudhury { s, j, resolution: 0.005 });
    let run = simulate(&spec, before + samples, seed).expect("can be simulated").after(before);
    let series =
        |v: &[f64]| -> Vec<Sample> { run.t.iter().zip(v).map(|(t, v)| Sample::good(*t, *v)).collect() };
    let record =
        Record { op: series(&run.op), pv: series(&run.pv), op_span: Some(100.0), ..Record::default() };
    Loop { name: format!("level, no noise, S {s:.2}, {seed}"), record, f: 0.5 * s, also: Vec::new(), seed }
}

/// Every form that the simulator knows, but those in which PV is read later than its stamp says; and OP and PV read apart.
fn forms() -> Vec<Form> {
    fn form(
        name: &str,
        together: bool,
        make: impl Fn(&Loop, &Scans, &mut Pcg64Mcg) -> Record + Sync + 'static,
    ) -> Form {
        Form { name: name.to_string(), together, make: Box::new(make) }
    }
    fn simulated(name: &str, how: impl Fn(f64, &mut Pcg64Mcg) -> Acquisition + Sync + 'static) -> Form {
        form(name, true, move |own, scans, rng| {
            let how = how(scans.scan_s, rng);
            Record { op_span: Some(100.0), ..acquire(scans, &how, own.seed) }
        })
    }
    let mut forms = vec![
        form("at the controller's ticks", true, |own, _, _| own.record.clone()),
        form("OP stamped 0.3 to 0.5 of a scan later", true, stamped_later),
        simulated("same period, own clock, 5 % jitter", |s, rng| Acquisition::Polled(poll(s, rng))),
        simulated("twice per controller scan", |s, rng| Acquisition::Polled(poll(0.5 * s, rng))),
        simulated("every 2.3 scans", |s, rng| Acquisition::Polled(poll(2.3 * s, rng))),
        simulated("scaled integers of 0.01", |s, rng| {
            Acquisition::Polled(Poll { step: 0.01, ..poll(s, rng) })
        }),
        simulated("a tenth without an answer, a tenth answered twice", |s, rng| {
            Acquisition::Polled(Poll { dropped: 0.1, doubled: 0.1, ..poll(s, rng) })
        }),
        simulated("on change, with source stamps", |_, _| Acquisition::OnChange { dead_band: 0.0 }),
        simulated("on changes of 0.05 and more", |_, _| Acquisition::OnChange { dead_band: 0.05 }),
    ];
    forms.extend(kinds_of_gaps(10).map(|(how, gaps)| {
        simulated(&format!("10 % missing, {how}"), move |s, _| {
            Acquisition::Polled(Poll { gaps, phase: 0.5, ..Poll::every(s) })
        })
    }));
    forms.push(form("a random share of a poll of 2 to 4 scans apart", false, polled_apart));
    forms.push(form("in turns", false, in_turns));
    forms.push(form("each at a pace of its own", false, at_paces));
    forms
}

/// A poll of this period (s) with a clock and a phase of its own, and 5 % jitter.
fn poll(period_s: f64, rng: &mut Pcg64Mcg) -> Poll {
    let clock = 1.0 + CLOCK * (2.0 * rng.random::<f64>() - 1.0);
    Poll { phase: rng.random::<f64>(), jitter: 0.05, ..Poll::every(period_s * clock) }
}

/// PV stamped at the tick, and OP of the same tick when its register is read.
fn stamped_later(own: &Loop, scans: &Scans, rng: &mut Pcg64Mcg) -> Record {
    let late = scans.scan_s * rng.random_range(0.3..0.5);
    let op = own.record.op.iter().map(|s| Sample { t: s.t + late, ..*s }).collect();
    Record { op, ..own.record.clone() }
}

/// One poll of two requests, OP's a random share of the period after PV's.
fn polled_apart(own: &Loop, scans: &Scans, rng: &mut Pcg64Mcg) -> Record {
    let of_pv = poll(scans.scan_s * rng.random_range(SCANS[0]..SCANS[1]), rng);
    let of_op = Poll { phase: of_pv.phase + rng.random::<f64>(), ..of_pv };
    let [op, pv] = [of_op, of_pv].map(|poll| acquire(scans, &Acquisition::Polled(poll), own.seed));
    Record { op: op.op, op_span: Some(100.0), ..pv }
}

/// OP and PV at the same pace, but never at one scan.
fn in_turns(own: &Loop, _: &Scans, rng: &mut Pcg64Mcg) -> Record {
    let pace = rng.random_range(2..=4);
    let after = rng.random_range(1..pace);
    at_scans(own, [(pace, after), (pace, 0)], rng)
}

/// OP and PV at paces of their own: of one scan now and then only, or OP more seldom.
fn at_paces(own: &Loop, _: &Scans, rng: &mut Pcg64Mcg) -> Record {
    let (op, pv) = PACES[rng.random_range(0..PACES.len())];
    at_scans(own, [(op, 0), (pv, 0)], rng)
}

/// OP and PV at every so many-th scan from one on, and at a few scans besides, with the controller's stamps.
fn at_scans(own: &Loop, [op, pv]: [(usize, usize); 2], rng: &mut Pcg64Mcg) -> Record {
    let besides = BESIDES * rng.random::<f64>();
    let mut read = |series: &[Sample], (pace, from): (usize, usize)| -> Vec<Sample> {
        let mut is_read = |k: usize| k % pace == from || rng.random::<f64>() < besides;
        series.iter().enumerate().filter(|(k, _)| is_read(*k)).map(|(_, s)| *s).collect()
    };
    Record { op: read(&own.record.op, op), pv: read(&own.record.pv, pv), ..own.record.clone() }
}

/// What is said of a record by each choice of the limits.
fn outcomes(case: &Case, tried: &[ReadingLimits]) -> Vec<Outcome> {
    let mut known = Vec::new();
    tried.iter().map(|limits| outcome(case, *limits, &mut known)).collect()
}

fn outcome(case: &Case, reading: ReadingLimits, known: &mut Vec<Known>) -> Outcome {
    let settings = Settings { reading, ..Settings::default() };
    let (window, mut preparation) = match gate::gate(&case.record, &settings) {
        Ok(passed) => passed,
        Err(why) => {
            let apart = matches!(why.0, NotIdentifiable::ReadApart { .. });
            return Outcome { apart, ..Outcome::default() };
        }
    };
    // How many rows become one is known once the window is prepared.
    prepare::prepare(window.clone(), &settings, &mut preparation);
    let apart = preparation.apart().is_some();
    let unseen = preparation.acquisition.as_ref().is_some_and(|found| found.unseen_scans());
    let fast = (apart || unseen).then_some(reading.fast);
    let same = |own: &Known| own.window == window && own.apart == apart && own.fast == fast;
    let at = known.iter().position(same).unwrap_or_else(|| {
        let said = judge_by(case.own, &case.record, &settings);
        known.push(Known { window, apart, fast, said });
        known.len() - 1
    });
    let said = &known[at].said;
    let covers = said.sticks().then(|| said.covers(case.own.f));
    Outcome { apart, denied: said.verdict == "no_stiction", covers }
}

/// What is said by the published limits, by the form of acquisition.
fn by_form(forms: &[Form], cases: &[Case], found: &[Vec<Outcome>]) {
    println!("\n| acquisition | read | called apart | called `no_stiction` | interval contains S/2 |");
    println!("|---|---|---|---|---|");
    for form in forms {
        let of: Vec<Outcome> = outcomes_of(cases, found, 0, |case| std::ptr::eq(case.form, form));
        let read = if form.together { "together" } else { "apart" };
        let [apart, denied, covers] = cells(&of);
        println!("| {} | {read} | {apart} | {denied} | {covers} |", form.name);
    }
}

/// What is said by each value of a limit, of which the first is the `first` choice.
fn by_value(sweep: &Sweep, first: usize, cases: &[Case], found: &[Vec<Outcome>]) {
    println!(
        "\n| `{}` | together: called apart | apart: called apart | together: called `no_stiction` | apart: called `no_stiction` | together: interval contains S/2 | apart: interval contains S/2 |",
        sweep.name
    );
    println!("|---|---|---|---|---|---|---|");
    for (at, value) in sweep.values.iter().enumerate() {
        let of =
            |together: bool| outcomes_of(cases, found, first + at, |case| case.form.together == together);
        let (together, apart) = (cells(&of(true)), cells(&of(false)));
        let mark = if with(sweep, *value) == ReadingLimits::default() { " (published)" } else { "" };
        let cells: Vec<&str> =
            together.iter().zip(&apart).flat_map(|(a, b)| [a.as_str(), b.as_str()]).collect();
        println!("| {value}{mark} | {} |", cells.join(" | "));
    }
}

/// What is said of some cases by one choice of the limits.
fn outcomes_of(
    cases: &[Case],
    found: &[Vec<Outcome>],
    choice: usize,
    wanted: impl Fn(&Case) -> bool,
) -> Vec<Outcome> {
    let of = cases.iter().zip(found).filter(|(case, _)| wanted(case));
    of.map(|(_, outcomes)| outcomes[choice]).collect()
}

/// How many are called apart, how many are told no stiction, and how many intervals contain S/2, of all, of all and of those told to
/// stick.
fn cells(of: &[Outcome]) -> [String; 3] {
    let count = |is: fn(&Outcome) -> bool| of.iter().filter(|own| is(own)).count();
    let told = count(|own| own.covers.is_some());
    [
        wilson(count(|own| own.apart), of.len()),
        wilson(count(|own| own.denied), of.len()),
        wilson(count(|own| own.covers == Some(true)), told),
    ]
}

/// Hits, and the Wilson 95 % interval of their share, in per cent.
fn wilson(hits: usize, of: usize) -> String {
    match tally::wilson(hits, of) {
        Some([low, high]) => format!("{hits} of {of} [{:.0}, {:.0}]", 100.0 * low, 100.0 * high),
        None => "-".into(),
    }
}
