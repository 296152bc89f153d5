//! Fits a scene to a recorded capture.
//!
//! Directly measured figures (rates, carrier offset, turn-around, RSSI, gain, latencies, noise of the subcarriers) go into the
//! scene. Properties that act through the whole chain (phase noise, transmitted power, reflections) are adjusted until the
//! simulated figures equal the recorded ones: each round simulates the scene and measures it like the recording.

use super::CompareError;
use super::distribution::Distribution;
use super::figures::{Figures, measure_scene_along};
use super::fitted_scene::{Recording, is_wide, text};
use super::side::SideFigures;
use csi5300::motion::pose::Trajectory;
use csi5300::pipeline::Options;
use csi5300::signal::channel::{Channel, Width};
use csi5300_sim::Scene;
use nalgebra::Vector3;
use std::f64::consts::TAU;
use std::path::Path;

/// A fitted scene.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// Its text.
    pub toml: String,
    /// The scene.
    pub scene: Scene,
    /// Its figures. The scene has another seed than the one used for fitting, so these are no better than any other seed's.
    pub figures: Figures,
}

/// What is known of a recording besides its figures.
pub struct Known<'a> {
    /// The receiver's trajectory.
    pub trajectory: &'a Trajectory,
    /// Its file name in the scene, relative to `folder`.
    pub file: &'a Path,
    /// The folder of the scene.
    pub folder: &'a Path,
    /// The transmitter's antenna, metres, in the trajectory's frame; the estimated place if unknown.
    pub transmitter_m: Option<[f64; 3]>,
}

/// Adjusted values: phase noise of a frame, loss of the walls (no walls for a recording without motion), transmitted power
/// that each side sees, variation of the phase slope on each side (radians per index), spread of the core of turn-arounds.
#[derive(Clone, Copy, Debug)]
pub(super) struct Adjusted {
    pub(super) phase_noise_rad: f64,
    pub(super) wall_loss_db: Option<f64>,
    pub(super) tx_power_dbm: [f64; 2],
    pub(super) slope_sd_rad: [f64; 2],
    pub(super) core_us: f64,
    /// Deviation of the robot from its trajectory, metres: accounts for slowly lost coherence.
    pub(super) stray_m: f64,
    /// Distance of the walls from the robots, metres: longer paths make subcarriers differ more.
    pub(super) margin_m: f64,
}

/// Rounds of adjustment.
const ROUNDS: usize = 8;
/// Seed for fitting, and seed of the fitted scene.
const SEEDS: [u64; 2] = [1, 2];
/// Loss of the walls, dB: first guess, least and largest.
const WALL_DB: [f64; 3] = [12.0, 1.0, 40.0];
/// Distance of the walls from the robots, metres: first guess, least and largest, typical of a laboratory.
const MARGIN_M: [f64; 3] = [2.5, 1.5, 4.0];
/// Coefficients are rounded to integers: the power of that error, steps squared.
const ROUNDING: f64 = 2.0 / 12.0;

/// Refuses a recording of another bandwidth than the channel's.
///
/// # Errors
/// [`CompareError::Width`] if most records have the other bandwidth.
pub fn check_width(recorded: &Figures, channel: Channel) -> Result<(), CompareError> {
    let recorded_mhz = if is_wide(&recorded.receiver) { 40 } else { 20 };
    let mhz = if channel.width() == Width::Ht20 { 20 } else { 40 };
    if recorded_mhz == mhz { Ok(()) } else { Err(CompareError::Width { recorded_mhz, channel }) }
}

/// Fits a scene.
///
/// # Errors
/// If the recording lacks what a scene needs or is not of the options' channel, or its scene cannot be simulated.
pub fn fit(recorded: &Figures, known: &Known<'_>, options: &Options) -> Result<Fitted, CompareError> {
    check_width(recorded, options.channel)?;
    let place = known.transmitter_m.or(recorded.link.place_m).ok_or(CompareError::NoPlace)?;
    let recording = Recording { figures: recorded, known, place, channel: options.channel };
    let mut adjusted = first(recorded, known.trajectory, place);
    let simulated = |adjusted: &Adjusted, seed: u64| {
        let scene = recording.scene(adjusted, seed);
        let unwritable = |source| CompareError::Fitted { toml: String::new(), source };
        let toml = text(&scene).map_err(unwritable)?;
        let read = Scene::read(&toml, known.folder);
        let scene = read.map_err(|source| CompareError::Fitted { toml: toml.clone(), source })?;
        let figures = measure_scene_along(&scene, known.trajectory, options)?;
        Ok::<_, CompareError>(Fitted { toml, scene, figures })
    };
    let mut best = (f64::INFINITY, adjusted);
    for _ in 0..ROUNDS {
        let figures = simulated(&adjusted, SEEDS[0])?.figures;
        let off = distance(recorded, &figures);
        if off < best.0 {
            best = (off, adjusted);
        }
        adjust(&mut adjusted, recorded, &figures, options.channel.wavelength_m());
    }
    simulated(&best.1, SEEDS[1])
}

/// The noise power of a subcarrier beyond the rounding of its coefficients, relative to the signal, at one side's antenna.
pub(super) fn noise(side: &SideFigures) -> f64 {
    let rounding = ROUNDING / side.level[0].median.max(1.0).powi(2);
    (10f64.powf(-0.1 * side.tone_snr_db) - rounding).max(0.0)
}

/// The first guess.
fn first(recorded: &Figures, trajectory: &Trajectory, place: [f64; 3]) -> Adjusted {
    let from_tones = (noise(&recorded.receiver) + noise(&recorded.transmitter)) / 60.0;
    let spread = recorded.link.spread_after_rad;
    let away_m = middle(trajectory).metric_distance(&Vector3::from(place)).max(0.1);
    // Free space over the first metre at 5.5 GHz is 47.3 dB.
    let lost_db = 47.3 + 20.0 * away_m.log10();
    let power = |side: &SideFigures| side.rssi_db[0].mean - 44.0 - side.agc_db.mean + lost_db;
    Adjusted {
        phase_noise_rad: (0.5 * (spread * spread - from_tones)).max(0.0).sqrt(),
        wall_loss_db: recorded.link.coherence.map(|_| WALL_DB[0]),
        tx_power_dbm: [power(&recorded.receiver), power(&recorded.transmitter)],
        core_us: recorded.link.core_us,
        stray_m: 0.0,
        margin_m: MARGIN_M[0],
        slope_sd_rad: [recorded.receiver.slope_rad.sd, recorded.transmitter.slope_rad.sd],
    }
}

pub(super) fn middle(trajectory: &Trajectory) -> Vector3<f64> {
    let poses = trajectory.poses();
    poses.iter().map(|pose| pose.position_m).sum::<Vector3<f64>>() / poses.len().max(1) as f64
}

/// Ripple over the subcarriers that filters do not explain.
fn selective(side: &SideFigures) -> f64 {
    let filter = Distribution::of(&side.filter);
    (side.ripple.median.powi(2) - (filter.sd / filter.mean.max(1e-6)).powi(2)).max(1e-6).sqrt()
}

/// Differences of the adjusted figures from the recorded ones.
fn distance(recorded: &Figures, simulated: &Figures) -> f64 {
    let (a, b) = (&recorded.link, &simulated.link);
    let relative = |a: f64, b: f64| (b / a.max(1e-6)).max(1e-6).ln().abs() / 0.15;
    let apart = |a: Option<f64>, b: Option<f64>| a.zip(b).map_or(0.0, |(a, b)| (a - b).abs() / 0.1);
    let coherence = apart(a.coherence, b.coherence).max(apart(a.short_coherence, b.short_coherence));
    let gain = |a: &SideFigures, b: &SideFigures| (a.agc_db.mean - b.agc_db.mean).abs();
    let gains = gain(&recorded.receiver, &simulated.receiver) + gain(&recorded.transmitter, &simulated.transmitter);
    let spreads = [(a.spread_before_rad, b.spread_before_rad), (a.spread_after_rad, b.spread_after_rad)];
    let spread = spreads.into_iter().map(|(a, b)| relative(a, b)).fold(0.0, f64::max);
    // Figures that depend on the walls, in units of their limits.
    let fading = |a: &SideFigures, b: &SideFigures| {
        ((a.agc_db.sd - b.agc_db.sd).abs() / 0.7).max((a.ripple.median - b.ripple.median).abs() / 0.05)
    };
    let sides = [(&recorded.receiver, &simulated.receiver), (&recorded.transmitter, &simulated.transmitter)];
    let fading = sides.into_iter().map(|(a, b)| fading(a, b)).fold(0.0, f64::max);
    spread.max(coherence).max(fading) + 0.1 * gains
}

/// Moves the adjusted values towards the recorded figures.
fn adjust(adjusted: &mut Adjusted, recorded: &Figures, simulated: &Figures, wavelength_m: f64) {
    let (a, b) = (&recorded.link, &simulated.link);
    // Variances add: each frame gets half of the missing part.
    let missing = 0.5 * (a.spread_after_rad.powi(2) - b.spread_after_rad.powi(2));
    adjusted.phase_noise_rad = (adjusted.phase_noise_rad.powi(2) + missing).max(0.0).sqrt();
    // Before compensation, the carrier offset turns the turn-around's spread into phase.
    let rad_per_us = TAU * a.df_hz.abs().max(1_000.0) * 1e-6;
    let missing = (a.spread_before_rad.powi(2) - b.spread_before_rad.powi(2)) / rad_per_us.powi(2);
    let core_us = (adjusted.core_us.powi(2) + missing).max(0.0).sqrt();
    adjusted.core_us = core_us.clamp(0.7 * a.core_us, 1.4 * a.core_us);
    if let (Some(loss_db), Some(wanted), Some(got)) = (adjusted.wall_loss_db, a.short_coherence, b.short_coherence) {
        // Within a second, reflections limit coherence, and their incoherent power scales with the walls' reflection.
        let incoherent = |c: f64| (1.0 - c.powi(2)).clamp(0.01, 0.99);
        let step_db = 5.0 * (incoherent(got) / incoherent(wanted)).log10() * 2.0;
        adjusted.wall_loss_db = Some((loss_db + step_db.clamp(-6.0, 6.0)).clamp(WALL_DB[1], WALL_DB[2]));
    }
    if adjusted.wall_loss_db.is_some() {
        let of = |figures: &Figures| selective(&figures.receiver) + selective(&figures.transmitter);
        let longer = (of(recorded) / of(simulated)).clamp(0.7, 1.4);
        adjusted.margin_m = (adjusted.margin_m * longer).clamp(MARGIN_M[1], MARGIN_M[2]);
    }
    if let (Some(wanted), Some(got)) = (a.coherence, b.coherence) {
        // Over the whole motion, deviations from the path limit coherence: a phase of deviation s leaves exp(-s^2 / 2), and a round
        // trip has 4 pi of phase per wavelength.
        let missing = 2.0 * (got.max(0.01) / wanted.max(0.01)).ln() * (wavelength_m / (2.0 * TAU)).powi(2);
        adjusted.stray_m = (adjusted.stray_m.powi(2) + missing).clamp(0.0, (0.25 * wavelength_m).powi(2)).sqrt();
    }
    let sides = [(&recorded.receiver, &simulated.receiver), (&recorded.transmitter, &simulated.transmitter)];
    for (power, (a, b)) in adjusted.tx_power_dbm.iter_mut().zip(sides) {
        *power += b.agc_db.mean - a.agc_db.mean;
    }
    for (slope, (a, b)) in adjusted.slope_sd_rad.iter_mut().zip(sides) {
        *slope = (slope.powi(2) + a.slope_rad.sd.powi(2) - b.slope_rad.sd.powi(2)).max(0.0).sqrt();
    }
}
