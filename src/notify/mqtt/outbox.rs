//! The latest message of each topic, until the broker has taken it. Pure and bounded.

use std::collections::{HashMap, HashSet, VecDeque};

/// Messages by topic. A newer one takes the place of an older one: what matters of a loop is how it is now.
#[derive(Debug)]
pub(super) struct Outbox {
    most: usize,
    by_topic: HashMap<String, Entry>,
    /// Topics that wait to be sent, each once, the longest waiting first.
    waiting: VecDeque<String>,
    /// Topics that the broker has emptied: they are kept while there is room, in case that it forgets it.
    emptied: HashSet<String>,
}

#[derive(Debug)]
struct Entry {
    payload: Vec<u8>,
    version: u64,
    waits: bool,
}

impl Outbox {
    pub(super) fn new(most: usize) -> Self {
        Self { most, by_topic: HashMap::new(), waiting: VecDeque::new(), emptied: HashSet::new() }
    }

    /// Takes a message; false when there is no room for another topic.
    pub(super) fn put(&mut self, topic: &str, payload: Vec<u8>) -> bool {
        if let Some(entry) = self.by_topic.get_mut(topic) {
            if entry.payload != payload {
                (entry.payload, entry.version) = (payload, entry.version + 1);
                self.emptied.remove(topic);
                if !std::mem::replace(&mut entry.waits, true) {
                    self.waiting.push_back(topic.into());
                }
            }
            return true;
        }
        if self.by_topic.len() >= self.most && !self.forget_emptied() {
            return false;
        }
        self.by_topic.insert(topic.into(), Entry { payload, version: 0, waits: true });
        self.waiting.push_back(topic.into());
        true
    }

    /// The next message to send, with its version; it waits no longer.
    pub(super) fn next(&mut self) -> Option<(String, u64, Vec<u8>)> {
        while let Some(topic) = self.waiting.pop_front() {
            if let Some(entry) = self.by_topic.get_mut(&topic) {
                entry.waits = false;
                return Some((topic, entry.version, entry.payload.clone()));
            }
        }
        None
    }

    /// How many wait.
    pub(super) fn waiting(&self) -> usize {
        self.waiting.len()
    }

    /// A topic that the broker has emptied makes room for another; false where there is none.
    fn forget_emptied(&mut self) -> bool {
        let Some(topic) = self.emptied.iter().next().cloned() else { return false };
        self.emptied.remove(&topic);
        self.by_topic.remove(&topic);
        true
    }

    /// The broker has taken a message.
    pub(super) fn taken(&mut self, topic: &str, version: u64) {
        let latest = self.by_topic.get(topic).filter(|entry| entry.version == version && !entry.waits);
        if latest.is_some_and(|entry| entry.payload.is_empty()) {
            self.emptied.insert(topic.into());
        }
    }

    /// A message was not taken after all: unless there is a newer one, it waits again.
    pub(super) fn failed(&mut self, topic: &str, version: u64) {
        if let Some(entry) = self.by_topic.get_mut(topic)
            && entry.version == version
            && !std::mem::replace(&mut entry.waits, true)
        {
            self.waiting.push_back(topic.into());
        }
    }

    /// Everything is to be sent once more: a broker that was started again may have forgotten what it had.
    pub(super) fn again(&mut self) {
        let mut topics: Vec<String> = self.by_topic.keys().cloned().collect();
        topics.sort_unstable();
        self.by_topic.values_mut().for_each(|entry| entry.waits = true);
        self.waiting = topics.into();
        self.emptied.clear();
    }

    /// Empties all topics but these: an empty message takes the one that the broker keeps away.
    pub(super) fn empty_all_but(&mut self, wanted: impl Fn(&str) -> bool) {
        let gone: Vec<String> = self.by_topic.keys().filter(|topic| !wanted(topic)).cloned().collect();
        for topic in gone {
            self.put(&topic, Vec::new());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_latest_takes_the_place_of_the_one_before() {
        let mut outbox = Outbox::new(2);
        assert!(outbox.put("a", vec![1]) && outbox.put("b", vec![2]) && outbox.put("a", vec![3]));
        assert!(!outbox.put("c", vec![4]), "no room");
        assert_eq!(outbox.next(), Some(("a".into(), 1, vec![3])));
        outbox.put("a", vec![5]);
        outbox.failed("a", 1);
        assert_eq!(outbox.next(), Some(("b".into(), 0, vec![2])));
        assert_eq!(outbox.next(), Some(("a".into(), 2, vec![5])));
        assert_eq!(outbox.next(), None);
        outbox.put("a", vec![5]);
        assert_eq!(outbox.next(), None, "nothing new");
        outbox.again();
        assert_eq!(outbox.next().map(|(topic, ..)| topic), Some("a".into()));
        outbox.empty_all_but(|topic| topic == "a");
        assert_eq!(outbox.next(), Some(("b".into(), 1, vec![])));
        assert_eq!(outbox.next(), None);
    }

    #[test]
    fn topics_that_the_broker_has_emptied_make_room_for_others() {
        let mut outbox = Outbox::new(2);
        assert!(outbox.put("a", vec![1]) && outbox.put("b", vec![2]));
        while let Some((topic, version, _)) = outbox.next() {
            outbox.taken(&topic, version);
        }
        outbox.empty_all_but(|_| false);
        assert!(!outbox.put("c", vec![3]), "the broker still has the others");
        let (first, version, _) = outbox.next().expect("it waits");
        outbox.taken(&first, version - 1);
        assert!(!outbox.put("c", vec![3]), "it has taken what was there before");
        outbox.taken(&first, version);
        assert!(outbox.put("c", vec![3]) && !outbox.put("d", vec![4]), "one for one");

        // One that has something again is none of them.
        let (second, version, _) = outbox.next().expect("it waits");
        outbox.taken(&second, version);
        assert!(outbox.put(&second, vec![5]) && !outbox.put("d", vec![4]));
        let left: Vec<String> = std::iter::from_fn(|| outbox.next()).map(|(topic, ..)| topic).collect();
        assert_eq!(left, ["c".to_string(), second]);
    }

    proptest! {
        /// Whatever fails on the way: in the end the broker has the latest of every topic, and no more is kept than allowed.
        #[test]
        fn the_latest_of_each_topic_arrives(
            steps in prop::collection::vec((0u8..6, any::<u8>(), any::<bool>()), 0..200),
        ) {
            let mut outbox = Outbox::new(4);
            let (mut put, mut there) = (HashMap::new(), HashMap::new());
            for (topic, payload, fails) in steps {
                let name = topic.to_string();
                if outbox.put(&name, vec![payload]) {
                    put.insert(name, vec![payload]);
                }
                prop_assert!(outbox.by_topic.len() <= 4 && outbox.waiting.len() <= 4);
                if payload % 3 == 0 && let Some((topic, version, payload)) = outbox.next() {
                    if fails {
                        outbox.failed(&topic, version);
                    } else {
                        there.insert(topic, payload);
                    }
                }
            }
            while let Some((topic, _, payload)) = outbox.next() {
                there.insert(topic, payload);
            }
            prop_assert_eq!(put, there);
        }
    }
}
