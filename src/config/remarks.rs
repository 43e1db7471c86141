//! What is right by itself and often meant otherwise.

use super::{Config, LoopConfig, TagConfig, tags};
use crate::collect::opcua;
use crate::signal::Role;
use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, HashMap};

/// A range of believable values that is so many times wider than the span belongs to another unit.
const WIDER: f64 = 10.0;
/// So does one that is so many times narrower.
const NARROWER: f64 = 4.0;

impl Config {
    /// What is right by itself and often meant otherwise, each with its loop and tag.
    pub fn remarks(&self) -> Vec<String> {
        let mut out = Vec::new();
        for control_loop in &self.loops {
            for (role, tag) in tags(control_loop) {
                let TagConfig::Modbus(own) = tag else { continue };
                let name = role.map(Role::as_str).or(tag.name()).unwrap_or_default();
                out.extend(own.remark().map(|remark| format!("{}.{name}: {remark}", control_loop.id)));
            }
            out.extend(beyond_range(control_loop));
        }
        out.extend(self.numbered());
        out.extend(self.copied());
        out.extend(self.subscriptions());
        out.extend(self.in_the_clear());
        let (held, wanted) = (self.history.samples_per_tag, self.diagnosis.window_samples);
        if held < wanted {
            out.push(format!(
                "[history] holds {held} samples of a tag, and a diagnosis looks at up to {wanted}: samples_per_tag may be larger"
            ));
        }
        out
    }

    /// Servers whose nodes are named by the number of their namespace.
    fn numbered(&self) -> Vec<String> {
        let mut numbered: BTreeMap<&str, usize> = BTreeMap::new();
        for (_, tag) in self.loops.iter().flat_map(tags) {
            if let TagConfig::Opcua(own) = tag
                && own.place().is_ok_and(|place| place.is_numbered())
            {
                *numbered.entry(own.device.as_str()).or_default() += 1;
            }
        }
        let told = |(device, tags)| {
            format!(
                "{device}: {tags} tags name their namespace by its number, which a server may give to another when it starts: \
                 write nsu=URI instead, as stictiond probe shows it"
            )
        };
        numbered.into_iter().map(told).collect()
    }

    /// Passwords that anybody on the way can read.
    fn in_the_clear(&self) -> Vec<String> {
        let is_near =
            |address: &str| ["127.", "localhost", "[::1]"].iter().any(|own| address.starts_with(own));
        let clear = self
            .mqtt
            .iter()
            .filter(|b| b.user.is_some() && !(b.tls || b.ca_file.is_some()) && !is_near(&b.address));
        let told = |(name, address): (&String, &String)| {
            format!("{name}: the password goes to {address} in the clear: write tls = true")
        };
        clear.map(|broker| told((&broker.name, &broker.address))).collect()
    }

    /// What servers are asked for that costs samples, or small movements of OP.
    fn subscriptions(&self) -> Vec<String> {
        let servers: HashMap<&str, &opcua::Config> =
            self.opcua.iter().map(|server| (server.name.as_str(), server)).collect();
        let mut out = Vec::new();
        let mut lossy: BTreeMap<(&str, u64, u32), (usize, String)> = BTreeMap::new();
        for control_loop in &self.loops {
            for (role, tag) in tags(control_loop) {
                let TagConfig::Opcua(own) = tag else { continue };
                let Some(server) = servers.get(own.device.as_str()) else { continue };
                if server.mode != opcua::Mode::Subscribe {
                    continue;
                }
                let name = format!(
                    "{}.{}",
                    control_loop.id,
                    role.map(Role::as_str).or(tag.name()).unwrap_or_default()
                );
                let sampling = opcua::Sampling::new(server, own);
                if role == Some(Role::Op) && sampling.deadband != opcua::Deadband::None {
                    out.push(format!(
                        "{name}: a dead band hides small movements of OP, by which friction is seen: leave it out, or write \
                         deadband = 0.0 for this tag"
                    ));
                }
                if server.publishing_ms.div_ceil(sampling.every_ms.max(1)) > u64::from(sampling.queue) {
                    let key = (server.name.as_str(), sampling.every_ms, sampling.queue);
                    lossy.entry(key).or_insert((0, name)).0 += 1;
                }
            }
        }
        out.extend(lossy.into_iter().map(|((device, every_ms, queue), (tags, first))| {
            let publishing_ms = servers[device].publishing_ms;
            let made = publishing_ms.div_ceil(every_ms.max(1));
            let others = if tags > 1 { format!(" and {} others", tags - 1) } else { String::new() };
            format!(
                "{device}: of {first}{others} the server takes {made} samples between two publishes (sampling_ms = {every_ms}, \
                 publishing_ms = {publishing_ms}) and keeps {queue}, the others are lost: write queue_size = {made} or more"
            )
        }));
        out
    }

    /// Loops that read OP and PV where another does.
    fn copied(&self) -> Vec<String> {
        let mut first: HashMap<String, &str> = HashMap::new();
        let told = |own: &'_ LoopConfig, other: &str| {
            format!("{}: it reads OP and PV where {other} does: was its section copied?", own.id)
        };
        let mut out = Vec::new();
        for own in &self.loops {
            match first.entry(format!("{:?} {:?}", own.op, own.pv)) {
                Entry::Occupied(other) => out.push(told(own, other.get())),
                Entry::Vacant(place) => drop(place.insert(&own.id)),
            }
        }
        out
    }
}

/// Limits and span of OP that its range does not go with.
fn beyond_range(control_loop: &LoopConfig) -> Option<String> {
    let [least, most] = control_loop.op.range()?;
    let id = &control_loop.id;
    if let Some([low, high]) = control_loop.op_limits.filter(|[low, high]| *low < least || *high > most) {
        return Some(format!(
            "{id}.op: op_limits = [{low}, {high}] reach beyond range = [{least}, {most}], and a value out of range is bad: \
             widen range, or correct op_limits"
        ));
    }
    let (span, wide) = (control_loop.op_span?, most - least);
    let than = match wide {
        wide if wide > WIDER * span => "wider",
        wide if NARROWER * wide < span => "narrower",
        _ => return None,
    };
    Some(format!(
        "{id}.op: range = [{least}, {most}] is far {than} than op_span = {span}: both are in OP's own unit, after scaling"
    ))
}
