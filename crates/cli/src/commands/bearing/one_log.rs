//! `csi5300 bearing --antennas A,B --baseline X,Y,Z`: bearings of all senders in one log, from antennas on a turning robot.

use super::super::Words;
use super::super::inputs::Inputs;
use super::super::{Outcome, Result, hint, info, print, print_json, usage};
use super::captures::MirrorOf;
use super::{Args, artefacts, describe, explain_lines, link_name, options, pairs};
use csi_formats::{Item, Items, Why};
use csi5300::motion::pose::Trajectory;
use csi5300::pipeline::{
    Answer, Array, ArrayError, CaptureReport, ChainConstant, LinkReport, OneLog, OneLogReport, Options, one_log,
};
use nalgebra::Vector3;
use std::path::Path;

/// The result of another card's log, and whether some bytes were unreadable; `None` for other files.
fn other_card(
    path: &Path,
    trajectory: &Trajectory,
    array: &Array,
    options: &Options,
) -> Words<Option<(OneLogReport, bool)>> {
    let Some((format, bytes)) = csi5300_lab::cards::read(path) else { return Ok(None) };
    let mut one = OneLog::new(array.clone(), options.clone());
    let (mut frames, mut without, mut lost) = (0_u64, 0_u64, 0_u64);
    for item in Items::new(format, &bytes) {
        match item {
            Item::Frame(frame) => {
                frames += 1;
                without += u64::from(!one.note_frame(&frame));
            }
            Item::Skipped(skipped) => lost += if skipped.why == Why::NoCsi { 0 } else { skipped.len },
        }
    }
    note!("{}: {}, {frames} frames, {without} lack an antenna", path.display(), format.name());
    if lost > 0 {
        note!("  not read: {lost} bytes");
    }
    Ok(Some((one.bearings(trajectory), lost > 0)))
}

/// The bearings from one log.
struct Alone {
    report: OneLogReport,
    lost: bool,
    /// Unused and lost records of a 5300's log.
    notes: Option<String>,
}

impl Alone {
    fn read(inputs: &Inputs, rx: &Path, trajectory: &Trajectory, (array, options): (&Array, &Options)) -> Words<Self> {
        if let Some((report, lost)) = other_card(rx, trajectory, array, options)? {
            return Ok(Self { report, lost, notes: None });
        }
        let mut log = inputs.open(rx)?;
        let report = one_log(&mut log, trajectory, array, options).map_err(|error| error.to_string())?;
        let (survey, unused) = (&report.log.survey, report.log.unused);
        let losses = info::unusual_losses(survey, log.bytes());
        let has_notes = unused.no_antenna > 0 || !losses.is_empty();
        let notes = has_notes.then(|| {
            let (bfees, lacking) = (survey.bfees(), unused.no_antenna);
            format!("{}: {bfees} bfee records, {lacking} lack an antenna\n{losses}", rx.display())
        });
        Ok(Self { lost: survey.lost_something(), notes, report })
    }
}

/// The name of a link: that of the log, with the sender if there are several.
fn name(inputs: &Inputs, rx: &Path, link: &LinkReport, links: usize) -> String {
    let own = link_name(inputs, rx);
    match link.mac {
        _ if links == 1 => own,
        Some(mac) => format!("{own}/{mac}"),
        None => format!("{own}/unknown"),
    }
}

/// The antennas, their baselines and, if given, the constants of their chains.
fn array(args: &Args) -> std::result::Result<Array, ArrayError> {
    let metres: Vec<Vector3<f64>> = args.logs.baseline.iter().map(|baseline| baseline.metres).collect();
    let array = Array::new(&args.estimation.antenna, &metres)?;
    let constants: Vec<ChainConstant> = args.logs.baseline.iter().filter_map(|baseline| baseline.constant).collect();
    if constants.is_empty() { Ok(array) } else { array.with_constants(&constants) }
}

/// Combines the bearings of two logs with those of the receiver's log alone.
pub fn join(args: &Args, inputs: &Inputs, (rx, path): (&Path, &Path), report: &mut CaptureReport) -> Words<()> {
    if rx.as_os_str() == "-" {
        usage("--baseline with --tx reads the log twice: --rx cannot be standard input");
    }
    let array = array(args).unwrap_or_else(|error| usage(&format!("--antennas, --baseline: {error}")));
    let mut options = options(args).unwrap_or_else(|message| usage(&message));
    // All senders: pairing by clocks has identified the transmitters.
    options.tx_macs.clear();
    let trajectory = inputs.trajectory(path)?;
    let Alone { report: one, .. } = Alone::read(inputs, rx, &trajectory, (&array, &options))?;
    for link in &mut report.links {
        let heard = one.links.iter().find(|heard| heard.mac.is_some() && heard.mac == link.mac);
        let Some(heard) = heard.map(|heard| &heard.bearing) else { continue };
        match (&link.bearing, heard) {
            (Ok(two), Ok(heard)) => link.bearing = Ok(two.with_one_log(heard)),
            (Err(why), Ok(heard)) => {
                note!("the two logs give no bearing ({why}): this one is from {} alone", rx.display());
                link.bearing = Ok(heard.clone());
            }
            (_, Err(why)) => note!("{} alone gives no bearing: {why}", rx.display()),
        }
    }
    Ok(())
}

/// Estimates and prints the bearings.
pub fn run(args: &Args) -> Result {
    let array = array(args).unwrap_or_else(|error| usage(&format!("--antennas, --baseline: {error}")));
    let options = options(args).unwrap_or_else(|message| usage(&message));
    let (Some(rx), Some(path)) = (&args.logs.rx, &args.logs.trajectory) else {
        usage("--rx and --trajectory are needed");
    };
    let inputs = Inputs::files(args.logs.columns.clone());
    let trajectory = inputs.trajectory(path)?;
    let Alone { report, mut lost, notes } = Alone::read(&inputs, rx, &trajectory, (&array, &options))?;
    let mut answered = 0;
    for link in &report.links {
        let name = name(&inputs, rx, link, report.links.len());
        let mut answer = Answer::new(name.clone(), link);
        hint::add(&mut answer);
        if let Some(least) = args.min_confidence {
            answer.refuse_below(least);
        }
        answered += usize::from(answer.azimuth_deg.is_some());
        if args.json {
            print_json(&answer);
        } else {
            // With known constants, the robot may stand still.
            let stands = args.logs.baseline.iter().any(|baseline| baseline.constant.is_some());
            let of = if stands { MirrorOf::Antennas } else { MirrorOf::Motion };
            print(&describe(&answer, of, report.links.len(), "", &pairs::records(&answer)));
        }
        if let Some(error) = &answer.error {
            wrong!("{}: {error}", answer.link);
        }
        artefacts(args, &name, link, report.links.len())?;
    }
    if report.links.is_empty() {
        wrong!(
            "{}: no record has the CSI of all named antennas (--antennas); `csi5300 info` shows the number of chains",
            rx.display()
        );
    }
    if !args.json {
        explain_lines(report.links.len());
    }
    if let Some(notes) = notes {
        notes!("{notes}");
    }
    lost |= answered < report.links.len();
    Ok(match answered {
        0 => Outcome::Nothing,
        _ if lost => Outcome::DataLost,
        _ => Outcome::Done,
    })
}
