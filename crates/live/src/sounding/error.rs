//! Why an exchange cannot be opened or brought to its end.

use std::path::PathBuf;

/// What an exchange refuses. Within [`csi5300::source::Error`] it is a backend's error.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SoundingError {
    /// The interface has no MAC, and none was given.
    #[error("{interface} has no MAC of its own: say which it is to use")]
    NoMac {
        /// The interface.
        interface: String,
    },
    /// A key's file holds something else.
    #[error(
        "{}: a key is 16 bytes or 32 hexadecimal digits; make one with `head -c 16 /dev/urandom > FILE`",
        .path.display()
    )]
    Key {
        /// The file.
        path: PathBuf,
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
