//! The room's side: programs, frames in; frames, records and poses out. It neither waits nor reads a clock.

use super::place::Place;
use super::{GREETING, Role, WORDS, seqpacket};
use crate::{Interface, Odometer, Port, Room};
use csi5300::motion::odometry::{NextPose, OdometrySource, csv};
use csi5300::source::{CsiSource, Error, Next};
use csi5300::time::{Instant, Span};
use driver_iface::connector::{CN_IDX, CN_VAL, MAX_DATAGRAM, Repr as Message};
use driver_iface::radiotap::{Bandwidth, Mcs, Packet, Repr};
use driver_iface::record::{Record, code};
use nix::errno::Errno;
use nix::sys::epoll::{Epoll, EpollCreateFlags, EpollEvent, EpollFlags};
use nix::sys::socket::{Backlog, ControlMessageOwned, MsgFlags, SockFlag, listen, recvmsg, send, setsockopt, sockopt};
use nix::sys::time::TimeSpec;
use std::io::{ErrorKind, IoSliceMut};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::os::unix::net::UnixListener;
use std::path::Path;

/// Longest radiotap header and frame that are taken, bytes (IEEE80211_MAX_FRAME_LEN and a header of ours).
const LONGEST: usize = 2_352 + driver_iface::radiotap::MAX_EMIT_LEN;
/// Limit of programs: more than any scene's robots need.
const CLIENTS: usize = 256;
/// A new program must send its request within this time.
const PATIENCE: Span = Span::from_ms(5_000);
/// Shortest frame on air, and limit of a card's queue.
const SHORTEST: Span = Span::from_us(40);
const QUEUED: Span = Span::from_ms(100);
/// Requested send buffer for a client that does not read, bytes: about a second of records at 200 a second.
const SEND_BUFFER: usize = 1 << 18;

/// Everything counted at a served room's socket.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct ServedCounts {
    /// Programs that joined.
    pub joined: u64,
    /// Programs that were refused.
    pub refused: u64,
    /// Frames taken from programs.
    pub frames: u64,
    /// Frames not taken: no radiotap header, too long, another channel width, several streams.
    pub bad_frames: u64,
    /// Messages to programs that did not read them in time.
    pub untaken: u64,
    /// Records sent to programs, once for each that listens.
    pub records: u64,
}

/// A program that joined.
#[derive(Debug)]
struct Client {
    socket: OwnedFd,
    /// Its requested stream and robot, once known.
    what: Option<(Role, usize)>,
    /// When it came.
    since: Instant,
    /// When its queued frames would be on air.
    free_at: Instant,
}

impl Client {
    /// True, and counted, for a frame at `at` that fits a card's queue.
    fn has_air(&mut self, at: Instant) -> bool {
        let free_at = self.free_at.max(at);
        let has_air = free_at - at <= QUEUED;
        if has_air {
            self.free_at = free_at + SHORTEST;
        }
        has_air
    }
}

/// Streams of a robot in use.
#[derive(Debug, Default)]
struct Robot {
    air: Option<Interface>,
    card: Option<Port>,
    poses: Option<Odometer>,
}

/// A frame to be put on air.
struct Frame {
    at: Instant,
    robot: usize,
    mcs: u8,
    bytes: Vec<u8>,
}

/// A room's socket. Never blocks; wait on its file descriptor, and until the time that [`Server::turn`] gives.
#[derive(Debug)]
pub struct Server {
    /// Readable when the listener or any client is.
    ready: Epoll,
    /// A type of the standard library for its safe `accept`; the socket is SOCK_SEQPACKET.
    listener: UnixListener,
    place: Place,
    clients: Vec<Client>,
    robots: Vec<Robot>,
    buffer: Box<[u8]>,
    counts: ServedCounts,
    told: Option<String>,
}

/// The outcome of a message to a program.
enum Sent {
    Yes,
    NoRoom,
    Gone,
}

impl Server {
    /// Opens the socket. One that an earlier room left behind is replaced.
    ///
    /// # Errors
    /// [`PlaceError`](super::PlaceError) when what is there is no socket, or one that is in use; when the path cannot be used.
    pub fn bind(path: &Path) -> Result<Self, Error> {
        let io = |errno: Errno| {
            let what = format!("cannot serve a room at {}", path.display());
            Error::Io { what, source: errno.into() }
        };
        let listener = seqpacket(SockFlag::SOCK_NONBLOCK).map_err(io)?;
        let ready = Epoll::new(EpollCreateFlags::EPOLL_CLOEXEC).map_err(io)?;
        ready.add(&listener, EpollEvent::new(EpollFlags::EPOLLIN, 0)).map_err(io)?;
        let place = Place::take(&listener, path)?;
        if let Err(errno) = listen(&listener, Backlog::MAXALLOWABLE) {
            place.leave();
            return Err(io(errno));
        }
        Ok(Self {
            ready,
            listener: listener.into(),
            place,
            clients: Vec::new(),
            robots: Vec::new(),
            buffer: vec![0; MAX_DATAGRAM.max(LONGEST)].into_boxed_slice(),
            counts: ServedCounts::default(),
            told: None,
        })
    }

    /// Everything counted so far.
    #[must_use]
    pub fn counts(&self) -> ServedCounts {
        self.counts
    }

    /// The first problem with a program's frames, once.
    pub fn notice(&mut self) -> Option<String> {
        self.told.take_if(|told| !told.is_empty()).inspect(|_| self.told = Some(String::new()))
    }

    /// Puts on air what programs handed over until `now`, each frame at its own time, lets the room's time pass to
    /// `now` and hands out what is due. `wall_us` is the host's wall clock at `now`, on which the kernel stamps
    /// messages; without it frames are of `now`. Returns when to call again if nobody sends before; `None` at the
    /// scene's end.
    ///
    /// # Errors
    /// If the socket fails. A program's behaviour is no error.
    pub fn turn(&mut self, room: &mut Room, now: Instant, wall_us: Option<i64>) -> Result<Option<Instant>, Error> {
        self.robots.resize_with(room.scene().robot.len(), Robot::default);
        self.accept(now)?;
        let (mut frames, gone) = self.listen(room, now, wall_us);
        frames.sort_by_key(|frame| frame.at);
        for frame in frames {
            let robot = self.robots.get_mut(frame.robot);
            let taken =
                robot.and_then(|robot| robot.air.as_mut()).map(|air| air.inject_at(frame.at, &frame.bytes, frame.mcs));
            match taken {
                Some(Ok(())) => self.counts.frames += 1,
                Some(Err(error)) => self.refuse(error.to_string()),
                None => {}
            }
        }
        gone.into_iter().for_each(|robot| self.robots[robot].air = None);
        room.advance(now);
        let mut next = room.next_at();
        for robot in 0..self.robots.len() {
            let wide = room.scene().bandwidth_mhz == 40;
            self.tell_frames(robot, wide);
            let at = [self.tell_records(robot, now)?, self.tell_poses(robot, now)?];
            next = next.into_iter().chain(at.into_iter().flatten()).min();
        }
        Ok(next)
    }

    /// Accepts new programs.
    fn accept(&mut self, now: Instant) -> Result<(), Error> {
        loop {
            match self.listener.accept() {
                // Without a free place it is closed at once.
                Ok(_) if self.clients.len() >= CLIENTS => self.counts.refused += 1,
                Ok((stream, _)) => {
                    let socket = OwnedFd::from(stream);
                    let stamped = setsockopt(&socket, sockopt::ReceiveTimestampns, &true);
                    // With a smaller buffer a program only loses messages sooner.
                    let _ = setsockopt(&socket, sockopt::SndBuf, &SEND_BUFFER);
                    let watched = self.ready.add(&socket, EpollEvent::new(EpollFlags::EPOLLIN, 0));
                    if stamped.and(watched).is_ok() {
                        self.clients.push(Client { socket, what: None, since: now, free_at: now });
                    }
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(()),
                Err(error) if [ErrorKind::Interrupted, ErrorKind::ConnectionAborted].contains(&error.kind()) => {}
                Err(source) => {
                    let what = format!("nobody can join the room at {} any more", self.place.path().display());
                    return Err(Error::Io { what, source });
                }
            }
        }
    }

    /// Takes the programs' messages; returns their frames, and the robots whose air became free.
    fn listen(&mut self, room: &mut Room, now: Instant, wall_us: Option<i64>) -> (Vec<Frame>, Vec<usize>) {
        let (mut frames, mut gone) = (Vec::new(), Vec::new());
        for mut client in std::mem::take(&mut self.clients) {
            let stays = loop {
                match receive(&client.socket, &mut self.buffer) {
                    Ok((0, _)) => break false,
                    Ok((len, stamp_us)) => {
                        let age = stamp_us.zip(wall_us).map_or(0, |(stamp, wall)| wall.saturating_sub(stamp).max(0));
                        match client.what {
                            None => {
                                if !self.greet(room, &mut client, len, now) {
                                    break false;
                                }
                            }
                            Some((Role::Air, robot)) => {
                                let at = (now - Span::from_us(age)).max(Instant::ZERO);
                                if client.has_air(at) {
                                    frames.extend(self.frame(room, robot, at, len));
                                } else {
                                    self.refuse("more frames than the air has room for".into());
                                }
                            }
                            Some(_) => {}
                        }
                    }
                    Err(Errno::EAGAIN) => break client.what.is_some() || now - client.since <= PATIENCE,
                    // It closed with unread data; its earlier messages are still readable.
                    Err(Errno::EINTR | Errno::ECONNRESET) => {}
                    Err(_) => break false,
                }
            };
            match (stays, client.what) {
                (true, _) => self.clients.push(client),
                (false, Some((Role::Air, robot))) => gone.push(robot),
                (false, _) => {}
            }
        }
        (frames, gone)
    }

    /// Answers a new program's request. False if it is refused.
    fn greet(&mut self, room: &mut Room, client: &mut Client, len: usize, now: Instant) -> bool {
        let hello = String::from_utf8_lossy(self.buffer.get(..len.min(WORDS)).unwrap_or_default()).into_owned();
        let (answer, what) = match self.asked(room, &hello, now) {
            Ok((role, robot)) => {
                let mac = room.mac(robot).unwrap_or(driver_iface::Mac::ZERO);
                (format!("ok {mac}"), Some((role, robot)))
            }
            Err(why) => (format!("no {why}"), None),
        };
        client.what = what;
        self.counts.joined += u64::from(what.is_some());
        self.counts.refused += u64::from(what.is_none());
        matches!(say(&client.socket, answer.as_bytes()), Sent::Yes) && what.is_some()
    }

    /// The requested stream, taken from the room if nobody had it yet.
    fn asked(&mut self, room: &mut Room, hello: &str, now: Instant) -> Result<(Role, usize), String> {
        let words = hello.strip_prefix(GREETING).ok_or("this is a room of csi5300, and another version of it")?;
        let (role, name) = words.trim_start().split_once(' ').ok_or("which stream of which robot?")?;
        let role = Role::ALL.into_iter().find(|(_, word)| *word == role).ok_or("air, card or poses?")?.0;
        let names = || room.scene().robot.iter().map(|robot| robot.name.as_str()).collect::<Vec<_>>().join(", ");
        let number = room.number(name).ok_or_else(|| format!("the scene has no robot {name}: it has {}", names()))?;
        let robot = &mut self.robots[number];
        match role {
            Role::Air => {
                let busy = || format!("another program has the air of {name}");
                robot.air = Some(room.interface(number).ok_or_else(busy)?);
            }
            Role::Card if robot.card.is_none() => {
                let elsewhere = || format!("the records of {name} go to the kernel's connector");
                robot.card = Some(room.card(number).ok_or_else(elsewhere)?);
            }
            Role::Poses if robot.poses.is_none() => {
                let mut poses = room.odometry(number).ok_or_else(|| format!("{name} has no odometry"))?;
                // Earlier poses are dropped.
                while let Ok(NextPose::Pose(_) | NextPose::NewFrame) = poses.receive(now) {}
                robot.poses = Some(poses);
            }
            Role::Card | Role::Poses => {}
        }
        Ok((role, number))
    }

    /// The frame in a message of `len` bytes, if it can be sent in this room.
    fn frame(&mut self, room: &Room, robot: usize, at: Instant, len: usize) -> Option<Frame> {
        let scene = room.scene();
        let parsed = || -> Result<Frame, String> {
            let message = self.buffer.get(..len).ok_or("a frame that is longer than any")?;
            let packet = Packet::new_checked(message).map_err(|error| error.to_string())?;
            let repr = Repr::parse(&packet).map_err(|error| error.to_string())?;
            let bytes = packet.frame(&repr).map_err(|error| error.to_string())?;
            // Without a rate the card takes its own.
            let radio = scene.robot.get(robot).map(|state| scene.radio_of(state).mcs);
            let mcs = repr.mcs.map_or(radio.unwrap_or_default(), |mcs| mcs.index);
            let wide = repr.mcs.and_then(|mcs| mcs.bandwidth()).map(|width| width == Bandwidth::Ht40);
            if wide.is_some_and(|wide| wide != (scene.bandwidth_mhz == 40)) {
                return Err(format!("a frame of another width than the room's {} MHz", scene.bandwidth_mhz));
            }
            Ok(Frame { at, robot, mcs, bytes: bytes.to_vec() })
        };
        let parsed = parsed();
        parsed.map_err(|why| self.refuse(why)).ok()
    }

    fn refuse(&mut self, why: String) {
        self.counts.bad_frames += 1;
        self.told.get_or_insert(why);
    }

    /// Hands on the frames that passed a robot's interface.
    fn tell_frames(&mut self, robot: usize, wide: bool) {
        let Some(mut air) = self.robots[robot].air.take() else { return };
        while let Some(seen) = air.see() {
            let width = if wide { Bandwidth::Ht40 } else { Bandwidth::Ht20 };
            let mcs = Some(Mcs::injected(seen.mcs, width));
            let sent = Repr { tx_flags: Some(0), data_retries: Some(seen.retries), mcs, ..Repr::default() };
            let header = if seen.own { sent } else { Repr { mcs, ..Repr::default() } };
            let header_len = header.header_len();
            let len = header_len + seen.frame.len();
            let mut message = std::mem::take(&mut self.buffer);
            if header.emit(&mut message).is_ok()
                && let Some(place) = message.get_mut(header_len..len)
            {
                place.copy_from_slice(seen.frame);
                self.tell(Role::Air, robot, &message[..len]);
            }
            self.buffer = message;
        }
        self.robots[robot].air = Some(air);
    }

    /// Hands on the records of a robot's card; when there are more.
    fn tell_records(&mut self, robot: usize, now: Instant) -> Result<Option<Instant>, Error> {
        let Some(mut card) = self.robots[robot].card.take() else { return Ok(None) };
        if !self.clients.iter().any(|client| client.what == Some((Role::Card, robot))) {
            card.let_go(now);
        }
        let next = loop {
            match card.receive(now)? {
                Next::Record(_, record) => {
                    let whole = record.code == code::BFEE;
                    if self.tell_record(robot, record) == 0 && whole {
                        card.take_back();
                    }
                }
                // The real socket has its own queue, and the real listener stalls by itself.
                Next::Lost(_) => {}
                Next::Pending => break card.next_at(),
                Next::End(_) => break None,
            }
        };
        self.robots[robot].card = Some(card);
        Ok(next)
    }

    /// Sends a record to every program that listens; returns their number.
    fn tell_record(&mut self, robot: usize, record: Record<'_>) -> u64 {
        let mut message = std::mem::take(&mut self.buffer);
        let len = (Message { idx: CN_IDX, val: CN_VAL, record, padded: true }).emit(&mut message);
        let told = len.map_or(0, |len| self.tell(Role::Card, robot, &message[..len]));
        self.buffer = message;
        self.counts.records += told;
        told
    }

    fn tell_poses(&mut self, robot: usize, now: Instant) -> Result<Option<Instant>, Error> {
        let Some(mut poses) = self.robots[robot].poses.take() else { return Ok(None) };
        let next = loop {
            match poses.receive(now)? {
                NextPose::Pose(pose) => {
                    self.tell(Role::Poses, robot, csv::line(&pose).as_bytes());
                }
                NextPose::NewFrame => {}
                NextPose::Pending => break poses.next_at(),
                NextPose::End => break None,
            }
        };
        self.robots[robot].poses = Some(poses);
        Ok(next)
    }

    /// Sends a message to every program that requested it; returns their number. One that does not read loses it.
    fn tell(&mut self, role: Role, robot: usize, message: &[u8]) -> u64 {
        let mut told = 0;
        for client in self.clients.iter().filter(|client| client.what == Some((role, robot))) {
            match say(&client.socket, message) {
                Sent::Yes => told += 1,
                Sent::NoRoom => self.counts.untaken += 1,
                // It is closed when its end is read.
                Sent::Gone => {}
            }
        }
        told
    }
}

impl AsFd for Server {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.ready.0.as_fd()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.place.leave();
    }
}

/// Takes one message: its true length, 0 at the end, and the kernel's stamp, microseconds since the Unix epoch.
fn receive(socket: &OwnedFd, buffer: &mut [u8]) -> nix::Result<(usize, Option<i64>)> {
    let mut control = nix::cmsg_space!(TimeSpec);
    let mut parts = [IoSliceMut::new(buffer)];
    let flags = MsgFlags::MSG_DONTWAIT | MsgFlags::MSG_TRUNC;
    let message = recvmsg::<()>(socket.as_raw_fd(), &mut parts, Some(&mut control), flags)?;
    let stamp = message.cmsgs().ok().and_then(|mut said| {
        said.find_map(|said| if let ControlMessageOwned::ScmTimestampns(stamp) = said { Some(stamp) } else { None })
    });
    Ok((message.bytes, stamp.map(|stamp| stamp.tv_sec().saturating_mul(1_000_000) + stamp.tv_nsec() / 1_000)))
}

fn say(socket: &OwnedFd, message: &[u8]) -> Sent {
    match send(socket.as_raw_fd(), message, MsgFlags::MSG_DONTWAIT | MsgFlags::MSG_NOSIGNAL) {
        Ok(_) => Sent::Yes,
        Err(Errno::EAGAIN | Errno::ENOBUFS | Errno::ENOMEM) => Sent::NoRoom,
        Err(_) => Sent::Gone,
    }
}
