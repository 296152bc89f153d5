//! What a fleet needs of air, network and processor: groups of robots that sound each other on one channel, simulated, and
//! one pair's bearing, timed: `cargo run --release --bin fleet`. docs/method/fleet.md explains the table.

use csi5300::exchange::tdma::{Plan, Request};
use csi5300::pipeline::{Options, Transmitter, bearings};
use csi5300_sim::scene::{Dialect, Robot, Sounding};
use csi5300_sim::{Room, Scene, Simulation};
use std::error::Error;
use std::time::Instant;

type Fallible<T> = Result<T, Box<dyn Error>>;

/// Length of each simulation, seconds.
const DURATION_S: f64 = 20.0;
/// Robots of the fleet.
const FLEET: usize = 1_000;
/// Channels of 20 MHz at 5 GHz that may transmit in most countries, those with radar among them.
const CHANNELS: usize = 19;
/// Samples of a round trip no further apart than this tell every direction, wavelengths (one-way channel's signs).
const SPACING: f64 = 0.25;

fn main() -> Fallible<()> {
    let wavelength_m = options()?.channel.wavelength_m();
    let [per_exchange_us, per_bearing_ms] = cost_of_a_pair()?;
    println!("one pair, one core: {per_exchange_us:.1} us to read and pair an exchange, {per_bearing_ms:.1} ms a bearing");
    println!("robots in a group | exchanges/s planned, simulated | a pair/s | fastest drive, m/s | log, kB/s a robot | processor, % of a core");
    for robots in [2, 4, 8, 16, 32] {
        let own = Group::run(robots)?;
        let pairs = (robots * (robots - 1) / 2) as f64;
        let each_hz = own.exchanges_per_s / pairs;
        // A robot reads all its exchanges, and makes a bearing to each peer once a second.
        let peers = (robots - 1) as f64;
        let busy = peers * (each_hz * per_exchange_us * 1e-6 + per_bearing_ms * 1e-3);
        println!(
            "{robots} | {:.0}, {:.0} | {each_hz:.1} | {:.2} | {:.1} | {:.1}",
            own.planned_per_s,
            own.exchanges_per_s,
            each_hz * SPACING * wavelength_m,
            own.bytes_per_s * 1e-3,
            100.0 * busy
        );
        let groups = FLEET.div_ceil(robots);
        println!(
            "  {FLEET} robots: {groups} groups, {} of them on each of {CHANNELS} channels, which must not hear each other or take turns",
            groups.div_ceil(CHANNELS)
        );
    }
    Ok(())
}

fn options() -> Fallible<Options> {
    Ok(Options::new("108".parse()?).with_parallel(false))
}

/// Robots on a circle, ideal radios.
fn scene(robots: usize) -> Scene {
    let name = |k: usize| format!("r{k}");
    let robot = |k: usize| {
        let (sin, cos) = (k as f64 * std::f64::consts::TAU / robots as f64).sin_cos();
        Robot { name: name(k), position_m: [6.0 * cos, 6.0 * sin, 0.3], ..Robot::default() }
    };
    let initiators = (0..robots).map(name).collect();
    let sounding = Sounding { rate_hz: f64::INFINITY, initiators, dialect: Dialect::Native, start_s: 0.0 };
    let robot = (0..robots).map(robot).collect();
    Scene { duration_s: DURATION_S, channel: 108, sounding: Some(sounding), robot, ..Scene::default() }
}

/// Robots of one channel that all sound each other, as fast as fits.
struct Group {
    planned_per_s: f64,
    exchanges_per_s: f64,
    /// What a robot logs.
    bytes_per_s: f64,
}

impl Group {
    fn run(robots: usize) -> Fallible<Self> {
        let run = Room::new(&scene(robots))?.run()?;
        let records: u64 = run.robots.iter().map(|robot| robot.records).sum();
        let bytes: usize = run.robots.iter().map(|robot| robot.log.len()).sum();
        let plan = Plan::new(&Request::new(u16::try_from(robots - 1)?, 1.0))?;
        Ok(Self {
            planned_per_s: 1e6 / f64::from(plan.shortest_slot_us()),
            // A forward and a backward record each.
            exchanges_per_s: records as f64 / 2.0 / DURATION_S,
            bytes_per_s: bytes as f64 / robots as f64 / DURATION_S,
        })
    }
}

/// Microseconds an exchange without an estimate, milliseconds an estimate, on one core, in the room `lab-circle`.
fn cost_of_a_pair() -> Fallible<[f64; 2]> {
    let run = Room::new(&Scene::built_in("lab-circle").ok_or("no lab-circle")?)?.run()?;
    let (whole_s, pairs) = timed(&run, &options()?)?;
    // A cut that leaves no pair reads and pairs everything, and estimates nothing.
    let (read_s, _) = timed(&run, &options()?.with_cut(Some(1e6), None))?;
    Ok([1e6 * read_s / pairs as f64, 1e3 * (whole_s - read_s)])
}

/// The quickest of ten runs, seconds, and the pairs that it had.
fn timed(run: &Simulation, options: &Options) -> Fallible<(f64, usize)> {
    let (rx, tx) = (run.robot("rx").ok_or("no rx")?, run.robot("tx").ok_or("no tx")?);
    let path = rx.true_path.as_ref().ok_or("no path")?;
    let (mut quickest_s, mut pairs) = (f64::INFINITY, 1);
    for _ in 0..10 {
        let (mut own, mut other) = (rx.replay(), tx.replay());
        let began = Instant::now();
        let report = bearings(&mut own, vec![Transmitter { log: &mut other, trajectory: None }], path, options)?;
        quickest_s = quickest_s.min(began.elapsed().as_secs_f64());
        if let Some(Ok(bearing)) = report.links.first().map(|link| &link.bearing) {
            pairs = bearing.pairs.formed.max(1);
        }
    }
    Ok((quickest_s, pairs))
}
