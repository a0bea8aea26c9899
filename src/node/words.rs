//! Words of peers, and of what is over: what diagnostics and logs say of them.

use std::sync::Mutex;
use std::time::{Duration, Instant};

use super::lock::lock;

/// How long diagnostics warn of something that does not happen any more.
const LASTS: Duration = Duration::from_secs(5);
/// Most characters of a text from a peer.
const LONGEST: usize = 200;

/// A text from a peer, safe to print: what is no plain character escaped, cut at 200 characters.
pub fn quoted(text: &str) -> String {
    let mut escaped = text.chars().flat_map(|c| {
        // A quote is printed as it is; control characters and marks of direction are not.
        let plain = matches!(c, '\'' | '"' | '\\') || c.escape_debug().len() == 1;
        plain
            .then_some(c)
            .into_iter()
            .chain((!plain).then(|| c.escape_debug()).into_iter().flatten())
    });
    let cut: String = escaped.by_ref().take(LONGEST).collect();
    if escaped.next().is_some() { format!("{cut}...") } else { cut }
}

/// The reason of the last refusal, as long as it is recent.
#[derive(Debug, Default)]
pub struct Recent(Mutex<Option<(Instant, String)>>);

impl Recent {
    /// Takes the newest reason, whose texts of peers are made safe; whether it is another than the
    /// last.
    pub fn set(&self, reason: &str) -> bool {
        let reason = quoted(reason);
        let last = lock(&self.0).replace((Instant::now(), reason.clone()));
        last.is_none_or(|(_, last)| last != reason)
    }

    /// The last reason, if it is not long ago.
    pub fn get(&self) -> Option<String> {
        lock(&self.0).as_ref().filter(|(at, _)| at.elapsed() < LASTS).map(|(_, text)| text.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_of_a_peer_is_escaped_and_cut() {
        assert_eq!(quoted("a\u{1b}[31mb\n"), "a\\u{1b}[31mb\\n");
        let long = quoted(&"\u{7}".repeat(1000));
        assert_eq!(long.chars().count(), LONGEST + 3);
        assert!(long.ends_with("..."));
        assert_eq!(quoted("µm `x` \"y\""), "µm `x` \"y\"");
        assert_eq!(quoted("a\u{202e}b\u{2028}"), "a\\u{202e}b\\u{2028}");
    }
}
