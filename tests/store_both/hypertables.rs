//! The branch for TimescaleDB, which is not to be had here, against what stands in for it: see `timescaledb.sql`.

use crate::place::{Place, batch, good, tag, whole};
use crate::suite;
use stictiond::store::Store;

#[test]
fn samples_and_trends_become_hypertables_by_time() {
    let mut place = Place::hypertables();
    let mut store = Store::open(&place.config()).expect("opens");
    store.write(&batch(&tag("A", "op"), good(0..50))).expect("writes");
    assert!(!store.spool().expect("there is one").waits);
    let checked = whole(&place);
    assert!(checked.samples == 50 && checked.sample_bytes > 0, "{checked:?}");
    let mut client = place.cluster().client().expect("answers");
    let rows = client
        .query(
            "SELECT name, time_column::text, extract(epoch FROM span)::float8, default_indexes FROM hypertables
             ORDER BY name",
            &[],
        )
        .expect("reads");
    let made: Vec<(String, String, f64, bool)> =
        rows.iter().map(|row| (row.get(0), row.get(1), row.get(2), row.get(3))).collect();
    // Six hours and thirty days; the key is index enough.
    let expected = [("samples", 21_600.0), ("trends", 2_592_000.0)];
    assert_eq!(made, expected.map(|(name, span)| (name.into(), "at".into(), span, false)));
    let partitions = "SELECT count(*) FROM pg_inherits";
    assert_eq!(client.query_one(partitions, &[]).expect("reads").get::<_, i64>(0), 0);
}

#[test]
fn what_is_old_goes_by_whole_chunks() {
    let mut place = Place::hypertables();
    suite::what_is_old_is_thinned_to_trends_and_then_goes(&mut place);
    let mut client = place.cluster().client().expect("answers");
    let row = client
        .query_one(
            "SELECT count(*) FILTER (WHERE name = 'samples'), count(*) FILTER (WHERE name = 'trends'),
                bool_and(older_than = date_bin(CASE name WHEN 'samples' THEN interval '6 hours' ELSE '30 days' END,
                    older_than, timestamptz 'epoch')) FROM dropped",
            &[],
        )
        .expect("reads");
    let (samples, trends, aligned): (i64, i64, bool) = (row.get(0), row.get(1), row.get(2));
    assert!(samples > 0 && trends > 0 && aligned, "{samples} {trends} {aligned}");
}

#[test]
fn the_rest_of_the_suite_holds() {
    suite::stamps_of_any_order_find_their_place(&mut Place::hypertables());
    suite::nothing_is_there_twice_and_a_good_sample_replaces_a_bad_one(&mut Place::hypertables());
    suite::what_is_exported_and_imported_is_the_same(&mut Place::hypertables());
}
