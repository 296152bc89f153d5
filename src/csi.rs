//! CSI matrices (in work).
