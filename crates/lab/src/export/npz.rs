//! NPZ files, as NumPy reads them: a ZIP archive of NPY arrays, stored as they are (CSI hardly compresses).
//!
//! Source: NumPy Enhancement Proposal 1 (format 1.0), `numpy.savez`.

use super::error::ExportError;
use num_complex::Complex32;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

/// A value that an array can hold.
pub trait Element {
    /// Its dtype as NumPy describes it: byte order, kind, bytes.
    const DESCR: &str;
    /// Writes its bytes, in that order.
    ///
    /// # Errors
    /// As the writer.
    fn emit(self, out: &mut impl Write) -> io::Result<()>;
}

macro_rules! elements {
    ($($of:ty: $descr:literal),*) => {$(
        impl Element for $of {
            const DESCR: &str = $descr;
            fn emit(self, out: &mut impl Write) -> io::Result<()> {
                out.write_all(&self.to_le_bytes())
            }
        }
    )*};
}

elements!(u8: "|u1", i8: "|i1", u16: "<u2", u32: "<u4", i64: "<i8", f64: "<f8");

impl Element for Complex32 {
    const DESCR: &str = "<c8";
    fn emit(self, out: &mut impl Write) -> io::Result<()> {
        out.write_all(&self.re.to_le_bytes())?;
        out.write_all(&self.im.to_le_bytes())
    }
}

/// An NPZ file being written. Dropped early, it is left without its directory, and readers refuse it.
pub struct Npz {
    writer: ZipWriter<BufWriter<File>>,
    name: String,
}

impl Npz {
    /// Creates (or replaces) the file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn create(path: &Path) -> Result<Self, ExportError> {
        let name = path.display().to_string();
        let file = File::create(path).map_err(|source| ExportError::Io { file: name.clone(), source })?;
        Ok(Self { writer: ZipWriter::new(BufWriter::with_capacity(1 << 18, file)), name })
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
        let (file, io) = (self.name.clone(), |file: &str, source| ExportError::Io { file: file.to_owned(), source });
        // Room for sizes over 4 GiB: an array's size is known only at its end.
        let options = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored).large_file(true);
        let started = self.writer.start_file(format!("{name}.npy"), options);
        started.map_err(|source| ExportError::Format { file: file.clone(), source: source.into() })?;
        let mut out = BufWriter::with_capacity(1 << 16, &mut self.writer);
        out.write_all(&header(T::DESCR, shape)).map_err(|error| io(&file, error))?;
        let (mut got, expect) = (0_u64, shape.iter().product::<u64>());
        for value in values {
            got += 1;
            value.emit(&mut out).map_err(|error| io(&file, error))?;
        }
        out.flush().map_err(|error| io(&file, error))?;
        if got != expect {
            return Err(ExportError::Values { file: file.clone(), array: name.to_owned(), got, expect });
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
fn header(descr: &str, shape: &[u64]) -> Vec<u8> {
    let shape: String = shape.iter().map(|length| format!("{length},")).collect();
    let mut dict = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({shape}), }}");
    let length = (10 + dict.len() + 1).next_multiple_of(64) - 10;
    dict.push_str(&" ".repeat(length - dict.len() - 1));
    dict.push('\n');
    let mut header = b"\x93NUMPY\x01\x00".to_vec();
    header.extend(u16::try_from(length).unwrap_or(u16::MAX).to_le_bytes());
    header.extend(dict.as_bytes());
    header
}
