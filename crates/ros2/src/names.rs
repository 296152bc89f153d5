//! Names of ROS 2 and their DDS equivalents.

use std::collections::BTreeMap;

/// Makes a valid part of a ROS name: letters, digits and `_`, not starting with a digit.
#[must_use]
pub fn name_part(name: &str) -> String {
    let plain: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    if plain.starts_with(|c: char| c.is_ascii_digit()) { format!("_{plain}") } else { plain }
}

/// True for a name whose parts are letters, digits and `_`, none starting with a digit: `/tb3_0/odom`, `odom`, `~/odom`.
pub(crate) fn is_name(name: &str) -> bool {
    let part = |part: &str| {
        part.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
            && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
    };
    let rest = name.strip_prefix("~/").or_else(|| name.strip_prefix('/')).unwrap_or(name);
    rest.split('/').all(part)
}

/// A node's name and its rules for resolving names.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Names {
    /// `/` or `/lab/burger`.
    pub namespace: String,
    /// `csi5300_burger`.
    pub node: String,
    /// From a full name to another, as with `--remap`.
    pub remap: BTreeMap<String, String>,
}

impl Names {
    /// The node's full name.
    pub fn node(&self) -> String {
        format!("{}/{}", self.namespace.trim_end_matches('/'), self.node)
    }

    fn expanded(&self, name: &str) -> String {
        if let Some(rest) = name.strip_prefix("~/") {
            format!("{}/{rest}", self.node())
        } else if name.starts_with('/') {
            name.to_owned()
        } else {
            format!("{}/{name}", self.namespace.trim_end_matches('/'))
        }
    }

    /// Resolves a name in the node (`~/csi`), its namespace (`odom`) or from the root (`/tf`), then remaps it.
    pub fn whole(&self, name: &str) -> String {
        let whole = self.expanded(name);
        let other = self.remap.iter().find(|(from, _)| self.expanded(from) == whole);
        other.map_or(whole, |(_, to)| self.expanded(to))
    }
}

/// The DDS topic of a ROS topic.
pub(crate) fn topic(whole: &str) -> String {
    format!("rt{whole}")
}

/// The DDS topics of a service: requests and answers.
pub(crate) fn service(whole: &str) -> (String, String) {
    (format!("rq{whole}Request"), format!("rr{whole}Reply"))
}

/// The DDS type of a ROS type: `nav_msgs/msg/Odometry` is `nav_msgs::msg::dds_::Odometry_`.
pub(crate) fn kind(kind: &str) -> String {
    match kind.rsplit_once('/') {
        Some((package, name)) => format!("{}::dds_::{name}_", package.replace('/', "::")),
        None => kind.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dds_names_are_ros_2s() {
        assert_eq!(kind("nav_msgs/msg/Odometry"), "nav_msgs::msg::dds_::Odometry_");
        assert_eq!(kind("std_srvs/srv/Trigger_Request"), "std_srvs::srv::dds_::Trigger_Request_");
        assert_eq!(topic("/lab/odom"), "rt/lab/odom");
        assert_eq!(service("/n/start"), ("rq/n/startRequest".into(), "rr/n/startReply".into()));
        assert_eq!(name_part("burger-1"), "burger_1");
        assert_eq!(name_part("02:53"), "_02_53");
        for good in ["/odom", "odom", "~/csi", "/a/b_c", "/a__b/odom"] {
            assert!(is_name(good), "{good}");
        }
        for bad in ["", "/", "a//b", "/1a", "a b", "/a/", "~x"] {
            assert!(!is_name(bad), "{bad}");
        }
    }

    #[test]
    fn names_are_expanded_and_remapped() {
        let remap = [("odom", "/base/odom"), ("/tf", "tf"), ("~/csi", "/csi")];
        let remap = remap.into_iter().map(|(from, to)| (from.to_owned(), to.to_owned())).collect();
        let names = Names { namespace: "/lab".into(), node: "n".into(), remap };
        assert_eq!(names.node(), "/lab/n");
        assert_eq!(names.whole("odom"), "/base/odom");
        assert_eq!(names.whole("/tf"), "/lab/tf");
        assert_eq!(names.whole("~/csi"), "/csi");
        assert_eq!(names.whole("~/b/bearing"), "/lab/n/b/bearing");
        assert_eq!(names.whole("/odom"), "/odom");
        let root = Names { namespace: "/".into(), node: "n".into(), remap: BTreeMap::new() };
        assert_eq!((root.node().as_str(), root.whole("odom").as_str()), ("/n", "/odom"));
    }
}
