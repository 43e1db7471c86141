//! Days on which a clock is changed: times that it never showed, and the hour that it showed twice.
//!
//! In which of the two hours a row is, the rows around it tell. Who comes from the time before is in the first one, until times go
//! back by that hour. A stretch of rows that begins within the hour is known only by what follows, so the file is read once before:
//! then [`Changes::refuse`] tells what nothing decides.

use super::super::error::TableError;
use super::super::stamp::{DAY, SECOND};
use super::reading::seconds;
use jiff::Timestamp;
use jiff::tz::{AmbiguousOffset, Offset, TimeZone};

/// The record goes on where the next row is off by no more than so many usual steps.
const STEPS: f64 = 10.0;
/// Limits of that (s): a record of seconds may miss a minute, and half an hour would be as near to the other hour.
const NEAR: (f64, f64) = (60.0, 900.0);
/// Rows may be missing for so long (s), where the other hour would be as far away at least.
const GAP: f64 = 1800.0;
/// Rows of a stretch that may be in either hour, beside others that are in none: a set point or a mode is seldom written.
const FEW: u64 = 3;
/// Clocks are changed at a civil time that is at most so far from UTC (s).
const A_DAY: f64 = 86_400.0;

/// Which of the two hours, in the order of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pass {
    First,
    Second,
}

/// The rows of a tag within the hour that comes twice.
#[derive(Clone, Copy)]
struct Hour {
    pass: Pass,
    /// The first and the last row on the written clock (ns).
    first: i64,
    last: i64,
    /// The line of the first row.
    line: u64,
    /// From UTC, before the change and after it.
    offsets: [Offset; 2],
    /// The number of the stretch among those of the tag, where nothing has told its pass yet.
    open: Option<usize>,
    /// Its pass is asked for where nothing tells it: no row shortly before suggests one.
    asks: bool,
    /// How many rows it has, and whether the tag has rows before it.
    rows: u64,
    is_begin: bool,
}

/// The rows of a tag so far.
#[derive(Clone, Default)]
struct Rows {
    /// The time of the last one (s).
    last: Option<f64>,
    hour: Option<Hour>,
    /// How many stretches have begun within such an hour, and the pass of each that is known.
    begun: usize,
    passes: Vec<Pass>,
}

/// The clock by which times without an offset are written. Every row goes through it, in the order of the file.
pub struct Changes {
    zone: TimeZone,
    /// As it was told.
    name: String,
    /// From one row to the next (s).
    step: f64,
    /// The newest stands first.
    falls: bool,
    tags: Vec<Rows>,
    /// What nothing decides: the line, and why. Of several the first in the file.
    doubt: Option<(u64, String)>,
    /// The last row of any tag whose hour is known (s).
    latest: Option<f64>,
    /// The first few rows that may be in either hour, in words, and how many such stretches there are.
    few: Option<(String, u64)>,
}

impl Rows {
    /// A stretch that begins within the hour: its pass, and its number where nothing has told it yet. The row may stand beside others
    /// that are in the first hour, or in the second one.
    fn begin(&mut self, beside: [bool; 2]) -> (Pass, Option<usize>) {
        let at = self.begun;
        self.begun += 1;
        if let Some(pass) = self.passes.get(at) {
            return (*pass, None);
        }
        let (pass, open) = match beside {
            [true, false] => (Pass::First, None),
            [false, true] => (Pass::Second, None),
            _ => (Pass::First, Some(at)),
        };
        self.passes.push(pass);
        (pass, open)
    }
}

impl Changes {
    /// Before the first row.
    pub(super) fn new(zone: TimeZone, name: &str) -> Self {
        Self {
            zone,
            name: name.to_string(),
            step: 0.0,
            falls: false,
            tags: Vec::new(),
            doubt: None,
            latest: None,
            few: None,
        }
    }

    /// How the rows follow each other: the usual step (s), and whether the newest stands first.
    pub(super) fn follow(&mut self, step: f64, falls: bool) {
        (self.step, self.falls) = (step, falls);
    }

    /// Before the first row again; what is known of the stretches stays.
    pub(super) fn rewind(&mut self) {
        for rows in &mut self.tags {
            (rows.last, rows.hour, rows.begun) = (None, None, 0);
        }
        self.latest = None;
    }

    /// Whether the clock is changed between two times on it (s since 1970), or a day before or after.
    pub(super) fn is_changed(&self, from: f64, to: f64) -> bool {
        let at = |t: f64| Timestamp::from_second(t as i64);
        let (Ok(from), Ok(to)) = (at(from - A_DAY), at(to + A_DAY)) else { return true };
        self.zone.following(from).next().is_some_and(|change| change.timestamp() <= to)
    }

    /// A row that says its offset itself, at `t` (s).
    pub(super) fn pass_by(&mut self, t: f64, tag: usize, line: u64) {
        self.leave(t, tag, line);
        self.of_tag(tag).last = Some(t);
        self.latest = Some(t);
    }

    /// The moment (s since 1970) of a time on the written clock (ns); `None` for one that the clock never showed. Where tags stand
    /// `in_turn`, the row of another tag before it is from about the same time.
    pub(super) fn read(&mut self, ns: i64, (tag, line): (usize, u64), in_turn: bool) -> Option<f64> {
        let civil = Offset::UTC.to_datetime(Timestamp::from_nanosecond(i128::from(ns)).ok()?);
        let found = self.zone.to_ambiguous_timestamp(civil).offset();
        let t = match found {
            AmbiguousOffset::Unambiguous { offset } => {
                let t = moment(ns, offset)?;
                self.leave(t, tag, line);
                t
            }
            AmbiguousOffset::Gap { before, .. } => {
                let (time, date) = shown(ns);
                let why = format!(
                    "{time} does not exist in {} on {date}; say --tz {} if the clock is never changed",
                    self.name,
                    from_utc(before)
                );
                self.doubted(line, why);
                return None;
            }
            AmbiguousOffset::Fold { before, after } => {
                self.twice(ns, [before, after], (tag, line), in_turn)?
            }
        };
        let rows = self.of_tag(tag);
        rows.last = Some(t);
        if rows.hour.is_none_or(|hour| hour.open.is_none()) {
            self.latest = Some(t);
        }
        Some(t)
    }

    /// Tells what nothing decides, after the last row.
    ///
    /// # Errors
    /// A time that the clock never showed, an hour that comes twice and may be either, or one that comes once.
    pub(super) fn refuse(&mut self, row_name: &str) -> Result<(), TableError> {
        (0..self.tags.len()).for_each(|tag| self.close(tag, false));
        match &self.doubt {
            Some((line, why)) => Err(TableError::refused(format!("{row_name} {line}: {why}"))),
            None => Ok(()),
        }
    }

    /// Few rows that may be in either hour, in words; empty for none.
    pub(super) fn said(&self) -> String {
        match &self.few {
            None => String::new(),
            Some((first, 1)) => format!(", {first}"),
            Some((first, all)) => format!(", {first}, and {} more like it", all - 1),
        }
    }

    fn of_tag(&mut self, tag: usize) -> &mut Rows {
        if self.tags.len() <= tag {
            self.tags.resize(tag + 1, Rows::default());
        }
        &mut self.tags[tag]
    }

    fn doubted(&mut self, line: u64, why: String) {
        if self.doubt.as_ref().is_none_or(|(first, _)| line < *first) {
            self.doubt = Some((line, why));
        }
    }

    /// From one row to the next in the file (s).
    fn signed_step(&self) -> f64 {
        if self.falls { -self.step } else { self.step }
    }

    /// By how much a row that goes on is off at most (s).
    fn near(&self) -> f64 {
        (STEPS * self.step).clamp(NEAR.0, NEAR.1)
    }

    /// A row within the hour that comes twice.
    fn twice(
        &mut self,
        ns: i64,
        offsets: [Offset; 2],
        (tag, line): (usize, u64),
        in_turn: bool,
    ) -> Option<f64> {
        let [Some(early), Some(late)] = offsets.map(|offset| moment(ns, offset)) else { return None };
        let [first, second] = if self.falls { [late, early] } else { [early, late] };
        let (near, step, falls) = (self.near(), self.signed_step(), self.falls);
        let latest = self.latest.filter(|_| in_turn);
        // The one of another year.
        if self.of_tag(tag).hour.is_some_and(|hour| hour.last.abs_diff(ns) >= DAY.unsigned_abs()) {
            self.close(tag, true);
        }
        let last = self.of_tag(tag).last;
        let off = |t: f64| last.map_or(f64::INFINITY, |last| (t - last - step).abs());
        let goes_on = if off(second) < off(first) { Pass::Second } else { Pass::First };
        let (is_first, is_second) = (off(first) <= near, off(second) <= near);
        let is_near = is_first || is_second;
        // By how much a time is later than the last row (s).
        let ahead = |t: f64| last.map_or(f64::NEG_INFINITY, |last| if falls { last - t } else { t - last });
        // Some rows are missing: the next one is in the same hour, or in the second one where it would go back in the first.
        let stays = (0.0..=GAP).contains(&ahead(first));
        let follows = (0.0..=GAP).contains(&ahead(second));
        let in_first = self.of_tag(tag).hour.is_some_and(|hour| hour.pass == Pass::First);
        if in_first && !is_near && !stays && !follows {
            self.close(tag, true);
        }
        let rows = self.of_tag(tag);
        let hour = match rows.hour {
            Some(hour) if hour.pass == Pass::Second => {
                rows.hour = Some(Hour { last: ns, rows: hour.rows + 1, ..hour });
                // After any hole the first hour would go back.
                if !is_near && ahead(second) < 0.0 {
                    self.ask(ns, offsets, line);
                }
                // A row of the first hour may come late.
                return Some(if is_first && !is_second { first } else { second });
            }
            // Times that go back by the hour tell the pass of the rows before.
            Some(hour) => {
                let pass = match (is_near, stays) {
                    (true, _) => goes_on,
                    (false, true) => Pass::First,
                    (false, false) => Pass::Second,
                };
                let open = hour.open.filter(|_| pass == Pass::First);
                Hour { pass, last: ns, open, rows: hour.rows + 1, ..hour }
            }
            None => {
                // Beside rows of other tags whose hour is known.
                let beside = |t: f64| latest.is_some_and(|latest| (t - latest).abs() <= near);
                let (pass, open) = match is_near {
                    true => (goes_on, None),
                    false => rows.begin([beside(first), beside(second)]),
                };
                let (asks, is_begin) = (!stays, last.is_none());
                Hour { pass, first: ns, last: ns, line, offsets, open, asks, rows: 1, is_begin }
            }
        };
        rows.hour = Some(hour);
        Some(if hour.pass == Pass::First { first } else { second })
    }

    /// A row at `t` (s) beyond the hour.
    fn leave(&mut self, t: f64, tag: usize, line: u64) {
        let (near, step, falls) = (self.near(), self.signed_step(), self.falls);
        let rows = self.of_tag(tag);
        let (Some(hour), Some(last)) = (rows.hour.filter(|hour| hour.pass == Pass::First), rows.last) else {
            rows.hour = None;
            return;
        };
        // Whether the record goes on from its last row, or as if that had been in the other pass.
        let [before, after] = hour.offsets.map(|offset| f64::from(offset.seconds()));
        let other = if falls { last - (before - after) } else { last + (before - after) };
        let off = |last: f64| (t - last - step).abs();
        let goes_on = |last: f64| off(last) <= near;
        let is_other = goes_on(other) && (!goes_on(last) || off(other) < off(last));
        match hour.open {
            _ if !is_other && goes_on(last) => rows.hour = None,
            _ if !is_other => self.close(tag, true),
            Some(at) => {
                rows.passes[at] = Pass::Second;
                rows.hour = None;
            }
            // Few rows, as of a set point, may have none in the second hour.
            None if hour.rows <= FEW && hour.rows as f64 * step.abs() < GAP && !hour.is_begin => {
                rows.hour = None
            }
            None => {
                rows.hour = None;
                let (_, date) = shown(hour.last);
                let why = format!(
                    "the hour that comes twice in {} on {date} is there once; say --tz {} if the clock is never changed, or write an \
                     offset behind each time",
                    self.name,
                    from_utc(hour.offsets[1])
                );
                self.doubted(line, why);
            }
        }
    }

    /// No row of the hour is left: asks for its pass where nothing has told it. A few rows among others, of which some may be `behind`,
    /// are told and not asked for.
    fn close(&mut self, tag: usize, behind: bool) {
        let hour = self.of_tag(tag).hour.take().filter(|hour| hour.open.is_some() && hour.asks);
        let Some(hour) = hour else { return };
        if hour.rows > FEW || hour.is_begin && !behind {
            self.ask(hour.first, hour.offsets, hour.line);
            return;
        }
        let (time, date) = shown(hour.first);
        let which = if self.falls { "second" } else { "first" };
        let first = || format!("{time} comes twice in {} on {date} and is read as the {which}", self.name);
        self.few = Some(match self.few.take() {
            Some((said, all)) => (said, all + 1),
            None => (first(), 1),
        });
    }

    /// Asks in which of the two hours a row is.
    fn ask(&mut self, ns: i64, offsets: [Offset; 2], line: u64) {
        let ((time, date), [before, after]) = (shown(ns), offsets.map(from_utc));
        let why = format!(
            "{time} comes twice in {} on {date}, and nothing tells which it is; say --tz {before} for the first, or {after} for the \
             second",
            self.name
        );
        self.doubted(line, why);
    }
}

/// A time on the written clock (ns) at an offset from UTC as a moment (s since 1970).
fn moment(ns: i64, offset: Offset) -> Option<f64> {
    Some(seconds(ns.checked_sub(i64::from(offset.seconds()) * SECOND)?))
}

/// The time of day and the date of a time on the written clock (ns).
fn shown(ns: i64) -> (String, String) {
    let Ok(moment) = Timestamp::from_nanosecond(i128::from(ns)) else { return Default::default() };
    let civil = Offset::UTC.to_datetime(moment);
    (civil.strftime("%H:%M:%S").to_string(), civil.date().to_string())
}

/// An offset as `--tz` has it: `+01:00`.
fn from_utc(offset: Offset) -> String {
    let seconds = offset.seconds();
    let (sign, all) = (if seconds < 0 { '-' } else { '+' }, seconds.abs());
    format!("{sign}{:02}:{:02}", all / 3600, all / 60 % 60)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 2026-10-25 00:00 on the written clock (s since 1970): clocks go back from 3 to 2 in Central Europe.
    const AUTUMN: i64 = 1_792_886_400;
    /// 2026-03-29 00:00: they go forward from 2 to 3.
    const SPRING: i64 = 1_774_742_400;

    /// Times on the written clock (s since midnight) as seconds since midnight UTC, or what is refused.
    fn read(midnight: i64, times: &[i64], falls: bool) -> Result<Vec<i64>, String> {
        let mut clock = Changes::new(TimeZone::get("Europe/Berlin").expect("a zone"), "Europe/Berlin");
        let steps = times.windows(2).map(|pair| (pair[1] - pair[0]).abs()).filter(|step| *step > 0);
        clock.follow(steps.min().unwrap_or(0) as f64, falls);
        let all = |clock: &mut Changes| -> Vec<Option<f64>> {
            let lines = times.iter().zip(2..);
            lines.map(|(t, line)| clock.read((midnight + t) * SECOND, (0, line), false)).collect()
        };
        let _ = all(&mut clock);
        clock.refuse("line").map_err(|error| error.to_string())?;
        clock.rewind();
        let moments = all(&mut clock).into_iter().map(|t| t.expect("a time") as i64 - midnight);
        Ok(moments.collect())
    }

    /// `02:30` as seconds since midnight.
    fn at(clock: &str) -> i64 {
        let (hours, minutes) = clock.split_once(':').expect("two numbers");
        60 * (60 * hours.parse::<i64>().expect("hours") + minutes.parse::<i64>().expect("minutes"))
    }

    fn all(clocks: &[&str]) -> Vec<i64> {
        clocks.iter().map(|clock| at(clock)).collect()
    }

    #[test]
    fn rows_before_and_behind_tell_which_hour_it_is() {
        for (written, meant) in [
            // From the time before, and back by an hour.
            (
                &["01:40", "02:00", "02:20", "02:40", "02:00", "02:20", "02:40", "03:00"][..],
                &["-1:40", "00:00", "00:20", "00:40", "01:00", "01:20", "01:40", "02:00"][..],
            ),
            // Begun within the hour: what follows tells.
            (&["02:20", "02:40", "02:00", "02:20"], &["00:20", "00:40", "01:00", "01:20"]),
            (&["02:20", "02:40", "03:00"], &["01:20", "01:40", "02:00"]),
            // A late row is in the hour of the others.
            (
                &["01:50", "02:00", "02:10", "02:05", "02:15", "02:25"],
                &["-1:50", "00:00", "00:10", "00:05", "00:15", "00:25"],
            ),
            // Two pauses within the first hour, and one of more than half an hour within the second.
            (
                &["01:59", "02:00", "02:01", "02:15", "02:16", "02:31", "02:32", "02:00", "02:01", "02:50"],
                &["-1:59", "00:00", "00:01", "00:15", "00:16", "00:31", "00:32", "01:00", "01:01", "01:50"],
            ),
            // Hour by hour.
            (&["00:00", "01:00", "02:00", "02:00", "03:00"], &["-0:00", "-1:00", "00:00", "01:00", "02:00"]),
        ] {
            // A minus stands before times of the day's summer, which are two hours ahead of UTC.
            let meant: Vec<i64> = meant
                .iter()
                .map(|clock| clock.strip_prefix('-').map_or_else(|| at(clock), |own| at(own) - 7200))
                .collect();
            assert_eq!(read(AUTUMN, &all(written), false), Ok(meant.clone()), "{written:?}");
            let turned = |times: &[i64]| times.iter().rev().copied().collect::<Vec<i64>>();
            assert_eq!(read(AUTUMN, &turned(&all(written)), true), Ok(turned(&meant)), "{written:?} turned");
        }
    }

    #[test]
    fn what_nothing_decides_is_refused_with_the_option() {
        let said = |midnight: i64, times: &[&str]| read(midnight, &all(times), false).expect_err("a doubt");
        assert_eq!(
            said(SPRING, &["01:58", "02:00", "02:02"]),
            "line 3: 02:00:00 does not exist in Europe/Berlin on 2026-03-29; say --tz +01:00 if the clock is never changed"
        );
        assert_eq!(
            said(AUTUMN, &["02:01", "02:03", "02:05"]),
            "line 2: 02:01:00 comes twice in Europe/Berlin on 2026-10-25, and nothing tells which it is; say --tz +02:00 for the \
             first, or +01:00 for the second"
        );
        let once = said(AUTUMN, &["01:40", "02:00", "02:20", "02:40", "03:00"]);
        assert!(
            once.starts_with(
                "line 6: the hour that comes twice in Europe/Berlin on 2026-10-25 is there once"
            )
        );
        assert!(once.contains("--tz +01:00"), "{once}");
        assert_eq!(read(SPRING, &all(&["01:58", "03:00"]), false), Ok(vec![at("00:58"), at("01:00")]));
    }

    #[test]
    fn a_clock_is_changed_twice_a_year_or_never() {
        let day = |zone: &str, midnight: i64| {
            let zone = super::super::super::options::zone(zone).expect("a zone");
            Changes::new(zone, "").is_changed(midnight as f64, midnight as f64 + 3600.0)
        };
        assert!(day("Europe/Berlin", SPRING) && day("Europe/Berlin", AUTUMN));
        assert!(!day("Europe/Berlin", SPRING + 30 * 86_400) && !day("+01:00", SPRING) && !day("UTC", AUTUMN));
    }
}
