//! What reads a topic, and what writes one, on one connection with a master.

use super::{Ended, OutCounts, QUEUE};
use csi5300::motion::odometry::ros::{Inbox, Message};
use roslibrust::RosMessageType;
use roslibrust::ros1::NodeHandle;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use tokio::sync::mpsc::Receiver;

/// Reads a topic until a newer connection does.
pub(super) async fn read<T: RosMessageType>(
    node: NodeHandle,
    connection: u64,
    inbox: Inbox,
    used: fn(&T) -> Message<'_>,
    wall_us: fn() -> Option<i64>,
) -> Ended {
    let mut subscriber = match node.subscribe::<T>(inbox.topic(), QUEUE).await {
        Ok(subscriber) => subscriber,
        Err(error) => return format!("cannot subscribe to {}: {error}", inbox.topic()),
    };
    loop {
        match subscriber.next().await {
            Some(Ok(message)) => {
                // Without a wall clock there is nothing to compare stamps with.
                let Some(received_us) = wall_us() else { continue };
                if !inbox.put(connection, &used(&message), received_us) {
                    return String::new();
                }
            }
            Some(Err(error)) => match skipped(&error.to_string()) {
                Some(messages) => inbox.dropped(messages),
                None => inbox.unreadable(),
            },
            None => return format!("the subscription to {} has ended", inbox.topic()),
        }
    }
}

/// How many messages the library dropped, if that is what its error says: it has no other name for it.
fn skipped(error: &str) -> Option<u64> {
    error.strip_prefix("you are too slow, ")?.split(' ').next()?.parse().ok()
}

/// Writes a topic as long as there is something to write.
pub(super) async fn write<T: RosMessageType>(
    node: NodeHandle,
    topic: String,
    waiting: Arc<tokio::sync::Mutex<Receiver<T>>>,
    counts: Arc<OutCounts>,
) -> Ended {
    let publisher = match node.advertise::<T>(&topic, QUEUE, false).await {
        Ok(publisher) => publisher,
        Err(error) => return format!("cannot publish {topic}: {error}"),
    };
    let mut waiting = waiting.lock().await;
    // What waited for a master is old.
    while waiting.try_recv().is_ok() {
        counts.lost.fetch_add(1, Ordering::Relaxed);
    }
    while let Some(message) = waiting.recv().await {
        let sent = publisher.publish(&message).await.is_ok();
        (if sent { &counts.sent } else { &counts.lost }).fetch_add(1, Ordering::Relaxed);
    }
    // Nobody has anything to publish any more; the topic stays until the end.
    std::future::pending().await
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_library_drops_is_told_from_its_words() {
        assert_eq!(skipped("you are too slow, 7 messages were skipped"), Some(7));
        assert_eq!(skipped("serde_rosmsg Error: 7"), None);
    }
}
