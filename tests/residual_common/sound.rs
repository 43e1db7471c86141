//! Loops of the generator that the diagnosis is tested with, in which nothing is hidden.

use stictiond::diagnosis::{self, diagnose};
use stictiond::residual::{self, Kind, trace_record};
use stictiond::signal::{Record, Sample};
use stictiond::sim::scenarios::{SOUND_KINDS, random_sound};
use stictiond::sim::valve::Characteristic;

/// Kinds of sound loop that have noise, a load that no shape describes, or a set point that moves.
const NOTHING_HIDDEN: [&str; 5] =
    ["noise only", "coloured load", "random walk load", "tight tuning", "set-point changes"];

/// Those of `seeds` in which nothing is hidden: of these kinds, with a linear valve.
pub fn sound(seeds: std::ops::Range<u64>) -> Vec<u64> {
    let kind = |seed: &u64| SOUND_KINDS[(seed % SOUND_KINDS.len() as u64) as usize];
    let linear = |seed: &u64| random_sound(*seed).spec.valve.characteristic == Characteristic::Linear;
    seeds.filter(|seed| NOTHING_HIDDEN.contains(&kind(seed)) && linear(seed)).collect()
}

/// What tracing names on the loop of `seed`.
pub fn named(seed: u64) -> Vec<Kind> {
    let run = random_sound(seed).run().expect("a loop that was drawn runs");
    let series =
        |v: &[f64]| -> Vec<Sample> { run.t.iter().zip(v).map(|(t, v)| Sample::good(*t, *v)).collect() };
    let record =
        Record { op: series(&run.op), pv: series(&run.pv), sp: Some(series(&run.sp)), ..Record::default() };
    let settings = diagnosis::Settings::default();
    let found =
        trace_record(&record, &diagnose(&record, &settings), &settings, &residual::Settings::default());
    found.iter().flat_map(|f| &f.effects).map(|e| e.kind).collect()
}
