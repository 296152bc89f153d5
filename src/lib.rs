//! Bearings between robots, from WiFi alone.
//!
//! # From CSI to a bearing, in one page
//!
//! An Intel 5300 card reports **channel state information** (CSI): for each received frame the complex gain
//! `h[subcarrier]` of the channel, on 30 subcarriers, in 8-bit integers. The phase of `h` gives the length of the path,
//! modulo a wavelength (5.4 cm at 5.54 GHz): `h ~ exp(-j 2 pi d / lambda)`. One phase alone tells nothing about the
//! path, because the two cards' carriers differ by some kHz (the **carrier frequency offset**, CFO) and turn it at
//! random from frame to frame.
//!
//! 1. **Forward and backward.** Two robots exchange two frames almost at once. The CFO has opposite signs in the two
//!    directions, the path the same: in the *product* of the two CSI vectors the offset cancels and the path is there
//!    twice ([`signal::samples::Samples::path_gain`] is this factor). Frames are paired by number
//!    ([`exchange::pairing`]), which transmitter wrote which log follows from the clocks ([`exchange::assign`]).
//! 2. **The channel centre.** A line through the phase over the subcarriers, evaluated at subcarrier 0, makes 30 noisy
//!    phases one good one ([`signal::cfo::at_centre`]).
//! 3. **Turn-around.** The remaining effect of the CFO is `2 pi df` times the jitter of the time between the two
//!    frames. Both cards' microsecond clocks measure it, so it is removed ([`signal::cfo::TurnAround`]), with most of
//!    the phase noise.
//! 4. **Motion makes the array.** While the robot drives, one antenna is at many places `p`: a virtual antenna array
//!    ([`motion::pose`], [`signal::samples::Samples`]).
//! 5. **Bartlett.** For every direction `u` the samples are turned back by the phase that a wave from there would have
//!    made, and summed: `F(u) = |sum z exp(-j 4 pi u.p / lambda)|^2`. The bearing is the direction of its maximum
//!    ([`bartlett::search`] finds the maximum with a guarantee, [`bartlett::profile`] gives all of `F`).
//!
//! Motion along a line does not distinguish left from right: the answer has a mirror. Motion in a plane does not
//! distinguish up from down, but a raised transmitter shortens the wavelength seen in the plane, so |elevation| is searched too.
//!
//! ```
//! use csi5300::bartlett::{SearchOptions, search};
//! use csi5300::signal::samples::Samples;
//! use nalgebra::Vector3;
//! use num_complex::Complex64;
//! use std::f64::consts::TAU;
//!
//! // A robot on a circle of 30 cm, a far transmitter at 40 degrees, path gain 2 (forward times backward).
//! let (lambda_m, bearing) = (0.0541, 40f64.to_radians());
//! let mut samples = Samples::new(lambda_m, 2)?;
//! for k in 0..500 {
//!     let (sin, cos) = (TAU * f64::from(k) / 500.0).sin_cos();
//!     let p = Vector3::new(0.3 * cos, 0.3 * sin, 0.0);
//!     let towards = p.x * bearing.cos() + p.y * bearing.sin();
//!     let z = Complex64::cis(2.0 * TAU * towards / lambda_m);
//!     samples.push(f64::from(k) * 0.01, z, p, Vector3::zeros())?;
//! }
//! let estimate = search(&samples, &SearchOptions::default())?;
//! assert!((estimate.azimuth_rad - bearing).abs() < 1e-6);
//! # Ok::<(), csi5300::bartlett::Error>(())
//! ```
//!
//! # Read a log
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let mut log = csi5300::Log::open("tests/fixtures/small-circle/csi_rx_2023-11-14_221320.dat")?;
//! let mut frames = 0;
//! for frame in &mut log {
//!     frames += usize::from(frame?.mac.is_some());
//! }
//! println!("{frames} frames, how it ended: {:?}", log.tail()); // what was lost is in `log.survey()`
//! # assert!(frames > 100);
//! # Ok(())
//! # }
//! ```
//!
//! # Bearing from logs
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use csi5300::pipeline::Capture;
//!
//! let capture = Capture::new("108".parse()?)
//!     .receiver("tests/fixtures/small-circle/csi_rx_2023-11-14_221320.dat")?
//!     .transmitter("tests/fixtures/small-circle/csi_tx1_2023-11-14_221320.dat")?
//!     .trajectory("tests/fixtures/small-circle/rx_trajectory_2023-11-14_221320_.csv")?;
//! for bearing in capture.bearings()? {
//!     let answer = bearing?.answer;
//!     let azimuth_deg = answer.azimuth_rad.to_degrees();
//!     println!("{azimuth_deg:.1} deg, within 5 deg with probability {:.2?}", answer.probability);
//!     # assert!((azimuth_deg - 120.5).abs() < 0.5);
//! }
//! # Ok(())
//! # }
//! ```
//!
//! # Listen
//!
//! Every record that the driver of this machine's card sends, with its host time; CAP_NET_ADMIN is needed.
//!
//! ```no_run
//! use csi5300::source::{CsiSource, Next};
//! use csi5300_live::{netlink::{Netlink, Options}, wait::Monotonic};
//! use std::os::fd::AsFd;
//!
//! let (mut card, clock) = (Netlink::open(&Options::default())?, Monotonic::new());
//! loop {
//!     match card.receive(clock.now())? {
//!         Next::Record(stamps, record) => println!("{:?} us: {} bytes", stamps.host_us, record.body.len()),
//!         Next::Lost(loss) => eprintln!("{loss:?}"),
//!         Next::Pending => drop(clock.wait([card.as_fd()], None)?),
//!         Next::End(_) => break,
//!     }
//! }
//! # Ok::<(), csi5300::source::Error>(())
//! ```
//!
//! # Simulate
//!
//! The crate `csi5300-sim` takes the place of cards, drivers and loggers: a scene becomes a room, the room is run, and the
//! result has each robot's log, in the bytes that a card's logger writes, and its true path.
//!
//! ```
//! use csi5300_sim::{Room, Scene};
//!
//! let scene = "duration_s = 2.0\nsounding.rate_hz = 100\n\
//!              [[robot]]\nname = \"rx\"\nmotion.circle = { radius_m = 0.3, duration_s = 2.0 }\n\
//!              [[robot]]\nname = \"tx\"\nposition_m = [3.0, 1.0, 0.5]\n";
//! let run = Room::new(&Scene::parse(scene)?)?.run()?;
//! let (rx, tx) = (&run.robots[0], &run.robots[1]);
//! assert_eq!((rx.records, tx.records), (200, 200)); // 100 rounds per second; `rx.replay()` reads the log
//! assert!(rx.true_path.is_some() && tx.log.len() > 200 * 100);
//! # Ok::<(), csi5300_sim::RoomError>(())
//! ```
//!
//! # Where things come from
//!
//! Records come from a [`source::CsiSource`]: a file ([`source::replay`]), a card (crate `csi5300-live`) or a simulated
//! room (crate `csi5300-sim`). [`pipeline::Capture`] and [`pipeline::bearings`] run all steps. `ARCHITECTURE.md` has the plan of crates and modules.
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used))]

pub mod bartlett;
pub(crate) mod estimate;
/// The exchange of frames: who sends when, and which frames belong together. State machines without I/O.
pub mod exchange {
    pub(crate) mod admission;
    pub mod pairing;
    pub mod tdma;

    // Public for the tests of this workspace, no part of the library's interface.
    #[doc(hidden)]
    pub mod assign;
}
// What estimators count and wrap with: public for the crates of this workspace, no part of the library's interface.
#[doc(hidden)]
pub mod maths;
/// Where a robot is, and how that is known.
pub mod motion {
    pub mod odometry;
    pub mod pose;
}
pub mod pipeline;
mod place;
pub mod signal;
pub mod source;
pub mod time;

pub use driver_iface;
pub use nalgebra;
pub use num_complex;
pub use source::log::{Frame, Log};

/// What benches, examples and other crates of this workspace measure and fit beneath the library's interface: no part of
/// it, and free to change with any version.
#[doc(hidden)]
pub mod internal {
    use std::sync::{Mutex, MutexGuard, PoisonError};

    /// Locks a mutex, also after a thread panicked with it: what ours hold is consistent between any two steps.
    pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
        mutex.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// An error in words; nobody tells them apart.
    pub fn refused(words: impl Into<String>) -> crate::source::Error {
        crate::source::Error::Backend(words.into().into())
    }

    /// Packets of the OpenCR's protocol.
    pub mod dynamixel {
        pub use crate::motion::odometry::dynamixel::{emit, instruction};
    }
    pub use crate::bartlett::planner::{Method, Planner, Precision, ProfileOptions, oracle};
    pub use crate::bartlett::search::{ElevationSearch, Searcher};
    pub use crate::estimate::heading;
    pub use crate::exchange::pairing::by_clock::{ByClock, Refusal};
    pub use crate::exchange::tdma::auth::{Proof, Prover};
    pub use crate::exchange::tdma::roster::before_first_number;
    pub use crate::motion::pose::{Roller, heading_of};
    pub use crate::pipeline::intake::{FrameHeard, Front};
    pub use crate::pipeline::one_log::ArrayFrame;
    pub use crate::signal::cfo::drift_line;
    pub use crate::source::key_file::{create_key_file, group_text, robot_text};
    pub use crate::source::survey::{LOSSES_KEPT, PAUSE_US, SENDERS_KEPT};
    pub use crate::source::{FrameReceiver, HeardFrame};
}
