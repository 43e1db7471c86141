//! Sparkplug B: its topics and its protobuf messages (Sparkplug 3.0, appendix), with the fields that are used here.
//! Pure; fields that are not known are skipped, as protobuf wants it.

use crate::protobuf::{self, Field, Refused, Weighed, many, one};
use prost::Message;

/// Most that a message takes once it is decoded (bytes): what a birth of 50,000 metrics takes, and less than the 32 MiB of a peer
/// with the packet beside it.
const MOST_DECODED: usize = 20 << 20;
/// A longer message, where `max_payload_bytes` lets it come, may take so many times its bytes: metrics of a birth take about ten.
const MOST_TIMES: usize = 16;
/// The metric that carries the number of a session in NBIRTH and NDEATH.
pub const BDSEQ: &str = "bdSeq";
/// The metric that asks an edge node for its births.
pub const REBIRTH: &str = "Node Control/Rebirth";

/// Data types of the standard that are used here.
pub mod datatype {
    /// Signed integers of 8 to 64 bits.
    pub const INT8: u32 = 1;
    /// See [`INT8`].
    pub const INT16: u32 = 2;
    /// See [`INT8`].
    pub const INT32: u32 = 3;
    /// See [`INT8`].
    pub const INT64: u32 = 4;
    /// Unsigned, 64 bits.
    pub const UINT64: u32 = 8;
    /// Double precision.
    pub const DOUBLE: u32 = 10;
    /// True or false.
    pub const BOOLEAN: u32 = 11;
    /// UTF-8 text.
    pub const STRING: u32 = 12;
    /// Milliseconds since the epoch: no measurement.
    pub const DATE_TIME: u32 = 13;
}

/// A message.
#[derive(Clone, PartialEq, Message)]
pub struct Payload {
    /// When it was sent (ms since the epoch).
    #[prost(uint64, optional, tag = "1")]
    pub timestamp: Option<u64>,
    /// What it tells.
    #[prost(message, repeated, tag = "2")]
    pub metrics: Vec<Metric>,
    /// Its number in the session, 0 to 255.
    #[prost(uint64, optional, tag = "3")]
    pub seq: Option<u64>,
}

/// One value.
#[derive(Clone, PartialEq, Message)]
pub struct Metric {
    /// Its name; always in births.
    #[prost(string, optional, tag = "1")]
    pub name: Option<String>,
    /// A number that stands for the name in data.
    #[prost(uint64, optional, tag = "2")]
    pub alias: Option<u64>,
    /// When it held (ms since the epoch).
    #[prost(uint64, optional, tag = "3")]
    pub timestamp: Option<u64>,
    /// See [`datatype`].
    #[prost(uint32, optional, tag = "4")]
    pub datatype: Option<u32>,
    /// Whether it is sent late, from a buffer.
    #[prost(bool, optional, tag = "5")]
    pub is_historical: Option<bool>,
    /// Whether there is no value.
    #[prost(bool, optional, tag = "7")]
    pub is_null: Option<bool>,
    /// Its properties, such as `Quality`.
    #[prost(message, optional, tag = "9")]
    pub properties: Option<PropertySet>,
    /// What it is.
    #[prost(oneof = "Value", tags = "10, 11, 12, 13, 14, 15")]
    pub value: Option<Value>,
}

/// The value of a metric.
#[derive(Clone, PartialEq, prost::Oneof)]
pub enum Value {
    /// Integers up to 32 bits; signed ones in two's complement.
    #[prost(uint32, tag = "10")]
    Int(u32),
    /// Integers of 64 bits.
    #[prost(uint64, tag = "11")]
    Long(u64),
    /// Single precision.
    #[prost(float, tag = "12")]
    Float(f32),
    /// Double precision.
    #[prost(double, tag = "13")]
    Double(f64),
    /// True or false.
    #[prost(bool, tag = "14")]
    Boolean(bool),
    /// Text.
    #[prost(string, tag = "15")]
    Text(String),
}

/// Properties by name: the n-th value belongs to the n-th key.
#[derive(Clone, PartialEq, Message)]
pub struct PropertySet {
    /// Names.
    #[prost(string, repeated, tag = "1")]
    pub keys: Vec<String>,
    /// Values.
    #[prost(message, repeated, tag = "2")]
    pub values: Vec<PropertyValue>,
}

/// One property.
#[derive(Clone, PartialEq, Message)]
pub struct PropertyValue {
    /// See [`datatype`].
    #[prost(uint32, optional, tag = "1")]
    pub datatype: Option<u32>,
    /// An integer.
    #[prost(uint32, optional, tag = "3")]
    pub int: Option<u32>,
}

impl Weighed for Payload {
    const FIELDS: &'static [Field] = &[many::<Metric>(2)];
}

impl Weighed for Metric {
    const FIELDS: &'static [Field] = &[Field::Text(1), one::<PropertySet>(9), Field::Text(15)];
}

impl Weighed for PropertySet {
    const FIELDS: &'static [Field] = &[Field::Texts(1), many::<PropertyValue>(2)];
}

impl Weighed for PropertyValue {
    const FIELDS: &'static [Field] = &[];
}

/// What a topic says of its message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Topic<'t> {
    /// The group.
    pub group: &'t str,
    /// What kind of message.
    pub kind: Kind,
    /// The edge node.
    pub edge: &'t str,
    /// The device at the edge node, for messages of one.
    pub device: Option<&'t str>,
}

/// Kinds of messages that an edge node sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// An edge node is there, with all it has.
    NodeBirth,
    /// An edge node is gone.
    NodeDeath,
    /// News of an edge node.
    NodeData,
    /// A device is there.
    DeviceBirth,
    /// A device is gone.
    DeviceDeath,
    /// News of a device.
    DeviceData,
}

impl<'t> Topic<'t> {
    /// Reads `spBv1.0/group/kind/edge[/device]`; `None` for anything else, commands included.
    pub fn parse(topic: &'t str) -> Option<Self> {
        let mut parts = topic.split('/');
        if parts.next() != Some("spBv1.0") {
            return None;
        }
        let (group, kind, edge) = (parts.next()?, parts.next()?, parts.next()?);
        let device = parts.next();
        let kind = match kind {
            "NBIRTH" => Kind::NodeBirth,
            "NDEATH" => Kind::NodeDeath,
            "NDATA" => Kind::NodeData,
            "DBIRTH" => Kind::DeviceBirth,
            "DDEATH" => Kind::DeviceDeath,
            "DDATA" => Kind::DeviceData,
            _ => return None,
        };
        let of_device = matches!(kind, Kind::DeviceBirth | Kind::DeviceDeath | Kind::DeviceData);
        let whole = parts.next().is_none() && of_device == device.is_some();
        let named = !group.is_empty() && !edge.is_empty() && device != Some("");
        (whole && named).then_some(Self { group, kind, edge, device })
    }
}

impl Payload {
    /// Reads a message.
    ///
    /// # Errors
    /// When it is not one, or would take too much.
    pub fn read(bytes: &[u8]) -> Result<Self, Refused> {
        protobuf::read(bytes, MOST_DECODED.max(bytes.len().saturating_mul(MOST_TIMES)))
    }

    /// The number of the session that a birth begins or a death ends.
    pub fn bdseq(&self) -> Option<u64> {
        let metric = self.metrics.iter().find(|metric| metric.name.as_deref() == Some(BDSEQ))?;
        match metric.value {
            Some(Value::Long(number)) => Some(number),
            Some(Value::Int(number)) => Some(u64::from(number)),
            _ => None,
        }
    }
}

impl Metric {
    /// A metric with a name and a value.
    pub fn named(name: &str, datatype: u32, value: Option<Value>) -> Self {
        Self {
            name: Some(name.into()),
            datatype: Some(datatype),
            is_null: value.is_none().then_some(true),
            value,
            ..Self::default()
        }
    }

    /// The value as a number; `None` for text and other kinds. `datatype` is the one its birth named.
    pub fn number(&self, datatype: Option<u32>) -> Option<f64> {
        use datatype::{DATE_TIME, INT8, INT16, INT32, INT64};
        let kind = self.datatype.or(datatype);
        match (self.value.as_ref()?, kind) {
            (Value::Int(_) | Value::Long(_), Some(DATE_TIME)) => None,
            (Value::Int(bits), Some(INT8)) => Some(f64::from(*bits as u8 as i8)),
            (Value::Int(bits), Some(INT16)) => Some(f64::from(*bits as u16 as i16)),
            (Value::Int(bits), Some(INT32)) => Some(f64::from(*bits as i32)),
            (Value::Int(number), _) => Some(f64::from(*number)),
            (Value::Long(bits), Some(INT8 | INT16 | INT32 | INT64)) => Some(*bits as i64 as f64),
            (Value::Long(number), _) => Some(*number as f64),
            (Value::Float(number), _) => Some(f64::from(*number)),
            (Value::Double(number), _) => Some(*number),
            (Value::Boolean(on), _) => Some(f64::from(u8::from(*on))),
            (Value::Text(_), _) => None,
        }
    }

    /// The property `Quality`: 192 good, 0 bad, 500 stale.
    pub fn quality(&self) -> Option<u32> {
        let set = self.properties.as_ref()?;
        let at = set.keys.iter().position(|key| key == "Quality")?;
        set.values.get(at)?.int
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn topics_are_read_and_commands_and_strays_are_not() {
        let node = Topic::parse("spBv1.0/g/NBIRTH/e").unwrap();
        assert_eq!((node.group, node.kind, node.edge, node.device), ("g", Kind::NodeBirth, "e", None));
        assert_eq!(Topic::parse("spBv1.0/g/DDATA/e/d").unwrap().device, Some("d"));
        for wrong in [
            "spBv1.0/g/NCMD/e",
            "spBv1.0/g/DDATA/e",
            "spBv1.0/g/NDATA/e/d",
            "spBv1.0/g/DDATA/e/d/x",
            "spAv1.0/g/NDATA/e",
            "spBv1.0//NDATA/e",
            "spBv1.0/STATE/h",
            "",
        ] {
            assert_eq!(Topic::parse(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn signed_numbers_come_in_twos_complement() {
        let metric = |kind, value| Metric { datatype: kind, value: Some(value), ..Metric::default() };
        assert_eq!(metric(Some(datatype::INT8), Value::Int(0xFF)).number(None), Some(-1.0));
        assert_eq!(metric(Some(datatype::INT16), Value::Int(0xFFFF_FFFE)).number(None), Some(-2.0));
        assert_eq!(metric(None, Value::Int(u32::MAX)).number(Some(datatype::INT32)), Some(-1.0));
        assert_eq!(metric(None, Value::Long(u64::MAX)).number(Some(datatype::INT64)), Some(-1.0));
        assert_eq!(metric(None, Value::Int(7)).number(None), Some(7.0));
        assert_eq!(metric(Some(datatype::DATE_TIME), Value::Long(7)).number(None), None);
        assert_eq!(metric(None, Value::Text("7".into())).number(None), None);
    }

    #[test]
    fn what_decodes_to_a_hundred_times_its_bytes_is_refused_before_that() {
        // Of the longest message where nothing else is configured: empty metrics, keys and values.
        let empty = |tag: u8| [tag, 0].repeat(1 << 17);
        assert_eq!(Payload::read(&empty(0x12)), Err(Refused::TooMuch(MOST_DECODED)));
        let set = |inner: u8| {
            let set = PropertySet::decode(&empty(inner)[..]).unwrap();
            let metric = Metric { properties: Some(set), ..Metric::default() };
            Payload { metrics: vec![metric], ..Payload::default() }.encode_to_vec()
        };
        for inner in [0x0a, 0x12] {
            let weight = protobuf::weigh(&set(inner), Payload::FIELDS, usize::MAX).unwrap();
            assert!(weight > (1 << 17) * 16, "{inner}: {weight}");
        }
        let metric = |at: usize| {
            let name = format!("Area 1/Unit 2/FIC{at:05}/PV");
            Metric::named(&name, datatype::DOUBLE, Some(Value::Double(50.0)))
        };
        for count in [2000, 50_000] {
            let birth = Payload { metrics: (0..count).map(metric).collect(), ..Payload::default() };
            assert_eq!(Payload::read(&birth.encode_to_vec()), Ok(birth), "{count}");
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            if let Ok(payload) = Payload::read(&bytes) {
                let _ = payload.bdseq();
                for metric in &payload.metrics {
                    let _ = (metric.number(None), metric.quality());
                }
            }
        }

        #[test]
        fn any_topic_is_read_or_refused(topic in "(spBv1.0)?(/[a-zA-Z]{0,6}){0,6}") {
            let _ = Topic::parse(&topic);
        }
    }
}
