//! Undeclared effects: what they ask of the plan, and how they are put into the signals.

use std::f64::consts::TAU;

use stictiond_numerics::residual::Kind;

use super::super::{Case, Size};
use super::draw::{Draw, deviation, lagged, peak, rms};
use super::loads::{scale, share};
use super::plan::{Bend, Plan, Wish};
use super::run::{Signals, Trace, WARM_UP, add, run};
use super::sensor::{Fault, recorded_pv};

/// Draws of one effect before the whole loop is drawn anew.
const TRIES: usize = 5;
/// Largest amplitude that an effect may ask of OP (%).
const OP_ROOM: f64 = 18.0;
/// Largest deviation that an effect may put on PV.
const PV_ROOM: f64 = 25.0;
/// Least movement of PV that an effect is judged by (standard deviations of its noise).
const LEAST: f64 = 2.5;
/// Largest deviation of PV while the stem lies against a stop.
const STOP_ROOM: f64 = 15.0;
/// Movement of PV by the slow load that drives the stem to a stop (standard deviations of the noise).
const STOP_LOAD: f64 = 30.0;
/// Steps of the search for a stop's place.
const STOP_STEPS: usize = 7;

/// A size from the range that belongs to the case's size.
fn size(case: &Case, small: (f64, f64), medium: (f64, f64), large: (f64, f64), draw: &mut Draw) -> f64 {
    let (low, high) = match case.size {
        Size::Small => small,
        Size::Medium => medium,
        Size::Large => large,
    };
    draw.even(low, high)
}

/// What the case's effect asks of the plan.
pub fn wish(case: &Case, calm: f64, draw: &mut Draw) -> Wish {
    let mut wish = Wish {
        gain: 1.0,
        delay: 0.0,
        lively: false,
        tight: false,
        bend: None,
        slip: None,
        asymmetry: 1.0,
        direct: false,
        calm,
    };
    let Some(effect) = case.effect else { return wish };
    match effect {
        Kind::GainChange => {
            let factor = size(case, (1.4, 1.55), (1.7, 2.0), (2.2, 2.5), draw);
            wish.gain = if draw.chance(0.5) { factor } else { 1.0 / factor };
            (wish.lively, wish.tight) = (true, true);
        }
        Kind::DeadTimeChange => {
            wish.delay = draw.sign() * size(case, (1.5, 2.5), (3.0, 5.0), (6.0, 9.0), draw);
            (wish.lively, wish.tight) = (true, true);
        }
        Kind::FrozenPv | Kind::ClockSkew => wish.lively = true,
        Kind::ValveSaturation => wish.direct = true,
        Kind::StaticNonlinearity => {
            let bend = if case.variant.is_multiple_of(2) { Bend::Valve } else { Bend::Gain };
            wish.bend = Some((bend, size(case, (1.4, 1.6), (1.9, 2.4), (2.8, 3.5), draw)));
            wish.direct = true;
        }
        Kind::SlipJump => {
            let none = case.size == Size::Large && draw.chance(0.4);
            let slip = size(case, (0.45, 0.6), (0.2, 0.4), (0.0, 0.12), draw);
            wish.slip = Some(if none { 0.0 } else { slip });
        }
        Kind::AsymmetricFriction => {
            let ratio = size(case, (1.5, 1.7), (1.9, 2.3), (2.6, 3.0), draw);
            wish.asymmetry = if draw.chance(0.5) { ratio } else { 1.0 / ratio };
        }
        _ => {}
    }
    wish
}

/// What the effect's size is judged by, from the loop without it.
struct Measure {
    /// PV's usual distance from the set point, not below some times the noise (PV).
    pv: f64,
    /// OP's usual movement (%).
    op: f64,
}

impl Measure {
    fn new(plan: &Plan, signals: &Signals) -> (Self, Trace) {
        let trace = run(plan, signals, false);
        let mut distance: Vec<f64> = trace.error().iter().map(|e| e.abs()).collect();
        distance.sort_by(f64::total_cmp);
        // Long transients of the set point do not count: 1.48 makes a standard deviation of the median.
        let usual = 1.48 * distance[distance.len() / 2];
        let measure = Self { pv: usual.max(LEAST * plan.noise), op: deviation(&trace.swing(plan.at)) };
        (measure, trace)
    }
}

/// Puts the effect; `None` where this loop cannot carry it. A tag that belongs to the effect is returned.
pub fn put(
    case: &Case,
    wish: &Wish,
    plan: &mut Plan,
    signals: &mut Signals,
    draw: &mut Draw,
) -> Option<Vec<(String, Vec<f64>)>> {
    let Some(effect) = case.effect else { return Some(Vec::new()) };
    match effect {
        Kind::OscillatingLoad => put_oscillation(case, plan, signals, draw)?,
        Kind::MeasuredDisturbance => return put_disturbance(case, plan, signals, draw),
        Kind::LoadStep => put_step(case, plan, signals, draw)?,
        Kind::Drift => put_drift(case, plan, signals, draw),
        Kind::GainChange => {
            let at = moment(plan, 0.25, 0.75, draw);
            signals.gain[at..].fill(wish.gain);
        }
        Kind::DeadTimeChange => {
            let at = moment(plan, 0.25, 0.75, draw);
            signals.dead[at..].fill(plan.process.dead + wish.delay);
        }
        Kind::ValveSaturation => put_stop(case, plan, signals, draw)?,
        Kind::FrictionDrift => put_friction_drift(case, plan, signals, draw),
        Kind::QuantisedPv => {
            let step = plan.noise * size(case, (3.0, 4.0), (5.0, 7.0), (8.0, 10.0), draw);
            signals.fault = Fault::Quantised { step, offset: draw.even(0.0, step) };
            signals.seen = draw.chance(0.5);
        }
        Kind::Outliers => put_outliers(case, plan, signals, draw),
        Kind::FrozenPv => put_frozen(case, plan, signals, draw)?,
        Kind::ClockSkew => put_skew(case, plan, signals, draw),
        Kind::StaticNonlinearity | Kind::SlipJump | Kind::AsymmetricFriction => {}
    }
    Some(Vec::new())
}

/// Whether an effect shows that has no size of its own in PV: by the same loop without it. `shown` is PV with it.
pub fn shows(case: &Case, with: (&Plan, &Signals), without: (&Plan, &Signals), shown: &[f64]) -> bool {
    let Some(effect) = case.effect else { return true };
    let of_loop = matches!(
        effect,
        Kind::GainChange | Kind::DeadTimeChange | Kind::StaticNonlinearity | Kind::ValveSaturation
    );
    let of_friction = matches!(effect, Kind::SlipJump | Kind::AsymmetricFriction | Kind::FrictionDrift);
    if !of_loop && !of_friction && effect != Kind::ClockSkew {
        return true;
    }
    let need = with.0.noise
        * match case.size {
            Size::Small => 0.8,
            Size::Medium => 2.5,
            Size::Large => 4.0,
        };
    let pv = |(plan, signals): (&Plan, &Signals), free| recorded_pv(signals, &run(plan, signals, free));
    let apart = |a: &[f64], b: &[f64]| rms(&a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<f64>>());
    // A cycle that slips out of step differs at all times, so the loop without friction is asked too.
    let free = of_friction || apart(&pv(with, true), &pv(without, true)) >= 0.6 * need;
    free && apart(shown, &pv(without, false)) >= need
}

/// A scan between two shares of the record.
fn moment(plan: &Plan, low: f64, high: f64, draw: &mut Draw) -> usize {
    WARM_UP + (plan.samples as f64 * draw.even(low, high)) as usize
}

/// Adds a load of unit size so that PV's deviation by `measure` becomes `target`; `None` where OP has no room.
fn add_sized(
    plan: &Plan,
    signals: &mut Signals,
    unit: &Signals,
    target: f64,
    measure: fn(&[f64]) -> f64,
) -> Option<f64> {
    let trace = run(plan, unit, true);
    let factor = target / measure(&trace.error()).max(1e-9);
    let swing = factor * peak(&trace.swing(plan.at));
    let moved = factor * peak(&trace.error());
    // A little less than asked for is taken, much less is not.
    let factor = factor * (OP_ROOM / swing).min(PV_ROOM / moved).min(1.0);
    let enough = factor * measure(&trace.error()) > 0.75 * target;
    enough.then(|| signals.add_loads(unit, factor)).map(|()| factor)
}

fn put_oscillation(case: &Case, plan: &Plan, signals: &mut Signals, draw: &mut Draw) -> Option<()> {
    let (usual, _) = Measure::new(plan, signals);
    for _ in 0..TRIES {
        let mut unit = Signals::still(plan);
        let n = unit.sp.len();
        let period = draw.log(12.0, plan.samples as f64 / 7.0);
        let (second, third) = (draw.even(0.0, 0.12), draw.even(0.0, 0.08));
        let wander = if draw.chance(0.5) { draw.even(0.1, 0.25) } else { 0.0 };
        let sway = draw.coloured(n, 4.0 * period);
        let start = draw.even(0.0, TAU);
        let wave = (0..n)
            .map(|k| {
                let phase = start + TAU * k as f64 / period;
                let shape = phase.sin() + second * (2.0 * phase).sin() + third * (3.0 * phase).cos();
                (1.0 + wander * sway[k]) * shape
            })
            .collect();
        if draw.chance(0.6) {
            unit.load_in = wave
        } else {
            unit.load_out = wave
        }
        let target = usual.pv * size(case, (0.4, 0.7), (1.0, 1.7), (2.3, 3.5), draw);
        if add_sized(plan, signals, &unit, target, rms).is_some() {
            return Some(());
        }
    }
    None
}

/// A recorded tag drives the process.
fn put_disturbance(
    case: &Case,
    plan: &Plan,
    signals: &mut Signals,
    draw: &mut Draw,
) -> Option<Vec<(String, Vec<f64>)>> {
    let (usual, _) = Measure::new(plan, signals);
    for _ in 0..TRIES {
        let mut unit = Signals::still(plan);
        let n = unit.sp.len();
        let tag = match draw.whole(0, 3) {
            0 => {
                let tau = draw.log(3.0, 60.0);
                draw.coloured(n, tau)
            }
            1 => {
                let (period, damping) = (draw.log(15.0, 90.0), draw.even(0.2, 0.5));
                draw.resonant(n, period, damping)
            }
            2 => {
                let hold = draw.log(25.0, 150.0);
                draw.steps(n, hold)
            }
            _ => {
                let (hold, ramp) = (draw.log(20.0, 80.0), draw.log(5.0, 40.0));
                draw.moves(n, hold, ramp)
            }
        };
        let delay = draw.whole(0, 8);
        let late: Vec<f64> = (0..n).map(|k| tag[k.saturating_sub(delay)]).collect();
        let path = lagged(&late, draw.log(0.8, 20.0));
        let sign = draw.sign();
        if draw.chance(0.6) {
            add(&mut unit.load_in, &path, sign);
            if draw.chance(0.3) {
                add(&mut unit.forward, &tag, -sign * draw.even(0.4, 0.8));
            }
        } else {
            add(&mut unit.load_out, &path, sign);
        }
        let target = usual.pv * size(case, (0.4, 0.7), (1.0, 1.6), (2.0, 3.0), draw);
        if add_sized(plan, signals, &unit, target, rms).is_some() {
            let (mean, unit, noise) = (draw.even(20.0, 80.0), draw.log(0.5, 10.0), draw.even(0.005, 0.04));
            let shown = Trace::recorded(&tag[..n - 1]);
            let shown = shown.iter().map(|v| mean + unit * (v + noise * draw.normal())).collect();
            return Some(vec![("upstream".to_owned(), shown)]);
        }
    }
    None
}

fn put_step(case: &Case, plan: &Plan, signals: &mut Signals, draw: &mut Draw) -> Option<()> {
    let (usual, _) = Measure::new(plan, signals);
    for _ in 0..TRIES {
        let mut unit = Signals::still(plan);
        let at = moment(plan, 0.12, 0.85, draw);
        let sign = draw.sign();
        // A level's load is a flow; a step of the level itself would be no load.
        let input = plan.process.integrating || draw.chance(0.65);
        if input {
            unit.load_in[at..].fill(sign)
        } else {
            unit.load_out[at..].fill(sign)
        }
        let target = usual.pv * size(case, (2.0, 3.0), (4.0, 6.0), (8.0, 11.0), draw);
        if add_sized(plan, signals, &unit, target, peak).is_some() {
            return Some(());
        }
    }
    None
}

/// A load or a sensor that runs away; the size is what OP must take up.
fn put_drift(case: &Case, plan: &mut Plan, signals: &mut Signals, draw: &mut Draw) {
    let (usual, _) = Measure::new(plan, signals);
    let wanted = size(case, (2.0, 3.0), (5.0, 8.0), (11.0, 16.0), draw);
    let total = (wanted * usual.op.max(1.0)).min(size(case, (8.0, 10.0), (16.0, 20.0), (26.0, 32.0), draw));
    let from = if draw.chance(0.5) { WARM_UP } else { moment(plan, 0.08, 0.5, draw) };
    let end = (WARM_UP + plan.samples) as f64;
    let sign = draw.sign();
    // OP starts on the other side of the middle, so that it ends inside the range.
    plan.at = 50.0 + sign * 0.5 * total;
    let input = plan.process.integrating || draw.chance(0.5);
    let factor = sign * total * if input { 1.0 } else { plan.process.gain };
    let load = if input { &mut signals.load_in } else { &mut signals.load_out };
    for (k, value) in load.iter_mut().enumerate().skip(from) {
        *value += factor * (k - from) as f64 / (end - from as f64);
    }
}

/// A stop that the stem meets for a part of the time.
fn put_stop(case: &Case, plan: &mut Plan, signals: &mut Signals, draw: &mut Draw) -> Option<()> {
    let wanted = size(case, (0.04, 0.08), (0.12, 0.22), (0.3, 0.42), draw);
    let mut slow = Signals::still(plan);
    let tau = draw.log(25.0, 120.0);
    slow.load_in = draw.coloured(slow.sp.len(), tau);
    let swing = draw.even(1.5, 4.0);
    let factor = scale(plan, &slow, (STOP_LOAD * plan.noise).clamp(0.5, 2.5), swing);
    signals.add_loads(&slow, factor);
    let trace = run(plan, signals, false);
    let mut stem = Trace::recorded(&trace.stem).to_vec();
    stem.sort_by(f64::total_cmp);
    let upper = draw.chance(0.5);
    let (mut near, mut far) = (stem[stem.len() / 2], if upper { stem[stem.len() - 1] } else { stem[0] });
    for _ in 0..STOP_STEPS {
        let stop = 0.5 * (near + far);
        plan.valve.stops = if upper { (0.0, stop) } else { (stop, 100.0) };
        let stopped = stopped(&run(plan, signals, true), plan);
        if (0.7 * wanted..1.4 * wanted).contains(&stopped) {
            break;
        }
        if stopped > wanted { near = stop } else { far = stop }
    }
    let trace = run(plan, signals, false);
    let plain = if case.size == Size::Small { 4.0 } else { 8.0 } * plan.noise;
    let fits = (0.6 * wanted..1.6 * wanted).contains(&stopped(&trace, plan));
    let moved = peak(&trace.error());
    (fits && (plain..STOP_ROOM).contains(&moved)).then_some(())
}

/// Share of the record in which the stem lies against a stop.
fn stopped(trace: &Trace, plan: &Plan) -> f64 {
    let (low, high) = plan.valve.stops;
    share(trace, |x| (low > 0.0 && x <= low + 1e-6) || (high < 100.0 && x >= high - 1e-6))
}

/// Friction that grows or falls steadily; its mean over the record stays.
fn put_friction_drift(case: &Case, plan: &Plan, signals: &mut Signals, draw: &mut Draw) {
    let ratio = size(case, (1.7, 1.9), (2.1, 2.5), (2.7, 3.0), draw);
    let (low, high) = (2.0 / (1.0 + ratio), 2.0 * ratio / (1.0 + ratio));
    let (start, end) = if draw.chance(0.5) { (low, high) } else { (high, low) };
    for (k, scale) in signals.friction.iter_mut().enumerate() {
        let along = (k as f64 - WARM_UP as f64) / plan.samples as f64;
        *scale = start + (end - start) * along.clamp(0.0, 1.0);
    }
}

fn put_outliers(case: &Case, plan: &Plan, signals: &mut Signals, draw: &mut Draw) {
    let (usual, _) = Measure::new(plan, signals);
    let share = size(case, (0.005, 0.008), (0.008, 0.013), (0.013, 0.02), draw);
    let height = usual.pv * size(case, (2.5, 3.5), (4.0, 6.0), (8.0, 12.0), draw);
    let off = (0..signals.sp.len())
        .map(|_| if draw.chance(share) { draw.sign() * height * draw.even(0.7, 1.4) } else { 0.0 })
        .collect();
    signals.fault = Fault::Outliers(off);
    signals.seen = draw.chance(0.5);
}

/// PV stands still in one long run or in several shorter ones, where the process moves.
fn put_frozen(case: &Case, plan: &Plan, signals: &mut Signals, draw: &mut Draw) -> Option<()> {
    let (_, trace) = Measure::new(plan, signals);
    let (runs, length) = if draw.chance(0.5) {
        (1.0, size(case, (25.0, 40.0), (50.0, 80.0), (100.0, 160.0), draw))
    } else {
        let runs = size(case, (2.0, 3.0), (3.0, 5.0), (6.0, 9.0), draw).round();
        (runs, size(case, (10.0, 16.0), (15.0, 28.0), (20.0, 40.0), draw))
    };
    let mut still = vec![false; signals.sp.len()];
    let mut placed = 0.0;
    for _ in 0..20 * TRIES {
        let length = (length * draw.even(0.8, 1.2)) as usize;
        let from = WARM_UP + 20 + draw.whole(0, plan.samples - length - 40);
        let free = !still[from - 15..from + length + 15].contains(&true);
        if free && deviation(&trace.pv[from..from + length]) > 2.0 * plan.noise {
            still[from..from + length].fill(true);
            placed += 1.0;
        }
        if placed >= runs {
            signals.fault = Fault::Frozen(still);
            signals.seen = draw.chance(0.5);
            return Some(());
        }
    }
    None
}

fn put_skew(case: &Case, plan: &Plan, signals: &mut Signals, draw: &mut Draw) {
    let most = draw.sign() * size(case, (1.6, 2.4), (3.0, 5.4), (6.0, 10.0), draw);
    let parting = draw.chance(0.5);
    let last = plan.samples as f64 - 1.0;
    let delay = (0..plan.samples)
        .map(|k| (if parting { most * k as f64 / last } else { most }).round() as isize)
        .collect();
    signals.fault = Fault::Skew(delay);
}
