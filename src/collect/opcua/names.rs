//! How nodes are named, and which namespace a name means in a session. Pure.
//!
//! A server may number its namespaces anew whenever it starts. A URI means the same namespace for ever; a plain number
//! means the URI that it had at first, and nothing else after that. `pins` shares that among all who ask the server.

use opcua::types::{Identifier, NodeId, QualifiedName, RelativePath, RelativePathElement};
use std::collections::BTreeMap;
use std::str::FromStr;

/// Most steps of a path.
const MAX_STEPS: usize = 32;
/// Longest text of a name or path (bytes).
const MAX_TEXT: usize = 4096;

/// The namespace of a name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Namespace {
    /// By its number, `ns=2` or `2:`.
    Number(u16),
    /// By its URI, `nsu=urn:plant`.
    Uri(String),
}

/// A node by its identifier.
#[derive(Clone, Debug, PartialEq)]
pub struct NodeName {
    namespace: Namespace,
    /// The identifier; the number of its namespace is not used.
    bare: NodeId,
}

/// A node by its browse path from the Objects folder.
#[derive(Clone, Debug, PartialEq)]
pub struct PathName(Vec<Step>);

#[derive(Clone, Debug, PartialEq)]
struct Step {
    reference: NodeId,
    is_inverse: bool,
    include_subtypes: bool,
    namespace: Namespace,
    name: String,
}

impl FromStr for NodeName {
    type Err = ();

    /// `nsu=urn:plant;s=FIC101.OP`, `ns=2;s=FIC101.OP`, `i=2258`.
    fn from_str(text: &str) -> Result<Self, ()> {
        if let Some(rest) = text.strip_prefix("nsu=") {
            let (uri, rest) = uri(rest).ok_or(())?;
            let bare = NodeId::from_str(rest).map_err(|_| ())?;
            // A second namespace within the identifier would contradict the first.
            let names_one = rest.starts_with("ns=") || rest.starts_with("nsu=");
            return if names_one { Err(()) } else { Ok(Self { namespace: Namespace::Uri(uri), bare }) };
        }
        let bare = NodeId::from_str(text).map_err(|_| ())?;
        Ok(Self { namespace: Namespace::Number(bare.namespace), bare })
    }
}

impl Namespace {
    /// The standard's own has its number for ever.
    fn is_numbered(&self) -> bool {
        matches!(self, Self::Number(1..))
    }
}

impl NodeName {
    pub(super) fn is_numbered(&self) -> bool {
        self.namespace.is_numbered()
    }

    /// Whether a name stands in the standard's own namespace, whose nodes have numbers.
    pub(super) fn has_no_namespace(&self) -> bool {
        matches!(self.namespace, Namespace::Number(0))
            && matches!(self.bare.identifier, Identifier::String(_))
    }

    /// The node in a session, or why it has none.
    pub(super) fn resolve(&self, namespaces: &Namespaces, pins: &mut Pins) -> Result<NodeId, String> {
        let number = pins.number(&self.namespace, namespaces)?;
        Ok(NodeId { namespace: number, identifier: self.bare.identifier.clone() })
    }
}

impl FromStr for PathName {
    type Err = ();

    /// `/nsu=urn:plant;Unit10/nsu=urn:plant;FIC101`, `/2:Unit10/2:FIC101`, with the references of the standard in
    /// `<HasComponent>` and `&` before a character that is part of a name.
    fn from_str(text: &str) -> Result<Self, ()> {
        let mut steps = Vec::new();
        let mut rest = text;
        while !rest.is_empty() {
            let step;
            (step, rest) = step_of(rest).ok_or(())?;
            steps.push(step);
        }
        let fits = (1..=MAX_STEPS).contains(&steps.len()) && text.len() <= MAX_TEXT;
        if fits { Ok(Self(steps)) } else { Err(()) }
    }
}

impl PathName {
    pub(super) fn is_numbered(&self) -> bool {
        self.0.iter().any(|step| step.namespace.is_numbered())
    }

    /// The path in a session, or why it has none.
    pub(super) fn resolve(&self, namespaces: &Namespaces, pins: &mut Pins) -> Result<RelativePath, String> {
        let mut elements = Vec::with_capacity(self.0.len());
        for step in &self.0 {
            let number = pins.number(&step.namespace, namespaces)?;
            elements.push(RelativePathElement {
                reference_type_id: step.reference.clone(),
                is_inverse: step.is_inverse,
                include_subtypes: step.include_subtypes,
                target_name: QualifiedName::new(number, step.name.as_str()),
            });
        }
        Ok(RelativePath { elements: Some(elements) })
    }
}

/// A URI up to its `;`, and what follows. Within it `;` and `%` are written as `%3B` and `%25`.
fn uri(text: &str) -> Option<(String, &str)> {
    let (uri, rest) = text.split_once(';')?;
    let uri = uri.replace("%3B", ";").replace("%3b", ";").replace("%25", "%");
    (!uri.is_empty() && uri.len() <= MAX_TEXT).then_some((uri, rest))
}

fn step_of(text: &str) -> Option<(Step, &str)> {
    let by_name = |name: &str| RelativePathElement::default_node_resolver(0, name);
    let (reference, is_inverse, include_subtypes, rest) = if let Some(rest) = text.strip_prefix('/') {
        (by_name("HierarchicalReferences")?, false, true, rest)
    } else if let Some(rest) = text.strip_prefix('.') {
        // As in the standard's own grammar: what a node is made of.
        (opcua::types::ReferenceTypeId::Aggregates.into(), false, true, rest)
    } else {
        let (reference, rest) = text.strip_prefix('<')?.split_once('>')?;
        let exact = reference.strip_prefix('#');
        let inverse = exact.unwrap_or(reference).strip_prefix('!');
        let name = inverse.or(exact).unwrap_or(reference);
        let found = by_name(name.strip_prefix("0:").unwrap_or(name))?;
        // What is not one of the standard's comes back as a text, which is no node of the standard.
        found.as_u32()?;
        (found, inverse.is_some(), exact.is_none(), rest)
    };
    let (namespace, rest) = namespace_of(rest)?;
    let (name, rest) = name_of(rest);
    let step = Step { reference, is_inverse, include_subtypes, namespace, name };
    (!step.name.is_empty()).then_some((step, rest))
}

fn namespace_of(text: &str) -> Option<(Namespace, &str)> {
    if let Some(rest) = text.strip_prefix("nsu=") {
        let (uri, rest) = uri(rest)?;
        return Some((Namespace::Uri(uri), rest));
    }
    let digits = text.bytes().take_while(u8::is_ascii_digit).count();
    match text[digits..].strip_prefix(':') {
        Some(rest) if digits > 0 => Some((Namespace::Number(text[..digits].parse().ok()?), rest)),
        _ => Some((Namespace::Number(0), text)),
    }
}

/// A browse name without its `&`, and where the next step begins.
fn name_of(text: &str) -> (String, &str) {
    let mut name = String::new();
    let mut escaped = false;
    for (at, c) in text.char_indices() {
        match c {
            _ if escaped => {
                name.push(c);
                escaped = false;
            }
            '&' => escaped = true,
            '/' | '.' | '<' => return (name, &text[at..]),
            c => name.push(c),
        }
    }
    (name, "")
}

/// The namespaces of a session, as the server told them; empty where it told none.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Namespaces(pub(super) Vec<String>);

impl Namespaces {
    /// The URI of a number.
    pub(super) fn uri(&self, number: u16) -> Option<&str> {
        self.0.get(usize::from(number)).map(String::as_str)
    }

    fn number(&self, uri: &str) -> Option<u16> {
        self.0.iter().position(|known| known == uri).and_then(|at| u16::try_from(at).ok())
    }
}

/// Which URI each plain number of one server had at first. It outlives a session.
#[derive(Clone, Debug, Default)]
pub(super) struct Pins {
    first: BTreeMap<u16, String>,
}

impl Pins {
    /// The number of a namespace in this session, or why it has none.
    fn number(&mut self, namespace: &Namespace, namespaces: &Namespaces) -> Result<u16, String> {
        let number = match namespace {
            Namespace::Uri(uri) => {
                let missing = || format!("the server has no namespace '{uri}': {}", told(namespaces));
                return namespaces.number(uri).ok_or_else(missing);
            }
            // The standard's own namespace never moves.
            Namespace::Number(0) => return Ok(0),
            Namespace::Number(number) => *number,
        };
        let now = namespaces.uri(number);
        match (self.first.get(&number), now) {
            (Some(first), Some(now)) if first == now => Ok(number),
            (Some(first), now) => Err(moved(number, first, now)),
            (None, Some(now)) => {
                self.first.insert(number, now.into());
                Ok(number)
            }
            // A server that tells no namespaces can still be asked, and says itself what it has not.
            (None, None) => Ok(number),
        }
    }

    /// Remembers what a number means, unless that is known already.
    pub(super) fn pin(&mut self, number: u16, uri: String) {
        self.first.entry(number).or_insert(uri);
    }

    /// Numbers and their URIs.
    pub(super) fn known(&self) -> impl Iterator<Item = (u16, &str)> {
        self.first.iter().map(|(number, uri)| (*number, uri.as_str()))
    }
}

/// Why a number is not read any more. Where what it is now is meant, its URI says so: what it was is not forgotten.
fn moved(number: u16, first: &str, now: Option<&str>) -> String {
    let is = now.map_or_else(|| "none".into(), |now| format!("'{now}'"));
    let or = now.map(|now| format!(", or by nsu={now};… where that is meant")).unwrap_or_default();
    format!(
        "ns={number} was the namespace '{first}' and is now {is}: not read, since it is another node; name it by \
         nsu={first};… instead of a number{or}"
    )
}

fn told(namespaces: &Namespaces) -> String {
    let own: Vec<String> = namespaces.0.iter().skip(1).take(20).map(|uri| format!("'{uri}'")).collect();
    if own.is_empty() { "it tells none of its own".into() } else { format!("it has {}", own.join(", ")) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn node(text: &str) -> NodeName {
        text.parse().unwrap()
    }

    fn spaces(own: &[&str]) -> Namespaces {
        Namespaces(
            std::iter::once(&"http://opcfoundation.org/UA/").chain(own).map(|s| s.to_string()).collect(),
        )
    }

    #[test]
    fn a_uri_follows_its_namespace_and_a_number_stays_with_the_uri_it_had() {
        let (before, after) =
            (spaces(&["urn:own", "urn:a", "urn:b"]), spaces(&["urn:own", "urn:b", "urn:a"]));
        let mut pins = Pins::default();
        let (by_uri, by_number) = (node("nsu=urn:a;s=OP"), node("ns=2;s=OP"));
        assert_eq!(by_uri.resolve(&before, &mut pins), Ok(NodeId::new(2, "OP")));
        assert_eq!(by_number.resolve(&before, &mut pins), Ok(NodeId::new(2, "OP")));
        assert_eq!(by_uri.resolve(&after, &mut pins), Ok(NodeId::new(3, "OP")));
        let why = by_number.resolve(&after, &mut pins).unwrap_err();
        assert!(why.contains("'urn:a' and is now 'urn:b'") && why.contains("nsu=urn:a;"), "{why}");
        let why = by_number.resolve(&spaces(&["urn:own"]), &mut pins).unwrap_err();
        assert!(why.contains("is now none"), "{why}");
        assert_eq!(by_number.resolve(&before, &mut pins), Ok(NodeId::new(2, "OP")), "back where it was");
        assert_eq!(pins.known().collect::<Vec<_>>(), [(2, "urn:a")]);
        let why = node("nsu=urn:c;s=OP").resolve(&before, &mut pins).unwrap_err();
        assert!(why.contains("'urn:c'") && why.contains("'urn:b'"), "{why}");
        assert_eq!(node("i=2258").resolve(&after, &mut pins), Ok(NodeId::new(0, 2258u32)));
        // A server that tells nothing is asked as the file says, until something was pinned.
        assert_eq!(node("ns=7;i=1").resolve(&Namespaces::default(), &mut pins), Ok(NodeId::new(7, 1u32)));
        assert!(by_number.resolve(&Namespaces::default(), &mut pins).is_err());
    }

    #[test]
    fn paths_name_each_step_and_escape_what_divides() {
        let namespaces = Namespaces((0..20).map(|n| format!("http://x/{n}/UA")).collect());
        let steps = |text: &str| -> Vec<(u16, String)> {
            let path: PathName = text.parse().unwrap_or_else(|()| panic!("{text}"));
            let path = path.resolve(&namespaces, &mut Pins::default()).unwrap();
            let elements = path.elements.unwrap().into_iter();
            elements.map(|e| (e.target_name.namespace_index, e.target_name.name.to_string())).collect()
        };
        let of = |names: &[(u16, &str)]| names.iter().map(|(n, s)| (*n, s.to_string())).collect::<Vec<_>>();
        assert_eq!(steps("/2:Unit/12:OP"), of(&[(2, "Unit"), (12, "OP")]));
        assert_eq!(steps("/nsu=http://x/3/UA;Unit.2:OP"), of(&[(3, "Unit"), (2, "OP")]));
        assert_eq!(steps("/nsu=http://x/3/UA;A&/B&.C/Server"), of(&[(3, "A/B.C"), (0, "Server")]));
        assert_eq!(steps("<HasComponent>2:A<#!Organizes>1:B"), of(&[(2, "A"), (1, "B")]));
        for wrong in
            ["", "Unit", "/", "/2:", "/nsu=urn:a", "/nsu=;A", "/99999:A", "<2:Mine>A", "<HasNothing>A", "<A"]
        {
            assert!(wrong.parse::<PathName>().is_err(), "{wrong}");
        }
        for wrong in ["FIC101", "ns=99999;s=a", "nsu=urn:a", "nsu=;s=a", "nsu=urn:a;ns=2;s=a", "nsu=urn:a;x"]
        {
            assert!(wrong.parse::<NodeName>().is_err(), "{wrong}");
        }
        assert_eq!(node("nsu=urn:a%3Bb%25;s=x").namespace, Namespace::Uri("urn:a;b%".into()));
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused(text in "[/.<>#!&:;=nsui0-9a%é]{0,40}") {
            let _ = text.parse::<NodeName>();
            let _ = text.parse::<PathName>();
        }

        #[test]
        fn no_order_of_namespaces_leads_to_another_node(
            before in Just(vec!["urn:a", "urn:b", "urn:c", "urn:d"]).prop_shuffle(),
            after in Just(vec!["urn:a", "urn:b", "urn:c", "urn:d"]).prop_shuffle(),
            at in 1u16..5,
        ) {
            let (before, after) = (spaces(&before), spaces(&after));
            let mut pins = Pins::default();
            let meant = before.uri(at).unwrap();
            for name in [node(&format!("ns={at};s=OP")), node(&format!("nsu={meant};s=OP"))] {
                prop_assert_eq!(name.resolve(&before, &mut pins).unwrap().namespace, at);
                if let Ok(found) = name.resolve(&after, &mut pins) {
                    prop_assert_eq!(after.uri(found.namespace), Some(meant));
                } else {
                    let by_number = name == node(&format!("ns={at};s=OP"));
                    prop_assert!(by_number && after.uri(at) != Some(meant));
                }
            }
        }
    }
}
