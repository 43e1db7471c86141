//! Messages that nobody keeps, as they are heard. The client's library bounds their number and not their bytes. So they are taken from
//! it at once, and what waits here is bounded.

use crate::fleet::ops::LOG;
use async_nats::Message;
use futures::stream::{Stream, StreamExt};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Most bytes of a message beside its body: its subject and its head fields.
pub(super) const HEAD: usize = 512;
/// Most bytes that wait for whoever hears them: each message fits, because [`MOST_MESSAGE`](crate::fleet::ops::MOST_MESSAGE) is less.
const WAITING: usize = 1 << 23;

/// A message, and the room that it takes until it is heard.
type Heard = (Message, OwnedSemaphorePermit);

/// Messages that nobody keeps. What comes while too many bytes wait is left out, and the log says so: who hears must not need all.
#[derive(Debug)]
pub struct Hearing(UnboundedReceiver<Heard>);

impl Hearing {
    /// Takes messages until they end, or nobody hears any more.
    pub(super) fn of(messages: impl Stream<Item = Message> + Send + Unpin + 'static) -> Self {
        // Without a bound on their number: each takes room.
        let (sender, heard) = unbounded_channel();
        tokio::spawn(async move {
            tokio::select! {
                () = take(messages, &sender) => {}
                () = sender.closed() => {}
            }
        });
        Self(heard)
    }
}

impl Stream for Hearing {
    type Item = Message;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Message>> {
        self.0.poll_recv(context).map(|heard| heard.map(|(message, _)| message))
    }
}

async fn take(mut messages: impl Stream<Item = Message> + Unpin, sender: &UnboundedSender<Heard>) {
    let room = Arc::new(Semaphore::new(WAITING));
    while let Some(message) = messages.next().await {
        // A short one takes more than its bytes.
        let bytes = u32::try_from(message.length.max(HEAD)).unwrap_or(u32::MAX);
        match room.clone().try_acquire_many_owned(bytes) {
            Ok(place) => {
                if sender.send((message, place)).is_err() {
                    return;
                }
            }
            Err(_) => {
                tracing::warn!(target: LOG, bytes, "messages come faster than they are heard: one is left out");
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures::stream::iter;
    use std::iter::repeat_n;

    fn message(bytes: usize) -> Message {
        Message {
            subject: "a.b".into(),
            reply: None,
            payload: vec![b'x'; bytes].into(),
            headers: None,
            status: None,
            description: None,
            length: bytes + 3,
        }
    }

    /// Bytes that wait once all these messages came and nobody heard them, and how many messages that are.
    async fn waiting(messages: impl IntoIterator<Item = Message>) -> (usize, usize) {
        let (sender, mut heard) = unbounded_channel();
        take(iter(messages), &sender).await;
        let (mut bytes, mut count) = (0, 0);
        while let Ok((message, _)) = heard.try_recv() {
            (bytes, count) = (bytes + message.length, count + 1);
        }
        (bytes, count)
    }

    #[tokio::test]
    async fn what_waits_is_bounded_in_bytes_and_in_number() {
        let large = 1 << 20;
        let (bytes, count) = waiting(repeat_n(large, 100).map(message)).await;
        assert!(bytes <= WAITING && count == 7, "{count} messages of {bytes} bytes wait");
        let (_, count) = waiting(repeat_n(0, 50_000).map(message)).await;
        assert_eq!(count, WAITING / HEAD);
        // Any one fits, whatever came before it is heard.
        let most = crate::fleet::ops::MOST_MESSAGE as usize;
        assert_eq!(waiting([message(most)]).await.1, 1);
    }

    #[tokio::test]
    async fn what_was_heard_makes_room_for_what_comes_later() {
        let (sender, messages) = tokio::sync::mpsc::unbounded_channel::<Message>();
        let messages =
            futures::stream::unfold(messages, |mut own| async move { Some((own.recv().await?, own)) });
        let mut hearing = Hearing::of(Box::pin(messages));
        // Three times what may wait, each once the one before it was heard.
        for _ in 0..6 {
            sender.send(message(WAITING / 2)).expect("it is taken");
            let heard = hearing.next().await.expect("the messages go on");
            assert_eq!(heard.payload.len(), WAITING / 2);
        }
        drop(sender);
        assert!(hearing.next().await.is_none(), "they end");
    }
}
