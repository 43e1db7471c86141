//! Loops of the generator that the diagnosis is tested with.

use stictiond_numerics::diagnosis::{self, Verdict, diagnose};
use stictiond_numerics::residual::{self, Kind, trace_record};
use stictiond_numerics::signal::{Record, Sample};
use stictiond_numerics::sim::scenarios::{SOUND_KINDS, Scenario, random_sound};
use stictiond_numerics::sim::valve::Characteristic;

/// Kinds of sound loop that have noise, a load that no shape describes, or a set point that moves.
const NOTHING_HIDDEN: [&str; 5] =
    ["noise only", "coloured load", "random walk load", "tight tuning", "set-point changes"];

/// What tracing makes of a loop.
pub struct Traced {
    /// Whether the declared model says stiction, and the one with the effects.
    pub sticks: [bool; 2],
    /// The effects.
    pub named: Vec<Kind>,
}

/// Those of `seeds` whose sound loop has nothing hidden: of these kinds, with a linear valve.
pub fn nothing_hidden(seeds: std::ops::Range<u64>) -> Vec<u64> {
    let kind = |seed: &u64| SOUND_KINDS[(seed % SOUND_KINDS.len() as u64) as usize];
    let linear = |seed: &u64| random_sound(*seed).spec.valve.characteristic == Characteristic::Linear;
    seeds.filter(|seed| NOTHING_HIDDEN.contains(&kind(seed)) && linear(seed)).collect()
}

/// Diagnoses and traces the loop of `scenario`.
pub fn traced(scenario: &Scenario) -> Traced {
    let run = scenario.run().expect("a loop that was drawn runs");
    let series =
        |v: &[f64]| -> Vec<Sample> { run.t.iter().zip(v).map(|(t, v)| Sample::good(*t, *v)).collect() };
    let record =
        Record { op: series(&run.op), pv: series(&run.pv), sp: Some(series(&run.sp)), ..Record::default() };
    let settings = diagnosis::Settings::default();
    let diagnosis = diagnose(&record, &settings);
    let found = trace_record(&record, &diagnosis, &settings, &residual::Settings::default());
    let sticks = |verdict: &Verdict| *verdict == Verdict::Stiction;
    let before = sticks(&diagnosis.verdict);
    Traced {
        sticks: [before, found.as_ref().map_or(before, |f| sticks(&f.verdict))],
        named: found.iter().flat_map(|f| &f.effects).map(|e| e.kind).collect(),
    }
}
