//! The configuration as the parts want it: loops with numbered tags, devices with planned requests.

use super::{Config, LoopConfig};
use crate::collect::modbus::{self, Issue, Plan};
use crate::history::{self, LoopTags, TagKind};
use crate::signal::{LoopId, Role};
use std::collections::HashMap;

/// Who is watched and who is polled. Tags are numbered through all loops: op, pv, sp, mode, mv, then the others.
#[derive(Clone, Debug)]
pub struct Plant {
    /// The loops, in the file's order; a tag's number counts through them.
    pub loops: Vec<LoopTags>,
    /// One plan per device, in the file's order.
    pub plans: Vec<Plan>,
}

impl Config {
    /// Numbers the tags and plans the requests.
    ///
    /// # Errors
    /// What [`Plan::new`] finds; nothing for a configuration that [`load`](super::load) accepted.
    pub fn plant(&self) -> Result<Plant, Vec<Issue>> {
        let mut specs: Vec<Vec<modbus::TagSpec>> = vec![Vec::new(); self.modbus.len()];
        let devices: HashMap<&str, usize> =
            self.modbus.iter().enumerate().map(|(at, device)| (device.name.as_str(), at)).collect();
        let mut loops = Vec::with_capacity(self.loops.len());
        let mut index = 0;
        for control_loop in &self.loops {
            let mut own = Vec::new();
            for (role, tag) in tags(control_loop) {
                let kind = kind(role, tag);
                if let Some(&at) = devices.get(tag.device.as_str()) {
                    own.push(history::TagSpec {
                        unit: tag.unit.clone().unwrap_or_default(),
                        source: source(&self.modbus[at], tag),
                        kind: kind.clone(),
                    });
                    specs[at].push(modbus::TagSpec {
                        index,
                        name: format!("{}.{}", control_loop.id, kind.name()),
                        role,
                        config: tag.clone(),
                        frozen_after_s: control_loop.frozen_pv_s.filter(|_| role == Some(Role::Pv)),
                    });
                    index += 1;
                }
            }
            loops.push(LoopTags {
                id: LoopId::new(control_loop.id.as_str()),
                tags: own,
                op_limits: control_loop.op_limits.map(|[low, high]| (low, high)),
                op_span: control_loop.op_span,
            });
        }
        let plan = |(at, specs)| Plan::new(at, &self.modbus[at], specs);
        let plans = specs.into_iter().enumerate().map(plan).collect::<Result<_, _>>()?;
        Ok(Plant { loops, plans })
    }

    /// Time between two diagnoses of a loop (s).
    pub fn period_s(&self, control_loop: &LoopConfig) -> f64 {
        control_loop.period_s.unwrap_or(self.schedule.period_s)
    }
}

/// A loop's tags in the order of their numbers.
pub fn tags(control_loop: &LoopConfig) -> impl Iterator<Item = (Option<Role>, &modbus::TagConfig)> {
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

/// The key of a role in `[[loop]]`.
pub fn role_name(role: Role) -> &'static str {
    match role {
        Role::Op => "op",
        Role::Pv => "pv",
        Role::Sp => "sp",
        Role::Mode => "mode",
        Role::Mv => "mv",
    }
}

fn kind(role: Option<Role>, tag: &modbus::TagConfig) -> TagKind {
    match role {
        Some(role) => TagKind::Role(role),
        None => TagKind::Extra(tag.name.clone().unwrap_or_default()),
    }
}

/// Everything that decides which number a sample of the tag is.
fn source(device: &modbus::Config, tag: &modbus::TagConfig) -> String {
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
    if tag.scale != 1.0 || tag.offset != 0.0 {
        text += &format!(" x {} + {}", tag.scale, tag.offset);
    }
    if let Some([low, high]) = tag.range {
        text += &format!(" in {low} to {high}");
    }
    if let Some(values) = &tag.auto_values {
        text += &format!(" automatic {values:?}");
    }
    text
}
