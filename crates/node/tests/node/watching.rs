//! `watch` until a signal comes: the terminal is as it was, and the end is a good one.

use nix::fcntl::{FcntlArg, FdFlag, fcntl};
use nix::pty::{OpenptyResult, Winsize, openpty};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use std::fs::File;
use std::io::{Read, Write};
use std::os::unix::net::UnixListener;
use std::process::{Child, Command, Stdio};

/// The program, started with signals as usual: tests may run with SIGHUP ignored. `None` where `env` cannot do that.
fn usual() -> Option<Command> {
    let known = Command::new("env").args(["--default-signal", "true"]).output();
    if !known.is_ok_and(|output| output.status.success()) {
        crate::common::skipped("`env --default-signal` is not there (coreutils 8.31)");
        return None;
    }
    let mut command = Command::new("env");
    command.args(["--default-signal", env!("CARGO_BIN_EXE_csi5300-node")]);
    Some(command)
}

/// A terminal whose ends no program inherits: one that holds its own terminal's other end never sees that it ended.
fn terminal() -> OpenptyResult {
    let size = Winsize { ws_row: 24, ws_col: 100, ws_xpixel: 0, ws_ypixel: 0 };
    let ends = openpty(&size, None).unwrap();
    for end in [&ends.master, &ends.slave] {
        fcntl(end, FcntlArg::F_SETFD(FdFlag::FD_CLOEXEC)).unwrap();
    }
    ends
}

fn send(child: &Child, signal: Signal) {
    kill(Pid::from_raw(child.id() as i32), signal).unwrap();
}

#[test]
fn a_signal_gives_the_terminal_back_as_it_was() {
    let folder = crate::program::folder("watch-signals");
    for signal in [Signal::SIGTERM, Signal::SIGINT, Signal::SIGHUP, Signal::SIGQUIT] {
        let Some(mut command) = usual() else { return };
        let socket = folder.join(format!("{signal}.sock"));
        let node = UnixListener::bind(&socket).unwrap();
        let terminal = terminal();
        let side = || Stdio::from(terminal.slave.try_clone().unwrap());
        let mut child = command
            .arg("watch")
            .arg(&socket)
            .stdin(side())
            .stdout(side())
            .stderr(side())
            .env("TERM", "xterm")
            .spawn()
            .unwrap();
        let mut state = node.accept().unwrap().0;
        state.write_all(b"{\"name\": \"burger-7\"}\n").unwrap();
        let echoes = || {
            let flags = nix::sys::termios::tcgetattr(&terminal.slave).unwrap().local_flags;
            flags.contains(nix::sys::termios::LocalFlags::ECHO | nix::sys::termios::LocalFlags::ICANON)
        };
        let mut screen = File::from(terminal.master.try_clone().unwrap());
        let (mut shown, mut bytes) = (String::new(), [0; 4096]);
        while !shown.contains("burger-7") {
            let count = screen.read(&mut bytes).unwrap();
            shown += &String::from_utf8_lossy(&bytes[..count]);
        }
        assert!(shown.contains("\x1b[?1049h") && !echoes(), "{signal}: it is on a screen of its own");
        send(&child, signal);
        assert_eq!(child.wait().unwrap().code(), Some(0), "{signal}");
        assert!(echoes(), "{signal}");
        nix::unistd::write(&terminal.slave, b"end").unwrap();
        while !shown.ends_with("end") {
            let count = screen.read(&mut bytes).unwrap();
            shown += &String::from_utf8_lossy(&bytes[..count]);
        }
        assert!(shown.contains("\x1b[?1049l"), "{signal}: {shown:?}");
        assert!(shown.rfind("\x1b[?25h") > shown.rfind("\x1b[?25l"), "{signal}: {shown:?}");
    }
}

#[test]
fn a_line_without_an_end_is_given_up() {
    let folder = crate::program::folder("watch-endless");
    let socket = folder.join("status.sock");
    let node = UnixListener::bind(&socket).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_csi5300-node"));
    command.args(["watch", "--once"]).arg(&socket).stdout(Stdio::piped()).stderr(Stdio::piped());
    let child = command.spawn().unwrap();
    let mut state = node.accept().unwrap().0;
    // Until nobody reads any more.
    while state.write_all(&[b'a'; 1 << 16]).is_ok() {}
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(1) && said.contains("more than 16 MiB") && output.stdout.is_empty(), "{said}");
}

/// As when an SSH session or a pane goes: by a hangup where it is the program's own terminal, and where that does not reach the
/// program (`nohup`, another session) the end of the terminal is all that there is to see.
#[test]
fn a_closed_terminal_ends_the_display() {
    let folder = crate::program::folder("watch-ended");
    for is_own in [true, false] {
        let Some(mut command) = usual() else { return };
        if is_own {
            let usual = command;
            command = Command::new("setsid");
            command.arg("--ctty").arg(usual.get_program()).args(usual.get_args());
        }
        let socket = folder.join(format!("{is_own}.sock"));
        let node = UnixListener::bind(&socket).unwrap();
        let terminal = terminal();
        let side = || Stdio::from(terminal.slave.try_clone().unwrap());
        command.arg("watch").arg(&socket).stdin(side()).stdout(side()).stderr(side()).env("TERM", "xterm");
        let mut child = command.spawn().unwrap();
        drop(command);
        let mut state = node.accept().unwrap().0;
        state.write_all(b"{\"name\": \"burger-7\"}\n").unwrap();
        let mut screen = File::from(terminal.master);
        let (mut shown, mut bytes) = (String::new(), [0; 4096]);
        while !shown.contains("burger-7") {
            let count = screen.read(&mut bytes).unwrap();
            shown += &String::from_utf8_lossy(&bytes[..count]);
        }
        // Part of an arrow key, after which crossterm would wait for the rest.
        screen.write_all(b"\x1b[").unwrap();
        drop((screen, terminal.slave));
        assert_eq!(child.wait().unwrap().code(), Some(0), "its own: {is_own}");
    }
}
