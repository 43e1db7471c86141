use super::*;
use crate::collect::opcua::plan::{Deadband, Sampling};

fn device(more: &str) -> Config {
    toml::from_str(&format!("name = 'd'\nurl = 'opc.tcp://localhost:4840/'\n{more}")).unwrap()
}

fn fields(issues: Vec<Issue>) -> Vec<&'static str> {
    issues.into_iter().map(|issue| issue.field).collect()
}

#[test]
fn security_is_on_unless_the_file_says_otherwise() {
    let secure = device("pki_dir = 'pki'");
    assert_eq!(secure.effective_mode(), SecurityMode::SignAndEncrypt);
    assert_eq!(fields(secure.validate()), [""; 0]);
    assert_eq!(fields(device("").validate()), ["pki_dir"]);
    let plain = device("security_policy = 'None'");
    assert_eq!(plain.effective_mode(), SecurityMode::None);
    assert_eq!(fields(plain.validate()), [""; 0]);
}

#[test]
fn what_contradicts_itself_is_refused() {
    for (more, field) in [
        ("security_policy = 'None'\nsecurity_mode = 'Sign'", "security_mode"),
        ("pki_dir = 'p'\nsecurity_mode = 'None'", "security_mode"),
        ("pki_dir = 'p'\nuser = 'u'", "user"),
        ("pki_dir = 'p'\npassword_env = 'P'", "user"),
        ("pki_dir = 'p'\nuser = 'u'\npassword_env = 'P'\npassword_file = 'f'", "password_env"),
        ("pki_dir = 'p'\nuser_key = 'k'", "user_certificate"),
        ("pki_dir = 'p'\nsampling_ms = 0", "sampling_ms"),
        ("pki_dir = 'p'\nqueue_size = 0", "queue_size"),
        ("pki_dir = 'p'\ndeadband_percent = 100.0", "deadband_percent"),
        ("pki_dir = 'p'\nsilent_s = nan", "silent_s"),
        ("pki_dir = 'p'\nmax_nodes_per_request = 0", "max_nodes_per_request"),
    ] {
        assert_eq!(fields(device(more).validate()), [field], "{more}");
    }
    for url in ["", "localhost:4840", "opc.tcp://", "opc.tcp://h", "opc.tcp://h:0/", "opc.tcp://a b:1"] {
        let config = Config { url: url.into(), ..device("pki_dir = 'p'") };
        assert_eq!(fields(config.validate()), ["url"], "{url}");
    }
}

#[test]
fn places_are_node_ids_or_browse_paths() {
    let tag = |text: &str| -> TagConfig { toml::from_str(&format!("device = 'd'\n{text}")).unwrap() };
    for node in ["ns=2;s=FIC101.OP", "i=2258", "nsu=urn:plant;s=FIC101.OP"] {
        assert_eq!(tag(&format!("node = '{node}'")).place(), Ok(Place::Node(node.parse().unwrap())));
    }
    for path in ["/2:Unit/2:OP", "/nsu=http://plant.example/UA/;Unit/2:OP"] {
        assert_eq!(tag(&format!("path = '{path}'")).place(), Ok(Place::Path(path.parse().unwrap())));
    }
    for (text, field) in [
        ("", "node"),
        ("node = 'FIC101'", "node"),
        ("node = 'ns=99999;s=a'", "node"),
        ("node = 'nsu=urn:plant'", "node"),
        ("node = 'i=1'\npath = '/2:a'", "path"),
        ("path = ''", "path"),
        ("path = 'Unit'", "path"),
    ] {
        assert_eq!(tag(text).place().unwrap_err().field, field, "{text}");
    }
}

#[test]
fn a_node_may_be_sampled_in_its_own_way() {
    let server = device("pki_dir = 'p'\nqueue_size = 7\ndeadband_percent = 2.0");
    let sampling = |text: &str| {
        let tag: TagConfig = toml::from_str(&format!("device = 'd'\nnode = 'i=1'\n{text}")).unwrap();
        (fields(tag.validate(None)), Sampling::new(&server, &tag))
    };
    let as_server = Sampling { every_ms: 1000, queue: 7, deadband: Deadband::Percent(2.0) };
    assert_eq!(sampling("").1, as_server);
    assert_eq!(
        sampling("sampling_ms = 50\nqueue_size = 20\ndeadband = 0.5").1,
        Sampling { every_ms: 50, queue: 20, deadband: Deadband::Absolute(0.5) }
    );
    for none in ["deadband = 0.0", "deadband_percent = 0.0"] {
        assert_eq!(sampling(none), (vec![], Sampling { deadband: Deadband::None, ..as_server }), "{none}");
    }
    for (text, field) in [
        ("sampling_ms = 1", "sampling_ms"),
        ("queue_size = 0", "queue_size"),
        ("deadband = -1.0", "deadband"),
        ("deadband = nan", "deadband"),
        ("element = 20000", "element"),
        ("deadband_percent = 100.0", "deadband_percent"),
        ("deadband = 1.0\ndeadband_percent = 1.0", "deadband_percent"),
    ] {
        assert_eq!(sampling(text).0, [field], "{text}");
    }
    // Of a band in percent only the server knows what it hides.
    assert!(!Deadband::Percent(1.0).lets_through(Some(0.0), Some(99.0)));
    assert!(Deadband::Absolute(1.0).lets_through(Some(0.0), Some(1.5)));
    assert!(!Deadband::Absolute(1.0).lets_through(Some(0.0), Some(1.0)));
    assert!(Deadband::None.lets_through(Some(0.0), Some(0.1)));
    assert!(!Deadband::None.lets_through(Some(0.1), Some(0.1)));
}

#[test]
fn a_mode_is_raw_and_a_range_is_ordered() {
    let tag =
        |text: &str| -> TagConfig { toml::from_str(&format!("device = 'd'\nnode = 'i=1'\n{text}")).unwrap() };
    assert_eq!(fields(tag("scale = 2.0").validate(Some(Role::Mode))), ["scale"]);
    assert_eq!(fields(tag("auto_values = [1]").validate(Some(Role::Mode))), [""; 0]);
    assert_eq!(fields(tag("auto_values = [1]").validate(Some(Role::Pv))), ["auto_values"]);
    assert_eq!(fields(tag("range = [1.0, 0.0]\nscale = 0.0").validate(None)), ["scale", "range"]);
}
