//! Datagrams of RTPS, the wire protocol of DDS: a header and submessages (\[rtps\] 8.3, 9.4). Writes little-endian, reads
//! both. A datagram of another protocol or version is refused, an unknown submessage is skipped, and a cut one ends its
//! datagram.

use csi5300_bag::cdr::{Cdr, CdrError, CdrReader};

/// Bytes of a datagram's header.
const HEADER: usize = 20;
/// RTPS 2.4: the version that all of ROS 2 understands.
const VERSION: [u8; 2] = [2, 4];
/// Vendor number "unknown".
pub(crate) const VENDOR: [u8; 2] = [0, 0];
/// Numbers in one set at most.
const SET: u32 = 256;

/// A participant.
pub(crate) type Prefix = [u8; 12];
/// A writer or reader of a participant.
pub(crate) type Entity = [u8; 4];
/// The reader and the writer of a submessage.
pub(crate) type Ends = (Entity, Entity);
/// A participant's prefix.
pub(crate) const ANY: Entity = [0; 4];

/// A writer or reader.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Guid {
    /// Its participant.
    pub prefix: Prefix,
    /// Its entity there.
    pub entity: Entity,
}

impl Guid {
    /// As on the wire.
    pub fn bytes(self) -> [u8; 16] {
        let mut bytes = [0; 16];
        let all = self.prefix.into_iter().chain(self.entity);
        bytes.iter_mut().zip(all).for_each(|(to, from)| *to = from);
        bytes
    }

    /// From the wire.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (prefix, rest) = bytes.split_first_chunk()?;
        Some(Self { prefix: *prefix, entity: *rest.first_chunk()? })
    }
}

/// A set of numbers from `base` on, one bit each; the first bit of the first word is its highest.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Numbers {
    /// The first number.
    pub base: i64,
    bits: u32,
    words: Vec<u32>,
}

impl Numbers {
    /// The empty set: everything below `base` is there.
    pub fn none(base: i64) -> Self {
        Self { base, bits: 0, words: Vec::new() }
    }

    /// The set of `numbers` (rising), as many as fit after the first.
    pub fn of(base: i64, numbers: impl Iterator<Item = i64>) -> Self {
        let mut set = Self::none(base);
        for bit in numbers.map_while(|number| u32::try_from(number - base).ok()).take_while(|bit| *bit < SET) {
            set.bits = bit + 1;
            set.words.resize(bit as usize / 32 + 1, 0);
            if let Some(word) = set.words.last_mut() {
                *word |= 1 << (31 - bit % 32);
            }
        }
        set
    }

    /// The numbers.
    pub fn iter(&self) -> impl Iterator<Item = i64> + '_ {
        let has = |bit: &u32| self.words.get(*bit as usize / 32).is_some_and(|word| word >> (31 - bit % 32) & 1 == 1);
        (0..self.bits).filter(has).map(|bit| self.base.saturating_add(i64::from(bit)))
    }

    fn read(from: &mut CdrReader<'_>) -> Result<Self, CdrError> {
        let (base, bits) = (number(from)?, u32::read(from)?.min(SET));
        let words = (0..bits.div_ceil(32)).map(|_| u32::read(from)).collect::<Result<_, _>>()?;
        Ok(Self { base, bits, words })
    }

    fn put(&self, to: &mut Vec<u8>) {
        put_number(self.base, to);
        to.extend(self.bits.to_le_bytes());
        self.words.iter().for_each(|word| to.extend(word.to_le_bytes()));
    }
}

fn number(from: &mut CdrReader<'_>) -> Result<i64, CdrError> {
    let (high, low) = (i32::read(from)?, u32::read(from)?);
    Ok(i64::from(high) << 32 | i64::from(low))
}

fn put_number(number: i64, to: &mut Vec<u8>) {
    to.extend(((number >> 32) as i32).to_le_bytes());
    to.extend((number as u32).to_le_bytes());
}

/// The parameters before a sample's payload, as far as they are used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Inline {
    /// The instance was disposed of or unregistered.
    pub is_over: bool,
    /// Its key.
    pub key: Option<[u8; 16]>,
    /// The request that a sample answers: its writer and number.
    pub request: Option<(Guid, i64)>,
}

/// A fragment of a sample, or several.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Fragment<'a> {
    /// Number of the first fragment in it, from 1.
    pub first: u32,
    /// Bytes of each fragment but the last.
    pub size: u16,
    /// Bytes of the sample.
    pub total: u32,
    /// The fragments.
    pub bytes: &'a [u8],
}

/// The content of a submessage. Numbers are those of its writer's samples.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Body<'a> {
    /// A sample; `None` without a payload.
    Data { number: i64, inline: Inline, payload: Option<&'a [u8]> },
    /// A fragment.
    Fragments { number: i64, fragment: Fragment<'a> },
    /// The range that the writer has.
    Heartbeat { first: i64, last: i64, count: u32, is_final: bool },
    /// What the reader lacks.
    AckNack { missing: Numbers, count: u32 },
    /// Numbers that will never arrive: from the first to the base of the set, and the set.
    Gap { start: i64, set: Numbers },
}

/// A submessage from one end to another.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Submessage<'a> {
    /// The addressed participant; `None` for all.
    pub to: Option<Prefix>,
    /// The reader.
    pub reader: Entity,
    /// The writer.
    pub writer: Entity,
    /// What it brings.
    pub body: Body<'a>,
}

/// A checked datagram: its sender and its submessages in order.
#[derive(Clone, Debug)]
pub(crate) struct Datagram<'a> {
    /// Who sent it.
    pub from: Prefix,
    rest: &'a [u8],
    to: Option<Prefix>,
}

impl<'a> Datagram<'a> {
    /// A datagram of RTPS 2.
    pub fn new_checked(bytes: &'a [u8]) -> Option<Self> {
        let (head, rest) = bytes.split_at_checked(HEADER)?;
        let (from, start) = (head.get(8..)?.first_chunk()?, head.get(..5)?);
        (start == b"RTPS\x02").then_some(Self { from: *from, rest, to: None })
    }

    /// The next one; `None` at the end, an error if it is cut.
    pub fn next(&mut self) -> Option<Result<Submessage<'a>, CdrError>> {
        loop {
            let ([kind, flags, low, high], rest) = self.rest.split_first_chunk::<4>()?;
            let little = flags & 1 == 1;
            let length = if little { u16::from_le_bytes([*low, *high]) } else { u16::from_be_bytes([*low, *high]) };
            // Length 0: to the end of the datagram, except for submessages that may be empty.
            let length = if length == 0 && !matches!(kind, 0x01 | 0x09) { rest.len() } else { length.into() };
            let Some((body, rest)) = rest.split_at_checked(length) else {
                let want = length - rest.len();
                self.rest = &[];
                return Some(Err(CdrError::Short { at: 0, want }));
            };
            self.rest = rest;
            match self.read(*kind, *flags, CdrReader::plain(body, little)) {
                Ok(Some(submessage)) => return Some(Ok(submessage)),
                Ok(None) => {}
                Err(error) => return Some(Err(error)),
            }
        }
    }

    fn read(&mut self, kind: u8, flags: u8, mut from: CdrReader<'a>) -> Result<Option<Submessage<'a>>, CdrError> {
        match kind {
            // INFO_DST and INFO_SRC
            0x0e => {
                let to: Prefix = <[u8; 12]>::read(&mut from)?;
                self.to = (to != [0; 12]).then_some(to);
                return Ok(None);
            }
            0x0c => {
                from.take(8)?;
                self.from = <[u8; 12]>::read(&mut from)?;
                return Ok(None);
            }
            0x06..=0x08 => {}
            0x15 | 0x16 => {
                from.take(2)?;
                let behind = usize::from(u16::read(&mut from)?);
                // From after that field to after the number: 16 bytes, and 12 more for fragments.
                let extra = behind.saturating_sub(if kind == 0x15 { 16 } else { 28 });
                return self.sample(kind, flags, from, extra).map(Some);
            }
            _ => return Ok(None),
        }
        let (reader, writer) = (Entity::read(&mut from)?, Entity::read(&mut from)?);
        let body = match kind {
            0x06 => {
                let missing = Numbers::read(&mut from)?;
                Body::AckNack { missing, count: u32::read(&mut from)? }
            }
            0x07 => Body::Heartbeat {
                first: number(&mut from)?,
                last: number(&mut from)?,
                count: u32::read(&mut from)?,
                is_final: flags & 2 == 2,
            },
            _ => Body::Gap { start: number(&mut from)?, set: Numbers::read(&mut from)? },
        };
        Ok(Some(Submessage { to: self.to, reader, writer, body }))
    }

    /// DATA and DATA_FRAG; a later version may extend the head by `extra` bytes.
    fn sample(&self, kind: u8, flags: u8, mut from: CdrReader<'a>, extra: usize) -> Result<Submessage<'a>, CdrError> {
        let (reader, writer) = (Entity::read(&mut from)?, Entity::read(&mut from)?);
        let number = number(&mut from)?;
        let has_inline = flags & 2 == 2;
        let body = if kind == 0x15 {
            from.take(extra)?;
            let inline = if has_inline { inline(&mut from)? } else { Inline::default() };
            // Data, or the key of an instance.
            let payload = (flags & 0x0c != 0).then(|| from.rest());
            Body::Data { number, inline, payload }
        } else {
            let (first, _, size) = (u32::read(&mut from)?, u16::read(&mut from)?, u16::read(&mut from)?);
            let total = u32::read(&mut from)?;
            from.take(extra)?;
            if has_inline {
                inline(&mut from)?;
            }
            Body::Fragments { number, fragment: Fragment { first, size, total, bytes: from.rest() } }
        };
        Ok(Submessage { to: self.to, reader, writer, body })
    }
}

/// The parameters before a payload.
fn inline(from: &mut CdrReader<'_>) -> Result<Inline, CdrError> {
    let mut inline = Inline::default();
    loop {
        let (id, length) = (u16::read(from)?, u16::read(from)?);
        if id == 1 {
            return Ok(inline);
        }
        let value = from.take(length.into())?;
        match id {
            // PID_STATUS_INFO: the flags are in the last byte.
            0x0071 => inline.is_over = value.last().is_some_and(|flags| flags & 3 != 0),
            0x0070 => inline.key = value.first_chunk().copied(),
            // PID_RELATED_SAMPLE_IDENTITY, as specified and as Fast DDS had it before.
            0x0083 | 0x800f => inline.request = related(value),
            _ => {}
        }
    }
}

/// Writer and number of a sample, as the inline parameters of Fast DDS have it.
fn related(value: &[u8]) -> Option<(Guid, i64)> {
    let mut from = CdrReader::plain(value.get(16..)?, true);
    Some((Guid::from_bytes(value)?, number(&mut from).ok()?))
}

/// A datagram being written.
#[derive(Clone, Debug)]
pub(crate) struct Maker(Vec<u8>);

impl Maker {
    /// From `from`, for the participant `to` or for all.
    pub fn new(from: Prefix, to: Option<Prefix>) -> Self {
        let mut bytes = b"RTPS".to_vec();
        bytes.extend(VERSION.into_iter().chain(VENDOR).chain(from));
        let mut maker = Self(bytes);
        if let Some(to) = to {
            maker.submessage(0x0e, 0, |bytes| bytes.extend(to));
        }
        maker
    }

    fn submessage(&mut self, kind: u8, flags: u8, fill: impl FnOnce(&mut Vec<u8>)) {
        self.0.extend([kind, flags | 1, 0, 0]);
        let begin = self.0.len();
        fill(&mut self.0);
        // A longer one is the last and goes to the end of the datagram, as length 0 says.
        let length = u16::try_from(self.0.len() - begin).unwrap_or(0);
        if let Some(place) = self.0.get_mut(begin - 2..begin) {
            place.copy_from_slice(&length.to_le_bytes());
        }
    }

    /// The time of what follows, microseconds since the Unix epoch.
    pub fn time(mut self, us: i64) -> Self {
        self.submessage(0x09, 0, |bytes| {
            let (s, fraction) = (us.div_euclid(1_000_000), (us.rem_euclid(1_000_000) << 32) / 1_000_000);
            bytes.extend((s as u32).to_le_bytes());
            bytes.extend((fraction as u32).to_le_bytes());
        });
        self
    }

    /// A sample. `over` is the key of a disposed instance, which has no payload; `request` is what a sample answers.
    pub fn data(
        mut self,
        ends: Ends,
        number: i64,
        payload: &[u8],
        (over, request): (Option<[u8; 16]>, Option<(Guid, i64)>),
    ) -> Self {
        let has_inline = if over.is_some() || request.is_some() { 2 } else { 0 };
        let has_payload = if over.is_some() { 0 } else { 4 };
        self.submessage(0x15, has_inline | has_payload, |bytes| {
            bytes.extend([0, 0, 16, 0]);
            bytes.extend(ends.0.into_iter().chain(ends.1));
            put_number(number, bytes);
            if let Some(key) = over {
                bytes.extend([0x70, 0, 16, 0]);
                bytes.extend(key);
                // Disposed of and unregistered.
                bytes.extend([0x71, 0, 4, 0, 0, 0, 0, 3]);
            }
            if let Some((guid, number)) = request {
                for id in [0x0083_u16, 0x800f] {
                    bytes.extend(id.to_le_bytes().into_iter().chain([24, 0]).chain(guid.bytes()));
                    put_number(number, bytes);
                }
            }
            if has_inline != 0 {
                bytes.extend([1, 0, 0, 0]);
            }
            bytes.extend(payload);
        });
        self
    }

    /// The range of a writer's samples, from `first` to `last`.
    pub fn heartbeat(mut self, ends: Ends, (first, last): (i64, i64), count: u32, is_final: bool) -> Self {
        self.submessage(0x07, if is_final { 2 } else { 0 }, |bytes| {
            bytes.extend(ends.0.into_iter().chain(ends.1));
            put_number(first, bytes);
            put_number(last, bytes);
            bytes.extend(count.to_le_bytes());
        });
        self
    }

    /// What a reader lacks.
    pub fn acknack(mut self, ends: Ends, missing: &Numbers, count: u32, is_final: bool) -> Self {
        self.submessage(0x06, if is_final { 2 } else { 0 }, |bytes| {
            bytes.extend(ends.0.into_iter().chain(ends.1));
            missing.put(bytes);
            bytes.extend(count.to_le_bytes());
        });
        self
    }

    /// Numbers that will never arrive: all from `start` to below `end`.
    pub fn gap(mut self, ends: Ends, (start, end): (i64, i64)) -> Self {
        self.submessage(0x08, 0, |bytes| {
            bytes.extend(ends.0.into_iter().chain(ends.1));
            put_number(start, bytes);
            Numbers::none(end).put(bytes);
        });
        self
    }

    /// The finished datagram.
    pub fn finish(self) -> Vec<u8> {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FROM: Prefix = *b"from-someone";
    const TO: Prefix = *b"to-somewhere";
    const ENDS: (Entity, Entity) = ([0, 0, 1, 4], [0, 0, 2, 3]);

    fn whole() -> Vec<u8> {
        let set = Numbers::of(5, [5, 7, 40].into_iter());
        let related = Some((Guid { prefix: TO, entity: ENDS.0 }, 9));
        Maker::new(FROM, Some(TO))
            .time(1_700_000_000_500_000)
            .data(ENDS, 3, &[1, 2, 3, 4], (None, related))
            .data(ENDS, 4, &[], (Some([8; 16]), None))
            .heartbeat(ENDS, (1, 1 << 33), 6, true)
            .acknack(ENDS, &set, 7, false)
            .gap(ENDS, (2, 4))
            .finish()
    }

    fn read(bytes: &[u8]) -> Vec<Result<Submessage<'_>, CdrError>> {
        let mut datagram = Datagram::new_checked(bytes).unwrap();
        std::iter::from_fn(|| datagram.next()).collect()
    }

    #[test]
    fn written_datagrams_are_read_back() {
        let bytes = whole();
        assert_eq!(Datagram::new_checked(&bytes).unwrap().from, FROM);
        let all: Vec<_> = read(&bytes).into_iter().map(Result::unwrap).collect();
        assert!(all.iter().all(|one| one.to == Some(TO) && (one.reader, one.writer) == ENDS), "{all:?}");
        let bodies: Vec<_> = all.into_iter().map(|one| one.body).collect();
        let answers = Inline { request: Some((Guid { prefix: TO, entity: ENDS.0 }, 9)), ..Inline::default() };
        let over = Inline { is_over: true, key: Some([8; 16]), ..Inline::default() };
        assert_eq!(bodies[0], Body::Data { number: 3, inline: answers, payload: Some(&[1, 2, 3, 4]) });
        assert_eq!(bodies[1], Body::Data { number: 4, inline: over, payload: None });
        assert_eq!(bodies[2], Body::Heartbeat { first: 1, last: 1 << 33, count: 6, is_final: true });
        let Body::AckNack { missing, count: 7 } = &bodies[3] else { panic!("{bodies:?}") };
        assert_eq!(missing.iter().collect::<Vec<_>>(), [5, 7, 40]);
        assert_eq!(bodies[4], Body::Gap { start: 2, set: Numbers::none(4) });
        assert_eq!(bodies.len(), 5);
    }

    #[test]
    fn cut_and_damaged_datagrams_end_and_never_panic() {
        let bytes = whole();
        for cut in 20..bytes.len() {
            read(&bytes[..cut]);
        }
        for at in 20..bytes.len() {
            for value in [0, 1, 0x7f, 0xff] {
                let mut damaged = bytes.clone();
                damaged[at] = value;
                for body in read(&damaged).into_iter().flatten() {
                    if let Body::AckNack { missing: set, .. } | Body::Gap { set, .. } = &body.body {
                        assert!(set.iter().count() <= 256);
                    }
                }
            }
        }
        assert!(Datagram::new_checked(b"RTPS\x01\x00").is_none());
        assert!(Datagram::new_checked(&[b"RTPX", &bytes[4..]].concat()).is_none());
    }

    #[test]
    fn fragments_and_big_endian_are_read() {
        let mut bytes = Maker::new(FROM, None).finish();
        bytes.extend([0x16, 0, 0, 36, 0, 0, 0, 28]);
        bytes.extend(ENDS.0.into_iter().chain(ENDS.1));
        bytes.extend([0, 0, 0, 0, 0, 0, 0, 5, 0, 0, 0, 2, 0, 1, 0, 4, 0, 0, 0, 7, 9, 9, 9, 0]);
        let fragment = Fragment { first: 2, size: 4, total: 7, bytes: &[9, 9, 9, 0] };
        assert_eq!(read(&bytes)[0].as_ref().unwrap().body, Body::Fragments { number: 5, fragment });
    }
}
