//! The zone that a header says its times are in.

use super::calendar::{is_ambiguous, zone};
use super::options;

/// Letters for Greenwich.
const UTC: [&str; 3] = ["utc", "gmt", "z"];

/// What the unit of a column of times says of its zone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum HeaderZone {
    /// An offset or a name, as `--tz` has it: `+02:00`, `Europe/Berlin`.
    Offset(String),
    /// Letters, which `--tz` has to say more of.
    Letters(String),
}

impl HeaderZone {
    /// `UTC+02:00`, `GMT-5`, `CEST`; `None` where nothing of the kind stands there, or UTC itself.
    pub fn of(unit: &str) -> Option<Self> {
        let small = unit.trim().to_lowercase();
        // Letters that only one zone has hold for half of a year.
        let of_one = !UTC.contains(&small.as_str()) && zone(&small).is_some();
        if of_one || is_ambiguous(&small) {
            return Some(Self::Letters(unit.trim().to_string()));
        }
        // `Europe/Berlin`; `m3/h` is none.
        if unit.contains('/') && options::zone(unit.trim()).is_some() {
            return Some(Self::Offset(unit.trim().to_string()));
        }
        let rest = small.strip_prefix("utc").or_else(|| small.strip_prefix("gmt")).unwrap_or(&small).trim();
        let digits = rest.strip_prefix(['+', '-'])?;
        let (hours, minutes) = match (digits.split_once(':'), digits.len()) {
            (Some(parts), _) => parts,
            (None, 4) => digits.split_at(2),
            (None, _) => (digits, "0"),
        };
        let (hours, minutes): (u8, u8) = (hours.parse().ok()?, minutes.parse().ok()?);
        (hours <= 15 && minutes < 60).then(|| Self::Offset(format!("{}{hours:02}:{minutes:02}", &rest[..1])))
    }
}
