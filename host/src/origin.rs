//! Who a request comes from, and whom it asks for: what a browser says in `Origin` and `Host`, and no page of somebody else's can
//! change. What is served on this machine is held against it: any page that is open here may send requests here.

use std::net::IpAddr;

/// The name or address in a `Host`, without its port.
pub fn name_of(host: &str) -> String {
    let name = match host.strip_prefix('[') {
        Some(six) => six.split(']').next(),
        None => host.split(':').next(),
    };
    name.unwrap_or_default().to_ascii_lowercase()
}

/// Whether a name or address is this machine's own whoever asks. Names that were bound to this machine's address after the
/// fact (DNS rebinding) are none of these.
pub fn is_this_machine(name: &str) -> bool {
    name.parse::<IpAddr>().map_or(name == "localhost", |address| address.is_loopback())
}

/// The host, with its port, that a page of this `Origin` came from; none where it came from no host.
pub fn host_of(origin: &str) -> Option<&str> {
    origin.strip_prefix("http://").or(origin.strip_prefix("https://"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_only_look_like_this_machine_are_not() {
        for (host, is_here) in [
            ("127.0.0.1:8080", true),
            ("LOCALHOST", true),
            ("[::1]:8080", true),
            ("127.0.0.1.example.org", false),
            ("localhost.example.org:8080", false),
            ("192.0.2.7:8080", false),
            ("[2001:db8::1]", false),
            ("", false),
        ] {
            assert_eq!(is_this_machine(&name_of(host)), is_here, "{host:?}");
        }
        assert_eq!(host_of("https://bench:8080"), Some("bench:8080"));
        assert_eq!((host_of("null"), host_of("file://")), (None, None));
    }
}
