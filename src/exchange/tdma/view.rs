//! This robot's view of who has the turn, and its treatment of contradictions.
//!
//! Turns are numbered; every frame names the initiator, the turn, who is next and how many slots are left. The rule for
//! two initiators at once is the same on every robot: **the later turn wins, and of equal turns the initiator with the
//! lower MAC**. A contradicting frame changes this robot's view only with a valid tag, or as the third in a row that
//! agree: a single one without a tag may be forged.

/// A frame's claim about the turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Claim {
    /// Rank of the initiator (by MAC).
    pub(super) holder: u16,
    /// Its turn.
    pub(super) turn: u32,
    /// Rank of the next initiator; `None` if it is not known here.
    pub(super) next: Option<u16>,
    /// First slot after the turn.
    pub(super) end: i64,
}

/// This many contradicting frames in a row change the view.
const CONVINCING: u32 = 3;

/// The turn as this robot sees it.
#[derive(Clone, Copy, Debug)]
pub(super) struct View {
    current: Option<Claim>,
    rival: Option<(u16, u32)>,
    rival_frames: u32,
    /// A turn up to this many numbers ahead is plausible without proof.
    plausible: u32,
}

impl View {
    pub(super) fn new(robots: usize) -> Self {
        Self { current: None, rival: None, rival_frames: 0, plausible: 2 * robots as u32 + 4 }
    }

    /// The turn last heard of, or taken.
    pub(super) fn current(&self) -> Option<Claim> {
        self.current
    }

    /// Number of the turn last heard of, or taken.
    pub(super) fn turn(&self) -> u32 {
        self.current.map_or(0, |claim| claim.turn)
    }

    /// This robot takes or renews the turn; an earlier rival remains one.
    pub(super) fn begin(&mut self, claim: Claim) {
        self.current = Some(claim);
    }

    fn take(&mut self, claim: Claim) {
        self.current = Some(claim);
        self.rival = None;
    }

    /// A frame claims `heard`. True if this is (now) the view; false if the claim is not accepted.
    ///
    /// `silent`: nobody was heard for so long that any initiator is accepted. `has_key`: the group has a key, so the
    /// frame has a valid tag.
    pub(super) fn hear(&mut self, heard: Claim, silent: bool, has_key: bool) -> bool {
        let Some(current) = self.current else {
            self.take(heard);
            return true;
        };
        let same = (heard.holder, heard.turn) == (current.holder, current.turn);
        if same || silent || (precedes(current, heard) && (has_key || self.is_plausible(current, heard))) {
            self.take(heard);
            return true;
        }
        self.persists(heard, 1) && {
            self.take(heard);
            true
        }
    }

    /// As [`View::hear`] for a robot with the turn: true if it must yield. A losing rival is ignored.
    pub(super) fn hear_as_holder(&mut self, heard: Claim, has_key: bool) -> bool {
        let yields = self.current.is_none_or(|own| precedes(own, heard));
        let convinced = yields && (has_key || self.persists(heard, 0));
        if convinced {
            self.take(heard);
        }
        convinced
    }

    fn is_plausible(&self, current: Claim, heard: Claim) -> bool {
        heard.turn.wrapping_sub(current.turn) <= self.plausible
    }

    /// Counts contradicting frames that agree with each other.
    fn persists(&mut self, heard: Claim, extra: u32) -> bool {
        let key = Some((heard.holder, heard.turn));
        self.rival_frames = if self.rival == key { self.rival_frames + 1 } else { 1 };
        self.rival = key;
        self.rival_frames >= CONVINCING + extra
    }
}

/// True if `b` wins over `a`: the later turn, and of equal turns the lower rank.
fn precedes(a: Claim, b: Claim) -> bool {
    match b.turn.wrapping_sub(a.turn).cast_signed() {
        0 => b.holder < a.holder,
        step => step > 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn claim(holder: u16, turn: u32) -> Claim {
        Claim { holder, turn, next: None, end: 0 }
    }

    #[test]
    fn later_turns_win_and_equal_ones_go_to_the_lower_mac() {
        assert!(precedes(claim(1, 5), claim(2, 6)));
        assert!(!precedes(claim(1, 6), claim(2, 5)));
        assert!(precedes(claim(2, 5), claim(1, 5)));
        assert!(!precedes(claim(1, 5), claim(2, 5)));
        assert!(precedes(claim(1, u32::MAX), claim(2, 0)), "turn numbers wrap");
    }

    #[test]
    fn exactly_one_of_two_holders_yields() {
        for (a, b) in [((1, 5), (2, 5)), ((1, 5), (2, 9)), ((4, 7), (0, 6))] {
            let (a, b) = (claim(a.0, a.1), claim(b.0, b.1));
            let yields = |own, rival| {
                let mut view = View::new(4);
                view.take(own);
                (0..5).any(|_| view.hear_as_holder(rival, false))
            };
            assert_ne!(yields(a, b), yields(b, a));
        }
    }

    #[test]
    fn a_single_forged_turn_convinces_nobody_and_one_with_a_tag_does() {
        let mut view = View::new(4);
        view.take(claim(1, 5));
        assert!(!view.hear(claim(2, 5_000), false, false));
        assert!(view.hear(claim(1, 5), false, false));
        assert!(!view.hear(claim(2, 5_000), false, false));
        assert!(!view.hear_as_holder(claim(2, 5_000), false));
        assert!(view.hear(claim(2, 5_000), false, true));
        assert_eq!(view.turn(), 5_000);
        assert!(view.hear(claim(3, 1), true, false), "after a long silence any initiator is welcome");
    }

    #[test]
    fn a_persistent_rival_is_accepted() {
        let mut view = View::new(4);
        view.take(claim(1, 5_000));
        let believed: Vec<bool> = (0..4).map(|_| view.hear(claim(2, 1), false, false)).collect();
        assert_eq!(believed, [false, false, false, true]);
    }
}
