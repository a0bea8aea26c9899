//! What comes from a writer before the DDS library knows the writer.
//!
//! A peer that has found a reader of ours may send at once. The library reads the announcement of
//! its writer from another socket, and drops what came before it. A reliable writer repeats what
//! was not acknowledged, but Fast DDS only after its heartbeat period of 3 s: a first message or a
//! call of a service took that long (`docs/upstream/acknowledgement-of-a-match.md`).
//!
//! So the last datagrams of unknown writers are kept, and sent to the same socket again, over
//! loopback, when the library has matched the writer. UDP may deliver late and twice; RTPS is made
//! for that. The library takes a peer that sends from loopback for one of this machine, so each of
//! them is [wrapped] for its way, and [unwrapped] with the address that it came from.
//!
//! [wrapped]: wrap
//! [unwrapped]: unwrap

use std::collections::{HashSet, VecDeque};
use std::hash::{BuildHasher as _, RandomState};
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use rustdds::GUID;

/// How long a datagram is kept: then the writer repeats it. The heartbeat period of Fast DDS.
const KEPT: Duration = Duration::from_secs(3);
/// Datagrams that are kept at most, those of one writer, and their bytes.
const MOST: usize = 64;
const MOST_OF_ONE: usize = 8;
const MOST_BYTES: usize = 1 << 20;

/// Where a datagram came from: a `sockaddr_in`.
pub type Source = [u8; size_of::<libc::sockaddr_in>()];

/// What a wrapped datagram begins with: only this process knows it.
static TOKEN: LazyLock<[u8; 16]> = LazyLock::new(|| {
    let random = |_| RandomState::new().hash_one(0_u8).to_ne_bytes();
    let [a, b] = [0, 1].map(random);
    std::array::from_fn(|k| if k < 8 { a[k] } else { b[k - 8] })
});

fn wrap(early: &Early) -> Vec<u8> {
    [&TOKEN[..], &early.source, &early.bytes].concat()
}

/// The source of a datagram that this process has wrapped, and how many bytes are before it.
pub fn unwrap(datagram: &[u8]) -> Option<(Source, usize)> {
    let rest = datagram.strip_prefix(TOKEN.as_slice())?;
    Some((*rest.first_chunk()?, TOKEN.len() + size_of::<Source>()))
}

/// A datagram that came too early.
struct Early {
    writer: GUID,
    /// Of the socket that it came to.
    port: u16,
    source: Source,
    bytes: Vec<u8>,
    came: Instant,
}

/// Writers that the library has matched, and what came from others.
#[derive(Default)]
struct Arrivals {
    matched: HashSet<GUID>,
    early: VecDeque<Early>,
}

impl Arrivals {
    fn keep(&mut self, early: Early) {
        let now = early.came;
        let of_writer = |one: &Early| one.writer == early.writer;
        if self.early.iter().filter(|one| of_writer(one)).count() >= MOST_OF_ONE
            && let Some(first) = self.early.iter().position(of_writer)
        {
            self.early.remove(first);
        }
        self.early.push_back(early);
        let bytes = |all: &VecDeque<Early>| all.iter().map(|one| one.bytes.len()).sum::<usize>();
        while self.early.front().is_some_and(|first| now.duration_since(first.came) > KEPT)
            || self.early.len() > MOST
            || bytes(&self.early) > MOST_BYTES
        {
            self.early.pop_front();
        }
    }

    /// The datagrams of a writer that is matched now, in the order in which they came.
    fn take(&mut self, writer: GUID, now: Instant) -> Vec<Early> {
        self.matched.insert(writer);
        let (taken, others): (Vec<Early>, Vec<Early>) =
            self.early.drain(..).partition(|early| early.writer == writer);
        self.early = others.into();
        taken.into_iter().filter(|early| now.duration_since(early.came) <= KEPT).collect()
    }
}

static ARRIVALS: Mutex<Option<Arrivals>> = Mutex::new(None);

fn arrivals() -> MutexGuard<'static, Option<Arrivals>> {
    ARRIVALS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Keeps a datagram that is for a socket of this process, if the library does not know its writer.
/// `port` says to which port the socket is bound.
pub fn keep(writer: GUID, bytes: &[u8], source: Source, port: impl FnOnce() -> Option<u16>) {
    let mut arrivals = arrivals();
    let arrivals = arrivals.get_or_insert_default();
    if arrivals.matched.contains(&writer) {
        return;
    }
    if let Some(port) = port() {
        let (bytes, came) = (bytes.to_vec(), Instant::now());
        arrivals.keep(Early { writer, port, source, bytes, came });
    }
}

/// The library has matched a writer with a reader of this process: what came before is sent again.
pub fn matched(writer: GUID) {
    let early = arrivals().get_or_insert_default().take(writer, Instant::now());
    if early.is_empty() {
        return;
    }
    // Without a socket the writer repeats it.
    let Ok(socket) = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)) else { return };
    for early in early {
        let to = SocketAddr::from((Ipv4Addr::LOCALHOST, early.port));
        let _ = socket.send_to(&wrap(&early), to);
    }
}

/// Writers that are no longer there are forgotten.
pub fn lost(is_lost: impl Fn(&GUID) -> bool) {
    if let Some(arrivals) = arrivals().as_mut() {
        arrivals.matched.retain(|writer| !is_lost(writer));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn guid(writer: u8) -> GUID {
        GUID::from_bytes([writer; 16])
    }

    fn early(writer: u8, size: usize, came: Instant) -> Early {
        let bytes = vec![writer; size];
        Early { writer: guid(writer), port: 7, source: [9; 16], bytes, came }
    }

    #[test]
    fn what_came_before_the_match_is_given_once_in_its_order() {
        let mut arrivals = Arrivals::default();
        let now = Instant::now();
        for (writer, size) in [(1, 10), (2, 11), (1, 12)] {
            arrivals.keep(early(writer, size, now));
        }
        let sizes = |taken: Vec<Early>| taken.iter().map(|e| e.bytes.len()).collect::<Vec<_>>();
        assert_eq!(sizes(arrivals.take(guid(1), now)), [10, 12]);
        assert!(arrivals.matched.contains(&guid(1)));
        assert!(arrivals.take(guid(1), now).is_empty());
        assert_eq!(sizes(arrivals.take(guid(2), now)), [11]);
    }

    #[test]
    fn a_wrapped_datagram_has_its_source_and_others_are_none() {
        let early = early(3, 100, Instant::now());
        let wrapped = wrap(&early);
        let (source, before) = unwrap(&wrapped).unwrap();
        assert_eq!((source, &wrapped[before..]), (early.source, &early.bytes[..]));
        for datagram in [&wrapped[1..], &wrapped[..20], &early.bytes, &[]] {
            assert!(unwrap(datagram).is_none());
        }
    }

    #[test]
    fn what_is_kept_is_bounded() {
        let mut arrivals = Arrivals::default();
        let now = Instant::now();
        arrivals.keep(early(0, 1, now));
        (0..1000).for_each(|_| arrivals.keep(early(1, 100, now)));
        // A flood of one pushes no other out.
        assert_eq!(arrivals.early.len(), 1 + MOST_OF_ONE);
        assert_eq!(arrivals.early[0].writer, guid(0));
        (0..1000).for_each(|k| arrivals.keep(early(k as u8, 100, now)));
        assert_eq!(arrivals.early.len(), MOST);
        (0..40).for_each(|k| arrivals.keep(early(k, 60_000, now)));
        assert!(arrivals.early.iter().map(|one| one.bytes.len()).sum::<usize>() <= MOST_BYTES);
        // Old ones go, and are not given.
        let later = now + KEPT + Duration::from_millis(1);
        arrivals.keep(early(2, 1, later));
        assert_eq!(arrivals.early.len(), 1);
        assert!(arrivals.take(guid(2), later + KEPT + KEPT).is_empty());
    }
}
