//! What the name of a column of quality says: by which word it speaks of quality, and of which value.

use super::names::{LONGEST, Meaning, Name, plain};
use super::vocabulary::{DETAILS, MODE, QUALITIES, SHORT_QUALITIES, VALUES};
use crate::signal::Role;

/// The shortest names of values: a word of quality may stand at them without a sign between, `PVQ` and `OPStatus`.
const SHORT_VALUES: [&str; 5] = ["op", "pv", "sp", "sv", "mv"];
/// Flags that stand at them so: `PVBad`.
const FLAGS: [&str; 2] = ["bad", "good"];
/// Words beside the name of a value that may say how good it is, and mean other things as well: `PV_STS`.
const STATES: [&str; 7] = ["sts", "stat", "state", "flag", "flags", "flg", "code"];
/// Those of them that may stand at the shortest names without a sign between; `opcode` and `opstate` are words of their own.
const STATES_AT: [&str; 3] = ["sts", "stat", "flag"];
/// What a meaning is called by itself.
const MEANINGS: [&str; 6] = ["t", "op", "pv", "sp", "mv", "mode"];

/// Whether a name is that of a value: neither a time nor a mode.
fn is_value(name: &str) -> bool {
    let said = Name::new(name).said().map(|said| said.meaning);
    matches!(said, Some(Meaning::Role(role)) if role != Role::Mode)
}

impl Name {
    /// Whether it says if a value is good: `Some` with the name of that value, empty where it stands alone.
    ///
    /// The word of quality stands behind the value or before it, and either may stand in brackets: `pv_quality`, `Q_PV`,
    /// `Quality (FIC101.OP)`, `FIC101.OP [Quality]`.
    pub fn quality_of(&self) -> Option<String> {
        let own = self.plain();
        // `A/M Status` is a mode.
        if MODE.contains(&own) {
            return None;
        }
        if QUALITIES.contains(&own) {
            if is_value(self.brackets()) {
                return Some(plain(self.brackets()));
            }
            return (!SHORT_QUALITIES.contains(&own)).then(String::new);
        }
        if QUALITIES.contains(&plain(self.brackets()).as_str()) {
            return Some(own.to_string());
        }
        let of = |word: &&str| own.strip_suffix(*word)?.strip_suffix(' ').map(str::to_string);
        let before = QUALITIES.iter().filter_map(of).min_by_key(String::len);
        before.or_else(|| self.behind_quality()).or_else(|| self.at_short_value(QUALITIES))
    }

    /// The value whose name stands behind a word of quality: `Q_PV`. `Q_steam` is a flow, and `Status text` has no value.
    fn behind_quality(&self) -> Option<String> {
        let path = self.path();
        if path.len() > LONGEST {
            return None;
        }
        let divides = |c: char| !c.is_alphanumeric() && !matches!(c, '%' | '°');
        // From the right, for `Status code PV` has a longer word of quality than `Status`.
        path.char_indices().rev().filter(|(_, c)| divides(*c)).find_map(|(at, c)| {
            let (word, value) = (&path[..at], &path[at + c.len_utf8()..]);
            (QUALITIES.contains(&plain(word).as_str()) && is_value(value)).then(|| plain(value))
        })
    }

    /// The value of a name in which one of these words and the shortest name of a value are one word.
    fn at_short_value(&self, words: &[&str]) -> Option<String> {
        let (before, last) = self.plain().rsplit_once(' ').unwrap_or(("", self.plain()));
        let is_of = |value: &&str| {
            let behind = last.strip_prefix(*value).is_some_and(|word| words.contains(&word));
            // `stop` is no `st` of OP.
            let ahead = |word: &str| words.contains(&word) && word != "st";
            behind || last.strip_suffix(*value).is_some_and(ahead)
        };
        let value = SHORT_VALUES.into_iter().find(is_of)?;
        Some(if before.is_empty() { value.to_string() } else { format!("{before} {value}") })
    }

    /// Names of values that it may speak of where it speaks of one, the likeliest first: `pv` of `PV state`, of `State PV`, of
    /// `pv_is_bad` and of `State (PV)`.
    pub fn values_of(&self) -> Vec<String> {
        // `Quality code` is a word of quality alone.
        let own = if QUALITIES.contains(&self.plain()) { "" } else { self.plain() };
        let before = own.rsplit_once(' ').map(|(before, _)| before.strip_suffix(" is").unwrap_or(before));
        let behind = own.split_once(' ').map(|(_, behind)| behind);
        let all = [
            self.quality_of(),
            self.may_qualify(),
            before.map(str::to_string),
            behind.map(str::to_string),
            Some(plain(self.brackets())),
            self.at_short_value(&FLAGS),
        ];
        all.into_iter().flatten().filter(|of| !of.is_empty()).collect()
    }

    /// The value of which it may say how good it is, by a word that means other things as well: `pv` of `PV_STS` and of `Flag PV`.
    pub fn may_qualify(&self) -> Option<String> {
        let own = self.plain();
        let is_state = |word: &str| STATES.contains(&word);
        let behind = own.rsplit_once(' ').filter(|(_, word)| is_state(word)).map(|(of, _)| of);
        let before = own.split_once(' ').filter(|(word, _)| is_state(word)).map(|(_, of)| of);
        let of = behind.or(before).map(str::to_string).or_else(|| self.at_short_value(&STATES_AT));
        of.filter(|of| is_value(of))
    }

    /// Without a number behind it, by which columns that belong together differ: `q` of `Q1` and of `Q2`.
    pub fn stem(&self) -> &str {
        self.plain().trim_end_matches(|c: char| c.is_ascii_digit()).trim_end()
    }

    /// Whether it holds OPC's numbers beside a column of another numbering, as in AVEVA's historian.
    pub fn is_detail(&self) -> bool {
        DETAILS.iter().any(|detail| {
            self.plain().strip_suffix(detail).is_some_and(|of| of.is_empty() || of.ends_with(' '))
        })
    }

    /// Whether a quality column of this name (see [`Self::quality_of`]) belongs to it.
    pub fn owns_quality(&self, of: &str) -> bool {
        self.called.get_or_init(|| self.names_of_value()).iter().any(|own| own == of)
    }

    /// What a quality column may call it: `fic101 pv`, `fic101` and `pv` for `FIC101.PV`.
    fn names_of_value(&self) -> Vec<String> {
        let own = self.plain();
        let shortened =
            VALUES.iter().filter_map(|value| Some(own.strip_suffix(value)?.trim_end().to_string()));
        let mut all: Vec<String> = shortened.collect();
        all.push(own.to_string());
        all.extend(
            self.said()
                .map(|said| said.meaning.as_str().to_string())
                .filter(|of| MEANINGS.contains(&of.as_str())),
        );
        // The letter of `FIC101.PV C` may be its unit, which its quality has not.
        all.extend(self.lettered().into_iter().flat_map(|(name, _)| name.names_of_value()));
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_word_of_quality_stands_behind_its_value_before_it_or_in_brackets() {
        for (name, of) in [
            ("Q_PV", Some("pv")),
            ("Quality_OP", Some("op")),
            ("Status FIC101.OP", Some("fic101 op")),
            ("Status code PV", Some("pv")),
            ("Calidad Salida", Some("salida")),
            ("Quality (FIC101.OP)", Some("fic101 op")),
            ("Quality (PV)", Some("pv")),
            ("FIC101.OP [Quality]", Some("fic101 op")),
            ("FIC101.OP (Status)", Some("fic101 op")),
            ("OPQ", Some("op")),
            ("FIC101.PVStatus", Some("fic101 pv")),
            ("pv_bad_quality", Some("pv")),
            ("Bad_Quality", Some("")),
            ("Quality [%]", Some("")),
            ("Q_steam", None),
            ("Q [m3/h]", None),
            ("Status text", None),
            ("Status mode", None),
            ("Stop", None),
        ] {
            assert_eq!(Name::new(name).quality_of().as_deref(), of, "{name}");
        }
    }

    #[test]
    fn a_column_may_speak_of_what_its_name_has_beside_a_word() {
        for (name, of) in [
            ("PV state", "pv"),
            ("State PV", "pv"),
            ("pv_is_bad", "pv"),
            ("Bad_PV", "pv"),
            ("FIC101.BADPV", "fic101 pv"),
        ] {
            let values = Name::new(name).values_of();
            assert!(values.iter().any(|own| own == of), "{name}: {values:?}");
        }
    }

    #[test]
    fn a_state_beside_the_name_of_a_value_may_say_how_good_it_is() {
        for (name, of) in [
            ("PV_STS", Some("pv")),
            ("FIC101.PV_FLAG", Some("fic101 pv")),
            ("SP Code", Some("sp")),
            ("Stat OP", Some("op")),
            ("PVSTS", Some("pv")),
            ("MODE_STS", None),
            ("Batch code", None),
            ("OpCode", None),
            ("State", None),
            ("Flag", None),
        ] {
            assert_eq!(Name::new(name).may_qualify().as_deref(), of, "{name}");
        }
    }
}
