//! Ordinary least squares, with the t value of a sum of coefficients.
//!
//! ```text
//! theta = G^-1 r,   G = X'X, r = X'y
//! t = v'theta / (s sqrt(v' G^-1 v)),   s^2 = |y - X theta|^2 / (n - p)
//! ```
//!
//! Source: Ljung, System Identification, 1999, appendix II.

use super::least_squares::{MOST_COLUMNS, dot, factor, substitute};
use std::ops::Range;

/// The regressions of `y` on the first n of some columns, for every n.
///
/// One Cholesky factor serves them all: the factor of the first columns is the first block of the whole factor.
pub struct Ols {
    /// Cholesky factor of `X'X`.
    gram: Vec<f64>,
    /// `X'y`.
    right: Vec<f64>,
    /// Which columns do not depend on those before them.
    live: [bool; MOST_COLUMNS],
    /// `y'y`.
    power: f64,
    rows: usize,
}

impl Ols {
    /// Factors `X'X` of the columns; `None` with more than [`MOST_COLUMNS`] columns, or with no more rows than columns.
    pub fn new(columns: &[Vec<f64>], y: &[f64]) -> Option<Self> {
        let p = columns.len();
        if p > MOST_COLUMNS || y.len() <= p {
            return None;
        }
        let mut gram = vec![0.0; p * p];
        for (i, a) in columns.iter().enumerate() {
            for (j, b) in columns[..=i].iter().enumerate() {
                gram[i * p + j] = dot(a, b);
            }
        }
        let right = columns.iter().map(|column| dot(column, y)).collect();
        let mut live = [true; MOST_COLUMNS];
        factor(&mut gram, p, p, &mut live);
        Some(Self { gram, right, live, power: dot(y, y), rows: y.len() })
    }

    /// `G^-1 right`, of as many columns as `right` has.
    fn solved(&self, mut right: Vec<f64>) -> Vec<f64> {
        substitute(&self.gram, self.right.len(), &self.live, &mut right);
        right
    }

    /// The coefficients of the first `n` columns.
    pub fn theta(&self, n: usize) -> Vec<f64> {
        self.solved(self.right[..n].to_vec())
    }

    /// The sum of squares of the residual with the first `n` columns.
    pub fn rest(&self, n: usize) -> f64 {
        let right = &self.right[..n];
        (self.power - dot(right, &self.theta(n))).max(0.0)
    }

    /// t of the sum of the coefficients of the columns `of`, in the regression on the first `n` columns (-).
    ///
    /// It is 0 where all of them depend on columns before them, and ±`f64::MAX` where the residual is 0.
    pub fn t(&self, n: usize, of: Range<usize>) -> f64 {
        let sum_of = |v: &[f64]| v[of.clone()].iter().sum::<f64>();
        let sum = sum_of(&self.theta(n));
        let ones = (0..n).map(|i| f64::from(u8::from(of.contains(&i)))).collect();
        let leverage = sum_of(&self.solved(ones));
        // Columns that depend on those before them have no coefficients, so their sum has no variance.
        if leverage <= 0.0 {
            return 0.0;
        }
        let variance = self.rest(n) / (self.rows - n) as f64 * leverage;
        // A record without noise leaves no residual.
        if variance > 0.0 { sum / variance.sqrt() } else { sum.signum() * f64::MAX }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn t_is_that_of_a_mean_and_of_a_line() {
        let y = [1.0, 2.0, 4.0, 5.0];
        let ones = vec![1.0; 4];
        let ols = Ols::new(std::slice::from_ref(&ones), &y).expect("solvable");
        // Mean 3, s^2 = 10/3, standard error sqrt(10/12).
        assert!((ols.t(1, 0..1) - 3.0 / (10.0f64 / 12.0).sqrt()).abs() < 1e-12);
        assert!((ols.rest(1) - 10.0).abs() < 1e-12);
        // Slope 1.4 with a rest of 0.2 about the line 0.9 + 1.4 k.
        let ols = Ols::new(&[ones, vec![0.0, 1.0, 2.0, 3.0]], &y).expect("solvable");
        assert!((ols.rest(2) - 0.2).abs() < 1e-9);
        assert!((ols.t(2, 1..2) - 1.4 / (0.1f64 / 5.0).sqrt()).abs() < 1e-6);
        assert!((ols.rest(1) - 10.0).abs() < 1e-12, "the first column alone");
    }

    #[test]
    fn a_column_that_depends_on_another_says_nothing() {
        let y = [1.0, 2.0, 4.0, 5.0];
        let ols = Ols::new(&[vec![1.0; 4], vec![2.0; 4]], &y).expect("solvable");
        assert_eq!(ols.t(2, 1..2), 0.0);
    }

    #[test]
    fn too_few_rows_are_refused() {
        assert!(Ols::new(&[vec![1.0; 2], vec![0.0, 1.0]], &[1.0, 2.0]).is_none());
    }
}
