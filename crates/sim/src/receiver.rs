//! One card receiving one frame: from the channel to coefficients and the fields around them. Of a 5300 they have 8 bits; an
//! AX210 gives, as FeitCSI writes it, 16-bit coefficients of all subcarriers on two chains, noise in the pilots' places.

use super::maths::{amplitude, decibel, phasor, power};
use super::radio::{AntennaOrder, Gain, Noise, Radio, Stray};
use super::random::{Purpose, Stream};
use super::scene::{Preamble, Scene};
use super::world::{Common, Path, TONES, World};
use csi_formats::Kind;
use driver_iface::bfee::Iq;
use num_complex::Complex64;
use std::f64::consts::FRAC_1_SQRT_2;

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

/// What reaches the antennas of one card, before the converter.
struct Incoming {
    /// Each antenna's tones and their mean power; `None` where nothing is connected or nothing arrives.
    heard: Vec<Option<(Vec<Complex64>, f64)>>,
    /// The greatest of these powers, and that of the noise.
    strongest: f64,
    noise: f64,
    /// Power that is received at a distance of 1 m, dBm.
    metre_dbm: f64,
    /// Steps of the converter per unit of the channel, and the `agc` field.
    lsb: f64,
    agc: u8,
}

impl Receiver {
    /// The receiver of a robot.
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
        let (n_rx, filter) = (usize::from(self.radio.chains.clamp(1, 3)), self.filter);
        let fill = |paths: &[Path], common, tones: &mut [Complex64]| {
            paths.iter().for_each(|path| world.carrier.add(path, common, tones));
            if let Some(filter) = &filter {
                tones.iter_mut().zip(filter).for_each(|(tone, gain)| *tone *= *gain);
            }
        };
        let incoming = self.incoming(world, arrival, n_rx, TONES, fill)?;
        let rssi = self.rssi(&incoming);
        let order = order_of(self.radio.antenna_order, n_rx, rssi);
        let mut measured = Measured {
            csi: [Iq::default(); 3 * TONES],
            n_rx: n_rx as u8,
            rssi: rssi.map(|db| db.round().clamp(0.0, 255.0) as u8),
            agc: incoming.agc,
            antenna_sel: (0..n_rx).fold(0, |sel, k| sel | (order[k] as u8) << (2 * k)),
            saturated: 0,
        };
        for (k, &antenna) in order.iter().enumerate().take(n_rx) {
            self.convert(&incoming, antenna, k, &mut measured);
        }
        Some(measured)
    }

    /// What reaches each antenna, by `fill`, which adds paths to an antenna's tones; `None` if that is nothing, or infinite.
    fn incoming(
        &mut self,
        world: &World,
        arrival: Arrival,
        chains: usize,
        tones: usize,
        fill: impl Fn(&[Path], Common, &mut [Complex64]),
    ) -> Option<Incoming> {
        let common = self.common(world, arrival);
        let t_s = arrival.t_ns as f64 * 1e-9;
        let mut heard = Vec::with_capacity(chains);
        for antenna in 0..chains {
            heard.push(world.paths(arrival.from, arrival.to, antenna, t_s, &mut self.paths).then(|| {
                let mut own = vec![Complex64::default(); tones];
                fill(&self.paths, common, &mut own);
                if let Some(phasor) = self.chain_phasor(antenna) {
                    own.iter_mut().for_each(|tone| *tone *= phasor);
                }
                let power = own.iter().map(Complex64::norm_sqr).sum::<f64>() / tones as f64;
                (own, power)
            }));
        }
        let powers = || heard.iter().flatten().map(|(_, power)| *power);
        let strongest = powers().fold(0.0, f64::max);
        if strongest <= 0.0 || powers().any(|power| !power.is_finite()) {
            return None;
        }
        let metre_dbm = self.radio.tx_power_dbm - world.first_metre_db();
        let noise = match self.radio.noise {
            Noise::Off => 0.0,
            Noise::SnrDb(db) => strongest * power(-db),
            Noise::FloorDbm(dbm) => power(dbm - metre_dbm),
        };
        let (lsb, agc) = self.gain(strongest + noise, metre_dbm + decibel(strongest + noise));
        Some(Incoming { heard, strongest, noise, metre_dbm, lsb, agc })
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
    fn rssi(&mut self, incoming: &Incoming) -> [f64; 3] {
        let mut rssi = [0.0; 3];
        let level_db = incoming.metre_dbm + 44.0 + f64::from(incoming.agc);
        for (antenna, (rssi, heard)) in rssi.iter_mut().zip(&incoming.heard).enumerate() {
            let stray = self.stray(antenna);
            *rssi = match heard {
                Some((_, power)) => level_db + decibel(power + incoming.noise),
                None => stray.rssi_db + self.stream.spread(stray.rssi_std_db),
            };
        }
        rssi
    }

    /// Adds noise to an antenna's tones and rounds them into raw chain `k`.
    fn convert(&mut self, incoming: &Incoming, antenna: usize, k: usize, out: &mut Measured) {
        let Incoming { lsb, noise, .. } = *incoming;
        let (tones, scale, std) = match &incoming.heard[antenna] {
            Some((tones, _)) => (&tones[..], lsb, (0.5 * noise).sqrt() * lsb),
            None => (&[Complex64::ZERO; TONES][..], 0.0, self.stray(antenna).lsb * FRAC_1_SQRT_2),
        };
        if scale == 0.0 && std == 0.0 {
            return;
        }
        let places = out.csi.iter_mut().skip(k).step_by(usize::from(out.n_rx));
        for (place, tone) in places.zip(tones) {
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
    tones: csi_formats::Tones,
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
        let tones = csi_formats::Tones::of(kind, width_mhz)?;
        Some(Self { kind, width_mhz, tones, spacing_hz: if kind == Kind::He { 78_125.0 } else { 312_500.0 } })
    }
}

impl Receiver {
    /// Receives a frame. `None` if no path leads from sender to receiver, or one of no length.
    pub fn measure_ax210(&mut self, world: &World, arrival: Arrival, card: &Ax210) -> Option<MeasuredAx210> {
        let chains = usize::from(self.radio.chains.max(1)).min(CHAINS);
        let at = (&card.tones.subcarriers[..], card.spacing_hz);
        let fill = |paths: &[Path], common, tones: &mut [Complex64]| {
            paths.iter().for_each(|path| world.carrier.add_at(path, common, at, tones));
        };
        let incoming = self.incoming(world, arrival, chains, card.tones.subcarriers.len(), fill)?;
        let mut measured = MeasuredAx210 {
            csi: Vec::with_capacity(chains * card.tones.subcarriers.len()),
            n_rx: chains as u8,
            rssi_dbm: [-127; CHAINS],
            saturated: 0,
        };
        for (antenna, heard) in incoming.heard.iter().enumerate() {
            let power = |(_, power): &(_, f64)| incoming.metre_dbm + decibel(power + incoming.noise);
            measured.rssi_dbm[antenna] = heard.as_ref().map_or(f64::MIN, power).round().clamp(-127.0, -1.0) as i16;
            self.convert_ax210(&incoming, antenna, card, &mut measured);
        }
        Some(measured)
    }

    /// Adds noise to an antenna's tones, replaces pilots by noise as strong as the signal, and rounds.
    fn convert_ax210(&mut self, incoming: &Incoming, antenna: usize, card: &Ax210, out: &mut MeasuredAx210) {
        let Incoming { strongest, noise, .. } = *incoming;
        let lsb = incoming.lsb * STEPS;
        let tones = incoming.heard[antenna].as_ref().map(|(tones, _)| tones);
        let stray = self.stray(antenna).lsb * STEPS * FRAC_1_SQRT_2;
        for (k, is_data) in card.tones.data.iter().enumerate() {
            let (tone, std) = match tones.and_then(|tones| tones.get(k)) {
                None => (Complex64::default(), stray),
                Some(tone) if *is_data => (tone * lsb, (0.5 * noise).sqrt() * lsb),
                Some(_) => (Complex64::default(), (0.5 * strongest).sqrt() * lsb),
            };
            let parts = [tone.re + self.stream.spread(std), tone.im + self.stream.spread(std)];
            let (low, high) = (f64::from(i16::MIN), f64::from(i16::MAX));
            out.saturated += parts.iter().filter(|part| !(low - 0.5..high + 0.5).contains(*part)).count() as u32;
            // Halves up, as at 8 bits.
            out.csi.push(parts.map(|part| libm::floor(part.clamp(low, high) + 0.5) as i16));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(radio: &str, more: &str) -> Scene {
        let text = format!(
            "duration_s = 10.0\n[radio]\n{radio}\n{more}\n[[robot]]\nname = \"rx\"\n[[robot]]\nname = \"tx\"\nposition_m = [4.0, 0.0, 0.0]\n"
        );
        Scene::from_toml(&text).unwrap()
    }

    fn arrival(t_ns: i64) -> Arrival {
        Arrival { from: 1, to: 0, t_ns, instant_ns: t_ns }
    }

    fn receive(scene: &Scene, n: i64) -> Vec<Measured> {
        let world = World::new(scene).unwrap();
        let mut receiver = Receiver::new(scene.radio, scene.seed, 0);
        (0..n).map(|i| receiver.measure(&world, arrival(i * 10_000_000)).unwrap()).collect()
    }

    #[test]
    fn quantisation_rounds_to_nearest_and_counts_what_it_cuts() {
        let mut saturated = 0;
        let mut q = |x: f64| quantised(x, 0.0, &mut saturated).i;
        assert_eq!([q(0.4), q(0.6), q(-0.6), q(-0.4), q(126.6), q(127.4), q(-128.4)], [0, 1, -1, 0, 127, 127, -128]);
        assert_eq!([q(127.6), q(-129.0), q(1e30), q(-1e30)], [127, -128, 127, -128]);
        assert_eq!(saturated, 4);
    }

    #[test]
    fn a_bare_record_is_the_channel_itself() {
        let scene = scene("gain.fixed = { lsb_at_1m = 400.0 }", "");
        let m = receive(&scene, 1)[0];
        assert_eq!((m.n_rx, m.antenna_sel, m.saturated), (3, 0x24, 0));
        let world = World::new(&scene).unwrap();
        for (i, &k) in world.carrier.indices.iter().enumerate() {
            let hz = world.carrier.centre_hz + f64::from(k) * 312_500.0;
            let want = Complex64::from_polar(100.0, -std::f64::consts::TAU * 4.0 * hz / 299_792_458.0);
            let got = m.csi[3 * i];
            assert!(
                (f64::from(got.i) - want.re).abs() <= 0.5 + 1e-6 && (f64::from(got.q) - want.im).abs() <= 0.5 + 1e-6
            );
            assert_eq!(
                (m.csi[3 * i + 1], m.csi[3 * i + 2]),
                (Iq::default(), Iq::default()),
                "B and C are not connected"
            );
        }
    }

    #[test]
    fn filters_shape_the_subcarriers_and_leave_the_level() {
        let gains: Vec<String> =
            (0..30).map(|k| format!("{:.1}", if !(3..=26).contains(&k) { -6.0 } else { 3.0 })).collect();
        let flat = receive(&scene("gain.agc = { target_lsb = 60.0 }", ""), 1)[0];
        let shaped = format!("gain.agc = {{ target_lsb = 60.0 }}\nfilter_db = [{}]", gains.join(", "));
        let shaped = receive(&scene(&shaped, ""), 1)[0];
        let size = |m: &Measured, i: usize| f64::from(m.csi[3 * i].i).hypot(f64::from(m.csi[3 * i].q));
        let rms = |m: &Measured| ((0..30).map(|i| size(m, i).powi(2)).sum::<f64>() / 30.0).sqrt();
        assert!(
            (rms(&flat) - 60.0).abs() < 0.5 && (rms(&shaped) - 60.0).abs() < 0.5,
            "{} {}",
            rms(&flat),
            rms(&shaped)
        );
        let ratio = size(&shaped, 15) / size(&shaped, 0);
        assert!((ratio - amplitude(9.0)).abs() < 0.05 * ratio, "{ratio}: 9 dB between middle and edge");
        assert_eq!((shaped.agc, shaped.rssi), (flat.agc, flat.rssi));
    }

    #[test]
    fn a_pattern_weighs_both_directions_alike_by_the_robots_heading() {
        let power = |more: &str, arrival: Arrival| {
            let text = format!(
                "duration_s = 1.0\nradio.gain.agc = {{ target_lsb = 60.0 }}\n[[robot]]\nname = \"rx\"\n{more}\n\
                 [[robot]]\nname = \"tx\"\nposition_m = [4.0, 0.0, 0.0]\n"
            );
            let patterned = Scene::from_toml(&text).unwrap();
            let world = World::new(&patterned).unwrap();
            let measured = Receiver::new(patterned.radio, 1, 0).measure(&world, arrival).unwrap();
            i32::from(measured.rssi[0]) - i32::from(measured.agc)
        };
        let back = Arrival { from: 0, to: 1, t_ns: 0, instant_ns: 0 };
        let plain = power("", arrival(0));
        // The other robot is at +x: ahead, to the left, behind.
        for (yaw_deg, db) in [(0.0, 6), (-90.0, 3), (180.0, -6), (90.0, -3)] {
            let more = format!("yaw_deg = {yaw_deg:?}\npattern = {{ cos_db = 6.0, sin_db = 3.0 }}");
            assert_eq!([power(&more, arrival(0)), power(&more, back)], [plain + db; 2], "{yaw_deg} degrees");
        }
        let more = "yaw_deg = 45.0\npattern = { cos2_db = 9.0, sin2_db = -4.0 }";
        assert_eq!(power(more, arrival(0)), plain + 4, "45 degrees to the right: the second harmonic's sine is -1");
    }

    #[test]
    fn noise_has_the_stated_ratio_and_agc_the_stated_size() {
        let records = receive(&scene("noise.snr_db = 3.0", ""), 400);
        let clean = receive(&scene("", ""), 1)[0];
        let (mut signal, mut noise, mut total, mut n) = (0.0, 0.0, 0.0, 0.0);
        // Noise is part of what the gain control holds at 31 steps.
        let shrink = (1.0 / (1.0 + power(-3.0))).sqrt();
        for m in &records {
            for i in 0..TONES {
                let z = |iq: Iq| Complex64::new(f64::from(iq.i), f64::from(iq.q));
                let (got, want) = (z(m.csi[3 * i]), z(clean.csi[3 * i]) * shrink);
                signal += want.norm_sqr();
                noise += (got - want).norm_sqr();
                total += got.norm_sqr();
                n += 1.0;
            }
        }
        let snr_db = decibel(signal / noise);
        assert!((snr_db - 3.0).abs() < 0.1, "{snr_db} dB");
        assert!(((total / n).sqrt() - 31.0).abs() < 0.3, "{}", (total / n).sqrt());
    }

    #[test]
    fn rssi_and_agc_give_the_received_power() {
        // 15 dBm over 4 m at 5.54 GHz: 59.36 dB of free space loss, -44.36 dBm.
        let m = receive(&scene("", ""), 1)[0];
        let rss_dbm = f64::from(m.rssi[0]) - 44.0 - f64::from(m.agc);
        assert!((rss_dbm + 44.36).abs() <= 0.5, "{rss_dbm} dBm");
        assert_eq!(m.rssi[0], 38);
        let floor = receive(&scene("noise.floor_dbm = -92.0", ""), 1)[0];
        assert_eq!(floor.rssi[0], 38);
    }

    #[test]
    fn antennas_are_ordered_by_rssi_packet_by_packet() {
        let radio = "antenna_order = \"by_rssi\"\nstray_b = { lsb = 2.0, rssi_db = 14.0, rssi_std_db = 2.0 }\n\
                     stray_c = { lsb = 1.5, rssi_db = 14.0, rssi_std_db = 2.0 }";
        let records = receive(&scene(radio, ""), 400);
        let abc = records.iter().filter(|m| m.antenna_sel == 0x24).count();
        let acb = records.iter().filter(|m| m.antenna_sel == 0x18).count();
        assert_eq!(abc + acb, 400, "A is always the strongest");
        assert!((120..280).contains(&abc), "B and C change places: {abc}");
        for m in &records {
            let weaker = if m.antenna_sel == 0x24 { (1, 2) } else { (2, 1) };
            assert!(m.rssi[weaker.0] >= m.rssi[weaker.1]);
        }
        let rms = |k: usize| {
            let sum: f64 = records
                .iter()
                .flat_map(|m| (0..TONES).map(move |i| m.csi[3 * i + k]))
                .map(|iq| f64::from(iq.i).powi(2) + f64::from(iq.q).powi(2))
                .sum();
            (sum / (400.0 * TONES as f64)).sqrt()
        };
        assert!((rms(1) - 1.8).abs() < 0.3 && (rms(0) - 31.0).abs() < 0.1, "{} {}", rms(0), rms(1));
    }

    #[test]
    fn crystals_turn_the_two_directions_against_each_other() {
        let text = "duration_s = 10.0\ncfo = \"physical\"\n[radio]\ngain.fixed = { lsb_at_1m = 500.0 }\n[[robot]]\nname = \"rx\"\n[[robot]]\n\
                    name = \"tx\"\nposition_m = [4.0, 0.0, 0.0]\ncrystal.offset_ppm = -2.0\n";
        let scene = Scene::from_toml(text).unwrap();
        let world = World::new(&scene).unwrap();
        let mut receiver = Receiver::new(scene.radio, 1, 0);
        let mut phase = |from, to, t_ns| {
            let m = receiver.measure(&world, Arrival { from, to, t_ns, instant_ns: t_ns }).unwrap();
            Complex64::new(f64::from(m.csi[45].i), f64::from(m.csi[45].q))
        };
        // -2 ppm of 5.54 GHz is -11.08 kHz: 20 us turn it by -0.2216 of a turn, in the direction of the fast sender.
        let turned = (phase(1, 0, 20_000) / phase(1, 0, 0)).arg();
        assert!((turned + std::f64::consts::TAU * 0.2216).abs() < 0.03, "{turned}");
        let still = phase(0, 1, 0) * phase(1, 0, 0);
        let later = phase(0, 1, 7_777_000) * phase(1, 0, 7_777_000);
        assert!((later / still).arg().abs() < 0.03, "at one instant both cancel");
        // 225 us of turn-around leave 2 pi f d.
        let late = (phase(0, 1, 0) * phase(1, 0, 225_000) / still).arg();
        let want = std::f64::consts::TAU * (-11_080.0 * 225e-6);
        assert!(csi5300::maths::wrap_rad(late - want).abs() < 0.03, "{late}, not {want}");
    }

    #[test]
    fn the_papers_offset_cancels_but_for_its_jitter() {
        let paper =
            |jitter: &str| scene("gain.fixed = { lsb_at_1m = 500.0 }", &format!("[cfo.paper]\njitter_ns = {jitter}"));
        let residual = |scene: &Scene| {
            let world = World::new(scene).unwrap();
            let mut receiver = Receiver::new(scene.radio, 1, 0);
            let z: Vec<Complex64> = (0..500)
                .map(|i| {
                    let t_ns = i * 10_000_000;
                    let mut at = |from, to, late| {
                        let m = receiver
                            .measure(&world, Arrival { from, to, t_ns: t_ns + late, instant_ns: t_ns })
                            .unwrap();
                        Complex64::new(f64::from(m.csi[45].i), f64::from(m.csi[45].q))
                    };
                    at(0, 1, 0) * at(1, 0, 225_000)
                })
                .collect();
            let mean: Complex64 = z.iter().sum();
            (z.iter().map(|z| (z / mean).arg().powi(2)).sum::<f64>() / 500.0).sqrt()
        };
        assert!(residual(&paper("0.0")) < 0.02);
        // 2 pi x 2 MHz x uniform in +-100 ns x rms of the cosine: 0.513 rad.
        let got = residual(&paper("100.0"));
        assert!((got - 0.513).abs() < 0.06, "{got}");
    }

    #[test]
    fn disabled_effects_draw_no_random_numbers() {
        let scene = scene("", "");
        let world = World::new(&scene).unwrap();
        let mut receiver = Receiver::new(scene.radio, 1, 0);
        let before = receiver.stream.clone().uniform().to_bits();
        receiver.measure(&world, arrival(0)).unwrap();
        assert_eq!(receiver.stream.uniform().to_bits(), before);
    }

    /// Phases of chain B against A over records, radians.
    fn chain_phases(scene: &Scene, n: i64) -> Vec<f64> {
        let phase = |m: &Measured| {
            let [a, b] = [m.csi[0], m.csi[1]].map(|iq| Complex64::new(f64::from(iq.i), f64::from(iq.q)));
            (b * a.conj()).arg()
        };
        receive(scene, n).iter().map(phase).collect()
    }

    #[test]
    fn chains_have_constants_that_flip_with_the_firmware_and_noise_of_their_own() {
        // Antenna B where A is, so that nothing but the chains differs.
        let with = |radio: &str| {
            let mut scene = scene(&format!("gain.agc = {{ target_lsb = 100.0 }}\n{radio}"), "");
            scene.robot[0].antenna_b_m = Some([0.0; 3]);
            scene
        };
        let at = |radio: &str, n: i64| chain_phases(&with(radio), n);
        assert!(at("", 2).iter().all(|rad| rad.abs() < 0.02));
        assert!(at("chain_deg = [60.0, 0.0]", 2).iter().all(|rad| (rad.to_degrees() - 60.0).abs() < 1.0));
        let noisy = at("chain_noise_rad = 0.2", 4_000);
        let rms = (noisy.iter().map(|rad| rad * rad).sum::<f64>() / 4_000.0).sqrt();
        assert!((rms - 0.2).abs() < 0.01, "{rms}");
        // Of many loads of the firmware half are turned over.
        let world = World::new(&with("chain_flips = true")).unwrap();
        let mut receiver = Receiver::new(world.scene().radio, 1, 0);
        let mut over = 0;
        for _ in 0..200 {
            receiver.load();
            let [_, turns, _] = receiver.chain_turns;
            assert!(turns == 0.0 || turns == 0.5);
            over += usize::from(turns == 0.5);
        }
        assert!((70..130).contains(&over), "{over}");
    }
}
