//! `csi5300 export --dat`: every intact record of a damaged log.

use super::Args;
use crate::commands::draft::{Draft, led_to, must_not_be_read, rest};
use crate::commands::{InWords, Outcome, Result, Words, info, must_not_exist, open_log, print_json, some};
use csi5300::source::replay::Replay;
use csi5300::source::survey::{Identity, Survey};
use csi5300::source::{Checks, CsiSource, Next, Origin, side_path};
use csi5300::time::Instant;
use driver_iface::bfee::{Bfee, Iq, Repr, SUBCARRIERS};
use driver_iface::record::{Record, code};
use driver_iface::side_file::{Check, Entry, Layout as SideLayout};
use driver_iface::{Mac, mpdu};
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};

/// The line of JSON.
#[derive(serde::Serialize)]
struct Row<'a> {
    output: &'a Path,
    /// Records written.
    records: u64,
    /// Records that were framed but hold something impossible.
    bad_bfee: u64,
    /// Stretches of bytes that are no record, and the bytes in them.
    damages: u64,
    damaged_bytes: u64,
    /// Skipped records beside damage that are neither CSI nor its frames.
    doubtful: u64,
    /// Records written whose frame number no reader takes, because a group address sent them.
    without_number: u64,
    /// Results of the side file's checksums; null without them.
    checks: Option<Checks>,
}

/// A layout to bring records into.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Layout {
    /// The original CSI tool's: sender and number of a WSR record go into a copy of its frame before it, host times into a
    /// side file (OUTPUTstp)
    Stock,
}

/// Records of other codes that wait for a CSI record or its frame: this many confirm each other.
const WAITING: usize = 16;

/// The output in progress.
struct Output {
    draft: Draft,
    data: BufWriter<File>,
    /// With host times: in the stock layout, and where the input has them.
    side: Option<(BufWriter<File>, SideLayout)>,
    name: String,
    /// Records of the input that are in it.
    kept: u64,
    /// Of these, records whose number the stock layout cannot tell: a group address sent them.
    without_number: u64,
    /// The length of each record in it.
    lengths: Vec<usize>,
    frame: Vec<u8>,
}

fn create(path: &Path) -> Words<BufWriter<File>> {
    let file = File::create(path).map_err(|error| format!("cannot write {}: {error}", path.display()))?;
    Ok(BufWriter::with_capacity(256 * 1024, file))
}

impl Output {
    fn create(path: &Path, side: Option<SideLayout>) -> Words<Self> {
        let draft = Draft::new(path);
        let data = create(draft.path())?;
        let side = side.filter(|_| draft.is_file());
        let side = side.map(|layout| Ok::<_, String>((create(&side_path(draft.path()))?, layout))).transpose()?;
        let (name, lengths, frame) = (path.display().to_string(), Vec::new(), Vec::new());
        let mut out = Self { draft, data, side, name, kept: 0, without_number: 0, lengths, frame };
        if let Some((side, layout)) = &mut out.side {
            side.write_all(layout.head()).map_err(|error| format!("cannot write {}: {error}", out.name))?;
        }
        Ok(out)
    }

    fn write(&mut self, record: Record<'_>, host_us: Option<i64>) -> Words<()> {
        self.frame.resize(record.emit_len(), 0);
        record.emit(&mut self.frame).in_words()?;
        let name = &self.name;
        let failed = |error: std::io::Error| format!("cannot write {name}: {error}");
        self.data.write_all(&self.frame).map_err(failed)?;
        self.lengths.push(self.frame.len());
        if let Some((side, layout)) = &mut self.side {
            let check = (*layout == SideLayout::Checked).then(|| Check::of(&self.frame));
            let mut out = [0; SideLayout::Wide.bytes()];
            // A time that does not fit stays zeros: not known.
            let _ = Entry { host_us, check }.emit(*layout, &mut out);
            side.write_all(out.split_at(layout.bytes()).0).map_err(failed)?;
        }
        Ok(())
    }

    /// A record of the WSR layout as the stock driver would have written it: its frame, then its CSI.
    fn write_stock(&mut self, bfee: &Bfee<'_>, identity: Identity) -> Words<()> {
        if identity.mac != Mac::ZERO {
            self.without_number += u64::from(identity.frame_count.is_some() && identity.mac.is_group());
            let frame = frame_of(identity.mac, identity.frame_count)?;
            self.write(Record { code: code::MPDU, body: &frame }, identity.host_us)?;
        }
        let repr = Repr { wsr: None, ..Repr::parse(bfee) };
        let rows = (0..bfee.n_rx()).flat_map(|rx| (0..bfee.n_tx()).map(move |tx| (rx, tx)));
        let all = (0..SUBCARRIERS).flat_map(|k| rows.clone().map(move |(rx, tx)| (k, rx, tx)));
        let csi: Vec<Iq> = all.filter_map(|(k, rx, tx)| bfee.iq(k, rx, tx)).collect();
        let mut body = vec![0; repr.body_len()];
        repr.emit(&csi, &mut body).in_words()?;
        self.write(Record { code: code::BFEE, body: &body }, identity.host_us)
    }

    /// Settles the log, and renames it and its side file; older side files are removed.
    fn finish(mut self, path: &Path) -> Words<u64> {
        let failed = |error: std::io::Error| format!("cannot write {}: {error}", path.display());
        self.data.flush().map_err(failed)?;
        let side = self.side.take();
        let layout = side.as_ref().map(|(_, layout)| *layout);
        if let Some((mut side, _)) = side {
            side.flush().map_err(failed)?;
        }
        if !self.draft.is_file() {
            return Ok(0);
        }
        let taken = settle(self.draft.path(), layout, self.lengths)?;
        let named = side_path(self.draft.target());
        self.draft.keep(layout.is_some()).map_err(failed)?;
        let older = side_files(path).into_iter().filter(|side| layout.is_none() || led_to(side) != led_to(&named));
        older.for_each(|older| drop(std::fs::remove_file(older)));
        Ok(taken)
    }
}

/// Where a side file of an output may be: beside the name it was given, and beside the file that this leads to.
fn side_files(output: &Path) -> [PathBuf; 2] {
    [side_path(&led_to(output)), side_path(output)]
}

/// Records of other codes than CSI and its frames, unknown ones or what drivers log beside: between intact records they are kept,
/// beside damage they are as likely made up of its bytes.
#[derive(Default)]
struct Doubts {
    waiting: Vec<(u8, Vec<u8>, Option<i64>)>,
    after_damage: bool,
    /// Records that were not kept.
    dropped: u64,
}

impl Doubts {
    /// Takes a record of another code.
    fn hold(&mut self, record: Record<'_>, host_us: Option<i64>, out: &mut Output) -> Words<()> {
        if self.after_damage {
            self.dropped += 1;
            return Ok(());
        }
        self.waiting.push((record.code, record.body.to_vec(), host_us));
        if self.waiting.len() >= WAITING { self.believe(out) } else { Ok(()) }
    }

    /// A certain record follows the waiting ones.
    fn believe(&mut self, out: &mut Output) -> Words<()> {
        self.after_damage = false;
        for (code, body, host_us) in self.waiting.drain(..) {
            out.write(Record { code, body: &body }, host_us)?;
            out.kept += 1;
        }
        Ok(())
    }

    /// Damage follows the waiting records.
    fn damage(&mut self) {
        self.dropped += self.waiting.drain(..).len() as u64;
        self.after_damage = true;
    }
}

/// A sounding frame as the CSI tool logs it: to the magic address, sender in address 3, number, if any, in the payload.
fn frame_of(mac: Mac, number: Option<u32>) -> Words<Vec<u8>> {
    let payload = number.map(u32::to_be_bytes);
    let repr = mpdu::Repr {
        // A data frame.
        frame_control: 0x0008,
        duration_us: 0,
        seq_ctrl: 0,
        addr1: driver_iface::sounding::MAGIC_MAC,
        addr2: mac,
        addr3: mac,
        payload: payload.as_ref().map_or(&[], |number| number),
    };
    let mut frame = vec![0; repr.emit_len()];
    repr.emit(&mut frame).in_words()?;
    Ok(frame)
}

/// Copies the intact records of a log.
pub fn run(args: &Args) -> Result {
    let output = args.output.display().to_string();
    must_not_be_read(&args.output)?;
    must_not_exist(&args.output, args.force)?;
    let mut source = open_log(&args.file)?;
    // Checksums of what was never checked would vouch for it.
    let is_checked = source.checks().is_none_or(|checks| !checks.out_of_step);
    let own = source.side_layout().filter(|_| is_checked);
    let side = if args.layout == Some(Layout::Stock) { Some(SideLayout::Narrow) } else { own };
    // Without a side file of its own the recovered log must not be read with that of another.
    side_files(&args.output)
        .iter()
        .try_for_each(|side| must_not_be_read(side).and_then(|()| must_not_exist(side, args.force)))?;
    let mut out = Output::create(&args.output, side)?;
    let (mut survey, mut doubts) = (Survey::default(), Doubts::default());
    if side.is_some() && !out.draft.is_file() {
        note!("{output} is no file: host times, which go into a side file, are not written");
    }
    copy(&mut source, args.layout, &mut out, &mut survey, &mut doubts)?;
    notes!("{}", info::losses(&survey, source.bytes()));
    let checks = source.checks();
    if let Some(checks) = &checks {
        note!("  {}", info::check_words(checks));
    }
    let (mut kept, without_number) = (out.kept, out.without_number);
    if kept == 0 {
        drop(out);
        note!("nothing to write: no {output}");
    } else {
        let taken = out.finish(&args.output)?;
        (kept, doubts.dropped) = (kept.saturating_sub(taken), doubts.dropped + taken);
        note!("{} written to {output}", some(kept, "intact record", "intact records"));
    }
    if args.json {
        let Survey { bad_bfee, damages, damaged_bytes, .. } = survey;
        let row = Row {
            output: &args.output,
            records: kept,
            bad_bfee,
            damages,
            damaged_bytes,
            doubtful: doubts.dropped,
            without_number,
            checks,
        };
        print_json(&row);
    }
    if doubts.dropped > 0 {
        let doubtful = some(doubts.dropped, "doubtful record", "doubtful records");
        note!("  {doubtful} skipped beside the damage: they may not be real");
    }
    if without_number > 0 {
        let lost = some(without_number, "record loses its", "records lose their");
        note!(
            "  {lost} frame number: a group address sent them, and readers of the stock layout take no number from it"
        );
    }
    let missing = checks.is_some_and(|checks| checks.missing > 0 || checks.out_of_step);
    Ok(Outcome::of(kept > 0, survey.lost_something() || missing || doubts.dropped + without_number > 0))
}

/// Writes the intact records of `source`.
fn copy(
    source: &mut Replay<Box<dyn std::io::Read + Send>>,
    layout: Option<Layout>,
    out: &mut Output,
    survey: &mut Survey,
    doubts: &mut Doubts,
) -> Words<()> {
    loop {
        // What a side file's checksums let through is no doubt.
        let is_checked = source.checks().is_some_and(|checks| !checks.out_of_step);
        let next = source.receive(Instant::ZERO).in_words()?;
        let noted = survey.note(&next);
        match (next, noted) {
            (Next::Record(..), Some((bfee, identity))) if layout == Some(Layout::Stock) && bfee.wsr().is_some() => {
                doubts.believe(out)?;
                out.write_stock(&bfee, identity)?;
                out.kept += 1;
            }
            (Next::Record(_, record), None) if record.code == code::BFEE => doubts.damage(),
            (Next::Record(stamps, record), noted) => {
                let identified = noted.filter(|_| layout.is_some()).and_then(|(_, identity)| identity.host_us);
                let host_us = identified.or(stamps.host_us);
                if is_checked || [code::BFEE, code::MPDU].contains(&record.code) {
                    doubts.believe(out)?;
                    out.write(record, host_us)?;
                    out.kept += 1;
                } else {
                    doubts.hold(record, host_us, out)?;
                }
            }
            (Next::Lost(_), _) => doubts.damage(),
            (Next::Pending, _) => {}
            (Next::End(_), _) => return doubts.believe(out),
        }
    }
}

/// Takes records out of a log that was just written with these lengths, and their entries out of its side file, until it reads as it
/// was written. Gives how many.
fn settle(log: &Path, side: Option<SideLayout>, mut lengths: Vec<usize>) -> Words<u64> {
    let written = lengths.len();
    loop {
        let misread = misread(log, &lengths)?;
        if misread.is_empty() {
            return Ok((written - lengths.len()) as u64);
        }
        let failed = |error: std::io::Error| format!("cannot write {}: {error}", log.display());
        take_out(log, side, &lengths, &misread).map_err(failed)?;
        let mut numbers = 0..;
        lengths.retain(|_| numbers.next().is_some_and(|number| !misread.contains(&number)));
    }
}

/// The numbers, from 0, of records that a reader does not find where they were written.
fn misread(log: &Path, lengths: &[usize]) -> Words<BTreeSet<usize>> {
    let mut source = Replay::open(log).in_words()?;
    let mut misread = BTreeSet::new();
    let places = lengths.iter().scan(0, |end, length| {
        *end += *length as u64;
        Some((*end - *length as u64, *length))
    });
    let mut places = places.enumerate().peekable();
    loop {
        let found = match source.receive(Instant::ZERO).in_words()? {
            Next::Record(stamps, record) => match stamps.origin {
                Origin::File { offset } => Some((offset, record.emit_len())),
                Origin::Live { .. } => continue,
            },
            Next::Lost(_) | Next::Pending => continue,
            Next::End(_) => None,
        };
        while let Some((number, place)) = places.next_if(|(_, place)| found.is_none_or(|found| place.0 <= found.0)) {
            if found != Some(place) {
                misread.insert(number);
            }
        }
        if found.is_none() {
            return Ok(misread);
        }
    }
}

/// Rewrites a log without some of its records.
fn take_out(log: &Path, side: Option<SideLayout>, lengths: &[usize], out: &BTreeSet<usize>) -> std::io::Result<()> {
    let rest = rest(log);
    let (mut written, mut kept) = (BufReader::new(File::open(log)?), BufWriter::new(File::create(&rest)?));
    for (number, length) in lengths.iter().enumerate() {
        let mut record = vec![0; *length];
        written.read_exact(&mut record)?;
        if !out.contains(&number) {
            kept.write_all(&record)?;
        }
    }
    kept.into_inner()?.sync_data()?;
    std::fs::rename(&rest, log)?;
    let Some(layout) = side else { return Ok(()) };
    let entries = std::fs::read(side_path(log))?;
    let (head, entries) = entries.split_at_checked(layout.head().len()).unwrap_or((&entries, &[]));
    let kept = (0..).zip(entries.chunks(layout.bytes())).filter(|(number, _)| !out.contains(number));
    let kept: Vec<&[u8]> = std::iter::once(head).chain(kept.map(|(_, entry)| entry)).collect();
    std::fs::write(side_path(log), kept.concat())
}
