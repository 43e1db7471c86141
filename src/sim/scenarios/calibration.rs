//! Loops that cycle because of their valve and of nothing else: the coverage of f's interval is checked on them.

use super::draw::{
    Base, HALF_CYCLE, LAST, N, REVERSALS, WARM_UP, chance, draw_loop, generator, inside_limits, log_uniform,
    sd, sticking, uniform,
};
use super::{Scenario, Truth, reverses_beyond};
use crate::sim::load::{Load, LoadKind};
use crate::sim::plant::simulate;
use crate::sim::sensor::SensorSpec;
use rand_pcg::Pcg64Mcg;

/// J as a share of S, in turn by seed.
const JUMPS: [f64; 4] = [0.0, 0.2, 0.5, 1.0];
/// Longest dead time (samples).
const MAX_DEAD: f64 = 4.0;
const ATTEMPTS: usize = 2000;

/// A flow, level, pressure or temperature loop that cycles because of S: Choudhury's or Kano's valve, S 0.3 to 8 %,
/// J = 0, S/5, S/2 or S by `seed % 4`, dead time 0 to 4 samples, PV noise of 2 to 20 % of the sd of the PV cycle,
/// coloured load of 1 to 5 % of S. OP reverses by more than S at least six times in the last 1,000 samples, with
/// and without the noise; draws until that is so.
pub fn calibration(seed: u64) -> Scenario {
    let mut rng = generator(seed, 4);
    let jump = JUMPS[(seed % JUMPS.len() as u64) as usize];
    for _ in 1..ATTEMPTS {
        let (scenario, cycles) = draw(&mut rng, seed, jump);
        if cycles {
            return scenario;
        }
    }
    // A test counts how often no draw cycles: never in its seeds.
    draw(&mut rng, seed, jump).0
}

/// One draw, and whether it cycles with and without its noise.
fn draw(rng: &mut Pcg64Mcg, seed: u64, jump: f64) -> (Scenario, bool) {
    let s = log_uniform(rng, 0.3, 8.0);
    let j = s * jump;
    let (model, friction) = sticking(rng, s, j);
    let Base { name, mut spec, pace } = draw_loop(rng, friction, MAX_DEAD);
    // A step of at least S gets the valve off its first stuck point.
    spec.sp = spec.pv0 + uniform(rng, 1.0, 2.0) * s * if chance(rng, 0.5) { 1.0 } else { -1.0 };
    spec.loads.push(Load::input(LoadKind::Coloured {
        sd: s * log_uniform(rng, 0.01, 0.05),
        tau_s: spec.ts_s * pace * log_uniform(rng, 1.0, 10.0),
    }));
    let noise_share = log_uniform(rng, 0.02, 0.2);
    let mut cycles = true;
    let mut at_work = |spec: &_| {
        let run = simulate(spec, N, seed).ok()?;
        let reversals = reverses_beyond(&run.op[N - LAST..], s);
        cycles &= inside_limits(spec, &run) && (REVERSALS..=LAST / HALF_CYCLE).contains(&reversals);
        Some(sd(&run.after(WARM_UP).pv))
    };
    // Without noise first, to know the cycle that the noise is measured against.
    let cycle_sd = at_work(&spec).unwrap_or(0.0);
    spec.sensor = SensorSpec::noisy(noise_share * cycle_sd);
    at_work(&spec);
    let kind = format!("{name}, {model}, J = {jump} S, noise {noise_share:.3} of the cycle");
    let truth = Truth { sticky: true, s, j, kind };
    let scenario = Scenario { spec, truth, seed, n: N, warm_up: WARM_UP };
    (scenario, cycles && cycle_sd > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::valve::Friction;
    use std::collections::BTreeMap;

    #[test]
    fn every_loop_cycles_because_of_its_valve() {
        let mut kinds: BTreeMap<String, usize> = BTreeMap::new();
        for seed in 0..200 {
            let scenario = calibration(seed);
            let run = scenario.run().expect("drawn loops are valid");
            let last = &run.op[run.op.len() - LAST..];
            assert!(reverses_beyond(last, scenario.truth.s) >= REVERSALS, "{seed}");
            // With a sound valve and without the noise, the same loop under the same load comes to rest.
            let mut sound = scenario.clone();
            sound.spec.valve.friction = Friction::Ideal;
            sound.spec.sensor = SensorSpec::default();
            let rest = sound.run().expect("drawn loops are valid");
            let still = &rest.op[rest.op.len() - LAST..];
            assert!(sd(still) < 0.5 * sd(last), "{seed}: {}", scenario.truth.kind);
            for word in scenario.truth.kind.split(", ").take(3) {
                *kinds.entry(word.to_owned()).or_default() += 1;
            }
        }
        println!("{kinds:?}");
        // Every class, both models and each J are met at least ten times in 200.
        for word in ["flow", "pressure", "level", "temperature", "Kano", "Choudhury"] {
            assert!(kinds.get(word).is_some_and(|&n| n >= 10), "{word}: {kinds:?}");
        }
        assert!(JUMPS.iter().all(|j| kinds.get(&format!("J = {j} S")) == Some(&50)));
    }

    #[test]
    fn the_same_seed_gives_the_same_record() {
        assert_eq!(calibration(17).run(), calibration(17).run());
        assert_ne!(calibration(17).run(), calibration(21).run());
    }
}
