//! Ends a node that takes too much memory, before it takes that of the machine.
//!
//! The DDS library has no bound of its own: whoever reaches its sockets can make it remember more
//! and more peers. In goes the resident memory of this process, from `/proc/self/statm`; out comes
//! the moment at which it is beyond the bound. A limit of the kernel (`RLIMIT_AS`) would end the
//! process in the middle of an allocation, with the bag open.

use std::time::Duration;

/// Resident memory at which a node ends, bytes. A stage takes 20 MB, with a recording 60 MB.
pub const BOUND: u64 = 1 << 30;

/// Between two looks. The fastest growth that was seen is 1 GB per second.
const INTERVAL: Duration = Duration::from_millis(50);

/// Waits until this process takes more than `bound` bytes; how many they are.
pub async fn exceeds(bound: u64) -> u64 {
    let mut interval = tokio::time::interval(INTERVAL);
    interval.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    loop {
        interval.tick().await;
        // Where it cannot be read there is no bound.
        if let Some(bytes) = resident().filter(|bytes| *bytes > bound) {
            return bytes;
        }
    }
}

/// Resident memory of this process, bytes.
pub fn resident() -> Option<u64> {
    let statm = std::fs::read_to_string("/proc/self/statm").ok()?;
    let pages: u64 = statm.split_whitespace().nth(1)?.parse().ok()?;
    // SAFETY: a plain query.
    let page = u64::try_from(unsafe { libc::sysconf(libc::_SC_PAGESIZE) }).ok()?;
    Some(pages * page)
}

/// Ends the process with an error, at once: threads of the library that are busy are not waited
/// for. Bags are closed before.
pub fn end(bytes: u64) -> ! {
    eprintln!(
        "error: this node takes {} MB of memory, more than {} MB: its peers, or a stranger in its \
         domain, fill the DDS library; the bag, if any, is closed",
        bytes >> 20,
        BOUND >> 20
    );
    std::process::exit(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn memory_beyond_the_bound_is_seen_when_it_is_used() {
        let before = resident().unwrap();
        let bound = before + (100 << 20);
        let short = Duration::from_millis(200);
        assert!(tokio::time::timeout(short, exceeds(bound)).await.is_err());
        let block = vec![1_u8; 200 << 20];
        let seen = tokio::time::timeout(Duration::from_secs(60), exceeds(bound)).await.unwrap();
        assert!(seen > bound && seen >= block.len() as u64, "{seen} bytes");
    }
}
