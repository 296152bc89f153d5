//! The 0xBB record: beamforming feedback, the CSI of one received frame.
//!
//! Three layouts exist. The stock csitool driver writes a 20-byte header and the packed CSI. The WSR driver of 2021 puts 14
//! bytes between them (host time, sender), later ones 18 (a frame number, too). `len` is the number of CSI bytes in every
//! layout, so the lengths distinguish them: `body - 20 - len` is 0, 14 or 18.
//!
//! Bytes after the CSI are separate ([`Bfee::behind_csi`]), because other readers ignore them: netlink pads a datagram to four
//! bytes, and a logger may write the padding. The zero bits between the samples identify such a body.
//!
//! The CSI is a bit stream, least significant bit first. Each of 30 subcarriers has 3 bits that are not CSI (the SNR field of 802.11n
//! 7.3.1.28, always 0), then `n_rx n_tx` samples of 8 bits real and 8 bits imaginary, two's complement, tx fastest. Trailing bits are 0.
//!
//! Field offsets are those of `struct iwl_bfee_notif` (csitool `netlink/bfee.h`; WSR `dvm/commands.h`), little-endian.

use crate::{EmitError, Mac, array, put, room};
use byteorder::{ByteOrder, LittleEndian};
use core::fmt;

/// Subcarriers that the card reports, whatever the bandwidth (802.11n-2009 7.3.1.28: Ng = 2 at 20 MHz, 4 at 40 MHz).
pub const SUBCARRIERS: usize = 30;
/// Bytes before the CSI in the stock layout.
pub const STOCK_HEADER: usize = 20;
/// Bytes that the WSR driver adds after the stock header.
pub(crate) const WSR_EXTRA: usize = 18;
/// Bytes that the WSR driver of 2021 adds after the stock header: without the frame number.
pub(crate) const WSR_2021_EXTRA: usize = 14;
/// Bytes before the CSI in the WSR layout of 2021.
pub(crate) const WSR_2021_HEADER: usize = STOCK_HEADER + WSR_2021_EXTRA;
/// Bytes before the CSI in the WSR layout.
pub const WSR_HEADER: usize = STOCK_HEADER + WSR_EXTRA;
/// The longest body: WSR header and 3x3 CSI.
pub const MAX_BODY: usize = WSR_HEADER + 552;
/// Value of `noise` if the driver has no measurement (IWL_NOISE_MEAS_NOT_AVAILABLE): always the case without beacons.
pub const NOISE_UNKNOWN_DBM: i8 = -127;

/// Offsets of the fields in the body (without the code byte). In a `.dat` log add 3, in a datagram 37. At 0 is the card's clock (u32,
/// microseconds). WSR layouts also have the microseconds of the host's time (u32) at 24 and the sender's address (6 bytes) at 28; the layout
/// of 2023 has the frame number (u32) at 34.
pub mod offset {
    /// u16, wraps.
    pub const BFEE_COUNT: usize = 4;
    /// u16, firmware leftovers.
    pub(crate) const RESERVED: usize = 6;
    /// u8, 1 to 3.
    pub const N_RX: usize = 8;
    /// u8, 1 to 3.
    pub const N_TX: usize = 9;
    /// u8 each for antennas A, B, C.
    pub const RSSI: usize = 10;
    /// i8, dBm.
    pub(crate) const NOISE: usize = 13;
    /// u8, dB.
    pub(crate) const AGC: usize = 14;
    /// u8, three 2-bit antenna numbers.
    pub const ANTENNA_SEL: usize = 15;
    /// u16, bytes of packed CSI.
    pub const LEN: usize = 16;
    /// u16.
    pub(crate) const RATE_N_FLAGS: usize = 18;
    /// u32, WSR layouts only.
    pub const TV_SEC: usize = 20;
}

/// Bits of [`Bfee::rate_n_flags`] (`dvm/commands.h`, RATE_MCS_*); the driver keeps the low 14.
pub mod rate {
    /// HT frame; always set if there is CSI.
    pub const HT: u16 = 0x0100;
    /// CCK.
    pub const CCK: u16 = 0x0200;
    /// Greenfield preamble.
    pub const GREENFIELD: u16 = 0x0400;
    /// 40 MHz wide.
    pub const HT40: u16 = 0x0800;
    /// Duplicate of a 20 MHz frame on both halves.
    pub const DUPLICATE: u16 = 0x1000;
    /// Short guard interval.
    pub const SHORT_GI: u16 = 0x2000;
}

/// Bytes of packed CSI for `n_rx` by `n_tx` chains: 30 groups of 3 + 16 n bits, rounded up (`60 n + 12`).
#[must_use]
pub const fn csi_len(n_rx: u8, n_tx: u8) -> usize {
    60 * n_rx as usize * n_tx as usize + 12
}

/// The driver that wrote the record.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Layout {
    /// csitool: 20-byte header.
    Stock,
    /// WSR of 2021: 34-byte header with host time and sender.
    Wsr2021,
    /// WSR: 38-byte header with host time, sender and frame number.
    Wsr,
}

impl Layout {
    /// Bytes before the CSI.
    #[must_use]
    pub const fn header_len(self) -> usize {
        match self {
            Self::Stock => STOCK_HEADER,
            Self::Wsr2021 => WSR_2021_HEADER,
            Self::Wsr => WSR_HEADER,
        }
    }
}

/// Fields that the WSR driver adds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Wsr {
    /// Host wall clock when the record was handled, seconds; steps when the clock is set.
    pub tv_sec: u32,
    /// Microseconds of it.
    pub tv_usec: u32,
    /// Address 3 of the last good frame: its sender.
    ///
    /// The driver clears it if `frame_count` is 0, so zero with count 0 means "unknown". After a frame with a bad checksum both
    /// still show the previous frame.
    pub mac: Mac,
    /// The four bytes after the 802.11 header, read big-endian: the sounding counter, or anything in foreign frames. `None` in the
    /// layout of 2021.
    pub frame_count: Option<u32>,
}

impl Wsr {
    /// The fields at a time of the host's wall clock, microseconds since the Unix epoch.
    #[must_use]
    pub const fn at(host_us: i64, mac: Mac, frame_count: Option<u32>) -> Self {
        let (tv_sec, tv_usec) = (host_us.div_euclid(1_000_000) as u32, host_us.rem_euclid(1_000_000) as u32);
        Self { tv_sec, tv_usec, mac, frame_count }
    }

    /// False when the driver did not know the sender ([`Wsr::mac`]).
    #[must_use]
    pub fn sender_known(&self) -> bool {
        !(self.mac.is_zero() && self.frame_count.is_none_or(|number| number == 0))
    }
}

/// Why a body is not a bfee.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Error {
    /// Shorter than the header.
    Short {
        /// Bytes of the body.
        got: usize,
    },
    /// `n_rx` or `n_tx` is not 1 to 3.
    Chains {
        /// Receive chains as read.
        n_rx: u8,
        /// Space-time streams as read.
        n_tx: u8,
    },
    /// `len` does not match the chains.
    CsiLength {
        /// `60 n_rx n_tx + 12`.
        expect: usize,
        /// The field as read.
        got: usize,
    },
    /// The body is too short for its CSI, or longer than in any layout.
    BodyLength {
        /// Bytes of CSI.
        csi: usize,
        /// Bytes of the body.
        got: usize,
    },
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Short { got } => write!(f, "bfee of {got} bytes, its header needs {STOCK_HEADER}"),
            Self::Chains { n_rx, n_tx } => write!(f, "bfee with n_rx {n_rx}, n_tx {n_tx}; both must be 1 to 3"),
            Self::CsiLength { expect, got } => write!(f, "bfee says {got} bytes of CSI, its chains need {expect}"),
            Self::BodyLength { csi, got } => write!(
                f,
                "bfee of {got} bytes with {csi} of CSI: neither stock ({}) nor WSR ({}, or {} as in 2021)",
                csi + STOCK_HEADER,
                csi + WSR_HEADER,
                csi + WSR_2021_HEADER
            ),
        }
    }
}

impl core::error::Error for Error {}

/// A checked view of a bfee body.
///
/// CSI indices are `subcarrier` 0 to 29, `rx` the raw chain (not the antenna, see [`Bfee::antennas`]), `tx` the space-time
/// stream; in the payload tx varies fastest, then rx, then the subcarrier.
#[derive(Clone, Copy, Debug)]
pub struct Bfee<'a> {
    head: &'a [u8; STOCK_HEADER],
    extra: &'a [u8],
    payload: &'a [u8],
    behind: &'a [u8],
}

/// Checks the header against the length of a body that ends with its CSI.
#[inline]
pub(crate) fn check(head: &[u8; STOCK_HEADER], body_len: usize) -> Result<Layout, Error> {
    let [n_rx, n_tx] = [head[offset::N_RX], head[offset::N_TX]];
    if !(1..=3).contains(&n_rx) || !(1..=3).contains(&n_tx) {
        return Err(Error::Chains { n_rx, n_tx });
    }
    let expect = csi_len(n_rx, n_tx);
    let got = usize::from(u16::from_le_bytes([head[offset::LEN], head[offset::LEN + 1]]));
    if got != expect {
        return Err(Error::CsiLength { expect, got });
    }
    match body_len.checked_sub(expect) {
        Some(STOCK_HEADER) => Ok(Layout::Stock),
        Some(WSR_2021_HEADER) => Ok(Layout::Wsr2021),
        Some(WSR_HEADER) => Ok(Layout::Wsr),
        _ => Err(Error::BodyLength { csi: expect, got: body_len }),
    }
}

impl<'a> Bfee<'a> {
    /// Checks a body (without the code byte). It may continue after its CSI, see [`Bfee::behind_csi`].
    ///
    /// # Errors
    /// If the body is too short, the chains are not 1 to 3, or the lengths disagree.
    pub fn new_checked(body: &'a [u8]) -> Result<Self, Error> {
        let short = Error::Short { got: body.len() };
        let (head, rest) = body.split_first_chunk::<STOCK_HEADER>().ok_or(short)?;
        match check(head, body.len()) {
            Ok(layout) => {
                let (extra, payload) = rest.split_at_checked(layout.header_len() - STOCK_HEADER).ok_or(short)?;
                Ok(Self { head, extra, payload, behind: &[] })
            }
            Err(error @ Error::BodyLength { csi, .. }) => Self::longer(head, rest, csi).ok_or(error),
            Err(error) => Err(error),
        }
    }

    /// A body that continues after its CSI: the first layout that fits and in which the bits between the samples are 0, or stock, as
    /// csitool's readers assume.
    #[cold]
    fn longer(head: &'a [u8; STOCK_HEADER], rest: &'a [u8], csi: usize) -> Option<Self> {
        let as_layout = |layout: Layout| {
            let (extra, rest) = rest.split_at_checked(layout.header_len() - STOCK_HEADER)?;
            let (payload, behind) = rest.split_at_checked(csi)?;
            Some(Self { head, extra, payload, behind })
        };
        let layouts = [Layout::Stock, Layout::Wsr2021, Layout::Wsr];
        layouts.into_iter().filter_map(as_layout).find(Self::gaps_are_clear).or_else(|| as_layout(Layout::Stock))
    }

    fn u16_at(&self, at: usize) -> u16 {
        u16::from_le_bytes(array(self.head, at))
    }

    /// The driver that wrote it.
    #[must_use]
    pub fn layout(&self) -> Layout {
        match self.extra.len() {
            WSR_EXTRA => Layout::Wsr,
            WSR_2021_EXTRA => Layout::Wsr2021,
            _ => Layout::Stock,
        }
    }

    /// Low 32 bits of the card's 1 MHz clock when the frame began, microseconds; wraps every 4,294.967296 s.
    #[must_use]
    pub fn timestamp_low(&self) -> u32 {
        LittleEndian::read_u32(self.head)
    }

    /// The driver's record counter; wraps after 65,535.
    #[must_use]
    pub fn bfee_count(&self) -> u16 {
        self.u16_at(offset::BFEE_COUNT)
    }

    /// Reserved by the firmware; 0 in all known captures.
    #[must_use]
    pub fn reserved(&self) -> u16 {
        self.u16_at(offset::RESERVED)
    }

    /// Receive chains used, 1 to 3.
    #[must_use]
    #[doc(alias = "Nrx")]
    pub fn n_rx(&self) -> usize {
        usize::from(self.head[offset::N_RX])
    }

    /// Space-time streams, 1 to 3 (not transmit antennas).
    #[must_use]
    #[doc(alias = "Ntx")]
    pub fn n_tx(&self) -> usize {
        usize::from(self.head[offset::N_TX])
    }

    /// RSSI of antennas A, B, C in dB above an internal reference; 0 for an unused antenna. Never permuted.
    #[must_use]
    pub fn rssi(&self) -> [u8; 3] {
        array(self.head, offset::RSSI)
    }

    /// Noise floor in dBm, or [`NOISE_UNKNOWN_DBM`].
    #[must_use]
    pub fn noise_dbm(&self) -> i8 {
        self.head[offset::NOISE].cast_signed()
    }

    /// Receiver gain, dB.
    #[must_use]
    pub fn agc(&self) -> u8 {
        self.head[offset::AGC]
    }

    /// The antenna of each chain, packed; [`Bfee::antennas`] decodes it.
    #[must_use]
    pub fn antenna_sel(&self) -> u8 {
        self.head[offset::ANTENNA_SEL]
    }

    /// Rate and flags of the frame, see [`rate`].
    #[must_use]
    #[doc(alias = "fake_rate_n_flags")]
    pub fn rate_n_flags(&self) -> u16 {
        self.u16_at(offset::RATE_N_FLAGS)
    }

    /// True for a 40 MHz frame.
    #[must_use]
    pub fn is_40_mhz(&self) -> bool {
        self.rate_n_flags() & rate::HT40 != 0
    }

    /// Host time, sender and frame number, in the WSR layouts.
    #[must_use]
    #[inline]
    pub fn wsr(&self) -> Option<Wsr> {
        let (host_and_sender, number) = self.extra.split_first_chunk::<WSR_2021_EXTRA>()?;
        let [s0, s1, s2, s3, u0, u1, u2, u3, m0, m1, m2, m3, m4, m5] = *host_and_sender;
        Some(Wsr {
            tv_sec: u32::from_le_bytes([s0, s1, s2, s3]),
            tv_usec: u32::from_le_bytes([u0, u1, u2, u3]),
            mac: Mac([m0, m1, m2, m3, m4, m5]),
            frame_count: number.first_chunk().map(|number| u32::from_le_bytes(*number)),
        })
    }

    /// The packed CSI, `60 n_rx n_tx + 12` bytes.
    #[must_use]
    pub fn payload(&self) -> &'a [u8] {
        self.payload
    }

    /// Bytes after the CSI: none as a driver writes it, padding if a logger wrote whole datagrams.
    #[must_use]
    pub fn behind_csi(&self) -> &'a [u8] {
        self.behind
    }

    /// The antenna of each raw chain.
    ///
    /// # Errors
    /// [`InvalidPerm`], see [`Antennas::new`].
    #[inline]
    pub fn antennas(&self) -> Result<Antennas, InvalidPerm> {
        Antennas::new(self.antenna_sel(), self.head[offset::N_RX], self.rssi())
    }

    /// The raw chain of an antenna; `None` if it was not used or the permutation is invalid.
    #[must_use]
    #[inline]
    pub fn chain_of(&self, antenna: Antenna) -> Option<usize> {
        self.antennas().ok()?.chain_of(antenna)
    }
}

/// A receive antenna port of the card.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Antenna {
    /// Port A.
    A,
    /// Port B.
    B,
    /// Port C.
    C,
}

impl Antenna {
    /// A, B, C.
    pub const ALL: [Self; 3] = [Self::A, Self::B, Self::C];

    /// 0, 1, 2 for A, B, C.
    #[must_use]
    pub const fn index(self) -> usize {
        self as usize
    }

    fn from_bits(bits: u8) -> Option<Self> {
        Self::ALL.get(usize::from(bits)).copied()
    }
}

impl fmt::Display for Antenna {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::A => "A",
            Self::B => "B",
            Self::C => "C",
        })
    }
}

/// The antenna of each raw receive chain, for one record.
///
/// Raw chain `k` holds the signal of antenna `antennas()[k]`: `by_antenna[perm[k]] = raw[k]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Antennas {
    of_chain: [Antenna; 3],
    n_rx: u8,
}

impl Antennas {
    /// Reads `antenna_sel` for `n_rx` chains, 1 to 3.
    ///
    /// With three chains it must be a permutation; with two, the first two must differ. With one chain whose number is 3 (no
    /// antenna), it is the only antenna with a nonzero RSSI, if there is exactly one.
    ///
    /// # Errors
    /// [`InvalidPerm`] if the bits name no antenna, or one twice. Nothing is guessed.
    #[inline]
    pub fn new(antenna_sel: u8, n_rx: u8, rssi: [u8; 3]) -> Result<Self, InvalidPerm> {
        let invalid = InvalidPerm { antenna_sel, n_rx };
        if n_rx == 3 {
            let of_chain = OF_THREE.get(usize::from(antenna_sel & 63)).copied().flatten().ok_or(invalid)?;
            return Ok(Self { of_chain, n_rx });
        }
        let [a, b] = [0, 2].map(|shift| Antenna::from_bits(antenna_sel >> shift & 3));
        let of_chain = match n_rx {
            1 => {
                let only = a.or_else(|| only_heard(rssi)).ok_or(invalid)?;
                [only; 3]
            }
            2 => {
                let (a, b) = a.zip(b).filter(|(a, b)| a != b).ok_or(invalid)?;
                [a, b, b]
            }
            _ => return Err(invalid),
        };
        Ok(Self { of_chain, n_rx })
    }

    /// The antennas in chain order, one per chain.
    #[must_use]
    pub fn as_slice(&self) -> &[Antenna] {
        self.of_chain.get(..usize::from(self.n_rx)).unwrap_or(&self.of_chain)
    }

    /// The raw chain that was connected to `antenna`, if any.
    #[must_use]
    #[inline]
    pub fn chain_of(&self, antenna: Antenna) -> Option<usize> {
        self.as_slice().iter().position(|&a| a == antenna)
    }
}

/// The antennas of three chains, by the low six bits of `antenna_sel`: all permutations.
static OF_THREE: [Option<[Antenna; 3]>; 64] = {
    let mut table = [None; 64];
    let mut first = 0;
    while first < 3 {
        let mut second = 0;
        while second < 3 {
            if first != second {
                let third = 3 - first - second;
                table[first | second << 2 | third << 4] =
                    Some([Antenna::ALL[first], Antenna::ALL[second], Antenna::ALL[third]]);
            }
            second += 1;
        }
        first += 1;
    }
    table
};

/// The only antenna with a nonzero RSSI.
fn only_heard(rssi: [u8; 3]) -> Option<Antenna> {
    let mut heard = Antenna::ALL.into_iter().zip(rssi).filter(|&(_, rssi)| rssi != 0);
    let (antenna, _) = heard.next()?;
    heard.next().is_none().then_some(antenna)
}

/// An `antenna_sel` that does not assign the antennas.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InvalidPerm {
    /// The byte as read.
    pub antenna_sel: u8,
    /// Chains used.
    pub n_rx: u8,
}

impl fmt::Display for InvalidPerm {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [a, b, c] = [0, 2, 4].map(|shift| self.antenna_sel >> shift & 3);
        write!(
            f,
            "antenna_sel {:#04x} maps {} receive chains to antennas {a}, {b}, {c}: no permutation",
            self.antenna_sel, self.n_rx
        )
    }
}

impl core::error::Error for InvalidPerm {}

/// All header fields of a bfee; [`Repr::emit`] gets the CSI separately.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Repr {
    /// See [`Bfee::timestamp_low`], microseconds.
    pub timestamp_low: u32,
    /// See [`Bfee::bfee_count`].
    pub bfee_count: u16,
    /// See [`Bfee::reserved`].
    pub reserved: u16,
    /// Receive chains, 1 to 3.
    pub n_rx: u8,
    /// Space-time streams, 1 to 3.
    pub n_tx: u8,
    /// RSSI of antennas A, B, C in dB; 0 if unused.
    pub rssi: [u8; 3],
    /// Noise floor in dBm.
    pub noise_dbm: i8,
    /// Receiver gain, dB.
    pub agc: u8,
    /// Antennas of the chains, packed.
    pub antenna_sel: u8,
    /// Rate and flags.
    pub rate_n_flags: u16,
    /// Fields that the WSR driver adds: `None` writes the stock layout, a missing frame number that of 2021.
    pub wsr: Option<Wsr>,
}

impl Default for Repr {
    /// One stream received on three chains in antenna order, MCS 1 at 20 MHz, noise unknown, stock layout.
    fn default() -> Self {
        Self {
            timestamp_low: 0,
            bfee_count: 0,
            reserved: 0,
            n_rx: 3,
            n_tx: 1,
            rssi: [30; 3],
            noise_dbm: NOISE_UNKNOWN_DBM,
            agc: 40,
            antenna_sel: 0x24,
            rate_n_flags: 0x101,
            wsr: None,
        }
    }
}

impl Repr {
    /// The header fields of a record.
    #[must_use]
    #[inline]
    pub fn parse(bfee: &Bfee<'_>) -> Self {
        Self {
            timestamp_low: bfee.timestamp_low(),
            bfee_count: bfee.bfee_count(),
            reserved: bfee.reserved(),
            n_rx: bfee.n_rx() as u8,
            n_tx: bfee.n_tx() as u8,
            rssi: bfee.rssi(),
            noise_dbm: bfee.noise_dbm(),
            agc: bfee.agc(),
            antenna_sel: bfee.antenna_sel(),
            rate_n_flags: bfee.rate_n_flags(),
            wsr: bfee.wsr(),
        }
    }

    /// Number of its CSI samples, `30 n_rx n_tx`.
    #[must_use]
    pub fn samples(&self) -> usize {
        SUBCARRIERS * usize::from(self.n_rx) * usize::from(self.n_tx)
    }

    /// The layout that [`Repr::emit`] writes.
    #[must_use]
    pub fn layout(&self) -> Layout {
        match self.wsr {
            None => Layout::Stock,
            Some(Wsr { frame_count: None, .. }) => Layout::Wsr2021,
            Some(_) => Layout::Wsr,
        }
    }

    /// Bytes of the body, without the code.
    #[must_use]
    pub fn body_len(&self) -> usize {
        csi_len(self.n_rx, self.n_tx) + self.layout().header_len()
    }

    /// Writes the body (without the code): header, then `csi` packed, `[subcarrier][raw rx chain][tx]`.
    ///
    /// Returns the number of bytes written, [`Repr::body_len`].
    ///
    /// # Errors
    /// If chains are not 1 to 3, `csi` is not `30 n_rx n_tx` long, or `out` is too short.
    pub fn emit(&self, csi: &[Iq], out: &mut [u8]) -> Result<usize, EmitError> {
        for (name, got) in [("n_rx", self.n_rx), ("n_tx", self.n_tx)] {
            if !(1..=3).contains(&got) {
                return Err(EmitError::Field { name, got: got.into(), max: 3 });
            }
        }
        if csi.len() != self.samples() {
            return Err(EmitError::Samples { expect: self.samples(), got: csi.len() });
        }
        let out = room(out, self.body_len())?;
        let (header, payload) = out.split_at_mut(self.body_len() - csi_len(self.n_rx, self.n_tx));
        self.emit_header(header);
        pack(csi, usize::from(self.n_rx) * usize::from(self.n_tx), payload);
        Ok(self.body_len())
    }

    /// Writes the bytes before the CSI.
    pub(crate) fn emit_header(&self, out: &mut [u8]) {
        let Some((out, extra)) = out.split_first_chunk_mut::<STOCK_HEADER>() else { return };
        LittleEndian::write_u32(out, self.timestamp_low);
        LittleEndian::write_u16(&mut out[offset::BFEE_COUNT..], self.bfee_count);
        LittleEndian::write_u16(&mut out[offset::RESERVED..], self.reserved);
        out[offset::N_RX] = self.n_rx;
        out[offset::N_TX] = self.n_tx;
        put(out, offset::RSSI, &self.rssi);
        out[offset::NOISE] = self.noise_dbm.cast_unsigned();
        out[offset::AGC] = self.agc;
        out[offset::ANTENNA_SEL] = self.antenna_sel;
        LittleEndian::write_u16(&mut out[offset::LEN..], csi_len(self.n_rx, self.n_tx) as u16);
        LittleEndian::write_u16(&mut out[offset::RATE_N_FLAGS..], self.rate_n_flags);
        if let Some(wsr) = &self.wsr {
            let fields = wsr.tv_sec.to_le_bytes().into_iter().chain(wsr.tv_usec.to_le_bytes());
            let fields = fields.chain(wsr.mac.0).chain(wsr.frame_count.unwrap_or(0).to_le_bytes());
            extra.iter_mut().zip(fields).for_each(|(byte, field)| *byte = field);
        }
    }
}

/// Packs samples, `n` per subcarrier, as a bit stream.
fn pack(csi: &[Iq], n: usize, out: &mut [u8]) {
    let mut out = out.iter_mut();
    let (mut pending, mut bits) = (0_u32, 0);
    let mut put = |value: u32, width: u32| {
        pending |= value << bits;
        bits += width;
        while bits >= 8 {
            if let Some(byte) = out.next() {
                *byte = pending as u8;
            }
            pending >>= 8;
            bits -= 8;
        }
    };
    for subcarrier in csi.chunks(n) {
        put(0, 3);
        for iq in subcarrier {
            put(u32::from(iq.i.cast_unsigned()), 8);
            put(u32::from(iq.q.cast_unsigned()), 8);
        }
    }
    put(0, 7);
}

/// Samples of the largest record: 30 subcarriers, 3 by 3 chains.
pub const MAX_SAMPLES: usize = SUBCARRIERS * 9;

/// Bits before the samples of each subcarrier.
const GAP: usize = 3;
/// Bytes of a load for three samples.
const WORD: usize = 8;
/// Bytes of a load for one sample.
const LOAD: usize = 4;
/// Bytes of one sample of every subcarrier, and of the rest of the last load.
const COLUMN: usize = 2 * SUBCARRIERS + LOAD;
/// Samples in one 64-bit load at any bit offset: 48 bits and at most 7 before them.
const PER_WORD: usize = 3;

/// Bytes to be widened to floats, aligned so that no wide vector straddles two cache lines.
#[repr(align(64))]
struct Lines<const N: usize>([u8; N]);

/// One sample as the card reports it; +-127 and -128 mean saturation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Iq {
    /// Real part.
    pub i: i8,
    /// Imaginary part.
    pub q: i8,
}

/// First bit of sample `index` (`rx n_tx + tx`) of a subcarrier that has `n` samples.
const fn bit_of(subcarrier: usize, index: usize, n: usize) -> usize {
    GAP + subcarrier * (GAP + 16 * n) + 16 * index
}

/// At least 57 bits of the payload from `bit` on, in the low bits, or zeros after its end.
///
/// Near the end the load starts earlier, so it never leaves the payload (at least 72 bytes).
#[inline(always)]
fn word_at(payload: &[u8], bit: usize) -> u64 {
    let from = (bit / 8).min(payload.len().saturating_sub(8));
    let shift = bit - 8 * from;
    let word = payload.get(from..).and_then(|rest| rest.first_chunk());
    word.map_or(0, |word| u64::from_le_bytes(*word)) >> (shift & 63)
}

/// The sample in the low 16 bits.
const fn low_iq(word: u64) -> Iq {
    Iq { i: word as i8, q: (word >> 8) as i8 }
}

/// Unpacks `N` chain pairs to bytes, one word per three samples: the last word ends after the samples. `None` if a slice is too
/// short.
#[inline(always)]
fn unpack_bytes_n<const N: usize>(payload: &[u8], bytes: &mut [u8]) -> Option<usize> {
    let payload = payload.get(..60 * N + 12)?;
    let bytes = bytes.get_mut(..60 * N + WORD)?;
    for octave in 0..3 {
        let from = octave * (GAP + 16 * N);
        let to = octave * 16 * N;
        unpack_run::<N, 8>(payload.get(from..from + GAP + 16 * N + 8)?, bytes.get_mut(to..to + 16 * N + WORD)?);
    }
    unpack_run::<N, 6>(payload.get(3 * (GAP + 16 * N)..)?, bytes.get_mut(48 * N..)?);
    Some(SUBCARRIERS * N)
}

/// Unpacks and widens `N` chain pairs; `BYTES` is `60 N` and room for one word. `None` if a slice is too short.
///
/// First to bytes, then all bytes to floats, in a loop that compilers vectorise.
#[inline(always)]
fn unpack_f32_n<const N: usize, const BYTES: usize>(payload: &[u8], out: &mut [f32]) -> Option<usize> {
    let out = out.get_mut(..2 * SUBCARRIERS * N)?;
    let mut bytes = Lines([0; BYTES]);
    unpack_bytes_n::<N>(payload, &mut bytes.0)?;
    widen(&bytes.0, out);
    Some(SUBCARRIERS * N)
}

/// Bytes of `COUNT` consecutive subcarriers, the first of which begins on a byte of `payload`; every eighth one does.
///
/// With both counts known at compile time the loop unrolls, and all offsets and shifts are constants.
#[inline(always)]
fn unpack_run<const N: usize, const COUNT: usize>(payload: &[u8], bytes: &mut [u8]) {
    for subcarrier in 0..COUNT {
        for first in (0..N).step_by(PER_WORD) {
            let word = word_at(payload, bit_of(subcarrier, first, N));
            let at = 2 * (subcarrier * N + first);
            // An array, because copying a slice may be a call.
            if let Some(place) = bytes.get_mut(at..).and_then(|rest| rest.first_chunk_mut()) {
                *place = word.to_le_bytes();
            }
        }
    }
}

/// Unpacks `N` chain pairs, with the samples of each adjacent. `None` if a slice is too short.
#[inline(always)]
fn unpack_planes_n<const N: usize>(payload: &[u8], out: &mut [[i8; 2]]) -> Option<usize> {
    let payload = payload.get(..60 * N + 12)?;
    let planes = out.as_chunks_mut::<SUBCARRIERS>().0.first_chunk_mut::<N>()?;
    for octave in 0..3 {
        let from = octave * (GAP + 16 * N);
        unpack_planes_run::<N, 8>(payload.get(from..from + GAP + 16 * N + 8)?, planes, 8 * octave);
    }
    unpack_planes_run::<N, 6>(payload.get(3 * (GAP + 16 * N)..)?, planes, 24);
    Some(SUBCARRIERS * N)
}

/// Samples of `COUNT` consecutive subcarriers from `first` on, which begins on a byte of `payload`; see [`unpack_run`].
#[inline(always)]
fn unpack_planes_run<const N: usize, const COUNT: usize>(
    payload: &[u8],
    planes: &mut [[[i8; 2]; SUBCARRIERS]; N],
    first: usize,
) {
    for subcarrier in 0..COUNT {
        for part in (0..N).step_by(PER_WORD) {
            let mut word = word_at(payload, bit_of(subcarrier, part, N));
            for plane in planes.iter_mut().skip(part).take(PER_WORD) {
                if let Some(sample) = plane.get_mut(first + subcarrier) {
                    *sample = [word as i8, (word >> 8) as i8];
                }
                word >>= 16;
            }
        }
    }
}

/// The place of a sample in the payload: the first byte of a load, and the bits before the sample in it.
#[derive(Clone, Copy)]
struct Place {
    from: u16,
    shift: u16,
}

impl Place {
    /// The place of sample `index` of the subcarrier that begins at `bit`, in a payload of `len` bytes. Near the end the load starts
    /// earlier, as in [`word_at`].
    #[inline(always)]
    const fn new(len: usize, bit: usize, index: usize) -> Self {
        let (wanted, last) = (bit / 8 + 2 * index, len.saturating_sub(LOAD));
        let from = if wanted < last { wanted } else { last };
        Self { from: from as u16, shift: (8 * (wanted - from) + bit % 8) as u16 }
    }

    /// The sample in the low half.
    #[inline(always)]
    fn load(self, payload: &[u8]) -> u32 {
        let rest = payload.get(self.from.into()..);
        rest.and_then(|rest| rest.first_chunk()).map_or(0, |word| u32::from_le_bytes(*word)) >> (self.shift & 31)
    }

    /// The two bytes of the sample.
    #[inline(always)]
    fn sample(self, payload: &[u8]) -> [u8; 2] {
        (self.load(payload) as u16).to_le_bytes()
    }
}

/// The places of `N` chain pairs' samples: for each pair, every subcarrier's.
struct Places<const N: usize>;

impl<const N: usize> Places<N> {
    const OF: &[[Place; SUBCARRIERS]; N] = &{
        let mut places = [[Place { from: 0, shift: 0 }; SUBCARRIERS]; N];
        let mut at = 0;
        while at < SUBCARRIERS * N {
            let (subcarrier, index) = (at / N, at % N);
            places[index][subcarrier] = Place::new(60 * N + 12, bit_of(subcarrier, 0, N), index);
            at += 1;
        }
        places
    };
}

/// True for all subcarriers in order. Comparing an array needs no call.
#[inline(always)]
fn is_whole(subcarriers: &[u8]) -> bool {
    <&[u8; SUBCARRIERS]>::try_from(subcarriers).is_ok_and(|numbers| *numbers == ALL_SUBCARRIERS)
}

/// True if all numbers are subcarrier indices; checks eight at once, and skips a whole column's.
#[inline(always)]
fn are_subcarriers(numbers: &[u8]) -> bool {
    let outside = |numbers: &[u8]| numbers.iter().fold(false, |any, &s| any | (usize::from(s) >= SUBCARRIERS));
    let (eights, rest) = numbers.as_chunks::<8>();
    is_whole(numbers) || !eights.iter().fold(outside(rest), |any, eight| any | outside(eight))
}

/// One sample of each requested subcarrier, of `N` chain pairs, widened.
#[inline(always)]
fn column_f32_n<const N: usize>(payload: &[u8], index: usize, subcarriers: &[u8], out: &mut [[f32; 2]]) -> Option<()> {
    let payload = payload.get(..60 * N + 12)?;
    if let Ok(out) = out.try_into()
        && is_whole(subcarriers)
    {
        return column_f32_all::<N>(payload, index, out);
    }
    let places = Places::<N>::OF.get(index)?;
    let sample = |subcarrier: u8| places.get(usize::from(subcarrier)).map_or([0; 2], |place| place.sample(payload));
    let (fours, rest) = subcarriers.as_chunks::<4>();
    let (out_fours, out_rest) = out.split_at_mut(4 * fours.len());
    for (out, four) in out_fours.as_chunks_mut::<4>().0.iter_mut().zip(fours) {
        // Combined in a register: through memory the wide load would wait for the narrow stores.
        let word = four.iter().rev().fold(0, |word, &s| word << 16 | u64::from(u16::from_le_bytes(sample(s))));
        widen(&word.to_le_bytes(), out.as_flattened_mut());
    }
    for (out, &subcarrier) in out_rest.iter_mut().zip(rest) {
        widen(&sample(subcarrier), out);
    }
    Some(())
}

/// One sample of every subcarrier: gathered first, so that widening vectorises.
#[inline(always)]
fn column_f32_all<const N: usize>(payload: &[u8], index: usize, out: &mut [[f32; 2]; SUBCARRIERS]) -> Option<()> {
    widen(&gather::<N>(payload, index)?.0, out.as_flattened_mut());
    Some(())
}

/// The bytes of one sample of every subcarrier.
#[inline(always)]
fn gather<const N: usize>(payload: &[u8], index: usize) -> Option<Lines<COLUMN>> {
    let payload = payload.get(..60 * N + 12)?;
    let mut bytes = Lines([0; COLUMN]);
    for octave in 0..3 {
        let from = octave * (GAP + 16 * N) + 2 * index;
        gather_run::<N, 8>(payload.get(from..from + 14 * N + 6)?, bytes.0.get_mut(16 * octave..)?);
    }
    let from = 3 * (GAP + 16 * N) + 2 * index;
    gather_run::<N, 6>(payload.get(from..from + 10 * N + 5)?, bytes.0.get_mut(48..)?);
    Some(bytes)
}

/// One sample of each of `COUNT` consecutive subcarriers, the first of which begins on a byte of `payload`, as every eighth one
/// does: all offsets are constants. Each is written with the rest of its load, which the next one overwrites.
#[inline(always)]
fn gather_run<const N: usize, const COUNT: usize>(payload: &[u8], bytes: &mut [u8]) {
    for subcarrier in 0..COUNT {
        let place = bytes.get_mut(2 * subcarrier..).and_then(|rest| rest.first_chunk_mut());
        if let Some(place) = place {
            *place = Place::new(payload.len(), bit_of(subcarrier, 0, N), 0).load(payload).to_le_bytes();
        }
    }
}

/// Bytes to floats, as many as the shorter slice has.
#[inline(always)]
fn widen(bytes: &[u8], out: &mut [f32]) {
    for (value, &byte) in out.iter_mut().zip(bytes) {
        *value = f32::from(byte.cast_signed());
    }
}

/// All subcarriers, in order: the argument of [`Bfee::column_f32`] for a whole column.
#[rustfmt::skip]
pub const ALL_SUBCARRIERS: [u8; SUBCARRIERS] = [
    0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29,
];

/// `$unpack` with the number of chain pairs of `$bfee` as the constant `$n`.
macro_rules! by_pairs {
    ($bfee:ident, $n:ident => $unpack:expr) => {
        match $bfee.n_rx() * $bfee.n_tx() {
            1 => {
                const $n: usize = 1;
                $unpack
            }
            2 => {
                const $n: usize = 2;
                $unpack
            }
            3 => {
                const $n: usize = 3;
                $unpack
            }
            4 => {
                const $n: usize = 4;
                $unpack
            }
            6 => {
                const $n: usize = 6;
                $unpack
            }
            _ => {
                const $n: usize = 9;
                $unpack
            }
        }
    };
}

impl Bfee<'_> {
    /// Number of samples in the record, `30 n_rx n_tx`.
    #[must_use]
    pub fn samples(&self) -> usize {
        SUBCARRIERS * self.n_rx() * self.n_tx()
    }

    /// One sample, or `None` if an index is out of range.
    #[must_use]
    pub fn iq(&self, subcarrier: usize, rx: usize, tx: usize) -> Option<Iq> {
        let inside = subcarrier < SUBCARRIERS && rx < self.n_rx() && tx < self.n_tx();
        let n = self.n_rx() * self.n_tx();
        inside.then(|| low_iq(word_at(self.payload(), bit_of(subcarrier, rx * self.n_tx() + tx, n))))
    }

    /// Unpacks everything bit by bit: slow, obvious, and the oracle of the fast ways.
    ///
    /// Writes `[subcarrier][rx][tx]` to `out` and returns the number of samples; `None` if `out` is too short.
    pub fn unpack_bits(&self, out: &mut [Iq]) -> Option<usize> {
        let payload = self.payload();
        let bit = |at: usize| payload.get(at / 8).map_or(0, |byte| byte >> (at % 8) & 1);
        let byte = |at: usize| (0..8).fold(0, |byte, k| byte | bit(at + k) << k).cast_signed();
        let n = self.n_rx() * self.n_tx();
        let out = out.get_mut(..self.samples())?;
        for (k, iq) in out.iter_mut().enumerate() {
            let at = bit_of(k / n, k % n, n);
            *iq = Iq { i: byte(at), q: byte(at + 8) };
        }
        Some(self.samples())
    }

    /// Unpacks everything with 64-bit loads, `[subcarrier][rx][tx]`; `None` if `out` is too short.
    pub fn unpack(&self, out: &mut [Iq]) -> Option<usize> {
        let n = self.n_rx() * self.n_tx();
        let out = out.get_mut(..self.samples())?;
        for (subcarrier, row) in out.chunks_exact_mut(n).enumerate() {
            for (part, samples) in row.chunks_mut(PER_WORD).enumerate() {
                let mut word = word_at(self.payload(), bit_of(subcarrier, PER_WORD * part, n));
                for iq in samples {
                    *iq = low_iq(word);
                    word >>= 16;
                }
            }
        }
        Some(self.samples())
    }

    /// Unpacks everything to `f32`, re and im alternating, `[subcarrier][rx][tx][re, im]`.
    ///
    /// Returns the number of samples (half the number of floats); `None` if `out` is too short.
    ///
    /// Inlined, like [`Bfee::column_f32`], so that callers compiled for wide vectors use those here.
    #[inline(always)]
    pub fn unpack_f32(&self, out: &mut [f32]) -> Option<usize> {
        by_pairs!(self, N => unpack_f32_n::<N, { 60 * N + WORD }>(self.payload(), out))
    }

    /// Unpacks everything, one chain pair after the other, `[rx][tx][subcarrier][i, q]`, for work antenna by antenna.
    ///
    /// Returns the number of samples; `None` if `out` is too short.
    pub fn unpack_planes(&self, out: &mut [[i8; 2]]) -> Option<usize> {
        by_pairs!(self, N => unpack_planes_n::<N>(self.payload(), out))
    }

    /// One chain pair at all subcarriers; `None` if an index is out of range.
    #[must_use]
    pub fn column(&self, rx: usize, tx: usize) -> Option<[Iq; SUBCARRIERS]> {
        let index = self.column_index(rx, tx, &[])?;
        let bytes = by_pairs!(self, N => gather::<N>(self.payload(), index))?;
        let pairs = bytes.0.as_chunks::<2>().0;
        let sample =
            |k: usize| pairs.get(k).map_or(Iq::default(), |[i, q]| Iq { i: i.cast_signed(), q: q.cast_signed() });
        Some(core::array::from_fn(sample))
    }

    /// Unpacks one chain pair at the requested subcarriers only, to `f32`, re and im alternating.
    ///
    /// Returns the number of samples; `None` if an index is out of range or `out` has less than two floats per subcarrier.
    #[inline(always)]
    pub fn column_f32(&self, rx: usize, tx: usize, subcarriers: &[u8], out: &mut [f32]) -> Option<usize> {
        let index = self.column_index(rx, tx, subcarriers)?;
        let (out, _) = out.get_mut(..2 * subcarriers.len())?.as_chunks_mut::<2>();
        by_pairs!(self, N => column_f32_n::<N>(self.payload(), index, subcarriers, out))?;
        Some(subcarriers.len())
    }

    /// True if the bits that carry no CSI are all 0, as the firmware writes them.
    ///
    /// 96 bits in all, spread over the payload: they show bytes lost or inserted before them.
    #[must_use]
    pub fn gaps_are_clear(&self) -> bool {
        let n = self.n_rx() * self.n_tx();
        let gaps = (0..SUBCARRIERS).fold(0, |all, s| all | word_at(self.payload(), bit_of(s, 0, n) - GAP) & 7);
        gaps | word_at(self.payload(), bit_of(SUBCARRIERS, 0, n) - GAP) == 0
    }

    /// Position of a chain pair among a subcarrier's samples, if it and all `subcarriers` are in range.
    #[inline]
    fn column_index(&self, rx: usize, tx: usize, subcarriers: &[u8]) -> Option<usize> {
        let inside = rx < self.n_rx() && tx < self.n_tx() && are_subcarriers(subcarriers);
        inside.then(|| rx * self.n_tx() + tx)
    }
}

#[cfg(test)]
mod tests {
    use super::{Bfee, Iq, MAX_SAMPLES, Repr, SUBCARRIERS, *};
    use crate::EmitError;
    use proptest::collection::vec;
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    pub(crate) fn any_repr() -> impl Strategy<Value = (Repr, Vec<Iq>)> {
        let wsr = proptest::option::of(
            (any::<u32>(), any::<u32>(), any::<[u8; 6]>(), any::<Option<u32>>())
                .prop_map(|(tv_sec, tv_usec, mac, frame_count)| Wsr { tv_sec, tv_usec, mac: Mac(mac), frame_count }),
        );
        let head = (any::<u32>(), any::<u16>(), any::<u16>(), 1..=3_u8, 1..=3_u8, any::<[u8; 3]>());
        let tail = (any::<i8>(), any::<u8>(), any::<u8>(), any::<u16>(), wsr);
        let repr = (head, tail).prop_map(|((t, n, r, n_rx, n_tx, rssi), (noise, agc, sel, rate, wsr))| Repr {
            timestamp_low: t,
            bfee_count: n,
            reserved: r,
            n_rx,
            n_tx,
            rssi,
            noise_dbm: noise,
            agc,
            antenna_sel: sel,
            rate_n_flags: rate,
            wsr,
        });
        repr.prop_flat_map(|repr| {
            let iq = any::<(i8, i8)>().prop_map(|(i, q)| Iq { i, q });
            (Just(repr), vec(iq, repr.samples()))
        })
    }

    fn emitted(repr: &Repr, csi: &[Iq]) -> Vec<u8> {
        let mut body = vec![0xa5; repr.body_len()];
        assert_eq!(repr.emit(csi, &mut body), Ok(body.len()));
        body
    }

    proptest! {
        #[test]
        fn emit_then_parse_is_the_identity((repr, csi) in any_repr()) {
            let body = emitted(&repr, &csi);
            let bfee = Bfee::new_checked(&body).unwrap();
            prop_assert_eq!(Repr::parse(&bfee), repr);
            prop_assert!(bfee.gaps_are_clear());
            let mut bits = vec![Iq::default(); repr.samples()];
            prop_assert_eq!(bfee.unpack_bits(&mut bits), Some(csi.len()));
            prop_assert_eq!(&bits, &csi);
        }

        #[test]
        fn fast_ways_agree_with_the_bit_loop_on_any_payload((repr, csi) in any_repr(), noise in vec(any::<u8>(), 552)) {
            let mut body = emitted(&repr, &csi);
            let header = body.len() - csi_len(repr.n_rx, repr.n_tx);
            body[header..].iter_mut().zip(noise).for_each(|(b, n)| *b = n);
            let bfee = Bfee::new_checked(&body).unwrap();
            let mut oracle = vec![Iq::default(); repr.samples()];
            bfee.unpack_bits(&mut oracle).unwrap();

            let mut words = vec![Iq::default(); repr.samples()];
            bfee.unpack(&mut words).unwrap();
            prop_assert_eq!(&words, &oracle);

            let mut floats = vec![9.0_f32; 2 * repr.samples() + 3];
            prop_assert_eq!(bfee.unpack_f32(&mut floats), Some(oracle.len()));
            let as_f32: Vec<f32> = oracle.iter().flat_map(|iq| [f32::from(iq.i), f32::from(iq.q)]).collect();
            prop_assert_eq!(&floats[..as_f32.len()], &as_f32[..]);
            prop_assert_eq!(&floats[as_f32.len()..], &[9.0; 3]);

            let (n_rx, n_tx) = (bfee.n_rx(), bfee.n_tx());
            let some = [29, 0, 7, 7, 28];
            prop_assert!(bfee.column(n_rx, 0).is_none() && bfee.column(0, n_tx).is_none());
            prop_assert!(bfee.column_f32(0, 0, &[29, 30], &mut [0.0; 4]).is_none());
            prop_assert!(bfee.column_f32(n_rx, 0, &some, &mut [0.0; 10]).is_none());
            for rx in 0..n_rx {
                for tx in 0..n_tx {
                    let (iq, mut re_im) = (bfee.column(rx, tx).unwrap(), [0.0; 10]);
                    bfee.column_f32(rx, tx, &some, &mut re_im).unwrap();
                    for (k, &s) in some.iter().enumerate() {
                        let expect = oracle[(usize::from(s) * n_rx + rx) * n_tx + tx];
                        prop_assert_eq!(iq[usize::from(s)], expect);
                        prop_assert_eq!(bfee.iq(s.into(), rx, tx), Some(expect));
                        prop_assert_eq!([re_im[2 * k], re_im[2 * k + 1]], [f32::from(expect.i), f32::from(expect.q)]);
                    }
                }
            }
        }

        #[test]
        fn a_set_gap_bit_is_seen((repr, csi) in any_repr(), subcarrier in 0..30_usize, bit in 0..3_usize) {
            let mut body = emitted(&repr, &csi);
            let n = usize::from(repr.n_rx * repr.n_tx);
            let at = 8 * (body.len() - csi_len(repr.n_rx, repr.n_tx)) + subcarrier * (3 + 16 * n) + bit;
            body[at / 8] |= 1 << (at % 8);
            prop_assert!(!Bfee::new_checked(&body).unwrap().gaps_are_clear());
        }
    }

    /// Header bytes written by hand from the format's table, not by `emit`.
    #[test]
    fn fields_lie_where_the_format_says() {
        let mut body = vec![0_u8; 38 + 72];
        body[..20].copy_from_slice(&[
            0x78, 0x56, 0x34, 0x12, 0xcd, 0xab, 0, 0, 1, 1, 33, 0, 0, 0x81, 38, 0x24, 72, 0, 0x01, 0x29,
        ]);
        body[20..38].copy_from_slice(&[1, 0, 0, 0, 2, 0, 0, 0, 0x00, 0x21, 0x6a, 0x53, 0x89, 0xd2, 5, 4, 3, 2]);
        // The first sample begins at bit 3: -1 - 128j.
        body[38] = 0xf8;
        body[39] = 0x07;
        body[40] = 0x04;
        let bfee = Bfee::new_checked(&body).unwrap();
        assert_eq!(bfee.layout(), Layout::Wsr);
        assert_eq!((bfee.timestamp_low(), bfee.bfee_count()), (0x1234_5678, 0xabcd));
        assert_eq!((bfee.n_rx(), bfee.n_tx(), bfee.rssi()), (1, 1, [33, 0, 0]));
        assert_eq!((bfee.noise_dbm(), bfee.agc(), bfee.rate_n_flags()), (NOISE_UNKNOWN_DBM, 38, 0x2901));
        assert!(bfee.is_40_mhz());
        let mac = Mac([0x00, 0x21, 0x6a, 0x53, 0x89, 0xd2]);
        assert_eq!(bfee.wsr(), Some(Wsr { tv_sec: 1, tv_usec: 2, mac, frame_count: Some(0x0203_0405) }));
        assert_eq!(bfee.iq(0, 0, 0), Some(Iq { i: -1, q: -128 }));
        assert_eq!(bfee.iq(30, 0, 0), None);
        assert_eq!([bfee.iq(0, 1, 0), bfee.iq(0, 0, 1)], [None; 2]);
        body.drain(34..38);
        let unnumbered = Bfee::new_checked(&body).unwrap();
        assert_eq!((unnumbered.layout(), unnumbered.iq(0, 0, 0)), (Layout::Wsr2021, bfee_first()));
        assert_eq!(unnumbered.wsr(), Some(Wsr { tv_sec: 1, tv_usec: 2, mac, frame_count: None }));
        body.drain(20..34);
        let stock = Bfee::new_checked(&body).unwrap();
        assert_eq!((stock.layout(), stock.wsr(), stock.iq(0, 0, 0)), (Layout::Stock, None, bfee_first()));
    }

    fn bfee_first() -> Option<Iq> {
        Some(Iq { i: -1, q: -128 })
    }

    #[test]
    fn a_body_that_continues_after_its_csi_is_read_in_its_layout() {
        let numbered = Wsr { tv_sec: 5, tv_usec: 6, mac: Mac([2; 6]), frame_count: Some(7) };
        for wsr in [None, Some(Wsr { frame_count: None, ..numbered }), Some(numbered)] {
            let repr = Repr { wsr, ..Repr::default() };
            let csi: Vec<Iq> = (0..repr.samples()).map(|k| Iq { i: k as i8, q: !(k as i8) }).collect();
            let body = emitted(&repr, &csi);
            for behind in 0..40 {
                let longer: Vec<u8> = body.iter().copied().chain(0xa0..0xa0 + behind).collect();
                let bfee = Bfee::new_checked(&longer).unwrap();
                // By its length such a body has another layout.
                if Layout::Wsr2021.header_len() + 192 != longer.len() && Layout::Wsr.header_len() + 192 != longer.len()
                {
                    assert_eq!((Repr::parse(&bfee), bfee.iq(29, 2, 0)), (repr, csi.last().copied()), "{behind} behind");
                    assert_eq!(bfee.behind_csi(), &longer[body.len()..]);
                }
            }
        }
    }

    #[test]
    fn lengths_and_chains_must_agree() {
        let repr = Repr::default();
        let csi = vec![Iq::default(); repr.samples()];
        let good = emitted(&repr, &csi);
        let error = |body: &[u8]| Bfee::new_checked(body).unwrap_err();
        assert_eq!(error(&good[..19]), Error::Short { got: 19 });
        assert_eq!(error(&good[..211]), Error::BodyLength { csi: 192, got: 211 });
        for (at, value, expect) in [
            (offset::N_RX, 0, Error::Chains { n_rx: 0, n_tx: 1 }),
            (offset::N_RX, 4, Error::Chains { n_rx: 4, n_tx: 1 }),
            (offset::N_TX, 9, Error::Chains { n_rx: 3, n_tx: 9 }),
            (offset::N_TX, 2, Error::CsiLength { expect: 372, got: 192 }),
            (offset::LEN, 193, Error::CsiLength { expect: 192, got: 193 }),
        ] {
            let mut body = good.clone();
            body[at] = value;
            assert_eq!(error(&body), expect);
        }
        let mut out = [0; 300];
        assert_eq!(
            Repr { n_rx: 4, ..repr }.emit(&csi, &mut out),
            Err(EmitError::Field { name: "n_rx", got: 4, max: 3 })
        );
        assert_eq!(repr.emit(&csi[1..], &mut out), Err(EmitError::Samples { expect: 90, got: 89 }));
        assert_eq!(repr.emit(&csi, &mut out[..211]), Err(EmitError::Buffer { need: 212, got: 211 }));
    }

    #[test]
    fn antennas_of_known_selections() {
        use Antenna::{A, B, C};
        let of = |sel, n_rx, rssi| Antennas::new(sel, n_rx, rssi).map(|a| a.as_slice().to_vec());
        // Values seen in captures.
        assert_eq!(of(0x24, 3, [1; 3]), Ok(vec![A, B, C]));
        assert_eq!(of(0x18, 3, [1; 3]), Ok(vec![A, C, B]));
        assert_eq!(of(0x09, 3, [1; 3]), Ok(vec![B, C, A]));
        assert_eq!(of(0x06, 3, [1; 3]), Ok(vec![C, B, A]));
        // Two chains: antennas A and C.
        assert_eq!(of(0x08, 2, [1, 0, 1]), Ok(vec![A, C]));
        assert_eq!(Antennas::new(0x08, 2, [1, 0, 1]).unwrap().chain_of(C), Some(1));
        assert_eq!(Antennas::new(0x08, 2, [1, 0, 1]).unwrap().chain_of(B), None);
        // One chain: named, or the only one with a nonzero RSSI.
        assert_eq!(of(0x02, 1, [0; 3]), Ok(vec![C]));
        assert_eq!(of(0x03, 1, [0, 7, 0]), Ok(vec![B]));
        for (sel, n_rx, rssi) in [
            (0x3f, 3, [1; 3]),
            (0x00, 3, [1; 3]),
            (0x05, 2, [1; 3]),
            (0x0c, 2, [1; 3]),
            (0x03, 1, [1, 1, 0]),
            (0x24, 4, [1; 3]),
        ] {
            assert_eq!(of(sel, n_rx, rssi), Err(InvalidPerm { antenna_sel: sel, n_rx }));
        }
    }

    #[test]
    fn a_sender_is_unknown_where_address_and_number_are_zero() {
        let known = |mac, frame_count| Wsr { mac, frame_count: Some(frame_count), ..Wsr::default() }.sender_known();
        let some = Mac([0, 0, 0, 0, 0, 1]);
        assert_eq!(
            [known(Mac::default(), 0), known(Mac::default(), 1), known(some, 0), known(some, 1)],
            [false, true, true, true]
        );
    }

    #[test]
    fn a_record_has_its_width_and_antennas() {
        for (rate_n_flags, wide) in [(0x0101, false), (0x0901, true), (!rate::HT40, false), (rate::HT40, true)] {
            // Chains 1 and 2 were connected to C and A.
            let repr = Repr { n_rx: 2, antenna_sel: 0b00_0010, rate_n_flags, ..Repr::default() };
            let mut body = vec![0; repr.body_len()];
            repr.emit(&vec![Iq::default(); repr.samples()], &mut body).unwrap();
            let bfee = Bfee::new_checked(&body).unwrap();
            assert_eq!(bfee.is_40_mhz(), wide, "{rate_n_flags:#06x}");
            assert_eq!(Antenna::ALL.map(|antenna| bfee.chain_of(antenna)), [Some(1), None, Some(0)]);
        }
        assert_eq!(Antenna::ALL.map(Antenna::index), [0, 1, 2]);
    }

    // Compares unpacking by chain pair and to bytes with unpacking bit by bit.
    /// Samples over the whole range of values, with different neighbours.
    fn samples(count: usize) -> Vec<Iq> {
        let value = |k: usize| (k * 73 + 11) as u8;
        (0..count).map(|k| Iq { i: value(2 * k).cast_signed(), q: value(2 * k + 1).cast_signed() }).collect()
    }

    /// Passes on a record of every number of chains and streams, with its samples unpacked bit by bit.
    fn each_size(mut show: impl FnMut(&Repr, &Bfee<'_>, &[Iq])) {
        for (n_rx, n_tx) in (1..=3).flat_map(|n_rx| (1..=3).map(move |n_tx| (n_rx, n_tx))) {
            let repr = Repr { n_rx, n_tx, ..Repr::default() };
            let mut body = vec![0; repr.body_len()];
            repr.emit(&samples(repr.samples()), &mut body).unwrap();
            let bfee = Bfee::new_checked(&body).unwrap();
            let mut bits = vec![Iq::default(); repr.samples()];
            assert_eq!(bfee.unpack_bits(&mut bits), Some(repr.samples()));
            show(&repr, &bfee, &bits);
        }
    }

    #[test]
    fn planes_are_the_samples_by_chain_pair() {
        each_size(|repr, bfee, bits| {
            let (n_rx, n_tx) = (repr.n_rx, repr.n_tx);
            let mut planes = [[99; 2]; MAX_SAMPLES];
            assert_eq!(bfee.unpack_planes(&mut planes), Some(repr.samples()));
            let pairs = usize::from(n_rx) * usize::from(n_tx);
            for (k, iq) in bits.iter().enumerate() {
                let (subcarrier, pair) = (k / pairs, k % pairs);
                assert_eq!(planes[pair * SUBCARRIERS + subcarrier], [iq.i, iq.q], "{n_rx}x{n_tx}, sample {k}");
            }
            assert!(planes[repr.samples()..].iter().all(|rest| *rest == [99; 2]), "written beyond the record");
            assert_eq!(bfee.unpack_planes(&mut planes[..repr.samples() - 1]), None);
        });
    }

    #[test]
    fn bytes_are_the_samples_in_the_order_of_the_payload() {
        each_size(|repr, bfee, bits| {
            let (n_rx, n_tx) = (repr.n_rx, repr.n_tx);
            let unpack = |out: &mut [u8]| by_pairs!(bfee, N => unpack_bytes_n::<N>(bfee.payload(), out));
            let mut bytes = [99; 2 * MAX_SAMPLES + WORD + 1];
            assert_eq!(unpack(&mut bytes), Some(repr.samples()));
            let (used, rest) = bytes.split_at(2 * repr.samples());
            let expected: Vec<u8> = bits.iter().flat_map(|iq| [iq.i.cast_unsigned(), iq.q.cast_unsigned()]).collect();
            assert_eq!(used, expected, "{n_rx}x{n_tx}");
            assert!(rest.iter().skip(8).all(|byte| *byte == 99), "written beyond a word more");
            let short = 2 * repr.samples() + 7;
            assert_eq!(unpack(&mut bytes[..short]), None);
        });
    }
}
