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
    let said = rename_command(args, place).or_else(|| without_root(args, place)).or_else(|| of_record(args, place));
    let is_bearing = args.get(place).is_some_and(|name| name == "bearing");
    let old = args.iter_mut().find(|arg| is_bearing && *arg == JOIN_ROWS[0]);
    let Some(old) = old else { return said };
    *old = JOIN_ROWS[1].into();
    said.or_else(|| {
        Some(format!("`{}` is `{}` now; the next version removes the old name", JOIN_ROWS[0], JOIN_ROWS[1]))
    })
}

/// `doctor --root DIR` is `doctor DIR`.
fn without_root(args: &mut Vec<OsString>, place: usize) -> Option<String> {
    const OLD: &str = "--root";
    let is_root = |arg: &OsString| arg.to_str().is_some_and(|arg| arg.split('=').next() == Some(OLD));
    let at = args.iter().position(is_root).filter(|_| args.get(place).is_some_and(|name| name == "doctor"))?;
    let value = args.get(at)?.to_str()?.split_once('=').map(|(_, value)| OsString::from(value));
    match (value, args.get_mut(at)) {
        (Some(value), Some(arg)) => *arg = value,
        _ => drop(args.remove(at)),
    }
    Some(format!("`doctor {OLD} DIR` is `doctor DIR` now; the next version removes the old name"))
}

/// `record --records N` is `record --stop-after Nrecords`; and the records of `--stock` stand behind an equals sign, as a value may
/// be left out.
fn of_record(args: &mut Vec<OsString>, place: usize) -> Option<String> {
    const RECORDS: [&str; 4] = ["wsr", "wsr-frames", "csitool", "csitool-frames"];
    args.get(place).filter(|name| *name == "record")?;
    let option =
        |name: &str| args.iter().position(|arg| arg.to_str().is_some_and(|arg| arg.split('=').next() == Some(name)));
    if let Some(at) = option("--records") {
        let text = args.get(at)?.to_str()?;
        let count = match text.split_once('=') {
            Some((_, count)) => count.to_owned(),
            None => args.get(at + 1)?.to_str()?.to_owned(),
        };
        let last = if text.contains('=') { at } else { at + 1 };
        drop(args.splice(at..=last, [OsString::from(format!("--stop-after={count}records"))]));
        return Some(format!(
            "`--records {count}` is `--stop-after {count}records` now; the old name goes with the next version"
        ));
    }
    let at = option("--stock").filter(|at| args.get(*at).is_some_and(|arg| arg == "--stock"))?;
    let value = args.get(at + 1)?.to_str().filter(|value| RECORDS.contains(value))?.to_owned();
    drop(args.splice(at..=at + 1, [OsString::from(format!("--stock={value}"))]));
    Some(format!("`--stock {value}` is read as `--stock={value}`: a log of that name is `./{value}`"))
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
