//! Checks of all requirements of a first record, in the order in which they usually fail, and the set-up of the card.
//!
//! Every check reads the machine through [`System`], so that tests can stage each failure with a folder of files. The
//! facts are those of csitool's and WSR's installation notes and of their users' reports.

mod ax2xx;
mod card;
mod error;
mod host;
mod radio;
mod reception;
mod setup;
mod system;
mod ways;

pub(crate) use card::IWL5300;
pub use error::SetupError;
pub use radio::channel_flags;
pub(crate) use radio::rate_file;
pub use reception::Reception;
pub(crate) use setup::module::RATE as MODULE_RATE;
pub use setup::{Action, Driver, Request, Role, Step, default_interface, plan, undo, warnings};
pub use system::{Machine, Ran, System, Tree, module_counters};
pub(crate) use ways::{EBPF_FROM, kernel_version};

/// The result of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// As it should be.
    Good,
    /// A possible problem.
    Doubt,
    /// A problem.
    Bad,
    /// Unknown.
    Unknown,
}

/// One check.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Check {
    /// What was checked.
    pub name: &'static str,
    /// The result.
    pub verdict: Verdict,
    /// What was found.
    pub found: String,
    /// What was expected.
    pub expected: String,
    /// The command or step that repairs it.
    pub mend: Option<String>,
}

impl Check {
    fn new(name: &'static str, verdict: Verdict, found: impl Into<String>, expected: impl Into<String>) -> Self {
        Self { name, verdict, found: found.into(), expected: expected.into(), mend: None }
    }

    fn mend(mut self, mend: impl Into<String>) -> Self {
        self.mend = Some(mend.into());
        self
    }

    fn good(name: &'static str, found: impl Into<String>, expected: impl Into<String>) -> Self {
        Self::new(name, Verdict::Good, found, expected)
    }

    fn bad(name: &'static str, found: impl Into<String>, expected: impl Into<String>) -> Self {
        Self::new(name, Verdict::Bad, found, expected)
    }

    fn doubt(name: &'static str, found: impl Into<String>, expected: impl Into<String>) -> Self {
        Self::new(name, Verdict::Doubt, found, expected)
    }

    fn unknown(name: &'static str, found: impl Into<String>, expected: impl Into<String>) -> Self {
        Self::new(name, Verdict::Unknown, found, expected)
    }
}

/// The checks that need no reception, in order.
pub fn examine(system: &dyn System) -> Vec<Check> {
    let card = card::Card::find(system);
    if card.is_none()
        && let Some(checks) = ax2xx::checks(system)
    {
        return checks;
    }
    let ways = ways::Ways::find(system);
    let mut checks = card::checks(system, card.as_ref(), &ways);
    checks.extend(radio::checks(system, card.as_ref()));
    checks.extend(host::checks(system, &ways));
    checks
}

#[cfg(test)]
mod tests;
