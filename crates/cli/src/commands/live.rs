//! What the live commands share: kinds of arguments, signals, refusals.

use csi5300::time::Span;
pub use csi5300_live::wait::Signals;
use csi5300_sim::served;

/// Why a log cannot be made, with the flag that helps.
pub fn create_refused(error: &csi5300::source::Error) -> String {
    match error {
        csi5300::source::Error::Exists { .. } => format!("{error}: --force overwrites it"),
        csi5300::source::Error::IntoPipe { .. } => {
            format!("{error}; `record --live` also writes records to standard output")
        }
        _ => error.to_string(),
    }
}

/// Why a served room cannot be joined, with the command that serves one.
pub fn join_refused(error: &served::JoinError) -> String {
    match error {
        served::JoinError::NoRoom { .. } => {
            format!("{error}; does `csi5300 simulate SCENE --serve --socket PATH` run there?")
        }
        _ => error.to_string(),
    }
}

/// A length of time: `250ms`, `10s`, `5m`, `1h`; a bare number is seconds.
pub fn duration(text: &str) -> Result<Span, String> {
    let split = text.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(text.len());
    let (number, unit) = text.split_at(split);
    let scale = match unit {
        "ms" => 1e-3,
        "" | "s" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        _ => return Err(format!("unit `{unit}`: ms, s, m or h")),
    };
    match number.parse::<f64>() {
        Ok(value) if value.is_finite() && value >= 0.0 => Ok(Span::from_s(value * scale)),
        _ => Err("a time such as 250ms, 10s, 5m or 1h".into()),
    }
}

/// A length of time that is more than nothing.
pub fn some_duration(text: &str) -> Result<Span, String> {
    duration(text).and_then(|span| if span > Span::default() { Ok(span) } else { Err("more than 0".into()) })
}

/// A size at which a log is continued in another file: a record of the stock driver has up to 64 KiB.
pub fn rotation_size(text: &str) -> Result<u64, String> {
    size(text).and_then(
        |size| if size >= LEAST_ROTATION { Ok(size) } else { Err("64k or more: a record is as large".into()) },
    )
}

/// Bytes of a log at least before it is continued in another file.
const LEAST_ROTATION: u64 = 64 << 10;

/// A multiple of real time, above 0; `max` for no waiting at all.
pub fn speed(text: &str) -> Result<f64, String> {
    match text {
        "max" => Ok(f64::INFINITY),
        _ => text
            .parse()
            .ok()
            .filter(|speed: &f64| *speed > 0.0 && speed.is_finite())
            .ok_or_else(|| "above 0, or max".into()),
    }
}

/// A size in bytes: `4096`, `500k`, `100M`, `2G` (powers of 1024).
pub fn size(text: &str) -> Result<u64, String> {
    let split = text.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(text.len());
    let (number, unit) = text.split_at(split);
    let shift = match unit.to_ascii_lowercase().as_str() {
        "" => 0,
        "k" => 10,
        "m" => 20,
        "g" => 30,
        _ => return Err(format!("unit `{unit}`: k, M or G")),
    };
    let bytes = number.parse::<u64>().ok().and_then(|number| number.checked_mul(1 << shift));
    bytes.filter(|bytes| *bytes > 0).ok_or_else(|| "a size such as 500k, 100M or 2G".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_and_sizes() {
        assert_eq!(duration("250ms"), Ok(Span::from_ms(250)));
        assert_eq!(duration("1.5m"), Ok(Span::from_ms(90_000)));
        assert_eq!(duration("7"), Ok(Span::from_ms(7_000)));
        for wrong in ["", "s", "-1s", "3 days", "nan", "1e999s"] {
            assert!(duration(wrong).is_err(), "{wrong}");
        }
        assert!(some_duration("0s").is_err() && some_duration("0").is_err() && some_duration("1ms").is_ok());
        assert!(rotation_size("1").is_err() && rotation_size("63k").is_err() && rotation_size("64k").is_ok());
        assert_eq!(size("500k"), Ok(512_000));
        assert_eq!(size("2G"), Ok(1 << 31));
        for wrong in ["", "0", "k", "-5M", "1T", "99999999999G"] {
            assert!(size(wrong).is_err(), "{wrong}");
        }
    }
}
