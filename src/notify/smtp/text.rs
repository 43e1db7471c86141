//! What a mail says. Pure.

use crate::alarm::Kind;
use crate::notify::batch::Digest;
use crate::notify::filter::What;
use crate::notify::notice::{Notice, Source, words};
use crate::notify::payload;
use crate::notify::time::iso;
use crate::results::words::swings_with as swings;

/// Longest subject (characters).
const MOST_SUBJECT: usize = 120;

/// `[stictiond] HIGH FIC101: the valve sticks (and 3 more)`.
pub(super) fn subject(digest: &Digest, source: &Source) -> String {
    let site = source.site.as_ref().map(|site| format!(" {site}")).unwrap_or_default();
    // What is most urgent and came first.
    let rank = |notice: &&Notice| (notice.what == What::Raised, notice.priority);
    let first = digest.notices.iter().rev().max_by_key(rank);
    let text = match first {
        None => format!("[stictiond{site}] {} changes of alarms", digest.changes()),
        Some(notice) => {
            let others = digest.changes() - 1;
            let more = if others > 0 { format!(" (and {others} more)") } else { String::new() };
            format!("[stictiond{site}] {}{more}", head(notice))
        }
    };
    line(&text).chars().take(MOST_SUBJECT).collect()
}

/// `HIGH FIC101: the valve sticks`, or `cleared FIC101: the valve sticks`.
fn head(notice: &Notice) -> String {
    let tag = match notice.what {
        What::Raised => notice.priority.as_str().to_uppercase(),
        other => other.as_str().to_string(),
    };
    format!("{tag} {}: {}", notice.alarm.subject, words(notice.alarm.kind))
}

/// All of it, one paragraph a change.
pub(super) fn body(digest: &Digest, source: &Source) -> String {
    let mut out = String::new();
    for notice in &digest.notices {
        paragraph(notice, &mut out);
    }
    for (what, kind, count) in &digest.more {
        out += &format!("and {count} times {}: {}\n", what.as_str(), kind_words(*kind));
    }
    if digest.lost > 0 {
        out += &format!("and {} changes that were too many to follow\n", digest.lost);
    }
    if let Some(url) = &source.public_url {
        out += &format!("\nAll alarms: {}/#/alarms\n", url.trim_end_matches('/'));
    }
    out
}

fn kind_words(kind: Kind) -> String {
    format!("{} ({})", words(kind), kind.as_str())
}

fn paragraph(notice: &Notice, out: &mut String) {
    *out += &format!("{}\n", line(&head(notice)));
    let mut say = |name: &str, text: &str| {
        if !text.is_empty() {
            *out += &format!("  {name:<9}{}\n", line(text));
        }
    };
    say(
        "alarm",
        &format!("{}, {} priority, {}", notice.alarm, notice.priority.as_str(), notice.what.as_str()),
    );
    say("time", &iso(notice.at));
    say("group", &notice.groups.join(", "));
    say("found", &notice.detail);
    let swings_with = notice.swings_with.as_ref();
    say("expected", &swings_with.map(|source| swings(source.as_str())).unwrap_or_default());
    say("friction", &notice.friction.as_ref().map(payload::friction).unwrap_or_default());
    say("state", notice.state.as_str());
    say("by", notice.by.as_deref().unwrap_or_default());
    say("comment", notice.comment.as_deref().unwrap_or_default());
    say("see", notice.link.as_deref().unwrap_or_default());
    *out += "\n";
}

/// On one line: what people and devices say does not shape a mail.
fn line(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}
