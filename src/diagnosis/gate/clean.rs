//! One tag's samples in the order of time, freed of what is no measurement.

use crate::diagnosis::{NotIdentifiable, Preparation};
use crate::signal::{Quality, Sample};
use crate::sysid::stats::quantile;

/// Values of this and beyond are no measurement: 1E+30 stands for none in some exports, and more would overflow the sums.
const LARGEST_VALUE: f64 = 1e30;

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

/// Sorts, de-duplicates and drops what is not good.
pub fn clean(series: &[Sample], preparation: &mut Preparation) -> Clean {
    let usable = |s: &&Sample| {
        s.quality.is_good() && s.t.is_finite() && s.value.is_finite() && s.value.abs() < LARGEST_VALUE
    };
    let mut kept: Vec<Sample> = series.iter().filter(usable).copied().collect();
    let disorder = kept.windows(2).filter(|w| w[1].t < w[0].t).count();
    if disorder > 0 {
        kept.sort_by(|a, b| a.t.total_cmp(&b.t));
    }
    let before = kept.len();
    kept.dedup_by(|later, earlier| later.t == earlier.t);
    preparation.out_of_order += disorder;
    preparation.duplicates += before - kept.len();
    drop_outages(&mut kept);
    Clean {
        kept,
        good: before,
        offered: series.len(),
        stale: series.iter().filter(|s| s.quality == Quality::Stale).count(),
        too_large: series.iter().filter(|s| s.value.abs() >= LARGEST_VALUE).count(),
    }
}

/// Drops what is written where nothing was measured.
fn drop_outages(kept: &mut Vec<Sample>) {
    let outages = outages(kept);
    if !outages.is_empty() {
        kept.retain(|s| !outages.contains(&s.value));
    }
}

/// Values that links, historians and loggers write where nothing was measured.
const OUTAGES: [f64; 13] = [
    0.0,
    -99.0,
    -999.0,
    -999.25,
    -9999.0,
    -99_999.0,
    999.0,
    9999.0,
    99_999.0,
    -32_768.0,
    32_767.0,
    65_535.0,
    4_294_967_295.0,
];
/// How many times further than it spreads a tag lives from such a value; from zero it is once.
const FAR: f64 = 10.0;

/// Which of these values are no measurements among good samples: the tag lives far from them otherwise. A tag that stands still
/// lives far from nothing but zero.
pub fn outages(samples: &[Sample]) -> Vec<f64> {
    let times = |value: f64| samples.iter().filter(|s| s.value == value).count();
    let few = |value: &f64| (1..=samples.len() / 2).contains(&times(*value));
    let candidates: Vec<f64> = OUTAGES.into_iter().filter(few).collect();
    if candidates.is_empty() {
        return candidates;
    }
    // None of them is among the others, so that two kinds do not hide each other.
    let others: Vec<f64> = samples.iter().map(|s| s.value).filter(|v| !candidates.contains(v)).collect();
    if others.is_empty() {
        return Vec::new();
    }
    let (low, high) = (quantile(&others, 0.02), quantile(&others, 0.98));
    let spread = high - low;
    let far = |value: &f64| {
        let away = (low - value).max(value - high);
        if *value == 0.0 { away > spread } else { spread > 0.0 && away > FAR * spread }
    };
    candidates.into_iter().filter(far).collect()
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
