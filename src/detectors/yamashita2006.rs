//! Yamashita 2006: qualitative shapes in the plot of OP against the stem.
//!
//! The changes of OP and stem, in their standard deviations, become symbols: I (increases), S (steady), D (decreases).
//! `XY` means OP X, stem Y. A valve that sticks is in IS and DS, and leaves them as a stem that slips would.
//!
//! ```text
//! rho_1 = (t_IS + t_DS) / (t - t_SS)
//! rho_2 = (t of IS II, IS SI, DS DD, DS SD) / (t - t_SS)
//! rho_3 = rho_1 - (t of IS DD, IS DI, IS SD, IS ID, IS DS, DS DI, DS SI, DS ID, DS II, DS IS) / (t - t_SS)
//! ```
//!
//! t: samples; t_XY of them in that state, t of `XY ZW` in runs of XY that ZW ends. rho_3 (-) is the index: above 0.25 the
//! valve sticks. 0.25 is what signals without any relation give: two of eight states.
//!
//! Source: An automatic method for detection of valve stiction in process control loops, Control Eng. Practice 2006, 14,
//! 503; the threshold is the author's. PV stands for the stem where none is measured, as in the paper, which is right for
//! flow loops. Chosen here: changes are taken over a thirtieth of a period, and a change is steady up to 0.43 standard
//! deviations, which makes the three symbols of Gaussian changes equally frequent.
//! Limits: a slow process moves PV while the stem stands still, so that sticking valves are missed; noise makes symbols
//! random and draws rho_3 below 0.25; where PV is a sample late the slip coincides with the turn of OP (DI), which rho_3 takes
//! for impossible.

use super::{Band, Facts, Integrates, Method, Opinion};
use crate::sysid::stats::{mean, sd};

const ME: Method = Method::Yamashita2006;
/// The author's threshold (-).
pub const BAND: Band = Band::at(0.25);
/// Changes are taken over the period divided by this.
const PARTS: f64 = 30.0;
/// Third of a Gaussian on either side of which a change is no more steady (standard deviations).
const STEADY: f64 = 0.430_727_3;

/// The shares of time in sticking states.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shares {
    /// Sticking states.
    pub rho_1: f64,
    /// Those that end as a slip does.
    pub rho_2: f64,
    /// Sticking states without those that end as no stem could.
    pub rho_3: f64,
}

/// Changes over `step` samples as -1, 0, 1.
pub fn symbols(v: &[f64], step: usize) -> Vec<i8> {
    let changes: Vec<f64> = v.windows(step + 1).step_by(step).map(|w| w[step] - w[0]).collect();
    let (m, s) = (mean(&changes), sd(&changes));
    let of = |change: f64| match (change - m) / s {
        z if z > STEADY => 1,
        z if z < -STEADY => -1,
        _ => 0,
    };
    changes.into_iter().map(of).collect()
}

/// The shares from the symbols of OP and stem; none where nothing moves.
pub fn shares(u: &[i8], x: &[i8]) -> Option<Shares> {
    let states: Vec<(i8, i8)> = u.iter().copied().zip(x.iter().copied()).collect();
    let moving = states.iter().filter(|state| **state != (0, 0)).count();
    let (mut sticking, mut slips, mut impossible, mut end) = (0, 0, 0, 0);
    for run in states.chunk_by(|a, b| a == b) {
        end += run.len();
        let (way, 0) = run[0] else { continue };
        if way == 0 {
            continue;
        }
        sticking += run.len();
        match states.get(end).map(|(u, x)| (way * u, way * x)) {
            Some((1 | 0, 1)) => slips += run.len(),
            Some((0, 0)) | None => {}
            Some(_) => impossible += run.len(),
        }
    }
    let share = |count: usize| count as f64 / moving as f64;
    (moving > 0).then(|| Shares {
        rho_1: share(sticking),
        rho_2: share(slips),
        rho_3: share(sticking) - share(impossible),
    })
}

/// What the method says.
pub fn opinion(facts: &Facts<'_>) -> Opinion {
    let period = match facts.oscillates() {
        Ok(period) => period,
        Err(why) => return Opinion::cannot_tell(ME, why),
    };
    let (name, stem) = match (&facts.stem, facts.integration.answer) {
        (Some(stem), _) => ("the measured stem", stem),
        (None, Integrates::No) => ("PV", &facts.y),
        (None, Integrates::Yes) => {
            return Opinion::cannot_tell(ME, "the process integrates: PV does not stand for the stem");
        }
        (None, Integrates::Unknown) => return Opinion::cannot_tell(ME, facts.integration.why()),
    };
    let step = ((period / PARTS).round() as usize).max(1);
    match shares(&symbols(&facts.u, step), &symbols(stem, step)) {
        Some(Shares { rho_1, rho_2, rho_3 }) => {
            let why = format!(
                "OP moves and {name} is steady: rho_1 {rho_1:.2}, rho_2 {rho_2:.2}, rho_3 {rho_3:.2}"
            );
            Opinion::of(ME, rho_3, BAND, why)
        }
        None => Opinion::cannot_tell(ME, "nothing moves"),
    }
}
