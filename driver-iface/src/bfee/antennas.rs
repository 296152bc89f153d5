//! The antenna of each receive chain.

use core::fmt;

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
