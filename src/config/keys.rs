//! What is said of keys: those that a section does not know, those that it lacks, and those that belong elsewhere.

use super::diagnostic::Report;
use super::source::{Source, Step, table_at};
use super::{tag, wording};
use crate::collect::modbus;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use toml::Spanned;
use toml::de::{DeValue, ValueDeserializer};

/// So many missing keys of a table are named one by one, more in one line.
const MOST_SINGLE: usize = 6;

/// Words that people take for a key of another name.
const MISTAKEN: [(&str, &str); 31] = [
    ("name", "id"),
    ("tag", "id"),
    ("id", "name"),
    ("host", "address"),
    ("ip", "address"),
    ("url", "address"),
    ("address", "url"),
    ("endpoint", "url"),
    ("zone", "tz"),
    ("timezone", "tz"),
    ("time_zone", "tz"),
    ("port", "address"),
    ("port", "listen"),
    ("broker", "address"),
    ("server", "address"),
    ("slave", "unit_id"),
    ("slave_id", "unit_id"),
    ("device_id", "unit_id"),
    ("interval", "poll_ms"),
    ("poll_interval", "poll_ms"),
    ("polling_interval", "poll_ms"),
    ("username", "user"),
    ("factor", "scale"),
    ("gain", "scale"),
    ("setpoint", "sp"),
    ("out", "op"),
    ("output", "op"),
    ("cv", "op"),
    ("position", "mv"),
    ("valve", "mv"),
    ("path", "folder"),
];

/// What was found of the keys of one section.
#[derive(Default)]
pub struct Keys {
    /// Missing ones, by place and table.
    lacking: BTreeMap<(usize, String), Vec<String>>,
    /// Those that are there, in a table that does not have them or by another name.
    elsewhere: Vec<String>,
}

impl Keys {
    /// A key is missing.
    pub fn lack(&mut self, place: usize, table: String, key: &str) {
        self.lacking.entry((place, table)).or_default().push(key.into());
    }

    /// Whether a missing key was found elsewhere, which was told.
    pub fn is_elsewhere(&self, key: &str) -> bool {
        self.elsewhere.iter().any(|own| own == key)
    }

    /// What is wrong with a key that serde does not know. `T` is the section at `path`, whose text is `value`; the key is
    /// in the table `below`.
    pub fn unknown<T: DeserializeOwned>(
        &mut self,
        (message, key): (&str, &str),
        (path, below): (&[Step], &[Step]),
        value: &Spanned<DeValue>,
    ) -> String {
        let table = wording::section(&[path, below].concat());
        let known = wording::choices(message);
        let beside = table_at(value.get_ref(), below).map(|table| table.keys()).into_iter().flatten();
        let beside: Vec<&str> = beside.map(|own| own.get_ref().as_ref()).filter(|own| *own != key).collect();
        let belongs = !below.is_empty() && keys_of::<T>().iter().any(|own| own == key);
        let there = table_at(value.get_ref(), &[]).is_some_and(|own| own.contains_key(key));
        let mistaken = MISTAKEN.iter().find(|(word, meant)| {
            let fits = known.contains(meant) && !beside.contains(meant);
            // Only one of several has a name.
            *word == key && fits && (*meant != "name" || table.starts_with("[[")) && (there || !belongs)
        });
        if let Some((_, meant)) = mistaken {
            self.elsewhere.push((*meant).into());
            return format!("unknown key {key:?} in {table}, did you mean {meant:?}?");
        }
        if belongs {
            self.elsewhere.push(key.into());
            let section = wording::section(path);
            let first = first_table(path, value).unwrap_or_else(|| table.clone());
            return format!(
                "{key}: belongs to {section} and stands in {table}: put it above {first}, under {section}"
            );
        }
        if let Some(meant) = in_other_words(key, &known) {
            return format!("unknown key {key:?} in {table}{meant}");
        }
        if key == "password" && known.contains(&"password_file") {
            return "password: no password stands in this file: write password_file or password_env".into();
        }
        if table == "[tables]" {
            return format!(
                "unknown key {key:?} in [tables]: how files are read stands in [tables.defaults]"
            );
        }
        let hint = match known.contains(&"register") && known.contains(&"topic") {
            true => tag::hint(key, &beside, &known, table.starts_with("[[")),
            false => wording::hint(key, &known),
        };
        format!("unknown key {key:?} in {table}{hint}")
    }

    /// Tells what is missing.
    pub fn tell(self, report: &mut Report) {
        for ((place, table), keys) in self.lacking {
            if keys.len() > MOST_SINGLE {
                let remedy = match table.as_str() {
                    "[loop.writeback]" => {
                        "; docs/writeback.md shows a whole section; without write-back, take it out"
                    }
                    _ => "",
                };
                let names = keys.join(", ");
                report.at(place, format!("{} keys are missing in {table}: {names}{remedy}", keys.len()));
                continue;
            }
            for key in keys {
                let remedy = match key.as_str() {
                    "address_base" => modbus::WHICH_BASE,
                    _ => "",
                };
                report.at(place, format!("missing key {key:?} in {table}{remedy}"));
            }
        }
    }
}

/// `poll_s` for `poll_ms`, and `disabled` for the opposite of `enabled`: the nearest key would mean something else.
fn in_other_words(key: &str, known: &[&str]) -> Option<String> {
    if key == "disabled" && known.contains(&"enabled") {
        return Some(": write enabled = false for disabled = true".into());
    }
    let other = |end: &str, own: &str| key.strip_suffix(end).map(|stem| format!("{stem}{own}"));
    let of_unit = [("_s", "_ms", "milliseconds"), ("_ms", "_s", "seconds")].into_iter();
    let mut found = of_unit.filter_map(|(end, own, unit)| Some((other(end, own)?, unit)));
    let (meant, unit) = found.find(|(meant, _)| known.contains(&meant.as_str()))?;
    Some(format!(", did you mean {meant:?}, in {unit}?"))
}

/// The keys that a section knows, in serde's own words.
fn keys_of<T: DeserializeOwned>() -> Vec<String> {
    let Ok(strange) = DeValue::parse("{ '?' = 0 }") else { return Vec::new() };
    match T::deserialize(ValueDeserializer::from(strange)) {
        Ok(_) => Vec::new(),
        Err(error) => wording::choices(error.message()).into_iter().map(str::to_string).collect(),
    }
}

/// The first table below a section, as the file writes it: what is the section's own stands above.
fn first_table(path: &[Step], value: &Spanned<DeValue>) -> Option<String> {
    let tables = value.get_ref().as_table()?.iter().filter_map(|(key, value)| {
        let items = value.get_ref().as_array().and_then(|items| items.first());
        let several = items.is_some_and(|item| item.get_ref().is_table());
        (several || value.get_ref().is_table()).then(|| (key.span().start, key.get_ref(), several))
    });
    let (_, key, several) = tables.min()?;
    let item = several.then_some(Step::Item(0));
    let below: Vec<Step> = [Step::Key(key.to_string())].into_iter().chain(item).collect();
    Some(wording::section(&[path, &below].concat()))
}

/// Whether a key that a section lacks stands under a section that is not known, which was told: `[loops.op]`, `[op]`.
pub fn is_in_unknown(source: &Source, sections: &[&str], section: &str, key: &str) -> bool {
    let unknown = source.root().iter().filter(|(name, _)| !sections.contains(&name.get_ref().as_ref()));
    unknown.into_iter().any(|(name, value)| {
        let misspelt = wording::close(name.get_ref(), section);
        let holds = value.get_ref().as_table().is_some_and(|table| table.contains_key(key));
        misspelt && holds || name.get_ref() == key && value.get_ref().is_table()
    })
}

#[cfg(test)]
mod tests {
    use crate::config::parse;

    /// A device and a loop, with some text put in place of other.
    fn errors(changes: &[(&str, &str)]) -> Vec<String> {
        let mut text = "[[modbus]]\nname = 'd'\naddress = '10.0.0.5:502'\naddress_base = 0\n\
                        [[loop]]\nid = 'A'\nop_limits = [0.0, 100.0]\n\
                        [loop.op]\ndevice = 'd'\nregister = 'holding'\naddress = 100\ntype = 'f32'\n\
                        [loop.pv]\ndevice = 'd'\nregister = 'holding'\naddress = 102\ntype = 'f32'\n"
            .to_string();
        for (from, to) in changes {
            assert!(text.contains(from), "{from}");
            text = text.replacen(from, to, 1);
        }
        parse("f", &text).err().unwrap_or_default().iter().map(ToString::to_string).collect()
    }

    #[test]
    fn a_value_of_the_wrong_kind_is_told_as_it_should_be() {
        assert_eq!(errors(&[]), [""; 0]);
        let cases = [
            (
                ("address = 100", "address = '0x64'"),
                "f:11:11: address: a number without quotes is expected, write address = 0x64",
            ),
            (
                ("op_limits", "candidates = 'X'\nop_limits"),
                "f:7:14: candidates: \"X\" is one name: expected \"auto\" or a list of names",
            ),
            (("op_limits", "mode = 'AUTO'\nop_limits"), "f:7:8: mode: a tag is expected: write [loop.mode]"),
            (
                ("address_base", "poll_ms = 1\naddress_base"),
                "f:4:11: poll_ms: 1 is shorter than timeout_ms = 500",
            ),
            (
                ("[[loop]]", "[tables]\nauto_values = [1]\n[[loop]]"),
                "f:6:1: unknown key \"auto_values\" in [tables]: how files are read stands in [tables.defaults]",
            ),
        ];
        for (change, expected) in &cases {
            let found = errors(&[*change]);
            assert!(found.len() == 1 && found[0].starts_with(expected), "{expected}: {found:#?}");
        }
        for (change, expected) in [
            (("address_base", "slave_id = 1\naddress_base"), "did you mean \"unit_id\"?"),
            (("address_base", "poll_ms = '1s'\naddress_base"), "write poll_ms = 1000"),
            (("[loop.op]", "[loop.cv]"), "did you mean \"op\"?"),
            (("op_limits", "period_s = true\nop_limits"), "period_s: a number is expected, not true"),
        ] {
            let found = errors(&[change]);
            assert!(found.iter().any(|line| line.contains(expected)), "{expected}: {found:#?}");
        }
        let limits = errors(&[("[0.0, 100.0]", "[4.0, 20.0]"), ("[loop.op]", "[loop.op]\nunit = '%'")]);
        assert!(limits.len() == 1 && limits[0].contains("op_span = 16 or op_span = 100"), "{limits:#?}");
        let none = errors(&[("[[modbus]]\nname = 'd'\naddress = '10.0.0.5:502'\naddress_base = 0\n", "")]);
        assert!(none.len() == 1 && none[0].contains("such as [[modbus]] with name = \"d\""), "{none:#?}");
        let mail = "[[notify.smtp]]\nname = 'm'\naddress = '127.0.0.1:25'\nsecurity = 'none'\nfrom = 'a@b.example'\n\
                    to = ['a@b.example; c@d.example']\n[[loop]]";
        let mail = errors(&[("[[loop]]", mail)]);
        assert!(mail.len() == 1 && mail[0].ends_with("to = [\"a@b.example\", \"c@d.example\"]"), "{mail:#?}");
    }

    #[test]
    fn what_is_right_and_may_be_meant_otherwise_is_remarked() {
        let remarks = |from: &str, to: &str| {
            let text = "[[modbus]]\nname = 'd'\naddress = '10.0.0.5:502'\naddress_base = 0\npoll_ms = 1000\n\
                        [[loop]]\nid = 'A'\n[loop.op]\ndevice = 'd'\nregister = 'holding'\naddress = 100\ntype = 'f32'\n\
                        [loop.pv]\ndevice = 'd'\nregister = 'holding'\naddress = 102\ntype = 'f32'\n";
            parse("f", &text.replacen(from, to, 1)).map(|config| config.remarks()).unwrap_or_default()
        };
        assert_eq!(remarks("", ""), [""; 0]);
        let cases = [
            (
                "poll_ms = 1000",
                "poll_ms = 3600000",
                "d: at poll_ms = 3600000 the first diagnosis takes 200 h",
            ),
            (
                "poll_ms = 1000",
                "poll_ms = 5\ntimeout_ms = 5",
                "d: at poll_ms = 5 it is asked 200 times a second",
            ),
            (
                "[[loop]]",
                "[fleet]\nservers = ['nats://127.0.0.1:4222']\n[[loop]]",
                "[fleet]: `stictiond edge` needs a site and a [store]",
            ),
        ];
        for (from, to, expected) in cases {
            let found = remarks(from, to);
            assert!(found.len() == 1 && found[0].starts_with(expected), "{expected}: {found:#?}");
        }
    }
}
