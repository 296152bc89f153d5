//! A recorded log at the pace at which it was recorded, or any multiple of it.

use super::{CsiSource, Error, Loss, Next, Stamps};
use crate::time::{Instant, Span, Unwrap32};
use driver_iface::bfee::Bfee;
use driver_iface::record::{Record, Tail, code};

/// Gives each record of `S` when it is due by the card's clock (`timestamp_low`).
///
/// Records without a clock of their own (MPDUs come just before their bfee) are due with the record before them. A clock
/// that steps back, as after a reload of the driver, costs no time.
pub struct Paced<S> {
    source: S,
    speed: f64,
    longest: Option<Span>,
    clock: Unwrap32,
    last_card_us: Option<i64>,
    due: Option<Instant>,
    held: Held,
    /// The time of the last call.
    asked: Instant,
    body: Vec<u8>,
}

/// Records read ahead that wait for their time.
enum Held {
    Nothing,
    Record(Stamps, u8),
    Lost(Loss),
    End(Tail),
}

impl<S: CsiSource> Paced<S> {
    /// Plays `source` at `speed` times its own pace (above 0; infinity for no waiting), shortening pauses to `longest`
    /// of the player's time.
    pub fn new(source: S, speed: f64, longest: Option<Span>) -> Self {
        Self {
            source,
            speed,
            longest,
            clock: Unwrap32::default(),
            last_card_us: None,
            due: None,
            held: Held::Nothing,
            asked: Instant::ZERO,
            body: Vec::new(),
        }
    }

    /// The same, its first record due at `at`.
    #[must_use]
    pub fn beginning(self, at: Instant) -> Self {
        Self { due: Some(at), ..self }
    }

    /// The log being played.
    pub fn source(&self) -> &S {
        &self.source
    }

    fn read_ahead(&mut self, now: Instant) -> Result<(), Error> {
        let (held, clock) = match self.source.receive(now)? {
            Next::Record(stamps, record) => {
                self.body.clear();
                self.body.extend_from_slice(record.body);
                let bfee = (record.code == code::BFEE).then(|| Bfee::new_checked(record.body).ok()).flatten();
                (Held::Record(stamps, record.code), bfee.map(|bfee| bfee.timestamp_low()))
            }
            Next::Lost(loss) => (Held::Lost(loss), None),
            Next::End(tail) => (Held::End(tail), None),
            Next::Pending => (Held::Nothing, None),
        };
        self.held = held;
        let Some(raw) = clock else { return Ok(()) };
        let card_us = self.clock.next(raw);
        let step_us = self.last_card_us.map_or(0, |last| card_us - last).max(0);
        self.last_card_us = Some(card_us);
        let wait = Span::from_s(step_us as f64 * 1e-6 / self.speed);
        let wait = self.longest.map_or(wait, |longest| wait.min(longest));
        self.due = Some(self.due.unwrap_or(now) + wait);
        Ok(())
    }
}

impl<S: CsiSource> CsiSource for Paced<S> {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        self.asked = now;
        if matches!(self.held, Held::Nothing) {
            self.read_ahead(now)?;
        }
        if self.due.is_some_and(|due| due > now) {
            return Ok(Next::Pending);
        }
        Ok(match std::mem::replace(&mut self.held, Held::Nothing) {
            Held::Nothing => Next::Pending,
            Held::Record(stamps, code) => Next::Record(Stamps { at: now, ..stamps }, Record { code, body: &self.body }),
            Held::Lost(loss) => Next::Lost(loss),
            Held::End(tail) => {
                self.held = Held::End(tail);
                Next::End(tail)
            }
        })
    }

    fn next_at(&self) -> Option<Instant> {
        match self.held {
            Held::Nothing => self.source.next_at(),
            _ => Some(self.due.unwrap_or(self.asked)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::replay::Replay;
    use driver_iface::bfee::{self, csi_len};

    fn log(clocks_us: &[u32]) -> Vec<u8> {
        let mut log = Vec::new();
        for clock in clocks_us {
            let mut body = vec![0; bfee::STOCK_HEADER + csi_len(1, 1)];
            body[..4].copy_from_slice(&clock.to_le_bytes());
            body[bfee::offset::N_RX] = 1;
            body[bfee::offset::N_TX] = 1;
            body[bfee::offset::LEN] = csi_len(1, 1) as u8;
            let record = Record { code: code::BFEE, body: &body };
            let from = log.len();
            log.resize(from + record.emit_len(), 0);
            record.emit(&mut log[from..]).unwrap();
        }
        log
    }

    fn times(clocks_us: &[u32], speed: f64, longest: Option<Span>) -> Vec<i64> {
        let bytes = log(clocks_us);
        let mut paced = Paced::new(Replay::new(bytes.as_slice(), "test".into()), speed, longest);
        let (mut now, mut times) = (Instant::from_us(500), Vec::new());
        loop {
            match paced.receive(now).unwrap() {
                Next::Record(stamps, _) => times.push(stamps.at.as_us()),
                Next::Pending => {
                    let at = paced.next_at().unwrap();
                    assert!(at > now, "waiting for nothing");
                    now = at;
                }
                Next::End(_) => return times,
                Next::Lost(loss) => panic!("{loss:?}"),
            }
        }
    }

    #[test]
    fn records_come_at_the_cards_pace() {
        let clocks = [u32::MAX - 999, 1_000, 3_000, 2_500, 12_500];
        assert_eq!(times(&clocks, 1.0, None), [500, 2_500, 4_500, 4_500, 14_500]);
        assert_eq!(times(&clocks, 2.0, None), [500, 1_500, 2_500, 2_500, 7_500]);
        assert_eq!(times(&clocks, 1.0, Some(Span::from_ms(3))), [500, 2_500, 4_500, 4_500, 7_500]);
        assert_eq!(times(&clocks, f64::INFINITY, None), [500; 5]);
    }

    #[test]
    fn a_log_may_begin_later() {
        let bytes = log(&[7, 1_007]);
        let begin = Instant::from_us(9_000);
        let mut paced = Paced::new(Replay::new(bytes.as_slice(), "test".into()), 1.0, None).beginning(begin);
        assert!(matches!(paced.receive(Instant::ZERO), Ok(Next::Pending)));
        assert_eq!(paced.next_at(), Some(begin));
        assert!(matches!(paced.receive(begin), Ok(Next::Record(..))));
        assert!(matches!(paced.receive(begin), Ok(Next::Pending)));
        assert_eq!(paced.next_at(), Some(Instant::from_us(10_000)));
    }
}
