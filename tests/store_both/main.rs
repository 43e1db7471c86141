//! One suite for the store in a folder and the store in PostgreSQL, and what is only true of the latter.

mod hypertables;
mod large;
mod outage;
mod place;
#[path = "../peers/postgres.rs"]
mod postgres;
mod suite;
mod unknown;

use place::Place;

/// Each promise twice.
macro_rules! both {
    ($($name:ident)*) => {
        mod in_a_folder {
            $(#[test] fn $name() { crate::suite::$name(&mut super::Place::folder()); })*
        }
        mod in_postgresql {
            $(#[test] fn $name() { crate::suite::$name(&mut super::Place::postgres()); })*
        }
    };
}

both! {
    what_was_written_is_there_after_reopening
    every_number_and_quality_comes_back_to_the_last_bit
    stamps_of_any_order_find_their_place
    nothing_is_there_twice_and_a_good_sample_replaces_a_bad_one
    the_last_samples_of_each_tag_come_back_as_a_ring_held_them
    a_clock_that_is_set_back_begins_another_era
    diagnoses_models_and_alarms_come_back
    the_last_run_and_the_last_that_said_something_come_whole
    a_gap_in_an_alarms_history_is_found
    what_is_old_is_thinned_to_trends_and_then_goes
    the_last_that_was_said_keeps_its_number_however_old_its_stamp_is
    a_clock_that_is_set_forward_takes_no_history_with_it
    what_is_exported_and_imported_is_the_same
    another_version_and_another_writer_are_refused
}
