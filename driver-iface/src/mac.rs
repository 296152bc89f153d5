//! MAC addresses.

use core::fmt;
use core::str::FromStr;

/// A 48-bit MAC address, in transmission order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Mac(pub [u8; 6]);

impl Mac {
    /// All zeros: a WSR driver writes it for an unknown sender.
    pub const ZERO: Self = Self([0; 6]);
    /// ff:ff:ff:ff:ff:ff.
    pub const BROADCAST: Self = Self([0xff; 6]);

    /// True for 00:00:00:00:00:00.
    #[must_use]
    pub fn is_zero(self) -> bool {
        self == Self::ZERO
    }
}

impl fmt::Display for Mac {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [a, b, c, d, e, g] = self.0;
        write!(f, "{a:02x}:{b:02x}:{c:02x}:{d:02x}:{e:02x}:{g:02x}")
    }
}

/// The text is not six hexadecimal octets with `:` or `-` between them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ParseMacError;

impl fmt::Display for ParseMacError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a MAC address is six hexadecimal octets like 00:21:6a:53:89:d2")
    }
}

impl core::error::Error for ParseMacError {}

impl FromStr for Mac {
    type Err = ParseMacError;

    fn from_str(text: &str) -> Result<Self, ParseMacError> {
        let mut octets = [0; 6];
        let mut parts = text.split([':', '-']);
        for octet in &mut octets {
            let part = parts.next().ok_or(ParseMacError)?;
            if part.is_empty() || part.len() > 2 || !part.bytes().all(|b| b.is_ascii_hexdigit()) {
                return Err(ParseMacError);
            }
            *octet = u8::from_str_radix(part, 16).map_err(|_| ParseMacError)?;
        }
        if parts.next().is_some() { Err(ParseMacError) } else { Ok(Self(octets)) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn text_and_back() {
        let mac: Mac = "00:21:6A:53-89:d2".parse().unwrap();
        assert_eq!(mac, Mac([0x00, 0x21, 0x6a, 0x53, 0x89, 0xd2]));
        assert_eq!(mac.to_string(), "00:21:6a:53:89:d2");
        assert_eq!("0:1:2:3:4:5".parse(), Ok(Mac([0, 1, 2, 3, 4, 5])));
        for bad in [
            "",
            "00:21:6a:53:89",
            "00:21:6a:53:89:d2:00",
            "00:21:6a:53:89:1d2",
            "00:21:6a:53:89:0d2",
            "00:+1:6a:53:89:d2",
            "::::::",
        ] {
            assert_eq!(bad.parse::<Mac>(), Err(ParseMacError), "{bad}");
        }
    }

    #[test]
    fn one_address_is_zero() {
        assert!(Mac::default().is_zero());
        (0..6).for_each(|at| {
            let mut mac = Mac::default();
            mac.0[at] = 1;
            assert!(!mac.is_zero());
        });
    }
}
