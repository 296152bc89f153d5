//! Frames as the firmware reports them, and the records that csitool's and the WSR driver make of them: written from
//! the description of those drivers, without this project's code.

/// One received frame.
pub struct Heard {
    pub timestamp: u64,
    pub rssi: [u8; 3],
    pub agc: u8,
    pub order: u8,
    pub rate_n_flags: u32,
    pub n_rx: u8,
    pub n_tx: u8,
    pub csi: Vec<u8>,
    /// The frame without its FCS.
    pub frame: Vec<u8>,
}

/// A generator whose numbers anybody can compute: xorshift64*.
pub struct Numbers(pub u64);

impl Numbers {
    pub fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    pub fn below(&mut self, bound: usize) -> usize {
        (self.next() >> 33) as usize % bound
    }

    pub fn bytes(&mut self, len: usize) -> Vec<u8> {
        (0..len).map(|_| (self.next() >> 56) as u8).collect()
    }
}

/// FCS of 802.11, bit by bit.
pub fn fcs(frame: &[u8]) -> [u8; 4] {
    let mut crc = u32::MAX;
    for byte in frame {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = crc >> 1 ^ if crc & 1 == 1 { 0xedb8_8320 } else { 0 };
        }
    }
    (!crc).to_le_bytes()
}

impl Heard {
    /// The k-th sounding frame of a sender, with measurements that are all different.
    pub fn made(numbers: &mut Numbers, number: u32) -> Self {
        let (n_rx, n_tx) = match numbers.below(10) {
            0 => (1 + numbers.below(3) as u8, 1 + numbers.below(3) as u8),
            _ => (3, 1),
        };
        let mut frame = vec![0x08, 0, 0x30, 0];
        frame.extend_from_slice(&[0x00, 0x16, 0xea, 0x12, 0x34, 0x56, 0x00, 0x16, 0xea, 0x12, 0x34, 0x56]);
        frame.extend_from_slice(&[0x00, 0x21, 0x6a, 0x3f, 0x17, numbers.below(4) as u8, 0, 0]);
        frame.extend_from_slice(&number.to_be_bytes());
        let payload = numbers.below(60);
        frame.extend(numbers.bytes(payload));
        Self {
            timestamp: numbers.next() >> 8,
            rssi: [0; 3].map(|_: u8| numbers.below(100) as u8),
            agc: numbers.below(128) as u8,
            order: [0x24, 0x18, 0x09, 0x06, 0x21, 0x12][numbers.below(6)],
            rate_n_flags: [0x0001_4101, 0x0000_4901, 0x0001_c113][numbers.below(3)],
            csi: numbers.bytes(60 * usize::from(n_rx) * usize::from(n_tx) + 12),
            n_rx,
            n_tx,
            frame,
        }
    }

    /// 0xC0: struct iwl_rx_phy_res and one word of the configurable part.
    pub fn rx_phy(&self) -> Vec<u8> {
        let mut data = vec![8, 1, 0, 0];
        data.extend_from_slice(&self.timestamp.to_le_bytes());
        data.extend_from_slice(&[0; 4]); // beacon time
        data.extend_from_slice(&[0; 2]); // flags: 5 GHz
        data.extend_from_slice(&64_u16.to_le_bytes());
        let [a, b, c] = self.rssi.map(u32::from);
        // The bits between the fields are the out-of-band values, which nobody reads.
        let words = [0x1111_2222, u32::from(self.agc) << 9 | 0xabcd_0055, 0x7700_6600 | a | b << 16, 0x5544_3300 | c];
        for word in words.into_iter().chain([0; 4]) {
            data.extend_from_slice(&word.to_le_bytes());
        }
        data.extend_from_slice(&self.rate_n_flags.to_le_bytes());
        data.extend_from_slice(&((self.frame.len() + 4) as u16).to_le_bytes());
        data.extend_from_slice(&44_u16.to_le_bytes());
        data.extend_from_slice(&[self.order, 0x99, 0x88, 0x77]);
        data
    }

    /// The frame with its FCS.
    pub fn on_air(&self) -> Vec<u8> {
        [&self.frame[..], &fcs(&self.frame)].concat()
    }

    /// 0xC1: count, the frame, and that its checksum was good.
    pub fn rx_mpdu(&self) -> Vec<u8> {
        let on_air = self.on_air();
        let mut data = (on_air.len() as u16).to_le_bytes().to_vec();
        data.extend_from_slice(&[0, 0]);
        data.extend_from_slice(&on_air);
        data.extend_from_slice(&0x3_u32.to_le_bytes());
        data
    }

    /// 0xBB: the fields that the driver fills in have other bytes here.
    pub fn bfee(&self) -> Vec<u8> {
        let mut data = vec![0xde, 0xad, 0xbe, 0xef, 0x55, 0xaa, 0x12, 0x34, self.n_rx, self.n_tx];
        data.extend_from_slice(&[0xee; 6]);
        data.extend_from_slice(&(self.csi.len() as u16).to_le_bytes());
        data.extend_from_slice(&[0xcc; 2]);
        data.extend_from_slice(&self.csi);
        data
    }

    /// The record's first 20 bytes, which both drivers have.
    fn header(&self, bfee_count: u16) -> Vec<u8> {
        let mut body = (self.timestamp as u32).to_le_bytes().to_vec();
        body.extend_from_slice(&bfee_count.to_le_bytes());
        body.extend_from_slice(&[0x12, 0x34, self.n_rx, self.n_tx]);
        body.extend_from_slice(&self.rssi);
        body.extend_from_slice(&[-127_i8 as u8, self.agc, self.order]);
        body.extend_from_slice(&(self.csi.len() as u16).to_le_bytes());
        body.extend_from_slice(&((self.rate_n_flags & 0x3fff) as u16).to_le_bytes());
        body
    }

    /// Code and body as csitool's driver sends them.
    pub fn stock(&self, bfee_count: u16) -> Vec<u8> {
        [&[0xbb][..], &self.header(bfee_count), &self.csi].concat()
    }

    /// Code and body as the WSR driver sends them; the eight bytes of the host's time are zeros.
    pub fn wsr(&self, bfee_count: u16) -> Vec<u8> {
        let number = u32::from_be_bytes(self.frame[24..28].try_into().unwrap()).to_le_bytes();
        [&[0xbb][..], &self.header(bfee_count), &[0; 8], &self.frame[16..22], &number, &self.csi].concat()
    }
}
