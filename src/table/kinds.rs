//! Kinds of files by their first bytes: those that are read, and those that are refused by name.

use super::error::TableError;

/// How files begin that are read.
pub const PARQUET: &[u8] = b"PAR1";
pub const ZIP: &[u8] = b"PK\x03\x04";
pub const OLE: &[u8] = &[0xd0, 0xcf, 0x11, 0xe0, 0xa1, 0xb1, 0x1a, 0xe1];
pub const GZIP: &[u8] = &[0x1f, 0x8b];

/// How files begin that are not, what they are, and what to do.
const OTHERS: [(&[u8], &str, &str); 12] = [
    (b"BZh", "compressed with bzip2", UNPACK),
    (b"\xfd7zXZ", "compressed with xz", UNPACK),
    (&[0x28, 0xb5, 0x2f, 0xfd], "compressed with zstd", UNPACK),
    (b"7z\xbc\xaf", "a 7-Zip archive", UNPACK),
    (b"Rar!", "a RAR archive", UNPACK),
    (b"SQLite format 3", "a SQLite database", EXPORT),
    (b"MATLAB 5.0", "a MATLAB file", EXPORT),
    (b"\x89HDF", "an HDF5 file", EXPORT),
    (b"ARROW1", "an Arrow file", EXPORT),
    (b"%PDF", "a PDF", EXPORT),
    (b"\x93NUMPY", "a NumPy file", EXPORT),
    (b"{\\rtf", "a text with formats (RTF)", EXPORT),
];
const UNPACK: &str = "unpack it first";
const EXPORT: &str = "export its table as CSV or Parquet";

/// Refuses what is neither a table of text nor a workbook, by its name.
///
/// # Errors
/// What it is, and what to do.
pub fn refuse(head: &[u8]) -> Result<(), TableError> {
    let refused = |what: &str, then: &str| Err(TableError::refused(format!("{what}, no table: {then}")));
    if let Some((_, what, then)) = OTHERS.iter().find(|(begin, ..)| head.starts_with(begin)) {
        return refused(what, then);
    }
    let text = String::from_utf8_lossy(&head[..head.len().min(4096)]);
    let text = text.trim_start_matches('\u{feff}').trim_start();
    let begins = |words: &[&str]| {
        words.iter().any(|word| text.get(..word.len()).is_some_and(|t| t.eq_ignore_ascii_case(word)))
    };
    if begins(&["<!doctype html", "<html", "<table", "<meta", "<head"]) {
        return refused(
            "line 1: HTML, as web pages and some \"xls\" files are",
            "open it in a spreadsheet and save it as CSV or .xlsx",
        );
    }
    let tags = ["</", "/>", "<!"].iter().any(|tag| text.contains(tag));
    if text.starts_with("<?xml") || text.starts_with('<') && tags {
        let office = text.contains("office:spreadsheet");
        let what = if office { "line 1: an XML spreadsheet of Excel 2003" } else { "line 1: XML" };
        return refused(what, "save its table as CSV or .xlsx");
    }
    let mut signs = text.chars().filter(|c| !c.is_whitespace());
    let json = match (signs.next(), signs.next()) {
        (Some('{'), Some('"')) => text.contains("\":"),
        (Some('['), Some('{' | '[')) => true,
        _ => false,
    };
    if json {
        return refused("line 1: JSON", EXPORT);
    }
    if is_line_protocol(text) {
        return refused(
            "line 1: line protocol of InfluxDB",
            "export it as CSV (`influx query --raw`, or the explorer's CSV)",
        );
    }
    Ok(())
}

/// `measurement,tag=a field=1.5 1465839830100400200`.
fn is_line_protocol(text: &str) -> bool {
    let line = text.lines().find(|line| !line.starts_with('#')).unwrap_or_default();
    let parts: Vec<&str> = line.split(' ').collect();
    let [series, fields, time] = parts.as_slice() else { return false };
    let ns = time.trim();
    let pair =
        |part: &str| part.split_once('=').is_some_and(|(key, value)| !key.is_empty() && !value.is_empty());
    !series.is_empty()
        && series.split(',').skip(1).all(pair)
        && fields.split(',').all(pair)
        && ns.len() >= 10
        && ns.bytes().all(|byte| byte.is_ascii_digit())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_are_named_and_text_is_none_of_them() {
        let said =
            |head: &str| refuse(head.as_bytes()).err().map(|error| error.to_string()).unwrap_or_default();
        for (head, what) in [
            ("<!DOCTYPE html><table>", "HTML"),
            (
                "<?xml version=\"1.0\"?><Workbook xmlns=\"urn:schemas-microsoft-com:office:spreadsheet\">",
                "Excel 2003",
            ),
            ("<data/>", "XML"),
            ("{\"t\": 0}", "JSON"),
            (" [\n {\"t\": 0}]", "JSON"),
            ("loop,unit=U1 op=50.1,pv=51.2 1780293600000000000\n", "line protocol"),
            ("BZh91AY", "bzip2"),
            ("SQLite format 3\0", "SQLite"),
        ] {
            assert!(said(head).contains(what), "{head}: {}", said(head));
        }
        for head in [
            "t,op,pv\n0,1,2\n",
            "[s],op,pv\n",
            "<DATE>;<TIME>;<OP>;<PV>\n1;2;3;4\n",
            "{t};op;pv\n",
            "Date Time OP\n",
            "a=1 b=2 3\n",
            "",
        ] {
            assert_eq!(said(head), "", "{head}");
        }
    }
}
