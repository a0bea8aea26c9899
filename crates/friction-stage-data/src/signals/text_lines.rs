//! A text as lines, and a line as fields.

use std::io::{self, BufRead, BufReader, Read};

use super::mapping::Delimiter;

/// A longer line belongs to no table, bytes.
pub(super) const LONGEST_LINE: usize = 1 << 20;

/// The lines of a text: they end with LF, CR LF or CR.
pub(super) struct Lines<R> {
    reader: BufReader<R>,
    line: Vec<u8>,
    number: u64,
    after_return: bool,
}

impl<R: Read> Lines<R> {
    pub fn new(text: R) -> Self {
        Lines { reader: BufReader::new(text), line: Vec::new(), number: 0, after_return: false }
    }

    /// The next line with its number, from 1.
    ///
    /// # Errors
    /// The text cannot be read, or a line is longer than [`LONGEST_LINE`].
    pub fn next(&mut self) -> io::Result<Option<(u64, &[u8])>> {
        self.line.clear();
        let mut is_any = false;
        loop {
            let mut part = self.reader.fill_buf()?;
            if part.is_empty() {
                if !is_any {
                    return Ok(None);
                }
                break;
            }
            if std::mem::take(&mut self.after_return) && part[0] == b'\n' {
                self.reader.consume(1);
                part = self.reader.fill_buf()?;
                if part.is_empty() {
                    continue;
                }
            }
            is_any = true;
            let end = memchr::memchr2(b'\n', b'\r', part);
            self.line.extend(&part[..end.unwrap_or(part.len())]);
            self.after_return = end.is_some_and(|end| part[end] == b'\r');
            let read = end.map_or(part.len(), |end| end + 1);
            self.reader.consume(read);
            if self.line.len() > LONGEST_LINE {
                return Err(io::Error::new(
                    io::ErrorKind::InvalidData,
                    format!("line {} has more than {LONGEST_LINE} bytes", self.number + 1),
                ));
            }
            if end.is_some() {
                break;
            }
        }
        self.number += 1;
        Ok(Some((self.number, &self.line)))
    }
}

/// Takes lines apart; a field in quotes may hold delimiters.
pub(super) struct Splitter {
    reader: csv_core::Reader,
    blanks: bool,
    /// The line, with one blank between words where blanks separate.
    text: Vec<u8>,
    bytes: Vec<u8>,
    ends: Vec<usize>,
    count: usize,
}

impl Splitter {
    pub fn new(delimiter: Delimiter) -> Self {
        let (byte, blanks) = match delimiter {
            Delimiter::Byte(byte) => (byte, false),
            Delimiter::Blanks => (b' ', true),
        };
        Splitter {
            reader: csv_core::ReaderBuilder::new().delimiter(byte).build(),
            blanks,
            text: Vec::new(),
            bytes: Vec::new(),
            ends: Vec::new(),
            count: 0,
        }
    }

    /// Takes `line` apart, for [`Splitter::field`].
    pub fn split(&mut self, line: &[u8]) {
        self.text.clear();
        if self.blanks {
            let words = line.split(|byte| matches!(byte, b' ' | b'\t')).filter(|w| !w.is_empty());
            for word in words {
                if !self.text.is_empty() {
                    self.text.push(b' ');
                }
                self.text.extend(word);
            }
        } else {
            self.text.extend(line);
        }
        self.text.push(b'\n');
        // Room for a line of delimiters only.
        self.bytes.resize(self.text.len(), 0);
        self.ends.resize(self.text.len() + 1, 0);
        self.reader.reset();
        let (_, _, _, count) = self.reader.read_record(&self.text, &mut self.bytes, &mut self.ends);
        self.count = count;
    }

    /// Number of fields of the line.
    pub fn len(&self) -> usize {
        self.count
    }

    /// A field without the blanks around it; empty beyond the last.
    pub fn field(&self, index: usize) -> &[u8] {
        if index >= self.count {
            return b"";
        }
        let begin = index.checked_sub(1).map_or(0, |before| self.ends[before]);
        self.bytes[begin..self.ends[index]].trim_ascii()
    }

    /// All fields.
    pub fn fields(&self) -> impl Iterator<Item = &[u8]> {
        (0..self.count).map(|index| self.field(index))
    }
}
