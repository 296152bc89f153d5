//! What became of frames that were not sent or not used, by cause: for words and for JSON.

use csi5300::exchange::tdma::TdmaCounts;
use csi5300_live::monitor::AirCounts;
use csi5300_live::sounding::Figures;

/// How many were lost or ignored for one cause.
#[derive(Clone, Copy)]
pub struct Cause {
    /// Its name in JSON.
    pub name: &'static str,
    /// How many.
    pub count: u64,
    /// What follows the number in words.
    pub words: &'static str,
}

fn cause(name: &'static str, count: u64, words: &'static str) -> Cause {
    Cause { name, count, words }
}

/// Due frames that were not sent, or perhaps late.
pub fn not_sent(counts: &TdmaCounts, figures: &Figures, air: &AirCounts) -> [Cause; 7] {
    let skipped = counts.missed_slots + figures.too_late;
    [
        cause("host_late", skipped, "frames skipped because the host was late (never sent late)"),
        cause("answer_late", counts.missed_replies, "answers skipped because they were late"),
        cause("perhaps_late", figures.perhaps_late, "frames handed over in time that the kernel took late"),
        cause("no_room", air.no_room, "frames not taken: no room in the kernel's queue"),
        cause("interface_down", air.down, "frames not taken: the interface was down"),
        cause("too_long", air.too_long, "frames not taken: longer than the MTU"),
        cause("cut", air.cut, "frames that the kernel took only in part"),
    ]
}

/// Frames heard and turns that were not used.
pub fn not_used(counts: &TdmaCounts, air: &AirCounts) -> [Cause; 17] {
    [
        cause("kernel_dropped", air.dropped, "frames heard but dropped by the kernel before they were read"),
        cause("stale", air.stale, "frames dropped after a second or more in the kernel's queue"),
        cause("bad_fcs", air.bad_fcs, "frames with a wrong check sequence"),
        cause("damaged", air.damaged, "frames behind an unreadable radiotap header"),
        cause("foreign", counts.foreign, "frames of another dialect or damaged"),
        cause("strangers", counts.strangers, "frames of robots that are no peers"),
        cause("unauthenticated", counts.unauthenticated, "frames without the key"),
        cause("contested", counts.contested, "measurements whose number two frames had"),
        cause("replayed", counts.replayed, "frames repeated or of an old session"),
        cause("unmatched", counts.unmatched, "answers that match no waiting frame"),
        cause("other_plan", counts.other_plan, "frames of another plan (--rate, --links)"),
        cause("yields", counts.yields, "turns yielded to another initiator"),
        cause("overslept", counts.overslept, "turns lost because the host was busy"),
        cause("rivals", counts.rivals, "frames that contradict an earlier initiator or turn"),
        cause("off_epoch", counts.off_epoch, "frames outside their slot"),
        cause("own_echoes", counts.own_echoes, "copies of this robot's own frames"),
        cause("events_lost", counts.events_lost, "events lost because too many came at once"),
    ]
}
