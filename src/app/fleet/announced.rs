//! How an edge says what it is, in parts, and how far it has come with that.

use super::inventory::hello;
use super::{Fleet, Scene};
use crate::fleet::announcement;
use crate::fleet::link::{Link, LinkError, Outgoing};
use crate::fleet::streams::LATEST;
use crate::fleet::subject::{Subject, What};
use crate::signal::LoopId;
use prost::Message;
use std::sync::Arc;

/// What the stream has of an edge's announcement, as far as the edge knows.
#[derive(Default)]
pub(super) struct Announced {
    /// The scene that nothing more is to be said of.
    scene: Option<Arc<Scene>>,
    /// The first part, which has the digest of the whole: another announcement has another.
    first: Option<Outgoing>,
    /// Parts that are kept: all before this number.
    kept: usize,
    /// The stream may be another one by now.
    is_doubted: bool,
}

impl Announced {
    /// The stream is another one, which has nothing.
    pub(super) fn lost(&mut self) {
        *self = Self::default();
    }

    /// The server was away, or may have been: its stream may be another one when it is there again.
    pub(super) fn doubt(&mut self) {
        self.is_doubted = true;
        if self.first.is_none() {
            // What could not be announced may be possible then.
            self.scene = None;
        }
    }

    /// Where the stream is to be asked for the first part, which it has if it is the same as before.
    fn doubted(&self) -> Option<&str> {
        self.first.as_ref().filter(|_| self.is_doubted).map(|first| first.subject.as_str())
    }

    /// The stream has this there.
    fn found(&mut self, body: Option<&[u8]>) {
        if self.first.as_ref().is_some_and(|first| body == Some(&first.body[..])) {
            self.is_doubted = false;
        } else {
            self.lost();
        }
    }

    /// Whether nothing more is to be said of a scene.
    fn is_done(&self, scene: &Arc<Scene>) -> bool {
        self.scene.as_ref().is_some_and(|own| Arc::ptr_eq(own, scene))
    }

    /// Begins the announcement that has this first part, or goes on with it; how many of its parts are kept.
    fn begin(&mut self, first: &Outgoing) -> usize {
        if self.first.as_ref() != Some(first) {
            *self = Self { first: Some(first.clone()), ..Self::default() };
        }
        self.kept
    }

    /// One part more is kept.
    fn keep(&mut self) {
        self.kept += 1;
    }

    /// All parts are kept.
    fn end(&mut self, scene: &Arc<Scene>) {
        self.scene = Some(scene.clone());
    }

    /// A scene cannot be announced: nothing more is said of it until the server was away.
    fn give_up(&mut self, scene: &Arc<Scene>) {
        *self = Self { scene: Some(scene.clone()), ..Self::default() };
    }
}

impl Fleet {
    /// Says what this edge is, in parts. What is kept already is not said again, so that a slow line comes to an end with it.
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
            // The next is sent once this one is kept: a centre that hears the last finds all of them.
            match link.send(&[part]).await {
                Err((_, LinkError::TooLarge(bytes))) => {
                    tracing::error!(
                        bytes,
                        "the centre does not know this edge's loops: max_payload of the NATS servers is too small"
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
