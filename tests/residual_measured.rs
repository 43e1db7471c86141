//! Measured records: the error before and after what was found, and that no record is predicted worse for it.

mod diagnosis_common {
    pub mod measured;
    pub mod parallel;
}

use diagnosis_common::measured::measured;
use diagnosis_common::parallel;
use stictiond::diagnosis::{Settings, diagnose};
use stictiond::residual::{self, trace_record};

#[test]
fn measured_records_are_never_predicted_worse() {
    let loops = measured();
    if loops.is_empty() {
        return;
    }
    let settings = Settings::default();
    let found = parallel::each(&loops, |(_, record)| {
        let d = diagnose(record, &settings);
        let found = trace_record(record, &d, &settings, &residual::Settings::default());
        (d, found)
    });
    let (mut traced, mut better) = (0, 0);
    println!(
        "{:34} {:10} {:>9} {:>9} {:>9} {:>9} effects",
        "record", "label", "one", "after", "free", "after"
    );
    for ((row, _), (d, found)) in loops.iter().zip(&found) {
        let Some(f) = found else {
            println!("{:34} {:10} {} {}", row[1], row[6], d.verdict.as_str(), d.reason);
            continue;
        };
        traced += 1;
        let names: Vec<String> =
            f.effects.iter().map(|e| format!("{}({:.0})", e.kind, e.delta_aic)).collect();
        println!(
            "{:34} {:10} {:>9.4} {:>9.4} {:>9.4} {:>9.4} {} | {}->{} f {:.3}->{:.3}",
            row[1],
            row[6],
            f.before.one_step_rmse,
            f.after.one_step_rmse,
            f.before.free_run_rmse,
            f.after.free_run_rmse,
            names.join(" "),
            d.verdict.as_str(),
            f.verdict.as_str(),
            f.friction_before.f,
            f.friction_after.f
        );
        assert!(f.after.free_run_rmse <= f.before.free_run_rmse * 1.0001, "{}", row[1]);
        better += usize::from(f.after.free_run_rmse < 0.999 * f.before.free_run_rmse);
    }
    println!("better on {better} of {} ({traced} traced)", loops.len());
    assert!(3 * better >= loops.len(), "{better}");
}
