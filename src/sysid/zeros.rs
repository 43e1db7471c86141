//! The zeros of a polynomial `1 + c1 q^-1 + … + cn q^-n`: whether they lie inside a circle, and how they are kept there.

use nalgebra::Complex;
use std::f64::consts::TAU;

/// Largest order of a polynomial.
pub const ORDER: usize = 6;

/// Share of the radius by which a zero that was moved lies inside, so that rounding does not put it outside again.
pub const MARGIN: f64 = 1e-6;

/// Whether every zero of `1 + c1 q^-1 + …` has `|q| < radius` (Schur–Cohn test by the step-down recursion).
pub fn is_inside(c: &[f64], radius: f64) -> bool {
    let mut poly = [0.0; ORDER];
    let mut scale = 1.0;
    for (slot, &c) in poly.iter_mut().zip(c) {
        scale /= radius;
        *slot = c * scale;
    }
    let mut n = c.len().min(ORDER);
    while n > 0 {
        let k = poly[n - 1];
        if k.is_nan() || k.abs() >= 1.0 {
            return false;
        }
        let previous = poly;
        for i in 0..n - 1 {
            poly[i] = (previous[i] - k * previous[n - 2 - i]) / (1.0 - k * k);
        }
        n -= 1;
    }
    true
}

/// Moves every zero of `1 + c1 q^-1 + …` outside `|q| = radius` to that radius at the same angle; the other zeros stay.
///
/// Where the zeros cannot be computed, all coefficients become 0.
pub fn draw_inside(c: &mut [f64], radius: f64) {
    if is_inside(c, radius) {
        return;
    }
    let zeros = c.iter().all(|c| c.is_finite()).then(|| zeros(c)).flatten();
    let Some(zeros) = zeros else {
        c.fill(0.0);
        return;
    };
    let mut poly = [Complex::new(0.0, 0.0); ORDER + 1];
    poly[0] = Complex::new(1.0, 0.0);
    let inside = radius * (1.0 - MARGIN);
    for (i, zero) in zeros[..c.len()].iter().enumerate() {
        let zero = if zero.norm() > inside { zero * (inside / zero.norm()) } else { *zero };
        for j in (0..=i).rev() {
            let low = poly[j];
            poly[j + 1] -= low * zero;
        }
    }
    for (c, p) in c.iter_mut().zip(&poly[1..]) {
        *c = p.re;
    }
    // Rounding may leave a multiple zero outside. Then all zeros are scaled together.
    while !is_inside(c, radius) {
        let mut power = 1.0;
        for c in c.iter_mut() {
            power *= 1.0 - 1e-4;
            *c *= power;
        }
    }
}

/// The zeros of `1 + c1 q^-1 + …`: of two coefficients by the quadratic formula, else by the Durand–Kerner iteration.
///
/// `None` where the iteration diverges.
pub fn zeros(c: &[f64]) -> Option<[Complex<f64>; ORDER]> {
    let n = c.len().min(ORDER);
    if n == 2 {
        let (half, root) = (-0.5 * c[0], Complex::new(0.25 * c[0] * c[0] - c[1], 0.0).sqrt());
        let mut zeros = [Complex::new(0.0, 0.0); ORDER];
        (zeros[0], zeros[1]) = (half + root, half - root);
        return Some(zeros);
    }
    // The starts lie on half of Cauchy's bound.
    let bound = 1.0 + c.iter().fold(0.0f64, |most, c| most.max(c.abs()));
    let mut zeros: [Complex<f64>; ORDER] =
        std::array::from_fn(|i| Complex::from_polar(0.5 * bound, 0.4 + i as f64 * TAU / n.max(1) as f64));
    for _ in 0..200 {
        let mut moved = 0.0f64;
        for i in 0..n {
            let z = zeros[i];
            let value = c[..n].iter().fold(Complex::new(1.0, 0.0), |value, c| value * z + c);
            let others = (0..n).filter(|&j| j != i);
            let product = others.fold(Complex::new(1.0, 0.0), |product, j| product * (z - zeros[j]));
            let step = value / product;
            if !step.re.is_finite() || !step.im.is_finite() {
                return None;
            }
            zeros[i] -= step;
            moved = moved.max(step.norm());
        }
        if moved < 1e-13 * bound {
            return Some(zeros);
        }
    }
    // A double zero converges slowly. Its error is then far below what a step of the minimisation moves.
    Some(zeros)
}

/// The derivative of the modulus of a simple zero z by each coefficient: `d|z|/dc_l`, into `row`.
///
/// With `P(q) = q^n + c1 q^(n-1) + …` it is the part of `dz/dc_l = -z^(n-l) / P'(z)` along z.
/// It is not finite for a multiple zero.
pub fn outward(c: &[f64], zero: Complex<f64>, row: &mut [f64]) {
    let n = c.len();
    let mut slope = Complex::new(n as f64, 0.0);
    for (i, c) in c[..n - 1].iter().enumerate() {
        slope = slope * zero + c * (n - 1 - i) as f64;
    }
    let direction = -zero.conj() / (zero.norm() * slope);
    let mut power = Complex::new(1.0, 0.0);
    for slot in row[..n].iter_mut().rev() {
        *slot = (direction * power).re;
        power *= zero;
    }
}
