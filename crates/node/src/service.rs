//! The service: one thread of tokio that waits for records, poses, times, signals and readers of the state.

use super::adapters::{self, Adapter, Robot, Said, Start};
use super::config::{Config, Log};
use super::health::{Health, Load, Looks};
use super::machine::Machine;
use super::sounder::Sounder;
use super::sources::Sources;
use super::team::{Ranges, Solver};
use csi5300::pipeline::live::PeerState;
use csi5300::source::Error;
use csi5300::source::recorder::{LogFiles, Rotation};
use csi5300::time::{Instant, Span, WallWatch};
use csi5300_live::wait::{Monotonic, is_ignored, processor_s, wall_us};
use driver_iface::side_file::Layout;
use nix::sys::signal::SigSet;
use sd_notify::NotifyState;
use std::cell::OnceCell;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::Notify;

/// Interval of states.
const LOOK: Span = Span::from_ms(500);
/// How long records may wait while no report is due, so that one wake-up takes several.
const TOGETHER: Duration = Duration::from_millis(3);
/// The longest wait between reads of the sources.
const LONGEST_WAIT: Span = Span::from_ms(500);

/// How a service ended.
#[derive(Debug)]
pub struct Ended {
    /// The state at the end, with what is in the log.
    pub health: Health,
    /// Bearings that were published.
    pub bearings: u64,
    /// A signal ended it.
    pub signalled: bool,
    /// The error that ended it, if any.
    pub error: Option<Error>,
}

/// Runs a robot until its records end or a signal comes. The log is whole and the last bearings are out when it returns.
///
/// # Errors
/// If it cannot be started. What fails later is in [`Ended::error`].
pub fn run(config: &Config, name: String) -> Result<Ended, Error> {
    // A log at the size limit (`ulimit -f`) acts as a full disk: the write fails with EFBIG, and the signal is blocked.
    let sizes = SigSet::from_iter([nix::sys::signal::Signal::SIGXFSZ]).thread_block();
    sizes.map_err(Error::io("cannot catch signals"))?;
    let wake = Arc::new(Notify::new());
    let ranges = Ranges::default();
    let start =
        Start { config, name: &name, wake: Arc::clone(&wake), ranges: ranges.clone(), topics: OnceCell::default() };
    let mut adapters = adapters::make(&start)?;
    let sources = Sources::open(config, &mut adapters, &wake)?;
    let team = Solver::start(config, &name, ranges)?;
    let peers = sources.peers.iter().map(|peer| (peer.peer.name.clone(), peer.peer.mac)).collect();
    let robot = Robot { name: name.clone(), own: sources.own, peers };
    adapters.iter_mut().try_for_each(|adapter| adapter.meet(&robot))?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let runtime = runtime.map_err(Error::io("cannot start tokio"))?;
    // Adapters are dropped outside of the runtime, where they may wait for their own, and after the machine is finished.
    runtime.block_on(Service::serve(config, name, (sources, team), (&mut adapters, &wake)))
}

/// Real time, and the sources' own, which runs `speed` times as fast.
#[derive(Clone, Copy)]
struct Clock {
    real: Monotonic,
    speed: f64,
}

impl Clock {
    fn now(&self) -> Instant {
        Instant::from_us((self.real.now().as_us() as f64 * self.speed) as i64)
    }

    /// Real time until `at`.
    fn until(&self, at: Instant) -> Duration {
        Duration::from_secs_f64(((at - self.now()).as_s() / self.speed).clamp(0.0, LONGEST_WAIT.as_s()))
    }
}

struct Service<'a> {
    adapters: &'a mut [Box<dyn Adapter>],
    wake: &'a Notify,
    clock: Clock,
    machine: Machine,
    sounder: Option<Sounder>,
    /// Where the robots are, if a graph of the team is configured.
    team: Option<Solver>,
    looks: Looks,
    load: Load,
    /// Real time and processor time of the last look.
    looked: (Instant, f64),
    bearings: u64,
    signalled: bool,
    /// Of a live card; what is replayed or simulated has clocks of its own.
    wall: Option<WallWatch>,
}

impl<'a> Service<'a> {
    async fn serve(
        config: &Config,
        name: String,
        (sources, team): (Sources, Option<Solver>),
        (adapters, wake): (&'a mut [Box<dyn Adapter>], &'a Notify),
    ) -> Result<Ended, Error> {
        // Signals first: from here on they end the robot in order.
        let hangup = Some(SignalKind::hangup()).filter(|_| !is_ignored(nix::sys::signal::Signal::SIGHUP));
        let mut signals = [SignalKind::terminate(), SignalKind::interrupt()]
            .into_iter()
            .chain(hangup)
            .map(signal)
            .collect::<std::io::Result<Vec<Signal>>>()
            .map_err(Error::io("cannot catch signals"))?;
        let clock = Clock { real: Monotonic::new(), speed: sources.speed };
        let (own, is_live) = (sources.own, sources.is_live);
        let answering = sources.peers.iter().filter(|peer| !peer.is_heard_only).map(|peer| peer.peer.mac).collect();
        let log = config.log.as_ref().map(log_files).transpose()?;
        let mut machine = Machine::new(sources, log, config.estimator_settings(), config.options(), clock.now())?;
        adapters.iter_mut().try_for_each(|adapter| adapter.attach(&mut machine))?;
        // Last: from here on it sends.
        let sounder = Sounder::start(config, own, answering, clock.real)?;
        sounder.iter().for_each(|sounder| sounder.attach(&mut machine));
        let mut service = Self {
            adapters,
            wake,
            clock,
            machine,
            sounder,
            team,
            looks: Looks::new(name),
            load: Load::default(),
            looked: (clock.real.now(), processor_s()),
            bearings: 0,
            signalled: false,
            wall: is_live.then(WallWatch::default),
        };
        // Without a service manager nobody listens, which is no error.
        let _ = sd_notify::notify(&[NotifyState::Ready]);
        let error = service.work(&mut signals).await.err();
        let _ = sd_notify::notify(&[NotifyState::Stopping]);
        Ok(service.finish(error))
    }

    /// Works until the records end or a signal comes.
    async fn work(&mut self, signals: &mut [Signal]) -> Result<(), Error> {
        let watchdog = sd_notify::watchdog_enabled().map(|limit| limit / 2);
        let mut look_at = self.clock.real.now();
        let mut alive_at = look_at;
        loop {
            if let Some(sounder) = &mut self.sounder {
                sounder.take(&mut self.machine, self.clock.now());
            }
            let more = self.machine.take(self.clock.now())?;
            self.watch_wall();
            self.estimate();
            let real = self.clock.real.now();
            if real >= look_at {
                self.look();
                look_at = real + LOOK;
            }
            if let Some(every) = watchdog.filter(|_| real >= alive_at) {
                let _ = sd_notify::notify(&[NotifyState::Watchdog]);
                alive_at = real + Span::from_s(every.as_secs_f64());
            }
            if self.machine.is_done(self.clock.now()) {
                return Ok(());
            }
            let gather = if more { Duration::ZERO } else { self.gather() };
            if !gather.is_zero() {
                tokio::time::sleep(gather).await;
            }
            let until = self.machine.next_at().map_or(LONGEST_WAIT.as_s(), |at| self.clock.until(at).as_secs_f64());
            let wait = if more {
                Duration::ZERO
            } else {
                Duration::from_secs_f64(until.min((look_at - self.clock.real.now()).as_s().max(0.0)))
            };
            tokio::select! {
                biased;
                () = any(signals) => {
                    self.signalled = true;
                    return Ok(());
                }
                () = self.wake.notified() => {}
                () = tokio::time::sleep(wait) => if !wait.is_zero() { self.note_lateness() },
            }
        }
    }

    /// How long records may wait: until a report is due, which then waits for its pair.
    fn gather(&self) -> Duration {
        self.machine.estimator.next_due().map_or(Duration::ZERO, |due| self.clock.until(due).min(TOGETHER))
    }

    /// After all waiting items were taken, so that none comes later with a time of the old clock.
    fn watch_wall(&mut self) {
        if let (Some(watch), Some(wall_us)) = (&mut self.wall, wall_us())
            && watch.was_set(wall_us, self.clock.real.now().as_us())
        {
            self.machine.handle_clock_set();
        }
    }

    /// Makes at most one estimate, and publishes it.
    fn estimate(&mut self) {
        let before = self.clock.real.now();
        let Some((peer, report)) = self.machine.poll_report(self.clock.now()) else { return };
        self.load.estimate_ms = (self.clock.real.now() - before).as_s() * 1e3;
        self.load.longest_estimate_ms = self.load.longest_estimate_ms.max(self.load.estimate_ms);
        self.bearings += u64::from(report.state == PeerState::Bearing);
        let since = |at: Instant| (self.clock.now() - at).as_s() / self.clock.speed * 1e3;
        let latency_ms = report.heard_at.map(since);
        let (took_ms, bearing) = (Some(self.load.estimate_ms), self.machine.estimator.bearing(peer));
        let said = Said { peer, report: &report, bearing, took_ms, latency_ms };
        self.adapters.iter_mut().for_each(|adapter| adapter.report(&said));
        self.team.iter_mut().for_each(|team| team.note(peer, &report, &self.machine));
        self.looks.note(peer, report);
    }

    fn note_lateness(&mut self) {
        if let Some(at) = self.machine.next_at() {
            let late_ms = (self.clock.now() - at).as_s() / self.clock.speed * 1e3;
            self.load.late_ms = self.load.late_ms.max(late_ms);
        }
    }

    fn look(&mut self) -> Health {
        let (real, used_s) = (self.clock.real.now(), processor_s());
        let seconds = (real - self.looked.0).as_s();
        if seconds > 0.0 {
            self.load.cpu_percent = 100.0 * (used_s - self.looked.1) / seconds;
        }
        self.looked = (real, used_s);
        self.load.memory_mib = resident_mib().unwrap_or(0.0);
        let mut health = self.looks.look(&self.machine, self.clock.now(), self.load);
        self.sounder.iter_mut().for_each(|sounder| sounder.look(&mut health));
        health.team = self.team.as_mut().map(|team| team.look().clone());
        self.adapters.iter_mut().for_each(|adapter| adapter.look(&mut health));
        self.load.late_ms = 0.0;
        self.adapters.iter_mut().for_each(|adapter| adapter.tell(&health, &self.machine));
        health
    }

    fn finish(mut self, error: Option<Error>) -> Ended {
        // One time for both: what the state counts is what the log has.
        let now = self.clock.now();
        self.machine.drain(now);
        let mut health = self.look();
        let (reports, estimator, log) = self.machine.finish(now);
        // The machine held the sender too, for its measurements.
        let mut error = self.sounder.take().and_then(Sounder::stop).or(error);
        for (peer, report) in reports.iter().enumerate() {
            let said = Said { peer, report, bearing: estimator.bearing(peer), took_ms: None, latency_ms: None };
            self.adapters.iter_mut().for_each(|adapter| adapter.report(&said));
        }
        self.adapters.iter_mut().for_each(|adapter| adapter.finish(&mut health));
        for (report, peer) in reports.into_iter().zip(&mut health.peers) {
            self.bearings += u64::from(report.state == PeerState::Bearing);
            peer.report = Some(report);
        }
        match log {
            Ok(totals) => health.log = totals,
            Err(died) => drop(error.get_or_insert(died)),
        }
        Ended { health, bearings: self.bearings, signalled: self.signalled, error }
    }
}

/// Until one of the signals comes.
async fn any(signals: &mut [Signal]) {
    std::future::poll_fn(|context| {
        let mut ready = signals.iter_mut().map(|signal| signal.poll_recv(context).is_ready());
        if ready.any(|ready| ready) { std::task::Poll::Ready(()) } else { std::task::Poll::Pending }
    })
    .await;
}

/// The files of a log of everything.
fn log_files(log: &Log) -> Result<LogFiles, Error> {
    let rotation = Rotation { bytes: log.rotate_mib.map(|mib| mib.get().saturating_mul(1 << 20)), every: None };
    let layout = if log.checksums { Layout::Checked } else { Layout::Narrow };
    Ok(LogFiles::create(&free_name(&log.file, rotation), rotation, false)?.with_side_layout(layout))
}

/// The first of `log.dat`, `log-r1.dat`, `log-r2.dat` ... without any file, rotated or not: no start overwrites
/// another's log.
fn free_name(log: &Path, rotation: Rotation) -> PathBuf {
    let stem = log.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let numbered = |k: u32| log.with_file_name(format!("{stem}-r{k}.dat"));
    std::iter::once(log.to_owned())
        .chain((1..).map(numbered))
        .find(|name| !name.exists() && LogFiles::earlier(name, rotation).is_none())
        .unwrap_or_else(|| log.to_owned())
}

fn resident_mib() -> Option<f64> {
    let pages: f64 = std::fs::read_to_string("/proc/self/statm").ok()?.split_whitespace().nth(1)?.parse().ok()?;
    Some(pages * 4_096.0 / (1 << 20) as f64)
}
