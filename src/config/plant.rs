//! The configuration as the parts want it: loops with numbered tags, devices with planned requests.

use super::{Config, LoopConfig, TagConfig};
use crate::collect::{DecimalSign, Issue, Plan, modbus, mqtt, opcua};
use crate::history::{self, LoopTags, TagKind};
use crate::signal::{LoopId, Role, Scale};
use std::collections::HashMap;

/// Who is watched and who is asked. Tags are numbered through all loops: op, pv, sp, mode, mv, the others, then the term of
/// write-back.
#[derive(Clone, Debug)]
pub struct Plant {
    /// The loops, in the file's order; a tag's number counts through them.
    pub loops: Vec<LoopTags>,
    /// One plan per Modbus device, in the file's order.
    pub plans: Vec<modbus::Plan>,
    /// One plan per OPC UA server, in the file's order; their numbers follow those of the Modbus devices.
    pub opcua: Vec<opcua::Plan>,
    /// One plan per MQTT broker, in the file's order; their numbers follow those of the OPC UA servers.
    pub mqtt: Vec<mqtt::Plan>,
}

impl Plant {
    /// All plans, each at its device's number.
    pub fn into_plans(self) -> impl Iterator<Item = Plan> {
        let polled = self.plans.into_iter().map(Plan::Modbus).chain(self.opcua.into_iter().map(Plan::Opcua));
        polled.chain(self.mqtt.into_iter().map(Plan::Mqtt))
    }
}

impl Config {
    /// Numbers the tags and plans the requests.
    ///
    /// # Errors
    /// What [`modbus::Plan::new`], [`opcua::Plan::new`] and [`mqtt::Plan::new`] find; nothing for a configuration that
    /// [`load`](super::load) accepted.
    pub fn plant(&self) -> Result<Plant, Vec<Issue>> {
        let mut registers: Vec<Vec<modbus::TagSpec>> = vec![Vec::new(); self.modbus.len()];
        let mut nodes: Vec<Vec<opcua::TagSpec>> = vec![Vec::new(); self.opcua.len()];
        let mut topics: Vec<Vec<mqtt::TagSpec>> = vec![Vec::new(); self.mqtt.len()];
        let devices = positions(self.modbus.iter().map(|device| device.name.as_str()));
        let servers = positions(self.opcua.iter().map(|server| server.name.as_str()));
        let brokers = positions(self.mqtt.iter().map(|broker| broker.name.as_str()));
        let mut loops = Vec::with_capacity(self.loops.len());
        let mut index = 0;
        for control_loop in &self.loops {
            let mut own = Vec::new();
            for (role, tag) in tags(control_loop) {
                let kind = kind(role, tag);
                let name = format!("{}.{}", control_loop.id, kind.name());
                let frozen_after_s = control_loop.frozen_pv_s.filter(|_| role == Some(Role::Pv));
                let source = match tag {
                    TagConfig::Modbus(tag) => devices.get(tag.device.as_str()).map(|&at| {
                        let config = tag.clone();
                        registers[at].push(modbus::TagSpec { index, name, role, config, frozen_after_s });
                        source_in_registers(&self.modbus[at], tag)
                    }),
                    TagConfig::Opcua(tag) => servers.get(tag.device.as_str()).map(|&at| {
                        let config = tag.clone();
                        nodes[at].push(opcua::TagSpec { index, name, role, config, frozen_after_s });
                        source_in_nodes(&self.opcua[at], tag)
                    }),
                    TagConfig::Mqtt(tag) => brokers.get(tag.device.as_str()).map(|&at| {
                        let config = tag.clone();
                        topics[at].push(mqtt::TagSpec { index, name, role, config, frozen_after_s });
                        source_at_broker(&self.mqtt[at], tag)
                    }),
                    TagConfig::Forwarded(tag) => Some(tag.source.clone()),
                };
                if let Some(source) = source {
                    let unit = tag.unit().unwrap_or_default().to_string();
                    own.push(history::TagSpec { unit, source, kind });
                    index += 1;
                }
            }
            if control_loop.writeback.is_some() {
                // Nobody polls it: write-back itself says what it has in force.
                let unit = control_loop.op.unit().unwrap_or_default().to_string();
                let kind = TagKind::Role(Role::Term);
                own.push(history::TagSpec { unit, source: "write-back".to_string(), kind });
                index += 1;
            }
            let limits = control_loop.op_limits.map(|[low, high]| (low, high));
            let scale = Scale { given: control_loop.op_span, limits, unit: control_loop.op.unit() };
            let (op_span, op_span_source) = scale.span(&[]);
            loops.push(LoopTags {
                id: LoopId::new(control_loop.id.as_str()),
                tags: own,
                op_limits: limits,
                op_span,
                op_span_source,
            });
        }
        let plan = |(at, specs)| modbus::Plan::new(at, &self.modbus[at], specs);
        let plans = registers.into_iter().enumerate().map(plan).collect::<Result<_, _>>()?;
        let plan = |(at, specs)| opcua::Plan::new(self.modbus.len() + at, &self.opcua[at], specs);
        let opcua = nodes.into_iter().enumerate().map(plan).collect::<Result<_, _>>()?;
        let first = self.modbus.len() + self.opcua.len();
        let plan = |(at, specs)| mqtt::Plan::new(first + at, &self.mqtt[at], specs);
        let mqtt = topics.into_iter().enumerate().map(plan).collect::<Result<_, _>>()?;
        Ok(Plant { loops, plans, opcua, mqtt })
    }

    /// Time between two diagnoses of a loop (s).
    pub fn period_s(&self, control_loop: &LoopConfig) -> f64 {
        control_loop.period_s.unwrap_or(self.schedule.period_s)
    }
}

/// A loop's tags in the order of their numbers.
pub fn tags(control_loop: &LoopConfig) -> impl Iterator<Item = (Option<Role>, &TagConfig)> {
    let roles = [
        (Role::Op, Some(&control_loop.op)),
        (Role::Pv, Some(&control_loop.pv)),
        (Role::Sp, control_loop.sp.as_ref()),
        (Role::Mode, control_loop.mode.as_ref()),
        (Role::Mv, control_loop.mv.as_ref()),
    ];
    let roles = roles.into_iter().filter_map(|(role, tag)| Some((Some(role), tag?)));
    roles.chain(control_loop.tag.iter().map(|tag| (None, tag)))
}

fn positions<'n>(names: impl Iterator<Item = &'n str>) -> HashMap<&'n str, usize> {
    names.enumerate().map(|(at, name)| (name, at)).collect()
}

pub(super) fn kind(role: Option<Role>, tag: &TagConfig) -> TagKind {
    match role {
        Some(role) => TagKind::Role(role),
        None => TagKind::Extra(tag.name().unwrap_or_default().into()),
    }
}

/// Everything that decides which number a sample of the tag is.
fn source_in_registers(device: &modbus::Config, tag: &modbus::TagConfig) -> String {
    let order = tag.byte_order.unwrap_or(device.byte_order);
    let mut text = format!(
        "modbus {} unit {} {} {} from {}",
        device.address, device.unit_id, tag.register, tag.address, device.address_base
    );
    if let Some(value_type) = tag.effective_type() {
        text += &format!(" {value_type:?}").to_lowercase();
    }
    if !tag.register.is_bits() {
        text += &format!(" {}", order.as_str());
    }
    if let Some(bit) = tag.bit {
        text += &format!(" bit {bit}");
    }
    text + &meaning(tag.scale, tag.offset, tag.range, tag.auto_values.as_deref())
}

/// As [`source_in_registers`]; how the server is asked is no part of it, but for the time of a value.
fn source_in_nodes(server: &opcua::Config, tag: &opcua::TagConfig) -> String {
    let place = tag.node.as_deref().or(tag.path.as_deref()).unwrap_or_default();
    let element = tag.element.map(|at| format!("[{at}]")).unwrap_or_default();
    let (time, decimal) = (server.source_time_fallback, decimal(tag.decimal));
    format!("opcua {} {place}{element}{decimal} time {time:?}", server.url)
        + &meaning(tag.scale, tag.offset, tag.range, tag.auto_values.as_deref())
}

/// As [`source_in_nodes`].
fn source_at_broker(broker: &mqtt::Config, tag: &mqtt::TagConfig) -> String {
    let place = match (&tag.topic, &tag.sparkplug) {
        (Some(topic), _) => format!("{topic} {}", tag.path.as_deref().unwrap_or_default()),
        (None, place) => format!("{place:?} {:?} {:?}", tag.metric, tag.alias),
    };
    let time = tag.time_path.as_ref().or(broker.time_path.as_ref());
    let (unit, fallback) = (broker.time_unit, broker.time_fallback);
    let decimal = decimal(tag.decimal);
    format!("mqtt {} {place}{decimal} time {time:?} {unit:?} {fallback:?}", broker.address)
        + &meaning(tag.scale, tag.offset, tag.range, tag.auto_values.as_deref())
}

/// A sign that was not told is no part of a source: it is the text's own.
fn decimal(sign: Option<DecimalSign>) -> String {
    sign.map(|sign| format!(" decimal {sign:?}")).unwrap_or_default()
}

fn meaning(scale: f64, offset: f64, range: Option<[f64; 2]>, auto_values: Option<&[i64]>) -> String {
    let mut text = String::new();
    if scale != 1.0 || offset != 0.0 {
        text += &format!(" x {scale} + {offset}");
    }
    if let Some([low, high]) = range {
        text += &format!(" in {low} to {high}");
    }
    if let Some(values) = auto_values {
        text += &format!(" automatic {values:?}");
    }
    text
}
