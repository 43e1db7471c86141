//! History read slice by slice: each value once, whatever happens to the server or to us on the way.

use super::rig::{COUNTER, Server, TICK_S, checked, config, folder, holes, plan, steady};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use stictiond::collect::opcua::{HistoryError, Keep, Pinned, Slice, Wish, history};
use stictiond::signal::Sample;

/// Half a minute of what the server has kept for two, in slices of five seconds.
pub fn wish(newest_first: bool) -> Wish {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).expect("after 1970").as_secs_f64();
    let (from, to) = ((now - 60.0).floor(), (now - 30.0).floor());
    Wish { from, to, newest_first, slice_s: 5.0, pause: Duration::ZERO, average_s: None }
}

/// Takes slices; may replace the server before it takes one, or take no more.
#[derive(Default)]
pub struct Taker {
    slices: Vec<Slice>,
    server: Option<Server>,
    restart_before: Option<usize>,
    refuse_from: Option<usize>,
}

impl Keep for Taker {
    async fn keep(&mut self, slice: Slice) -> Result<(), String> {
        if self.refuse_from.is_some_and(|from| self.slices.len() >= from) {
            return Err("the disk is full".to_string());
        }
        if self.restart_before == Some(self.slices.len())
            && let Some(server) = self.server.take()
        {
            let port = server.port.to_string();
            server.kill().await;
            self.server = Some(Server::start(&["--history", "--backlog", "120", "--port", &port]).await);
        }
        self.slices.push(slice);
        Ok(())
    }
}

impl Taker {
    /// The samples of a tag over all slices, which are to be the wish's own in its order.
    pub fn samples(&self, tag: usize, wish: &Wish) -> Vec<Sample> {
        let spans: Vec<(f64, f64)> = self.slices.iter().map(|slice| (slice.from, slice.to)).collect();
        assert_eq!(spans, wish.slices().collect::<Vec<_>>(), "each slice once");
        let mut slices: Vec<&Slice> = self.slices.iter().collect();
        slices.sort_by(|a, b| a.from.total_cmp(&b.from));
        let of = |slice: &&Slice| slice.series.iter().find(|(at, _)| *at == tag).map(|(_, s)| s.clone());
        slices.iter().filter_map(of).flatten().collect()
    }
}

/// Every tick of the wish's time, once, at its own time.
pub fn complete(samples: &[Sample], wish: &Wish, step: u64) {
    let ticks = checked(samples);
    let gaps: Vec<_> = holes(&ticks).into_iter().filter(|(a, b)| b - a != step).collect();
    assert_eq!(gaps, [], "nothing lost");
    let expected = (wish.to - wish.from) / TICK_S / step as f64;
    // The first and the last may lie on the edge.
    assert!((ticks.len() as f64 - expected).abs() <= 1.0, "{} of {expected}", ticks.len());
}

#[tokio::test]
async fn a_server_restarted_in_the_middle_costs_nothing_and_repeats_nothing() {
    tokio::join!(restarted_in_the_middle(false, &[]), restarted_in_the_middle(true, &["--cap", "70"]));
}

async fn restarted_in_the_middle(newest_first: bool, more: &[&str]) {
    let args = [&["--history", "--backlog", "120"], more].concat();
    let server = Server::start(&args).await;
    let plan = plan(&config(server.port, "reconnect_max_ms = 1000"), &[COUNTER.into()]);
    let wish = wish(newest_first);
    let mut taker = Taker { server: Some(server), restart_before: Some(2), ..Taker::default() };
    history(&plan, &wish, &Pinned::default(), &mut taker).await.expect("it is read");
    complete(&taker.samples(0, &wish), &wish, 1);
}

#[tokio::test]
async fn what_was_left_goes_on_where_it_was_left() {
    let server = Server::start(&["--history", "--backlog", "120"]).await;
    let plan = plan(&config(server.port, ""), &[COUNTER.into()]);
    for newest_first in [false, true] {
        let wish = wish(newest_first);
        let mut taker = Taker { refuse_from: Some(3), ..Taker::default() };
        let refused = history(&plan, &wish, &Pinned::default(), &mut taker).await;
        assert_eq!(refused, Err(HistoryError::Kept("the disk is full".to_string())));
        let last = taker.slices.last().expect("three were taken");
        let rest = wish.after(if newest_first { last.from } else { last.to });
        taker.refuse_from = None;
        history(&plan, &rest, &Pinned::default(), &mut taker).await.expect("it is read");
        complete(&taker.samples(0, &wish), &wish, 1);
    }
}

#[tokio::test]
async fn another_server_over_continuation_points_and_a_node_without_history() {
    let folder = folder("node-past");
    let server = Server::start_node(&folder, 0, 120).await;
    let counter = || "node = 'ns=1;s=Counter'".to_string();
    let wish = Wish { slice_s: 30.0, ..wish(false) };
    let mut taker = Taker::default();
    let read = plan(&config(server.port, ""), &[counter()]);
    history(&read, &wish, &Pinned::default(), &mut taker).await.expect("it is read");
    complete(&taker.samples(0, &wish), &wish, 2);
    for tag in ["node = 'ns=1;s=Steady3'".to_string(), "path = '/1:Plant/1:Nowhere'".to_string()] {
        let read = plan(&config(server.port, ""), &[tag]);
        let refused = history(&read, &wish, &Pinned::default(), &mut Taker::default())
            .await
            .expect_err("there is none");
        assert!(refused.to_string().starts_with("tag 0: "), "{refused}");
    }
    std::fs::remove_dir_all(folder).expect("it was made");
}

#[tokio::test]
async fn means_that_a_server_does_not_make_are_refused_in_one_line() {
    let server = Server::start(&["--history", "--backlog", "120"]).await;
    let read = plan(&config(server.port, ""), &[COUNTER.into(), steady(1)]);
    let wish = Wish { average_s: Some(1.0), ..wish(false) };
    let refused = history(&read, &wish, &Pinned::default(), &mut Taker::default())
        .await
        .expect_err("asyncua makes none");
    assert!(!refused.to_string().contains('\n') && refused.to_string().contains("tag 0"), "{refused}");
}
