//! Where poses come from.

pub mod csv;
