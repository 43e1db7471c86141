//! Ports that are none: an address that is refused as a whole would leave the reader to find out why.

use super::Rules;
use toml::Spanned;
use toml::de::DeValue;

/// Keys that name a host and a port.
const KEYS: [&str; 4] = ["address", "url", "public_url", "servers"];

/// The largest port.
const MOST: u64 = 65_535;

impl Rules<'_, '_, '_> {
    pub(super) fn ports(&mut self) {
        let mut found = Vec::new();
        for (name, value) in self.source.root() {
            addresses(name.get_ref(), value, &mut |place, key, text| {
                found.extend(too_large(text).map(|port| (place, key.to_string(), port)));
            });
        }
        for (place, key, port) in found {
            if self.blamed.insert(place) {
                // The address of a receiver may carry a secret, and is not shown.
                self.report.at(place, format!("{key}: the port {port} must be 1 to {MOST}"));
            }
        }
    }
}

/// Every address below a value, with its place and key.
fn addresses<'v>(
    key: &'v str,
    value: &'v Spanned<DeValue<'_>>,
    take: &mut dyn FnMut(usize, &'v str, &'v str),
) {
    match value.get_ref() {
        DeValue::String(text) if KEYS.contains(&key) => take(value.span().start, key, text),
        DeValue::Array(items) => items.iter().for_each(|item| addresses(key, item, take)),
        DeValue::Table(table) => {
            table.iter().for_each(|(key, value)| addresses(key.get_ref(), value, take));
        }
        _ => {}
    }
}

/// The port of an address that is larger than any.
fn too_large(text: &str) -> Option<u64> {
    let rest = text.split_once("://").map_or(text, |(_, rest)| rest);
    let authority = rest.split(['/', '?']).next().unwrap_or_default();
    let (_, port) = authority.rsplit_once(':')?;
    port.parse().ok().filter(|port| *port > MOST)
}

#[cfg(test)]
mod tests {
    use super::too_large;

    #[test]
    fn ports_of_addresses() {
        for (text, port) in [
            ("h:70000", Some(70_000)),
            ("https://u@h:65536/x:1", Some(65_536)),
            ("[fd00::5]:99999", Some(99_999)),
            ("h:65535", None),
            ("[fd00::ffff]", None),
            ("plant/70000", None),
        ] {
            assert_eq!(too_large(text), port, "{text}");
        }
    }
}
