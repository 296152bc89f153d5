//! The corpus of a fuzz target (`fuzz/corpus`), run again as it is and with damage.

use std::path::Path;

/// Runs each input of a target's corpus, and variants of it with bytes changed, taken out and put in.
pub fn replay(target: &str, run: fn(&[u8])) {
    let own = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = own.ancestors().map(|at| at.join("fuzz/corpus").join(target)).find(|folder| folder.is_dir());
    let folder = folder.unwrap_or_else(|| panic!("no corpus of {target}"));
    let mut inputs: Vec<Vec<u8>> =
        std::fs::read_dir(folder).unwrap().map(|file| std::fs::read(file.unwrap().path()).unwrap()).collect();
    inputs.sort();
    assert!(!inputs.is_empty(), "the corpus of {target} is empty");
    // xorshift64.
    let mut state = 0x5300_0006_u64;
    let mut below = |end: usize| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state % end.max(1) as u64) as usize
    };
    for input in &inputs {
        run(input);
        for _ in 0..10 {
            let mut damaged = input.clone();
            for _ in 0..=below(3) {
                let at = below(damaged.len());
                match below(4) {
                    0 => damaged.truncate(at),
                    1 if at < damaged.len() => drop(damaged.remove(at)),
                    2 => damaged.insert(at, below(256) as u8),
                    _ if at < damaged.len() => damaged[at] ^= 1 << below(8),
                    _ => {}
                }
            }
            run(&damaged);
        }
    }
}
