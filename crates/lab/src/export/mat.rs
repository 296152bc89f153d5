//! MAT files of version 5 for MATLAB, Octave and `scipy.io.loadmat`: arrays of numbers, uncompressed.
//!
//! Source: MathWorks, "MAT-File Format", level 5: a header of 128 bytes, then tagged elements, each padded to 8 bytes. In an
//! array the first index varies fastest.

use super::ExportError;
use super::npz::emit;
use bytemuck::Pod;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// Element types (table 1-1).
const MI_INT8: u32 = 1;
const MI_INT32: u32 = 5;
const MI_UINT32: u32 = 6;
const MI_MATRIX: u32 = 14;
/// Flag of an array with an imaginary part.
const COMPLEX: u32 = 0x0800;
/// Longest element, bytes: some readers read its length as an i32.
const LONGEST: u64 = i32::MAX as u64;

/// A number type of arrays: its array class (table 1-3), its element type, its bytes.
pub trait Number: Pod {
    /// The class of an array of it.
    const CLASS: u32;
    /// The type of its element.
    const TYPE: u32;
}

macro_rules! numbers {
    ($($of:ty: $class:literal, $kind:literal);*) => {$(
        impl Number for $of {
            const CLASS: u32 = $class;
            const TYPE: u32 = $kind;
        }
    )*};
}

numbers!(f64: 6, 9; f32: 7, 7; i8: 8, 1; u8: 9, 2; u16: 11, 4; u32: 13, 6; i64: 14, 12);

/// A file being written.
pub struct Mat {
    out: BufWriter<File>,
    name: String,
}

impl Mat {
    /// Creates (or replaces) the file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn create(path: &Path) -> Result<Self, ExportError> {
        let name = path.display().to_string();
        let failed = |source| ExportError::Io { file: name.clone(), source };
        let mut out = BufWriter::with_capacity(1 << 18, File::create(path).map_err(failed)?);
        let mut header = [b' '; 128];
        let text = b"MATLAB 5.0 MAT-file, written by csi5300";
        for (place, byte) in header.iter_mut().zip(text) {
            *place = *byte;
        }
        // No subsystem data; version 1.0; "MI" as a number, which shows readers the byte order.
        let [version, order] = [0x0100_u16, 0x4D49].map(u16::to_ne_bytes);
        for (place, byte) in header.iter_mut().skip(116).zip([0; 8].into_iter().chain(version).chain(order)) {
            *place = byte;
        }
        out.write_all(&header).map_err(failed)?;
        Ok(Self { out, name })
    }

    /// Adds an array; in `dims` and in the values the first index varies fastest.
    ///
    /// # Errors
    /// If it cannot be written, is too long for the format, or has the wrong number of values.
    pub fn array<T: Number>(
        &mut self,
        name: &str,
        dims: &[u64],
        values: impl Iterator<Item = T>,
    ) -> Result<(), ExportError> {
        self.begin::<T>(name, dims, false)?;
        self.part(name, dims, values)
    }

    /// Adds a complex array from the real and the imaginary parts.
    ///
    /// # Errors
    /// As [`Mat::array`].
    pub fn complex<T: Number>(
        &mut self,
        name: &str,
        dims: &[u64],
        re: impl Iterator<Item = T>,
        im: impl Iterator<Item = T>,
    ) -> Result<(), ExportError> {
        self.begin::<T>(name, dims, true)?;
        self.part(name, dims, re)?;
        self.part(name, dims, im)
    }

    /// Finishes the file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn finish(mut self) -> Result<(), ExportError> {
        self.out.flush().map_err(|source| ExportError::Io { file: self.name, source })
    }

    fn failed(&self, source: io::Error) -> ExportError {
        ExportError::Io { file: self.name.clone(), source }
    }

    fn begin<T: Number>(&mut self, name: &str, dims: &[u64], complex: bool) -> Result<(), ExportError> {
        let part = 8 + padded(dims.iter().product::<u64>() * size_of::<T>() as u64);
        let parts = if complex { 2 * part } else { part };
        let head = 16 + 8 + padded(4 * dims.len() as u64) + 8 + padded(name.len() as u64);
        if head + parts > LONGEST {
            return Err(ExportError::TooLong { file: self.name.clone(), array: name.to_owned(), bytes: head + parts });
        }
        let mut bytes = Vec::new();
        let mut words = |words: &[u32]| bytes.extend(words.iter().flat_map(|word| word.to_ne_bytes()));
        words(&[MI_MATRIX, (head + parts) as u32]);
        words(&[MI_UINT32, 8, T::CLASS | if complex { COMPLEX } else { 0 }, 0]);
        words(&[MI_INT32, 4 * dims.len() as u32]);
        words(&dims.iter().map(|dim| *dim as u32).collect::<Vec<_>>());
        if dims.len() % 2 == 1 {
            words(&[0]);
        }
        words(&[MI_INT8, name.len() as u32]);
        bytes.extend(name.as_bytes());
        bytes.resize(bytes.len().next_multiple_of(8), 0);
        self.out.write_all(&bytes).map_err(|error| self.failed(error))
    }

    fn part<T: Number>(
        &mut self,
        name: &str,
        dims: &[u64],
        values: impl Iterator<Item = T>,
    ) -> Result<(), ExportError> {
        let expect = dims.iter().product::<u64>();
        let bytes = expect * size_of::<T>() as u64;
        let written = (|| -> io::Result<u64> {
            self.out.write_all(&T::TYPE.to_ne_bytes())?;
            self.out.write_all(&(bytes as u32).to_ne_bytes())?;
            let got = emit(values, &mut self.out)?;
            (bytes..padded(bytes)).try_for_each(|_| self.out.write_all(&[0]))?;
            Ok(got)
        })();
        let got = written.map_err(|error| self.failed(error))?;
        if got != expect {
            return Err(ExportError::Values { file: self.name.clone(), array: name.to_owned(), got, expect });
        }
        Ok(())
    }
}

/// Bytes including their padding.
fn padded(bytes: u64) -> u64 {
    bytes.next_multiple_of(8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_consists_of_its_elements() {
        let path = std::env::temp_dir().join(format!("csi5300-mat-{}.mat", std::process::id()));
        let mut mat = Mat::create(&path).unwrap();
        mat.array("a", &[3, 1], [1_u8, 2, 3].into_iter()).unwrap();
        mat.complex("bcd", &[2, 1, 1], [1.0_f32, 2.0].into_iter(), [3.0_f32, 4.0].into_iter()).unwrap();
        let short = mat.array("e", &[2, 2], [1.0_f64].into_iter());
        assert!(matches!(short, Err(ExportError::Values { got: 1, expect: 4, .. })));
        let long = mat.array("f", &[1 << 29, 1], std::iter::empty::<f64>());
        assert!(matches!(long, Err(ExportError::TooLong { .. })));
        mat.finish().unwrap();
        let bytes = std::fs::read(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        assert_eq!(&bytes[124..128], &[0, 1, b'I', b'M']);
        assert_eq!((word(128), word(132)), (14, 16 + 16 + 16 + 16));
        assert_eq!((word(136), word(140), word(144)), (6, 8, 9));
        assert_eq!((word(152), word(156), word(160), word(164)), (5, 8, 3, 1));
        assert_eq!((word(168), word(172), bytes[176]), (1, 1, b'a'));
        assert_eq!((word(184), word(188), &bytes[192..195]), (2, 3, &[1, 2, 3][..]));
        let second = 136 + word(132) as usize;
        assert_eq!((word(second), word(second + 16)), (14, 7 | 0x0800));
        assert_eq!(second + 8 + word(second + 4) as usize % 8, second + 8, "elements end at multiples of 8");
    }
}
