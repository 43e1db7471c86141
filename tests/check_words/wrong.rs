//! Wrong configurations, each with the one error that it gives.

use super::{OP, SOUND};
use stictiond::config;

/// What is replaced by what, and what the one error says: its line, the thing, the remedy.
const WRONG: &[(&str, &str, usize, &[&str])] = &[
    ("10.0.0.5:502", "${PLC}:502", 4, &["variables are not filled in", "${PLC}", "write the value itself"]),
    ("10.0.0.5:502", "%PLC%:502", 4, &["address", "is not host:port", "variables are not filled in"]),
    ("10.0.0.5:502", "<PLC-IP>:502", 4, &["address", "is not host:port", "variables are not filled in"]),
    ("10.0.0.5:502", "$PLC:502", 4, &["address", "is not host:port", "variables are not filled in"]),
    ("10.0.0.5:502", "10.0.0.5", 4, &["address", "'10.0.0.5' is not host:port", "10.0.0.5:502"]),
    ("10.0.0.5:502", "tcp://10.0.0.5:502", 4, &["address", "is not host:port", "leave out the scheme"]),
    ("10.0.0.5:502", "10.0.0.256:502", 4, &["address", "is not host:port", "four numbers from 0 to 255"]),
    ("10.0.0.5:502", "10,0,0,5:502", 4, &["address", "is not host:port", "write points"]),
    ("10.0.0.5:502", "fe80::1:502", 4, &["address", "is not host:port", "in brackets"]),
    ("\"10.0.0.5:502\"", "10.0.0.5:502", 4, &["in quotes: write address = \"10.0.0.5:502\""]),
    (
        "poll_ms = 1000",
        "poll_s = 1",
        6,
        &["unknown key \"poll_s\"", "did you mean \"poll_ms\", in milliseconds?"],
    ),
    ("poll_ms = 1000", "poll_ms = 1000.0", 6, &["a whole number is expected, write poll_ms = 1000"]),
    ("poll_ms = 1000", "poll_ms = 1,000", 6, &["a comma within a number: leave it out between thousands"]),
    ("type = \"f32\"", "type = \"REAL\"", 17, &["unknown value \"REAL\"", "did you mean \"f32\"?"]),
    ("type = \"f32\"", "type = \"DINT\"", 17, &["unknown value \"DINT\"", "did you mean \"i32\"?"]),
    (
        "register = \"holding\"",
        "register = \"4x\"",
        15,
        &["unknown value \"4x\"", "did you mean \"holding\"?"],
    ),
    (
        "type = \"f32\"",
        "type = \"f32\"\nbyte_order = \"little_endian\"",
        18,
        &["unknown value \"little_endian\": write DCBA or CDAB", "all four orders"],
    ),
    (
        "[[loop]]",
        "[alarm.not_identifiable]\nignore = [\"manuel\"]\n[[loop]]",
        9,
        &["ignore", "no diagnosis gives the reason \"manuel\"", "did you mean \"manual\"?"],
    ),
    (
        "[[loop]]",
        "[[mqtt]]\nname = \"b\"\naddress = \"mqtts://h\"\n[[loop]]",
        10,
        &["'mqtts://h' is not host:port, such as 10.0.0.5:8883", "leave out mqtts:// and write tls = true"],
    ),
    (
        "[[loop]]",
        "[[opcua]]\nname = \"s\"\nurl = \"opc.tcp://op:pw@dcs:4840\"\nsecurity_policy = \"None\"\n[[loop]]",
        10,
        &["url: take the log-in out of the address: write user, and password_env or password_file"],
    ),
    ("id = \"A\"", "id = \"A\"\nupstream = [\"B\"]", 10, &["upstream: no [[loop]] has the id \"B\""]),
    (
        "auto_values = [1]",
        "auto_values = [1]\n[loop.cost]\nper_sd = 1.0\nunit = \"EUR/day\"\n[[loop]]\nid = \"B\"\nop_span = 100.0\n[loop.op]\n\
         device = \"d\"\nregister = \"holding\"\naddress = 201\ntype = \"f32\"\n[loop.pv]\ndevice = \"d\"\n\
         register = \"holding\"\naddress = 203\ntype = \"f32\"\n[loop.cost]\nper_sd = 1.0\nunit = \"EUR/h\"",
        50,
        &["unit: \"EUR/h\" here and \"EUR/day\" at \"A\"", "give all of them in one unit"],
    ),
    (
        "address = \"10",
        "adress = \"10",
        4,
        &["unknown key \"adress\" in [[modbus]]", "did you mean \"address\"?"],
    ),
    ("address_base = 1", "", 2, &["missing key \"address_base\" in [[modbus]]: write 0"]),
    ("address_base = 1", "address_base = 2", 5, &["address_base", "2 must be 0 or 1: write 0"]),
    ("poll_ms = 1000", "poll_ms = 1s", 6, &["of milliseconds", "write poll_ms = 1000"]),
    ("poll_ms = 1000", "poll_ms = \"1000\"", 6, &["without quotes", "write poll_ms = 1000"]),
    ("poll_ms = 1000", "pol_ms = 1000", 6, &["unknown key \"pol_ms\"", "did you mean \"poll_ms\"?"]),
    ("poll_ms = 1000", "poll_ms = 0", 6, &["poll_ms: 0 must be 1 to 86400000"]),
    ("[[modbus]]", "[modbus]", 2, &["modbus", "write each as [[modbus]]"]),
    ("[[modbus]]", "[[modbuss]]", 2, &["unknown section \"modbuss\"", "did you mean \"modbus\"?"]),
    ("[[loop]]", "[[loops]]", 8, &["unknown section \"loops\"", "did you mean \"loop\"?"]),
    (
        "[[loop]]",
        "[tls]\ncert_file = \"c\"\n[[loop]]",
        8,
        &["unknown section \"tls\"", "write it as [server.tls]"],
    ),
    ("[[loop]]", "[[smtp]]\nname = \"m\"\n[[loop]]", 8, &["unknown section \"smtp\"", "[[notify.smtp]]"]),
    ("[[loop]]", "[logging]\n[[loop]]", 8, &["unknown section \"logging\"", "RUST_LOG"]),
    ("id = \"A\"", "id = \"A/B\"", 9, &["id", "none of them /"]),
    ("id = \"A\"", "id = A", 9, &["a text stands in quotes: write id = \"A\""]),
    (
        "op_span = 100.0",
        "op_span = 1.0",
        10,
        &["op_span = 1 and op_limits = [0, 100] contradict", "write op_span = 100, or correct op_limits"],
    ),
    ("op_span = 100.0", "op_span = -100", 10, &["op_span", "must be a number above 0"]),
    ("op_span = 100.0", "op_span = 100,0", 10, &["a decimal comma", "with a point"]),
    ("op_span = 100.0", "op_span = \"100,5\"", 10, &["op_span", "a decimal comma", "write op_span = 100.5"]),
    ("[0.0, 100.0]", "[100.0, 0.0]", 11, &["op_limits", "the lower, then the upper"]),
    ("[0.0, 100.0]", "[0.0, 50.0, 100.0]", 11, &["op_limits", "here are 3"]),
    ("[0.0, 100.0]", "100.0", 11, &["op_limits: two numbers in brackets are expected, such as [0.0, 100.0]"]),
    ("[0.0, 100.0]", "[0.0, 100.0", 13, &["array elements"]),
    (
        "device = \"d\"\nregister = \"holding\"\naddress = 101",
        "device = \"x\"\nregister = \"holding\"\naddress = 101",
        14,
        &["device", "\"x\""],
    ),
    (
        "address = 101",
        "adress = 101",
        16,
        &["unknown key \"adress\" in [loop.op]", "did you mean \"address\"?"],
    ),
    ("address = 101", "address = 0", 16, &["0 must be 1 to 65535 (", "write address_base = 0"]),
    ("address = 101", "address = 400101", 16, &["address", "400101 must be 1 to", "write address = 101"]),
    ("address = 101", "address = \"101\"", 16, &["without quotes", "write address = 101"]),
    ("type = \"f32\"\nunit", "type = \"float\"\nunit", 17, &["type", "\"float\"", "f32"]),
    ("type = \"f32\"\nunit", "typ = \"f32\"\nunit", 17, &["unknown key \"typ\"", "did you mean \"type\"?"]),
    ("unit = \"%\"", "scale = 0,1", 18, &["a decimal comma", "with a point"]),
    ("unit = \"%\"", "scale = \"0,1\"", 18, &["scale", "a decimal comma", "write scale = 0.1"]),
    ("unit = \"%\"", "range = \"0-100\"", 18, &["range"]),
    ("[loop.pv]", "[loop.pw]", 20, &["pw"]),
    ("[loop.pv]", "[[loop.pv]]", 20, &["pv", "[loop.pv]"]),
    (
        "register = \"holding\"\naddress = 103",
        "register = \"coil\"\naddress = 103",
        24,
        &["type", "a coil is a single bit"],
    ),
    (
        "register = \"holding\"\naddress = 103",
        "register = \"holdings\"\naddress = 103",
        22,
        &["register", "\"holdings\"", "\"holding\""],
    ),
    ("auto_values = [1]", "auto_values = 1", 31, &["auto_values", "write auto_values = [1]"]),
    ("poll_ms = 1000", "poll_ms = 1000\n[alarm]\nk = 5\nn = 3", 8, &["k"]),
    (
        "[[loop]]",
        "[[notify.smtp]]\nname = \"m\"\naddress = \"mail:25\"\nfrom = \"a@b.c\"\nto = \"a@b.c\"\n[[loop]]",
        12,
        &["to", "write to = [\"a@b.c\"]"],
    ),
    (
        "[[loop]]",
        "[tables.defaults]\ndecimal = \";\"\n[[loop]]",
        9,
        &["decimal", "\";\" cannot be read", ". or ,"],
    ),
    ("[[loop]]", "[server]\nport = 8080\n[[loop]]", 9, &["\"port\" in [server], did you mean \"listen\"?"]),
    ("[[loop]]", "[store]\n[[loop]]", 8, &["missing key \"folder\" in [store]"]),
    (
        "[[loop]]",
        "[schedule]\nperiod = 60\n[[loop]]",
        9,
        &["unknown key \"period\"", "did you mean \"period_s\"?"],
    ),
    (
        "[[loop]]",
        "[server]\nlisten = \"8080\"\n[[loop]]",
        9,
        &["listen", "an address in numbers and a port", "127.0.0.1:8080"],
    ),
    ("address_base = 1", "address_base = 40001", 5, &["address_base", "40001 must be 0 or 1", "write 1"]),
    (
        "unit = \"%\"",
        "hysteresis = 1",
        18,
        &[
            "\"hysteresis\"",
            "known are device, register, address, type, byte_order, bit, scale, offset, range, unit",
        ],
    ),
    (
        OP,
        "[[mqtt]]\nname = \"b\"\naddress = \"h:1883\"\n[loop.op]\ndevice = \"b\"\ntopic = \"op\"\nhysteresis = 1\n",
        19,
        &[
            "\"hysteresis\"",
            "known are device, path, decimal, topic, time_path, quality_path, sparkplug, metric, alias",
        ],
    ),
    (
        "unit = \"%\"",
        "frozen_pv_s = 60.0",
        18,
        &["frozen_pv_s: belongs to [[loop]] and stands in [loop.op]", "put it above [loop.op]"],
    ),
    (
        "auto_values = [1]",
        "auto_values = [1]\ngroup = \"U\"",
        32,
        &["group: belongs to [[loop]] and stands in [loop.mode]", "put it above [loop.op]"],
    ),
    (
        "id = \"A\"\nop_span = 100.0\nop_limits = [0.0, 100.0]\n\n[loop.op]\n",
        "op_span = 100.0\n\n[loop.op]\nid = \"A\"\n",
        12,
        &["id: belongs to [[loop]] and stands in [loop.op]", "put it above [loop.op]"],
    ),
    ("id = \"A\"", "", 8, &["missing key \"id\" in [[loop]]"]),
    ("id = \"A\"", "name = \"A\"", 9, &["unknown key \"name\" in [[loop]]", "did you mean \"id\"?"]),
    ("[loop.op]", "[loops.op]", 13, &["unknown section \"loops\"", "did you mean \"loop\"?"]),
    ("[loop.op]", "[op]", 13, &["unknown section \"op\"", "write it as [loop.op], below its [[loop]]"]),
    (
        "[[loop]]\n",
        "[loop.sp]\ndevice = \"d\"\n\n[[loop]]\n",
        8,
        &["[loop.sp] stands above the first [[loop]]", "put it below its own [[loop]]"],
    ),
    (
        "[[loop]]\nid = \"A\"\nop_span = 100.0\nop_limits = [0.0, 100.0]\n",
        "",
        9,
        &["[loop.op] has no [[loop]] above it", "write [[loop]] and the id there"],
    ),
    (
        "[loop.pv]",
        "[loop.writeback]\nenabled = false\n[loop.pv]",
        20,
        &["31 keys are missing in [loop.writeback]: device, term_address, ", "docs/writeback.md shows"],
    ),
    (
        "unit = \"%\"",
        "range = [100.0, 0.0]",
        18,
        &["range: [100, 0] must be the least, then the greatest value"],
    ),
    ("name = \"d\"\n", "", 2, &["missing key \"name\" in [[modbus]]"]),
    ("name = \"d\"", "id = \"d\"", 3, &["unknown key \"id\" in [[modbus]]", "did you mean \"name\"?"]),
    (
        "[[loop]]",
        "[[opcua]]\nname = \"s\"\nurl = \"opc.tcp://h:4840/\"\nsecurity_policy = \"none\"\n[[loop]]",
        11,
        &["security_policy: unknown value \"none\", did you mean \"None\"?"],
    ),
    (
        "[[loop]]",
        "[[loop]]\nid = \"B\"\n[loop.op]\ndevice = \"d\"\n[loop.pv]\ndevice = \"d\"\n[loop.op]\n[loop.pv]\n[[loop]]",
        14,
        &["the section [loop.op] is there twice", "write [[loop]] above the second"],
    ),
    (
        "[[loop]]\nid = \"A\"",
        "[[loops]]\nid = \"A\"",
        8,
        &["unknown section \"loops\"", "did you mean \"loop\"?"],
    ),
    ("10.0.0.5:502", "10.0.0.5:70000", 4, &["address: the port 70000 must be 1 to 65535"]),
    (
        "[[loop]]",
        "[[opcua]]\nname = \"s\"\nurl = \"opc.tcp://h:70000/\"\nsecurity_policy = \"None\"\n[[loop]]",
        10,
        &["url: the port 70000 must be 1 to 65535"],
    ),
    (
        "[[loop]]",
        "[diagnosis]\nts_s = 60.0\n[[loop]]",
        9,
        &[
            "ts_s: min_samples = 200 of 60 s take 12000 s",
            "hold 4096 s of A",
            "write samples_per_tag = 12000 or more",
        ],
    ),
    ("[[loop]]", "[history]\nsamples_per_tag = 100\n[[loop]]", 9, &["samples_per_tag: 100 must be 200 to"]),
    (
        "op_span = 100.0",
        "op_span = 100.0\nfrozen_pv_s = 0.5",
        11,
        &["frozen_pv_s: 0.5 is shorter than poll_ms = 1000", "write 3 or more"],
    ),
    (
        "[[loop]]",
        "[alarm]\nsuppressed = [\"*/f_rising\", \"B/f_rising\"]\n[[loop]]",
        9,
        &["suppressed: no [[loop]] is called \"B\", did you mean \"A\"?"],
    ),
    (
        "[[loop]]",
        "[alarm]\nsuppressed = [\"A/f_risin\"]\n[[loop]]",
        9,
        &["suppressed: no alarm is called \"f_risin\", did you mean \"f_rising\"?"],
    ),
    (
        "[[loop]]",
        "[alarm]\nsuppressed = [\"dcs/collector_down\"]\n[[loop]]",
        9,
        &["suppressed: no collector is called \"dcs\"; known are d"],
    ),
    (
        "[[loop]]",
        "[alarm]\nsuppressed = [\"A\"]\n[[loop]]",
        9,
        &["suppressed: \"A\" names no kind of alarm: write A/f_rising, or */f_rising"],
    ),
    (
        "op_limits = [0.0, 100.0]\n",
        "group = \"Unit 1\"\n[[notify.webhook]]\nname = \"w\"\nurl = \"https://h/x\"\nsecret_env = \"S\"\nfilter.groups = [\"Unit1\"]\n",
        16,
        &["groups: no [[loop]] has the group \"Unit1\", did you mean \"Unit 1\"?"],
    ),
    (
        "[[loop]]",
        "[[notify.alertmanager]]\nname = \"a\"\nurl = \"https://h/api/v2/\"\n[[loop]]",
        10,
        &["url: leave out its end /api/v2", "is added here"],
    ),
    (
        OP,
        "[[mqtt]]\nname = \"b\"\naddress = \"h:1883\"\n[loop.op]\ndevice = \"b\"\ntopic = \"op\"\npath = \"$.\"\n",
        19,
        &["path: '$.' names nothing in the message", "a path such as values.op"],
    ),
    (
        OP,
        "[[mqtt]]\nname = \"b\"\naddress = \"h:1883\"\nquality_path = \"$\"\n[loop.op]\ndevice = \"b\"\ntopic = \"op\"\npath = \"v\"\n",
        16,
        &["quality_path: '$' names nothing in the message", "values.quality", "has no quality"],
    ),
    (
        "[[loop]]",
        "[plantwide]\nperiod_s = 7200000.0\n[[loop]]",
        9,
        &["period_s: 7200000 must be 60 to 604800"],
    ),
    (
        "[[loop]]",
        "[plantwide]\nperiod_s = 259200.0\n[[loop]]",
        9,
        &["persist_s is left out, and its default 172800 must be 259200 (", "write persist_s too"],
    ),
    (
        "[[loop]]",
        "[tables.defaults]\ndecimal = \",\"\ntz = \"Mars/Base\"\n[[loop]]",
        10,
        &["tz: \"Mars/Base\" cannot be read", "say a zone such as Europe/Berlin"],
    ),
    (
        "[[loop]]",
        "[[notify.smtp]]\nname = \"m\"\naddress = \"mail:25\"\nfrom = \"nobody\"\nto = [\"a@b.c\"]\n[[loop]]",
        11,
        &["from: \"nobody\" is not a mail address such as"],
    ),
    (
        "[[loop]]",
        "[tables.defaults]\ntime_unit = \"fortnight\"\n[[loop]]",
        9,
        &["time_unit: \"fortnight\" cannot be read", "ticks, datenum and mjd"],
    ),
    (
        "[[loop]]",
        "[[notify.webhook]]\nname = \"w\"\nurl = \"https://h/x\"\nsecret_env = \"\"\n[[loop]]",
        11,
        &["secret_env: must name an environment variable"],
    ),
    (
        "[[loop]]",
        "[[notify.alertmanager]]\nname = \"a\"\nurl = \"https://h\"\nuser = \"u\"\npassword_env = \"\"\n[[loop]]",
        12,
        &["password_env: must name an environment variable"],
    ),
    (
        "[[loop]]",
        "[notify]\npublic_url = \"https://op:geheim@stictiond.plant\"\n[[loop]]",
        9,
        &["public_url: must not hold a user or a password"],
    ),
    (
        "[[loop]]",
        "[notify]\npublic_url = \"stictiond.plant\"\n[[loop]]",
        9,
        &["public_url: write an address that begins with http:// or https://"],
    ),
];

#[test]
fn every_error_names_its_line_the_thing_and_the_remedy_once() {
    let mut faults = Vec::new();
    for (from, to, line, says) in WRONG {
        let text = SOUND.replacen(from, to, 1);
        assert_ne!(text, SOUND, "{from}");
        let errors = match config::parse("plant.toml", &text) {
            Ok(_) => vec!["accepted".to_string()],
            Err(errors) => errors.iter().map(ToString::to_string).collect(),
        };
        let place = format!("plant.toml:{line}:");
        let told = errors.iter().filter(|error| error.starts_with(&place)).count();
        let good = errors
            .iter()
            .any(|error| error.starts_with(&place) && says.iter().all(|word| error.contains(word)));
        if !good || told != 1 || errors.len() != 1 {
            faults.push(format!("{from:?} as {to:?}:\n    {}", errors.join("\n    ")));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}
