//! Who can join the robots' network, by its endpoints and authentication, and who may publish as a peer, by zenoh's access control.
//!
//! Zenoh judges a message by its link, so a robot with a named certificate must be linked directly, without a router.

use driver_iface::Mac;
use serde_json::{Value, json};
use std::path::PathBuf;

/// Local endpoints, for a network without authentication.
pub(crate) const LOCAL: &str = "tcp/127.0.0.1:0";

/// Settings of an endpoint that do not affect who may connect; the empty one too.
const HARMLESS: [&str; 5] = ["", "iface", "bind", "so_sndbuf", "so_rcvbuf"];

/// The parts of zenoh's configuration that decide who may join.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Doors {
    /// Endpoints on which it listens, if any are named.
    pub listen: Option<Vec<String>>,
    /// Endpoints to which it connects.
    pub connect: Vec<String>,
    /// The file with users and their passwords.
    pub users: Option<PathBuf>,
    /// Both ends of TLS show a certificate.
    pub has_certificates: bool,
    /// Its file has an access control of its own.
    pub has_rules: bool,
}

/// The consequence.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// Members need a password or a certificate, or only local programs can join.
    Good,
    /// Without authentication and endpoints: on [`LOCAL`], without discovery.
    KeepLocal,
    /// Anybody who reaches this endpoint can join.
    Open(String),
}

impl Doors {
    /// Judges them.
    pub(crate) fn judge(&self) -> Verdict {
        let all: Vec<&String> = self.listen.iter().flatten().chain(&self.connect).collect();
        let by_certificate = self.has_certificates
            && !all.is_empty()
            && self.listen.is_some()
            && all.iter().all(|one| is_encrypted(one));
        if self.users.is_some() || by_certificate {
            return Verdict::Good;
        }
        match &self.listen {
            None => Verdict::KeepLocal,
            Some(listen) => match listen.iter().find(|endpoint| !is_local(endpoint)) {
                Some(open) => Verdict::Open(open.clone()),
                None => Verdict::KeepLocal,
            },
        }
    }
}

/// True for a TLS endpoint with the file's settings: settings after `#` could weaken them.
fn is_encrypted(endpoint: &str) -> bool {
    let (address, settings) = endpoint.split_once('#').unwrap_or((endpoint, ""));
    let is_harmless = |setting: &str| HARMLESS.contains(&setting.split('=').next().unwrap_or_default());
    ["tls/", "quic/"].iter().any(|scheme| address.starts_with(scheme)) && settings.split(';').all(is_harmless)
}

/// True for an endpoint that only local programs reach, such as `tcp/127.0.0.1:7447`.
fn is_local(endpoint: &str) -> bool {
    let Some((scheme, rest)) = endpoint.split_once('/') else { return false };
    if scheme.starts_with("unixsock") || scheme == "unixpipe" {
        return true;
    }
    // Behind the address there may be metadata (`?`) and settings (`#`).
    let address = rest.split(['?', '#']).next().unwrap_or_default();
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    let host = host.trim_start_matches('[').trim_end_matches(']');
    host.parse::<std::net::IpAddr>().is_ok_and(|ip| ip.is_loopback())
}

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
pub(crate) struct Owner {
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
    let allowed = |id: &str, flows: &[&str], messages: &[&str], keys: &[String]| json!({ "id": id, "permission": "allow", "flows": flows, "messages": messages, "key_exprs": keys });
    let all = ["**".to_owned()];
    let mut rules = vec![
        allowed("ask", &["ingress", "egress"], &ASKING, &all),
        allowed("send", &["egress"], &["put", "delete"], &all),
    ];
    let (mut subjects, mut policies) = (vec![json!({ "id": "anybody" })], Vec::new());
    let mut open = vec![json!("ask"), json!("send")];
    for owner in owners {
        let key = key_of(owner.mac);
        rules.push(allowed(&key, &["ingress"], &["put"], &[format!("{prefix}/{key}/**")]));
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
        let graph = ["@ros2_lv/**", "**/@adv/**"].map(str::to_owned);
        rules.push(allowed("graph", &["ingress", "egress"], &ASKING, &graph));
        open.push(json!("graph"));
        if !keys.is_empty() {
            rules.push(allowed("topics", &["ingress"], &["put"], keys));
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

    fn doors(listen: Option<&[&str]>, connect: &[&str]) -> Doors {
        let owned = |endpoints: &[&str]| endpoints.iter().map(|one| (*one).to_owned()).collect::<Vec<_>>();
        Doors { listen: listen.map(owned), connect: owned(connect), ..Doors::default() }
    }

    #[test]
    fn only_this_machine_is_local() {
        for local in [
            "tcp/127.0.0.1:0",
            "tcp/127.8.0.1:7447",
            "tcp/[::1]:7447",
            "unixsock-stream//run/z",
            "udp/127.0.0.1:1#iface=lo",
        ] {
            assert!(is_local(local), "{local}");
        }
        // A name may resolve to any address.
        for open in [
            "tcp/0.0.0.0:7447",
            "tcp/[::]:0",
            "tcp/10.0.0.1:7447",
            "tls/burger:7447",
            "tcp/localhost:1",
            "",
            "tcp",
            "tcp/",
        ] {
            assert!(!is_local(open), "{open}");
        }
    }

    #[test]
    fn an_open_network_is_reported_and_a_closed_one_is_not() {
        let all = "tcp/0.0.0.0:7447";
        assert_eq!(doors(None, &[]).judge(), Verdict::KeepLocal);
        assert_eq!(
            doors(None, &["tcp/10.0.0.1:7447"]).judge(),
            Verdict::KeepLocal,
            "peers that are named may be asked"
        );
        assert_eq!(doors(Some(&["tcp/127.0.0.1:7447"]), &[]).judge(), Verdict::KeepLocal);
        assert_eq!(doors(Some(&["tcp/127.0.0.1:1", all]), &[]).judge(), Verdict::Open(all.into()));
        let with_users = Doors { users: Some("users".into()), ..doors(Some(&[all]), &[]) };
        assert_eq!(with_users.judge(), Verdict::Good);
        let tls = |listen: &[&str], connect: &[&str]| Doors { has_certificates: true, ..doors(Some(listen), connect) };
        assert_eq!(tls(&["tls/0.0.0.0:7447"], &["quic/10.0.0.1:1"]).judge(), Verdict::Good);
        assert_eq!(tls(&["tls/0.0.0.0:7447", all], &[]).judge(), Verdict::Open("tls/0.0.0.0:7447".into()));
        assert_eq!(tls(&["tls/0.0.0.0:7447#iface=lo;so_rcvbuf=9"], &[]).judge(), Verdict::Good);
        for open in ["tls/0.0.0.0:7447#enable_mtls=false", "quic/0.0.0.0:1#iface=lo;verify_name_on_connect=false"] {
            assert_eq!(tls(&[open], &[]).judge(), Verdict::Open(open.into()));
        }
        let unsaid = Doors { has_certificates: true, ..doors(None, &["tls/10.0.0.1:1"]) };
        assert_eq!(unsaid.judge(), Verdict::KeepLocal, "it would listen without TLS");
    }

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
