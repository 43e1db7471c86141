//! The tags of an XML document one after the other, in no more memory than the longest of them. They are divided as the library
//! that opens workbooks divides them, so that neither sees a tag that the other does not.

use std::io::{self, BufRead};

/// A tag.
#[derive(Debug, PartialEq, Eq)]
pub enum Tag<'t> {
    /// An element begins: its name, and its attributes as they are written.
    Begin(&'t [u8], &'t [u8]),
    /// An element ends: its name.
    End(&'t [u8]),
}

/// The tags of a document.
pub struct Tags<R> {
    from: R,
    /// Bytes that were read.
    pub at: u64,
    /// The tag that was read last, without its brackets.
    held: Vec<u8>,
    /// Whether its element is empty, so that its end comes next.
    is_empty: bool,
}

impl<R: BufRead> Tags<R> {
    pub fn new(from: R) -> Self {
        Self { from, at: 0, held: Vec::new(), is_empty: false }
    }

    /// The next one; an element without content, `<a/>`, begins and ends. `None` at the end of the document.
    ///
    /// # Errors
    /// What the reader said, and a DOCTYPE.
    pub fn tag(&mut self) -> io::Result<Option<Tag<'_>>> {
        if std::mem::take(&mut self.is_empty) {
            return Ok(Some(Tag::End(&self.held[..name_len(&self.held)])));
        }
        let ends = loop {
            self.at += self.from.skip_until(b'<')? as u64;
            if !self.markup()? {
                return Ok(None);
            }
            match self.held.first() {
                Some(b'!' | b'?') => {}
                first => break first == Some(&b'/'),
            }
        };
        self.held.pop();
        if ends {
            return Ok(Some(Tag::End(self.held[1..].trim_ascii_end())));
        }
        self.is_empty = self.held.last() == Some(&b'/');
        if self.is_empty {
            self.held.pop();
        }
        let (name, written) = self.held.split_at(name_len(&self.held));
        Ok(Some(Tag::Begin(name, written)))
    }

    /// Takes what began with `<`, to its closing bracket; `false` where the document ends before.
    fn markup(&mut self) -> io::Result<bool> {
        self.held.clear();
        let mut quote: Option<u8> = None;
        loop {
            let from = self.held.len();
            self.at += self.from.read_until(b'>', &mut self.held)? as u64;
            if !self.held[from..].ends_with(b">") {
                return Ok(false);
            }
            let is_whole = match self.held.as_slice() {
                [b'!', b'-', ..] => self.held.len() > 5 && self.held.ends_with(b"-->"),
                [b'!', b'[', ..] => self.held.ends_with(b"]]>"),
                [b'?', ..] => self.held.ends_with(b"?>"),
                [b'!', ..] => return Err(io::Error::other("it has a DOCTYPE, which no spreadsheet writes")),
                _ => {
                    // A bracket within quotes is one of a value.
                    for byte in &self.held[from..] {
                        quote = match quote {
                            None => Some(*byte).filter(|byte| [b'"', b'\''].contains(byte)),
                            Some(open) => Some(open).filter(|open| open != byte),
                        };
                    }
                    quote.is_none()
                }
            };
            if is_whole {
                return Ok(true);
            }
        }
    }
}

fn name_len(tag: &[u8]) -> usize {
    tag.iter().position(|byte| [b' ', b'\t', b'\r', b'\n'].contains(byte)).unwrap_or(tag.len())
}

/// A name without its prefix.
pub fn local(name: &[u8]) -> &[u8] {
    name.iter().position(|byte| *byte == b':').map_or(name, |at| &name[at + 1..])
}

/// Names and values of attributes, up to the first that is none: there the library gives the document up.
pub fn attributes(written: &[u8]) -> impl Iterator<Item = (&[u8], &[u8])> {
    let mut rest = written;
    std::iter::from_fn(move || {
        let (name, behind) = rest.split_at_checked(rest.iter().position(|byte| *byte == b'=')?)?;
        let (quote, value) = behind[1..].trim_ascii_start().split_first()?;
        if ![b'"', b'\''].contains(quote) {
            return None;
        }
        let end = value.iter().position(|byte| byte == quote).unwrap_or(value.len());
        rest = value.get(end + 1..).unwrap_or_default();
        Some((name.trim_ascii(), &value[..end]))
    })
}

/// The number of an attribute; 1 where it is not there.
///
/// Signs and entities are left out, so that none is read as less than it is.
pub fn number(written: &[u8], name: &str) -> u64 {
    let own = attributes(written).find(|(own, _)| *own == name.as_bytes());
    let digits = own.map(|(_, value)| value.iter().filter(|byte| byte.is_ascii_digit()));
    let add = |sum: u64, byte: &u8| sum.saturating_mul(10).saturating_add(u64::from(byte - b'0'));
    digits.map_or(1, |digits| digits.fold(0, add))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The tags in short: `<name attributes` and `>name`.
    fn all(text: &str) -> Vec<String> {
        let mut tags = Tags::new(text.as_bytes());
        let mut out = Vec::new();
        let shown = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        while let Some(tag) = tags.tag().expect("text") {
            out.push(match tag {
                Tag::Begin(name, written) => format!("<{}{}", shown(name), shown(written)),
                Tag::End(name) => format!(">{}", shown(name)),
            });
        }
        assert_eq!(tags.at, text.len() as u64, "all of it was read: {text}");
        out
    }

    #[test]
    fn tags_are_those_of_the_document() {
        assert_eq!(
            all("<?xml version='1.0'?><a><b c=\"1\"/>text</a >tail"),
            ["<a", "<b c=\"1\"", ">b", ">a"]
        );
        assert_eq!(all("<a b='>' c=\"'>\"\n><d\n/></a>"), ["<a b='>' c=\"'>\"\n", "<d\n", ">d", ">a"]);
        assert_eq!(all("<!-- <a> --><!----><![CDATA[<b>]]><?p <c>?><d/>"), ["<d", ">d"]);
        assert_eq!(all("<!--> <a/> --><b/>"), ["<b", ">b"], "a comment has two dashes at either end");
        for cut in ["", "text", "<", "<a", "<a b='>", "<!-- -", "<![CDATA[ ]]", "<?p >"] {
            assert!(all(cut).is_empty(), "{cut}");
        }
        assert!(Tags::new("<!DOCTYPE a><a/>".as_bytes()).tag().is_err());
    }

    #[test]
    fn many_brackets_in_one_value_are_looked_at_once() {
        // Looked at anew with each of them, it would take minutes.
        let text = format!("<a b=\"{}\"/>", ">".repeat(200_000));
        assert_eq!(all(&text).len(), 2);
    }

    #[test]
    fn attributes_are_read_in_either_quotes() {
        let all = |written: &str| -> Vec<String> {
            let shown = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
            attributes(written.as_bytes()).map(|(name, value)| shown(name) + "=" + &shown(value)).collect()
        };
        assert_eq!(all(" a=\"1\" b:c = '\"2'"), ["a=1", "b:c=\"2"]);
        assert_eq!(all(" a=\"1\" b=2 c=\"3\""), ["a=1"], "a value without quotes is the end");
        assert!(all(" ").is_empty() && all(" a").is_empty() && all(" a=").is_empty());
        assert_eq!((local(b"x:sst"), local(b"sst")), (&b"sst"[..], &b"sst"[..]));
        assert_eq!(number(b" n=\"16384\"", "n"), 16_384);
        assert_eq!(number(b" n=\"&#49;6384\"", "n"), 496_384, "never less than it means");
        assert_eq!(number(b" n=\"99999999999999999999\"", "n"), u64::MAX);
        assert_eq!((number(b" m=\"5\"", "n"), number(b" n=\"\"", "n")), (1, 0));
    }
}
