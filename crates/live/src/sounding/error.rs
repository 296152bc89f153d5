//! Errors of opening or ending an exchange.

use driver_iface::Mac;

/// Errors of an exchange. Within [`csi5300::source::Error`] they are a backend's.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SoundingError {
    /// The interface has no MAC, and none was given.
    #[error("{interface} has no MAC of its own: name the one to use")]
    NoMac {
        /// The interface.
        interface: String,
    },
    /// A robot's key file has no key with a peer.
    #[error("the key file has no key of {own} with {peer}: make another with `csi5300 key robot`, all peers named")]
    NoKeyWith {
        /// This robot.
        own: Mac,
        /// The peer.
        peer: Mac,
    },
    /// The thread that sends has panicked.
    #[error("the thread that sends has panicked")]
    Panicked,
}

impl From<SoundingError> for csi5300::source::Error {
    fn from(error: SoundingError) -> Self {
        Self::Backend(Box::new(error))
    }
}
