//! A cell cut into numbers, words and signs, and the parts of a stamp taken from their front one by one.

use super::{DAY, Date, SECOND, century};
use crate::table::calendar::{
    half, half_before, is_ambiguous, is_filler, is_of_date, is_weekday, month, zone,
};

/// A piece of a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Piece<'a> {
    /// Digits: value and how many.
    Number(i64, usize),
    Word(&'a str),
    Sign(char),
}

/// Most pieces of a stamp.
const PIECES: usize = 32;

pub fn pieces(text: &str) -> Option<Vec<Piece<'_>>> {
    let mut out = Vec::with_capacity(PIECES);
    let mut rest = text;
    while let Some(c) = rest.chars().next() {
        let run = |is: fn(char) -> bool| rest.find(|c| !is(c)).unwrap_or(rest.len());
        let n = if c.is_ascii_digit() {
            let n = run(|c| c.is_ascii_digit());
            out.push(Piece::Number(rest[..n].parse().ok()?, n));
            n
        } else if c.is_alphabetic() {
            let n = run(char::is_alphabetic);
            out.push(Piece::Word(&rest[..n]));
            n
        } else {
            let c = if c.is_whitespace() { ' ' } else { c };
            if c != ' ' || out.last() != Some(&Piece::Sign(' ')) {
                out.push(Piece::Sign(c));
            }
            rest.chars().next().map_or(1, char::len_utf8)
        };
        if out.len() > PIECES {
            return None;
        }
        rest = &rest[n..];
    }
    Some(out)
}

/// Minutes and seconds with a fraction, `59:58.5` (ns): hours and minutes have none.
pub fn minutes(pieces: &[Piece<'_>]) -> Option<i64> {
    use Piece::{Number, Sign};
    let [Number(minute, 1..=4), Sign(':'), Number(second @ ..60, 2), Sign('.' | ','), Number(part, digits)] =
        pieces
    else {
        return None;
    };
    Some((minute * 60 + second) * SECOND + fraction(*part, *digits)?)
}

/// Digits behind a decimal sign as nanoseconds.
fn fraction(value: i64, digits: usize) -> Option<i64> {
    let scale = 9i32 - i32::try_from(digits).ok()?;
    let factor = 10i64.checked_pow(scale.unsigned_abs())?;
    if scale >= 0 { value.checked_mul(factor) } else { Some(value / factor) }
}

/// The pieces that are not understood yet.
pub struct Left<'p, 'a>(pub &'p [Piece<'a>]);

impl Left<'_, '_> {
    /// Time since something began (ns): `1 day, 0:00:02`, `0 days 00:00:02.030`, `25:00:00`.
    pub fn elapsed(&mut self) -> Option<i64> {
        use Piece::{Number, Sign, Word};
        let days = match self.0 {
            [Number(days, 1..=5), Sign(' '), Word("day" | "days"), rest @ ..] => {
                self.0 = rest;
                self.between();
                *days
            }
            [Number(24.., 2..=4), Sign(':'), Number(_, 2), Sign(':'), Number(_, 2), ..] => 0,
            _ => return None,
        };
        let clock = if self.0.is_empty() { 0 } else { self.clock_below(10_000)? };
        days.checked_mul(DAY)?.checked_add(clock)
    }

    pub fn skip_weekday(&mut self) {
        use Piece::{Number, Sign, Word};
        // `mar 02/06/2026` is a Tuesday, `mar 02 2026` a day of March.
        let before_date = |rest: &[Piece<'_>]| {
            let rest =
                &rest[rest.iter().take_while(|piece| matches!(piece, Sign(',' | '.' | ' '))).count()..];
            matches!(
                rest,
                [Number(..), Sign('/' | '-' | '.'), Number(..), Sign('/' | '-' | '.'), Number(..), ..]
            )
        };
        if let [Word(word), rest @ ..] = self.0
            && (is_weekday(word) || word.eq_ignore_ascii_case("mar") && before_date(rest))
        {
            self.0 = rest;
            // `segunda-feira, 15 de junho`.
            if let [Sign('-'), Word("feira"), rest @ ..] = self.0 {
                self.0 = rest;
            }
            while let [Piece::Sign(',' | '.' | ' '), rest @ ..] = self.0 {
                self.0 = rest;
            }
        }
    }

    pub fn blanks(&mut self) {
        while let [Piece::Sign(' '), rest @ ..] = self.0 {
            self.0 = rest;
        }
    }

    /// What divides date and time: a blank, `T`, a comma, `_`, a dash, or a colon (`01/Jun/2026:06:00:00`), and words that say
    /// nothing (`at`, `klo`, `г.`).
    pub fn between(&mut self) {
        if let [Piece::Word("T" | "t"), rest @ ..] = self.0 {
            self.0 = rest;
            return;
        }
        self.signs_between();
        while let [Piece::Word(word), rest @ ..] = self.0
            && is_filler(word)
        {
            let before = self.0;
            self.0 = without_point(rest);
            self.signs_between();
            // A letter behind a date alone is a mark, but for that of a year.
            if self.0.is_empty() && !is_of_date(word) {
                self.0 = before;
                return;
            }
        }
    }

    fn signs_between(&mut self) {
        while let [Piece::Sign(' ' | ',' | '_' | '-' | ':' | ';'), rest @ ..] = self.0 {
            self.0 = rest;
        }
    }

    pub fn date(&mut self) -> Option<Date> {
        use Piece::{Number, Sign, Word};
        if let Some((date, rest)) = pointed(self.0) {
            self.0 = rest;
            return Some(date);
        }
        let (date, rest) = match self.0 {
            [Number(all, 8), rest @ ..] if !matches!(rest, [Sign('.' | ','), ..]) => {
                (Date::Known(all / 10_000, (all / 100 % 100) as u32, (all % 100) as u32), rest)
            }
            // Exports of East Asia say year, month and day behind the numbers.
            [Number(y, 4), Word("年"), Number(m, _), Word("月"), Number(d, _), Word("日"), rest @ ..]
            | [
                Number(y, 4),
                Word("년"),
                Sign(' '),
                Number(m, _),
                Word("월"),
                Sign(' '),
                Number(d, _),
                Word("일"),
                rest @ ..,
            ] => (Date::Known(*y, *m as u32, *d as u32), rest),
            [
                Number(d, 1..=2),
                Sign('-'),
                Number(m, 1..=2),
                Word("月"),
                Sign('-'),
                Number(y, n @ (2 | 4)),
                rest @ ..,
            ] => (Date::Known(century(*y, *n == 4), *m as u32, *d as u32), rest),
            [Number(y, 4), Sign(a), Number(m, 1..=2), Sign(b), Number(d, 1..=2), rest @ ..]
                if a == b && matches!(a, '-' | '/') =>
            {
                (Date::Known(*y, *m as u32, *d as u32), rest)
            }
            // `2026-166 06:00:00`: the day of the year; without a time of day behind it, it may be any number.
            [Number(y, 4), Sign('-' | '/'), Number(day, 3), rest @ ..]
                if matches!(rest, [Word("T" | "t") | Sign(' '), Number(..), ..]) =>
            {
                (day_of_year(*y, *day)?, rest)
            }
            [
                Number(y, 4),
                Sign('-' | '/' | ' '),
                Word(m),
                Sign('-' | '/' | ' '),
                Number(d, 1..=2),
                rest @ ..,
            ] => (Date::Known(*y, month(m)?, *d as u32), rest),
            [Number(a, 1..=2), Sign(s), Number(b, 1..=2), Sign(t), Number(c, n @ (2 | 4)), rest @ ..]
                if s == t && matches!(s, '/' | '-' | ' ') =>
            {
                (Date::Open([*a, *b, *c], *n == 4), rest)
            }
            _ => return self.with_name(),
        };
        self.0 = rest;
        Some(date)
    }

    /// A date with the month by its name; the year 0 where it has not come yet.
    fn with_name(&mut self) -> Option<Date> {
        let signs = |c: &char| matches!(c, '-' | '/' | ' ' | '.' | ',');
        let mut rest = self.0;
        let mut seen: [Option<&Piece<'_>>; 3] = [None; 3];
        let mut n = 0;
        while n < 3 {
            match rest {
                [Piece::Sign(c), after @ ..] if n > 0 && signs(c) => rest = after,
                // `15 de junio de 2026`, `June 15th, 2026`.
                [Piece::Word(word), after @ ..] if n > 0 && is_of_date(word) => rest = after,
                [piece @ (Piece::Number(..) | Piece::Word(_)), after @ ..] => {
                    // A time of day begins where a colon follows, but for a year: `01Jun2026:06:00:00`.
                    let colon = matches!(after, [Piece::Sign(':'), Piece::Number(..), Piece::Sign(':'), ..]);
                    if colon && n == 2 && !matches!(piece, Piece::Number(_, 4)) {
                        break;
                    }
                    seen[n] = Some(piece);
                    n += 1;
                    rest = after;
                }
                _ => break,
            }
        }
        use Piece::{Number, Word};
        let date = match seen {
            [Some(Number(d, 1..=2)), Some(Word(m)), Some(Number(y, k @ (2 | 4)))]
            | [Some(Word(m)), Some(Number(d, 1..=2)), Some(Number(y, k @ (2 | 4)))] => {
                Date::Known(century(*y, *k == 4), month(m)?, *d as u32)
            }
            // `2026. június 15.`
            [Some(Number(y, 4)), Some(Word(m)), Some(Number(d, 1..=2))] => {
                Date::Known(*y, month(m)?, *d as u32)
            }
            [Some(Word(m)), Some(Number(d, 1..=2)), None] => Date::Known(0, month(m)?, *d as u32),
            _ => return None,
        };
        self.0 = without_last_point(rest);
        Some(date)
    }

    /// Nanoseconds since midnight, 24:00 included.
    pub fn clock(&mut self) -> Option<i64> {
        self.clock_below(24)
    }

    /// The same of fewer hours than these.
    fn clock_below(&mut self, hours: i64) -> Option<i64> {
        use Piece::{Number, Sign, Word};
        let before = match self.0 {
            [Word(word), rest @ ..] => {
                let past_noon = half_before(word)?;
                self.0 = without_blank(rest);
                Some(past_noon)
            }
            _ => None,
        };
        let (hour, minute, mut second, mut rest) = match self.0 {
            // `2026-06-15_06-00-02`, as files are called.
            [Number(h, 2), Sign('-'), Number(m, 2), Sign('-'), Number(s, 2), rest @ ..] => (*h, *m, *s, rest),
            [Number(h, 1..=4), Sign(':'), Number(m, 2), Sign(':'), Number(s, 2), rest @ ..]
            | [Number(h, 1..=2), Sign('.'), Number(m, 2), Sign('.'), Number(s, 2), rest @ ..] => {
                (*h, *m, *s, rest)
            }
            [Number(h, 1..=2), Sign(':'), Number(m, 2), rest @ ..] => (*h, *m, 0, rest),
            [Number(all, 6), rest @ ..] => (all / 10_000, all / 100 % 100, all % 100, rest),
            [Number(h, 1..=2), rest @ ..] if noon(without_blank(rest)).is_some() => (*h, 0, 0, rest),
            _ => named_clock(self.0)?,
        };
        let mut part = 0;
        if let [Sign('.' | ',' | ':'), Number(value, n), after @ ..]
        // Studio 5000 writes `06:00:02;030`.
        | [Sign(';'), Number(value, n @ 3), after @ ..] = rest
        {
            part = fraction(*value, *n)?;
            rest = after;
        }
        let mut hour = hour;
        let behind = noon(without_blank(rest));
        if let Some((after, _)) = behind {
            rest = after;
        }
        if let Some(past_noon) = before.or(behind.map(|(_, past_noon)| past_noon)) {
            if !(1..=12).contains(&hour) {
                return None;
            }
            hour = hour % 12 + if past_noon { 12 } else { 0 };
        }
        // `06:00:02 Uhr`, `6:00:02 ч.`.
        if let [Word("Uhr" | "uhr" | "h" | "hs" | "hrs" | "ч"), after @ ..] = without_blank(rest) {
            rest = without_point(after);
        }
        // A leap second is told as the last nanosecond of its minute.
        if second == 60 {
            (second, part) = (59, SECOND - 1);
        }
        let midnight = hour == 24 && minute == 0 && second == 0 && part == 0;
        if !(midnight || hour < hours) || minute > 59 || second > 59 {
            return None;
        }
        self.0 = rest;
        Some((hour * 3600 + minute * 60 + second) * SECOND + part)
    }

    /// The offset from Greenwich where one is given, and whether letters stand there that do not say which; `None` where what
    /// stands there is neither.
    pub fn offset(&mut self) -> Option<(Option<i32>, bool)> {
        use Piece::{Number, Sign, Word};
        self.blanks();
        if let [Word(name), rest @ ..] = self.0 {
            let known = zone(name);
            if known.is_none() && !is_ambiguous(name) {
                return None;
            }
            self.0 = rest;
            self.blanks();
            let Some(offset) = known else { return Some((None, true)) };
            if offset != 0 || !matches!(self.0, [Sign('+' | '-'), ..]) {
                return Some((Some(offset), false));
            }
        }
        let [Sign(sign @ ('+' | '-')), rest @ ..] = self.0 else { return Some((None, false)) };
        let (hours, minutes, rest) = match rest {
            [Number(h, 2), Sign(':'), Number(m, 2), rest @ ..] => (*h, *m, rest),
            [Number(hm, 4), rest @ ..] => (hm / 100, hm % 100, rest),
            [Number(h, 1..=2), rest @ ..] => (*h, 0, rest),
            _ => return None,
        };
        if hours > 15 || minutes > 59 {
            return None;
        }
        self.0 = rest;
        let seconds = i32::try_from(hours * 3600 + minutes * 60).ok()?;
        let seconds = if *sign == '-' { -seconds } else { seconds };
        // `+0000 UTC`, `+0200 CEST`: letters that say the same again.
        if let [Word(name), rest @ ..] = without_blank(self.0)
            && (zone(name) == Some(seconds) || is_ambiguous(name))
        {
            self.0 = rest;
        }
        Some((Some(seconds), false))
    }
}

fn without_blank<'p, 'a>(pieces: &'p [Piece<'a>]) -> &'p [Piece<'a>] {
    if let [Piece::Sign(' '), after @ ..] = pieces { after } else { pieces }
}

fn without_point<'p, 'a>(pieces: &'p [Piece<'a>]) -> &'p [Piece<'a>] {
    if let [Piece::Sign('.'), after @ ..] = pieces { after } else { pieces }
}

/// Without a point that ends a date: nothing or a blank follows it.
fn without_last_point<'p, 'a>(pieces: &'p [Piece<'a>]) -> &'p [Piece<'a>] {
    match pieces {
        [Piece::Sign('.'), after @ ..] if matches!(after, [] | [Piece::Sign(' '), ..]) => after,
        _ => pieces,
    }
}

/// Three numbers with points between, a blank behind each or not, and a point behind the last or not: `15.06.2026`,
/// `15. 6. 2026`, `2026. 06. 15.`; and what follows.
fn pointed<'p, 'a>(pieces: &'p [Piece<'a>]) -> Option<(Date, &'p [Piece<'a>])> {
    use Piece::{Number, Sign};
    let [Number(a, of_a), Sign('.'), rest @ ..] = pieces else { return None };
    let [Number(b, 1..=2), Sign('.'), rest @ ..] = without_blank(rest) else { return None };
    let is_apart = matches!(rest, [Sign(' '), ..]);
    let [Number(c, of_c), rest @ ..] = without_blank(rest) else { return None };
    // `15.06. 06:00:00` has no year: what follows the blank is an hour.
    if is_apart && matches!(rest, [Sign(':'), ..]) {
        return None;
    }
    let date = match (*of_a, *of_c) {
        (4, 1..=2) => Date::Known(*a, *b as u32, *c as u32),
        (1..=2, 4) => Date::Known(*c, *b as u32, *a as u32),
        (1..=2, 2) => Date::Dotted([*a, *b, *c]),
        _ => return None,
    };
    Some((date, without_last_point(rest)))
}

/// The date of a day of a year, from 1.
fn day_of_year(year: i64, day: i64) -> Option<Date> {
    let first = jiff::civil::Date::new(i16::try_from(year).ok()?, 1, 1).ok()?;
    if !(1..=i64::from(first.days_in_year())).contains(&day) {
        return None;
    }
    let date = first.checked_add(jiff::Span::new().try_days(day - 1).ok()?).ok()?;
    Some(Date::Known(year, u32::try_from(date.month()).ok()?, u32::try_from(date.day()).ok()?))
}

/// Hours, minutes and seconds with words behind them, and what follows: `6时00分02秒`, `06h00m02s`, `06h00`.
fn named_clock<'p, 'a>(pieces: &'p [Piece<'a>]) -> Option<(i64, i64, i64, &'p [Piece<'a>])> {
    use Piece::{Number, Word};
    let [Number(hour, 1..=2), Word("时" | "時" | "시" | "h" | "H"), rest @ ..] = pieces else {
        return None;
    };
    let [Number(minute, 1..=2), rest @ ..] = without_blank(rest) else { return None };
    let [Word("分" | "분" | "m" | "min"), rest @ ..] = rest else { return Some((*hour, *minute, 0, rest)) };
    match without_blank(rest) {
        [Number(second, 1..=2), Word("秒" | "초" | "s" | "sec"), rest @ ..] => {
            Some((*hour, *minute, *second, rest))
        }
        _ => Some((*hour, *minute, 0, rest)),
    }
}

/// AM or PM in front, with or without points: what follows, and whether it is past noon.
fn noon<'p, 'a>(pieces: &'p [Piece<'a>]) -> Option<(&'p [Piece<'a>], bool)> {
    use Piece::{Sign, Word};
    let (word, rest) = match pieces {
        [Word(word), Sign('.'), Word("m" | "M" | "μ"), Sign('.'), rest @ ..]
        | [Word(word), Sign('.'), Sign(' '), Word("m" | "M" | "μ"), Sign('.'), rest @ ..]
            if word.chars().count() == 1 =>
        {
            (*word, rest)
        }
        [Word(word), rest @ ..] if word.chars().count() == 2 => (*word, rest),
        _ => return None,
    };
    half(word).map(|past_noon| (rest, past_noon))
}
