//! Files of arrays: NPZ for NumPy, MAT for MATLAB, Octave and SciPy.

use bytemuck::{Pod, cast_slice};
use num_complex::Complex32;
use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::Path;
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

/// A value type of arrays, stored as in memory.
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

elements!(u8: "u1", i8: "i1", u16: "u2", u32: "u4", i64: "i8", f32: "f4", f64: "f8", Complex32: "c8");

/// A file that refuses all writes after its first error, but reports success: dropping the archive's writer finishes the file,
/// and an error there would be printed to standard error.
struct Disk {
    file: File,
    /// Its intended position in the file, and its end.
    at: u64,
    end: u64,
    refused: Option<io::ErrorKind>,
}

impl Disk {
    /// An empty file.
    fn new(file: File) -> Self {
        Self { file, at: 0, end: 0, refused: None }
    }

    /// Keeps the file's first error.
    fn note<T>(&mut self, said: io::Result<T>) -> io::Result<T> {
        let refused = said.as_ref().err().map(io::Error::kind);
        self.refused = refused.filter(|kind| *kind != io::ErrorKind::Interrupted);
        said
    }
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = match self.refused {
            Some(_) => bytes.len(),
            None => {
                let said = self.file.write(bytes);
                self.note(said)?
            }
        };
        self.at += count as u64;
        self.end = self.end.max(self.at);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        let said = if self.refused.is_none() { self.file.flush() } else { return Ok(()) };
        self.note(said)
    }
}

impl Seek for Disk {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.at = match (self.refused, to) {
            (None, _) => {
                let said = self.file.seek(to);
                self.note(said)?
            }
            (Some(_), SeekFrom::Start(at)) => at,
            (Some(_), SeekFrom::Current(by)) => self.at.saturating_add_signed(by),
            (Some(_), SeekFrom::End(by)) => self.end.saturating_add_signed(by),
        };
        Ok(self.at)
    }
}

/// An NPZ file being written. If it is dropped early it has no directory, and readers refuse it.
pub struct Npz(ZipWriter<Disk>);

impl Npz {
    /// Creates (or replaces) the file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn create(path: &Path) -> io::Result<Self> {
        Self::create_for(path, 0)
    }

    /// The same for at least this many bytes, which the file system allocates if it can: writing then takes a third less time. The
    /// file itself grows as it is written.
    pub(super) fn create_for(path: &Path, bytes: u64) -> io::Result<Self> {
        let file = File::create(path)?;
        #[cfg(target_os = "linux")]
        if let Ok(bytes) = i64::try_from(bytes)
            && bytes > 0
        {
            let _ = nix::fcntl::fallocate(&file, nix::fcntl::FallocateFlags::FALLOC_FL_KEEP_SIZE, 0, bytes);
        }
        Ok(Self(ZipWriter::new(Disk::new(file))))
    }

    /// Adds an array of the given shape, last index fastest.
    ///
    /// # Errors
    /// If it cannot be written, or the number of values does not match the shape.
    pub fn array<T: Element>(&mut self, name: &str, shape: &[u64], values: impl Iterator<Item = T>) -> io::Result<()> {
        self.add::<T>(name, shape, |out| emit(values, out))
    }

    /// Adds an array block by block: `next` replaces the block's content with the next values, and leaves it empty at the end.
    ///
    /// # Errors
    /// As [`Npz::array`].
    pub(super) fn blocks<T: Element>(
        &mut self,
        name: &str,
        shape: &[u64],
        next: impl FnMut(&mut Vec<T>),
    ) -> io::Result<()> {
        self.add::<T>(name, shape, |out| emit_blocks(next, out))
    }

    /// Adds an array that `write` writes and whose number of values it returns.
    fn add<T: Element>(
        &mut self,
        name: &str,
        shape: &[u64],
        write: impl FnOnce(&mut ZipWriter<Disk>) -> io::Result<u64>,
    ) -> io::Result<()> {
        // Room for sizes over 4 GiB: an array's size is only known at its end. It is written into the head, not behind the array,
        // where readers such as cnpy expect the next one.
        let options = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored).large_file(true);
        self.0.start_file(format!("{name}.npy"), options)?;
        self.0.write_all(&header::<T>(shape))?;
        must_fit(name, shape, write(&mut self.0)?)
    }

    /// Writes the directory of the archive.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn finish(self) -> io::Result<()> {
        let mut written = self.0.finish()?;
        let flushed = written.flush();
        written.refused.map_or(flushed, |kind| Err(kind.into()))
    }
}

/// Refuses an array with another number of values than its shape has.
fn must_fit(name: &str, shape: &[u64], got: u64) -> io::Result<()> {
    match shape.iter().product::<u64>() {
        expect if expect == got => Ok(()),
        expect => Err(io::Error::other(format!("{name} has {got} values for {expect} places"))),
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

/// Bytes written at a time: enough for one system call, few enough to stay in the second-level cache.
const BLOCK: usize = 256 * 1024;

/// Writes values as they are in memory; returns their number.
///
/// # Errors
/// As the writer.
pub(super) fn emit<T: Pod>(mut values: impl Iterator<Item = T>, out: &mut impl Write) -> io::Result<u64> {
    let next = |block: &mut Vec<T>| {
        block.clear();
        block.extend(values.by_ref().take(BLOCK / size_of::<T>().max(1)));
    };
    emit_blocks(next, out)
}

/// The same block by block: `next` replaces the block's content with the next values, and leaves it empty at the end.
///
/// # Errors
/// As the writer.
fn emit_blocks<T: Pod>(mut next: impl FnMut(&mut Vec<T>), out: &mut impl Write) -> io::Result<u64> {
    let (mut block, mut written) = (Vec::new(), 0);
    loop {
        next(&mut block);
        if block.is_empty() {
            return Ok(written);
        }
        out.write_all(cast_slice(&block))?;
        written += block.len() as u64;
    }
}

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
pub trait Number: Element {
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
pub struct Mat(BufWriter<File>);

impl Mat {
    /// Creates (or replaces) the file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn create(path: &Path) -> io::Result<Self> {
        let mut out = BufWriter::with_capacity(1 << 18, File::create(path)?);
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
        out.write_all(&header)?;
        Ok(Self(out))
    }

    /// Adds an array; in `dims` and in the values the first index varies fastest.
    ///
    /// # Errors
    /// If it cannot be written, is too long for the format, or has the wrong number of values.
    pub fn array<T: Number>(&mut self, name: &str, dims: &[u64], values: impl Iterator<Item = T>) -> io::Result<()> {
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
    ) -> io::Result<()> {
        self.begin::<T>(name, dims, true)?;
        self.part(name, dims, re)?;
        self.part(name, dims, im)
    }

    /// Finishes the file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn finish(mut self) -> io::Result<()> {
        self.0.flush()
    }

    fn begin<T: Number>(&mut self, name: &str, dims: &[u64], complex: bool) -> io::Result<()> {
        let part = 8 + padded(dims.iter().product::<u64>() * size_of::<T>() as u64);
        let parts = if complex { 2 * part } else { part };
        let head = 16 + 8 + padded(4 * dims.len() as u64) + 8 + padded(name.len() as u64);
        if head + parts > LONGEST {
            return Err(io::Error::other(format!(
                "{name} takes {} bytes, but arrays of this format have at most 2^31: export a part, or as .npz or .parquet",
                head + parts
            )));
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
        self.0.write_all(&bytes)
    }

    fn part<T: Number>(&mut self, name: &str, dims: &[u64], values: impl Iterator<Item = T>) -> io::Result<()> {
        let bytes = dims.iter().product::<u64>() * size_of::<T>() as u64;
        self.0.write_all(&T::TYPE.to_ne_bytes())?;
        self.0.write_all(&(bytes as u32).to_ne_bytes())?;
        let got = emit(values, &mut self.0)?;
        (bytes..padded(bytes)).try_for_each(|_| self.0.write_all(&[0]))?;
        must_fit(name, dims, got)
    }
}

/// Bytes including their padding.
fn padded(bytes: u64) -> u64 {
    bytes.next_multiple_of(8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::temporary::Temporary;

    /// A file that refuses all writes stands for a full disk: `/dev/full` does not show the position of a write.
    #[test]
    fn after_a_failed_write_nothing_is_written_and_the_error_is_kept() {
        let path = &Temporary::file("refused.npz", b"").0;
        let mut disk = Disk::new(File::open(path).unwrap());
        assert!(disk.write(b"x").is_err());
        assert!(disk.refused.is_some());
        assert!(disk.write(b"more").is_ok_and(|count| count == 4) && disk.flush().is_ok());
        // The position advances as if the write had succeeded.
        assert_eq!(disk.seek(SeekFrom::Current(-3)).unwrap(), 1);
        assert_eq!((disk.seek(SeekFrom::End(1)).unwrap(), disk.seek(SeekFrom::Start(2)).unwrap()), (5, 2));
        let refusing = || ZipWriter::new(Disk::new(File::open(path).unwrap()));
        // The first array is refused; later writes must not succeed.
        let mut npz = Npz(refusing());
        assert!(npz.array("a", &[1], [1_u8].into_iter()).is_err());
        assert!(npz.finish().is_err());
    }

    /// As cnpy reads, from the head of one array to that of the next.
    #[test]
    fn arrays_follow_each_other_without_the_directory() {
        let path = &Temporary::path("heads.npz").0;
        let mut npz = Npz::create(path).unwrap();
        npz.array("a", &[3], [1_u8, 2, 3].into_iter()).unwrap();
        npz.array("b", &[1], [4_u8].into_iter()).unwrap();
        npz.finish().unwrap();
        let bytes = std::fs::read(path).unwrap();
        let mut at = 0;
        for (name, values) in [(b"a.npy", &[1_u8, 2, 3][..]), (b"b.npy", &[4])] {
            let word = |at: usize| usize::from(u16::from_le_bytes(bytes[at..at + 2].try_into().unwrap()));
            assert_eq!(&bytes[at..at + 4], b"PK\x03\x04");
            assert_eq!(&bytes[at + 30..][..word(at + 26)], name);
            let array = at + 30 + word(at + 26) + word(at + 28);
            assert_eq!(&bytes[array..array + 6], b"\x93NUMPY");
            let data = array + 10 + word(array + 8);
            assert_eq!(&bytes[data..data + values.len()], values);
            at = data + values.len();
        }
    }

    #[test]
    fn a_file_consists_of_its_elements() {
        let path = &Temporary::path("mat.mat").0;
        let mut mat = Mat::create(path).unwrap();
        mat.array("a", &[3, 1], [1_u8, 2, 3].into_iter()).unwrap();
        mat.complex("bcd", &[2, 1, 1], [1.0_f32, 2.0].into_iter(), [3.0_f32, 4.0].into_iter()).unwrap();
        let short = mat.array("e", &[2, 2], [1.0_f64].into_iter()).unwrap_err().to_string();
        assert_eq!(short, "e has 1 values for 4 places");
        let long = mat.array("f", &[1 << 29, 1], std::iter::empty::<f64>()).unwrap_err().to_string();
        assert!(long.contains("at most 2^31"), "{long}");
        mat.finish().unwrap();
        let bytes = std::fs::read(path).unwrap();
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
