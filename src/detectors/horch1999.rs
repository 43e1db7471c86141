//! Horch 1999: the cross-correlation of OP and PV.
//!
//! Under PI control of a self-regulating process, a valve that sticks puts PV a quarter of a period behind (an odd
//! function); a load or tight tuning puts OP and PV half a period apart (an even one).
//!
//! ```text
//! r(l) = sum u[k] y[k + l] / (N sd(u) sd(y))
//! d_rho = | |r_0| - |r_opt| | / (|r_0| + |r_opt|)      r_0 = r(0), r_opt: the largest |r| between the two crossings
//! d_tau = |tau_l - tau_r| / (tau_l + tau_r)            tau_l, tau_r: zero crossings of r nearest to 0 (samples)
//! ```
//!
//! A cosine `r = cos(w l + phi)` has `d_rho = (1 - cos phi)/(1 + cos phi)` and `d_tau = 2 phi/pi`, phi its shift from an even
//! function. The author's thresholds are phi = 30° (`d_rho = (2 - sqrt 3)/(2 + sqrt 3) = 0.072, d_tau = 1/3`) and 60°
//! (`1/3, 2/3`). The index is d_tau; d_rho must say the same.
//!
//! Source: A simple method for detection of stiction in control valves, Control Eng. Practice 1999, 7, 1221.
//! Limits: integrating processes and P control are not covered; dead time and a lag turn the phase towards the half period
//! of a load, so that a valve that sticks weakly in a slow process is called sound.

use super::{Band, Facts, Integrates, Method, Opinion, Says};
use crate::sysid::least_squares::dot;

const ME: Method = Method::Horch1999;
/// The author's thresholds of `d_tau` (-).
pub const BY_TIME: Band = Band { sound: 1.0 / 3.0, sticks: 2.0 / 3.0 };
/// The author's thresholds of `d_rho` (-): the first is (2 - √3)/(2 + √3).
pub const BY_HEIGHT: Band = Band { sound: 0.071_796_769_724_490_8, sticks: 1.0 / 3.0 };

/// What the cross-correlation looks like around 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// `d_rho` (-).
    pub by_height: f64,
    /// `d_tau` (-).
    pub by_time: f64,
}

/// `d_rho` and `d_tau` of two centred signals within a period (samples); none where r does not cross zero there.
pub fn shape(u: &[f64], y: &[f64], period: f64) -> Option<Shape> {
    let n = u.len().min(y.len());
    let reach = (period.ceil() as usize).min(n / 2);
    let r = |lag: isize| -> f64 {
        let by = lag.unsigned_abs();
        if lag < 0 { dot(&u[by..n], &y[..n - by]) } else { dot(&u[..n - by], &y[by..n]) }
    };
    let (zero, mut largest) = (r(0), r(0).abs());
    let mut crossings = [0.0; 2];
    for (to, step) in crossings.iter_mut().zip([-1, 1]) {
        let mut before = zero;
        *to = (1..=reach as isize).find_map(|lag| {
            let now = r(step * lag);
            if (now > 0.0) != (before > 0.0) && now != before {
                return Some((lag - 1) as f64 + before / (before - now));
            }
            largest = largest.max(now.abs());
            before = now;
            None
        })?;
    }
    let (zero, sum) = (zero.abs(), crossings[0] + crossings[1]);
    (largest > 0.0 && sum > 0.0).then(|| Shape {
        by_height: (largest - zero) / (largest + zero),
        by_time: (crossings[0] - crossings[1]).abs() / sum,
    })
}

/// What the method says.
pub fn opinion(facts: &Facts<'_>) -> Opinion {
    let period = match facts.oscillates() {
        Ok(period) => period,
        Err(why) => return Opinion::cannot_tell(ME, why),
    };
    match facts.integration.answer {
        Integrates::No => {}
        Integrates::Yes => return Opinion::cannot_tell(ME, "the process integrates"),
        Integrates::Unknown => return Opinion::cannot_tell(ME, facts.integration.why()),
    }
    let Some(Shape { by_height, by_time }) = shape(&facts.op.centred, &facts.pv.centred, period) else {
        return Opinion::cannot_tell(ME, "the cross-correlation does not cross zero within a period");
    };
    let why = format!("d_tau {by_time:.2}, d_rho {by_height:.2}");
    let opinion = Opinion::of(ME, by_time, BY_TIME, why.clone());
    let other = BY_HEIGHT.says(by_height);
    if opinion.says != other && opinion.says != Says::CannotTell {
        return opinion.but_cannot_tell(format!("{why}: they do not say the same"));
    }
    opinion
}
