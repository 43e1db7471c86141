//! Which lists of loops a centre has taken, and which it has yet to fetch. Pure: the caller receives messages and fetches parts.

use crate::fleet::announcement::{Announcement, Heard};
use crate::fleet::subject::Subject;
use prost::bytes::Bytes;
use std::collections::{HashMap, HashSet, VecDeque};

/// Most lists that wait to be fetched, and most that have come in part: a centre shows as many machines.
const MOST: usize = 10_000;

/// The state of the lists of all edges.
#[derive(Default)]
pub(super) struct Lists {
    /// Digest of the list that was taken, by edge.
    taken: HashMap<Subject, Vec<u8>>,
    /// Lists whose last part was heard and that are not fetched yet, at most one for each edge. Only the first may hold parts,
    /// because a list is large.
    waiting: VecDeque<Announcement>,
    /// Edges of whose new list some parts were heard, but not the last.
    begun: HashSet<Subject>,
    /// When the stream took the last part that was heard of each edge (s, by the server's clock).
    announced: HashMap<Subject, f64>,
}

impl Lists {
    /// Whether a list has to be fetched before more messages are read.
    pub(super) fn is_full(&self) -> bool {
        self.waiting.len() >= MOST
    }

    /// Takes a message of an announcement, which the stream took at `at` (s). Returns the edge if it is the last part.
    pub(super) fn hear(&mut self, subject: &str, bytes: impl Into<Bytes>, at: f64) -> Option<Subject> {
        match Heard::read(subject, bytes)? {
            Heard::Part(edge, whole) => {
                if self.taken.get(&edge).is_some_and(|taken| *taken == whole) {
                    self.begun.remove(&edge);
                } else if self.begun.len() < MOST {
                    self.begun.insert(edge);
                }
                None
            }
            Heard::Last(new) => {
                let edge = new.edge().clone();
                if self.announced.len() < MOST || self.announced.contains_key(&edge) {
                    self.announced.insert(edge.clone(), at);
                }
                self.hear_last(new);
                Some(edge)
            }
        }
    }

    /// When the stream took the last part that was heard of an edge (s).
    pub(super) fn announced(&self, edge: &Subject) -> f64 {
        self.announced.get(edge).copied().unwrap_or_default()
    }

    fn hear_last(&mut self, new: Announcement) {
        self.begun.remove(new.edge());
        let same = self.waiting.iter().position(|own| own.edge() == new.edge());
        if let Some(own) = same.and_then(|at| self.waiting.get_mut(at)) {
            // A list that is announced again keeps the parts that were fetched.
            if own.digest() != new.digest() {
                *own = new;
            }
        } else if self.taken.get(new.edge()).is_none_or(|taken| taken != new.digest()) {
            self.waiting.push_back(new);
        }
    }

    /// Removes the list that is to be fetched next. If that fails, the caller [puts it back](Self::put_back).
    pub(super) fn next(&mut self) -> Option<Announcement> {
        self.waiting.pop_front()
    }

    /// The list of an edge was taken.
    pub(super) fn took(&mut self, edge: Subject, digest: Vec<u8>) {
        self.taken.insert(edge, digest);
    }

    /// Takes back a list that could not be fetched to its end. If more of its parts were fetched than before (`has_more`), it comes
    /// next again. Otherwise the other lists come first, so that it does not hold them up.
    pub(super) fn put_back(&mut self, mut own: Announcement, has_more: bool) {
        if has_more || self.waiting.is_empty() {
            self.waiting.push_front(own);
        } else {
            own.forget();
            self.waiting.push_back(own);
        }
    }

    /// Whether no list waits to be fetched.
    pub(super) fn are_fetched(&self) -> bool {
        self.waiting.is_empty()
    }

    /// Sites of which a list has come in part only, or has yet to be fetched.
    pub(super) fn unsettled(&self) -> HashSet<&str> {
        let waiting = self.waiting.iter().map(Announcement::edge);
        waiting.chain(&self.begun).map(|edge| edge.site.as_str()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fleet::announcement::split;
    use crate::fleet::link::Outgoing;
    use crate::fleet::subject::What;

    fn edge(site: &str, name: &str) -> Subject {
        Subject::new(site, name, What::Hello)
    }

    /// A list of several parts, which has these bytes.
    fn announced(edge: &Subject, byte: u8) -> Vec<Outgoing> {
        let messages = split(edge, &vec![byte; 300_000]);
        assert!(messages.len() > 2, "{} parts", messages.len());
        messages
    }

    fn hear(lists: &mut Lists, messages: &[Outgoing]) {
        messages.iter().for_each(|own| drop(lists.hear(&own.subject, own.body.clone(), 100.0)));
    }

    /// Edges in the order in which they wait, with the parts that were fetched of their lists.
    fn waiting(lists: &Lists) -> Vec<(&str, u32)> {
        lists.waiting.iter().map(|own| (own.edge().name.as_str(), own.fetched())).collect()
    }

    #[test]
    fn a_site_is_unsettled_until_what_its_edge_announces_is_taken() {
        let (mut lists, e1) = (Lists::default(), edge("north", "e1"));
        let messages = announced(&e1, b'x');
        let (last, others) = messages.split_last().expect("there are parts");
        assert!(lists.unsettled().is_empty());
        hear(&mut lists, others);
        assert_eq!((lists.unsettled(), lists.are_fetched()), (HashSet::from(["north"]), true));
        hear(&mut lists, std::slice::from_ref(last));
        assert_eq!((lists.unsettled(), lists.are_fetched()), (HashSet::from(["north"]), false));
        let own = lists.next().expect("it waits");
        lists.took(e1.clone(), own.digest().to_vec());
        assert!(lists.unsettled().is_empty() && lists.are_fetched());
        // The same again is no news, and of another one the first part is enough.
        hear(&mut lists, &messages);
        assert!(lists.unsettled().is_empty() && lists.are_fetched());
        hear(&mut lists, &announced(&e1, b'y')[..1]);
        assert_eq!(lists.unsettled(), HashSet::from(["north"]));
        hear(&mut lists, &messages[..1]);
        assert!(lists.unsettled().is_empty(), "it announces the one of before");
    }

    #[test]
    fn a_list_that_cannot_be_fetched_goes_on_where_it_was_and_holds_up_no_other() {
        let mut lists = Lists::default();
        let [e1, e2] = [edge("north", "e1"), edge("east", "e2")];
        let first = announced(&e1, b'x');
        hear(&mut lists, &first);
        hear(&mut lists, &announced(&e2, b'x'));
        assert_eq!(waiting(&lists), [("e1", 0), ("e2", 0)]);
        // A part of it came before the line failed.
        let mut own = lists.next().expect("it waits");
        assert!(own.push(Some(first[0].body.clone())));
        lists.put_back(own, true);
        // It is announced again meanwhile.
        hear(&mut lists, &first);
        assert_eq!(waiting(&lists), [("e1", 1), ("e2", 0)]);
        let own = lists.next().expect("it waits");
        assert_eq!(own.next_subject(), Some(e1.part(1)));
        // Nothing came of it.
        lists.put_back(own, false);
        assert_eq!(waiting(&lists), [("e2", 0), ("e1", 0)]);
        assert_eq!(lists.next().expect("it waits").edge(), &e2);
        // Where it is the only one it keeps what it has.
        let mut own = lists.next().expect("it waits");
        assert!(own.push(Some(first[0].body.clone())));
        lists.put_back(own, false);
        assert_eq!(waiting(&lists), [("e1", 1)]);
    }

    #[test]
    fn an_edge_that_announces_the_same_list_again_has_announced_itself_then() {
        let (mut lists, e1) = (Lists::default(), edge("north", "e1"));
        let messages = announced(&e1, b'x');
        hear(&mut lists, &messages);
        let own = lists.next().expect("it waits");
        lists.took(e1.clone(), own.digest().to_vec());
        assert_eq!(lists.announced(&e1), 100.0);
        let again = |own: &Outgoing| lists.hear(&own.subject, own.body.clone(), 200.0);
        let edges: Vec<Option<Subject>> = messages.iter().map(again).collect();
        let (last, others) = edges.split_last().expect("there are parts");
        assert!(last.as_ref() == Some(&e1) && others.iter().all(Option::is_none));
        assert_eq!(lists.announced(&e1), 200.0);
        assert!(lists.are_fetched(), "it is no news");
    }

    #[test]
    fn another_list_of_an_edge_replaces_the_one_that_waits() {
        let (mut lists, e1) = (Lists::default(), edge("north", "e1"));
        let [old, new] = [b'x', b'y'].map(|byte| announced(&e1, byte));
        hear(&mut lists, &old);
        let mut own = lists.next().expect("it waits");
        assert!(own.push(Some(old[0].body.clone())));
        lists.put_back(own, true);
        hear(&mut lists, &new);
        assert_eq!(waiting(&lists), [("e1", 0)]);
        assert!(lists.next().expect("it waits").push(Some(new[0].body.clone())));
        assert!(lists.next().is_none());
    }
}
