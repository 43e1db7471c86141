//! Outage values: values such as -9999 that a link, historian or logger writes in place of a measurement, with good quality.

use super::Sample;

/// Values from here on are no measurements: some exports write 1E+30 for none, and larger values would overflow sums.
pub const LARGEST_VALUE: f64 = 1e30;
/// Values that links, historians and loggers write in place of a measurement.
const OUTAGES: [f64; 14] = [
    0.0,
    -1.0,
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
/// Least distance of the tag's other values from an outage value, in spreads of the tag; from zero one spread is enough.
const FAR: f64 = 10.0;
/// Fewest equal samples in a row that are a stay of OP at a limit. Outage values, and extremes that a coarse resolution repeats, are
/// usually shorter.
pub const AT_LIMIT: usize = 5;

/// The limits between which the controller keeps OP, and the end of the record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// The lower and the upper limit (OP unit).
    pub range: (f64, f64),
    /// End of the record (s).
    pub end: f64,
}

/// The outage values among good samples: values of the known list that are at most half of the samples, and far from all others. Of a
/// tag that otherwise stands still only zero can be one. [`are_measured`] then tells the samples apart.
pub fn outages(samples: &[Sample]) -> Vec<f64> {
    let times = |value: f64| samples.iter().filter(|s| s.value == value).count();
    let few = |value: f64| (1..=samples.len() / 2).contains(&times(value));
    let candidates: Vec<f64> = OUTAGES.into_iter().filter(|value| few(*value)).collect();
    if candidates.is_empty() {
        return candidates;
    }
    // All candidates are left out of the others, so that two outage values do not hide each other.
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

/// Which of the good samples of a tag are measurements.
///
/// An outage value is a measurement where it is a limit of OP and OP stays there: an OP that shuts the valve is zero, too. A stay has
/// [`AT_LIMIT`] equal samples in a row, or lasts as long as so many where the source sends changes only.
///
/// * `samples`: the good samples, in order of time.
/// * `none`: the outage values of the tag.
/// * `limits`: the limits of OP, where the tag is OP and they are known.
/// * `lost`: times at which the tag was not good, in order (s): a value lasts no longer than until the next of them.
pub fn are_measured(samples: &[Sample], none: &[f64], limits: Option<Limits>, lost: &[f64]) -> Vec<bool> {
    let is_none = |s: &Sample| none.contains(&s.value);
    let Some(limits) = limits.filter(|_| !none.is_empty()) else {
        return samples.iter().map(|s| !is_none(s)).collect();
    };
    let repeats = |w: &[Sample]| w[0].value == w[1].value && !is_none(&w[0]) && w[0].t < w[1].t;
    let by_changes = !samples.windows(2).any(repeats);
    let intervals: Vec<f64> = samples.windows(2).map(|w| w[1].t - w[0].t).collect();
    let least_s = AT_LIMIT as f64 * quantile(&intervals, 0.5);
    let mut out = Vec::with_capacity(samples.len());
    for run in samples.chunk_by(|a, b| a.value == b.value) {
        let (first, last) = (run[0], run[run.len() - 1]);
        let after = samples.get(out.len() + run.len()).map_or(limits.end, |s| s.t);
        let lost_at = lost.get(lost.partition_point(|t| *t <= last.t));
        let until = lost_at.map_or(after, |t| t.min(after));
        let stays = run.len() >= AT_LIMIT || by_changes && until - first.t >= least_s;
        let is_measured = !is_none(&first) || stays && is_limit(Some(limits.range), first.value);
        out.resize(out.len() + run.len(), is_measured);
    }
    out
}

/// Whether a value is one of the limits of a tag.
pub fn is_limit(limits: Option<(f64, f64)>, value: f64) -> bool {
    limits.is_some_and(|(low, high)| value == low || value == high)
}

/// The q-quantile (0..1), interpolated between order statistics.
pub fn quantile(v: &[f64], q: f64) -> f64 {
    if v.is_empty() {
        return 0.0;
    }
    let at = q.clamp(0.0, 1.0) * (v.len() - 1) as f64;
    let (place, part) = (at.floor() as usize, at.fract());
    let mut own = v.to_vec();
    let (_, &mut low, above) = own.select_nth_unstable_by(place, f64::total_cmp);
    let high = above.iter().copied().min_by(f64::total_cmp).unwrap_or(low);
    low + part * (high - low)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Which samples are measurements where OP is kept between 0 and 100 %.
    fn kept(samples: &[Sample], lost: &[f64]) -> Vec<bool> {
        let end = samples.last().map_or(0.0, |last| last.t);
        are_measured(samples, &outages(samples), Some(Limits { range: (0.0, 100.0), end }), lost)
    }

    #[test]
    fn a_value_at_a_known_limit_is_a_measurement_where_op_stays_there() {
        // An OP that is shut for 40 % of the time and else between 40 and 60 %.
        let op: Vec<Sample> = (0..500)
            .map(|k| {
                let moves = 50.0 + 10.0 * (0.1 * k as f64).sin();
                Sample::good(k as f64, if k % 100 < 40 { 0.0 } else { moves })
            })
            .collect();
        assert_eq!(outages(&op), [0.0]);
        assert_eq!(kept(&op, &[]), [true; 500]);
        let others = Limits { range: (5.0, 95.0), end: 499.0 };
        let by = |limits| are_measured(&op, &[0.0], limits, &[]).iter().filter(|is| **is).count();
        assert_eq!((by(Some(others)), by(None)), (300, 300));
        // Zeros that are alone, and what stands for no measurement, are none beside it.
        let mut flawed = op.clone();
        let none = [(50, 0.0), (60, 0.0), (61, 0.0), (62, 0.0), (63, 0.0), (70, -9999.0)];
        none.iter().for_each(|(at, value)| flawed[*at].value = *value);
        let gone = |kept: Vec<bool>| (0..kept.len()).filter(|k| !kept[*k]).collect::<Vec<usize>>();
        assert_eq!(gone(kept(&flawed, &[])), none.map(|own| own.0));
    }

    #[test]
    fn of_changes_a_limit_is_a_measurement_where_it_lasts() {
        // Every value is another one than before; shut from 100 to 400 s, for which one zero is sent.
        let moves = |t: f64| 50.0 + 10.0 * (0.0123 * t * t).sin();
        let mut op: Vec<Sample> = (0..600).map(f64::from).map(|t| Sample::good(t, moves(t))).collect();
        op[100].value = 0.0;
        op[450].value = 0.0;
        op.drain(101..400);
        let zeros = |kept: Vec<bool>| [100, op.len() - 150].map(|at| (op[at].value, kept[at]));
        assert_eq!(zeros(kept(&op, &[])), [(0.0, true), (0.0, false)]);
        // It does not stand beyond a sample that is not good.
        assert_eq!(zeros(kept(&op, &[103.0])), [(0.0, false), (0.0, false)]);
        assert_eq!(zeros(kept(&op, &[50.0, 106.0])), [(0.0, true), (0.0, false)]);
        // The last one stands until the record ends.
        let last = &op[..101];
        let at = |end| {
            let limits = Limits { range: (0.0, 100.0), end };
            are_measured(last, &[0.0], Some(limits), &[])[100]
        };
        assert_eq!((at(100.0), at(104.0), at(105.0)), (false, false, true));
    }
}
