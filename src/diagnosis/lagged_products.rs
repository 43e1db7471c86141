//! Products and sums of lagged columns, over the samples that count: the entries of a Gram matrix.
//!
//! ```text
//! out[i][j] = sum over k of a[k - lag_i] b[k - lag_j]
//! ```
//!
//! With both lags larger by one, the sum has one term more at its start and one less at its end. So only the first row and the
//! first column of a block are summed.

use crate::sysid::least_squares::dot_long;

/// The columns of one signal at the lags `from..from + count`.
#[derive(Clone, Copy)]
pub(super) struct Lags<'a> {
    pub(super) v: &'a [f64],
    pub(super) from: usize,
    pub(super) count: usize,
}

/// The samples that count: all from the first on, except those left out.
#[derive(Clone, Copy, Debug)]
pub struct Counted<'a> {
    /// The first sample that counts.
    pub first: usize,
    /// Samples after it that do not count, in order.
    pub left_out: &'a [usize],
}

impl Counted<'_> {
    /// The number of samples that count among the first `n`.
    pub fn rows(&self, n: usize) -> usize {
        n - self.first - self.left_out.len()
    }
}

/// `out[i][j] = sum over the k that count of a[k - lag_i] b[k - lag_j]`; with `same` the lower triangle alone.
///
/// * `stride`: length of a row of `out`.
pub(super) fn products(
    a: Lags<'_>,
    b: Lags<'_>,
    counted: Counted<'_>,
    same: bool,
    out: &mut [f64],
    stride: usize,
) {
    let (n, first) = (a.v.len(), counted.first);
    for i in 0..a.count {
        let li = a.from + i;
        let ai = &a.v[first - li..n - li];
        for j in 0..if same { i + 1 } else { b.count } {
            let lj = b.from + j;
            out[i * stride + j] = if i > 0 && j > 0 {
                out[(i - 1) * stride + j - 1] + a.v[first - li] * b.v[first - lj] - a.v[n - li] * b.v[n - lj]
            } else {
                dot_long(ai, &b.v[first - lj..n - lj])
            };
        }
    }
    for &k in counted.left_out {
        for i in 0..a.count {
            let value = a.v[k - a.from - i];
            for j in 0..if same { i + 1 } else { b.count } {
                out[i * stride + j] -= value * b.v[k - b.from - j];
            }
        }
    }
}

/// `out[i] = sum over the k that count of a[k - lag_i]`.
pub(super) fn sums(a: Lags<'_>, counted: Counted<'_>, out: &mut [f64]) {
    let (n, first) = (a.v.len(), counted.first);
    let mut sum: f64 = a.v[first - a.from..n - a.from].iter().sum();
    for (lag, out) in (a.from..a.from + a.count).zip(out) {
        *out = sum - counted.left_out.iter().map(|k| a.v[k - lag]).sum::<f64>();
        // With one lag more the sum has one sample more at the start and one less at the end.
        if first > lag {
            sum += a.v[first - lag - 1] - a.v[n - lag - 1];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// Directions are +1 and -1, so that their sums are whole numbers in any order.
    #[test]
    fn sums_of_directions_are_those_one_by_one_to_the_last_bit() {
        let (first, count) = (5, 4);
        for rows in [0, 1, 7, 8, 9, 17, 513, 1535] {
            let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(rows as u64);
            let v: Vec<f64> =
                (0..first + rows).map(|_| if rng.random::<f64>() < 0.6 { 1.0 } else { -1.0 }).collect();
            let mut found = vec![f64::NAN; count];
            sums(Lags { v: &v, from: 1, count }, Counted { first, left_out: &[] }, &mut found);
            for (i, found) in found.iter().enumerate() {
                let plain = (first..v.len()).fold(0.0, |sum, k| sum + v[k - 1 - i]);
                assert_eq!(found.to_bits(), f64::to_bits(plain), "{rows} {i}");
            }
        }
    }
}
