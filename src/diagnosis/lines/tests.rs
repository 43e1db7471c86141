//! Lines that were drawn, and lines that were measured.

use super::*;
use crate::diagnosis::gate::gate;
use crate::diagnosis::history_kind::{HistoryKind, recognise_beside};
use crate::diagnosis::{NotIdentifiable, Settings, Verdict, diagnose};
use crate::signal::{Record, Row};
use crate::sim::archive::{interpolated, swinging_door};
use crate::sim::scenarios::{random_sound, random_sticky, table2_loop};
use crate::sim::{ControllerSpec, Friction, LoopSpec, Run, simulate};
use crate::sysid::stats::sd;

/// Longest line of the archives (sample periods).
const LONGEST: f64 = 100.0;

fn series(run: &Run, values: &[f64]) -> Vec<Sample> {
    run.t.iter().zip(values).map(|(t, v)| Sample::good(*t, *v)).collect()
}

/// OP, PV and set point of a run, printed with this last digit.
fn printed_run(run: &Run, digit: f64) -> [Vec<Sample>; 3] {
    [&run.op, &run.pv, &run.sp].map(|values| rounded(&series(run, values), digit))
}

fn rounded(series: &[Sample], digit: f64) -> Vec<Sample> {
    series.iter().map(|s| Sample::good(s.t, (s.value / digit).round() * digit)).collect()
}

/// What a swinging-door archive keeps; `band`: its deviation (standard deviations).
fn kept(series: &[Sample], band: f64) -> Vec<Sample> {
    let spread = sd(&series.iter().map(|s| s.value).collect::<Vec<_>>());
    swinging_door(series, band * spread, LONGEST * (series[1].t - series[0].t))
}

/// As it exports that, at the period of the samples.
fn archived(series: &[Sample], band: f64) -> Vec<Sample> {
    interpolated(&kept(series, band), series[1].t - series[0].t)
}

fn kind([op, pv, sp]: &[Vec<Sample>; 3]) -> Option<HistoryKind> {
    recognise_beside(op, pv, Some(sp)).map(|found| found.kind)
}

/// The level loop whose valve sticks, without noise: a stuck valve lets the tank fill on straight lines.
fn stuck(controller: Option<ControllerSpec>, sp_schedule: Vec<(f64, f64)>, friction: Friction) -> Run {
    let mut spec = LoopSpec { sp_schedule, ..table2_loop(true, friction) };
    spec.controller = controller.unwrap_or(spec.controller);
    simulate(&spec, 2500, 1).expect("can be simulated").after(1000)
}

#[test]
fn hand_values() {
    assert_eq!(printed(&[1.5, 2.25, -3.0]), Some(0.75));
    assert_eq!(printed(&[]), None);
    let steps: Vec<f64> = (0..300).map(|k| 0.01 * f64::from((k * k) % 97)).collect();
    for factor in [1.0, 0.01, 276.48, -0.16] {
        let scaled: Vec<f64> = steps.iter().map(|v| 50.0 + factor * v).collect();
        let unit = printed(&scaled).expect("all are whole hundredths");
        assert!((unit / (0.01 * factor.abs()) - 1.0).abs() < 1e-6, "{factor}: {unit}");
    }
    let smooth: Vec<f64> = (0..300).map(|k| (0.1 * f64::from(k)).sin()).collect();
    assert_eq!(printed(&smooth), None);
    // Two lines, and the last sample off both; in time, so that a missing sample breaks none.
    let (times, values) = ([0.0, 1.0, 2.0, 4.0, 5.0, 6.0, 7.0], [0.0, 1.0, 2.0, 4.0, 2.0, 0.0, 5.0]);
    assert_eq!(chords(&times, &values, 0.01), [(0, 3), (3, 5), (5, 6)]);
    assert_eq!(chords(&times, &values, 9.0), [(0, 6)]);
    // 0, 1, 0 about its line of slope 0: the mean is 1/3.
    assert!((about_line(&[0.0, 1.0, 2.0], &[0.0, 1.0, 0.0]) - 2.0 / 3.0).abs() < 1e-12);
    let own: Vec<Sample> = times.iter().zip(&values).map(|(t, v)| Sample::good(*t, *v)).collect();
    let ends: Vec<f64> = Lines::of(&own).expect("it moves").measured(&own).iter().map(|s| s.t).collect();
    assert_eq!(ends, [0.0, 4.0, 6.0, 7.0]);
    assert_eq!(Lines::of(&[]), None);
    assert_eq!(Lines::of(&[Sample::good(0.0, 1.0); 90]), None);
}

#[test]
fn the_samples_that_an_archive_kept_are_found_again() {
    for seed in 0..8 {
        let Ok(run) = random_sound(seed).run() else { continue };
        let pv = series(&run, &run.pv);
        let ts = pv[1].t - pv[0].t;
        let (kept, exported) = (kept(&pv, 0.2), archived(&pv, 0.2));
        let found = Lines::of(&exported).expect("it moves").measured(&exported);
        let stamps = |s: &[Sample]| s.iter().map(|s| (s.t / ts).round() as usize).collect::<Vec<_>>();
        assert_eq!(stamps(&found), stamps(&kept), "seed {seed}");
    }
}

#[test]
fn an_archive_calls_no_valve_sound_and_no_sound_one_sticking() {
    let (mut judged, mut compressed) = (0, 0);
    for seed in 100..124 {
        for (sticks, scenario) in [(false, random_sound(seed)), (true, random_sticky(seed))] {
            let Ok(run) = scenario.run() else { continue };
            let raw = printed_run(&run, 1e-4);
            assert_eq!(kind(&raw), None, "seed {seed}: raw");
            let op_alone_is_raw = [raw[0].clone(), archived(&raw[1], 0.25), raw[2].clone()];
            let both = [archived(&raw[0], 0.1), archived(&raw[1], 0.25), raw[2].clone()];
            // A calm loop has too few lines, and one whose noise is all that moves PV keeps nearly all of its samples.
            let share = kept(&raw[1], 0.25).len() as f64 / raw[1].len() as f64;
            let is_told = (0.05..0.7).contains(&share);
            for own in [op_alone_is_raw, both] {
                let own = own.map(|tag| rounded(&tag, 1e-4));
                assert!(!is_told || kind(&own) == Some(HistoryKind::Interpolated), "seed {seed}");
                let [op, pv, sp] = own;
                let record = Record { op, pv, sp: Some(sp), op_span: Some(100.0), ..Record::default() };
                let found = diagnose(&record, &Settings::default());
                assert!(sticks || found.verdict != Verdict::Stiction, "seed {seed}: {}", found.reason);
                if !is_told {
                    continue;
                }
                assert_ne!(found.verdict, Verdict::NoStiction, "seed {seed}");
                judged += 1;
                if let Verdict::NotIdentifiable(NotIdentifiable::Compressed { .. }) = found.verdict {
                    let why = "compressed: an archive drew straight lines between the few samples it kept";
                    assert!(found.reason.starts_with(why), "{}", found.reason);
                    assert!(found.reason.contains("raw values") && !found.reason.contains("f reads low"));
                    compressed += 1;
                }
            }
        }
    }
    assert!(judged > 30 && 10 * compressed > 8 * judged, "{compressed} of {judged}");
}

#[test]
fn only_the_ends_of_lines_count() {
    // Two samples of three are measured: the third is on the line between its neighbours.
    let Ok(run) = random_sound(3).run() else { panic!("can be simulated") };
    let [op, mut pv, _] = printed_run(&run, 1e-6);
    for k in (1..pv.len() - 1).step_by(3) {
        pv[k].value = 0.5 * (pv[k - 1].value + pv[k + 1].value);
    }
    let record = Record { op, pv, op_span: Some(100.0), ..Record::default() };
    let (window, preparation) = gate(&record, &Settings::default()).expect("enough is left");
    assert!(preparation.is_drawn() && (preparation.gap_share - 1.0 / 3.0).abs() < 0.02, "{preparation:?}");
    let missing = |k: usize| window.row(k) == Row::Missing;
    assert!((3..window.len() - 3).filter(|k| k % 3 == 1).all(missing));
    let of_others = (3..window.len() - 3).filter(|k| k % 3 != 1 && missing(*k)).count();
    assert!(of_others * 20 < window.len(), "{of_others}");
}

#[test]
fn lines_of_which_the_controller_computed_op_are_measurements() {
    let kano = Friction::Kano { s: 5.0, j: 2.0, resolution: 0.0 };
    let ramps: Vec<(f64, f64)> = (0..2500)
        .map(|k| (50.0 * f64::from(k), 50.0 + 3.0 * (f64::from(k % 160) / 80.0 - 1.0).abs()))
        .collect();
    let proportional = ControllerSpec::pi(3.0, f64::INFINITY);
    let mut lines = 0;
    for run in [
        stuck(None, Vec::new(), kano),
        stuck(None, Vec::new(), Friction::Choudhury { s: 5.0, j: 1.5, resolution: 0.005 }),
        stuck(Some(proportional), Vec::new(), kano),
        stuck(None, ramps.clone(), kano),
        stuck(None, ramps, Friction::Ideal),
    ] {
        for digit in [1e-2, 1e-3, 1e-5, 1e-12] {
            let own = printed_run(&run, digit);
            lines += usize::from(Lines::of(&own[1]).is_some_and(|lines| lines.look_drawn()));
            assert_ne!(kind(&own), Some(HistoryKind::Interpolated), "{digit}");
        }
    }
    // Of a loop whose set point is not recorded, OP follows from PV wherever that set point does not change.
    let steps = vec![(70_000.0, 53.0), (95_000.0, 48.0)];
    for digit in [1e-5, 1e-12] {
        let [op, pv, sp] = printed_run(&stuck(None, steps.clone(), kano), digit);
        assert!(sp.iter().any(|s| s.value != sp[0].value), "it changes");
        let found = recognise_beside(&op, &pv, None).map(|found| found.kind);
        assert_ne!(found, Some(HistoryKind::Interpolated), "{digit}");
    }
    // Where the two are never read at one time, OP cannot tell, and that is what is wrong with the record.
    let [mut op, mut pv, sp] = printed_run(&stuck(None, Vec::new(), kano), 1e-5);
    let in_turns = |s: &Sample| ((s.t / 350.0) as usize).is_multiple_of(2);
    op.retain(in_turns);
    pv.retain(|s| !in_turns(s));
    assert_eq!(kind(&[op, pv, sp]), None);
    // Else this would test nothing.
    assert!(lines > 4, "{lines}");
    // Drawn through every tenth sample of the same loop, PV is not what the controller read.
    let [op, pv, sp] = printed_run(&stuck(None, Vec::new(), kano), 1e-5);
    let ts = pv[1].t - pv[0].t;
    let tenth: Vec<Sample> = pv.iter().step_by(10).copied().collect();
    let drawn = rounded(&interpolated(&tenth, ts), 1e-5);
    assert_eq!(kind(&[op, drawn, sp]), Some(HistoryKind::Interpolated));
}

#[test]
fn curves_coarse_digits_and_noise_are_no_lines() {
    let looks = |value: &dyn Fn(f64) -> f64, digit: f64| {
        let own: Vec<Sample> = (0..1500).map(|k| Sample::good(f64::from(k), value(f64::from(k)))).collect();
        Lines::of(&rounded(&own, digit)).is_some_and(|lines| lines.look_drawn())
    };
    // A smooth PV of few digits has chords that are a hundred rows long.
    for digit in [0.3, 0.1, 0.01, 1e-3, 1e-4] {
        assert!(!looks(&|k| (0.02 * k).sin() + 0.3 * (0.013 * k).cos(), digit), "{digit}");
    }
    // A triangle with noise of a third of its last digit.
    let noise = |k: f64| (1e4 * (12.9898 * k).sin()).fract();
    let triangle = |k: f64| (k.rem_euclid(60.0) - 30.0).abs();
    assert!(looks(&triangle, 0.01));
    assert!(!looks(&|k| triangle(k) + 0.006 * noise(k), 0.01));
}
