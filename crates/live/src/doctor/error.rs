//! Why the card could not be set up.

/// Why a step of the set-up cannot be planned or taken.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SetupError {
    /// A file could not be written.
    #[error("writing {path}: {source}")]
    Write {
        /// The file.
        path: String,
        /// The operating system's answer.
        source: std::io::Error,
    },
    /// The driver has no file for the rate of injected frames.
    #[error("{pattern} is not there: is debugfs mounted, and the driver a CSI driver?")]
    NoRateFile {
        /// Its expected path.
        pattern: String,
    },
    /// A program failed.
    #[error("{command}: {output}")]
    Command {
        /// The program and its arguments.
        command: String,
        /// What it printed.
        output: String,
    },
    /// A program is not installed.
    #[error("{program} is not installed")]
    NotInstalled {
        /// Its name.
        program: String,
    },
    /// The driver cannot report CSI.
    #[error("iwlwifi has no connector_log: it is not a CSI driver")]
    NoCsiDriver,
    /// A responder with the WSR driver without the length of its frames.
    #[error(
        "a responder with the WSR driver needs the length of the frames meant for it (57 for the first robot, 59 for the \
         second ...)"
    )]
    NoAckLen,
    /// No card on the bus.
    #[error("no Intel 5300 on the PCI bus")]
    NoCard,
    /// A card without an interface.
    #[error("the card has no interface")]
    NoInterface,
}
