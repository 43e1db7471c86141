//! Who is told: every receiver has a name of its own, and no rule of its is broken.

use super::super::wording;
use super::{Parts, Rules, Step};
use crate::alarm::Kind;
use crate::diagnosis::NotIdentifiable;
use crate::notify::{Config, Wrong};
use std::collections::{BTreeSet, HashMap};

impl Rules<'_, '_, '_> {
    pub(super) fn notify(&mut self, parts: &Parts) {
        let Some(notify) = &parts.notify else { return };
        self.section("notify", Some(notify.validate()));
        for (field, message) in notify.mqtt.as_ref().map(|mqtt| mqtt.validate()).into_iter().flatten() {
            self.wrong(&path!["notify", "mqtt", field], format!("{field}: {message}"));
        }
        let webhooks = notify.webhook.iter().map(|own| own.validate()).collect();
        let alertmanagers = notify.alertmanager.iter().map(|own| own.validate()).collect();
        let smtp = notify.smtp.iter().map(|own| own.validate()).collect();
        let mut seen = HashMap::new();
        for (kind, all) in [("webhook", webhooks), ("alertmanager", alertmanagers), ("smtp", smtp)] {
            self.receivers(kind, all, &mut seen);
        }
        self.groups(notify, parts);
    }

    /// A receiver for a group that no loop has would never hear of anything.
    fn groups(&mut self, notify: &Config, parts: &Parts) {
        if self.of_fleet() {
            return;
        }
        let groups = parts.loops.iter().flatten().map(|own| own.group.as_str());
        let known: BTreeSet<&str> = groups.filter(|group| !group.is_empty()).collect();
        let known: Vec<&str> = known.into_iter().collect();
        let webhook = notify.webhook.iter().map(|own| &own.filter).enumerate();
        let alertmanager = notify.alertmanager.iter().map(|own| &own.filter).enumerate();
        let smtp = notify.smtp.iter().map(|own| &own.filter).enumerate();
        let all = webhook.map(|one| ("webhook", one)).chain(alertmanager.map(|one| ("alertmanager", one)));
        for (kind, (at, filter)) in all.chain(smtp.map(|one| ("smtp", one))) {
            for (nth, group) in filter.groups.iter().enumerate() {
                let here = path!["notify", kind, at, "filter", "groups", nth];
                let hint = match known.is_empty() {
                    true => format!(": write group = {group:?} in the loops that are meant"),
                    false => wording::hint(group, &known),
                };
                self.unless(known.contains(&group.as_str()), &here, || {
                    format!("groups: no [[loop]] has the group {group:?}{hint}")
                });
            }
        }
    }

    /// What is no fault is the reason of a diagnosis.
    pub(super) fn ignored(&mut self, parts: &Parts) {
        let known = NotIdentifiable::CODES;
        let ignore = parts.alarm.iter().flat_map(|alarm| &alarm.not_identifiable.ignore).enumerate();
        for (nth, reason) in ignore.filter(|(_, reason)| !known.contains(&reason.as_str())) {
            let hint = wording::hint(reason, &known);
            let here = path!["alarm", "not_identifiable", "ignore", nth];
            self.wrong(&here, format!("ignore: no diagnosis gives the reason {reason:?}{hint}"));
        }
    }

    /// What clears an alarm is no more than what raises it.
    pub(super) fn clearing(&mut self, parts: &Parts) {
        let (Some(alarm), Some(diagnosis)) = (&parts.alarm, &parts.diagnosis) else { return };
        let pairs = [
            ("clear_f_percent", alarm.clear_f_percent, "f_threshold_percent", diagnosis.f_threshold_percent),
            ("clear_evidence", alarm.clear_evidence, "evidence_threshold", diagnosis.evidence_threshold),
        ];
        for (clears, least, raises, most) in pairs {
            let here = path!["alarm", clears];
            let there = path!["diagnosis", raises];
            // The default stands in no file, so what the file has is told.
            let place = if self.source.has(&here) { &here } else { &there };
            self.unless(!self.source.has(&here) || least.is_nan() || most.is_nan() || least <= most, place, || {
                format!("{clears} = {least} must be at most {raises} = {most}: what clears an alarm is less than what raises it")
            });
        }
    }

    /// What is suppressed by design is a kind of alarm, of a loop or of a collector that there is.
    pub(super) fn suppressed(&mut self, parts: &Parts) {
        let Some(alarm) = &parts.alarm else { return };
        let loops = (0..parts.loops.len()).filter_map(|at| self.source.text(&path!["loop", at, "id"]));
        let loops: Vec<&str> = loops.collect();
        let mut devices: Vec<&str> = self.devices.keys().copied().collect();
        devices.sort_unstable();
        let kinds = Kind::ALL.map(Kind::as_str);
        for (nth, text) in alarm.suppressed.iter().enumerate() {
            let here = path!["alarm", "suppressed", nth];
            let Some((whose, kind)) = text.rsplit_once('/') else {
                let message = match Kind::named(text) {
                    Some(_) => format!("{text:?} does not say whose alarm: write */{text} for all"),
                    None => format!(
                        "{text:?} names no kind of alarm: write {text}/f_rising, or */f_rising for every loop"
                    ),
                };
                self.wrong(&here, format!("suppressed: {message}"));
                continue;
            };
            let Some(kind) = Kind::named(kind) else {
                let message =
                    format!("suppressed: no alarm is called {kind:?}{}", wording::hint(kind, &kinds));
                self.wrong(&here, message);
                continue;
            };
            let (what, known) = match kind.of_device() {
                true => ("collector", &devices),
                false => ("[[loop]]", &loops),
            };
            let there = whose == "*" || known.contains(&whose) || self.of_fleet();
            self.unless(there, &here, || {
                format!("suppressed: no {what} is called {whose:?}{}", wording::hint(whose, known))
            });
        }
    }

    fn receivers<'n>(&mut self, kind: &str, all: Vec<Vec<Wrong>>, seen: &mut HashMap<&'n str, usize>)
    where
        Self: 'n,
    {
        for (at, wrong) in all.into_iter().enumerate() {
            let here = path!["notify", kind, at, "name"];
            if let Some(name) = self.source.text(&here) {
                self.name(name, &here, "name");
                self.first(seen, name, &here, "receiver");
            }
            for (table, field, message) in wrong {
                let message = format!("{field}: {message}");
                match table {
                    "" => self.wrong(&path!["notify", kind, at, field], message),
                    table => self.wrong(&path!["notify", kind, at, table, field], message),
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::config::parse;

    const PLANT: &str = "[[modbus]]\nname = 'd'\naddress = 'h:1'\naddress_base = 0\n[[loop]]\nid = 'A'\n\
        [loop.op]\ndevice = 'd'\nregister = 'holding'\naddress = 0\ntype = 'f32'\n\
        [loop.pv]\ndevice = 'd'\nregister = 'holding'\naddress = 2\ntype = 'f32'\n";

    const TOLD: &str = "\
[notify]
public_url = 'stictiond.plant'
[[notify.webhook]]
name = 'a'
url = 'http://h/x'
secret_file = 's'
events = ['raised', 'razed']
[[notify.webhook]]
name = 'b/c'
url = 'https://u:p@h/x'
[notify.webhook.pace]
wait_s = -1.0
most = 3
[[notify.alertmanager]]
name = 'am'
url = 'https://h'
resend_s = 60.0
expires_s = 100.0
[[notify.smtp]]
name = 'am'
address = 'mail.plant:25'
security = 'none'
from = 'nobody'
to = []
[notify.smtp.filter]
kinds = ['stiktion']
";

    #[test]
    fn errors_of_receivers_have_their_place() {
        let text = format!("{PLANT}{TOLD}");
        let found: Vec<String> = parse("f", &text).unwrap_err().iter().map(ToString::to_string).collect();
        let from = text.lines().position(|line| line == "[notify]").unwrap() + 1;
        for (after, expected) in [
            (1, "public_url: write an address"),
            (4, "url: is not encrypted"),
            (6, "events: unknown value \"razed\", did you mean \"raised\"?"),
            (8, "name: \"b/c\" must be"),
            (8, "name: needs secret_file or secret_env"),
            (9, "url: must not hold a password"),
            (11, "wait_s: -1 must be 0 to 86400"),
            (12, "unknown key \"most\" in [notify.webhook.pace]; known are wait_s"),
            (17, "expires_s: 100 must be three times resend_s"),
            (19, "receiver \"am\" is already on line"),
            (21, "security: \"none\" is for a server on this machine only"),
            (22, "from: \"nobody\" is not a mail address"),
            (23, "to: must name 1 to 100 addresses"),
            (25, "kinds: unknown value \"stiktion\", did you mean \"stiction\"?"),
        ] {
            let place = format!("f:{}:", from + after);
            let is = |found: &&String| found.starts_with(&place) && found.contains(expected);
            assert!(found.iter().any(|found| is(&found)), "{place} {expected}: {}", found.join("\n"));
        }
        assert_eq!(found.len(), 14, "{}", found.join("\n"));
        assert!(!found.join("").contains("u:p"), "a secret is shown: {}", found.join("\n"));
    }
}
