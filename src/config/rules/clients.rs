//! Clients of one broker: each has a name of its own there, or they throw each other out.

use super::super::{LoopConfig, TagConfig, plant};
use super::{Parts, Rules, Step};
use crate::collect::mqtt;
use crate::host;
use crate::notify;
use std::collections::{HashMap, HashSet};

impl Rules<'_, '_, '_> {
    pub(super) fn clients(&mut self, parts: &Parts) {
        let mut all: Vec<(String, String, Vec<Step>, String)> = Vec::new();
        for (at, broker) in parts.mqtt.iter().enumerate() {
            let Some(broker) = broker else { continue };
            let section = format!("[[mqtt]] {:?}", broker.name);
            all.push((
                broker.address.clone(),
                broker.client_id(),
                path!["mqtt", at, "client_id"].to_vec(),
                section,
            ));
        }
        let publisher = parts.notify.as_ref().and_then(|notify| notify.mqtt.as_ref());
        for id in publisher.map(|own| own.client_ids()).unwrap_or_default() {
            let address = publisher.map(|own| own.address.clone()).unwrap_or_default();
            let place = path!["notify", "mqtt", "client_id"].to_vec();
            all.push((address, id, place, "[notify.mqtt]".into()));
        }
        let mut seen: HashMap<(String, String), String> = HashMap::new();
        for (address, id, place, section) in all {
            let key = (host::canonical(&address), id.clone());
            if let Some(first) = seen.get(&key) {
                let message = format!(
                    "client_id: {first} and {section} are both the client {id:?} of {address}, which throws one out for the \
                     other: give each its own, or leave client_id out"
                );
                self.wrong(&place, message);
            } else {
                seen.insert(key, section);
            }
        }
        self.echoed(parts);
        self.one_edge(parts);
    }

    /// Two programs that are one edge node mix their births and deaths for everybody who listens.
    fn one_edge(&mut self, parts: &Parts) {
        let Some(own) = parts.notify.as_ref().and_then(|notify| notify.mqtt.as_ref()) else { return };
        let Some(edge) = &own.sparkplug else { return };
        let name = format!("{}/{}", edge.group, edge.edge);
        let is_it = |(_, tag): (_, &TagConfig)| match tag {
            TagConfig::Mqtt(tag) if is_there(parts, own, tag) => tag.sparkplug.as_ref().is_some_and(|read| {
                *read == name || read.strip_prefix(&name).is_some_and(|rest| rest.starts_with('/'))
            }),
            _ => false,
        };
        if parts.loops.iter().flatten().any(|own| plant::tags(own).any(is_it)) {
            let message =
                format!("edge: {name} is an edge node that tags are read from: appear under another name");
            self.wrong(&path!["notify", "mqtt", "sparkplug", "edge"], message);
        }
    }

    /// A topic that is published and read would make what is said of a loop its next sample.
    fn echoed(&mut self, parts: &Parts) {
        let Some(own) = parts.notify.as_ref().and_then(|notify| notify.mqtt.as_ref()) else { return };
        let read_there = |tag: &mqtt::TagConfig| is_there(parts, own, tag);
        let loops: Vec<&LoopConfig> = parts.loops.iter().flatten().collect();
        let of_loop = |own: &'_ LoopConfig| -> Vec<String> {
            let tags = plant::tags(own).filter_map(|(_, tag)| match tag {
                TagConfig::Mqtt(tag) if read_there(tag) => tag.topic.clone(),
                _ => None,
            });
            tags.collect()
        };
        let read: HashSet<String> = loops.iter().flat_map(|own| of_loop(own)).collect();
        let written = |own_loop: &&LoopConfig| own.topics(&own_loop.id, &own_loop.group);
        let written: Vec<[String; 2]> = loops.iter().map(written).collect();
        for (at, field) in ["diagnosis_topic", "alarm_topic"].into_iter().enumerate() {
            if let Some(topic) = written.iter().map(|topics| &topics[at]).find(|topic| read.contains(*topic))
            {
                let message =
                    format!("{field}: {topic:?} is a topic that a tag is read from: publish to another");
                self.wrong(&path!["notify", "mqtt", field], message);
            }
        }
    }
}

/// Whether a tag is read from the broker that results are published to.
fn is_there(parts: &Parts, own: &notify::mqtt::Config, tag: &mqtt::TagConfig) -> bool {
    let broker = parts.mqtt.iter().flatten().find(|broker| broker.name == tag.device);
    broker.is_some_and(|broker| host::canonical(&broker.address) == host::canonical(&own.address))
}

#[cfg(test)]
mod tests {
    use crate::config::parse;

    const LOOP: &str =
        "[[loop]]\nid = 'A'\n[loop.op]\ndevice = 'a'\ntopic = 'o'\n[loop.pv]\ndevice = 'a'\ntopic = 'p'\n";

    fn errors(text: &str) -> Vec<String> {
        let parsed = parse("f", &format!("{text}{LOOP}"));
        parsed.err().unwrap_or_default().iter().map(ToString::to_string).collect()
    }

    fn broker(name: &str, address: &str, more: &str) -> String {
        format!("[[mqtt]]\nname = '{name}'\naddress = '{address}'\n{more}\n")
    }

    #[test]
    fn two_clients_of_a_broker_have_two_names() {
        let same = "client_id = 'x'";
        let found = errors(&(broker("a", "Plant:1883", same) + &broker("b", "plant:1883", same)));
        assert!(found.len() == 1 && found[0].starts_with("f:8:13: client_id:"), "{found:?}");
        assert!(found[0].contains("[[mqtt]] \"a\"") && found[0].contains("\"x\""), "{found:?}");
        let found = errors(&(broker("a", "localhost:1883", same) + &broker("b", "127.0.0.1:1883", same)));
        assert!(found.len() == 1 && found[0].starts_with("f:8:13: client_id:"), "{found:?}");
        let none = [
            broker("a", "plant:1883", "") + &broker("b", "plant:1883", ""),
            broker("a", "plant:1883", same) + &broker("b", "other:1883", same),
            broker("a", "plant:1883", "") + "[notify.mqtt]\naddress = 'plant:1883'\n",
        ];
        for text in none {
            assert_eq!(errors(&text), [""; 0], "{text}");
        }
        let publisher = "[notify.mqtt]\naddress = 'plant:1883'\nclient_id = 'x'\n";
        let found = errors(&(broker("a", "plant:1883", same) + publisher));
        assert!(found.len() == 1 && found[0].contains("[notify.mqtt]"), "{found:?}");
        let edge = "[notify.mqtt.sparkplug]\ngroup = 'g'\n";
        let found = errors(&(broker("a", "plant:1883", "client_id = 'x-sparkplug'") + publisher + edge));
        assert!(found.len() == 1, "{found:?}");
    }

    #[test]
    fn the_edge_node_that_is_read_is_not_our_own() {
        let text = |edge: &str| {
            let of = broker("a", "plant:1883", "");
            format!(
                "{of}[notify.mqtt]\naddress = 'plant:1883'\n[notify.mqtt.sparkplug]\ngroup = 'g'\nedge = '{edge}'\n"
            )
        };
        let read = LOOP.replace("topic = 'p'", "sparkplug = 'g/e/FIC1'\nmetric = 'pv'");
        let found = |edge: &str| -> Vec<String> {
            let parsed = parse("f", &(text(edge) + &read));
            parsed.err().unwrap_or_default().iter().map(ToString::to_string).collect()
        };
        assert!(found("e").len() == 1 && found("e")[0].contains("g/e is an edge node"), "{:?}", found("e"));
        assert_eq!(found("e2"), [""; 0]);
    }

    #[test]
    fn what_is_published_is_not_read_again() {
        let text = |topic: &str| {
            let of = broker("a", "plant:1883", "");
            format!(
                "{of}[notify.mqtt]\naddress = 'Plant:1883'\nalarm_topic = 'al/{{loop}}'\ndiagnosis_topic = '{topic}'\n"
            )
        };
        assert_eq!(errors(&text("said/{loop}")), [""; 0]);
        let read = LOOP.replace("topic = 'p'", "topic = 'plant/A'");
        let parsed = parse("f", &(text("plant/{loop}") + &read));
        let found: Vec<String> = parsed.err().unwrap_or_default().iter().map(ToString::to_string).collect();
        assert!(
            found.len() == 1 && found[0].contains("diagnosis_topic: \"plant/A\" is a topic"),
            "{found:?}"
        );
    }
}
