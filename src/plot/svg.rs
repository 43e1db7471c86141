//! Plots as SVG; the page's style sheet gives the colours.

use super::{Panel, Plot, escape};
use std::fmt::Write;

pub(super) const WIDTH: f64 = 560.0;
/// Left, right: room for the y numbers, and for half an x number.
const LEFT: f64 = 58.0;
const RIGHT: f64 = 14.0;
/// Above each panel: room for its legend.
const ABOVE: f64 = 20.0;
const PANEL: f64 = 130.0;
/// A plot of one panel only is higher.
const SINGLE: f64 = 210.0;
const BELOW: f64 = 34.0;
/// Places that are shaded are at least this wide, and those that are closer are one.
const SHADE: f64 = 2.5;

/// A linear or decadic axis from data to pixels.
struct Axis {
    low: f64,
    high: f64,
    from: f64,
    to: f64,
    log: bool,
}

impl Axis {
    fn scale(&self, value: f64) -> f64 {
        if self.log { value.max(f64::MIN_POSITIVE).log10() } else { value }
    }

    fn at(&self, value: f64) -> f64 {
        self.from + (self.to - self.from) * (self.scale(value) - self.low) / (self.high - self.low)
    }

    /// Where the numbers go, and how they read.
    fn ticks(&self, about: f64) -> Vec<(f64, String)> {
        if !self.log {
            return round(self.low, self.high, about);
        }
        let decades = self.low.ceil() as i32..=self.high.floor() as i32;
        if decades.clone().count() > 1 {
            return decades.map(|d| (10f64.powi(d), decade(d))).collect();
        }
        // Less than two powers of ten lie inside.
        let (low, high) = (10f64.powf(self.low), 10f64.powf(self.high));
        let inside: Vec<(f64, String)> = (self.low.floor() as i32..=self.high.floor() as i32)
            .flat_map(|d| [1, 2, 5].map(|m| (f64::from(m) * 10f64.powi(d), part(m, d))))
            .filter(|(value, _)| (low..=high).contains(value))
            .collect();
        if inside.len() > 1 { inside } else { round(low, high, about) }
    }
}

/// Round numbers from `low` to `high`, `about` so many.
fn round(low: f64, high: f64, about: f64) -> Vec<(f64, String)> {
    let raw = (high - low) / about;
    let power = 10f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|s| *s >= raw).unwrap_or(raw);
    let digits = (-step.log10().floor()).max(0.0) as usize;
    let first = (low / step).ceil() as i64;
    let last = (high / step + 1e-9).floor() as i64;
    (first..=last).map(|i| (i as f64 * step, format!("{:.digits$}", i as f64 * step))).collect()
}

/// A multiple of a power of ten, in digits as long as they are few.
fn part(times: u8, power: i32) -> String {
    match power {
        -3..=3 => {
            let digits = usize::try_from(-power).unwrap_or(0);
            format!("{:.digits$}", f64::from(times) * 10f64.powi(power))
        }
        _ if times == 1 => decade(power),
        _ => format!("{times}·{}", decade(power)),
    }
}

fn decade(power: i32) -> String {
    if power == 0 {
        return "1".into();
    }
    let digits: String = power
        .to_string()
        .chars()
        .map(|c| match c {
            '-' => '⁻',
            '1' => '¹',
            '2' => '²',
            '3' => '³',
            digit => char::from_u32(0x2070 + digit.to_digit(10).unwrap_or(0)).unwrap_or(digit),
        })
        .collect();
    format!("10{digits}")
}

/// Least and largest finite value, with some air; a flat curve gets a band of its own.
fn bounds(values: impl Iterator<Item = f64>, air: f64) -> (f64, f64) {
    let (low, high) = values
        .filter(|v| v.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    if low > high {
        return (0.0, 1.0);
    }
    let air = if high > low { air * (high - low) } else { 0.5 * high.abs().max(1e-3) };
    (low - air, high + air)
}

/// The plot as an `<svg>` element.
pub fn draw(plot: &Plot) -> String {
    let title = escape(&plot.title);
    let height = height(plot);
    let inside = inside(plot);
    format!("<svg viewBox=\"0 0 {WIDTH} {height}\" role=\"img\" aria-label=\"{title}\">{inside}</svg>")
}

fn panel_height(plot: &Plot) -> f64 {
    if plot.panels.len() == 1 { SINGLE } else { PANEL }
}

/// Height of a plot in its own units.
pub(super) fn height(plot: &Plot) -> f64 {
    plot.panels.len() as f64 * (ABOVE + panel_height(plot)) + BELOW
}

/// What the plot's element contains.
pub(super) fn inside(plot: &Plot) -> String {
    let panel = panel_height(plot);
    let height = height(plot);
    let all = plot.panels.iter().flat_map(|p| &p.series).flat_map(|s| s.points.iter().map(|p| p.0));
    let (low, high) = bounds(all, 0.0);
    let x = Axis { low, high, from: LEFT, to: WIDTH - RIGHT, log: false };
    let mut out = String::new();
    for (at, of) in plot.panels.iter().enumerate() {
        let top = ABOVE + at as f64 * (ABOVE + panel);
        draw_panel(&mut out, plot, of, &x, top, top + panel);
    }
    let bottom = height - BELOW;
    for (value, text) in x.ticks(6.0) {
        let at = x.at(value);
        let _ = write!(
            out,
            "<text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{text}</text>",
            bottom + 14.0
        );
    }
    let middle = 0.5 * (LEFT + WIDTH - RIGHT);
    let _ = write!(
        out,
        "<text x=\"{middle}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
        bottom + 29.0,
        escape(plot.x)
    );
    out
}

fn draw_panel(out: &mut String, plot: &Plot, panel: &Panel, x: &Axis, top: f64, bottom: f64) {
    let curves = panel.series.iter().filter(|s| s.class != "bad");
    let values = curves.flat_map(|s| s.points.iter().map(|p| p.1)).filter(|v| !panel.log || *v > 0.0);
    let (low, high) = if panel.log { bounds(values.map(f64::log10), 0.05) } else { bounds(values, 0.06) };
    let y = Axis { low, high, from: bottom, to: top, log: panel.log };
    for (value, text) in y.ticks(5.0) {
        let at = y.at(value);
        let _ = write!(
            out,
            "<path class=\"axis\" d=\"M{LEFT} {at:.1}H{}\" opacity=\".5\"/><text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{text}</text>",
            WIDTH - RIGHT,
            LEFT - 5.0,
            at + 4.0,
        );
    }
    let _ = write!(out, "<path class=\"axis\" d=\"M{LEFT} {top:.1}V{bottom:.1}H{}\"/>", WIDTH - RIGHT);
    let _ = write!(
        out,
        "<text transform=\"translate(12 {:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
        0.5 * (top + bottom),
        escape(panel.y),
    );
    for (value, what) in &plot.marks {
        let at = x.at(*value);
        let _ = write!(out, "<path class=\"mark\" d=\"M{at:.1} {top:.1}V{bottom:.1}\"/>");
        // Said once, above all of them.
        if top <= ABOVE {
            let (x, y) = (at + 4.0, top + 10.0);
            let _ = write!(out, "<text class=\"look\" x=\"{x:.1}\" y=\"{y:.1}\">{}</text>", escape(what));
        }
    }
    // Drawn from the last, so that the first lies on top.
    for series in panel.series.iter().rev() {
        if series.class == "bad" {
            shade(out, series.points.iter().map(|p| x.at(p.0)), top, bottom);
            continue;
        }
        for run in series.points.split(|p| !p.1.is_finite()).filter(|run| !run.is_empty()) {
            let _ = write!(out, "<polyline class=\"{}\" points=\"", series.class);
            // A point alone is a dot.
            let dot = run.first().filter(|_| run.len() == 1);
            for (px, py) in run.iter().chain(dot) {
                let _ = write!(out, "{:.1},{:.1} ", x.at(*px), y.at(*py).clamp(top, bottom));
            }
            out.push_str("\"/>");
        }
    }
    let mut right = WIDTH - RIGHT;
    for series in panel.series.iter().rev().filter(|s| !s.name.is_empty() && !s.points.is_empty()) {
        let _ = write!(
            out,
            "<text class=\"{}\" x=\"{right:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            series.class,
            top - 5.0,
            escape(&series.name),
        );
        right -= 12.0 + 6.0 * series.name.chars().count() as f64;
    }
}

/// Shades places on x (in pixels, increasing), those that are next to each other as one.
fn shade(out: &mut String, places: impl Iterator<Item = f64>, top: f64, bottom: f64) {
    let mut bands: Vec<[f64; 2]> = Vec::new();
    for at in places {
        match bands.last_mut() {
            Some(band) if at - band[1] <= SHADE => band[1] = at,
            _ => bands.push([at, at]),
        }
    }
    for [from, to] in bands {
        let (x, width) = (from - 0.5 * SHADE, to - from + SHADE);
        let height = bottom - top;
        let _ = write!(
            out,
            "<rect class=\"bad\" x=\"{x:.1}\" y=\"{top:.1}\" width=\"{width:.1}\" height=\"{height:.1}\"/>"
        );
    }
}

#[cfg(test)]
mod tests {
    use super::super::Series;
    use super::*;

    #[test]
    fn a_curve_is_interrupted_and_bad_places_are_shaded_without_a_say_in_the_axis() {
        let series =
            |class, points: &[(f64, f64)]| Series { name: "n".into(), class, points: points.to_vec() };
        let curve = [(0.0, 50.0), (1.0, 51.0), (2.0, f64::NAN), (3.0, 52.0), (4.0, f64::NAN), (100.0, 50.0)];
        let bad = [(2.0, 0.0), (2.1, 0.0), (60.0, 0.0)];
        let plot = Plot {
            panels: vec![Panel {
                y: "PV",
                log: false,
                series: vec![series("pv", &curve), series("bad", &bad)],
            }],
            marks: vec![(50.0, "alarm")],
            ..Plot::default()
        };
        let drawn = draw(&plot);
        assert_eq!((drawn.matches("<polyline").count(), drawn.matches("<rect").count()), (3, 2));
        assert!(!drawn.contains("NaN") && drawn.contains(">50.5<"), "the axis is the curve's: {drawn}");
    }

    #[test]
    fn ticks_are_round_and_inside() {
        let axis = Axis { low: 47.2, high: 63.9, from: 0.0, to: 100.0, log: false };
        let text: Vec<String> = axis.ticks(5.0).into_iter().map(|t| t.1).collect();
        assert_eq!(text, ["50", "55", "60"]);
        let log = Axis { low: -2.7, high: 0.1, from: 0.0, to: 100.0, log: true };
        let text: Vec<String> = log.ticks(5.0).into_iter().map(|t| t.1).collect();
        assert_eq!(text, ["10⁻²", "10⁻¹", "1"]);
    }

    #[test]
    fn an_axis_within_a_decade_has_numbers() {
        let ticks = |low: f64, high: f64| -> Vec<String> {
            let (low, high) = (low.log10(), high.log10());
            let axis = Axis { low, high, from: 0.0, to: 100.0, log: true };
            let ticks = axis.ticks(5.0);
            assert!(ticks.iter().all(|(value, _)| (-1e-9..=100.0 + 1e-9).contains(&axis.at(*value))));
            ticks.into_iter().map(|tick| tick.1).collect()
        };
        assert_eq!(ticks(0.19, 0.8), ["0.2", "0.5"]);
        assert_eq!(ticks(0.7, 25.0), ["1", "10¹"]);
        assert_eq!(ticks(0.7, 9.0), ["1", "2", "5"]);
        assert_eq!(ticks(1.9e-7, 8e-7), ["2·10⁻⁷", "5·10⁻⁷"]);
        assert_eq!(ticks(150.0, 900.0), ["200", "500"]);
        // Between two of them: as on any axis.
        assert_eq!(ticks(0.301, 0.449), ["0.35", "0.40"]);
    }

    #[test]
    fn bounds_of_nothing_and_of_a_flat_curve_have_a_width() {
        assert_eq!(bounds(std::iter::empty(), 0.1), (0.0, 1.0));
        let (low, high) = bounds([60.0, f64::NAN].into_iter(), 0.1);
        assert!(low < 60.0 && high > 60.0);
    }
}
