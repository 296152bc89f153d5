//! Commands of the previous version: they work for one more version and print their new names.

use clap::Command;
use std::ffi::{OsStr, OsString};
use std::fmt::Write;

/// An old command: its new name, the arguments that replace it, renamed options, and a required option with its
/// default.
struct Moved {
    name: &'static str,
    now: &'static str,
    args: &'static [&'static str],
    options: &'static [(&'static str, &'static str)],
    usual: Option<[&'static str; 2]>,
}

const MOVED: [Moved; 8] = [
    Moved {
        name: "plot",
        now: "info --plot DIR",
        args: &["info"],
        options: &[("--out", "--plot")],
        usual: Some(["--plot", "."]),
    },
    Moved {
        name: "report",
        now: "evaluate --html OUT.html",
        args: &["evaluate"],
        options: &[("--out", "--html"), ("-o", "--html"), ("--interactive", "")],
        usual: Some(["--html", "report.html"]),
    },
    Moved { name: "explain", now: "bearing --explain", args: &["bearing", "--explain"], options: &[], usual: None },
    Moved { name: "locate", now: "bearing", args: &["bearing"], options: &[], usual: None },
    Moved { name: "recover", now: "export --dat", args: &["export", "--dat"], options: &[], usual: None },
    Moved { name: "respond", now: "sound --answer", args: &["sound", "--answer"], options: &[], usual: None },
    Moved { name: "compare", now: "simulate", args: &["simulate"], options: &[], usual: None },
    Moved {
        name: "suite",
        now: "simulate suite",
        args: &["simulate", "suite"],
        options: &[("--csv", "--out")],
        usual: None,
    },
];

/// Where the command's name stands: behind the options of all commands.
fn place(args: &[OsString]) -> Option<usize> {
    let mut skip = false;
    let is_name = |(_, arg): &(usize, &OsString)| {
        let is_value = std::mem::take(&mut skip);
        skip = [OsStr::new("--color"), OsStr::new("--colour")].contains(&arg.as_os_str());
        !is_value && !arg.as_encoded_bytes().starts_with(b"-")
    };
    args.iter().enumerate().skip(1).find(is_name).map(|(place, _)| place)
}

/// An old option of `bearing`, and its new name.
const JOIN_ROWS: [&str; 2] = ["--join-rows", "--clock-offset=rows"];

/// Replaces an old name by the new one, and returns the note to print.
pub fn rename(args: &mut Vec<OsString>) -> Option<String> {
    let place = place(args)?;
    let said = rename_command(args, place).or_else(|| rename_option(args, place));
    let is_bearing = args.get(place).is_some_and(|name| name == "bearing");
    let old = args.iter_mut().find(|arg| is_bearing && *arg == JOIN_ROWS[0]);
    let Some(old) = old else { return said };
    *old = JOIN_ROWS[1].into();
    said.or_else(|| {
        Some(format!("`{}` is `{}` now; the next version removes the old name", JOIN_ROWS[0], JOIN_ROWS[1]))
    })
}

/// An option with a value whose name or form was another: the command, the old name, and what stands for it and its value now.
type Renamed = (&'static str, &'static str, fn(&str) -> Option<String>);

/// The records of `--stock` stand behind an equals sign, as they may be left out.
const OPTIONS: [Renamed; 3] = [
    ("doctor", "--root", |folder| Some(folder.to_owned())),
    ("record", "--records", |count| Some(format!("--stop-after={count}records"))),
    ("record", "--stock", |records| {
        let is_named = ["wsr", "wsr-frames", "csitool", "csitool-frames"].contains(&records);
        is_named.then(|| format!("--stock={records}"))
    }),
];

fn rename_option(args: &mut Vec<OsString>, place: usize) -> Option<String> {
    let own = OPTIONS.iter().filter(|(command, ..)| args.get(place).is_some_and(|name| name == command));
    let renamed = |(_, old, new): &Renamed| {
        let at = args.iter().position(|arg| arg.to_str().is_some_and(|arg| arg.split('=').next() == Some(*old)))?;
        let text = args.get(at)?.to_str()?;
        let (last, value) = match text.split_once('=') {
            Some((_, value)) => (at, value),
            None => (at + 1, args.get(at + 1)?.to_str()?),
        };
        let new = new(value).filter(|new| new != text)?;
        Some((at..=last, format!("{old} {value}"), new))
    };
    let (at, old, new) = own.into_iter().find_map(renamed)?;
    drop(args.splice(at, [OsString::from(&new)]));
    Some(format!("`{old}` is `{new}` now; the next version removes the old form"))
}

fn rename_command(args: &mut Vec<OsString>, place: usize) -> Option<String> {
    let moved = MOVED.iter().find(|moved| args.get(place).is_some_and(|name| name == moved.name))?;
    let rest: Vec<OsString> = args.split_off(place + 1);
    args.pop();
    args.extend(moved.args.iter().map(OsString::from));
    args.extend(rest.into_iter().filter_map(|arg| renamed(moved, arg)));
    if let Some([option, value]) = moved.usual
        && !args.iter().any(|arg| arg.to_str().is_some_and(|arg| arg.split('=').next() == Some(option)))
    {
        args.extend([option, value].map(OsString::from));
    }
    Some(format!("`csi5300 {}` is `csi5300 {}` now; the next version removes the old name", moved.name, moved.now))
}

/// The present name of an argument; `None` if it has no meaning any more.
fn renamed(moved: &Moved, arg: OsString) -> Option<OsString> {
    let Some(text) = arg.to_str() else { return Some(arg) };
    let (name, value) = text.split_once('=').map_or((text, None), |(name, value)| (name, Some(value)));
    match moved.options.iter().find(|(old, _)| *old == name) {
        None => Some(arg),
        Some((_, "")) => None,
        Some((_, new)) => Some(value.map_or_else(|| (*new).into(), |value| format!("{new}={value}").into())),
    }
}

/// Every command, hidden ones too, and what became of old ones.
pub fn all(cli: &Command) -> String {
    let mut text = String::new();
    for hidden in [false, true] {
        text += if hidden { "\nSeldom needed:\n" } else { "Commands:\n" };
        for one in cli.get_subcommands().filter(|one| one.is_hide_set() == hidden) {
            let about = one.get_about().map(ToString::to_string).unwrap_or_default();
            let _ = writeln!(text, "  {:<12} {about}", one.get_name());
        }
    }
    text += "\nNames of the version before, until the next version:\n";
    for Moved { name, now, .. } in &MOVED {
        let _ = writeln!(text, "  {name:<12} csi5300 {now}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn now(words: &str) -> (String, bool) {
        let mut args: Vec<OsString> = words.split(' ').map(OsString::from).collect();
        let said = rename(&mut args).is_some();
        (args.iter().map(|arg| arg.to_string_lossy().into_owned()).collect::<Vec<_>>().join(" "), said)
    }

    #[test]
    fn old_names_are_what_they_are_now_and_others_stay() {
        for (old, new) in [
            ("csi5300 plot a.dat --out=p", "csi5300 info a.dat --plot=p"),
            ("csi5300 plot a.dat", "csi5300 info a.dat --plot ."),
            ("csi5300 -q report d -o r.html --interactive", "csi5300 -q evaluate d --html r.html"),
            ("csi5300 --color never explain d/tx2 --out p", "csi5300 --color never bearing --explain d/tx2 --out p"),
            ("csi5300 recover a b", "csi5300 export --dat a b"),
            ("csi5300 bearing --join-rows --rx a", "csi5300 bearing --clock-offset=rows --rx a"),
            ("csi5300 suite --csv t", "csi5300 simulate suite --out t"),
            ("csi5300 doctor --root d --json", "csi5300 doctor d --json"),
            ("csi5300 doctor --root=d", "csi5300 doctor d"),
            ("csi5300 record a.dat --records 500 -q", "csi5300 record a.dat --stop-after=500records -q"),
            ("csi5300 record --records=500 a.dat", "csi5300 record --stop-after=500records a.dat"),
            ("csi5300 record --stock csitool a.dat", "csi5300 record --stock=csitool a.dat"),
        ] {
            assert_eq!(now(old), (new.into(), true), "{old}");
        }
        for same in [
            "csi5300 info plot",
            "csi5300 --color plot info",
            "csi5300",
            "csi5300 bearing --out plot",
            "csi5300 record --stock a.dat",
        ] {
            assert_eq!(now(same), (same.into(), false));
        }
    }
}
