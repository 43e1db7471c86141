//! Whose loops they are: which edges count, and which of them has a loop that several edges of a site announce. Pure.

use crate::fleet::message::Hello;
use crate::fleet::subject::split;
use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// An edge, by its site and its name.
pub(super) type Key = (String, String);

/// An edge that has said nothing for longer (s) counts as stopped: another that has the same loops takes its place. It says each
/// 5 s that it is there.
const STOPPED_S: f64 = 60.0;
/// A machine that has said nothing for longer (s) is forgotten, and with an edge its loops. A reader of a stream is, too.
pub(super) const FORGOTTEN_S: f64 = 7.0 * 86_400.0;

/// An edge that has announced itself.
pub(super) struct Edge {
    pub(super) hello: Hello,
    /// When the stream took the last part of that (s, by the server's clock).
    pub(super) announced: f64,
}

/// The edges that have announced themselves.
pub(super) type Edges = BTreeMap<Key, Edge>;

/// When machines said last that they are there (s, by the server's clock).
#[derive(Default)]
pub(super) struct Signs {
    /// Each edge.
    pub(super) heard: HashMap<Key, f64>,
    /// Any machine. `None` before all were heard that the stream has: until then every edge counts as being there.
    pub(super) now: Option<f64>,
    /// The first one after none was heard for a while, because the server was away: no edge could say anything before that.
    pub(super) resumed: f64,
    /// The last one before that.
    pub(super) paused: f64,
}

impl Signs {
    /// For how long an edge has said nothing (s) that was heard last at `heard`, without the time in which the server was away: one
    /// that had stopped before that is stopped after it.
    fn silent_s(&self, heard: f64) -> f64 {
        let silent_s = |now: f64| match heard >= self.resumed {
            true => now - heard,
            false => now - self.resumed + (self.paused - heard).max(0.0),
        };
        self.now.map_or(0.0, silent_s)
    }
}

/// The edges that are not forgotten, site by site, those first that have the first claim to a loop: they are there, and
/// announced themselves last.
pub(super) fn ranked<'e>(edges: &'e Edges, signs: &Signs) -> Vec<(&'e Key, &'e Edge)> {
    // An announcement of long after the last sign was made before the server's clock was set back.
    let is_past = |at: f64| signs.now.is_none_or(|now| at < now + STOPPED_S);
    let heard = |key: &Key, edge: &Edge| {
        let announced = Some(edge.announced).filter(|at| is_past(*at));
        let said = signs.heard.get(key).copied().into_iter().chain(announced);
        // One that has only announced itself, and that in the future, may be there.
        said.reduce(f64::max).unwrap_or_else(|| signs.now.unwrap_or_default() - STOPPED_S)
    };
    let is_remembered = |heard: f64| signs.now.is_none_or(|now| now - heard.max(signs.resumed) < FORGOTTEN_S);
    let all = edges.iter().map(|(key, edge)| (heard(key, edge), key, edge));
    let mut all: Vec<_> = all.filter(|(heard, ..)| is_remembered(*heard)).collect();
    // Of those that have stopped the one comes first that stopped last: none has said anything yet where the server was away.
    let stopped_at = |heard: f64| (signs.silent_s(heard) >= STOPPED_S).then_some(-heard);
    all.sort_by(|(one_at, one_key, one), (other_at, other_key, other)| {
        let [one_stopped, other_stopped] = [*one_at, *other_at].map(stopped_at);
        let both = one_stopped.zip(other_stopped);
        let by_site = one_key.0.cmp(&other_key.0);
        by_site
            .then(one_stopped.is_some().cmp(&other_stopped.is_some()))
            .then(both.map_or(Ordering::Equal, |(one, other)| one.total_cmp(&other)))
            .then(other.announced.total_cmp(&one.announced))
            .then(one_key.1.cmp(&other_key.1))
    });
    all.into_iter().map(|(_, key, edge)| (key, edge)).collect()
}

/// A loop or collector that several edges of a site have.
struct Contested {
    /// The edge that it is taken from.
    owner: String,
    /// When that announced itself (s, by the server's clock): what others said before is of when it was theirs.
    since: f64,
    /// The other edges.
    others: Vec<String>,
}

/// Whose loops and collectors they are in the configuration in force.
#[derive(Default)]
pub(super) struct Claims {
    /// By the name with the site, those that several edges have.
    contested: HashMap<String, Contested>,
    /// All edges that are not forgotten.
    edges: BTreeSet<Key>,
    /// Those of them that have something that another has, too.
    rivals: BTreeSet<Key>,
    /// The same in their order.
    order: Vec<Key>,
}

impl Claims {
    /// What is called `id` with its site is taken from `owner`, and another edge has it, too.
    pub(super) fn contest(&mut self, id: &str, owner: (&Key, &Edge), other: &Key) {
        let (key, edge) = owner;
        if key == other {
            return;
        }
        let new = || Contested { owner: key.1.clone(), since: edge.announced, others: Vec::new() };
        self.contested.entry(id.to_string()).or_insert_with(new).others.push(other.1.clone());
        for rival in [key, other] {
            if !self.rivals.contains(rival) {
                self.rivals.insert(rival.clone());
            }
        }
    }

    /// These are all edges, in their order, and everything is known that several of them have.
    pub(super) fn of_all(mut self, ranked: &[(&Key, &Edge)]) -> Self {
        self.edges = ranked.iter().map(|(key, _)| (*key).clone()).collect();
        self.order = self.order_of(ranked);
        self
    }

    fn order_of(&self, ranked: &[(&Key, &Edge)]) -> Vec<Key> {
        let rivals = ranked.iter().map(|(key, _)| *key).filter(|key| self.rivals.contains(*key));
        rivals.cloned().collect()
    }

    /// Whether an edge is forgotten, came back, or takes the place of another since.
    pub(super) fn are_outdated(&self, ranked: &[(&Key, &Edge)]) -> bool {
        let is_new = |(key, _): &(&Key, &Edge)| !self.edges.contains(*key);
        ranked.len() != self.edges.len() || ranked.iter().any(is_new) || self.order_of(ranked) != self.order
    }

    /// Whether what `edge` says of a loop or collector is left out, in a message that its stream took at `taken_at` (s): another
    /// edge has it. Edges that do not say which they are, are believed.
    pub(super) fn is_foreign(&self, id: &str, edge: &str, taken_at: Option<f64>) -> bool {
        let Some(own) = self.contested.get(id) else { return false };
        own.others.iter().any(|other| other == edge) && taken_at.is_none_or(|at| at >= own.since)
    }

    /// Whether what `edge` says of how the alarms of `id` at `site` stand is taken, in a message that its stream took at `taken_at`
    /// (s). The stream keeps it for ever, so it says nothing where the edge is forgotten, or not known yet.
    pub(super) fn is_state_taken(&self, (site, id): (&str, &str), edge: &str, taken_at: Option<f64>) -> bool {
        let is_known = edge.is_empty() || self.edges.contains(&(site.to_string(), edge.to_string()));
        is_known && !self.is_foreign(id, edge, taken_at)
    }

    /// The edge that a loop or collector is taken from, where several have it.
    pub(super) fn owner(&self, id: &str) -> Option<&str> {
        self.contested.get(id).map(|own| own.owner.as_str())
    }

    /// What is left out because another edge has it, a line for each two edges.
    pub(super) fn remarks(&self) -> Vec<String> {
        let mut pairs = BTreeMap::<(&str, &str, &str), (usize, &str)>::new();
        for (id, own) in &self.contested {
            let site = split(id).map_or("", |(site, _)| site);
            for other in &own.others {
                let pair = (site, other.as_str(), own.owner.as_str());
                let (count, first) = pairs.entry(pair).or_insert((0, id.as_str()));
                (*count, *first) = (*count + 1, id.as_str().min(*first));
            }
        }
        let line = |((site, other, owner), (count, first)): ((&str, &str, &str), (usize, &str))| {
            format!(
                "the edges {owner} and {other} of {site} both have {first} and {} more loops or collectors: they are taken from {owner}, and what {other} says of them is left out",
                count - 1
            )
        };
        pairs.into_iter().map(line).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Edges of one site, each with when it announced itself.
    fn edges(all: &[(&str, f64)]) -> Edges {
        let edge = |(name, announced): &(&str, f64)| {
            let edge = Edge { hello: Hello::default(), announced: *announced };
            (("north".to_string(), (*name).to_string()), edge)
        };
        all.iter().map(edge).collect()
    }

    fn signs(heard: &[(&str, f64)], now: f64) -> Signs {
        let own = |(name, at): &(&str, f64)| (("north".to_string(), (*name).to_string()), *at);
        Signs { heard: heard.iter().map(own).collect(), now: Some(now), ..Signs::default() }
    }

    fn names<'e>(ranked: &[(&'e Key, &'e Edge)]) -> Vec<&'e str> {
        ranked.iter().map(|(key, _)| key.1.as_str()).collect()
    }

    /// The claims of edges that all have the loop `north:FIC1`.
    fn claims(ranked: &[(&Key, &Edge)]) -> Claims {
        let (first, others) = ranked.split_first().expect("there are edges");
        let mut claims = Claims::default();
        others.iter().for_each(|(key, _)| claims.contest("north:FIC1", *first, key));
        claims.of_all(ranked)
    }

    #[test]
    fn of_those_that_are_there_the_one_comes_first_that_announced_itself_last() {
        let edges = edges(&[("a", 100.0), ("b", 300.0), ("c", 200.0)]);
        let at = |heard: &[(&str, f64)], now: f64| names(&ranked(&edges, &signs(heard, now)));
        assert_eq!(names(&ranked(&edges, &Signs::default())), ["b", "c", "a"], "none was heard yet");
        let all = [("a", 1000.0), ("b", 1000.0), ("c", 1000.0)];
        assert_eq!(at(&all, 1059.0), ["b", "c", "a"]);
        assert_eq!(
            at(&[("a", 1060.0), ("b", 1000.0), ("c", 1060.0)], 1060.0),
            ["c", "a", "b"],
            "b is stopped"
        );
        // A week later.
        let week = 1000.0 + FORGOTTEN_S;
        assert_eq!(at(&[("a", week), ("b", 1000.0), ("c", 1001.0)], week), ["a", "c"], "b is forgotten");
        // For that week the server was away.
        let away = Signs { resumed: week, paused: 1000.0, ..signs(&all, week) };
        assert_eq!(names(&ranked(&edges, &away)), ["b", "c", "a"]);
        // Then b had been stopped before that, and a was heard until then.
        let heard = [("a", 1000.0), ("b", 900.0), ("c", 940.0)];
        let away = Signs { resumed: week, paused: 1000.0, ..signs(&heard, week + 1.0) };
        assert_eq!(names(&ranked(&edges, &away)), ["a", "c", "b"]);
        // The server's clock was set back by an hour, and b has said nothing since.
        let set_back = signs(&[("a", 290.0), ("b", 100.0), ("c", 290.0)], 290.0);
        let edges = self::edges(&[("a", 100.0), ("b", 3900.0), ("c", 200.0)]);
        assert_eq!(names(&ranked(&edges, &set_back)), ["c", "a", "b"]);
    }

    #[test]
    fn what_another_edge_says_of_a_loop_is_left_out_once_the_owner_has_announced_itself() {
        let edges = edges(&[("a", 100.0), ("b", 300.0)]);
        let claims = claims(&ranked(&edges, &Signs::default()));
        assert_eq!(claims.owner("north:FIC1"), Some("b"));
        let is_foreign = |edge, at| claims.is_foreign("north:FIC1", edge, at);
        assert!(is_foreign("a", Some(300.0)) && is_foreign("a", None));
        assert!(!is_foreign("a", Some(299.0)), "it was its loop then");
        assert!(!is_foreign("b", Some(400.0)) && !is_foreign("", Some(400.0)));
        assert!(!is_foreign("c", Some(400.0)), "it may be about to announce itself");
        let is_state_taken = |edge, at| claims.is_state_taken(("north", "north:FIC1"), edge, Some(at));
        assert!(is_state_taken("b", 400.0) && is_state_taken("a", 299.0) && is_state_taken("", 400.0));
        assert!(!is_state_taken("a", 400.0) && !is_state_taken("c", 400.0), "they are read again later");
        assert!(!claims.is_foreign("north:FIC2", "a", Some(400.0)) && claims.owner("north:FIC2").is_none());
        assert_eq!(
            claims.remarks(),
            [
                "the edges b and a of north both have north:FIC1 and 0 more loops or collectors: they are taken from b, and what a says of them is left out"
            ]
        );
    }

    #[test]
    fn a_loop_changes_hands_when_its_edge_stops_or_another_is_new() {
        let mut edges = edges(&[("a", 100.0), ("b", 300.0)]);
        let all = [("a", 1000.0), ("b", 1000.0)];
        let before = claims(&ranked(&edges, &signs(&all, 1000.0)));
        assert!(!before.are_outdated(&ranked(&edges, &signs(&all, 1010.0))));
        let stopped = signs(&[("a", 1100.0), ("b", 1000.0)], 1100.0);
        assert!(before.are_outdated(&ranked(&edges, &stopped)), "b has stopped");
        assert!(!claims(&ranked(&edges, &stopped)).are_outdated(&ranked(&edges, &stopped)));
        if let Some(edge) = edges.get_mut(&("north".to_string(), "a".to_string())) {
            edge.announced = 1000.0;
        }
        assert!(before.are_outdated(&ranked(&edges, &signs(&all, 1010.0))), "a has announced itself again");
        // Of edges that have nothing in common the order does not matter, but a new one does.
        let apart = Claims::default().of_all(&ranked(&edges, &signs(&all, 1000.0)));
        assert!(!apart.are_outdated(&ranked(&edges, &stopped)));
        edges.insert(("east".into(), "a".into()), Edge { hello: Hello::default(), announced: 1.0 });
        assert!(apart.are_outdated(&ranked(&edges, &signs(&all, 1000.0))));
    }
}
