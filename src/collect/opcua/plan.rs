//! What to ask a server, decided once and without I/O.

use super::config::{Config, Place, TagConfig};
use crate::collect::Issue;
use crate::collect::scaling::Scaling;
use crate::signal::Role;

/// A tag as `app` hands it over.
#[derive(Clone, Debug)]
pub struct TagSpec {
    /// The number under which the [`Sink`](crate::collect::Sink) receives its samples.
    pub index: usize,
    /// Its name in logs (`FIC101.pv`).
    pub name: String,
    /// What it is to its loop; `None` for an extra tag.
    pub role: Option<Role>,
    /// Where it lives.
    pub config: TagConfig,
    /// Flag it as stale when its value has not changed for longer than this (s).
    pub frozen_after_s: Option<f64>,
}

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
    pub(super) scaling: Scaling,
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
                Ok(place) if found.is_empty() => tags.push(ready(spec, place)),
                _ => issues.extend(
                    found
                        .into_iter()
                        .map(|issue| Issue { message: format!("{}: {}", spec.name, issue.message), ..issue }),
                ),
            }
        }
        if issues.is_empty() { Ok(Self { device, config: config.clone(), tags }) } else { Err(issues) }
    }

    /// Whether a server would be asked the same under both plans, apart from the numbers of its tags and its own.
    pub fn asks_the_same(&self, other: &Plan) -> bool {
        self.config == other.config
            && self.tags.len() == other.tags.len()
            && self.tags.iter().zip(&other.tags).all(|(a, b)| {
                (&a.name, &a.place, &a.scaling, a.frozen_after_s)
                    == (&b.name, &b.place, &b.scaling, b.frozen_after_s)
            })
    }
}

fn ready(spec: TagSpec, place: Place) -> Tag {
    let mode = spec.role == Some(Role::Mode);
    Tag {
        index: spec.index,
        name: spec.name,
        place,
        frozen_after_s: spec.frozen_after_s,
        scaling: Scaling {
            scale: spec.config.scale,
            offset: spec.config.offset,
            range: spec.config.range,
            auto_values: mode.then(|| spec.config.auto_values.clone().unwrap_or_default()),
        },
    }
}
