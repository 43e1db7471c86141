//! From a record to the search problem, by the same steps as `diagnose`.

use stictiond_numerics::diagnosis::search::Problem;
use stictiond_numerics::diagnosis::{Settings, gate, prepare, verdict};
use stictiond_numerics::signal::Record;

/// The problem of a record and the OP unit of its normalised OP; `None` where the gate or the excitation refuse.
pub fn pose(record: &Record) -> Option<(Problem, f64)> {
    let settings = Settings::default();
    let (window, mut preparation) = gate::gate(record, &settings).ok()?;
    let (window, region) = prepare::prepare(window, &settings, &mut preparation);
    let (problem, scale) = verdict::pose(&window, &region, &settings).ok()?;
    Some((problem, scale.u))
}
