//! Live bearings: products of forward and backward frames while robots sound, with no second network.
//!
//! The initiator's card reports the backward frame; what the responder's card reported of the forward frame comes in a
//! later answer ([`driver_iface::sounding::native::Measurement`]). Both go into the library's live estimator, as a node's
//! records do.
//!
//! [`Beside`] computes them beside a session: a bearing may take seconds, while the session must read its driver and watch
//! its stop and its time.

use super::Running;
use crate::wait::Monotonic;
use csi5300::exchange::tdma::Key;
use csi5300::internal::{FrameHeard, Proof, Prover};
use csi5300::nalgebra::Vector3;
use csi5300::pipeline::Options;
use csi5300::pipeline::live::{LiveEstimator, LivePeer, LiveSettings, Track};
use csi5300::source::survey::{Identity, Survey};
use csi5300::source::{Error, Next};
use csi5300::time::{Instant, Span};
use driver_iface::Mac;
use driver_iface::bfee::{Antenna, Bfee};
use driver_iface::sounding::native::Measurement;
use std::io::PipeReader;
use std::os::fd::{AsFd, BorrowedFd};
use std::thread::JoinHandle;

/// One antenna's CSI of a forward frame, to be sent to its initiator; `None` without that antenna or a number.
#[must_use]
pub fn measurement(bfee: &Bfee<'_>, identity: &Identity, antenna: Antenna) -> Option<Measurement> {
    let heard = FrameHeard::of(bfee, antenna, identity.frame_count?, None, 0)?;
    Some(Measurement {
        number: heard.number,
        timestamp_low: heard.timestamp_low,
        rx_antenna: antenna as u8,
        antenna_sel: bfee.antenna_sel(),
        rssi: bfee.rssi(),
        noise_dbm: bfee.noise_dbm(),
        agc: bfee.agc(),
        iq: heard.iq(),
    })
}

/// Hands the card's measurements of the peers' frames to the answers.
pub struct Measuring {
    antenna: Antenna,
    peers: Vec<Mac>,
    survey: Survey,
    prover: Prover,
}

impl Measuring {
    /// Of this antenna; with a key, frames without its tag are not measured.
    #[must_use]
    pub fn new(antenna: Antenna, peers: Vec<Mac>, key: Option<Key>) -> Self {
        let (survey, prover) = (Survey::with_known(peers.iter().copied()), Prover::new(key));
        Self { antenna, peers, survey, prover }
    }

    /// Takes what the card gave. False for a record without sender and number, which no answer can carry.
    pub fn note(&mut self, next: &Next<'_>, running: &Running) -> bool {
        let proof = self.prover.note(next);
        let Some((bfee, identity)) = self.survey.note(next) else { return true };
        if proof != Proof::Wrong
            && self.peers.contains(&identity.mac)
            && let Some(measurement) = measurement(&bfee, &identity, self.antenna)
        {
            running.carry(identity.mac, measurement);
        }
        identity.frame_count.is_some() || bfee.wsr().is_some()
    }
}

/// The links of one initiator to `peers` that stand still: an estimator that takes the card's records and the peers' measurements,
/// and gives bearings of its [`LiveEstimator::links`].
#[must_use]
pub fn products(peers: &[Mac], options: Options) -> LiveEstimator {
    let still = || Track::still(Vector3::zeros(), 0.0);
    let peer = |mac: &Mac| LivePeer { name: mac.to_string(), mac: *mac, track: still(), yaw_rad: 0.0 };
    let peers = peers.iter().map(peer).collect();
    // It gives bearings on request, without a schedule, and has no peer's log that shows this robot's MAC.
    let (own, now) = (Mac::ZERO, Instant::ZERO);
    let settings = LiveSettings::new(options.channel.wavelength_m());
    LiveEstimator::new(own, Track::default(), peers, settings, options, now)
}

/// Repeated work, one piece at a time, in a separate thread.
#[derive(Debug)]
pub struct Beside<T> {
    every: Span,
    next_at: Instant,
    /// The piece that is running, and what is readable, at its end, once it is done.
    under_way: Option<(JoinHandle<T>, PipeReader)>,
}

impl<T: Send + 'static> Beside<T> {
    /// Due at `first_at`, then `every` span after the start of the last piece, or as soon as that is done.
    #[must_use]
    pub fn new(first_at: Instant, every: Span) -> Self {
        Self { every, next_at: first_at, under_way: None }
    }

    /// True if a piece is due and none is running.
    #[must_use]
    pub fn is_due(&self, now: Instant) -> bool {
        self.under_way.is_none() && self.next_at <= now
    }

    /// Starts a piece of `work`, unless one is running.
    ///
    /// # Errors
    /// If thread or pipe cannot be created.
    pub fn begin(&mut self, now: Instant, work: impl FnOnce() -> T + Send + 'static) -> Result<(), Error> {
        if self.under_way.is_some() {
            return Ok(());
        }
        self.next_at = now + self.every;
        let what = "cannot start a thread beside the one that listens";
        let (done, doing) = std::io::pipe().map_err(Error::io(what))?;
        let work = move || {
            // Closed when the work ends, also by a panic.
            let _doing = doing;
            work()
        };
        let thread = std::thread::Builder::new().name("csi5300 beside".into()).spawn(work).map_err(Error::io(what))?;
        self.under_way = Some((thread, done));
        Ok(())
    }

    /// The result of a finished piece, once.
    ///
    /// # Panics
    /// If the work did.
    pub fn take(&mut self) -> Option<T> {
        self.under_way.take_if(|(thread, _)| thread.is_finished()).map(|(thread, _)| joined(thread))
    }

    /// Waits for the running piece, unless `stop` is readable: then it ends with the process.
    ///
    /// # Errors
    /// If it cannot be waited for.
    ///
    /// # Panics
    /// If the work did.
    pub fn last(&mut self, clock: Monotonic, stop: BorrowedFd<'_>) -> Result<Option<T>, Error> {
        let Some((thread, done)) = self.under_way.take() else { return Ok(None) };
        loop {
            match clock.wait([done.as_fd(), stop], None)? {
                [true, _] => return Ok(Some(joined(thread))),
                [false, true] => return Ok(None),
                [false, false] => {}
            }
        }
    }
}

fn joined<T>(thread: JoinHandle<T>) -> T {
    thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::channel;

    const SECOND: Span = Span::from_ms(1_000);

    fn at(s: i64) -> Instant {
        Instant::from_us(s * 1_000_000)
    }

    #[test]
    fn nobody_waits_for_work_that_takes_longer_than_its_turn() {
        let (go, gate) = channel();
        let mut beside = Beside::new(at(0), SECOND);
        assert!(beside.is_due(at(0)));
        beside.begin(at(0), move || gate.recv().unwrap_or(0)).unwrap();
        for s in 0..10 {
            assert_eq!((beside.is_due(at(s)), beside.take()), (false, None), "a piece is under way");
        }
        beside.begin(at(10), || 9).unwrap();
        go.send(7).unwrap();
        let (stop, _open) = std::io::pipe().unwrap();
        assert_eq!(beside.last(Monotonic::new(), stop.as_fd()).unwrap(), Some(7), "the one that was begun first");
    }

    #[test]
    fn pieces_follow_each_other_at_their_times() {
        let mut beside = Beside::new(at(5), SECOND);
        assert!(!beside.is_due(at(4)));
        beside.begin(at(5), || 1).unwrap();
        let made = loop {
            match beside.take() {
                Some(made) => break made,
                None => std::thread::yield_now(),
            }
        };
        assert_eq!((made, beside.take()), (1, None));
        assert!(!beside.is_due(at(5)) && beside.is_due(at(6)));
    }

    #[test]
    fn a_stop_does_not_wait_for_running_work() {
        let (_held, gate) = channel::<u8>();
        let mut beside = Beside::new(at(0), SECOND);
        beside.begin(at(0), move || gate.recv().is_ok()).unwrap();
        let (stop, asked) = std::io::pipe().unwrap();
        drop(asked);
        assert_eq!(beside.last(Monotonic::new(), stop.as_fd()).unwrap(), None);
        let mut idle = Beside::<u8>::new(at(0), SECOND);
        assert_eq!(idle.last(Monotonic::new(), stop.as_fd()).unwrap(), None, "nothing was begun");
    }

    #[test]
    #[should_panic(expected = "a defect")]
    fn a_panic_of_the_work_is_not_lost() {
        let mut beside = Beside::<()>::new(at(0), SECOND);
        beside.begin(at(0), || panic!("a defect")).unwrap();
        let (stop, _open) = std::io::pipe().unwrap();
        let _ = beside.last(Monotonic::new(), stop.as_fd());
    }
}
