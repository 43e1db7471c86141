//! Configurations that are accepted, and what is remarked of them.

use super::{OP, SOUND};
use stictiond::config;

#[test]
fn an_address_that_names_the_kind_of_register_is_remarked() {
    let text = SOUND.replacen("address = 101", "address = 40101", 1);
    let config = config::parse("plant.toml", &text).unwrap_or_else(|errors| panic!("{errors:?}"));
    let remarks = config.remarks();
    assert_eq!(remarks.len(), 1, "{remarks:?}");
    assert!(remarks[0].starts_with("A.op: address = 40101 is read as holding register 40101"), "{remarks:?}");
    assert!(remarks[0].ends_with("write address = 101"), "{remarks:?}");
    // Counted from 0, number 101 of the list is register 100.
    let from_zero = text.replacen("address_base = 1", "address_base = 0", 1);
    let remarks = config::parse("plant.toml", &from_zero).expect("sound").remarks();
    assert!(remarks[0].ends_with("write address = 100, counted from 0"), "{remarks:?}");
    let input = SOUND.replacen("address = 101", "address = 30101", 1);
    let remarks = config::parse("plant.toml", &input).expect("sound").remarks();
    assert!(remarks[0].ends_with("write register = \"input\" and address = 101"), "{remarks:?}");
}

#[test]
fn what_was_copied_or_goes_in_the_clear_is_remarked() {
    let section = &SOUND[SOUND.find("[[loop]]").expect("there")..];
    let broker =
        "[[mqtt]]\nname = \"b\"\naddress = \"broker.plant:1883\"\nuser = \"u\"\npassword_env = \"PW\"\n";
    let history = "[history]\nsamples_per_tag = 512\n";
    let tls = "[[mqtt]]\nname = \"s\"\naddress = \"broker.plant:8883\"\n";
    let text = [SOUND, &section.replacen("\"A\"", "\"B\"", 1), broker, tls, history].join("\n");
    let remarks_of = |text: &str| {
        config::parse("plant.toml", text).unwrap_or_else(|errors| panic!("{errors:?}")).remarks()
    };
    let remarks = remarks_of(&text);
    for said in [
        "B: it reads OP and PV where A does",
        "s: 8883 is the port of brokers that speak TLS: write tls = true",
        "b: the password goes to broker.plant:1883 in the clear: write tls = true",
        "[history] holds 512 samples of a tag, and a diagnosis looks at up to 1000",
    ] {
        assert!(remarks.iter().any(|remark| remark.starts_with(said)), "{said}: {remarks:?}");
    }
    assert_eq!(remarks.len(), 4, "{remarks:?}");
    assert!(remarks_of(&format!("{SOUND}\n{}", broker.replace("broker.plant", "127.0.0.1"))).is_empty());
}

/// What is accepted and remarked: a section that stands before the loop, its `[loop.op]`, and what is said.
const REMARKED: &[(&str, &str, &str)] = &[
    (
        "sampling_ms = 100\npublishing_ms = 5000\n",
        "",
        "s: of A.op the server takes 50 samples between two publishes (sampling_ms = 100, publishing_ms = 5000) and keeps 10, \
         the others are lost: write queue_size = 50 or more",
    ),
    ("", "sampling_ms = 50\n", "s: of A.op the server takes 20 samples between two publishes"),
    (
        "",
        "deadband = 0.5\n",
        "A.op: a dead band hides small movements of OP, by which friction is seen: leave it out",
    ),
    ("deadband_percent = 1.0\n", "", "A.op: a dead band hides small movements of OP"),
    ("", "range = [10.0, 110.0]\n", "A.op: op_limits = [0, 100] reach beyond range = [10, 110]"),
    ("", "range = [0.0, 1.0]\n", "A.op: op_limits = [0, 100] reach beyond range = [0, 1]"),
    ("", "range = [-1e4, 1e4]\n", "A.op: range = [-10000, 10000] is far wider than op_span = 100"),
    ("password_file = \"none/pw\"\nuser = \"u\"\n", "", "s: password_file = \"none/pw\" is not there"),
    (
        "user_certificate = \"none/c\"\nuser_key = \"none/k\"\n",
        "",
        "s: user_certificate = \"none/c\" is not there: make it, or correct the path; it is looked for from the folder in which \
         stictiond starts",
    ),
];

#[test]
fn what_may_be_meant_otherwise_is_remarked() {
    let server = "[[opcua]]\nname = \"s\"\nurl = \"opc.tcp://localhost:4840/\"\nsecurity_policy = \"None\"\n";
    let op = "[loop.op]\ndevice = \"s\"\nnode = \"nsu=urn:plant;s=OP\"\n";
    let remarks_of = |own: &str, of_op: &str| {
        let text = SOUND.replacen(OP, &format!("{server}{own}{op}{of_op}"), 1);
        let config = config::parse("plant.toml", &text).unwrap_or_else(|errors| panic!("{errors:?}"));
        [config.remarks(), config.missing_files()].concat()
    };
    assert_eq!(remarks_of("", ""), Vec::<String>::new());
    for (own, of_op, said) in REMARKED {
        let remarks = remarks_of(own, of_op);
        assert!(remarks.iter().any(|remark| remark.starts_with(said)), "{said}: {remarks:?}");
        assert!(remarks.len() == 1 || said.contains("user_certificate"), "{remarks:?}");
    }
    let bare = SOUND.replacen(OP, &format!("{server}{op}"), 1).replacen("nsu=urn:plant;s=OP", "s=OP", 1);
    let remarks = config::parse("plant.toml", &bare).expect("sound").remarks();
    assert!(
        remarks.len() == 1 && remarks[0].starts_with("s: 1 tag names a node in OPC UA's own namespace"),
        "{remarks:?}"
    );
    assert!(remarks_of("sampling_ms = 100\nqueue_size = 10\n", "deadband = 0.0\n").is_empty());
}
