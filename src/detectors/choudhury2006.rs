//! Choudhury, Shah, Thornhill & Shook 2006: a test for nonlinearity by the bicoherence, and the width of the plot of PV
//! against OP as apparent stiction.
//!
//! ```text
//! bic²(f1, f2) = |Σ X(f1) X(f2) X*(f1+f2)|² / (Σ|X(f1) X(f2)|² Σ|X(f1+f2)|²)     sums over K segments
//! NGI = mean bic² - bic²_crit          bic²_crit = (1.645 + sqrt(4 L - 1))² / (4 K L)
//! NLI = max bic² - (mean bic² + 2 sd bic²)
//! S_c: distance along OP of the two branches near the mean of PV (2-means)
//! S_e = 2 sqrt 2 sd(u) sqrt(1 - r²)    width along OP of the ellipse of the same moments, r: correlation of u and y
//! ```
//!
//! X: transform of a Hann-windowed segment of the control error, half overlapping; L: pairs of frequencies. NGI, NLI (-); u: OP, y: PV, both filtered to the band of the largest bicoherence; S_c, S_e
//! (OP unit). A loop with NGI > 0.001 and NLI > 0.01 is nonlinear; the authors then look at the plot, and a width is stiction.
//!
//! Source: Automatic detection and quantification of stiction in control valves, Control Eng. Practice 2006, 14, 1395
//! (thresholds); indices: Choudhury, Shah & Thornhill, Automatica 2004, 40, 1719.
//! The ellipse of equal moments replaces their fit, which gives the same on an ellipse. Chosen here: segments of four
//! periods or a sixth of the record, whichever is shorter.
//! Limits: a window of 1,000 samples is a quarter of what they ask for, and has so few segments that NLI is above its threshold
//! for Gaussian noise too: NGI alone decides, and is the index. Bicoherence sees quadratic coupling: a symmetric cycle
//! has odd harmonics alone and little of it. Any other nonlinearity is called stiction, saturation and square loads among it.
//! The apparent stiction is not S: it grows with the process's lag.

use super::facts::Facts;
use super::opinion::{Band, Method, Opinion, Says};
use super::picture::{Layer, Mark, Picture, Tone, excerpt};
use crate::signal::{beside, share};
use crate::sysid::stats::{mean, range, sd};
use realfft::RealFftPlanner;

const METHOD: Method = Method::Choudhury2006;
/// The authors' threshold of NGI, the index (-).
pub const BY_NGI: Band = Band::at(0.001);
/// The authors' threshold of NLI (-).
pub const LEAST_NLI: f64 = 0.01;
/// Normal quantile of the test for NGI.
const QUANTILE: f64 = 1.645;
/// Fewest samples of a segment.
const LEAST_SEGMENT: usize = 32;
/// Periods in a segment.
const PERIODS: f64 = 4.0;
/// Fewest segments without overlap.
const SEGMENTS: usize = 6;
/// Half the width of the filter around the frequencies of the largest bicoherence (1/samples).
const HALF_WIDTH: f64 = 0.05;
/// Half the width of the strip around the mean of PV, as a share of its range.
const STRIP: f64 = 0.1;
/// Most cells of the drawn map along its longer side.
const CELLS: usize = 48;

/// The indices of the bicoherence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Indices {
    /// Non-Gaussianity index (-).
    pub ngi: f64,
    /// Nonlinearity index (-).
    pub nli: f64,
    /// Largest squared bicoherence (-).
    pub largest: f64,
    /// The pair of frequencies where it is (1/samples).
    pub at: (f64, f64),
}

/// The squared bicoherence over the principal domain, without the mean.
#[derive(Clone, Debug, PartialEq)]
pub struct Bicoherence {
    /// Samples of a segment, and how many segments.
    segment: usize,
    segments: usize,
    /// The bins of both frequencies.
    pairs: Vec<(usize, usize)>,
    /// Squared bicoherence of each pair (-).
    values: Vec<f64>,
}

impl Bicoherence {
    /// The bicoherence of a signal, from half overlapping segments; none for fewer than two. `segment`: samples of a segment.
    pub fn new(v: &[f64], segment: usize) -> Option<Self> {
        let half = segment / 2;
        if segment < 8 || v.len() < segment + half {
            return None;
        }
        let forward = RealFftPlanner::<f64>::new().plan_fft_forward(segment);
        let hann: Vec<f64> = (0..segment)
            .map(|k| 0.5 - 0.5 * (std::f64::consts::TAU * (k as f64 + 0.5) / segment as f64).cos())
            .collect();
        let mut spectra = Vec::new();
        for part in v.windows(segment).step_by(half.max(1)) {
            let m = mean(part);
            let mut x: Vec<f64> = part.iter().zip(&hann).map(|(x, h)| (x - m) * h).collect();
            let mut bins = forward.make_output_vec();
            forward.process(&mut x, &mut bins).ok()?;
            spectra.push(bins);
        }
        let (mut pairs, mut values) = (Vec::new(), Vec::new());
        for f1 in 1..=segment / 4 {
            for f2 in f1..=(segment / 2 - f1) {
                let mut sum = realfft::num_complex::Complex::new(0.0, 0.0);
                let (mut both, mut third) = (0.0, 0.0);
                for x in &spectra {
                    let product = x[f1] * x[f2];
                    sum += product * x[f1 + f2].conj();
                    both += product.norm_sqr();
                    third += x[f1 + f2].norm_sqr();
                }
                let all = both * third;
                pairs.push((f1, f2));
                values.push(if all > 0.0 { sum.norm_sqr() / all } else { 0.0 });
            }
        }
        Some(Self { segment, segments: spectra.len(), pairs, values })
    }

    /// The indices; none where they are no numbers.
    pub fn indices(&self) -> Option<Indices> {
        let bic = &self.values;
        let (at, largest) = bic.iter().copied().enumerate().max_by(|a, b| a.1.total_cmp(&b.1))?;
        let (k, l, mean) = (self.segments as f64, bic.len() as f64, mean(bic));
        let critical = (QUANTILE + (4.0 * l - 1.0).sqrt()).powi(2) / (4.0 * k * l);
        let frequency = |bin: usize| bin as f64 / self.segment as f64;
        largest.is_finite().then(|| Indices {
            ngi: mean - critical,
            nli: largest - (mean + 2.0 * sd(bic)),
            largest,
            at: (frequency(self.pairs[at].0), frequency(self.pairs[at].1)),
        })
    }

    /// The map, the second frequency to the right, at most [`CELLS`] cells a side: of several pairs in one the largest.
    fn cells(&self, ts: f64) -> Mark {
        let pool = (self.segment / 2).div_ceil(CELLS).max(1);
        let (columns, rows) = (self.segment / 2 / pool + 1, self.segment / 4 / pool + 1);
        let mut values = vec![None::<f64>; columns * rows];
        for ((f1, f2), value) in self.pairs.iter().zip(&self.values) {
            let cell = &mut values[f1 / pool * columns + f2 / pool];
            *cell = Some(cell.map_or(*value, |other| other.max(*value)));
        }
        let bin = 1.0 / (self.segment as f64 * ts);
        let size = (bin * pool as f64, bin * pool as f64);
        Mark::Cells { from: (-0.5 * bin, -0.5 * bin), size, columns, values }
    }
}

/// The indices of a signal; none for fewer than two segments. `segment`: samples of a segment.
pub fn indices(v: &[f64], segment: usize) -> Option<Indices> {
    Bicoherence::new(v, segment)?.indices()
}

/// The width along `u` of the ellipse with the moments of `u` and `y`, in u's unit.
pub fn ellipse(u: &[f64], y: &[f64]) -> f64 {
    let (mu, my, su, sy) = (mean(u), mean(y), sd(u), sd(y));
    let covariance = u.iter().zip(y).map(|(u, y)| (u - mu) * (y - my)).sum::<f64>() / u.len().max(1) as f64;
    let r = covariance / (su * sy);
    (8.0 * (1.0 - r * r).max(0.0)).sqrt() * su
}

/// The outline of that ellipse, once around.
fn outline(u: &[f64], y: &[f64]) -> Vec<(f64, f64)> {
    let (mu, my, su, sy) = (mean(u), mean(y), sd(u), sd(y));
    let covariance = u.iter().zip(y).map(|(u, y)| (u - mu) * (y - my)).sum::<f64>() / u.len().max(1) as f64;
    let r = covariance / (su * sy);
    let across = (1.0 - r * r).max(0.0).sqrt();
    let at = |i: u32| {
        let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / 90.0).sin_cos();
        let root = std::f64::consts::SQRT_2;
        (mu + root * su * cos, my + root * sy * (r * cos + across * sin))
    };
    (0..=90).map(at).collect()
}

/// The distance along `u` of the two branches where `y` is near its mean, in u's unit; none with too few samples there.
pub fn branches(u: &[f64], y: &[f64]) -> Option<f64> {
    let (low, high) = range(y);
    let (middle, reach) = (mean(y), STRIP * (high - low));
    let near: Vec<f64> =
        u.iter().zip(y).filter(|(_, y)| (*y - middle).abs() <= reach).map(|(u, _)| *u).collect();
    if near.len() < 8 {
        return None;
    }
    let (mut a, mut b) = range(&near);
    for _ in 0..20 {
        let (left, right): (Vec<f64>, Vec<f64>) = near.iter().partition(|u| (*u - a).abs() <= (*u - b).abs());
        if left.is_empty() || right.is_empty() {
            break;
        }
        (a, b) = (mean(&left), mean(&right));
    }
    Some(b - a)
}

/// The part of `v` between two frequencies (1/samples).
fn band_pass(v: &[f64], low: f64, high: f64) -> Option<Vec<f64>> {
    let n = v.len();
    let mut planner = RealFftPlanner::<f64>::new();
    let (forward, back) = (planner.plan_fft_forward(n), planner.plan_fft_inverse(n));
    let mut bins = forward.make_output_vec();
    forward.process(&mut v.to_vec(), &mut bins).ok()?;
    for (i, bin) in bins.iter_mut().enumerate() {
        let frequency = i as f64 / n as f64;
        if frequency < low || frequency > high {
            *bin = Default::default();
        }
    }
    let mut out = back.make_output_vec();
    back.process(&mut bins, &mut out).ok()?;
    Some(out.into_iter().map(|x| x / n as f64).collect())
}

/// What the method evaluates.
struct Evaluated {
    map: Bicoherence,
    found: Indices,
}

fn evaluate(facts: &Facts<'_>) -> Result<Evaluated, String> {
    let period = facts.oscillates()?;
    let error: Vec<f64> = match &facts.window.sp {
        Some(sp) if sp.iter().all(|sp| sp.is_finite()) => {
            sp.iter().zip(&facts.window.pv).map(|(sp, pv)| sp - pv).collect()
        }
        _ => facts.y.clone(),
    };
    let segment = (PERIODS * period).min((facts.len() / SEGMENTS) as f64) as usize & !1;
    if segment < LEAST_SEGMENT || (segment as f64) < period {
        return Err(format!("fewer than {SEGMENTS} segments of a period"));
    }
    let none = "no bicoherence can be estimated";
    let map = Bicoherence::new(&error, segment).ok_or(none)?;
    let found = map.indices().ok_or(none)?;
    Ok(Evaluated { map, found })
}

impl Evaluated {
    /// Whether the loop is nonlinear.
    fn nonlinear(&self) -> bool {
        BY_NGI.says(self.found.ngi) == Says::Sticks && self.found.nli > LEAST_NLI
    }

    /// OP and PV around the frequencies of the largest bicoherence (their standard deviations).
    fn filtered(&self, facts: &Facts<'_>) -> Option<(Vec<f64>, Vec<f64>)> {
        let at = self.found.at;
        let (low, high) = ((at.0.min(at.1) - HALF_WIDTH).max(0.004), (at.0.max(at.1) + HALF_WIDTH).min(0.5));
        band_pass(&facts.u, low, high).zip(band_pass(&facts.y, low, high))
    }
}

/// The map of the bicoherence, and where the loop is nonlinear PV against OP with the ellipse.
pub(super) fn picture(facts: &Facts<'_>) -> Vec<Picture> {
    let Ok(evaluated) = evaluate(facts) else { return Vec::new() };
    let name = format!("squared bicoherence, largest {:.2}", evaluated.found.largest);
    let cells = Layer { name, tone: Tone::Data, mark: evaluated.map.cells(facts.window.ts) };
    let title = "Bicoherence of the control error: coupled frequencies show a loop that is not linear";
    let mut pictures =
        vec![Picture::new(title, "second frequency (Hz)", "first frequency (Hz)", vec![cells])];
    let plane = evaluated.nonlinear().then(|| evaluated.filtered(facts)).flatten();
    if let Some((u, y)) = plane {
        let path = excerpt(facts).map(|k| (u[k], y[k])).collect();
        let layers = vec![
            Layer::line("path, filtered", Tone::Data, path),
            Layer::line("ellipse of the same moments", Tone::Sticks, outline(&u, &y)),
        ];
        let title = "PV against OP: the ellipse's width along OP is the apparent stiction";
        pictures.push(Picture::new(title, "OP (standard deviations)", "PV (standard deviations)", layers));
    }
    pictures
}

/// The opinion of the method.
pub fn opinion(facts: &Facts<'_>) -> Opinion {
    let evaluated = match evaluate(facts) {
        Ok(evaluated) => evaluated,
        Err(why) => return Opinion::cannot_tell(METHOD, why),
    };
    let Indices { ngi, nli, .. } = evaluated.found;
    let why = format!("NGI {}, NLI {}", BY_NGI.told(ngi, 3), beside(nli, &[LEAST_NLI], 3));
    let opinion = Opinion::of(METHOD, ngi, BY_NGI, format!("{why}: Gaussian, so linear"));
    if opinion.says != Says::Sticks {
        return opinion;
    }
    if !evaluated.nonlinear() {
        return Opinion { says: Says::Sound, why: format!("{why}: not Gaussian, but linear"), ..opinion };
    }
    let widths = evaluated.filtered(facts).and_then(|(u, y)| Some((branches(&u, &y)?, ellipse(&u, &y))));
    let Some((width, ellipse)) = widths else {
        return opinion.but_cannot_tell(format!("{why}: nonlinear, but PV and OP make no plot"));
    };
    let apparent = share(ellipse / facts.op_range(), 0);
    let why = format!("{why}: nonlinear, apparent stiction {apparent} of OP's range by the ellipse");
    Opinion { why, ..opinion }.with(width * facts.unit, "apparent stiction, by two branches")
}
