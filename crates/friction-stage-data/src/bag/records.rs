//! Records of MCAP, each length in them checked against what is left before it is believed.
//!
//! The library reserves what a length says: a damaged one would take all memory. Source of the
//! layouts: MCAP specification, version 0.

use mcap::records::{Record, op};

/// A part of a record that has a length of its own, or a fixed one.
#[derive(Clone, Copy)]
enum Part {
    Fixed(usize),
    /// Bytes with their number before them, in 32 bits.
    Bytes,
    /// Bytes with their number before them, in 64 bits.
    LongBytes,
    /// Pairs of texts, with the bytes of all of them before.
    Texts,
}

use Part::{Bytes, Fixed, LongBytes, Texts};

/// The parts of the records that have lengths inside.
fn parts(opcode: u8) -> &'static [Part] {
    match opcode {
        op::HEADER => &[Bytes, Bytes],
        op::SCHEMA => &[Fixed(2), Bytes, Bytes, Bytes],
        op::CHANNEL => &[Fixed(4), Bytes, Bytes, Texts],
        op::CHUNK => &[Fixed(28), Bytes, LongBytes],
        op::MESSAGE_INDEX => &[Fixed(2), Bytes],
        op::CHUNK_INDEX => &[Fixed(32), Bytes, Fixed(8), Bytes, Fixed(16)],
        op::ATTACHMENT => &[Fixed(16), Bytes, Bytes, LongBytes, Fixed(4)],
        op::ATTACHMENT_INDEX => &[Fixed(40), Bytes, Bytes],
        op::STATISTICS => &[Fixed(42), Bytes],
        op::METADATA => &[Bytes, Texts],
        op::METADATA_INDEX => &[Fixed(16), Bytes],
        _ => &[],
    }
}

/// Bytes that are read forward.
struct Rest<'a>(&'a [u8]);

impl<'a> Rest<'a> {
    fn take(&mut self, count: u64) -> Result<&'a [u8], String> {
        let left = self.0.len();
        let count = usize::try_from(count).ok().filter(|count| *count <= left);
        let count =
            count.ok_or_else(|| format!("a length beyond the {left} bytes that are left"))?;
        let (taken, rest) = self.0.split_at(count);
        self.0 = rest;
        Ok(taken)
    }

    fn counted(&mut self) -> Result<&'a [u8], String> {
        let length = self.take(4)?.first_chunk().copied().unwrap_or_default();
        self.take(u64::from(u32::from_le_bytes(length)))
    }
}

/// Reads a record. The error says what is wrong with it.
pub(super) fn parse(opcode: u8, body: &[u8]) -> Result<Record<'_>, String> {
    let mut rest = Rest(body);
    for part in parts(opcode) {
        match part {
            Fixed(count) => {
                rest.take(*count as u64)?;
            }
            Bytes => {
                rest.counted()?;
            }
            LongBytes => {
                let length = rest.take(8)?.first_chunk().copied().unwrap_or_default();
                rest.take(u64::from_le_bytes(length))?;
            }
            Texts => {
                let mut texts = Rest(rest.counted()?);
                while !texts.0.is_empty() {
                    texts.counted()?;
                }
            }
        }
    }
    mcap::parse_record(opcode, body).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every length of every record in a whole file, set to the largest one.
    #[test]
    fn no_length_is_believed() {
        let text = |text: &str| [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat();
        let texts = [text("key"), text("value")].concat();
        let texts = [(texts.len() as u32).to_le_bytes().to_vec(), texts].concat();
        let long = [2u64.to_le_bytes().to_vec(), vec![7, 7]].concat();
        let of = |parts: &[Part]| -> (Vec<u8>, Vec<usize>) {
            let (mut body, mut lengths) = (Vec::new(), Vec::new());
            for part in parts {
                if !matches!(part, Fixed(_)) {
                    lengths.push(body.len());
                }
                match part {
                    Fixed(count) => body.extend(vec![0; *count]),
                    Bytes => body.extend(text("")),
                    LongBytes => body.extend(&long),
                    Texts => {
                        lengths.push(body.len() + 4);
                        body.extend(&texts);
                    }
                }
            }
            (body, lengths)
        };
        for opcode in op::HEADER..=op::DATA_END {
            let (body, lengths) = of(parts(opcode));
            for at in lengths {
                let mut body = body.clone();
                body[at..at + 4].fill(0xff);
                let error = parse(opcode, &body).unwrap_err();
                assert!(error.contains("a length beyond the"), "{opcode} at {at}: {error}");
            }
        }
    }
}
