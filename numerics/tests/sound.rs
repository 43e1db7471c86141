//! Sound valves whose loops a square or triangular load drives: the load is what a stem that sticks looks most like.
//!
//! `cargo run --release -p stictiond-numerics --example sound_rates` counts how often they are told to stick.

#[path = "common/records.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod records;

use stictiond_numerics::diagnosis::{Settings, Verdict, diagnose};
use stictiond_numerics::residual::{self, trace_record};
use stictiond_numerics::sim::scenarios::random_sound;

#[test]
fn a_load_with_corners_is_not_taken_for_a_stem_that_sticks() {
    // Each was told to stick while a load could have no corners and no explanation without friction was searched for on its own.
    for seed in [2073, 2128, 2238, 2292, 2370, 2490] {
        let scenario = random_sound(seed);
        let kind = scenario.truth.kind.clone();
        let (record, settings) = (records::window(scenario).expect("can be simulated"), Settings::default());
        let diagnosis = diagnose(&record, &settings);
        let found = trace_record(&record, &diagnosis, &settings, &residual::Settings::default());
        let found = found.expect("long enough");
        assert_ne!(found.verdict, Verdict::Stiction, "seed {seed}, {kind}: {}", found.reason);
    }
}
