//! Who is told of alarms, against receivers that were not written here: the library of Standard Webhooks, aiosmtpd, and
//! Debian's Alertmanager.

#[cfg(test)]
mod alertmanager;
#[cfg(test)]
mod mail;
#[cfg(test)]
mod rig;
#[cfg(test)]
mod webhook;
