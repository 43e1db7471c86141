//! Random dialects and random bytes: what is read is what was written, or it is refused; never other numbers.

use super::dress::{Date, Extra, Form, Names, dressed};
use super::of_bytes;
use proptest::prelude::*;
use std::time::{Duration, Instant};
use stictiond::collect::table::Options;
use stictiond::signal::{Record, Sample};

fn pick<T: Copy + std::fmt::Debug>(all: &'static [T]) -> impl Strategy<Value = T> {
    (0..all.len()).prop_map(|at| all[at])
}

/// A record of random values with so many digits.
fn records() -> impl Strategy<Value = Record> {
    let value = || {
        (any::<i32>(), 0..4u32).prop_map(|(n, digits)| f64::from(n % 3_000_000) / 10f64.powi(digits as i32))
    };
    prop::collection::vec((value(), value(), value()), 3..40).prop_map(|rows| {
        let series = |of: fn(&(f64, f64, f64)) -> f64| -> Vec<Sample> {
            rows.iter().enumerate().map(|(k, row)| Sample::good(2.5 * k as f64, of(row))).collect()
        };
        Record { op: series(|r| r.0), pv: series(|r| r.1), sp: Some(series(|r| r.2)), ..Record::default() }
    })
}

/// A number as a plant may write it: with thousands, with fixed decimals.
fn written(value: f64, decimal: char, thousands: Option<char>, digits: Option<usize>) -> String {
    let text = digits.map_or_else(|| value.to_string(), |digits| format!("{value:.digits$}"));
    let (whole, fraction) = text.split_once('.').map_or((text.as_str(), None), |(a, b)| (a, Some(b)));
    let (sign, whole) = whole.strip_prefix('-').map_or(("", whole), |rest| ("-", rest));
    let mut grouped = String::new();
    for (at, digit) in whole.chars().enumerate() {
        if let Some(thousands) = thousands.filter(|_| at > 0 && (whole.len() - at) % 3 == 0) {
            grouped.push(thousands);
        }
        grouped.push(digit);
    }
    let fraction = fraction.map(|f| format!("{decimal}{f}")).unwrap_or_default();
    format!("{sign}{grouped}{fraction}")
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    #[test]
    fn what_is_read_is_what_was_written(
        record in records(),
        separator in pick(&[',', ';', '\t', '|']),
        decimal in pick(&['.', ',']),
        date in pick(&Date::ALL),
        names in pick(&Names::ALL),
        extra in pick(&[Extra::None, Extra::Preamble, Extra::Comments, Extra::Bom, Extra::Utf16, Extra::SepLine]),
    ) {
        let form = Form { separator, decimal, date, names, extra };
        let (bytes, times) = dressed(&record, &form);
        // Refused is right, too: three decimals everywhere may be thousands.
        if let Ok(found) = of_bytes(&bytes, &Options::default()) {
            for (read, written) in [(&found.record.op, &record.op), (&found.record.pv, &record.pv)] {
                prop_assert_eq!(read.len(), written.len());
                for ((read, written), t) in read.iter().zip(written).zip(&times) {
                    prop_assert_eq!(read.value, written.value, "{:?}: {}", form, found.found.read_as);
                    prop_assert!((read.t - t).abs() < 1e-3, "{:?}: {} and {}", form, read.t, t);
                }
            }
        }
    }

    /// OP is written as controllers have it, in 0 to 100; PV with thousands, or with decimals in every cell.
    #[test]
    fn thousands_are_read_or_refused(
        rows in prop::collection::vec((0..100_000i32, any::<i32>()), 3..30),
        separator in pick(&[';', '\t', '|', ',']),
        decimal in pick(&['.', ',']),
        thousands in pick(&[None, Some('.'), Some(','), Some(' '), Some('\'')]),
        op_digits in pick(&[None, Some(0), Some(1), Some(3)]),
        pv_digits in pick(&[None, Some(0), Some(2), Some(3)]),
        scale in pick(&[1.0, 10.0, 1000.0]),
    ) {
        let thousands = thousands.filter(|sign| *sign != decimal);
        let mut text = format!("t{separator}op{separator}pv\n");
        let mut meant = Vec::new();
        for (k, (op, pv)) in rows.iter().enumerate() {
            let (op, pv) = (f64::from(*op) / 1000.0, f64::from(pv % 5_000_000) / scale);
            let cells = [k.to_string(), written(op, decimal, None, op_digits), written(pv, decimal, thousands, pv_digits)];
            text += &(cells.map(|cell| format!("\"{cell}\"")).join(&separator.to_string()) + "\n");
            // As it was rounded when it was written.
            let rounded = |value: f64, digits: Option<usize>| -> f64 {
                digits.map_or(value, |digits| format!("{value:.digits$}").parse().expect("a number"))
            };
            meant.push((rounded(op, op_digits), rounded(pv, pv_digits)));
        }
        if let Ok(found) = of_bytes(text.as_bytes(), &Options::default()) {
            prop_assert_eq!(found.record.op.len(), meant.len());
            for ((op, pv), meant) in found.record.op.iter().zip(&found.record.pv).zip(&meant) {
                prop_assert_eq!((op.value, pv.value), *meant, "{}\n{}", found.found.read_as, text);
            }
        }
    }

    /// Bytes changed, cut out and put in: a record, or a refusal in one line, soon.
    #[test]
    fn a_damaged_table_is_read_or_refused(
        record in records(),
        separator in pick(&[',', ';', '\t', '|']),
        date in pick(&Date::ALL),
        extra in pick(&Extra::ALL),
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..3u8), 0..12),
    ) {
        let form = Form { separator, decimal: '.', date, names: Names::Tags, extra };
        let (mut bytes, _) = dressed(&record, &form);
        for (at, byte, how) in damage {
            let at = at.index(bytes.len());
            match how {
                0 => bytes[at] = byte,
                1 => bytes.insert(at, byte),
                _ => drop(bytes.remove(at)),
            }
        }
        let began = Instant::now();
        match of_bytes(&bytes, &Options::default()) {
            Ok(found) => {
                let series = [&found.record.op, &found.record.pv];
                for sample in series.into_iter().flatten() {
                    prop_assert!(sample.t.is_finite());
                    prop_assert!(sample.value.is_finite() || !sample.quality.is_good());
                }
                prop_assert_eq!(found.found.read_as.lines().count(), 1);
            }
            Err(error) => prop_assert_eq!(error.lines().count(), 1, "{}", error),
        }
        prop_assert!(began.elapsed() < Duration::from_secs(20));
    }

    #[test]
    fn any_bytes_are_a_record_or_a_refusal(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
        let _ = of_bytes(&bytes, &Options::default());
    }

    /// Text of the signs that tables are made of gets further than any bytes.
    #[test]
    fn any_rows_give_judged_samples(rows in "[0-9a-zN.,;:/\"\t\r\n+ %-]{0,300}", semicolon: bool) {
        let header = if semicolon { "t;op;pv;x\n" } else { "t,op,pv,x\n" };
        if let Ok(found) = of_bytes(format!("{header}{rows}").as_bytes(), &Options::default()) {
            let lines = rows.split(['\n', '\r']).count();
            let tags = found.record.tags.iter().map(|(_, series)| series);
            for series in [&found.record.op, &found.record.pv].into_iter().chain(tags) {
                prop_assert!(series.len() <= lines);
                for sample in series {
                    prop_assert!(sample.t.is_finite());
                    prop_assert_eq!(sample.value.is_finite(), sample.quality.is_good());
                }
            }
        }
    }
}
