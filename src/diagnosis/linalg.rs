//! The two linear-algebra kernels everything rests on: a dot product that vectorises, and the Cholesky
//! solution of small symmetric systems in caller-owned storage.

/// `sum a[i] b[i]` over the shorter length, in eight accumulators so that it vectorises.
#[inline]
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len().min(b.len());
    let (a8, a_rest) = a[..n].as_chunks::<8>();
    let (b8, b_rest) = b[..n].as_chunks::<8>();
    let mut acc = [0.0; 8];
    for (x, y) in a8.iter().zip(b8) {
        for i in 0..8 {
            acc[i] += x[i] * y[i];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(x, y)| x * y).sum();
    ((acc[0] + acc[4]) + (acc[1] + acc[5])) + ((acc[2] + acc[6]) + (acc[3] + acc[7])) + rest
}

/// Solves `G theta = r` for a symmetric positive semi-definite `G` of order `n` by Cholesky.
///
/// `g` is row-major with row length `stride`, lower triangle used and overwritten with the factor; `r` is
/// overwritten with the solution. A pivot below `1e-13` of its diagonal is a dependent column: its coefficient
/// is set to 0, which is what a pseudo-inverse would do to it.
pub fn cholesky_solve(g: &mut [f64], stride: usize, n: usize, r: &mut [f64]) {
    let mut live = [true; 64];
    for i in 0..n {
        let diagonal = g[i * stride + i];
        for j in 0..=i {
            let (head, tail) = g.split_at_mut(i * stride);
            let row_i = &mut tail[..=i];
            let partial = if j == i {
                row_i[..j].iter().map(|x| x * x).sum::<f64>()
            } else {
                row_i[..j]
                    .iter()
                    .zip(&head[j * stride..j * stride + j])
                    .map(|(x, y)| x * y)
                    .sum::<f64>()
            };
            let rest = row_i[j] - partial;
            if j == i {
                live[i] = rest > 1e-13 * diagonal && rest > 0.0;
                row_i[i] = if live[i] { rest.sqrt() } else { 1.0 };
                if !live[i] {
                    row_i[..i].fill(0.0);
                }
            } else {
                row_i[j] = if live[j] { rest / head[j * stride + j] } else { 0.0 };
            }
        }
    }
    for i in 0..n {
        let partial: f64 = (0..i).map(|j| g[i * stride + j] * r[j]).sum();
        r[i] = if live[i] {
            (r[i] - partial) / g[i * stride + i]
        } else {
            0.0
        };
    }
    for i in (0..n).rev() {
        let partial: f64 = (i + 1..n).map(|j| g[j * stride + i] * r[j]).sum();
        r[i] = if live[i] {
            (r[i] - partial) / g[i * stride + i]
        } else {
            0.0
        };
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
    }

    #[test]
    fn solves_by_hand_and_drops_a_dependent_column() {
        let mut g = [4.0, 0.0, 2.0, 3.0];
        let mut r = [10.0, 8.0];
        cholesky_solve(&mut g, 2, 2, &mut r);
        assert!((r[0] - 1.75).abs() < 1e-15 && (r[1] - 1.5).abs() < 1e-15);

        let mut g = [1.0, 0.0, 2.0, 4.0];
        let mut r = [3.0, 6.0];
        cholesky_solve(&mut g, 2, 2, &mut r);
        assert_eq!(r, [3.0, 0.0]);
    }
}
