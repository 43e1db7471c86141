//! Straight lines that an archive drew between the samples that it kept.
//!
//! A compressing archive keeps some samples, and an export draws lines between them at every row. What is on a line between its
//! two ends was not measured. It is smoother than PV, and bends at its ends only. Such lines make a sound valve look stuck.
//!
//! Three things tell such lines from measurements:
//!
//! * The samples are on the line to the last digit of the record: their distances from it are those of rounding alone. Measured
//!   values have noise, and a curve bends away from its chord.
//! * The lines end sharply. A curve that is rounded to coarse digits has chords, too, but they hardly turn at their ends.
//! * The controller did not compute OP from them. A tank without noise fills on straight lines while the valve is stuck, and the
//!   ramps of a set point are straight. OP follows from such lines by the controller's equation.

use super::acquisition::computed::is_computed;
use super::acquisition::lattice::period as sample_period;
use crate::signal::Sample;
use crate::sysid::stats::median;

/// Fewest lines of an archive: a ramp or two make fewer.
const LINES: usize = 12;
/// Least share of samples on such lines. By chance one sample in six is on one: the turn of [`SHARP`] spreads the values over
/// seventeen, and three of these put a sample on the line through its neighbours.
const STRAIGHT: f64 = 0.25;
/// Least turn at the end of a line: its length times the change of slope (units of the values). An arc is a unit off its chord where
/// curvature times length squared is 8, and its chords turn by as much. Rounding can double the distance, and so the turn.
const SHARP: f64 = 16.0;
/// Least rise of a line (units of the values): the ends of a flat line differ by up to two units by rounding.
const RISES: f64 = 3.0;
/// Variance of rounding (squared units), and that of its square as a multiple of its own square.
const ROUNDING: [f64; 2] = [1.0 / 12.0, 0.8];
/// Number of standard errors by which the variance about the lines may exceed that of rounding: one chance in thirty thousand.
const SIGNIFICANT: f64 = 4.0;
/// Least share of lines after which the direction stays, where OP does not tell whether they were drawn: a triangle turns at every
/// end.
const STRAIGHT_ON: f64 = 0.2;
/// Tolerance of a distance of one unit (units).
const ONE: f64 = 1.01;
/// Rounding of values that are not printed with few digits, as a share of the usual step.
const FINE: f64 = 1e-6;
/// Rounding of the distance of a single-precision value from a chord of two others, as a share of the largest value: at most two
/// halves of its last digit, 2^-23 each.
const SINGLE: f64 = 2.4e-7;
/// Most rows for each sample, with which a controller's equation is asked: more would not be measured.
const MOST_ROWS: usize = 4;
/// Largest distance in time of OP from PV of one row, as a share of the sample period.
const SAME_ROW: f64 = 0.25;

/// The straight lines in a series.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Lines {
    /// Number of lines of three samples and more that rise and end sharply.
    pub count: usize,
    /// Share of samples inside such lines (0..1).
    pub share: f64,
    /// Number of such lines after which the direction stays.
    straight_on: usize,
    /// Number of samples inside such lines, each with a degree of freedom that the lines leave.
    inside: usize,
    /// Rounding of the values.
    unit: f64,
    /// Variance about such lines (squared units); 0 where the values are not printed with few digits: then they are on lines exactly.
    variance: f64,
    /// Sample period (s).
    period: f64,
    /// Row of each sample.
    rows: Vec<usize>,
    /// First and last sample of each line; every sample but the first ends one, also one of two samples.
    ends: Vec<(usize, usize)>,
}

impl Lines {
    /// The lines in samples in the order of time; `None` where they stand still, or have no sample period.
    pub fn of(series: &[Sample]) -> Option<Self> {
        let values: Vec<f64> = series.iter().map(|s| s.value).collect();
        let period = sample_period(series)?;
        let times: Vec<f64> = series.iter().map(|s| (s.t - series[0].t) / period).collect();
        let (unit, is_printed) = rounding(&values)?;
        let rows = times.iter().map(|row| row.round() as usize).collect();
        let ends = chords(&times, &values, ONE * unit);
        let mut lines = Self { unit, period, rows, ends, ..Self::default() };
        let mut squares = 0.0;
        for pair in lines.ends.windows(2) {
            let slope = |(a, b): (usize, usize)| (values[b] - values[a]) / (times[b] - times[a]);
            let (a, b) = pair[0];
            let (own, next) = (slope(pair[0]), slope(pair[1]));
            let turn = (next - own).abs() * (times[b] - times[a]);
            if b - a >= 2 && (values[b] - values[a]).abs() > RISES * unit && turn > SHARP * unit {
                lines.count += 1;
                lines.inside += b - a - 1;
                lines.straight_on += usize::from(own * next > 0.0);
                squares += about_line(&times[a..=b], &values[a..=b]);
            }
        }
        lines.share = lines.inside as f64 / values.len() as f64;
        if is_printed {
            lines.variance = squares / (lines.inside.max(1) as f64 * unit * unit);
        }
        Some(lines)
    }

    /// Whether they look drawn: there are many, with many samples, that are off them by rounding alone.
    pub fn look_drawn(&self) -> bool {
        let [variance, of_square] = ROUNDING;
        let most = variance * (1.0 + SIGNIFICANT * (of_square / self.inside.max(1) as f64).sqrt());
        self.count >= LINES && self.share >= STRAIGHT && self.variance <= most
    }

    /// Whether the values were drawn and not measured. Where OP was computed from them, they are measurements.
    ///
    /// * `pv`: the samples that the lines are of.
    /// * `op`: samples in the order of time.
    /// * `set_point`: samples, where it is recorded.
    pub fn are_drawn(&self, op: &[Sample], pv: &[Sample], set_point: Option<&[Sample]>) -> bool {
        // Nearly every record ends here, so OP is looked at only behind it.
        if !self.look_drawn() {
            return false;
        }
        let near = SAME_ROW * self.period;
        let op = at_stamps(op, pv, |s, t| (s.t - t).abs() <= near, near);
        // An export has both tags at every row. Tags that were read apart are told as such.
        let has_both = 2 * op.iter().flatten().count() > pv.len();
        let goes_on = self.straight_on as f64 >= STRAIGHT_ON * self.count as f64;
        has_both && !self.are_computed_from(&op, pv, set_point).unwrap_or(!goes_on)
    }

    /// Whether the controller computed OP from the values; `None` where it does not tell.
    ///
    /// * `op`: one value for each sample of PV; `None` where it was not read beside it.
    fn are_computed_from(
        &self,
        op: &[Option<f64>],
        pv: &[Sample],
        set_point: Option<&[Sample]>,
    ) -> Option<bool> {
        let n = self.rows.last()?.saturating_add(1);
        if n > MOST_ROWS * pv.len() {
            return None;
        }
        let on_rows = |values: &[Option<f64>]| -> Vec<Option<f64>> {
            let mut out = vec![None; n];
            for (row, value) in self.rows.iter().zip(values) {
                if let Some(slot) = out.get_mut(*row) {
                    *slot = *value;
                }
            }
            out
        };
        let is_good = |s: &&Sample| s.quality.is_good() && s.t.is_finite() && s.value.is_finite();
        let mut good: Vec<Sample> = set_point.unwrap_or_default().iter().filter(is_good).copied().collect();
        good.sort_by(|a, b| a.t.total_cmp(&b.t));
        let set_point =
            (!good.is_empty()).then(|| on_rows(&at_stamps(&good, pv, |_, _| true, SAME_ROW * self.period)));
        let pv: Vec<Option<f64>> = pv.iter().map(|s| Some(s.value)).collect();
        let (op_rows, pv_rows) = (on_rows(op), on_rows(&pv));
        let op: Vec<f64> = op.iter().copied().flatten().collect();
        let units = [rounding(&op).map_or(0.0, |(unit, _)| unit), self.unit];
        // From an end of a line to its middle what was drawn is furthest from what was measured.
        let lengths: Vec<f64> =
            self.ends.iter().filter(|(a, b)| b - a >= 2).map(|(a, b)| (b - a) as f64).collect();
        let most = (0.5 * median(&lengths)) as usize;
        // Where rows are missing, only shorter spans may be whole.
        let mut spans =
            std::iter::successors(Some(most.max(1)), |span| Some(span / 2)).take_while(|span| *span > 0);
        spans.find_map(|span| is_computed(&op_rows, &pv_rows, set_point.as_deref(), span, units))
    }

    /// The samples at the ends of lines: what is between them was not measured.
    ///
    /// * `series`: the samples that the lines are of.
    pub fn measured(&self, series: &[Sample]) -> Vec<Sample> {
        let first = series.first().copied();
        let ends = self.ends.iter().filter_map(|(_, end)| series.get(*end)).copied();
        first.into_iter().chain(ends).collect()
    }
}

/// The last sample at or before each stamp of PV, or a little after it, where it passes; else `None`.
///
/// * `passes`: of a sample and the stamp.
/// * `after`: how much later than PV a sample may be (s).
fn at_stamps(
    series: &[Sample],
    pv: &[Sample],
    passes: impl Fn(&Sample, f64) -> bool,
    after: f64,
) -> Vec<Option<f64>> {
    let mut at = 0;
    let value = |own: &Sample| {
        while at < series.len() && series[at].t <= own.t + after {
            at += 1;
        }
        at.checked_sub(1).map(|last| series[last]).filter(|s| passes(s, own.t)).map(|s| s.value)
    };
    pv.iter().map(value).collect()
}

/// Chords, each as long as all of its values are at most `tolerance` off it: first and last index. Each begins where the one before
/// it ends.
fn chords(times: &[f64], values: &[f64], tolerance: f64) -> Vec<(usize, usize)> {
    let mut found = Vec::new();
    let mut a = 0;
    while a + 1 < values.len() {
        let (mut b, mut least, mut most) = (a + 1, f64::NEG_INFINITY, f64::INFINITY);
        while b + 1 < values.len() {
            // The slopes of the chords that pass the value at `b`, and that of the chord to the next one.
            let width = times[b] - times[a];
            least = least.max((values[b] - tolerance - values[a]) / width);
            most = most.min((values[b] + tolerance - values[a]) / width);
            let next = (values[b + 1] - values[a]) / (times[b + 1] - times[a]);
            if !(least..=most).contains(&next) {
                break;
            }
            b += 1;
        }
        found.push((a, b));
        a = b;
    }
    found
}

/// The sum of squares about the straight line of least squares.
fn about_line(times: &[f64], values: &[f64]) -> f64 {
    let n = times.len() as f64;
    let (t0, v0) = (times.iter().sum::<f64>() / n, values.iter().sum::<f64>() / n);
    let (mut tt, mut tv, mut vv) = (0.0, 0.0, 0.0);
    for (t, v) in times.iter().zip(values) {
        tt += (t - t0).powi(2);
        tv += (t - t0) * (v - v0);
        vv += (v - v0).powi(2);
    }
    (vv - tv * tv / tt).max(0.0)
}

/// The rounding of values, and whether they are printed with so few digits that it shows; `None` where they stand still.
fn rounding(values: &[f64]) -> Option<(f64, bool)> {
    let steps: Vec<f64> = values.windows(2).map(|w| (w[1] - w[0]).abs()).filter(|d| *d > 0.0).collect();
    let scale = median(&steps);
    if scale.is_nan() || scale <= 0.0 {
        return None;
    }
    let largest = values.iter().fold(0.0_f64, |largest, v| largest.max(v.abs()));
    let digits = printed(values);
    Some((digits.unwrap_or_else(|| (FINE * scale).max(SINGLE * largest)), digits.is_some()))
}

/// The largest unit of which all differences between values are whole multiples, where there is one: the resolution to which the
/// values were once rounded, in the present unit.
fn printed(values: &[f64]) -> Option<f64> {
    /// Least unit, as a share of the range of the values: a finer one is that of floating point.
    const FINEST: f64 = 1e-7;
    /// Largest distance of a value from a whole number of units: a change of unit leaves such rounding.
    const OFF: f64 = 1e-2;
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let (first, last) = (*sorted.first()?, *sorted.last()?);
    let least = FINEST * (last - first);
    // Euclid's algorithm on the gaps, for numbers that are nearly whole.
    let gaps = sorted.windows(2).map(|w| w[1] - w[0]).filter(|gap| *gap > least);
    let unit = gaps.fold(0.0_f64, |unit, gap| {
        let (mut a, mut b) = (unit.max(gap), unit.min(gap));
        while b > least {
            (a, b) = (b, (a - b * (a / b).round()).abs());
        }
        a
    });
    let whole = |v: &f64| (((v - first) / unit).round() - (v - first) / unit).abs() < OFF;
    (unit > 10.0 * least && sorted.iter().all(whole)).then_some(unit)
}

#[cfg(test)]
mod tests;
