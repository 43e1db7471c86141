//! Verdicts on sticking loops of whose samples a tenth is lost. `numerics/examples/holes.rs` measures it on a hundred.

#[path = "common/acquired.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod acquired;
#[path = "common/generators/mod.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod generators;
#[path = "common/parallel.rs"]
mod parallel;

use acquired::{draw, judge, kinds_of_gaps, with_gaps};
use stictiond_numerics::sim::acquisition::Gaps;

/// Sticking loops of the three generators; the first seeds of those that the method was developed on.
const LOOPS: usize = 8;
const FIRST: u64 = 6100;
/// Evidence beyond which a tenth of the rows cannot be what a verdict hangs on: twice the limit.
const CLEAR: f64 = 40.0;

#[test]
fn a_tenth_of_the_samples_is_not_missed() {
    let drawn = (0..).map(|i| draw(i, FIRST + i)).filter(|own| own.f > 0.0).take(LOOPS);
    let of_one = |own: acquired::Loop| -> Vec<(String, bool)> {
        let whole = judge(&own, &with_gaps(&own, Gaps::None));
        if !whole.sticks() || whole.evidence < CLEAR {
            return Vec::new();
        }
        let kinds = kinds_of_gaps(10);
        let told = kinds.map(|(kind, gaps)| {
            let said = judge(&own, &with_gaps(&own, gaps));
            let right = said.sticks() && said.near(whole.f);
            (format!("{}, {kind}: f {:.3} / {:.3}; {}", own.name, whole.f, said.f, said.reason), right)
        });
        told.to_vec()
    };
    let told: Vec<(String, bool)> = parallel::each(drawn, of_one).into_iter().flatten().collect();
    let wrong: Vec<&String> = told.iter().filter(|(_, right)| !right).map(|(name, _)| name).collect();
    assert!(told.len() >= 12, "too few loops are clear: {}", told.len());
    assert!(wrong.is_empty(), "{} of {}: {wrong:#?}", wrong.len(), told.len());
}
