//! The plant as a whole, as the API writes it: groups, the work list, indicators.

use super::latest_look::LatestLook;
use super::rfc3339;
use crate::indicators::series::{COUNT, NAMED, Values, over};
use crate::plantwide::Part;
use crate::plantwide::cause::period;
use crate::results::words::percent;
use crate::serve::ports::{GroupSeen, Health, Overview, WorkLine};
use crate::signal::LoopId;
use crate::work::{Measure, State};
use serde::{Deserialize, Serialize};
use std::cmp::Ordering;
use std::collections::BTreeMap;
use utoipa::{IntoParams, ToSchema};

/// What the latest look at the plant found.
#[derive(Debug, Default, Serialize, ToSchema)]
pub struct GroupList {
    /// When the plant was looked at; null before the first look.
    pub time: Option<String>,
    /// How long that took (s).
    pub took_s: f64,
    /// Loops that were looked at.
    pub looked_at: usize,
    /// Loops of which nothing could be said: their record could not be used, or OP or PV was silent for longer than a period of
    /// the looks and ten of its sampling intervals.
    pub skipped: Vec<SkippedLoop>,
    /// Groups, the largest first.
    pub items: Vec<GroupItem>,
}

/// A loop that could not be looked at.
#[derive(Debug, Serialize, ToSchema)]
pub struct SkippedLoop {
    /// Its name.
    pub id: String,
    /// Why.
    pub why: String,
}

/// Loops that swing together.
#[derive(Debug, Serialize, ToSchema)]
pub struct GroupItem {
    /// Counted from 1, the largest first; another look counts anew.
    pub number: usize,
    /// Period (s).
    pub period_s: f64,
    /// In a sentence.
    pub words: String,
    /// Its loops, the strongest first.
    pub members: Vec<String>,
    /// Who may have started it, the likeliest first: members with good samples over half of the time that were not in manual for
    /// more than half of it.
    pub suspects: Vec<SuspectItem>,
}

/// A loop that may have started a group.
#[derive(Debug, Serialize, ToSchema)]
pub struct SuspectItem {
    /// Its name.
    pub id: String,
    /// Probability, given that one of the suspects started it (0..1).
    pub probability: f64,
    /// What speaks for it, the strongest first.
    pub evidence: Vec<String>,
}

/// A group with its pictures.
#[derive(Debug, Serialize, ToSchema)]
pub struct GroupDetail {
    /// When the plant was looked at.
    pub time: Option<String>,
    /// The group.
    #[serde(flatten)]
    pub group: GroupItem,
    /// Trends, spectra, interaction graph and coherence, each an SVG image without colours of its own.
    pub pictures: Vec<PictureItem>,
}

/// A picture.
#[derive(Debug, Serialize, ToSchema)]
pub struct PictureItem {
    /// What it shows.
    pub caption: String,
    /// An SVG element.
    pub svg: String,
}

impl GroupList {
    /// Of an overview.
    pub fn of(found: &Overview) -> Self {
        let skipped = found.skipped.iter();
        Self {
            time: rfc3339(found.at),
            took_s: found.took_s,
            looked_at: found.looked_at,
            skipped: skipped.map(|(id, why)| SkippedLoop { id: id.to_string(), why: why.clone() }).collect(),
            items: found.groups.iter().enumerate().map(|(at, own)| GroupItem::of(at + 1, own)).collect(),
        }
    }
}

fn names(ids: &[LoopId]) -> Vec<String> {
    ids.iter().map(LoopId::to_string).collect()
}

impl GroupItem {
    /// The group with a number.
    pub fn of(number: usize, own: &GroupSeen) -> Self {
        let suspect = |(id, probability, evidence): &(LoopId, f64, Vec<String>)| SuspectItem {
            id: id.to_string(),
            probability: *probability,
            evidence: evidence.clone(),
        };
        let suspects: Vec<SuspectItem> = own.suspects.iter().map(suspect).collect();
        let swing =
            format!("{} loops swing together with a period of {}", own.members.len(), period(own.period_s));
        let words = match suspects.first() {
            Some(first) if first.probability >= 0.5 => {
                format!("{swing}. {} is the suspected source ({}).", first.id, percent(first.probability))
            }
            Some(first) => {
                format!(
                    "{swing}. No source stands out; {} is the likeliest ({}).",
                    first.id,
                    percent(first.probability)
                )
            }
            None => format!("{swing}."),
        };
        Self { number, period_s: own.period_s, words, members: names(&own.members), suspects }
    }
}

impl GroupDetail {
    /// The group with a number; `None` where there is none.
    pub fn of(found: &Overview, number: usize) -> Option<Self> {
        let own = found.groups.get(number.checked_sub(1)?)?;
        let pictures = own.pictures.iter().flat_map(|pictures| pictures.each());
        let item = |(svg, caption): (&str, &str)| PictureItem { caption: caption.into(), svg: svg.into() };
        Some(Self {
            time: rfc3339(found.at),
            group: GroupItem::of(number, own),
            pictures: pictures.map(item).collect(),
        })
    }
}

/// Query of the work list.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
pub struct WorkQuery {
    /// True for those that are over too, and those that are only watched yet.
    pub all: bool,
}

/// The work list.
#[derive(Debug, Serialize, ToSchema)]
pub struct WorkListing {
    /// Now.
    pub time: Option<String>,
    /// Orders that somebody has something to do for, in all.
    pub standing: usize,
    /// Loops that are not at rest for a cause that is not known, in all: there is nothing to order yet.
    pub unknown: usize,
    /// Suspicions that have not lasted yet, in all.
    pub watched: usize,
    /// What to do first comes first, then what to do perhaps, then the loops whose cause is not known.
    pub items: Vec<WorkItem>,
}

/// One thing to do.
#[derive(Debug, Serialize, ToSchema)]
pub struct WorkItem {
    /// The loop to look at.
    pub id: String,
    /// The part of the list: `first` for what to do first, `perhaps` where the cause is less likely than 0.8 or nothing is gained by
    /// removing it, `unknown` for a loop whose cause is not known; null for what is watched or over.
    #[schema(value_type = Option<String>, example = "first")]
    pub part: Option<&'static str>,
    /// Where it stands.
    #[schema(value_type = String, example = "open")]
    pub state: &'static str,
    /// Since when.
    pub since: Option<String>,
    /// When the loop was first suspected.
    pub first: Option<String>,
    /// Why the loop is not at rest: `valve`, `tuning`, `load`, `sensor`, `saturation` or `unknown`.
    #[schema(value_type = Option<String>, example = "valve")]
    pub cause: Option<&'static str>,
    /// Probability of the cause (0..1), the mean over the looks; null where the cause is not known.
    pub probability: Option<f64>,
    /// In a sentence.
    pub why: String,
    /// Loops that may calm down with it, by the latest look: those of which it is the source with a probability of 1/2 or more.
    /// None where that look suspected nothing, or could not judge the loop.
    pub victims: Vec<String>,
    /// What the swing of all of these costs by the latest look; null where nobody gave prices, or the loops were not looked at.
    pub cost: Option<f64>,
    /// Its unit.
    pub cost_unit: Option<String>,
    /// Who acted last.
    pub by: Option<String>,
    /// What they said.
    pub note: Option<String>,
    /// How often a repair did not help.
    pub reopened: u32,
    /// How the loop was before it was repaired.
    pub before: Option<MeasureItem>,
    /// How it was after that, by the looks that decided whether the repair helped; null before.
    pub after: Option<MeasureItem>,
}

/// An order after somebody has acted.
#[derive(Debug, Serialize, ToSchema)]
pub struct WorkActed {
    /// The order.
    #[serde(flatten)]
    pub order: WorkItem,
    /// Whether that is durable: false without a store, or while it fails.
    pub survives_restart: bool,
}

/// How a loop was, in the mean over some looks.
#[derive(Debug, Serialize, ToSchema)]
pub struct MeasureItem {
    /// Standard deviation of the error (PV unit).
    pub error_sd: Option<f64>,
    /// Share of the error's variance in oscillations (0..1).
    pub swing: Option<f64>,
    /// Friction, as the loop's diagnosis tells it; null where none was made of what the looks are of.
    pub f: Option<f64>,
}

impl From<&Measure> for MeasureItem {
    fn from(own: &Measure) -> Self {
        Self { error_sd: own.error_sd, swing: own.swing, f: own.f }
    }
}

impl WorkItem {
    /// One line.
    pub fn of(line: &WorkLine) -> Self {
        let order = &line.order;
        let cause = order.cause();
        Self {
            id: order.id.to_string(),
            part: order.part().map(Part::as_str),
            state: order.state.as_str(),
            since: rfc3339(order.since),
            first: rfc3339(order.first),
            cause: cause.map(|(cause, _)| cause.as_str()),
            probability: cause.and_then(|(_, probability)| probability),
            why: order.why.as_ref().map(|(_, why)| why.clone()).unwrap_or_default(),
            victims: names(&order.victims),
            cost: line.cost.as_ref().map(|(cost, _)| *cost),
            cost_unit: line.cost.as_ref().map(|(_, unit)| unit.clone()),
            by: order.by.clone(),
            note: order.note.clone(),
            reopened: order.reopened,
            before: order.before.as_ref().map(|(own, _)| own.into()),
            after: order.after.as_ref().map(MeasureItem::from),
        }
    }
}

impl WorkListing {
    /// The lines that are wanted, what to do first first.
    pub fn of(lines: Vec<WorkLine>, all: bool, now: f64) -> Self {
        let mut lines: Vec<((u8, [f64; 3]), WorkLine)> =
            lines.into_iter().map(|line| (line.rank(), line)).collect();
        lines.sort_by(|((state, a), one), ((other, b), two)| {
            let by_number = a.iter().zip(b).map(|(a, b)| b.total_cmp(a)).find(|own| own.is_ne());
            let by_number = by_number.unwrap_or(Ordering::Equal);
            other.cmp(state).then(by_number).then_with(|| one.order.id.cmp(&two.order.id))
        });
        let of_part = |part: Part| lines.iter().filter(|(_, line)| line.order.part() == Some(part)).count();
        Self {
            time: rfc3339(now),
            standing: of_part(Part::First) + of_part(Part::Perhaps),
            unknown: of_part(Part::Unknown),
            watched: lines.iter().filter(|(_, line)| line.order.state == State::Watched).count(),
            items: lines
                .iter()
                .filter(|(_, line)| all || line.order.part().is_some())
                .map(|(_, line)| WorkItem::of(line))
                .collect(),
        }
    }
}

/// What somebody says when they act on an order.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct WorkBody {
    /// Who acts; ignored for who is logged in.
    pub by: Option<String>,
    /// A remark, as the number of the order.
    pub note: Option<String>,
}

/// The indicators of a loop.
#[derive(Debug, Serialize, ToSchema)]
pub struct LoopHealth {
    /// What each is, in the order of every list of values.
    pub names: Vec<IndicatorName>,
    /// The latest look (`hour`), and the means of the latest `shift` (8 h), `day` (24 h) and `week` (168 h) up to it; of
    /// `error_sd` the standard deviation about the mean of all that time, of `period_s` and `regularity`, which have no mean, those
    /// of the look with the largest swing, and of `harris` and its interval the means of the looks with the latest dead time. In each
    /// of them `score`, `swing`, `period_s`, `regularity` and `settling_s` are of looks at the whole record, a week at most. A
    /// value is null where good samples cover less than half of its time, and all of `hour` where the latest look is older than
    /// two periods of the looks.
    pub over: BTreeMap<&'static str, Vec<Option<f64>>>,
    /// Every look of the latest week, oldest first. Where the latest one is older than two periods of the looks, the last is the
    /// one that was due, without values.
    pub looks: Vec<IndicatorPoint>,
    /// The mean of each day of UTC that has ended, oldest first.
    pub days: Vec<IndicatorPoint>,
    /// What the latest look found beside the indicators; null before the first since the start, and where it is older than two
    /// periods of the looks.
    pub latest: Option<LatestLook>,
}

/// One indicator.
#[derive(Debug, Serialize, ToSchema)]
pub struct IndicatorName {
    /// Its name.
    pub name: &'static str,
    /// Its unit; `PV` and `OP` stand for the tags' own, `PV²` for its square, `-` for none.
    pub unit: &'static str,
    /// What it is.
    pub meaning: &'static str,
}

/// All indicators at one time.
#[derive(Debug, Serialize, ToSchema)]
pub struct IndicatorPoint {
    /// When.
    pub time: Option<String>,
    /// In the order of `names`.
    pub values: Vec<Option<f64>>,
}

/// Names of the times that are averaged over, and their length (s).
const OVER: [(&str, f64); 3] = [("shift", 28_800.0), ("day", 86_400.0), ("week", 604_800.0)];

impl From<&Health> for LoopHealth {
    fn from(own: &Health) -> Self {
        // The last look, or that which was due last where there was none.
        let now = own.looks.last().map_or(0.0, |(t, _)| *t);
        let means = OVER.map(|(name, length_s)| {
            let looks = own.looks.iter().filter(|(t, _)| now - t < length_s).map(|(_, values)| values);
            (name, over(looks).to_vec())
        });
        let latest = own.looks.last().map_or([None; COUNT], |(_, values)| *values);
        let point =
            |(t, values): &(f64, Values)| IndicatorPoint { time: rfc3339(*t), values: values.to_vec() };
        Self {
            names: NAMED.map(|(name, unit, meaning)| IndicatorName { name, unit, meaning }).into(),
            over: means.into_iter().chain([("hour", latest.to_vec())]).collect(),
            looks: own.looks.iter().map(point).collect(),
            days: own.days.iter().map(point).collect(),
            latest: own.last.as_ref().map(LatestLook::from),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plantwide::Cause;
    use crate::work::{self, Order, Seen};

    fn words(probability: f64) -> String {
        let (a, b) = (LoopId::new("FIC101"), LoopId::new("LIC102"));
        let suspects = vec![(a.clone(), probability, Vec::new())];
        let own = GroupSeen { period_s: 60.0, members: vec![a, b], suspects, pictures: None };
        GroupItem::of(1, &own).words
    }

    #[test]
    fn no_source_is_certain() {
        let swing = "2 loops swing together with a period of 60 s. ";
        for (probability, said) in [
            (0.997, "FIC101 is the suspected source (> 99 %)."),
            (0.7, "FIC101 is the suspected source (70 %)."),
            (0.3, "No source stands out; FIC101 is the likeliest (30 %)."),
            (0.004, "No source stands out; FIC101 is the likeliest (< 1 %)."),
        ] {
            assert_eq!(words(probability), format!("{swing}{said}"));
        }
    }

    #[test]
    fn an_unknown_cause_has_no_probability_and_is_not_before_a_known_one() {
        let line = |name: &str, cause: Cause, probability: Option<f64>, worth: f64| {
            let mut order = Order::new(LoopId::new(name), 0.0);
            let (why, victims) = ("it swings".to_string(), vec![LoopId::new("B")]);
            let seen = Seen { cause, probability, worth, why, gains_nothing: false, victims };
            order.take(Some(&seen), Measure::default(), 0.0, 3600.0, &work::Config::default());
            WorkLine { order, cost: None }
        };
        let lines = vec![
            line("A", Cause::Unknown, None, 1.0),
            line("B", Cause::Valve, Some(0.6), 1.0),
            line("C", Cause::Unknown, None, 1.8),
            line("D", Cause::Tuning, Some(0.9), 1.0),
        ];
        let items = WorkListing::of(lines, true, 7200.0).items;
        assert_eq!(items.iter().map(|own| own.id.as_str()).collect::<Vec<_>>(), ["C", "D", "B", "A"]);
        let said: Vec<Option<f64>> = items.iter().map(|own| own.probability).collect();
        assert_eq!(said, [None, Some(0.9), Some(0.6), None]);
        assert_eq!(
            (items[0].why.as_str(), items[0].victims.as_slice()),
            ("it swings", &["B".to_string()][..])
        );
    }

    #[test]
    fn a_loop_whose_cause_is_not_known_is_listed_below_and_is_nothing_to_do() {
        let line = |name: &str, state: State, cause: Cause, probability: f64, gains_nothing: bool| {
            let mut order = Order { state, ..Order::new(LoopId::new(name), 0.0) };
            let (why, victims) = (String::new(), Vec::new());
            let probability = (cause != Cause::Unknown).then_some(probability);
            // The one that is worth least is first.
            let seen = Seen {
                cause,
                probability,
                worth: 2.0 - probability.unwrap_or(0.0),
                why,
                gains_nothing,
                victims,
            };
            order.take(Some(&seen), Measure::default(), 0.0, 3600.0, &work::Config::default());
            WorkLine { order, cost: None }
        };
        let lines = || {
            vec![
                line("watched", State::Watched, Cause::Valve, 0.99, false),
                line("unknown", State::Unexplained, Cause::Unknown, 0.0, false),
                line("opened", State::Open, Cause::Unknown, 0.0, false),
                line("unlikely", State::Open, Cause::Valve, 0.5, false),
                line("useless", State::Open, Cause::Sensor, 0.9, true),
                line("likely", State::Open, Cause::Valve, 0.95, false),
                line("wanted", State::Ordered, Cause::Valve, 0.4, false),
                line("over", State::Calmed, Cause::Valve, 0.99, false),
            ]
        };
        let told = |listing: &WorkListing| -> Vec<(String, Option<&'static str>)> {
            listing.items.iter().map(|item| (item.id.clone(), item.part)).collect()
        };
        let own = |id: &str, part: &'static str| (id.to_string(), Some(part));
        let listing = WorkListing::of(lines(), false, 7200.0);
        let listed = [
            own("wanted", "first"),
            own("likely", "first"),
            own("unlikely", "perhaps"),
            own("useless", "perhaps"),
            own("opened", "unknown"),
            own("unknown", "unknown"),
        ];
        assert_eq!(told(&listing), listed);
        assert_eq!((listing.standing, listing.unknown, listing.watched), (4, 2, 1));
        let all = told(&WorkListing::of(lines(), true, 7200.0));
        assert_eq!(all[6..], [("watched".to_string(), None), ("over".to_string(), None)]);
    }

    #[test]
    fn an_act_says_beside_the_order_whether_it_is_kept() {
        let order = WorkItem::of(&WorkLine { order: Order::new(LoopId::new("FIC101"), 0.0), cost: None });
        let told = serde_json::to_value(WorkActed { order, survives_restart: false }).expect("JSON");
        assert_eq!(told["id"], "FIC101");
        assert_eq!(told["state"], "watched");
        assert_eq!(told["survives_restart"], false);
    }

    #[test]
    fn what_was_due_and_did_not_come_is_no_hour() {
        let hour = 3600.0;
        let look = |at: f64| (at * hour, [Some(50.0); COUNT]);
        let there = Health { looks: vec![look(1.0), look(2.0)], days: Vec::new(), last: None };
        let found = LoopHealth::from(&there);
        assert_eq!((found.over["hour"][0], found.over["shift"][0]), (Some(50.0), Some(50.0)));
        // Since then none came: a shift of eight hours up to now has the second alone, and later none.
        for (due, shift) in [(9.5, Some(50.0)), (12.0, None)] {
            let mut late = there.clone();
            late.looks.push((due * hour, [None; COUNT]));
            let found = LoopHealth::from(&late);
            assert_eq!((found.over["hour"][0], found.over["shift"][0]), (None, shift));
            assert_eq!(found.over["day"][0], Some(50.0));
        }
    }
}
