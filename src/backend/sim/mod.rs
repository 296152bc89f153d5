//! A room full of robots that speaks the card's bytes (in work).
pub mod carrier;
pub mod crystal;
pub mod faults;
mod maths;
pub mod motion;
pub mod radio;
mod random;
pub mod receiver;
pub mod recorded;
pub mod scene;
mod scene_check;
pub mod surfaces;
pub mod world;
