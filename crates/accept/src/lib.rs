//! Acceptance claims about a card, its driver and its host.
//!
//! A [`Claim`] is a statement about a card, with its expected range and the source of that range. [`Evidence`]
//! takes the cards' items ([`csi5300::source::Next`]) and the sent frames; it does no I/O and reads no clock.
//! [`Evidence::judge`] judges every claim and returns a [`Report`]. So the same claims judge a simulated card in
//! virtual time, a recorded log and a card on the desk.
//!
//! A claim about a share or a mean **fails** only if chance would give such records about once in 10,000 times
//! ([`stats`]); the one about a bearing fails outside of the answer's own 95 % interval. If the records cannot decide,
//! the claim was **not tried**, with the reason. A claim without an expected range only **measures**.
//!
//! A user's own backend gets the same claims from [`run`]:
//!
//! ```
//! use csi5300_accept::{Plan, run};
//! use csi5300_sim::{Room, Scene};
//!
//! let mut room = Room::new(&Scene::built_in("lab-circle").expect("it is built in"))?;
//! let (mut near, mut far) = (room.card(0).expect("first"), room.card(1).expect("second"));
//! let report = run(&mut near, Some(&mut far), Plan::new("108".parse()?))?;
//! assert_eq!(report.failed().count(), 0, "{report}");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::indexing_slicing))]

mod claims;
mod evidence;
mod report;
pub mod stats;

pub use claims::{CLAIMS, Claim};
pub use evidence::{
    After, Done, Evidence, Heard, HeardRecord, Interface, Plan, Sending, Sent, Side, Truth, collect, run,
};
pub use report::{Curve, Figure, Finding, LogFacts, Of, Report, Verdict};
