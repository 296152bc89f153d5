//! An AX210 receiving one frame, as FeitCSI writes it: 16-bit coefficients of all subcarriers on two chains, noise in the
//! pilots' places.

use super::super::carrier::Common;
use super::super::maths::{decibel, power};
use super::super::radio::{Noise, Radio};
use super::super::scene::{Preamble, Scene};
use super::super::world::World;
use super::{Arrival, Receiver};
use csi_formats::{Kind, Tones};
use num_complex::Complex64;

/// Chains of the card.
const CHAINS: usize = 2;
/// Steps of its converter in one of a 5300: coefficients have a root mean square of 155 in FeitCSI's files, of 31 in captures
/// of a 5300.
const STEPS: f64 = 5.0;

/// An AX210's measurement of a scene's frames.
#[derive(Clone, Debug)]
pub struct Ax210 {
    /// Kind of the frames.
    pub kind: Kind,
    /// Their width, MHz.
    pub width_mhz: u16,
    tones: Tones,
    spacing_hz: f64,
}

/// The card's report on one frame, without clocks and addresses.
#[derive(Clone, Debug)]
pub struct MeasuredAx210 {
    /// Coefficients `[chain][subcarrier]`.
    pub csi: Vec<[i16; 2]>,
    /// Chains.
    pub n_rx: u8,
    /// Strength of the chains, dBm.
    pub rssi_dbm: [i16; CHAINS],
    /// Components cut at the converter's ends.
    pub saturated: u32,
}

impl Ax210 {
    /// `None` for impossible frames.
    pub fn of(scene: &Scene) -> Option<Self> {
        let kind = match scene.preamble.unwrap_or(Preamble::He) {
            Preamble::Ht => Kind::Ht,
            Preamble::Vht => Kind::Vht,
            Preamble::He => Kind::He,
        };
        let width_mhz = scene.bandwidth_mhz;
        let tones = Tones::of(kind, width_mhz)?;
        Some(Self { kind, width_mhz, tones, spacing_hz: if kind == Kind::He { 78_125.0 } else { 312_500.0 } })
    }
}

impl Receiver {
    /// Receives a frame. `None` if no path leads from sender to receiver, or one of no length.
    pub fn measure_ax210(&mut self, world: &World, arrival: Arrival, card: &Ax210) -> Option<MeasuredAx210> {
        let common = self.common(world, arrival);
        let chains = usize::from(self.radio.chains.max(1)).min(CHAINS);
        let heard: Vec<Option<Vec<Complex64>>> =
            (0..chains).map(|antenna| self.heard(world, arrival, common, antenna, card)).collect();
        let mean = |tones: &Vec<Complex64>| tones.iter().map(Complex64::norm_sqr).sum::<f64>() / tones.len() as f64;
        let powers: Vec<Option<f64>> = heard.iter().map(|tones| tones.as_ref().map(mean)).collect();
        let strongest = powers.iter().flatten().fold(0.0_f64, |a, &b| a.max(b));
        if strongest <= 0.0 || !strongest.is_finite() {
            return None;
        }
        let Radio { tx_power_dbm, noise, .. } = self.radio;
        let received_dbm = tx_power_dbm - world.first_metre_db();
        let noise = match noise {
            Noise::Off => 0.0,
            Noise::SnrDb(db) => strongest * power(-db),
            Noise::FloorDbm(dbm) => power(dbm - received_dbm),
        };
        let (lsb, _) = self.gain(strongest + noise, received_dbm + decibel(strongest + noise));
        let mut measured = MeasuredAx210 {
            csi: Vec::with_capacity(chains * card.tones.subcarriers.len()),
            n_rx: chains as u8,
            rssi_dbm: [-127; CHAINS],
            saturated: 0,
        };
        for (antenna, (tones, power)) in heard.iter().zip(&powers).enumerate() {
            let dbm = power.map_or(f64::MIN, |power| received_dbm + decibel(power + noise));
            measured.rssi_dbm[antenna] = dbm.round().clamp(-127.0, -1.0) as i16;
            self.convert_ax210(tones.as_deref(), (lsb * STEPS, noise, strongest), antenna, card, &mut measured);
        }
        Some(measured)
    }

    /// The tones at an antenna; none if it is not connected or nothing reaches it.
    fn heard(
        &mut self,
        world: &World,
        arrival: Arrival,
        common: Common,
        antenna: usize,
        card: &Ax210,
    ) -> Option<Vec<Complex64>> {
        let t_s = arrival.t_ns as f64 * 1e-9;
        world.paths(arrival.from, arrival.to, antenna, t_s, &mut self.paths).then_some(())?;
        let mut tones = vec![Complex64::default(); card.tones.subcarriers.len()];
        world.add_at(&self.paths, common, (&card.tones.subcarriers, card.spacing_hz), &mut tones);
        if let Some(phasor) = self.chain_phasor(antenna) {
            tones.iter_mut().for_each(|tone| *tone *= phasor);
        }
        Some(tones)
    }

    /// Adds noise to an antenna's tones, replaces pilots by noise as strong as the signal, and rounds.
    fn convert_ax210(
        &mut self,
        tones: Option<&[Complex64]>,
        (lsb, noise, signal): (f64, f64, f64),
        antenna: usize,
        card: &Ax210,
        out: &mut MeasuredAx210,
    ) {
        let stray = self.stray(antenna).lsb * STEPS * std::f64::consts::FRAC_1_SQRT_2;
        for (k, is_data) in card.tones.data.iter().enumerate() {
            let (tone, std) = match tones.and_then(|tones| tones.get(k)) {
                None => (Complex64::default(), stray),
                Some(tone) if *is_data => (tone * lsb, (0.5 * noise).sqrt() * lsb),
                Some(_) => (Complex64::default(), (0.5 * signal).sqrt() * lsb),
            };
            let parts = [tone.re + self.stream.spread(std), tone.im + self.stream.spread(std)];
            let (low, high) = (f64::from(i16::MIN), f64::from(i16::MAX));
            out.saturated += parts.iter().filter(|part| !(low - 0.5..high + 0.5).contains(*part)).count() as u32;
            // Halves up, as at 8 bits.
            out.csi.push(parts.map(|part| libm::floor(part.clamp(low, high) + 0.5) as i16));
        }
    }
}
