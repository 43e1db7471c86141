//! Gram matrices: the products of all columns of a regression. Least squares on a window spends most of its time on them.
//!
//! ```text
//! g[i][j] = sum over rows k of c_i[k] c_j[k],   c_i[k] = v_i[k - lag_i]
//! ```
//!
//! * Eight products are summed side by side, because one alone waits for its two columns to be loaded from memory.
//! * Where two columns are the ones before them, a sample later, their product differs from that of those by two terms.

use crate::sysid::least_squares::dot_long;
use multiversion::multiversion;
use std::ops::Range;

/// Samples summed side by side for each product: the width of a vector register.
const FOUR: usize = 4;
/// Terms of a partial sum, before it is added to the whole: one long sum rounds so much that dependent columns seem independent.
const RUN: usize = 128;

/// Calls `put(i, j, sum over k of a_i[k] b_j[k])` for every column of `a` with every column of `b`; all have one length.
pub fn products(a: &[&[f64]], b: &[&[f64]], mut put: impl FnMut(usize, usize, f64)) {
    let (fours, rest) = b.as_chunks::<4>();
    products_with_fours(a, fours, &mut put);
    let (fours, left) = a.as_chunks::<4>();
    let (i, j) = (a.len() - left.len(), b.len() - rest.len());
    products_with_fours(rest, fours, |r, c, sum| put(c, j + r, sum));
    for (r, other) in left.iter().enumerate() {
        for (c, one) in rest.iter().enumerate() {
            put(i + r, j + c, dot_long(other, one));
        }
    }
}

/// Calls `put(i, j, sum)` for every column of `a` with every column of `fours`.
///
/// One run of samples comes after the other, because a run of a few columns fits into the nearest cache, and columns do not.
fn products_with_fours(a: &[&[f64]], fours: &[[&[f64]; 4]], mut put: impl FnMut(usize, usize, f64)) {
    let (pairs, odd) = a.as_chunks::<2>();
    let mut of_pairs = vec![[[[0.0; FOUR]; 4]; 2]; fours.len() * pairs.len()];
    let mut of_odd = vec![[[0.0; FOUR]; 4]; fours.len() * odd.len()];
    let n = a.first().map_or(0, |v| chunks(v).len());
    for from in (0..n).step_by(RUN) {
        let to = n.min(from + RUN);
        for (j, four) in fours.iter().enumerate() {
            let four = four.map(|v| &chunks(v)[from..to]);
            for (i, pair) in pairs.iter().enumerate() {
                let pair = pair.map(|v| &chunks(v)[from..to]);
                two_by_four(pair, four, &mut of_pairs[j * pairs.len() + i]);
            }
            for one in odd {
                one_by_four(&chunks(one)[from..to], four, &mut of_odd[j]);
            }
        }
    }
    for (j, four) in fours.iter().enumerate() {
        for (i, pair) in pairs.iter().enumerate() {
            for (r, sums) in of_pairs[j * pairs.len() + i].iter().enumerate() {
                for (c, sums) in sums.iter().enumerate() {
                    put(2 * i + r, 4 * j + c, sum_of_lanes(sums, pair[r], four[c]));
                }
            }
        }
        for one in odd {
            for (c, sums) in of_odd[j].iter().enumerate() {
                put(a.len() - 1, 4 * j + c, sum_of_lanes(sums, one, four[c]));
            }
        }
    }
}

/// `to[k] += a v[k] + b w[k]`.
#[multiversion(targets("x86_64+avx2"))]
pub fn add_two(to: &mut [f64], (a, v): (f64, &[f64]), (b, w): (f64, &[f64])) {
    for ((to, v), w) in to.iter_mut().zip(v).zip(w) {
        *to += a * v + b * w;
    }
}

/// A column of a regression: a signal, `lag` samples late.
#[derive(Clone, Copy)]
pub struct Column<'a> {
    /// The signal from the window's first sample on.
    pub of: &'a [f64],
    /// The lag (samples).
    pub lag: usize,
    /// Whether it is the column before it, one sample later.
    pub next: bool,
}

impl<'a> Column<'a> {
    /// The columns of a signal at some lags.
    pub fn lags(of: &'a [f64], lags: impl IntoIterator<Item = usize>) -> impl Iterator<Item = Self> {
        let mut before = None;
        lags.into_iter().map(move |lag| {
            let next = lag > 0 && before == Some(lag - 1);
            before = Some(lag);
            Self { of, lag, next }
        })
    }

    /// The column of a signal without a lag.
    pub fn now(of: &'a [f64]) -> Self {
        Self { of, lag: 0, next: false }
    }

    /// Its values in these rows.
    pub fn rows(&self, rows: &Range<usize>) -> &'a [f64] {
        &self.of[rows.start - self.lag..rows.end - self.lag]
    }
}

/// Puts the Gram matrix of the columns in these rows into the lower triangle of `g`, whose rows are `stride` long.
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

/// Puts the Gram matrix of the columns into the lower triangle of `g`, whose rows are `stride` long; the rest stays as it is.
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

/// One product: the sums of its four lanes, and the samples that fill no vector.
fn sum_of_lanes([p, q, r, s]: &[f64; FOUR], a: &[f64], b: &[f64]) -> f64 {
    let n = a.len().min(b.len());
    let from = n - n % FOUR;
    let left: f64 = a[from..n].iter().zip(&b[from..n]).map(|(a, b)| a * b).sum();
    (p + r) + (q + s) + left
}

/// A column in chunks of [`FOUR`] samples; the samples that fill no chunk are left out.
fn chunks(v: &[f64]) -> &[[f64; FOUR]] {
    v.as_chunks().0
}

/// Adds to `sums[r][c][l]` the products of the chunks of columns r and c in one run, lane by lane.
///
/// It is a function apart from [`sum_of_lanes`]: compiled together, each step of the loop would shuffle lanes.
#[multiversion(targets("x86_64+avx2"))]
fn two_by_four(a: [&[[f64; FOUR]]; 2], b: [&[[f64; FOUR]]; 4], sums: &mut [[[f64; FOUR]; 4]; 2]) {
    let n = a[0].len();
    let (a, b) = (a.map(|v| &v[..n]), b.map(|v| &v[..n]));
    let mut acc = [[[0.0; FOUR]; 4]; 2];
    for k in 0..n {
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

/// The same for one column with four.
#[multiversion(targets("x86_64+avx2"))]
fn one_by_four(a: &[[f64; FOUR]], b: [&[[f64; FOUR]]; 4], sums: &mut [[f64; FOUR]; 4]) {
    let n = a.len();
    let b = b.map(|v| &v[..n]);
    let mut acc = [[0.0; FOUR]; 4];
    for k in 0..n {
        for c in 0..4 {
            for l in 0..FOUR {
                acc[c][l] += a[k][l] * b[c][k][l];
            }
        }
    }
    sums.as_flattened_mut().iter_mut().zip(acc.as_flattened()).for_each(|(sum, part)| *sum += part);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sysid::least_squares::dot;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    fn signal(seed: u64, n: usize) -> Vec<f64> {
        StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(seed)).take(n).collect()
    }

    /// The product as the kernels sum it, term by term: in lanes, run after run.
    fn in_lanes(a: &[f64], b: &[f64]) -> f64 {
        let whole = a.len() - a.len() % FOUR;
        let mut sums = [0.0; FOUR];
        for from in (0..whole).step_by(FOUR * RUN) {
            let mut run = [0.0; FOUR];
            (from..whole.min(from + FOUR * RUN)).for_each(|k| run[k % FOUR] += a[k] * b[k]);
            (0..FOUR).for_each(|l| sums[l] += run[l]);
        }
        let left: f64 = (whole..a.len()).map(|k| a[k] * b[k]).sum();
        (sums[0] + sums[2]) + (sums[1] + sums[3]) + left
    }

    /// Every remainder of both sets, and of the samples.
    #[test]
    fn products_are_the_plain_sums() {
        let signals: Vec<Vec<f64>> = (0..11).map(|seed| signal(seed, 4 * FOUR * RUN)).collect();
        for n in [0, 1, 7, 8, 9, 17, 103, FOUR * RUN, FOUR * RUN + 1, 1534, 3 * FOUR * RUN + 7] {
            let of: Vec<&[f64]> = signals.iter().map(|v| &v[..n]).collect();
            for (p, q) in (0..=5).flat_map(|p| (0..=11).map(move |q| (p, q))) {
                let mut found = vec![f64::NAN; p * q];
                products(&of[..p], &of[..q], |i, j, sum| found[i * q + j] = sum);
                for (at, found) in found.iter().enumerate() {
                    let (i, j) = (at / q, at % q);
                    let plain: f64 = of[i].iter().zip(of[j]).map(|(a, b)| a * b).sum();
                    assert!((found - plain).abs() < 1e-10, "{n} {p} {q} {at}: {found} {plain}");
                    let alone = i >= p - p % 4 && j >= q - q % 4;
                    let same = if alone { dot(of[i], of[j]) } else { in_lanes(of[i], of[j]) };
                    assert_eq!(found.to_bits(), same.to_bits(), "{n} {p} {q} {at}: {found} {same}");
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
