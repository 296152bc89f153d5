//! The corpus of a fuzz target (`fuzz/corpus`), run again as it is and with damage.
#![allow(dead_code)]

use std::path::Path;

/// xorshift64: the same on every run.
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    pub fn below(&mut self, end: usize) -> usize {
        (self.next() % end.max(1) as u64) as usize
    }

    pub fn bytes(&mut self, n: usize) -> Vec<u8> {
        (0..n).map(|_| self.next() as u8).collect()
    }

    /// Changes a few bytes: overwritten, removed, inserted, cut.
    pub fn damage(&mut self, bytes: &mut Vec<u8>) {
        for _ in 0..self.below(4) {
            let at = self.below(bytes.len());
            match self.below(5) {
                0 => bytes.truncate(at),
                1 if at < bytes.len() => drop(bytes.remove(at)),
                2 => bytes.insert(at, self.next() as u8),
                3 => {
                    let n = self.below(20);
                    let garbage = self.bytes(n);
                    bytes.splice(at..at, garbage);
                }
                _ if at < bytes.len() => bytes[at] ^= 1 << self.below(8),
                _ => {}
            }
        }
    }
}

/// Runs each input of a target's corpus, and variants of it with bytes changed, taken out and put in.
pub fn replay(target: &str, run: fn(&[u8])) {
    let own = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = own.ancestors().map(|at| at.join("fuzz/corpus").join(target)).find(|folder| folder.is_dir());
    let folder = folder.unwrap_or_else(|| panic!("no corpus of {target}"));
    let mut inputs: Vec<Vec<u8>> =
        std::fs::read_dir(folder).unwrap().map(|file| std::fs::read(file.unwrap().path()).unwrap()).collect();
    inputs.sort();
    assert!(!inputs.is_empty(), "the corpus of {target} is empty");
    let mut random = Random(0x5300_0006);
    for input in &inputs {
        run(input);
        for _ in 0..10 {
            let mut damaged = input.clone();
            random.damage(&mut damaged);
            run(&damaged);
        }
    }
}
