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
