//! Yamashita 2006: qualitative shapes in the plot of OP against the stem.
//!
//! The changes of OP and stem become symbols: I (increasing), S (steady), D (decreasing). `XY` is the state in which OP does X and the
//! stem Y. A valve that sticks is in IS or DS, and leaves them as a stem that slips does.
//!
//! ```text
//! rho_1 = (t_IS + t_DS) / (t - t_SS)
//! rho_2 = (t of IS II, IS SI, DS DD, DS SD) / (t - t_SS)
//! rho_3 = rho_1 - (t of IS DD, IS DI, IS SD, IS ID, IS DS, DS DI, DS SI, DS ID, DS II, DS IS) / (t - t_SS)
//! ```
//!
//! t: number of samples; t_XY: those in state XY; t of `XY ZW`: those in runs of XY that are followed by ZW. rho_3 (-) is the index:
//! above 0.25 the valve sticks. Unrelated signals give 0.25, two of eight states.
//!
//! The states distinguish directions. So the sign of a stem that moves against OP is reversed first, and that of PV in place of a stem
//! where the process gain is negative. The sign of the gain is the one that the controller tells (`sysid::gain_sign`), otherwise that
//! of the correlation with OP behind the best dead band (`kano2004`).
//!
//! Source: An automatic method for detection of valve stiction in process control loops, Control Eng. Practice 2006, 14,
//! 503; the threshold is the author's. PV takes the place of a stem that is not measured, as in the paper, which is right for
//! flow loops. Chosen here: changes are taken over a thirtieth of a period, and a change is steady up to 0.43 standard
//! deviations, which makes the three symbols of Gaussian changes equally frequent.
//! Limits: a slow process moves PV while the stem stands still, so that sticking valves are missed; noise makes symbols
//! random and draws rho_3 below 0.25; where PV is a sample late the slip coincides with the turn of OP (DI), which rho_3 takes
//! for impossible.

use super::facts::Facts;
use super::kano2004::parallelogram;
use super::opinion::{Band, Method, Opinion};
use super::picture::{Layer, Picture, Tone, excerpt};
use crate::signal::Row;
use crate::sysid::gain_sign::gain_sign;
use crate::sysid::stats::{mean, normalised, sd};

const METHOD: Method = Method::Yamashita2006;
/// The author's threshold (-).
pub const BAND: Band = Band::at(0.25);
/// Changes are taken over the period divided by this.
const PARTS: f64 = 30.0;
/// Size of a change up to which it is steady (standard deviations): a third of Gaussian changes is.
const STEADY: f64 = 0.430_727_3;

/// The shares of the time in sticking states (-).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shares {
    /// All sticking states.
    pub rho_1: f64,
    /// Sticking states that end with a slip.
    pub rho_2: f64,
    /// Sticking states without those that end as no stem can: the index.
    pub rho_3: f64,
}

/// The symbols of a signal, by its changes over `step` samples: 1 for I, 0 for S, -1 for D.
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

/// The state of OP and stem in one symbol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// Neither moves.
    Still,
    /// The stem moves: not a sticking state.
    Moves,
    /// Sticking, and followed by a slip.
    Slips,
    /// Sticking, and followed by a state that no stem can have then.
    Impossible,
    /// Sticking, and followed by a standstill of both, or by the end of the record.
    Ends,
}

/// The states of the symbols of OP and stem.
pub fn states(u: &[i8], x: &[i8]) -> Vec<State> {
    let pairs: Vec<(i8, i8)> = u.iter().copied().zip(x.iter().copied()).collect();
    let mut found = Vec::with_capacity(pairs.len());
    for run in pairs.chunk_by(|a, b| a == b) {
        let next = pairs.get(found.len() + run.len());
        let state = match run[0] {
            (0, 0) => State::Still,
            (0, _) => State::Moves,
            (way, 0) => match next.map(|(u, x)| (way * u, way * x)) {
                Some((1 | 0, 1)) => State::Slips,
                Some((0, 0)) | None => State::Ends,
                Some(_) => State::Impossible,
            },
            _ => State::Moves,
        };
        found.extend(run.iter().map(|_| state));
    }
    found
}

/// The shares from the symbols of OP and stem; none where nothing moves.
pub fn shares(u: &[i8], x: &[i8]) -> Option<Shares> {
    Shares::of(&states(u, x))
}

impl Shares {
    fn of(states: &[State]) -> Option<Self> {
        let count = |of: &[State]| states.iter().filter(|state| of.contains(state)).count() as f64;
        let moving = states.len() as f64 - count(&[State::Still]);
        let sticking = count(&[State::Slips, State::Impossible, State::Ends]);
        (moving > 0.0).then(|| Self {
            rho_1: sticking / moving,
            rho_2: count(&[State::Slips]) / moving,
            rho_3: (sticking - count(&[State::Impossible])) / moving,
        })
    }
}

/// What the method evaluates.
struct Evaluated<'a> {
    /// Name of the stem, or of PV in its place.
    name: &'static str,
    /// Its values (standard deviations).
    stem: &'a [f64],
    /// Samples of a symbol.
    step: usize,
    /// The state in each symbol.
    states: Vec<State>,
}

fn evaluate<'a>(facts: &'a Facts<'_>) -> Result<Evaluated<'a>, String> {
    let period = facts.oscillates()?;
    let (name, stem) = facts.stem_or_pv()?;
    let step = ((period / PARTS).round() as usize).max(1);
    let sign = sign(facts, stem);
    let along_op: Vec<f64> = stem.iter().map(|x| sign * x).collect();
    Ok(Evaluated { name, stem, step, states: states(&symbols(&facts.u, step), &symbols(&along_op, step)) })
}

/// -1 where the stem, or PV in its place, moves against OP; otherwise 1.
fn sign(facts: &Facts<'_>, stem: &[f64]) -> f64 {
    let w = &facts.window;
    let of_gain = || {
        let sp = w.sp.as_ref().map(|sp| normalised(sp, mean(&w.pv), sd(&w.pv)));
        gain_sign(&facts.u, &facts.y, sp.as_deref(), |k| w.row(k) == Row::Counts)
    };
    // The controller tells the sign for PV alone: a measured stem may move against OP whatever the process gain.
    let told = if facts.stem.is_none() { of_gain() } else { None };
    told.or_else(|| Some(parallelogram(&facts.u, stem)?.sign)).unwrap_or(1.0)
}

/// OP against the stem, the sticking samples marked.
pub(super) fn picture(facts: &Facts<'_>) -> Vec<Picture> {
    let Ok(found) = evaluate(facts) else { return Vec::new() };
    let shown = excerpt(facts);
    let path = shown.clone().map(|k| (facts.u[k], found.stem[k])).collect();
    let at = |wanted: &[State]| -> Vec<(f64, f64)> {
        let state = |k: &usize| found.states.get(k / found.step).is_some_and(|state| wanted.contains(state));
        shown.clone().filter(state).map(|k| (facts.u[k], found.stem[k])).collect()
    };
    let layers = vec![
        Layer::line("path", Tone::Data, path),
        Layer::dots("stands, and then slips", Tone::Sticks, at(&[State::Slips, State::Ends])),
        Layer::dots("stands, and ends as no stem could", Tone::Sound, at(&[State::Impossible])),
    ];
    let title = format!("OP against {}: where it stands still while OP moves", found.name);
    let y = format!("{} (standard deviations)", found.name);
    vec![Picture::new(title, "OP (standard deviations)", &y, layers)]
}

/// The opinion of the method.
pub fn opinion(facts: &Facts<'_>) -> Opinion {
    let found = match evaluate(facts) {
        Ok(found) => found,
        Err(why) => return Opinion::cannot_tell(METHOD, why),
    };
    match Shares::of(&found.states) {
        Some(Shares { rho_1, rho_2, rho_3 }) => {
            let name = found.name;
            let told = BAND.told(rho_3, 2);
            let why =
                format!("OP moves and {name} is steady: rho_1 {rho_1:.2}, rho_2 {rho_2:.2}, rho_3 {told}");
            Opinion::of(METHOD, rho_3, BAND, why)
        }
        None => Opinion::cannot_tell(METHOD, "nothing moves"),
    }
}
