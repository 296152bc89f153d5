//! A simulated room in another process that acts as the card: injected and received frames of a robot, its card's
//! records and its odometry's poses, over a Unix socket.
//!
//! `csi5300 simulate SCENE.toml --serve --socket PATH` runs a [`Server`]; `sound`, `record` (with `--room PATH#ROBOT`)
//! and `node` (with `capture.served`) use it with the code for cards: the socket carries the same bytes as the
//! kernel's, so everything behind the live crate's `Monitor` and `Netlink` is shared.
//!
//! The socket is of type SOCK_SEQPACKET: messages keep their bounds, and a closed partner is noticed. The first message
//! is a request in words:
//!
//! | to the room | from the room |
//! |---|---|
//! | `csi5300-room 1 air ROBOT` | `ok MAC`, then radiotap header and 802.11 frame, one a message, both ways. A frame that went out comes back as a tx-status copy (TX flags), as mac80211's do |
//! | `csi5300-room 1 card ROBOT` | `ok MAC`, then connector datagrams: `nlmsghdr`, `cn_msg`, record |
//! | `csi5300-room 1 poses ROBOT` | `ok MAC`, then lines `time,0,x,y,z,heading,` on the robot's host clock |
//! | anything else | `no`, and why |
//!
//! A frame is on air from the moment of its hand-over, by the kernel's stamp of the message; overlapping frames
//! collide. Several programs may listen to one card; one at a time may use a robot's air.

use crate::{Interface, Odometer, Port, Room, refused};
use csi5300::motion::odometry::{NextPose, OdometrySource, csv};
use csi5300::source::{CsiSource, Error, Next};
use csi5300::time::{Instant, Span};
use driver_iface::Mac;
use driver_iface::connector::{CN_IDX, CN_VAL, MAX_DATAGRAM, Repr as Message};
use driver_iface::radiotap::{Bandwidth, Mcs, Repr};
use driver_iface::record::{Record, code};
use nix::errno::Errno;
use nix::sys::epoll::{Epoll, EpollCreateFlags, EpollEvent, EpollFlags};
use nix::sys::socket::{
    AddressFamily, Backlog, ControlMessageOwned, MsgFlags, SockFlag, SockType, UnixAddr, bind, connect, listen, recv,
    recvmsg, send, setsockopt, socket, sockopt,
};
use nix::sys::time::{TimeSpec, TimeVal};
use std::fmt;
use std::io::{self, ErrorKind, IoSliceMut};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// First word of the first message, and the version of what follows.
const GREETING: &str = "csi5300-room 1";
/// Longest message other than frames and records, bytes.
const WORDS: usize = 512;
/// How long to wait for the room, seconds.
const PATIENCE_S: i64 = 60;

/// The requested stream of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Its monitor interface.
    Air,
    /// Its card's records.
    Card,
    /// Its odometry.
    Poses,
}

impl Role {
    const ALL: [(Self, &str); 3] = [(Self::Air, "air"), (Self::Card, "card"), (Self::Poses, "poses")];

    fn word(self) -> &'static str {
        Self::ALL.iter().find(|(role, _)| *role == self).map_or("", |(_, word)| word)
    }
}

/// Connects to a robot of a room; returns the socket, which does not block and stamps messages, and the robot's MAC.
///
/// # Errors
/// [`JoinError::NoRoom`] where no room is served, [`JoinError::Refused`] with the room's reason, or from something else that
/// listens there.
pub fn join(address: &Address, role: Role) -> Result<(OwnedFd, Mac), JoinError> {
    let no_room = |source: nix::errno::Errno| JoinError::NoRoom { address: address.clone(), source: source.into() };
    let socket = seqpacket(SockFlag::empty()).map_err(no_room)?;
    setsockopt(&socket, sockopt::ReceiveTimeout, &TimeVal::new(PATIENCE_S, 0)).map_err(no_room)?;
    let path = UnixAddr::new(&address.socket).map_err(no_room)?;
    connect(socket.as_raw_fd(), &path).map_err(no_room)?;
    let hello = format!("{GREETING} {} {}", role.word(), address.robot);
    send(socket.as_raw_fd(), hello.as_bytes(), MsgFlags::MSG_NOSIGNAL).map_err(no_room)?;
    let mut answer = [0; WORDS];
    let len = recv(socket.as_raw_fd(), &mut answer, MsgFlags::empty()).map_err(no_room)?;
    let answer = String::from_utf8_lossy(answer.get(..len).unwrap_or_default());
    let strange = || JoinError::Refused(format!("{address}: the answer of {len} bytes is not that of a room"));
    match answer.split_once(' ') {
        Some(("ok", mac)) => Ok((socket, mac.parse().map_err(|_| strange())?)),
        Some(("no", why)) => Err(JoinError::Refused(format!("{address}: {why}"))),
        _ => Err(strange()),
    }
}

/// A socket that stamps received messages.
fn seqpacket(flags: SockFlag) -> nix::Result<OwnedFd> {
    let socket = socket(AddressFamily::Unix, SockType::SeqPacket, flags | SockFlag::SOCK_CLOEXEC, None)?;
    setsockopt(&socket, sockopt::ReceiveTimestampns, &true)?;
    Ok(socket)
}

/// Takes one message of a robot's card or odometry: its true length, 0 once the room has ended.
///
/// # Errors
/// The kernel's, WouldBlock where there is none.
fn take(socket: &OwnedFd, buffer: &mut [u8]) -> io::Result<usize> {
    loop {
        match recv(socket.as_raw_fd(), buffer, MsgFlags::MSG_DONTWAIT | MsgFlags::MSG_TRUNC) {
            // The partner closed with unread data; its earlier messages are still readable.
            Err(nix::errno::Errno::ECONNRESET) => {}
            taken => return Ok(taken?),
        }
    }
}

/// A robot of a served room: `PATH#ROBOT`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// The room's socket.
    pub socket: PathBuf,
    /// The robot's name in the scene.
    pub robot: String,
}

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        match text.rsplit_once('#') {
            Some((path, robot)) if !path.is_empty() && !robot.is_empty() => {
                Ok(Self { socket: path.into(), robot: robot.into() })
            }
            _ => Err(AddressError),
        }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of the room at {}", self.robot, self.socket.display())
    }
}

/// A text that is no [`Address`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a robot of a served room is PATH#ROBOT, such as /tmp/room#rx")]
pub struct AddressError;

/// Why a robot of a room cannot be joined; inside [`csi5300::source::Error::Backend`] where a source is asked for.
#[derive(Debug, thiserror::Error)]
pub enum JoinError {
    /// Nothing listens there, or it left.
    #[error("cannot reach {address}: {source}")]
    NoRoom {
        /// Who was asked for.
        address: Address,
        /// The operating system's reason.
        source: io::Error,
    },
    /// The room has no such robot, another program has its air, or something else listens there: who was asked for, and why.
    #[error("{0}")]
    Refused(String),
}

impl From<JoinError> for Error {
    fn from(error: JoinError) -> Self {
        Self::Backend(Box::new(error))
    }
}

/// Bytes of a socket's path at most (struct sockaddr_un: 108 with the zero at its end).
const LONGEST_PATH: usize = 107;

/// The path of a socket, which is removed at the end.
#[derive(Debug)]
struct Place {
    path: PathBuf,
    /// Device and inode of the socket.
    own: (u64, u64),
}

impl Place {
    /// Binds a socket to a path. Removes an abandoned socket there first, but no other file.
    fn take(socket: &OwnedFd, path: &Path) -> Result<Self, Error> {
        let io = |source: io::Error| cannot_serve(path, source);
        let len = path.as_os_str().len();
        if !(1..=LONGEST_PATH).contains(&len) {
            let name = path.display();
            return Err(refused(format!("the path {name} has {len} bytes; a socket's has 1 to {LONGEST_PATH}")));
        }
        make_way(path)?;
        let address = UnixAddr::new(path).map_err(|errno| io(errno.into()))?;
        bind(socket.as_raw_fd(), &address).map_err(|errno| io(errno.into()))?;
        Ok(Self { own: identity(path).map_err(io)?, path: path.to_owned() })
    }

    /// Removes the socket if it is still at the path. It must be open, so that its inode is not reused.
    fn leave(&self) {
        if identity(&self.path).is_ok_and(|there| there == self.own) {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

fn cannot_serve(path: &Path, source: io::Error) -> Error {
    Error::Io { what: format!("cannot serve a room at {}; is its folder there and writable", path.display()), source }
}

/// Device and inode at a path, without following a link.
fn identity(path: &Path) -> io::Result<(u64, u64)> {
    let there = std::fs::symlink_metadata(path)?;
    Ok((there.dev(), there.ino()))
}

/// Removes an abandoned socket, but no other file.
fn make_way(path: &Path) -> Result<(), Error> {
    let name = path.display();
    let Ok(there) = std::fs::symlink_metadata(path) else { return Ok(()) };
    if !there.file_type().is_socket() {
        return Err(refused(format!("{name} is there and is no socket: give the room's socket another name")));
    }
    let asked = seqpacket(SockFlag::empty()).and_then(|socket| {
        let address = UnixAddr::new(path)?;
        connect(socket.as_raw_fd(), &address)
    });
    match asked {
        // Somebody listens, to sockets of this type or of another.
        Ok(()) | Err(Errno::EPROTOTYPE | Errno::EAGAIN) => Err(refused(format!(
            "another room, or another program, is served at {name}: stop it first, or give this one another name"
        ))),
        Err(Errno::ECONNREFUSED) => std::fs::remove_file(path).map_err(|source| cannot_serve(path, source)),
        Err(errno) => Err(cannot_serve(path, errno.into())),
    }
}

/// Longest line of a pose, bytes.
const LINE: usize = 512;

/// Poses of a robot in a served room. Never blocks; wait on its file descriptor.
#[derive(Debug)]
pub struct Poses {
    socket: OwnedFd,
    ended: bool,
}

impl Poses {
    /// Joins the room.
    ///
    /// # Errors
    /// No room there, or no such robot in it.
    pub fn join(address: &Address) -> Result<Self, Error> {
        Ok(Self { socket: join(address, Role::Poses)?.0, ended: false })
    }
}

impl OdometrySource for Poses {
    fn receive(&mut self, _: Instant) -> Result<NextPose, Error> {
        let mut line = [0; LINE];
        while !self.ended {
            match take(&self.socket, &mut line) {
                Ok(0) => self.ended = true,
                Ok(len) => {
                    let line = line.get(..len).unwrap_or_default();
                    let pose = csv::parse_line(line).map_err(|error| refused(format!("a pose of a room: {error}")))?;
                    return Ok(NextPose::Pose(pose));
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(NextPose::Pending),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(source) => return Err(Error::Io { what: "receiving poses from a room".into(), source }),
            }
        }
        Ok(NextPose::End)
    }

    fn next_at(&self) -> Option<Instant> {
        None
    }
}

impl AsFd for Poses {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

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

impl Server {
    /// Opens the socket. One that an earlier room left behind is replaced.
    ///
    /// # Errors
    /// When what is there is no socket, or one that is in use; when the path cannot be used.
    pub fn bind(path: &Path) -> Result<Self, Error> {
        let io = |errno: Errno| cannot_serve(path, errno.into());
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
                    let what = format!("nobody can join the room at {} any more", self.place.path.display());
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
        say(&client.socket, answer.as_bytes()).is_ok() && what.is_some()
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
            let (repr, frame) = Repr::parse(message).map_err(|error| error.to_string())?;
            let bytes = message.get(frame).unwrap_or_default().to_vec();
            // Without a rate the card takes its own.
            let radio = scene.robot.get(robot).map(|state| scene.radio_of(state).mcs);
            let mcs = repr.mcs.map_or(radio.unwrap_or_default(), |mcs| mcs.index);
            let wide = repr.mcs.and_then(|mcs| mcs.bandwidth()).map(|width| width == Bandwidth::Ht40);
            if wide.is_some_and(|wide| wide != (scene.bandwidth_mhz == 40)) {
                return Err(format!("a frame of another width than the room's {} MHz", scene.bandwidth_mhz));
            }
            Ok(Frame { at, robot, mcs, bytes })
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
                Ok(()) => told += 1,
                Err(Errno::EAGAIN | Errno::ENOBUFS | Errno::ENOMEM) => self.counts.untaken += 1,
                // It is closed when its end is read.
                Err(_) => {}
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

/// Sends a message, or nothing of it.
fn say(socket: &OwnedFd, message: &[u8]) -> nix::Result<()> {
    send(socket.as_raw_fd(), message, MsgFlags::MSG_DONTWAIT | MsgFlags::MSG_NOSIGNAL).map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_a_room_the_error_names_robot_and_socket() {
        let address = Address { socket: "/nowhere/room".into(), robot: "rx".into() };
        let error = join(&address, Role::Air).unwrap_err();
        assert!(error.to_string().contains("rx of the room at /nowhere/room"), "{error}");
        assert!(matches!(error, JoinError::NoRoom { source, .. } if source.kind() == io::ErrorKind::NotFound));
    }

    #[test]
    fn a_robot_of_a_room_is_its_socket_and_its_name() {
        let address: Address = "/tmp/a#b/room#rx".parse().unwrap();
        assert_eq!(address, Address { socket: "/tmp/a#b/room".into(), robot: "rx".into() });
        assert_eq!(address.to_string(), "rx of the room at /tmp/a#b/room");
        for wrong in ["", "#", "/tmp/room", "/tmp/room#", "#rx"] {
            assert!(wrong.parse::<Address>().is_err(), "{wrong}");
        }
    }

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("csi5300-place-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        folder
    }

    fn socket() -> OwnedFd {
        seqpacket(SockFlag::empty()).unwrap()
    }

    fn refused(path: &Path) -> String {
        Place::take(&socket(), path).unwrap_err().to_string()
    }

    #[test]
    fn other_files_stay_and_are_named() {
        let folder = folder("files");
        let [file, link, dangling] = ["precious.dat", "link", "dangling"].map(|name| folder.join(name));
        std::fs::write(&file, "precious").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        std::os::unix::fs::symlink(folder.join("none"), &dangling).unwrap();
        for path in [&file, &link, &dangling, &folder] {
            let said = refused(path);
            assert!(said.contains("is there and is no socket") && !said.contains("another room"), "{said}");
            assert!(std::fs::symlink_metadata(path).is_ok());
        }
        assert_eq!(std::fs::read_to_string(&link).unwrap(), "precious");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn the_refusal_names_the_places_problem_and_no_other_room() {
        let folder = folder("lacks");
        let cases = [
            (folder.join("none").join("room"), "No such file"),
            (folder.join("x".repeat(120)), "a socket's has 1 to 107"),
            (PathBuf::new(), "has 0 bytes"),
        ];
        for (path, why) in cases {
            let said = refused(&path);
            assert!(said.contains(why) && !said.contains("another"), "{said}");
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_socket_in_use_is_refused_and_one_left_behind_is_replaced() {
        let folder = folder("sockets");
        let path = folder.join("room");
        // Of another type, as a node's status socket.
        let living = UnixListener::bind(&path).unwrap();
        assert!(refused(&path).contains("is served at"));
        drop(living);
        let own = socket();
        let place = Place::take(&own, &path).unwrap();
        place.leave();
        assert!(!path.exists());
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_file_in_place_of_the_socket_stays() {
        let folder = folder("later");
        let path = folder.join("room");
        let own = socket();
        let place = Place::take(&own, &path).unwrap();
        std::fs::remove_file(&path).unwrap();
        std::fs::write(&path, "of somebody else").unwrap();
        place.leave();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "of somebody else");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
