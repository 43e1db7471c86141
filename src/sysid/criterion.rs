//! The model selection criterion: a tempered log-likelihood less a penalty for every parameter, as in BIC.
//!
//! ```text
//! score(h) = tau max ln L(h) - sum_i rate_i ln N - ln(alternatives)
//! posterior(kind) ~ prior(kind) * sum over h of that kind of exp(score(h))
//! ```
//!
//! | parameter | penalty | constant |
//! |---|---|---|
//! | a coefficient, a level, a gain, a curvature | `1/2 ln N` | [`REGULAR`] |
//! | a threshold, or the time of a change | `ln N` | [`THRESHOLD`] |
//! | a frequency | `3/2 ln N` | [`FREQUENCY`] |
//! | a choice among n alternatives | `ln n` | – |
//!
//! * Rate: the standard deviation of the parameter's estimate shrinks as `N^-rate`.
//! * Parameters that all hypotheses have cancel, and are not charged.
//! * Tempering: the errors of a model that is nearly right are not independent, so N samples are worth `tau N`.
//!   `cargo run --release -p stictiond-numerics --example tempering` shows what each tau does on simulated loops.
//!
//! Sources: Schwarz, Ann. Stat. 1978, 6, 461 (rate 1/2); Chan, Ann. Stat. 1993, 21, 520 (thresholds); Djuric, IEEE Trans.
//! SP 1996, 44, 1744 (frequencies); Chen & Chen, Biometrika 2008, 95, 759 (alternatives).

/// Rate of a coefficient, a level, a gain or a curvature (-): the penalty is `1/2 ln N`.
pub const REGULAR: f64 = 0.5;
/// Rate of a threshold or of the time of a change (-): the penalty is `ln N`.
pub const THRESHOLD: f64 = 1.0;
/// Rate of a frequency (-): the penalty is `3/2 ln N`.
pub const FREQUENCY: f64 = 1.5;

/// Tempering exponent tau of the likelihood (-).
///
/// It was chosen on the generators A, B and C by the effects that are named wrongly: at 0.6 they are less than half of those at 1,
/// while as many are named right. The logarithmic score would choose 1 on A and B, and 0.8 on C. The command above prints both.
pub const TEMPERING: f64 = 0.6;

/// The score of a hypothesis, `tau ln L - rate ln N - ln(alternatives)` (-).
///
/// * `log_likelihood`: `max ln L`.
/// * `rate`: sum of the rates of the parameters that not all hypotheses have.
/// * `alternatives`: number of discrete alternatives from which it was chosen, at least 1.
/// * `n`: number N of samples that count.
pub fn score(log_likelihood: f64, rate: f64, alternatives: f64, n: f64) -> f64 {
    TEMPERING * log_likelihood - penalty(rate, n.max(1.0)) - alternatives.max(1.0).ln()
}

/// The penalty of parameters, `rate ln N` (-): what [`score`] takes off a tempered log-likelihood.
///
/// * `rate`: sum of the rates of the parameters.
/// * `n`: number N of samples that count.
pub fn penalty(rate: f64, n: f64) -> f64 {
    rate * n.ln()
}

/// The penalty of parameters in units of a log-likelihood that is not tempered, `rate ln N / tau` (-).
pub fn untempered_penalty(rate: f64, n: f64) -> f64 {
    penalty(rate, n) / TEMPERING
}

/// The penalty of parameters in units of a deviance `-2 ln L`, `2 ln N / tau * rate` (-).
pub fn deviance_penalty(rate: f64, n: f64) -> f64 {
    2.0 * n.ln() / TEMPERING * rate
}

/// `ln(exp(a) + exp(b) + …)`, without overflow; minus infinity for an empty iterator.
pub fn log_sum(logs: impl Iterator<Item = f64> + Clone) -> f64 {
    let most = logs.clone().fold(f64::NEG_INFINITY, f64::max);
    if most.is_finite() { most + logs.map(|log| (log - most).exp()).sum::<f64>().ln() } else { most }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_score_a_log_likelihood_and_a_deviance_pay_the_same_penalty() {
        let (rate, n) = (REGULAR + THRESHOLD, 1000.0);
        assert!((penalty(rate, n) - 1.5 * 6.907_755_278_982_137).abs() < 1e-12);
        // A gain of the log-likelihood that is as large as the penalty leaves the score as it was.
        let gained = untempered_penalty(rate, n);
        assert!((score(7.0 + gained, rate, 1.0, n) - score(7.0, 0.0, 1.0, n)).abs() < 1e-12);
        assert!((deviance_penalty(rate, n) - 2.0 * gained).abs() < 1e-12);
        assert_eq!(score(0.0, rate, 1.0, 0.5), 0.0, "fewer samples than one cost nothing");
    }
}
