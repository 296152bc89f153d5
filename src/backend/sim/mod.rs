//! A room full of robots that speaks the card's bytes (in work).
mod air;
mod built_in;
pub mod carrier;
pub mod crystal;
mod dataset;
pub mod faults;
mod maths;
pub mod motion;
mod odometer;
mod port;
pub mod radio;
mod random;
pub mod receiver;
pub mod recorded;
mod room;
pub mod scene;
mod scene_check;
mod sounder;
mod station;
pub mod surfaces;
pub mod world;

pub use air::MakeStation;
pub use built_in::BUILT_IN;
pub use dataset::{Capture, Log, write_dataset};
pub use faults::{Faults, Injected};
pub use odometer::{NextPose, Odometer};
pub use port::Port;
pub use room::Room;
pub use scene::{Scene, SceneError};
pub use station::{Role, Station};

#[cfg(test)]
mod dataset_tests;
#[cfg(test)]
mod room_tests;
#[cfg(test)]
mod sounding_tests;
