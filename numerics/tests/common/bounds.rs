//! How far a count may be from a published share by chance.

/// Chance of less, or of more, that a test puts up with: two and a half standard errors of a normal distribution.
const CHANCE: f64 = 0.0062;

/// Fewest of `n` at this rate.
pub fn fewest(rate: f64, n: usize) -> usize {
    n - most(1.0 - rate, n)
}

/// Most of `n` at this rate, by the binomial distribution.
pub fn most(rate: f64, n: usize) -> usize {
    let (mut term, mut below) = ((1.0 - rate).powi(n as i32), 0.0);
    for k in 0..n {
        below += term;
        if 1.0 - below < CHANCE {
            return k;
        }
        term *= (n - k) as f64 / (k + 1) as f64 * rate / (1.0 - rate);
    }
    n
}
