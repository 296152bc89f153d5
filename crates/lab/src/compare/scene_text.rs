//! The text of a fitted scene.

use super::distribution::QUARTILES;
use super::figures::{Figures, Group};
use super::fit::{Adjusted, Known, middle, noise};
use super::pattern::pattern;
use super::side::{Side, usual};
use csi5300::motion::pose::Trajectory;
use csi5300::signal::channel::{Channel, Width};
use std::f64::consts::TAU;
use std::fmt::Write;

/// Subcarriers' spacing, Hz.
const SPACING_HZ: f64 = csi5300::signal::channel::SUBCARRIER_SPACING_HZ;
/// A recorded trajectory strays in so many swings: slowly, as the windows of a second stay coherent.
const SWINGS: f64 = 3.0;
/// Decibels by which an amplitude grows that grows by a factor of e.
const DB_PER_E: f64 = 8.685_889_638;

/// Writes the scene of a recording: what its figures say, and what is adjusted.
pub(super) fn write(
    recorded: &Figures,
    known: &Known<'_>,
    place: [f64; 3],
    adjusted: &Adjusted,
    channel: Channel,
    seed: u64,
) -> String {
    let pattern = pattern(&recorded.receiver.powers, known.trajectory, place);
    let (rx, tx, link) = (&recorded.receiver, &recorded.transmitter, &recorded.link);
    let (from_s, to_s) = known.trajectory.span_s();
    let (first_us, last_us) = rx.host_us.unwrap_or(((from_s * 1e6) as i64, (to_s * 1e6) as i64));
    let start_unix_s = (first_us.div_euclid(1_000_000)).min(from_s.floor() as i64);
    let since = |us: i64| (us - start_unix_s * 1_000_000) as f64 * 1e-6;
    let start_s = brief((since(first_us) - 0.001).max(0.0));
    let interval_us = tx.interval_us.median;
    let mut text =
        String::from("# Fitted to a recorded capture; see docs/simulation.md for what each figure is taken from.\n");
    let _ = write!(
        text,
        "name = \"fitted\"\nseed = {seed}\nduration_s = {:?}\nchannel = {}\nbandwidth_mhz = {}\ndriver = {:?}\n\
         start_unix_s = {start_unix_s}\ncfo = \"physical\"\nreflections = {}\n\n[sounding]\nrate_hz = {:?}\nstart_s = {start_s:?}\n",
        brief(since(last_us) + 0.005),
        scene_channel(channel),
        if is_wide(rx) { 40 } else { 20 },
        if 2 * rx.stock > rx.records { "stock" } else { "wsr" },
        if adjusted.wall_loss_db.is_some() { 2 } else { 0 },
        brief(1e6 / interval_us.max(1.0)),
    );
    let [x, y, z] = known.trajectory.poses().first().map_or([0.0; 3], |pose| pose.position_m.into());
    let clock_start = |side: &Side| {
        let first_us = side.clock_us.map_or(0, |(first, _)| first);
        (first_us - (start_s * 1e6) as i64).rem_euclid(1 << 32)
    };
    // Cards are told by their hosts' clocks, and the hosts by each other; the offset itself is the finer measure of
    // how far the cards are apart.
    let apart_ppm = 1e6 * link.df_hz / channel.centre_hz();
    let rx_ppm = rx.card_ppm;
    let tx_ppm = brief(rx_ppm + apart_ppm);
    // The clocks were compared in the middle of the capture, an answer later on one side than on the other.
    let host_ppm = tx_ppm - tx.card_ppm;
    let middle_s = 0.5 * (since(first_us) + since(last_us));
    let later_us = TURN_AROUND_US + mean_latency_us(rx, 0) - mean_latency_us(tx, 1);
    let host_offset_s = link.host_apart_s.map_or(0.0, |s| s + 1e-6 * (later_us - host_ppm * middle_s));
    let backward_loss = brief((rx.missing - tx.missing).max(0.0));
    let _ = write!(
        text,
        "\n[[robot]]\nname = \"rx\"\nposition_m = [{x:?}, {y:?}, {z:?}]\n\
         motion.recorded = {{ file = {:?}, start_s = {:?}, stray_m = {:?}, stray_s = {:?} }}\n\
         pattern = {{ cos_db = {:?}, sin_db = {:?}, cos2_db = {:?}, sin2_db = {:?} }}\n\
         crystal = {{ offset_ppm = {rx_ppm:?}, clock_start_us = {} }}\nfaults = {{ loss = {backward_loss:?}, killed = {} }}\n",
        known.file,
        brief(from_s - start_unix_s as f64),
        brief(adjusted.stray_m),
        brief(((to_s - from_s) / SWINGS).max(0.1)),
        brief(pattern.cos_db),
        brief(pattern.sin_db),
        brief(pattern.cos2_db),
        brief(pattern.sin2_db),
        clock_start(rx),
        rx.tail_bytes > 0,
    );
    let away_m = (middle(known.trajectory) - nalgebra::Vector3::from(place)).norm();
    let flight_ns = 1e9 * away_m / csi5300::signal::channel::SPEED_OF_LIGHT_M_PER_S;
    radio(&mut text, [rx, tx], adjusted, 0, flight_ns);
    let (jitter_us, delay) = lateness(tx);
    let _ = writeln!(text, "send_jitter_us = {:?}\nsend_delay = {}", brief(jitter_us), group_text(delay));
    let _ = write!(
        text,
        "\n[[robot]]\nname = \"tx\"\nposition_m = {place:?}\n\
         crystal = {{ offset_ppm = {tx_ppm:?}, clock_start_us = {} }}\n\
         host_clock = {{ offset_s = {:?}, drift_ppm = {:?} }}\nfaults = {{ loss = {:?}, killed = {} }}\n",
        clock_start(tx),
        host_offset_s,
        brief(host_ppm),
        brief(tx.missing),
        tx.tail_bytes > 0,
    );
    radio(&mut text, [tx, rx], adjusted, 1, flight_ns);
    let ([early, far, late], turn) = (link.groups, &link.turn_around_us);
    let _ = writeln!(
        text,
        "turn_around = {{ median_us = {TURN_AROUND_US:?}, spread_us = {:?}, tail = {:?}, tail_us = {:?}, \
         tail_spread_us = {:?}, far = {}, late = {}, tail_run = {:?}, min_us = {:?}, max_us = {:?} }}",
        brief(adjusted.core_us),
        brief(early.share),
        brief(early.mean_us),
        brief(early.sd_us),
        group_text(far),
        group_text(late),
        brief(link.run.unwrap_or(0.0)),
        brief((TURN_AROUND_US + turn.min - turn.median).max(0.0)),
        brief(TURN_AROUND_US + turn.max - turn.median),
    );
    if let Some(loss_db) = adjusted.wall_loss_db {
        walls(&mut text, known.trajectory, place, loss_db, adjusted.margin_m);
    }
    text
}

fn group_text(group: Group) -> String {
    let [share, us, spread_us] = [group.share, group.mean_us, group.sd_us].map(brief);
    format!("{{ share = {share:?}, us = {us:?}, spread_us = {spread_us:?} }}")
}

/// How late the sender sends: the mean of the exponential lateness of most frames, microseconds, and the delays of the
/// others.
///
/// The difference of two exponential latenesses is symmetric; beyond `x` on one side is half of `exp(-x / mean)` of it. A
/// delayed frame makes one interval long and the next one short, so it takes its share of either side.
fn lateness(side: &Side) -> (f64, Group) {
    let share = side.delayed.share.min(0.2);
    let beyond = (0.25 - share) / (1.0 - 2.0 * share);
    let mean_us = 0.5 * side.interval_us.quartile_range() / -(2.0 * beyond).ln();
    // What is drawn later than usual is so beside the usual lateness.
    let sd_us = (side.delayed.sd_us.powi(2) - 2.0 * mean_us.powi(2)).max(0.0).sqrt();
    (mean_us, Group { share, sd_us, ..side.delayed })
}

/// Six significant digits: no figure is known better.
fn brief(value: f64) -> f64 {
    format!("{value:.5e}").parse().unwrap_or(value)
}

/// Whether the card reported channels of 40 MHz.
pub(super) fn is_wide(side: &Side) -> bool {
    usual(&side.rates).is_some_and(|rate| rate & RATE_40_MHZ != 0)
}

/// Standard deviation of a host's latency, microseconds. The responder's host is early where its answers are, which is
/// said with them; the rest is the core.
fn latency_us(side: &Side, k: usize) -> f64 {
    if k == 1 { side.latency_core_us } else { side.latency_us.quartile_range() / QUARTILES }
}

fn mean_latency_us(side: &Side, k: usize) -> f64 {
    LATENCY_US + 3.0 * latency_us(side, k)
}

/// A robot's radio: what its own log says of it, and what the other's says of how it sent.
fn radio(text: &mut String, [side, other]: [&Side; 2], adjusted: &Adjusted, k: usize, flight_ns: f64) {
    let ns = |slope_rad: f64| 1e9 * slope_rad / (TAU * SPACING_HZ);
    let tones = noise(side);
    let _ = writeln!(text, "[robot.radio]\nphase_noise_rad = {:?}", brief(adjusted.phase_noise_rad));
    let mcs = usual(&other.rates).map_or(0, |rate| rate & 7);
    let chains = usual(&side.streams).map_or(3, |streams| streams / 10);
    let _ = writeln!(text, "mcs = {mcs}\nchains = {chains}");
    if side.filter.iter().all(|gain| *gain > 0.0) {
        let _ = writeln!(text, "filter_db = {:?}", side.filter.map(|gain| brief(20.0 * gain.log10())));
    }
    if tones > 1e-6 {
        let _ = writeln!(text, "noise.snr_db = {:?}", brief(-10.0 * tones.log10()));
    }
    let [_, b, c] = &side.level;
    let [rssi_a, rssi_b, rssi_c] = &side.rssi_db;
    let level_db = DB_PER_E * side.level[0].sd / side.level[0].mean.max(1.0);
    let level_db = brief(level_db);
    let _ = write!(
        text,
        "delay_ns = {:?}\ndelay_std_ns = {:?}\nantenna_order = \"by_rssi\"\ntx_power_dbm = {:?}\n\
         host_latency_us = {:?}\nhost_latency_std_us = {:?}\n\
         gain.agc = {{ target_lsb = {:?}, lsb_std_db = {level_db:?}, rssi_db = {:?}, agc_std_db = {:?} }}\n\
         stray_b = {{ lsb = {:?}, rssi_db = {:?}, rssi_std_db = {:?} }}\n\
         stray_c = {{ lsb = {:?}, rssi_db = {:?}, rssi_std_db = {:?} }}\n",
        brief(ns(-side.slope_rad.mean) - flight_ns),
        brief(ns(adjusted.slope_sd_rad[k])),
        brief(adjusted.tx_power_dbm[k]),
        brief(mean_latency_us(side, k)),
        brief(latency_us(side, k)),
        brief(side.level[0].median),
        brief(rssi_a.mean),
        brief(rssi_a.sd),
        brief(b.mean),
        brief(rssi_b.mean),
        brief(rssi_b.sd),
        brief(c.mean),
        brief(rssi_c.mean),
        brief(rssi_c.sd),
    );
}

/// Mean latency of the host less three deviations, microseconds. It cannot be seen in a log; it must be long enough for
/// an answer that is early to be early in the log too.
const LATENCY_US: f64 = 300.0;
/// Median turn-around, microseconds. It cannot be seen in two logs whose clocks have nothing to do with each other; it
/// must be long enough for the earliest answers to come after the frame they answer.
const TURN_AROUND_US: f64 = 450.0;
/// The bit of `rate_n_flags` for 40 MHz.
const RATE_40_MHZ: u16 = 0x800;

/// Four walls about both robots.
fn walls(text: &mut String, trajectory: &Trajectory, place: [f64; 3], loss_db: f64, margin_m: f64) {
    let mut low = [place[0], place[1]];
    let mut high = low;
    for pose in trajectory.poses() {
        for axis in 0..2 {
            low[axis] = low[axis].min(pose.position_m[axis]);
            high[axis] = high[axis].max(pose.position_m[axis]);
        }
    }
    let ([x0, y0], [x1, y1]) = (low.map(|v| brief(v - margin_m)), high.map(|v| brief(v + margin_m)));
    let loss_db = brief(loss_db);
    for (from, to) in [([x0, y0], [x1, y0]), ([x1, y0], [x1, y1]), ([x1, y1], [x0, y1]), ([x0, y1], [x0, y0])] {
        let _ = write!(text, "\n[[wall]]\nfrom_m = {from:?}\nto_m = {to:?}\nbottom_m = -1.0\nloss_db = {loss_db:?}\n");
    }
}

/// A channel's number in a scene: at 40 MHz that of the centre, two above or below the primary channel's.
#[must_use]
pub fn scene_channel(channel: Channel) -> u16 {
    let number = channel.number() as u16;
    match channel.width() {
        Width::Ht20 => number,
        Width::Ht40Plus => number + 2,
        Width::Ht40Minus => number.saturating_sub(2),
    }
}
