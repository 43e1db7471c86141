//! The report as a page for a person: the verdict first, then what it rests on.

use std::fmt::Write;
use stictiond::results::words::{SIMULATES_TO, between, percent, times_as};
use stictiond::serve::dto::report::{Report, ReportCurve, ReportOpinion, ReportSays, ReportVerdict};
use stictiond::signal::{figures, is_date, many, moment, trimmed};

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
    if let Some(traced) = report.traced_elsewhere() {
        let (samples, stretch) = (many(traced.n, "sample"), stretch(traced.start, traced.end));
        line("traced", format!("effects were looked for in {samples}, from {stretch}"));
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
            line("", free_run_is_worse(r.free_run_ratio()));
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
        let most = report.aic_curve.as_ref().and_then(|curve| curve.f.last().copied().flatten());
        line("", format!("0 … {} {unit}{legend}", number(most)));
    }
    out
}

/// That a simulation is worse with the effects, and by how much.
///
/// * `times`: its error over that of the declared model (-); `None` where it is not known.
fn free_run_is_worse(times: Option<f64>) -> String {
    let Some(times) = times else { return "the free run is worse with the effects than without".into() };
    let advice = if times > SIMULATES_TO { ": do not simulate with this model" } else { "" };
    format!("the free run is {} as far off with the effects as without{advice}", times_as(times))
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
mod tests;
