//! What a reader of a table may be told where the table leaves a doubt.

use super::error::TableError;
use super::number::Decimal;
use super::several::LoopColumns;
use super::stamp::Order;
use jiff::tz::TimeZone;
use serde::Deserialize;
use std::path::PathBuf;

/// What is told of a table; everything left out is found from the table itself.
///
/// The names are those of the command line, of the API's `table` and of `[tables.defaults]` in a configuration.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// The column of times, by name or by number from 1.
    pub time: Option<String>,
    /// The column, or the tag of a long table, of the controller's output.
    pub op: Option<String>,
    /// The same of the measured value.
    pub pv: Option<String>,
    /// The same of the set point.
    pub sp: Option<String>,
    /// The same of the valve's measured position.
    pub mv: Option<String>,
    /// The same of the controller's mode; `none` where no column is.
    pub mode: Option<String>,
    /// The column of tags of a long table, by name or by number from 1.
    pub tag: Option<String>,
    /// The column of values of a long table.
    pub value: Option<String>,
    /// `dmy`, `mdy`, `ymd`, a pattern such as `dd/mm/yyyy hh:mm:ss`, or one of strptime (`%d/%m/%Y %H:%M:%S`).
    pub time_format: Option<String>,
    /// The time zone of stamps without an offset: an IANA name (`Europe/Berlin`), or `+02:00`; UTC where it is left out.
    pub tz: Option<String>,
    /// What times as numbers count: `s`, `ms`, `us`, `ns`, `min`, `h`, `days` of a spreadsheet, `s1904`, `ticks`, `datenum`.
    pub time_unit: Option<String>,
    /// How text is encoded, by its label on the web: `utf-8`, `windows-1250`, `shift_jis`; guessed where it is left out.
    pub encoding: Option<String>,
    /// The decimal sign: `.` or `,` (`point` or `comma`).
    pub decimal: Option<String>,
    /// What divides cells: `,`, `;`, `|`, `tab`.
    pub separator: Option<String>,
    /// Values of the mode column that are automatic, divided by commas; every other one is not.
    pub auto_values: Option<String>,
    /// Values of quality columns that are good, divided by commas, `blank` for a cell with nothing in it; every other one is not.
    pub good_values: Option<String>,
    /// The sheet of a workbook.
    pub sheet: Option<String>,
    /// The loop, where a table has several.
    #[serde(skip)]
    pub of_loop: Option<String>,
    /// The loops of a table with a column for each tag of several, where all of them are read; empty where their names tell them.
    #[serde(skip)]
    pub several: Option<Vec<LoopColumns>>,
    /// Names of those that are told of tables of all kinds: what a table says of itself comes before them.
    #[serde(skip)]
    pub of_all: Vec<&'static str>,
}

/// `[tables]`: files of samples that the API may be asked to read.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// The folder in which they are; without it none is read.
    pub folder: Option<PathBuf>,
    /// What is told of each where the request says nothing else.
    pub defaults: Options,
}

impl Config {
    /// What is wrong with `[tables.defaults]`: the field, and why.
    pub fn validate(&self) -> Vec<(&'static str, String)> {
        let said = |wrong: Wrong| {
            (wrong.key, format!("{}: {:?} cannot be read: {}", wrong.key, wrong.value, wrong.right))
        };
        self.defaults.wrong().into_iter().map(said).collect()
    }
}

/// What numbers of time count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// Seconds, since 1970 or since anything.
    Seconds,
    /// Seconds since 1904, as LabVIEW and the Macintosh count.
    SecondsSince1904,
    /// Thousandths.
    Millis,
    /// Millionths.
    Micros,
    /// Billionths.
    Nanos,
    /// Minutes.
    Minutes,
    /// Hours.
    Hours,
    /// Days since 1899-12-30, as spreadsheets count.
    Days,
    /// Tenths of a microsecond since 1601, as Windows counts.
    FileTime,
    /// Tenths of a microsecond since the year 1, as .NET counts.
    Ticks,
    /// Days since the year 0, as MATLAB counts.
    DateNum,
    /// Days since 1858-11-17, as astronomers count (modified Julian days).
    Mjd,
}

impl Unit {
    /// By the name in an option, a header or a row of units.
    pub fn of(name: &str) -> Option<Self> {
        Some(match name.trim().to_lowercase().as_str() {
            "s" | "sec" | "secs" | "second" | "seconds" | "sekunden" => Unit::Seconds,
            "ms" | "millis" | "milliseconds" => Unit::Millis,
            "us" | "µs" | "micros" | "microseconds" => Unit::Micros,
            "ns" | "nanos" | "nanoseconds" => Unit::Nanos,
            "min" | "mins" | "minute" | "minutes" | "minuten" => Unit::Minutes,
            "h" | "hr" | "hrs" | "hour" | "hours" | "stunden" => Unit::Hours,
            "d" | "days" | "serial" => Unit::Days,
            "s1904" => Unit::SecondsSince1904,
            "ticks" => Unit::Ticks,
            "datenum" => Unit::DateNum,
            "mjd" => Unit::Mjd,
            _ => return None,
        })
    }
}

/// The options, understood.
pub struct Told {
    /// See [`Options::of_all`].
    of_all: Vec<&'static str>,
    pub encoding: Option<&'static encoding_rs::Encoding>,
    pub decimal: Option<Decimal>,
    pub separator: Option<u8>,
    pub zone: Zone,
    pub unit: Option<Unit>,
    pub format: Option<Format>,
    pub auto_values: Option<Vec<String>>,
    pub good_values: Option<Vec<String>>,
}

impl Told {
    /// Whether an option of this name is told of tables of all kinds.
    pub fn is_default(&self, name: &str) -> bool {
        self.of_all.contains(&name)
    }
}

/// The time zone of stamps without an offset.
#[derive(Clone)]
pub struct Zone {
    /// As it was told; `None` for UTC by default.
    pub name: Option<String>,
    /// The rules; `None` for UTC.
    pub rules: Option<TimeZone>,
}

/// How stamps are written.
pub enum Format {
    /// The order of day, month and year.
    Order(Order),
    /// A pattern of strptime.
    Pattern(String),
}

impl Options {
    /// The column that is told for a role.
    pub(super) fn column(&self, role: &str) -> Option<&str> {
        match role {
            "t" => &self.time,
            "op" => &self.op,
            "pv" => &self.pv,
            "sp" => &self.sp,
            "mv" => &self.mv,
            "mode" => &self.mode,
            "tag" => &self.tag,
            "value" => &self.value,
            _ => &None,
        }
        .as_deref()
    }

    /// The same, told of tables of all kinds.
    pub fn of_all_tables(&self) -> Self {
        let all = [
            ("tz", &self.tz),
            ("time_unit", &self.time_unit),
            ("time_format", &self.time_format),
            ("sheet", &self.sheet),
        ];
        let of_all = all.into_iter().filter(|(_, own)| own.is_some()).map(|(name, _)| name).collect();
        Self { of_all, ..self.clone() }
    }

    /// Sets one by its name, as the API has it; `false` for a name that none has.
    pub fn set(&mut self, name: &str, value: String) -> bool {
        self.of_all.retain(|own| *own != name);
        let place = match name {
            "time" => &mut self.time,
            "op" => &mut self.op,
            "pv" => &mut self.pv,
            "sp" => &mut self.sp,
            "mv" => &mut self.mv,
            "mode" => &mut self.mode,
            "tag" => &mut self.tag,
            "value" => &mut self.value,
            "encoding" => &mut self.encoding,
            "time_format" => &mut self.time_format,
            "tz" => &mut self.tz,
            "time_unit" => &mut self.time_unit,
            "decimal" => &mut self.decimal,
            "separator" => &mut self.separator,
            "auto_values" => &mut self.auto_values,
            "good_values" => &mut self.good_values,
            "sheet" => &mut self.sheet,
            _ => return false,
        };
        *place = Some(value);
        true
    }

    /// Those that cannot be understood.
    fn wrong(&self) -> Vec<Wrong> {
        let all = [
            self.encoding().err(),
            self.decimal().err(),
            self.separator().err(),
            self.unit().err(),
            self.format().err(),
            self.rules().err(),
        ];
        all.into_iter().flatten().collect()
    }

    /// Understands them.
    ///
    /// # Errors
    /// One that cannot be understood, by its name.
    pub fn told(&self) -> Result<Told, TableError> {
        let refused = |wrong: Wrong| {
            let option = wrong.key.replace('_', "-");
            TableError::refused(format!("--{option} {:?}: {}", wrong.value, wrong.right))
        };
        let list = |text: &Option<String>| {
            let own = text.as_deref()?.split(',').map(|one| one.trim().to_lowercase());
            Some(own.filter(|one| !one.is_empty()).collect::<Vec<_>>())
        };
        Ok(Told {
            of_all: self.of_all.clone(),
            encoding: self.encoding().map_err(refused)?,
            decimal: self.decimal().map_err(refused)?,
            separator: self.separator().map_err(refused)?,
            zone: Zone { name: self.tz.clone(), rules: self.rules().map_err(refused)? },
            unit: self.unit().map_err(refused)?,
            format: self.format().map_err(refused)?,
            auto_values: list(&self.auto_values),
            good_values: list(&self.good_values),
        })
    }

    fn encoding(&self) -> Result<Option<&'static encoding_rs::Encoding>, Wrong> {
        let right = "use a WHATWG encoding label, such as utf-8, windows-1250, shift_jis or gb18030; of a text in another one name \
                     columns by number, such as --op 2, or save it as UTF-8";
        understood("encoding", &self.encoding, right, |label| {
            encoding_rs::Encoding::for_label_no_replacement(label.as_bytes())
        })
    }

    fn decimal(&self) -> Result<Option<Decimal>, Wrong> {
        understood("decimal", &self.decimal, "the decimal sign is . or ,", |value| match value {
            "." | "point" => Some(Decimal::Point),
            "," | "comma" => Some(Decimal::Comma),
            _ => None,
        })
    }

    fn separator(&self) -> Result<Option<u8>, Wrong> {
        let right = "it is one sign, such as ; or tab";
        understood("separator", &self.separator, right, |value| match value {
            "tab" | "\\t" | "\t" => Some(b'\t'),
            "blank" | "space" => Some(b' '),
            one if one.len() == 1 && !one.as_bytes()[0].is_ascii_alphanumeric() && one != "\"" => {
                Some(one.as_bytes()[0])
            }
            _ => None,
        })
    }

    fn unit(&self) -> Result<Option<Unit>, Wrong> {
        let right = "known are s, ms, us, ns, min, h, days, s1904, ticks, datenum and mjd";
        understood("time_unit", &self.time_unit, right, Unit::of)
    }

    fn format(&self) -> Result<Option<Format>, Wrong> {
        let text = self.time_format.as_deref().unwrap_or_default();
        let right = match text.contains('%') && lacks_month(text) {
            true => "%m is the month, and %M the minute",
            false => "say dmy, mdy or ymd, or a pattern such as dd/mm/yyyy or %d/%m/%Y %H:%M:%S",
        };
        understood("time_format", &self.time_format, right, format)
    }

    fn rules(&self) -> Result<Option<TimeZone>, Wrong> {
        understood("tz", &self.tz, "say a zone such as Europe/Berlin, UTC or +02:00", zone)
    }
}

/// An option that cannot be understood.
struct Wrong {
    /// Its name in a configuration.
    key: &'static str,
    value: String,
    /// What would be right.
    right: &'static str,
}

fn understood<T>(
    key: &'static str,
    told: &Option<String>,
    right: &'static str,
    read: impl Fn(&str) -> Option<T>,
) -> Result<Option<T>, Wrong> {
    let Some(value) = told else { return Ok(None) };
    read(value).map(Some).ok_or_else(|| Wrong { key, value: value.clone(), right })
}

/// A zone by its name or its offset.
pub fn zone(name: &str) -> Option<TimeZone> {
    if name.eq_ignore_ascii_case("utc") || name.eq_ignore_ascii_case("z") {
        return Some(TimeZone::UTC);
    }
    if let Some(rest) = name.strip_prefix(['+', '-']) {
        let (hours, minutes) = rest.split_once(':').unwrap_or((rest, "0"));
        let (hours, minutes): (i32, i32) = (hours.parse().ok()?, minutes.parse().ok()?);
        if !(0..=15).contains(&hours) || !(0..60).contains(&minutes) {
            return None;
        }
        let seconds = (hours * 3600 + minutes * 60) * if name.starts_with('-') { -1 } else { 1 };
        return Some(TimeZone::fixed(jiff::tz::Offset::from_seconds(seconds).ok()?));
    }
    TimeZone::get(name).ok()
}

/// Whether a pattern of strptime has a day of the month and no month, or the month in the place of minutes.
fn lacks_month(pattern: &str) -> bool {
    let letters = pattern.split('%').skip(1).filter_map(|part| {
        part.trim_start_matches(|c: char| c.is_ascii_digit() || ".-_0^:".contains(c)).chars().next()
    });
    let letters: Vec<char> = letters.collect();
    let has = |of: &str| letters.iter().any(|letter| of.contains(*letter));
    has("de") && !has("mbBhDFcx") || pattern.contains("%H:%m")
}

/// An order, a pattern with `%`, or the order of the letters in a pattern such as `dd.mm.yyyy hh:mm`.
fn format(text: &str) -> Option<Format> {
    if text.contains('%') {
        return (!lacks_month(text)).then(|| Format::Pattern(text.to_string()));
    }
    let small = text.to_lowercase();
    let date = small.split([' ', 't']).find(|part| part.contains('y'))?;
    let mut places = ['d', 'm', 'y'].map(|letter| date.find(letter).map(|at| (at, letter)));
    places.sort_unstable();
    let letters: Option<String> = places.iter().map(|place| place.map(|(_, letter)| letter)).collect();
    Some(Format::Order(match letters?.as_str() {
        "dmy" => Order::Dmy,
        "mdy" => Order::Mdy,
        "ymd" => Order::Ymd,
        _ => return None,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_are_understood_or_named() {
        let order = |text: &str| match format(text) {
            Some(Format::Order(order)) => Some(order),
            _ => None,
        };
        assert_eq!(order("dmy"), Some(Order::Dmy));
        assert_eq!(order("MM/DD/YYYY hh:mm:ss"), Some(Order::Mdy));
        assert_eq!(order("yyyy-mm-dd"), Some(Order::Ymd));
        assert_eq!(order("dd.mm.yyyy HH:MM"), Some(Order::Dmy));
        assert_eq!(order("soon"), None);
        for (pattern, is_right) in
            [("%d/%M/%Y", false), ("%d/%M/%Y %H:%m", false), ("%Y-%m-%d %H:%M", true), ("%j %Y", true)]
        {
            assert_eq!(format(pattern).is_some(), is_right, "{pattern}");
        }
        for (name, options) in [
            ("--encoding", Options { encoding: Some("cp1".into()), ..Options::default() }),
            ("--decimal", Options { decimal: Some(";".into()), ..Options::default() }),
            ("--tz", Options { tz: Some("Mars/Base".into()), ..Options::default() }),
            ("--time-unit", Options { time_unit: Some("weeks".into()), ..Options::default() }),
            ("--time-format", Options { time_format: Some("soon".into()), ..Options::default() }),
            ("--separator", Options { separator: Some("ab".into()), ..Options::default() }),
        ] {
            let said = options.told().err().map(|error| error.to_string()).unwrap_or_default();
            assert!(said.starts_with(name), "{name}: {said}");
        }
        let berlin = Options { tz: Some("Europe/Berlin".into()), ..Options::default() };
        assert!(berlin.told().is_ok_and(|told| told.zone.rules.is_some()), "the zones are in the program");
    }
}
