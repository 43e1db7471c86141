//! Windows of records of known flaws.

mod thinned;

use super::*;
use crate::indicators::series::NAMED;
use crate::indicators::service::at_limits;
use crate::plantwide::{Plant, analyse, health, values};
use crate::signal::{BadReason, Quality};
use crate::sysid::spectrum::Transforms;
use std::borrow::Cow;
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
        let sp = of.sp_known.as_ref().map(|known| known.iter().filter(|is| **is).count());
        (sp, mode.count())
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
    let both = Some(4001 + 640);
    assert_eq!(known(&of(back.clone(), back)), (both, 4001 + 640), "from 80,000 s on it is known again");
    // What changed first may have been anything before.
    let late = vec![Sample::good(50_000.0, 1.0)];
    assert_eq!(known(&of(late.clone(), late)), (Some(3640), 3640));
    // The gap of a polled one is no set point, and there is no error in it.
    let mut gap = day(|_| 5.0);
    gap.drain(1000..3000);
    let gap = of(gap, once);
    assert_eq!(known(&gap), (Some(6640), 8640));
    let is_known = gap.sp_known.as_ref().map(|known| [999, 1000, 2999, 3000].map(|k| known[k]));
    assert_eq!(is_known, Some([true, false, false, true]));
}

#[test]
fn a_step_of_the_set_point_in_a_gap_is_no_error() {
    // PV follows the set point from 20 to 80, which is not sampled for an hour before it is seen to have moved.
    let level = |t: f64| if t < 30_000.0 { 20.0 } else { 80.0 };
    let pv = day(move |t| level(t) + (0.7 * t * t).sin());
    let mut sp = day(level);
    sp.retain(|s| s.t < 30_000.0 || s.t >= 33_600.0);
    let record = Record { op: pv.clone(), pv, sp: Some(sp), ..Record::default() };
    let found = health(&of_record("FIC1", &record, 10_000).expect("a day"), &mut Transforms::new());
    // Held over the gap it would be 60 for an hour of the day, and 12 in the root mean square.
    let error = found.error.expect("known for most of the day");
    assert!(error.sd < 1.0 && error.mean_absolute < 1.0, "{error:?}");
    assert_eq!(found.settling, None, "when it stepped is not known");
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
fn a_cycle_of_a_row_and_a_half_does_not_fold_to_a_swing() {
    // 100,000 samples at 1 s are rows of 33 s: picked, and by the mean of a row, 51 s shows as a swing of 94 s.
    let fast = |k: u32| Sample::good(f64::from(k), 50.0 + 5.0 * (TAU * f64::from(k) / 51.0).sin());
    let series: Vec<Sample> = (0..100_000).map(fast).collect();
    let record = Record { op: series.clone(), pv: series, ..Record::default() };
    let of = of_record("FIC1", &record, 3000).expect("27 hours");
    assert!((of.window.ts - 33.3).abs() < 0.1 && of.pv_blurred && of.op_blurred, "{}", of.window.ts);
    assert!(sd(&of.window.pv[10..2990]) < 0.05, "{}", sd(&of.window.pv[10..2990]));
    // Of its own samples the recent part has the whole swing.
    let recent = recent("FIC1", &record, 3600.0, 3600).expect("an hour");
    assert_eq!((recent.window.ts, recent.window.len(), recent.pv_blurred), (1.0, 3600, false));
    assert!((sd(&recent.window.pv) - 5.0 * 0.5f64.sqrt()).abs() < 0.05);
}

/// A record that is looked at as the daemon looks at its rings.
struct Rings(Record);

impl Plant for Rings {
    fn count(&self) -> usize {
        1
    }

    fn get(&self, _: usize) -> Cow<'_, PlantLoop> {
        Cow::Owned(of_record("FIC1", &self.0, 4096).expect("samples"))
    }

    fn recent(&self, _: usize, hour_s: f64) -> Option<PlantLoop> {
        recent("FIC1", &self.0, hour_s, 3600).ok()
    }
}

#[test]
fn the_latest_hour_does_not_depend_on_how_far_a_record_goes_back() {
    let end = 108_000_u32;
    let error = |k: u32| {
        let t = f64::from(k);
        5.0 * (TAU * t / 60.0).sin() + (0.7 * t * t).sin()
    };
    let of = |seconds: u32| {
        let series = |of: &dyn Fn(u32) -> f64| -> Vec<Sample> {
            (end - seconds..end).map(|k| Sample::good(f64::from(k), of(k))).collect()
        };
        let (op, pv, sp) = (series(&|k| 50.0 - error(k)), series(&error), Some(series(&|_| 0.0)));
        let rings = Rings(Record { op, pv, sp, op_limits: Some((0.0, 100.0)), ..Record::default() });
        let found = analyse(&rings);
        let blurred = found.loops[0].indicators.blurred;
        // Of a swing that is too fast for the rows the whole window says nothing.
        let whole = &found.loops[0].indicators;
        assert_eq!(
            (whole.error.is_none(), whole.score.is_none(), whole.swing.is_none()),
            (blurred, blurred, blurred)
        );
        (blurred, values(&rings, &found, 3600.0)[0])
    };
    // Rows of 2.9 and 26 s.
    let (sharp, few) = of(12_000);
    let (blurred, many) = of(end);
    assert_eq!((sharp, blurred), (false, true));
    for (at, (name, ..)) in NAMED.iter().enumerate() {
        if *name == "regularity" {
            // Of the same swing, but of other crossings.
            assert!(few[at] > Some(1.0) && many[at] > Some(1.0), "{few:?} {many:?}");
        } else if ["score", "swing", "period_s"].contains(name) {
            // What needs a long record is taken from one, so long as it shows there.
            let (few, many) = (few[at].expect("known"), many[at].expect("known"));
            assert!((few / many - 1.0).abs() < 0.1, "{name}: {few} {many}");
        } else {
            assert_eq!(few[at], many[at], "{name}");
        }
    }
    assert!((many[3].expect("known") - 13.0_f64.sqrt()).abs() < 0.1, "{many:?}");
}

#[test]
fn the_recent_part_of_a_record_that_is_not_thinned_is_its_end() {
    let record = Record {
        op: day(|t| (0.003 * t).sin()),
        pv: day(|t| (0.001 * t).sin()),
        sp: Some(day(|_| 0.0)),
        mode: Some(day(|_| 1.0)),
        mv: Some(day(|t| (0.002 * t).sin())),
        ..Record::default()
    };
    let whole = of_record("FIC1", &record, 10_000).expect("a day");
    let of = |most| recent("FIC1", &record, 3600.0, most).expect("a day");
    assert_eq!(of(10_000), whole);
    assert_eq!(of(3600), tail(&whole, 36_000.0));
    // So many rows are an hour at least, however near the samples are.
    let short = of(100).window;
    assert_eq!((short.ts, short.len()), (36.0, 100));
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
fn of_a_stem_that_is_not_measured_any_more_the_travel_is_not_known() {
    let wave = |t: f64| 50.0 + 5.0 * (TAU * t / 600.0).sin();
    let mut transforms = Transforms::new();
    for (until, is_told) in [(86_400.0, (true, true)), (60_000.0, (true, false)), (40_000.0, (false, false))]
    {
        let stem: Vec<Sample> = day(wave).into_iter().filter(|s| s.t < until).collect();
        let record = Record { op: day(wave), pv: day(wave), mv: Some(stem), ..Record::default() };
        for most in [1000, 10_000] {
            let of = of_record("FIC1", &record, most).expect("a day");
            let found = [health(&of, &mut transforms), health(&tail(&of, 3600.0), &mut transforms)];
            let told = (found[0].travel.is_some(), found[1].travel.is_some());
            assert_eq!((told, found[1].measured), (is_told, true), "{until} {most}");
            // Of the time in which it was seen: 144 periods a day of 20 each.
            for travel in found.iter().filter_map(|own| own.travel) {
                assert!((travel.a_day / 2880.0 - 1.0).abs() < 0.03, "{until} {most}: {travel:?}");
            }
        }
    }
}

#[test]
fn a_valve_that_is_held_at_its_limit_is_measured() {
    // A third of the day at 0, where OP lives from 40 to 60 otherwise.
    let closed = |t: f64| if t < 57_600.0 { 50.0 + 10.0 * (0.01 * t).sin() } else { 0.0 };
    let (op, mv) = (day(closed), Some(day(closed)));
    let record = Record { op, mv, pv: day(|t| (0.001 * t).sin()), ..Record::default() };
    let limited = Record { op_limits: Some((0.0, 100.0)), ..record.clone() };
    let last = 86_390.0;
    assert_eq!(silent_since(&limited, last, 3600.0), None);
    let of = of_record("FIC1", &limited, 10_000).expect("a day");
    assert_eq!((of.window.missing(), &of.stem_known), (0.0, &None));
    let share = at_limits(&of.window.op, (0.0, 100.0)).expect("a span");
    assert!((share - 1.0 / 3.0).abs() < 0.001, "{share}");
    // Where nobody says that it is a limit, a zero is what loggers write; and a limit of OP is none of PV. All the same who writes
    // it is not silent.
    let missing = |of: &Record| of_record("FIC1", of, 10_000).expect("a day").window.missing();
    assert!((missing(&record) - 1.0 / 3.0).abs() < 0.001);
    let limited = Record { pv: limited.op.clone(), op: day(|t| 50.0 + (0.01 * t).sin()), ..limited };
    let of = of_record("FIC1", &limited, 10_000).expect("two thirds of a day");
    assert_eq!(of.window.t0 + of.window.ts * (of.window.len() as f64 - 1.0), 57_590.0);
    assert_eq!([&record, &limited].map(|of| silent_since(of, last, 3600.0)), [None; 2]);
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
        assert!((w.op[middle] - 100.0).abs() < 1e-9 && w.missing() == 0.0);
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
            let travel = found.travel.expect("seen for most of the time");
            let (way, turns) = (travel.a_day / 46_703.0, travel.reversals_a_day / 4670.0);
            assert!((way - 1.0).abs() < 0.015 && (turns - 1.0).abs() < 0.015, "{most} {has_gap}: {found:?}");
            // Whether PV answers such a cycle does not show in rows of 36 s.
            let is_thinned = most == 600;
            assert_eq!([of.pv_blurred, of.op_blurred, found.stuck.is_none()], [is_thinned; 3]);
        }
    }
}

#[test]
fn the_valve_gets_op_and_the_term_of_write_back() {
    let series = |of: &dyn Fn(f64) -> f64| -> Vec<Sample> {
        (0..400).map(f64::from).map(|t| Sample::good(t, of(t))).collect()
    };
    let term = [(0.0, 0.0), (200.0, 2.0), (300.0, 0.0)].map(|(t, value)| Sample::good(t, value)).to_vec();
    let (op, pv) = (series(&|t| 50.0 + (0.1 * t).sin()), series(&|t| 20.0 + (0.1 * t).cos()));
    let record = Record { op, pv, term: Some(term), ..Record::default() };
    let of = of_record("A", &record, 3000).expect("long enough");
    assert_eq!(of.window.op.len(), 400);
    for (own, op) in of.window.op.iter().zip(&record.op) {
        let acts = if (200.0..300.0).contains(&op.t) { 2.0 } else { 0.0 };
        // A rounding of numbers of order 50.
        assert!((own - op.value - acts).abs() < 1e-9, "{} at {}", own - op.value, op.t);
    }
}
