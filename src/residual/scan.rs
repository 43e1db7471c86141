//! The scan over friction: the long ARX's loss for many elements, with all products kept that no stem enters.

use super::fit::FLOOR;
use super::lanes::{LANES, Lane, Run};
use super::model::{Data, Element, Spec, Stage};
use super::regress::{LONG_Y, Quick, long_lags};
use super::search::{Reach, settle};
use crate::sysid::gram::{lower, products};
use crate::sysid::least_squares::{MOST_COLUMNS, dot, factor, factor_rows, substitute};
use std::array::from_fn;

/// Fewest reversals of the stem in the fitted samples that say anything about f.
pub const LEAST_REVERSALS: usize = 5;

/// A sine and the cosine after it among the shapes, and by how much they turn from one sample to the next.
struct Wave {
    at: usize,
    turn: (f64, f64),
}

/// Those of the terms, `counts` their shapes.
fn waves(spec: &Spec, counts: &[usize]) -> Vec<Wave> {
    let mut found = Vec::new();
    let mut first = 0;
    for (term, count) in spec.terms.iter().zip(counts) {
        let waves = term.waves().into_iter().enumerate();
        found.extend(waves.map(|(i, w)| Wave { at: first + 2 * i, turn: w.sin_cos() }));
        first += count;
    }
    found
}

/// Rates elements with the terms of a model in place.
pub struct Scan<'a> {
    data: &'a Data,
    /// The model with the element on trial.
    trial: Spec,
    stage: Stage,
    z_lags: Vec<usize>,
    /// Samples that do not count: then nothing is shared.
    masked: bool,
    /// Products of y lags, 1 and shapes, rows of `fixed`, factored; and the columns that do not depend on those before them.
    gram: Vec<f64>,
    live: [bool; MOST_COLUMNS],
    right: Vec<f64>,
    power: f64,
    /// Columns of which the products are kept.
    fixed: usize,
    /// Waves among the shapes, and the shapes that are of none.
    waves: Vec<Wave>,
    alone: Vec<usize>,
    work: Vec<f64>,
    stems: Vec<Lane>,
    /// Fewest reversals of a stem that is rated.
    least_turns: usize,
    ones: Vec<f64>,
}

impl<'a> Scan<'a> {
    /// For elements in place of `spec`'s.
    pub fn new(data: &'a Data, spec: &Spec) -> Self {
        Self::of_lags(data, spec, long_lags(data, spec.orders.nk), LEAST_REVERSALS)
    }

    /// The same with these lags of z, for stems that reverse so often at least.
    pub fn of_lags(data: &'a Data, spec: &Spec, z_lags: Vec<usize>, least_turns: usize) -> Self {
        let (stage, counts) = spec.stage(data);
        let (from, to) = (data.first, data.split);
        let ones = vec![1.0; to - from];
        let mut columns: Vec<&[f64]> = (1..=LONG_Y).map(|lag| &stage.y[from - lag..to - lag]).collect();
        columns.push(&ones);
        columns.extend(stage.columns.iter().map(|c| &c[from..to]));
        columns.truncate(MOST_COLUMNS - 24);
        let target = &stage.y[from..to];
        let (fixed, power) = (columns.len(), dot(target, target));
        let (mut gram, mut right) = (vec![0.0; fixed * fixed], vec![0.0; fixed]);
        lower(&columns, &mut gram, fixed);
        products(&[target], &columns, |_, i, sum| right[i] = sum);
        let mut live = [true; MOST_COLUMNS];
        factor(&mut gram, fixed, fixed, &mut live);
        let masked = stage.weight[from..to].contains(&0.0);
        let size = fixed + z_lags.len();
        let shapes = fixed - LONG_Y - 1;
        let mut waves = waves(spec, &counts);
        waves.retain(|wave| wave.at + 1 < shapes);
        let of_wave = |c: &usize| waves.iter().any(|wave| wave.at == *c || wave.at + 1 == *c);
        let alone = (0..shapes).filter(|c| !of_wave(c)).collect();
        let (trial, work) = (spec.clone(), vec![0.0; size * size]);
        Self {
            data,
            trial,
            stage,
            z_lags,
            masked,
            gram,
            live,
            right,
            power,
            fixed,
            waves,
            alone,
            work,
            stems: Vec::new(),
            least_turns,
            ones,
        }
    }

    /// Sets the first knob of the last term.
    pub fn set_last(&mut self, value: f64) {
        if let Some(last) = self.trial.terms.last_mut() {
            last.set(0, value);
        }
    }

    /// The long ARX's loss with each element; `None` where the stem hardly reverses.
    pub fn rate(&mut self, elements: &[Element]) -> Vec<Option<f64>> {
        elements.chunks(LANES).flat_map(|few| self.rate_few(few).into_iter().take(few.len())).collect()
    }

    /// The loss without friction.
    fn sound(&mut self) -> f64 {
        let mut stage = std::mem::take(&mut self.stage);
        stage.z.clear();
        stage.z.extend_from_slice(&stage.u[..self.data.split]);
        let loss = self.behind(&mut stage);
        self.stage = stage;
        loss
    }

    /// As many as go side by side.
    fn rate_few(&mut self, elements: &[Element]) -> [Option<f64>; LANES] {
        let Some(&last) = elements.last() else { return [None; LANES] };
        let (data, to) = (self.data, self.data.split);
        let full = from_fn(|l| {
            self.trial.element = elements.get(l).copied().unwrap_or(last);
            self.trial.full_element()
        });
        let mut run = Run::new(&full, data.start, data.first, to);
        let mut stems = std::mem::take(&mut self.stems);
        stems.resize(to, [0.0; LANES]);
        run.go_on(&self.stage.u, to, &mut stems);
        let turns = run.turns();
        let mut stage = std::mem::take(&mut self.stage);
        let losses = from_fn(|l| {
            if l >= elements.len() || turns[l] < self.least_turns as f64 {
                return None;
            }
            stage.z.clear();
            stage.z.extend(stems.iter().map(|z| z[l]));
            Some(self.behind(&mut stage))
        });
        self.stage = stage;
        self.stems = stems;
        losses
    }

    /// The loss behind a stem, once the terms have changed it.
    fn behind(&mut self, stage: &mut Stage) -> f64 {
        self.trial.terms.iter().for_each(|term| term.stem(self.data, &mut stage.z));
        if self.masked {
            let y_lags: Vec<usize> = (1..=LONG_Y).collect();
            Quick::new(self.data, stage, &y_lags, &self.z_lags).loss
        } else {
            self.loss(stage)
        }
    }

    fn loss(&mut self, stage: &Stage) -> f64 {
        let (from, to, fixed) = (self.data.first, self.data.split, self.fixed);
        let (y, z) = (&stage.y, &stage.z);
        let size = fixed + self.z_lags.len();
        let g = &mut self.work;
        for i in 0..fixed {
            g[i * size..i * size + i + 1].copy_from_slice(&self.gram[i * fixed..][..i + 1]);
        }
        let mut right = self.right.clone();
        let y_lags: [&[f64]; LONG_Y] = from_fn(|l| &y[from - 1 - l..to - 1 - l]);
        let late: Vec<&[f64]> = self.z_lags.iter().map(|lag| &z[from - lag..to - lag]).collect();
        let (shapes, on) = (&stage.columns[..fixed - LONG_Y - 1], LONG_Y + 1);
        let (waves, alone) = (&self.waves, &self.alone);
        // With PV, the stem at the first lag and shapes that are of no wave; all else of a lag but the first follows from the one before.
        let mut others: Vec<&[f64]> = vec![&y[from..to]];
        others.extend(late.first());
        others.extend(alone.iter().map(|c| &shapes[*c][from..to]));
        right.resize(size, 0.0);
        products(&late, &others, |i, j, sum| match j {
            0 => right[fixed + i] = sum,
            1 => g[(fixed + i) * size + fixed] = sum,
            _ => g[(fixed + i) * size + on + alone[j - 2]] = sum,
        });
        let mut once: Vec<&[f64]> = y_lags.to_vec();
        once.push(&self.ones);
        once.extend(waves.iter().flat_map(|wave| [wave.at, wave.at + 1]).map(|c| &shapes[c][from..to]));
        products(&late[..1.min(late.len())], &once, |_, j, sum| {
            let column = j.checked_sub(on).map_or(j, |j| on + waves[j / 2].at + j % 2);
            g[fixed * size + column] = sum;
        });
        for (i, &lag) in self.z_lags.iter().enumerate().skip(1) {
            let row = (fixed + i) * size;
            let [enters, leaves] = [from, to].map(|k| z[k - lag]);
            for l in 1..=LONG_Y {
                let previous = if l == 1 { right[fixed + i - 1] } else { g[row - size + l - 2] };
                g[row + l - 1] = previous + enters * y[from - l] - leaves * y[to - l];
            }
            g[row + LONG_Y] = g[row - size + LONG_Y] + enters - leaves;
            for Wave { at, turn: (sin, cos) } in waves {
                // A sample later the wave has turned.
                let [s, c] = [*at, at + 1].map(|at| {
                    g[row - size + on + at] + enters * shapes[at][from - 1] - leaves * shapes[at][to - 1]
                });
                (g[row + on + at], g[row + on + at + 1]) = (s * cos + c * sin, c * cos - s * sin);
            }
            for (j, &other) in self.z_lags[..=i].iter().enumerate().skip(1) {
                g[row + fixed + j] =
                    g[row - size + fixed + j - 1] + enters * z[from - other] - leaves * z[to - other];
            }
        }
        let mut live = self.live;
        factor_rows(g, size, fixed..size, &mut live);
        let mut theta = right.clone();
        substitute(g, size, &live, &mut theta);
        (self.power - dot(&right, &theta)).max(0.0) / (to - from) as f64 + FLOOR
    }
}

/// Kinds of valve whose best is polished.
const LIKELY: usize = 2;
/// Gain of the long ARX over that without friction below which a closer search finds none that is worth its numbers (-).
const PROMISING: f64 = 10.0;
/// Turns of the close search.
const TURNS: usize = 2;

/// Valves tried in a scan: lag, resume threshold, slips. J = S of the one-parameter element, Choudhury's and He's for
/// some J, and lags that make up for what the model lacks.
const VALVES: [(f64, f64, bool); 12] = [
    (0.0, 0.0, false),
    (0.4, 0.0, false),
    (0.8, 0.0, false),
    (-0.5, 0.0, false),
    (-0.5, 1.5, false),
    (0.0, 1.0, false),
    (0.4, 0.6, false),
    (0.7, 0.3, false),
    (0.0, 1.0, true),
    (0.2, 0.8, true),
    (0.5, 0.5, true),
    (0.8, 0.2, true),
];

/// What a scan over friction found.
pub struct Scanned {
    /// The best elements, by increasing loss, each of a kind of its own.
    pub best: Vec<Element>,
    /// Gain of the long ARX over that without friction (-).
    pub gain: f64,
    /// Whether they promise anything.
    pub promising: bool,
    /// The best of each family, not sought closely.
    pub of_family: Vec<Element>,
}

/// Friction scanned with the terms in place: the long ARX's loss over f, its lag and its resume threshold; `kept`: from
/// the model's own kind of valve on.
pub fn scan_friction(data: &Data, spec: &Spec, values: usize, kept: bool) -> Scanned {
    let mut scan = Scan::new(data, spec);
    let step = data.f_top / values as f64;
    let own = spec.element;
    let lags = if own.lag < 0.0 { [0.0, -0.3, -0.6] } else { [0.0, 0.4, 0.8] };
    let valves: Vec<(f64, f64, bool)> =
        if kept { lags.map(|lag| (lag, own.resume, own.slips)).to_vec() } else { VALVES.to_vec() };
    let mut best: Vec<(f64, Element)> = Vec::new();
    for (lag, resume, slips) in valves {
        // Finer towards 0: weak friction is a small share of the largest swing.
        let coarse = (1..=values).map(|i| data.f_top * (i as f64 / values as f64).powf(1.5));
        let coarse = coarse.map(|f| Element { f, lag, resume, slips, ..own });
        let Some(found) = scan.least(coarse) else { continue };
        let near = (-4i32..=4).map(|i| Element { f: found.1.f + step * 0.25 * f64::from(i), ..found.1 });
        let found = scan.better(found, near);
        // Reversals late by a sample cost a strong valve more than all else.
        let near = (-5i32..=5).map(|i| Element { f: found.1.f + step * 0.04 * f64::from(i), ..found.1 });
        best.push(scan.better(found, near));
    }
    let by_loss = |a: &(f64, Element), b: &(f64, Element)| a.0.total_cmp(&b.0);
    best.sort_by(by_loss);
    let rows = (data.split - data.first) as f64;
    let gain = best.first().map_or(0.0, |found| rows * (scan.sound() / found.0).ln());
    let promising = own.f > 0.0 || gain > PROMISING;
    let reach = if kept { Reach::Near } else { Reach::Wide };
    let mut of_family: Vec<Element> = best.iter().map(|found| found.1).collect();
    of_family.sort_by_key(family);
    of_family.dedup_by_key(|element| family(element));
    if kept {
        best.truncate(1);
    } else {
        // One that slips beyond OP has to lead, and never goes alone: with a smaller f it looks like one that does not.
        let leads = best.first().copied().filter(|found| found.1.lag < 0.0);
        best.retain(|found| found.1.lag >= 0.0);
        best.truncate(LIKELY - usize::from(leads.is_some()));
        best.extend(leads);
    }
    if promising {
        best.iter_mut().for_each(|found| scan.settle(found, reach));
    }
    best.sort_by(by_loss);
    // Those that came to the same valve are one.
    best.dedup_by(|b, a| {
        a.1.slips == b.1.slips && (a.1.resume - b.1.resume).abs() < 0.1 && (a.1.f / b.1.f - 1.0).abs() < 0.01
    });
    Scanned { best: best.into_iter().map(|found| found.1).collect(), gain, promising, of_family }
}

/// Plain, sticking at stops, slipping, or slipping with J = S.
fn family(element: &Element) -> (bool, bool, bool) {
    (element.slips, element.resume > 0.0, element.slips && element.resume == 1.0)
}

impl Scan<'_> {
    /// The element with the least loss.
    fn least(&mut self, elements: impl Iterator<Item = Element>) -> Option<(f64, Element)> {
        let elements: Vec<Element> = elements.filter(|e| e.f > 0.0 && e.is_valve()).collect();
        let rated = self.rate(&elements).into_iter().zip(elements);
        rated.filter_map(|(loss, element)| Some((loss?, element))).min_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// Sought closely, by turns with the lag and the kind of valve: dynamics that are held hold on to those.
    fn settle(&mut self, found: &mut (f64, Element), mut reach: Reach) {
        for _ in 0..if reach == Reach::Wide { TURNS } else { 1 } {
            let (settled, _) = settle(self.data, &self.trial, found.1, None, reach);
            let Some(loss) = self.rate(&[settled])[0] else { return };
            let lags = |c: Element, step: f64| {
                (-10..=10).map(move |i| Element { lag: c.lag + step * f64::from(i), ..c })
            };
            let kinds = (1..=5).flat_map(|i| [false, true].map(|slips| (0.2 * f64::from(i), slips)));
            let kinds = kinds.map(|(resume, slips)| Element { lag: 1.0 - resume, resume, slips, ..settled });
            let better = self.better((loss, settled), kinds.chain(lags(settled, 0.1)));
            let better = self.better(better, lags(better.1, 0.01));
            let done = better.1 == settled;
            *found = better;
            if done {
                return;
            }
            reach = Reach::Near;
        }
    }

    fn better(&mut self, found: (f64, Element), others: impl Iterator<Item = Element>) -> (f64, Element) {
        self.least(others).filter(|other| other.0 < found.0).unwrap_or(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::model::{Linear, Term};
    use crate::residual::pose::declared;
    use crate::residual::pose::tests::first_order;
    use crate::residual::{Kind, Parameter};

    /// Two shapes, or the waves of so many frequencies; and whether it says so.
    #[derive(Clone, Debug)]
    struct Shapes(Vec<f64>, bool);

    impl Term for Shapes {
        fn kind(&self) -> Kind {
            Kind::LoadStep
        }
        fn boxed(&self) -> Box<dyn Term> {
            Box::new(self.clone())
        }
        fn waves(&self) -> Vec<f64> {
            if self.1 { self.0.clone() } else { Vec::new() }
        }
        fn columns(&self, data: &Data, _stage: &Stage, out: &mut Vec<Vec<f64>>) {
            let n = data.len();
            for w in &self.0 {
                out.push((0..n).map(|k| (w * k as f64).sin()).collect());
                out.push((0..n).map(|k| (w * k as f64).cos()).collect());
            }
            if !self.0.is_empty() {
                return;
            }
            out.push((0..n).map(|k| f64::from(u8::from(k >= 300))).collect());
            out.push((0..n).map(|k| (0.003 * (k * k) as f64).sin()).collect());
        }
        fn describe(&self, _data: &Data, _gamma: &[f64], _linear: &Linear) -> (Vec<Parameter>, String) {
            Default::default()
        }
    }

    #[test]
    fn shared_products_are_the_plain_ones() {
        let data = first_order(700);
        let spec = declared(&data, 0.0);
        let beside = |waves: &[&[f64]], told: bool| {
            let terms = waves.iter().map(|waves| Shapes(waves.to_vec(), told).boxed()).collect();
            Spec { terms, ..spec.clone() }
        };
        let slow_and_fast: &[f64] = &[0.01, 0.9];
        // More than a system holds: the last wave that is left has lost its cosine.
        let many: Vec<f64> = (1..=60).map(|i| 0.05 * f64::from(i)).collect();
        let shapes: [&[&[f64]]; 5] =
            [&[], &[&[]], &[slow_and_fast], &[&[], slow_and_fast, &[], &[2.7]], &[&[], &many]];
        for shapes in shapes {
            let mut scan = Scan::new(&data, &beside(shapes, true));
            let mut untold = Scan::new(&data, &beside(shapes, false));
            assert_eq!(scan.waves.len(), shapes.concat().len().min(47));
            for (f, lag) in [(0.05, 0.0), (0.3, 0.5), (0.6, 1.0)] {
                let element = Element { f, lag, ..Element::default() };
                let shared = scan.rate(&[element])[0].expect("the stem reverses");
                let plain = if shapes.concat().len() > 40 {
                    untold.rate(&[element])[0].expect("the stem reverses")
                } else {
                    let other = Spec { element, ..beside(shapes, false) };
                    Quick::long_arx(&data, &other.stage(&data).0, spec.orders.nk).loss
                };
                // Products one lag on are sums of other roundings.
                assert!((shared / plain - 1.0).abs() < 1e-8, "{shared} {plain}");
            }
        }
    }
}
