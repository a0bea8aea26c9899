//! Machines that multicast may not reach.
//!
//! The DDS library sends to the multicast addresses that a peer names, where it names any. A peer
//! that has announced itself to this machine alone may be one that multicast does not reach
//! ([static peers](super::static_peers)): from its machine the library sees no multicast addresses,
//! and sends to the others.

use std::collections::HashSet;
use std::net::Ipv4Addr;
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};

/// Machines that are remembered. Addresses can be forged.
const MOST: usize = 1024;

/// Parameters of an announcement that are multicast addresses: of an endpoint, of the discovery of
/// a participant, of its data (DDSI-RTPS 2.5, table 9.14).
const MULTICAST_LOCATORS: [u16; 3] = [0x0030, 0x0033, 0x0048];
const PAD: u16 = 0x0000;
const SENTINEL: u16 = 0x0001;

static MACHINES: LazyLock<Mutex<HashSet<Ipv4Addr>>> = LazyLock::new(Mutex::default);

fn machines() -> MutexGuard<'static, HashSet<Ipv4Addr>> {
    MACHINES.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A participant of `machine` has announced itself to this machine alone.
pub fn add(machine: Ipv4Addr) {
    let mut machines = machines();
    if machines.len() >= MOST {
        // Those that are there announce themselves again.
        machines.clear();
    }
    machines.insert(machine);
}

/// A participant of `machine` has announced itself by multicast.
pub fn remove(machine: Ipv4Addr) {
    machines().remove(&machine);
}

/// Whether multicast may not reach it.
pub fn is(machine: Ipv4Addr) -> bool {
    machines().contains(&machine)
}

/// Makes padding of the multicast addresses in the DATA submessage of an announcement, whose body
/// this is.
pub fn hide_multicast(body: &mut [u8], flags: u8) {
    const HAS_INLINE_QOS: u8 = 1 << 1;
    let is_little_endian = flags & 1 == 1;
    // How far it is from the end of this number to what follows the head.
    let Some(&[low, high]) = body.get(2..4).and_then(<[u8]>::first_chunk) else { return };
    let head = if is_little_endian { [low, high] } else { [high, low] };
    let at = 4 + usize::from(u16::from_le_bytes(head));
    let mut list = Parameters { body, at, is_little_endian };
    if flags & HAS_INLINE_QOS != 0 {
        while list.next().is_some_and(|kind| kind != SENTINEL) {}
    }
    // A list of parameters, big or little endian (10.2.1.2); then two bytes of options.
    match list.body.get(list.at..list.at + 4) {
        Some(&[0, 2, ..]) => list.is_little_endian = false,
        Some(&[0, 3, ..]) => list.is_little_endian = true,
        _ => return,
    }
    list.at += 4;
    loop {
        let begin = list.at;
        match list.next() {
            None | Some(SENTINEL) => return,
            Some(kind) if MULTICAST_LOCATORS.contains(&kind) => {
                list.body[begin..begin + 2].copy_from_slice(&PAD.to_ne_bytes());
            }
            Some(_) => {}
        }
    }
}

/// A list of parameters (9.4.2.11).
struct Parameters<'a> {
    body: &'a mut [u8],
    at: usize,
    is_little_endian: bool,
}

impl Parameters<'_> {
    /// The kind of the next one, which is stepped over.
    fn next(&mut self) -> Option<u16> {
        let header: [u8; 4] = self.body.get(self.at..self.at + 4)?.try_into().ok()?;
        let word = |bytes: [u8; 2]| match self.is_little_endian {
            true => u16::from_le_bytes(bytes),
            false => u16::from_be_bytes(bytes),
        };
        let (kind, length) = (word([header[0], header[1]]), word([header[2], header[3]]));
        self.at += 4 + if kind == SENTINEL { 0 } else { usize::from(length) };
        (self.at <= self.body.len()).then_some(kind)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Flags, the way to what follows the head, two entities and a number.
    const HEAD: [u8; 20] = {
        let mut head = [0; 20];
        head[2] = 16;
        head
    };

    fn parameter(kind: u16, value: &[u8]) -> Vec<u8> {
        [&kind.to_le_bytes()[..], &(value.len() as u16).to_le_bytes(), value].concat()
    }

    #[test]
    fn multicast_addresses_become_padding_of_the_same_length() {
        let announcement = |kinds: [u16; 4]| {
            let parameters = kinds.map(|kind| parameter(kind, &[7; 24])).concat();
            let inline = [parameter(0x0033, &[1; 16]), parameter(SENTINEL, &[])].concat();
            let end = parameter(SENTINEL, &[]);
            [&HEAD[..], &inline, &[0, 3, 0, 0], &parameters, &end, &parameter(0x0033, &[])].concat()
        };
        let mut body = announcement([0x0032, 0x0033, 0x0048, 0x0030]);
        hide_multicast(&mut body, 0b111);
        assert_eq!(body, announcement([0x0032, PAD, PAD, PAD]));
    }

    #[test]
    fn machines_without_number_fill_a_room_of_fixed_size() {
        let machine = |number: u32| Ipv4Addr::from(0xc633_0000 + number);
        for number in 0..3 * MOST as u32 {
            add(machine(number));
            assert!(is(machine(number)) && machines().len() <= MOST);
        }
        remove(machine(3 * MOST as u32 - 1));
        assert!(!is(machine(3 * MOST as u32 - 1)));
    }

    #[test]
    fn what_is_cut_off_is_left_as_it_is() {
        let list = [&HEAD[..], &[0, 3, 0, 0], &parameter(0x0033, &[7; 24])].concat();
        for length in 0..list.len() {
            for flags in 0..8 {
                let mut body = list[..length].to_vec();
                hide_multicast(&mut body, flags);
                assert_eq!(body, list[..length]);
            }
        }
    }
}
