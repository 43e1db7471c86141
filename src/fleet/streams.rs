//! The streams of a fleet: what is in which, and what goes when one is full.

use super::config::Config;
use super::subject::{What, all};
use async_nats::jetstream::stream::{self, DiscardPolicy, RetentionPolicy, StorageType};
use std::collections::BTreeSet;
use std::time::Duration;

/// Raw samples; when it is full the oldest go.
pub const SAMPLES: &str = "stictiond_samples";
/// Windows that wait for a worker; each is taken out when it is answered.
pub const WINDOWS: &str = "stictiond_windows";
/// Diagnoses; when it is full what is new waits at the edge.
pub const DIAGNOSES: &str = "stictiond_diagnoses";
/// What happened to alarms; when it is full what is new waits at the edge. It is apart from diagnoses, which are far more and
/// larger, so that these never keep an alarm back.
pub const ALARMS: &str = "stictiond_alarms";
/// How the alarms of each loop and collector stand, the last message of each edge about each.
pub const STATES: &str = "stictiond_states";
/// What people at the centre did about alarms; when it is full nothing more can be done.
pub const ACTIONS: &str = "stictiond_actions";
/// The latest message of each edge, worker and centre, the latest of each part of an edge's announcement, the lease, and what each
/// reader of a centre was given last.
pub const LATEST: &str = "stictiond_latest";

/// The names of all streams.
pub const ALL: [&str; 7] = [SAMPLES, WINDOWS, DIAGNOSES, ALARMS, STATES, ACTIONS, LATEST];

/// Subject of the lease.
pub const LEASE: &str = "stictiond.v1.fleet.centre.lease";
/// Subjects of what readers of streams were given last.
const GIVEN: &str = "stictiond.v1.fleet.*.given";
/// An id that was seen within this time is a message sent twice.
const SAME_WITHIN: Duration = Duration::from_secs(600);
/// A window that nobody took for longer is no longer asked for.
const WINDOW_LASTS: Duration = Duration::from_secs(300);
/// An action that a site did not take for longer is no longer meant.
const ACTION_LASTS: Duration = Duration::from_secs(7 * 86_400);
/// Most bytes of windows that wait.
const WINDOW_BYTES: i64 = 256_000_000;
/// Most bytes of actions that wait.
const ACTION_BYTES: i64 = 64_000_000;
/// Most bytes of the latest messages: 100,000 loops take about 30 MB.
const LATEST_BYTES: i64 = 256_000_000;
/// Most bytes of one of the latest messages: four times the longest of them, a part of an edge's list. A reader gets a message as
/// Base64, a third longer. If that were longer than an answer may be, each reader would lose its connection.
const LATEST_MESSAGE: i32 = 1 << 19;
/// Most bytes of how alarms stand: 5 kB for each of 100,000 loops.
const STATE_BYTES: i64 = 512_000_000;
/// Most bytes of one message of how alarms stand, with its head: a reader asks for 32 at once.
pub const STATE_MESSAGE: i32 = 1 << 16;

/// Subject of what a reader of a stream was given last.
pub fn given(stream: &str, reader: &str) -> String {
    GIVEN.replace('*', &format!("{stream}-{reader}"))
}

/// All streams, with the room that a configuration gives them.
pub fn of(config: &Config) -> [stream::Config; 7] {
    let bytes = |mb: u64| i64::try_from(mb * 1_000_000).unwrap_or(i64::MAX);
    let base = |name: &str, subjects: Vec<String>, max_bytes: i64| stream::Config {
        name: name.to_string(),
        subjects,
        max_bytes,
        storage: StorageType::File,
        duplicate_window: SAME_WITHIN,
        num_replicas: 1,
        ..stream::Config::default()
    };
    let each = |whats: &[What]| whats.iter().map(|what| all(None, *what)).collect::<Vec<_>>();
    let mut latest = each(&[What::Hello, What::Pulse, What::Cursor]);
    latest.extend([LEASE, GIVEN].map(str::to_string));
    [
        stream::Config {
            discard: DiscardPolicy::Old,
            ..base(SAMPLES, each(&[What::Samples]), bytes(config.samples_mb))
        },
        stream::Config {
            retention: RetentionPolicy::WorkQueue,
            discard: DiscardPolicy::Old,
            max_age: WINDOW_LASTS,
            duplicate_window: WINDOW_LASTS,
            ..base(WINDOWS, each(&[What::Window]), WINDOW_BYTES)
        },
        stream::Config {
            discard: DiscardPolicy::New,
            ..base(DIAGNOSES, each(&[What::Diagnosis]), bytes(config.diagnoses_mb))
        },
        stream::Config {
            discard: DiscardPolicy::New,
            ..base(ALARMS, each(&[What::Alarm]), bytes(config.alarms_mb))
        },
        stream::Config {
            discard: DiscardPolicy::Old,
            max_messages_per_subject: 1,
            max_message_size: STATE_MESSAGE,
            ..base(STATES, each(&[What::State]), STATE_BYTES)
        },
        stream::Config {
            discard: DiscardPolicy::New,
            max_age: ACTION_LASTS,
            ..base(ACTIONS, each(&[What::Action]), ACTION_BYTES)
        },
        stream::Config {
            discard: DiscardPolicy::Old,
            max_messages_per_subject: 1,
            max_message_size: LATEST_MESSAGE,
            ..base(LATEST, latest, LATEST_BYTES)
        },
    ]
}

/// The configuration that a stream needs in place of `held`; `None` if it is right. The subjects have to be ours, because a stream
/// keeps no message of another subject. The longest message has to be ours, because nobody can read a longer one. All else is left
/// as it is: an operator may have set other limits.
pub fn mended(held: &stream::Config, wanted: &stream::Config) -> Option<stream::Config> {
    let subjects = |own: &stream::Config| own.subjects.iter().cloned().collect::<BTreeSet<String>>();
    // A server says -1 where there is no bound. Where we want none, any bound is the operator's.
    let is_right = wanted.max_message_size <= 0 || held.max_message_size == wanted.max_message_size;
    if is_right && subjects(held) == subjects(wanted) {
        return None;
    }
    let max_message_size = if is_right { held.max_message_size } else { wanted.max_message_size };
    Some(stream::Config { subjects: wanted.subjects.clone(), max_message_size, ..held.clone() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_give_way_and_what_was_found_never_does() {
        let text = "servers = ['nats://hub']\ndiagnoses_mb = 32\nalarms_mb = 16";
        let config: Config = toml::from_str(text).expect("readable");
        let [samples, windows, diagnoses, alarms, states, actions, latest] = of(&config);
        assert_eq!((samples.discard, samples.max_bytes), (DiscardPolicy::Old, 4_096_000_000));
        assert_eq!((diagnoses.discard, diagnoses.max_bytes), (DiscardPolicy::New, 32_000_000));
        assert_eq!((alarms.discard, alarms.max_bytes), (DiscardPolicy::New, 16_000_000));
        assert_eq!((diagnoses.max_age, alarms.max_age), (Duration::ZERO, Duration::ZERO));
        assert_eq!((states.max_messages_per_subject, states.max_message_size), (1, 65_536));
        assert_eq!(windows.retention, RetentionPolicy::WorkQueue);
        assert_eq!(actions.discard, DiscardPolicy::New);
        // A server refuses a stream that forgets ids later than messages.
        let all = [&samples, &windows, &diagnoses, &alarms, &states, &actions, &latest];
        assert!(all.iter().all(|own| own.max_age.is_zero() || own.duplicate_window <= own.max_age));
        assert_eq!((latest.max_messages_per_subject, latest.max_message_size), (1, 524_288));
        // Every kind of message but the answer, which an edge waits for, is in exactly one stream.
        let all = [samples, windows, diagnoses, alarms, states, actions, latest];
        assert_eq!(all.each_ref().map(|own| own.name.as_str()), ALL);
        let all: Vec<String> = all.into_iter().flat_map(|own| own.subjects).collect();
        for what in What::ALL.into_iter().filter(|what| *what != What::Answer) {
            let subjects = crate::fleet::subject::all(None, what);
            assert_eq!(all.iter().filter(|own| **own == subjects).count(), 1, "{what:?}");
        }
    }
    #[test]
    fn a_stream_of_an_earlier_version_gets_our_subjects_and_bound_and_keeps_its_limits() {
        let config: Config = toml::from_str("servers = ['nats://hub']").expect("readable");
        for wanted in of(&config) {
            // As a server says what it has.
            let bound = if wanted.max_message_size == 0 { -1 } else { wanted.max_message_size };
            let now = stream::Config { max_message_size: bound, max_bytes: 7, ..wanted.clone() };
            assert_eq!(mended(&now, &wanted), None, "{}", wanted.name);
            let turned = wanted.subjects.iter().rev().cloned().collect();
            assert_eq!(mended(&stream::Config { subjects: turned, ..now.clone() }, &wanted), None);

            let old = vec!["stictiond.v0.>".to_string()];
            let held = stream::Config { subjects: old, max_message_size: -1, ..now.clone() };
            assert_eq!(mended(&held, &wanted), Some(now), "{}", wanted.name);
        }
        let [.., latest] = of(&config);
        let unbounded = stream::Config { max_message_size: -1, ..latest.clone() };
        assert_eq!(mended(&unbounded, &latest), Some(latest));
    }
}
