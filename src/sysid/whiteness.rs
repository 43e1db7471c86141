//! Whether a residual is white: the test of Ljung and Box at 1 %.
//!
//! ```text
//! Q = N (N + 2) sum over l = 1..h of r_l² / (N - l)  <  chi²_0.99(h - fitted)
//! r_l = sum over k of e[k] e[k-l] / sum over k of e[k]²       h = 20 lags
//! ```
//!
//! Source: Ljung & Box, Biometrika 1978, 65, 297.

use super::least_squares::dot;

/// Number h of lags in the test.
const LAGS: usize = 20;

/// Whether Ljung–Box at 1 % does not reject that `e` is white. Too short a residual is not rejected.
///
/// * `fitted`: number of coefficients of A and C that were fitted to the record, below h.
pub fn is_white(e: &[f64], fitted: usize) -> bool {
    let n = e.len() as f64;
    let power = dot(e, e);
    if e.len() <= 2 * LAGS || power <= 0.0 {
        return true;
    }
    let q: f64 = (1..=LAGS)
        .map(|l| {
            let r = dot(&e[l..], &e[..e.len() - l]) / power;
            r * r / (n - l as f64)
        })
        .sum::<f64>()
        * n
        * (n + 2.0);
    q < chi_squared_99((LAGS - fitted) as f64)
}

/// 99 % point of chi-squared with `dof` degrees of freedom (Wilson–Hilferty, good to 0.5 % here).
fn chi_squared_99(dof: f64) -> f64 {
    let a = 2.0 / (9.0 * dof);
    dof * (1.0 - a + 2.326_347_9 * a.sqrt()).powi(3)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn chi_squared_by_table() {
        // Tables: 99 % of chi-squared is 29.141 with 14 and 37.566 with 20 degrees of freedom.
        assert!((chi_squared_99(14.0) - 29.141).abs() < 0.1);
        assert!((chi_squared_99(20.0) - 37.566).abs() < 0.1);
    }

    #[test]
    fn white_passes_and_coloured_fails() {
        let (mut passed, mut caught) = (0, 0);
        for seed in 0..200 {
            let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
            let e: Vec<f64> = StandardNormal.sample_iter(&mut rng).take(500).collect();
            passed += usize::from(is_white(&e, 0));
            let coloured: Vec<f64> = e.windows(2).map(|w| w[1] + 0.4 * w[0]).collect();
            caught += usize::from(!is_white(&coloured, 0));
        }
        // 1 % of 200 is 2; six or more rejections would have a chance of 2 %.
        assert!(passed >= 195, "{passed}");
        // r1 = 0.345 gives Q = 59 on average against a limit of 38.
        assert!(caught >= 190, "{caught}");
    }
}
