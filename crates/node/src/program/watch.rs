//! A running node in a terminal.

use csi5300::time::Instant;
use csi5300_live::wait::{Monotonic, Signals};
use csi5300_say::{Outcome, Result, fixed, print};
use nix::sys::signal::Signal;
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::canvas::{Canvas, Circle, Line as Stroke};
use ratatui::widgets::{Block, Paragraph, Row, Table};
use serde_json::Value;
use std::fs::File;
use std::io::{BufRead, BufReader, IsTerminal, Read};
use std::mem::ManuallyDrop;
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

// Arguments of `watch`.
#[derive(clap::Args)]
pub struct Args {
    /// The node's status socket [default: that of the configuration that `node` finds, else /run/csi5300/status.sock]
    #[arg(value_name = "SOCKET")]
    socket: Option<PathBuf>,
    /// Print one state as a table and exit. Without it, an output that is no terminal gets one state as JSON
    #[arg(long)]
    once: bool,
}

/// Time between two reads of the state.
const LOOK: csi5300::time::Span = csi5300::time::Span::from_ms(100);
/// Bytes of a state at most.
const LONGEST: u64 = 16 << 20;
/// Silence after which the screen reports it.
const SILENT: Duration = Duration::from_secs(3);
/// Columns of the table of peers with its frame.
const TABLE: u16 = 80;
/// A node that hangs sends nothing for this long.
const HANGS: Duration = Duration::from_secs(10);
/// Colours of the peers, in their order; they are also numbered.
const COLOURS: [Color; 6] =
    [Color::Cyan, Color::Yellow, Color::Green, Color::Magenta, Color::LightRed, Color::LightBlue];

/// The signals that end the program, after the terminal is restored. SIGQUIT is one, which would dump core.
struct Ends {
    signals: Signals,
    clock: Monotonic,
}

impl Ends {
    /// True once one arrived.
    fn is_one_here(&self) -> bool {
        let come = self.clock.wait([self.signals.as_fd()], Some(self.clock.now()));
        come.is_ok_and(|[come]| come)
    }

    /// Waits for a key, a signal or `until`; true for a key that ends the program, and if the terminal closed.
    fn wait(&self, keys: &mut Keys, until: Instant) -> bool {
        let fds = [keys.terminal.as_fd(), self.signals.as_fd()];
        self.clock.wait(fds, Some(until)).is_ok_and(|[key, _]| key) && keys.end()
    }
}

/// The keyboard. crossterm is not used, because it reads a closed terminal for ever (its `mio.rs`: neither an end nor
/// an error leaves the inner loop) while signals are blocked.
struct Keys {
    terminal: File,
}

impl Keys {
    fn open() -> std::io::Result<Self> {
        let stdin = std::io::stdin();
        let terminal =
            if stdin.is_terminal() { File::from(stdin.as_fd().try_clone_to_owned()?) } else { File::open("/dev/tty")? };
        Ok(Self { terminal })
    }

    /// Reads available keys: true for q, Escape and Ctrl-C, and if the terminal closed.
    fn end(&mut self) -> bool {
        let mut bytes = [0; 64];
        let Ok(read) = self.terminal.read(&mut bytes) else { return true };
        match bytes.get(..read).unwrap_or_default() {
            [] | [0x1b] => true,
            // An arrow, a function key.
            [0x1b, ..] => false,
            keys => keys.iter().any(|key| matches!(key, b'q' | 0x03)),
        }
    }
}

/// Shows a running node until `q` or a signal.
pub fn run(args: &Args) -> Result {
    let socket = args.socket.clone().unwrap_or_else(super::status_socket);
    let stream = connect(&socket)?;
    if args.once || !std::io::stdout().is_terminal() {
        stream.set_read_timeout(Some(HANGS)).map_err(|error| error.to_string())?;
        let state = first(lines(stream)).map_err(|error| format!("{}: {error}", socket.display()))?;
        print(&if args.once {
            table_of(&serde_json::from_str(&state).map_err(|error| format!("the node's state: {error}"))?)
        } else {
            state + "\n"
        });
        return Ok(Outcome::Done);
    }
    let states = lines(stream);
    // Before the thread starts, and before there is anything to restore.
    let signals = Signals::catch_with(&[Signal::SIGQUIT]).map_err(|error| error.to_string())?;
    let ends = Ends { signals, clock: Monotonic::new() };
    let (told, from_node) = channel();
    std::thread::spawn(move || {
        for line in states {
            let is_last = line.is_err();
            let state = line.map_or_else(
                |error| Some(serde_json::json!({ "trouble": [error.to_string()] })),
                |line| serde_json::from_str(&line).ok(),
            );
            let Some(state) = state else { continue };
            if told.send(state).is_err() || is_last {
                return;
            }
        }
    });
    let mut keys = Keys::open().map_err(|error| format!("the terminal: {error}"))?;
    // Dropping it would show the cursor, and panic if terminal and standard error are gone.
    let mut terminal = ManuallyDrop::new(ratatui::init());
    let shown = show(&mut terminal, &from_node, &socket, (&ends, &mut keys));
    // Without a terminal there is nothing to restore or report.
    let _ = terminal.show_cursor();
    let _ = ratatui::try_restore();
    match shown {
        // Drawing fails on a closed terminal; a hangup or the end reports it.
        Err(_) if ends.is_one_here() || ends.wait(&mut keys, ends.clock.now()) => Ok(Outcome::Done),
        shown => shown.map_err(|error| error.to_string()),
    }
}

/// The first state of a node.
fn first(mut lines: impl Iterator<Item = std::io::Result<String>>) -> std::result::Result<String, String> {
    match lines.find(|line| !line.as_ref().is_ok_and(String::is_empty)) {
        Some(Err(error)) if error.kind() == std::io::ErrorKind::WouldBlock => {
            Err(format!("no state within {} s: does the node hang?", HANGS.as_secs()))
        }
        Some(state) => state.map_err(|error| error.to_string()),
        None => Err("the node ended before it sent its state, or it already has 16 readers".into()),
    }
}

/// The lines of a node, up to an incomplete one.
fn lines(stream: UnixStream) -> impl Iterator<Item = std::io::Result<String>> {
    let mut stream = BufReader::new(stream);
    std::iter::from_fn(move || {
        let mut line = String::new();
        match (&mut stream).take(LONGEST).read_line(&mut line) {
            Ok(read) if read as u64 >= LONGEST && !line.ends_with('\n') => {
                Some(Err(std::io::Error::other(format!("the node's state has more than {} MiB", LONGEST >> 20))))
            }
            Ok(_) if !line.ends_with('\n') => None,
            Ok(_) => Some(Ok(line.trim_end_matches('\n').to_owned())),
            Err(error) => Some(Err(error)),
        }
    })
}

fn connect(socket: &Path) -> std::result::Result<UnixStream, String> {
    UnixStream::connect(socket).map_err(|error| {
        let hint = "does the node run, and is this its `output.status_socket`?";
        format!("{}: {error}; {hint}", socket.display())
    })
}

/// Draws every state until a key or a signal ends it.
fn show(
    terminal: &mut ratatui::DefaultTerminal,
    states: &Receiver<Value>,
    socket: &Path,
    (ends, keys): (&Ends, &mut Keys),
) -> std::io::Result<Outcome> {
    let mut state = Value::Null;
    let mut silent = Duration::ZERO;
    while !ends.is_one_here() {
        match states.try_iter().last() {
            Some(new) => (state, silent) = (new, Duration::ZERO),
            None => silent += Duration::from_micros(LOOK.as_us().unsigned_abs()),
        }
        let title = if silent > SILENT { "  no state from the node: it ended or hangs" } else { "" };
        terminal.draw(|frame| draw(frame, &state, &format!(" {}{title} ", socket.display())))?;
        if ends.wait(keys, ends.clock.now() + LOOK) {
            break;
        }
    }
    Ok(Outcome::Done)
}

/// The table of peers and the compass: beside each other if there is room, else below each other.
fn parts(area: Rect, peers: usize) -> [Rect; 2] {
    let side = (area.height * 2).min(area.width / 2);
    if area.width.saturating_sub(side) >= TABLE {
        return Layout::horizontal([Constraint::Min(TABLE), Constraint::Length(side)]).areas(area);
    }
    let rows = u16::try_from(peers).unwrap_or(u16::MAX).saturating_add(3).min(area.height / 2).max(4);
    Layout::vertical([Constraint::Length(rows), Constraint::Min(0)]).areas(area)
}

fn number(value: &Value, path: &str) -> Option<f64> {
    value.pointer(path)?.as_f64()
}

fn text(value: &Value, path: &str) -> String {
    value.pointer(path).and_then(Value::as_str).unwrap_or_default().to_owned()
}

fn figure(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".into(), |value| fixed(value, digits))
}

/// One decimal below a hundred, for lack of room.
fn short(value: Option<f64>) -> String {
    figure(value, if value.is_some_and(|value| value < 99.95) { 1 } else { 0 })
}

/// The whole screen.
fn draw(frame: &mut Frame<'_>, state: &Value, title: &str) {
    let peers = state["peers"].as_array().cloned().unwrap_or_default();
    let trouble = troubles(state);
    let rows =
        [Constraint::Length(6), Constraint::Min(8), Constraint::Length(trouble.len() as u16), Constraint::Length(1)];
    let [head, middle, wrong, foot] = Layout::vertical(rows).areas(frame.area());
    frame.render_widget(Paragraph::new(summary(state)).block(Block::bordered().title(title.to_owned())), head);
    let [list, rose] = parts(middle, peers.len());
    frame.render_widget(table(&peers, list.height), list);
    compass(frame, rose, state, &peers);
    frame.render_widget(Paragraph::new(trouble).style(Style::new().fg(Color::Red)), wrong);
    frame.render_widget(Paragraph::new("q ends; bearings are in the odometry's frame, +x to the right"), foot);
}

/// What is wrong, in four lines at most.
fn troubles(state: &Value) -> Vec<Line<'_>> {
    const MOST: usize = 4;
    let all: Vec<&str> = state["trouble"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
    let shown = if all.len() > MOST { MOST - 1 } else { all.len() };
    let mut lines: Vec<Line> = all[..shown].iter().copied().map(Line::from).collect();
    if shown < all.len() {
        lines.push(Line::from(format!("and {} more: csi5300 watch --once", all.len() - shown)));
    }
    lines
}

/// The team's graph, if there is one.
fn team(state: &Value) -> String {
    let Some(team) = state.get("team").filter(|team| !team.is_null()) else { return String::new() };
    let notes: Vec<&str> = team["notes"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
    let robots = team["robots"].as_array().map_or(0, Vec::len);
    let solved = if robots == 0 { "not solved".to_owned() } else { format!("{robots} robots placed") };
    let notes = if notes.is_empty() { String::new() } else { format!(": {}", notes.join("; ")) };
    format!("; team: {solved}{notes}")
}

fn summary(state: &Value) -> Vec<Line<'static>> {
    let of = |path| number(state, path);
    let lost = of("/losses").unwrap_or(0.0);
    let disk = of("/log/dropped").unwrap_or(0.0) + of("/log/lost_on_disk").unwrap_or(0.0);
    let pose = format!(
        "x {} m, y {} m, heading {} deg",
        figure(of("/pose/1/0"), 2),
        figure(of("/pose/1/1"), 2),
        figure(of("/pose/2").map(|deg| deg.round().rem_euclid(360.0)), 0)
    );
    let log = match of("/log/written") {
        Some(written) => format!("{written:.0} records, {disk:.0} not"),
        None => "none".into(),
    };
    vec![
        Line::from(vec![
            Span::styled(text(state, "/name"), Style::new().add_modifier(Modifier::BOLD)),
            Span::raw(format!("  up {} s  log: {log}", figure(of("/uptime_s"), 0))),
        ]),
        Line::from(format!(
            "records {}, {}/s; lost {lost:.0}, missing in bfee_count {}; of other senders {}",
            figure(of("/records"), 0),
            figure(of("/records_hz"), 0),
            figure(of("/missing"), 0),
            figure(of("/strangers"), 0)
        )),
        Line::from(format!("poses {}/s: {pose}{}", figure(of("/poses_hz"), 0), team(state))),
        Line::from(format!(
            "load {} % of a core, {} MiB; estimate {} ms, longest {}; late {} ms",
            short(of("/load/cpu_percent")),
            figure(of("/load/memory_mib"), 0),
            short(of("/load/estimate_ms")),
            short(of("/load/longest_estimate_ms")),
            short(of("/load/late_ms"))
        )),
    ]
}

/// Heads of the table of peers.
const HEADS: [&str; 7] = ["peer", "bearing, deg", "prob.", "range m", "pairs/s", "lost", "age"];

/// A peer's row.
fn cells(k: usize, peer: &Value) -> [String; 7] {
    let of = |path: &str| number(peer, path);
    let bearing = match (of("/report/azimuth_deg"), of("/report/azimuth_sd_deg"), of("/report/mirror_deg")) {
        (Some(azimuth), sd, mirror) => {
            let mirror = mirror.map_or(String::new(), |mirror| format!(" or {}", fixed(mirror, 1)));
            format!("{} +- {}{mirror}", fixed(azimuth, 1), figure(sd, 1))
        }
        _ => text(peer, "/report/words"),
    };
    [
        format!("{} {}", k + 1, text(peer, "/name")),
        bearing,
        figure(of("/report/confidence"), 2),
        figure(of("/report/range_m"), 1),
        figure(of("/pairs_hz"), 0),
        figure(of("/counts/losses"), 0),
        of("/report/age_s").map_or_else(String::new, |age| format!("{age:.0} s")),
    ]
}

/// One state as text: what the screen shows without its compass.
fn table_of(state: &Value) -> String {
    let peers = state["peers"].as_array().cloned().unwrap_or_default();
    let rows = peers.iter().enumerate().map(|(k, peer)| cells(k, peer));
    let rows: Vec<[String; 7]> = std::iter::once(HEADS.map(str::to_owned)).chain(rows).collect();
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: [usize; 7] = std::array::from_fn(width);
    let mut text: String = summary(state).iter().map(|line| format!("{line}\n")).collect();
    for row in &rows {
        let padded: Vec<String> = row.iter().zip(widths).map(|(cell, width)| format!("{cell:width$}")).collect();
        text.push_str(padded.join("  ").trim_end());
        text.push('\n');
    }
    let trouble = state["trouble"].as_array().into_iter().flatten().filter_map(Value::as_str);
    text.extend(trouble.map(|trouble| format!("trouble: {trouble}\n")));
    text
}

/// The peers, as many as there is room for in so many lines.
fn table(peers: &[Value], lines: u16) -> Table<'static> {
    // Two lines are the frame, one has the heads.
    let room = usize::from(lines.saturating_sub(3));
    let title = match peers.len() {
        all if all > room => format!(" {room} of {all} peers; all: csi5300 watch --once "),
        _ => " peers ".to_owned(),
    };
    let row = |(k, peer): (usize, &Value)| {
        let held = text(peer, "/report/state") == "held";
        let style = Style::new().fg(COLOURS.get(k % COLOURS.len()).copied().unwrap_or(Color::White));
        Row::new(cells(k, peer)).style(if held { style.add_modifier(Modifier::DIM) } else { style })
    };
    let widths = [
        Constraint::Length(12),
        Constraint::Min(32),
        Constraint::Length(5),
        Constraint::Length(7),
        Constraint::Length(7),
        Constraint::Length(4),
        Constraint::Length(5),
    ];
    let head = Row::new(HEADS).style(Style::new().add_modifier(Modifier::BOLD));
    Table::new(peers.iter().enumerate().map(row), widths).header(head).block(Block::bordered().title(title))
}

/// Bearings on a circle; mirrors thin, this robot's heading as a tick.
fn compass(frame: &mut Frame<'_>, area: Rect, state: &Value, peers: &[Value]) {
    let towards = |deg: f64, length: f64| (length * deg.to_radians().cos(), length * deg.to_radians().sin());
    let block = Block::bordered().title(" bearings ");
    // A cell of a terminal is twice as high as wide; the circle fills the shorter side.
    let inside = block.inner(area);
    let (width, height) = (f64::from(inside.width.max(1)), 2.0 * f64::from(inside.height.max(1)));
    let [across, up] = [width, height].map(|side| 1.35 * side / width.min(height));
    let canvas =
        Canvas::default().block(block).marker(Marker::Braille).x_bounds([-across, across]).y_bounds([-up, up]).paint(
            |context| {
                context.draw(&Circle { x: 0.0, y: 0.0, radius: 1.0, color: Color::DarkGray });
                for deg in [0.0, 90.0, 180.0, -90.0] {
                    let ((x1, y1), (x2, y2)) = (towards(deg, 1.0), towards(deg, 1.06));
                    context.draw(&Stroke { x1, y1, x2, y2, color: Color::DarkGray });
                    let (x, y) = towards(deg, 1.16);
                    context.print(x, y, Span::styled(format!("{deg:.0}"), Style::new().fg(Color::DarkGray)));
                }
                if let Some(heading) = number(state, "/pose/2") {
                    let ((x1, y1), (x2, y2)) = (towards(heading, 0.9), towards(heading, 1.0));
                    context.draw(&Stroke { x1, y1, x2, y2, color: Color::White });
                }
                for (k, peer) in peers.iter().enumerate() {
                    let color = COLOURS.get(k % COLOURS.len()).copied().unwrap_or(Color::White);
                    for (path, length) in [("/report/azimuth_deg", 1.0), ("/report/mirror_deg", 0.5)] {
                        let Some(deg) = number(peer, path) else { continue };
                        let (x2, y2) = towards(deg, length);
                        context.draw(&Stroke { x1: 0.0, y1: 0.0, x2, y2, color });
                        let (x, y) = towards(deg, length + 0.12);
                        context.print(x, y, Span::styled((k + 1).to_string(), Style::new().fg(color)));
                    }
                }
            },
        );
    frame.render_widget(canvas, area);
}

#[cfg(test)]
mod tests {
    use super::*;
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    fn screen(state: &Value, width: u16, height: u16) -> String {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(frame, state, "status.sock")).unwrap();
        let buffer = terminal.backend().buffer().clone();
        let line = |y: u16| (0..width).map(|x| buffer[(x, y)].symbol().to_owned()).collect::<String>();
        (0..height).map(|y| line(y) + "\n").collect()
    }

    #[test]
    fn a_node_that_hangs_is_given_up() {
        let (stream, _node) = UnixStream::pair().unwrap();
        stream.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
        assert!(first(lines(stream)).unwrap_err().contains("no state within 10 s"));
    }

    #[test]
    fn a_state_fills_the_screen_and_a_small_one_does_not_break() {
        let state = serde_json::json!({
            "name": "burger-1", "uptime_s": 12.0, "records": 1200, "records_hz": 100.0, "losses": 3,
            "pose": [1.7e9, [0.25, -0.5, 0.0], 359.7],
            "load": {"cpu_percent": 106.0, "memory_mib": 120.0, "estimate_ms": 133.2, "longest_estimate_ms": 1059.3, "late_ms": 1101.3}, "trouble": ["the port is gone"],
            "log": {"written": 1199, "dropped": 1, "lost_on_disk": 0},
            "peers": [
                {"name": "alpha", "pairs_hz": 99.0, "report": {"azimuth_deg": 41.25, "azimuth_sd_deg": 0.5,
                 "mirror_deg": -141.0, "confidence": 0.93, "range_m": 4.25, "state": "bearing"}, "counts": {"losses": 17}},
                {"name": "beta", "pairs_hz": 98.0, "report": {"words": "not yet: moved 0.04 m of 0.11 m", "state": "not_yet"}},
            ],
        });
        let on_any =
            ["burger-1", "100/s", "41.2 +- 0.5 or -141.0", "0.93", "4.2", "17", "not yet: moved 0.04 m", "lost 3"];
        let heads = [
            "late 1101 ms",
            "heading 0 deg",
            "bearing, deg",
            "prob.",
            "range m",
            "pairs/s",
            "lost",
            "age",
            "-90",
            "180",
            "the port is gone",
        ];
        for (width, height) in [(80, 24), (120, 30), (200, 50)] {
            let shown = screen(&state, width, height);
            for words in on_any.iter().chain(&heads) {
                assert!(shown.contains(words), "no `{words}` in\n{shown}");
            }
        }
        let five = screen(&serde_json::json!({ "trouble": ["one", "two", "three", "four", "five"] }), 80, 24);
        assert!(five.contains("three") && five.contains("and 2 more: ") && !five.contains("four"), "{five}");
        let crowd = serde_json::json!({ "peers": (0..20).map(|k| serde_json::json!({ "name": format!("robot-{k}") })).collect::<Vec<_>>() });
        let small = screen(&crowd, 80, 24);
        assert!(small.contains(" 5 of 20 peers; all: csi5300 watch --once ") && !small.contains("robot-5"), "{small}");
        let large = screen(&crowd, 200, 50);
        assert!(large.contains(" peers ") && large.contains("robot-19"), "{large}");
        // The circle is as wide as high, in units of half a cell's height.
        let shown = screen(&serde_json::json!({}), 120, 30);
        let drawn = |line: &str| {
            line.chars()
                .enumerate()
                .filter(|(_, dot)| ('\u{2801}'..='\u{28ff}').contains(dot))
                .map(|(x, _)| x)
                .collect::<Vec<_>>()
        };
        let lines: Vec<Vec<usize>> = shown.lines().map(drawn).filter(|line| !line.is_empty()).collect();
        let (left, right) = (lines.iter().flatten().min().unwrap(), lines.iter().flatten().max().unwrap());
        let (width, height) = ((right - left + 1) as f64, 2.0 * lines.len() as f64);
        assert!((width / height - 1.0).abs() < 0.15, "{width} x {height}\n{shown}");
        screen(&state, 20, 5);
        screen(&Value::Null, 80, 24);
    }
}
