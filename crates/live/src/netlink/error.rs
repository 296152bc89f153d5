//! Errors of the connector that are not the operating system's.

use super::socket::MAX_GROUP;
use driver_iface::EmitError;

/// Why the kernel's connector cannot be listened to, or sent to; inside [`csi5300::source::Error::Backend`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NetlinkError {
    /// Only the first network namespace has the connector.
    #[error(
        "the kernel's connector is not in this network namespace (/proc/net/connector is absent): run outside of the \
         container or `ip netns`, on a kernel with CONFIG_CONNECTOR=y"
    )]
    OtherNamespace,
    /// The connector has no such index to send to.
    #[error("connector index {index}: 1 to {MAX_GROUP} can be sent to")]
    Index {
        /// The requested index.
        index: u32,
    },
    /// A record does not fit a message.
    #[error(transparent)]
    Emit(#[from] EmitError),
}

impl From<NetlinkError> for csi5300::source::Error {
    fn from(error: NetlinkError) -> Self {
        Self::Backend(Box::new(error))
    }
}
