//! Two antennas in rooms with reflections: the product of their channels beside that at the first strong delay.

use csi_formats::{Item, items};
use csi5300::driver_iface::Mac;
use csi5300::driver_iface::bfee::Antenna;
use csi5300::maths::wrap_rad;
use csi5300::num_complex::Complex32;
use csi5300::pipeline::{Array, ArrayFrame, OneLog, Options};
use csi5300_sim::{Room, Scene, Simulation};
use nalgebra::Vector3;

const BASELINE_M: f64 = 0.05;
/// SplitMix64, from `low` to `high`.
fn random(state: &mut u64, low: f64, high: f64) -> f64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (*state ^ (*state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    low + (high - low) * ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}

/// A room of four walls, in which a robot with two antennas turns in place before another one.
fn room(seed: u64, bandwidth_mhz: u16) -> Simulation {
    let mut state = seed;
    let mut between = |low, high| random(&mut state, low, high);
    let (x, y) = (between(5.0, 9.0), between(4.0, 7.0));
    let ([from_x, from_y], azimuth, range) =
        ([between(-0.8, 0.8), between(-0.8, 0.8)], between(-3.1, 3.1), between(0.5, 0.9));
    let (to_x, to_y) =
        (from_x + range * (0.5 * x - 1.0) * azimuth.cos(), from_y + range * (0.5 * y - 1.0) * azimuth.sin());
    let walls = [[[-x, -y], [x, -y]], [[x, -y], [x, y]], [[x, y], [-x, y]], [[-x, y], [-x, -y]]];
    let walls: String = walls
        .iter()
        .map(|[a, b]| {
            let half = |p: &[f64; 2]| format!("[{:.3}, {:.3}]", 0.5 * p[0], 0.5 * p[1]);
            format!("[[wall]]\nfrom_m = {}\nto_m = {}\nloss_db = {:.1}\n", half(a), half(b), between(4.0, 10.0))
        })
        .collect();
    let scene = format!(
        "duration_s = 4.0\nseed = {seed}\nreflections = 2\ncard = \"ax210\"\nbandwidth_mhz = {bandwidth_mhz}\nchannel = 108\n\
         sounding.rate_hz = 20\n[radio]\nnoise.snr_db = 20\ndelay_ns = 100\ndelay_std_ns = 10\nchain_deg = [70.0, 0.0]\n\
         [[robot]]\nname = \"rx\"\nposition_m = [{from_x:.3}, {from_y:.3}, 0.4]\nantenna_b_m = [{BASELINE_M}, 0.0, 0.0]\n\
         motion.circle = {{ radius_m = 0.0, duration_s = 4.0 }}\n\
         [[robot]]\nname = \"tx\"\nposition_m = [{to_x:.3}, {to_y:.3}, 0.4]\n{walls}"
    );
    Room::new(&Scene::parse(&scene).unwrap()).unwrap().run().unwrap()
}

/// Error of the bearing, degrees: of the whole product, and of what the library takes.
fn errors_deg(run: &Simulation) -> [f64; 2] {
    let robot = &run.robots[0];
    let array = Array::new(&[Antenna::A, Antenna::B], &[Vector3::new(-BASELINE_M, 0.0, 0.0)]).unwrap();
    let mut options = Options::new("108".parse().unwrap());
    options.accuracy = options.accuracy.with_elevation_max_rad(Some(0.0));
    let mut both = [true, false].map(|_| OneLog::new(array.clone(), options.clone()));
    for item in items(&robot.log).unwrap() {
        let Item::Frame(frame) = item else { panic!("{item:?}") };
        let csi = |antenna: Antenna, _| {
            let column = frame.column(antenna.index(), 0)?;
            let measured = column.iter().zip(&frame.measured).filter(|(_, measured)| **measured);
            Some(measured.map(|([re, im], _)| Complex32::new(*re, *im)).collect())
        };
        let [whole, first] = &mut both;
        whole.hear(ArrayFrame::new(&array, Mac(frame.sender.unwrap()), frame.host_us, 1, csi).unwrap());
        assert!(first.note_frame(&frame));
    }
    let path = robot.true_path.as_ref().unwrap();
    let way = run.robots[1].start_m().unwrap() - path.poses()[0].position_m;
    both.map(|one| {
        let answer = one.bearings(path).links.pop().unwrap().bearing.unwrap().answer;
        wrap_rad(answer.azimuth_rad - way.y.atan2(way.x)).to_degrees()
    })
}

/// Rooms as large as offices are: at 160 MHz one delay is 1.9 m long. At 20 and 40 MHz it holds most of the room, and is not used.
#[test]
fn in_wide_frames_the_first_delay_is_nearer_than_the_product() {
    for (bandwidth_mhz, rooms) in [(40, 2), (160, 48)] {
        let errors: Vec<[f64; 2]> = (0..rooms).map(|seed| errors_deg(&room(100 + seed, bandwidth_mhz))).collect();
        let at = |k: usize, share: usize| {
            let mut sizes: Vec<f64> = errors.iter().map(|both| both[k].abs()).collect();
            sizes.sort_by(f64::total_cmp);
            sizes[sizes.len() * share / 100]
        };
        let better = errors.iter().filter(|[whole, first]| first.abs() < whole.abs()).count();
        let [whole, first] = [0, 1].map(|k| [50, 90].map(|share| at(k, share)));
        println!(
            "{bandwidth_mhz} MHz: product {whole:.2?}, first delay {first:.2?} degrees; better in {better} of {rooms}"
        );
        match bandwidth_mhz {
            40 => assert!(errors.iter().all(|[whole, first]| whole == first)),
            _ => assert!(first[0] < 0.8 * whole[0] && 2 * better > errors.len(), "{whole:?} {first:?} {better}"),
        }
    }
}
