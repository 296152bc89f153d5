//! Topics of a node in the format of `rmw_zenoh_cpp`: keys, liveliness tokens, attachments. This module has no zenoh session:
//! the session's owner takes the topics from a [`Relay`] and carries their messages.
//!
//! Source: ROS 2's `rmw_zenoh` for Jazzy and Kilted: `docs/design.md` ("Topic and Service name mapping to Zenoh key
//! expressions", "Graph Cache", "Publishers"), `liveliness_utils.cpp`, `qos.cpp` and `attachment_helpers.cpp`.
//!
//! | item | format |
//! |---|---|
//! | key of a topic | `<domain>/<name>/<DDS type>/<type hash>` |
//! | payload | as in DDS: 4 bytes of encapsulation, then CDR |
//! | attachment | sequence number from 1 and nanoseconds since the Unix epoch (64 bits each, little-endian), the byte 16, the publisher's GID |
//! | GID of a publisher | 16 bytes: XXH3 (128 bits) of its token, little-endian |
//! | token of a node | `@ros2_lv/<domain>/<session>/<node>/<node>/NN/<enclave>/<namespace>/<name>` |
//! | token of an endpoint | `.../<node>/<endpoint>/MP/...` (`MS` for a subscription) `/<topic>/<type>/<hash>/<quality of service>` |
//!
//! In tokens `%` replaces `/`. Default values of the quality of service are empty: reliable, volatile, depth 42.

use crate::lock;
use crate::rtps::Qos;
use std::sync::{Arc, Mutex, OnceLock};
use twox_hash::XxHash3_128;

/// The default depth, which a token leaves empty.
const USUAL_DEPTH: u32 = 42;

/// Sends a payload at a host time, microseconds since the Unix epoch. It must not block.
pub type Sender = Box<dyn Fn(&[u8], i64) + Send + Sync>;
/// Takes a received payload.
pub type Taker = Box<dyn Fn(Vec<u8>) + Send + Sync>;

/// An end of a topic.
pub enum End {
    /// Payloads go to the sender set here.
    Publisher(Arc<OnceLock<Sender>>),
    /// Received payloads go to this function.
    Subscription(Taker),
}

/// A topic of a node.
pub struct Topic {
    /// Its full name.
    pub(crate) name: String,
    /// The DDS type.
    pub(crate) kind: String,
    /// `RIHS01_` and 64 hexadecimal digits.
    pub(crate) type_hash: String,
    pub(crate) qos: Qos,
    /// The node's end.
    pub end: End,
}

impl Topic {
    /// True for a subscription that also wants samples published before it (transient local).
    #[must_use]
    pub fn wants_earlier(&self) -> bool {
        self.qos.durability > 0 && matches!(self.end, End::Subscription(_))
    }

    /// The number of samples that a publisher keeps for later subscribers (transient local); 0 keeps none.
    #[must_use]
    pub fn kept(&self) -> usize {
        if self.qos.durability > 0 { self.qos.depth as usize } else { 0 }
    }
}

/// A node and its topics.
#[derive(Default)]
pub struct Graph {
    /// The domain.
    pub(crate) domain: u16,
    /// `/` or `/lab`.
    pub(crate) namespace: String,
    /// The node's name in the namespace.
    pub(crate) node: String,
    /// Its topics.
    pub topics: Vec<Topic>,
}

/// A name as one segment of a key.
fn mangled(name: &str) -> String {
    name.replace('/', "%")
}

fn words(qos: &Qos) -> String {
    let reliability = if qos.reliable { "" } else { "2" };
    let durability = if qos.durability > 0 { "1" } else { "" };
    let depth = if qos.depth == USUAL_DEPTH { String::new() } else { qos.depth.to_string() };
    format!("{reliability}:{durability}:,{depth}:,:,:,,")
}

impl Graph {
    /// The key of a topic's messages.
    #[must_use]
    pub fn key(&self, topic: &Topic) -> String {
        format!("{}/{}/{}/{}", self.domain, topic.name.trim_matches('/'), topic.kind, topic.type_hash)
    }

    /// A token up to the node's name; the enclave is the root.
    fn token_of(&self, session: &str, number: usize, kind: &str) -> String {
        let (domain, namespace) = (self.domain, mangled(&self.namespace));
        format!("@ros2_lv/{domain}/{session}/0/{number}/{kind}/%/{namespace}/{}", self.node)
    }

    /// The node's token. `session` is the ID of the zenoh session.
    #[must_use]
    pub fn node_token(&self, session: &str) -> String {
        self.token_of(session, 0, "NN")
    }

    /// The token of a topic; `number` is unique in the session, from 1.
    #[must_use]
    pub fn token(&self, session: &str, number: usize, topic: &Topic) -> String {
        let kind = if matches!(topic.end, End::Publisher(_)) { "MP" } else { "MS" };
        let node = self.token_of(session, number, kind);
        format!("{node}/{}/{}/{}/{}", mangled(&topic.name), topic.kind, topic.type_hash, words(&topic.qos))
    }
}

/// The GID of the endpoint with this token.
#[must_use]
pub fn gid(token: &str) -> [u8; 16] {
    XxHash3_128::oneshot(token.as_bytes()).to_le_bytes()
}

/// The attachment of a payload.
#[must_use]
pub fn attachment(number: i64, source_ns: i64, gid: [u8; 16]) -> Vec<u8> {
    [&number.to_le_bytes()[..], &source_ns.to_le_bytes(), &[gid.len() as u8], &gid].concat()
}

/// Passes a node's topics to the session's owner.
#[derive(Clone, Default)]
pub struct Relay(Arc<Mutex<Graph>>);

impl Relay {
    pub(crate) fn new(domain: u16, namespace: &str, node: &str) -> Self {
        let (namespace, node) = (namespace.to_owned(), node.to_owned());
        Self(Arc::new(Mutex::new(Graph { domain, namespace, node, topics: Vec::new() })))
    }

    pub(crate) fn add(&self, topic: Topic) {
        lock(&self.0).topics.push(topic);
    }

    /// The node, with the topics that have not been taken yet.
    #[must_use]
    pub fn take(&self) -> Graph {
        let mut graph = lock(&self.0);
        let topics = std::mem::take(&mut graph.topics);
        Graph { domain: graph.domain, namespace: graph.namespace.clone(), node: graph.node.clone(), topics }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::names::kind;

    const HASH: &str = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";

    fn chatter(name: &str, qos: Qos, end: End) -> Topic {
        Topic { name: name.into(), kind: kind("std_msgs/msg/String"), type_hash: HASH.into(), qos, end }
    }

    fn published() -> End {
        End::Publisher(Arc::default())
    }

    fn subscribed() -> End {
        End::Subscription(Box::new(|_| ()))
    }

    fn graph(domain: u16, namespace: &str, node: &str) -> Graph {
        Relay::new(domain, namespace, node).take()
    }

    /// The examples of `docs/design.md`.
    #[test]
    fn keys_and_tokens_agree_with_the_design_document() {
        let key = |name: &str| graph(0, "/", "talker").key(&chatter(name, Qos::reliable(7), published()));
        assert_eq!(key("/chatter"), format!("0/chatter/std_msgs::msg::dds_::String_/{HASH}"));
        assert_eq!(key("/robot1/chatter"), format!("0/robot1/chatter/std_msgs::msg::dds_::String_/{HASH}"));
        let (listener, session) = (graph(2, "/", "listener"), "aac3178e146ba6f1fc6e6a4085e77f21");
        assert_eq!(listener.node_token(session), "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener");
        assert_eq!(
            listener.token(session, 10, &chatter("/chatter", Qos::reliable(10), subscribed())),
            format!(
                "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MS/%/%/listener/%chatter/\
                 std_msgs::msg::dds_::String_/{HASH}/::,10:,:,:,,"
            )
        );
        let talker = graph(2, "/", "talker");
        let token =
            talker.token("8b20917502ee955ac4476e0266340d5c", 10, &chatter("/chatter", Qos::reliable(7), published()));
        assert_eq!(
            token,
            format!(
                "@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter/\
                 std_msgs::msg::dds_::String_/{HASH}/::,7:,:,:,,"
            )
        );
        // From PyPI's `xxhash`: `xxh3_128_intdigest(token).to_bytes(16, "little")`.
        assert_eq!(gid(&token), 0xac17_0f31_eadc_d9ff_0cd8_6d7a_1790_7d1c_u128.to_be_bytes());
    }

    #[test]
    fn tokens_state_namespaces_and_non_default_qualities_of_service() {
        for (qos, told) in [
            (Qos::reliable(42), "::,:,:,:,,"),
            (Qos::reliable(32), "::,32:,:,:,,"),
            (Qos::best_effort(5), "2::,5:,:,:,,"),
            (Qos::latched(64), ":1:,64:,:,:,,"),
        ] {
            assert_eq!(words(&qos), told);
        }
        assert!(chatter("/a", Qos::latched(1), subscribed()).wants_earlier());
        assert!(!chatter("/a", Qos::latched(1), published()).wants_earlier());
        assert!(!chatter("/a", Qos::reliable(1), subscribed()).wants_earlier());
        let lab = graph(7, "/lab/east", "burger");
        assert_eq!(lab.node_token("a1"), "@ros2_lv/7/a1/0/0/NN/%/%lab%east/burger");
        let topic = chatter("/lab/east/burger/b/bearing", Qos::reliable(32), published());
        assert!(
            lab.token("a1", 3, &topic).contains("/0/3/MP/%/%lab%east/burger/%lab%east%burger%b%bearing/std_msgs::")
        );
    }

    /// `docs/design.md`, "Publishers": 8 + 8 + 1 + 16 bytes.
    #[test]
    fn an_attachment_has_33_bytes() {
        let gid: [u8; 16] = std::array::from_fn(|k| 0xa0 + k as u8);
        let bytes = attachment(2, 0x0102_0304_0506_0708, gid);
        let expected = [&[2, 0, 0, 0, 0, 0, 0, 0, 8, 7, 6, 5, 4, 3, 2, 1, 16][..], &gid].concat();
        assert_eq!((bytes.len(), bytes), (33, expected));
    }
}
