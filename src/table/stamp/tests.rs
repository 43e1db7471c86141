//! Stamps as people write them.

use super::*;

/// Seconds since 2026-06-01 00:00 on the written clock, and the offset.
fn read(cell: &str, order: Order) -> Option<(f64, Option<i32>)> {
    let stamp = scan(cell)?;
    let begin = days(2026, 6, 1)? * DAY;
    Some(((stamp.civil(order)? - begin) as f64 / SECOND as f64, stamp.offset))
}

#[test]
fn dates_of_every_kind_are_the_same_moment() {
    let six = 6.0 * 3600.0;
    for (cell, seconds, offset) in [
        ("2026-06-01T06:00:00Z", six, Some(0)),
        ("2026-06-01 06:00:00", six, None),
        ("2026-06-01 06:00:00+02:00", six, Some(7200)),
        ("2026-06-01 06:00:00 +0200", six, Some(7200)),
        ("2026-06-01 06:00:00 UTC", six, Some(0)),
        ("2026-06-01T06:00:02.030000Z", six + 2.03, Some(0)),
        ("2026/06/01 06:00", six, None),
        ("2026.06.01 06:00:00", six, None),
        ("20260601 060000", six, None),
        ("20260601060000", six, None),
        ("20260601T060000Z", six, Some(0)),
        ("01.06.2026 06:00:00", six, None),
        ("01.06.2026 06:00:02,030", six + 2.03, None),
        ("01-Jun-26 06:00:00", six, None),
        ("01-JUN-2026 06:00:00.030", six + 0.03, None),
        ("1 June 2026 06:00:00", six, None),
        ("Jun 1, 2026 6:00:00 AM", six, None),
        ("Mon Jun  1 06:00:00 2026", six, None),
        ("Mon, 01 Jun 2026 06:00:00 GMT", six, Some(0)),
        ("06:00:00 01.06.2026", six, None),
        ("\u{200e}01.\u{200e}06.\u{200e}2026 06:00:00", six, None),
        ("2026-06-01 12:00:00 AM", 0.0, None),
        ("2026-06-01 06:00:00 p.m.", six + 43200.0, None),
        ("2026-05-31 24:00:00", 0.0, None),
        ("2026年06月01日 06:00:00", six, None),
        ("2026-06-01", 0.0, None),
        ("01-Mai-26 06:00:00", six - 31.0 * 86_400.0, None),
        ("01-6月-26 06:00:00", six, None),
        ("2026년 06월 01일 06:00:00", six, None),
        ("2026/6/1 上午 06:00:00", six, None),
        ("2026-06-01 오후 6:00:00", six + 43200.0, None),
        ("1 июня 2026 06:00:00", six, None),
        ("01-cze-2026 06:00:00", six, None),
        ("01 jun. 2026 6:00:00 a. m.", six, None),
        ("2026-06-01 06:00:00 CEST", six, Some(7200)),
        ("Mon Jun 01 06:00:00 CET 2026", six, Some(3600)),
        ("2026-06-01T06:00:00+02:00[Europe/Berlin]", six, Some(7200)),
        ("Mon Jun 01 2026 06:00:00 GMT+0200 (Central European Summer Time)", six, Some(7200)),
        ("2026-06-01T06:00:00.000000000+02:00[America/Argentina/Buenos_Aires]", six, Some(7200)),
        ("mar. 02.06.2026 06:00:00", six + 86_400.0, None),
        ("2026-06-01 06:00:00 +0000 UTC", six, Some(0)),
        ("2026-06-01 06:00:00.03 +0200 CEST", six + 0.03, Some(7200)),
        ("2026-06-01 06:00:00 -0500 EST", six, Some(-18_000)),
        ("01.06.2026 06:00:00 Uhr", six, None),
        ("01.06.2026 06:00 h", six, None),
        ("1. 6. 2026 6:00:00", six, None),
        ("2026. 06. 01. 6:00:00", six, None),
        ("2026. június 1. 6:00:00", six, None),
        ("2026. 6. 1 오전 6:00:00", six, None),
        ("1.6.2026. 06:00:00", six, None),
        ("1.6.2026 klo 6.00.00", six, None),
        ("2026-06-01 kl. 06:00:00", six, None),
        ("01.06.2026 à 06:00:00", six, None),
        ("June 1, 2026 at 6:00:00 AM", six, None),
        ("June 1st, 2026 6:00 AM", six, None),
        ("1er juin 2026 06:00:00", six, None),
        ("1 de junio de 2026 06:00:00", six, None),
        ("1 de jun. de 2026 06:00:00", six, None),
        ("lundi 1 juin 2026 06:00:00", six, None),
        ("segunda-feira, 1 de junho de 2026 06:00:00", six, None),
        ("martes, 2 de junio de 2026 06:00:00", six + 86_400.0, None),
        ("2026年6月1日 6时00分00秒", six, None),
        ("2026年6月1日 6時00分02秒", six + 2.0, None),
        ("2026년 6월 1일 6시 00분 02초", six + 2.0, None),
        ("2026-06-01 06h00m02s", six + 2.0, None),
        ("2026-06-01 06h00", six, None),
        ("2026-06-01_06-00-02", six + 2.0, None),
        ("2026-152 06:00:00", six, None),
        ("2026-152T06:00:00.000Z", six, Some(0)),
        ("2026-06-01 6:00:00 πμ", six, None),
        ("2026-06-01 6:00:00 μ.μ.", six + 43200.0, None),
        ("2026-06-01 6:00:00 SA", six, None),
        ("1.6.2026 г. 6:00:00 ч.", six, None),
        ("1.6.2026 г.", 0.0, None),
    ] {
        for order in Order::ALL {
            assert_eq!(read(cell, order), Some((seconds, offset)), "{cell} {order:?}");
        }
    }
}

#[test]
fn three_numbers_are_read_in_the_order_that_is_decided() {
    let day = |cell, order| read(cell, order).map(|(seconds, _)| seconds / 86_400.0);
    assert_eq!(day("01/06/2026 00:00:00", Order::Dmy), Some(0.0));
    assert_eq!(day("06/01/2026 12:00:00 AM", Order::Mdy), Some(0.0));
    assert_eq!(day("06/13/2026", Order::Dmy), None);
    assert_eq!(day("26/06/01", Order::Ymd), Some(0.0));
    assert_eq!(day("01/06/2026", Order::Ymd), None);
    // With points and two digits of the year, too.
    assert_eq!(day("1.6.26 0:00", Order::Dmy), Some(0.0));
    assert_eq!(day("1. 6. 26. 0:00", Order::Dmy), Some(0.0));
    assert_eq!(day("26.06.01", Order::Ymd), Some(0.0));
    assert_eq!(day("06.01.26", Order::Mdy), Some(0.0));
}

#[test]
fn what_is_no_stamp_is_none() {
    for cell in [
        "",
        "Average",
        "Total samples: 1200",
        "51.812",
        "1.002",
        "10.0.0.5",
        "2024-02-30x",
        "25:00",
        "2026-06-01 25:00:00",
        "2026-06-01T06:00:00[Europe/Berlin]",
        "2026-06-01 06:00:00 (CEST)",
        "2026-06-01 06:00:00 [bad]",
        "06:61",
        "13:00 PM",
        "2026-06-01 06:00:00 Mars",
        "Jun 1",
        "1780293600",
        "2026-06-01 06:00:00+99:00",
        "2026-166",
        "2026-000 06:00:00",
        "2025-366 06:00:00",
        "2026-06-01 V",
        "06h75m02s",
        "1. 6. 2026 at",
        "15.06. 06:00:00",
    ] {
        assert_eq!(scan(cell), None, "{cell}");
    }
    // Several zones are called so: the column is read with the zone that somebody tells.
    assert!(scan("2026-06-01 06:00:00 CST").is_some_and(|stamp| stamp.has_letters && stamp.offset.is_none()));
    assert_eq!(scan("2024-02-30").and_then(|stamp| stamp.civil(Order::Dmy)), None);
    let clock =
        |cell: &str| scan(cell).and_then(|stamp| stamp.time_of_day()).map(|ns| ns as f64 / SECOND as f64);
    assert_eq!(clock("06:00:02.5"), Some(21_602.5));
    for (cell, hours) in
        [("25:00:00", 25.0), ("1 day, 1:00:00", 25.0), ("0 days 06:00:00", 6.0), ("2 days", 48.0)]
    {
        assert_eq!(clock(cell), Some(hours * 3600.0), "{cell}");
    }
}
