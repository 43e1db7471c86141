//! What people want done about an alarm, as a message and back.

use crate::alarm::{Action, AlarmId, Kind, Shelving};
use crate::fleet::message;
use crate::results::{Said, Wanted};
use crate::signal::LoopId;

/// The order, for the loop or collector that is called `subject` at its site; for this edge, or for any where that is empty.
pub(super) fn action(wanted: Wanted, (subject, edge): (&str, &str), epoch: u64) -> message::Action {
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
        edge: edge.to_string(),
    }
}

/// How much later than it was given an order comes (s): since the server took it, by the server's clock. What a machine's own clock
/// says does not matter.
pub(super) fn late_s(server_now: f64, taken_at: Option<f64>) -> f64 {
    taken_at.map_or(0.0, |taken| (server_now - taken).max(0.0))
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
    use crate::app::fleet::server_clock::ServerClock;
    use std::time::Duration;

    #[test]
    fn a_shelving_lasts_as_long_at_an_edge_whose_clock_is_hours_ahead() {
        // The edge's clock is 9 h ahead of the centre's, and the server's is a minute behind that.
        let (given, second) = (1_767_225_600.0, Duration::from_secs(1));
        let mut clock = ServerClock::default();
        clock.hear(given - 61.0, second);
        // The order waited for 100 s while the line was cut.
        let now = clock.at(101 * second).expect("a stamp was heard");
        let order = message::Action {
            kind: "stiction".into(),
            action: "shelve".into(),
            duration_s: Some(8.0 * 3600.0),
            at: given,
            ..message::Action::default()
        };
        let taken = Some(given - 61.0);
        let action = read_action(&order, late_s(now, taken)).map(|(_, action, _)| action);
        assert_eq!(action, Some(Action::Shelve(Shelving::For(8.0 * 3600.0 - 100.0))));
        assert_eq!((late_s(now, Some(now + 5.0)), late_s(now, None)), (0.0, 0.0));
    }

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
            let order = action(wanted, ("FIC101", "e1"), 7);
            assert_eq!((order.epoch, order.raised_at, order.since), (7, Some(3.0), Some(3.5)));
            assert_eq!(order.edge, "e1");
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
        let order = action(wanted, ("FIC101", "e1"), 7);
        let late = |s| read_action(&order, s).map(|(_, action, _)| action);
        assert_eq!(late(20.0), Some(Action::Shelve(Shelving::For(40.0))));
        assert_eq!(late(61.0), None);
        let order = message::Action { kind: "stiction".into(), action: "open".into(), ..Default::default() };
        assert_eq!(read_action(&order, 0.0), None);
        let order = message::Action { action: "shelve".into(), duration_s: Some(f64::NAN), ..order };
        assert_eq!(read_action(&order, 0.0), None);
    }
}
