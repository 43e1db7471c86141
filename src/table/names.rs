//! What the names of columns mean: the words of the field, of vendors, and of a few languages.

use super::header_format::is_format;
use super::header_zone::{HeaderZone, speaks_of_zone};
use super::options::Unit;
use super::vocabulary::{CLOCKS, DATES, FLAGGED, MODE, MV, OF_MANY, OP, OWNERS, PV, SP, TIME, VALUES};
use crate::signal::Role;
use std::sync::OnceLock;

/// What a column's name says it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Meaning {
    /// The stamp, or the date of it.
    Time,
    /// What belongs to the loop.
    Role(Role),
}

impl Meaning {
    /// As options and messages name it.
    pub(super) fn as_str(self) -> &'static str {
        match self {
            Meaning::Time => "t",
            Meaning::Role(role) => role.as_str(),
        }
    }
}

/// Units that may stand behind a name without brackets: `OP %`, `PV degC`; a letter alone only behind a comma or times (`t_s`).
const UNITS: &[&str] = &[
    "%", "pct", "percent", "ma", "a", "v", "degc", "degf", "°c", "°f", "c", "k", "bar", "mbar", "bara",
    "barg", "pa", "kpa", "mpa", "psi", "psig", "m3/h", "m³/h", "nm3/h", "l/h", "l/min", "l/s", "gpm", "kg/h",
    "kg/s", "t/h", "lb/h", "m", "mm", "cm", "kw", "mw", "rpm", "ph", "ppm", "s", "sec", "secs", "second",
    "seconds", "ms", "us", "µs", "ns", "min", "minutes", "minuten", "h", "hr", "hrs", "hours", "stunden",
    "sekunden", "d", "days", "-", "utc", "gmt", "local", "counts", "raw", "m3/s", "mol/s",
];

/// Longest name that is taken apart (bytes): a longer one is prose, and takes time with the square of its length.
pub(super) const LONGEST: usize = 512;

/// Units in which a gas is measured.
const GASES: [&str; 7] = ["ppm", "ppmv", "ppb", "mg/m3", "mg/nm3", "vol%", "vol.-%"];

/// What may stand as a unit behind a name of times.
const ZONES: [&str; 5] = ["utc", "gmt", "local", "-", ""];

/// Zones that may stand before a name of times.
const BEFORE: [&str; 3] = ["utc", "gmt", "local"];

/// A name of a column or a tag, taken apart.
#[derive(Clone, Debug)]
pub struct Name {
    /// As it is written, without blanks around it.
    pub(super) full: String,
    /// Without its unit, in small letters, one blank for each sign that divides words.
    plain: String,
    /// The unit that stands in it.
    pub(super) unit: Option<String>,
    /// What it says, once somebody has asked: many ask, and each name takes long.
    said: OnceLock<Option<Said>>,
    /// Once asked, what a quality column may call it.
    pub(super) called: OnceLock<Vec<String>>,
}

/// What a name says, and how plainly.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Said {
    /// What it is.
    pub meaning: Meaning,
    /// The part before it: the loop of `FIC101.OP`; empty where the whole name says it.
    pub owner: String,
}

impl Name {
    /// Takes a cell of a header apart.
    pub fn new(cell: &str) -> Self {
        let mut full = super::number::bare(cell).trim_matches(['"', '\'']).trim().to_string();
        // pandas writes names of several levels so: `('FIC101', 'OP')`.
        if let Some(levels) = full.strip_prefix("('").and_then(|rest| rest.strip_suffix("')")) {
            full = levels.split("', '").collect::<Vec<_>>().join(".");
        }
        let bare = full.trim_start_matches('#').trim();
        let (bare, unit) = split_unit(bare);
        // What stands in brackets may say what it is: `Flow (PV)`.
        let unit = unit.filter(|unit| labelled(unit).is_none());
        Self {
            plain: plain(bare),
            unit: unit.map(str::to_string),
            full,
            said: OnceLock::new(),
            called: OnceLock::new(),
        }
    }

    /// Whether somebody who writes `wanted` means this column; its unit may be left out.
    pub(super) fn is(&self, wanted: &str) -> bool {
        let wanted = wanted.trim();
        self.full.eq_ignore_ascii_case(wanted) || !self.plain.is_empty() && self.plain == plain(wanted)
    }

    /// What it says of itself.
    pub fn said(&self) -> Option<Said> {
        self.said.get_or_init(|| self.find()).clone()
    }

    fn find(&self) -> Option<Said> {
        if self.full.len() > LONGEST {
            return None;
        }
        // `Bad_PV` is a flag.
        if self.plain.split_once(' ').is_some_and(|(first, _)| FLAGGED.contains(&first)) {
            return None;
        }
        // InfluxDB's name of a table, in which PV may stand beside it.
        if self.full == "_measurement" {
            return None;
        }
        // `T_C` is a temperature: a time has a unit of time, or the name of a zone.
        let of_time = |unit: &String| {
            Unit::of(unit).is_some()
                || ZONES.contains(&unit.to_lowercase().as_str())
                || HeaderZone::of(unit).is_some()
                || speaks_of_zone(unit)
                || is_format(unit)
        };
        let time = self.unit.as_ref().is_none_or(of_time);
        // `CO [ppm]` is carbon monoxide.
        let of_gas = |unit: &String| GASES.contains(&unit.to_lowercase().as_str());
        if self.plain == "co" && self.unit.as_ref().is_some_and(of_gas) {
            return None;
        }
        let label = split_unit(self.bare()).1.and_then(labelled);
        let of_whole = whole(&self.plain).filter(|meaning| *meaning != Meaning::Time || time);
        if let Some(meaning) = label.or(of_whole) {
            // `Output (PV)` is either.
            let one = label.is_none() || of_whole.is_none_or(|own| own == meaning);
            let is_tag = |name: &&str| controller(name).is_some_and(|tag| name.replace(' ', "") == tag);
            let owner = Some(self.plain.as_str()).filter(|name| label.is_some() && is_tag(name));
            return one.then(|| Said { meaning, owner: owner.unwrap_or_default().to_string() });
        }
        if let Some((meaning, owner)) = with_number(&self.plain) {
            return Some(Said { meaning, owner });
        }
        if let Some((_, Said { meaning, owner }, letter)) = self.before_letter() {
            return Some(Said { meaning, owner: plain(&format!("{owner} {letter}")) });
        }
        // `FIC101.PV - FIC101.SP` is a difference.
        let is_known = |name: &str| Name::new(name).said().is_some();
        let are_known =
            |(one, other): (&str, &str)| !other.contains(" - ") && is_known(one) && is_known(other);
        if self.full.split_once(" - ").is_some_and(are_known) {
            return None;
        }
        let path = self.path();
        let parts: Vec<&str> = path.split(PATH).map(str::trim).filter(|part| !part.is_empty()).collect();
        let said = |meaning: Meaning, before: &[&str]| Said { meaning, owner: plain(&before.join(".")) };
        if let [before @ .., last] = parts.as_slice()
            && !before.is_empty()
        {
            // The output of an analog input's block is what it measures.
            let is_measured = |name: &str, before: &[&str]| {
                role(&plain(name)) == Some(Meaning::Role(Role::Op))
                    && before.last().is_some_and(|block| is_input(block))
            };
            if is_measured(last, before) {
                return None;
            }
            if let [earlier @ .., named] = before {
                if VALUES.contains(&plain(last).as_str()) && is_measured(named, earlier) {
                    return None;
                }
                let both = plain(&format!("{named} {last}"));
                let of_value = VALUES.contains(&plain(last).as_str()).then(|| plain(named));
                if let Some(meaning) = of_value.as_deref().and_then(role).or_else(|| role(&both)) {
                    return Some(said(meaning, earlier));
                }
            }
            // Foxboro's bit of automatic is called as a unit is, so that the tag of a controller has to stand before it.
            let is_bit = plain(last) == "ma" && controller(&plain(&before.join("."))).is_some();
            let bit = is_bit.then_some(Meaning::Role(Role::Mode));
            if let Some(meaning) = role(&plain(last)).or(bit) {
                return Some(said(meaning, before));
            }
        }
        // `FIC101_OP.F_CV`: the value of what stands before it.
        let path = match parts.as_slice() {
            [before @ .., last] if !before.is_empty() && VALUES.contains(&plain(last).as_str()) => {
                before.join(".")
            }
            _ => path,
        };
        let said = of_controller(&path).or_else(|| short(&path)).or_else(|| joined(&path));
        said.map(|(meaning, owner)| Said { meaning, owner }).or_else(|| self.described())
    }

    /// The name before the letter of a loop, what it says, and that letter: `FIC101.OP` and `B` of `FIC101.OP_B`. `Q` is a quality.
    fn before_letter(&self) -> Option<(Name, Said, String)> {
        let path = self.path();
        let (before, letter) = path.rsplit_once([' ', '_'])?;
        let before = before.trim_end_matches([' ', '_']);
        // `FIC101.OP - Valve B` has words of its own, and `A M` is no loop.
        let is_loop = is_letter(letter) && !letter.eq_ignore_ascii_case("q") && !path.contains(" - ");
        let is_first = plain(before).rsplit(' ').next().is_some_and(|last| !is_letter(last));
        let name = (is_loop && is_first).then(|| Name::new(before))?;
        let said = name.said().filter(|said| matches!(said.meaning, Meaning::Role(_)))?;
        Some((name, said, letter.to_string()))
    }

    /// The name of OP, PV and the like before the letter of a loop, and that letter: `FIC101.OP` and `B` of `FIC101.OP_B`.
    pub(super) fn lettered(&self) -> Option<(Name, String)> {
        self.before_letter().map(|(name, _, letter)| (name, letter))
    }

    /// `FIC101.OP - Valve of the feed`: a tag and what it is in words.
    fn described(&self) -> Option<Said> {
        let (tag, words) = self.full.split_once(" - ")?;
        Name::new(tag).said().filter(|said| !said.owner.is_empty() && !Name::new(words).is_none())
    }

    /// The owner of [`Self::said`] as it is written: `FIC-101/PID1` of `FIC-101/PID1/OUT.CV`.
    pub fn owner_as_written(&self) -> Option<String> {
        let said = self.said()?;
        let bracketed = || {
            let unit = self.unit.as_deref()?;
            controller(&plain(unit))
                .filter(|tag| plain(unit).replace(' ', "") == *tag)
                .map(|_| unit.to_string())
        };
        if said.owner.is_empty() {
            return bracketed();
        }
        if let Some((name, letter)) = self.lettered() {
            return Some(match name.owner_as_written() {
                Some(own) => format!("{own} {letter}"),
                None => letter,
            });
        }
        // The shortest beginning that has as many letters.
        let all = said.owner.chars().filter(|c| *c != ' ').count();
        let mut letters = 0;
        let end = self.full.char_indices().find_map(|(at, c)| {
            letters += plain(&c.to_string()).chars().count();
            (letters >= all).then_some(at + c.len_utf8())
        });
        let written = end.and_then(|end| self.full.get(..end)).filter(|before| plain(before) == said.owner);
        let trimmed = written.map(|own| own.trim_start_matches(['[', '(', '{', '#', '"', '\'', ' ']));
        // `OP_1` has the number of its loop behind it.
        Some(trimmed.unwrap_or(&said.owner).to_string())
    }

    /// The unit of times in this column: `Time [min]`, and `Minutes`.
    pub(super) fn unit_of_time(&self) -> Option<String> {
        let by_name = || Unit::of(&self.plain).map(|_| self.plain.clone());
        self.unit.clone().or_else(by_name)
    }

    /// As it is written, without its unit.
    pub(super) fn path(&self) -> String {
        split_unit(self.bare()).0.to_string()
    }

    /// What stands in brackets behind it, a unit or anything else; a unit without brackets counts as well.
    pub(super) fn brackets(&self) -> &str {
        split_unit(self.bare()).1.unwrap_or_default()
    }

    fn bare(&self) -> &str {
        self.full.trim_start_matches('#').trim()
    }

    /// Whether it is a date without a time of day, and a time of day without a date.
    pub(super) fn is_date(&self) -> bool {
        DATES.contains(&self.plain.as_str())
    }

    /// See [`Self::is_date`].
    pub(super) fn is_clock(&self) -> bool {
        CLOCKS.contains(&self.plain.as_str())
    }

    /// Whether there is a name at all; pandas calls an index without one `Unnamed: 0`.
    pub(super) fn is_none(&self) -> bool {
        self.plain.is_empty() || self.plain.starts_with("unnamed")
    }

    /// Whether its cells may name the loop of their row, where OP and PV have columns of their own.
    pub(super) fn is_owner(&self) -> bool {
        OWNERS.contains(&self.plain.as_str())
    }

    /// In small letters without its unit.
    pub(super) fn plain(&self) -> &str {
        &self.plain
    }
}

/// What divides the parts of a path.
const PATH: [char; 8] = ['.', '/', '\\', ':', '|', '!', '>', '#'];

/// In small letters, one blank for each sign that divides words.
pub(super) fn plain(name: &str) -> String {
    let mut out = String::with_capacity(name.len());
    for c in name.chars().flat_map(char::to_lowercase) {
        if c.is_alphanumeric() || matches!(c, '%' | '°') {
            out.push(c);
        } else if !out.is_empty() && !out.ends_with(' ') {
            out.push(' ');
        }
    }
    out.truncate(out.trim_end().len());
    out
}

/// The shortest names: longer words beside others are tags of their own.
const SHORT: [&str; 7] = ["op", "pv", "sp", "sv", "mv", "co", "mode"];

/// `FIC101_OP`: only the shortest names, for words as `flow_out` are tags of their own.
fn short(path: &str) -> Option<(Meaning, String)> {
    let (before, last) = path.rsplit_once(['_', '-', ' '])?;
    let last = plain(last);
    role(&last)
        .filter(|_| SHORT.contains(&last.as_str()) && !before.trim().is_empty())
        .map(|meaning| (meaning, plain(before)))
}

/// `FIC101 Out`, `FIC-101 Process Value`, `PLC01/FIC101_CV`: any word behind the tag of a controller.
fn of_controller(path: &str) -> Option<(Meaning, String)> {
    let (area, last) = path.rsplit_once(PATH).unwrap_or(("", path));
    let words = plain(last);
    words.match_indices(' ').find_map(|(at, _)| {
        let (before, behind) = (&words[..at], &words[at + 1..]);
        let is_tag = controller(before).is_some_and(|tag| before.replace(' ', "") == tag);
        role(behind).filter(|_| is_tag).map(|meaning| (meaning, plain(&format!("{area} {before}"))))
    })
}

/// `FIC101OP`: the tag of a controller and what it has, with nothing between them.
fn joined(path: &str) -> Option<(Meaning, String)> {
    const BEHIND: [&str; 5] = ["op", "pv", "sp", "sv", "mv"];
    let (area, last) = path.rsplit_once(PATH).unwrap_or(("", path));
    let last = plain(last);
    let (tag, word) = BEHIND.iter().find_map(|word| Some((last.strip_suffix(*word)?, *word)))?;
    let is_tag = controller(tag).is_some_and(|own| own == tag.replace(' ', ""));
    role(word).filter(|_| is_tag).map(|meaning| (meaning, plain(&format!("{area} {tag}"))))
}

/// What brackets behind a name say it is: `Valve (OP)`. `mV` is a unit, and `CO` a gas.
fn labelled(unit: &str) -> Option<Meaning> {
    let small = plain(unit);
    role(&small).filter(|_| ["op", "pv", "sp", "mode"].contains(&small.as_str()))
}

/// `OP_1`, `PV_1`: the shortest names with the number of a loop behind them.
fn with_number(name: &str) -> Option<(Meaning, String)> {
    let (word, number) = name.split_once(' ')?;
    let counts = (1..=3).contains(&number.len()) && number.bytes().all(|byte| byte.is_ascii_digit());
    role(word).filter(|_| counts && SHORT.contains(&word)).map(|meaning| (meaning, number.to_string()))
}

fn role(name: &str) -> Option<Meaning> {
    let lists = [(Role::Op, OP), (Role::Pv, PV), (Role::Sp, SP), (Role::Mv, MV), (Role::Mode, MODE)];
    lists.iter().find(|(_, names)| names.contains(&name)).map(|(role, _)| Meaning::Role(*role))
}

/// Whether a block of a path is an analog input: `AI1`.
fn is_input(block: &str) -> bool {
    let small = plain(block);
    let number = small.strip_prefix("ai").or_else(|| small.rsplit_once(' ')?.1.strip_prefix("ai"));
    number.is_some_and(|number| number.bytes().all(|byte| byte.is_ascii_digit()))
}

/// The tag of a controller (ISA-5.1: letters that end with C, and a number) that the path of a name ends with, but for its blocks:
/// `fic101` of `unit1 fic 101 pida`. Transmitters and valves have other letters, and belong to a controller of another name.
pub(super) fn controller(path: &str) -> Option<String> {
    let words: Vec<&str> = path.split(' ').collect();
    let letters = |word: &str| word.bytes().take_while(u8::is_ascii_lowercase).count();
    let is_tag = |tag: &str| {
        let n = letters(tag);
        (2..=4).contains(&n) && tag.bytes().skip(n).take_while(u8::is_ascii_digit).count() > 1
    };
    // `FIC-101` is two words.
    let joined = |at: usize| {
        let before = at.checked_sub(1).map(|at| words[at]).filter(|word| letters(word) == word.len());
        let number = words[at].starts_with(|c: char| c.is_ascii_digit());
        before.filter(|_| number).unwrap_or_default().to_string() + words[at]
    };
    let last = (0..words.len()).rev().map(joined).find(|tag| is_tag(tag))?;
    (last.as_bytes()[letters(&last) - 1] == b'c').then_some(last)
}

fn whole(name: &str) -> Option<Meaning> {
    TIME.contains(&name).then_some(Meaning::Time).or_else(|| role(name))
}

/// Whether a text is a unit by itself, in brackets or not: a cell of a row of units.
pub(super) fn as_unit(cell: &str) -> Option<&str> {
    let cell = super::number::bare(cell);
    let inner = [('[', ']'), ('(', ')')]
        .iter()
        .find_map(|(open, close)| cell.strip_prefix(*open)?.strip_suffix(*close))
        .map_or(cell, str::trim);
    is_unit(inner).then_some(inner)
}

fn is_letter(text: &str) -> bool {
    text.len() == 1 && text.bytes().all(|byte| byte.is_ascii_alphabetic())
}

/// Whether a name is that of times, or ends with one: `t`, `OP_time`.
fn is_of_times(name: &str) -> bool {
    let name = plain(name);
    let is_end = |rest: &str| rest.is_empty() || rest.ends_with(' ');
    TIME.iter().any(|own| name.strip_suffix(*own).is_some_and(is_end))
}

fn is_unit(text: &str) -> bool {
    let small = text.to_lowercase();
    UNITS.contains(&small.as_str()) || small.starts_with('%') || small.starts_with('°')
}

/// `mA` of `4-20 mA` and of `4...20mA`; anything else as it is.
fn without_range(unit: &str) -> &str {
    let behind = unit.trim_start_matches(|c: char| c.is_ascii_digit() || "-–+., …".contains(c));
    // `100 ms` is a multiple.
    let from_to = &unit[..unit.len() - behind.len()];
    let has_to = ["-", "–", "…", ".."].iter().any(|sign| from_to.contains(sign));
    let is_range = has_to && unit.starts_with(|c: char| c.is_ascii_digit()) && is_unit(behind);
    if is_range { behind } else { unit }
}

/// `OP [%]`, `OP (%)`, `OP %`, `PV, m3/h`, `t_ms` as name and unit.
fn split_unit(name: &str) -> (&str, Option<&str>) {
    for (open, close) in [('[', ']'), ('(', ')'), ('{', '}')] {
        if let Some((before, unit)) = name.strip_suffix(close).and_then(|n| n.rsplit_once(open))
            && !before.trim().is_empty()
        {
            // HOBO's loggers write who measured behind the unit: `OP, % (LGR S/N: 20123, LBL: OP)`.
            if unit.contains(": ") {
                return split_unit(before.trim());
            }
            let word = plain(unit);
            // `OP (Min)` is the least of many, and `Time (min)` is counted in minutes.
            let of_role = |name: &str| {
                Name::new(name).said().is_some_and(|said| matches!(said.meaning, Meaning::Role(_)))
            };
            let nested = before.trim_end().ends_with([')', ']', '}']);
            if OF_MANY.contains(&word.as_str()) && !nested && of_role(before) {
                return (name.trim(), None);
            }
            let before = before.trim_end_matches(['_', ' ', ',']).trim();
            // `FIC101.OP (Value)` has no unit.
            let unit = Some(without_range(unit.trim())).filter(|_| !VALUES.contains(&word.as_str()));
            return (before, unit);
        }
    }
    if let Some((before, unit)) = name.rsplit_once([' ', ',', '_'])
        && !before.trim().is_empty()
    {
        // `OP_C` is that of loop C: a letter alone is a unit behind a comma and behind times.
        let has_comma = name[before.len()..].starts_with(',') || before.trim_end().ends_with(',');
        let before = before.trim_end_matches([' ', ',', '_']);
        let may_be_loop = is_letter(unit) && !has_comma && !is_of_times(before);
        let is_time = || whole(&plain(before)) == Some(Meaning::Time);
        // `OP Min` is the least of something, and only times are counted in minutes.
        let is_least = unit.eq_ignore_ascii_case("min") && !is_time();
        let is_zone = !name.contains('_') && HeaderZone::of(unit).is_some();
        // `FIC101 MV` is a value, and `TC101 mV` what a thermocouple gives.
        let is_unit = is_unit(unit) || unit == "mV";
        if is_unit && !is_least && !may_be_loop || is_zone && is_time() {
            return (before, Some(unit));
        }
    }
    // `UTC time`: the zone may stand before the name.
    if let Some((zone, times)) = name.split_once([' ', '_'])
        && BEFORE.contains(&zone.to_lowercase().as_str())
        && whole(&plain(times)) == Some(Meaning::Time)
    {
        return (times.trim(), Some(zone));
    }
    // `t/min`, as DIN 1313 labels an axis.
    if let Some((before, unit)) = name.rsplit_once('/')
        && whole(&plain(before)) == Some(Meaning::Time)
        && Unit::of(unit).is_some()
    {
        return (before.trim(), Some(unit.trim()));
    }
    if let Some(before) = name.strip_suffix('%').filter(|before| !before.trim().is_empty()) {
        return (before.trim(), Some("%"));
    }
    (name.trim(), None)
}

#[cfg(test)]
mod tests;
