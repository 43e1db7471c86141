//! Which messages of a stream may be deleted. Pure.

/// A stream is nearly full when this share of its room is taken: what comes within a minute has to fit into the rest.
const NEARLY_FULL: (u64, u64) = (3, 4);
/// When this share is taken nothing is waited for any more: a full stream takes nothing from anybody.
const ALMOST_FULL: (u64, u64) = (9, 10);

/// A reader of a stream, as its server knows it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Reader {
    /// What it is called.
    pub(super) name: String,
    /// Number of the last message that it has done, and with it all before.
    pub(super) floor: u64,
    /// Messages that it was given and has not done.
    pub(super) under_way: usize,
}

/// Number of the last message that every reader has done, with all before it; `None` where nothing may be deleted, or a reader that
/// is `needed` is not there. A server that `forgets` knows no longer what is under way once it has deleted something: then nothing
/// is deleted while a reader holds a message.
pub(super) fn done_by_all(readers: &[Reader], needed: &[&str], forgets: bool) -> Option<u64> {
    let is_there = |name: &&str| readers.iter().any(|own| own.name == **name);
    let is_held = forgets && readers.iter().any(|own| own.under_way > 0);
    if !needed.iter().all(is_there) || is_held {
        return None;
    }
    readers.iter().map(|own| own.floor).min().filter(|floor| *floor > 0)
}

/// Number of the last message that `own` has done, with all before it, and who has not done all of that. `None`, too, while `own`
/// holds a message, where that `waits`.
pub(super) fn done_by<'a>(readers: &'a [Reader], own: &str, waits: bool) -> Option<(u64, Vec<&'a str>)> {
    let reader = readers.iter().find(|reader| reader.name == own)?;
    let floor = Some(reader.floor).filter(|_| !waits || reader.under_way == 0)?;
    let behind = readers.iter().filter(|reader| reader.floor < floor).map(|reader| reader.name.as_str());
    (floor > 0).then(|| (floor, behind.collect()))
}

/// Whether a stream is nearly full; one without a bound never is.
pub(super) fn is_nearly_full(bytes: u64, room: i64) -> bool {
    has_taken(NEARLY_FULL, bytes, room)
}

/// Whether there is so little room that nothing is waited for.
pub(super) fn is_almost_full(bytes: u64, room: i64) -> bool {
    has_taken(ALMOST_FULL, bytes, room)
}

fn has_taken((share, of): (u64, u64), bytes: u64, room: i64) -> bool {
    let room = u64::try_from(room).unwrap_or(0);
    room > 0 && u128::from(bytes) * u128::from(of) >= u128::from(room) * u128::from(share)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reader(name: &str, floor: u64, under_way: usize) -> Reader {
        Reader { name: name.to_string(), floor, under_way }
    }

    #[test]
    fn what_every_reader_has_done_goes_also_while_one_is_at_work() {
        let readers = [reader("c1", 90, 3), reader("c2", 70, 0), reader("tell", 80, 1)];
        assert_eq!(done_by_all(&readers, &["tell", "c1"], false), Some(70));
        assert_eq!(done_by_all(&readers, &["tell", "c1"], true), None, "an old server would forget four");
        let idle = readers.map(|own| Reader { under_way: 0, ..own });
        assert_eq!(done_by_all(&idle, &["tell"], true), Some(70));
    }

    #[test]
    fn nothing_goes_before_everybody_has_begun() {
        assert_eq!(done_by_all(&[], &[], false), None);
        assert_eq!(done_by_all(&[reader("c1", 90, 0)], &["tell"], false), None, "people are not told yet");
        assert_eq!(done_by_all(&[reader("c1", 90, 0), reader("c2", 0, 0)], &["c1"], false), None);
    }

    #[test]
    fn where_there_is_no_room_a_reader_that_stopped_holds_up_nobody_and_is_named() {
        let readers = [reader("c1", 90, 3), reader("c2", 5, 0), reader("c3", 95, 0)];
        assert_eq!(done_by(&readers, "c1", false), Some((90, vec!["c2"])));
        assert_eq!(done_by(&readers, "c1", true), None, "an old server would forget three of its own");
        assert_eq!(done_by(&readers, "c3", true), Some((95, vec!["c1", "c2"])));
        assert_eq!(done_by(&readers, "c4", false), None);
        assert_eq!(done_by(&[reader("c1", 0, 0)], "c1", false), None);
    }

    #[test]
    fn a_stream_is_nearly_full_at_three_quarters() {
        assert!(!is_nearly_full(749, 1000) && is_nearly_full(750, 1000));
        assert!(!is_almost_full(899, 1000) && is_almost_full(900, 1000));
        assert!(!is_nearly_full(u64::MAX, -1) && is_nearly_full(u64::MAX, i64::MAX));
    }
}
