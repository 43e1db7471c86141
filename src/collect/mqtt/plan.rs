//! What to listen to, decided once and without I/O.

use super::config::{Config, Place, TagConfig};
use crate::collect::scaling::Scaling;
use crate::collect::{self, Issue};
use std::collections::BTreeSet;

/// A tag as `app` hands it over.
pub type TagSpec = collect::TagSpec<TagConfig>;

/// A tag ready to be listened for.
#[derive(Clone, Debug)]
pub struct Tag {
    /// As in [`TagSpec`].
    pub index: usize,
    /// As in [`TagSpec`].
    pub name: String,
    /// As in [`TagSpec`].
    pub frozen_after_s: Option<f64>,
    pub(super) place: Place,
    pub(super) scaling: Scaling,
}

/// Everything needed to listen to one broker.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The number under which the [`Sink`](crate::collect::Sink) hears of it.
    pub device: usize,
    /// The broker, its security and its timing.
    pub config: Config,
    /// The tags, in the order given.
    pub tags: Vec<Tag>,
}

impl Plan {
    /// Plans one broker, numbered `device` by the caller, from its configuration and tags.
    ///
    /// # Errors
    /// Everything that [`Config::validate`] and [`TagConfig::validate`] find, the tag's name in the message.
    pub fn new(device: usize, config: &Config, specs: Vec<TagSpec>) -> Result<Self, Vec<Issue>> {
        let mut issues = config.validate();
        let mut tags = Vec::with_capacity(specs.len());
        for spec in specs {
            let found = spec.config.validate(config, spec.role);
            match spec.config.place(config) {
                Ok(place) if found.is_empty() => tags.push(ready(spec, place)),
                _ => issues.extend(found.into_iter().map(|issue| issue.of_tag(&spec.name))),
            }
        }
        if issues.is_empty() { Ok(Self { device, config: config.clone(), tags }) } else { Err(issues) }
    }

    /// Whether a broker would be listened to the same under both plans, apart from the numbers of its tags and its own.
    pub fn asks_the_same(&self, other: &Plan) -> bool {
        self.config == other.config
            && self.tags.len() == other.tags.len()
            && self.tags.iter().zip(&other.tags).all(|(a, b)| {
                (&a.name, &a.place, &a.scaling, a.frozen_after_s)
                    == (&b.name, &b.place, &b.scaling, b.frozen_after_s)
            })
    }

    /// What to subscribe to: each topic once, and of an edge node everything, because its messages are numbered through.
    pub(super) fn filters(&self) -> BTreeSet<String> {
        let filter = |tag: &Tag| match &tag.place {
            Place::Topic { topic, .. } => topic.clone(),
            Place::Metric { group, edge, .. } => format!("spBv1.0/{group}/+/{edge}/#"),
        };
        self.tags.iter().map(filter).collect()
    }
}

fn ready(spec: TagSpec, place: Place) -> Tag {
    Tag {
        index: spec.index,
        name: spec.name,
        frozen_after_s: spec.frozen_after_s,
        place,
        scaling: spec.config.scaling().in_role(spec.role),
    }
}
