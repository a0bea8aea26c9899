//! A target that libFuzzer drives by what each input reaches; `FUZZ_TARGET` names it.
#![no_main]

use std::sync::LazyLock;

use fuzz_targets::targets::{TARGETS, Target};
use libfuzzer_sys::fuzz_target;
use tempfile::TempDir;

static TARGET: LazyLock<(Target, TempDir)> = LazyLock::new(|| {
    let names = TARGETS.map(|(name, _)| name).join(", ");
    let wanted = std::env::var("FUZZ_TARGET").unwrap_or_default();
    let found = TARGETS.iter().find(|(name, _)| *name == wanted);
    let (_, target) = found.unwrap_or_else(|| panic!("FUZZ_TARGET must be one of {names}"));
    (*target, TempDir::new().expect("a directory for files"))
});

fuzz_target!(|input: &[u8]| {
    let (target, directory) = &*TARGET;
    target(input, directory.path());
});
