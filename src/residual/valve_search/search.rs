//! The search itself: its grids, its rounds of alternating maximisation, and the valves it returns.
//!
//! `valve_search/mod.rs` has the idea, and says what a family and a rank are.

use super::beam::FixedDynamics;
use super::cells::Family;
use super::cost::{RESOLUTIONS, cost};
use super::successive_halving::successive_halving;
use crate::residual::hypothesis::Hypothesis;
use crate::sysid::arx::{Arx, ArxFit};
use crate::sysid::criterion::{deviance_penalty, score};
use crate::sysid::iddata::IdData;
use crate::sysid::stats::quantile;
use crate::sysid::valve::batch::{Batch, LANES};
use crate::sysid::valve::{Rest, StopRule, ValveModel};

/// Values of S in the grid.
const VALUES: usize = 20;
/// Power by which they are denser towards 0: weak friction is a small share of the largest reversal.
const CROWDED: f64 = 1.6;
/// Stop rules and ratios J/S in the grid: those whose likelihood is broad.
const GRID: [(StopRule, f64); 4] =
    [(StopRule::Reversal, 1.0), (StopRule::Reversal, 0.5), (StopRule::Reversal, 0.1), (StopRule::Stop, 1.0)];
/// Finer grids about the best values: step as a share of S, and how many of the values before are refined.
const FINER: [(f64, usize); 3] = [(0.02, 4), (0.007, 3), (0.0025, 2)];
/// Stop rules and J/S (`None`: free) of the valves that successive halving searches for: those whose likelihood is a needle.
const STAGED: [(StopRule, Option<f64>); 3] =
    [(StopRule::Stop, None), (StopRule::Slip, None), (StopRule::Slip, Some(1.0))];
/// How many of the best of each are kept, and the least relative distance of their S.
const OF_STAGED: (usize, f64) = (2, 0.02);
/// Fewest reversals of a stem that tell anything about S: those of two cycles.
pub const LEAST_REVERSALS: f64 = 4.0;
/// Valves of the grid that are starts.
const STARTS: usize = 3;
/// Least S, as a share of the largest: below it friction cannot be told from none.
const LEAST_S: f64 = 0.01;
/// Factor to each side of S in a beam search over every family with the dynamics of the leader.
const WIDE: f64 = 3.0;
/// The same over a valve's own family with its own dynamics, which are right near its S only.
const NARROW: f64 = 1.1;
/// Most rounds of alternating maximisation: where nothing is known of the valve, and where valves are given.
const ROUNDS: (usize, usize) = (8, 3);
/// Rounds in which the leader's dynamics are tried with every family.
const EVERY: usize = 2;
/// Score behind the best up to which a valve is the start of a round (-).
const REACH: f64 = 60.0;
/// Valves of a beam search that are ranked with dynamics of their own.
const RANKED: usize = 16;
/// Rank above that of the start up to which they are fitted (-): the weights of outliers may change a deviance so much.
const WORTH: f64 = 40.0;
/// Valves returned, each of another class.
const RETURNED: usize = 4;
/// Ratios J/S tried where J is in the lag alone: number of steps, their width, and the width of the finer ones.
const LAGS: (i32, f64, f64) = (13, 0.1, 0.02);
/// Most positions of the stem at the start that are tried.
const RESTS: usize = 48;

/// A valve with its fit.
#[derive(Clone, Debug)]
pub struct Found {
    /// The valve, without what the effects change in it.
    pub valve: ValveModel,
    /// The high-order ARX with its stem.
    pub fit: ArxFit,
    /// Its score: tempered log-likelihood less the penalty of the valve (-).
    pub score: f64,
}

/// Which searches are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effort {
    /// Grid, successive halving, and alternating maximisation from their best.
    Whole,
    /// Alternating maximisation from the valves given.
    Near,
    /// Alternating maximisation from the valves given and the best of the coarse grid, each within its own family.
    Same,
    /// The grid alone.
    Grid,
}

/// Searches for the valves with the largest scores beside some effects. Returns the best of each stop rule, with J = S and
/// with J free, the best first; none where no stem reverses often enough.
///
/// * `effects`: a hypothesis; its effects are held, its valve is not used.
/// * `starts`: valves to start from.
pub fn search(data: &IdData, effects: &Hypothesis, starts: &[ValveModel], effort: Effort) -> Vec<Found> {
    let (y, shapes) = (effects.pv(data), effects.shapes(data));
    let mut search = Search::new(data, effects, (&y, &shapes));
    starts.iter().for_each(|valve| search.fit(*valve, None));
    if matches!(effort, Effort::Whole | Effort::Grid) {
        search.grid().into_iter().take(STARTS).for_each(|valve| search.fit(valve, None));
    }
    if effort == Effort::Same {
        search.coarse().into_iter().take(1).for_each(|valve| search.fit(valve, None));
    }
    if effort == Effort::Whole {
        search.successive_halving();
    }
    let rounds = match effort {
        Effort::Whole => ROUNDS.0,
        Effort::Near | Effort::Same => ROUNDS.1,
        Effort::Grid => 0,
    };
    // No round is left in which every family is tried.
    search.full_rounds = if effort == Effort::Same { EVERY } else { 0 };
    for _ in 0..rounds {
        if !search.alternate() {
            break;
        }
    }
    search.finish()
}

/// The range of S: from the least that can be told from none to the largest at which a stem reverses (standard deviations of OP).
pub(super) fn range_of_s(data: &IdData) -> (f64, f64) {
    (2.0 * LEAST_S * data.f_max, 2.0 * data.f_max)
}

/// The range of S about that of a valve, by a factor to each side.
pub(super) fn range_about(data: &IdData, valve: &ValveModel, by: f64) -> (f64, f64) {
    let (least, most) = range_of_s(data);
    ((valve.s / by).max(least).min(0.5 * most), (valve.s * by).min(most))
}

/// The state of a search.
pub(super) struct Search<'a> {
    data: &'a IdData,
    effects: &'a Hypothesis,
    shapes: &'a [Vec<f64>],
    pub(super) arx: Arx<'a>,
    /// What the effects change in every valve: its asymmetry, drift and stops.
    full: ValveModel,
    /// The fitted valves, and whether each was the start of a round.
    found: Vec<(Found, bool)>,
    /// Rounds in which every family was tried.
    full_rounds: usize,
}

impl<'a> Search<'a> {
    /// A search without valves yet. `y`: PV less the offset of the effects; `shapes`: those of the effects' loads.
    pub(super) fn new(
        data: &'a IdData,
        effects: &'a Hypothesis,
        (y, shapes): (&'a [f64], &'a [Vec<f64>]),
    ) -> Self {
        let mut full = ValveModel::default();
        effects.effects.iter().for_each(|effect| effect.change_valve(&mut full));
        let arx = Arx::new(data, y, shapes);
        Self { data, effects, full, shapes, arx, found: Vec::new(), full_rounds: 0 }
    }

    /// The stem of a valve as the process sees it.
    pub(super) fn stem(&self, valve: ValveModel) -> Vec<f64> {
        let hypothesis = self.effects.with_valve(Some(valve));
        hypothesis.to_process(self.data, hypothesis.stem(self.data).0)
    }

    /// Fits a valve, unless it was fitted already. `near`: an ARX fit whose weights are nearly right.
    fn fit(&mut self, valve: ValveModel, near: Option<&ArxFit>) {
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

    /// Fits the best valves of successive halving, over the families whose likelihood is a needle.
    fn successive_halving(&mut self) {
        for (rule, ratio) in STAGED {
            let family = Family { rule, ratio, resolution: 0.0 };
            let rate = |short: &IdData, valves: &[ValveModel]| {
                self.deviances(short, &Arx::new(short, &self.effects.pv(short), self.shapes), valves)
            };
            let found = successive_halving(self.data, &self.full, family, range_of_s(self.data), rate);
            let mut taken: Vec<f64> = Vec::new();
            for valve in found {
                if taken.len() < OF_STAGED.0 && taken.iter().all(|s| (valve.s / s - 1.0).abs() > OF_STAGED.1)
                {
                    taken.push(valve.s);
                    self.fit(valve, None);
                }
            }
        }
    }

    /// The deviances `-2 ln L` of valves on `data`, each with dynamics of its own (-). Infinite where the stem reverses too seldom in
    /// the whole record.
    pub(super) fn deviances(&self, data: &IdData, arx: &Arx<'_>, valves: &[ValveModel]) -> Vec<f64> {
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

    /// The valves with their ranks, deviance plus twice the penalty over tau, the best (least) first. Infinite deviances are left out.
    fn ranked(&self, valves: &[ValveModel]) -> Vec<(f64, ValveModel)> {
        let n = self.data.counted();
        let costs = valves.iter().map(|valve| deviance_penalty(cost(Some(valve)).0, n));
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

    /// Valve `i`, from 1 to [`VALUES`], of the coarse grid of a stop rule and J/S.
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

    /// The best valve of each stop rule and J/S of the grid, refined, the best first.
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

    /// One round of alternating maximisation. It starts from the best valve that was no start yet, and returns false where there is
    /// none.
    ///
    /// The thresholds are searched for with the dynamics of that valve, and the best of them are fitted with dynamics of their own.
    /// Where that valve leads, every family is searched, otherwise its own. Then its lag, its resolution and its position at the
    /// start are varied.
    fn alternate(&mut self) -> bool {
        let leader = self.found.iter().map(|f| f.0.score).fold(f64::NEG_INFINITY, f64::max);
        let open = self.found.iter_mut().filter(|(found, used)| !used && found.score > leader - REACH);
        let Some(next) = open.max_by(|a, b| a.0.score.total_cmp(&b.0.score)) else { return false };
        next.1 = true;
        let start = next.0.clone();
        let leads = start.score == leader;
        let fixed = FixedDynamics::new(self.data, self.effects, &start.fit, &self.stem(start.valve));
        let every = leads && self.full_rounds < EVERY;
        self.full_rounds += usize::from(every);
        let range = range_about(self.data, &start.valve, if every { WIDE } else { NARROW });
        let own = self.ranked(&[start.valve]).first().map_or(f64::INFINITY, |own| own.0);
        for family in families(&start.valve) {
            if !every && class_of_family(family) != class_of(&start.valve) {
                continue;
            }
            let found = fixed.beam_search(family, range, &self.full, RANKED, f64::INFINITY);
            let plain: Vec<ValveModel> = found
                .into_iter()
                .map(|(_, valve)| ValveModel { asymmetry: 0.0, drift: 0.0, stops: None, ..valve })
                .collect();
            let ranked = self.ranked(&plain);
            let worth = |valve: &&(f64, ValveModel)| valve.0 < own + WORTH;
            let best = ranked.first().filter(worth);
            let first = ranked.iter().find(|r| Some(&r.1) == plain.first()).filter(worth);
            for valve in best.into_iter().chain(first) {
                self.fit(valve.1, Some(&start.fit));
            }
        }
        self.fit_best_lag(&start);
        self.fit_best_resolution(&start, own);
        self.fit_best_position(&start, own);
        true
    }

    /// Fits the valve as one that rests at reversals only, with the likeliest kinetic lag `(S - J)/2`.
    fn fit_best_lag(&mut self, of: &Found) {
        let s = of.valve.s;
        let with =
            |ratio: f64| ValveModel { j: ratio * s, rule: StopRule::Reversal, resolution: 0.0, ..of.valve };
        let coarse: Vec<ValveModel> = (0..=LAGS.0).map(|i| with(LAGS.1 * f64::from(i))).collect();
        let Some(best) = self.ranked(&coarse).first().copied() else { return };
        let ratio = best.1.j / s;
        let fine: Vec<ValveModel> =
            (-4..=4).map(|i| with((ratio + LAGS.2 * f64::from(i)).max(0.0))).collect();
        let Some(best) = self.ranked(&fine).first().copied() else { return };
        self.fit(best.1, Some(&of.fit));
    }

    /// Fits the valve as one that also comes to rest at small steps of OP, with its J or with J = S, where that ranks better. `own`:
    /// its rank as it is.
    fn fit_best_resolution(&mut self, of: &Found, own: f64) {
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
        best.into_iter().for_each(|best| self.fit(best.1, Some(&of.fit)));
    }

    /// Fits the valve from another position at the start where that ranks better, and the valve with J = S from its best position.
    /// `own`: its rank from its own position.
    fn fit_best_position(&mut self, of: &Found, own: f64) {
        let tied = ValveModel { j: of.valve.s, ..of.valve };
        for (valve, least) in [(of.valve, own), (tied, f64::INFINITY)] {
            let band = ValveModel { asymmetry: self.full.asymmetry, drift: self.full.drift, ..valve };
            let others: Vec<ValveModel> = initial_positions(self.data, &band)
                .into_iter()
                .map(|rest| ValveModel { rest, ..valve })
                .collect();
            let best = self.ranked(&others).first().copied().filter(|best| best.0 < least);
            best.into_iter().for_each(|best| self.fit(best.1, Some(&of.fit)));
            if tied == of.valve {
                break;
            }
        }
    }

    /// The best valve of each class, the best first.
    fn finish(self) -> Vec<Found> {
        let mut found: Vec<Found> = self.found.into_iter().map(|found| found.0).collect();
        found.sort_by(|a, b| b.score.total_cmp(&a.score));
        let mut seen = Vec::new();
        found.retain(|found| {
            let new = !seen.contains(&class_of(&found.valve));
            seen.push(class_of(&found.valve));
            new
        });
        found.truncate(RETURNED);
        found
    }
}

/// Positions of the stem at the start: one of each range from which the first slip comes at the same sample, the widest range
/// first.
pub(super) fn initial_positions(data: &IdData, valve: &ValveModel) -> Vec<Rest> {
    let u0 = data.u[data.start.index];
    let grown = valve.growth(data.start.index, data.split);
    let (s, ahead) = (valve.s * grown, if valve.rule == StopRule::Reversal { 0.0 } else { valve.j * grown });
    let mut all: Vec<(f64, Rest)> = Vec::new();
    for turned in [false, true] {
        let direction = if data.start.is_max != turned { 1.0 } else { -1.0 };
        let band = s * (1.0 + valve.asymmetry * direction);
        // Along its direction, the stem reverses at a new low of OP and goes on at a new high. So the borders of the ranges are
        // these lows and highs.
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

/// The families of a beam search about a valve: free J, J = S, and the valve's own J/S without a threshold in J.
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

/// The class of a valve: its stop rule, and whether J = S. The best valve of each class is kept.
fn class_of(valve: &ValveModel) -> (StopRule, bool) {
    (valve.rule, valve.j == valve.s)
}

/// The class of the valves of a family.
fn class_of_family(family: Family) -> (StopRule, bool) {
    (family.rule, family.ratio == Some(1.0))
}
