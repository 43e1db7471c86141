//! `stictiond backfill SOURCE`: what the daemon would have said over a long record, window by window.

pub(super) mod sources;

use super::diagnose::{above_zero, limits};
use super::format::Format;
use super::{Failure, output, print};
use std::fmt::Write as _;
use std::io::{self, IsTerminal, Write as _};
use std::path::PathBuf;
use stictiond::app::App;
use stictiond::backfill::{BackfillError, Marked, Past, Timeline, timeline, usual_cut};
use stictiond::plot::{Panel, Plot, Series, sheet, thin};
use stictiond::results::f_unit;
use stictiond::serve::dto::backfill::{BackfillItem, BackfillReport};
use stictiond::signal::{self, LoopId, Record, share};

/// Points of a trend in the picture.
const POINTS: usize = 2000;
const HOUR: f64 = 3600.0;
/// The verdict of a window that could not be judged.
const NOT_IDENTIFIABLE: &str = "not_identifiable";

#[derive(clap::Args)]
pub struct Args {
    /// A record (CSV of any dialect, an Excel or ODS workbook, Parquet), the folder of a store, or a configuration (.toml): then the history that the loop's OPC
    /// UA servers keep
    source: PathBuf,
    /// Which loop of a store, a configuration or a table of several
    #[arg(long = "loop", value_name = "ID")]
    of_loop: Option<String>,
    /// From this time on: RFC 3339, or seconds on the record's clock
    #[arg(long, value_parser = super::store::time)]
    from: Option<f64>,
    /// Up to this time
    #[arg(long, value_parser = super::store::time)]
    to_time: Option<f64>,
    /// Folder of a store of its own for what devices send; run again, it goes on where it was left
    #[arg(long, value_name = "FOLDER")]
    into: Option<PathBuf>,
    /// Ask devices for the latest history first
    #[arg(long)]
    newest_first: bool,
    /// Ask devices for means over so many seconds rather than for what they stored; means bend f
    #[arg(long, value_name = "SECONDS", value_parser = above_zero)]
    average: Option<f64>,
    /// Time asked of a device, and kept, at once (s)
    #[arg(long, value_name = "SECONDS", value_parser = above_zero, default_value = "3600")]
    slice: f64,
    /// Rest between two requests to a device (ms)
    #[arg(long, value_name = "MS", default_value = "100")]
    pause_ms: u64,
    /// Length of a window (s) [default: 1,500 sample periods]
    #[arg(long, value_name = "SECONDS", value_parser = above_zero)]
    window: Option<f64>,
    /// From one diagnosis to the next (s) [default: a quarter of the window]
    #[arg(long, value_name = "SECONDS", value_parser = above_zero)]
    step: Option<f64>,
    /// Span of OP in its own unit, 100 for per cent: f is then told in % of it
    #[arg(long, value_name = "SPAN", value_parser = above_zero)]
    op_span: Option<f64>,
    /// The controller's output limits (OP unit): saturation is judged against them
    #[arg(long, value_name = "LOW,HIGH", value_parser = limits, allow_hyphen_values = true)]
    op_limits: Option<(f64, f64)>,
    /// How to print the timeline [default: text on a terminal, else json]
    #[arg(long, value_enum)]
    format: Option<Format>,
    /// Draw OP, PV, f with its interval and the evidence over time, as an SVG
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
    #[command(flatten)]
    table: super::table::TableArgs,
}

/// Reads, cuts, diagnoses, prints.
pub fn run(args: &Args) -> Result<(), Failure> {
    output::may_be_made(args.plot.as_deref(), output::PICTURE)?;
    if args.from.zip(args.to_time).is_some_and(|(from, to)| from > to) {
        return Err(Failure::BadInput("--from is later than --to-time".to_string()));
    }
    let bad = |error: &BackfillError| {
        let within = match error {
            BackfillError::Empty if args.from.or(args.to_time).is_some() => {
                " in the time that --from and --to-time name"
            }
            _ => "",
        };
        Failure::in_file(&args.source, format!("{error}{within}"))
    };
    let sources::Read { mut past, name, read_as, op_unit, settings, alarms } = sources::past(args)?;
    // The span may have to be found from all values of OP, whatever window they are of.
    let mut record = Record { op: past.all("op").into_owned(), ..std::mem::take(&mut past.known) };
    record.op_limits = args.op_limits.or(record.op_limits);
    let given = args.op_span.or(record.op_span);
    super::table::scale(&args.source, &mut record, given, op_unit.as_deref())?;
    past.known = Record { op: Vec::new(), ..record };
    let marked = Marked::from(past);
    let drawn = args.plot.as_ref().map(|_| trends(&marked.past));
    let cut = usual_cut(&marked.past, args.window, args.step).ok_or_else(|| bad(&BackfillError::Empty))?;
    let judge = App::diagnosis();
    let id = LoopId::new(name.as_str());
    let bar = Bar::new();
    let progress = |done, all| {
        bar.show(done, all);
        true
    };
    let found = timeline(&id, marked, cut, &settings, &alarms, judge.as_ref(), progress)
        .map_err(|error| bad(&error))?;
    bar.end();
    let mut report = BackfillReport::new(&name, &found);
    report.read_as = read_as;
    match args.format.unwrap_or_else(Format::usual) {
        Format::Text => print(&page(&report, (alarms.k, alarms.n)))?,
        Format::Json => {
            let mut json = serde_json::to_string_pretty(&report)
                .map_err(|error| Failure::Failed(format!("cannot write the timeline: {error}")))?;
            json.push('\n');
            print(&json)?;
        }
    }
    // The report comes first: a picture that cannot be made takes nothing away from it.
    match args.plot.as_deref().zip(drawn) {
        Some((to, trends)) => output::write(to, &picture(&name, trends, &found, &report)),
        None => Ok(()),
    }
}

/// Progress on a terminal.
struct Bar {
    shown: bool,
}

impl Bar {
    fn new() -> Self {
        Self { shown: io::stderr().is_terminal() }
    }

    fn show(&self, done: usize, all: usize) {
        if self.shown {
            let filled = 40 * done / all.max(1);
            // Nobody is left to tell when stderr is closed.
            let _ = write!(io::stderr(), "\r[{:<40}] {done} of {all}", "#".repeat(filled));
        }
    }

    fn end(&self) {
        if self.shown {
            let _ = write!(io::stderr(), "\r{:70}\r", "");
        }
    }
}

/// The timeline for a person: a line a window, then what it comes to, where `k` of `n` raise the alarm.
fn page(report: &BackfillReport, (k, n): (usize, usize)) -> String {
    let begin = report.begin.unwrap_or_default();
    let since = |t: Option<f64>| t.map_or("-".into(), |t| format!("{:.1} h", (t - begin) / HOUR));
    let mut out = report.read_as.as_ref().map(|read_as| format!("read as: {read_as}\n")).unwrap_or_default();
    out += &format!(
        "loop {}: windows of {:.1} h, one every {:.1} h; drop-outs marked bad: OP {}, PV {} samples; gaps {:.1} h\n",
        report.r#loop,
        report.window_s / HOUR,
        report.step_s / HOUR,
        report.op_drop_outs,
        report.pv_drop_outs,
        report.gaps_s.unwrap_or_default() / HOUR
    );
    // Writing into a String cannot fail.
    let _ = writeln!(
        out,
        "{:>10}  {:17} {:>12}  {:17} {:>9} {:>6}  effects",
        "until",
        "verdict",
        f_with_unit(report),
        "95 %",
        "evidence",
        "good"
    );
    for item in &report.items {
        let _ = writeln!(out, "{:>10}  {}", since(item.to), line(item));
    }
    if let Some(history) = &report.history {
        let _ = writeln!(
            out,
            "{} of {} windows are not raw ({}): {}; {}",
            history.windows,
            report.items.len(),
            history.found.kind,
            history.found.evidence,
            history.found.note
        );
    }
    for alarm in &report.alarms {
        let date = alarm.from_time.as_ref().map(|date| format!(" ({date})")).unwrap_or_default();
        let _ = match alarm.to {
            Some(_) => writeln!(
                out,
                "the alarm was raised {} in{date} and cleared {} in",
                since(alarm.from),
                since(alarm.to)
            ),
            None => writeln!(out, "the alarm was raised {} in{date} and held to the end", since(alarm.from)),
        };
    }
    if report.alarms.is_empty() {
        let all = report.items.len();
        let judged = report.items.iter().filter(|item| item.verdict != NOT_IDENTIFIABLE).count();
        let _ = match (judged, n) {
            (0, _) => writeln!(out, "no alarm: none of {all} windows could be judged"),
            (_, 1) => writeln!(
                out,
                "no alarm: {judged} of {all} windows could be judged, and none of these says that the valve sticks"
            ),
            _ => writeln!(
                out,
                "no alarm: {judged} of {all} windows could be judged, and no {k} of {n} of these in a row say that the valve sticks"
            ),
        };
    }
    out
}

fn line(item: &BackfillItem) -> String {
    let number = |v: Option<f64>, digits: usize| v.map_or("-".into(), |v| format!("{v:.digits$}"));
    let interval = item.f_ci95.map_or(String::new(), |[low, high]| format!("{low:.3} … {high:.3}"));
    let good = item.good_share.map_or("-".into(), |good| share(good, 1));
    format!(
        "{:17} {:>12}  {:17} {:>9} {:>6}  {}",
        verdict_words(&item.verdict),
        number(item.f, 3),
        interval,
        number(item.delta_aic, 0),
        good,
        if item.verdict == NOT_IDENTIFIABLE { item.reason.clone() } else { item.effects.join(", ") }
    )
}

/// f with its unit, which is the same in all windows: what is known of OP's span is known of the whole record.
fn f_with_unit(report: &BackfillReport) -> &'static str {
    let in_percent = report.items.first().is_none_or(|item| item.f_unit == f_unit(true));
    if in_percent { "f (% OP)" } else { "f (OP units)" }
}

/// A verdict as `stictiond diagnose` says it.
fn verdict_words(verdict: &str) -> String {
    if verdict == NOT_IDENTIFIABLE { "cannot be told".into() } else { verdict.replace('_', " ") }
}

/// OP and PV over the time since the record began: since the first sample of PV, as the timeline has it. OP may begin before.
fn trends(past: &Past) -> [[Vec<(f64, f64)>; 2]; 2] {
    let begin = past.all("pv").first().map_or(0.0, |s| s.t);
    ["op", "pv"].map(|tag| trend(&past.all(tag), begin))
}

/// Good samples over the time since `begin` (s), and those that are not as places.
fn trend(series: &[signal::Sample], begin: f64) -> [Vec<(f64, f64)>; 2] {
    let place = |s: &signal::Sample| ((s.t - begin) / HOUR, s.value);
    let good: Vec<(f64, f64)> = series.iter().filter(|s| s.quality.is_good()).map(place).collect();
    let bad = series.iter().filter(|s| !s.quality.is_good()).map(place).collect();
    [interrupted(&good), bad]
}

/// A curve that is interrupted where nothing is known for so long that it is seen.
fn interrupted(good: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let (Some(first), Some(last)) = (good.first(), good.last()) else { return Vec::new() };
    let mut steps: Vec<f64> = good.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
    steps.sort_unstable_by(f64::total_cmp);
    let usual = steps.get(steps.len() / 2).copied().unwrap_or(0.0);
    // Of the width of the picture; so there are not many either.
    let seen = ((last.0 - first.0) / 300.0).max(4.0 * usual);
    let mut curve = Vec::new();
    for run in good.chunk_by(|a, b| b.0 - a.0 <= seen) {
        let share = run.len() as f64 / good.len() as f64;
        curve.extend(thin(run, ((POINTS / 2) as f64 * share).ceil() as usize));
        curve.extend(run.last().map(|last| (last.0, f64::NAN)));
    }
    curve
}

/// OP and PV, f with its interval, and the evidence, over time.
fn picture(
    name: &str,
    [op, pv]: [[Vec<(f64, f64)>; 2]; 2],
    found: &Timeline,
    report: &BackfillReport,
) -> String {
    let begin = found.begin;
    let hours = |t: Option<f64>| (t.unwrap_or(begin) - begin) / HOUR;
    let over = |value: &dyn Fn(&BackfillItem) -> Option<f64>| -> Vec<(f64, f64)> {
        report.items.iter().map(|item| (hours(item.to), value(item).unwrap_or(f64::NAN))).collect()
    };
    let series = |name: &str, class, points| Series { name: name.into(), class, points };
    let panel = |y, series: Vec<Series>| Panel { y, log: false, series };
    let mut marks = Vec::new();
    for alarm in &report.alarms {
        marks.push((hours(alarm.from), "alarm"));
        marks.extend(alarm.to.map(|to| (hours(Some(to)), "cleared")));
    }
    let of = |[good, bad]: [Vec<(f64, f64)>; 2], name, class| {
        vec![series(name, class, good), series("bad, not fitted", "bad", bad)]
    };
    let plot = Plot {
        title: format!(
            "{name}: f and its evidence, each at the end of a window of {:.1} h",
            report.window_s / HOUR
        ),
        x: "time since the record began (h)",
        panels: vec![
            panel("OP (unit of OP)", of(op, "OP", "op")),
            panel("PV (unit of PV)", of(pv, "PV", "pv")),
            panel(
                f_with_unit(report),
                vec![
                    series("f", "op", over(&|item| item.f)),
                    series("95 %", "sp", over(&|item| Some(item.f_ci95?[0]))),
                    series("", "sp", over(&|item| Some(item.f_ci95?[1]))),
                ],
            ),
            panel("evidence (-)", vec![series("dAIC", "pv", over(&|item| item.delta_aic))]),
        ],
        marks,
    };
    sheet(&[plot])
}

#[cfg(test)]
mod tests {
    use super::*;
    use stictiond::signal::Sample;

    #[test]
    fn an_alarm_of_one_window_is_not_told_by_windows_in_a_row() {
        let report = serde_json::json!({
            "loop": "FIC101", "window_s": 7200.0, "step_s": 3600.0, "op_drop_outs": 0, "pv_drop_outs": 0, "alarms": [],
            "items": [{"verdict": "no_stiction", "reason": "", "f_unit": "% OP", "effects": []}]
        });
        let report: BackfillReport = serde_json::from_value(report).expect("a report");
        let one = "no alarm: 1 of 1 windows could be judged, and none of these says that the valve sticks\n";
        assert!(page(&report, (1, 1)).ends_with(one), "{}", page(&report, (1, 1)));
        assert!(page(&report, (3, 4)).contains("and no 3 of 4 of these in a row say"));
    }

    #[test]
    fn f_has_its_unit_above_its_column() {
        let report = |unit: &str| -> BackfillReport {
            let item = serde_json::json!({"verdict": "stiction", "reason": "", "f": 2.5, "f_unit": unit, "effects": []});
            let report = serde_json::json!({
                "loop": "FIC101", "window_s": 7200.0, "step_s": 3600.0, "op_drop_outs": 0, "pv_drop_outs": 0, "alarms": [],
                "items": [item]
            });
            serde_json::from_value(report).expect("a report")
        };
        for (unit, above) in [("% OP", "f (% OP)"), ("OP units", "f (OP units)")] {
            let page = page(&report(unit), (3, 4));
            let ends = |of: &str| page.lines().find_map(|line| Some(line.find(of)? + of.len()));
            assert!(ends(above).is_some() && ends(above) == ends("2.500"), "{page}");
        }
    }

    #[test]
    fn op_and_pv_are_drawn_over_the_same_time() {
        // OP was recorded two hours before PV was.
        let minutes = |from: u32| -> Vec<Sample> {
            (from..240).map(|minute| Sample::good(60.0 * f64::from(minute), f64::from(minute))).collect()
        };
        let record = Record { op: minutes(0), pv: minutes(120), ..Record::default() };
        let [op, pv] = trends(&Past::from(record)).map(|[good, _]| good);
        assert_eq!((op[0], pv[0]), ((-2.0, 0.0), (0.0, 120.0)));
        // The last point only ends the curve.
        let last = |curve: &[(f64, f64)]| curve[curve.len() - 2];
        assert_eq!(last(&op), last(&pv));
        assert_eq!(last(&pv).1, 239.0);
    }
}
