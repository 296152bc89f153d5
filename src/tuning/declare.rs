//! How tuned numbers are declared.

/// Declares the groups as structs, their values as a constant, and the same as a table.
macro_rules! tuning {
    ($( $(#[doc = $about:literal])* $group:ident: $Group:ident, $command:literal {
        $( $(#[doc = $what:literal])* $name:ident: $type:ty = $value:expr, $origin:literal, $sensitivity:literal; )*
    } )*) => {
        /// All groups.
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[cfg_attr(feature = "tunable", derive(serde::Serialize, serde::Deserialize), serde(default, deny_unknown_fields))]
        #[non_exhaustive]
        pub struct Tuning {
            $( $(#[doc = $about])* pub $group: $Group, )*
        }

        $(
            $(#[doc = $about])*
            #[doc = ""]
            #[doc = "Shown by"]
            #[doc = concat!("`", $command, "`.")]
            #[derive(Clone, Copy, Debug, PartialEq)]
            #[cfg_attr(
                feature = "tunable",
                derive(serde::Serialize, serde::Deserialize),
                serde(default, deny_unknown_fields)
            )]
            #[non_exhaustive]
            pub struct $Group {
                $(
                    $(#[doc = $what])*
                    #[doc = ""]
                    #[doc = concat!("Origin: ", $origin, ". At half and at double: ", $sensitivity, ".")]
                    pub $name: $type,
                )*
            }
        )*

        /// The values as chosen.
        pub(super) const CHOSEN: Tuning = Tuning { $( $group: $Group { $( $name: $value, )* }, )* };

        #[cfg(feature = "tunable")]
        impl Default for Tuning {
            fn default() -> Self {
                CHOSEN
            }
        }

        $(
            #[cfg(feature = "tunable")]
            impl Default for $Group {
                fn default() -> Self {
                    CHOSEN.$group
                }
            }
        )*

        /// The same as a list, in the order of the fields.
        #[cfg(test)]
        pub(super) fn entries() -> Vec<TuningEntry> {
            vec![$( $( TuningEntry {
                name: concat!(stringify!($group), ".", stringify!($name)).into(),
                value: format!("{:?}", CHOSEN.$group.$name),
                origin: $origin,
                sensitivity: $sensitivity,
                command: $command,
            }, )* )*]
        }
    };
}
