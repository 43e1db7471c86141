//! What a look says of each loop, and what an order costs by it.

use super::{Live, LiveLoop};
use crate::indicators::series::Values;
use crate::plantwide::cause::is_judged;
use crate::plantwide::{self, Analysis, HOUR_S, LoopFound, Task, tasks};
use crate::results::Summary;
use crate::serve::LoopLook;
use crate::signal::LoopId;
use crate::work::{CostConfig, Measure, Order, Said, Seen};
use std::collections::HashMap;

/// What a look says.
#[derive(Default)]
pub(super) struct LookSaid {
    /// Of the loops that it could judge, for the work list.
    pub of_loops: Vec<Said>,
    /// Indicators of every loop.
    pub values: Vec<(LoopId, Values)>,
    /// How every loop was over all of its window, or over the latest part of one that does not tell.
    pub measures: Vec<(LoopId, Measure)>,
    /// What else is found of every loop.
    pub last: Vec<(LoopId, LoopLook)>,
}

/// What the look says of each loop.
pub(super) fn said(plant: &Live<'_>, found: &Analysis) -> LookSaid {
    let todo = tasks(found);
    let by_loop: HashMap<usize, &Task> = todo.iter().map(|task| (task.at, task)).collect();
    let id = |at: usize| LoopId::new(found.loops[at].name.as_str());
    let mut said = LookSaid::default();
    for (at, own) in plantwide::values(plant, found, HOUR_S).into_iter().enumerate() {
        said.values.push((id(at), own));
        let live = &plant.loops[at];
        let known = plant.results.get(&id(at), plant.at.now);
        let f = known.and_then(|known| f_since(&known.summary?, live.from));
        let told = found.loops[at].told();
        let finite = |x: &f64| x.is_finite();
        let error_sd = told.error.map(|error| error.sd).filter(finite);
        let measure = Measure { error_sd, swing: told.swing.filter(finite), f };
        said.measures.push((id(at), measure));
        said.last.push((id(at), last(&found.loops[at], plant.at.now)));
        let seen = by_loop.get(&at).map(|task| Seen {
            cause: task.cause,
            probability: task.probability,
            worth: task.worth,
            why: task.why.clone(),
            gains_nothing: task.gains_nothing,
            victims: task.victims.iter().map(|at| id(*at)).collect(),
        });
        // Where most of the movement is too fast for the window, it does not tell rest, and the latest part does. A term of write-back
        // calms a loop and cures no valve.
        let is_blurred = found.loops[at].indicators.blurred;
        let is_told = seen.is_some() || !is_blurred || told.swing == Some(0.0);
        let is_told = is_told && !plant.history.term_acted(&id(at), live.from);
        if is_told && is_judged(&found.loops[at]) && live.shows_something(seen.is_some()) {
            said.of_loops.push(Said { id: id(at), from: live.from, measure, seen });
        }
    }
    said
}

/// What a look at `now` (s) finds of a loop beside its indicators.
fn last(of: &LoopFound, now: f64) -> LoopLook {
    let (told, recent) = (of.told(), of.recent.as_ref().unwrap_or(&of.indicators));
    LoopLook {
        at: now,
        harris: recent.harris,
        dead_time_s: recent.dead_time_s,
        settling: told.settling,
        oscillations: told.oscillations.clone(),
        distribution: told.distribution,
        margins: of.margins,
    }
}

/// Friction as a diagnosis tells it that was made since a time (s): of an earlier one it is that of before a repair, maybe.
fn f_since(summary: &Summary, from: f64) -> Option<f64> {
    summary.f.filter(|_| summary.time >= from)
}

impl LiveLoop<'_> {
    /// Whether a window of a loop that is not in manual shows it at work: where nothing moves the unit is down. Without a recorded
    /// mode an OP that stands still is all that tells manual: then rest proves nothing, but what is suspected all the same, as an
    /// OP that stays at a limit, is.
    fn shows_something(&self, is_suspected: bool) -> bool {
        self.op_moves || self.pv_moves && is_suspected
    }
}

/// What an order's loop and its victims cost by their swing: price times the part of the error's standard deviation that would be
/// gone with it, `sd (1 - sqrt(1 - share))`. Both are of the same time, the whole window where that tells them: the last hour has but
/// a piece of a slow swing.
pub(super) fn cost(
    order: &Order,
    costs: &HashMap<LoopId, CostConfig>,
    measures: &HashMap<LoopId, Measure>,
) -> Option<(f64, String)> {
    cost_of(std::iter::once(&order.id).chain(&order.victims), costs, measures)
}

/// What some loops cost by their swing, as [`cost`]; `None` where none of them has a price and was looked at.
pub(super) fn cost_of<'a>(
    ids: impl Iterator<Item = &'a LoopId>,
    costs: &HashMap<LoopId, CostConfig>,
    measures: &HashMap<LoopId, Measure>,
) -> Option<(f64, String)> {
    let mut sum: Option<(f64, String)> = None;
    for id in ids {
        let (Some(price), Some(measure)) = (costs.get(id), measures.get(id)) else { continue };
        let (Some(sd), Some(swing)) = (measure.error_sd, measure.swing) else { continue };
        let cost = price.per_sd * sd * (1.0 - (1.0 - swing.clamp(0.0, 1.0)).sqrt());
        // Prices have one unit, as `check` asks.
        sum.get_or_insert_with(|| (0.0, price.unit.clone())).0 += cost;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::super::{Moment, WatchedLoop, untold_of, window};
    use super::*;
    use crate::alarm;
    use crate::history::{self, History, LoopTags, TagKind, TagSpec};
    use crate::indicators::series::NAMED;
    use crate::plantwide::{Cause, analyse};
    use crate::results::{Remembered, Restored, Results, Trigger};
    use crate::signal::{BadReason, Quality, Role, Sample, SpanSource, Window};
    use crate::work::{Act, Config, State, WorkList};
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    const NAME: &str = "FIC1";
    /// Time between samples (s).
    const STEP_S: f64 = 240.0;

    /// The rings of a loop: OP, PV and, where they are there, the mode and the term of each sample; NaN for one that is not good.
    fn rings(samples: u32, of: impl Fn(f64) -> Vec<f64>) -> History {
        rings_of(STEP_S, samples, of)
    }

    /// The same with so much time between samples (s).
    fn rings_of(step_s: f64, samples: u32, of: impl Fn(f64) -> Vec<f64>) -> History {
        let tag = |role| TagSpec { kind: TagKind::Role(role), unit: String::new(), source: String::new() };
        let own = LoopTags {
            id: LoopId::new(NAME),
            tags: [Role::Op, Role::Pv, Role::Mode, Role::Term].map(tag).to_vec(),
            op_limits: None,
            op_span: None,
            op_span_source: SpanSource::Unknown,
        };
        let samples_per_tag = history::Config::default().samples_per_tag.max(samples as usize);
        let history = History::new(&[own], &history::Config { samples_per_tag });
        for k in (0..samples).map(f64::from) {
            for (tag, value) in of(k).into_iter().enumerate() {
                let quality = if value.is_nan() { Quality::Bad(BadReason::Timeout) } else { Quality::Good };
                assert!(history.push(tag, Sample { t: step_s * k, value, quality }));
            }
        }
        history
    }

    /// A swing of 4.2 h and an amplitude of 5 in a little noise.
    fn swing(k: f64, phase: f64) -> f64 {
        5.0 * (0.1 * k + phase).sin() + (0.7 * k * k).sin()
    }

    /// When looks are an hour apart, and nothing has come since the start.
    fn moment(now: f64) -> Moment {
        Moment { now, elapsed_s: 0.0, period_s: 3600.0 }
    }

    /// A look when the last of 1,440 samples has come.
    fn look(history: &History) -> LookSaid {
        look_at(history, STEP_S * 1439.0)
    }

    fn look_at(history: &History, now: f64) -> LookSaid {
        let results = Results::new(&[LoopId::new(NAME)], 1, &alarm::Config::default());
        let of = WatchedLoop { id: LoopId::new(NAME), upstream: Vec::new() };
        let at = moment(now);
        let found = window(history, &of.id, at).expect("rings").expect("samples");
        let loops = vec![LiveLoop::new(&of, &found.window, 0.0)];
        let plant = Live { history, loops, results: &results, at };
        said(&plant, &analyse(&plant))
    }

    /// An order that is open since hour 48 of 60.
    fn opened() -> WorkList {
        let mut list = WorkList::default();
        let seen = Seen {
            cause: Cause::Valve,
            probability: Some(0.9),
            worth: 1.0,
            why: "it sticks".into(),
            gains_nothing: false,
            victims: Vec::new(),
        };
        for now in (0..60).map(|hour| 3600.0 * f64::from(hour)) {
            let (id, measure) = (LoopId::new(NAME), Measure::default());
            let said = [Said { id, from: now, measure, seen: Some(seen.clone()) }];
            list.take(&said, now, &Config::default());
        }
        assert_eq!(state(&list), State::Open);
        list
    }

    fn state(list: &WorkList) -> State {
        list.get(&LoopId::new(NAME)).expect("there").state
    }

    #[test]
    fn a_loop_in_manual_or_a_unit_that_is_down_proves_nothing() {
        let manual = rings(1440, |k| vec![swing(k, 0.0), swing(k, 0.0), 0.0]);
        let down = rings(1440, |_| vec![0.0, 0.0]);
        for history in [manual, down] {
            let found = look(&history);
            assert_eq!((found.of_loops.len(), found.values.len()), (0, 1));
            let mut repaired = opened();
            let id = LoopId::new(NAME);
            repaired.act(&id, Act::Repaired, None, None, 213_000.0).expect("there").expect("open");
            for (mut list, stays) in [(opened(), State::Open), (repaired, State::Repaired)] {
                for hour in 60..120 {
                    list.take(&found.of_loops, 3600.0 * f64::from(hour), &Config::default());
                }
                assert_eq!(state(&list), stays);
            }
        }
        let automatic = look(&rings(1440, |k| vec![swing(k, 0.0), swing(k, 0.0), 1.0]));
        assert_eq!(automatic.of_loops.len(), 1);
    }

    /// An order would be closed as calmed, or as verified, while the valve sticks as before.
    #[test]
    fn a_window_in_which_a_term_of_write_back_acted_proves_nothing() {
        let judged = |acts: &dyn Fn(f64) -> bool| {
            let term = |k: f64| if acts(k) { 2.0 } else { 0.0 };
            look(&rings(1440, |k| vec![swing(k, 0.0), swing(k, 0.0), 1.0, term(k)])).of_loops.len()
        };
        assert_eq!(judged(&|_| false), 1);
        assert_eq!(judged(&|k| (300.0..310.0).contains(&k)), 0);
        assert_eq!(judged(&|k| k == 1439.0), 0, "and it acts still");
    }

    #[test]
    fn a_window_that_is_mostly_a_gap_proves_nothing() {
        let there = |k: f64| if (200.0..1000.0).contains(&k) { f64::NAN } else { swing(k, 0.0) };
        let found = look(&rings(1440, |k| vec![there(k), there(k)]));
        assert_eq!((found.of_loops.len(), found.measures[0].1), (0, Measure::default()));
    }

    #[test]
    fn without_a_mode_an_op_that_stands_still_is_all_that_tells_manual() {
        let of = WatchedLoop { id: LoopId::new(NAME), upstream: Vec::new() };
        let empty = LiveLoop::new(&of, &Window::default(), 0.0);
        let live = |op_moves, pv_moves| LiveLoop { op_moves, pv_moves, ..empty };
        let shows = |live: LiveLoop<'_>| [false, true].map(|seen| live.shows_something(seen));
        assert_eq!(shows(live(true, true)), [true, true]);
        assert_eq!(shows(live(true, false)), [true, true]);
        assert_eq!(shows(live(false, true)), [false, true]);
        assert_eq!(shows(live(false, false)), [false, false]);
    }

    #[test]
    fn what_a_swing_costs_does_not_depend_on_where_it_stands() {
        let id = LoopId::new(NAME);
        let costs = HashMap::from([(id.clone(), CostConfig { per_sd: 1.0, unit: "EUR/day".into() })]);
        for phase in [0.0, 0.8, 1.6, 2.4] {
            let found = look(&rings(1440, |k| vec![swing(k, phase), swing(k, phase)]));
            let measures: HashMap<LoopId, Measure> = found.measures.into_iter().collect();
            let (sum, unit) = cost(&Order::new(id.clone(), 0.0), &costs, &measures).expect("a price");
            // 12.5 of the swing and 0.5 of the noise; without the swing 0.7 of 3.6 are left.
            let (sd, share) = (13f64.sqrt(), measures[&id].swing.expect("it swings"));
            assert!(share > 0.8, "{phase}: {share}");
            assert!((sum - sd * (1.0 - (1.0 - share).sqrt())).abs() < 0.1, "{phase}: {sum}");
            assert_eq!(unit, "EUR/day");
        }
    }

    #[test]
    fn a_loop_without_data_is_passed_over_and_says_since_when() {
        let id = LoopId::new(NAME);
        let seen = |history: &History, now: f64| {
            window(history, &id, moment(now)).expect("rings").map(|of| (of.silent_s, of.window.len()))
        };
        let (last, whole) = (STEP_S * 1439.0, rings(1440, |k| vec![swing(k, 0.0), swing(k, 0.0)]));
        assert_eq!(seen(&whole, last), Ok((0.0, 1440)));
        assert_eq!(seen(&whole, last + 3600.0), Ok((3600.0, 1440)));
        let since = |tag: &str, at: &str| -> Result<(f64, usize), String> {
            Err(format!("no good sample of {tag} since {at}"))
        };
        // Nothing comes any more.
        assert_eq!(seen(&whole, last + 3601.0), since("PV", "1970-01-04T23:56:00Z"));
        // A dead collector goes on saying that there is nothing.
        let died = |k: f64, x: f64| if k < 1400.0 { x } else { f64::NAN };
        let dead = rings(1440, |k| vec![died(k, swing(k, 0.0)), died(k, swing(k, 0.0))]);
        assert_eq!(seen(&dead, last), since("PV", "1970-01-04T21:16:00Z"));
        // OP alone is enough.
        let half = rings(1440, |k| vec![died(k, swing(k, 0.0)), swing(k, 0.0)]);
        assert_eq!(seen(&half, last), since("OP", "1970-01-04T21:16:00Z"));
        // Of few good samples it is their silence that is told.
        let few = rings(1440, |k| vec![swing(k, 0.0), if k < 20.0 { 1.0 } else { f64::NAN }]);
        assert_eq!(seen(&few, last), since("PV", "1970-01-01T01:16:00Z"));
    }

    #[test]
    fn a_source_whose_clock_is_off_is_silent_when_nothing_comes_and_not_before() {
        let (id, last) = (LoopId::new(NAME), STEP_S * 1439.0);
        for ahead in [-18_000.0, 18_000.0] {
            let history = rings(1440, |k| vec![swing(k, 0.0), swing(k, 0.0)]);
            // The last samples came 1,000 s after the start.
            for tag in [0, 1] {
                history.ring(tag).expect("a tag").heard().sample(last, 1000.0);
            }
            let after = |s: f64| Moment { now: last - ahead + s, elapsed_s: 1000.0 + s, period_s: 3600.0 };
            let seen = |s: f64| window(&history, &id, after(s)).expect("rings").map(|of| of.silent_s);
            assert_eq!((seen(0.0), seen(3600.0)), (Ok(0.0), Ok(3600.0)), "{ahead}");
            assert!(seen(3601.0).is_err(), "{ahead}");
            // A repair is stamped by our clock: no sample of before it may pass for one of after it.
            let of = WatchedLoop { id: id.clone(), upstream: Vec::new() };
            let found = window(&history, &id, after(0.0)).expect("rings").expect("samples");
            let live = LiveLoop::new(&of, &found.window, after(0.0).ahead_s(&history, &id));
            assert_eq!(live.from, if ahead > 0.0 { -ahead } else { 0.0 });
        }
    }

    #[test]
    fn the_latest_hour_is_that_before_now() {
        // Half of the latest hour and less has no sample, and its figures are not those of an hour before.
        let history = rings(1440, |k| vec![swing(k, 0.0), swing(k, 0.0), 1.0]);
        let hour = |late: f64| {
            let results = Results::new(&[LoopId::new(NAME)], 1, &alarm::Config::default());
            let of = WatchedLoop { id: LoopId::new(NAME), upstream: Vec::new() };
            let at = moment(STEP_S * 1439.0 + late);
            let found = window(&history, &of.id, at).expect("rings").expect("samples");
            let loops = vec![LiveLoop::new(&of, &found.window, 0.0)];
            let plant = Live { history: &history, loops, results: &results, at };
            said(&plant, &analyse(&plant)).values[0].1
        };
        let of = |late: f64, name: &str| {
            let at = NAMED.iter().position(|own| own.0 == name).expect("an indicator");
            hour(late)[at]
        };
        assert!(of(0.0, "error_sd").is_some() && of(1200.0, "error_sd").is_some());
        assert_eq!((of(2400.0, "error_sd"), of(2400.0, "service_factor")), (None, None));
    }

    #[test]
    fn a_swing_too_fast_for_the_rows_of_long_rings_is_in_the_hour_and_no_rest() {
        // 20,000 samples at 10 s are rows of 49 s, in which nothing is left of a cycle of 40 s.
        let fast = |k: f64| 5.0 * (std::f64::consts::TAU * k / 4.0 + 0.3).sin() + (0.7 * k * k).sin();
        let history = rings_of(10.0, 20_000, |k| vec![50.0 - fast(k), fast(k)]);
        let found = look_at(&history, 199_990.0);
        // What it costs is told by the latest part, and rest by neither.
        let Measure { error_sd, swing, .. } = found.measures[0].1;
        assert!((error_sd.expect("known") - 13f64.sqrt()).abs() < 0.2, "{:?}", found.measures);
        assert!(swing.expect("known") > 0.8, "{:?}", found.measures);
        assert!(found.of_loops.iter().all(|own| own.seen.is_some()), "{:?}", found.of_loops);
        // The hour has it as it was sampled, and what the window does not tell is told by the recent part.
        let at = |name: &str| NAMED.iter().position(|own| own.0 == name).and_then(|at| found.values[0].1[at]);
        assert!((at("error_sd").expect("known") - 13f64.sqrt()).abs() < 0.2, "{:?}", found.values);
        assert!(at("swing").expect("known") > 0.8 && at("score").is_some(), "{:?}", found.values);
        assert!((at("period_s").expect("known") - 40.0).abs() < 1.0, "{:?}", found.values);
    }

    /// The samples of a loop at rest: PV is white noise of 1, and OP answers it slowly.
    fn at_rest(samples: u32) -> Vec<Vec<f64>> {
        let noise = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(7));
        let mut answer = 0.0;
        let sample = |(_, pv): (u32, f64)| {
            answer = 0.8 * answer - 0.5 * pv;
            vec![50.0 + answer, pv]
        };
        (0..samples).zip(noise).map(sample).collect()
    }

    #[test]
    fn the_harris_index_of_a_look_is_for_the_dead_time_of_the_model() {
        // Looked at sample by sample, and thinned with a latest part of its own.
        for samples in [1440, 20_000] {
            let all = at_rest(samples);
            let history = rings_of(10.0, samples, |k| all[k as usize].clone());
            let results = Results::new(&[LoopId::new(NAME)], 1, &alarm::Config::default());
            let of = WatchedLoop { id: LoopId::new(NAME), upstream: Vec::new() };
            let at = moment(10.0 * f64::from(samples - 1));
            let whole = window(&history, &of.id, at).expect("rings").expect("samples");
            for dead_time_s in [None, Some(30.0)] {
                let live = LiveLoop { dead_time_s, ..LiveLoop::new(&of, &whole.window, 0.0) };
                let plant = Live { history: &history, loops: vec![live], results: &results, at };
                let found = said(&plant, &analyse(&plant));
                let values = found.values[0].1;
                let told = |name: &str| NAMED.iter().position(|own| own.0 == name).and_then(|at| values[at]);
                let last = &found.last[0].1;
                assert_eq!((told("harris_dead_time_s"), last.dead_time_s), (dead_time_s, dead_time_s));
                let index = last.harris.map(|own| own.index);
                assert!(index.is_some() && told("harris") == index, "{samples}: {index:?}");
            }
        }
    }

    #[test]
    fn a_loop_at_rest_is_mostly_noise_and_its_order_ends() {
        // Rows of seven samples have little of white noise.
        let (samples, last) = (at_rest(30_000), 299_990.0);
        let history = rings_of(10.0, 30_000, |k| samples[k as usize].clone());
        let whole = window(&history, &LoopId::new(NAME), moment(last)).expect("rings").expect("samples");
        assert!(whole.pv_blurred);
        let found = look_at(&history, last);
        assert!(found.of_loops.len() == 1 && found.of_loops[0].seen.is_none(), "{:?}", found.of_loops);
        let Measure { error_sd, swing, .. } = found.of_loops[0].measure;
        assert!((error_sd.expect("known") - 1.0).abs() < 0.05, "{error_sd:?}");
        assert_eq!(swing, Some(0.0));
        let mut list = opened();
        for hour in 60..120 {
            list.take(&found.of_loops, 3600.0 * f64::from(hour), &Config::default());
        }
        assert_eq!(state(&list), State::Calmed);
    }

    #[test]
    fn a_ring_of_the_usual_length_is_looked_at_sample_by_sample() {
        let count = history::Config::default().samples_per_tag;
        let samples = at_rest(count as u32);
        let history = rings_of(1.0, count as u32, |k| samples[k as usize].clone());
        let at = moment(count as f64);
        let found = window(&history, &LoopId::new(NAME), at).expect("rings").expect("samples");
        assert_eq!((found.window.ts, found.window.len(), found.raw), (1.0, count, None));
        let pv: Vec<f64> = samples.iter().map(|own| own[1]).collect();
        assert_eq!(found.window.pv, pv);
    }

    #[test]
    fn friction_of_before_the_window_is_not_how_a_loop_is() {
        let of = |time| Summary {
            time,
            took_s: 0.1,
            trigger: Trigger::Periodic,
            outcome: "stiction".into(),
            reason_code: None,
            reason: String::new(),
            f: Some(2.0),
            f_ci95: Some([1.9, 2.1]),
            f_in_percent: true,
            delta_aic: Some(100.0),
            compensated: None,
        };
        let since = |time| f_since(&of(time), 1000.0);
        assert_eq!((since(999.0), since(1000.0), since(2000.0)), (None, Some(2.0), Some(2.0)));
    }

    #[test]
    fn what_a_diagnosis_lacked_is_told_with_its_code() {
        let of = |outcome: &'static str, code: Option<&'static str>, reason: &str| Summary {
            time: 0.0,
            took_s: 0.1,
            trigger: Trigger::Periodic,
            outcome: outcome.into(),
            reason_code: code.map(Into::into),
            reason: reason.into(),
            f: None,
            f_ci95: None,
            f_in_percent: true,
            delta_aic: None,
            compensated: None,
        };
        let told = |summary: &Summary| untold_of(summary).map(|own| (own.code, own.says));
        let said = |code: &str, says: &str| Some((code.to_string(), says.to_string()));
        let slow = of("not_identifiable", Some("undersampled"), "undersampled: 2.2 samples per period");
        assert_eq!(told(&slow), said("undersampled", "sampled too slowly: 2.2 samples per period"));
        // The sentence behind the name of the reason is enough.
        let flat = of("not_identifiable", Some("flat_op"), "flat OP: it does not move: never");
        assert_eq!(told(&flat), said("flat_op", "it does not move: never"));
        let late = of("deadline_exceeded", None, "the run was not done before its deadline");
        assert_eq!(told(&late), said("deadline_exceeded", "the run was not done before its deadline"));
        for outcome in ["stiction", "no_stiction"] {
            assert_eq!(told(&of(outcome, None, "")), None);
        }

        // A look takes it of the latest diagnosis, also of one of before the start.
        let (id, history) = (LoopId::new(NAME), rings(1440, |k| vec![swing(k, 0.0), swing(k, 0.0)]));
        let results = Results::new(std::slice::from_ref(&id), 1, &alarm::Config::default());
        let restored = Restored {
            finished: 0.0,
            took_s: 0.1,
            quality: "good".into(),
            doubtful: false,
            structure: None,
            source: None,
            report: "{}".into(),
        };
        let kept = Remembered { diagnosed: Some((restored, slow.clone())), ..Remembered::default() };
        results.restore(&id, kept);
        let watched = WatchedLoop { id: id.clone(), upstream: Vec::new() };
        let at = moment(STEP_S * 1439.0);
        let whole = window(&history, &id, at).expect("rings").expect("samples");
        let loops = vec![LiveLoop::new(&watched, &whole.window, 0.0)];
        let found = analyse(&Live { history: &history, loops, results: &results, at });
        assert_eq!(found.loops[0].untold, untold_of(&slow));
    }

    #[test]
    fn a_look_goes_back_a_week_at_most() {
        let history = rings(4000, |k| vec![k, k]);
        let at = moment(STEP_S * 3999.0);
        let found = window(&history, &LoopId::new(NAME), at).expect("rings").expect("samples").window;
        assert_eq!((found.t0, found.op[0]), (STEP_S * 3999.0 - 604_800.0, 1479.0));
    }
}
