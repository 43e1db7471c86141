//! Workbooks are archives of files: the least that is one, its files as they are or packed.

/// A file of an archive.
pub struct Part<'p> {
    /// Its name.
    pub name: &'p str,
    /// How it is packed: 0 where it stands there as it is, 8 for deflate.
    pub method: u16,
    /// Its bytes as they stand there.
    pub bytes: &'p [u8],
    /// How many bytes it says it unpacks to, and their check sum.
    pub unpacked: (u32, u32),
}

/// A ZIP archive of files that are not compressed.
pub fn archive(files: &[(&str, &str)]) -> Vec<u8> {
    let stored = files.iter().map(|(name, content)| {
        let bytes = content.as_bytes();
        Part { name, method: 0, bytes, unpacked: (bytes.len() as u32, crc32fast::hash(bytes)) }
    });
    of_parts(&stored.collect::<Vec<_>>())
}

/// A ZIP archive of files as they are given.
pub fn of_parts(parts: &[Part<'_>]) -> Vec<u8> {
    let (mut out, mut directory) = (Vec::new(), Vec::new());
    for part in parts {
        let at = out.len() as u32;
        let mut common = Vec::new();
        // Version, flags, method, time and date of 1980.
        common.extend([20, 0, 0, 0]);
        common.extend(part.method.to_le_bytes());
        common.extend([0, 0, 0x21, 0]);
        common.extend(part.unpacked.1.to_le_bytes());
        common.extend((part.bytes.len() as u32).to_le_bytes());
        common.extend(part.unpacked.0.to_le_bytes());
        common.extend((part.name.len() as u16).to_le_bytes());
        common.extend([0, 0]);
        out.extend(b"PK\x03\x04");
        out.extend(&common);
        out.extend(part.name.as_bytes());
        out.extend(part.bytes);
        directory.extend(b"PK\x01\x02\x14\x00");
        directory.extend(&common);
        // Comment, disk, attributes.
        directory.extend([0; 10]);
        directory.extend(at.to_le_bytes());
        directory.extend(part.name.as_bytes());
    }
    let (at, size, count) = (out.len() as u32, directory.len() as u32, parts.len() as u16);
    out.extend(&directory);
    out.extend(b"PK\x05\x06\0\0\0\0");
    out.extend(count.to_le_bytes());
    out.extend(count.to_le_bytes());
    out.extend(size.to_le_bytes());
    out.extend(at.to_le_bytes());
    out.extend([0, 0]);
    out
}
