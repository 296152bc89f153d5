//! `csi5300 doctor`.

mod accept;

use super::live::{Card, Listening, Needs, Signals, duration};
use super::{InWords, Outcome, Result, Words, print, print_json, usage};
use csi5300::signal::channel::Channel;
use csi5300::source::{CsiSource, Next};
use csi5300::time::Span;
use csi5300_live::doctor::{Check, Machine, Reception, System, Tree, Verdict, examine};
use csi5300_live::listener::Listener;
use csi5300_live::wait::Monotonic;
use csi5300_say::{Tone, toned};
use std::fmt::Write;
use std::os::fd::AsFd;
use std::path::PathBuf;

// Arguments of `doctor`.
#[derive(clap::Args)]
pub struct Args {
    /// Print JSON, one object a line (docs/reference/formats.md)
    #[arg(long)]
    json: bool,
    /// Also listen for this long and report what comes
    #[arg(long, value_parser = duration, value_name = "TIME")]
    listen: Option<Span>,
    /// A copy of another machine's files (sys, proc, lib), checked instead of this machine. With --accept: one or two logs,
    /// a scene, or a TOML file that describes the desk [default: this machine and its card]
    #[arg(value_name = "WHAT")]
    what: Vec<PathBuf>,
    /// Judge claims about card, driver and host (20 s with a card; a log at once)
    #[arg(long)]
    accept: bool,
    /// WiFi channel of the cards, for --accept
    #[arg(long, value_name = "CHANNEL", requires = "accept")]
    channel: Option<Channel>,
    /// Also write the verdicts into this folder: HTML, JSON, JUnit XML, an entry for the bench log, the logs
    #[arg(long, value_name = "DIR", requires = "accept")]
    report: Option<PathBuf>,
    #[command(flatten)]
    card: Card,
}

#[derive(serde::Serialize)]
struct Report<'a> {
    ready: bool,
    checks: &'a [Check],
}

/// Examines the machine.
pub fn run(args: &Args) -> Result {
    if args.accept {
        return accept::run(args);
    }
    let system: Box<dyn System> = match args.what.as_slice() {
        [] => Box::new(Machine),
        [root] if root.is_dir() => Box::new(Tree(root.clone())),
        [root] => return Err(format!("{} is no folder; to judge a log, add --accept", root.display())),
        _ => usage("the doctor looks at one machine; to judge the logs of two robots, add --accept"),
    };
    if args.listen.is_some() && !args.what.is_empty() {
        usage("--listen hears the card of this machine, not of a copy");
    }
    if args.listen.is_none() && args.card.is_named() {
        usage("--connector-index and --stock belong to --listen or --accept");
    }
    let mut checks = examine(system.as_ref());
    if let Some(span) = args.listen {
        checks.extend(listen(args, span)?);
    }
    let ready = !checks.iter().any(|check| check.verdict == Verdict::Bad);
    if args.json {
        print_json(&Report { ready, checks: &checks });
    } else {
        print(&text(&checks, ready));
    }
    Ok(if ready { Outcome::Done } else { Outcome::Nothing })
}

fn text(checks: &[Check], ready: bool) -> String {
    let mut text = String::new();
    for check in checks {
        let mark = match check.verdict {
            Verdict::Good => toned("ok  ", Tone::Good),
            Verdict::Doubt => toned("?   ", Tone::Doubt),
            Verdict::Bad => toned("BAD ", Tone::Bad),
            Verdict::Unknown => "-   ".into(),
        };
        let _ = writeln!(text, "{mark}{}: {}", check.name, check.found);
        if check.verdict != Verdict::Good {
            let _ = writeln!(text, "      expected: {}", check.expected);
        }
        if let Some(mend) = &check.mend {
            let _ = writeln!(text, "      try: {mend}");
        }
    }
    let bad = checks.iter().filter(|check| check.verdict == Verdict::Bad).count();
    let _ = match ready {
        true => writeln!(text, "\nno problem found"),
        false => writeln!(text, "\n{bad} in the way; repair them from the top, then run the doctor again"),
    };
    text
}

fn listen(args: &Args, span: Span) -> Words<Vec<Check>> {
    let signals = Signals::catch().in_words()?;
    let mut heard = Reception::default();
    let listening = Listening { card: args.card.clone(), allow_user_sender: false, room: None };
    let mut listener = match listening.open(Needs::default()) {
        Ok(listener) => listener,
        Err(message) => {
            return Ok(vec![Check {
                name: "listener",
                verdict: Verdict::Bad,
                found: message,
                expected: "the card's records".into(),
                mend: None,
            }]);
        }
    };
    note!("{}", listener.describe());
    let clock = Monotonic::new();
    let end = clock.now() + span;
    while clock.now() < end {
        let next = listener.receive(clock.now()).in_words()?;
        heard.note(&next);
        if matches!(next, Next::Pending) {
            let until = [listener.next_at(), Some(end)].into_iter().flatten().min();
            let ready = clock.wait([listener.as_fd(), signals.as_fd()], until).in_words()?;
            if ready[1] {
                break;
            }
        }
    }
    let mut checks = heard.checks();
    let refused = if let Listener::Connector(listener) = &listener { listener.counters().user_senders } else { 0 };
    if refused > 0 {
        checks.push(Check {
            name: "other senders",
            verdict: Verdict::Doubt,
            found: format!("{refused} messages came from a program, not from the kernel"),
            expected: "the driver's messages".into(),
            mend: Some("`csi5300 record --allow-user-sender` accepts them, for emulators".into()),
        });
    }
    Ok(checks)
}
