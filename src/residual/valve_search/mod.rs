//! The search for the valve beside given effects: a grid, then a beam search over cells of thresholds, by turns with the
//! dynamics (alternating maximisation).

mod beam;
mod cells;
mod hidden;
mod staged;
#[cfg(test)]
mod tests;

use super::effect::EffectModel;
use super::hypotheses::{Proposal, best};
use super::hypothesis::Hypothesis;
use super::screening::Screen;
use crate::sysid::arx::{Arx, ArxFit};
use crate::sysid::criterion::{REGULAR, TEMPERING, THRESHOLD, score};
use crate::sysid::iddata::IdData;
use crate::sysid::stats::quantile;
use crate::sysid::valve::batch::{Batch, LANES};
use crate::sysid::valve::{Rest, StopRule, ValveModel};
use beam::Held;
use cells::Family;
pub use hidden::hidden;
use staged::staged;

/// Values of S in the grid: finer towards 0, since weak friction is a small share of the largest reversal.
const VALUES: usize = 20;
/// Power by which they crowd there.
const CROWDED: f64 = 1.6;
/// Rules and ratios J/S in the grid: those whose thresholds are no needles.
const GRID: [(StopRule, f64); 4] =
    [(StopRule::Reversal, 1.0), (StopRule::Reversal, 0.5), (StopRule::Reversal, 0.1), (StopRule::Stop, 1.0)];
/// Finer grids about the best: steps as shares of S, and about how many of the values before.
const FINER: [(f64, usize); 3] = [(0.02, 4), (0.007, 3), (0.0025, 2)];
/// Rules and J/S of the valves that are sought by successive halving.
const STAGED: [(StopRule, Option<f64>); 3] =
    [(StopRule::Stop, None), (StopRule::Slip, None), (StopRule::Slip, Some(1.0))];
/// The best of each that are kept, and the least distance of their S, as a share.
const OF_STAGED: (usize, f64) = (2, 0.02);
/// Fewest reversals of a stem that says anything about S.
pub const LEAST_REVERSALS: f64 = 4.0;
/// Valves of the grid that are fitted.
const STARTS: usize = 3;
/// Least S, as a share of the largest.
const LEAST_S: f64 = 0.01;
/// Factor to each side of S in a beam: of every family about the leader, of a valve's own, and beside another effect.
const WIDE: f64 = 3.0;
const NARROW: f64 = 1.1;
const BANDED: f64 = 1.6;
/// Valves from which beams start, at most: where nothing is known of the valve, and where it is.
const ROUNDS: (usize, usize) = (8, 3);
/// How often the leader's dynamics are tried with every family.
const EVERY: usize = 2;
/// Score behind the best up to which a valve is a start (-).
const REACH: f64 = 60.0;
/// Valves of a beam that are ranked with dynamics of their own.
const RANKED: usize = 16;
/// Deviance above the start's up to which they are worth a fit: weights of outliers may change so much.
const WORTH: f64 = 40.0;
/// Valves returned.
const RETURNED: usize = 4;
/// Ratios J/S tried where J is no threshold: up to this many steps, each so wide, then finer ones.
const LAGS: (i32, f64, f64) = (13, 0.1, 0.02);
/// Resolutions tried: these quantiles of the steps of OP. A stem that stops at more of them hardly moves.
const RESOLUTIONS: [f64; 7] = [0.003, 0.006, 0.0125, 0.025, 0.05, 0.1, 0.2];
/// Largest asymmetry and drift of friction: at 1 one direction, or one end of the record, would have none.
pub const MOST_UNEQUAL: f64 = 0.95;
/// Places at the start tried, at most.
const RESTS: usize = 48;

/// A valve with its fit.
#[derive(Clone, Debug)]
pub struct Found {
    /// The valve, without what the effects change about it.
    pub valve: ValveModel,
    /// The high-order ARX with its stem.
    pub fit: ArxFit,
    /// Log-likelihood less what the valve's parameters cost.
    pub score: f64,
}

/// Sum of the rates of a valve's parameters, and the alternatives it was chosen from.
pub fn cost(valve: Option<&ValveModel>) -> (f64, f64) {
    let Some(valve) = valve else { return (0.0, 1.0) };
    let of_j = match valve.rule {
        _ if valve.j == valve.s => 0.0,
        StopRule::Reversal => REGULAR,
        _ => THRESHOLD,
    };
    let resolutions = if valve.resolution > 0.0 { RESOLUTIONS.len() as f64 } else { 1.0 };
    (THRESHOLD + of_j, StopRule::ALL.len() as f64 * resolutions)
}

/// How far a search goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effort {
    /// A grid over all valves, then beams from its best.
    Whole,
    /// Beams from the valves given.
    Near,
    /// Beams from the valves given and the best of the coarse grid, with no other family.
    Same,
    /// The grid alone: whether there may be friction at all.
    Grid,
}

/// The valves that explain PV best beside the effects of `effects`, the best first and of different kinds.
pub fn search(data: &IdData, effects: &Hypothesis, starts: &[ValveModel], effort: Effort) -> Vec<Found> {
    let (y, shapes) = (effects.pv(data), effects.shapes(data));
    let mut search = Search::new(data, effects, (&y, &shapes));
    starts.iter().for_each(|valve| search.rate(*valve, None));
    if matches!(effort, Effort::Whole | Effort::Grid) {
        search.grid().into_iter().take(STARTS).for_each(|valve| search.rate(valve, None));
    }
    if effort == Effort::Same {
        search.coarse().into_iter().take(1).for_each(|valve| search.rate(valve, None));
    }
    if effort == Effort::Whole {
        search.halve();
    }
    let rounds = match effort {
        Effort::Whole => ROUNDS.0,
        Effort::Near | Effort::Same => ROUNDS.1,
        Effort::Grid => 0,
    };
    // As if every family had been tried.
    search.every = if effort == Effort::Same { EVERY } else { 0 };
    for _ in 0..rounds {
        if !search.improve() {
            break;
        }
    }
    search.finish()
}

/// S from the least that is told from none to the largest at which a stem turns.
fn whole(data: &IdData) -> (f64, f64) {
    (2.0 * LEAST_S * data.f_max, 2.0 * data.f_max)
}

/// S about a valve's, by this factor.
fn about(data: &IdData, valve: &ValveModel, by: f64) -> (f64, f64) {
    let (least, most) = whole(data);
    ((valve.s / by).max(least).min(0.5 * most), (valve.s * by).min(most))
}

/// A search under way.
struct Search<'a> {
    data: &'a IdData,
    effects: &'a Hypothesis,
    shapes: &'a [Vec<f64>],
    arx: Arx<'a>,
    /// What the effects change about any valve.
    full: ValveModel,
    /// What was found, and whether it was a start already.
    found: Vec<(Found, bool)>,
    /// How often every family was tried.
    every: usize,
}

impl<'a> Search<'a> {
    /// `y`: PV less the offset of the effects.
    fn new(data: &'a IdData, effects: &'a Hypothesis, (y, shapes): (&'a [f64], &'a [Vec<f64>])) -> Self {
        let mut full = ValveModel::default();
        effects.effects.iter().for_each(|effect| effect.on_valve(&mut full));
        let arx = Arx::new(data, y, shapes);
        Self { data, effects, full, shapes, arx, found: Vec::new(), every: 0 }
    }

    /// The stem of a valve as the process sees it.
    fn stem(&self, valve: ValveModel) -> Vec<f64> {
        let hypothesis = self.effects.with_valve(Some(valve));
        hypothesis.to_process(self.data, hypothesis.stem(self.data).0)
    }

    /// Fits a valve, unless it was.
    fn rate(&mut self, valve: ValveModel, near: Option<&ArxFit>) {
        if !valve.is_valid() || self.found.iter().any(|(found, _)| found.valve == valve) {
            return;
        }
        let fit = self.arx.fit(&self.stem(valve), near);
        let (rate, alternatives) = cost(Some(&valve));
        let score = score(fit.log_likelihood, rate, alternatives, self.data.counted());
        if score.is_finite() {
            self.found.push((Found { valve, fit, score }, false));
        }
    }

    /// Successive halving over the valves whose thresholds may be needles.
    fn halve(&mut self) {
        for (rule, ratio) in STAGED {
            let family = Family { rule, ratio, resolution: 0.0 };
            let rate = |short: &IdData, valves: &[ValveModel]| {
                self.deviances(short, &Arx::new(short, &self.effects.pv(short), self.shapes), valves)
            };
            let found = staged(self.data, &self.full, family, whole(self.data), rate);
            let mut taken: Vec<f64> = Vec::new();
            for valve in found {
                if taken.len() < OF_STAGED.0 && taken.iter().all(|s| (valve.s / s - 1.0).abs() > OF_STAGED.1)
                {
                    taken.push(valve.s);
                    self.rate(valve, None);
                }
            }
        }
    }

    /// Deviances of valves on `data`, each with dynamics of its own; infinite where the stem hardly turns in all of the record.
    fn deviances(&self, data: &IdData, arx: &Arx<'_>, valves: &[ValveModel]) -> Vec<f64> {
        let mut stems = Vec::new();
        let mut all = Vec::with_capacity(valves.len());
        for few in valves.chunks(LANES) {
            let lanes: [ValveModel; LANES] = std::array::from_fn(|l| {
                let own = few[l.min(few.len() - 1)];
                ValveModel {
                    asymmetry: self.full.asymmetry,
                    drift: self.full.drift,
                    stops: self.full.stops,
                    ..own
                }
            });
            let mut batch = Batch::new(&lanes, data.start, self.data.split);
            batch.run(&data.u[..data.split], &mut stems);
            let turns = batch.turns();
            all.extend((0..few.len()).map(|l| {
                if turns[l] < LEAST_REVERSALS && data.split == self.data.split {
                    return f64::INFINITY;
                }
                let x: Vec<f64> = stems.iter().map(|x| x[l]).collect();
                arx.deviance(&self.effects.to_process(self.data, x))
            }));
        }
        all
    }

    /// The valves by their deviance less twice the cost, the best first.
    fn ranked(&self, valves: &[ValveModel]) -> Vec<(f64, ValveModel)> {
        let each = 2.0 * self.data.counted().ln() / TEMPERING;
        let costs = valves.iter().map(|valve| each * cost(Some(valve)).0);
        let mut ranked: Vec<(f64, ValveModel)> = self
            .deviances(self.data, &self.arx, valves)
            .into_iter()
            .zip(costs)
            .zip(valves)
            .filter(|((deviance, _), _)| deviance.is_finite())
            .map(|((deviance, cost), valve)| (deviance + cost, *valve))
            .collect();
        ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
        ranked
    }

    /// Valve `i` of a family's coarse grid, 1 to [`VALUES`].
    fn of_grid(&self, i: usize, (rule, ratio): (StopRule, f64)) -> ValveModel {
        let s = 2.0 * self.data.f_max * (i as f64 / VALUES as f64).powf(CROWDED);
        ValveModel { s, j: ratio * s, rule, ..ValveModel::default() }
    }

    /// The valves of the coarse grid, the best first.
    fn coarse(&self) -> Vec<ValveModel> {
        let all: Vec<ValveModel> =
            (1..=VALUES).flat_map(|i| GRID.map(|family| self.of_grid(i, family))).collect();
        self.ranked(&all).into_iter().map(|ranked| ranked.1).collect()
    }

    /// The grid over families and S: the best valves of different families.
    fn grid(&self) -> Vec<ValveModel> {
        let mut best: Vec<(f64, ValveModel)> = Vec::new();
        for (rule, ratio) in GRID {
            let with = |s: f64| ValveModel { s, j: ratio * s, rule, ..ValveModel::default() };
            let coarse: Vec<ValveModel> = (1..=VALUES).map(|i| self.of_grid(i, (rule, ratio))).collect();
            let mut found = self.ranked(&coarse);
            for (step, few) in FINER {
                found.truncate(few);
                let finer: Vec<ValveModel> = found
                    .iter()
                    .flat_map(|f| [-3, -2, -1, 1, 2, 3].map(|i| with(f.1.s * (1.0 + step * f64::from(i)))))
                    .filter(|v| v.s < 2.0 * self.data.f_max)
                    .collect();
                found.extend(self.ranked(&finer));
                found.sort_by(|a, b| a.0.total_cmp(&b.0));
            }
            best.extend(found.into_iter().take(1));
        }
        best.sort_by(|a, b| a.0.total_cmp(&b.0));
        best.into_iter().map(|found| found.1).collect()
    }

    /// Beams with the dynamics of the best valve that was no start yet; whether there was one.
    fn improve(&mut self) -> bool {
        let leader = self.found.iter().map(|f| f.0.score).fold(f64::NEG_INFINITY, f64::max);
        let open = self.found.iter_mut().filter(|(found, used)| !used && found.score > leader - REACH);
        let Some(next) = open.max_by(|a, b| a.0.score.total_cmp(&b.0.score)) else { return false };
        next.1 = true;
        let start = next.0.clone();
        let leads = start.score == leader;
        let held = Held::new(self.data, self.effects, &start.fit, &self.stem(start.valve));
        let every = leads && self.every < EVERY;
        self.every += usize::from(every);
        let range = about(self.data, &start.valve, if every { WIDE } else { NARROW });
        let own = self.ranked(&[start.valve]).first().map_or(f64::INFINITY, |own| own.0);
        for family in families(&start.valve) {
            if !every && kind_of(family) != kind(&start.valve) {
                continue;
            }
            let found = held.best(family, range, &self.full, RANKED);
            let plain: Vec<ValveModel> = found
                .into_iter()
                .map(|(_, valve)| ValveModel { asymmetry: 0.0, drift: 0.0, stops: None, ..valve })
                .collect();
            let ranked = self.ranked(&plain);
            let worth = |valve: &&(f64, ValveModel)| valve.0 < own + WORTH;
            let best = ranked.first().filter(worth);
            let first = ranked.iter().find(|r| Some(&r.1) == plain.first()).filter(worth);
            for valve in best.into_iter().chain(first) {
                self.rate(valve.1, Some(&start.fit));
            }
        }
        self.lags(&start);
        self.resolutions(&start, own);
        self.rests(&start, own);
        true
    }

    /// The valve as one that rests at reversals only, with the lag that explains most.
    fn lags(&mut self, of: &Found) {
        let s = of.valve.s;
        let with =
            |ratio: f64| ValveModel { j: ratio * s, rule: StopRule::Reversal, resolution: 0.0, ..of.valve };
        let coarse: Vec<ValveModel> = (0..=LAGS.0).map(|i| with(LAGS.1 * f64::from(i))).collect();
        let Some(best) = self.ranked(&coarse).first().copied() else { return };
        let ratio = best.1.j / s;
        let fine: Vec<ValveModel> =
            (-4..=4).map(|i| with((ratio + LAGS.2 * f64::from(i)).max(0.0))).collect();
        let Some(best) = self.ranked(&fine).first().copied() else { return };
        self.rate(best.1, Some(&of.fit));
    }

    /// The valve as one that comes to rest at small steps of OP, too, with its J and with S; `own`: its rank as it is.
    fn resolutions(&mut self, of: &Found, own: f64) {
        if of.valve.rule == StopRule::Slip {
            return;
        }
        let steps: Vec<f64> = self.data.u.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
        let with = |share: f64| {
            let resolution = quantile(&steps, share);
            [of.valve.j, of.valve.s].map(|j| ValveModel { j, rule: StopRule::Stop, resolution, ..of.valve })
        };
        let others: Vec<ValveModel> = RESOLUTIONS.into_iter().flat_map(with).collect();
        let best = self.ranked(&others).first().copied().filter(|best| best.0 < own);
        best.into_iter().for_each(|best| self.rate(best.1, Some(&of.fit)));
    }

    /// The valve from other places at the start, and the one with J = S from any; `own`: its rank from its own place.
    fn rests(&mut self, of: &Found, own: f64) {
        let tied = ValveModel { j: of.valve.s, ..of.valve };
        for (valve, least) in [(of.valve, own), (tied, f64::INFINITY)] {
            let band = ValveModel { asymmetry: self.full.asymmetry, drift: self.full.drift, ..valve };
            let others: Vec<ValveModel> =
                places(self.data, &band).into_iter().map(|rest| ValveModel { rest, ..valve }).collect();
            let best = self.ranked(&others).first().copied().filter(|best| best.0 < least);
            best.into_iter().for_each(|best| self.rate(best.1, Some(&of.fit)));
            if tied == of.valve {
                break;
            }
        }
    }

    /// The best first, one of each kind.
    fn finish(self) -> Vec<Found> {
        let mut found: Vec<Found> = self.found.into_iter().map(|found| found.0).collect();
        found.sort_by(|a, b| b.score.total_cmp(&a.score));
        let mut seen = Vec::new();
        found.retain(|found| {
            let new = !seen.contains(&kind(&found.valve));
            seen.push(kind(&found.valve));
            new
        });
        found.truncate(RETURNED);
        found
    }
}

/// Places of the stem at the start: one of each range from which the first slip comes at the same sample, the widest ranges
/// first.
fn places(data: &IdData, valve: &ValveModel) -> Vec<Rest> {
    let u0 = data.u[data.start.index];
    let grown = valve.growth(data.start.index, data.split);
    let (s, ahead) = (valve.s * grown, if valve.rule == StopRule::Reversal { 0.0 } else { valve.j * grown });
    let mut all: Vec<(f64, Rest)> = Vec::new();
    for turned in [false, true] {
        let direction = if data.start.is_max != turned { 1.0 } else { -1.0 };
        let band = s * (1.0 + valve.asymmetry * direction);
        // A stem turns at a new low of OP (seen in its direction), and goes on at a new high.
        let (mut low, mut high, mut borders) = (0.0, 0.0, vec![0.0, 1.0]);
        for u in &data.u[data.start.index..data.split] {
            let by = direction * (u - u0);
            if by < low && by > -band {
                low = by;
                borders.push((band + by) / s);
            } else if by > high && by < s + ahead {
                high = by;
                borders.push((by - ahead) / s);
            }
        }
        borders.retain(|b| (0.0..=1.0).contains(b));
        borders.sort_by(f64::total_cmp);
        let ranges = borders.windows(2).map(|b| (b[1] - b[0], Rest { turned, beyond: 0.5 * (b[0] + b[1]) }));
        all.extend(ranges);
    }
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    all.truncate(RESTS);
    all.into_iter().map(|(_, rest)| rest).collect()
}

/// The families of a beam search about a valve.
fn families(about: &ValveModel) -> Vec<Family> {
    let with = |rule: StopRule, ratio: Option<f64>| {
        let resolution = if rule == StopRule::Stop { about.resolution } else { 0.0 };
        Family { rule, ratio, resolution }
    };
    let free = [StopRule::Stop, StopRule::Slip].map(|rule| with(rule, None));
    let tied = StopRule::ALL.map(|rule| with(rule, Some(1.0)));
    let ratio = about.j / about.s;
    let lagging = if ratio == 1.0 { 0.5 } else { ratio };
    let lagging = with(StopRule::Reversal, Some(lagging));
    free.into_iter().chain(tied).chain([lagging]).collect()
}

/// What tells valves apart whose best are each kept: the rule, and whether J is S.
fn kind(valve: &ValveModel) -> (StopRule, bool) {
    (valve.rule, valve.j == valve.s)
}

/// The same of a family.
fn kind_of(family: Family) -> (StopRule, bool) {
    (family.rule, family.ratio == Some(1.0))
}

/// Proposals of an effect that changes the bands: the best valve of the present rule at each value of it.
pub fn banded(
    screen: &Screen<'_>,
    values: &[f64],
    set: impl Fn(&mut ValveModel, f64),
    effect: impl Fn(f64) -> Box<dyn EffectModel>,
) -> Vec<Proposal> {
    let (data, base) = (screen.data, screen.hypothesis());
    let Some(own) = base.valve else { return Vec::new() };
    let y = base.pv(data);
    let arx = Arx::new(data, &y, &screen.signals.shapes);
    let fit = arx.fit(&screen.signals.x, None);
    let held = Held::new(data, base, &fit, &screen.signals.x);
    let mut family = Family { rule: own.rule, ratio: Some(own.j / own.s), resolution: own.resolution };
    if own.j != own.s && own.rule != StopRule::Reversal {
        family.ratio = None;
    }
    let full = base.full_valve().unwrap_or(own);
    let mut rated: Vec<(f64, f64, ValveModel)> = Vec::new();
    for &value in values {
        let mut bands = full;
        set(&mut bands, value);
        if bands.asymmetry.abs() < MOST_UNEQUAL && bands.drift.abs() < MOST_UNEQUAL {
            let found = held.best(family, about(data, &own, BANDED), &bands, 1);
            rated.extend(found.into_iter().map(|(loss, valve)| (loss, value, valve)));
        }
    }
    rated.sort_by(|a, b| a.0.total_cmp(&b.0));
    rated.truncate(2);
    let proposals = rated.into_iter().map(|(_, value, valve)| {
        let plain = ValveModel { asymmetry: own.asymmetry, drift: own.drift, stops: own.stops, ..valve };
        let effect = effect(value);
        let other = base.with_valve(Some(plain)).with(effect.boxed());
        let x = other.to_process(data, other.stem(data).0);
        let gain = arx.fit(&x, Some(&fit)).log_likelihood - fit.log_likelihood;
        Proposal { effect, valve: Some(plain), gain }
    });
    best(proposals.collect(), 2)
}
