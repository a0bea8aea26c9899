//! Which processor a thread runs on. Threads inherit it from the one that starts them.
//!
//! In lockstep the two nodes take turns: on one processor each hands over to the other without
//! waking an idle one, which is a quarter faster. The recorder then belongs on the others.

use std::io;

/// Parameter value for no particular processor.
pub const ANY: i64 = -1;

/// Binds this thread, and those that it starts, to one processor.
pub fn pin(cpu: usize) -> io::Result<()> {
    set(std::iter::once(cpu))
}

/// Lets this thread, and those that it starts, run on every processor but, if there is another,
/// `busy`.
pub fn avoid(busy: usize) -> io::Result<()> {
    let count = std::thread::available_parallelism().map_or(1, usize::from).max(online());
    if count < 2 { Ok(()) } else { set((0..count).filter(|cpu| *cpu != busy)) }
}

/// Processors of this machine.
pub fn online() -> usize {
    // SAFETY: a plain query.
    usize::try_from(unsafe { libc::sysconf(libc::_SC_NPROCESSORS_ONLN) }).unwrap_or(1).max(1)
}

/// Gives this thread, and those that it starts, a real-time priority (SCHED_FIFO) from 1 to 99.
pub fn real_time(priority: i32) -> io::Result<()> {
    let parameters = libc::sched_param { sched_priority: priority };
    // SAFETY: plain call for the calling thread, with a valid argument.
    let result = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters) };
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

/// Takes the real-time priority of this thread away, which it has from the one that started it.
pub fn not_real_time() -> io::Result<()> {
    let parameters = libc::sched_param { sched_priority: 0 };
    // SAFETY: plain call for the calling thread, with a valid argument.
    let result = unsafe { libc::sched_setscheduler(0, libc::SCHED_OTHER, &raw const parameters) };
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

fn set(cpus: impl Iterator<Item = usize>) -> io::Result<()> {
    // SAFETY: the set is local and zeroed; CPU_SET ignores numbers beyond its size.
    let result = unsafe {
        let mut wanted: libc::cpu_set_t = std::mem::zeroed();
        for cpu in cpus.filter(|cpu| *cpu < libc::CPU_SETSIZE as usize) {
            libc::CPU_SET(cpu, &mut wanted);
        }
        libc::sched_setaffinity(0, std::mem::size_of::<libc::cpu_set_t>(), &wanted)
    };
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_is_bound_where_it_is_told_and_a_processor_that_is_not_there_is_refused() {
        std::thread::spawn(|| {
            pin(0).unwrap();
            // SAFETY: a plain query.
            assert_eq!(unsafe { libc::sched_getcpu() }, 0);
            assert!(pin(1000).is_err());
            avoid(0).unwrap();
        })
        .join()
        .unwrap();
    }
}
