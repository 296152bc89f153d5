//! Any bytes as a connector datagram: refused, or its messages lie inside it.

use driver_iface::connector::{CN_IDX, CN_MSG, Messages, NLMSGHDR};

/// Runs the target.
pub fn run(datagram: &[u8]) {
    let Ok(messages) = Messages::new_checked(datagram) else { return };
    let mut used = NLMSGHDR;
    let mut failed = false;
    for message in messages {
        assert!(!failed, "nothing follows an error");
        match message {
            Ok(message) => {
                used += CN_MSG + message.data.len();
                assert_eq!(message.record(&[message.idx]).is_some(), message.val == 1 && !message.data.is_empty());
                let _ = message.record(&[CN_IDX]);
            }
            Err(_) => failed = true,
        }
    }
    assert!(used <= datagram.len());
}
