//! The tags of an XML document one after the other, in no more memory than the longest of them. They are divided as the library
//! that opens workbooks divides them, so that neither sees a tag that the other does not.

use super::limits::{ENTRY_SIZE, GROWTH_FACTOR, STRING_SIZE, allocation_size};
use std::io::{self, BufRead, Read};

/// Most bytes of a tag: even the longest text that Excel takes has fewer.
const LONGEST_TAG: usize = 1 << 20;
/// Most bytes of an element's name: those of spreadsheets have some dozens.
const LONGEST_NAME: usize = 1 << 8;
/// Most levels of elements within elements: spreadsheets have a dozen.
const DEEPEST: usize = 1 << 8;
/// Elements of which the library keeps a list, without their prefixes.
const LISTED: [&[u8]; 8] =
    [b"Relationship", b"border", b"fill", b"font", b"numFmt", b"sheet", b"style", b"table"];
/// Bytes that it takes for each byte of the tag of one of these: a value may be kept twice, in texts with twice the room that they
/// need.
const LISTED_TAG_FACTOR: u64 = 4;
/// Elements that name cells: of each the library keeps only two texts, the name and its formula.
const NAMES: [&[u8]; 3] = [b"definedName", b"named-expression", b"named-range"];
/// Bytes that it takes for the two texts of a name without their characters, in a list that grows.
const NAME_SIZE: u64 = GROWTH_FACTOR * 2 * STRING_SIZE;
/// Bytes that it takes for each byte of the tag of a name: either text may have twice the room that it needs.
const NAME_TAG_FACTOR: u64 = 2;
/// Elements whose content the library reads into one buffer, without their prefixes.
const GATHERED: [&[u8]; 6] = [b"annotation", b"definedName", b"is", b"si", b"t", b"v"];

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
    /// Bytes that the library takes for the elements of which it keeps lists.
    pub listed: u64,
    /// Most bytes that the library reads into one buffer: a tag, a text between tags, or the content of an element.
    pub longest: u64,
    /// The tag that was read last, without its brackets.
    held: Vec<u8>,
    /// Whether its element is empty, so that its end comes next.
    is_empty: bool,
    /// Elements that have begun and not ended.
    depth: usize,
    /// The element that is being read into one buffer, and where its content begins.
    gathered: Option<(&'static [u8], u64)>,
}

impl<R: BufRead> Tags<R> {
    pub fn new(from: R) -> Self {
        Self {
            from,
            at: 0,
            listed: 0,
            longest: 0,
            held: Vec::new(),
            is_empty: false,
            depth: 0,
            gathered: None,
        }
    }

    /// The next one; an element without content, `<a/>`, begins and ends. `None` at the end of the document.
    ///
    /// # Errors
    /// What the reader said, a DOCTYPE with declarations in it, and tags that are longer or deeper than those of any spreadsheet.
    pub fn tag(&mut self) -> io::Result<Option<Tag<'_>>> {
        if std::mem::take(&mut self.is_empty) {
            let len = name_len(&self.held);
            self.ends(0, len);
            return Ok(Some(Tag::End(&self.held[..len])));
        }
        let ends = loop {
            let text = self.from.skip_until(b'<')? as u64;
            self.at += text;
            let is_whole = self.markup()?;
            let gathered = self.gathered.map_or(0, |(_, from)| self.at - from);
            self.longest = self.longest.max(text).max(self.held.len() as u64).max(gathered);
            if !is_whole {
                return Ok(None);
            }
            match self.held.first() {
                Some(b'!' | b'?') => {}
                first => break first == Some(&b'/'),
            }
        };
        self.held.pop();
        if ends {
            let len = self.held.trim_ascii_end().len();
            self.ends(1, len);
            return Ok(Some(Tag::End(&self.held[1..len])));
        }
        self.is_empty = self.held.last() == Some(&b'/');
        if self.is_empty {
            self.held.pop();
        }
        let len = name_len(&self.held);
        self.begins(len)?;
        let (name, written) = self.held.split_at(len);
        Ok(Some(Tag::Begin(name, written)))
    }

    /// Counts an element that begins; its name is the first `len` bytes of the tag.
    fn begins(&mut self, len: usize) -> io::Result<()> {
        self.depth += 1;
        if self.depth > DEEPEST || len > LONGEST_NAME {
            return Err(io::Error::other(
                "it has tags that are nested deeper, or named longer, than any spreadsheet writes them",
            ));
        }
        let name = local(&self.held[..len]);
        let own = allocation_size(self.held.len() as u64);
        if LISTED.contains(&name) {
            self.listed = self.listed.saturating_add(ENTRY_SIZE + LISTED_TAG_FACTOR * own);
        } else if NAMES.contains(&name) {
            self.listed = self.listed.saturating_add(NAME_SIZE + NAME_TAG_FACTOR * own);
        }
        if self.gathered.is_none() {
            let own = GATHERED.into_iter().find(|own| *own == name);
            self.gathered = own.map(|own| (own, self.at));
        }
        Ok(())
    }

    /// Counts an element that ends; its name is at `from..to` in the tag.
    fn ends(&mut self, from: usize, to: usize) {
        self.depth = self.depth.saturating_sub(1);
        let name = local(&self.held[from..to]);
        self.gathered = self.gathered.filter(|(own, _)| *own != name);
    }

    /// Takes what began with `<`, to its closing bracket; `false` where the document ends before.
    fn markup(&mut self) -> io::Result<bool> {
        self.held.clear();
        let mut quote: Option<u8> = None;
        loop {
            let from = self.held.len();
            let room = LONGEST_TAG.saturating_sub(from) as u64;
            self.at += self.from.by_ref().take(room).read_until(b'>', &mut self.held)? as u64;
            if !self.held[from..].ends_with(b">") {
                if self.held.len() < LONGEST_TAG {
                    return Ok(false);
                }
                return Err(io::Error::other(format!("it has a tag of more than {LONGEST_TAG} bytes")));
            }
            let is_whole = match self.held.as_slice() {
                [b'!', b'-', ..] => self.held.len() > 5 && self.held.ends_with(b"-->"),
                [b'!', b'[', ..] => self.held.ends_with(b"]]>"),
                [b'?', ..] => self.held.ends_with(b"?>"),
                held => {
                    // A bracket within quotes is one of a value.
                    for byte in &held[from..] {
                        quote = match quote {
                            None if *byte == b'[' && held[0] == b'!' => {
                                return Err(io::Error::other(
                                    "it has a DOCTYPE with declarations in it, which no spreadsheet writes",
                                ));
                            }
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
        for doctype in ["<!DOCTYPE a>", "<!DOCTYPE a PUBLIC \"-//[b]//>\" '<c>'>"] {
            assert_eq!(all(&format!("{doctype}<a/>")), ["<a", ">a"], "{doctype}");
        }
        assert!(Tags::new("<!DOCTYPE a [<!ENTITY b 'c'>]><a/>".as_bytes()).tag().is_err());
    }

    /// The tags of a text that was read to its end, or what is wrong with it.
    fn counted(text: &str) -> Result<Tags<&[u8]>, String> {
        let mut tags = Tags::new(text.as_bytes());
        while tags.tag().map_err(|error| error.to_string())?.is_some() {}
        Ok(tags)
    }

    #[test]
    fn what_the_library_keeps_lists_of_is_counted() {
        let listed = |text: &str| counted(text).expect("text").listed;
        assert_eq!(listed("<a><sheets/></a>"), 0);
        let one = listed("<sheet name=\"a\"/>");
        assert_eq!(one, ENTRY_SIZE + LISTED_TAG_FACTOR * 16);
        assert_eq!(listed("<a><x:sheet name=\"a\"></x:sheet><font/></a>"), 2 * one);
        assert!(listed(&format!("<sheet name=\"{}\"/>", "x".repeat(1000))) > 1000 * LISTED_TAG_FACTOR);
        // Two headers of 24 bytes in a list that grows, and twice its own 32 bytes.
        assert_eq!(listed("<x:definedName name=\"abcde\">S!$A$1</x:definedName>"), 3 * 48 + 2 * 32);
    }

    #[test]
    fn what_the_library_takes_into_one_buffer_is_counted() {
        let longest = |text: &str| counted(text).expect("text").longest;
        assert_eq!(longest("<a/>"), 3);
        assert_eq!(longest(&format!("<a>{}</a>", "x".repeat(100))), 101, "a text and a bracket");
        assert_eq!(longest(&format!("<a b=\"{}\"/>", "x".repeat(100))), 108, "a tag");
        let many = "<b>12345</b>".repeat(100);
        assert!(longest(&format!("<a>{many}</a>")) < 10);
        for name in ["si", "x:is", "t", "office:annotation"] {
            assert!(longest(&format!("<a><{name}>{many}</{name}><si/></a>")) > 1200, "{name}");
        }
        let apart = format!("<t>{}</t>", "<b>12345</b>".repeat(2)).repeat(50);
        assert!(longest(&format!("<a>{apart}</a>")) < 50, "each is one buffer");
    }

    #[test]
    fn tags_that_no_spreadsheet_has_are_refused() {
        let said = |text: &str| counted(text).err().unwrap_or_default();
        assert_eq!(said(&("<a>".repeat(DEEPEST) + &"</a>".repeat(DEEPEST)).repeat(2)), "");
        assert!(said(&"<a>".repeat(DEEPEST + 1)).contains("nested deeper"));
        assert_eq!(said(&format!("<{}/>", "a".repeat(LONGEST_NAME))), "");
        assert!(said(&format!("<{}/>", "a".repeat(LONGEST_NAME + 1))).contains("named longer"));
        assert!(said(&format!("<a b='{}'/>", "x".repeat(LONGEST_TAG))).contains("a tag of more than"));
        assert!(said(&format!("<!--{}-->", "x".repeat(LONGEST_TAG))).contains("a tag of more than"));
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
