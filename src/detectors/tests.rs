//! The methods on signals made by hand, on the numbers and pictures of their own papers, and on anything at all.

use super::facts::Facts;
use super::*;
use crate::diagnosis::prepare::decimate;
use crate::sim::scenarios::{table2, table2_loop};
use crate::sim::{Friction, LoopSpec, Run, simulate};
use proptest::prelude::*;
use std::f64::consts::TAU;

/// Samples of a period of the hand-made signals, and how many periods.
const PERIOD: usize = 60;
const PERIODS: usize = 16;

/// One period of a wave over its phase (0..1).
type Wave = fn(f64) -> f64;

fn sine(phase: f64) -> f64 {
    (TAU * phase).sin()
}

fn triangle(phase: f64) -> f64 {
    let phase = phase.rem_euclid(1.0);
    if phase < 0.25 {
        4.0 * phase
    } else if phase < 0.75 {
        2.0 - 4.0 * phase
    } else {
        4.0 * phase - 4.0
    }
}

fn square(phase: f64) -> f64 {
    if phase.rem_euclid(1.0) < 0.5 { 1.0 } else { -1.0 }
}

/// OP and PV as waves, PV shifted by so much of a period; half a sample off, so that no sample lies on a corner.
fn window(op: Wave, pv: Wave, shift: f64) -> Window {
    let of = |wave: Wave, shift: f64| -> Vec<f64> {
        (0..PERIOD * PERIODS).map(|k| wave((k as f64 + 0.5) / PERIOD as f64 + shift)).collect()
    };
    Window { ts: 1.0, op: of(op, 0.0), pv: of(pv, shift), ..Window::default() }
}

fn says(method: Method, window: &Window, integrates: bool) -> Opinion {
    opinion(method, &Facts::new(window, Some(integrates)).expect("the signals move"))
}

fn of_run(run: &Run) -> Window {
    Window { ts: run.ts, op: run.op.clone(), pv: run.pv.clone(), ..Window::default() }
}

/// A valve that sticks in a fast self-regulating loop: OP rises while PV is low, until the valve slips and PV is high.
fn sticking() -> Window {
    window(triangle, square, 0.75)
}

/// A load in a self-regulating loop: OP and PV half a period apart.
fn loaded() -> Window {
    window(sine, sine, 0.5)
}

#[test]
fn horch_1999_odd_and_even() {
    // Horch 1999, figures of odd and even correlation: square PV behind a triangular OP, and a load.
    let odd = says(Method::Horch1999, &sticking(), false);
    assert_eq!(odd.says, Says::Sticks, "{odd:?}");
    assert!(odd.index.is_some_and(|index| index > 0.95), "{odd:?}");
    let even = says(Method::Horch1999, &loaded(), false);
    assert_eq!(even.says, Says::Sound, "{even:?}");
    assert!(even.index.is_some_and(|index| index < 0.05), "{even:?}");
    assert_eq!(says(Method::Horch1999, &sticking(), true).says, Says::CannotTell);
}

#[test]
fn horch_1999_published_limits_are_phases_of_30_and_60_degrees() {
    // Horch 1999: 0.072 = (2 - √3)/(2 + √3) with 1/3, and 1/3 with 2/3.
    for (degrees, height, time) in
        [(30.0, (2.0 - 3.0_f64.sqrt()) / (2.0 + 3.0_f64.sqrt()), 1.0 / 3.0), (60.0, 1.0 / 3.0, 2.0 / 3.0)]
    {
        let window = window(sine, sine, 0.5 - degrees / 360.0);
        let found = horch1999::shape(&window.op, &window.pv, PERIOD as f64).expect("crosses zero");
        // The sums of unequal lengths lean by a lag over the record's length: 1/16 of a period in the record.
        assert!((found.by_height - height).abs() < 0.03, "{found:?}");
        assert!((found.by_time - time).abs() < 0.03, "{found:?}");
    }
}

#[test]
fn horch_2000_one_hump_or_two() {
    // Horch 2000, picture of the level loops: the second derivative of a triangle has one hump, that of a sine two.
    let humps = |wave| says(Method::Horch2000, &window(sine, wave, 0.3), true);
    assert_eq!(humps(triangle).says, Says::Sticks);
    assert_eq!(humps(sine).says, Says::Sound);
    assert_eq!(says(Method::Horch2000, &sticking(), false).says, Says::CannotTell);
}

#[test]
fn yamashita_by_hand() {
    // IS IS II: two sticking samples that end as a slip does. IS DD: one that ends as no stem could. Two of SS do not count.
    let u = [1, 1, 1, 1, -1, 0, 0];
    let x = [0, 0, 1, 0, -1, 0, 0];
    let found = yamashita2006::shares(&u, &x).expect("moves");
    assert!(
        [found.rho_1 - 0.6, found.rho_2 - 0.4, found.rho_3 - 0.4].iter().all(|off| off.abs() < 1e-12),
        "{found:?}"
    );
}

#[test]
fn yamashita_published_threshold_is_what_unrelated_signals_give() {
    // Yamashita 2006: 0.25, two of the eight states other than SS, for OP and stem without any relation.
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    let mut draw = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(5));
    let mut walk = || -> Vec<f64> {
        let mut at = 0.0;
        (0..40_000)
            .map(|_| {
                let step: f64 = draw.next().unwrap_or(0.0);
                at += step;
                at
            })
            .collect()
    };
    let (u, x) = (walk(), walk());
    let found = yamashita2006::shares(&yamashita2006::symbols(&u, 1), &yamashita2006::symbols(&x, 1));
    // 36,000 states: the standard error is 0.0023.
    assert!(found.is_some_and(|found| (found.rho_1 - 0.25).abs() < 0.01), "{found:?}");
    // The stem slips before OP turns: two samples, one step of the symbols.
    let ahead = window(triangle, square, 0.75 + 2.0 / PERIOD as f64);
    let sticks = says(Method::Yamashita2006, &ahead, false);
    assert_eq!(sticks.says, Says::Sticks, "{sticks:?}");
    assert!(sticks.index.is_some_and(|index| index > 0.85), "{sticks:?}");
    assert_eq!(says(Method::Yamashita2006, &loaded(), false).says, Says::Sound);
    // A process with a negative gain is the mirror image, and so is a valve that opens without air.
    for window in [ahead, loaded()] {
        let own = says(Method::Yamashita2006, &window, false);
        let pv: Vec<f64> = window.pv.iter().map(|y| -y).collect();
        for mv in [None, Some(pv.clone())] {
            let turned = Window { pv: pv.clone(), mv, ..window.clone() };
            let found = says(Method::Yamashita2006, &turned, false);
            assert_eq!((found.says, found.index), (own.says, own.index), "{found:?}");
        }
    }
}

#[test]
fn kano_parallelogram() {
    // Kano 2004, picture of OP against stem: a dead band of 0.5 draws a parallelogram with that side.
    let mut held = sticking();
    held.op = window(sine, sine, 0.0).op;
    let mut stem = 0.0;
    held.pv = held
        .op
        .iter()
        .map(|u| {
            stem = f64::clamp(stem, u - 0.25, u + 0.25);
            stem
        })
        .collect();
    let b = says(Method::Kano2004B, &held, false);
    assert_eq!(b.says, Says::Sticks, "{b:?}");
    // One step of the grid is OP's range over 40.
    assert!(b.quantity.is_some_and(|q| (q.value - 0.5).abs() < 0.05), "{b:?}");
    let a = says(Method::Kano2004A, &sticking(), false);
    assert_eq!(a.says, Says::Sticks, "{a:?}");
    // PV stands still while OP goes from one end of its range of 2 to the other.
    assert!(a.quantity.is_some_and(|q| (q.value - 2.0).abs() < 0.3), "{a:?}");
    for method in [Method::Kano2004A, Method::Kano2004B] {
        assert_ne!(says(method, &loaded(), false).says, Says::Sticks);
    }
}

#[test]
fn he_sine_and_triangle() {
    // He 2007: SI is 1 for a triangle and 0 for a sine, of OP where the process follows, of PV where it integrates.
    let index = |op, pv, integrates| says(Method::He2007, &window(op, pv, 0.25), integrates).index;
    for (op, pv, integrates) in [(triangle as Wave, sine as Wave, false), (sine, triangle, true)] {
        assert!(index(op, pv, integrates).is_some_and(|si| si > 0.98));
    }
    for (op, pv, integrates) in [(sine as Wave, triangle as Wave, false), (triangle, sine, true)] {
        assert!(index(op, pv, integrates).is_some_and(|si| si < 0.02));
    }
}

#[test]
fn choudhury_coupled_and_uncoupled_waves() {
    // Kim & Powers 1979, the example every paper on bicoherence repeats: waves whose phases add up have bic² 1 at their
    // frequencies, and waves of independent phases have none.
    use rand::{RngExt, SeedableRng};
    let (segment, segments) = (64, 64);
    for coupled in [true, false] {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(9);
        let mut v = Vec::new();
        for _ in 0..segments {
            let phase: [f64; 3] = std::array::from_fn(|_| TAU * rng.random::<f64>());
            let third = if coupled { phase[0] + phase[1] } else { phase[2] };
            for k in 0..segment {
                let turn = |bins: f64| TAU * bins * f64::from(k) / f64::from(segment);
                let noise = 0.02 * (rng.random::<f64>() - 0.5);
                v.push(
                    (turn(7.0) + phase[0]).cos()
                        + (turn(12.0) + phase[1]).cos()
                        + (turn(19.0) + third).cos()
                        + noise,
                );
            }
        }
        let found = choudhury2006::indices(&v, segment as usize).expect("long enough");
        if coupled {
            assert!(found.largest > 0.5, "{found:?}");
            assert!(found.nli > choudhury2006::LEAST_NLI && found.ngi > choudhury2006::BY_NGI.sticks);
        } else {
            assert!(found.largest < 0.5, "{found:?}");
        }
    }
}

#[test]
fn choudhury_width_of_an_ellipse() {
    // The ellipse u = 3 cos, y = 2 cos(. + 1): along u it is 2 * 3 sin 1 wide, by its moments and by its branches.
    let turn = |k: usize| TAU * k as f64 / 997.0;
    let u: Vec<f64> = (0..997).map(|k| 3.0 * turn(k).cos()).collect();
    let y: Vec<f64> = (0..997).map(|k| 2.0 * (turn(k) + 1.0).cos()).collect();
    let width = 6.0 * 1.0_f64.sin();
    assert!((choudhury2006::ellipse(&u, &y) - width).abs() < 1e-9);
    // The strip is a tenth of PV's range on either side: the branches bend by two per cent within it.
    assert!(choudhury2006::branches(&u, &y).is_some_and(|found| (found - width).abs() < 0.03 * width));
}

#[test]
fn srinivasan_shapes() {
    // Srinivasan 2005, part 1, table of shapes.
    use srinivasan2005::{Shape, distance};
    for shape in [Shape::Sine, Shape::Triangle, Shape::Square] {
        assert_eq!(distance(&shape.points(), &shape.points()), 0.0);
    }
    let share =
        |op, pv, integrates| says(Method::Srinivasan2005Shape, &window(op, pv, 0.25), integrates).index;
    assert_eq!(share(triangle, square, false), Some(1.0));
    assert_eq!(share(sine, triangle, true), Some(1.0));
    assert_eq!(share(sine, sine, false), Some(0.0));
    assert_eq!(share(sine, sine, true), Some(0.0));
}

#[test]
fn srinivasan_d_of_his_own_element_is_found() {
    // Srinivasan 2005, part 2: two incommensurate sines through the element with d = 1.3 and a first-order process.
    let op: Vec<f64> =
        (0..900).map(|k| 2.0 * (0.11 * f64::from(k)).sin() + 1.1 * (0.037 * f64::from(k)).sin()).collect();
    let mut stem = op.clone();
    crate::diagnosis::friction::srinivasan(&op, 1.3, &mut stem);
    let mut pv = vec![0.0; op.len()];
    for k in 1..op.len() {
        pv[k] = 0.8 * pv[k - 1] + 0.2 * stem[k - 1];
    }
    let window = Window { ts: 1.0, op, pv, ..Window::default() };
    let found = says(Method::Srinivasan2005D, &window, false);
    // One step of the grid: OP's range of at most 6.2 over 60.
    assert!(found.quantity.is_some_and(|q| (q.value - 1.3).abs() < 0.11), "{found:?}");
}

#[test]
fn srinivasan_d_tells_the_paper_s_sticking_loops_from_the_others() {
    // Ivan & Lakshminarayanan 2009, Table 2: d is 0.00 under the sinusoidal load and 3.78 in the sticking level loop. The
    // program's d follows a longer model than theirs: docs/reproduce.md has theirs beside the paper's, window by window.
    let d = |case: usize| {
        let run = table2()[case].run().expect("valid");
        says(Method::Srinivasan2005D, &of_run(&run), true)
    };
    let (sticking, loaded) = (d(3), d(4));
    assert!(sticking.quantity.is_some_and(|q| q.value > 1.5), "{sticking:?}");
    assert!(loaded.index.is_some_and(|index| index < 0.05), "{loaded:?}");
}

#[test]
fn rossi_and_scali_relay_and_sine() {
    // Rossi & Scali 2005: S_I is 1 for the response to a relay, of any time constant, and -1 for a sine.
    for ratio in [0.5, 2.0, 8.0, 32.0] {
        let mut window = sticking();
        window.pv = (0..PERIOD * PERIODS)
            .map(|k| {
                let s = (k as f64 + 0.5) / (PERIOD / 2) as f64;
                let sign = if (s as usize).is_multiple_of(2) { 1.0 } else { -1.0 };
                sign * rossi_scali2005::relay(s.fract(), ratio)
            })
            .collect();
        let relay = says(Method::RossiScali2005, &window, false);
        assert!(relay.index.is_some_and(|index| index > 0.9), "{ratio}: {relay:?}");
    }
    let sine = says(Method::RossiScali2005, &loaded(), false);
    assert!(sine.index.is_some_and(|index| index < -0.98), "{sine:?}");
    let middle = says(Method::RossiScali2005, &window(sine_like, sine_like, 0.5), false);
    assert_eq!(middle.says, Says::CannotTell, "{middle:?}");
}

/// Between a sine and a triangle.
fn sine_like(phase: f64) -> f64 {
    0.5 * (sine(phase) + 1.03 * triangle(phase))
}

fn sticking_loop(fs: f64, fd: f64) -> LoopSpec {
    table2_loop(true, Friction::He { fs, fd })
}

#[test]
fn lee_finds_the_friction_of_his_own_valve() {
    // Lee 2008 simulates He's valve; the loop and fS 3, fD 2 are those of Ivan & Lakshminarayanan 2009, which prints his
    // numbers of industrial loops in Table 6.
    let run = simulate(&sticking_loop(3.0, 2.0), 3000, 1).expect("valid").after(1000);
    let window = of_run(&run);
    let facts = Facts::new(&window, Some(true)).expect("moves");
    let found = lee2008::estimate(&facts).expect("reverses");
    // The grid has steps of 0.03 in S and of S/5 in J, which finer ones divide by eight.
    assert!((found.fs - 3.0).abs() < 0.1 && (found.fd - 2.0).abs() < 0.1, "{found:?}");
    assert_eq!(opinion(Method::Lee2008, &facts).says, Says::Sticks);
    // Table 6, loop 3: fS' 0 and fD' 0, where nothing sticks. Here: the paper's sinusoidal load.
    let sound = says(Method::Lee2008, &of_run(&table2()[4].run().expect("valid")), true);
    assert_eq!(sound.says, Says::Sound, "{sound:?}");
}

#[test]
fn the_measured_stem_gives_s() {
    // Ivan & Lakshminarayanan 2009, Table 2: S = fS + fD is 1 and 5.
    for (case, s) in [(0, 1.0), (1, 5.0), (2, 1.0), (3, 5.0)] {
        let run = table2()[case].run().expect("valid");
        let window = Window { mv: Some(run.mv.clone()), ..of_run(&run) };
        let found = says(Method::StemLoop, &window, false);
        assert_eq!(found.says, Says::Sticks, "{found:?}");
        // A step of the grid is OP's range over 160.
        assert!(found.quantity.is_some_and(|q| (q.value - s).abs() < 0.03 * s), "{case}: {found:?}");
    }
    let run = table2()[4].run().expect("valid");
    let window = Window { mv: Some(run.mv.clone()), ..of_run(&run) };
    assert_eq!(says(Method::StemLoop, &window, true).says, Says::Sound);
    assert_eq!(says(Method::StemLoop, &sticking(), false).says, Says::CannotTell);
}

#[test]
fn whether_the_process_integrates_is_measured() {
    // The paper's sticking loops: `1/(12 s + 1)` at periods of 500 s and more follows, `e^-60s/(900 s)` integrates.
    for (case, answer) in
        [(0, Integrates::No), (1, Integrates::No), (2, Integrates::Yes), (3, Integrates::Yes)]
    {
        let run = simulate(&table2()[case].spec, 13_000, 1).expect("valid").after(1000);
        let window = decimate(&of_run(&run), if case < 2 { 4 } else { 1 });
        let facts = Facts::new(&window, None).expect("moves");
        assert_eq!(facts.integration.answer, answer, "{case}: {:?}", facts.integration);
    }
    // Under a load OP follows PV: nothing is said of the process.
    let window = loaded();
    assert_eq!(Facts::new(&window, None).expect("moves").integration.answer, Integrates::Unknown);
}

#[test]
fn agreement_counts_and_doubts() {
    let of = |method, says| Opinion { says, ..Opinion::cannot_tell(method, "") };
    let mut all: Vec<Opinion> = Method::ALL.map(|method| of(method, Says::CannotTell)).to_vec();
    assert_eq!(agreement(&all, Some(true), true).could_tell, 0);
    assert!(!agreement(&all, Some(true), true).doubtful);
    for opinion in &mut all[1..=agreement::LEAST_CONTRADICTING] {
        opinion.says = Says::Sound;
    }
    let found = agreement(&all, Some(true), true);
    assert_eq!((found.sticks, found.could_tell, found.doubtful), (0, agreement::LEAST_CONTRADICTING, true));
    assert!(!agreement(&all, Some(true), false).doubtful, "no regular cycle");
    assert!(!agreement(&all, Some(false), true).doubtful, "they agree");
    assert!(!agreement(&all, None, true).doubtful, "there is no verdict");
    all[1].says = Says::CannotTell;
    assert!(!agreement(&all, Some(true), true).doubtful, "too few");
    all[0].says = Says::Sound;
    assert!(agreement(&all, Some(true), false).doubtful, "the stem alone is enough");
}

#[test]
fn one_method_is_told_as_one() {
    let said = |says: &[Says]| {
        let opinion =
            |(method, says): (&Method, &Says)| Opinion { says: *says, ..Opinion::cannot_tell(*method, "") };
        let all: Vec<Opinion> = Method::ALL[1..].iter().zip(says).map(opinion).collect();
        agreement(&all, None, false).why
    };
    assert_eq!(said(&[Says::Sticks]), "the only method that could tell says that the valve sticks");
    assert_eq!(said(&[Says::Sound]), "the only method that could tell says that the valve does not stick");
    assert_eq!(said(&[Says::Sound, Says::Sticks]), "1 of 2 that could tell says that the valve sticks");
    assert_eq!(said(&[Says::Sticks; 2]), "2 of 2 that could tell say that the valve sticks");
    assert_eq!(said(&[]), "no method could tell");
}

#[test]
fn nothing_to_say_is_said_by_all() {
    let flat = Window { ts: 1.0, op: vec![1.0; 500], pv: vec![2.0; 500], ..Window::default() };
    let short = Window { ts: 1.0, op: vec![1.0, 2.0], pv: vec![1.0, 2.0], ..Window::default() };
    for window in [flat, short, Window::default()] {
        let all = opinions(&window, None);
        assert_eq!(all.len(), Method::ALL.len());
        assert!(all.iter().all(|o| o.says == Says::CannotTell && !o.why.is_empty()));
    }
}

/// Values of any kind, most of them usable, so that the methods themselves are reached.
fn value() -> impl Strategy<Value = f64> {
    prop_oneof![
        60 => -100.0..100.0_f64,
        1 => Just(0.0),
        1 => prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(1e300), Just(-1e308), Just(1e-300)],
    ]
}

/// A wave of any period and height with noise of any size: what passes the first checks.
fn wave() -> impl Strategy<Value = Vec<f64>> {
    (100..700_usize, 2.0..400.0_f64, -9.0..9.0_f64, 0.0..2.0_f64, any::<u64>(), 0..3_usize).prop_map(
        |(n, period, decades, noise, seed, kind)| {
            use rand::{RngExt, SeedableRng};
            let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
            let wave = [sine, triangle, square][kind];
            let of = |k: usize, noise: f64| 10.0_f64.powf(decades) * (wave(k as f64 / period) + noise);
            (0..n).map(|k| of(k, noise * (rng.random::<f64>() - 0.5))).collect()
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn nothing_panics(
        op in prop_oneof![prop::collection::vec(value(), 0..300), wave()],
        pv in prop_oneof![prop::collection::vec(value(), 0..300), wave()],
        stem in prop::option::of(wave()),
        ts in prop_oneof![Just(1.0), Just(0.0), Just(f64::NAN), Just(1e-9), Just(1e12)],
        integrates in prop::option::of(any::<bool>()),
        alike in any::<bool>(),
    ) {
        let mut window = Window { ts, op, pv, mv: stem, ..Window::default() };
        if alike {
            let n = window.op.len().min(window.pv.len());
            window.op.truncate(n);
            window.pv.truncate(n);
            window.mv = window.mv.filter(|mv| mv.len() >= n).map(|mv| mv[..n].to_vec());
        }
        let all = opinions(&window, integrates);
        prop_assert_eq!(all.len(), Method::ALL.len());
        for opinion in &all {
            prop_assert!(opinion.index.is_none_or(f64::is_finite), "{:?}", opinion);
            prop_assert!(opinion.quantity.is_none_or(|q| q.value.is_finite()), "{:?}", opinion);
            prop_assert!(!opinion.why.is_empty());
        }
        agreement(&all, Some(true), true);
    }
}

#[test]
fn every_opinion_with_an_index_has_a_picture_that_is_bounded() {
    for (window, integrates) in [
        (sticking(), false),
        (loaded(), false),
        (window(sine, triangle, 0.75), true),
        (window(sine, sine, 0.75), true),
    ] {
        let window = Window { mv: Some(window.pv.clone()), ..window };
        let facts = Facts::new(&window, Some(integrates)).expect("the signals move");
        for method in Method::ALL {
            let (said, drawn) = (opinion(method, &facts), picture(method, &facts));
            assert!(said.index.is_none() || !drawn.is_empty(), "{said:?}");
            for picture in drawn {
                assert!(picture.x.from < picture.x.to && picture.y.from < picture.y.to, "{method:?}");
                assert!(picture.layers.iter().all(|layer| bounded(&layer.mark)), "{method:?}");
                assert!(!picture.layers.is_empty() && !picture.title.is_empty());
            }
        }
    }
}

fn bounded(mark: &picture::Mark) -> bool {
    use picture::Mark;
    match mark {
        Mark::Line(points) | Mark::Dots(points) | Mark::Bars { points, .. } => {
            points.len() <= picture::MOST_POINTS && points.iter().all(|(x, y)| x.is_finite() && y.is_finite())
        }
        Mark::Level(at) | Mark::Upright(at) => at.is_finite(),
        Mark::Cells { columns, values, .. } => {
            *columns > 0 && values.len() % columns == 0 && values.len() <= 50 * 50
        }
    }
}

#[test]
fn pictures_hold_the_numbers_that_opinions_rest_on() {
    use picture::{Mark, Tone};
    let window = sticking();
    let facts = Facts::new(&window, Some(false)).expect("the signals move");
    // Horch: the correlation is odd, so that it is zero at lag 0, and crosses zero half a period away on one side.
    let [drawn] = &picture(Method::Horch1999, &facts)[..] else { panic!("one picture") };
    let at_zero = drawn.layers.iter().find(|layer| layer.name == "r at lag 0").expect("it is marked");
    assert!(matches!(&at_zero.mark, Mark::Dots(points) if points.len() == 1 && points[0].1.abs() < 0.05));
    let uprights = drawn.layers.iter().filter(|layer| matches!(layer.mark, Mark::Upright(_)));
    assert_eq!(uprights.count(), 2);
    // He: the triangle that is drawn has its peak where OP has it, in the middle, and is higher than the sine.
    let [drawn] = &picture(Method::He2007, &facts)[..] else { panic!("one picture") };
    let triangle = drawn.layers.iter().find(|layer| layer.tone == Tone::Sticks).expect("it is drawn");
    let Mark::Line(points) = &triangle.mark else { panic!("a line") };
    let top = points.iter().max_by(|a, b| a.1.total_cmp(&b.1)).expect("points");
    assert!((top.0 - 0.5).abs() < 0.06 && top.1 > 1.0, "{top:?}");
    // Kano: the samples that stand still are those of the stem's two levels.
    let [drawn] = &picture(Method::Kano2004A, &facts)[..] else { panic!("one picture") };
    let still = drawn.layers.iter().find(|layer| layer.tone == Tone::Sticks).expect("it is drawn");
    assert!(
        matches!(&still.mark, Mark::Dots(points) if points.len() > 100 && points.iter().all(|p| (p.1.abs() - 1.0).abs() < 0.1))
    );
}
