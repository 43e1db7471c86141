//! Names on the wire: `stictiond.v1.<site>.<loop>.<what>`, `stictiond.v1.<site>.<loop>.state.<edge>`, and
//! `stictiond.v1.<site>.<edge>.hello.<part>`.

use std::fmt::{self, Write as _};

/// What every subject begins with; the number changes when a payload does so that old readers would misread it.
const PREFIX: &str = "stictiond.v1";
/// Stands in a site's place for what belongs to none.
pub const NO_SITE: &str = "fleet";
/// Longest name of a site (characters).
const MAX_SITE: usize = 32;

/// What a message is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum What {
    /// Samples of a loop, [`Samples`](super::message::Samples).
    Samples,
    /// A window to be diagnosed, [`Window`](super::message::Window).
    Window,
    /// What a worker says of a window, [`Answer`](super::message::Answer).
    Answer,
    /// What an edge says of a loop, [`Diagnosis`](super::message::Diagnosis).
    Diagnosis,
    /// An alarm of an edge, [`Alarm`](super::message::Alarm).
    Alarm,
    /// How the alarms of a loop or collector stand, [`States`](super::message::States). The edge that says so stands at the end: the
    /// stream keeps the last message of each subject, and two edges of a site may have one loop.
    State,
    /// What somebody at the centre did about an alarm, [`Action`](super::message::Action).
    Action,
    /// A part of an edge's announcement, [`HelloPart`](super::message::HelloPart). The edge's name stands in the loop's place, and
    /// the number of the part at the end.
    Hello,
    /// That an edge or a worker is there, [`Pulse`](super::message::Pulse); its name stands in the loop's place.
    Pulse,
    /// How far an edge has forwarded, [`Cursor`](super::message::Cursor); its name stands in the loop's place.
    Cursor,
}

impl What {
    /// All of them.
    pub const ALL: [Self; 10] = [
        Self::Samples,
        Self::Window,
        Self::Answer,
        Self::Diagnosis,
        Self::Alarm,
        Self::State,
        Self::Action,
        Self::Hello,
        Self::Pulse,
        Self::Cursor,
    ];

    /// As it stands in a subject.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Samples => "samples",
            Self::Window => "window",
            Self::Answer => "answer",
            Self::Diagnosis => "diagnosis",
            Self::Alarm => "alarm",
            Self::State => "state",
            Self::Action => "action",
            Self::Hello => "hello",
            Self::Pulse => "pulse",
            Self::Cursor => "cursor",
        }
    }
}

/// Whose message it is and what it is about.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Subject {
    /// The site.
    pub site: String,
    /// The loop, or the edge or worker.
    pub name: String,
    /// What it is about.
    pub what: What,
}

impl Subject {
    /// Its parts.
    pub fn new(site: &str, name: &str, what: What) -> Self {
        Self { site: site.to_string(), name: name.to_string(), what }
    }

    /// The subject of the part with this number.
    pub fn part(&self, number: u32) -> String {
        format!("{self}.{number}")
    }

    /// The subject of what this edge says of it.
    pub fn of_edge(&self, edge: &str) -> String {
        format!("{self}.{}", escaped(edge))
    }

    /// A subject as it is written; `None` for another's. The number of a part and the edge of a state are not returned: the message
    /// has them, too.
    pub fn read(text: &str) -> Option<Self> {
        let mut parts = text.strip_prefix(PREFIX)?.strip_prefix('.')?.split('.');
        let (site, name, what) = (parts.next()?, parts.next()?, parts.next()?);
        let what = What::ALL.into_iter().find(|own| own.as_str() == what)?;
        if what == What::Hello {
            parts.next()?.parse::<u32>().ok()?;
        } else if what == What::State {
            unescaped(parts.next().filter(|edge| !edge.is_empty())?)?;
        }
        (parts.next().is_none() && is_site(site)).then_some(())?;
        Some(Self { site: site.to_string(), name: unescaped(name)?, what })
    }
}

impl fmt::Display for Subject {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{PREFIX}.{}.{}.{}", self.site, escaped(&self.name), self.what.as_str())
    }
}

/// All subjects about `what`, of one site or of all.
pub fn all(site: Option<&str>, what: What) -> String {
    let part = if matches!(what, What::Hello | What::State) { ".*" } else { "" };
    format!("{PREFIX}.{}.*.{}{part}", site.unwrap_or("*"), what.as_str())
}

/// Whether this may stand in a site's place: it stands in subjects, loop names and file names as it is.
pub fn is_site(text: &str) -> bool {
    let good = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
    (1..=MAX_SITE).contains(&text.len()) && text.chars().all(good)
}

/// The name of a site's loop where loops of many sites are together.
pub fn of_site(site: &str, control_loop: &str) -> String {
    format!("{site}:{control_loop}")
}

/// Site and loop of such a name.
pub fn split(name: &str) -> Option<(&str, &str)> {
    name.split_once(':').filter(|(site, _)| is_site(site))
}

/// A name as one token: what is no letter, digit, `-` or `_` by its bytes, as in an address.
pub fn escaped(name: &str) -> String {
    let mut out = String::with_capacity(name.len());
    for byte in name.bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'_' => out.push(char::from(byte)),
            _ => {
                let _ = write!(out, "%{byte:02X}");
            }
        }
    }
    out
}

fn unescaped(token: &str) -> Option<String> {
    let (mut bytes, mut rest) = (Vec::with_capacity(token.len()), token.as_bytes());
    while let Some((&first, behind)) = rest.split_first() {
        rest = behind;
        if first == b'%' {
            let digits = std::str::from_utf8(rest.get(..2)?).ok()?;
            bytes.push(u8::from_str_radix(digits, 16).ok()?);
            rest = &rest[2..];
        } else {
            bytes.push(first);
        }
    }
    String::from_utf8(bytes).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_subject_is_written_as_documented() {
        let subject = Subject::new("north", "FIC 101.A", What::Samples);
        assert_eq!(subject.to_string(), "stictiond.v1.north.FIC%20101%2EA.samples");
        assert_eq!(Subject::new("north", "e1", What::Hello).part(7), "stictiond.v1.north.e1.hello.7");
        let state = Subject::new("north", "FIC1", What::State).of_edge("e.1");
        assert_eq!(state, "stictiond.v1.north.FIC1.state.e%2E1");
        assert_eq!(all(None, What::State), "stictiond.v1.*.*.state.*");
        assert_eq!(all(Some("north"), What::Hello), "stictiond.v1.north.*.hello.*");
        assert_eq!(all(None, What::Alarm), "stictiond.v1.*.*.alarm");
    }

    #[test]
    fn another_s_subject_is_none_of_ours() {
        for text in ["", "stictiond.v2.a.b.samples", "stictiond.v1.a.b", "stictiond.v1.a.b.c.samples"] {
            assert_eq!(Subject::read(text), None, "{text}");
        }
        for text in ["stictiond.v1.A.b.samples", "stictiond.v1.a.%4.samples", "stictiond.v1.a.b.other"] {
            assert_eq!(Subject::read(text), None, "{text}");
        }
        for text in ["stictiond.v1.a.b.hello", "stictiond.v1.a.b.hello.x", "stictiond.v1.a.b.hello.1.2"] {
            assert_eq!(Subject::read(text), None, "{text}");
        }
        for text in ["stictiond.v1.a.b.state", "stictiond.v1.a.b.state.", "stictiond.v1.a.b.state.e.1"] {
            assert_eq!(Subject::read(text), None, "{text}");
        }
    }

    proptest! {
        #[test]
        fn whatever_a_loop_is_called_it_comes_back(name in "\\PC{1,40}", at in 0..What::ALL.len()) {
            let subject = Subject::new("site-1", &name, What::ALL[at]);
            let (text, tokens) = match subject.what {
                What::Hello => (subject.part(at as u32), 6),
                What::State => (subject.of_edge(&name), 6),
                _ => (subject.to_string(), 5),
            };
            prop_assert!(text.split('.').count() == tokens && !text.contains([' ', '*', '>']));
            prop_assert_eq!(Subject::read(&text), Some(subject));
        }

        #[test]
        fn no_text_makes_it_panic(text in "\\PC{0,60}") {
            let _ = Subject::read(&format!("stictiond.v1.{text}"));
        }
    }
}
