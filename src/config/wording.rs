//! What serde says, as a person at a text file needs it.

use super::source::Step;

/// Most names that are listed: keys, or loops of a plant.
const MOST_LISTED: usize = 30;

/// The key of `missing field`.
pub fn missing(message: &str) -> Option<&str> {
    message.strip_prefix("missing field `")?.split('`').next()
}

/// The path of a table as the file writes it: `[alarm]`, `[[modbus]]`, `[loop.op]`.
pub fn section(path: &[Step]) -> String {
    let keys: Vec<&str> = path
        .iter()
        .filter_map(|step| match step {
            Step::Key(key) => Some(key.as_str()),
            Step::Item(_) => None,
        })
        .collect();
    match path.last() {
        Some(Step::Item(_)) => format!("[[{}]]", keys.join(".")),
        _ => format!("[{}]", keys.join(".")),
    }
}

/// The message about an entry that cannot be used.
pub fn of_entry(message: &str, key: &str) -> String {
    if let Some(word) = message.strip_prefix("unknown variant `").and_then(|rest| rest.split('`').next()) {
        let known = choices(message);
        if key == "byte_order" && LITTLE.contains(&word.to_lowercase().replace(['-', ' '], "_").as_str()) {
            return format!(
                "{key}: unknown value {word:?}: write DCBA or CDAB; stictiond probe shows a register in all four orders"
            );
        }
        let hint = meant(key, word).filter(|own| known.contains(own));
        let hint = hint.map_or_else(|| self::hint(word, &known), |own| format!(", did you mean {own:?}?"));
        return format!("{key}: unknown value {word:?}{hint}");
    }
    if let Some(number) = decimal_comma(message) {
        return format!("{key}: a decimal comma in quotes: write {key} = {number}");
    }
    if let Some(number) = quoted_number(message) {
        let is_quoted = message.contains("string");
        let wanted = if is_quoted { "a number without quotes" } else { "a whole number" };
        return format!("{key}: {wanted} is expected, write {key} = {number}");
    }
    if let Some(number) = base(message).filter(|_| key == "address_base") {
        return format!(
            "{key}: {number} must be 0 or 1, the number of the device's first register: write 1 where its list begins with \
             1 or 40001"
        );
    }
    if let Some(said) = quoted_duration(message, key) {
        return format!("{key}: {said}");
    }
    if let Some(number) = hexadecimal(message) {
        return format!("{key}: a number without quotes is expected, write {key} = {number}");
    }
    if let Some(list) = list_of_one(message) {
        return format!("{key}: a list is expected, write {key} = [{list}]");
    }
    if message.starts_with("invalid type: map, expected a sequence") && !SEVERAL.contains(&key) {
        return format!("{key}: a list is expected, in [square brackets]");
    }
    if key == "tls" && message.contains("expected struct") {
        return "tls: write it as [server.tls], with cert_file and key_file".into();
    }
    format!("{key}: {}", plain(message))
}

/// Sections of which there may be several, in double brackets.
const SEVERAL: [&str; 8] = ["loop", "tag", "modbus", "opcua", "mqtt", "webhook", "alertmanager", "smtp"];

/// What devices' lists call a type, a register or an order of bytes.
fn meant(key: &str, word: &str) -> Option<&'static str> {
    let word = word.to_lowercase().replace(['-', ' '], "_");
    if key == "security_policy" {
        // Servers show it as a URI.
        let name = word.rsplit('#').next()?;
        return POLICIES.into_iter().find(|own| own.eq_ignore_ascii_case(name));
    }
    let names: &[(&str, &[&str])] = match key {
        "security" => &SECURITIES,
        "type" => &TYPES,
        "register" => &REGISTERS,
        "byte_order" => &ORDERS,
        _ => return None,
    };
    names.iter().find(|(_, others)| others.contains(&word.as_str())).map(|(own, _)| *own)
}

/// A type of the configuration by the word of a device's list.
pub fn type_meant(word: &str) -> Option<&'static str> {
    meant("type", word)
}

/// Types of IEC 61131-3 and of programming languages.
const TYPES: [(&str, &[&str]); 9] = [
    ("f32", &["real", "float", "float32", "single"]),
    ("f64", &["lreal", "double", "float64"]),
    ("i16", &["int", "int16", "short", "sint16"]),
    ("i32", &["dint", "int32", "sint32"]),
    ("i64", &["lint", "int64"]),
    ("u16", &["word", "uint", "uint16"]),
    ("u32", &["dword", "udint", "uint32"]),
    ("u64", &["lword", "ulint", "uint64"]),
    ("bit", &["bool", "boolean"]),
];
const REGISTERS: [(&str, &[&str]); 4] = [
    ("holding", &["hr", "4x", "holding_register", "holding_registers", "holdingregister"]),
    ("input", &["ir", "3x", "input_register", "input_registers", "inputregister"]),
    ("discrete", &["di", "1x", "discrete_input", "discrete_inputs", "discreteinput"]),
    ("coil", &["0x", "coils", "do"]),
];
const ORDERS: [(&str, &[&str]); 3] = [
    ("ABCD", &["big", "big_endian", "be", "msb"]),
    ("CDAB", &["word_swap", "word_swapped", "swap_words", "swapped"]),
    ("BADC", &["byte_swap", "byte_swapped", "swap_bytes"]),
];
/// The least significant first, of bytes or of words: lists do not say which.
const LITTLE: [&str; 4] = ["little", "little_endian", "le", "lsb"];

const SECURITIES: [(&str, &[&str]); 2] =
    [("tls", &["ssl", "smtps", "implicit", "ssl/tls"]), ("starttls", &["start_tls", "explicit"])];
const POLICIES: [&str; 3] = ["None", "Basic256Sha256", "Aes256_Sha256_RsaPss"];

/// Hints for names of sections that other programs use.
pub fn elsewhere(section: &str) -> Option<&'static str> {
    let section = section.to_lowercase();
    let found = ELSEWHERE.iter().find(|(names, _)| names.contains(&section.as_str()));
    found.map(|(_, own)| *own)
}

const ELSEWHERE: [(&[&str], &str); 12] = [
    (&["tls", "https", "ssl"], "write it as [server.tls]"),
    (&["http", "api", "web", "listen", "dashboard"], "where the daemon listens stands in [server]"),
    (&["auth", "users", "user", "login", "ldap", "oidc"], "who may do what stands in [access]"),
    (
        &["database", "db", "postgres", "postgresql", "sqlite", "storage"],
        "where samples are kept stands in [store]",
    ),
    (&["smtp", "mail", "email"], "write it as [[notify.smtp]]"),
    (&["webhook", "webhooks"], "write it as [[notify.webhook]]"),
    (&["alertmanager"], "write it as [[notify.alertmanager]]"),
    (&["nats", "jetstream"], "NATS is configured in [fleet]"),
    (
        &["log", "logs", "logging"],
        "the log goes to the standard error, set its level by the environment variable RUST_LOG, and take the section out",
    ),
    (&["device", "devices", "plc", "plcs"], "a device is a [[modbus]], an [[opcua]] or an [[mqtt]]"),
    (&["tag", "tags"], "write it as [[loop.tag]], or as [loop.op] and the like, below its [[loop]]"),
    (&["limits", "thresholds", "threshold"], "what raises an alarm stands in [alarm]"),
];

/// `invalid type: string "0,1", expected f64`: the number with a point.
fn decimal_comma(message: &str) -> Option<String> {
    let (text, expected) = message.strip_prefix("invalid type: string \"")?.split_once("\", expected ")?;
    let number = text.trim().replacen(',', ".", 1);
    let is_number = expected == "f64" && text.contains(',') && number.parse::<f64>().is_ok();
    is_number.then_some(number)
}

/// `invalid type: string "100", expected f64`, or `floating point `100.0`, expected u16`: the number as it should stand there.
fn quoted_number(message: &str) -> Option<String> {
    let (found, expected) = message.strip_prefix("invalid type: ")?.split_once(", expected ")?;
    let whole = ["u8", "u16", "u32", "u64", "usize", "i64"].contains(&expected);
    let text = found.strip_prefix("string \"").and_then(|text| text.strip_suffix('"'));
    let text = text.or_else(|| found.strip_prefix("floating point `")?.strip_suffix('`'))?;
    let number: f64 = text.trim().parse().ok().filter(|number: &f64| number.is_finite())?;
    match (whole, number.fract() == 0.0) {
        (true, true) => Some(format!("{number:.0}")),
        (false, _) if expected == "f64" => Some(text.trim().to_string()),
        _ => None,
    }
}

/// `invalid type: string "0x64", expected u16`: the number as TOML has it.
fn hexadecimal(message: &str) -> Option<&str> {
    let (text, expected) = message.strip_prefix("invalid type: string \"")?.split_once("\", expected ")?;
    let digits = text.trim().strip_prefix("0x")?;
    let is_number = expected.starts_with(['u', 'i']) && !digits.is_empty();
    (is_number && digits.bytes().all(|byte| byte.is_ascii_hexdigit())).then(|| text.trim())
}

/// `invalid type: string "30min", expected f64`: the number that the key wants.
fn quoted_duration(message: &str, key: &str) -> Option<String> {
    let (text, expected) = message.strip_prefix("invalid type: string \"")?.split_once("\", expected ")?;
    ["f64", "u32", "u64"].contains(&expected).then(|| super::syntax::duration(key, text.trim()))?
}

/// `invalid value: integer `40001`, expected u8`: the number.
fn base(message: &str) -> Option<&str> {
    message.strip_prefix("invalid value: integer `")?.strip_suffix("`, expected u8")
}

/// `invalid type: string "a@b.c", expected a sequence`: the text in quotes.
fn list_of_one(message: &str) -> Option<&str> {
    let found = message.strip_prefix("invalid type: ")?.strip_suffix(", expected a sequence")?;
    let (kind, value) = found.split_once(' ')?;
    ["string", "integer", "boolean", "floating"]
        .contains(&kind)
        .then(|| value.trim_start_matches("point ").trim_matches('`'))
}

/// Whether somebody who wrote one word may have meant the other.
pub fn close(word: &str, other: &str) -> bool {
    distance(word, other) <= allowed(word)
}

/// How many letters of a word may be wrong.
fn allowed(word: &str) -> usize {
    1 + word.chars().count().min(12) / 4
}

/// Rust's names of types in plain words.
pub fn plain(message: &str) -> String {
    if message.contains("socket address") {
        return "not an address in numbers and a port, such as 127.0.0.1:8080 for this machine alone or 0.0.0.0:8080 for all"
            .into();
    }
    if message.starts_with("invalid type: map, expected a sequence") {
        return "there may be several: write each in [[double brackets]]".into();
    }
    if message.starts_with("invalid type: sequence, expected struct") {
        return "there is one: write it in [single brackets]".into();
    }
    let (head, expected) = match message.rsplit_once("expected ") {
        Some(parts) => parts,
        None => return message.into(),
    };
    let (are, such) = match expected {
        "an array of length 2" => ("are", ", such as [0.0, 100.0]"),
        _ => ("is", ""),
    };
    let expected = match expected {
        "u8" => "a whole number from 0 to 255",
        "u16" => "a whole number from 0 to 65535",
        "u32" | "u64" | "usize" => "a whole number from 0",
        "i64" => "a whole number",
        "f64" => "a number",
        "a string" => "text in quotes",
        "a boolean" => "true or false",
        "a sequence" => "several, each in [[double brackets]]",
        "an array of length 2" => "two numbers in brackets",
        other if other.starts_with("struct ") => "a table",
        other => other,
    };
    let found = head.strip_prefix("invalid type: ").or_else(|| head.strip_prefix("invalid value: "));
    match found.and_then(|found| found.strip_suffix(", ")) {
        Some(found) => format!("{expected} {are} expected{such}, not {}", in_words(found)),
        None => format!("{head}expected {expected}"),
    }
}

/// What serde found: `string "x"`, `integer `1``, `map`.
fn in_words(found: &str) -> String {
    match found {
        "map" => return "a table".into(),
        "sequence" => return "a list".into(),
        _ => {}
    }
    let number = ["integer `", "floating point `", "boolean `"];
    let number = number.iter().find_map(|kind| found.strip_prefix(kind)?.strip_suffix('`'));
    match (number, found.strip_prefix("string ")) {
        (Some(number), _) => number.into(),
        (None, Some(text)) => format!("the text {text}"),
        (None, None) => found.into(),
    }
}

/// The names that serde lists after `expected`.
pub fn choices(message: &str) -> Vec<&str> {
    let Some((_, list)) = message.split_once(", expected ") else {
        return Vec::new();
    };
    list.split('`').skip(1).step_by(2).collect()
}

/// `, did you mean "…"?` when a choice is close, else all of them.
pub fn hint(word: &str, choices: &[&str]) -> String {
    let allowed = allowed(word);
    let nearest = choices.iter().map(|choice| (distance(word, choice), choice)).min();
    match nearest {
        Some((distance, choice)) if distance <= allowed => format!(", did you mean {choice:?}?"),
        Some(_) if choices.len() > MOST_LISTED => {
            format!(
                "; known are {} and {} more",
                choices[..MOST_LISTED].join(", "),
                choices.len() - MOST_LISTED
            )
        }
        Some(_) if choices.iter().all(|choice| choice.contains(char::is_alphanumeric)) => {
            format!("; known are {}", choices.join(", "))
        }
        Some(_) => format!(
            "; known are {}",
            choices.iter().map(|c| format!("{c:?}")).collect::<Vec<_>>().join(" and ")
        ),
        None => String::new(),
    }
}

/// Levenshtein's distance of the first 64 characters.
fn distance(a: &str, b: &str) -> usize {
    const LONGEST: usize = 64;
    let b: Vec<char> = b.chars().take(LONGEST).flat_map(char::to_lowercase).collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().take(LONGEST).flat_map(char::to_lowercase).enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, y) in b.iter().enumerate() {
            let replaced = diagonal + usize::from(x != *y);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_by_hand() {
        let cases =
            [("", "abc", 3), ("poll_ms", "poll_ms", 0), ("polll_ms", "poll_ms", 1), ("kitten", "sitting", 3)];
        for (a, b, expected) in cases {
            assert_eq!((distance(a, b), distance(b, a)), (expected, expected), "{a} {b}");
        }
    }

    #[test]
    fn a_hint_is_the_nearest_or_the_list() {
        assert_eq!(hint("polll_ms", &["name", "poll_ms"]), ", did you mean \"poll_ms\"?");
        assert_eq!(hint("colour", &["name", "poll_ms"]), "; known are name, poll_ms");
        assert_eq!(hint("x", &[]), "");
    }

    #[test]
    fn choices_of_serde() {
        assert_eq!(choices("unknown field `x`, expected one of `a`, `b`"), ["a", "b"]);
        assert_eq!(choices("unknown field `x`, expected `a` or `b`"), ["a", "b"]);
        assert_eq!(choices("unknown field `x`, expected `a`"), ["a"]);
        assert!(choices("unknown field `x`, there are no fields").is_empty());
    }
}
