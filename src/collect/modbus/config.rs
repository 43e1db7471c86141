//! What the configuration file says about a Modbus device and about a tag's place in it.

use super::kinds::{ByteOrder, Register, ValueType};
use crate::collect::Issue;
use crate::collect::scaling::Scaling;
use crate::host::{host_and_port, shown};
use crate::signal::Role;
use serde::Deserialize;
use std::ops::RangeInclusive;

/// Most registers that one answer can carry (Modbus application protocol V1.1b3, 6.3).
pub(super) const MAX_REGISTERS: u16 = 125;
/// Most coils or discrete inputs that one answer can carry (6.1).
pub(super) const MAX_BITS: u16 = 2000;

/// One Modbus/TCP device, `[[modbus]]`. Every entry has a task of its own and, unless `share_connection` says
/// otherwise, a connection, so several units behind one gateway are several entries with the same address.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Name that tags refer to.
    pub name: String,
    /// `host:port`, `10.0.0.5:502` or `[fd00::5]:502`.
    pub address: String,
    /// Unit identifier; 1 for most devices, the slave's number behind a gateway.
    #[serde(default = "default_unit_id")]
    pub unit_id: u8,
    /// How requests are framed on the connection.
    #[serde(default)]
    pub framing: Framing,
    /// One connection for all entries with this address and this set, each unit in its turn: for gateways that
    /// take one connection only.
    #[serde(default)]
    pub share_connection: bool,
    /// Least pause between an answer and the next request on the same connection (ms); 0 for none.
    #[serde(default)]
    pub min_gap_ms: u64,
    /// Poll period (ms).
    #[serde(default = "default_poll_ms")]
    pub poll_ms: u64,
    /// Longest wait for a connection and for each answer (ms); at most `poll_ms`.
    #[serde(default = "default_timeout_ms")]
    pub timeout_ms: u64,
    /// Longest pause between attempts to reconnect (ms).
    #[serde(default = "default_reconnect_max_ms")]
    pub reconnect_max_ms: u64,
    /// 0 when the device's documentation counts registers from 0 (as on the wire), 1 when from 1. Required,
    /// because a wrong guess reads the neighbour's value. Leave out the leading 3 or 4 of `40001` notation.
    pub address_base: u8,
    /// Most registers asked for at once, 1 to 125.
    #[serde(default = "default_max_registers")]
    pub max_registers_per_request: u16,
    /// Most coils or discrete inputs asked for at once, 1 to 2000.
    #[serde(default = "default_max_bits")]
    pub max_bits_per_request: u16,
    /// Registers nobody asked for that may be read along, to save a request.
    #[serde(default = "default_max_gap")]
    pub max_gap: u16,
    /// What of an answer's head may differ from the request's; nothing unless it is named.
    #[serde(default)]
    pub tolerate: Vec<Tolerated>,
    /// Byte order of the device's tags that name none.
    #[serde(default)]
    pub byte_order: ByteOrder,
}

fn default_unit_id() -> u8 {
    1
}
fn default_poll_ms() -> u64 {
    1000
}
fn default_timeout_ms() -> u64 {
    500
}
fn default_reconnect_max_ms() -> u64 {
    30_000
}
fn default_max_registers() -> u16 {
    MAX_REGISTERS
}
fn default_max_bits() -> u16 {
    MAX_BITS
}
fn default_max_gap() -> u16 {
    8
}

/// How requests are framed on a TCP connection.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Framing {
    /// Modbus/TCP: a head with the transaction's number.
    #[default]
    Tcp,
    /// RTU frames with a check sum, as on a serial line: gateways that pass bytes through.
    Rtu,
}

/// A part of an answer's head that some gateways do not give back as it was sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Tolerated {
    /// Any transaction's number. Nothing tells then whether an answer is that of this request.
    TransactionId,
    /// The unit identifiers 0, 1 and 255, by which gateways mean themselves.
    UnitId,
}

/// Where a tag lives in a Modbus device and how its value is made: `[loop.op]`, `[[loop.tag]]`, ….
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TagConfig {
    /// Name of an extra tag; the five roles of a loop have none.
    #[serde(default)]
    pub name: Option<String>,
    /// Name of the device.
    pub device: String,
    /// Which of the device's four tables.
    pub register: Register,
    /// Address of the (first) register, counted from the device's `address_base`.
    pub address: i64,
    /// How registers become a number; left out for coils and discrete inputs, which are bits.
    #[serde(default, rename = "type")]
    pub value_type: Option<ValueType>,
    /// Byte order, where it differs from the device's.
    #[serde(default)]
    pub byte_order: Option<ByteOrder>,
    /// Which bit of the register, 0 the least significant; for `type = "bit"` only.
    #[serde(default)]
    pub bit: Option<u8>,
    /// value = scale * raw + offset.
    #[serde(default = "crate::collect::scaling::unscaled")]
    pub scale: f64,
    /// See `scale`.
    #[serde(default)]
    pub offset: f64,
    /// Least and greatest believable value, after scaling.
    #[serde(default, deserialize_with = "crate::collect::pair::pair")]
    pub range: Option<[f64; 2]>,
    /// Engineering unit, for people.
    #[serde(default)]
    pub unit: Option<String>,
    /// Of a mode tag: the raw values that mean automatic. Without it, anything but 0 does.
    #[serde(default)]
    pub auto_values: Option<Vec<i64>>,
}

/// Collects issues.
struct Issues(Vec<Issue>);

impl Issues {
    fn unless(&mut self, ok: bool, field: &'static str, message: impl FnOnce() -> String) {
        if !ok {
            self.0.push(Issue { field, message: message() });
        }
    }
}

impl Config {
    /// Everything wrong with the device's own fields; empty when it can be polled.
    pub fn validate(&self) -> Vec<Issue> {
        let mut issues = Issues(Vec::new());
        issues.unless(!self.name.trim().is_empty(), "name", || "a device needs a name".into());
        if let Err(why) = host_and_port(&self.address) {
            let message =
                || format!("'{}' is not host:port, such as 10.0.0.5:502: {why}", shown(&self.address));
            issues.unless(false, "address", message);
        }
        issues.unless((1..=86_400_000).contains(&self.poll_ms), "poll_ms", || {
            format!("{} must be 1 to 86400000", self.poll_ms)
        });
        issues.unless(self.timeout_ms >= 1, "timeout_ms", || "must be at least 1".into());
        if self.poll_ms > 0 && self.timeout_ms > self.poll_ms {
            let (timeout, poll) = (self.timeout_ms, self.poll_ms);
            let why = "one lost answer would cost the next poll";
            // The default stands in no file, so what the file may have is told.
            let (field, message) = match timeout == default_timeout_ms() {
                true => (
                    "poll_ms",
                    format!(
                        "{poll} is shorter than timeout_ms = {timeout}: {why}; poll more slowly, or write a shorter timeout_ms"
                    ),
                ),
                false => (
                    "timeout_ms",
                    format!(
                        "{timeout} is longer than poll_ms = {poll}: {why}; write {poll} or less, or a longer poll_ms"
                    ),
                ),
            };
            issues.unless(false, field, || message);
        }
        issues.unless((1..=86_400_000).contains(&self.reconnect_max_ms), "reconnect_max_ms", || {
            "must be 1 to 86400000".into()
        });
        issues.unless(self.poll_ms == 0 || self.min_gap_ms <= self.poll_ms, "min_gap_ms", || {
            format!(
                "{} is longer than poll_ms = {}: no poll could be finished",
                self.min_gap_ms, self.poll_ms
            )
        });
        issues.unless(self.address_base <= 1, "address_base", || {
            format!("{} must be 0 or 1{WHICH_BASE}", self.address_base)
        });
        let registers = self.max_registers_per_request;
        issues.unless((1..=MAX_REGISTERS).contains(&registers), "max_registers_per_request", || {
            format!("{registers} must be 1 to {MAX_REGISTERS}, the most one answer can carry")
        });
        let bits = self.max_bits_per_request;
        issues.unless((1..=MAX_BITS).contains(&bits), "max_bits_per_request", || {
            format!("{bits} must be 1 to {MAX_BITS}, the most one answer can carry")
        });
        issues.unless(self.max_gap <= MAX_REGISTERS, "max_gap", || {
            format!("{} must be at most {MAX_REGISTERS}", self.max_gap)
        });
        let numbered = self.framing == Framing::Tcp || !self.tolerate.contains(&Tolerated::TransactionId);
        issues.unless(numbered, "tolerate", || "a frame of RTU has no transaction_id".into());
        issues.0
    }
}

impl TagConfig {
    /// The type, with the default of bits for tables of bits.
    pub fn effective_type(&self) -> Option<ValueType> {
        self.value_type.or(self.register.is_bits().then_some(ValueType::Bit))
    }

    /// The least and the greatest value that the type can send, after scaling; `None` where it has a fraction.
    pub fn reach(&self) -> Option<[f64; 2]> {
        let [a, b] = self.effective_type()?.raw_range()?.map(|raw| raw * self.scale + self.offset);
        (a.is_finite() && b.is_finite()).then(|| [a.min(b), a.max(b)])
    }

    /// Address on the wire, counted from 0, when the whole value lies inside the device's 65536 addresses.
    pub fn wire_address(&self, device: &Config) -> Option<u16> {
        let start = self.address.checked_sub(i64::from(device.address_base))?;
        let last = start.checked_add(i64::from(self.effective_type()?.width()) - 1)?;
        u16::try_from(last).ok()?;
        u16::try_from(start).ok()
    }

    /// What an address stands for whose first of so many digits names the kind of register, 40101 for holding register 101.
    fn notation(&self, digits: u32) -> Option<i64> {
        let first = match self.register {
            Register::Coil => 0,
            Register::Discrete => 1,
            Register::Input => 3,
            Register::Holding => 4,
        };
        let unit = 10i64.pow(digits - 1);
        let number = self.address - first * unit;
        (first > 0 && (1..unit).contains(&number)).then_some(number)
    }

    /// What is right by itself and often meant otherwise, on a device that counts from `base`.
    pub fn remark(&self, base: u8) -> Option<String> {
        let (address, register) = (self.address, self.register);
        let read =
            format!("address = {address} is read as {register} register {address}; where the device's list");
        if let Some(number) = self.notation(5) {
            let write = counted("address", number, base);
            return Some(format!("{read} writes the kind of register as the first digit, write {write}"));
        }
        let is_input = register == Register::Holding && INPUTS.contains(&address);
        is_input.then(|| {
            let write = counted("address", address - INPUTS.start(), base);
            format!(
                "{read} means an input register by the first digit, write register = \"input\" and {write}"
            )
        })
    }

    /// What its raw numbers mean.
    pub(super) fn scaling(&self) -> Scaling {
        let Self { scale, offset, range, .. } = *self;
        Scaling { scale, offset, range, auto_values: self.auto_values.clone() }
    }

    /// Everything wrong with the tag, on this device and in this role (`None` for an extra tag).
    pub fn validate(&self, device: &Config, role: Option<Role>) -> Vec<Issue> {
        let mut issues = Issues(Vec::new());
        self.validate_type(device, &mut issues);
        self.validate_reach(&mut issues);
        issues.0.extend(self.scaling().validate(role));
        issues.0
    }

    /// What a whole number of this type can never be.
    fn validate_reach(&self, issues: &mut Issues) {
        let Some((value_type, [least, most])) =
            self.effective_type().and_then(|own| Some((own, own.raw_range()?)))
        else {
            return;
        };
        let beyond = |value: &&i64| !(least..=most).contains(&(**value as f64));
        if let Some(value) = self.auto_values.iter().flatten().find(beyond) {
            let what = match self.register {
                Register::Coil => "a coil",
                Register::Discrete => "a discrete input",
                _ => value_type.as_str(),
            };
            let message = || format!("{value} never comes: {what} is {least} to {most}");
            issues.unless(false, "auto_values", message);
        }
        let met = |[from, to]: [f64; 2]| self.reach().is_none_or(|[least, most]| from <= most && to >= least);
        if let (Some(range), Some([least, most])) = (self.range.filter(|range| !met(*range)), self.reach()) {
            issues.unless(false, "range", || {
                format!(
                    "[{}, {}] is never met: {} with this scale and offset is {least} to {most}",
                    range[0],
                    range[1],
                    value_type.as_str()
                )
            });
        }
    }

    fn validate_type(&self, device: &Config, issues: &mut Issues) {
        let bits = self.register.is_bits();
        let Some(value_type) = self.effective_type() else {
            issues.unless(false, "type", || {
                format!("a {} register needs a type: u16 i16 u32 i32 u64 i64 f32 f64 bit", self.register)
            });
            return;
        };
        issues.unless(!bits || value_type == ValueType::Bit, "type", || {
            format!("a {} is a single bit; leave the type out or write \"bit\"", self.register)
        });
        let base = i64::from(device.address_base);
        let width = value_type.width();
        issues.unless(self.wire_address(device).is_some(), "address", || {
            let last = 65536 - i64::from(width) + base;
            let number = self.notation(6).map(|number| {
                let write = counted("address", number, device.address_base);
                format!("; the first digit names the kind of register: write {write}")
            });
            let from_zero = || ": where the device's list begins with 0, write address_base = 0".to_string();
            let number =
                number.or_else(|| (self.address == 0 && base == 1).then(from_zero)).unwrap_or_default();
            format!("{} must be {base} to {last} (address_base = {base}){number}", self.address)
        });
        let most = device.max_registers_per_request;
        issues.unless(bits || width <= most, "type", || {
            format!("takes {width} registers, but max_registers_per_request = {most}")
        });
        let needs_bit = !bits && value_type == ValueType::Bit;
        match self.bit {
            None => issues.unless(!needs_bit, "bit", || {
                "type = \"bit\" needs it: write the bit's number, 0 to 15".into()
            }),
            Some(bit) => {
                issues.unless(needs_bit, "bit", || {
                    "only for type = \"bit\" in a holding or input register".into()
                });
                issues.unless(bit <= 15, "bit", || format!("{bit} must be 0 to 15"));
            }
        }
        issues.unless(!bits || self.byte_order.is_none(), "byte_order", || {
            format!("a {} has no bytes to order", self.register)
        });
    }
}

/// How it is found out from which number a device counts its registers.
pub const WHICH_BASE: &str = ": write 0 where the device's list counts registers from 0, 1 where from 1";

/// Input registers as lists write them whose first digit is the kind: number 1 is 30001.
const INPUTS: RangeInclusive<i64> = 30_000..=39_999;

/// How register `number` of a list that counts from 1 is written on a device that counts from `base`.
pub fn counted(key: &str, number: i64, base: u8) -> String {
    match base {
        0 => format!("{key} = {}, counted from 0", number - 1),
        _ => format!("{key} = {number}"),
    }
}

#[cfg(test)]
#[path = "config_tests.rs"]
mod tests;
