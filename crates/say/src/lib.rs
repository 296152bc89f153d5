//! Output of the programs: results on standard output, notes and errors on standard error, exit statuses. Control characters
//! in names are escaped.

use std::borrow::Cow;
use std::fmt::{Arguments, Write as _};
use std::io::{IsTerminal, Write};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};

/// How much is printed: errors only, notes too, or also what was read, and the time and memory used.
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

impl Level {
    /// The level of the options `--quiet` and `--verbose`.
    #[must_use]
    pub fn of(quiet: bool, verbose: bool) -> Self {
        match (quiet, verbose) {
            (true, _) => Self::Quiet,
            (false, false) => Self::Usual,
            (false, true) => Self::Verbose,
        }
    }
}

/// When output is coloured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum When {
    /// On a terminal, unless NO_COLOR is set or TERM is `dumb`.
    #[default]
    Auto,
    /// Always.
    Always,
    /// Never.
    Never,
}

impl When {
    /// All names.
    pub const NAMES: [&str; 3] = ["auto", "always", "never"];

    /// The choice of that name, or the default.
    #[must_use]
    pub fn named(name: &str) -> Self {
        match name {
            "always" => Self::Always,
            "never" => Self::Never,
            _ => Self::Auto,
        }
    }
}

/// The meaning of a word's colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tone {
    /// Good.
    Good,
    /// Doubtful.
    Doubt,
    /// Bad.
    Bad,
}

const GREEN: &str = "\x1b[1;32m";
const YELLOW: &str = "\x1b[1;33m";
const RED: &str = "\x1b[1;31m";
const PLAIN: &str = "\x1b[0m";

static LEVEL: AtomicU8 = AtomicU8::new(Level::Usual as u8);
/// Whether standard output and standard error are coloured.
static COLOURED: [AtomicBool; 2] = [AtomicBool::new(false), AtomicBool::new(false)];

/// The program's name in errors.
static PROGRAM: OnceLock<&'static str> = OnceLock::new();

/// Sets the output options for the rest of the program `name`.
pub fn set(name: &'static str, level: Level, colours: When) {
    let _ = PROGRAM.set(name);
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

/// Names that contain line ends, and their parts.
static NAMES: Mutex<Vec<String>> = Mutex::new(Vec::new());

/// Names that the program was given or found in folders: from now on, line ends in them are escaped.
pub fn add_names(names: impl Iterator<Item = std::ffi::OsString>) {
    let names = names.map(|one| one.to_string_lossy().into_owned()).filter(|one| one.contains('\n'));
    let parts = |name: String| {
        let last = name.rsplit('/').next().unwrap_or_default().to_owned();
        let stem = last.rsplit_once('.').map_or(String::new(), |(stem, _)| stem.to_owned());
        [name, last, stem]
    };
    let parts = names.flat_map(parts).filter(|part| part.contains('\n'));
    NAMES.lock().unwrap_or_else(PoisonError::into_inner).extend(parts);
}

/// True if this much is printed.
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
        Tone::Doubt => YELLOW,
        Tone::Bad => RED,
    };
    if wanted.load(Ordering::Relaxed) { format!("{code}{word}{PLAIN}") } else { word.to_owned() }
}

/// A text for a terminal. Control characters from the names of files, topics and links are escaped as in JSON (`\u001b`);
/// line ends, tabs and this program's colours stay. No name can clear or rename a terminal, or answer for it.
///
/// Line ends in names ([`add_names`]) are escaped, too.
pub fn printable(text: &str) -> Cow<'_, str> {
    let names = NAMES.lock().unwrap_or_else(PoisonError::into_inner);
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

/// Characters that reverse the direction of text or are invisible: with them a name can look like another.
fn turns_writing(sign: char) -> bool {
    matches!(sign, '\u{61c}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{2069}' | '\u{feff}')
}

/// Prints to standard error; if it is closed, nobody is there to read.
pub fn words(level: Level, words: Arguments<'_>) {
    if says(level) {
        // In one piece: standard error writes each part of a text separately.
        let _ = std::io::stderr().lock().write_all(printable(&words.to_string()).as_bytes());
    }
}

/// Prints an error, one line.
pub fn error(words: Arguments<'_>) {
    let name = format!("{}:", PROGRAM.get().copied().unwrap_or("csi5300"));
    let name = coloured(&name, Tone::Bad, &COLOURED[1]);
    let _ = writeln!(std::io::stderr().lock(), "{name} {}", printable(&words.to_string()));
}

/// Prints a hint, one line; not with `--quiet`.
#[macro_export]
macro_rules! note {
    ($($words:tt)*) => {{
        $crate::words($crate::Level::Usual, format_args!("{}\n", format_args!($($words)*)))
    }};
}

/// Prints hints of several lines, each with its line end.
#[macro_export]
macro_rules! notes {
    ($($words:tt)*) => {{
        $crate::words($crate::Level::Usual, format_args!($($words)*))
    }};
}

/// Prints one line with `--verbose`.
#[macro_export]
macro_rules! detail {
    ($($words:tt)*) => {{
        $crate::words($crate::Level::Verbose, format_args!("{}\n", format_args!($($words)*)))
    }};
}

/// Prints an error, one line.
#[macro_export]
macro_rules! wrong {
    ($($words:tt)*) => {{ $crate::error(format_args!($($words)*)) }};
}

/// Exit status of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Done; a cut last record is the normal end of a log that was killed.
    Done,
    /// Done, but records were dropped or damaged before the tail, rows of a trajectory were unreadable, or a link or capture
    /// failed.
    DataLost,
    /// Nothing usable.
    Nothing,
}

impl Outcome {
    /// The outcome if anything usable was read or made, and if anything was lost.
    #[must_use]
    pub fn of(usable: bool, lost: bool) -> Self {
        match (usable, lost) {
            (false, _) => Self::Nothing,
            (true, true) => Self::DataLost,
            (true, false) => Self::Done,
        }
    }
}

impl From<Outcome> for ExitCode {
    fn from(outcome: Outcome) -> Self {
        Self::from(match outcome {
            Outcome::Done => 0,
            Outcome::Nothing => 1,
            Outcome::DataLost => 3,
        })
    }
}

/// A command's result: its outcome, or an error for the user.
pub type Result = std::result::Result<Outcome, String>;

/// Ends the command with the exit status for wrong usage, as the argument parser does.
pub fn usage(message: &str) -> ! {
    wrong!("{message}");
    std::process::exit(2);
}

/// Prints the parser's message about arguments (or `--help`) and ends the program. Parsers repeat arguments as they are;
/// where nothing needs escaping, `plainly` prints it.
pub fn misused(words: &str, status: i32, plainly: impl FnOnce() -> std::convert::Infallible) -> ! {
    if let Cow::Owned(shown) = printable(words) {
        notes!("{shown}");
        std::process::exit(status);
    }
    match plainly() {}
}

/// Prints to standard output. A closed reader (`| head`) ends the command quietly; a full disk is an error.
pub fn print(text: &str) {
    match std::io::stdout().write_all(printable(text).as_bytes()) {
        Ok(()) => {}
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => std::process::exit(0),
        Err(error) => {
            wrong!("standard output: {error}");
            std::process::exit(1);
        }
    }
}

/// True if an error of a served room's sockets means that the room has ended, which is normal.
pub fn is_end_of_room(error: &(dyn std::error::Error + 'static)) -> bool {
    use std::io::ErrorKind;
    let mut cause = Some(error);
    while let Some(error) = cause {
        if let Some(error) = error.downcast_ref::<std::io::Error>() {
            let ended = [ErrorKind::UnexpectedEof, ErrorKind::BrokenPipe, ErrorKind::ConnectionReset];
            return ended.contains(&error.kind());
        }
        cause = error.source();
    }
    false
}

/// Prints one value as a line of JSON.
pub fn print_json(value: &impl serde::Serialize) {
    match serde_json::to_string(value) {
        Ok(line) => print(&format!("{line}\n")),
        Err(error) => wrong!("{error}"),
    }
}

/// A count and its noun: `1 number`, `2 numbers`.
#[must_use]
pub fn count(count: u64, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

/// A number with this many decimals; what rounds to zero has no sign.
#[must_use]
pub fn fixed(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    match text.strip_prefix('-') {
        Some(size) if size.bytes().all(|byte| matches!(byte, b'0' | b'.')) => size.to_owned(),
        _ => text,
    }
}

/// The end of a program that began at `begun`: prints what it used and the error, if there is one.
pub fn ended(begun: std::time::Instant, result: Result) -> ExitCode {
    detail!("{}", used(begun));
    let outcome = result.unwrap_or_else(|message| {
        wrong!("{message}");
        Outcome::Nothing
    });
    outcome.into()
}

/// Time since `begun`, seconds, and peak memory, megabytes, of this process.
fn used(begun: std::time::Instant) -> String {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak =
        status.lines().find_map(|line| line.strip_prefix("VmHWM:")?.split_whitespace().next()?.parse::<f64>().ok());
    let memory = peak.map_or(String::new(), |kib| format!(", {:.0} MB of memory", kib * 1.024e-3));
    format!("{:.2} s{memory}", begun.elapsed().as_secs_f64())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_are_escaped() {
        let name = "a\x1b[2J\x07\r\u{9b}1m\u{7f}\x1b]0;mine\x1b";
        assert_eq!(printable(name), "a\\u001b[2J\\u0007\\u000d\\u009b1m\\u007f\\u001b]0;mine\\u001b");
        assert_eq!(printable("log\u{202e}tad.dat"), "log\\u202etad.dat");
        for good in ["", "two\nlines\tand \u{e4}\u{4e2d}", &format!("{RED}BAD{YELLOW}?\x1b[0m\n")] {
            assert_eq!(printable(good), *good);
        }
    }

    #[test]
    fn one_is_singular() {
        let said = [0, 1, 2].map(|n| count(n, "stretch", "stretches"));
        assert_eq!(said, ["0 stretches", "1 stretch", "2 stretches"]);
    }

    #[test]
    fn what_rounds_to_zero_has_no_sign() {
        assert_eq!([-1e-17, -0.0, -0.004, 0.0].map(|value| fixed(value, 2)), ["0.00"; 4]);
        assert_eq!([-0.006, -1.0, 12.345].map(|value| fixed(value, 2)), ["-0.01", "-1.00", "12.35"]);
        assert_eq!([-0.4, -0.6].map(|value| fixed(value, 0)), ["0", "-1"]);
        assert_eq!([f64::NAN, f64::NEG_INFINITY].map(|value| fixed(value, 1)), ["NaN", "-inf"]);
    }
}
