//! A room run to its end in memory: its robots' logs and true paths.

use super::faults::Injected;
use super::port::Port;
use super::room::Room;
use super::room_error::{CardError, RoomError};
use super::scene::Card;
use csi_formats::feitcsi;
use csi5300::motion::pose::{Pose, Trajectory};
use csi5300::source::other_card::Translated;
use csi5300::source::replay::Replay;
use csi5300::source::{CsiSource, Error, Next};
use csi5300::time::Instant;
use driver_iface::Mac;
use driver_iface::record::Record;
use nalgebra::Vector3;
use std::io::Read;

/// Rows per second of true paths, as motion capture gives them.
const TRUTH_HZ: f64 = 200.0;

/// A room that was run to its end.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Simulation {
    /// Its robots, in the scene's order.
    pub robots: Vec<SimulatedRobot>,
}

/// The log of a robot, and its true path.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct SimulatedRobot {
    /// Its name in the scene.
    pub name: String,
    /// Its card's MAC address.
    pub mac: Mac,
    /// The bytes of its log (a `.dat`, of an AX210 FeitCSI's): the records of exchanges in which it took part.
    pub log: Vec<u8>,
    /// Whole records in it.
    pub records: u64,
    /// The true path of its antenna A, 200 times a second on its host's clock, metres in the scene's frame; `None` if
    /// the scene is too short for two poses.
    pub true_path: Option<Trajectory>,
    /// Its account of faults.
    pub injected: Injected,
}

impl Simulation {
    /// The robot of this name.
    #[must_use]
    pub fn robot(&self, name: &str) -> Option<&SimulatedRobot> {
        self.robots.iter().find(|robot| robot.name == name)
    }
}

impl SimulatedRobot {
    /// Its log as a source of records.
    #[must_use]
    pub fn replay(&self) -> Replay<Box<dyn Read + Send + '_>> {
        let log: &[u8] = &self.log;
        let is_feitcsi = feitcsi::is_log(log);
        let log: Box<dyn Read + Send + '_> = if is_feitcsi { Box::new(Translated::new(log)) } else { Box::new(log) };
        Replay::new(log, format!("the log of {}", self.name))
    }

    /// Where its antenna A was at the start, metres in the scene's frame.
    #[must_use]
    pub fn start_m(&self) -> Option<Vector3<f64>> {
        self.true_path.as_ref()?.poses().first().map(|pose| pose.position_m)
    }
}

impl Room {
    /// Runs the room to its end and keeps all logs in memory, each with the records of its robot's own exchanges.
    ///
    /// # Errors
    /// [`RoomError::CardTaken`] if somebody reads one of the cards already; [`RoomError::Source`] as a card's
    /// [`CsiSource::receive`].
    pub fn run(self) -> Result<Simulation, RoomError> {
        self.run_while(|_| true)
    }

    /// [`Room::run`] while `go_on` returns true; it gets the scene's time after each event.
    ///
    /// # Errors
    /// As [`Room::run`], and [`RoomError::Stopped`].
    pub fn run_while(mut self, mut go_on: impl FnMut(Instant) -> bool) -> Result<Simulation, RoomError> {
        let count = self.scene().robot.len();
        let mut cards: Vec<Port> = (0..count).filter_map(|robot| self.card(robot)).collect();
        if cards.len() != count {
            return Err(RoomError::CardTaken);
        }
        cards.iter_mut().for_each(Port::for_logger);
        let is_framed = self.scene().card == Card::Intel5300;
        let mut logs = vec![(Vec::new(), 0); count];
        let mut now = Instant::ZERO;
        loop {
            let mut next: Option<Instant> = None;
            for (card, (log, records)) in cards.iter_mut().zip(&mut logs) {
                if !drain(card, now, (log, is_framed), records)? {
                    next = [next, card.next_at()].into_iter().flatten().min();
                }
            }
            let Some(at) = next else { break };
            now = now.max(at);
            if !go_on(now) {
                return Err(RoomError::Stopped { at_s: now.as_s() });
            }
        }
        let injected = self.injected();
        let robots = logs.into_iter().zip(injected).enumerate().map(|(robot, ((log, records), injected))| {
            let name = self.scene().robot.get(robot).map_or_else(String::new, |state| state.name.clone());
            let mac = self.mac(robot).unwrap_or(Mac::ZERO);
            SimulatedRobot { name, mac, log, records, true_path: self.true_path(robot, TRUTH_HZ), injected }
        });
        Ok(Simulation { robots: robots.collect() })
    }

    /// The true path of a robot's antenna A, start to end, `rate_hz` times a second on its host's clock, metres in the
    /// scene's frame; `None` without such a robot, or if the scene is too short for two poses.
    #[must_use]
    pub fn true_path(&self, robot: usize, rate_hz: f64) -> Option<Trajectory> {
        let rows = (self.scene().duration_s * rate_hz).floor() as usize;
        let pose = |row: usize| {
            let t_s = row as f64 / rate_hz;
            let (position_m, host_us) = (self.antenna(robot, t_s)?, self.host_us(robot, t_s)?);
            let heading_rad = self.pose(robot, t_s).map(|pose| pose.yaw_rad);
            Some(Pose { t_s: host_us as f64 * 1e-6, position_m, heading_rad })
        };
        Trajectory::new((0..=rows).filter_map(pose).collect()).ok()
    }
}

/// Logs all records that a card has at `now`; true at its end.
fn drain(
    card: &mut Port,
    now: Instant,
    (log, is_framed): (&mut Vec<u8>, bool),
    records: &mut u64,
) -> Result<bool, RoomError> {
    loop {
        match card.receive(now)? {
            Next::Record(_, record) => {
                append(log, &record, is_framed)?;
                *records += 1;
            }
            Next::Lost(_) => {}
            Next::Pending => return Ok(false),
            Next::End(_) => return Ok(true),
        }
    }
}

/// Appends a record as its logger does; FeitCSI's has no length before it.
pub(super) fn append(log: &mut Vec<u8>, record: &Record<'_>, is_framed: bool) -> Result<(), Error> {
    if !is_framed {
        log.extend_from_slice(record.body);
        return Ok(());
    }
    let from = log.len();
    log.resize(from + record.emit_len(), 0);
    let place = log.get_mut(from..).unwrap_or_default();
    let written = record.emit(place).map_err(|error| CardError::Frame(error).into());
    written.map(|_| ())
}

#[cfg(test)]
mod tests {
    use crate::{Room, RoomError, Scene};

    #[test]
    fn a_run_ends_when_it_is_told_to() {
        let scene = Scene::parse(
            "duration_s = 36000.0\nsounding.rate_hz = 100\n\
             [[robot]]\nname = \"rx\"\nmotion.circle = { radius_m = 0.3, duration_s = 36000.0 }\n\
             [[robot]]\nname = \"tx\"\nposition_m = [3.0, 1.0, 0.5]\n",
        );
        let room = Room::new(&scene.unwrap()).unwrap();
        let ended = room.run_while(|now| now.as_s() < 0.5);
        assert!(matches!(ended, Err(RoomError::Stopped { at_s }) if (0.5..0.6).contains(&at_s)), "{ended:?}");
    }
}
