//! Plant-wide analysis: which loops oscillate together, which of them is the source, and why a loop is not at rest. Pure: no clock, no
//! files, no randomness.
//!
//! [`analyse`] takes the windows of all loops one after the other. They may have any sampling, and end at about the same time.
//! `docs/plantwide.md` measures how often each result is right.
//!
//! | file | what it has |
//! |---|---|
//! | `window.rs`, `window/` | a record of any sampling becomes a window on an equal grid |
//! | `spectra.rs` | the spectra of all loops on common grids, and the coherence of two loops in a band |
//! | `lag.rs` | which of two loops swings later, and by how much, with its standard error |
//! | `cascade.rs` | set points that are the output of another loop |
//! | `groups.rs` | groups of loops that oscillate together |
//! | `friction.rs` | what a diagnosis says of a valve, and how well that explains a swing |
//! | `rank.rs` | which member of a group is the source, with a probability and its evidence |
//! | `signs.rs`, `cause.rs` | the features of one loop, its cause with a probability, and the sentence that operators read |
//! | `sensor.rs` | the sentences for PV's measurement as the cause |
//! | `tuning.rs` | the sentences for the tuning as the cause |
//! | `causes.rs` | the probability of every cause of a loop |
//! | `tasks.rs` | what to do first, what to do perhaps, and which loops are not at rest for a cause that is not known |

pub mod cascade;
pub mod cause;
pub mod causes;
mod friction;
pub mod groups;
pub mod lag;
pub mod rank;
mod sensor;
pub mod signs;
pub mod spectra;
pub mod tasks;
mod tuning;
pub mod window;

pub use cause::{Cause, Reason};
pub use causes::Likely;
pub use friction::Friction;
pub use groups::Group;
pub use rank::Suspect;
pub use tasks::{Part, Task, tasks};
pub use window::{Raw, Work};

use crate::indicators::margins::Margins;
use crate::indicators::noise::Spread;
use crate::indicators::oscillation::{Oscillation, oscillations};
use crate::indicators::series::{self, Values};
use crate::indicators::{Indicators, Known, indicators};
use crate::signal::Window;
use crate::sysid::spectrum::Transforms;
use cascade::{Track, is_moved};
use cause::is_judged;
use signs::Signs;
use spectra::{Span, Spectra};
use std::borrow::Cow;

/// A loop, as the plant-wide analysis takes it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlantLoop {
    /// Its name.
    pub name: String,
    /// Its window.
    pub window: Window,
    /// Mode at every sample of the window, where recorded: 1 in automatic, 0 otherwise, NaN where it is not known.
    pub mode: Option<Vec<f64>>,
    /// Whether the set point is known at each sample of the window; none where it is known at all of them.
    pub sp_known: Option<Vec<bool>>,
    /// Whether the stem was measured at each sample of the window; none where it was measured at all of them.
    pub stem_known: Option<Vec<bool>>,
    /// Time since the window's end without samples (s).
    pub silent_s: f64,
    /// The controller's output limits (OP unit), where known.
    pub op_limits: Option<(f64, f64)>,
    /// The span of OP (OP unit), where known.
    pub op_span: Option<f64>,
    /// Properties of the samples of PV and OP that thinning removes, where the window is thinned.
    pub raw: Option<Raw>,
    /// Travel of the valve by the samples, from row to row, where the window is thinned.
    pub work: Option<Work>,
    /// Whether most of the movement of PV is too fast for the window.
    pub pv_blurred: bool,
    /// Whether most of the movement of OP is too fast for the window.
    pub op_blurred: bool,
    /// Dead time of the process by a model of the loop, without the sample that passes before OP acts (s); where there is one.
    pub dead_time_s: Option<f64>,
    /// Its margins by a model without friction, where a diagnosis has one that tells them.
    pub margins: Option<Margins>,
    /// Names of the loops whose stream enters this one, where they are known.
    pub upstream: Vec<String>,
    /// The result of a diagnosis of its valve, where there was one.
    pub friction: Option<Friction>,
    /// Why a diagnosis of its valve had no result, where that was so.
    pub untold: Option<Untold>,
}

/// The loops of a plant. Each is read when it is analysed, because the windows of a large plant do not fit into memory together.
pub trait Plant {
    /// Number of loops.
    fn count(&self) -> usize;

    /// The loop with number `at`; read again, it may have newer samples.
    fn get(&self, at: usize) -> Cow<'_, PlantLoop>;

    /// The latest part of a loop whose window is thinned, at least `hour_s` (s) of it. Its rows do not depend on the length of the
    /// window. `None` where there is no more than the window.
    fn recent(&self, _at: usize, _hour_s: f64) -> Option<PlantLoop> {
        None
    }
}

impl Plant for Vec<PlantLoop> {
    fn count(&self) -> usize {
        self.len()
    }

    fn get(&self, at: usize) -> Cow<'_, PlantLoop> {
        Cow::Borrowed(&self[at])
    }
}

/// Length of the latest part of a longer record from which indicators are computed (s).
pub const HOUR_S: f64 = 3600.0;

/// Why a diagnosis of a valve had no result.
#[derive(Clone, Debug, PartialEq)]
pub struct Untold {
    /// The reason code, as `undersampled`.
    pub code: String,
    /// The reason as a clause that says what was missing.
    pub says: String,
}

/// The results for one loop.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LoopFound {
    /// Its name.
    pub name: String,
    /// Names of the loops whose stream enters this one, where they are known.
    pub upstream: Vec<String>,
    /// The result of a diagnosis of its valve, where there was one.
    pub friction: Option<Friction>,
    /// Why a diagnosis of its valve had no result, where that was so.
    pub untold: Option<Untold>,
    /// Its margins by a model without friction, where a diagnosis has one that tells them.
    pub margins: Option<Margins>,
    /// Its indicators. Where the window is thinned, those that need the samples are of its latest part.
    pub indicators: Indicators,
    /// The indicators of the latest part, where the window is thinned and there is one.
    pub recent: Option<Indicators>,
    /// Oscillations of PV, or of OP where PV does not oscillate, the largest first.
    pub oscillations: Vec<Oscillation>,
    /// The spread of OP as it was sampled (% of OP's span); none where the span is not known.
    pub op_spread: Option<Spread>,
    /// The features by which its own cause is found.
    pub signs: Signs,
    /// The loop whose output is its set point.
    pub master: Option<usize>,
    /// The group of its largest oscillation: of the groups with this member, the one whose band has the largest share of its variance.
    pub group: Option<usize>,
    /// The cause why it is not at rest; none where it is at rest or cannot be judged.
    pub reason: Option<Reason>,
    /// The probability of every cause and of rest, the largest first; empty where it cannot be judged.
    pub causes: Vec<Likely>,
}

impl LoopFound {
    /// The indicators of the longest time from which the error and the oscillation of PV can be computed: those of the window, or those
    /// of the latest part where most of the movement of PV is too fast for the window.
    pub fn told(&self) -> &Indicators {
        self.recent.as_ref().filter(|_| self.indicators.blurred).unwrap_or(&self.indicators)
    }
}

/// The results for a plant.
#[derive(Clone, Debug, PartialEq)]
pub struct Analysis {
    /// The results for every loop, in the order of the plant.
    pub loops: Vec<LoopFound>,
    /// The groups, the largest first.
    pub groups: Vec<Group>,
}

/// Analyses a plant; a loop whose values are not finite is in no group.
pub fn analyse(plant: &dyn Plant) -> Analysis {
    let mut transforms = Transforms::new();
    let (mut found, mut spans, mut slaves) = (Vec::new(), Vec::new(), Vec::new());
    for at in 0..plant.count() {
        let of = plant.get(at);
        let recent = of.raw.and_then(|_| plant.recent(at, HOUR_S));
        found.push(loop_found(&of, recent.as_ref(), &mut transforms));
        spans.push(Span::of(&of.window));
        if of.window.sp.as_deref().is_some_and(is_moved) {
            slaves.push(at);
        }
    }
    let mut grids = spectra::grids(&spans);
    let mut outputs = Vec::new();
    for (number, spectra) in grids.iter_mut().enumerate() {
        for (at, span) in spans.iter().enumerate() {
            let of = plant.get(at);
            spectra.add(span, &of.window, &mut transforms);
            // All outputs are needed only where some set point moves.
            if number == 0 && !slaves.is_empty() {
                outputs.push(Track::of(&of.window, &of.window.op));
            }
        }
    }
    cascade::masters(plant, &slaves, &outputs, Spectra::new(&spans).covered(), &mut found);
    drop(outputs);
    let swings: Vec<&[Oscillation]> = found.iter().map(|of| of.oscillations.as_slice()).collect();
    let mut groups = groups::groups(&swings, &sticking(&found), &grids);
    set_groups(&groups, &mut found);
    let mut rank = |(number, group): (usize, &Group)| {
        rank::rank(number, group, plant, &found, &grids[group.grid], &mut transforms)
    };
    let suspects: Vec<Vec<Suspect>> = groups.iter().enumerate().map(&mut rank).collect();
    groups.iter_mut().zip(suspects).for_each(|(group, suspects)| group.suspects = suspects);
    for at in 0..found.len() {
        found[at].reason = cause::reason(at, &found, &groups);
        found[at].causes = causes::causes(at, &found, &groups);
    }
    Analysis { loops: found, groups }
}

/// Whether each loop's valve clearly sticks. A master has no valve of its own, and in manual friction limits no cycle.
fn sticking(found: &[LoopFound]) -> Vec<bool> {
    let is_master = |at: usize| found.iter().any(|of| of.master == Some(at));
    let is_clear = |of: &LoopFound| of.friction.as_ref().is_some_and(Friction::is_clear);
    found.iter().enumerate().map(|(at, of)| is_clear(of) && is_judged(of) && !is_master(at)).collect()
}

/// Sets for each loop the group of its largest oscillation.
fn set_groups(groups: &[Group], found: &mut [LoopFound]) {
    let mut largest = vec![0.0; found.len()];
    for (at, group) in groups.iter().enumerate() {
        for (member, share) in group.members.iter().zip(&group.shares) {
            if *share > largest[*member] {
                largest[*member] = *share;
                found[*member].group = Some(at);
            }
        }
    }
}

/// The indicators of every loop as numbers: those of the last `hour_s` (s), and over the whole window those that need a longer time.
///
/// The rows of a thinned window are the further apart the longer it is. Where its latest part has better rows, these indicators come
/// from that: those of the last hour, the Harris index, the part of the score for a stuck valve, and all that the window does not tell
/// because PV moves too fast for it.
pub fn values(plant: &dyn Plant, found: &Analysis, hour_s: f64) -> Vec<Values> {
    let mut transforms = Transforms::new();
    let mut latest = |(at, found): (usize, &LoopFound)| {
        let recent = found.recent.as_ref().and_then(|_| plant.recent(at, hour_s));
        let of = recent.map_or_else(|| plant.get(at), Cow::Owned);
        let hour = health(&window::tail(&of, hour_s), &mut transforms).values();
        let recent = found.recent.as_ref().unwrap_or(&found.indicators);
        series::latest(&hour, &recent.values(), &found.told().values())
    };
    found.loops.iter().enumerate().map(&mut latest).collect()
}

/// The indicators of a loop.
fn health(of: &PlantLoop, transforms: &mut Transforms) -> Indicators {
    let w = &of.window;
    let share = |known: &Vec<bool>| known.iter().filter(|is| **is).count() as f64 / known.len().max(1) as f64;
    // The valve is observed while its stem is measured, or, without a stem, while OP and PV are.
    let of_stem = w.mv.as_ref().map(|_| of.stem_known.as_ref().map_or(1.0, share));
    let seen = of_stem.unwrap_or_else(|| 1.0 - w.missing());
    let seen_s = w.len() as f64 * w.ts * seen;
    let known = Known {
        mode: of.mode.as_deref(),
        op_limits: of.op_limits,
        measured: of.raw.map(|raw| (raw.step, raw.pv)),
        sp_known: of.sp_known.as_deref(),
        silent_s: of.silent_s,
        seen: Some(seen),
        travel: of.work.as_ref().map(|work| work.travel(seen_s)),
        pv_blurred: of.pv_blurred,
        op_blurred: of.op_blurred,
        dead_time_s: of.dead_time_s,
    };
    indicators(w, &known, transforms)
}

/// The results for one loop, without those that need other loops. `recent`: its latest part, where the window is thinned.
fn loop_found(of: &PlantLoop, recent: Option<&PlantLoop>, transforms: &mut Transforms) -> LoopFound {
    let recent = recent.map(|recent| health(recent, transforms));
    let whole = health(of, transforms);
    let indicators = match &recent {
        Some(recent) => whole.with_recent(recent),
        None => whole,
    };
    let mut swings = Vec::new();
    // An interpolation across gaps may oscillate by itself.
    if indicators.measured {
        swings = oscillations(&of.window.pv, of.window.ts, transforms);
        // A controller may hold PV still by moving OP.
        if swings.is_empty() {
            swings = oscillations(&of.window.op, of.window.ts, transforms);
        }
    }
    let mut found = LoopFound {
        name: of.name.clone(),
        upstream: of.upstream.clone(),
        friction: of.friction.clone(),
        untold: of.untold.clone(),
        margins: of.margins,
        indicators,
        recent,
        oscillations: swings,
        op_spread: op_spread(of),
        ..LoopFound::default()
    };
    found.signs = signs::signs(of, &found, transforms);
    found
}

/// The spread of OP as it was sampled (% of its span); none where the span is not known.
fn op_spread(of: &PlantLoop) -> Option<Spread> {
    let percent = 100.0 / of.op_span?;
    let Spread { sd, noise, finest } = of.raw.map_or_else(|| Spread::of(&of.window.op), |raw| raw.op);
    Some(Spread { sd: percent * sd, noise: percent * noise, finest: percent * finest })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use std::f64::consts::TAU;

    /// A loop whose PV is `wave` of the time in minutes, and noise.
    fn swinging(seed: u64, wave: impl Fn(f64) -> f64) -> PlantLoop {
        let noise = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(seed));
        let noisy = |(k, e): (u32, f64)| wave(f64::from(k)) + 0.2 * e;
        let pv: Vec<f64> = (0..1440_u32).zip(noise).map(noisy).collect();
        let window = Window { ts: 60.0, op: pv.clone(), pv, ..Window::default() };
        PlantLoop { name: format!("FIC{seed}"), window, ..PlantLoop::default() }
    }

    #[test]
    fn of_a_large_group_only_the_source_is_a_task() {
        let plant: Vec<PlantLoop> = (0..80).map(|seed| swinging(seed, |t| (0.2 * t).sin())).collect();
        let found = analyse(&plant);
        assert_eq!(found.groups.iter().map(|group| group.members.len()).collect::<Vec<usize>>(), [80]);
        let first = found.groups[0].suspects[0].at;
        for (at, of) in found.loops.iter().enumerate().filter(|(at, _)| *at != first) {
            let told = of.reason.as_ref().map(|own| (own.cause, own.neighbour));
            assert_eq!(told, Some((Cause::Neighbour, Some(first))), "{at}");
        }
        assert_eq!(tasks(&found).iter().map(|task| task.at).collect::<Vec<usize>>(), [first]);
    }

    #[test]
    fn a_loop_is_judged_by_the_group_of_its_largest_oscillation() {
        // Four swing at 31 min, two at 79 min, and one of them does both, the slow one more.
        let (fast, slow) = (|t: f64| (0.2 * t).sin(), |t: f64| (0.08 * t).sin());
        let mut plant: Vec<PlantLoop> = (0..3).map(|seed| swinging(seed, fast)).collect();
        plant.push(swinging(3, |t| 0.6 * fast(t) + slow(t)));
        plant.push(swinging(4, slow));
        plant[3].friction = Some(Friction::of(true, 100.0, false));
        let found = analyse(&plant);
        let sizes: Vec<usize> = found.groups.iter().map(|group| group.members.len()).collect();
        assert_eq!((sizes, found.loops[3].group), (vec![4, 2], Some(1)));
        let sticks = |group: &Group| {
            let own = group.suspects.iter().find(|suspect| suspect.at == 3);
            own.map(|suspect| suspect.signs[rank::SIGNS - 1] > 0.0)
        };
        // Its valve starts one of the two swings.
        assert_eq!((sticks(&found.groups[0]), sticks(&found.groups[1])), (Some(false), Some(true)));
    }

    #[test]
    fn one_sure_swing_takes_in_a_loop_that_it_explains_though_its_own_was_not_noticed() {
        let fast = |t: f64| (0.2 * t).sin();
        // A larger wave beside it hides it from whoever looks at the loop alone.
        let hidden = |by: f64| move |t: f64| by * fast(t) + (0.31 * t + 3.0 * (0.011 * t).sin()).sin();
        let groups = |by: f64| {
            let found = analyse(&vec![swinging(1, fast), swinging(2, hidden(by))]);
            let slowest = found.loops[1].oscillations.iter().map(|own| own.period_s).fold(0.0, f64::max);
            assert!(slowest < 1500.0, "31 min is not noticed alone: {slowest}");
            found.groups.iter().map(|group| group.members.len()).collect::<Vec<usize>>()
        };
        // 26 % of the variance, and 8 %.
        assert_eq!((groups(0.6), groups(0.3)), (vec![2], vec![]));
    }

    #[test]
    fn a_swing_too_fast_for_the_grid_of_long_records_is_a_group_too() {
        // 28 h at 5 s: on 8,192 steps each is 12.2 s long.
        let one = |name: usize| {
            let noise = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(name as u64));
            let period = if name < 3 { 18.0 } else { 2000.0 };
            let wave = |(k, e): (u32, f64)| (TAU * 5.0 * f64::from(k) / period).sin() + 0.2 * e;
            let pv: Vec<f64> = (0..20_000_u32).zip(noise).map(wave).collect();
            let window = Window { ts: 5.0, op: pv.clone(), pv, ..Window::default() };
            PlantLoop { name: format!("FIC{name}"), window, ..PlantLoop::default() }
        };
        let found = analyse(&(0..6).map(one).collect::<Vec<PlantLoop>>());
        let mut groups: Vec<(usize, Vec<usize>)> =
            found.groups.iter().map(|group| (group.grid, group.members.clone())).collect();
        groups.iter_mut().for_each(|group| group.1.sort_unstable());
        groups.sort_unstable();
        assert_eq!(groups, [(0, vec![3, 4, 5]), (1, vec![0, 1, 2])]);
    }

    #[test]
    fn short_records_are_compared_with_the_end_of_long_ones() {
        // At 10 s for 12 h, and at 1 s for the last 70 min of them; all swing at 3 min.
        let one = |name: usize, ts: f64, hours: f64| {
            let t0 = 3600.0 * (12.0 - hours);
            let noise = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(name as u64));
            let wave = |(k, e): (usize, f64)| (TAU * (t0 + k as f64 * ts) / 180.0).sin() + 0.2 * e;
            let pv: Vec<f64> = (0..(3600.0 * hours / ts) as usize).zip(noise).map(wave).collect();
            let window = Window { t0, ts, op: pv.clone(), pv, ..Window::default() };
            PlantLoop { name: format!("FIC{name}"), window, ..PlantLoop::default() }
        };
        let mut plant: Vec<PlantLoop> = (0..5).map(|name| one(name, 10.0, 12.0)).collect();
        plant.extend((5..8).map(|name| one(name, 1.0, 70.0 / 60.0)));
        let found = analyse(&plant);
        // One group, not one on each grid.
        assert_eq!(found.groups.iter().map(|group| group.members.len()).collect::<Vec<usize>>(), [8]);
        assert!(found.loops.iter().all(|of| of.group == Some(0)));
        // Without the short ones it is what the long ones alone make of it.
        plant.truncate(5);
        let found = analyse(&plant);
        assert_eq!(
            found.groups.iter().map(|group| (group.grid, group.members.len())).collect::<Vec<_>>(),
            [(0, 5)]
        );
    }
}
