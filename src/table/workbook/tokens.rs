//! What the library that opens workbooks makes of the tokens of formulas: it writes each formula as text. A short token may name
//! something long, or put many blanks before all that stands there, and tokens that are nested are taken by a function that calls
//! itself. Tokens (`Ptg…`) have their names in Microsoft's document MS-XLS.

use super::fields::u16_at;

/// Bytes of text that a byte of tokens becomes at most, but for the tokens that are counted by themselves.
const TOKEN_BYTE_FACTOR: u64 = 8;
/// Bytes of a number with all its digits: `5e-324` is written with 324 of them behind the point.
const NUMBER_TEXT_LEN: u64 = 360;
/// PtgMemFunc in its three classes: tokens that hold tokens.
const NESTING_TOKENS: [u8; 3] = [0x29, 0x49, 0x69];
/// Least bytes of a token that holds tokens: its kind, and how many bytes it holds.
const MIN_NESTING_LEN: usize = 3;

/// What is made of formulas.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Written {
    /// Bytes of their text.
    pub text: u64,
    /// Bytes that are shifted while it is put together, by what is inserted before them.
    pub shifted: u64,
}

impl Written {
    /// Both together.
    pub fn and(self, other: Self) -> Self {
        Self {
            text: self.text.saturating_add(other.text),
            shifted: self.shifted.saturating_add(other.shifted),
        }
    }
}

/// What is made of a formula; `longest_name` are the bytes of the longest name. Every byte is counted as if a token began with it,
/// so that nothing is counted low.
pub fn written(tokens: &[u8], longest_name: u64) -> Written {
    let (mut text, mut insertions) = (TOKEN_BYTE_FACTOR.saturating_mul(tokens.len() as u64), 0u64);
    for (at, token) in tokens.iter().enumerate() {
        let (more, inserted) = match token {
            // PtgAttr: blanks and line breaks are inserted one by one, anything else at once.
            0x19 => match tokens.get(at + 1..at + 4) {
                Some([0x40 | 0x41, _, blanks]) => (u64::from(*blanks), u64::from(*blanks)),
                _ => (0, 1),
            },
            // Operators, brackets, functions and tokens that hold others: a sign or a bracket is inserted.
            0x03..=0x15 | 0x21 | 0x22 | 0x29 | 0x41 | 0x42 | 0x49 | 0x61 | 0x62 | 0x69 => (0, 1),
            // PtgNum: a number.
            0x1f => (NUMBER_TEXT_LEN, 0),
            // PtgName, and PtgRef3d to PtgAreaErr3d: names of cells, and of sheets before a cell.
            0x23 | 0x43 | 0x63 | 0x3a..=0x3d | 0x5a..=0x5d | 0x7a..=0x7d => (longest_name, 0),
            _ => (0, 0),
        };
        (text, insertions) = (text.saturating_add(more), insertions.saturating_add(inserted));
    }
    Written { text, shifted: text.saturating_mul(insertions) }
}

/// How deep tokens may be nested at most: so many of them may hold others.
pub fn depth(tokens: &[u8]) -> usize {
    let holds = |at: usize| {
        let behind = tokens.len() - at - 1;
        let inside = u16_at(tokens, at + 1).map_or(0, usize::from);
        inside >= MIN_NESTING_LEN && inside + 2 <= behind
    };
    (0..tokens.len()).filter(|at| NESTING_TOKENS.contains(&tokens[*at]) && holds(*at)).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_short_token_becomes_is_counted() {
        // A cell, two cells added, and a sum of an area.
        let cell = [0x44, 1, 0, 0, 0xc0];
        assert_eq!(written(&cell, 1000), Written { text: 40, shifted: 0 });
        let sum = [&cell[..], &cell[..], &[0x03][..]].concat();
        assert_eq!(written(&sum, 1000), Written { text: 88, shifted: 88 });
        assert_eq!(
            written(&[0x19, 0x10, 0, 0], 1000),
            Written { text: 32, shifted: 64 },
            "SUM, counted twice"
        );
        assert_eq!(written(&[0x23, 1, 0, 0, 0], 1000).text, 1040);
        assert_eq!(written(&[0x1f; 1], 0).text, 368);
        assert_eq!(written(&[0x19, 0x40, 0, 255], 0), Written { text: 287, shifted: 287 * 255 });
        assert_eq!(written(&[0x23; 1 << 20], u64::MAX / 2), Written { text: u64::MAX, shifted: 0 });
        assert_eq!(written(&[], 1000), Written::default());
        let both = Written { text: 1, shifted: u64::MAX }.and(Written { text: 2, shifted: 3 });
        assert_eq!(both, Written { text: 3, shifted: u64::MAX });
    }

    #[test]
    fn only_tokens_that_hold_others_make_it_deep() {
        let nested = |inside: &[u8]| [&[0x29][..], &(inside.len() as u16).to_le_bytes()[..], inside].concat();
        let missing = [0x16];
        assert_eq!(depth(&missing), 0);
        assert_eq!(depth(&nested(&missing)), 0, "what holds one byte holds nothing that is nested");
        assert_eq!(depth(&nested(&nested(&nested(&missing)))), 2);
        // A text with the letters of such tokens, and the row 42.
        let text: Vec<u8> = "if it is I".encode_utf16().flat_map(u16::to_le_bytes).collect();
        assert_eq!(depth(&text), 0);
        assert_eq!(depth(&[0x44, 0x29, 0, 0, 0, 0, 0xc0]), 0);
        assert_eq!(depth(&[0x29]), 0);
    }
}
