//! Threads for card and wheels: their data are read and stamped at once, however long an estimate takes. Both threads
//! end with the source that reads from them.

use crate::{lock, refused};
use csi5300::motion::odometry::{NextPose, OdometrySource, SourceCounts};
use csi5300::source::{CsiSource, Error, Loss, Next, Stamps};
use csi5300::time::{Instant, Span};
use csi5300_live::wait::Monotonic;
use driver_iface::record::{Record, Tail};
use std::io::{PipeReader, PipeWriter};
use std::os::fd::AsFd;
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

/// Limit of waiting records; then the thread waits too, and overruns in the kernel are counted there.
const RECORDS: usize = 32_768;
/// Limit of waiting poses.
const POSES: usize = 4_096;
/// The reader is woken after this many records at the latest.
const TELL: usize = 256;
/// Interval of reads of a source of poses.
const LOOK: Span = Span::from_ms(500);

/// Starts a thread; `what` says that it cannot be started.
pub(crate) fn spawn(
    name: &str,
    what: &'static str,
    work: impl FnOnce() + Send + 'static,
) -> Result<JoinHandle<()>, Error> {
    let thread = std::thread::Builder::new().name(name.into()).spawn(work);
    thread.map_err(Error::io(what))
}

/// An item of a source that outlives the source's buffer.
pub(crate) enum Item {
    Record(Stamps, u8, Box<[u8]>),
    Lost(Loss),
    End(Tail),
}

impl Item {
    /// None of [`Next::Pending`].
    pub fn of(next: &Next<'_>) -> Option<Self> {
        match next {
            Next::Record(stamps, record) => Some(Self::Record(*stamps, record.code, record.body.into())),
            Next::Lost(loss) => Some(Self::Lost(loss.clone())),
            Next::End(tail) => Some(Self::End(*tail)),
            Next::Pending => None,
        }
    }

    /// As the source gave it.
    pub fn next(&self) -> Next<'_> {
        match self {
            Self::Record(stamps, code, body) => Next::Record(*stamps, Record { code: *code, body }),
            Self::Lost(loss) => Next::Lost(loss.clone()),
            Self::End(tail) => Next::End(*tail),
        }
    }
}

/// A card that is read on a separate thread.
pub struct CardThread {
    items: Receiver<Result<Item, Error>>,
    /// Its end is that of the thread.
    _open: PipeWriter,
    /// The last item.
    item: Option<Item>,
}

impl CardThread {
    /// Reads `card` from now on, and waits on its file descriptor. Calls `wake` after records came, and at the end.
    ///
    /// # Errors
    /// If the thread cannot be started.
    pub fn start<S: CsiSource + AsFd + Send + 'static>(
        card: S,
        wake: impl Fn() + Send + 'static,
    ) -> Result<Self, Error> {
        let what = "cannot start the thread that listens to the card";
        let (shut, open) = std::io::pipe().map_err(Error::io(what))?;
        let (give, items) = sync_channel(RECORDS);
        let read = move || {
            if let Err(error) = listen(card, &give, &shut, &wake) {
                let _ = give.send(Err(error));
            }
            wake();
        };
        spawn("csi5300 card", what, read)?;
        Ok(Self { items, _open: open, item: None })
    }
}

/// Hands over the card's items until the other end is shut.
fn listen<S: CsiSource + AsFd>(
    mut card: S,
    give: &SyncSender<Result<Item, Error>>,
    shut: &PipeReader,
    wake: &impl Fn(),
) -> Result<(), Error> {
    let clock = Monotonic::new();
    let mut untold = 0;
    loop {
        let item = Item::of(&card.receive(clock.now())?);
        let (pending, ends) = (item.is_none(), matches!(item, Some(Item::End(_))));
        untold += usize::from(!pending);
        if item.is_some_and(|item| give.send(Ok(item)).is_err()) || ends {
            return Ok(());
        }
        if untold > 0 && (pending || untold >= TELL) {
            wake();
            untold = 0;
        }
        if pending {
            let [_, is_shut] = clock.wait([card.as_fd(), shut.as_fd()], card.next_at())?;
            if is_shut {
                return Ok(());
            }
        }
    }
}

impl CsiSource for CardThread {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        match self.items.try_recv() {
            Ok(item) => {
                let item = self.item.insert(item?);
                if let Item::Record(stamps, ..) = item {
                    stamps.at = now;
                }
                Ok(item.next())
            }
            Err(TryRecvError::Empty) => Ok(Next::Pending),
            Err(TryRecvError::Disconnected) => Err(refused("the thread that listens to the card has ended")),
        }
    }

    fn next_at(&self) -> Option<Instant> {
        None
    }
}

/// Poses that are read on a separate thread.
pub struct PoseThread {
    poses: Receiver<Result<NextPose, Error>>,
    told: Arc<Mutex<Told>>,
}

/// Counts of a source of poses.
#[derive(Default)]
struct Told {
    trouble: Option<String>,
    counted: Option<SourceCounts>,
    /// When its counts were last read.
    at: Option<Instant>,
}

impl Told {
    fn ask(&mut self, source: &impl OdometrySource, now: Instant) {
        self.trouble = source.trouble();
        if self.at.is_none_or(|at| now - at >= LOOK) {
            (self.counted, self.at) = (source.counted(), Some(now));
        }
    }
}

impl PoseThread {
    /// Takes the poses of `source` from now on.
    ///
    /// # Errors
    /// If the thread cannot be started.
    pub fn start(mut source: impl OdometrySource + Send + 'static) -> Result<Self, Error> {
        let (give, poses) = sync_channel(POSES);
        let shared = Arc::new(Mutex::new(Told::default()));
        let told = Arc::downgrade(&shared);
        let take = move || {
            let clock = Monotonic::new();
            loop {
                let now = clock.now();
                match source.receive(now) {
                    Ok(NextPose::Pending) => {
                        // Nobody reads any more.
                        let Some(told) = told.upgrade() else { return };
                        lock(&told).ask(&source, now);
                        drop(told);
                        clock.sleep_until(source.next_at().map_or(now + LOOK, |at| at.min(now + LOOK)));
                    }
                    last @ (Ok(NextPose::End) | Err(_)) => return drop(give.send(last)),
                    next => {
                        if give.send(next).is_err() {
                            return;
                        }
                    }
                }
            }
        };
        spawn("csi5300 poses", "cannot start the thread of the odometry", take)?;
        Ok(Self { poses, told: shared })
    }
}

impl OdometrySource for PoseThread {
    fn receive(&mut self, _: Instant) -> Result<NextPose, Error> {
        match self.poses.try_recv() {
            Ok(next) => next,
            Err(TryRecvError::Empty) => Ok(NextPose::Pending),
            Err(TryRecvError::Disconnected) => Err(refused("the thread of the odometry has ended")),
        }
    }

    fn next_at(&self) -> Option<Instant> {
        None
    }

    fn trouble(&self) -> Option<String> {
        lock(&self.told).trouble.clone()
    }

    fn counted(&self) -> Option<SourceCounts> {
        lock(&self.told).counted.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::motion::pose::Pose;
    use std::io::{Read, Write};
    use std::os::fd::BorrowedFd;
    use std::os::unix::net::UnixStream;
    use std::sync::atomic::{AtomicI64, Ordering};

    /// A card that repeats the bytes of a socket, stamped with `WALL_US`.
    struct Wire(UnixStream, Vec<u8>);

    static WALL_US: AtomicI64 = AtomicI64::new(0);

    impl CsiSource for Wire {
        fn receive(&mut self, at: Instant) -> Result<Next<'_>, Error> {
            self.1.resize(1, 0);
            match self.0.read(&mut self.1) {
                Ok(1) => {
                    let stamps = Stamps { at, host_us: Some(WALL_US.load(Ordering::SeqCst)), ..Stamps::default() };
                    Ok(Next::Record(stamps, Record { code: 0xBB, body: &self.1 }))
                }
                Ok(_) => Err(Error::Backend("unplugged".into())),
                Err(_) => Ok(Next::Pending),
            }
        }

        fn next_at(&self) -> Option<Instant> {
            None
        }
    }

    impl AsFd for Wire {
        fn as_fd(&self) -> BorrowedFd<'_> {
            self.0.as_fd()
        }
    }

    #[test]
    fn a_record_has_the_time_at_which_it_came_however_late_it_is_taken() {
        let (mut card, wire) = UnixStream::pair().unwrap();
        wire.set_nonblocking(true).unwrap();
        let (wake, woken) = std::sync::mpsc::channel();
        let mut thread = CardThread::start(Wire(wire, Vec::new()), move || _ = wake.send(())).unwrap();
        let wait = || woken.recv().unwrap();
        for us in 1..=3 {
            WALL_US.store(us, Ordering::SeqCst);
            card.write_all(&[us as u8]).unwrap();
            wait();
            // An estimate takes its time.
            WALL_US.store(1_000_000, Ordering::SeqCst);
            let Next::Record(stamps, record) = thread.receive(Instant::from_us(7)).unwrap() else { panic!("a record") };
            assert_eq!((stamps.at.as_us(), stamps.host_us, record.body), (7, Some(us), &[us as u8][..]));
            assert!(matches!(thread.receive(Instant::ZERO), Ok(Next::Pending)));
        }
        drop(card);
        wait();
        let failed = std::iter::from_fn(|| match thread.receive(Instant::ZERO) {
            Ok(_) => Some(None),
            Err(error) => Some(Some(error)),
        });
        assert!(failed.flatten().next().unwrap().to_string().contains("unplugged"));
    }

    #[test]
    fn the_card_is_let_go_when_nobody_reads() {
        let (mut card, wire) = UnixStream::pair().unwrap();
        wire.set_nonblocking(true).unwrap();
        drop(CardThread::start(Wire(wire, Vec::new()), || ()).unwrap());
        // The thread's end of the wire is closed: this ends.
        assert_eq!(card.read(&mut [0; 1]).unwrap(), 0);
    }

    /// Two poses and their end.
    struct Two(u8);

    impl OdometrySource for Two {
        fn receive(&mut self, _: Instant) -> Result<NextPose, Error> {
            self.0 += 1;
            let position_m = nalgebra::Vector3::zeros();
            let pose = |t_s| NextPose::Pose(Pose { t_s, position_m, heading_rad: None });
            Ok(if self.0 <= 2 { pose(f64::from(self.0)) } else { NextPose::End })
        }

        fn next_at(&self) -> Option<Instant> {
            None
        }
    }

    #[test]
    fn poses_come_through_in_their_order() {
        let mut thread = PoseThread::start(Two(0)).unwrap();
        let mut times = Vec::new();
        loop {
            match thread.receive(Instant::ZERO).unwrap() {
                NextPose::Pose(pose) => times.push(pose.t_s),
                NextPose::Pending => std::thread::yield_now(),
                NextPose::End => break,
                NextPose::NewFrame => panic!("no frame"),
            }
        }
        assert_eq!(times, [1.0, 2.0]);
    }
}
