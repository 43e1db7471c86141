//! Orders and indicators as rows of the store, and back. They are states of a loop, as its alarms are, and lie beside them under
//! kinds of their own, so that they too are held twice. A row that is written otherwise is left out.

use crate::indicators::series::{COUNT, Values};
use crate::plantwide::Cause;
use crate::signal::LoopId;
use crate::store::{AlarmRow, Row, TransitionRow};
use crate::work::order::Look;
use crate::work::{Measure, Move, Order, State};
use std::collections::VecDeque;
use std::fmt::Write;

/// Kinds of the rows.
const WORK: &str = "work";
const HEALTH: &str = "health";
const TODAY: &str = "today";
/// What stands behind a cause by whose removal nothing is gained.
const GAINS_NOTHING: &str = "\tgains nothing";

/// A loop's indicators, day by day: when each ended (s), and its means.
pub(in crate::app) type Days = (LoopId, Vec<(f64, Values)>);

/// What the looks of a day have found of a loop so far.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::app) struct Part {
    /// When the last of these looks was (s): the day is that of this time.
    pub until: f64,
    /// Mean of each indicator.
    pub values: Values,
    /// How many looks each mean is of.
    pub counts: [u32; COUNT],
}

/// What a start goes on from: a loop's day so far, and how it was by the latest look.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::app) struct Today {
    pub id: LoopId,
    pub part: Part,
    pub measure: Measure,
}

/// All that the store has of the plant as a whole.
#[derive(Default)]
pub(in crate::app) struct KeptPlant {
    pub orders: Vec<Order>,
    pub days: Vec<Days>,
    pub todays: Vec<Today>,
}

impl KeptPlant {
    /// That which is among some states.
    pub(in crate::app) fn of(states: &[AlarmRow]) -> Self {
        Self {
            orders: states.iter().filter_map(order_of).collect(),
            days: states.iter().filter_map(health_of).collect(),
            todays: states.iter().filter_map(today_of).collect(),
        }
    }
}

/// An order and what happened to it.
pub(in crate::app) fn order_rows(order: &Order, moved: Option<&Move>) -> Vec<Row> {
    let mut trend = String::new();
    let victims: Vec<&str> = order.victims.iter().map(LoopId::as_str).collect();
    let why = order.why.as_ref().map_or("", |(cause, _)| cause.as_str());
    let gains = if order.gains_nothing { GAINS_NOTHING } else { "" };
    let _ = writeln!(trend, "{why}{gains}\n{}", victims.join("\t"));
    for look in &order.looks {
        let (cause, p) = look.cause.map_or(("-", None), |(cause, p)| (cause.as_str(), p));
        let (p, worth, own) = (field(p), look.worth, measure(&look.measure));
        let _ = writeln!(trend, "{}\t{cause}\t{p}\t{worth}\t{own}\t{}", look.at, look.from);
    }
    let before = order.before.map(|(own, at)| format!("{at}\t{}\n", measure(&own))).unwrap_or_default();
    let after = order.after.map(|own| format!("-\t{}\n", measure(&own))).unwrap_or_default();
    let row = AlarmRow {
        control_loop: order.id.to_string(),
        kind: WORK.into(),
        active: order.state.is_standing(),
        votes: format!("{} {} {}", order.state.as_str(), order.reopened, order.suspected),
        raises: format!("{before}{after}"),
        trend,
        since: Some(order.since),
        raised_at: Some(order.first),
        detail: order.why.as_ref().map(|(_, why)| why.clone()).unwrap_or_default(),
        by: order.by.clone(),
        comment: order.note.clone(),
        ..AlarmRow::default()
    };
    let mut rows = vec![Row::Alarm(row)];
    if let Some(moved) = moved {
        rows.push(Row::Transition(TransitionRow {
            control_loop: order.id.to_string(),
            kind: WORK.into(),
            at: moved.at,
            before: moved.from.as_str().into(),
            after: moved.to.as_str().into(),
            cause: if moved.by.is_some() || moved.note.is_some() { "acted" } else { "measured" }.into(),
            by: moved.by.clone(),
            comment: moved.note.clone(),
            ..TransitionRow::default()
        }));
    }
    rows
}

/// The days of a loop's indicators.
pub(in crate::app) fn health_row(id: &LoopId, days: &[(f64, Values)]) -> Row {
    let mut trend = String::new();
    for (at, values) in days {
        let _ = write!(trend, "{at}");
        for value in values {
            // Six digits are what single precision has.
            let _ = match value {
                Some(x) => write!(trend, " {}", (*x as f32)),
                None => write!(trend, " -"),
            };
        }
        trend.push('\n');
    }
    let (control_loop, kind) = (id.to_string(), HEALTH.to_string());
    Row::Alarm(AlarmRow {
        control_loop,
        kind,
        trend,
        since: days.last().map(|own| own.0),
        ..AlarmRow::default()
    })
}

/// A loop's day so far, and how it was by the latest look.
pub(in crate::app) fn today_row(id: &LoopId, part: &Part, own: &Measure) -> Row {
    let each = part.values.iter().zip(part.counts);
    let values: String = each.map(|(value, count)| format!("{count}\t{}\n", field(*value))).collect();
    Row::Alarm(AlarmRow {
        control_loop: id.to_string(),
        kind: TODAY.into(),
        trend: format!("{}\n{values}", measure(own)),
        since: Some(part.until),
        ..AlarmRow::default()
    })
}

/// An order as it was kept; `None` for a row that is none.
fn order_of(row: &AlarmRow) -> Option<Order> {
    if row.kind != WORK {
        return None;
    }
    let mut votes = row.votes.split(' ');
    let (state, reopened, suspected) = (votes.next()?, votes.next()?, number(votes.next()?)?);
    let mut lines = row.trend.lines();
    let first = lines.next().unwrap_or_default();
    let gains_nothing = first.ends_with(GAINS_NOTHING);
    let why = cause(first.trim_end_matches(GAINS_NOTHING)).map(|cause| (cause, row.detail.clone()));
    let victims = lines.next().unwrap_or_default().split('\t').filter(|name| !name.is_empty());
    let victims = victims.map(LoopId::new).collect();
    let looks: VecDeque<Look> = lines.filter_map(look).collect();
    let (mut before, mut after) = (None, None);
    for line in row.raises.lines() {
        let mut fields = line.split('\t');
        match (fields.next().and_then(number), read_measure(&mut fields)) {
            (Some(at), own) => before = Some((own, at)),
            (None, own) => after = Some(own),
        }
    }
    Some(Order {
        id: LoopId::new(row.control_loop.as_str()),
        state: State::named(state)?,
        since: row.since?,
        first: row.raised_at?,
        suspected,
        why,
        gains_nothing,
        victims,
        looks,
        before,
        after,
        by: row.by.clone(),
        note: row.comment.clone(),
        reopened: reopened.parse().ok()?,
    })
}

/// The days of a loop as they were kept; `None` for a row that has none.
fn health_of(row: &AlarmRow) -> Option<Days> {
    let day = |line: &str| {
        let mut fields = line.split(' ');
        let at = fields.next().and_then(number)?;
        let mut values: Values = [None; COUNT];
        // A later version may have more of them.
        values.iter_mut().zip(fields).for_each(|(value, field)| *value = number(field));
        Some((at, values))
    };
    let days = || row.trend.lines().filter_map(day).collect();
    (row.kind == HEALTH).then(|| (LoopId::new(row.control_loop.as_str()), days()))
}

/// A loop's day so far as it was kept; `None` for a row that has none.
fn today_of(row: &AlarmRow) -> Option<Today> {
    if row.kind != TODAY {
        return None;
    }
    let mut lines = row.trend.lines();
    let measure = read_measure(&mut lines.next()?.split('\t'));
    let mut part = Part { until: row.since?, values: [None; COUNT], counts: [0; COUNT] };
    // An earlier version had fewer of them: the others are not known.
    for ((value, count), line) in part.values.iter_mut().zip(&mut part.counts).zip(lines) {
        let (of, mean) = line.split_once('\t')?;
        (*value, *count) = (number(mean), of.parse::<u32>().ok()?);
    }
    Some(Today { id: LoopId::new(row.control_loop.as_str()), part, measure })
}

fn number(field: &str) -> Option<f64> {
    field.parse::<f64>().ok().filter(|x| x.is_finite())
}

fn field(x: Option<f64>) -> String {
    x.map_or("-".to_string(), |x| x.to_string())
}

fn measure(own: &Measure) -> String {
    format!("{}\t{}\t{}", field(own.error_sd), field(own.swing), field(own.f))
}

fn read_measure<'a>(fields: &mut impl Iterator<Item = &'a str>) -> Measure {
    let mut next = || fields.next().and_then(number);
    Measure { error_sd: next(), swing: next(), f: next() }
}

fn cause(name: &str) -> Option<Cause> {
    Cause::ALL.into_iter().find(|cause| cause.as_str() == name)
}

fn look(line: &str) -> Option<Look> {
    let mut fields = line.split('\t');
    let at = number(fields.next()?)?;
    let (cause, probability, worth) =
        (cause(fields.next()?), number(fields.next()?), number(fields.next()?)?);
    let measure = read_measure(&mut fields);
    let from = number(fields.next()?)?;
    Some(Look { at, from, cause: cause.map(|cause| (cause, probability)), worth, measure })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::indicators::series::NAMED;
    use crate::work::{Act, Config, Said, Seen, WorkList};

    #[test]
    fn an_order_comes_back_as_it_was() {
        let (mut list, id, config) = (WorkList::default(), LoopId::new("FIC1"), Config::default());
        let seen = |hour: u32| {
            let (cause, probability) =
                if hour < 7 { (Cause::Unknown, None) } else { (Cause::Valve, Some(0.875)) };
            let victims = vec![LoopId::new("LIC1"), LoopId::new("TIC 2")];
            let (why, gains_nothing) = ("it sticks".to_string(), cause == Cause::Valve);
            Seen { cause, probability, worth: 2.25, why, gains_nothing, victims }
        };
        for hour in 0..60_u32 {
            let seen = (hour % 10 != 3).then(|| seen(hour));
            let measure = Measure { error_sd: Some(1.5), swing: None, f: Some(0.1 * f64::from(hour)) };
            let now = 3600.0 * f64::from(hour);
            list.take(&[Said { id: id.clone(), from: now - 8640.5, measure, seen }], now, &config);
        }
        let (by, note) = (Some("Ann".to_string()), Some("new packing".to_string()));
        let acted = list.act(&id, Act::Repaired, by, note, 3.0e5).expect("there").expect("open");
        let rows = order_rows(&acted.0, Some(&acted.1));
        let [Row::Alarm(row), Row::Transition(moved)] = &rows[..] else { panic!("{rows:?}") };
        assert_eq!(
            (moved.before.as_str(), moved.after.as_str(), moved.cause.as_str()),
            ("open", "repaired", "acted")
        );
        assert!(acted.0.gains_nothing && acted.0.why.is_some(), "{:?}", acted.0);
        assert_eq!(order_of(row).as_ref(), Some(&acted.0));
        let useful = Order { gains_nothing: false, ..acted.0.clone() };
        let kept = order_rows(&useful, None);
        let [Row::Alarm(row)] = &kept[..] else { panic!("{kept:?}") };
        assert_eq!(order_of(row).as_ref(), Some(&useful));
        assert_eq!(health_of(row), None);
    }

    #[test]
    fn a_look_that_is_written_otherwise_is_none() {
        let measure = Measure { error_sd: Some(1.5), swing: None, f: Some(0.25) };
        let of = |cause| Look { at: 3600.0, from: -60.5, cause, worth: 2.5, measure };
        let (valve, unknown) = (Some((Cause::Valve, Some(0.875))), Some((Cause::Unknown, None)));
        assert_eq!(look("3600\tvalve\t0.875\t2.5\t1.5\t-\t0.25\t-60.5"), Some(of(valve)));
        assert_eq!(look("3600\tunknown\t-\t2.5\t1.5\t-\t0.25\t-60.5"), Some(of(unknown)));
        assert_eq!(look("3600\t-\t-\t2.5\t1.5\t-\t0.25\t-60.5"), Some(of(None)));
        for wrong in ["3600\tvalve\t0.875\t2.5\t1.5\t-\t0.25", "3600\tvalve\t0.875", "3600", ""] {
            assert_eq!(look(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn the_day_so_far_comes_back_as_it_was() {
        let (id, mut values, mut counts) = (LoopId::new("FIC1"), [None; COUNT], [0; COUNT]);
        (values[0], counts[0], values[COUNT - 1], counts[COUNT - 1]) = (Some(81.5), 18, Some(0.25), 7);
        let part = Part { until: 64_800.0, values, counts };
        let measure = Measure { error_sd: Some(1.5), swing: None, f: Some(0.25) };
        let Row::Alarm(row) = today_row(&id, &part, &measure) else { panic!("a state") };
        let found = KeptPlant::of(std::slice::from_ref(&row));
        assert_eq!(found.todays, [Today { id, part, measure }]);
        assert_eq!((found.orders.len(), found.days.len()), (0, 0));
        // With a line less it is of an earlier version, which did not have the last of them.
        let (less, _) = row.trend.trim_end().rsplit_once('\n').expect("lines");
        let found = today_of(&AlarmRow { trend: less.into(), ..row.clone() }).expect("a day so far").part;
        assert_eq!((found.values[0], found.counts[0]), (Some(81.5), 18));
        assert_eq!((found.values[COUNT - 1], found.counts[COUNT - 1]), (None, 0));
        for trend in ["", "x\ty\nz"] {
            assert_eq!(today_of(&AlarmRow { trend: trend.into(), ..row.clone() }), None);
        }
    }

    #[test]
    fn every_indicator_comes_back_under_its_own_name() {
        let at = |name: &str| NAMED.iter().position(|own| own.0 == name).expect(name);
        let values: Values = std::array::from_fn(|k| Some(k as f64 + 0.5));
        let id = LoopId::new("FIC1");
        let Row::Alarm(days) = health_row(&id, &[(86_400.0, values)]) else { panic!("a state") };
        let part = Part { until: 64_800.0, values, counts: [7; COUNT] };
        let Row::Alarm(today) = today_row(&id, &part, &Measure::default()) else { panic!("a state") };
        let found = KeptPlant::of(&[days.clone(), today]);
        let kept = [found.days[0].1[0].1, found.todays[0].part.values];
        // Where they stand in what is kept, which is all that tells them apart.
        for (name, place) in [
            ("pv_mean", 14.5),
            ("ise_per_s", 15.5),
            ("settling_s", 16.5),
            ("regularity", 17.5),
            ("compression", 18.5),
            ("harris_low", 19.5),
            ("harris_high", 20.5),
            ("harris_dead_time_s", 21.5),
        ] {
            assert_eq!(kept.map(|own| own[at(name)]), [Some(place); 2], "{name}");
        }
        // Of a day that an earlier version kept fifteen are known.
        let trend = days.trend.split(' ').take(16).collect::<Vec<_>>().join(" ");
        let (_, found) = health_of(&AlarmRow { trend, ..days }).expect("days");
        assert_eq!((found[0].1[at("pv_mean")], found[0].1[at("ise_per_s")]), (Some(14.5), None));
    }

    #[test]
    fn days_come_back_and_rubbish_does_not() {
        let mut values = [None; COUNT];
        (values[0], values[5]) = (Some(81.5), Some(0.25));
        let days = vec![(86_400.0, values), (172_800.0, [None; COUNT])];
        let Row::Alarm(row) = health_row(&LoopId::new("FIC1"), &days) else { panic!("a state") };
        assert_eq!(health_of(&row), Some((LoopId::new("FIC1"), days)));
        assert_eq!(order_of(&row), None);
        for trend in ["", "x y z", "1 2 NaN\n\n\t\n", "valve\t"] {
            let row = AlarmRow {
                kind: WORK.into(),
                votes: "open x 0".into(),
                trend: trend.into(),
                ..AlarmRow::default()
            };
            assert_eq!(order_of(&row), None);
            let row = AlarmRow { kind: HEALTH.into(), trend: trend.into(), ..AlarmRow::default() };
            assert!(health_of(&row).is_some());
        }
    }
}
