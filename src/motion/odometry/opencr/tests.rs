//! The dialogue with an emulated controller, in virtual time.

use super::emulated::Emulated;
use super::table::ID;
use super::*;
use crate::motion::odometry::dynamixel;
use crate::time::Span;
use nalgebra::Vector3;

const WALL_US: i64 = 1_700_000_000_000_000;

/// Runs the dialogue from `from_s` to `to_s` in virtual time; `line` may spoil what the controller says.
fn talk(
    opencr: &mut OpenCr,
    device: &mut Emulated,
    (from_s, to_s): (f64, f64),
    mut line: impl FnMut(f64, Vec<u8>) -> Vec<u8>,
) -> Vec<Found> {
    let mut now = Instant::from_us((from_s * 1e6) as i64);
    let mut found = Vec::new();
    while now.as_s() < to_s {
        let asked = opencr.poll_transmit(now, WALL_US + now.as_us()).map(<[u8]>::to_vec);
        if let Some(asked) = asked {
            // A tenth of a millisecond there, half a one back.
            let at = now + Span::from_us(100);
            let answer = line(now.as_s(), device.answer(at.as_us(), &asked));
            let at = at + Span::from_us(500);
            opencr.handle_bytes(at, WALL_US + at.as_us(), &answer);
            now = at;
        }
        found.extend(std::iter::from_fn(|| opencr.poll_found()));
        now = opencr.poll_timeout().max(now + Span::from_us(1));
    }
    found
}

fn poses(found: &[Found]) -> Vec<Pose> {
    found.iter().filter_map(|found| if let Found::Pose(pose) = found { Some(*pose) } else { None }).collect()
}

/// Where the emulated robot is, in the frame of its start.
fn truth(t_s: f64) -> Vector3<f64> {
    let turned = (t_s / 20.0).min(1.0) * std::f64::consts::TAU;
    Vector3::new(0.3 * turned.sin(), 0.3 - 0.3 * turned.cos(), 0.0)
}

#[test]
fn a_circle_is_followed_in_place_and_time() {
    for imu in [true, false] {
        let (mut opencr, mut device) = (OpenCr::new(100.0, None, Instant::ZERO), Emulated::new());
        device.imu = imu;
        let poses = poses(&talk(&mut opencr, &mut device, (0.0, 22.0), |_, bytes| bytes));
        assert!(poses.len() > 1_050 && poses.len() <= 1_101, "{} poses of 50 Hz", poses.len());
        for pose in poses.iter().skip(60) {
            let off = (pose.position_m - truth(pose.t_s - WALL_US as f64 * 1e-6)).norm();
            assert!(off < 2e-3, "{off} m at {}", pose.t_s);
        }
        let counts = opencr.counts();
        assert_eq!((counts.unanswered, counts.refused, counts.restarts), (0, 0, 0), "{counts:?}");
        assert!(counts.repeated > 900 && (counts.drive.by_imu > 0) == imu, "{counts:?}");
        assert_eq!(opencr.trouble(), None);
    }
}

#[test]
fn damage_and_silence_cost_what_was_lost_and_no_more() {
    let (mut opencr, mut device) = (OpenCr::new(100.0, None, Instant::ZERO), Emulated::new());
    let mut n = 0;
    let found = talk(&mut opencr, &mut device, (0.0, 22.0), |t_s, mut bytes| {
        n += 1;
        match n % 10 {
            _ if (8.0..10.0).contains(&t_s) => return Vec::new(),
            3 => bytes[20] ^= 1,
            5 => bytes.truncate(40),
            7 => drop(bytes.splice(0..0, [0xFF, 0xFF, 0xFD])),
            _ => {}
        }
        bytes
    });
    assert!(!found.contains(&Found::NewFrame));
    let last = poses(&found).last().copied().unwrap();
    assert!((last.position_m - truth(22.0)).norm() < 3e-3, "{last:?}");
    let counts = opencr.counts();
    assert!(counts.packets.bad_crc > 10 && counts.unanswered > 20, "{counts:?}");
}

#[test]
fn a_controller_that_began_anew_opens_a_new_frame() {
    let (mut opencr, mut device) = (OpenCr::new(50.0, None, Instant::ZERO), Emulated::new());
    let before = talk(&mut opencr, &mut device, (0.0, 5.0), |_, bytes| bytes);
    opencr.reopened(Instant::from_us(5_000_000));
    (device.boot_us, device.ticks_from) = (0, 12_345);
    let after = talk(&mut opencr, &mut device, (5.0, 6.0), |_, bytes| bytes);
    assert_eq!(after.first(), Some(&Found::NewFrame));
    let (before, after) = (poses(&before), poses(&after));
    assert!((after[0].position_m - before[before.len() - 1].position_m).norm() < 1e-9);
    assert!((after[40].t_s - (WALL_US as f64 * 1e-6 + 5.8)).abs() < 0.1, "{}", after[40].t_s);
    assert_eq!(opencr.counts().restarts, 1);
}

#[test]
fn a_stall_of_this_host_is_no_restart_of_the_controller() {
    let (mut opencr, mut device) = (OpenCr::new(100.0, None, Instant::ZERO), Emulated::new());
    let mut now = Instant::ZERO;
    let mut got = Vec::new();
    while now.as_s() < 20.0 {
        let Some(asked) = opencr.poll_transmit(now, WALL_US + now.as_us()).map(<[u8]>::to_vec) else {
            now = opencr.poll_timeout().max(now + Span::from_us(1));
            continue;
        };
        let answer = device.answer(now.as_us() + 100, &asked);
        // Every fifth second the answer lies there for 1.2 s before it is looked at, the next one for none.
        let stalled = now.as_s() > 3.0 && now.as_us() / 10_000 % 500 < 2;
        now += if stalled { Span::from_ms(1_200) } else { Span::from_us(600) };
        opencr.handle_bytes(now, WALL_US + now.as_us(), &answer);
        got.extend(std::iter::from_fn(|| opencr.poll_found()));
    }
    let counts = opencr.counts();
    assert!(!got.contains(&Found::NewFrame) && poses(&got).len() > 700, "{counts:?}");
    assert_eq!((counts.restarts, counts.clock_steps, counts.drive.jumps), (0, 0, 0), "{counts:?}");
    let off = |pose: &Pose| (pose.position_m - truth(pose.t_s - WALL_US as f64 * 1e-6)).norm();
    assert!(poses(&got).iter().skip(60).all(|pose| off(pose) < 2e-3));
}

#[test]
fn a_clock_that_was_set_and_a_jump_of_the_ticks_open_a_new_frame() {
    let (mut opencr, mut device) = (OpenCr::new(100.0, None, Instant::ZERO), Emulated::new());
    assert!(!talk(&mut opencr, &mut device, (0.0, 5.0), |_, bytes| bytes).contains(&Found::NewFrame));
    device.ticks_from += 1 << 20;
    let jumped = talk(&mut opencr, &mut device, (5.0, 6.0), |_, bytes| bytes);
    assert_eq!(jumped.iter().filter(|found| **found == Found::NewFrame).count(), 1);
    // The host's clock is set back by an hour.
    let (now, back_us) = (Instant::from_us(6_100_000), WALL_US - 3_600_000_000);
    let asked = opencr.poll_transmit(now, back_us + now.as_us()).unwrap().to_vec();
    let answer = device.answer(now.as_us(), &asked);
    opencr.handle_bytes(now, back_us + now.as_us(), &answer);
    assert_eq!(opencr.poll_found(), Some(Found::NewFrame));
    let Some(Found::Pose(pose)) = opencr.poll_found() else { panic!("a pose on the new clock") };
    assert!((pose.t_s - (back_us as f64 * 1e-6 + 6.1)).abs() < 0.1, "{pose:?}");
}

#[test]
fn the_clocks_are_compared_where_values_are_fresh() {
    for rate_hz in [25.0, 50.0, 100.0] {
        let (mut opencr, mut device) = (OpenCr::new(rate_hz, None, Instant::ZERO), Emulated::new());
        // Always asked 9 ms after a refresh, were it in step.
        let found = talk(&mut opencr, &mut device, (0.009, 12.0), |_, bytes| bytes);
        for pose in poses(&found).iter().filter(|pose| pose.t_s > WALL_US as f64 * 1e-6 + 5.0) {
            let age_ms = ((pose.t_s - WALL_US as f64 * 1e-6) * 1e3 + 1.0).rem_euclid(20.0) - 1.0;
            assert!(age_ms < 2.5, "{rate_hz} Hz: {age_ms} ms after the refresh");
        }
    }
}

#[test]
fn wrong_devices_are_named() {
    let (mut opencr, mut device) = (OpenCr::new(50.0, None, Instant::ZERO), Emulated::new());
    device.model = 0x0406;
    assert!(talk(&mut opencr, &mut device, (0.0, 3.0), |_, bytes| bytes).is_empty());
    assert!(opencr.trouble().unwrap().contains("0x0406"));
    let mut opencr = OpenCr::new(50.0, None, Instant::ZERO);
    talk(&mut opencr, &mut device, (0.0, 3.0), |_, _| Vec::new());
    assert!(opencr.trouble().unwrap().contains("does not answer"));
    let mut opencr = OpenCr::new(50.0, None, Instant::ZERO);
    talk(&mut opencr, &mut device, (0.0, 3.0), |_, _| vec![0xFF, 0xFE, 8, 0, 0xF7]);
    assert!(opencr.trouble().unwrap().contains("rosserial"));
    let (mut opencr, mut device) = (OpenCr::new(50.0, None, Instant::ZERO), Emulated::new());
    device.device_status = -1;
    assert!(!talk(&mut opencr, &mut device, (0.0, 1.0), |_, bytes| bytes).is_empty());
    assert!(opencr.trouble().unwrap().contains("device status -1"));
    device.device_status = 0;
    talk(&mut opencr, &mut device, (1.0, 2.0), |_, bytes| bytes);
    assert_eq!(opencr.trouble(), None);
    let refusal = |_, _| {
        let mut out = Vec::new();
        dynamixel::emit(ID, dynamixel::instruction::STATUS, &[7], &mut out);
        out
    };
    talk(&mut opencr, &mut device, (2.0, 4.0), refusal);
    assert!(opencr.trouble().unwrap().contains("error 7"), "{:?}", opencr.trouble());
}
