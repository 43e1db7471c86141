use super::*;

fn device(text: &str) -> Config {
    toml::from_str(text).unwrap()
}

fn tag(text: &str) -> TagConfig {
    toml::from_str(&format!("device = 'd'\n{text}")).unwrap()
}

fn plain_device() -> Config {
    device("name = 'd'\naddress = '10.0.0.5:502'\naddress_base = 0")
}

fn fields(issues: Vec<Issue>) -> Vec<&'static str> {
    issues.into_iter().map(|issue| issue.field).collect()
}

#[test]
fn the_smallest_device_is_accepted_with_the_defaults() {
    let device = plain_device();
    assert_eq!(device.validate(), []);
    assert_eq!((device.unit_id, device.poll_ms, device.timeout_ms), (1, 1000, 500));
    assert_eq!((device.max_registers_per_request, device.max_gap), (125, 8));
    assert_eq!(device.byte_order, ByteOrder::Abcd);
}

#[test]
fn an_unknown_key_and_a_missing_base_are_refused() {
    let unknown = toml::from_str::<Config>("name='d'\naddress='h:1'\naddress_base=0\nspeed=9600");
    assert!(unknown.unwrap_err().to_string().contains("speed"));
    let missing = toml::from_str::<Config>("name='d'\naddress='h:1'");
    assert!(missing.unwrap_err().to_string().contains("address_base"));
    let unknown = toml::from_str::<TagConfig>("device='d'\nregister='coil'\naddress=1\ncolour=1");
    assert!(unknown.unwrap_err().to_string().contains("colour"));
}

#[test]
fn every_bad_device_field_is_named_at_once() {
    let bad = device(
        "name = ' '\naddress = '10.0.0.5'\naddress_base = 2\npoll_ms = 0\ntimeout_ms = 500\n\
         max_registers_per_request = 126\nmax_bits_per_request = 0\nmax_gap = 126\nreconnect_max_ms = 0",
    );
    assert_eq!(
        fields(bad.validate()),
        [
            "name",
            "address",
            "poll_ms",
            "reconnect_max_ms",
            "address_base",
            "max_registers_per_request",
            "max_bits_per_request",
            "max_gap"
        ]
    );
}

#[test]
fn the_address_base_moves_the_wire_address_and_its_limits() {
    let mut device = plain_device();
    let f64_at = |address: i64| tag(&format!("register='holding'\ntype='f64'\naddress={address}"));
    assert_eq!(f64_at(0).wire_address(&device), Some(0));
    assert_eq!(f64_at(65532).wire_address(&device), Some(65532));
    assert_eq!(f64_at(65533).wire_address(&device), None);
    assert_eq!(f64_at(-1).wire_address(&device), None);
    device.address_base = 1;
    assert_eq!(f64_at(0).wire_address(&device), None);
    assert_eq!(f64_at(1).wire_address(&device), Some(0));
    assert_eq!(f64_at(65533).wire_address(&device), Some(65532));
    assert_eq!(f64_at(65534).wire_address(&device), None);
    assert_eq!(f64_at(i64::MIN).wire_address(&device), None);
    let issues = f64_at(65534).validate(&device, None);
    assert_eq!(issues[0].message, "65534 must be 1 to 65533 (address_base = 1)");
}

#[test]
fn bad_tags_are_named_field_by_field() {
    let device = plain_device();
    let cases: [(&str, &[&str]); 14] = [
        ("register='holding'\naddress=1\ntype='u16'", &[]),
        ("register='coil'\naddress=1", &[]),
        ("register='discrete'\naddress=1\ntype='bit'", &[]),
        ("register='holding'\naddress=1", &["type"]),
        ("register='coil'\naddress=1\ntype='u16'", &["type"]),
        ("register='holding'\naddress=65535\ntype='f32'", &["address"]),
        ("register='holding'\naddress=1\ntype='bit'", &["bit"]),
        ("register='holding'\naddress=1\ntype='bit'\nbit=16", &["bit"]),
        ("register='holding'\naddress=1\ntype='u16'\nbit=3", &["bit"]),
        ("register='coil'\naddress=1\nbyte_order='CDAB'", &["byte_order"]),
        ("register='input'\naddress=1\ntype='f32'\nscale=0.0\noffset=nan", &["scale", "offset"]),
        ("register='input'\naddress=1\ntype='f32'\nrange=[5.0, 5.0]", &["range"]),
        ("register='input'\naddress=1\ntype='f32'\nrange=[0.0, inf]", &["range"]),
        ("register='input'\naddress=1\ntype='u16'\nauto_values=[1]", &["auto_values"]),
    ];
    for (text, expected) in cases {
        assert_eq!(fields(tag(text).validate(&device, Some(Role::Op))), expected, "{text}");
    }
}

#[test]
fn a_mode_is_compared_raw() {
    let device = plain_device();
    let good = tag("register='holding'\naddress=1\ntype='u16'\nauto_values=[1, 2]");
    assert_eq!(good.validate(&device, Some(Role::Mode)), []);
    let empty = tag("register='holding'\naddress=1\ntype='u16'\nauto_values=[]");
    assert_eq!(fields(empty.validate(&device, Some(Role::Mode))), ["auto_values"]);
    let scaled = tag("register='holding'\naddress=1\ntype='u16'\nscale=2.0");
    assert_eq!(fields(scaled.validate(&device, Some(Role::Mode))), ["scale"]);
}

#[test]
fn the_tables_are_named_as_the_file_names_them() {
    for name in ["holding", "input", "coil", "discrete"] {
        let parsed: Register = name.parse().unwrap();
        assert_eq!(parsed.to_string(), name);
        assert_eq!(tag(&format!("register='{name}'\naddress=1")).register, parsed);
    }
    assert!("Holding".parse::<Register>().is_err());
}

#[test]
fn a_value_wider_than_a_request_is_refused() {
    let mut device = plain_device();
    device.max_registers_per_request = 2;
    let wide = tag("register='holding'\naddress=1\ntype='f64'");
    assert_eq!(fields(wide.validate(&device, None)), ["type"]);
    assert_eq!(tag("register='coil'\naddress=1").validate(&device, None), []);
}
