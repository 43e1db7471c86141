//! How many methods agree with one another and with the program's verdict, and whether they cast doubt on the verdict.

use super::opinion::{Method, Opinion, Says};

/// Fewest methods that must contradict the verdict for a doubt.
pub const LEAST_CONTRADICTING: usize = 4;
/// Least share of the methods that could tell which must contradict it (-).
pub const SHARE_CONTRADICTING: f64 = 0.8;

/// The opinions, counted.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Agreement {
    /// Methods that say that the valve sticks.
    pub sticks: usize,
    /// Methods that could tell.
    pub could_tell: usize,
    /// Methods that agree with the program's verdict; 0 where the verdict cannot tell.
    pub agree: usize,
    /// Whether the measured stem contradicts the verdict.
    pub by_stem: bool,
    /// Whether the verdict is doubtful, so that somebody should inspect the loop.
    pub doubtful: bool,
    /// The counts in one line.
    pub why: String,
}

/// Counts the opinions, and compares them with a verdict.
///
/// A verdict is doubtful where the measured stem contradicts it; that method is a measurement, and is not counted among the others.
/// It is doubtful, too, where the cycle is regular and at least `LEAST_CONTRADICTING` methods contradict the verdict, which are a
/// share of `SHARE_CONTRADICTING` of those that could tell. The methods share their blind spots, so that two of them may agree by
/// chance. Without a regular cycle there is no doubt, because most of the methods need one.
///
/// Both limits are calibrated (`numerics/examples/opinions -- --calibrate`): of the right verdicts on simulated loops with a regular
/// cycle fewer than 1 % are doubted. A needless doubt costs a day of work.
///
/// * `verdict_sticks`: the verdict; none where it cannot tell.
/// * `regular`: whether the loop has a regular cycle.
pub fn agreement(opinions: &[Opinion], verdict_sticks: Option<bool>, regular: bool) -> Agreement {
    let counted = || opinions.iter().filter(|o| o.method != Method::StemLoop && o.says != Says::CannotTell);
    let could_tell = counted().count();
    let sticks = counted().filter(|o| o.says == Says::Sticks).count();
    let mut why = match (sticks, could_tell) {
        (_, 0) => "no method could tell".to_string(),
        (0, 1) => "the only method that could tell says that the valve does not stick".to_string(),
        (_, 1) => "the only method that could tell says that the valve sticks".to_string(),
        (1, _) => format!("1 of {could_tell} that could tell says that the valve sticks"),
        _ => format!("{sticks} of {could_tell} that could tell say that the valve sticks"),
    };
    let Some(verdict) = verdict_sticks else {
        return Agreement { sticks, could_tell, why, ..Agreement::default() };
    };
    let against = if verdict { could_tell - sticks } else { sticks };
    let stem = opinions.iter().find(|o| o.method == Method::StemLoop).map(|o| o.says);
    let by_stem = stem == Some(if verdict { Says::Sound } else { Says::Sticks });
    let many = against >= LEAST_CONTRADICTING && against as f64 >= SHARE_CONTRADICTING * could_tell as f64;
    let doubtful = by_stem || (regular && many);
    if by_stem {
        why += "; the measured stem contradicts the verdict";
    } else if doubtful {
        why += "; on a regular cycle most of them contradict the verdict";
    }
    Agreement { sticks, could_tell, agree: could_tell - against, by_stem, doubtful, why }
}
