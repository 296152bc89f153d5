//! The second robot: it waits for the first, records while that sends, answers if it is to, and hands its log over.
//!
//! One connection of TCP, in lines: `csi5300-accept 1 CHANNEL MAC` (or `-` for a robot that does not send); `ok MAC` (or `-`), or `no WHY`;
//! `end`; `log BYTES` and the log.

use super::super::super::Words;
use super::super::Args;
use super::{Desk, channel, live};
use crate::commands::live::Signals;
use csi5300::exchange::tdma::{Dialect, Epoch, Phy, Request};
use csi5300::signal::channel::Channel;
use csi5300::source::{CsiSource, Next};
use csi5300::time::Span;
use csi5300_accept::{Collector, Plan, Side};
use csi5300_live::sounding::{Running, Settings, Setup};
use csi5300_live::wait::Monotonic;
use driver_iface::Mac;
use driver_iface::bfee::Antenna;
use driver_iface::radiotap::Bandwidth;
use driver_iface::sounding::wsr;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::fd::AsFd;
use std::time::Duration;

/// The greeting.
const GREETING: &str = "csi5300-accept 1";
/// Modulation of frames and answers.
pub(super) const PHY: Phy = Phy { mcs: 0, bandwidth: Bandwidth::Ht20 };
/// A partner that is silent for this long is given up.
const PATIENCE: Duration = Duration::from_secs(30);
/// Bytes of a line, and of a log, at most.
const LINE: u64 = 256;
const LOG: u64 = 256 << 20;

fn line(from: &mut impl BufRead) -> Words<String> {
    let mut text = String::new();
    let read =
        from.take(LINE).read_line(&mut text).map_err(|error| format!("the other robot does not answer: {error}"))?;
    if read == 0 {
        return Err("the other robot ended the connection".into());
    }
    Ok(text.trim_end().to_owned())
}

fn name(mac: Option<Mac>) -> String {
    mac.map_or_else(|| "-".into(), |mac| mac.to_string())
}

/// The second robot, as the first one has it.
pub(super) struct Helper {
    stream: BufReader<TcpStream>,
    mac: Option<Mac>,
}

impl Helper {
    /// Calls it; `mac` is of the robot that calls, if that sends.
    pub(super) fn call(peer: &str, channel: Channel, mac: Option<Mac>) -> Words<Self> {
        let failed = |error: std::io::Error| {
            format!(
                "cannot reach the second robot at {peer}: {error}. Does `csi5300 doctor --accept` run there, with `assist` in its TOML?"
            )
        };
        let mut stream = TcpStream::connect(peer).map_err(failed)?;
        stream.set_read_timeout(Some(PATIENCE)).map_err(failed)?;
        writeln!(stream, "{GREETING} {channel} {}", name(mac)).map_err(failed)?;
        let mut stream = BufReader::new(stream);
        let said = line(&mut stream)?;
        match said.split_once(' ') {
            Some(("ok", mac)) => Ok(Self { stream, mac: mac.parse().ok() }),
            Some(("no", why)) => Err(format!("the second robot refuses: {why}")),
            _ => Err(format!("a program other than `csi5300 doctor --accept` answers at {peer}")),
        }
    }

    /// Its MAC, if it answers.
    pub(super) fn mac(&self) -> Option<Mac> {
        self.mac
    }

    /// Ends its recording; its log.
    pub(super) fn end(mut self) -> Words<Vec<u8>> {
        let failed = |error: std::io::Error| format!("the second robot's log did not come: {error}");
        writeln!(self.stream.get_mut(), "end").map_err(failed)?;
        let said = line(&mut self.stream)?;
        let len = said.strip_prefix("log ").and_then(|len| len.parse().ok()).filter(|len| *len <= LOG);
        let len: u64 = len.ok_or_else(|| format!("the second robot has no log: {said}"))?;
        let mut log = Vec::new();
        self.stream.take(len).read_to_end(&mut log).map_err(failed)?;
        if (log.len() as u64) < len {
            return Err(format!("{} of {len} bytes of the second robot's log came", log.len()));
        }
        note!("{len} bytes of log came from the second robot");
        Ok(log)
    }
}

/// Refuses a name that no interface has.
fn must_be_there(interface: &str) -> Words<()> {
    let is_there = std::path::Path::new("/sys/class/net").join(interface).exists();
    if is_there { Ok(()) } else { Err(format!("there is no interface {interface}: `ip link` lists them")) }
}

/// Waits for the first robot and assists it.
pub(super) fn assist(args: &Args, desk: &Desk, address: &str) -> Words<()> {
    desk.interface.as_deref().map_or(Ok(()), must_be_there)?;
    let signals = Signals::catch().map_err(|error| error.to_string())?;
    let failed = |error: std::io::Error| format!("cannot wait at {address}: {error}");
    let waiting = TcpListener::bind(address).map_err(failed)?;
    note!("waiting at {} for the first robot; Ctrl-C ends it", waiting.local_addr().map_err(failed)?);
    let clock = Monotonic::new();
    let ready = clock.wait([waiting.as_fd(), signals.as_fd()], None).map_err(|error| error.to_string())?;
    if ready[1] {
        return Ok(());
    }
    let (stream, _) = waiting.accept().map_err(failed)?;
    stream.set_read_timeout(Some(PATIENCE)).map_err(failed)?;
    stream.set_write_timeout(Some(PATIENCE)).map_err(failed)?;
    let mut stream = BufReader::new(stream);
    let made = agree(args, desk, &line(&mut stream)?);
    let (mut listener, running, own, told) = match made {
        Ok(made) => made,
        Err(why) => {
            let _ = writeln!(stream.get_mut(), "no {why}");
            return Err(why);
        }
    };
    writeln!(stream.get_mut(), "ok {}", name(own)).map_err(failed)?;
    note!("the first robot came, on channel {told}: recording until it ends");
    let mut collector = Collector::new(Plan::new(told));
    loop {
        let next = listener.receive(clock.now()).map_err(|error| error.to_string())?;
        let (pending, over) = (matches!(next, Next::Pending), matches!(next, Next::End(_)));
        collector.heard(Side::Near, &next);
        if over {
            break;
        }
        while running.as_ref().and_then(Running::news).is_some() {}
        if pending {
            let latest = clock.now() + Span::from_ms(200);
            let until = listener.next_at().map_or(latest, |at| at.min(latest));
            let fds = [listener.as_fd(), stream.get_ref().as_fd(), signals.as_fd()];
            let ready = clock.wait(fds, Some(until)).map_err(|error| error.to_string())?;
            if ready[2] {
                return Err("ended before the first robot did".into());
            }
            if ready[1] {
                break;
            }
        }
    }
    let said = line(&mut stream)?;
    if said != "end" {
        return Err(format!("unexpected message from the first robot: {said}"));
    }
    if let Some(running) = running {
        running.stop().map_err(|error| error.to_string())?;
    }
    let log = collector.finish().near.log;
    let stream = stream.get_mut();
    writeln!(stream, "log {}", log.len()).and_then(|()| stream.write_all(&log)).map_err(failed)?;
    note!("{} bytes of log went to the first robot, which judges", log.len());
    Ok(())
}

/// The first robot's request: the card, the answering MAC, and the channel.
type Agreed = (csi5300_live::listener::Listener, Option<Running>, Option<Mac>, Channel);

fn agree(args: &Args, desk: &Desk, said: &str) -> Words<Agreed> {
    let words: Vec<&str> = said.strip_prefix(GREETING).unwrap_or_default().split_whitespace().collect();
    let [told, mac] = words.as_slice() else { return Err(format!("no greeting of `csi5300 doctor --accept`: {said}")) };
    let own = channel(args, desk)?;
    if *told != own.to_string() {
        return Err(format!("the first robot is on channel {told}, the second on {own}"));
    }
    let listener = live::open(args, desk)?;
    if !desk.answer {
        return Ok((listener, None, None, own));
    }
    let first =
        mac.parse().map_err(|_| "`answer` needs a first robot that sends: `send = true` in its TOML".to_owned())?;
    let (running, mac) = answerer(desk, first)?;
    Ok((listener, Some(running), Some(mac), own))
}

/// Answers the first robot's frames on the interface, from user space.
fn answerer(desk: &Desk, first: Mac) -> Words<(Running, Mac)> {
    let text = |error: csi5300::source::Error| error.to_string();
    let dialect = Dialect::Wsr { first_len: wsr::DEFAULT_LEN as u16 };
    let setup = Setup {
        interface: desk.interface.clone().unwrap_or_default(),
        mac: None,
        peers: vec![first],
        // It answers each frame when it comes, and sends none of its own: the plan only has to fit.
        request: Request::new(1, 100.0).with_phy(PHY).with_dialect(dialect).with_turn_around_us(6_000),
        own_index: 0,
        key: None,
    };
    if let Some(interface) = &desk.interface {
        crate::commands::sound::see_to_rate(interface, PHY, Antenna::A)?;
    }
    let (monitor, mac) = live::air(desk, &setup.options())?;
    let clock = Monotonic::new();
    let opened =
        setup.open_on(monitor, |config| (config.epoch, config.start) = (Epoch::Heard(clock.now()), clock.now()));
    let running = Running::start_opened(opened.map_err(text)?, clock, Settings::default()).map_err(text)?;
    Ok((running, mac))
}
