//! The serial source against an emulated TurtleBot3 controller behind a pseudo terminal: real ports, virtual time.

use csi5300::internal::dynamixel::{emit, instruction};
use csi5300::motion::odometry::{NextPose, OdometrySource, SourceCounts};
use csi5300::time::{Instant, Span};
use csi5300_live::serial::Serial;
use nix::fcntl::OFlag;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::pty::{PtyMaster, grantpt, posix_openpt, ptsname_r, unlockpt};
use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

const WALL_US: i64 = 1_700_000_000_000_000;
/// Bytes of a question of the source.
const QUESTION: usize = 14;
/// No question begins with this.
const MARK: u8 = 0x55;

/// The controller's end of a port that can be unplugged: a link to a pseudo terminal.
struct Device {
    master: Option<PtyMaster>,
    /// The other end, to see what has arrived there.
    slave: Option<File>,
    link: PathBuf,
    asked: Vec<u8>,
    /// Its control table, and its clock in microseconds.
    table: [u8; 400],
}

impl Device {
    fn new(name: &str) -> Self {
        let link = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        let mut table = [0; 400];
        table[..2].copy_from_slice(&0x5000u16.to_le_bytes());
        table[2] = 1;
        Self { master: None, slave: None, link, asked: Vec::new(), table }
    }

    fn plug(&mut self) {
        let master = posix_openpt(OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_NONBLOCK | OFlag::O_CLOEXEC).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let _ = std::fs::remove_file(&self.link);
        let name = ptsname_r(&master).unwrap();
        let flags = (OFlag::O_NOCTTY | OFlag::O_NONBLOCK).bits();
        self.slave = Some(File::options().read(true).write(true).custom_flags(flags).open(&name).unwrap());
        std::os::unix::fs::symlink(name, &self.link).unwrap();
        self.master = Some(master);
    }

    fn unplug(&mut self) {
        self.master = None;
        // Another test that starts a program holds a copy of the master until that program runs.
        let mut hung_up = [PollFd::new(self.slave.as_ref().unwrap().as_fd(), PollFlags::empty())];
        assert_eq!(poll(&mut hung_up, PollTimeout::NONE), Ok(1), "the port is gone");
        self.slave = None;
        let _ = std::fs::remove_file(&self.link);
    }

    /// Answers everything that was asked, as the firmware does at `at`: straight on at 0.1 m/s.
    fn answer(&mut self, at: Instant) {
        let (Some(master), Some(slave)) = (&mut self.master, &mut self.slave) else { return };
        // What was asked comes before this mark, which no question begins with, and which a worker of the kernel carries over too.
        slave.write_all(&[MARK]).unwrap();
        let mut bytes = [0; 256];
        while self.asked.len() % QUESTION != 1 || self.asked.last() != Some(&MARK) {
            let mut asked = [PollFd::new(master.as_fd(), PollFlags::POLLIN)];
            assert_eq!(poll(&mut asked, PollTimeout::NONE), Ok(1));
            let read = master.read(&mut bytes).unwrap();
            self.asked.extend(&bytes[..read]);
        }
        self.asked.pop();
        let ticks = (at.as_s() * 0.1 / (0.033 * std::f64::consts::TAU / 4_096.0)) as i32;
        let mut put = |from: usize, bytes: [u8; 4]| self.table[from..from + 4].copy_from_slice(&bytes);
        put(10, ((at.as_us() / 1_000) as u32).to_le_bytes());
        put(14, (at.as_us() as u32).to_le_bytes());
        put(96, 1f32.to_le_bytes());
        put(136, ticks.to_le_bytes());
        put(140, ticks.to_le_bytes());
        while self.asked.len() >= QUESTION {
            let asked: Vec<u8> = self.asked.drain(..QUESTION).collect();
            assert_eq!(asked[7], instruction::READ, "the source only reads");
            let word = |at: usize| usize::from(u16::from_le_bytes([asked[at], asked[at + 1]]));
            let mut out = Vec::new();
            emit(200, instruction::STATUS, &[&[0], &self.table[word(8)..word(8) + word(10)]].concat(), &mut out);
            master.write_all(&out).unwrap();
            // A worker of the kernel carries it over: virtual time stands still until it has.
            let mut arrived = [PollFd::new(slave.as_fd(), PollFlags::POLLIN)];
            assert_eq!(poll(&mut arrived, PollTimeout::NONE), Ok(1), "the answer arrives");
        }
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.link);
    }
}

thread_local! {
    static NOW: std::cell::Cell<Instant> = const { std::cell::Cell::new(Instant::ZERO) };
}

fn wall_us() -> Option<i64> {
    Some(WALL_US + NOW.get().as_us())
}

/// Drives both ends up to `until`, in virtual time.
fn drive(source: &mut Serial, device: &mut Device, until: Instant) -> Vec<NextPose> {
    let mut got = Vec::new();
    while NOW.get() < until {
        loop {
            match source.receive(NOW.get()).unwrap() {
                NextPose::Pending => break,
                next => got.push(next),
            }
        }
        device.answer(NOW.get());
        NOW.set(source.next_at().unwrap().min(NOW.get() + Span::from_ms(20)));
    }
    got
}

fn poses(got: &[NextPose]) -> Vec<(f64, f64)> {
    let pose = |next: &NextPose| match next {
        NextPose::Pose(pose) => Some((pose.t_s - WALL_US as f64 * 1e-6, pose.position_m.x)),
        _ => None,
    };
    got.iter().filter_map(pose).collect()
}

#[test]
fn a_port_that_is_unplugged_and_plugged_in_again() {
    let mut device = Device::new("opencr-port");
    let mut source = Serial::open(device.link.clone(), 50.0, None, Instant::ZERO, wall_us).unwrap();
    assert!(poses(&drive(&mut source, &mut device, Instant::from_us(1_000_000))).is_empty());
    assert!(source.trouble().unwrap().contains("plugged in"), "{:?}", source.trouble());
    device.plug();
    let first = poses(&drive(&mut source, &mut device, Instant::from_us(5_000_000)));
    assert!(first.len() > 150, "{} poses in 4 s", first.len());
    assert_eq!(source.trouble(), None);
    device.unplug();
    assert!(poses(&drive(&mut source, &mut device, Instant::from_us(7_000_000))).is_empty());
    assert!(source.trouble().is_some());
    device.plug();
    let got = drive(&mut source, &mut device, Instant::from_us(10_000_000));
    assert!(!got.contains(&NextPose::NewFrame), "the controller went on, its ticks too");
    let again = poses(&got);
    assert!(again.len() > 100 && source.trouble().is_none(), "{}", again.len());
    // What was driven while it was unplugged is in the ticks.
    // The fit of the clocks has settled by the middle of the first stretch.
    let (from, to) = (first[first.len() / 2], again[again.len() - 1]);
    assert!((to.1 - from.1 - 0.1 * (to.0 - from.0)).abs() < 2e-3, "{from:?} {to:?}");
    assert!((to.0 - 10.0).abs() < 0.1, "its time is the host's: {to:?}");
    assert!(matches!(source.counted(), Some(SourceCounts::Controller { unplugged: 1, .. })));
}

#[test]
fn files_that_are_no_port_are_refused() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let refused = Serial::open(folder.to_owned(), 50.0, None, Instant::ZERO, wall_us).err().unwrap();
    assert!(refused.to_string().contains("no serial port"));
}
