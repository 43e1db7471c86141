//! What a look says of each loop, and what an order costs by it.

use super::{Live, LiveLoop};
use crate::indicators::series::Values;
use crate::plantwide::{self, Analysis, Task, tasks};
use crate::results::Summary;
use crate::signal::LoopId;
use crate::work::{CostConfig, Measure, Order, Said, Seen};
use std::collections::HashMap;

/// What of a record the indicators of a look are taken from, where the record is longer (s).
const HOUR_S: f64 = 3600.0;
/// Share of the time in automatic below which nothing is said of a controller.
const IN_MANUAL: f64 = 0.5;
/// Where some of the indicators stand.
const SERVICE_FACTOR: usize = 1;
const ERROR_SD: usize = 3;
const SWING: usize = 6;

/// What a look says.
#[derive(Default)]
pub(super) struct LookSaid {
    /// Of the loops that it could judge, for the work list.
    pub of_loops: Vec<Said>,
    /// Indicators of every loop.
    pub values: Vec<(LoopId, Values)>,
    /// How every loop was over all of its window.
    pub measures: Vec<(LoopId, Measure)>,
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
        let f = plant.results.get(&id(at), plant.now).and_then(|known| f_since(&known.summary?, live.from));
        let whole = found.loops[at].indicators.values();
        let measure = Measure { error_sd: whole[ERROR_SD], swing: whole[SWING], f };
        said.measures.push((id(at), measure));
        let seen = by_loop.get(&at).map(|task| Seen {
            cause: task.cause,
            probability: task.probability,
            why: task.why.clone(),
            victims: task.victims.iter().map(|at| id(*at)).collect(),
        });
        // What is drawn through gaps proves nothing.
        let measured = found.loops[at].indicators.measured;
        if measured && live.can_be_judged(whole[SERVICE_FACTOR], seen.is_some()) {
            said.of_loops.push(Said { id: id(at), from: live.from, measure, seen });
        }
    }
    said
}

/// Friction as a diagnosis tells it that was made since a time (s): of an earlier one it is that of before a repair, maybe.
fn f_since(summary: &Summary, from: f64) -> Option<f64> {
    summary.f.filter(|_| summary.time >= from)
}

impl LiveLoop<'_> {
    /// Whether the window shows the loop at work. In manual nothing was asked of the valve, and where nothing moves the unit is
    /// down. Without a recorded mode an OP that stands still is all that tells manual: then rest proves nothing, but what is
    /// suspected all the same, as an OP that stays at a limit, is.
    fn can_be_judged(&self, service_factor: Option<f64>, is_suspected: bool) -> bool {
        let in_manual = service_factor.is_some_and(|share| share < IN_MANUAL);
        !in_manual && (self.op_moves || self.pv_moves && is_suspected)
    }
}

/// What an order's loop and its victims cost by their swing: price times the part of the error's standard deviation that would be
/// gone with it, `sd (1 - sqrt(1 - share))`. Both are of the whole window: the last hour has but a piece of a slow swing.
pub(super) fn cost(
    order: &Order,
    costs: &HashMap<LoopId, CostConfig>,
    measures: &HashMap<LoopId, Measure>,
) -> Option<(f64, String)> {
    let victims = order.seen.iter().flat_map(|seen| &seen.victims);
    let mut sum: Option<(f64, String)> = None;
    for id in std::iter::once(&order.id).chain(victims) {
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
    use super::super::{WatchedLoop, window};
    use super::*;
    use crate::alarm;
    use crate::history::{self, History, LoopTags, TagKind, TagSpec};
    use crate::plantwide::{Cause, analyse};
    use crate::results::{Results, Trigger};
    use crate::signal::{BadReason, Quality, Role, Sample, SpanSource};
    use crate::work::{Act, Config, State, WorkList};

    const NAME: &str = "FIC1";
    /// Time between samples (s).
    const STEP_S: f64 = 240.0;

    /// The rings of a loop: OP, PV and, where it is there, the mode of each sample; NaN for one that is not good.
    fn rings(samples: u32, of: impl Fn(f64) -> Vec<f64>) -> History {
        let tag = |role| TagSpec { kind: TagKind::Role(role), unit: String::new(), source: String::new() };
        let own = LoopTags {
            id: LoopId::new(NAME),
            tags: [Role::Op, Role::Pv, Role::Mode].map(tag).to_vec(),
            op_limits: None,
            op_span: None,
            op_span_source: SpanSource::Unknown,
        };
        let history = History::new(&[own], &history::Config::default());
        for k in (0..samples).map(f64::from) {
            for (tag, value) in of(k).into_iter().enumerate() {
                let quality = if value.is_nan() { Quality::Bad(BadReason::Timeout) } else { Quality::Good };
                assert!(history.push(tag, Sample { t: STEP_S * k, value, quality }));
            }
        }
        history
    }

    /// A swing of 4.2 h and an amplitude of 5 in a little noise.
    fn swing(k: f64, phase: f64) -> f64 {
        5.0 * (0.1 * k + phase).sin() + (0.7 * k * k).sin()
    }

    /// A look when the last of 1,440 samples has come.
    fn look(history: &History) -> LookSaid {
        let results = Results::new(&[LoopId::new(NAME)], 1, &alarm::Config::default());
        let of = WatchedLoop { id: LoopId::new(NAME), upstream: Vec::new() };
        let (now, period_s) = (STEP_S * 1439.0, 3600.0);
        let found = window(history, &of.id, (now, period_s)).expect("rings").expect("samples");
        let loops = vec![LiveLoop::new(&of, &found.window)];
        let plant = Live { history, loops, results: &results, now, period_s };
        said(&plant, &analyse(&plant))
    }

    /// An order that is open since hour 48 of 60.
    fn opened() -> WorkList {
        let mut list = WorkList::default();
        let seen =
            Seen { cause: Cause::Valve, probability: 0.9, why: "it sticks".into(), victims: Vec::new() };
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

    #[test]
    fn a_window_that_is_mostly_a_gap_proves_nothing() {
        let there = |k: f64| if (200.0..1000.0).contains(&k) { f64::NAN } else { swing(k, 0.0) };
        let found = look(&rings(1440, |k| vec![there(k), there(k)]));
        assert_eq!((found.of_loops.len(), found.measures[0].1), (0, Measure::default()));
    }

    #[test]
    fn without_a_mode_an_op_that_stands_still_is_all_that_tells_manual() {
        let of = WatchedLoop { id: LoopId::new(NAME), upstream: Vec::new() };
        let live = |op_moves, pv_moves| LiveLoop { of: &of, from: 0.0, op_moves, pv_moves };
        let judged = |live: LiveLoop<'_>| [false, true].map(|seen| live.can_be_judged(None, seen));
        assert_eq!(judged(live(true, true)), [true, true]);
        assert_eq!(judged(live(true, false)), [true, true]);
        assert_eq!(judged(live(false, true)), [false, true]);
        assert_eq!(judged(live(false, false)), [false, false]);
        assert!(!live(true, true).can_be_judged(Some(0.4), true));
        assert!(live(true, true).can_be_judged(Some(0.6), false));
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
            window(history, &id, (now, 3600.0)).expect("rings").map(|of| (of.silent_s, of.window.len()))
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
    fn the_latest_hour_is_that_before_now() {
        // Half of the latest hour and less has no sample, and its figures are not those of an hour before.
        let history = rings(1440, |k| vec![swing(k, 0.0), swing(k, 0.0), 1.0]);
        let hour = |late: f64| {
            let results = Results::new(&[LoopId::new(NAME)], 1, &alarm::Config::default());
            let of = WatchedLoop { id: LoopId::new(NAME), upstream: Vec::new() };
            let (now, period_s) = (STEP_S * 1439.0 + late, 3600.0);
            let found = window(&history, &of.id, (now, period_s)).expect("rings").expect("samples");
            let loops = vec![LiveLoop::new(&of, &found.window)];
            let plant = Live { history: &history, loops, results: &results, now, period_s };
            said(&plant, &analyse(&plant)).values[0].1
        };
        assert!(hour(0.0)[ERROR_SD].is_some() && hour(1200.0)[ERROR_SD].is_some());
        assert_eq!((hour(2400.0)[ERROR_SD], hour(2400.0)[SERVICE_FACTOR]), (None, None));
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
    fn a_look_goes_back_a_week_at_most() {
        let history = rings(4000, |k| vec![k, k]);
        let at = (STEP_S * 3999.0, 3600.0);
        let found = window(&history, &LoopId::new(NAME), at).expect("rings").expect("samples").window;
        assert_eq!((found.t0, found.op[0]), (STEP_S * 3999.0 - 604_800.0, 1479.0));
    }
}
