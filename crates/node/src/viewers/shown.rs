//! The channels of a recording, over a websocket.

use crate::config::Config;
use crate::foxglove::Live;
use crate::machine::{Machine, Tap};
use csi5300::internal::Front;
use csi5300::motion::pose::Pose;
use csi5300::pipeline::live::{PeerReport, PeerState};
use csi5300::source::{Error, Next, Stamps};
use csi5300::time::Instant;
use driver_iface::record::Record;
use std::sync::{Arc, Mutex, PoisonError};

/// Poses of a path at most.
const PATH: usize = 500;

/// A websocket on which a robot is shown, if one is asked for.
pub struct Viewers(Option<Shown>);

struct Shown {
    live: Arc<Mutex<Live>>,
    name: String,
    antenna: driver_iface::bfee::Antenna,
}

impl Shown {
    fn with<T>(&self, tell: impl FnOnce(&mut Live) -> T) -> T {
        tell(&mut self.live.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Viewers {
    /// Listens, outside of an async runtime.
    pub fn open(config: &Config, name: &str) -> Result<Self, Error> {
        let Some(address) = config.output.foxglove else { return Ok(Self(None)) };
        let links = config.peer.iter().map(|peer| peer.get_ref().name.as_str());
        let origins = config.output.foxglove_origins.clone();
        let live = Live::listen(name, links, address, origins).map_err(|error| Error::Backend(Box::new(error)))?;
        Ok(Self(Some(Shown { live: Arc::new(Mutex::new(live)), name: name.to_owned(), antenna: config.antenna })))
    }

    /// Begins to hand the machine's records and poses to the viewers.
    pub fn attach(&self, machine: &mut Machine) {
        if let Some(shown) = &self.0 {
            let live = Arc::clone(&shown.live);
            machine.add_tap(Box::new(Told { live, name: shown.name.clone(), front: Front::new(shown.antenna) }));
        }
    }

    /// Tells a new bearing.
    pub fn report(&self, machine: &Machine, peer: usize, report: &PeerReport) {
        let Some(shown) = self.0.as_ref().filter(|_| report.state == PeerState::Bearing) else { return };
        if let Some(bearing) = machine.estimator.bearing(peer) {
            // What is refused has no profile, and is in the report.
            let _ = shown.with(|live| live.channels.bearing(&report.answer.link, bearing));
        }
    }

    /// Tells what was counted, and the path.
    pub fn look(&self, machine: &Machine) {
        let Some(shown) = &self.0 else { return };
        let (survey, track) = (&machine.estimator.own_log().survey, machine.estimator.track());
        let records_s = survey.host_us.map(|(_, last)| last as f64 * 1e-6);
        let step = track.len().div_ceil(PATH).max(1);
        shown.with(|live| {
            if let Some(t_s) = records_s {
                live.channels.counters(&shown.name, t_s, survey);
            }
            if let Some(last) = track.last().filter(|_| !track.is_still()) {
                live.channels.path(last.t_s, track.poses().step_by(step));
            }
        });
    }

    /// Lets the viewers go.
    pub fn stop(self) {
        let live = self.0.and_then(|shown| Arc::into_inner(shown.live)).map(Mutex::into_inner);
        if let Some(live) = live {
            live.unwrap_or_else(PoisonError::into_inner).stop();
        }
    }
}

struct Told {
    live: Arc<Mutex<Live>>,
    name: String,
    front: Front,
}

impl Tap for Told {
    fn record(&mut self, host_us: Option<i64>, record: Record<'_>) {
        let stamps = Stamps { at: Instant::ZERO, host_us, ..Stamps::default() };
        let Some((sender, heard)) = self.front.note(&Next::Record(stamps, record)) else { return };
        let t_s = heard.host_us.map_or(0.0, |us| us as f64 * 1e-6);
        let mut live = self.live.lock().unwrap_or_else(PoisonError::into_inner);
        live.channels.record(&self.name, t_s, sender, &heard);
    }

    fn pose(&mut self, pose: Option<Pose>) {
        if let Some(pose) = pose {
            self.live.lock().unwrap_or_else(PoisonError::into_inner).channels.pose(&pose);
        }
    }
}
