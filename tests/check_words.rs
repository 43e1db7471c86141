//! Wrong configurations as people write them: each error names the line, the thing and the remedy, and is told once.

#[path = "check_words/remarks.rs"]
mod remarks;
#[path = "check_words/wrong.rs"]
mod wrong;

use stictiond::config;

/// A sound configuration, in parts that the cases replace.
const SOUND: &str = r#"
[[modbus]]
name = "d"
address = "10.0.0.5:502"
address_base = 1
poll_ms = 1000

[[loop]]
id = "A"
op_span = 100.0
op_limits = [0.0, 100.0]

[loop.op]
device = "d"
register = "holding"
address = 101
type = "f32"
unit = "%"

[loop.pv]
device = "d"
register = "holding"
address = 103
type = "f32"

[loop.mode]
device = "d"
register = "holding"
address = 105
type = "u16"
auto_values = [1]
"#;

/// Its controller output, for cases that read it elsewhere.
const OP: &str =
    "[loop.op]\ndevice = \"d\"\nregister = \"holding\"\naddress = 101\ntype = \"f32\"\nunit = \"%\"\n";

#[test]
fn the_sound_configuration_is_sound() {
    let config = config::parse("plant.toml", SOUND).unwrap_or_else(|errors| panic!("{errors:?}"));
    assert_eq!(config.remarks(), Vec::<String>::new());
}

#[test]
fn a_device_that_there_is_not_is_told_once() {
    let text = SOUND.replace("device = \"d\"", "device = \"dcs\"");
    let errors = config::parse("plant.toml", &text).expect_err("no such device");
    let told: Vec<String> = errors.iter().map(ToString::to_string).collect();
    assert_eq!(told.len(), 1, "{told:?}");
    assert!(told[0].contains(":14:") && told[0].ends_with("(2 more tags name it)"), "{told:?}");
}

#[test]
fn a_file_in_utf_16_is_told_how_to_be_saved() {
    let path = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("utf16.toml");
    for mark in [&[0xff, 0xfe][..], &[]] {
        let text = SOUND.trim_start().encode_utf16().flat_map(u16::to_le_bytes);
        let bytes: Vec<u8> = mark.iter().copied().chain(text).collect();
        std::fs::write(&path, bytes).expect("the folder is there");
        let errors = config::load(&path).expect_err("it cannot be read");
        assert_eq!((errors.len(), errors[0].line), (1, 1), "{errors:?}");
        assert!(errors[0].message.starts_with("this is UTF-16 text: save it as UTF-8"), "{errors:?}");
    }
}
