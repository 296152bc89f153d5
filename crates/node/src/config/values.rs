//! Values as the file writes them.

use csi5300::signal::channel::Channel;
use driver_iface::bfee::Antenna;
use serde::de::{Deserialize, Deserializer, Error as _};
use std::collections::BTreeMap;
use std::fmt::Display;
use std::str::FromStr;

pub(super) fn parsed<'de, D: Deserializer<'de>, T: FromStr<Err: Display>>(input: D) -> Result<T, D::Error> {
    String::deserialize(input)?.parse().map_err(D::Error::custom)
}

pub(super) fn maybe_parsed<'de, D: Deserializer<'de>, T: FromStr<Err: Display>>(
    input: D,
) -> Result<Option<T>, D::Error> {
    parsed(input).map(Some)
}

/// A channel: text, or the number of one of 20 MHz.
pub(super) fn channel<'de, D: Deserializer<'de>>(input: D) -> Result<Channel, D::Error> {
    #[derive(serde::Deserialize)]
    #[serde(untagged, expecting = "a channel: \"108\", \"36+\" for 40 MHz, or its centre, \"5290MHz\"")]
    enum Written {
        Number(u32),
        Text(String),
    }
    let text = match Written::deserialize(input)? {
        Written::Number(number) => number.to_string(),
        Written::Text(text) => text,
    };
    text.parse().map_err(D::Error::custom)
}

pub(super) fn antenna<'de, D: Deserializer<'de>>(input: D) -> Result<Antenna, D::Error> {
    match String::deserialize(input)?.as_str() {
        "A" => Ok(Antenna::A),
        "B" => Ok(Antenna::B),
        "C" => Ok(Antenna::C),
        other => Err(D::Error::custom(format!("antenna `{other}`: A, B or C"))),
    }
}

pub(super) fn positive<'de, D: Deserializer<'de>>(input: D) -> Result<f64, D::Error> {
    let value = f64::deserialize(input)?;
    if value.is_finite() && value > 0.0 {
        Ok(value)
    } else {
        Err(D::Error::custom(format!("{value}: a number above 0")))
    }
}

pub(super) fn maybe_positive<'de, D: Deserializer<'de>>(input: D) -> Result<Option<f64>, D::Error> {
    positive(input).map(Some)
}

/// Numbers of a list that must have `N` of them: arrays of serde ignore further ones.
struct Exactly<const N: usize>([f64; N]);

impl<'de, const N: usize> Deserialize<'de> for Exactly<N> {
    fn deserialize<D: Deserializer<'de>>(input: D) -> Result<Self, D::Error> {
        let all = Vec::<f64>::deserialize(input)?;
        let count = all.len();
        all.try_into().map(Self).map_err(|_| D::Error::custom(format!("{count} numbers where {N} are expected")))
    }
}

pub(super) fn exactly<'de, const N: usize, D: Deserializer<'de>>(input: D) -> Result<[f64; N], D::Error> {
    Exactly::deserialize(input).map(|own| own.0)
}

pub(super) fn lists<'de, const N: usize, D: Deserializer<'de>>(input: D) -> Result<Vec<[f64; N]>, D::Error> {
    Vec::<Exactly<N>>::deserialize(input).map(|all| all.into_iter().map(|own| own.0).collect())
}

pub(super) fn named<'de, const N: usize, D: Deserializer<'de>>(
    input: D,
) -> Result<BTreeMap<String, [f64; N]>, D::Error> {
    let all = BTreeMap::<String, Exactly<N>>::deserialize(input)?;
    Ok(all.into_iter().map(|(name, own)| (name, own.0)).collect())
}

pub(super) fn antenna_a() -> Antenna {
    Antenna::A
}

pub(super) fn one() -> f64 {
    1.0
}

pub(super) fn hundred() -> f64 {
    100.0
}
