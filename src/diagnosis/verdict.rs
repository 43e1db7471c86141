//! The verdict, its reason in one line for an operator, and all steps from the record to it.
//!
//! | verdict | condition |
//! |---|---|
//! | stiction | f above its threshold, and `delta_aic` above its threshold, and steadiness above its limit, and 0 outside the interval of f |
//! | no stiction | one of these does not hold, OP reversed by enough, PV responds to OP, and both were read together |
//! | not identifiable | anything else |

use super::evidence::{Evidence, STEADY, interval, weigh};
use super::friction::{largest_reversal, reversals, srinivasan, stick_slip};
use super::gate::{self, Gated};
use super::grid::GRID;
use super::not_identifiable::{LEAST_EXTREMA, NotIdentifiable};
use super::preparation::Preparation;
use super::prepare::prepare;
use super::region::{self, Region};
use super::result::{CurvePoint, Diagnosis, Estimate, Model, Oscillation, Verdict};
use super::rivals::Rival;
use super::screen::{LONGEST_DELAY, Screen};
use super::search::{CellPoint, GridPoint, Holes, LEAST_REVERSALS, Problem, Refined, Searcher};
use super::settings::Settings;
use super::undersampling::too_few;
use super::{armax, validation};
use crate::signal::{Record, Row, Window, along_op, along_op_beside, beside, span_at_least, told};
use crate::sysid::stats::{mean, median, normalised, quantile, range, sd};
use crate::sysid::valve::model_error::with_model_error;

/// Fewest samples that must count after the start of the friction element: fifteen for each of eight coefficients.
const LEAST_ROWS: usize = 120;
/// Loss, as a share of the variance of PV, below which PV is explained fully: without noise it is, with OP or without.
const EXPLAINED: f64 = 1e-6;
/// Number of values of Srinivasan's d that are tried: it is for comparison only.
const D_GRID: usize = 60;

/// Diagnoses the record of one loop.
///
/// It never panics. A record that cannot be judged has the verdict `not_identifiable`; it is no error.
pub fn diagnose(record: &Record, settings: &Settings) -> Diagnosis {
    diagnose_gated(record, &gate::gate(record, settings), settings)
}

/// [`diagnose`] for a record that is gated already.
///
/// * `gated`: what [`gate::gate`] made of the record with these settings.
pub fn diagnose_gated(record: &Record, gated: &Gated, settings: &Settings) -> Diagnosis {
    with_history(judge(record, gated, settings))
}

/// Adds to the reason what an archive did to the data.
fn with_history(mut found: Diagnosis) -> Diagnosis {
    found.reason += &of_archive(&found.preparation, &found.verdict);
    found
}

/// The end of a reason where an archive changed the data; else empty, also where the reason is the archive.
///
/// `docs/backfill.md` has the effect on f, measured on simulated loops.
pub fn of_archive(preparation: &Preparation, verdict: &Verdict) -> String {
    let is_reason = matches!(verdict, Verdict::NotIdentifiable(NotIdentifiable::Compressed { .. }));
    let Some(history) = preparation.history.as_ref().filter(|_| !is_reason) else { return String::new() };
    format!("; the data is not raw ({}): {}", history.kind.as_str(), history.kind.effect())
}

/// The end of a reason of `no_stiction`: the largest f that the record could hide.
///
/// * `f`: the upper end of the interval of f (OP unit).
/// * `span`: the span of OP, where it is known (OP unit).
pub fn could_be_hidden(f: f64, span: Option<f64>) -> String {
    format!("; f up to {} could be hidden", along_op(f, span))
}

/// The reason of a diagnosis without its ends, [`could_be_hidden`] and [`of_archive`].
///
/// * `span`: the span of OP, where it is known (OP unit).
pub fn bare_reason(found: &Diagnosis, span: Option<f64>) -> &str {
    let archive = of_archive(&found.preparation, &found.verdict);
    let reason = found.reason.strip_suffix(archive.as_str()).unwrap_or(&found.reason);
    let bound = found.estimate.as_ref().map(|e| could_be_hidden(e.f_ci95[1], span));
    bound.and_then(|bound| reason.strip_suffix(bound.as_str())).unwrap_or(reason)
}

/// The thresholds of a verdict. Sentences give a number with as many digits as show on which side of its threshold it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Thresholds {
    /// Of the evidence, `delta_aic` (-).
    pub evidence: f64,
    /// Of f (OP unit).
    pub f: f64,
}

impl Thresholds {
    /// The evidence in a sentence.
    fn told(&self, evidence: f64) -> String {
        format!("evidence {}", beside(evidence, &[self.evidence], 0))
    }

    /// The reason of `stiction`.
    ///
    /// * `evidence`: `delta_aic` (-).
    /// * `f`: friction, and `[low, high]`: its interval (OP unit).
    /// * `span`: the span of OP, where it is known (OP unit).
    pub fn sticks(&self, evidence: f64, f: f64, [low, high]: [f64; 2], span: Option<f64>) -> String {
        let per = span.map_or(1.0, |span| 100.0 / span);
        let [low, high] = [low, high].map(|f| told(per * f));
        let f = along_op_beside(f, &[self.f], span);
        format!("f = {f} [{low}, {high}], {}", self.told(evidence))
    }

    /// The reason of `no_stiction` where the evidence for friction is enough: f is below its threshold, or its interval reaches 0.
    ///
    /// * `evidence`: `delta_aic` (-).
    /// * `[f, low]`: f, and the lower end of its interval (OP unit).
    /// * `span`: the span of OP, where it is known (OP unit).
    pub fn not_told(&self, evidence: f64, [f, low]: [f64; 2], span: Option<f64>) -> String {
        if low > 0.0 {
            return self.too_small(evidence, f, span);
        }
        format!("friction predicts PV better, {}, but f may be 0", self.told(evidence))
    }

    /// The reason of `no_stiction` where the evidence for friction is enough, and f is below its threshold.
    ///
    /// * `evidence`: `delta_aic` (-).
    /// * `f`: friction (OP unit).
    /// * `span`: the span of OP, where it is known (OP unit).
    pub fn too_small(&self, evidence: f64, f: f64, span: Option<f64>) -> String {
        let f = along_op_beside(f, &[self.f], span);
        format!(
            "friction predicts PV better, {}, but its f of {f} is too small to matter",
            self.told(evidence)
        )
    }

    /// The reason of `no_stiction` where the evidence for friction is too small.
    ///
    /// * `evidence`: `delta_aic` (-); below 0 it is 0.
    pub fn too_little(&self, evidence: f64) -> String {
        if evidence < 1.0 {
            return "nothing speaks for friction, evidence 0".to_string();
        }
        format!("too little speaks for friction, {} of {}", self.told(evidence), self.evidence)
    }
}

/// Fewest samples that a record needs for a fit with this longest delay (samples), where its first sample is an extremum of OP.
pub fn least_samples(max_delay: usize) -> usize {
    Screen::lead(max_delay) + LEAST_ROWS
}

/// A record that can be fitted.
#[derive(Debug)]
pub struct Prepared {
    /// The window that is fitted.
    pub window: Window,
    /// How the record became this window.
    pub preparation: Preparation,
    /// The large extrema of OP.
    pub region: Region,
    /// The oscillation of OP, where there is one.
    pub oscillation: Option<Oscillation>,
    /// The window, normalised, for the search.
    pub problem: Problem,
    /// Means and standard deviations by which it was normalised.
    pub scale: Scale,
    /// The span of OP, where it is known (OP unit).
    pub span: Option<f64>,
}

/// Prepares a gated record for the fits: the decimation, the most regular stretch, and the normalisation.
///
/// # Errors
/// The diagnosis, `not_identifiable` with its reason, of a record that cannot be fitted.
pub fn prepared(record: &Record, gated: &Gated, settings: &Settings) -> Result<Prepared, Box<Diagnosis>> {
    let stop = |reason, preparation, oscillation, window| {
        Err(Box::new(refused(reason, preparation, oscillation, window)))
    };
    let (window, mut preparation) = match gated {
        Ok(passed) => passed.clone(),
        Err(why) => return stop(why.0.clone(), why.1.clone(), None, None),
    };
    let (window, region) = prepare(window, settings, &mut preparation);
    if let Some(reason) = preparation.too_close() {
        return stop(reason, preparation, None, None);
    }
    let n = window.len();
    preparation.compensated = record.compensated(&window);
    let undersampled = |unexcited| too_few(&window.op, &preparation, unexcited);
    if let Some(reason) = undersampled(false) {
        // No oscillation is reported: the period that is seen may be an alias.
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
            let (reason, oscillation) =
                undersampled(true).map_or((reason, oscillation), |reason| (reason, None));
            stop(reason, preparation, oscillation, Some(window))
        }
        Err(reason) => stop(preparation.by_archive(reason), preparation, oscillation, Some(window)),
    }
}

/// The diagnosis of a record, without what an archive did to it.
fn judge(record: &Record, gated: &Gated, settings: &Settings) -> Diagnosis {
    let prepared = match prepared(record, gated, settings) {
        Ok(prepared) => prepared,
        Err(refused) => return *refused,
    };
    let mut searcher = Searcher::new(&prepared.problem);
    let grid = searcher.grid(GRID);
    let cells = searcher.full_profile();
    let (sound, sticky) = searcher.refine(&grid, &cells);
    let weighed =
        sticky.map(|sticky| (sticky, evidence_for(&prepared, settings, &mut searcher, [&sound, &sticky])));
    let verdict = verdict_of(&prepared, settings, &cells, weighed.as_ref());
    let Prepared { window, preparation, oscillation, ref problem, scale, span, .. } = prepared;
    if let Verdict::NotIdentifiable(reason) = verdict {
        return refused(reason, preparation, oscillation, Some(window));
    }
    let sticking = weighed.filter(|_| verdict == Verdict::Stiction).map(|found| found.0);
    let chosen = sticking.unwrap_or(sound);
    let bounds = match (sticking, weighed) {
        (Some(sticky), _) => interval_with_unseen(problem, &preparation, &cells, &sticky),
        (None, weighed) => {
            interval_from_zero(problem, &preparation, &cells, &sound, weighed.map(|found| found.0))
        }
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
        low: interval_with_unseen(problem, &preparation, &cells, sticky)[0] * scale.u,
    });
    let least = Thresholds { evidence: settings.evidence_threshold, f: preparation.f_threshold };
    let reason = explain(&verdict, &estimate, tried, least, span);
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

/// The evidence for the sticky model against the sound one, at f = 0, and the other explanations without friction.
fn evidence_for(
    found: &Prepared,
    settings: &Settings,
    searcher: &mut Searcher<'_>,
    [sound, sticky]: [&Refined; 2],
) -> Evidence {
    let ((sound_errors, _), (errors, _)) = (searcher.errors(sound), searcher.errors(sticky));
    let (period, worth) = (found.region.typical_period(), 0.5 * settings.evidence_threshold);
    weigh(&found.problem, sound, sticky, [&sound_errors, &errors], period, worth)
}

/// Stiction where f, its evidence, its steadiness and its interval meet their conditions; else whether the record can say no.
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
            && interval_with_unseen(&found.problem, &found.preparation, cells, sticky)[0] > 0.0
    };
    if weighed.is_some_and(believed) {
        return Verdict::Stiction;
    }
    match unanswered(&found.problem, &found.region) {
        // A valve that write-back moves at once shows no friction in OP and PV.
        _ if found.preparation.compensated > 0.0 => Verdict::NotIdentifiable(NotIdentifiable::Compensated),
        Some(reason) => Verdict::NotIdentifiable(reason),
        None => found.preparation.apart().map_or(Verdict::NoStiction, Verdict::NotIdentifiable),
    }
}

/// The interval of f (unit of the problem's OP). Where the controller may have acted unseen, it is widened by the fast steps of OP
/// instead of its median step.
fn interval_with_unseen(
    p: &Problem,
    preparation: &Preparation,
    cells: &[CellPoint],
    sticky: &Refined,
) -> [f64; 2] {
    let [low, high] = interval(p, cells, sticky);
    let Some(fast) = preparation.unseen_moves() else { return [low, high] };
    let steps: Vec<f64> = p.u.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
    let more = quantile(&steps, fast) - median(&steps);
    [(low - more).max(0.0), high + more]
}

/// The interval of f for f = 0 (unit of the problem's OP): from 0 up to what the record could have hidden.
fn interval_from_zero(
    p: &Problem,
    preparation: &Preparation,
    cells: &[CellPoint],
    sound: &Refined,
    sticky: Option<Refined>,
) -> [f64; 2] {
    let most = |sticky: Refined| sticky.f.max(0.0) + p.f_top;
    let own = || interval_with_unseen(p, preparation, cells, sound)[1];
    [0.0, sticky.map_or(p.f_top, |sticky| own().min(most(sticky)))]
}

/// The normalisation of a window: subtract the mean, divide by the standard deviation.
#[derive(Clone, Copy, Debug)]
pub struct Scale {
    /// Mean of OP (OP unit).
    pub u0: f64,
    /// Standard deviation of OP (OP unit).
    pub u: f64,
    /// Standard deviation of PV (PV unit).
    pub y: f64,
}

/// The normalised problem of a window, for the search.
///
/// # Errors
/// OP has too few reversals, too few rows count after the first of them, or a sum of the values overflows.
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

/// The reason where fewer than [`LEAST_ROWS`] rows count from row `first` on: the window is too short, or too many of its rows
/// are at a limit of OP or missing.
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

/// The reason why a record without evidence for friction is no evidence against friction: OP does not reverse by enough, or PV does
/// not respond to OP. `None` where neither holds.
pub fn unanswered(p: &Problem, region: &Region) -> Option<NotIdentifiable> {
    let (mut x, mut dir) = (p.u.clone(), vec![0.0; p.u.len()]);
    stick_slip(&p.u, 0.5 * p.f_top, 0.0, p.start, &mut x, &mut dir);
    // One reversal fewer than a fit needs, because only the middle of the range of f is tested.
    if reversals(&dir) < LEAST_REVERSALS - 1 {
        return Some(NotIdentifiable::NotExcited { reversals: region.reversals(0, p.u.len()) });
    }
    let s = p.signals(&p.u, &dir);
    let mut screen = Screen::new(&p.y, p.counted(), p.max_delay);
    screen.load(&s, false);
    let with_op = screen.fit_lag(0.0, 0.0).loss;
    let without = screen.without_input();
    let inputs = Screen::input_lags(p.max_delay) as f64;
    // A record without noise is explained fully without OP as well; that is no lack of response.
    if without < EXPLAINED {
        return None;
    }
    let gain = p.rows() * ((without + armax::LOSS_FLOOR) / (with_op + armax::LOSS_FLOOR)).ln() - 2.0 * inputs;
    (gain <= 0.0).then_some(NotIdentifiable::NoResponse)
}

/// Srinivasan's d (unit of the problem's OP): that with the least loss of the long ARX, on a grid.
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

/// The AIC curve over f; `unit` is the standard deviation of OP (OP unit).
fn curve(grid: &[GridPoint], p: &Problem, unit: f64) -> Vec<CurvePoint> {
    let least = grid.iter().map(|g| g.loss).fold(f64::INFINITY, f64::min);
    grid.iter().map(|g| CurvePoint { f: g.f * unit, aic: p.rows() * (g.loss / least).ln() }).collect()
}

/// The chosen model in the plant's units.
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

/// The sticky model, as far as its reason tells of it.
struct Tried<'a> {
    evidence: &'a Evidence,
    /// f (OP unit).
    f: f64,
    /// The lower end of the interval of f (OP unit).
    low: f64,
}

/// The reason of a verdict in one line, as an operator reads it.
///
/// * `tried`: the sticky model, where OP reverses enough for one.
/// * `span`: the span of OP, where it is known (OP unit).
fn explain(
    verdict: &Verdict,
    e: &Estimate,
    tried: Option<Tried<'_>>,
    least: Thresholds,
    span: Option<f64>,
) -> String {
    let bound = could_be_hidden(e.f_ci95[1], span);
    let Some(Tried { evidence: w, f, low }) = tried else {
        return format!("OP never reverses by enough for friction to hold the stem{bound}");
    };
    if *verdict == Verdict::Stiction {
        let sticks = least.sticks(e.delta_aic, e.f, e.f_ci95, span);
        return format!("{sticks}; next best explanation: {}", w.rival.name());
    }
    // The published evidence: below 0 it is 0.
    let evidence = least.told(e.delta_aic);
    let is_enough = w.delta_aic > least.evidence;
    let why = if !is_enough && w.rival != Rival::Linear {
        format!("{} explains the record about as well as friction, {evidence}", w.rival.name())
    } else if w.steadiness <= STEADY {
        let steadiness = beside(w.steadiness, &[STEADY], 1);
        format!("no steady gain from friction, {evidence}, steadiness {steadiness}")
    } else if is_enough {
        least.not_told(e.delta_aic, [f, low], span)
    } else {
        least.too_little(e.delta_aic)
    };
    why + &bound
}

/// The diagnosis of a record that is refused.
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
pub(crate) mod tests;
