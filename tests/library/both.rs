//! Combines two logs and two antennas of one robot in one bearing, in simulated rooms.

use csi5300::driver_iface::bfee::Antenna;
use csi5300::maths::wrap_rad;
use csi5300::pipeline::{Array, Bearing, Options, Transmitter, bearings, one_log};
use csi5300::source::replay::Replay;
use csi5300_sim::{Room, Scene, Simulation};
use nalgebra::Vector3;

/// Simulates a room with one path; `motion` is that of the first robot.
fn simulated(motion: &str, antenna_b: &str, azimuth_deg: f64, seed: u64) -> Simulation {
    let (sin, cos) = azimuth_deg.to_radians().sin_cos();
    let scene = format!(
        "duration_s = 11.0\nseed = {seed}\nchannel = 108\ncfo = \"physical\"\nsounding.rate_hz = 40\nreflections = 1\n\
         [radio]\nnoise.snr_db = 20\nchain_deg = [-50.0, 0.0]\nsend_jitter_us = 60\nturn_around.spread_us = 8\n\
         [[robot]]\nname = \"rx\"\nantenna_b_m = {antenna_b}\nmotion = {motion}\n\
         [[robot]]\nname = \"tx\"\nposition_m = [{:.6}, {:.6}, 0.0]\ncrystal.offset_ppm = 3.0\n",
        8.0 * cos,
        8.0 * sin
    );
    Room::new(&Scene::parse(&scene).unwrap()).unwrap().run().unwrap()
}

/// Bearings from two logs, from one, and from both combined.
fn three(run: &Simulation, array: &Array) -> [Bearing; 3] {
    let options = Options::new("108".parse().unwrap());
    let [rx, tx] = [0, 1].map(|k| &run.robots[k].log[..]);
    let path = run.robots[0].true_path.as_ref().unwrap();
    let (mut receiver, mut transmitter) = (Replay::new(rx, "rx".into()), Replay::new(tx, "tx".into()));
    let transmitters = vec![Transmitter { log: &mut transmitter, trajectory: None }];
    let two = bearings(&mut receiver, transmitters, path, &options).unwrap().links.remove(0).bearing.unwrap();
    let one = one_log(&mut Replay::new(rx, "rx".into()), path, array, &options).unwrap();
    let one = one.links.into_iter().next().unwrap().bearing.unwrap();
    let both = two.with_one_log(&one);
    [two, one, both]
}

fn off_deg(found: &Bearing, run: &Simulation) -> f64 {
    let way = run.robots[1].start_m().unwrap() - found.mean_position_m;
    wrap_rad(found.answer.azimuth_rad - way.y.atan2(way.x)).to_degrees()
}

fn rms(errors: &[[f64; 3]], kind: usize) -> f64 {
    (errors.iter().map(|own| own[kind].powi(2)).sum::<f64>() / errors.len() as f64).sqrt()
}

#[test]
fn with_one_path_the_combined_bearing_is_no_worse_than_either() {
    let array = Array::new(&[Antenna::A, Antenna::B], &[Vector3::new(0.1, 0.0, 0.0)]).unwrap();
    let circle = "{ circle = { radius_m = 0.05, duration_s = 10.0, start_s = 0.5 } }";
    let errors: Vec<[f64; 3]> = (0..10_u32)
        .map(|seed| {
            let azimuth_deg = 36.0 * f64::from(seed) - 170.0;
            let run = simulated(circle, "[-0.1, 0.0, 0.0]", azimuth_deg, seed.into());
            let found = three(&run, &array);
            let off = [0, 1, 2].map(|k| off_deg(&found[k], &run));
            let sd_deg = [0, 1, 2].map(|k| found[k].answer.azimuth_sd_rad.to_degrees());
            println!("{azimuth_deg}: {off:.2?} +- {sd_deg:.2?}");
            assert!(sd_deg[2] < 1.05 * sd_deg[0].min(sd_deg[1]) + 0.02, "{sd_deg:?}");
            off
        })
        .collect();
    let [two, one, both] = [0, 1, 2].map(|kind| rms(&errors, kind));
    println!("two logs {two:.3}, one log {one:.3}, both {both:.3} degrees");
    assert!(both < 1.1 * two.min(one) + 0.02, "{two} {one} {both}");
}

/// Half a metre straight ahead, then a full turn on the spot.
fn straight_then_around() -> std::path::PathBuf {
    let rows = (0..=550).map(|k| {
        let t_s = f64::from(k) * 0.02;
        let (x, yaw) = (0.5 * (t_s / 6.0).min(1.0), std::f64::consts::TAU * ((t_s - 6.0) / 5.0).max(0.0));
        format!("{t_s:.2},{x:.6},0.0,{yaw:.6}\n")
    });
    let file = std::env::temp_dir().join(format!("csi5300-both-{}.csv", std::process::id()));
    std::fs::write(&file, "t,x,y,yaw\n".to_owned() + &rows.collect::<String>()).unwrap();
    file
}

#[test]
fn turning_antennas_remove_the_mirror_of_a_straight_drive() {
    let path = straight_then_around();
    let motion = format!("{{ recorded = {{ file = '{}' }} }}", path.display());
    let array = Array::new(&[Antenna::A, Antenna::B], &[Vector3::new(0.05, 0.0, 0.0)]).unwrap();
    for (seed, azimuth_deg) in [(1, 40.0), (2, -65.0), (3, 120.0), (4, -140.0)] {
        let run = simulated(&motion, "[-0.05, 0.0, 0.0]", azimuth_deg, seed);
        let [two, one, both] = three(&run, &array);
        let shares = [&two, &one, &both].map(|of| of.answer.mirror_share);
        let off = [&two, &one, &both].map(|of| off_deg(of, &run));
        println!(
            "{azimuth_deg}: {off:.2?}, mirror {shares:?} {:?}",
            [&two, &one, &both].map(|of| of.answer.azimuth_sd_rad.to_degrees())
        );
        assert!(shares[0].is_some_and(|share| share > 0.3), "{shares:?}");
        assert!(shares[2].is_none_or(|share| share < 0.01), "{azimuth_deg}: {shares:?}");
        assert!(off[2].abs() < 3.0 * both.answer.azimuth_sd_rad.to_degrees(), "{azimuth_deg}: {off:?}");
    }
    std::fs::remove_file(path).unwrap();
}
