//! What a survey takes of a bfee record: its fields beside the CSI.

use driver_iface::bfee::{Antennas, Bfee, Repr};

/// The fields of an intact bfee record beside its CSI: small enough to be handed from one thread to another, which need not look at
/// the record itself then.
#[doc(hidden)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fields {
    /// As they are in the record.
    pub head: Repr,
    /// Antenna of each chain, where the record says a permutation.
    pub antennas: Option<Antennas>,
    /// Bytes behind the CSI.
    pub behind_csi: u16,
}

impl Fields {
    /// Those of a record.
    #[must_use]
    #[inline]
    pub fn of(bfee: &Bfee<'_>) -> Self {
        Self { head: Repr::parse(bfee), antennas: bfee.antennas().ok(), behind_csi: bfee.behind_csi().len() as u16 }
    }
}
