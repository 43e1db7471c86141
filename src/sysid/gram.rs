//! Products of many columns with many: what least squares on a window spends its time on.
//!
//! ```text
//! g[i][j] = sum over rows k of c_i[k] c_j[k],   c_i[k] = v_i[k - lag_i]
//! ```
//!
//! One product alone waits for its two columns to be loaded; eight side by side load six for eight. And neighbours that are
//! one signal a sample later share all but two of their terms.

use crate::sysid::least_squares::dot;
use multiversion::multiversion;
use std::ops::Range;

/// Samples summed side by side for each product: the width of a vector register.
const FOUR: usize = 4;
/// How often before that is added to what was summed before: one long sum rounds so much that columns which depend on one another
/// no longer seem to.
const RUN: usize = 128;

/// Calls `put(i, j, sum a_i[k] b_j[k])` for all of both, of one length.
pub fn products(a: &[&[f64]], b: &[&[f64]], mut put: impl FnMut(usize, usize, f64)) {
    let (fours, rest) = b.as_chunks::<4>();
    let (pairs, odd) = a.as_chunks::<2>();
    for (j, four) in fours.iter().enumerate() {
        for (i, pair) in pairs.iter().enumerate() {
            by_pair(pair, four, |r, c, sum| put(2 * i + r, 4 * j + c, sum));
        }
        for one in odd {
            by_four(one, four, |c, sum| put(a.len() - 1, 4 * j + c, sum));
        }
    }
    let (fours, left) = a.as_chunks::<4>();
    let (pairs, odd) = rest.as_chunks::<2>();
    let j = b.len() - rest.len();
    for (i, four) in fours.iter().enumerate() {
        for (p, pair) in pairs.iter().enumerate() {
            by_pair(pair, four, |c, r, sum| put(4 * i + r, j + 2 * p + c, sum));
        }
        for one in odd {
            by_four(one, four, |r, sum| put(4 * i + r, b.len() - 1, sum));
        }
    }
    for (i, other) in left.iter().enumerate() {
        for (c, one) in rest.iter().enumerate() {
            put(a.len() - left.len() + i, j + c, dot(other, one));
        }
    }
}

/// Adds two signals, each times a number.
#[multiversion(targets("x86_64+avx2"))]
pub fn add_two(to: &mut [f64], (a, v): (f64, &[f64]), (b, w): (f64, &[f64])) {
    for ((to, v), w) in to.iter_mut().zip(v).zip(w) {
        *to += a * v + b * w;
    }
}

/// A column of a regression: a signal so many samples late.
#[derive(Clone, Copy)]
pub struct Column<'a> {
    /// The signal from the window's first sample on.
    pub of: &'a [f64],
    /// Samples late.
    pub lag: usize,
    /// Whether it is the column before it, a sample later.
    pub next: bool,
}

impl<'a> Column<'a> {
    /// A signal at some lags.
    pub fn lags(of: &'a [f64], lags: impl IntoIterator<Item = usize>) -> impl Iterator<Item = Self> {
        let mut before = None;
        lags.into_iter().map(move |lag| {
            let next = lag > 0 && before == Some(lag - 1);
            before = Some(lag);
            Self { of, lag, next }
        })
    }

    /// A signal as it is.
    pub fn now(of: &'a [f64]) -> Self {
        Self { of, lag: 0, next: false }
    }

    /// Its part in the rows.
    pub fn rows(&self, rows: &Range<usize>) -> &'a [f64] {
        &self.of[rows.start - self.lag..rows.end - self.lag]
    }
}

/// The products of all columns in these rows into the lower triangle of `g`, its rows `stride` long.
pub fn gram(columns: &[Column<'_>], rows: &Range<usize>, g: &mut [f64], stride: usize) {
    let (nexts, firsts): (Vec<usize>, Vec<usize>) = (0..columns.len()).partition(|i| columns[*i].next);
    let of = |which: &[usize]| -> Vec<&[f64]> { which.iter().map(|i| columns[*i].rows(rows)).collect() };
    let of_firsts = of(&firsts);
    let at = |i: usize, j: usize| i.max(j) * stride + i.min(j);
    products(&of_firsts, &of(&nexts), |i, j, sum| g[at(firsts[i], nexts[j])] = sum);
    triangle(&of_firsts, |i, j, sum| g[at(firsts[i], firsts[j])] = sum);
    let Range { start, end } = *rows;
    for (nth, &i) in nexts.iter().enumerate() {
        let a = &columns[i];
        for &j in &nexts[..=nth] {
            let b = &columns[j];
            let ends = a.of[start - a.lag] * b.of[start - b.lag] - a.of[end - a.lag] * b.of[end - b.lag];
            g[i * stride + j] = g[(i - 1) * stride + j - 1] + ends;
        }
    }
}

/// The products of all columns into the lower triangle of `g`, its rows `stride` long; what is above stays as it is.
pub fn lower(columns: &[&[f64]], g: &mut [f64], stride: usize) {
    triangle(columns, |i, j, sum| g[i * stride + j] = sum);
}

/// Calls `put(i, j, sum c_i[k] c_j[k])` for all `j <= i`.
fn triangle(columns: &[&[f64]], mut put: impl FnMut(usize, usize, f64)) {
    for (at, few) in columns.chunks(4).enumerate() {
        let at = 4 * at;
        products(few, &columns[..at + few.len()], |i, j, sum| {
            if j <= at + i {
                put(at + i, j, sum);
            }
        });
    }
}

fn by_pair(pair: &[&[f64]; 2], four: &[&[f64]; 4], mut put: impl FnMut(usize, usize, f64)) {
    let mut sums = [[[0.0; FOUR]; 4]; 2];
    two_by_four(pair.map(chunks), four.map(chunks), &mut sums);
    for (r, sums) in sums.iter().enumerate() {
        for (c, sums) in sums.iter().enumerate() {
            put(r, c, whole(sums, pair[r], four[c]));
        }
    }
}

fn by_four(one: &[f64], four: &[&[f64]; 4], mut put: impl FnMut(usize, f64)) {
    let mut sums = [[0.0; FOUR]; 4];
    one_by_four(chunks(one), four.map(chunks), &mut sums);
    for (c, sums) in sums.iter().enumerate() {
        put(c, whole(sums, one, four[c]));
    }
}

/// The whole product: what was summed side by side, and the samples that are left.
fn whole([p, q, r, s]: &[f64; FOUR], a: &[f64], b: &[f64]) -> f64 {
    let n = a.len().min(b.len());
    let from = n - n % FOUR;
    let left: f64 = a[from..n].iter().zip(&b[from..n]).map(|(a, b)| a * b).sum();
    (p + r) + (q + s) + left
}

/// What is taken so many samples at a time.
fn chunks<const N: usize>(v: &[f64]) -> &[[f64; N]] {
    v.as_chunks().0
}

/// Apart from what adds the sums up: seen together they are rearranged so that each step shuffles.
#[multiversion(targets("x86_64+avx2"))]
fn two_by_four(a: [&[[f64; FOUR]]; 2], b: [&[[f64; FOUR]]; 4], sums: &mut [[[f64; FOUR]; 4]; 2]) {
    let n = a[0].len();
    for from in (0..n).step_by(RUN) {
        let to = n.min(from + RUN);
        let (a, b) = (a.map(|v| &v[from..to]), b.map(|v| &v[from..to]));
        let mut acc = [[[0.0; FOUR]; 4]; 2];
        for k in 0..to - from {
            for r in 0..2 {
                for c in 0..4 {
                    for l in 0..FOUR {
                        acc[r][c][l] += a[r][k][l] * b[c][k][l];
                    }
                }
            }
        }
        let all = sums.as_flattened_mut().as_flattened_mut();
        all.iter_mut().zip(acc.as_flattened().as_flattened()).for_each(|(sum, part)| *sum += part);
    }
}

#[multiversion(targets("x86_64+avx2"))]
fn one_by_four(a: &[[f64; FOUR]], b: [&[[f64; FOUR]]; 4], sums: &mut [[f64; FOUR]; 4]) {
    for from in (0..a.len()).step_by(RUN) {
        let to = a.len().min(from + RUN);
        let (a, b) = (&a[from..to], b.map(|v| &v[from..to]));
        let mut acc = [[0.0; FOUR]; 4];
        for k in 0..to - from {
            for c in 0..4 {
                for l in 0..FOUR {
                    acc[c][l] += a[k][l] * b[c][k][l];
                }
            }
        }
        sums.as_flattened_mut().iter_mut().zip(acc.as_flattened()).for_each(|(sum, part)| *sum += part);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    fn signal(seed: u64, n: usize) -> Vec<f64> {
        StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(seed)).take(n).collect()
    }

    /// Every remainder of both sets, and of the samples.
    #[test]
    fn products_are_the_plain_sums() {
        let signals: Vec<Vec<f64>> = (0..11).map(|seed| signal(seed, 4 * FOUR * RUN)).collect();
        for n in [0, 1, 2, 3, 103, FOUR * RUN, FOUR * RUN + 1, 3 * FOUR * RUN + 7] {
            let of: Vec<&[f64]> = signals.iter().map(|v| &v[..n]).collect();
            for (p, q) in (0..=5).flat_map(|p| (0..=11).map(move |q| (p, q))) {
                let mut found = vec![f64::NAN; p * q];
                products(&of[..p], &of[..q], |i, j, sum| found[i * q + j] = sum);
                for (at, found) in found.iter().enumerate() {
                    let plain: f64 = of[at / q].iter().zip(of[at % q]).map(|(a, b)| a * b).sum();
                    assert!((found - plain).abs() < 1e-10, "{n} {p} {q} {at}: {found} {plain}");
                }
            }
        }
    }

    #[test]
    fn what_neighbours_share_is_the_same() {
        let (y, z, shape) = (signal(1, 200), signal(2, 200), signal(3, 200));
        let mut columns: Vec<Column> = Column::lags(&y, [1, 2, 3, 5, 6]).collect();
        columns.extend(Column::lags(&z, 2..5));
        columns.push(Column::now(&shape));
        let (rows, p) = (20..190, columns.len());
        assert_eq!(columns.iter().filter(|column| column.next).count(), 5);
        let of: Vec<&[f64]> = columns.iter().map(|column| column.rows(&rows)).collect();
        let (mut shared, mut plain) = (vec![0.0; p * (p + 2)], vec![0.0; p * (p + 2)]);
        gram(&columns, &rows, &mut shared, p + 2);
        lower(&of, &mut plain, p + 2);
        for (at, (shared, plain)) in shared.iter().zip(&plain).enumerate() {
            assert!((shared - plain).abs() < 1e-10, "{at}: {shared} {plain}");
        }
        let dots = (0..p).flat_map(|i| (0..=i).map(move |j| (i, j)));
        let mut filled = plain.iter().filter(|g| **g != 0.0).count();
        for (i, j) in dots {
            assert!((plain[i * (p + 2) + j] - dot(of[i], of[j])).abs() < 1e-12);
            filled -= 1;
        }
        assert_eq!(filled, 0, "nothing above the diagonal");
    }
}
