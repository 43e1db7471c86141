//! The options of every command that reads a table, and the reading.

use super::Failure;
use std::fs;
use std::path::Path;
use stictiond::app::span_contradiction;
use stictiond::signal::{Record, Scale};
use stictiond::table::{self, Options, Source, Table, TableError};

/// What a table does not say, or leaves in doubt.
#[derive(clap::Args, Clone, Debug, Default)]
#[command(next_help_heading = "The table")]
pub struct TableArgs {
    /// Column of times, by name or by number from 1
    #[arg(long, value_name = "NAME")]
    time: Option<String>,
    /// Column or tag of the controller's output
    #[arg(long, value_name = "NAME")]
    op: Option<String>,
    /// Column or tag of the measured value
    #[arg(long, value_name = "NAME")]
    pv: Option<String>,
    /// Column or tag of the set point
    #[arg(long, value_name = "NAME")]
    sp: Option<String>,
    /// Column or tag of the valve's measured position
    #[arg(long, value_name = "NAME")]
    mv: Option<String>,
    /// Column or tag of the controller's mode; none where there is none
    #[arg(long, value_name = "NAME")]
    mode: Option<String>,
    /// Column of tags, where each row is one sample of one tag
    #[arg(long, value_name = "NAME")]
    tag: Option<String>,
    /// Column of values, where each row is one sample of one tag
    #[arg(long, value_name = "NAME")]
    value: Option<String>,
    /// How times are written: dmy, mdy, ymd, dd/mm/yyyy hh:mm:ss, or as strptime has it: %d/%m/%Y %H:%M:%S
    #[arg(long, value_name = "FORMAT")]
    time_format: Option<String>,
    /// Time zone of times without an offset: Europe/Berlin, +02:00 [default: UTC]
    #[arg(long, value_name = "ZONE", allow_hyphen_values = true)]
    tz: Option<String>,
    /// What times as numbers count: s, ms, us, ns, min, h, days of a spreadsheet, s1904 (LabVIEW), ticks (.NET), datenum (MATLAB) or mjd (modified Julian days)
    #[arg(long, value_name = "UNIT")]
    time_unit: Option<String>,
    /// How text is encoded: utf-8, windows-1250, shift_jis, gb18030 [default: guessed]
    #[arg(long, value_name = "LABEL")]
    encoding: Option<String>,
    /// The decimal sign: . or ,
    #[arg(long, value_name = "SIGN")]
    decimal: Option<String>,
    /// What divides cells: , ; | or tab
    #[arg(long, value_name = "SIGN")]
    separator: Option<String>,
    /// Values of the mode that are automatic, divided by commas; every other one is not
    #[arg(long, value_name = "VALUES")]
    auto_values: Option<String>,
    /// Values of quality columns that are good, divided by commas, blank for an empty cell; every other one is not
    #[arg(long, value_name = "VALUES")]
    good_values: Option<String>,
    /// Sheet of a workbook
    #[arg(long, value_name = "NAME")]
    sheet: Option<String>,
}

impl TableArgs {
    /// As the reader takes them; `of_loop` is the loop of a table with several.
    pub fn options(&self, of_loop: Option<&str>) -> Options {
        let own = self.clone();
        Options {
            time: own.time,
            op: own.op,
            pv: own.pv,
            sp: own.sp,
            mv: own.mv,
            mode: own.mode,
            tag: own.tag,
            value: own.value,
            encoding: own.encoding,
            time_format: own.time_format,
            tz: own.tz,
            time_unit: own.time_unit,
            decimal: own.decimal,
            separator: own.separator,
            auto_values: own.auto_values,
            good_values: own.good_values,
            sheet: own.sheet,
            of_loop: of_loop.map(str::to_string),
            several: None,
            of_all: Vec::new(),
        }
    }

    /// Reads one loop's record.
    pub fn read(&self, path: &Path, of_loop: Option<&str>) -> Result<Table, Failure> {
        read(path, &self.options(of_loop))
    }
}

/// Refuses what can be read only once: of a pipe the second reading would have nothing, or wait for ever.
pub fn readable_twice(path: &Path) -> Result<(), Failure> {
    if fs::metadata(path).is_ok_and(|about| !about.is_file() && !about.is_dir()) {
        let why = "is a pipe or a device, and a table is read twice: save it to a file, such as a .csv.gz";
        return Err(Failure::in_file(path, why));
    }
    Ok(())
}

/// Reads one loop's record.
pub fn read(path: &Path, options: &Options) -> Result<Table, Failure> {
    readable_twice(path)?;
    table::read(Source::File(path), options).map_err(|error| failure(path, &error))
}

/// Finds the span of OP for a record, from what was given, its limits, its unit and its values.
pub fn scale(
    path: &Path,
    record: &mut Record,
    given: Option<f64>,
    unit: Option<&str>,
) -> Result<(), Failure> {
    let scale = Scale { given, limits: record.op_limits, unit };
    if let Some(why) = span_contradiction(&scale, &record.op) {
        let why = why.replace("op_span = ", "--op-span ").replace("op_limits = ", "--op-limits ");
        return Err(Failure::in_file(path, why.replace("of op_limits,", "of --op-limits,")));
    }
    record.op_span = None;
    record.find_span(given, unit);
    Ok(())
}

/// The same for one of many records: no span can be given for it alone, so its header has to be put right.
pub fn scale_one_of_many(path: &Path, record: &mut Record, unit: Option<&str>) -> Result<(), Failure> {
    scale_or(path, record, (None, unit), "put OP's unit in the file's header right")
}

/// The same, with what was given and the unit, and what to do where these contradict the record.
pub fn scale_or(
    path: &Path,
    record: &mut Record,
    (given, unit): (Option<f64>, Option<&str>),
    remedy: &str,
) -> Result<(), Failure> {
    scale(path, record, given, unit).map_err(|failed| match failed {
        Failure::BadInput(why) => {
            let what = why.split("say what is right").next().unwrap_or(&why);
            let what = what.trim_end_matches([' ', ':', ';']);
            Failure::BadInput(format!("{what}; {remedy}"))
        }
        other => other,
    })
}

/// A table that is refused is bad input.
pub fn failure(path: &Path, error: &TableError) -> Failure {
    Failure::in_file(path, error)
}
