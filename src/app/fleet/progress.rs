//! How far a stream has what an edge's store numbers, and whether it still has it. Pure. A server acknowledges a message before it
//! is on its disk. So a loss of power takes messages that were acknowledged, while the edge's cursor, which is in another stream,
//! may stay.

use crate::fleet::link::StreamState;
use crate::fleet::message::Progress;
use std::collections::VecDeque;
use std::time::Duration;

/// What a server has had for so long is on its disk: it writes through every two minutes at the latest, unless somebody has set a
/// longer `sync_interval`.
const ON_DISK: Duration = Duration::from_secs(300);
/// How far a stream was is noted no more often than this.
const STEP: Duration = Duration::from_secs(10);

/// What became of the last message that a stream has acknowledged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// It is there, or every reader has done it and it was deleted.
    Kept,
    /// The stream has lost it, and maybe some before it.
    Lost,
    /// The stream was made anew, and has nothing of what was sent.
    Anew,
}

/// How far one stream has what the store numbers.
#[derive(Clone, Debug, Default)]
pub(super) struct Way {
    progress: Progress,
    /// Numbers that the stream had, and when, on a steady clock; the oldest first.
    recent: VecDeque<(u64, Duration)>,
}

impl Way {
    /// As it was when an edge noted it last.
    pub(super) fn from(progress: Option<Progress>) -> Self {
        Self { progress: progress.unwrap_or_default(), recent: VecDeque::new() }
    }

    /// As it is to be noted.
    pub(super) fn progress(&self) -> Progress {
        self.progress
    }

    /// Number of the last that the stream has.
    pub(super) fn number(&self) -> u64 {
        self.progress.number
    }

    /// Number of the last message in the stream, where its being there is to be looked at.
    pub(super) fn sequence(&self) -> Option<u64> {
        Some(self.progress.sequence).filter(|sequence| *sequence > 0)
    }

    /// What the stream says: how it stands, and whether the message at the last place is ours; `None` where there is none. From
    /// now on the way begins where the stream surely is.
    pub(super) fn look(&mut self, stream: StreamState, is_ours: Option<bool>) -> Place {
        let made = i64::try_from(stream.made).unwrap_or(i64::MAX);
        let own = &mut self.progress;
        let place = match own.sequence {
            0 => Place::Kept,
            _ if own.made != made => Place::Anew,
            sequence if stream.last < sequence || is_ours == Some(false) => Place::Lost,
            _ => Place::Kept,
        };
        match place {
            Place::Kept => {}
            Place::Lost => (own.number, own.sequence) = (own.on_disk.min(own.number), 0),
            Place::Anew => *own = Progress::default(),
        }
        if place != Place::Kept {
            self.recent.clear();
        }
        self.progress.made = made;
        place
    }

    /// The stream has acknowledged everything up to `number`, the last of it as its message `sequence`.
    pub(super) fn kept(&mut self, number: u64, sequence: u64, now: Duration) {
        let own = &mut self.progress;
        if number < own.number {
            // The store was made anew, and numbers from 1 again.
            own.on_disk = 0;
            self.recent.clear();
        }
        (own.number, own.sequence) = (number, sequence);
        while let Some((number, at)) = self.recent.front()
            && now.saturating_sub(*at) >= ON_DISK
        {
            own.on_disk = *number;
            self.recent.pop_front();
        }
        if self.recent.back().is_none_or(|(_, at)| now.saturating_sub(*at) >= STEP) {
            self.recent.push_back((number, now));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SECOND: Duration = Duration::from_secs(1);
    const MADE: i128 = 1_767_225_600_000_000_000;

    fn stream(last: u64) -> StreamState {
        StreamState { made: MADE, last }
    }

    /// A way of which the stream has had 40 for long, and 45 since a moment ago, as its message 90.
    fn noted() -> Way {
        let mut way = Way::default();
        assert_eq!(way.look(stream(80), None), Place::Kept, "nothing was sent");
        way.kept(40, 85, SECOND);
        way.kept(45, 90, SECOND + ON_DISK);
        way
    }

    #[test]
    fn what_the_stream_has_or_every_reader_has_done_is_not_sent_again() {
        for is_ours in [Some(true), None] {
            let mut way = noted();
            assert_eq!(way.look(stream(95), is_ours), Place::Kept);
            assert_eq!((way.number(), way.sequence()), (45, Some(90)));
        }
    }

    #[test]
    fn what_a_server_lost_is_sent_again_from_what_was_on_its_disk() {
        // The stream ends before it, or its number was given to another message.
        for (last, is_ours) in [(89, None), (95, Some(false))] {
            let mut way = noted();
            assert_eq!(way.look(stream(last), is_ours), Place::Lost);
            assert_eq!((way.number(), way.sequence()), (40, None));
            assert_eq!(way.look(stream(last), None), Place::Kept, "once");
            // As an edge that is started later finds it.
            let mut way = Way::from(Some(noted().progress()));
            assert_eq!(way.look(stream(last), is_ours), Place::Lost);
            assert_eq!(way.number(), 40);
        }
    }

    #[test]
    fn of_a_stream_that_was_made_anew_everything_is_sent() {
        let mut way = noted();
        assert_eq!(way.look(StreamState { made: MADE + 1, last: 500 }, Some(true)), Place::Anew);
        assert_eq!((way.number(), way.sequence()), (0, None));
        way.kept(7, 3, 2 * ON_DISK);
        assert_eq!(way.look(StreamState { made: MADE + 1, last: 3 }, Some(true)), Place::Kept);
    }

    #[test]
    fn a_store_that_was_made_anew_is_sent_from_its_first_number_on_whatever_was_on_the_disk() {
        let mut way = noted();
        way.kept(3, 91, SECOND + ON_DISK);
        assert_eq!(way.look(stream(89), None), Place::Lost);
        assert_eq!(way.number(), 0);
    }

    proptest! {
        /// Whatever was sent when: at a loss everything is sent again that is younger than a server needs for its disk, and not
        /// much more.
        #[test]
        fn at_a_loss_nothing_is_left_out(pauses in proptest::collection::vec((0u64..60, 1u64..9), 1..100)) {
            let (mut way, mut sent, mut now) = (Way::default(), Vec::new(), Duration::ZERO);
            way.look(stream(0), None);
            let (mut number, mut sequence) = (0, 0);
            for (pause, count) in pauses {
                now += Duration::from_secs(pause);
                (number, sequence) = (number + count, sequence + count);
                way.kept(number, sequence, now);
                sent.push((number, now));
            }
            way.look(stream(sequence - 1), None);
            let young = sent.iter().find(|(_, at)| now - *at < ON_DISK).map(|(number, _)| *number);
            prop_assert!(young.is_none_or(|first| way.number() < first));
            // How far it was is noted in steps.
            let old = sent.iter().rfind(|(_, at)| now - *at >= ON_DISK).map(|(_, at)| *at);
            let noted = sent.iter().rfind(|(_, at)| old.is_some_and(|old| *at + STEP <= old));
            prop_assert!(noted.is_none_or(|(number, _)| way.number() >= *number));
            prop_assert!(way.recent.len() <= 32);
        }
    }
}
