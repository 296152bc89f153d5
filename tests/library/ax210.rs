//! Two robots with AX210s under FeitCSI, from the room to the bearing: paired by the cards' clocks, turn-around by the FTM clock.

use csi5300::driver_iface::record::{LENGTH_FIELD, code, written};
use csi5300::maths::wrap_rad;
use csi5300::pipeline::{Bearing, Options, Transmitter, bearings};
use csi5300::source::other_card::Translated;
use csi5300::source::replay::Replay;
use csi5300_sim::{Room, Scene, SimulatedRobot, Simulation};
use std::io::Read;

/// A robot on a circle of 25 cm, another one `offset_ppm` faster, 20 dB of noise.
fn simulated((azimuth_deg, range_m): (f64, f64), preamble: &str, offset_ppm: f64, seed: u64) -> Simulation {
    let (sin, cos) = azimuth_deg.to_radians().sin_cos();
    let scene = format!(
        "duration_s = 15.0\nseed = {seed}\nchannel = 108\ncard = \"ax210\"\npreamble = \"{preamble}\"\ncfo = \"physical\"\n\
         sounding.rate_hz = 60\n\
         [radio]\nnoise.snr_db = 20\nsend_jitter_us = 60\ndelay_ns = 100\ndelay_std_ns = 20\nturn_around.spread_us = 8\n\
         [[robot]]\nname = \"rx\"\nmotion.circle = {{ radius_m = 0.25, duration_s = 15.0 }}\n\
         crystal.clock_start_us = 4294960000\n\
         [[robot]]\nname = \"tx\"\nposition_m = [{:.6}, {:.6}, 0.0]\ncrystal.offset_ppm = {offset_ppm:?}\n",
        range_m * cos,
        range_m * sin
    );
    Room::new(&Scene::parse(&scene).unwrap()).unwrap().run().unwrap()
}

/// Its log as one of a 5300, with the FTM clock or with whole microseconds alone.
fn log(robot: &SimulatedRobot, finely: bool) -> Vec<u8> {
    let mut all = Vec::new();
    Translated::new(&robot.log[..]).read_to_end(&mut all).unwrap();
    let kept = |record: &&[u8]| finely || record[LENGTH_FIELD] != code::CARD_CLOCK;
    written(&all).filter(kept).flatten().copied().collect()
}

fn bearing(run: &Simulation, finely: bool) -> Bearing {
    let [rx, tx] = [0, 1].map(|k| log(&run.robots[k], finely));
    let (mut rx, mut tx) = (Replay::new(&rx[..], "rx".into()), Replay::new(&tx[..], "tx".into()));
    let transmitters = vec![Transmitter { log: &mut tx, trajectory: None }];
    let path = run.robots[0].true_path.as_ref().unwrap();
    let mut report = bearings(&mut rx, transmitters, path, &Options::new("108".parse().unwrap())).unwrap();
    assert_eq!((report.receiver.survey.damages, report.receiver.survey.wsr_2021), (0, run.robots[0].records));
    report.links.pop().unwrap().bearing.unwrap()
}

/// How far the bearing is from the transmitter as seen from the middle of the samples, degrees.
fn off_deg(found: &Bearing, run: &Simulation) -> f64 {
    let way = run.robots[1].start_m().unwrap() - found.mean_position_m;
    wrap_rad(found.answer.azimuth_rad - way.y.atan2(way.x)).to_degrees()
}

#[test]
fn a_room_with_two_ax210s_gives_its_bearing() {
    for (k, preamble) in ["he", "ht", "vht"].into_iter().enumerate() {
        for azimuth_deg in [-100.0, 20.0, 140.0] {
            let run = simulated((azimuth_deg, 5.0 + 8.0 * k as f64), preamble, 4.0 - 3.0 * k as f64, 7 + k as u64);
            let found = bearing(&run, true);
            let off = off_deg(&found, &run);
            assert!(off.abs() < 0.2, "{preamble} {azimuth_deg}: {off} degrees off");
            assert!(found.pairs.formed as f64 >= 0.99 * run.robots[0].records as f64, "{:?}", found.pairs);
            assert!(off.abs() < 4.0 * found.answer.azimuth_sd_rad.to_degrees() + 0.02, "{off} {:?}", found.answer);
        }
    }
}

/// Crystals 18 ppm apart, 100 kHz: a microsecond of the turn-around is a tenth of a turn.
#[test]
fn the_ftm_clock_takes_the_turn_around_out_where_microseconds_leave_a_part() {
    let (mut errors, mut coherence) = ([0.0, 0.0], [0.0, 0.0]);
    let runs = 6;
    for seed in 0..runs {
        // So far away that the wave is plane.
        let run = simulated((20.0 + 70.0 * seed as f64, 500.0), "he", 18.0, seed);
        for (k, finely) in [true, false].into_iter().enumerate() {
            let found = bearing(&run, finely);
            errors[k] += off_deg(&found, &run).powi(2) / runs as f64;
            coherence[k] += found.plane_wave.coherence / runs as f64;
        }
    }
    // Phases that are left of `1 - coherence`, for small ones.
    let left_rad = coherence.map(|coherence| (2.0 * (1.0 - coherence)).sqrt());
    let errors_deg = errors.map(f64::sqrt);
    println!("FTM, 1 us: phase {left_rad:.3?} rad, bearing {errors_deg:.4?} degrees");
    assert!(left_rad[0] < 0.3 * left_rad[1] && errors_deg[0] < 0.7 * errors_deg[1], "{left_rad:?} {errors_deg:?}");
}
