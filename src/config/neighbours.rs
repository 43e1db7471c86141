//! Whose signals may explain a loop: other loops' tags, by name or by unit.

use super::{Config, LoopConfig, plant};
use crate::history::TagKind;
use crate::signal::{LoopId, Role};
use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use std::fmt;

/// Most tags of other loops that one loop looks at.
pub const MOST_CANDIDATES: usize = 50;

/// `candidates` of a loop: `"auto"`, or names as `"FIC203.pv"`.
#[derive(Clone, Debug, PartialEq)]
pub enum Candidates {
    /// PV of the other loops of the same `group`, the first [`MOST_CANDIDATES`] in the file's order.
    Auto,
    /// These.
    Named(Vec<String>),
}

impl<'de> Deserialize<'de> for Candidates {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Reader;
        impl<'de> Visitor<'de> for Reader {
            type Value = Candidates;

            fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
                out.write_str("\"auto\" or a list of names like \"FIC203.pv\"")
            }

            fn visit_str<E: Error>(self, word: &str) -> Result<Candidates, E> {
                if word == "auto" {
                    Ok(Candidates::Auto)
                } else {
                    let wanted = "expected \"auto\" or a list of names like \"FIC203.pv\"";
                    Err(E::custom(format!("{word:?} is one name: {wanted}, candidates = [{word:?}]")))
                }
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut names: A) -> Result<Candidates, A::Error> {
                let mut all = Vec::new();
                while let Some(name) = names.next_element()? {
                    all.push(name);
                }
                Ok(Candidates::Named(all))
            }
        }
        deserializer.deserialize_any(Reader)
    }
}

/// A tag of another loop.
#[derive(Clone, Debug, PartialEq)]
pub struct Neighbour {
    /// `loop.tag`, the name it has in a record.
    pub name: String,
    /// Whose it is.
    pub id: LoopId,
    /// Which of its tags.
    pub kind: TagKind,
}

impl Neighbour {
    fn new(id: &str, kind: TagKind) -> Self {
        Self { name: format!("{id}.{}", kind.name()), id: LoopId::new(id), kind }
    }
}

/// The tag that `name` means among `loops`; the mode of a loop is none.
pub(super) fn find<'l>(name: &str, loops: impl Iterator<Item = &'l LoopConfig>) -> Option<Neighbour> {
    for other in loops {
        let Some(tag) = name.strip_prefix(other.id.as_str()).and_then(|rest| rest.strip_prefix('.')) else {
            continue;
        };
        let kinds = plant::tags(other).map(|(role, tag)| plant::kind(role, tag));
        let found = kinds.into_iter().find(|kind| kind.name() == tag && *kind != TagKind::Role(Role::Mode));
        if let Some(kind) = found {
            return Some(Neighbour::new(&other.id, kind));
        }
    }
    None
}

/// The tag that is called `name` but for capitals.
pub(super) fn in_other_letters<'l>(
    name: &str,
    mut loops: impl Iterator<Item = &'l LoopConfig>,
) -> Option<String> {
    loops.find_map(|other| {
        let called = |(role, tag)| format!("{}.{}", other.id, plant::kind(role, tag).name());
        plant::tags(other).map(called).find(|own| own.eq_ignore_ascii_case(name))
    })
}

impl Config {
    /// The tags of other loops that may explain this one.
    pub fn neighbours(&self, control_loop: &LoopConfig) -> Vec<Neighbour> {
        let others = || self.loops.iter().filter(|other| other.id != control_loop.id);
        match &control_loop.candidates {
            None => Vec::new(),
            Some(Candidates::Named(names)) => names.iter().filter_map(|name| find(name, others())).collect(),
            Some(Candidates::Auto) => {
                let near = others().filter(|other| other.group == control_loop.group);
                near.take(MOST_CANDIDATES)
                    .map(|other| Neighbour::new(&other.id, TagKind::Role(Role::Pv)))
                    .collect()
            }
        }
    }
}
