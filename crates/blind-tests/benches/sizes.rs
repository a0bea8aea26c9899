//! How large the effects of the blind tests are: rms of what each adds to force, encoder and cell,
//! least, middle and largest of ten draws.
//!
//!     cargo bench -p blind-tests --bench sizes
//!
//! Each draw keeps the loop, or this fails. About seven minutes of one core.

use blind_tests::effects::{CATALOGUE, by_name};
use blind_tests::{RecordTruth, Setup, rms};
use rayon::prelude::*;

const DRAWS: u64 = 10;

fn main() -> anyhow::Result<()> {
    println!("{:28} {:^29}   {:^29}   {:^29}", "effect", "force, N", "encoder, m", "cell, N");
    for (name, _) in CATALOGUE {
        let runs: Vec<RecordTruth> = (0..DRAWS)
            .into_par_iter()
            .map(|seed| {
                let effect = by_name(name, seed).ok_or_else(|| anyhow::anyhow!("no {name}"))?;
                Ok(Setup::new(seed).with(effect).generate()?.truth.train)
            })
            .collect::<anyhow::Result<_>>()?;
        let range = |size: &dyn Fn(&RecordTruth) -> f64| {
            let mut sizes: Vec<f64> = runs.iter().map(size).collect();
            sizes.sort_by(f64::total_cmp);
            format!(
                "{:9.3e} {:9.3e} {:9.3e}",
                sizes[0],
                sizes[sizes.len() / 2],
                sizes[sizes.len() - 1]
            )
        };
        println!(
            "{name:28} {}   {}   {}",
            range(&|truth| rms(&truth.hidden[0].force)),
            range(&|truth| rms(&truth.hidden[0].encoder)),
            range(&|truth| rms(&truth.hidden[0].cell))
        );
    }
    Ok(())
}
