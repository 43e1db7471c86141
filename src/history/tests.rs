use super::*;
use crate::signal::{BadReason, Quality};

fn tag(role: Role, source: &str) -> TagSpec {
    TagSpec { kind: TagKind::Role(role), unit: "%".into(), source: source.into() }
}

fn control_loop(name: &str, tags: Vec<TagSpec>) -> LoopTags {
    LoopTags {
        id: LoopId::new(name),
        tags,
        op_limits: Some((0.0, 100.0)),
        op_span: None,
        op_span_source: crate::signal::SpanSource::Unknown,
    }
}

fn two_loops() -> Vec<LoopTags> {
    let mut flow = control_loop("FIC1", vec![tag(Role::Op, "a"), tag(Role::Pv, "b"), tag(Role::Sp, "c")]);
    flow.tags.push(TagSpec {
        kind: TagKind::Extra("upstream".into()),
        unit: "bar".into(),
        source: "d".into(),
    });
    vec![flow, control_loop("LIC2", vec![tag(Role::Op, "e"), tag(Role::Pv, "f")])]
}

#[test]
fn tags_are_numbered_through_the_loops_and_land_in_their_series() {
    let history = History::new(&two_loops(), &Config { samples_per_tag: 8 });
    assert_eq!(history.tag_count(), 6);
    for number in 0..6 {
        assert!(history.push(number, Sample::good(1.0, number as f64)));
    }
    assert!(!history.push(6, Sample::good(1.0, 0.0)));
    let flow = history.snapshot(&LoopId::new("FIC1")).expect("FIC1 is there");
    assert_eq!((flow.op[0].value, flow.pv[0].value), (0.0, 1.0));
    assert_eq!(flow.sp.as_ref().expect("has SP")[0].value, 2.0);
    assert_eq!(flow.tags, vec![("upstream".to_string(), vec![Sample::good(1.0, 3.0)])]);
    assert_eq!(flow.op_limits, Some((0.0, 100.0)));
    let level = history.snapshot(&LoopId::new("LIC2")).expect("LIC2 is there");
    assert_eq!((level.op[0].value, level.pv[0].value), (4.0, 5.0));
    assert_eq!((level.sp, level.mode), (None, None));
    assert_eq!(history.snapshot(&LoopId::new("XX")), None);
    let number = history.tag_index(&LoopId::new("LIC2"), &TagKind::Role(Role::Pv));
    assert_eq!(number, Some(5));
}

#[test]
fn a_successor_keeps_what_is_unchanged_and_only_that() {
    let old = History::new(&two_loops(), &Config { samples_per_tag: 8 });
    (0..6).for_each(|number| assert!(old.push(number, Sample::good(1.0, 7.0))));
    let mut loops = two_loops();
    loops[0].tags[1].source = "another register".into();
    loops.reverse();
    loops.push(control_loop("new", vec![tag(Role::Op, "a"), tag(Role::Pv, "b")]));
    let new = old.successor(&loops, &Config { samples_per_tag: 8 });
    let level = new.snapshot(&LoopId::new("LIC2")).expect("kept");
    assert_eq!((level.op.len(), level.pv.len()), (1, 1));
    let flow = new.snapshot(&LoopId::new("FIC1")).expect("kept");
    assert_eq!((flow.op.len(), flow.pv.len()), (1, 0));
    assert_eq!(new.snapshot(&LoopId::new("new")).expect("new").op.len(), 0);
    // A sample pushed under the new number arrives where the old history sees it: the ring is the same.
    assert!(new.push(0, Sample::good(2.0, 8.0)));
    assert_eq!(old.snapshot(&LoopId::new("LIC2")).expect("still there").op.len(), 2);
    let larger = old.successor(&two_loops(), &Config { samples_per_tag: 16 });
    assert_eq!(larger.pushed(), 0);
}

#[test]
fn terms_of_a_loop_without_write_back_are_known_as_long_as_op_of_their_time_is() {
    let measured = || vec![tag(Role::Op, "a"), tag(Role::Pv, "b")];
    let without = [control_loop("A", measured())];
    let with = [control_loop("A", [measured(), vec![tag(Role::Term, "write-back")]].concat())];
    let (config, id) = (Config { samples_per_tag: 10 }, LoopId::new("A"));
    let poll = |history: &History, seconds: std::ops::Range<u32>| {
        for sample in seconds.map(|t| Sample::good(f64::from(t), 50.0)) {
            assert!(history.push(0, sample) && history.push(1, sample));
        }
    };
    let told = |history: &History, t: f64| history.snapshot(&id).expect("there").term_at(t);
    let after = |before: &History, loops: &[LoopTags]| {
        let history = before.successor(loops, &config);
        history.keep_terms_of(before, 60.0);
        history
    };
    let first = History::new(&with, &config);
    poll(&first, 0..10);
    for (t, value) in [(2.0, 1.5), (5.0, 0.0)] {
        assert!(first.push(2, Sample::good(t, value)));
    }
    let second = after(&first, &without);
    assert_eq!([1.0, 3.0, 6.0].map(|t| told(&second, t)), [0.0, 1.5, 0.0]);
    assert_eq!(second.snapshot(&id).expect("there").input()[3].value, 51.5);
    let third = after(&second, &without);
    assert_eq!(told(&third, 3.0), 1.5, "another reload takes nothing away");
    assert_eq!(told(&after(&third, &with), 3.0), 1.5, "nor does write-back that is there again");
    poll(&third, 10..20);
    assert_eq!(after(&third, &without).snapshot(&id).expect("there").term, None, "OP of that time is gone");

    // A daemon that was killed ended none.
    let killed = History::new(&without, &config);
    poll(&killed, 0..10);
    killed.keep_terms(&id, vec![Sample::good(2.0, 1.5)], 3.0);
    assert_eq!([1.0, 4.0, 5.0].map(|t| told(&killed, t)), [0.0, 1.5, 0.0]);
}

#[test]
fn what_acted_on_an_op_is_known_or_the_op_is_left_out() {
    let measured = || vec![tag(Role::Op, "a"), tag(Role::Pv, "b")];
    let without = [control_loop("A", measured())];
    let with = [control_loop("A", [measured(), vec![tag(Role::Term, "write-back")]].concat())];
    let (config, id) = (Config { samples_per_tag: 10 }, LoopId::new("A"));
    let told = |history: &History| {
        let record = history.snapshot(&id).expect("there");
        let input = record.input();
        assert!(input.iter().all(|own| own.value == 52.5), "{input:?}");
        assert!(record.term.iter().flatten().all(|own| own.quality.is_good()));
        (record.op.first().map(|own| own.t), record.pv.len())
    };
    // So many terms to a sample of OP: of five each the first ten are overwritten, and later two more by what is put in front of and
    // behind them.
    for (each, first, again) in [(3u32, 0.0, 0.0), (5, 2.0, 3.0)] {
        let history = History::new(&with, &config);
        for t in (0..10).map(f64::from) {
            assert!(history.push(0, Sample::good(t, 50.0)) && history.push(1, Sample::good(t, 50.0)));
            let terms = (0..each).map(|k| Sample::good(t + f64::from(k) / f64::from(each), 2.5));
            terms.for_each(|own| assert!(history.push(2, own)));
        }
        assert_eq!(told(&history), (Some(first), 10));
        let after = |before: &History, loops: &[LoopTags]| {
            let history = before.successor(loops, &config);
            history.keep_terms_of(before, 60.0);
            history
        };
        let removed = after(&history, &without);
        assert_eq!(told(&removed), (Some(first), 10), "write-back was removed");
        assert_eq!(told(&after(&removed, &with)), (Some(again), 10), "and is there again");
        assert_eq!(told(&after(&history, &with)), (Some(first), 10), "the same file again");
    }
}

#[test]
fn where_op_and_pv_are_read_is_which_valve_it_is() {
    let of = |op: &str, pv: &str, sp: &str, mv: Option<&str>| {
        let mut tags = vec![tag(Role::Op, op), tag(Role::Pv, pv), tag(Role::Sp, sp)];
        tags.extend(mv.map(|mv| tag(Role::Mv, mv)));
        let history = History::new(&[control_loop("A", tags)], &Config { samples_per_tag: 10 });
        let source = history.source(&LoopId::new("A"));
        assert_eq!(history.snapshot(&LoopId::new("A")).expect("there").source, source);
        source.expect("there")
    };
    let own = of("a", "b", "c", None);
    assert_eq!(of("a", "b", "elsewhere", None), own, "a set point is no part of the valve");
    assert_eq!(of("a", "b", "c", Some("d")), own, "a stem that is measured now is that of the same valve");
    let others = [of("a2", "b", "c", None), of("b", "b", "c", None), of("a", "b2", "c", None)];
    assert!(!others.contains(&own));
    assert_eq!(History::new(&[], &Config::default()).source(&LoopId::new("A")), None);
}

#[test]
fn a_clock_that_is_set_back_begins_a_new_record() {
    let history = History::new(&two_loops(), &Config { samples_per_tag: 100 });
    let id = LoopId::new("FIC1");
    for t in [100.0, 101.0, 102.0, 50.0, 51.0, 51.0] {
        history.push(0, Sample::good(t, t));
    }
    let stamps = |samples: &[Sample]| samples.iter().map(|s| s.t).collect::<Vec<_>>();
    assert_eq!(stamps(&history.snapshot(&id).expect("there").op), [50.0, 51.0, 51.0]);
    let trends = history.samples(&id, 0.0, 200.0, 100).expect("there");
    assert_eq!(stamps(&trends[0].samples), [50.0, 51.0, 51.0]);
}

/// OP and PV are polled; the clock is set back from 11:50 to 10:50.
#[test]
fn what_did_not_change_since_the_clock_was_set_back_is_in_force_from_then_on() {
    let tags = [Role::Op, Role::Pv, Role::Sp, Role::Mode].map(|role| tag(role, role.as_str())).to_vec();
    let history = History::new(&[control_loop("A", tags)], &Config { samples_per_tag: 1000 });
    let id = LoopId::new("A");
    let pairs = |samples: &[Sample]| samples.iter().map(|s| (s.t, s.value)).collect::<Vec<_>>();
    let hour = |hour: u32, minute: u32| f64::from(hour * 3600 + minute * 60);
    let poll = |from: f64, to: f64| {
        for i in 0..=((to - from) / 60.0) as u32 {
            let sample = Sample::good(from + f64::from(60 * i), 1.0);
            assert!(history.push(0, sample) && history.push(1, sample));
        }
    };
    history.push(3, Sample::good(hour(9, 0), 0.0));
    history.push(2, Sample::good(hour(9, 10), 40.0));
    poll(hour(9, 0), hour(11, 50));
    history.push(3, Sample::good(hour(11, 30), 1.0));
    history.push(2, Sample::good(hour(11, 40), 50.0));
    let before = history.snapshot(&id).expect("there");
    assert_eq!(before.mode.as_deref().map(pairs), Some(vec![(hour(9, 0), 0.0), (hour(11, 30), 1.0)]));

    poll(hour(10, 50), hour(11, 0));
    let record = history.snapshot(&id).expect("there");
    assert_eq!((record.op.len(), record.op[0].t), (11, hour(10, 50)));
    assert_eq!(record.mode.as_deref().map(pairs), Some(vec![(hour(10, 50), 1.0)]));
    assert_eq!(record.sp.as_deref().map(pairs), Some(vec![(hour(10, 50), 50.0)]));

    // A tag that changes after that is what it was until then.
    history.push(3, Sample::good(hour(11, 10), 0.0));
    // What comes after the last stamp of before is new, whatever of the tag was old.
    poll(hour(11, 1), hour(12, 0));
    history.push(2, Sample::good(hour(11, 55), 60.0));
    let record = history.snapshot(&id).expect("there");
    assert_eq!(record.mode.as_deref().map(pairs), Some(vec![(hour(10, 50), 1.0), (hour(11, 10), 0.0)]));
    assert_eq!(record.sp.as_deref().map(pairs), Some(vec![(hour(10, 50), 50.0), (hour(11, 55), 60.0)]));
}

#[test]
fn a_slow_tag_that_did_not_fall_keeps_what_it_measured_since() {
    let tags = vec![tag(Role::Op, "a"), tag(Role::Pv, "b")];
    let history = History::new(&[control_loop("A", tags)], &Config { samples_per_tag: 1000 });
    // OP falls by two seconds, PV is polled every ten.
    let op = (0..100).chain(98..200).map(f64::from);
    op.for_each(|t| assert!(history.push(0, Sample::good(t, t))));
    (0..20).for_each(|i| assert!(history.push(1, Sample::good(f64::from(10 * i), 1.0))));
    let record = history.snapshot(&LoopId::new("A")).expect("there");
    let stamps = |samples: &[Sample]| samples.iter().map(|s| s.t).collect::<Vec<_>>();
    assert_eq!((record.op.len(), record.op[0].t), (102, 98.0));
    let since: Vec<f64> = (10..20).map(|i| f64::from(10 * i)).collect();
    assert_eq!(stamps(&record.pv), [vec![98.0], since].concat());
}

#[test]
fn trends_are_cut_by_time_and_thinned() {
    let history = History::new(&two_loops(), &Config { samples_per_tag: 100 });
    for i in [0, 1, 2, 2, 3] {
        history.push(0, Sample::good(f64::from(i), f64::from(10 * i)));
    }
    history.push(0, Sample::good(f64::NAN, 1.0));
    let trends = history.samples(&LoopId::new("FIC1"), 1.0, 3.0, 100).expect("there");
    let times: Vec<f64> = trends[0].samples.iter().map(|s| s.t).collect();
    assert_eq!(times, vec![1.0, 2.0, 2.0, 3.0]);
    assert_eq!(trends.len(), 4);
    assert_eq!(trends[1].found, 0);
    assert_eq!(history.samples(&LoopId::new("XX"), 0.0, 1.0, 10), None);
    let few = history.samples(&LoopId::new("FIC1"), 0.0, 9.0, 3).expect("there");
    assert_eq!((few[0].found, few[0].samples.len()), (5, 2));
}

#[test]
fn what_held_before_a_trend_begins_is_told_and_so_is_whether_a_source_sends_changes_only() {
    let history = History::new(&two_loops(), &Config { samples_per_tag: 100 });
    for (t, value) in [(0.0, 50.0), (8.0, 60.0)] {
        history.push(2, Sample::good(t, value));
    }
    // The same value counts again after a bad sample.
    history.push(2, Sample { t: 9.0, value: 0.0, quality: Quality::Bad(BadReason::LinkDown) });
    history.push(2, Sample::good(10.0, 60.0));
    (0..20).for_each(|i| assert!(history.push(0, Sample::good(f64::from(i), f64::from(i / 2)))));
    let sp = |from: f64| {
        let trend = history.samples(&LoopId::new("FIC1"), from, 20.0, 100).expect("there").remove(2);
        (trend.found, trend.before.map(|s| (s.t, s.value)), trend.by_changes)
    };
    assert_eq!(sp(f64::NEG_INFINITY), (4, None, true));
    assert_eq!(sp(0.0), (4, None, true));
    assert_eq!(sp(8.5), (2, Some((8.0, 60.0)), true));
    assert_eq!(sp(15.0), (0, Some((10.0, 60.0)), true));
    let trends = history.samples(&LoopId::new("FIC1"), 5.0, 20.0, 100).expect("there");
    assert_eq!((trends[0].before.map(|s| s.t), trends[0].by_changes), (Some(4.0), false));
}

#[test]
fn a_value_is_as_old_as_it_was_last_known_to_hold_whatever_its_stamp_says() {
    let history = History::new(&two_loops(), &Config { samples_per_tag: 100 });
    // Our own clock shows 1000 s at the start.
    let ages = |now_s: f64| -> Vec<Option<f64>> {
        let aged = history.aged(&LoopId::new("FIC1"), 1000.0 + now_s, now_s);
        aged.into_iter().map(|(_, newest)| newest.map(|(_, age_s)| age_s)).collect()
    };
    assert_eq!(ages(0.0), [None; 4]);
    // What a store gave back is as old as our clock says.
    (0..4).for_each(|tag| assert!(history.push(tag, Sample::good(900.0, 1.0))));
    assert_eq!(ages(10.0), [Some(110.0); 4]);
    // OP comes from a source that is five hours behind, PV from one that is ahead.
    for (tag, t, at) in [(0, -17_000.0, 20.0), (1, 5000.0, 25.0)] {
        history.push(tag, Sample::good(t, 2.0));
        history.ring(tag).expect("a tag").heard().sample(t, at);
    }
    assert_eq!(ages(30.0), [Some(10.0), Some(5.0), Some(130.0), Some(130.0)]);
    // A source that tells every change was there since; one that repeats values would have said more than that.
    (0..4).for_each(|tag| history.ring(tag).expect("a tag").heard().seen(290.0));
    history.push(3, Sample::good(901.0, 1.0));
    assert_eq!(ages(300.0), [Some(10.0), Some(10.0), Some(10.0), Some(399.0)]);
    assert!(history.aged(&LoopId::new("XX"), 0.0, 0.0).is_empty());
}

#[test]
fn the_memory_is_what_the_configuration_asks_for() {
    let history = History::new(&two_loops(), &Config { samples_per_tag: 4096 });
    let samples = 6 * 4096 * history.bytes_per_sample();
    // Above the bare samples only a hundredth for the blocks' addresses, a part of a block and the ring's own fields.
    assert!(history.memory_bytes() >= samples);
    assert!(history.memory_bytes() < samples + samples / 100 + 6 * (1024 + 256));
}

#[test]
fn impossible_settings_are_named() {
    assert_eq!(Config::default().validate(), vec![]);
    assert_eq!(Config { samples_per_tag: 0 }.validate()[0].0, "samples_per_tag");
}

/// OP has the daemon's clock, which is set back; PV has the stamps of a server, whose clock is not.
#[test]
fn a_tag_of_another_clock_keeps_what_it_measured() {
    let tags = vec![tag(Role::Op, "a"), tag(Role::Pv, "b")];
    let history = History::new(&[control_loop("A", tags)], &Config { samples_per_tag: 1000 });
    let op = (600..710).chain(650..690).map(|minute| f64::from(60 * minute));
    op.for_each(|t| assert!(history.push(0, Sample::good(t, t))));
    (655..690).for_each(|minute| assert!(history.push(1, Sample::good(f64::from(60 * minute), 1.0))));
    let record = history.snapshot(&LoopId::new("A")).expect("there");
    assert_eq!((record.op.len(), record.pv.len(), record.pv[0].t), (40, 35, 60.0 * 655.0));
}

/// As a file's: 20 to 90 kPa are no per cent of a span, which nobody has told.
#[test]
fn the_values_of_an_op_in_a_physical_unit_tell_no_span() {
    let span = |unit: &str| {
        let op = TagSpec { unit: unit.into(), ..tag(Role::Op, "a") };
        let own = LoopTags { op_limits: None, ..control_loop("A", vec![op, tag(Role::Pv, "b")]) };
        let history = History::new(&[own], &Config { samples_per_tag: 8 });
        for k in (0..8).map(f64::from) {
            assert!(history.push(0, Sample::good(k, 20.0 + 10.0 * k)));
        }
        let record = history.snapshot(&LoopId::new("A")).expect("there");
        (record.op_span, record.op_span_source.as_str())
    };
    assert_eq!(span("kPa"), (None, "unknown"));
    assert_eq!(span(""), (Some(100.0), "values"));
}
