//! What tracing a residual costs on one core, in processor time.
//!
//! `cargo bench --bench residual`; the target for a window of 2,000 samples with 20 tags is 200 ms.

use std::hint::black_box;
use std::time::Instant;
use stictiond::diagnosis::{Settings, diagnose, gate};
use stictiond::residual::{self, trace};
use stictiond::signal::{Record, Sample};
use stictiond::sim::scenarios::{random_sound, random_sticky};

/// Samples of a window, tags that have nothing to do with it, and loops of each family.
const SAMPLES: usize = 2000;
const TAGS: usize = 20;
const LOOPS: u64 = 12;

fn main() {
    let begun = Instant::now();
    let settings = Settings::default();
    let mut spent: Vec<f64> = Vec::new();
    for seed in 0..LOOPS {
        for mut scenario in [random_sticky(seed), random_sound(seed)] {
            scenario.n = SAMPLES + scenario.warm_up;
            let Ok(run) = scenario.run() else { continue };
            let series = |v: &[f64]| -> Vec<Sample> {
                run.t.iter().zip(v).map(|(t, value)| Sample::good(*t, *value)).collect()
            };
            let wave = |tag: usize| -> Vec<f64> {
                let w = 0.013 * (tag + 1) as f64;
                (0..run.t.len()).map(|k| (w * k as f64).sin() + (1.7 * w * k as f64).cos()).collect()
            };
            let record = Record {
                op: series(&run.op),
                pv: series(&run.pv),
                tags: (0..TAGS).map(|tag| (format!("tag {tag}"), series(&wave(tag)))).collect(),
                ..Record::default()
            };
            let Ok((window, _)) = gate::gate(&record, &settings) else { continue };
            let diagnosis = diagnose(&record, &settings);
            let before = now_ms(begun);
            black_box(trace(&window, &diagnosis, &residual::Settings::default()));
            spent.push(now_ms(begun) - before);
        }
    }
    spent.sort_by(f64::total_cmp);
    let at = |share: f64| spent[((spent.len() - 1) as f64 * share) as usize];
    println!(
        "tracing {} windows of {SAMPLES} samples with {TAGS} tags: median {:.0} ms, 90 % {:.0} ms, worst {:.0} ms (target 200 ms)",
        spent.len(),
        at(0.5),
        at(0.9),
        at(1.0)
    );
}

/// Processor time of this thread where the system tells it, else the wall's [ms]: what else runs here is not counted.
fn now_ms(begun: Instant) -> f64 {
    let stat = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanoseconds: Option<f64> = stat.split(' ').next().and_then(|text| text.parse().ok());
    nanoseconds.map_or_else(|| begun.elapsed().as_secs_f64() * 1e3, |ns| ns * 1e-6)
}
