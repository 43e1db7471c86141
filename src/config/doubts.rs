//! Numbers that are each right and do not go together: what a register can send, what is waited for, who is told.

use super::{Config, LoopConfig, TagConfig, tags};
use crate::alarm::{Kind, Priority};
use crate::collect::{modbus, opcua};
use crate::signal::{Role, Scale, figures};
use std::collections::{BTreeSet, HashMap};

/// A step of OP that is so many times the threshold of f hides friction that would count.
const COARSE: f64 = 10.0;
/// A range that reaches so many times further than the register belongs to another scale.
const BEYOND: f64 = 10.0;
/// A range may reach below 0 by such a part of itself though the register does not.
const MARGIN: f64 = 0.1;
/// OP and PV so many times further apart in time are told: what OP does between two values of PV is not seen.
const APART: u64 = 20;
/// An alarm waits for so many polls at least.
const POLLS: f64 = 3.0;
/// What is in deploy/ ends a daemon that has not ended by itself after so long (s).
const STOP_S: f64 = 90.0;

impl Config {
    /// Each with its loop, device or receiver.
    pub(super) fn doubts(&self) -> Vec<String> {
        let mut out = Vec::new();
        for own in &self.loops {
            for (role, tag) in tags(own) {
                let TagConfig::Modbus(tag) = tag else { continue };
                let name = role.map(Role::as_str).or(tag.name.as_deref()).unwrap_or_default();
                out.extend(reach(tag).map(|said| format!("{}.{name}: {said}", own.id)));
            }
            out.extend(self.steps_of_op(own));
            out.extend(never_covered(own));
            out.extend(self.apart(own));
            out.extend(self.finer(own));
            out.extend(always_automatic(own));
            out.extend(self.term(own));
            out.extend(slow_end(own));
        }
        out.extend(self.one_device());
        out.extend(self.idle());
        out.extend(self.too_soon());
        out.extend(self.never_told());
        out
    }

    /// OP in steps by which friction is hidden.
    fn steps_of_op(&self, own: &LoopConfig) -> Option<String> {
        let op = own.op.as_modbus()?;
        op.effective_type()?.raw_range()?;
        let limits = own.op_limits.map(|[low, high]| high - low);
        let percent = own.op.unit().is_some_and(|unit| unit.trim() == "%").then_some(100.0);
        let span = own.op_span.or(limits).or(percent)?;
        let step = 100.0 * op.scale.abs() / span;
        let least = self.diagnosis.f_threshold_percent;
        (step > COARSE * least).then(|| {
            format!(
                "{}.op: it comes in steps of {step:.2} % of its span, and friction counts from {least} %: read a finer register, or \
                 look at scale",
                own.id
            )
        })
    }

    /// How often a tag comes (ms), where anybody asks for it.
    fn every_ms(&self, tag: &TagConfig) -> Option<u64> {
        match tag {
            TagConfig::Modbus(tag) => {
                self.modbus.iter().find(|own| own.name == tag.device).map(|own| own.poll_ms)
            }
            TagConfig::Opcua(tag) => {
                let server = self.opcua.iter().find(|own| own.name == tag.device)?;
                Some(opcua::Sampling::new(server, tag).every_ms)
            }
            TagConfig::Mqtt(_) | TagConfig::Forwarded(_) => None,
        }
    }

    fn apart(&self, own: &LoopConfig) -> Option<String> {
        let (op, pv) = (self.every_ms(&own.op)?, self.every_ms(&own.pv)?);
        (op.max(pv) > APART * op.min(pv)).then(|| {
            format!(
                "{}: op comes every {op} ms and pv every {pv} ms: a diagnosis sees no more than the slower of both",
                own.id
            )
        })
    }

    /// A loop that is resampled to a shorter period than it has samples.
    fn finer(&self, own: &LoopConfig) -> Option<String> {
        let ts = self.diagnosis.ts_s?;
        let slower = self.every_ms(&own.op)?.max(self.every_ms(&own.pv)?) as f64 / 1000.0;
        (ts < slower).then(|| {
            format!(
                "{}: its samples come every {slower} s, and [diagnosis] ts_s = {ts}: what is drawn between them is no evidence",
                own.id
            )
        })
    }

    /// The term of write-back in another order of bytes than the device's tags, and samples that are too old at once.
    fn term(&self, own: &LoopConfig) -> Vec<String> {
        let Some(writeback) = own.writeback.as_ref().filter(|own| own.enabled) else { return Vec::new() };
        let Some(device) = self.modbus.iter().find(|device| device.name == writeback.device) else {
            return Vec::new();
        };
        let mut out = Vec::new();
        let (term, read) = (writeback.term_byte_order.as_str(), device.byte_order.as_str());
        if term != read && writeback.term_type.width() > 1 {
            out.push(format!(
                "{}.writeback: the term is WRITTEN as {term}, and {} is read as {read}: write term_byte_order = \"{read}\" unless \
                 the DCS takes it so",
                own.id, device.name
            ));
        }
        let age = writeback.max_sample_age_ms;
        let slowest = [Some(&own.op), Some(&own.pv), own.sp.as_ref(), own.mode.as_ref()];
        let slowest = slowest.into_iter().flatten().filter_map(|tag| self.every_ms(tag)).max();
        if let Some(every) = slowest.filter(|every| *every >= age) {
            out.push(format!(
                "{}.writeback: max_sample_age_ms = {age}, and its samples come every {every} ms: the gate never opens; read them \
                 more often, or write more",
                own.id
            ));
        }
        let (grant, prove) = (writeback.grant_max_s, writeback.prove_s);
        if grant < prove {
            out.push(format!(
                "{}.writeback: grant_max_s = {grant}, and the gain may take prove_s = {prove}: every grant ends before its term \
                 is proven",
                own.id
            ));
        }
        let (age, period) = (writeback.evidence_max_age_s, self.period_s(own));
        if age < period {
            out.push(format!(
                "{}.writeback: evidence_max_age_s = {age}, and a diagnosis comes every {period} s: most of the time the gate has \
                 no evidence",
                own.id
            ));
        } else if let Some(reach) = self.reach_s(own).filter(|reach| age < period + reach) {
            out.push(format!(
                "{}.writeback: evidence_max_age_s = {age}, and a diagnosis, one each {period} s, may be of a stretch that ended up to \
                 {reach} s before it (samples_per_tag): the gate may stay at evidence_old; write {} or more",
                own.id,
                period + reach
            ));
        }
        out
    }

    /// How far back the samples of a loop go that are kept (s), where anybody asks for them.
    fn reach_s(&self, own: &LoopConfig) -> Option<f64> {
        let every_ms = self.every_ms(&own.op)?.max(self.every_ms(&own.pv)?);
        Some(self.history.samples_per_tag as f64 * every_ms as f64 / 1000.0)
    }

    /// Devices and servers that no loop reads from.
    fn idle(&self) -> Vec<String> {
        let read: BTreeSet<&str> = self.loops.iter().flat_map(tags).map(|(_, tag)| tag.device()).collect();
        let written =
            self.loops.iter().filter_map(|own| own.writeback.as_ref()).map(|own| own.device.as_str());
        let used: BTreeSet<&str> = read.into_iter().chain(written).collect();
        let modbus = self.modbus.iter().map(|own| own.name.as_str());
        let opcua = self.opcua.iter().map(|own| own.name.as_str());
        let idle = modbus.chain(opcua).filter(|name| !used.contains(name));
        idle.map(|name| format!("{name}: no loop reads from it")).collect()
    }

    /// One unit at one address that is read in two ways.
    fn one_device(&self) -> Vec<String> {
        let mut first: HashMap<(String, u8), &modbus::Config> = HashMap::new();
        let mut out = Vec::new();
        for own in &self.modbus {
            let other = *first.entry((own.address.to_lowercase(), own.unit_id)).or_insert(own);
            let mut differ = Vec::new();
            if other.address_base != own.address_base {
                differ.push("address_base");
            }
            if other.byte_order != own.byte_order {
                differ.push("byte_order");
            }
            if !differ.is_empty() {
                out.push(format!(
                    "{}: it is unit {} at {} as {} is, with another {}",
                    own.name,
                    own.unit_id,
                    own.address,
                    other.name,
                    differ.join(" and another ")
                ));
            }
        }
        out
    }

    /// Alarms of a device that would be raised between two of its polls, or before its silence is looked into.
    fn too_soon(&self) -> Vec<String> {
        let down = &self.alarm.collector_down;
        let polls = self.modbus.iter().map(|own| (&own.name, own.poll_ms));
        let all = polls.chain(self.opcua.iter().map(|own| (&own.name, own.sampling_ms)));
        let told = |(name, ms): (&String, u64)| {
            let every = ms as f64 / 1000.0;
            (down.enabled && down.after_s < every && !self.is_slow(ms)).then(|| {
                format!(
                    "{name}: it is asked every {every} s, and [alarm.collector_down] after_s = {} takes it for down before the next \
                     answer: write {} or more",
                    down.after_s,
                    POLLS * every
                )
            })
        };
        let subscribed = self.opcua.iter().filter(|own| own.mode == opcua::Mode::Subscribe);
        let silent = subscribed.map(|own| (&own.name, own.silent_s));
        let silent = silent.chain(self.mqtt.iter().map(|own| (&own.name, own.silent_s)));
        let quiet = silent.filter(|(_, silent_s)| down.enabled && down.after_s < *silent_s).map(|(name, silent_s)| {
            format!(
                "{name}: it is looked into after silent_s = {silent_s} without a value, and [alarm.collector_down] after_s = {} takes \
                 it for down before: write {} or more, or a shorter silent_s",
                down.after_s,
                2.0 * silent_s
            )
        });
        all.filter_map(told).chain(quiet).collect()
    }

    /// Kinds of alarms that a receiver asks for and its least priority keeps away.
    fn never_told(&self) -> Vec<String> {
        let webhooks = self.notify.webhook.iter().map(|own| (&own.name, &own.filter));
        let managers = self.notify.alertmanager.iter().map(|own| (&own.name, &own.filter));
        let mails = self.notify.smtp.iter().map(|own| (&own.name, &own.filter));
        let mut out = Vec::new();
        for (name, filter) in webhooks.chain(managers).chain(mails) {
            for kind in &filter.kinds {
                // That of stiction goes with f.
                let most = match kind {
                    Kind::Stiction => Priority::High,
                    kind => self.alarm.priority(*kind, None),
                };
                if most < filter.min_priority {
                    out.push(format!(
                        "{name}: it never hears of {0}, which has the priority {1}: write min_priority = \"{1}\", or [alarm.{0}] \
                         priority",
                        kind.as_str(),
                        most.as_str()
                    ));
                }
            }
        }
        out
    }
}

/// A range that the register cannot fill.
fn reach(tag: &modbus::TagConfig) -> Option<String> {
    let ([least, most], [low, high]) = (tag.reach()?, tag.range?);
    let own = tag.effective_type()?;
    let unsigned = own.raw_range()?[0] == 0.0 && own != modbus::ValueType::Bit;
    // A little below 0 is a margin.
    if unsigned && low < -MARGIN * (high - low) && least >= 0.0 {
        return Some(format!(
            "range begins at {low}, and {} is never below {least}: write type = \"{}\" where the device counts below 0",
            own.as_str(),
            own.as_str().replacen('u', "i", 1)
        ));
    }
    let far = high - low > BEYOND * (most - least);
    far.then(|| {
        format!(
            "range = [{low}, {high}], and {} with this scale is {least} to {most}: range is in the tag's own unit, after scaling",
            own.as_str()
        )
    })
}

/// A span of OP that its register cannot come near: f in per cent of it would be as many times too small.
fn never_covered(own: &LoopConfig) -> Option<String> {
    let op = own.op.as_modbus()?;
    let ([least, most], kind) = (op.reach()?, op.effective_type()?);
    let limits = own.op_limits.map(|[low, high]| (low, high));
    let span = Scale { given: own.op_span, limits, unit: own.op.unit() }.span(&[]).0?;
    (span > BEYOND * (most - least)).then(|| {
        format!(
            "{}.op: its span is {span}, and {} with this scale is {} to {}: op_span, op_limits and unit are those of OP after \
             scaling, or f is told far too small",
            own.id,
            kind.as_str(),
            figures(least),
            figures(most)
        )
    })
}

/// A mode of which every value counts as automatic.
fn always_automatic(own: &LoopConfig) -> Option<String> {
    let mode = own.mode.as_ref()?.as_modbus()?;
    let values = mode.auto_values.as_ref()?;
    let bit = mode.effective_type() == Some(modbus::ValueType::Bit);
    (bit && values.contains(&0) && values.contains(&1)).then(|| {
        format!(
            "{}.mode: 0 and 1 are both automatic, and a bit is nothing else: name the one that is",
            own.id
        )
    })
}

/// A term that is still on its way to zero when the daemon is killed.
fn slow_end(own: &LoopConfig) -> Option<String> {
    let writeback = own.writeback.as_ref().filter(|own| own.enabled)?;
    let end = writeback.longest_end_s();
    (end > STOP_S).then(|| {
        format!(
            "{}.writeback: its term may take {end} s to reach zero (withdraw_limit_s + max_step_ms + 2 s), and the service files in \
             deploy/ kill the daemon {STOP_S} s after a stop: raise that time, or lower withdraw_limit_s",
            own.id
        )
    })
}

#[cfg(test)]
mod tests;
