//! What is looked at, and every answer that the page asks for.

use crate::Error;
use crate::links::{Links, Reading};
use crate::logs::{Logs, Named, maps};
use crate::node::{Events, Node};
use csi5300::source::survey::Sender;
use csi5300_lab::course::{LogIndex, letter};
use csi5300_lab::evaluate::TrajectorySource;
use driver_iface::Mac;
use driver_iface::bfee::Antenna;
use driver_iface::record::Tail;
use serde_json::{Value, json};
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
        let found = std::fs::metadata(path).map_err(|source| Error::missing(path, &source))?;
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
        let (antenna, source) = (reading.options.antenna, reading.source);
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
                return Err(Error::Words(format!(
                    "no log and no capture below {}: a log's name ends in .dat, of another card in .csi, .pcap or .csv",
                    path.display()
                )));
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
        if known {
            return Ok(view(logs, None, None));
        }
        let path = path.display();
        Err(Error::Words(format!("{path}: no intact CSI record in it (`csi5300 info` lists its content)")))
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
            thread.map_err(|source| Error::start("the thread that evaluates links", &source))?;
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

    /// What was noted of the captures so far, and why links have no bearing.
    #[must_use]
    pub fn said(&self) -> (Vec<String>, Vec<String>) {
        self.links.as_ref().map(Links::said).unwrap_or_default()
    }

    /// The answer to a question of the page: a path, and what follows its `?`.
    ///
    /// # Errors
    /// If there is no such thing, a value cannot be meant, or a log cannot be read.
    pub fn answer(&self, path: &str, query: &str) -> Result<Answer, Error> {
        let none = || Error::NoSuch { path: path.to_owned() };
        if let Some((kind, text)) = page_file(path) {
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
        Ok(whole_page(&self.name, &answers))
    }

    fn overview(&self) -> Value {
        let bytes = |log: &Named| log.path.metadata().ok().map(|found| found.len());
        let logs = self.logs.iter().map(|log| json!({ "name": log.name, "bytes": bytes(log) }));
        let kind = match (&self.node, &self.links) {
            (Some(_), _) => "node",
            (None, Some(_)) => "captures",
            (None, None) => "logs",
        };
        json!({
            "program": format!("csi5300 {}", env!("CARGO_PKG_VERSION")),
            "name": self.name,
            "kind": kind,
            "logs": logs.collect::<Vec<_>>(),
            "links": self.links.as_ref().map(Links::names).unwrap_or_default(),
            "has_beside": self.links.as_ref().is_some_and(Links::has_beside),
            "trajectory": self.source,
        })
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

    /// What is in a log: `info --json`, with its senders as a list.
    fn facts(&self, number: usize) -> Result<Option<Vec<u8>>, Error> {
        let Some((log, index)) = self.logs.read(number)? else { return Ok(None) };
        let survey = index.survey();
        let sender = |(mac, (records, rate_hz)): (&Mac, (u64, Option<f64>))| {
            let counted: Option<&Sender> = survey.and_then(|survey| survey.senders.get(mac));
            json!({
                "mac": mac.to_string(),
                "records": counted.map_or(records, |sender| sender.records),
                "rate_hz": counted.map_or(rate_hz, Sender::mean_rate_hz),
                "median_rate_hz": counted.and_then(Sender::rate_hz),
                // Null for what does not count up.
                "frames_skipped": counted.filter(|sender| sender.counts_up()).map(|sender| sender.frames_skipped),
                "frames_repeated": counted.filter(|sender| sender.counts_up()).map(|sender| sender.frames_repeated),
            })
        };
        let mut facts = match (survey, index.card()) {
            (Some(survey), _) => serde_json::to_value(survey)?,
            (None, Some((_, survey))) => serde_json::to_value(survey)?,
            (None, None) => return Ok(None),
        };
        let senders: Vec<Value> = index.senders.iter().zip(index.sent()).take(SENDERS).map(sender).collect();
        let own = json!({
            "name": log.name,
            "bytes": index.bytes,
            "cut": survey.is_some_and(|survey| survey.tail.is_some_and(|tail| !matches!(tail, Tail::Clean))),
            // By `time_base`; with that of numbers the records' numbers.
            "span_s": index.span_s,
            "time_base": index.base,
            "subcarriers": index.subcarriers(),
            "antennas": (0..index.ports).map(letter).collect::<Vec<_>>(),
            "rssi_in_dbm": index.rssi_in_dbm,
            "senders": senders,
        });
        let format = index.card().map(|(format, _)| ("format".to_owned(), format.name().into()));
        if let (Value::Object(facts), Value::Object(own)) = (&mut facts, own) {
            facts.extend(own.into_iter().chain(format));
        }
        Ok(Some(serde_json::to_vec(&facts)?))
    }

    fn stretch(&self, index: &LogIndex, what: &str, query: &Query<'_>) -> Result<Vec<u8>, Error> {
        let span_s = index.span_s;
        let (from_s, to_s) = (query.seconds("from", span_s.0)?, query.seconds("to", span_s.1)?);
        let (columns, sender) = (query.value("columns")?.unwrap_or(COLUMNS), query.value::<Mac>("sender")?);
        if what == "levels" {
            return Ok(serde_json::to_vec(&index.stretch(from_s, to_s, columns, sender))?);
        }
        let antenna = query.value::<char>("antenna")?;
        // Means over several senders would be nobody's channel.
        let sender = sender.or_else(|| most_heard(index));
        Ok(serde_json::to_vec(&maps(&index.csi(from_s, to_s, columns, sender)?, antenna, sender)?)?)
    }
}

/// The sender with the most records, if there are several; the first of equals.
fn most_heard(index: &LogIndex) -> Option<Mac> {
    let heard = index.senders.iter().zip(index.sent()).rev().max_by_key(|(_, (records, _))| *records);
    heard.map(|(mac, _)| *mac).filter(|_| index.senders.len() > 1)
}

/// Senders listed of a log.
const SENDERS: usize = 64;

/// The plotting library uPlot and its licence: `page/vendor`, from npm's `uplot` as published.
const UPLOT: &str = include_str!("../page/vendor/uPlot.iife.min.js");
const UPLOT_STYLE: &str = include_str!("../page/vendor/uPlot.min.css");
const HEAD: &str = include_str!("../page/index.html");
const STYLE: &str = include_str!("../page/page.css");
/// The page's own script, in the order in which its parts need each other.
const SCRIPTS: [&str; 10] = [
    include_str!("../page/base.js"),
    include_str!("../page/colours.js"),
    include_str!("../page/charts.js"),
    include_str!("../page/log.js"),
    include_str!("../page/map.js"),
    include_str!("../page/profile.js"),
    include_str!("../page/table.js"),
    include_str!("../page/link.js"),
    include_str!("../page/live.js"),
    include_str!("../page/main.js"),
];
/// Where the head names its files.
const FILES: &str = "<!-- files -->";
const LINKED: &str = "<link rel=\"stylesheet\" href=\"/uplot.css\"><link rel=\"stylesheet\" href=\"/page.css\">\
                      <script defer src=\"/uplot.js\"></script><script defer src=\"/page.js\"></script>";

/// A file of the page by its path: its kind and text.
fn page_file(path: &str) -> Option<(&'static str, String)> {
    Some(match path {
        "" | "/" => ("text/html; charset=utf-8", HEAD.replace(FILES, LINKED)),
        "/uplot.js" => ("text/javascript; charset=utf-8", UPLOT.to_owned()),
        "/uplot.css" => ("text/css; charset=utf-8", UPLOT_STYLE.to_owned()),
        "/page.js" => ("text/javascript; charset=utf-8", SCRIPTS.concat()),
        "/page.css" => ("text/css; charset=utf-8", STYLE.to_owned()),
        _ => return None,
    })
}

/// The page as one file with the answers to its requests: path and JSON of each.
fn whole_page(title: &str, answers: &[(String, String)]) -> String {
    let name = title.replace('&', "&amp;").replace('<', "&lt;");
    let mut head = HEAD.replace("<title>csi5300</title>", &format!("<title>{name}: csi5300</title>"));
    head = head.replace(FILES, &format!("<style>{UPLOT_STYLE}{STYLE}</style>"));
    let (above, below) = head.rsplit_once("</body>").unwrap_or((&head, ""));
    let mut page = String::with_capacity(answers.iter().map(|answer| answer.1.len() + 64).sum::<usize>() + (1 << 17));
    page.push_str(above);
    page.push_str("<script type=\"application/json\" id=\"answers\">{");
    for (k, (path, json)) in answers.iter().enumerate() {
        // This sign is in strings only: no name from outside can end the element.
        let json = json.replace('<', "\\u003c");
        page.push_str(&format!("{}\"{path}\":{json}", if k == 0 { "" } else { "," }));
    }
    page.push_str("}</script>");
    for script in std::iter::once(UPLOT).chain(SCRIPTS) {
        page.push_str("<script>");
        page.push_str(script);
        page.push_str("</script>");
    }
    page.push_str("</body>");
    page.push_str(below);
    page
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::reading;
    use serde_json::Value;

    fn fixtures() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures")
    }

    fn ask(view: &View, path: &str, query: &str) -> Value {
        let answer = view.answer(path, query).unwrap();
        assert_eq!(answer.kind, "application/json");
        serde_json::from_slice(&answer.bytes).unwrap()
    }

    #[test]
    fn a_folder_answers_what_evaluate_and_the_log_say() {
        let view = View::open(&fixtures(), reading()).unwrap();
        let overview = ask(&view, "/data/overview", "");
        assert_eq!((overview["kind"].as_str(), overview["logs"].as_array().map(Vec::len)), (Some("captures"), Some(2)));
        assert_eq!(overview["links"].as_array().map(Vec::len), Some(1));
        // Until it is evaluated it is waited for.
        let waiting = ask(&view, "/data/link/0", "");
        assert_eq!(
            (&waiting["waiting"], waiting["logs"]["receiver"].is_u64()),
            (&Value::from(true), true),
            "{waiting}"
        );
        assert_eq!(ask(&view, "/data/rows", "")["known"], 0);
        let mut seen = Vec::new();
        view.finish(|done| seen.push(done));
        assert_eq!((seen, view.outcome()), (vec![1], (true, false)));
        let rows = ask(&view, "/data/rows", "");
        let row = &rows["rows"][0];
        assert!(row["error_from_mean_pose_deg"].as_f64().unwrap().abs() < 0.1, "{row}");
        assert_eq!(ask(&view, "/data/rows", "known=1")["rows"].as_array().map(Vec::len), Some(0));
        let sets = ask(&view, "/data/sets", "");
        assert_eq!((&sets["all"]["links"], &sets["all"]["beside"]), (&Value::from(1), &Value::Null));

        let link = ask(&view, "/data/link/0", "");
        assert_eq!(link["row"]["azimuth_deg"], row["azimuth_deg"]);
        let curve = &link["drawn"]["curves"][0];
        let values: Vec<f64> = curve["values"].as_array().unwrap().iter().filter_map(Value::as_f64).collect();
        let best = values.iter().position(|value| *value == 1.0).unwrap();
        let off = curve["azimuths_deg"][best].as_f64().unwrap() - row["azimuth_deg"].as_f64().unwrap();
        assert!(off.abs() < 1.0, "the curve's top is the answer: {off}");
        let receiver = link["logs"]["receiver"].as_u64().unwrap();
        let facts = ask(&view, &format!("/data/log/{receiver}"), "");
        assert!(facts["name"].as_str().unwrap().contains("csi_rx_"), "{facts}");
        assert_eq!(facts["senders"][0]["records"], facts["wsr"]);
    }

    #[test]
    fn a_stretch_of_a_log_is_what_was_asked_for() {
        let view = View::open(&fixtures().join("small-circle"), reading()).unwrap();
        let log = view.logs.iter().position(|log| log.name.starts_with("csi_rx_")).unwrap();
        let whole = ask(&view, &format!("/data/log/{log}/levels"), "columns=40");
        let to_s = whole["to_s"].as_f64().unwrap();
        let part = ask(&view, &format!("/data/log/{log}/levels"), &format!("from=0.5&to={to_s}&columns=40"));
        assert_eq!((part["from_s"].as_f64(), part["rssi"][0]["mean"].as_array().map(Vec::len)), (Some(0.5), Some(40)));
        assert!(part["records"].as_u64() < whole["records"].as_u64());
        let csi = ask(&view, &format!("/data/log/{log}/csi"), "columns=40&antenna=A");
        let antennas = csi["antennas"].as_array().unwrap();
        assert_eq!((antennas.len(), antennas[0]["antenna"].as_str()), (1, Some("A")));
        let cells = antennas[0]["amplitude_db"]["cells"].as_str().unwrap();
        assert_eq!(cells.len(), (40_usize * 30).div_ceil(3) * 4);
    }

    #[test]
    fn a_heat_map_is_of_one_sender() {
        let folder = std::env::temp_dir().join(format!("csi5300-senders-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let read = |name: &str| std::fs::read(fixtures().join("small-circle").join(name)).unwrap();
        let (rx, tx) = (read("csi_rx_2023-11-14_221320.dat"), read("csi_tx1_2023-11-14_221320.dat"));
        std::fs::write(folder.join("both.dat"), [&tx[..tx.len() / 2], &rx].concat()).unwrap();
        let view = View::open(&folder, reading()).unwrap();
        let senders = ask(&view, "/data/log/0", "")["senders"].clone();
        let most = senders.as_array().unwrap().iter().max_by_key(|sender| sender["records"].as_u64()).unwrap();
        let csi = ask(&view, "/data/log/0/csi", "columns=40");
        assert_eq!((senders.as_array().map(Vec::len), &csi["sender"]), (Some(2), &most["mac"]), "{senders}");
        assert_eq!(csi["records"], most["records"], "{senders}");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_stretch_of_a_log_that_was_replaced_is_refused_until_the_page_is_loaded_again() {
        let folder = std::env::temp_dir().join(format!("csi5300-view-replaced-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let fixture =
            View::open(&fixtures(), reading()).unwrap().logs.iter().next().map(|log| log.path.clone()).unwrap();
        let log = folder.join("a.dat");
        std::fs::copy(&fixture, &log).unwrap();
        let view = View::open(&log, reading()).unwrap();
        ask(&view, "/data/log/0/csi", "columns=40");
        std::fs::copy(&fixture, folder.join("b")).unwrap();
        std::fs::rename(folder.join("b"), &log).unwrap();
        for what in ["csi", "levels"] {
            let error = view.answer(&format!("/data/log/0/{what}"), "").map(|_| ()).unwrap_err();
            assert!(error.status() == 409 && error.to_string().contains("was changed since"), "{what}: {error}");
        }
        ask(&view, "/data/log/0", "");
        ask(&view, "/data/log/0/csi", "columns=40");
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn what_cannot_be_meant_is_said() {
        let view = View::open(&fixtures(), reading()).unwrap();
        for path in [
            "/data/log/9",
            "/data/link/7",
            "/data/states",
            "/../Cargo.toml",
            "/data/log/0/../1",
            "/data/log/-1",
            "//",
            "",
        ] {
            let error = view.answer(path, "").map(|answer| answer.kind);
            assert!(path.is_empty() && error.is_ok() || error.is_err_and(|error| error.status() == 404), "{path}");
        }
        for query in ["columns=many", "from=x", "sender=nobody"] {
            let error = view.answer("/data/log/0/levels", query).map(|_| ()).unwrap_err();
            assert_eq!(error.status(), 400, "{query}: {error}");
        }
        let endless = ask(&view, "/data/log/0/levels", "columns=99999999&from=nan&to=inf");
        assert!(endless["columns"].as_u64() <= Some(4_000), "{}", endless["columns"]);
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
        for (path, words) in [
            (PathBuf::from("/nowhere"), "/nowhere: No such file"),
            (fixtures().join("small-circle.toml"), "no intact CSI record in it"),
            (source, "no log and no capture below"),
        ] {
            let why = View::open(&path, reading()).err().unwrap().to_string();
            assert!(why.contains(words), "{why}");
        }
    }

    #[test]
    fn the_page_as_one_file_has_all_its_answers_and_fetches_nothing() {
        let view = View::open(&fixtures(), reading()).unwrap();
        view.finish(|_| {});
        let page = view.file().unwrap();
        assert!(page.len() < 400 * 1024, "{} KiB", page.len() / 1024);
        for outside in ["src=\"", "href=\"http", "@import", "url(http"] {
            assert!(!page.contains(outside), "{outside}");
        }
        let (_, rest) = page.split_once("<script type=\"application/json\" id=\"answers\">").unwrap();
        let answers: Value = serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap();
        for path in
            ["/data/overview", "/data/rows", "/data/sets", "/data/link/0", "/data/log/1/levels", "/data/log/0/csi"]
        {
            assert!(answers.get(path).is_some(), "{path}");
        }
        assert_eq!(answers["/data/rows"], ask(&view, "/data/rows", ""));
    }

    #[test]
    fn names_from_outside_cannot_become_markup() {
        let answers = [("/data/overview".to_owned(), r#"{"name":"</script><script>x()<!--"}"#.to_owned())];
        let page = whole_page("</title><b>", &answers);
        assert!(!page.contains("<script>x()") && !page.contains("<b>") && !page.contains("x()<!--"));
        let inside = page.split_once("id=\"answers\">").unwrap().1.split_once("</script>").unwrap().0;
        let back: serde_json::Value = serde_json::from_str(inside).unwrap();
        assert_eq!(back["/data/overview"]["name"], "</script><script>x()<!--");
    }

    #[test]
    fn every_file_that_the_page_names_is_there() {
        let (_, head) = page_file("/").unwrap();
        let named: Vec<&str> = head.split("\"/").skip(1).filter_map(|rest| rest.split('"').next()).collect();
        assert_eq!(named.len(), 4, "{named:?}");
        named.iter().for_each(|name| assert!(page_file(&format!("/{name}")).is_some(), "{name}"));
        assert!(page_file("/page/base.js").is_none());
        // What ends a script would end it in the one file too.
        assert!(SCRIPTS.iter().chain([&UPLOT]).all(|script| !script.contains("</script")));
    }
}
