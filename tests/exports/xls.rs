//! The least that is a workbook of Excel 97 (`.xls`): records in a stream, and the stream in the sectors of a file.

/// A record: kind, and bytes.
pub fn record(kind: u16, data: &[u8]) -> Vec<u8> {
    [&kind.to_le_bytes()[..], &(data.len() as u16).to_le_bytes()[..], data].concat()
}

/// A record of a cell, by its row and column.
pub fn cell(kind: u16, row: u16, column: u16, value: &[u8]) -> Vec<u8> {
    let place = [row, column, 0].map(u16::to_le_bytes).concat();
    record(kind, &[&place[..], value].concat())
}

/// A number in a cell.
pub fn number(row: u16, column: u16, value: f64) -> Vec<u8> {
    cell(0x0203, row, column, &value.to_le_bytes())
}

/// A text that says it has so many characters.
pub fn told_text(row: u16, column: u16, characters: u16, text: &str) -> Vec<u8> {
    cell(0x0204, row, column, &[&characters.to_le_bytes()[..], &[0][..], text.as_bytes()].concat())
}

/// A text that cells share, in a cell.
pub fn shared_text(row: u16, column: u16, number: u32) -> Vec<u8> {
    cell(0x00fd, row, column, &number.to_le_bytes())
}

/// The list of the texts that cells share: what stands in its record, and in each of those that continue it.
pub fn texts(parts: &[&[u8]]) -> Vec<u8> {
    let first = record(0x00fc, &[&[3, 0, 0, 0, 3, 0, 0, 0][..], parts[0]].concat());
    let more = parts[1..].iter().flat_map(|part| record(0x003c, part));
    first.into_iter().chain(more).collect()
}

/// The place of a sheet, with a name of one letter.
pub fn place(at: u32, name: u8) -> Vec<u8> {
    record(0x0085, &[&at.to_le_bytes()[..], &[0, 0, 1, 0, name][..]].concat())
}

/// A stream with one sheet of these records. `before` makes records before it, told where it begins.
pub fn stream_of(before: &dyn Fn(u32) -> Vec<u8>, sheet: &[u8]) -> Vec<u8> {
    let begin = |kind: u16| record(0x0809, &[0x0600, kind].map(u16::to_le_bytes).concat());
    let end = record(0x000a, &[]);
    let at = (begin(5).len() + before(0).len() + place(0, b'S').len() + end.len()) as u32;
    let globals = [begin(5), before(at), place(at, b'S'), end.clone(), begin(0x10)].concat();
    [&globals[..], sheet, &end[..]].concat()
}

/// No sector, and the last one of a chain.
pub const NO_SECTOR: u32 = 0xffff_ffff;
pub const LAST: u32 = 0xffff_fffe;
const TABLE: u32 = 0xffff_fffd;
const SECTOR: usize = 512;

/// A file with this stream; `follows` is the sector behind that of the directory, which stands behind the tables.
pub fn compound_of(name: &str, stream: &[u8], follows: u32) -> Vec<u8> {
    let mut stream = stream.to_vec();
    // A shorter one would be kept elsewhere.
    stream.resize(stream.len().max(4096).next_multiple_of(SECTOR), 0);
    let sectors = (stream.len() / SECTOR) as u32;
    // Each table lists 128 sectors, the tables and the directory among them.
    let tables = (sectors + 1).div_ceil(127);
    let mut table = vec![TABLE; tables as usize];
    table.push(follows);
    table.extend((tables + 2..=tables + sectors).chain([LAST]));
    table.resize(tables as usize * SECTOR / 4, NO_SECTOR);
    let mut head = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1".to_vec();
    head.resize(SECTOR, 0);
    let mut put = |at: usize, bytes: &[u8]| head[at..at + bytes.len()].copy_from_slice(bytes);
    // Version 3, its order of bytes, sectors of 2^9 and 2^6 bytes; the tables, where the directory and the rest begin.
    put(26, &[3, 0, 0xfe, 0xff, 9, 0, 6, 0]);
    put(44, &[tables, tables].map(u32::to_le_bytes).concat());
    put(60, &[LAST, 0, LAST, 0].map(u32::to_le_bytes).concat());
    put(76, &[0xff; SECTOR - 76]);
    put(76, &(0..tables).flat_map(u32::to_le_bytes).collect::<Vec<u8>>());
    let entry = |name: &str, kind: u8, first: u32, len: u32| {
        let mut entry: Vec<u8> = name.encode_utf16().flat_map(u16::to_le_bytes).collect();
        entry.resize(128, 0);
        entry[64] = 2 * (name.len() as u8 + 1);
        entry[66] = kind;
        entry[116..124].copy_from_slice(&[first, len].map(u32::to_le_bytes).concat());
        entry
    };
    let mut directory = entry("Root Entry", 5, LAST, 0);
    directory.extend(entry(name, 2, tables + 1, stream.len() as u32));
    directory.resize(SECTOR, 0);
    let table: Vec<u8> = table.into_iter().flat_map(u32::to_le_bytes).collect();
    [head, table, directory, stream].concat()
}
