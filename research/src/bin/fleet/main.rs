//! Limits of fleets: air time, network traffic and processor time of each robot (`docs/method/fleet.md`):
//! `cargo run --release --bin fleet [ROBOTS..]`.
//!
//! Air time is computed, channels are simulated, and messages and processor time are measured on one pair.

mod air;
mod pair;

use air::{Got, Shared};
use csi5300::signal::channel::Channel;
use pair::Pair;
use std::fs::read_to_string;

type Fallible<T> = Result<T, Box<dyn std::error::Error>>;

/// Sizes of groups alone on a channel, sizes of fleets, numbers of channels, and size of small groups.
const ALONE: [u16; 5] = [2, 5, 10, 20, 50];
const FLEETS: [u16; 3] = [10, 100, 1_000];
const CHANNELS: [u16; 4] = [1, 3, 8, 24];
const SMALL: u16 = 10;
/// Speed of the robots, and capacity of a router's link (1 Gbit/s), bytes per second.
const DRIVE_M_S: f64 = 0.1;
const ROUTER_BYTES_HZ: f64 = 125e6;
/// Greatest distance driven between two exchanges, wavelengths; beyond it, the sign of the one-way channel is lost
/// (`src/estimate/signal.rs`).
const SPACING: f64 = 0.25;

fn main() -> Fallible<()> {
    let asked: Vec<u16> = std::env::args().skip(1).map(|robots| robots.parse()).collect::<Result<_, _>>()?;
    let fleets = if asked.is_empty() { FLEETS.to_vec() } else { asked };
    let channel: Channel = "108".parse()?;
    let spacing_m = SPACING * channel.wavelength_m();
    print_air()?;
    let pair = pair::measure(channel)?;
    print_pair(&pair);
    println!("\n| robots | exchanges/s, computed | simulated | age, s | drive, m/s |\n|---|---|---|---|---|");
    for size in ALONE {
        let alone = Shared { groups: 1, size };
        let (computed_hz, got) = (alone.computed_hz(&alone.plan()?.1), alone.simulate()?);
        let Got { exchanges_hz, age_s, .. } = got;
        println!("| {size} | {computed_hz:.1} | {exchanges_hz:.1} | {age_s:.3} | {:.3} |", spacing_m / age_s);
    }
    println!(
        "\n| robots | channels | groups | exchanges/s | lost | bearings/s | age, s | kB/s | router, MB/s | processor | breaks |\n|---|---|---|---|---|---|---|---|---|---|---|"
    );
    for robots in fleets {
        for channels in CHANNELS.into_iter().filter(|channels| robots / channels > 1) {
            let size = robots.div_ceil(channels);
            let small = (size > SMALL).then(|| Shared { groups: size.div_ceil(SMALL), size: SMALL });
            for shared in [Shared { groups: 1, size }].into_iter().chain(small) {
                let head = format!("| {robots} | {channels} | {} of {} |", shared.groups * channels, shared.size);
                match shared.plan() {
                    Err(error) => println!("{head} | | | | | | | {error} |"),
                    Ok(_) => {
                        let got = shared.simulate()?;
                        println!("{head} {} {}", row(&got), costs(&pair, shared, &got, spacing_m));
                    }
                }
            }
        }
    }
    Ok(())
}

fn print_air() -> Fallible<()> {
    let (request, plan) = Shared { groups: 1, size: 2 }.plan()?;
    let (forward, backward) = request.dialect.longest(1);
    let [forward_us, backward_us] = [forward, backward].map(|bytes| request.phy.airtime_us(bytes));
    let (turn_around_us, guards_us, slot_us) = (request.turn_around_us, 2 * request.guard_us, plan.shortest_slot_us);
    println!(
        "computed: {forward} bytes {forward_us} us, turn-around {turn_around_us} us, {backward} bytes {backward_us} us, guards {guards_us} us: {slot_us} us, {:.0} exchanges/s",
        1e6 / f64::from(slot_us)
    );
    Ok(())
}

fn print_pair(pair: &Pair) {
    let Pair { record_bytes, pose_bytes, line_bytes, poses_hz, record_s, bearing_s } = pair;
    println!(
        "measured: record {record_bytes:.0} bytes, pose {pose_bytes:.0} bytes at {poses_hz:.0} Hz, bearing {line_bytes:.0} bytes; {:.1} us a record, {:.1} ms a bearing",
        1e6 * record_s,
        1e3 * bearing_s
    );
    let said = |path: &str| read_to_string(path).unwrap_or_default();
    let (processor, load) = (said("/proc/cpuinfo"), said("/proc/loadavg"));
    let model = processor.lines().find_map(|line| line.strip_prefix("model name")).unwrap_or_default();
    println!("processor{model}, load {}", load.split(' ').next().unwrap_or_default());
}

fn row(got: &Got) -> String {
    let Got { exchanges_hz, lost, bearings_hz, age_s, .. } = got;
    format!("{exchanges_hz:.1} | {:.1} % | {bearings_hz:.1} | {age_s:.2} |", 1e2 * lost)
}

/// Traffic of a robot and of its group's router, the robot's share of a core, and the exceeded limits.
fn costs(pair: &Pair, shared: Shared, got: &Got, spacing_m: f64) -> String {
    let peers = f64::from(shared.size - 1);
    let sent_hz = got.records_hz * pair.record_bytes + pair.poses_hz * pair.pose_bytes;
    let router_hz = sent_hz * peers * f64::from(shared.size);
    // A robot receives all records of its peers, including those of exchanges between others.
    let processor = got.bearings_hz * pair.bearing_s + got.records_hz * pair.record_s * (1.0 + peers);
    let [air, router] = [DRIVE_M_S * got.age_s / spacing_m, router_hz / ROUTER_BYTES_HZ];
    let shares = [("air", air), ("router", router), ("processor", processor)];
    let broken =
        shares.into_iter().filter(|(_, share)| *share > 1.0).map(|(what, share)| format!("{what} {share:.1}x"));
    let broken: Vec<String> = broken.collect();
    format!("{:.0} | {:.1} | {:.0} % | {} |", 1e-3 * sent_hz, 1e-6 * router_hz, 1e2 * processor, broken.join(", "))
}
