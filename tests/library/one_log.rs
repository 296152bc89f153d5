//! Bearings from one log: antennas that turn with the robot, against the Cramer-Rao bound and a slow formula.

use crate::common::cases;
use csi5300::Log;
use csi5300::driver_iface::Mac;
use csi5300::driver_iface::bfee::{Antenna, Iq, Repr, Wsr};
use csi5300::driver_iface::record::{Record, code};
use csi5300::internal::ArrayFrame;
use csi5300::maths::wrap_rad;
use csi5300::motion::odometry::csv;
use csi5300::motion::pose::{Pose, Trajectory};
use csi5300::pipeline::{
    Accuracy, Answer, Array, ArrayError, Bearing, CaptureReport, JoinBy, LinkError, Options, one_log,
};
use csi5300::source::replay::Replay;
use nalgebra::Vector3;
use num_complex::{Complex32, Complex64};
use std::f64::consts::{PI, TAU};
use std::io::Cursor;

const START_S: f64 = 1_700_000_000.0;
const RECORDS: usize = 200;
const RATE_HZ: f64 = 100.0;
/// Deviation of the noise of each coefficient, as a share of the signal: 20 dB below it.
const NOISE: f64 = 0.1;
const NEAR: Mac = Mac([2, 0, 0, 0, 0, 7]);
const FAR: Mac = Mac([2, 0, 0, 0, 0, 8]);

fn options() -> Options {
    let flat = Accuracy { elevation_max_rad: Some(0.0), ..Accuracy::default() };
    Options { accuracy: flat, ..Options::new("108".parse().unwrap()) }
}

fn wavelength_m() -> f64 {
    options().channel.wavelength_m()
}

/// A robot that turns in place, away from the trajectory's origin.
struct Scene {
    turn_rad: f64,
    /// Antennas B and C, seen from A.
    others_m: [Vector3<f64>; 2],
    azimuth_rad: f64,
}

impl Scene {
    fn new(turn_deg: f64, baseline_m: Vector3<f64>, azimuth_rad: f64) -> Self {
        let across = Vector3::new(-baseline_m.y, baseline_m.x, 0.0);
        Self { turn_rad: turn_deg.to_radians(), others_m: [-baseline_m, -across], azimuth_rad }
    }

    fn heading_rad(&self, t_s: f64) -> f64 {
        0.4 + self.turn_rad * t_s / (RECORDS as f64 / RATE_HZ)
    }

    fn trajectory(&self) -> Trajectory {
        let pose = |k: usize| {
            let t_s = k as f64 / 500.0;
            let position_m = Vector3::new(3.0, -2.0, 0.2);
            Pose { t_s: START_S + t_s, position_m, heading_rad: Some(wrap_rad(self.heading_rad(t_s))) }
        };
        Trajectory::new((0..=RECORDS * 5).map(pose).collect()).unwrap()
    }

    /// The log of a card whose packets all begin with another phase and another sampling time, and whose chains are in
    /// another order every third time. `heard` is how strong the signal is at A, B and C.
    fn log(&self, seed: u64, sender: Mac, heard: [f64; 3]) -> Vec<u8> {
        let mut random = Random(seed.wrapping_mul(0x1234_5678_9abc_def1));
        let mut log = Vec::new();
        for k in 0..RECORDS {
            let t_s = k as f64 / RATE_HZ;
            let (sin, cos) = self.heading_rad(t_s).sin_cos();
            let towards = Vector3::new(self.azimuth_rad.cos(), self.azimuth_rad.sin(), 0.0);
            let phase = |offset_m: &Vector3<f64>| {
                let place = Vector3::new(cos * offset_m.x - sin * offset_m.y, sin * offset_m.x + cos * offset_m.y, 0.0);
                TAU / wavelength_m() * towards.dot(&place)
            };
            // Cables make a constant of each chain.
            let phases = [0.0, phase(&self.others_m[0]) + 0.9, phase(&self.others_m[1]) - 2.1];
            let (carrier, slope) = (TAU * random.next(), 0.6 * random.next() - 0.3);
            let order = if k % 3 == 0 { [1, 0, 2] } else { [0, 1, 2] };
            let mut iq = Vec::new();
            for subcarrier in 0..30 {
                for antenna in order {
                    let turn = carrier + slope * f64::from(subcarrier) + phases[antenna];
                    let h = heard[antenna] * Complex64::cis(turn) + NOISE * normal(&mut random);
                    let part = |value: f64| (90.0 * value).round().clamp(-128.0, 127.0) as i8;
                    iq.push(Iq { i: part(h.re), q: part(h.im) });
                }
            }
            let host_us = (t_s * 1e6).round() as u32;
            let (tv_sec, tv_usec) = (START_S as u32 + host_us / 1_000_000, host_us % 1_000_000);
            let wsr = Wsr { mac: sender, frame_count: Some(k as u32 + 1), tv_sec, tv_usec };
            let antenna_sel = (0..3).fold(0, |sel, chain| sel | (order[chain] as u8) << (2 * chain));
            let timestamp_low = host_us;
            let repr = Repr { timestamp_low, n_rx: 3, n_tx: 1, antenna_sel, wsr: Some(wsr), ..Repr::default() };
            let mut body = vec![0; repr.body_len()];
            repr.emit(&iq, &mut body).unwrap();
            let record = Record { code: code::BFEE, body: &body };
            let mut bytes = vec![0; record.emit_len()];
            record.emit(&mut bytes).unwrap();
            log.extend(bytes);
        }
        log
    }
}

/// SplitMix64.
struct Random(u64);

impl Random {
    /// Uniform, 0 to 1.
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// Complex noise of unit power.
fn normal(random: &mut Random) -> Complex64 {
    let radius = (-(1.0 - random.next()).ln()).sqrt();
    Complex64::from_polar(radius, TAU * random.next())
}

fn run(log: Vec<u8>, trajectory: &Trajectory, array: &Array) -> CaptureReport {
    one_log(&mut Replay::new(Cursor::new(log), String::new()), trajectory, array, &options()).unwrap()
}

fn only(log: Vec<u8>, trajectory: &Trajectory, array: &Array) -> Result<Bearing, LinkError> {
    run(log, trajectory, array).links.remove(0).bearing
}

fn pair(baseline_m: Vector3<f64>) -> Array {
    Array::new(&[Antenna::A, Antenna::B], &[baseline_m]).unwrap()
}

/// The bound of the azimuth where the constant of each baseline is open: places are about the middle of their own baseline's.
fn bound_rad(bearing: &Bearing, baselines: usize) -> f64 {
    // Thirty products of two coefficients each.
    let noise = (2.0 * NOISE.powi(2) + NOISE.powi(4)) / 30.0;
    let across = Vector3::new(-bearing.answer.azimuth_rad.sin(), bearing.answer.azimuth_rad.cos(), 0.0);
    let places: Vec<f64> = bearing.samples.receiver_m().iter().map(|place| place.dot(&across)).collect();
    let spread = |own: &[f64]| {
        let mean = own.iter().sum::<f64>() / own.len() as f64;
        own.iter().map(|v| (v - mean).powi(2)).sum::<f64>()
    };
    let sum: f64 = places.chunks(places.len() / baselines).map(spread).sum();
    1.0 / (2.0 / noise * (TAU / wavelength_m()).powi(2) * sum).sqrt()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

#[test]
fn two_antennas_that_turn_reach_the_bound() {
    let mut all = Vec::new();
    for (k, baseline_m) in [0.03, 0.1, 0.3].into_iter().enumerate() {
        for turn_deg in [90.0, 180.0, 360.0] {
            let shares: Vec<f64> = (0..24_u32)
                .map(|seed| {
                    let azimuth_rad = wrap_rad(0.7 + 2.4 * f64::from(seed));
                    let baseline_m = Vector3::new(0.6, 0.8, 0.0) * baseline_m;
                    let scene = Scene::new(turn_deg, baseline_m, azimuth_rad);
                    let log = scene.log(u64::from(seed) + 100 * k as u64, NEAR, [0.9; 3]);
                    let bearing = only(log, &scene.trajectory(), &pair(baseline_m)).unwrap();
                    assert_eq!(bearing.pairs.formed, RECORDS);
                    // The signal is at 0.9 of what the noise is told of.
                    wrap_rad(bearing.answer.azimuth_rad - azimuth_rad) / (bound_rad(&bearing, 1) / 0.9)
                })
                .collect();
            println!("{baseline_m} m, {turn_deg} degrees: {:.3} of the bound", rms(&shares));
            all.extend(shares);
        }
    }
    assert!(rms(&all) < 1.1, "{}", rms(&all));
}

#[test]
fn three_antennas_together_reach_the_bound_of_both_baselines() {
    let (mut shares, mut alone) = (Vec::new(), Vec::new());
    let baseline_m = Vector3::new(0.08, 0.0, 0.0);
    let across_m = Vector3::new(0.0, 0.08, 0.0);
    let array = Array::new(&[Antenna::A, Antenna::B, Antenna::C], &[baseline_m, across_m]).unwrap();
    for seed in 0..80_u32 {
        let azimuth_rad = wrap_rad(2.4 * f64::from(seed));
        let scene = Scene::new(90.0, baseline_m, azimuth_rad);
        let log = scene.log(seed.into(), NEAR, [0.9; 3]);
        let both = only(log.clone(), &scene.trajectory(), &array).unwrap();
        let one = only(log, &scene.trajectory(), &pair(baseline_m)).unwrap();
        assert_eq!((both.samples.len(), one.samples.len()), (2 * RECORDS, RECORDS));
        let error = |bearing: &Bearing| wrap_rad(bearing.answer.azimuth_rad - azimuth_rad);
        shares.push(error(&both) / (bound_rad(&both, 2) / 0.9));
        alone.push(error(&one) / (bound_rad(&both, 2) / 0.9));
    }
    println!("joint {:.3}, one baseline {:.3} of the joint bound", rms(&shares), rms(&alone));
    // Both products hold the noise of antenna A: they are not independent, which the bound takes them to be. Of two products
    // with half of their noise in common the mean is worse than of independent ones by sqrt(1.5) at most.
    assert!(rms(&shares) < 1.1 * 1.5_f64.sqrt() && rms(&shares) < rms(&alone), "{} {}", rms(&shares), rms(&alone));
}

#[test]
fn every_sender_is_a_link_and_the_answer_says_what_it_is_of() {
    let baseline_m = Vector3::new(0.05, 0.0, 0.0);
    let scene = Scene::new(300.0, baseline_m, 1.2);
    let other = Scene::new(300.0, baseline_m, -2.0);
    let mut log = scene.log(1, NEAR, [0.9; 3]);
    log.extend(other.log(2, FAR, [0.9; 3]));
    let report = run(log, &scene.trajectory(), &pair(baseline_m));
    assert_eq!(report.links.len(), 2);
    for link in &report.links {
        let truth_rad = if link.mac == Some(NEAR) { 1.2 } else { -2.0 };
        let answer = Answer::new("link".into(), link);
        assert!(wrap_rad(answer.azimuth_deg.unwrap().to_radians() - truth_rad).abs() < 0.01, "{answer:?}");
        assert_eq!((answer.pairs, answer.range_m, answer.compensated), (RECORDS, None, false));
        // One wave leaves nothing but noise: there is a probability, and of the sharpest kind.
        assert!(answer.confidence.unwrap() > 0.99 && answer.azimuth_sd_deg.unwrap() < 1.0);
        let body_deg = answer.azimuth_body_deg.unwrap();
        let heading_rad = scene.heading_rad((RECORDS - 1) as f64 / RATE_HZ);
        assert!(wrap_rad(body_deg.to_radians() + heading_rad - truth_rad).abs() < 0.01);
    }
}

#[test]
fn what_shows_no_bearing_is_refused_with_why() {
    let baseline_m = Vector3::new(0.05, 0.0, 0.0);
    let scene = Scene::new(270.0, baseline_m, 1.2);
    let log = || scene.log(1, NEAR, [0.9; 3]);
    let array = pair(baseline_m);
    // Antenna B hears nothing but noise.
    let unsteady = only(scene.log(1, NEAR, [0.9, 0.0, 0.9]), &scene.trajectory(), &array);
    assert!(matches!(unsteady, Err(LinkError::Unsteady { .. })), "{unsteady:?}");
    let change = |of: &dyn Fn(Pose) -> Pose| {
        Trajectory::new(scene.trajectory().poses().iter().map(|pose| of(*pose)).collect()).unwrap()
    };
    let still = only(log(), &change(&|pose| Pose { heading_rad: Some(0.3), ..pose }), &array);
    assert_eq!(still.unwrap_err(), LinkError::NotTurned { records: RECORDS });
    let blind = only(log(), &change(&|pose| Pose { heading_rad: None, ..pose }), &array);
    assert_eq!(blind.unwrap_err(), LinkError::NoAttitude);
    let late = only(log(), &change(&|pose| Pose { t_s: pose.t_s + 1e3, ..pose }), &array);
    assert!(matches!(late, Err(LinkError::OutsideTrajectory { pairs: RECORDS, .. })), "{late:?}");
    let named = [Antenna::A, Antenna::B, Antenna::C, Antenna::A];
    for count in 1..=4 {
        let made = Array::new(&named[..count], &vec![baseline_m; count - 1]);
        assert_eq!(made.is_ok(), (2..=3).contains(&count), "{count}: {made:?}");
    }
    let short = Array::new(&named[..3], &[baseline_m]);
    assert_eq!(short.unwrap_err(), ArrayError::Baselines { antennas: 3, baselines: 1 });
    let twice = Array::new(&[Antenna::B, Antenna::B], &[baseline_m]);
    assert_eq!(twice.unwrap_err(), ArrayError::Twice { antenna: Antenna::B });
    for metres in [0.0, 2.0, f64::NAN] {
        let made = Array::new(&[Antenna::A, Antenna::B], &[Vector3::new(metres, 0.0, 0.0)]);
        assert!(matches!(made, Err(ArrayError::Length { .. })), "{metres}");
    }
}

#[test]
fn frames_that_an_antenna_missed_keep_their_rows() {
    let baseline_m = Vector3::new(0.05, 0.0, 0.0);
    let scene = Scene::new(270.0, baseline_m, 1.2);
    let mut log = scene.log(1, NEAR, [0.9; 3]);
    let record = log.len() / RECORDS;
    // Coefficients, which end each record, are all zero in the first of them.
    let silent = 60;
    log.chunks_mut(record).take(silent).for_each(|record| record[41..].fill(0));
    let every_frame = scene.trajectory().poses().iter().step_by(5).copied().collect();
    let mut options = options();
    options.join = JoinBy::Row;
    let mut source = Replay::new(Cursor::new(log), String::new());
    let report = one_log(&mut source, &Trajectory::new(every_frame).unwrap(), &pair(baseline_m), &options).unwrap();
    let bearing = report.links[0].bearing.as_ref().unwrap();
    assert_eq!((bearing.pairs.formed, report.receiver.unused.no_antenna), (RECORDS - silent, silent as u64));
    assert!(wrap_rad(bearing.answer.azimuth_rad - 1.2).abs() < 0.01, "{}", bearing.answer.azimuth_rad);
}

/// What `log` adds to the product of A and B, and of A and C, radians.
const CONSTANTS_RAD: [f64; 2] = [-0.9, 2.1];

#[test]
fn a_turn_gives_the_constants_of_the_chains() {
    let (baseline_m, across_m) = (Vector3::new(0.05, 0.0, 0.0), Vector3::new(0.0, 0.05, 0.0));
    let both = Array::new(&[Antenna::A, Antenna::B, Antenna::C], &[baseline_m, across_m]).unwrap();
    for turn_deg in [120.0, 360.0] {
        let mut shares = Vec::new();
        for seed in 0..100_u32 {
            let scene = Scene::new(turn_deg, baseline_m, wrap_rad(2.4 * f64::from(seed)));
            let bearing = only(scene.log(seed.into(), NEAR, [0.9; 3]), &scene.trajectory(), &both).unwrap();
            assert_eq!(bearing.chain_constants.len(), 2);
            for (found, truth_rad) in bearing.chain_constants.iter().zip(CONSTANTS_RAD) {
                assert!(found.sd_rad < 0.03, "{found:?}");
                shares.push(wrap_rad(found.rad - truth_rad) / found.sd_rad);
            }
        }
        println!("{turn_deg} degrees: {:.2} deviations", rms(&shares));
        assert!((0.8..1.2).contains(&rms(&shares)), "{turn_deg}: {}", rms(&shares));
    }
}

/// The constant of a turn, then a robot that stands: the angle to the baseline, so one of two sides, and both of them with a third
/// antenna.
#[test]
fn with_the_constant_of_a_turn_a_robot_that_stands_has_a_bearing() {
    let (baseline_m, across_m) = (Vector3::new(0.025, 0.0, 0.0), Vector3::new(0.0, 0.025, 0.0));
    let two = pair(baseline_m);
    let three = Array::new(&[Antenna::A, Antenna::B, Antenna::C], &[baseline_m, across_m]).unwrap();
    let turned = Scene::new(360.0, baseline_m, 0.3);
    let constants =
        |array: &Array| only(turned.log(99, NEAR, [0.9; 3]), &turned.trajectory(), array).unwrap().chain_constants;
    let [of_two, of_three] = [&two, &three].map(constants);
    let (two, three) = (two.with_constants(&of_two).unwrap(), three.with_constants(&of_three).unwrap());
    for seed in 0..12_u32 {
        // The baseline points to 0.4 radians; directions along it are left out, where two antennas tell least.
        let from_baseline = 0.5 + 2.1 * f64::from(seed) / 11.0;
        let azimuth_rad = wrap_rad(if seed % 2 == 0 { 0.4 + from_baseline } else { 0.4 - from_baseline });
        let mirror_rad = wrap_rad(0.8 - azimuth_rad);
        let still = Scene::new(0.0, baseline_m, azimuth_rad);
        let log = still.log(seed.into(), NEAR, [0.9; 3]);
        let found = only(log.clone(), &still.trajectory(), &two).unwrap().answer;
        let off = |a: f64, b: f64| wrap_rad(a - b).abs();
        let (first, second) = (found.azimuth_rad, found.mirror_rad.unwrap());
        let way = off(first, azimuth_rad).max(off(second, mirror_rad));
        let other_way = off(first, mirror_rad).max(off(second, azimuth_rad));
        assert!(way.min(other_way) < 0.03, "{azimuth_rad} and {mirror_rad}: {first} and {second}");
        assert!((0.001..0.05).contains(&found.azimuth_sd_rad), "{}", found.azimuth_sd_rad);
        let whole = only(log, &still.trajectory(), &three).unwrap().answer;
        assert!(off(whole.azimuth_rad, azimuth_rad) < 0.03 && whole.mirror_rad.is_none(), "{azimuth_rad}: {whole:?}");
    }
    // Noise that happens to have a constant is none.
    let still = Scene::new(0.0, baseline_m, 1.0);
    let unsteady = only(still.log(1, NEAR, [0.9, 0.0, 0.9]), &still.trajectory(), &two);
    assert!(matches!(unsteady, Err(LinkError::Unsteady { records: RECORDS, .. })), "{unsteady:?}");
    let wrong = pair(baseline_m).with_constants(&of_three);
    assert_eq!(wrong.unwrap_err(), ArrayError::Constants { constants: 2, baselines: 1 });
}

#[test]
fn a_constant_that_the_turn_contradicts_is_refused() {
    let baseline_m = Vector3::new(0.05, 0.0, 0.0);
    let scene = Scene::new(200.0, baseline_m, 1.2);
    let turned = || scene.log(5, NEAR, [0.9; 3]);
    let [right] = only(turned(), &scene.trajectory(), &pair(baseline_m)).unwrap().chain_constants[..] else { panic!() };
    let with = |by_rad: f64| {
        let constant = csi5300::pipeline::ChainConstant { rad: right.rad + by_rad, ..right };
        pair(baseline_m).with_constants(&[constant]).unwrap()
    };
    let found = only(turned(), &scene.trajectory(), &with(0.0)).unwrap();
    assert!(wrap_rad(found.answer.azimuth_rad - 1.2).abs() < 0.01, "{}", found.answer.azimuth_rad);
    // As the firmware of a 5300 makes it when it is loaded anew, and as that of another card.
    for by_rad in [PI, 1.0] {
        let wrong = only(turned(), &scene.trajectory(), &with(by_rad)).unwrap_err();
        let LinkError::WrongConstant { given_deg, turn_deg, .. } = wrong else { panic!("{wrong}") };
        assert!(wrap_rad((given_deg - turn_deg).to_radians() - by_rad).abs() < 0.05, "{wrong}");
    }
    // Nothing contradicts it where the robot stands.
    let still = Scene::new(0.0, baseline_m, 1.2);
    assert!(only(still.log(5, NEAR, [0.9; 3]), &still.trajectory(), &with(PI)).is_ok());
}

/// The formula of the WSR toolbox, slowly: `|sum h_A conj(h_B) exp(-j 2 pi / lambda u . R b)|` over all azimuths, as a share of
/// `sum |h_A conj(h_B)|` where every product has unit size.
fn slowly(log: &std::path::Path, trajectory: &Trajectory, used_s: &[f64], baseline_m: f64) -> (f64, f64) {
    let mut samples = Vec::new();
    for frame in Log::open(log).unwrap() {
        let frame = frame.unwrap();
        let t_s = frame.host_us.unwrap() as f64 * 1e-6;
        let rows = frame.csi.row(Antenna::A).zip(frame.csi.row(Antenna::B));
        let (Some((a, b)), Ok(_)) = (rows, used_s.binary_search_by(|used| used.total_cmp(&t_s))) else { continue };
        let h = |row: usize, k: usize| (0..frame.csi.n_tx()).map(move |tx| (k, row, tx));
        let product = |k: usize| -> num_complex::Complex32 {
            let of = |(k, row, tx)| frame.csi.get(k, row, tx).unwrap();
            h(a, k).zip(h(b, k)).map(|(a, b)| of(a) * of(b).conj()).sum()
        };
        let sum: num_complex::Complex32 = (0..30).map(product).sum();
        let z = Complex64::new(sum.re.into(), sum.im.into());
        samples.push((trajectory.at(t_s).unwrap().heading_rad.unwrap(), z / z.norm()));
    }
    let share = |azimuth_rad: f64| {
        let turn = |(heading_rad, z): &(f64, Complex64)| {
            z * Complex64::cis(-TAU * baseline_m / wavelength_m() * (azimuth_rad - heading_rad).cos())
        };
        samples.iter().map(turn).sum::<Complex64>().norm() / samples.len() as f64
    };
    let all = (0..7_200).map(|k| -PI + TAU * f64::from(k) / 7_200.0).map(|azimuth| (share(azimuth), azimuth));
    all.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap()
}

#[test]
fn the_real_log_of_two_antennas_has_the_toolboxs_answer() {
    let Some(folder) = cases("two-antennas") else { return };
    let log = folder.join("csi_rx_2022-08-31_103703.dat");
    let odometry = folder.join("odom_rx_trajectory_2022-08-31_103703.csv");
    let (trajectory, _) = csv::read(&odometry, None).unwrap();
    let array = pair(Vector3::new(0.28, 0.0, 0.0));
    let mut replay = Replay::open(&log).unwrap();
    let report = one_log(&mut replay, &trajectory, &array, &options()).unwrap();
    let bearing = report.links.into_iter().next().unwrap().bearing.unwrap();
    let (share, azimuth_rad) = slowly(&log, &trajectory, bearing.samples.t_s(), 0.28);
    let found = &bearing.plane_wave;
    println!(
        "{} records: share {:.3} at {:.2} degrees, slowly {share:.3} at {:.2}; answer {:.2} +- {:.2}",
        bearing.samples.len(),
        found.coherence,
        found.azimuth_rad.to_degrees(),
        azimuth_rad.to_degrees(),
        bearing.answer.azimuth_rad.to_degrees(),
        bearing.answer.azimuth_sd_rad.to_degrees()
    );
    assert!((found.coherence - share).abs() < 2e-3, "{} {share}", found.coherence);
    assert!(wrap_rad(found.azimuth_rad - azimuth_rad).abs() < 0.1_f64.to_radians());
    assert!(bearing.samples.len() > 800, "{}", bearing.samples.len());
}

#[test]
fn antennas_with_different_subcarriers_make_no_frame() {
    let array = Array::new(&[Antenna::A, Antenna::B], &[Vector3::new(0.1, 0.0, 0.0)]).unwrap();
    let heard = |of_b: usize| {
        let csi = |antenna, _| Some(vec![Complex32::ONE; if antenna == Antenna::A { 30 } else { of_b }]);
        ArrayFrame::new(&array, Mac::ZERO, None, 1, csi).is_some()
    };
    assert_eq!([30, 1, 31].map(heard), [true, false, false]);
}

/// While a robot drives past a sender, its direction changes: odometry and two or three antennas give the place. Without `near_field`
/// the estimate assumes one direction for the whole drive.
#[test]
fn a_robot_that_drives_finds_the_place_of_a_sender() {
    use csi5300_sim::motion::{RandomWalk, RobotMotion};
    use csi5300_sim::radio::{Noise, Radio};
    use csi5300_sim::scene::{Robot, Scene, Sounding};
    let (antennas_m, sender_m) = ([[0.1, 0.0, 0.0], [0.0; 3], [0.05, 0.08, 0.0]], [1.5, 2.2, 0.0]);
    let walk = RandomWalk { speed_m_s: 0.2, turning_deg_s: 40.0, within_m: 1.5, duration_s: 20.0, start_s: 0.0 };
    let [a, b, c] = antennas_m;
    let rx = Robot {
        name: "rx".into(),
        antenna_m: a,
        antenna_b_m: Some(b),
        antenna_c_m: Some(c),
        motion: RobotMotion::RandomWalk(walk),
        ..Robot::default()
    };
    let seen = |seed: u64, count: usize, near_field: bool| {
        let scene = Scene {
            seed,
            duration_s: 20.0,
            sounding: Some(Sounding { rate_hz: 50.0, ..Sounding::default() }),
            radio: Radio {
                noise: Noise::SnrDb(15.0),
                chain_deg: [70.0, -110.0],
                host_latency_us: 0.0,
                ..Radio::default()
            },
            robot: vec![rx.clone(), Robot { name: "tx".into(), position_m: sender_m, ..Robot::default() }],
            ..Scene::default()
        };
        let room = csi5300_sim::Room::new(&scene).unwrap();
        let path = room.true_path(0, 50.0).unwrap();
        let others = [b, c].map(|other| Vector3::from(a) - Vector3::from(other));
        let letters = [Antenna::A, Antenna::B, Antenna::C];
        let array = Array::new(&letters[..count], &others[..count - 1]).unwrap().on_trajectory();
        let accuracy = Accuracy { near_field, ..Accuracy::default() };
        let options = Options { accuracy, ..options() };
        let simulated = room.run().unwrap();
        let mut log = simulated.robots[0].replay();
        one_log(&mut log, &path, &array, &options).unwrap().links.remove(0).bearing.unwrap()
    };
    for count in [2, 3] {
        let (mut levels, mut plane_off) = (Vec::new(), Vec::new());
        for seed in 0..10 {
            let bearing = seen(seed, count, true);
            let range = bearing.answer.range.filter(|_| bearing.answer.has_place()).unwrap();
            let off = (range.position_m - Vector3::from(sender_m)).xy();
            let covariance = range.covariance_m2.fixed_view::<2, 2>(0, 0).into_owned();
            levels.push(off.dot(&(covariance.try_inverse().unwrap() * off)));
            assert!(off.norm() < 0.3 && range.sd_m < 0.5, "{count} {seed}: {off} {range:?}");
            // The azimuth is seen from the middle of the drive.
            let way = Vector3::from(sender_m) - bearing.mean_position_m;
            assert!(wrap_rad(bearing.answer.azimuth_rad - way.y.atan2(way.x)).abs() < 0.05, "{count} {seed}");
            let plane = seen(seed, count, false);
            assert!(plane.answer.range.is_none());
            plane_off.push(wrap_rad(plane.answer.azimuth_rad - way.y.atan2(way.x)) / plane.answer.azimuth_sd_rad);
        }
        // -2 ln(1 - share) of 95 %.
        let outside = levels.iter().filter(|level| **level > 5.99).count();
        assert!(outside <= 1, "{count}: {levels:?}");
        assert!(rms(&plane_off) > 1.5, "{count}: {plane_off:?}");
    }
}
