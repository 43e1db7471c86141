//! How an edge announces the list of its loops in parts, and which of them the stream has.

use super::forward::{Came, ROUND_BYTES};
use super::inventory::hello;
use super::{Fleet, Scene};
use crate::fleet::announcement;
use crate::fleet::link::{Link, LinkError, Outgoing};
use crate::fleet::streams::LATEST;
use crate::fleet::subject::{Subject, What};
use crate::signal::LoopId;
use prost::Message;
use std::sync::Arc;

/// How far the announcement of an edge has come.
#[derive(Default)]
pub(super) enum Announcing {
    /// The stream has no part, as far as is known.
    #[default]
    NotBegun,
    /// The stream has the first parts.
    Sending(Sent),
    /// The stream has all parts of the list of this scene.
    Done(Arc<Scene>, Sent),
    /// The list of this scene cannot be announced.
    GivenUp(Arc<Scene>),
}

/// The parts of an announcement that the stream has acknowledged.
pub(super) struct Sent {
    /// The first part. It has the digest of the whole list, so it identifies the announcement.
    first: Outgoing,
    /// How many parts, from the first on.
    kept: usize,
    /// Whether the stream may have been made anew, and may have lost the parts.
    is_doubted: bool,
}

impl Announcing {
    /// The stream was made anew and has no part.
    pub(super) fn lost(&mut self) {
        *self = Self::NotBegun;
    }

    /// The server was away, or may have been: when it is back, its stream may be a new one.
    pub(super) fn doubt(&mut self) {
        match self {
            Self::NotBegun => {}
            Self::Sending(sent) | Self::Done(_, sent) => sent.is_doubted = true,
            // It is tried again: the server's limits may have changed.
            Self::GivenUp(_) => *self = Self::NotBegun,
        }
    }

    /// The subject of the first part, where the stream has to be asked for it: a stream that was not made anew still has it.
    fn doubted(&self) -> Option<&str> {
        match self {
            Self::Sending(sent) | Self::Done(_, sent) if sent.is_doubted => Some(&sent.first.subject),
            _ => None,
        }
    }

    /// Takes the stream's answer: the last message with the subject of the first part.
    fn found(&mut self, body: Option<&[u8]>) {
        match self {
            Self::Sending(sent) | Self::Done(_, sent) if body == Some(&sent.first.body[..]) => {
                sent.is_doubted = false;
            }
            _ => self.lost(),
        }
    }

    /// Whether a scene needs no further announcement.
    fn is_over(&self, scene: &Arc<Scene>) -> bool {
        match self {
            Self::NotBegun | Self::Sending(_) => false,
            Self::Done(own, _) | Self::GivenUp(own) => Arc::ptr_eq(own, scene),
        }
    }

    /// Begins the announcement with this first part, or goes on with it. Returns how many of its parts are kept.
    fn begin(&mut self, first: &Outgoing) -> usize {
        match self {
            Self::Sending(sent) | Self::Done(_, sent) if sent.first == *first => sent.kept,
            _ => {
                *self = Self::Sending(Sent { first: first.clone(), kept: 0, is_doubted: false });
                0
            }
        }
    }

    /// One more part is kept.
    fn keep(&mut self) {
        if let Self::Sending(sent) = self {
            sent.kept += 1;
        }
    }

    /// All parts are kept.
    fn end(&mut self, scene: &Arc<Scene>) {
        *self = match std::mem::take(self) {
            // A scene may have the list of the one before.
            Self::Sending(sent) | Self::Done(_, sent) => Self::Done(scene.clone(), sent),
            other => other,
        };
    }

    /// A scene cannot be announced: it is not tried again until the server was away.
    fn give_up(&mut self, scene: &Arc<Scene>) {
        *self = Self::GivenUp(scene.clone());
    }
}

impl Fleet {
    /// Announces this edge in parts, of which as many as there is room for in one round. Parts that the stream has are not sent
    /// again, so that a slow line gets through in the end.
    pub(super) async fn announce(
        &self,
        link: &Link,
        scene: &Arc<Scene>,
        announcing: &mut Announcing,
    ) -> Result<Came, LinkError> {
        if let Some(subject) = announcing.doubted() {
            let last = link.last(LATEST, subject).await?;
            announcing.found(last.as_ref().map(|(_, body)| &body[..]));
        }
        if announcing.is_over(scene) {
            return Ok(Came::Whole);
        }
        let names = crate::app::devices_of(&scene.config).iter().map(LoopId::to_string).collect();
        let own = Subject::new(&self.site, &self.name, What::Hello);
        let list = hello(scene, names).encode_to_vec();
        if !announcement::is_taken(&list) {
            tracing::error!(
                loops = scene.config.loops.len(),
                bytes = list.len(),
                "the centre does not know this edge's loops: their list is too large for it; divide them between two edges"
            );
            announcing.give_up(scene);
            return Ok(Came::Whole);
        }
        let parts = announcement::split(&own, &list);
        let kept = parts.first().map_or(0, |first| announcing.begin(first));
        let mut bytes = 0;
        for part in parts.into_iter().skip(kept) {
            if bytes >= ROUND_BYTES {
                return Ok(Came::Part);
            }
            bytes += part.body.len();
            // The next part is sent once this one is kept, so that a centre that hears the last part finds all of them.
            match link.send(&[part]).await {
                Err((_, LinkError::TooLarge(bytes))) => {
                    tracing::error!(
                        bytes,
                        "the centre does not know this edge's loops: a part of their list is longer than the NATS servers take; raise their max_payload"
                    );
                    announcing.give_up(scene);
                    return Ok(Came::Whole);
                }
                sent => sent.map_err(|(_, error)| error)?,
            }
            announcing.keep();
        }
        announcing.end(scene);
        Ok(Came::Whole)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::fleet::tests::edge;

    /// The first part of a list that has these bytes.
    fn first(list: &[u8]) -> Outgoing {
        announcement::split(&Subject::new("north", "e1", What::Hello), list).swap_remove(0)
    }

    fn scene() -> Arc<Scene> {
        edge("FIC1").0.scene.borrow().clone()
    }

    #[test]
    fn an_announcement_goes_on_where_it_was_while_the_stream_has_it() {
        let (mut own, first) = (Announcing::default(), first(b"one"));
        own.doubt();
        assert_eq!(own.doubted(), None);
        assert_eq!(own.begin(&first), 0);
        own.keep();
        own.keep();
        assert_eq!(own.doubted(), None, "nothing has failed");
        own.doubt();
        assert_eq!(own.doubted(), Some(first.subject.as_str()));
        own.found(Some(&first.body));
        assert_eq!(own.doubted(), None);
        assert_eq!(own.begin(&first), 2);
    }

    #[test]
    fn a_stream_that_was_made_anew_gets_all_parts_again() {
        let other = first(b"two").body;
        for found in [None, Some(&other[..])] {
            let (mut own, first, scene) = (Announcing::default(), first(b"one"), scene());
            own.begin(&first);
            own.keep();
            own.end(&scene);
            own.doubt();
            own.found(found);
            assert!(!own.is_over(&scene) && own.doubted().is_none());
            assert_eq!(own.begin(&first), 0);
        }
    }

    #[test]
    fn another_list_is_announced_from_its_first_part_on() {
        let mut own = Announcing::default();
        own.begin(&first(b"one"));
        own.keep();
        assert_eq!(own.begin(&first(b"two")), 0);
        own.keep();
        assert_eq!(own.begin(&first(b"two")), 1);
        assert_eq!(own.begin(&first(b"one")), 0, "its parts were replaced");
    }

    #[test]
    fn what_is_announced_stays_so_when_something_else_fails() {
        let (mut own, first, [one, other]) = (Announcing::default(), first(b"one"), [scene(), scene()]);
        own.begin(&first);
        own.keep();
        own.end(&one);
        own.doubt();
        own.found(Some(&first.body));
        assert!(own.is_over(&one) && !own.is_over(&other));
        // The list of the other one is the same, so the stream has it.
        assert_eq!(own.begin(&first), 1);
        own.end(&other);
        assert!(own.is_over(&other) && !own.is_over(&one));
        // One that cannot be announced is looked at again once the server was away.
        own.give_up(&other);
        assert!(own.is_over(&other) && own.doubted().is_none());
        own.doubt();
        assert!(!own.is_over(&other) && own.doubted().is_none());
    }
}
