//! The scheduler on a virtual air.

mod air;
mod faults;
mod golden;
mod hostile;
mod keys;
mod rounds;
mod wsr;
