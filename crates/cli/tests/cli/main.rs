//! The program as its users meet it.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "../../../../tests/common/mod.rs"]
mod common;
#[path = "../../../../tests/common/documented.rs"]
mod documented;
#[path = "../../../../tests/common/private.rs"]
mod private;

// Tests start in the order of their names; those that wait the longest are the first.
mod acceptance;
mod air;
mod bags;
mod cards;
mod commands;
mod compare;
mod monitor;
#[cfg(unix)]
mod outputs;
mod recording;
mod served;

/// Builds the robot's service, which `csi5300 node` starts, where it is not beside the program yet: a test of this package alone
/// builds no other's.
fn with_node() {
    static ONCE: std::sync::Once = std::sync::Once::new();
    ONCE.call_once(|| {
        let program = std::path::Path::new(env!("CARGO_BIN_EXE_csi5300"));
        if program.with_file_name("csi5300-node").exists() {
            return;
        }
        let (folder, target) = (program.parent().unwrap(), program.ancestors().nth(2).unwrap());
        let profile = if folder.ends_with("debug") { "dev" } else { folder.file_name().unwrap().to_str().unwrap() };
        let mut cargo = std::process::Command::new(env!("CARGO"));
        cargo.args(["build", "--quiet", "--package", "csi5300-node", "--profile", profile, "--target-dir"]).arg(target);
        assert!(cargo.current_dir(common::root()).status().unwrap().success(), "csi5300-node is not built");
    });
}
