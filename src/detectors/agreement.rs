//! How the methods agree, with one another and with the program's verdict.

use super::opinion::{Method, Opinion, Says};

/// Methods that have to contradict the verdict, at least.
pub const LEAST_CONTRADICTING: usize = 4;
/// Share of the methods that could tell which have to contradict it.
pub const SHARE_CONTRADICTING: f64 = 0.8;

/// Who says what.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Agreement {
    /// Methods that say that the valve sticks.
    pub sticks: usize,
    /// Methods that could tell.
    pub could_tell: usize,
    /// Methods that say what the program's verdict says; none where that cannot tell.
    pub agree: usize,
    /// True where the measured stem, which is no guess, contradicts the verdict.
    pub by_stem: bool,
    /// True where the methods contradict the program's verdict so that somebody should look at the loop.
    pub doubtful: bool,
    /// The same in one line.
    pub why: String,
}

/// Counts the opinions, and holds them against a verdict on a loop whose cycle is regular or not.
///
/// The two numbers keep the doubted among the right verdicts below 1 % on simulated loops with a regular cycle
/// (`numerics/examples/opinions -- --calibrate`): a doubt that is raised without need costs a day.
/// The measured stem is not counted: it is no guess. Where it contradicts the verdict, that is enough. Otherwise most of those
/// that could tell have to, and several of them: the methods share their blind spots, so that two of them agree by chance.
/// Without a regular cycle there is no doubt, since most of the methods were made for one.
pub fn agreement(opinions: &[Opinion], verdict_sticks: Option<bool>, regular: bool) -> Agreement {
    let counted = || opinions.iter().filter(|o| o.method != Method::StemLoop && o.says != Says::CannotTell);
    let could_tell = counted().count();
    let sticks = counted().filter(|o| o.says == Says::Sticks).count();
    let mut why = match could_tell {
        0 => "no method could tell".to_string(),
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
