//! What a verdict says: why a window cannot be fitted, and the sentences with their numbers.

use super::*;
use crate::diagnosis::armax::{Fit, Orders, Theta};
use crate::diagnosis::friction::{Cell, Start};
use crate::diagnosis::search::Holes;
use crate::diagnosis::{Acquisition, Apart, HistoryFound, HistoryKind};
use crate::signal::{Role, Sample};
use std::f64::consts::TAU;

/// OP that swings with a period of 40 rows from row `from` on, and PV behind it; `worth`: what each row is worth.
fn window(n: usize, from: usize, worth: impl Fn(usize) -> Row) -> Window {
    let swing = |k: usize, late: usize| (TAU * k.saturating_sub(from + late) as f64 / 40.0).sin();
    Window {
        ts: 1.0,
        op: (0..n).map(|k| 50.0 + swing(k, 0)).collect(),
        pv: (0..n).map(|k| 20.0 + swing(k, 3)).collect(),
        rows: (0..n).map(worth).collect(),
        ..Window::default()
    }
}

fn posed(window: &Window) -> Option<NotIdentifiable> {
    pose(window, &region::analyse(&window.op), &Settings::default()).err()
}

#[test]
fn a_window_of_too_few_rows_is_too_short_and_not_calm() {
    let all = |_: usize| Row::Counts;
    // OP turns first at row 10, a quarter of its period: the lags take 19 rows more, and 120 have to count.
    assert_eq!(posed(&window(130, 0, all)), Some(NotIdentifiable::TooShort { n: 130, need: 149 }));
    assert_eq!(posed(&window(149, 0, all)), None);
    // The same of as many as are asked for, where OP begins to swing late.
    assert_eq!(posed(&window(200, 60, all)), Some(NotIdentifiable::TooShort { n: 200, need: 209 }));
    assert_eq!(posed(&window(209, 60, all)), None);
    // One that hardly turns is told so, however long.
    assert!(matches!(posed(&window(400, 330, all)), Some(NotIdentifiable::NotExcited { reversals: 1..4 })));
}

#[test]
fn rows_that_do_not_count_are_named_where_they_are_too_many() {
    let lost = |worth: Row| move |k: usize| if (100..380).contains(&k) { worth } else { Row::Counts };
    assert_eq!(posed(&window(400, 0, lost(Row::Silent))), Some(NotIdentifiable::Saturated { share: 0.7 }));
    assert_eq!(posed(&window(400, 0, lost(Row::Missing))), Some(NotIdentifiable::Gaps { share: 0.7 }));
    assert_eq!(posed(&window(429, 0, lost(Row::Silent))), None);
}

#[test]
fn a_limit_cycle_of_few_samples_is_never_told_to_be_calm() {
    let wave = |phase: f64| -> Vec<Sample> {
        (0..130).map(|k| Sample::good(k as f64, 50.0 + (0.2 * k as f64 + phase).sin())).collect()
    };
    let record = Record { op: wave(0.0), pv: wave(1.0), ..Record::default() };
    let found = diagnose(&record, &Settings { min_samples: 100, ..Settings::default() });
    // OP turns first at row 8.
    assert_eq!(found.verdict, Verdict::NotIdentifiable(NotIdentifiable::TooShort { n: 130, need: 147 }));
    assert!(found.reason.starts_with("too short: 130 usable samples, 147 needed"), "{}", found.reason);
}

/// An estimate without friction, of a model that does nothing.
pub(crate) fn estimate(delta_aic: f64, rival: Rival, steadiness: f64) -> Estimate {
    let model = Model { na: 1, nb: 1, nc: 0, nk: 1, a: vec![0.0], b: vec![0.0], c: Vec::new(), rmse: 1.0 };
    Estimate {
        f: 0.0,
        f_ci95: [0.0, 1.2],
        f_of_op_range: 0.0,
        delta_aic,
        rival,
        steadiness,
        f_max: 5.0,
        d: 0.0,
        curve: Vec::new(),
        model,
        mv: Vec::new(),
    }
}

/// Thresholds of the evidence, and of f in a span of 100.
const LEAST: Thresholds = Thresholds { evidence: 20.0, f: 0.05 };

#[test]
fn a_no_beside_much_evidence_says_what_it_is_that_friction_lacks() {
    let load = Rival::OscillatingLoad { period: 40.0, harmonics: 1 };
    let said = |delta_aic: f64, rival: Rival, steadiness: f64, low: f64| {
        let evidence = Evidence { delta_aic, rival, steadiness };
        let tried = Some(Tried { evidence: &evidence, f: 0.03, low });
        let own = estimate(delta_aic, rival, steadiness);
        explain(&Verdict::NoStiction, &own, tried, LEAST, Some(100.0))
    };
    let (bound, better) =
        ("; f up to 1.200 % OP could be hidden", "friction predicts PV better, evidence 60, but");
    // Whatever came next: with so much evidence it is no explanation as good.
    for rival in [Rival::Linear, load] {
        let small = "its f of 0.0300 % OP is too small to matter";
        assert_eq!(said(60.0, rival, 2.0, 0.02), format!("{better} {small}{bound}"));
        assert_eq!(said(60.0, rival, 2.0, 0.0), format!("{better} f may be 0{bound}"));
        let unsteady = "no steady gain from friction, evidence 60, steadiness 0.3";
        assert_eq!(said(60.0, rival, 0.3, 0.02), format!("{unsteady}{bound}"));
    }
    let as_well = "an oscillating load explains the record about as well as friction, evidence 10";
    assert_eq!(said(10.0, load, 2.0, 0.0), format!("{as_well}{bound}"));
    assert_eq!(
        said(10.0, Rival::Linear, 2.0, 0.0),
        format!("too little speaks for friction, evidence 10 of 20{bound}")
    );
    assert_eq!(LEAST.too_little(-3.0), "nothing speaks for friction, evidence 0");
    assert_eq!(LEAST.too_little(0.9), "nothing speaks for friction, evidence 0");
    let never = explain(&Verdict::NoStiction, &estimate(0.0, Rival::Linear, 0.0), None, LEAST, None);
    assert_eq!(
        never,
        "OP never reverses by enough for friction to hold the stem; f up to 1.200 OP could be hidden"
    );
}

#[test]
fn evidence_and_f_are_never_told_on_the_other_side_of_their_thresholds() {
    assert_eq!(LEAST.too_little(19.7), "too little speaks for friction, evidence 19.7 of 20");
    assert_eq!(LEAST.too_little(18.7), "too little speaks for friction, evidence 19 of 20");
    let but = "but its f of 0.04998 % OP is too small to matter";
    let small = LEAST.not_told(20.3, [0.04998, 0.04], Some(100.0));
    assert_eq!(small, format!("friction predicts PV better, evidence 20.3, {but}"));
    let sticks = LEAST.sticks(20.02, 0.05003, [0.04, 0.06], Some(100.0));
    assert_eq!(sticks, "f = 0.05003 % OP [0.0400, 0.0600], evidence 20.02");
    let load = Rival::OscillatingLoad { period: 40.0, harmonics: 1 };
    let evidence = Evidence { delta_aic: 19.8, rival: load, steadiness: 2.0 };
    let tried = Some(Tried { evidence: &evidence, f: 0.1, low: 0.05 });
    let said = explain(&Verdict::NoStiction, &estimate(19.8, load, 2.0), tried, LEAST, None);
    assert!(said.contains("about as well as friction, evidence 19.8;"), "{said}");
}

#[test]
fn f_is_told_with_its_unit_whether_the_span_is_known_or_not() {
    let said = |span| {
        let evidence = Evidence { delta_aic: 60.0, rival: Rival::Linear, steadiness: 2.0 };
        let tried = Some(Tried { evidence: &evidence, f: 1.0, low: 0.5 });
        let own = Estimate { f: 1.0, f_ci95: [0.5, 1.2], ..estimate(60.0, Rival::Linear, 2.0) };
        explain(&Verdict::Stiction, &own, tried, LEAST, span)
    };
    for (span, f) in [
        (Some(200.0), "f = 0.500 % OP [0.250, 0.600], evidence 60"),
        (None, "f = 1.000 OP [0.500, 1.200], evidence 60"),
    ] {
        assert!(said(span).starts_with(f), "{}", said(span));
    }
}

#[test]
fn a_reason_is_known_without_what_it_ends_with() {
    let history = HistoryFound { kind: HistoryKind::Held, role: Role::Pv, evidence: [1.0, 5.0] };
    let preparation = Preparation { history: Some(Box::new(history)), ..Preparation::default() };
    let reason = "too little speaks for friction, evidence 3 of 20; f up to 1.200 % OP could be hidden";
    let own = Diagnosis {
        preparation,
        estimate: Some(estimate(3.0, Rival::Linear, 2.0)),
        ..Diagnosis::bare(Verdict::NoStiction, reason)
    };
    let told = with_history(own.clone());
    assert_eq!(
        told.reason,
        format!("{reason}; the data is not raw (held): f reads low, and sticking may go unseen")
    );
    for found in [&own, &told] {
        assert_eq!(bare_reason(found, Some(100.0)), "too little speaks for friction, evidence 3 of 20");
    }
    let other = Diagnosis::bare(Verdict::NoStiction, "made for a test");
    assert_eq!(bare_reason(&other, None), "made for a test");
}

#[test]
fn what_an_archive_left_out_is_told_with_its_own_remedy() {
    let of = |kind: HistoryKind| {
        let history = HistoryFound { kind, role: Role::Pv, evidence: [0.9, 40.0] };
        let read_apart = Apart { share: 0.6, rows: 0.5, ..Apart::default() };
        Preparation { history: Some(Box::new(history)), read_apart, decimation: 1, ..Preparation::default() }
    };
    let exception = of(HistoryKind::Exception);
    let apart = exception.apart().expect("read apart");
    assert_eq!(apart.code(), "compressed");
    assert_eq!(
        apart.to_string(),
        "compressed: only changes beyond a dead band were kept, so that OP and PV are not known at the same time in 60 % of the rows: \
         set the dead band of both tags to 0, or export raw values"
    );
    // The reason has it already.
    let verdict = Verdict::NotIdentifiable(apart);
    assert_eq!(of_archive(&exception, &verdict), "");
    assert!(of_archive(&exception, &Verdict::NoStiction).contains("not raw (exception)"));
    // A lost connection, a manual loop and values that are held have other remedies.
    let gaps = NotIdentifiable::Gaps { share: 0.7 };
    assert_eq!(of(HistoryKind::Held).by_archive(gaps.clone()), gaps);
    assert_eq!(Preparation::default().by_archive(gaps.clone()), gaps);
    assert_eq!(exception.by_archive(NotIdentifiable::FlatOp), NotIdentifiable::FlatOp);
    let drawn = of(HistoryKind::Interpolated).by_archive(gaps);
    assert_eq!(drawn, NotIdentifiable::Compressed { kind: HistoryKind::Interpolated, share: 0.9 });
}

#[test]
fn the_interval_is_wider_where_the_controller_may_have_acted_unseen() {
    // Nine steps of ten are of 0.1, one of 1.
    let mut at = 0.0;
    let u: Vec<f64> = (0..400)
        .map(|k| {
            let (step, sign) = (if k % 10 == 0 { 1.0 } else { 0.1 }, if k % 40 < 20 { 1.0 } else { -1.0 });
            at += sign * step;
            at
        })
        .collect();
    let start = Start { index: 0, is_max: false };
    let y = u.clone();
    let p = Problem { u, y, start, first: 100, max_delay: 1, f_top: 9.0, holes: Holes::default() };
    let cell = Cell { lo: 2.0, hi: 2.5 };
    let orders = Orders { na: 1, nb: 1, nc: 4, nk: 1 };
    let fit = Fit { orders, theta: Theta::default(), loss: 1.0, iterations: 1 };
    let sticky = Refined { cell, resume: 0.0, f: 2.25, fit, long_loss: 1.0, long_lag: 0.0 };
    let prepared = |jitter_s: f64, recovered: bool| {
        let (poll_s, jitter_s) = (Some(1.0), Some(jitter_s));
        let acquisition = Acquisition { poll_s, jitter_s, recovered, ..Acquisition::default() };
        Preparation { acquisition: Some(Box::new(acquisition)), decimation: 1, ..Preparation::default() }
    };
    let of = |jitter_s: f64, recovered: bool| {
        interval_with_unseen(&p, &prepared(jitter_s, recovered), &[], &sticky)
    };
    let seen = interval(&p, &[], &sticky);
    assert_eq!((of(0.0, false), of(0.05, true)), (seen, seen));
    let [low, high] = of(0.05, false);
    assert!((low - (seen[0] - 0.9)).abs() < 1e-9 && (high - (seen[1] + 0.9)).abs() < 1e-9, "{low} {high}");
    // What could be hidden where friction is not told is larger by as much.
    let hidden =
        |jitter_s: f64| interval_from_zero(&p, &prepared(jitter_s, false), &[], &sticky, Some(sticky));
    assert_eq!((hidden(0.0), hidden(0.05)), ([0.0, seen[1]], [0.0, high]));
}
