//! The network interfaces of this machine, as the DDS library asks for them.
//!
//! In goes what the operating system tells; out come index, addresses and kind of each interface,
//! and [`DATAGRAM`] as the MTU of all of them. Why: the README of this crate.

#![warn(missing_docs)]

use std::collections::BTreeMap;
use std::net::IpAddr;

use ipnet::{Ipv4Net, Ipv6Net};
use nix::ifaddrs::{InterfaceAddress, getifaddrs};
use nix::net::if_::{InterfaceFlags, if_nametoindex};
use nix::sys::socket::SockaddrStorage;

/// The largest packet that the library puts together, in bytes with the headers of IP and UDP. The
/// longest answer of these nodes fits twice: the descriptions of all parameters of the controller.
/// No larger than needed: a lost frame loses the whole packet.
pub const DATAGRAM: u32 = 16_384;

/// A network interface.
#[derive(Clone, Debug)]
pub struct Interface {
    /// Number of the interface, 0 where it is not known.
    pub index: u32,
    /// Addresses and networks.
    pub ipv4: Vec<Ipv4Net>,
    /// Addresses and networks.
    pub ipv6: Vec<Ipv6Net>,
    /// Always [`DATAGRAM`].
    pub mtu: Option<u32>,
    flags: InterfaceFlags,
}

impl Interface {
    /// Whether it leads back to this machine.
    pub fn is_loopback(&self) -> bool {
        self.flags.contains(InterfaceFlags::IFF_LOOPBACK)
    }

    /// Whether it carries multicast.
    pub fn is_multicast(&self) -> bool {
        self.flags.contains(InterfaceFlags::IFF_MULTICAST)
    }
}

/// All interfaces that have an address; none where the system does not tell.
pub fn get_interfaces() -> Vec<Interface> {
    let mut interfaces = BTreeMap::new();
    for address in getifaddrs().into_iter().flatten() {
        let interface =
            interfaces.entry(address.interface_name.clone()).or_insert_with(|| Interface {
                index: if_nametoindex(address.interface_name.as_str()).unwrap_or(0),
                ipv4: Vec::new(),
                ipv6: Vec::new(),
                mtu: Some(DATAGRAM),
                flags: address.flags,
            });
        match network(&address) {
            Some((IpAddr::V4(ip), IpAddr::V4(mask))) => {
                interface.ipv4.extend(Ipv4Net::with_netmask(ip, mask));
            }
            Some((IpAddr::V6(ip), IpAddr::V6(mask))) => {
                interface.ipv6.extend(Ipv6Net::with_netmask(ip, mask));
            }
            _ => {}
        }
    }
    interfaces.into_values().filter(|it| !it.ipv4.is_empty() || !it.ipv6.is_empty()).collect()
}

/// Address and mask.
fn network(address: &InterfaceAddress) -> Option<(IpAddr, IpAddr)> {
    Some((ip(address.address.as_ref()?)?, ip(address.netmask.as_ref()?)?))
}

fn ip(address: &SockaddrStorage) -> Option<IpAddr> {
    let v4 = address.as_sockaddr_in().map(|it| IpAddr::from(it.ip()));
    v4.or_else(|| address.as_sockaddr_in6().map(|it| IpAddr::from(it.ip())))
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;

    use super::*;

    #[test]
    fn the_loopback_interface_is_found_with_its_network() {
        let interfaces = get_interfaces();
        let loopback = interfaces.iter().find(|it| it.is_loopback()).expect("loopback");
        assert!(loopback.ipv4.iter().any(|it| it.addr() == Ipv4Addr::LOCALHOST));
        assert!(loopback.ipv4.iter().all(|it| it.netmask() == Ipv4Addr::new(255, 0, 0, 0)));
        assert_ne!(loopback.index, 0);
    }
}
