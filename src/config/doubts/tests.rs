use super::STOP_S;
use crate::config::parse;

const DEVICE: &str = "[[modbus]]\nname = 'd'\naddress = 'plc1:502'\naddress_base = 0\n";

/// A loop of a device `d`; what `op` and `more` say stands in its sections.
fn of_loop(op: &str, more: &str) -> String {
    let tag = |role: &str, address: u8, own: &str| {
        format!("[loop.{role}]\ndevice = 'd'\nregister = 'holding'\naddress = {address}\n{own}\n")
    };
    let (op, pv) = (tag("op", 0, op), tag("pv", 2, "type = 'f32'"));
    format!("[[loop]]\nid = 'A'\nop_span = 100.0\nop_limits = [0, 100]\n{op}{pv}{more}")
}

fn remarks(text: &str) -> String {
    parse("f", text).unwrap_or_else(|errors| panic!("{text}\n{errors:?}")).remarks().join("\n")
}

fn errors(text: &str) -> String {
    let errors = parse("f", text).expect_err(text);
    errors.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
}

const PLAIN: &str = "type = 'f32'";

#[test]
fn what_a_register_cannot_send_is_told() {
    for (op, said) in [
        (
            "type = 'u16'\nscale = 0.1\nrange = [-50, 200]",
            "A.op: range begins at -50, and u16 is never below 0: write type = \"i16\"",
        ),
        (
            "type = 'i16'\nscale = 0.01\nrange = [0, 10000]",
            "is -327.68 to 327.67: range is in the tag's own unit",
        ),
        (
            "type = 'u16'\nscale = 1.0",
            "A.op: it comes in steps of 1.00 % of its span, and friction counts from 0.05 %",
        ),
        (
            "type = 'u16'\nscale = 0.0001",
            "A.op: its span is 100, and u16 with this scale is 0 to 6.554: op_span, op_limits and unit are those of OP after",
        ),
    ] {
        let found = remarks(&(DEVICE.to_string() + &of_loop(op, "")));
        assert!(found.contains(said), "{op}: {found}");
    }
    let fine = remarks(&(DEVICE.to_string() + &of_loop("type = 'u16'\nscale = 0.01\nrange = [0, 100]", "")));
    assert_eq!(fine, "");
    let never = of_loop("type = 'u16'\nscale = 0.001\nrange = [100, 700]", "");
    let found = errors(&(DEVICE.to_string() + &never));
    assert!(
        found.contains("range: [100, 700] is never met: u16 with this scale and offset is 0 to 65.535"),
        "{found}"
    );
    let mode = |own: &str| of_loop(PLAIN, &format!("[loop.mode]\ndevice = 'd'\n{own}\n"));
    for (own, said) in [
        ("register = 'coil'\naddress = 6\nauto_values = [2]", "auto_values: 2 never comes: a coil is 0 to 1"),
        (
            "register = 'holding'\ntype = 'u16'\naddress = 6\nauto_values = [-1]",
            "-1 never comes: u16 is 0 to 65535",
        ),
    ] {
        let found = errors(&(DEVICE.to_string() + &mode(own)));
        assert!(found.contains(said), "{own}: {found}");
    }
    let both = mode("register = 'coil'\naddress = 6\nauto_values = [0, 1]");
    assert!(remarks(&(DEVICE.to_string() + &both)).contains("A.mode: 0 and 1 are both automatic"));
}

#[test]
fn times_that_do_not_go_together_are_told() {
    let slow = DEVICE.to_string() + "poll_ms = 300000\n" + &of_loop(PLAIN, "");
    let found = remarks(&slow);
    assert!(
        found.contains("d: it is asked every 300 s, and [alarm.collector_down] after_s = 120"),
        "{found}"
    );
    assert!(found.contains("write 900 or more"), "{found}");
    let waits = format!("[alarm.collector_down]\nafter_s = 900\n{slow}");
    assert_eq!(remarks(&waits), "");
    let tag = |role: &str| format!("[loop.{role}]\ndevice = 'b'\ntopic = '{role}'\n");
    let broker = |silent_s: u32| {
        format!(
            "[[mqtt]]\nname = 'b'\naddress = 'broker:1883'\nsilent_s = {silent_s}\n[[loop]]\nid = 'A'\nop_span = 100.0\n{}{}",
            tag("op"),
            tag("pv")
        )
    };
    assert!(remarks(&broker(600)).contains("b: it is looked into after silent_s = 600 without a value"));
    assert!(!remarks(&broker(120)).contains("silent_s"), "{}", remarks(&broker(120)));
    let found = errors(&format!("[diagnosis]\nts_s = 0.1\n{DEVICE}{}", of_loop(PLAIN, "")));
    assert!(
        found.contains("ts_s: 0.1 is shorter than the time between two polls of every loop, 1 s of A"),
        "{found}"
    );
    let other = "[[modbus]]\nname = 'e'\naddress = 'plc2:502'\naddress_base = 0\npoll_ms = 60000\n";
    let apart = of_loop(PLAIN, "").replace("[loop.pv]\ndevice = 'd'", "[loop.pv]\ndevice = 'e'");
    let found = remarks(&format!("{DEVICE}{other}{apart}"));
    assert!(found.contains("A: op comes every 1000 ms and pv every 60000 ms"), "{found}");
}

#[test]
fn a_unit_that_is_read_in_two_ways_is_told() {
    let second = "[[modbus]]\nname = 'e'\naddress = 'PLC1:502'\naddress_base = 1\nbyte_order = 'CDAB'\n";
    let found = remarks(&format!("{DEVICE}{second}{}", of_loop(PLAIN, "")));
    assert!(
        found.contains(
            "e: it is unit 1 at PLC1:502 as d is, with another address_base and another byte_order"
        ),
        "{found}"
    );
}

#[test]
fn a_device_that_no_loop_reads_from_is_told() {
    let other = "[[modbus]]\nname = 'e'\naddress = 'plc2:502'\naddress_base = 0\n";
    assert_eq!(remarks(&format!("{other}{DEVICE}{}", of_loop(PLAIN, ""))), "e: no loop reads from it");
    let read =
        "[[loop.tag]]\nname = 'level'\ndevice = 'e'\nregister = 'holding'\naddress = 0\ntype = 'f32'\n";
    assert_eq!(remarks(&format!("{other}{DEVICE}{}", of_loop(PLAIN, read))), "");
}

#[cfg(feature = "writeback")]
#[test]
fn a_gate_that_could_not_stay_open_is_told() {
    let tags = "[loop.sp]\ndevice = 'd'\nregister = 'holding'\naddress = 4\ntype = 'f32'\n[loop.mode]\ndevice = 'd'\n\
                register = 'coil'\naddress = 0\n";
    let bounds = "[loop.writeback]\nenabled = true\ndevice = 'd'\nterm_address = 100\nterm_type = 'f32'\n\
        term_byte_order = 'ABCD'\nterm_scale_percent = 1.0\nheartbeat_address = 102\nheartbeat_timeout_ms = 9000\n\
        write_ms = 500\ntimeout_ms = 500\nclamp_percent = 3.0\nrate_percent_per_s = 2.0\nwithdraw_percent_per_s = 2.0\n\
        withdraw_limit_s = 30.0\ndead_band_percent = 0.05\nrest_ms = 3000\nmax_step_ms = 5000\nclock_tolerance_ms = 500\n\
        max_sample_age_ms = 5000\nmax_missed_polls_per_minute = 2\nop_margin_percent = 5.0\nsp_rate_per_s = 0.1\n\
        sp_settle_s = 60.0\nf_margin_percent = 0.2\nmeasure_s = 600.0\nprove_s = 3600.0\nise_gain = 1.5\n\
        ise_limit = 2.0\ntravel_limit = 30.0\nreversal_band_percent = 0.2\n";
    let of = |grant_s: f64, age_s: f64, limit_s: f64| {
        let bounds = bounds.replace("withdraw_limit_s = 30.0", &format!("withdraw_limit_s = {limit_s:?}"));
        let more = format!("{tags}{bounds}grant_max_s = {grant_s:?}\nevidence_max_age_s = {age_s:?}\n");
        remarks(&format!(
            "[writeback]\naudit_file = '/var/lib/a.log'\n{DEVICE}{}",
            of_loop(PLAIN, &more).replace("op_span", "frozen_pv_s = 60.0\nop_span")
        ))
    };
    assert!(of(3000.0, 7200.0, 30.0).contains("grant_max_s = 3000, and the gain may take prove_s = 3600"));
    assert!(
        of(86_400.0, 1800.0, 30.0).contains("evidence_max_age_s = 1800, and a diagnosis comes every 3600 s")
    );
    // Of 4096 samples, one a second.
    let (short, long) = (of(86_400.0, 7695.0, 30.0), of(86_400.0, 7696.0, 30.0));
    assert!(short.contains("evidence_max_age_s = 7695") && short.contains("write 7696 or more"), "{short}");
    assert!(!long.contains("evidence_max_age_s"), "{long}");
    // With max_step_ms = 5000 and 2 s the limit is what deploy/ allows, and a second more.
    assert!(of(86_400.0, 7696.0, STOP_S - 6.0).contains("A.writeback: its term may take 91 s"));
    let fine = of(86_400.0, 7696.0, STOP_S - 7.0);
    let told = ["grant_max_s", "evidence_max_age_s", "its term may take"];
    assert!(!told.iter().any(|own| fine.contains(own)), "{fine}");
}

#[test]
fn what_is_in_deploy_waits_for_a_term_as_long_as_is_said_here() {
    for (file, key) in [
        ("systemd/stictiond.service", "TimeoutStopSec="),
        ("compose.yml", "stop_grace_period: "),
        ("kubernetes/stictiond.yaml", "terminationGracePeriodSeconds: "),
    ] {
        let path = format!("{}/deploy/{file}", env!("CARGO_MANIFEST_DIR"));
        let text = std::fs::read_to_string(&path).expect(&path);
        assert!(text.contains(&format!("{key}{STOP_S}")), "{file}");
    }
}

#[test]
fn a_receiver_that_never_hears_of_what_it_asks_for_is_told() {
    let mail = "[[notify.smtp]]\nname = 'm'\naddress = 'mail.plant:587'\nfrom = 'a@b.c'\nto = ['d@e.f']\n\
        [notify.smtp.filter]\nmin_priority = 'medium'\nkinds = ['stiction', 'f_rising']\n";
    let found = remarks(&format!("{mail}{DEVICE}{}", of_loop(PLAIN, "")));
    assert!(found.contains("m: it never hears of f_rising, which has the priority low"), "{found}");
    let raised = format!("[alarm.f_rising]\npriority = 'medium'\n{mail}{DEVICE}{}", of_loop(PLAIN, ""));
    assert!(!remarks(&raised).contains("never hears"), "{}", remarks(&raised));
}

#[test]
fn secrets_are_not_shown_and_advice_can_be_followed() {
    let broker = "[[mqtt]]\nname = 'b'\naddress = 'user:geheim@broker:1883'\n";
    let found = errors(&format!("{broker}{DEVICE}{}", of_loop(PLAIN, "")));
    assert!(found.contains("a log-in stands in keys of its own") && !found.contains("geheim"), "{found}");
    let hook = "[[notify.webhook]]\nname = 'w'\nurl = 'https://h/x'\nsecret_file = 'whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw'\n";
    let found = errors(&format!("{hook}{DEVICE}{}", of_loop(PLAIN, "")));
    assert!(found.contains("is the secret itself") && !found.contains("MfKQ"), "{found}");
    let found = errors(&(DEVICE.to_string() + &of_loop("type = 'f32'\nrange = ['0', '100']", "")));
    assert!(found.contains("range: a number without quotes is expected, write in the list 0"), "{found}");
    let found =
        errors(&format!("[alarm]\nsuppressed = {{ A = 'stiction' }}\n{DEVICE}{}", of_loop(PLAIN, "")));
    assert!(found.contains("suppressed: a list is expected, in [square brackets]"), "{found}");
    let found = errors(&format!("[alarm]\nmedium_f_percent = 50.0\n{DEVICE}{}", of_loop(PLAIN, "")));
    let said = "high_f_percent is left out, and its default 2 must be at least medium_f_percent = 50: write";
    assert!(found.starts_with("f:2:") && found.contains(said), "{found}");
}

#[test]
fn paths_and_topics_that_find_nothing_are_refused() {
    let mqtt = |broker: &str, op: &str| {
        format!(
            "[[mqtt]]\nname = 'b'\naddress = 'broker:1883'\n{broker}\n[[loop]]\nid = 'A'\n[loop.op]\ndevice = 'b'\n{op}\n\
            [loop.pv]\ndevice = 'b'\ntopic = 'p'\npath = 'v'\ntime_path = 't'\n"
        )
    };
    for (broker, op, said) in [
        (
            "time_fallback = 'none'",
            "topic = 'o'\npath = 'v'",
            "a value needs a time_path: every one would be refused",
        ),
        ("", "topic = 'o '", "has a blank before or after it"),
        ("", "topic = 'o'\npath = '/values/op'", "write values.op"),
        ("", "topic = 'o'\npath = 'op '", "write 'op'"),
    ] {
        let found = errors(&mqtt(broker, op));
        assert!(found.contains(said), "{op}: {found}");
    }
    let path = "[[opcua]]\nname = 's'\nurl = 'opc.tcp://h:4840/'\nsecurity_policy = 'None'\n[[loop]]\nid = 'A'\n[loop.op]\n\
        device = 's'\npath = '/0:Root/0:Objects/2:Unit/2:OP'\n[loop.pv]\ndevice = 's'\npath = '/Objects/2:Unit/2:PV'\n";
    let found = errors(path);
    assert!(found.contains("write /2:Unit/2:OP") && found.contains("write /2:Unit/2:PV"), "{found}");
}
