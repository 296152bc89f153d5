//! Quality of service, and why two ends do not go together (\[dds\] 2.2.3).

/// What a writer offers or a reader asks for, as far as it decides whether they meet.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Qos {
    /// What is lost is sent again.
    pub reliable: bool,
    /// Who comes late gets what was sent before: 0 volatile, 1 transient local, and further ones.
    pub durability: u32,
    /// Samples that a writer keeps, or that were asked for.
    pub depth: u32,
    /// A time between samples is promised or asked for.
    pub has_deadline: bool,
    /// Signs of life are promised or asked for: by hand, or within a time.
    pub has_liveliness: bool,
    /// Samples are ordered by the time at which they were written, not received.
    pub by_source: bool,
    /// One writer only.
    pub exclusive: bool,
    /// Parts of the domain; none is the one without a name.
    pub partitions: Vec<String>,
    /// Representations offered, or taken: 0 is CDR version 1, 2 version 2. None: 0.
    pub representations: Vec<i16>,
    /// The hash of the type's definition (RIHS01), which ROS 2 puts beside the rest (`USER_DATA`) from Iron on.
    pub type_hash: Option<String>,
}

impl Qos {
    /// As ROS 2 publishes and subscribes unless it is asked otherwise: reliable, nothing for those who come late.
    #[must_use]
    pub fn reliable(depth: u32) -> Self {
        Self { reliable: true, depth, ..Self::default() }
    }

    /// As ROS 2 has it for sensors: what is lost is lost.
    #[must_use]
    pub fn best_effort(depth: u32) -> Self {
        Self { depth, ..Self::default() }
    }

    /// As ROS 2 has it for what is published once, such as `/tf_static`.
    #[must_use]
    pub fn latched(depth: u32) -> Self {
        Self { durability: 1, ..Self::reliable(depth) }
    }

    /// Why a reader that asks for `asked` gets nothing of a writer that offers this, in words.
    #[must_use]
    pub fn mismatch(&self, asked: &Self) -> Option<&'static str> {
        let any = |list: &[i16], wanted: i16| if list.is_empty() { wanted == 0 } else { list.contains(&wanted) };
        let representation = self.representations.first().copied().unwrap_or(0);
        let partition = |list: &[String]| if list.is_empty() { vec![String::new()] } else { list.to_vec() };
        let (own, theirs) = (partition(&self.partitions), partition(&asked.partitions));
        if self.type_hash.as_ref().zip(asked.type_hash.as_ref()).is_some_and(|(own, theirs)| own != theirs) {
            Some("publisher and subscriber have different definitions of this message (their type hashes differ)")
        } else if asked.reliable && !self.reliable {
            Some("the publisher is best effort, and the subscriber asks for reliable")
        } else if asked.durability > self.durability {
            Some("the publisher is volatile, and the subscriber asks for transient local")
        } else if asked.has_deadline && !self.has_deadline {
            Some("the subscriber asks for a deadline, and the publisher promises none")
        } else if asked.has_liveliness && !self.has_liveliness {
            Some("the subscriber asks for signs of life (liveliness) that the publisher does not promise")
        } else if asked.by_source && !self.by_source {
            Some(
                "the subscriber asks for the order of writing (destination order by source), and the publisher offers that of reception",
            )
        } else if asked.exclusive != self.exclusive {
            Some("one end has exclusive ownership, the other shared")
        } else if !any(&asked.representations, representation) {
            Some("the publisher writes a representation (XCDR) that the subscriber does not take")
        } else if !own.iter().any(|one| theirs.contains(one)) {
            Some("they are in different partitions")
        } else {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_offered_must_be_what_is_asked_for_or_more() {
        let (sensor, usual, latched) = (Qos::best_effort(5), Qos::reliable(10), Qos::latched(1));
        for (offered, asked, why) in [
            (&usual, &usual, None),
            (&usual, &sensor, None),
            (&latched, &usual, None),
            (&sensor, &usual, Some("best effort")),
            (&usual, &latched, Some("volatile")),
        ] {
            let said = offered.mismatch(asked);
            assert_eq!(said.is_some(), why.is_some(), "{offered:?} {asked:?}");
            assert!(said.unwrap_or_default().contains(why.unwrap_or_default()), "{said:?}");
        }
        let second = Qos { representations: vec![2], ..usual.clone() };
        assert!(usual.mismatch(&second).is_some_and(|why| why.contains("XCDR")));
        assert_eq!(usual.mismatch(&Qos { representations: vec![2, 0], ..usual.clone() }), None);
        // One that does not say, such as a node of Humble, goes with all.
        let hashed = |hash: &str| Qos { type_hash: Some(hash.into()), ..usual.clone() };
        assert!(hashed("RIHS01_a").mismatch(&hashed("RIHS01_b")).is_some_and(|why| why.contains("type hashes")));
        for (offered, asked) in [(hashed("RIHS01_a"), hashed("RIHS01_a")), (hashed("RIHS01_a"), usual.clone())] {
            assert_eq!((offered.mismatch(&asked), asked.mismatch(&offered)), (None, None));
        }
        let apart = Qos { partitions: vec!["a".into()], ..usual.clone() };
        assert!(usual.mismatch(&apart).is_some_and(|why| why.contains("partitions")));
        for (asked, why) in [
            (Qos { has_deadline: true, ..usual.clone() }, "deadline"),
            (Qos { has_liveliness: true, ..usual.clone() }, "liveliness"),
            (Qos { by_source: true, ..usual.clone() }, "destination order"),
        ] {
            assert!(usual.mismatch(&asked).is_some_and(|said| said.contains(why)), "{why}");
            assert_eq!(asked.mismatch(&usual), None, "{why}");
        }
    }
}
