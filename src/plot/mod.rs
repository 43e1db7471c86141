//! Plots as SVG, light and dark by what the viewer prefers: panels over a common axis, and sheets of several plots.

mod svg;

pub use svg::draw;

/// The rules of the plots' classes, in the colours that the page or picture around them sets.
pub const STYLE: &str = "svg text { fill: var(--faint); font: 11px system-ui, sans-serif; }
svg .axis { stroke: var(--rule); fill: none; } svg polyline { fill: none; stroke-width: 1.3; stroke-linejoin: round; stroke-linecap: round; }
svg .op { stroke: var(--op); } svg .pv { stroke: var(--pv); } svg .other { stroke: var(--other); }
svg .sp { stroke: var(--sp); stroke-dasharray: 5 3; } svg .mark { stroke: var(--look); stroke-dasharray: 2 3; }
svg text.op { fill: var(--op); stroke: none; } svg text.pv { fill: var(--pv); stroke: none; }
svg text.sp { fill: var(--sp); stroke: none; } svg text.other { fill: var(--other); stroke: none; }
svg text.look { fill: var(--look); } svg .bad { fill: var(--other); opacity: .35; } svg text.bad { opacity: 1; }
";
/// The colours, light and dark.
pub const COLOURS: &str = ":root { color-scheme: light dark; --ground: #f4f4f4; --sheet: #fff; --ink: #222; --faint: #666; --rule: #ccc;
  --look: #b3261e; --op: #1f5fa8; --pv: #222; --sp: #8a8a8a; --other: #b06a00; }
@media (prefers-color-scheme: dark) { :root { --ground: #161616; --sheet: #202020; --ink: #ddd; --faint: #999; --rule: #444;
  --look: #ff7a70; --op: #6fa8e8; --pv: #ddd; --sp: #888; --other: #e0a840; } }
";

/// A plot: panels over one x axis, from top to bottom.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plot {
    /// Caption.
    pub title: String,
    /// The x axis with its unit.
    pub x: &'static str,
    /// Panels.
    pub panels: Vec<Panel>,
    /// Vertical marks, (x, what).
    pub marks: Vec<(f64, &'static str)>,
}

/// One panel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Panel {
    /// The y axis with its unit.
    pub y: &'static str,
    /// Decades instead of a linear axis.
    pub log: bool,
    /// Curves.
    pub series: Vec<Series>,
}

/// One curve.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Series {
    /// Legend.
    pub name: String,
    /// `op`, `pv`, `sp` or `other`: its colour. `bad`: its points are places on x, which are shaded.
    pub class: &'static str,
    /// The points by increasing x; where y is no number the curve is interrupted.
    pub points: Vec<(f64, f64)>,
}

/// At most `2 * most` of the points: the least and the largest of each stretch, so that no swing is lost.
pub fn thin(points: &[(f64, f64)], most: usize) -> Vec<(f64, f64)> {
    if points.len() <= 2 * most {
        return points.to_vec();
    }
    let mut kept = Vec::with_capacity(2 * most);
    for stretch in points.chunks(points.len().div_ceil(most)) {
        let by = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
        if let (Some(&low), Some(&high)) = (stretch.iter().min_by(by), stretch.iter().max_by(by)) {
            let (first, second) = if low.0 <= high.0 { (low, high) } else { (high, low) };
            kept.push(first);
            if second.0 > first.0 {
                kept.push(second);
            }
        }
    }
    kept
}

/// Text for HTML and SVG.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Several plots below each other as one picture that stands alone, each under its title.
pub fn sheet(plots: &[Plot]) -> String {
    const TITLE: f64 = 24.0;
    let heights: Vec<f64> = plots.iter().map(|plot| svg::height(plot) + TITLE).collect();
    let height: f64 = heights.iter().sum::<f64>() + 8.0;
    let width = svg::WIDTH;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{}\" height=\"{}\">\
         <style>{COLOURS}{STYLE}svg text.title {{ fill: var(--ink); font-size: 13px; }}</style>\
         <rect width=\"100%\" height=\"100%\" style=\"fill: var(--sheet)\"/>",
        1.6 * width,
        1.6 * height
    );
    let mut top = 0.0;
    for (plot, height) in plots.iter().zip(&heights) {
        out += &format!("<text class=\"title\" x=\"8\" y=\"{}\">{}</text>", top + 16.0, escape(&plot.title));
        out += &format!("<g transform=\"translate(0 {})\">{}</g>", top + TITLE, svg::inside(plot));
        top += height;
    }
    out + "</svg>\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thinning_keeps_every_swing() {
        let points: Vec<(f64, f64)> =
            (0..1000).map(|k| (f64::from(k), if k == 577 { 9.0 } else { f64::from(k % 3) })).collect();
        let thinned = thin(&points, 50);
        assert!(thinned.len() <= 100 && thinned.contains(&(577.0, 9.0)));
        assert!(thinned.windows(2).all(|p| p[0].0 < p[1].0));
        assert_eq!(thin(&points[..80], 50), points[..80]);
    }

    #[test]
    fn a_sheet_stands_alone_and_escapes_what_it_is_given() {
        let series = Series { name: "<b>".into(), class: "pv", points: vec![(0.0, 1.0), (1.0, 2.0)] };
        let plot = Plot {
            title: "a & b".into(),
            x: "time (s)",
            panels: vec![Panel { y: "PV", log: false, series: vec![series] }],
            marks: vec![],
        };
        let sheet = sheet(&[plot.clone(), plot]);
        assert!(
            sheet.starts_with("<svg xmlns=") && sheet.contains("a &amp; b") && sheet.contains("&lt;b&gt;")
        );
        assert_eq!(sheet.matches("<svg").count(), 1);
        assert_eq!(sheet.matches("<polyline").count(), 2);
    }
}
