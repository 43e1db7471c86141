//! A value that a device sends as text: `12,5`, `50.1 °C`, `+50.1`, `ON`. Read as one number or refused, never guessed.

use crate::table::number::{self, Decimal, Form};
use serde::Deserialize;
use std::fmt;

/// Most characters of a text that an error quotes.
const QUOTED: usize = 40;
/// Units that would multiply the number: nobody knows whether they are meant so.
const MULTIPLIERS: [&str; 3] = ["k", "M", "G"];

/// The sign before the decimals, `decimal` in the configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub enum DecimalSign {
    /// `51.8`; a comma marks thousands.
    #[serde(rename = ".")]
    Point,
    /// `51,8`; a point marks thousands.
    #[serde(rename = ",")]
    Comma,
}

/// Why a text is no value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TextFault {
    /// Neither a number nor a switch.
    NoNumber(String),
    /// It can be read in two ways.
    Doubtful(String),
    /// Not written with the decimal sign of the configuration.
    OtherSign(String, DecimalSign),
}

impl TextFault {
    /// Memory that the quoted text takes (bytes).
    pub fn text_bytes(&self) -> usize {
        match self {
            Self::NoNumber(text) | Self::Doubtful(text) | Self::OtherSign(text, _) => text.capacity(),
        }
    }
}

impl fmt::Display for TextFault {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoNumber(text) => write!(out, "the text '{text}' is no number"),
            Self::Doubtful(text) => write!(
                out,
                "the text '{text}' may have a decimal comma or mark thousands: say which by decimal = \",\" or \".\""
            ),
            Self::OtherSign(text, sign) => {
                let sign = if *sign == DecimalSign::Point { "." } else { "," };
                write!(out, "the text '{text}' is not written with decimal = \"{sign}\"")
            }
        }
    }
}

/// The text as a finite number; a switch is 1 or 0.
///
/// A point is the decimal sign unless the configuration says otherwise, since programs write it so. A comma is it where it
/// can be nothing else.
///
/// # Errors
/// [`TextFault`], with the beginning of the text.
pub fn read(text: &str, decimal: Option<DecimalSign>) -> Result<f64, TextFault> {
    let bare = number::bare(text);
    match bare.to_ascii_lowercase().as_str() {
        "on" | "true" => return Ok(1.0),
        "off" | "false" => return Ok(0.0),
        _ => {}
    }
    let quoted = || bare.chars().take(QUOTED).map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect();
    let none = || TextFault::NoNumber(quoted());
    let found = number::scan(bare).filter(|found| !MULTIPLIERS.contains(&found.unit)).ok_or_else(none)?;
    let sign = match (decimal, found.form) {
        (Some(DecimalSign::Point), _) => Decimal::Point,
        (Some(DecimalSign::Comma), _) => Decimal::Comma,
        (None, Form::Either(Decimal::Comma)) => return Err(TextFault::Doubtful(quoted())),
        (None, Form::Plain | Form::Either(Decimal::Point)) => Decimal::Point,
        (None, Form::Decimal(own) | Form::Both(own)) => own,
        (None, Form::Grouped(own)) => own.other(),
    };
    match (found.value(sign), decimal, found.form) {
        (Some(value), ..) => Ok(value),
        (None, Some(sign), Form::Decimal(_) | Form::Both(_) | Form::Grouped(_)) => {
            Err(TextFault::OtherSign(quoted(), sign))
        }
        _ => Err(none()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn what_devices_write_is_read() {
        for (text, value) in [
            ("12,5", 12.5),
            ("50.1 °C", 50.1),
            ("50.1%", 50.1),
            ("+50.1", 50.1),
            ("50.1\0\0", 50.1),
            ("\u{feff}50.1\r\n", 50.1),
            ("ON", 1.0),
            ("off", 0.0),
            ("True", 1.0),
            ("1.002", 1.002),
            ("0,125", 0.125),
            ("1.234,5", 1234.5),
            ("1,234.5", 1234.5),
            ("1 234,5", 1234.5),
            ("-1e-3", -0.001),
            ("7 m3/h", 7.0),
        ] {
            assert_eq!(read(text, None), Ok(value), "{text}");
        }
    }

    #[test]
    fn what_is_doubtful_is_decided_by_the_option_alone() {
        let fault = read("1,002", None).unwrap_err();
        assert!(fault.to_string().contains("decimal = \",\""), "{fault}");
        assert_eq!(read("1,002", Some(DecimalSign::Comma)), Ok(1.002));
        assert_eq!(read("1,002", Some(DecimalSign::Point)), Ok(1002.0));
        assert_eq!(read("1.002", Some(DecimalSign::Comma)), Ok(1002.0));
        let fault = read("12.5", Some(DecimalSign::Comma)).unwrap_err();
        assert_eq!(fault, TextFault::OtherSign("12.5".into(), DecimalSign::Comma));
    }

    #[test]
    fn anything_else_is_refused_and_quoted_in_short() {
        for text in
            ["", "Bad", "NaN", "inf", "10:30:00", "2026-06-01", "1,2,3", "5 k", "1.2M", "1e999", "50.1 12"]
        {
            assert!(matches!(read(text, None), Err(TextFault::NoNumber(_))), "{text}");
        }
        let long = read(&"x".repeat(1000), None).unwrap_err().to_string();
        assert!(long.len() < 100, "{long}");
        assert!(!read("a\nb", None).unwrap_err().to_string().contains('\n'));
    }

    proptest! {
        #[test]
        fn any_text_is_a_finite_number_or_refused(text in "\\PC{0,20}") {
            for decimal in [None, Some(DecimalSign::Point), Some(DecimalSign::Comma)] {
                prop_assert!(read(&text, decimal).is_ok_and(f64::is_finite) || read(&text, decimal).is_err());
            }
        }

        #[test]
        fn numbers_come_back(number in any::<f64>().prop_filter("finite", |x| x.is_finite())) {
            prop_assert_eq!(read(&format!("{number:e}"), None), Ok(number));
        }
    }
}
