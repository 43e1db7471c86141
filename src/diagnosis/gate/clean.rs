//! One tag's samples in the order of time, freed of what is no measurement.

use crate::diagnosis::{NotIdentifiable, Preparation};
use crate::signal::{LARGEST_VALUE, Limits, Quality, Sample, are_measured, outages};

/// One tag's good samples in order of time.
pub struct Clean {
    /// Those that are kept.
    pub kept: Vec<Sample>,
    /// Before those with the same stamp were taken for one.
    good: usize,
    offered: usize,
    stale: usize,
    too_large: usize,
}

/// What a zero far from a tag's other values is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Zero {
    /// No measurement: that of a signal which was lost, as OP, PV and the stem are.
    DropOut,
    /// A value like any other: a set point may be zero for a while, and a pump is on or off.
    Value,
}

/// Sorts, de-duplicates and drops what is not good; `limits`: those of OP, for a tag that has them.
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

/// Drops from the usable samples of a series what is written where nothing was measured.
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

/// The share of the samples that a period of `ts` asks for and that are not there.
pub fn missing_share(kept: &[Sample], ts: f64) -> f64 {
    let (Some(first), Some(last)) = (kept.first(), kept.last()) else { return 1.0 };
    let asked = (last.t - first.t) / ts + 1.0;
    (1.0 - kept.len() as f64 / asked).clamp(0.0, 1.0)
}

/// Why too few good samples are left.
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
    // Good samples whose stamps all coincide leave one after de-duplication.
    if worst.kept.len() <= 1 && worst.good * 2 > worst.offered {
        return NotIdentifiable::NoTimeBase;
    }
    NotIdentifiable::Gaps { share: 1.0 - worst.kept.len() as f64 / worst.offered as f64 }
}
