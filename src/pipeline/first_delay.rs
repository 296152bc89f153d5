//! In a room the product of two antennas' channels contains every pair of paths. Wide frames separate the paths by
//! delay, and the first strong delay is nearly the direct path alone.
//!
//! Errors of bearings of a robot that turns, 48 simulated rooms of two reflections, 20 dB, degrees.
//! `tests/library/rooms.rs` repeats the last row; the others were measured once, those of 20 and 40 MHz without the
//! limit [`WIDE_MHZ`]:
//!
//! | width, MHz | product: median, 90 % | first delay | first delay better in |
//! |---|---|---|---|
//! | 20 | 0.70, 1.56 | 0.71, 1.61 | 23 |
//! | 40 | 0.56, 1.32 | 0.62, 1.52 | 22 |
//! | 80 | 0.31, 0.89 | 0.14, 0.63 | 35 |
//! | 160 | 0.22, 0.52 | 0.09, 0.30 | 38 |

use crate::bartlett::Tier;
use csi_formats::Frame;
use csi5300_kernels::fft::{Ffts, good_size};
use num_complex::Complex32;
use std::fmt;

/// From this width on the first delay is taken, MHz: a tap of 80 MHz is 3.7 m long.
const WIDE_MHZ: u16 = 80;
/// A peak from this share of the strongest one's power on is a path of its own: the side lobes of a tap are below 0.05.
const STRONG: f32 = 0.25;
/// The direct path precedes the strongest one by at most this, seconds: 75 m.
const AHEAD_S: f64 = 0.25e-6;

/// What the antennas of an array heard at the first strong delay.
pub(super) struct FirstDelay(Ffts<f32>);

impl fmt::Debug for FirstDelay {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("FirstDelay").field(&self.0.tier()).finish()
    }
}

impl FirstDelay {
    pub fn new(tier: Tier) -> Self {
        Self(Ffts::new(tier))
    }

    /// True if a frame is wide enough to separate paths by delay.
    pub fn is_of(frame: &Frame) -> bool {
        frame.width_mhz >= WIDE_MHZ
    }

    /// One value for each of `columns`, which are CSI in the order of the frame's subcarriers.
    pub fn of(&mut self, frame: &Frame, columns: &[&[[f32; 2]]]) -> Option<Vec<Complex32>> {
        let (first, last) = (*frame.subcarriers.first()?, *frame.subcarriers.last()?);
        // Two delays per resolution of the bandwidth.
        let n = good_size(2 * usize::from(last.abs_diff(first)) + 2);
        let inverse = self.0.inverse(n);
        let delays = |column: &&[[f32; 2]]| {
            let mut delays = vec![Complex32::default(); n];
            for (([re, im], k), _) in
                column.iter().zip(&frame.subcarriers).zip(&frame.measured).filter(|(_, measured)| **measured)
            {
                if let Some(place) = delays.get_mut(isize::from(*k).rem_euclid(n as isize) as usize) {
                    *place = Complex32::new(*re, *im);
                }
            }
            inverse.process(&mut delays);
            delays
        };
        let all: Vec<Vec<Complex32>> = columns.iter().map(delays).collect();
        let power =
            |at: usize| all.iter().filter_map(|delays| delays.get(at % n)).map(Complex32::norm_sqr).sum::<f32>();
        let strongest = (0..n).max_by(|a, b| power(*a).total_cmp(&power(*b)))?;
        let ahead = ((AHEAD_S * frame.spacing_hz() * n as f64) as usize).min(n / 2);
        let is_path = |at: &usize| {
            let own = power(*at);
            own >= STRONG * power(strongest) && own >= power(at + n - 1) && own >= power(at + 1)
        };
        let at = (strongest + n - ahead..=strongest + n).find(is_path)? % n;
        all.iter().map(|delays| delays.get(at).copied()).collect()
    }
}
