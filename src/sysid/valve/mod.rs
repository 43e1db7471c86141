//! The valve models: their parameters in `model`, their recursion in `recursion`, eight valves side by side in [`batch`].
//!
//! | symbol | what it is | unit |
//! |---|---|---|
//! | `S` | dead band plus stick band | OP |
//! | `J` | slip jump | OP |
//! | `f` | the paper's parameter, `S/2` | OP |
//! | `r` | resolution: a moving stem comes to rest where OP goes on by no more than r | OP |
//!
//! The paper's element has `J = S` and rests at reversals only.
//! The [`StopRule`] says what counts as a rest: the models of the literature differ in it.
//!
//! Sources: Choudhury et al., Control Eng. Practice 2005, 13, 641; Kano et al., IFAC DYCOPS 2004; He et al., Ind. Eng.
//! Chem. Res. 2007, 46, 4549; Stenman et al., Int. J. Adapt. Control 2003, 17, 251; Ivan & Lakshminarayanan 2009.

pub mod batch;
mod model;
pub mod model_error;
mod recursion;

pub use model::{Rest, Start, StopRule, ValveModel, largest_move, largest_reversal, reversals};
pub use recursion::growth;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn run(valve: ValveModel, u: &[f64], start: Start) -> (Vec<f64>, Vec<f64>) {
        let (mut x, mut dir) = (Vec::new(), Vec::new());
        valve.run(u, start, u.len(), &mut x, &mut dir);
        (x, dir)
    }

    const MAX_AT_1: Start = Start { index: 1, is_max: true };

    #[test]
    fn the_papers_element_sticks_for_2f_on_a_reversal_and_then_follows() {
        let u = [0.0, 3.0, 2.0, 1.0, 0.5, 0.0, -1.0, -0.5, 0.0, 1.0, 1.5, 2.0];
        let (x, dir) = run(ValveModel::one_parameter(1.0), &u, MAX_AT_1);
        assert_eq!(x, [0.0, 3.0, 3.0, 3.0, 0.5, 0.0, -1.0, -1.0, -1.0, -1.0, 1.5, 2.0]);
        assert_eq!(reversals(&dir), 2);
    }

    #[test]
    fn a_stem_at_rest_goes_on_beyond_its_slip_jump() {
        // S = 2, J = 1: the stem trails by 0.5; it rests at 3, OP is 0.5 ahead at 3.5, it goes on at 4.5.
        let valve = ValveModel { s: 2.0, j: 1.0, rule: StopRule::Stop, ..ValveModel::default() };
        let u = [0.0, 3.0, 2.5, 3.5, 4.5, 5.0, 2.5];
        assert_eq!(run(valve, &u, MAX_AT_1).0, [-0.5, 2.5, 2.5, 2.5, 4.0, 4.5, 3.0]);
        // He's rests after each slip: 5.0 is 0.5 ahead only.
        let he = ValveModel { rule: StopRule::Slip, ..valve };
        assert_eq!(run(he, &u, MAX_AT_1).0, [-0.5, 2.5, 2.5, 2.5, 4.0, 4.0, 4.0]);
    }

    #[test]
    fn a_band_that_differs_is_wider_on_one_side() {
        let u = [0.0, 4.0, 1.5, 0.5, 2.0, 3.6];
        let valve = ValveModel { asymmetry: 0.5, ..ValveModel::one_parameter(1.0) };
        // Down takes more than 3, up more than 1.
        assert_eq!(run(valve, &u, MAX_AT_1).0, [0.0, 4.0, 4.0, 0.5, 2.0, 3.6]);
    }

    #[test]
    fn a_stem_at_its_stop_leaves_it_when_the_force_has_turned() {
        // S = 2, J = 1, a stop at 3: the stem is there from OP 3.5 on, and leaves it where OP is below 3.5 - S.
        let valve =
            ValveModel { s: 2.0, j: 1.0, stops: Some((f64::NEG_INFINITY, 3.0)), ..ValveModel::default() };
        let u = [0.0, 1.0, 3.0, 5.0, 4.0, 2.0, 1.6, 1.4, 1.0];
        assert_eq!(
            run(valve, &u, Start { index: 0, is_max: true }).0,
            [-0.5, 0.5, 2.5, 3.0, 3.0, 3.0, 3.0, 1.9, 1.5]
        );
    }

    #[test]
    fn the_largest_reversal_ends_the_search() {
        let u = [0.0, 3.0, 1.0, 4.0, 1.5, 2.0];
        assert_eq!(largest_reversal(&u, MAX_AT_1), 1.25);
        assert_eq!(largest_reversal(&u, Start { index: 2, is_max: false }), 1.5);
        assert_eq!(largest_reversal(&u, Start { index: 9, is_max: true }), 0.0);
    }

    #[test]
    fn the_largest_move_is_that_of_either_direction() {
        // From a maximum OP falls by 3, then rises by 10.
        let u = [0.0, 5.0, 2.0, 12.0, 11.0];
        assert_eq!((largest_reversal(&u, MAX_AT_1), largest_move(&u, 1)), (1.5, 5.0));
        assert_eq!(largest_move(&u.map(|u| -u), 1), 5.0);
        assert_eq!(largest_move(&u, 9), 0.0);
    }

    /// The element as the paper's figure 3 states it.
    fn paper(u: &[f64], f: f64, start: Start) -> Vec<f64> {
        let mut x = u.to_vec();
        let mut residual = if start.is_max { f } else { -f };
        for k in start.index + 1..u.len() {
            let cum = residual + (u[k] - u[k - 1]);
            if cum.abs() > f {
                x[k] = u[k];
                residual = cum.signum() * f;
            } else {
                x[k] = x[k - 1];
                residual = cum;
            }
        }
        x
    }

    proptest! {
        // Steps of 1/8 keep both statements exact in floating point, so they must agree to the bit.
        #[test]
        fn agrees_with_the_paper(steps in prop::collection::vec(-16i32..=16, 2..200), f in 1i32..40, max: bool) {
            let u: Vec<f64> = steps.iter().scan(0, |s, d| { *s += d; Some(f64::from(*s) / 8.0) }).collect();
            let (start, f) = (Start { index: 0, is_max: max }, f64::from(f) / 8.0);
            prop_assert_eq!(run(ValveModel::one_parameter(f), &u, start).0, paper(&u, f, start));
        }
    }
}
