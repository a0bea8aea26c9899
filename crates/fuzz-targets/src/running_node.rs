//! RTPS datagrams at a running node.
//!
//! The node runs in this process, with the sockets and threads that it has in the programs. It must
//! still hear a publisher after each datagram. Datagrams announce random addresses, and
//! the node sends to them: hence only where there is no network but the loopback interface
//! (`unshare --map-root-user --net`).

use std::ffi::CStr;
use std::io;
use std::net::UdpSocket;
use std::os::fd::AsRawFd;
use std::path::Path;
use std::sync::{LazyLock, Mutex, PoisonError};
use std::time::{Duration, Instant};

use friction_stage::node::domain::OwnDomain;
use friction_stage::node::participant::{Network, Participant, Reach};
use friction_stage::node::qos::Qos;
use friction_stage_data::message::Float64MultiArray;
use ros2_client::{NodeOptions, Publisher, Subscription};

/// How long a sample may take; one that is lost in a full buffer is sent again.
const PATIENCE: Duration = Duration::from_secs(60);
const REPEATED: Duration = Duration::from_millis(500);

struct RunningNode {
    /// Of the node; the publisher is another participant.
    subscription: Subscription<Float64MultiArray>,
    publisher: Publisher<Float64MultiArray>,
    stranger: UdpSocket,
    /// Where the node hears what is sent to it alone: discovery and samples (DDSI-RTPS 2.5,
    /// 9.6.2.3).
    ports: [u16; 2],
    sent: u64,
    _participants: [Participant; 2],
    _domain: OwnDomain,
}

impl RunningNode {
    fn start() -> Self {
        turn_loopback_on().expect("the loopback interface can be turned on");
        let domain = OwnDomain::take().expect("a free domain");
        let network = Network { domain: domain.number(), reach: Reach::Localhost };
        let join = |name| {
            Participant::join(network, "/", name, NodeOptions::new()).expect("a participant")
        };
        // The first one of a domain has the first ports.
        let (node, other) = (join("node"), join("other"));
        let topic = |participant: &Participant| {
            let qos = Qos::reliable(100);
            participant.topic("/numbers", "std_msgs", "Float64MultiArray", &qos).expect("a topic")
        };
        let subscription = {
            let topic = topic(&node);
            node.node().create_subscription(&topic, None).expect("a subscription")
        };
        let publisher = {
            let topic = topic(&other);
            other.node().create_publisher(&topic, None).expect("a publisher")
        };
        let first = 7400 + 250 * domain.number();
        let mut running = Self {
            subscription,
            publisher,
            stranger: UdpSocket::bind("127.0.0.1:0").expect("a socket"),
            ports: [first + 10, first + 11],
            sent: 0,
            _participants: [node, other],
            _domain: domain,
        };
        running.hear();
        running
    }

    /// Sends the next number until it is heard.
    fn hear(&mut self) {
        self.sent += 1;
        // A stranger may have sent other numbers.
        let number = self.sent as f64;
        let begin = Instant::now();
        while begin.elapsed() < PATIENCE {
            let message = Float64MultiArray { data: vec![number], ..Default::default() };
            let published = Instant::now();
            let _ = self.publisher.publish(message);
            while published.elapsed() < REPEATED {
                match self.subscription.take() {
                    Ok(Some((message, _))) if message.data == [number] => return,
                    Ok(Some(_)) => {}
                    Ok(None) | Err(_) => std::thread::sleep(Duration::from_micros(50)),
                }
            }
        }
        panic!("the node no longer hears: sample {number} did not come within {PATIENCE:?}");
    }
}

/// Sends a datagram to both ports of a running node.
///
/// # Panics
/// There is another network, or the node does not hear its publisher any more.
pub fn rtps(bytes: &[u8], _: &Path) {
    static NODE: LazyLock<Mutex<RunningNode>> = LazyLock::new(|| Mutex::new(RunningNode::start()));
    let mut node = NODE.lock().unwrap_or_else(PoisonError::into_inner);
    for port in node.ports {
        // Longer than a datagram can be: nothing is sent.
        let _ = node.stranger.send_to(bytes, ("127.0.0.1", port));
    }
    node.hear();
}

/// Turns on the loopback interface of a new network namespace.
///
/// # Errors
/// Another interface is on, or the interfaces cannot be read or set.
fn turn_loopback_on() -> io::Result<()> {
    if let Some(name) = other_interface()? {
        return Err(io::Error::other(format!(
            "{name} is on: this target runs only where there is no other network, see the README"
        )));
    }
    let socket = UdpSocket::bind("0.0.0.0:0")?;
    // SAFETY: zero is a request; both calls get one whose name ends with a zero.
    unsafe {
        let mut request: libc::ifreq = std::mem::zeroed();
        for (to, from) in request.ifr_name.iter_mut().zip(c"lo".to_bytes()) {
            *to = *from as libc::c_char;
        }
        request.ifr_ifru.ifru_flags = (libc::IFF_UP | libc::IFF_RUNNING) as libc::c_short;
        match libc::ioctl(socket.as_raw_fd(), libc::SIOCSIFFLAGS, &raw const request) {
            0 => Ok(()),
            _ => Err(io::Error::last_os_error()),
        }
    }
}

/// An interface that is on and not the loopback interface.
fn other_interface() -> io::Result<Option<String>> {
    let mut first: *mut libc::ifaddrs = std::ptr::null_mut();
    // SAFETY: the list is read before it is freed; its names end with a zero.
    unsafe {
        if libc::getifaddrs(&raw mut first) != 0 {
            return Err(io::Error::last_os_error());
        }
        let (mut found, mut next) = (None, first);
        while let Some(interface) = next.as_ref() {
            let flags = interface.ifa_flags as libc::c_int;
            if flags & libc::IFF_UP != 0 && flags & libc::IFF_LOOPBACK == 0 {
                found = Some(CStr::from_ptr(interface.ifa_name).to_string_lossy().into_owned());
            }
            next = interface.ifa_next;
        }
        libc::freeifaddrs(first);
        Ok(found)
    }
}
