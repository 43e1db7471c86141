//! The report as a page for a person: the verdict first, then what it rests on.

use std::fmt::Write;
use stictiond::results::words::{between, percent};
use stictiond::serve::dto::report::{Report, ReportCurve, ReportOpinion, ReportSays, ReportVerdict};
use stictiond::signal::{figures, is_date, moment, trimmed};

/// Columns of the plot.
const WIDTH: usize = 60;
const BARS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];

/// The page, ending in a newline.
pub fn page(report: &Report) -> String {
    let mut out = String::new();
    let verdict = match report.verdict {
        ReportVerdict::Stiction => "STICTION",
        ReportVerdict::NoStiction => "no stiction",
        ReportVerdict::NotIdentifiable => "cannot be told",
    };
    let mut line = |name: &str, text: String| {
        // Writing into a String cannot fail.
        let _ = writeln!(out, "{name:<12}{text}");
    };
    if let Some(read_as) = &report.read_as {
        line("read as:", read_as.clone());
    }
    line("loop", report.r#loop.clone());
    line("verdict", verdict.into());
    line("reason", report.reason.clone());
    let unit = &report.f_unit;
    if let Some(f) = report.f {
        let mut text = format!("{} {unit}", number(Some(f)));
        if let Some([low, high]) = report.f_ci95 {
            text += &format!("   95 %: {} … {}", number(Some(low)), number(Some(high)));
        }
        if let Some(share) = report.f_of_op_range {
            text += &format!("   {} % of OP's range", number(Some(share * 100.0)));
        }
        line("f", text);
        if report.f_unit_assumed {
            for said in of_unknown_span(report) {
                line("", said);
            }
        } else if let (Some(span), source @ ("limits" | "unit")) =
            (report.op_span, report.op_span_source.as_str())
        {
            line("", format!("OP's span is {} by its {source}", number(Some(span))));
        }
        let evidence = number(report.delta_aic);
        let rival = report.rival.as_deref().unwrap_or("a linear loop");
        line(
            "evidence",
            match report.posterior {
                Some(posterior) => {
                    format!(
                        "dAIC {evidence} over the best model without friction, probability of friction {}",
                        percent(posterior)
                    )
                }
                None => format!("dAIC {evidence} over the next best explanation, {rival}"),
            },
        );
        let d = number(report.d_srinivasan);
        line("compare", format!("Srinivasan's d {d} {unit}"));
    }
    let w = &report.window;
    if w.n > 0 {
        line(
            "window",
            format!(
                "{} samples of {} s, from {}, quality {}",
                w.n,
                number(w.ts_s),
                stretch(w.start, w.end),
                w.quality.as_str()
            ),
        );
    }
    if let Some(p) = &report.preparation {
        line(
            "",
            format!(
                "{} % missing, worst OP-PV skew {} s, {}, {} out of order, decimation {}",
                number(p.gap_share.map(|share| share * 100.0)),
                number(p.worst_skew_s),
                many(p.duplicates, "duplicate"),
                p.out_of_order,
                p.decimation
            ),
        );
    }
    if let Some(note) = report.acquisition.as_ref().and_then(|acquired| acquired.note.clone()) {
        line("acquisition", note);
    }
    if let Some(denoise) = &report.denoise {
        let done = if denoise.applied { "denoised" } else { "not denoised" };
        line("", format!("{done}, {}", noise_of_op(denoise.noise_share)));
    }
    // Where no swing is larger than the noise there are crossings, but no oscillation to speak of.
    if let Some(o) = report.oscillation.as_ref().filter(|o| o.op_amplitude != Some(0.0)) {
        line(
            "oscillation",
            format!(
                "period {} s, regularity r {}, OP amplitude {} {unit}",
                number(o.period_s),
                number(o.regularity_r),
                number(o.op_amplitude)
            ),
        );
    }
    if let Some(m) = &report.model {
        line(
            "model",
            format!(
                "ARMAX na {} nb {} nc {}, delay {}, RMSE {} [PV]",
                m.na,
                m.nb,
                m.nc,
                m.nk,
                number(m.rmse)
            ),
        );
    }
    if let Some(white) = report.residual.white_after {
        line(
            "residual",
            format!(
                "{}, one-step RMSE {}, free-run RMSE {} [PV, held out]",
                if white { "white" } else { "not white" },
                number(report.residual.one_step_rmse_after),
                number(report.residual.free_run_rmse_after)
            ),
        );
    }
    for (at, effect) in report.residual.effects.iter().enumerate() {
        let tag = effect.tag.as_ref().map_or(String::new(), |tag| format!(" ({tag})"));
        let name = if at == 0 { "effects" } else { "" };
        line(
            name,
            format!(
                "{}{tag}, {}: {}",
                effect.kind,
                effect.posterior.map_or("-".into(), percent),
                effect.explanation
            ),
        );
    }
    let named = !report.residual.effects.is_empty();
    if let Some(between) = between(&report.residual.kinds(), named) {
        line(if named { "" } else { "effects" }, between);
    }
    if named {
        let r = &report.residual;
        // Without a verdict on friction no f is told, so there is nothing to compare.
        let told = report.f.and(r.f_before);
        let f = told.map(|before| format!(", f {} -> {} {unit}", number(Some(before)), number(r.f_after)));
        line(
            "",
            format!(
                "one-step RMSE {} -> {}, free-run RMSE {} -> {}{}",
                number(r.one_step_rmse_before),
                number(r.one_step_rmse_after),
                number(r.free_run_rmse_before),
                number(r.free_run_rmse_after),
                f.unwrap_or_default()
            ),
        );
        if r.simulates_worse {
            line("", "the free run is worse with the effects than without".into());
        }
    }
    // Where nothing was traced no test has a name, and the residual is told already.
    if report.residual.unexplained && !report.residual.failed_tests.is_empty() {
        line("unexplained", report.residual.failed_tests.join(", "));
    }
    if let Some(stem) = &report.residual.stem {
        let text = format!("f {} {unit} on OP -> stem, dAIC {}", number(stem.f), number(stem.delta_aic));
        line("stem", text);
    }
    if let Some(agreement) = &report.agreement {
        line("opinions", agreement.why.clone());
        for opinion in report.opinions.iter().filter(|own| own.index.is_some()) {
            line("", one(opinion));
        }
        for (why, methods) in silent(&report.opinions) {
            line("", format!("{} cannot tell: {why}", methods.join(", ")));
        }
        if let Some(doubt) = report.doubt() {
            line("doubtful", doubt);
        }
    }
    if let Some(bars) = report.aic_curve.as_ref().and_then(sparkline) {
        line("AIC over f", bars);
        let marks = report.aic_curve.as_ref().and_then(|curve| marks(curve, report));
        // Where tracing cannot tell friction, the curve of the declared model has neither.
        let legend = if marks.is_some() { "; ▲ the estimate, ─ its interval" } else { "" };
        if let Some(marks) = marks {
            line("", marks);
        }
        line("", format!("0 … {} {unit}{legend}", number(report.f_max)));
    }
    out
}

/// So many of these.
pub fn many(count: usize, of: &str) -> String {
    format!("{count} {of}{}", if count == 1 { "" } else { "s" })
}

/// What one method says, in columns: whose, what, its index, why.
fn one(opinion: &ReportOpinion) -> String {
    let says = match opinion.says {
        ReportSays::Sticks => "sticks",
        ReportSays::Sound => "sound",
        ReportSays::CannotTell => "cannot tell",
    };
    let index = number(opinion.index);
    format!("{:<22}{says:<12}{index:>9}  {}", opinion.method, opinion.why)
}

/// The methods without an index, by why they have none.
fn silent(opinions: &[ReportOpinion]) -> Vec<(&str, Vec<&str>)> {
    let mut by: Vec<(&str, Vec<&str>)> = Vec::new();
    for own in opinions.iter().filter(|own| own.index.is_none()) {
        match by.iter_mut().find(|(why, _)| *why == own.why) {
            Some((_, methods)) => methods.push(&own.method),
            None => by.push((&own.why, vec![&own.method])),
        }
    }
    by
}

/// Four significant digits; `-` when there is no number.
fn number(value: Option<f64>) -> String {
    value.map_or_else(|| "-".into(), figures)
}

/// What is known of a unit that OP's values alone show.
fn of_unknown_span(report: &Report) -> Vec<String> {
    let unit = &report.f_unit;
    match report.op_span {
        Some(span) => {
            let span = number(Some(span));
            vec![format!("unit {unit} judged from OP's values: its span is taken for {span}")]
        }
        None => {
            let least = number(report.f_threshold);
            vec![
                "OP's values do not tell its span: say it with --op-span, 100 for per cent, 16 for mA".into(),
                format!("sticking counts from f = {least} {unit} on: what OP covered is taken for its span"),
            ]
        }
    }
}

/// How noisy OP is. `share`: its noise, judged from one sample to the next, as a share of its standard deviation (-).
fn noise_of_op(share: Option<f64>) -> String {
    match share {
        // Rounding alone.
        Some(share) if share < 1e-9 => "no noise in OP".into(),
        Some(share) if share >= 1.0 => "OP moves from sample to sample as noise does".into(),
        Some(share) => format!("OP noise {} % of its sd", number(Some(share * 100.0))),
        None => "OP noise not known".into(),
    }
}

/// From when to when: dates where the stamps count from the Unix epoch, else the seconds that the record has.
fn stretch(start: Option<f64>, end: Option<f64>) -> String {
    match start.zip(end) {
        Some((start, end)) if is_date(start) && is_date(end) => {
            format!("{} to {}", moment(start), moment(end))
        }
        _ => format!("{} to {} s", stamp(start), stamp(end)),
    }
}

/// A time to the millisecond, however many seconds since the epoch it is.
fn stamp(value: Option<f64>) -> String {
    match value {
        Some(value) if value.abs() < 1e12 => trimmed(format!("{value:.3}")),
        other => number(other),
    }
}

/// Below the bars: where the interval and the estimate lie.
fn marks(curve: &ReportCurve, report: &Report) -> Option<String> {
    let (first, last) = ((*curve.f.first()?)?, (*curve.f.last()?)?);
    let [low, high] = report.f_ci95?.map(|f| column(f, first, last));
    let estimate = column(report.f?, first, last);
    let mark = |at| match at {
        _ if at == estimate => '▲',
        _ if (low..=high).contains(&at) => '─',
        _ => ' ',
    };
    Some((0..WIDTH).map(mark).collect::<String>().trim_end().to_string())
}

/// The column of a value of f between the curve's ends.
fn column(f: f64, first: f64, last: f64) -> usize {
    let share = if last > first { (f - first) / (last - first) } else { 0.0 };
    ((share * (WIDTH - 1) as f64).round() as usize).min(WIDTH - 1)
}

/// The curve as bars over an equal grid of f: each the least AIC of its stretch, on a square-root scale so that the
/// valley around the estimate shows beside a high evidence.
fn sparkline(curve: &ReportCurve) -> Option<String> {
    let points: Vec<(f64, f64)> =
        curve.f.iter().zip(&curve.aic).filter_map(|(f, aic)| Some(((*f)?, (*aic)?))).collect();
    let (first, last) = (points.first()?.0, points.last()?.0);
    let least = points.iter().map(|p| p.1).fold(f64::INFINITY, f64::min);
    let most = points.iter().map(|p| p.1).fold(f64::NEG_INFINITY, f64::max);
    if !(last > first && most > least) {
        return None;
    }
    let mut cells = [None::<f64>; WIDTH];
    for (f, aic) in points {
        let cell = &mut cells[column(f, first, last)];
        *cell = Some(cell.map_or(aic, |other| other.min(aic)));
    }
    let mut before = None;
    let bars = cells.iter().map(|cell| {
        before = cell.or(before);
        let height = ((before.unwrap_or(most) - least) / (most - least)).sqrt();
        BARS[((height * BARS.len() as f64) as usize).min(BARS.len() - 1)]
    });
    Some(bars.collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use stictiond::diagnosis::{Diagnosis, Verdict};
    use stictiond::serve::dto::report::{ReportCandidate, ReportEffect, ReportOscillation};

    fn bare() -> Report {
        Report::new("x", None, &Diagnosis::bare(Verdict::NoStiction, "made for a test"))
    }

    #[test]
    fn effects_are_told_with_their_probability_and_what_lies_between_kinds_too() {
        let mut report =
            Report::new("FIC101", None, &Diagnosis::bare(Verdict::NoStiction, "made for a test"));
        let candidate = |(kind, posterior): (&str, f64)| ReportCandidate {
            kind: kind.into(),
            posterior: Some(posterior),
        };
        report.residual.candidates =
            [("gain_change", 0.48), ("load_step", 0.41), ("none", 0.04)].map(candidate).into();
        let said = |named| between(&report.residual.kinds(), named).expect("no kind is sure") + "\n";
        let (between, beside) = (said(false), said(true));
        assert!(
            between.contains("a gain change (48 %)") && between.contains("a load step (41 %)"),
            "{between}"
        );
        assert!(page(&report).contains(&format!("\neffects     {between}")), "{}", page(&report));
        report.residual.effects = vec![ReportEffect {
            kind: "oscillating_load".into(),
            posterior: Some(0.99),
            delta_aic: Some(31.0),
            tag: None,
            parameters: Default::default(),
            explanation: "period 733 s".into(),
        }];
        let named = "\neffects     oscillating_load, 99 %: period 733 s\n            ";
        assert!(page(&report).contains(&format!("{named}{beside}")), "{}", page(&report));
        report.residual.candidates = [("none", 0.9), ("load_step", 0.1)].map(candidate).into();
        assert!(!page(&report).contains("the record "));
        assert!(!page(&report).contains("dAIC 31"));
    }

    #[test]
    fn opinions_with_an_index_have_a_line_and_the_others_are_told_by_why() {
        use stictiond::detectors::{Agreement, Band, Method, Opinion};
        use stictiond::results::Judged;
        use stictiond::signal::SpanSource;
        let judged = Judged {
            opinions: vec![
                Opinion::cannot_tell(Method::Horch1999, "the process integrates"),
                Opinion::of(Method::He2007, 0.73456, Band { sound: 0.4, sticks: 0.6 }, "SI 0.73"),
                Opinion::cannot_tell(Method::Kano2004A, "the process integrates"),
            ],
            agreement: Some(Agreement { why: "1 of 1".into(), ..Agreement::default() }),
            ..Diagnosis::bare(Verdict::NoStiction, "made for a test").into()
        };
        let page = page(&Report::judged("LIC1", (None, SpanSource::Unknown), &judged));
        let lines = "opinions    1 of 1\n            he_2007               sticks         0.7346  SI 0.73\n            \
                     horch_1999, kano_2004_a cannot tell: the process integrates\n";
        assert!(page.contains(lines), "{page}");
    }

    #[test]
    fn nothing_is_explained_that_is_not_there() {
        let mut report = Report::new("x", None, &Diagnosis::bare(Verdict::NoStiction, "made for a test"));
        let f: Vec<Option<f64>> = (0..=59).map(|k| Some(f64::from(k))).collect();
        let aic = f.iter().map(|f| f.map(|f| (f - 20.0).powi(2))).collect();
        (report.aic_curve, report.f_max) = (Some(ReportCurve { f, aic }), Some(59.0));
        report.residual.unexplained = true;
        let bare = page(&report);
        assert!(bare.contains("0 … 59 OP units\n") && !bare.contains('▲'), "{bare}");
        assert!(!bare.contains("unexplained"), "{bare}");
        (report.f, report.f_ci95) = (Some(20.0), Some([19.0, 21.0]));
        report.residual.failed_tests = vec!["drift".into()];
        let whole = page(&report);
        assert!(whole.contains("0 … 59 OP units; ▲ the estimate, ─ its interval\n"), "{whole}");
        assert!(whole.contains("\nunexplained drift\n"), "{whole}");
    }

    #[test]
    fn a_bound_is_told_once_and_a_probability_is_one_of_friction() {
        let mut report = bare();
        report.reason =
            "too little speaks for friction, evidence 2 of 20; f up to 2.642 OP could be hidden".into();
        (report.f, report.f_ci95, report.posterior) = (Some(0.0), Some([0.0, 2.642]), Some(0.69));
        let page = page(&report);
        assert_eq!(page.matches("could be hidden").count(), 1, "{page}");
        assert!(page.contains("probability of friction 69 %\n"), "{page}");
    }

    #[test]
    fn f_is_compared_where_the_verdict_tells_it() {
        let mut report = bare();
        let explanation = "39 samples of PV are off".into();
        report.residual.effects = vec![ReportEffect {
            kind: "outliers".into(),
            posterior: Some(1.0),
            delta_aic: None,
            tag: None,
            parameters: Default::default(),
            explanation,
        }];
        (report.residual.f_before, report.residual.f_after) = (Some(1.0), Some(2.0));
        assert!(!page(&report).contains(", f 1 -> 2"), "{}", page(&report));
        report.f = Some(2.0);
        assert!(page(&report).contains(", f 1 -> 2 OP units\n"), "{}", page(&report));
        report.residual.f_before = None;
        assert!(!page(&report).contains(", f - "), "{}", page(&report));
    }

    #[test]
    fn an_oscillation_without_a_swing_is_none() {
        let mut report = bare();
        let swing = |op_amplitude| ReportOscillation {
            period_s: Some(9085.0),
            regularity_r: Some(0.7),
            op_amplitude: Some(op_amplitude),
        };
        report.oscillation = Some(swing(0.0));
        assert!(!page(&report).contains("9085"), "{}", page(&report));
        report.oscillation = Some(swing(0.1));
        assert!(page(&report).contains("\noscillation period 9085 s"), "{}", page(&report));
    }

    #[test]
    fn a_window_of_the_calendar_is_told_in_dates() {
        let told = |start, end| stretch(Some(start), Some(end));
        assert_eq!(
            told(1_700_000_000.0, 1_700_001_000.0),
            "2023-11-14 22:13:20 UTC to 2023-11-14 22:30:00 UTC"
        );
        assert_eq!(told(370.036, 2368.046), "370.036 to 2368.046 s");
        assert_eq!(stretch(None, Some(1_700_000_000.25)), "- to 1700000000.25 s");
    }

    #[test]
    fn noise_is_told_as_a_share_where_it_is_one() {
        let told = [Some(0.083), Some(1.0), Some(2.12), Some(8e-16), None].map(noise_of_op);
        let like_noise = "OP moves from sample to sample as noise does";
        assert_eq!(
            told,
            ["OP noise 8.3 % of its sd", like_noise, like_noise, "no noise in OP", "OP noise not known"]
        );
    }

    #[test]
    fn an_unknown_span_is_asked_for() {
        let mut report = bare();
        (report.f, report.f_unit_assumed, report.op_span) = (Some(0.5), true, None);
        (report.f_threshold, report.f_unit) = (Some(0.001), "OP units".into());
        let asked = "OP's values do not tell its span: say it with --op-span";
        let page = page(&report);
        assert!(page.contains(asked) && page.contains("from f = 0.001 OP units on"), "{page}");
        assert!(!page.contains("unit OP units"), "{page}");
    }

    #[test]
    fn numbers_have_four_digits() {
        let cases = [
            (0.0, "0"),
            (2.5, "2.5"),
            (0.01024, "0.01024"),
            (446.0, "446"),
            (49950.0, "49950"),
            (1_700_000_000.0, "1.700e9"),
            (-12.3456, "-12.35"),
            (1e-9, "1.000e-9"),
            (1e308, "1.000e308"),
        ];
        for (value, text) in cases {
            assert_eq!(number(Some(value)), text);
        }
        assert_eq!(number(None), "-");
        assert_eq!([0, 1, 2].map(|count| many(count, "request")), ["0 requests", "1 request", "2 requests"]);
        assert_eq!(stamp(Some(1_700_000_000.25)), "1700000000.25");
    }

    #[test]
    fn sparkline_is_lowest_at_the_estimate() {
        let f: Vec<Option<f64>> = (0..=59).map(|k| Some(f64::from(k))).collect();
        let aic = f.iter().map(|f| f.map(|f| (f - 20.0).powi(2))).collect();
        let bars: Vec<char> = sparkline(&ReportCurve { f, aic }).unwrap().chars().collect();
        assert_eq!(bars.len(), WIDTH);
        assert_eq!((bars[20], bars[59]), ('▁', '█'));
        assert_eq!([-1.0, 0.0, 20.0, 59.0, 99.0].map(|f| column(f, 0.0, 59.0)), [0, 0, 20, 59, 59]);
        let flat = ReportCurve { f: vec![Some(0.0), Some(1.0)], aic: vec![Some(1.0), None] };
        assert_eq!(sparkline(&flat), None);
    }
}
