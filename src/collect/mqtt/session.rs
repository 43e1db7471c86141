//! The sessions of Sparkplug B's edge nodes: who is alive, what an alias means, and whether a message was missed. Pure.
//!
//! ```text
//!             NBIRTH                     a number is missing: aliases forgotten, births wanted
//! unborn --------------> born ------------------------------------------------------------------+
//!   ^  ^ data: refused,   |  ^                                                                  |
//!   |  | births wanted    |  +----------------------- NBIRTH, DBIRTH ---------------------------+
//!   +--+------------------+ NDEATH of this session, or the connection is lost: all tags bad
//! ```

use super::config::{MetricKey, Place};
use super::json::{Told, is_time};
use super::plan::Tag;
use crate::mqtt::sparkplug::{Kind, Metric, Payload, Topic};
use crate::signal::{BadReason, Quality};

/// One edge node and the tags it has.
#[derive(Debug)]
pub(super) struct Edge {
    pub(super) group: String,
    pub(super) edge: String,
    wants: Vec<Want>,
    born: Option<Born>,
}

#[derive(Debug)]
struct Born {
    bdseq: Option<u64>,
    seq: u64,
}

/// A metric that a tag asks for.
#[derive(Debug)]
struct Want {
    tag: usize,
    device: Option<String>,
    key: MetricKey,
    /// Whether its birth came in this session.
    born: bool,
    /// Whether its device was born without it: then asking for births again brings nothing.
    missing: bool,
    alias: Option<u64>,
    datatype: Option<u32>,
}

/// What a message brought.
#[derive(Debug, Default, PartialEq)]
pub(super) struct News {
    /// Values, by position of the tag.
    pub(super) values: Vec<(usize, Told)>,
    /// Tags that have no value any more, and why.
    pub(super) lost: Vec<(usize, BadReason)>,
    /// Whether births were missed.
    pub(super) wants_births: bool,
    /// Whether messages were missed.
    pub(super) gap: bool,
    /// What could not be read or believed.
    pub(super) refused: u64,
}

impl Edge {
    /// The edge nodes of the tags.
    pub(super) fn all(tags: &[Tag]) -> Vec<Edge> {
        let mut edges: Vec<Edge> = Vec::new();
        for (at, tag) in tags.iter().enumerate() {
            let Place::Metric { group, edge, device, metric } = &tag.place else { continue };
            let known = edges.iter().position(|e| e.group == *group && e.edge == *edge);
            let known = known.unwrap_or_else(|| {
                edges.push(Edge { group: group.clone(), edge: edge.clone(), wants: Vec::new(), born: None });
                edges.len() - 1
            });
            edges[known].wants.push(Want {
                tag: at,
                device: device.clone(),
                key: metric.clone(),
                born: false,
                missing: false,
                alias: None,
                datatype: None,
            });
        }
        edges
    }

    /// Whether a topic is of this edge node.
    pub(super) fn is_of(&self, topic: &Topic) -> bool {
        self.group == topic.group && self.edge == topic.edge
    }

    /// The connection was lost: nobody knows what is missed.
    pub(super) fn forget(&mut self) {
        self.born = None;
        self.wants.iter_mut().for_each(Want::forget);
    }

    /// Takes a message of this edge node.
    pub(super) fn take(&mut self, topic: &Topic, payload: &Payload) -> News {
        let mut news = News::default();
        match topic.kind {
            Kind::NodeBirth => {
                let Some(seq) = payload.seq.filter(|seq| *seq <= 255) else {
                    news.refused += 1;
                    return news;
                };
                self.forget();
                self.born = Some(Born { bdseq: payload.bdseq(), seq });
                self.birth(None, payload, &mut news);
                return news;
            }
            Kind::NodeDeath => {
                let current = self.born.as_ref().and_then(|born| born.bdseq);
                // The will of an earlier session may come after the birth of the next.
                if current.zip(payload.bdseq()).is_some_and(|(ours, theirs)| ours != theirs) {
                    return news;
                }
                self.forget();
                news.lost = self.wants.iter().map(|want| (want.tag, BadReason::LinkDown)).collect();
                return news;
            }
            _ => {}
        }
        if !self.follows(payload, &mut news) {
            return news;
        }
        match topic.kind {
            Kind::DeviceBirth => self.birth(topic.device, payload, &mut news),
            Kind::DeviceDeath => {
                for want in self.wants.iter_mut().filter(|want| want.device.as_deref() == topic.device) {
                    want.forget();
                    news.lost.push((want.tag, BadReason::LinkDown));
                }
            }
            _ => self.data(topic.device, payload, &mut news),
        }
        news
    }

    /// Whether a message may be believed: after a birth. A number left out is noticed.
    fn follows(&mut self, payload: &Payload, news: &mut News) -> bool {
        let Some(born) = &mut self.born else {
            (news.wants_births, news.refused) = (true, 1);
            return false;
        };
        let Some(seq) = payload.seq.filter(|seq| *seq <= 255) else {
            news.refused += 1;
            return false;
        };
        if seq != (born.seq + 1) % 256 {
            (news.gap, news.wants_births) = (true, true);
            // A birth may have been missed that gave the aliases another meaning.
            self.wants.iter_mut().for_each(|want| want.alias = None);
        }
        born.seq = seq;
        true
    }

    fn birth(&mut self, device: Option<&str>, payload: &Payload, news: &mut News) {
        for want in self.wants.iter_mut().filter(|want| want.device.as_deref() == device) {
            let named = |metric: &&Metric| match &want.key {
                MetricKey::Name(name) => metric.name.as_ref() == Some(name),
                MetricKey::Alias(alias) => metric.alias == Some(*alias),
            };
            let Some(metric) = payload.metrics.iter().find(named) else {
                want.forget();
                want.missing = true;
                news.lost.push((want.tag, BadReason::DeviceException));
                continue;
            };
            (want.born, want.missing) = (true, false);
            (want.alias, want.datatype) = (metric.alias, metric.datatype);
            want.value(metric, payload, news);
        }
    }

    fn data(&mut self, device: Option<&str>, payload: &Payload, news: &mut News) {
        for want in self.wants.iter().filter(|want| want.device.as_deref() == device) {
            for metric in payload.metrics.iter().filter(|metric| want.is_told_by(metric)) {
                if want.born {
                    want.value(metric, payload, news);
                } else {
                    news.refused += 1;
                }
            }
            news.wants_births |= !want.born && !want.missing;
        }
    }
}

impl Want {
    fn forget(&mut self) {
        (self.born, self.missing, self.alias, self.datatype) = (false, false, None, None);
    }

    fn is_told_by(&self, metric: &Metric) -> bool {
        match (metric.name.as_deref().filter(|name| !name.is_empty()), &self.key) {
            (Some(name), MetricKey::Name(own)) => name == own,
            _ => self.alias.is_some() && metric.alias == self.alias,
        }
    }

    fn value(&self, metric: &Metric, payload: &Payload, news: &mut News) {
        let t = metric.timestamp.or(payload.timestamp).map(|ms| ms as f64 * 1e-3);
        if t.is_some_and(|t| !is_time(t)) {
            news.refused += 1;
            return;
        }
        let quality = match metric.quality() {
            None | Some(192) => Quality::Good,
            Some(500) => Quality::Stale,
            Some(_) => Quality::Bad(BadReason::DeviceException),
        };
        let raw = metric.number(self.datatype).filter(|_| metric.is_null != Some(true));
        let quality = match (raw, quality) {
            (None, Quality::Good | Quality::Stale) if metric.is_null == Some(true) => {
                Quality::Bad(BadReason::NotANumber)
            }
            (None, Quality::Good | Quality::Stale) => {
                news.refused += 1;
                return;
            }
            (_, quality) => quality,
        };
        let buffered = metric.is_historical == Some(true);
        news.values.push((self.tag, Told { raw, t, quality, buffered }));
    }
}

#[cfg(test)]
#[path = "session_tests.rs"]
mod tests;
