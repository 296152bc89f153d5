//! One card receiving one frame: from the channel to 8-bit coefficients and the fields around them.

mod ax210;

pub use ax210::Ax210;

use super::carrier::{Common, TONES, Tones};
use super::maths::{amplitude, decibel, phasor, power};
use super::radio::{AntennaOrder, Gain, Noise, Radio, Stray};
use super::random::{Purpose, Stream};
use super::surfaces::Path;
use super::world::World;
use driver_iface::bfee::Iq;
use num_complex::Complex64;

/// The card's report on one frame, without clocks and counters.
#[derive(Clone, Copy, Debug)]
pub struct Measured {
    /// Coefficients `[subcarrier][raw chain]`; the first `30 n_rx` count.
    pub csi: [Iq; 3 * TONES],
    /// Receive chains.
    pub n_rx: u8,
    /// RSSI of antennas A, B, C, dB.
    pub rssi: [u8; 3],
    /// Gain setting, dB.
    pub agc: u8,
    /// Antennas of the raw chains, two bits each.
    pub antenna_sel: u8,
    /// Components cut to -128 or 127.
    pub saturated: u32,
}

/// The frame to be received.
#[derive(Clone, Copy, Debug)]
pub struct Arrival {
    /// The sender's number.
    pub from: usize,
    /// The receiver's number.
    pub to: usize,
    /// True time of its rise at the receiver, nanoseconds.
    pub t_ns: i64,
    /// True time of the exchange's forward frame, nanoseconds.
    pub instant_ns: i64,
}

/// The receiving half of a card.
#[derive(Debug)]
pub struct Receiver {
    radio: Radio,
    stream: Stream,
    /// Noise of the phases between chains, and the constants between them, turns.
    chains: Stream,
    chain_turns: [f64; 3],
    paths: Vec<Path>,
    filter: Option<[f64; TONES]>,
}

/// The signals at the chains of one card, before the converter.
struct Incoming {
    tones: [Tones; 3],
    /// Mean power of each antenna's tones; `None` where nothing is connected.
    power: [Option<f64>; 3],
}

impl Receiver {
    /// The receiver of a robot.
    #[must_use]
    pub fn new(radio: Radio, seed: u64, robot: usize) -> Self {
        let [stream, chains] = [Purpose::Radio, Purpose::Chains].map(|purpose| Stream::new(seed, robot, purpose));
        let mut receiver =
            Self { filter: radio.filter(), radio, stream, chains, chain_turns: [0.0; 3], paths: Vec::new() };
        receiver.load();
        receiver
    }

    /// At a load of the firmware: draws the phases between chains.
    pub fn load(&mut self) {
        let share = if self.radio.chain_flips { 0.5 } else { 0.0 };
        for (turns, deg) in self.chain_turns.iter_mut().skip(1).zip(self.radio.chain_deg) {
            *turns = deg / 360.0 + if self.chains.happens(share) { 0.5 } else { 0.0 };
        }
    }

    /// The phase of an antenna's chain against A's in this frame, as a unit factor; none without the effect.
    fn chain_phasor(&mut self, antenna: usize) -> Option<Complex64> {
        let std = if antenna == 0 { 0.0 } else { self.radio.chain_noise_rad / std::f64::consts::TAU };
        let turns = self.chain_turns.get(antenna).copied().unwrap_or(0.0) + self.chains.spread(std);
        (turns != 0.0).then(|| phasor(turns))
    }

    /// Receives a frame. `None` if no path leads from sender to receiver, or one of no length: antennas at one place.
    pub fn measure(&mut self, world: &World, arrival: Arrival) -> Option<Measured> {
        let common = self.common(world, arrival);
        let n_rx = usize::from(self.radio.chains.clamp(1, 3));
        let incoming = self.incoming(world, arrival, common, n_rx);
        let strongest = incoming.power.iter().flatten().fold(0.0_f64, |a, &b| a.max(b));
        if strongest <= 0.0 || incoming.power.iter().flatten().any(|power| !power.is_finite()) {
            return None;
        }
        let received_db = self.radio.tx_power_dbm - world.first_metre_db();
        let noise = match self.radio.noise {
            Noise::Off => 0.0,
            Noise::SnrDb(db) => strongest * power(-db),
            Noise::FloorDbm(dbm) => power(dbm - received_db),
        };
        let strongest_dbm = received_db + decibel(strongest + noise);
        let (lsb, agc) = self.gain(strongest + noise, strongest_dbm);
        let level_db = received_db + 44.0 + f64::from(agc);
        let rssi = self.rssi(&incoming.power, n_rx, level_db, noise);
        let order = order_of(self.radio.antenna_order, n_rx, rssi);
        let mut measured = Measured {
            csi: [Iq::default(); 3 * TONES],
            n_rx: n_rx as u8,
            rssi: rssi.map(|db| db.round().clamp(0.0, 255.0) as u8),
            agc,
            antenna_sel: (0..n_rx).fold(0, |sel, k| sel | (order[k] as u8) << (2 * k)),
            saturated: 0,
        };
        for (k, &antenna) in order.iter().enumerate().take(n_rx) {
            self.convert(&incoming, antenna, lsb, noise, k, &mut measured);
        }
        Some(measured)
    }

    /// The tones that reach each antenna.
    fn incoming(&mut self, world: &World, arrival: Arrival, common: Common, n_rx: usize) -> Incoming {
        let mut incoming = Incoming { tones: [[Complex64::default(); TONES]; 3], power: [None; 3] };
        let t_s = arrival.t_ns as f64 * 1e-9;
        for (antenna, (tones, power)) in incoming.tones.iter_mut().zip(&mut incoming.power).enumerate().take(n_rx) {
            if world.paths(arrival.from, arrival.to, antenna, t_s, &mut self.paths) {
                world.add(&self.paths, common, tones);
                if let Some(filter) = &self.filter {
                    tones.iter_mut().zip(filter).for_each(|(tone, gain)| *tone *= *gain);
                }
                if let Some(phasor) = self.chain_phasor(antenna) {
                    tones.iter_mut().for_each(|tone| *tone *= phasor);
                }
                *power = Some(tones.iter().map(Complex64::norm_sqr).sum::<f64>() / TONES as f64);
            }
        }
        incoming
    }

    /// The signal of a chain without an antenna; A always has one.
    fn stray(&self, antenna: usize) -> Stray {
        match antenna {
            1 => self.radio.stray_b,
            2 => self.radio.stray_c,
            _ => Stray::default(),
        }
    }

    /// Effects common to all antennas: carrier phase, phase noise, delay.
    fn common(&mut self, world: &World, arrival: Arrival) -> Common {
        let Arrival { from, to, t_ns, instant_ns } = arrival;
        let jitter = if world.carrier_jitters() { self.stream.symmetric() } else { 0.0 };
        let mut turns = world.carrier_turns(from, to, t_ns, instant_ns, jitter);
        turns += self.stream.spread(self.radio.phase_noise_rad / std::f64::consts::TAU);
        let mut delay_s = 1e-9 * (self.radio.delay_ns + self.stream.spread(self.radio.delay_std_ns));
        if self.radio.sampling_offset {
            delay_s += world.sampling_offset_s(from, to, t_ns);
        }
        Common { turns, delay_s }
    }

    /// Steps of the converter per unit of the channel, and the `agc` field.
    fn gain(&mut self, power: f64, dbm: f64) -> (f64, u8) {
        match self.radio.gain {
            Gain::Fixed(fixed) => (fixed.lsb_at_1m, fixed.agc_db),
            Gain::Agc(agc) => {
                let lsb = agc.target_lsb / power.sqrt() * amplitude(self.stream.spread(agc.lsb_std_db));
                let setting = agc.rssi_db - 44.0 - dbm + self.stream.spread(agc.agc_std_db);
                (lsb, setting.round().clamp(0.0, 127.0) as u8)
            }
        }
    }

    /// RSSI of each antenna, dB, not rounded: `rss = rssi - 44 - agc` dBm, as csitool scales it.
    fn rssi(&mut self, powers: &[Option<f64>; 3], n_rx: usize, level_db: f64, noise: f64) -> [f64; 3] {
        let mut rssi = [0.0; 3];
        for (antenna, (rssi, power)) in rssi.iter_mut().zip(powers).enumerate().take(n_rx) {
            let stray = self.stray(antenna);
            *rssi = match power {
                Some(power) => level_db + decibel(power + noise),
                None => stray.rssi_db + self.stream.spread(stray.rssi_std_db),
            };
        }
        rssi
    }

    /// Adds noise to an antenna's tones and rounds them into raw chain `k`.
    fn convert(&mut self, incoming: &Incoming, antenna: usize, lsb: f64, noise: f64, k: usize, out: &mut Measured) {
        let stray = self.stray(antenna).lsb;
        let (scale, std) = match incoming.power[antenna] {
            Some(_) => (lsb, (0.5 * noise).sqrt() * lsb),
            None => (0.0, stray * std::f64::consts::FRAC_1_SQRT_2),
        };
        if scale == 0.0 && std == 0.0 {
            return;
        }
        let places = out.csi.iter_mut().skip(k).step_by(usize::from(out.n_rx));
        for (place, tone) in places.zip(&incoming.tones[antenna]) {
            let (re, im) = (tone.re * scale + self.stream.spread(std), tone.im * scale + self.stream.spread(std));
            *place = quantised(re, im, &mut out.saturated);
        }
    }
}

/// Antennas in chain order.
fn order_of(order: AntennaOrder, n_rx: usize, rssi: [f64; 3]) -> [usize; 3] {
    let mut antennas = [0, 1, 2];
    if order == AntennaOrder::ByRssi
        && let Some(used) = antennas.get_mut(..n_rx)
    {
        used.sort_by(|&a, &b| rssi[b].total_cmp(&rssi[a]));
    }
    antennas
}

/// Rounds to the nearest step, cuts at the converter's ends and counts what was cut.
fn quantised(re: f64, im: f64, saturated: &mut u32) -> Iq {
    let mut cut = |x: f64| {
        let clamped = x.clamp(-128.0, 127.0);
        *saturated += u32::from(!(-128.5..127.5).contains(&x));
        // Rounds halves up; all operands are exact, so the result is the same on every machine.
        (clamped + 128.5) as i32 as u8 ^ 0x80
    };
    Iq { i: cut(re).cast_signed(), q: cut(im).cast_signed() }
}

#[cfg(test)]
#[path = "receiver_tests.rs"]
mod tests;
