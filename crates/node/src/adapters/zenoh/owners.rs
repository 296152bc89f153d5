//! Zenoh's access control, made from the peers' `certificate`: who may publish as a peer.
//!
//! Zenoh judges a message by its link, so a robot with a named certificate must be linked directly, without a router.

use driver_iface::Mac;
use serde_json::{Value, json};

/// Messages of discovery; none is a record or a pose.
const ASKING: [&str; 7] = [
    "declare_subscriber",
    "query",
    "declare_queryable",
    "reply",
    "liveliness_token",
    "declare_liveliness_subscriber",
    "liveliness_query",
];

/// A peer and who may publish as it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Owner {
    /// The peer.
    pub mac: Mac,
    /// The common name of its certificate; without one, anybody in the network may publish as it.
    pub certificate: Option<String>,
}

/// A MAC as part of a key.
pub(crate) fn key_of(mac: Mac) -> String {
    mac.to_string().replace(':', "")
}

/// Zenoh's table `access_control` for keys below `prefix` and those that are read for ROS 2; `None` without a named
/// certificate.
///
/// Everything else is refused, also messages to many keys (`*`).
pub(crate) fn access_control(prefix: &str, owners: &[Owner], ros2: Option<&[String]>) -> Option<Value> {
    if owners.iter().all(|owner| owner.certificate.is_none()) {
        return None;
    }
    let allowed = |id: &str, flows: &[&str], messages: &[&str], key: &str| json!({ "id": id, "permission": "allow", "flows": flows, "messages": messages, "key_exprs": [key] });
    let mut rules = vec![
        allowed("ask", &["ingress", "egress"], &ASKING, "**"),
        allowed("send", &["egress"], &["put", "delete"], "**"),
    ];
    let (mut subjects, mut policies) = (vec![json!({ "id": "anybody" })], Vec::new());
    let mut open = vec![json!("ask"), json!("send")];
    for owner in owners {
        let key = key_of(owner.mac);
        rules.push(allowed(&key, &["ingress"], &["put"], &format!("{prefix}/{key}/**")));
        match &owner.certificate {
            None => open.push(json!(key)),
            Some(name) => {
                subjects.push(json!({ "id": key, "cert_common_names": [name] }));
                policies.push(json!({ "rules": [key], "subjects": [key] }));
            }
        }
    }
    if let Some(keys) = ros2 {
        // `**` does not include parts that begin with `@`.
        let graph = ["@ros2_lv/**", "**/@adv/**"];
        rules.push(json!({ "id": "graph", "permission": "allow", "flows": ["ingress", "egress"], "messages": ASKING, "key_exprs": graph }));
        open.push(json!("graph"));
        if !keys.is_empty() {
            rules.push(json!({ "id": "topics", "permission": "allow", "flows": ["ingress"], "messages": ["put"], "key_exprs": keys }));
            open.push(json!("topics"));
        }
    }
    policies.push(json!({ "rules": open, "subjects": ["anybody"] }));
    Some(json!({
        "enabled": true,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn owner(last: u8, certificate: Option<&str>) -> Owner {
        Owner { mac: Mac([0, 0x21, 0x6a, 0, 0, last]), certificate: certificate.map(Into::into) }
    }

    #[test]
    fn without_a_certificate_there_is_no_access_control() {
        assert_eq!(access_control("csi5300/lab", &[], None), None);
        assert_eq!(access_control("csi5300/lab", &[owner(1, None)], None), None);
    }

    #[test]
    fn an_owned_key_is_published_by_its_certificate_only() {
        let owners = [owner(1, Some("burger-1")), owner(2, None)];
        let made = access_control("csi5300/lab", &owners, None).unwrap();
        assert_eq!((&made["enabled"], &made["default_permission"]), (&json!(true), &json!("deny")));
        let rule = |id: &str| made["rules"].as_array().unwrap().iter().find(|rule| rule["id"] == id).unwrap();
        for (id, key) in
            [("00216a000001", "csi5300/lab/00216a000001/**"), ("00216a000002", "csi5300/lab/00216a000002/**")]
        {
            let taken = json!({
                "id": id, "permission": "allow", "flows": ["ingress"], "messages": ["put"], "key_exprs": [key],
            });
            assert_eq!(rule(id), &taken);
        }
        // Messages of others are refused.
        let incoming = made["rules"].as_array().unwrap().iter().filter(|rule| {
            let has = |list: &Value, what: &str| list.as_array().unwrap().contains(&json!(what));
            has(&rule["flows"], "ingress") && (has(&rule["messages"], "put") || has(&rule["messages"], "delete"))
        });
        assert_eq!(incoming.count(), 2);
        assert_eq!(
            made["subjects"],
            json!([{ "id": "anybody" }, { "id": "00216a000001", "cert_common_names": ["burger-1"] }])
        );
        assert_eq!(
            made["policies"],
            json!([
                { "rules": ["00216a000001"], "subjects": ["00216a000001"] },
                { "rules": ["ask", "send", "00216a000002"], "subjects": ["anybody"] },
            ])
        );
        // Of ROS 2 only what is read, from anybody in the network.
        let key = "0/odom/nav_msgs::msg::dds_::Odometry_/RIHS01_3c".to_owned();
        let made = access_control("csi5300/lab", &owners, Some(std::slice::from_ref(&key))).unwrap();
        let put = |rule: &&Value| rule["messages"] == json!(["put"]) && rule["flows"] == json!(["ingress"]);
        let keys: Vec<&Value> =
            made["rules"].as_array().unwrap().iter().filter(put).map(|rule| &rule["key_exprs"]).collect();
        assert_eq!(keys[2..], [&json!([key])]);
        assert_eq!(made["policies"][1]["rules"], json!(["ask", "send", "00216a000002", "graph", "topics"]));
    }
}
