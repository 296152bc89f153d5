//! Common Data Representation: the values in the payload of a ROS 2 message (\[dds-xtypes\] 7.4). Writes version 1, as ROS 2
//! does; reads version 2 without headers, too.
//!
//! Each value is aligned to its size, counted from after the four bytes of the encapsulation. Strings and lists have their
//! length before them; a string ends with a zero, which counts.

/// Encapsulation that is written: version 1, little-endian (\[rtps\] 10.2).
pub const CDR_LE: [u8; 4] = [0, 1, 0, 0];

/// Why bytes are not a value of the expected type.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CdrError {
    /// The payload ends before the value does.
    #[error("ends at byte {at}, {want} more bytes expected")]
    Short {
        /// Bytes from the start of the values.
        at: usize,
        /// Bytes that are missing at least.
        want: usize,
    },
    /// Unknown representation.
    #[error("unknown representation {0:#06x}")]
    Representation(u16),
    /// A name or list is longer than its kind allows.
    #[error("has length {length}, at most {most} expected")]
    Long {
        /// Bytes, or values.
        length: usize,
        /// The limit.
        most: usize,
    },
    /// A string is not UTF-8, or does not end with a zero.
    #[error("invalid text at byte {0}")]
    NoText(usize),
}

/// Reads values from bytes.
#[derive(Clone, Debug)]
pub struct CdrReader<'a> {
    bytes: &'a [u8],
    at: usize,
    little: bool,
    /// Largest alignment.
    most: usize,
    /// Whether strings end with a zero.
    has_ends: bool,
}

impl<'a> CdrReader<'a> {
    /// From a message's payload, encapsulation first.
    pub fn of_payload(payload: &'a [u8]) -> Result<Self, CdrError> {
        let Some(([high, low, _, _], bytes)) = payload.split_first_chunk::<4>() else {
            return Err(CdrError::Short { at: 0, want: 4 });
        };
        let representation = u16::from_be_bytes([*high, *low]);
        let (little, most) = match representation {
            // Plain and parameter list, version 1; plain, version 2.
            0x0000 | 0x0002 => (false, 8),
            0x0001 | 0x0003 => (true, 8),
            0x0006 => (false, 4),
            0x0007 => (true, 4),
            _ => return Err(CdrError::Representation(representation)),
        };
        Ok(Self { bytes, at: 0, little, most, has_ends: true })
    }

    /// From bytes without encapsulation.
    pub fn plain(bytes: &'a [u8], little: bool) -> Self {
        Self { bytes, at: 0, little, most: 8, has_ends: true }
    }

    /// From bytes of ROS 1 or MCAP: little-endian, without alignment, strings without a zero.
    pub fn packed(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0, little: true, most: 1, has_ends: false }
    }

    /// The remaining bytes.
    pub fn rest(&self) -> &'a [u8] {
        self.bytes.get(self.at..).unwrap_or_default()
    }

    /// The next bytes, unchanged.
    pub fn take(&mut self, count: usize) -> Result<&'a [u8], CdrError> {
        let (at, rest) = (self.at, self.rest());
        let taken = rest.get(..count).ok_or_else(|| CdrError::Short { at, want: count - rest.len() })?;
        self.at += count;
        Ok(taken)
    }

    /// The next value's bytes, aligned to their number.
    fn aligned<const N: usize>(&mut self) -> Result<[u8; N], CdrError> {
        self.take(self.at.next_multiple_of(N.min(self.most)) - self.at)?;
        let (at, rest) = (self.at, self.rest());
        let taken = rest.first_chunk::<N>().ok_or_else(|| CdrError::Short { at, want: N - rest.len() })?;
        self.at += N;
        let mut value = *taken;
        if !self.little {
            value.reverse();
        }
        Ok(value)
    }
}

/// Writes values to bytes, little-endian.
#[derive(Clone, Debug, Default)]
pub struct CdrWriter {
    bytes: Vec<u8>,
    /// Origin of the alignment.
    origin: usize,
}

impl CdrWriter {
    /// Without encapsulation.
    pub fn plain() -> Self {
        Self::default()
    }

    /// Appends bytes unchanged.
    pub fn put(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    fn aligned<const N: usize>(&mut self, value: [u8; N]) {
        let at = self.bytes.len() - self.origin;
        self.bytes.resize(self.origin + at.next_multiple_of(N), 0);
        self.bytes.extend_from_slice(&value);
    }

    /// The written bytes.
    pub fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }
}

/// A value of CDR.
pub trait Cdr: Sized {
    /// Writes it.
    fn write(&self, to: &mut CdrWriter);
    /// Reads it.
    fn read(from: &mut CdrReader<'_>) -> Result<Self, CdrError>;

    /// The payload of a message: encapsulation and value.
    fn payload(&self) -> Vec<u8> {
        let mut to = CdrWriter { bytes: CDR_LE.to_vec(), origin: CDR_LE.len() };
        self.write(&mut to);
        to.into_bytes()
    }

    /// The value of a payload; ignores what follows it.
    fn of_payload(payload: &[u8]) -> Result<Self, CdrError> {
        Self::read(&mut CdrReader::of_payload(payload)?)
    }
}

macro_rules! numbers {
    ($($number:ty),*) => {$(
        impl Cdr for $number {
            fn write(&self, to: &mut CdrWriter) {
                to.aligned(self.to_le_bytes());
            }

            fn read(from: &mut CdrReader<'_>) -> Result<Self, CdrError> {
                from.aligned().map(Self::from_le_bytes)
            }
        }
    )*};
}
numbers!(u8, i8, u16, i16, u32, i32, u64, i64, f32, f64);

impl Cdr for bool {
    fn write(&self, to: &mut CdrWriter) {
        u8::from(*self).write(to);
    }

    fn read(from: &mut CdrReader<'_>) -> Result<Self, CdrError> {
        u8::read(from).map(|byte| byte != 0)
    }
}

impl Cdr for String {
    fn write(&self, to: &mut CdrWriter) {
        // A zero inside would end it for readers in C.
        let text = self.split('\0').next().unwrap_or_default();
        (u32::try_from(text.len() + 1).unwrap_or(u32::MAX)).write(to);
        to.put(text.as_bytes());
        to.put(&[0]);
    }

    fn read(from: &mut CdrReader<'_>) -> Result<Self, CdrError> {
        let length = u32::read(from)? as usize;
        let at = from.at;
        let bytes = from.take(length)?;
        let text = match bytes.split_last() {
            _ if !from.has_ends => bytes,
            // Some writers give an empty string no zero.
            None => bytes,
            Some((0, text)) => text,
            Some(_) => return Err(CdrError::NoText(at)),
        };
        std::str::from_utf8(text).map(str::to_owned).map_err(|_| CdrError::NoText(at))
    }
}

impl<T: Cdr> Cdr for Vec<T> {
    fn write(&self, to: &mut CdrWriter) {
        (u32::try_from(self.len()).unwrap_or(u32::MAX)).write(to);
        self.iter().for_each(|value| value.write(to));
    }

    fn read(from: &mut CdrReader<'_>) -> Result<Self, CdrError> {
        let count = u32::read(from)? as usize;
        // Each value takes at least a byte: an invented number allocates nothing.
        if count > from.rest().len() {
            return Err(CdrError::Short { at: from.at, want: count - from.rest().len() });
        }
        let mut values = Self::new();
        for _ in 0..count {
            values.push(T::read(from)?);
        }
        Ok(values)
    }
}

impl<T: Cdr + Default + Copy, const N: usize> Cdr for [T; N] {
    fn write(&self, to: &mut CdrWriter) {
        self.iter().for_each(|value| value.write(to));
    }

    fn read(from: &mut CdrReader<'_>) -> Result<Self, CdrError> {
        let mut values = [T::default(); N];
        for value in &mut values {
            *value = T::read(from)?;
        }
        Ok(values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_aligned_from_the_end_of_the_encapsulation() {
        let mut to = CdrWriter { bytes: CDR_LE.to_vec(), origin: CDR_LE.len() };
        7_u8.write(&mut to);
        1.5_f64.write(&mut to);
        "ab".to_owned().write(&mut to);
        vec![3_u16, 4].write(&mut to);
        let bytes = to.into_bytes();
        let expected = [
            &[0, 1, 0, 0, 7, 0, 0, 0, 0, 0, 0, 0][..],
            &1.5_f64.to_le_bytes(),
            &[3, 0, 0, 0, b'a', b'b', 0, 0, 2, 0, 0, 0, 3, 0, 4, 0],
        ];
        assert_eq!(bytes, expected.concat());
        let mut from = CdrReader::of_payload(&bytes).unwrap();
        assert_eq!(u8::read(&mut from), Ok(7));
        assert_eq!(f64::read(&mut from), Ok(1.5));
        assert_eq!(String::read(&mut from).as_deref(), Ok("ab"));
        assert_eq!(Vec::<u16>::read(&mut from), Ok(vec![3, 4]));
        assert_eq!(from.rest(), b"");
    }

    #[test]
    fn big_endian_and_version_2_are_read() {
        let big = [&[0, 0, 0, 0, 0, 0, 0, 9, 0, 0, 0, 0][..], &2.5_f64.to_be_bytes()[4..], &[0; 0]].concat();
        let mut from = CdrReader::of_payload(&big).unwrap();
        assert_eq!(u32::read(&mut from), Ok(9));
        let second = [&[0, 7, 0, 0, 9, 0, 0, 0][..], &2.5_f64.to_le_bytes()].concat();
        let mut from = CdrReader::of_payload(&second).unwrap();
        assert_eq!((u32::read(&mut from), f64::read(&mut from)), (Ok(9), Ok(2.5)), "aligned to four");
        assert_eq!(CdrReader::of_payload(&[0, 9, 0, 0]).unwrap_err(), CdrError::Representation(9));
    }

    #[test]
    fn ros_1_values_are_unaligned_and_strings_unterminated() {
        let bytes = [&[7, 2, 0, 0, 0, b'a', b'b'][..], &1.5_f64.to_le_bytes(), &[0; 4]].concat();
        let mut from = CdrReader::packed(&bytes);
        assert_eq!((u8::read(&mut from), String::read(&mut from)), (Ok(7), Ok("ab".into())));
        assert_eq!((f64::read(&mut from), String::read(&mut from)), (Ok(1.5), Ok(String::new())));
        assert!(u8::read(&mut from).is_err());
    }

    #[test]
    fn cut_or_invalid_values_are_refused_without_allocation() {
        let whole = vec!["abc".to_owned(), "d".to_owned()].payload();
        assert!(Vec::<String>::of_payload(&whole).is_ok());
        for cut in 0..whole.len() {
            assert!(Vec::<String>::of_payload(&whole[..cut]).is_err(), "{cut}");
        }
        let huge = [&CDR_LE[..], &u32::MAX.to_le_bytes(), &[0; 8]].concat();
        assert!(matches!(Vec::<f64>::of_payload(&huge), Err(CdrError::Short { .. })));
        assert!(matches!(String::of_payload(&huge), Err(CdrError::Short { .. })));
        let no_end = [&CDR_LE[..], &2_u32.to_le_bytes(), b"ab"].concat();
        assert_eq!(String::of_payload(&no_end), Err(CdrError::NoText(4)));
    }
}
