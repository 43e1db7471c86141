//! The two linear-algebra kernels everything rests on: a dot product that vectorises, and the Cholesky
//! solution of small symmetric systems in caller-owned storage.

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
    for i in 0..n {
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
