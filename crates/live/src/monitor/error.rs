//! Errors of a monitor interface that are not the operating system's.

use crate::sys::ARPHRD_IEEE80211_RADIOTAP;
use driver_iface::radiotap;

/// Why frames cannot be sent and heard on an interface; inside [`csi5300::source::Error::Backend`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MonitorError {
    /// The interface is down.
    #[error("{interface} is down: `sudo ip link set {interface} up`")]
    Down {
        /// Its name.
        interface: String,
    },
    /// The frames to be sent are longer than the interface takes.
    #[error(
        "{interface} takes {mtu} bytes at most, frames here have up to {longest} with their radiotap header: \
         `sudo ip link set {interface} mtu 2304`"
    )]
    Mtu {
        /// Its name.
        interface: String,
        /// Bytes that it takes, radiotap header included.
        mtu: usize,
        /// Bytes of the longest frame with its radiotap header.
        longest: usize,
    },
    /// The interface is no monitor.
    #[error(
        "{interface} has link type {link_type}, not that of a monitor interface ({ARPHRD_IEEE80211_RADIOTAP}, \
         radiotap): `sudo ip link set {interface} down && sudo iw dev {interface} set type monitor && \
         sudo ip link set {interface} up`"
    )]
    LinkType {
        /// Its name.
        interface: String,
        /// ARPHRD_* of the kernel (`linux/if_arp.h`).
        link_type: u16,
    },
    /// The radiotap header cannot express the request.
    #[error(transparent)]
    Header(#[from] radiotap::Error),
}

impl From<MonitorError> for csi5300::source::Error {
    fn from(error: MonitorError) -> Self {
        Self::Backend(Box::new(error))
    }
}
