//! Random loops, wide on purpose: what a diagnosis may meet in a plant.

use super::draw::{
    Base, HALF_CYCLE, LAST, N, REVERSALS, WARM_UP, chance, draw_loop, generator, inside_limits, log_uniform,
    sd, sticking, uniform,
};
use super::{Scenario, Truth, reverses_beyond};
use crate::sim::load::{Load, LoadKind};
use crate::sim::plant::{LoopSpec, simulate};
use crate::sim::sensor::SensorSpec;
use crate::sim::valve::{Friction, ValveSpec};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use std::f64::consts::TAU;

const ATTEMPTS: usize = 400;
/// Longest dead time (samples).
const MAX_DEAD: f64 = 8.0;
/// Share of the noisy loops whose noise is heavy: as large as a third of the cycle and more.
const HEAVY: f64 = 0.15;

/// The kinds of [`random_sound`], in turn by seed.
pub const SOUND_KINDS: [&str; 11] = [
    "noise only",
    "coloured load",
    "random walk load",
    "sinusoidal load",
    "square load",
    "triangular load",
    "drifting oscillating load",
    "tight tuning",
    "saturation limit cycle",
    "set-point changes",
    "load steps",
];

/// A loop whose valve sticks (or has a dead band only) and whose OP reverses by more than S at least six times in
/// the last 1,000 samples; draws until that is so.
///
/// Flow, pressure, level or temperature; dead time 0 to 8 samples; S 0.3 to 8 %, J from 0 to S; sluggish to tight
/// PI; PV noise from none to 0.6 of the cycle's sd; quiet or with a load; constant or changing set point.
pub fn random_sticky(seed: u64) -> Scenario {
    let mut rng = generator(seed, 1);
    let mut best: Option<(usize, Scenario)> = None;
    for _ in 0..ATTEMPTS {
        let scenario = draw_sticky(&mut rng, seed);
        let Ok(run) = scenario.run() else { continue };
        let last = &run.op[run.op.len() - LAST..];
        let reversals = reverses_beyond(last, scenario.truth.s);
        let inside = inside_limits(&scenario.spec, &run);
        if inside && (REVERSALS..=LAST / HALF_CYCLE).contains(&reversals) {
            return scenario;
        }
        let score = if inside { reversals.min(REVERSALS - 1) } else { 0 };
        if best.as_ref().is_none_or(|(most, _)| score > *most) {
            best = Some((score, scenario));
        }
    }
    // A test counts how often even the best draw does not cycle: never in its seeds.
    best.map_or_else(|| draw_sticky(&mut rng, seed), |(_, scenario)| scenario)
}

/// A loop whose valve is sound, of the kind `SOUND_KINDS[seed % 11]`.
pub fn random_sound(seed: u64) -> Scenario {
    let mut rng = generator(seed, 2);
    let kind = SOUND_KINDS[(seed % SOUND_KINDS.len() as u64) as usize];
    let base = draw_loop(&mut rng, Friction::Ideal, MAX_DEAD);
    let name = base.name;
    let spec = sound_spec(&mut rng, base, kind);
    let truth = Truth { sticky: false, s: 0.0, j: 0.0, kind: format!("{name}, {kind}") };
    Scenario { spec, truth, seed, n: N, warm_up: WARM_UP }
}

fn draw_sticky(rng: &mut Pcg64Mcg, seed: u64) -> Scenario {
    let (strength, s) = match rng.random_range(0..3) {
        0 => ("weak", log_uniform(rng, 0.3, 1.0)),
        1 => ("medium", log_uniform(rng, 1.0, 3.0)),
        _ => ("strong", log_uniform(rng, 3.0, 8.0)),
    };
    let deadband_only = chance(rng, 0.2);
    let j = if deadband_only { 0.0 } else { s * uniform(rng, 0.02, 1.0) };
    let noise_share = if chance(rng, 0.35) { 0.0 } else { noise_share(rng) };
    let (model, friction) = sticking(rng, s, j);
    let Base { name, mut spec, pace } = draw_loop(rng, friction, MAX_DEAD);
    // A step of at least S gets the valve off its first stuck point.
    spec.sp = spec.pv0 + uniform(rng, 1.0, 2.0) * s * if chance(rng, 0.5) { 1.0 } else { -1.0 };
    let load = sticky_load(rng, &mut spec, s, pace, deadband_only);
    let sp_changes = chance(rng, 0.25);
    if sp_changes {
        let count = rng.random_range(1..=3);
        set_point_changes(rng, &mut spec, count, 2.0 * s);
    }
    if noise_share > 0.0 {
        // Without noise first, to know the cycle that the noise is measured against.
        if let Ok(quiet) = simulate(&spec, N, seed) {
            spec.sensor = SensorSpec::noisy(noise_share * sd(&quiet.after(WARM_UP).pv));
        }
    }
    let kind = format!(
        "{name}, {model}, {}{strength}, {load}, noise {noise_share:.3} of the cycle{}",
        if deadband_only { "dead band only, " } else { "" },
        if sp_changes { ", set-point changes" } else { "" },
    );
    Scenario { spec, truth: Truth { sticky: true, s, j, kind }, seed, n: N, warm_up: WARM_UP }
}

/// PV noise sd as a share of the cycle's.
fn noise_share(rng: &mut Pcg64Mcg) -> f64 {
    if chance(rng, HEAVY) { uniform(rng, 0.3, 0.6) } else { log_uniform(rng, 0.003, 0.3) }
}

/// None, or noise at the process input; a dead band in a self-regulating loop needs one large enough to make OP
/// cross it.
fn sticky_load(
    rng: &mut Pcg64Mcg,
    spec: &mut LoopSpec,
    s: f64,
    pace: f64,
    deadband_only: bool,
) -> &'static str {
    let driven = deadband_only && !spec.process.kind.is_integrating();
    let tau_s = spec.ts_s * pace * log_uniform(rng, 1.0, 10.0);
    let size = if driven { uniform(rng, 1.0, 3.0) } else { log_uniform(rng, 0.03, 0.5) };
    match rng.random_range(0..6) {
        0..=2 if !driven => "no load",
        3 if !driven => {
            let sd_per_root_s = 0.2 * size * s / (100.0 * spec.ts_s).sqrt();
            spec.loads.push(Load::input(LoadKind::RandomWalk { sd_per_root_s }));
            "random walk load"
        }
        _ => {
            spec.loads.push(Load::input(LoadKind::Coloured { sd: size * s, tau_s }));
            "coloured load"
        }
    }
}

/// `count` changes of up to `size` at random times.
fn set_point_changes(rng: &mut Pcg64Mcg, spec: &mut LoopSpec, count: usize, size: f64) {
    let slot = N as f64 * spec.ts_s / count as f64;
    for i in 0..count {
        let at = slot * (i as f64 + uniform(rng, 0.2, 0.9));
        let sp = spec.pv0 + uniform(rng, -size, size);
        spec.sp_schedule.push((at, sp));
    }
}

fn sound_spec(rng: &mut Pcg64Mcg, base: Base, kind: &str) -> LoopSpec {
    let Base { mut spec, pace, .. } = base;
    let ts = spec.ts_s;
    let amplitude = log_uniform(rng, 0.5, 8.0);
    let period_s = ts * pace * log_uniform(rng, 4.0, 40.0).max(12.0 / pace);
    let phase = uniform(rng, 0.0, TAU);
    // An integrating level under a lasting input load swings far: there the load enters at the output.
    let enter =
        if spec.process.kind.is_integrating() || chance(rng, 0.5) { Load::output } else { Load::input };
    let noise = if chance(rng, 0.25) { 0.0 } else { noise_share(rng) };
    // Some colour under every kind: no real loop has none.
    let background =
        LoadKind::Coloured { sd: 0.05 * amplitude, tau_s: ts * pace * log_uniform(rng, 1.0, 10.0) };
    let mut noise_sd = noise * amplitude;
    match kind {
        "noise only" => noise_sd = log_uniform(rng, 0.02, 2.0),
        "coloured load" => {
            let tau_s = ts * pace * log_uniform(rng, 1.0, 20.0);
            spec.loads.push(Load::input(LoadKind::Coloured { sd: amplitude, tau_s }));
        }
        "random walk load" => {
            let sd_per_root_s = 0.2 * amplitude / (100.0 * ts).sqrt();
            spec.loads.push(Load::input(LoadKind::RandomWalk { sd_per_root_s }));
        }
        "sinusoidal load" | "drifting oscillating load" => {
            let growth_per_s =
                if kind.starts_with("drifting") { uniform(rng, -0.45, 2.0) / (N as f64 * ts) } else { 0.0 };
            spec.loads.push(enter(LoadKind::Sine { amplitude, period_s, phase, growth_per_s }));
        }
        "square load" => spec.loads.push(enter(LoadKind::Square { amplitude, period_s })),
        "triangular load" => spec.loads.push(enter(LoadKind::Triangle { amplitude, period_s })),
        "tight tuning" => {
            spec.controller.gain *= ultimate(&spec) * uniform(rng, 0.85, 0.97);
            noise_sd = log_uniform(rng, 0.02, 0.3);
        }
        "saturation limit cycle" => {
            spec.controller.gain *= ultimate(&spec) * uniform(rng, 1.05, 1.4);
            let half = uniform(rng, 5.0, 25.0);
            let limits = (spec.op0 - half, spec.op0 + half);
            // Either OP is limited by the controller, or the stem by its travel.
            if chance(rng, 0.5) {
                spec.controller.op_limits = limits;
            } else {
                spec.valve.travel = limits;
            }
            spec.sp += 0.5;
            noise_sd *= 0.1;
        }
        "set-point changes" => {
            let count = rng.random_range(2..=8);
            set_point_changes(rng, &mut spec, count, amplitude);
        }
        _ => {
            for _ in 0..rng.random_range(2..=6) {
                let at_s = uniform(rng, 0.0, N as f64 * ts);
                let size = uniform(rng, -amplitude, amplitude);
                spec.loads.push(Load::input(LoadKind::Step { at_s, size }));
            }
        }
    }
    if chance(rng, 0.5) {
        spec.loads.push(Load::input(background));
    }
    spec.sensor = SensorSpec::noisy(noise_sd);
    spec
}

/// The factor on the gain at which the quiet linear loop stops dying out, by bisection on its simulation.
fn ultimate(spec: &LoopSpec) -> f64 {
    let quiet = |factor: f64| {
        let mut linear = spec.clone();
        linear.loads.clear();
        linear.controller.gain *= factor;
        linear.controller.op_limits = (f64::NEG_INFINITY, f64::INFINITY);
        linear.valve =
            ValveSpec { travel: (f64::NEG_INFINITY, f64::INFINITY), ..ValveSpec::linear(Friction::Ideal) };
        linear.sp = linear.pv0 + 1.0;
        simulate(&linear, 1200, 0).is_ok_and(|run| {
            let swing = |part: &[f64]| part.iter().map(|y| (y - linear.sp).abs()).fold(0.0, f64::max);
            // A loop that has come to rest has died out, whatever its last roundings do.
            swing(&run.pv[900..]) < swing(&run.pv[300..600]).max(1e-9)
        })
    };
    let (mut stable, mut unstable) = (0.2_f64, 40.0_f64);
    for _ in 0..24 {
        let middle = (stable * unstable).sqrt();
        if quiet(middle) {
            stable = middle;
        } else {
            unstable = middle;
        }
    }
    stable
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::controller::ControllerSpec;
    use crate::sim::process::{ProcessKind, ProcessSpec};
    use std::collections::BTreeMap;

    #[test]
    fn sticky_loops_reverse_beyond_s() {
        let mut kinds: BTreeMap<String, usize> = BTreeMap::new();
        let mut cycling = 0;
        for seed in 0..200 {
            let scenario = random_sticky(seed);
            let run = scenario.run().expect("random loops are valid");
            let reversals = reverses_beyond(&run.op[500..], scenario.truth.s);
            cycling += usize::from(reversals >= 4);
            for word in scenario.truth.kind.split(", ").filter(|w| !w.starts_with("noise")) {
                *kinds.entry(word.to_owned()).or_default() += 1;
            }
            let noise = scenario.spec.sensor.noise_sd;
            *kinds.entry(format!("noise {}", noise > 0.0)).or_default() += 1;
            let dead = (scenario.spec.process.dead_time_s / scenario.spec.ts_s).ceil();
            *kinds.entry(format!("dead time {dead}")).or_default() += 1;
            assert!(run.pv.iter().chain(&run.op).all(|x| x.is_finite()));
        }
        println!("{cycling} of 200 reverse beyond S at least 4 times in 1000 samples; {kinds:?}");
        assert_eq!(cycling, 200);
        // Every loop class, valve model, strength and load is met at least ten times in 200.
        for word in
            ["flow", "pressure", "level", "temperature", "Kano", "Choudhury", "weak", "medium", "strong"]
        {
            assert!(kinds.get(word).is_some_and(|&n| n >= 10), "{word}: {kinds:?}");
        }
        for word in [
            "dead band only",
            "no load",
            "coloured load",
            "random walk load",
            "set-point changes",
            "dead time 0",
            "dead time 8",
        ] {
            assert!(kinds.get(word).is_some_and(|&n| n >= 10), "{word}: {kinds:?}");
        }
    }

    #[test]
    fn sound_loops_stay_finite_and_their_stems_follow() {
        for seed in 0..220 {
            let scenario = random_sound(seed);
            let run = scenario.run().expect("random loops are valid");
            assert!(run.pv.iter().all(|x| x.abs() < 1e3), "{}", scenario.truth.kind);
            let (low, high) = scenario.spec.valve.travel;
            assert!(run.op.iter().zip(&run.mv).all(|(op, mv)| *mv == op.max(low).min(high)));
            assert!(sd(&run.op) > 0.0, "{}", scenario.truth.kind);
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_record() {
        for make in [random_sticky, random_sound] {
            assert_eq!(make(17).run(), make(17).run());
            assert_ne!(make(17).run(), make(28).run());
        }
    }

    #[test]
    fn ultimate_gain_of_a_sampled_integrator() {
        // y[k+1] = y[k] + 0.1 u[k-1] under P control: stable up to Kc 0.1 = 1 (double root on the unit circle at ±60°).
        let mut base = draw_loop(&mut generator(3, 3), Friction::Ideal, MAX_DEAD).spec;
        base.ts_s = 1.0;
        base.process = ProcessSpec { kind: ProcessKind::Integrating { rate: 0.1 }, dead_time_s: 1.0 };
        base.controller = ControllerSpec::pi(1.0, f64::INFINITY);
        // 1 %: at the bound the swings of both stretches hardly differ.
        assert!((ultimate(&base) / 10.0 - 1.0).abs() < 0.01);
    }
}
