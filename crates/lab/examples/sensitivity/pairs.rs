//! Frames of two cards that are restarted, paired.

use csi5300::exchange::pairing::{LinkSide, Pairing};
use csi5300_sim::random::Stream;

/// Sessions, and exchanges in each.
const SESSIONS: u32 = 6;
const EXCHANGES: u32 = 600;
/// Microseconds from one exchange to the next, of a turn-around, and of its jitter.
const ROUND_US: f64 = 10_000.0;
const TURN_AROUND_US: f64 = 300.0;
const JITTER_US: f64 = 15.0;
/// Share of the frames that a side does not log, and that carry a number of another exchange.
const LOST: f64 = 0.1;
const FALSE: f64 = 0.02;
/// How fast the clocks drift apart.
const DRIFT: f64 = 20e-6;

/// Right and wrong pairs of logs over restarts of either card: a pair is right if both frames are of one exchange.
pub fn after_restarts() -> (f64, f64) {
    let mut random = Stream::of_seed(7);
    let mut pairing = Pairing::new(1_024);
    let (mut right, mut wrong) = (0u32, 0u32);
    let mut count = |pairing: &mut Pairing<(u32, u32)>| {
        while let Some(pair) = pairing.poll_pair() {
            *if pair.receiver == pair.transmitter { &mut right } else { &mut wrong } += 1;
        }
    };
    let mut from_us = [0.0, 5e8];
    let mut first = 1;
    for session in 0..SESSIONS {
        for exchange in 0..EXCHANGES {
            let at_us = f64::from(exchange) * ROUND_US;
            let clocks = [at_us, at_us * (1.0 + DRIFT) - TURN_AROUND_US + JITTER_US * random.normal()];
            for (k, side) in [LinkSide::Receiver, LinkSide::Transmitter].into_iter().enumerate() {
                if random.happens(LOST) {
                    continue;
                }
                let other = random.below(u64::from(EXCHANGES)) as u32;
                let number = first + if random.happens(FALSE) { other } else { exchange };
                let clock = (from_us[k] + clocks[k]).max(0.0) as u64 as u32;
                pairing.handle(side, number, clock, (session, exchange));
                count(&mut pairing);
            }
        }
        // After each session one of the two cards is loaded anew and its clock begins again; after every third, numbers do too.
        let loaded = (session % 2) as usize;
        from_us = from_us.map(|from_us| from_us + f64::from(EXCHANGES) * ROUND_US + 2e6);
        from_us[loaded] = 1e6 * f64::from(session + 1);
        first = if session % 3 == 0 { 1 } else { first + EXCHANGES };
    }
    pairing.finish();
    count(&mut pairing);
    (f64::from(right), f64::from(wrong))
}
