//! `csi5300 info`.

use super::args::antenna;
use super::{InWords, Outcome, Result, Words, draft, files, hint, print, print_json, some, usage};
use csi_formats::{Format, Items};
use csi5300::internal::{LOSSES_KEPT, SENDERS_KEPT};
use csi5300::source::survey::{ClockSteps, HostSteps, Sender, Survey, TimeBase};
use csi5300::source::{Checks, CsiSource, Next};
use csi5300::time::Instant;
use csi5300_lab::cards::{self, CardSurvey};
use csi5300_lab::course::{Course, Wanted};
use csi5300_lab::show::file_safe;
use csi5300_lab::show::log::LogPictures;
use csi5300_lab::table::Filter;
use csi5300_live::doctor::is_silent;
use csi5300_say::{Level, says};
use driver_iface::Mac;
use driver_iface::bfee::{Antenna, rate};
use driver_iface::record::{Tail, code};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};

// Arguments of `info`.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  csi5300 info rx.dat --plot pictures --antenna A --from 2 --to 8")]
pub struct Args {
    /// Logs, or folders of logs; - is standard input
    #[arg(required = true, value_name = "LOG")]
    files: Vec<PathBuf>,
    /// Print JSON, one object a line (docs/reference/formats.md)
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    plot: Pictures,
}

#[derive(serde::Serialize)]
struct SenderRow<'a> {
    rate_hz: Option<f64>,
    median_rate_hz: Option<f64>,
    /// Frame numbers only.
    frame_count: Option<(u32, u32)>,
    frames_skipped: Option<u64>,
    frames_repeated: Option<u64>,
    frames_restarted: Option<u64>,
    records: u64,
    clock_steps: &'a ClockSteps,
}

impl<'a> SenderRow<'a> {
    fn new(sender: &'a Sender) -> Self {
        let counted = |count: u64| sender.counts_up().then_some(count);
        Self {
            rate_hz: sender.mean_rate_hz(),
            median_rate_hz: sender.rate_hz(),
            frame_count: sender.frame_count.filter(|_| sender.counts_up()),
            frames_skipped: counted(sender.frames_skipped),
            frames_repeated: counted(sender.frames_repeated),
            frames_restarted: counted(sender.frames_restarted),
            records: sender.records,
            clock_steps: &sender.clock_steps,
        }
    }
}

#[derive(serde::Serialize)]
struct Row<'a> {
    file: String,
    bytes: u64,
    tail: String,
    cut: bool,
    /// The clock that its times are of.
    time_base: TimeBase,
    senders: std::collections::BTreeMap<String, SenderRow<'a>>,
    /// Results of the side file's checksums; null without them.
    checks: Option<Checks>,
    /// The pictures drawn.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pictures: Vec<PathBuf>,
    /// Records whose CSI is all zeros.
    silent: u64,
    #[serde(flatten)]
    survey: &'a Survey,
}

/// Describes logs.
pub fn run(args: &Args) -> Result {
    if let Err(error) = Filter::default().with_time(args.plot.from, args.plot.to) {
        usage(&error);
    }
    if args.files.iter().filter(|path| path.as_os_str() == "-").count() > 1 {
        usage("standard input can be one log only");
    }
    let (mut usable, mut lost, mut failed) = (false, false, false);
    let files = logs(&args.files)?;
    let stem = |log: &PathBuf| log.file_stem().map_or("log".into(), |stem| stem.to_string_lossy().into_owned());
    let names = files::told_apart(files.iter().map(stem).collect());
    for (k, (path, name)) in files.iter().zip(&names).enumerate() {
        if let Some((format, bytes)) = cards::read(path) {
            let mut row = OtherRow::new(path, format, &bytes);
            row.pictures = drawn(args, path, name, &mut failed);
            row.show(args.json, k > 0);
            let has_frames = row.survey.frames > 0;
            usable |= has_frames;
            lost |= row.survey.is_damaged || !has_frames;
            continue;
        }
        match survey(path) {
            Ok(read) => {
                let pictures = drawn(args, path, name, &mut failed);
                if args.json {
                    print_json(&row(path, &read, pictures));
                } else {
                    print(&format!(
                        "{}{}",
                        if k == 0 { "" } else { "\n" },
                        describe(&path.display().to_string(), &read)
                    ));
                }
                let survey = &read.survey;
                let has_csi = survey.bfees() > read.silent;
                usable |= has_csi;
                lost |= !has_csi
                    || survey.lost_something()
                    || read.checks.is_some_and(|checks| checks.missing > 0 || checks.out_of_step);
            }
            Err(message) => {
                failed = true;
                wrong!("{message}");
            }
        }
    }
    Ok(Outcome::of(usable, lost || failed))
}

/// The logs in place of each folder, by their names.
fn logs(named: &[PathBuf]) -> Words<Vec<PathBuf>> {
    let mut all = Vec::new();
    for path in named {
        if !path.is_dir() {
            all.push(path.clone());
            continue;
        }
        let entries = std::fs::read_dir(path).map_err(|error| format!("{}: {error}", path.display()))?;
        let files = entries.flatten().map(|entry| entry.path()).filter(|path| path.is_file());
        let mut found: Vec<PathBuf> = files.filter(|path| csi5300_lab::cards::is_named_as_log(path)).collect();
        if found.is_empty() {
            let why = "no log in this folder (.dat; of other cards .csi, .pcap or .csv): name one, or the folder that holds some";
            return Err(format!("{}: {why}", path.display()));
        }
        found.sort();
        all.append(&mut found);
    }
    Ok(all)
}

/// The requested pictures of a log. Prints the error if they cannot be drawn.
fn drawn(args: &Args, log: &Path, name: &str, failed: &mut bool) -> Vec<PathBuf> {
    let drawn = draw_pictures(&args.plot, log, name).unwrap_or_else(|message| {
        *failed = true;
        wrong!("{message}");
        Vec::new()
    });
    drawn.iter().filter(|_| !args.json).for_each(|path| note!("{}", path.display()));
    drawn
}

/// A log that was read.
struct Read {
    survey: Survey,
    bytes: u64,
    checks: Option<Checks>,
    /// Records whose CSI is all zeros.
    silent: u64,
}

fn survey(path: &Path) -> Words<Read> {
    let mut source = super::open_log(path)?;
    let (mut survey, mut silent) = (Survey::default(), 0);
    loop {
        let next = source.receive(Instant::ZERO).in_words()?;
        silent += u64::from(survey.note(&next).is_some_and(|(bfee, _)| is_silent(&bfee)));
        if matches!(next, Next::End(_)) {
            return Ok(Read { survey, bytes: source.bytes(), checks: source.checks(), silent });
        }
    }
}

fn row<'a>(path: &Path, read: &'a Read, pictures: Vec<PathBuf>) -> Row<'a> {
    let Read { survey, bytes, checks, silent } = read;
    let sender = |(mac, sender): (&Mac, &'a Sender)| (mac.to_string(), SenderRow::new(sender));
    Row {
        file: path.display().to_string(),
        bytes: *bytes,
        tail: tail_words(survey, *bytes),
        time_base: survey.time_base(),
        cut: survey.tail.is_some_and(|tail| !matches!(tail, Tail::Clean)),
        senders: survey.senders.iter().map(sender).collect(),
        checks: *checks,
        pictures,
        silent: *silent,
        survey,
    }
}

fn tail_words(survey: &Survey, bytes: u64) -> String {
    match survey.tail {
        None | Some(Tail::Clean) => "ends with a whole record".into(),
        Some(tail @ Tail::Cut { offset, bytes: left, expected }) => {
            let expected = expected.map_or(String::new(), |expected| format!(" of {expected}"));
            let why = match tail.is_unflushed_buffer() {
                true => ", at a multiple of 4096 bytes: the logger was killed before it flushed",
                false => "",
            };
            format!(
                "the last record, at offset {offset}, is cut ({left}{expected} bytes); the file ends at {bytes}{why}"
            )
        }
    }
}

/// The losses, a line each; empty if there are none.
pub fn losses(survey: &Survey, bytes: u64) -> String {
    damages(survey) + &end(survey, bytes)
}

/// The same for commands that only read the log: a last record that a killed logger cut is usual, and printed with `-v` only.
pub fn unusual_losses(survey: &Survey, bytes: u64) -> String {
    let is_usual = survey.tail.is_some_and(|tail| tail.is_unflushed_buffer());
    let end = if is_usual && !says(Level::Verbose) { String::new() } else { end(survey, bytes) };
    damages(survey) + &end
}

fn damages(survey: &Survey) -> String {
    let mut text = String::new();
    for loss in &survey.losses {
        let _ = writeln!(text, "  lost: {} bytes at offset {}: {}", loss.bytes, loss.offset, loss.reason);
    }
    let all = survey.damages + survey.bad_bfee;
    if all > LOSSES_KEPT as u64 {
        let _ = writeln!(text, "  lost: and {} more like these", all - LOSSES_KEPT as u64);
    }
    text
}

/// Where the log is cut, in a line; empty if it ends with a whole record.
fn end(survey: &Survey, bytes: u64) -> String {
    let is_cut = survey.tail.is_some_and(|tail| !matches!(tail, Tail::Clean));
    if is_cut { format!("  end: {}\n", tail_words(survey, bytes)) } else { String::new() }
}

/// The results of a side file's checksums, in a line.
pub fn check_words(checks: &Checks) -> String {
    let Checks { good, unknown, wrong, missing, out_of_step, .. } = *checks;
    let mut text = format!("checksums of the side file: {good} records right");
    for (count, what) in
        [(wrong, "wrong and skipped"), (missing, "of the side file not in the log"), (unknown, "unknown")]
    {
        if count > 0 {
            let _ = write!(text, ", {count} {what}");
        }
    }
    if out_of_step {
        text += "; it is of another log, or all of the first records were changed: no record was checked";
    }
    text
}

/// How often the host's clock was set; `None` if it was not.
pub fn host_words(steps: &HostSteps) -> Option<String> {
    let furthest_s = steps.furthest_us as f64 * 1e-6;
    let times = some(steps.set, "time", "times");
    (steps.set > 0).then(|| format!("the host's clock was set {times} meanwhile, the furthest by {furthest_s:+.3} s"))
}

/// A frame's rate in words, with its code.
fn modulation(code: u16) -> String {
    // RATE_MCS_CODE_MSK without MCS 32 (`dvm/commands.h`).
    let mcs = code & 0x1f;
    let kind = if code & rate::HT != 0 { format!("HT MCS {mcs}") } else { "legacy".into() };
    let width = if code & rate::HT40 != 0 { "40 MHz" } else { "20 MHz" };
    let guard = if code & rate::SHORT_GI != 0 { ", short guard" } else { "" };
    format!("{kind}, {width}{guard} (0x{code:04x})")
}

fn describe(name: &str, read: &Read) -> String {
    let Read { survey, bytes, checks, silent } = read;
    let bytes = *bytes;
    let mut text = format!("{name}: {bytes} bytes, {}\n", some(survey.records, "record", "records"));
    if survey.bfees() == 0 {
        let why = match (bytes, survey.records) {
            (0, _) => {
                "the file is empty: was the logger's socket on the right connector index, and the CSI firmware loaded?"
            }
            (_, 0) => "no record of a csitool log in it: is it another kind of file?",
            _ if survey.by_code.keys().all(|own| *own == code::MPDU) => {
                "no CSI in it, only copies of frames (0xC1): the card measures HT frames (802.11n, `monitor_tx_rate` 0x4101 on \
                 the sender) on an open network only, and in monitor mode those to or from 00:16:ea:12:34:56"
            }
            _ => "no CSI in it",
        };
        let _ = writeln!(text, "  {why}");
    } else {
        describe_csi(&mut text, survey);
    }
    if *silent > 0 {
        let records = some(*silent, "record has", "records have");
        let _ = writeln!(
            text,
            "  {records} CSI of only zeros: the card was not measuring (reload the driver, or try another card)"
        );
    }
    for (code, count) in survey.by_code.iter().filter(|(code, _)| **code != code::BFEE) {
        let _ = writeln!(text, "  code 0x{code:02X} ({}): {count}", code::name(*code).unwrap_or("unknown"));
    }
    if survey.longer > 0 {
        let (some, bytes) = (some(survey.longer, "record", "records"), survey.bytes_behind_csi);
        let _ = writeln!(text, "  bytes behind the CSI: {bytes} in {some}, not read (netlink pads to 4)");
    }
    if survey.mpdu_without_fcs > 0 {
        let _ = writeln!(
            text,
            "  MPDUs without a frame check sequence: {} (client or access point mode; their sender is address 2)",
            survey.mpdu_without_fcs
        );
    }
    if survey.mpdu_bad_fcs > 0 {
        let _ = writeln!(text, "  MPDUs with a wrong frame check sequence: {}", survey.mpdu_bad_fcs);
    }
    describe_senders(&mut text, survey);
    if survey.bfee_missing > 0 {
        let _ = writeln!(text, "  missing from bfee_count: {} (lost, or filtered out of the log)", survey.bfee_missing);
    }
    for (count, [one, many], what) in [
        (survey.bfee_repeated, ["record", "records"], "with the bfee_count of the one before"),
        (survey.bfee_restarted, ["step", "steps"], "back of bfee_count (the driver was reloaded)"),
    ] {
        if count > 0 {
            let _ = writeln!(text, "  {} {what}", some(count, one, many));
        }
    }
    if let Some(words) = host_words(&survey.host_steps) {
        let _ = writeln!(text, "  {words}");
    }
    if let Some(checks) = checks {
        let _ = writeln!(text, "  {}", check_words(checks));
    }
    text.push_str(&losses(survey, bytes));
    if survey.damages > 0 {
        let stretches = some(survey.damages, "stretch", "stretches");
        let _ = writeln!(text, "  damaged: {stretches}, {} bytes in all", survey.damaged_bytes);
    }
    if survey.records > 0 && survey.tail == Some(Tail::Clean) && !survey.lost_something() {
        text.push_str("  intact to the last byte\n");
    }
    text
}

fn describe_csi(text: &mut String, survey: &Survey) {
    let layouts = [
        (survey.stock, "stock", ""),
        (survey.wsr_2021, "WSR", ", as of 2021: no frame numbers"),
        (survey.wsr, "WSR", ""),
    ];
    let used: Vec<_> = layouts.iter().filter(|(count, ..)| *count > 0).collect();
    let layout = match used[..] {
        [(count, name, remark)] => format!("{name} layout{remark}, {count} bfee records"),
        _ => {
            let each = used.iter().map(|(count, name, remark)| format!("{count} {name}{remark}"));
            format!("mixed layouts of bfee records: {}", each.collect::<Vec<_>>().join("; "))
        }
    };
    let mut streams = Vec::new();
    for (rx, row) in survey.streams.iter().enumerate() {
        for (tx, &count) in row.iter().enumerate().filter(|(_, count)| **count > 0) {
            streams.push(format!("{}x{}: {count}", rx + 1, tx + 1));
        }
    }
    let _ = writeln!(text, "  {layout}; receive x transmit streams {}", streams.join(", "));
    let _ = writeln!(text, "  {}", time_words(survey));
    let noise = match survey.noise_unknown {
        all if all == survey.bfees() => "not measured (-127, usual in monitor mode)".into(),
        _ => survey.noise_dbm.map_or_else(String::new, |noise| format!("{} to {} dBm", noise.min, noise.max)),
    };
    let agc = survey.agc.unwrap_or_default();
    let rates: Vec<_> = survey.rates.iter().map(|(rate, count)| format!("{}: {count}", modulation(*rate))).collect();
    let _ = writeln!(text, "  noise {noise}; AGC {} to {} dB; rate {}", agc.min, agc.max, rates.join(", "));
    let rssi: Vec<_> = "ABC"
        .chars()
        .zip(&survey.rssi)
        .map(|(name, range)| match range {
            None => format!("{name} none"),
            Some(range) => format!("{name} {:.1} ({}..{})", range.mean, range.min, range.max),
        })
        .collect();
    let order: Vec<_> = survey.antenna_sel.iter().map(|(sel, count)| format!("0x{sel:02x}: {count}")).collect();
    let _ = writeln!(text, "  RSSI mean (range) {}; antenna_sel {}", rssi.join(", "), order.join(", "));
    if survey.bad_permutations > 0 {
        let _ = writeln!(
            text,
            "  antenna_sel no permutation in {} records: antennas unknown there",
            survey.bad_permutations
        );
    }
}

/// How long the records took, and by which clock.
fn time_words(survey: &Survey) -> String {
    let (base, steps) = (survey.time_base(), &survey.clock_steps);
    let elapsed_s = survey.elapsed_us(base) as f64 * 1e-6;
    let stands_us = steps.forward_us;
    match base {
        TimeBase::Host => {
            format!(
                "{elapsed_s:.3} s by the host's times; the card's clock (timestamp_low) stands still: {stands_us} us in all"
            )
        }
        TimeBase::Number => {
            format!(
                "no times: the card's clock (timestamp_low) stands, {stands_us} us in all, and there are no host times"
            )
        }
        _ => format!("{elapsed_s:.3} s on the card's clock (timestamp_low){}", clock_words(steps)),
    }
}

/// A clock's irregularities: pauses and steps back.
fn clock_words(steps: &ClockSteps) -> String {
    let mut text = String::new();
    if steps.pauses > 0 {
        let longest = steps.longest_pause_us as f64 * 1e-6;
        let pauses = some(steps.pauses, "pause", "pauses");
        let _ = write!(text, "; {pauses} of a second and more, the longest {longest:.1} s");
    }
    if steps.steps_back > 0 {
        let furthest = steps.furthest_back_us as f64 * 1e-6;
        let back = some(steps.steps_back, "step", "steps");
        let _ = write!(text, "; {back} back, the furthest by {furthest:.3} s");
    }
    text
}

/// Frames per second over the log, and between frames if that differs.
fn rate_words(sender: &Sender) -> String {
    match (sender.mean_rate_hz(), sender.rate_hz()) {
        (Some(mean), Some(median)) if (median / mean - 1.0).abs() > 0.05 => {
            format!(", {mean:.1} Hz over the log ({median:.1} Hz is the median between frames)")
        }
        (Some(mean), _) => format!(", {mean:.1} Hz"),
        (None, Some(median)) => format!(", {median:.1} Hz"),
        (None, None) => String::new(),
    }
}

fn describe_senders(text: &mut String, survey: &Survey) {
    for (mac, sender) in &survey.senders {
        let name = if *mac == Mac::default() { "unknown sender".to_string() } else { format!("from {mac}") };
        let rate = rate_words(sender);
        let numbers = match sender.frame_count {
            Some(_) if !sender.counts_up() => ", no frame numbers: the field does not count up".into(),
            Some((low, high)) => format!(", frames {low}..{high}{}", steps(sender)),
            None => String::new(),
        };
        let _ = writeln!(text, "  {name}: {}{rate}{numbers}", some(sender.records, "record", "records"));
    }
    if survey.further_senders > 0 {
        let _ = writeln!(
            text,
            "  {} records of more than {SENDERS_KEPT} senders, whose rarest are not listed: noise in the log, or not a log of the CSI tool",
            survey.further_senders
        );
    }
}

/// Irregularities of a sender's frame numbers.
fn steps(sender: &Sender) -> String {
    [
        (sender.frames_skipped, "skipped"),
        (sender.frames_repeated, "reported twice"),
        (
            sender.frames_restarted,
            if sender.frames_restarted == 1 { "restart of the count" } else { "restarts of the count" },
        ),
    ]
    .iter()
    .filter(|(count, _)| *count > 0)
    .map(|(count, what)| format!(", {count} {what}"))
    .collect()
}

// What is drawn of logs.
#[derive(clap::Args)]
#[group(id = "drawn")]
#[command(next_help_heading = "Pictures")]
struct Pictures {
    /// Draw each log into this folder: NAME-csi (CSI of the sender with the most records, by antenna) and NAME-levels
    /// (amplitude, RSSI, gain, rate, gaps, losses, steps back of the clock). Times are the card's, the host's if that
    /// clock stands still, or record numbers
    #[arg(long, visible_alias = "out", value_name = "DIR")]
    pub plot: Option<PathBuf>,
    /// Draw only frames of these senders
    #[arg(long, value_delimiter = ',', value_name = "MAC,..", requires = "plot")]
    mac: Vec<Mac>,
    /// Draw only these antennas (RF ports): A,B,C
    #[arg(long, value_delimiter = ',', value_parser = antenna, value_name = "A,..", requires = "plot")]
    antenna: Vec<Antenna>,
    /// Draw from this time, seconds after the first record
    #[arg(long, value_name = "SECONDS", requires = "plot")]
    from: Option<f64>,
    /// Draw up to this time, seconds after the first record
    #[arg(long, value_name = "SECONDS", requires = "plot")]
    to: Option<f64>,
}

/// Draws a log, if requested; returns the pictures, which have this name.
fn draw_pictures(args: &Pictures, log: &Path, name: &str) -> Words<Vec<PathBuf>> {
    let Some(folder) = &args.plot else { return Ok(Vec::new()) };
    if files::is_read_once(log) {
        usage("a log is read again for its pictures, and standard input or a pipe only once: name a file");
    }
    if !cards::is_log(log) {
        files::must_be_log(log)?;
    }
    let (macs, antennas) = (args.mac.clone(), args.antenna.clone());
    let wanted = Wanted { macs, antennas, from_s: args.from, to_s: args.to };
    let course = Course::read(log, &wanted).map_err(|error| hint::log_refused(&error))?;
    if course.records == 0 {
        return Err(format!("{}: no matching record to draw", log.display()));
    }
    if let Some(left_out) = course.left_out() {
        note!("{}: the heat maps are {left_out} (--mac chooses senders)", log.display());
    }
    if course.antennas.is_empty() && !args.antenna.is_empty() {
        note!("{}: no CSI of these antennas (--antenna), so no picture of it", log.display());
    }
    let title = log.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let drawn = LogPictures { title: &title, course: &course };
    draft::pictures(folder, |folder| drawn.write(&folder.join(file_safe(name))))
}

/// What is in a log, as JSON has it.
#[derive(serde::Serialize)]
struct OtherRow {
    file: String,
    bytes: u64,
    /// The kind of log, in words.
    format: &'static str,
    senders: BTreeMap<String, u64>,
    /// The pictures drawn.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pictures: Vec<PathBuf>,
    #[serde(flatten)]
    survey: CardSurvey,
}

impl OtherRow {
    fn new(path: &Path, format: Format, bytes: &[u8]) -> Self {
        let mut survey = CardSurvey::default();
        Items::new(format, bytes).for_each(|item| survey.note(&item));
        let name = |mac: &Mac| if *mac == Mac::default() { "unknown".into() } else { mac.to_string() };
        Self {
            file: path.display().to_string(),
            bytes: bytes.len() as u64,
            format: format.name(),
            senders: survey.senders.iter().map(|(mac, count)| (name(mac), *count)).collect(),
            pictures: Vec::new(),
            survey,
        }
    }

    /// Prints it, as a line of JSON or as text, parted from what was printed before.
    fn show(&self, json: bool, parted: bool) {
        match json {
            true => print_json(self),
            false => print(&format!("{}{}", if parted { "\n" } else { "" }, self.text())),
        }
    }

    fn text(&self) -> String {
        let survey = &self.survey;
        let frames = some(survey.frames, "frame", "frames");
        let mut text = format!("{}: {} bytes, {}, {frames}\n", self.file, self.bytes, self.format);
        for (what, counts) in [("card", &survey.cards), ("frames", &survey.shapes), ("sender", &self.senders)] {
            for (key, count) in counts {
                let _ = writeln!(text, "  {what} {key}: {count}");
            }
        }
        if let Some(span_s) = survey.host_span_s {
            let _ = writeln!(text, "  {span_s:.3} s by the host's clock");
        }
        text += &not_read(&survey.skipped);
        let _ = writeln!(text, "  bearings: {}", self.bearings());
        text
    }

    /// Which bearings such a log can give.
    fn bearings(&self) -> &'static str {
        match (self.format, self.survey.n_rx) {
            ("FeitCSI", 2..) => {
                "of two robots that exchanged frames, or of one with two antennas (`bearing --baseline`)"
            }
            ("FeitCSI", _) => "of two robots that exchanged frames",
            (_, 2..) => "of one robot with two antennas (`bearing --baseline`)",
            _ => "none; one log needs two antennas in the same frame, and each frame here has one",
        }
    }
}

/// The bytes of another card's log that are not frames with CSI, a line for each reason.
pub fn not_read(skipped: &BTreeMap<String, u64>) -> String {
    skipped.iter().map(|(why, bytes)| format!("  not read: {bytes} bytes: {why}\n")).collect()
}
