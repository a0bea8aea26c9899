//! What the kernel lets through to the sockets of the DDS library.
//!
//! In goes the reach of a participant; out comes a classic BPF program on each of its sockets. The
//! library trusts the counts in a datagram: a few bytes can reserve 4 GiB or occupy its thread for
//! good, and its sockets listen on every interface whatever the reach. So the kernel drops, before
//! the library sees them,
//! - with [`Reach::Localhost`], what did not come through the loopback interface;
//! - what is no RTPS message, or one that ends within a submessage;
//! - sequence numbers from 2^40, which take 4 years at 8 kHz;
//! - HEARTBEAT and GAP over more than [`LARGEST_WINDOW`] samples, except a GAP from the first one;
//! - fragments of samples of [`LARGEST_SAMPLE`] bytes or more, and requests for fragments that such
//!   a sample does not have;
//! - big-endian submessages, a timestamp for nothing, and messages of more submessages than the
//!   program looks at ([`Length`]).
//!
//! One such submessage drops its whole datagram. The layout of the submessages: DDSI-RTPS 2.5,
//! 9.4.5. Limits and costs: `docs/decisions/0010-strangers.md`.

use std::io;
use std::mem::{size_of, zeroed};
use std::os::fd::RawFd;
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::participant::Reach;

/// Samples of this serialised size, in bytes, are not heard in fragments.
pub const LARGEST_SAMPLE: usize = 1 << 20;
/// Samples that a HEARTBEAT or GAP may span: any span of up to this one passes, none of twice as
/// many.
pub const LARGEST_WINDOW: u64 = 1 << 16;

/// How far a program looks into a message: some submessages of any kind, a run of samples (a
/// publisher repeats up to 256 in one datagram), and more of any kind. A timestamp before a
/// submessage does not count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Length {
    head: usize,
    samples: usize,
    tail: usize,
}

/// The longest first: as long as the 4096 instructions of a program allow, and for kernels before
/// 6.8, which allow a socket 20 KB.
const LENGTHS: [Length; 3] = [
    Length { head: 4, samples: 140, tail: 12 },
    Length { head: 3, samples: 20, tail: 5 },
    Length { head: 2, samples: 10, tail: 3 },
];

/// Offset of the RTPS message in what the program sees, after the UDP header.
const MESSAGE: u32 = 8;
const RTPS_HEADER: u32 = 20;
const SUBMESSAGE_HEADER: u32 = 4;

// Kinds of submessages (DDSI-RTPS 2.5, 9.4.5.1.1).
const PAD: u32 = 0x01;
const ACKNACK: u32 = 0x06;
const HEARTBEAT: u32 = 0x07;
const GAP: u32 = 0x08;
const INFO_TS: u32 = 0x09;
const NACK_FRAG: u32 = 0x12;
const DATA: u32 = 0x15;
const DATA_FRAG: u32 = 0x16;

/// First word of an INFO_TS with a time: little endian, 8 bytes.
const TIMESTAMP: u32 = 0x0901_0800;
const TIMESTAMP_LENGTH: u32 = 12;

// The program loads words in network order, the numbers in them are little endian: the first byte
// of a number is the highest of the word.
const KIND: u32 = 0xff00_0000;
const LITTLE_ENDIAN_FLAG: u32 = 0x0001_0000;
const LITTLE_ENDIAN_DATA: u32 = (DATA << 24) | LITTLE_ENDIAN_FLAG;
const ABOVE_255: u32 = 0x00ff_ffff;
const ABOVE_65535: u32 = 0x0000_ffff;
const FROM_LARGEST_SAMPLE: u32 = 0x0000_f0ff;
const ONE: u32 = 0x0100_0000;
const _: () = assert!(LARGEST_SAMPLE == 1 << 20 && LARGEST_WINDOW == 1 << 16);

// Sequence numbers of HEARTBEAT and GAP, from the submessage's begin.
const FIRST: u32 = SUBMESSAGE_HEADER + 8;
const LAST: u32 = FIRST + 8;

// Scratch memory of the program.
const POSITION: u32 = 0;
const HEAD: u32 = 1;
const OTHER: u32 = 2;

const DROP: u32 = 0;
const PASS: u32 = u32::MAX;

/// Sockets of this process that a new participant may own: those that were not there before.
pub struct NewSockets {
    before: Vec<RawFd>,
    /// Participants join one after the other, so that each finds its own sockets.
    _turn: MutexGuard<'static, ()>,
}

impl NewSockets {
    /// To be called before the participant is made.
    pub fn watch() -> io::Result<NewSockets> {
        static TURN: Mutex<()> = Mutex::new(());
        let turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(NewSockets { before: descriptors()?, _turn: turn })
    }

    /// Filters what the sockets of the participant receive from now on.
    pub fn filter(self, reach: Reach) -> io::Result<()> {
        let sockets: Vec<RawFd> = descriptors()?
            .into_iter()
            .filter(|descriptor| !self.before.contains(descriptor) && hears_everyone(*descriptor))
            .collect();
        if sockets.is_empty() {
            return Err(io::Error::other("the participant has no socket"));
        }
        let interface = match reach {
            Reach::Localhost => Some(loopback()?),
            Reach::Subnet => None,
        };
        for socket in sockets {
            let length = attach(socket, interface)?;
            if length != LENGTHS[0] {
                tracing::warn!(
                    "net.core.optmem_max is small: a peer that repeats more than {} samples at \
                     once is not heard; 131072 is enough",
                    length.samples
                );
            }
        }
        Ok(())
    }
}

fn descriptors() -> io::Result<Vec<RawFd>> {
    Ok(std::fs::read_dir("/proc/self/fd")?
        .filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok())
        .collect())
}

/// Whether this is a UDP socket of IPv4 that is bound to a port of every interface, as those of the
/// library are.
fn hears_everyone(descriptor: RawFd) -> bool {
    let mut kind: libc::c_int = 0;
    let mut kind_length = size_of::<libc::c_int>() as libc::socklen_t;
    // SAFETY: every pointer is to a local of the length that is told; a descriptor that is closed
    // by now, or no socket, makes the calls fail.
    unsafe {
        let mut address: libc::sockaddr_in = zeroed();
        let mut length = size_of::<libc::sockaddr_in>() as libc::socklen_t;
        libc::getsockopt(
            descriptor,
            libc::SOL_SOCKET,
            libc::SO_TYPE,
            (&raw mut kind).cast(),
            &raw mut kind_length,
        ) == 0
            && kind == libc::SOCK_DGRAM
            && libc::getsockname(descriptor, (&raw mut address).cast(), &raw mut length) == 0
            && i32::from(address.sin_family) == libc::AF_INET
            && address.sin_addr.s_addr == libc::INADDR_ANY
            && address.sin_port != 0
    }
}

/// Index of the loopback interface.
fn loopback() -> io::Result<u32> {
    // SAFETY: the name ends with a zero.
    match unsafe { libc::if_nametoindex(c"lo".as_ptr()) } {
        0 => Err(io::Error::last_os_error()),
        index => Ok(index),
    }
}

/// Gives `socket` the longest program that the kernel takes.
fn attach(socket: RawFd, interface: Option<u32>) -> io::Result<Length> {
    let mut result = Err(io::ErrorKind::Unsupported.into());
    for length in LENGTHS {
        result = attach_program(socket, &mut program(interface, length)).map(|()| length);
        match &result {
            Err(error) if error.raw_os_error() == Some(libc::ENOMEM) => {}
            _ => break,
        }
    }
    result
}

fn attach_program(socket: RawFd, code: &mut [libc::sock_filter]) -> io::Result<()> {
    let filter = libc::sock_fprog {
        len: u16::try_from(code.len()).map_err(io::Error::other)?,
        filter: code.as_mut_ptr(),
    };
    // SAFETY: `filter` points to `len` instructions, which the kernel copies.
    let result = unsafe {
        libc::setsockopt(
            socket,
            libc::SOL_SOCKET,
            libc::SO_ATTACH_FILTER,
            (&raw const filter).cast(),
            size_of::<libc::sock_fprog>() as libc::socklen_t,
        )
    };
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

/// The program; it lets only through what comes from `interface`, if there is one.
fn program(interface: Option<u32>, length: Length) -> Vec<libc::sock_filter> {
    let mut code = Assembler::default();
    // First of all: the kernel wants memory written on every way to where it is read.
    code.set_x(MESSAGE + RTPS_HEADER);
    code.store_x(POSITION);
    if let Some(interface) = interface {
        code.load((libc::SKF_AD_OFF + libc::SKF_AD_IFINDEX) as u32);
        code.drop_unless_equal(interface);
    }
    code.load(MESSAGE);
    code.drop_unless_equal(u32::from_be_bytes(*b"RTPS"));
    code.end_of_message();
    let begin = code.jump();
    code.verdicts();
    code.land(begin);
    for _ in 0..length.head {
        code.submessage();
    }
    code.samples(length.samples);
    code.store_x(POSITION);
    for _ in 0..length.tail {
        code.submessage();
    }
    code.leave(DROP);
    code.code
}

/// Writes the program. X holds the position of the submessage that is looked at.
#[derive(Default)]
struct Assembler {
    code: Vec<libc::sock_filter>,
    /// Jumps to the next instruction that drops, or passes, the datagram.
    drops: Vec<Jump>,
    passes: Vec<Jump>,
}

/// An instruction that jumps to where [`Assembler::land`] is called, if its test is true or if it
/// is false.
#[must_use]
struct Jump {
    at: usize,
    if_true: bool,
}

impl Assembler {
    /// A run of samples. Goes on with the first submessage that is none, or after `count` of them.
    fn samples(&mut self, count: usize) {
        /// So that jumps reach the end of a group.
        const GROUP: usize = 10;
        let mut done = Vec::new();
        for first in (0..count).step_by(GROUP) {
            let mut others = Vec::new();
            for _ in first..count.min(first + GROUP) {
                self.begin_submessage();
                self.and(KIND | LITTLE_ENDIAN_FLAG);
                others.push(self.jump_unless_equal(LITTLE_ENDIAN_DATA));
                self.load_at(SUBMESSAGE_HEADER + 12);
                self.drop_if_set(ABOVE_255);
                self.load_half_at(2);
                self.pass_if_equal(0);
                self.swap_half();
                self.advance();
                self.end_of_message();
            }
            let more = self.jump();
            others.into_iter().for_each(|jump| self.land(jump));
            done.push(self.far_jump());
            self.verdicts();
            self.land(more);
        }
        done.into_iter().for_each(|jump| self.land_far(jump));
    }

    /// Loads the first word of a submessage, or of the one after a timestamp.
    fn begin_submessage(&mut self) {
        self.load_at(0);
        let other = self.jump_unless_equal(TIMESTAMP);
        self.copy_x();
        self.add(TIMESTAMP_LENGTH);
        self.move_to_x();
        self.load_at(0);
        self.land(other);
    }

    /// A submessage of any kind.
    fn submessage(&mut self) {
        self.begin_submessage();
        self.store_x(POSITION);
        self.drop_unless_set(LITTLE_ENDIAN_FLAG);
        self.store(HEAD);
        self.shift_right(24);
        let data = self.jump_if_equal(DATA);
        let heartbeat = self.jump_if_equal(HEARTBEAT);
        let acknowledgement = self.jump_if_equal(ACKNACK);
        let fragment = self.jump_if_equal(DATA_FRAG);
        let request = self.jump_if_equal(NACK_FRAG);
        let harmless = self.jump_unless_equal(GAP);

        // A GAP from sample 1 tells a late reader that it gets nothing from before: it may be long,
        // and costs the library nothing.
        self.load_at(FIRST);
        let late = self.jump_unless_equal(0);
        self.load_at(FIRST + 4);
        let from_one = self.jump_if_equal(ONE);
        self.land(late);
        self.land(heartbeat);
        self.window();
        let in_window = self.jump();

        self.land(from_one);
        self.load_at(LAST);
        self.drop_if_set(ABOVE_255);
        let in_order = self.jump();

        self.land(request);
        // Number of the first fragment, from 1.
        self.load_at(SUBMESSAGE_HEADER + 16);
        self.drop_if_set(ABOVE_65535);
        self.drop_if_equal(0);
        self.land(acknowledgement);
        self.load_at(SUBMESSAGE_HEADER + 8);
        self.drop_if_set(ABOVE_255);
        let answerable = self.jump();

        self.land(fragment);
        // Size of the whole sample.
        self.load_at(SUBMESSAGE_HEADER + 28);
        self.drop_if_set(FROM_LARGEST_SAMPLE);
        self.land(data);
        self.load_at(SUBMESSAGE_HEADER + 12);
        self.drop_if_set(ABOVE_255);

        [harmless, in_window, in_order, answerable].into_iter().for_each(|jump| self.land(jump));
        self.next_submessage();
    }

    /// First and last sequence number of HEARTBEAT, or begin and end of GAP.
    fn window(&mut self) {
        self.load_at(LAST);
        self.drop_if_set(ABOVE_255);
        self.store(OTHER);
        // Upper words alike.
        self.load_at(FIRST);
        self.load_x(OTHER);
        self.drop_unless_equal_x();
        self.load_x(POSITION);
        // The upper halves of the lower words differ by one at most: a last one before the first
        // is an empty range.
        self.load_upper_half_at(FIRST + 4);
        self.store(OTHER);
        self.load_upper_half_at(LAST + 4);
        self.load_x(OTHER);
        self.subtract_x();
        self.load_x(POSITION);
        self.add(1);
        self.drop_if_above(2);
    }

    /// Goes on to the next submessage, or leaves at the end of the message. A length of 0 means up
    /// to the end, except where it is one (DDSI-RTPS 2.5, 9.4.5.1.3).
    fn next_submessage(&mut self) {
        self.load_slot(HEAD);
        self.and(0xffff);
        let has_length = self.jump_unless_equal(0);
        self.load_slot(HEAD);
        self.shift_right(24);
        let empty = self.jump_if_equal(PAD);
        self.pass_unless_equal(INFO_TS);
        self.land(empty);
        self.and(0);
        self.land(has_length);
        self.swap_half();
        self.advance();
        self.end_of_message();
        let more = self.jump();
        self.verdicts();
        self.land(more);
    }

    /// Moves X over a submessage of A bytes.
    fn advance(&mut self) {
        self.add(SUBMESSAGE_HEADER);
        self.add_x();
        self.move_to_x();
    }

    /// Passes the message if X is its end, drops it if X is beyond.
    fn end_of_message(&mut self) {
        self.emit(libc::BPF_LD | libc::BPF_W | libc::BPF_LEN, 0);
        let more = self.jump_when(libc::BPF_JGT | libc::BPF_X, 0, true);
        let end = self.jump_when(libc::BPF_JEQ | libc::BPF_X, 0, true);
        self.passes.push(end);
        let beyond = Jump { at: self.code.len() - 1, if_true: false };
        self.drops.push(beyond);
        self.land(more);
    }

    /// Where all jumps to a verdict since the last ones land. Nothing else comes here.
    fn verdicts(&mut self) {
        std::mem::take(&mut self.passes).into_iter().for_each(|jump| self.land(jump));
        self.leave(PASS);
        std::mem::take(&mut self.drops).into_iter().for_each(|jump| self.land(jump));
        self.leave(DROP);
    }

    /// The two upper bytes of a little-endian word.
    fn load_upper_half_at(&mut self, offset: u32) {
        self.load_half_at(offset + 2);
        self.swap_half();
    }

    /// Swaps the bytes of A, below 65536.
    fn swap_half(&mut self) {
        self.emit(libc::BPF_ALU | libc::BPF_MUL | libc::BPF_K, 0x0100_0100);
        self.shift_right(16);
    }

    fn load(&mut self, offset: u32) {
        self.emit(libc::BPF_LD | libc::BPF_W | libc::BPF_ABS, offset);
    }

    /// The word at `offset` in the submessage; a datagram that is shorter is dropped.
    fn load_at(&mut self, offset: u32) {
        self.emit(libc::BPF_LD | libc::BPF_W | libc::BPF_IND, offset);
    }

    fn load_half_at(&mut self, offset: u32) {
        self.emit(libc::BPF_LD | libc::BPF_H | libc::BPF_IND, offset);
    }

    fn load_slot(&mut self, slot: u32) {
        self.emit(libc::BPF_LD | libc::BPF_MEM, slot);
    }

    fn load_x(&mut self, slot: u32) {
        self.emit(libc::BPF_LDX | libc::BPF_MEM, slot);
    }

    fn set_x(&mut self, value: u32) {
        self.emit(libc::BPF_LDX | libc::BPF_IMM, value);
    }

    fn store(&mut self, slot: u32) {
        self.emit(libc::BPF_ST, slot);
    }

    fn store_x(&mut self, slot: u32) {
        self.emit(libc::BPF_STX, slot);
    }

    fn move_to_x(&mut self) {
        self.emit(libc::BPF_MISC | libc::BPF_TAX, 0);
    }

    fn copy_x(&mut self) {
        self.emit(libc::BPF_MISC | libc::BPF_TXA, 0);
    }

    fn add(&mut self, value: u32) {
        self.emit(libc::BPF_ALU | libc::BPF_ADD | libc::BPF_K, value);
    }

    fn add_x(&mut self) {
        self.emit(libc::BPF_ALU | libc::BPF_ADD | libc::BPF_X, 0);
    }

    fn subtract_x(&mut self) {
        self.emit(libc::BPF_ALU | libc::BPF_SUB | libc::BPF_X, 0);
    }

    fn and(&mut self, mask: u32) {
        self.emit(libc::BPF_ALU | libc::BPF_AND | libc::BPF_K, mask);
    }

    fn shift_right(&mut self, bits: u32) {
        self.emit(libc::BPF_ALU | libc::BPF_RSH | libc::BPF_K, bits);
    }

    fn leave(&mut self, verdict: u32) {
        self.emit(libc::BPF_RET | libc::BPF_K, verdict);
    }

    fn drop_unless_equal(&mut self, value: u32) {
        let jump = self.jump_when(libc::BPF_JEQ | libc::BPF_K, value, false);
        self.drops.push(jump);
    }

    fn drop_if_equal(&mut self, value: u32) {
        let jump = self.jump_when(libc::BPF_JEQ | libc::BPF_K, value, true);
        self.drops.push(jump);
    }

    fn drop_unless_equal_x(&mut self) {
        let jump = self.jump_when(libc::BPF_JEQ | libc::BPF_X, 0, false);
        self.drops.push(jump);
    }

    fn drop_if_above(&mut self, value: u32) {
        let jump = self.jump_when(libc::BPF_JGT | libc::BPF_K, value, true);
        self.drops.push(jump);
    }

    fn drop_if_set(&mut self, bits: u32) {
        let jump = self.jump_when(libc::BPF_JSET | libc::BPF_K, bits, true);
        self.drops.push(jump);
    }

    fn drop_unless_set(&mut self, bits: u32) {
        let jump = self.jump_when(libc::BPF_JSET | libc::BPF_K, bits, false);
        self.drops.push(jump);
    }

    fn pass_if_equal(&mut self, value: u32) {
        let jump = self.jump_when(libc::BPF_JEQ | libc::BPF_K, value, true);
        self.passes.push(jump);
    }

    fn pass_unless_equal(&mut self, value: u32) {
        let jump = self.jump_when(libc::BPF_JEQ | libc::BPF_K, value, false);
        self.passes.push(jump);
    }

    fn jump_if_equal(&mut self, value: u32) -> Jump {
        self.jump_when(libc::BPF_JEQ | libc::BPF_K, value, true)
    }

    fn jump_unless_equal(&mut self, value: u32) -> Jump {
        self.jump_when(libc::BPF_JEQ | libc::BPF_K, value, false)
    }

    /// A test that is always true: no bit is below 0.
    fn jump(&mut self) -> Jump {
        self.jump_when(libc::BPF_JGE | libc::BPF_K, 0, true)
    }

    fn jump_when(&mut self, test: u32, value: u32, if_true: bool) -> Jump {
        self.emit(libc::BPF_JMP | test, value);
        Jump { at: self.code.len() - 1, if_true }
    }

    /// Makes `jump` come here.
    fn land(&mut self, jump: Jump) {
        let distance = self.code.len() - 1 - jump.at;
        let distance = u8::try_from(distance).expect("a submessage takes fewer instructions");
        let instruction = &mut self.code[jump.at];
        let side = if jump.if_true { &mut instruction.jt } else { &mut instruction.jf };
        *side = distance;
    }

    /// Jumps to where [`Assembler::land_far`] is called, at any distance.
    fn far_jump(&mut self) -> usize {
        self.emit(libc::BPF_JMP | libc::BPF_JA, 0);
        self.code.len() - 1
    }

    fn land_far(&mut self, at: usize) {
        self.code[at].k = (self.code.len() - 1 - at) as u32;
    }

    fn emit(&mut self, code: u32, k: u32) {
        self.code.push(libc::sock_filter { code: code as u16, jt: 0, jf: 0, k });
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::net::UdpSocket;
    use std::os::fd::AsRawFd as _;

    use proptest::prelude::*;
    use proptest::test_runner::{Config, TestRunner};

    use super::*;

    /// A filtered socket on loopback, and one that sends to it. What is sent over loopback is
    /// there, or dropped, when the call returns.
    struct Link {
        receiver: UdpSocket,
        sender: UdpSocket,
    }

    impl Link {
        fn new(interface: Option<u32>) -> Link {
            Link::with(interface, LENGTHS[0])
        }

        fn with(interface: Option<u32>, length: Length) -> Link {
            let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
            receiver.set_nonblocking(true).unwrap();
            attach_program(receiver.as_raw_fd(), &mut program(interface, length)).unwrap();
            let sender = UdpSocket::bind("127.0.0.1:0").unwrap();
            sender.connect(receiver.local_addr().unwrap()).unwrap();
            Link { receiver, sender }
        }

        fn passes(&self, datagram: &[u8]) -> bool {
            self.sender.send(datagram).unwrap();
            let mut buffer = [0; 1 << 16];
            match self.receiver.recv(&mut buffer) {
                Ok(length) => {
                    assert_eq!(&buffer[..length], datagram);
                    true
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => false,
                Err(error) => panic!("{error}"),
            }
        }
    }

    fn message(submessages: &[Vec<u8>]) -> Vec<u8> {
        let mut message = b"RTPS\x02\x03\x01\x0f".to_vec();
        message.extend(1..=12);
        submessages.iter().for_each(|submessage| message.extend(submessage));
        message
    }

    fn submessage(kind: u32, body: &[u8]) -> Vec<u8> {
        let length = u16::try_from(body.len()).unwrap().to_le_bytes();
        [&[kind as u8, 1, length[0], length[1]], body].concat()
    }

    fn number(value: u64) -> [u8; 8] {
        let (high, low) = ((value >> 32) as u32, value as u32);
        [high.to_le_bytes(), low.to_le_bytes()].concat().try_into().unwrap()
    }

    const ENTITIES: [u8; 8] = [0, 0, 3, 0xc7, 0, 0, 3, 0xc2];

    fn range(kind: u32, first: u64, last: u64) -> Vec<u8> {
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
        let link = Link::new(None);
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
        let empty = |kind: u32| vec![kind as u8, 1, 0, 0];
        assert!(link.passes(&message(&[empty(PAD), empty(INFO_TS), data(1)])));
        // The last one may leave its length to that of the message.
        let mut last = data(1);
        last[2..4].fill(0);
        assert!(link.passes(&message(&[timestamp(), last])));
    }

    #[test]
    fn counts_beyond_what_the_nodes_use_are_dropped() {
        let link = Link::new(None);
        let negative = u64::MAX;
        for hostile in [
            fragment(1, LARGEST_SAMPLE as u32),
            fragment(1, u32::MAX),
            fragment(1 << 40, 1000),
            range(HEARTBEAT, 1, 1 << 40),
            range(HEARTBEAT, 1, 1 << 31),
            range(HEARTBEAT, 1, 2 * LARGEST_WINDOW),
            range(HEARTBEAT, 1 << 40, 1 << 40),
            range(HEARTBEAT, negative, 5),
            range(GAP, 100, 1 << 40),
            range(GAP, 100, 2 * LARGEST_WINDOW + 100),
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
        let link = Link::new(None);
        for first in [1, 65_535, 65_537, (1 << 24) - 3, (1 << 32) + 65_000, (1 << 39) + 1] {
            for width in [0, 1, 255, 65_535, LARGEST_WINDOW] {
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
        let link = Link::new(None);
        let whole = message(&[timestamp(), data(1), acknack(3)]);
        assert!(link.passes(&whole));
        for length in 0..whole.len() {
            // After the header and after the sample; a timestamp for nothing is no message.
            let ends_a_submessage = [20, 64].contains(&length);
            assert_eq!(link.passes(&whole[..length]), ends_a_submessage, "{length} bytes");
        }
        let mut big_endian = data(1);
        big_endian[1] = 0;
        assert!(!link.passes(&message(&[big_endian])));
        assert!(!link.passes(b"RTPX\x02\x03\x01\x0f0123456789ab"));
    }

    #[test]
    fn a_message_of_more_submessages_than_the_program_sees_is_dropped() {
        let link = Link::new(None);
        let Length { head, samples, tail } = LENGTHS[0];
        let pairs = |count: usize| (1..=count as u64).flat_map(|n| [timestamp(), data(n)]);
        let answers = |count: usize| (1..=count as u64).map(acknack);
        let join = |parts: [Vec<Vec<u8>>; 3]| message(&parts.concat());
        let full =
            [answers(head).collect(), pairs(samples).collect(), answers(tail).collect::<Vec<_>>()];
        assert!(link.passes(&join(full.clone())));
        for part in 0..3 {
            let mut longer = full.clone();
            let first = longer[part][0].clone();
            longer[part].push(if part == 1 { data(1) } else { first });
            let passes = link.passes(&join(longer));
            // A sample more takes the place of another submessage after the run.
            assert!(!passes, "part {part}");
        }
        assert!(link.passes(&message(&pairs(head + samples + tail).collect::<Vec<_>>())));
        assert!(!link.passes(&message(&pairs(head + samples + tail + 1).collect::<Vec<_>>())));
        // Without samples in between.
        assert!(link.passes(&message(&answers(head + tail).collect::<Vec<_>>())));
        assert!(!link.passes(&message(&answers(head + tail + 1).collect::<Vec<_>>())));
    }

    #[test]
    fn shorter_programs_judge_alike() {
        for length in LENGTHS {
            let link = Link::with(None, length);
            assert!(link.passes(&message(&[timestamp(), data(1), range(HEARTBEAT, 1, 1)])));
            assert!(!link.passes(&message(&[timestamp(), data(1), range(HEARTBEAT, 1, 1 << 40)])));
        }
    }

    #[test]
    fn only_what_comes_through_the_interface_passes() {
        let datagram = message(&[data(1)]);
        let interface = loopback().unwrap();
        assert!(Link::new(Some(interface)).passes(&datagram));
        assert!(!Link::new(Some(interface + 1)).passes(&datagram));
    }

    /// The rules again, on numbers.
    fn is_harmless(datagram: &[u8]) -> bool {
        let Some(mut rest) = datagram.get(20..) else { return false };
        if !datagram.starts_with(b"RTPS") {
            return false;
        }
        let Length { mut head, mut samples, mut tail } = LENGTHS[0];
        while !rest.is_empty() {
            if rest.starts_with(&[9, 1, 8, 0]) {
                match rest.get(12..) {
                    None | Some([]) => return false,
                    Some(after) => rest = after,
                }
            }
            if head > 0 {
                head -= 1;
            } else if samples > 0 && rest[0] == 0x15 && rest.get(1).is_some_and(|f| f % 2 == 1) {
                samples -= 1;
            } else if tail > 0 {
                (samples, tail) = (0, tail - 1);
            } else {
                return false;
            }
            let word = |at: usize| {
                rest.get(at..at + 4).map(|bytes| u32::from_le_bytes(bytes.try_into().unwrap()))
            };
            let number = |at: usize| Some((u64::from(word(at)?) << 32) | u64::from(word(at + 4)?));
            let is_number = |at: usize| number(at).is_some_and(|number| number < 1 << 40);
            let Some(first) = word(0) else { return false };
            if first & 0x100 == 0 {
                return false;
            }
            let kind = first & 0xff;
            let holds = match kind {
                HEARTBEAT | GAP => {
                    is_number(12) && is_number(20) && {
                        let (first, last) = (number(12).unwrap(), number(20).unwrap());
                        let step = (last >> 16).abs_diff(first >> 16);
                        kind == GAP && first == 1 || step <= 1 && first >> 32 == last >> 32
                    }
                }
                ACKNACK => is_number(12),
                NACK_FRAG => {
                    is_number(12) && word(20).is_some_and(|first| (1..65_536).contains(&first))
                }
                DATA => is_number(16),
                DATA_FRAG => {
                    is_number(16) && word(32).is_some_and(|size| size < LARGEST_SAMPLE as u32)
                }
                _ => true,
            };
            if !holds {
                return false;
            }
            let length = (first >> 16) as usize;
            if length == 0 && ![PAD, INFO_TS].contains(&kind) {
                return true;
            }
            let Some(after) = rest.get(4 + length..) else { return false };
            rest = after;
        }
        true
    }

    /// Datagrams of well-formed submessages with a few bytes changed, and some cut off.
    fn mutated() -> impl Strategy<Value = Vec<u8>> {
        let count = || prop_oneof![0..300_u64, 0..1_u64 << 33, 0..1_u64 << 41, any::<u64>()];
        let piece = prop_oneof![
            Just(timestamp()),
            count().prop_map(data),
            count().prop_map(acknack),
            (count(), any::<u32>(), 0..32_u32).prop_map(|(n, size, up)| fragment(n, size >> up)),
            (count(), any::<u32>(), 0..32_u32)
                .prop_map(|(n, first, up)| fragment_request(n, first >> up)),
            (count(), count(), any::<bool>()).prop_map(|(first, last, gap)| range(
                if gap { GAP } else { HEARTBEAT },
                first,
                last
            )),
            (count(), 0..200_000_u64, any::<bool>()).prop_map(|(first, width, gap)| {
                range(if gap { GAP } else { HEARTBEAT }, first, first.wrapping_add(width))
            }),
            (any::<u8>(), prop::collection::vec(any::<u8>(), 0..60))
                .prop_map(|(kind, body)| submessage(kind.into(), &body)),
        ];
        let changes = prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..3);
        (prop::collection::vec(piece, 0..8), changes, 0..40_usize).prop_map(
            |(pieces, changes, cut)| {
                let mut datagram = message(&pieces);
                for (at, value) in changes {
                    let at = at.index(datagram.len());
                    datagram[at] = value;
                }
                // One in four is cut.
                datagram.truncate(datagram.len() - if cut < 10 { cut } else { 0 });
                datagram
            },
        )
    }

    #[test]
    fn the_program_judges_as_the_rules_do() {
        let link = Link::new(None);
        let (passed, dropped) = (Cell::new(0), Cell::new(0));
        let mut runner =
            TestRunner::new(Config { failure_persistence: None, ..Config::with_cases(5000) });
        runner
            .run(&mutated(), |datagram| {
                let harmless = is_harmless(&datagram);
                let count = if harmless { &passed } else { &dropped };
                count.set(count.get() + 1);
                prop_assert_eq!(link.passes(&datagram), harmless);
                Ok(())
            })
            .unwrap();
        let (passed, dropped) = (passed.get(), dropped.get());
        assert!(passed > 500 && dropped > 500, "{passed} passed, {dropped} dropped");
    }

    #[test]
    fn a_program_fits_into_the_kernel() {
        let length = program(Some(1), LENGTHS[0]).len();
        assert!((3500..=libc::BPF_MAXINSNS as usize).contains(&length), "{length} instructions");
    }
}
