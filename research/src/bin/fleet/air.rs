//! Simulates one channel: each robot's real scheduler on simulated air.

use crate::Fallible;
use csi5300::driver_iface::Mac;
use csi5300::driver_iface::bfee::SUBCARRIERS;
use csi5300::driver_iface::sounding::native::Measurement;
use csi5300::exchange::tdma::{Config, Epoch, Event, Plan, PlanError, Request, Tdma};
use csi5300::pipeline::live::LiveSettings;
use csi5300::source::Injector;
use csi5300::time::{Instant, Span};
use csi5300_sim::radio::Radio;
use csi5300_sim::random::Stream;
use csi5300_sim::scene::Robot;
use csi5300_sim::{Interface, Room, Scene};

/// Share of frames that a card fails to decode, as in the scene `lab-circle`.
const LOSS: f64 = 0.0015;
/// Greatest relative error of a clock's rate.
const DRIFT: f64 = 20e-6;
/// Least number of groups in all runs together, if groups share a channel.
const GROUPS: u16 = 20;
/// Slots until a silent group has an initiator: two silences and the rest of a window.
const BEGIN_SLOTS: u32 = 200;
/// Least simulated time after all robots had a turn, seconds.
const COUNTED_S: f64 = 4.0;
/// Interval at which ages are sampled.
const LOOK: Span = Span::from_ms(50);

/// Robots on one channel, all within reach of each other. Groups do not coordinate; each requests its share of the air.
#[derive(Clone, Copy, Debug)]
pub struct Shared {
    pub groups: u16,
    /// Robots in a group.
    pub size: u16,
}

/// Results, for each robot.
#[derive(Debug)]
pub struct Got {
    /// Exchanges in which it took part, a second.
    pub exchanges_hz: f64,
    /// Share of forward frames without an answer.
    pub lost: f64,
    /// Bearings due with a new exchange, a second.
    pub bearings_hz: f64,
    /// 95th percentile of the age of a pair's last exchange, seconds.
    pub age_s: f64,
    /// Records of its card, including those of other robots' exchanges, a second.
    pub records_hz: f64,
}

impl Shared {
    pub fn robots(self) -> u16 {
        self.groups * self.size
    }

    /// The request of a node, at the highest rate that its share of the air allows.
    pub fn plan(self) -> Result<(Request, Plan), PlanError> {
        let request = Request::new(self.size - 1, 1e-3);
        let slot_us = Plan::new(&request)?.shortest_slot_us;
        let round_us = slot_us * u32::from(self.size - 1) * u32::from(self.groups);
        let request = Request { rate_hz: 1e6 / f64::from(round_us), ..request };
        Plan::new(&request).map(|plan| (request, plan))
    }

    /// Exchanges in which a robot takes part if nothing is lost, a second. Each exchange involves two robots of the group.
    pub fn computed_hz(self, plan: &Plan) -> f64 {
        2e6 / plan.slot_us / f64::from(self.size)
    }

    /// Simulates the channel. With few groups, whose slots overlap by chance, this is the mean of several runs.
    pub fn simulate(self) -> Fallible<Got> {
        let runs = if self.groups == 1 { 1 } else { (GROUPS / self.groups).max(1) };
        let got: Vec<Got> = (1..=runs).map(|seed| self.run(seed.into())).collect::<Fallible<_>>()?;
        let mean = |of: fn(&Got) -> f64| got.iter().map(of).sum::<f64>() / f64::from(runs);
        Ok(Got {
            exchanges_hz: mean(|got| got.exchanges_hz),
            lost: mean(|got| got.lost),
            bearings_hz: mean(|got| got.bearings_hz),
            age_s: mean(|got| got.age_s),
            records_hz: mean(|got| got.records_hz),
        })
    }

    /// Runs the channel until every robot had a turn, then counts for another cycle.
    fn run(self, seed: u64) -> Fallible<Got> {
        let (request, plan) = self.plan()?;
        let cycle = plan.span_of(u32::from(self.size) * plan.turn_slots);
        let begin = Instant::ZERO + plan.span_of(BEGIN_SLOTS) + cycle;
        let end = begin + cycle.max(Span::from_s(COUNTED_S));
        let mut scene = Scene {
            seed,
            duration_s: end.as_s(),
            radio: Radio { mcs: request.phy.mcs, ..Radio::default() },
            robot: (0..self.robots()).map(robot).collect(),
            ..Scene::default()
        };
        scene.robot.iter_mut().for_each(|robot| robot.faults.loss = LOSS);
        let mut room = Room::quiet(&scene)?;
        let macs: Vec<Mac> = (0..scene.robot.len()).filter_map(|k| room.mac(k)).collect();
        let (mut hosts, mut random) = (Vec::new(), Stream::of_seed(seed));
        for group in macs.chunks(self.size.into()) {
            // Groups are not synchronised.
            let at = Instant::from_us((1e5 * random.uniform()) as i64);
            for own in group {
                let peers: Vec<Mac> = group.iter().copied().filter(|mac| mac != own).collect();
                let mut config = Config { initiate: true, ..Config::new(*own, 0, &peers, request, 1) };
                (config.epoch, config.start) = (Epoch::Heard(at), at);
                let (tdma, air) = (Tdma::new(&config)?, room.interface(hosts.len()).ok_or("an interface is taken")?);
                let (ahead, answered) = (DRIFT * (2.0 * random.uniform() - 1.0), vec![Vec::new(); group.len()]);
                hosts.push(Host { tdma, air, ahead, due: Some(Instant::ZERO), answered });
            }
        }
        let mut before = None;
        loop {
            let due = hosts.iter().filter_map(|host| host.due).chain(room.next_at()).min();
            let Some(now) = due.filter(|now| *now < end) else { break };
            if before.is_none() && now >= begin {
                before = Some(totals(&hosts, &room));
            }
            room.advance(now);
            hosts.iter_mut().try_for_each(|host| host.step(now, &macs))?;
        }
        let (from, to) = (before.ok_or("the run ended before counting began")?, totals(&hosts, &room));
        let [forward, answered, records] = [0, 1, 2].map(|k| (to[k] - from[k]) as f64);
        let per_robot_hz = 1.0 / (f64::from(self.robots()) * (end - begin).as_s());
        let (ages_s, fresh) = self.ages(&hosts, begin, end);
        Ok(Got {
            exchanges_hz: 2.0 * answered * per_robot_hz,
            lost: 1.0 - answered / forward.max(1.0),
            // Both robots of a pair estimate.
            bearings_hz: 2.0 * fresh * per_robot_hz,
            age_s: ages_s[ages_s.len() * 95 / 100],
            records_hz: records * per_robot_hz,
        })
    }

    /// Ages of all pairs' last exchanges, sampled at regular times, sorted, seconds; and the number of bearings due with a new
    /// exchange.
    fn ages(self, hosts: &[Host], begin: Instant, end: Instant) -> (Vec<f64>, f64) {
        let period = Span::from_s(1.0 / LiveSettings::new(1.0).rate_hz);
        let (mut ages_s, mut fresh) = (Vec::new(), 0.0);
        let pairs = hosts.chunks(self.size.into()).flat_map(|group| {
            let of = move |a: usize, b: usize| [&group[a].answered[b], &group[b].answered[a]];
            (0..group.len()).flat_map(move |a| (0..a).map(move |b| of(a, b)))
        });
        for pair in pairs {
            let mut times: Vec<Instant> = pair.into_iter().flatten().copied().collect();
            times.sort_unstable();
            let mut now = begin;
            while now < end {
                let last = times[..times.partition_point(|at| *at <= now)].last().copied();
                ages_s.push((now - last.unwrap_or(Instant::ZERO)).as_s());
                let is_due = (now - begin).as_us() % period.as_us() == 0;
                fresh += f64::from(u8::from(is_due && last.is_some_and(|last| last + period > now)));
                now += LOOK;
            }
        }
        ages_s.sort_by(f64::total_cmp);
        (ages_s, fresh)
    }
}

/// A robot on a grid with 1 m spacing.
fn robot(k: u16) -> Robot {
    Robot { name: format!("r{k}"), position_m: [f64::from(k % 32), f64::from(k / 32), 0.0], ..Robot::default() }
}

/// A robot's scheduler on its interface.
struct Host {
    tdma: Tdma,
    air: Interface,
    /// Relative error of its clock's rate; above 0 if fast.
    ahead: f64,
    /// Its next timeout on the room's clock.
    due: Option<Instant>,
    /// Times of the answers from each robot of its group.
    answered: Vec<Vec<Instant>>,
}

impl Host {
    fn step(&mut self, now: Instant, macs: &[Mac]) -> Fallible<()> {
        let own = Instant::from_us((now.as_us() as f64 * (1.0 + self.ahead)) as i64);
        let mut is_due = self.due.is_some_and(|due| due <= now);
        while let Some(seen) = self.air.see() {
            if !seen.own {
                self.tdma.handle_heard(own, own - seen.age, seen.frame);
                is_due = true;
                send(&mut self.tdma, &mut self.air, own, now)?;
            }
        }
        if is_due {
            send(&mut self.tdma, &mut self.air, own, now)?;
            while let Some(event) = self.tdma.poll_event() {
                match event {
                    Event::Answered { peer, .. } => {
                        let at = macs.binary_search(&peer).map_err(|_| "a stranger answered")?;
                        let size = self.answered.len();
                        self.answered[at % size].push(now);
                    }
                    // The next answer carries the card's measurement.
                    Event::Asked { peer, number, .. } => _ = self.tdma.set_measurement(peer, measurement(number)),
                    _ => {}
                }
            }
            let due = |at: Instant| Instant::from_us((at.as_us() as f64 / (1.0 + self.ahead)).ceil() as i64 + 1);
            self.due = self.tdma.poll_timeout().map(due);
        }
        Ok(())
    }
}

fn send(tdma: &mut Tdma, air: &mut Interface, own: Instant, now: Instant) -> Fallible<()> {
    while let Some(transmit) = tdma.poll_transmit(own) {
        air.inject(now, transmit.frame)?;
    }
    Ok(())
}

/// A measurement; the scheduler ignores its values.
fn measurement(number: u32) -> Measurement {
    let (timestamp_low, iq) = (number.wrapping_mul(1_000), [[0; 2]; SUBCARRIERS]);
    Measurement { number, timestamp_low, rx_antenna: 0, antenna_sel: 0, rssi: [0; 3], noise_dbm: -127, agc: 0, iq }
}

/// Counts of all robots so far: forward frames, answered ones, records.
fn totals(hosts: &[Host], room: &Room) -> [u64; 3] {
    let counts = |of: fn(&Tdma) -> u64| hosts.iter().map(|host| of(&host.tdma)).sum();
    let records = room.injected().iter().map(|robot| robot.received).sum();
    [counts(|tdma| tdma.counts().forward), counts(|tdma| tdma.counts().answered), records]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn simulated_rates_agree_with_computed_ones() {
        for size in [2, 3, 7] {
            let alone = Shared { groups: 1, size };
            let plan = alone.plan().unwrap().1;
            let got = alone.simulate().unwrap();
            // Either frame of an exchange may be lost.
            let share = got.exchanges_hz / alone.computed_hz(&plan);
            assert!((1.0 - 4.0 * LOSS..1.001).contains(&share) && got.lost < 4.0 * LOSS, "{size}: {share}, {got:?}");
            assert!(got.age_s < plan.span_of(u32::from(size) * plan.turn_slots).as_s(), "{got:?}");
            // Each card reports every frame of others: both of an exchange, or one if its robot takes part.
            let records_hz = got.exchanges_hz * f64::from(size - 1);
            assert!((got.records_hz / records_hz - 1.0).abs() < 0.01, "{got:?}, {records_hz}");
        }
    }

    #[test]
    fn groups_that_share_a_channel_get_less_than_their_share() {
        let three = Shared { groups: 3, size: 4 };
        let (computed_hz, got) = (three.computed_hz(&three.plan().unwrap().1), three.simulate().unwrap());
        let alone = Shared { groups: 1, ..three }.simulate().unwrap();
        assert!((0.6..1.001).contains(&(got.exchanges_hz / computed_hz)), "{computed_hz}, {got:?}");
        assert!(got.lost > alone.lost && got.age_s > 2.0 * alone.age_s, "{got:?}, {alone:?}");
    }

    #[test]
    fn more_robots_than_a_scheduler_accepts_are_rejected() {
        let error = |size| Shared { groups: 1, size }.plan().err();
        assert_eq!((error(256), error(257)), (None, Some(PlanError::Links(256))));
    }
}
