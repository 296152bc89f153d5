//! `csi5300 doctor --accept`: which promises of the card, its driver and its host hold.

use super::Args;
use crate::commands::args::channel as channel_of;
use crate::commands::draft::{FolderDraft, reads};
use crate::commands::files::{open_log, read_trajectory};
use crate::commands::listener::{Listening, Needs, describe};
use crate::commands::live::Signals;
use crate::commands::{Outcome, Result, print, simulate, usage};
use csi5300::signal::channel::Channel;
use csi5300::source::{CsiSource, Next};
use csi5300::time::{Instant, Span};
use csi5300_accept::{Collector, Evidence, Plan, Report, Side, Truth, Verdict, collect};
use csi5300_live::doctor::{Machine, System};
use csi5300_live::wait::Monotonic;
use csi5300_say::{Tone, toned};
use csi5300_sim::motion::RobotMotion;
use csi5300_sim::{Room, Scene, stamp};
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};

/// Where the module counts.
const COUNTERS: &str = "/sys/module/csi5300/counters";
/// How long a card is listened to unless `--listen` says otherwise.
const LISTEN_S: f64 = 20.0;
/// How often a waiting host is woken, to see how late it is.
const WAKE_US: i64 = 5_000;

/// What is on the desk, as its TOML says. All is optional; without logs the card of this machine is listened to.
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
}

/// Judges what is on the desk. Fails with exit status 1 where a claim does.
pub fn run(args: &Args) -> Result {
    let (evidence, facts) = evidence(args)?;
    let mut report = evidence.judge();
    report.facts = facts;
    match args.json {
        true => println!("{}", report.json().map_err(|error| error.to_string())?),
        false => print(&text(&report)),
    }
    if let Some(folder) = &args.report {
        write(&report, &evidence, folder)?;
        note!(
            "the report is in {}: report.html to look at, report.json, report.xml (JUnit), bench-log.md; the logs beside it have MAC addresses, the report has none",
            folder.display()
        );
    }
    Ok(if report.count(Verdict::Fails) == 0 { Outcome::Done } else { Outcome::Nothing })
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

fn evidence(args: &Args) -> std::result::Result<(Evidence, Vec<String>), String> {
    let toml = |path: &Path| path.extension().is_some_and(|ending| ending == "toml");
    match args.what.as_slice() {
        [] => live(args, &Desk::default()),
        [only] if toml(only) && only.exists() => {
            let text = std::fs::read_to_string(only).map_err(|error| format!("{}: {error}", only.display()))?;
            if let Ok(scene) = Scene::parse(&text) {
                return room(&scene);
            }
            reads(only);
            let mut desk: Desk = toml::from_str(&text).map_err(|error| format!("{}: {error}", only.display()))?;
            let beside = |path: Option<PathBuf>| path.map(|path| only.parent().unwrap_or(Path::new("")).join(path));
            (desk.near, desk.far, desk.trajectory) = (beside(desk.near), beside(desk.far), beside(desk.trajectory));
            if desk.near.is_some() { logs(args, &desk) } else { live(args, &desk) }
        }
        [only] if !only.exists() => room(&simulate::load(only)?),
        [near] => logs(args, &Desk { near: Some(near.clone()), ..Desk::default() }),
        [near, far] => logs(args, &Desk { near: Some(near.clone()), far: Some(far.clone()), ..Desk::default() }),
        _ => usage("--accept takes the logs of two robots at most: the first robot's, then the second's"),
    }
}

/// The plan by the desk and the command line.
fn plan(args: &Args, desk: &Desk) -> std::result::Result<Plan, String> {
    let told = desk.channel.as_deref().map(channel_of).transpose()?;
    let Some(channel) = args.channel.or(told) else {
        usage(
            "which WiFi channel were the cards tuned to? Say it with --channel, or with `channel = \"108\"` in the desk's TOML",
        )
    };
    let mut plan = Plan::new(channel);
    plan.at_rest = desk.at_rest;
    plan.truth = match (&desk.trajectory, desk.azimuth_deg) {
        (Some(path), Some(deg)) => {
            reads(path);
            Some(Truth { trajectory: read_trajectory(path)?, azimuth_rad: deg.to_radians() })
        }
        (None, None) => None,
        _ => usage("a desk has both `trajectory` and `azimuth_deg`, or none of them"),
    };
    Ok(plan)
}

/// Recorded logs.
fn logs(args: &Args, desk: &Desk) -> std::result::Result<(Evidence, Vec<String>), String> {
    let mut collector = Collector::new(plan(args, desk)?);
    for (side, path) in [(Side::Near, &desk.near), (Side::Far, &desk.far)] {
        let Some(path) = path else { continue };
        reads(path);
        open_log(path)?;
        let bytes = std::fs::read(path).map_err(|error| format!("{}: {error}", path.display()))?;
        collector.log(side, &bytes);
    }
    Ok((collector.finish(), vec!["backend: recorded logs".into()]))
}

/// The first two robots of a simulated room, in virtual time.
fn room(scene: &Scene) -> std::result::Result<(Evidence, Vec<String>), String> {
    let mut room = Room::new(scene).map_err(|error| error.to_string())?;
    let name = if scene.bandwidth_mhz == 40 { format!("{}+", scene.channel) } else { scene.channel.to_string() };
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
    Ok((evidence, vec![format!("backend: simulated room, scene {:?}, seed {}", scene.name, scene.seed)]))
}

/// The module's counters.
fn counters(system: &dyn System) -> Vec<(String, u64)> {
    let value = |name: &String| system.text(&format!("{COUNTERS}/{name}"))?.parse().ok();
    system.names(COUNTERS).into_iter().filter_map(|name| value(&name).map(|count| (name, count))).collect()
}

/// What runs the card, without a name or an address.
fn facts(system: &dyn System) -> Vec<String> {
    let text = |path: &str| system.text(path).unwrap_or_else(|| "-".into());
    let mut facts =
        vec!["backend: the card of this machine".to_owned(), format!("kernel: {}", text("/proc/sys/kernel/osrelease"))];
    for module in ["iwlwifi", "csi5300"] {
        let folder = format!("/sys/module/{module}/parameters");
        for name in system.names(&folder) {
            facts.push(format!("{module} {name}={}", text(&format!("{folder}/{name}"))));
        }
    }
    facts
}

/// The card of this machine, listened to while another robot sounds.
fn live(args: &Args, desk: &Desk) -> std::result::Result<(Evidence, Vec<String>), String> {
    let system = Machine;
    let span = args.listen.unwrap_or(Span::from_s(LISTEN_S));
    let mut collector = Collector::new(plan(args, desk)?);
    let signals = Signals::catch().map_err(|error| error.to_string())?;
    let listening = Listening { card: args.card.clone(), allow_user_sender: false, room: None };
    let mut listener = listening.open(Needs::default())?;
    note!(
        "{}; listening for {:.0} s while another robot sounds. Ctrl-C ends it sooner",
        describe(&listener),
        span.as_s()
    );
    let before = counters(&system);
    let clock = Monotonic::new();
    let end = clock.now() + span;
    while clock.now() < end {
        let next = listener.receive(clock.now()).map_err(|error| error.to_string())?;
        let (pending, over) = (matches!(next, Next::Pending), matches!(next, Next::End(_)));
        collector.heard(Side::Near, &next);
        if over {
            break;
        }
        if pending && wait(&clock, &listener, &signals, &mut collector, end)? {
            break;
        }
    }
    for (name, count) in counters(&system) {
        let old = before.iter().find(|(known, _)| *known == name).map_or(0, |(_, count)| *count);
        collector.counted(&name, count.wrapping_sub(old));
    }
    if collector.records() == 0 {
        note!("no record came: is another robot sounding on this channel? `csi5300 doctor` examines this one");
    }
    Ok((collector.finish(), facts(&system)))
}

/// Waits for the listener or the next wake, and notes how late it was. True where a signal ends it.
fn wait(
    clock: &Monotonic,
    listener: &csi5300_live::listener::Listener,
    signals: &Signals,
    collector: &mut Collector,
    end: Instant,
) -> std::result::Result<bool, String> {
    let wake = (clock.now() + Span::from_us(WAKE_US)).min(end);
    let until = [listener.next_at(), Some(wake)].into_iter().flatten().min();
    let ready = clock.wait([listener.as_fd(), signals.as_fd()], until).map_err(|error| error.to_string())?;
    if !ready.contains(&true)
        && let Some(until) = until
    {
        collector.woke_late(clock.now() - until);
    }
    Ok(ready[1])
}

/// The report's files, and the logs beside it.
fn write(report: &Report, evidence: &Evidence, folder: &Path) -> std::result::Result<(), String> {
    let draft = FolderDraft::new(folder)?;
    let date = evidence
        .near
        .records
        .iter()
        .find_map(|record| record.host_us)
        .map_or_else(|| "no date".into(), |us| stamp(us.div_euclid(1_000_000)));
    let json = report.json().map_err(|error| error.to_string())?;
    let files = [
        ("report.json", json.into_bytes()),
        ("report.xml", report.junit().into_bytes()),
        ("report.html", report.html().into_bytes()),
        ("bench-log.md", report.entry(&date).into_bytes()),
        ("near.dat", evidence.near.log.clone()),
        ("far.dat", evidence.far.as_ref().map(|far| far.log.clone()).unwrap_or_default()),
    ];
    for (name, bytes) in files.into_iter().filter(|(_, bytes)| !bytes.is_empty()) {
        std::fs::write(draft.path().join(name), bytes)
            .map_err(|error| draft.words(&format!("cannot write {name}: {error}")))?;
    }
    draft.keep()
}
