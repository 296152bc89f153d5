//! `csi5300 doctor --accept`: which promises of the card, its driver and its host hold.

use super::super::Words;
use super::Args;
use crate::commands::args::channel as channel_of;
use crate::commands::draft::{FolderDraft, reads};
use crate::commands::files::{open_log, read_trajectory};
use crate::commands::{Outcome, Result, print, simulate, usage};
use csi_formats::Format;
use csi5300::signal::channel::Channel;
use csi5300::source::CsiSource;
use csi5300::source::other_card::Translated;
use csi5300_accept::{Collector, Done, Evidence, Plan, Report, Side, Truth, Verdict, collect};
use csi5300_say::{Tone, toned};
use csi5300_sim::motion::RobotMotion;
use csi5300_sim::{Room, Scene, stamp};
use std::io::Read;
use std::path::{Path, PathBuf};

mod assist;
mod live;
mod stopped;

/// The desk, as its TOML describes it. Every key is optional; without logs, this machine's card is judged.
#[derive(serde::Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct Desk {
    /// The first robot's log.
    near: Option<PathBuf>,
    /// The second robot's log of the same time.
    far: Option<PathBuf>,
    /// The channel, as `--channel` takes it.
    channel: Option<String>,
    /// Neither robot moves.
    at_rest: bool,
    /// The first robot's trajectory.
    trajectory: Option<PathBuf>,
    /// The true direction from the first to the second robot, degrees from +x towards +y of the trajectory's frame.
    azimuth_deg: Option<f64>,
    /// One or two logs, the first robot's first, after each retune.
    retuned: Vec<Vec<PathBuf>>,
    /// The same after the driver was reloaded.
    reloaded: Vec<Vec<PathBuf>>,
    /// The monitor interface: the first robot sends on it, the second answers.
    interface: Option<String>,
    /// A robot of a served room in place of a card: PATH#ROBOT.
    room: Option<String>,
    /// Send frames at several rates while listening.
    send: bool,
    /// Where the second robot waits (its `assist`), host and port: its log comes from there at the end.
    peer: Option<String>,
    /// This is the second robot; it waits here for the first, address and port.
    assist: Option<String>,
    /// The second robot answers on its interface; otherwise its driver answers, or nobody.
    answer: bool,
    /// Antennas that a person unplugs one after the other: A, B, C.
    unplug: Vec<String>,
}

impl Desk {
    /// Ends the command if keys contradict each other.
    fn check(&self) {
        let is_live = self.near.is_none();
        let needs_interface = self.send || self.answer;
        let sets = [
            (
                !is_live && (self.send || self.peer.is_some() || self.assist.is_some() || !self.unplug.is_empty()),
                "a desk with `near` is judged by that log: `send`, `peer`, `assist` and `unplug` need a card",
            ),
            (
                self.assist.is_some() && (self.send || self.peer.is_some() || !self.unplug.is_empty()),
                "`assist` is for the second robot; `send`, `peer` and `unplug` are for the first",
            ),
            (self.answer && self.assist.is_none(), "`answer` belongs to the second robot, which has `assist`"),
            (
                needs_interface && self.interface.is_none() && self.room.is_none(),
                "`send` and `answer` need the monitor interface: `interface = \"mon0\"`",
            ),
            (
                self.send && !self.unplug.is_empty(),
                "`send` and `unplug` do not go together: run one after the other, while another robot sounds",
            ),
            (
                self.retuned.iter().chain(&self.reloaded).any(|logs| !(1..=2).contains(&logs.len())),
                "each item of `retuned` and `reloaded` is one log or two: [[\"near2.dat\", \"far2.dat\"]]",
            ),
        ];
        if let Some((_, why)) = sets.iter().find(|(is_wrong, _)| *is_wrong) {
            usage(why);
        }
    }
}

/// Judges the desk. Exit status 1 if a claim fails, 3 if the run was interrupted.
pub fn run(args: &Args) -> Result {
    let Some(Judged { evidence, facts, is_whole, stopped }) = evidence(args)? else { return Ok(Outcome::Done) };
    let mut report = evidence.judge();
    report.facts = facts;
    match args.json {
        true => println!("{}", report.json().map_err(|error| error.to_string())?),
        false => print(&text(&report)),
    }
    if let Some(folder) = &args.report {
        write(&report, &evidence, stopped.as_ref(), folder)?;
        note!(
            "the report is in {}: report.html to look at, report.json, report.xml (JUnit), bench-log.md; the logs beside it have MAC addresses, the report has none",
            folder.display()
        );
    }
    Ok(match report.count(Verdict::Fails) {
        0 if is_whole => Outcome::Done,
        0 => Outcome::DataLost,
        _ => Outcome::Nothing,
    })
}

/// The table with coloured verdicts.
fn text(report: &Report) -> String {
    let coloured = |line: &str| {
        let tones = [("FAILS", Tone::Bad), ("holds", Tone::Good)];
        match tones.iter().find(|(word, _)| line.starts_with(word)) {
            Some((word, tone)) => format!("{}{}", toned(word, *tone), &line[word.len()..]),
            None => line.to_owned(),
        }
    };
    let mut text: String = report.facts.iter().map(|fact| format!("{fact}\n")).collect();
    let is_long = csi5300_say::says(csi5300_say::Level::Verbose);
    let words = if is_long { format!("{report:#}") } else { report.to_string() };
    text.extend(words.lines().map(|line| coloured(line) + "\n"));
    text
}

/// The observations that claims are judged by, and facts about their source.
struct Judged {
    evidence: Evidence,
    facts: Vec<String>,
    /// All parts of the run are finished.
    is_whole: bool,
    /// The part of an interrupted run that can be continued.
    stopped: Option<stopped::Stopped>,
}

impl Judged {
    fn of(evidence: Evidence, fact: String) -> Self {
        Self { evidence, facts: vec![fact], is_whole: true, stopped: None }
    }
}

type Found = Words<Judged>;

/// `None` if this robot assisted.
fn evidence(args: &Args) -> Words<Option<Judged>> {
    let toml = |path: &Path| path.extension().is_some_and(|ending| ending == "toml");
    let found = match args.what.as_slice() {
        [] => live::listen(args, &Desk::default()),
        [only] if toml(only) && only.exists() => {
            let text = std::fs::read_to_string(only).map_err(|error| format!("{}: {error}", only.display()))?;
            match Scene::parse(&text) {
                Ok(scene) => return room(&scene).map(Some),
                // A desk has no robots.
                Err(error) if text.lines().any(|line| line.trim_start().starts_with("[[robot]]")) => {
                    return Err(error.of_file(only));
                }
                Err(_) => {}
            }
            reads(only);
            let mut desk: Desk = toml::from_str(&text).map_err(|error| format!("{}: {error}", only.display()))?;
            let beside = |path: Option<PathBuf>| path.map(|path| only.parent().unwrap_or(Path::new("")).join(path));
            (desk.near, desk.far, desk.trajectory) = (beside(desk.near), beside(desk.far), beside(desk.trajectory));
            for path in desk.retuned.iter_mut().chain(&mut desk.reloaded).flatten() {
                *path = only.parent().unwrap_or(Path::new("")).join(&path);
            }
            desk.check();
            if let Some(address) = &desk.assist {
                return assist::assist(args, &desk, address).map(|()| None);
            }
            if desk.near.is_some() { logs(args, &desk) } else { live::listen(args, &desk) }
        }
        [only] if !only.exists() => room(&simulate::load(only)?),
        [near] => logs(args, &Desk { near: Some(near.clone()), ..Desk::default() }),
        [near, far] => logs(args, &Desk { near: Some(near.clone()), far: Some(far.clone()), ..Desk::default() }),
        _ => usage("--accept takes the logs of two robots at most: the first robot's, then the second's"),
    };
    found.map(Some)
}

/// The channel by the command line or the desk.
fn channel(args: &Args, desk: &Desk) -> Words<Channel> {
    let told = desk.channel.as_deref().map(channel_of).transpose()?;
    let Some(channel) = args.channel.or(told) else {
        usage(
            "which WiFi channel were the cards tuned to? Give it with --channel, or with `channel = \"108\"` in the desk's TOML",
        )
    };
    Ok(channel)
}

/// The plan by the desk and the command line.
fn plan(args: &Args, desk: &Desk) -> Words<Plan> {
    let mut plan = Plan::new(channel(args, desk)?);
    plan.at_rest = desk.at_rest;
    plan.truth = match (&desk.trajectory, desk.azimuth_deg) {
        (Some(path), Some(deg)) => {
            reads(path);
            Some(Truth { trajectory: read_trajectory(path)?, azimuth_rad: deg.to_radians() })
        }
        (None, None) => None,
        _ => usage("a desk has both `trajectory` and `azimuth_deg`, or neither"),
    };
    Ok(plan)
}

/// A log's bytes; those of a FeitCSI log as records of the 5300.
fn log(path: &Path) -> Words<Vec<u8>> {
    reads(path);
    open_log(path)?;
    let failed = |error| format!("{}: {error}", path.display());
    let Some((Format::FeitCsi, bytes)) = csi5300_lab::cards::read(path) else {
        return std::fs::read(path).map_err(failed);
    };
    let mut records = Vec::new();
    Translated::new(bytes.as_slice()).read_to_end(&mut records).map_err(failed)?;
    Ok(records)
}

/// The logs after retunes and reloads.
fn later(collector: &mut Collector, desk: &Desk) -> Words<()> {
    for (done, all) in [(Done::Retuned, &desk.retuned), (Done::Reloaded, &desk.reloaded)] {
        for logs in all {
            let bytes = logs.iter().map(|path| log(path)).collect::<std::result::Result<Vec<_>, _>>()?;
            if let Some((near, far)) = bytes.split_first() {
                collector.after(done, near, far.first().map(Vec::as_slice));
            }
        }
    }
    Ok(())
}

/// Recorded logs.
fn logs(args: &Args, desk: &Desk) -> Found {
    let mut collector = Collector::new(plan(args, desk)?);
    for (side, path) in [(Side::Near, &desk.near), (Side::Far, &desk.far)] {
        let Some(path) = path else { continue };
        collector.log(side, &log(path)?);
    }
    later(&mut collector, desk)?;
    Ok(Judged::of(collector.finish(), "backend: recorded logs".into()))
}

/// The first two robots of a simulated room, in virtual time.
fn room(scene: &Scene) -> Found {
    let mut room = Room::new(scene).map_err(|error| error.to_string())?;
    // A scene's number is that of the centre, here it is the lower half's.
    let name = match scene.bandwidth_mhz {
        40 => format!("{}+", scene.channel.saturating_sub(2)),
        _ => scene.channel.to_string(),
    };
    let mut plan = Plan::new(name.parse::<Channel>().map_err(|error| error.to_string())?);
    let still = |robot: &csi5300_sim::scene::Robot| robot.motion == RobotMotion::default();
    plan.at_rest = scene.robot.iter().all(still);
    if let (Some(trajectory), Some(to)) = (room.true_path(0, 100.0), room.antenna(1, 0.0))
        && scene.robot.get(1).is_some_and(still)
    {
        let poses = trajectory.poses();
        let mean = poses.iter().map(|pose| pose.position_m).sum::<nalgebra::Vector3<f64>>() / poses.len().max(1) as f64;
        let towards = to - mean;
        plan.truth = Some(Truth { azimuth_rad: towards.y.atan2(towards.x), trajectory });
    }
    let Some(mut near) = room.card(0) else { return Err("the scene has no robot".into()) };
    let mut far = room.card(1);
    let far = far.as_mut().map(|far| far as &mut dyn CsiSource);
    let evidence = collect(&mut near, far, None, plan).map_err(|error| error.to_string())?;
    Ok(Judged::of(evidence, format!("backend: simulated room, scene {:?}, seed {}", scene.name, scene.seed)))
}

/// The report's files, the logs beside it, and the state from which an interrupted run continues.
fn write(report: &Report, evidence: &Evidence, stopped: Option<&stopped::Stopped>, folder: &Path) -> Words<()> {
    let draft = FolderDraft::new(folder)?;
    let date = evidence
        .near
        .records
        .iter()
        .find_map(|record| record.host_us)
        .map_or_else(|| "no date".into(), |us| stamp(us.div_euclid(1_000_000)));
    let json = report.json().map_err(|error| error.to_string())?;
    let goes_on = stopped.map(serde_json::to_vec).transpose().map_err(|error| error.to_string())?.unwrap_or_default();
    let mut files = vec![
        ("report.json".to_owned(), json.into_bytes()),
        ("report.xml".into(), report.junit().into_bytes()),
        ("report.html".into(), report.html().into_bytes()),
        ("bench-log.md".into(), report.entry(&date).into_bytes()),
        ("near.dat".into(), evidence.near.log.clone()),
        ("far.dat".into(), evidence.far.as_ref().map(|far| far.log.clone()).unwrap_or_default()),
        (stopped::FILE.into(), goes_on),
    ];
    // A continued run needs every log, even an empty one.
    let is_kept = |(name, bytes): &(String, Vec<u8>)| !bytes.is_empty() || (stopped.is_some() && name == "near.dat");
    files.retain(is_kept);
    files.extend(evidence.unplugged.iter().map(|(antenna, heard)| (stopped::unplugged(*antenna), heard.log.clone())));
    for (name, bytes) in files {
        std::fs::write(draft.path().join(&name), bytes)
            .map_err(|error| draft.words(&format!("cannot write {name}: {error}")))?;
    }
    draft.keep()?;
    match stopped {
        Some(_) => Ok(()),
        None => match std::fs::remove_file(folder.join(stopped::FILE)) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(format!("cannot remove {}: {error}", stopped::FILE))
            }
            _ => Ok(()),
        },
    }
}
