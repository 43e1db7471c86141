//! What the machines say to each other, as protobuf: fields that a reader does not know are skipped, so a fleet may have
//! several versions at once. Times are seconds since the Unix epoch, by the clock of the machine that says them.

use prost::Message;
use prost::bytes::Bytes;

/// Samples of one loop that came since the last such message.
#[derive(Clone, PartialEq, Message)]
pub struct Samples {
    /// Its tags that have new ones.
    #[prost(message, repeated, tag = "1")]
    pub tags: Vec<TagSamples>,
    /// Where each tag of the loop is after this message, those without new samples too.
    #[prost(message, repeated, tag = "2")]
    pub places: Vec<Place>,
    /// The edge that says so: two edges of a site may have a loop of one name.
    #[prost(string, tag = "3")]
    pub edge: String,
}

/// How far a tag has been forwarded.
#[derive(Clone, PartialEq, Message)]
pub struct Place {
    /// The tag.
    #[prost(string, tag = "1")]
    pub tag: String,
    /// Where it is read.
    #[prost(string, tag = "2")]
    pub source: String,
    /// Stamp of the last sample that was forwarded (s).
    #[prost(double, tag = "3")]
    pub last: f64,
}

/// Samples of one tag.
#[derive(Clone, PartialEq, Message)]
pub struct TagSamples {
    /// `op`, `pv`, `sp`, `mode`, `mv` or another tag's name; the term of write-back never leaves its edge.
    #[prost(string, tag = "1")]
    pub tag: String,
    /// Where it is read and how it is decoded: another source is another tag.
    #[prost(string, tag = "2")]
    pub source: String,
    /// The samples as [`codec::encode`](crate::store::codec::encode) writes them.
    #[prost(bytes = "bytes", tag = "3")]
    pub block: Bytes,
    /// The edge's clock was set back before the first of them: they are earlier than what came before, and no repetition.
    #[prost(bool, tag = "4")]
    pub set_back: bool,
    /// Stamp of the sample of this tag that was forwarded last before these (s); none where that is not known.
    #[prost(double, optional, tag = "5")]
    pub after: Option<f64>,
}

/// A window to be diagnosed, with everything that a diagnosis depends on.
#[derive(Clone, PartialEq, Message)]
pub struct Window {
    /// The loop.
    #[prost(string, tag = "1")]
    pub control_loop: String,
    /// Settings, effects known before, and which samples, as a bundle has them (JSON).
    #[prost(string, tag = "2")]
    pub basis: String,
    /// The samples, in the record's order.
    #[prost(message, repeated, tag = "3")]
    pub tags: Vec<TagSamples>,
    /// When the samples were copied (s).
    #[prost(double, tag = "4")]
    pub started: f64,
    /// Whether somebody asked for it.
    #[prost(bool, tag = "5")]
    pub on_demand: bool,
    /// Nobody waits for an answer for longer (s).
    #[prost(double, tag = "6")]
    pub answer_within_s: f64,
    /// Version and build of the program that asks: another one may find something else, so it refuses the window.
    #[prost(string, tag = "7")]
    pub version: String,
}

/// What a worker says of a window.
#[derive(Clone, PartialEq, Message)]
pub struct Answer {
    /// SHA-256 of the window's bytes.
    #[prost(bytes = "vec", tag = "1")]
    pub window: Vec<u8>,
    /// Who says it.
    #[prost(string, tag = "2")]
    pub worker: String,
    /// The diagnosis; absent where the window could not be read.
    #[prost(message, optional, tag = "3")]
    pub run: Option<Run>,
    /// Why there is none.
    #[prost(string, optional, tag = "4")]
    pub refused: Option<String>,
}

/// A diagnosis by an edge, as its store has it.
#[derive(Clone, PartialEq, Message)]
pub struct Diagnosis {
    /// Its number in the edge's store.
    #[prost(uint64, tag = "1")]
    pub number: u64,
    /// The diagnosis.
    #[prost(message, optional, tag = "2")]
    pub run: Option<Run>,
    /// The loop's model after it, where the store has one.
    #[prost(message, optional, tag = "3")]
    pub model: Option<Model>,
    /// The edge that says so: two edges of a site may have a loop of one name.
    #[prost(string, tag = "4")]
    pub edge: String,
}

/// A run and what it said.
#[derive(Clone, PartialEq, Message)]
pub struct Run {
    /// The loop, by its name at the site.
    #[prost(string, tag = "1")]
    pub control_loop: String,
    /// When it ended (s).
    #[prost(double, tag = "2")]
    pub finished: f64,
    /// How long it took (s).
    #[prost(double, tag = "3")]
    pub took_s: f64,
    /// Whether somebody asked for it.
    #[prost(bool, tag = "4")]
    pub on_demand: bool,
    /// A verdict, `deadline_exceeded` or `panicked`.
    #[prost(string, tag = "5")]
    pub outcome: String,
    /// Why nothing could be said, for machines.
    #[prost(string, optional, tag = "6")]
    pub reason_code: Option<String>,
    /// In one line.
    #[prost(string, tag = "7")]
    pub reason: String,
    /// Friction.
    #[prost(double, optional, tag = "8")]
    pub f: Option<f64>,
    /// Lower end of its 95 % interval.
    #[prost(double, optional, tag = "9")]
    pub f_low: Option<f64>,
    /// Upper end.
    #[prost(double, optional, tag = "10")]
    pub f_high: Option<f64>,
    /// Whether f is in per cent of OP's span.
    #[prost(bool, tag = "11")]
    pub f_in_percent: bool,
    /// Evidence (-).
    #[prost(double, optional, tag = "12")]
    pub delta_aic: Option<f64>,
    /// Version and build of the program that said it.
    #[prost(string, tag = "13")]
    pub version: String,
    /// The whole report, JSON packed by zstd; absent for a run that failed.
    #[prost(bytes = "vec", optional, tag = "14")]
    pub report: Option<Vec<u8>>,
    /// What it worked on, JSON packed by zstd.
    #[prost(bytes = "vec", optional, tag = "15")]
    pub basis: Option<Vec<u8>>,
    /// The effects in the model, in the order they were added.
    #[prost(message, repeated, tag = "16")]
    pub effects: Vec<Effect>,
    /// Share of PV's standard deviation that the model does not explain (0..1).
    #[prost(double, optional, tag = "17")]
    pub unexplained: Option<f64>,
}

/// An effect in a loop's model.
#[derive(Clone, PartialEq, Message)]
pub struct Effect {
    /// As the report names it.
    #[prost(string, tag = "1")]
    pub kind: String,
    /// Its tag, where it is measured.
    #[prost(string, optional, tag = "2")]
    pub tag: Option<String>,
}

/// A version of a loop's model.
#[derive(Clone, PartialEq, Message)]
pub struct Model {
    /// Counted from 1.
    #[prost(uint64, tag = "1")]
    pub version: u64,
    /// Since when (s).
    #[prost(double, tag = "2")]
    pub since: f64,
    /// Its effects, as the store writes them.
    #[prost(string, tag = "3")]
    pub effects: String,
}

/// An alarm of an edge: how it stands, and what happened to it.
#[derive(Clone, PartialEq, Message)]
pub struct Alarm {
    /// Number of the change in the edge's store.
    #[prost(uint64, tag = "1")]
    pub number: u64,
    /// How it stands now.
    #[prost(message, optional, tag = "2")]
    pub state: Option<AlarmState>,
    /// What happened.
    #[prost(message, optional, tag = "3")]
    pub change: Option<AlarmChange>,
    /// Whether the edge has told people of it, because it reached no centre.
    #[prost(bool, tag = "4")]
    pub told: bool,
    /// The edge that says so: two edges of a site may have a loop of one name.
    #[prost(string, tag = "5")]
    pub edge: String,
}

/// How all alarms of a loop or collector stand. The stream keeps the last of each, so that a centre which reads for the first
/// time, or has lost its disk, knows of alarms that have not changed since.
#[derive(Clone, PartialEq, Message)]
pub struct States {
    /// Those that have ever changed; all others of the loop or collector are normal.
    #[prost(message, repeated, tag = "1")]
    pub alarms: Vec<AlarmState>,
    /// The edge that says so: two edges of a site may have a loop of one name.
    #[prost(string, tag = "2")]
    pub edge: String,
}

/// How an alarm stands, as the store keeps it.
#[derive(Clone, PartialEq, Message)]
pub struct AlarmState {
    /// The loop, or the collector, by its name at the site.
    #[prost(string, tag = "1")]
    pub subject: String,
    /// What it is about.
    #[prost(string, tag = "2")]
    pub kind: String,
    /// The condition holds.
    #[prost(bool, tag = "3")]
    pub active: bool,
    /// Somebody has seen it.
    #[prost(bool, tag = "4")]
    pub acknowledged: bool,
    /// The condition went and the alarm stays.
    #[prost(bool, tag = "5")]
    pub latched: bool,
    /// Until when it is shelved (s).
    #[prost(double, optional, tag = "6")]
    pub shelved_until: Option<f64>,
    /// Shelved until its condition goes.
    #[prost(bool, tag = "7")]
    pub one_shot: bool,
    /// Suppressed by design.
    #[prost(bool, tag = "8")]
    pub suppressed: bool,
    /// Out of service.
    #[prost(bool, tag = "9")]
    pub out_of_service: bool,
    /// Votes that count to the next change, as text.
    #[prost(string, tag = "10")]
    pub votes: String,
    /// Since when a condition holds that has to hold for longer (s).
    #[prost(double, optional, tag = "11")]
    pub pending: Option<f64>,
    /// When it was raised last, as text.
    #[prost(string, tag = "12")]
    pub raises: String,
    /// The highest priority since then.
    #[prost(string, optional, tag = "13")]
    pub priority: Option<String>,
    /// f over time, as text.
    #[prost(string, tag = "14")]
    pub trend: String,
    /// When the state last changed (s).
    #[prost(double, optional, tag = "15")]
    pub since: Option<f64>,
    /// When the condition was last raised (s).
    #[prost(double, optional, tag = "16")]
    pub raised_at: Option<f64>,
    /// What the condition is, in one line.
    #[prost(string, tag = "17")]
    pub detail: String,
    /// Who acted last.
    #[prost(string, optional, tag = "18")]
    pub by: Option<String>,
    /// What they said.
    #[prost(string, optional, tag = "19")]
    pub comment: Option<String>,
}

/// What happened to an alarm, as the store keeps it.
#[derive(Clone, PartialEq, Message)]
pub struct AlarmChange {
    /// When (s).
    #[prost(double, tag = "1")]
    pub at: f64,
    /// State before.
    #[prost(string, tag = "2")]
    pub before: String,
    /// State after.
    #[prost(string, tag = "3")]
    pub after: String,
    /// Why.
    #[prost(string, tag = "4")]
    pub cause: String,
    /// How soon somebody had to act.
    #[prost(string, optional, tag = "5")]
    pub priority: Option<String>,
    /// What the condition was, in one line.
    #[prost(string, tag = "6")]
    pub detail: String,
    /// Who acted.
    #[prost(string, optional, tag = "7")]
    pub by: Option<String>,
    /// What they said.
    #[prost(string, optional, tag = "8")]
    pub comment: Option<String>,
}

/// What somebody at the centre did about an alarm.
#[derive(Clone, PartialEq, Message)]
pub struct Action {
    /// The loop, or the collector, by its name at the site.
    #[prost(string, tag = "1")]
    pub subject: String,
    /// What the alarm is about.
    #[prost(string, tag = "2")]
    pub kind: String,
    /// `acknowledge`, `reset`, `shelve`, `shelve_once`, `unshelve`, `take_out` or `give_back`.
    #[prost(string, tag = "3")]
    pub action: String,
    /// How long it is shelved (s), where it is.
    #[prost(double, optional, tag = "4")]
    pub duration_s: Option<f64>,
    /// Who.
    #[prost(string, optional, tag = "5")]
    pub by: Option<String>,
    /// What they said.
    #[prost(string, optional, tag = "6")]
    pub comment: Option<String>,
    /// When (s).
    #[prost(double, tag = "7")]
    pub at: f64,
    /// The lease that the centre held: an edge refuses one that is older than the newest it has seen.
    #[prost(uint64, tag = "8")]
    pub epoch: u64,
    /// When the condition that was seen was raised (s): an acknowledgement counts for that one only.
    #[prost(double, optional, tag = "9")]
    pub raised_at: Option<f64>,
    /// When the state that was seen began, by the edge's clock (s): what a person did there since was not known.
    #[prost(double, optional, tag = "10")]
    pub since: Option<f64>,
    /// The edge that is meant, where several edges of the site have a loop of this name; empty where any of them is.
    #[prost(string, tag = "11")]
    pub edge: String,
}

/// A part of an edge's announcement: some of the bytes of a [`Hello`].
#[derive(Clone, PartialEq, Message)]
pub struct HelloPart {
    /// Digest of the whole list: all parts of one announcement have the same.
    #[prost(bytes = "vec", tag = "1")]
    pub whole: Vec<u8>,
    /// Its number among the parts, from 0.
    #[prost(uint32, tag = "2")]
    pub number: u32,
    /// How many parts there are.
    #[prost(uint32, tag = "3")]
    pub count: u32,
    /// Its bytes of the list.
    #[prost(bytes = "bytes", tag = "4")]
    pub body: Bytes,
}

/// The list that an edge announces.
#[derive(Clone, PartialEq, Message)]
pub struct Hello {
    /// Its loops.
    #[prost(message, repeated, tag = "1")]
    pub loops: Vec<Loop>,
    /// Its collectors, whose alarms it has.
    #[prost(string, repeated, tag = "2")]
    pub collectors: Vec<String>,
}

/// A loop as it is configured, without addresses of devices.
#[derive(Clone, PartialEq, Message)]
pub struct Loop {
    /// Its name at the site.
    #[prost(string, tag = "1")]
    pub id: String,
    /// For people.
    #[prost(string, tag = "2")]
    pub description: String,
    /// For people.
    #[prost(string, tag = "3")]
    pub group: String,
    /// Time between two diagnoses (s).
    #[prost(double, tag = "4")]
    pub period_s: f64,
    /// Span of OP (OP unit), where it is configured.
    #[prost(double, optional, tag = "5")]
    pub op_span: Option<f64>,
    /// Lower output limit (OP unit).
    #[prost(double, optional, tag = "6")]
    pub op_low: Option<f64>,
    /// Upper output limit (OP unit).
    #[prost(double, optional, tag = "7")]
    pub op_high: Option<f64>,
    /// Its tags.
    #[prost(message, repeated, tag = "8")]
    pub tags: Vec<Tag>,
    /// Loops of the same edge whose stream enters this one.
    #[prost(string, repeated, tag = "9")]
    pub upstream: Vec<String>,
    /// Price of a standard deviation of one PV unit, where it is configured.
    #[prost(double, optional, tag = "10")]
    pub cost_per_sd: Option<f64>,
    /// Unit of the price, for people.
    #[prost(string, tag = "11")]
    pub cost_unit: String,
}

/// A tag of a loop.
#[derive(Clone, PartialEq, Message)]
pub struct Tag {
    /// `op`, `pv`, `sp`, `mode`, `mv` or another tag's name.
    #[prost(string, tag = "1")]
    pub name: String,
    /// Where it is read and how it is decoded.
    #[prost(string, tag = "2")]
    pub source: String,
    /// Engineering unit.
    #[prost(string, tag = "3")]
    pub unit: String,
    /// The collector that reads it.
    #[prost(string, tag = "4")]
    pub collector: String,
}

/// That an edge, a worker or a centre is there.
#[derive(Clone, PartialEq, Message)]
pub struct Pulse {
    /// `edge`, `worker` or `centre`.
    #[prost(string, tag = "1")]
    pub role: String,
    /// Version and build of its program.
    #[prost(string, tag = "2")]
    pub version: String,
    /// Its clock (s).
    #[prost(double, tag = "3")]
    pub at: f64,
    /// Since when it runs (s).
    #[prost(double, tag = "4")]
    pub since: f64,
    /// Age of the oldest sample, diagnosis or alarm that waits to be forwarded (s).
    #[prost(double, tag = "5")]
    pub lag_s: f64,
    /// Diagnoses that it made.
    #[prost(uint64, tag = "6")]
    pub diagnosed: u64,
    /// Loops that it has.
    #[prost(uint64, tag = "7")]
    pub loops: u64,
    /// Which of its certificates ends first: the section, or the device or broker, and the key that names it.
    #[prost(string, optional, tag = "8")]
    pub certificate: Option<String>,
    /// When that ends (s).
    #[prost(double, optional, tag = "9")]
    pub certificate_until: Option<f64>,
}

/// How far an edge has forwarded what its store numbers.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct Cursor {
    /// Diagnoses.
    #[prost(message, optional, tag = "1")]
    pub diagnoses: Option<Progress>,
    /// Changes of alarms.
    #[prost(message, optional, tag = "2")]
    pub changes: Option<Progress>,
}

/// How far a stream has what an edge's store numbers. The cursor is in another stream and may outlive the messages that it counts,
/// so it says where the last of them is.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct Progress {
    /// Number of the last that the stream has acknowledged.
    #[prost(uint64, tag = "1")]
    pub number: u64,
    /// Number of its message in the stream; 0 where the stream that there is now has acknowledged none.
    #[prost(uint64, tag = "2")]
    pub sequence: u64,
    /// When the stream was made (ns since the Unix epoch).
    #[prost(int64, tag = "3")]
    pub made: i64,
    /// Number of the last that the server has had for so long that a loss of power takes it no more.
    #[prost(uint64, tag = "4")]
    pub on_disk: u64,
}

#[cfg(test)]
mod tests;
