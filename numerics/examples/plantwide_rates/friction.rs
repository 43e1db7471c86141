//! What a diagnosis says of a simulated loop's valve, as the daemon hands it to the analysis of the plant.

use stictiond_numerics::diagnosis::{self, Verdict, diagnose};
use stictiond_numerics::plantwide::Friction;
use stictiond_numerics::residual::{self, overruled, trace_record};
use stictiond_numerics::signal::{Record, Sample};
use stictiond_numerics::sim::Run;

/// What a diagnosis says of a loop's valve, in the words that a report has.
pub fn friction(run: &Run) -> Option<Friction> {
    let series = |x: &[f64]| run.t.iter().zip(x).map(|(t, x)| Sample::good(*t, *x)).collect();
    let record = Record {
        op: series(&run.op),
        pv: series(&run.pv),
        sp: Some(series(&run.sp)),
        op_limits: Some((0.0, 100.0)),
        op_span: Some(100.0),
        ..Record::default()
    };
    let settings = diagnosis::Settings::default();
    let diagnosis = diagnose(&record, &settings);
    let found = trace_record(&record, &diagnosis, &settings, &residual::Settings::default());
    let traced = found.as_ref().filter(|found| found.replaces_diagnosis());
    let verdict = traced.map_or(&diagnosis.verdict, |found| &found.verdict);
    let declared = diagnosis.estimate.as_ref().map(|own| own.delta_aic);
    let delta_aic = traced.map(|found| found.friction_after.delta_aic).or(declared)?;
    let sticks = match verdict {
        Verdict::Stiction => true,
        Verdict::NoStiction => false,
        Verdict::NotIdentifiable(_) => return None,
    };
    let f = traced.map(|found| found.friction_after.f).or(diagnosis.estimate.as_ref().map(|own| own.f));
    let is_contested = traced.is_some_and(|found| found.reason.contains(overruled()));
    // OP is in % of its span, and S is twice f.
    let (band, says) = (f.map(|f| 2.0 * f), "The valve sticks".into());
    Some(Friction { band, says, ..Friction::of(sticks, delta_aic, is_contested) })
}
