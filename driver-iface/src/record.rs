//! Framing of `.dat` logs (in work).

/// One record: a code and its body (without the code).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record<'a> {
    /// Message code: 0xBB bfee, 0xC1 MPDU, others kept and counted.
    pub code: u8,
    /// The body, after the code byte.
    pub body: &'a [u8],
}

/// Why bytes were skipped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// A length of zero.
    ZeroLength,
}

/// How a stream of records ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tail {
    /// On a record boundary.
    Clean,
}
