//! Numbers in sentences: with how many digits, and with which words.

use std::cmp::Ordering;
use std::fmt::Display;

/// Most decimals of a number in a sentence.
const MOST_DECIMALS: usize = 12;
/// Difference from a limit, as a share of it, from which on a number is another: a smaller one is an error of rounding.
const APART: f64 = 1e-9;

/// A number in a sentence: three decimals, and more where three significant figures need them.
pub fn told(value: f64) -> String {
    format!("{value:.0$}", decimals(value))
}

/// The decimals of [`told`].
fn decimals(value: f64) -> usize {
    let size = value.abs();
    if size > 0.0 && size < 0.1 { (2.0 - size.log10().floor()).min(MOST_DECIMALS as f64) as usize } else { 3 }
}

/// A number that is judged by limits: with so many decimals, and with as many more as show on which side of each limit it is. So 1.96
/// with one decimal is `1.96` beside a limit of 2, and `2.0` without one.
pub fn beside(value: f64, limits: &[f64], decimals: usize) -> String {
    let side = |value: f64, limit: f64| match (value - limit).abs() <= APART * limit.abs() {
        true => Some(Ordering::Equal),
        false => value.partial_cmp(&limit),
    };
    let is_right = |text: &str| {
        text.parse::<f64>()
            .is_ok_and(|told| limits.iter().all(|limit| side(told, *limit) == side(value, *limit)))
    };
    let mut text = format!("{value:.decimals$}");
    for more in decimals + 1..=MOST_DECIMALS {
        if is_right(&text) {
            break;
        }
        text = format!("{value:.more$}");
    }
    text
}

/// A distance along OP (OP unit) in a sentence: in per cent of the span where that is known.
pub fn along_op(distance: f64, span: Option<f64>) -> String {
    along_op_beside(distance, &[], span)
}

/// [`along_op`] of a distance that is judged by limits (OP unit), with as many digits as show on which side of each it is.
pub fn along_op_beside(distance: f64, limits: &[f64], span: Option<f64>) -> String {
    let (per, unit) = span.map_or((1.0, "OP"), |span| (100.0 / span, "% OP"));
    let limits: Vec<f64> = limits.iter().map(|limit| per * limit).collect();
    let distance = per * distance;
    format!("{} {unit}", beside(distance, &limits, decimals(distance)))
}

/// A share (0..1) in a sentence: in per cent, with so many decimals. A share that would be rounded to nothing is said to be less than
/// the least that can be written.
pub fn share(share: f64, decimals: usize) -> String {
    share_beside(share, &[], decimals)
}

/// [`share`] of one that is judged by limits (-), with as many digits as show on which side of each it is.
pub fn share_beside(share: f64, limits: &[f64], decimals: usize) -> String {
    let percent = 100.0 * share;
    let limits: Vec<f64> = limits.iter().map(|limit| 100.0 * limit).collect();
    let text = beside(percent, &limits, decimals);
    let is_nothing = text.parse::<f64>().is_ok_and(|told| told == 0.0);
    match percent > 0.0 && is_nothing {
        true => format!("less than {:.decimals$} %", 10f64.powi(-(decimals as i32))),
        false => format!("{text} %"),
    }
}

/// A time or a size in a sentence: four significant digits, without trailing zeros.
pub fn figures(value: f64) -> String {
    if value != 0.0 && !(1e-4..1e9).contains(&value.abs()) {
        return format!("{value:.3e}");
    }
    let digits = if value == 0.0 { 0 } else { 3 - value.abs().log10().floor() as i32 };
    let decimals = digits.clamp(0, 8) as usize;
    trimmed(format!("{value:.decimals$}"))
}

/// A number without trailing zeros.
pub fn trimmed(text: String) -> String {
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_string(),
        false => text,
    }
}

/// So many of these: `1 row`, `2 rows`.
pub fn many<N: Display + PartialEq + From<u8>>(count: N, of: &str) -> String {
    let ending = if count == N::from(1) { "" } else { "s" };
    format!("{count} {of}{ending}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_sentences_keep_three_figures() {
        let cases = [
            (2.5, "2.500"),
            (0.4123, "0.412"),
            (0.012_345, "0.0123"),
            (-4.123e-5, "-0.0000412"),
            (0.0, "0.000"),
        ];
        for (value, text) in cases {
            assert_eq!(told(value), text);
        }
        assert_eq!(told(f64::NAN), "NaN");
        assert_eq!(told(1e-300), "0.000000000000");
    }

    #[test]
    fn a_number_is_never_told_on_the_other_side_of_its_limit() {
        for (value, limits, decimals, text) in [
            (1.96, &[2.0, 5.0][..], 1, "1.96"),
            (1.996, &[2.0, 5.0], 1, "1.996"),
            (5.04, &[2.0, 5.0], 1, "5.04"),
            (2.04, &[], 1, "2.0"),
            (2.0, &[2.0, 5.0], 1, "2.0"),
            (1.3, &[2.0, 5.0], 1, "1.3"),
            (19.7, &[20.0], 0, "19.7"),
            (20.04, &[20.0], 0, "20.04"),
            (18.7, &[20.0], 0, "19"),
            // A threshold of 0 is told apart from what is above it, and an error of rounding is none.
            (0.3, &[0.0], 0, "0.3"),
            (0.1 + 0.2, &[0.3], 1, "0.3"),
        ] {
            assert_eq!(beside(value, limits, decimals), text, "{value} beside {limits:?}");
        }
        assert_eq!(beside(f64::NAN, &[2.0], 1), "NaN");
    }

    #[test]
    fn a_distance_along_op_keeps_the_side_of_its_threshold() {
        assert_eq!(along_op(0.4, Some(16.0)), "2.500 % OP");
        assert_eq!(along_op(0.4, None), "0.400 OP");
        // 0.05 % of 16 mA are 0.008 mA.
        assert_eq!(along_op(0.007_999, Some(16.0)), "0.0500 % OP");
        assert_eq!(along_op_beside(0.007_999, &[0.008], Some(16.0)), "0.04999 % OP");
        assert_eq!(along_op_beside(0.008, &[0.008], Some(16.0)), "0.0500 % OP");
    }

    #[test]
    fn a_share_that_is_there_is_never_told_as_nothing() {
        for (value, decimals, text) in [
            (0.123, 0, "12 %"),
            (0.123_45, 1, "12.3 %"),
            (0.0, 1, "0.0 %"),
            (0.004, 0, "less than 1 %"),
            (0.000_4, 1, "less than 0.1 %"),
            (0.006, 0, "1 %"),
            (1.0, 0, "100 %"),
        ] {
            assert_eq!(share(value, decimals), text, "{value}");
        }
        assert_eq!(share_beside(0.162, &[0.16], 0), "16.2 %");
        assert_eq!(share_beside(0.003, &[0.0, 0.58], 0), "0.3 %");
        assert_eq!(share_beside(0.003, &[f64::NEG_INFINITY, 0.16], 0), "less than 1 %");
    }

    #[test]
    fn one_is_not_told_as_many() {
        assert_eq!([0, 1, 2].map(|count| many(count, "request")), ["0 requests", "1 request", "2 requests"]);
        assert_eq!(many(1_u64, "row"), "1 row");
    }
}
