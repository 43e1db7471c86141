//! The two linear-algebra kernels everything rests on: a dot product that vectorises, and the Cholesky
//! solution of small symmetric systems in caller-owned storage.

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
    // Halves onto halves, as vectors fold: in another order the compiler shuffles inside the loop.
    let acc: [f64; 8] = std::array::from_fn(|i| acc[i] + acc[i + 8]);
    let [a, b, c, d]: [f64; 4] = std::array::from_fn(|i| acc[i] + acc[i + 4]);
    ((a + c) + (b + d)) + rest
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

/// Most columns of a system.
pub const MOST_COLUMNS: usize = 128;

/// Factors a symmetric positive semi-definite `G` of order `n` into `L Lᵀ` in place.
///
/// `g` is row-major with row length `stride`, lower triangle used and overwritten. A pivot below `1e-13` of its
/// diagonal is a dependent column: `live` is false there and [`substitute`] gives it the coefficient 0, so that
/// the others solve the problem without it.
pub fn factor(g: &mut [f64], stride: usize, n: usize, live: &mut [bool; MOST_COLUMNS]) {
    factor_rows(g, stride, 0..n, live);
}

/// The same for some rows, where those before them are factored.
pub fn factor_rows(g: &mut [f64], stride: usize, of: Range<usize>, live: &mut [bool; MOST_COLUMNS]) {
    let n = of.end;
    for first in of.step_by(ROWS) {
        let few = first..n.min(first + ROWS);
        let together = if few.len() == ROWS { first } else { 0 };
        if together > 0 {
            let (head, tail) = g.split_at_mut(first * stride);
            rows(head, tail, stride, first, live);
        }
        for i in few {
            let (head, tail) = g.split_at_mut(i * stride);
            let row = &mut tail[..=i];
            for j in together..i {
                let above = &head[j * stride..=j * stride + j];
                let partial: f64 = row[..j].iter().zip(above).map(|(x, y)| x * y).sum();
                row[j] = if live[j] { (row[j] - partial) / above[j] } else { 0.0 };
            }
            let rest = row[i] - row[..i].iter().map(|x| x * x).sum::<f64>();
            live[i] = rest > 1e-13 * row[i] && rest > 0.0;
            row[i] = if live[i] { rest.sqrt() } else { 1.0 };
        }
    }
}

/// Rows factored side by side: the sums of one alone wait for one another.
const ROWS: usize = 4;

/// The first `n` columns of the rows at the start of `tail`, below the factored `n` rows `head`.
fn rows(head: &[f64], tail: &mut [f64], stride: usize, n: usize, live: &[bool; MOST_COLUMNS]) {
    let mut each = tail.chunks_mut(stride);
    let mut rows: [&mut [f64]; ROWS] =
        std::array::from_fn(|_| each.next().map_or(&mut [][..], |row| &mut row[..n]));
    for j in 0..n {
        let above = &head[j * stride..=j * stride + j];
        let mut partial = [0.0; ROWS];
        {
            let [p, q, r, s] = rows.each_ref().map(|row| &row[..j]);
            for k in 0..j {
                partial[0] += p[k] * above[k];
                partial[1] += q[k] * above[k];
                partial[2] += r[k] * above[k];
                partial[3] += s[k] * above[k];
            }
        }
        for (row, partial) in rows.iter_mut().zip(partial) {
            row[j] = if live[j] { (row[j] - partial) / above[j] } else { 0.0 };
        }
    }
}

/// Solves `L Lᵀ theta = r` in place; the order is `r`'s length.
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

    #[test]
    fn dot_is_the_plain_sum() {
        let a: Vec<f64> = (0..37).map(f64::from).collect();
        let plain: f64 = a.iter().map(|x| x * x).sum();
        assert_eq!(dot(&a, &a), plain);
        assert_eq!(dot(&a, &a[..3]), 5.0);
        assert_eq!(total(&a), 666.0);
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
    fn rows_side_by_side_are_those_one_after_the_other() {
        for n in 1..=11 {
            // The sixth column is the sum of the first two.
            let column = |i: usize, k: usize| ((i * i + 2) as f64 * 0.37 * k as f64).cos() + 0.1 * i as f64;
            let value = |i, k| if i == 5 { column(0, k) + column(1, k) } else { column(i, k) };
            let product = |i, j| (0..40).map(|k| value(i, k) * value(j, k)).sum::<f64>();
            let g: Vec<f64> = (0..n * n).map(|at| product(at / n, at % n)).collect();
            let mut found = [(); 3].map(|()| (g.clone(), [true; MOST_COLUMNS]));
            let [plain, whole, parts] = &mut found;
            plainly(&mut plain.0, n, &mut plain.1);
            factor(&mut whole.0, n, n, &mut whole.1);
            factor(&mut parts.0, n, n / 2, &mut parts.1);
            factor_rows(&mut parts.0, n, n / 2..n, &mut parts.1);
            assert_eq!(plain, whole);
            assert_eq!(plain, parts);
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
