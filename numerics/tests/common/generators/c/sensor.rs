//! What may be wrong with PV's measurement, and the record as the recorder writes it.

use stictiond_numerics::signal::{Record, Sample, Series};

use super::plan::Plan;
use super::run::{RUN_OUT, Signals, Trace, WARM_UP};

/// Range of the transmitter (PV).
const RANGE: (f64, f64) = (0.0, 100.0);

/// A fault of PV's measurement; one value per scan where it changes.
#[derive(Clone, Debug)]
pub enum Fault {
    /// None.
    None,
    /// PV moves in steps.
    Quantised {
        /// Their height (PV).
        step: f64,
        /// Where the first lies (PV).
        offset: f64,
    },
    /// What single samples are off by (PV); 0 for the others.
    Outliers(Vec<f64>),
    /// Where PV stands still.
    Frozen(Vec<bool>),
    /// PV's delay by its stamp (samples); it counts from the record's start.
    Skew(Vec<isize>),
}

impl Fault {
    /// PV at scan `k` as it leaves the transmitter; `last` is the value before.
    pub fn apply(&self, k: usize, pv: f64, last: f64) -> f64 {
        match self {
            Self::None | Self::Skew(_) => pv,
            Self::Quantised { step, offset } => ((pv - offset) / step).round() * step + offset,
            Self::Outliers(off) => (pv + off[k]).clamp(RANGE.0, RANGE.1),
            Self::Frozen(still) => {
                if still[k] {
                    last
                } else {
                    pv
                }
            }
        }
    }
}

/// PV as recorded, with what the controller did not see.
pub fn recorded_pv(signals: &Signals, trace: &Trace) -> Vec<f64> {
    if let Fault::Skew(delay) = &signals.fault {
        return delay
            .iter()
            .enumerate()
            .map(|(k, &delay)| {
                let at = (WARM_UP + k) as isize - delay;
                trace.pv[at.clamp(0, trace.pv.len() as isize - 1) as usize]
            })
            .collect();
    }
    if signals.seen {
        return Trace::recorded(&trace.pv).to_vec();
    }
    let mut last = trace.pv[WARM_UP - 1];
    (WARM_UP..trace.pv.len() - RUN_OUT)
        .map(|k| {
            last = signals.fault.apply(k, trace.pv[k], last);
            last
        })
        .collect()
}

/// The record of a run.
pub fn record(plan: &Plan, signals: &Signals, trace: &Trace, tags: Vec<(String, Vec<f64>)>) -> Record {
    let series = |values: &[f64]| -> Series {
        values.iter().enumerate().map(|(k, &value)| Sample::good(k as f64 * plan.period, value)).collect()
    };
    Record {
        op: series(Trace::recorded(&trace.op)),
        pv: series(&recorded_pv(signals, trace)),
        sp: Some(series(Trace::recorded(&trace.sp))),
        tags: tags.into_iter().map(|(name, values)| (name, series(&values))).collect(),
        op_span: Some(100.0),
        ..Record::default()
    }
}
