//! Files of named arrays: `.npy` and `.npz` of NumPy, `.mat` of MATLAB.
//!
//! In goes a path; out come the columns that the arrays make, by the name of the array and, for one
//! of two dimensions, the index: `pos[:,0]` as NumPy counts, `pos(:,1)` as MATLAB does. Values are
//! read when they are asked for. Words, complex numbers, cells and objects make no columns.

mod hdf5;
mod mat5;
mod npy;

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use super::error::SignalError;
use crate::bag::BagError;
use friction_stage_core::text_file;

/// Most bytes of the arrays that are read of one file, as numbers of eight bytes.
const MOST: u64 = 256 * 1024 * 1024;
/// Most columns of one array; one with more is an image or a map.
const MOST_COLUMNS: u64 = 1000;
/// What is said of a table, a timetable or another object of MATLAB, whose format is not open.
const AN_OBJECT: &str = "an object: save its columns as arrays, or in a struct";

/// How a file stores its arrays.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Format {
    Npy,
    Npz,
    Mat5,
    Hdf5,
}

impl Format {
    fn of(path: &Path) -> Result<Format, SignalError> {
        let mut begin = Vec::new();
        let read = text_file::regular(path)
            .and_then(|()| File::open(path))
            .and_then(|file| file.take(520).read_to_end(&mut begin));
        read.map_err(|error| BagError::reading(path, error))?;
        let has = |at: usize, magic: &[u8]| begin.get(at..at + magic.len()) == Some(magic);
        const HDF5: &[u8] = b"\x89HDF\r\n\x1a\n";
        if has(0, npy::MAGIC) {
            Ok(Format::Npy)
        } else if has(0, b"PK\x03\x04") || has(0, b"PK\x05\x06") {
            Ok(Format::Npz)
        } else if has(0, HDF5) || has(512, HDF5) {
            Ok(Format::Hdf5)
        } else if has(126, b"IM") || has(126, b"MI") {
            Ok(Format::Mat5)
        } else {
            Err(SignalError::Array {
                path: path.to_owned(),
                reason: "it is none of .npy, .npz (NumPy), .mat of version 5 to 7.3 (MATLAB); a \
                         .mat of version 4, or a table of text, is to be saved again: `save -v7 \
                         FILE`, or as CSV"
                    .into(),
            })
        }
    }

    /// Name for people and programs.
    pub fn name(self) -> &'static str {
        match self {
            Format::Npy => "npy",
            Format::Npz => "npz",
            Format::Mat5 => "mat",
            Format::Hdf5 => "mat 7.3",
        }
    }

    fn is_of_matlab(self) -> bool {
        matches!(self, Format::Mat5 | Format::Hdf5)
    }
}

/// An array as the file lists it.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Array {
    name: String,
    /// Length along each dimension.
    shape: Vec<u64>,
    /// Whether the first index runs fastest in the values.
    is_first_fastest: bool,
    /// Why it makes no column: what it holds instead of numbers.
    other: Option<String>,
}

impl Array {
    fn len(&self) -> Option<u64> {
        self.shape.iter().try_fold(1u64, |product, length| product.checked_mul(*length))
    }
}

/// Values of an array or a column.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Values {
    Numbers(Vec<f64>),
    /// Whole numbers of 64 bits, which a float would round.
    Whole(Vec<i64>),
    /// Times, ns; the smallest stands for none.
    Times(Vec<i64>),
}

impl Values {
    fn len(&self) -> usize {
        match self {
            Values::Numbers(values) => values.len(),
            Values::Whole(values) | Values::Times(values) => values.len(),
        }
    }

    fn part(&self, first: usize, step: usize, length: usize) -> Values {
        fn part<T: Copy>(values: &[T], first: usize, step: usize, length: usize) -> Vec<T> {
            values.iter().skip(first).step_by(step.max(1)).take(length).copied().collect()
        }
        match self {
            Values::Numbers(values) => Values::Numbers(part(values, first, step, length)),
            Values::Whole(values) => Values::Whole(part(values, first, step, length)),
            Values::Times(values) => Values::Times(part(values, first, step, length)),
        }
    }
}

/// How the numbers of an array are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Number {
    Int(usize),
    Uint(usize),
    Float(usize),
    /// 64 bits, with so many ns in a unit.
    Time(i64),
}

impl Number {
    fn size(self) -> usize {
        match self {
            Number::Int(size) | Number::Uint(size) | Number::Float(size) => size,
            Number::Time(_) => 8,
        }
    }

    /// Reads `count` numbers, every `stride` bytes one.
    fn read(
        self,
        reader: &mut dyn Read,
        count: u64,
        (before, after): (usize, usize),
        big_endian: bool,
    ) -> io::Result<Values> {
        let size = self.size();
        let mut buffer = vec![0; before + size + after];
        let mut next = || -> io::Result<[u8; 8]> {
            reader.read_exact(&mut buffer)?;
            let mut bytes = [0; 8];
            bytes[..size].copy_from_slice(&buffer[before..before + size]);
            if big_endian {
                bytes[..size].reverse();
            }
            Ok(bytes)
        };
        // What is there decides, not what is declared.
        let whole = |bytes: [u8; 8]| {
            let value = u64::from_le_bytes(bytes);
            let unused = 64 - 8 * size as u32;
            ((value << unused) as i64) >> unused
        };
        Ok(match self {
            Number::Int(8) => {
                Values::Whole((0..count).map(|_| next().map(whole)).collect::<io::Result<_>>()?)
            }
            Number::Time(unit) => {
                let time = |bytes| match whole(bytes) {
                    i64::MIN => i64::MIN,
                    value => value.checked_mul(unit).unwrap_or(i64::MIN),
                };
                Values::Times((0..count).map(|_| next().map(time)).collect::<io::Result<_>>()?)
            }
            Number::Uint(8) => {
                let values: Vec<u64> = (0..count)
                    .map(|_| next().map(u64::from_le_bytes))
                    .collect::<io::Result<_>>()?;
                match values.iter().map(|value| i64::try_from(*value)).collect() {
                    Ok(values) => Values::Whole(values),
                    Err(_) => Values::Numbers(values.into_iter().map(|v| v as f64).collect()),
                }
            }
            _ => {
                let number = |bytes: [u8; 8]| match self {
                    Number::Uint(_) => u64::from_le_bytes(bytes) as f64,
                    Number::Float(8) => f64::from_le_bytes(bytes),
                    Number::Float(4) => {
                        let [a, b, c, d, ..] = bytes;
                        f64::from(f32::from_le_bytes([a, b, c, d]))
                    }
                    Number::Float(_) => half([bytes[0], bytes[1]]),
                    _ => whole(bytes) as f64,
                };
                Values::Numbers((0..count).map(|_| next().map(number)).collect::<io::Result<_>>()?)
            }
        })
    }
}

/// A number of 16 bits (IEEE 754 binary16).
fn half(bytes: [u8; 2]) -> f64 {
    let bits = u16::from_le_bytes(bytes);
    let (exponent, fraction) = (i32::from(bits >> 10 & 0x1f), f64::from(bits & 0x3ff));
    let size = match exponent {
        0 => fraction * 2f64.powi(-24),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        exponent => (1.0 + fraction / 1024.0) * 2f64.powi(exponent - 15),
    };
    if bits & 0x8000 == 0 { size } else { -size }
}

/// What is wrong with an array, for people.
type Fault = String;

fn fault_of(error: &io::Error) -> Fault {
    match error.kind() {
        io::ErrorKind::UnexpectedEof => "the file ends before its values do".into(),
        _ => "its values do not unpack".into(),
    }
}

/// A column that an array makes.
#[derive(Debug, Clone)]
pub(super) struct ArrayColumn {
    /// As a mapping names it.
    pub name: String,
    /// Values in it.
    pub length: u64,
    array: usize,
    first: u64,
    step: u64,
}

/// An open file of arrays.
pub(super) struct ArrayFile {
    pub path: PathBuf,
    pub format: Format,
    arrays: Vec<Array>,
    /// The columns, in the order of the file.
    pub columns: Vec<ArrayColumn>,
}

impl ArrayFile {
    /// Lists the arrays of a file.
    pub fn open(path: &Path) -> Result<Self, SignalError> {
        let format = Format::of(path)?;
        let arrays = match format {
            Format::Npy => npy::list(path),
            Format::Npz => npy::list_archive(path),
            Format::Mat5 => mat5::list(path),
            Format::Hdf5 => hdf5::list(path),
        };
        let wrong = |reason: Fault| SignalError::Array { path: path.to_owned(), reason };
        let mut file = Self {
            path: path.to_owned(),
            format,
            arrays: arrays.map_err(wrong)?,
            columns: Vec::new(),
        };
        for index in 0..file.arrays.len() {
            if let Err(other) = file.add_columns(index) {
                file.arrays[index].other.get_or_insert(other);
            }
        }
        Ok(file)
    }

    /// Adds the columns of an array; the error says why there are none.
    fn add_columns(&mut self, index: usize) -> Result<(), String> {
        let array = &self.arrays[index];
        if array.other.is_some() {
            return Ok(());
        }
        let long: Vec<u64> = array.shape.iter().copied().filter(|length| *length != 1).collect();
        if array.len().is_none() {
            return Err("more values than there can be".into());
        }
        if array.shape.len() <= 1 || long.len() <= 1 {
            let length = array.len().unwrap_or(0);
            let name = if array.name.is_empty() { "values" } else { &array.name };
            let name = shown(name);
            self.columns.push(ArrayColumn { name, length, array: index, first: 0, step: 1 });
            return Ok(());
        }
        let &[rows, columns] = array.shape.as_slice() else {
            return Err(format!("{} dimensions", array.shape.len()));
        };
        let of = shown(&array.name);
        // What is longer is time.
        let is_upright = rows >= columns;
        let (length, count) = if is_upright { (rows, columns) } else { (columns, rows) };
        if count > MOST_COLUMNS {
            return Err(format!("{rows} by {columns} values"));
        }
        for k in 0..count {
            let step_of_columns = if array.is_first_fastest { rows } else { 1 };
            let step_of_rows = if array.is_first_fastest { 1 } else { columns };
            let (first, step) = if is_upright {
                (k * step_of_columns, step_of_rows)
            } else {
                (k * step_of_rows, step_of_columns)
            };
            let name = match (self.format.is_of_matlab(), is_upright) {
                (true, true) => format!("{of}(:,{})", k + 1),
                (true, false) => format!("{of}({},:)", k + 1),
                (false, true) => format!("{of}[:,{k}]"),
                (false, false) => format!("{of}[{k},:]"),
            };
            self.columns.push(ArrayColumn { name, length, array: index, first, step });
        }
        Ok(())
    }

    /// What the file holds besides columns of `length`, with what it is.
    pub fn others(&self, length: u64) -> Vec<String> {
        let words = self.arrays.iter().filter_map(|array| {
            array.other.as_ref().map(|other| format!("{} ({other})", shown(&array.name)))
        });
        let columns = self.columns.iter().filter(|column| column.length != length).map(|column| {
            let plural = if column.length == 1 { "" } else { "s" };
            format!("{} ({} value{plural})", column.name, column.length)
        });
        words.chain(columns).collect()
    }

    /// Reads columns, each array once.
    pub fn read(&self, columns: &[usize]) -> Result<Vec<Values>, SignalError> {
        self.read_first(columns, usize::MAX)
    }

    /// Reads columns, each array once, and keeps at most so many values of each.
    pub fn read_first(&self, columns: &[usize], most: usize) -> Result<Vec<Values>, SignalError> {
        let wrong = |reason: String| SignalError::Array { path: self.path.clone(), reason };
        let mut arrays: Vec<usize> =
            columns.iter().map(|column| self.columns[*column].array).collect();
        arrays.sort_unstable();
        arrays.dedup();
        let lengths = arrays.iter().map(|array| self.arrays[*array].len().unwrap_or(u64::MAX / 8));
        // Where all values are kept they are in memory together.
        let all: u64 = if most == usize::MAX {
            lengths.fold(0, u64::saturating_add)
        } else {
            lengths.max().unwrap_or(0)
        };
        if all.saturating_mul(8) > MOST {
            return Err(wrong(format!(
                "the arrays that are asked for have {all} values, read are at most {}; save them \
                 in parts, or as CSV",
                MOST / 8
            )));
        }
        let mut found: Vec<Option<Values>> = columns.iter().map(|_| None).collect();
        for index in arrays {
            let array = &self.arrays[index];
            let read = match self.format {
                Format::Npy => npy::read(&self.path, array),
                Format::Npz => npy::read_archive(&self.path, array),
                Format::Mat5 => mat5::read(&self.path, array),
                Format::Hdf5 => hdf5::read(&self.path, array),
            };
            let name = shown(&array.name);
            let values = read.map_err(|reason| wrong(format!("array {name}: {reason}")))?;
            if Some(values.len() as u64) != array.len() {
                let declared = array.len().unwrap_or(0);
                return Err(wrong(format!(
                    "array {name}: it is declared with {declared} values and has {}",
                    values.len()
                )));
            }
            for (column, found) in columns.iter().zip(&mut found) {
                let column = &self.columns[*column];
                if column.array == index {
                    // No longer than what was read.
                    let [first, step, length] =
                        [column.first, column.step, column.length].map(|number| number as usize);
                    *found = Some(values.part(first, step, length.min(most)));
                }
            }
        }
        Ok(found.into_iter().flatten().collect())
    }
}

/// A name without control characters.
fn shown(name: &str) -> String {
    super::text_layout::name(name.as_bytes())
}

/// Both ways to write a column, `a[:,0]` and `a(:,1)`, as one: `a[:,0]`.
pub(super) fn plain_name(name: &str) -> String {
    let Some(inside) = name.strip_suffix(')') else { return name.to_owned() };
    let Some((array, index)) = inside.rsplit_once('(') else { return name.to_owned() };
    let parts: Option<Vec<String>> = index
        .split(',')
        .map(|part| match part.trim() {
            ":" => Some(":".to_owned()),
            number => Some(number.parse::<u64>().ok()?.checked_sub(1)?.to_string()),
        })
        .collect();
    match parts {
        Some(parts) => format!("{array}[{}]", parts.join(",")),
        None => name.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_every_kind_are_read() {
        let read = |number: Number, bytes: &[u8], big_endian: bool| {
            number.read(&mut &*bytes, 1, (0, 0), big_endian).unwrap()
        };
        assert_eq!(read(Number::Int(1), &[0xfe], false), Values::Numbers(vec![-2.0]));
        assert_eq!(read(Number::Int(2), &[0xff, 0xfe], true), Values::Numbers(vec![-2.0]));
        assert_eq!(
            read(Number::Uint(4), &[0, 0, 0, 0x80], false),
            Values::Numbers(vec![2147483648.0])
        );
        assert_eq!(read(Number::Float(2), &[0, 0xc5], false), Values::Numbers(vec![-5.0]));
        assert_eq!(read(Number::Float(2), &[1, 0], false), Values::Numbers(vec![2f64.powi(-24)]));
        assert_eq!(
            read(Number::Int(8), &i64::MIN.to_le_bytes(), false),
            Values::Whole(vec![i64::MIN])
        );
        assert_eq!(
            read(Number::Uint(8), &u64::MAX.to_le_bytes(), false),
            Values::Numbers(vec![u64::MAX as f64])
        );
        assert_eq!(read(Number::Time(1000), &7i64.to_be_bytes(), true), Values::Times(vec![7000]));
        assert!(Number::Int(4).read(&mut &[1u8, 2][..], 1 << 40, (0, 0), false).is_err());
    }

    #[test]
    fn both_ways_to_name_a_column_are_one() {
        assert_eq!(plain_name("a(:,1)"), "a[:,0]");
        assert_eq!(plain_name("s.a( 2 , :)"), "s.a[1,:]");
        assert_eq!(plain_name("a[:,3]"), "a[:,3]");
        assert_eq!(plain_name("force (N)"), "force (N)");
        assert_eq!(plain_name("a(:,0)"), "a(:,0)");
    }
}
