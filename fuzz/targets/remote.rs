//! Any bytes as messages of another robot: no panic, no more waiting items than allowed, and every item is counted.
//!
//! The input is a list of `length (2 bytes), message`.

use csi5300::source::remote::{Batch, Mailbox};
use csi5300::source::{CsiSource, Next};
use csi5300::time::Instant;

/// Items that may wait.
const LIMIT: usize = 32;

/// Runs the target.
pub fn run(bytes: &[u8]) {
    let mailbox = Mailbox::new(LIMIT);
    let mut card = mailbox.card();
    let (mut rest, mut now, mut records, mut missing) = (bytes, Instant::ZERO, 0, 0);
    while let Some((len, behind)) = rest.split_first_chunk() {
        let (message, behind) = behind.split_at(behind.len().min(usize::from(u16::from_le_bytes(*len))));
        rest = behind;
        now += csi5300::time::Span::from_ms(100);
        mailbox.put_at(now, message);
        let mut waited = 0;
        loop {
            match card.receive(now).unwrap() {
                Next::Record(stamps, record) => {
                    waited += 1;
                    records += 1;
                    let mut batch = Batch::records(1);
                    batch.push_record(stamps.host_us, record);
                    assert!(batch.len() >= 16 + 8 + record.emit_len());
                }
                Next::Lost(_) => missing += 1,
                Next::Pending => break,
                Next::End(_) => panic!("a robot that may come back"),
            }
        }
        assert!(waited <= LIMIT, "{waited} waited");
    }
    let counts = mailbox.counts();
    assert!(
        records <= counts.received
            && missing <= counts.missing.saturating_add(counts.overflowed).saturating_add(counts.sessions),
        "{counts:?}"
    );
}
