//! One record, dressed as other programs write it.

use std::fmt::Write;
use stictiond::signal::Record;

/// 2026-06-01 06:00:00 UTC.
pub const BEGIN: i64 = 1_780_293_600;

/// How times are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Date {
    Seconds,
    Rfc3339,
    Iso,
    Slashed,
    European,
    Named,
    AmPm,
    Offset,
    TwoColumns,
    Compact,
    EpochS,
    EpochMs,
    EpochUs,
    EpochNs,
    Serial,
    UsProved,
}

impl Date {
    pub const ALL: [Date; 16] = [
        Date::Seconds,
        Date::Rfc3339,
        Date::Iso,
        Date::Slashed,
        Date::European,
        Date::Named,
        Date::AmPm,
        Date::Offset,
        Date::TwoColumns,
        Date::Compact,
        Date::EpochS,
        Date::EpochMs,
        Date::EpochUs,
        Date::EpochNs,
        Date::Serial,
        Date::UsProved,
    ];

    /// Whether it has seconds only.
    pub fn is_whole(self) -> bool {
        matches!(
            self,
            Date::Slashed | Date::European | Date::Named | Date::AmPm | Date::Compact | Date::UsProved
        )
    }

    /// The cell for a time since the begin (ms), and the moment that it means (ms since 1970, or since the begin).
    pub fn cell(self, ms: i64, decimal: char) -> (String, f64) {
        // Half a day later there is a midnight, which decides between day and month.
        let begin = if self == Date::UsProved { BEGIN + 63_000 } else { BEGIN };
        let ms = if self.is_whole() { (ms + 500) / 1000 * 1000 } else { ms };
        let all = begin * 1000 + ms;
        let (day, of_day) = (all.div_euclid(86_400_000), all.rem_euclid(86_400_000));
        // The record ends on the day after at the latest.
        let d = 1 + (day - BEGIN.div_euclid(86_400));
        let (h, m, s, f) = (of_day / 3_600_000, of_day / 60_000 % 60, of_day / 1000 % 60, of_day % 1000);
        let since_1970 = (all / 1000) as f64 + (all % 1000) as f64 * 1e-3;
        let text = match self {
            Date::Seconds => {
                return (format!("{}{decimal}{:03}", ms / 1000, ms % 1000), ms as f64 / 1000.0);
            }
            Date::Rfc3339 => format!("2026-06-{d:02}T{h:02}:{m:02}:{s:02}.{f:03}Z"),
            Date::Iso => format!("2026-06-{d:02} {h:02}:{m:02}:{s:02},{f:03}"),
            Date::Slashed => format!("2026/06/{d:02} {h:02}:{m:02}:{s:02}"),
            Date::European => format!("{d:02}.06.2026 {h:02}:{m:02}:{s:02}"),
            Date::Named => format!("{d:02}-Jun-26 {h:02}:{m:02}:{s:02}"),
            Date::AmPm => {
                let half = if h < 12 { "AM" } else { "PM" };
                format!("2026-06-{d:02} {}:{m:02}:{s:02} {half}", (h + 11) % 12 + 1)
            }
            Date::Offset => format!("2026-06-{d:02} {:02}:{m:02}:{s:02}.{f:03} +02:00", h + 2),
            Date::TwoColumns => format!("{d:02}.06.2026\u{1f}{h:02}:{m:02}:{s:02}.{f:03}"),
            Date::Compact => format!("202606{d:02}{h:02}{m:02}{s:02}"),
            Date::EpochS => {
                return (format!("{}{decimal}{:03}", all / 1000, all % 1000), all as f64 / 1000.0);
            }
            Date::EpochMs => return (all.to_string(), all as f64 / 1000.0),
            Date::EpochUs => return (format!("{all}000"), all as f64 / 1000.0),
            Date::EpochNs => return (format!("{all}000000"), all as f64 / 1000.0),
            Date::Serial => {
                let days = all as f64 / 86_400_000.0 + 25_569.0;
                format!("{days:.9}").replace('.', &decimal.to_string())
            }
            Date::UsProved => format!("06/{d:02}/2026 {h:02}:{m:02}:{s:02}"),
        };
        (text, since_1970)
    }
}

/// How columns are named.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Names {
    Plain,
    Tags,
    DeltaV,
    Units,
    Brackets,
    Vendor,
    German,
    RowOfUnits,
}

impl Names {
    pub const ALL: [Names; 8] = [
        Names::Plain,
        Names::Tags,
        Names::DeltaV,
        Names::Units,
        Names::Brackets,
        Names::Vendor,
        Names::German,
        Names::RowOfUnits,
    ];

    /// Time, OP, PV and SP.
    fn header(self) -> [&'static str; 4] {
        match self {
            Names::Plain | Names::RowOfUnits => ["t", "op", "pv", "sp"],
            Names::Tags => ["Time", "FIC101.OP", "FIC101.PV", "FIC101.SP"],
            Names::DeltaV => ["Timestamp", "FIC101/PID1/OUT.CV", "FIC101/PID1/PV.CV", "FIC101/PID1/SP.CV"],
            Names::Units => ["time", "OP %", "PV degC", "SP degC"],
            Names::Brackets => ["Time", "OP [%]", "PV [m3/h]", "SP [m3/h]"],
            Names::Vendor => ["time", "MV", "PV", "SV"],
            Names::German => ["Zeit", "Stellgröße", "Istwert", "Sollwert"],
        }
    }
}

/// What stands around the record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extra {
    None,
    Preamble,
    Comments,
    Trailer,
    Bom,
    Utf16,
    Latin1,
    SepLine,
    Mode,
    Quality,
    CellUnits,
    BadStamp,
}

impl Extra {
    pub const ALL: [Extra; 12] = [
        Extra::None,
        Extra::Preamble,
        Extra::Comments,
        Extra::Trailer,
        Extra::Bom,
        Extra::Utf16,
        Extra::Latin1,
        Extra::SepLine,
        Extra::Mode,
        Extra::Quality,
        Extra::CellUnits,
        Extra::BadStamp,
    ];
}

/// A form of the record.
#[derive(Clone, Copy, Debug)]
pub struct Form {
    pub separator: char,
    pub decimal: char,
    pub date: Date,
    pub names: Names,
    pub extra: Extra,
}

impl Form {
    /// As the table of the documents tells it.
    pub fn told(&self) -> String {
        let separator = if self.separator == '\t' {
            "tab".into()
        } else {
            format!("`{}`", self.separator).replace('|', "\\|")
        };
        let Form { decimal, date, names, extra, .. } = self;
        format!("{separator} | `{decimal}` | {date:?} | {names:?} | {extra:?}")
    }
}

/// What a form has beside times and values: more than one thing at once, and its columns in any order.
#[derive(Clone, Debug, Default)]
pub struct Beside {
    /// A column of the mode, manual from this row on.
    pub manual_from: Option<usize>,
    /// A column of the quality, bad in this row.
    pub bad_quality: Option<usize>,
    /// A row whose stamp cannot be read.
    pub bad_stamp: Option<usize>,
    /// An average and a count below the table.
    pub trailer: bool,
    /// A unit behind each number of OP.
    pub units: bool,
    /// Which column stands at which place: times, OP, PV, SP, and mode and quality as far as there are. Empty for this order.
    pub order: Vec<usize>,
}

impl Beside {
    /// That of a form which has one thing.
    pub fn of(extra: Extra) -> Self {
        let in_no_row = |own: Extra| (extra == own).then_some(usize::MAX);
        Self {
            manual_from: in_no_row(Extra::Mode),
            bad_quality: in_no_row(Extra::Quality),
            bad_stamp: (extra == Extra::BadStamp).then_some(700),
            trailer: extra == Extra::Trailer,
            units: extra == Extra::CellUnits,
            order: Vec::new(),
        }
    }

    /// The cells of a row, by its columns: times may take two.
    fn row(&self, times: Vec<String>, values: [String; 3], mode: &str, quality: &str) -> Vec<String> {
        let mut columns = vec![times];
        columns.extend(values.map(|value| vec![value]));
        columns.extend(self.manual_from.map(|_| vec![mode.to_string()]));
        columns.extend(self.bad_quality.map(|_| vec![quality.to_string()]));
        if self.order.is_empty() {
            return columns.concat();
        }
        self.order.iter().filter_map(|at| columns.get(*at)).flatten().cloned().collect()
    }
}

/// The bytes of a form, and the time that each row means.
pub fn dressed(record: &Record, form: &Form) -> (Vec<u8>, Vec<f64>) {
    with(record, form, &Beside::of(form.extra))
}

/// The same with other things beside it.
pub fn with(record: &Record, form: &Form, beside: &Beside) -> (Vec<u8>, Vec<f64>) {
    let Form { separator, decimal, date, names, extra } = *form;
    let mut text = before(separator, extra);
    let mut line = |cells: &[String]| {
        let quoted = |cell: &String| {
            if cell.contains(separator) { format!("\"{cell}\"") } else { cell.clone() }
        };
        text += &cells.iter().map(quoted).collect::<Vec<_>>().join(&separator.to_string());
        text.push('\n');
    };
    let is_two = date == Date::TwoColumns;
    let own = |cells: &[&str]| cells.iter().map(|cell| cell.to_string()).collect::<Vec<_>>();
    let [time, op, pv, sp] = names.header();
    let header = if is_two { own(&["Date", "Time"]) } else { own(&[time]) };
    let blank = vec![String::new(); header.len()];
    line(&beside.row(header, [op, pv, sp].map(str::to_string), "mode", "Quality"));
    if names == Names::RowOfUnits {
        line(&beside.row(blank.clone(), ["%", "m3/h", "m3/h"].map(str::to_string), "", ""));
    }
    let unit = if beside.units { " %" } else { "" };
    let mut times = Vec::new();
    let sp = record.sp.as_ref().expect("the record has a set point");
    for (row, ((op, pv), sp)) in record.op.iter().zip(&record.pv).zip(sp).enumerate() {
        let (cell, t) = date.cell((op.t * 1000.0).round() as i64, decimal);
        let mut stamp: Vec<String> = cell.split('\u{1f}').map(str::to_string).collect();
        if beside.bad_stamp == Some(row) {
            stamp[0] = "unknown".into();
        } else {
            times.push(t);
        }
        let number = |value: f64| value.to_string().replace('.', &decimal.to_string());
        let values = [number(op.value) + unit, number(pv.value), number(sp.value)];
        let mode = if beside.manual_from.is_some_and(|from| row >= from) { "MAN" } else { "AUTO" };
        let quality = if beside.bad_quality == Some(row) { "Bad" } else { "Good" };
        line(&beside.row(stamp, values, mode, quality));
    }
    if beside.trailer {
        let mut average = blank;
        average[0] = "Average".into();
        let values = [format!("50{decimal}1{unit}"), format!("50{decimal}2"), String::new()];
        line(&beside.row(average, values, "", ""));
        line(&own(&["Total samples: 1200"]));
    }
    (encoded(&text, extra), times)
}

/// What stands above the names.
fn before(separator: char, extra: Extra) -> String {
    match extra {
        Extra::SepLine => format!("sep={separator}\n"),
        Extra::Preamble => {
            let cells = ["From", "a day", "to", "the next"].join(&separator.to_string());
            format!("Trend export of unit 10\n{cells}\n")
        }
        Extra::Comments => "# exported by hand\n".into(),
        _ => String::new(),
    }
}

fn encoded(text: &str, extra: Extra) -> Vec<u8> {
    match extra {
        Extra::Bom => [b"\xef\xbb\xbf", text.as_bytes()].concat(),
        Extra::Utf16 => {
            let words = text.encode_utf16().flat_map(u16::to_le_bytes);
            [0xff, 0xfe].into_iter().chain(words).collect()
        }
        Extra::Latin1 => text.chars().map(|c| u8::try_from(c).expect("Latin-1")).collect(),
        _ => text.as_bytes().to_vec(),
    }
}

/// The table of forms, as Markdown.
pub fn table(rows: &[(Form, String)]) -> String {
    let mut out = String::from(
        "| separator | decimal | times | names | around it | read as |\n|---|---|---|---|---|---|\n",
    );
    for (form, read_as) in rows {
        // Writing into a String cannot fail.
        let _ = writeln!(out, "| {} | {} |", form.told(), read_as.replace('|', "\\|"));
    }
    out
}
