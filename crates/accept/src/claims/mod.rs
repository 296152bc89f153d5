//! The table of claims with their checks.

mod host;
mod link;
mod reception;

use crate::evidence::{Done, Evidence, Heard, Pairs};
use crate::report::{Figure, Finding, Of, Verdict};
use crate::stats::share_bounds;

/// What a claim needs, where a part of it is missing.
const TWO_CARDS: &str = "needs the logs of two cards that sounded each other";
const TRUTH: &str = "needs a trajectory and the true direction";
const SENDING: &str = "needs a card that sends during the run, and one that hears it";

/// The result of a check.
pub(crate) struct Told {
    verdict: Verdict,
    found: String,
    figures: Vec<Figure>,
}

impl Told {
    fn new(verdict: Verdict, found: String) -> Self {
        Self { verdict, found, figures: Vec::new() }
    }

    fn not_tried(why: impl Into<String>) -> Self {
        Self::new(Verdict::NotTried, why.into())
    }

    /// Holds or fails.
    fn decided(holds: bool, found: String) -> Self {
        Self::new(if holds { Verdict::Holds } else { Verdict::Fails }, found)
    }

    fn with(mut self, name: &'static str, value: f64, unit: &'static str) -> Self {
        self.figures.push(Figure { name, value, unit });
        self
    }

    /// More of the finding, behind it.
    fn adding(mut self, more: &str) -> Self {
        self.found.push_str(more);
        self
    }

    /// A deviation that is known within `error`, against its limit.
    fn limited(deviation: f64, error: f64, limit: f64, found: String) -> Self {
        match deviation {
            away if away <= limit => Self::decided(true, found),
            away if away - error > limit => Self::decided(false, found),
            _ => Self::not_tried(format!("{found}: too near the limit")),
        }
    }

    /// A share with a limit. It fails if the share is certainly above it; in between nothing is decided.
    fn share(bad: usize, total: usize, limit: f64, what: &str) -> Self {
        let share = bad as f64 / total.max(1) as f64;
        let most = if limit == 0.0 { "none is allowed".to_owned() } else { format!("at most {} %", 100.0 * limit) };
        let found = format!("{bad} of {total} {what}: {:.2} %, {most}", 100.0 * share);
        let (low, _) = share_bounds(bad, total);
        let told = match share {
            _ if total < LEAST => Self::not_tried(format!("{found}: at least {LEAST} are needed")),
            share if share <= limit => Self::decided(true, found),
            _ if low > limit => Self::decided(false, found),
            _ => Self::not_tried(format!("{found}: too few to tell that from {:.1} %", 100.0 * limit)),
        };
        told.with("share", share, "")
    }
}

/// Fewest records from which a share is judged.
const LEAST: usize = 100;

/// The check of a claim.
#[derive(Debug)]
enum Check {
    /// Each card's records alone.
    Log(fn(&Heard, &Evidence) -> Told),
    /// The same of fields that only a 5300 fills; logs of other cards have converted values there.
    Of5300(fn(&Heard, &Evidence) -> Told),
    /// Both cards together.
    Link(fn(&Evidence) -> Told),
    /// Exchanges with both frames, if there are enough of them.
    Pairs(fn(&Pairs, &Evidence) -> Told),
    /// The host.
    Host(fn(&Evidence) -> Told),
}

/// A statement about a card, its driver or its host that is true or false.
#[derive(Debug)]
pub struct Claim {
    /// Its identity, `subject.what`.
    pub id: &'static str,
    /// The sentence.
    pub says: &'static str,
    /// The expected range; `open` if unknown.
    pub expected: &'static str,
    /// The source of that range.
    pub source: &'static str,
    /// Likely causes of a failure, the likeliest first.
    pub causes: &'static [&'static str],
    /// The next command after a failure.
    pub next: &'static str,
    check: Check,
}

impl Claim {
    /// Expected range, causes and next command, in lines.
    #[must_use]
    pub fn advice(&self) -> String {
        let causes: Vec<String> = self.causes.iter().map(|cause| format!("Likely: {cause}.")).collect();
        format!("Expected: {} ({}). {} Next: {}", self.expected, self.source, causes.join(" "), self.next)
    }

    /// Its verdicts: one for each card, or one.
    pub(crate) fn judge(&self, evidence: &Evidence) -> Vec<Finding> {
        let finding = |of: Of, told: Told| Finding {
            id: self.id,
            of,
            verdict: told.verdict,
            found: told.found,
            figures: told.figures,
        };
        match self.check {
            Check::Log(check) | Check::Of5300(check) => {
                let is_of_5300 = matches!(self.check, Check::Of5300(_));
                let sides = [(Of::Near, Some(&evidence.near)), (Of::Far, evidence.far.as_ref())];
                let told = |heard: &Heard| match check(heard, evidence) {
                    _ if is_of_5300 && heard.is_of_another_card() => {
                        Told::not_tried("the log is of another card, which has no such field")
                    }
                    // Without records there is no good verdict on a card.
                    told if told.verdict == Verdict::Holds && heard.records.is_empty() => {
                        Told::not_tried("needs a card that hears frames")
                    }
                    told => told,
                };
                sides.into_iter().filter_map(|(of, heard)| Some(finding(of, told(heard?)))).collect()
            }
            Check::Link(check) => vec![finding(Of::Link, check(evidence))],
            Check::Pairs(check) => {
                let told = link::paired(evidence).map_or_else(|why| why, |pairs| check(pairs, evidence));
                vec![finding(Of::Link, told)]
            }
            Check::Host(check) => vec![finding(Of::Host, check(evidence))],
        }
    }
}

const INFO: &str = "`csi5300 info` on that card's log (--report DIR keeps both)";

/// All claims, by subject.
pub static CLAIMS: [Claim; 49] = [
    Claim {
        id: "host.buffer",
        says: "The listener reads as fast as records come: no queue runs over.",
        expected: "0 overruns",
        source: "netlink(7): ENOBUFS when the socket's buffer is full",
        causes: &["the host is busy", "the socket's buffer is too small"],
        next: "`csi5300 doctor`: the listener's buffer and rights",
        check: Check::Log(host::buffer),
    },
    Claim {
        id: "host.clock",
        says: "The host's clock is not set while records come.",
        expected: "no step of more than 50 ms against the card's clock",
        source: "card's clock of the same records",
        causes: &["NTP or a person set the clock", "the machine was suspended"],
        next: "timedatectl show-timesync on that robot, then record again after its clock is steady",
        check: Check::Log(host::clock_set),
    },
    Claim {
        id: "host.delay",
        says: "Records reach the host soon and evenly after the card heard the frame.",
        expected: "open",
        source: "measured: spread of host clock less card clock",
        causes: &[],
        next: INFO,
        check: Check::Log(host::delay),
    },
    Claim {
        id: "host.lateness",
        says: "The host wakes a waiting program in time for a slot of 5 ms.",
        expected: "99 % within 2.5 ms",
        source: "half a slot of this program's schedule",
        causes: &["the processor saves power", "another program has a higher priority"],
        next: "cpupower frequency-set -g performance, then run the claims again",
        check: Check::Host(host::lateness),
    },
    Claim {
        id: "host.processor",
        says: "The bearing is the same with every vector unit of this processor.",
        expected: "within 0.001 degrees of the portable code",
        source: "this program's portable code",
        causes: &["a compiler or processor fault: please report it with /proc/cpuinfo"],
        next: "`csi5300 bearing FOLDER --json` on another machine",
        check: Check::Host(host::processor),
    },
    Claim {
        id: "card.clock",
        says: "The card's clock goes on evenly.",
        expected: "no step of more than 50 ms against the host's clock, never back",
        source: "host's clock of the same records; iwlwifi `timestamp_low` counts microseconds and wraps after 71.6 min",
        causes: &["the driver was reloaded", "the card was reset"],
        next: "sudo dmesg | grep iwl",
        check: Check::Log(host::card_clock),
    },
    Claim {
        id: "card.rate",
        says: "The card's clock is as fast as the host's.",
        expected: "within 100 ppm",
        source: "802.11-2016 17.3.9.5: 20 ppm for the card; 71 WSR links: 7 to 90 ppm, most of it the hosts'",
        causes: &["the host's clock is not disciplined", "the card's crystal is out of tolerance"],
        next: "chronyc tracking, then a recording of 60 s",
        check: Check::Log(host::card_rate),
    },
    Claim {
        id: "log.whole",
        says: "Every byte from the card is part of a record that can be read.",
        expected: "0 bytes lost; a last record cut by a killed logger is allowed",
        source: "iwlwifi dvm/rx.c: the fields and the length of a record fix each other",
        causes: &[
            "the driver's layout is not known to this program",
            "the disk was full",
            "two loggers wrote one file",
        ],
        next: INFO,
        check: Check::Log(reception::whole),
    },
    Claim {
        id: "log.layout",
        says: "All records have one layout.",
        expected: "one of stock, WSR of 2021, WSR",
        source: "driver_iface::bfee",
        causes: &["the driver was exchanged during the recording", "records of two machines are in one file"],
        next: INFO,
        check: Check::Of5300(reception::layout),
    },
    Claim {
        id: "reception.count",
        says: "The driver's counter of frames goes up from record to record.",
        expected: "never the same value twice in a row",
        source: "iwlwifi `bfee_count`, one up for each frame with CSI",
        causes: &["the driver does not count", "each record was written twice"],
        next: INFO,
        check: Check::Of5300(reception::count),
    },
    Claim {
        id: "reception.gaps",
        says: "Between driver and log no records are lost.",
        expected: "at most 1 % of `bfee_count` missing",
        source: "iwlwifi `bfee_count`",
        causes: &["the logger keeps only some senders", "the listener's queue ran over", "the driver drops records"],
        next: "`csi5300 doctor --listen 20s`",
        check: Check::Of5300(reception::gaps),
    },
    Claim {
        id: "reception.rate",
        says: "Every frame with CSI was sent at an HT rate.",
        expected: "bit 8 of `fake_rate_n_flags` set",
        source: "802.11n 20.3.9: only HT frames carry HT training fields; iwlwifi RATE_MCS_HT_MSK",
        causes: &[
            "the driver fills the field in wrongly, if the claims about phases hold",
            "the robot that sent these frames uses a legacy rate (`monitor_tx_rate`)",
        ],
        next: "`csi5300 info LOG.dat`: the rates; then `csi5300 doctor` on the robot that sent these frames",
        check: Check::Of5300(reception::ht),
    },
    Claim {
        id: "reception.width",
        says: "Frames are as wide as the stated channel.",
        expected: "bit 11 of `fake_rate_n_flags` set on 40 MHz only",
        source: "iwlwifi RATE_MCS_HT40_MSK",
        causes: &[
            "the stated channel width is wrong, if both cards fail",
            "this card's record is wrong, if reception.subcarriers holds",
            "the sender is set to another width",
        ],
        next: "if both cards fail, the channel with its width: --channel 108 or 108+",
        check: Check::Log(reception::width),
    },
    Claim {
        id: "reception.chains",
        says: "The number of receive chains stays the same.",
        expected: "one value",
        source: "iwlwifi RXON chain flags, set once by the driver",
        causes: &["the driver saves power by switching chains off", "an antenna has a loose contact"],
        next: "iw dev NAME set power_save off",
        check: Check::Log(reception::chains),
    },
    Claim {
        id: "reception.order",
        says: "Each record says which antenna each chain was connected to.",
        expected: "`antenna_sel` is a permutation",
        source: "iwlwifi `antenna_sel`, two bits a chain",
        causes: &["the driver does not fill the field in", "one antenna is connected and its chain is not named"],
        next: INFO,
        check: Check::Of5300(reception::order),
    },
    Claim {
        id: "reception.antennas",
        says: "The named antenna is the true one: a chain's power and its antenna's RSSI agree.",
        expected: "at most 2 % of the records more than 5 dB off",
        source: "csitool: csi and rssi_a, rssi_b, rssi_c of one record; both are measured behind the same gain",
        causes: &[
            "the coefficients are noise, if reception.snr fails: repair that first",
            "two antennas are exchanged in `antenna_sel` or in the RSSI fields, if the two differences have opposite signs; only unplugging an antenna shows which field is wrong (`unplug`)",
            "`antenna_sel` is constant while the order of the chains changes",
        ],
        next: "unplug antenna B, record 10 s, and look at `csi5300 info LOG.dat --plot DIR`: the named chain falls",
        check: Check::Of5300(reception::antenna_names),
    },
    Claim {
        id: "reception.unplugged",
        says: "The chain that is named after an unplugged antenna falls.",
        expected: "by at least 6 dB against the other chains, and more than any other",
        source: "an open port hears less than a quarter of what its antenna heard",
        causes: &[
            "no antenna was unplugged (in a simulated room nobody can)",
            "`antenna_sel` is constant or wrong: see reception.antennas",
            "another antenna was unplugged",
            "the antennas couple: they are closer than a few centimetres",
        ],
        next: "plug all in and run it again; then the cables from the card to the housing",
        check: Check::Link(link::unplugged),
    },
    Claim {
        id: "reception.subcarriers",
        says: "The 30 subcarriers come in the order and at the indices of 802.11n.",
        expected: "a line through the phase fits better than with another order",
        source: "802.11n table 7-25f (grouping of 2 at 20 MHz, 4 at 40 MHz)",
        causes: &["the driver or a converter moved the subcarriers", "the stated width is wrong"],
        next: "`csi5300 info LOG.dat --plot DIR --antenna A --from 2 --to 3`, beside the other card's log: no row is at the wrong edge",
        check: Check::Log(reception::subcarriers),
    },
    Claim {
        id: "reception.level",
        says: "The gain control uses the converter's range.",
        expected: "root mean square of the strongest chain 8 to 64 steps in the median",
        source: "71 WSR links: 30 to 33",
        causes: &["the coefficients were scaled after the card", "the gain control is off"],
        next: INFO,
        check: Check::Of5300(reception::level),
    },
    Claim {
        id: "reception.saturation",
        says: "Coefficients are not cut at the converter's ends.",
        expected: "at most 1 % of the records with a value of -128 or 127",
        source: "8-bit values of the record",
        causes: &[
            "the robots are closer than 0.5 m, if both cards fail",
            "this card or its driver scales the coefficients, if its gain and RSSI are like the other card's",
            "the gain control is off",
        ],
        next: "move the robots apart, or lower the sender's power with iw dev NAME set txpower fixed 500",
        check: Check::Of5300(reception::saturation),
    },
    Claim {
        id: "reception.zero",
        says: "No record's coefficients are all zero.",
        expected: "0 records",
        source: "a frame that was decoded has a channel",
        causes: &["the firmware reports CSI of frames without training fields", "the record was damaged"],
        next: INFO,
        check: Check::Log(reception::zero),
    },
    Claim {
        id: "reception.fresh",
        says: "Every record has coefficients of its own.",
        expected: "at most 1 % equal to the record before",
        source: "noise changes the last bit of some of 60 or more values from frame to frame",
        causes: &["the driver hands on a buffer that was not refilled", "records are written twice"],
        next: INFO,
        check: Check::Log(reception::fresh),
    },
    Claim {
        id: "reception.gain",
        says: "RSSI and gain together give a power that air can carry.",
        expected: "total RSS between -95 and -10 dBm, gain above 0 dB",
        source: "csitool get_total_rss: 10 log10 of the summed RSSI, less 44, less agc",
        causes: &["the driver does not fill in `agc`", "RSSI fields are exchanged with others"],
        next: INFO,
        check: Check::Of5300(reception::gain),
    },
    Claim {
        id: "reception.noise",
        says: "The noise floor is unknown (-127) or one that a receiver can have.",
        expected: "-127, or -105 to -60 dBm",
        source: "thermal noise of 20 MHz is -101 dBm; csitool takes -92 for unknown",
        causes: &[
            "this card's firmware or driver writes another value, if the other card's log is good",
            "the robot that sent these frames uses a legacy rate (`monitor_tx_rate`), if reception.rate fails",
            "a strong transmitter is close",
        ],
        next: INFO,
        check: Check::Of5300(reception::noise),
    },
    Claim {
        id: "reception.snr",
        says: "The channel stands out of the noise.",
        expected: "at least 5 dB in the median",
        source: "third differences over the subcarriers; 71 WSR links: 23 to 29 dB",
        causes: &[
            "this card reports noise for coefficients, if its RSSI and reception.gain are normal",
            "the antenna is not connected",
            "the robots are too far apart",
            "a jammer or another network is on the channel",
        ],
        next: "`csi5300 info LOG.dat --plot DIR`: RSSI over time; then another channel",
        check: Check::Log(reception::snr),
    },
    Claim {
        id: "reception.once",
        says: "Each frame is reported once.",
        expected: "at most 1 % of the numbers twice",
        source: "sounding frames are sent without retries and numbered",
        causes: &[
            "the robot that sent these frames sends some twice, if none is skipped: see injection.once, or its responder answers twice",
            "this card's driver writes an old number, if as many numbers are skipped",
            "two programs sound under one MAC address",
        ],
        next: "`csi5300 info LOG.dat -v`: numbers that come twice, by sender",
        check: Check::Log(reception::once),
    },
    Claim {
        id: "exchange.pairs",
        says: "Both frames of an exchange are reported.",
        expected: "at least 90 % of the near card's frames have a partner",
        source: "71 WSR links: 98.9 % and above",
        causes: &[
            "the far log is of another run",
            "frames are lost on the air",
            "answers carry another robot's address",
        ],
        next: "`csi5300 bearing FOLDER -v`: pairs and losses by side",
        check: Check::Link(link::pairs),
    },
    Claim {
        id: "exchange.turn_around",
        says: "Answers come evenly.",
        expected: "90 % within 500 us of each other",
        source: "71 WSR links: 27 to 194 us; the driver's code: 145 to 322 us",
        causes: &[
            "a card's clock steps, if card.clock fails",
            "the responder answers in user space",
            "the responder's host is busy: see host.lateness",
        ],
        next: "`csi5300 setup --role responder --channel N` on the second robot, so that its driver answers",
        check: Check::Pairs(link::turn_around),
    },
    Claim {
        id: "exchange.late",
        says: "No answer comes a frame too late.",
        expected: "at most 5 % later than 1.5 ms",
        source: "5 ms between slots, a third of it",
        causes: &[
            "a card's clock steps, if card.clock fails",
            "the responder's host is busy",
            "carrier sense holds answers back: the channel is busy",
        ],
        next: "another channel, or a responder whose host does nothing else",
        check: Check::Pairs(link::late),
    },
    Claim {
        id: "exchange.drift",
        says: "The two cards' clocks drift apart slowly.",
        expected: "at most 40 ppm",
        source: "802.11-2016 17.3.9.5: 20 ppm each way",
        causes: &["a clock was reset", "the logs are of two runs"],
        next: INFO,
        check: Check::Pairs(link::drift),
    },
    Claim {
        id: "phase.cancels",
        says: "In the product of forward and backward frame the carrier offset cancels.",
        expected: "coherence of the product from exchange to exchange at least 0.4",
        source: "71 WSR links: 0.61 to 0.90",
        causes: &[
            "one card's records are wrong, if one of its own claims fails (reception.fresh, reception.snr, card.clock): repair that first",
            "the phase of one card jumps from frame to frame; two cards cannot tell which one: replace one by a third",
            "the cards retune or restart between the two frames",
            "one log is conjugated",
            "the logs are of two runs",
            "SNR is too low",
        ],
        next: "the curve of the round trip in report.html (--report DIR): compensated, the phase stays in one band",
        check: Check::Pairs(link::cancels),
    },
    Claim {
        id: "phase.sign",
        says: "The offset has opposite signs in the two directions.",
        expected: "the product is more coherent than forward times conjugate of backward",
        source: "h ~ exp(-j 2 pi d / lambda); the mixers' difference has one sign each way",
        causes: &["one card's driver conjugates the coefficients", "one log went through a converter"],
        next: "compare with csiread: the same file, the same signs",
        check: Check::Pairs(link::sign),
    },
    Claim {
        id: "phase.crystal",
        says: "Clock and carrier of a card come from one crystal.",
        expected: "carrier offset over clock drift is the carrier frequency, within 1.5 ppm",
        source: "802.11-2016 17.3.9.5: one reference for carrier and symbol clock",
        causes: &["the stated channel is of another band", "a card's clock is not the one its carrier comes from"],
        next: "iw dev NAME info: the channel; then a recording of 60 s",
        check: Check::Pairs(link::crystal),
    },
    Claim {
        id: "phase.rest",
        says: "At rest the compensated product's phase is constant.",
        expected: "coherence within each second at least 0.7",
        source: "0.7 is a spread of 0.84 rad within a second",
        causes: &[
            "the carrier offset does not cancel, if phase.cancels fails or is below 0.8: one card sends and receives on different carriers",
            "something moves near the robots",
        ],
        next: "`csi5300 info LOG.dat --plot DIR` of both, while nobody walks between the robots",
        check: Check::Pairs(link::rest),
    },
    Claim {
        id: "phase.retune",
        says: "After a retune the phases between antennas and of the round trip are the same.",
        expected: "no step of more than 45 degrees",
        source: "half of pi/2, the smallest step of this card that is known (firmware-notes/csi-quirks.md)",
        causes: &[
            "at 2.4 GHz the card's synthesizer divides by four: steps of 90 degrees are its own",
            "a robot was moved: 4 mm are 45 degrees of the round trip at 5.5 GHz",
        ],
        next: "use one antenna, or begin a new log after each retune",
        check: Check::Link(|evidence| link::same(evidence, Done::Retuned)),
    },
    Claim {
        id: "phase.reload",
        says: "After the driver was reloaded the phases between antennas and of the round trip are the same.",
        expected: "no step of more than 45 degrees",
        source: "half of pi/2, the smallest step of this card that is known (firmware-notes/csi-quirks.md)",
        causes: &["the card recalibrates its chains", "a robot was moved: 4 mm are 45 degrees of the round trip"],
        next: "begin a new log after each reload",
        check: Check::Link(|evidence| link::same(evidence, Done::Reloaded)),
    },
    Claim {
        id: "injection.taken",
        says: "The driver takes every frame.",
        expected: "at most 1 % refused at up to 200 frames a second",
        source: "packet(7): ENOBUFS where the interface's queue is full",
        causes: &["the interface is down or not in monitor mode", "the channel forbids sending (no-IR, radar)"],
        next: "`csi5300 doctor`",
        check: Check::Link(link::taken),
    },
    Claim {
        id: "injection.channel",
        says: "The card may start to transmit on its channel.",
        expected: "neither disabled nor no-IR nor radar detection",
        source: "mac80211 drops injected frames on such channels silently (firmware-notes/injection.md)",
        causes: &["the regulatory domain is the world's (00)", "the channel needs radar detection"],
        next: "sudo iw reg set XX with your country's code, then set the channel; or another channel",
        check: Check::Link(link::channel),
    },
    Claim {
        id: "injection.confirmed",
        says: "The driver reports the frames as sent.",
        expected: "at most 10 % without a report",
        source: "mac80211: one status a frame; on mac80211_hwsim each frame has one (firmware-notes/injection.md)",
        causes: &["the channel forbids sending (no-IR, radar): see injection.channel", "the queue ran over"],
        next: "`csi5300 doctor`",
        check: Check::Link(link::confirmed),
    },
    Claim {
        id: "injection.once",
        says: "Each frame leaves once.",
        expected: "at most 1 % sent more than once",
        source: "the count of retries in the driver's report (radiotap field 17)",
        causes: &["the driver waits for acknowledgements: the frames lack the no-acknowledgement flag"],
        next: "on the robot that sends: `csi5300 doctor`, then firmware-notes/injection.md",
        check: Check::Link(link::once),
    },
    Claim {
        id: "injection.pace",
        says: "Frames leave at the requested rate.",
        expected: "within 10 % at up to 200 frames a second, by the far card's clock",
        source: "the schedule of the frames that were sent",
        causes: &[
            "the far card's clock steps, if card.clock fails",
            "the host is busy: see host.lateness",
            "the channel is busy, so frames wait for air",
        ],
        next: "another channel, then cpupower frequency-set -g performance",
        check: Check::Link(link::pace),
    },
    Claim {
        id: "injection.heard",
        says: "The far card hears the frames that are sent.",
        expected: "at most 10 % lost at up to 200 frames a second",
        source: "71 WSR links: 1.0 % of the answers lost at most",
        causes: &[
            "frames leave at a legacy rate: no record at the other card",
            "the channel is busy",
            "the other card is on another channel",
        ],
        next: "`csi5300 record OUT.dat` on the other robot, then `csi5300 doctor` here",
        check: Check::Link(link::heard),
    },
    Claim {
        id: "injection.numbers",
        says: "The far card hears the numbers that were sent.",
        expected: "no other number",
        source: "the frame's own bytes",
        causes: &[
            "another program sounds under this MAC address",
            "the robot that sent these frames uses a legacy rate (`monitor_tx_rate`)",
        ],
        next: INFO,
        check: Check::Link(link::numbers),
    },
    Claim {
        id: "recorder.same",
        says: "A recording gives the same records as the card did, and all of those written before a cut.",
        expected: "equal, every field and coefficient",
        source: "the live records",
        causes: &["a fault of this program: please report it with the log"],
        next: INFO,
        check: Check::Log(host::recorder),
    },
    Claim {
        id: "module.csi",
        says: "The firmware sends CSI when the module asks for it.",
        expected: "`bfee` grows while frames are heard",
        source: "csitool's patched drivers; on the stock driver nobody has seen it",
        causes: &[
            "no frame came at an HT rate to the magic address",
            "the firmware was not asked: `rxons`, `stations`, `orders` are 0",
            "another firmware is loaded than csitool's",
        ],
        next: "sudo dmesg | grep iwl, then echo N | sudo tee /sys/module/csi5300/parameters/ask for N from 0 to 7",
        check: Check::Host(host::csi),
    },
    Claim {
        id: "module.marked",
        says: "CSI comes as a notification, not as an answer to a command.",
        expected: "`unmarked` stays 0",
        source: "iwlwifi pcie/rx.c: bit 15 of the packet's sequence number",
        causes: &["the firmware does not set the bit: the driver takes CSI for answers"],
        next: "sudo dmesg | grep \"wrong command queue\"",
        check: Check::Host(|evidence| host::stays_zero(evidence, ["unmarked"])),
    },
    Claim {
        id: "module.order",
        says: "The firmware reports the order of the antennas.",
        expected: "`no_order` stays 0",
        source: "iwlwifi dvm/rx.c: REPLY_RX_PHY_CMD before each frame",
        causes: &["the phase packet is laid out in another way", "one chain only is in use"],
        next: "connect antenna A only, and record again",
        check: Check::Host(|evidence| host::stays_zero(evidence, ["no_order"])),
    },
    Claim {
        id: "module.layout",
        says: "The firmware's packets are laid out as the driver's sources say.",
        expected: "`bad_bfee` and `bad_phy` stay 0",
        source: "iwlwifi dvm/commands.h",
        causes: &["another firmware is loaded than csitool's"],
        next: "sha256sum /lib/firmware/iwlwifi-5000-2.ucode",
        check: Check::Host(|evidence| host::stays_zero(evidence, ["bad_bfee", "bad_phy"])),
    },
    Claim {
        id: "truth.bearing",
        says: "The true direction lies within the answer's 95 % interval.",
        expected: "error at most the 95 % half-width, in the trajectory's frame",
        source: "the person's measurement of the direction",
        causes: &[
            "the antenna's place on the robot is missing or mirrored: --antenna-offset FORWARD,LEFT,UP",
            "the stated channel is wrong",
            "the direction was measured in another frame",
        ],
        next: "`csi5300 bearing FOLDER -v`",
        check: Check::Link(link::bearing),
    },
];

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn claims_are_distinct_and_name_a_next_step() {
        let ids: BTreeSet<&str> = CLAIMS.iter().map(|claim| claim.id).collect();
        assert_eq!(ids.len(), CLAIMS.len());
        for claim in &CLAIMS {
            assert!(claim.says.ends_with('.') && !claim.source.is_empty() && !claim.next.is_empty(), "{}", claim.id);
            assert_eq!(claim.causes.is_empty(), claim.expected == "open", "{}", claim.id);
        }
    }

    #[test]
    fn a_share_fails_only_for_certain() {
        let verdict = |bad, total, limit| Told::share(bad, total, limit, "records").verdict;
        assert_eq!(verdict(0, 10, 0.01), Verdict::NotTried);
        assert_eq!(verdict(1, 200, 0.01), Verdict::Holds);
        assert_eq!(verdict(4, 200, 0.01), Verdict::NotTried);
        assert_eq!(verdict(20, 200, 0.01), Verdict::Fails);
        assert_eq!(verdict(1, 2_000, 0.0), Verdict::Fails);
    }
}
