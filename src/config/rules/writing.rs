//! Rules of write-back: registers of its own that nothing else uses, everything there that the gate has to see.

use super::super::plant;
use super::super::section::Parts;
use super::super::source::Step;
use super::super::{LoopConfig, TagConfig};
use super::{Device, Rules, tag_path};
use crate::collect::modbus::{self, Framing, Register, ValueType};
use crate::host::host_and_port;
use crate::writeback;

/// Holding registers in use, and by what.
struct Taken {
    /// Where it is: two entries may be one device.
    device: Endpoint,
    from: u32,
    to: u32,
    what: String,
    line: usize,
}

/// Where a device is.
#[derive(Clone)]
struct Endpoint {
    host: String,
    port: u16,
    unit_id: u8,
}

impl Endpoint {
    /// Whatever the address is written like: `PLC1.:502` is `plc1:502`, and `127.0.0.1` is `localhost`.
    fn of(device: &modbus::Config) -> Option<Self> {
        let (host, port) = host_and_port(&device.address).ok()?;
        let host = host.trim_end_matches('.').to_lowercase();
        let is_here = ["127.0.0.1", "::1"].contains(&host.as_str());
        let host = if is_here { "localhost".into() } else { host };
        Some(Self { host, port, unit_id: device.unit_id })
    }

    /// Whether both may be one device. The first label of a host's name may stand for the whole, and the units 0 and 255 for
    /// the one device that is there.
    fn may_be(&self, other: &Self) -> bool {
        let short =
            |a: &str, b: &str| b.strip_prefix(a).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'));
        let one_host = short(&self.host, &other.host) || short(&other.host, &self.host);
        let any = |unit: u8| unit == 0 || unit == 255;
        let one_unit = self.unit_id == other.unit_id || any(self.unit_id) || any(other.unit_id);
        one_host && self.port == other.port && one_unit
    }
}

impl Rules<'_, '_, '_> {
    pub(super) fn writing(&mut self, parts: &Parts) {
        let mut taken = self.registers_read(parts);
        for (at, control_loop) in parts.loops.iter().enumerate() {
            let Some(control_loop) = control_loop else { continue };
            let Some(own) = &control_loop.writeback else { continue };
            for (field, message) in own.validate() {
                self.wrong(&path!["loop", at, "writeback", field], format!("{field}: {message}"));
            }
            self.needed(at, control_loop, own, parts);
            self.registers_written(at, control_loop, own, parts, &mut taken);
        }
    }

    /// What the gate cannot do without.
    fn needed(&mut self, at: usize, control_loop: &LoopConfig, own: &writeback::LoopConfig, parts: &Parts) {
        let here = |field: &str| path!["loop", at, "writeback", field].to_vec();
        let there = [
            ("[loop.mode]", control_loop.mode.is_some()),
            ("[loop.sp]", control_loop.sp.is_some()),
            ("op_span", control_loop.op_span.is_some()),
            ("op_limits", control_loop.op_limits.is_some()),
            ("frozen_pv_s", control_loop.frozen_pv_s.is_some()),
        ];
        for (what, _) in there.iter().filter(|(_, there)| !there) {
            let message = format!("enabled: write-back needs {what}, which the loop does not have");
            self.unless(!own.enabled, &here("enabled"), || message.clone());
        }
        let told = control_loop.mode.as_ref().is_none_or(tells_automatic);
        self.unless(!own.enabled || told, &here("enabled"), || {
            "enabled: write-back needs auto_values in [loop.mode]: without them every mode but 0 counts as automatic, and many \
             controllers count manual from 1"
                .into()
        });
        self.unless(!own.enabled || writeback::BUILT_IN, &here("enabled"), || {
            "enabled: this stictiond cannot write: it was built without the cargo feature \"writeback\"; use a build \
             that has it, or set enabled = false"
                .into()
        });
        let audited = parts.writeback.as_ref().is_none_or(|c| c.audit_file.is_some());
        self.unless(!own.enabled || audited, &here("enabled"), || {
            "enabled: write-back needs an audit log: set [writeback] audit_file".into()
        });
    }

    /// Every holding register that some tag reads.
    fn registers_read(&self, parts: &Parts) -> Vec<Taken> {
        let mut taken = Vec::new();
        for (at, control_loop) in parts.loops.iter().enumerate() {
            let Some(control_loop) = control_loop else { continue };
            let tags: Vec<_> = plant::tags(control_loop).collect();
            for (tag_at, (role, tag)) in tags.iter().enumerate() {
                let Some(tag) = tag.as_modbus() else { continue };
                let device = self.device(&tag.device, parts);
                let Some((device, width)) = device.zip(tag.effective_type().map(|t| t.width())) else {
                    continue;
                };
                let Some(start) = tag.wire_address(device).filter(|_| tag.register == Register::Holding)
                else {
                    continue;
                };
                let name = role.map_or_else(|| tag.name.clone().unwrap_or_default(), |r| r.as_str().into());
                let path = [&tag_path(at, tag_at, &tags)[..], &path!["address"]].concat();
                let Some(endpoint) = Endpoint::of(device) else { continue };
                taken.push(Taken {
                    device: endpoint,
                    from: u32::from(start),
                    to: u32::from(start) + u32::from(width),
                    what: format!("{name} of loop {}", control_loop.id),
                    line: self.report.line(self.source.place(&path)),
                });
            }
        }
        taken
    }

    fn registers_written(
        &mut self,
        at: usize,
        control_loop: &LoopConfig,
        own: &writeback::LoopConfig,
        parts: &Parts,
        taken: &mut Vec<Taken>,
    ) {
        let here = |field: &str| path!["loop", at, "writeback", field].to_vec();
        let Some(device) = self.device(&own.device, parts) else {
            if !matches!(self.devices.get(own.device.as_str()), Some(Device::Modbus(_))) {
                let message = format!("device: no [[modbus]] is called {:?}", own.device);
                self.wrong(&here("device"), message);
            }
            return;
        };
        self.unless(device.unit_id != 0 || !own.enabled, &here("device"), || {
            format!(
                "device: {:?} has unit_id = 0, which a gateway takes for every unit behind it: write the unit's own number, or \
                 255 for the device at the address itself",
                device.name
            )
        });
        if let Some(key) = not_for_two(device).filter(|_| own.enabled) {
            let message = format!(
                "device: {:?} has {key}, and write-back needs a second Modbus/TCP connection: name a [[modbus]] device that \
                 accepts two, such as the controller itself or another gateway, or set enabled = false",
                device.name
            );
            self.wrong(&here("device"), message);
        }
        let Some(unit) = Endpoint::of(device) else { return };
        for (field, start, width) in own.registers(device.address_base) {
            let Some(start) = start.map(u32::from) else {
                let base = i64::from(device.address_base);
                let last = 65_536 - i64::from(width) + base;
                let message = format!("{field}: must be {base} to {last} (address_base = {base})");
                self.wrong(&here(field), message);
                continue;
            };
            let end = start + u32::from(width);
            let meets = |other: &&Taken| other.device.may_be(&unit) && other.from < end && start < other.to;
            if let Some(other) = taken.iter().find(meets) {
                let message = format!(
                    "{field}: overlaps {} (line {}); write-back needs registers of its own and never writes what \
                     another uses",
                    other.what, other.line
                );
                self.wrong(&here(field), message);
            }
            taken.push(Taken {
                device: unit.clone(),
                from: start,
                to: end,
                what: format!("{field} of loop {}", control_loop.id),
                line: self.report.line(self.source.place(&here(field))),
            });
        }
    }

    fn device<'p>(&self, name: &str, parts: &'p Parts) -> Option<&'p modbus::Config> {
        match self.devices.get(name)? {
            Device::Modbus(at) => parts.modbus[*at].as_ref(),
            Device::Opcua | Device::Mqtt(_) => None,
        }
    }
}

/// Whether a mode says by itself what automatic is: a bit, or a number whose meaning is written down.
fn tells_automatic(mode: &TagConfig) -> bool {
    match mode {
        TagConfig::Modbus(tag) => tag.auto_values.is_some() || tag.effective_type() == Some(ValueType::Bit),
        TagConfig::Opcua(tag) => tag.auto_values.is_some(),
        TagConfig::Mqtt(tag) => tag.auto_values.is_some(),
        TagConfig::Forwarded(_) => false,
    }
}

/// What of a device leaves no room for a connection of write-back's own.
fn not_for_two(device: &modbus::Config) -> Option<&'static str> {
    match (device.framing, device.share_connection) {
        (Framing::Rtu, _) => Some("framing = \"rtu\""),
        (Framing::Tcp, true) => Some("share_connection = true"),
        (Framing::Tcp, false) => None,
    }
}
