//! Dot products that vectorise, and the Cholesky solution of small symmetric systems in the caller's storage.

use multiversion::multiversion;
use std::ops::Range;

/// `sum a[i] b[i]` over the shorter length, in sixteen accumulators so that it vectorises.
#[inline(always)]
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len().min(b.len());
    let (a16, a_rest) = a[..n].as_chunks::<16>();
    let (b16, b_rest) = b[..n].as_chunks::<16>();
    let mut acc = [0.0; 16];
    for (x, y) in a16.iter().zip(b16) {
        for i in 0..16 {
            acc[i] += x[i] * y[i];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(x, y)| x * y).sum();
    // The upper half is added to the lower one, as vector registers are folded. In another order the compiler shuffles in the loop.
    let acc: [f64; 8] = std::array::from_fn(|i| acc[i] + acc[i + 8]);
    let [a, b, c, d]: [f64; 4] = std::array::from_fn(|i| acc[i] + acc[i + 4]);
    ((a + c) + (b + d)) + rest
}

/// [`dot`] for columns with a value for each sample, compiled for AVX2 too. The accumulators are the same, and so is the sum.
///
/// For short rows the call costs more than wider registers gain.
#[multiversion(targets("x86_64+avx2"))]
pub fn dot_long(a: &[f64], b: &[f64]) -> f64 {
    dot(a, b)
}

/// `sum a[i]`, in eight accumulators.
pub fn total(a: &[f64]) -> f64 {
    let (chunks, rest) = a.as_chunks::<8>();
    let mut acc = [0.0; 8];
    for chunk in chunks {
        for (sum, x) in acc.iter_mut().zip(chunk) {
            *sum += x;
        }
    }
    let [a, b, c, d]: [f64; 4] = std::array::from_fn(|i| acc[i] + acc[i + 4]);
    ((a + c) + (b + d)) + rest.iter().sum::<f64>()
}

/// Largest number of columns of a system.
pub const MOST_COLUMNS: usize = 128;

/// Factors a symmetric positive semi-definite `G` of order `n` into `L Lᵀ` in place (Cholesky).
///
/// * `g`: row by row, each row `stride` long; the lower triangle is read and overwritten.
/// * `live`: receives false for a column that depends on those before it, whose pivot is below `1e-13` of its diagonal.
///   [`substitute`] gives such a column the coefficient 0, so that the others solve the problem without it.
pub fn factor(g: &mut [f64], stride: usize, n: usize, live: &mut [bool; MOST_COLUMNS]) {
    factor_rows(g, stride, 0..n, live);
}

/// [`factor`] for the rows `of`, where all rows before them are factored already.
pub fn factor_rows(g: &mut [f64], stride: usize, of: Range<usize>, live: &mut [bool; MOST_COLUMNS]) {
    let n = of.end;
    if n <= ROWS {
        return of.for_each(|i| factor_row(g, stride, i, live));
    }
    let mut columns = [[0.0; ROWS]; MOST_COLUMNS];
    for first in of.step_by(ROWS) {
        factor_together(g, stride, first..n.min(first + ROWS), &mut columns, live);
    }
}

/// Factors row `i` alone.
fn factor_row(g: &mut [f64], stride: usize, i: usize, live: &mut [bool; MOST_COLUMNS]) {
    let (head, tail) = g.split_at_mut(i * stride);
    let row = &mut tail[..=i];
    for j in 0..i {
        let above = &head[j * stride..=j * stride + j];
        let partial: f64 = row[..j].iter().zip(above).map(|(x, y)| x * y).sum();
        row[j] = if live[j] { (row[j] - partial) / above[j] } else { 0.0 };
    }
    let rest = row[i] - row[..i].iter().map(|x| x * x).sum::<f64>();
    live[i] = rest > 1e-13 * row[i] && rest > 0.0;
    row[i] = if live[i] { rest.sqrt() } else { 1.0 };
}

/// Rows factored side by side: the sums of one row alone wait for one another.
const ROWS: usize = 8;

/// Factors at most [`ROWS`] rows, column by column. Every sum has the terms of [`factor_row`] in the same order.
///
/// * `columns`: room for the numbers of these rows, those of one column side by side.
#[multiversion(targets("x86_64+avx2"))]
fn factor_together(
    g: &mut [f64],
    stride: usize,
    rows: Range<usize>,
    columns: &mut [[f64; ROWS]; MOST_COLUMNS],
    live: &mut [bool; MOST_COLUMNS],
) {
    let Range { start: first, end } = rows;
    for j in 0..end {
        let (before, rest) = columns.split_at_mut(j);
        let column = &mut rest[0];
        *column = [0.0; ROWS];
        for i in first.max(j)..end {
            column[i - first] = g[i * stride + j];
        }
        // The numbers of row j are final, also where it is one of these rows.
        let above = &g[j * stride..=j * stride + j];
        let mut partial = [0.0; ROWS];
        for (other, l) in before.iter().zip(above) {
            for r in 0..ROWS {
                partial[r] += other[r] * l;
            }
        }
        for r in 0..ROWS {
            column[r] -= partial[r];
        }
        let mut pivot = above[j];
        if j >= first {
            let rest = column[j - first];
            live[j] = rest > 1e-13 * pivot && rest > 0.0;
            pivot = if live[j] { rest.sqrt() } else { 1.0 };
            g[j * stride + j] = pivot;
        }
        let is_live = live[j];
        for value in column.iter_mut() {
            *value = if is_live { *value / pivot } else { 0.0 };
        }
        for i in first.max(j + 1)..end {
            g[i * stride + j] = column[i - first];
        }
    }
}

/// Solves `L Lᵀ theta = r` in place, with L and `live` of [`factor`]; the order is the length of `r`, which receives theta.
pub fn substitute(g: &[f64], stride: usize, live: &[bool; MOST_COLUMNS], r: &mut [f64]) {
    let n = r.len();
    for i in 0..n {
        let row = &g[i * stride..=i * stride + i];
        let partial: f64 = row[..i].iter().zip(&r[..i]).map(|(x, y)| x * y).sum();
        r[i] = if live[i] { (r[i] - partial) / row[i] } else { 0.0 };
    }
    for i in (0..n).rev() {
        if !live[i] {
            r[i] = 0.0;
            continue;
        }
        let row = &g[i * stride..=i * stride + i];
        let value = r[i] / row[i];
        r[i] = value;
        for (r, l) in r[..i].iter_mut().zip(row) {
            *r -= l * value;
        }
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

    #[test]
    fn dot_is_the_plain_sum() {
        let a: Vec<f64> = (0..37).map(f64::from).collect();
        let plain: f64 = a.iter().map(|x| x * x).sum();
        assert_eq!(dot(&a, &a), plain);
        assert_eq!(dot(&a, &a[..3]), 5.0);
        assert_eq!(total(&a), 666.0);
    }

    /// The sum in N accumulators, term by term.
    fn in_accumulators<const N: usize>(terms: &[f64]) -> f64 {
        let whole = terms.len() - terms.len() % N;
        let mut acc = [0.0; N];
        (0..whole).for_each(|k| acc[k % N] += terms[k]);
        let mut half = N;
        while half > 4 {
            half /= 2;
            (0..half).for_each(|i| acc[i] += acc[i + half]);
        }
        ((acc[0] + acc[2]) + (acc[1] + acc[3])) + terms[whole..].iter().sum::<f64>()
    }

    #[test]
    fn sums_are_those_term_by_term_to_the_last_bit() {
        for (seed, n) in [0, 1, 7, 8, 9, 15, 16, 17, 33, 513, 1534, 2047].into_iter().enumerate() {
            let (a, b) = (signal(seed as u64, n), signal(100 + seed as u64, n));
            let terms: Vec<f64> = a.iter().zip(&b).map(|(a, b)| a * b).collect();
            let plain = in_accumulators::<16>(&terms).to_bits();
            assert_eq!([dot(&a, &b), dot_long(&a, &b)].map(f64::to_bits), [plain; 2], "{n}");
            assert_eq!(total(&a).to_bits(), in_accumulators::<8>(&a).to_bits(), "{n}");
        }
    }

    /// Row after row, term by term.
    fn plainly(g: &mut [f64], n: usize, live: &mut [bool; MOST_COLUMNS]) {
        for i in 0..n {
            for j in 0..i {
                let partial: f64 = (0..j).map(|k| g[i * n + k] * g[j * n + k]).sum();
                g[i * n + j] = if live[j] { (g[i * n + j] - partial) / g[j * n + j] } else { 0.0 };
            }
            let rest = g[i * n + i] - (0..i).map(|k| g[i * n + k].powi(2)).sum::<f64>();
            live[i] = rest > 1e-13 * g[i * n + i] && rest > 0.0;
            g[i * n + i] = if live[i] { rest.sqrt() } else { 1.0 };
        }
    }

    #[test]
    fn rows_side_by_side_are_those_one_after_the_other_to_the_last_bit() {
        let mut columns: Vec<Vec<f64>> = (0..MOST_COLUMNS as u64).map(|seed| signal(seed, 200)).collect();
        // The sixth column is the sum of the first two.
        columns[5] = columns[0].iter().zip(&columns[1]).map(|(a, b)| a + b).collect();
        for n in (0..=19).chain([31, 32, 45, 101, MOST_COLUMNS]) {
            let g: Vec<f64> = (0..n * n).map(|at| dot(&columns[at / n], &columns[at % n])).collect();
            let mut found = [(); 3].map(|()| (g.clone(), [true; MOST_COLUMNS]));
            let [plain, whole, parts] = &mut found;
            plainly(&mut plain.0, n, &mut plain.1);
            factor(&mut whole.0, n, n, &mut whole.1);
            factor(&mut parts.0, n, n / 2, &mut parts.1);
            factor_rows(&mut parts.0, n, n / 2..n, &mut parts.1);
            let bits = |g: &[f64]| g.iter().map(|g| g.to_bits()).collect::<Vec<u64>>();
            for other in [whole, parts] {
                assert_eq!((bits(&plain.0), plain.1), (bits(&other.0), other.1), "{n}");
            }
            assert_eq!(plain.1[..n].iter().filter(|live| !**live).count(), usize::from(n > 5));
        }
    }

    #[test]
    fn solves_by_hand_and_drops_a_dependent_column() {
        let mut live = [true; MOST_COLUMNS];
        let mut g = [4.0, 0.0, 2.0, 3.0];
        let mut r = [10.0, 8.0];
        factor(&mut g, 2, 2, &mut live);
        substitute(&g, 2, &live, &mut r);
        assert!((r[0] - 1.75).abs() < 1e-15 && (r[1] - 1.5).abs() < 1e-15);

        let mut g = [1.0, 0.0, 2.0, 4.0];
        let mut r = [3.0, 6.0];
        factor(&mut g, 2, 2, &mut live);
        substitute(&g, 2, &live, &mut r);
        assert_eq!((r, live[..2].to_vec()), ([3.0, 0.0], vec![true, false]));
    }
}
