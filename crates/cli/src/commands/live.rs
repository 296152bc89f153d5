//! What the live commands share: arguments, signals, words.

use csi5300::time::Span;
use csi5300_live::netlink::{Found, Netlink, Options};
use csi5300_live::wait::wall_us;
use csi5300_sim::served::{self, Address};
use nix::sys::signal::{SigSet, Signal};
use nix::sys::signalfd::{SfdFlags, SignalFd};
use std::os::fd::{AsFd, BorrowedFd};

/// How to listen to the driver.
#[derive(clap::Args, Clone, Debug)]
pub struct Listening {
    /// Connector index of the driver, instead of looking for it
    #[arg(long, value_name = "INDEX", value_parser = clap::value_parser!(u32).range(1..=32))]
    pub connector_index: Option<u32>,
    /// Believe messages of other programs too: emulators, `replay --connector`
    #[arg(long)]
    pub allow_user_sender: bool,
    /// Receive buffer to ask the kernel for
    #[arg(long, value_parser = size, default_value = "32M", value_name = "SIZE")]
    pub receive_buffer: u64,
    /// Work with a robot of a simulated room (`simulate SCENE --serve --socket PATH`) as if it were the card
    #[arg(long, value_name = "PATH#ROBOT", conflicts_with_all = ["connector_index", "allow_user_sender"])]
    pub room: Option<Address>,
}

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

impl Listening {
    /// Opens the listener.
    pub fn open(&self) -> Result<Netlink, String> {
        if let Some(address) = &self.room {
            let (card, _) = served::join(address, served::Role::Card).map_err(|error| join_refused(&error))?;
            return Ok(Netlink::over(card, wall_us));
        }
        let receive_buffer = usize::try_from(self.receive_buffer).unwrap_or(usize::MAX).min(i32::MAX as usize / 2);
        let options = Options::default()
            .with_connector_index(self.connector_index)
            .with_allow_user_sender(self.allow_user_sender)
            .with_receive_buffer(receive_buffer);
        Netlink::open(&options).map_err(|error| error.to_string())
    }

    /// What a listener listens to, in words.
    pub fn describe(listener: &Netlink) -> String {
        let (indices, found) = listener.indices();
        let kib = listener.receive_buffer() / 1024;
        let indices: Vec<_> = indices.iter().map(u32::to_string).collect();
        let how = match found {
            Found::Given => "as given",
            Found::Registered => "where the driver is registered",
            Found::Served => return format!("listening to a card in a simulated room, receive buffer {kib} KiB"),
            Found::Guessed => "no CSI driver is registered in /proc/net/connector",
        };
        let indices = indices.join(" and ");
        format!("listening on connector index {indices} ({how}), receive buffer {kib} KiB")
    }
}

/// SIGINT, SIGTERM and SIGHUP as something to wait for.
pub struct Signals {
    fd: SignalFd,
}

impl Signals {
    /// From here on these signals end nothing by themselves. Threads started later inherit that.
    pub fn catch() -> Result<Self, String> {
        let set = SigSet::from_iter([Signal::SIGINT, Signal::SIGTERM, Signal::SIGHUP]);
        let blocked = set
            .thread_block()
            .and_then(|()| SignalFd::with_flags(&set, SfdFlags::SFD_NONBLOCK | SfdFlags::SFD_CLOEXEC));
        blocked.map(|fd| Self { fd }).map_err(|errno| format!("cannot catch signals: {errno}"))
    }
}

impl AsFd for Signals {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.fd.as_fd()
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
        assert_eq!(size("500k"), Ok(512_000));
        assert_eq!(size("2G"), Ok(1 << 31));
        for wrong in ["", "0", "k", "-5M", "1T", "99999999999G"] {
            assert!(size(wrong).is_err(), "{wrong}");
        }
    }
}
