//! Simulated runs as records.

use stictiond_numerics::signal::{Record, Sample, Series};
use stictiond_numerics::sim::{Run, Scenario, SpecError};

/// Samples of a window: as many as the daemon diagnoses by default.
const WINDOW: usize = 1000;

/// The run as a collector would have recorded it: OP and PV, in % of span.
pub fn record(run: &Run) -> Record {
    let series = |v: &[f64]| -> Series { run.t.iter().zip(v).map(|(&t, &x)| Sample::good(t, x)).collect() };
    Record { op: series(&run.op), pv: series(&run.pv), op_span: Some(100.0), ..Record::default() }
}

/// The scenario's record after its transient.
pub fn simulated(scenario: &Scenario) -> Record {
    record(&scenario.run().expect("the scenarios are valid loops"))
}

/// The first window after the scenario's transient, however long the scenario runs.
pub fn window(mut scenario: Scenario) -> Result<Record, SpecError> {
    scenario.n = scenario.warm_up + WINDOW;
    Ok(record(&scenario.run()?))
}
