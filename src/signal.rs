//! The types that all modules share: samples with a quality, the raw record of one loop, and the equally sampled window that the
//! diagnosis works on. Imports nothing internal.
//!
//! | abbreviation | what it is |
//! |---|---|
//! | OP | controller output |
//! | PV | process variable |
//! | SP | set point |
//! | MV | measured position of the valve's stem |

mod figures;
mod moment;
mod outages;
mod span;

pub use figures::{along_op, along_op_beside, beside, figures, many, share, share_beside, told, trimmed};
pub use moment::{is_date, moment};
pub use outages::{AT_LIMIT, LARGEST_VALUE, Limits, are_measured, is_limit, outages, quantile};
pub use span::{Scale, SpanSource, span_at_least, span_of_unit};
use std::borrow::Cow;
use std::fmt;
use std::sync::Arc;

/// The name of a control loop, as the plant writes it (`FIC101`); cheap to clone.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct LoopId(Arc<str>);

impl LoopId {
    /// Takes any text as the loop's name; `config` decides which names a plant may use.
    pub fn new(name: impl Into<Arc<str>>) -> Self {
        Self(name.into())
    }

    /// The name as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for LoopId {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&self.0)
    }
}

/// The role of a tag in its loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Role {
    /// Controller output (% of span, or the unit the plant uses).
    Op,
    /// Process variable.
    Pv,
    /// Set point.
    Sp,
    /// 1 in automatic, 0 otherwise (decoded by the collector).
    Mode,
    /// The valve's true, measured position.
    Mv,
    /// The term that write-back adds to OP behind the controller (OP unit): each value is in force from its stamp on.
    Term,
}

impl Role {
    /// Its name, as options, configuration, messages and the store write it.
    pub fn as_str(self) -> &'static str {
        match self {
            Role::Op => "op",
            Role::Pv => "pv",
            Role::Sp => "sp",
            Role::Mode => "mode",
            Role::Mv => "mv",
            Role::Term => "term",
        }
    }
}

/// Why a sample cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BadReason {
    /// The device answered with an exception: it is alive and refuses this address.
    DeviceException,
    /// No answer in time.
    Timeout,
    /// No connection to the device.
    LinkDown,
    /// The value left the range the configuration allows.
    OutOfRange,
    /// The bit pattern is no number (NaN, infinity) or the text was none.
    NotANumber,
}

/// The quality of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Quality {
    /// Read from the device just now.
    Good,
    /// The device repeats an old value (frozen, or marked so by its source).
    Stale,
    /// Not usable, with the reason.
    Bad(BadReason),
}

impl Quality {
    /// Every quality.
    pub const ALL: [Quality; 7] = [
        Quality::Good,
        Quality::Stale,
        Quality::Bad(BadReason::DeviceException),
        Quality::Bad(BadReason::Timeout),
        Quality::Bad(BadReason::LinkDown),
        Quality::Bad(BadReason::OutOfRange),
        Quality::Bad(BadReason::NotANumber),
    ];

    /// True when the diagnosis may use the sample.
    pub fn is_good(self) -> bool {
        self == Quality::Good
    }

    /// The quality as the API writes it: `good`, `stale`, `bad:timeout`, ….
    pub fn as_str(self) -> &'static str {
        match self {
            Quality::Good => "good",
            Quality::Stale => "stale",
            Quality::Bad(BadReason::DeviceException) => "bad:device_exception",
            Quality::Bad(BadReason::Timeout) => "bad:timeout",
            Quality::Bad(BadReason::LinkDown) => "bad:link_down",
            Quality::Bad(BadReason::OutOfRange) => "bad:out_of_range",
            Quality::Bad(BadReason::NotANumber) => "bad:not_a_number",
        }
    }

    /// The quality that [`Quality::as_str`] writes so.
    pub fn named(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|quality| quality.as_str() == word)
    }
}

/// One value of one tag.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Time (s): since the Unix epoch in the daemon, since any beginning in a file.
    pub t: f64,
    /// The value in the tag's unit; NaN when `quality` is bad and no value exists.
    pub value: f64,
    /// Its quality.
    pub quality: Quality,
}

impl Sample {
    /// A good sample.
    pub fn good(t: f64, value: f64) -> Self {
        Self { t, value, quality: Quality::Good }
    }
}

/// The 64-bit FNV-1a hash of some bytes. Every later version gives the same hash, so that it can be stored.
pub fn fnv1a(bytes: impl Iterator<Item = u8>) -> u64 {
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

/// Samples of one tag, in the order they arrived.
pub type Series = Vec<Sample>;

/// The raw record of one loop, each tag with its own stamps. The gate of the diagnosis makes a [`Window`] of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Record {
    /// Controller output.
    pub op: Series,
    /// Process variable.
    pub pv: Series,
    /// Set point, where recorded.
    pub sp: Option<Series>,
    /// Automatic (1) or not (0), where recorded.
    pub mode: Option<Series>,
    /// Measured stem position, where there is one.
    pub mv: Option<Series>,
    /// The terms that write-back added to OP (OP unit), each in force until the next, where a loop has write-back.
    pub term: Option<Series>,
    /// Other tags by name.
    pub tags: Vec<(String, Series)>,
    /// The controller's output limits (OP unit), where known: saturation is judged against them.
    pub op_limits: Option<(f64, f64)>,
    /// The span of OP in its own unit (100 for per cent), where known.
    pub op_span: Option<f64>,
    /// Where the span is known from.
    pub op_span_source: SpanSource,
    /// Whether the process integrates, where that is known. The verdict does not depend on it; some of the published methods do.
    pub integrates: Option<bool>,
    /// A hash of where OP and PV are read, where it is known: another place is another valve.
    pub source: Option<u64>,
}

impl Record {
    /// The limits of OP, where they are known, with the time of the last sample of OP and PV.
    pub fn limits(&self) -> Option<Limits> {
        let times = self.op.iter().chain(&self.pv).map(|own| own.t).filter(|t| t.is_finite());
        Some(Limits { range: self.op_limits?, end: times.fold(f64::NEG_INFINITY, f64::max) })
    }

    /// The term of write-back in force at time `t` (OP unit); 0 before the first.
    pub fn term_at(&self, t: f64) -> f64 {
        let terms = self.term.as_deref().unwrap_or_default();
        let before = terms[..terms.partition_point(|own| own.t <= t)].iter().rev();
        let usable = |own: &&Sample| own.quality.is_good() && own.value.is_finite();
        before.into_iter().find(usable).map_or(0.0, |own| own.value)
    }

    /// The signal that the valve received: OP plus the term that was in force at each of its samples.
    pub fn input(&self) -> Cow<'_, [Sample]> {
        if self.term.as_ref().is_none_or(Vec::is_empty) {
            return Cow::Borrowed(&self.op);
        }
        let told = |own: &Sample| Sample { value: own.value + self.term_at(own.t), ..*own };
        Cow::Owned(self.op.iter().map(told).collect())
    }

    /// The share of a window's rows at which a term of write-back was in force (0..1).
    pub fn compensated(&self, window: &Window) -> f64 {
        let acted = |k: &usize| self.term_at(window.t0 + *k as f64 * window.ts) != 0.0;
        (0..window.len()).filter(acted).count() as f64 / window.len().max(1) as f64
    }
}

/// How a fit uses a row of a window.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Row {
    /// Its error counts.
    #[default]
    Counts,
    /// OP and PV are right, but carry no information on the valve: the error does not count.
    Silent,
    /// OP or PV was not measured: its value was filled in, and the error does not count.
    Missing,
}

/// The data of one loop on an equal grid, with finite values only. Where OP or PV was not measured, its likeliest value is filled in;
/// a model takes its own prediction in place of such a PV.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Window {
    /// Time of the first sample (s).
    pub t0: f64,
    /// Sample period (s).
    pub ts: f64,
    /// Controller output, N values.
    pub op: Vec<f64>,
    /// Process variable, N values.
    pub pv: Vec<f64>,
    /// Set point, N values, where recorded.
    pub sp: Option<Vec<f64>>,
    /// Measured stem position, N values, where there is one.
    pub mv: Option<Vec<f64>>,
    /// Other tags by name, N values each.
    pub tags: Vec<(String, Vec<f64>)>,
    /// How a fit uses each row, N values; empty where all count.
    pub rows: Vec<Row>,
}

impl Window {
    /// How a fit uses row `k`.
    pub fn row(&self, k: usize) -> Row {
        self.rows.get(k).copied().unwrap_or_default()
    }

    /// Number of rows that count.
    pub fn counted(&self) -> usize {
        self.len() - self.rows.iter().filter(|row| **row != Row::Counts).count()
    }

    /// The share of rows that are missing (0..1).
    pub fn missing(&self) -> f64 {
        let missing = self.rows.iter().filter(|row| **row == Row::Missing).count();
        missing as f64 / self.len().max(1) as f64
    }

    /// Number of samples N.
    pub fn len(&self) -> usize {
        self.op.len()
    }

    /// True when there is no sample.
    pub fn is_empty(&self) -> bool {
        self.op.is_empty()
    }

    /// The samples `from..to` as a window of their own.
    pub fn slice(&self, from: usize, to: usize) -> Window {
        let cut = |v: &Vec<f64>| v[from..to].to_vec();
        Window {
            t0: self.t0 + from as f64 * self.ts,
            ts: self.ts,
            op: cut(&self.op),
            pv: cut(&self.pv),
            sp: self.sp.as_ref().map(cut),
            mv: self.mv.as_ref().map(cut),
            tags: self.tags.iter().map(|(name, v)| (name.clone(), cut(v))).collect(),
            rows: self.rows.get(from..to).unwrap_or_default().to_vec(),
        }
    }
}
