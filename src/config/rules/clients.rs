//! Clients of one broker: each has a name of its own there, or they throw each other out.

use super::{Parts, Rules, Step};
use std::collections::HashMap;

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
            let key = (address.to_ascii_lowercase(), id.clone());
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
    }
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
}
