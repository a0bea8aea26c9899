//! Waits that continue after the process was stopped.
//!
//! When a process is stopped and continued (Ctrl-Z and `fg`, a debugger, `SIGSTOP`), epoll_wait(2)
//! ends with `EINTR`, although nothing has happened (signal(7)). Both threads of the DDS library
//! take this for a failure and end: the node would find no other, or send nothing
//! (`docs/upstream/stopped-process.md`). So the function of the C library is replaced by one that
//! waits for the rest of the time.

use std::io;
use std::time::{Duration, Instant};

/// Checks that the library calls the [`epoll_wait`] of this file. To be called before a participant
/// is made.
///
/// # Errors
/// The program was linked so that the library does not call [`epoll_wait`] here.
pub fn check() -> io::Result<()> {
    if libc::epoll_wait as *const () == epoll_wait as *const () {
        return Ok(());
    }
    Err(io::Error::other(
        "the C library's epoll_wait is called, which ends when a process is stopped",
    ))
}

/// Takes the place of the function of the C library: the same, but does not end with `EINTR`.
///
/// # Safety
/// As for epoll_wait(2).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn epoll_wait(
    epoll: libc::c_int,
    events: *mut libc::epoll_event,
    most: libc::c_int,
    timeout: libc::c_int,
) -> libc::c_int {
    let began = Instant::now();
    let mut left = timeout;
    loop {
        // SAFETY: the arguments are the caller's; no signal is blocked meanwhile, so the last two
        // are not looked at.
        let ready = unsafe {
            let no_signals = std::ptr::null::<libc::sigset_t>();
            libc::syscall(libc::SYS_epoll_pwait, epoll, events, most, left, no_signals, 8_usize)
        };
        if ready >= 0 || io::Error::last_os_error().kind() != io::ErrorKind::Interrupted {
            return ready as libc::c_int;
        }
        if let Ok(timeout) = u64::try_from(timeout) {
            let rest = Duration::from_millis(timeout).saturating_sub(began.elapsed());
            // Rounded up: a wait that ends early would be taken for the time.
            left = rest.as_micros().div_ceil(1000) as libc::c_int;
        }
    }
}
