//! The channel per subcarrier: the effect of a set of paths on 30 tones.

use super::maths::phasor;
use super::surfaces::Path;
use csi5300::signal::channel::{
    INDICES_20_MHZ, INDICES_40_MHZ, SPEED_OF_LIGHT_M_PER_S, SUBCARRIER_SPACING_HZ, SUBCARRIERS,
};
use num_complex::Complex64;

/// Subcarriers in a record.
pub const TONES: usize = SUBCARRIERS;
/// Period of one sample at 20 MHz, seconds; at 40 MHz it is half of it.
pub const SAMPLE_20_S: f64 = 50e-9;

/// One row of tones.
pub type Tones = [Complex64; TONES];

/// The tones of a channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Carrier {
    /// Centre frequency, Hz.
    pub centre_hz: f64,
    indices: &'static [i8; TONES],
}

/// Contribution of the radios to every path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Common {
    /// Phase at the centre, turns.
    pub turns: f64,
    /// Delay, seconds. It turns subcarrier `k` by `-k 312.5 kHz delay_s` turns and does not change the centre, because
    /// the receiver mixes down before it samples.
    pub delay_s: f64,
}

impl Carrier {
    /// The carrier of a 5 GHz (or 2.4 GHz, 1 to 14) channel number, 20 MHz or 40 MHz wide.
    ///
    /// At 40 MHz the given number is that of the 40 MHz channel's centre. `None` for numbers that are no channel.
    #[must_use]
    pub fn new(channel: u16, wide: bool) -> Option<Self> {
        // 802.11-2016 17.3.8.4.3 and 19.3.15.2: 5000 + 5 n MHz; 2407 + 5 n MHz, and 2484 MHz for channel 14.
        let centre_mhz = match channel {
            1..=13 => 2_407 + 5 * channel,
            14 => 2_484,
            34..=196 => 5_000 + 5 * channel,
            _ => return None,
        };
        let indices = if wide { &INDICES_40_MHZ } else { &INDICES_20_MHZ };
        Some(Self { centre_hz: f64::from(centre_mhz) * 1e6, indices })
    }

    /// Wavelength at the centre, metres.
    #[must_use]
    pub fn wavelength_m(&self) -> f64 {
        SPEED_OF_LIGHT_M_PER_S / self.centre_hz
    }

    /// The subcarrier indices of the 30 tones.
    #[cfg(test)]
    pub fn indices(&self) -> &'static [i8; TONES] {
        self.indices
    }

    /// Adds a path to `tones`: `gain / d exp(-j 2 pi (d f_k / c))` at the frequency `f_k` of each tone, with the
    /// radios' contribution. Distances are exact, without a far-field approximation.
    ///
    /// Three sines and cosines a path: tone follows tone by multiplication, which costs about 30 rounding errors.
    pub fn add(&self, path: &Path, common: Common, tones: &mut Tones) {
        let flight_s = path.length_m / SPEED_OF_LIGHT_M_PER_S;
        let step_turns = -SUBCARRIER_SPACING_HZ * (flight_s + common.delay_s);
        let first = self.indices[0];
        let centre_turns = common.turns - flight_s * self.centre_hz;
        let mut tone = phasor(centre_turns + f64::from(first) * step_turns) * (path.gain / path.length_m);
        let one = phasor(step_turns);
        let two = one * one;
        let four = two * two;
        let mut index = first;
        for (sum, &next) in tones.iter_mut().zip(self.indices) {
            match next - index {
                0 => {}
                1 => tone *= one,
                2 => tone *= two,
                _ => tone *= four,
            }
            index = next;
            *sum += tone;
        }
    }

    /// The same at any subcarriers, by their indices in rising order and their spacing.
    pub fn add_at(&self, path: &Path, common: Common, (indices, spacing_hz): (&[i16], f64), tones: &mut [Complex64]) {
        let flight_s = path.length_m / SPEED_OF_LIGHT_M_PER_S;
        let step_turns = -spacing_hz * (flight_s + common.delay_s);
        let centre_turns = common.turns - flight_s * self.centre_hz;
        let (one, size) = (phasor(step_turns), path.gain / path.length_m);
        let mut last: Option<(i16, Complex64)> = None;
        for (sum, &index) in tones.iter_mut().zip(indices) {
            let tone = match last {
                Some((before, tone)) if before + 1 == index => tone * one,
                _ => phasor(centre_turns + f64::from(index) * step_turns) * size,
            };
            last = Some((index, tone));
            *sum += tone;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_have_their_frequencies() {
        assert_eq!(Carrier::new(108, false).unwrap().centre_hz, 5.540e9);
        assert_eq!(Carrier::new(6, false).unwrap().centre_hz, 2.437e9);
        assert_eq!(Carrier::new(14, false).unwrap().centre_hz, 2.484e9);
        assert!(Carrier::new(20, false).is_none());
    }

    #[test]
    fn every_tone_is_the_exact_phase_at_its_own_frequency() {
        let common = Common { turns: 12_345.678, delay_s: 200e-9 };
        for wide in [false, true] {
            let carrier = Carrier::new(108, wide).unwrap();
            let mut tones = [Complex64::default(); TONES];
            let path = Path { length_m: 3.968_3, gain: -0.5 };
            carrier.add(&path, common, &mut tones);
            for (tone, &k) in tones.iter().zip(carrier.indices()) {
                let hz = carrier.centre_hz + f64::from(k) * SUBCARRIER_SPACING_HZ;
                let turns = common.turns
                    - path.length_m * hz / SPEED_OF_LIGHT_M_PER_S
                    - f64::from(k) * SUBCARRIER_SPACING_HZ * common.delay_s;
                let want = phasor(turns) * (path.gain / path.length_m);
                assert!((tone - want).norm() < 1e-11, "tone {k}");
            }
        }
    }

    #[test]
    fn any_subcarriers_have_the_phase_of_their_frequency() {
        let (carrier, common) = (Carrier::new(36, true).unwrap(), Common { turns: 7.25, delay_s: 90e-9 });
        let path = Path { length_m: 5.5, gain: 0.8 };
        let indices: Vec<i16> = (-244..-2).chain(3..245).collect();
        let mut tones = vec![Complex64::default(); indices.len()];
        carrier.add_at(&path, common, (&indices, 78_125.0), &mut tones);
        for (tone, &k) in tones.iter().zip(&indices) {
            let off_hz = f64::from(k) * 78_125.0;
            let turns =
                common.turns - path.length_m * (carrier.centre_hz + off_hz) / SPEED_OF_LIGHT_M_PER_S - off_hz * 90e-9;
            assert!((tone - phasor(turns) * (path.gain / path.length_m)).norm() < 1e-9, "tone {k}");
        }
    }

    #[test]
    fn indices_step_by_at_most_the_grouping() {
        for (indices, grouping) in [(INDICES_20_MHZ, 2), (INDICES_40_MHZ, 4)] {
            assert!(indices.windows(2).all(|w| matches!(w[1] - w[0], 1 | 2 | 4) && w[1] - w[0] <= grouping));
        }
    }
}
