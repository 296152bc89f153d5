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
//! | `scene_check`, `refusal` | values into refusals with their place |
//! | [`toml_lines`] | a place in a TOML text into its line |
//! | [`motion`] | time into poses: shapes, walks, waypoints, recorded trajectories |
//! | `followed` | an odometry source into poses, while it gives them |
//! | `surfaces` | two places into paths: image method \[allen-berkley1979\] to any order, exact lengths, blocked and weakened paths |
//! | `carrier` | paths into 30 tones at the card's true subcarrier indices |
//! | [`crystal`] | time into a card's clock and carrier phase, which share one crystal |
//! | `world`, `world_check` | all of these for every robot; refusals of what cannot be |
//! | [`radio`], `receiver` | tones into 8-bit coefficients: noise, gain control, RSSI, antenna order, saturation |
//! | `station`, `sounder` | time into frames: the TDMA state machine |
//! | `air`, `event`, `node` | frames into receptions: carrier sense, collisions, turn-around, losses, the driver's counters |
//! | `turn_around` | frames into the moments of their answers |
//! | `card_fault` | records into those of a card with faults |
//! | `port` | receptions into records, behind a socket queue that overruns as the kernel's does |
//! | `interface` | frames for senders outside of the room, as a monitor interface gives them |
//! | `odometer` | true motion into a sensor's poses |
//! | `dataset`, `simulation` | a room into a capture folder, or logs in memory |
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
mod backend;
mod built_in;
mod card_fault;
mod carrier;
pub mod crystal;
mod dataset;
mod event;
mod faults;
mod followed;
mod interface;
mod maths;
pub mod motion;
mod node;
mod odometer;
mod port;
pub mod radio;
pub mod random;
mod receiver;
mod recorded;
mod refusal;
mod room;
mod room_error;
pub mod scene;
mod scene_check;
pub mod served;
mod simulation;
mod sounder;
mod station;
mod surfaces;
pub mod toml_lines;
mod turn_around;
mod world;
mod world_check;

pub use backend::Backend;
pub use built_in::BUILT_IN;
pub use card_fault::CardFault;
pub use dataset::{WrittenCapture, WrittenLog, stamp, write_dataset};
pub use faults::{Faults, Injected};
pub use interface::{Interface, Seen};
pub use odometer::Odometer;
pub use port::Port;
pub use recorded::{Recorded, RecordedError};
pub use refusal::{SceneError, ScenePlace};
pub use room::Room;
pub use room_error::{CardError, RoomError};
pub use scene::Scene;
pub use simulation::{SimulatedRobot, Simulation};

#[cfg(test)]
use station::{FrameRole, Station};

#[cfg(test)]
mod account_tests;
#[cfg(test)]
mod dataset_tests;
#[cfg(test)]
mod room_tests;
#[cfg(test)]
mod scene_numbers_tests;
#[cfg(test)]
mod sounding_tests;
