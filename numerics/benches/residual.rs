//! What an answer costs on one core, in processor time: a diagnosis and the tracing of its residual together.
//!
//! `cargo bench -p stictiond-numerics --bench residual`. Targets for a window of 2,000 samples with 20 tags: 300 ms in the
//! median and 900 ms at worst; where the structure of the last model holds, 60 ms.

use std::hint::black_box;
use std::time::Instant;
use stictiond_numerics::diagnosis::{Settings, diagnose};
use stictiond_numerics::residual;
use stictiond_numerics::signal::{Record, Sample};
use stictiond_numerics::sim::scenarios::{Scenario, random_sound, random_sticky};

/// Samples of a window, tags that have nothing to do with it, and loops of each family.
const SAMPLES: usize = 2000;
const TAGS: usize = 20;
const LOOPS: u64 = 12;
/// Targets (ms).
const MEDIAN: f64 = 300.0;
const WORST: f64 = 900.0;
const CONFIRMED: f64 = 60.0;

fn main() {
    let clock = Clock(Instant::now());
    let drawn = (0..LOOPS).flat_map(|seed| [random_sticky(seed), random_sound(seed)]);
    let records: Vec<Record> = drawn.filter_map(record).collect();
    let settings = Settings::default();
    let (mut diagnosing, mut together, mut confirming) = (Vec::new(), Vec::new(), Vec::new());
    for record in &records {
        let (diagnosis, of_diagnosis) = clock.spent(|| diagnose(black_box(record), &settings));
        let of = residual::Settings::default();
        let (found, of_tracing) = clock.spent(|| residual::trace_record(record, &diagnosis, &settings, &of));
        diagnosing.push(of_diagnosis);
        together.push(of_diagnosis + of_tracing);
        // The same window again: its structure mostly holds.
        if let Some(structure) = found.and_then(|found| found.structure) {
            let (again, of_it) = clock.spent(|| residual::confirm(record, &settings, &of, &structure));
            again.iter().for_each(|_| confirming.push(of_it));
        }
    }
    println!("{} windows of {SAMPLES} samples with {TAGS} tags, processor time", records.len());
    print("diagnosis", diagnosing, "");
    let targets = format!(" (targets: median {MEDIAN:.0}, worst {WORST:.0})");
    print("diagnosis and tracing", together, &targets);
    println!("{} of them have a structure that holds", confirming.len());
    print("structure confirmed", confirming, &format!(" (target: {CONFIRMED:.0})"));
}

fn print(what: &str, mut spent: Vec<f64>, target: &str) {
    spent.sort_by(f64::total_cmp);
    let at = |share: f64| spent[((spent.len() - 1) as f64 * share) as usize];
    println!(
        "{what:21} median {:4.0} ms, 90 % {:4.0} ms, worst {:4.0} ms{target}",
        at(0.5),
        at(0.9),
        at(1.0)
    );
}

/// The loop over a whole window, with tags of periods that are not its own.
fn record(mut scenario: Scenario) -> Option<Record> {
    scenario.n = SAMPLES + scenario.warm_up;
    let run = scenario.run().ok()?;
    let series = |v: &[f64]| -> Vec<Sample> {
        run.t.iter().zip(v).map(|(t, value)| Sample::good(*t, *value)).collect()
    };
    let wave = |tag: usize| -> Vec<f64> {
        let w = 0.013 * (tag + 1) as f64;
        (0..run.t.len()).map(|k| (w * k as f64).sin() + (1.7 * w * k as f64).cos()).collect()
    };
    Some(Record {
        op: series(&run.op),
        pv: series(&run.pv),
        tags: (0..TAGS).map(|tag| (format!("tag {tag}"), series(&wave(tag)))).collect(),
        ..Record::default()
    })
}

struct Clock(Instant);

impl Clock {
    /// Processor time of this thread where the system tells it, else the wall's (ms): what else runs here is not counted.
    fn now_ms(&self) -> f64 {
        let stat = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
        let nanoseconds: Option<f64> = stat.split(' ').next().and_then(|text| text.parse().ok());
        nanoseconds.map_or_else(|| self.0.elapsed().as_secs_f64() * 1e3, |ns| ns * 1e-6)
    }

    /// What `work` gives, and what it took (ms).
    fn spent<T>(&self, work: impl FnOnce() -> T) -> (T, f64) {
        let start = self.now_ms();
        let done = black_box(work());
        (done, self.now_ms() - start)
    }
}
