//! What the diagnoses of the demo's loops say, counted beside what is true of them.
//!
//! As in the other tables of rates, an effect counts where a report names it, whatever its posterior and whatever its kind.
//! Candidates are not named, and do not count.

use serde_json::Value;
use std::collections::BTreeMap;
use stictiond::detectors::tally;
use stictiond::residual::Kind;
use stictiond::sim::{DemoLoop, Expected, LoadKind};

/// Most diagnoses that may have an invented effect, of 100.
pub const MOST_INVENTED: usize = 2;
/// Fewest intervals of a sticking loop that have to hold S/2, of 100.
pub const LEAST_COVERED: usize = 90;

/// One run of the diagnosis, as the API tells it.
#[derive(Clone, Debug, PartialEq)]
pub struct Diagnosis {
    /// When it ended: no two of a loop ended at the same time.
    pub time: String,
    /// A verdict, or how the run failed.
    pub outcome: String,
    /// Why nothing could be said.
    pub reason_code: Option<String>,
    /// The 95 % interval of f (% OP).
    pub f_ci95: Option<[f64; 2]>,
    /// Kinds of the effects in its report; `None` where nobody read it while it was the latest.
    pub effects: Option<Vec<String>>,
}

impl Diagnosis {
    /// An item of a loop's list of diagnoses, which has no effects; `None` for what is no such item.
    pub fn of(item: &Value) -> Option<Self> {
        let f_ci95 = match item["f_ci95"].as_array().map(Vec::as_slice) {
            Some([low, high]) => low.as_f64().zip(high.as_f64()).map(|(low, high)| [low, high]),
            _ => None,
        };
        Some(Self {
            time: item["time"].as_str()?.to_string(),
            outcome: item["outcome"].as_str()?.to_string(),
            reason_code: item["reason_code"].as_str().map(str::to_string),
            f_ci95,
            effects: None,
        })
    }

    /// Whether it ended with a report.
    pub fn has_report(&self) -> bool {
        self.tells() || self.outcome == Expected::NotIdentifiable.as_str()
    }

    /// Whether it says that the valve sticks, or that it does not.
    fn tells(&self) -> bool {
        [Expected::Stiction, Expected::NoStiction].iter().any(|own| own.as_str() == self.outcome)
    }
}

/// The effects that a loop has beside friction and linear dynamics, as it is simulated.
pub fn effects_of(demo: &DemoLoop) -> Vec<Kind> {
    let swings = demo.spec.loads.iter().any(|load| matches!(load.kind, LoadKind::Sine { .. }));
    let all = [
        (demo.truth.j < demo.truth.s, Kind::SlipJump),
        (swings, Kind::OscillatingLoad),
        (demo.spec.sensor.freeze.is_some(), Kind::FrozenPv),
    ];
    all.into_iter().filter_map(|(is_there, kind)| is_there.then_some(kind)).collect()
}

/// What was said of a loop, counted.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Count {
    /// All diagnoses.
    pub diagnoses: usize,
    /// Those with the verdict to expect.
    pub right: usize,
    /// Those that tell nothing, by reason; those that failed, by how.
    pub silent: BTreeMap<String, usize>,
    /// Those with at least one effect that the loop does not have.
    pub inventing: usize,
    /// These effects, by kind.
    pub invented: BTreeMap<String, usize>,
    /// Those whose effects nobody read in time.
    pub unread: usize,
    /// Of a sticking loop: those with an interval of f.
    pub intervals: usize,
    /// Of a sticking loop: those whose interval holds S/2.
    pub covering: usize,
}

impl Count {
    fn add(&mut self, demo: &DemoLoop, own: &Diagnosis) {
        self.diagnoses += 1;
        self.right += usize::from(own.outcome == demo.expected.as_str());
        if !own.tells() {
            let why = own.reason_code.as_ref().unwrap_or(&own.outcome);
            *self.silent.entry(why.clone()).or_default() += 1;
        }
        match &own.effects {
            None => self.unread += 1,
            Some(named) => {
                let there = effects_of(demo);
                let is_invented = |kind: &&String| there.iter().all(|own| own.as_str() != kind.as_str());
                let invented: Vec<&String> = named.iter().filter(is_invented).collect();
                self.inventing += usize::from(!invented.is_empty());
                invented.into_iter().for_each(|kind| *self.invented.entry(kind.clone()).or_default() += 1);
            }
        }
        if let Some([low, high]) = own.f_ci95.filter(|_| demo.truth.sticky) {
            self.intervals += 1;
            self.covering += usize::from((low..=high).contains(&(0.5 * demo.truth.s)));
        }
    }

    fn join(&mut self, other: &Count) {
        self.diagnoses += other.diagnoses;
        self.right += other.right;
        self.inventing += other.inventing;
        self.unread += other.unread;
        self.intervals += other.intervals;
        self.covering += other.covering;
        for (into, from) in [(&mut self.silent, &other.silent), (&mut self.invented, &other.invented)] {
            from.iter().for_each(|(what, n)| *into.entry(what.clone()).or_default() += n);
        }
    }
}

/// A loop and what was said of it.
pub struct Rated {
    /// What is true.
    pub demo: DemoLoop,
    /// What was said.
    pub count: Count,
}

impl Rated {
    /// Counts all diagnoses of a loop.
    pub fn new(demo: DemoLoop, diagnoses: &[Diagnosis]) -> Self {
        let mut count = Count::default();
        diagnoses.iter().for_each(|own| count.add(&demo, own));
        Self { demo, count }
    }

    fn row(&self) -> String {
        let Self { demo, count } = self;
        let has = effects_of(demo).iter().map(|kind| kind.as_str()).collect::<Vec<_>>().join(", ");
        format!(
            "| {} | {}, {} | {:.2} | {} | {} | {} | {} | {} | {} |",
            demo.id,
            demo.class.as_str(),
            demo.truth.kind,
            0.5 * demo.truth.s,
            if has.is_empty() { "-".to_string() } else { has },
            count.diagnoses,
            count.right,
            counted(&count.silent),
            counted(&count.invented),
            if demo.truth.sticky {
                format!("{} of {}", count.covering, count.intervals)
            } else {
                "-".to_string()
            },
        )
    }
}

/// The table, a row for each loop, and below it all loops together with Wilson 95 % intervals.
pub fn table(rated: &[Rated]) -> Vec<String> {
    let mut lines = vec![
        "| loop | what it is | S/2 (% OP) | effects it has | diagnoses | verdict right | not identifiable, why | effects invented | f's interval holds S/2 |"
            .to_string(),
        "|---|---|---|---|---|---|---|---|---|".to_string(),
    ];
    lines.extend(rated.iter().map(Rated::row));
    let all = together(rated);
    lines.extend([
        String::new(),
        format!("right verdict: {}", share(all.right, all.diagnoses)),
        format!("not identifiable: {}", counted(&all.silent)),
        format!(
            "an effect invented: {}; {}",
            share(all.inventing, all.diagnoses - all.unread),
            counted(&all.invented)
        ),
        format!("f's interval holds S/2, sticking loops: {}", share(all.covering, all.intervals)),
    ]);
    lines
}

/// What was promised and does not hold, a line each; empty where everything does.
pub fn broken(rated: &[Rated]) -> Vec<String> {
    let all = together(rated);
    let mut broken = Vec::new();
    let read = all.diagnoses - all.unread;
    if all.unread > 0 {
        broken.push(format!(
            "the effects were not read in time on {} of {} diagnoses",
            all.unread, all.diagnoses
        ));
    }
    if 100 * all.inventing > MOST_INVENTED * read {
        broken.push(format!(
            "an effect is invented on {} of {read} diagnoses, more than {MOST_INVENTED} %",
            all.inventing
        ));
    }
    for Rated { demo, count } in rated.iter().filter(|own| own.demo.truth.sticky) {
        let Count { covering, intervals, .. } = count;
        if *intervals == 0 {
            broken.push(format!("{}: no diagnosis has an interval of f", demo.id));
        } else if 100 * covering < LEAST_COVERED * intervals {
            broken.push(format!(
                "{}: the interval of f holds S/2 on {covering} of {intervals} diagnoses, less than {LEAST_COVERED} %",
                demo.id
            ));
        }
    }
    broken
}

fn together(rated: &[Rated]) -> Count {
    let mut all = Count::default();
    rated.iter().for_each(|own| all.join(&own.count));
    all
}

/// Hits, and the Wilson 95 % interval of their share in per cent.
fn share(hits: usize, of: usize) -> String {
    match tally::wilson(hits, of) {
        Some([low, high]) => format!("{hits} of {of} [{:.1}, {:.1}]", 100.0 * low, 100.0 * high),
        None => "-".to_string(),
    }
}

/// What there is, with its number.
fn counted(counts: &BTreeMap<String, usize>) -> String {
    if counts.is_empty() {
        return "-".to_string();
    }
    counts.iter().map(|(what, n)| format!("{what} {n}")).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use stictiond::sim::demo_plant;

    fn demo(id: &str) -> DemoLoop {
        demo_plant(1).into_iter().find(|demo| demo.id == id).expect("a loop of the demo")
    }

    fn said(outcome: &str, f_ci95: Option<[f64; 2]>, effects: &[&str]) -> Diagnosis {
        Diagnosis {
            time: "2026-01-01T00:00:00Z".into(),
            outcome: outcome.into(),
            reason_code: (outcome == "not_identifiable").then(|| "hidden_friction".into()),
            f_ci95,
            effects: Some(effects.iter().map(|kind| kind.to_string()).collect()),
        }
    }

    /// So many sound diagnoses of a sound loop, so many of them with an invented effect.
    fn sound(of: usize, inventing: usize) -> Rated {
        let one = |at: usize| said("no_stiction", None, if at < inventing { &["drift"] } else { &[] });
        Rated::new(demo("FIC101"), &(0..of).map(one).collect::<Vec<_>>())
    }

    /// So many diagnoses of a loop with S/2 = 2.5, so many of them with an interval beside it.
    fn sticking(of: usize, missing: usize) -> Rated {
        let one = |at: usize| said("stiction", Some(if at < missing { [2.0, 2.4] } else { [2.4, 2.6] }), &[]);
        Rated::new(demo("FIC102"), &(0..of).map(one).collect::<Vec<_>>())
    }

    #[test]
    fn an_effect_is_invented_where_the_loop_does_not_have_it() {
        let of = |id: &str, effects: &[&str]| {
            let count = Rated::new(demo(id), &[said("stiction", None, effects)]).count;
            (count.inventing, counted(&count.invented))
        };
        assert_eq!(of("FIC102", &["slip_jump"]), (0, "-".into()), "S and J differ");
        assert_eq!(of("FIC101", &["slip_jump"]), (1, "slip_jump 1".into()), "its valve is sound");
        assert_eq!(of("FIC104", &["oscillating_load"]), (0, "-".into()));
        assert_eq!(of("PIC302", &["frozen_pv"]), (0, "-".into()));
        assert_eq!(
            of("FIC104", &["outliers", "oscillating_load", "drift"]),
            (1, "drift 1, outliers 1".into()),
            "a diagnosis counts once"
        );
    }

    #[test]
    fn an_interval_is_counted_of_sticking_loops_and_holds_its_ends() {
        let of = |id: &str, f_ci95| {
            let count = Rated::new(demo(id), &[said("stiction", f_ci95, &[])]).count;
            (count.covering, count.intervals)
        };
        assert_eq!([of("FIC102", Some([2.4, 2.5])), of("FIC102", Some([2.5, 2.6]))], [(1, 1); 2]);
        assert_eq!([of("FIC102", Some([2.2, 2.49])), of("FIC102", Some([2.51, 2.6]))], [(0, 1); 2]);
        assert_eq!((of("FIC102", None), of("FIC101", Some([0.0, 0.3]))), ((0, 0), (0, 0)));
    }

    #[test]
    fn what_tells_nothing_is_counted_by_its_reason() {
        let failed = Diagnosis { reason_code: None, ..said("deadline_exceeded", None, &[]) };
        let silent = said("not_identifiable", None, &[]);
        let all = [silent.clone(), failed, silent.clone(), said("no_stiction", None, &[])];
        let count = Rated::new(demo("FIC101"), &all).count;
        assert_eq!((count.diagnoses, count.right), (4, 1));
        assert_eq!(counted(&count.silent), "deadline_exceeded 1, hidden_friction 2");
        // Where nothing can be told that is the right answer.
        assert_eq!(Rated::new(demo("LIC204"), &[silent]).count.right, 1);
    }

    #[test]
    fn a_promise_holds_up_to_its_bound() {
        assert_eq!(broken(&[sound(30, 1), sticking(20, 2)]), Vec::<String>::new());
        let told = broken(&[sound(30, 2), sticking(20, 3)]);
        assert_eq!(
            told,
            [
                "an effect is invented on 2 of 50 diagnoses, more than 2 %",
                "FIC102: the interval of f holds S/2 on 17 of 20 diagnoses, less than 90 %",
            ]
        );
        let silent = Rated::new(demo("FIC103"), &[said("not_identifiable", None, &[])]);
        let unread = Diagnosis { effects: None, ..said("no_stiction", None, &[]) };
        let told = broken(&[silent, Rated::new(demo("FIC101"), &[unread])]);
        assert_eq!(
            told,
            [
                "the effects were not read in time on 1 of 2 diagnoses",
                "FIC103: no diagnosis has an interval of f"
            ]
        );
    }

    #[test]
    fn every_loop_has_its_row_and_all_have_their_shares() {
        let lines = table(&[sound(30, 1), sticking(20, 2)]);
        assert_eq!(
            lines[2..],
            [
                "| FIC101 | flow, sound | 0.00 | - | 30 | 30 | - | drift 1 | - |",
                "| FIC102 | flow, strong stiction | 2.50 | slip_jump | 20 | 20 | - | - | 18 of 20 |",
                "",
                "right verdict: 50 of 50 [92.9, 100.0]",
                "not identifiable: -",
                "an effect invented: 1 of 50 [0.4, 10.5]; drift 1",
                "f's interval holds S/2, sticking loops: 18 of 20 [69.9, 97.2]",
            ]
        );
    }

    #[test]
    fn an_item_of_the_api_is_read() {
        let item = json!({
            "time": "2026-01-01T00:00:00Z", "outcome": "not_identifiable", "reason_code": "hidden_friction", "f_ci95": null,
        });
        let read = Diagnosis::of(&item).expect("an item");
        assert_eq!(read, Diagnosis { effects: None, ..said("not_identifiable", None, &[]) });
        let item = json!({ "time": "2026-01-01T00:00:00Z", "outcome": "stiction", "f_ci95": [2.4, 2.6] });
        let read = Diagnosis::of(&item).expect("an item");
        assert_eq!(read, Diagnosis { effects: None, ..said("stiction", Some([2.4, 2.6]), &[]) });
        assert!(read.has_report() && !Diagnosis { outcome: "panicked".into(), ..read }.has_report());
        assert_eq!(Diagnosis::of(&json!({ "outcome": "stiction" })), None);
    }
}
