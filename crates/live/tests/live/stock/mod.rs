//! What runs in the guest of tests/checks/stock.sh: the stock driver on cards that are not there (tests/kernel/fakecard),
//! and csi5300.ko beside it. Each test is a step of a script there and does nothing elsewhere.

mod air;
mod card;
mod hostile;
mod listener;
mod oracle;
mod records;

/// The step's argument, if this is the guest.
fn step(name: &str) -> Option<String> {
    let argument = std::env::var(name).ok();
    if argument.is_none() {
        crate::common::skipped("runs in the guest of tests/checks/stock.sh");
    }
    argument
}
