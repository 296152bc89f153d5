//! The `csi5300` command.
fn main() {}
