//! The rules that refuse a complete window: gaps, flat OP, flat or frozen PV, OP at a limit. Rows at a limit do not count.

use crate::diagnosis::not_identifiable::NotIdentifiable;
use crate::diagnosis::preparation::Preparation;
use crate::diagnosis::settings::Settings;
use crate::signal::{AT_LIMIT, Record, Row, Window};
use crate::sysid::stats::range;

/// Share of samples at a limit of OP above which only the samples between the limits count: a few do no harm.
const SATURATED_SHARE: f64 = 0.3;
/// Largest share of the window with one unchanging value of PV: above it less than half is left to judge.
const FROZEN_SHARE: f64 = 0.5;

/// The reason why a window says nothing about the valve; `None` where it passes.
///
/// Where OP is at a limit for much of the window, the rows there become [`Row::Silent`].
pub fn refuse(
    w: &mut Window,
    record: &Record,
    settings: &Settings,
    p: &Preparation,
) -> Option<NotIdentifiable> {
    let too_few = w.counted() < settings.min_samples;
    if p.gap_share > settings.max_gap_share || too_few {
        return Some(NotIdentifiable::Gaps { share: p.gap_share });
    }
    let at_limit = at_limits(&w.op, record.op_limits);
    let share = at_limit.iter().filter(|at| **at).count() as f64 / w.len().max(1) as f64;
    let saturated = NotIdentifiable::Saturated { share };
    // An OP that is always at its limit is flat as well; the limit says more.
    if is_flat(&w.op) {
        let known = record.op_limits.is_some() && share > SATURATED_SHARE;
        return Some(if known { saturated } else { NotIdentifiable::FlatOp });
    }
    if is_flat(&w.pv) || longest_constant_run(&w.pv) as f64 > FROZEN_SHARE * w.len() as f64 {
        return Some(NotIdentifiable::FlatPv);
    }
    if share <= SATURATED_SHARE {
        return None;
    }
    w.rows.resize(w.op.len(), Row::Counts);
    let silent = w.rows.iter_mut().zip(&at_limit).filter(|(row, at)| **at && **row == Row::Counts);
    silent.for_each(|(row, _)| *row = Row::Silent);
    (w.counted() < settings.min_samples).then_some(saturated)
}

/// Whether the values differ by no more than rounding.
fn is_flat(v: &[f64]) -> bool {
    let (low, high) = range(v);
    high - low <= 1e-9 * low.abs().max(high.abs())
}

/// Length of the longest run of one unchanging value.
fn longest_constant_run(v: &[f64]) -> usize {
    v.chunk_by(|a, b| a == b).map(<[f64]>::len).max().unwrap_or(0)
}

/// Whether OP is at an output limit, for each sample: at the given limits, or else in flat stretches at the extremes of the record.
fn at_limits(op: &[f64], limits: Option<(f64, f64)>) -> Vec<bool> {
    if let Some((low, high)) = limits {
        let margin = 1e-3 * (high - low).abs();
        return op.iter().map(|u| *u <= low + margin || *u >= high - margin).collect();
    }
    let (low, high) = range(op);
    let margin = 1e-6 * (high - low);
    let at = |u: f64| u <= low + margin || u >= high - margin;
    let runs = op.chunk_by(|a, b| at(*a) && at(*b) && (a - b).abs() <= margin);
    runs.flat_map(|run| std::iter::repeat_n(run.len() >= AT_LIMIT, run.len())).collect()
}
