//! `csi5300 view`: a page in the browser about a log, captures or a running node.

use super::args::{Estimation, Mounting, Which, address, antenna, reading};
use super::{InWords, Outcome, Result, print, usage};
use csi5300::signal::channel::Channel;
use csi5300_view::{Ends, Server, View};
use driver_iface::bfee::Antenna;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;

// Arguments of `view`.
#[derive(clap::Args)]
#[command(after_help = "Ctrl-C ends it. `evaluate --html` writes the page as one file.\n\
                        Example: csi5300 view captures --open")]
pub struct Args {
    /// A log, a folder of captures or logs, or the status socket of a running node
    #[arg(value_name = "LOG|DIR|SOCKET", required = true)]
    what: Vec<PathBuf>,
    /// Address to listen on; port 0 takes any free port. Everybody who can reach the address can see the page
    #[arg(long, default_value = "127.0.0.1:0", value_parser = address, value_name = "ADDRESS:PORT")]
    listen: SocketAddr,
    /// Open the page in the browser
    #[arg(long)]
    open: bool,
    /// Which trajectory of captures to use
    #[arg(long, value_enum, default_value = "gt")]
    trajectory: Which,
    /// WiFi channel, with + or - for 40 MHz [default: the capture's]
    #[arg(long, value_name = "NUMBER")]
    channel: Option<Channel>,
    /// Antenna (RF port) used on both robots: A, B or C
    #[arg(long, default_value = "A", value_parser = antenna)]
    antenna: Antenna,
}

/// Serves the page until a signal ends it.
pub fn run(args: &Args) -> Result {
    let [what] = args.what.as_slice() else {
        usage("view takes one log, folder or socket: put the files of a capture into one folder, and name that")
    };
    // Before there are threads, which inherit it.
    let ends = Ends::catch(ends_by_hangup()).in_words()?;
    // Before it is opened: a pipe would be waited for.
    View::check(what).in_words()?;
    if !csi5300_lab::cards::is_log(what) {
        super::files::must_be_log(what)?;
    }
    let estimation = Estimation { antenna: vec![args.antenna], ..Estimation::default() };
    let reading = reading(args.trajectory, &Mounting::default(), args.channel, &estimation);
    let view = View::open(what, reading).in_words()?;
    view.left_out().iter().for_each(|words| note!("{words}"));
    let view = Arc::new(view);
    let server = Server::listen(args.listen).in_words()?;
    let address = server.address();
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    // One core is left for who clicks.
    view.start(cores.saturating_sub(1).max(1)).in_words()?;
    let shown =
        if address.ip().is_unspecified() { SocketAddr::new([127, 0, 0, 1].into(), address.port()) } else { address };
    let url = format!("http://{shown}/");
    print(&format!("{url}\n"));
    if !address.ip().is_loopback() {
        note!("everybody who can reach {address} can see the page; nobody can change anything");
    }
    if args.open {
        open(&url);
    }
    server.run(&view, &ends).in_words()?;
    Ok(Outcome::Done)
}

/// SIGHUP ends it, unless it is ignored, as under `nohup`.
fn ends_by_hangup() -> bool {
    !csi5300_live::wait::is_ignored(nix::sys::signal::Signal::SIGHUP)
}

/// Opens the page as the desktop opens pages.
fn open(url: &str) {
    use std::process::{Command, Stdio};
    let quiet =
        Command::new("xdg-open").arg(url).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
    if let Err(error) = quiet {
        wrong!("cannot open a browser (xdg-open: {error}): open {url} in one");
    }
}
