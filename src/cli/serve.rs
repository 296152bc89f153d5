//! `csi5300 simulate --serve`: a room in real time.

use super::live::Signals;
use super::{Outcome, Result};
use csi5300::backend::netlink::Sender;
use csi5300::backend::sim::{Odometer, Port, Room, Scene};
use csi5300::backend::{CsiSource, Loss, Next};
use csi5300::odometry::{NextPose, OdometrySource};
use csi5300::time::{Instant, Span};
use csi5300::wait::{Monotonic, wall_us};
use driver_iface::connector::CN_IDX;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::os::fd::AsFd;
use std::path::PathBuf;

/// How a room is served.
#[derive(clap::Args)]
#[group(id = "serving")]
pub struct Args {
    /// Run the room in real time: a robot's records go out on the kernel's connector, as its driver would send them
    #[arg(long, conflicts_with_all = ["out", "force"])]
    pub serve: bool,
    /// The robot that is served, =INDEX for another connector index; several for several. The first initiator if none
    #[arg(long, value_name = "NAME[=INDEX]", value_parser = served)]
    robot: Vec<(String, u32)>,
    /// Append the poses of the robot's odometry here, a CSV line each as they come; - is standard output. Once for
    /// each --robot, in their order
    #[arg(long, value_name = "FILE")]
    poses: Vec<PathBuf>,
    /// Times real time (1 if not given); max does not wait at all
    #[arg(long, value_parser = super::live::speed)]
    speed: Option<f64>,
}

impl Args {
    /// True if anything was asked of serving.
    pub fn asked(&self) -> bool {
        !self.robot.is_empty() || !self.poses.is_empty() || self.speed.is_some()
    }
}

fn served(text: &str) -> std::result::Result<(String, u32), String> {
    match text.rsplit_once('=') {
        None => Ok((text.to_owned(), CN_IDX)),
        Some((name, index)) => {
            let index = index.parse().ok().filter(|index| (1..=32).contains(index));
            index.map(|index| (name.to_owned(), index)).ok_or_else(|| "a connector index is 1 to 32".into())
        }
    }
}

/// One robot whose card and odometry are served.
struct Served {
    name: String,
    card: Port,
    sender: Sender,
    sent: u64,
    poses: Option<(Odometer, Box<dyn Write>)>,
    card_over: bool,
}

type Words<T> = std::result::Result<T, String>;

/// Serves a scene until its end or a signal.
pub fn run(mut scene: Scene, args: &Args) -> Result {
    let signals = Signals::catch()?;
    let outputs = open(&scene, args)?;
    for output in &outputs {
        eprintln!("serving {} on connector index {}", output.name, output.sender.index());
    }
    // Times are of now: the scene begins when this clock does.
    let (clock, wall_us) = (Monotonic::new(), wall_us());
    let start_us = wall_us.unwrap_or(scene.start_unix_s.saturating_mul(1_000_000));
    scene.start_unix_s = start_us.div_euclid(1_000_000);
    for robot in &mut scene.robot {
        robot.host_clock.offset_s += start_us.rem_euclid(1_000_000) as f64 * 1e-6;
        // The real socket has its own queue, and the real listener stalls by itself.
        (robot.faults.queue_records, robot.faults.stall_every_s) = (usize::MAX, 0.0);
    }
    let mut room = Room::new(&scene).map_err(|error| error.to_string())?;
    let mut all = outputs.into_iter().map(|output| output.of(&mut room)).collect::<Words<Vec<_>>>()?;
    let speed = args.speed.unwrap_or(1.0);
    let (mut now, mut behind) = (Instant::ZERO, Span::ZERO);
    loop {
        let mut next: Option<Instant> = None;
        for robot in &mut all {
            next = [next, robot.pump(now)?].into_iter().flatten().min();
        }
        let Some(next) = next else { break };
        // Without waiting, time still passes event by event.
        let until = speed.is_finite().then(|| Span::from_s(next.as_s() / speed));
        let until = until.map(|span| Instant::ZERO + span + Span::from_us(1));
        if clock.wait([signals.as_fd()], Some(until.unwrap_or(Instant::ZERO))).map_err(|error| error.to_string())?[0] {
            break;
        }
        let woken = clock.now();
        let waited = match speed.is_finite() {
            true => Instant::ZERO + Span::from_s(woken.as_s() * speed),
            false => next,
        };
        behind = until.map_or(behind, |until| behind.max(woken - until));
        now = waited.max(now);
    }
    let mut sent = 0;
    for (robot, injected) in all.iter().map(|robot| (robot, room.injected())) {
        sent += robot.sent;
        let number = room.number(&robot.name).unwrap_or_default();
        eprintln!("{}: {} records sent; injected {:?}", robot.name, robot.sent, injected.get(number));
    }
    if speed.is_finite() {
        eprintln!("at most {:.1} ms behind real time", behind.as_s() * 1e3);
    }
    Ok(if sent == 0 { Outcome::Nothing } else { Outcome::Done })
}

/// Opens everything that may take time or fail, before the scene's time begins.
fn open(scene: &Scene, args: &Args) -> Words<Vec<Output>> {
    let first = scene.initiators().first().and_then(|&k| scene.robot.get(k)).map(|robot| robot.name.clone());
    let named = if args.robot.is_empty() { vec![(first.unwrap_or_default(), CN_IDX)] } else { args.robot.clone() };
    if args.poses.len() > named.len() {
        return Err(format!("{} files for poses and {} robots served", args.poses.len(), named.len()));
    }
    for (k, (name, index)) in named.iter().enumerate() {
        if !scene.robot.iter().any(|robot| robot.name == *name) {
            return Err(format!("no robot {name} in the scene"));
        }
        for (other, same) in &named[..k] {
            if other == name {
                return Err(format!("{name} is served twice"));
            }
            if same == index {
                let free = "give each its own, such as NAME=27";
                return Err(format!("{other} and {name} would both be served on connector index {index}: {free}"));
            }
        }
    }
    let output = |(k, (name, index)): (usize, (String, u32))| {
        let sender = Sender::open(index, true).map_err(|error| error.to_string())?;
        let poses = args.poses.get(k).map(append).transpose()?;
        Ok(Output { name, sender, poses })
    };
    named.into_iter().enumerate().map(output).collect()
}

/// Where a robot's records and poses go.
struct Output {
    name: String,
    sender: Sender,
    poses: Option<Box<dyn Write>>,
}

impl Output {
    /// Joins the outputs with the robot's card and odometry.
    fn of(self, room: &mut Room) -> Words<Served> {
        let Self { name, sender, poses } = self;
        let number = room.number(&name).ok_or_else(|| format!("no robot {name} in the scene"))?;
        let card = room.card(number).ok_or_else(|| format!("{name} is served twice"))?;
        let poses = poses.and_then(|out| room.odometry(number).map(|source| (source, out)));
        Ok(Served { name, card, sender, sent: 0, poses, card_over: false })
    }
}

fn append(path: &PathBuf) -> Words<Box<dyn Write>> {
    if path.as_os_str() == "-" {
        return Ok(Box::new(std::io::stdout()));
    }
    let file: File = OpenOptions::new()
        .create(true)
        .append(true)
        .open(path)
        .map_err(|error| format!("cannot append poses to {}: {error}", path.display()))?;
    Ok(Box::new(file))
}

impl Served {
    /// Sends what is due by `now`; when there is more, or nothing at the end.
    fn pump(&mut self, now: Instant) -> Words<Option<Instant>> {
        let words = |error: csi5300::backend::Error| error.to_string();
        while !self.card_over {
            match self.card.receive(now).map_err(words)? {
                Next::Record(_, record) => {
                    self.sender.send(record).map_err(words)?;
                    self.sent += 1;
                }
                Next::Lost(Loss::Overrun { .. } | Loss::Bytes { .. } | Loss::Datagram { .. }) => {}
                Next::Pending => break,
                Next::End(_) => self.card_over = true,
            }
        }
        let card_at = if self.card_over { None } else { self.card.next_at() };
        Ok([card_at, self.pump_poses(now)?].into_iter().flatten().min())
    }

    /// Writes the poses that are due, in the columns of motion capture with a heading.
    fn pump_poses(&mut self, now: Instant) -> Words<Option<Instant>> {
        let Some((source, out)) = &mut self.poses else { return Ok(None) };
        let mut written = false;
        let at = loop {
            match source.receive(now).map_err(|error| error.to_string())? {
                NextPose::Pose(pose) => {
                    let (p, yaw) = (pose.position_m, pose.heading_rad.unwrap_or(0.0));
                    writeln!(out, "{:.6},0,{:.6},{:.6},{:.6},{yaw:.6},", pose.t_s, p.x, p.y, p.z)
                        .map_err(|error| format!("cannot write a pose: {error}"))?;
                    written = true;
                }
                NextPose::NewFrame => {}
                NextPose::Pending => break source.next_at(),
                NextPose::End => break None,
            }
        };
        if written {
            out.flush().map_err(|error| format!("cannot write a pose: {error}"))?;
        }
        Ok(at)
    }
}
