//! Sound loops whose load jumps, as a pump makes it: a stem with friction predicts PV better than OP does, but PV does not
//! follow it.

use super::common::parallel;
use super::common::records::simulated;
use stictiond_numerics::diagnosis::{NotIdentifiable, Settings, Verdict, diagnose};
use stictiond_numerics::residual::{self, trace_record};
use stictiond_numerics::sim::load::{Load, LoadKind};
use stictiond_numerics::sim::scenarios::random_sound;

/// Samples between two jumps.
const BETWEEN: [f64; 6] = [120.0, 70.0, 190.0, 95.0, 150.0, 60.0];
/// The load while the pump runs (% OP).
const PUMP: f64 = 4.0;

#[test]
fn a_load_that_jumps_is_seldom_taken_for_friction() {
    let found = parallel::each(7100..7140, |seed| {
        let mut scenario = random_sound(seed);
        let ts = scenario.spec.ts_s;
        let (mut at_s, mut size) = (150.0 * ts, PUMP);
        scenario.spec.loads.clear();
        for between in BETWEEN.iter().cycle().take(24) {
            scenario.spec.loads.push(Load::input(LoadKind::Step { at_s, size }));
            (at_s, size) = (at_s + between * ts, -size);
        }
        let (record, settings) = (simulated(&scenario), Settings::default());
        let declared = diagnose(&record, &settings);
        let traced = trace_record(&record, &declared, &settings, &residual::Settings::default());
        traced.filter(|found| found.replaces_diagnosis()).map_or(declared.verdict, |found| found.verdict)
    });
    let told = found.iter().filter(|verdict| **verdict == Verdict::Stiction).count();
    let not_followed = Verdict::NotIdentifiable(NotIdentifiable::StemNotFollowed);
    let found_out = found.iter().filter(|verdict| **verdict == not_followed).count();
    println!("of {} sound loops {told} are told as sticking, {found_out} are found out", found.len());
    // Each of those that are found out would be told as sticking. docs/diagnosis.md says 6 and 2.
    assert!(told <= 3 && found_out >= 4, "{found_out} are found out, {told} told");
}
