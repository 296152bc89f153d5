//! The room: one card and one odometry for each robot, and their accounts.

use super::air::{Air, MakeStation};
use super::faults::Injected;
use super::followed::Follower;
use super::interface::Interface;
use super::motion::Pose;
use super::odometer::Odometer;
use super::port::{Port, ceil_us, host_us, lock};
use super::room_error::RoomError;
use super::scene::Scene;
use super::sounder::sounder;
use super::station::Station;
use super::world::World;
use super::world_check::check;
use csi5300::motion::odometry::OdometrySource;
use csi5300::time::Instant;
use driver_iface::Mac;
use std::sync::{Arc, Mutex};

/// A room full of robots.
///
/// Time is virtual: it follows the times at which cards and odometries are called. One thread may drive all robots, or
/// each robot has its own.
#[derive(Debug)]
pub struct Room {
    air: Arc<Mutex<Air>>,
    world: Arc<World>,
    taken: Vec<bool>,
}

impl Room {
    /// A room whose robots sound each other as the scene states, by the TDMA state machine of live cards. Without
    /// `sounding` in the scene it is [`Room::quiet`].
    ///
    /// # Errors
    /// [`RoomError::Scene`] when a value of the scene makes no sense, a trajectory file cannot be read, the sounding does
    /// not fit, or a robot is inside a wall; [`RoomError::Sounding`] when there is no sender for the scene's sounding.
    pub fn new(scene: &Scene) -> Result<Self, RoomError> {
        let world = Self::checked(scene)?;
        // Errors occur for the first robot already.
        sounder(&world, 0, 0, Instant::ZERO)?;
        let stations = Arc::clone(&world);
        let make = move |robot, restarts, now| {
            let sounder = sounder(&stations, robot, restarts, now).ok().flatten()?;
            Some(Box::new(sounder) as Box<dyn Station>)
        };
        Ok(Self::in_world(world, Box::new(make)))
    }

    /// A room in which robots send only what is injected through their [`Port`]s (and what a driver with an `ack_len`
    /// answers). The scene's `sounding` has no effect.
    ///
    /// # Errors
    /// [`RoomError::Scene`] as [`Room::new`].
    pub fn quiet(scene: &Scene) -> Result<Self, RoomError> {
        Self::with_stations(scene, Box::new(|_, _, _| None))
    }

    /// A room with given senders; `make` makes one for each robot, and again after each restart.
    ///
    /// # Errors
    /// [`RoomError::Scene`] as [`Room::new`].
    pub(crate) fn with_stations(scene: &Scene, make: MakeStation) -> Result<Self, RoomError> {
        Ok(Self::in_world(Self::checked(scene)?, make))
    }

    fn checked(scene: &Scene) -> Result<Arc<World>, RoomError> {
        let world = World::new(scene)?;
        check(&world)?;
        Ok(Arc::new(world))
    }

    fn in_world(world: Arc<World>, make: MakeStation) -> Self {
        let air = Arc::new(Mutex::new(Air::new(Arc::clone(&world), make)));
        Self { air, taken: vec![false; world.scene().robot.len()], world }
    }

    /// The scene.
    #[must_use]
    pub fn scene(&self) -> &Scene {
        self.world.scene()
    }

    /// The number of the robot of this name.
    #[must_use]
    pub fn number(&self, name: &str) -> Option<usize> {
        self.scene().robot.iter().position(|robot| robot.name == name)
    }

    /// A robot's card: source and injector. Each is handed out once; `None` the second time, or without such a robot.
    ///
    /// Records are made from then on.
    pub fn card(&mut self, robot: usize) -> Option<Port> {
        let taken = self.taken.get_mut(robot).filter(|taken| !**taken)?;
        *taken = true;
        Some(Port::new(Arc::clone(&self.air), robot))
    }

    /// A robot's monitor interface: frames injected and heard, for a sender outside of the room. `None` without such a
    /// robot, or while it is taken. Frames are kept from then on.
    pub fn interface(&mut self, robot: usize) -> Option<Interface> {
        (robot < self.taken.len()).then(|| Interface::new(Arc::clone(&self.air), robot)).flatten()
    }

    /// Lets time pass, for rooms in which nobody reads records.
    pub fn advance(&mut self, now: Instant) {
        lock(&self.air).advance(now.as_us().saturating_mul(1_000));
    }

    /// The time of the next event, or the room's end; `None` after that.
    #[must_use]
    pub fn next_at(&self) -> Option<Instant> {
        let air = lock(&self.air);
        let at_ns = air.next_ns().or((air.now_ns() < air.end_ns()).then(|| air.end_ns()));
        at_ns.map(ceil_us)
    }

    /// A robot's odometry; `None` without such a robot. Two of the same robot give the same poses, and count twice.
    #[must_use]
    pub fn odometry(&self, robot: usize) -> Option<Odometer> {
        (robot < self.taken.len()).then(|| Odometer::new(Arc::clone(&self.air), robot))
    }

    /// Lets a robot follow `source`, a tenth of a second behind. Its motion in the scene must be `followed`. The
    /// robot's odometry gives its place in the room, so poses and records agree.
    ///
    /// # Errors
    /// [`RoomError::NotFollowed`] when there is no such robot or it has another motion, [`RoomError::FollowsAlready`].
    pub fn follow(&mut self, robot: usize, source: Box<dyn OdometrySource + Send>) -> Result<(), RoomError> {
        let name = || self.scene().robot.get(robot).map_or("?", |robot| robot.name.as_str()).to_owned();
        let way = self.world.way(robot).ok_or_else(|| RoomError::NotFollowed { robot: name() })?;
        if lock(&self.air).follow(Follower::new(robot, Arc::clone(way), source)) {
            Ok(())
        } else {
            Err(RoomError::FollowsAlready { robot: name() })
        }
    }

    /// A robot's MAC address, if there is such a robot.
    #[must_use]
    pub fn mac(&self, robot: usize) -> Option<Mac> {
        (robot < self.taken.len()).then(|| self.world.mac(robot))
    }

    /// A robot's true pose at true time `t_s` of the scene, if there is such a robot.
    #[must_use]
    pub fn pose(&self, robot: usize, t_s: f64) -> Option<Pose> {
        (robot < self.taken.len()).then(|| self.world.pose(robot, t_s))
    }

    /// The place of a robot's antenna A at true time `t_s`, if there is such a robot.
    #[must_use]
    pub fn antenna(&self, robot: usize, t_s: f64) -> Option<nalgebra::Vector3<f64>> {
        (robot < self.taken.len()).then(|| self.world.antenna(robot, 0, t_s)).flatten()
    }

    /// A robot's wall clock at true time `t_s`, microseconds since the Unix epoch, if there is such a robot.
    #[must_use]
    pub fn host_us(&self, robot: usize, t_s: f64) -> Option<i64> {
        (robot < self.taken.len()).then(|| host_us(&lock(&self.air), robot, (t_s * 1e9).round() as i64))
    }

    pub(super) fn air(&self) -> std::sync::MutexGuard<'_, Air> {
        lock(&self.air)
    }

    /// The account of each robot so far.
    #[must_use]
    pub fn injected(&self) -> Vec<Injected> {
        lock(&self.air).injected().collect()
    }
}
