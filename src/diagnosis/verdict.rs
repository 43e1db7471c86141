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
use crate::signal::{Record, Row, Window, span_at_least, told};
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
pub fn with_history(mut found: Diagnosis) -> Diagnosis {
    if let Some(history) = &found.preparation.history {
        // Measured on simulated loops: docs/backfill.md. It is said, and changes no verdict.
        let kind = history.kind.as_str();
        found.reason += &format!("; the data is not raw ({kind}): f reads low, and sticking may go unseen");
    }
    found
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
    let acted = |k: &usize| record.term_at(window.t0 + *k as f64 * window.ts) != 0.0;
    preparation.compensated = (0..n).filter(acted).count() as f64 / n.max(1) as f64;
    let few = |unexcited| too_few(&window.op, window.ts, preparation.history.as_deref(), unexcited);
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
    let reason =
        explain(&verdict, &estimate, weighed.as_ref().map(|(_, e)| e), span.map(|span| 100.0 / span));
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

/// The interval of f. Where OP and PV were read apart, OP at the time of PV is as far from what was read as it moves from one row
/// to the next where it moves fast.
fn within(p: &Problem, preparation: &Preparation, cells: &[CellPoint], sticky: &Refined) -> [f64; 2] {
    let [low, high] = interval(p, cells, sticky);
    if preparation.apart().is_none() {
        return [low, high];
    }
    let steps: Vec<f64> = p.u.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
    let more = quantile(&steps, preparation.reading.fast) - median(&steps);
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
/// Too few reversals of OP, or values that no sum can hold.
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
    let left_out = window.rows.iter().skip(first).filter(|row| **row != Row::Counts).count();
    if first + left_out + LEAST_ROWS > n {
        return Err(not_excited);
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

/// The verdict in one line; `percent` turns f into % of OP span where the span is known.
fn explain(verdict: &Verdict, e: &Estimate, evidence: Option<&Evidence>, percent: Option<f64>) -> String {
    let Some(w) = evidence else { return "OP never reverses by enough for friction to hold the stem".into() };
    let (per, unit) = percent.map_or((1.0, ""), |p| (p, " % OP"));
    match verdict {
        Verdict::Stiction => format!(
            "f = {}{unit} [{}, {}], evidence {:.0}; next best explanation: {}",
            told(e.f * per),
            told(e.f_ci95[0] * per),
            told(e.f_ci95[1] * per),
            w.delta_aic,
            w.rival.name()
        ),
        _ => {
            // As published: evidence below 0 is none.
            let evidence = format!("evidence {:.0}", e.delta_aic);
            let why = if w.rival != Rival::Linear {
                format!("{} explains the record about as well as friction, {evidence}", w.rival.name())
            } else if w.steadiness <= STEADY {
                format!("no steady gain from friction, {evidence}, steadiness {:.1}", w.steadiness)
            } else {
                format!("no friction needed, {evidence}")
            };
            format!("{why}; f up to {}{unit} could be hidden", told(e.f_ci95[1] * per))
        }
    }
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
