//! The simulated backend (in work).
