//! Variables of a `.mat` of MATLAB, versions 5 to 7: numbers of every class, and fields of structs.
//! Source: MathWorks, MAT-File Format (R2018b), chapter 1.
//!
//! The file is walked element by element; compressed ones are unpacked as they are walked.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use flate2::bufread::ZlibDecoder;

use super::{AN_OBJECT, Array, Fault, MOST, Number, Values, fault_of};

/// Bytes before the first element.
const HEADER: u64 = 128;
/// Structs in structs.
const DEEPEST: usize = 8;
/// Longest name, and longest list of names of fields, bytes.
const LONGEST_NAME: u64 = 64 * 1024;
/// Most dimensions, bytes.
const LONGEST_SHAPE: u64 = 256;

const COMPRESSED: u32 = 15;
const MATRIX: u32 = 14;

/// Lists the variables.
pub(super) fn list(path: &Path) -> Result<Vec<Array>, Fault> {
    let mut found = Vec::new();
    walk(path, &mut |array, _| {
        found.push(array.clone());
        Ok(None)
    })?;
    Ok(found)
}

/// Reads the values of one variable.
pub(super) fn read(path: &Path, wanted: &Array) -> Result<Values, Fault> {
    let found = walk(path, &mut |array, elements| {
        if array != wanted {
            return Ok(None);
        }
        elements.numbers(array.len().unwrap_or(u64::MAX)).map(Some)
    })?;
    found.ok_or_else(|| "the file changes while it is read".to_owned())
}

/// What is done with a variable whose values come next; it ends the walk with values.
type Visit<'a> = dyn FnMut(&Array, &mut Elements<'_>) -> io::Result<Option<Values>> + 'a;

fn walk(path: &Path, visit: &mut Visit<'_>) -> Result<Option<Values>, Fault> {
    let fault = |error: io::Error| match error.kind() {
        io::ErrorKind::Unsupported => error.to_string(),
        _ => fault_of(&error),
    };
    let mut file = BufReader::new(File::open(path).map_err(|error| error.to_string())?);
    let size = file.get_ref().metadata().map_err(|error| error.to_string())?.len();
    let mut header = [0; HEADER as usize];
    file.read_exact(&mut header).map_err(fault)?;
    let big_endian = header[126..] == *b"MI";
    let mut at = HEADER;
    while at < size {
        let mut elements = Elements { reader: &mut file, big_endian, left: size - at };
        let Some(tag) = elements.tag().map_err(fault)? else { break };
        let begin = at + tag.bytes;
        if tag.length > size.saturating_sub(begin) {
            return Err(format!(
                "the element at byte {at} is declared with {} bytes, {} are left in the file",
                tag.length,
                size.saturating_sub(begin)
            ));
        }
        let found = match tag.kind {
            COMPRESSED => {
                let mut packed = ZlibDecoder::new((&mut file).take(tag.length));
                let mut inside = Elements { reader: &mut packed, big_endian, left: u64::MAX };
                inside.tag().and_then(|inner| match inner {
                    Some(inner) if inner.kind == MATRIX => {
                        inside.left = inner.length;
                        inside.matrix("", 0, visit)
                    }
                    _ => Ok(None),
                })
            }
            MATRIX => {
                let mut inside = Elements { reader: &mut file, big_endian, left: tag.length };
                inside.matrix("", 0, visit)
            }
            _ => Ok(None),
        };
        if let Some(values) = found.map_err(fault)? {
            return Ok(Some(values));
        }
        // A compressed element is not filled up to eight bytes.
        let padded = if tag.kind == COMPRESSED { tag.length } else { tag.padded() };
        at = begin.saturating_add(padded);
        file.seek(SeekFrom::Start(at)).map_err(fault)?;
    }
    Ok(None)
}

/// What stands before the data of an element.
struct Tag {
    kind: u32,
    length: u64,
    /// Bytes of the tag itself.
    bytes: u64,
}

impl Tag {
    /// Bytes of the data with what fills them up.
    fn padded(&self) -> u64 {
        if self.bytes == 4 { 4 } else { self.length.next_multiple_of(8) }
    }
}

/// Reads the elements inside another one.
struct Elements<'a> {
    reader: &'a mut dyn Read,
    big_endian: bool,
    /// Bytes up to the end of what they are inside of.
    left: u64,
}

impl Elements<'_> {
    fn exact<const N: usize>(&mut self) -> io::Result<[u8; N]> {
        let mut bytes = [0; N];
        if self.left < N as u64 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        self.reader.read_exact(&mut bytes)?;
        self.left -= N as u64;
        Ok(bytes)
    }

    fn u32(&self, bytes: [u8; 4]) -> u32 {
        if self.big_endian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) }
    }

    /// The next tag; none at the end.
    fn tag(&mut self) -> io::Result<Option<Tag>> {
        if self.left < 8 {
            return Ok(None);
        }
        let first = self.exact()?;
        let first = self.u32(first);
        if first >> 16 != 0 {
            // Up to four bytes of data stand in the tag.
            let (kind, length) = (first & 0xffff, u64::from(first >> 16));
            if length > 4 {
                return Err(io::ErrorKind::InvalidData.into());
            }
            return Ok(Some(Tag { kind, length, bytes: 4 }));
        }
        let length = self.exact()?;
        Ok(Some(Tag { kind: first, length: u64::from(self.u32(length)), bytes: 8 }))
    }

    fn needed_tag(&mut self) -> io::Result<Tag> {
        self.tag()?.ok_or_else(|| io::ErrorKind::UnexpectedEof.into())
    }

    fn skip(&mut self, bytes: u64) -> io::Result<()> {
        let bytes = bytes.min(self.left);
        let skipped = io::copy(&mut (&mut *self.reader).take(bytes), &mut io::sink())?;
        self.left -= skipped;
        if skipped < bytes { Err(io::ErrorKind::UnexpectedEof.into()) } else { Ok(()) }
    }

    /// The data of a short element.
    fn short(&mut self, most: u64) -> io::Result<Vec<u8>> {
        let tag = self.needed_tag()?;
        if tag.length > most || tag.length > self.left {
            return Err(io::ErrorKind::InvalidData.into());
        }
        let mut bytes = vec![0; tag.length as usize];
        self.reader.read_exact(&mut bytes)?;
        self.left -= tag.length;
        self.skip(tag.padded() - tag.length)?;
        Ok(bytes)
    }

    /// The lengths along the dimensions of an array, or other numbers of 32 bits.
    fn integers(&mut self) -> io::Result<Vec<u64>> {
        let bytes = self.short(LONGEST_SHAPE)?;
        let number = |chunk: &[u8]| u64::from(self.u32([chunk[0], chunk[1], chunk[2], chunk[3]]));
        Ok(bytes.chunks_exact(4).map(number).collect())
    }

    /// A variable, or a field of one, and what is inside of it.
    fn matrix(
        &mut self,
        before: &str,
        depth: usize,
        visit: &mut Visit<'_>,
    ) -> io::Result<Option<Values>> {
        let flags = self.short(16)?;
        let &[a, b, c, d, ..] = flags.as_slice() else {
            return Err(io::ErrorKind::InvalidData.into());
        };
        let flags = self.u32([a, b, c, d]);
        let class = flags & 0xff;
        if class == 17 {
            // An object has no shape; what it holds is not known.
            let name = String::from_utf8_lossy(&self.short(LONGEST_NAME)?).into_owned();
            return self.other(join(before, &name), Vec::new(), AN_OBJECT, visit);
        }
        let shape = self.integers()?;
        let name = String::from_utf8_lossy(&self.short(LONGEST_NAME)?).into_owned();
        if name.is_empty() && before.is_empty() {
            // What MATLAB keeps for itself.
            return Ok(None);
        }
        let name = join(before, &name);
        let is_complex = flags & 0x0800 != 0;
        match class {
            6..=15 if is_complex => self.other(name, shape, "complex numbers", visit),
            6..=15 => {
                let array = Array { name, shape, is_first_fastest: true, other: None };
                visit(&array, self)
            }
            2 if shape.iter().all(|length| *length == 1) && depth < DEEPEST => {
                self.fields(&name, depth, visit)
            }
            2 => self.other(name, shape, "a struct array", visit),
            1 => self.other(name, shape, "a cell array", visit),
            3 | 17 => self.other(name, shape, AN_OBJECT, visit),
            4 => self.other(name, shape, "text", visit),
            5 => self.other(name, shape, "a sparse matrix", visit),
            _ => self.other(name, shape, "no numbers", visit),
        }
    }

    fn other(
        &mut self,
        name: String,
        shape: Vec<u64>,
        what: &str,
        visit: &mut Visit<'_>,
    ) -> io::Result<Option<Values>> {
        let other = Some(what.to_owned());
        visit(&Array { name, shape, is_first_fastest: true, other }, self)
    }

    /// The fields of a struct.
    fn fields(
        &mut self,
        before: &str,
        depth: usize,
        visit: &mut Visit<'_>,
    ) -> io::Result<Option<Values>> {
        let width = self.integers()?.first().copied().unwrap_or(0) as usize;
        let names = self.short(LONGEST_NAME)?;
        if width == 0 {
            return Ok(None);
        }
        for name in names.chunks(width) {
            let end = name.iter().position(|byte| *byte == 0).unwrap_or(name.len());
            let name = join(before, &String::from_utf8_lossy(&name[..end]));
            let tag = self.needed_tag()?;
            if tag.kind != MATRIX || tag.length > self.left {
                return Err(io::ErrorKind::InvalidData.into());
            }
            if tag.length > MOST {
                let array = Array {
                    name,
                    shape: Vec::new(),
                    is_first_fastest: true,
                    other: Some(LARGE.into()),
                };
                // What comes after it is not looked for.
                return visit(&array, self);
            }
            if tag.length == 0 {
                continue;
            }
            let mut inside = Elements {
                reader: &mut *self.reader,
                big_endian: self.big_endian,
                left: tag.length,
            };
            let found = inside.matrix(&name, depth + 1, visit)?;
            if found.is_some() {
                return Ok(found);
            }
            let left = inside.left;
            self.left -= tag.length - left;
            self.skip(left)?;
        }
        Ok(None)
    }

    /// The numbers of an array, which come next. They may be stored in less room than their class
    /// says.
    fn numbers(&mut self, count: u64) -> io::Result<Values> {
        let tag = self.needed_tag()?;
        let number = match tag.kind {
            1 => Number::Int(1),
            2 => Number::Uint(1),
            3 => Number::Int(2),
            4 => Number::Uint(2),
            5 => Number::Int(4),
            6 => Number::Uint(4),
            7 => Number::Float(4),
            9 => Number::Float(8),
            12 => Number::Int(8),
            13 => Number::Uint(8),
            _ => return Err(io::ErrorKind::InvalidData.into()),
        };
        let size = number.size() as u64;
        if tag.length > self.left || count.checked_mul(size) != Some(tag.length) {
            return Err(io::Error::new(
                io::ErrorKind::Unsupported,
                format!("{count} values are declared, {} are stored", tag.length / size),
            ));
        }
        number.read(&mut io::BufReader::new(&mut *self.reader), count, (0, 0), self.big_endian)
    }
}

const LARGE: &str = "more values than are read";

fn join(before: &str, name: &str) -> String {
    match (before, name) {
        ("", name) => name.to_owned(),
        (before, "") => before.to_owned(),
        (before, name) => format!("{before}.{name}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Writes elements; independent of the code above.
    struct Writer {
        bytes: Vec<u8>,
        big_endian: bool,
    }

    impl Writer {
        fn u32(&mut self, value: u32) {
            self.bytes.extend(if self.big_endian {
                value.to_be_bytes()
            } else {
                value.to_le_bytes()
            });
        }

        fn element(&mut self, kind: u32, data: &[u8]) {
            if data.len() <= 4 {
                self.u32((data.len() as u32) << 16 | kind);
                self.bytes.extend(data);
                self.bytes.resize(self.bytes.len() + 4 - data.len(), 0);
            } else {
                self.u32(kind);
                self.u32(data.len() as u32);
                self.bytes.extend(data);
                self.bytes.resize(self.bytes.len().next_multiple_of(8), 0);
            }
        }

        fn inside(&self, fill: impl FnOnce(&mut Writer)) -> Vec<u8> {
            let mut inside = Writer { bytes: Vec::new(), big_endian: self.big_endian };
            fill(&mut inside);
            inside.bytes
        }

        fn numbers(&self, values: &[u32]) -> Vec<u8> {
            self.inside(|writer| values.iter().for_each(|value| writer.u32(*value)))
        }

        /// A variable of a class with values in a type of storage.
        fn variable(&mut self, name: &str, class: u32, count: u32, kind: u32, values: &[u8]) {
            let (flags, shape) = (self.numbers(&[class, 0]), self.numbers(&[count, 1]));
            let data = self.inside(|writer| {
                writer.element(6, &flags);
                writer.element(5, &shape);
                writer.element(1, name.as_bytes());
                writer.element(kind, values);
            });
            self.element(MATRIX, &data);
        }
    }

    #[test]
    fn both_endians_and_values_in_less_room_are_read() {
        for big_endian in [false, true] {
            let mut writer = Writer { bytes: vec![b' '; 124], big_endian };
            writer.bytes.extend(if big_endian { *b"\x01\x00MI" } else { *b"\x00\x01IM" });
            let bytes = |v: f64| if big_endian { v.to_be_bytes() } else { v.to_le_bytes() };
            writer.variable("long_name", 6, 2, 9, &[1.5, -2.5].map(bytes).concat());
            // doubles that are small whole numbers, stored as bytes
            writer.variable("a", 6, 3, 2, &[7, 8, 9]);
            // what MATLAB adds for objects has no name
            writer.variable("", 9, 3, 2, &[7, 8, 9]);
            let file = tempfile::NamedTempFile::new().unwrap();
            std::fs::write(file.path(), &writer.bytes).unwrap();
            let arrays = list(file.path()).unwrap();
            let names: Vec<&str> = arrays.iter().map(|array| array.name.as_str()).collect();
            assert_eq!(names, ["long_name", "a"]);
            let values: Vec<Values> =
                arrays.iter().map(|array| read(file.path(), array).unwrap()).collect();
            assert_eq!(values[0], Values::Numbers(vec![1.5, -2.5]));
            assert_eq!(values[1], Values::Numbers(vec![7.0, 8.0, 9.0]));
        }
    }
}
