//! Changes an input at random: bytes, numbers, pieces of it, pieces of others, words.
//!
//! The way of AFL's havoc stage, which needs neither coverage nor a nightly compiler.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Longest input, bytes.
const LONGEST: usize = 64 * 1024;

/// Sizes at which arithmetic goes wrong.
const NUMBERS: [u64; 14] = [
    0,
    1,
    0x7f,
    0x80,
    0xff,
    0x7fff,
    0xffff,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
    1 << 40,
    0x7fff_ffff_ffff_ffff,
    0x8000_0000_0000_0000,
    u64::MAX,
];

/// What texts of all kinds are made of, and what breaks readers.
const WORDS: [&str; 46] = [
    "\n",
    "\r\n",
    ",",
    ";",
    "\t",
    ":",
    ": ",
    "- ",
    "[",
    "]",
    "{",
    "}",
    "\"",
    "'",
    "#",
    "&a ",
    "*a",
    "<<: *a",
    "!!binary ",
    "---\n",
    ".nan",
    ".inf",
    "-.inf",
    "1e308",
    "-1e308",
    "1e-320",
    "1e400",
    "0",
    "-1",
    "0x7fffffffffffffff",
    "18446744073709551615",
    "99999999999999999999",
    "\u{1b}[31m",
    "\u{9b}",
    "\u{202e}",
    "\0",
    "[0]",
    "[18446744073709551615]",
    "[<=3]",
    "..",
    "/",
    "~",
    "true",
    "null",
    "2024-02-30 25:61:61",
    "%",
];

/// An input made of `input` by some changes; `others` lend pieces.
pub fn mutated(input: &[u8], others: &[Vec<u8>], chaos: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = input.to_vec();
    let changes = 1 << chaos.random_range(0..5);
    for _ in 0..changes {
        change(&mut bytes, others, chaos);
    }
    bytes.truncate(LONGEST);
    bytes
}

fn piece<'a>(of: &'a [u8], chaos: &mut ChaCha8Rng) -> &'a [u8] {
    if of.is_empty() {
        return of;
    }
    let from = chaos.random_range(0..of.len());
    let most = (of.len() - from).min(1 << chaos.random_range(0..10));
    &of[from..from + chaos.random_range(1..=most)]
}

fn change(bytes: &mut Vec<u8>, others: &[Vec<u8>], chaos: &mut ChaCha8Rng) {
    let at = chaos.random_range(0..=bytes.len());
    let insert = |bytes: &mut Vec<u8>, what: &[u8]| {
        bytes.splice(at..at, what.iter().copied());
    };
    let replace = |bytes: &mut Vec<u8>, what: &[u8]| {
        let end = (at + what.len()).min(bytes.len());
        bytes.splice(at..end, what.iter().copied());
    };
    match chaos.random_range(0..10) {
        0 if at < bytes.len() => bytes[at] ^= 1 << chaos.random_range(0..8),
        1 if at < bytes.len() => bytes[at] = chaos.random(),
        2 => {
            let number = NUMBERS[chaos.random_range(0..NUMBERS.len())];
            let number = number.wrapping_add(chaos.random_range(0..3)).to_le_bytes();
            replace(bytes, &number[..1 << chaos.random_range(0..4)]);
        }
        3 => insert(bytes, WORDS[chaos.random_range(0..WORDS.len())].as_bytes()),
        4 => replace(bytes, WORDS[chaos.random_range(0..WORDS.len())].as_bytes()),
        5 => {
            let length = piece(&bytes[at..], chaos).len();
            bytes.drain(at..at + length);
        }
        6 => {
            let own = piece(bytes, chaos).to_vec();
            let times = if chaos.random_bool(0.1) { 50 } else { 1 };
            insert(bytes, &own.repeat(times));
        }
        7 => {
            let own = piece(bytes, chaos).to_vec();
            replace(bytes, &own);
        }
        8 if !others.is_empty() => {
            let other = piece(&others[chaos.random_range(0..others.len())], chaos).to_vec();
            insert(bytes, &other);
        }
        9 if chaos.random_bool(0.2) => bytes.truncate(at),
        _ => {}
    }
}
