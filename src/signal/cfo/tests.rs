//! Offsets that are known, found and removed.

use super::offset::along;
use super::*;
use crate::signal::channel::SUBCARRIERS;
use num_complex::{Complex32, Complex64};
use std::f64::consts::TAU;

const INDICES: [i8; SUBCARRIERS] = crate::signal::channel::INDICES_20_MHZ;

#[test]
fn centre_phase_is_exact_for_any_delay_the_card_has() {
    let wave = |size: f32, phase: f32, slope: f32| {
        std::array::from_fn(|k| Complex32::from_polar(size, phase + slope * f32::from(INDICES[k])))
    };
    for slope in [-1.4f32, -0.81, -0.3, 0.0, 0.4, 0.9] {
        for phase in [-3.0f32, -1.0, 0.0, 2.5] {
            let one = at_centre(&wave(3.0, phase, slope), &INDICES).unwrap();
            assert!((one.h - Complex64::from_polar(3.0, f64::from(phase))).norm() < 1e-4, "{slope} {phase}");
            // Two such slopes together turn by more than pi from one reported subcarrier to the next.
            let both = round_trip_at_centre(&wave(1.0, phase, slope), &wave(3.0, 0.5, slope), &INDICES).unwrap();
            assert!((both.h - Complex64::from_polar(3.0, f64::from(phase) + 0.5)).norm() < 1e-4, "{slope} {phase}");
            assert_eq!((one.path_gain, both.path_gain), (1, 2));
        }
    }
    assert_eq!(at_centre(&[Complex32::default(); SUBCARRIERS], &INDICES), None);
    assert_eq!(at_centre(&[Complex32::new(f32::NAN, 0.0); SUBCARRIERS], &INDICES), None);
}

#[test]
fn a_subcarrier_at_zero_has_no_part_in_the_line() {
    let wave: [Complex32; SUBCARRIERS] =
        std::array::from_fn(|k| Complex32::from_polar(3.0, 2.0 + 0.3 * f32::from(INDICES[k])));
    for silent in [&[0][..], &[0, 1, 2], &[7], &[3, 4, 20, 29], &[29]] {
        let mut csi = wave;
        silent.iter().for_each(|k| csi[*k] = Complex32::default());
        let found = at_centre(&csi, &INDICES).unwrap().h;
        assert!((found.arg() - 2.0).abs() < 1e-5, "{silent:?} {found}");
        assert!((found.norm_sqr() - 9.0 * (30.0 - silent.len() as f64) / 30.0).abs() < 1e-4, "{silent:?} {found}");
    }
    // One alone gives its own phase.
    let mut csi = [Complex32::default(); SUBCARRIERS];
    csi[4] = Complex32::from_polar(1.0, 0.7);
    assert!((at_centre(&csi, &INDICES).unwrap().h.arg() - 0.7).abs() < 1e-6);
}

/// [`TurnAround::estimate`] with differences of whole microseconds.
fn estimate(z: &[Complex64], clock_us: &[i64], difference_us: &[i64], carrier_hz: f64) -> Option<TurnAround> {
    let difference_us: Vec<f64> = difference_us.iter().map(|us| *us as f64).collect();
    TurnAround::estimate(z, clock_us, &difference_us, carrier_hz)
}

/// A link of `n` pairs at 10 ms with a slowly turning phase, an offset of `df_hz`, and a jitter with outliers.
fn link(n: usize, df_hz: f64, drift_ppm: f64) -> (Vec<Complex64>, Vec<i64>, Vec<i64>) {
    let mut state = 1u64;
    let mut random = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / f64::from(1u32 << 24)
    };
    let (mut z, mut clock, mut difference) = (Vec::new(), Vec::new(), Vec::new());
    for k in 0..n {
        let t_us = 10_000.0 * k as f64 + 300.0 * random();
        let jitter_us = if random() < 0.03 { 180.0 * random() } else { 16.0 * (random() - 0.5) };
        let d = jitter_us.round();
        z.push(Complex64::cis(3.0 * (t_us * 1e-6).sin() - TAU * df_hz * d * 1e-6));
        clock.push(4_294_967_000 + t_us as i64);
        difference.push(-7_000_000 + (d + drift_ppm * 1e-6 * t_us).round() as i64);
    }
    (z, clock, difference)
}

#[test]
fn the_offset_is_found_from_the_jitter_and_taken_out() {
    for df_hz in [-21_000.0, -4_100.0, 9_000.0] {
        let (mut z, clock, difference) = link(900, df_hz, df_hz / 5.54e9 * 1e6);
        let found = estimate(&z, &clock, &difference, 5.54e9).unwrap();
        assert!((found.df_hz - df_hz).abs() < 150.0, "{} for {df_hz}", found.df_hz);
        assert!((found.drift_ppm - df_hz / 5_540.0).abs() < 0.05);
        assert!(found.worthwhile && found.coherence_after > 0.98, "{found:?}");
        found.apply(&mut z);
        assert!(second_difference_coherence(&z).unwrap() > 0.97);
    }
}

#[test]
fn an_offset_that_drifts_is_followed_and_a_steady_one_is_left_alone() {
    let (mut z, clock, difference) = link(3_000, -15_000.0, -15_000.0 / 5_540.0);
    assert!(estimate(&z, &clock, &difference, 5.54e9).unwrap().course.is_empty());
    // From -15 kHz on it drifts by 2.4 kHz; `d` is the jitter that `link` made.
    let extra_hz = |k: usize| -2_400.0 * k as f64 / 3_000.0;
    let drift = -15_000.0 / 5.54e9;
    for (k, z) in z.iter_mut().enumerate() {
        let d_us = difference[k] as f64 + 7e6 - (drift * (clock[k] - clock[0]) as f64).round();
        *z *= Complex64::cis(-TAU * extra_hz(k) * d_us * 1e-6);
    }
    let found = estimate(&z, &clock, &difference, 5.54e9).unwrap();
    assert!((found.df_span_hz() - 2_240.0).abs() < 500.0, "{:?}", found.course);
    assert!(found.course.windows(2).all(|pair| (pair[1].1 - pair[0].1 + 160.0).abs() < 300.0), "{:?}", found.course);
    let mut one = z.clone();
    TurnAround { offsets_hz: Vec::new(), ..found.clone() }.apply(&mut one);
    found.apply(&mut z);
    let (with, without) = (second_difference_coherence(&z).unwrap(), second_difference_coherence(&one).unwrap());
    assert!(with > 0.97 && with > without + 0.005, "{with} {without}");
}

/// A program that answers from user space goes over to another path for good, 140 us longer: the line through the clocks'
/// differences is tilted by that, and the offset is far from where it points.
#[test]
fn a_turn_around_that_steps_hides_no_offset() {
    for step_at in [300, 450, 600] {
        let (mut z, clock, mut difference) = link(900, -16_000.0, -16_000.0 / 5_540.0);
        for (z, d) in z.iter_mut().zip(&mut difference).skip(step_at) {
            *d += 140;
            *z *= Complex64::cis(TAU * 16_000.0 * 140e-6);
        }
        let found = estimate(&z, &clock, &difference, 5.54e9).unwrap();
        assert!((found.df_hz + 16_000.0).abs() < 150.0, "{} with a step at {step_at}", found.df_hz);
        assert!(found.worthwhile && found.coherence_after > 0.98, "{found:?}");
        found.apply(&mut z);
        let (still, _, _) = link(900, 0.0, 0.0);
        let left: Complex64 = z.iter().zip(&still).map(|(a, b)| a * b.conj()).sum();
        assert!(left.norm() / z.len() as f64 > 0.98, "{left}");
    }
}

#[test]
fn points_beyond_a_course_have_its_end() {
    let course = [(10.0, 1.0), (20.0, 3.0)];
    assert_eq!([0.0, 10.0, 15.0, 20.0, 99.0].map(|x| along(&course, x)), [1.0, 1.0, 2.0, 3.0, 3.0].map(Some));
    assert_eq!((along(&course[..1], 5.0), along(&[], 5.0)), (Some(1.0), None));
}

#[test]
fn a_turn_around_that_drifts_is_no_drift_of_the_clocks() {
    let (z, clock, mut difference) = link(900, 9_000.0, 9_000.0 / 5_540.0);
    difference.iter_mut().enumerate().for_each(|(k, d)| *d += k as i64 / 40);
    // The product of the frames holds the longer turn-arounds too.
    let drifts = |(k, z): (usize, &Complex64)| z * Complex64::cis(-TAU * 9_000.0 * 1e-6 * (k / 40) as f64);
    let mut z: Vec<Complex64> = z.iter().enumerate().map(drifts).collect();
    let (still, _, _) = link(900, 0.0, 0.0);
    estimate(&z, &clock, &difference, 5.54e9).unwrap().apply(&mut z);
    let left: Complex64 = z.iter().zip(&still).map(|(a, b)| a * b.conj()).sum();
    assert!(left.norm() / z.len() as f64 > 0.98, "{left}");
}

/// At 100 kHz a microsecond is a tenth of a turn: whole ones leave half a radian, ticks of 3.125 ns next to nothing.
#[test]
fn a_finer_clock_leaves_less_of_the_offset() {
    let df_hz = 100_000.0;
    let (mut z, clock, mut whole) = link(900, 0.0, df_hz / 5_540.0);
    let still = z.clone();
    let mut fine_us: Vec<f64> = whole.iter().map(|us| *us as f64).collect();
    let drift = df_hz / 5.54e9;
    for (k, (z, d)) in z.iter_mut().zip(&mut fine_us).enumerate() {
        // What `link` rounded, and a part of a microsecond beside it, in ticks of the FTM clock.
        let since_us = (clock[k] - clock[0]) as f64;
        let jitter_us = *d + 7e6 - drift * since_us + ((k * 97) % 320) as f64 / 320.0;
        *z *= Complex64::cis(-TAU * df_hz * jitter_us * 1e-6);
        *d = ((drift * since_us + jitter_us - 7e6) * 320.0).floor() / 320.0;
        whole[k] = d.floor() as i64;
    }
    let left = |found: &TurnAround| {
        let mut z = z.clone();
        found.apply(&mut z);
        let turned: Complex64 = z.iter().zip(&still).map(|(a, b)| a * b.conj()).sum();
        let turned = turned / turned.norm();
        let sum: f64 = z.iter().zip(&still).map(|(a, b)| (a * b.conj() * turned.conj()).arg().powi(2)).sum();
        (sum / z.len() as f64).sqrt()
    };
    let finely = left(&TurnAround::estimate(&z, &clock, &fine_us, 5.54e9).unwrap());
    let coarsely = left(&estimate(&z, &clock, &whole, 5.54e9).unwrap());
    assert!(finely < 0.3 * coarsely && coarsely > 0.15, "{finely} {coarsely}");
}

#[test]
fn without_clocks_or_offset_nothing_is_done() {
    let (z, clock, difference) = link(500, 0.0, 1.0);
    assert!(!estimate(&z, &clock, &difference, 5.54e9).unwrap().worthwhile);
    let stopped = vec![4; z.len()];
    assert_eq!(estimate(&z, &stopped, &stopped, 5.54e9), None);
    assert_eq!(estimate(&z, &clock[1..], &difference, 5.54e9), None);
}

/// How steady the phase of `z` is from sample to sample, 0..1, whatever its slow course: the coherence of unit second
/// differences. `None` with fewer than three samples.
fn second_difference_coherence(z: &[Complex64]) -> Option<f64> {
    let unit = |w: &[Complex64]| {
        let product = w[0] * w[1].conj() * w[1].conj() * w[2];
        if product.norm() > 0.0 { product / product.norm() } else { Complex64::default() }
    };
    (z.len() >= 3).then(|| z.windows(3).map(unit).sum::<Complex64>().norm() / (z.len() - 2) as f64)
}
