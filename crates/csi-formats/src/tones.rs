//! The subcarriers of a frame, and which of them are pilots.

use crate::Kind;
use alloc::vec::Vec;

/// The subcarriers of a frame that carry a signal, by index relative to the channel centre.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tones {
    /// In rising order.
    pub subcarriers: Vec<i16>,
    /// Which of them carry data rather than a pilot.
    pub data: Vec<bool>,
}

/// Ranges of indices above the centre, both ends included, and their pilots; the lower half mirrors them.
type Upper = (&'static [(i16, i16)], &'static [i16]);

/// 802.11-2016 17.3.5.10 (legacy), 19.3.11.10 (HT), 21.3.10.10 (VHT); 802.11ax 27.3.12.13 (HE, one user on the whole width).
const fn upper(kind: Kind, width_mhz: u16) -> Option<Upper> {
    Some(match (kind, width_mhz) {
        (Kind::Legacy, 20) => (&[(1, 26)], &[7, 21]),
        (Kind::Ht | Kind::Vht, 20) => (&[(1, 28)], &[7, 21]),
        (Kind::Ht | Kind::Vht, 40) => (&[(2, 58)], &[11, 25, 53]),
        (Kind::Vht, 80) => (&[(2, 122)], &[11, 39, 75, 103]),
        (Kind::Vht, 160) => (&[(6, 126), (130, 250)], &[25, 53, 89, 117, 139, 167, 203, 231]),
        (Kind::He, 20) => (&[(2, 122)], &[22, 48, 90, 116]),
        (Kind::He, 40) => (&[(3, 244)], &[10, 36, 78, 104, 144, 170, 212, 238]),
        (Kind::He, 80) => (&[(3, 500)], &[24, 92, 158, 226, 266, 334, 400, 468]),
        (Kind::He, 160) => (
            &[(12, 509), (515, 1012)],
            &[44, 112, 178, 246, 286, 354, 420, 488, 536, 604, 670, 738, 778, 846, 912, 980],
        ),
        _ => return None,
    })
}

impl Tones {
    /// Those of a kind and width; `None` for a width that the kind does not have.
    #[must_use]
    pub fn of(kind: Kind, width_mhz: u16) -> Option<Self> {
        let (ranges, pilots) = upper(kind, width_mhz)?;
        let above = || ranges.iter().flat_map(|(from, to)| *from..=*to);
        let below: Vec<i16> = above().map(|index| -index).collect();
        let subcarriers: Vec<i16> = below.into_iter().rev().chain(above()).collect();
        let data = subcarriers.iter().map(|index| !pilots.contains(&index.abs())).collect();
        Some(Self { subcarriers, data })
    }
}

/// The 30 that a 5300 reports: grouped by 2 at 20 MHz, by 4 at 40 MHz (802.11n-2009 7.3.1.28).
pub(crate) fn of_5300(width_mhz: u16) -> Option<Vec<i16>> {
    let above = |index: i16| match width_mhz {
        20 => Some(if index < 14 { 2 * index + 1 } else { 28 }),
        40 => Some(4 * index + 2),
        _ => None,
    };
    let below = |index: i16| if width_mhz == 20 { [1, 2 * index].into_iter().max() } else { Some(4 * index + 2) };
    let lower = (0..15).rev().map(|index| below(index).map(|index| -index));
    lower.chain((0..15).map(above)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Positions of the pilots in a record, from CSIKit's list of interpolated subcarriers.
    #[test]
    fn pilots_match_csikits_list() {
        for (kind, width, n, first) in [
            (Kind::Ht, 20, 56, &[7, 21, 34, 48][..]),
            (Kind::Ht, 40, 114, &[5, 33, 47, 66, 80, 108]),
            (Kind::Vht, 80, 242, &[19, 47, 83, 111, 130, 158, 194, 222]),
            (Kind::Vht, 160, 484, &[19, 47, 83, 111, 130, 158, 194, 222, 261, 289, 325, 353, 372, 400, 436, 464]),
            (Kind::He, 20, 242, &[6, 32, 74, 100, 141, 167, 209, 235]),
            (Kind::He, 40, 484, &[6, 32, 74, 100, 140, 166, 208, 234, 249, 275, 317, 343, 383, 409, 451, 477]),
            (Kind::He, 80, 996, &[32, 100, 166, 234, 274, 342, 408, 476, 519, 587, 653, 721, 761, 829, 895, 963]),
            (
                Kind::He,
                160,
                1992,
                &[32, 100, 166, 234, 274, 342, 408, 476, 519, 587, 653, 721, 761, 829, 895, 963, 1028],
            ),
        ] {
            let tones = Tones::of(kind, width).unwrap();
            let pilots: Vec<usize> = (0..n).filter(|k| !tones.data[*k]).collect();
            assert_eq!(tones.subcarriers.len(), n, "{kind:?} {width}");
            assert_eq!(&pilots[..first.len()], first, "{kind:?} {width}");
        }
        assert_eq!(Tones::of(Kind::Ht, 80), None);
    }

    #[test]
    fn a_5300_reports_the_groups_of_the_standard() {
        let lower: Vec<i16> = of_5300(20).unwrap().into_iter().take(16).collect();
        assert_eq!(lower, [-28, -26, -24, -22, -20, -18, -16, -14, -12, -10, -8, -6, -4, -2, -1, 1]);
        assert_eq!(of_5300(20).unwrap()[28..], [27, 28]);
        let wide = of_5300(40).unwrap();
        assert_eq!((wide[0], wide[14], wide[15], wide[29]), (-58, -2, 2, 58));
        assert_eq!(of_5300(80), None);
    }
}
