//! A room full of robots that speaks the card's bytes (in work).
#![allow(missing_docs)]
pub mod carrier;
pub mod crystal;
pub mod maths;
pub mod motion;
pub mod random;
pub mod recorded;
pub mod surfaces;
