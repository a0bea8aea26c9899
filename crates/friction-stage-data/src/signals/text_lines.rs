//! A text as lines, and a line as fields.

use std::collections::VecDeque;
use std::io::{self, BufRead, BufReader, Read};

use super::mapping::Delimiter;

/// A longer line belongs to no table, bytes.
pub(super) const LONGEST_LINE: usize = 1 << 20;

/// Lines that a field in quotes may have: the names of a spreadsheet's columns wrap. A quotation
/// mark that does not close within them is no more than a sign in its line.
const LINES_OF_FIELD: usize = 8;

/// The lines of a text: they end with LF, CR LF or CR. Lines that a field in quotes joins are one,
/// with one blank where they were joined and the number of the first.
pub(super) struct Lines<R> {
    reader: BufReader<R>,
    line: Vec<u8>,
    number: u64,
    /// Lines that were read to look for the end of a field in quotes, and not needed for it.
    ahead: VecDeque<Vec<u8>>,
    after_return: bool,
}

impl<R: Read> Lines<R> {
    pub fn new(text: R) -> Self {
        Lines {
            reader: BufReader::new(text),
            line: Vec::new(),
            number: 0,
            ahead: VecDeque::new(),
            after_return: false,
        }
    }

    /// The next line with its number, from 1.
    ///
    /// # Errors
    /// The text cannot be read, or a line is longer than [`LONGEST_LINE`].
    pub fn next(&mut self) -> io::Result<Option<(u64, &[u8])>> {
        match self.ahead.pop_front() {
            Some(line) => self.line = line,
            None if !self.read(self.number)? => return Ok(None),
            None => {}
        }
        self.number += 1;
        let number = self.number;
        if is_open(false, &self.line) {
            self.join()?;
        }
        Ok(Some((number, &self.line)))
    }

    /// Passes over what is before the line of this number.
    ///
    /// # Errors
    /// As [`Lines::next`].
    pub fn skip_before(&mut self, number: u64) -> io::Result<()> {
        while self.number + 1 < number && self.next()?.is_some() {}
        Ok(())
    }

    /// Joins the line, in which a field in quotes begins, with those that the field has more.
    fn join(&mut self) -> io::Result<()> {
        let begin = std::mem::take(&mut self.line);
        let mut closed_by = None;
        let mut size = begin.len();
        for more in 0..LINES_OF_FIELD - 1 {
            if more == self.ahead.len() {
                if !self.read(self.number + more as u64)? {
                    break;
                }
                self.ahead.push_back(std::mem::take(&mut self.line));
            }
            size += self.ahead[more].len();
            if size > LONGEST_LINE {
                break;
            }
            if !is_open(true, &self.ahead[more]) {
                closed_by = Some(more + 1);
                break;
            }
        }
        self.line = begin;
        for line in self.ahead.drain(..closed_by.unwrap_or(0)) {
            self.line.truncate(self.line.trim_ascii_end().len());
            self.line.push(b' ');
            self.line.extend(line.trim_ascii());
            self.number += 1;
        }
        Ok(())
    }

    /// Reads one more line of the file after `number` of them; `false` at its end.
    fn read(&mut self, number: u64) -> io::Result<bool> {
        self.line.clear();
        let mut is_any = false;
        loop {
            let mut part = self.reader.fill_buf()?;
            if part.is_empty() {
                return Ok(is_any);
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
                    format!("line {} has more than {LONGEST_LINE} bytes", number + 1),
                ));
            }
            if end.is_some() {
                return Ok(true);
            }
        }
    }
}

/// Whether a field in quotes is open at the end of a line, at whose begin one was if `open`.
///
/// A quotation mark opens a field at its begin only: elsewhere it means inches or seconds of arc.
fn is_open(mut open: bool, line: &[u8]) -> bool {
    if !open && memchr::memchr(b'"', line).is_none() {
        return false;
    }
    let mut is_begin = !open;
    let mut bytes = line.iter().peekable();
    while let Some(&byte) = bytes.next() {
        if !open {
            open = is_begin && byte == b'"';
        } else if byte == b'"' {
            // Two of them stand for one.
            open = bytes.next_if_eq(&&b'"').is_some();
        }
        is_begin = !open && matches!(byte, b',' | b';' | b'\t' | b'|' | b' ');
    }
    open
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

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(text: &str) -> Vec<(u64, String)> {
        let mut lines = Lines::new(text.as_bytes());
        let mut found = Vec::new();
        while let Some((number, line)) = lines.next().unwrap() {
            found.push((number, String::from_utf8(line.to_vec()).unwrap()));
        }
        found
    }

    fn numbered(expected: &[(u64, &str)]) -> Vec<(u64, String)> {
        expected.iter().map(|(number, line)| (*number, (*line).to_owned())).collect()
    }

    #[test]
    fn a_field_in_quotes_joins_its_lines() {
        assert_eq!(
            lines("\"time\r\n(s)\",\"position\n(mm)\n\"\"left\"\"\"\r\n0,1\r\n1,2"),
            numbered(&[(1, "\"time (s)\",\"position (mm) \"\"left\"\"\""), (5, "0,1"), (6, "1,2")])
        );
    }

    #[test]
    fn a_quotation_mark_that_opens_nothing_is_a_sign_in_its_line() {
        let text = "travel 3.5\", steel\nx,y\n0,1";
        assert_eq!(lines(text), numbered(&[(1, "travel 3.5\", steel"), (2, "x,y"), (3, "0,1")]));
        // One that never closes takes no line with it.
        let rows: Vec<String> = (0..40).map(|row| format!("{row},1")).collect();
        let text = format!("\"open\n{}", rows.join("\n"));
        let found = lines(&text);
        assert_eq!(found.len(), 41);
        assert_eq!(found[0], (1, "\"open".to_owned()));
        assert_eq!(found[40], (41, "39,1".to_owned()));
        // Nor does one that is followed by another of its kind.
        assert_eq!(lines("\"a\n\"b\nc").last(), Some(&(3, "c".to_owned())));
    }
}
