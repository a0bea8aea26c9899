//! Variables of a `.mat` of MATLAB 7.3, which is HDF5: numbers, and fields of structs.
//!
//! MATLAB stores an array with its dimensions turned round and says in attributes what is text,
//! a cell or an object. The format is left to a library.

use std::path::Path;
use std::sync::Arc;

use hdf5_reader::group::Group;
use hdf5_reader::{Dataset, Datatype, FileStorage, Hdf5File, OpenOptions};

use super::{AN_OBJECT, Array, Fault, MOST, Values};

/// Structs in structs.
const DEEPEST: usize = 8;
/// Most variables that are listed.
const MOST_VARIABLES: usize = 10_000;
const DAMAGED: &str = "the file is damaged, or stores its variables in a way that is not read: \
                       `save -v7 FILE` in MATLAB makes one that is";

/// Lists the variables.
pub(super) fn list(path: &Path) -> Result<Vec<Array>, Fault> {
    let file = open(path)?;
    let root = file.root_group().map_err(damaged)?;
    let mut found = Vec::new();
    list_group(&root, "", 0, &mut found)?;
    Ok(found)
}

/// Reads the values of one variable.
pub(super) fn read(path: &Path, array: &Array) -> Result<Values, Fault> {
    let file = open(path)?;
    // A name of MATLAB has no point in it.
    let dataset = file.dataset(&array.name.replace('.', "/")).map_err(damaged)?;
    values(&dataset)
}

fn open(path: &Path) -> Result<Hdf5File, Fault> {
    let options = OpenOptions::default()
        .with_max_read_bytes(MOST as usize)
        .with_max_chunk_bytes(MOST as usize / 4);
    let storage = FileStorage::open(path).map_err(damaged)?;
    Hdf5File::from_storage_with_options(Arc::new(storage), options).map_err(damaged)
}

fn damaged<E>(_: E) -> Fault {
    DAMAGED.to_owned()
}

fn list_group(
    group: &Group,
    before: &str,
    depth: usize,
    found: &mut Vec<Array>,
) -> Result<(), Fault> {
    let joined = |name: &str| {
        if before.is_empty() { name.to_owned() } else { format!("{before}.{name}") }
    };
    let (groups, datasets) = group.members().map_err(damaged)?;
    for dataset in datasets {
        if found.len() >= MOST_VARIABLES {
            return Err(format!("it has more than {MOST_VARIABLES} variables"));
        }
        found.push(array(joined(last(dataset.name())), &dataset));
    }
    for group in groups {
        let name = last(group.name());
        // Where MATLAB keeps what cells and objects refer to.
        if name.starts_with('#') {
            continue;
        }
        let name = joined(name);
        if depth == DEEPEST {
            return Err(format!("{name} has more than {DEEPEST} structs in each other"));
        }
        list_group(&group, &name, depth + 1, found)?;
    }
    Ok(())
}

fn last(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

fn array(name: String, dataset: &Dataset) -> Array {
    let class = dataset.attribute("MATLAB_class").and_then(|class| class.read_string());
    let other = match (class.as_deref().map(str::trim), dataset.dtype()) {
        // A table, a timetable, a string: the dataset has numbers that refer to it.
        _ if dataset.attribute("MATLAB_object_decode").is_ok() => Some(AN_OBJECT),
        _ if dataset.attribute("MATLAB_empty").is_ok() => Some("no values"),
        (Ok("char"), _) | (_, Datatype::String { .. }) => Some("text"),
        (Ok("cell"), _) => Some("a cell array"),
        (_, Datatype::Compound { .. }) => Some("complex numbers"),
        (_, Datatype::FixedPoint { .. }) => None,
        (_, Datatype::FloatingPoint { size: 4 | 8, .. }) => None,
        (_, Datatype::Enum { .. }) => Some("enumerated values"),
        (_, Datatype::Reference { .. }) => Some("a struct array"),
        _ => Some("no numbers"),
    };
    Array {
        name,
        shape: dataset.shape().iter().rev().copied().collect(),
        is_first_fastest: true,
        other: other.map(str::to_owned),
    }
}

fn values(dataset: &Dataset) -> Result<Values, Fault> {
    macro_rules! read {
        ($kind:ty) => {
            dataset.read_array::<$kind>().map_err(damaged)?.into_iter()
        };
    }
    let numbers: Vec<f64> = match dataset.dtype() {
        Datatype::FloatingPoint { size: 8, .. } => {
            dataset.read_array::<f64>().map_err(damaged)?.into_raw_vec_and_offset().0
        }
        Datatype::FloatingPoint { .. } => read!(f32).map(f64::from).collect(),
        Datatype::FixedPoint { size: 1, signed: true, .. } => read!(i8).map(f64::from).collect(),
        Datatype::FixedPoint { size: 1, .. } => read!(u8).map(f64::from).collect(),
        Datatype::FixedPoint { size: 2, signed: true, .. } => read!(i16).map(f64::from).collect(),
        Datatype::FixedPoint { size: 2, .. } => read!(u16).map(f64::from).collect(),
        Datatype::FixedPoint { size: 4, signed: true, .. } => read!(i32).map(f64::from).collect(),
        Datatype::FixedPoint { size: 4, .. } => read!(u32).map(f64::from).collect(),
        Datatype::FixedPoint { size: 8, signed: true, .. } => {
            return Ok(Values::Whole(read!(i64).collect()));
        }
        Datatype::FixedPoint { size: 8, .. } => {
            let values: Vec<u64> = read!(u64).collect();
            return Ok(match values.iter().map(|value| i64::try_from(*value)).collect() {
                Ok(values) => Values::Whole(values),
                Err(_) => Values::Numbers(values.into_iter().map(|v| v as f64).collect()),
            });
        }
        _ => return Err(DAMAGED.to_owned()),
    };
    Ok(Values::Numbers(numbers))
}
