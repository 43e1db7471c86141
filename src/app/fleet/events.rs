//! What edges have found: diagnoses, and what happens to alarms. A centre takes both into its results and its store.

use super::Fleet;
use super::centre::{MOST, Taken, WAIT, begin};
use super::order::{Making, Order};
use super::standing::reader;
use super::window;
use crate::alarm::{AlarmId, Cause};
use crate::app::App;
use crate::app::persistence::rows::{remembered_alarms, remembered_change, remembered_model};
use crate::fleet::convert;
use crate::fleet::link::{Incoming, Link};
use crate::fleet::message::{self, Alarm, Diagnosis};
use crate::fleet::streams::ALARMS;
use crate::fleet::subject::{Subject, What, of_site};
use crate::fleet::weights;
use crate::results::{AlarmChange, RestoredAlarm};
use crate::signal::LoopId;
use crate::store::AlarmRow;
use std::sync::atomic::Ordering::Relaxed;

impl Fleet {
    /// Takes what a stream has of diagnoses or of alarms.
    pub(super) async fn take_events(&self, link: &Link, app: &App, stream: &str) {
        let (name, mut making) = (reader(&self.name), Making::default());
        let failed = if stream == ALARMS { "no alarms are taken" } else { "no diagnoses are taken" };
        let (mut taken, mut order) = (Taken::default(), Order::default());
        loop {
            let (mut reading, made) = match begin(link, stream, (name.as_str(), "")).await {
                Ok(begun) => begun,
                Err(error) => {
                    self.rest(&error, failed).await;
                    continue;
                }
            };
            if making.is_another(made) {
                (taken, order) = (Taken::default(), Order::default());
                if stream == ALARMS {
                    self.looked_at.send_replace(0);
                }
            }
            if stream == ALARMS {
                self.looked_at.send_modify(|known| *known = reading.done_before().max(*known));
            }
            loop {
                let messages = match reading.next(MOST, WAIT).await {
                    Ok(messages) => messages,
                    Err(error) => break self.rest(&error, failed).await,
                };
                let guard = self.taking.read().await;
                let mut done = Vec::new();
                let last = messages.last().map_or(0, Incoming::sequence);
                for message in messages {
                    if !self.is_next(&message, &mut order) {
                        self.put_off(&message, &mut order).await;
                        continue;
                    }
                    match self.take_event(&message, &mut taken, made) {
                        Some(()) => {
                            order.taken(message.subject(), message.sequence());
                            done.push(message);
                        }
                        None => self.later(&message, &mut order).await,
                    }
                }
                if stream == ALARMS {
                    self.looked_at.send_modify(|known| *known = last.max(*known));
                }
                let (_guard, blocked) = self.settle(app, guard, done).await;
                order.stood_still(blocked);
            }
        }
    }

    /// Takes a diagnosis or a change of an alarm, from the stream that was made then; `None` where its loop is not known.
    fn take_event(&self, message: &Incoming, taken: &mut Taken, made: i128) -> Option<()> {
        let own = Subject::read(message.subject())?;
        let id = LoopId::new(of_site(&own.site, &own.name));
        match own.what {
            What::Diagnosis => {
                self.results.summaries(&id)?;
                let read = weights::read::<Diagnosis>(message.subject(), message.bytes());
                let Some(Diagnosis { run, model, edge, .. }) = read else { return Some(()) };
                let Some(run) = run else {
                    weights::refuse(message.subject(), "it has no diagnosis");
                    return Some(());
                };
                if self.is_foreign(id.as_str(), &edge, message) {
                    return Some(());
                }
                let model = model.map(|model| remembered_model(&convert::model_row(id.as_str(), &model)));
                let (run, is_whole) = window::run(id, &run);
                if !is_whole {
                    let why =
                        "this version cannot read its report, or what it worked on: it is kept all the same";
                    weights::refuse(message.subject(), why);
                }
                if self.results.learn(run, model, self.clock.now()) {
                    self.diagnosed.fetch_add(1, Relaxed);
                }
            }
            What::Alarm => {
                let Some(Heard { kept, change, edge }) = alarm(&id, message) else { return Some(()) };
                if self.is_foreign(id.as_str(), &edge, message) {
                    return Some(());
                }
                if let Some(change) = &change {
                    self.firsts.note(change, (made, message.sequence()));
                }
                if !change.as_ref().is_some_and(is_forgotten) && !self.is_known(&kept.id) {
                    return None;
                }
                // Else it is known how it stands since then.
                if !taken.is_past(&kept.id.to_string(), message.mark()) {
                    self.results.follow_alarm(kept, change, self.clock.now());
                }
            }
            _ => {}
        }
        Some(())
    }

    /// Whether an edge has the loop or collector of an alarm, whatever its kind: one that is switched off here is not shown, and
    /// nothing waits for it.
    pub(super) fn is_known(&self, id: &AlarmId) -> bool {
        match id.of_loop() {
            Some(id) => self.results.summaries(id).is_some(),
            None => self.scene.borrow().config.forwarded.iter().any(|name| name == id.subject.as_str()),
        }
    }
}

/// Whether a change ends the alarm of a loop or collector that its edge has no more.
pub(super) fn is_forgotten(change: &AlarmChange) -> bool {
    change.transition.cause == Cause::Forgotten
}

/// What a message says of an alarm.
pub(super) struct Heard {
    /// As its edge has it.
    pub(super) kept: RestoredAlarm,
    /// What happened to it.
    pub(super) change: Option<AlarmChange>,
    /// The edge that says so.
    pub(super) edge: String,
}

/// What a message of the loop or collector `id` says of an alarm. What this version cannot read is refused.
pub(super) fn alarm(id: &LoopId, message: &Incoming) -> Option<Heard> {
    let read = weights::read::<Alarm>(message.subject(), message.bytes());
    let Alarm { state: Some(state), change, told, edge, .. } = read? else {
        weights::refuse(message.subject(), "it has no state of an alarm");
        return None;
    };
    heard(message.subject(), AlarmRow { control_loop: id.to_string(), ..convert::alarm_row(state) }, change)
        .map(|(kept, change)| Heard {
            kept,
            change: change.map(|change| AlarmChange { told, ..change }),
            edge,
        })
}

fn heard(
    subject: &str,
    row: AlarmRow,
    change: Option<message::AlarmChange>,
) -> Option<(RestoredAlarm, Option<AlarmChange>)> {
    let change = change.map(|change| convert::change_row(&row.control_loop, &row.kind, &change));
    let Some(kept) = remembered_alarms(vec![row]).pop() else {
        weights::refuse(
            subject,
            "this version does not know its kind of alarm, so that nobody is told of it",
        );
        return None;
    };
    let is_told_of = change.is_some();
    let change = change.and_then(remembered_change);
    if is_told_of && change.is_none() {
        weights::refuse(
            subject,
            "this version does not know what happened to its alarm, so that nobody is told of it",
        );
    }
    Some((kept, change))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::TransitionRow;

    #[test]
    fn an_alarm_that_this_version_cannot_read_is_counted() {
        let row = |kind: &str| AlarmRow {
            control_loop: "north:FIC1".into(),
            kind: kind.into(),
            ..AlarmRow::default()
        };
        let change = |cause: &str| {
            Some(convert::change(TransitionRow {
                control_loop: "FIC1".into(),
                kind: "stiction".into(),
                at: 1.0,
                before: "normal".into(),
                after: "unacknowledged".into(),
                cause: cause.into(),
                priority: None,
                detail: String::new(),
                by: None,
                comment: None,
            }))
        };
        let counted = |kind: &str, cause: &str| {
            let before = weights::refused();
            (
                heard("a", row(kind), change(cause)).map(|(_, change)| change.is_some()),
                weights::refused() > before,
            )
        };
        assert_eq!(counted("stiction", "raised").0, Some(true));
        assert_eq!(counted("stiction", "of_a_later_version"), (Some(false), true), "how it stands is taken");
        assert_eq!(counted("of_a_later_version", "raised"), (None, true));
    }
}
