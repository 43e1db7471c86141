//! What `stictiond plant` found, as one page that stands alone: light and dark, wide and narrow.

use super::Work;
use std::fmt::Write;
use stictiond::plantwide::cause::period;
use stictiond::plantwide::{Analysis, Group, PlantLoop};
use stictiond::plot::{COLOURS, escape, thin};

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
svg .mark { stroke: var(--look); stroke-dasharray: 2 3; } svg .cell { fill: var(--op); } svg .frame { fill: none; stroke: var(--rule); }
@media (max-width: 700px) { .pair { grid-template-columns: 1fr; } body { padding: .5rem; } section { padding: .2rem .5rem 1rem; } th.less, td.less { display: none; } }
";
/// Members that are drawn of a group.
const DRAWN: usize = 16;
/// Height of one trend or spectrum, and widths.
const ROW: f64 = 30.0;
const WIDTH: f64 = 560.0;
const LEFT: f64 = 90.0;
/// Points of a trend.
const POINTS: usize = 500;

/// The page.
pub fn page(title: &str, plant: &[PlantLoop], found: &Analysis, work: &[Work], skipped: &[String]) -> String {
    let mut body = format!("<h1>{}</h1>", escape(title));
    let swinging = found.loops.iter().filter(|of| !of.oscillations.is_empty()).count();
    let _ = write!(
        body,
        "<p>{} loops, {swinging} of them oscillate, {} groups swing together.</p>",
        found.loops.len(),
        found.groups.len()
    );
    list(&mut body, found, work);
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

fn list(out: &mut String, found: &Analysis, work: &[Work]) {
    *out += "<section><h2>What to do first</h2>";
    if work.is_empty() {
        *out += "<p>Nothing: every loop is at rest.</p></section>";
        return;
    }
    *out += "<div class=\"wide\"><table><thead><tr><th>Loop</th><th>Cause</th><th class=\"number\">Probability</th><th>Why</th><th>Expected to calm down with it</th></tr></thead><tbody>";
    for line in work {
        let victims: Vec<String> = line.victims.iter().map(|i| escape(&found.loops[*i].name)).collect();
        let _ = write!(
            out,
            "<tr><td><strong>{}</strong></td><td>{}</td><td class=\"number\">{}</td><td>{}</td><td>{}</td></tr>",
            escape(&found.loops[line.at].name),
            line.cause.as_str(),
            super::sure(line),
            escape(&line.why),
            victims.join(", ")
        );
    }
    *out += "</tbody></table></div></section>";
}

fn of_group(out: &mut String, k: usize, group: &Group, plant: &[PlantLoop], found: &Analysis) {
    let name = |i: usize| escape(&found.loops[i].name);
    let _ = write!(
        out,
        "<section><h2>Group {}: {} loops swing at {}</h2>",
        k + 1,
        group.members.len(),
        period(group.period_s)
    );
    for (place, suspect) in group.suspects.iter().take(2).enumerate() {
        let what = if place == 0 { "Suspected source" } else { "Runner-up" };
        let evidence: Vec<String> = suspect.evidence.iter().map(|e| escape(e)).collect();
        let said = if evidence.is_empty() { String::new() } else { format!(": {}", evidence.join("; ")) };
        let class = if place == 0 { " class=\"look\"" } else { "" };
        let _ = write!(
            out,
            "<p>{what} <strong{class}>{}</strong>, {:.0} %{said}.</p>",
            name(suspect.at),
            100.0 * suspect.probability
        );
    }
    let members = &group.members[..group.members.len().min(DRAWN)];
    let source = group.suspects.first().map(|s| s.at);
    *out += "<div class=\"pair\"><figure>";
    trends(out, members, source, group, plant, found);
    *out += "<figcaption>The last ten periods of PV, each in its own scale</figcaption></figure><figure>";
    spectra(out, members, source, group, plant, found);
    *out += "<figcaption>Power of PV against the period, each over its largest</figcaption></figure><figure>";
    graph(out, members, source, group, found);
    *out += "<figcaption>Who is expected to drive whom: arrows from the suspected source along the strongest coherence</figcaption></figure><figure>";
    matrix(out, members, group, found);
    *out += "<figcaption>Coherence of every two, full colour where they swing as one</figcaption></figure></div></section>";
}

fn trends(
    out: &mut String,
    members: &[usize],
    source: Option<usize>,
    group: &Group,
    plant: &[PlantLoop],
    found: &Analysis,
) {
    let height = ROW * members.len() as f64 + 8.0;
    let _ = write!(out, "<svg viewBox=\"0 0 {WIDTH} {height}\" role=\"img\" aria-label=\"trends\">");
    let end = members
        .iter()
        .map(|i| {
            let w = &plant[*i].window;
            w.t0 + w.ts * w.pv.len() as f64
        })
        .fold(f64::INFINITY, f64::min);
    let from = end - 10.0 * group.period_s;
    for (row, i) in members.iter().enumerate() {
        let w = &plant[*i].window;
        let points: Vec<(f64, f64)> =
            w.pv.iter()
                .enumerate()
                .map(|(k, y)| (w.t0 + k as f64 * w.ts, *y))
                .filter(|p| p.0 >= from && p.0 <= end)
                .collect();
        line(out, row, &found.loops[*i].name, &thin(&points, POINTS), (from, end), Some(*i) == source);
    }
    *out += "</svg>";
}

fn spectra(
    out: &mut String,
    members: &[usize],
    source: Option<usize>,
    group: &Group,
    plant: &[PlantLoop],
    found: &Analysis,
) {
    use stictiond::plantwide::spectra::Spectra;
    use stictiond::sysid::spectrum::Transforms;
    let few: Vec<PlantLoop> = members.iter().map(|i| plant[*i].clone()).collect();
    let of = Spectra::new(&few, &mut Transforms::new());
    let height = ROW * members.len() as f64 + 22.0;
    let _ = write!(out, "<svg viewBox=\"0 0 {WIDTH} {height}\" role=\"img\" aria-label=\"spectra\">");
    // Two octaves slower, three faster than the group.
    let (from, to) = (-(4.0 * group.period_s).log2(), -(group.period_s / 8.0).log2());
    for (row, i) in members.iter().enumerate() {
        let points: Vec<(f64, f64)> = of
            .power(row)
            .into_iter()
            .map(|(p, y)| (-p.log2(), y.sqrt()))
            .filter(|p| p.0 >= from && p.0 <= to)
            .collect();
        line(out, row, &found.loops[*i].name, &thin(&points, POINTS), (from, to), Some(*i) == source);
    }
    let x = |v: f64| LEFT + (WIDTH - LEFT - 8.0) * (v - from) / (to - from);
    for times in [4.0, 1.0, 0.25] {
        let at = x(-(times * group.period_s).log2());
        let _ = write!(
            out,
            "<text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
            height - 4.0,
            period(times * group.period_s)
        );
    }
    let at = x(-group.period_s.log2());
    let _ = write!(out, "<path class=\"mark\" d=\"M{at:.1} 0V{:.1}\"/></svg>", height - 18.0);
}

fn line(out: &mut String, row: usize, name: &str, points: &[(f64, f64)], (from, to): (f64, f64), look: bool) {
    let bottom = ROW * (row + 1) as f64;
    let (low, high) =
        points.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| (l.min(p.1), h.max(p.1)));
    let span = (high - low).max(f64::MIN_POSITIVE);
    let class = if look { " class=\"look\"" } else { "" };
    let _ = write!(
        out,
        "<text x=\"2\" y=\"{:.1}\">{}</text><polyline{class} points=\"",
        bottom - 10.0,
        escape(name)
    );
    for (x, y) in points {
        let (px, py) = (
            LEFT + (WIDTH - LEFT - 8.0) * (x - from) / (to - from),
            bottom - 3.0 - (ROW - 6.0) * (y - low) / span,
        );
        let _ = write!(out, "{px:.1},{py:.1} ");
    }
    *out += "\"/>";
}

/// A tree of strongest coherence from the source: each member hangs on the one already there that it swings with most.
fn graph(out: &mut String, members: &[usize], source: Option<usize>, group: &Group, found: &Analysis) {
    let n = members.len();
    let size = (group.coherence.len() as f64).sqrt() as usize;
    let gamma = |a: usize, b: usize| group.coherence.get(a * size + b).copied().unwrap_or(0.0);
    let root = members.iter().position(|i| Some(*i) == source).unwrap_or(0);
    let (mut there, mut edges) = (vec![root], Vec::new());
    while there.len() < n {
        let left = (0..n).filter(|i| !there.contains(i));
        let pairs = left.flat_map(|i| there.iter().map(move |j| (*j, i)));
        let Some((from, to)) = pairs.max_by(|a, b| gamma(a.0, a.1).total_cmp(&gamma(b.0, b.1))) else {
            break;
        };
        edges.push((from, to));
        there.push(to);
    }
    let (w, h) = (WIDTH, 360.0);
    let place = |i: usize| {
        if i == root {
            return (0.5 * w, 0.5 * h);
        }
        let k = there.iter().position(|j| *j == i).unwrap_or(0) as f64 - 1.0;
        let turn = std::f64::consts::TAU * k / (n - 1).max(1) as f64;
        (0.5 * w + 0.4 * w * turn.cos(), 0.5 * h + 0.42 * h * turn.sin())
    };
    let _ = write!(
        out,
        "<svg viewBox=\"0 0 {w} {h}\" role=\"img\" aria-label=\"interaction graph\"><defs><marker id=\"a{root}-{n}\" viewBox=\"0 0 8 8\" refX=\"8\" refY=\"4\" markerWidth=\"7\" markerHeight=\"7\" orient=\"auto\"><path class=\"head\" d=\"M0 0L8 4L0 8z\"/></marker></defs>"
    );
    for (from, to) in edges {
        let ((x, y), (p, q)) = (place(from), place(to));
        // The arrow ends at the edge of the name's box.
        let edge = (34.0 / (p - x).abs()).min(10.0 / (q - y).abs());
        let short = edge.min(0.4);
        let _ = write!(
            out,
            "<path class=\"edge\" opacity=\"{:.2}\" marker-end=\"url(#a{root}-{n})\" d=\"M{x:.1} {y:.1}L{:.1} {:.1}\"/>",
            0.3 + 0.7 * gamma(from, to),
            p - short * (p - x),
            q - short * (q - y)
        );
    }
    for (i, member) in members.iter().enumerate() {
        let (x, y) = place(i);
        let class = if i == root { "look" } else { "node" };
        let style = if i == root { " style=\"fill:var(--sheet)\"" } else { "" };
        let _ = write!(
            out,
            "<rect class=\"{class}\"{style} x=\"{:.1}\" y=\"{:.1}\" width=\"68\" height=\"20\" rx=\"4\"/><text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
            x - 34.0,
            y - 10.0,
            y + 4.0,
            escape(&found.loops[*member].name)
        );
    }
    *out += "</svg>";
}

fn matrix(out: &mut String, members: &[usize], group: &Group, found: &Analysis) {
    let size = (group.coherence.len() as f64).sqrt() as usize;
    let side = (0.5 * (WIDTH - LEFT)).min(26.0 * members.len() as f64) / members.len().max(1) as f64;
    let height = side * members.len() as f64 + 8.0;
    let _ = write!(out, "<svg viewBox=\"0 0 {WIDTH} {height:.1}\" role=\"img\" aria-label=\"coherence\">");
    for (i, a) in members.iter().enumerate() {
        let top = side * i as f64;
        let _ = write!(
            out,
            "<text x=\"2\" y=\"{:.1}\">{}</text>",
            top + 0.5 * side + 4.0,
            escape(&found.loops[*a].name)
        );
        for (j, b) in members.iter().enumerate() {
            let gamma = group.coherence.get(i * size + j).copied().unwrap_or(0.0);
            let _ = write!(
                out,
                "<rect class=\"cell\" opacity=\"{gamma:.2}\" x=\"{:.1}\" y=\"{top:.1}\" width=\"{side:.1}\" height=\"{side:.1}\"><title>{} and {}: {gamma:.2}</title></rect>",
                LEFT + side * j as f64,
                escape(&found.loops[*a].name),
                escape(&found.loops[*b].name)
            );
        }
    }
    *out += "</svg>";
}

fn loops(out: &mut String, found: &Analysis) {
    *out += "<section><h2>All loops, the worst first</h2><div class=\"wide\"><table><thead><tr><th>Loop</th><th class=\"number\">Score</th><th class=\"number\">Period</th><th class=\"number less\">Share</th><th class=\"number less\">Harris</th><th class=\"number less\">Reversals a day</th><th>Cause</th><th class=\"less\">Why</th></tr></thead><tbody>";
    let mut order: Vec<usize> = (0..found.loops.len()).collect();
    let score = |i: usize| found.loops[i].indicators.score.unwrap_or(100.0);
    order.sort_by(|a, b| score(*a).total_cmp(&score(*b)));
    for i in order {
        let of = &found.loops[i];
        let swing = of.oscillations.first();
        let cell = |text: Option<String>| text.unwrap_or_else(|| "–".into());
        let _ = write!(
            out,
            "<tr><td>{}</td><td class=\"number\">{}</td><td class=\"number\">{}</td><td class=\"number less\">{}</td><td class=\"number less\">{}</td><td class=\"number less\">{:.0}</td><td>{}</td><td class=\"less\">{}</td></tr>",
            escape(&of.name),
            cell(of.indicators.score.map(|s| format!("{s:.0}"))),
            cell(swing.map(|s| period(s.period_s))),
            cell(swing.map(|s| format!("{:.0} %", 100.0 * s.share))),
            cell(of.indicators.harris.map(|h| format!("{:.2}", h.index))),
            of.indicators.travel.reversals_a_day,
            of.reason.as_ref().map_or("–", |r| r.cause.as_str()),
            of.reason.as_ref().map_or(String::new(), |r| escape(&r.why))
        );
    }
    *out += "</tbody></table></div></section>";
}
