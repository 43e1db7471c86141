//! What an edge forwards, and what streams are asked before it.

use super::*;
use crate::fleet::message::{Progress, Run};
use std::sync::Mutex;

fn edge() -> Edge {
    Edge { site: "north".into(), name: "e1".into() }
}

fn row(name: &str, kind: &str) -> AlarmRow {
    AlarmRow { control_loop: name.into(), kind: kind.into(), active: true, ..AlarmRow::default() }
}

#[test]
fn every_loop_says_how_all_of_its_alarms_stand_also_one_that_has_none() {
    let rows = [row("FIC1", "stiction"), row("FIC1", "f_rising"), row("old", "stiction")];
    let messages = states_of(&edge(), ["FIC1", "FIC2"].map(String::from), &rows);
    let read = |at: usize| {
        let message: &Outgoing = &messages[at];
        assert!(!message.once, "the last one counts, also where it says what an earlier one had said");
        let own: States = weights::read(&message.subject, message.body.clone()).expect("ours");
        let kinds: Vec<String> = own.alarms.into_iter().map(|own| own.kind).collect();
        (message.subject.as_str(), own.edge, kinds)
    };
    let both = ["stiction", "f_rising"].map(String::from).to_vec();
    assert_eq!(read(0), ("stictiond.v1.north.FIC1.state.e1", "e1".to_string(), both));
    // It takes the place of what an edge had said that has lost its disk since.
    assert_eq!(read(1), ("stictiond.v1.north.FIC2.state.e1", "e1".to_string(), Vec::new()));
    assert_eq!(messages.len(), 2, "the old loop is not watched any more");
}

#[test]
fn a_state_that_no_stream_takes_keeps_no_other_back() {
    let long = AlarmRow { comment: Some("x".repeat(STATE_MESSAGE as usize)), ..row("FIC1", "stiction") };
    let messages = states_of(&edge(), ["FIC1", "FIC2"].map(String::from), &[long]);
    assert_eq!(messages.len(), 1);
    assert!(messages.iter().all(|own| own.body.len() < STATE_MESSAGE as usize));
}

#[test]
fn a_message_under_a_number_that_was_used_again_is_another_s() {
    let own = edge();
    let subject = |what| own.subject("FIC1", what);
    let alarm = |edge: &str, number| Alarm { edge: edge.into(), number, ..Alarm::default() }.encode_to_vec();
    assert!(own.has_sent(&subject(What::Alarm), alarm("e1", 7), 7));
    assert!(!own.has_sent(&subject(What::Alarm), alarm("e1", 8), 7));
    assert!(!own.has_sent(&subject(What::Alarm), alarm("e2", 7), 7));
    let run = Some(Run::default());
    let found = Diagnosis { edge: "e1".into(), number: 7, run, ..Diagnosis::default() };
    assert!(own.has_sent(&subject(What::Diagnosis), found.encode_to_vec(), 7));
    assert!(!own.has_sent(&subject(What::Samples), alarm("e1", 7), 7));
    assert!(!own.has_sent(&subject(What::Alarm), b"\xff".to_vec(), 7));
}

#[test]
fn a_store_that_was_made_anew_is_read_from_its_first_row_on() {
    let rows = |last: i64| {
        move |after: i64, most: usize| -> Result<Vec<(i64, ())>, StoreError> {
            Ok((1..=last).filter(|number| *number > after).map(|number| (number, ())).take(most).collect())
        }
    };
    assert_eq!(begin(0, rows(0)).expect("readable"), 0);
    assert_eq!(begin(9, rows(9)).expect("readable"), 9);
    assert_eq!(begin(9, rows(20)).expect("readable"), 9);
    assert_eq!(begin(9, rows(8)).expect("readable"), 0);
}

/// Streams on a line that is too slow for a diagnosis, and what they were asked.
#[derive(Default)]
struct Slow(Mutex<Vec<String>>);

impl Slow {
    fn asked(&self) -> Vec<String> {
        std::mem::take(&mut *self.0.lock().expect("no panic"))
    }

    fn note(&self, what: &str, stream: &str) {
        self.0.lock().expect("no panic").push(format!("{what} {stream}"));
    }
}

impl Ask for Slow {
    async fn last(&self, stream: &str, _: &str) -> Result<Option<(u64, Vec<u8>)>, LinkError> {
        self.note("last", stream);
        let progress = Some(Progress { number: 7, sequence: 5, made: 1, ..Progress::default() });
        Ok(Some((1, Cursor { changes: progress, diagnoses: progress }.encode_to_vec())))
    }

    async fn state(&self, stream: &str) -> Result<StreamState, LinkError> {
        self.note("state", stream);
        Ok(StreamState { made: 1, last: 9 })
    }

    async fn at(&self, stream: &str, _: u64) -> Result<Option<(String, Vec<u8>)>, LinkError> {
        self.note("at", stream);
        if stream == DIAGNOSES { Err(LinkError::Away("timed out".into())) } else { Ok(None) }
    }
}

fn named(asked: &[(&str, &str)]) -> Vec<String> {
    asked.iter().map(|(what, stream)| format!("{what} {stream}")).collect()
}

#[tokio::test]
async fn after_a_doubt_no_alarm_waits_until_the_last_diagnosis_is_fetched() {
    let (streams, mut found) = (Slow::default(), Found::new("north", "e1"));
    let of_alarms = named(&[("state", ALARMS), ("at", ALARMS), ("state", STATES)]);
    found.look_at_alarms(&streams).await.expect("it is small");
    assert_eq!(streams.asked(), [named(&[("last", LATEST)]), of_alarms.clone()].concat());
    assert_eq!((found.changes.number(), found.diagnoses.number()), (7, 7));
    found.look_at_diagnoses(&streams).await.expect_err("it takes too long");
    assert_eq!(streams.asked(), named(&[("state", DIAGNOSES), ("at", DIAGNOSES)]));
    // Of what is sure nothing is asked, and after a doubt all of it.
    found.look_at_alarms(&streams).await.expect("it is sure");
    assert_eq!(streams.asked(), [""; 0]);
    found.doubt();
    found.look_at_alarms(&streams).await.expect("it is small");
    assert_eq!(streams.asked(), of_alarms);
}
