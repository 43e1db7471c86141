//! What to ask a device, decided once and without I/O: neighbouring registers go into one request.

use super::config::{Config, Framing, TagConfig, Tolerated};
use super::decode::Decoder;
use super::kinds::{Register, ValueType};
use super::overlap::contradictions;
use crate::collect::{self, Issue};
use std::time::Duration;

/// A tag as `app` hands it over.
pub type TagSpec = collect::TagSpec<TagConfig>;

/// A tag ready to be read.
#[derive(Clone, Debug)]
pub struct Tag {
    /// As in [`TagSpec`].
    pub index: usize,
    /// As in [`TagSpec`].
    pub name: String,
    /// The addresses it takes.
    pub span: Span,
    /// How they become its value.
    pub decoder: Decoder,
    /// As in [`TagSpec`].
    pub frozen_after_s: Option<f64>,
}

/// Consecutive addresses of one table, counted from 0 as on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Span {
    /// Which table.
    pub register: Register,
    /// First address.
    pub start: u16,
    /// Number of addresses, at least 1.
    pub count: u16,
}

impl Span {
    /// One past the last address.
    fn end(self) -> u32 {
        u32::from(self.start) + u32::from(self.count)
    }
}

/// How much one request may ask for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Most registers.
    pub registers: u16,
    /// Most coils or discrete inputs.
    pub bits: u16,
    /// Most addresses nobody wants between two that somebody does.
    pub gap: u16,
}

/// One question to the device, and the tags its answer serves.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Request {
    /// What is asked for.
    pub span: Span,
    /// Positions in [`Plan::tags`], by ascending address.
    pub tags: Vec<usize>,
}

/// Everything needed to poll one device.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The number under which the [`Sink`](crate::collect::Sink) hears of its polls.
    pub device: usize,
    /// Its name in logs.
    pub name: String,
    /// `host:port`.
    pub address: String,
    /// Unit identifier.
    pub unit_id: u8,
    /// How requests are framed.
    pub framing: Framing,
    /// Whether the connection is shared with other units at the address.
    pub share_connection: bool,
    /// Least pause between an answer and the next request.
    pub min_gap: Duration,
    /// What of an answer's head may differ from the request's.
    pub tolerate: Vec<Tolerated>,
    /// Poll period.
    pub period: Duration,
    /// Longest wait for a connection and for each answer.
    pub timeout: Duration,
    /// Longest pause between attempts to reconnect.
    pub reconnect_max: Duration,
    /// The tags, in the order given.
    pub tags: Vec<Tag>,
    /// The requests that cover them.
    pub requests: Vec<Request>,
}

impl Plan {
    /// Plans the polling of one device, numbered `device` by the caller, from its configuration and tags.
    ///
    /// # Errors
    /// Everything that [`Config::validate`], [`TagConfig::validate`] and [`contradictions`] find, the tag's
    /// name in the message.
    pub fn new(device: usize, config: &Config, specs: Vec<TagSpec>) -> Result<Self, Vec<Issue>> {
        let mut issues = config.validate();
        let mut tags = Vec::with_capacity(specs.len());
        let configs: Vec<&TagConfig> = specs.iter().map(|spec| &spec.config).collect();
        for pair in contradictions(config, &configs) {
            issues.push(Issue {
                field: "address",
                message: format!("{}, {}: {}", specs[pair.first].name, specs[pair.second].name, pair.message),
            });
        }
        for spec in specs {
            let found = spec.config.validate(config, spec.role);
            let place = spec.config.wire_address(config).zip(spec.config.effective_type());
            match place {
                Some((start, value_type)) if found.is_empty() => {
                    tags.push(ready(config, spec, start, value_type));
                }
                _ => issues.extend(found.into_iter().map(|issue| issue.of_tag(&spec.name))),
            }
        }
        if !issues.is_empty() {
            return Err(issues);
        }
        let limits = Limits {
            registers: config.max_registers_per_request,
            bits: config.max_bits_per_request,
            gap: config.max_gap,
        };
        let spans: Vec<Span> = tags.iter().map(|tag| tag.span).collect();
        Ok(Self {
            device,
            name: config.name.clone(),
            address: config.address.clone(),
            unit_id: config.unit_id,
            framing: config.framing,
            share_connection: config.share_connection,
            min_gap: Duration::from_millis(config.min_gap_ms),
            tolerate: config.tolerate.clone(),
            period: Duration::from_millis(config.poll_ms),
            timeout: Duration::from_millis(config.timeout_ms),
            reconnect_max: Duration::from_millis(config.reconnect_max_ms),
            requests: group(&spans, &limits),
            tags,
        })
    }
}

impl Plan {
    /// Whether a device would be polled the same under both plans, apart from the numbers of its tags and its own.
    pub fn asks_the_same(&self, other: &Plan) -> bool {
        let head =
            |p: &Plan| (p.name.clone(), p.address.clone(), p.unit_id, p.period, p.timeout, p.reconnect_max);
        let line = |p: &Plan| (p.framing, p.share_connection, p.min_gap, p.tolerate.clone());
        head(self) == head(other)
            && line(self) == line(other)
            && self.requests == other.requests
            && self.tags.len() == other.tags.len()
            && self.tags.iter().zip(&other.tags).all(|(a, b)| {
                (&a.name, a.span, &a.decoder, a.frozen_after_s)
                    == (&b.name, b.span, &b.decoder, b.frozen_after_s)
            })
    }
}

fn ready(config: &Config, spec: TagSpec, start: u16, value_type: ValueType) -> Tag {
    let order = spec.config.byte_order.unwrap_or_else(|| match spec.config.register.is_bits() {
        true => Default::default(),
        false => config.byte_order,
    });
    Tag {
        index: spec.index,
        name: spec.name,
        span: Span { register: spec.config.register, start, count: value_type.width() },
        decoder: Decoder::new(&spec.config, value_type, order, spec.role),
        frozen_after_s: spec.frozen_after_s,
    }
}

/// Groups spans into the fewest requests that a walk by ascending address gives: a span joins the request
/// before it when the gap between them and the length together stay within the limits. A span is never
/// divided; one longer than the limit gets a request of its own.
pub fn group(spans: &[Span], limits: &Limits) -> Vec<Request> {
    let mut order: Vec<usize> = (0..spans.len()).collect();
    order.sort_by_key(|&at| (spans[at], at));
    let mut requests: Vec<Request> = Vec::new();
    for at in order {
        let span = spans[at];
        if let Some(last) = requests.last_mut()
            && let Some(joined) = join(last.span, span, limits)
        {
            last.span = joined;
            last.tags.push(at);
            continue;
        }
        requests.push(Request { span, tags: vec![at] });
    }
    requests
}

fn join(a: Span, b: Span, limits: &Limits) -> Option<Span> {
    let most = if a.register.is_bits() { limits.bits } else { limits.registers };
    let near = u32::from(b.start) <= a.end() + u32::from(limits.gap);
    let count = u16::try_from(a.end().max(b.end()) - u32::from(a.start)).ok()?;
    (a.register == b.register && near && count <= most).then_some(Span { count, ..a })
}

impl Request {
    /// Divides a request that the device refused: at the widest hole between its tags, the most central
    /// one of equals. `None` when no address separates the tags, so that the refusal is theirs.
    pub fn split(&self, tags: &[Tag]) -> Option<(Request, Request)> {
        let spans: Vec<Span> = self.tags.iter().map(|&at| tags[at].span).collect();
        let mut best: Option<(u32, usize, usize)> = None;
        let mut end = 0;
        for (at, span) in spans.iter().enumerate() {
            let hole = u32::from(span.start).checked_sub(end);
            if let Some(hole) = hole.filter(|_| at > 0) {
                let central = at.min(spans.len() - at);
                if best.is_none_or(|(width, middle, _)| (hole, central) > (width, middle)) {
                    best = Some((hole, central, at));
                }
            }
            end = end.max(span.end());
        }
        let (_, _, at) = best?;
        let (left, right) = self.tags.split_at(at);
        Some((covering(left, &spans[..at])?, covering(right, &spans[at..])?))
    }
}

fn covering(tags: &[usize], spans: &[Span]) -> Option<Request> {
    let first = spans.first()?;
    let end = spans.iter().map(|span| span.end()).max()?;
    Some(Request {
        span: Span { count: u16::try_from(end - u32::from(first.start)).ok()?, ..*first },
        tags: tags.to_vec(),
    })
}

#[cfg(test)]
#[path = "plan_tests.rs"]
mod tests;
