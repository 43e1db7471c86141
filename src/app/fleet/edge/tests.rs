use super::*;
use crate::alarm::State;
use crate::app::fleet::tests::edge;
use crate::app::persistence::Persistence;
use crate::config::Config;
use crate::history::History;
use crate::store::{self, Driven, Opener, Reader, Store, StoreError};
use std::sync::atomic::AtomicBool;

#[test]
fn an_order_for_another_edge_with_a_loop_of_the_same_name_is_not_done() {
    let (fleet, results) = edge("FIC1");
    let obey = |edge: &str| {
        let order = Action {
            subject: "FIC1".to_string(),
            kind: "stiction".to_string(),
            action: "take_out".to_string(),
            edge: edge.to_string(),
            ..Action::default()
        };
        fleet.obey(&order, 0.0, &mut Obeyed::default());
        results.alarm(&AlarmId::named("FIC1"), fleet.clock.now()).map(|own| own.state)
    };
    assert_eq!(obey("another"), Some(State::Normal));
    assert_eq!(obey(&fleet.name), Some(State::OutOfService));
}

#[tokio::test]
async fn what_nobody_has_heard_of_is_still_to_be_told() {
    let (fleet, results) = edge("FIC1");
    let (mut known, mut handed) = (Alone::default(), Handed::new());
    results.watch_trip(&LoopId::new("FIC1"), Some("a fault".into()), fleet.clock.now());
    fleet.tell(&mut known, &mut handed).await;
    assert!(handed.is_empty() && !fleet.outlet.is_heard());
    assert_eq!(known.untold(&results.alarm_log()).len(), 1, "there is no receiver");
    // The store of this edge is nowhere.
    let receiver = fleet.outlet.kept_by_a_task();
    fleet.tell(&mut known, &mut handed).await;
    assert!(handed.is_empty() && known.untold(&results.alarm_log()).is_empty());
    receiver.abort();
}

#[tokio::test]
async fn what_receivers_have_when_a_centre_is_back_is_told() {
    let (fleet, results) = edge("FIC1");
    let mut known = Alone::default();
    results.watch_trip(&LoopId::new("FIC1"), Some("a fault".into()), fleet.clock.now());
    let receiver = fleet.outlet.kept_by_a_task();
    let mut handed = fleet.hand(&known, &Vec::new()).await;
    assert_eq!((handed.len(), known.untold(&results.alarm_log()).len()), (1, 1));
    fleet.note_kept(&mut known, &mut handed).await;
    assert!(handed.is_empty() && known.untold(&results.alarm_log()).is_empty());
    receiver.abort();
}

#[tokio::test]
async fn an_edge_whose_store_takes_nothing_tells_people_by_itself_and_no_centre_does_once_more() {
    let (fleet, results) = edge("FIC1");
    let folder = std::env::temp_dir().join(format!("stictiond-edge-full-{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    let config = Config { store: Some(store::Config::new(folder.join("store"))), ..Config::default() };
    let has_room = Arc::new(AtomicBool::new(false));
    let room = has_room.clone();
    let open: Opener = Arc::new(move |config, _| {
        if room.load(Relaxed) {
            return Store::open(config);
        }
        let source = std::io::Error::other("no space left on device");
        Err(StoreError::Io { path: config.folder.clone(), source })
    });
    let driven = Driven { open, by_hand: true };
    let history = History::new(&[], &config.history);
    let persistence = Persistence::new(&config, fleet.clock, driven, (&history, &results));
    persistence.begin(results.clone());
    results.watch_trip(&LoopId::new("FIC1"), Some("a fault".into()), fleet.clock.now());
    assert!(!persistence.make_durable() && persistence.fails());

    let mut own = Forwarding::new(&fleet.site, &fleet.name, Duration::ZERO);
    let is_alone = |own: &mut Forwarding, now: Duration| {
        // A centre is there all the time.
        own.seen = Some((Seen { sequence: 7, holder: "c1".into(), epoch: 0 }, now));
        own.watch_store(persistence.fails(), now);
        fleet.is_alone(own.unheard_for(now))
    };
    let (second, cut_off) = (Duration::from_secs(1), Duration::from_secs_f64(fleet.config.cut_off_after_s));
    assert!(!is_alone(&mut own, second) && !is_alone(&mut own, second + cut_off));
    assert!(is_alone(&mut own, 2 * second + cut_off));
    let receiver = fleet.outlet.kept_by_a_task();
    fleet.tell(&mut own.known, &mut own.handed).await;
    assert!(own.handed.is_empty() && own.known.untold(&results.alarm_log()).is_empty());

    has_room.store(true, Relaxed);
    assert!(persistence.make_durable() && !persistence.fails());
    assert!(!is_alone(&mut own, 3 * second + cut_off));
    // It is forwarded now, with the mark that people know of it.
    let log = results.clone();
    let told = own.known.so_far(Box::new(move || log.alarm_log()), 0.0, false);
    let reader = Reader::of(config.store.as_ref().expect("there")).expect("readable");
    let rows = reader.transitions(0, 10).expect("readable");
    assert!(rows.len() == 1 && told.is_told(&rows[0].1), "{rows:?}");
    receiver.abort();
    std::fs::remove_dir_all(&folder).expect("writable");
}
