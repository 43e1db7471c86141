//! The file as a tree whose every key and value knows its place in the text.

use super::diagnostic::Report;
use super::syntax;
use std::ops::Range;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// The parsed text.
pub struct Source<'a> {
    root: DeTable<'a>,
}

/// One step from a table or array to what is in it.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    Key(String),
    Item(usize),
}

impl From<&str> for Step {
    fn from(key: &str) -> Self {
        Self::Key(key.into())
    }
}

impl From<usize> for Step {
    fn from(item: usize) -> Self {
        Self::Item(item)
    }
}

impl<'a> Source<'a> {
    /// Parses the text; every syntax error goes to the report and what could be read is kept.
    pub fn parse(text: &'a str, report: &mut Report) -> Self {
        let (root, errors) = DeTable::parse_recoverable(text);
        let found = errors
            .into_iter()
            .map(|error| (error.span().map_or(text.len(), |span| span.start), error.message().to_string()));
        for fault in syntax::faults(text, found) {
            report.broken(fault.at, fault.said);
        }
        Self { root: root.into_inner() }
    }

    /// The top-level sections.
    pub fn root(&self) -> &DeTable<'a> {
        &self.root
    }

    fn get(&self, path: &[Step]) -> Option<&Spanned<DeValue<'a>>> {
        let (Step::Key(first), rest) = path.split_first()? else {
            return None;
        };
        rest.iter().try_fold(self.root.get(first.as_str())?, |value, step| match step {
            Step::Key(key) => value.get_ref().as_table()?.get(key.as_str()),
            Step::Item(at) => value.get_ref().as_array()?.get(*at),
        })
    }

    /// Byte at which the value at a path stands; when it is left out, that of the nearest table that would hold it.
    pub fn place(&self, path: &[Step]) -> usize {
        let known = (1..=path.len()).rev().find_map(|length| self.get(&path[..length]));
        known.map_or(0, |value| value.span().start)
    }

    /// Whether something stands at a path.
    pub fn has(&self, path: &[Step]) -> bool {
        self.get(path).is_some()
    }

    /// The keys of the table at a path, with their places.
    pub fn keys(&self, path: &[Step]) -> Vec<(&str, usize)> {
        let table = self.get(path).and_then(|value| value.get_ref().as_table());
        let place = |key: &'_ Spanned<std::borrow::Cow<'a, str>>| key.span().start;
        table
            .map(|table| table.keys().map(|key| (key.get_ref().as_ref(), place(key))).collect())
            .unwrap_or_default()
    }

    /// The string at a path.
    pub fn text(&self, path: &[Step]) -> Option<&str> {
        self.get(path)?.get_ref().as_str()
    }
}

/// The variable that a text waits to have filled in: `PLC` of `${PLC}:502`.
pub fn variable(text: &str) -> Option<&str> {
    let (_, rest) = text.split_once("${")?;
    rest.split_once('}').map(|(name, _)| name)
}

/// Every text below a value, with its place.
pub fn texts<'v>(value: &'v Spanned<DeValue<'_>>, take: &mut dyn FnMut(usize, &'v str)) {
    match value.get_ref() {
        DeValue::String(text) => take(value.span().start, text),
        DeValue::Array(items) => items.iter().for_each(|item| texts(item, take)),
        DeValue::Table(table) => table.values().for_each(|value| texts(value, take)),
        _ => {}
    }
}

/// The path to the entry whose key or value covers exactly `span`. The path to an array that holds such an item is
/// that of the whole array: an array is judged as one value.
pub fn entry_at(value: &DeValue, span: &Range<usize>) -> Option<Vec<Step>> {
    match value {
        DeValue::Table(table) => table.iter().find_map(|(key, value)| {
            let key_step = || Step::Key(key.get_ref().to_string());
            // Deeper first: a table written with dots covers the same bytes as its key.
            let below = entry_at(value.get_ref(), span).map(|mut path| {
                path.insert(0, key_step());
                path
            });
            let holds = |value: &Spanned<DeValue>| match value.get_ref() {
                DeValue::Array(items) => items.iter().any(|item| item.span() == *span),
                _ => false,
            };
            let here = key.span() == *span || value.span() == *span || holds(value);
            below.or_else(|| here.then(|| vec![key_step()]))
        }),
        DeValue::Array(items) => items.iter().enumerate().find_map(|(at, item)| {
            let mut path = entry_at(item.get_ref(), span)?;
            path.insert(0, Step::Item(at));
            Some(path)
        }),
        _ => None,
    }
}

/// The paths to the tables that cover exactly `span`.
pub fn tables_at(value: &Spanned<DeValue>, span: &Range<usize>) -> Vec<Vec<Step>> {
    let mut found = Vec::new();
    let mut below = |step: Step, value: &Spanned<DeValue>| {
        for mut path in tables_at(value, span) {
            path.insert(0, step.clone());
            found.push(path);
        }
    };
    match value.get_ref() {
        DeValue::Table(table) => {
            table.iter().for_each(|(key, value)| below(Step::Key(key.get_ref().to_string()), value));
            if value.span() == *span {
                found.push(Vec::new());
            }
        }
        DeValue::Array(items) => {
            items.iter().enumerate().for_each(|(at, item)| below(Step::Item(at), item));
        }
        _ => {}
    }
    found
}

/// The table at a path below a value, to be looked at.
pub fn table_at<'t, 'a>(value: &'t DeValue<'a>, path: &[Step]) -> Option<&'t DeTable<'a>> {
    let inner = path.iter().try_fold(value, |value, step| match step {
        Step::Key(key) => value.as_table()?.get(key.as_str()).map(Spanned::get_ref),
        Step::Item(at) => value.as_array()?.get(*at).map(Spanned::get_ref),
    })?;
    inner.as_table()
}

/// The table at a path below a value.
pub fn table_mut<'t, 'a>(value: &'t mut DeValue<'a>, path: &[Step]) -> Option<&'t mut DeTable<'a>> {
    let inner = path.iter().try_fold(value, |value, step| match (step, value) {
        (Step::Key(key), DeValue::Table(table)) => table.get_mut(key.as_str()).map(Spanned::get_mut),
        (Step::Item(at), DeValue::Array(items)) => items.get_mut(*at).map(Spanned::get_mut),
        _ => None,
    })?;
    match inner {
        DeValue::Table(table) => Some(table),
        _ => None,
    }
}
