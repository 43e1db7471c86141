//! Who is told of alarms, against receivers that were not written here: the library of Standard Webhooks, aiosmtpd, and
//! Debian's Alertmanager; and what `deploy/` has for Prometheus and Grafana, by promtool and a JSON schema.

#[cfg(test)]
mod alertmanager;
#[cfg(test)]
mod dashboard;
#[cfg(test)]
mod endless;
#[cfg(test)]
mod mail;
#[cfg(test)]
#[path = "../peers/piped.rs"]
mod piped;
#[cfg(test)]
mod prometheus;
#[cfg(test)]
mod rig;
#[cfg(test)]
mod webhook;
