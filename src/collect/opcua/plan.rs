//! What to ask a server, decided once and without I/O.

use super::config::{Config, Place, TagConfig};
use super::value::Meaning;
use crate::collect::{self, Issue};

/// A tag as `app` hands it over.
pub type TagSpec = collect::TagSpec<TagConfig>;

/// A tag ready to be asked for.
#[derive(Clone, Debug)]
pub struct Tag {
    /// As in [`TagSpec`].
    pub index: usize,
    /// As in [`TagSpec`].
    pub name: String,
    /// Where it is found.
    pub place: Place,
    /// As in [`TagSpec`].
    pub frozen_after_s: Option<f64>,
    /// How a subscription samples it.
    pub sampling: Sampling,
    pub(super) meaning: Meaning,
}

/// How a subscription samples one node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampling {
    /// How often the server looks (ms).
    pub every_ms: u64,
    /// Samples that it keeps between two publishings.
    pub queue: u32,
    /// What it leaves out.
    pub deadband: Deadband,
}

/// Which changes a server leaves out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Deadband {
    /// None.
    None,
    /// Smaller ones, in the node's own unit.
    Absolute(f64),
    /// Smaller ones, in % of the node's EURange.
    Percent(f64),
}

impl Sampling {
    /// Of a tag at its server.
    pub fn new(server: &Config, tag: &TagConfig) -> Self {
        let percent = tag.deadband_percent.unwrap_or(server.deadband_percent);
        Self {
            every_ms: tag.sampling_ms.unwrap_or(server.sampling_ms),
            queue: tag.queue_size.unwrap_or(server.queue_size),
            deadband: match tag.deadband {
                Some(band) if band > 0.0 => Deadband::Absolute(band),
                None if percent > 0.0 => Deadband::Percent(percent),
                _ => Deadband::None,
            },
        }
    }
}

impl Deadband {
    /// Whether a server that sent `sent` last has to send `now` too; `false` where that depends on its EURange.
    pub(super) fn lets_through(self, sent: Option<f64>, now: Option<f64>) -> bool {
        match (self, sent, now) {
            (Deadband::Percent(_), ..) => false,
            (Deadband::Absolute(band), Some(sent), Some(now)) => (now - sent).abs() > band,
            _ => sent != now,
        }
    }
}

/// Everything needed to keep one session.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The number under which the [`Sink`](crate::collect::Sink) hears of it.
    pub device: usize,
    /// The server, its security and its timing.
    pub config: Config,
    /// The tags, in the order given.
    pub tags: Vec<Tag>,
}

impl Plan {
    /// Plans one server, numbered `device` by the caller, from its configuration and tags.
    ///
    /// # Errors
    /// Everything that [`Config::validate`] and [`TagConfig::validate`] find, the tag's name in the message.
    pub fn new(device: usize, config: &Config, specs: Vec<TagSpec>) -> Result<Self, Vec<Issue>> {
        let mut issues = config.validate();
        let mut tags = Vec::with_capacity(specs.len());
        for spec in specs {
            let found = spec.config.validate(spec.role);
            match spec.config.place() {
                Ok(place) if found.is_empty() => tags.push(ready(config, spec, place)),
                _ => issues.extend(found.into_iter().map(|issue| issue.of_tag(&spec.name))),
            }
        }
        if issues.is_empty() { Ok(Self { device, config: config.clone(), tags }) } else { Err(issues) }
    }

    /// Time from a change to its publishing at most (s), by the slowest of the tags.
    pub(super) fn pace_s(&self) -> f64 {
        let slowest =
            self.tags.iter().map(|tag| tag.sampling.every_ms).max().unwrap_or(self.config.sampling_ms);
        (slowest + self.config.publishing_ms) as f64 / 1e3
    }

    /// A session without data for longer is looked into (s): a slow subscription has nothing to say for so long.
    pub(super) fn silence_s(&self) -> f64 {
        self.config.silent_s.max(3.0 * self.pace_s())
    }

    /// Whether a server would be asked the same under both plans, apart from the numbers of its tags and its own.
    pub fn asks_the_same(&self, other: &Plan) -> bool {
        self.config == other.config
            && self.tags.len() == other.tags.len()
            && self.tags.iter().zip(&other.tags).all(|(a, b)| {
                (&a.name, &a.place, &a.meaning, a.sampling, a.frozen_after_s)
                    == (&b.name, &b.place, &b.meaning, b.sampling, b.frozen_after_s)
            })
    }
}

fn ready(server: &Config, spec: TagSpec, place: Place) -> Tag {
    Tag {
        index: spec.index,
        name: spec.name,
        place,
        frozen_after_s: spec.frozen_after_s,
        sampling: Sampling::new(server, &spec.config),
        meaning: spec.config.meaning(spec.role),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_subscription_that_is_slow_is_not_taken_for_a_silent_one() {
        let plan = |server: &str, tag: &str| {
            let text = format!("name = 'd'\nurl = 'opc.tcp://d:4840/'\nsecurity_policy = 'None'\n{server}");
            let spec = TagSpec {
                index: 0,
                name: "a".into(),
                role: None,
                config: toml::from_str(&format!("device = 'd'\nnode = 'ns=2;s=A'\n{tag}")).unwrap(),
                frozen_after_s: None,
            };
            let config: Config = toml::from_str(&text).unwrap();
            Plan::new(0, &config, vec![spec]).unwrap()
        };
        assert_eq!(plan("", "").silence_s(), 30.0);
        assert_eq!(plan("sampling_ms = 60000\npublishing_ms = 60000", "").silence_s(), 360.0);
        assert_eq!(plan("", "sampling_ms = 60000").silence_s(), 183.0);
        assert_eq!(plan("sampling_ms = 60000\nsilent_s = 900.0", "").silence_s(), 900.0);
    }
}
