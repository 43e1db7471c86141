//! The filters of an ARMAX model: `A y - B z - c0`, and the recursion of `1/C`.
//!
//! ```text
//! w[k] = A(q) y[k] - B(q) z[k] - c0
//! e[k] = w[k] - c1 e[k-1] - … - c_nc e[k-nc]
//! ```

use super::model::{ORDER, Orders, Theta};
use crate::sysid::gram::add_two;
use multiversion::multiversion;

/// `w = A(q) y - B(q) z - c0`, two lags in each pass over w.
///
/// * `y`, `z`: the signal with the given lag.
#[inline]
pub(super) fn combine<'v>(
    w: &mut [f64],
    orders: Orders,
    theta: &Theta,
    y: impl Fn(usize) -> &'v [f64],
    z: impl Fn(usize) -> &'v [f64],
) {
    let (a, b, nk) = (&theta.a[..orders.na], &theta.b[..orders.nb], orders.nk);
    first_terms(w, theta.c0, (a[0], b[0]), [y(0), y(1), z(nk)]);
    let mut rest = [(0.0, y(0)); ORDER];
    let mut count = 0;
    let lagged = (1..a.len()).map(|i| (a[i], y(i + 1))).chain((1..b.len()).map(|j| (-b[j], z(nk + j))));
    for (slot, term) in rest.iter_mut().zip(lagged) {
        *slot = term;
        count += 1;
    }
    let mut pairs = rest[..count].chunks_exact(2);
    for pair in &mut pairs {
        add_two(w, pair[0], pair[1]);
    }
    for &(gain, v) in pairs.remainder() {
        add_scaled(w, gain, v);
    }
}

/// `w = y0 - c0 + a y1 - b z`.
#[multiversion(targets("x86_64+avx2"))]
fn first_terms(w: &mut [f64], c0: f64, (a, b): (f64, f64), [y0, y1, z]: [&[f64]; 3]) {
    for (((w, y0), y1), z) in w.iter_mut().zip(y0).zip(y1).zip(z) {
        *w = y0 - c0 + a * y1 - b * z;
    }
}

/// `w += gain * v`.
#[inline]
pub(super) fn add_scaled(w: &mut [f64], gain: f64, v: &[f64]) {
    for (w, v) in w.iter_mut().zip(v) {
        *w += gain * v;
    }
}

/// The coefficients of `e[k+1]` on the errors before `e[k]`, from `e[k]` put into the recursion of `e[k+1]`.
///
/// With them two samples are computed at once, and the second need not wait for the first.
#[inline]
fn two_steps_ahead<const P: usize>(c: [f64; P]) -> [f64; P] {
    std::array::from_fn(|l| c[0] * c[l] - c.get(l + 1).copied().unwrap_or(0.0))
}

/// `out = w / C` from rest, four samples at a time, so that a sample does not wait for its neighbour.
#[inline]
pub(super) fn whiten<const P: usize>(c: [f64; P], w: &[f64], out: &mut [f64]) {
    // The response of four samples of 1/C to one input, and to each past error.
    let mut impulse = [1.0, 0.0, 0.0, 0.0];
    let mut free = [[0.0; 4]; P];
    for k in 0..4 {
        let carried = |before: &[f64; 4]| (0..P.min(k)).map(|l| c[l] * before[k - 1 - l]).sum::<f64>();
        if k > 0 {
            impulse[k] = -carried(&impulse);
        }
        for (p, free) in free.iter_mut().enumerate() {
            free[k] = -carried(free) - c.get(p + k).copied().unwrap_or(0.0);
        }
    }
    let [_, p1, p2, p3] = impulse;
    let mut past = [0.0; P];
    let (blocks, last) = w.as_chunks::<4>();
    let (out_blocks, out_last) = out[..w.len()].as_chunks_mut::<4>();
    for (&[w0, w1, w2, w3], out) in blocks.iter().zip(out_blocks) {
        let mut e = [w0, w1 + p1 * w0, w2 + (p1 * w1 + p2 * w0), (w3 + p1 * w2) + (p2 * w1 + p3 * w0)];
        // The newest error is added last, because it is the last that the block before computes.
        for l in (0..P).rev() {
            for (e, free) in e.iter_mut().zip(free[l]) {
                *e += free * past[l];
            }
        }
        for (l, past) in past.iter_mut().enumerate() {
            *past = e[3 - l];
        }
        *out = e;
    }
    for (w, out) in last.iter().zip(out_last) {
        let e = (0..P).rev().fold(*w, |e, l| e - c[l] * past[l]);
        past.rotate_right(1);
        past[0] = e;
        *out = e;
    }
}

/// Four signals, each divided by C from rest, side by side, because the recursion of one alone leaves the processor idle.
#[multiversion(targets("x86_64+avx2"))]
pub(super) fn filter4<const P: usize>(c: [f64; P], inputs: [&[f64]; 4], outputs: [&mut [f64]; 4]) {
    let n = inputs[0].len();
    let [i0, i1, i2, i3] = inputs.map(|v| &v[..n]);
    let [o0, o1, o2, o3] = outputs.map(|v| &mut v[..n]);
    let ahead = two_steps_ahead(c);
    let mut past = [[0.0; 4]; P];
    let mut k = 0;
    while k + 1 < n {
        let now = [i0[k], i1[k], i2[k], i3[k]];
        let next = [i0[k + 1], i1[k + 1], i2[k + 1], i3[k + 1]];
        let (mut e0, mut e1) = (now, [0.0; 4]);
        for lane in 0..4 {
            e1[lane] = next[lane] - c[0] * now[lane];
        }
        for l in (0..P).rev() {
            for lane in 0..4 {
                e0[lane] -= c[l] * past[l][lane];
                e1[lane] += ahead[l] * past[l][lane];
            }
        }
        for l in (2..P).rev() {
            past[l] = past[l - 2];
        }
        if P > 1 {
            past[1] = e0;
        }
        past[0] = e1;
        [o0[k], o1[k], o2[k], o3[k]] = e0;
        [o0[k + 1], o1[k + 1], o2[k + 1], o3[k + 1]] = e1;
        k += 2;
    }
    if k < n {
        let now = [i0[k], i1[k], i2[k], i3[k]];
        [o0[k], o1[k], o2[k], o3[k]] =
            std::array::from_fn(|lane| (0..P).rev().fold(now[lane], |e, l| e - c[l] * past[l][lane]));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::armax::splits;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    fn signal(seed: u64, n: usize) -> Vec<f64> {
        StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(seed)).take(n).collect()
    }

    fn bits(v: &[f64]) -> Vec<u64> {
        v.iter().map(|v| v.to_bits()).collect()
    }

    /// Every split of the orders, sample by sample.
    #[test]
    fn terms_add_up_as_sample_by_sample_to_the_last_bit() {
        for n in [0, 1, 7, 8, 9, 17, 513, 1535] {
            let (of_y, of_z, gains) = (signal(1, n + ORDER), signal(2, n + ORDER), signal(3, 2 * ORDER));
            let y = |lag: usize| &of_y[ORDER - lag..ORDER - lag + n];
            let z = |lag: usize| &of_z[ORDER - lag..ORDER - lag + n];
            for orders in splits(2) {
                let mut theta = Theta { c0: 0.3, ..Theta::default() };
                theta.a[..orders.na].copy_from_slice(&gains[..orders.na]);
                theta.b[..orders.nb].copy_from_slice(&gains[ORDER..ORDER + orders.nb]);
                let (a, b) = (&theta.a[..orders.na], &theta.b[..orders.nb]);
                let of_a = (1..orders.na).map(|i| (a[i], y(i + 1)));
                let rest: Vec<(f64, &[f64])> =
                    of_a.chain((1..orders.nb).map(|j| (-b[j], z(orders.nk + j)))).collect();
                let plain = (0..n).map(|k| {
                    let mut w = y(0)[k] - theta.c0 + a[0] * y(1)[k] - b[0] * z(orders.nk)[k];
                    for terms in rest.chunks(2) {
                        w += match *terms {
                            [(gain, v), (other_gain, other)] => gain * v[k] + other_gain * other[k],
                            _ => terms[0].0 * terms[0].1[k],
                        };
                    }
                    w
                });
                let plain: Vec<f64> = plain.collect();
                let mut found = vec![0.0; n];
                combine(&mut found, orders, &theta, y, z);
                assert_eq!(bits(&found), bits(&plain), "{n} {orders:?}");
            }
        }
    }

    fn four_are_those_alone<const P: usize>(c: [f64; P]) {
        for n in [0, 1, 7, 8, 9, 17, 513, 1535] {
            let signals: [Vec<f64>; 4] = std::array::from_fn(|lane| signal(lane as u64, n));
            let mut found = signals.clone();
            let outputs = found.each_mut().map(Vec::as_mut_slice);
            filter4(c, signals.each_ref().map(Vec::as_slice), outputs);
            let ahead = two_steps_ahead(c);
            for (signal, found) in signals.iter().zip(&found) {
                let (mut past, mut plain) = ([0.0; P], Vec::<f64>::new());
                for pair in signal.chunks(2) {
                    let (mut e0, mut e1) = (pair[0], pair[pair.len() - 1] - c[0] * pair[0]);
                    for l in (0..P).rev() {
                        e0 -= c[l] * past[l];
                        e1 += ahead[l] * past[l];
                    }
                    plain.extend(&[e0, e1][..pair.len()]);
                    past.rotate_right(2 % P);
                    past[P.min(2) - 1] = e0;
                    past[0] = e1;
                }
                assert_eq!(bits(found), bits(&plain), "{P} {n}");
            }
        }
    }

    #[test]
    fn signals_side_by_side_are_those_alone_to_the_last_bit() {
        four_are_those_alone([-0.9]);
        four_are_those_alone([-1.6, 0.7]);
        four_are_those_alone([-0.4, 0.3, -0.1]);
        four_are_those_alone([0.5, -0.2, 0.1, 0.05]);
    }
}
