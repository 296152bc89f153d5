//! A running robot in Foxglove's viewers, over a websocket.

mod channels;
mod door;

use super::{Adapter, Made, Said, Start};
use crate::health::Health;
use crate::machine::{Machine, Tap};
use channels::Live;
use csi5300::internal::Front;
use csi5300::motion::pose::Pose;
use csi5300::pipeline::live::PeerState;
use csi5300::source::{Error, Next, Stamps};
use csi5300::time::Instant;
use driver_iface::record::Record;
use std::sync::{Arc, Mutex, PoisonError};

/// Poses of a path at most.
const PATH: usize = 500;

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

pub(super) fn make(start: &Start<'_>) -> Made {
    let (config, name) = (start.config, start.name);
    let Some(address) = config.output.foxglove else { return Ok(None) };
    let links = config.peer.iter().map(|peer| peer.get_ref().name.as_str());
    let origins = config.output.foxglove_origins.clone();
    let live = Live::listen(name, links, address, origins).map_err(|error| Error::Backend(Box::new(error)))?;
    let live = Arc::new(Mutex::new(live));
    Ok(Some(Box::new(Shown { live, name: name.to_owned(), antenna: config.antenna })))
}

impl Adapter for Shown {
    fn attach(&mut self, machine: &mut Machine) -> Result<(), Error> {
        let live = Arc::clone(&self.live);
        machine.add_tap(Box::new(Told { live, name: self.name.clone(), front: Front::new(self.antenna) }));
        Ok(())
    }

    fn report(&mut self, said: &Said<'_>) {
        if said.report.state == PeerState::Bearing
            && let Some(bearing) = said.machine.estimator.bearing(said.peer)
        {
            // What is refused has no profile, and is in the report.
            let _ = self.with(|live| live.channels.bearing(&said.report.answer.link, bearing));
        }
    }

    fn tell(&mut self, _: &Health, machine: &Machine) {
        let (survey, track) = (&machine.estimator.own_log().survey, machine.estimator.track());
        let records_s = survey.host_us.map(|(_, last)| last as f64 * 1e-6);
        let step = track.len().div_ceil(PATH).max(1);
        self.with(|live| {
            if let Some(t_s) = records_s {
                live.channels.counters(&self.name, t_s, survey);
            }
            if let Some(last) = track.last().filter(|_| !track.is_still()) {
                live.channels.path(last.t_s, track.poses().step_by(step));
            }
        });
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
