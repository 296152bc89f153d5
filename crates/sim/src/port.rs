//! What one robot has of a room: its card as a [`CsiSource`] and an [`Injector`], its monitor interface, and its odometry, a
//! sensor that gives true motion with a rate, noise, scale and heading errors, gaps and late poses.

use super::air::{Air, Flight, Listening, Passed, Reception};
use super::crystal::FTM_TICKS_PER_US;
use super::faults::{Faults, FaultyCard};
use super::maths::{rad, turned};
use super::motion;
use super::radio::Radio;
use super::random::{Purpose, Stream};
use super::receiver::{Arrival, Ax210, Receiver};
use super::refused;
use super::scene::{Card, Driver, Odometry, Scene};
use super::sounder::FrameRole;
use super::world::World;
use csi_formats::feitcsi;
use csi5300::internal::{FrameReceiver, HeardFrame, lock};
use csi5300::motion::odometry::{NextPose, OdometrySource, SourceCounts};
use csi5300::motion::pose::Pose;
use csi5300::source::other_card::Translator;
use csi5300::source::{CsiSource, Error, Injector, Loss, Next, Origin, Stamps};
use csi5300::time::{Instant, Span};
use driver_iface::bfee::{MAX_BODY, NOISE_UNKNOWN_DBM, Repr, Wsr};
use driver_iface::record::{LENGTH_FIELD, Record, Tail, code, written};
use driver_iface::{Mac, mpdu};
use nalgebra::Vector3;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

/// Longest frame that mac80211 takes (IEEE80211_MAX_FRAME_LEN), without FCS.
const MAX_FRAME: usize = 2_352 - mpdu::FCS;

/// A robot's card, driver and listening socket.
///
/// It behaves like the kernel's socket: records wait in a queue of [`Faults::queue_records`]. If it is full, new
/// records are lost until it has been emptied (the kernel's overrun latch), and one [`Loss::Overrun`] has their number.
/// Records of the stock driver come in pairs, 0xC1 before 0xBB, which count as one.
#[derive(Debug)]
pub struct Port {
    air: Arc<Mutex<Air>>,
    robot: usize,
    receiver: Receiver,
    faults: Faults,
    faulty: Option<FaultyCard>,
    driver: Driver,
    ax210: Option<FeitCsi>,
    /// The firmware's loads that the receiver knows.
    loads: u64,
    queue: VecDeque<Reception>,
    /// Records lost since the overrun; not 0 while the latch holds.
    overrun: Option<u64>,
    /// The 0xBB after a 0xC1 that was handed out.
    follows: Option<Reception>,
    body: Vec<u8>,
    /// MAC and number of the last frame that had them; the driver keeps them for frames too short to.
    last: (Mac, u32),
    handed_out: u64,
    now: Instant,
}

/// An AX210 under FeitCSI.
#[derive(Debug)]
struct FeitCsi {
    card: Ax210,
    translator: Translator,
    /// FeitCSI's record, and its translation into the layouts of a 5300.
    written: Vec<u8>,
    records: Vec<u8>,
    /// The reader wants the untranslated record.
    as_written: bool,
}

/// The item read; a record's body is in the port.
enum Read {
    Record(Stamps, u8, FrameRole, usize),
    None(Next<'static>),
}

impl Port {
    pub(super) fn new(air: Arc<Mutex<Air>>, robot: usize) -> Self {
        let mut guard = lock(&air);
        guard.node(robot).listening = Listening::All;
        let world = Arc::clone(guard.world());
        drop(guard);
        let scene = world.scene();
        let state = &scene.robot[robot];
        Self {
            air,
            robot,
            receiver: Receiver::new(*scene.radio_of(state), scene.seed, robot),
            faults: state.faults.clone(),
            faulty: FaultyCard::new(&state.faults.card),
            driver: scene.driver,
            ax210: (scene.card == Card::Ax210).then(|| FeitCsi::of(scene)).flatten(),
            loads: 0,
            queue: VecDeque::new(),
            overrun: None,
            follows: None,
            body: vec![0; MAX_BODY],
            last: (Mac::ZERO, 0),
            handed_out: 0,
            now: Instant::ZERO,
        }
    }

    /// From now on only records of exchanges in which this robot takes part are made, as for a logger that keeps only
    /// those. The driver counts the others too, so they are gaps in `bfee_count`, as in the WSR data set.
    pub fn own_only(&mut self) {
        lock(&self.air).node(self.robot).listening = Listening::Own;
    }

    /// The same for the card's usual logger: for an AX210 the body of a record is FeitCSI's.
    pub(crate) fn for_logger(&mut self) {
        self.own_only();
        self.ax210.iter_mut().for_each(|card| card.as_written = true);
    }

    /// [`CsiSource::receive`], with the record's role for this robot and the number of its sender, which its bytes do
    /// not contain.
    ///
    /// # Errors
    /// As [`CsiSource::receive`].
    pub(crate) fn receive_with_role(&mut self, now: Instant) -> Result<(FrameRole, usize, Next<'_>), Error> {
        let next = self.read(now)?;
        Ok(match next {
            Read::Record(stamps, code, role, from) => {
                (role, from, Next::Record(stamps, Record { code, body: &self.body }))
            }
            Read::None(next) => (FrameRole::Unknown, 0, next),
        })
    }

    /// Drops the records up to `now`, like the kernel without a listener: they are counted, not computed.
    pub(crate) fn let_go(&mut self, now: Instant) {
        let shared = Arc::clone(&self.air);
        let mut air = lock(&shared);
        self.now = self.now.max(now);
        let now_ns = self.now.as_us().saturating_mul(1_000);
        air.advance(now_ns);
        let mut gone = self.queue.len() + usize::from(self.follows.take().is_some());
        (self.queue, self.overrun) = (VecDeque::new(), None);
        let node = air.node(self.robot);
        while node.arrivals.front().is_some_and(|r| r.arrival_ns <= now_ns) {
            node.arrivals.pop_front();
            gone += 1;
        }
        node.injected.unheard += gone as u64;
    }

    /// The last record that was handed out reached nobody.
    pub(crate) fn take_back(&mut self) {
        let mut air = lock(&self.air);
        let injected = &mut air.node(self.robot).injected;
        injected.delivered -= 1;
        injected.unheard += 1;
    }

    /// The next record, its body left in `self.body`.
    fn read(&mut self, now: Instant) -> Result<Read, Error> {
        let shared = Arc::clone(&self.air);
        let mut air = lock(&shared);
        self.now = self.now.max(now);
        let now_ns = self.now.as_us().saturating_mul(1_000);
        air.advance(now_ns);
        if self.faults.stalled_until(self.now).is_some() {
            return Ok(Read::None(Next::Pending));
        }
        self.fill(&mut air, now_ns);
        loop {
            let second = self.follows.is_some();
            let Some(reception) = self.follows.take().or_else(|| self.queue.pop_front()) else { break };
            let is_pair = self.ax210.as_ref().map_or(self.driver == Driver::Stock, |card| !card.as_written);
            let first_of_two = is_pair && !second;
            let written = match &self.ax210 {
                Some(_) if second => self.body_of_feitcsi(1),
                Some(_) => self.write_feitcsi(&mut air, &reception).then(|| self.body_of_feitcsi(0)).flatten(),
                None if first_of_two => Some(self.write_mpdu(&reception)),
                None => self.write_bfee(&mut air, &reception)?.then_some(code::BFEE),
            };
            // A frame without a bfee has only its 0xC1, and is counted where that is found.
            let Some(code) = written else { continue };
            let stamps = self.stamps(&air, &reception);
            self.handed_out += 1;
            air.node(self.robot).injected.delivered += u64::from(!first_of_two);
            let read = Read::Record(stamps, code, reception.role, reception.flight.from);
            self.follows = first_of_two.then_some(reception);
            return Ok(read);
        }
        if let Some(dropped) = self.overrun.take() {
            return Ok(Read::None(Next::Lost(Loss::Overrun { dropped: Some(dropped) })));
        }
        let over = now_ns >= air.end_ns() && air.node(self.robot).arrivals.is_empty();
        Ok(Read::None(if over { Next::End(Tail::Clean) } else { Next::Pending }))
    }

    /// Moves arrived records into the socket's queue; those that do not fit are lost.
    fn fill(&mut self, air: &mut Air, now_ns: i64) {
        let node = air.node(self.robot);
        while node.arrivals.front().is_some_and(|r| r.arrival_ns <= now_ns) {
            let Some(reception) = node.arrivals.pop_front() else { break };
            if let Some(dropped) = &mut self.overrun {
                *dropped += 1;
                node.injected.overrun_records += 1;
            } else if self.queue.len() >= self.faults.queue_records {
                self.overrun = Some(1);
                node.injected.overruns += 1;
                node.injected.overrun_records += 1;
            } else {
                self.queue.push_back(reception);
            }
        }
    }

    /// Writes the 0xC1 of a reception: the frame and its FCS.
    fn write_mpdu(&mut self, reception: &Reception) -> u8 {
        self.body.clear();
        self.body.extend_from_slice(reception.flight.bytes.with_fcs());
        code::MPDU
    }

    /// Draws new phases between chains if the firmware was loaded since the last record.
    fn load(&mut self, air: &mut Air) {
        let loads = air.node(self.robot).injected.restarts;
        for _ in std::mem::replace(&mut self.loads, loads)..loads {
            self.receiver.load();
        }
    }

    fn arrival(&self, reception: &Reception) -> Arrival {
        let flight = &reception.flight;
        Arrival { from: flight.from, to: self.robot, t_ns: reception.t_ns, instant_ns: flight.instant_ns }
    }

    /// Measures a reception with an AX210 and writes FeitCSI's record. False if there is nothing to measure.
    fn write_feitcsi(&mut self, air: &mut Air, reception: &Reception) -> bool {
        self.load(air);
        let (world, flight) = (Arc::clone(air.world()), &reception.flight);
        let arrival = self.arrival(reception);
        let Some(feitcsi) = &mut self.ax210 else { return false };
        let Some(measured) = self.receiver.measure_ax210(&world, arrival, &feitcsi.card) else {
            air.node(self.robot).injected.unmeasured += 1;
            return false;
        };
        air.node(self.robot).injected.saturated += u64::from(measured.saturated);
        let crystal = world.scene().robot[self.robot].crystal;
        // Both clocks start when the robot is switched on.
        let since_us = crystal.clock_us(reception.t_ns).wrapping_sub(reception.clock_us);
        let repr = feitcsi::Repr {
            ftm: crystal.ftm(reception.t_ns).wrapping_sub(since_us.wrapping_mul(FTM_TICKS_PER_US)) as u32,
            host_us: u64::try_from(host_us(air, self.robot, reception.arrival_ns)).unwrap_or(0),
            n_rx: measured.n_rx,
            n_tx: 1,
            kind: feitcsi.card.kind,
            width_mhz: feitcsi.card.width_mhz,
            mcs: flight.mcs,
            rssi_dbm: measured.rssi_dbm,
            sender: world.mac(flight.from).0,
            clock_us: reception.clock_us as u32,
        };
        feitcsi.written.clear();
        repr.emit(&measured.csi, &mut feitcsi.written);
        true
    }

    /// A record of FeitCSI's last frame, its body in `self.body`: untranslated, or one of the two records of the
    /// translation, clock and bfee.
    fn body_of_feitcsi(&mut self, place: usize) -> Option<u8> {
        let feitcsi = self.ax210.as_mut()?;
        self.body.clear();
        if feitcsi.as_written {
            self.body.extend_from_slice(&feitcsi.written);
            return Some(code::BFEE);
        }
        if place == 0 {
            feitcsi.records.clear();
            let (read, len) = feitcsi::front(&feitcsi.written);
            feitcsi.translator.take(&read, 0, len, &mut feitcsi.records);
        }
        let message = written(&feitcsi.records).nth(place)?.get(LENGTH_FIELD..)?;
        let Record { code, body } = Record::from_message(message)?;
        self.body.extend_from_slice(body);
        Some(code)
    }

    /// Measures a reception and writes its 0xBB. False if there is nothing to measure.
    fn write_bfee(&mut self, air: &mut Air, reception: &Reception) -> Result<bool, Error> {
        let world = Arc::clone(air.world());
        let flight = &reception.flight;
        let arrival = self.arrival(reception);
        self.load(air);
        let Some(mut measured) = self.receiver.measure(&world, arrival) else {
            air.node(self.robot).injected.unmeasured += 1;
            return Ok(false);
        };
        let scene = world.scene();
        let mut repr = Repr {
            timestamp_low: reception.clock_us as u32,
            bfee_count: reception.bfee_count,
            reserved: 0,
            n_rx: measured.n_rx,
            n_tx: 1,
            rssi: measured.rssi,
            noise_dbm: NOISE_UNKNOWN_DBM,
            agc: measured.agc,
            antenna_sel: measured.antenna_sel,
            rate_n_flags: Radio { mcs: flight.mcs, ..*scene.radio_of(&scene.robot[flight.from]) }
                .rate_n_flags(scene.bandwidth_mhz == 40),
            wsr: (self.driver == Driver::Wsr).then(|| self.wsr(host_us(air, self.robot, reception.arrival_ns), flight)),
        };
        if let Some(card) = &mut self.faulty
            && !card.change(&mut repr, &mut measured.csi, reception.t_ns as f64 * 1e-9)
        {
            air.node(self.robot).injected.driver_dropped += 1;
            return Ok(false);
        }
        self.body.resize(repr.body_len(), 0);
        let csi = measured.csi.get(..repr.samples()).unwrap_or(&[]);
        repr.emit(csi, &mut self.body).map_err(|error| refused(format!("cannot write a simulated record: {error}")))?;
        if let Some(card) = &self.faulty {
            self.body.truncate(card.kept(repr.body_len()));
        }
        air.node(self.robot).injected.saturated += u64::from(measured.saturated);
        Ok(true)
    }

    /// The WSR driver's fields: host time, and MAC and number of the last frame long enough to have them.
    fn wsr(&mut self, host_us: i64, flight: &Flight) -> Wsr {
        let mpdu = flight.bytes.mpdu();
        if let Some((mpdu, number)) = mpdu.and_then(|mpdu| Some((mpdu, mpdu.sounding_counter()?))) {
            self.last = (if number == 0 { Mac::ZERO } else { mpdu.addr3 }, number);
        }
        Wsr::at(host_us, self.last.0, Some(self.last.1))
    }

    fn stamps(&self, air: &Air, reception: &Reception) -> Stamps {
        Stamps {
            at: ceil_us(reception.arrival_ns),
            host_us: Some(host_us(air, self.robot, reception.arrival_ns)),
            origin: Origin::Live { number: self.handed_out },
        }
    }
}

impl FeitCsi {
    fn of(scene: &Scene) -> Option<Self> {
        let (written, records) = (Vec::new(), Vec::new());
        Some(Self { card: Ax210::of(scene)?, translator: Translator::default(), written, records, as_written: false })
    }
}

impl CsiSource for Port {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        Ok(self.receive_with_role(now)?.2)
    }

    fn next_at(&self) -> Option<Instant> {
        let mut air = lock(&self.air);
        let arrival_ns = air.node(self.robot).arrivals.front().map(|r| r.arrival_ns);
        let at = if self.follows.is_some() || !self.queue.is_empty() || self.overrun.is_some() {
            self.now
        } else if let Some(arrival_ns) = arrival_ns {
            ceil_us(arrival_ns)
        } else {
            ceil_us(air.next_ns().unwrap_or(air.end_ns()))
        };
        let at = at.max(self.now);
        Some(self.faults.stalled_until(at).unwrap_or(at))
    }
}

impl Injector for Port {
    fn inject(&mut self, now: Instant, frame: &[u8]) -> Result<(), Error> {
        inject(&self.air, self.robot, now, frame, None)
    }
}

/// A robot's host hands a frame to its card.
pub(super) fn inject(air: &Mutex<Air>, robot: usize, now: Instant, frame: &[u8], mcs: Option<u8>) -> Result<(), Error> {
    if !(mpdu::HEADER..=MAX_FRAME).contains(&frame.len()) {
        let len = frame.len();
        let least = mpdu::HEADER;
        return Err(refused(format!("a frame of {len} bytes was not sent: {least} to {MAX_FRAME} are possible")));
    }
    let mut air = lock(air);
    let now_ns = now.as_us().saturating_mul(1_000);
    air.advance(now_ns);
    air.transmit(robot, now_ns, frame, mcs);
    Ok(())
}

/// A host's wall clock at a true time, microseconds since the Unix epoch.
pub(super) fn host_us(air: &Air, robot: usize, t_ns: i64) -> i64 {
    let scene = air.world().scene();
    let clock = scene.robot[robot].host_clock;
    let ahead_ns = clock.offset_s * 1e9 + t_ns as f64 * clock.drift_ppm * 1e-6;
    scene.start_unix_s * 1_000_000 + (t_ns + ahead_ns.round() as i64).div_euclid(1_000)
}

/// The first whole microsecond at or after a time.
pub(super) fn ceil_us(t_ns: i64) -> Instant {
    Instant::from_us(t_ns.saturating_add(999).div_euclid(1_000))
}

/// A robot's monitor interface in a room, the counterpart of `csi5300_live::monitor::Monitor`.
///
/// It hears everything up to the room's time, which cards, odometries, injectors and [`super::Room::advance`] move
/// forward. A sender of the room's own on the same robot continues beside it.
#[derive(Debug)]
pub struct Interface {
    air: Arc<Mutex<Air>>,
    robot: usize,
    current: Option<Arc<Flight>>,
    went_out: u64,
    retried: u64,
}

/// A frame that passed the interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seen<'a> {
    /// The frame, without FCS.
    pub frame: &'a [u8],
    /// Modulation and coding scheme, 0 to 7.
    pub mcs: u8,
    /// How long ago it ended on air.
    pub age: Span,
    /// This robot sent it: the card reports it as sent.
    pub own: bool,
    /// How often the card sent it again.
    pub retries: u8,
}

impl Interface {
    /// `None` if it is taken.
    pub(super) fn new(air: Arc<Mutex<Air>>, robot: usize) -> Option<Self> {
        let mut guard = lock(&air);
        let passed = &mut guard.node(robot).passed;
        if passed.is_some() {
            return None;
        }
        *passed = Some(VecDeque::new());
        drop(guard);
        Some(Self { air, robot, current: None, went_out: 0, retried: 0 })
    }

    /// The next frame that passed, own ones too; `None` if there is none yet.
    pub fn see(&mut self) -> Option<Seen<'_>> {
        let mut air = lock(&self.air);
        let Passed { flight, own } = air.node(self.robot).passed.as_mut()?.pop_front()?;
        let age = Span::from_us((air.now_ns() - flight.end_ns).max(0) / 1_000);
        drop(air);
        self.went_out += u64::from(own);
        self.retried += u64::from(own && flight.retries > 0);
        let flight = self.current.insert(flight);
        Some(Seen { frame: flight.bytes.without_fcs(), mcs: flight.mcs, age, own, retries: flight.retries })
    }

    /// As [`Injector::inject`], at a modulation and coding scheme of one stream, 0 to 7, other than the scene's.
    ///
    /// # Errors
    /// [`Error::Backend`] for another scheme, and for a frame too short or too long.
    pub fn inject_at(&mut self, now: Instant, frame: &[u8], mcs: u8) -> Result<(), Error> {
        if mcs > 7 {
            return Err(refused(format!("MCS {mcs}: cards in a room send one stream, MCS 0 to 7")));
        }
        inject(&self.air, self.robot, now, frame, Some(mcs))
    }

    /// Own frames that the card reports as sent more than once.
    #[must_use]
    pub fn retried(&self) -> u64 {
        self.retried
    }

    /// Frames that passed and were lost because they were not fetched.
    #[must_use]
    pub fn lost(&self) -> u64 {
        lock(&self.air).node(self.robot).passed_lost
    }
}

impl Drop for Interface {
    fn drop(&mut self) {
        lock(&self.air).node(self.robot).passed = None;
    }
}

impl Injector for Interface {
    fn inject(&mut self, now: Instant, frame: &[u8]) -> Result<(), Error> {
        inject(&self.air, self.robot, now, frame, None)
    }
}

impl FrameReceiver for Interface {
    fn hear(&mut self) -> Result<Option<HeardFrame<'_>>, Error> {
        loop {
            match self.see().map(|seen| (seen.own, seen.age)) {
                None => return Ok(None),
                Some((true, _)) => {}
                Some((false, age)) => {
                    let frame = self.current.as_ref().map(|flight| flight.bytes.without_fcs());
                    return Ok(frame.map(|frame| HeardFrame { frame, age }));
                }
            }
        }
    }

    fn sent_for_certain(&self) -> Option<u64> {
        Some(self.went_out)
    }

    fn failed_for_certain(&self) -> u64 {
        0
    }
}

/// A robot's odometry in the scene's frame: at the start the sensor has no error.
#[derive(Debug)]
pub struct Odometer {
    air: Arc<Mutex<Air>>,
    world: Arc<World>,
    robot: usize,
    sensor: Odometry,
    stream: Stream,
    /// Number of the next measurement.
    next: i64,
    /// Late poses with their arrival times.
    late: Vec<(i64, Pose)>,
    before: motion::Pose,
    believed_m: Vector3<f64>,
    heading_error_rad: f64,
    /// Of a followed robot: the frame of the last pose.
    frame: u32,
}

impl Odometer {
    pub(super) fn new(air: Arc<Mutex<Air>>, robot: usize) -> Self {
        let world = Arc::clone(lock(&air).world());
        let scene = world.scene();
        let before = world.pose(robot, 0.0);
        Self {
            sensor: scene.robot[robot].odometry,
            stream: Stream::new(scene.seed, robot, Purpose::Odometry),
            robot,
            next: 0,
            late: Vec::new(),
            before,
            believed_m: before.position_m,
            heading_error_rad: 0.0,
            frame: 0,
            air,
            world,
        }
    }

    /// True time of measurement number `n`; `None` after the end of the scene.
    fn measured_ns(&self, n: i64) -> Option<i64> {
        let t_s = n as f64 / self.sensor.rate_hz;
        (t_s <= self.world.scene().duration_s).then_some((t_s * 1e9).round() as i64)
    }

    fn due_ns(&self) -> Option<i64> {
        let late = self.late.iter().map(|late| late.0).min();
        [late, self.measured_ns(self.next)].into_iter().flatten().min()
    }

    /// True if a followed robot's poses are in another frame from `due_ns` on: dead reckoning restarts.
    fn begins_frame(&mut self, due_ns: i64) -> bool {
        let t_s = due_ns as f64 * 1e-9;
        let Some(frame) = self.world.frame(self.robot, t_s).filter(|frame| *frame != self.frame) else { return false };
        let first = std::mem::replace(&mut self.frame, frame) == 0;
        self.before = self.world.pose(self.robot, t_s);
        (self.believed_m, self.heading_error_rad) = (self.before.position_m, 0.0);
        self.late.clear();
        !first
    }

    /// The pose that is due at `due_ns`, if it is not dropped or late.
    fn take(&mut self, due_ns: i64) -> Option<Pose> {
        if let Some(at) = self.late.iter().position(|late| late.0 == due_ns) {
            return Some(self.late.swap_remove(at).1);
        }
        if self.world.frame(self.robot, due_ns as f64 * 1e-9) == Some(0) {
            // Its place is not known yet.
            self.next += 1;
            return None;
        }
        let pose = self.measure(due_ns);
        self.next += 1;
        let mut air = lock(&self.air);
        let injected = &mut air.node(self.robot).injected;
        if self.stream.happens(self.sensor.drop) {
            injected.poses_dropped += 1;
            None
        } else if self.stream.happens(self.sensor.late) {
            injected.poses_late += 1;
            self.late.push((due_ns + (self.sensor.late_s * 1e9).round() as i64, pose));
            None
        } else {
            Some(pose)
        }
    }

    /// One step of dead reckoning: the true step, scaled, and turned by the heading error.
    fn measure(&mut self, t_ns: i64) -> Pose {
        let sensor = self.sensor;
        let truth = self.world.pose(self.robot, t_ns as f64 * 1e-9);
        if sensor.scale == 1.0 && sensor.heading_drift_deg_s == 0.0 && sensor.heading_walk_deg == 0.0 {
            self.believed_m = truth.position_m;
        } else {
            let step_s = if self.next == 0 { 0.0 } else { 1.0 / sensor.rate_hz };
            let driven = (truth.position_m - self.before.position_m) * sensor.scale;
            self.believed_m += turned(driven, self.heading_error_rad);
            self.heading_error_rad += rad(sensor.heading_drift_deg_s) * step_s;
            self.heading_error_rad += self.stream.spread(rad(sensor.heading_walk_deg) * step_s.sqrt());
        }
        self.before = truth;
        let mut noise = || self.stream.spread(sensor.noise_m);
        let position_m = self.believed_m + Vector3::new(noise(), noise(), noise());
        let yaw_rad = truth.yaw_rad + self.heading_error_rad + self.stream.spread(rad(sensor.noise_deg));
        let t_s = host_us(&lock(&self.air), self.robot, t_ns) as f64 * 1e-6;
        Pose { t_s, position_m, heading_rad: Some(yaw_rad) }
    }
}

impl OdometrySource for Odometer {
    fn receive(&mut self, now: Instant) -> Result<NextPose, Error> {
        let now_ns = now.as_us().saturating_mul(1_000);
        while let Some(due_ns) = self.due_ns() {
            if due_ns > now_ns {
                return Ok(NextPose::Pending);
            }
            if self.begins_frame(due_ns) {
                return Ok(NextPose::NewFrame);
            }
            if let Some(pose) = self.take(due_ns) {
                lock(&self.air).node(self.robot).injected.poses += 1;
                return Ok(NextPose::Pose(pose));
            }
        }
        Ok(NextPose::End)
    }

    fn next_at(&self) -> Option<Instant> {
        self.due_ns().map(|ns| Instant::from_us(ns.saturating_add(999).div_euclid(1_000)))
    }

    fn trouble(&self) -> Option<String> {
        lock(&self.air).follower(self.robot)?.trouble()
    }

    fn counted(&self) -> Option<SourceCounts> {
        Some(lock(&self.air).follower(self.robot)?.counted())
    }
}
