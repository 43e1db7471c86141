//! What a published method looked at, as JSON: pictures of numbers, which the dashboard draws.

use super::report::{Report, ReportOpinion};
use super::{finite, rfc3339};
use crate::detectors::picture::{Axis, Layer, Mark};
use crate::detectors::{Facts, Method, Picture, picture};
use crate::results::Known;
use serde::Serialize;
use utoipa::ToSchema;

/// What one method says of a loop, and what it looked at.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct LoopOpinion {
    /// The loop's name.
    pub r#loop: String,
    /// When the diagnosis was made.
    pub time: Option<String>,
    /// What it says; null where the diagnosis had no window.
    pub opinion: Option<ReportOpinion>,
    /// What it looked at; empty where it does not apply, and for a diagnosis of before the start.
    pub pictures: Vec<OpinionPicture>,
}

/// A picture: layers over two axes.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct OpinionPicture {
    /// What it shows, in a line.
    pub title: String,
    /// To the right.
    pub x: PictureAxis,
    /// Upwards.
    pub y: PictureAxis,
    /// From back to front.
    pub layers: Vec<PictureLayer>,
}

/// An axis.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct PictureAxis {
    /// What it is, with its unit.
    pub label: String,
    /// Its lower end.
    pub from: Option<f64>,
    /// Its upper end.
    pub to: Option<f64>,
}

/// Marks of one meaning.
#[derive(Clone, Debug, Default, Serialize, ToSchema)]
pub struct PictureLayer {
    /// What they are.
    pub name: String,
    /// What they stand for: `data`, `beside`, `sticks`, `sound`, `mark`.
    pub tone: &'static str,
    /// `line`, `dots`, `bars`, `level`, `upright` or `cells`.
    pub mark: &'static str,
    /// Of a line, of dots, of bars: along x.
    pub x: Vec<Option<f64>>,
    /// … along y.
    pub y: Vec<Option<f64>>,
    /// Of a level or an upright: where it is. Null for others.
    pub at: Option<f64>,
    /// Width of a bar, or width and height of a cell.
    pub size: Vec<Option<f64>>,
    /// Lower left corner of the first cell.
    pub from: Vec<Option<f64>>,
    /// Cells in a row.
    pub columns: usize,
    /// Cells row by row from below, 0 to 1; null where there is none.
    pub values: Vec<Option<f64>>,
}

impl LoopOpinion {
    /// What a method says in the latest diagnosis of a loop, and what it looked at; `None` before the first diagnosis.
    pub fn latest(known: &Known, method: Method) -> Option<Self> {
        let named =
            |report: &Report| report.opinions.iter().find(|own| own.method == method.as_str()).cloned();
        if let Some(run) = &known.diagnosed {
            let report = Report::of(run)?;
            let diagnosis = &run.judged()?.diagnosis;
            let window = diagnosis.shown_window().filter(|window| !window.is_empty());
            let integrates = run.basis.as_ref().and_then(|basis| basis.integrates);
            let facts = window.as_deref().and_then(|window| Facts::new(window, integrates).ok());
            let facts = facts.map(|facts| facts.with_verdict(&diagnosis.verdict));
            let pictures = facts.map(|facts| picture(method, &facts)).unwrap_or_default();
            return Some(Self {
                time: rfc3339(run.finished),
                opinion: named(&report),
                pictures: pictures.iter().map(OpinionPicture::from).collect(),
                r#loop: report.r#loop,
            });
        }
        let restored = known.restored.as_ref()?;
        let report = Report::read(&restored.report)?;
        let (time, opinion) = (rfc3339(restored.finished), named(&report));
        Some(Self { time, opinion, pictures: Vec::new(), r#loop: report.r#loop })
    }
}

impl From<&Picture> for OpinionPicture {
    fn from(own: &Picture) -> Self {
        Self {
            title: own.title.clone(),
            x: PictureAxis::from(&own.x),
            y: PictureAxis::from(&own.y),
            layers: own.layers.iter().map(PictureLayer::from).collect(),
        }
    }
}

impl From<&Axis> for PictureAxis {
    fn from(own: &Axis) -> Self {
        Self { label: own.label.clone(), from: finite(own.from), to: finite(own.to) }
    }
}

impl From<&Layer> for PictureLayer {
    fn from(own: &Layer) -> Self {
        let layer = Self {
            name: own.name.clone(),
            tone: own.tone.as_str(),
            mark: own.mark.as_str(),
            ..Self::default()
        };
        let right = |points: &[(f64, f64)]| points.iter().map(|point| finite(point.0)).collect();
        let up = |points: &[(f64, f64)]| points.iter().map(|point| finite(point.1)).collect();
        match &own.mark {
            Mark::Line(points) | Mark::Dots(points) => Self { x: right(points), y: up(points), ..layer },
            Mark::Bars { points, width } => {
                Self { x: right(points), y: up(points), size: vec![finite(*width)], ..layer }
            }
            Mark::Level(at) | Mark::Upright(at) => Self { at: finite(*at), ..layer },
            Mark::Cells { from, size, columns, values } => Self {
                from: vec![finite(from.0), finite(from.1)],
                size: vec![finite(size.0), finite(size.1)],
                columns: *columns,
                values: values.iter().map(|value| value.and_then(finite)).collect(),
                ..layer
            },
        }
    }
}
