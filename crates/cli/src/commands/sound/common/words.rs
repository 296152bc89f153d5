//! What `sound` and `sound --answer` print: while they run, and at the end.

use super::causes::{Cause, not_sent, not_used};
use csi5300::exchange::tdma::Event;
use csi5300::time::Span;
use csi5300_live::sounding::{Finished, KERNEL_TURN_AROUND_US, News, spread_of};
use driver_iface::Mac;
use driver_iface::sounding::wsr;
use std::fmt::Write as _;

/// Printed once if the driver's records carry neither sender nor number.
pub const NO_NUMBERS: &str = "the driver's records carry neither sender nor number: load it with connector_log=0x5 (csitool), or use the WSR driver";

/// A first frame within this time is announced as "at once", seconds.
const AT_ONCE_S: f64 = 0.5;
/// The summary of a session without a frame.
const NOTHING_SENT: &str =
    "no frame was sent: it ended while this robot still listened for others, or nobody sounded it\n";

/// Prints events as they come.
pub fn tell(news: &News) {
    match news {
        News::Started(granted) => note!("{granted}"),
        News::Notice(notice) => note!("{notice}"),
        News::Event(Event::Joined(peer)) => note!("{} joined", peer),
        News::Event(Event::Absent(peer)) => note!("{} does not answer; waiting for it", peer),
        News::Event(Event::Restarted { peer, .. }) => note!("{} restarted", peer),
        News::Event(Event::Yielded { to, .. }) => note!("{} initiates too, and takes precedence", to),
        News::Event(_) => {}
    }
}

/// When the first frame is sent, and whose answers are awaited from then on.
pub fn waiting(peers: &[Mac], first_in: Option<Span>) -> String {
    let peers = peers.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
    let first = first_in.map_or(0, Span::as_us) as f64 * 1e-6;
    let first = match first > AT_ONCE_S {
        true => format!("in {first:.1} s, if no other robot is heard to initiate until then (--alone: at once)"),
        false => "at once".to_string(),
    };
    format!("first frame {first}; then waiting for answers of {peers}")
}

/// How a session went.
pub fn summary(peers: &[Mac], finished: &Finished) -> String {
    let (counts, figures, air) = (finished.counts(), &finished.exchange.figures, finished.air);
    let mut text = String::new();
    if counts.forward > 0 {
        let _ = writeln!(
            text,
            "{} forward frames, {} answered{}",
            counts.forward,
            counts.answered,
            unanswered(counts.forward, counts.answered)
        );
        for mac in peers {
            if let Some(link) = finished.exchange.tdma.link_counts(*mac) {
                let _ = writeln!(text, "  {mac}: {} sounded, {} answered", link.sounded, link.answered);
            }
        }
        let _ = writeln!(text, "  lateness: {}: every slot that was due, skipped ones too", spread_of(&figures.due_us));
        let _ = writeln!(text, "  lateness of the frames sent: {}", spread_of(&figures.lateness_us));
        let _ = writeln!(text, "  answers began after: {}", spread_of(&figures.answer_us));
    }
    if counts.forward + counts.replies == 0 {
        text.push_str(NOTHING_SENT);
    }
    if counts.replies > 0 {
        let _ = writeln!(text, "{} answers", counts.replies);
        let turn_around = spread_of(&figures.turn_around_us);
        let _ = writeln!(text, "  turn-around, from the kernel's receive stamp: {turn_around}");
    }
    if counts.answered + counts.replies > 0 {
        let [least, median, most] = KERNEL_TURN_AROUND_US;
        let airtime_us = finished.exchange.tdma.plan().phy.airtime_us(wsr::DEFAULT_LEN);
        let _ = writeln!(
            text,
            "  the WSR kernel driver: {least} to {most} us, median {median}, from start to start of the frames, {airtime_us} us of it on air"
        );
    }
    for Cause { count, words, .. } in not_sent(counts, figures, &air).into_iter().chain(not_used(counts, &air)) {
        if count > 0 {
            let _ = writeln!(text, "  {count} {words}");
        }
    }
    text + &confirmed(finished)
}

/// The unanswered frames, if there are more than a few, and likely causes.
fn unanswered(forward: u64, answered: u64) -> String {
    let missing = forward.saturating_sub(answered);
    match missing * 20 > forward {
        true => format!(
            "; {missing} ({:.0} %) were not: the other robot is off, far, or later than --turn-around allows",
            100.0 * missing as f64 / forward as f64
        ),
        false => String::new(),
    }
}

/// What the kernel reports of the frames sent.
fn confirmed(finished: &Finished) -> String {
    let (sent, failed, mut text) = (finished.sent(), finished.reported_failed(), String::new());
    if finished.air.tx_failed > 0 {
        let _ = writeln!(text, "  the kernel reports {failed} of {sent} frames as failed");
    }
    match finished.confirmed() {
        0 if sent > 0 => {
            let _ = writeln!(text, "  the kernel confirms none of {sent} frames as sent");
        }
        0 => {}
        confirmed => {
            let _ = writeln!(text, "  the kernel confirms {confirmed} of {sent} frames as sent");
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_waited_for_is_said() {
        let peers = ["00:21:6a:00:00:02".parse().unwrap(), "00:21:6a:00:00:03".parse().unwrap()];
        let soon = waiting(&peers, Some(Span::from_ms(150)));
        assert_eq!(soon, "first frame at once; then waiting for answers of 00:21:6a:00:00:02, 00:21:6a:00:00:03");
        assert!(waiting(&peers, Some(Span::from_ms(6_400))).contains("in 6.4 s, if no other robot"));
    }

    #[test]
    fn rounds_without_an_answer_are_said_where_they_are_many() {
        assert_eq!(unanswered(1_000, 980), "");
        assert_eq!(unanswered(0, 0), "");
        assert!(unanswered(900, 600).contains("300 (33 %)"));
    }
}
