//! Determines who can join the robots' network, by its endpoints and authentication.

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
}
