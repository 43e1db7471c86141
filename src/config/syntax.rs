//! What is wrong with text that is no TOML, as the person who wrote it needs it.

/// Quotes that word processors put in place of `"` and `'`.
const TYPOGRAPHIC: [char; 6] = ['“', '”', '„', '‘', '’', '«'];

/// A blank that is none.
const NO_BREAK: [char; 2] = ['\u{a0}', '\u{202f}'];

/// A fault of syntax.
pub struct Fault {
    /// Byte at which it stands.
    pub at: usize,
    /// What is wrong and what to do.
    pub said: String,
}

/// The faults that a parser found, by place and message. What follows from one that was told is left out.
pub fn faults(text: &str, found: impl Iterator<Item = (usize, String)>) -> Vec<Fault> {
    let mut told: Vec<Fault> = Vec::new();
    let mut twice = None;
    let mut headless: Option<(&str, usize)> = None;
    for (at, message) in found {
        let at = at.min(text.len());
        if text.trim_start().starts_with('{') {
            let said = "this is JSON: a configuration is TOML, such as config/stictiond.toml".to_string();
            return vec![Fault { at: 0, said }];
        }
        if let Some(fault) = below_nothing(text, at).filter(|_| message.starts_with("duplicate key")) {
            told.push(fault);
            continue;
        }
        // A section that is there twice has every key twice.
        if message.starts_with("duplicate key") {
            let section = section(text, at);
            if twice.replace(section) == Some(section) {
                continue;
            }
            // Every table of a section is there twice that has no head of its own.
            if let Some(of) = table_of(line(text, at)) {
                let head = format!("[[{of}]]");
                let same =
                    headless.is_some_and(|(other, from)| other == of && !text[from..at].contains(&head));
                headless = Some((of, at));
                if same {
                    continue;
                }
            }
        }
        let said = said(text, at, &message);
        let ends = message.contains("array") || said.contains("YAML");
        told.push(Fault { at, said });
        // A bracket left open makes every line after it wrong.
        if ends {
            break;
        }
    }
    told
}

fn said(text: &str, at: usize, message: &str) -> String {
    let line = line(text, at);
    let value = line.split_once('=').map_or("", |(_, value)| value.trim());
    let begin = line.trim_start();
    if begin.starts_with("//")
        || begin.starts_with(';')
        || value.split('#').next().is_some_and(|value| value.contains(" //"))
    {
        return "a remark begins with #, not with // or ;".into();
    }
    if decimal_comma(text, at) {
        let thousands = value.split_once(',').is_some_and(|(_, rest)| rest.trim().len() == 3);
        return match thousands {
            true => "a comma within a number: leave it out between thousands, or write a point for a decimal comma".into(),
            false => match line.split_once('=') {
                Some((key, _)) if decimal(value) => {
                    format!("a decimal comma: write the number with a point, {} = {}", key.trim(), value.replacen(',', ".", 1))
                }
                _ => "a decimal comma: write the number with a point, such as 0.1".into(),
            },
        };
    }
    if line.contains(TYPOGRAPHIC) {
        return "typographic quotes: write the text as \"…\"".into();
    }
    if line.contains(NO_BREAK) {
        return "a no-break space, which looks like a blank: delete it and write a blank".into();
    }
    if let Some((key, _)) = line.split_once('=')
        && let Some(said) = of_value(key.trim(), value)
    {
        return said;
    }
    let word = || message.split([',', ':']).next().unwrap_or(message);
    match word() {
        "missing escaped value" | "invalid escape sequence" => {
            "a backslash within \"…\" begins an escape: write the text as '…', or a path with /".into()
        }
        "invalid basic string" | "invalid literal string" => {
            "a text that is not closed: its last quote is missing".into()
        }
        "string values must be quoted" if value.starts_with(|c: char| c.is_ascii_digit()) => {
            "a number stands alone: leave out the unit behind it, or write a text in quotes".into()
        }
        "string values must be quoted" | "invalid boolean" if is_plain(value) => {
            let key = line.split_once('=').map_or("", |(key, _)| key.trim());
            format!("a text stands in quotes: write {key} = \"{value}\"")
        }
        "string values must be quoted" | "invalid boolean" => {
            "a text stands in quotes, \"…\"; only numbers, true and false do not".into()
        }
        "key with no value" if line.contains(": ") || line.trim_end().ends_with(':') => {
            "this looks like YAML: a configuration is TOML, such as config/stictiond.toml".into()
        }
        "key with no value" => "a key without a value: write key = value".into(),
        "unclosed array table" | "unclosed table" => {
            "a section that is not closed: write [name] or [[name]]".into()
        }
        "duplicate key" => twice(text, at),
        word if word.starts_with("invalid") && !value.is_empty() => format!(
            "{message}: write a number such as 100.0, a list such as [0.0, 100.0], true, false, or a text in quotes"
        ),
        _ => message.into(),
    }
}

/// What is wrong with a value that is no TOML, where its text shows what was meant.
fn of_value(key: &str, value: &str) -> Option<String> {
    let value = value.split(" #").next().unwrap_or_default().trim();
    if value.is_empty() || value.starts_with('#') {
        return Some(format!("the value is missing: write {key} = value"));
    }
    match value.to_lowercase().as_str() {
        "true" | "yes" | "on" => return Some(format!("write {key} = true")),
        "false" | "no" | "off" => return Some(format!("write {key} = false")),
        _ => {}
    }
    match value {
        "null" | "None" | "none" | "nil" => return Some(format!("there is no such value: leave {key} out")),
        _ => {}
    }
    if let Some(fraction) = value.strip_prefix('.').filter(|rest| rest.bytes().all(|b| b.is_ascii_digit())) {
        return Some(format!("a number begins with a digit: write {key} = 0.{fraction}"));
    }
    if let Some(list) = value.strip_prefix('(').and_then(|rest| rest.strip_suffix(')')) {
        return Some(format!("a list stands in square brackets: write {key} = [{list}]"));
    }
    if let Some(alone) = value.strip_suffix([',', ';']) {
        return Some(format!("a line ends with its value: write {key} = {alone}"));
    }
    if value.contains(" ; ") {
        return Some("a remark begins with #, not with // or ;".into());
    }
    if let Some(rest) = value.strip_prefix(['−', '–', '—']) {
        return Some(format!("a dash in place of the minus sign: write {key} = -{rest}"));
    }
    let without_zeros = value.trim_start_matches('0');
    if without_zeros.len() < value.len()
        && without_zeros.starts_with(|c: char| c.is_ascii_digit() && c != '0')
        && without_zeros.bytes().all(|byte| byte.is_ascii_digit())
    {
        return Some(format!("a number does not begin with 0: write {key} = {without_zeros}"));
    }
    let of_address = |c: char| c.is_ascii_digit() || c == '.' || c == ':';
    if value.chars().all(of_address) && (value.contains(':') || value.matches('.').count() == 3) {
        return Some(format!("a text stands in quotes: write {key} = \"{value}\""));
    }
    if value.starts_with('[') && value.contains(';') {
        return Some("values of a list are parted by commas".into());
    }
    let quotes = value.matches('"').count();
    if value.starts_with('"') && value.ends_with('"') && quotes > 2 && !value.contains('\\') {
        let inner = value.get(1..value.len() - 1).unwrap_or_default();
        return Some(format!("quotes within a text: write {key} = '{inner}'"));
    }
    duration(key, value)
}

/// `period_s = 1h`: the number that the key wants.
pub fn duration(key: &str, value: &str) -> Option<String> {
    let (number, unit) = value.split_at(value.find(|c: char| !c.is_ascii_digit() && c != '.')?);
    let seconds = match unit.trim() {
        "ms" => 1e-3,
        "s" | "sec" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        "d" => 86_400.0,
        _ => return None,
    };
    let per_unit = match key {
        key if key.ends_with("_ms") => 1e3,
        key if key.ends_with("_s") => 1.0,
        _ => return None,
    };
    let number = number.parse::<f64>().ok()? * seconds * per_unit;
    let unit = if per_unit > 1.0 { "milliseconds" } else { "seconds" };
    Some(format!("a number stands alone, here of {unit}: write {key} = {number}"))
}

/// The section that a line opens a table of: `loop` of `[loop.op]`.
fn table_of(line: &str) -> Option<&str> {
    let name = line.trim().strip_prefix('[')?.trim_start_matches('[');
    name.split_once('.').map(|(of, _)| of.trim())
}

/// Which key is there twice, and where it is first.
fn twice(text: &str, at: usize) -> String {
    let name = |line: &str| line.split('=').next().unwrap_or_default().trim().to_string();
    let key = name(line(text, at));
    let begin = section(text, at).unwrap_or(0);
    let before = &text[begin..at];
    let first = before.lines().position(|line| line.contains('=') && name(line) == key);
    match first {
        Some(first) if !key.starts_with('[') => {
            let line = text[..begin].matches('\n').count() + first + 1;
            format!("the key {key:?} is there twice, first in line {line}: take one out")
        }
        _ if key.starts_with('[') => {
            let head = table_of(&key).filter(|_| !key.starts_with("[["));
            let head = head.map(|of| format!(", or write [[{of}]] above the second")).unwrap_or_default();
            format!("the section {key} is there twice: take one out{head}")
        }
        _ => format!("the key {key:?} is there twice: perhaps its section is, take one out"),
    }
}

/// `[loop.op]` above the first `[[loop]]`, whose line is the second fault then.
fn below_nothing(text: &str, at: usize) -> Option<Fault> {
    let name = line(text, at).trim().strip_prefix("[[")?.split("]]").next()?.trim();
    let begins = |line: &str, with: &str| line.trim_start().starts_with(with);
    let (single, several) = (format!("[{name}."), format!("[[{name}]]"));
    let mut begin = 0;
    for line in text.split_inclusive('\n') {
        if begins(line, &several) && begin < at && begin + line.len() <= at {
            return None;
        }
        if begins(line, &single) && begin < at {
            let table = line.trim().split(']').next().unwrap_or_default();
            let said = format!("{table}] stands above the first [[{name}]]: put it below its own [[{name}]]");
            return Some(Fault { at: begin + line.len() - line.trim_start().len(), said });
        }
        begin += line.len();
    }
    None
}

/// The line around a byte.
fn line(text: &str, at: usize) -> &str {
    let begin = text.get(..at).and_then(|before| before.rfind('\n')).map_or(0, |end| end + 1);
    text.get(begin..).and_then(|rest| rest.lines().next()).unwrap_or_default()
}

/// Where the line of the section begins that holds a byte; `None` above the first.
fn section(text: &str, at: usize) -> Option<usize> {
    let mut begin = 0;
    let mut last = None;
    for line in text.split_inclusive('\n') {
        if begin > at {
            break;
        }
        if line.trim_start().starts_with('[') {
            last = Some(begin);
        }
        begin += line.len();
    }
    last
}

/// Whether a value needs nothing but quotes to be a text. The beginning of true or false may be meant as one of these.
fn is_plain(value: &str) -> bool {
    let may_be_meant = ["true", "false"].iter().any(|word| word.starts_with(value));
    !may_be_meant && value.chars().all(|c| c.is_alphanumeric() || "_-./: ".contains(c))
}

/// Whether a value is one number with a decimal comma.
fn decimal(value: &str) -> bool {
    value.matches(',').count() == 1 && value.replacen(',', ".", 1).parse::<f64>().is_ok()
}

/// `scale = 0,1`: the parser stops at the comma.
fn decimal_comma(text: &str, at: usize) -> bool {
    let digit = |at: Option<usize>| at.and_then(|at| text.as_bytes().get(at)).is_some_and(u8::is_ascii_digit);
    text.as_bytes().get(at) == Some(&b',') && digit(at.checked_sub(1)) && digit(at.checked_add(1))
}

#[cfg(test)]
mod tests {
    use crate::config::parse;

    fn errors(text: &str) -> Vec<String> {
        parse("f", text).err().unwrap_or_default().iter().map(ToString::to_string).collect()
    }

    #[test]
    fn what_is_no_toml_is_told_once_and_with_what_to_do() {
        let cases = [
            ("[[loop]]\nid = FIC101\n", "f:2:6: a text stands in quotes: write id = \"FIC101\""),
            ("[[loop]]\nid = “FIC101”\n", "f:2:6: typographic quotes"),
            ("[[loop]]\nid = \"FIC101\n", "a text that is not closed"),
            ("[[loop]]\nid = \"A\"\nop_span = 100.0 // per cent\n", "a remark begins with #"),
            ("// the loops\n[[loop]]\nid = \"A\"\n", "a remark begins with #, not with // or ;"),
            ("; the loops\n[[loop]]\nid = \"A\"\n", "a remark begins with #, not with // or ;"),
            ("[loop.op]\naddress = 0100\n", "a number does not begin with 0: write address = 100"),
            ("[store]\nfolder = \"C:\\stictiond\\store\"\n", "write the text as '…', or a path with /"),
            ("{\"loop\": [{\"id\": \"A\"}]}\n", "f:1:1: this is JSON"),
            ("loop:\n  - id: A\n    op: 1\n", "this looks like YAML"),
            ("[[loop]]\nid = \"A\"\nid = \"B\"\n", "f:3:1: the key \"id\" is there twice, first in line 2"),
            ("[[loop]\nid = \"A\"\n", "a section that is not closed"),
            ("[server]\nscale = 0,1\n", "a decimal comma"),
            ("[schedule]\nperiod_s = 3,600\n", "a comma within a number: leave it out between thousands"),
            ("[schedule]\nperiod_s = 1h\n", "write period_s = 3600"),
            ("[[modbus]]\npoll_ms = 2s\n", "write poll_ms = 2000"),
            ("[[modbus]]\naddress = 10.0.0.5:502\n", "write address = \"10.0.0.5:502\""),
            ("[store]\nenabled = True\n", "write enabled = true"),
            ("[store]\nenabled = no # yet\n", "write enabled = false"),
            ("[[loop]]\nid =\n", "the value is missing: write id = value"),
            ("[[loop]]\noffset = −5.0\n", "write offset = -5.0"),
            ("[[loop]]\nscale = 0,01\n", "a decimal comma: write the number with a point, scale = 0.01"),
            ("[[loop]]\nop_limits = (0.0, 100.0)\n", "write op_limits = [0.0, 100.0]"),
            ("[[loop]]\nscale = .01\n", "write scale = 0.01"),
            ("[[loop]]\nscale = null\n", "there is no such value: leave scale out"),
            ("[[loop]]\nscale = 0.1,\n", "a line ends with its value: write scale = 0.1"),
            ("[[loop]]\nscale = 1 ; boiler\n", "a remark begins with #"),
            ("[[loop]]\nop_limits = [0.0; 100.0]\n", "values of a list are parted by commas"),
            ("[[loop]]\nop_limits = 0-100\n", "a list such as [0.0, 100.0]"),
            ("[[loop]]\n\u{a0}id = \"A\"\n", "a no-break space"),
            (
                "[[loop]]\nnode = \"ns=3;s=\"DB1\".\"OP\"\"\n",
                "quotes within a text: write node = 'ns=3;s=\"DB1\".\"OP\"'",
            ),
        ];
        for (text, expected) in cases {
            let found = errors(text);
            let same = found.iter().filter(|line| line.contains(expected)).count();
            assert_eq!(same, 1, "{text}: {found:#?}");
        }
        let section = "[[loop]]\nid = \"A\"\n[loop.op]\ndevice = \"d\"\naddress = 0\n[loop.op]\ndevice = \"d\"\naddress = 2\n";
        let found = errors(section);
        assert_eq!(found.iter().filter(|line| line.contains("twice")).count(), 1, "{found:#?}");
    }
}
