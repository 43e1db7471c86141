//! Records of `.xlsb`, for tests of the library and of its tables.

/// A record that says it has so many bytes.
pub fn told(kind: u16, len: usize, data: &[u8]) -> Vec<u8> {
    let mut out = if kind < 0x80 { vec![kind as u8] } else { vec![kind as u8 | 0x80, (kind >> 7) as u8] };
    let mut left = len;
    while left >= 0x80 {
        out.push(left as u8 | 0x80);
        left >>= 7;
    }
    out.push(left as u8);
    out.extend(data);
    out
}

/// A record: kind, and bytes.
pub fn record(kind: u16, data: &[u8]) -> Vec<u8> {
    told(kind, data.len(), data)
}

/// A text with its length before it.
pub fn wide(text: &str) -> Vec<u8> {
    let words = text.encode_utf16().flat_map(u16::to_le_bytes);
    (text.encode_utf16().count() as u32).to_le_bytes().into_iter().chain(words).collect()
}
