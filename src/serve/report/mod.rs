//! Reports for printing and for a work order: one file each, with its style and its plots in it and nothing from anywhere
//! else. Whatever comes from the plant passes [`escape`].

mod of_benchmark;
mod of_group;
mod of_loop;
mod of_plant;
mod of_work;

pub use of_benchmark::{mark, of_benchmark, share};
pub use of_group::GroupPictures;
pub use of_loop::{Subject, of_loop};
pub use of_plant::of_plant;
pub use of_work::{of_work, work_csv};

use crate::plot::{self, escape};
use sha2::{Digest, Sha256};
use std::sync::LazyLock;

/// The style of every report.
static STYLE: LazyLock<String> = LazyLock::new(|| format!("{}{}", include_str!("style.css"), plot::STYLE));

/// The policy under which a browser shows a report: its own style, and nothing else.
pub static POLICY: LazyLock<String> = LazyLock::new(|| {
    let digest = base64(&Sha256::digest(STYLE.as_bytes()));
    format!(
        "default-src 'none'; style-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
});

/// A whole document.
fn document(title: &str, body: &str) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"><title>{}</title>\
         <style>{}</style></head>\n<body><main>{body}</main></body></html>\n",
        escape(title),
        *STYLE
    )
}

/// A time without the fraction of its second, in UTC.
fn when(time: Option<&str>) -> String {
    let Some(time) = time else { return "–".into() };
    let (whole, _) = time.split_once('.').unwrap_or((time.trim_end_matches('Z'), ""));
    format!("{} UTC", whole.replace('T', " "))
}

fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::new();
    for three in bytes.chunks(3) {
        let at = |i: usize| u32::from(three.get(i).copied().unwrap_or(0));
        let bits = at(0) << 16 | at(1) << 8 | at(2);
        for digit in 0..4 {
            let value = (bits >> (18 - 6 * digit) & 63) as usize;
            text.push(if digit > three.len() { '=' } else { char::from(DIGITS[value]) });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_by_rfc_4648() {
        let said = ["", "f", "fo", "foo", "foob", "fooba", "foobar"].map(|text| base64(text.as_bytes()));
        assert_eq!(said, ["", "Zg==", "Zm8=", "Zm9v", "Zm9vYg==", "Zm9vYmE=", "Zm9vYmFy"]);
    }

    #[test]
    fn times_are_readable() {
        assert_eq!(when(Some("2026-01-01T00:00:00.25Z")), "2026-01-01 00:00:00 UTC");
        assert_eq!(when(Some("2026-01-01T00:00:00Z")), "2026-01-01 00:00:00 UTC");
        assert_eq!(when(None), "–");
    }
}
