//! Ports without an antenna.

use super::Survey;
use driver_iface::bfee::Antenna;

/// An antenna whose mean RSSI is this much below the strongest one's is as good as unconnected, dB (ports without an
/// antenna are 18 to 35 below in 64 logs).
const UNCONNECTED_DB: f64 = 14.0;

impl Survey {
    /// Where `antenna` hears so much less than another that nothing seems to be connected to its port: the antenna that
    /// hears most, and by how much its mean RSSI is higher, dB.
    #[must_use]
    pub fn better_antenna(&self, antenna: Antenna) -> Option<(Antenna, f64)> {
        let mean =
            |antenna: Antenna| self.rssi.get(antenna.index()).filter(|rssi| rssi.is_measured()).map(|rssi| rssi.mean);
        let heard = Antenna::ALL.into_iter().filter_map(|other| Some((other, mean(other)?)));
        let (best, level_db) = heard.max_by(|a, b| a.1.total_cmp(&b.1))?;
        let above_db = level_db - mean(antenna).unwrap_or(0.0);
        (best != antenna && above_db >= UNCONNECTED_DB).then_some((best, above_db))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::survey::Range;

    fn survey(rssi: [&[i32]; 3]) -> Survey {
        let range = |values: &[i32]| {
            let mut range = Range::default();
            values.iter().for_each(|value| range.note(*value));
            range
        };
        Survey { rssi: rssi.map(range), ..Survey::default() }
    }

    #[test]
    fn a_port_without_an_antenna_is_told_from_one_that_hears_less() {
        let wsr = survey([&[38, 37, 39], &[15, 14], &[13, 12]]);
        assert_eq!(wsr.better_antenna(Antenna::A), None);
        assert_eq!(wsr.better_antenna(Antenna::B), Some((Antenna::A, 23.5)));
        // Fading takes less, and a port of which the card says nothing has 0.
        let faded = survey([&[30], &[20], &[]]);
        assert_eq!(faded.better_antenna(Antenna::B), None);
        assert_eq!(faded.better_antenna(Antenna::C), Some((Antenna::A, 30.0)));
        assert_eq!(survey([&[], &[], &[]]).better_antenna(Antenna::A), None, "nothing is known");
    }
}
