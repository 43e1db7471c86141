//! The friction element sought closely: dynamics held, by a loss that a few huge errors do not rule.
//!
//! ```text
//! L = sum of ln(1 + e^2 / (3 s^2)),   e = y - sum a_i y[k-i] - sum b_j z[k-j] - c0 - sum gamma_i phi_i
//! ```
//!
//! A stem that turns a sample late, or misses one turn, leaves errors far beyond the noise s, so that least squares sees no
//! difference between an element that is nearly right and one that is wrong everywhere. Here their number counts rather
//! than their size. A long ARX is estimated with the element there is, then elements are tried with its coefficients held,
//! which costs one pass over the samples each; then the ARX again.

use super::cells::{Family, Stems, Task};
use super::evidence::{Robust, System};
use super::lanes::{LANES, Lane, Run};
use super::model::{Data, Element, Spec};
use super::scan::LEAST_REVERSALS;
use multiversion::multiversion;
use std::array::from_fn;

/// Degrees of freedom of the t distribution that the errors are taken to have.
const FREEDOM: f64 = 3.0;
/// Rounds of dynamics, then element.
const ROUNDS: usize = 3;
/// Passes over an element's numbers in a round.
const MOST_PASSES: usize = 4;
/// Lags of y and of z in the ARX; those of z a multiple of four.
pub const LAGS: (usize, usize) = (10, 8);
/// Samples rated at a time.
const BLOCK: usize = 128;
/// Factors under one logarithm, and the largest that may be: their product stays finite.
pub const FACTORS: usize = 16;
pub const MOST_FACTOR: f64 = 1e18;
/// Loss behind the best up to the same sample at which an element is given up.
const FAR_BEHIND: f64 = 20.0;
/// Decrease of the loss that is worth another pass: half of it is a likelihood's.
const LEAST_LESS: f64 = 0.25;
/// Valves with bands that differ or grow that are tried.
const LIKELY: usize = 2;
/// Least S among all paths, as a share of the largest; and where it is nearly known, the factor by which it may differ.
const LEAST_S: f64 = 0.02;
const WIDELY: f64 = 1.6;
/// Bound of a knob that is part of the element.
const MOST_VALUE: f64 = 0.95;
/// Range of f that is swept for every kind of valve, as `ln`, and values to each side.
const SWEEP: (f64, i32) = (0.4, 16);
/// The same of f about its value, as shares, in the first round and later, and to its last digit.
const ABOUT: [f64; 2] = [0.12, 0.03];
const FINE: f64 = 0.004;
/// Resume threshold J/S of a valve that slips beyond OP.
const BEYOND: f64 = 1.4;
/// Steps of lag and threshold.
const STEPS: [f64; 4] = [0.2, 0.1, 0.05, 0.02];

/// How far to look.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Reach {
    /// Any kind of valve, f within half and one and a half times as much.
    Wide,
    /// About the element there is, once.
    Near,
    /// The same, the knob too: it is nearly right.
    Close,
}

/// The element near `element` that explains most samples; with the first knob of the last term, `value` at first, where
/// that is part of the element.
pub fn settle(
    data: &Data,
    spec: &Spec,
    element: Element,
    value: Option<f64>,
    reach: Reach,
) -> (Element, Option<f64>) {
    let mut at = (element, value);
    for round in 0..if reach == Reach::Wide { ROUNDS } else { 1 } {
        let mut held = Held::new(data, spec, at.0, at.1);
        let Some(loss) = held.rate(&[at], f64::INFINITY)[0] else { return at };
        held.lead(0);
        let mut found = Found { loss, element: at.0, value: at.1 };
        if reach == Reach::Wide && round == 0 {
            held.sweep(&mut found);
        }
        held.improve(&mut found, ABOUT[round.min(1)], reach);
        if (found.element, found.value) == at {
            break;
        }
        at = (found.element, found.value);
    }
    at
}

/// Valves of the kind of `spec`'s and any f and J, or of `any` kind and an f near that, with an f that grows so or differs so
/// between directions, whose stems explain most samples; the dynamics held are those with `spec`'s own.
pub fn banded(data: &Data, spec: &Spec, bands: impl Iterator<Item = (f64, f64)>, any: bool) -> Vec<Element> {
    let family = match (spec.element.slips, spec.element.resume) {
        (true, 1.0) => Family::Jumps,
        (true, _) => Family::Slips,
        (_, resume) if resume > 0.0 => Family::Sticks,
        _ => Family::Plain(spec.element.lag),
    };
    let families = if any { families(spec).to_vec() } else { vec![family] };
    let sought = bands.flat_map(|bands| families.iter().map(move |family| (*family, bands)));
    let range = if any { about(data, spec) } else { whole(data) };
    let mut rated = among_paths(data, spec, sought, range);
    rated.sort_by(|a, b| a.0.total_cmp(&b.0));
    rated.into_iter().take(LIKELY).map(|(_, element)| element).collect()
}

/// Every kind of valve, the plain one with the lag of `spec`'s.
fn families(spec: &Spec) -> [Family; 4] {
    [Family::Plain(spec.element.lag), Family::Sticks, Family::Slips, Family::Jumps]
}

/// The valves of one constant band whose stems explain most samples, one of each kind; the dynamics held are those with
/// `spec`'s own.
pub fn even(data: &Data, spec: &Spec) -> Vec<Element> {
    let sought = families(spec).into_iter().map(|family| (family, (0.0, 0.0)));
    let rated = among_paths(data, spec, sought, whole(data));
    rated.into_iter().map(|(_, element)| element).collect()
}

/// S from the least that is told apart from none to the largest at which the stem still reverses.
fn whole(data: &Data) -> (f64, f64) {
    let most = 2.0 * data.f_top;
    (LEAST_S * most, most)
}

/// The part of [`whole`] near the S of `spec`; empty (its start beyond its end) where that lies far outside.
fn about(data: &Data, spec: &Spec) -> (f64, f64) {
    let ((least, most), own) = (whole(data), 2.0 * spec.element.f);
    ((own / WIDELY).max(least), (own * WIDELY).min(most))
}

/// The best of each family, growth and skew among all paths of the stem with S in `range`, with its loss; none where a term
/// does more to the stem than delay it.
fn among_paths(
    data: &Data,
    spec: &Spec,
    sought: impl Iterator<Item = (Family, (f64, f64))>,
    range: (f64, f64),
) -> Vec<(f64, Element)> {
    if range.0 >= range.1 || spec.terms.iter().any(|term| term.changes_stem() && term.delays().is_none()) {
        return Vec::new();
    }
    let held = Held::new(data, spec, spec.element, None);
    let task = held.task(range);
    if !task.is_kept() {
        return Vec::new();
    }
    sought.flat_map(|(family, bands)| task.best(family, bands, spec.element, 1)).collect()
}

/// An element on trial, with the value of the term's knob that belongs to it.
type Tried = (Element, Option<f64>);

/// The best so far.
#[derive(Clone, Copy)]
struct Found {
    loss: f64,
    element: Element,
    value: Option<f64>,
}

/// The dynamics of one fit, held.
struct Held<'a> {
    data: &'a Data,
    trial: Spec,
    u: Vec<f64>,
    /// First lag of z, and the coefficients from it on.
    nearest: usize,
    b: Vec<f64>,
    /// What is left for the stem to explain, and whether the sample counts.
    left: Vec<f64>,
    counted: Vec<f64>,
    scale: f64,
    z: Vec<Lane>,
    alone: Vec<f64>,
    /// Losses after each block: of those on trial, and of the best so far.
    after: Vec<Lane>,
    best: Vec<f64>,
}

impl<'a> Held<'a> {
    fn new(data: &'a Data, spec: &Spec, element: Element, value: Option<f64>) -> Self {
        let mut trial = spec.clone();
        trial.element = element;
        set_last(&mut trial, value);
        let (stage, _) = trial.stage(data);
        let system = System::new(data, &stage, spec.orders.nk, data.split, LAGS);
        let Robust { theta, scale, .. } = system.robust();
        let (left, b) = system.without_z(&theta);
        let (nearest, counted) = (system.nearest, system.counted.to_vec());
        let mut u = stage.u;
        u.truncate(data.split);
        let z = vec![[0.0; LANES]; data.split];
        let (alone, after, best) = (Vec::new(), Vec::new(), Vec::new());
        Self { data, trial, u, nearest, b, left, counted, scale, z, alone, after, best }
    }

    /// The losses, the last of `tried` in the lanes that are left; `None` where it is no less than `enough`, where all are far
    /// behind the best, or where the stem hardly reverses.
    fn rate(&mut self, tried: &[Tried], enough: f64) -> [Option<f64>; LANES] {
        let (from, to) = (self.data.first, self.data.split);
        let Some(&last) = tried.last() else { return [None; LANES] };
        let of = |l: usize| tried.get(l).copied().unwrap_or(last);
        let elements = from_fn(|l| self.put(of(l)).full_element());
        let mut run = Run::new(&elements, self.data.start, from, to);
        if self.trial.terms.iter().any(|term| term.changes_stem()) {
            run.go_on(&self.u, to, &mut self.z);
            (0..LANES).for_each(|l| self.change_stem(l, of(l)));
        }
        let per = 1.0 / (FREEDOM * self.scale * self.scale);
        let mut sums = [0.0; LANES];
        self.after.clear();
        for at in (from..to).step_by(BLOCK) {
            let end = (at + BLOCK).min(to);
            run.go_on(&self.u, end, &mut self.z);
            self.add(at, end, per, &mut sums);
            let best = self.best.get(self.after.len()).map_or(f64::INFINITY, |best| best + FAR_BEHIND);
            if sums.iter().all(|sum| *sum >= best.min(enough)) {
                return [None; LANES];
            }
            self.after.push(sums);
        }
        let turns = run.turns();
        from_fn(|l| (sums[l] < enough && turns[l] >= LEAST_REVERSALS as f64).then_some(sums[l]))
    }

    /// Adds the loss of the samples from `at` to `end`.
    fn add(&self, at: usize, end: usize, per: f64, sums: &mut Lane) {
        let rows = at - self.data.first..end - self.data.first;
        let (left, counted) = (&self.left[rows.clone()], &self.counted[rows]);
        let late: [&[Lane]; LAGS.1] = from_fn(|j| &self.z[at - self.nearest - j..][..left.len()]);
        add_losses(left, counted, &self.b, late, per, sums);
    }

    fn put(&mut self, (element, value): Tried) -> &Spec {
        self.trial.element = element;
        set_last(&mut self.trial, value);
        &self.trial
    }

    /// What the terms do to the stem of one lane.
    fn change_stem(&mut self, l: usize, tried: Tried) {
        self.alone.clear();
        self.alone.extend(self.z.iter().map(|z| z[l]));
        self.put(tried);
        self.trial.terms.iter().for_each(|term| term.stem(self.data, &mut self.alone));
        self.z.iter_mut().zip(&self.alone).for_each(|(z, alone)| z[l] = *alone);
    }

    fn better(&mut self, found: &mut Found, others: impl Iterator<Item = Tried>) {
        let fits = |(element, value): &Tried| {
            element.f > 0.0 && value.is_none_or(|v| v.abs() <= MOST_VALUE) && element.is_valve()
        };
        let mut others = others.filter(fits).fuse();
        loop {
            let mut tried = [(found.element, found.value); LANES];
            let mut count = 0;
            for (slot, other) in tried.iter_mut().zip(&mut others) {
                *slot = other;
                count += 1;
            }
            let losses = self.rate(&tried[..count], found.loss);
            for (l, (loss, (element, value))) in losses.into_iter().zip(tried).enumerate() {
                if let Some(loss) = loss.filter(|loss| *loss < found.loss) {
                    *found = Found { loss, element, value };
                    self.lead(l);
                }
            }
            if count < LANES {
                return;
            }
        }
    }

    /// The one in that lane is the best so far.
    fn lead(&mut self, lane: usize) {
        self.best.clear();
        self.best.extend(self.after.iter().map(|sums| sums[lane]));
    }

    /// Every kind of valve over a wide range of f.
    fn sweep(&mut self, found: &mut Found) {
        let Found { element: c, value, .. } = *found;
        let jumps = (1..=5).flat_map(|i| [(0.2 * f64::from(i), false), (0.2 * f64::from(i), true)]);
        let jumps = jumps.chain([(BEYOND, false)]).map(|(resume, slips)| (1.0 - resume, resume, slips));
        let plain = [(0.0, 0.0, false), (0.5, 0.0, false), (1.0, 0.0, false), (c.lag, c.resume, c.slips)];
        let (width, sides) = SWEEP;
        for (lag, resume, slips) in jumps.chain(plain) {
            let range = (-sides..=sides).map(|i| c.f * (width * f64::from(i) / f64::from(sides)).exp());
            self.better(found, range.map(|f| (Element { f, lag, resume, slips, ..c }, value)));
        }
    }

    /// What is left for any stem with S in `range` to explain.
    fn task(&self, range: (f64, f64)) -> Task<'_> {
        Task {
            stems: Stems { u: &self.u, start: self.data.start, range },
            first: self.data.first,
            left: &self.left,
            counted: &self.counted,
            nearest: self.nearest,
            b: &self.b,
            per: 1.0 / (FREEDOM * self.scale * self.scale),
            delays: self.trial.terms.iter().filter_map(|term| term.delays()).collect(),
        }
    }

    /// One number after the other, until none comes out better.
    fn improve(&mut self, found: &mut Found, width: f64, reach: Reach) {
        let value = if reach == Reach::Close { Self::value } else { Self::any_value };
        let numbers = [Self::f_widely, value, Self::place, Self::kind, Self::lag, Self::f_finely];
        let mut settled = 0;
        for number in numbers.iter().cycle().take(MOST_PASSES * numbers.len()) {
            let before = found.loss;
            number(self, found, width);
            settled = if found.loss < before - LEAST_LESS { 1 } else { settled + 1 };
            if settled == numbers.len() {
                return;
            }
        }
    }

    fn f_widely(&mut self, found: &mut Found, width: f64) {
        let Found { element: c, value, .. } = *found;
        let range = (-20..=20).map(|i| c.f * (1.0 + width * f64::from(i) / 20.0));
        self.better(found, range.map(|f| (Element { f, ..c }, value)));
    }

    fn f_finely(&mut self, found: &mut Found, _width: f64) {
        self.f_widely(found, FINE);
    }

    /// The knob, with f.
    fn any_value(&mut self, found: &mut Found, width: f64) {
        let Found { element: c, value: Some(_), .. } = *found else { return };
        let values = (-9..=9).map(|i| 0.1 * f64::from(i));
        let both = values.flat_map(|v| [0.8, 0.9, 1.0, 1.1, 1.25].map(|share| (share, v)));
        self.better(found, both.map(|(share, v)| (Element { f: c.f * share, ..c }, Some(v))));
        self.value(found, width);
    }

    /// The same about what it is.
    fn value(&mut self, found: &mut Found, _width: f64) {
        let Found { element: c, value: Some(value), .. } = *found else { return };
        let values = (-5..=5).map(|i| value + 0.02 * f64::from(i));
        let both = values.flat_map(|v| [0.8, 0.9, 1.0, 1.1, 1.25].map(|share| (share, v)));
        self.better(found, both.map(|(share, v)| (Element { f: c.f * share, ..c }, Some(v))));
    }

    /// Where the stem was at the start, which nothing says.
    fn place(&mut self, found: &mut Found, _width: f64) {
        let Found { element: c, value, .. } = *found;
        let starts = [false, true].into_iter().flat_map(|turned| (0..=10).map(move |i| (turned, i)));
        let starts = starts.map(|(turned, i)| Element { turned, rest: 0.1 * f64::from(i), ..c });
        self.better(found, starts.map(|element| (element, value)));
    }

    fn kind(&mut self, found: &mut Found, _width: f64) {
        let Found { element: c, value, .. } = *found;
        let kinds =
            [false, true].into_iter().flat_map(|slips| (0..=5).map(move |i| (slips, 0.2 * f64::from(i))));
        let kinds = kinds.chain([(false, BEYOND)]);
        let kinds = kinds.flat_map(|(slips, resume)| [c.lag, 1.0 - resume].map(|lag| (slips, resume, lag)));
        let kinds = kinds.map(|(slips, resume, lag)| Element { slips, resume, lag, ..c });
        self.better(found, kinds.map(|element| (element, value)));
    }

    /// The lag, and the threshold with it or alone.
    fn lag(&mut self, found: &mut Found, _width: f64) {
        let Found { element: c, value, .. } = *found;
        let moves = STEPS
            .into_iter()
            .flat_map(|s| [(s, 0.0), (-s, 0.0), (s, -s), (-s, s), (0.0, s), (0.0, -s)])
            .filter(|(_, threshold)| *threshold == 0.0 || c.resume > 0.0)
            .map(|(lag, resume)| Element { lag: c.lag + lag, resume: c.resume + resume, ..c });
        self.better(found, moves.map(|element| (element, value)));
    }
}

fn set_last(spec: &mut Spec, value: Option<f64>) {
    if let (Some(value), Some(last)) = (value, spec.terms.last_mut()) {
        last.set(0, value);
    }
}

/// Adds the losses of what is `left` for stems to explain, `late` their places by lag, `b` what each lag counts.
#[multiversion(targets("x86_64+avx2"))]
fn add_losses(left: &[f64], counted: &[f64], b: &[f64], late: [&[Lane]; LAGS.1], per: f64, sums: &mut Lane) {
    let mut e = [[0.0; LANES]; BLOCK];
    let e = &mut e[..left.len()];
    e.iter_mut().zip(left).for_each(|(e, left)| *e = [*left; LANES]);
    // Four lags at a time: what is bound by memory is passed over a quarter as often.
    for (b, late) in b.chunks_exact(4).zip(late.chunks_exact(4)) {
        let e = e.as_flattened_mut();
        let lagged = |i: usize| &late[i].as_flattened()[..e.len()];
        let (z0, z1, z2, z3) = (lagged(0), lagged(1), lagged(2), lagged(3));
        for k in 0..e.len() {
            e[k] -= b[0] * z0[k] + b[1] * z1[k] + b[2] * z2[k] + b[3] * z3[k];
        }
    }
    for (e, counted) in e.chunks(FACTORS).zip(counted.chunks(FACTORS)) {
        let mut product = [1.0; LANES];
        for (e, counted) in e.iter().zip(counted) {
            for l in 0..LANES {
                product[l] *= 1.0 + (counted * e[l] * e[l] * per).min(MOST_FACTOR);
            }
        }
        sums.iter_mut().zip(product).for_each(|(sum, product)| *sum += product.ln());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::pose::declared;
    use crate::residual::pose::tests::{behind_valve, noise, waves};
    use crate::residual::scan::scan_friction;

    /// A first-order process behind `element`, whose f is in units of OP here; noise of `sd`.
    fn posed(element: Element, sd: f64) -> Data {
        let mut draw = noise(8);
        let op: Vec<f64> = waves(1200).into_iter().map(|op| op + 0.05 * draw()).collect();
        behind_valve(&op, element, 0.8, |_| sd * draw())
    }

    fn stem(data: &Data, spec: &Spec, element: Element) -> Vec<f64> {
        let (mut z, mut dir) = (Vec::new(), Vec::new());
        Spec { element, ..spec.clone() }.restem(data, &data.u, &mut z, &mut dir);
        z
    }

    #[test]
    fn the_loss_is_the_plain_sum() {
        let data = posed(Element { f: 1.0, ..Element::default() }, 0.02);
        let element = Element { f: 0.9 / data.scale.u, lag: 0.3, ..Element::default() };
        let spec = declared(&data, element.f);
        let mut held = Held::new(&data, &spec, element, None);
        let z = stem(&data, &spec, element);
        let mut plain = 0.0;
        for k in data.first..data.split {
            let mut e = held.left[k - data.first];
            for (j, b) in held.b.iter().enumerate() {
                e -= b * z[k - held.nearest - j];
            }
            plain += (1.0 + e * e / (FREEDOM * held.scale * held.scale)).ln();
        }
        let losses = held.rate(&[(element, None)], f64::INFINITY);
        let loss = losses[0].expect("the stem reverses");
        // Sums in another order.
        assert!((loss / plain - 1.0).abs() < 1e-9, "{loss} {plain}");
        assert_eq!(losses, [Some(loss); LANES], "lanes that are left repeat the last");
        assert_eq!(held.rate(&[(element, None)], loss), [None; LANES], "what is no better is given up");
    }

    #[test]
    fn a_valve_at_rest_anywhere_at_the_start_is_found() {
        for (turned, rest, resume, slips) in [
            (false, 0.0, 0.0, false),
            (true, 0.6, 0.0, false),
            (true, 0.3, 0.4, false),
            (false, 0.5, 0.6, true),
        ] {
            let lag = if resume > 0.0 { 1.0 - resume } else { 0.0 };
            let valve = Element { f: 1.6, lag, resume, slips, turned, rest, ..Element::default() };
            let data = posed(valve, 0.02);
            let own = Element { f: valve.f / data.scale.u, ..valve };
            let spec = declared(&data, own.f);
            let plain = Element { f: 1.08 * own.f, ..Element::default() };
            let found = scan_friction(&data, &Spec { element: plain, ..spec.clone() }, 24, false).best[0];
            let (is, was) = (stem(&data, &spec, found), stem(&data, &spec, own));
            let far =
                |a: &[f64]| (data.first..data.split).filter(|&k| (a[k] - was[k]).abs() > 0.2 * own.f).count();
            let (left, at_first) = (far(&is), far(&stem(&data, &spec, plain)));
            // A sample at a turn may be told apart by noise only; a missed turn would be tens.
            assert!(left <= 3 && at_first > 10, "{left} of {at_first}: {found:?} for {own:?}");
        }
    }
}
