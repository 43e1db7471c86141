use super::*;
use crate::diagnosis::diagnose;
use crate::sim::scenarios;

fn judge(record: &Record, settings: &Settings, _: Option<&Structure>) -> Judged {
    diagnose(record, settings).into()
}

fn series(values: &[f64], ts: f64) -> Vec<Sample> {
    values.iter().enumerate().map(|(k, &value)| Sample::good(k as f64 * ts, value)).collect()
}

/// PV far from zero with a drop-out of `zeros` samples in its middle.
fn with_a_drop_out(zeros: usize) -> Record {
    let wave = |level: f64| (0..600).map(|k| level + (f64::from(k) * 0.1).sin()).collect::<Vec<_>>();
    let (op, mut pv) = (wave(50.0), wave(80.0));
    pv[300..300 + zeros].fill(0.0);
    Record { op: series(&op, 60.0), pv: series(&pv, 60.0), ..Record::default() }
}

#[test]
fn drop_outs_are_marked_bad_and_kept_in_place() {
    let mut record = with_a_drop_out(7);
    record.pv.reverse();
    let marked = Marked::from(record);
    assert_eq!(marked.drop_outs, [0, 7]);
    let pv = marked.past.all("pv");
    assert_eq!(pv.len(), 600);
    let bad: Vec<f64> = pv.iter().filter(|s| !s.quality.is_good()).map(|s| s.t / 60.0).collect();
    assert_eq!(bad, (300..307).map(f64::from).collect::<Vec<_>>());
    // An OP that shuts the valve keeps its zeros, where zero is known to be its limit.
    let mut shut = with_a_drop_out(0);
    shut.op[100..200].iter_mut().for_each(|s| s.value = 0.0);
    assert_eq!(Marked::from(shut.clone()).drop_outs, [100, 0]);
    shut.op_limits = Some((0.0, 100.0));
    assert_eq!(Marked::from(shut.clone()).drop_outs, [0, 0]);
    // One that is alone is what a logger wrote.
    shut.op[400].value = 0.0;
    assert_eq!(Marked::from(shut).drop_outs, [1, 0]);
    // A signal that lives around zero keeps its zeros.
    let mut around: Vec<f64> = (0..600).map(|k| (f64::from(k) * 0.1).sin()).collect();
    around[0] = 0.0;
    let record = Record { op: series(&around, 1.0), pv: series(&around, 1.0), ..Record::default() };
    assert_eq!(Marked::from(record).drop_outs, [0, 0]);
}

#[test]
fn windows_end_with_the_record_and_hold_what_lies_between() {
    let id = LoopId::new("A");
    let cut = Cut { window_s: 600.0, step_s: 250.0 };
    let seen = std::cell::RefCell::new(Vec::new());
    let judge = |record: &Record, settings: &Settings, known: Option<&Structure>| {
        seen.borrow_mut().push((record.pv[0].t, record.pv[record.pv.len() - 1].t, record.pv.len()));
        judge(record, settings, known)
    };
    let record = Record { op: series(&[1.0; 101], 10.0), pv: series(&[1.0; 101], 10.0), ..Record::default() };
    let mut told = Vec::new();
    let progress = |done, all| {
        told.push((done, all));
        true
    };
    let found =
        timeline(&id, record.into(), cut, &Settings::default(), &alarm::Config::default(), &judge, progress);
    let found = found.expect("the record has windows");
    assert_eq!(*seen.borrow(), [(150.0, 750.0, 61), (400.0, 1000.0, 61)]);
    assert_eq!(told, [(1, 2), (2, 2)]);
    assert_eq!(
        found.items.iter().map(|item| (item.from, item.to)).collect::<Vec<_>>(),
        [(150.0, 750.0), (400.0, 1000.0)]
    );
    assert!(
        found.items.iter().all(|item| item.summary.outcome == "not_identifiable" && item.summary.f.is_none())
    );
    assert!(found.raised.is_empty());
}

#[test]
fn nothing_and_too_much_are_refused() {
    let id = LoopId::new("A");
    let run = |record: Record, step_s| {
        let cut = Cut { window_s: 60.0, step_s };
        timeline(&id, record.into(), cut, &Settings::default(), &alarm::Config::default(), &judge, |_, _| {
            true
        })
    };
    assert_eq!(run(Record::default(), 60.0), Err(BackfillError::Empty));
    let one = Record { pv: series(&[1.0], 1.0), ..Record::default() };
    assert_eq!(run(one, 60.0), Err(BackfillError::Empty));
    let long = with_a_drop_out(0);
    assert!(matches!(run(long, 0.01), Err(BackfillError::TooMany(3_588_001))));
}

#[test]
fn a_valve_that_begins_to_stick_raises_the_alarm_from_then_on() {
    let scenario = |name: &str| {
        let found = scenarios::table2().into_iter().find(|s| s.truth.kind.contains(name));
        found.expect("it is there").run().expect("it can be simulated")
    };
    let (sound, sticky) = (scenario("sinusoidal"), scenario("level control (strong"));
    let ts = sound.t[1] - sound.t[0];
    let op: Vec<f64> = sound.op.iter().chain(&sticky.op).copied().collect();
    let pv: Vec<f64> = sound.pv.iter().chain(&sticky.pv).copied().collect();
    let change = sound.op.len() as f64 * ts;
    let record =
        Record { op: series(&op, ts), pv: series(&pv, ts), op_span: Some(100.0), ..Record::default() };
    let cut = Cut { window_s: 1000.0 * ts, step_s: 500.0 * ts };
    let id = LoopId::new("A");
    let found =
        timeline(&id, record.into(), cut, &Settings::default(), &alarm::Config::default(), &judge, |_, _| {
            true
        });
    let found = found.expect("the record has windows");
    let before = found.items.iter().filter(|item| item.to <= change);
    assert!(before.clone().count() > 2 && before.clone().all(|item| item.summary.outcome != "stiction"));
    let [raised] = found.raised[..] else { panic!("{:?}", found.raised) };
    assert!(
        raised.to.is_none() && raised.from > change && raised.from <= change + 5.0 * cut.step_s,
        "{raised:?} {change}"
    );
    let last = found.items.last().and_then(|item| item.summary.f).expect("f is told");
    assert!((last - 2.5).abs() < 0.1, "{last}");
}

#[test]
fn what_was_marked_keeps_its_count_and_what_is_cancelled_ends() {
    let id = LoopId::new("A");
    let marked = Marked::from(with_a_drop_out(7));
    assert_eq!(marked.drop_outs, [0, 7]);
    let run = |marked: Marked, last: usize| {
        let (cut, settings) = (Cut { window_s: 6000.0, step_s: 6000.0 }, Settings::default());
        timeline(&id, marked, cut, &settings, &alarm::Config::default(), &judge, |done, _| done < last)
    };
    let found = run(marked.clone(), usize::MAX).expect("the record has windows");
    assert_eq!(found.drop_outs, [0, 7]);
    assert!(found.items.len() > 2);
    assert_eq!(run(marked, 2), Err(BackfillError::Cancelled));
}
