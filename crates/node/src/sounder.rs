//! The robot's part in the sounding exchange: the sender's thread beside the service.

use super::config::{Capture, Config, Peer, Records};
use super::health::Health;
use super::machine::{Machine, Tap};
use csi5300::exchange::tdma::{Epoch, Event, Key};
use csi5300::source::{Error, Next, read_key};
use csi5300::time::Instant;
use csi5300_live::doctor::{Machine as Host, other_channel};
use csi5300_live::monitor::Monitor;
use csi5300_live::sounding::{Measuring, News, Notice, Running, Settings, Setup, rate_n_flags, set_rate};
use csi5300_live::wait::Monotonic;
use csi5300_sim::served::{self, Address};
use driver_iface::Mac;
use driver_iface::bfee::Antenna;
use serde::Serialize;
use std::sync::Arc;

/// Counts of the exchange.
#[derive(Clone, Debug, Default, Serialize)]
struct SoundingCounts {
    /// Forward frames answered.
    answered: u64,
    /// Forward frames not answered in time.
    unanswered: u64,
    /// Forward frames of others for this robot, which it answered.
    asked: u64,
    /// Slots skipped because the host was late.
    missed_slots: u64,
    /// Turns that this robot had.
    turns: u64,
    /// Turns given up to another initiator.
    yielded: u64,
    /// Robots that no longer answer.
    absent: Vec<String>,
    /// The priority that the system granted to the sending thread.
    granted: Option<String>,
    /// The last problem of the interface, until frames go out again.
    notice: Option<String>,
    /// The thread has ended by itself; the node reports the reason at its end.
    ended: bool,
}

/// A running exchange.
pub(super) struct Sounder {
    running: Arc<Running>,
    counts: SoundingCounts,
    /// What is wrong from the start on.
    warnings: Vec<String>,
    antenna: Antenna,
    peers: Vec<Mac>,
    /// Peers whose records come with their answers.
    answering: Vec<Mac>,
    measures: bool,
    key: Option<Key>,
}

impl Sounder {
    /// Starts the sending thread, if requested.
    pub fn start(config: &Config, own: Mac, peers: Vec<Mac>, clock: Monotonic) -> Result<Option<Self>, Error> {
        let Some((asked, request)) = config.sounding.as_ref().zip(config.sounding_request()) else { return Ok(None) };
        let room = match config.capture.get_ref() {
            Capture::Served(served) => Some(Address { socket: served.socket.clone(), robot: served.robot.clone() }),
            _ => None,
        };
        let setup = Setup {
            interface: asked
                .interface
                .clone()
                .unwrap_or_else(|| room.as_ref().map_or_else(String::new, Address::to_string)),
            mac: Some(own),
            peers: peers.clone(),
            request,
            own_index: 0,
            key: asked.key.as_deref().map(read_key).transpose()?,
        };
        let now = clock.now();
        let monitor = match &room {
            Some(address) => {
                let (air, mac) = served::join(address, served::Role::Air)?;
                Monitor::over(air, mac, &setup.options())
            }
            None => Monitor::open(&setup.options()),
        }?;
        let opened = setup.open_on(monitor, |config| {
            (config.epoch, config.start, config.initiate) = (Epoch::Heard(now), now, asked.initiate);
        })?;
        let mut warnings: Vec<String> = opened.warning.clone().into_iter().collect();
        if let Some(rate) = rate_n_flags(request.phy, config.antenna)
            && let Some(interface) = &asked.interface
        {
            warnings.extend(set_rate(&Host, interface, rate).err());
            warnings.extend(other_channel(&Host, interface, config.channel));
        }
        let usual = Settings::default();
        let settings = Settings { fifo_priority: usual.fifo_priority.filter(|_| asked.fifo), ..usual };
        let (key, measures) = (opened.key.clone(), asked.measurement);
        let running = Arc::new(Running::start(opened, clock, settings)?);
        let by_answers = |peer: &Peer| matches!(peer.records, Records::Sounding(_));
        let asked = config.peer.iter().map(|peer| peer.get_ref());
        let answering = asked.zip(&peers).filter(|(peer, _)| by_answers(peer)).map(|(_, mac)| *mac).collect();
        let counts = SoundingCounts::default();
        Ok(Some(Self { running, counts, warnings, antenna: config.antenna, peers, answering, measures, key }))
    }

    /// From now on answers carry the card's measurements, and with a key only confirmed exchanges are used.
    pub fn attach(&self, machine: &mut Machine) {
        if let Some(key) = &self.key {
            machine.estimator.require_key(key);
        }
        if self.measures {
            let measuring = Measuring::new(self.antenna, self.peers.clone(), self.key.clone());
            machine.add_tap(Box::new(Measures(Arc::clone(&self.running), measuring)));
        }
    }

    /// Takes the news: exchanges that the machine may use.
    pub fn take(&mut self, machine: &mut Machine, now: Instant) {
        while let Some(news) = self.running.news() {
            self.counts.note(&news);
            let News::Event(event) = news else { continue };
            if let Event::Answered { peer, number, .. } | Event::Asked { peer, number, .. } = &event {
                machine.estimator.handle_confirmed(*peer, *number, now);
            }
            if let Event::Answered { peer, measurement: Some(measured), .. } = &event
                && self.answering.contains(peer)
            {
                machine.estimator.handle_measurement(*peer, measured);
            }
        }
    }

    /// Adds what was counted so far, and what is wrong at the moment, to the state.
    pub fn look(&mut self, health: &mut Health) {
        self.counts.ended = self.running.has_ended();
        health.sounding = serde_json::to_value(&self.counts).ok();
        if self.counts.ended {
            health.trouble.push("sounding: the thread that sends has ended".into());
        } else {
            let wrong = self.warnings.iter().chain(&self.counts.notice);
            health.trouble.extend(wrong.map(|why| format!("sounding: {why}")));
        }
    }

    /// Stops the thread; returns the error that had ended it, if any.
    pub fn stop(self) -> Option<Error> {
        let running = Arc::into_inner(self.running)?;
        running.stop().map_or_else(Some, |(.., error)| error)
    }
}

impl SoundingCounts {
    fn note(&mut self, news: &News) {
        let event = match news {
            News::Started(granted) => return self.granted = Some(granted.clone()),
            News::Notice(Notice::GoesOut) => return self.notice = None,
            News::Notice(notice) => return self.notice = Some(notice.to_string()),
            News::Event(event) => event,
        };
        match event {
            Event::Answered { .. } => self.answered += 1,
            Event::Unanswered { .. } => self.unanswered += 1,
            Event::Asked { .. } => self.asked += 1,
            Event::Missed { slots, .. } => self.missed_slots += u64::from(*slots),
            Event::TurnBegan { .. } => self.turns += 1,
            Event::Yielded { .. } => self.yielded += 1,
            Event::Absent(peer) => self.absent.push(peer.to_string()),
            Event::Joined(peer) => {
                let peer = peer.to_string();
                self.absent.retain(|absent| *absent != peer);
            }
            _ => {}
        }
    }
}

/// Hands the card's measurements to the answers.
struct Measures(Arc<Running>, Measuring);

impl Tap for Measures {
    fn own(&mut self, _: Instant, next: &Next<'_>) {
        self.1.note(next, &self.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_that_go_out_again_are_no_trouble() {
        let mut counts = SoundingCounts::default();
        counts.note(&News::Notice(Notice::NothingGoesOut { frames: 32 }));
        assert!(counts.notice.as_ref().unwrap().starts_with("32 frames were handed to the kernel"));
        counts.note(&News::Notice(Notice::GoesOut));
        assert_eq!(counts.notice, None);
    }
}
