//! What a reproduction says, before it is rendered: sections of text, one table, plots.

use crate::plot::Plot;

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
}
