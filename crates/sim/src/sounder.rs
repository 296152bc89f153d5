//! The room's own senders: the TDMA state machine that live cards run too, driven in virtual time.

use super::radio::{DelayGroup, Radio};
use super::scene::{Dialect, Scene, Sounding};
use super::station::{FrameRole, Station};
use super::world::World;
use csi5300::exchange::tdma::{self, Config, Event, Plan, PlanError, Request, Tdma};
use csi5300::time::{Instant, Span};
use driver_iface::radiotap::Bandwidth;
use driver_iface::sounding::wsr;

/// Silence after which a lost turn is taken, in slots, if only one robot wants it.
const ALONE_SILENCE_SLOTS: u32 = 2;
/// A guard is this many times the jitter of sending, and the usual delay with this many deviations beside it, so that
/// frames keep out of each other's slots.
const GUARD_PER_JITTER: f64 = 5.0;
const GUARD_DEVIATIONS: f64 = 3.0;

/// One robot's side of the exchange.
#[derive(Debug)]
pub struct Sounder {
    tdma: Tdma,
}

impl Station for Sounder {
    fn heard(&mut self, now: Instant, frame: &[u8]) -> FrameRole {
        self.tdma.handle_heard(now, now, frame);
        let mut role = FrameRole::Overheard;
        while let Some(event) = self.tdma.poll_event() {
            match event {
                Event::Asked { .. } => role = FrameRole::Forward,
                Event::Answered { .. } => role = FrameRole::Backward,
                _ => {}
            }
        }
        role
    }

    fn transmit(&mut self, now: Instant, frame: &mut Vec<u8>) -> bool {
        let transmit = self.tdma.poll_transmit(now);
        transmit.map(|transmit| frame.extend_from_slice(transmit.frame)).is_some()
    }

    fn timeout(&self) -> Option<Instant> {
        self.tdma.poll_timeout()
    }
}

/// The request of a scene's sounding; an infinite rate becomes the highest that fits.
///
/// # Errors
/// [`PlanError`] when the rate does not fit, with the highest that does.
pub(super) fn request(scene: &Scene, sounding: &Sounding) -> Result<Request, PlanError> {
    let radios = || scene.robot.iter().map(|robot| scene.radio_of(robot));
    let longest = |of: fn(&Radio) -> f64| radios().map(of).fold(0.0, f64::max);
    let phy = tdma::Phy {
        mcs: radios().map(|radio| radio.mcs).min().unwrap_or(0),
        bandwidth: if scene.bandwidth_mhz == 40 { Bandwidth::Ht40 } else { Bandwidth::Ht20 },
    };
    let dialect = match sounding.dialect {
        Dialect::Wsr => tdma::Dialect::Wsr { first_len: wsr::DEFAULT_LEN as u16 },
        Dialect::Native => tdma::Dialect::Native { measurement: false, authenticated: false },
    };
    let request = Request {
        phy,
        dialect,
        turn_around_us: longest(|radio| radio.turn_around.max_us).ceil() as u32,
        guard_us: Request::default().guard_us.max(longest(lateness_us).ceil() as u32),
        ..Request::new(scene.robot.len().saturating_sub(1) as u16, sounding.rate_hz)
    };
    if sounding.rate_hz != f64::INFINITY {
        return Plan::new(&request).map(|_| request);
    }
    match Plan::new(&Request { rate_hz: 1e6, ..request }) {
        Err(PlanError::Rate { highest_hz, .. }) => Ok(Request { rate_hz: highest_hz, ..request }),
        Err(other) => Err(other),
        Ok(_) => Ok(Request { rate_hz: 1e6, ..request }),
    }
}

/// Lateness that few frames of a radio exceed, microseconds.
fn lateness_us(radio: &Radio) -> f64 {
    let DelayGroup { share, us, spread_us } = radio.send_delay;
    let delayed_us = if share > 0.0 { us + GUARD_DEVIATIONS * spread_us } else { 0.0 };
    GUARD_PER_JITTER * radio.send_jitter_us + delayed_us
}

/// The sender of a robot, switched on at `now` on its own clock, for the `restarts`-th time.
///
/// # Errors
/// [`PlanError`] as [`request`].
pub(super) fn sounder(world: &World, robot: usize, restarts: u64, now: Instant) -> Result<Option<Sounder>, PlanError> {
    let scene = world.scene();
    let Some(sounding) = &scene.sounding else { return Ok(None) };
    let request = request(scene, sounding)?;
    let initiators = scene.initiators();
    let index = |robot: usize| u16::try_from(robot).unwrap_or(u16::MAX);
    let peers = (0..scene.robot.len()).filter(|&peer| peer != robot);
    let begin = Instant::from_us((sounding.start_s * 1e6).round() as i64);
    let session = (scene.start_unix_s as u32).wrapping_add(restarts as u32);
    let mut config = Config {
        initiate: initiators.contains(&robot),
        epoch: tdma::Epoch::Heard(begin),
        ..Config::new(world.mac(robot), index(robot), &[], request, session)
    };
    config.start = now.max(begin);
    config.peers = peers.map(|peer| tdma::Robot { mac: world.mac(peer), index: index(peer) }).collect();
    if initiators.len() == 1 {
        config.silence_slots = ALONE_SILENCE_SLOTS;
        if restarts == 0 {
            // It has listened before the scene, and starts in its first slot.
            let listened = Plan::new(&request)?.span_of(2 * ALONE_SILENCE_SLOTS);
            config.start = begin - listened - Span::from_us(1);
        }
    }
    Tdma::new(&config).map(|tdma| Some(Sounder { tdma }))
}
