//! How an edge announces the list of its loops in parts, and which of them the stream has.

use super::inventory::hello;
use super::{Fleet, Scene};
use crate::fleet::announcement;
use crate::fleet::link::{Link, LinkError, Outgoing};
use crate::fleet::streams::LATEST;
use crate::fleet::subject::{Subject, What};
use crate::signal::LoopId;
use prost::Message;
use std::sync::Arc;

/// How much of its announcement an edge believes to be in the stream.
#[derive(Default)]
pub(super) struct Announced {
    /// The scene that needs no further announcement: it was announced, or cannot be.
    scene: Option<Arc<Scene>>,
    /// The first part of the announcement under way. It has the digest of the whole list, so it identifies the announcement.
    first: Option<Outgoing>,
    /// How many parts the stream has acknowledged, from the first on.
    kept: usize,
    /// Whether the stream may have been made anew, and may have lost the parts.
    is_doubted: bool,
}

impl Announced {
    /// The stream was made anew and has no part.
    pub(super) fn lost(&mut self) {
        *self = Self::default();
    }

    /// The server was away, or may have been: when it is back, its stream may be a new one.
    pub(super) fn doubt(&mut self) {
        self.is_doubted = true;
        if self.first.is_none() {
            // A list that could not be announced is tried again: the server's limits may have changed.
            self.scene = None;
        }
    }

    /// The subject of the first part, where the stream has to be asked for it: a stream that was not made anew still has it.
    fn doubted(&self) -> Option<&str> {
        self.first.as_ref().filter(|_| self.is_doubted).map(|first| first.subject.as_str())
    }

    /// Takes the stream's answer: the last message with the subject of the first part.
    fn found(&mut self, body: Option<&[u8]>) {
        if self.first.as_ref().is_some_and(|first| body == Some(&first.body[..])) {
            self.is_doubted = false;
        } else {
            self.lost();
        }
    }

    /// Whether a scene needs no further announcement.
    fn is_done(&self, scene: &Arc<Scene>) -> bool {
        self.scene.as_ref().is_some_and(|own| Arc::ptr_eq(own, scene))
    }

    /// Begins the announcement with this first part, or goes on with it. Returns how many of its parts are kept.
    fn begin(&mut self, first: &Outgoing) -> usize {
        if self.first.as_ref() != Some(first) {
            *self = Self { first: Some(first.clone()), ..Self::default() };
        }
        self.kept
    }

    /// One more part is kept.
    fn keep(&mut self) {
        self.kept += 1;
    }

    /// All parts are kept.
    fn end(&mut self, scene: &Arc<Scene>) {
        self.scene = Some(scene.clone());
    }

    /// A scene cannot be announced: it is not tried again until the server was away.
    fn give_up(&mut self, scene: &Arc<Scene>) {
        *self = Self { scene: Some(scene.clone()), ..Self::default() };
    }
}

impl Fleet {
    /// Announces this edge in parts. Parts that the stream has are not sent again, so that a slow line gets through in the end.
    pub(super) async fn greet(
        &self,
        link: &Link,
        scene: &Arc<Scene>,
        announced: &mut Announced,
    ) -> Result<(), LinkError> {
        if let Some(subject) = announced.doubted() {
            let last = link.last(LATEST, subject).await?;
            announced.found(last.as_ref().map(|(_, body)| &body[..]));
        }
        if announced.is_done(scene) {
            return Ok(());
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
            announced.give_up(scene);
            return Ok(());
        }
        let parts = announcement::split(&own, &list);
        let kept = parts.first().map_or(0, |first| announced.begin(first));
        for part in parts.into_iter().skip(kept) {
            // The next part is sent once this one is kept, so that a centre that hears the last part finds all of them.
            match link.send(&[part]).await {
                Err((_, LinkError::TooLarge(bytes))) => {
                    tracing::error!(
                        bytes,
                        "the centre does not know this edge's loops: a part of their list is longer than the NATS servers take; raise their max_payload"
                    );
                    announced.give_up(scene);
                    return Ok(());
                }
                sent => sent.map_err(|(_, error)| error)?,
            }
            announced.keep();
        }
        announced.end(scene);
        Ok(())
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
        let (mut own, first) = (Announced::default(), first(b"one"));
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
            let (mut own, first, scene) = (Announced::default(), first(b"one"), scene());
            own.begin(&first);
            own.keep();
            own.end(&scene);
            own.doubt();
            own.found(found);
            assert!(!own.is_done(&scene) && own.doubted().is_none());
            assert_eq!(own.begin(&first), 0);
        }
    }

    #[test]
    fn another_list_is_announced_from_its_first_part_on() {
        let mut own = Announced::default();
        own.begin(&first(b"one"));
        own.keep();
        assert_eq!(own.begin(&first(b"two")), 0);
        own.keep();
        assert_eq!(own.begin(&first(b"two")), 1);
        assert_eq!(own.begin(&first(b"one")), 0, "its parts were replaced");
    }

    #[test]
    fn what_is_announced_stays_so_when_something_else_fails() {
        let (mut own, first, [one, other]) = (Announced::default(), first(b"one"), [scene(), scene()]);
        own.begin(&first);
        own.keep();
        own.end(&one);
        own.doubt();
        own.found(Some(&first.body));
        assert!(own.is_done(&one) && !own.is_done(&other));
        // One that cannot be announced is looked at again once the server was away.
        own.give_up(&other);
        assert!(own.is_done(&other) && own.doubted().is_none());
        own.doubt();
        assert!(!own.is_done(&other) && own.doubted().is_none());
    }
}
