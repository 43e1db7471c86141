//! What `stictiond plant` found, as one page that stands alone: light and dark, wide and narrow.

use super::{counted, nothing, sure};
use std::fmt::Write;
use stictiond::plantwide::cause::period;
use stictiond::plantwide::{Analysis, Group, Part, Plant, Task};
use stictiond::plot::{COLOURS, escape};
use stictiond::results::words::percent;
use stictiond::serve::report::GroupPictures;
use stictiond::signal::share;

const CSS: &str = "body { margin: 0 auto; max-width: 72rem; padding: 1rem; background: var(--ground); color: var(--ink); font: 14px/1.45 system-ui, sans-serif; }
h1 { font-size: 22px; } h2 { font-size: 17px; margin: 1.6rem 0 .4rem; } h3 { font-size: 14px; margin: .8rem 0 .2rem; }
.faint, th { color: var(--faint); font-weight: 400; } .wide { overflow-x: auto; }
section { background: var(--sheet); border: 1px solid var(--rule); padding: .2rem 1rem 1rem; margin: 1rem 0; }
table { border-collapse: collapse; width: 100%; } th, td { text-align: left; padding: .25rem .5rem; border-bottom: 1px solid var(--rule); vertical-align: top; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; } strong.look { color: var(--look); }
.pair { display: grid; grid-template-columns: 1fr 1fr; gap: 1rem; } figure { margin: 0; } figcaption { color: var(--faint); }
svg { display: block; width: 100%; height: auto; } svg text { fill: var(--ink); font: 11px system-ui, sans-serif; }
svg polyline { fill: none; stroke: var(--pv); stroke-width: 1.1; } svg .look { stroke: var(--look); fill: var(--look); } svg polyline.look { fill: none; }
svg .edge { stroke: var(--op); fill: none; stroke-width: 1.4; } svg .head { fill: var(--op); } svg .node { fill: var(--sheet); stroke: var(--ink); }
svg .mark { stroke: var(--look); stroke-dasharray: 2 3; } svg .cell { fill: var(--op); } svg rect.look { fill: var(--sheet); } svg .frame { fill: none; stroke: var(--rule); }
@media (max-width: 700px) { .pair { grid-template-columns: 1fr; } body { padding: .5rem; } section { padding: .2rem .5rem 1rem; } th.less, td.less { display: none; } }
";

/// The page.
pub fn page(title: &str, plant: &dyn Plant, found: &Analysis, work: &[Task], skipped: &[String]) -> String {
    let mut body = format!("<h1>{}</h1>", escape(title));
    let _ = write!(body, "<p>{}.</p>", counted(found));
    for part in Part::ALL {
        list(&mut body, part, found, work);
    }
    for (k, group) in found.groups.iter().enumerate() {
        of_group(&mut body, k, group, plant, found);
    }
    loops(&mut body, found);
    if !skipped.is_empty() {
        body += "<h2>Not read</h2><ul>";
        skipped.iter().for_each(|why| {
            let _ = write!(body, "<li>{}</li>", escape(why));
        });
        body += "</ul>";
    }
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
         <title>{}</title><style>{COLOURS}{CSS}</style></head>\n<body><main>{body}</main></body></html>\n",
        escape(title)
    )
}

/// One part of the list of tasks; nothing of an empty one but the first.
fn list(out: &mut String, part: Part, found: &Analysis, work: &[Task]) {
    let lines: Vec<&Task> = work.iter().filter(|line| line.part() == part).collect();
    if lines.is_empty() && part != Part::First {
        return;
    }
    let note = part.note().map(|note| format!("<p class=\"faint\">{note}</p>")).unwrap_or_default();
    let _ = write!(out, "<section><h2>{}</h2>{note}", part.heading());
    if lines.is_empty() {
        let _ = write!(out, "<p>{}.</p></section>", nothing(work));
        return;
    }
    // Of a cause that is not known there is neither a name nor a probability.
    let is_known = part != Part::Unknown;
    let cause = if is_known { "<th>Cause</th><th class=\"number\">Probability</th>" } else { "" };
    let _ = write!(
        out,
        "<div class=\"wide\"><table><thead><tr><th>Loop</th>{cause}<th>Why</th><th>May calm down with it</th></tr></thead><tbody>"
    );
    for line in lines {
        let victims: Vec<String> = line.victims.iter().map(|i| escape(&found.loops[*i].name)).collect();
        let (cause, sure) = (line.cause.as_str(), escape(&sure(line)));
        let cause = if is_known {
            format!("<td>{cause}</td><td class=\"number\">{sure}</td>")
        } else {
            String::new()
        };
        let _ = write!(
            out,
            "<tr><td><strong>{}</strong></td>{cause}<td>{}</td><td>{}</td></tr>",
            escape(&found.loops[line.at].name),
            escape(&line.why),
            victims.join(", ")
        );
    }
    *out += "</tbody></table></div></section>";
}

fn of_group(out: &mut String, k: usize, group: &Group, plant: &dyn Plant, found: &Analysis) {
    let name = |i: usize| escape(&found.loops[i].name);
    let _ = write!(
        out,
        "<section><h2>Group {}: {} loops swing at {}</h2>",
        k + 1,
        group.members.len(),
        period(group.period_s)
    );
    for (place, suspect) in group.suspects.iter().take(2).enumerate() {
        let what = match place {
            0 if suspect.probability >= 0.5 => "Suspected source",
            0 => "Likeliest source",
            _ => "Runner-up",
        };
        let evidence: Vec<String> = suspect.evidence.iter().map(|e| escape(e)).collect();
        let said = if evidence.is_empty() { String::new() } else { format!(": {}", evidence.join("; ")) };
        let class = if place == 0 { " class=\"look\"" } else { "" };
        let _ = write!(
            out,
            "<p>{what} <strong{class}>{}</strong>, {}{said}.</p>",
            name(suspect.at),
            escape(&percent(suspect.probability))
        );
    }
    *out += "<div class=\"pair\">";
    for (picture, caption) in GroupPictures::of(k, group, plant, found).each() {
        let _ = write!(out, "<figure>{picture}<figcaption>{caption}</figcaption></figure>");
    }
    *out += "</div></section>";
}

fn loops(out: &mut String, found: &Analysis) {
    *out += "<section><h2>All loops, the worst first</h2><p class=\"faint\">Score: 100 for a loop at rest, 0 for the worst. Share: of PV's \
             variance in its largest swing. Harris: 1 where no tuning makes PV steadier, near 0 where tuning could gain most. Margins: usual are 2 to 5 and 30° to 60°.</p><div class=\"wide\"><table><thead><tr><th>Loop</th><th class=\"number\">Score</th><th class=\"number\">Period</th><th class=\"number less\">Share</th><th class=\"number less\">Harris</th><th class=\"less\">Margins</th><th class=\"number less\">Reversals a day</th><th>Cause</th><th class=\"less\">Why</th></tr></thead><tbody>";
    let mut order: Vec<usize> = (0..found.loops.len()).collect();
    let score = |i: usize| found.loops[i].indicators.score.unwrap_or(100.0);
    order.sort_by(|a, b| score(*a).total_cmp(&score(*b)));
    for i in order {
        let of = &found.loops[i];
        let swing = of.oscillations.first();
        let cell = |text: Option<String>| text.unwrap_or_else(|| "–".into());
        let _ = write!(
            out,
            "<tr><td>{}</td><td class=\"number\">{}</td><td class=\"number\">{}</td><td class=\"number less\">{}</td><td class=\"number less\">{}</td><td class=\"less\">{}</td><td class=\"number less\">{}</td><td>{}</td><td class=\"less\">{}</td></tr>",
            escape(&of.name),
            cell(of.indicators.score.map(|s| format!("{s:.0}"))),
            cell(swing.map(|s| period(s.period_s))),
            cell(swing.map(|s| share(s.share, 0))),
            cell(of.indicators.harris.map(|h| format!("{:.2}", h.index))),
            cell(of.margins.map(|margins| margins.words())),
            cell(of.indicators.travel.map(|travel| format!("{:.0}", travel.reversals_a_day))),
            of.reason.as_ref().map_or("–", |r| r.cause.as_str()),
            of.reason.as_ref().map_or(String::new(), |r| escape(&r.why))
        );
    }
    *out += "</tbody></table></div></section>";
}
