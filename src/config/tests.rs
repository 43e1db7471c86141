use super::*;
use proptest::prelude::*;

const EXAMPLE: &str = include_str!("../../config/stictiond.toml");

const DEVICE: &str = "[[modbus]]\nname = 'd'\naddress = 'h:1'\naddress_base = 0\n";

/// The smallest configuration, with lines of its own at the end.
fn minimal(more: &str) -> String {
    format!(
        "{DEVICE}[[loop]]\nid = 'A'\n[loop.op]\ndevice = 'd'\nregister = 'holding'\naddress = 0\ntype = 'f32'\n\
         [loop.pv]\ndevice = 'd'\nregister = 'holding'\naddress = 2\ntype = 'f32'\n{more}"
    )
}

fn errors(text: &str) -> Vec<String> {
    parse("f", text).unwrap_err().iter().map(Diagnostic::to_string).collect()
}

#[test]
fn every_file_in_config_is_accepted() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("config");
    let mut files = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "toml") {
            let config = load(&path).unwrap_or_else(|errors| panic!("{}", errors[0]));
            config.plant().unwrap();
            files += 1;
        }
    }
    assert!(files > 0);
}

#[test]
fn the_example_shows_the_defaults() {
    let config = parse("f", EXAMPLE).unwrap();
    let defaults = Config::default();
    assert_eq!(config.server, defaults.server);
    assert_eq!(config.history, defaults.history);
    assert_eq!(config.schedule, defaults.schedule);
    assert_eq!(config.diagnosis, defaults.diagnosis);
    assert_eq!(config.alarm, defaults.alarm);
    assert_eq!((config.modbus.len(), config.loops.len()), (2, 2));
    let periods: Vec<f64> = config.loops.iter().map(|own| config.period_s(own)).collect();
    assert_eq!(periods, [1800.0, 3600.0]);
}

#[test]
fn tags_are_numbered_through_the_loops() {
    let plant = parse("f", EXAMPLE).unwrap().plant().unwrap();
    let names: Vec<Vec<&str>> =
        plant.loops.iter().map(|l| l.tags.iter().map(|tag| tag.kind.name()).collect()).collect();
    assert_eq!(names, [vec!["op", "pv", "sp", "mode", "upstream pressure"], vec!["op", "pv", "mode", "mv"]]);
    let mut numbered: Vec<(usize, &str)> =
        plant.plans.iter().flat_map(|plan| &plan.tags).map(|tag| (tag.index, tag.name.as_str())).collect();
    numbered.sort_unstable();
    let expected = [
        "FIC101.op",
        "FIC101.pv",
        "FIC101.sp",
        "FIC101.mode",
        "FIC101.upstream pressure",
        "LIC7.op",
        "LIC7.pv",
        "LIC7.mode",
        "LIC7.mv",
    ];
    assert_eq!(numbered, expected.into_iter().enumerate().collect::<Vec<_>>());
    // 100..=106 in one request and the input register in another; holding 1..=2 and input 1..=4.
    assert_eq!(plant.plans.iter().map(|plan| plan.requests.len()).collect::<Vec<_>>(), [2, 2]);
    assert_eq!(plant.loops[1].tags[1].source, "modbus localhost:5021 unit 3 input 1 from 1 f32 CDAB");
    assert_eq!(
        plant.plans[0]
            .tags
            .iter()
            .filter_map(|tag| Some((tag.name.as_str(), tag.frozen_after_s?)))
            .collect::<Vec<_>>(),
        [("FIC101.pv", 600.0)]
    );
}

#[test]
fn a_minimal_file_is_accepted() {
    let config = parse("f", &minimal("")).unwrap();
    assert_eq!(config.loops[0].op_span, None);
}

#[test]
fn every_error_of_a_broken_file_has_its_place() {
    let text = "\
[server]
listen = 'everywhere'
[histroy]
samples_per_tag = 1
[schedule]
period_s = 0
parallelism = 1.5
deadline_s = -1.0
[diagnosis]
f_threshold_percent = 'half'
window = 5
[[modbus]]
name = 'dcs1'
address = '10.0.0.5:502'
address_base = 0
polll_ms = 1000
timeout_ms = 'long'
byte_order = 'ABDC'
[[modbus]]
name = 'dcs2'
address = 'nowhere'
unit_id = 256
[[modbus]]
name = 'dcs3'
address = '10.0.0.7:502'
address_base = 0
poll_ms = 0
[[modbus]]
name = 'dcs3'
address = '10.0.0.8:502'
address_base = 2
[[loop]]
id = 'FIC101'
op_limits = [100.0, 0.0]
op_span = 0
  [loop.op]
  device = 'dcs3'
  register = 'holding'
  address = 100
  type = 'f32'
  [loop.pv]
  device = 'dcs4'
  register = 'holding'
  address = 102
  type = 'f32'
  [loop.sp]
  device = 'dcs3'
  register = 'holding'
  address = 101
  type = 'u16'
[[loop]]
id = 'FIC101'
description = 'größer'; colour = 1
";
    // One line that is no TOML hides what follows from it, and the rules across sections.
    let broken = errors(text);
    assert_eq!(
        broken.last().unwrap(),
        "f:53:23: unexpected key or value, expected newline, `#`",
        "{broken:#?}"
    );
    let text = text.replace("'größer'; colour = 1", "'größer'\nframe = { 'größe' = 'ü', x = 1 }");
    let expected = [
        "f:2:10: listen: not an address in numbers and a port, such as 127.0.0.1:8080 for this machine alone or 0.0.0.0:8080 for all",
        "f:3:2: unknown section \"histroy\", did you mean \"history\"?",
        "f:6:12: period_s: 0 must be 1 to 2678400",
        "f:7:15: parallelism: a whole number from 0 is expected, not 1.5",
        "f:8:14: deadline_s: -1 must be 0.1 to 3600",
        "f:10:23: f_threshold_percent: a number is expected, not the text \"half\"",
        "f:11:1: unknown key \"window\" in [diagnosis]; known are f_threshold_percent, evidence_threshold, \
         window_samples, min_samples, max_gap_share, ts_s, max_delay_samples",
        "f:16:1: unknown key \"polll_ms\" in [[modbus]], did you mean \"poll_ms\"?",
        "f:17:14: timeout_ms: a whole number from 0 is expected, not the text \"long\"",
        "f:18:14: byte_order: unknown value \"ABDC\", did you mean \"ABCD\"?",
        "f:19:1: missing key \"address_base\" in [[modbus]]: write 0 where the device's list counts registers from 0, 1 where \
         from 1",
        "f:22:11: unit_id: a whole number from 0 to 255 is expected, not 256",
        "f:27:11: poll_ms: 0 must be 1 to 86400000",
        "f:29:8: device \"dcs3\" is already on line 24; every device needs a name of its own",
        "f:31:16: address_base: 2 must be 0 or 1: write 0 where the device's list counts registers from 0, 1 where from 1",
        "f:34:13: op_limits: [100, 0] must be the lower, then the upper limit",
        "f:35:11: op_span: 0 must be a number above 0",
        "f:42:12: device: no [[modbus]], [[opcua]] or [[mqtt]] is called \"dcs4\", did you mean \"dcs1\"?",
        "f:49:13: address: u16 on holding register 101 overlaps f32 at 100: one register cannot be both \
         (the other is on line 39)",
        "f:51:1: missing key \"op\" in [[loop]]",
        "f:51:1: missing key \"pv\" in [[loop]]",
        "f:52:6: loop \"FIC101\" is already on line 33; every loop needs a name of its own",
        "f:54:1: unknown key \"frame\" in [[loop]]; known are id, description, group, period_s, op_span, op_limits, \
         frozen_pv_s, op, pv, sp, mode, mv, tag, candidates, upstream, cost, writeback",
    ];
    let found = errors(&text);
    for (found, expected) in found.iter().zip(expected) {
        assert_eq!(found, expected);
    }
    assert_eq!(found.len(), expected.len(), "{found:#?}");
}

#[test]
fn structure_is_judged_tag_by_tag() {
    let cases = [
        (
            "[[loop.tag]]\ndevice = 'd'\nregister = 'coil'\naddress = 1\n",
            "f:17:1: missing key \"name\" in [[loop.tag]]",
        ),
        (
            "[[loop.tag]]\nname = 'pv'\ndevice = 'd'\nregister = 'coil'\naddress = 1\n",
            "f:18:8: name: write it as [loop.pv], or give the tag another name",
        ),
        (
            "[loop.sp]\nname = 'x'\ndevice = 'd'\nregister = 'input'\naddress = 2\ntype = 'f32'\n",
            "f:18:8: name: only a [[loop.tag]] has one, this is sp",
        ),
        (
            "[loop.sp]\ndevice = 'd'\nregister = 'holding'\naddress = 2\ntype = 'f32'\n",
            "f:20:11: address: sp reads the same register as pv",
        ),
        (
            "[loop.sp]\ndevice = 'd'\nregister = 'holdin'\naddress = 4\ntype = 'f32'\n",
            "f:19:12: register: unknown value \"holdin\", did you mean \"holding\"?",
        ),
        (
            "[loop.sp]\ndevice = 'd'\nregister = 'holding'\naddress = 65535\ntype = 'f32'\n",
            "f:20:11: address: 65535 must be 0 to 65534 (address_base = 0)",
        ),
        ("[[loop.sp]]\ndevice = 'd'\n", "f:17:1: sp: a loop has one, write it as [loop.sp]"),
        (
            "[loop.tag]\ndevice = 'd'\n",
            "f:17:1: tag: there may be several: write each in [[double brackets]]",
        ),
        ("deadband = 1.0\n", "f:17:12: deadband: a tag with a register has none"),
        ("range = [1.0]\n", "f:17:9: range: two numbers are needed, [lowest, highest], and here are 1"),
        ("range = [1.0, 'x']\n", "f:17:15: range: a number is expected, not the text \"x\""),
        ("range = [9.0, 1.0]\n", "f:17:9: range: [9, 1] must be the least, then the greatest value"),
        ("[[loop]]\nid = 'a/b'\nop = 1\n[loop.pv]\ndevice = 'd'\n", "f:19:6: op: a table is expected, not 1"),
    ];
    for (more, expected) in cases {
        let found = errors(&minimal(more));
        assert!(found.contains(&expected.to_string()), "{more}\n{expected}\n{found:#?}");
        assert!(found.iter().all(|error| !error.contains("missing key \"op\"")), "{found:#?}");
    }
}

#[test]
fn sections_of_the_wrong_shape() {
    let found = errors("modbus = 3\nserver = 'x'\n[loop]\nid = 'A'\n");
    assert_eq!(
        found,
        [
            "f:1:10: modbus: there may be several, write each as [[modbus]]",
            "f:2:10: server: write it as a section, [server]",
            "f:3:1: loop: there may be several, write each as [[loop]]",
        ]
    );
    assert_eq!(errors(""), ["f:1:1: no [[loop]]: name at least one control loop to watch"]);
    assert_eq!(
        errors("[fleet]\nservers = ['nats://h:4222']\nsite = 'n'\n"),
        [
            "f:3:8: site: only an edge has one, and an edge needs a [[loop]]; for a worker or a centre, take site out"
        ]
    );
}

#[test]
fn every_missing_key_is_named() {
    let found = errors("[[modbus]]\n[[loop]]\n[loop.op]\n");
    assert_eq!(
        found,
        [
            "f:1:1: missing key \"address\" in [[modbus]]",
            "f:1:1: missing key \"address_base\" in [[modbus]]: write 0 where the device's list counts registers from 0, 1 \
             where from 1",
            "f:1:1: missing key \"name\" in [[modbus]]",
            "f:2:1: missing key \"id\" in [[loop]]",
            "f:2:1: missing key \"pv\" in [[loop]]",
            "f:3:1: missing key \"address\" in [loop.op]",
            "f:3:1: missing key \"device\" in [loop.op]",
            "f:3:1: missing key \"register\" in [loop.op]",
        ]
    );
}

#[test]
fn files_that_cannot_be_read() {
    let folder = std::env::temp_dir().join(format!("stictiond-config-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("bad.toml");
    std::fs::write(&path, b"[server]\nlisten = '\xff'\n").unwrap();
    let utf8 = load(&path).unwrap_err();
    let missing = load(&folder.join("none.toml")).unwrap_err();
    let directory = load(&folder).unwrap_err();
    std::fs::remove_dir_all(&folder).unwrap();
    assert_eq!(
        (utf8[0].line, utf8[0].column, utf8[0].message.as_str()),
        (2, 11, "not UTF-8 text: save the file as UTF-8")
    );
    assert!(missing[0].message.starts_with("cannot read: No such file"), "{}", missing[0]);
    assert!(directory[0].to_string().contains("Is a directory"), "{}", directory[0]);
}

#[test]
fn thousands_of_errors_are_bounded() {
    let junk: String = (0..3000).map(|k| format!("x{k} = 1\n")).collect();
    let found = errors(&format!("[alarm]\n{junk}"));
    assert_eq!(found.len(), 502, "500 of the section, one line that says so, and the missing loop");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    /// Any damage to the example is an error with a place inside the text, or none; never a panic.
    #[test]
    fn damage_never_panics(
        edits in prop::collection::vec((any::<prop::sample::Index>(), 0usize..40, "[\\]\\[a-z=.,{}'\"0-9\n #é-]{0,8}"), 1..5)
    ) {
        let mut text: Vec<char> = EXAMPLE.chars().collect();
        for (at, length, new) in edits {
            let from = at.index(text.len());
            let to = (from + length).min(text.len() - 1).max(from);
            text.splice(from..to, new.chars());
        }
        let text: String = text.into_iter().collect();
        match parse("f", &text) {
            Ok(config) => prop_assert!(config.plant().is_ok()),
            Err(errors) => {
                prop_assert!(!errors.is_empty());
                for error in errors {
                    let line = text.split('\n').nth(error.line.wrapping_sub(1));
                    let length = line.map(|line| line.chars().count());
                    prop_assert!(length.is_some_and(|length| error.column <= length + 1), "{error}");
                    prop_assert!(!error.message.contains('\n'));
                }
            }
        }
    }

    /// A line taken out or doubled is the commonest slip.
    #[test]
    fn lines_moved_about_never_panic(lines in prop::collection::vec(any::<prop::sample::Index>(), 1..4), double: bool) {
        let mut text: Vec<&str> = EXAMPLE.lines().collect();
        for line in lines {
            let at = line.index(text.len());
            if double { text.insert(at, text[at]) } else { text.remove(at); }
        }
        if let Ok(config) = parse("f", &text.join("\n")) {
            prop_assert!(config.plant().is_ok());
        }
    }
}

const SERVER: &str = "[[opcua]]\nname = 's'\nurl = 'opc.tcp://h:4840/'\nsecurity_policy = 'None'\n";

#[test]
fn a_loop_may_mix_registers_and_nodes() {
    let text = format!(
        "{DEVICE}{SERVER}[[loop]]\nid = 'A'\n[loop.op]\ndevice = 's'\nnode = 'ns=2;s=OP'\n[loop.pv]\ndevice = 'd'\n\
         register = 'holding'\naddress = 2\ntype = 'f32'\n[loop.sp]\ndevice = 's'\npath = '/2:A/2:SP'\nscale = 2.0\n"
    );
    let plant = parse("f", &text).unwrap().plant().unwrap();
    assert_eq!(plant.plans[0].tags.iter().map(|tag| tag.index).collect::<Vec<_>>(), [1]);
    assert_eq!(plant.opcua[0].tags.iter().map(|tag| tag.index).collect::<Vec<_>>(), [0, 2]);
    // Numbers of devices go on through the kinds.
    assert_eq!((plant.plans[0].device, plant.opcua[0].device), (0, 1));
    assert_eq!(plant.loops[0].tags[2].source, "opcua opc.tcp://h:4840/ /2:A/2:SP time Server x 2 + 0");
}

#[test]
fn errors_of_nodes_and_servers_have_their_place() {
    let text = "\
[[opcua]]
name = 's'
url = 'http://h'
security_polcy = 'None'
[[opcua]]
name = 't'
url = 'opc.tcp://h:4840/'
security_policy = 'Basic256'
[[modbus]]
name = 'd'
address = 'h:1'
address_base = 0
[[opcua]]
name = 'd'
url = 'opc.tcp://h:4840/'
[[loop]]
id = 'A'
[loop.op]
device = 's'
node = 'OP'
[loop.pv]
device = 's'
node = 'ns=2;s=PV'
address = 7
[loop.sp]
device = 's'
[loop.mode]
device = 'd'
node = 'ns=2;s=M'
[loop.mv]
device = 's'
register = 'holding'
address = 1
type = 'u16'
[[loop]]
id = 'B'
[loop.op]
device = 's'
node = 'ns=2;s=X'
[loop.pv]
device = 's'
node = 'ns=2;s=X'
nod = 1
";
    let found = errors(text);
    let places: Vec<String> =
        found.iter().map(|line| line.splitn(4, ':').take(3).collect::<Vec<_>>().join(":")).collect();
    assert!(found.iter().all(|line| !line.ends_with("::")), "{found:?}");
    for place in ["f:4:1", "f:8:", "f:14:8", "f:20:8", "f:24:11", "f:25:1", "f:29:8", "f:32:12", "f:43:1"] {
        assert!(places.iter().any(|found| found.starts_with(place)), "{place} in {}", found.join("\n"));
    }
}

#[test]
fn a_pair_has_two_numbers() {
    for (limits, message) in
        [("[0, 50, 100]", "and here are 3"), ("[50]", "and here are 1"), ("['a', 'b']", "a number")]
    {
        let found = errors(&minimal("").replace("id = 'A'", &format!("id = 'A'\nop_limits = {limits}")));
        assert!(found.len() == 1 && found[0].contains(message), "{limits}: {found:?}");
    }
}

#[test]
fn candidates_are_tags_of_other_loops() {
    let with =
        |candidates: &str| minimal("").replace("id = 'A'", &format!("id = 'A'\ncandidates = {candidates}"));
    for (candidates, message) in [
        ("'all'", "expected \"auto\" or a list of names like \"FIC203.pv\""),
        ("7", "\"auto\" or a list of names like \"FIC203.pv\" is expected, not 7"),
        ("'auto'", "\"auto\" takes the loops of the same group; give this loop a group"),
        ("['X.pv']", "\"X.pv\" is no tag of another loop"),
        ("['A.pv']", "\"A.pv\" is this loop's own"),
    ] {
        let found = errors(&with(candidates));
        assert!(found.len() == 1 && found[0].contains(message), "{candidates}: {found:?}");
    }
    let other =
        minimal("").replace(DEVICE, "").replace("'A'", "'B.1'").replace("= 0", "= 4").replace("= 2", "= 6");
    let of_two = |candidates: &str| format!("{}{}{other}", with(candidates), "\n");
    let config = parse("f", &of_two("['B.1.op', 'B.1.pv']")).unwrap();
    let names: Vec<String> = config.neighbours(&config.loops[0]).into_iter().map(|n| n.name).collect();
    assert_eq!(names, ["B.1.op", "B.1.pv"]);
    assert!(config.neighbours(&config.loops[1]).is_empty());
    let twice = errors(&of_two("['B.1.op', 'B.1.op']"));
    assert!(twice[0].contains("is there twice"), "{twice:?}");
}

#[test]
fn errors_of_brokers_and_topics_have_their_place() {
    let text = "\
[[mqtt]]
name = 'b'
address = 'mqtt://h'
user = 'u'
silent_s = 0.0
[notify.mqtt]
address = 'h:1883'
alarm_topic = 'all/alarms'
[[loop]]
id = 'A'
[loop.op]
device = 'b'
topic = 'plant/#'
[loop.pv]
device = 'b'
topic = 'a'
path = 'v..x'
register = 'holding'
[loop.sp]
device = 'b'
sparkplug = 'edge'
metric = 'SP'
[loop.mv]
device = 'b'
node = 'ns=2;s=X'
";
    let found = errors(text);
    for expected in [
        "f:3:11: address: 'mqtt://h' is not host:port",
        "f:4:8: user: a user name needs password_file or password_env",
        "f:5:12: silent_s: must be 0.1",
        "f:8:15: alarm_topic: needs {loop}",
        "f:13:9: topic: 'plant/#' must name one topic",
        "f:17:8: path: 'v..x' is not a path",
        "f:18:12: register: a tag at a broker has none",
        "f:21:13: sparkplug: 'edge' is not group/edge",
        "f:25:8: node: \"b\" is an MQTT broker: write topic, or sparkplug and metric",
    ] {
        assert!(found.iter().any(|found| found.starts_with(expected)), "{expected}: {}", found.join("\n"));
    }
    assert_eq!(found.len(), 9, "{}", found.join("\n"));
}

#[test]
fn a_certificate_for_a_broker_needs_an_authority_too() {
    let own = "certificate_file = 'c'\nkey_file = 'k'\n";
    let found =
        errors(&format!("[[mqtt]]\nname = 'b'\naddress = 'h:1'\n{own}[notify.mqtt]\naddress = 'h:1'\n{own}"));
    for place in ["f:4:20: ", "f:8:20: "] {
        let expected = format!("{place}certificate_file: needs ca_file too");
        assert!(found.contains(&expected), "{expected}: {}", found.join("\n"));
    }
}
