//! `[writeback]` and `[loop.writeback]`: where the term goes, and every bound it keeps. Nothing has a default but that it
//! is off.

use crate::compensation::gate::Limits;
use crate::compensation::measure::{Criteria, MAX_POINTS};
use serde::Deserialize;
use std::path::PathBuf;
use std::time::Duration;

/// What the ramp to zero may take longer than its limit, for the last answers to come.
pub(super) const GRACE: Duration = Duration::from_secs(2);

/// Time after which a term in force is recorded again although it has not changed (s). If it is not, the term ends with the
/// time-out of the DCS (see [`LoopConfig::term_lasts_s`]).
pub const TERM_REPEAT_S: f64 = 60.0;

/// Times `timeout_ms` that an exchange may take: a connection, a write, a read and a heartbeat.
pub(super) const IN_EXCHANGE: u32 = 4;

/// `[writeback]`: the audit log.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// The audit log; needed as soon as a loop enables write-back.
    pub audit_file: Option<PathBuf>,
    /// It is rotated once it is larger (bytes).
    pub audit_max_bytes: u64,
    /// Rotated files that are kept.
    pub audit_keep_files: usize,
}

impl Default for Config {
    fn default() -> Self {
        Self { audit_file: None, audit_max_bytes: 16_000_000, audit_keep_files: 20 }
    }
}

impl Config {
    /// Everything wrong with it, by field; empty when it can be used.
    pub fn validate(&self) -> Vec<(&'static str, String)> {
        let mut wrong = Vec::new();
        let (bytes, files) = (self.audit_max_bytes, self.audit_keep_files);
        if !(10_000..=1_000_000_000).contains(&bytes) {
            wrong.push(("audit_max_bytes", format!("{bytes} must be 10000 to 1000000000")));
        }
        if !(1..=10_000).contains(&files) {
            wrong.push(("audit_keep_files", format!("{files} must be 1 to 10000")));
        }
        wrong
    }
}

/// `[loop.writeback]`: one loop's term. Every bound has to be written down.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoopConfig {
    /// Off unless this says otherwise.
    #[serde(default)]
    pub enabled: bool,
    /// The `[[modbus]]` device that holds the registers; write-back has a connection of its own to it.
    pub device: String,
    /// First holding register of the term, counted from the device's `address_base`. Nothing else may lie there.
    pub term_address: i64,
    /// `i16`, `i32`, `f32` or `f64`.
    pub term_type: TermType,
    /// Byte order of the term: `ABCD`, `CDAB`, `BADC` or `DCBA`.
    pub term_byte_order: WordOrder,
    /// What one unit of the register stands for (% of OP span): term = scale * raw.
    pub term_scale_percent: f64,
    /// Holding register of the heartbeat, a `u16` that changes with every write.
    pub heartbeat_address: i64,
    /// What the DCS is set to: a heartbeat that stands still for longer drops the term (ms).
    pub heartbeat_timeout_ms: u64,
    /// Longest pause between two writes (ms); a new OP is answered at once.
    pub write_ms: u64,
    /// Longest wait for the connection and for each answer (ms).
    pub timeout_ms: u64,
    /// The term is never larger (% of OP span).
    pub clamp_percent: f64,
    /// The term never changes faster while active (%/s).
    pub rate_percent_per_s: f64,
    /// The ramp to zero (%/s).
    pub withdraw_percent_per_s: f64,
    /// Longest time the ramp may take before the heartbeat is stopped instead (s).
    pub withdraw_limit_s: f64,
    /// OP turns back by more than this before the term changes its sign (%).
    pub dead_band_percent: f64,
    /// OP counts as constant, and the term as 0, after this long (ms).
    pub rest_ms: u64,
    /// A step of the gate that comes later withdraws (ms).
    pub max_step_ms: u64,
    /// A jump of the wall clock by more than this withdraws (ms).
    pub clock_tolerance_ms: u64,
    /// An older sample of OP, PV, SP or mode withdraws (ms).
    pub max_sample_age_ms: u64,
    /// More missed or overrun polls of the loop's devices within a minute withdraw.
    pub max_missed_polls_per_minute: u64,
    /// OP closer to a limit withdraws (%).
    pub op_margin_percent: f64,
    /// SP may move this fast when the gate opens (SP unit/s).
    pub sp_rate_per_s: f64,
    /// … and must have been as slow for this long (s).
    pub sp_settle_s: f64,
    /// Oldest diagnosis that opens the gate (s).
    pub evidence_max_age_s: f64,
    /// A later interval of f that is apart from the granted one by more than this withdraws (%).
    pub f_margin_percent: f64,
    /// Longest grant (s).
    pub grant_max_s: f64,
    /// Length measured before and with the term (s).
    pub measure_s: f64,
    /// Without the gain within this the term is withdrawn (s).
    pub prove_s: f64,
    /// ISE before over ISE with the term that must be reached (-).
    pub ise_gain: f64,
    /// ISE with the term over ISE before that withdraws (-).
    pub ise_limit: f64,
    /// Travel with the term over travel before that withdraws (-).
    pub travel_limit: f64,
    /// A turn of the stem counts from this (%).
    pub reversal_band_percent: f64,
}

/// How the term lies in its registers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TermType {
    /// Two's complement, one register.
    I16,
    /// Two's complement, two registers.
    I32,
    /// IEEE 754 single precision, two registers.
    F32,
    /// IEEE 754 double precision, four registers.
    F64,
}

impl TermType {
    /// Registers it takes.
    pub fn width(self) -> u16 {
        match self {
            TermType::I16 => 1,
            TermType::I32 | TermType::F32 => 2,
            TermType::F64 => 4,
        }
    }

    fn largest(self) -> f64 {
        match self {
            TermType::I16 => f64::from(i16::MAX),
            TermType::I32 => f64::from(i32::MAX),
            TermType::F32 => f64::from(f32::MAX),
            TermType::F64 => f64::MAX,
        }
    }
}

/// Units of a whole-number register that the largest term must span.
const LEAST_STEPS: f64 = 20.0;

/// The order of a value's bytes in ascending registers; A is the most significant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub enum WordOrder {
    /// Big-endian.
    #[serde(rename = "ABCD")]
    Abcd,
    /// Words swapped.
    #[serde(rename = "CDAB")]
    Cdab,
    /// Bytes swapped in each word.
    #[serde(rename = "BADC")]
    Badc,
    /// Little-endian.
    #[serde(rename = "DCBA")]
    Dcba,
}

impl WordOrder {
    /// The name as the configuration writes it.
    pub fn as_str(self) -> &'static str {
        match self {
            WordOrder::Abcd => "ABCD",
            WordOrder::Cdab => "CDAB",
            WordOrder::Badc => "BADC",
            WordOrder::Dcba => "DCBA",
        }
    }
}

/// Where and how to write, on the wire.
#[derive(Clone, Debug, PartialEq)]
pub struct Target {
    /// `host:port`.
    pub address: String,
    /// Unit identifier.
    pub unit_id: u8,
    /// First register of the term, counted from 0.
    pub term: u16,
    /// Register of the heartbeat, counted from 0.
    pub heartbeat: u16,
    /// How the term is stored.
    pub term_type: TermType,
    /// … in which order.
    pub order: WordOrder,
    /// % of OP span per unit of the register.
    pub scale: f64,
    /// Longest wait for each answer.
    pub timeout: Duration,
}

impl LoopConfig {
    /// Everything wrong with its own fields; empty when it can be used.
    pub fn validate(&self) -> Vec<(&'static str, String)> {
        let mut wrong = Vec::new();
        let mut unless = |ok: bool, field: &'static str, message: String| {
            if !ok {
                wrong.push((field, message));
            }
        };
        for (field, value, least, most) in self.numbers() {
            let ok = value >= least && value <= most;
            unless(ok, field, format!("{value} must be {least} to {most}"));
        }
        let scale = self.term_scale_percent;
        let fits = scale.is_finite() && scale > 0.0 && self.clamp_percent <= scale * self.term_type.largest();
        let message = format!("{scale} must be above 0, and clamp_percent must fit into the register");
        unless(fits, "term_scale_percent", message);
        // Raw values are rounded towards 0: in a coarse register a small term would be none.
        let whole = matches!(self.term_type, TermType::I16 | TermType::I32);
        unless(
            !whole || !fits || scale * LEAST_STEPS <= self.clamp_percent,
            "term_scale_percent",
            format!(
                "{scale} is too coarse for a whole number: clamp_percent = {} must be at least {LEAST_STEPS} units of it",
                self.clamp_percent
            ),
        );
        let (write, exchange, step) = (self.write_ms, self.exchange_ms(), self.max_step_ms);
        unless(
            write.saturating_add(exchange) <= step,
            "max_step_ms",
            format!(
                "{step} must be at least write_ms + {IN_EXCHANGE} timeout_ms, the longest a good step takes"
            ),
        );
        let heart = self.heartbeat_timeout_ms;
        // A heartbeat ends its exchange: the next one may come that much later behind its step.
        let longest = step.saturating_add(exchange);
        unless(
            heart > longest,
            "heartbeat_timeout_ms",
            format!(
                "{heart} must be more than max_step_ms + {IN_EXCHANGE} timeout_ms = {longest}, the longest from one heartbeat to \
                 the next, or the DCS drops the term at every hitch"
            ),
        );
        let (clamp, margin) = (self.clamp_percent, self.op_margin_percent);
        unless(
            margin >= clamp,
            "op_margin_percent",
            format!(
                "{margin} must be at least clamp_percent = {clamp}: OP and term together stay within the limits"
            ),
        );
        let ramp = clamp / self.withdraw_percent_per_s + 2.0 * step as f64 / 1000.0;
        let limit = self.withdraw_limit_s;
        // Written so that a NaN is refused.
        unless(
            limit >= ramp,
            "withdraw_limit_s",
            format!(
                "{limit} must be at least {ramp:.3}: clamp_percent at withdraw_percent_per_s and two steps"
            ),
        );
        let (measure, prove) = (self.measure_s, self.prove_s);
        unless(prove >= measure, "prove_s", format!("{prove} must be at least measure_s = {measure}"));
        let points = 1000.0 * measure / write.max(1) as f64;
        let most = MAX_POINTS as f64;
        unless(
            points <= most,
            "measure_s",
            format!("{measure} is more than {most} steps of write_ms = {write}"),
        );
        wrong
    }

    fn numbers(&self) -> [(&'static str, f64, f64, f64); 25] {
        let ms = |value: u64| value as f64;
        let day = 86_400.0;
        [
            ("heartbeat_timeout_ms", ms(self.heartbeat_timeout_ms), 10.0, 3.6e6),
            ("write_ms", ms(self.write_ms), 1.0, 600_000.0),
            ("timeout_ms", ms(self.timeout_ms), 1.0, 60_000.0),
            ("clamp_percent", self.clamp_percent, 0.01, 20.0),
            ("rate_percent_per_s", self.rate_percent_per_s, 0.001, 10_000.0),
            ("withdraw_percent_per_s", self.withdraw_percent_per_s, 0.001, 10_000.0),
            ("withdraw_limit_s", self.withdraw_limit_s, 0.01, 3600.0),
            ("dead_band_percent", self.dead_band_percent, 0.0, 10.0),
            ("rest_ms", ms(self.rest_ms), 0.0, 3.6e6),
            ("max_step_ms", ms(self.max_step_ms), 2.0, 3.6e6),
            ("clock_tolerance_ms", ms(self.clock_tolerance_ms), 1.0, 60_000.0),
            ("max_sample_age_ms", ms(self.max_sample_age_ms), 1.0, 3.6e6),
            ("max_missed_polls_per_minute", ms(self.max_missed_polls_per_minute), 0.0, 10_000.0),
            ("op_margin_percent", self.op_margin_percent, 0.0, 49.0),
            ("sp_rate_per_s", self.sp_rate_per_s, 0.0, f64::MAX),
            ("sp_settle_s", self.sp_settle_s, 0.0, day),
            ("evidence_max_age_s", self.evidence_max_age_s, 1.0, 31.0 * day),
            ("f_margin_percent", self.f_margin_percent, 0.0, 20.0),
            ("grant_max_s", self.grant_max_s, 1.0, 31.0 * day),
            ("measure_s", self.measure_s, 1.0, 7.0 * day),
            ("prove_s", self.prove_s, 1.0, 31.0 * day),
            ("ise_gain", self.ise_gain, 1.01, 1e6),
            ("ise_limit", self.ise_limit, 1.0, 1e6),
            ("travel_limit", self.travel_limit, 1.0, 1e6),
            ("reversal_band_percent", self.reversal_band_percent, 0.0, 20.0),
        ]
    }

    /// Longest time of an exchange: the term, what the device made of it, the heartbeat (ms).
    fn exchange_ms(&self) -> u64 {
        self.timeout_ms.saturating_mul(u64::from(IN_EXCHANGE))
    }

    /// Longest time for which a term can be in force after it was last recorded (s).
    pub fn term_lasts_s(&self) -> f64 {
        TERM_REPEAT_S + self.heartbeat_timeout_ms as f64 / 1000.0
    }

    /// Longest time that the daemon waits for this loop's term after a stop (s).
    pub fn longest_end_s(&self) -> f64 {
        self.withdraw_limit_s + self.max_step_ms as f64 / 1000.0 + GRACE.as_secs_f64()
    }

    /// The bounds as the gate keeps them, for a loop with this span and these limits of OP (OP unit).
    pub fn limits(&self, op_span: f64, op_limits: [f64; 2]) -> Limits {
        let s = |ms: u64| ms as f64 / 1000.0;
        Limits {
            clamp: self.clamp_percent,
            rate: self.rate_percent_per_s,
            withdraw_rate: self.withdraw_percent_per_s,
            withdraw_limit_s: self.withdraw_limit_s,
            dead_band: self.dead_band_percent,
            rest_s: s(self.rest_ms),
            max_step_s: s(self.max_step_ms),
            silence_s: s(self.heartbeat_timeout_ms.saturating_sub(self.exchange_ms())),
            clock_tolerance_s: s(self.clock_tolerance_ms),
            max_sample_age_s: s(self.max_sample_age_ms),
            max_missed_polls: self.max_missed_polls_per_minute,
            op_span,
            op_limits,
            op_margin: self.op_margin_percent,
            sp_rate: self.sp_rate_per_s,
            sp_settle_s: self.sp_settle_s,
            evidence_max_age_s: self.evidence_max_age_s,
            f_margin: self.f_margin_percent,
            grant_max_s: self.grant_max_s,
            criteria: Criteria {
                length_s: self.measure_s,
                prove_s: self.prove_s,
                ise_gain: self.ise_gain,
                ise_limit: self.ise_limit,
                travel_limit: self.travel_limit,
                reversal_band: self.reversal_band_percent,
            },
        }
    }

    /// The registers it writes on the wire, term first, where the device counts from `address_base`; each with its field
    /// and its width. `None` where one is not among the 65536.
    pub fn registers(&self, address_base: u8) -> [(&'static str, Option<u16>, u16); 2] {
        let on_wire = |address: i64, width: u16| {
            let start = address.checked_sub(i64::from(address_base))?;
            u16::try_from(start.checked_add(i64::from(width) - 1)?).ok()?;
            u16::try_from(start).ok()
        };
        let width = self.term_type.width();
        [
            ("term_address", on_wire(self.term_address, width), width),
            ("heartbeat_address", on_wire(self.heartbeat_address, 1), 1),
        ]
    }

    /// Where to write; `None` where the registers do not exist.
    pub fn target(&self, address: &str, unit_id: u8, address_base: u8) -> Option<Target> {
        let [(_, term, _), (_, heartbeat, _)] = self.registers(address_base);
        Some(Target {
            address: address.to_string(),
            unit_id,
            term: term?,
            heartbeat: heartbeat?,
            term_type: self.term_type,
            order: self.term_byte_order,
            scale: self.term_scale_percent,
            timeout: Duration::from_millis(self.timeout_ms),
        })
    }
}
