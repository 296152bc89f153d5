//! What is looked at, and every answer that the page asks for.

use crate::csi::Maps;
use crate::events::Events;
use crate::links::{Links, Reading};
use crate::logs::Logs;
use crate::node::Node;
use crate::{Error, page};
use csi5300::source::survey::{Sender, Survey, TimeBase};
use csi5300_lab::cards::CardSurvey;
use csi5300_lab::course::{LogIndex, letter};
use csi5300_lab::evaluate::TrajectorySource;
use driver_iface::Mac;
use driver_iface::bfee::Antenna;
use driver_iface::record::Tail;
use serde::Serialize;
use std::fs::Metadata;
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::{Arc, OnceLock, Weak};

/// Columns of a stretch where the page asks for no number of them.
const COLUMNS: usize = 600;
/// Columns of a log in a page that is one file.
const COLUMNS_IN_FILE: usize = 300;

/// A log, a folder of captures and logs, or a running node, to be looked at.
pub struct View {
    name: String,
    logs: Logs,
    links: Option<Links>,
    node: Option<Arc<Node>>,
    pub(crate) events: Arc<Events>,
    antenna: Antenna,
    source: TrajectorySource,
    /// Itself, once links are evaluated in the background: for the threads of links that somebody waits for.
    own: OnceLock<Weak<Self>>,
}

/// An answer: its kind (a MIME type) and its bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Answer {
    /// MIME type.
    pub kind: &'static str,
    /// What it is.
    pub bytes: Vec<u8>,
}

#[derive(Serialize)]
struct Overview<'a> {
    program: String,
    name: &'a str,
    kind: &'static str,
    logs: Vec<LogName<'a>>,
    links: Vec<String>,
    has_beside: bool,
    trajectory: TrajectorySource,
}

#[derive(Serialize)]
struct LogName<'a> {
    name: &'a str,
    bytes: Option<u64>,
}

/// What is in a log: `info --json`, with its senders as a list.
#[derive(Serialize)]
struct LogFacts<'a> {
    name: &'a str,
    bytes: u64,
    cut: bool,
    /// First and last time, seconds, by `time_base`; with that of numbers the records' numbers.
    span_s: (f64, f64),
    time_base: TimeBase,
    /// Indices of the reported subcarriers about the centre: of most frames, or where a 5300's frames are of one width.
    subcarriers: Option<Vec<i16>>,
    /// Letters of the antennas.
    antennas: Vec<char>,
    /// True if RSSI is in dBm, not dB.
    rssi_in_dbm: bool,
    senders: Vec<SenderFacts>,
    #[serde(flatten)]
    counted: Counted<'a>,
}

/// What was counted in a log.
#[derive(Serialize)]
#[serde(untagged)]
enum Counted<'a> {
    Csitool(&'a Survey),
    Card {
        /// The kind of log, of cards other than the 5300.
        format: &'static str,
        #[serde(flatten)]
        survey: &'a CardSurvey,
    },
}

#[derive(Serialize)]
struct SenderFacts {
    mac: String,
    records: u64,
    rate_hz: Option<f64>,
    median_rate_hz: Option<f64>,
    /// Null for what does not count up.
    frames_skipped: Option<u64>,
    frames_repeated: Option<u64>,
}

/// What follows the `?` of a question.
struct Query<'a>(&'a str);

impl Query<'_> {
    fn value<T: FromStr>(&self, name: &'static str) -> Result<Option<T>, Error> {
        let found = self.0.split('&').filter_map(|pair| pair.split_once('=')).find(|(key, _)| *key == name);
        found
            .filter(|(_, value)| !value.is_empty())
            .map(|(_, value)| value.parse().map_err(|_| Error::Query { name, value: value.to_owned() }))
            .transpose()
    }

    fn seconds(&self, name: &'static str, default: f64) -> Result<f64, Error> {
        Ok(self.value::<f64>(name)?.filter(|value| value.is_finite()).unwrap_or(default))
    }
}

impl View {
    /// Whether `path` is of a kind that is looked at, without opening it: a file, a folder or a socket.
    ///
    /// # Errors
    /// If it is not there, or a pipe or a device, which could be waited for.
    pub fn check(path: &Path) -> Result<Metadata, Error> {
        let found = std::fs::metadata(path).map_err(|source| Error::Missing { path: path.to_owned(), source })?;
        match found.is_file() || found.is_dir() || found.file_type().is_socket() {
            true => Ok(found),
            false => Err(Error::NoFile { path: path.to_owned() }),
        }
    }

    /// What `path` is: a log, a folder, or the status socket of a node.
    ///
    /// # Errors
    /// If there is nothing to look at.
    pub fn open(path: &Path, reading: Reading) -> Result<Self, Error> {
        let kind = Self::check(path)?;
        let events = Arc::new(Events::default());
        let (antenna, source) = (reading.antenna(), reading.source());
        let name = path.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into_owned());
        let view = |logs, links, node| Self {
            name: name.clone(),
            logs,
            links,
            node,
            events: Arc::clone(&events),
            antenna,
            source,
            own: OnceLock::new(),
        };
        if kind.is_dir() {
            let (logs, links) = (Logs::below(path), Links::below(path, reading));
            if logs.len() == 0 && links.is_none() {
                return Err(Error::Empty { path: path.to_owned() });
            }
            return Ok(view(logs, links, None));
        }
        if kind.file_type().is_socket() {
            let node = Node::open(path, Arc::downgrade(&events))?;
            return Ok(view(Logs::new(Vec::new()), None, Some(node)));
        }
        let logs = Logs::new(vec![(name.clone(), path.to_owned())]);
        // Read at once: an unreadable log is reported before there is a page.
        let known = logs.read(0)?.is_some_and(|(_, index)| index.records() > 0);
        if known { Ok(view(logs, None, None)) } else { Err(Error::NoRecord { path: path.to_owned() }) }
    }

    /// Begins to evaluate the links on `threads` threads, for as long as somebody has the view.
    ///
    /// # Errors
    /// If no thread can be started.
    pub fn start(self: &Arc<Self>, threads: usize) -> Result<(), Error> {
        if self.links.is_none() {
            return Ok(());
        }
        self.own.get_or_init(|| Arc::downgrade(self));
        for _ in 0..threads.max(1) {
            let of: Weak<Self> = Arc::downgrade(self);
            let work = move || {
                while of.upgrade().is_some_and(|view| view.links.as_ref().is_some_and(|links| links.work(&view.events)))
                {
                }
            };
            let thread = std::thread::Builder::new().name("csi5300 links".into()).spawn(work);
            thread.map_err(|source| Error::Start { what: "the thread that evaluates links", source })?;
        }
        Ok(())
    }

    /// Has a link evaluated at once, on a thread of its own, if that was not begun. Where none can be started it is next.
    fn hurry(&self, link: usize) {
        let Some(view) = self.own.get().and_then(Weak::upgrade) else { return };
        let work = move || {
            if let Some(urgent) = view.links.as_ref().and_then(|links| links.urgent(link)) {
                urgent.work(&view.events);
            }
        };
        drop(std::thread::Builder::new().name("csi5300 link".into()).spawn(work));
    }

    /// How many links there are.
    #[must_use]
    pub fn links(&self) -> usize {
        self.links.as_ref().map_or(0, Links::len)
    }

    /// Evaluates all links here; `progress` is handed how many are done.
    pub fn finish(&self, progress: impl FnMut(usize)) {
        if let Some(links) = &self.links {
            links.finish(&self.events, progress);
        }
    }

    /// Whether a link has a bearing, and whether something was lost or failed.
    #[must_use]
    pub fn outcome(&self) -> (bool, bool) {
        self.links.as_ref().map_or((false, false), Links::outcome)
    }

    /// What has the name of a log and is not shown, in words.
    #[must_use]
    pub fn left_out(&self) -> Vec<String> {
        let words = |path: &PathBuf| format!("{} is left out: it is no file", path.display());
        self.logs.left_out().iter().map(words).collect()
    }

    /// What was noted of the captures so far.
    #[must_use]
    pub fn notes(&self) -> Vec<String> {
        self.links.as_ref().map(|links| links.said().0).unwrap_or_default()
    }

    /// Links without a bearing so far, and why.
    #[must_use]
    pub fn failed(&self) -> Vec<String> {
        self.links.as_ref().map(|links| links.said().1).unwrap_or_default()
    }

    /// The answer to a question of the page: a path, and what follows its `?`.
    ///
    /// # Errors
    /// If there is no such thing, a value cannot be meant, or a log cannot be read.
    pub fn answer(&self, path: &str, query: &str) -> Result<Answer, Error> {
        let none = || Error::NoSuch { path: path.to_owned() };
        if let Some((kind, text)) = page::file(path) {
            return Ok(Answer { kind, bytes: text.into_bytes() });
        }
        let query = Query(query);
        let parts: Vec<&str> = path.trim_start_matches('/').split('/').collect();
        let number = |text: &str| text.parse::<usize>().map_err(|_| none());
        let links = || self.links.as_ref().ok_or_else(none);
        let bytes = match parts.as_slice() {
            ["data", "overview"] => serde_json::to_vec(&self.overview())?,
            ["data", "rows"] => links()?.rows(query.value("known")?.unwrap_or(0))?,
            ["data", "sets"] => links()?.sets()?,
            ["data", "states"] => self.node.as_ref().ok_or_else(none)?.states(),
            ["data", "link", link] => {
                let link = number(link)?;
                let (answer, waits) = links()?.link(link, self.logs_of(link))?.ok_or_else(none)?;
                if waits {
                    self.hurry(link);
                }
                answer
            }
            ["data", "log", log] => self.facts(number(log)?)?.ok_or_else(none)?,
            ["data", "log", log, what @ ("levels" | "csi")] => {
                let log = number(log)?;
                let (_, index) = self.logs.read_again(log)?.ok_or_else(none)?;
                let stretch = self.stretch(&index, what, &query);
                // Where the log became another one meanwhile, what was read of it is of neither.
                self.logs.must_hold(log)?;
                stretch?
            }
            _ => return Err(none()),
        };
        Ok(Answer { kind: "application/json", bytes })
    }

    /// The page as one file, with every answer inside that a page from the server asks for.
    ///
    /// # Errors
    /// If an answer cannot be given.
    pub fn file(&self) -> Result<String, Error> {
        let mut answers = Vec::new();
        let mut give = |path: String, query: &str| {
            let answer = self.answer(&path, query)?;
            answers.push((path, String::from_utf8_lossy(&answer.bytes).into_owned()));
            Ok::<(), Error>(())
        };
        give("/data/overview".into(), "")?;
        if self.links.is_some() {
            give("/data/rows".into(), "")?;
            give("/data/sets".into(), "")?;
        }
        for link in 0..self.links() {
            give(format!("/data/link/{link}"), "")?;
        }
        let query = format!("columns={COLUMNS_IN_FILE}&antenna={}", self.antenna);
        for log in 0..self.logs.len() {
            // Its links report an unreadable log; the other links remain.
            if give(format!("/data/log/{log}"), "").is_ok() {
                give(format!("/data/log/{log}/levels"), &query)?;
                give(format!("/data/log/{log}/csi"), &query)?;
            }
        }
        Ok(page::whole(&self.name, &answers))
    }

    fn overview(&self) -> Overview<'_> {
        let logs = self
            .logs
            .iter()
            .map(|log| LogName { name: &log.name, bytes: log.path.metadata().ok().map(|found| found.len()) });
        Overview {
            program: format!("csi5300 {}", env!("CARGO_PKG_VERSION")),
            name: &self.name,
            kind: match (&self.node, &self.links) {
                (Some(_), _) => "node",
                (None, Some(_)) => "captures",
                (None, None) => "logs",
            },
            logs: logs.collect(),
            links: self.links.as_ref().map(Links::names).unwrap_or_default(),
            has_beside: self.links.as_ref().is_some_and(Links::has_beside),
            trajectory: self.source,
        }
    }

    /// The numbers of the receiver's and the transmitter's log of a link.
    fn logs_of(&self, link: usize) -> [Option<usize>; 2] {
        let of = |links: &Links| {
            let (capture, transmitter) = links.place(link)?;
            let capture = links.captures().get(capture)?;
            let receiver = capture.receiver_log();
            let transmitter = capture.transmitters.get(transmitter).and_then(|(_, path)| self.logs.number(path));
            Some([self.logs.number(&receiver), transmitter])
        };
        self.links.as_ref().and_then(of).unwrap_or_default()
    }

    fn facts(&self, number: usize) -> Result<Option<Vec<u8>>, Error> {
        let Some((log, index)) = self.logs.read(number)? else { return Ok(None) };
        let survey = index.survey();
        let sender = |(mac, (records, rate_hz)): (&Mac, (u64, Option<f64>))| {
            let counted: Option<&Sender> = survey.and_then(|survey| survey.senders.get(mac));
            SenderFacts {
                mac: mac.to_string(),
                records: counted.map_or(records, |sender| sender.records),
                rate_hz: counted.map_or(rate_hz, Sender::mean_rate_hz),
                median_rate_hz: counted.and_then(Sender::rate_hz),
                frames_skipped: counted.filter(|sender| sender.counts_up()).map(|sender| sender.frames_skipped),
                frames_repeated: counted.filter(|sender| sender.counts_up()).map(|sender| sender.frames_repeated),
            }
        };
        let counted = match (survey, index.card()) {
            (Some(survey), _) => Counted::Csitool(survey),
            (None, Some((format, survey))) => Counted::Card { format: format.name(), survey },
            (None, None) => return Ok(None),
        };
        let facts = LogFacts {
            name: &log.name,
            bytes: index.bytes(),
            cut: survey.is_some_and(|survey| survey.tail.is_some_and(|tail| !matches!(tail, Tail::Clean))),
            span_s: index.span_s(),
            time_base: index.base(),
            subcarriers: index.subcarriers(),
            antennas: (0..index.antennas()).map(letter).collect(),
            rssi_in_dbm: index.rssi_in_dbm(),
            senders: index.senders().iter().zip(index.sent()).take(SENDERS).map(sender).collect(),
            counted,
        };
        Ok(Some(serde_json::to_vec(&facts)?))
    }

    fn stretch(&self, index: &LogIndex, what: &str, query: &Query<'_>) -> Result<Vec<u8>, Error> {
        let span_s = index.span_s();
        let (from_s, to_s) = (query.seconds("from", span_s.0)?, query.seconds("to", span_s.1)?);
        let (columns, sender) = (query.value("columns")?.unwrap_or(COLUMNS), query.value::<Mac>("sender")?);
        if what == "levels" {
            return Ok(serde_json::to_vec(&index.stretch(from_s, to_s, columns, sender))?);
        }
        let antenna = query.value::<char>("antenna")?;
        // Means over several senders would be nobody's channel.
        let sender = sender.or_else(|| most_heard(index));
        Ok(serde_json::to_vec(&Maps::new(&index.csi(from_s, to_s, columns, sender)?, antenna, sender))?)
    }
}

/// The sender with the most records, if there are several; the first of equals.
fn most_heard(index: &LogIndex) -> Option<Mac> {
    let heard = index.senders().iter().zip(index.sent()).rev().max_by_key(|(_, (records, _))| *records);
    heard.map(|(mac, _)| *mac).filter(|_| index.senders().len() > 1)
}

/// Senders listed of a log.
const SENDERS: usize = 64;

#[cfg(test)]
mod tests;
