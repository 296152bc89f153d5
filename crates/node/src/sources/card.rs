//! The card of this machine.

use super::Opened;
use crate::config::Card;
use crate::threads::CardThread;
use csi5300::source::Error;
use csi5300_live::netlink::{Netlink, Options};

/// Listens to the driver, on a thread of its own.
pub(super) fn open(card: &Card, wall_us: fn() -> Option<i64>) -> Result<Opened, Error> {
    let (connector_index, allow_user_sender) = (card.connector_index, card.allow_user_sender);
    let options = Options::default()
        .with_connector_index(connector_index)
        .with_allow_user_sender(allow_user_sender)
        .with_wall_us(wall_us);
    let card = CardThread::start(Netlink::open(&options)?)?;
    // A card's records come when they come.
    Ok(Opened { wake: Some(card.wake()?), card: Box::new(card), mac: None, speed: 1.0 })
}
