//! `probe`: what a server has, for the day its tags are chosen. Reads only.

use super::config::Config;
use super::link::Link;
use super::names::Namespaces;
use super::value::{self, Meaning, Received};
use crate::collect::scaling::Scaling;
use crate::collect::stub::{self, Stub, quoted};
use opcua::types::{DataValue, NodeClass, NodeId, ObjectId, StatusCode, Variant};
use std::collections::HashSet;
use std::fmt;
use std::sync::Arc;

/// Nodes that are looked at, at most.
const MAX_NODES: usize = 100_000;
/// Steps from the Objects folder, at most.
const MAX_DEPTH: usize = 30;
/// Longest value that is shown (characters).
const SHOWN: usize = 24;

/// A variable that was found.
#[derive(Clone, Debug, PartialEq)]
pub struct Seen {
    /// Its names from the Objects folder, `Plant/Unit10/FIC101/OP`.
    pub path: String,
    /// Its node id by the namespace's URI, as `node` wants it.
    pub node: String,
    /// The type of its value; empty where it has none.
    pub data_type: String,
    /// The value, shortened.
    pub value: String,
    /// When it held, by its source (s).
    pub t: Option<f64>,
    /// Good, or what the server says instead.
    pub status: String,
    /// Why it is no number, if it is none.
    pub no_number: Option<String>,
}

/// What a server has.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Probed {
    /// URIs of its namespaces, by number.
    pub namespaces: Vec<String>,
    /// The variables that the filter lets through.
    pub seen: Vec<Seen>,
    /// Variables that the filter lets through, and that were more than asked for.
    pub more: usize,
    /// The server has more nodes than are looked at.
    pub cut: bool,
    device: String,
}

/// Looks for variables whose path or node id fits the filter, in which `*` stands for anything; at most `most` are read.
///
/// # Errors
/// Why there is no session, or why it ended.
pub async fn probe(config: &Config, filter: &str, most: usize) -> Result<Probed, String> {
    let lost = |lost: super::link::Lost| format!("{}: {lost}", config.url);
    let mut link = Link::open(Arc::new(config.clone())).await.map_err(lost)?;
    let namespaces = link.namespaces().await.map_err(lost)?;
    let mut found = Probed { device: config.name.clone(), ..Probed::default() };
    let all = variables(&mut link, &mut found).await.map_err(lost)?;
    let fits =
        |(path, node): &(String, NodeId)| matches(filter, path) || matches(filter, &named(node, &namespaces));
    let mut wanted: Vec<(String, NodeId)> = all.into_iter().filter(fits).collect();
    wanted.sort_by(|a, b| a.0.cmp(&b.0));
    found.more = wanted.len().saturating_sub(most);
    wanted.truncate(most);
    let nodes: Vec<NodeId> = wanted.iter().map(|(_, node)| node.clone()).collect();
    let values = link.read(&nodes).await.map_err(lost)?;
    found.seen = wanted
        .iter()
        .zip(&values)
        .map(|((path, node), value)| seen(path, &named(node, &namespaces), value))
        .collect();
    found.namespaces = namespaces.0;
    Ok(found)
}

/// Every variable below the Objects folder by its path, breadth first; what belongs to the standard is left out.
async fn variables(link: &mut Link, found: &mut Probed) -> Result<Vec<(String, NodeId)>, super::link::Lost> {
    let mut variables = Vec::new();
    let mut known: HashSet<NodeId> = HashSet::new();
    let mut level: Vec<(String, NodeId)> = vec![(String::new(), ObjectId::ObjectsFolder.into())];
    for _ in 0..MAX_DEPTH {
        let nodes: Vec<NodeId> = level.iter().map(|(_, node)| node.clone()).collect();
        let mut next = Vec::new();
        for ((path, _), children) in level.iter().zip(link.children(&nodes).await?) {
            for child in children {
                let node = child.node_id.node_id;
                if node.namespace == 0 || child.node_id.server_index != 0 || !known.insert(node.clone()) {
                    continue;
                }
                let name = child.browse_name.name.to_string();
                let path = if path.is_empty() { name } else { format!("{path}/{name}") };
                if child.node_class == NodeClass::Variable {
                    variables.push((path.clone(), node.clone()));
                }
                next.push((path, node));
            }
        }
        found.cut = known.len() >= MAX_NODES;
        if next.is_empty() || found.cut {
            break;
        }
        level = next;
    }
    Ok(variables)
}

/// A node by the URI of its namespace; by its number where the server tells none.
fn named(node: &NodeId, namespaces: &Namespaces) -> String {
    let bare = NodeId { namespace: 0, identifier: node.identifier.clone() };
    match namespaces.uri(node.namespace) {
        Some(uri) => format!("nsu={};{bare}", uri.replace('%', "%25").replace(';', "%3B")),
        None => node.to_string(),
    }
}

/// Whether a text fits a filter: its parts between `*` occur in their order, small letters or large.
fn matches(filter: &str, text: &str) -> bool {
    let text = text.to_lowercase();
    let mut rest = text.as_str();
    filter.to_lowercase().split('*').all(|part| match rest.split_once(part) {
        Some((_, after)) => {
            rest = after;
            true
        }
        None => false,
    })
}

fn seen(path: &str, node: &str, value: &DataValue) -> Seen {
    let scaling = Scaling { scale: 1.0, offset: 0.0, range: None, auto_values: None };
    let meaning = Meaning { scaling, element: None, decimal: None };
    let status = value.status.unwrap_or(StatusCode::Good);
    let data_type = match &value.value {
        Some(Variant::Array(array)) => format!("{:?}[{}]", array.value_type, array.values.len()),
        Some(single) => value::type_name(single),
        None => String::new(),
    };
    let received = Received::of(value, &meaning);
    let text = value.value.as_ref().map(ToString::to_string).unwrap_or_default();
    Seen {
        path: path.into(),
        node: node.into(),
        data_type,
        value: text.chars().take(SHOWN).map(|c| if c.is_control() { ' ' } else { c }).collect(),
        t: received.source,
        status: status.to_string(),
        no_number: received.number.err().map(|why| why.to_string()).filter(|_| !status.is_bad()),
    }
}

impl Seen {
    fn note(&self) -> String {
        let at = self.t.map_or_else(|| "no source time".into(), stamp);
        format!("{} {} {} {at}", self.data_type, self.value, self.status)
    }
}

/// A time (s) as people read it.
fn stamp(t: f64) -> String {
    let found = jiff::Timestamp::from_millisecond((t * 1e3) as i64);
    found.map_or_else(|_| "no time".into(), |stamp| stamp.to_string())
}

impl Probed {
    /// The loops that the variables' names tell.
    pub fn stub(&self) -> Stub {
        let device = if self.device.is_empty() { "server" } else { &self.device };
        let numbers = self.seen.iter().filter(|seen| seen.no_number.is_none());
        let tags: Vec<stub::Tag> = numbers
            .map(|seen| stub::Tag {
                name: seen.path.clone(),
                keys: vec![("device".into(), quoted(device)), ("node".into(), quoted(&seen.node))],
                note: Some(seen.note()),
                ..stub::Tag::default()
            })
            .collect();
        stub::loops(&tags)
    }
}

impl fmt::Display for Probed {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (number, uri) in self.namespaces.iter().enumerate() {
            writeln!(out, "# ns={number} is nsu={}", uri.replace(char::is_control, " "))?;
        }
        for seen in &self.seen {
            // What a server calls its nodes must not end the comment.
            let line = format!("{}  {}  {}", seen.path, seen.node, seen.note());
            writeln!(out, "# {}", line.replace(char::is_control, " "))?;
            if let Some(why) = &seen.no_number {
                writeln!(out, "#   {}", why.replace(char::is_control, " "))?;
            }
        }
        if self.more > 0 {
            writeln!(out, "# and {} more: narrow the filter, or raise --most", self.more)?;
        }
        if self.cut {
            writeln!(
                out,
                "# the server has more than {MAX_NODES} nodes: those further down were not looked at"
            )?;
        }
        let stub = self.stub();
        write!(out, "{}\n{}", stub.remarks(), stub.text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn filters_are_parts_in_their_order() {
        for (filter, fits) in
            [("", true), ("fic101", true), ("u*101*op", true), ("op*101", false), ("x", false)]
        {
            assert_eq!(matches(filter, "Unit/FIC101/OP"), fits, "{filter}");
        }
    }
}
