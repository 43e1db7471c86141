//! Words of the field, of vendors, and of a few languages, by what a column of such a name holds.

/// Times.
pub const TIME: &[&str] = &[
    "t",
    "time",
    "timestamp",
    "time stamp",
    "date",
    "datetime",
    "date time",
    "ts",
    "datum",
    "zeit",
    "uhrzeit",
    "datum uhrzeit",
    "datum zeit",
    "zeitstempel",
    "sourcetimestamp",
    "source timestamp",
    "sample time",
    "event time",
    "index level 0",
    "timestring",
    "time string",
    "t stamp",
    "seconds",
    "minutes",
    "hours",
    "ip trend time",
    "dateandtime",
    "date and time",
    "elapsed",
    "elapsed time",
    "datenum",
    "x value",
    "ticks",
    "hora",
    "fecha",
    "fecha hora",
    "horodatage",
    "date heure",
    "tijd",
    "tijdstip",
    "čas",
    "idő",
    "日時",
    "時間",
    "时间",
    "시간",
];
/// The controller's output.
pub const OP: &[&str] = &[
    "op",
    "co",
    "out",
    "output",
    "controller output",
    "control output",
    "manipulated variable",
    "lmn",
    "cout",
    "cv",
    "stellgröße",
    "stellgrösse",
    "stellgroesse",
    "stellwert",
    "op value",
    "valve demand",
    "cveu",
];
/// The measured value.
pub const PV: &[&str] = &[
    "pv",
    "process value",
    "process variable",
    "measured value",
    "meas",
    "measurement",
    "istwert",
    "actual value",
    "pv value",
    "pv in",
    "pv out",
    "scaledinput",
    "scaled input",
];
/// The set point.
pub const SP: &[&str] = &[
    "sp",
    "sv",
    "spt",
    "setpoint",
    "set point",
    "set value",
    "sollwert",
    "sp value",
    "wsp",
    "working setpoint",
    "sp out",
];
/// The valve's position.
pub const MV: &[&str] = &[
    "mv",
    "mv stem",
    "stem",
    "stem position",
    "valve position",
    "travel",
    "valve travel",
    "position feedback",
];
/// The controller's mode.
pub const MODE: &[&str] = &[
    "mode",
    "mode actual",
    "controller mode",
    "loop mode",
    "block mode",
    "auto man",
    "auto manual",
    "man auto",
    "betriebsart",
    "mode act",
];

/// Names that hold a date, whose time of day may stand in a column of its own.
pub const DATES: &[&str] = &["date", "datum", "day"];
/// Names that hold the time of day beside a date.
pub const CLOCKS: &[&str] = &["time", "zeit", "uhrzeit", "clock", "time of day"];

/// Last parts of a path that say "its value": what they are the value of stands before them.
pub const VALUES: &[&str] = &["cv", "f cv", "val", "value", "present value", "presentvalue"];
/// Names of a column that says whether the value beside it is good.
pub const QUALITIES: &[&str] = &[
    "quality",
    "qual",
    "status",
    "statuscode",
    "status code",
    "data quality",
    "dataintegrity",
    "data integrity",
    "validity",
    "valid",
    "isgood",
    "is good",
    "confidence",
    "qualität",
    "qualitaet",
    "qualité",
    "qualite",
    "calidad",
    "qualidade",
    "kvalitet",
    "güte",
    "jakość",
    "品質",
    "质量",
    "dataquality",
    "opcquality",
    "opc quality",
    "qualitydetail",
    "qualitycode",
    "quality code",
    "качество",
    "quality detail",
    "q",
    "st",
];
/// Those of them that mean nothing without the name of a value before them.
pub const SHORT_QUALITIES: &[&str] = &["q", "st"];

/// Those of them that hold the numbers of OPC.
pub const DETAILS: [&str; 4] = ["opcquality", "opc quality", "qualitydetail", "quality detail"];

/// Columns that name the loop of a row.
pub const OWNERS: [&str; 19] = [
    "device",
    "device id",
    "plant",
    "site",
    "name",
    "valve",
    "regler",
    "equipment",
    "source",
    "loop",
    "loop id",
    "loopid",
    "loop name",
    "controller",
    "asset",
    "tag",
    "tagname",
    "tag name",
    "regelkreis",
];
