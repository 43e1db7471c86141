//! What the opinions of the published methods cost on one core, in processor time.
//!
//! `cargo bench -p stictiond-numerics --bench opinions`. Targets for a window of 1,000 samples: each method within 20 ms, all of
//! them, with what they share, within 60 ms.

use std::hint::black_box;
use std::time::Instant;
use stictiond_numerics::detectors::{Facts, Method, opinion, opinions};
use stictiond_numerics::signal::Window;
use stictiond_numerics::sim::scenarios::{Scenario, random_sound, random_sticky};

/// Samples of a window, and loops of each family.
const SAMPLES: usize = 1000;
const LOOPS: u64 = 20;
/// Times that one is repeated: a clock that ticks in milliseconds sees no single one.
const REPEATED: u32 = 20;
/// Targets (ms).
const EACH: f64 = 20.0;
const ALL: f64 = 60.0;

fn main() {
    let clock = Clock(Instant::now());
    let drawn = (0..LOOPS).flat_map(|seed| [random_sticky(seed), random_sound(seed)]);
    let windows: Vec<Window> = drawn.filter_map(window).collect();
    println!("{} windows of {SAMPLES} samples, processor time", windows.len());
    let of = |work: &dyn Fn(&Window)| -> Vec<f64> {
        windows.iter().map(|window| clock.mean(|| work(black_box(window)))).collect()
    };
    print("what they share", of(&|window| drop(black_box(Facts::new(window, None)))), EACH);
    for method in Method::ALL {
        let spent: Vec<f64> = windows
            .iter()
            .filter_map(|window| {
                let facts = Facts::new(window, Some(method == Method::Horch2000)).ok()?;
                Some(clock.mean(|| opinion(method, black_box(&facts))))
            })
            .collect();
        print(method.as_str(), spent, EACH);
    }
    print("all together", of(&|window| drop(black_box(opinions(window, None)))), ALL);
}

fn print(what: &str, mut spent: Vec<f64>, target: f64) {
    spent.sort_by(f64::total_cmp);
    let at = |share: f64| spent[((spent.len() - 1) as f64 * share) as usize];
    println!("{what:22} median {:6.2} ms, worst {:6.2} ms (target {target:.0})", at(0.5), at(1.0));
}

/// The last samples of a loop, with its stem.
fn window(mut scenario: Scenario) -> Option<Window> {
    scenario.n = SAMPLES + scenario.warm_up;
    let run = scenario.run().ok()?;
    Some(Window { ts: run.ts, op: run.op, pv: run.pv, mv: Some(run.mv), ..Window::default() })
}

struct Clock(Instant);

impl Clock {
    /// Processor time of this thread where the system tells it, else the wall's (ms): what else runs here is not counted.
    fn now_ms(&self) -> f64 {
        let stat = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
        let nanoseconds: Option<f64> = stat.split(' ').next().and_then(|text| text.parse().ok());
        nanoseconds.map_or_else(|| self.0.elapsed().as_secs_f64() * 1e3, |ns| ns * 1e-6)
    }

    /// What `work` takes in the mean of some (ms).
    fn mean<T>(&self, work: impl Fn() -> T) -> f64 {
        let start = self.now_ms();
        for _ in 0..REPEATED {
            black_box(work());
        }
        (self.now_ms() - start) / f64::from(REPEATED)
    }
}
