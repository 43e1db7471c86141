//! `probe`: what a broker carries, for the day its tags are chosen. It subscribes and publishes nothing.

use super::config::{Config, TimeUnit};
use super::json::{is_time, parse};
use crate::collect::stub::{self, Stub, quoted};
use crate::collect::text_value;
use crate::mqtt::sparkplug::{Payload, Topic};
use rumqttc::{AsyncClient, Event, Packet, QoS};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt;
use std::time::Duration;
use tokio::time::{Instant, timeout_at};

/// Longest part of a payload that is shown (characters).
const SHOWN: usize = 200;
/// Values that are looked for in one payload, at most, and how deep.
const MAX_LEAVES: usize = 500;
const MAX_DEPTH: usize = 16;

/// A value within a message.
#[derive(Clone, Debug, PartialEq)]
pub struct Leaf {
    /// Its path in JSON, or its name as a metric; empty for a payload that is a plain value.
    pub path: String,
    /// As it was sent.
    pub value: String,
    /// The unit of time in which it is a time, where it can be one.
    pub time_unit: Option<&'static str>,
    /// Whether it is read as a number.
    pub is_number: bool,
}

/// A topic and its first message.
#[derive(Clone, Debug, PartialEq)]
pub struct Seen {
    /// Its name.
    pub topic: String,
    /// `group/edge` or `group/edge/device`, where it is one of Sparkplug B.
    pub sparkplug: Option<String>,
    /// The beginning of the message.
    pub payload: String,
    /// The values in it.
    pub leaves: Vec<Leaf>,
    /// Messages that came.
    pub messages: u64,
}

/// What a broker carries.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Probed {
    /// By name.
    pub seen: Vec<Seen>,
    /// Topics beyond those asked for.
    pub more: usize,
    device: String,
}

/// Listens to the topics of a filter for so long, and remembers the first message of each of `most` topics.
///
/// # Errors
/// Why there is no connection, or why it ended.
pub async fn probe(config: &Config, filter: &str, listen: Duration, most: usize) -> Result<Probed, String> {
    let wrong = |why: String| format!("{}: {why}", config.address);
    let mut broker = config.broker();
    // A daemon that is at work under the section's own name must not be thrown out.
    broker.client_id += "-probe";
    broker.clean_session = true;
    let options = broker.options().map_err(|error| wrong(error.to_string()))?;
    let built = AsyncClient::builder(options).capacity(8).try_build();
    let (client, mut events) = built.map_err(|error| wrong(error.to_string()))?;
    events.network_options.set_connection_timeout(config.timeout_s);
    client.try_subscribe(filter, QoS::AtMostOnce).map_err(|error| wrong(error.to_string()))?;
    let end = Instant::now() + listen;
    let mut topics: BTreeMap<String, Seen> = BTreeMap::new();
    let mut found = Probed { device: config.name.clone(), ..Probed::default() };
    let mut beyond = std::collections::BTreeSet::new();
    while let Ok(event) = timeout_at(end, events.poll()).await {
        let Event::Incoming(Packet::Publish(message)) = event.map_err(|error| wrong(error.to_string()))?
        else {
            continue;
        };
        let topic = String::from_utf8_lossy(&message.topic).into_owned();
        if let Some(known) = topics.get_mut(&topic) {
            known.messages += 1;
        } else if topics.len() < most {
            topics.insert(topic.clone(), seen(topic, &message.payload));
        } else if beyond.len() < most {
            beyond.insert(topic);
        }
    }
    found.more = beyond.len();
    found.seen = topics.into_values().collect();
    Ok(found)
}

fn seen(topic: String, payload: &[u8]) -> Seen {
    let place = Topic::parse(&topic).map(|own| {
        let device = own.device.map(|device| format!("/{device}")).unwrap_or_default();
        format!("{}/{}{device}", own.group, own.edge)
    });
    let mut leaves = Vec::new();
    let message = Payload::read(payload).ok().filter(|_| place.is_some());
    if let Some(message) = &message {
        for metric in message.metrics.iter().take(MAX_LEAVES) {
            let (Some(name), number) = (&metric.name, metric.number(metric.datatype)) else { continue };
            let value = number.map(|number| number.to_string()).unwrap_or_default();
            leaves.push(Leaf { path: name.clone(), value, time_unit: None, is_number: number.is_some() });
        }
    } else if let Ok(document) = serde_json::from_slice::<Value>(payload)
        && (document.is_object() || document.is_array())
    {
        collect(&document, "", 0, &mut leaves);
    } else if parse(payload, true).is_ok() {
        let text = String::from_utf8_lossy(payload);
        leaves.push(leaf("", &text, text_value::read(&text, None).ok()));
    }
    let text = match &message {
        Some(message) => format!("Sparkplug B, {} metrics", message.metrics.len()),
        None => String::from_utf8_lossy(payload).into_owned(),
    };
    let payload = text.chars().take(SHOWN).map(|c| if c.is_control() { ' ' } else { c }).collect();
    Seen { topic, sparkplug: place.filter(|_| message.is_some()), payload, leaves, messages: 1 }
}

/// The values of a document with their paths.
fn collect(value: &Value, path: &str, depth: usize, leaves: &mut Vec<Leaf>) {
    if leaves.len() >= MAX_LEAVES || depth > MAX_DEPTH {
        return;
    }
    match value {
        Value::Object(fields) => {
            for (key, value) in fields {
                let plain = !key.is_empty() && key.chars().all(|c| c.is_alphanumeric() || "_-".contains(c));
                let step = match plain {
                    true if path.is_empty() => key.clone(),
                    true => format!(".{key}"),
                    false => format!("['{key}']"),
                };
                collect(value, &format!("{path}{step}"), depth + 1, leaves);
            }
        }
        Value::Array(values) => {
            for (at, value) in values.iter().enumerate() {
                collect(value, &format!("{path}[{at}]"), depth + 1, leaves);
            }
        }
        Value::Number(number) => leaves.push(leaf(path, &number.to_string(), number.as_f64())),
        Value::String(text) => leaves.push(leaf(path, text, text_value::read(text, None).ok())),
        Value::Bool(on) => leaves.push(leaf(path, &on.to_string(), Some(f64::from(u8::from(*on))))),
        Value::Null => leaves.push(leaf(path, "null", None)),
    }
}

fn leaf(path: &str, value: &str, number: Option<f64>) -> Leaf {
    let counted = |number: f64| TimeUnit::ALL.into_iter().find(|unit| is_time(number / unit.per_second()));
    let written = value.parse::<jiff::Timestamp>().is_ok().then_some(TimeUnit::Ms);
    let time_unit = number.and_then(counted).or(written).map(TimeUnit::name);
    let value = value.chars().take(SHOWN).collect();
    Leaf { path: path.into(), value, time_unit, is_number: number.is_some() }
}

impl Seen {
    /// Where the time of its values stands, if one value alone can be a time.
    fn time(&self) -> Option<&Leaf> {
        let mut times = self.leaves.iter().filter(|leaf| leaf.time_unit.is_some() && !leaf.path.is_empty());
        times.next().filter(|_| times.next().is_none())
    }

    fn tags<'s>(&'s self, device: &'s str) -> impl Iterator<Item = stub::Tag> + 's {
        let values = self.leaves.iter().filter(|leaf| leaf.is_number && leaf.time_unit.is_none());
        values.map(move |leaf| {
            let mut keys = vec![("device".to_string(), quoted(device))];
            let place = self.sparkplug.as_deref().unwrap_or(&self.topic);
            if self.sparkplug.is_some() {
                keys.extend([("sparkplug".into(), quoted(place)), ("metric".into(), quoted(&leaf.path))]);
            } else {
                keys.push(("topic".into(), quoted(place)));
                let paths = [("path", Some(leaf)), ("time_path", self.time())];
                for (key, leaf) in paths {
                    let leaf = leaf.filter(|leaf| !leaf.path.is_empty());
                    keys.extend(leaf.map(|leaf| (key.to_string(), quoted(&leaf.path))));
                }
            }
            let name =
                if leaf.path.is_empty() { place.to_string() } else { format!("{place}/{}", leaf.path) };
            stub::Tag { name, keys, note: Some(leaf.value.clone()), ..stub::Tag::default() }
        })
    }
}

impl Probed {
    /// The loops that the names of topics and values tell.
    pub fn stub(&self) -> Stub {
        let device = if self.device.is_empty() { "broker" } else { &self.device };
        let tags: Vec<stub::Tag> = self.seen.iter().flat_map(|seen| seen.tags(device)).collect();
        stub::loops(&tags)
    }
}

impl fmt::Display for Probed {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for seen in &self.seen {
            let topic = seen.topic.replace(char::is_control, " ");
            writeln!(out, "# {topic} ({} messages): {}", seen.messages, seen.payload)?;
            for leaf in seen.leaves.iter().filter(|leaf| !leaf.path.is_empty()) {
                let kind = match (leaf.time_unit, leaf.is_number) {
                    (Some(unit), true) => format!(", a time with time_unit = \"{unit}\""),
                    (Some(_), false) => ", a time".into(),
                    (None, true) => String::new(),
                    (None, false) => ", no number".into(),
                };
                let line = format!("{} = {}{kind}", leaf.path, leaf.value);
                writeln!(out, "#   {}", line.replace(char::is_control, " "))?;
            }
        }
        if self.seen.is_empty() {
            writeln!(out, "# nothing came: listen longer by --seconds, or widen the filter")?;
        }
        if self.more > 0 {
            writeln!(out, "# and {} topics more at least: narrow the filter, or raise --most", self.more)?;
        }
        let stub = self.stub();
        write!(out, "{}\n{}", stub.remarks(), stub.text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_those_that_the_configuration_reads() {
        let payload = r#"{"v":{"op":41.5,"a.b":[1,"x"]},"ts":1700000000000,"on":true}"#;
        let found = seen("plant/FIC101".into(), payload.as_bytes());
        let paths: Vec<&str> = found.leaves.iter().map(|leaf| leaf.path.as_str()).collect();
        assert_eq!(paths, ["on", "ts", "v['a.b'][0]", "v['a.b'][1]", "v.op"]);
        for path in paths {
            assert!(super::super::json::Path::parse("path", path).is_ok(), "{path}");
        }
        assert_eq!(found.time().map(|leaf| leaf.path.as_str()), Some("ts"));
        assert_eq!(seen("a".into(), b"12,5").leaves[0].value, "12,5");
        assert!(seen("a".into(), &[0xff, 0xfe]).leaves.iter().all(|leaf| !leaf.is_number));
    }
}
