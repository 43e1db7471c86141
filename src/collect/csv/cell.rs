//! One cell: blank, a number, a time, or rubbish.

use super::header::Column;
use crate::signal::Role;

/// Modes in which the controller moves the valve by itself.
const AUTOMATIC: [&str; 6] = ["auto", "automatic", "aut", "cas", "cascade", "rcas"];
/// Modes in which it does not.
const NOT_AUTOMATIC: [&str; 6] = ["man", "manual", "rout", "oos", "iman", "lo"];

/// How the file writes its cells.
pub struct Cells {
    /// Whether `1,5` may mean one and a half.
    pub decimal_comma: bool,
}

impl Cells {
    /// The cell as a finite value of its role; `None` when it is no such number.
    pub fn value(&self, cell: &[u8], role: Column) -> Option<f64> {
        if role == Column::Role(Role::Mode) {
            return self.mode(cell);
        }
        self.number(cell)
    }

    /// The cell as a finite number.
    pub fn number(&self, cell: &[u8]) -> Option<f64> {
        let text = std::str::from_utf8(cell.trim_ascii()).ok()?;
        let value = match text.parse::<f64>() {
            Ok(value) => value,
            Err(_) => self.with_decimal_comma(text)?,
        };
        value.is_finite().then_some(value)
    }

    /// `1,5` as 1.5, on the stack; a comma beside a point could be a thousands separator and is refused.
    fn with_decimal_comma(&self, text: &str) -> Option<f64> {
        let mut digits = [0u8; 64];
        if !self.decimal_comma || text.len() > digits.len() || text.contains('.') {
            return None;
        }
        let digits = &mut digits[..text.len()];
        digits.copy_from_slice(text.as_bytes());
        let comma = digits.iter().position(|&byte| byte == b',')?;
        digits[comma] = b'.';
        std::str::from_utf8(digits).ok()?.parse().ok()
    }

    /// 1 in automatic, 0 otherwise; `None` for a mode that cannot be told.
    fn mode(&self, cell: &[u8]) -> Option<f64> {
        if let Some(number) = self.number(cell) {
            return (number == 0.0 || number == 1.0).then_some(number);
        }
        let text = std::str::from_utf8(cell.trim_ascii()).ok()?;
        let is = |names: &[&str]| names.iter().any(|name| name.eq_ignore_ascii_case(text));
        if is(&AUTOMATIC) {
            Some(1.0)
        } else if is(&NOT_AUTOMATIC) {
            Some(0.0)
        } else {
            None
        }
    }

    /// The cell as seconds: a number as it stands, a date and time since the Unix epoch (UTC where no offset is given).
    pub fn time(&self, cell: &[u8]) -> Option<f64> {
        if let Some(seconds) = self.number(cell) {
            return Some(seconds);
        }
        let text = std::str::from_utf8(cell.trim_ascii()).ok()?;
        let stamp = match text.parse::<jiff::Timestamp>() {
            Ok(stamp) => stamp,
            Err(_) => {
                let civil: jiff::civil::DateTime = text.parse().ok()?;
                civil.to_zoned(jiff::tz::TimeZone::UTC).ok()?.timestamp()
            }
        };
        Some(stamp.as_second() as f64 + f64::from(stamp.subsec_nanosecond()) * 1e-9)
    }
}

/// True for a cell without a sample.
pub fn is_blank(cell: &[u8]) -> bool {
    cell.iter().all(u8::is_ascii_whitespace)
}

/// The cell for an error message: short, and text whatever the bytes.
pub fn shown(cell: &[u8]) -> String {
    const LONGEST: usize = 40;
    let cell = cell.trim_ascii();
    let text = String::from_utf8_lossy(&cell[..cell.len().min(4 * LONGEST)]);
    let mut shown: String = text.chars().take(LONGEST).collect();
    if shown.len() < text.len() || cell.len() > 4 * LONGEST {
        shown.push('…');
    }
    shown
}
