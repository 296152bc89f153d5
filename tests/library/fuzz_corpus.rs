//! The fuzz targets of the library and the simulator on their corpus.

#[path = "../common/corpus.rs"]
mod corpus;
#[path = "../../fuzz/targets/log.rs"]
mod log;
#[path = "../../fuzz/targets/remote.rs"]
mod remote;
#[path = "../../fuzz/targets/scene.rs"]
mod scene;

use crate::fuzz_csv::trajectory_csv;
use crate::fuzz_sounding::sounding;

#[test]
fn corpora() {
    corpus::replay("log", log::run);
    corpus::replay("remote", remote::run);
    corpus::replay("scene", scene::run);
    corpus::replay("sounding", sounding::run);
    corpus::replay("trajectory_csv", trajectory_csv::run);
}
