//! Admits requests of this page in a browser on this machine, but not requests that other pages cause.
//!
//! A page of the web can make a browser ask a server on localhost, by its number or by a name of the page's own that
//! resolves to it (DNS rebinding). The browser then says another `Host`, `Origin` or `Sec-Fetch-Site` than this page's.

use std::net::{IpAddr, SocketAddr};

/// Why a request is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum Refused {
    /// It names no host, or one by a name.
    #[error("this page is at an address in numbers or at localhost, not at this host")]
    Host,
    /// It comes from another page.
    #[error("another page may not look here")]
    Origin,
    /// It wants to do something.
    #[error("there is nothing to do here but to look (GET)")]
    Method,
}

impl Refused {
    pub fn status(self) -> u16 {
        match self {
            Self::Method => 405,
            Self::Host | Self::Origin => 403,
        }
    }
}

/// What a request says of itself.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Asked<'a> {
    pub method: &'a str,
    pub host: Option<&'a str>,
    pub origin: Option<&'a str>,
    pub fetch_site: Option<&'a str>,
}

/// Admits a request to `listening`, or returns why not.
pub(crate) fn admit(listening: SocketAddr, asked: Asked<'_>) -> Result<(), Refused> {
    if !matches!(asked.method, "GET" | "HEAD") {
        return Err(Refused::Method);
    }
    let host = asked.host.ok_or(Refused::Host)?;
    if !is_own(listening, host) {
        return Err(Refused::Host);
    }
    let own = asked.origin.is_none_or(|origin| origin.strip_prefix("http://") == Some(host));
    let same = asked.fetch_site.is_none_or(|site| matches!(site, "same-origin" | "none"));
    if own && same { Ok(()) } else { Err(Refused::Origin) }
}

/// True for `localhost` and for addresses in numbers; where only this machine is listened to, for its own only. Any port:
/// a tunnel has another.
fn is_own(listening: SocketAddr, host: &str) -> bool {
    let name = match host.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or_default(),
        None => host.split(':').next().unwrap_or_default(),
    };
    match name.parse::<IpAddr>() {
        Ok(address) => address.is_loopback() || !listening.ip().is_loopback(),
        Err(_) => name.eq_ignore_ascii_case("localhost"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ask(listening: &str, asked: Asked<'_>) -> Result<(), Refused> {
        admit(listening.parse().unwrap(), Asked { method: "GET", ..asked })
    }

    #[test]
    fn only_numbers_and_localhost_are_this_page() {
        let host = |name| Asked { host: Some(name), ..Asked::default() };
        for name in ["127.0.0.1:8080", "localhost:8080", "LocalHost", "[::1]:8080", "127.0.0.1:9000"] {
            assert_eq!(ask("127.0.0.1:8080", host(name)), Ok(()), "{name}");
        }
        for name in
            ["evil.example:8080", "localhost.evil.example", "127.0.0.1.evil.example", "", "[::1", "10.0.0.7:8080"]
        {
            let expected = if name == "[::1" { Ok(()) } else { Err(Refused::Host) };
            assert_eq!(ask("127.0.0.1:8080", host(name)), expected, "{name}");
        }
        assert_eq!(ask("127.0.0.1:8080", Asked::default()), Err(Refused::Host));
        assert_eq!(ask("10.0.0.7:8080", host("10.0.0.7:8080")), Ok(()));
        assert_eq!(ask("10.0.0.7:8080", host("robot.example:8080")), Err(Refused::Host));
    }

    #[test]
    fn another_page_may_neither_read_nor_embed() {
        let from = |origin, fetch_site| Asked { host: Some("127.0.0.1:8080"), origin, fetch_site, ..Asked::default() };
        assert_eq!(ask("127.0.0.1:8080", from(Some("http://127.0.0.1:8080"), Some("same-origin"))), Ok(()));
        assert_eq!(ask("127.0.0.1:8080", from(None, Some("none"))), Ok(()));
        for (origin, site) in [
            (Some("http://evil.example"), None),
            (Some("null"), None),
            (Some("https://127.0.0.1:8080"), None),
            (None, Some("cross-site")),
            (None, Some("same-site")),
        ] {
            assert_eq!(ask("127.0.0.1:8080", from(origin, site)), Err(Refused::Origin), "{origin:?} {site:?}");
        }
    }

    #[test]
    fn nothing_can_be_done() {
        for method in ["POST", "PUT", "DELETE", "OPTIONS", "CONNECT"] {
            let asked = Asked { method, host: Some("localhost"), ..Asked::default() };
            assert_eq!(admit("127.0.0.1:1".parse().unwrap(), asked), Err(Refused::Method));
        }
    }
}
