//! Multicasts records to the driver's group from user space, for `replay --connector` and tests.

use super::NetlinkError;
use csi5300::source::Error;
use driver_iface::connector::{CN_VAL, MAX_DATAGRAM, NETLINK_CONNECTOR, Repr};
use driver_iface::record::Record;
use netlink_sys::{Socket, SocketAddr};
use std::io::ErrorKind;

/// Sends to one connector group. Needs CAP_NET_ADMIN in the user namespace of the network namespace.
#[derive(Debug)]
pub struct Sender {
    socket: Socket,
    group: SocketAddr,
    index: u32,
    padded: bool,
    buffer: Box<[u8]>,
}

impl Sender {
    /// A sender on connector index `index`, 1 to 32; `padded` as the kernel does it, or not, as programs do.
    ///
    /// # Errors
    /// If the index or the connector socket cannot be used.
    pub fn open(index: u32, padded: bool) -> Result<Self, Error> {
        let mask = index.checked_sub(1).and_then(|bit| 1_u32.checked_shl(bit));
        let mask = mask.ok_or(NetlinkError::Index { index })?;
        let io = |source| Error::Io { what: "cannot open a connector socket to send".into(), source };
        let mut socket = Socket::new(isize::from(NETLINK_CONNECTOR.cast_signed())).map_err(io)?;
        socket.bind_auto().map_err(io)?;
        let buffer = vec![0; MAX_DATAGRAM].into_boxed_slice();
        Ok(Self { socket, group: SocketAddr::new(0, mask), index, padded, buffer })
    }

    /// The connector index sent to.
    #[must_use]
    pub fn index(&self) -> u32 {
        self.index
    }

    /// Sends one record to all listeners; none is no error.
    ///
    /// # Errors
    /// A record that does not fit a message, or the kernel's refusal.
    pub fn send(&mut self, record: Record<'_>) -> Result<(), Error> {
        let repr = Repr { idx: self.index, val: CN_VAL, record, padded: self.padded };
        let len = repr.emit(&mut self.buffer).map_err(NetlinkError::Emit)?;
        self.send_bytes(self.buffer.get(..len).unwrap_or_default())
    }

    /// Sends a raw datagram.
    ///
    /// # Errors
    /// The kernel's refusal.
    pub fn send_bytes(&self, datagram: &[u8]) -> Result<(), Error> {
        match self.socket.send_to(datagram, &self.group, 0) {
            // The kernel's own copy is refused outside the first namespace, where it has no connector socket; the
            // multicast was delivered before.
            Err(error) if error.kind() != ErrorKind::ConnectionRefused => Err(Error::Io {
                what: "cannot send to the connector group (CAP_NET_ADMIN is needed; `unshare -Urn` gives it in a \
                       namespace of its own)"
                    .into(),
                source: error,
            }),
            _ => Ok(()),
        }
    }
}
