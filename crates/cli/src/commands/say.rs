//! What is said beside results, on standard error: how much of it, and in which colours.

use std::borrow::Cow;
use std::fmt::{Arguments, Write as _};
use std::io::{IsTerminal, Write};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};

/// How much is said: errors only, notes too, or also what was read, how long it took and how much memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Level {
    /// Errors.
    Quiet,
    /// Errors and notes.
    Usual,
    /// Everything.
    Verbose,
}

/// When words are coloured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum When {
    /// On a terminal, unless NO_COLOR is set or TERM is `dumb`
    #[default]
    Auto,
    /// Always
    Always,
    /// Never
    Never,
}

/// How a word is meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tone {
    /// As it should be.
    Good,
    /// Perhaps not.
    #[cfg(feature = "live")]
    Doubt,
    /// Not as it should be.
    Bad,
}

const GREEN: &str = "\x1b[1;32m";
const YELLOW: &str = "\x1b[1;33m";
const RED: &str = "\x1b[1;31m";
const PLAIN: &str = "\x1b[0m";

static LEVEL: AtomicU8 = AtomicU8::new(Level::Usual as u8);
/// Whether words on standard output and on standard error are coloured.
static COLOURED: [AtomicBool; 2] = [AtomicBool::new(false), AtomicBool::new(false)];

/// What was asked for, for the rest of the program.
pub fn set(level: Level, colours: When) {
    LEVEL.store(level as u8, Ordering::Relaxed);
    let terminals = [std::io::stdout().is_terminal(), std::io::stderr().is_terminal()];
    for (coloured, is_terminal) in COLOURED.iter().zip(terminals) {
        let variable = |name: &str| std::env::var_os(name).unwrap_or_default();
        let wanted = match colours {
            When::Auto => is_terminal && variable("NO_COLOR").is_empty() && variable("TERM") != "dumb",
            When::Always => true,
            When::Never => false,
        };
        coloured.store(wanted, Ordering::Relaxed);
    }
}

/// Names with ends of lines in them, among the arguments and their parts.
static NAMES: OnceLock<Vec<String>> = OnceLock::new();

/// The names that the program was given.
pub fn set_names(arguments: impl Iterator<Item = std::ffi::OsString>) {
    let names = arguments.map(|one| one.to_string_lossy().into_owned()).filter(|one| one.contains('\n'));
    let parts = |name: String| {
        let last = name.rsplit('/').next().unwrap_or_default().to_owned();
        let stem = last.rsplit_once('.').map_or(String::new(), |(stem, _)| stem.to_owned());
        [name, last, stem]
    };
    let _ = NAMES.set(names.flat_map(parts).filter(|part| part.contains('\n')).collect());
}

/// True if so much is said.
pub fn says(level: Level) -> bool {
    LEVEL.load(Ordering::Relaxed) >= level as u8
}

/// A word of a result in its colour, if results are coloured.
pub fn toned(word: &str, tone: Tone) -> String {
    coloured(word, tone, &COLOURED[0])
}

fn coloured(word: &str, tone: Tone, wanted: &AtomicBool) -> String {
    let code = match tone {
        Tone::Good => GREEN,
        #[cfg(feature = "live")]
        Tone::Doubt => YELLOW,
        Tone::Bad => RED,
    };
    if wanted.load(Ordering::Relaxed) { format!("{code}{word}{PLAIN}") } else { word.to_owned() }
}

/// A text as it may go to a terminal: what names of files, topics and links have of control characters is written as JSON writes
/// it (`\u001b`), ends of lines, tabs and our own colours stay. A name cannot clear, rename or answer for a terminal.
///
/// Ends of lines that are in the names that the program was given are written out, too.
pub fn printable(text: &str) -> Cow<'_, str> {
    let names = NAMES.get().map(Vec::as_slice).unwrap_or_default();
    if names.iter().any(|name| text.contains(name.as_str())) {
        let whole = names.iter().fold(text.to_owned(), |text, name| text.replace(name, &name.replace('\n', "\\n")));
        return Cow::Owned(without_signs(&whole).into_owned());
    }
    without_signs(text)
}

fn without_signs(text: &str) -> Cow<'_, str> {
    let is_told = |sign: char| (sign.is_control() && !matches!(sign, '\n' | '\t')) || turns_writing(sign);
    if !text.contains(is_told) {
        return Cow::Borrowed(text);
    }
    let (mut shown, mut rest) = (String::with_capacity(text.len() + 16), text);
    while let Some(at) = rest.find(is_told) {
        let (before, from) = rest.split_at(at);
        shown.push_str(before);
        let own = [GREEN, YELLOW, RED, PLAIN].into_iter().find(|code| from.starts_with(code));
        let sign = from.chars().next().unwrap_or_default();
        match own {
            Some(code) => shown.push_str(code),
            None => _ = write!(shown, "\\u{:04x}", u32::from(sign)),
        }
        rest = from.get(own.map_or(sign.len_utf8(), str::len)..).unwrap_or_default();
    }
    shown.push_str(rest);
    Cow::Owned(shown)
}

/// Signs that turn the direction of what is written behind them, or hide in it: a name can look like another one by them.
fn turns_writing(sign: char) -> bool {
    matches!(sign, '\u{61c}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{2069}' | '\u{feff}')
}

/// Says something. Where standard error is closed there is nobody to be told.
pub fn words(level: Level, words: Arguments<'_>) {
    if says(level) {
        // In one piece: standard error writes each part of a text by itself.
        let _ = std::io::stderr().lock().write_all(printable(&words.to_string()).as_bytes());
    }
}

/// Says what went wrong, a line.
pub fn error(words: Arguments<'_>) {
    let name = coloured("csi5300:", Tone::Bad, &COLOURED[1]);
    let _ = writeln!(std::io::stderr().lock(), "{name} {}", printable(&words.to_string()));
}

/// A line of what may help: not said with `--quiet`.
macro_rules! note {
    ($($words:tt)*) => {{
        $crate::commands::say::words($crate::commands::say::Level::Usual, format_args!("{}\n", format_args!($($words)*)))
    }};
}

/// Lines of what may help, each with its end.
macro_rules! notes {
    ($($words:tt)*) => {{
        $crate::commands::say::words($crate::commands::say::Level::Usual, format_args!($($words)*))
    }};
}

/// A line that is said with `--verbose`.
macro_rules! detail {
    ($($words:tt)*) => {{
        $crate::commands::say::words($crate::commands::say::Level::Verbose, format_args!("{}\n", format_args!($($words)*)))
    }};
}

/// A line of what went wrong.
macro_rules! wrong {
    ($($words:tt)*) => {{ $crate::commands::say::error(format_args!($($words)*)) }};
}

/// What this process has used so far: seconds since `begun`, and the most memory, megabytes.
pub fn used(begun: std::time::Instant) -> String {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak =
        status.lines().find_map(|line| line.strip_prefix("VmHWM:")?.split_whitespace().next()?.parse::<f64>().ok());
    let memory = peak.map_or(String::new(), |kib| format!(", {:.0} MB of memory", kib * 1.024e-3));
    format!("{:.2} s{memory}", begun.elapsed().as_secs_f64())
}

#[cfg(test)]
mod tests {
    use super::{RED, YELLOW, printable};

    #[test]
    fn what_would_command_a_terminal_is_written_out() {
        let name = "a\x1b[2J\x07\r\u{9b}1m\u{7f}\x1b]0;mine\x1b";
        assert_eq!(printable(name), "a\\u001b[2J\\u0007\\u000d\\u009b1m\\u007f\\u001b]0;mine\\u001b");
        assert_eq!(printable("log\u{202e}tad.dat"), "log\\u202etad.dat");
        for good in ["", "two\nlines\tand \u{e4}\u{4e2d}", &format!("{RED}BAD{YELLOW}?\x1b[0m\n")] {
            assert_eq!(printable(good), *good);
        }
    }
}
