//! The recursions by 1/C, with the order known to the compiler and several signals side by side.

/// Signals filtered side by side: one alone waits for its own last value at every sample.
const LANES: usize = 4;

/// `e[k] <- e[k] - c1 e[k-1] - …` in place; 0 where a sample does not count.
pub fn recursion(c: &[f64], weight: &[f64], e: &mut [f64]) {
    let whole = !weight.contains(&0.0);
    match *c {
        [] if whole => {}
        [] => masked([], weight, e),
        [c1] if whole => plain([c1], e),
        [c1, c2] if whole => plain([c1, c2], e),
        [c1, c2, c3] if whole => plain([c1, c2, c3], e),
        [c1, c2, c3, c4] if whole => plain([c1, c2, c3, c4], e),
        [c1] => masked([c1], weight, e),
        [c1, c2] => masked([c1, c2], weight, e),
        [c1, c2, c3] => masked([c1, c2, c3], weight, e),
        [c1, c2, c3, c4, ..] => masked([c1, c2, c3, c4], weight, e),
    }
}

fn plain<const P: usize>(c: [f64; P], e: &mut [f64]) {
    let mut past = [0.0; P];
    for e in e {
        // The latest value comes last: all else is known a sample ahead.
        let value = (0..P).rev().fold(*e, |value, l| value - c[l] * past[l]);
        for l in (1..P).rev() {
            past[l] = past[l - 1];
        }
        past[0] = value;
        *e = value;
    }
}

fn masked<const P: usize>(c: [f64; P], weight: &[f64], e: &mut [f64]) {
    let mut past = [0.0; P];
    for (e, weight) in e.iter_mut().zip(weight) {
        let value = (0..P).rev().fold(*e, |value, l| value - c[l] * past[l]);
        let value = if *weight == 0.0 { 0.0 } else { value };
        for l in (1..P).rev() {
            past[l] = past[l - 1];
        }
        if let Some(latest) = past.first_mut() {
            *latest = value;
        }
        *e = value;
    }
}

/// Every input filtered by 1/C from sample `from` to `to`, into `outputs` of length `to`; 0 before.
pub fn whiten(c: &[f64], inputs: &[&[f64]], from: usize, to: usize, outputs: &mut Vec<Vec<f64>>) {
    outputs.resize_with(inputs.len(), Vec::new);
    for (inputs, outputs) in inputs.chunks(LANES).zip(outputs.chunks_mut(LANES)) {
        for output in outputs.iter_mut() {
            output.resize(to, 0.0);
            output[..from].fill(0.0);
        }
        match *c {
            [] => outputs.iter_mut().zip(inputs).for_each(|(o, i)| o[from..].copy_from_slice(&i[from..to])),
            [c1] => side_by_side([c1], inputs, from, to, outputs),
            [c1, c2] => side_by_side([c1, c2], inputs, from, to, outputs),
            [c1, c2, c3] => side_by_side([c1, c2, c3], inputs, from, to, outputs),
            [c1, c2, c3, c4, ..] => side_by_side([c1, c2, c3, c4], inputs, from, to, outputs),
        }
    }
}

fn side_by_side<const P: usize>(
    c: [f64; P],
    inputs: &[&[f64]],
    from: usize,
    to: usize,
    outputs: &mut [Vec<f64>],
) {
    let ([a, b, c_in, d], [x, y, z, w]) = (inputs, &mut *outputs) else {
        for (input, output) in inputs.iter().zip(outputs) {
            output[from..].copy_from_slice(&input[from..to]);
            plain(c, &mut output[from..]);
        }
        return;
    };
    let inputs = [a, b, c_in, d].map(|v| &v[from..to]);
    let n = to - from;
    let [i0, i1, i2, i3] = inputs.map(|v| &v[..n]);
    let [o0, o1, o2, o3] = [x, y, z, w].map(|v| &mut v[from..from + n]);
    let mut past = [[0.0; LANES]; P];
    for k in 0..n {
        let mut value = [i0[k], i1[k], i2[k], i3[k]];
        for l in (0..P).rev() {
            for lane in 0..LANES {
                value[lane] -= c[l] * past[l][lane];
            }
        }
        for l in (1..P).rev() {
            past[l] = past[l - 1];
        }
        past[0] = value;
        [o0[k], o1[k], o2[k], o3[k]] = value;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn side_by_side_is_one_after_the_other() {
        let c = [0.6, -0.3, 0.1, 0.05];
        let signals: Vec<Vec<f64>> =
            (0..6).map(|i| (0..50).map(|k| ((i + 2) as f64 * 0.3 * k as f64).sin()).collect()).collect();
        let inputs: Vec<&[f64]> = signals.iter().map(Vec::as_slice).collect();
        for order in 0..=4 {
            let mut out = Vec::new();
            whiten(&c[..order], &inputs, 3, 45, &mut out);
            for (signal, out) in signals.iter().zip(&out) {
                let mut alone = signal[3..45].to_vec();
                recursion(&c[..order], &[1.0; 42], &mut alone);
                assert_eq!(out[..3], [0.0; 3]);
                assert_eq!(out[3..], alone);
                for k in 0..alone.len() {
                    let past: f64 = (0..order.min(k)).map(|l| c[l] * alone[k - 1 - l]).sum();
                    assert!((alone[k] - (signal[3 + k] - past)).abs() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn a_sample_that_does_not_count_is_forgotten() {
        let mut e = [1.0, 5.0, 1.0, 1.0];
        recursion(&[0.5], &[1.0, 0.0, 1.0, 1.0], &mut e);
        assert_eq!(e, [1.0, 0.0, 1.0, 0.5]);
    }
}
