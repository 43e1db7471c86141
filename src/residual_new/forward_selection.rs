//! Forward selection: the likeliest effect is added, then all is asked again beside it.

use super::Kind;
use super::decide::{Decided, arx, decide, refine, scored};
use super::hypotheses::ALL;
use super::hypothesis::Hypothesis;
use super::posterior::Table;
use super::screening::Screen;
use super::valve_search::{Effort, search};
use crate::sysid::arx::ArxFit;
use crate::sysid::iddata::IdData;
use crate::sysid::valve::ValveModel;

/// Score behind the best of the screening up to which a hypothesis is looked at closely (-).
const REACH: f64 = 25.0;
/// Kinds beside which friction is searched again.
const SEARCHED: usize = 5;
/// Valves that are screened beside no friction.
const SCREENED: usize = 3;
/// Hypotheses of one kind, with friction and without, that are fitted by ARMAX.
const FITTED: usize = 2;

/// A hypothesis with its high-order ARX.
#[derive(Clone, Debug)]
struct Ranked {
    hypothesis: Hypothesis,
    kind: Option<Kind>,
    fit: ArxFit,
    score: f64,
}

impl Ranked {
    fn new(data: &IdData, hypothesis: Hypothesis, kind: Option<Kind>, near: Option<&ArxFit>) -> Self {
        let fit = arx(data, &hypothesis, near);
        let score = scored(data, &hypothesis, fit.log_likelihood);
        Self { hypothesis, kind, fit, score }
    }

    fn sticks(&self) -> bool {
        self.hypothesis.valve.is_some()
    }
}

/// The hypotheses with at most one effect more than `effects` has, fitted; `pool`: valves found before, which are offered to
/// all and added to.
pub fn compare(data: &IdData, effects: &Hypothesis, pool: &mut Vec<ValveModel>) -> Vec<Decided> {
    let effort = if pool.is_empty() { Effort::Whole } else { Effort::Near };
    let valves = search(data, effects, pool, effort);
    add(pool, valves.iter().map(|found| found.valve));
    let none = Ranked::new(data, effects.with_valve(None), None, None);
    let mut ranked = vec![none];
    for found in &valves {
        let hypothesis = effects.with_valve(Some(found.valve));
        let score = scored(data, &hypothesis, found.fit.log_likelihood);
        ranked.push(Ranked { hypothesis, kind: None, fit: found.fit.clone(), score });
    }
    propose(data, &mut ranked);
    search_beside(data, &mut ranked, pool);
    offer(data, &mut ranked, pool);
    leaders(&ranked).into_iter().map(|at| fitted(data, &ranked[at])).collect()
}

fn fitted(data: &IdData, ranked: &Ranked) -> Decided {
    let decided = decide(data, ranked.hypothesis.clone(), Some(&ranked.fit));
    if ranked.kind.is_some() { refine(data, decided) } else { decided }
}

/// Adds valves that are new.
fn add(pool: &mut Vec<ValveModel>, valves: impl Iterator<Item = ValveModel>) {
    for valve in valves {
        let same = |other: &ValveModel| {
            other.rule == valve.rule
                && (other.s / valve.s - 1.0).abs() < 2e-3
                && (other.j - valve.j).abs() < 0.02 * valve.s
        };
        if !pool.iter().any(same) {
            pool.push(valve);
        }
    }
}

/// Screens every kind beside no friction and the best valves, and ranks what is proposed.
fn propose(data: &IdData, ranked: &mut Vec<Ranked>) {
    let bases: Vec<Ranked> = ranked.iter().take(1 + SCREENED).cloned().collect();
    let mut proposed = Vec::new();
    for (at, base) in bases.iter().enumerate() {
        let signals = base.hypothesis.signals(data);
        let screen = Screen::new(data, &base.hypothesis, &signals, &base.fit);
        for hypothesis in ALL {
            for proposal in hypothesis.propose(&screen) {
                let other = base.hypothesis.with(proposal.effect);
                let other = other.with_valve(proposal.valve.or(base.hypothesis.valve));
                let promised = scored(data, &other, base.fit.log_likelihood + proposal.gain);
                proposed.push((promised, at, hypothesis.kind(), other));
            }
        }
    }
    proposed.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut count: Vec<(Kind, bool, usize)> = Vec::new();
    for (_, at, kind, hypothesis) in proposed {
        let key = (kind, hypothesis.valve.is_some());
        let seen = match count.iter_mut().find(|c| (c.0, c.1) == key) {
            Some(seen) => &mut seen.2,
            None => {
                count.push((key.0, key.1, 0));
                let last = count.len() - 1;
                &mut count[last].2
            }
        };
        *seen += 1;
        if *seen <= 2 * FITTED {
            ranked.push(Ranked::new(data, hypothesis, Some(kind), Some(&bases[at].fit)));
        }
    }
}

/// The best score of a kind, with friction or without.
fn best_of(ranked: &[Ranked], kind: Option<Kind>, sticks: bool) -> Option<&Ranked> {
    let own = ranked.iter().filter(|r| r.kind == kind && r.sticks() == sticks);
    own.max_by(|a, b| a.score.total_cmp(&b.score))
}

/// The kinds that lead, the best first.
fn leading(ranked: &[Ranked]) -> Vec<(Option<Kind>, f64)> {
    let mut kinds: Vec<(Option<Kind>, f64)> = Vec::new();
    for r in ranked {
        match kinds.iter_mut().find(|k| k.0 == r.kind) {
            Some(known) => known.1 = known.1.max(r.score),
            None => kinds.push((r.kind, r.score)),
        }
    }
    kinds.sort_by(|a, b| b.1.total_cmp(&a.1));
    let enough = kinds.first().map_or(0.0, |k| k.1) - REACH;
    kinds.retain(|k| k.1 >= enough || k.0.is_none());
    kinds
}

/// Searches friction again beside the leading effects.
fn search_beside(data: &IdData, ranked: &mut Vec<Ranked>, pool: &mut Vec<ValveModel>) {
    for (kind, _) in leading(ranked).into_iter().filter(|k| k.0.is_some()).take(SEARCHED) {
        let best = [true, false].map(|sticks| best_of(ranked, kind, sticks).cloned());
        let Some(best) = best.into_iter().flatten().max_by(|a, b| a.score.total_cmp(&b.score)) else { continue };
        let mut starts = pool.clone();
        starts.truncate(SCREENED);
        starts.extend(best.hypothesis.valve);
        let found = search(data, &best.hypothesis, &starts, Effort::Near);
        add(pool, found.iter().map(|found| found.valve));
        for found in found {
            let hypothesis = best.hypothesis.with_valve(Some(found.valve));
            let score = scored(data, &hypothesis, found.fit.log_likelihood);
            ranked.push(Ranked { hypothesis, kind, fit: found.fit, score });
        }
    }
}

/// Offers every valve that was found to every leading kind.
fn offer(data: &IdData, ranked: &mut Vec<Ranked>, pool: &[ValveModel]) {
    for (kind, _) in leading(ranked) {
        let Some(best) = best_of(ranked, kind, true).or_else(|| best_of(ranked, kind, false)).cloned() else {
            continue;
        };
        for valve in pool.iter().filter(|valve| Some(**valve) != best.hypothesis.valve) {
            let hypothesis = best.hypothesis.with_valve(Some(*valve));
            ranked.push(Ranked::new(data, hypothesis, kind, Some(&best.fit)));
        }
    }
}

/// The hypotheses that are fitted: of each leading kind the best with friction, J free and J = S, and without.
fn leaders(ranked: &[Ranked]) -> Vec<usize> {
    let kinds = leading(ranked);
    let enough = kinds.first().map_or(0.0, |k| k.1) - REACH;
    let mut order: Vec<usize> = (0..ranked.len()).collect();
    order.sort_by(|a, b| ranked[*b].score.total_cmp(&ranked[*a].score));
    let mut out: Vec<usize> = Vec::new();
    for (kind, _) in kinds {
        for class in 0..3 {
            let of_class = |r: &Ranked| match r.hypothesis.valve {
                None => class == 0,
                Some(valve) => class == if valve.j == valve.s { 1 } else { 2 },
            };
            let own = order.iter().filter(|at| ranked[**at].kind == kind && of_class(&ranked[**at]));
            let most = if class == 0 { 1 } else { FITTED };
            let own = own.take(most).filter(|at| ranked[**at].score >= enough || kind.is_none());
            out.extend(own);
        }
    }
    out
}

/// The posterior of the next effect.
pub fn table<'a>(decided: &'a [Decided], effects: &Hypothesis) -> Table<'a> {
    Table::new(decided, effects.effects.len(), ALL.len())
}
