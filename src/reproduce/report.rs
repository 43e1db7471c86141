//! What a reproduction says, before it is rendered: sections of text, one table, plots.

/// The whole report.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// In reading order.
    pub sections: Vec<Section>,
}

/// One table or figure of the paper, or one of ours.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Section {
    /// Stable name, as in the JSON.
    pub id: &'static str,
    /// Heading.
    pub title: String,
    /// Paragraphs before the table.
    pub text: Vec<String>,
    /// The table, where there is one.
    pub table: Option<Table>,
    /// The plots.
    pub plots: Vec<Plot>,
}

/// A table: every row as long as `columns`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Key in the JSON and heading, with the unit.
    pub columns: Vec<(&'static str, &'static str)>,
    /// Rows.
    pub rows: Vec<Vec<Cell>>,
}

/// How a number is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// So many digits after the point.
    Fixed(usize),
    /// Two significant digits and a power of ten.
    Power,
}

/// One value of a table.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// Words.
    Text(String),
    /// A number of ours; `None` where it does not exist.
    Number(Option<f64>, Style),
    /// Ours and the paper's.
    Versus {
        /// Ours.
        ours: Option<f64>,
        /// The paper's.
        paper: Option<f64>,
        /// How both are written.
        style: Style,
    },
    /// The median, least and largest of several.
    Range {
        /// Least, median, largest.
        of: Option<[f64; 3]>,
        /// How they are written.
        style: Style,
    },
}

impl Cell {
    /// Words.
    pub fn text(text: impl Into<String>) -> Self {
        Cell::Text(text.into())
    }

    /// Least, median and largest of the finite `values`.
    pub fn range(values: &[f64], style: Style) -> Self {
        Cell::Range { of: spread(values), style }
    }
}

/// Least, median and largest of the finite values.
pub fn spread(values: &[f64]) -> Option<[f64; 3]> {
    let mut v: Vec<f64> = values.iter().copied().filter(|x| x.is_finite()).collect();
    v.sort_by(f64::total_cmp);
    Some([*v.first()?, v[v.len() / 2], *v.last()?])
}

/// `(ours - paper) / paper` [-]; none where the paper's number is 0 or missing.
pub fn relative(ours: Option<f64>, paper: Option<f64>) -> Option<f64> {
    match (ours, paper) {
        (Some(ours), Some(paper)) if paper != 0.0 => Some((ours - paper) / paper),
        _ => None,
    }
}

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
    /// `op`, `pv`, `sp` or `other`: its colour.
    pub class: &'static str,
    /// The points by increasing x.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spread_and_relative_by_hand() {
        assert_eq!(spread(&[3.0, f64::NAN, 1.0, 2.0]), Some([1.0, 2.0, 3.0]));
        assert_eq!(spread(&[]), None);
        assert_eq!(relative(Some(3.0), Some(2.0)), Some(0.5));
        assert_eq!(relative(Some(3.0), Some(0.0)), None);
    }

    #[test]
    fn thinning_keeps_every_swing() {
        let points: Vec<(f64, f64)> =
            (0..1000).map(|k| (f64::from(k), if k == 577 { 9.0 } else { f64::from(k % 3) })).collect();
        let thinned = thin(&points, 50);
        assert!(thinned.len() <= 100 && thinned.contains(&(577.0, 9.0)));
        assert!(thinned.windows(2).all(|p| p[0].0 < p[1].0));
        assert_eq!(thin(&points[..80], 50), points[..80]);
    }
}
