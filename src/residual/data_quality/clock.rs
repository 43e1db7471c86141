//! Clock skew: OP and PV are stamped by clocks that disagree. The skew (s) is positive where PV's stamps are early; of clocks that
//! drift apart it is the mean over the window.
//!
//! ```text
//! controller  du[k] = sum_{i=0}^{2} g_i y[k-i] + sum_{i=1}^{2} h_i du[k-i] + sum_{i=0}^{2} r_i sp[k-i] + c + e,   du[k] = u[k] - u[k-1]
//! process     y[k]  = the high-order ARX on u
//! ```
//!
//! The first equation is that of a PI or PID controller, its derivative filtered or not. A skew of PV violates it, whereas the
//! process hides a skew in its dead time. So PV is shifted by every skew in turn, and the likelihood of the controller is compared
//! with that at right stamps.
//!
//! With feed-forward or in a cascade the controller does more than its equation says. Later samples of PV then explain OP's changes
//! too, because PV answers to them; but with that shift OP explains PV no longer. So, unless the controller's equation is exact, both
//! equations together must be likelier: by the chain rule of probability their sum gains nothing from what one takes from the
//! other. Neither equation is exactly true, so that the gain is compared with its own standard error.
//!
//! Source: Vuong, Econometrica 1989, 57, 307.

use super::equations::{Controller, Equations, HONEST, LONGEST, Shift, gain};
use super::fact::{Fact, TOLD, posterior};
use crate::residual::findings::{Described, Kind};
use crate::sysid::controller::LAGS;
use crate::sysid::criterion::{THRESHOLD, score};
use crate::sysid::iddata::{IdData, PvMoved};

/// Standard errors by which two inexact equations must be likelier: chance does that once in a thousand.
const STANDARD_ERRORS: f64 = 3.0;
/// Largest scale of the errors, as a share of that at right stamps, at which an equation that rounding may explain is the
/// controller's: a quarter of the variance, as for a late PV on rows.
const HALF: f64 = 0.5;

/// Finds a clock skew, and shifts PV to its right times. `step`: the quantum of PV (standard deviations of PV); 0 without one.
pub fn assess(data: &mut IdData, step: f64) -> Option<Fact> {
    let (shift, log_odds) = skew(data, step)?;
    let posterior = posterior(log_odds);
    if posterior < TOLD {
        return None;
    }
    (data.y, data.weight) = shift.moved(&data.y, &data.weight);
    data.known = shift.flags(&data.known);
    data.pv_moved = shift.is_late().then(|| PvMoved {
        late_s: -shift.first.min(shift.last) * data.units.ts,
        is_right: op_follows(data, step),
        perhaps_later: [shift.first, shift.last].into_iter().any(|by| by < 0.0 && Shift::is_longest(by)),
    });
    Some(Fact { kind: Kind::ClockSkew, posterior, described: describe(data.units.ts, shift) })
}

/// The clock skew of a PV that the gate has moved back already; `None` where it is too short to be one.
///
/// * `late_s`: the time by which PV was moved back (s); `ts`: the sample period (s).
pub fn of_gate(late_s: f64, ts: f64) -> Option<Fact> {
    let shift = Shift { first: -late_s / ts, last: -late_s / ts };
    // The gate moves PV where no other explanation comes near.
    let fact = || Fact { kind: Kind::ClockSkew, posterior: 1.0, described: describe(ts, shift) };
    shift.is_wrong().then(fact)
}

fn describe(ts: f64, shift: Shift) -> Described {
    let [first, last] = [shift.first, shift.last].map(|by| by * ts);
    let told = |by: f64| {
        let least = if Shift::is_longest(by) { "at least " } else { "" };
        format!("{least}{:.3} s {}", (by * ts).abs(), if by > 0.0 { "early" } else { "late" })
    };
    let skew = |explanation| Described::new(explanation).with("skew_s", 0.5 * (first + last), "s");
    if first == last {
        let told = told(shift.first);
        return skew(format!("PV's stamps are {told} against OP's: the controller says so"));
    }
    let (from, to) = (told(shift.first), told(shift.last));
    let explanation = format!("PV's stamps drift against OP's, from {from} to {to}: the controller says so");
    skew(explanation).with("growth_s", last - first, "s")
}

/// Whether OP is computed from PV of its row and before, exactly but for rounding, and from nothing else.
///
/// Then it tells of no PV that is still to come.
fn op_follows(data: &IdData, step: f64) -> bool {
    let equations = Equations::new(data, step);
    let fitted = |(moves, by)| equations.controller_of(moves, Shift::constant(by), data.rows());
    let honest = (0..=LAGS[1]).flat_map(|moves| HONEST.map(move |by| (moves, by))).map(fitted);
    let scales = honest.filter(|own| own.is_exact() && own.is_stable).map(|own| own.scale);
    let least = scales.fold(f64::INFINITY, f64::min);
    // Coarse values may hide that a later PV explains OP better.
    let of_later = |by: i32| fitted((LAGS[1], -by)).scale;
    least.is_finite() && (1..=LONGEST).map(of_later).all(|scale| scale >= HALF * least)
}

/// The likeliest shift of PV, and the log odds for it; `None` where the stamps are right.
fn skew(data: &IdData, step: f64) -> Option<(Shift, f64)> {
    let equations = Equations::new(data, step);
    let rows = data.rows();
    let n = rows.len() as f64;
    let honest: Vec<Controller> =
        HONEST.map(|by| equations.controller(Shift::constant(by), rows.clone())).collect();
    // Where right stamps fit exactly, a shift can fit better by rounding alone: in a pure sine any sample follows from any two others.
    if honest.iter().any(|own| own.scale <= equations.exact) {
        return None;
    }
    let constant = equations.constant(rows.clone());
    // A constant skew is one of so many alternatives; a drifting one has two parameters.
    let mut best = (&constant, 0.0, f64::from(2 * LONGEST + 1));
    let worth =
        |(of, rate, alternatives): (&Controller, f64, f64)| score(of.log_likelihood(), rate, alternatives, n);
    let growing = equations.growing(rows);
    if let Some(growing) = &growing {
        let other = (growing, 2.0 * THRESHOLD, 1.0);
        if worth(other) > worth(best) && gain(&growing.each, &constant.each).1 > STANDARD_ERRORS {
            best = other;
        }
    }
    let stamped = honest.iter().map(|honest| worth((honest, 0.0, 1.0))).fold(f64::NEG_INFINITY, f64::max);
    let (log_odds, (best, rate, alternatives)) = (worth(best) - stamped, best);
    if !best.shift.is_wrong() || log_odds < 0.0 {
        return None;
    }
    // Coarse values may leave no less at the right shift than at the stamps.
    let stamped = honest.iter().map(|own| own.scale).fold(f64::INFINITY, f64::min);
    if best.is_exact() && best.scale < HALF * stamped {
        return Some((best.shift, log_odds));
    }
    let both = |of: &Controller| -> Vec<f64> {
        equations
            .process(of.shift)
            .iter()
            .zip(&of.each)
            .map(|(process, controller)| process + controller)
            .collect()
    };
    let with = both(best);
    let rivals = honest.iter().map(|honest| gain(&with, &both(honest)));
    let (together, errors) = rivals.min_by(|a, b| a.0.total_cmp(&b.0))?;
    (errors > STANDARD_ERRORS).then(|| (best.shift, log_odds.min(score(together, rate, alternatives, n))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::Window;
    use crate::sysid::valve::Start;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// What a controller does beside PI.
    #[derive(Clone, Copy, Debug, Default)]
    struct Extra {
        /// Derivative time (samples), filtered over a fifth of it.
        derivative: f64,
        /// Standard deviation of what is added to OP: feed-forward, or the set point of a cascade that is not recorded.
        forward: f64,
        /// Steps in which OP is written.
        step: f64,
        /// Samples between two scans of the controller, less one.
        idle: usize,
    }

    /// OP, PV and set point of a loop whose set point moves every 90 samples.
    fn signals(extra: Extra) -> Window {
        let mut noise = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(11));
        let mut draw = || -> f64 { noise.next().unwrap_or(0.0) };
        let (mut x, mut op, mut last, mut load, mut forward): (f64, f64, f64, f64, f64) =
            (0.0, 0.0, 0.0, 0.0, 0.0);
        let (mut slow, mut rate, mut seen) = (0.0, 0.0, 0.0);
        let mut window = Window { ts: 1.0, sp: Some(Vec::new()), ..Window::default() };
        for k in 0..1200 {
            let target = [0.0, 2.0, -1.0, 1.5][k / 90 % 4];
            let pv = x + 0.1 * draw();
            if k % (extra.idle + 1) == 0 {
                let error: f64 = target - pv;
                op += 0.8 * (error - last + error / 8.0);
                last = error;
                slow += (pv - slow) / (1.0 + 0.2 * extra.derivative);
                let next = if extra.derivative > 0.0 { 0.8 * 5.0 * (pv - slow) } else { 0.0 };
                op -= next - rate;
                rate = next;
                forward = 0.95 * forward + 0.3 * extra.forward * draw();
                seen = op + forward;
                seen = if extra.step > 0.0 { (seen / extra.step).round() * extra.step } else { seen };
            }
            load = 0.95 * load + 0.05 * draw();
            x = 0.85 * x + 0.15 * (seen + load);
            window.op.push(seen);
            window.pv.push(pv);
            window.sp.iter_mut().for_each(|sp| sp.push(target));
        }
        window
    }

    /// PV as clocks that disagree by `stamped` record it: interpolated between two samples, or held from the one before.
    fn recorded(pv: &[f64], stamped: Shift, held: bool) -> Vec<f64> {
        let n = pv.len();
        let of = |k: usize| {
            let by = stamped.first + (stamped.last - stamped.first) * k as f64 / n as f64;
            let at = (k as f64 + by).clamp(0.0, n as f64 - 1.0);
            let (before, share) = (at as usize, if held { 0.0 } else { at.fract() });
            pv[before] + share * (pv[(before + 1).min(n - 1)] - pv[before])
        };
        (0..n).map(of).collect()
    }

    fn data(mut window: Window, stamped: Shift, with_sp: bool) -> IdData {
        window.pv = recorded(&window.pv, stamped, false);
        window.sp = window.sp.filter(|_| with_sp);
        IdData::new(&window, Start { index: 0, is_max: true }).expect("long enough")
    }

    fn told(window: Window, stamped: Shift, with_sp: bool) -> Option<Shift> {
        skew(&data(window, stamped, with_sp), 0.0)
            .filter(|found| posterior(found.1) > TOLD)
            .map(|found| found.0)
    }

    #[test]
    fn a_skew_is_found_to_the_sample_whether_the_set_point_is_recorded_or_not() {
        for by in [-6, -3, 3, 6] {
            let stamped = Shift::constant(by);
            for with_sp in [true, false] {
                assert_eq!(told(signals(Extra::default()), stamped, with_sp), Some(stamped), "{with_sp}");
            }
            let derivative = Extra { derivative: 4.0, ..Extra::default() };
            assert_eq!(told(signals(derivative), stamped, true), Some(stamped), "with a derivative");
            let coarse = Extra { step: 0.02, ..Extra::default() };
            assert_eq!(told(signals(coarse), stamped, true), Some(stamped), "OP in steps");
        }
    }

    #[test]
    fn clocks_that_part_are_found_at_both_ends() {
        for (first, last) in [(0.0, 4.0), (0.0, -4.0), (2.0, -2.0), (-1.0, -7.0)] {
            let found = told(signals(Extra::default()), Shift { first, last }, true).expect("they part");
            // Half of the noise between two samples is lost where PV is written between them.
            let off = [found.first - first, found.last - last];
            assert!(off.iter().all(|off| off.abs() < 0.75), "{found:?} for {first} to {last}");
        }
    }

    #[test]
    fn honest_stamps_are_never_wrong() {
        let extras = [
            Extra::default(),
            Extra { derivative: 4.0, ..Extra::default() },
            Extra { forward: 0.5, ..Extra::default() },
            Extra { forward: 2.0, derivative: 4.0, ..Extra::default() },
            Extra { step: 0.01, ..Extra::default() },
            Extra { step: 0.5, ..Extra::default() },
            Extra { idle: 2, ..Extra::default() },
            Extra { idle: 4, forward: 0.5, ..Extra::default() },
        ];
        for extra in extras {
            for (by, with_sp) in [(0, true), (0, false), (1, true)] {
                assert_eq!(told(signals(extra), Shift::constant(by), with_sp), None, "{extra:?} {by}");
            }
        }
    }

    #[test]
    fn a_wave_without_noise_tells_no_skew() {
        let rounded = |x: f64| f64::from(x as f32);
        let (mut window, mut op, mut last) = (Window { ts: 1.0, ..Window::default() }, 50.0, 0.0);
        for k in 0..1200 {
            let pv = 50.0 + (std::f64::consts::TAU * f64::from(k) / 44.0).sin();
            let error = 50.0 - pv;
            op += 0.8 * (error - last + error / 8.0);
            last = error;
            window.op.push(rounded(op));
            window.pv.push(rounded(pv));
        }
        assert_eq!(told(window, Shift::constant(0), false), None);
    }

    /// The signals with OP and PV written in steps.
    fn written(steps: [f64; 2]) -> Window {
        let window = signals(Extra::default());
        let [op, pv] = [(&window.op, steps[0]), (&window.pv, steps[1])]
            .map(|(v, step)| v.iter().map(|v| (v / step).round() * step).collect());
        Window { op, pv, ..window }
    }

    #[test]
    fn a_late_pv_is_found_at_any_rounding() {
        for steps in [[0.1, 1e-6], [0.01, 0.01], [1e-3, 1e-3], [1e-6, 1e-3]] {
            for by in [-4, -6, -12] {
                let stamped = Shift::constant(by);
                assert_eq!(told(written(steps), stamped, true), Some(stamped), "{steps:?} {by}");
            }
            assert_eq!(told(written(steps), Shift::constant(0), true), None, "{steps:?}");
        }
    }

    #[test]
    fn a_held_pv_whose_lateness_grows_is_never_later_than_the_controller_read_it() {
        let stamped = Shift { first: 0.0, last: -8.0 };
        let window = written([1e-3, 1e-3]);
        let late = Window { pv: recorded(&window.pv, stamped, true), ..window.clone() };
        let start = Start { index: 0, is_max: true };
        let [right, mut skewed] = [window, late].map(|of| IdData::new(&of, start).expect("long enough"));
        let told = assess(&mut skewed, 0.0).expect("eight samples").described.explanation;
        let moved = skewed.pv_moved.expect("it is late");
        assert!(
            moved.is_right && !moved.perhaps_later && (moved.late_s - 8.0).abs() < 1.0,
            "{moved:?}: {told}"
        );
        // PV of a row, or of the row after it.
        let pv = |data: &IdData, k: usize| data.y[k] * data.units.y + data.units.y0;
        let near = |k: usize, after: usize| (pv(&skewed, k) - pv(&right, k + after)).abs() < 1e-6;
        let rows = 32..1100;
        let (same, next) =
            (rows.clone().filter(|k| near(*k, 0)).count(), rows.clone().filter(|k| near(*k, 1)).count());
        assert!(same + next >= rows.len() - 60 && same > next, "{same} and {next} of {}", rows.len());
    }

    #[test]
    fn a_pv_that_the_gate_moved_back_is_told() {
        let fact = of_gate(8.0, 2.0).expect("four rows");
        assert_eq!(
            fact.described.explanation,
            "PV's stamps are 8.000 s late against OP's: the controller says so"
        );
        assert_eq!(fact.described.parameters[0].value, -8.0);
        assert!(of_gate(2.0, 2.0).is_none() && of_gate(0.0, 2.0).is_none());
    }

    #[test]
    fn a_lateness_at_the_end_of_the_range_is_at_least_that() {
        let beyond = Shift { first: -2.0, last: -24.0 };
        let mut skewed = data(signals(Extra::default()), beyond, true);
        if let Some(fact) = assess(&mut skewed, 0.0) {
            assert!(fact.described.explanation.contains("at least"), "{}", fact.described.explanation);
            assert!(skewed.pv_moved.is_some_and(|moved| moved.perhaps_later));
        }
    }

    #[test]
    fn stamps_are_put_right() {
        let honest = data(signals(Extra::default()), Shift::constant(0), true);
        let mut skewed = data(signals(Extra::default()), Shift::constant(3), true);
        let fact = assess(&mut skewed, 0.0).expect("three samples");
        assert_eq!(fact.described.parameters[0].value, 3.0);
        assert!((100..1100).all(|k| (skewed.y[k] - honest.y[k]).abs() < 0.02));
        assert_eq!((skewed.weight[2], skewed.weight[3], skewed.pv_moved), (0.0, 1.0, None));
    }
}
