//! What a mail says. Pure.

use crate::alarm::{Kind, State};
use crate::notify::batch::Digest;
use crate::notify::filter::What;
use crate::notify::notice::{Notice, Source};
use crate::notify::payload;
use crate::notify::time::iso;
use crate::results::SourceOrder;
use crate::results::words::swings_with as swings;

/// Longest subject (characters).
const MOST_SUBJECT: usize = 120;
/// What stands before each line of a change that is listed below its source's.
const BELOW: &str = "    ";

/// `[stictiond] HIGH FIC101: the valve sticks (and 3 more)`.
pub(super) fn subject(digest: &Digest, source: &Source) -> String {
    let site = source.site.as_ref().map(|site| format!(" {site}")).unwrap_or_default();
    // What is most urgent and came first.
    let rank = |notice: &&Notice| (notice.what == What::Raised, notice.priority);
    let first = digest.notices.iter().rev().max_by_key(rank);
    let text = match first {
        None => format!("[stictiond{site}] changes of alarms: {}", digest.changes()),
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
    format!("{tag} {}: {}", notice.alarm.subject, notice.alarm.kind.words())
}

/// All of it, one paragraph a change.
pub(super) fn body(digest: &Digest, source: &Source) -> String {
    let mut out = String::new();
    for (notice, victims) in digest.grouped() {
        paragraph(notice, "", &mut out);
        if !victims.is_empty() {
            out += "  expected to calm down with it:\n";
            victims.into_iter().for_each(|victim| paragraph(victim, BELOW, &mut out));
        }
        out += "\n";
    }
    for (what, kind, count) in &digest.more {
        out += &format!("and {count} more {}: {}\n", what.as_str(), kind_words(*kind));
    }
    if digest.lost > 0 {
        out += &format!("and {} more that came too fast to list\n", digest.lost);
    }
    if let Some(url) = &source.public_url {
        out += &format!("\nAll alarms: {}/#/alarms\n", url.trim_end_matches('/'));
    }
    out
}

fn kind_words(kind: Kind) -> String {
    format!("{} ({})", kind.words(), kind.as_str())
}

/// What a change is about, each line behind `indent`.
fn paragraph(notice: &Notice, indent: &str, out: &mut String) {
    *out += &format!("{indent}{}\n", line(&head(notice)));
    let mut say = |name: &str, text: &str| {
        if !text.is_empty() {
            *out += &format!("{indent}  {name:<9}{}\n", line(text));
        }
    };
    say(
        "alarm",
        &format!("{}, {} priority, {}", notice.alarm, notice.priority.as_str(), notice.what.as_str()),
    );
    say("time", &iso(notice.at));
    say("group", &notice.groups.join(", "));
    // Of a condition that has gone it is told what it was; whether friction rises is said anew by every diagnosis.
    let is_there = matches!(notice.state, State::Unacknowledged | State::Acknowledged);
    let found = if is_there || notice.alarm.kind == Kind::FRising { "found" } else { "was" };
    say(found, &notice.detail);
    // Below its source this is said by where it stands.
    if let Some(order) = notice.swings_with.as_ref().filter(|_| indent.is_empty()) {
        say("swings", &swings(order.source.as_str()));
        say("order", &standing(order));
    }
    say("friction", &notice.friction.as_ref().map(payload::friction).unwrap_or_default());
    say("state", notice.state.as_str());
    say("by", notice.by.as_deref().unwrap_or_default());
    say("comment", notice.comment.as_deref().unwrap_or_default());
    say("see", notice.link.as_deref().unwrap_or_default());
}

/// `FIC102, ordered since 2026-01-01T00:00:00Z (ann: 4711)`.
fn standing(order: &SourceOrder) -> String {
    let said: Vec<&str> = [&order.by, &order.note].into_iter().filter_map(|own| own.as_deref()).collect();
    let said = if said.is_empty() { String::new() } else { format!(" ({})", said.join(": ")) };
    format!("{}, {} since {}{said}", order.source, order.state, iso(order.since))
}

/// On one line: what people and devices say does not shape a mail.
fn line(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alarm::{AlarmId, Priority};
    use crate::notify::notice::tests::{notice, source};
    use crate::signal::LoopId;

    #[test]
    fn a_condition_that_has_gone_is_not_said_to_be_found() {
        let told = |notice: &Notice| {
            let mut out = String::new();
            paragraph(notice, "", &mut out);
            out
        };
        let raised = notice("A/stiction", Priority::High);
        let (found, was) = ("\n  found    sticks by 2.5 %\n", "\n  was      sticks by 2.5 %\n");
        assert!(told(&raised).contains(found), "{}", told(&raised));
        let seen = Notice { what: What::Acknowledged, state: State::Acknowledged, ..raised.clone() };
        assert!(told(&seen).contains(found), "{}", told(&seen));
        for (what, state) in [
            (What::Cleared, State::ReturnedUnacknowledged),
            (What::Cleared, State::Normal),
            (What::Acknowledged, State::Normal),
            (What::Latched, State::LatchedAcknowledged),
            (What::Silenced, State::Shelved),
        ] {
            let gone = Notice { what, state, ..raised.clone() };
            assert!(told(&gone).contains(was) && !told(&gone).contains(found), "{}", told(&gone));
        }
        let (alarm, state) = (AlarmId::named("A/f_rising"), State::ReturnedUnacknowledged);
        let no_longer = Notice { alarm, what: What::Cleared, state, ..raised };
        assert!(told(&no_longer).contains(found), "{}", told(&no_longer));
    }

    #[test]
    fn a_mail_calls_each_alarm_as_the_page_does() {
        let page = include_str!("../../serve/page/assets/js/states.js");
        let (_, list) = page.split_once("const ALARMS = {").expect("the page's list");
        for kind in Kind::ALL {
            let head = head(&notice(&format!("A/{}", kind.as_str()), Priority::Low));
            let (_, said) = head.split_once("LOW A: ").expect("a head");
            assert!(list.contains(&format!("{}: \"{said}\"", kind.as_str())), "{head}");
        }
    }

    #[test]
    fn victims_are_listed_below_their_source_and_one_without_it_names_its_order() {
        let order = SourceOrder {
            source: LoopId::new("FIC102"),
            state: "ordered",
            since: 1_767_225_600.0,
            by: Some("ann".into()),
            note: Some("4711".into()),
        };
        let plain = |id: &str, priority| Notice { friction: None, link: None, ..notice(id, priority) };
        let victim =
            Notice { swings_with: Some(order), ..plain("LIC201/unexplained_residual", Priority::Low) };
        let source_of = plain("FIC102/stiction", Priority::High);
        let told = |notices: Vec<Notice>| body(&Digest { notices, more: Vec::new(), lost: 0 }, &source());
        let fields = |indent: &str, alarm: &str, priority: &str| {
            format!(
                "{indent}  alarm    {alarm}, {priority} priority, raised\n\
                 {indent}  time     2026-01-01T00:00:00Z\n\
                 {indent}  group    unit 10\n\
                 {indent}  found    sticks by 2.5 %\n"
            )
        };
        let state = "  state    unacknowledged\n";
        let below = format!(
            "    LOW LIC201: much is unexplained\n{}    {state}",
            fields("    ", "LIC201/unexplained_residual", "low")
        );
        let own = format!("HIGH FIC102: the valve sticks\n{}{state}", fields("", "FIC102/stiction", "high"));
        assert_eq!(
            told(vec![victim.clone(), source_of]),
            format!("{own}  expected to calm down with it:\n{below}\n")
        );
        assert_eq!(
            told(vec![victim]),
            format!(
                "LOW LIC201: much is unexplained\n{}  swings   {}\n  order    FIC102, ordered since 2026-01-01T00:00:00Z (ann: 4711)\n{state}\n",
                fields("", "LIC201/unexplained_residual", "low"),
                swings("FIC102")
            )
        );
    }

    #[test]
    fn what_is_only_counted_reads_well_for_one_and_for_many() {
        let more = vec![(What::Raised, Kind::Stiction, 1), (What::Cleared, Kind::TagBad, 12)];
        let digest = Digest { notices: Vec::new(), more, lost: 3 };
        assert_eq!(subject(&digest, &source()), "[stictiond] changes of alarms: 16");
        assert_eq!(
            body(&digest, &source()),
            "and 1 more raised: the valve sticks (stiction)\nand 12 more cleared: a tag is bad (tag_bad)\n\
             and 3 more that came too fast to list\n"
        );
    }
}
