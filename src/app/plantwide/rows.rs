//! Orders and indicators as rows of the store, and back. They are states of a loop, as its alarms are, and lie beside them under
//! kinds of their own, so that they too are held twice.

use crate::indicators::series::{COUNT, Values};
use crate::plantwide::Cause;
use crate::signal::LoopId;
use crate::store::{AlarmRow, Row, TransitionRow};
use crate::work::order::Look;
use crate::work::{Measure, Move, Order, Seen, State};
use std::collections::VecDeque;
use std::fmt::Write;

/// Kinds of the rows.
const WORK: &str = "work";
const HEALTH: &str = "health";

/// An order and what happened to it.
pub(in crate::app) fn order_rows(order: &Order, moved: Option<&Move>) -> Vec<Row> {
    let mut trend = String::new();
    if let Some(seen) = &order.seen {
        let victims: Vec<&str> = seen.victims.iter().map(LoopId::as_str).collect();
        let _ = writeln!(trend, "{}\t{}\t{}", seen.cause.as_str(), seen.probability, victims.join("\t"));
    } else {
        trend.push('\n');
    }
    for look in &order.looks {
        let cause = look.cause.map_or("-\t-".to_string(), |(cause, p)| format!("{}\t{p}", cause.as_str()));
        let _ = writeln!(trend, "{}\t{cause}\t{}\t{}", look.at, measure(&look.measure), look.from);
    }
    let before = order.before.map(|(own, at)| format!("{at}\t{}\n", measure(&own))).unwrap_or_default();
    let after = order.after.map(|own| format!("-\t{}\n", measure(&own))).unwrap_or_default();
    let row = AlarmRow {
        control_loop: order.id.to_string(),
        kind: WORK.into(),
        active: order.state.is_standing(),
        votes: format!("{} {}", order.state.as_str(), order.reopened),
        raises: format!("{before}{after}"),
        trend,
        since: Some(order.since),
        raised_at: Some(order.first),
        detail: order.seen.as_ref().map(|seen| seen.why.clone()).unwrap_or_default(),
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

/// An order as it was kept; `None` for a row that is none.
pub(in crate::app) fn order_of(row: &AlarmRow) -> Option<Order> {
    if row.kind != WORK {
        return None;
    }
    let (state, reopened) = row.votes.split_once(' ')?;
    let mut lines = row.trend.lines();
    let seen = lines.next().and_then(|line| seen(line, &row.detail));
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
        seen,
        looks,
        before,
        after,
        by: row.by.clone(),
        note: row.comment.clone(),
        reopened: reopened.parse().ok()?,
    })
}

/// The days of a loop as they were kept; `None` for a row that has none.
pub(in crate::app) fn health_of(row: &AlarmRow) -> Option<(LoopId, Vec<(f64, Values)>)> {
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

fn number(field: &str) -> Option<f64> {
    field.parse::<f64>().ok().filter(|x| x.is_finite())
}

fn measure(own: &Measure) -> String {
    let field = |x: Option<f64>| x.map_or("-".to_string(), |x| x.to_string());
    format!("{}\t{}\t{}", field(own.error_sd), field(own.swing), field(own.f))
}

fn read_measure<'a>(fields: &mut impl Iterator<Item = &'a str>) -> Measure {
    let mut next = || fields.next().and_then(number);
    Measure { error_sd: next(), swing: next(), f: next() }
}

fn cause(name: &str) -> Option<Cause> {
    Cause::ALL.into_iter().find(|cause| cause.as_str() == name)
}

fn seen(line: &str, why: &str) -> Option<Seen> {
    let mut fields = line.split('\t');
    let cause = cause(fields.next()?)?;
    let probability = number(fields.next()?)?;
    let victims = fields.filter(|name| !name.is_empty()).map(LoopId::new).collect();
    Some(Seen { cause, probability, why: why.to_string(), victims })
}

fn look(line: &str) -> Option<Look> {
    let mut fields = line.split('\t');
    let at = number(fields.next()?)?;
    let (cause, probability) = (cause(fields.next()?), number(fields.next()?));
    let measure = read_measure(&mut fields);
    // An earlier version did not keep it: such a look may reach back before everything.
    let from = fields.next().and_then(number).unwrap_or(f64::NEG_INFINITY);
    Some(Look { at, from, cause: cause.zip(probability), measure })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::work::{Act, Config, Said, WorkList};

    #[test]
    fn an_order_comes_back_as_it_was() {
        let (mut list, id, config) = (WorkList::default(), LoopId::new("FIC1"), Config::default());
        let seen = Seen {
            cause: Cause::Valve,
            probability: 0.875,
            why: "it sticks".into(),
            victims: vec![LoopId::new("LIC1"), LoopId::new("TIC 2")],
        };
        for hour in 0..60 {
            let seen = (hour % 10 != 3).then(|| seen.clone());
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
        assert_eq!(order_of(row).as_ref(), Some(&acted.0));
        assert_eq!(health_of(row), None);
    }

    #[test]
    fn a_look_of_an_earlier_version_may_reach_back_before_everything() {
        let measure = Measure { error_sd: Some(1.5), swing: None, f: Some(0.25) };
        let of = |from| Look { at: 3600.0, from, cause: Some((Cause::Valve, 0.875)), measure };
        assert_eq!(look("3600\tvalve\t0.875\t1.5\t-\t0.25"), Some(of(f64::NEG_INFINITY)));
        assert_eq!(look("3600\tvalve\t0.875\t1.5\t-\t0.25\t-inf"), Some(of(f64::NEG_INFINITY)));
        assert_eq!(look("3600\tvalve\t0.875\t1.5\t-\t0.25\t-60.5"), Some(of(-60.5)));
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
                votes: "open x".into(),
                trend: trend.into(),
                ..AlarmRow::default()
            };
            assert_eq!(order_of(&row), None);
            let row = AlarmRow { kind: HEALTH.into(), trend: trend.into(), ..AlarmRow::default() };
            assert!(health_of(&row).is_some());
        }
    }
}
