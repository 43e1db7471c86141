//! Samples a second of the paper's six loops, on one core; at least 2 million are asked for.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;
use stictiond::sim::{LoopSim, SensorSpec, scenarios::table2};

const SAMPLES: u64 = 10_000;

fn paper_loops(c: &mut Criterion) {
    let mut group = c.benchmark_group("sim");
    group.throughput(Throughput::Elements(SAMPLES));
    for case in table2() {
        for (name, noise_sd) in [("quiet", 0.0), ("noisy", 0.1)] {
            let mut spec = case.spec.clone();
            spec.sensor = SensorSpec::noisy(noise_sd);
            let Ok(mut sim) = LoopSim::new(&spec, case.seed) else {
                continue;
            };
            group.bench_function(format!("{}, {name}", case.truth.kind), |b| {
                b.iter(|| {
                    for _ in 0..SAMPLES {
                        black_box(sim.step());
                    }
                });
            });
        }
    }
    group.finish();
}

criterion_group!(benches, paper_loops);
criterion_main!(benches);
