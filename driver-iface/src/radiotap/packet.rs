//! A checked view of a radiotap header, and the walk over its fields.

use super::{Error, FIELDS, MIN_LEN, Repr, bit, field};
use byteorder::{ByteOrder, LittleEndian};

/// A radiotap header and the frame after it, checked.
#[derive(Clone, Copy, Debug)]
pub struct Packet<T: AsRef<[u8]>> {
    buffer: T,
    header_len: usize,
}

impl<T: AsRef<[u8]>> Packet<T> {
    /// Checks version, length and presence words. Fields are checked by [`Repr::parse`].
    ///
    /// # Errors
    /// [`Error`] with the failed check.
    pub fn new_checked(buffer: T) -> Result<Self, Error> {
        let bytes = buffer.as_ref();
        let cut = |expect| Error::Length { expect, got: bytes.len() };
        let (Some(&version), Some(len)) = (bytes.get(field::VERSION), bytes.get(field::LEN..field::LEN + 2)) else {
            return Err(cut(MIN_LEN));
        };
        if version != 0 {
            return Err(Error::Version(version));
        }
        let len = LittleEndian::read_u16(len);
        let header_len = usize::from(len);
        if header_len < MIN_LEN {
            return Err(Error::HeaderLength(len));
        }
        let header = bytes.get(..header_len).ok_or(cut(header_len))?;
        fields_start(header)?;
        Ok(Self { buffer, header_len })
    }

    /// Length of the header, bytes.
    #[must_use]
    pub fn header_len(&self) -> usize {
        self.header_len
    }

    /// The header.
    pub(super) fn header(&self) -> &[u8] {
        self.buffer.as_ref().get(..self.header_len).unwrap_or(&[])
    }

    /// Everything after the header, with the FCS if there is one.
    #[must_use]
    pub fn payload(&self) -> &[u8] {
        self.buffer.as_ref().get(self.header_len..).unwrap_or(&[])
    }

    /// The 802.11 frame after the header, without the FCS that `repr.flags` may announce.
    ///
    /// # Errors
    /// [`Error::Length`] if an announced FCS does not fit.
    pub fn frame(&self, repr: &Repr) -> Result<&[u8], Error> {
        let payload = self.payload();
        let fcs_len = if repr.has_fcs() { 4 } else { 0 };
        let len = payload.len().checked_sub(fcs_len);
        len.and_then(|len| payload.get(..len)).ok_or(Error::Length { expect: fcs_len, got: payload.len() })
    }
}

fn present_word(header: &[u8], number: usize) -> Result<u32, Error> {
    let at = field::PRESENT + 4 * number;
    let word = header.get(at..at + 4).map(LittleEndian::read_u32);
    word.ok_or(Error::Length { expect: at + 4, got: header.len() })
}

/// Offset of the first field: after the last presence word.
fn fields_start(header: &[u8]) -> Result<usize, Error> {
    let mut words = 0;
    loop {
        let word = present_word(header, words)?;
        words += 1;
        if word & (1 << bit::EXT) == 0 {
            return Ok(field::PRESENT + 4 * words);
        }
    }
}

/// The owner of a presence word's bits.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Namespace {
    /// Radiotap's own table, from bit 0.
    Radiotap,
    /// Radiotap's table beyond bit 31, where nothing is defined: the sizes are unknown.
    Beyond,
    /// A vendor's; its fields are skipped together.
    Vendor,
}

/// Calls `each` with the bit number and bytes of every field of the radiotap namespace.
///
/// As in Linux (`ieee80211_radiotap_iterator_next`), a field of unknown size ends the walk: nothing after it can be located.
pub(super) fn walk(header: &[u8], mut each: impl FnMut(u32, &[u8])) -> Result<(), Error> {
    let mut at = fields_start(header)?;
    let mut namespace = Namespace::Radiotap;
    for number in 0.. {
        let word = present_word(header, number)?;
        let has = |present_bit: u32| word & (1 << present_bit) != 0;
        if namespace == Namespace::Beyond && word & ((1 << bit::RADIOTAP_NAMESPACE) - 1) != 0 {
            return Ok(());
        }
        for (present_bit, &(align, size)) in (0u32..).zip(&FIELDS) {
            if namespace != Namespace::Radiotap || !has(present_bit) {
                continue;
            }
            at = at.next_multiple_of(align);
            let bytes = header.get(at..at + size);
            each(present_bit, bytes.ok_or(Error::Length { expect: at + size, got: header.len() })?);
            at += size;
        }
        if namespace == Namespace::Radiotap && has(bit::TLV) {
            return Ok(());
        }
        if has(bit::VENDOR_NAMESPACE) {
            at = after_vendor_fields(header, at)?;
        }
        if !has(bit::EXT) {
            return Ok(());
        }
        namespace = match (has(bit::RADIOTAP_NAMESPACE), has(bit::VENDOR_NAMESPACE), namespace) {
            (true, _, _) => Namespace::Radiotap,
            (_, true, _) | (_, _, Namespace::Vendor) => Namespace::Vendor,
            _ => Namespace::Beyond,
        };
    }
    Ok(())
}

/// The vendor namespace field: OUI (3), sub-namespace (1), u16 length of the vendor's fields, aligned to 2.
fn after_vendor_fields(header: &[u8], at: usize) -> Result<usize, Error> {
    let at = at.next_multiple_of(2);
    let cut = |expect| Error::Length { expect, got: header.len() };
    let skip = header.get(at + 4..at + 6).map(LittleEndian::read_u16).ok_or(cut(at + 6))?;
    let end = at + 6 + usize::from(skip);
    if end > header.len() { Err(cut(end)) } else { Ok(end) }
}
