//! The scan over friction: the long ARX's loss for many elements, with all products kept that no stem enters.

use super::fit::FLOOR;
use super::model::{Data, Element, Spec, Stage};
use super::regress::{LONG_Y, Quick, long_lags};
use crate::diagnosis::friction::reversals;
use crate::diagnosis::linalg::{MOST_COLUMNS, dot, factor, substitute};

/// Fewest reversals of the stem in the fitted samples that say anything about f.
pub const LEAST_REVERSALS: usize = 5;

/// Rates elements with the terms of a model in place.
pub struct Scan<'a> {
    data: &'a Data,
    /// The model with the element on trial.
    pub trial: Spec,
    stage: Stage,
    z_lags: Vec<usize>,
    /// Samples that do not count: then nothing is shared.
    masked: bool,
    /// Lower triangle of the products of y lags, 1 and shapes, rows of [`MOST_COLUMNS`].
    gram: Vec<f64>,
    right: Vec<f64>,
    power: f64,
    /// Columns of which the products are kept.
    fixed: usize,
    work: Vec<f64>,
}

impl<'a> Scan<'a> {
    /// For elements in place of `spec`'s.
    pub fn new(data: &'a Data, spec: &Spec) -> Self {
        let (stage, _) = spec.stage(data);
        let (from, to) = (data.first, data.split);
        let z_lags = long_lags(data, spec.orders.nk);
        let ones = vec![1.0; to - from];
        let mut columns: Vec<&[f64]> = (1..=LONG_Y).map(|lag| &stage.y[from - lag..to - lag]).collect();
        columns.push(&ones);
        columns.extend(stage.columns.iter().map(|c| &c[from..to]));
        columns.truncate(MOST_COLUMNS - 24);
        let target = &stage.y[from..to];
        let mut gram = vec![0.0; MOST_COLUMNS * MOST_COLUMNS];
        for (i, a) in columns.iter().enumerate() {
            for (j, b) in columns[..=i].iter().enumerate() {
                gram[i * MOST_COLUMNS + j] = dot(a, b);
            }
        }
        let right: Vec<f64> = columns.iter().map(|c| dot(c, target)).collect();
        let (fixed, power) = (columns.len(), dot(target, target));
        let masked = stage.weight[from..to].contains(&0.0);
        let (trial, work) = (spec.clone(), vec![0.0; MOST_COLUMNS * MOST_COLUMNS]);
        Self { data, trial, stage, z_lags, masked, gram, right, power, fixed, work }
    }

    /// The long ARX's loss with the element; `None` where the stem hardly reverses.
    pub fn rate(&mut self, element: Element) -> Option<f64> {
        self.trial.element = element;
        let mut stage = std::mem::take(&mut self.stage);
        self.trial.restem(self.data, &stage.u[..self.data.split], &mut stage.z, &mut stage.dir);
        let (from, to) = (self.data.first, self.data.split);
        let loss = (reversals(&stage.dir[from..to]) >= LEAST_REVERSALS).then(|| {
            if self.masked {
                Quick::long_arx(self.data, &stage, self.trial.orders.nk).loss
            } else {
                self.loss(&stage)
            }
        });
        self.stage = stage;
        loss
    }

    fn loss(&mut self, stage: &Stage) -> f64 {
        let (from, to, fixed) = (self.data.first, self.data.split, self.fixed);
        let (y, z) = (&stage.y, &stage.z);
        let size = fixed + self.z_lags.len();
        let g = &mut self.work;
        for i in 0..fixed {
            g[i * size..i * size + i + 1].copy_from_slice(&self.gram[i * MOST_COLUMNS..][..i + 1]);
        }
        let mut right = self.right.clone();
        // The last row's products of z with y, from lag 0 on.
        let mut with_y = [0.0; LONG_Y + 1];
        for (i, &lag) in self.z_lags.iter().enumerate() {
            let own = &z[from - lag..to - lag];
            let row = (fixed + i) * size;
            let previous = with_y;
            for l in 0..=LONG_Y {
                with_y[l] = if i > 0 && l > 0 {
                    // Neighbours one lag further on share all but two of their products.
                    previous[l - 1] + z[from - lag] * y[from - l] - z[to - lag] * y[to - l]
                } else {
                    dot(own, &y[from - l..to - l])
                };
            }
            g[row..row + LONG_Y].copy_from_slice(&with_y[1..]);
            g[row + LONG_Y] =
                if i > 0 { g[row - size + LONG_Y] + z[from - lag] - z[to - lag] } else { own.iter().sum() };
            for (slot, column) in g[row + LONG_Y + 1..row + fixed].iter_mut().zip(&stage.columns) {
                *slot = dot(own, &column[from..to]);
            }
            for (j, &other) in self.z_lags[..=i].iter().enumerate() {
                g[row + fixed + j] = if j > 0 {
                    g[row - size + fixed + j - 1] + z[from - lag] * z[from - other]
                        - z[to - lag] * z[to - other]
                } else {
                    dot(own, &z[from - other..to - other])
                };
            }
            right.push(with_y[0]);
        }
        let mut live = [true; MOST_COLUMNS];
        factor(g, size, size, &mut live);
        let mut theta = right.clone();
        substitute(g, size, &live, &mut theta);
        (self.power - dot(&right, &theta)).max(0.0) / (to - from) as f64 + FLOOR
    }
}

/// Valves tried in a scan: lag, resume threshold, slips. J = S of the one-parameter element, Choudhury's and He's for
/// some J, and lags that make up for what the model lacks.
const VALVES: [(f64, f64, bool); 9] = [
    (0.0, 0.0, false),
    (0.4, 0.0, false),
    (0.8, 0.0, false),
    (0.0, 1.0, false),
    (0.4, 0.6, false),
    (0.7, 0.3, false),
    (0.2, 0.8, true),
    (0.5, 0.5, true),
    (0.8, 0.2, true),
];

/// Friction scanned with the terms in place: the long ARX's loss over f, its lag and its resume threshold; `kept`: the
/// model's own kind of valve alone.
///
/// Returns the best elements, by increasing loss, each from a different neighbourhood of f.
pub fn scan_friction(data: &Data, spec: &Spec, values: usize, most: usize, kept: bool) -> Vec<Element> {
    let mut scan = Scan::new(data, spec);
    let mut rated: Vec<(f64, Element)> = Vec::new();
    let mut rate = |element: Element, rated: &mut Vec<(f64, Element)>| {
        rated.extend(scan.rate(element).map(|loss| (loss, element)));
    };
    let step = data.f_top / values as f64;
    let own = spec.element;
    let valves: Vec<(f64, f64, bool)> =
        if kept { [0.0, 0.4, 0.8].map(|lag| (lag, own.resume, own.slips)).to_vec() } else { VALVES.to_vec() };
    for i in 1..=values {
        // Finer towards 0: weak friction is a small share of the largest swing.
        let f = data.f_top * (i as f64 / values as f64).powf(1.5);
        for &(lag, resume, slips) in &valves {
            rate(Element { f, lag, resume, slips, ..own }, &mut rated);
        }
    }
    rated.sort_by(|a, b| a.0.total_cmp(&b.0));
    let coarse: Vec<Element> = rated.iter().take(2).map(|r| r.1).collect();
    for centre in coarse {
        for i in -4i32..=4 {
            let f = centre.f + step * 0.25 * f64::from(i);
            for lag in [centre.lag, centre.lag + 0.2, centre.lag - 0.2] {
                if f > 0.0 && (0.0..=1.0).contains(&lag) {
                    rate(Element { f, lag, ..centre }, &mut rated);
                }
            }
        }
    }
    rated.sort_by(|a, b| a.0.total_cmp(&b.0));
    if let Some((_, centre)) = rated.first().copied() {
        // Reversals late by a sample cost a strong valve more than all else.
        for i in (-5i32..=5).filter(|i| *i != 0) {
            let f = centre.f + step * 0.04 * f64::from(i);
            rate(Element { f: f.max(0.1 * centre.f), ..centre }, &mut rated);
        }
        for resume in [centre.resume + 0.15, centre.resume - 0.15] {
            if centre.resume > 0.0 && (0.01..=1.0).contains(&resume) {
                rate(Element { resume, ..centre }, &mut rated);
            }
        }
    }
    rated.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut kept: Vec<Element> = Vec::new();
    for (_, element) in rated {
        let near = |k: &Element| {
            (k.f - element.f).abs() < 0.1 * step && k.resume == element.resume && k.slips == element.slips
        };
        if !kept.iter().any(near) {
            kept.push(element);
        }
        if kept.len() == most {
            break;
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::pose::{declared, pose};
    use crate::signal::Window;

    #[test]
    fn shared_products_are_the_plain_ones() {
        let n = 700;
        let op: Vec<f64> =
            (0..n).map(|k| 50.0 + (0.21 * k as f64).sin() + (0.047 * k as f64).cos()).collect();
        let mut pv = vec![0.0; n];
        for k in 2..n {
            pv[k] = 0.8 * pv[k - 1] + 0.3 * (op[k - 2] - 50.0) + 0.05 * (1.7 * (k * k) as f64).sin();
        }
        let window = Window { t0: 0.0, ts: 1.0, op, pv, sp: None, mv: None, tags: Vec::new() };
        let data = pose(&window).expect("long enough");
        let spec = declared(&data, 0.0);
        let mut scan = Scan::new(&data, &spec);
        for (f, lag) in [(0.05, 0.0), (0.3, 0.5), (0.6, 1.0)] {
            let element = Element { f, lag, ..Element::default() };
            let mut other = spec.clone();
            other.element = element;
            let plain = Quick::long_arx(&data, &other.stage(&data).0, spec.orders.nk).loss;
            let shared = scan.rate(element).expect("the stem reverses");
            // Products one lag on are sums of other roundings.
            assert!((shared / plain - 1.0).abs() < 1e-8, "{shared} {plain}");
        }
    }
}
