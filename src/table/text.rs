//! Bytes as text: which encoding, and a reader that hands out UTF-8 in lines of bounded length.

use super::blanks::{Blanks, Runs, ruled};
use super::error::TableError;
use chardetng::{EncodingDetector, Iso2022JpDetection, Utf8Detection};
use encoding_rs::{CoderResult, Decoder, UTF_8, UTF_16BE, UTF_16LE, WINDOWS_1252};
use std::io::{self, Read};

/// Longest line (bytes); an unclosed quote must not swallow the file into memory.
pub const MAX_LINE: usize = 1 << 20;
/// Bytes decoded at a time.
const BUFFER: usize = 1 << 16;

/// How text is written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Encoding {
    own: &'static encoding_rs::Encoding,
    /// Lines end in `\r` alone.
    old_mac: bool,
    /// Characters of a line that divide its cells, by a ruler of dashes below the header; none without one.
    ruled: Vec<usize>,
}

impl Encoding {
    /// Its name, where it is not the usual one.
    pub fn unusual(&self) -> Option<&'static str> {
        (self.own != UTF_8).then(|| self.own.name())
    }

    /// Whether a ruler of dashes says where cells begin.
    pub fn is_ruled(&self) -> bool {
        !self.ruled.is_empty()
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
    Ok(Encoding { own, old_mac, ruled: ruled(&text) })
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
            runs: blanks.map(|blanks| Runs::new(blanks, &encoding.ruled)),
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
    fn what_is_no_text_is_refused() {
        assert!(encoding(b" \r\n", None).is_err());
        assert!(encoding(&[0x7f, b'E', b'L', b'F', 0, 0, 1, 0, 0, 0], None).is_err());
    }
}
