//! A tag of a loop, on whatever kind of device: its keys say which.

use super::wording::{self, close};
use crate::collect::{DecimalSign, modbus, mqtt, opcua};
use serde::{Deserialize, Deserializer, de};

/// Where a tag is read and how its value is made: `[loop.op]`, `[[loop.tag]]`, …
#[derive(Clone, Debug, PartialEq)]
pub enum TagConfig {
    /// With `register` and `address`.
    Modbus(modbus::TagConfig),
    /// With `node` or `path`.
    Opcua(opcua::TagConfig),
    /// With `topic` or `sparkplug`.
    Mqtt(mqtt::TagConfig),
    /// Read by an edge, which forwards it; no file has one.
    Forwarded(ForwardedTag),
}

/// A tag that an edge reads and a centre shows.
#[derive(Clone, Debug, PartialEq)]
pub struct ForwardedTag {
    /// Name of an extra tag.
    pub name: Option<String>,
    /// The collector, with its site.
    pub device: String,
    /// Where the edge reads it and how it is decoded.
    pub source: String,
    /// Engineering unit, for people.
    pub unit: Option<String>,
}

impl TagConfig {
    /// Name of an extra tag.
    pub fn name(&self) -> Option<&str> {
        match self {
            Self::Modbus(tag) => tag.name.as_deref(),
            Self::Opcua(tag) => tag.name.as_deref(),
            Self::Mqtt(tag) => tag.name.as_deref(),
            Self::Forwarded(tag) => tag.name.as_deref(),
        }
    }

    /// Name of the device.
    pub fn device(&self) -> &str {
        match self {
            Self::Modbus(tag) => &tag.device,
            Self::Opcua(tag) => &tag.device,
            Self::Mqtt(tag) => &tag.device,
            Self::Forwarded(tag) => &tag.device,
        }
    }

    /// Engineering unit, for people.
    pub fn unit(&self) -> Option<&str> {
        match self {
            Self::Modbus(tag) => tag.unit.as_deref(),
            Self::Opcua(tag) => tag.unit.as_deref(),
            Self::Mqtt(tag) => tag.unit.as_deref(),
            Self::Forwarded(tag) => tag.unit.as_deref(),
        }
    }

    /// Least and greatest believable value, after scaling.
    pub fn range(&self) -> Option<[f64; 2]> {
        match self {
            Self::Modbus(tag) => tag.range,
            Self::Opcua(tag) => tag.range,
            Self::Mqtt(tag) => tag.range,
            Self::Forwarded(_) => None,
        }
    }

    /// As a tag of a Modbus device.
    pub fn as_modbus(&self) -> Option<&modbus::TagConfig> {
        match self {
            Self::Modbus(tag) => Some(tag),
            Self::Opcua(_) | Self::Mqtt(_) | Self::Forwarded(_) => None,
        }
    }

    /// The key that says where it is read.
    pub fn place_key(&self) -> &'static str {
        match self {
            Self::Modbus(_) => "address",
            Self::Opcua(tag) if tag.path.is_some() => "path",
            Self::Opcua(_) => "node",
            Self::Mqtt(tag) if tag.sparkplug.is_some() => "sparkplug",
            Self::Mqtt(_) => "topic",
            Self::Forwarded(_) => "source",
        }
    }

    /// Where it is read; the same text for two tags that read the same thing.
    pub fn source(&self) -> String {
        match self {
            Self::Modbus(own) => format!("{:?}", (&own.device, own.register, own.address, own.bit)),
            Self::Opcua(own) => format!("{:?}", (&own.device, &own.node, &own.path, own.element)),
            Self::Mqtt(own) => {
                let metric = (&own.sparkplug, &own.metric, own.alias);
                format!("{:?}", (&own.device, &own.topic, &own.path, metric))
            }
            Self::Forwarded(own) => format!("{:?}", (&own.device, &own.source)),
        }
    }
}

/// The keys of a tag that only Modbus has; the rules refuse them where the tag is another kind's.
pub const MODBUS_KEYS: [&str; 5] = ["register", "address", "type", "byte_order", "bit"];

/// And those that only OPC UA has.
pub const OPCUA_KEYS: [&str; 5] = ["element", "sampling_ms", "queue_size", "deadband", "deadband_percent"];

/// And those of values that may be text, which registers are not.
pub const TEXT_KEYS: [&str; 1] = ["decimal"];

/// And those that only a broker's tags have.
pub const MQTT_KEYS: [&str; 6] = ["topic", "time_path", "quality_path", "sparkplug", "metric", "alias"];

/// Which of all keys a tag may have, by the kind that those beside it show; `None` where they show none.
fn of_kind<'k>(beside: &[&str], known: &[&'k str]) -> Option<Vec<&'k str>> {
    let any = |keys: &[&str]| beside.iter().any(|own| keys.contains(own));
    let others = if any(&MODBUS_KEYS) {
        [&OPCUA_KEYS[..], &MQTT_KEYS, &TEXT_KEYS, &["node", "path"]].concat()
    } else if any(&MQTT_KEYS) {
        [&MODBUS_KEYS[..], &OPCUA_KEYS, &["node"]].concat()
    } else if any(&OPCUA_KEYS) || any(&["node", "path"]) {
        [&MODBUS_KEYS[..], &MQTT_KEYS].concat()
    } else {
        return None;
    };
    Some(known.iter().copied().filter(|key| !others.contains(key)).collect())
}

/// What may have been meant by a key that no tag has; only an extra tag has a name.
pub fn hint(key: &str, beside: &[&str], known: &[&str], extra: bool) -> String {
    let known: Vec<&str> = known.iter().copied().filter(|own| extra || *own != "name").collect();
    let own = of_kind(beside, &known);
    if known.iter().any(|other| close(key, other)) {
        let near = own.filter(|own| own.iter().any(|other| close(key, other)));
        return wording::hint(key, &near.unwrap_or(known));
    }
    if let Some(own) = own {
        return wording::hint(key, &own);
    }
    let listed = |keys: &[&str]| keys.join(", ");
    let special = [&MODBUS_KEYS[..], &OPCUA_KEYS, &MQTT_KEYS, &TEXT_KEYS, &["node", "path"]].concat();
    let common: Vec<&str> = known.into_iter().filter(|own| !special.contains(own)).collect();
    format!(
        "; known are {}, and of Modbus {}, of OPC UA node, path, {}, of MQTT path, {}",
        listed(&common),
        listed(&MODBUS_KEYS),
        listed(&OPCUA_KEYS),
        listed(&MQTT_KEYS)
    )
}

/// Every key of every kind. Read as one table, so that each wrong key keeps its place in the file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    name: Option<String>,
    device: String,
    register: Option<modbus::Register>,
    address: Option<i64>,
    #[serde(rename = "type")]
    value_type: Option<modbus::ValueType>,
    byte_order: Option<modbus::ByteOrder>,
    bit: Option<u8>,
    node: Option<String>,
    path: Option<String>,
    element: Option<usize>,
    decimal: Option<DecimalSign>,
    sampling_ms: Option<u64>,
    queue_size: Option<u32>,
    deadband: Option<f64>,
    deadband_percent: Option<f64>,
    topic: Option<String>,
    time_path: Option<String>,
    quality_path: Option<String>,
    sparkplug: Option<String>,
    metric: Option<String>,
    alias: Option<u64>,
    #[serde(default = "one")]
    scale: f64,
    #[serde(default)]
    offset: f64,
    #[serde(default, deserialize_with = "crate::collect::pair::pair")]
    range: Option<[f64; 2]>,
    unit: Option<String>,
    auto_values: Option<Vec<i64>>,
}

fn one() -> f64 {
    1.0
}

impl<'de> Deserialize<'de> for TagConfig {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let keys = Keys::deserialize(deserializer)?;
        let (name, device, scale, offset) = (keys.name, keys.device, keys.scale, keys.offset);
        let (range, unit, auto_values) = (keys.range, keys.unit, keys.auto_values);
        let (node, path, decimal) = (keys.node, keys.path, keys.decimal);
        if keys.topic.is_some() || keys.sparkplug.is_some() {
            return Ok(Self::Mqtt(mqtt::TagConfig {
                name,
                device,
                topic: keys.topic,
                path,
                decimal,
                time_path: keys.time_path,
                quality_path: keys.quality_path,
                sparkplug: keys.sparkplug,
                metric: keys.metric,
                alias: keys.alias,
                scale,
                offset,
                range,
                unit,
                auto_values,
            }));
        }
        // With no key that says the kind, the rules look at the device to say which is missing.
        let named = !device.is_empty();
        let unknown = named && keys.register.is_none() && keys.address.is_none() && keys.value_type.is_none();
        if node.is_some() || path.is_some() || unknown {
            return Ok(Self::Opcua(opcua::TagConfig {
                name,
                device,
                node,
                path,
                element: keys.element,
                decimal,
                sampling_ms: keys.sampling_ms,
                queue_size: keys.queue_size,
                deadband: keys.deadband,
                deadband_percent: keys.deadband_percent,
                scale,
                offset,
                range,
                unit,
                auto_values,
            }));
        }
        Ok(Self::Modbus(modbus::TagConfig {
            name,
            device,
            register: keys.register.ok_or_else(|| de::Error::missing_field("register"))?,
            address: keys.address.ok_or_else(|| de::Error::missing_field("address"))?,
            value_type: keys.value_type,
            byte_order: keys.byte_order,
            bit: keys.bit,
            scale,
            offset,
            range,
            unit,
            auto_values,
        }))
    }
}
