//! The texts that the cells of an `.xls` share. They go on from record to record, and a text may be cut anywhere: behind the cut,
//! a byte tells anew whether its characters take one byte or two. They are divided as the library divides them, so that a cell's
//! number means the same text to both.

/// Bytes of the head of the list: two counts, which the library does not believe.
const HEAD_LEN: usize = 8;
/// Flag of a text whose characters take two bytes.
const WIDE: u8 = 0x1;
/// Flag of a text with something behind it for the Far East.
const FAR_EAST: u8 = 0x4;
/// Flag of a text with changes of its font behind it.
const FONT_CHANGES: u8 = 0x8;
/// Bytes of a change of the font: where it begins, and the number of the font.
const FONT_CHANGE_LEN: usize = 4;

/// Bytes in UTF-8 of each text of a list, of its record and those that continue it, up to one that is cut: there the library refuses
/// the workbook.
pub fn texts(parts: &[&[u8]]) -> Vec<u32> {
    let Some((first, more)) = parts.split_first() else { return Vec::new() };
    let mut rest = Rest { data: first.get(HEAD_LEN..).unwrap_or_default(), more };
    let mut texts = Vec::new();
    while !rest.data.is_empty() || rest.goes_on() {
        let Some(bytes) = rest.text() else { break };
        texts.push(bytes);
    }
    texts
}

/// What is left of a list.
struct Rest<'r> {
    data: &'r [u8],
    more: &'r [&'r [u8]],
}

impl Rest<'_> {
    /// Takes the next record; `false` where there is none.
    fn goes_on(&mut self) -> bool {
        let more = self.more;
        let Some((next, more)) = more.split_first() else { return false };
        (self.data, self.more) = (*next, more);
        true
    }

    fn text(&mut self) -> Option<u32> {
        if self.data.is_empty() {
            return Some(0);
        }
        let (characters, flags) = (self.number(2)?, self.number(1)? as u8);
        let font_changes = if flags & FONT_CHANGES == 0 { 0 } else { self.number(2)? };
        let far_east = if flags & FAR_EAST == 0 { 0 } else { self.number(4)? };
        let bytes = self.characters(characters, flags & WIDE != 0)?;
        self.skip(FONT_CHANGE_LEN * font_changes)?;
        self.skip(far_east)?;
        Some(bytes)
    }

    /// A number of so many bytes, which are not cut.
    fn number(&mut self, len: usize) -> Option<usize> {
        let (own, rest) = self.data.split_at_checked(len)?;
        self.data = rest;
        Some(own.iter().rev().fold(0, |number, byte| (number << 8) | usize::from(*byte)))
    }

    /// Bytes that so many characters take.
    fn characters(&mut self, mut left: usize, mut is_wide: bool) -> Option<u32> {
        let mut bytes = 0;
        while left > 0 {
            let width = if is_wide { 2 } else { 1 };
            let taken = left.min(self.data.len() / width);
            let (own, rest) = self.data.split_at(taken * width);
            bytes += own.chunks_exact(width).map(utf_8).sum::<u32>();
            (self.data, left) = (rest, left - taken);
            if left > 0 {
                if !self.goes_on() {
                    return None;
                }
                is_wide = self.number(1)? as u8 & WIDE != 0;
            }
        }
        Some(bytes)
    }

    fn skip(&mut self, mut left: usize) -> Option<()> {
        while left > 0 {
            if self.data.is_empty() && !self.goes_on() {
                return None;
            }
            let taken = left.min(self.data.len());
            (self.data, left) = (&self.data[taken..], left - taken);
        }
        Some(())
    }
}

/// Bytes that a character of one byte or two takes; each half of a pair takes three, which is more than its share.
fn utf_8(character: &[u8]) -> u32 {
    match character {
        [low] | [low, 0] if *low < 0x80 => 1,
        [_] | [_, 0..=7] => 2,
        _ => 3,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A list of one record and those that continue it.
    fn of(parts: &[&[u8]]) -> Vec<u32> {
        let first = [&[0; HEAD_LEN][..], parts[0]].concat();
        let parts: Vec<&[u8]> = [first.as_slice()].into_iter().chain(parts[1..].iter().copied()).collect();
        texts(&parts)
    }

    #[test]
    fn texts_are_as_long_as_in_utf_8() {
        assert_eq!(of(&[b"\x02\0\0ab\0\0\0\x01\0\0\xe4"]), [2, 0, 2]);
        assert_eq!(of(&[b"\x04\0\x01a\0\xe4\0\xff\x07\0\x08\x01\0\0z"]), [1 + 2 + 2 + 3, 1]);
        assert_eq!(of(&[b""]), [0; 0]);
        assert_eq!(texts(&[]), [0; 0]);
        assert_eq!(texts(&[&[0; 3]]), [0; 0]);
    }

    #[test]
    fn a_text_goes_on_behind_a_cut_with_characters_of_another_width() {
        assert_eq!(of(&[b"\x05\0\0ab", b"\x01c\0d\0", b"\0e\x01\0\0z"]), [5, 1]);
        // A half of a character before the cut is none.
        assert_eq!(of(&[b"\x02\0\x01a\0b", b"\0b"]), [2]);
        assert_eq!(
            of(&[b"\x01\0\0a", b"", b"\x01\0\0z"]),
            [1, 0, 1],
            "a record of nothing is a text of none"
        );
        assert_eq!(of(&[b"\x03\0\0ab"]), [0; 0], "cut");
        assert_eq!(of(&[b"\x01\0\0a\x03\0\0ab", b""]), [1], "cut");
    }

    #[test]
    fn what_stands_behind_a_text_is_none() {
        assert_eq!(of(&[b"\x01\0\x08\x01\0a1234\x01\0\0z"]), [1, 1], "a change of the font");
        assert_eq!(of(&[b"\x01\0\x04\x05\0\0\0a12", b"345\x01\0\0z"]), [1, 1], "for the Far East");
        assert_eq!(of(&[b"\x01\0\x0c\x01\0\x02\0\0\0a12", b"3456\x01\0\0z"]), [1, 1], "both");
        assert_eq!(of(&[b"\x01\0\x04\xff\xff\xff\xffa", b"more"]), [0; 0], "longer than all there is");
    }
}
