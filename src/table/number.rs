//! One cell as a number: its shape, which decimal sign it proves, and its value once the sign is decided.
//!
//! | shape | example | proves |
//! |---|---|---|
//! | `Plain` | `52`, `1 234`, `1e3` | nothing |
//! | `Decimal` | `51,8`, `0.123`, `1234.567` | that its sign is the decimal one |
//! | `Either` | `1,002` | nothing: 1.002 or 1002 |
//! | `Grouped` | `1,234,567` | that its sign marks thousands |
//! | `Both` | `1.234,5` | that the last sign is the decimal one |

/// Longest number that is read (bytes): the least one above zero, written out.
const LONGEST: usize = 384;
/// Longest unit behind a number (bytes).
const LONGEST_UNIT: usize = 16;

/// Which sign divides the whole part from the fraction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decimal {
    /// `51.8`
    Point,
    /// `51,8`
    Comma,
}

impl Decimal {
    /// As it is written.
    pub(super) fn sign(self) -> u8 {
        match self {
            Decimal::Point => b'.',
            Decimal::Comma => b',',
        }
    }

    /// As it is told.
    pub(super) fn name(self) -> &'static str {
        match self {
            Decimal::Point => "decimal point",
            Decimal::Comma => "decimal comma",
        }
    }

    /// The other one, which may mark thousands.
    pub fn other(self) -> Self {
        match self {
            Decimal::Point => Decimal::Comma,
            Decimal::Comma => Decimal::Point,
        }
    }

    fn of(sign: u8) -> Self {
        if sign == b',' { Decimal::Comma } else { Decimal::Point }
    }
}

/// What the signs within a number can mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Neither point nor comma.
    Plain,
    /// One sign that can only be the decimal one.
    Decimal(Decimal),
    /// One sign with three digits behind it: decimal or thousands.
    Either(Decimal),
    /// This sign marks thousands, more than once.
    Grouped(Decimal),
    /// Thousands and a fraction, divided by this sign.
    Both(Decimal),
}

/// A cell that looks like a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Number<'a> {
    text: &'a str,
    /// What its signs can mean.
    pub form: Form,
    /// What stands behind it: `%`, `kPa`; empty without one.
    pub unit: &'a str,
    /// As accountants write it: `12.5-`, `(12.5)`.
    negated: bool,
}

/// What marks thousands without doubt: blanks and apostrophes.
fn is_gap(c: char) -> bool {
    matches!(c, ' ' | '\u{a0}' | '\u{202f}' | '\u{2009}' | '\'' | '\u{2019}')
}

/// The cell without what surrounds it: blanks, a byte order mark, the zero byte of a C string, quotes that a blank before them
/// hides from a reader of tables.
pub fn bare(cell: &str) -> &str {
    let around = |c: char| c.is_whitespace() || matches!(c, '\0' | '\u{feff}');
    let cell = cell.trim_matches(around);
    // `="51.8"` and `'51.8` keep a spreadsheet from reading a number.
    let cell = cell.strip_prefix('=').filter(|rest| rest.starts_with('"')).unwrap_or(cell);
    let digit = |text: &&str| {
        text.trim_start_matches(['+', '-']).starts_with(|c: char| c.is_ascii_digit()) && !text.ends_with('\'')
    };
    let cell = cell.strip_prefix('\'').filter(digit).unwrap_or(cell);
    let quoted = |sign: char| cell.strip_prefix(sign)?.strip_suffix(sign);
    quoted('"').or_else(|| quoted('\'')).map_or(cell, |inner| inner.trim_matches(around))
}

/// The cell as a number; `None` for anything else, dates and addresses among it.
pub fn scan(cell: &str) -> Option<Number<'_>> {
    let cell = bare(cell);
    let inner =
        cell.strip_prefix('(').and_then(|cell| cell.strip_suffix(')')).or_else(|| cell.strip_suffix('-'));
    if let Some(inner) = inner.filter(|inner| {
        let digit = |c: char| c.is_ascii_digit();
        inner.starts_with(digit) && inner.ends_with(digit)
    }) {
        return scan(inner)
            .filter(|number| number.unit.is_empty())
            .map(|number| Number { negated: true, ..number });
    }
    // Loggers write `+  51.8`.
    let signed = cell.strip_prefix(['+', '-', '\u{2212}']).map_or(cell, |rest| rest.trim_start_matches(' '));
    let at = cell.len() - signed.len();
    let mut end = digits_end(signed);
    if !signed[..end].bytes().any(|byte| byte.is_ascii_digit()) {
        return None;
    }
    let whole = &signed[..end];
    let exponent = exponent(&signed[end..]);
    end += exponent;
    let rest = &signed[end..];
    let unit = rest.trim_start_matches(is_gap);
    let opens = |c: char| c.is_alphabetic() || matches!(c, '%' | '°' | '‰' | '/' | 'µ');
    if unit.len() > LONGEST_UNIT || !unit.is_empty() && !unit.starts_with(opens) {
        return None;
    }
    let text = &cell[..at + end];
    // `1.234E+02`: nobody marks thousands before an exponent.
    let form = match form(whole)? {
        Form::Either(own) if exponent > 0 => Form::Decimal(own),
        form => form,
    };
    (text.len() <= LONGEST).then_some(Number { text, form, unit, negated: false })
}

/// Where digits with their signs end; a blank belongs to them only between digits.
fn digits_end(text: &str) -> usize {
    let mut end = 0;
    for (at, c) in text.char_indices() {
        if c.is_ascii_digit() || matches!(c, '.' | ',') {
            end = at + 1;
        } else {
            let after = &text[at + c.len_utf8()..];
            let three = after.bytes().take_while(u8::is_ascii_digit).count() == 3;
            if !is_gap(c) || end == 0 || !three {
                break;
            }
        }
    }
    end
}

/// The bytes of an exponent, 0 without one; Fortran writes `D+02`.
fn exponent(text: &str) -> usize {
    let Some(rest) = text.strip_prefix(['e', 'E', 'd', 'D']) else { return 0 };
    let signed = rest.strip_prefix(['+', '-']);
    // `5 d` and `5D2` are no numbers with an exponent.
    if signed.is_none() && text.starts_with(['d', 'D']) {
        return 0;
    }
    let digits = signed.unwrap_or(rest);
    let count = digits.bytes().take_while(u8::is_ascii_digit).count();
    if count == 0 { 0 } else { text.len() - digits.len() + count }
}

/// What the signs of digits mean; `None` where no number is written so.
fn form(text: &str) -> Option<Form> {
    let gaps = text.chars().any(is_gap);
    let (mut signs, mut runs) = ([0u8; 2], [0usize; 2]);
    let (mut count, mut kinds) = (0, 0);
    let mut run = 0;
    let mut first = 0;
    // In threes, or as in India: a three at the end, twos before it.
    let (mut threes, mut twos) = (true, true);
    for byte in text.bytes() {
        if byte.is_ascii_digit() {
            run += 1;
        } else if matches!(byte, b'.' | b',') {
            if count == 0 {
                first = run;
            } else {
                let last = signs[kinds - 1] != byte;
                threes &= run == 3;
                twos &= run == if last { 3 } else { 2 };
            }
            if kinds == 0 || signs[kinds - 1] != byte {
                if kinds == 2 {
                    return None;
                }
                signs[kinds] = byte;
                kinds += 1;
            }
            runs[kinds - 1] += 1;
            count += 1;
            run = 0;
        } else if matches!(byte, b' ' | b'\'') || byte >= 0xc2 {
            // A gap begins: three digits follow, as was seen before; those before it are no group of a sign.
            run = 0;
        }
    }
    let leads = (1..=3).contains(&first) && !text.starts_with('0');
    let grouped = threes || twos && first <= 2 && signs[0] == b',';
    match kinds {
        0 => Some(Form::Plain),
        1 if count == 1 => {
            let own = Decimal::of(signs[0]);
            let either = !gaps && leads && run == 3;
            Some(if either { Form::Either(own) } else { Form::Decimal(own) })
        }
        1 => (!gaps && leads && grouped && run == 3).then_some(Form::Grouped(Decimal::of(signs[0]))),
        _ => (!gaps && leads && grouped && runs[1] == 1).then_some(Form::Both(Decimal::of(signs[1]))),
    }
}

/// What stands behind the digits of a cell and makes it no number: `*` of `51.8*`. Dates and addresses have digits behind it, too.
pub(super) fn mark(cell: &str) -> Option<&str> {
    let cell = bare(cell);
    let signed = cell.trim_start_matches(['+', '-', '\u{2212}']);
    let (digits, mark) = signed.split_at(digits_end(signed));
    let mark = mark.trim();
    let is_mark = !mark.is_empty() && !mark.bytes().any(|byte| byte.is_ascii_digit());
    (is_mark && scan(digits).is_some() && scan(cell).is_none()).then_some(mark)
}

impl<'a> Number<'a> {
    /// The same number with something else behind it.
    pub(super) fn with_unit(self, unit: &'a str) -> Self {
        Self { unit, ..self }
    }

    /// Whether it is written with one.
    pub(super) fn has_exponent(&self) -> bool {
        self.text.contains(['e', 'E', 'd', 'D'])
    }

    /// Its value under a decimal sign; `None` where it is not written so, or is not finite.
    pub fn value(&self, decimal: Decimal) -> Option<f64> {
        let fits = match self.form {
            Form::Plain | Form::Either(_) => true,
            Form::Decimal(own) | Form::Both(own) => own == decimal,
            Form::Grouped(own) => own != decimal,
        };
        if !fits {
            return None;
        }
        let (mut digits, mut n) = ([0u8; LONGEST], 0);
        for c in self.text.chars() {
            digits[n] = match c {
                '\u{2212}' => b'-',
                'd' | 'D' => b'e',
                '.' | ',' if c as u8 == decimal.sign() => b'.',
                '.' | ',' => continue,
                c if is_gap(c) => continue,
                c => u8::try_from(c).ok()?,
            };
            n += 1;
        }
        let value: f64 = std::str::from_utf8(&digits[..n]).ok()?.parse().ok()?;
        value.is_finite().then_some(if self.negated { -value } else { value })
    }
}

#[cfg(test)]
mod tests {
    use super::Decimal::{Comma, Point};
    use super::*;

    #[test]
    fn a_number_is_read_under_the_sign_that_is_decided() {
        let cases = [
            ("51.8", Form::Decimal(Point), Some(51.8), None),
            ("51,8", Form::Decimal(Comma), None, Some(51.8)),
            ("1,002", Form::Either(Comma), Some(1002.0), Some(1.002)),
            ("-1.002", Form::Either(Point), Some(-1.002), Some(-1002.0)),
            ("0,002", Form::Decimal(Comma), None, Some(0.002)),
            ("1234,567", Form::Decimal(Comma), None, Some(1234.567)),
            ("1,234,567", Form::Grouped(Comma), Some(1_234_567.0), None),
            ("12,34,567", Form::Grouped(Comma), Some(1_234_567.0), None),
            ("12,34,567.5", Form::Both(Point), Some(1_234_567.5), None),
            ("51.8-", Form::Decimal(Point), Some(-51.8), None),
            ("(1,234.5)", Form::Both(Point), Some(-1234.5), None),
            ("1.234,5", Form::Both(Comma), None, Some(1234.5)),
            ("1,234.5", Form::Both(Point), Some(1234.5), None),
            ("1 234,5", Form::Decimal(Comma), None, Some(1234.5)),
            ("1\u{202f}234", Form::Plain, Some(1234.0), Some(1234.0)),
            ("1'234.50", Form::Decimal(Point), Some(1234.5), None),
            ("+50.1", Form::Decimal(Point), Some(50.1), None),
            ("-  50.1", Form::Decimal(Point), Some(-50.1), None),
            ("=\"50.1\"", Form::Decimal(Point), Some(50.1), None),
            ("'50.1", Form::Decimal(Point), Some(50.1), None),
            ("\u{2212}5", Form::Plain, Some(-5.0), Some(-5.0)),
            ("1e-3", Form::Plain, Some(0.001), Some(0.001)),
            ("1,5E+02", Form::Decimal(Comma), None, Some(150.0)),
            ("1.234E+02", Form::Decimal(Point), Some(123.4), None),
            ("0.51812D+02", Form::Decimal(Point), Some(51.812), None),
            (".5", Form::Decimal(Point), Some(0.5), None),
            ("5.", Form::Decimal(Point), Some(5.0), None),
            ("7\0", Form::Plain, Some(7.0), Some(7.0)),
        ];
        for (text, form, point, comma) in cases {
            let number = scan(text).unwrap_or_else(|| panic!("{text} is a number"));
            assert_eq!(
                (number.form, number.value(Point), number.value(Comma)),
                (form, point, comma),
                "{text}"
            );
        }
    }

    #[test]
    fn units_stand_behind_and_what_is_no_number_is_none() {
        for (text, unit) in [("50.1 %", "%"), ("50,1%", "%"), ("7 m3/h", "m3/h"), ("12.5\u{a0}°C", "°C")] {
            assert_eq!(scan(text).map(|number| number.unit), Some(unit), "{text}");
        }
        for text in
            ["", "-", "Bad", "01.06.2026", "06:00:00", "2026-06-01", "10.0.0.5", "1,2,3", "1,23.4,5", "NaN"]
        {
            assert_eq!((scan(text), mark(text)), (None, None), "{text}");
        }
        assert_eq!(scan("1e999").and_then(|number| number.value(Point)), None);
    }

    #[test]
    fn what_makes_digits_no_number_is_named() {
        for (text, behind) in
            [("51.8*", "*"), ("-51,8 *", "*"), ("51.8 (ok?)", "(ok?)"), ("7 ?", "?"), ("51.8#", "#")]
        {
            assert_eq!((scan(text), mark(text)), (None, Some(behind)), "{text}");
        }
        for text in ["51.8", "51.8 %", "51.8 bar", "-5", "5-", "shut", "2024-02-30x"] {
            assert_eq!(mark(text), None, "{text}");
        }
    }
}
