use super::*;
use stictiond::diagnosis::{Diagnosis, Verdict};
use stictiond::serve::dto::report::{ReportCandidate, ReportEffect, ReportOscillation, ReportTraced};

fn bare() -> Report {
    Report::new("x", None, &Diagnosis::bare(Verdict::NoStiction, "made for a test"))
}

#[test]
fn effects_are_told_with_their_probability_and_what_lies_between_kinds_too() {
    let mut report = Report::new("FIC101", None, &Diagnosis::bare(Verdict::NoStiction, "made for a test"));
    let candidate =
        |(kind, posterior): (&str, f64)| ReportCandidate { kind: kind.into(), posterior: Some(posterior) };
    report.residual.candidates =
        [("gain_change", 0.48), ("load_step", 0.41), ("none", 0.04)].map(candidate).into();
    let said = |named| between(&report.residual.kinds(), named).expect("no kind is sure") + "\n";
    let (between, beside) = (said(false), said(true));
    assert!(between.contains("a gain change (48 %)") && between.contains("a load step (41 %)"), "{between}");
    assert!(page(&report).contains(&format!("\neffects     {between}")), "{}", page(&report));
    report.residual.effects = vec![ReportEffect {
        kind: "oscillating_load".into(),
        posterior: Some(0.99),
        delta_aic: Some(31.0),
        tag: None,
        parameters: Default::default(),
        explanation: "period 733 s".into(),
    }];
    let named = "\neffects     oscillating_load, 99 %: period 733 s\n            ";
    assert!(page(&report).contains(&format!("{named}{beside}")), "{}", page(&report));
    report.residual.candidates = [("none", 0.9), ("load_step", 0.1)].map(candidate).into();
    assert!(!page(&report).contains("the record "));
    assert!(!page(&report).contains("dAIC 31"));
}

#[test]
fn a_worse_free_run_is_told_with_its_ratio() {
    let mut report = bare();
    report.residual.effects = vec![ReportEffect {
        kind: "drift".into(),
        posterior: Some(0.99),
        delta_aic: None,
        tag: None,
        parameters: Default::default(),
        explanation: "a load that rises".into(),
    }];
    report.residual.simulates_worse = true;
    for (before, after, said) in [
        (Some(2.0), Some(2.1), "the free run is 1.05 times as far off with the effects as without\n"),
        (
            Some(2.0),
            Some(900.0),
            "the free run is 450 times as far off with the effects as without: do not simulate with this model\n",
        ),
        (Some(0.0), Some(1.0), "the free run is worse with the effects than without\n"),
        (None, None, "the free run is worse with the effects than without\n"),
    ] {
        (report.residual.free_run_rmse_before, report.residual.free_run_rmse_after) = (before, after);
        assert!(page(&report).contains(said), "{}", page(&report));
    }
    report.residual.simulates_worse = false;
    assert!(!page(&report).contains("the free run is"), "{}", page(&report));
}

#[test]
fn opinions_with_an_index_have_a_line_and_the_others_are_told_by_why() {
    use stictiond::detectors::{Agreement, Band, Method, Opinion};
    use stictiond::results::Judged;
    use stictiond::signal::SpanSource;
    let judged = Judged {
        opinions: vec![
            Opinion::cannot_tell(Method::Horch1999, "the process integrates"),
            Opinion::of(Method::He2007, 0.73456, Band { sound: 0.4, sticks: 0.6 }, "SI 0.73"),
            Opinion::cannot_tell(Method::Kano2004A, "the process integrates"),
        ],
        agreement: Some(Agreement { why: "1 of 1".into(), ..Agreement::default() }),
        ..Diagnosis::bare(Verdict::NoStiction, "made for a test").into()
    };
    let page = page(&Report::judged("LIC1", (None, SpanSource::Unknown), &judged));
    let lines = "opinions    1 of 1\n            he_2007               sticks         0.7346  SI 0.73\n            \
                 horch_1999, kano_2004_a cannot tell: the process integrates\n";
    assert!(page.contains(lines), "{page}");
}

#[test]
fn nothing_is_explained_that_is_not_there() {
    let mut report = Report::new("x", None, &Diagnosis::bare(Verdict::NoStiction, "made for a test"));
    let f: Vec<Option<f64>> = (0..=59).map(|k| Some(f64::from(k))).collect();
    let aic = f.iter().map(|f| f.map(|f| (f - 20.0).powi(2))).collect();
    (report.aic_curve, report.f_max) = (Some(ReportCurve { f, aic }), Some(59.0));
    report.residual.unexplained = true;
    let bare = page(&report);
    assert!(bare.contains("0 … 59 OP units\n") && !bare.contains('▲'), "{bare}");
    assert!(!bare.contains("unexplained"), "{bare}");
    (report.f, report.f_ci95) = (Some(20.0), Some([19.0, 21.0]));
    report.residual.failed_tests = vec!["drift".into()];
    let whole = page(&report);
    assert!(whole.contains("0 … 59 OP units; ▲ the estimate, ─ its interval\n"), "{whole}");
    assert!(whole.contains("\nunexplained drift\n"), "{whole}");
}

#[test]
fn a_bound_is_told_once_and_a_probability_is_one_of_friction() {
    let mut report = bare();
    report.reason =
        "too little speaks for friction, evidence 2 of 20; f up to 2.642 OP could be hidden".into();
    (report.f, report.f_ci95, report.posterior) = (Some(0.0), Some([0.0, 2.642]), Some(0.69));
    let page = page(&report);
    assert_eq!(page.matches("could be hidden").count(), 1, "{page}");
    assert!(page.contains("probability of friction 69 %\n"), "{page}");
}

#[test]
fn f_is_compared_where_the_verdict_tells_it() {
    let mut report = bare();
    let explanation = "39 samples of PV are off".into();
    report.residual.effects = vec![ReportEffect {
        kind: "outliers".into(),
        posterior: Some(1.0),
        delta_aic: None,
        tag: None,
        parameters: Default::default(),
        explanation,
    }];
    (report.residual.f_before, report.residual.f_after) = (Some(1.0), Some(2.0));
    assert!(!page(&report).contains(", f 1 -> 2"), "{}", page(&report));
    report.f = Some(2.0);
    assert!(page(&report).contains(", f 1 -> 2 OP units\n"), "{}", page(&report));
    report.residual.f_before = None;
    assert!(!page(&report).contains(", f - "), "{}", page(&report));
}

#[test]
fn an_oscillation_without_a_swing_is_none() {
    let mut report = bare();
    let swing = |op_amplitude| ReportOscillation {
        period_s: Some(9085.0),
        regularity_r: Some(0.7),
        op_amplitude: Some(op_amplitude),
    };
    report.oscillation = Some(swing(0.0));
    assert!(!page(&report).contains("9085"), "{}", page(&report));
    report.oscillation = Some(swing(0.1));
    assert!(page(&report).contains("\noscillation period 9085 s"), "{}", page(&report));
}

#[test]
fn the_traced_stretch_is_told_where_it_is_not_the_window() {
    let mut report = bare();
    (report.window.start, report.window.end) = (Some(370.036), Some(2368.046));
    (report.window.n, report.window.ts_s) = (1000, Some(2.0));
    assert!(!page(&report).contains("looked for"), "{}", page(&report));
    let traced = |start, end, n| Some(ReportTraced { start: Some(start), end: Some(end), n });
    report.residual.traced = traced(370.036, 2368.046, 1000);
    assert!(!page(&report).contains("looked for"), "{}", page(&report));
    report.residual.traced = traced(0.034, 2398.047, 1200);
    let told = "\ntraced      effects were looked for in 1200 samples, from 0.034 to 2398.047 s\n";
    assert!(page(&report).contains(told), "{}", page(&report));
}

#[test]
fn a_window_of_the_calendar_is_told_in_dates() {
    let told = |start, end| stretch(Some(start), Some(end));
    assert_eq!(told(1_700_000_000.0, 1_700_001_000.0), "2023-11-14 22:13:20 UTC to 2023-11-14 22:30:00 UTC");
    assert_eq!(told(370.036, 2368.046), "370.036 to 2368.046 s");
    assert_eq!(stretch(None, Some(1_700_000_000.25)), "- to 1700000000.25 s");
}

#[test]
fn noise_is_told_as_a_share_where_it_is_one() {
    let told = [Some(0.083), Some(1.0), Some(2.12), Some(8e-16), None].map(noise_of_op);
    let like_noise = "OP moves from sample to sample as noise does";
    assert_eq!(
        told,
        ["OP noise 8.3 % of its sd", like_noise, like_noise, "no noise in OP", "OP noise not known"]
    );
}

#[test]
fn an_unknown_span_is_asked_for() {
    let mut report = bare();
    (report.f, report.f_unit_assumed, report.op_span) = (Some(0.5), true, None);
    (report.f_threshold, report.f_unit) = (Some(0.001), "OP units".into());
    let asked = "OP's values do not tell its span: say it with --op-span";
    let page = page(&report);
    assert!(page.contains(asked) && page.contains("from f = 0.001 OP units on"), "{page}");
    assert!(!page.contains("unit OP units"), "{page}");
}

#[test]
fn numbers_have_four_digits() {
    let cases = [
        (0.0, "0"),
        (2.5, "2.5"),
        (0.01024, "0.01024"),
        (446.0, "446"),
        (49950.0, "49950"),
        (1_700_000_000.0, "1.700e9"),
        (-12.3456, "-12.35"),
        (1e-9, "1.000e-9"),
        (1e308, "1.000e308"),
    ];
    for (value, text) in cases {
        assert_eq!(number(Some(value)), text);
    }
    assert_eq!(number(None), "-");
    assert_eq!(stamp(Some(1_700_000_000.25)), "1700000000.25");
}

#[test]
fn sparkline_is_lowest_at_the_estimate() {
    let f: Vec<Option<f64>> = (0..=59).map(|k| Some(f64::from(k))).collect();
    let aic = f.iter().map(|f| f.map(|f| (f - 20.0).powi(2))).collect();
    let bars: Vec<char> = sparkline(&ReportCurve { f, aic }).unwrap().chars().collect();
    assert_eq!(bars.len(), WIDTH);
    assert_eq!((bars[20], bars[59]), ('▁', '█'));
    assert_eq!([-1.0, 0.0, 20.0, 59.0, 99.0].map(|f| column(f, 0.0, 59.0)), [0, 0, 20, 59, 59]);
    let flat = ReportCurve { f: vec![Some(0.0), Some(1.0)], aic: vec![Some(1.0), None] };
    assert_eq!(sparkline(&flat), None);
}
