//! Links of the documents lead to files that are there, and to headings that those have.

use super::{DOCUMENTS, read, root};
use std::fs;
use std::path::{Path, PathBuf};

/// Where a heading is within its page, as hosts of Markdown make it: small letters, `-` for a blank, no other marks.
fn place(heading: &str) -> String {
    let kept = |c: &char| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_');
    heading.to_lowercase().chars().filter(kept).map(|c| if c == ' ' { '-' } else { c }).collect()
}

fn has(page: &str, wanted: &str) -> bool {
    let headings = page.lines().filter(|line| line.starts_with('#'));
    headings.map(|line| place(line.trim_start_matches('#').trim())).any(|own| own == wanted)
}

#[test]
fn a_heading_is_found_by_its_place() {
    let page = "# One\n## 10. The interval of f (`residual/interval.rs`)\n";
    assert!(has(page, "one") && has(page, "10-the-interval-of-f-residualintervalrs"));
    assert!(!has(page, "two") && !has(page, ""));
}

#[test]
fn every_link_to_a_file_leads_somewhere() {
    let (mut files, mut headings) = (0, 0);
    for name in DOCUMENTS {
        let text = read(name);
        let folder = root().join(name).parent().map(Path::to_path_buf).unwrap_or_default();
        for target in text.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
            if target.contains("://") {
                continue;
            }
            let (file, heading) = target.split_once('#').unwrap_or((target, ""));
            let path: PathBuf = if file.is_empty() { root().join(name) } else { folder.join(file) };
            assert!(path.exists(), "{name}: {target} does not exist");
            files += 1;
            if !heading.is_empty() {
                let page = fs::read_to_string(&path);
                let page = page.unwrap_or_else(|error| panic!("{name}: {target}: {error}"));
                assert!(has(&page, heading), "{name}: {target} is no heading there");
                headings += 1;
            }
        }
    }
    assert!(files > 5 && headings > 5, "only {files} links found, {headings} to a heading");
}

/// A picture that nobody can make again shows what the program no longer does.
#[test]
fn every_picture_is_made_by_a_script_that_says_so() {
    const OTHERS: [(&str, &str); 2] =
        [("closing-", "closing-*    scripts/worked-examples"), ("soak", "soak         scripts/soak")];
    let script = read("scripts/screenshot");
    let made = script.split_once("\nmade=(").and_then(|(_, rest)| rest.split(')').next());
    let mut made: Vec<&str> = made.expect("a list of what it makes").split_whitespace().collect();
    for entry in fs::read_dir(root().join("docs/img")).expect("the folder is there") {
        let path = entry.expect("readable").path();
        let name = path.file_stem().and_then(|name| name.to_str()).expect("a name");
        if let Some((_, said)) = OTHERS.iter().find(|(begin, _)| name.starts_with(begin)) {
            assert!(script.contains(said), "{name}: scripts/screenshot does not say what makes it");
            continue;
        }
        assert!(made.contains(&name), "{name}: scripts/screenshot does not make it");
        made.retain(|own| *own != name);
    }
    assert!(made.is_empty(), "scripts/screenshot makes pictures that are not there: {made:?}");
}
