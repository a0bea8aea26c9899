//! Writes a pair of recordings of an emulated stage, with something hidden in it, as `train` and
//! `check` bags; the truth goes into another folder.
//!
//! `cargo run --release --example emulate_measurement --
//! BAGS TRUTH SEED [EFFECT[=FACTOR] ... | COUNT]`
//!
//! Effects are given by name, each drawn from the seed at its usual size times the factor; a number
//! hides that many effects that the seed picks. Without either nothing is hidden. `--list` prints
//! the names.

use std::path::Path;

use anyhow::{Context as _, bail};
use blind_tests::Setup;
use blind_tests::effects::{CATALOGUE, LISTED, by_name, composition};

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if arguments.iter().any(|a| a == "--list") {
        for (index, (name, _)) in CATALOGUE.iter().enumerate() {
            println!("{name}{}", if index < LISTED { "" } else { " (unlisted)" });
        }
        return Ok(());
    }
    let [bags, truth, seed, hidden @ ..] = arguments.as_slice() else {
        bail!(
            "which folders and seed? emulate_measurement BAGS TRUTH SEED [EFFECT[=FACTOR] ... | \
             COUNT]"
        );
    };
    let seed: u64 = seed.parse().with_context(|| format!("seed {seed:?} is not a whole number"))?;
    let mut setup = Setup::new(seed);
    for (index, word) in hidden.iter().enumerate() {
        if let Ok(count) = word.parse() {
            setup = setup.with_all(composition(&CATALOGUE[..LISTED], count, seed));
            continue;
        }
        let (name, factor) = word.split_once('=').unwrap_or((word, "1"));
        let factor: f64 = factor
            .parse()
            .with_context(|| format!("factor {factor:?} of {name} is not a number"))?;
        let effect = by_name(name, seed.wrapping_add(index as u64))
            .with_context(|| format!("no effect {name:?}; --list prints the names"))?;
        setup = setup.with(effect.scaled(factor));
    }
    let run = setup.generate()?;
    run.write(Path::new(bags), Path::new(truth))?;
    println!("{}", serde_json::to_string(&run.truth.effects)?);
    Ok(())
}
