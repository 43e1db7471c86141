//! Whether PV follows a stem or OP itself: the encompassing regression, in which both act side by side.
//!
//! ```text
//! y[k] = c + sum a_i y[k-i] + sum b_i p[k-i] + sum d_i u[k-i] + w[k]
//! ```
//!
//! `p` is the stem of the one-parameter element, `u` is OP. Where a valve sticks, PV follows the stem, and OP beside it adds little.
//! Where a load jumps in a sound loop, a stem predicts PV better than OP does as well, because it ignores what noise does to OP and
//! keeps what a jump does. But then PV follows OP inside the dead band, too: beside OP, `sum b_i` turns round, as if PV moved against
//! the stem.
//!
//! Source: Davidson & MacKinnon, Econometrica 1981, 49, 781; Mizon & Richard, Econometrica 1986, 54, 657.

use super::least_squares::{MOST_COLUMNS, dot, factor, substitute};
use std::ops::Range;

/// Lags of PV.
const LAGS_Y: usize = 8;
/// One-sided 5 % point of the normal distribution: with a smaller t PV moves against the stem.
pub const LEAST_T: f64 = -1.645;

/// The signals of the regression, one value a sample.
pub struct Encompassing<'a> {
    /// PV.
    pub y: &'a [f64],
    /// OP.
    pub u: &'a [f64],
    /// The stem of the one-parameter element (unit of OP).
    pub p: &'a [f64],
    /// What else acts on PV, as it enters the equation of its sample.
    pub extra: &'a [Vec<f64>],
    /// Lags of OP and of the stem.
    pub lags: usize,
    /// Samples that are fitted, from the longest lag on.
    pub rows: Range<usize>,
    /// Whether a sample counts.
    pub counts: &'a [bool],
}

impl Encompassing<'_> {
    /// t of the stem's summed coefficients beside OP's, positive in the direction in which PV follows the stem alone; 0 where
    /// there are too few samples.
    pub fn t_of_stem(&self) -> f64 {
        let known = 1 + LAGS_Y + self.extra.len();
        let first = self.rows.start.max(LAGS_Y.max(self.lags));
        let rows: Vec<usize> = (first..self.rows.end).filter(|k| self.counts[*k]).collect();
        let (alone, both) = (known + self.lags, known + 2 * self.lags);
        if both > MOST_COLUMNS || rows.len() <= both {
            return 0.0;
        }
        let column = |v: &[f64], lag: usize| -> Vec<f64> { rows.iter().map(|k| v[k - lag]).collect() };
        let lagged =
            |v: &[f64], lags: usize| -> Vec<Vec<f64>> { (1..=lags).map(|lag| column(v, lag)).collect() };
        let mut columns = vec![vec![1.0; rows.len()]];
        columns.extend(lagged(self.y, LAGS_Y));
        columns.extend(self.extra.iter().map(|extra| column(extra, 0)));
        columns.extend(lagged(self.p, self.lags));
        columns.extend(lagged(self.u, self.lags));
        let y = column(self.y, 0);
        let mut gram = vec![0.0; both * both];
        for (i, a) in columns.iter().enumerate() {
            for (j, b) in columns[..=i].iter().enumerate() {
                gram[i * both + j] = dot(a, b);
            }
        }
        let right: Vec<f64> = columns.iter().map(|column| dot(column, &y)).collect();
        let mut live = [true; MOST_COLUMNS];
        factor(&mut gram, both, both, &mut live);
        let solved = |mut right: Vec<f64>| {
            substitute(&gram, both, &live, &mut right);
            right
        };
        let of_stem = |v: &[f64]| v[known..alone].iter().sum::<f64>();
        // The factor of the first columns is the first block of the whole factor.
        let direction = of_stem(&solved(right[..alone].to_vec())).signum();
        let solution = solved(right.clone());
        // The variance of a sum v'θ is s² v' G^-1 v.
        let sums = (0..both).map(|i| f64::from(u8::from((known..alone).contains(&i)))).collect();
        let leverage = of_stem(&solved(sums));
        let rest = (dot(&y, &y) - dot(&right, &solution)).max(0.0) / (y.len() - both) as f64;
        let (sum, error) = (of_stem(&solution), (rest * leverage).sqrt());
        // A record without noise is explained to the last digit.
        direction * if error > 0.0 { sum / error } else { sum.signum() * f64::MAX }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sysid::valve::{Start, ValveModel};

    /// White noise of unit size without a library: sums of a linear congruential generator.
    fn noise(seed: u64) -> impl FnMut() -> f64 {
        let mut state = seed;
        move || {
            let mut sum = 0.0;
            for _ in 0..12 {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                sum += (state >> 11) as f64 / (1u64 << 53) as f64;
            }
            sum - 6.0
        }
    }

    /// A loop of a lag of ten samples and a PI controller; OP, PV.
    fn record(f: f64, load: impl Fn(usize) -> f64, seed: u64) -> (Vec<f64>, Vec<f64>) {
        let mut random = noise(seed);
        let (mut u, mut y) = (Vec::new(), Vec::new());
        let (mut x, mut force, mut level, mut integral, mut last) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for k in 0..1500 {
            let pv: f64 = level + 0.1 * random();
            integral -= 0.08 * pv;
            let op: f64 = integral - 0.8 * pv;
            let moved: f64 = force + op - last;
            (x, force) = if moved.abs() > f { (op, moved.signum() * f) } else { (x, moved) };
            last = op;
            level += 0.1 * (x + load(k) - level);
            u.push(op);
            y.push(pv);
        }
        (u, y)
    }

    fn t(f: f64, (u, y): (Vec<f64>, Vec<f64>)) -> f64 {
        let (mut z, mut dir) = (Vec::new(), Vec::new());
        let start = Start { index: 0, is_max: true };
        ValveModel::one_parameter(f).run(&u, start, u.len(), &mut z, &mut dir);
        let counts = vec![true; u.len()];
        Encompassing { y: &y, u: &u, p: &z, extra: &[], lags: 10, rows: 60..u.len(), counts: &counts }
            .t_of_stem()
    }

    #[test]
    fn pv_of_a_sticking_valve_follows_the_stem() {
        for seed in 1..6 {
            let found = t(0.5, record(0.5, |_| 2.0, seed));
            assert!(found > -LEAST_T, "seed {seed}: {found}");
        }
    }

    #[test]
    fn pv_of_a_sound_valve_does_not_follow_a_stem_however_its_load_jumps() {
        let pump = |k: usize| if k % 310 < 120 { 4.0 } else { 0.0 };
        for seed in 1..6 {
            let found = t(0.4, record(0.0, pump, seed));
            assert!(found < LEAST_T, "seed {seed}: {found}");
        }
    }

    #[test]
    fn a_record_that_is_too_short_says_nothing() {
        let (u, y) = record(1.5, |_| 2.0, 1);
        let counts = vec![true; u.len()];
        let short = Encompassing { y: &y, u: &u, p: &u, extra: &[], lags: 10, rows: 60..85, counts: &counts };
        assert_eq!(short.t_of_stem(), 0.0);
    }
}
