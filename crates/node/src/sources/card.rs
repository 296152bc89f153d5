//! The card of this machine.

use super::Opened;
use crate::config::{Card, Feitcsi, Stock as Asked};
use crate::threads::CardThread;
use csi5300::source::Error;
use csi5300_live::feitcsi::{FeitCsi, Frames};
use csi5300_live::netlink::{self, Netlink};
use csi5300_live::stock::{self, Stock};
use driver_iface::Mac;

/// Listens to the driver, on a thread of its own.
pub(super) fn open(card: &Card, wall_us: fn() -> Option<i64>) -> Result<Opened, Error> {
    let (connector_index, allow_user_sender) = (card.connector_index, card.allow_user_sender);
    let options = netlink::Options::default()
        .with_connector_index(connector_index)
        .with_allow_user_sender(allow_user_sender)
        .with_wall_us(wall_us);
    opened(CardThread::start(Netlink::open(&options)?)?)
}

/// The same by the eBPF program, under the kernel's own driver. `own` is this robot's MAC, and `frames` says whether their
/// tags are checked.
pub(super) fn open_stock(
    asked: &Asked,
    own: Option<Mac>,
    frames: bool,
    wall_us: fn() -> Option<i64>,
) -> Result<Opened, Error> {
    let records = driver_iface::stock::Options::default().with_frames(asked.frames || frames);
    let options = stock::Options::default().with_records(records).with_own(own).with_wall_us(wall_us);
    opened(CardThread::start(Stock::open(&options)?)?)
}

/// What FeitCSI writes. A pipe stays open, whoever writes to it and whenever.
pub(super) fn open_feitcsi(asked: &Feitcsi, wall_us: fn() -> Option<i64>) -> Result<Opened, Error> {
    let frames = match asked {
        Feitcsi::Udp(command) => Frames::ask(command, wall_us)?,
        Feitcsi::Pipe(pipe) => {
            let io = |source| Error::Io { what: format!("cannot read {}", pipe.display()), source };
            let pipe = std::fs::File::options().read(true).write(true).open(pipe).map_err(io)?;
            Frames::read(pipe.into(), wall_us)
        }
    };
    opened(CardThread::start(FeitCsi::new(frames))?)
}

/// A card's records come when they come.
fn opened(card: CardThread) -> Result<Opened, Error> {
    Ok(Opened { wake: Some(card.wake()?), card: Box::new(card), mac: None, speed: 1.0 })
}
