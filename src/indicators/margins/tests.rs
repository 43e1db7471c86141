use super::*;
use crate::signal::Row;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};

/// Sample period (s).
const TS: f64 = 10.0;

/// A first-order process with dead time, `0.1 q^-nk / (1 - 0.9 q^-1)`.
fn process(nk: usize) -> Model {
    Model { na: 1, nb: 1, nc: 0, nk, a: vec![-0.9], b: vec![0.1], c: Vec::new(), rmse: 0.0 }
}

/// A PI controller whose integral time cancels the lag of the process: L = g q^-nk / (1 - q^-1).
fn pi(g: f64) -> [f64; 3] {
    [10.0 * g, -9.0 * g, 0.0]
}

fn margins_of(controller: [f64; 3], model: &Model) -> Margins {
    let open = OpenLoop { controller, process: model };
    crossovers(&open, 1000).expect("crossovers").margins(&open, TS)
}

/// Steps of the set point, by up to `size` from 50.
fn steps(size: f64) -> impl Fn(usize) -> f64 {
    move |k| 50.0 + size * [0.0, 1.0, -0.5, 0.5][k / 50 % 4]
}

/// A loop with a dead time of three samples; `noise` enters the process (PV).
fn simulated(q: [f64; 3], noise: f64, limits: (f64, f64), sp: impl Fn(usize) -> f64) -> Window {
    let random = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(11));
    let random: Vec<f64> = random.take(1000).collect();
    let mut window = Window { ts: TS, sp: Some((0..1000).map(&sp).collect()), ..Window::default() };
    let (mut y, mut last, mut before) = (0.0, 0.0, 0.0);
    for (k, random) in random.iter().enumerate() {
        let op = |back: usize| k.checked_sub(back).map_or(50.0, |at| window.op[at]);
        y = 0.9 * y + 0.1 * (op(3) - 50.0) + noise * random;
        let e = sp(k) - (50.0 + y);
        let next = op(1) + q[0] * e + q[1] * last + q[2] * before;
        window.op.push(next.clamp(limits.0, limits.1));
        window.pv.push(50.0 + y);
        (before, last) = (last, e);
    }
    window
}

/// Limits that OP does not reach.
const FAR: (f64, f64) = (0.0, 100.0);

#[test]
fn margins_by_hand() {
    // On the unit circle |1 - q^-1| = 2 sin(angle/2), and arg L = -90° - (nk - 1/2) angle.
    let found = margins_of(pi(0.2), &process(3));
    let near = |found: Option<f64>, want: f64| found.is_some_and(|found| (found / want - 1.0).abs() < 1e-6);
    // 90° are 5/2 of 36°, ten samples: 2 sin 18° / 0.2. Where |L| = 1 the angle is 2 asin 0.1, of which 5/2 are 28.7°.
    assert!(near(found.gain, 3.090_169_9) && near(found.phase_crossover_s, 100.0), "{found:?}");
    assert!(near(found.phase_deg, 61.304_148) && near(found.gain_crossover_s, 313.634_18), "{found:?}");
    // With one sample of delay L is negative at two samples a period alone: 2/0.5 there, and 90° - asin 0.25.
    let found = margins_of(pi(0.5), &process(1));
    assert!(near(found.gain, 4.0) && near(found.phase_crossover_s, 20.0), "{found:?}");
    assert!(near(found.phase_deg, 75.522_488), "{found:?}");
    // A loop that swings by itself has margins below 1 and 0.
    let found = margins_of(pi(0.8), &process(3));
    assert!(near(found.gain, 0.772_542_5) && found.phase_deg.is_some_and(|phase| phase < 0.0), "{found:?}");
}

#[test]
fn a_controller_without_noise_is_recovered_exactly_and_so_are_its_margins() {
    for q in [pi(0.2), [1.4, -1.6, 0.3]] {
        let window = simulated(q, 0.0, FAR, steps(2.0));
        let found = controller(&window, Some(FAR)).expect("it explains OP");
        assert!(found.iter().zip(q).all(|(found, q)| (found - q).abs() < 1e-8), "{found:?}");
        let found = margins(&window, None, &process(3)).expect("it moves");
        let want = margins_of(q, &process(3));
        for (found, want) in [(found.gain, want.gain), (found.phase_deg, want.phase_deg)] {
            assert!(found.zip(want).is_some_and(|(found, want)| (found - want).abs() < 1e-5), "{want:?}");
        }
    }
}

#[test]
fn rows_at_a_limit_and_rows_that_were_filled_in_say_nothing_of_the_controller() {
    let limits = (48.0, 52.0);
    let mut window = simulated(pi(0.2), 0.0, limits, steps(2.0));
    let is_exact = |q: Option<[f64; 3]>| {
        q.is_some_and(|q| q.iter().zip(pi(0.2)).all(|(found, q)| (found - q).abs() < 1e-6))
    };
    assert!(is_exact(controller(&window, Some(limits))));
    assert!(!is_exact(controller(&window, None)), "at a limit OP is not what the controller wants");
    window.rows = vec![Row::Counts; window.len()];
    for k in 500..520 {
        (window.rows[k], window.pv[k]) = (Row::Missing, 0.0);
    }
    assert!(is_exact(controller(&window, Some(limits))));
    window.rows.clear();
    assert!(!is_exact(controller(&window, Some(limits))));
}

#[test]
fn an_op_that_is_moved_by_hand_is_no_controller() {
    let mut window = simulated(pi(0.2), 0.1, FAR, steps(2.0));
    assert!(controller(&window, None).is_some());
    window.op = (0..window.len()).map(|k| 50.0 + [0.0, 3.0, -2.0][k / 40 % 3]).collect();
    assert_eq!(controller(&window, None), None);
    window.op = vec![50.0; window.len()];
    assert_eq!(controller(&window, None), None, "nor is one that stands still");
    assert_eq!(margins(&window, None, &process(3)), None);
}

#[test]
fn a_tight_loop_has_its_true_margins() {
    let window = simulated(pi(0.5), 0.1, FAR, steps(2.0));
    let found = margins(&window, Some(FAR), &process(3)).expect("the set point moves");
    assert!(found.gain.is_some_and(|gain| (gain - 1.236_07).abs() < 1e-3), "{found:?}");
    assert!(found.phase_deg.is_some_and(|phase| (phase - 17.612).abs() < 0.05), "{found:?}");
    assert_eq!(found.tuned(), Tuned::Tightly);
    assert_eq!(found.words(), "gain margin 1.2, phase margin 18°");
}

#[test]
fn feedback_alone_tells_no_margins() {
    // The inverse of the controller, which a fit may find for the process: L = -1.
    let [q0, q1, _] = pi(0.2);
    let inverse = Model { na: 1, nb: 2, nk: 0, a: vec![q1 / q0], b: vec![-1.0 / q0, 1.0 / q0], ..process(0) };
    // Without a set point, with one that rests, and with one that moves less than chance has it.
    let dither = |k: usize| 50.0 + 1e-5 * ((k * k) as f64 * 0.7).sin();
    let resting = simulated(pi(0.2), 0.1, FAR, |_| 50.0);
    let without = Window { sp: None, ..resting.clone() };
    for window in [resting, without, simulated(pi(0.2), 0.1, FAR, dither)] {
        for model in [&process(3), &inverse] {
            assert_eq!(margins(&window, None, model), None);
        }
    }
    assert!(margins(&simulated(pi(0.2), 0.1, FAR, steps(2.0)), None, &process(3)).is_some());
}

#[test]
fn rubbish_has_no_margins() {
    let window = simulated(pi(0.2), 0.1, FAR, steps(2.0));
    for broken in [f64::NAN, f64::INFINITY] {
        let model = Model { b: vec![broken], ..process(3) };
        assert_eq!(margins(&window, None, &model), None);
        let window = Window { pv: vec![broken; window.len()], ..window.clone() };
        assert_eq!(margins(&window, None, &process(3)), None);
    }
    assert_eq!(margins(&Window::default(), None, &process(3)), None);
    let short = window.slice(0, 60);
    assert_eq!(margins(&short, None, &process(3)), None);
}

#[test]
fn usual_margins_are_neither_tight_nor_loose_and_a_margin_that_is_not_there_is_large() {
    let of = |gain, phase_deg| Margins { gain, phase_deg, ..Margins::default() }.tuned();
    for (gain, phase_deg, want) in [
        (Some(1.9), Some(45.0), Tuned::Tightly),
        (Some(3.0), Some(29.0), Tuned::Tightly),
        (None, Some(-5.0), Tuned::Tightly),
        (Some(2.0), Some(30.0), Tuned::Usually),
        (Some(3.0), Some(75.0), Tuned::Usually),
        (Some(9.0), Some(60.0), Tuned::Usually),
        (Some(5.1), Some(61.0), Tuned::Loosely),
        (None, Some(90.0), Tuned::Loosely),
        (Some(12.0), None, Tuned::Loosely),
    ] {
        assert_eq!(of(gain, phase_deg), want, "{gain:?} {phase_deg:?}");
    }
    let words = |gain, phase_deg| Margins { gain, phase_deg, ..Margins::default() }.words();
    assert_eq!(words(None, Some(-0.0)), "phase margin 0°");
    assert_eq!(words(Some(9.0), None), "gain margin 9.0");
    assert_eq!(words(Some(1.96), Some(30.2)), "gain margin 1.96, phase margin 30.2°");
    assert_eq!(words(Some(1.04), Some(0.3)), "gain margin 1.04, phase margin 0.3°");
    assert_eq!(Margins::usual(), "usual are 2 to 5 and 30° to 60°");
}
