use super::*;
use crate::signal::Window;
use crate::sysid::arx::Arx;
use crate::sysid::valve;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};

/// A stem with one smooth parameter: a gain for the second half.
struct Halves<'a> {
    u: &'a [f64],
    ratio: Option<f64>,
}

impl Input for Halves<'_> {
    fn smooth(&self) -> Vec<Smooth> {
        self.ratio.iter().map(|value| Smooth { value: *value, step: 1e-4, bounds: (0.1, 10.0) }).collect()
    }
    fn signals(&self, theta: &[f64]) -> Signals {
        let ratio = theta.first().copied().unwrap_or(1.0);
        let half = self.u.len() / 2;
        let x = self.u.iter().enumerate().map(|(k, u)| if k < half { *u } else { ratio * u }).collect();
        Signals { x, ..Signals::default() }
    }
}

/// `y[k] = 1.5 y[k-1] - 0.56 y[k-2] + 0.1 u[k-3] + e[k] - 0.7 e[k-1]`, the input `ratio` times as large in the second half.
fn data(noise: f64, ratio: f64) -> IdData {
    let n = 1500;
    let mut draw = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(4));
    let mut draw = move || -> f64 { draw.next().unwrap_or(0.0) };
    let op: Vec<f64> =
        (0..n).map(|k| (0.21 * k as f64).sin() + (0.047 * k as f64).cos() + 0.3 * draw()).collect();
    let (mut pv, mut last) = (vec![0.0; n], 0.0);
    for k in 3..n {
        let e = noise * draw();
        let gain = if k - 3 < n / 2 { 1.0 } else { ratio };
        pv[k] = 1.5 * pv[k - 1] - 0.56 * pv[k - 2] + 0.1 * gain * op[k - 3] + e - 0.7 * last;
        last = e;
    }
    let window = Window { t0: 0.0, ts: 1.0, op, pv, ..Window::default() };
    IdData::new(&window, valve::Start { index: 0, is_max: true }).expect("long enough")
}

fn fitted(data: &IdData, input: &Halves<'_>) -> Armax {
    let theta: Vec<f64> = input.smooth().iter().map(|s| s.value).collect();
    let signals = input.signals(&theta);
    let long = Arx::new(data, &data.y, &signals.shapes).fit(&signals.x, None);
    let starts = hannan_rissanen(data, &data.y, &signals, &long, &theta);
    // Three numbers of B from 1, 2 or 3 on hold lag 3.
    assert!((1..=3).contains(&starts[0].model.nk));
    starts[0].model.clone().fit(data, &data.y, input, 20)
}

#[test]
fn dynamics_delay_and_noise_come_out() {
    let data = data(0.05, 1.0);
    let fit = fitted(&data, &Halves { u: &data.u, ratio: None });
    // Orders above the true ones leave common factors: the responses are unique, the coefficients are not.
    let gain = fit.b.iter().sum::<f64>() / (1.0 + fit.a.iter().sum::<f64>());
    let true_gain = 0.1 / 0.06 * data.units.u / data.units.y;
    assert!((gain / true_gain - 1.0).abs() < 0.1, "{gain} {true_gain}");
    let power = fit.errors(&data, &data.y, &Halves { u: &data.u, ratio: None }.signals(&[]), data.split);
    let rms = crate::sysid::stats::sd(&power.e[data.rows()]) * data.units.y;
    assert!((rms / 0.05 - 1.0).abs() < 0.05, "{rms}");
}

#[test]
fn a_smooth_parameter_is_estimated_with_the_coefficients() {
    let data = data(0.02, 1.6);
    let fit = fitted(&data, &Halves { u: &data.u, ratio: Some(1.0) });
    // About three standard errors.
    assert!((fit.theta[0] - 1.6).abs() < 0.05, "{:?}", fit.theta);
    let plain = fitted(&data, &Halves { u: &data.u, ratio: None });
    assert!(fit.log_likelihood > plain.log_likelihood + 20.0);
}

#[test]
fn missing_samples_are_left_out_and_the_filter_carries_on() {
    let whole = data(0.05, 1.0);
    let mut holed = whole.clone();
    for k in (60..whole.len()).step_by(11) {
        holed.y[k] = 40.0;
        holed.weight[k] = 0.0;
    }
    let input = Halves { u: &whole.u, ratio: None };
    let start = fitted(&whole, &input);
    let fit = start.clone().fit(&holed, &holed.y, &input, 20);
    for (a, b) in fit.a.iter().chain(&fit.b).zip(start.a.iter().chain(&start.b)) {
        // A tenth of the rows is missing: the estimate moves by a part of its standard error.
        assert!((a - b).abs() < 0.1, "{fit:?} {start:?}");
    }
    assert!((fit.scale / start.scale - 1.0).abs() < 0.1);
}

#[test]
fn what_is_missing_and_what_is_silent_leave_the_model_as_it_is() {
    let mut data = data(0.05, 1.0);
    let input = Halves { u: &data.u.clone(), ratio: None };
    let whole = fitted(&data, &input);
    for k in (100..1500).filter(|k| k % 11 == 0) {
        (data.y[k], data.weight[k]) = (50.0, 0.0);
    }
    (data.weight[777], data.known[777]) = (0.0, true);
    let signals = input.signals(&[]);
    let errors = whole.errors(&data, &data.y, &signals, 1500);
    // A missing PV is its prediction, a silent one stays; neither has an error.
    assert!(errors.y[110].abs() < 10.0 && errors.y[777] == data.y[777]);
    assert_eq!((errors.e[110], errors.e[777]), (0.0, 0.0));
    let holed = whole.clone().fit(&data, &data.y, &input, 20);
    let gain = |fit: &Armax| fit.b.iter().sum::<f64>() / (1.0 + fit.a.iter().sum::<f64>());
    // A tenth fewer rows move the gain by less than its own error, some 5 % here.
    assert!((gain(&holed) / gain(&whole) - 1.0).abs() < 0.05, "{} {}", gain(&holed), gain(&whole));
}

#[test]
fn errors_behind_a_hole_are_as_large_as_the_filter_says() {
    // At one noise level alone a hole is worth as much as it is.
    let mut data = data(0.05, 1.0);
    let input = Halves { u: &data.u.clone(), ratio: None };
    let whole = fitted(&data, &input);
    for k in (100..1500).filter(|k| k % 4 < 2) {
        (data.y[k], data.weight[k]) = (50.0, 0.0);
    }
    let errors = whole.errors(&data, &data.y, &input.signals(&[]), 1500);
    let (mut sum, mut raw, mut count) = (0.0, 0.0, 0.0);
    for k in (102..1500).filter(|k| k % 4 == 2) {
        let e = errors.e[k] / whole.scale;
        (sum, raw, count) = (sum + e * e, raw + (e * errors.gains.root[k]).powi(2), count + 1.0);
    }
    let usual = data.rows().filter(|k| k % 4 == 3).map(|k| (errors.e[k] / whole.scale).powi(2));
    let usual = usual.sum::<f64>() / data.rows().filter(|k| k % 4 == 3).count() as f64;
    // 350 squares: their mean is known to 8 %.
    assert!((sum / count / usual - 1.0).abs() < 0.25, "{} {usual}", sum / count);
    assert!(raw / count > 1.3 * usual, "{} {usual}", raw / count);
}

#[test]
fn the_gradient_with_holes_is_that_of_the_errors() {
    let mut data = data(0.05, 1.0);
    let input = Halves { u: &data.u.clone(), ratio: None };
    let (a, c) = ([-1.5, 0.56, 0.0], [-0.7, 0.0, 0.0]);
    let b = [0.1 * data.units.u / data.units.y, 0.0, 0.0];
    let whole = Armax { nk: 3, a, b, c, scale: 0.1, nu: 5.0, ..Armax::default() };
    for k in (100..1500).filter(|k| k % 7 < 2) {
        (data.y[k], data.weight[k]) = (50.0, 0.0);
    }
    // One that is measured.
    (data.weight[779], data.known[779]) = (0.0, true);
    let gradient = Gradient::new(&data, &data.y, &whole, &input);
    let signals = input.signals(&[]);
    let at = |model: &Armax| model.errors(&data, &data.y, &signals, data.split).e[data.rows()].to_vec();
    let step = 1e-6;
    for (column, change) in [0, 4, 6, 9].into_iter().zip([
        &(|m: &mut Armax| m.a[0] += step) as &dyn Fn(&mut Armax),
        &|m: &mut Armax| m.b[1] += step,
        &|m: &mut Armax| m.c[0] += step,
        &|m: &mut Armax| m.c0 += step,
    ]) {
        let mut moved = whole.clone();
        change(&mut moved);
        let slopes: Vec<f64> = at(&whole).iter().zip(at(&moved)).map(|(e, f)| (e - f) / step).collect();
        let counts = &data.weight[data.rows()];
        let sum = |v: &dyn Fn(usize) -> f64| (0..counts.len()).map(|k| counts[k] * v(k)).sum::<f64>();
        let own = &gradient.columns[column];
        let off = sum(&|k| (slopes[k] - own[k]).powi(2)) / sum(&|k| slopes[k] * slopes[k]);
        // How the variance of the state changes is left out: that hardly depends on A, and with C it adds what has nothing to do
        // with the column, so that the step is neither too long nor too short.
        let along = sum(&|k| slopes[k] * own[k]) / sum(&|k| own[k] * own[k]);
        let holds = if column == 6 { (along - 1.0).abs() < 0.15 } else { off < 1e-3 };
        assert!(holds, "{column}: {off} off, {along} along");
    }
}
