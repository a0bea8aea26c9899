//! `friction-stage merge`: the shards of a selection put together, bit for bit what one run gives.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::PathBuf;

use clap::Args;

use super::Outcome;
use super::selection_output::finish;
use super::variant_rows::{Sheet, VariantRows};
use friction_stage_lab::Shard;

/// Put the shards of a selection together: the same files, bit for bit, as one run without --shard.
#[derive(Debug, Clone, Args)]
#[command(after_help = "Example:\n  friction-stage merge part_* --out whole")]
pub struct MergeArgs {
    /// Directories that `friction-stage select --shard i/n` wrote, in any order
    #[arg(value_name = "DIR", required = true)]
    pub shards: Vec<PathBuf>,
    /// Directory for the results
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Print JSON instead of a table
    #[arg(long)]
    pub json: bool,
}

/// Missing shards that are named at most.
const TOLD: usize = 10;

/// Runs the command; results go to `out`.
pub fn run(args: &MergeArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let mut parts = Vec::new();
    for directory in &args.shards {
        parts.push((directory, Sheet::read(directory)?));
    }
    // `required` leaves no empty list.
    let (first_directory, first) = parts[0].clone();
    let whole = |sheet: &Sheet| Sheet { shard: Shard::WHOLE, ..sheet.clone() };
    let mut places: BTreeMap<u64, &PathBuf> = BTreeMap::new();
    for (directory, sheet) in &parts {
        if let Some((one, other)) = whole(&first).difference(&whole(sheet))? {
            anyhow::bail!(
                "{} and {} are not of one selection: `{one}` and `{other}`",
                first_directory.display(),
                directory.display()
            );
        }
        anyhow::ensure!(
            sheet.shard.count == first.shard.count,
            "{} is shard {} and {} is shard {}: not of one division",
            first_directory.display(),
            first.shard,
            directory.display(),
            sheet.shard
        );
        if let Some(other) = places.insert(sheet.shard.index, directory) {
            anyhow::bail!(
                "{} and {} are both shard {}",
                other.display(),
                directory.display(),
                sheet.shard
            );
        }
    }
    let missing = first.shard.count - places.len() as u64;
    if missing > 0 {
        let mut told: Vec<String> = (1..=first.shard.count)
            .filter(|index| !places.contains_key(index))
            .take(TOLD)
            .map(|index| Shard { index, ..first.shard }.to_string())
            .collect();
        told.extend((missing > TOLD as u64).then(|| "...".to_owned()));
        anyhow::bail!(
            "{missing} of {} shards missing: {}; compute them by --shard",
            first.shard.count,
            told.join(", ")
        );
    }
    let parts: Vec<VariantRows> = places
        .into_values()
        .map(|directory| VariantRows::whole(directory))
        .collect::<Result<_, _>>()?;
    let (rows, _) = VariantRows::open(&args.out, whole(&first), false)?;
    for part in &parts {
        rows.append_rows_of(part)?;
    }
    finish(&args.out, &rows, args.json, out)
}
