//! What a cell of the column of times can be, or the two of a date and a time of day.

use super::super::number;
use super::super::options::Unit;
use super::super::source::{Cell, TimeBase};
use super::super::stamp::{self, DAY, Stamp};

/// What a cell of the column, or the two of date and time of day, can be.
pub enum What<'a> {
    Number(f64),
    Digits(number::Number<'a>),
    Dated(Stamp),
    Clock(i64),
    Moment { ns: i64, base: TimeBase },
    Nothing,
}

impl<'a> What<'a> {
    pub fn of(first: &Cell<'a>, second: Option<&Cell<'a>>) -> Self {
        match (first, second) {
            (Cell::Number(value), None) if value.is_finite() => What::Number(*value),
            (Cell::Moment { ns, base }, None) => What::Moment { ns: *ns, base: *base },
            (Cell::Clock(ns), None) => What::Clock(*ns),
            (Cell::Text(text), None) => text_alone(text),
            (Cell::Moment { ns, base }, Some(second)) => match time_of_day(second) {
                Some(clock) if ns % DAY == 0 => What::Moment { ns: ns.saturating_add(clock), base: *base },
                _ => What::Nothing,
            },
            (Cell::Text(date), Some(Cell::Text(clock))) => {
                let stamp = stamp::scan(date).and_then(|date| date.at(&stamp::scan(clock)?));
                stamp.map_or(What::Nothing, What::Dated)
            }
            // A date that a spreadsheet or a database keeps as text beside a time of day as such.
            (Cell::Text(date), Some(second)) => {
                let stamp = stamp::scan(date).and_then(|date| date.at_clock(time_of_day(second)?));
                stamp.map_or(What::Nothing, What::Dated)
            }
            _ => What::Nothing,
        }
    }
}

fn time_of_day(cell: &Cell<'_>) -> Option<i64> {
    match cell {
        Cell::Clock(ns) => Some(*ns),
        Cell::Text(text) => stamp::scan(text)?.as_clock().time_of_day().filter(|clock| *clock <= DAY),
        Cell::Number(days) if (0.0..1.0).contains(days) => Some((days * 86_400e3).round() as i64 * 1_000_000),
        _ => None,
    }
}

/// Whether a text has as many digits as a date and a time of day without a sign, `20260601060000`, and a fraction behind or none.
fn is_compact(text: &str) -> bool {
    let text = number::bare(text);
    let digits = |part: &str| !part.is_empty() && part.bytes().all(|byte| byte.is_ascii_digit());
    match text.split_once(['.', ',']) {
        Some((whole, fraction)) => whole.len() == 14 && digits(whole) && digits(fraction),
        None => text.len() == 14,
    }
}

fn text_alone(text: &str) -> What<'_> {
    let compact = is_compact(text);
    // `2.03 sec`: seconds are what a number without a unit counts, too.
    let of_time = |unit: &str| unit.is_empty() || Unit::of(unit) == Some(Unit::Seconds);
    match number::scan(text).filter(|number| of_time(number.unit)) {
        Some(number) if !compact => What::Digits(number),
        found => match (stamp::scan(text), found) {
            (Some(stamp), _) if stamp.has_date() => What::Dated(stamp),
            (Some(stamp), _) => stamp.time_of_day().map_or(What::Nothing, What::Clock),
            (None, Some(number)) => What::Digits(number),
            (None, None) => What::Nothing,
        },
    }
}

/// [`What`] a cell can be, without the reading itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WhatKind {
    /// Nothing stands there.
    Blank,
    /// A number.
    Number,
    /// A date, or a moment as such.
    Dated,
    /// A time of day.
    Clock,
    /// Other text.
    Nothing,
}

impl What<'_> {
    /// Its kind.
    pub fn kind(&self) -> WhatKind {
        match self {
            What::Number(_) | What::Digits(_) => WhatKind::Number,
            What::Dated(_) | What::Moment { .. } => WhatKind::Dated,
            What::Clock(_) => WhatKind::Clock,
            What::Nothing => WhatKind::Nothing,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::stamp::{Order, SECOND};
    use super::*;

    /// 2026-06-01 06:00:02 on the written clock (s since 1970).
    const AT: i64 = 1_780_293_602;
    const CLOCK: Cell<'static> = Cell::Clock((6 * 3600 + 2) * SECOND);

    fn civil(what: &What<'_>) -> Option<i64> {
        match what {
            What::Dated(stamp) => stamp.civil(Order::Dmy),
            _ => None,
        }
    }

    #[test]
    fn a_date_as_text_and_a_time_of_day_as_such_are_one_moment() {
        for date in ["2026-06-01", "01.06.2026", "1 June 2026", "20260601"] {
            let what = What::of(&Cell::Text(date), Some(&CLOCK));
            assert_eq!(civil(&what), Some(AT * SECOND), "{date}");
        }
        // Points divide its numbers in Italy and Denmark, also beside another sign in the date.
        for (date, clock) in
            [("01/06/2026", "06.00.02"), ("2026-06-01", "6.00.02"), ("01.06.2026", "06.00.02")]
        {
            let what = What::of(&Cell::Text(date), Some(&Cell::Text(clock)));
            assert_eq!(civil(&what), Some(AT * SECOND), "{date} {clock}");
        }
        // A share of the day, as a spreadsheet keeps a time of day that has lost its format.
        let quarter = What::of(&Cell::Text("2026-06-01"), Some(&Cell::Number(0.25)));
        assert_eq!(civil(&quarter), Some((AT - 2) * SECOND));
        for (date, second) in [
            ("2026-06-01 05:00:00", CLOCK),
            ("06:00:00", CLOCK),
            ("soon", CLOCK),
            ("2026-06-01", Cell::Blank),
            ("2026-06-01", Cell::Number(21_602.0)),
            ("2026-06-01", Cell::Clock(2 * DAY)),
            ("2026-06-01", Cell::Text("01.06.2026")),
            ("2026-06-01", Cell::Text("31.12.25")),
        ] {
            let what = What::of(&Cell::Text(date), Some(&second));
            assert_eq!(what.kind(), WhatKind::Nothing, "{date} beside {second:?}");
        }
    }

    #[test]
    fn digits_of_a_date_and_a_time_of_day_may_have_a_fraction_behind() {
        for (text, fraction) in
            [("20260601060002", 0), ("20260601060002.123", 123), ("20260601060002,5", 500)]
        {
            let what = What::of(&Cell::Text(text), None);
            assert_eq!(civil(&what), Some(AT * SECOND + fraction * 1_000_000), "{text}");
        }
        for text in ["1780293602.123", "178029360212345.5", "20260601060002.", "202606.01060002"] {
            assert_ne!(What::of(&Cell::Text(text), None).kind(), WhatKind::Dated, "{text}");
        }
    }
}
