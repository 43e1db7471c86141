//! The samples of one tag in the order of time, without those that are no measurements.

use crate::diagnosis::not_identifiable::NotIdentifiable;
use crate::diagnosis::preparation::Preparation;
use crate::signal::{LARGEST_VALUE, Limits, Quality, Sample, are_measured, outages};

/// The good samples of one tag, and how many there were of which kind.
pub struct Clean {
    /// The samples that are kept, in the order of time; no stamp twice.
    pub kept: Vec<Sample>,
    /// Number of good samples, repeated stamps included.
    good: usize,
    /// Number of all samples.
    offered: usize,
    /// Number of stale samples.
    stale: usize,
    /// Number of samples whose value is too large to compute with.
    too_large: usize,
}

/// The meaning of a zero that is far from the other values of a tag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Zero {
    /// A lost signal, for OP, PV and the stem.
    DropOut,
    /// A value like any other: a set point may be zero for a while, and a pump is on or off.
    Value,
}

/// Sorts the samples of a tag, removes repeated stamps, and drops samples that are no measurements.
///
/// * `limits`: the limits of OP, for OP and the stem: at a limit a zero may be a value.
/// * `preparation`: receives the numbers of repeated stamps and of samples out of order.
pub fn clean(series: &[Sample], zero: Zero, limits: Option<Limits>, preparation: &mut Preparation) -> Clean {
    let mut kept: Vec<Sample> = series.iter().filter(|s| is_usable(s)).copied().collect();
    let disorder = kept.windows(2).filter(|w| w[1].t < w[0].t).count();
    if disorder > 0 {
        kept.sort_by(|a, b| a.t.total_cmp(&b.t));
    }
    let before = kept.len();
    kept.dedup_by(|later, earlier| later.t == earlier.t);
    preparation.out_of_order += disorder;
    preparation.duplicates += before - kept.len();
    drop_outages(&mut kept, series, zero, limits);
    Clean {
        kept,
        good: before,
        offered: series.len(),
        stale: series.iter().filter(|s| s.quality == Quality::Stale).count(),
        too_large: series.iter().filter(|s| s.value.abs() >= LARGEST_VALUE).count(),
    }
}

fn is_usable(s: &Sample) -> bool {
    s.quality.is_good() && s.t.is_finite() && s.value.is_finite() && s.value.abs() < LARGEST_VALUE
}

/// Drops the values that loggers write where nothing was measured.
fn drop_outages(kept: &mut Vec<Sample>, series: &[Sample], zero: Zero, limits: Option<Limits>) {
    let mut outages = outages(kept);
    outages.retain(|value| zero == Zero::DropOut || *value != 0.0);
    if outages.is_empty() {
        return;
    }
    let lost = series.iter().filter(|s| !is_usable(s) && s.t.is_finite());
    let mut lost: Vec<f64> = lost.map(|s| s.t).collect();
    lost.sort_by(f64::total_cmp);
    let mut are_measured = are_measured(kept, &outages, limits, &lost).into_iter();
    kept.retain(|_| are_measured.next().unwrap_or(false));
}

/// The share of missing samples (0..1) at a sample period of `ts` (s).
pub fn missing_share(kept: &[Sample], ts: f64) -> f64 {
    let (Some(first), Some(last)) = (kept.first(), kept.last()) else { return 1.0 };
    let asked = (last.t - first.t) / ts + 1.0;
    (1.0 - kept.len() as f64 / asked).clamp(0.0, 1.0)
}

/// The reason why only `n` good samples are left, where `need` are needed.
pub fn shortage(op: &Clean, pv: &Clean, n: usize, need: usize) -> NotIdentifiable {
    let worst = if op.kept.len() < pv.kept.len() { op } else { pv };
    if worst.offered < need {
        return NotIdentifiable::TooShort { n, need };
    }
    if pv.stale * 2 > pv.offered {
        return NotIdentifiable::FlatPv;
    }
    if worst.too_large * 2 > worst.offered {
        return NotIdentifiable::OutOfScale;
    }
    // Of good samples with one stamp a single one is left.
    if worst.kept.len() <= 1 && worst.good * 2 > worst.offered {
        return NotIdentifiable::NoTimeBase;
    }
    NotIdentifiable::Gaps { share: 1.0 - worst.kept.len() as f64 / worst.offered as f64 }
}
