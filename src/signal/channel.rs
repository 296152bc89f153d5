//! WiFi channels: centre frequency, wavelength, and the subcarriers of which the card reports CSI.

pub(crate) use driver_iface::bfee::SUBCARRIERS;
use std::fmt;
use std::str::FromStr;

/// Speed of light in vacuum, m/s (exact, SI).
#[doc(hidden)] // for the crates of this workspace
pub const SPEED_OF_LIGHT_M_PER_S: f64 = 299_792_458.0;
/// Spacing of subcarriers, Hz (802.11-2016 table 19-6).
#[doc(hidden)] // for the crates of this workspace
pub const SUBCARRIER_SPACING_HZ: f64 = 312_500.0;

/// Subcarrier indices reported at 20 MHz (802.11-2016 table 9-54, Ng = 2); neither uniform nor symmetric.
#[rustfmt::skip]
pub const INDICES_20_MHZ: [i8; SUBCARRIERS] = [
    -28, -26, -24, -22, -20, -18, -16, -14, -12, -10, -8, -6, -4, -2, -1,
    1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 28,
];
/// Subcarrier indices reported at 40 MHz (802.11-2016 table 9-54, Ng = 4).
#[rustfmt::skip]
pub const INDICES_40_MHZ: [i8; SUBCARRIERS] = [
    -58, -54, -50, -46, -42, -38, -34, -30, -26, -22, -18, -14, -10, -6, -2,
    2, 6, 10, 14, 18, 22, 26, 30, 34, 38, 42, 46, 50, 54, 58,
];

/// Where the second half of a 40 MHz channel lies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Width {
    /// 20 MHz.
    #[default]
    Ht20,
    /// 40 MHz, secondary channel above.
    Ht40Plus,
    /// 40 MHz, secondary channel below.
    Ht40Minus,
}

/// A WiFi channel: of the 2.4 or 5 GHz band by its number and width, any other by its centre frequency.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Channel {
    number: u32,
    width: Width,
    /// Centre, MHz, if that is how the channel was given.
    centre_mhz: Option<u32>,
}

/// Why a text or number is not a channel.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}: {KNOWN}")]
pub struct ChannelError(String);

/// The accepted forms of a channel, for error messages.
const KNOWN: &str = "1 to 14 (2.4 GHz), or 36, 40, .. 64, 100, 104, .. 144 and 149, 153, .. 177 (5 GHz); of 40 MHz the lower \
                     half with + or the upper with -, for example 36+ or 40-; any other by its centre, for example 5290MHz \
                     (80 MHz wide) or 6115MHz (6 GHz)";

fn no_channel(named: impl fmt::Display) -> ChannelError {
    ChannelError(format!("`{named}` is no channel"))
}

/// Whether some country has a channel of this number (802.11-2016 annex E; 34 to 46 and 184 to 196 were Japan's).
fn is_assigned(number: u32) -> bool {
    match number {
        1..=14 | 34 | 36 | 38 | 40 | 42 | 44 | 46 => true,
        48..=64 | 100..=144 | 184..=196 => number.is_multiple_of(4),
        149..=177 => number % 4 == 1,
        _ => false,
    }
}

/// Whether this may be the lower (+) or the upper (-) half of 40 MHz (802.11-2016 annex E, classes 83, 84, 116 to 127).
fn is_half(number: u32, width: Width) -> bool {
    match (width, number) {
        (Width::Ht20, _) => true,
        (Width::Ht40Plus, 1..=14) => number <= 9,
        (Width::Ht40Minus, 1..=14) => (5..=13).contains(&number),
        (Width::Ht40Plus, 36..=144) => number % 8 == 4,
        (Width::Ht40Minus, 36..=144) => number.is_multiple_of(8),
        (Width::Ht40Plus, 149..=177) => number % 8 == 5,
        (Width::Ht40Minus, 149..=177) => number % 8 == 1,
        _ => false,
    }
}

impl Channel {
    /// A channel by its number and width.
    ///
    /// # Errors
    /// [`ChannelError`] if no channel of the 2.4 or 5 GHz band has this number.
    pub fn new(number: u32, width: Width) -> Result<Self, ChannelError> {
        let known = (1..=14).contains(&number) || (34..=196).contains(&number);
        let wide = !(number == 14 && width != Width::Ht20);
        if known && wide { Ok(Self { number, width, centre_mhz: None }) } else { Err(no_channel(number)) }
    }

    /// A channel by its centre, MHz: of the 6 GHz band, whose numbers are also used at 5 GHz, or one of 80 or 160 MHz. Its
    /// [`Channel::width`] is then [`Width::Ht20`].
    ///
    /// # Errors
    /// [`ChannelError`] outside 2,400 to 2,500 and 5,000 to 7,125 MHz.
    fn of_centre_mhz(mhz: u32) -> Result<Self, ChannelError> {
        let base_mhz = match mhz {
            2_400..=2_500 => 2_407,
            5_000..=5_925 => 5_000,
            5_926..=7_125 => 5_950,
            _ => return Err(ChannelError(format!("{mhz} MHz is outside the bands of WiFi"))),
        };
        Ok(Self { number: mhz.saturating_sub(base_mhz) / 5, width: Width::Ht20, centre_mhz: Some(mhz) })
    }

    /// Its number, which is not unique: 5 and 6 GHz share numbers (802.11ax-2021 annex E).
    #[must_use]
    pub fn number(self) -> u32 {
        self.number
    }

    /// Its width.
    #[must_use]
    pub fn width(self) -> Width {
        self.width
    }

    /// True if it is named by its centre, which shows no width: in MHz, or by a number that no channel of 20 MHz has.
    fn is_centre(self) -> bool {
        self.centre_mhz.is_some() || (self.width == Width::Ht20 && !is_assigned(self.number))
    }

    /// How records of this width name the channel, if it is named as one of the other width.
    pub(crate) fn renamed(self, is_wide: bool) -> Option<String> {
        if self.is_centre() || is_wide == (self.width != Width::Ht20) {
            return None;
        }
        let named = |sign| Self::from_str(&format!("{}{sign}", self.number)).ok().map(|channel| channel.to_string());
        let signs: &[&str] = if is_wide { &["+", "-"] } else { &[""] };
        Some(signs.iter().filter_map(named).collect::<Vec<_>>().join(" or "))
    }

    /// Centre of the channel (of both halves at 40 MHz), Hz: the frequency of subcarrier 0 (802.11-2016 17.3.8.4, 19.3.15).
    #[must_use]
    pub fn centre_hz(self) -> f64 {
        if let Some(mhz) = self.centre_mhz {
            return f64::from(mhz) * 1e6;
        }
        let primary_mhz = match self.number {
            14 => 2_484,
            number @ 1..=13 => 2_407 + 5 * number,
            number => 5_000 + 5 * number,
        };
        let shift_mhz = match self.width {
            Width::Ht20 => 0.0,
            Width::Ht40Plus => 10.0,
            Width::Ht40Minus => -10.0,
        };
        (f64::from(primary_mhz) + shift_mhz) * 1e6
    }

    /// Wavelength at the centre, metres.
    #[must_use]
    pub fn wavelength_m(self) -> f64 {
        SPEED_OF_LIGHT_M_PER_S / self.centre_hz()
    }

    /// Indices of the reported subcarriers about the centre.
    #[must_use]
    pub fn subcarriers(self) -> [i8; SUBCARRIERS] {
        match self.width {
            Width::Ht20 => INDICES_20_MHZ,
            Width::Ht40Plus | Width::Ht40Minus => INDICES_40_MHZ,
        }
    }
}

impl FromStr for Channel {
    type Err = ChannelError;

    fn from_str(text: &str) -> Result<Self, ChannelError> {
        let wrong = || no_channel(text);
        if let Some(mhz) = text.strip_suffix("MHz") {
            return Self::of_centre_mhz(mhz.trim_end().parse().map_err(|_| wrong())?);
        }
        let (digits, width) = match (text.strip_suffix('+'), text.strip_suffix('-')) {
            (Some(digits), _) => (digits, Width::Ht40Plus),
            (_, Some(digits)) => (digits, Width::Ht40Minus),
            _ => (text, Width::Ht20),
        };
        let number = digits.parse().map_err(|_| wrong())?;
        let is_known = is_assigned(number) && is_half(number, width);
        Self::new(number, width).ok().filter(|_| is_known).ok_or_else(wrong)
    }
}

impl fmt::Display for Channel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(mhz) = self.centre_mhz {
            return write!(f, "{mhz}MHz");
        }
        let sign = match self.width {
            Width::Ht20 => "",
            Width::Ht40Plus => "+",
            Width::Ht40Minus => "-",
        };
        write!(f, "{}{sign}", self.number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_name_channels_that_there_are() {
        for text in [
            "1", "14", "36", "36+", "64", "100", "108", "144", "149", "165", "196", "9+", "13-", "60+", "64-", "104-",
            "108+", "157+", "177-",
        ] {
            assert_eq!(text.parse::<Channel>().map(|channel| channel.to_string()), Ok(text.into()));
        }
        for text in [
            "0", "15", "37", "50", "66", "99", "110", "148", "152", "180", "197", "14+", "10+", "4-", "64+", "36-",
            "104+", "149-", "34+", "x",
        ] {
            let error = text.parse::<Channel>().unwrap_err().to_string();
            assert!(error.contains("no channel"), "{text}: {error}");
        }
    }

    #[test]
    fn channels_by_their_centre() {
        let channel: Channel = "6115 MHz".parse().unwrap();
        assert_eq!((channel.to_string().as_str(), channel.number(), channel.centre_hz()), ("6115MHz", 33, 6.115e9));
        assert_eq!(channel.to_string().parse(), Ok(channel));
        assert_eq!("5290MHz".parse::<Channel>().map(Channel::number), Ok(58));
        for wrong in ["5.29GHz", "3000MHz", "7200MHz", "-5290MHz", "MHz"] {
            assert!(wrong.parse::<Channel>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn channels_of_both_bands() {
        let hz = |text: &str| text.parse::<Channel>().unwrap().centre_hz();
        assert_eq!(hz("108"), 5.54e9);
        assert_eq!(hz("1"), 2.412e9);
        assert_eq!(hz("14"), 2.484e9);
        assert_eq!(hz("36+"), 5.19e9);
        assert_eq!(hz("40-"), 5.19e9);
        let channel: Channel = "36+".parse().unwrap();
        assert_eq!((channel.to_string().as_str(), channel.subcarriers()[0]), ("36+", -58));
        assert!((Channel::new(108, Width::Ht20).unwrap().wavelength_m() - 0.054_114_162).abs() < 1e-8);
        for wrong in ["0", "15", "33", "200", "14+", "", "x", "-5", "108*"] {
            assert!(wrong.parse::<Channel>().is_err(), "{wrong}");
        }
    }
}
