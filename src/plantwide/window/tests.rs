//! Windows of records of known flaws.

use super::*;
use crate::indicators::service::at_limits;
use crate::plantwide::health;
use crate::signal::{BadReason, Quality};
use crate::sysid::spectrum::Transforms;
use std::f64::consts::TAU;

#[test]
fn what_is_missing_is_drawn_through_and_set_points_are_held() {
    let series = |at: &[f64], f: &dyn Fn(f64) -> f64| at.iter().map(|t| Sample::good(*t, f(*t))).collect();
    let times: Vec<f64> = (0..100).map(f64::from).filter(|t| *t != 50.0 && *t != 51.0).collect();
    let record = Record {
        op: series(&times, &|t| 2.0 * t),
        pv: series(&times, &|t| t),
        sp: Some(series(&[0.0, 30.0], &|t| t)),
        ..Record::default()
    };
    let of = of_record("FIC1", &record, 1000).expect("98 samples");
    assert_eq!((of.window.pv.len(), of.window.ts), (100, 1.0));
    assert!((of.window.pv[50] - 50.0).abs() < 1e-9 && (of.window.pv[51] - 51.0).abs() < 1e-9);
    // OP repeats no value, as one that is sent by changes: it stood still until the next.
    assert_eq!(of.window.op[49..=52], [98.0, 98.0, 98.0, 104.0]);
    let sp = of.window.sp.expect("recorded");
    assert_eq!((sp[29], sp[30], sp[99]), (0.0, 30.0, 30.0));
    assert!(of_record("FIC1", &Record::default(), 1000).is_err());
    let last = tail(&of_record("FIC1", &record, 1000).expect("98 samples"), 9.5);
    assert_eq!(
        (last.window.t0, last.window.pv.len(), last.window.sp.map(|sp| sp.len())),
        (90.0, 10, Some(10))
    );
    // One that is longer than allowed is thinned, over the same time.
    let thin = of_record("FIC1", &record, 10).expect("98 samples").window;
    assert!((thin.ts - 9.9).abs() < 1e-9 && thin.pv.len() == 11, "{thin:?}");
}

/// A day of samples every 10 s.
fn day(f: impl Fn(f64) -> f64) -> Vec<Sample> {
    (0..8640).map(|k| 10.0 * f64::from(k)).map(|t| Sample::good(t, f(t))).collect()
}

/// A sample that is not good.
fn bad(t: f64) -> Sample {
    Sample { quality: Quality::Bad(BadReason::Timeout), ..Sample::good(t, f64::NAN) }
}

#[test]
fn mode_and_set_point_are_known_no_longer_than_they_were_sampled() {
    let pv = day(|t| (0.001 * t).sin());
    let of = |sp: Vec<Sample>, mode: Vec<Sample>| {
        let (op, pv) = (pv.clone(), pv.clone());
        let record = Record { op, pv, sp: Some(sp), mode: Some(mode), ..Record::default() };
        of_record("FIC1", &record, 10_000).expect("a day")
    };
    let known = |of: &PlantLoop| {
        let mode = of.mode.as_ref().expect("recorded").iter().filter(|mode| mode.is_finite());
        (of.sp_known, mode.count())
    };
    let all = of(day(|_| 5.0), day(|_| 1.0));
    assert_eq!(known(&all), (None, 8640));
    // Both died after 6,000 samples, without a word.
    let first = |x: f64| day(|_| x).into_iter().take(6000).collect::<Vec<Sample>>();
    let dead = of(first(5.0), first(1.0));
    assert_eq!(known(&dead), (Some(6000), 6000));
    let hour = tail(&dead, 3600.0);
    assert_eq!(known(&hour), (Some(0), 0));
    // A source that sends changes only has said nothing since, until it says that something is wrong.
    let once = vec![Sample::good(0.0, 1.0)];
    assert_eq!(known(&of(once.clone(), once.clone())), (None, 8640));
    let lost = vec![Sample::good(0.0, 1.0), bad(40_000.0)];
    assert_eq!(known(&of(lost.clone(), lost)), (Some(4001), 4001));
    let back = vec![Sample::good(0.0, 1.0), bad(40_000.0), Sample::good(80_000.0, 1.0)];
    assert_eq!(known(&of(once, back)), (None, 4001 + 640), "from 80,000 s on it is known again");
}

#[test]
fn what_is_drawn_through_a_gap_is_missing() {
    let mut gap = day(|t| (0.001 * t).sin());
    gap.drain(1000..7000);
    let record =
        |op: &[Sample], pv: &[Sample]| Record { op: op.to_vec(), pv: pv.to_vec(), ..Record::default() };
    let whole = day(|t| (0.001 * t).sin());
    let missing = |record: &Record| of_record("FIC1", record, 10_000).expect("a day").window.missing();
    assert_eq!(missing(&record(&whole, &whole)), 0.0);
    // OP repeats its values, so that its source does not send changes only.
    let polled = day(|t| (10.0 * (0.001 * t).sin()).round());
    let mut hole = polled.clone();
    hole.drain(1000..7000);
    for of in [record(&hole, &gap), record(&polled, &gap), record(&hole, &whole)] {
        assert!((missing(&of) - 6000.0 / 8640.0).abs() < 1e-3, "{}", missing(&of));
    }
    // One that is sent by changes stands where it was, until it is bad.
    assert_eq!(missing(&record(&gap, &whole)), 0.0);
    gap.insert(1000, bad(10_000.0));
    assert!((missing(&record(&gap, &whole)) - 6000.0 / 8640.0).abs() < 1e-3);
    gap.remove(1000);
    // The last hour is there, and of an hour in which OP has died two thirds are not.
    let of = of_record("FIC1", &record(&whole, &gap), 10_000).expect("a day");
    assert_eq!(tail(&of, 3600.0).window.missing(), 0.0);
    let of = of_record("FIC1", &record(&polled[..8400], &whole), 10_000).expect("a day");
    assert!((tail(&of, 3600.0).window.missing() - 240.0 / 360.0).abs() < 0.01);
    // A window that ended half an hour ago has the other half of the latest hour.
    let late = PlantLoop { silent_s: 1800.0, ..of };
    assert_eq!(tail(&late, 3600.0).window.pv.len(), 180);
}

#[test]
fn a_tag_is_silent_after_a_period_of_looks_and_ten_intervals() {
    let record = |op: Vec<Sample>| Record { op, pv: day(|t| t), ..Record::default() };
    let last = 86_390.0;
    let whole = record(day(|t| t));
    assert_eq!(silent_since(&whole, last + 3600.0, 3600.0), None);
    assert_eq!(silent_since(&whole, last + 3601.0, 3600.0), Some(("PV", last)));
    assert_eq!(silent_since(&whole, last + 99.0, 60.0), None, "ten intervals of 10 s");
    assert_eq!(silent_since(&whole, last + 101.0, 60.0), Some(("PV", last)));
    // Bad samples are no life.
    let mut dying: Vec<Sample> = day(|t| t).into_iter().take(100).collect();
    dying.extend((100..8640).map(|k| bad(10.0 * f64::from(k))));
    assert_eq!(silent_since(&record(dying), last, 3600.0), Some(("OP", 990.0)));
    // One that is sent by changes may stand still, and one that repeats its values may not.
    let first = |f: fn(f64) -> f64| day(f).into_iter().take(100).collect::<Vec<Sample>>();
    assert_eq!(silent_since(&record(first(|t| t)), last, 3600.0), None);
    assert_eq!(silent_since(&record(first(|_| 5.0)), last, 3600.0), Some(("OP", 990.0)));
    assert_eq!(silent_since(&Record::default(), 0.0, 60.0), None, "there never was one");
}

#[test]
fn a_cycle_that_is_faster_than_the_grid_does_not_show_as_a_slow_one() {
    let (fast, slow) = (|t: f64| (TAU * t / 30.0).sin(), |t: f64| (TAU * t / 3600.0).sin());
    let record = Record { op: day(slow), pv: day(fast), sp: Some(day(slow)), ..Record::default() };
    let of = of_record("FIC1", &record, 3000).expect("a day").window;
    assert!((of.ts - 28.8).abs() < 0.01, "{}", of.ts);
    assert!(sd(&of.pv) < 0.1, "{}", sd(&of.pv));
    // What is slow stays where it is, and a set point stays its master's output.
    let late = (0..of.op.len()).map(|k| of.op[k] - slow(k as f64 * of.ts)).map(f64::abs);
    assert!(late.fold(0.0, f64::max) < 0.03);
    assert_eq!(of.sp, Some(of.op));
    // A level stays level, and a gap in the record is drawn through.
    let mut gap = day(|_| 1e5 / 3.0);
    gap.drain(2000..4000);
    let record = Record { op: gap.clone(), pv: gap, ..Record::default() };
    let of = of_record("FIC1", &record, 3000).expect("most of a day").window;
    assert!(of.pv.iter().all(|x| *x == 1e5 / 3.0));
}

#[test]
fn steps_and_stretches_of_pv_outlive_the_thinning() {
    let coarse = |t: f64| if t < 43_200.0 { 5.0 } else { (8.0 * (TAU * t / 3600.0).sin()).round() * 0.5 };
    let record = Record { op: day(coarse), pv: day(coarse), ..Record::default() };
    let of = of_record("FIC1", &record, 1000).expect("a day");
    let raw = of.raw.expect("it is thinned");
    assert!((raw.step - 0.5).abs() < 1e-9 && (raw.held - 0.5).abs() < 0.01, "{raw:?}");
    assert_eq!(tail(&of, 3600.0).raw, Some(raw));
    assert_eq!(of_record("FIC1", &record, 10_000).expect("a day").raw, None);
}

#[test]
fn a_measured_stem_goes_with_the_window() {
    let record = Record { op: day(|t| t), pv: day(|t| t), mv: Some(day(|t| 2.0 * t)), ..Record::default() };
    let of = of_record("FIC1", &record, 10_000).expect("a day");
    let stem = of.window.mv.as_ref().expect("measured");
    assert!((stem[100] - 2000.0).abs() < 1e-9);
    assert_eq!(tail(&of, 3600.0).window.mv.map(|mv| mv.len()), Some(360));
    let hardly = Record { mv: Some(day(|t| t).split_off(8600)), ..record };
    assert_eq!(of_record("FIC1", &hardly, 10_000).expect("a day").window.mv, None);
}

#[test]
fn what_stands_for_no_measurement_is_none_and_a_set_point_may_be_zero() {
    let mut flawed = day(|t| 50.0 + (0.001 * t).sin());
    for (k, value) in [-9999.0, 0.0, 1e30, 0.0].into_iter().enumerate() {
        flawed[1000 + k].value = value;
    }
    let half = |x: f64| day(move |t| if t < 43_200.0 { x } else { 0.0 });
    let (op, pv, mv) = (flawed.clone(), flawed.clone(), Some(flawed));
    let record = Record { op, pv, mv, sp: Some(half(50.0)), mode: Some(half(1.0)), ..Record::default() };
    let of = of_record("FIC1", &record, 10_000).expect("a day");
    let w = &of.window;
    for values in [&w.op, &w.pv, w.mv.as_ref().expect("measured")] {
        assert!(values.iter().all(|x| (49.0..=51.0).contains(x)));
    }
    let zeros = |values: &[f64]| values.iter().filter(|x| **x == 0.0).count();
    let (sp, mode) = (w.sp.as_ref().expect("recorded"), of.mode.as_ref().expect("recorded"));
    assert_eq!((zeros(sp), zeros(mode)), (4320, 4320));
    // Samples that are none are no life either.
    let mut dying = day(|t| 50.0 + (0.001 * t).sin());
    dying[5000..].iter_mut().for_each(|s| s.value = -9999.0);
    let record = Record { op: day(|t| t), pv: dying, ..Record::default() };
    assert_eq!(silent_since(&record, 86_390.0, 3600.0), Some(("PV", 49_990.0)));
}

#[test]
fn op_that_is_sent_by_changes_stands_until_the_next() {
    // At its limit from 8 to 18 h, in which it is not sent.
    let (from, to) = (28_800.0, 64_800.0);
    let swing = |t: f64| if t == from { 100.0 } else { 50.0 + 10.0 * (0.0123 * t).sin() };
    let mut op = day(swing);
    op.retain(|s| s.t <= from || s.t >= to);
    let record = Record { op, pv: day(|t| (0.001 * t).sin()), ..Record::default() };
    for most in [1000, 10_000] {
        let w = of_record("FIC1", &record, most).expect("a day").window;
        let middle = ((0.5 * (from + to) - w.t0) / w.ts) as usize;
        assert_eq!((w.op[middle], w.missing()), (100.0, 0.0));
        let share = at_limits(&w.op, (0.0, 100.0)).expect("a span");
        assert!((share - 10.0 / 24.0).abs() < 0.005, "{share}");
    }
    // Of one that is polled, and repeats its values, nothing is known in a gap.
    let mut polled = day(|t| (10.0 * (0.001 * t).sin()).round());
    polled.drain(1000..1100);
    let ends = (polled[999].value, polled[1000].value);
    let record = Record { op: polled, pv: day(|t| (0.001 * t).sin()), ..Record::default() };
    let w = of_record("FIC1", &record, 10_000).expect("a day").window;
    assert!(ends.0 != ends.1 && (w.op[1050] - 0.5 * (ends.0 + ends.1)).abs() < 0.5 && w.missing() > 0.01);
}

#[test]
fn the_work_of_a_valve_does_not_depend_on_how_many_samples_there_may_be() {
    // A cycle of 37 s, for six hours at 1 s: 2,335 periods a day of 20 of way each.
    let wave = |late: f64| {
        move |k: u32| {
            let t = f64::from(k);
            Sample::good(t, 50.0 + 5.0 * (TAU * t / 37.0 + late).sin())
        }
    };
    let series = |late: f64, has_gap: bool| -> Vec<Sample> {
        let seen = |k: &u32| !has_gap || !(7200..14_400).contains(k);
        (0..21_600).filter(seen).map(wave(late)).collect()
    };
    let mut transforms = Transforms::new();
    for (most, has_gap) in [(600, false), (600, true), (100_000, false), (100_000, true)] {
        let record = Record { op: series(0.0, has_gap), pv: series(1.0, has_gap), ..Record::default() };
        let of = of_record("FIC1", &record, most).expect("six hours");
        for of in [tail(&of, 3600.0), of] {
            let found = health(&of, &mut transforms);
            let (way, turns) = (found.travel.a_day / 46_703.0, found.travel.reversals_a_day / 4670.0);
            assert!((way - 1.0).abs() < 0.015 && (turns - 1.0).abs() < 0.015, "{most} {has_gap}: {found:?}");
            // Whether PV answers such a cycle does not show in rows of 36 s.
            assert_eq!((of.blurred, found.stuck.is_none()), (most == 600, most == 600));
        }
    }
}
