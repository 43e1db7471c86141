//! What of the configuration is shown to people. Each fact is named here: a key that is added to the file, which may hold a
//! secret, is not shown before somebody says so.

use crate::config::Config;
use crate::serve::{Facts, Setting};

/// The facts of what is in force. What a reload does not change is as it was `started`: a page that shows a door as shut must be
/// right.
pub(super) fn of(started: &Config, config: &Config) -> Facts {
    let mut settings = Vec::new();
    let mut say = |section, key, value: String| settings.push(Setting { section, key, value });
    let server = &started.server;
    say("server", "listen", server.listen.to_string());
    say("server", "allow_unauthenticated_network", server.allow_unauthenticated_network.to_string());
    let plain = server.allow_plain_http_on_network.to_string();
    say("server", "allow_plain_http_on_network", plain);
    let tls = server.tls.as_ref();
    let client = tls.is_some_and(|tls| tls.client_ca_file.is_some());
    let tls = if client { "yes, clients show certificates too" } else { tls.map_or("no", |_| "yes") };
    say("server", "tls", tls.to_string());
    say("server", "max_requests", server.max_requests.to_string());
    say("server", "max_connections", server.max_connections.to_string());
    say("server", "max_event_clients", server.max_event_clients.to_string());
    say("server", "request_timeout_s", server.request_timeout_s.to_string());
    say("server", "max_body_bytes", server.max_body_bytes.to_string());
    match &started.access {
        None => say("access", "log-in", "none".to_string()),
        Some(access) => {
            say("access", "log-in", "needed".to_string());
            say("access", "anyone_may_read", access.anyone_may_read.to_string());
            say("access", "session_idle_s", access.session_idle_s.to_string());
            say("access", "session_max_s", access.session_max_s.to_string());
        }
    }
    say("audit", "changes on record", if started.audit.is_some() { "yes" } else { "no" }.to_string());
    say("history", "samples_per_tag", config.history.samples_per_tag.to_string());
    say("schedule", "period_s", config.schedule.period_s.to_string());
    let schedule = &started.schedule;
    say("schedule", "parallelism", schedule.parallelism.to_string());
    say("schedule", "deadline_s", schedule.deadline_s.to_string());
    say("schedule", "queue", schedule.queue.to_string());
    say("schedule", "keep_results", schedule.keep_results.to_string());
    let diagnosis = &config.diagnosis;
    say("diagnosis", "f_threshold_percent", diagnosis.f_threshold_percent.to_string());
    say("diagnosis", "evidence_threshold", diagnosis.evidence_threshold.to_string());
    say("diagnosis", "window_samples", diagnosis.window_samples.to_string());
    say("diagnosis", "min_samples", diagnosis.min_samples.to_string());
    say("diagnosis", "max_gap_share", diagnosis.max_gap_share.to_string());
    let own = "the controller's scan where the record shows it, else the period of the stamps";
    say("diagnosis", "ts_s", diagnosis.ts_s.map_or(own.to_string(), |ts| ts.to_string()));
    say("diagnosis", "max_delay_samples", diagnosis.max_delay_samples.to_string());
    let alarm = &config.alarm;
    say("alarm", "k of n", format!("{} of {}", alarm.k, alarm.n));
    say("alarm", "clear_k of clear_n", format!("{} of {}", alarm.clear_k, alarm.clear_n));
    say("alarm", "clear_f_percent", alarm.clear_f_percent.to_string());
    say("alarm", "clear_evidence", alarm.clear_evidence.to_string());
    say("alarm", "max_shelve_s", alarm.max_shelve_s.to_string());
    let notify = &config.notify;
    say("notify", "webhooks", notify.webhook.len().to_string());
    say("notify", "alertmanagers", notify.alertmanager.len().to_string());
    say("notify", "mails", notify.smtp.len().to_string());
    say("notify", "mqtt", if started.notify.mqtt.is_some() { "yes" } else { "no" }.to_string());
    Facts { f_threshold_percent: Some(config.diagnosis.f_threshold_percent), settings }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_reload_does_not_change_is_shown_as_it_was_started() {
        let started = Config::default();
        let mut config = started.clone();
        config.server.allow_unauthenticated_network = true;
        config.access = Some(toml::from_str("file = 'users.json'").expect("it is right"));
        config.schedule.parallelism += 7;
        config.schedule.period_s += 7.0;
        config.alarm.k += 1;
        let facts = of(&started, &config).settings;
        let of = |section: &str, key: &str| {
            let own = facts.iter().find(|own| own.section == section && own.key == key);
            own.expect("it is shown").value.clone()
        };
        assert_eq!(of("server", "allow_unauthenticated_network"), "false");
        assert_eq!(of("access", "log-in"), "none");
        assert_eq!(of("schedule", "parallelism"), started.schedule.parallelism.to_string());
        assert_eq!(of("schedule", "period_s"), config.schedule.period_s.to_string());
        assert_eq!(of("alarm", "k of n"), format!("{} of {}", config.alarm.k, config.alarm.n));
    }
}
