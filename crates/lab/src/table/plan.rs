//! Where a record's samples go: the same for most records in a row, and made anew only where that changes.

use super::columns::antenna_order;
use super::decode::Rows;
use driver_iface::bfee::{Bfee, MAX_SAMPLES, SUBCARRIERS};

/// Columns of the largest record.
const MOST: usize = MAX_SAMPLES / SUBCARRIERS;

/// What the plan of a record depends on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Kind {
    antenna_sel: u8,
    /// 0 before the first record.
    n_rx: usize,
    n_tx: usize,
    /// Of a record of one chain, whose RSSI may say which antenna that was.
    rssi: [u8; 3],
}

impl Kind {
    fn of(bfee: &Bfee<'_>) -> Self {
        let (n_rx, rssi) = (bfee.n_rx(), bfee.rssi());
        Self { antenna_sel: bfee.antenna_sel(), n_rx, n_tx: bfee.n_tx(), rssi: if n_rx == 1 { rssi } else { [0; 3] } }
    }
}

/// How the columns of an array, row by row, are made from a record's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Way {
    /// As they are.
    Straight,
    /// From those of the numbers that [`Plan::sources`] has.
    Sorted,
    /// Some have none.
    #[default]
    Partly,
}

/// Where the samples of a record go.
#[derive(Clone, Debug, Default)]
pub(super) struct Plan {
    kind: Kind,
    /// The chain of each row.
    pub chains: [Option<usize>; 3],
    /// How columns are made.
    pub way: Way,
    /// Of each column the record's, `chain n_tx + stream`, where it has one.
    pub sources: [Option<usize>; MOST],
}

impl Plan {
    /// Makes it that of a record.
    #[inline(always)]
    pub fn fit(&mut self, bfee: &Bfee<'_>, rows: &Rows) {
        let kind = Kind::of(bfee);
        if self.kind != kind {
            *self = Self::new(kind, bfee, rows);
        }
    }

    #[inline(never)]
    fn new(kind: Kind, bfee: &Bfee<'_>, rows: &Rows) -> Self {
        let chains = rows.chains(kind.n_rx, antenna_order(bfee));
        let columns = rows.n_rx * rows.n_tx;
        let source = |column: usize| {
            let stream = column % rows.n_tx;
            let chain = chains.get(column / rows.n_tx).copied().flatten();
            chain.filter(|_| stream < kind.n_tx).map(|chain| chain * kind.n_tx + stream)
        };
        let sources: [_; MOST] = std::array::from_fn(|column| if column < columns { source(column) } else { None });
        let of_columns = sources.get(..columns).unwrap_or_default();
        let way = if of_columns.iter().any(Option::is_none) {
            Way::Partly
        } else if columns == kind.n_rx * kind.n_tx && of_columns.is_sorted() {
            Way::Straight
        } else {
            Way::Sorted
        };
        Self { kind, chains, way, sources }
    }
}
