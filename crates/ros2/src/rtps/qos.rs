//! Quality of service, and why two endpoints do not match (\[dds\] 2.2.3).

/// What a writer offers or a reader requests, as far as matching depends on it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Qos {
    /// Lost samples are sent again.
    pub reliable: bool,
    /// Durability, whether late readers receive earlier samples: 0 volatile, 1 transient local, and higher ones.
    pub durability: u32,
    /// Samples that a writer keeps, or that a reader requests.
    pub depth: u32,
    /// A deadline between samples is offered or requested.
    pub has_deadline: bool,
    /// Liveliness is offered or requested: manual, or with a lease.
    pub has_liveliness: bool,
    /// Samples are ordered by time of writing, not of reception.
    pub by_source: bool,
    /// Exclusive ownership: one writer only.
    pub exclusive: bool,
    /// Partitions of the domain; an empty list is the unnamed one.
    pub partitions: Vec<String>,
    /// Data representations offered or accepted: 0 is CDR version 1, 2 version 2. Empty: 0.
    pub representations: Vec<i16>,
    /// The hash of the type's definition (RIHS01), which ROS 2 sends in `USER_DATA` from Iron on.
    pub type_hash: Option<String>,
}

impl Qos {
    /// The default of ROS 2: reliable, nothing for late readers.
    #[must_use]
    pub fn reliable(depth: u32) -> Self {
        Self { reliable: true, depth, ..Self::default() }
    }

    /// As ROS 2 has it for sensors: best effort.
    #[must_use]
    pub fn best_effort(depth: u32) -> Self {
        Self { depth, ..Self::default() }
    }

    /// As ROS 2 has it for latched topics such as `/tf_static`.
    #[must_use]
    pub fn latched(depth: u32) -> Self {
        Self { durability: 1, ..Self::reliable(depth) }
    }

    /// Why a reader that requests `asked` does not match a writer that offers this, as text.
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
    fn offered_quality_must_meet_the_requested_quality() {
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
        // An endpoint without a hash, such as a node of Humble, matches all.
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
