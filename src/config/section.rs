//! Text to structs, section by section. Serde stops at the first error; here the offending entry is taken out and the
//! section read again until nothing is left to complain of.

use super::diagnostic::Report;
use super::keys::Keys;
use super::source::{Source, Step, entry_at, table_mut, tables_at};
use super::wording;
use super::{Config, LoopConfig, keys};
use crate::collect::{modbus, mqtt, opcua};
use crate::{
    access, alarm, audit, diagnosis, fleet, history, notify, schedule, serve, store, table, work, writeback,
};
use serde::de::DeserializeOwned;
use std::borrow::Cow;
use toml::Spanned;
use toml::de::{DeValue, ValueDeserializer};

/// Sections of the file.
const SECTIONS: [&str; 17] = [
    "server",
    "access",
    "audit",
    "history",
    "store",
    "tables",
    "schedule",
    "diagnosis",
    "alarm",
    "plantwide",
    "writeback",
    "fleet",
    "notify",
    "modbus",
    "opcua",
    "mqtt",
    "loop",
];
/// Tags that a loop has once.
pub const ROLES: [&str; 5] = ["op", "pv", "sp", "mode", "mv"];
/// Errors looked for in one section; each costs one more reading of it.
const MAX_ERRORS: usize = 500;
/// Where entries stand that are not in the text.
const NOWHERE: usize = usize::MAX / 2;

/// What could be read; `None` where a needed key is missing or wrong.
pub struct Parts {
    pub server: Option<serve::Config>,
    /// Inside, `None` where the section is left out; the same below.
    pub access: Option<Option<access::Config>>,
    pub audit: Option<Option<audit::Config>>,
    pub history: Option<history::Config>,
    /// Inside, `None` where the section is left out.
    pub store: Option<Option<store::Config>>,
    pub tables: Option<table::Config>,
    pub schedule: Option<schedule::Config>,
    pub diagnosis: Option<diagnosis::Config>,
    pub alarm: Option<alarm::Config>,
    pub plantwide: Option<work::Config>,
    pub writeback: Option<writeback::Config>,
    /// Inside, `None` where the section is left out.
    pub fleet: Option<Option<fleet::Config>>,
    pub notify: Option<notify::Config>,
    pub modbus: Vec<Option<modbus::Config>>,
    pub opcua: Vec<Option<opcua::Config>>,
    pub mqtt: Vec<Option<mqtt::Config>>,
    pub loops: Vec<Option<LoopConfig>>,
}

impl Parts {
    /// The configuration, when every part of it could be read.
    pub fn whole(self) -> Option<Config> {
        Some(Config {
            server: self.server?,
            access: self.access?,
            audit: self.audit?,
            history: self.history?,
            store: self.store?,
            tables: self.tables?,
            schedule: self.schedule?,
            diagnosis: self.diagnosis?,
            alarm: self.alarm?,
            plantwide: self.plantwide?,
            writeback: self.writeback?,
            fleet: self.fleet?,
            notify: self.notify?,
            modbus: self.modbus.into_iter().collect::<Option<_>>()?,
            opcua: self.opcua.into_iter().collect::<Option<_>>()?,
            mqtt: self.mqtt.into_iter().collect::<Option<_>>()?,
            loops: self.loops.into_iter().collect::<Option<_>>()?,
            forwarded: Vec::new(),
        })
    }
}

/// Reads every section.
pub fn parts(source: &Source, report: &mut Report) -> Parts {
    for key in source.root().keys() {
        let name = key.get_ref();
        if !SECTIONS.contains(&name.as_ref()) {
            let hint = match (ROLES.contains(&name.as_ref()), wording::elsewhere(name)) {
                (true, _) => format!(": write it as [loop.{name}], below its [[loop]]"),
                (_, Some(own)) => format!(": {own}"),
                _ => wording::hint(name, &SECTIONS),
            };
            report.section(key.span().start, format!("unknown section {name:?}{hint}"));
        }
    }
    Parts {
        server: table(source, "server", report),
        access: optional(source, "access", report),
        audit: optional(source, "audit", report),
        history: table(source, "history", report),
        store: optional(source, "store", report),
        tables: table(source, "tables", report),
        schedule: table(source, "schedule", report),
        diagnosis: table(source, "diagnosis", report),
        alarm: table(source, "alarm", report),
        plantwide: table(source, "plantwide", report),
        writeback: table(source, "writeback", report),
        fleet: optional(source, "fleet", report),
        notify: table(source, "notify", report),
        modbus: tables(source, "modbus", report),
        opcua: tables(source, "opcua", report),
        mqtt: tables(source, "mqtt", report),
        loops: tables(source, "loop", report),
    }
}

/// `[name]`; its defaults when it is left out.
fn table<T: DeserializeOwned + Default>(source: &Source, name: &str, report: &mut Report) -> Option<T> {
    optional(source, name, report).map(Option::unwrap_or_default)
}

/// `[name]`; inside, `None` when it is left out.
fn optional<T: DeserializeOwned>(source: &Source, name: &str, report: &mut Report) -> Option<Option<T>> {
    match source.root().get(name) {
        None => Some(None),
        Some(value) if value.get_ref().is_table() => read(source, &[name.into()], value, report).map(Some),
        Some(value) => {
            report.at(value.span().start, format!("{name}: write it as a section, [{name}]"));
            None
        }
    }
}

/// Every `[[name]]`.
fn tables<T: DeserializeOwned>(source: &Source, name: &str, report: &mut Report) -> Vec<Option<T>> {
    let Some(value) = source.root().get(name) else {
        return Vec::new();
    };
    let wrong = format!("{name}: there may be several, write each as [[{name}]]");
    let Some(items) = value.get_ref().as_array() else {
        let wrong = headless(name, value).unwrap_or(wrong);
        // `[[loops]]` with `[loop.op]` below it: what is misspelt is told already.
        let misspelt = |key: &str| !SECTIONS.contains(&key) && wording::close(key, name);
        if !source.root().keys().any(|key| misspelt(key.get_ref())) {
            report.section(value.span().start, wrong);
        }
        return vec![None];
    };
    let item = |(at, item): (usize, &Spanned<DeValue>)| {
        if item.get_ref().is_table() {
            return read(source, &[name.into(), at.into()], item, report);
        }
        report.at(item.span().start, wrong.clone());
        None
    };
    items.iter().enumerate().map(item).collect()
}

/// `[loop.op]` where no `[[loop]]` stands above it.
fn headless(name: &str, value: &Spanned<DeValue>) -> Option<String> {
    let table = value.get_ref().as_table()?;
    let is_table = |value: &Spanned<DeValue>| value.get_ref().is_table();
    let first = ROLES.into_iter().find(|role| table.get(*role).is_some_and(is_table))?;
    if !table.values().all(is_table) {
        return None;
    }
    Some(format!("[{name}.{first}] has no [[{name}]] above it: write [[{name}]] and the id there"))
}

/// Reads one section at `path`, every error to the report.
fn read<T: DeserializeOwned>(
    source: &Source,
    path: &[Step],
    value: &Spanned<DeValue>,
    report: &mut Report,
) -> Option<T> {
    let mut keys = Keys::default();
    let read = read_on(source, path, value, &mut keys, report);
    keys.tell(report);
    read
}

/// Reads until nothing is left to complain of.
fn read_on<T: DeserializeOwned>(
    source: &Source,
    path: &[Step],
    value: &Spanned<DeValue>,
    keys: &mut Keys,
    report: &mut Report,
) -> Option<T> {
    let mut rest = value.clone();
    if path.first() == Some(&Step::from("loop")) {
        refuse_lists(&mut rest, report);
    }
    let mut inserted = 0;
    for _ in 0..MAX_ERRORS {
        let error = match T::deserialize(ValueDeserializer::from(rest.clone())) {
            // Without the entries that were wrong it is still good for the rules: a default stands in their place.
            Ok(read) if inserted == 0 => return Some(read),
            Ok(_) => return None,
            Err(error) => error,
        };
        let span = error.span().unwrap_or(value.span());
        let message = error.message();
        let went_on = match wording::missing(message) {
            Some(key) => {
                let told = report.is_broken() || stands_elsewhere(source, path, key);
                let keys = (!told).then_some(&mut *keys);
                missing(path, value, &mut rest, (key, span.clone()), &mut inserted, keys)
            }
            None => offending::<T>((path, value), &mut rest, (message, span.clone()), keys, report),
        };
        if !went_on {
            report.at(span.start.min(value.span().end), wording::plain(message));
            return None;
        }
    }
    report.at(value.span().start, format!("{}: and more errors", wording::section(path)));
    None
}

/// Serde would take a list for a table, its items for the fields in order; nobody means that in a loop.
fn refuse_lists(control_loop: &mut Spanned<DeValue>, report: &mut Report) {
    let DeValue::Table(table) = control_loop.get_mut() else {
        return;
    };
    for role in ROLES.into_iter().chain(["writeback", "cost"]) {
        if let Some(list) = table.get(role).filter(|value| value.get_ref().is_array()) {
            let message = format!("{role}: a loop has one, write it as [loop.{role}]");
            report.at(list.span().start, message);
            table.remove(role);
        }
    }
    let items = table.get("tag").and_then(|value| value.get_ref().as_array());
    if let Some(list) = items.and_then(|items| items.iter().find(|item| item.get_ref().is_array())) {
        report.at(list.span().start, "tag: write each as [[loop.tag]]".into());
        table.remove("tag");
    }
}

/// A key that a table needs: reported unless it was there and was taken out, and filled in so that reading goes on.
fn missing(
    path: &[Step],
    value: &Spanned<DeValue>,
    rest: &mut Spanned<DeValue>,
    (key, span): (&str, std::ops::Range<usize>),
    inserted: &mut usize,
    keys: Option<&mut Keys>,
) -> bool {
    let lacking = tables_at(rest, &span);
    let found = lacking
        .into_iter()
        .find(|path| table_mut(rest.get_mut(), path).is_some_and(|t| !t.contains_key(key)));
    let Some(below) = found else { return false };
    // A key that was taken out for its spelling was told with what was meant.
    let left: Vec<String> = table_mut(rest.get_mut(), &below)
        .map(|table| table.keys().map(|key| key.get_ref().to_string()).collect())
        .unwrap_or_default();
    let told = |own: &str| own == key || !left.iter().any(|left| left == own) && wording::close(own, key);
    let was_there = table_mut(value.clone().get_mut(), &below)
        .is_some_and(|table| table.keys().any(|own| told(own.get_ref())));
    let keys = keys.filter(|keys| !was_there && span.start < NOWHERE && !keys.is_elsewhere(key));
    if let Some(keys) = keys {
        keys.lack(span.start, wording::section(&[path, &below].concat()), key);
    }
    let Some(table) = table_mut(rest.get_mut(), &below) else {
        return false;
    };
    fill(table, key, 0, None, inserted)
}

/// Whether a key of a section stands under a name that is no section's.
fn stands_elsewhere(source: &Source, path: &[Step], key: &str) -> bool {
    matches!(path.first(), Some(Step::Key(section)) if keys::is_in_unknown(source, &SECTIONS, section, key))
}

/// Values for a missing key, tried in turn until one has the right type.
const FILLERS: [&str; 6] = ["''", "{}", "0", "0.0", "false", "[]"];

/// Fills in the `filler`-th value, or the word that serde asked for.
fn fill(
    table: &mut toml::de::DeTable,
    key: &str,
    filler: usize,
    word: Option<String>,
    inserted: &mut usize,
) -> bool {
    let value = match (word, FILLERS.get(filler)) {
        (Some(word), _) => DeValue::String(Cow::Owned(word)),
        (None, Some(text)) => match DeValue::parse(text) {
            Ok(value) => value.into_inner(),
            Err(_) => return false,
        },
        (None, None) => return false,
    };
    // The place says which value was tried, so that the next error about it can try the next.
    let place = NOWHERE + *inserted * (FILLERS.len() + 1) + filler;
    *inserted += 1;
    table.remove(key);
    let key = Spanned::new(NOWHERE..NOWHERE, Cow::Owned(key.to_string()));
    table.insert(key, Spanned::new(place..place + 1, value));
    true
}

/// An entry that cannot be used: reported and taken out, or, when it was filled in here, filled in otherwise.
fn offending<T: DeserializeOwned>(
    (path, value): (&[Step], &Spanned<DeValue>),
    rest: &mut Spanned<DeValue>,
    (message, span): (&str, std::ops::Range<usize>),
    keys: &mut Keys,
    report: &mut Report,
) -> bool {
    let Some(mut below) = entry_at(rest.get_ref(), &span) else {
        return false;
    };
    let Some(Step::Key(key)) = below.pop() else {
        return false;
    };
    let Some(table) = table_mut(rest.get_mut(), &below) else {
        return false;
    };
    if span.start >= NOWHERE {
        let step = FILLERS.len() + 1;
        let (before, filler) = ((span.start - NOWHERE) / step, (span.start - NOWHERE) % step);
        let word = wording::choices(message).first().map(|word| word.to_string());
        return fill(table, &key, filler + 1, word, &mut { before });
    }
    let entry = table.remove(key.as_str());
    let is_tag =
        ROLES.contains(&key.as_str()) && below.is_empty() && message.starts_with("invalid type: string");
    let said = if message.starts_with("unknown field") {
        keys.unknown::<T>((message, &key), (path, &below), value)
    } else if is_tag {
        format!("{key}: a tag is expected: write [loop.{key}] and below it where its values are read from")
    } else {
        let said = wording::of_entry(message, &key);
        // Of a list one item is wrong, and the others stay.
        let in_list = entry.is_some_and(|entry| entry.get_ref().is_array());
        if in_list { said.replace(&format!("write {key} = "), "write in the list ") } else { said }
    };
    report.at(span.start, said);
    true
}
