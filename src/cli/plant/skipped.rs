//! What was not used, and why: the first reasons in full, the rest counted by kind.

use std::collections::HashMap;
use std::fmt;

/// A record, or a loop, that was not used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Skipped {
    /// Its name.
    pub name: String,
    /// Why.
    pub why: String,
}

impl fmt::Display for Skipped {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}: {}", self.name, self.why)
    }
}

impl Skipped {
    /// Its reason without what differs from file to file: numbers, and what stands in quotes.
    fn kind(&self) -> String {
        let (mut kind, mut is_quoted) = (String::new(), false);
        // A short name may be a part of any word.
        let named = if self.name.len() > 2 { self.name.as_str() } else { "\n" };
        for c in self.why.replace(named, "").chars() {
            match c {
                '"' => is_quoted = !is_quoted,
                _ if is_quoted => {}
                c if c.is_ascii_digit() && kind.ends_with('#') => {}
                c if c.is_ascii_digit() => kind.push('#'),
                c => kind.push(c),
            }
        }
        kind
    }
}

/// The first `most` in full; of the others each further kind with its first, and how many are like it.
pub fn lines(skipped: &[Skipped], most: usize) -> Vec<String> {
    let mut lines: Vec<String> = skipped.iter().take(most).map(Skipped::to_string).collect();
    // The place of the first of each kind, and how many of it are not printed in full.
    let mut kinds: Vec<(usize, usize)> = Vec::new();
    let mut places: HashMap<String, usize> = HashMap::new();
    for (at, own) in skipped.iter().enumerate() {
        let place = *places.entry(own.kind()).or_insert_with(|| {
            kinds.push((at, 0));
            kinds.len() - 1
        });
        if let Some((_, count)) = kinds.get_mut(place).filter(|_| at >= most) {
            *count += 1;
        }
    }
    kinds.retain(|(_, count)| *count > 0);
    for (first, count) in kinds.iter().take(most.max(1)) {
        let Some(own) = skipped.get(*first) else { continue };
        lines.push(match (*first < most, *count) {
            (true, count) => format!("{count} more, as {}", own.name),
            (false, 1) => own.to_string(),
            (false, count) => format!("{own}; and {} more like it", count - 1),
        });
    }
    let left: usize = kinds.iter().skip(most.max(1)).map(|(_, count)| count).sum();
    if left > 0 {
        lines.push(format!("{left} more for other reasons"));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    fn skipped(name: &str, why: &str) -> Skipped {
        Skipped { name: name.into(), why: why.into() }
    }

    #[test]
    fn the_first_reasons_are_printed_and_the_rest_is_counted_by_kind() {
        let wide =
            |k: usize| skipped(&format!("unit{k}"), &format!("line {k}: the header has \"T{k}\", \"U{k}\""));
        let mut all: Vec<Skipped> = (1..=30).map(wide).collect();
        all.push(skipped("a", "cannot read: denied"));
        all.push(skipped("b", "30 good samples of PV and 20 of OP, 60 are needed"));
        all.push(skipped("c", "1 good samples of PV and 0 of OP, 60 are needed"));
        let told = lines(&all, 2);
        assert_eq!(told[0], "unit1: line 1: the header has \"T1\", \"U1\"");
        assert_eq!(told[1], "unit2: line 2: the header has \"T2\", \"U2\"");
        assert_eq!(told[2], "28 more, as unit1");
        assert_eq!(told[3], "a: cannot read: denied");
        assert_eq!(told[4], "2 more for other reasons");
        let told = lines(&all, 3);
        assert_eq!(told[5], "b: 30 good samples of PV and 20 of OP, 60 are needed; and 1 more like it");
        assert_eq!(told.len(), 6);
    }

    #[test]
    fn few_are_printed_as_they_are() {
        let all = [skipped("a", "x"), skipped("b", "x")];
        assert_eq!(lines(&all, 2), ["a: x", "b: x"]);
        assert!(lines(&[], 2).is_empty());
    }
}
