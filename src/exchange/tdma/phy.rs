//! Frames on air: modulation, dialect, lengths, airtime.

use driver_iface::radiotap::Bandwidth;
use driver_iface::sounding::{native, wsr};

/// HT modulation of every frame: one of MCS 0 to 31, long guard interval, BCC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Phy {
    /// MCS index; `monitor_tx_rate` 0x4101 is MCS 1.
    pub mcs: u8,
    /// Channel width.
    pub bandwidth: Bandwidth,
}

impl Default for Phy {
    /// HT20 MCS 1, 13 Mb/s: what the csitool README sets (0x4101).
    fn default() -> Self {
        Self { mcs: 1, bandwidth: Bandwidth::Ht20 }
    }
}

impl Phy {
    /// Highest MCS with equal modulation on up to four streams (802.11-2016 clause 19.5).
    pub(crate) const MAX_MCS: u8 = 31;

    /// Data bits in one OFDM symbol of 4 us (802.11-2016 tables 19-27 to 19-34).
    #[must_use]
    fn bits_per_symbol(&self) -> u32 {
        const HT20: [u32; 8] = [26, 52, 78, 104, 156, 208, 234, 260];
        const HT40: [u32; 8] = [54, 108, 162, 216, 324, 432, 486, 540];
        let table = match self.bandwidth {
            Bandwidth::Ht20 => HT20,
            Bandwidth::Ht40 => HT40,
        };
        let one_stream = table.get(usize::from(self.mcs % 8)).copied().unwrap_or(26);
        one_stream * self.streams()
    }

    fn streams(&self) -> u32 {
        u32::from(self.mcs / 8 + 1)
    }

    /// Time on air of a frame of `len_with_fcs` bytes, microseconds: HT-mixed preamble (L-STF, L-LTF, L-SIG, HT-SIG,
    /// HT-STF, one HT-LTF per stream, four for three) and whole symbols of 4 us (802.11-2016 equation 19-90).
    #[must_use]
    pub fn airtime_us(&self, len_with_fcs: usize) -> u32 {
        let ltf = match self.streams() {
            3 => 4,
            streams => streams,
        };
        let preamble = 8 + 8 + 4 + 8 + 4 + 4 * ltf;
        let bits = 16 + 8 * len_with_fcs as u32 + 6;
        preamble + 4 * bits.div_ceil(self.bits_per_symbol())
    }
}

/// The format of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dialect {
    /// As the WSR toolbox: the length of a frame addresses a robot.
    Wsr {
        /// On-air length (FCS included) of the forward frame to the robot of index 0; odd.
        first_len: u16,
    },
    /// The dialect of this project, see [`driver_iface::sounding::native`].
    Native {
        /// Leave room for a measurement in the backward frame.
        measurement: bool,
        /// Leave room for an authentication tag in every frame.
        authenticated: bool,
    },
}

impl Dialect {
    /// Longest forward and backward frames on air, FCS included, if robots' indices go up to `last_index`.
    #[must_use]
    pub fn longest(&self, last_index: usize) -> (usize, usize) {
        match *self {
            Self::Wsr { first_len } => {
                let forward = wsr::forward_len(usize::from(first_len), last_index);
                (forward, forward + wsr::REPLY_GROWTH)
            }
            Self::Native { measurement, authenticated } => {
                (native::len_with_fcs(false, authenticated), native::len_with_fcs(measurement, authenticated))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_frames_are_those_of_the_last_robot_and_of_both_additions() {
        let wsr = Dialect::Wsr { first_len: 57 };
        assert_eq!([wsr.longest(0), wsr.longest(3)], [(57, 57 + wsr::REPLY_GROWTH), (63, 63 + wsr::REPLY_GROWTH)]);
        for (measurement, authenticated) in [(false, false), (true, false), (false, true), (true, true)] {
            let (forward, backward) = Dialect::Native { measurement, authenticated }.longest(3);
            let tag = if authenticated { native::TAG_LEN } else { 0 };
            assert_eq!(forward, native::len_with_fcs(false, false) + tag);
            assert_eq!(backward, native::len_with_fcs(measurement, false) + tag);
        }
    }

    #[test]
    fn airtime_is_that_of_the_standard() {
        let ht20 = |mcs| Phy { mcs, bandwidth: Bandwidth::Ht20 };
        // 57 bytes: 478 bits; 19 symbols of 26, 10 of 52, 2 of 260.
        assert_eq!([0, 1, 7].map(|mcs| ht20(mcs).airtime_us(57)), [36 + 76, 36 + 40, 36 + 8]);
        assert_eq!(Phy { mcs: 0, bandwidth: Bandwidth::Ht40 }.airtime_us(57), 36 + 36);
        // Three streams: four HT-LTFs, 78 bits a symbol.
        assert_eq!(ht20(16).airtime_us(57), 48 + 28);
    }
}
