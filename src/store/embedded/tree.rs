//! Pages of the database as rows: those of a leaf, wherever it hangs, and those that the trees of the tables lead to. What a
//! tree leads to by good pages alone is in force, while a leaf by itself may be of before. See the SQLite file format,
//! sections 1.6 and 2.

use super::pages::Pages;
use super::write::PAGE_BYTES;
use rusqlite::types::Value;
use std::collections::HashMap;

/// Kinds of pages: a table by name is an index, with rows on all of its pages; one by number has them on its leaves.
const INNER_INDEX: u8 = 0x02;
const INNER_TABLE: u8 = 0x05;
const LEAF_INDEX: u8 = 0x0a;
const LEAF_TABLE: u8 = 0x0d;
/// Bytes before the first page's own head.
const OF_FILE: usize = 100;
/// Longest row that is put together (bytes): a blob of the store is far shorter.
const LONGEST: usize = 1 << 24;
/// Most columns of a row: no table has a quarter of them, while a head that is damaged may tell of millions.
const COLUMNS: usize = 100;
const USABLE: usize = PAGE_BYTES as usize;

/// A row as it was found.
pub(super) struct Row {
    /// Its number; 0 in a table by name.
    pub key: i64,
    pub values: Vec<Value>,
    /// All it lies on is what was written.
    pub good: bool,
    /// Something of it is, see [`Page::late`](super::pages::Page::late).
    pub late: bool,
}

/// Hands out the rows of a leaf of a table by number, one at a time: a page that is damaged may lead to any number of long ones.
/// There is none on any other page.
///
/// # Errors
/// That of `each`, which ends it.
pub(super) fn rows<E>(pages: &Pages, at: u32, mut each: impl FnMut(Row) -> Result<(), E>) -> Result<(), E> {
    let Some(own) = pages.get(at) else { return Ok(()) };
    let page = own.bytes.as_slice();
    let start = if at == 1 { OF_FILE } else { 0 };
    if page.get(start) != Some(&LEAF_TABLE) {
        return Ok(());
    }
    // A page has no room for more cells, whatever it says.
    let count = usize::from(short(page, start + 3)).min(USABLE / 2);
    for cell in (0..count).map(|n| usize::from(short(page, start + 8 + 2 * n))) {
        if let Some(row) = row(pages, page, cell, true) {
            each(Row { good: row.good && own.good, late: row.late || own.late, ..row })?;
        }
    }
    Ok(())
}

/// What the tree of a table leads to.
#[derive(Default)]
pub(super) struct Reached {
    /// Rows that are in force, with their numbers.
    pub rows: Vec<(i64, Vec<Value>)>,
    /// Those are all.
    pub whole: bool,
}

/// The trees of a database.
pub(super) struct Trees<'p> {
    pages: &'p Pages,
    /// First pages of the tables.
    roots: HashMap<String, u32>,
}

impl<'p> Trees<'p> {
    pub fn of(pages: &'p Pages) -> Self {
        let mut trees = Self { pages, roots: HashMap::new() };
        // Columns of the table that names all others: type, name, table, first page, SQL.
        let mut roots = HashMap::new();
        trees.walk(1, &mut |_, values: Vec<Value>| {
            if let [Value::Text(kind), Value::Text(name), _, Value::Integer(root), ..] = values.as_slice()
                && kind == "table"
            {
                roots.extend(u32::try_from(*root).ok().map(|root| (name.clone(), root)));
            }
        });
        trees.roots = roots;
        trees
    }

    /// A table.
    pub fn table(&self, name: &str) -> Reached {
        let mut rows = Vec::new();
        let whole = self.each(name, &mut |key, values| rows.push((key, values)));
        Reached { rows, whole }
    }

    /// A table, of its rows only the one with the highest number: what happened may be far more than has to be in memory.
    pub fn newest(&self, name: &str) -> Reached {
        let mut newest: Option<(i64, Vec<Value>)> = None;
        let whole = self.each(name, &mut |key, values| {
            if newest.as_ref().is_none_or(|(last, _)| *last <= key) {
                newest = Some((key, values));
            }
        });
        Reached { rows: newest.into_iter().collect(), whole }
    }

    /// Whether everything of a table is in force and can be read.
    pub fn is_whole(&self, name: &str) -> bool {
        self.each(name, &mut |_, _| ())
    }

    /// Hands out the rows of a table that are in force; whether those are all.
    fn each(&self, name: &str, each: &mut dyn FnMut(i64, Vec<Value>)) -> bool {
        self.roots.get(name).is_some_and(|root| self.walk(*root, each))
    }

    /// Hands out the rows that a page leads to; whether those are all.
    fn walk(&self, root: u32, each: &mut dyn FnMut(i64, Vec<Value>)) -> bool {
        let (mut next, mut whole, mut left) = (vec![root], true, self.pages.count());
        while let Some(number) = next.pop() {
            // No tree has more pages than there are: it is a circle.
            let Some(rest) = left.checked_sub(1) else { return false };
            left = rest;
            let page = self.pages.get(number);
            let start = if number == 1 { OF_FILE } else { 0 };
            whole &= page
                .filter(|page| page.good && !page.late)
                .is_some_and(|page| self.look(&page.bytes, start, &mut next, each));
        }
        whole
    }

    /// Hands out the rows of one page, and says which pages it leads to; whether all of that could be read.
    fn look(
        &self,
        page: &[u8],
        start: usize,
        next: &mut Vec<u32>,
        each: &mut dyn FnMut(i64, Vec<Value>),
    ) -> bool {
        let kind = page.get(start).copied().unwrap_or(0);
        let is_inner = matches!(kind, INNER_INDEX | INNER_TABLE);
        if !is_inner && !matches!(kind, LEAF_INDEX | LEAF_TABLE) {
            return false;
        }
        let (head, mut whole) = (start + if is_inner { 12 } else { 8 }, true);
        for n in 0..usize::from(short(page, start + 3)) {
            let mut cell = usize::from(short(page, head + 2 * n));
            if is_inner {
                next.push(number(page, cell).unwrap_or(0));
                cell += 4;
            }
            if kind == INNER_TABLE {
                continue;
            }
            match row(self.pages, page, cell, kind == LEAF_TABLE) {
                Some(Row { key, values, good: true, late: false }) => each(key, values),
                _ => whole = false,
            }
        }
        if is_inner {
            next.push(number(page, start + 8).unwrap_or(0));
        }
        whole
    }
}

fn short(page: &[u8], at: usize) -> u16 {
    page.get(at..at + 2).and_then(|two| two.try_into().ok()).map_or(0, u16::from_be_bytes)
}

fn number(page: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_be_bytes(page.get(at..at + 4)?.try_into().ok()?))
}

/// A row of a table by number, or of one by name.
fn row(pages: &Pages, page: &[u8], cell: usize, is_numbered: bool) -> Option<Row> {
    let mut at = cell;
    let length = usize::try_from(varint(page, &mut at)?).ok().filter(|length| *length <= LONGEST)?;
    let key = if is_numbered { varint(page, &mut at)? } else { 0 };
    // So much of it lies on the page itself at most.
    let most = if is_numbered { USABLE - 35 } else { (USABLE - 12) * 64 / 255 - 23 };
    let Payload { bytes, good, late } = payload(pages, page, at, length, most)?;
    values(&bytes).map(|values| Row { key, values, good, late })
}

/// A row's bytes.
struct Payload {
    bytes: Vec<u8>,
    good: bool,
    late: bool,
}

/// Some of a row's bytes lie beside others, the rest on pages of their own.
fn payload(pages: &Pages, page: &[u8], at: usize, length: usize, most: usize) -> Option<Payload> {
    if length <= most {
        let bytes = page.get(at..at + length)?.to_vec();
        return Some(Payload { bytes, good: true, late: false });
    }
    let least = (USABLE - 12) * 32 / 255 - 23;
    let fits = least + (length - least) % (USABLE - 4);
    let own = if fits <= most { fits } else { least };
    let mut bytes = page.get(at..at + own)?.to_vec();
    let (mut next, mut good, mut late) = (number(page, at + own)?, true, false);
    while bytes.len() < length {
        let over = pages.get(next)?;
        (good, late) = (good && over.good, late || over.late);
        let over = over.bytes.as_slice();
        let more = (length - bytes.len()).min(USABLE - 4);
        bytes.extend_from_slice(over.get(4..4 + more)?);
        next = number(over, 0)?;
    }
    Some(Payload { bytes, good, late })
}

fn varint(bytes: &[u8], at: &mut usize) -> Option<i64> {
    let mut value: u64 = 0;
    for n in 0..9 {
        let byte = *bytes.get(*at)?;
        *at += 1;
        if n == 8 {
            return Some((value << 8 | u64::from(byte)) as i64);
        }
        value = value << 7 | u64::from(byte & 0x7f);
        if byte < 0x80 {
            break;
        }
    }
    Some(value as i64)
}

/// A record's columns.
fn values(record: &[u8]) -> Option<Vec<Value>> {
    let mut at = 0;
    let head = usize::try_from(varint(record, &mut at)?).ok()?;
    let mut body = head;
    let mut values = Vec::new();
    while at < head {
        if values.len() == COLUMNS {
            return None;
        }
        let kind = varint(record, &mut at)?;
        let length = match kind {
            0 | 8 | 9 => 0,
            1..=4 => kind as usize,
            5 => 6,
            6 | 7 => 8,
            12.. => usize::try_from((kind - 12) / 2).ok()?,
            _ => return None,
        };
        let bytes = record.get(body..body.checked_add(length)?)?;
        body += length;
        let whole = || {
            let sign = if bytes.first().is_some_and(|first| *first >= 0x80) { -1 } else { 0 };
            bytes.iter().fold(sign, |value: i64, byte| value << 8 | i64::from(*byte))
        };
        values.push(match kind {
            0 => Value::Null,
            1..=6 => Value::Integer(whole()),
            7 => Value::Real(f64::from_bits(whole() as u64)),
            8 | 9 => Value::Integer(kind - 8),
            _ if kind % 2 == 0 => Value::Blob(bytes.to_vec()),
            _ => Value::Text(String::from_utf8(bytes.to_vec()).ok()?),
        });
    }
    (body == record.len()).then_some(values)
}
