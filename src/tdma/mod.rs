//! The round-robin TDMA scheduler (in work).
