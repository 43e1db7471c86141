//! What a binary built without the feature `writeback` is: one in which the writer does not exist. That it cannot be
//! called is shown by type, in an example of `stictiond::writeback` that must not compile; here it is shown of the
//! binary. Built with the feature the same looks find the writer: they can fail.

use std::fs;
use std::path::Path;
use std::process::Command;
use stictiond::writeback::BUILT_IN;

/// The writer's name as the compiler mangles it, and a text that only the writer has.
const TRACES: [&str; 2] = ["9writeback4link", "a write was answered with "];

#[test]
fn the_writer_is_in_the_binary_only_with_the_feature() {
    // The binary of a test build has 200 MB, in which code that is not optimised looks for a long time.
    let holds = |what: &str| {
        let grep = Command::new("grep")
            .args(["-qaF", what, env!("CARGO_BIN_EXE_stictiond")])
            .env("LC_ALL", "C")
            .status();
        match grep.expect("grep is there").code() {
            Some(0) => true,
            Some(1) => false,
            code => panic!("the binary cannot be read: grep ends with {code:?}"),
        }
    };
    assert!(holds("9writeback6config"), "the binary has no symbols to look at");
    for trace in TRACES {
        assert_eq!(holds(trace), BUILT_IN, "{trace}");
    }
}

fn config(enabled: bool) -> String {
    let tag = |role: &str, address: u16, kind: &str| {
        format!("[loop.{role}]\ndevice = 'd'\nregister = 'holding'\naddress = {address}\ntype = '{kind}'\n")
    };
    format!(
        "[writeback]\naudit_file = 'audit.log'\n[[modbus]]\nname = 'd'\naddress = '127.0.0.1:9'\naddress_base = 0\n\
         [[loop]]\nid = 'A'\nop_span = 100.0\nop_limits = [0.0, 100.0]\nfrozen_pv_s = 60.0\n{}{}{}{}{AUTO}[loop.writeback]\n\
         enabled = {enabled}\n{BOUNDS}",
        tag("op", 0, "f32"),
        tag("pv", 2, "f32"),
        tag("sp", 4, "f32"),
        tag("mode", 6, "u16"),
    )
}

/// Of the mode.
const AUTO: &str = "auto_values = [1]\n";

const BOUNDS: &str = "device = 'd'
term_address = 100
term_type = 'f32'
term_byte_order = 'ABCD'
term_scale_percent = 1.0
heartbeat_address = 102
heartbeat_timeout_ms = 10000
write_ms = 1000
timeout_ms = 500
clamp_percent = 3.0
rate_percent_per_s = 5.0
withdraw_percent_per_s = 1.0
withdraw_limit_s = 20.0
dead_band_percent = 0.1
rest_ms = 3000
max_step_ms = 4000
clock_tolerance_ms = 1000
max_sample_age_ms = 5000
max_missed_polls_per_minute = 5
op_margin_percent = 5.0
sp_rate_per_s = 0.1
sp_settle_s = 60.0
evidence_max_age_s = 86400.0
f_margin_percent = 0.2
grant_max_s = 28800.0
measure_s = 3600.0
prove_s = 7200.0
ise_gain = 1.5
ise_limit = 1.5
travel_limit = 10.0
reversal_band_percent = 0.2
";

fn check(name: &str, text: &str) -> (Option<i32>, String) {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    fs::write(&path, text).expect("the test directory is writable");
    let output =
        Command::new(env!("CARGO_BIN_EXE_stictiond")).args(["check", "--config"]).arg(&path).output();
    let output = output.expect("the binary starts");
    (output.status.code(), String::from_utf8(output.stderr).expect("UTF-8"))
}

#[test]
fn a_configuration_that_needs_the_writer_is_refused_where_there_is_none() {
    let (code, errors) = check("enabled.toml", &config(true));
    if BUILT_IN {
        assert_eq!((code, errors.as_str()), (Some(0), ""));
    } else {
        assert_eq!((code, errors.lines().count()), (Some(2), 1), "{errors}");
        assert!(errors.contains(":34:11: enabled: this stictiond cannot write"), "{errors}");
    }
    assert_eq!(check("off.toml", &config(false)).0, Some(0), "off it means the same to every binary");
}

/// A term in manual, and a second connection where there is one only.
#[test]
fn a_mode_that_does_not_say_what_automatic_is_and_a_line_of_another_are_refused() {
    let errors = |from: &str, to: &str| {
        let text = config(true).replacen(from, to, 1);
        assert_ne!(text, config(true), "{from}");
        check("manual.toml", &text).1
    };
    let said = errors(AUTO, "");
    assert!(said.contains(":33:11: enabled: write-back needs auto_values in [loop.mode]"), "{said}");
    let word = format!("register = 'holding'\naddress = 6\ntype = 'u16'\n{AUTO}");
    for bit in [
        "register = 'coil'\naddress = 6\n",
        "register = 'discrete'\naddress = 6\n",
        "register = 'holding'\naddress = 6\ntype = 'bit'\nbit = 3\n",
    ] {
        let said = errors(&word, bit);
        assert!(!said.contains("auto_values"), "{bit}: {said}");
    }
    for line in ["framing = 'rtu'", "share_connection = true"] {
        let said = errors("address_base = 0\n", &format!("address_base = 0\n{line}\n"));
        let key = line.replace('\'', "\"");
        assert!(said.contains(&format!("device: \"d\" has {key}, and write-back")), "{line}: {said}");
    }
    // What writes nothing may stand on any device.
    let off = config(false).replacen(AUTO, "", 1).replacen(
        "address_base = 0",
        "address_base = 0\nframing = 'rtu'",
        1,
    );
    assert_eq!(check("manual.toml", &off).0, Some(0));
}

#[test]
fn registers_that_another_uses_are_refused() {
    let overlapping = |from: &str, to: &str| {
        let text = config(false).replace(from, to);
        let (code, errors) = check("overlap.toml", &text);
        assert_eq!(code, Some(2), "{from} {to}");
        errors
    };
    // OP's second register, PV's first, the last of SP with the first of the mode; the heartbeat on the term, on OP.
    for (from, to, what) in [
        ("term_address = 100", "term_address = 1", ":36:16: term_address: overlaps op of loop A (line "),
        ("term_address = 100", "term_address = 2", "overlaps pv of loop A"),
        ("term_address = 100", "term_address = 5", "overlaps sp of loop A"),
        (
            "heartbeat_address = 102",
            "heartbeat_address = 101",
            "heartbeat_address: overlaps term_address of loop A",
        ),
        ("heartbeat_address = 102", "heartbeat_address = 0", "heartbeat_address: overlaps op of loop A"),
        ("heartbeat_address = 102", "heartbeat_address = 65536", "heartbeat_address: must be 0 to 65535"),
        ("device = 'd'\nterm_address", "device = 'e'\nterm_address", "no [[modbus]] is called \"e\""),
        (
            "max_step_ms = 4000",
            "max_step_ms = 2000",
            "max_step_ms: 2000 must be at least write_ms + 4 timeout_ms",
        ),
        (
            "heartbeat_timeout_ms = 10000",
            "heartbeat_timeout_ms = 6000",
            "heartbeat_timeout_ms: 6000 must be more than max_step_ms + 4 timeout_ms = 6000",
        ),
        (
            "op_margin_percent = 5.0",
            "op_margin_percent = 1.0",
            "op_margin_percent: 1 must be at least clamp_percent",
        ),
        ("term_type = 'f32'", "term_type = 'i16'", "term_scale_percent: 1 is too coarse for a whole number"),
        ("withdraw_limit_s = 20.0", "withdraw_limit_s = nan", "withdraw_limit_s: NaN must be"),
        ("ise_gain = 1.5", "ise_gain = 1.0", "ise_gain: 1 must be 1.01"),
        ("clamp_percent = 3.0\n", "", "missing key \"clamp_percent\""),
        ("clamp_percent = 3.0\n", "clamp_percent = 3.0\nclamp = 1\n", "clamp"),
    ] {
        let errors = overlapping(from, to);
        assert!(errors.contains(what), "{to}: {errors}");
    }
    // The same device under another name, address or unit may be the same device.
    let twin = |first: &str, second: &str, unit: u8| {
        let other = format!(
            "[[modbus]]\nname = 'e'\naddress = '{second}'\naddress_base = 1\nunit_id = {unit}\n[[loop]]"
        );
        // A unit that must not be written to is refused where somebody writes.
        let text = config(unit == 0)
            .replacen("127.0.0.1:9", first, 1)
            .replacen("[[loop]]", &other, 1)
            .replace("device = 'd'\nterm_address = 100", "device = 'e'\nterm_address = 1");
        check("twin.toml", &text)
    };
    for (first, second, unit) in [
        ("127.0.0.1:9", "127.0.0.1:9", 1),
        ("127.0.0.1:9", "localhost:9", 1),
        ("[::1]:9", "localhost:9", 1),
        ("plc1:9", "PLC1:09", 1),
        ("plc1:9", "plc1.plant.example.:9", 1),
        ("plc1:9", "plc1:9", 255),
    ] {
        let (code, errors) = twin(first, second, unit);
        assert!(
            code == Some(2) && errors.contains("overlaps op of loop A"),
            "{first} {second} {unit}: {errors}"
        );
    }
    for (first, second, unit) in
        [("plc1:9", "plc2:9", 1), ("plc1:9", "plc11:9", 1), ("plc1:9", "plc1:10", 1), ("plc1:9", "plc1:9", 2)]
    {
        assert_eq!(twin(first, second, unit).0, Some(0), "{first} {second} {unit} are two devices");
    }
    let (code, errors) = twin("plc1:9", "plc2:9", 0);
    assert!(code == Some(2) && errors.contains("device: \"e\" has unit_id = 0"), "{errors}");
}
