use super::*;

fn said(name: &str) -> Option<(&'static str, String)> {
    Name::new(name).said().map(|said| (said.meaning.as_str(), said.owner))
}

#[test]
fn names_of_vendors_say_what_they_are() {
    for (name, meaning, owner) in [
        ("t", "t", ""),
        ("Time Stamp", "t", ""),
        ("time [s]", "t", ""),
        ("t/min", "t", ""),
        ("t_ms", "t", ""),
        ("Timestamp (UTC)", "t", ""),
        ("OP [%]", "op", ""),
        ("OP %", "op", ""),
        ("OP%", "op", ""),
        ("PV degC", "pv", ""),
        ("PV, m3/h", "pv", ""),
        ("Process Value", "pv", ""),
        ("setpoint", "sp", ""),
        ("SV", "sp", ""),
        ("mv_stem", "mv", ""),
        ("FIC101.OP", "op", "fic101"),
        ("FIC101.PIDA.OP", "op", "fic101 pida"),
        ("FIC101/PID1/OUT.CV", "op", "fic101 pid1"),
        ("FIC101/PID1/PV.CV", "pv", "fic101 pid1"),
        ("FIC101/PID1/MODE.ACTUAL", "mode", "fic101 pid1"),
        ("FIC101:PV [m3/h]", "pv", "fic101"),
        ("FIC101_PV", "pv", "fic101"),
        ("('FIC101', 'PV')", "pv", "fic101"),
        ("[FIC101.PV]", "pv", "fic101"),
        ("Date Time, GMT+02:00", "t", ""),
        ("Time (Europe/Berlin)", "t", ""),
        ("Time (W. Europe Standard Time)", "t", ""),
        ("Time (hh:mm:ss)", "t", ""),
        ("Timestamp (dd/mm/yyyy hh:mm:ss)", "t", ""),
        ("Time min", "t", ""),
        ("UTC time", "t", ""),
        ("local_timestamp", "t", ""),
        ("Start time", "t", ""),
        ("\\\\SERVER\\FIC101.PV", "pv", "server fic101"),
        ("FIC101 OP %", "op", "fic101"),
        ("CV", "op", ""),
        ("FIC101 Out", "op", "fic101"),
        ("FIC-101 Process Value", "pv", "fic 101"),
        ("FIC101_OP.F_CV", "op", "fic101"),
        ("FIC101/MV#Value", "mv", "fic101"),
        ("FIC101.ScaledInput", "pv", "fic101"),
        ("OP_1", "op", "1"),
        ("PV 2 [%]", "pv", "2"),
        ("OP_B", "op", "b"),
        ("OP_A", "op", "a"),
        ("PV_C", "pv", "c"),
        ("PV_C [%]", "pv", "c"),
        ("PV, C", "pv", ""),
        ("t_s", "t", ""),
        ("Time h", "t", ""),
        ("Setpoint C", "sp", "c"),
        ("Mode_A", "mode", "a"),
        ("FIC101.OP_B", "op", "fic101 b"),
        ("FIC101_PV_C", "pv", "fic101 c"),
        ("FIC101 Out B", "op", "fic101 b"),
        ("OP [4-20 mA]", "op", ""),
        ("Flow (PV)", "pv", ""),
        ("Set point (SP)", "sp", ""),
        ("FIC101 (PV)", "pv", "fic101"),
        ("FIC101.OP - Valve of the feed", "op", "fic101"),
        ("FIC101.OP - Valve B", "op", "fic101"),
        ("FIC101OP", "op", "fic101"),
        ("PLC1/FIC101APV", "pv", "plc1 fic101a"),
        ("FIC101_OUTP", "op", "fic101"),
        ("FIC101.PIDA.PVEU", "pv", "fic101 pida"),
        ("Regelgröße", "pv", ""),
        ("輸出", "op", ""),
    ] {
        assert_eq!(said(name), Some((meaning, owner.to_string())), "{name}");
    }
    for name in [
        "flow",
        "flow_out",
        "T5",
        "T_C",
        "PV_Q",
        "flow_c",
        "T [degC]",
        "P1_kPa",
        "remark",
        "",
        "XMEAS1",
        "OP Min",
        "_measurement",
        "temp out",
        "FIC101 High Output",
        "FT101 Out",
        "OP_2026",
        "Output (PV)",
        "UTC offset",
        "FIC101.PV - FIC101.SP",
        "OP - PV",
        "FT101OP",
        "STOP",
        "FIC1OP",
        "TC101 mV",
        "Thermocouple_mV",
    ] {
        assert_eq!(said(name), None, "{name}");
    }
    for (name, unit) in [
        ("OP [4-20 mA]", "mA"),
        ("OP (0...100 %)", "%"),
        ("PV [5]", "5"),
        ("T [2-1]", "2-1"),
        ("Time (100 ms)", "100 ms"),
        ("t/min", "min"),
        ("t_s", "s"),
        ("Time h", "h"),
        ("OP_time_s", "s"),
        ("UTC time", "UTC"),
        ("Local Time", "Local"),
        ("PV, C", "C"),
        ("OP mV", "mV"),
    ] {
        assert_eq!(Name::new(name).unit.as_deref(), Some(unit), "{name}");
    }
}

#[test]
fn a_letter_behind_a_name_is_no_unit_but_of_times_or_behind_a_comma() {
    for name in ["OP_A", "OP V", "PV_C", "PV m", "SP K", "FIC101.PV C", "TI5_C", "Level m"] {
        assert_eq!(Name::new(name).unit, None, "{name}");
    }
    for (name, before, letter) in
        [("OP_B", "OP", "B"), ("FIC101.OP  B", "FIC101.OP", "B"), ("PV_c [%]", "PV", "c")]
    {
        let (own, behind) = Name::new(name).lettered().unwrap_or_else(|| panic!("{name} has a letter"));
        assert_eq!((own.full.as_str(), behind.as_str()), (before, letter), "{name}");
    }
    for name in ["OP", "PV_Q", "A M", "t_s", "TI5_C", "FIC101.OP - Valve B", "PV, C", "OP_1", ""] {
        assert!(Name::new(name).lettered().is_none(), "{name}");
    }
}

#[test]
fn a_loop_is_called_as_it_is_written() {
    for (name, owner) in [
        ("FIC101.PV (m³/h)", Some("FIC101")),
        ("FIC-101/PID1/OUT.CV", Some("FIC-101/PID1")),
        ("Root.Plant.FIC101.MV.Value", Some("Root.Plant.FIC101")),
        ("SCADA1.FIC101_OP.F_CV", Some("SCADA1.FIC101")),
        ("FIC101_OP", Some("FIC101")),
        ("FIC 101 Out", Some("FIC 101")),
        ("Régulation.FIC101OP", Some("Régulation.FIC101")),
        ("[FIC101.PV]", Some("FIC101")),
        ("OP [FIC101]", Some("FIC101")),
        ("OP_1", Some("1")),
        ("OP_B", Some("B")),
        ("FIC-101.OP_B", Some("FIC-101 B")),
        ("OP", None),
        ("flow", None),
    ] {
        assert_eq!(Name::new(name).owner_as_written().as_deref(), owner, "{name}");
    }
}

#[test]
fn a_quality_names_the_value_it_belongs_to() {
    let of = |name: &str| Name::new(name).quality_of();
    assert_eq!(of("pv_quality"), Some("pv".into()));
    assert_eq!(of("OP Status"), Some("op".into()));
    assert_eq!(of("FIC101.PV.Status"), Some("fic101 pv".into()));
    assert_eq!(of("Quality"), Some(String::new()));
    assert_eq!(of("q"), None);
    assert_eq!(of("pv"), None);
    assert!(Name::new("FIC101.PV").owns_quality("fic101 pv"));
    assert!(Name::new("FIC101.PV").owns_quality("pv"));
    assert!(Name::new("FIC101/PID1/PV.CV").owns_quality("fic101 pid1 pv"));
    assert!(!Name::new("FIC101.OP").owns_quality("pv"));
    assert!(Name::new("FIC101.PV C").owns_quality("fic101 pv"));
}

#[test]
fn somebody_who_writes_a_name_means_its_column() {
    assert!(Name::new("OP [%]").is("op"));
    assert!(Name::new("FIC101.OP").is("fic101.op"));
    assert!(!Name::new("FIC101.OP").is("op"));
}
