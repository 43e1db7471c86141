//! One loop as a report: the verdict, the picture behind it, and a form for the fitter.

use super::super::dto::alarms::AlarmChangeItem;
use super::super::dto::evidence::{EvidenceWindow, LoopEvidence};
use super::super::dto::loops::{LoopDiagnosis, LoopItem, RunItem};
use super::super::dto::params::AlarmKind;
use super::super::dto::parse_time;
use super::super::dto::plantwide::LoopHealth;
use super::super::dto::report::ReportVerdict;
use super::super::words::{percent, short};
use super::of_plant::{friction_words, verdict_words};
use super::{document, when};
use crate::plot::{Panel, Plot, Series, draw, escape, thin};
use crate::results::f_unit;
use crate::results::words::swings_with;
use std::fmt::Write;

/// Points of a curve over time.
const POINTS: usize = 700;
/// Stretch of the window that is shown over time (samples): enough swings to see their shape.
const SHOWN: usize = 300;

/// What a report is made of.
pub struct Subject<'a> {
    /// The loop.
    pub item: &'a LoopItem,
    /// Its diagnosis, where there is one.
    pub diagnosis: Option<&'a LoopDiagnosis>,
    /// The picture behind it.
    pub evidence: Option<&'a LoopEvidence>,
    /// Its diagnoses, oldest first.
    pub runs: &'a [RunItem],
    /// Changes of its alarms of every kind, newest first.
    pub alarms: &'a [AlarmChangeItem],
    /// Its indicators; without a look there are none.
    pub health: &'a LoopHealth,
    /// When.
    pub now: Option<&'a str>,
}

/// The report of one loop.
pub fn of_loop(subject: &Subject<'_>) -> String {
    let item = subject.item;
    let mut body = format!(
        "<h1>{}</h1><p>{}</p><p class=\"faint\">stictiond {}, {}</p>",
        escape(&item.id),
        escape(&[item.description.as_str(), item.group.as_str()].join(" · ")),
        env!("CARGO_PKG_VERSION"),
        when(subject.now)
    );
    let said = subject.evidence.map_or("Not diagnosed yet.", |evidence| evidence.words.as_str());
    let look = if item.severity >= 3 { " look" } else { "" };
    let _ = write!(body, "<div class=\"verdict{look}\"><strong>{}</strong></div>", escape(said));
    facts(&mut body, subject);
    if let Some(evidence) = subject.evidence {
        effects(&mut body, evidence);
        plots(&mut body, subject, evidence);
    }
    health(&mut body, subject);
    history(&mut body, subject.alarms);
    work_order(&mut body);
    document(&format!("{}: valve report", item.id), &body)
}

/// How the loop does its work, and with whom it swings.
fn health(out: &mut String, subject: &Subject<'_>) {
    const OVER: [&str; 4] = ["hour", "shift", "day", "week"];
    if let Some(source) = &subject.item.swings_with {
        let _ = write!(out, "<p>{}</p>", escape(&swings_with(source)));
    }
    let found = subject.health;
    if found.looks.is_empty() {
        return;
    }
    *out += "<h2>Health</h2><table><thead><tr><th>Indicator</th>";
    OVER.iter().for_each(|over| {
        let _ = write!(out, "<th class=\"number\">{over}</th>");
    });
    *out += "<th></th></tr></thead><tbody>";
    for (at, named) in found.names.iter().enumerate() {
        let _ = write!(out, "<tr><td>{}</td>", named.name.replace('_', " "));
        for over in OVER {
            let value = found.over.get(over).and_then(|values| values[at]);
            let _ = write!(out, "<td class=\"number\">{}</td>", value.map_or_else(|| "–".into(), short));
        }
        let unit = if named.unit == "-" { String::new() } else { format!(", {}", named.unit) };
        let _ = write!(out, "<td class=\"faint\">{}{unit}</td></tr>", named.meaning);
    }
    *out += "</tbody></table>";
}

fn facts(out: &mut String, subject: &Subject<'_>) {
    let item = subject.item;
    let mut facts = vec![
        ("verdict", verdict_words(item)),
        ("f, 95 % interval", friction_words(item)),
        ("evidence", item.delta_aic.map_or_else(|| "–".into(), short)),
        ("alarm", item.alarm.words()),
        ("diagnosed", when(item.time.as_deref())),
    ];
    if let Some(found) = subject.diagnosis {
        let used = &found.report.window;
        facts.push(("window from", when(found.window_start.as_deref())));
        facts.push(("window to", when(found.window_end.as_deref())));
        let period = used.ts_s.map_or_else(|| "–".into(), short);
        facts.push(("samples", format!("{}, {period} s apart, {}", used.n, used.quality.as_str())));
        if let Some(traced) = found.report.traced_elsewhere() {
            facts.push(("effects looked for from", when(found.traced_start.as_deref())));
            facts.push(("effects looked for to", when(found.traced_end.as_deref())));
            facts.push(("samples of that stretch", traced.n.to_string()));
        }
        // Friction may be likely and its f still be too small to matter: beside that it would read as a contradiction.
        let told = |posterior: &f64| match found.report.verdict {
            ReportVerdict::Stiction => true,
            ReportVerdict::NoStiction => *posterior <= 0.5,
            ReportVerdict::NotIdentifiable => false,
        };
        if let Some(posterior) = found.report.posterior.filter(told) {
            facts.push(("probability of friction", percent(posterior)));
        }
        if let Some(rival) = &found.report.rival {
            facts.push(("best other explanation of the declared model", rival.clone()));
        }
    }
    out.push_str("<dl>");
    for (name, value) in facts {
        let _ = write!(out, "<div><dt>{name}</dt><dd>{}</dd></div>", escape(&value));
    }
    out.push_str("</dl>");
}

fn effects(out: &mut String, evidence: &LoopEvidence) {
    if evidence.effects.is_empty() && evidence.notes.is_empty() {
        return;
    }
    out.push_str("<h2>What else the record shows</h2><ul>");
    for effect in &evidence.effects {
        let _ = write!(
            out,
            "<li><strong>{}</strong>. {} {} <span class=\"faint\">{}</span></li>",
            escape(&effect.title),
            escape(&effect.meaning),
            escape(&effect.advice),
            escape(&effect.detail)
        );
    }
    out.push_str("</ul>");
    for note in &evidence.notes {
        let _ = write!(out, "<p>{}</p>", escape(note));
    }
}

fn plots(out: &mut String, subject: &Subject<'_>, evidence: &LoopEvidence) {
    let figure = |out: &mut String, plot: &Plot| {
        let _ =
            write!(out, "<figure>{}<figcaption>{}</figcaption></figure>", draw(plot), escape(&plot.title));
    };
    out.push_str("<h2>The picture behind it</h2>");
    if let Some(window) = &evidence.window {
        figure(out, &trend(window));
        out.push_str("<div class=\"pair\">");
        figure(out, &over_op(window, evidence));
        if let Some(plot) = subject.diagnosis.and_then(curve) {
            figure(out, &plot);
        }
        out.push_str("</div>");
    }
    if let Some(plot) = over_time(subject.now, subject.runs, subject.alarms) {
        figure(out, &plot);
    }
}

fn series(name: &str, class: &'static str, points: Vec<(f64, f64)>) -> Series {
    Series { name: name.into(), class, points: thin(&points, POINTS) }
}

/// The last stretch of the window over time (min).
fn trend(window: &EvidenceWindow) -> Plot {
    let ts = window.ts_s.unwrap_or(1.0) / 60.0;
    let from = window.op.len().saturating_sub(SHOWN);
    let over_time = |column: &[Option<f64>]| -> Vec<(f64, f64)> {
        let shown = column.iter().enumerate().skip(from);
        shown.filter_map(|(k, value)| Some(((k - from) as f64 * ts, (*value)?))).collect()
    };
    let mut upper = vec![series("PV", "pv", over_time(&window.pv))];
    upper.extend(window.sp.as_ref().map(|sp| series("SP", "sp", over_time(sp))));
    let mut lower = vec![series("OP", "op", over_time(&window.op))];
    lower.extend(window.stem.as_ref().map(|stem| series("fitted stem", "other", over_time(stem))));
    Plot {
        title: "The last swings of the window that was diagnosed; the fitted stem stands still where the valve sticks."
            .into(),
        x: "time (min)",
        panels: vec![
            Panel { y: "PV, SP", log: false, series: upper },
            Panel { y: "OP, stem", log: false, series: lower },
        ],
        marks: vec![],
    }
}

/// PV over OP with the dead band plus stick band.
fn over_op(window: &EvidenceWindow, evidence: &LoopEvidence) -> Plot {
    let points = window.op.iter().zip(&window.pv).filter_map(|(op, pv)| Some(((*op)?, (*pv)?)));
    let measured = Series { name: "measured".into(), class: "pv", points: points.collect() };
    let mut all = Vec::new();
    let mut title = "PV over OP.".to_string();
    if let Some(band) = &evidence.band {
        let corner = |[op, pv]: &[Option<f64>; 2]| Some(((*op)?, (*pv)?));
        let mut corners: Vec<(f64, f64)> = band.corners.iter().filter_map(corner).collect();
        corners.extend(corners.first().copied());
        all.push(Series { name: "dead band plus stick band (2f)".into(), class: "mark", points: corners });
        let wide = band.f_op.map_or_else(String::new, |f| format!(", {} wide", short(2.0 * f)));
        title = format!("PV over OP, with the dead band plus stick band (2f){wide}.");
    }
    all.push(measured);
    Plot { title, x: "OP", panels: vec![Panel { y: "PV", log: false, series: all }], marks: vec![] }
}

/// AIC over f.
fn curve(found: &LoopDiagnosis) -> Option<Plot> {
    let curve = found.report.aic_curve.as_ref()?;
    let points = curve.f.iter().zip(&curve.aic).filter_map(|(f, aic)| Some(((*f)?, (*aic)?)));
    let points: Vec<(f64, f64)> = points.collect();
    if points.is_empty() {
        return None;
    }
    let mut marks = Vec::new();
    marks.extend(found.report.f.map(|f| (f, "f")));
    marks.extend(found.report.f_ci95.into_iter().flatten().map(|limit| (limit, "")));
    let outer = found.report.f_ci95.map_or("", |_| " The outer marks are the 95 % interval of f.");
    Some(Plot {
        title: format!("AIC over f: the lower the AIC, the better the model explains PV.{outer}"),
        x: axis(&found.report.f_unit),
        panels: vec![Panel { y: "AIC above the best", log: false, series: vec![series("", "op", points)] }],
        marks,
    })
}

/// The axis of f in this unit.
fn axis(unit: &str) -> &'static str {
    if unit == f_unit(true) { "f (% OP)" } else { "f (OP units)" }
}

/// f over the diagnoses that are remembered (h before now), with the alarms that it raised. A share of the span and OP's own unit do
/// not fit on one axis: those in another unit than the latest, of before the span was known, are not drawn.
fn over_time(now: Option<&str>, runs: &[RunItem], alarms: &[AlarmChangeItem]) -> Option<Plot> {
    let now = now.and_then(parse_time)?;
    let before = |time: &Option<String>| Some((time.as_deref().and_then(parse_time)? - now) / 3600.0);
    let unit = runs.iter().rev().find(|run| run.f.is_some())?.f_unit.as_str();
    let is_other = |run: &&RunItem| run.f.is_some() && run.f_unit != unit;
    let others = match runs.iter().filter(is_other).count() {
        0 => String::new(),
        1 => " One in another unit is not drawn.".to_string(),
        many => format!(" {many} in another unit are not drawn."),
    };
    let of = |value: &dyn Fn(&RunItem) -> Option<f64>| -> Vec<(f64, f64)> {
        let told = runs.iter().filter(|run| !is_other(run));
        told.filter_map(|run| Some((before(&run.time)?, value(run)?))).collect()
    };
    let f = of(&|run| run.f);
    if f.len() < 2 {
        return None;
    }
    // An alarm may be remembered for longer than the diagnoses: before the first there is no axis.
    let (first, last) =
        f.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), (t, _)| (a.min(*t), b.max(*t)));
    let raised =
        alarms.iter().filter(|change| change.kind == AlarmKind::Stiction && change.cause == "raised");
    let raised = raised.filter_map(|change| before(&change.time)).filter(|t| (first..=last).contains(t));
    let limits = |side: usize| of(&move |run| run.f_ci95.map(|limits| limits[side]));
    let bounds = [series("95 % interval", "sp", limits(0)), series("", "sp", limits(1))];
    Some(Plot {
        title: format!("f over the diagnoses that are remembered.{others}"),
        x: "time before this report (h)",
        panels: vec![Panel {
            y: axis(unit),
            log: false,
            series: std::iter::once(series("f", "op", f)).chain(bounds).collect(),
        }],
        marks: raised.map(|t| (t, "alarm")).collect(),
    })
}

fn history(out: &mut String, alarms: &[AlarmChangeItem]) {
    if alarms.is_empty() {
        return;
    }
    out.push_str("<h2>Alarms</h2><table><thead><tr><th>Time</th><th>Kind</th><th>What</th><th>Who</th><th>Remark</th></tr></thead><tbody>");
    for change in alarms.iter().take(20) {
        let _ = write!(
            out,
            "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            when(change.time.as_deref()),
            change.kind.words(),
            change.cause.replace('_', " "),
            escape(change.by.as_deref().unwrap_or_default()),
            escape(change.comment.as_deref().unwrap_or_default())
        );
    }
    out.push_str("</tbody></table>");
}

/// To be filled in by hand.
fn work_order(out: &mut String) {
    out.push_str("<h2>Work order</h2><table class=\"work\"><tbody>");
    for line in [
        "Order number, date",
        "Packing, gland, linkage",
        "Actuator, positioner, air supply",
        "Stroke test: band found (% OP)",
        "What was done",
        "Name, signature",
    ] {
        let _ = write!(out, "<tr><th scope=\"row\">{line}</th><td></td></tr>");
    }
    out.push_str("</tbody></table>");
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::super::dto::params::{AlarmPriority, AlarmState};
    use super::*;
    use crate::results::{Summary, Trigger};

    fn raised(kind: AlarmKind) -> AlarmChangeItem {
        AlarmChangeItem {
            id: "FIC101".into(),
            r#loop: Some("FIC101".into()),
            kind,
            priority: AlarmPriority::High,
            time: Some("2026-01-01T01:00:00Z".into()),
            from: AlarmState::Normal,
            to: AlarmState::Unacknowledged,
            cause: "raised".into(),
            detail: String::new(),
            grouped: false,
            by: None,
            comment: None,
        }
    }

    /// A run that found a valve that sticks.
    pub(in crate::serve::report) fn sticks(time: f64, f_in_percent: bool) -> Summary {
        Summary {
            time,
            took_s: 0.1,
            trigger: Trigger::Periodic,
            outcome: "stiction".into(),
            reason_code: None,
            reason: String::new(),
            f_in_percent,
            f: Some(2.0),
            f_ci95: Some([1.9, 2.1]),
            delta_aic: Some(100.0),
            compensated: None,
        }
    }

    fn run(time: f64, f_in_percent: bool) -> RunItem {
        RunItem::from(&sticks(time, f_in_percent))
    }

    #[test]
    fn an_alarm_of_another_kind_is_told_as_such_and_is_no_mark_over_f() {
        let alarms = [raised(AlarmKind::TagBad), raised(AlarmKind::Stiction)];
        // 2026-01-01T00:00:00Z and two hours later.
        let runs = [1_767_225_600.0, 1_767_232_800.0].map(|time| run(time, true));
        let plot = over_time(Some("2026-01-01T02:00:00Z"), &runs, &alarms).expect("two diagnoses");
        assert_eq!(plot.marks, [(-1.0, "alarm")]);
        let mut table = String::new();
        history(&mut table, &alarms);
        let cells = ["<td>a tag is bad</td>", "<td>the valve sticks</td>"];
        assert!(cells.iter().all(|cell| table.contains(cell)), "{table}");
    }

    #[test]
    fn what_does_not_fit_on_the_axes_is_not_drawn() {
        // 2026-01-01T01:30:00Z, half an hour after the alarm, and later.
        let at = |minutes: f64| 1_767_231_000.0 + 60.0 * minutes;
        let drawn = |runs: &[RunItem]| {
            over_time(Some("2026-01-01T04:00:00Z"), runs, &[raised(AlarmKind::Stiction)])
                .expect("two of one unit")
        };
        // OP's span is known since the third.
        let both = [run(at(0.0), false), run(at(10.0), false), run(at(20.0), true), run(at(30.0), true)];
        let plot = drawn(&both);
        assert_eq!((plot.panels[0].y, plot.panels[0].series[0].points.len()), ("f (% OP)", 2));
        assert!(
            plot.title.ends_with(" 2 in another unit are not drawn.") && plot.marks.is_empty(),
            "{plot:?}"
        );
        let plot = drawn(&both[..2]);
        assert_eq!((plot.panels[0].y, plot.panels[0].series[0].points.len()), ("f (OP units)", 2));
        assert!(plot.title.ends_with("that are remembered."), "{}", plot.title);
    }
}
