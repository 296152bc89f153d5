//! Values as the file writes them.

use driver_iface::bfee::Antenna;
use serde::de::{Deserialize, Deserializer, Error as _};
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

pub(super) fn antenna_a() -> Antenna {
    Antenna::A
}

pub(super) fn one() -> f64 {
    1.0
}

pub(super) fn hundred() -> f64 {
    100.0
}
