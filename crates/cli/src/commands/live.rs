//! What the live commands share: kinds of arguments, signals, refusals; what they listen to (the kernel's connector, or the card under
//! the kernel's own driver), and its messages.

use super::InWords;
use csi5300::time::Span;
use csi5300_live::listener::Listener;
use csi5300_live::netlink::{Netlink, Options};
use csi5300_live::stock::{self, Stock};
pub use csi5300_live::wait::Signals;
use csi5300_live::wait::wall_us;
use csi5300_sim::served::{self, Address};
use driver_iface::Mac;
use std::fmt::Write;

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

/// The number that begins a text, and the letters behind it.
fn number_and_unit(text: &str) -> (&str, &str) {
    text.split_at(text.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(text.len()))
}

/// A length of time: `250ms`, `10s`, `5m`, `1h`; a bare number is seconds.
pub fn duration(text: &str) -> Result<Span, String> {
    let (number, unit) = number_and_unit(text);
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
    let size = size(text)?;
    if size >= LEAST_ROTATION { Ok(size) } else { Err("64k or more: a record is as large".into()) }
}

/// Bytes of a log at least before it is continued in another file.
const LEAST_ROTATION: u64 = 64 << 10;

/// A multiple of real time, above 0; `max` for no waiting at all.
pub fn speed(text: &str) -> Result<f64, String> {
    if text == "max" {
        return Ok(f64::INFINITY);
    }
    let speed = text.parse().ok().filter(|speed: &f64| *speed > 0.0 && speed.is_finite());
    speed.ok_or_else(|| "above 0, or max".into())
}

/// A size in bytes: `4096`, `500k`, `100M`, `2G` (powers of 1024).
pub fn size(text: &str) -> Result<u64, String> {
    let (number, unit) = number_and_unit(text);
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

/// Receive buffer to ask the kernel for, bytes.
const RECEIVE_BUFFER: u64 = 32 << 20;

// How to listen to the card.
#[derive(clap::Args, Clone, Debug)]
pub struct Listening {
    #[command(flatten)]
    pub card: Card,
    /// Accept messages of other programs too: emulators, `replay --connector`
    #[arg(long)]
    #[arg(conflicts_with = "stock")]
    pub allow_user_sender: bool,
    /// Use a robot of a simulated room (`simulate SCENE --serve --socket PATH`) as the card
    #[arg(long, value_name = "PATH#ROBOT", conflicts_with_all = ["connector_index", "allow_user_sender"])]
    #[arg(conflicts_with = "stock")]
    pub room: Option<Address>,
}

// How the card's records arrive.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct Card {
    /// Connector index of the driver [default: found by its name]
    #[arg(long, value_name = "INDEX", value_parser = clap::value_parser!(u32).range(1..=32))]
    connector_index: Option<u32>,
    /// Take packets from the kernel's unpatched driver by an eBPF program (Linux 5.8 or later), and make the WSR
    /// driver's or csitool's records, with or without frames (0xC1)
    #[arg(
        long,
        value_enum,
        value_name = "RECORDS",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "wsr",
        overrides_with = "stock",
        conflicts_with = "connector_index"
    )]
    stock: Option<Records>,
}

impl Card {
    /// True if an option names it.
    pub fn is_named(&self) -> bool {
        self.connector_index.is_some() || self.stock.is_some()
    }
}

/// The driver whose records are made, with or without frames.
#[derive(clap::ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
enum Records {
    Wsr,
    WsrFrames,
    Csitool,
    CsitoolFrames,
}

/// What a command needs of the card's records.
#[derive(Clone, Copy, Debug, Default)]
pub struct Needs {
    /// This robot's MAC, if known: records of other robots' cards on this machine are then ignored.
    pub own: Option<Mac>,
    /// The frames (0xC1) too: their tags are checked.
    pub frames: bool,
    /// Receive buffer to ask the kernel for, bytes, if not the default.
    pub receive_buffer: Option<u64>,
}

impl Listening {
    /// Opens what the arguments name.
    pub fn open(&self, needs: Needs) -> Result<Listener, String> {
        let receive_buffer = usize::try_from(needs.receive_buffer.unwrap_or(RECEIVE_BUFFER)).unwrap_or(usize::MAX);
        if let Some(asked) = self.card.stock {
            let layout = match asked {
                Records::Wsr | Records::WsrFrames => driver_iface::bfee::Layout::Wsr,
                Records::Csitool | Records::CsitoolFrames => driver_iface::bfee::Layout::Stock,
            };
            let frames = matches!(asked, Records::WsrFrames | Records::CsitoolFrames) || needs.frames;
            let records = driver_iface::stock::Options { layout, frames, ..Default::default() };
            let options = stock::Options { records, ring: receive_buffer, own: needs.own };
            return Ok(Listener::Stock(Box::new(Stock::open(&options).in_words()?)));
        }
        if let Some(address) = &self.room {
            let (card, _) = served::join(address, served::Role::Card).map_err(|error| join_refused(&error))?;
            return Ok(Listener::Connector(Box::new(Netlink::over(card, wall_us))));
        }
        let receive_buffer = receive_buffer.min(i32::MAX as usize / 2);
        let (connector_index, allow_user_sender) = (self.card.connector_index, self.allow_user_sender);
        let options = Options { connector_index, allow_user_sender, receive_buffer, ..Options::default() };
        Ok(Listener::Connector(Box::new(Netlink::open(&options).in_words()?)))
    }
}

/// Lines for the summary.
pub fn summary(listener: &Listener) -> String {
    match listener {
        Listener::Connector(listener) => connector_summary(listener),
        Listener::Stock(stock) => stock_summary(stock),
    }
}

/// Printed if the card receives but sends no CSI.
const NO_CSI: &str = "  the card received frames and sent no CSI: does csitool's firmware run, and are they HT frames to and \
                      from 00:16:ea:12:34:56? The patched drivers ask the card for CSI, which this program cannot: with the \
                      module csi5300 loaded before the channel is set it is asked, too\n";

/// A line for each counter that is not zero.
fn counted(text: &mut String, counts: &[(u64, &str)]) {
    for (count, what) in counts.iter().filter(|(count, _)| *count > 0) {
        let _ = writeln!(text, "  {count} {what}");
    }
}

fn connector_summary(listener: &Netlink) -> String {
    let mut text = String::new();
    let counters = listener.counters();
    if counters.overruns > 0 {
        let _ = writeln!(
            text,
            "  {} overruns: the kernel dropped {} messages, bfee_count has gaps of {}",
            counters.overruns, counters.kernel_drops, counters.overrun_bfee_gap
        );
    }
    let counts = [
        (counters.other_bfee_gap, "numbers missing from bfee_count before this socket"),
        (counters.truncated, "datagrams longer than the buffer"),
        (counters.malformed, "datagrams that contradict themselves"),
        (counters.foreign, "foreign messages ignored"),
        (counters.user_senders, "messages from other programs refused (--allow-user-sender takes them)"),
    ];
    counted(&mut text, &counts);
    text
}

fn stock_summary(stock: &Stock) -> String {
    let mut text = String::new();
    let counters = stock.counters();
    let cards = counters.cards;
    let _ = writeln!(
        text,
        "  {} packets of the driver, {} of them receptions, {} with CSI",
        counters.hits, cards.phy, cards.bfee
    );
    let counts = [
        (counters.ring_full, "packets dropped, the ring was full (--receive-buffer makes it larger)"),
        (counters.unreadable, "packets that could not be read"),
        (counters.missed, "packets missed: the kernel did not run the program at them"),
        (counters.malformed, "events that contradict themselves"),
        (cards.bad_phy.into(), "receptions (0xC0) too short"),
        (cards.bad_mpdu.into(), "frames (0xC1) with inconsistent lengths"),
        (cards.bad_bfee.into(), "inconsistent CSI notifications (0xBB), dropped"),
        (cards.no_phy.into(), "CSI notifications without their reception (0xC0), dropped"),
        (cards.no_order.into(), "records without an antenna order from the card"),
        (cards.no_sender.into(), "records of an unknown sender: no good frame (0xC1) came with them"),
        (counters.held_back, "frames before the first CSI, not recorded"),
        (counters.others, "records of other robots' cards on this machine, ignored"),
        (counters.reattached, "reloads of the driver; up to a second of records after each is missing"),
    ];
    counted(&mut text, &counts);
    if counters.cards_seen > 1 {
        let _ = writeln!(text, "  {} cards, or one whose driver was reloaded", counters.cards_seen);
    }
    if counters.hits == 0 {
        text.push_str(
            "  the card sent no packet at all: is its interface up, in monitor mode, on the right channel?\n",
        );
    } else if cards.phy > 0 && cards.bfee == 0 {
        text.push_str(NO_CSI);
    }
    text
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
