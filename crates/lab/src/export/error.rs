//! Why an export failed.

/// Why a file was not written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExportError {
    /// The operating system said no.
    #[error("cannot write {file}: {source}")]
    Io {
        /// The file.
        file: String,
        /// Its answer.
        source: std::io::Error,
    },
    /// The log cannot be read again.
    #[error("cannot read {file} again: {source}")]
    Log {
        /// The log.
        file: String,
        /// The operating system's answer.
        source: std::io::Error,
    },
    /// A record of the log is not where it was when the log was read first.
    #[error("{file} was changed while it was exported: the record at byte {offset} is gone; export a copy of it")]
    Changed {
        /// The log.
        file: String,
        /// Where the record was, bytes.
        offset: u64,
    },
    /// The library that writes the format refused.
    #[error("writing {file}: {source}")]
    Format {
        /// The file.
        file: String,
        /// Its answer.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// An array has another number of values than its shape.
    #[error("{array} in {file}: {got} values for {expect} places")]
    Values {
        /// The file.
        file: String,
        /// The array.
        array: String,
        /// Values.
        got: u64,
        /// Places.
        expect: u64,
    },
    /// An array is longer than the format holds.
    #[error(
        "{array} in {file} takes {bytes} bytes, and arrays of this format 2^31 at most: export a part, or as .npz or .parquet"
    )]
    TooLong {
        /// The file.
        file: String,
        /// The array.
        array: String,
        /// Bytes that it takes.
        bytes: u64,
    },
    /// Who asked for the file wants it no more.
    #[error("{file} was not written to its end: that was stopped")]
    Stopped {
        /// The file.
        file: String,
    },
    /// No format has this extension.
    #[error("{file}: CSI is exported as {known}")]
    Extension {
        /// The file.
        file: String,
        /// What is written.
        known: &'static str,
    },
}

impl ExportError {
    /// The same of a file that will have another name: who writes a draft names the file that it becomes.
    #[must_use]
    pub fn of_file(mut self, name: &std::path::Path) -> Self {
        match &mut self {
            Self::Io { file, .. }
            | Self::Format { file, .. }
            | Self::Values { file, .. }
            | Self::TooLong { file, .. }
            | Self::Stopped { file }
            | Self::Extension { file, .. } => *file = name.display().to_string(),
            // Of the log that is read.
            Self::Log { .. } | Self::Changed { .. } => {}
        }
        self
    }
}
