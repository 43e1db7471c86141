//! A point in time as sentences write it.

/// A time `t` (s) as text: a date and time in UTC where stamps count from the Unix epoch, as in the daemon; otherwise seconds, as in
/// the record.
pub fn moment(t: f64) -> String {
    if !is_date(t) {
        return format!("{t:.1} s");
    }
    let seconds = t.round() as i64;
    let (year, month, day) = date(seconds.div_euclid(86_400));
    let of_day = seconds.rem_euclid(86_400);
    let (hour, minute, second) = (of_day / 3600, of_day / 60 % 60, of_day % 60);
    format!("{year:04}-{month:02}-{day:02} {hour:02}:{minute:02}:{second:02} UTC")
}

/// Whether a stamp (s) counts from the Unix epoch. A record that counts from its own beginning is shorter than three years, and
/// stamps of the Unix epoch end before the year 5000.
pub fn is_date(t: f64) -> bool {
    (1e8..1e11).contains(&t)
}

/// Year, month and day of a number of days after 1970-01-01, by the Gregorian calendar. Years begin in March, so that the leap day is
/// the last day of its year.
///
/// Source: Hinnant, "chrono-compatible low-level date algorithms".
fn date(days: i64) -> (i64, i64, i64) {
    let from_march_of_0 = days + 719_468;
    let era = from_march_of_0.div_euclid(146_097);
    let of_era = from_march_of_0.rem_euclid(146_097);
    let year_of_era = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let from_march = (5 * of_year + 2) / 153;
    let day = of_year - (153 * from_march + 2) / 5 + 1;
    let month = if from_march < 10 { from_march + 3 } else { from_march - 9 };
    let year = 400 * era + year_of_era + i64::from(month <= 2);
    (year, month, day)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_moment_of_the_daemon_is_a_date_and_one_of_a_file_is_a_number() {
        for (t, said) in [
            (1_767_225_600.0, "2026-01-01 00:00:00 UTC"),
            (1_767_229_345.0, "2026-01-01 01:02:25 UTC"),
            (1_767_225_599.4, "2025-12-31 23:59:59 UTC"),
            (1_767_225_599.6, "2026-01-01 00:00:00 UTC"),
            (951_782_400.0, "2000-02-29 00:00:00 UTC"),
            (951_868_799.0, "2000-02-29 23:59:59 UTC"),
            (951_868_800.0, "2000-03-01 00:00:00 UTC"),
            (1e8, "1973-03-03 09:46:40 UTC"),
            (8610.04, "8610.0 s"),
            (0.0, "0.0 s"),
            (-1.0, "-1.0 s"),
            (1e12, "1000000000000.0 s"),
            (f64::NAN, "NaN s"),
        ] {
            assert_eq!(moment(t), said);
        }
    }

    #[test]
    fn every_day_comes_after_the_one_before() {
        let lengths = |year: i64| {
            let leap = (year % 4 == 0 && year % 100 != 0) || year % 400 == 0;
            [31, 28 + i64::from(leap), 31, 30, 31, 30, 31, 31, 30, 31, 30, 31]
        };
        let (mut year, mut month, mut day) = (1970, 1, 1);
        // 2100 has no leap day.
        for days in 0..60_000 {
            assert_eq!(date(days), (year, month, day), "{days}");
            day += 1;
            if day > lengths(year)[month as usize - 1] {
                (month, day) = (month + 1, 1);
            }
            if month > 12 {
                (year, month) = (year + 1, 1);
            }
        }
    }
}
