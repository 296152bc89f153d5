//! `view` until a signal comes, and the end is a good one.

use super::commands::Folder;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use std::io::{Read, Write};
use std::process::{Child, Command, Stdio};

/// The program, started with signals as usual: tests may run with SIGHUP ignored. `None` where `env` cannot do that.
fn usual() -> Option<Command> {
    let known = Command::new("env").args(["--default-signal", "true"]).output();
    if !known.is_ok_and(|output| output.status.success()) {
        crate::common::skipped("`env --default-signal` is not there (coreutils 8.31)");
        return None;
    }
    let mut command = Command::new("env");
    command.args(["--default-signal", env!("CARGO_BIN_EXE_csi5300")]);
    Some(command)
}

fn send(child: &Child, signal: Signal) {
    kill(Pid::from_raw(child.id() as i32), signal).unwrap();
}

#[test]
fn a_signal_ends_the_page_as_it_ends_a_recording() {
    use std::io::{BufRead, BufReader};
    let folder = Folder::new("view-signals");
    folder.write("rx.dat", &crate::common::link(100, 1.0).rx.concat());
    for signal in [Signal::SIGTERM, Signal::SIGINT, Signal::SIGHUP] {
        let Some(mut command) = usual() else { return };
        command.arg("view").arg(folder.0.join("rx.dat")).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let mut address = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut address).unwrap();
        // An answer comes from a server that has begun, and with it its signals.
        let place = address.trim().trim_start_matches("http://").trim_end_matches('/');
        let mut page = std::net::TcpStream::connect(place).unwrap();
        write!(page, "GET /data/overview HTTP/1.1\r\nHost: {place}\r\nConnection: close\r\n\r\n").unwrap();
        let mut answer = String::new();
        page.read_to_string(&mut answer).unwrap();
        assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
        send(&child, signal);
        assert_eq!(child.wait().unwrap().code(), Some(0), "{signal}");
    }
}

#[test]
fn a_pipe_is_no_log_for_the_page() {
    let folder = Folder::new("view-pipe");
    let made = Command::new("mkfifo").arg(folder.0.join("p.dat")).status();
    assert!(made.is_ok_and(|status| status.success()), "mkfifo");
    let (status, _, err) = folder.run(&["view", "p.dat"]);
    assert!(status == 1 && err.contains("p.dat is a pipe or a device"), "{status} {err}");
}
