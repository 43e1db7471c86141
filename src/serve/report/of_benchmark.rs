//! A benchmark as one page.

use super::document;
use crate::plot::escape;
use crate::serve::dto::benchmark::{BenchmarkJudge, BenchmarkRecord, BenchmarkReport, BenchmarkShare};
use crate::serve::dto::report::ReportSays;
use std::fmt::Write;

/// The page.
pub fn of_benchmark(found: &BenchmarkReport) -> String {
    let sticky = found.records.iter().filter(|record| record.sticks).count();
    let mut body = format!(
        "<h1>Benchmark: {}</h1><p class=\"faint\">{} records, {sticky} with a valve that sticks. An interval is Wilson's of 95 %.</p>\
         <h2>How often each is right</h2><table><thead><tr><th>Method</th><th class=\"number\">found</th><th class=\"number\">missed</th>\
         <th class=\"number\">cannot tell</th><th class=\"number\">cleared</th><th class=\"number\">false alarms</th><th class=\"number\">cannot tell</th>\
         <th class=\"number\">right where told</th><th class=\"number\">ms, median (longest)</th></tr></thead><tbody>",
        escape(&found.folder),
        found.records.len()
    );
    for (at, judge) in found.judges.iter().enumerate() {
        body += &row(at + 1, judge);
    }
    body += "</tbody></table><h2>Record by record</h2><p class=\"faint\">The methods by their numbers above: ✓ right, ✗ wrong, · cannot tell.</p><table><thead><tr><th>Loop</th><th>Label</th>";
    for (at, judge) in found.judges.iter().enumerate() {
        // Writing into a String cannot fail.
        let _ = write!(body, "<th title=\"{}\">{}</th>", escape(&judge.title), at + 1);
    }
    body += "<th>Doubtful</th></tr></thead><tbody>";
    for record in &found.records {
        body += &line(record);
    }
    body += "</tbody></table>";
    document(&format!("Benchmark: {}", found.folder), &body)
}

/// A share as text: `4 of 5 (38–96 %)`.
pub fn share(own: &BenchmarkShare) -> String {
    let per = |share: f64| (100.0 * share).round();
    match own.ci95 {
        Some([low, high]) => format!("{} of {} ({}–{} %)", own.n, own.of, per(low), per(high)),
        None => "–".into(),
    }
}

/// A record's label and what somebody says of it, as a mark.
pub fn mark(sticks: bool, says: ReportSays) -> &'static str {
    match (says, sticks) {
        (ReportSays::CannotTell, _) => "·",
        (ReportSays::Sticks, true) | (ReportSays::Sound, false) => "✓",
        _ => "✗",
    }
}

fn row(number: usize, judge: &BenchmarkJudge) -> String {
    let ms = |value: Option<f64>| value.map_or("–".into(), |ms| format!("{ms:.1}"));
    let cells = [
        share(&judge.found),
        judge.missed.to_string(),
        judge.cannot_tell_sticky.to_string(),
        judge.cleared.to_string(),
        share(&judge.false_alarms),
        judge.cannot_tell_sound.to_string(),
        share(&judge.right),
        format!("{} ({})", ms(judge.ms_median), ms(judge.ms_longest)),
    ];
    let cells: String = cells.iter().map(|cell| format!("<td class=\"number\">{cell}</td>")).collect();
    format!("<tr><td>{number} {}</td>{cells}</tr>", escape(&judge.title))
}

fn line(record: &BenchmarkRecord) -> String {
    let cell = |says: &ReportSays| match mark(record.sticks, *says) {
        "✗" => "<td class=\"look\">✗</td>".to_string(),
        mark => format!("<td>{mark}</td>"),
    };
    let cells: String = record.says.iter().map(cell).collect();
    format!(
        "<tr><td>{}</td><td>{}</td>{cells}<td>{}</td></tr>",
        escape(&record.r#loop),
        if record.sticks { "sticks" } else { "sound" },
        if record.doubtful { "doubtful" } else { "" }
    )
}
