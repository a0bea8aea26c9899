//! What the filter of datagrams costs: a datagram of a sample received through it, and past it.
//!
//! `cargo bench --bench datagrams -- [--rounds N]`
//!
//! From a writer of discovery, which the DDS library knows from the start, and from one that it
//! does not know yet, whose datagrams the filter also keeps. The ways take turns; compare them, and
//! with the round trip of `--bench lockstep`, not the numbers of two machines.

use std::net::UdpSocket;
use std::os::fd::AsRawFd;
use std::time::Instant;

use friction_stage::node::domain::OwnDomain;
use friction_stage::node::participant::{Network, Participant, Reach};
use ros2_client::NodeOptions;

/// Datagrams that wait at once: they fit into the buffer of a socket.
const BATCH: usize = 100;
const BATCHES: usize = 200;

type Receive = unsafe fn(libc::c_int, *mut libc::msghdr) -> libc::ssize_t;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> =
        std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let rounds: usize = match &arguments[..] {
        [] => 15,
        [flag, value] if flag == "--rounds" => value.parse()?,
        _ => anyhow::bail!("unknown arguments {arguments:?}: known is --rounds N"),
    };
    // It turns on the filter, which from then on knows how far this process is heard.
    let domain = OwnDomain::take()?;
    let network = Network { domain: domain.number(), reach: Reach::Localhost };
    let _participant = Participant::join(network, "/", "datagrams", NodeOptions::new())?;

    let (known, unknown) = (sample([0, 0, 0x03, 0xc2]), sample([0, 0, 0x12, 0x03]));
    let ways: [(&str, &[u8], Receive); 3] = [
        ("past the filter", &known, past),
        ("through, of a known writer", &known, through),
        ("through, of an unknown one", &unknown, through),
    ];
    let mut times = ways.map(|_| Vec::new());
    for _ in 0..rounds {
        for ((_, datagram, way), times) in ways.iter().zip(&mut times) {
            times.push(receive(datagram, *way)?);
        }
    }
    println!("{:<28} {:>8} {:>8} {:>8}", "ns per datagram", "least", "median", "most");
    for ((name, ..), times) in ways.iter().zip(&mut times) {
        times.sort_by(f64::total_cmp);
        let (least, median, most) = (times[0], times[times.len() / 2], times[times.len() - 1]);
        println!("{name:<28} {least:>8.0} {median:>8.0} {most:>8.0}");
    }
    Ok(())
}

/// Time to receive one datagram, ns.
fn receive(datagram: &[u8], way: Receive) -> anyhow::Result<f64> {
    let (receiver, sender) = (UdpSocket::bind("127.0.0.1:0")?, UdpSocket::bind("127.0.0.1:0")?);
    sender.connect(receiver.local_addr()?)?;
    let on: libc::c_int = 1;
    // SAFETY: the length is that of the value.
    let asked = unsafe {
        libc::setsockopt(
            receiver.as_raw_fd(),
            libc::IPPROTO_IP,
            libc::IP_PKTINFO,
            (&raw const on).cast(),
            size_of_val(&on) as libc::socklen_t,
        )
    };
    anyhow::ensure!(asked == 0, "{}", std::io::Error::last_os_error());
    let mut nanoseconds = 0;
    for _ in 0..BATCHES {
        for _ in 0..BATCH {
            sender.send(datagram)?;
        }
        let begin = Instant::now();
        for _ in 0..BATCH {
            let length = take(receiver.as_raw_fd(), way);
            anyhow::ensure!(length == datagram.len() as isize, "received {length} bytes");
        }
        nanoseconds += begin.elapsed().as_nanos();
    }
    Ok(nanoseconds as f64 / (BATCH * BATCHES) as f64)
}

/// Receives as the DDS library does: with the source and the interface.
fn take(socket: libc::c_int, way: Receive) -> libc::ssize_t {
    let mut buffer = [0_u8; 65_536];
    let mut control = [0_u64; 16];
    // SAFETY: zero is a message; its places live until the end of the call.
    unsafe {
        let mut source: libc::sockaddr_in = std::mem::zeroed();
        let mut place = libc::iovec { iov_base: buffer.as_mut_ptr().cast(), iov_len: buffer.len() };
        let mut message: libc::msghdr = std::mem::zeroed();
        message.msg_name = (&raw mut source).cast();
        message.msg_namelen = size_of_val(&source) as libc::socklen_t;
        message.msg_iov = &raw mut place;
        message.msg_iovlen = 1;
        message.msg_control = control.as_mut_ptr().cast();
        message.msg_controllen = size_of_val(&control);
        way(socket, &raw mut message)
    }
}

/// # Safety
/// As for recvmsg(2).
unsafe fn past(socket: libc::c_int, message: *mut libc::msghdr) -> libc::ssize_t {
    // SAFETY: see above.
    unsafe { libc::syscall(libc::SYS_recvmsg, socket, message, 0) as libc::ssize_t }
}

/// # Safety
/// As for recvmsg(2).
unsafe fn through(socket: libc::c_int, message: *mut libc::msghdr) -> libc::ssize_t {
    // SAFETY: see above.
    unsafe { libc::recvmsg(socket, message, 0) }
}

/// A sample of 200 bytes of this writer with its destination, its time and a HEARTBEAT after it
/// (DDSI-RTPS 2.5, 9.4.5).
fn sample(writer: [u8; 4]) -> Vec<u8> {
    let submessage = |kind: u8, flags: u8, body: &[u8]| {
        [&[kind, flags][..], &(body.len() as u16).to_le_bytes(), body].concat()
    };
    let entities = [[0, 0, 0x12, 0x04], writer].concat();
    let number = [0, 0, 0, 0, 7, 0, 0, 0];
    let data = [&[0, 0, 16, 0][..], &entities, &number, &[0, 1, 0, 0], &[0x55; 200]].concat();
    let heartbeat = [&entities[..], &number, &number, &[1, 0, 0, 0]].concat();
    [
        &b"RTPS\x02\x03\x01\x0f"[..],
        &[0x77; 12],
        &submessage(0x0e, 1, &[0x66; 12]),
        &submessage(0x09, 1, &[0; 8]),
        &submessage(0x15, 5, &data),
        &submessage(0x07, 1, &heartbeat),
    ]
    .concat()
}
