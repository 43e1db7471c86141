//! Finds tags that read one register as two different things.

use super::config::{Config, TagConfig};
use super::kinds::{Register, ValueType};

/// Two tags that read the same registers as different things.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Contradiction {
    /// Position of one in the list given.
    pub first: usize,
    /// Position of the other, later one.
    pub second: usize,
    /// What contradicts.
    pub message: String,
}

/// The pairs of tags of one device that read overlapping registers as different things: one of the two
/// must be wrong. Allowed: the same value read twice, and bits of an integer that is also read whole.
pub fn contradictions(device: &Config, tags: &[&TagConfig]) -> Vec<Contradiction> {
    let mut order: Vec<(Register, u16, u16, usize)> = Vec::new();
    for (position, tag) in tags.iter().enumerate() {
        if let (Some(start), Some(value_type)) = (tag.wire_address(device), tag.effective_type()) {
            order.push((tag.register, start, value_type.width(), position));
        }
    }
    order.sort();
    let mut found = Vec::new();
    for (at, &(register, start, width, a)) in order.iter().enumerate() {
        let end = u32::from(start) + u32::from(width);
        let overlapping = order[at + 1..]
            .iter()
            .take_while(|(other, from, _, _)| *other == register && u32::from(*from) < end);
        for &(_, from, _, b) in overlapping {
            if !agree(device, tags[a], tags[b], start == from) {
                let (first, second) = (a.min(b), a.max(b));
                found.push(Contradiction {
                    first,
                    second,
                    message: format!(
                        "{} on {} register {} overlaps {} at {}: one register cannot be both",
                        type_name(tags[second]),
                        register,
                        tags[second].address,
                        type_name(tags[first]),
                        tags[first].address
                    ),
                });
            }
        }
    }
    found.sort_by_key(|pair| (pair.second, pair.first));
    found
}

fn agree(device: &Config, a: &TagConfig, b: &TagConfig, same_start: bool) -> bool {
    let (Some(ta), Some(tb)) = (a.effective_type(), b.effective_type()) else {
        return true;
    };
    let order = |tag: &TagConfig| tag.byte_order.unwrap_or(device.byte_order);
    match (ta, tb) {
        (ValueType::Bit, ValueType::Bit) => true,
        (ValueType::Bit, other) | (other, ValueType::Bit) => other.is_integer(),
        _ => same_start && ta == tb && order(a) == order(b),
    }
}

fn type_name(tag: &TagConfig) -> &'static str {
    tag.effective_type().map_or("a value without type", ValueType::as_str)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tag(text: &str) -> TagConfig {
        toml::from_str(&format!("device = 'd'\n{text}")).unwrap()
    }

    fn plain_device() -> Config {
        toml::from_str("name = 'd'\naddress = '10.0.0.5:502'\naddress_base = 0").unwrap()
    }

    #[test]
    fn overlapping_registers_of_contradicting_types_are_found() {
        let device = plain_device();
        let tags: Vec<TagConfig> = [
            "register='holding'\naddress=99\ntype='f32'",  // 0: 99..100
            "register='holding'\naddress=100\ntype='u16'", // 1: inside 0
            "register='input'\naddress=100\ntype='u16'",   // 2: another table
            "register='holding'\naddress=99\ntype='f32'",  // 3: 0 again
            "register='holding'\naddress=99\ntype='f32'\nbyte_order='CDAB'", // 4: 0 in another order
            "register='holding'\naddress=200\ntype='bit'\nbit=1", // 5
            "register='holding'\naddress=200\ntype='u16'", // 6: the word of 5
            "register='holding'\naddress=99\ntype='bit'\nbit=1", // 7: a bit of a float
            "register='holding'\naddress=101\ntype='u16'", // 8: next to 0
        ]
        .map(tag)
        .into();
        let pairs: Vec<(usize, usize)> = contradictions(&device, &tags.iter().collect::<Vec<_>>())
            .iter()
            .map(|c| (c.first, c.second))
            .collect();
        assert_eq!(pairs, [(0, 1), (1, 3), (0, 4), (1, 4), (3, 4), (0, 7), (3, 7), (4, 7)]);
    }
}
