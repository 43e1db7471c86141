//! What the plant-wide pass costs: 500, 2,000 and 8,000 loops of a day at one minute, every fifth with a period of its own, every
//! third with another's output as its set point.
//!
//! Wall time and processor time are the same where the machine has a core to spare.

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::TAU;
use std::time::Instant;
use stictiond_numerics::plantwide::{PlantLoop, analyse, tasks};
use stictiond_numerics::signal::Window;

fn main() {
    for n in [500_usize, 2_000, 8_000] {
        let mut plant: Vec<PlantLoop> = (0..n).map(one).collect();
        for slave in (1..n).step_by(3) {
            plant[slave].window.sp =
                Some(plant[slave - 1].window.op.iter().map(|u| 0.5 * u - 25.0).collect());
        }
        let begin = Instant::now();
        let found = analyse(&plant);
        let todo = tasks(&found).len();
        let swinging = found.loops.iter().filter(|of| !of.oscillations.is_empty()).count();
        let cascades = found.loops.iter().filter(|of| of.master.is_some()).count();
        let took = begin.elapsed().as_secs_f64();
        println!(
            "{n} loops: {took:.2} s, {:.2} ms a loop, {swinging} oscillate, {} groups, {cascades} cascades, {todo} tasks",
            1e3 * took / n as f64,
            found.groups.len()
        );
    }
}

fn one(i: usize) -> PlantLoop {
    let mut draw = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(i as u64));
    let mut next = || -> f64 { draw.next().unwrap_or(0.0) };
    let period = 8.0 + 50.0 * next().abs();
    let mut x = 0.0;
    let pv: Vec<f64> = (0..1440)
        .map(|k| {
            x = 0.9 * x + next();
            x + if i.is_multiple_of(5) { 6.0 * (TAU * f64::from(k) / period).sin() } else { 0.0 }
        })
        .collect();
    let op = pv.iter().map(|y| 50.0 - y).collect();
    PlantLoop {
        name: format!("FIC{i}"),
        window: Window { ts: 60.0, op, pv, ..Window::default() },
        op_limits: Some((0.0, 100.0)),
        ..PlantLoop::default()
    }
}
