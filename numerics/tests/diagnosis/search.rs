//! The search against evaluating everything: the grid pass ends at the f of the full fine grid, and the refined
//! profile at the f of refining every cell.

use super::common::labelled::labelled;
use super::common::measured::{FOLDER, readable};
use super::common::parallel;
use super::common::pose::pose;
use super::common::records::simulated;
use stictiond_numerics::diagnosis::armax::{LOSS_FLOOR, Lag, Workspace};
use stictiond_numerics::diagnosis::friction::{Cell, stick_slip};
use stictiond_numerics::diagnosis::grid::GRID;
use stictiond_numerics::diagnosis::screen::Screen;
use stictiond_numerics::diagnosis::search::{CellPoint, Problem, Refined, Searcher};
use stictiond_numerics::sim::scenarios::{calibration, random_sound, random_sticky, table2};

/// A search problem with its name.
type Named = (String, Problem);

/// Measured records compared here: every verdict and type among them.
const MEASURED: [&str; 11] = [
    "CHEM1",
    "CHEM10",
    "CHEM13",
    "CHEM23",
    "PAP2",
    "S_2111FIC46005_0902_0003",
    "N_2111LIC31102B_0827_0008",
    "N_2411LIC30102_0825_0008",
    "N_2111LIC31102B_0904_0008",
    "S_2111FIC46005_0614_0003",
    "S_2411FIC20102_0609_0957",
];

/// The paper's level loops, random ones, and measured ones where they are: sticky ones first.
fn problems() -> Vec<Named> {
    let simulated = table2()
        .into_iter()
        .filter(|scenario| scenario.truth.kind.starts_with("level"))
        .chain((0..4).map(calibration))
        .chain((0..3).map(random_sticky))
        .chain((0..3).map(random_sound))
        .map(|scenario| (scenario.truth.kind.clone(), simulated(&scenario)));
    let measured = labelled(FOLDER, readable).into_iter().map(|(row, record)| (row[1].clone(), record));
    let measured = measured.filter(|(name, _)| MEASURED.contains(&name.as_str()));
    let named = |(name, record)| pose(&record).map(|(problem, _)| (name, problem));
    simulated.chain(measured).filter_map(named).collect()
}

/// Records on which the grid pass ends at another f today, and how far off in N ln V at the most: a structure that
/// the screening ranks low wins the full grid there. The worst known records are among these; the goal is none.
const APART: usize = 3;
const NEARLY: f64 = 30.0;

/// One value of f with its least loss.
#[derive(Clone, Copy, Debug)]
struct Point {
    f: f64,
    cell: Cell,
    loss: f64,
}

/// Every f, every split, every delay by prediction error.
fn full_grid(p: &Problem) -> Vec<Point> {
    let n = p.y.len();
    let (mut x, mut dir) = (vec![0.0; n], vec![0.0; n]);
    let mut screen = Screen::new(&p.y, p.counted(), p.max_delay);
    let mut work = Workspace::new(n);
    let mut points: Vec<Point> = Vec::new();
    for i in 0..GRID {
        let f = p.f_top * i as f64 / (GRID - 1) as f64;
        let cell = stick_slip(&p.u, f, 0.0, p.start, &mut x, &mut dir);
        let known = points.last().filter(|last| last.cell == cell).map(|last| last.loss);
        let loss = known.unwrap_or_else(|| {
            let s = p.signals(&x, &dir);
            screen.load(&s, false);
            screen.load_errors(&s, 0.0);
            let mut least = f64::INFINITY;
            screen.fit_all(|c| {
                least = least.min(work.minimise(&s, c.orders, c.theta, Lag::Fixed, 1e-5, 12).loss);
            });
            least + LOSS_FLOOR
        });
        points.push(Point { f, cell, loss });
    }
    points
}

fn least(points: &[Point]) -> Point {
    *points.iter().min_by(|a, b| a.loss.total_cmp(&b.loss)).expect("a grid has points")
}

#[test]
fn the_grid_pass_ends_where_the_full_grid_does() {
    let problems = problems();
    let compared = parallel::each(&problems, |(_, p)| {
        let full = full_grid(p);
        let mut searcher = Searcher::new(p);
        let fast: Vec<Point> = searcher
            .grid(GRID)
            .iter()
            .zip(&full)
            .map(|(g, point)| Point { loss: g.loss, ..*point })
            .collect();
        (full, fast, searcher.fits)
    });
    let mut apart = Vec::new();
    for ((name, p), (full, fast, fits)) in problems.iter().zip(&compared) {
        let (a, b) = (least(full), least(fast));
        let distance = p.rows() * (b.loss / a.loss).ln();
        let at_full = fast.iter().find(|point| point.f == a.f).map_or(f64::NAN, |point| point.loss);
        let report = format!(
            "{name:60} full f {:.4} V {:.6e}; grid f {:.4} V {:.6e} (N ln {distance:+.2}; at the full f {at_full:.6e}); \
             {fits} fits",
            a.f, a.loss, b.f, b.loss
        );
        // Two values of f are the same where the full grid cannot tell them apart: the minimiser stops at 1e-5.
        let tied = full.iter().any(|point| point.f == b.f && point.loss <= a.loss * (1.0 + 1e-5));
        // A warm start may beat every cold one: then the full grid's own minimum is not the least.
        let same = a.cell == b.cell || tied || b.loss < a.loss;
        println!("{} {report}", if same { "same " } else { "APART" });
        assert!(same || distance < NEARLY, "{report}");
        if !same {
            apart.push(report);
        }
    }
    assert!(apart.len() <= APART, "{} of {}:\n{}", apart.len(), problems.len(), apart.join("\n"));
}

/// The elements of the search: the paper's and those that resume beyond a share of S.
const RESUMES: [f64; 6] = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0];
/// Cells wider than the range of f by this are all visited: there are far fewer than samples squared.
const EVERY: usize = 1_000_000_000;
/// Cells of the extended elements are refined within this distance in N ln V(long ARX) of the least, where the ARMAX
/// loss would have to be as much better than everywhere else; those of the paper's element all are.
const REACH: f64 = 40.0;

/// What the search minimises: both views of the noise together [N ln V].
fn score(p: &Problem, r: &Refined) -> f64 {
    p.rows() * ((r.fit.loss + LOSS_FLOOR).ln() + (r.long_loss + LOSS_FLOOR).ln())
}

/// The best of refining every cell of every element that the long ARX does not rule out, and how many.
fn exhaustive(p: &Problem) -> (Refined, usize, usize) {
    let mut searcher = Searcher::new(p);
    let cells: Vec<CellPoint> = RESUMES
        .iter()
        .flat_map(|&resume| searcher.profile(resume, 0.0, p.f_top, EVERY))
        .filter(|c| c.f() > 0.0)
        .collect();
    let least = cells.iter().map(|c| c.loss).fold(f64::INFINITY, f64::min);
    let is_near = |c: &&CellPoint| c.resume == 0.0 || p.rows() * (c.loss / least).ln() <= REACH;
    let near: Vec<&CellPoint> = cells.iter().filter(is_near).collect();
    let best = near
        .iter()
        .map(|c| searcher.refine_at(c.f(), c.resume, c.lag))
        .min_by(|a, b| score(p, a).total_cmp(&score(p, b)))
        .expect("a window with reversals has cells beyond 0");
    (best, near.len(), cells.len())
}

#[test]
fn the_refined_profile_ends_where_refining_every_cell_does() {
    // A dozen sticky ones of about 1,000 samples: elsewhere the best f is whatever the noise likes, and no verdict
    // rests on it; on longer windows every cell takes minutes.
    let known =
        ["level control (weak stiction)", "level control (strong stiction)", "CHEM1", "CHEM10", "PAP2"];
    let problems: Vec<Named> = problems()
        .into_iter()
        .filter(|(name, _)| known.contains(&name.as_str()) || name.contains("J ="))
        .collect();
    let compared = parallel::each(&problems, |(_, p)| {
        let mut searcher = Searcher::new(p);
        let grid = searcher.grid(GRID);
        let cells = searcher.full_profile();
        let (_, sticky) = searcher.refine(&grid, &cells);
        (exhaustive(p), sticky)
    });
    let mut apart = Vec::new();
    for ((name, p), ((full, refined, cells), sticky)) in problems.iter().zip(&compared) {
        let Some(fast) = sticky else {
            apart.push(format!("{name}: no sticky model at all"));
            continue;
        };
        let report = format!(
            "{name:60} every cell: f {:.4} (J/S {}) score {:.2}; search: f {:.4} (J/S {}) score {:+.2}; \
             {refined} of {cells} cells refined",
            full.f,
            full.resume,
            score(p, full),
            fast.f,
            fast.resume,
            score(p, fast) - score(p, full)
        );
        // Half a unit of N ln V is no preference: AIC asks two for a parameter.
        let same = fast.cell == full.cell || score(p, fast) - score(p, full) < 0.5;
        println!("{} {report}", if same { "same " } else { "APART" });
        if !same {
            apart.push(report);
        }
    }
    assert!(apart.is_empty(), "{} of {}:\n{}", apart.len(), problems.len(), apart.join("\n"));
}
