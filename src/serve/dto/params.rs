//! What a caller may ask for: query strings and bodies. Unknown names are refused.

use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

/// Query of the list of loops.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
pub struct LoopsQuery {
    /// What to sort by; equal keys by id. Default `severity`.
    #[param(inline)]
    pub sort: Sort,
    /// `asc` or `desc`; default `asc` for `id`, `group` and `score`, else `desc`.
    #[param(inline)]
    pub order: Option<Order>,
    /// Only loops whose latest diagnosis says this.
    #[param(inline)]
    pub verdict: Option<VerdictFilter>,
    /// Only loops whose alarm is in this state.
    #[param(inline)]
    pub alarm: Option<AlarmState>,
    /// Only loops of this group.
    pub group: Option<String>,
    /// Only loops of this site: of the group that is called so, and of every group whose name is `site / unit`.
    pub site: Option<String>,
    /// Only loops whose id, description or group contains this, whatever the case.
    pub q: Option<String>,
    /// Loops a page, 1 to 1000; default 100.
    #[param(minimum = 1, maximum = 1000)]
    pub limit: Option<usize>,
    /// `next` of the page before. Pages stay stable: a loop whose key does not change is neither repeated nor lost.
    pub after: Option<String>,
}

/// What to sort loops by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Sort {
    /// What needs looking at first.
    #[default]
    Severity,
    /// Name.
    Id,
    /// Group, then name.
    Group,
    /// Friction.
    F,
    /// Evidence.
    DeltaAic,
    /// Age of the latest diagnosis.
    Age,
    /// Score, unknown ones last.
    Score,
    /// What the swing costs, unknown ones last.
    Cost,
}

/// Direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Order {
    /// Least first.
    Asc,
    /// Greatest first.
    Desc,
}

/// A verdict, or none yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum VerdictFilter {
    /// Sticks.
    Stiction,
    /// Does not.
    NoStiction,
    /// Cannot be told.
    NotIdentifiable,
    /// Not diagnosed yet.
    None,
}

impl VerdictFilter {
    /// Whether a verdict passes.
    pub fn passes(self, verdict: Option<&str>) -> bool {
        verdict
            == match self {
                Self::Stiction => Some("stiction"),
                Self::NoStiction => Some("no_stiction"),
                Self::NotIdentifiable => Some("not_identifiable"),
                Self::None => None,
            }
    }
}

/// The state of an alarm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum AlarmState {
    /// No condition, nothing to do.
    Normal,
    /// The condition holds and nobody has seen it.
    Unacknowledged,
    /// The condition holds and somebody has seen it.
    Acknowledged,
    /// The condition went away before anybody saw it.
    ReturnedUnacknowledged,
    /// The condition went away, the alarm stays, and nobody has seen it.
    LatchedUnacknowledged,
    /// The condition went away, somebody has seen it, and the alarm stays until it is reset.
    LatchedAcknowledged,
    /// Silenced until a time, or until the condition goes.
    Shelved,
    /// Silenced by the design of the plant.
    SuppressedByDesign,
    /// Taken out of service by hand.
    OutOfService,
}

/// What an alarm is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum AlarmKind {
    /// The valve sticks.
    Stiction,
    /// Friction grows.
    FRising,
    /// Nothing can be said of the loop for long.
    NotIdentifiable,
    /// A tag is frozen or bad.
    TagBad,
    /// A collector brings no good sample.
    CollectorDown,
    /// Write-back was closed by a fault.
    CompensationTripped,
    /// The model leaves most of PV's movement unexplained.
    UnexplainedResidual,
}

/// How soon somebody has to act.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum AlarmPriority {
    /// When there is time.
    Low,
    /// This week.
    Medium,
    /// Today.
    High,
}

/// Query of a loop's samples.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
pub struct SamplesQuery {
    /// From this time on: RFC 3339, or seconds since the Unix epoch. Default: the oldest there is.
    pub from: Option<String>,
    /// Up to this time. Default: the newest there is.
    pub to: Option<String>,
    /// Samples per tag at most, 3 to 20000; default 1000. Thinned so that peaks and gaps survive.
    #[param(minimum = 3, maximum = 20000)]
    pub points: Option<usize>,
}

/// Query of a diagnosis on demand.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
pub struct RunQuery {
    #[param(minimum = 0, maximum = 60)]
    /// How long to wait for the result (s), 0 to 60; default 5. Afterwards the answer is 202 and the run goes on.
    pub wait_s: Option<f64>,
}

/// Query of a loop's runs.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
pub struct RunsQuery {
    /// Runs a page, 1 to 10000; default 100.
    #[param(minimum = 1, maximum = 10000)]
    pub limit: Option<usize>,
    /// `next` of the page before. Runs that are made meanwhile move no page.
    pub after: Option<String>,
}

/// Query of the devices.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
pub struct CollectorsQuery {
    /// Devices a page, 1 to 10000; default 1000.
    #[param(minimum = 1, maximum = 10000)]
    pub limit: Option<usize>,
    /// `next` of the page before: the name of its last device.
    pub after: Option<String>,
}

/// Query of the alarms.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
pub struct AlarmsQuery {
    /// Only this state. Default: every state but `normal`.
    #[param(inline)]
    pub state: Option<AlarmState>,
    /// Only this kind.
    #[param(inline)]
    pub kind: Option<AlarmKind>,
    /// Only this priority.
    #[param(inline)]
    pub priority: Option<AlarmPriority>,
    /// Only this loop's.
    pub r#loop: Option<String>,
    /// Alarms a page, 1 to 10000; default 1000.
    #[param(minimum = 1, maximum = 10000)]
    pub limit: Option<usize>,
    /// `next` of the page before: the name of its last alarm.
    pub after: Option<String>,
}

/// Query of the alarms' history.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
pub struct AlarmHistoryQuery {
    /// Only this loop.
    pub r#loop: Option<String>,
    /// Only this kind.
    #[param(inline)]
    pub kind: Option<AlarmKind>,
    /// Entries at most, 1 to 2000; default 100.
    #[param(minimum = 1, maximum = 2000)]
    pub limit: Option<usize>,
    /// `next` of the page before.
    pub after: Option<u64>,
}

/// Query of what takes none.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NoQuery {}

/// Body of an acknowledgement or the end of a shelving; may be left out.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ActBody {
    /// Who acts, at most 100 characters; believed as it is, unless there is a log-in, which says who.
    pub by: Option<String>,
    /// What they say, at most 1000 characters.
    pub comment: Option<String>,
}

/// Body of a grant of write-back.
#[cfg(feature = "writeback")]
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct GrantBody {
    /// Who grants, at most 100 characters; believed as it is, unless there is a log-in, which says who.
    #[serde(default)]
    pub by: Option<String>,
    /// How long (s).
    pub duration_s: f64,
}

/// Body of what an operator does about write-back.
#[cfg(feature = "writeback")]
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NameBody {
    /// Who acts, at most 100 characters; believed as it is, unless there is a log-in, which says who.
    #[serde(default)]
    pub by: Option<String>,
}

/// Body of a shelving.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ShelveBody {
    /// How long (s).
    pub duration_s: f64,
    /// Only until the condition goes, and at most `duration_s`.
    #[serde(default)]
    pub one_shot: bool,
    /// Who acts, at most 100 characters; believed as it is, unless there is a log-in, which says who.
    #[serde(default)]
    pub by: Option<String>,
    /// What they say, at most 1000 characters.
    #[serde(default)]
    pub comment: Option<String>,
}
