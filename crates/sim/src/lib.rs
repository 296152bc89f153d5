//! A room of robots, simulated down to the card's bytes.
//!
//! It replaces card, driver and logger: it moves robots, propagates waves, runs the TDMA exchange of live cards, and
//! emits the records of real cards, in the same layouts, with the same 8 bits, losses, overruns and cut tails. Code
//! behind [`csi5300::source::CsiSource`] works unchanged with both.
//!
//! ```
//! use csi5300_sim::{Room, Scene};
//!
//! let scene = "duration_s = 2.0\nsounding.rate_hz = 100\n\
//!              [[robot]]\nname = \"rx\"\nmotion.circle = { radius_m = 0.3, duration_s = 2.0 }\n\
//!              [[robot]]\nname = \"tx\"\nposition_m = [3.0, 1.0, 0.5]\n";
//! let run = Room::new(&Scene::parse(scene)?)?.run()?;
//! let (rx, tx) = (&run.robots[0], &run.robots[1]);
//! assert_eq!((rx.records, tx.records), (200, 200)); // 100 rounds per second
//! assert_eq!(tx.start_m().map(|place| place.x), Some(3.0));
//! # Ok::<(), csi5300_sim::RoomError>(())
//! ```
//!
//! A log is the bytes of a `.dat` file ([`SimulatedRobot::replay`] reads it); [`Room::card`] hands out a live card instead,
//! [`write_dataset`] writes a capture folder.
//!
//! The chain from scene to bytes:
//!
//! | module | what it turns into what |
//! |---|---|
//! | [`scene`] | TOML into values and back |
//! | `refusal` | values into refusals with their place |
//! | [`toml_lines`] | a place in a TOML text into its line |
//! | [`motion`] | time into poses: shapes, walks, waypoints, recorded trajectories; an odometry source while it gives them |
//! | [`crystal`] | time into a card's clock and carrier phase, which share one crystal |
//! | `world` | all of these for every robot; two places into paths: image method \[allen-berkley1979\] to any order, exact lengths, blocked and weakened paths; paths into 30 tones at the card's true subcarrier indices |
//! | [`radio`], `receiver` | tones into 8-bit coefficients: noise, gain control, RSSI, antenna order, saturation; frames into the moments of their answers |
//! | `sounder` | time into frames: the TDMA state machine |
//! | `air` | frames into receptions: carrier sense, collisions, turn-around, losses, the driver's counters |
//! | `faults` | records into those of a card with faults |
//! | `port` | receptions into records, behind a socket queue that overruns as the kernel's does; frames for senders outside of the room, as a monitor interface gives them; true motion into a sensor's poses |
//! | `dataset`, `room` | a room into a capture folder, or logs in memory |
//! | [`random`] | a seed into random numbers |
//!
//! Two rules. Disabled effects cost nothing: they draw no random number, reflections need surfaces, and coefficients
//! are computed when a record is read. And a seed gives the same bytes on any machine: random numbers are ChaCha8
//! streams \[chacha\], one for each purpose and robot, and all functions that affect bytes are plain arithmetic (see
//! `maths`).
//!
//! One space-time stream is sent (MCS 0 to 7), as sounding does; up to three antennas receive.
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used))]

mod air;
pub mod crystal;
mod dataset;
mod faults;
mod maths;
pub mod motion;
mod port;
pub mod radio;
pub mod random;
mod receiver;
mod refusal;
mod room;
pub mod scene;
pub mod served;
mod sounder;
pub mod toml_lines;
mod world;

pub use dataset::{WrittenCapture, WrittenLog, stamp, write_dataset};
pub use faults::{CardFault, Faults, Injected};
pub use motion::Recorded;
pub use port::{Interface, Odometer, Port, Seen};
pub use refusal::SceneError;
pub use room::{Backend, Room, RoomError, SimulatedRobot, Simulation};
pub use scene::{BUILT_IN, Scene};

use csi5300::internal::refused;
