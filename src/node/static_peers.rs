//! Machines that the user names (`ROS_STATIC_PEERS`), where multicast does not pass.
//!
//! A participant announces itself by multicast, and the DDS library cannot send its announcements
//! elsewhere. They come back to this process over the loopback of multicast: the
//! [socket filter](super::socket_filter) hands them to [`pass_on`], and each is sent to the ports
//! at which a participant of a named machine may listen (DDSI-RTPS 2.5, 9.6.2.3). Who hears one
//! answers to the addresses in it ([beyond multicast](super::beyond_multicast)), and both have
//! found each other.

use std::collections::VecDeque;
use std::net::{IpAddr, Ipv4Addr, SocketAddrV4, ToSocketAddrs as _, UdpSocket};
use std::sync::{Mutex, MutexGuard, PoisonError};

use rustdds::GUID;
use thiserror::Error;

/// Participants of one machine that are reached, as many as rmw_fastrtps and rmw_cyclonedds try.
const PARTICIPANTS: u16 = 32;
/// The last announcements of others that are kept.
const MOST_KEPT: usize = 16;

/// A machine of `ROS_STATIC_PEERS` that cannot be found.
#[derive(Debug, Error)]
#[error(
    "ROS_STATIC_PEERS names \"{peer}\", which {reason}: it must be IPv4 addresses or host names, \
     with a semicolon between two of them"
)]
pub struct PeerError {
    peer: String,
    reason: String,
}

/// The first 12 bytes of every GUID of a participant.
type Prefix = [u8; 12];

fn prefix_of(participant: GUID) -> Prefix {
    participant.to_bytes()[..12].try_into().expect("a GUID has 16 bytes")
}

/// Announcements that may be lost on the way back to this process. One whose number is farther from
/// the last is not of this process.
const LARGEST_STEP: u64 = 1000;

/// What is sent on, and to whom.
struct Relay {
    peers: Vec<Peer>,
    own: Vec<Own>,
    /// The last announcements of others: a participant announces itself before this process knows
    /// that it is its own.
    kept: VecDeque<(Prefix, u64, Vec<u8>)>,
}

/// A participant of this process.
struct Own {
    prefix: Prefix,
    /// Number of the last announcement that was sent on. One comes through each network interface,
    /// and again where a named machine is this one.
    last: u64,
}

struct Peer {
    /// Of its own: what waits for a machine that does not answer takes no room from the others.
    socket: UdpSocket,
    address: Ipv4Addr,
    ports: Vec<u16>,
    is_reached: bool,
}

static RELAY: Mutex<Option<Relay>> = Mutex::new(None);

fn relay() -> MutexGuard<'static, Option<Relay>> {
    RELAY.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The machines in `names`, as in `192.168.1.7;robot.local`.
///
/// # Errors
/// [`PeerError`] for one that is no address and no host with one.
pub fn resolve(names: &str) -> Result<Vec<Ipv4Addr>, PeerError> {
    let names = names.split(';').map(str::trim).filter(|name| !name.is_empty());
    let all: Result<Vec<_>, _> = names.map(addresses_of).collect();
    Ok(all?.concat())
}

fn addresses_of(name: &str) -> Result<Vec<Ipv4Addr>, PeerError> {
    let wrong = |reason: String| PeerError { peer: name.to_owned(), reason };
    let addresses =
        (name, 0).to_socket_addrs().map_err(|error| wrong(format!("has no address ({error})")))?;
    let ipv4 = addresses.filter_map(|address| match address.ip() {
        IpAddr::V4(address) => Some(address),
        IpAddr::V6(_) => None,
    });
    let ipv4: Vec<_> = ipv4.collect();
    if ipv4.is_empty() { Err(wrong("has no IPv4 address".to_owned())) } else { Ok(ipv4) }
}

/// From now on the participants of this process in `domain` are announced to `peers`, too. To be
/// called before one is made.
///
/// # Errors
/// There is no socket for it.
pub fn announce_to(peers: &[Ipv4Addr], domain: u16) -> std::io::Result<()> {
    if peers.is_empty() {
        return Ok(());
    }
    let ports = |participant: u16| 7410_u16.checked_add(250 * domain)?.checked_add(2 * participant);
    let ports: Vec<u16> = (0..PARTICIPANTS).map_while(ports).collect();
    let peer = |&address: &Ipv4Addr| -> std::io::Result<Peer> {
        let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
        socket.set_nonblocking(true)?;
        Ok(Peer { socket, address, ports: ports.clone(), is_reached: true })
    };
    let peers = peers.iter().map(peer).collect::<Result<_, _>>()?;
    *relay() = Some(Relay { peers, own: Vec::new(), kept: VecDeque::new() });
    Ok(())
}

/// `participant` is of this process.
pub fn add(participant: GUID) {
    if let Some(relay) = &mut *relay() {
        relay.own.push(Own { prefix: prefix_of(participant), last: 0 });
        for (from, number, datagram) in std::mem::take(&mut relay.kept) {
            relay.pass_on(from, number, &datagram);
        }
    }
}

/// `participant` leaves. Who has found it learns that from the library.
pub fn remove(participant: GUID) {
    if let Some(relay) = &mut *relay() {
        let prefix = prefix_of(participant);
        relay.own.retain(|own| own.prefix != prefix);
    }
}

/// A datagram with announcement `number` of the participant `from` has come.
pub fn pass_on(from: [u8; 12], number: u64, datagram: &[u8]) {
    if let Some(relay) = &mut *relay()
        && !relay.pass_on(from, number, datagram)
    {
        relay.kept.push_back((from, number, datagram.to_vec()));
        relay.kept.drain(..relay.kept.len().saturating_sub(MOST_KEPT));
    }
}

impl Relay {
    /// Whether it is from a participant of this process.
    fn pass_on(&mut self, from: Prefix, number: u64, datagram: &[u8]) -> bool {
        let Some(own) = self.own.iter_mut().find(|own| own.prefix == from) else { return false };
        if number > own.last && number - own.last <= LARGEST_STEP {
            own.last = number;
            self.send(datagram);
        }
        true
    }

    fn send(&mut self, datagram: &[u8]) {
        for peer in &mut self.peers {
            let to = |&port| peer.socket.send_to(datagram, SocketAddrV4::new(peer.address, port));
            let failure = peer
                .ports
                .iter()
                .filter_map(|port| to(port).err())
                .fold(None, |_, error| Some(error));
            if let (true, Some(error)) = (peer.is_reached, &failure) {
                tracing::warn!("cannot reach {} of ROS_STATIC_PEERS: {error}", peer.address);
            }
            peer.is_reached = failure.is_none();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_name_without_an_address_is_named() {
        assert_eq!(resolve(" 10.0.0.1; ;127.0.0.1").unwrap().len(), 2);
        for names in ["10.0.0.1;no host", "::1"] {
            let error = resolve(names).unwrap_err().to_string();
            let name = names.split(';').next_back().unwrap();
            assert!(error.starts_with(&format!("ROS_STATIC_PEERS names \"{name}\"")), "{error}");
        }
    }

    #[test]
    fn an_announcement_of_this_process_is_sent_on_once() {
        const MACHINE: Ipv4Addr = Ipv4Addr::new(127, 0, 77, 1);
        let participant = |id: u8| GUID::from_bytes([id; 16]);
        let last_port = UdpSocket::bind((MACHINE, 7410 + 250 * 5 + 2 * (PARTICIPANTS - 1)));
        let listener = last_port.unwrap();
        listener.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        let heard = || {
            let mut buffer = [0; 16];
            let length = listener.recv(&mut buffer).expect("a datagram");
            buffer[..length].to_vec()
        };
        announce_to(&[MACHINE], 5).unwrap();
        // It comes before this process knows its participant, and those of others are none of it.
        pass_on([1; 12], 1, b"first");
        pass_on([2; 12], 1, b"of another");
        add(participant(1));
        assert_eq!(heard(), b"first");
        pass_on([1; 12], 1, b"first");
        pass_on([2; 12], 2, b"of another");
        // With a number that ours does not reach for long, ours would not be sent on until then.
        pass_on([1; 12], 2 + LARGEST_STEP, b"forged");
        pass_on([1; 12], 2, b"second");
        assert_eq!(heard(), b"second");
        remove(participant(1));
        pass_on([1; 12], 3, b"third");
        add(participant(3));
        pass_on([3; 12], 1, b"of a later one");
        assert_eq!(heard(), b"of a later one");
        *relay() = None;
    }
}
