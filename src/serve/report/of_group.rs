//! The pictures of a group of loops that swing together, as SVG whose colours and strokes the page's style gives:
//! `polyline` trends and spectra, `.look` the likeliest source, `.edge` and `.node` of the graph, `.cell` of the matrix.

use crate::plantwide::cause::period;
use crate::plantwide::lag::Lag;
use crate::plantwide::spectra::Spectra;
use crate::plantwide::{Analysis, Group, Plant, PlantLoop};
use crate::plot::{escape, thin};
use std::fmt::Write;

/// Members that are drawn of a group.
const DRAWN: usize = 16;
/// Height of one trend or spectrum, and widths.
const ROW: f64 = 30.0;
const WIDTH: f64 = 560.0;
const LEFT: f64 = 90.0;
/// Points of a trend.
const POINTS: usize = 500;

/// What is drawn of a group, each with its caption.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GroupPictures([(String, &'static str); 4]);

impl GroupPictures {
    /// Draws a group; `number` tells the marks of several on one page apart.
    pub fn of(number: usize, group: &Group, plant: &dyn Plant, found: &Analysis) -> Self {
        let source = group.suspects.first().map(|s| s.at);
        let places = places(group, source);
        let members: Vec<usize> = places.iter().map(|place| group.members[*place]).collect();
        let few: Vec<PlantLoop> = members.iter().map(|i| plant.get(*i).into_owned()).collect();
        let drawn = Drawn { members: &members, places: &places, source, group, found };
        let picture = |draw: &dyn Fn(&mut String)| {
            let mut out = String::new();
            draw(&mut out);
            out
        };
        Self([
            (picture(&|out| drawn.trends(out, &few)), "The last ten periods of PV, each in its own scale"),
            (
                picture(&|out| drawn.spectra(out, &few)),
                "Power of PV against the period, each over its largest",
            ),
            (
                picture(&|out| drawn.graph(out, number)),
                "The strongest coherences from the likeliest source on. Arrow: comes later by more than twice the error of the lag; line: swings together, order not known",
            ),
            (
                picture(&|out| drawn.matrix(out)),
                "Coherence of every two, full colour where they swing as one",
            ),
        ])
    }

    /// Each picture with its caption: trends, spectra, graph, coherence.
    pub fn each(&self) -> impl Iterator<Item = (&str, &'static str)> {
        self.0.iter().map(|(picture, caption)| (picture.as_str(), *caption))
    }
}

/// Which of a group's members are drawn: the strongest, and the source in the last one's stead where it is not among them.
fn places(group: &Group, source: Option<usize>) -> Vec<usize> {
    let mut places: Vec<usize> = (0..group.members.len().min(DRAWN)).collect();
    let of_source = group.members.iter().position(|i| Some(*i) == source);
    if let (Some(beyond), Some(last)) = (of_source.filter(|place| *place >= DRAWN), places.last_mut()) {
        *last = beyond;
    }
    places
}

/// A group and those of its members that are drawn.
struct Drawn<'a> {
    members: &'a [usize],
    /// Where each of them stands in the group.
    places: &'a [usize],
    source: Option<usize>,
    group: &'a Group,
    found: &'a Analysis,
}

impl Drawn<'_> {
    /// Where two that are drawn stand in the matrices of the group; none where they were not kept.
    fn pair(&self, a: usize, b: usize) -> Option<usize> {
        let size = (self.group.coherence.len() as f64).sqrt() as usize;
        let (a, b) = (self.places[a], self.places[b]);
        (a.max(b) < size).then_some(a * size + b)
    }

    /// gamma² of two that are drawn; 0 where it was not kept.
    fn gamma(&self, a: usize, b: usize) -> f64 {
        self.pair(a, b).and_then(|at| self.group.coherence.get(at).copied()).unwrap_or(0.0)
    }

    /// The lag of `b` against `a`, both drawn; none where it is not known which comes first.
    fn lag(&self, a: usize, b: usize) -> Option<Lag> {
        self.group.lags.get(self.pair(a, b)?).copied().filter(Lag::is_known)
    }

    fn trends(&self, out: &mut String, few: &[PlantLoop]) {
        let Self { members, source, group, found, .. } = *self;
        let height = ROW * members.len() as f64 + 8.0;
        let _ = write!(out, "<svg viewBox=\"0 0 {WIDTH} {height}\" role=\"img\" aria-label=\"trends\">");
        let end = few
            .iter()
            .map(|of| of.window.t0 + of.window.ts * of.window.pv.len() as f64)
            .fold(f64::INFINITY, f64::min);
        let from = end - 10.0 * group.period_s;
        for (row, i) in members.iter().enumerate() {
            let w = &few[row].window;
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

    fn spectra(&self, out: &mut String, few: &[PlantLoop]) {
        let Self { members, source, group, found, .. } = *self;
        let of = Spectra::of(few, group.period_s);
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

    /// A tree of strongest coherence from the source: each member hangs on the one already there that it swings with most. It says who
    /// swings with whom; who comes first is said by the measured lag alone.
    fn graph(&self, out: &mut String, number: usize) {
        let Self { members, source, found, .. } = *self;
        let n = members.len();
        let root = members.iter().position(|i| Some(*i) == source).unwrap_or(0);
        let (mut there, mut edges) = (vec![root], Vec::new());
        while there.len() < n {
            let left = (0..n).filter(|i| !there.contains(i));
            let pairs = left.flat_map(|i| there.iter().map(move |j| (*j, i)));
            let Some((from, to)) = pairs.max_by(|a, b| self.gamma(a.0, a.1).total_cmp(&self.gamma(b.0, b.1)))
            else {
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
            "<svg viewBox=\"0 0 {w} {h}\" role=\"img\" aria-label=\"interaction graph\"><defs><marker id=\"from{number}\" viewBox=\"0 0 8 8\" refX=\"8\" refY=\"4\" markerWidth=\"7\" markerHeight=\"7\" orient=\"auto\"><path class=\"head\" d=\"M0 0L8 4L0 8z\"/></marker></defs>"
        );
        for (a, b) in edges {
            self.edge(out, number, (a, place(a)), (b, place(b)));
        }
        for (i, member) in members.iter().enumerate() {
            let (x, y) = place(i);
            let class = if i == root { "look" } else { "node" };
            let _ = write!(
                out,
                "<rect class=\"{class}\" x=\"{:.1}\" y=\"{:.1}\" width=\"68\" height=\"20\" rx=\"4\"/><text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
                x - 34.0,
                y - 10.0,
                y + 4.0,
                escape(&found.loops[*member].name)
            );
        }
        *out += "</svg>";
    }

    /// An edge between two that are drawn, each with its place: an arrow to the one that comes later, or a line where that is not known.
    fn edge(&self, out: &mut String, number: usize, a: (usize, (f64, f64)), b: (usize, (f64, f64))) {
        let name = |of: usize| escape(&self.found.loops[self.members[of]].name);
        let lag = self.lag(a.0, b.0);
        // The name's box covers the end of a line.
        let ((from, (x, y)), (to, (p, q))) =
            if lag.is_some_and(|lag| lag.delay_s < 0.0) { (b, a) } else { (a, b) };
        let (end, head, title) = match lag {
            Some(lag) => {
                // An arrow ends at the edge of the name's box.
                let short = (34.0 / (p - x).abs()).min(10.0 / (q - y).abs()).min(0.4);
                let periods = |s: f64| s.abs() / self.group.period_s;
                let (delay, error) = (periods(lag.delay_s), periods(lag.error_s));
                let title =
                    format!("{} swings {delay:.2} ± {error:.2} periods after {}", name(to), name(from));
                (
                    (p - short * (p - x), q - short * (q - y)),
                    format!(" marker-end=\"url(#from{number})\""),
                    title,
                )
            }
            None => {
                let title = format!("{} and {}: which comes first is not known", name(from), name(to));
                ((p, q), String::new(), title)
            }
        };
        let _ = write!(
            out,
            "<path class=\"edge\" opacity=\"{:.2}\"{head} d=\"M{x:.1} {y:.1}L{:.1} {:.1}\"><title>{title}</title></path>",
            0.3 + 0.7 * self.gamma(a.0, b.0),
            end.0,
            end.1
        );
    }

    fn matrix(&self, out: &mut String) {
        let Self { members, found, .. } = *self;
        let side = (0.5 * (WIDTH - LEFT)).min(26.0 * members.len() as f64) / members.len().max(1) as f64;
        let height = side * members.len() as f64 + 8.0;
        let _ =
            write!(out, "<svg viewBox=\"0 0 {WIDTH} {height:.1}\" role=\"img\" aria-label=\"coherence\">");
        for (i, a) in members.iter().enumerate() {
            let top = side * i as f64;
            let _ = write!(
                out,
                "<text x=\"2\" y=\"{:.1}\">{}</text>",
                top + 0.5 * side + 4.0,
                escape(&found.loops[*a].name)
            );
            for (j, b) in members.iter().enumerate() {
                let gamma = self.gamma(i, j);
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
}

/// One polyline in its row, its name beside it.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plantwide::{LoopFound, Suspect};

    #[test]
    fn the_source_is_drawn_and_marked_though_many_swing_more() {
        // L23 is the last of 24.
        let n = 24;
        let name = |i: usize| format!("L{i}");
        let plant: Vec<PlantLoop> =
            (0..n).map(|i| PlantLoop { name: name(i), ..PlantLoop::default() }).collect();
        let loops = (0..n).map(|i| LoopFound { name: name(i), ..LoopFound::default() }).collect();
        let mut coherence = vec![0.0; n * n];
        coherence[23 * n + 2] = 0.75;
        let group = Group {
            period_s: 600.0,
            members: (0..n).collect(),
            coherence,
            suspects: vec![Suspect { at: 23, probability: 0.9, ..Suspect::default() }],
            ..Group::default()
        };
        let found = Analysis { loops, groups: Vec::new() };
        let pictures = GroupPictures::of(0, &group, &plant, &found);
        let drawn: Vec<&str> = pictures.each().map(|picture| picture.0).collect();
        assert!(
            drawn.iter().all(|picture| picture.contains(">L23</text>") && !picture.contains(">L15</text>"))
        );
        let (_, marked) = drawn[2].split_once("class=\"look\"").expect("a source");
        assert!(marked.contains(">L23</text>") && !marked.contains(">L14</text>"), "{marked}");
        assert!(drawn[3].contains("<title>L23 and L2: 0.75</title>"));
        // It is where it was among the few.
        let few = Group { members: (0..5).collect(), ..group };
        assert_eq!(places(&few, Some(3)), [0, 1, 2, 3, 4]);
    }

    #[test]
    fn an_arrow_goes_to_who_comes_later_and_a_line_to_whom_nobody_knows() {
        let name = |i: usize| format!("L{i}");
        let plant: Vec<PlantLoop> =
            (0..4).map(|i| PlantLoop { name: name(i), ..PlantLoop::default() }).collect();
        let loops = (0..4).map(|i| LoopFound { name: name(i), ..LoopFound::default() }).collect();
        let (mut coherence, mut lags) = (vec![0.0; 16], vec![Lag::UNKNOWN; 16]);
        // All swing with the first: one after it, one before it, and one by less than twice the error after it.
        for (other, gamma, delay_s) in [(1, 0.9, 10.0), (2, 0.8, -10.0), (3, 0.7, 7.0)] {
            let lag = Lag { delay_s, error_s: 4.0 };
            (coherence[other], lags[other], lags[4 * other]) = (gamma, lag, lag.reversed());
        }
        let suspects = vec![Suspect { at: 0, probability: 0.9, ..Suspect::default() }];
        let members = (0..4).collect();
        let group = Group { period_s: 100.0, members, coherence, lags, suspects, ..Group::default() };
        let found = Analysis { loops, groups: Vec::new() };
        let pictures = GroupPictures::of(7, &group, &plant, &found);
        let (graph, caption) = pictures.each().nth(2).expect("a graph");
        let edges: Vec<&str> = graph
            .split("<path class=\"edge\"")
            .skip(1)
            .filter_map(|own| own.split("</path>").next())
            .collect();
        assert_eq!(
            edges,
            [
                " opacity=\"0.93\" marker-end=\"url(#from7)\" d=\"M280.0 180.0L470.0 180.0\"><title>L1 swings 0.10 ± 0.04 periods after L0</title>",
                " opacity=\"0.86\" marker-end=\"url(#from7)\" d=\"M168.0 310.9L271.4 190.0\"><title>L0 swings 0.10 ± 0.04 periods after L2</title>",
                " opacity=\"0.79\" d=\"M280.0 180.0L168.0 49.1\"><title>L0 and L3: which comes first is not known</title>",
            ]
        );
        assert!(
            caption.contains("Arrow: comes later") && caption.contains("line: swings together"),
            "{caption}"
        );
    }
}
