//! A ROS domain for a run of its own: two runs on one machine do not hear each other.

use std::fs::File;
use std::net::{Ipv4Addr, UdpSocket};
use std::os::fd::AsRawFd as _;

/// Domains whose ports lie below those that Linux gives to clients (32768 and up).
const CANDIDATES: std::ops::RangeInclusive<u16> = 1..=100;

/// A domain that this process keeps for itself until it is dropped.
#[derive(Debug)]
pub struct OwnDomain {
    number: u16,
    /// Locked; the lock ends with the file, also where the process is killed.
    _lock: File,
}

impl OwnDomain {
    /// Takes a domain in which no process on this machine takes part, and that no other run has
    /// taken.
    ///
    /// # Errors
    /// Where there is none.
    pub fn take() -> std::io::Result<OwnDomain> {
        let count = CANDIDATES.end() - CANDIDATES.start() + 1;
        // Runs that start together begin at different places.
        let first = (std::process::id() % u32::from(count)) as u16;
        (0..count)
            .map(|k| CANDIDATES.start() + (first + k) % count)
            .find_map(|number| OwnDomain::lock(number).filter(|_| is_silent(number)))
            .ok_or_else(|| std::io::Error::other("every ROS domain from 1 to 100 is in use here"))
    }

    /// Its number.
    pub fn number(&self) -> u16 {
        self.number
    }

    fn lock(number: u16) -> Option<OwnDomain> {
        // SAFETY: a plain query.
        let user = unsafe { libc::getuid() };
        let path = std::env::temp_dir().join(format!("ros_domain_{number}.{user}.lock"));
        let file = File::options().create(true).append(true).open(path).ok()?;
        // SAFETY: the descriptor is that of an open file.
        let locked = unsafe { libc::flock(file.as_raw_fd(), libc::LOCK_EX | libc::LOCK_NB) } == 0;
        locked.then_some(OwnDomain { number, _lock: file })
    }
}

/// Whether no participant listens on the first ports of the domain (DDSI-RTPS 2.5, 9.6.2.3).
fn is_silent(domain: u16) -> bool {
    let base = 7400 + 250 * domain;
    [base, base + 10].into_iter().all(|port| UdpSocket::bind((Ipv4Addr::UNSPECIFIED, port)).is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_runs_take_two_domains_and_give_them_back() {
        let (one, other) = (OwnDomain::take().unwrap(), OwnDomain::take().unwrap());
        assert_ne!(one.number(), other.number());
        let number = one.number();
        assert!(OwnDomain::lock(number).is_none());
        drop(one);
        assert!(OwnDomain::lock(number).is_some());
    }
}
