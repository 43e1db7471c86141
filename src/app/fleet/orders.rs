//! What people want done about an alarm, as a message and back.

use crate::alarm::{Action, AlarmId, Kind, Shelving};
use crate::fleet::message;
use crate::results::{Said, Wanted};
use crate::signal::LoopId;

/// The order, for the loop or collector that is called `subject` at its site.
pub(super) fn action(wanted: Wanted, subject: &str, epoch: u64) -> message::Action {
    let (name, duration_s) = match wanted.action {
        Action::Acknowledge => ("acknowledge", None),
        Action::Reset => ("reset", None),
        Action::Shelve(Shelving::For(s)) => ("shelve", Some(s)),
        Action::Shelve(Shelving::Once(s)) => ("shelve_once", Some(s)),
        Action::Unshelve => ("unshelve", None),
        Action::TakeOut => ("take_out", None),
        Action::GiveBack => ("give_back", None),
    };
    message::Action {
        subject: subject.to_string(),
        kind: wanted.id.kind.as_str().to_string(),
        action: name.to_string(),
        duration_s,
        by: wanted.said.by,
        comment: wanted.said.comment,
        at: wanted.at,
        epoch,
        raised_at: wanted.raised_at,
        since: wanted.since,
    }
}

/// What an order says that comes so much later than it was given (s); `None` for one that this version does not know, and for
/// a shelving that is over.
pub(super) fn read_action(order: &message::Action, late_s: f64) -> Option<(AlarmId, Action, Said)> {
    let duration = order.duration_s.map(|s| s - late_s).filter(|s| s.is_finite() && *s > 0.0);
    let action = match order.action.as_str() {
        "acknowledge" => Action::Acknowledge,
        "reset" => Action::Reset,
        "shelve" => Action::Shelve(Shelving::For(duration?)),
        "shelve_once" => Action::Shelve(Shelving::Once(duration?)),
        "unshelve" => Action::Unshelve,
        "take_out" => Action::TakeOut,
        "give_back" => Action::GiveBack,
        _ => return None,
    };
    let id = AlarmId::new(LoopId::new(order.subject.as_str()), Kind::named(&order.kind)?);
    Some((id, action, Said { by: order.by.clone(), comment: order.comment.clone() }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_action_comes_back_and_another_is_refused() {
        let id = AlarmId::new(LoopId::new("FIC101"), Kind::Stiction);
        for own in [
            Action::Acknowledge,
            Action::Reset,
            Action::Shelve(Shelving::For(60.0)),
            Action::Shelve(Shelving::Once(90.0)),
            Action::Unshelve,
            Action::TakeOut,
            Action::GiveBack,
        ] {
            let said = Said { by: Some("eve".into()), comment: Some("seen".into()) };
            let wanted = Wanted {
                id: id.clone(),
                action: own,
                said: said.clone(),
                raised_at: Some(3.0),
                since: Some(3.5),
                at: 4.0,
            };
            let order = action(wanted, "FIC101", 7);
            assert_eq!((order.epoch, order.raised_at, order.since), (7, Some(3.0), Some(3.5)));
            assert_eq!(read_action(&order, 0.0), Some((id.clone(), own, said)));
        }
        let wanted = Wanted {
            id: id.clone(),
            action: Action::Shelve(Shelving::For(60.0)),
            said: Said::default(),
            raised_at: None,
            since: None,
            at: 4.0,
        };
        let order = action(wanted, "FIC101", 7);
        let late = |s| read_action(&order, s).map(|(_, action, _)| action);
        assert_eq!(late(20.0), Some(Action::Shelve(Shelving::For(40.0))));
        assert_eq!(late(61.0), None);
        let order = message::Action { kind: "stiction".into(), action: "open".into(), ..Default::default() };
        assert_eq!(read_action(&order, 0.0), None);
        let order = message::Action { action: "shelve".into(), duration_s: Some(f64::NAN), ..order };
        assert_eq!(read_action(&order, 0.0), None);
    }
}
