//! Cells that no sign divides, but blanks: each of them, runs of two or more, or those below a ruler of dashes.
//!
//! ```text
//! SampleTime              OP     PV
//! ----------------------- ------ ------
//! 2026-06-01 06:00:00.000 51.812 51.227
//! ```

use super::layout::PREAMBLE;

/// Which blanks divide cells, where no sign does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Blanks {
    /// Each: `0 50.1 51.2`.
    One,
    /// Of two or more: `2026-06-01 06:00:00   50.1   51.2`.
    Two,
    /// Those below a gap of a ruler.
    Ruled,
}

impl Blanks {
    /// The sign that they become: a blank, or one that stands in no line.
    pub fn separator(self) -> u8 {
        match self {
            Blanks::One => b' ',
            Blanks::Two => 0x1e,
            Blanks::Ruled => 0x1d,
        }
    }

    /// Which of them a separator stands for.
    pub fn of(separator: u8) -> Option<Self> {
        [Blanks::One, Blanks::Two, Blanks::Ruled].into_iter().find(|own| own.separator() == separator)
    }
}

/// Stands in a cell that is wider than its column.
pub const TOO_WIDE: char = '\u{1c}';
/// Of so many lines one may have something below a gap of the ruler: a footer.
const CROSSING: usize = 20;

/// Characters of a line that divide its cells: the gaps of a ruler of dashes. There are none without a ruler, and none where tabs
/// move what stands below it.
pub fn ruled(text: &str) -> Vec<usize> {
    if text.contains('\t') {
        return Vec::new();
    }
    let text = text.trim_start_matches('\u{feff}');
    let lines: Vec<&str> = text.lines().map(str::trim_end).filter(|line| !line.is_empty()).collect();
    let rulers = lines.iter().enumerate().take(PREAMBLE).skip(1).filter(|(_, line)| is_ruler(line));
    let gaps = rulers.map(|(at, ruler)| (at, gaps(ruler))).find(|(at, gaps)| {
        // The header, and what stands below.
        let others = lines[at - 1..].iter().filter(|line| !is_ruler(line));
        let (crossing, all) =
            others.fold((0, 0), |(n, all), line| (n + usize::from(crosses(line, gaps)), all + 1));
        !crosses(lines[at - 1], gaps) && crossing * CROSSING <= all.max(CROSSING)
    });
    gaps.map_or(Vec::new(), |own| own.1)
}

/// Two or more runs of dashes.
fn is_ruler(line: &str) -> bool {
    line.bytes().all(|byte| matches!(byte, b'-' | b' ')) && line.contains("- ") && line.ends_with('-')
}

fn gaps(ruler: &str) -> Vec<usize> {
    let ruler = ruler.as_bytes();
    (1..ruler.len()).filter(|at| ruler[*at] == b' ' && ruler[at - 1] == b'-').collect()
}

/// Whether a line has something below a gap.
fn crosses(line: &str, gaps: &[usize]) -> bool {
    let mut gaps = gaps.iter().peekable();
    line.chars().enumerate().any(|(at, own)| gaps.next_if_eq(&&at).is_some() && own != ' ')
}

/// Makes one separator of each run of blanks that divides, and none at the ends of a line.
pub struct Runs {
    blanks: Blanks,
    /// Blanks that are not put out yet.
    pending: usize,
    cell_begins: bool,
    /// See [`ruled`].
    ruled: Vec<usize>,
    /// Character of the line, how many of `ruled` lie before it, and whether something stood below one.
    at: usize,
    passed: usize,
    crossed: bool,
}

impl Runs {
    pub fn new(blanks: Blanks, ruled: &[usize]) -> Self {
        let ruled = if blanks == Blanks::Ruled { ruled.to_vec() } else { Vec::new() };
        Self { blanks, pending: 0, cell_begins: true, ruled, at: 0, passed: 0, crossed: false }
    }

    /// Works on `bytes[from..to]`, and puts what it makes from 0 on; `from` is at least 1, for a run that began before.
    pub fn apply(&mut self, bytes: &mut [u8], from: usize, to: usize) -> usize {
        let mut out = 0;
        for at in from..to {
            let byte = bytes[at];
            let below = self.divides();
            let divides = byte == b' ' && below;
            self.crossed |= below && !divides && byte != b'\n';
            self.count(byte);
            if byte == b' ' && std::mem::take(&mut self.crossed) {
                // In place of a blank, so that there is room for it.
                bytes[out] = TOO_WIDE as u8;
                out += 1;
                self.cell_begins = false;
                continue;
            }
            if divides {
                self.cell_begins = true;
                self.pending = 0;
                bytes[out] = self.blanks.separator();
                out += 1;
                continue;
            }
            if byte == b' ' {
                self.pending += 1;
                continue;
            }
            if self.pending > 0 && !self.cell_begins && byte != b'\n' {
                let divides = match self.blanks {
                    Blanks::One => true,
                    Blanks::Two => self.pending > 1,
                    Blanks::Ruled => false,
                };
                bytes[out] = if divides { self.blanks.separator() } else { b' ' };
                out += 1;
            }
            self.pending = 0;
            self.cell_begins = byte == b'\n';
            bytes[out] = byte;
            out += 1;
        }
        out
    }

    /// Whether the next character stands below a gap.
    fn divides(&self) -> bool {
        self.ruled.get(self.passed) == Some(&self.at)
    }

    /// Goes on by this byte: bytes after the first of a character are none of their own.
    fn count(&mut self, byte: u8) {
        if byte == b'\n' {
            (self.at, self.passed, self.crossed) = (0, 0, false);
        } else if byte & 0xc0 != 0x80 {
            self.passed += usize::from(self.divides());
            self.at += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::text::{Text, encoding};
    use super::*;
    use std::io::Read;

    fn read(text: &str, blanks: Blanks, step: usize) -> String {
        let encoding = encoding(text.as_bytes(), None).expect("text");
        let mut reader = Text::new(text.as_bytes(), &encoding, Some(blanks));
        let (mut out, mut part) = (String::new(), vec![0; step]);
        while let Ok(n @ 1..) = reader.read(&mut part) {
            out += std::str::from_utf8(&part[..n]).expect("UTF-8");
        }
        out
    }

    #[test]
    fn runs_of_blanks_are_one_sign() {
        let text = "  t   op value  pv \r\n  0   50.1   51.2\n\n1  2    3";
        for step in [5, 6, 7, 64] {
            assert_eq!(read(text, Blanks::One, step), "t op value pv\n0 50.1 51.2\n\n1 2 3\n");
            assert_eq!(
                read(text, Blanks::Two, step),
                "t\u{1e}op value\u{1e}pv\n0\u{1e}50.1\u{1e}51.2\n\n1\u{1e}2\u{1e}3\n"
            );
        }
    }

    #[test]
    fn a_ruler_says_where_cells_begin() {
        let mut text = String::from(
            "\u{feff}Zeit       Öl PV [m³]  n\n---------- -- -------- -\n06:00 x     5    51.2  3\r\n06:01 y    16\n",
        );
        assert_eq!(ruled(&text), [10, 13, 22]);
        text += "wider than its 7\n";
        for step in [5, 6, 7, 64] {
            let lines = read(&text, Blanks::Ruled, step).replace('\u{1d}', "|");
            let own: Vec<&str> = lines.lines().collect();
            assert_eq!(own[0], "Zeit|Öl|PV [m³]|n");
            assert_eq!(own[2..], ["06:00 x|5|51.2|3", "06:01 y|16", "wider than|its\u{1c}7"]);
        }
    }

    #[test]
    fn no_ruler_is_taken_from_lines_that_go_on_below_its_gaps() {
        let of_names = "Time                OP     PV\n----                --     --\n";
        let none = [
            "t op\n0 1\n".to_string(),
            "-- --\n1 2\n".into(),
            "t\top\n-- --\n1\t2\n".into(),
            "t\n---\n0\n".into(),
            "t op pv\n- - -\n0 50.1 51.2\n".into(),
            of_names.to_string() + &"2026-06-01T06:00:00 51.812 51.227\n".repeat(9),
        ];
        none.iter().for_each(|text| assert!(ruled(text).is_empty(), "{text}"));
        let titled = "A title of it\n-- -- -- --\nt   op\n--- --\n0   50\n1   51\n";
        assert_eq!(ruled(titled), [3], "the first is a decoration");
    }
}
