//! What the names of columns mean: the words of the field, of vendors, and of a few languages.

use super::header_zone::HeaderZone;
use super::options::Unit;
use super::vocabulary::{
    CLOCKS, DATES, DETAILS, MODE, MV, OP, OWNERS, PV, QUALITIES, SHORT_QUALITIES, SP, TIME, VALUES,
};
use crate::signal::Role;

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
    pub fn as_str(self) -> &'static str {
        match self {
            Meaning::Time => "t",
            Meaning::Role(role) => role.as_str(),
        }
    }
}

/// Units that may stand behind a name without brackets: `OP %`, `PV degC`.
const UNITS: &[&str] = &[
    "%", "pct", "percent", "ma", "a", "v", "degc", "degf", "°c", "°f", "c", "k", "bar", "mbar", "bara",
    "barg", "pa", "kpa", "mpa", "psi", "psig", "m3/h", "m³/h", "nm3/h", "l/h", "l/min", "l/s", "gpm", "kg/h",
    "kg/s", "t/h", "lb/h", "m", "mm", "cm", "kw", "mw", "rpm", "ph", "ppm", "s", "sec", "secs", "second",
    "seconds", "ms", "us", "µs", "ns", "min", "minutes", "minuten", "h", "hr", "hrs", "hours", "stunden",
    "sekunden", "d", "days", "-", "utc", "gmt", "local", "counts", "raw", "m3/s", "mol/s",
];

/// Longest name that is taken apart (bytes): a longer one is prose, and takes time with the square of its length.
const LONGEST: usize = 512;

/// Units in which a gas is measured.
const GASES: [&str; 7] = ["ppm", "ppmv", "ppb", "mg/m3", "mg/nm3", "vol%", "vol.-%"];

/// What may stand as a unit behind a name of times.
const ZONES: [&str; 5] = ["utc", "gmt", "local", "-", ""];

/// A name of a column or a tag, taken apart.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Name {
    /// As it is written, without blanks around it.
    pub full: String,
    /// Without its unit, in small letters, one blank for each sign that divides words.
    plain: String,
    /// The unit that stands in it.
    pub unit: Option<String>,
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
        Self { plain: plain(bare), unit: unit.map(str::to_string), full }
    }

    /// Whether somebody who writes `wanted` means this column; its unit may be left out.
    pub fn is(&self, wanted: &str) -> bool {
        let wanted = wanted.trim();
        self.full.eq_ignore_ascii_case(wanted) || !self.plain.is_empty() && self.plain == plain(wanted)
    }

    /// What it says of itself.
    pub fn said(&self) -> Option<Said> {
        if self.full.len() > LONGEST {
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
        };
        let time = self.unit.as_ref().is_none_or(of_time);
        // `CO [ppm]` is carbon monoxide.
        let of_gas = |unit: &String| GASES.contains(&unit.to_lowercase().as_str());
        if self.plain == "co" && self.unit.as_ref().is_some_and(of_gas) {
            return None;
        }
        if let Some(meaning) = whole(&self.plain).filter(|meaning| *meaning != Meaning::Time || time) {
            return Some(Said { meaning, owner: String::new() });
        }
        if let Some((meaning, owner)) = with_number(&self.plain) {
            return Some(Said { meaning, owner });
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
        of_controller(&path).or_else(|| short(&path)).map(|(meaning, owner)| Said { meaning, owner })
    }

    /// The unit of times in this column: `Time [min]`, and `Minutes`.
    pub fn unit_of_time(&self) -> Option<String> {
        let by_name = || Unit::of(&self.plain).map(|_| self.plain.clone());
        self.unit.clone().or_else(by_name)
    }

    fn path(&self) -> String {
        split_unit(self.full.trim_start_matches('#').trim()).0.to_string()
    }

    /// Whether it is a date without a time of day, and a time of day without a date.
    pub fn is_date(&self) -> bool {
        DATES.contains(&self.plain.as_str())
    }

    /// See [`Self::is_date`].
    pub fn is_clock(&self) -> bool {
        CLOCKS.contains(&self.plain.as_str())
    }

    /// Whether there is a name at all; pandas calls an index without one `Unnamed: 0`.
    pub fn is_none(&self) -> bool {
        self.plain.is_empty() || self.plain.starts_with("unnamed")
    }

    /// Whether it says if a value is good: `Some` with the name of that value, empty where it stands alone.
    pub fn quality_of(&self) -> Option<String> {
        // `A/M Status` is a mode.
        if MODE.contains(&self.plain.as_str()) {
            return None;
        }
        if QUALITIES.contains(&self.plain.as_str()) {
            let short = SHORT_QUALITIES.contains(&self.plain.as_str());
            return (!short).then(String::new);
        }
        let of = |name: &&str| self.plain.strip_suffix(*name)?.strip_suffix(' ').map(str::to_string);
        QUALITIES.iter().filter_map(of).min_by_key(String::len)
    }

    /// Whether it holds OPC's numbers beside a column of another numbering, as in AVEVA's historian.
    pub fn is_detail(&self) -> bool {
        DETAILS.iter().any(|detail| {
            self.plain.strip_suffix(detail).is_some_and(|of| of.is_empty() || of.ends_with(' '))
        })
    }

    /// Whether its cells may name the loop of their row, where OP and PV have columns of their own.
    pub fn is_owner(&self) -> bool {
        OWNERS.contains(&self.plain.as_str())
    }

    /// Whether a quality column of this name (see [`Self::quality_of`]) belongs to it.
    pub fn owns_quality(&self, of: &str) -> bool {
        let short = self.said().map(|said| said.meaning.as_str());
        let value =
            VALUES.iter().any(|value| self.plain.strip_suffix(value).is_some_and(|p| p.trim_end() == of));
        self.plain == of || value || short == Some(of)
    }

    /// In small letters without its unit.
    pub fn plain(&self) -> &str {
        &self.plain
    }
}

/// What divides the parts of a path.
const PATH: [char; 8] = ['.', '/', '\\', ':', '|', '!', '>', '#'];

fn plain(name: &str) -> String {
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
pub fn controller(path: &str) -> Option<String> {
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
pub fn as_unit(cell: &str) -> Option<&str> {
    let cell = super::number::bare(cell);
    let inner = [('[', ']'), ('(', ')')]
        .iter()
        .find_map(|(open, close)| cell.strip_prefix(*open)?.strip_suffix(*close))
        .map_or(cell, str::trim);
    is_unit(inner).then_some(inner)
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
            return (before.trim_end_matches(['_', ' ', ',']).trim(), Some(without_range(unit.trim())));
        }
    }
    if let Some((before, unit)) = name.rsplit_once([' ', ',', '_'])
        && !before.trim().is_empty()
    {
        let before = before.trim_end_matches([' ', ',', '_']);
        let is_time = || whole(&plain(before)) == Some(Meaning::Time);
        // `OP Min` is the least of something, and only times are counted in minutes.
        let is_least = unit.eq_ignore_ascii_case("min") && !is_time();
        let is_zone = !name.contains('_') && HeaderZone::of(unit).is_some();
        if is_unit(unit) && !is_least || is_zone && is_time() {
            return (before, Some(unit));
        }
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
mod tests {
    use super::*;

    fn said(name: &str) -> Option<(&'static str, String)> {
        Name::new(name).said().map(|said| (said.meaning.as_str(), said.owner))
    }

    #[test]
    fn names_of_vendors_say_what_they_are() {
        for (name, meaning, owner) in [
            ("t", "t", ""),
            ("Time Stamp", "t", ""),
            ("time [s]", "t", ""),
            ("t/min", "t", ""),
            ("t_ms", "t", ""),
            ("Timestamp (UTC)", "t", ""),
            ("OP [%]", "op", ""),
            ("OP %", "op", ""),
            ("OP%", "op", ""),
            ("PV degC", "pv", ""),
            ("PV, m3/h", "pv", ""),
            ("Process Value", "pv", ""),
            ("setpoint", "sp", ""),
            ("SV", "sp", ""),
            ("mv_stem", "mv", ""),
            ("FIC101.OP", "op", "fic101"),
            ("FIC101.PIDA.OP", "op", "fic101 pida"),
            ("FIC101/PID1/OUT.CV", "op", "fic101 pid1"),
            ("FIC101/PID1/PV.CV", "pv", "fic101 pid1"),
            ("FIC101/PID1/MODE.ACTUAL", "mode", "fic101 pid1"),
            ("FIC101:PV [m3/h]", "pv", "fic101"),
            ("FIC101_PV", "pv", "fic101"),
            ("('FIC101', 'PV')", "pv", "fic101"),
            ("[FIC101.PV]", "pv", "fic101"),
            ("Date Time, GMT+02:00", "t", ""),
            ("Time (Europe/Berlin)", "t", ""),
            ("Time min", "t", ""),
            ("\\\\SERVER\\FIC101.PV", "pv", "server fic101"),
            ("FIC101 OP %", "op", "fic101"),
            ("CV", "op", ""),
            ("FIC101 Out", "op", "fic101"),
            ("FIC-101 Process Value", "pv", "fic 101"),
            ("FIC101_OP.F_CV", "op", "fic101"),
            ("FIC101/MV#Value", "mv", "fic101"),
            ("FIC101.ScaledInput", "pv", "fic101"),
            ("OP_1", "op", "1"),
            ("PV 2 [%]", "pv", "2"),
            ("OP [4-20 mA]", "op", ""),
        ] {
            assert_eq!(said(name), Some((meaning, owner.to_string())), "{name}");
        }
        for name in [
            "flow",
            "flow_out",
            "T5",
            "T_C",
            "T [degC]",
            "P1_kPa",
            "remark",
            "",
            "XMEAS1",
            "OP Min",
            "_measurement",
            "temp out",
            "FIC101 High Output",
            "FT101 Out",
            "OP_2026",
        ] {
            assert_eq!(said(name), None, "{name}");
        }
        for (name, unit) in [
            ("OP [4-20 mA]", "mA"),
            ("OP (0...100 %)", "%"),
            ("PV [5]", "5"),
            ("T [2-1]", "2-1"),
            ("Time (100 ms)", "100 ms"),
            ("t/min", "min"),
        ] {
            assert_eq!(Name::new(name).unit.as_deref(), Some(unit), "{name}");
        }
    }

    #[test]
    fn a_quality_names_the_value_it_belongs_to() {
        let of = |name: &str| Name::new(name).quality_of();
        assert_eq!(of("pv_quality"), Some("pv".into()));
        assert_eq!(of("OP Status"), Some("op".into()));
        assert_eq!(of("FIC101.PV.Status"), Some("fic101 pv".into()));
        assert_eq!(of("Quality"), Some(String::new()));
        assert_eq!(of("q"), None);
        assert_eq!(of("pv"), None);
        assert!(Name::new("FIC101.PV").owns_quality("fic101 pv"));
        assert!(Name::new("FIC101.PV").owns_quality("pv"));
        assert!(Name::new("FIC101/PID1/PV.CV").owns_quality("fic101 pid1 pv"));
        assert!(!Name::new("FIC101.OP").owns_quality("pv"));
    }

    #[test]
    fn somebody_who_writes_a_name_means_its_column() {
        assert!(Name::new("OP [%]").is("op"));
        assert!(Name::new("FIC101.OP").is("fic101.op"));
        assert!(!Name::new("FIC101.OP").is("op"));
    }
}
