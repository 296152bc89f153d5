//! The serial port of a TurtleBot3: opened, watched, and reopened after it was unplugged.

use csi5300::motion::odometry::opencr::{Geometry, OpenCr};
use csi5300::motion::odometry::{NextPose, OdometrySource, SourceCounts};
use csi5300::source::Error;
use csi5300::time::{Instant, Span};
use serialport::{SerialPort, TTYPort};
use std::io::{ErrorKind, Read, Write};
use std::path::PathBuf;
use std::time::Duration;

/// Requested bits per second; meaningless over USB (turtlebot3_node requests the same).
const BAUD: u32 = 1_000_000;
/// Interval of reads while an answer is due.
const LOOK: Span = Span::from_ms(1);
/// Interval of tries to open an absent port.
const REOPEN: Span = Span::from_ms(500);

/// Wheel odometry of a TurtleBot3 over its controller's port. It only reads: it never commands the motors.
pub struct Serial {
    path: PathBuf,
    port: Option<TTYPort>,
    opencr: OpenCr,
    wall_us: fn() -> Option<i64>,
    next: Instant,
    /// Times that the port was lost.
    unplugged: u64,
    trouble: Option<String>,
}

impl Serial {
    /// Polls the controller at `path`, `rate_hz` times a second. The port may appear later.
    ///
    /// # Errors
    /// If `path` exists but is no port.
    pub fn open(
        path: PathBuf,
        rate_hz: f64,
        geometry: Option<Geometry>,
        now: Instant,
        wall_us: fn() -> Option<i64>,
    ) -> Result<Self, Error> {
        if path.is_dir() || path.is_file() {
            return Err(crate::refused(format!("{} is no serial port", path.display())));
        }
        let opencr = OpenCr::new(rate_hz, geometry, now);
        Ok(Self { path, port: None, opencr, wall_us, next: now, unplugged: 0, trouble: None })
    }

    /// The port, opened if it is time to.
    fn connect(&mut self, now: Instant) {
        if self.port.is_some() || now < self.next {
            return;
        }
        self.next = now + REOPEN;
        let name = self.path.to_string_lossy();
        let opened = serialport::new(name.as_ref(), BAUD).timeout(Duration::from_millis(1)).open_native();
        match opened {
            Ok(port) => {
                let _ = port.clear(serialport::ClearBuffer::All);
                (self.port, self.trouble) = (Some(port), None);
                self.opencr.reopened(now);
            }
            Err(error) => {
                let hint = "is the robot plugged in and switched on, and may this user open it (group dialout)?";
                self.trouble = Some(format!("{name}: {error}; {hint}"));
            }
        }
    }

    fn lose(&mut self, now: Instant, error: &std::io::Error) {
        self.port = None;
        self.unplugged += 1;
        self.next = now + REOPEN;
        self.trouble = Some(format!("{}: {error}: unplugged?", self.path.display()));
    }

    /// Writes due requests and reads available answers.
    fn exchange(&mut self, now: Instant) -> std::io::Result<()> {
        let Some(port) = &mut self.port else { return Ok(()) };
        // Without a wall clock poses have no time.
        let Some(wall_us) = (self.wall_us)() else { return Ok(()) };
        let mut buffer = [0; 512];
        loop {
            let there = port.bytes_to_read()? as usize;
            if there == 0 {
                break;
            }
            let room = buffer.len().min(there);
            let Some(room) = buffer.get_mut(..room) else { break };
            match port.read(room) {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(read) => self.opencr.handle_bytes(now, wall_us, buffer.get(..read).unwrap_or_default()),
                Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => break,
                Err(error) => return Err(error),
            }
        }
        if let Some(request) = self.opencr.poll_transmit(now, wall_us) {
            port.write_all(request)?;
        }
        Ok(())
    }
}

impl OdometrySource for Serial {
    fn receive(&mut self, now: Instant) -> Result<NextPose, Error> {
        self.connect(now);
        if let Err(error) = self.exchange(now) {
            self.lose(now, &error);
        }
        if self.port.is_some() {
            let due = self.opencr.poll_timeout();
            let look = if self.opencr.is_waiting() { due.min(now + LOOK) } else { due };
            self.next = look.max(now + Span::from_us(1));
        }
        Ok(self.opencr.poll_found().unwrap_or(NextPose::Pending))
    }

    fn next_at(&self) -> Option<Instant> {
        Some(self.next)
    }

    fn trouble(&self) -> Option<String> {
        self.trouble.clone().or_else(|| self.opencr.trouble())
    }

    fn counted(&self) -> Option<SourceCounts> {
        Some(SourceCounts::Controller { controller: self.opencr.counts(), unplugged: self.unplugged })
    }
}
