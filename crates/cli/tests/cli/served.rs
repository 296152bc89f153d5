//! Live programs in a simulated room: their state machines on its air, in virtual time and through its socket.

use csi5300::exchange::pairing::LinkSide;
use csi5300::exchange::tdma::{Config, Epoch, Event, Phy, Request, Tdma};
use csi5300::internal::FrameReceiver;
use csi5300::motion::odometry::{NextPose, OdometrySource};
use csi5300::pipeline::{Options, Transmitter, bearings};
use csi5300::signal::channel::{Channel, Width};
use csi5300::source::{CsiSource, Injector, Next};
use csi5300::time::{Instant, Span};
use csi5300_lab::compare::figures::true_path;
use csi5300_live::monitor::{self, Monitor};
use csi5300_live::netlink::Netlink;
use csi5300_live::sounding::Exchange;
use csi5300_sim::served::{self, Address, Poses, Server};
use csi5300_sim::{Injected, Interface, Room, Scene};
use driver_iface::Mac;
use driver_iface::radiotap::Bandwidth;
use driver_iface::record::{Tail, code};
use std::path::PathBuf;

/// A robot on a circle, and one 4 m to its north-east.
fn scene(duration_s: f64, more: &str) -> Scene {
    let text = format!(
        "duration_s = {duration_s:?}\ncfo = \"physical\"\nradio.noise.snr_db = 15.0\nradio.mcs = 1\n{more}\n\
         [[robot]]\nname = \"rx\"\nmotion.circle = {{ radius_m = 0.3, duration_s = 9.0, start_s = 0.5 }}\n\
         crystal.offset_ppm = 1.0\n\
         [[robot]]\nname = \"tx\"\nposition_m = [300.0, 300.0, 0.0]\ncrystal.offset_ppm = -2.0\n"
    );
    Scene::from_toml(&text).unwrap_or_else(|error| panic!("{error}\n{text}"))
}

/// A robot's card in a served room, and its MAC.
fn card_of(address: &Address, wall_us: fn() -> Option<i64>) -> (Netlink, Mac) {
    let (card, mac) = served::join(address, served::Role::Card).unwrap();
    (Netlink::over(card, wall_us), mac)
}

/// The state machine that `sound` or `respond` runs.
fn machine(room: &Room, own: usize, initiate: bool) -> Tdma {
    let peers: Vec<Mac> = (0..room.scene().robot.len()).filter(|&k| k != own).map(|k| room.mac(k).unwrap()).collect();
    let phy = Phy { mcs: 1, bandwidth: Bandwidth::Ht20 };
    let request = Request { phy, ..Request::new(1, 100.0) };
    let epoch = Epoch::Heard(Instant::ZERO);
    let mut config = Config { initiate, epoch, ..Config::new(room.mac(own).unwrap(), 0, &peers, request, 1) };
    config.silence_slots = 2;
    Tdma::new(&config).unwrap()
}

/// Steps the exchanges as their threads would, in virtual time, until the room's end; gives what each said.
fn run(room: &mut Room, exchanges: &mut [Exchange<Interface>]) -> Vec<Vec<Event>> {
    let mut told: Vec<Vec<Event>> = vec![Vec::new(); exchanges.len()];
    let mut now = Instant::ZERO;
    loop {
        room.advance(now);
        let mut next = room.next_at();
        if next.is_none() {
            return told;
        }
        for (exchange, told) in exchanges.iter_mut().zip(&mut told) {
            let mut tell = |news| {
                if let csi5300_live::sounding::News::Event(event) = news {
                    told.push(event);
                }
            };
            let at = exchange.step(&|| now, &mut tell).unwrap();
            next = next.into_iter().chain(at).chain(room.next_at()).min();
        }
        now = next.unwrap().max(now + Span::from_us(1));
    }
}

#[test]
fn live_state_machines_sound_each_other_in_a_room_in_virtual_time() {
    let scene = scene(10.0, "");
    let mut room = Room::quiet(&scene).unwrap();
    let path = true_path(&room, 0).unwrap();
    let (mut rx, mut tx) = (room.card(0).unwrap(), room.card(1).unwrap());
    let exchange =
        |room: &mut Room, robot| Exchange::new(machine(room, robot, robot == 0), room.interface(robot).unwrap());
    let mut exchanges = [exchange(&mut room, 0), exchange(&mut room, 1)];
    let told = run(&mut room, &mut exchanges);
    let answered = told[0].iter().filter(|event| matches!(event, Event::Answered { .. })).count();
    let counts = exchanges[0].tdma.counts();
    assert!(answered > 900 && counts.answered == answered as u64, "{answered} of {}", counts.forward);
    assert_eq!(exchanges[1].air.sent_for_certain(), Some(exchanges[1].tdma.counts().replies));

    let options = Options::new(Channel::new(108, Width::Ht20).unwrap());
    let transmitters = vec![Transmitter { log: &mut tx, trajectory: None }];
    let report = bearings(&mut rx, transmitters, &path, &options).unwrap();
    let link = &report.links[0];
    assert_eq!(link.link.as_ref().unwrap().counts(LinkSide::Receiver).paired, answered as u64);
    let azimuth_deg = link.bearing.as_ref().unwrap().answer.azimuth_rad.to_degrees();
    assert!((azimuth_deg - 45.0).abs() < 0.3, "{azimuth_deg}");
    let [a, b] = room.injected()[..] else { panic!("two robots") };
    assert_eq!((a.sent, b.sent, a.collided + b.collided), (counts.forward, answered as u64, 0));
}

#[test]
fn an_interface_is_one_program_s_at_a_time_and_forgets_nothing_it_was_not_told() {
    let mut room = Room::quiet(&scene(1.0, "")).unwrap();
    let mut first = room.interface(1).unwrap();
    assert!(room.interface(1).is_none() && room.interface(2).is_none());
    let mut sender = room.card(0).unwrap();
    for number in 1..=300 {
        sender.inject(Instant::ZERO, &frame(&room, 0, number)).unwrap();
    }
    room.advance(Instant::from_us(500_000));
    let heard = std::iter::from_fn(|| first.hear().unwrap().map(|heard| heard.frame.to_vec())).count() as u64;
    assert_eq!((heard, first.lost()), (256, room.injected()[0].sent - 256), "what waits is bounded, the rest counted");
    assert!(first.inject_at(Instant::from_us(500_000), &frame(&room, 1, 1), 8).is_err(), "two streams");
    drop(first);
    assert!(room.interface(1).is_some());
}

/// A frame as the WSR toolbox sends it.
fn frame(room: &Room, from: usize, number: u32) -> Vec<u8> {
    let mut bytes = vec![0x08, 0, 0xff, 0xff];
    bytes.extend([0x00, 0x16, 0xea, 0x12, 0x34, 0x56].repeat(2));
    bytes.extend(room.mac(from).unwrap().0);
    bytes.extend([0, 0]);
    bytes.extend(number.to_be_bytes());
    bytes.resize(53, 0x55);
    bytes
}

/// A room at a socket of its own, in virtual time.
struct Served {
    room: Room,
    server: Server,
    socket: PathBuf,
}

impl Served {
    fn new(scene: &Scene, name: &str) -> Self {
        let socket = std::env::temp_dir().join(format!("csi5300-{name}-{}", std::process::id()));
        Self { room: Room::quiet(scene).unwrap(), server: Server::bind(&socket).unwrap(), socket }
    }

    fn turn(&mut self, us: i64) -> Option<Instant> {
        self.server.turn(&mut self.room, Instant::from_us(us), None).unwrap()
    }

    /// Joins as another program would, which waits for the room's answer.
    fn join<T: Send>(&mut self, robot: &str, join: impl FnOnce(&Address) -> T + Send) -> T {
        let address = Address { socket: self.socket.clone(), robot: robot.into() };
        std::thread::scope(|scope| {
            let program = scope.spawn(|| join(&address));
            while !program.is_finished() {
                self.turn(0);
                std::thread::yield_now();
            }
            program.join().unwrap()
        })
    }

    fn monitor(&mut self, robot: &str, mcs: u8) -> Monitor {
        self.join(robot, |address| {
            let (air, mac) = served::join(address, served::Role::Air).unwrap();
            Monitor::over(air, mac, &options(mcs)).unwrap()
        })
    }

    fn injected(&self) -> Vec<Injected> {
        self.room.injected()
    }
}

fn options(mcs: u8) -> monitor::Options {
    let bandwidth = Bandwidth::Ht20;
    monitor::Options { mcs, bandwidth, wall_us: || None, ..monitor::Options::new("room", 200) }
}

fn hear(monitor: &mut Monitor) -> Option<Vec<u8>> {
    monitor.hear().unwrap().map(|heard| heard.frame.to_vec())
}

#[test]
fn frames_over_the_socket_are_on_the_air_and_overlapping_ones_collide() {
    let third = "[[robot]]\nname = \"third\"\nposition_m = [0.0, 5.0, 0.0]\n";
    let mut text_scene = scene(1.0, "");
    text_scene.robot.push(Scene::from_toml(&format!("duration_s = 1.0\n{third}")).unwrap().robot[0].clone());
    let mut served = Served::new(&text_scene, "air");
    let (mut a, mut b) = (served.monitor("rx", 1), served.monitor("tx", 1));
    let mut third = served.monitor("third", 1);
    let frames = [frame(&served.room, 0, 1), frame(&served.room, 1, 2), frame(&served.room, 0, 3)];
    a.inject(Instant::ZERO, &frames[0]).unwrap();
    b.inject(Instant::ZERO, &frames[1]).unwrap();
    // Both are taken in one turn, without stamps: on air at one instant.
    served.turn(1_000);
    served.turn(2_000);
    assert_eq!(served.injected().iter().map(|injected| injected.collided).collect::<Vec<_>>(), [1, 1, 2]);
    assert_eq!([hear(&mut a), hear(&mut b), hear(&mut third)], [None, None, None]);
    a.inject(Instant::ZERO, &frames[2]).unwrap();
    served.turn(3_000);
    served.turn(4_000);
    assert_eq!(
        [hear(&mut a), hear(&mut b), hear(&mut third)],
        [None, Some(frames[2].clone()), Some(frames[2].clone())]
    );
    // Each frame that went out was reported to its sender, and to nobody else.
    assert_eq!([&mut a, &mut b, &mut third].map(|monitor| monitor.counters().tx_status), [2, 1, 0]);
    assert_eq!((served.server.counts().frames, served.server.notice()), (3, None));
}

#[test]
fn what_cannot_be_sent_is_counted_and_said_once() {
    let mut served = Served::new(&scene(1.0, ""), "bad");
    let mut two_streams = served.monitor("rx", 9);
    let sent = frame(&served.room, 0, 1);
    two_streams.inject(Instant::ZERO, &sent).unwrap();
    two_streams.inject(Instant::ZERO, &sent).unwrap();
    served.turn(1_000);
    assert_eq!((served.server.counts().bad_frames, served.injected()[0].sent), (2, 0));
    let said = served.server.notice().unwrap();
    assert!(said.contains("MCS 9") && served.server.notice().is_none(), "{said}");
    let refused = served.join("rx", |address| served::join(address, served::Role::Air).unwrap_err().to_string());
    assert!(refused.contains("another program has the air of rx"), "{refused}");
    let refused = served.join("nobody", |address| served::join(address, served::Role::Card).unwrap_err().to_string());
    assert!(refused.contains("no robot nobody: it has rx, tx"), "{refused}");
    drop(two_streams);
    let mut again = None;
    comes(|| {
        served.turn(2_000);
        again = served.join("rx", |address| served::join(address, served::Role::Air).ok());
        again.is_some()
    });
}

/// Waits for what comes when one end has gone: programs that other tests start hold copies of sockets between their fork and
/// their exec.
fn comes(mut is_there: impl FnMut() -> bool) {
    while !is_there() {
        std::thread::yield_now();
    }
}

#[test]
fn a_card_behind_the_socket_says_what_the_room_s_card_says() {
    // Two antennas with a constant and a noise between their chains.
    let mut scene = scene(1.0, "driver = \"stock\"\nradio.chain_deg = [60.0, 0.0]\nradio.chain_noise_rad = 0.1");
    scene.robot[1].antenna_b_m = Some([0.0, 0.1, 0.0]);
    let mut served = Served::new(&scene, "card");
    let (mut card, mac) = served.join("tx", |address| card_of(address, || Some(7)));
    assert_eq!((mac, card.at.as_str()), (served.room.mac(1).unwrap(), "to a card in a simulated room"));
    let (mut second, _) = served.join("tx", |address| card_of(address, || None));
    let mut poses = served.join("rx", |address| Poses::join(address).unwrap());
    let mut air = served.monitor("rx", 1);
    let mut plain = Room::quiet(&scene).unwrap();
    let (mut injector, mut expected) = (plain.card(0).unwrap(), plain.card(1).unwrap());
    for number in 1..=50 {
        let (now, sent) = (Instant::from_us(i64::from(number) * 10_000), frame(&plain, 0, number));
        air.inject(now, &sent).unwrap();
        injector.inject(now, &sent).unwrap();
        served.turn(now.as_us());
    }
    let mut at = Some(Instant::from_us(500_000));
    while let Some(now) = at {
        at = served.turn(now.as_us());
    }
    let (mut records, mut now) = (0, Instant::ZERO);
    loop {
        match expected.receive(now).unwrap() {
            Next::Record(_, record) => {
                for card in [&mut card, &mut second] {
                    let Next::Record(_, heard) = card.receive(Instant::ZERO).unwrap() else {
                        panic!("record {records}")
                    };
                    assert!(heard == record, "record {records} is another one");
                    // RSSI of antenna B.
                    assert!(record.code != code::BFEE || record.body[11] > 0, "{:?}", record.body);
                }
                records += 1;
            }
            Next::Pending => now = expected.next_at().unwrap(),
            Next::Lost(loss) => panic!("{loss:?}"),
            Next::End(_) => break,
        }
    }
    assert_eq!((records, served.server.counts().records), (100, 200), "two records a frame, two listeners");
    assert!(matches!(card.receive(Instant::ZERO).unwrap(), Next::Pending));
    let came =
        std::iter::from_fn(|| Some(poses.receive(Instant::ZERO).unwrap()).filter(|next| *next != NextPose::Pending));
    let came: Vec<NextPose> = came.collect();
    // The first was of the moment at which it joined.
    assert_eq!(came.len(), 100, "a hundred a second");
    drop(served);
    comes(|| !matches!(card.receive(Instant::ZERO).unwrap(), Next::Pending));
    assert!(matches!(card.receive(Instant::ZERO).unwrap(), Next::End(Tail::Clean)));
    comes(|| poses.receive(Instant::ZERO).unwrap() != NextPose::Pending);
    assert_eq!(poses.receive(Instant::ZERO).unwrap(), NextPose::End);
    assert!(hear_fails(&mut air).contains("the room has ended"));
}

/// Messages that a program finds at its end of a socket.
fn messages(program: &std::os::fd::OwnedFd) -> u64 {
    use nix::sys::socket::{MsgFlags, recv};
    let mut buffer = [0; 4096];
    let mut one = || recv(std::os::fd::AsRawFd::as_raw_fd(program), &mut buffer, MsgFlags::MSG_DONTWAIT);
    std::iter::from_fn(|| one().ok()).count() as u64
}

#[test]
fn records_are_delivered_while_somebody_listens_and_the_others_are_counted_as_unheard() {
    use nix::sys::socket::{Shutdown, shutdown};
    let mut served = Served::new(&scene(3.0, ""), "unheard");
    let mut air = served.monitor("tx", 1);
    let mut number = 0;
    // A frame every 10 ms, a record half a millisecond later at most.
    let mut frames = |served: &mut Served, count: u32| {
        for _ in 0..count {
            number += 1;
            let at_us = i64::from(number) * 10_000;
            air.inject(Instant::from_us(at_us), &frame(&served.room, 1, number)).unwrap();
            served.turn(at_us);
            served.turn(at_us + 500);
        }
    };
    let listen = |served: &mut Served| served.join("rx", |at| served::join(at, served::Role::Card).unwrap().0);
    frames(&mut served, 20);
    let mut heard = 0;
    for _ in 0..2 {
        let recorder = listen(&mut served);
        frames(&mut served, 30);
        heard += messages(&recorder);
        // Whoever holds a copy of it, it is at its end.
        shutdown(std::os::fd::AsRawFd::as_raw_fd(&recorder), Shutdown::Both).unwrap();
        frames(&mut served, 50);
    }
    let rx = served.injected()[0];
    assert_eq!((heard, served.server.counts().records), (60, 60));
    assert_eq!((rx.received, rx.delivered, rx.unheard, rx.under_way), (180, 60, 120, 0), "{rx}");
    // One that takes nothing more: what is sent to it reaches nobody.
    let deaf = listen(&mut served);
    shutdown(std::os::fd::AsRawFd::as_raw_fd(&deaf), Shutdown::Read).unwrap();
    frames(&mut served, 5);
    assert_eq!((served.injected()[0].delivered, served.injected()[0].unheard), (60, 125));
}

fn hear_fails(monitor: &mut Monitor) -> String {
    loop {
        if let Err(error) = monitor.hear() {
            return error.to_string();
        }
    }
}

#[test]
fn a_socket_left_behind_is_replaced_and_one_in_use_is_not() {
    let mut served = Served::new(&scene(1.0, ""), "twice");
    let error = Server::bind(&served.socket).unwrap_err().to_string();
    assert!(error.contains("another room, or another program, is served at"), "{error}");
    // As after a kill: the file stays.
    let left = served.socket.with_extension("left");
    std::fs::rename(&served.socket, &left).unwrap();
    served.socket = left.clone();
    drop(served);
    let mut again = None;
    comes(|| {
        again = Server::bind(&left).ok();
        again.is_some()
    });
    drop(again);
    assert!(!left.exists());
}

/// Connects and says nothing.
fn idle(socket: &std::path::Path) -> std::os::fd::OwnedFd {
    use nix::sys::socket::{AddressFamily, SockFlag, SockType, UnixAddr, connect, socket as open};
    let idle = open(AddressFamily::Unix, SockType::SeqPacket, SockFlag::SOCK_CLOEXEC, None).unwrap();
    connect(std::os::fd::AsRawFd::as_raw_fd(&idle), &UnixAddr::new(socket).unwrap()).unwrap();
    idle
}

#[test]
fn a_room_outlives_idle_programs_and_a_flood_of_frames() {
    let mut served = Served::new(&scene(20.0, ""), "flood");
    let mut air = served.monitor("rx", 1);
    let mut idlers = Vec::new();
    for _ in 0..300 {
        idlers.push(idle(&served.socket));
        served.turn(0);
    }
    assert_eq!(served.server.counts().refused, 45, "beyond 256");
    // Who says nothing for five seconds is let go.
    served.turn(6_000_000);
    idlers.push(idle(&served.socket));
    served.turn(6_000_000);
    assert_eq!(served.server.counts().refused, 45);
    let sent = frame(&served.room, 0, 1);
    for _ in 0..40 {
        for _ in 0..200 {
            let _ = air.inject(Instant::ZERO, &sent);
        }
        served.turn(6_000_000);
    }
    let counts = served.server.counts();
    assert!(counts.frames <= 2_501 && counts.bad_frames > 1_000, "{counts:?}");
    assert!(served.server.notice().unwrap().contains("more frames than the air has room for"));
    // And what comes at its own time is sent as ever.
    air.inject(Instant::ZERO, &sent).unwrap();
    served.turn(7_000_000);
    assert_eq!(served.server.counts().frames, counts.frames + 1);
}
