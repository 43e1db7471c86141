//! The evidence for friction, its steadiness over the record, and the interval of f.
//!
//! ```text
//! delta_aic  = min over explanations without friction of  AIC(explanation) - AIC(sticky),   AIC = N ln V + 2 parameters
//! steadiness = mean(g) / (sd(g) / sqrt(10)),   g: log-likelihood ratio summed over each of ten blocks of the rows that count
//! interval   = hull of { f : N ln(V(f) / V(f_hat)) <= 7.35 }, widened by the median step of OP
//! ```
//!
//! * **Steadiness.** A large `delta_aic` may come by chance, or from one transient of a model that is wrong anyway. So the gain
//!   must be shared by the record: steadiness above [`STEADY`] (Vuong's test; blocks, because errors are autocorrelated).
//! * **7.35.** f moves the instants at which the stem slips, so its likelihood is that of a threshold. 7.35 is the 95 % point of
//!   the likelihood ratio of a threshold; that of a smooth parameter is 3.84 (chi-squared).
//! * **Step of OP.** A slip happens somewhere between two samples, and no likelihood tells where.
//!
//! Source: Hansen, Econometrica 2000, 68, 575; Vuong, Econometrica 1989, 57, 307.

use super::armax::LOSS_FLOOR;
use super::friction::stick_slip;
use super::rivals::{Rated, Rival, rate};
use super::search::{CellPoint, Problem, Refined};
use crate::sysid::stats::{mean, median, sd};

/// 95 % point of the likelihood ratio of a threshold (Hansen, table 1).
const THRESHOLD_95: f64 = 7.35;
/// Number of blocks over which the gain must be shared: errors correlate within a block, and ten sums give a standard error.
const BLOCKS: usize = 10;
/// Degrees of freedom of the Student t likelihood of the steadiness: few, so that large errors at a few slips do not decide.
const TAILS: f64 = 4.0;
/// Least steadiness (-) of evidence that is believed: where as many blocks lose as win, it is about 0.
pub const STEADY: f64 = 0.5;

/// The evidence for the sticky model against the best explanation without friction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evidence {
    /// `AIC(best explanation) - AIC(sticky)` (-).
    pub delta_aic: f64,
    /// The best explanation without friction.
    pub rival: Rival,
    /// Mean gain of a block in standard errors (-), -100 to 100.
    pub steadiness: f64,
}

/// The evidence for friction: the sticky model against every explanation without friction.
///
/// * `sound`, `sticky`: the refined models at f = 0 and at f.
/// * `errors`: their prediction errors, one for each sample from [`Problem::first`] on.
/// * `period`: period of OP's oscillation (samples).
/// * `worth`: evidence against a linear loop below which the rivals that cost more are not fitted.
pub fn weigh(
    p: &Problem,
    sound: &Refined,
    sticky: &Refined,
    errors: [&[f64]; 2],
    period: Option<f64>,
    worth: f64,
) -> Evidence {
    let n = p.rows();
    let gain = |v0: f64, v1: f64| n * ((v0 + LOSS_FLOOR) / (v1 + LOSS_FLOOR)).ln();
    // The penalty of f, and of the kinetic lag and the resume threshold where they are not 0: 2 each.
    let paid = 2.0
        * (1.0 + f64::from(u8::from(sticky.fit.theta.lag > 0.0)) + f64::from(u8::from(sticky.resume > 0.0)));
    let by_armax = gain(sound.fit.loss, sticky.fit.loss) - paid;
    let by_long = gain(sound.long_loss, sticky.long_loss) - paid;
    let linear = by_armax.min(by_long);
    // Rows that do not count have the error 0, which would make the spread of the errors look smaller.
    let [of_sound, of_sticky] = errors.map(|errors| p.counting(errors));
    let steadiness = steadiness(&of_sound, &of_sticky);
    let mut evidence = Evidence { delta_aic: linear, rival: Rival::Linear, steadiness };
    if linear < worth {
        return evidence;
    }
    let lag = sticky.long_lag;
    let element = |u: &[f64]| -> Vec<f64> {
        let (mut x, mut dir) = (vec![0.0; u.len()], vec![0.0; u.len()]);
        stick_slip(u, sticky.f, sticky.resume, p.start, &mut x, &mut dir);
        x.iter().zip(&dir).map(|(x, d)| x - lag * d).collect()
    };
    for Rated { rival, gain } in rate(p, &element, period) {
        if gain - paid < evidence.delta_aic {
            evidence.delta_aic = gain - paid;
            evidence.rival = rival;
        }
    }
    evidence
}

/// The mean over blocks of the gain in log-likelihood, in its standard errors; bounded, for records without noise.
///
/// The likelihood is Student's t with [`TAILS`] degrees of freedom and the scale of the sticky model's errors, so that neither a
/// few large errors at slips nor one transient decides.
fn steadiness(sound: &[f64], sticky: &[f64]) -> f64 {
    let sizes: Vec<f64> = sticky.iter().map(|e| e.abs()).collect();
    let scale = (median(&sizes) / 0.6745).powi(2).max(LOSS_FLOOR);
    let minus_log_density = |e: f64| 0.5 * (TAILS + 1.0) * (e * e / (TAILS * scale)).ln_1p();
    let length = sound.len().min(sticky.len()).div_ceil(BLOCKS).max(1);
    let sums: Vec<f64> = sound
        .chunks(length)
        .zip(sticky.chunks(length))
        .map(|(a, b)| a.iter().zip(b).map(|(a, b)| minus_log_density(*a) - minus_log_density(*b)).sum())
        .collect();
    let spread = sd(&sums) * (sums.len() as f64 / (sums.len() as f64 - 1.0).max(1.0)).sqrt();
    let error = spread / (sums.len() as f64).sqrt();
    let m = mean(&sums);
    if error > 0.0 { (m / error).clamp(-100.0, 100.0) } else { 0.0 }
}

/// The 95 % interval of f from the profile likelihood of the long ARX (unit of the problem's OP), widened by the median step of OP.
///
/// * `cells`: the profile over f.
/// * `sticky`: the estimate.
pub fn interval(p: &Problem, cells: &[CellPoint], sticky: &Refined) -> [f64; 2] {
    let n = p.rows();
    let reference = sticky.long_loss + LOSS_FLOOR;
    let hi_of = |hi: f64, lo: f64| if hi.is_finite() { hi } else { lo };
    let mut bounds = [sticky.cell.lo, hi_of(sticky.cell.hi, sticky.cell.lo)];
    for c in cells.iter().filter(|c| n * (c.loss / reference).ln() <= THRESHOLD_95) {
        bounds[0] = bounds[0].min(c.cell.lo);
        bounds[1] = bounds[1].max(hi_of(c.cell.hi, c.cell.lo));
    }
    let steps: Vec<f64> = p.u.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
    let step = median(&steps);
    [(bounds[0] - step).max(0.0), bounds[1] + step]
}

#[cfg(test)]
mod tests;
