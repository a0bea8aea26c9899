//! Gives memory that is free back to the machine, and ends a node that takes too much of it.
//!
//! What the writers keep for a subscriber that falls back is freed in pieces between others, and
//! the allocator keeps such pieces: after an hour of slow subscribers 135 of 160 MB were free.
//!
//! The DDS library has no bound of its own: whoever reaches its sockets can make it remember more
//! and more peers. In goes the resident memory of this process, from `/proc/self/statm`; out comes
//! the moment at which it is beyond the bound. A limit of the kernel (`RLIMIT_AS`) would end the
//! process in the middle of an allocation, with the bag open.

use std::time::{Duration, Instant};

/// Resident memory at which a node ends, bytes. A stage takes 20 MB, with a recording 60 MB.
pub const BOUND: u64 = 1 << 30;

/// Between two looks. The fastest growth that was seen is 1 GB per second.
const INTERVAL: Duration = Duration::from_millis(50);

/// Growth from which on free pieces are looked for, bytes.
const STEP: u64 = 32 << 20;

/// Between two times that they are given back: what is in use now may be free later, and the
/// resident memory does not show it. 300 MB in pieces take 40 ms.
const GIVE_BACK_INTERVAL: Duration = Duration::from_secs(10);

/// Waits until this process takes more than `bound` bytes; how many they are. While it has grown by
/// `STEP`, what the allocator holds without use is given back from time to time.
pub async fn exceeds(bound: u64) -> u64 {
    let mut interval = tokio::time::interval(INTERVAL);
    interval.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut least = resident().unwrap_or(u64::MAX);
    let mut given_back: Option<Instant> = None;
    loop {
        interval.tick().await;
        // Where it cannot be read there is no bound.
        let Some(mut bytes) = resident() else { continue };
        least = least.min(bytes);
        if bytes > least.saturating_add(STEP)
            && given_back.is_none_or(|at| at.elapsed() >= GIVE_BACK_INTERVAL)
        {
            bytes = give_back().await.unwrap_or(bytes);
            given_back = Some(Instant::now());
        }
        if bytes > bound {
            return bytes;
        }
    }
}

/// Gives free pages back; what is resident after it, bytes.
async fn give_back() -> Option<u64> {
    // On a thread with the priority of the library's: its allocations wait for the lock that this
    // holds. The ticks do not allocate.
    let given = tokio::task::spawn_blocking(|| {
        // SAFETY: takes the locks of the allocator as an allocation does.
        #[cfg(target_env = "gnu")]
        unsafe {
            libc::malloc_trim(0);
        }
    });
    given.await.ok()?;
    resident()
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

    /// The memory is that of the process: one test at a time.
    static ALONE: tokio::sync::Mutex<()> = tokio::sync::Mutex::const_new(());

    #[tokio::test]
    async fn memory_beyond_the_bound_is_seen_when_it_is_used() {
        let _alone = ALONE.lock().await;
        let before = resident().unwrap();
        let bound = before + (100 << 20);
        let short = Duration::from_millis(200);
        assert!(tokio::time::timeout(short, exceeds(bound)).await.is_err());
        let block = vec![1_u8; 200 << 20];
        let seen = tokio::time::timeout(Duration::from_secs(60), exceeds(bound)).await.unwrap();
        assert!(seen > bound && seen >= block.len() as u64, "{seen} bytes");
    }

    #[cfg(target_env = "gnu")]
    #[tokio::test]
    async fn pieces_that_are_free_between_others_are_given_back() {
        let _alone = ALONE.lock().await;
        let watch = tokio::spawn(exceeds(u64::MAX));
        tokio::task::yield_now().await;
        let before = resident().unwrap();
        // Pieces of 1 KiB; of 64 in a row one is kept, so that the allocator has no end to cut.
        let mut pieces: Vec<Vec<u8>> = (0..300 << 10).map(|_| vec![1_u8; 1 << 10]).collect();
        let mut number = 0;
        pieces.retain(|_| {
            number += 1;
            number % 64 == 0
        });
        let freed = async {
            while resident().unwrap() > before + (100 << 20) {
                tokio::time::sleep(INTERVAL).await;
            }
        };
        tokio::time::timeout(Duration::from_secs(60), freed).await.unwrap();
        assert!(!watch.is_finished());
        drop(pieces);
    }
}
