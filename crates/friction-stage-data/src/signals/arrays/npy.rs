//! Arrays of NumPy: `.npy`, and `.npz`, an archive of them. Source: NumPy Enhancement Proposal 1.

use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;

use zip::ZipArchive;
use zip::read::ZipFile;

use super::{Array, Fault, Number, Values, fault_of};

/// What a `.npy` begins with.
pub(super) const MAGIC: &[u8] = b"\x93NUMPY";
/// Longest header, bytes.
const LONGEST_HEADER: u64 = 64 * 1024;
/// Most brackets inside each other in a header.
const DEEPEST: usize = 16;

/// The header of a `.npy`.
struct Header {
    shape: Vec<u64>,
    is_fortran: bool,
    columns: Vec<Column>,
}

/// A part of each element: the whole of it, or a field of a record.
struct Column {
    /// Empty where it is the whole.
    name: String,
    number: Result<Number, String>,
    big_endian: bool,
    /// Bytes of the element before it and after it.
    around: (usize, usize),
}

/// Arrays of a file with one array, or one of records.
pub(super) fn list(path: &Path) -> Result<Vec<Array>, Fault> {
    let mut file = open(path)?;
    Ok(arrays("", &Header::read(&mut file)?))
}

pub(super) fn read(path: &Path, array: &Array) -> Result<Values, Fault> {
    values(&mut open(path)?, "", array)
}

/// Arrays of an archive.
pub(super) fn list_archive(path: &Path) -> Result<Vec<Array>, Fault> {
    let mut archive = archive(path)?;
    let mut found = Vec::new();
    for index in 0..archive.len() {
        let mut entry = archive.by_index(index).map_err(|_| ENTRY.to_owned())?;
        let Some(name) = name_of(&entry) else { continue };
        match Header::read(&mut entry) {
            Ok(header) => found.extend(arrays(&name, &header)),
            Err(other) => found.push(Array {
                name,
                shape: Vec::new(),
                is_first_fastest: false,
                other: Some(other),
            }),
        }
    }
    Ok(found)
}

pub(super) fn read_archive(path: &Path, array: &Array) -> Result<Values, Fault> {
    let mut archive = archive(path)?;
    // The name of a field of records stands behind that of the array.
    let mut found = None;
    for index in 0..archive.len() {
        let entry = archive.by_index(index).map_err(|_| ENTRY.to_owned())?;
        let name = name_of(&entry).unwrap_or_default();
        match array.name.strip_prefix(&name) {
            Some("") => {
                found = Some(index);
                break;
            }
            Some(rest) if rest.starts_with('.') => found = Some(index),
            _ => {}
        }
    }
    let index = found.ok_or_else(|| "the file changes while it is read".to_owned())?;
    let mut entry = archive.by_index(index).map_err(|_| ENTRY.to_owned())?;
    let name = name_of(&entry).unwrap_or_default();
    values(&mut BufReader::new(&mut entry), &name, array)
}

const ENTRY: &str = "an entry of the archive is damaged, encrypted or compressed in a way that \
                     NumPy does not use";

/// The name of the array that an entry of an archive is; none for other entries.
fn name_of<R: Read>(entry: &ZipFile<'_, R>) -> Option<String> {
    entry.name().ok()?.strip_suffix(".npy").map(str::to_owned)
}

fn open(path: &Path) -> Result<BufReader<File>, Fault> {
    File::open(path).map(BufReader::new).map_err(|error| error.to_string())
}

fn archive(path: &Path) -> Result<ZipArchive<BufReader<File>>, Fault> {
    ZipArchive::new(open(path)?)
        .map_err(|_| "the archive is damaged or cut off: its list of entries does not read".into())
}

/// The arrays that a header declares.
fn arrays(name: &str, header: &Header) -> Vec<Array> {
    let array = |column: &Column| Array {
        name: joined(name, &column.name),
        shape: header.shape.clone(),
        is_first_fastest: header.is_fortran,
        other: column.number.as_ref().err().cloned(),
    };
    header.columns.iter().map(array).collect()
}

fn joined(array: &str, field: &str) -> String {
    match (array, field) {
        (array, "") => array.to_owned(),
        ("", field) => field.to_owned(),
        (array, field) => format!("{array}.{field}"),
    }
}

fn values(file: &mut dyn Read, name: &str, array: &Array) -> Result<Values, Fault> {
    let header = Header::read(file)?;
    let column = header.columns.iter().find(|column| joined(name, &column.name) == array.name);
    let column = column.ok_or_else(|| "the file changes while it is read".to_owned())?;
    let count = array.len().unwrap_or(u64::MAX);
    let number = column.number.clone()?;
    number.read(file, count, column.around, column.big_endian).map_err(|e| fault_of(&e))
}

impl Header {
    fn read(file: &mut dyn Read) -> Result<Self, Fault> {
        let text = header_text(file).map_err(|error| match error.kind() {
            io::ErrorKind::UnexpectedEof => "the file ends within its header".to_owned(),
            _ => error.to_string(),
        })?;
        Self::of(&text).ok_or_else(|| "its header is none of NumPy".to_owned())
    }

    fn of(text: &str) -> Option<Self> {
        let mut words = Words { text, depth: 0 };
        let Literal::List(entries) = words.literal()? else { return None };
        let entry = |key: &str| {
            entries.chunks_exact(2).find(|pair| pair[0] == Literal::Text(key.into())).map(|p| &p[1])
        };
        let Literal::List(shape) = entry("shape")? else { return None };
        let shape = shape.iter().map(Literal::number).collect::<Option<Vec<u64>>>()?;
        let is_fortran = *entry("fortran_order")? == Literal::Word("True".into());
        Some(Self { shape, is_fortran, columns: columns(entry("descr")?)? })
    }
}

fn header_text(file: &mut dyn Read) -> io::Result<String> {
    let invalid = |what: &str| io::Error::new(io::ErrorKind::InvalidData, what.to_owned());
    let mut begin = [0; 8];
    file.read_exact(&mut begin)?;
    if !begin.starts_with(MAGIC) {
        return Err(invalid("it does not begin as an array of NumPy"));
    }
    let mut length = [0; 4];
    let bytes = if begin[6] == 1 { 2 } else { 4 };
    file.read_exact(&mut length[..bytes])?;
    let length = u64::from(u32::from_le_bytes(length));
    if length > LONGEST_HEADER {
        return Err(invalid("its header is longer than any of NumPy"));
    }
    let mut text = vec![0; length as usize];
    file.read_exact(&mut text)?;
    String::from_utf8(text).map_err(|_| invalid("its header is none of NumPy"))
}

/// The columns of a type: one, or one for each field of a record.
fn columns(kind: &Literal) -> Option<Vec<Column>> {
    if let Literal::Text(kind) = kind {
        let (number, big_endian, _) = number(kind)?;
        return Some(vec![Column { name: String::new(), number, big_endian, around: (0, 0) }]);
    }
    let Literal::List(fields) = kind else { return None };
    let mut columns = Vec::new();
    let mut before = 0usize;
    for field in fields {
        let Literal::List(parts) = field else { return None };
        let name = match parts.first()? {
            Literal::Text(name) => name.clone(),
            // A title, and the name.
            Literal::List(names) => match names.last()? {
                Literal::Text(name) => name.clone(),
                _ => return None,
            },
            _ => return None,
        };
        let Literal::Text(kind) = parts.get(1)? else { return None };
        let (mut number, big_endian, mut size) = number(kind)?;
        if let Some(shape) = parts.get(2) {
            let lengths = match shape {
                Literal::List(lengths) => lengths.iter().map(Literal::number).collect(),
                length => length.number().map(|length| vec![length]),
            };
            for length in lengths? {
                size = size.checked_mul(usize::try_from(length).ok()?)?;
            }
            number = Err("several values in each row".into());
        }
        // Fields without a name are room that is not used.
        if !name.is_empty() {
            columns.push(Column { name, number, big_endian, around: (before, size) });
        }
        before = before.checked_add(size).filter(|size| *size < 1 << 20)?;
    }
    for column in &mut columns {
        column.around.1 = before - column.around.0 - column.number.as_ref().map_or(0, |n| n.size());
    }
    Some(columns)
}

/// How a type such as `<f8` is stored, or what it is instead of a number; its endianness and its
/// size in bytes.
fn number(kind: &str) -> Option<(Result<Number, String>, bool, usize)> {
    let order = kind.chars().next()?;
    let rest = kind.strip_prefix(['<', '>', '|', '=']).unwrap_or(kind);
    let letter = rest.chars().next()?;
    let (digits, unit) = match rest[letter.len_utf8()..].split_once('[') {
        Some((digits, unit)) => (digits, unit.trim_end_matches(']')),
        None => (&rest[letter.len_utf8()..], ""),
    };
    let size: usize = if digits.is_empty() { 0 } else { digits.parse().ok()? };
    let other = |what: &str| Err(what.to_owned());
    let number = match (letter, size) {
        ('i', 1 | 2 | 4 | 8) => Ok(Number::Int(size)),
        ('u', 1 | 2 | 4 | 8) | ('b', 1) => Ok(Number::Uint(size)),
        ('f', 2 | 4 | 8) => Ok(Number::Float(size)),
        ('M' | 'm', 8) => match unit {
            "ns" => Ok(Number::Time(1)),
            "us" => Ok(Number::Time(1_000)),
            "ms" => Ok(Number::Time(1_000_000)),
            "s" => Ok(Number::Time(1_000_000_000)),
            _ => other("times in a unit other than s, ms, us and ns"),
        },
        ('f', _) => other("numbers of more than 64 bits"),
        ('c', _) => other("complex numbers"),
        ('S' | 'a' | 'U', _) => other("text"),
        ('O', _) => other("objects"),
        _ => other("no numbers"),
    };
    let bytes = if letter == 'U' { size.checked_mul(4)? } else { size };
    Some((number, order == '>', bytes))
}

/// A literal of Python; a dict is the list of its keys and values.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Literal {
    Text(String),
    Word(String),
    List(Vec<Literal>),
}

impl Literal {
    fn number(&self) -> Option<u64> {
        match self {
            Literal::Word(word) => word.trim_end_matches('L').parse().ok(),
            _ => None,
        }
    }
}

struct Words<'a> {
    text: &'a str,
    depth: usize,
}

impl Words<'_> {
    fn literal(&mut self) -> Option<Literal> {
        self.text = self.text.trim_start();
        let first = self.text.chars().next()?;
        match first {
            '\'' | '"' => {
                let (text, rest) = self.text[1..].split_once(first)?;
                self.text = rest;
                Some(Literal::Text(text.to_owned()))
            }
            '(' | '[' | '{' => {
                self.depth += 1;
                if self.depth > DEEPEST {
                    return None;
                }
                self.text = &self.text[1..];
                let mut parts = Vec::new();
                loop {
                    self.text = self.text.trim_start_matches([' ', ',', ':', '\n']);
                    if let Some(rest) = self.text.strip_prefix([')', ']', '}']) {
                        self.text = rest;
                        self.depth -= 1;
                        return Some(Literal::List(parts));
                    }
                    parts.push(self.literal()?);
                }
            }
            _ => {
                let end = self.text.find(|c: char| !c.is_alphanumeric() && c != '_' && c != '-');
                let (word, rest) = self.text.split_at(end.unwrap_or(self.text.len()));
                self.text = rest;
                (!word.is_empty()).then(|| Literal::Word(word.to_owned()))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::io::Cursor;

    #[test]
    fn headers_of_numpy_are_read() {
        let text = "{'descr': [('t', '<f8'), ('pad', '|S3'), (('title', 'x'), '>i4'), ('v', '<f4', \
                    (3,))], 'fortran_order': True, 'shape': (10, 2), }";
        let header = Header::of(text).unwrap();
        assert_eq!((header.shape.as_slice(), header.is_fortran), (&[10, 2][..], true));
        let names: Vec<&str> = header.columns.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names, ["t", "pad", "x", "v"]);
        assert_eq!(header.columns[2].around, (11, 12));
        assert!(header.columns[2].big_endian);
        assert_eq!(header.columns[0].around, (0, 19));
        let scalar = Header::of("{'descr': '<M8[us]', 'fortran_order': False, 'shape': (3,)}");
        assert_eq!(scalar.unwrap().columns[0].number, Ok(Number::Time(1000)));
        assert!(Header::of(&"(".repeat(10_000)).is_none());
    }

    proptest! {
        #[test]
        fn garbage_never_panics(text in "[a-z0-9'()<>, :\\[\\]{}]{0,120}", bytes: Vec<u8>) {
            let _ = Header::of(&text);
            let _ = Header::read(&mut Cursor::new([MAGIC, &bytes[..]].concat()));
        }
    }
}
