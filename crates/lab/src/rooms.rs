//! Random rooms with known truth: what bearings are judged by where no capture is at hand.
//!
//! Each room has four walls, a receiver that drives an arc of about a metre, and three transmitters two to five metres
//! away and up to 0.8 m higher; cards, clocks and radios are those of the built-in `lab-circle`. In half of the
//! rooms a wall stands before every transmitter, which takes 8 to 30 dB off the straight path. Odometry (not the true
//! trajectory) has a scale and a drifting heading.

use csi5300::source::Error;
use csi5300_sim::{Room, Scene, write_dataset};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::fmt::Write;
use std::path::Path;

/// Folder of rooms in which nothing stands between receiver and transmitters.
pub const IN_SIGHT: &str = "rooms_LOS";
/// Folder of rooms with walls between them.
pub const BEHIND_WALLS: &str = "rooms_NLOS";

/// Writes `count` rooms of either kind as captures below `folder`; `seed` chooses them.
///
/// # Errors
/// If a file cannot be written, or a room cannot be built.
pub fn write(folder: &Path, count: u64, seed: u64) -> Result<(), Error> {
    let jobs: Vec<(u64, bool)> = (0..count).flat_map(|number| [(number, true), (number, false)]).collect();
    jobs.into_par_iter().try_for_each(|(number, in_sight)| {
        let text = toml(seed.wrapping_add(2 * number + u64::from(in_sight)), in_sight);
        let scene = Scene::from_toml(&text).map_err(|error| Error::Input(format!("room {number}: {error}")))?;
        let mut room = Room::new(&scene).map_err(|error| Error::Input(format!("room {number}: {error}")))?;
        let set = if in_sight { IN_SIGHT } else { BEHIND_WALLS };
        write_dataset(&mut room, &folder.join(set).join(format!("{number:03}")), &mut |_| {}).map(|_| ())
    })
}

/// The scene of a room.
fn toml(seed: u64, in_sight: bool) -> String {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut between = |low: f64, high: f64| random.random_range(low..high);
    let angle_deg = between(150.0, 300.0);
    let radius_m = 1.0 / angle_deg.to_radians() * between(0.9, 1.6);
    let (scale, drift_deg_s) = (between(0.96, 1.03), between(-0.8, 0.8));
    let mut text = format!(
        "name = \"room\"\nseed = {seed}\nduration_s = 13.0\nchannel = 108\ncfo = \"physical\"\nreflections = 1\n\
         [sounding]\nrate_hz = 100.0\n{RADIO}\n\
         [[robot]]\nname = \"rx\"\nposition_m = [0.0, 0.0, 0.3]\nyaw_deg = {:.1}\n\
         motion.arc = {{ radius_m = {radius_m:.3}, angle_deg = {angle_deg:.1}, duration_s = 7.0, start_s = 5.0 }}\n\
         odometry = {{ rate_hz = 200.0, noise_m = 0.0003, scale = {scale:.4}, heading_drift_deg_s = {drift_deg_s:.3} }}\n\
         crystal = {{ offset_ppm = {:.2}, clock_start_us = 3420000000 }}\n",
        between(-180.0, 180.0),
        between(-1.5, 1.5),
    );
    let turned_deg = between(-180.0, 180.0);
    for number in 0..3 {
        let (azimuth, range_m) = (turned_deg + 120.0 * f64::from(number) + between(-45.0, 45.0), between(2.2, 5.0));
        let (sin, cos) = azimuth.to_radians().sin_cos();
        let _ = writeln!(
            text,
            "[[robot]]\nname = \"tx{number}\"\nposition_m = [{:.3}, {:.3}, {:.3}]\n\
             crystal = {{ offset_ppm = {:.2}, wander_ppm = 0.02, wander_period_s = 40.0, clock_start_us = 1200000000 }}",
            range_m * cos,
            range_m * sin,
            between(0.3, 1.1),
            between(-2.5, 2.5),
        );
        if !in_sight {
            // A wall across the straight way, close to the transmitter.
            let (at_m, half_m, through_db) = (range_m - between(0.4, 0.8), between(0.6, 1.4), between(8.0, 30.0));
            let end = |side: f64| (at_m * cos - side * half_m * sin, at_m * sin + side * half_m * cos);
            let ((x0, y0), (x1, y1)) = (end(1.0), end(-1.0));
            let _ = writeln!(
                text,
                "[[wall]]\nfrom_m = [{x0:.3}, {y0:.3}]\nto_m = [{x1:.3}, {y1:.3}]\nloss_db = 8.0\nthrough_db = {through_db:.1}"
            );
        }
    }
    let loss_db = if in_sight { between(10.0, 16.0) } else { between(2.0, 8.0) };
    let (west, east, south, north) = (-between(6.0, 8.0), between(6.0, 8.0), -between(6.0, 8.0), between(6.0, 8.0));
    for (x0, y0, x1, y1) in
        [(west, south, east, south), (east, south, east, north), (east, north, west, north), (west, north, west, south)]
    {
        let _ =
            writeln!(text, "[[wall]]\nfrom_m = [{x0:.2}, {y0:.2}]\nto_m = [{x1:.2}, {y1:.2}]\nloss_db = {loss_db:.1}");
    }
    text
}

/// The radio of `lab-circle`, which is fitted to real cards.
const RADIO: &str = "[radio]
mcs = 0
noise.floor_dbm = -88.0
phase_noise_rad = 0.16
delay_ns = 200.0
delay_std_ns = 30.0
send_jitter_us = 85.0
host_latency_us = 120.0
host_latency_std_us = 55.0
gain.agc = { target_lsb = 31.3, lsb_std_db = 0.41, rssi_db = 38.4, agc_std_db = 0.7 }
turn_around = { median_us = 322.0, spread_us = 4.5, tail = 0.08, tail_us = -110.0, tail_spread_us = 45.0, min_us = 80.0, max_us = 400.0 }
";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_room_can_be_built_and_differs_from_the_others() {
        for seed in 0..40 {
            for in_sight in [true, false] {
                let text = toml(seed, in_sight);
                let scene = Scene::from_toml(&text).unwrap_or_else(|error| panic!("{error}\n{text}"));
                assert_eq!(scene.robot.len(), 4);
                assert_eq!(scene.wall.len(), if in_sight { 4 } else { 7 });
            }
            assert_ne!(toml(seed, true), toml(seed + 1, true));
        }
    }
}
