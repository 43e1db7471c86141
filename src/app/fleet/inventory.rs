//! The list of loops that an edge announces, how a centre fetches and takes it, and the configuration that a centre makes of all
//! lists.

use super::claims::{Claims, Edge, Key, ranked};
use super::lists::Lists;
use super::{Fleet, Scene, lock};
use crate::config::{Config, ForwardedTag, LoopConfig, TagConfig, tags};
use crate::fleet::announcement::Announcement;
use crate::fleet::link::{Link, LinkError};
use crate::fleet::message::{Hello, Loop, Tag};
use crate::fleet::streams::LATEST;
use crate::fleet::subject::{Subject, of_site};
use crate::signal::{LoopId, Role};
use crate::work::CostConfig;
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};

/// Most loops that a centre takes.
const MAX_LOOPS: usize = 100_000;
/// Longest name of a loop with its site (characters).
const MAX_NAME: usize = 160;

/// The list that an edge announces: its loops and its collectors.
pub(super) fn hello(scene: &Scene, collectors: Vec<String>) -> Hello {
    let config = &scene.config;
    let described = |own: &LoopConfig| Loop {
        id: own.id.clone(),
        description: own.description.clone(),
        group: own.group.clone(),
        period_s: config.period_s(own),
        op_span: own.op_span,
        op_low: own.op_limits.map(|[low, _]| low),
        op_high: own.op_limits.map(|[_, high]| high),
        tags: sources(scene, own),
        upstream: own.upstream.clone(),
        cost_per_sd: own.cost.as_ref().map(|cost| cost.per_sd),
        cost_unit: own.cost.as_ref().map(|cost| cost.unit.clone()).unwrap_or_default(),
    };
    Hello { loops: config.loops.iter().map(described).collect(), collectors }
}

/// A loop's tags, but for the term of write-back, which never leaves the edge.
fn sources(scene: &Scene, own: &LoopConfig) -> Vec<Tag> {
    let id = LoopId::new(own.id.as_str());
    let known: Vec<_> = scene.history.latest(&id).into_iter().map(|(spec, _)| spec).collect();
    let tag = |(role, tag): (Option<Role>, &TagConfig)| {
        let name = role.map(Role::as_str).or(tag.name())?;
        let spec = known.iter().find(|spec| spec.kind.name() == name)?;
        Some(Tag {
            name: name.to_string(),
            source: spec.source.clone(),
            unit: spec.unit.clone(),
            collector: tag.device().to_string(),
        })
    };
    tags(own).filter_map(tag).collect()
}

impl Fleet {
    /// Fetches and takes the lists that wait, one after the other. Returns whether an edge has other loops than before, and the
    /// error that ended it, if any. The lists before the error are taken, so they count; the others still wait.
    pub(super) async fn fetch_lists(&self, link: &Link, lists: &mut Lists) -> (bool, Result<(), LinkError>) {
        let mut is_changed = false;
        while let Some(mut announcement) = lists.next() {
            let before = announcement.fetched();
            match fetch(link, &mut announcement).await {
                Ok(true) => {
                    let (edge, digest) = (announcement.edge().clone(), announcement.digest().to_vec());
                    if let Some(hello) = announcement.list() {
                        is_changed |= self.take_list(&edge, hello, lists.announced(&edge));
                        lists.took(edge, digest);
                    }
                }
                Ok(false) => {}
                Err(error) => {
                    let has_more = announcement.fetched() > before;
                    lists.put_back(announcement, has_more);
                    return (is_changed, Err(error));
                }
            }
        }
        (is_changed, Ok(()))
    }

    /// Takes sites out of force of which a list has come in part only, or has yet to be fetched.
    pub(super) fn unsettle(&self, lists: &Lists) {
        let mut in_force = lock(&self.in_force);
        for site in lists.unsettled() {
            in_force.remove(site);
        }
    }

    /// Puts sites in force, except those of which a list has come in part only, or has yet to be fetched. Once no list waits, the
    /// centre also begins to take samples, diagnoses and alarms.
    ///
    /// To be called when the configuration has all lists that were taken, and all messages were heard that were in the stream at
    /// the start.
    pub(super) fn settle_sites(&self, lists: &Lists) {
        let (now, unsettled) = (self.clock.elapsed(), lists.unsettled());
        {
            let edges = lock(&self.edges);
            let mut in_force = lock(&self.in_force);
            for (site, _) in edges.keys().filter(|(site, _)| !unsettled.contains(site.as_str())) {
                in_force.entry(site.clone()).or_insert(now);
            }
        }
        self.known.send_if_modified(|known| {
            let first = known.is_none() && lists.are_fetched();
            first.then(|| *known = Some(now)).is_some()
        });
    }

    /// Takes the list of an edge, which announced it at `announced` (s). Returns whether that changes anything.
    fn take_list(&self, edge: &Subject, hello: Hello, announced: f64) -> bool {
        let key = (edge.site.clone(), edge.name.clone());
        let mut edges = lock(&self.edges);
        // One that has no loops any more is forgotten.
        let is_new = if hello.loops.is_empty() {
            edges.remove(&key).is_some()
        } else {
            edges.insert(key, Edge { hello, announced });
            true
        };
        if is_new {
            lock(&self.in_force).remove(&edge.site);
        }
        is_new
    }

    /// An edge has announced itself at `announced` (s), be it with the list that was taken before.
    pub(super) fn renew(&self, edge: &Subject, announced: f64) {
        if let Some(own) = lock(&self.edges).get_mut(&(edge.site.clone(), edge.name.clone())) {
            own.announced = announced.max(own.announced);
        }
    }

    /// Whether loops have to be taken from other edges than those in force: an edge has stopped, or is forgotten.
    pub(super) fn are_claims_outdated(&self) -> bool {
        let signs = self.signs();
        let edges = lock(&self.edges);
        lock(&self.claims).are_outdated(&ranked(&edges, &signs))
    }
}

/// Fetches the remaining parts of an announcement. Returns false if one of them is missing or belongs to another announcement.
async fn fetch(link: &Link, announcement: &mut Announcement) -> Result<bool, LinkError> {
    while let Some(subject) = announcement.next_subject() {
        let last = link.last(LATEST, &subject).await?;
        if !announcement.push(last.map(|(_, body)| body)) {
            return Ok(false);
        }
    }
    Ok(true)
}

/// The configuration of a centre with the loops of all edges.
pub(super) struct Composed {
    pub(super) config: Config,
    pub(super) claims: Claims,
    /// What cannot be taken, and why.
    pub(super) left: Vec<String>,
}

/// The configuration of a centre with the loops of all edges, in the order of their names. What several edges of a site have is
/// taken from the first of them; a collector counts as the same where they have a loop in common. What cannot be taken is left out
/// and told.
pub(super) fn composed(base: &Config, ranked: &[(&Key, &Edge)]) -> Composed {
    let (mut loops, mut collectors, mut left) = (BTreeMap::new(), BTreeMap::new(), Vec::new());
    let (mut claims, mut rivals) = (Claims::default(), BTreeSet::new());
    for &(key, edge) in ranked {
        let (site, name) = key;
        for own in &edge.hello.loops {
            let id = of_site(site, &own.id);
            let many = loops.len() == MAX_LOOPS || id.chars().count() > MAX_NAME;
            match (loops.entry(id), many) {
                (Entry::Occupied(place), _) => {
                    let (_, owner): &(LoopConfig, (&Key, &Edge)) = place.get();
                    claims.contest(place.key(), *owner, key);
                    rivals.insert((owner.0, key));
                }
                (Entry::Vacant(place), true) => {
                    left.push(format!("{} of {name}: too many loops, or too long a name", place.key()));
                }
                (Entry::Vacant(place), _) => match loop_config(site, place.key(), own) {
                    Some(config) => {
                        place.insert((config, (key, edge)));
                    }
                    None => left.push(format!("{} of {name}: it has no op or no pv", place.key())),
                },
            }
        }
    }
    for &(key, edge) in ranked {
        for collector in &edge.hello.collectors {
            match collectors.entry(of_site(&key.0, collector)) {
                Entry::Occupied(place) => {
                    let owner: &(&Key, &Edge) = place.get();
                    if rivals.contains(&(owner.0, key)) {
                        claims.contest(place.key(), *owner, key);
                    }
                }
                Entry::Vacant(place) => {
                    place.insert((key, edge));
                }
            }
        }
    }
    let loops = loops.into_values().map(|(config, _)| config).collect();
    let config = Config { loops, forwarded: collectors.into_keys().collect(), ..base.clone() };
    Composed { config, claims: claims.of_all(ranked), left }
}

fn loop_config(site: &str, id: &str, own: &Loop) -> Option<LoopConfig> {
    let forwarded = |tag: &Tag, name: Option<String>| {
        TagConfig::Forwarded(ForwardedTag {
            name,
            device: of_site(site, &tag.collector),
            source: tag.source.clone(),
            unit: Some(tag.unit.clone()).filter(|unit| !unit.is_empty()),
        })
    };
    let role = |role: Role| {
        let tag = own.tags.iter().find(|tag| tag.name == role.as_str())?;
        Some(forwarded(tag, None))
    };
    let roles = [Role::Op, Role::Pv, Role::Sp, Role::Mode, Role::Mv, Role::Term].map(Role::as_str);
    let others = own.tags.iter().filter(|tag| !roles.contains(&tag.name.as_str()));
    let cost = |per_sd| CostConfig { per_sd, unit: own.cost_unit.clone() };
    let limits = own.op_low.zip(own.op_high).map(|(low, high)| [low, high]);
    Some(LoopConfig {
        id: id.to_string(),
        description: own.description.clone(),
        group: if own.group.is_empty() { site.to_string() } else { format!("{site} / {}", own.group) },
        period_s: Some(own.period_s).filter(|period| period.is_finite() && *period >= 1.0),
        op_span: own.op_span.filter(|span| span.is_finite() && *span > 0.0),
        op_limits: limits.filter(|[low, high]| low.is_finite() && high.is_finite() && low < high),
        op: role(Role::Op)?,
        pv: role(Role::Pv)?,
        sp: role(Role::Sp),
        mode: role(Role::Mode),
        mv: role(Role::Mv),
        tag: others.map(|tag| forwarded(tag, Some(tag.name.clone()))).collect(),
        upstream: own.upstream.iter().map(|other| of_site(site, other)).collect(),
        frozen_pv_s: None,
        candidates: None,
        cost: own.cost_per_sd.map(cost).filter(|cost| cost.validate().is_empty()),
        writeback: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::fleet::claims::{Edges, Signs};
    use crate::app::fleet::tests::centre;
    use crate::fleet::announcement::split;
    use crate::fleet::subject::What;
    use prost::Message;

    /// What a centre hears of the list of an edge that has so many bytes.
    fn hear(lists: &mut Lists, edge: &Subject, bytes: usize) {
        split(edge, &vec![b'x'; bytes])
            .into_iter()
            .for_each(|own| drop(lists.hear(&own.subject, own.body, 1.0)));
    }

    /// An edge that has one loop, whose tags it reads at `source`, and one collector.
    fn edge_of(id: &str, source: &str, announced: f64) -> Edge {
        let tag = |name: &str| Tag { name: name.into(), source: source.into(), ..Tag::default() };
        let own = Loop { id: id.into(), tags: ["op", "pv"].map(tag).into(), ..Loop::default() };
        Edge { hello: Hello { loops: vec![own], collectors: vec!["dcs".into()] }, announced }
    }

    #[test]
    fn a_loop_that_two_edges_have_is_that_of_the_gateway_that_replaced_the_other() {
        let key = |name: &str| ("north".to_string(), name.to_string());
        let edges: Edges = [
            (key("a"), edge_of("FIC1", "before", 100.0)),
            (key("b"), edge_of("FIC1", "now", 200.0)),
            (key("c"), edge_of("FIC2", "elsewhere", 50.0)),
        ]
        .into();
        let Composed { config, claims, left } =
            composed(&Config::default(), &ranked(&edges, &Signs::default()));
        let sources: Vec<_> = config.loops.iter().map(|own| (own.id.as_str(), source(&own.pv))).collect();
        assert_eq!(sources, [("north:FIC1", "now"), ("north:FIC2", "elsewhere")]);
        assert_eq!((config.forwarded, left), (vec!["north:dcs".to_string()], Vec::new()));
        assert_eq!((claims.owner("north:FIC1"), claims.owner("north:FIC2")), (Some("b"), None));
        assert!(claims.is_foreign("north:FIC1", "a", None) && claims.is_foreign("north:dcs", "a", None));
        assert!(!claims.is_foreign("north:dcs", "c", None), "it has a collector of its own under that name");
    }

    #[test]
    fn the_price_of_a_loop_comes_to_the_centre_and_one_that_cannot_be_does_not() {
        let cost = |per_sd, unit: &str| {
            let tag = |name: &str| Tag { name: name.into(), ..Tag::default() };
            let tags = ["op", "pv"].map(tag).into();
            let own = Loop { cost_per_sd: per_sd, cost_unit: unit.into(), tags, ..Loop::default() };
            // As it comes over the wire; an earlier version says nothing of prices.
            let own = Loop::decode(&own.encode_to_vec()[..]).expect("ours");
            loop_config("north", "north:FIC1", &own).expect("it has op and pv").cost
        };
        let told = CostConfig { per_sd: 12.5, unit: "EUR/day".into() };
        assert_eq!(cost(Some(12.5), "EUR/day"), Some(told));
        assert_eq!(cost(Some(0.0), ""), Some(CostConfig { per_sd: 0.0, unit: String::new() }));
        assert_eq!(cost(None, ""), None);
        for (per_sd, unit) in [(f64::NAN, ""), (-1.0, ""), (1.0, "a unit that is far too long")] {
            assert_eq!(cost(Some(per_sd), unit), None, "{per_sd} {unit}");
        }
    }

    #[test]
    fn an_edge_announces_the_price_of_its_loops() {
        let (fleet, _results) = crate::app::fleet::tests::edge("FIC1");
        let own = fleet.scene.borrow().clone();
        let mut config = Config::clone(&own.config);
        let mut priced = loop_config("north", "FIC1", &edge_of("FIC1", "dcs", 0.0).hello.loops[0])
            .expect("it has op and pv");
        priced.cost = Some(CostConfig { per_sd: 3.0, unit: "EUR/day".into() });
        config.loops = vec![priced];
        let scene = Scene { config: config.into(), history: own.history.clone() };
        let said = hello(&scene, Vec::new());
        assert_eq!((said.loops[0].cost_per_sd, said.loops[0].cost_unit.as_str()), (Some(3.0), "EUR/day"));
    }

    /// Where a tag is read that an edge has announced.
    fn source(tag: &TagConfig) -> &str {
        match tag {
            TagConfig::Forwarded(own) => &own.source,
            _ => "",
        }
    }

    #[test]
    fn a_site_is_in_force_once_the_lists_of_all_of_its_edges_are() {
        let (fleet, _results) = centre("north:FIC1");
        let [e1, e2] = ["e1", "e2"].map(|name| Subject::new("north", name, What::Hello));
        let is_in_force = || fleet.in_force.lock().expect("no panic").contains_key("north");
        let is_known = || fleet.known.borrow().is_some();
        let of = |id: &str| Hello {
            loops: vec![Loop { id: id.to_string(), ..Loop::default() }],
            ..Hello::default()
        };
        let mut lists = Lists::default();
        assert!(fleet.take_list(&e1, of("FIC1"), 1.0));
        hear(&mut lists, &e2, 10_000);
        fleet.unsettle(&lists);
        fleet.settle_sites(&lists);
        assert!(!is_in_force() && !is_known(), "the list of e2 is not fetched yet");

        let heard = lists.next().expect("it waits");
        assert!(fleet.take_list(&e2, of("FIC2"), 1.0));
        lists.took(e2.clone(), heard.digest().to_vec());
        fleet.settle_sites(&lists);
        assert!(is_in_force() && is_known());

        // Another one begins to come: what it brings is not known yet.
        let first = split(&e2, &[b'y'; 5_000]).swap_remove(0);
        lists.hear(&first.subject, first.body, 1.0);
        fleet.unsettle(&lists);
        fleet.settle_sites(&lists);
        assert!(!is_in_force());
        hear(&mut lists, &e2, 10_000);
        fleet.settle_sites(&lists);
        assert!(is_in_force(), "the one of before was announced again");
    }
}
