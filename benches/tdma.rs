//! What the scheduler costs: nanoseconds per frame heard or sent, and allocations after the start.
//!
//! An exchange of 13 robots (12 peers at 100 rounds/s) runs once in virtual time; the calls that one robot's driver
//! made are recorded and then made again on a fresh scheduler, timed as a whole. Every call counts in the time, but
//! only frames heard and sent count as events.

use csi5300::exchange::tdma::{Config, Dialect, Epoch, Key, Plan, Request, Tdma};
use csi5300::time::{Instant, Span};
use driver_iface::Mac;
use driver_iface::sounding::native::Role;
use std::hint::black_box;

const PEERS: usize = 12;
const SECONDS: f64 = 60.0;
const REPETITIONS: usize = 7;
/// What is asked for.
const LIMIT_NS: f64 = 200.0;

/// A call of a driver.
enum Call {
    Heard(Instant, Box<[u8]>),
    Serve(Instant),
}

fn main() {
    let native = |measurement, authenticated| Dialect::Native { measurement, authenticated };
    let dialects =
        [("native", native(true, false)), ("native, tag", native(true, true)), ("wsr", Dialect::Wsr { first_len: 57 })];
    let roles = ["initiator", "responder"];
    println!("{:<12} {:<10} {:>9} {:>10} {:>12}", "dialect", "robot", "events", "ns/event", "allocations");
    let mut is_met = true;
    for (name, dialect) in dialects {
        for (k, role) in roles.iter().enumerate() {
            let configs = configs(dialect);
            let (calls, events) = record(&configs, k);
            let best = (0..REPETITIONS).map(|_| replay(&configs[k], &calls)).fold(f64::INFINITY, f64::min);
            let ns = best / events as f64;
            let mut tdma = scheduler(&configs[k]);
            let allocations = allocation_counter::measure(|| make(&mut tdma, &calls)).count_total;
            println!("{name:<12} {role:<10} {events:>9} {ns:>10.1} {allocations:>12}");
            is_met &= ns < LIMIT_NS && allocations == 0;
        }
    }
    if !is_met {
        println!("above {LIMIT_NS} ns per event, or allocating");
        std::process::exit(1);
    }
}

fn configs(dialect: Dialect) -> Vec<Config> {
    let macs: Vec<Mac> = (0..=PEERS as u8).map(|last| Mac([2, 0, 0, 0, 0, last])).collect();
    let request = Request { dialect, ..Request::new(PEERS as u16, 100.0) };
    let is_authenticated = matches!(dialect, Dialect::Native { authenticated: true, .. });
    let config = |(own, index): (&Mac, u16)| {
        let peers: Vec<Mac> = macs.iter().copied().filter(|mac| mac != own).collect();
        let mut config = Config::new(*own, index, &peers, request, 1);
        config.peers.iter_mut().for_each(|peer| peer.index = u16::from(peer.mac.0[5]));
        config.initiate = index == 0;
        config.epoch = Epoch::Common(Instant::ZERO);
        config.key = is_authenticated.then(|| Key::new([7; 16]));
        config
    };
    macs.iter().zip(0..).map(config).collect()
}

fn scheduler(config: &Config) -> Tdma {
    match Tdma::new(config) {
        Ok(tdma) => tdma,
        Err(error) => {
            println!("no plan: {error}");
            std::process::exit(2)
        }
    }
}

/// Runs the exchange and writes down the calls of robot `watched`, and how many frames it heard and sent.
fn record(configs: &[Config], watched: usize) -> (Vec<Call>, usize) {
    let mut robots: Vec<Tdma> = configs.iter().map(scheduler).collect();
    let plan: Plan = *robots[0].plan();
    let (mut calls, mut events) = (Vec::new(), 0);
    let mut now = Instant::ZERO;
    while now.as_s() < SECONDS {
        let next = robots.iter().enumerate().filter_map(|(k, robot)| Some((robot.poll_timeout()?, k))).min();
        let Some((at, k)) = next else { break };
        now = now.max(at);
        if k == watched {
            calls.push(Call::Serve(now));
        }
        let mut sent = send(&mut robots[k], now);
        events += usize::from(sent.is_some() && k == watched);
        let mut sender = k;
        while let Some((role, frame)) = sent.take() {
            let airtime_us = plan.phy.airtime_us(frame.len() + 4) + if role == Role::Forward { 100 } else { 0 };
            now += Span::from_us(i64::from(airtime_us));
            let mut answer = None;
            for (other, robot) in robots.iter_mut().enumerate().filter(|(other, _)| *other != sender) {
                robot.handle_heard(now, now, &frame);
                if other == watched {
                    calls.push(Call::Heard(now, frame.clone()));
                    calls.push(Call::Serve(now));
                    events += 1;
                }
                let reply = send(robot, now);
                if let Some(reply) = reply {
                    events += usize::from(other == watched);
                    answer = Some((other, reply));
                }
            }
            if let Some((other, reply)) = answer {
                (sender, sent) = (other, Some(reply));
            }
        }
    }
    (calls, events)
}

/// One frame that is due, with its role.
fn send(robot: &mut Tdma, now: Instant) -> Option<(Role, Box<[u8]>)> {
    let mut sent = None;
    while let Some(transmit) = robot.poll_transmit(now) {
        sent = Some((transmit.role, transmit.frame.into()));
    }
    while robot.poll_event().is_some() {}
    sent
}

/// Nanoseconds that the calls take on a fresh scheduler.
fn replay(config: &Config, calls: &[Call]) -> f64 {
    let mut tdma = scheduler(config);
    let start = std::time::Instant::now();
    make(&mut tdma, calls);
    start.elapsed().as_secs_f64() * 1e9
}

fn make(tdma: &mut Tdma, calls: &[Call]) {
    for call in calls {
        match call {
            Call::Heard(now, frame) => tdma.handle_heard(*now, *now, frame),
            Call::Serve(now) => {
                while let Some(transmit) = tdma.poll_transmit(*now) {
                    black_box(transmit.frame);
                }
                while let Some(event) = tdma.poll_event() {
                    black_box(event);
                }
                black_box(tdma.poll_timeout());
            }
        }
    }
}
