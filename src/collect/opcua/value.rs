//! From a data value to a sample: its number, its quality and its own time. Never panics, whatever was sent.

use super::config::TimeFallback;
use crate::collect::DecimalSign;
use crate::collect::scaling::{Reading, Scaling};
use crate::collect::text_value::{self, TextFault};
use crate::signal::{BadReason, Quality};
use opcua::types::{DataValue, DateTime, StatusCode, Variant};
use std::fmt;

/// 1970-01-01 in ticks of 100 ns since 1601-01-01.
const UNIX_EPOCH_TICKS: i64 = 116_444_736_000_000_000;
const TICKS_PER_S: i64 = 10_000_000;

/// How a tag's values are read.
#[derive(Clone, Debug, PartialEq)]
pub struct Meaning {
    /// What its raw numbers mean.
    pub(super) scaling: Scaling,
    /// Which element of an array is meant.
    pub(super) element: Option<usize>,
    /// How decimals are written in a text.
    pub(super) decimal: Option<DecimalSign>,
}

/// Why a value that is there is no number.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum NoNumber {
    /// There is nothing.
    Empty,
    /// An array of so many elements, and none is named.
    Array(usize),
    /// An array without the element named.
    TooShort(usize, usize),
    /// A single value, though an element is named.
    Single,
    /// NaN or infinite, before or after scaling.
    NotFinite,
    /// A text that is none.
    Text(TextFault),
    /// Another type, by name.
    Type(String),
}

impl fmt::Display for NoNumber {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Empty => out.write_str("the server sends no value"),
            Self::Array(0) => out.write_str("the value is an empty array"),
            Self::Array(len) => write!(
                out,
                "the value is an array of {len} elements: say which is meant by element = 0 to {}",
                len - 1
            ),
            Self::TooShort(at, len) => {
                write!(
                    out,
                    "the value is an array of {len} elements, counted from 0, and has none for element = {at}"
                )
            }
            Self::Single => out.write_str("the value is no array: leave element out"),
            Self::NotFinite => out.write_str("the value is not finite (NaN or infinite)"),
            Self::Text(fault) => fault.fmt(out),
            Self::Type(name) => write!(out, "a value of the type {name} is no number"),
        }
    }
}

/// Seconds since the Unix epoch; `None` for the null time.
pub(super) fn seconds(time: &DateTime) -> Option<f64> {
    let ticks = time.ticks();
    if time.is_null() || ticks <= 0 {
        return None;
    }
    let since = ticks - UNIX_EPOCH_TICKS;
    Some(since.div_euclid(TICKS_PER_S) as f64 + since.rem_euclid(TICKS_PER_S) as f64 / TICKS_PER_S as f64)
}

/// The time of so many seconds since the Unix epoch, as well as it can be expressed.
pub(super) fn date_time(seconds: f64) -> DateTime {
    // The cast saturates, and the sum stays far inside an i64 for any time a plant can have.
    let bounded = seconds.clamp(-1e10, 1e11);
    DateTime::from((bounded * TICKS_PER_S as f64) as i64 + UNIX_EPOCH_TICKS)
}

/// What is kept of a data value: little, however much was sent.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Received {
    /// The number before scaling, or why there is none.
    pub(super) number: Result<f64, NoNumber>,
    /// Its source's time stamp (s).
    pub(super) source: Option<f64>,
    /// The server's time stamp (s).
    pub(super) server: Option<f64>,
    status: StatusCode,
}

impl Received {
    /// What is kept of `value`, the value of a tag of this meaning.
    pub(super) fn of(value: &DataValue, meaning: &Meaning) -> Self {
        Self {
            number: number(value, meaning),
            source: value.source_timestamp.as_ref().and_then(seconds),
            server: value.server_timestamp.as_ref().and_then(seconds),
            status: value.status.unwrap_or(StatusCode::Good),
        }
    }

    /// When the value held: its source time, else what the configuration names instead. `None`: nobody knows.
    pub(super) fn time(&self, fallback: TimeFallback, arrival: f64) -> Option<f64> {
        self.source.or(match fallback {
            TimeFallback::Server => self.server,
            TimeFallback::Arrival => Some(arrival),
            TimeFallback::None => None,
        })
    }

    /// The value and whether to believe it.
    pub(super) fn reading(&self, meaning: &Meaning) -> Reading {
        if self.status.is_bad() {
            return Reading::bad(bad_reason(self.status));
        }
        let Ok(raw) = self.number else {
            return Reading::bad(BadReason::NotANumber);
        };
        let read = meaning.scaling.read(raw);
        match (read.quality, suspicion(self.status)) {
            (Quality::Good, Some(quality)) => Reading { quality, ..read },
            _ => read,
        }
    }

    /// Memory that it takes beside its own size (bytes): that of a text.
    pub(super) fn text_bytes(&self) -> usize {
        match &self.number {
            Err(NoNumber::Text(fault)) => fault.text_bytes(),
            Err(NoNumber::Type(name)) => name.capacity(),
            _ => 0,
        }
    }
}

/// The number that was sent, before scaling, or why there is none.
pub(super) fn number(value: &DataValue, meaning: &Meaning) -> Result<f64, NoNumber> {
    let value = value.value.as_ref().ok_or(NoNumber::Empty)?;
    let one = match (value, meaning.element) {
        (Variant::Array(array), Some(at)) => {
            array.values.get(at).ok_or(NoNumber::TooShort(at, array.values.len()))?
        }
        (Variant::Array(array), None) => return Err(NoNumber::Array(array.values.len())),
        (Variant::Empty, _) => return Err(NoNumber::Empty),
        (_, Some(_)) => return Err(NoNumber::Single),
        (single, None) => single,
    };
    // The elements of an array of any type come wrapped once more.
    let one = if let Variant::Variant(inner) = one { inner } else { one };
    let number = match one {
        Variant::Boolean(on) => f64::from(u8::from(*on)),
        Variant::String(text) => text_value::read(text.as_ref(), meaning.decimal).map_err(NoNumber::Text)?,
        Variant::Empty => return Err(NoNumber::Empty),
        other => other.as_f64().ok_or_else(|| NoNumber::Type(type_name(other)))?,
    };
    if number.is_finite() { Ok(number) } else { Err(NoNumber::NotFinite) }
}

/// The name of a value's type.
pub(super) fn type_name(value: &Variant) -> String {
    value.scalar_type_id().map_or_else(|| "unknown".into(), |known| format!("{known:?}"))
}

/// The code without its flags (limit and overflow bits, info type).
fn bare(status: StatusCode) -> u32 {
    status.bits() & 0xFFFF_0000
}

/// What is wrong with a value that is there.
fn suspicion(status: StatusCode) -> Option<Quality> {
    let code = bare(status);
    if code == StatusCode::UncertainEngineeringUnitsExceeded.bits() {
        return Some(Quality::Bad(BadReason::OutOfRange));
    }
    // Set by hand, or anything uncertain: an old, substituted or doubtful value is no measurement of now.
    let by_hand = code == StatusCode::GoodLocalOverride.bits();
    (status.is_uncertain() || by_hand).then_some(Quality::Stale)
}

fn bad_reason(status: StatusCode) -> BadReason {
    let code = bare(status);
    let is = |codes: &[StatusCode]| codes.iter().any(|known| known.bits() == code);
    if is(&[StatusCode::BadTimeout, StatusCode::BadRequestTimeout]) {
        BadReason::Timeout
    } else if is(&[
        StatusCode::BadNoCommunication,
        StatusCode::BadNotConnected,
        StatusCode::BadServerNotConnected,
        StatusCode::BadCommunicationError,
        StatusCode::BadConnectionClosed,
        StatusCode::BadWaitingForInitialData,
    ]) {
        BadReason::LinkDown
    } else if is(&[StatusCode::BadOutOfRange]) {
        BadReason::OutOfRange
    } else {
        BadReason::DeviceException
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PLAIN: Meaning = Meaning {
        scaling: Scaling { scale: 1.0, offset: 0.0, range: None, auto_values: None },
        element: None,
        decimal: None,
    };

    fn of(status: StatusCode, value: impl Into<Variant>) -> Reading {
        let value = DataValue { value: Some(value.into()), status: Some(status), ..DataValue::null() };
        Received::of(&value, &PLAIN).reading(&PLAIN)
    }

    #[test]
    fn status_codes_become_qualities() {
        use BadReason::*;
        let bad = |status| of(status, 1.0).quality;
        assert_eq!(of(StatusCode::Good, 1.5), Reading { value: 1.5, quality: Quality::Good });
        assert_eq!(bad(StatusCode::BadNoCommunication), Quality::Bad(LinkDown));
        assert_eq!(bad(StatusCode::BadTimeout), Quality::Bad(Timeout));
        assert_eq!(bad(StatusCode::BadOutOfRange), Quality::Bad(OutOfRange));
        assert_eq!(bad(StatusCode::BadNodeIdUnknown), Quality::Bad(DeviceException));
        assert_eq!(bad(StatusCode::BadSensorFailure), Quality::Bad(DeviceException));
        assert!(of(StatusCode::BadSensorFailure, 1.0).value.is_nan());
        let last = of(StatusCode::UncertainLastUsableValue, 1.0);
        assert_eq!((last.value, last.quality), (1.0, Quality::Stale));
        assert_eq!(bad(StatusCode::UncertainEngineeringUnitsExceeded), Quality::Bad(OutOfRange));
        assert_eq!(bad(StatusCode::GoodLocalOverride), Quality::Stale);
        // An overflow of the server's queue is said in a flag of a good code; the value itself is good.
        assert_eq!(bad(StatusCode::from(0x0000_0480)), Quality::Good);
    }

    #[test]
    fn every_number_is_read_and_nothing_else_is() {
        for value in [Variant::Byte(7), Variant::Int64(7), Variant::Float(7.0), Variant::UInt16(7)] {
            assert_eq!(of(StatusCode::Good, value).value, 7.0);
        }
        assert_eq!(of(StatusCode::Good, true).value, 1.0);
        assert_eq!(of(StatusCode::Good, "7,5").value, 7.5);
        for value in [Variant::from("x"), Variant::Empty, Variant::from(vec![7.0]), Variant::from(f64::NAN)] {
            assert_eq!(of(StatusCode::Good, value).quality, Quality::Bad(BadReason::NotANumber));
        }
        let nothing = Received::of(&DataValue::null(), &PLAIN).reading(&PLAIN);
        assert_eq!(nothing.quality, Quality::Bad(BadReason::NotANumber));
    }

    #[test]
    fn an_element_of_an_array_is_read_and_what_is_none_is_said() {
        let element = |at| Meaning { element: Some(at), ..PLAIN };
        let value = |value: Variant| DataValue { value: Some(value), ..DataValue::null() };
        let three = value(Variant::from(vec![1.5, 2.5, f64::NAN]));
        assert_eq!(number(&three, &element(1)), Ok(2.5));
        let said = |value: &DataValue, meaning: &Meaning| number(value, meaning).unwrap_err().to_string();
        assert!(
            said(&three, &PLAIN).contains("array of 3 elements") && said(&three, &PLAIN).contains("0 to 2")
        );
        assert!(said(&three, &element(3)).contains("element = 3"));
        assert!(said(&three, &element(2)).contains("NaN"));
        assert!(said(&value(Variant::from(vec![0.0; 0])), &PLAIN).contains("empty array"));
        assert!(said(&value(Variant::from(1.0)), &element(0)).contains("no array"));
        assert!(said(&value(Variant::from("Bad")), &PLAIN).contains("'Bad'"));
        assert!(said(&value(Variant::from(date_time(1.0))), &PLAIN).contains("DateTime"));
        assert!(said(&DataValue::null(), &PLAIN).contains("no value"));
    }

    #[test]
    fn the_source_time_is_kept_and_the_fallback_is_the_one_named() {
        let (source, server) = (date_time(1000.0), date_time(2000.0));
        let full =
            DataValue { source_timestamp: Some(source), server_timestamp: Some(server), ..DataValue::null() };
        let without = DataValue { source_timestamp: None, ..full.clone() };
        let null = DataValue { source_timestamp: Some(DateTime::null()), ..full.clone() };
        let time = |value: &DataValue, fallback, arrival| Received::of(value, &PLAIN).time(fallback, arrival);
        let all = [TimeFallback::Server, TimeFallback::Arrival, TimeFallback::None];
        for fallback in all {
            assert_eq!(time(&full, fallback, 3000.0), Some(1000.0));
        }
        for value in [without, null] {
            assert_eq!(all.map(|f| time(&value, f, 3000.0)), [Some(2000.0), Some(3000.0), None]);
        }
        assert_eq!(time(&DataValue::null(), TimeFallback::Server, 3000.0), None);
    }

    #[test]
    fn little_is_kept_of_a_value_however_large() {
        assert!(size_of::<Received>() <= 80, "{}", size_of::<Received>());
        let kept = |value: Variant| {
            let value = DataValue { value: Some(value), ..DataValue::null() };
            Received::of(&value, &PLAIN).text_bytes()
        };
        assert_eq!(kept(Variant::from(7.0)), 0);
        assert_eq!(kept(Variant::from(vec![7.0; 20_000])), 0);
        let text = kept(Variant::from("\u{1f321}".repeat(10_000).as_str()));
        assert!((1..=256).contains(&text), "{text}");
    }

    proptest! {
        #[test]
        fn times_come_back(t in 0.0..4e9f64) {
            let back = seconds(&date_time(t)).unwrap();
            // A tick is 100 ns, and a double of this size has steps of up to 4.8e-7 s.
            prop_assert!((back - t).abs() < 1e-6, "{} {}", back, t);
        }

        #[test]
        fn any_status_and_number_give_a_sound_reading(bits in any::<u32>(), raw in any::<f64>()) {
            let read = of(StatusCode::from(bits), raw);
            prop_assert!(read.value.is_finite() || read.quality != Quality::Good);
        }
    }
}
