use super::*;
use crate::sim::acquisition::{Acquisition as How, Gaps, Poll, Scans, acquire};

/// A loop's values at its scans: all different, as noise makes them.
fn scans(n: usize, scan_s: f64) -> Scans {
    let value = |k: usize, w: f64| 50.0 + (w * k as f64).sin() + 1e-3 * (1.7 * k as f64).cos();
    Scans {
        t0: 1000.0,
        scan_s,
        op: (0..n).map(|k| value(k, 0.11)).collect(),
        pv: (0..n).map(|k| value(k, 0.07)).collect(),
        ..Scans::default()
    }
}

/// What is recognised by the usual limits.
fn recognised(op: &[Sample], pv: &[Sample], ts: Option<f64>) -> Option<(Acquisition, Placed)> {
    recognise(op, pv, ts, None, ReadingLimits::default())
}

/// What is recognised of a polled record, and OP and PV on its rows.
fn seen(scans: &Scans, how: &How, seed: u64) -> (Acquisition, [Vec<Option<f64>>; 2]) {
    let record = acquire(scans, how, seed);
    let (found, placed) = recognised(&record.op, &record.pv, None).expect("stamps give a period");
    let from = placed.row_of(record.pv[0].t) as i64;
    let n = (placed.row_of(record.pv[record.pv.len() - 1].t) as i64 - from + 1) as usize;
    (found, [placed.op(&record.op, from, n), placed.pv(&record.pv, from, n)])
}

/// Share of the rows whose OP and PV are of one scan, each row one scan after the one before; missing rows left out.
fn in_step(scans: &Scans, [op, pv]: &[Vec<Option<f64>>; 2]) -> f64 {
    let of = |values: &[f64], value: Option<f64>| values.iter().position(|v| Some(*v) == value);
    let places = op.iter().zip(pv).enumerate().filter_map(|(row, (op, pv))| {
        let (op, pv) = (of(&scans.op, *op)? as i64, of(&scans.pv, *pv)? as i64);
        Some((op - row as i64, pv - row as i64))
    });
    let mut places: Vec<(i64, i64)> = places.collect();
    places.sort_unstable();
    // One row on the wrong side of a scan must not move all others.
    let usual = places[places.len() / 2].0;
    places.iter().filter(|place| **place == (usual, usual)).count() as f64 / places.len() as f64
}

#[test]
fn two_polls_a_scan_are_one_sample_at_its_tick() {
    let scans = scans(400, 2.0);
    for (phase, period) in [(0.1, 1.0), (0.7, 1.0003), (0.3, 0.83)] {
        let poll = Poll { phase, jitter: 0.05, ..Poll::every(period) };
        let (found, rows) = seen(&scans, &How::Polled(poll), 1);
        assert!(found.recovered, "{phase} {period}");
        let scan = found.scan_s.expect("recovered");
        assert!((scan / 2.0 - 1.0).abs() < 2e-4, "{scan}");
        assert!((found.poll_s.expect("polled") / period - 1.0).abs() < 1e-3);
        assert!((found.jitter_s.expect("polled") / (0.05 * period) - 1.0).abs() < 0.2);
        assert!((found.polls_per_scan.expect("polled") - 2.0 / period).abs() < 0.01);
        assert_eq!(in_step(&scans, &rows), 1.0, "{phase} {period}");
        // Every scan was read at least once, but where polls are almost as slow as scans.
        assert!(rows[0].iter().all(Option::is_some));
    }
}

#[test]
fn a_scan_between_two_polls_is_missing_and_not_made_up() {
    let scans = scans(600, 1.0);
    // At the edge of the scans a poll with jitter reads some twice and others never.
    let poll = Poll { phase: 0.98, jitter: 0.05, ..Poll::every(1.0) };
    let (found, rows) = seen(&scans, &How::Polled(poll), 2);
    assert!(found.recovered);
    // Next to a scan's instant stamps cannot tell to which side of it a poll belongs.
    let right = in_step(&scans, &rows);
    assert!(right > 0.97, "{right}");
    let missing = rows[0].iter().filter(|value| value.is_none()).count();
    assert!((60..240).contains(&missing), "{missing}");
}

#[test]
fn pv_read_late_is_put_beside_its_op() {
    let scans = scans(400, 2.0);
    for phase in [0.05, 0.35, 0.65, 0.95] {
        let poll = Poll { phase, jitter: 0.03, pv_late: 0.3, ..Poll::every(1.0) };
        let (found, rows) = seen(&scans, &How::Polled(poll), 3);
        assert!(found.recovered, "{phase}");
        assert!(in_step(&scans, &rows) > 0.99, "{phase}");
    }
}

#[test]
fn polls_slower_than_scans_stay_on_the_polls() {
    let poll = Poll { phase: 0.4, jitter: 0.05, ..Poll::every(2.3) };
    let (found, rows) = seen(&scans(800, 1.0), &How::Polled(poll), 4);
    assert_eq!((found.recovered, found.scan_s, found.polls_per_scan), (false, None, None));
    assert!((found.poll_s.expect("polled") - 2.3).abs() < 1e-3);
    assert_eq!(
        found.sentence().as_deref(),
        Some(
            "the controller may act between two samples: for a narrower interval of f take at least two samples per scan"
        )
    );
    // Each poll is a row of its own, and none is between two.
    assert!(rows.iter().flatten().all(Option::is_some));
}

#[test]
fn what_is_newer_at_every_poll_is_not_held() {
    let mut scans = scans(900, 1.0);
    // OP is written every third sample, PV is measured at each.
    scans.op = (0..900).map(|k| scans.op[k - k % 3]).collect();
    let (found, _) = seen(&scans, &How::Polled(Poll { phase: 0.5, jitter: 0.05, ..Poll::every(1.0) }), 5);
    assert!(!found.recovered);
}

#[test]
fn lost_polls_are_missing_rows() {
    let scans = scans(1000, 1.0);
    for gaps in [
        Gaps::Random { share: 0.3 },
        Gaps::Bursts { share: 0.3, length: 8.0 },
        Gaps::Periodic { every: 10, lost: 3 },
    ] {
        let (_, rows) = seen(&scans, &How::Polled(Poll { phase: 0.5, gaps, ..Poll::every(1.0) }), 6);
        assert_eq!(in_step(&scans, &rows), 1.0, "{gaps:?}");
        let missing = rows[0].iter().filter(|value| value.is_none()).count() as f64 / rows[0].len() as f64;
        // Bursts of 8 in 1,000 polls: three standard errors of their share are 0.12.
        assert!((missing - 0.3).abs() < 0.12, "{missing} {gaps:?}");
    }
}

#[test]
fn changes_with_the_controllers_stamps_are_held_exactly() {
    let mut scans = scans(500, 0.5);
    let coarse = |v: &f64| (v * 20.0).round() / 20.0;
    scans.op = scans.op.iter().map(coarse).collect();
    scans.pv = scans.pv.iter().map(coarse).collect();
    let (found, [op, pv]) = seen(&scans, &How::OnChange { dead_band: 0.0 }, 7);
    assert_eq!((found.recovered, found.scan_s), (true, Some(0.5)));
    let all = |rows: &[Option<f64>]| rows.iter().map(|v| v.expect("held")).collect::<Vec<f64>>();
    let n = op.len();
    assert!(n > 480);
    assert_eq!((all(&op), all(&pv)), (scans.op[..n].to_vec(), scans.pv[..n].to_vec()));
}

#[test]
fn a_slower_tag_is_held_between_its_samples() {
    let pv: Vec<Sample> = (0..100).map(|k| Sample::good(f64::from(k), f64::from(k))).collect();
    let op: Vec<Sample> = (0..50).map(|k| Sample::good(f64::from(2 * k), f64::from(k))).collect();
    let (_, placed) = recognised(&op, &pv, None).expect("stamps");
    let values = |rows: Vec<Option<f64>>| rows.into_iter().map(|v| v.expect("held")).collect::<Vec<f64>>();
    assert_eq!(values(placed.op(&op, 4, 4)), [2.0, 2.0, 3.0, 3.0]);
}

#[test]
fn what_is_read_in_turns_is_no_change_that_a_controller_reports() {
    /// Whether a tag is read at scan k.
    type IsRead = fn(usize) -> bool;
    // Steep ramps: no change is small, as where small ones are left out.
    let tag = |there: IsRead| -> Vec<Sample> {
        (0..900).filter(|k| there(*k)).map(|k| Sample::good(k as f64, k as f64)).collect()
    };
    let readings: [(&str, IsRead, IsRead, f64); 6] = [
        ("in turns", |k| k.is_multiple_of(2), |k| k % 2 == 1, 1.0),
        ("three in turns", |k| k.is_multiple_of(3), |k| k % 3 == 1, 1.0),
        ("second and third", |k| k.is_multiple_of(2), |k| k.is_multiple_of(3), 0.5),
        ("OP half as often", |k| k.is_multiple_of(2), |_| true, 0.5),
        ("in blocks", |k| (k / 7).is_multiple_of(2), |k| k / 7 % 2 == 1, 0.0),
        ("together", |k| k.is_multiple_of(2), |k| k.is_multiple_of(2), 0.0),
    ];
    for (name, op, pv, expected) in readings {
        let (op, pv) = (tag(op), tag(pv));
        let (found, placed) = recognised(&op, &pv, None).expect("stamps give a period");
        assert!(!found.recovered, "{name}");
        // Of blocks no row has both.
        let apart = placed.read_apart(&op, &pv, 0, 280).share;
        assert!((apart - expected).abs() < 0.01, "{name}: {apart}");
    }
    // Rows that are asked for between the samples have no reading of their own.
    let (op, pv) = (tag(|_| true), tag(|_| true));
    let (_, placed) = recognised(&op, &pv, Some(0.5)).expect("a period is given");
    assert!((placed.read_apart(&op, &pv, 0, 280).share - 0.5).abs() < 0.01);
    // A tenth of a period hardly leaves the controller time to act.
    let later = |by: f64| -> Vec<Sample> { op.iter().map(|s| Sample { t: s.t + by, ..*s }).collect() };
    let late = later(0.1);
    let (_, placed) = recognised(&late, &pv, None).expect("stamps give a period");
    assert_eq!(placed.read_apart(&late, &pv, 0, 280).share, 0.0);
    // Four tenths do, unless OP tells that it did not act.
    let late = later(0.4);
    let (_, mut placed) = recognised(&late, &pv, None).expect("stamps give a period");
    assert_eq!(placed.read_apart(&late, &pv, 0, 280).share, 1.0);
    placed.of_one_scan = true;
    assert_eq!(placed.read_apart(&late, &pv, 0, 280).share, 0.0);
    // That OP was computed from PV of its row says nothing of the rows that it is carried on to.
    let half: Vec<Sample> = op.iter().step_by(2).copied().collect();
    let (_, mut placed) = recognised(&half, &pv, None).expect("stamps give a period");
    placed.of_one_scan = true;
    assert!((placed.read_apart(&half, &pv, 0, 280).share - 0.5).abs() < 0.01);
}

#[test]
fn rows_that_are_closer_than_readings_are_told_with_the_interval_of_the_readings() {
    let every = |pace: usize| -> Vec<Sample> {
        (0..900).step_by(pace).map(|k| Sample::good(k as f64, k as f64)).collect()
    };
    let coarser = |op: &[Sample], pv: &[Sample], ts: f64| {
        let (_, placed) = recognised(op, pv, Some(ts)).expect("a period is given");
        placed.coarser_readings(op, pv).map(|carried| carried.samples_s)
    };
    let (one, two, five) = (every(1), every(2), every(5));
    // A whole number of rows from reading to reading or not, whatever the ramp looks like.
    for ts in [0.01, 0.3, 0.45, 0.5, 0.8] {
        assert_eq!(coarser(&one, &one, ts), Some(1.0), "{ts}");
        assert_eq!(coarser(&one, &two, ts), Some(2.0), "{ts}");
        assert_eq!(coarser(&five, &two, ts), Some(5.0), "{ts}");
    }
    for ts in [0.95, 1.0, 2.0, 7.0] {
        assert_eq!(coarser(&one, &one, ts), None, "{ts}");
    }
    // Each row has a PV of its own; that OP is carried on is another matter.
    assert_eq!(coarser(&five, &one, 1.0), None);
    // Without a sample, a tag whose changes alone are reported has not changed.
    let changes: Vec<Sample> =
        (0..900).filter(|k| matches!(k % 7, 0 | 3 | 5)).map(|k| Sample::good(k as f64, k as f64)).collect();
    // The scan of its stamps stays what it was, however many rows are asked for in it.
    let most: Vec<Sample> =
        (0..900).filter(|k| k % 5 != 3).map(|k| Sample::good(k as f64, k as f64)).collect();
    for ts in [0.1, 0.25, 1.0 / 3.0, 0.5, 1.0] {
        assert_eq!((coarser(&changes, &changes, ts), coarser(&most, &most, ts)), (None, None), "{ts}");
    }
    // Read at every second scan of the other, it may have changed in between.
    assert_eq!(coarser(&one, &two, 0.5), Some(2.0));
}

#[test]
fn an_op_that_is_reported_when_it_changes_is_known_at_every_scan() {
    // Stamps a hundredth of a scan off, so that they are no source's; OP goes on at three scans of seven.
    let goes_on = |k: usize| matches!(k % 7, 0 | 3 | 5);
    let t = |k: usize| k as f64 + 0.02 * ((k * 31 % 17) as f64 / 17.0 - 0.5);
    let pv: Vec<Sample> = (0..900).map(|k| Sample::good(t(k), (k as f64 * 0.37).sin())).collect();
    let mut op = vec![Sample::good(t(0), 50.0)];
    for k in (1..900).filter(|k| goes_on(*k)) {
        // A step of the converter up or down.
        let up = if (k / 40).is_multiple_of(2) { 0.1 } else { -0.1 };
        op.push(Sample::good(t(k), op[op.len() - 1].value + up));
    }
    let (_, placed) = recognised(&op, &pv, None).expect("stamps give a period");
    let apart = placed.read_apart(&op, &pv, 0, 880);
    assert!(apart.share < 0.01, "{apart:?}");
    // Samples of a ramp that were lost are no changes that were not there: now and then OP says the same twice.
    let mut lost: Vec<Sample> =
        (0..900).filter(|k| goes_on(*k)).map(|k| Sample::good(t(k), k as f64)).collect();
    for k in (20..lost.len()).step_by(20) {
        lost[k].value = lost[k - 1].value;
    }
    let (_, placed) = recognised(&lost, &pv, None).expect("stamps give a period");
    let apart = placed.read_apart(&lost, &pv, 0, 880);
    assert!(apart.share > 0.3, "{apart:?}");
}

#[test]
fn registers_that_are_held_may_be_read_in_turns() {
    let scans = scans(400, 2.0);
    let mut record = acquire(&scans, &How::Polled(Poll { phase: 0.2, ..Poll::every(0.5) }), 8);
    let nth = |series: &mut Vec<Sample>, odd: usize| {
        let mut k = 0;
        series.retain(|_| {
            k += 1;
            k % 2 == odd
        });
    };
    nth(&mut record.op, 1);
    nth(&mut record.pv, 0);
    let (found, placed) = recognised(&record.op, &record.pv, None).expect("stamps give a period");
    assert!(found.recovered);
    let from = placed.row_of(record.pv[0].t) as i64;
    let rows = [placed.op(&record.op, from, 390), placed.pv(&record.pv, from, 390)];
    assert_eq!(
        (in_step(&scans, &rows), placed.read_apart(&record.op, &record.pv, from, 390).share),
        (1.0, 0.0)
    );
}

#[test]
fn the_sentence_is_said_where_it_matters() {
    let twice = Acquisition {
        scan_s: Some(2.0),
        poll_s: Some(1.0),
        jitter_s: Some(0.0),
        polls_per_scan: Some(2.0),
        recovered: true,
        ts_given: false,
        pv_late_s: 0.0,
    };
    assert_eq!(
        twice.sentence().as_deref(),
        Some("polled twice per controller scan of 2 s; diagnosed at the controller's ticks")
    );
    assert_eq!(Acquisition { polls_per_scan: Some(1.02), ..twice }.sentence(), None);
    assert_eq!(Acquisition::default().sentence(), None);
    assert_eq!(
        Acquisition { pv_late_s: 2.0, ..twice }.sentence().as_deref(),
        Some(
            "polled twice per controller scan of 2 s; diagnosed at the controller's ticks; PV is recorded 2 s late: OP reacts \
             before PV shows the change; diagnosed with PV moved back"
        )
    );
}

#[test]
fn polls_that_leave_scans_out_are_told_what_to_do_in_each_case() {
    let slow = Acquisition { poll_s: Some(2.3), jitter_s: Some(0.1), ..Acquisition::default() };
    let said = |found: Acquisition| found.sentence().unwrap_or_default();
    // The period of the scans is not known, so that nothing is said of their number.
    assert_eq!(
        said(slow),
        "the controller may act between two samples: for a narrower interval of f take at least two samples per scan"
    );
    // With a given period the scans are not sought, however fast the polls are.
    let fast = Poll { phase: 0.4, jitter: 0.05, ..Poll::every(0.5) };
    let record = acquire(&scans(400, 1.0), &How::Polled(fast), 4);
    let (given, _) = recognised(&record.op, &record.pv, Some(1.0)).expect("a period is given");
    assert_eq!(
        said(given),
        "the controller may act between two samples: for a narrower interval of f give no sample period and take at \
         least two samples per scan"
    );
    // Without it they are found.
    let (found, _) = recognised(&record.op, &record.pv, None).expect("stamps give a period");
    assert!(said(found).starts_with("polled twice per controller scan of 1 s"), "{}", said(found));
    // Polls that hardly lag behind the scans show them.
    let known = Acquisition { scan_s: Some(2.0), polls_per_scan: Some(0.87), recovered: true, ..slow };
    assert_eq!(
        said(known),
        "about 1.1 controller scans of 2 s pass per poll; diagnosed at the controller's ticks, of which those between polls are \
         missing; poll at least once per scan"
    );
    // Exact stamps are those of the scans.
    assert_eq!(Acquisition { jitter_s: Some(1e-4), ..slow }.sentence(), None);
    let both = said(Acquisition { pv_late_s: 2.3, ..slow });
    assert!(both.contains("two samples per scan; PV is recorded 2.3 s late"), "{both}");
}

#[test]
fn rubbish_is_no_panic() {
    let same = vec![Sample::good(5.0, 1.0); 300];
    assert!(recognised(&same, &same, None).is_none());
    assert!(recognised(&[], &[], None).is_none());
    let wild: Vec<Sample> = (0..300).map(|k| Sample::good(f64::from(k).powi(40), f64::from(k % 2))).collect();
    let _ = recognised(&wild, &wild, None);
    let far = [Sample::good(0.0, 1.0), Sample::good(1e300, 2.0), Sample::good(2e300, 2.0)];
    let _ = recognised(&far, &far, None);
}
