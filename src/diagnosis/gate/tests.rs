//! The gate on records of known flaws.

use super::*;
use crate::diagnosis::prepare::prepare;
use crate::signal::{BadReason, Quality, Row, outages};

fn wave(n: usize, ts: f64) -> Record {
    let at = |k: usize, phase: f64| Sample::good(k as f64 * ts, 50.0 + (k as f64 * 0.2 + phase).sin());
    Record {
        op: (0..n).map(|k| at(k, 0.0)).collect(),
        pv: (0..n).map(|k| at(k, 1.0)).collect(),
        ..Record::default()
    }
}

fn reason(record: &Record) -> NotIdentifiable {
    gate(record, &Settings::default()).expect_err("refused").0
}

#[test]
fn a_clean_record_passes_unchanged() {
    let record = wave(300, 2.0);
    let (w, p) = gate(&record, &Settings::default()).expect("passes");
    assert_eq!((w.ts, w.len(), p.gap_share, p.worst_skew), (2.0, 300, 0.0, 0.0));
    assert!(w.op.iter().zip(&record.op).all(|(a, s)| *a == s.value));
}

#[test]
fn order_and_duplicates_are_repaired_and_counted() {
    let record = wave(300, 1.0);
    let mut shuffled = record.clone();
    shuffled.op.swap(10, 11);
    shuffled.pv.push(record.pv[299]);
    let (w, p) = gate(&shuffled, &Settings::default()).expect("passes");
    assert_eq!((p.out_of_order, p.duplicates), (1, 1));
    assert_eq!(w, gate(&record, &Settings::default()).expect("passes").0);
}

#[test]
fn jitter_and_skew_leave_values_as_they_are_and_are_reported() {
    let mut record = wave(300, 1.0);
    for (k, s) in record.op.iter_mut().enumerate() {
        s.t += 0.4 + 0.05 * (k as f64).sin();
        s.value = 50.0 + (s.t * 0.2).sin();
    }
    let (w, p) = gate(&record, &Settings::default()).expect("passes");
    assert!((p.worst_skew - 0.45).abs() < 0.01, "{}", p.worst_skew);
    // OP is held between its samples: the one read beside a PV belongs to it.
    let read: Vec<f64> = record.op.iter().map(|s| s.value).collect();
    let at = record.pv.iter().position(|s| s.value == w.pv[0]).expect("a sample's");
    assert_eq!(w.op, read[at..at + w.len()]);
    assert!(w.len() >= 298 && w.rows.is_empty());
}

#[test]
fn holes_are_masked_and_too_few_rows_are_refused() {
    let mut record = wave(400, 1.0);
    for k in (20..380).step_by(10) {
        record.pv[k].quality = Quality::Bad(BadReason::Timeout);
    }
    let (w, p) = gate(&record, &Settings::default()).expect("passes");
    assert!((p.gap_share - 36.0 / 400.0).abs() < 1e-12);
    assert_eq!((w.counted(), w.row(19), w.row(20)), (364, Row::Counts, Row::Missing));
    // What a sine must have been there, and none of it a measurement.
    let near =
        |value: f64, phase: f64, k: usize| (value - 50.0 - (0.2 * k as f64 + phase).sin()).abs() < 1e-4;
    assert!(near(w.pv[20], 1.0, 20), "{}", w.pv[20]);
    record.op[51].value = f64::NAN;
    let (w, _) = gate(&record, &Settings::default()).expect("passes");
    assert!(near(w.op[51], 0.0, 51) && w.row(51) == Row::Missing, "{}", w.op[51]);
    for k in (21..380).step_by(2) {
        record.pv[k].quality = Quality::Bad(BadReason::Timeout);
    }
    assert!(matches!(reason(&record), NotIdentifiable::Gaps { .. }));
}

#[test]
fn tags_that_are_read_apart_are_told() {
    let in_blocks = |of: f64| {
        let mut record = wave(600, 1.0);
        let is_even = |s: &Sample| (s.t / of).floor() % 2.0 == 0.0;
        record.op.retain(is_even);
        record.pv.retain(|s| !is_even(s));
        record
    };
    // No row has both, and beyond the longest hole no stretch has.
    for of in [3.0, 7.0, 100.0] {
        assert_eq!(reason(&in_blocks(of)), NotIdentifiable::ReadApart { share: 1.0 }, "{of}");
    }
    // Of rows with either one, those with both are the fewer.
    let joined = |before: Vec<Sample>, then: Vec<Sample>| -> Vec<Sample> {
        before.into_iter().chain(then.into_iter().filter(|s| s.t >= 100.0)).collect()
    };
    let (both, apart) = (wave(100, 1.0), in_blocks(7.0));
    let record = Record { op: joined(both.op, apart.op), pv: joined(both.pv, apart.pv), ..Record::default() };
    assert!(matches!(reason(&record), NotIdentifiable::ReadApart { share } if (0.8..0.9).contains(&share)));
    let (_, p) = gate(&in_blocks(1.0), &Settings::default()).expect("each row has both, read apart");
    assert_eq!((p.read_apart.share, p.apart()), (1.0, Some(NotIdentifiable::ReadApart { share: 1.0 })));
    let (_, p) = gate(&wave(600, 1.0), &Settings::default()).expect("passes");
    assert_eq!((p.read_apart.share, p.apart()), (0.0, None));
    // In a fitted row of four polls the two are near each other.
    let (_, p) = gate(&in_blocks(1.0), &Settings::default()).expect("each row has both, read apart");
    let of = |decimation: usize| Preparation { decimation, ..p.clone() }.apart().is_some();
    assert_eq!([of(1), of(5)], [true, false], "{:?}", p.read_apart);
}

#[test]
fn a_sample_period_below_that_of_the_samples_is_told_with_both() {
    let record = wave(600, 2.0);
    let with = |record: &Record, ts: f64| -> Gated {
        let settings = Settings { ts: Some(ts), ..Settings::default() };
        let (window, mut p) = gate(record, &settings)?;
        let (window, _) = prepare(window, &settings, &mut p);
        match p.too_close() {
            Some(reason) => Err(Box::new((reason, p))),
            None => Ok((window, p)),
        }
    };
    // Also where there would be so many rows that hardly any has a sample.
    for ts in [0.01, 0.7, 1.0, 1.4] {
        let (reason, p) = *with(&record, ts).expect_err("refused");
        assert_eq!(reason, NotIdentifiable::TsTooShort { ts, samples_s: 2.0 });
        assert!(reason.to_string().contains(&format!("rows every {ts} s")), "{reason}");
        assert!(reason.to_string().contains("set ts to 2 or more"), "{reason}");
        assert_eq!(p.acquisition.expect("told").poll_s, Some(2.0));
    }
    for ts in [2.0, 4.0] {
        let (w, p) = with(&wave(900, 2.0), ts).expect("passes");
        assert_eq!((w.ts, p.apart()), (ts, None));
    }
    // Where hardly a row repeats a reading, or a fitted row has several readings, the others decide.
    for ts in [1.6, 1.8] {
        assert!(with(&record, ts).is_ok(), "{ts}");
    }
    let (_, mut p) = *with(&record, 1.0).expect_err("refused");
    p.decimation = 8;
    assert_eq!(p.too_close(), None);
    // The slower of both says what to set.
    let mut slower = wave(1200, 1.0);
    slower.op.retain(|s| s.t % 5.0 == 0.0);
    slower.pv.retain(|s| s.t % 2.0 == 0.0);
    let (reason, _) = *with(&slower, 1.0).expect_err("refused");
    assert_eq!(reason, NotIdentifiable::TsTooShort { ts: 1.0, samples_s: 5.0 });
    assert!(with(&slower, 5.0).is_ok());
}

#[test]
fn op_that_is_read_later_in_the_scan_is_of_one_scan_where_it_answers_pv_of_its_row() {
    // PV that no other row tells, and OP that a PI controller computes of it or that answers PVs between the rows, too.
    let noise = |k: usize| ((k * k * 37 + k * 11) % 101) as f64 / 101.0 - 0.5;
    let pv = |k: usize| 50.0 + 2.0 * (k as f64 * 0.1).sin() + noise(k);
    let record = |scans_a_row: usize, op_after: usize, later_s: f64| {
        let (mut integral, mut record) = (0.0, Record::default());
        for k in 0..600 * scans_a_row {
            integral += 0.1 * (50.0 - pv(k));
            let row = |scan: usize| k % scans_a_row == scan;
            let t = (k / scans_a_row) as f64;
            if row(0) {
                record.pv.push(Sample::good(t, pv(k)));
            }
            if row(op_after) {
                record.op.push(Sample::good(t + later_s, 40.0 + 0.8 * (50.0 - pv(k)) + integral));
            }
        }
        record
    };
    for later_s in [0.3, 0.4, 0.48] {
        let (_, p) = gate(&record(1, 0, later_s), &Settings::default()).expect("passes");
        assert_eq!((p.read_apart.share, p.apart()), (0.0, None), "{later_s}");
        // The same stamps, but the controller scans five times a row.
        let (_, p) = gate(&record(5, 2, later_s), &Settings::default()).expect("passes");
        assert_eq!(p.apart(), Some(NotIdentifiable::ReadApart { share: 1.0 }), "{later_s}");
    }
}

#[test]
fn a_long_hole_leaves_the_longer_side() {
    let mut record = wave(800, 1.0);
    record.op.drain(300..400);
    let (w, _) = gate(&record, &Settings::default()).expect("passes");
    assert_eq!((w.t0, w.len()), (400.0, 400));
}

#[test]
fn drop_outs_to_zero_are_not_measurements() {
    let mut record = wave(500, 1.0);
    for s in &mut record.pv[100..103] {
        s.value = 0.0;
    }
    let (w, p) = gate(&record, &Settings::default()).expect("passes");
    assert!(w.pv.iter().all(|v| *v > 40.0));
    assert!((p.gap_share - 3.0 / 500.0).abs() < 1e-12);
    // What loggers write where nothing was measured, also more than one of it.
    for (k, value) in [-9999.0, -32_768.0, 65_535.0, -999.25].into_iter().enumerate() {
        record.pv[200 + 10 * k].value = value;
    }
    let (w, p) = gate(&record, &Settings::default()).expect("passes");
    assert!(w.pv.iter().all(|v| (40.0..70.0).contains(v)));
    assert!((p.gap_share - 7.0 / 500.0).abs() < 1e-12);
}

#[test]
fn a_tag_that_lives_near_such_a_value_has_it() {
    let mut record = wave(500, 1.0);
    let (low, high) =
        record.pv.iter().fold((f64::MAX, f64::MIN), |(l, h), s| (l.min(s.value), h.max(s.value)));
    for s in &mut record.pv {
        s.value = 990.0 + 20.0 * (s.value - low) / (high - low);
    }
    record.pv[100].value = 999.0;
    assert!(outages(&record.pv).is_empty());
    record.pv[100].value = 0.0;
    assert_eq!(outages(&record.pv), [0.0]);
}

#[test]
fn every_reason_is_reached() {
    let record = wave(300, 1.0);
    let settings = |change: &dyn Fn(&mut Record)| {
        let mut r = record.clone();
        change(&mut r);
        reason(&r)
    };
    assert_eq!(reason(&wave(50, 1.0)), NotIdentifiable::TooShort { n: 50, need: 200 });
    assert_eq!(reason(&Record::default()), NotIdentifiable::TooShort { n: 0, need: 200 });
    let flat = |series: &mut Vec<Sample>| series.iter_mut().for_each(|s| s.value = 7.0);
    assert_eq!(settings(&|r| flat(&mut r.op)), NotIdentifiable::FlatOp);
    assert_eq!(settings(&|r| flat(&mut r.pv)), NotIdentifiable::FlatPv);
    assert_eq!(settings(&|r| r.pv.iter_mut().for_each(|s| s.t = 5.0)), NotIdentifiable::NoTimeBase);
    assert_eq!(settings(&|r| r.pv.iter_mut().for_each(|s| s.value = 1e308)), NotIdentifiable::OutOfScale);
    assert_eq!(
        settings(&|r| r.pv.iter_mut().for_each(|s| s.quality = Quality::Stale)),
        NotIdentifiable::FlatPv
    );
    let top = |r: &mut Record| r.op.iter_mut().for_each(|s| s.value = s.value.min(50.3));
    assert!(matches!(settings(&top), NotIdentifiable::Saturated { share } if share > 0.3));
    let manual = |r: &mut Record| {
        r.mode = Some(r.op.iter().map(|s| Sample::good(s.t, f64::from(u8::from(s.t < 60.0)))).collect());
    };
    // 60 s of 299 s.
    let share = 60.0 / 299.0;
    assert!(
        matches!(settings(&manual), NotIdentifiable::Manual { share_auto } if (share_auto - share).abs() < 1e-4)
    );
}

#[test]
fn a_valve_at_its_stop_is_saturated_and_not_merely_flat() {
    let mut record = wave(300, 1.0);
    record.op.iter_mut().for_each(|s| s.value = 100.0);
    record.op_limits = Some((0.0, 100.0));
    assert_eq!(reason(&record), NotIdentifiable::Saturated { share: 1.0 });
    record.op_limits = Some((0.0, 120.0));
    assert_eq!(reason(&record), NotIdentifiable::FlatOp);
}

#[test]
fn a_mode_that_is_lost_for_a_moment_cuts_no_stretch() {
    let unknown = |at: &[usize]| {
        let mut record = wave(600, 1.0);
        let mut mode: Vec<Sample> = record.op.iter().map(|s| Sample::good(s.t, 1.0)).collect();
        for &k in at {
            mode[k] = Sample { value: f64::NAN, quality: Quality::Bad(BadReason::Timeout), ..mode[k] };
        }
        record.mode = Some(mode);
        record
    };
    // One poll in fifty without an answer, as OP and PV may be.
    let lost: Vec<usize> = (25..600).step_by(50).collect();
    assert_eq!(gate(&unknown(&lost), &Settings::default()).expect("passes").0.len(), 600);
    // Unknown for longer than a hole may be, it is no longer known to be automatic.
    let lost: Vec<usize> = (300..310).collect();
    let (w, _) = gate(&unknown(&lost), &Settings::default()).expect("passes");
    assert_eq!((w.t0, w.len()), (0.0, 300));
    let lost: Vec<usize> = (300..600).collect();
    assert_eq!(gate(&unknown(&lost), &Settings::default()).expect("passes").0.len(), 300);
}

#[test]
fn a_mode_is_counted_in_time() {
    // Sent when it changes: in automatic for 120 s and 60 s of 3,599 s.
    let mut record = wave(3600, 1.0);
    let changes = [(0.0, 1.0), (120.0, 0.0), (3480.0, 1.0), (3540.0, 0.0)];
    record.mode = Some(changes.into_iter().map(|(t, value)| Sample::good(t, value)).collect());
    let NotIdentifiable::Manual { share_auto } = reason(&record) else { panic!("{}", reason(&record)) };
    assert!((share_auto - 180.0 / 3599.0).abs() < 1e-4, "{share_auto}");
    assert!(reason(&record).to_string().starts_with("manual: in automatic for 5 % of the window"));
    record.mode = Some(vec![Sample::good(0.0, 0.0)]);
    assert_eq!(reason(&record).to_string(), "manual: never in automatic");
}

#[test]
fn a_mode_that_cannot_be_read_is_not_told_to_be_manual() {
    let mut record = wave(600, 1.0);
    let bad = |t: f64| Sample { t, value: f64::NAN, quality: Quality::Bad(BadReason::Timeout) };
    // None of its samples is good, or there is none yet.
    for mode in [(0..600).map(|k| bad(f64::from(k))).collect(), Vec::new()] {
        record.mode = Some(mode);
        assert_eq!(reason(&record), NotIdentifiable::ModeUnknown { share: 1.0 });
    }
    // Lost after a minute in automatic: it may have been so all along.
    let series = |part: &dyn Fn(f64) -> Sample| Some((0..600).map(|k| part(f64::from(k))).collect());
    record.mode = series(&|t| if t < 60.0 { Sample::good(t, 1.0) } else { bad(t) });
    let found = reason(&record);
    let share = 539.0 / 599.0;
    assert!(
        matches!(found, NotIdentifiable::ModeUnknown { share: own } if (own - share).abs() < 1e-3),
        "{found}"
    );
    assert!(found.to_string().starts_with("mode unknown: the mode cannot be read for 90 % of the window"));
    // Lost for a while between two times in manual: whatever it was, that was too short.
    record.mode = series(&|t| if (150.0..300.0).contains(&t) { bad(t) } else { Sample::good(t, 0.0) });
    assert_eq!(reason(&record), NotIdentifiable::Manual { share_auto: 0.0 });
    // In manual now: what was before the tag came is not asked, unless that was most of the time.
    let since = |from: f64| (0..600).map(f64::from).filter(move |t| *t >= from).map(|t| Sample::good(t, 0.0));
    record.mode = Some(since(290.0).collect());
    assert_eq!(reason(&record), NotIdentifiable::Manual { share_auto: 0.0 });
    record.mode = Some(since(310.0).collect());
    assert!(matches!(reason(&record), NotIdentifiable::ModeUnknown { .. }));
    // And of one that is lost at the end it is not known how it is now.
    let lost = (560..600).map(|k| bad(f64::from(k)));
    record.mode = Some(since(290.0).filter(|s| s.t < 560.0).chain(lost).collect());
    assert!(matches!(reason(&record), NotIdentifiable::ModeUnknown { .. }));
}

#[test]
fn one_stamp_far_away_does_not_make_a_huge_grid() {
    let mut record = wave(300, 1.0);
    record.op.push(Sample::good(1e18, 1.0));
    record.pv.push(Sample::good(1e18, 1.0));
    assert_eq!(gate(&record, &Settings::default()).expect("passes").0.len(), 300);
}

#[test]
fn a_loop_at_its_limit_for_part_of_the_time_is_judged_by_the_rest() {
    let mut record = wave(900, 1.0);
    for s in &mut record.op[300..700] {
        s.value = 100.0;
    }
    record.op_limits = Some((0.0, 100.0));
    let (w, p) = gate(&record, &Settings::default()).expect("passes");
    assert_eq!(
        (w.counted(), w.row(299), w.row(300), w.row(700)),
        (500, Row::Counts, Row::Silent, Row::Counts)
    );
    assert_eq!((p.gap_share, p.missing), (0.0, 0.0));
    record.op[100..850].iter_mut().for_each(|s| s.value = 100.0);
    let share = 750.0 / 900.0;
    assert_eq!(reason(&record), NotIdentifiable::Saturated { share });
}

#[test]
fn a_valve_that_op_shuts_is_at_its_limit_and_not_lost() {
    // OP is zero for 40 % of the time, and far from it else.
    let shut = |n: usize| {
        let mut record = wave(n, 1.0);
        for s in record.op.iter_mut().filter(|s| s.t % 100.0 < 40.0) {
            s.value = 0.0;
        }
        record
    };
    let limits = Some((0.0, 100.0));
    assert!(matches!(reason(&shut(300)), NotIdentifiable::Gaps { .. }), "nobody knows that zero is a limit");
    let record = Record { op_limits: limits, ..shut(300) };
    assert_eq!(reason(&record), NotIdentifiable::Saturated { share: 0.4 });
    // What is left between the limits is judged, where it is enough.
    let (w, p) = gate(&Record { op_limits: limits, ..shut(600) }, &Settings::default()).expect("passes");
    assert_eq!((w.counted(), p.gap_share, w.row(39), w.row(40)), (360, 0.0, Row::Silent, Row::Counts));
    // A link that was lost wrote zero into both: then OP is not known either.
    let mut lost = Record { op_limits: limits, ..wave(600, 1.0) };
    for tag in [&mut lost.op, &mut lost.pv] {
        tag[300..303].iter_mut().for_each(|s| s.value = 0.0);
    }
    let (w, _) = gate(&lost, &Settings::default()).expect("passes");
    assert!((300..303).all(|k| w.row(k) == Row::Missing && w.op[k] > 40.0), "{:?}", &w.op[300..303]);
}

#[test]
fn one_zero_of_a_logger_is_no_stroke_of_the_valve() {
    // OP and stem between 40 and 60 %, PV without a flaw, and zero is a limit.
    let mut record = Record { op_limits: Some((0.0, 100.0)), ..wave(600, 1.0) };
    record.op.iter_mut().for_each(|s| s.value = 50.0 + 10.0 * (s.value - 50.0));
    record.mv = Some(record.op.clone());
    let lone = |record: &mut Record, many: usize| {
        for tag in [&mut record.op, record.mv.as_mut().expect("there is one")] {
            tag[300..300 + many].iter_mut().for_each(|s| s.value = 0.0);
        }
        gate(record, &Settings::default()).expect("passes").0
    };
    for many in [1, 4] {
        let w = lone(&mut record, many);
        let zeros = (0..600).filter(|k| w.op[*k] < 39.0 || w.mv.as_ref().is_some_and(|mv| mv[*k] < 39.0));
        assert_eq!((zeros.count(), 600 - w.counted(), w.row(300)), (0, many, Row::Missing));
    }
    let w = lone(&mut record, 5);
    assert_eq!((w.counted(), w.op[302], w.mv.expect("there is one")[302]), (600, 0.0, 0.0));
}

#[test]
fn two_polls_a_scan_are_one_row() {
    let mut record = Record::default();
    for k in 0..1200 {
        let (t, scan) = (f64::from(k) * 0.5, f64::from(k / 2));
        record.op.push(Sample::good(t, 50.0 + (0.2 * scan).sin()));
        record.pv.push(Sample::good(t, 50.0 + (0.2 * scan + 1.0).sin()));
    }
    let (w, p) = gate(&record, &Settings::default()).expect("passes");
    assert!((w.ts - 1.0).abs() < 1e-3 && w.len() >= 599, "{} {}", w.ts, w.len());
    let acquired = p.acquisition.expect("told");
    assert!(acquired.recovered && p.history.is_none());
    assert!(w.op.windows(2).all(|two| two[0] != two[1]));
}

#[test]
fn through_a_hole_op_goes_on_and_all_other_rows_count() {
    let mut record = wave(400, 1.0);
    // OP turns in the hole: its crest is at row 102.
    record.op.drain(98..106);
    record.op.remove(200);
    let (w, _) = gate(&record, &Settings::default()).expect("passes");
    let missing = |k: &usize| (98..106).contains(k) || *k == 208;
    assert!((0..400).all(|k| w.row(k) == if missing(&k) { Row::Missing } else { Row::Counts }));
    let off = (0..400).map(|k| (w.op[k] - 50.0 - (0.2 * k as f64).sin()).abs()).fold(0.0, f64::max);
    assert!(off < 1e-3, "{off}");
}

#[test]
fn a_set_point_that_did_not_change_in_the_window_is_known_all_the_same() {
    let mut record = wave(300, 1.0);
    let sp = |record: &Record| gate(record, &Settings::default()).expect("passes").0.sp;
    for before in [vec![(-9000.0, 47.0)], vec![(-9000.0, 20.0), (-8000.0, 30.0), (-7999.0, 47.0)]] {
        record.sp = Some(before.into_iter().map(|(t, value)| Sample::good(t, value)).collect());
        assert_eq!(sp(&record), Some(vec![47.0; 300]));
    }
    // A change in the window comes after what was in force until then, however long ago that was reported.
    let changes = [(-9000.0, 47.0), (150.0, 50.0), (155.0, 51.0), (160.0, 52.0)];
    record.sp = Some(changes.into_iter().map(|(t, value)| Sample::good(t, value)).collect());
    let values = sp(&record).expect("known");
    assert_eq!((values[0], values[100], values[152], values[299]), (47.0, 47.0, 50.0, 52.0));
    // One that could not be read since is not known to be what it was.
    let lost = Sample { t: -5.0, value: f64::NAN, quality: Quality::Bad(BadReason::LinkDown) };
    record.sp = Some(vec![Sample::good(-9000.0, 47.0), lost]);
    assert_eq!(sp(&record), None);
    // Another tag may be a measurement that has ended: it is not carried on.
    record.mv = Some(vec![Sample::good(-9000.0, 47.0)]);
    assert_eq!(gate(&record, &Settings::default()).expect("passes").0.mv, None);
}

#[test]
fn zeros_of_set_points_and_pumps_are_values() {
    let mut record = wave(500, 1.0);
    let series = |value: &dyn Fn(usize) -> f64| -> Vec<Sample> {
        (0..500).map(|k| Sample::good(k as f64, value(k))).collect()
    };
    // On for 60 % of the time, and a set point that is zero for 30 % of it.
    let pump = |k: usize| f64::from(u8::from(k % 10 < 6));
    let level = |k: usize| if (200..350).contains(&k) { 0.0 } else { 50.0 };
    record.tags = vec![("pump".into(), series(&pump))];
    record.sp = Some(series(&level));
    // A link that was lost wrote zero into all of them.
    for k in 100..103 {
        for tag in [&mut record.op, &mut record.pv] {
            tag[k].value = 0.0;
        }
        record.sp.as_mut().expect("there is one")[k].value = 0.0;
    }
    let (w, _) = gate(&record, &Settings::default()).expect("passes");
    let same = |values: &[f64], truth: &dyn Fn(usize) -> f64| {
        (0..500).filter(|k| w.row(*k) == Row::Counts).all(|k| values[k] == truth(k))
    };
    let sp = w.sp.as_deref().expect("recorded");
    assert!(same(&w.tags[0].1, &pump) && same(sp, &level));
    assert_eq!((w.row(101), sp[101]), (Row::Missing, 50.0));
    // What stands for none is none in any tag that moves.
    let ramp = |k: usize| if k == 250 { -9999.0 } else { 50.0 + 0.01 * k as f64 };
    record.sp = Some(series(&ramp));
    let (w, _) = gate(&record, &Settings::default()).expect("passes");
    assert!(w.sp.expect("recorded").iter().all(|value| *value >= 50.0));
}

#[test]
fn a_stem_that_is_read_more_slowly_than_op_is_not_used() {
    let mut record = wave(600, 1.0);
    let stem = |every: usize| -> Vec<Sample> {
        (0..600).step_by(every).map(|k| Sample::good(k as f64, 50.0 + (k as f64 * 0.2).sin())).collect()
    };
    let mv = |record: &Record| gate(record, &Settings::default()).expect("passes").0.mv;
    record.mv = Some(stem(1));
    assert_eq!(mv(&record).expect("as fast").len(), 600);
    // One that lost a poll now and then is as fast as before.
    record.mv.as_mut().expect("there is one").retain(|s| s.t % 20.0 != 7.0);
    assert!(mv(&record).is_some());
    for every in [2, 10] {
        record.mv = Some(stem(every));
        assert_eq!(mv(&record), None, "every {every} s");
        // Another tag, which is no stem, is held.
        let tags = vec![("flow".into(), stem(every))];
        let w = gate(&Record { tags, ..record.clone() }, &Settings::default()).expect("passes").0;
        assert_eq!((w.tags[0].1[10], w.tags[0].1[11]), (50.0 + 2.0_f64.sin(), 50.0 + 2.0_f64.sin()));
    }
}
