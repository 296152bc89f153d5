//! Without a build script cargo does not count build-dependencies.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
}
