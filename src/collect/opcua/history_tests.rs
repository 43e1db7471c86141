//! Slices and their parts, and historians without end, without a server.

use super::*;
use crate::collect::opcua::value::date_time;
use crate::collect::opcua::{Config, TagSpec};
use opcua::types::{DataValue, StatusCode, Variant};

#[test]
fn slices_cover_the_wish_once_and_go_on_where_they_were_left() {
    let wish = Wish {
        from: 10.0,
        to: 35.0,
        newest_first: false,
        slice_s: 10.0,
        pause: Duration::ZERO,
        average_s: None,
    };
    let of = |wish: Wish| wish.slices().collect::<Vec<_>>();
    assert_eq!(of(wish), [(10.0, 20.0), (20.0, 30.0), (30.0, 35.0)]);
    let back = Wish { newest_first: true, ..wish };
    assert_eq!(of(back), [(25.0, 35.0), (15.0, 25.0), (10.0, 15.0)]);
    assert_eq!(of(wish.after(20.0)), [(20.0, 30.0), (30.0, 35.0)]);
    assert_eq!(of(back.after(25.0)), [(15.0, 25.0), (10.0, 15.0)]);
    assert_eq!((of(wish.after(35.0)), of(back.after(10.0))), (vec![], vec![]));
}

fn wish() -> Wish {
    let pause = Duration::ZERO;
    Wish { from: 0.0, to: 4096.0, newest_first: false, slice_s: 4096.0, pause, average_s: None }
}

#[test]
fn a_slice_that_is_too_much_is_divided_and_the_next_ones_with_it() {
    for newest_first in [false, true] {
        let wish = Wish { to: 80.0, newest_first, slice_s: 40.0, ..wish() };
        let (mut rest, mut parts) = (rest_of(&wish), Vec::new());
        while let Some(part) = rest.part() {
            // More than 15 s are too much.
            if part.1 - part.0 > 15.0 && rest.divide(part) {
                continue;
            }
            parts.push((part, rest.left(part).is_none()));
            rest.kept(part, false);
        }
        assert_eq!(parts.iter().filter(|(_, last)| *last).count(), 2, "{parts:?}");
        let mut spans: Vec<(f64, f64)> = parts.into_iter().map(|(part, _)| part).collect();
        if newest_first {
            spans.reverse();
        }
        assert_eq!((spans[0].0, spans[spans.len() - 1].1), (0.0, 80.0));
        assert!(spans.windows(2).all(|pair| pair[0].1 == pair[1].0), "{spans:?}");
        assert!(spans.iter().all(|(from, to)| to - from <= 10.0), "{spans:?}");
    }
    let means = Wish { average_s: Some(60.0), slice_s: 300.0, ..wish() };
    let mut rest = rest_of(&means);
    assert!(rest.divide((0.0, 300.0)) && rest.part() == Some((0.0, 120.0)), "whole means");
    assert!(rest.divide((0.0, 120.0)) && !rest.divide((0.0, 60.0)));
    assert!(!rest_of(&wish()).divide((5.0, 6.0)));
}

#[test]
fn parts_grow_again_behind_a_dense_hour() {
    for newest_first in [false, true] {
        let wish = Wish { newest_first, ..wish() };
        let mut rest = rest_of(&wish);
        let whole = rest.part().expect("there is one");
        assert!(rest.divide(whole));
        for _ in 0..5 {
            let part = rest.part().expect("there is one");
            assert!(rest.divide(part));
        }
        let mut spans = Vec::new();
        while let Some(part) = rest.part() {
            spans.push(part.1 - part.0);
            rest.kept(part, spans.len() != 1);
        }
        // The first was as much as can be held; the last is what is left.
        assert_eq!(spans, [64.0, 64.0, 128.0, 256.0, 512.0, 1024.0, 2048.0]);
    }
}

/// A server that answers as it is told: by how often it was asked before, and from when to when.
struct Told<F> {
    asked: usize,
    takes: Duration,
    answer: F,
}

impl<F: FnMut(usize, f64, f64) -> Page + Send> Historian for Told<F> {
    fn batch(&self) -> usize {
        1
    }

    async fn ask(
        &mut self,
        nodes: &[(NodeId, ByteString)],
        from: f64,
        to: f64,
    ) -> Result<Option<Vec<Page>>, Lost> {
        assert_eq!(nodes.len(), 1);
        sleep(self.takes).await;
        self.asked += 1;
        Ok(Some(vec![(self.answer)(self.asked - 1, from, to)]))
    }
}

/// Values at these times, and whether there is a continuation.
fn page(times: impl Iterator<Item = f64>, more: bool) -> Page {
    let value = |t: f64| DataValue {
        value: Some(Variant::Double(t)),
        source_timestamp: Some(date_time(t)),
        ..DataValue::null()
    };
    let next = if more { ByteString::from(vec![1]) } else { ByteString::null() };
    Page { values: times.map(value).collect(), status: StatusCode::Good, next }
}

/// What came of reading.
type Came = Result<Read<Vec<(usize, Vec<Sample>)>>, Ended>;

fn whole(came: Came) -> Vec<(usize, Vec<Sample>)> {
    match came {
        Ok(Read::Whole(series)) => series,
        _ => panic!("it is not whole"),
    }
}

/// Of which tag there was too much, and of what.
fn too_much(came: Came) -> (String, String) {
    match came {
        Ok(Read::TooMuch(tag, why)) => (tag, why),
        _ => panic!("it was not too much"),
    }
}

/// What is read of the whole wish by as many tags, and how often the server was asked.
async fn read_by(
    tags: usize,
    takes: Duration,
    answer: impl FnMut(usize, f64, f64) -> Page + Send,
) -> (Came, usize) {
    let text = "name = 'd'\nurl = 'opc.tcp://d:4840/'\nsecurity_policy = 'None'";
    let spec = |index: usize| TagSpec {
        index,
        name: format!("tag {index}"),
        role: None,
        config: toml::from_str(&format!("device = 'd'\nnode = 'ns=2;s=A{index}'")).expect("sound"),
        frozen_after_s: None,
    };
    let config: Config = toml::from_str(text).expect("sound");
    let plan = Plan::new(0, &config, (0..tags).map(spec).collect()).expect("sound");
    let tags: Vec<(&Tag, NodeId)> = plan.tags.iter().map(|tag| (tag, NodeId::null())).collect();
    let mut told = Told { asked: 0, takes, answer };
    let wish = wish();
    let read = part(&mut told, &tags, &wish, (wish.from, wish.to)).await;
    (read, told.asked)
}

#[tokio::test(start_paused = true)]
async fn pages_are_read_to_their_end_over_continuations_and_caps() {
    // Ten values a page: by continuation up to 100 s, then capped without a word up to 200 s.
    let answer = |asked: usize, from: f64, _: f64| match asked {
        0..10 => page((0..10).map(|k| (asked * 10 + k) as f64), asked < 9),
        _ => page((0..10).map(|k| from + f64::from(k)).filter(|t| *t < 200.0), false),
    };
    let (read, _) = read_by(1, Duration::ZERO, answer).await;
    let series = whole(read);
    let times: Vec<f64> = series[0].1.iter().map(|sample| sample.t).collect();
    assert_eq!(times, (0..200).map(f64::from).collect::<Vec<f64>>());
}

#[tokio::test(start_paused = true)]
async fn pages_that_bring_nothing_end() {
    let endless = |_: usize, _: f64, _: f64| page(std::iter::empty(), true);
    let (read, asked) = read_by(1, Duration::ZERO, endless).await;
    let (tag, why) = match read {
        Err(Ended::For(HistoryError::Tag(tag, why))) => (tag, why),
        other => panic!("{other:?}"),
    };
    assert!(tag == "tag 0" && why.contains("nothing newer") && asked == 100, "{why}, {asked}");
    // What lies behind the time that was asked for is none of it, and no reason to ask on.
    let behind = |_: usize, _: f64, to: f64| page([to, to + 1.0].into_iter(), false);
    let (read, asked) = read_by(1, Duration::ZERO, behind).await;
    let series = whole(read);
    assert!(series[0].1.is_empty() && asked == 1, "{asked}");
}

#[tokio::test(start_paused = true)]
async fn what_is_held_is_bounded_over_all_tags() {
    // 40,000 values of each tag, so that the thirteenth is too many.
    let many = |_: usize, from: f64, _: f64| page((0..40_000).map(|k| from + f64::from(k) / 10.0), false);
    let (read, asked) = read_by(20, Duration::ZERO, many).await;
    let (tag, why) = too_much(read);
    assert!(tag == "tag 12" && why.contains("500000"), "{tag}, {why}, {asked}");
}

#[tokio::test(start_paused = true)]
async fn a_server_is_not_waited_for_for_ever() {
    // A value every nine seconds, and always one more.
    let slow = |asked: usize, _: f64, _: f64| page(std::iter::once(asked as f64 / 100.0), true);
    let (read, asked) = read_by(1, Duration::from_secs(9), slow).await;
    let (_, why) = too_much(read);
    assert!(why.contains("600 s") && asked == 67, "{why}, {asked}");
}
