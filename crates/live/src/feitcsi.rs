//! Reads an AX200's or AX210's records from FeitCSI: from its UDP socket (`feitcsi --udp-socket`) or its standard output.
//!
//! FeitCSI owns the socket. A datagram with a command line starts a measurement, and FeitCSI sends each record to the
//! sender of that datagram. `stop` ends the measurement and removes FeitCSI's monitor interface (`UdpSocket.cpp` of FeitCSI 2).

use crate::netlink::widen;
use crate::wait::Monotonic;
use csi5300::source::other_card::{Pieces, Translator};
use csi5300::source::{CsiSource, Error, Loss, Next, Origin, Stamps};
use csi5300::time::Instant;
use driver_iface::record::{LENGTH_FIELD, Record, Tail, code, written};
use nix::sys::socket::{ControlMessageOwned, MsgFlags, recvmsg, setsockopt, sockopt};
use std::fs::File;
use std::io::{self, ErrorKind, IoSliceMut, Read};
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::str::FromStr;

/// Limit of a record's body, bytes.
const MOST: usize = 60_000;
/// Requested receive buffer, bytes; the kernel may grant less.
const RECEIVE_BUFFER: usize = 8 << 20;
/// FeitCSI reads at most this much of a command, bytes.
const LONGEST_COMMAND: usize = 1_023;
const STOP: &[u8] = b"stop";

/// A measurement to start: FeitCSI's address and options, as in `127.0.0.1:8008 --frequency 5180 --channel-width 80
/// --format VHT`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Command {
    /// FeitCSI's address; its port is 8008.
    pub to: SocketAddr,
    /// Options of FeitCSI's command line. If empty: HT frames of 20 MHz at 2,412 MHz.
    pub options: String,
}

impl FromStr for Command {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (to, options) = text.trim().split_once(char::is_whitespace).unwrap_or((text.trim(), ""));
        let to = to.parse().map_err(|_| {
            format!("`{to}` is not an address: give that of FeitCSI, as in 127.0.0.1:8008 or \"127.0.0.1:8008 --frequency 5180 --channel-width 80 --format VHT\"")
        })?;
        let command = Self { to, options: options.trim().into() };
        match command.line().len() {
            ..=LONGEST_COMMAND => Ok(command),
            len => Err(format!("this command has {len} bytes, and FeitCSI reads at most {LONGEST_COMMAND} bytes")),
        }
    }
}

impl Command {
    /// The command line sent to FeitCSI; the first word is the program's name.
    fn line(&self) -> String {
        format!("feitcsi {}", self.options).trim_end().to_owned()
    }
}

/// FeitCSI's output, live and unchanged. Each of its records, and any other bytes, is the body of a record here.
#[derive(Debug)]
pub struct Frames {
    way: Way,
    pieces: Pieces,
    /// The current piece; its first `given` bytes have been returned.
    body: Vec<u8>,
    given: usize,
    /// Records returned.
    number: u64,
    /// Dropped datagrams that were reported.
    told: u32,
    wall_us: fn() -> Option<i64>,
}

/// FeitCSI's output as records of a 5300 (see [`csi5300::source::other_card`]), from [`Frames`] or a source that wraps
/// them.
///
/// Records have FeitCSI's host time. Older versions write none; then records have the frames' host time.
#[derive(Debug)]
pub struct FeitCsi<S = Frames> {
    /// The source of the frames.
    pub frames: S,
    translator: Translator,
    /// Bytes of frames received.
    offset: u64,
    /// Translated records; those from `given` on have not been returned.
    buffer: Vec<u8>,
    given: usize,
    stamps: Stamps,
    /// Records returned.
    number: u64,
}

/// The source of bytes.
#[derive(Debug)]
enum Way {
    Datagrams(Measurement),
    Stream(File),
}

/// A running measurement; dropping it stops the measurement.
#[derive(Debug)]
struct Measurement {
    socket: UdpSocket,
    /// Room for the kernel's count of the datagrams that found no room before the one received; and that count, which wraps.
    control: Vec<u8>,
    dropped: u32,
}

impl Measurement {
    fn start(command: &Command) -> io::Result<Self> {
        let own: SocketAddr = match command.to {
            SocketAddr::V4(_) => (Ipv4Addr::UNSPECIFIED, 0).into(),
            SocketAddr::V6(_) => (Ipv6Addr::UNSPECIFIED, 0).into(),
        };
        let socket = UdpSocket::bind(own)?;
        socket.connect(command.to)?;
        socket.set_nonblocking(true)?;
        // CAP_NET_ADMIN allows sizes above the system's limit. A smaller buffer works too, for shorter delays.
        let _ = widen(&socket, RECEIVE_BUFFER);
        setsockopt(&socket, sockopt::RxqOvfl, &1)?;
        // A measurement that is still running would send each record twice.
        socket.send(STOP)?;
        socket.send(command.line().as_bytes())?;
        Ok(Self { socket, control: nix::cmsg_space!(u32), dropped: 0 })
    }

    fn receive(&mut self, room: &mut [u8]) -> io::Result<usize> {
        let mut parts = [IoSliceMut::new(room)];
        let flags = MsgFlags::MSG_DONTWAIT;
        let message = recvmsg::<()>(self.socket.as_raw_fd(), &mut parts, Some(&mut self.control), flags)?;
        for said in message.cmsgs()? {
            if let ControlMessageOwned::RxqOvfl(dropped) = said {
                self.dropped = dropped;
            }
        }
        Ok(message.bytes)
    }
}

impl Drop for Measurement {
    fn drop(&mut self) {
        // Fails if FeitCSI has ended.
        let _ = self.socket.send(STOP);
    }
}

/// The error of a failed read; a datagram that FeitCSI, if it is `at` an address, refused has its own message.
fn refused(error: io::Error, at: Option<SocketAddr>) -> Error {
    let what = match at.filter(|_| error.kind() == ErrorKind::ConnectionRefused) {
        Some(to) => format!(
            "FeitCSI does not listen at {to}: start `sudo feitcsi --udp-socket`; it exits at an unknown option and prints its \
             name"
        ),
        None => "reading FeitCSI's output".into(),
    };
    Error::io(what)(error)
}

impl Way {
    fn address(&self) -> Option<SocketAddr> {
        if let Self::Datagrams(measurement) = self { measurement.socket.peer_addr().ok() } else { None }
    }

    fn dropped(&self) -> u32 {
        if let Self::Datagrams(measurement) = self { measurement.dropped } else { 0 }
    }
}

impl Read for Way {
    fn read(&mut self, room: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Stream(stream) => {
                // O_NONBLOCK would also affect the program at the other end of a terminal or pipe.
                let clock = Monotonic::new();
                let [is_ready] = clock.wait([stream.as_fd()], Some(Instant::ZERO)).map_err(io::Error::other)?;
                if is_ready { stream.read(room) } else { Err(ErrorKind::WouldBlock.into()) }
            }
            Self::Datagrams(measurement) => loop {
                // An empty datagram does not end the stream.
                match measurement.receive(room) {
                    Ok(0) => {}
                    read => return read,
                }
            },
        }
    }
}

impl Frames {
    /// Starts a measurement over FeitCSI's UDP socket; dropping the frames stops it.
    ///
    /// # Errors
    /// If FeitCSI does not listen at the address, or a socket cannot be opened.
    pub fn ask(command: &Command, wall_us: fn() -> Option<i64>) -> Result<Self, Error> {
        let started = Measurement::start(command).map_err(|error| refused(error, Some(command.to)))?;
        Ok(Self::new(Way::Datagrams(started), wall_us))
    }

    /// Reads FeitCSI's standard output, from a pipe for example.
    #[must_use]
    pub fn read(output: OwnedFd, wall_us: fn() -> Option<i64>) -> Self {
        Self::new(Way::Stream(output.into()), wall_us)
    }

    fn new(way: Way, wall_us: fn() -> Option<i64>) -> Self {
        Self { way, pieces: Pieces::default(), body: Vec::new(), given: 0, number: 0, told: 0, wall_us }
    }

    /// Datagrams that the kernel dropped so far, because its queue was full.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.told.into()
    }
}

impl CsiSource for Frames {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        loop {
            self.body.drain(..self.given);
            self.given = 0;
            if !self.body.is_empty() {
                break;
            }
            if let Some(piece) = self.pieces.piece() {
                self.body.extend_from_slice(piece.bytes);
                break;
            }
            if self.pieces.has_ended() {
                return Ok(Next::End(Tail::Clean));
            }
            match self.pieces.fill(&mut self.way) {
                Ok(_) => {
                    let dropped = self.way.dropped();
                    let more = dropped.wrapping_sub(std::mem::replace(&mut self.told, dropped));
                    if more > 0 {
                        return Ok(Next::Lost(Loss::Overrun { dropped: Some(more.into()) }));
                    }
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(Next::Pending),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(refused(error, self.way.address())),
            }
        }
        let stamps = Stamps { at: now, host_us: (self.wall_us)(), origin: Origin::Live { number: self.number } };
        self.number += 1;
        // Only unreadable bytes are longer than this.
        self.given = self.body.len().min(MOST);
        Ok(Next::Record(stamps, Record { code: code::BFEE, body: self.body.get(..self.given).unwrap_or_default() }))
    }

    fn next_at(&self) -> Option<Instant> {
        None
    }
}

impl AsFd for Frames {
    fn as_fd(&self) -> BorrowedFd<'_> {
        match &self.way {
            Way::Datagrams(measurement) => measurement.socket.as_fd(),
            Way::Stream(stream) => stream.as_fd(),
        }
    }
}

impl<S> FeitCsi<S> {
    /// Translates the frames of this source.
    pub fn new(frames: S) -> Self {
        let (translator, buffer, stamps) = (Translator::default(), Vec::new(), Stamps::default());
        Self { frames, translator, offset: 0, buffer, given: 0, stamps, number: 0 }
    }
}

impl<S: CsiSource> CsiSource for FeitCsi<S> {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        let len = loop {
            let left = self.buffer.get(self.given..).unwrap_or_default();
            if let Some(record) = written(left).next() {
                break record.len();
            }
            match self.frames.receive(now)? {
                Next::Record(stamps, record) => {
                    self.buffer.drain(..self.given);
                    self.given = 0;
                    self.translator.take_bytes(record.body, self.offset, &mut self.buffer);
                    self.offset += record.body.len() as u64;
                    self.stamps = stamps;
                }
                Next::Pending => return Ok(Next::Pending),
                Next::Lost(loss) => return Ok(Next::Lost(loss)),
                Next::End(tail) => return Ok(Next::End(tail)),
            }
        };
        self.given += len;
        let stamps = Stamps { at: now, origin: Origin::Live { number: self.number }, ..self.stamps };
        self.number += 1;
        let message = self.buffer.get(self.given - len + LENGTH_FIELD..self.given).unwrap_or_default();
        Ok(Record::from_message(message).map_or(Next::Pending, |record| Next::Record(stamps, record)))
    }

    fn next_at(&self) -> Option<Instant> {
        self.frames.next_at()
    }
}

impl<S: AsFd> AsFd for FeitCsi<S> {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.frames.as_fd()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300_sim::{Room, Scene};
    use driver_iface::record::code;
    use std::io::Write;

    /// FeitCSI's output for some frames: whole, and by frame.
    fn written_by_feitcsi() -> (Vec<u8>, Vec<Vec<u8>>) {
        let scene = "duration_s = 1.0\ncard = \"ax210\"\nsounding.rate_hz = 20\n[[robot]]\nname = \"rx\"\n\
                     [[robot]]\nname = \"tx\"\nposition_m = [3.0, 0.0, 0.0]\n";
        let run = Room::new(&Scene::parse(scene).unwrap()).unwrap().run().unwrap();
        let log = run.robots[0].log.clone();
        let one = log.len() / run.robots[0].records as usize;
        (log.clone(), log.chunks(one).map(<[u8]>::to_vec).collect())
    }

    /// Adds all records available now. True if the source has ended.
    fn add_drained(all: &mut Vec<(u8, Vec<u8>)>, source: &mut FeitCsi) -> bool {
        loop {
            match source.receive(Instant::ZERO).unwrap() {
                Next::Record(stamps, record) => {
                    assert_eq!((stamps.origin, stamps.host_us), (Origin::Live { number: all.len() as u64 }, Some(7)));
                    all.push((record.code, record.body.to_vec()));
                }
                Next::Pending => return false,
                Next::End(tail) => {
                    assert_eq!(tail, Tail::Clean);
                    return true;
                }
                Next::Lost(loss) => panic!("{loss:?}"),
            }
        }
    }

    #[test]
    fn datagrams_and_a_stream_give_the_same_records() {
        let (log, frames) = written_by_feitcsi();
        let mut none = Vec::new();
        let (mut pipe, output) = std::io::pipe().map(|(read, write)| (write, read)).unwrap();
        let mut streamed = FeitCsi::new(Frames::read(output.into(), || Some(7)));
        assert!(!add_drained(&mut none, &mut streamed) && none.is_empty());
        pipe.write_all(&log).unwrap();
        drop(pipe);
        let (mut of_stream, mut ended) = (Vec::new(), false);
        // Programs that other tests start hold copies of the pipe between their fork and their exec.
        while !ended {
            ended = add_drained(&mut of_stream, &mut streamed);
        }
        assert!(of_stream.len() == 2 * frames.len(), "{}", of_stream.len());
        assert!(of_stream.chunks(2).all(|two| [two[0].0, two[1].0] == [code::CARD_CLOCK, code::BFEE]));

        // A stand-in for FeitCSI: receives commands, and sends records to their sender.
        let feitcsi = UdpSocket::bind("127.0.0.1:0").unwrap();
        let to = feitcsi.local_addr().unwrap();
        let command: Command = format!("{to} --frequency 5540 --format HESU").parse().unwrap();
        let mut source = FeitCsi::new(Frames::ask(&command, || Some(7)).unwrap());
        let asked = || {
            let mut text = [0; 2_000];
            let (len, from) = feitcsi.recv_from(&mut text).unwrap();
            (String::from_utf8(text[..len].to_vec()).unwrap(), from)
        };
        let (stop, (started, asker)) = (asked().0, asked());
        assert_eq!((&*stop, &*started), ("stop", "feitcsi --frequency 5540 --format HESU"));
        assert!(!add_drained(&mut none, &mut source) && none.is_empty());
        feitcsi.send_to(&[], asker).unwrap();
        frames.iter().for_each(|frame| assert_eq!(feitcsi.send_to(frame, asker).unwrap(), frame.len()));
        let mut of_datagrams = Vec::new();
        while of_datagrams.len() < of_stream.len() {
            assert!(!add_drained(&mut of_datagrams, &mut source));
        }
        assert!(of_datagrams == of_stream, "{}", of_datagrams.len());
        drop(source);
        assert_eq!(asked(), ("stop".to_owned(), asker));
    }

    #[test]
    fn datagrams_that_find_no_room_are_counted_where_they_are_missing() {
        let feitcsi = UdpSocket::bind("127.0.0.1:0").unwrap();
        let command: Command = feitcsi.local_addr().unwrap().to_string().parse().unwrap();
        let mut source = Frames::ask(&command, || Some(7)).unwrap();
        let asker = feitcsi.recv_from(&mut [0; 99]).unwrap().1;
        let frame = written_by_feitcsi().1.remove(0);
        let mut all = |sent: u64| {
            (0..sent).for_each(|_| assert_eq!(feitcsi.send_to(&frame, asker).unwrap(), frame.len()));
            let (mut came, mut lost) = (0, Vec::new());
            loop {
                match source.receive(Instant::ZERO).unwrap() {
                    Next::Record(..) => came += 1,
                    Next::Lost(loss) => lost.push((came, loss)),
                    _ => return (came, lost),
                }
            }
        };
        let (came, lost) = all(20_000);
        assert!(came > 0 && came < 20_000 && lost.is_empty(), "{came}, {lost:?}");
        let dropped = Some(20_000 - came);
        assert_eq!(all(1), (1, vec![(0, Loss::Overrun { dropped })]));
        assert_eq!((all(1), Some(source.dropped())), ((1, Vec::new()), dropped));
    }

    #[test]
    fn a_command_has_an_address_and_options_and_needs_a_listener() {
        let command: Command = " [::1]:8008\t -f 5180 ".parse().unwrap();
        assert_eq!((command.to.port(), &*command.line()), (8_008, "feitcsi -f 5180"));
        assert_eq!("127.0.0.1:8008".parse::<Command>().unwrap().line(), "feitcsi");
        let refused = |text: &str| text.parse::<Command>().unwrap_err();
        assert!(refused("8008").contains("`8008` is not an address"), "{}", refused("8008"));
        let long = format!("127.0.0.1:8008 {}", "-v ".repeat(400));
        assert!(refused(&long).contains("1023 bytes"), "{}", refused(&long));

        let free = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let command: Command = free.to_string().parse().unwrap();
        // The kernel reports the refused datagram at a later call, once no program that another test starts holds a copy of the port.
        let error = loop {
            let asked = Frames::ask(&command, || None);
            if let Err(error) = asked.and_then(|mut frames| frames.receive(Instant::ZERO).map(|_| ())) {
                break error;
            }
        };
        assert!(
            error.to_string().contains(&format!("FeitCSI does not listen at {free}: start `sudo feitcsi")),
            "{error}"
        );
    }
}
