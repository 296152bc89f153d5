//! `csi5300 export`, and profiles as files.

use super::{Outcome, Result};
use csi5300::bartlett::{self, Grid};
use csi5300::samples::Samples;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// Arguments of `export`.
#[derive(clap::Args)]
pub struct Args {
    /// The log; - is standard input
    file: PathBuf,
    /// Where to write: .csv, one row a record, or .npz
    output: PathBuf,
    /// CSI in units of sqrt(SNR) instead of the card's integers
    #[arg(long)]
    scaled: bool,
}
