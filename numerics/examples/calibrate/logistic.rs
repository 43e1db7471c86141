//! Multinomial logistic regression with a small ridge, by gradient descent with momentum: enough for a dozen numbers.

/// Weights `w[class][feature]`, the bias last, of `p(class) ∝ exp(w[class] · (x, 1))`; `alike`: classes count alike, else rows.
pub fn fit(x: &[Vec<f64>], y: &[usize], classes: usize, ridge: f64, alike: bool) -> Vec<Vec<f64>> {
    let width = x.first().map_or(0, Vec::len);
    let (mean, sd) = moments(x, width);
    let z: Vec<Vec<f64>> =
        x.iter().map(|row| (0..width).map(|i| (row[i] - mean[i]) / sd[i]).chain([1.0]).collect()).collect();
    let mut count = vec![0.0; classes];
    y.iter().for_each(|class| count[*class] += 1.0);
    let weight =
        |class: &usize| if alike { 1.0 / (classes as f64 * count[*class]) } else { 1.0 / y.len() as f64 };
    let each: Vec<f64> = y.iter().map(weight).collect();
    let mut w = vec![vec![0.0; width + 1]; classes];
    let mut speed = w.clone();
    for _ in 0..1500 {
        let mut gradient = vec![vec![0.0; width + 1]; classes];
        for ((row, class), weight) in z.iter().zip(y).zip(&each) {
            let p = probabilities(&w, row);
            for (c, p) in p.iter().enumerate() {
                let error = weight * (p - f64::from(u8::from(c == *class)));
                gradient[c].iter_mut().zip(row).for_each(|(g, x)| *g += error * x);
            }
        }
        for c in 0..classes {
            for i in 0..=width {
                let pull = if i < width { ridge * w[c][i] } else { 0.0 };
                speed[c][i] = 0.95 * speed[c][i] - 0.5 * (gradient[c][i] + pull);
                w[c][i] += speed[c][i];
            }
        }
    }
    // Back from standardised features.
    for w in &mut w {
        let mut bias = w[width];
        for i in 0..width {
            w[i] /= sd[i];
            bias -= w[i] * mean[i];
        }
        w[width] = bias;
    }
    w
}

/// `p(class)` of a row whose last value is 1.
pub fn probabilities(w: &[Vec<f64>], row: &[f64]) -> Vec<f64> {
    let scores: Vec<f64> = w.iter().map(|w| w.iter().zip(row).map(|(w, x)| w * x).sum()).collect();
    let most = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let sum: f64 = scores.iter().map(|s| (s - most).exp()).sum();
    scores.iter().map(|s| (s - most).exp() / sum).collect()
}

fn moments(x: &[Vec<f64>], width: usize) -> (Vec<f64>, Vec<f64>) {
    let n = x.len().max(1) as f64;
    let mean: Vec<f64> = (0..width).map(|i| x.iter().map(|row| row[i]).sum::<f64>() / n).collect();
    let sd = (0..width)
        .map(|i| (x.iter().map(|row| (row[i] - mean[i]).powi(2)).sum::<f64>() / n).sqrt().max(1e-9))
        .collect();
    (mean, sd)
}
