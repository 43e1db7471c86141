use super::*;
use crate::diagnosis::friction::largest_reversal;
use crate::diagnosis::grid::GRID;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// A noisy triangle through a sticking valve with f = 0.6 and no kinetic lag, into a first-order process.
fn problem(seed: u64, noise: f64) -> Problem {
    let n = 500;
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let mut uniform = move || rng.random::<f64>() - 0.5;
    let u: Vec<f64> = (0..n)
        .map(|k| 3.0 * (2.0 * ((k as f64 / 50.0).fract() - 0.5).abs() - 0.5) + 0.3 * uniform())
        .collect();
    let start = Start { index: 0, is_max: true };
    let (mut x, mut dir) = (vec![0.0; n], vec![0.0; n]);
    stick_slip(&u, 0.6, 0.0, start, &mut x, &mut dir);
    let mut y = vec![0.0; n];
    for k in 1..n {
        y[k] = 0.8 * y[k - 1] + 0.4 * x[k - 1] + noise * uniform();
    }
    let f_top = largest_reversal(&u, start);
    Problem { u, y, start, first: Screen::lead(3), max_delay: 3, f_top, holes: Holes::default() }
}

#[test]
fn the_profile_visits_every_cell_in_order() {
    let p = problem(1, 0.05);
    let points = Searcher::new(&p).profile(0.0, 0.0, p.f_top, 1_000_000);
    assert_eq!(points[0].cell.lo, 0.0);
    assert!(points.windows(2).all(|w| w[0].cell.hi == w[1].cell.lo), "the cells leave a gap");
    assert!(points.len() > 20 && points.iter().all(|c| c.f() >= c.cell.lo));
}

#[test]
fn the_least_of_the_profile_is_the_least_of_a_dense_grid() {
    for seed in 0..5 {
        let p = problem(seed, 0.05);
        let points = Searcher::new(&p).profile(0.0, 0.0, p.f_top, 1_000_000);
        let best = points.iter().min_by(|a, b| a.loss.total_cmp(&b.loss)).expect("cells");
        let n = p.y.len();
        let (mut x, mut dir) = (vec![0.0; n], vec![0.0; n]);
        let mut screen = Screen::new(&p.y, p.counted(), p.max_delay);
        let mut dense = (f64::INFINITY, 0.0);
        for i in 0..=4000 {
            let f = p.f_top * f64::from(i) / 4000.0;
            stick_slip(&p.u, f, 0.0, p.start, &mut x, &mut dir);
            if f > 0.0 && reversals(&dir) < LEAST_REVERSALS {
                break;
            }
            screen.load(&p.signals(&x, &dir), f > 0.0);
            let loss = screen.fit_lag(0.5 * f, f).loss;
            if loss < dense.0 {
                dense = (loss, f);
            }
        }
        // Both fit the lag from different starts, to a thousandth of f; the loss is flat there.
        assert!(best.loss <= dense.0 * 1.001 + LOSS_FLOOR, "{seed}: {} {dense:?}", best.loss);
        assert!((best.cell.lo..best.cell.hi).contains(&dense.1), "{seed}: {best:?} {dense:?}");
    }
}

#[test]
fn the_whole_search_finds_the_friction() {
    let p = problem(7, 0.02);
    let mut searcher = Searcher::new(&p);
    let grid = searcher.grid(GRID);
    let cells = searcher.full_profile();
    let (sound, sticky) = searcher.refine(&grid, &cells);
    let sticky = sticky.expect("a sticky model");
    assert_eq!(sound.f, 0.0);
    // f is known to a cell, and the cells of this OP are nowhere wider than its step, 0.12 and noise of 0.3.
    assert!((sticky.f - 0.6).abs() < 0.02, "{}", sticky.f);
    // The noise's variance is 0.02²/12, with a standard error of 10 % on 470 uniform values.
    assert!((sticky.fit.loss * 12.0 / 4e-4 - 1.0).abs() < 0.3, "{}", sticky.fit.loss);
    assert!(sound.fit.loss > 10.0 * sticky.fit.loss);
    assert!(searcher.screened >= 15 * 3 && searcher.fits > 0);
}

#[test]
fn best_cells_are_the_local_minima_of_each_element() {
    let point =
        |resume: f64, loss: f64| CellPoint { cell: Cell { lo: 0.0, hi: 1.0 }, resume, loss, lag: 0.0 };
    let cells: Vec<CellPoint> = [5.0, 3.0, 4.0, 1.0, 2.0]
        .map(|loss| point(0.0, loss))
        .into_iter()
        .chain([0.5, 2.0].map(|loss| point(0.2, loss)))
        .collect();
    assert_eq!(best_cells(&cells, 10), [5, 3, 1]);
    assert_eq!(best_cells(&cells, 2), [5, 3]);
}

/// Rounding may put the end of an extended element's cell on its beginning.
#[test]
fn the_profile_ends_where_a_cell_has_no_width() {
    let (f, resume) = (0.4, 0.6);
    let onward = (2.0_f64 * f * resume).next_up();
    assert!(onward * (0.5 / resume) <= f, "the cell has a width");
    let mut p = problem(1, 0.05);
    (p.u[0], p.u[1]) = (0.0, onward);
    assert_eq!(Searcher::new(&p).profile(resume, f, f, 10).len(), 1);
}
