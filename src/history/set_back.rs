//! What the rings of a loop hold since the clock was last set back.
//!
//! A tag that is polled shows it: its stamps fall. One that is reported only when it changes may have said nothing since. Its
//! ring then ends with what is in force, under a stamp that the clock has yet to reach again.

use crate::signal::Sample;

/// What a ring holds since its stamps last fell.
pub struct Since {
    /// The last sample before they fell; `None` where they never did.
    before: Option<Sample>,
    /// The samples since, in order of arrival.
    pub samples: Vec<Sample>,
}

impl Since {
    /// Of all that a ring holds, in order of arrival.
    pub fn of(mut samples: Vec<Sample>) -> Self {
        let Some(last) = samples.windows(2).rposition(|pair| pair[1].t < pair[0].t) else {
            return Self { before: None, samples };
        };
        let since = samples.split_off(last + 1);
        Self { before: samples.pop(), samples: since }
    }
}

/// The samples, in order of arrival, since the clock was last set back: nobody knows how the stamps before and after
/// belong together, and sorted into each other they would be a record of something that never happened.
pub fn since_set_back(samples: Vec<Sample>) -> Vec<Sample> {
    Since::of(samples).samples
}

/// Where the clock was set back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SetBack {
    /// The last stamp before (s).
    from: f64,
    /// The first stamp after it (s).
    to: f64,
}

impl SetBack {
    /// As OP and PV show it, which are the ones that a window is made of; `None` where neither fell.
    pub fn of<'s>(measured: impl Iterator<Item = &'s Since>) -> Option<Self> {
        let fell = measured.filter_map(|since| {
            let (before, first) = (since.before?, since.samples.first()?);
            Some(Self { from: before.t, to: first.t })
        });
        fell.reduce(|a, b| Self { from: a.from.max(b.from), to: a.to.max(b.to) })
    }

    /// What a tag of the loop has to say of the time since. What was in force then is stamped as of the first moment after it,
    /// for under its own stamp it would take effect in the middle of the new record.
    pub fn across(&self, Since { before, samples }: Since, is_measured: bool) -> Vec<Sample> {
        // A ring may still show another fall, long before this one.
        let (in_force, since) = match before.filter(|before| before.t > self.to) {
            // OP and PV were measured anew.
            Some(_) if is_measured => return samples,
            Some(before) => (Some(before), &samples[..]),
            None => {
                // What is measured shows a fall with its next sample; where its stamps are a server's, it never falls.
                let is_old = |s: &Sample| if is_measured { s.t < self.to } else { s.t <= self.from };
                let (old, new) = samples.split_at(samples.partition_point(is_old));
                (old.last().copied(), new)
            }
        };
        let unknown = since.first().is_none_or(|first| first.t > self.to);
        let carried = in_force.filter(|_| unknown).map(|own| Sample { t: self.to, ..own });
        carried.into_iter().chain(since.iter().copied()).collect()
    }
}
