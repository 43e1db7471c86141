//! The plant, not only the loop: which loops swing together, which of them started it, and why each loop is not at rest.
//! Pure: no clock, no files, no randomness.
//!
//! [`analyse`] takes the windows of all loops, of any sampling, over about the same time, one after the other. `spectra` brings them to one grid,
//! `groups` finds those that swing together, `rank` says which is likeliest the source, `cause` gives every loop a cause, `tasks`
//! says what to do first.
//! How often each is right is measured in `docs/plantwide.md`.

pub mod cause;
pub mod groups;
pub mod rank;
pub mod signs;
pub mod spectra;
pub mod tasks;
pub mod window;

pub use cause::{Cause, Reason};
pub use groups::Group;
pub use rank::Suspect;
pub use tasks::{Task, tasks};

use crate::indicators::oscillation::{Oscillation, oscillations};
use crate::indicators::series::{self, Values};
use crate::indicators::{Indicators, Known, indicators};
use crate::signal::Window;
use crate::sysid::spectrum::Transforms;
use signs::Signs;
use spectra::{Span, Spectra, Track};
use std::borrow::Cow;

/// A loop, as the plant-wide analysis takes it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlantLoop {
    /// Its tag.
    pub name: String,
    /// Its window.
    pub window: Window,
    /// 1 in automatic, 0 otherwise, at every sample of the window, where recorded.
    pub mode: Option<Vec<f64>>,
    /// The controller's output limits (OP unit), where known.
    pub op_limits: Option<(f64, f64)>,
    /// Tags of loops whose stream enters it, where somebody knows them.
    pub upstream: Vec<String>,
    /// What a diagnosis of its valve said, where there was one.
    pub friction: Option<Friction>,
}

/// The loops of a plant, each asked for when it is looked at: of a large plant not all windows fit into memory at once.
pub trait Plant {
    /// How many there are.
    fn count(&self) -> usize;

    /// One of them; asked again, it may have newer samples.
    fn get(&self, at: usize) -> Cow<'_, PlantLoop>;
}

impl Plant for Vec<PlantLoop> {
    fn count(&self) -> usize {
        self.len()
    }

    fn get(&self, at: usize) -> Cow<'_, PlantLoop> {
        Cow::Borrowed(&self[at])
    }
}

/// What a diagnosis said of a valve.
#[derive(Clone, Debug, PartialEq)]
pub struct Friction {
    /// Whether it sticks.
    pub sticks: bool,
    /// Posterior of friction (0..1).
    pub probability: f64,
    /// In words.
    pub says: String,
}

/// What was found of one loop.
#[derive(Clone, Debug, PartialEq)]
pub struct LoopFound {
    /// Its tag.
    pub name: String,
    /// Tags of loops whose stream enters it, where somebody knows them.
    pub upstream: Vec<String>,
    /// What a diagnosis of its valve said, where there was one.
    pub friction: Option<Friction>,
    /// Its indicators.
    pub indicators: Indicators,
    /// Oscillations of PV, the largest first.
    pub oscillations: Vec<Oscillation>,
    /// What its own cause is told by.
    pub signs: Signs,
    /// The loop whose output is its set point.
    pub master: Option<usize>,
    /// The group of its largest oscillation.
    pub group: Option<usize>,
    /// Why it is not at rest; none where nothing is wrong with it.
    pub reason: Option<Reason>,
}

/// What was found of a plant.
#[derive(Clone, Debug, PartialEq)]
pub struct Analysis {
    /// Every loop, in the order given.
    pub loops: Vec<LoopFound>,
    /// Groups, the largest first.
    pub groups: Vec<Group>,
}

/// Analyses a plant; a loop whose values are not finite is in no group.
pub fn analyse(plant: &dyn Plant) -> Analysis {
    let mut transforms = Transforms::new();
    let (mut found, mut spans, mut slaves) = (Vec::new(), Vec::new(), Vec::new());
    for at in 0..plant.count() {
        let of = plant.get(at);
        found.push(one(&of, &mut transforms));
        spans.push(Span::of(&of.window));
        if of.window.sp.as_deref().is_some_and(is_moved) {
            slaves.push(at);
        }
    }
    let mut spectra = Spectra::new(&spans);
    let mut outputs = Vec::new();
    for (at, span) in spans.iter().enumerate() {
        let of = plant.get(at);
        spectra.add(span, &of.window, &mut transforms);
        // Only a cascade asks for all outputs.
        if !slaves.is_empty() {
            outputs.push(Track::of(&of.window, &of.window.op));
        }
    }
    masters(plant, &slaves, &outputs, &mut found);
    drop(outputs);
    let swings: Vec<&[Oscillation]> = found.iter().map(|of| of.oscillations.as_slice()).collect();
    let mut groups = groups::groups(&swings, &spectra);
    for group in &mut groups {
        group.suspects = rank::rank(group, plant, &found, &spectra, &mut transforms);
    }
    for (at, group) in groups.iter().enumerate() {
        for member in &group.members {
            found[*member].group.get_or_insert(at);
        }
    }
    for at in 0..found.len() {
        found[at].reason = cause::reason(at, &found, &groups);
    }
    Analysis { loops: found, groups }
}

/// Of every loop the indicators of its last `hour_s` as numbers, those that need longer over all of its window.
pub fn values(plant: &dyn Plant, found: &Analysis, hour_s: f64) -> Vec<Values> {
    let mut transforms = Transforms::new();
    let mut latest = |(at, found): (usize, &LoopFound)| {
        let hour = health(&window::tail(&plant.get(at), hour_s), &mut transforms).values();
        series::latest(&hour, &found.indicators.values())
    };
    found.loops.iter().enumerate().map(&mut latest).collect()
}

fn health(of: &PlantLoop, transforms: &mut Transforms) -> Indicators {
    let known = Known { mode: of.mode.as_deref(), op_limits: of.op_limits, ..Known::default() };
    indicators(&of.window, &known, transforms)
}

fn one(of: &PlantLoop, transforms: &mut Transforms) -> LoopFound {
    let indicators = health(of, transforms);
    let mut swings = oscillations(&of.window.pv, of.window.ts, transforms);
    // A controller may keep PV still at the cost of its output.
    if swings.is_empty() {
        swings = oscillations(&of.window.op, of.window.ts, transforms);
    }
    let mut found = LoopFound {
        name: of.name.clone(),
        upstream: of.upstream.clone(),
        friction: of.friction.clone(),
        indicators,
        oscillations: swings,
        signs: [0.0; signs::SIGNS],
        master: None,
        group: None,
        reason: None,
    };
    found.signs = signs::signs(of, &found, transforms);
    found
}

/// Whether a set point moves as another's output does: one set by hand moves seldom.
fn is_moved(sp: &[f64]) -> bool {
    /// Changes, as a share of the samples.
    const MOVES: f64 = 0.2;
    sp.windows(2).filter(|w| w[0] != w[1]).count() as f64 > MOVES * sp.len() as f64
}

/// Finds cascades: a set point that moves as another loop's output does, but for scale.
fn masters(plant: &dyn Plant, slaves: &[usize], outputs: &[Track], found: &mut [LoopFound]) {
    /// Squared correlation of a set point with its master's output: the same numbers, but for rounding and sampling.
    const SAME: f64 = 0.95;
    for &slave in slaves {
        let of = plant.get(slave);
        let Some(sp) = &of.window.sp else { continue };
        let sp = Track::of(&of.window, sp);
        let best = outputs
            .iter()
            .enumerate()
            .filter(|(i, _)| *i != slave)
            .map(|(i, output)| (i, spectra::correlation(&sp, output)))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        found[slave].master = best.filter(|best| best.1 > SAME).map(|best| best.0);
    }
}
