//! Every input of the corpus, and so many changed ones, of each target.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use fuzz_targets::mutate::mutated;
use fuzz_targets::targets::{TARGETS, Target, needs_file};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Inputs of a target that works in memory; of one that needs a file, a tenth.
const INPUTS: u64 = 10_000;
/// Memory that a few targets at once may ask for.
const MEMORY: u64 = 4 << 30;
/// Set where there is no network but the loopback interface.
const ALONE: &str = "FUZZ_WITHOUT_NETWORK";
/// An input that takes longer never ends.
const ENDLESS: Duration = Duration::from_secs(120);

fn number(name: &str) -> Option<u64> {
    let text = std::env::var(name).ok()?;
    Some(text.parse().unwrap_or_else(|_| panic!("{name} is {text:?}, must be a number")))
}

/// Ends the process where one input does not end, and leaves it in the temporary directory.
fn watch(progress: Arc<AtomicU64>, input: Arc<Mutex<Vec<u8>>>, name: &'static str) {
    std::thread::spawn(move || {
        let mut last = u64::MAX;
        while last != progress.load(Ordering::SeqCst) {
            last = progress.load(Ordering::SeqCst);
            if last == 0 {
                return;
            }
            std::thread::sleep(ENDLESS);
        }
        if last == 0 {
            return;
        }
        let path = std::env::temp_dir().join(format!("fuzz-{name}-endless"));
        let input = input.lock().map(|input| input.clone()).unwrap_or_default();
        std::fs::write(&path, input).expect("the temporary directory takes files");
        eprintln!("{name}: an input does not end, it is in {}", path.display());
        std::process::abort();
    });
}

fn run(name: &'static str) {
    // SAFETY: changes a limit of this process only.
    unsafe {
        let limit = libc::rlimit { rlim_cur: MEMORY, rlim_max: MEMORY };
        assert_eq!(libc::setrlimit(libc::RLIMIT_AS, &limit), 0);
    }
    let target: Target =
        TARGETS.iter().find(|(known, _)| *known == name).expect("a target of that name").1;
    let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(name);
    let mut paths: Vec<_> = std::fs::read_dir(&directory)
        .unwrap_or_else(|error| panic!("{}: {error}", directory.display()))
        .map(|entry| entry.unwrap().path())
        .collect();
    paths.sort();
    let corpus: Vec<Vec<u8>> = paths.iter().map(|path| std::fs::read(path).unwrap()).collect();
    assert!(!corpus.is_empty(), "{} is empty", directory.display());
    let home = tempfile::tempdir().unwrap();
    let mut chaos = ChaCha8Rng::seed_from_u64(number("FUZZ_SEED").unwrap_or(1));
    let changed = number("FUZZ_INPUTS").unwrap_or(INPUTS) / if needs_file(name) { 10 } else { 1 };
    let (progress, current) = (Arc::new(AtomicU64::new(1)), Arc::new(Mutex::new(Vec::new())));
    watch(Arc::clone(&progress), Arc::clone(&current), name);
    let whole = corpus.iter().cloned();
    let mut pool = corpus.clone();
    for (count, given) in whole.map(Some).chain((0..changed).map(|_| None)).enumerate() {
        let input = given.unwrap_or_else(|| {
            let from = &pool[chaos.random_range(0..pool.len())];
            mutated(from, &corpus, &mut chaos)
        });
        current.lock().unwrap().clone_from(&input);
        let done = catch_unwind(AssertUnwindSafe(|| target(&input, home.path())));
        if done.is_err() {
            let path = std::env::temp_dir().join(format!("fuzz-{name}-{count}"));
            std::fs::write(&path, &input).unwrap();
            panic!("{name}: input {count} is a finding, it is in {}", path.display());
        }
        // Some of the changed ones are changed further.
        if count % 50 == 0 && input.len() < 32 * 1024 {
            let place = chaos.random_range(0..1000);
            match pool.get_mut(corpus.len() + place) {
                Some(old) => *old = input,
                None => pool.push(input),
            }
        }
        progress.fetch_add(1, Ordering::SeqCst);
    }
    progress.store(0, Ordering::SeqCst);
    println!("{name}: {} inputs of the corpus and {changed} changed ones", corpus.len());
}

/// Runs a test of this program again in a network namespace of its own. Where the machine does not
/// allow one, the test says so and does nothing.
fn without_network(name: &str) {
    let unshare = || {
        let mut command = Command::new("unshare");
        command.args(["--map-root-user", "--net"]);
        command
    };
    let allowed = unshare().arg("true").output();
    if !allowed.is_ok_and(|output| output.status.success()) {
        eprintln!("{name}: not run, this machine gives no network namespace");
        return;
    }
    let program = std::env::current_exe().unwrap();
    let mut again = unshare();
    again.arg(program).args([name, "--exact", "--nocapture"]).env(ALONE, "1");
    assert!(again.status().unwrap().success());
}

macro_rules! bounded {
    ($($name:ident)*) => {
        $(
            #[test]
            fn $name() {
                let name = stringify!($name);
                if name == "rtps" && std::env::var_os(ALONE).is_none() {
                    without_network(name);
                } else {
                    run(name);
                }
            }
        )*

        #[test]
        fn every_target_has_its_run() {
            assert_eq!([$(stringify!($name)),*], TARGETS.map(|(name, _)| name));
        }
    };
}

bounded! {
    mcap sqlite metadata cdr definition model catalogue
    mapping csv arrays motion trajectory arguments rtps
}
