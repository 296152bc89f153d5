//! The round-robin TDMA scheduler: who sounds whom, when, and who answers. Sans-IO.
//!
//! A robot that wants bearings sounds its peers in turn: in every slot it sends a forward frame to one peer, which
//! answers at once with a backward frame of the same number. Both cards measure, and the carrier offset cancels in the
//! product of both measurements. A round is one exchange with every peer; after one or more rounds the turn goes to the
//! next robot that wants it.
//!
//! * [`Plan`] divides time into slots, and refuses a rate that does not fit with the highest that does.
//! * [`Tdma`] is one robot's state machine, with its contract. The live card's thread and the simulated air drive the
//!   same one.
//! * [`Dialect`] chooses between the frames of the WSR toolbox and the native ones of this project.
//!
//! ```
//! use csi5300::exchange::tdma::{Config, Epoch, Plan, PlanError, Request, Tdma};
//! use csi5300::driver_iface::Mac;
//! use csi5300::time::Instant;
//!
//! // Twelve peers at 100 rounds per second fit, 32 do not; the error says what would.
//! let plan = Plan::new(&Request::new(12, 100.0))?;
//! assert!(plan.slot_us() > f64::from(plan.shortest_slot_us()));
//! assert!(matches!(Plan::new(&Request::new(32, 100.0)), Err(PlanError::Rate { highest_hz, .. }) if highest_hz > 40.0));
//!
//! // Two robots on one air, without loss. The first initiates, the second answers.
//! let (a, b) = (Mac([2, 0, 0, 0, 0, 1]), Mac([2, 0, 0, 0, 0, 2]));
//! let request = Request::new(1, 100.0);
//! let mut first = Tdma::new(&Config::new(a, 0, &[b], request, 1).with_initiate(true))?;
//! let mut second = Tdma::new(&Config::new(b, 0, &[a], request, 1))?;
//! let mut now = Instant::ZERO;
//! while first.counts().answered < 3 {
//!     now = now.max(first.poll_timeout().unwrap_or(now));
//!     let heard = first.poll_transmit(now).map(|transmit| transmit.frame.to_vec());
//!     if let Some(frame) = heard {
//!         second.handle_heard(now, now, &frame);
//!         let answer = second.poll_transmit(now).map(|transmit| transmit.frame.to_vec());
//!         first.handle_heard(now, now, &answer.unwrap_or_default());
//!     }
//! }
//! # Ok::<(), PlanError>(())
//! ```

mod auth;
mod clock;
mod config;
mod event;
mod hearing;
mod machine;
mod phy;
mod plan;
pub(crate) mod proof;
mod roster;
mod turns;
mod view;

pub use auth::Key;
pub use clock::Epoch;
pub use config::{Config, Robot};
pub use event::{Cause, Event, LinkCounts, TdmaCounts};
pub use machine::{Tdma, Transmit};
pub use phy::{Dialect, Phy};
pub use plan::{Plan, PlanError, Request};
pub(crate) use proof::{Proof, Prover};
pub use roster::Priority;
