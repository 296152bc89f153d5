//! Packets as an Intel 5300 sends them, and what csitool's and WSR's drivers make of them: an oracle that shares no code
//! with the library.
//!
//! The oracle follows csitool's `iwlagn_bfee_notif`, `iwlagn_rx_reply_rx_phy` and `iwlagn_rx_reply_rx` (and WSR's changes to
//! them), with these differences: no field is ever a leftover of another frame, every length is checked, and the counter
//! is a card's own.
#![allow(dead_code, clippy::unwrap_used, clippy::expect_used, clippy::indexing_slicing)]

/// A packet: command and data.
pub type Packet = (u8, Vec<u8>);

/// xorshift64.
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 16) as u32
    }

    fn bytes(&mut self, n: usize) -> Vec<u8> {
        (0..n).map(|_| self.next() as u8).collect()
    }
}

/// A good 0xC0; `words` configured words follow the fixed part, of which the count says `said`.
pub fn phy(random: &mut Random, words: usize, said: u8) -> Packet {
    let mut data = random.bytes(60 + 4 * words);
    data[1] = said;
    (0xC0, data)
}

/// A good 0xC1 with a frame of `len` bytes and this status.
pub fn mpdu(random: &mut Random, len: usize, status: u32) -> Packet {
    let mut data = (len as u16).to_le_bytes().to_vec();
    data.extend([0, 0]);
    data.extend(random.bytes(len));
    data.extend(status.to_le_bytes());
    (0xC1, data)
}

/// A good 0xBB with `extra` bytes behind it.
pub fn csi(random: &mut Random, n_rx: u8, n_tx: u8, extra: usize) -> Packet {
    let len = 60 * usize::from(n_rx) * usize::from(n_tx) + 12;
    let mut data = random.bytes(20 + len + extra);
    (data[8], data[9]) = (n_rx, n_tx);
    data[16..18].copy_from_slice(&(len as u16).to_le_bytes());
    (0xBB, data)
}

/// The three packets of one sounding frame of 57 bytes, number `number`, from `mac`, received on three chains.
pub fn sounding(random: &mut Random, mac: [u8; 6], number: u32, time_us: u32) -> [Packet; 3] {
    let mut phy = phy(random, 1, 1);
    phy.1[4..12].copy_from_slice(&u64::from(time_us).to_le_bytes());
    // 2.4 GHz, channel 6, MCS 1 from antenna A: what the driver hands to mac80211 has to be possible.
    phy.1[16..20].copy_from_slice(&[1, 0, 6, 0]);
    phy.1[52..56].copy_from_slice(&0x4101_u32.to_le_bytes());
    phy.1[60] = 0x24;
    let mut mpdu = mpdu(random, 57, 3);
    mpdu.1[4..4 + 16]
        .copy_from_slice(&[8, 0, 0x30, 0, 0, 0x16, 0xea, 0x12, 0x34, 0x56, 0, 0x16, 0xea, 0x12, 0x34, 0x56]);
    mpdu.1[4 + 16..4 + 22].copy_from_slice(&mac);
    mpdu.1[4 + 24..4 + 28].copy_from_slice(&number.to_be_bytes());
    [phy, mpdu, csi(random, 3, 1, 0)]
}

/// A packet of any kind, good or hostile, from three numbers.
pub fn any(kind: u8, a: u32, b: u32) -> Packet {
    let mut random = Random(u64::from(a) << 32 | u64::from(b) | 1);
    let mut one = |kind: u32| match kind % 3 {
        0 => phy(&mut random, (b % 3) as usize, (a % 2) as u8),
        1 if b.is_multiple_of(61) => mpdu(&mut random, 8_170 + (a % 30) as usize, 3),
        1 => mpdu(&mut random, 10 + (a % 90) as usize, if b.is_multiple_of(4) { a } else { 3 }),
        _ => csi(&mut random, 1 + (a % 3) as u8, 1 + (b % 3) as u8, (b % 7) as usize),
    };
    match kind % 10 {
        0 | 1 => one(0),
        2 | 3 => one(1),
        4 | 5 => one(2),
        6 => {
            let (command, mut data) = one(a);
            data.truncate(b as usize % (data.len() + 1));
            (command, data)
        }
        7 => {
            let (command, mut data) = one(a);
            let at = b as usize % data.len().min(24);
            data[at] = (a >> 8) as u8;
            (command, data)
        }
        8 => ([0xC0, 0xC1, 0xBB, 0x9C][a as usize % 4], random.bytes(b as usize % 700)),
        _ => (if a.is_multiple_of(8) { 0x01 } else { a as u8 }, random.bytes(b as usize % 90)),
    }
}

/// What the oracle counts: phy, mpdu, bfee, records, bad_phy, bad_mpdu, mpdu_no_phy, bad_bfee, no_phy, no_order, no_sender.
pub type Counts = [u32; 11];

/// A driver after csitool's rules.
#[derive(Default)]
pub struct Oracle {
    pub counts: Counts,
    last_phy: Option<Vec<u8>>,
    ever_phy: bool,
    mac_and_number: Option<[u8; 10]>,
    bfee_count: u16,
}

impl Oracle {
    /// The message (code and body) that this packet leads to.
    pub fn packet(&mut self, wsr: bool, log: u8, (command, data): &Packet, time: (u32, u32)) -> Option<Vec<u8>> {
        match command {
            0x01 => {
                (self.last_phy, self.ever_phy, self.mac_and_number) = (None, false, None);
                None
            }
            0xC0 => {
                self.counts[0] += 1;
                self.mac_and_number = None;
                let good = data.len() >= 60;
                self.counts[4] += u32::from(!good);
                self.ever_phy |= good;
                self.last_phy = good.then(|| data.clone());
                None
            }
            0xC1 => self.mpdu(log, data),
            0xBB => self.bfee(wsr, log, data, time),
            _ => None,
        }
    }

    fn mpdu(&mut self, log: u8, data: &[u8]) -> Option<Vec<u8>> {
        self.counts[1] += 1;
        let len = if data.len() < 8 { 0 } else { usize::from(data[0]) + 256 * usize::from(data[1]) };
        if !(14..=8191).contains(&len) || data.len() < len + 8 {
            self.counts[5] += 1;
            self.mac_and_number = None;
            return None;
        }
        if !self.ever_phy {
            self.counts[6] += 1;
            return None;
        }
        let (frame, status) = (&data[4..4 + len], data[4 + len]);
        if len >= 32 && status & 3 == 3 {
            let mut found = [0; 10];
            found[6..].copy_from_slice(&frame[24..28]);
            found[6..].reverse();
            if found != [0; 10] {
                found[..6].copy_from_slice(&frame[16..22]);
            }
            self.mac_and_number = Some(found);
        }
        (log & 4 != 0).then(|| [&[0xC1], frame].concat())
    }

    fn bfee(&mut self, wsr: bool, log: u8, data: &[u8], time: (u32, u32)) -> Option<Vec<u8>> {
        self.counts[2] += 1;
        let (phy, sender) = (self.last_phy.take(), self.mac_and_number.take());
        let chains = |at: usize| matches!(data[at], 1..=3);
        let need = |data: &[u8]| (30 * (usize::from(data[8]) * usize::from(data[9]) * 16 + 3)).div_ceil(8);
        if data.len() < 20
            || !(chains(8) && chains(9))
            || usize::from(u16::from_le_bytes([data[16], data[17]])) != need(data)
            || data.len() < 20 + need(data)
        {
            self.counts[7] += 1;
            return None;
        }
        let Some(phy) = phy else {
            self.counts[8] += 1;
            return None;
        };
        self.counts[3] += 1;
        self.bfee_count = self.bfee_count.wrapping_add(1);
        // struct iwl_rx_phy_res: the words of non_cfg_phy_buf begin at 20.
        let word = |at: usize| u32::from_le_bytes(phy[at..at + 4].try_into().unwrap());
        let order = if phy[1] > 0 && phy.len() >= 64 { phy[60] } else { 0xff };
        self.counts[9] += u32::from(order == 0xff);
        let mut out = vec![0xBB];
        out.extend(&phy[4..8]);
        out.extend(self.bfee_count.to_le_bytes());
        out.extend(&data[6..10]);
        out.extend([(word(28) & 0xff) as u8, ((word(28) & 0xff_0000) >> 16) as u8, (word(32) & 0xff) as u8]);
        out.extend([0x81, ((word(24) & 0xfe00) >> 9) as u8, order]);
        out.extend(&data[16..18]);
        out.extend(((word(52) & 0x3fff) as u16).to_le_bytes());
        if wsr {
            self.counts[10] += u32::from(sender.is_none());
            out.extend(time.0.to_le_bytes());
            out.extend(time.1.to_le_bytes());
            out.extend(sender.unwrap_or_default());
        }
        out.extend(&data[20..20 + need(data)]);
        (log & 1 != 0).then_some(out)
    }
}
