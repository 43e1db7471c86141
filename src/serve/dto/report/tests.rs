use super::*;
use crate::diagnosis::{
    Acquisition, Apart, CurvePoint, Denoise, Estimate, Model, NotIdentifiable, Oscillation, Preparation,
    ReadingLimits, Residual,
};
use crate::residual::Kind;
use crate::signal::Window;

fn sticky(op: Vec<f64>) -> Diagnosis {
    Diagnosis {
        verdict: Verdict::Stiction,
        reason: "f = 2.50 % OP, evidence 446".into(),
        preparation: Preparation {
            start: -0.0,
            end: 49950.0,
            n: 1000,
            ts: 50.0,
            gap_share: 0.0,
            missing: 0.0,
            acquisition: Some(Box::new(Acquisition {
                scan_s: Some(2.0),
                poll_s: Some(1.0),
                jitter_s: Some(0.05),
                polls_per_scan: Some(2.0),
                recovered: true,
                ts_given: false,
                pv_late_s: 0.0,
            })),
            worst_skew: 0.0,
            read_apart: Apart::default(),
            carried: None,
            reading: ReadingLimits::default(),
            duplicates: 0,
            out_of_order: 0,
            decimation: 1,
            denoise: Denoise::default(),
            history: None,
            f_threshold: 0.05,
            compensated: 0.0,
        },
        oscillation: Some(Oscillation { period: 1480.0, regularity_r: f64::INFINITY, op_amplitude: 2.75 }),
        estimate: Some(Estimate {
            f: 2.5,
            f_ci95: [2.25, 2.75],
            f_of_op_range: 0.41,
            delta_aic: 446.0,
            rival: crate::diagnosis::rivals::Rival::Linear,
            steadiness: 9.0,
            f_max: 6.0,
            d: 4.0,
            curve: vec![
                CurvePoint { f: 0.0, aic: 446.0 },
                CurvePoint { f: 2.5, aic: -0.0 },
                CurvePoint { f: 6.0, aic: f64::NAN },
            ],
            model: Model {
                na: 2,
                nb: 2,
                nc: 2,
                nk: 1,
                a: vec![-1.0, 0.25],
                b: vec![0.5, 0.125],
                c: vec![f64::NAN, 0.0],
                rmse: 0.0102,
            },
            mv: vec![],
        }),
        residual: Some(Residual { white: false, one_step_rmse: 0.031, free_run_rmse: 0.4 }),
        packed: None,
        window: Some(Window { op, ..Window::default() }),
    }
}

#[test]
fn contract_fields_have_their_names_and_values() {
    let report = Report::from(("FIC101", &sticky(vec![40.0, 46.0])));
    let json = serde_json::to_value(&report).unwrap();
    let residual = serde_json::json!({
        "traced": null, "white_before": false, "white_after": false,
        "one_step_rmse_before": 0.031, "one_step_rmse_after": 0.031,
        "free_run_rmse_before": 0.4, "free_run_rmse_after": 0.4,
        "effects": [], "candidates": [], "simulates_worse": false, "unexplained": true, "failed_tests": [], "structure": null, "f_before": null, "f_after": null,
        "verdict_before": null, "stem": null
    });
    let expected = serde_json::json!({
        "loop": "FIC101", "verdict": "stiction", "reason": "f = 2.50 % OP, evidence 446", "reason_code": null,
        "read_as": null, "op_span": null, "op_span_source": "unknown",
        "f": 2.5, "f_ci95": [2.25, 2.75], "f_unit": "OP units", "f_unit_assumed": true, "f_threshold": 0.05, "f_of_op_range": 0.41,
        "posterior": null, "delta_aic": 446.0, "rival": "a linear loop", "steadiness": 9.0, "f_max": 6.0, "f_detectable": null, "d_srinivasan": 4.0,
        "window": {"start": 0.0, "end": 49950.0, "n": 1000, "ts_s": 50.0, "quality": "good", "missing": 0.0, "history": null},
        "compensated": null,
        "acquisition": {"scan_s": 2.0, "poll_s": 1.0, "jitter_s": 0.05, "polls_per_scan": 2.0, "recovered": true, "pv_late_s": 0.0,
                        "note": "polled twice per controller scan of 2 s; diagnosed at the controller's ticks"},
        "preparation": {"gap_share": 0.0, "worst_skew_s": 0.0, "duplicates": 0, "out_of_order": 0, "decimation": 1},
        "denoise": {"applied": false, "noise_share": 0.0},
        "oscillation": {"period_s": 1480.0, "regularity_r": null, "op_amplitude": 2.75},
        "model": {"na": 2, "nb": 2, "nc": 2, "nk": 1, "rmse": 0.0102,
                  "a": [-1.0, 0.25], "b": [0.5, 0.125], "c": [null, 0.0]},
        "residual": residual,
        "opinions": [], "agreement": null, "doubtful": false,
        "aic_curve": {"f": [0.0, 2.5, 6.0], "aic": [446.0, 0.0, null]}
    });
    assert_eq!(json, expected);
    let text = serde_json::to_string(&report).unwrap();
    assert!(!text.contains("-0.0"), "{text}");
    assert_eq!(serde_json::from_str::<Report>(&text).unwrap(), report);
}

#[test]
fn what_was_traced_is_told_with_its_posteriors() {
    use crate::results::{made_effect, made_findings};
    let kinds = [(Kind::StaticNonlinearity, 0.97), (Kind::GainChange, f64::NAN)];
    let effects = kinds.map(|(kind, posterior)| made_effect(kind, posterior)).to_vec();
    let declared = sticky(vec![40.0, 46.0]);
    let told = |found: &Findings| {
        Report::new("FIC101", Some(50.0), &declared).with_findings(Some(50.0), &declared, found)
    };
    let report = told(&made_findings(Verdict::NoStiction, effects));
    let json = serde_json::to_value(&report).unwrap();
    assert_eq!(
        (&json["verdict"], &json["f"], &json["posterior"]),
        (&"no_stiction".into(), &0.0.into(), &0.9995.into())
    );
    let residual = &json["residual"];
    assert_eq!((&residual["verdict_before"], &residual["f_before"]), (&"stiction".into(), &5.0.into()));
    assert_eq!(residual["simulates_worse"], true);
    assert_eq!(residual["traced"], serde_json::json!({"start": 1000.0, "end": 2999.0, "n": 2000}));
    let candidates = serde_json::json!([{"kind": "gain_change", "posterior": 0.48}, {"kind": "load_step", "posterior": 0.41},
        {"kind": "none", "posterior": 0.11}]);
    assert_eq!(residual["candidates"], candidates);
    let mut others = made_findings(Verdict::NoStiction, Vec::new());
    others.candidates = [Some(Kind::GainChange), Some(Kind::LoadStep), Some(Kind::Drift), None]
        .into_iter()
        .zip([0.4, 0.3, 0.2, 0.1])
        .collect();
    let named: Vec<String> =
        told(&others).residual.candidates.into_iter().map(|candidate| candidate.kind).collect();
    assert_eq!(named, ["gain_change", "load_step", "none"], "none is told, however unlikely it is");
    others.candidates.clear();
    assert!(told(&others).residual.candidates.is_empty());
    let [curved, changed] = [&residual["effects"][0], &residual["effects"][1]];
    assert_eq!(curved["posterior"], 0.97);
    assert_eq!(curved["parameters"], serde_json::json!({"ratio": 1.5, "where": "process"}));
    assert_eq!((&changed["posterior"], &changed["parameters"]["where"]), (&().into(), &().into()));
    assert_eq!(
        report.residual.effects.iter().map(ReportEffect::place).collect::<Vec<_>>(),
        [Some("process"), None]
    );
    assert_eq!(serde_json::from_value::<Report>(json).unwrap(), report);
}

#[test]
fn what_was_traced_decides_without_effects_too_unless_it_cannot_tell() {
    use crate::results::made_findings;
    let declared = Diagnosis { verdict: Verdict::NoStiction, ..sticky(vec![40.0, 46.0]) };
    let told = |verdict| {
        let found = made_findings(verdict, Vec::new());
        let report = Report::new("x", None, &declared).with_findings(None, &declared, &found);
        (report.verdict, report.f, report.posterior, report.reason, report.residual.f_after)
    };
    let reason = "f = 2.208 [2.100, 2.300], evidence 707".to_string();
    assert_eq!(
        told(Verdict::Stiction),
        (ReportVerdict::Stiction, Some(2.208), Some(0.9995), reason, Some(2.208))
    );
    let unknown = told(Verdict::NotIdentifiable(NotIdentifiable::FlatPv));
    assert_eq!(unknown, (ReportVerdict::NoStiction, Some(2.5), None, declared.reason.clone(), None));
}

#[test]
fn the_traced_stretch_is_told_apart_from_the_diagnosed_window() {
    use crate::residual::Traced;
    use crate::results::made_findings;
    let declared = sticky(vec![40.0, 46.0]);
    let elsewhere = |start, end, n| {
        let traced = Traced { start, end, n };
        let found = Findings { traced, ..made_findings(Verdict::Stiction, Vec::new()) };
        let report = Report::new("x", None, &declared).with_findings(None, &declared, &found);
        report.traced_elsewhere().map(|traced| (traced.start, traced.end, traced.n))
    };
    // The diagnosed window has 1,000 samples of 50 s, from 0 s on.
    assert_eq!(elsewhere(1e-6, 49950.0 - 1e-6, 1000), None, "the same, computed along another way");
    let later = (Some(50.0), Some(50000.0), 1000);
    assert_eq!(elsewhere(50.0, 50000.0, 1000), Some(later));
    let longer = (Some(0.0), Some(99950.0), 2000);
    assert_eq!(elsewhere(0.0, 99950.0, 2000), Some(longer));
    assert_eq!(Report::new("x", None, &declared).traced_elsewhere(), None, "nothing was traced");
}

#[test]
fn what_a_run_without_a_search_did_not_ask_is_null() {
    use crate::results::made_findings;
    let declared = sticky(vec![40.0, 46.0]);
    let told = |structure: Option<crate::residual::Structure>| {
        let found = Findings { structure, ..made_findings(Verdict::Stiction, Vec::new()) };
        let report = Report::new("FIC101", None, &declared).with_findings(None, &declared, &found);
        let json = serde_json::to_value(&report).unwrap();
        assert_eq!(serde_json::from_value::<Report>(json.clone()).unwrap(), report);
        json
    };
    let asked = |json: &serde_json::Value| {
        let residual = &json["residual"];
        [&json["rival"], &residual["verdict_before"], &residual["f_before"]].map(|value| !value.is_null())
    };
    let of =
        |confirmed| Some(crate::residual::Structure { confirmed, searched: 7200.0, ..Default::default() });
    assert_eq!(asked(&told(None)), [true; 3]);
    assert_eq!(asked(&told(of(0))), [true; 3]);
    let confirmed = told(of(3));
    assert_eq!(asked(&confirmed), [false; 3]);
    assert_eq!((&confirmed["f"], &confirmed["residual"]["f_after"]), (&2.208.into(), &2.208.into()));
    let structure = &confirmed["residual"]["structure"];
    assert_eq!((&structure["confirmed"], &structure["searched"]), (&3.into(), &7200.0.into()));
}

#[test]
fn nothing_known_is_null() {
    let diagnosis = Diagnosis::bare(Verdict::NotIdentifiable(NotIdentifiable::FlatPv), "flat PV");
    let json = serde_json::to_value(Report::from(("x", &diagnosis))).unwrap();
    assert_eq!(json["verdict"], "not_identifiable");
    assert_eq!(json["reason_code"], "flat_pv");
    assert_eq!(json["f_unit"], "OP units");
    for null in ["f", "f_ci95", "delta_aic", "oscillation", "model", "preparation", "aic_curve"] {
        assert!(json[null].is_null(), "{null}");
    }
    assert_eq!(json["window"]["n"], 0);
    assert!(json["window"]["ts_s"].is_null());
    assert_eq!(json["residual"]["effects"], serde_json::json!([]));
    assert_eq!(json["residual"]["unexplained"], false);
}

#[test]
fn unit_of_f() {
    let unit = |span: Option<f64>, op: &[f64]| {
        let report = Report::new("x", span, &sticky(op.to_vec()));
        (report.f_unit, report.f_unit_assumed, report.f)
    };
    // A configured span decides and converts: 2.5 of 0..16 mA is 15.625 %.
    assert_eq!(unit(Some(100.0), &[-1.0, 1.0]), ("% OP".into(), false, Some(2.5)));
    assert_eq!(unit(Some(16.0), &[4.0, 20.0]), ("% OP".into(), false, Some(15.625)));
    // Without one it is in OP's own unit, whatever the values: 17 to 21 may be psi.
    for op in [[17.0, 21.0], [11.0, 13.0], [-1.0, 0.99], [389.0, 395.0], [0.2, 0.9]] {
        // A span that is no span counts as unknown.
        for span in [None, Some(f64::NAN), Some(0.0)] {
            assert_eq!(unit(span, &op), ("OP units".into(), true, Some(2.5)), "{op:?} {span:?}");
        }
    }
}

#[test]
fn window_quality_rule() {
    assert_eq!(WindowQuality::of(0.02, 0.5), WindowQuality::Good);
    assert_eq!(WindowQuality::of(0.021, 0.0), WindowQuality::Fair);
    assert_eq!(WindowQuality::of(0.0, 0.51), WindowQuality::Fair);
    assert_eq!(WindowQuality::of(0.11, 0.0), WindowQuality::Poor);
    assert_eq!(WindowQuality::of(0.0, 1.1), WindowQuality::Poor);
    assert_eq!(WindowQuality::of(f64::NAN, 0.0), WindowQuality::Poor);
    assert_eq!(WindowQuality::of(0.0, f64::NAN), WindowQuality::Poor);
}

#[test]
fn what_an_archive_did_is_told_by_kind_evidence_and_note() {
    use crate::diagnosis::{HistoryFound, HistoryKind};
    use crate::signal::Role;
    let mut found = sticky(vec![0.0, 1.0]);
    let kind = HistoryKind::Held;
    found.preparation.history = Some(Box::new(HistoryFound { kind, role: Role::Pv, evidence: [0.99, 5.0] }));
    let report = Report::from(("FIC101", &found));
    let said = serde_json::to_value(&report.window.history).expect("it can be written");
    assert_eq!(
        said,
        serde_json::json!({"kind": "held", "evidence": "PV: 99 % of the changes at every 5th sample", "note": kind.note()})
    );
    // A report of before there was the field is read as one where nothing shows.
    let mut old = serde_json::to_value(&report).expect("it can be written");
    old["window"].as_object_mut().expect("an object").remove("history");
    old.as_object_mut().expect("an object").remove("posterior");
    for name in ["traced", "candidates", "simulates_worse"] {
        old["residual"].as_object_mut().expect("an object").remove(name);
    }
    let old: Report = serde_json::from_value(old).expect("it can be read");
    assert_eq!((old.window.history, old.posterior), (None, None));
    assert!(old.residual.candidates.is_empty() && !old.residual.simulates_worse);
    assert_eq!(old.residual.traced, None);
}

#[test]
fn opinions_are_told_in_the_unit_of_f_and_what_has_no_number_is_null() {
    use crate::detectors::{Agreement, Band, Method, Opinion};
    use crate::results::Judged;
    let diagnosis = sticky(vec![4.0, 12.0]);
    let lee = Opinion::of(Method::Lee2008, 0.7, Band::above(0.23), "made for a test").with(1.6, "S");
    let agreement = Agreement { sticks: 0, could_tell: 5, agree: 0, doubtful: true, ..Agreement::default() };
    let opinions = vec![Opinion::cannot_tell(Method::He2007, "no period"), lee];
    let judged = Judged { opinions, agreement: Some(agreement), ..diagnosis.into() };
    // 16 mA are the whole span: 1.6 mA are 10 %.
    let report = Report::judged("FIC101", (Some(16.0), SpanSource::Given), &judged);
    let [he, lee] = &report.opinions[..] else { panic!("two") };
    assert_eq!((he.says, he.index, he.threshold), (ReportSays::CannotTell, None, None));
    assert_eq!(lee.threshold, Some(ReportThreshold { sound: None, sticks: Some(0.23) }));
    let measured = lee.quantity.as_ref().expect("it measures S");
    assert_eq!(
        (measured.value, measured.unit.as_str(), lee.unit.as_deref()),
        (Some(10.0), "% OP", Some("% OP"))
    );
    assert!(report.doubtful);
    assert_eq!(
        report.doubt().as_deref(),
        Some(
            "All 5 other methods that gave a result say that the valve does not stick. Look at the loop before you rely on the verdict."
        )
    );
}

#[test]
fn a_report_of_before_there_were_opinions_can_be_read() {
    let report = Report::new("FIC101", None, &sticky(vec![1.0, 2.0]));
    let mut value = serde_json::to_value(&report).expect("JSON");
    let fields = value.as_object_mut().expect("an object");
    for name in ["opinions", "agreement", "doubtful"] {
        assert!(fields.remove(name).is_some(), "{name}");
    }
    let read: Report = serde_json::from_value(value).expect("it is read");
    assert!(read.opinions.is_empty() && read.agreement.is_none() && !read.doubtful);
}
