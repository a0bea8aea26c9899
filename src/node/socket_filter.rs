//! What of the network reaches the DDS library.
//!
//! In goes every datagram that this process receives with [`recvmsg`]; out come those that do no
//! harm. The library trusts the counts in a datagram: a few bytes can reserve 4 GiB or occupy its
//! thread for good, and its sockets listen on every interface whatever the reach. So it does not
//! see
//! - with [`Reach::Localhost`], what did not come through the loopback interface;
//! - a message that ends within a submessage;
//! - sequence numbers from 2^40, which take 4 years at 8 kHz;
//! - HEARTBEAT and GAP over more than [`LARGEST_WINDOW`] samples, except a GAP from the first one;
//! - fragments of samples of [`LARGEST_SAMPLE`] bytes or more, and requests for fragments that such
//!   a sample does not have.
//!
//! One such submessage drops its whole datagram.
//!
//! One thing it sees changed: every announcement of a participant has a sequence number of its own.
//! A participant announces itself with one sample, again and again (DDSI-RTPS 2.5, 8.5.3.3), and
//! the library takes a number once. One whose lease has ended, since it was stopped in a debugger
//! or its announcements were lost, would never be found again.
//!
//! What comes before its writer is known is [kept](early) and delivered again.
//!
//! Announcements of this process are [passed on](static_peers::pass_on) to machines that the user
//! names.
//!
//! What subscribers acknowledge passes here as well, and the library does not say it: whoever
//! [asks](on_acknowledgement) learns of it.
//!
//! The layout of the submessages: DDSI-RTPS 2.5,
//! 9.4.5. Why here and not in the kernel: `docs/decisions/0012-strangers.md`.

use std::io;
use std::net::Ipv4Addr;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, LazyLock, Mutex, MutexGuard, PoisonError, Weak};

use rustdds::GUID;

use super::beyond_multicast;
use super::early;
use super::qos::LARGEST_WINDOW;
use super::reach::Reach;
use super::static_peers;

/// Samples of this serialised size, in bytes, are not heard in fragments.
pub const LARGEST_SAMPLE: usize = 1 << 20;
/// Sequence numbers that a peer may reach.
const LARGEST_NUMBER: u64 = 1 << 40;
/// Number of a fragment that a request may begin with: a sample has fewer.
const LARGEST_FRAGMENT: u32 = 1 << 16;

/// Index of the only interface that is heard, 0 for all of them.
static INTERFACE: AtomicU32 = AtomicU32::new(0);

/// Index of the loopback interface.
static LOOPBACK: LazyLock<Option<u32>> = LazyLock::new(|| loopback().ok());

/// Announcements of participants that have come.
static ANNOUNCEMENTS: AtomicU64 = AtomicU64::new(0);

/// A subscriber has every sample of a publisher below a number (DDSI-RTPS 2.5, 8.3.8.1, ACKNACK).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Acknowledgement {
    pub reader: GUID,
    pub writer: GUID,
    /// The first sample that it may miss; they count from 1.
    pub first_missing: u64,
}

type Listener = dyn Fn(Acknowledgement) + Send + Sync;

static LISTENERS: Mutex<Vec<Weak<Listener>>> = Mutex::new(Vec::new());

/// Calls `listener` with every acknowledgement that comes, until the result is dropped. On the
/// thread that receives: it has to be quick.
#[must_use]
pub fn on_acknowledgement(
    listener: impl Fn(Acknowledgement) + Send + Sync + 'static,
) -> Arc<Listener> {
    let listener: Arc<Listener> = Arc::new(listener);
    let mut listeners = listeners();
    listeners.retain(|listener| listener.strong_count() > 0);
    listeners.push(Arc::downgrade(&listener));
    listener
}

fn listeners() -> MutexGuard<'static, Vec<Weak<Listener>>> {
    LISTENERS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Hears this far from now on, in the whole process. To be called before a participant is made.
///
/// # Errors
/// There is no loopback interface, or the program was linked so that the library does not call
/// [`recvmsg`] here.
pub fn hear(reach: Reach) -> io::Result<()> {
    let called = libc::recvmsg as *const ();
    let ours = recvmsg as *const ();
    if called != ours {
        return Err(io::Error::other("the C library's recvmsg is called, not the filter"));
    }
    let interface = match reach {
        Reach::Localhost => loopback()?,
        Reach::Subnet => 0,
    };
    INTERFACE.store(interface, Ordering::Relaxed);
    Ok(())
}

/// Index of the loopback interface.
fn loopback() -> io::Result<u32> {
    // SAFETY: the name ends with a zero.
    match unsafe { libc::if_nametoindex(c"lo".as_ptr()) } {
        0 => Err(io::Error::last_os_error()),
        index => Ok(index),
    }
}

/// Takes the place of the function of the C library that the DDS library reads its sockets with:
/// the same, but skips RTPS messages that do harm.
///
/// # Safety
/// As for recvmsg(2).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn recvmsg(
    socket: libc::c_int,
    message: *mut libc::msghdr,
    flags: libc::c_int,
) -> libc::ssize_t {
    // SAFETY: the caller's `message` is one.
    let asked = unsafe { message.read() };
    loop {
        // SAFETY: the arguments are the caller's.
        let received = unsafe { libc::syscall(libc::SYS_recvmsg, socket, message, flags) };
        let Ok(length) = usize::try_from(received) else { return received as libc::ssize_t };
        if asked.msg_iovlen != 1 {
            return received as libc::ssize_t;
        }
        // SAFETY: the kernel has filled in `message`, and up to `length` bytes of its first buffer.
        if let Some(heard) = unsafe { take(socket, &*message, length) } {
            return heard as libc::ssize_t;
        }
        // SAFETY: as above. The kernel shortens the lengths to what there was.
        unsafe { message.write(asked) };
    }
}

/// How many bytes of a datagram the library sees, if any; numbers its announcements.
///
/// # Safety
/// `message` is what recvmsg(2) has filled in, with one buffer that holds `length` bytes, or fewer
/// where the datagram was cut off.
unsafe fn take(socket: libc::c_int, message: &libc::msghdr, length: usize) -> Option<usize> {
    // SAFETY: see above; no other code has the buffer until recvmsg(2) returns.
    let datagram = unsafe {
        let buffer = *message.msg_iov;
        std::slice::from_raw_parts_mut(buffer.iov_base.cast::<u8>(), length.min(buffer.iov_len))
    };
    if let Some((source, before)) = early::unwrap(datagram) {
        if let Some(place) = place_of_source(message) {
            // SAFETY: the caller of recvmsg(2) has given this place for it.
            unsafe { place.write(source) };
        }
        datagram.copy_within(before.., 0);
        return Some(length - before);
    }
    if !datagram.starts_with(b"RTPS") {
        return Some(length);
    }
    // SAFETY: see above.
    let way = unsafe { way_of(message) };
    let interface = INTERFACE.load(Ordering::Relaxed);
    let is_near = interface == 0 || way.is_some_and(|way| way.interface == interface);
    if !(is_near && is_harmless(datagram)) {
        return None;
    }
    let is_multicast = way.is_some_and(|way| way.destination.is_multicast());
    let is_from_here = way.is_none_or(|way| Some(way.interface) == *LOOPBACK);
    // SAFETY: the kernel has written it there.
    let source = place_of_source(message).map(|place| unsafe { place.read() });
    let machine = source.filter(|_| !is_from_here).map(address_of);
    if let Some((participant, number)) = announcement(datagram) {
        static_peers::pass_on(participant, number, datagram);
        match machine {
            Some(machine) if is_multicast => beyond_multicast::remove(machine),
            Some(machine) => beyond_multicast::add(machine),
            None => {}
        }
    }
    if machine.is_some_and(beyond_multicast::is) {
        hide_multicast(datagram);
    }
    number_announcements(datagram);
    report_acknowledgements(datagram);
    if let (Some(writer), Some(source)) = (user_writer(datagram), source) {
        early::keep(writer, datagram, source, || port_of(socket));
    }
    Some(length)
}

/// Where recvmsg(2) has written the source of a datagram, if that was asked for and is of IPv4.
fn place_of_source(message: &libc::msghdr) -> Option<*mut early::Source> {
    let is_one = message.msg_namelen as usize == size_of::<early::Source>();
    Some(message.msg_name.cast()).filter(|place: &*mut early::Source| is_one && !place.is_null())
}

/// The address of a `sockaddr_in`.
fn address_of(source: early::Source) -> Ipv4Addr {
    let &[_, _, _, _, a, b, c, d, ..] = &source;
    Ipv4Addr::new(a, b, c, d)
}

/// The port that a socket is bound to.
fn port_of(socket: libc::c_int) -> Option<u16> {
    // SAFETY: zero is an address; the length is that of the address.
    unsafe {
        let mut address: libc::sockaddr_in = std::mem::zeroed();
        let mut length = size_of_val(&address) as libc::socklen_t;
        let result =
            libc::getsockname(socket, (&raw mut address).cast::<libc::sockaddr>(), &raw mut length);
        let is_ipv4 = address.sin_family == libc::AF_INET as libc::sa_family_t;
        (result == 0 && is_ipv4).then(|| u16::from_be(address.sin_port))
    }
}

/// How a datagram came.
#[derive(Clone, Copy)]
struct Way {
    /// Index of the interface.
    interface: u32,
    destination: Ipv4Addr,
}

/// The way of a datagram, where the socket asks for it.
///
/// # Safety
/// `message` is what recvmsg(2) has filled in.
unsafe fn way_of(message: &libc::msghdr) -> Option<Way> {
    // SAFETY: the kernel has filled in the control messages, which the macros of the C library walk
    // over; the payload of one of this kind may lie at any address.
    unsafe {
        let mut control = libc::CMSG_FIRSTHDR(message);
        while let Some(header) = control.as_ref() {
            if (header.cmsg_level, header.cmsg_type) == (libc::IPPROTO_IP, libc::IP_PKTINFO) {
                let info = libc::CMSG_DATA(header).cast::<libc::in_pktinfo>().read_unaligned();
                let interface = u32::try_from(info.ipi_ifindex).ok()?;
                let destination = Ipv4Addr::from(info.ipi_addr.s_addr.to_ne_bytes());
                return Some(Way { interface, destination });
            }
            control = libc::CMSG_NXTHDR(message, control);
        }
    }
    None
}

const RTPS_HEADER: usize = 20;
const SUBMESSAGE_HEADER: usize = 4;

// Kinds of submessages (DDSI-RTPS 2.5, 9.4.5.1.1).
const PAD: u8 = 0x01;
const ACKNACK: u8 = 0x06;
const HEARTBEAT: u8 = 0x07;
const GAP: u8 = 0x08;
const INFO_TS: u8 = 0x09;
const INFO_DST: u8 = 0x0e;
const NACK_FRAG: u8 = 0x12;
const DATA: u8 = 0x15;
const DATA_FRAG: u8 = 0x16;

/// Entities of the writers of announcements: of participants, of their writers, of their readers
/// (DDSI-RTPS 2.5, table 9.3).
const ANNOUNCER: [u8; 4] = [0x00, 0x01, 0x00, 0xc2];
const ENDPOINT_ANNOUNCERS: [[u8; 4]; 2] = [[0x00, 0x00, 0x03, 0xc2], [0x00, 0x00, 0x04, 0xc2]];

/// Whether every submessage of an RTPS message is within the bounds of this file.
fn is_harmless(message: &[u8]) -> bool {
    let mut rest = message.get(RTPS_HEADER..).unwrap_or(&[]);
    while !rest.is_empty() {
        let Some(submessage) = Submessage::first_of(rest) else { return false };
        if submessage.within_bounds() != Some(true) {
            return false;
        }
        rest = &rest[SUBMESSAGE_HEADER + submessage.body.len()..];
    }
    message.len() >= RTPS_HEADER
}

/// The submessages of a harmless RTPS message.
fn submessages(message: &[u8]) -> impl Iterator<Item = Submessage<'_>> {
    let mut rest = message.get(RTPS_HEADER..).unwrap_or(&[]);
    std::iter::from_fn(move || {
        let submessage = Submessage::first_of(rest)?;
        rest = &rest[SUBMESSAGE_HEADER + submessage.body.len()..];
        Some(submessage)
    })
}

/// The participant that a harmless RTPS message is from.
fn participant(message: &[u8]) -> Option<[u8; 12]> {
    message.get(8..RTPS_HEADER)?.first_chunk().copied()
}

/// The participant that announces itself in a harmless RTPS message, and with which number.
fn announcement(message: &[u8]) -> Option<([u8; 12], u64)> {
    let announces = submessages(message).find(Submessage::is_announcement)?;
    Some((participant(message)?, announces.number(12)?))
}

/// Hides the multicast addresses that the announcements in a harmless RTPS message name.
fn hide_multicast(message: &mut [u8]) {
    let mut at = RTPS_HEADER;
    while let Some(submessage) = message.get(at..).and_then(Submessage::first_of) {
        let (begin, length) = (at + SUBMESSAGE_HEADER, submessage.body.len());
        if submessage.is_announcement() || submessage.is_announcement_of_endpoint() {
            let flags = message[at + 1];
            beyond_multicast::hide_multicast(&mut message[begin..begin + length], flags);
        }
        at = begin + length;
    }
}

/// Gives every announcement of a participant in a harmless RTPS message a number of its own.
fn number_announcements(message: &mut [u8]) {
    let mut at = RTPS_HEADER;
    while let Some(submessage) = message.get(at..).and_then(Submessage::first_of) {
        let (begin, length) = (at + SUBMESSAGE_HEADER, submessage.body.len());
        if submessage.is_announcement() {
            let number = ANNOUNCEMENTS.fetch_add(1, Ordering::Relaxed) % LARGEST_NUMBER + 1;
            let words = [(number >> 32) as u32, number as u32];
            let bytes = match submessage.is_little_endian {
                true => words.map(u32::to_le_bytes),
                false => words.map(u32::to_be_bytes),
            };
            message[begin + 12..begin + 20].copy_from_slice(bytes.as_flattened());
        }
        at = begin + length;
    }
}

/// The first writer in a harmless RTPS message that sends samples or says which it has, and serves
/// users, not the discovery (DDSI-RTPS 2.5, 9.3.1.2).
fn user_writer(message: &[u8]) -> Option<GUID> {
    const BUILT_IN_OR_OF_A_VENDOR: u8 = 0xc0;
    submessages(message).find_map(|submessage| {
        let place = match submessage.kind {
            DATA | DATA_FRAG => 8,
            HEARTBEAT | GAP => 4,
            _ => return None,
        };
        let writer = submessage.body.get(place..place + 4)?;
        if writer[3] & BUILT_IN_OR_OF_A_VENDOR != 0 {
            return None;
        }
        let bytes = [&participant(message)?, writer].concat();
        Some(GUID::from_bytes(bytes.try_into().ok()?))
    })
}

/// Calls the listeners with the acknowledgements in a harmless RTPS message.
fn report_acknowledgements(message: &[u8]) {
    // Both are named by the participant, 12 bytes, and 4 bytes of their own.
    let Some(from) = participant(message) else { return };
    let guid = |participant: [u8; 12], own: &[u8; 4]| {
        let mut bytes = [0; 16];
        bytes[..12].copy_from_slice(&participant);
        bytes[12..].copy_from_slice(own);
        GUID::from_bytes(bytes)
    };
    let mut to = None;
    for submessage in submessages(message) {
        let body = submessage.body;
        match submessage.kind {
            INFO_DST => to = body.first_chunk().copied(),
            ACKNACK => {
                if let (Some(to), Some(&reader), Some(&writer), Some(first_missing)) = (
                    to,
                    body.first_chunk::<4>(),
                    body.get(4..).and_then(<[u8]>::first_chunk::<4>),
                    submessage.number(8),
                ) {
                    let acknowledgement = Acknowledgement {
                        reader: guid(from, &reader),
                        writer: guid(to, &writer),
                        first_missing,
                    };
                    let all: Vec<_> = listeners().iter().filter_map(Weak::upgrade).collect();
                    all.iter().for_each(|listener| listener(acknowledgement));
                }
            }
            _ => {}
        }
    }
}

struct Submessage<'a> {
    kind: u8,
    is_little_endian: bool,
    body: &'a [u8],
}

impl<'a> Submessage<'a> {
    fn first_of(bytes: &'a [u8]) -> Option<Submessage<'a>> {
        let &[kind, flags, low, high, ref rest @ ..] = bytes else { return None };
        let is_little_endian = flags & 1 == 1;
        let length = if is_little_endian { [low, high] } else { [high, low] }.map(usize::from);
        let length = length[0] | length[1] << 8;
        // A length of 0 means up to the end of the message, except where it is one (9.4.5.1.3).
        let is_rest = length == 0 && ![PAD, INFO_TS].contains(&kind);
        let body = if is_rest { rest } else { rest.get(..length)? };
        Some(Submessage { kind, is_little_endian, body })
    }

    fn is_announcement(&self) -> bool {
        self.kind == DATA && self.body.get(8..12) == Some(&ANNOUNCER)
    }

    fn is_announcement_of_endpoint(&self) -> bool {
        let writer = self.body.get(8..12);
        self.kind == DATA && ENDPOINT_ANNOUNCERS.iter().any(|of| writer == Some(of))
    }

    /// `None` where a number lies beyond the submessage.
    fn within_bounds(&self) -> Option<bool> {
        Some(match self.kind {
            DATA => self.is_number(12)?,
            DATA_FRAG => self.is_number(12)? && (self.word(28)? as usize) < LARGEST_SAMPLE,
            HEARTBEAT | GAP => {
                let (first, last) = (self.number(8)?, self.number(16)?);
                let may_be_long = self.kind == GAP && first == 1;
                self.is_number(8)?
                    && self.is_number(16)?
                    // A last one before the first is an empty range.
                    && (may_be_long || last.abs_diff(first) <= u64::from(LARGEST_WINDOW))
            }
            ACKNACK => self.is_number(8)?,
            NACK_FRAG => self.is_number(8)? && (1..LARGEST_FRAGMENT).contains(&self.word(16)?),
            _ => true,
        })
    }

    fn is_number(&self, at: usize) -> Option<bool> {
        Some(self.number(at)? < LARGEST_NUMBER)
    }

    /// The sequence number at `at`: upper word, lower word. A negative one is large.
    fn number(&self, at: usize) -> Option<u64> {
        Some(u64::from(self.word(at)?) << 32 | u64::from(self.word(at + 4)?))
    }

    fn word(&self, at: usize) -> Option<u32> {
        let bytes = self.body.get(at..at + 4)?.try_into().ok()?;
        let read = if self.is_little_endian { u32::from_le_bytes } else { u32::from_be_bytes };
        Some(read(bytes))
    }
}

#[cfg(test)]
mod tests {
    use std::net::UdpSocket;
    use std::os::fd::AsRawFd as _;
    use std::sync::{Mutex, MutexGuard, PoisonError};

    use proptest::prelude::*;

    use super::*;

    const WINDOW: u64 = LARGEST_WINDOW as u64;

    /// Two sockets on loopback. What is sent over loopback is there, or dropped, when the call
    /// returns.
    struct Link {
        receiver: UdpSocket,
        sender: UdpSocket,
        /// The interface that is heard is one for the process.
        _turn: MutexGuard<'static, ()>,
    }

    impl Link {
        fn new(interface: u32) -> Link {
            static TURN: Mutex<()> = Mutex::new(());
            let turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
            INTERFACE.store(interface, Ordering::Relaxed);
            let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
            receiver.set_nonblocking(true).unwrap();
            let on: libc::c_int = 1;
            // SAFETY: the option is an int.
            let result = unsafe {
                libc::setsockopt(
                    receiver.as_raw_fd(),
                    libc::IPPROTO_IP,
                    libc::IP_PKTINFO,
                    (&raw const on).cast(),
                    size_of::<libc::c_int>() as libc::socklen_t,
                )
            };
            assert_eq!(result, 0);
            let sender = UdpSocket::bind("127.0.0.1:0").unwrap();
            sender.connect(receiver.local_addr().unwrap()).unwrap();
            Link { receiver, sender, _turn: turn }
        }

        /// The next datagram, as the library asks for it.
        fn receive(&self) -> Option<Vec<u8>> {
            Some(self.receive_from()?.0)
        }

        fn receive_from(&self) -> Option<(Vec<u8>, early::Source)> {
            let mut bytes = vec![0; 1 << 16];
            let mut control = [0_u64; 8];
            let mut source: early::Source = [0; 16];
            let mut buffer =
                libc::iovec { iov_base: bytes.as_mut_ptr().cast(), iov_len: bytes.len() };
            // SAFETY: zero is a message without anything; all pointers are to locals of the
            // lengths that are reported.
            let received = unsafe {
                let mut message: libc::msghdr = std::mem::zeroed();
                message.msg_name = source.as_mut_ptr().cast();
                message.msg_namelen = size_of_val(&source) as _;
                message.msg_iov = &raw mut buffer;
                message.msg_iovlen = 1;
                message.msg_control = control.as_mut_ptr().cast();
                message.msg_controllen = size_of_val(&control) as _;
                libc::recvmsg(self.receiver.as_raw_fd(), &raw mut message, 0)
            };
            match usize::try_from(received) {
                Ok(length) => Some((bytes[..length].to_vec(), source)),
                Err(_) => {
                    assert_eq!(io::Error::last_os_error().kind(), io::ErrorKind::WouldBlock);
                    None
                }
            }
        }

        fn passes(&self, datagram: &[u8]) -> bool {
            self.sender.send(datagram).unwrap();
            let received = self.receive();
            assert!(received.as_deref().is_none_or(|received| received == datagram));
            received.is_some()
        }
    }

    fn message(submessages: &[Vec<u8>]) -> Vec<u8> {
        let mut message = b"RTPS\x02\x03\x01\x0f".to_vec();
        message.extend(1..=12);
        submessages.iter().for_each(|submessage| message.extend(submessage));
        message
    }

    fn submessage(kind: u8, body: &[u8]) -> Vec<u8> {
        let length = u16::try_from(body.len()).unwrap().to_le_bytes();
        [&[kind, 1, length[0], length[1]], body].concat()
    }

    fn number(value: u64) -> [u8; 8] {
        let (high, low) = ((value >> 32) as u32, value as u32);
        [high.to_le_bytes(), low.to_le_bytes()].concat().try_into().unwrap()
    }

    const ENTITIES: [u8; 8] = [0, 0, 3, 0xc7, 0, 0, 3, 0xc2];

    fn range(kind: u8, first: u64, last: u64) -> Vec<u8> {
        submessage(kind, &[&ENTITIES[..], &number(first), &number(last), &[0; 4]].concat())
    }

    fn acknack(base: u64) -> Vec<u8> {
        submessage(ACKNACK, &[&ENTITIES[..], &number(base), &[0; 8]].concat())
    }

    fn data(sequence_number: u64) -> Vec<u8> {
        let payload = [0, 1, 0, 0, 7, 7, 7, 7];
        let head = [&[0, 0, 16, 0][..], &ENTITIES, &number(sequence_number)].concat();
        submessage(DATA, &[&head[..], &payload].concat())
    }

    fn fragment(sequence_number: u64, size: u32) -> Vec<u8> {
        let head = [&[0, 0, 28, 0][..], &ENTITIES, &number(sequence_number)].concat();
        let counts = [&1_u32.to_le_bytes()[..], &[1, 0, 0, 1], &size.to_le_bytes()].concat();
        submessage(DATA_FRAG, &[&head[..], &counts, &[0; 64]].concat())
    }

    fn fragment_request(sequence_number: u64, first: u32) -> Vec<u8> {
        let set = [first.to_le_bytes(), [32, 0, 0, 0], [0xff; 4], [1, 0, 0, 0]].concat();
        submessage(NACK_FRAG, &[&ENTITIES[..], &number(sequence_number), &set].concat())
    }

    fn timestamp() -> Vec<u8> {
        submessage(INFO_TS, &[5; 8])
    }

    #[test]
    fn what_peers_send_passes() {
        let link = Link::new(0);
        for sequence_number in [1, 255, 65_536, 0x01_2345_6789, (1 << 40) - 2] {
            for submessages in [
                vec![data(sequence_number)],
                vec![timestamp(), data(sequence_number), range(HEARTBEAT, 1, 100)],
                vec![acknack(sequence_number)],
                vec![fragment(sequence_number, LARGEST_SAMPLE as u32 - 1)],
                vec![fragment_request(sequence_number, 65_535)],
                vec![submessage(0x0e, &[9; 12]), acknack(sequence_number), acknack(0)],
                // Nothing is there: the first is the one after the last.
                vec![range(HEARTBEAT, sequence_number + 1, sequence_number)],
            ] {
                assert!(link.passes(&message(&submessages)), "{submessages:x?}");
            }
        }
        assert!(link.passes(&message(&[range(GAP, 1, 1 << 39)])), "what a late reader gets");
        assert!(link.passes(&message(&[])));
        let empty = |kind: u8| vec![kind, 1, 0, 0];
        assert!(link.passes(&message(&[empty(PAD), empty(INFO_TS), data(1)])));
        // The last one may leave its length to that of the message.
        let mut last = data(1);
        last[2..4].fill(0);
        assert!(link.passes(&message(&[timestamp(), last])));
    }

    #[test]
    fn acknowledgements_are_reported() {
        let link = Link::new(0);
        let heard = Arc::new(Mutex::new(Vec::new()));
        let shared = Arc::clone(&heard);
        let listener = on_acknowledgement(move |what| shared.lock().unwrap().push(what));
        let to: [u8; 12] = std::array::from_fn(|index| 100 + index as u8);
        let destination = submessage(INFO_DST, &to);
        // Without a destination there is no writer.
        assert!(link.passes(&message(&[acknack(3)])));
        assert!(link.passes(&message(&[destination, timestamp(), acknack(7), acknack(8)])));
        let guid = |participant: &[u8], own: [u8; 4]| {
            GUID::from_bytes([participant, &own].concat().try_into().unwrap())
        };
        let from: Vec<u8> = (1..=12).collect();
        let expected = [7, 8].map(|first_missing| Acknowledgement {
            reader: guid(&from, [0, 0, 3, 0xc7]),
            writer: guid(&to, [0, 0, 3, 0xc2]),
            first_missing,
        });
        assert_eq!(*heard.lock().unwrap(), expected);
        drop(listener);
        assert!(link.passes(&message(&[submessage(INFO_DST, &to), acknack(9)])));
        assert_eq!(heard.lock().unwrap().len(), 2);
    }

    #[test]
    fn what_came_before_its_writer_was_matched_comes_again() {
        let link = Link::new(0);
        let sample = |writer: u8| {
            let entities = [0, 0, 3, 4, 0, 0, writer, 3];
            let head = [&[0, 0, 16, 0][..], &entities, &number(1)].concat();
            submessage(DATA, &[&head[..], &[0, 1, 0, 0, 7, 7, 7, 7]].concat())
        };
        let heartbeat = |writer: u8| {
            let range = [number(1), number(1)].concat();
            submessage(HEARTBEAT, &[&[0, 0, 3, 4, 0, 0, writer, 3][..], &range, &[0; 4]].concat())
        };
        let guid = |writer: u8| {
            let participant: Vec<u8> = (1..=12).collect();
            GUID::from_bytes([&participant[..], &[0, 0, writer, 3]].concat().try_into().unwrap())
        };
        let early = [message(&[timestamp(), sample(1)]), message(&[heartbeat(1)])];
        for datagram in [&early[0], &message(&[sample(2)]), &early[1], &message(&[data(1)])] {
            assert!(link.passes(datagram));
        }
        early::matched(guid(1));
        let again = [link.receive_from().unwrap(), link.receive_from().unwrap()];
        // As from the one who sent it.
        let port = link.sender.local_addr().unwrap().port().to_be_bytes();
        assert!(again.iter().all(|(_, source)| source[2..8] == [port[0], port[1], 127, 0, 0, 1]));
        assert_eq!(again.map(|(datagram, _)| datagram), early);
        // Neither what another writer sent, nor what came from a writer that is known.
        assert!(link.receive().is_none());
        assert!(link.passes(&early[0]));
        early::matched(guid(1));
        assert!(link.receive().is_none());
        // It may come back as another one.
        early::lost(|writer| *writer == guid(1));
        assert!(link.passes(&early[0]));
        early::matched(guid(1));
        assert_eq!(link.receive().as_ref(), Some(&early[0]));
        // The discovery is no matter of this.
        early::matched(GUID::from_bytes(
            [(1..=12).collect(), ENTITIES[4..].to_vec()].concat().try_into().unwrap(),
        ));
        assert!(link.receive().is_none());
    }

    #[test]
    fn counts_beyond_what_the_nodes_use_are_dropped() {
        let link = Link::new(0);
        let negative = u64::MAX;
        for hostile in [
            fragment(1, LARGEST_SAMPLE as u32),
            fragment(1, u32::MAX),
            fragment(1 << 40, 1000),
            range(HEARTBEAT, 1, 1 << 40),
            range(HEARTBEAT, 1, 1 << 31),
            range(HEARTBEAT, 1, WINDOW + 2),
            range(HEARTBEAT, 1 << 40, 1 << 40),
            range(HEARTBEAT, negative, 5),
            range(GAP, 100, 1 << 40),
            range(GAP, 100, WINDOW + 2 + 100),
            range(GAP, 2, 1 << 33),
            range(GAP, 1, 1 << 40),
            range(GAP, (1 << 32) | 1, (2 << 32) | 1),
            acknack(1 << 40),
            acknack(negative),
            data(1 << 40),
            data(negative),
            fragment_request(1, 0),
            fragment_request(1, 65_536),
            fragment_request(1 << 40, 1),
        ] {
            for before in [vec![], vec![timestamp()], vec![data(7), timestamp(), acknack(2)]] {
                let submessages = [before, vec![hostile.clone(), data(8)]].concat();
                assert!(!link.passes(&message(&submessages)), "{submessages:x?}");
            }
        }
    }

    #[test]
    fn every_window_up_to_the_largest_passes_wherever_it_lies() {
        let link = Link::new(0);
        for first in [1, 65_535, 65_537, (1 << 24) - 3, (1 << 32) + 65_000, (1 << 39) + 1] {
            for width in [0, 1, 255, 65_535, WINDOW] {
                for kind in [HEARTBEAT, GAP] {
                    assert!(
                        link.passes(&message(&[range(kind, first, first + width)])),
                        "{kind} {first} {width}"
                    );
                }
            }
        }
    }

    #[test]
    fn broken_messages_are_dropped() {
        let link = Link::new(0);
        let whole = message(&[timestamp(), data(1), acknack(3)]);
        assert!(link.passes(&whole));
        for length in 0..whole.len() {
            // After the header, the timestamp and the sample. What is no RTPS is for the library.
            let ends_a_submessage = [20, 32, 64].contains(&length) || length < 4;
            assert_eq!(link.passes(&whole[..length]), ends_a_submessage, "{length} bytes");
        }
    }

    #[test]
    fn a_message_may_have_any_number_of_submessages() {
        let link = Link::new(0);
        // A peer that repeats what was asked for: samples and heartbeats in turns.
        let turn = |n: u64| [timestamp(), data(n), data(n + 1), range(HEARTBEAT, 1, n + 1)];
        let mut submessages: Vec<_> = (0..300).flat_map(|n| turn(2 * n + 1)).collect();
        assert!(link.passes(&message(&submessages)));
        submessages.push(fragment(1, u32::MAX));
        assert!(!link.passes(&message(&submessages)));
    }

    #[test]
    fn a_big_endian_peer_is_judged_alike() {
        let swapped = |first: u64, last: u64| {
            let body = [&ENTITIES[..], &first.to_be_bytes(), &last.to_be_bytes(), &[0; 4]].concat();
            [&[HEARTBEAT, 0, 0, body.len() as u8][..], &body].concat()
        };
        let link = Link::new(0);
        assert!(link.passes(&message(&[swapped(1, 100), data(1)])));
        assert!(!link.passes(&message(&[swapped(1, 1 << 40), data(1)])));
    }

    #[test]
    fn what_follows_a_dropped_datagram_is_received() {
        let link = Link::new(0);
        for datagram in [fragment(1, u32::MAX), data(7)] {
            link.sender.send(&message(&[datagram])).unwrap();
        }
        assert_eq!(link.receive(), Some(message(&[data(7)])));
        assert_eq!(link.receive(), None);
    }

    #[test]
    fn an_announcement_has_a_number_of_its_own_however_often_it_comes() {
        let link = Link::new(0);
        let little = data(1);
        let mut big = [&[DATA, 0, 0, 28][..], &[0; 8], &ANNOUNCER, &[0; 7], &[1], &[7; 8]].concat();
        let mut announcement = little.clone();
        announcement[12..16].copy_from_slice(&ANNOUNCER);
        let datagram = message(&[timestamp(), little, announcement, big.clone()]);
        let receive = || {
            link.sender.send(&datagram).unwrap();
            link.receive().unwrap()
        };
        let (first, second) = (receive(), receive());
        let numbers = |received: &[u8]| {
            let at = |from: usize| <[u8; 8]>::try_from(&received[from..from + 8]).unwrap();
            let little = at(RTPS_HEADER + 12 + 32 + 16);
            let big = at(RTPS_HEADER + 12 + 32 + 32 + 16);
            // The upper word comes first.
            let word =
                |bytes: &[u8], read: fn([u8; 4]) -> u32| u64::from(read(bytes.try_into().unwrap()));
            [
                word(&little[..4], u32::from_le_bytes) << 32
                    | word(&little[4..], u32::from_le_bytes),
                u64::from_be_bytes(big),
            ]
        };
        let mut all = [numbers(&first), numbers(&second)].concat();
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), 4, "{all:?}");
        assert!(all.iter().all(|number| (1..LARGEST_NUMBER).contains(number)), "{all:?}");
        // Nothing else has changed.
        let without = |received: &[u8]| {
            let mut rest = received.to_vec();
            for from in [RTPS_HEADER + 12 + 32 + 16, RTPS_HEADER + 12 + 32 + 32 + 16] {
                rest[from..from + 8].fill(0);
            }
            rest
        };
        assert_eq!(without(&first), without(&datagram));
        // The last one may leave its length to that of the message.
        big[2..4].fill(0);
        let last = message(&[big]);
        link.sender.send(&last).unwrap();
        assert_ne!(link.receive().unwrap(), last);
    }

    #[test]
    fn only_what_comes_through_the_interface_passes() {
        let datagram = message(&[data(1)]);
        let interface = loopback().unwrap();
        assert!(Link::new(interface).passes(&datagram));
        assert!(!Link::new(interface + 1).passes(&datagram));
    }

    /// Submessages, some of them hostile.
    fn piece() -> impl Strategy<Value = Vec<u8>> {
        let count = || prop_oneof![0..300_u64, 0..1_u64 << 33, 0..1_u64 << 41, any::<u64>()];
        let kind = || prop_oneof![Just(GAP), Just(HEARTBEAT)];
        prop_oneof![
            Just(timestamp()),
            count().prop_map(data),
            count().prop_map(acknack),
            (count(), any::<u32>(), 0..32_u32).prop_map(|(n, size, up)| fragment(n, size >> up)),
            (count(), any::<u32>(), 0..32_u32)
                .prop_map(|(n, first, up)| fragment_request(n, first >> up)),
            (kind(), count(), count()).prop_map(|(kind, first, last)| range(kind, first, last)),
            (0..3_usize, any::<u8>(), prop::collection::vec(parameter(), 0..6)).prop_map(
                |(writer, options, parameters)| announcement_by(writer, options, &parameters)
            ),
            (kind(), count(), 0..200_000_u64).prop_map(|(kind, first, width)| range(
                kind,
                first,
                first.wrapping_add(width)
            )),
            (any::<u8>(), prop::collection::vec(any::<u8>(), 1..60))
                .prop_map(|(kind, body)| submessage(kind, &body)),
        ]
    }

    /// A parameter of an announcement, often a multicast address.
    fn parameter() -> impl Strategy<Value = Vec<u8>> {
        let kind = prop_oneof![Just(0x30_u16), Just(0x33), Just(0x48), Just(1), any::<u16>()];
        let value = prop::collection::vec(any::<u8>(), 0..28);
        (kind, value).prop_map(|(kind, value)| {
            [&kind.to_le_bytes()[..], &(value.len() as u16).to_le_bytes(), &value].concat()
        })
    }

    /// An announcement of a participant, a writer or a reader.
    fn announcement_by(writer: usize, options: u8, parameters: &[Vec<u8>]) -> Vec<u8> {
        let writer = [ANNOUNCER, ENDPOINT_ANNOUNCERS[0], ENDPOINT_ANNOUNCERS[1]][writer];
        let number = [&[0; 4][..], &1_u32.to_le_bytes()].concat();
        let head = [&[0, 0, 16, 0, 0, 0, 0, 0][..], &writer, &number].concat();
        let body = [&head[..], &[0, 3, 0, options], &parameters.concat()].concat();
        submessage(DATA, &body)
    }

    proptest! {
        #![proptest_config(ProptestConfig {
            failure_persistence: None,
            ..ProptestConfig::with_cases(5000)
        })]

        #[test]
        fn a_message_is_as_harmless_as_its_worst_submessage(
            pieces in prop::collection::vec(piece(), 0..8),
        ) {
            let alone = |piece: &Vec<u8>| is_harmless(&message(std::slice::from_ref(piece)));
            prop_assert_eq!(is_harmless(&message(&pieces)), pieces.iter().all(alone));
        }

        #[test]
        fn changed_and_cut_messages_are_judged(
            pieces in prop::collection::vec(piece(), 0..8),
            changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..8),
            end in any::<prop::sample::Index>(),
        ) {
            let mut datagram = message(&pieces);
            let before = datagram.len();
            for (at, value) in changes {
                datagram[at.index(before)] = value;
            }
            let heard = &mut datagram[..=end.index(before)];
            // No panic, whatever it says; what is changed in it leaves it harmless.
            if is_harmless(heard) {
                let from = announcement(heard);
                let writer = user_writer(heard);
                hide_multicast(heard);
                number_announcements(heard);
                report_acknowledgements(heard);
                prop_assert!(is_harmless(heard));
                prop_assert_eq!(announcement(heard).is_some(), from.is_some());
                prop_assert_eq!(user_writer(heard), writer);
            }
        }
    }
}
