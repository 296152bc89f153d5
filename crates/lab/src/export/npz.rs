//! NPZ files, as NumPy reads them: a ZIP archive of NPY arrays, stored as they are (CSI hardly compresses).
//!
//! Source: NumPy Enhancement Proposal 1 (format 1.0), `numpy.savez`.

use super::blocks::{emit, emit_blocks};
use super::error::ExportError;
use bytemuck::Pod;
use num_complex::Complex32;
use std::fs::File;
use std::io::{self, Write};
use std::path::Path;
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

/// A value that an array can hold; its bytes are those of memory.
pub trait Element: Pod {
    /// Its dtype as NumPy describes it, without the byte order: kind, bytes.
    const DESCR: &str;
}

macro_rules! elements {
    ($($of:ty: $descr:literal),*) => {$(
        impl Element for $of {
            const DESCR: &str = $descr;
        }
    )*};
}

elements!(u8: "u1", i8: "i1", u16: "u2", u32: "u4", i64: "i8", f64: "f8", Complex32: "c8");

/// An NPZ file being written. Dropped early, it is left without its directory, and readers refuse it.
pub struct Npz {
    writer: ZipWriter<File>,
    name: String,
}

impl Npz {
    /// Creates (or replaces) the file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn create(path: &Path) -> Result<Self, ExportError> {
        Self::create_for(path, 0)
    }

    /// The same for at least so many bytes, which the file system sets aside where it can: writing costs it a third less then. The
    /// file itself grows as it is written.
    pub(super) fn create_for(path: &Path, bytes: u64) -> Result<Self, ExportError> {
        let name = path.display().to_string();
        let file = File::create(path).map_err(|source| ExportError::Io { file: name.clone(), source })?;
        #[cfg(target_os = "linux")]
        if let Ok(bytes) = i64::try_from(bytes)
            && bytes > 0
        {
            let _ = nix::fcntl::fallocate(&file, nix::fcntl::FallocateFlags::FALLOC_FL_KEEP_SIZE, 0, bytes);
        }
        Ok(Self { writer: ZipWriter::new(file), name })
    }

    /// Adds an array of the given shape, last index fastest.
    ///
    /// # Errors
    /// If it cannot be written, or has another number of values than its shape.
    pub fn array<T: Element>(
        &mut self,
        name: &str,
        shape: &[u64],
        values: impl Iterator<Item = T>,
    ) -> Result<(), ExportError> {
        self.add::<T>(name, shape, |out| emit(values, out))
    }

    /// Adds an array whose values are handed over block by block: `next` puts the next values in the place of those in the block,
    /// and none at the end.
    ///
    /// # Errors
    /// As [`Npz::array`].
    pub(super) fn blocks<T: Element>(
        &mut self,
        name: &str,
        shape: &[u64],
        next: impl FnMut(&mut Vec<T>),
    ) -> Result<(), ExportError> {
        self.add::<T>(name, shape, |out| emit_blocks(next, out))
    }

    /// Adds an array that `write` writes, which says how many values it had.
    fn add<T: Element>(
        &mut self,
        name: &str,
        shape: &[u64],
        write: impl FnOnce(&mut ZipWriter<File>) -> io::Result<u64>,
    ) -> Result<(), ExportError> {
        let io = |source| ExportError::Io { file: self.name.clone(), source };
        // Room for sizes over 4 GiB: an array's size is known only at its end.
        let options = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored).large_file(true);
        let started = self.writer.start_file(format!("{name}.npy"), options);
        started.map_err(|source| ExportError::Format { file: self.name.clone(), source: source.into() })?;
        self.writer.write_all(&header::<T>(shape)).map_err(io)?;
        let (got, expect) = (write(&mut self.writer).map_err(io)?, shape.iter().product::<u64>());
        if got != expect {
            return Err(ExportError::Values { file: self.name.clone(), array: name.to_owned(), got, expect });
        }
        Ok(())
    }

    /// Writes the directory of the archive.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn finish(self) -> Result<(), ExportError> {
        let file = self.name;
        let mut written = match self.writer.finish() {
            Ok(written) => written,
            Err(source) => return Err(ExportError::Format { file, source: source.into() }),
        };
        written.flush().map_err(|source| ExportError::Io { file, source })
    }
}

/// An NPY header of format 1.0, padded so that the data starts at a multiple of 64 bytes.
fn header<T: Element>(shape: &[u64]) -> Vec<u8> {
    let order = match (size_of::<T>(), cfg!(target_endian = "big")) {
        (1, _) => '|',
        (_, true) => '>',
        (_, false) => '<',
    };
    let descr = T::DESCR;
    let shape: String = shape.iter().map(|length| format!("{length},")).collect();
    let mut dict = format!("{{'descr': '{order}{descr}', 'fortran_order': False, 'shape': ({shape}), }}");
    let length = (10 + dict.len() + 1).next_multiple_of(64) - 10;
    dict.push_str(&" ".repeat(length - dict.len() - 1));
    dict.push('\n');
    let mut header = b"\x93NUMPY\x01\x00".to_vec();
    header.extend(u16::try_from(length).unwrap_or(u16::MAX).to_le_bytes());
    header.extend(dict.as_bytes());
    header
}
