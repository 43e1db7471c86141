//! Bytes as text: which encoding, and a reader that hands out UTF-8 in lines of bounded length.

use super::error::TableError;
use chardetng::{EncodingDetector, Iso2022JpDetection, Utf8Detection};
use encoding_rs::{CoderResult, Decoder, UTF_8, UTF_16BE, UTF_16LE, WINDOWS_1252};
use std::io::{self, Read};

/// Longest line (bytes); an unclosed quote must not swallow the file into memory.
pub const MAX_LINE: usize = 1 << 20;
/// Bytes decoded at a time.
const BUFFER: usize = 1 << 16;

/// How text is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Encoding {
    own: &'static encoding_rs::Encoding,
    /// Lines end in `\r` alone.
    old_mac: bool,
}

impl Encoding {
    /// Its name, where it is not the usual one.
    pub fn unusual(&self) -> Option<&'static str> {
        (self.own != UTF_8).then(|| self.own.name())
    }
}

/// The encoding of a file that begins so: by its byte order mark, else as told, else as guessed.
pub fn encoding(head: &[u8], told: Option<&'static encoding_rs::Encoding>) -> Result<Encoding, TableError> {
    if head.iter().all(u8::is_ascii_whitespace) {
        return Err(TableError::refused(
            "line 1: empty file; a header such as t,op,pv and one line per sample are needed",
        ));
    }
    if let Some(what) = unread(head).filter(|_| told.is_none()) {
        return Err(TableError::refused(format!("line 1: text in {what}; save it as UTF-8")));
    }
    let own = match encoding_rs::Encoding::for_bom(head).map(|(own, _)| own).or(told) {
        Some(own) => own,
        None => match zeros(head) {
            [0, 0] => guessed(head),
            // Text of western letters in UTF-16 has every other byte zero.
            [even, odd] if even == 0 && odd * 3 > head.len() => UTF_16LE,
            [even, odd] if odd == 0 && even * 3 > head.len() => UTF_16BE,
            _ => {
                return Err(TableError::refused(
                    "line 1: not text (it holds zero bytes); CSV, Excel, ODS and Parquet are read",
                ));
            }
        },
    };
    let (text, _) = own.decode_without_bom_handling(head);
    let old_mac = !text.contains('\n') && text.contains('\r');
    Ok(Encoding { own, old_mac })
}

/// Encodings that are not read, by how text looks in them.
fn unread(head: &[u8]) -> Option<&'static str> {
    let zeros = |place: usize| head.iter().skip(place).step_by(4).filter(|byte| **byte == 0).count();
    let most = head.len() / 4;
    let [a, b, c, d] = [0, 1, 2, 3].map(zeros).map(|count| count > 8 && count * 10 > most * 9);
    if head.starts_with(&[0xff, 0xfe, 0, 0]) || head.starts_with(&[0, 0, 0xfe, 0xff]) || b && c && (a || d) {
        return Some("UTF-32");
    }
    let share = |of: fn(u8) -> bool| head.iter().filter(|byte| of(**byte)).count();
    // Digits of mainframes lie where Latin codes have small letters with accents, and theirs are nowhere.
    let digits = share(|byte| (0xf0..=0xf9).contains(&byte));
    let ascii = share(|byte| byte.is_ascii_digit());
    (digits * 4 > head.len() && ascii * 20 < digits).then_some("EBCDIC")
}

/// Zero bytes at even and at odd places; one at the end of a cell is what some devices write.
fn zeros(head: &[u8]) -> [usize; 2] {
    let count = |first: usize| head.iter().skip(first).step_by(2).filter(|byte| **byte == 0).count();
    let [even, odd] = [count(0), count(1)];
    let few =
        (even + odd) * 20 < head.len() && head.iter().filter(|byte| **byte < 32).count() * 4 < head.len();
    if few { [0, 0] } else { [even, odd] }
}

/// UTF-8 where it is, else what an eight-bit code most likely is.
fn guessed(head: &[u8]) -> &'static encoding_rs::Encoding {
    // The head may end within a character.
    let valid = match std::str::from_utf8(head) {
        Ok(_) => true,
        Err(error) => error.error_len().is_none(),
    };
    if valid {
        return UTF_8;
    }
    let mut detector = EncodingDetector::new(Iso2022JpDetection::Deny);
    detector.feed(head, true);
    let own = detector.guess(None, Utf8Detection::Deny);
    // The codes of Latin letters cannot be told apart by a header, and a cubic metre is more frequent than a Polish l.
    const LATIN: [&str; 5] = ["windows-1250", "windows-1254", "windows-1257", "ISO-8859-2", "ISO-8859-4"];
    if own == UTF_8 || LATIN.contains(&own.name()) { WINDOWS_1252 } else { own }
}

/// Which runs of blanks divide cells, where no sign does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Blanks {
    /// Each: `0 50.1 51.2`.
    One,
    /// Of two or more: `2026-06-01 06:00:00   50.1   51.2`.
    Two,
}

impl Blanks {
    /// The sign that they become: a blank, or one that stands in no line.
    pub fn separator(self) -> u8 {
        match self {
            Blanks::One => b' ',
            Blanks::Two => 0x1e,
        }
    }

    /// Which of them a separator stands for.
    pub fn of(separator: u8) -> Option<Self> {
        [Blanks::One, Blanks::Two].into_iter().find(|own| own.separator() == separator)
    }
}

/// Makes one separator of each run of blanks that divides, and none at the ends of a line.
struct Runs {
    blanks: Blanks,
    pending: usize,
    line_begins: bool,
}

impl Runs {
    /// Works on `bytes[from..to]`, and puts what it makes from 0 on; `from` is at least 1, for a run that began before.
    fn apply(&mut self, bytes: &mut [u8], from: usize, to: usize) -> usize {
        let mut out = 0;
        for at in from..to {
            let byte = bytes[at];
            if byte == b' ' {
                self.pending += 1;
                continue;
            }
            if self.pending > 0 && !self.line_begins && byte != b'\n' {
                let divides = self.blanks == Blanks::One || self.pending > 1;
                bytes[out] = if divides { self.blanks.separator() } else { b' ' };
                out += 1;
            }
            self.pending = 0;
            self.line_begins = byte == b'\n';
            bytes[out] = byte;
            out += 1;
        }
        out
    }
}

/// Hands out UTF-8 without a byte order mark, with every line ended in one `\n`: `csv` counts lines right only then.
pub struct Text<R> {
    inner: R,
    decoder: Decoder,
    old_mac: bool,
    raw: Vec<u8>,
    /// Bytes of `raw` that are not decoded yet.
    left: std::ops::Range<usize>,
    ended: bool,
    /// Nothing is left to decode.
    finished: bool,
    last: u8,
    /// Bytes handed out since the caller began a line.
    since_line: usize,
    /// A line was too long.
    pub tripped: bool,
    runs: Option<Runs>,
}

impl<R: Read> Text<R> {
    pub fn new(inner: R, encoding: &Encoding, blanks: Option<Blanks>) -> Self {
        Self {
            runs: blanks.map(|blanks| Runs { blanks, pending: 0, line_begins: true }),
            inner,
            decoder: encoding.own.new_decoder_with_bom_removal(),
            old_mac: encoding.old_mac,
            raw: vec![0; BUFFER],
            left: 0..0,
            ended: false,
            finished: false,
            last: b'\n',
            since_line: 0,
            tripped: false,
        }
    }

    /// The caller begins a line.
    pub fn line_begins(&mut self) {
        self.since_line = 0;
    }
}

impl<R: Read> Read for Text<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.since_line > MAX_LINE {
            self.tripped = true;
            return Err(io::Error::other("line too long"));
        }
        if buffer.len() < 5 {
            return Err(io::Error::other("a buffer too small for a character"));
        }
        loop {
            if self.left.is_empty() && !self.ended {
                let n = self.inner.read(&mut self.raw)?;
                self.left = 0..n;
                self.ended = n == 0;
            }
            let mut written = 0;
            if !self.finished {
                let raw = &self.raw[self.left.clone()];
                // A run of blanks that ends here needs room for its separator.
                let from = usize::from(self.runs.is_some());
                let (result, read, out, _) =
                    self.decoder.decode_to_utf8(raw, &mut buffer[from..], self.ended);
                self.left.start += read;
                self.finished = self.ended && result == CoderResult::InputEmpty;
                written = out;
                if out > 0 {
                    written = self.written(buffer, from, from + out);
                }
            }
            if written == 0 {
                if !self.finished {
                    continue;
                }
                if self.last == b'\n' {
                    return Ok(0);
                }
                buffer[0] = b'\n';
                written = 1;
            }
            self.last = buffer[written - 1];
            self.since_line += written;
            return Ok(written);
        }
    }
}

impl<R> Text<R> {
    /// Puts the decoded bytes at the beginning, with lines ended alike and runs of blanks as one sign; returns how many.
    fn written(&mut self, buffer: &mut [u8], from: usize, to: usize) -> usize {
        for byte in &mut buffer[from..to] {
            if *byte == b'\r' {
                *byte = if self.old_mac { b'\n' } else { b' ' };
            }
        }
        match &mut self.runs {
            Some(runs) => runs.apply(buffer, from, to),
            None => to,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> String {
        let mut out = String::new();
        let encoding = encoding(bytes, None).expect("text");
        Text::new(bytes, &encoding, None).read_to_string(&mut out).expect("UTF-8");
        out
    }

    #[test]
    fn text_is_the_same_in_every_encoding() {
        let text = "t;op;Durchfluß [m³/h]\n0;1;2\n";
        let utf16 = |to: fn(u16) -> [u8; 2]| text.encode_utf16().flat_map(to).collect::<Vec<u8>>();
        let (little, big) = (utf16(u16::to_le_bytes), utf16(u16::to_be_bytes));
        let latin: Vec<u8> = text.chars().map(|c| u8::try_from(c).expect("Latin-1")).collect();
        for bytes in [
            text.as_bytes().to_vec(),
            [b"\xef\xbb\xbf", text.as_bytes()].concat(),
            [b"\xff\xfe".as_slice(), &little].concat(),
            [b"\xfe\xff".as_slice(), &big].concat(),
            little,
            big,
            latin,
            text.replace('\n', "\r").into_bytes(),
        ] {
            assert_eq!(read(&bytes), text);
        }
        assert_eq!(read(b"t,op\r\n0,1"), "t,op \n0,1\n");
    }

    #[test]
    fn runs_of_blanks_are_one_sign() {
        let text = "  t   op value  pv \r\n  0   50.1   51.2\n\n1  2    3";
        let of = |blanks: Blanks, step: usize| {
            let encoding = encoding(text.as_bytes(), None).expect("text");
            let mut reader = Text::new(text.as_bytes(), &encoding, Some(blanks));
            let (mut out, mut part) = (String::new(), vec![0; step]);
            while let Ok(n @ 1..) = reader.read(&mut part) {
                out += std::str::from_utf8(&part[..n]).expect("UTF-8");
            }
            out
        };
        for step in [5, 6, 7, 64] {
            assert_eq!(of(Blanks::One, step), "t op value pv\n0 50.1 51.2\n\n1 2 3\n");
            assert_eq!(
                of(Blanks::Two, step),
                "t\u{1e}op value\u{1e}pv\n0\u{1e}50.1\u{1e}51.2\n\n1\u{1e}2\u{1e}3\n"
            );
        }
    }

    #[test]
    fn what_is_no_text_is_refused() {
        assert!(encoding(b" \r\n", None).is_err());
        assert!(encoding(&[0x7f, b'E', b'L', b'F', 0, 0, 1, 0, 0, 0], None).is_err());
    }
}
