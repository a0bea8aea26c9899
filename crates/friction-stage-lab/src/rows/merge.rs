//! The parts of a plan put together, bit for bit what one run gives.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde::de::IgnoredAny;

use friction_stage_core::yaml;

use super::{NumberedPlan, PLAN, Rows, RowsError, Sheet, plan_text, selection};
use crate::selection::Shard;

/// Missing shards that are named at most.
const MOST_NAMED: usize = 10;

/// The kind of a sheet, whatever its plan.
#[derive(Deserialize)]
struct Kind {
    #[serde(default = "selection")]
    kind: String,
    #[serde(flatten)]
    _rest: std::collections::HashMap<String, IgnoredAny>,
}

/// What the plan of a directory is for: [`NumberedPlan::KIND`].
pub fn kind_of(directory: &Path) -> Result<String, RowsError> {
    let found: Kind = yaml::read(&plan_text(directory)?)
        .map_err(|reason| RowsError::Plan { path: directory.join(PLAN), reason })?;
    Ok(found.kind)
}

/// Puts the rows of `shards`, in any order, together in the directory `out`.
pub fn merge_shards<P: NumberedPlan>(shards: &[PathBuf], out: &Path) -> Result<Rows<P>, RowsError> {
    let mut parts: Vec<(&PathBuf, Sheet<P>)> = Vec::new();
    for directory in shards {
        parts.push((directory, Sheet::read(directory)?));
    }
    let Some((first_directory, first)) = parts.first().cloned() else {
        return Err(RowsError::NoParts);
    };
    let whole = |sheet: &Sheet<P>| Sheet { shard: Shard::WHOLE, ..sheet.clone() };
    let mut places: BTreeMap<u64, &PathBuf> = BTreeMap::new();
    for (directory, sheet) in &parts {
        if let Some((one, other)) = whole(&first).difference(&whole(sheet))? {
            let (first, second) = (first_directory.clone(), (*directory).clone());
            return Err(RowsError::OtherPlan { first, second, one, other });
        }
        if sheet.shard.count != first.shard.count {
            return Err(RowsError::OtherDivision {
                first: first_directory.clone(),
                second: (*directory).clone(),
                one: first.shard,
                other: sheet.shard,
            });
        }
        if let Some(other) = places.insert(sheet.shard.index, directory) {
            return Err(RowsError::SameShard {
                first: other.clone(),
                second: (*directory).clone(),
                shard: sheet.shard,
            });
        }
    }
    let missing = first.shard.count - places.len() as u64;
    if missing > 0 {
        let mut named: Vec<String> = (1..=first.shard.count)
            .filter(|index| !places.contains_key(index))
            .take(MOST_NAMED)
            .map(|index| Shard { index, ..first.shard }.to_string())
            .collect();
        named.extend((missing > MOST_NAMED as u64).then(|| "...".to_owned()));
        let (count, named) = (first.shard.count, named.join(", "));
        return Err(RowsError::Missing { missing, count, named });
    }
    let parts: Vec<Rows<P>> =
        places.into_values().map(|directory| Rows::whole(directory)).collect::<Result<_, _>>()?;
    let (rows, _) = Rows::open(out, whole(&first), false)?;
    for part in &parts {
        rows.append_rows_of(part)?;
    }
    Ok(rows)
}
