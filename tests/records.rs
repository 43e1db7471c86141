//! Records that were once judged wrongly, read as a user's files: OP in other units than per cent, an oscillation that is faster
//! than the samples show, and a pump that was taken for a valve that sticks.

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// f of the record of which three files are copies in other units (% OP), as `docs/closing-the-loop.md` has it for CHEM1.
const F_PERCENT: f64 = 0.35;
/// f is the same in every unit to this share, as in `numerics/tests/units.rs`.
const SAME_F: f64 = 1e-3;

fn shared(name: &str) -> Option<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors();
    let path = root.map(|up| up.join("shared/cases/records").join(name)).find(|path| path.exists());
    if path.is_none() {
        println!("skipped: there is no shared/cases/records/{name}");
    }
    path
}

/// The report on a record; `None` where it is not there.
fn report(name: &str, more: &[&str]) -> Option<Value> {
    let output = Command::new(env!("CARGO_BIN_EXE_stictiond"))
        .args(["diagnose", "--format", "json"])
        .arg(shared(name)?)
        .args(more)
        .output()
        .expect("runs");
    assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
    Some(serde_json::from_slice(&output.stdout).expect("JSON"))
}

/// f of a report that tells stiction, with its unit and the source of OP's span.
fn told(name: &str, report: &Value) -> (f64, String, String) {
    assert_eq!(report["verdict"], "stiction", "{name}: {}", report["reason"]);
    assert!(report["reason_code"].is_null(), "{name}: {}", report["reason_code"]);
    let text = |key: &str| report[key].as_str().expect("a text").to_string();
    (report["f"].as_f64().expect("a number"), text("f_unit"), text("op_span_source"))
}

#[test]
fn a_valve_that_sticks_is_told_so_in_shares_and_amperes_and_milliamperes() {
    let mut percent = Vec::new();
    for (name, more, source) in [
        ("op_frac.csv", &[][..], "values"),
        ("op_amp.csv", &[], "values"),
        ("op_mA.csv", &["--op-span", "16"], "given"),
    ] {
        let Some(report) = report(name, more) else { return };
        let (f, unit, from) = told(name, &report);
        assert_eq!((unit.as_str(), from.as_str()), ("% OP", source), "{name}");
        assert!((f - F_PERCENT).abs() < 0.02, "{name}: {f}");
        percent.push(f);
    }
    // Values of 9.8 may be milliamperes or per cent: f is in OP's own unit then, and the same.
    let Some(report) = report("op_mA.csv", &[]) else { return };
    let (f, unit, from) = told("op_mA.csv", &report);
    assert_eq!((unit.as_str(), from.as_str()), ("OP units", "unknown"));
    percent.push(f * 100.0 / 16.0);
    for f in &percent {
        assert!((f / percent[0] - 1.0).abs() < SAME_F, "{percent:?}");
    }
}

#[test]
fn an_oscillation_that_the_samples_do_not_show_is_named_with_the_poll_it_needs() {
    let Some(report) = report("undersampled.csv", &[]) else { return };
    let code = [&report["verdict"], &report["reason_code"], &report["f_unit"]].map(Value::as_str);
    assert_eq!(code, ["not_identifiable", "undersampled", "% OP"].map(Some));
    let why = "undersampled: 2.2 samples per period, ten are needed: poll at least every 39 s";
    assert!(report["reason"].as_str().is_some_and(|reason| reason.starts_with(why)), "{}", report["reason"]);
    // No period, no f, and no effect of what is not there.
    assert!(report["oscillation"].is_null() && report["f"].is_null(), "{report}");
    assert_eq!(report["residual"]["effects"].as_array().map(Vec::len), Some(0));
    // The published methods give the same reason; a stem is not measured.
    let opinions = report["opinions"].as_array().expect("a window has opinions");
    assert_eq!(opinions.len(), 12);
    for opinion in opinions {
        let stem = opinion["method"] == "stem_loop";
        let expected = if stem { "no stem that moves is measured" } else { why };
        assert_eq!((&opinion["says"], &opinion["why"]), (&"cannot_tell".into(), &expected.into()));
    }
}

#[test]
fn a_pump_is_not_told_to_be_a_valve_that_sticks() {
    let Some(report) = report("rig_noRTO_pump.csv", &[]) else { return };
    assert_ne!(report["verdict"], "stiction", "{}", report["reason"]);
    // OP is 4 to 20 mA, written in amperes.
    assert_eq!((&report["f_unit"], &report["op_span_source"]), (&"% OP".into(), &"values".into()));
    let undecided = report["verdict"] == "not_identifiable";
    assert_eq!(report["reason_code"].is_string(), undecided, "{}", report["reason"]);
    let f = report["f"].as_f64();
    assert_eq!(f, (!undecided).then_some(0.0), "{}", report["reason"]);
}
