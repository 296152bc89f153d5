//! Requests and answers of services. ROS 2 has two ways to identify a request: Cyclone writes the client before the request
//! itself; the others (Fast DDS, Connext) use the sample's identity and put it beside the answer.

use super::rtps::{Event, Guid};
use csi5300_bag::cdr::{CDR_LE, Cdr, CdrReader, CdrWriter};
use csi5300_bag::messages::Message;

/// The vendor number of Eclipse Cyclone DDS.
const CYCLONE: [u8; 2] = [1, 0x10];

/// The client of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Head {
    /// Client and number, written before the request.
    Inside(u64, i64),
    /// The request's writer and number.
    Beside(Guid, i64),
}

/// The client and its request.
pub(crate) fn request<Q: Message>(event: &Event) -> Option<(Head, Q)> {
    let mut from = CdrReader::of_payload(&event.payload).ok()?;
    let head = if event.vendor == CYCLONE {
        Head::Inside(u64::read(&mut from).ok()?, i64::read(&mut from).ok()?)
    } else {
        Head::Beside(event.from.0, event.from.1)
    };
    Some((head, Q::read(&mut from).ok()?))
}

/// The payload of an answer, and the request that it answers if that is sent beside it.
pub(crate) fn answer<A: Message>(head: Head, answer: &A) -> (Vec<u8>, Option<(Guid, i64)>) {
    match head {
        Head::Beside(guid, number) => (answer.payload(), Some((guid, number))),
        Head::Inside(client, number) => {
            let mut to = CdrWriter::plain();
            client.write(&mut to);
            number.write(&mut to);
            answer.write(&mut to);
            ([&CDR_LE[..], &to.into_bytes()].concat(), None)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300_bag::messages::services::{TriggerRequest, TriggerResponse};

    #[test]
    fn both_ways_of_identifying_a_request_are_understood() {
        let from = (Guid { prefix: [7; 12], entity: [0, 0, 1, 3] }, 5);
        let event = |vendor, payload| Event { reader: 0, from, vendor, payload };
        let inside = [&CDR_LE[..], &9_u64.to_le_bytes(), &3_i64.to_le_bytes(), &[0]].concat();
        let (head, _) = request::<TriggerRequest>(&event(CYCLONE, inside.clone())).unwrap();
        assert_eq!(head, Head::Inside(9, 3));
        let said = TriggerResponse { success: true, message: "x".into() };
        let (payload, beside) = answer(head, &said);
        assert_eq!((&payload[..20], beside), (&inside[..20], None));
        assert_eq!(payload[20..], said.payload()[4..]);
        let (head, _) = request::<TriggerRequest>(&event([1, 0x0f], vec![0, 1, 0, 0, 0])).unwrap();
        assert_eq!(head, Head::Beside(from.0, from.1));
        assert_eq!(answer(head, &said), (said.payload(), Some(from)));
        assert!(request::<TriggerRequest>(&event(CYCLONE, vec![0, 1, 0, 0, 0])).is_none());
    }
}
