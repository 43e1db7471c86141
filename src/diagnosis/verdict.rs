//! The verdict, and the whole way to it.
//!
//! *stiction*: f above the threshold **and** `delta_aic` above its own **and** a gain shared by the record **and** 0 outside the
//! interval of f.
//! *no stiction*: the loop was excited, PV answers OP, both were read together, and one of these four does not hold.
//! *not identifiable*: anything else.

use super::evidence::{Evidence, STEADY, interval, weigh};
use super::friction::{largest_reversal, reversals, srinivasan, stick_slip};
use super::grid::GRID;
use super::prepare::prepare;
use super::region::{self, Region};
use super::rivals::Rival;
use super::screen::{LONGEST_DELAY, Screen};
use super::search::{CellPoint, GridPoint, Holes, LEAST_REVERSALS, Problem, Refined, Searcher};
use super::undersampling::too_few;
use super::{
    CurvePoint, Diagnosis, Estimate, Model, NotIdentifiable, Oscillation, Preparation, Settings, Verdict,
};
use super::{armax, gate, validation};
use crate::signal::{Record, Row, Window, along_op, span_at_least, told};
use crate::sysid::stats::{mean, median, normalised, quantile, range, sd};
use crate::sysid::valve::model_error::with_model_error;

/// Fewest large extrema of OP in the window: those of two periods.
const LEAST_EXTREMA: usize = 4;
/// Fewest samples that may be left to count after the friction element's start: fifteen for each of eight coefficients.
const LEAST_ROWS: usize = 120;
/// Loss relative to var(PV) below which PV is taken as fully explained: without noise it is, with OP or without.
const EXPLAINED: f64 = 1e-6;
/// Values of Srinivasan's d tried: it is for comparison only.
const D_GRID: usize = 60;

/// Diagnoses one loop's record. Never panics on any input; what cannot be judged is a verdict, not an error.
pub fn diagnose(record: &Record, settings: &Settings) -> Diagnosis {
    with_history(judge(record, settings))
}

/// Says what an archive did to the data.
fn with_history(mut found: Diagnosis) -> Diagnosis {
    found.reason += &of_archive(&found.preparation);
    found
}

/// What a reason ends with where an archive changed the data; else nothing. Measured on simulated loops: docs/backfill.md. It is said,
/// and changes no verdict.
pub fn of_archive(preparation: &Preparation) -> String {
    preparation.history.as_ref().map_or_else(String::new, |history| {
        let kind = history.kind.as_str();
        format!("; the data is not raw ({kind}): f reads low, and sticking may go unseen")
    })
}

/// What a reason of `no_stiction` leaves possible: the upper end of the interval of f (OP unit).
pub fn could_be_hidden(f: f64, span: Option<f64>) -> String {
    format!("; f up to {} could be hidden", along_op(f, span))
}

/// The reason of a diagnosis without what it ends with: what the record could hide, and what an archive did to it. `span`: that of
/// OP, where it is known (OP unit).
pub fn bare_reason(found: &Diagnosis, span: Option<f64>) -> &str {
    let archive = of_archive(&found.preparation);
    let reason = found.reason.strip_suffix(archive.as_str()).unwrap_or(&found.reason);
    let bound = found.estimate.as_ref().map(|e| could_be_hidden(e.f_ci95[1], span));
    bound.and_then(|bound| reason.strip_suffix(bound.as_str())).unwrap_or(reason)
}

/// Why friction with enough evidence is not told: its f is below the threshold, or its interval reaches 0. `f`, and the lower end of
/// its interval (OP unit).
pub fn not_told(evidence: f64, [f, low]: [f64; 2], span: Option<f64>) -> String {
    let but = match low > 0.0 {
        true => format!("its f of {} is too small to matter", along_op(f, span)),
        false => "f may be 0".to_string(),
    };
    format!("friction predicts PV better, evidence {evidence:.0}, but {but}")
}

/// Fewest samples that a record needs for a fit with this longest delay (samples), if OP turns at its first.
pub fn least_samples(max_delay: usize) -> usize {
    Screen::lead(max_delay) + LEAST_ROWS
}

/// A record that can be fitted.
#[derive(Debug)]
pub struct Prepared {
    /// The window that is fitted.
    pub window: Window,
    /// How it came about.
    pub preparation: Preparation,
    /// Where OP turns.
    pub region: Region,
    /// How OP oscillates.
    pub oscillation: Option<Oscillation>,
    /// The window as a problem of the search.
    pub problem: Problem,
    /// How it was normalised.
    pub scale: Scale,
    /// The span of OP, where it is known (OP unit).
    pub span: Option<f64>,
}

/// Prepares a record for the fits.
///
/// # Errors
/// The diagnosis of a record that cannot be fitted.
pub fn prepared(record: &Record, settings: &Settings) -> Result<Prepared, Box<Diagnosis>> {
    let stop = |reason, preparation, oscillation, window| {
        Err(Box::new(refused(reason, preparation, oscillation, window)))
    };
    let (window, mut preparation) = match gate::gate(record, settings) {
        Ok(passed) => passed,
        Err(why) => return stop(why.0, why.1, None, None),
    };
    let (window, region) = prepare(window, settings, &mut preparation);
    if let Some(reason) = preparation.too_close() {
        return stop(reason, preparation, None, None);
    }
    let n = window.len();
    preparation.compensated = record.compensated(&window);
    let few = |unexcited| too_few(&window.op, &preparation, unexcited);
    if let Some(reason) = few(false) {
        // The period that is seen is not the one that is there.
        return stop(reason, preparation, None, Some(window));
    }
    let oscillation = region.oscillation(0, n, window.ts);
    match pose(&window, &region, settings) {
        Ok((problem, scale)) => {
            let span = record.known_span();
            preparation.f_threshold = 0.01 * settings.f_threshold * span_at_least(span, &window.op);
            Ok(Prepared { window, preparation, region, oscillation, problem, scale, span })
        }
        Err(NotIdentifiable::NotExcited { .. }) if preparation.compensated > 0.0 => {
            stop(NotIdentifiable::Compensated, preparation, oscillation, Some(window))
        }
        Err(reason @ NotIdentifiable::NotExcited { .. }) => {
            let (reason, oscillation) = few(true).map_or((reason, oscillation), |reason| (reason, None));
            stop(reason, preparation, oscillation, Some(window))
        }
        Err(reason) => stop(reason, preparation, oscillation, Some(window)),
    }
}

fn judge(record: &Record, settings: &Settings) -> Diagnosis {
    let prepared = match prepared(record, settings) {
        Ok(prepared) => prepared,
        Err(refused) => return *refused,
    };
    let mut searcher = Searcher::new(&prepared.problem);
    let grid = searcher.grid(GRID);
    let cells = searcher.full_profile();
    let (sound, sticky) = searcher.refine(&grid, &cells);
    let period = prepared.region.typical_period();
    let (sound_errors, _) = searcher.errors(&sound);
    let weighed = sticky.map(|sticky| {
        let (errors, _) = searcher.errors(&sticky);
        let worth = 0.5 * settings.evidence_threshold;
        let evidence = weigh(&prepared.problem, &sound, &sticky, [&sound_errors, &errors], period, worth);
        (sticky, evidence)
    });
    let verdict = verdict_of(&prepared, settings, &cells, weighed.as_ref());
    let Prepared { window, preparation, oscillation, ref problem, scale, span, .. } = prepared;
    if let Verdict::NotIdentifiable(reason) = verdict {
        return refused(reason, preparation, oscillation, Some(window));
    }
    let sticking = weighed.filter(|_| verdict == Verdict::Stiction).map(|found| found.0);
    let chosen = sticking.unwrap_or(sound);
    let bounds = match (sticking, weighed) {
        (Some(sticky), _) => within(problem, &preparation, &cells, &sticky),
        (None, weighed) => hidden(problem, &cells, &sound, weighed.map(|found| found.0)),
    };
    let (low, high) = range(&window.op);
    let (_, stem) = searcher.errors(&chosen);
    let estimate = Estimate {
        f: chosen.f * scale.u,
        f_ci95: with_model_error(chosen.f, bounds).map(|b| b * scale.u),
        f_of_op_range: chosen.f * scale.u / (high - low),
        delta_aic: weighed.map_or(0.0, |(_, e)| e.delta_aic.max(0.0)),
        rival: weighed.map_or(Rival::Linear, |(_, e)| e.rival),
        steadiness: weighed.map_or(0.0, |(_, e)| e.steadiness),
        f_max: problem.f_top * scale.u,
        d: best_d(problem) * scale.u,
        curve: curve(&grid, problem, scale.u),
        model: model(&chosen, &scale),
        mv: stem.iter().map(|x| x * scale.u + scale.u0).collect(),
    };
    let tried = weighed.as_ref().map(|(sticky, evidence)| Tried {
        evidence,
        f: sticky.f * scale.u,
        low: within(problem, &preparation, &cells, sticky)[0] * scale.u,
    });
    let reason = explain(&verdict, &estimate, tried, settings.evidence_threshold, span);
    let residual = Some(validation::validate(problem, &chosen, scale.y));
    Diagnosis {
        verdict,
        reason,
        preparation,
        oscillation,
        estimate: Some(estimate),
        residual,
        window: Some(window),
        packed: None,
    }
}

/// Stiction where f, its evidence, its steadiness and its interval all say so; else whether the record can say no.
fn verdict_of(
    found: &Prepared,
    settings: &Settings,
    cells: &[CellPoint],
    weighed: Option<&(Refined, Evidence)>,
) -> Verdict {
    let believed = |(sticky, evidence): &(Refined, Evidence)| {
        sticky.f * found.scale.u > found.preparation.f_threshold
            && evidence.delta_aic > settings.evidence_threshold
            && evidence.steadiness > STEADY
            && within(&found.problem, &found.preparation, cells, sticky)[0] > 0.0
    };
    if weighed.is_some_and(believed) {
        return Verdict::Stiction;
    }
    match unanswered(&found.problem, &found.region) {
        // A valve that a term moves at once leaves OP and PV nothing to show.
        _ if found.preparation.compensated > 0.0 => Verdict::NotIdentifiable(NotIdentifiable::Compensated),
        Some(reason) => Verdict::NotIdentifiable(reason),
        None => found.preparation.apart().map_or(Verdict::NoStiction, Verdict::NotIdentifiable),
    }
}

/// The interval of f, wider by the fast steps of OP instead of its median step where the controller may have acted unseen.
fn within(p: &Problem, preparation: &Preparation, cells: &[CellPoint], sticky: &Refined) -> [f64; 2] {
    let [low, high] = interval(p, cells, sticky);
    let Some(fast) = preparation.unseen_moves() else { return [low, high] };
    let steps: Vec<f64> = p.u.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
    let more = quantile(&steps, fast) - median(&steps);
    [(low - more).max(0.0), high + more]
}

/// The interval that goes with f = 0: up to what the record could have hidden.
fn hidden(p: &Problem, cells: &[CellPoint], sound: &Refined, sticky: Option<Refined>) -> [f64; 2] {
    let high = sticky.map_or(p.f_top, |sticky| interval(p, cells, sound)[1].min(sticky.f.max(0.0) + p.f_top));
    [0.0, high]
}

/// How the window was normalised: subtract the mean, divide by the sd.
#[derive(Clone, Copy, Debug)]
pub struct Scale {
    /// Mean of OP (OP unit).
    pub u0: f64,
    /// Standard deviation of OP (OP unit).
    pub u: f64,
    /// Standard deviation of PV (PV unit).
    pub y: f64,
}

/// The search problem of a prepared window.
///
/// # Errors
/// Too few reversals of OP, too few rows that count behind the first of them, or values that no sum can hold.
pub fn pose(
    window: &Window,
    region: &Region,
    settings: &Settings,
) -> Result<(Problem, Scale), NotIdentifiable> {
    let n = window.len();
    let extrema = region.reversals(0, n);
    let not_excited = NotIdentifiable::NotExcited { reversals: extrema };
    if extrema < LEAST_EXTREMA {
        return Err(not_excited);
    }
    let Some(start) = region::start_of(region, &window.op, 0, n) else {
        return Err(not_excited);
    };
    let max_delay = settings.max_delay.clamp(1, LONGEST_DELAY);
    let first = start.index + Screen::lead(max_delay);
    if let Some(reason) = shortage(window, first) {
        return Err(reason);
    }
    let scale = Scale { u0: mean(&window.op), u: sd(&window.op), y: sd(&window.pv) };
    if !(scale.u.is_finite() && scale.y.is_finite() && scale.u > 0.0 && scale.y > 0.0) {
        return Err(NotIdentifiable::OutOfScale);
    }
    let u = normalised(&window.op, scale.u0, scale.u);
    let f_top = largest_reversal(&u, start);
    let (y, holes) = (normalised(&window.pv, mean(&window.pv), scale.y), Holes::of(window, first));
    Ok((Problem { y, u, start, first, max_delay, f_top, holes }, scale))
}

/// Why too few rows count from row `first` on, where they are too few: there are no more, or those that do not count would have
/// been enough, at a limit or missing.
fn shortage(window: &Window, first: usize) -> Option<NotIdentifiable> {
    let (n, need) = (window.len(), first + LEAST_ROWS);
    let count = |rows: &[Row], worth: Row| rows.iter().filter(|row| **row == worth).count();
    let after = window.rows.get(first..).unwrap_or_default();
    let (silent, missing) = (count(after, Row::Silent), count(after, Row::Missing));
    if need + silent + missing <= n {
        return None;
    }
    Some(if need > n {
        NotIdentifiable::TooShort { n: n - silent - missing, need }
    } else if silent > missing {
        NotIdentifiable::Saturated { share: count(&window.rows, Row::Silent) as f64 / n as f64 }
    } else {
        NotIdentifiable::Gaps { share: window.missing() }
    })
}

/// Why a record without evidence for friction says nothing against it either.
pub fn unanswered(p: &Problem, region: &Region) -> Option<NotIdentifiable> {
    let (mut x, mut dir) = (p.u.clone(), vec![0.0; p.u.len()]);
    stick_slip(&p.u, 0.5 * p.f_top, 0.0, p.start, &mut x, &mut dir);
    // One reversal fewer than a fit needs: it is asked at the middle of the range of f, and only whether to refuse.
    if reversals(&dir) < LEAST_REVERSALS - 1 {
        return Some(NotIdentifiable::NotExcited { reversals: region.reversals(0, p.u.len()) });
    }
    let s = p.signals(&p.u, &dir);
    let mut screen = Screen::new(&p.y, p.counted(), p.max_delay);
    screen.load(&s, false);
    let with_op = screen.fit_lag(0.0, 0.0).loss;
    let without = screen.without_input();
    let inputs = Screen::input_lags(p.max_delay) as f64;
    // A record without noise is explained to the last digit by either; that is no lack of response.
    if without < EXPLAINED {
        return None;
    }
    let gain = p.rows() * ((without + armax::LOSS_FLOOR) / (with_op + armax::LOSS_FLOOR)).ln() - 2.0 * inputs;
    (gain <= 0.0).then_some(NotIdentifiable::NoResponse)
}

/// Srinivasan's d, in the unit of the problem: the least long-ARX loss over a grid.
pub fn best_d(p: &Problem) -> f64 {
    let mut screen = Screen::new(&p.y, p.counted(), p.max_delay);
    let (mut x, dir) = (vec![0.0; p.u.len()], vec![1.0; p.u.len()]);
    let mut best = (f64::INFINITY, 0.0);
    for i in 0..D_GRID {
        let d = 2.0 * p.f_top * i as f64 / D_GRID as f64;
        srinivasan(&p.u, d, &mut x);
        screen.load(&p.signals(&x, &dir), false);
        let loss = screen.fit_lag(0.0, 0.0).loss;
        if loss < best.0 {
            best = (loss, d);
        }
    }
    best.1
}

fn curve(grid: &[GridPoint], p: &Problem, unit: f64) -> Vec<CurvePoint> {
    let least = grid.iter().map(|g| g.loss).fold(f64::INFINITY, f64::min);
    grid.iter().map(|g| CurvePoint { f: g.f * unit, aic: p.rows() * (g.loss / least).ln() }).collect()
}

fn model(chosen: &Refined, scale: &Scale) -> Model {
    let (o, t) = (chosen.fit.orders, chosen.fit.theta);
    Model {
        na: o.na,
        nb: o.nb,
        nc: o.nc,
        nk: o.nk,
        a: t.a[..o.na].to_vec(),
        b: t.b[..o.nb].iter().map(|b| b * scale.y / scale.u).collect(),
        c: t.c[..o.nc].to_vec(),
        rmse: chosen.fit.loss.sqrt() * scale.y,
    }
}

/// Friction as it was weighed.
struct Tried<'a> {
    evidence: &'a Evidence,
    /// f of the sticky model (OP unit).
    f: f64,
    /// The lower end of its interval (OP unit).
    low: f64,
}

/// The verdict in one line. `tried`: friction, where OP let any be weighed; `least`: evidence above which it is told; `span`: that
/// of OP, where it is known (OP unit).
fn explain(
    verdict: &Verdict,
    e: &Estimate,
    tried: Option<Tried<'_>>,
    least: f64,
    span: Option<f64>,
) -> String {
    let bound = could_be_hidden(e.f_ci95[1], span);
    let Some(Tried { evidence: w, f, low }) = tried else {
        return format!("OP never reverses by enough for friction to hold the stem{bound}");
    };
    // As published: evidence below 0 is none.
    let evidence = format!("evidence {:.0}", e.delta_aic);
    if *verdict == Verdict::Stiction {
        let (per, unit) = span.map_or((1.0, ""), |span| (100.0 / span, " % OP"));
        let [f, low, high] = [e.f, e.f_ci95[0], e.f_ci95[1]].map(|f| told(f * per));
        return format!(
            "f = {f}{unit} [{low}, {high}], {evidence}; next best explanation: {}",
            w.rival.name()
        );
    }
    let is_enough = w.delta_aic > least;
    let why = if !is_enough && w.rival != Rival::Linear {
        format!("{} explains the record about as well as friction, {evidence}", w.rival.name())
    } else if w.steadiness <= STEADY {
        format!("no steady gain from friction, {evidence}, steadiness {:.1}", w.steadiness)
    } else if is_enough {
        not_told(e.delta_aic, [f, low], span)
    } else {
        format!("no friction needed, {evidence}")
    };
    why + &bound
}

fn refused(
    reason: NotIdentifiable,
    preparation: Preparation,
    oscillation: Option<Oscillation>,
    window: Option<Window>,
) -> Diagnosis {
    Diagnosis {
        preparation,
        oscillation,
        window,
        ..Diagnosis::bare(Verdict::NotIdentifiable(reason.clone()), reason.to_string())
    }
}

#[cfg(test)]
mod tests;
