//! Robots of a simulated room in this process.

use super::{Card, Poses};
use crate::NodeError;
use crate::config::{Odometry, Room as Asked};
use csi5300::source::Error;
use csi5300_sim::Room;
use driver_iface::Mac;
use std::collections::BTreeMap;

/// The room whose robots' cards and odometry are used.
pub(super) struct SharedRoom(Room);

/// There is no such robot.
pub(super) fn absent(robot: &str) -> Error {
    NodeError::NotInRoom { robot: robot.to_owned() }.into()
}

impl SharedRoom {
    /// The room of a scene that has this robot.
    pub(super) fn open(asked: &Asked) -> Result<Self, Error> {
        let (room, robot) = (Room::new(&asked.load_scene()?)?, &asked.robot);
        if room.number(robot).is_none() {
            let known = room.scene().robot.iter().map(|robot| robot.name.clone()).collect();
            return Err(NodeError::NotInScene { robot: robot.clone(), known }.into());
        }
        Ok(Self(room))
    }

    /// Robots of the room go where their sources say, which `open` opens.
    pub(super) fn follow(
        &mut self,
        sources: &BTreeMap<String, Odometry>,
        mut open: impl FnMut(&str, &Odometry) -> Result<Poses, Error>,
    ) -> Result<(), Error> {
        for (name, odometry) in sources {
            let source = open(name, odometry)?;
            self.0.follow(self.number(name)?, source)?;
        }
        Ok(())
    }

    /// This robot's card, and its MAC.
    pub(super) fn own_card(&mut self, robot: &str) -> Result<(Card, Option<Mac>), Error> {
        let number = self.number(robot)?;
        let card = self.0.card(number).ok_or(NodeError::CardTaken)?;
        Ok((Box::new(card), self.0.mac(number)))
    }

    /// A peer's card, and its MAC.
    pub(super) fn peer_card(&mut self, robot: &str) -> Result<(Card, Mac), Error> {
        let absent = || NodeError::NotInRoomOrTwice { robot: robot.to_owned() };
        let number = self.0.number(robot).ok_or_else(absent)?;
        let (mac, card) = (self.0.mac(number), self.0.card(number));
        let (mac, card) = mac.zip(card).ok_or_else(absent)?;
        Ok((Box::new(card), mac))
    }

    /// A robot's MAC.
    pub(super) fn mac(&self, robot: &str) -> Option<Mac> {
        self.0.mac(self.0.number(robot)?)
    }

    /// A robot's odometry.
    pub(super) fn poses(&self, robot: &str) -> Result<Poses, Error> {
        let odometry = self.0.odometry(self.number(robot)?).ok_or_else(|| absent(robot))?;
        Ok(Box::new(odometry))
    }

    fn number(&self, robot: &str) -> Result<usize, Error> {
        self.0.number(robot).ok_or_else(|| absent(robot))
    }
}
