//! ROS 2 messages as structures: fields in the order of the `.msg` files, with their names. CDR and the text of a definition
//! are derived from them.
//!
//! | module | packages |
//! |---|---|
//! | `standard` | `builtin_interfaces`, `std_msgs`, `geometry_msgs`, `nav_msgs`, `sensor_msgs`, `tf2_msgs`, `rosgraph_msgs` |
//! | `shown` | `visualization_msgs`, `diagnostic_msgs` |
//! | `own` | `csi5300_msgs` (packaging/ros2) |
//! | `graph` | `rmw_dds_common`: the nodes of a participant |
//! | `services` | `std_srvs`, `rcl_interfaces`, `diagnostic_msgs` |

pub mod graph;
mod hash;
pub mod own;
pub mod services;
pub mod shown;
pub mod standard;

use crate::cdr::Cdr;

/// A type's name and parts in a definition.
pub trait Described {
    /// Its name as a field's type: `float64`, `std_msgs/Header`.
    fn name() -> String;
    /// The messages that it contains, each once, with their fields.
    fn parts(_into: &mut Vec<(String, String)>) {}
}

/// A message, or one half of a service.
pub trait Message: Cdr + Described + Clone + Send + 'static {
    /// `PACKAGE/msg/NAME` or `PACKAGE/srv/NAME`.
    const TYPE: &'static str;

    /// Its hash as nodes of ROS 2 from Iron on announce it: `RIHS01_` and 64 hexadecimal digits.
    #[must_use]
    fn type_hash() -> String {
        let mut parts = Vec::new();
        Self::parts(&mut parts);
        hash::rihs01(&parts)
    }

    /// The full definition for recordings (`ros2msg`): its fields, then those of its parts.
    fn definition() -> String {
        let mut parts = Vec::new();
        Self::parts(&mut parts);
        let line = "=".repeat(80);
        let others = parts.iter().skip(1).map(|(name, text)| format!("{line}\nMSG: {name}\n{text}"));
        parts.first().map(|(_, text)| text.clone()).into_iter().chain(others).collect()
    }
}

macro_rules! basic {
    ($($kind:ty: $name:literal),*) => {$(
        impl Described for $kind {
            fn name() -> String {
                $name.into()
            }
        }
    )*};
}
basic!(bool: "bool", u8: "uint8", i8: "int8", u16: "uint16", i16: "int16", u32: "uint32", i32: "int32", u64: "uint64",
    i64: "int64", f32: "float32", f64: "float64", String: "string");

impl<T: Described> Described for Vec<T> {
    fn name() -> String {
        T::name() + "[]"
    }

    fn parts(into: &mut Vec<(String, String)>) {
        T::parts(into);
    }
}

impl<T: Described, const N: usize> Described for [T; N] {
    fn name() -> String {
        format!("{}[{N}]", T::name())
    }

    fn parts(into: &mut Vec<(String, String)>) {
        T::parts(into);
    }
}

/// Defines messages: `"PACKAGE/msg/NAME" Name { field: type, ... }`.
macro_rules! messages {
    ($($(#[$doc:meta])* $kind:literal $name:ident { $($field:ident: $type:ty),* $(,)? })*) => {$(
        $(#[$doc])*
        #[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
        #[allow(missing_docs, reason = "its fields are those of the message")]
        pub struct $name {
            $(pub $field: $type,)*
        }

        impl $crate::cdr::Cdr for $name {
            fn write(&self, to: &mut $crate::cdr::CdrWriter) {
                $(self.$field.write(to);)*
            }

            fn read(
                from: &mut $crate::cdr::CdrReader<'_>,
            ) -> Result<Self, $crate::cdr::CdrError> {
                $(let $field = <$type as $crate::cdr::Cdr>::read(from)?;)*
                Ok(Self { $($field),* })
            }
        }

        impl $crate::messages::Described for $name {
            fn name() -> String {
                $kind.replace("/msg/", "/")
            }

            fn parts(into: &mut Vec<(String, String)>) {
                use $crate::messages::Described;
                let name = <Self as Described>::name();
                if into.iter().all(|(known, _)| *known != name) {
                    let fields = [$((<$type as Described>::name(), stringify!($field))),*];
                    let line = |(kind, field): &(String, &str)| format!("{kind} {}\n", field.trim_start_matches("r#"));
                    into.push((name, fields.iter().map(line).collect()));
                    $(<$type as Described>::parts(into);)*
                }
            }
        }

        impl $crate::messages::Message for $name {
            const TYPE: &'static str = $kind;
        }
    )*};
}
use messages;

#[cfg(test)]
mod tests;
