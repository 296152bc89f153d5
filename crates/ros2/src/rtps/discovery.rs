//! How participants announce themselves, their writers and their readers: parameter lists (\[rtps\] 8.5, 9.6.2). Quality of
//! service, and why two endpoints do not match (\[dds\] 2.2.3).

use super::wire::{Guid, Prefix, VENDOR};
use csi5300::time::Span;
use csi5300_bag::cdr::{Cdr, CdrError, CdrReader, CdrWriter};
use std::net::{Ipv4Addr, SocketAddrV4};

/// Precedes a type's hash in an endpoint's user data (REP-2016): any number of `key=value;`.
const TYPE_HASH: &str = "typehash=";
/// Encapsulation of a parameter list, little-endian.
const LIST_LE: [u8; 4] = [0, 3, 0, 0];
/// The entity that stands for a participant.
pub(crate) const PARTICIPANT: [u8; 4] = [0, 0, 1, 0xc1];
/// Built-in endpoints of this participant: participants, publications and subscriptions, announcer and detector.
const BUILT_IN: u32 = 0x3f;
/// Addresses of one participant that are kept.
const ADDRESSES: usize = 16;
/// Longest name of a topic, type, participant or partition, bytes: a DDS topic has at most 255.
const LONGEST_NAME: usize = 512;
/// Partitions and representations of an endpoint at most.
const LONGEST_LIST: usize = 8;
/// Longest lease that is granted.
const LONGEST_LEASE: Span = Span::from_ms(600_000);
/// Lease of a participant that announces none.
const USUAL_LEASE: Span = Span::from_ms(100_000);

/// Numbers of parameters (\[rtps\] 9.6.3).
mod id {
    pub const END: u16 = 0x0001;
    pub const LEASE: u16 = 0x0002;
    pub const TOPIC: u16 = 0x0005;
    pub const TYPE: u16 = 0x0007;
    pub const VERSION: u16 = 0x0015;
    pub const VENDOR: u16 = 0x0016;
    pub const RELIABILITY: u16 = 0x001a;
    pub const LIVELINESS: u16 = 0x001b;
    pub const DURABILITY: u16 = 0x001d;
    pub const OWNERSHIP: u16 = 0x001f;
    pub const DEADLINE: u16 = 0x0023;
    pub const DESTINATION_ORDER: u16 = 0x0025;
    pub const PARTITION: u16 = 0x0029;
    pub const USER_DATA: u16 = 0x002c;
    pub const UNICAST: u16 = 0x002f;
    pub const DEFAULT_UNICAST: u16 = 0x0031;
    pub const META_UNICAST: u16 = 0x0032;
    pub const HISTORY: u16 = 0x0040;
    pub const PARTICIPANT: u16 = 0x0050;
    pub const BUILT_IN: u16 = 0x0058;
    pub const ENDPOINT: u16 = 0x005a;
    pub const NAME: u16 = 0x0062;
    pub const KEY: u16 = 0x0070;
    pub const REPRESENTATION: u16 = 0x0073;
}

/// A participant's announcement.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ParticipantData {
    /// Its identity.
    pub prefix: Prefix,
    /// The vendor of its program.
    pub vendor: [u8; 2],
    /// Where it receives discovery.
    pub meta: Vec<SocketAddrV4>,
    /// Where it receives samples.
    pub user: Vec<SocketAddrV4>,
    /// True if either list has only IPv6 addresses.
    pub is_ipv6: bool,
    /// Lease: it is gone after this long a silence.
    pub lease: Span,
    /// Its name, for people.
    pub name: String,
}

/// The announcement of a writer or reader.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct EndpointData {
    /// Its identity.
    pub guid: Guid,
    /// Its topic.
    pub topic: String,
    /// The type of its samples.
    pub kind: String,
    /// Offered or requested quality of service.
    pub qos: Qos,
    /// Where a reader receives samples, if not where its participant does.
    pub unicast: Vec<SocketAddrV4>,
}

/// Writes a parameter list.
struct List(Vec<u8>);

impl List {
    fn new() -> Self {
        Self(LIST_LE.to_vec())
    }

    fn put(&mut self, id: u16, fill: impl FnOnce(&mut CdrWriter)) {
        let mut value = CdrWriter::plain();
        fill(&mut value);
        let mut value = value.into_bytes();
        value.resize(value.len().next_multiple_of(4), 0);
        self.0.extend(id.to_le_bytes());
        self.0.extend(u16::try_from(value.len()).unwrap_or(u16::MAX).to_le_bytes());
        self.0.extend(value);
    }

    fn addresses(&mut self, id: u16, addresses: &[SocketAddrV4]) {
        for address in addresses {
            self.put(id, |value| {
                1_i32.write(value);
                u32::from(address.port()).write(value);
                value.put(&[0; 12]);
                value.put(&address.ip().octets());
            });
        }
    }

    fn finish(mut self) -> Vec<u8> {
        self.0.extend(id::END.to_le_bytes().into_iter().chain([0, 0]));
        self.0
    }
}

/// Each parameter of a list, up to its end.
fn each(payload: &[u8], mut used: impl FnMut(u16, CdrReader<'_>) -> Result<(), CdrError>) -> Result<(), CdrError> {
    let mut from = CdrReader::of_payload(payload)?;
    let little = payload.get(1).is_some_and(|low| low & 1 == 1);
    loop {
        let (id, length) = (u16::read(&mut from)?, u16::read(&mut from)?);
        if id == id::END {
            return Ok(());
        }
        used(id, CdrReader::plain(from.take(length.into())?, little))?;
    }
}

fn address(from: &mut CdrReader<'_>) -> Result<Option<SocketAddrV4>, CdrError> {
    let (kind, port) = (i32::read(from)?, u32::read(from)?);
    from.take(12)?;
    let ip = Ipv4Addr::from(<[u8; 4]>::read(from)?);
    let port = u16::try_from(port).ok().filter(|port| *port != 0);
    Ok(port.filter(|_| kind == 1 && !ip.is_multicast() && !ip.is_unspecified()).map(|port| SocketAddrV4::new(ip, port)))
}

/// True for a UDP address over IPv6 (\[rtps\] 9.3.2); reads the value again.
fn is_ipv6(value: &CdrReader<'_>) -> bool {
    i32::read(&mut value.clone()).is_ok_and(|kind| kind == 2)
}

fn keep(address: Option<SocketAddrV4>, into: &mut Vec<SocketAddrV4>) {
    into.extend(address.filter(|address| into.len() < ADDRESSES && !into.contains(address)));
}

/// A name to keep; one above the limit is refused.
fn name(from: &mut CdrReader<'_>) -> Result<String, CdrError> {
    let name = String::read(from)?;
    if name.len() <= LONGEST_NAME { Ok(name) } else { Err(CdrError::Long { length: name.len(), most: LONGEST_NAME }) }
}

/// A list to keep; one above the limit is refused.
fn list<T>(
    from: &mut CdrReader<'_>,
    read: impl Fn(&mut CdrReader<'_>) -> Result<T, CdrError>,
) -> Result<Vec<T>, CdrError> {
    let length = u32::read(from)? as usize;
    if length > LONGEST_LIST {
        return Err(CdrError::Long { length, most: LONGEST_LIST });
    }
    (0..length).map(|_| read(from)).collect()
}

/// Whole seconds and a fraction of 2^-32; infinity becomes the longest.
fn span(from: &mut CdrReader<'_>) -> Result<Span, CdrError> {
    let (s, fraction) = (i32::read(from)?, u32::read(from)?);
    let us = i64::from(s).max(0) * 1_000_000 + ((i64::from(fraction) * 1_000_000) >> 32);
    Ok(Span::from_us(us).min(LONGEST_LEASE))
}

impl ParticipantData {
    /// The payload of an announcement.
    pub fn payload(&self) -> Vec<u8> {
        let mut list = List::new();
        list.put(id::VERSION, |value| value.put(&[2, 4]));
        list.put(id::VENDOR, |value| value.put(&VENDOR));
        list.put(id::PARTICIPANT, |value| value.put(&Guid { prefix: self.prefix, entity: PARTICIPANT }.bytes()));
        list.put(id::BUILT_IN, |value| BUILT_IN.write(value));
        list.addresses(id::META_UNICAST, &self.meta);
        list.addresses(id::DEFAULT_UNICAST, &self.user);
        list.put(id::LEASE, |value| {
            ((self.lease.as_us() / 1_000_000) as i32).write(value);
            0_u32.write(value);
        });
        list.put(id::NAME, |value| self.name.write(value));
        // ROS 2 marks its participants so; without it, no list of nodes shows them.
        list.put(id::USER_DATA, |value| b"enclave=/;".to_vec().write(value));
        list.finish()
    }

    /// From a payload.
    pub fn read(payload: &[u8]) -> Result<Option<Self>, CdrError> {
        let (mut prefix, mut vendor, mut words) = (None, [0; 2], String::new());
        let (mut meta, mut user, mut lease) = (Vec::new(), Vec::new(), USUAL_LEASE);
        let mut ipv6 = [false; 2];
        each(payload, |id, mut value| {
            ipv6[0] |= id == id::META_UNICAST && is_ipv6(&value);
            ipv6[1] |= id == id::DEFAULT_UNICAST && is_ipv6(&value);
            match id {
                id::PARTICIPANT => prefix = Guid::from_bytes(value.rest()).map(|guid| guid.prefix),
                id::VENDOR => vendor = <[u8; 2]>::read(&mut value)?,
                id::META_UNICAST => keep(address(&mut value)?, &mut meta),
                id::DEFAULT_UNICAST => keep(address(&mut value)?, &mut user),
                id::LEASE => lease = span(&mut value)?,
                id::NAME => words = name(&mut value).unwrap_or_default(),
                _ => {}
            }
            Ok(())
        })?;
        let is_ipv6 = (ipv6[0] && meta.is_empty()) || (ipv6[1] && user.is_empty());
        Ok(prefix.map(|prefix| Self { prefix, vendor, meta, user, is_ipv6, lease, name: words }))
    }
}

impl EndpointData {
    /// The payload of an announcement.
    pub fn payload(&self) -> Vec<u8> {
        let mut list = List::new();
        let (guid, qos) = (self.guid, &self.qos);
        list.put(id::ENDPOINT, |value| value.put(&guid.bytes()));
        list.put(id::KEY, |value| value.put(&guid.bytes()));
        list.put(id::PARTICIPANT, |value| {
            value.put(&Guid { prefix: guid.prefix, entity: PARTICIPANT }.bytes());
        });
        list.put(id::VERSION, |value| value.put(&[2, 4]));
        list.put(id::VENDOR, |value| value.put(&VENDOR));
        list.put(id::TOPIC, |value| self.topic.write(value));
        list.put(id::TYPE, |value| self.kind.write(value));
        list.put(id::RELIABILITY, |value| {
            // Maximum blocking time 100 ms.
            (if qos.reliable { 2_u32 } else { 1 }).write(value);
            (0_i32).write(value);
            (429_496_730_u32).write(value);
        });
        list.put(id::DURABILITY, |value| qos.durability.write(value));
        list.put(id::HISTORY, |value| {
            0_u32.write(value);
            qos.depth.write(value);
        });
        if !qos.representations.is_empty() {
            list.put(id::REPRESENTATION, |value| qos.representations.write(value));
        }
        if let Some(hash) = &qos.type_hash {
            list.put(id::USER_DATA, |value| format!("{TYPE_HASH}{hash};").into_bytes().write(value));
        }
        list.addresses(id::UNICAST, &self.unicast);
        list.finish()
    }

    /// From a payload. Missing values have their defaults: writers are reliable, readers best effort.
    pub fn read(payload: &[u8], is_writer: bool) -> Result<Option<Self>, CdrError> {
        let (mut guid, mut topic, mut kind) = (None, None, None);
        let (mut qos, mut unicast) = (Qos { reliable: is_writer, ..Qos::default() }, Vec::new());
        each(payload, |id, mut value| {
            match id {
                id::ENDPOINT => guid = Guid::from_bytes(value.rest()),
                id::TOPIC => topic = Some(name(&mut value)?),
                id::TYPE => kind = Some(name(&mut value)?),
                id::RELIABILITY => qos.reliable = u32::read(&mut value)? == 2,
                id::DURABILITY => qos.durability = u32::read(&mut value)?,
                id::HISTORY => qos.depth = <[u32; 2]>::read(&mut value)?[1],
                id::DEADLINE => qos.has_deadline = i32::read(&mut value)? != i32::MAX,
                // Anything but "automatic" without a lease: a kind, then seconds and fraction.
                id::LIVELINESS => {
                    qos.has_liveliness = u32::read(&mut value)? != 0 || i32::read(&mut value)? != i32::MAX;
                }
                id::DESTINATION_ORDER => qos.by_source = u32::read(&mut value)? == 1,
                id::OWNERSHIP => qos.exclusive = u32::read(&mut value)? == 1,
                id::PARTITION => qos.partitions = list(&mut value, name)?,
                id::REPRESENTATION => qos.representations = list(&mut value, i16::read)?,
                id::UNICAST => keep(address(&mut value)?, &mut unicast),
                id::USER_DATA => qos.type_hash = type_hash(&Vec::read(&mut value)?),
                _ => {}
            }
            Ok(())
        })?;
        let named = guid.zip(topic).zip(kind);
        Ok(named.map(|((guid, topic), kind)| Self { guid, topic, kind, qos, unicast }))
    }
}

/// The type hash in an endpoint's user data; hashes of other rules than RIHS01 are ignored.
fn type_hash(user_data: &[u8]) -> Option<String> {
    let pairs = user_data.split(|byte| *byte == b';');
    let hash = pairs.into_iter().find_map(|pair| pair.strip_prefix(TYPE_HASH.as_bytes()))?;
    let digits = hash.strip_prefix(b"RIHS01_").filter(|digits| digits.len() == 64)?;
    digits.iter().all(u8::is_ascii_hexdigit).then(|| String::from_utf8_lossy(hash).into_owned())
}

/// The key of a disposed instance, from a payload that has only that.
pub(crate) fn key(payload: &[u8]) -> Option<Guid> {
    let mut guid = None;
    let _ = each(payload, |id, value| {
        if [id::ENDPOINT, id::PARTICIPANT, id::KEY].contains(&id) && guid.is_none() {
            guid = Guid::from_bytes(value.rest());
        }
        Ok(())
    });
    guid
}

/// A payload with only the key of an instance, as for a disposed one.
pub(crate) fn key_payload(key: [u8; 16]) -> Vec<u8> {
    let mut list = List::new();
    list.put(id::KEY, |value| value.put(&key));
    list.finish()
}

/// What a writer offers or a reader requests, as far as matching depends on it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Qos {
    /// Lost samples are sent again.
    pub reliable: bool,
    /// Durability, whether late readers receive earlier samples: 0 volatile, 1 transient local, and higher ones.
    pub durability: u32,
    /// Samples that a writer keeps, or that a reader requests.
    pub depth: u32,
    /// A deadline between samples is offered or requested.
    pub has_deadline: bool,
    /// Liveliness is offered or requested: manual, or with a lease.
    pub has_liveliness: bool,
    /// Samples are ordered by time of writing, not of reception.
    pub by_source: bool,
    /// Exclusive ownership: one writer only.
    pub exclusive: bool,
    /// Partitions of the domain; an empty list is the unnamed one.
    pub partitions: Vec<String>,
    /// Data representations offered or accepted: 0 is CDR version 1, 2 version 2. Empty: 0.
    pub representations: Vec<i16>,
    /// The hash of the type's definition (RIHS01), which ROS 2 sends in `USER_DATA` from Iron on.
    pub type_hash: Option<String>,
}

impl Qos {
    /// The default of ROS 2: reliable, nothing for late readers.
    #[must_use]
    pub fn reliable(depth: u32) -> Self {
        Self { reliable: true, depth, ..Self::default() }
    }

    /// As ROS 2 has it for sensors: best effort.
    #[must_use]
    pub fn best_effort(depth: u32) -> Self {
        Self { depth, ..Self::default() }
    }

    /// As ROS 2 has it for latched topics such as `/tf_static`.
    #[must_use]
    pub fn latched(depth: u32) -> Self {
        Self { durability: 1, ..Self::reliable(depth) }
    }

    /// Why a reader that requests `asked` does not match a writer that offers this, as text.
    pub(crate) fn mismatch(&self, asked: &Self) -> Option<&'static str> {
        let any = |list: &[i16], wanted: i16| if list.is_empty() { wanted == 0 } else { list.contains(&wanted) };
        let representation = self.representations.first().copied().unwrap_or(0);
        let partition = |list: &[String]| if list.is_empty() { vec![String::new()] } else { list.to_vec() };
        let (own, theirs) = (partition(&self.partitions), partition(&asked.partitions));
        if self.type_hash.as_ref().zip(asked.type_hash.as_ref()).is_some_and(|(own, theirs)| own != theirs) {
            Some("publisher and subscriber have different definitions of this message (their type hashes differ)")
        } else if asked.reliable && !self.reliable {
            Some("the publisher is best effort, and the subscriber asks for reliable")
        } else if asked.durability > self.durability {
            Some("the publisher is volatile, and the subscriber asks for transient local")
        } else if asked.has_deadline && !self.has_deadline {
            Some("the subscriber asks for a deadline, and the publisher promises none")
        } else if asked.has_liveliness && !self.has_liveliness {
            Some("the subscriber asks for signs of life (liveliness) that the publisher does not promise")
        } else if asked.by_source && !self.by_source {
            Some(
                "the subscriber asks for the order of writing (destination order by source), and the publisher offers that of reception",
            )
        } else if asked.exclusive != self.exclusive {
            Some("one end has exclusive ownership, the other shared")
        } else if !any(&asked.representations, representation) {
            Some("the publisher writes a representation (XCDR) that the subscriber does not take")
        } else if !own.iter().any(|one| theirs.contains(one)) {
            Some("they are in different partitions")
        } else {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(last: u8, port: u16) -> SocketAddrV4 {
        SocketAddrV4::new(Ipv4Addr::new(127, 0, 0, last), port)
    }

    #[test]
    fn announcements_round_trip_and_cut_ones_are_refused() {
        let lease = Span::from_ms(20_000);
        let (meta, user) = (vec![at(1, 7410)], vec![at(1, 7411), at(2, 7411)]);
        let participant = ParticipantData {
            prefix: *b"participant.",
            vendor: VENDOR,
            meta,
            user,
            is_ipv6: false,
            lease,
            name: "burger".into(),
        };
        let payload = participant.payload();
        assert_eq!(ParticipantData::read(&payload), Ok(Some(participant)));
        let hash = |digit: &str| format!("RIHS01_{}", digit.repeat(64));
        let qos = Qos { representations: vec![0], type_hash: Some(hash("a")), ..Qos::latched(3) };
        let guid = Guid { prefix: *b"participant.", entity: [0, 0, 1, 3] };
        let (topic, kind) = ("rt/odom".into(), "nav_msgs::msg::dds_::Odometry_".into());
        let endpoint = EndpointData { guid, topic, kind, qos, unicast: vec![at(1, 9)] };
        let other = endpoint.payload();
        assert_eq!(EndpointData::read(&other, true), Ok(Some(endpoint)));
        assert_eq!(key(&other), Some(guid));
        let words = |text: String| type_hash(text.as_bytes());
        assert_eq!(words(format!("sertypehash={};typehash={};", hash("b"), hash("a"))), Some(hash("a")));
        assert_eq!(
            (words("typehash=RIHS01_a;".into()), words("typehash=RIHS02_0;".into()), type_hash(&[])),
            (None, None, None)
        );
        let mut least = List::new();
        least.put(id::ENDPOINT, |value| value.put(&guid.bytes()));
        least.put(id::TOPIC, |value| "t".to_owned().write(value));
        least.put(id::TYPE, |value| "T".to_owned().write(value));
        let least = least.finish();
        let asks = |number: u16, words: &[u32]| {
            let mut list = List::new();
            list.put(id::ENDPOINT, |value| value.put(&guid.bytes()));
            list.put(id::TOPIC, |value| "t".to_owned().write(value));
            list.put(id::TYPE, |value| "T".to_owned().write(value));
            list.put(number, |value| words.iter().for_each(|word| word.write(value)));
            let qos = EndpointData::read(&list.finish(), false).unwrap().unwrap().qos;
            (qos.has_liveliness, qos.by_source)
        };
        assert_eq!(asks(id::LIVELINESS, &[0, i32::MAX as u32, u32::MAX]), (false, false));
        assert_eq!(asks(id::LIVELINESS, &[2, i32::MAX as u32, u32::MAX]), (true, false), "manual by topic");
        assert_eq!(asks(id::LIVELINESS, &[0, 5, 0]), (true, false), "a lease of 5 s");
        assert_eq!(asks(id::DESTINATION_ORDER, &[1]), (false, true));
        let reliable = |is_writer| EndpointData::read(&least, is_writer).unwrap().unwrap().qos.reliable;
        assert!(reliable(true) && !reliable(false), "what is left out is as usual");
        for cut in 0..payload.len() {
            assert!(ParticipantData::read(&payload[..cut]).is_err(), "{cut}");
        }
        for cut in 0..other.len() {
            assert!(EndpointData::read(&other[..cut], true).is_err(), "{cut}");
        }
    }

    #[test]
    fn unusable_addresses_are_ignored() {
        let mut list = List::new();
        let all = SocketAddrV4::new(Ipv4Addr::new(239, 255, 0, 1), 7400);
        list.addresses(id::META_UNICAST, &[all, at(1, 0), SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, 7410)]);
        list.addresses(id::META_UNICAST, &(1..99).map(|k| at(1, k)).collect::<Vec<_>>());
        list.put(id::PARTICIPANT, |value| value.put(&[5; 16]));
        let read = ParticipantData::read(&list.finish()).unwrap().unwrap();
        assert_eq!(read.meta, (1..=ADDRESSES as u16).map(|k| at(1, k)).collect::<Vec<_>>());
    }

    #[test]
    fn offered_quality_must_meet_the_requested_quality() {
        let (sensor, usual, latched) = (Qos::best_effort(5), Qos::reliable(10), Qos::latched(1));
        for (offered, asked, why) in [
            (&usual, &usual, None),
            (&usual, &sensor, None),
            (&latched, &usual, None),
            (&sensor, &usual, Some("best effort")),
            (&usual, &latched, Some("volatile")),
        ] {
            let said = offered.mismatch(asked);
            assert_eq!(said.is_some(), why.is_some(), "{offered:?} {asked:?}");
            assert!(said.unwrap_or_default().contains(why.unwrap_or_default()), "{said:?}");
        }
        let second = Qos { representations: vec![2], ..usual.clone() };
        assert!(usual.mismatch(&second).is_some_and(|why| why.contains("XCDR")));
        assert_eq!(usual.mismatch(&Qos { representations: vec![2, 0], ..usual.clone() }), None);
        // An endpoint without a hash, such as a node of Humble, matches all.
        let hashed = |hash: &str| Qos { type_hash: Some(hash.into()), ..usual.clone() };
        assert!(hashed("RIHS01_a").mismatch(&hashed("RIHS01_b")).is_some_and(|why| why.contains("type hashes")));
        for (offered, asked) in [(hashed("RIHS01_a"), hashed("RIHS01_a")), (hashed("RIHS01_a"), usual.clone())] {
            assert_eq!((offered.mismatch(&asked), asked.mismatch(&offered)), (None, None));
        }
        let apart = Qos { partitions: vec!["a".into()], ..usual.clone() };
        assert!(usual.mismatch(&apart).is_some_and(|why| why.contains("partitions")));
        for (asked, why) in [
            (Qos { has_deadline: true, ..usual.clone() }, "deadline"),
            (Qos { has_liveliness: true, ..usual.clone() }, "liveliness"),
            (Qos { by_source: true, ..usual.clone() }, "destination order"),
        ] {
            assert!(usual.mismatch(&asked).is_some_and(|said| said.contains(why)), "{why}");
            assert_eq!(asked.mismatch(&usual), None, "{why}");
        }
    }
}
