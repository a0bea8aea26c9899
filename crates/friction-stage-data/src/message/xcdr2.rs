//! Version 2 of CDR (XCDR2) brought to version 1, so that one reader does for both.
//!
//! Source: OMG DDS-XTypes 1.3, 7.4.3: numbers of eight bytes are aligned to four; sequences and
//! arrays of anything but numbers begin with their length in bytes; so does every struct of a type
//! that may be extended (delimited). That the parts of a delimited type are delimited, too, is
//! *assumed*: the bytes do not say it, and IDL makes types so by default.
//!
//! Not read: mutable types (parameter lists), whose fields stand in any order.

use super::type_layout::{Cursor, Kind, Many, TypeLayout};

/// How a message of version 2 is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Encoding {
    big_endian: bool,
    is_delimited: bool,
}

impl Encoding {
    /// What the encapsulation of a message says; none for plain CDR of version 1. The error says
    /// what else it is.
    pub fn of(message: &[u8]) -> Result<Option<Self>, String> {
        let Some([high, low, _, _]) = message.first_chunk::<4>() else {
            return Err(format!(
                "it has {} bytes, a CDR message begins with 4 bytes of encapsulation",
                message.len()
            ));
        };
        let representation = u16::from_be_bytes([*high, *low]);
        let version_2 = |is_delimited: bool| {
            Some(Self { big_endian: representation.is_multiple_of(2), is_delimited })
        };
        match representation {
            0x0000 | 0x0001 => Ok(None),
            0x0006 | 0x0007 => Ok(version_2(false)),
            0x0008 | 0x0009 => Ok(version_2(true)),
            0x0002 | 0x0003 | 0x000a | 0x000b => Err(format!(
                "it is a list of parameters (CDR representation {representation:#06x}), as types \
                 that are declared mutable are written; read are plain and delimited CDR"
            )),
            other => Err(format!(
                "it is in CDR representation {other:#06x}, read are 0x0000, 0x0001 (version 1) and \
                 0x0006 to 0x0009 (version 2, plain and delimited)"
            )),
        }
    }
}

/// A message of version 2 as one of version 1, little endian. The error says where it does not fit
/// its type.
pub(super) fn to_version_1(
    layout: &TypeLayout,
    encoding: Encoding,
    message: &[u8],
) -> Result<Vec<u8>, String> {
    let body = message.get(4..).unwrap_or_default();
    let big_endian = encoding.big_endian;
    let from = Cursor { body, at: 0, big_endian, most: 4, is_strict: false, text_bytes: 0 };
    let mut copy = Copy {
        layout,
        is_delimited: encoding.is_delimited,
        from,
        to: Vec::with_capacity(body.len() + body.len() / 4),
    };
    copy.message(0)?;
    let mut bytes = vec![0, 1, 0, 0];
    bytes.append(&mut copy.to);
    Ok(bytes)
}

/// Reads a body of version 2 and writes one of version 1. What is written is at most eight times as
/// long as what is read, since every value takes a byte at least.
struct Copy<'a> {
    layout: &'a TypeLayout,
    is_delimited: bool,
    from: Cursor<'a>,
    to: Vec<u8>,
}

impl Copy<'_> {
    fn message(&mut self, message: usize) -> Result<(), String> {
        let whole = self.from.body;
        let end = if self.is_delimited {
            let length = self.from.count()?;
            let end = self.from.at + length;
            self.from.body = &whole[..end];
            Some(end)
        } else {
            None
        };
        let layout = self.layout;
        let message = &layout.messages[message];
        if message.fields.is_empty() && self.from.at < self.from.body.len() {
            // ROS 2 gives a message without fields one byte
            self.number(1, 1)?;
        }
        for field in &message.fields {
            if end == Some(self.from.at) {
                return Err(format!(
                    "it ends before `{}` of {}: an older version of the type wrote it",
                    field.name, message.name
                ));
            }
            self.field(field.kind, field.many)?;
        }
        if let Some(end) = end {
            // What a newer version of the type has added is left out.
            self.from.at = end;
            self.from.body = whole;
        }
        Ok(())
    }

    fn field(&mut self, kind: Kind, many: Many) -> Result<(), String> {
        if many != Many::One && kind.size().is_none() {
            let length = self.from.length()?;
            let left = self.from.body.len() - self.from.at;
            if length > left {
                return Err(format!("it claims a list of {length} bytes in {left}"));
            }
        }
        let count = match many {
            Many::One => 1,
            Many::Fixed(count) => count,
            Many::Sequence => {
                let count = self.from.count()?;
                self.length(count);
                count
            }
        };
        match kind {
            Kind::Text => (0..count).try_for_each(|_| {
                let length = self.from.count()?;
                let text = self.from.take(1, length)?;
                self.length(length);
                self.to.extend(text);
                Ok(())
            }),
            Kind::WideText => {
                Err("it has a wstring, whose characters are of no certain length".into())
            }
            Kind::Message(message) => (0..count).try_for_each(|_| self.message(message)),
            number => self.number(number.size().unwrap_or(1), count),
        }
    }

    fn length(&mut self, length: usize) {
        self.align(4);
        // It was read as one of 32 bits.
        self.to.extend((length as u32).to_le_bytes());
    }

    fn align(&mut self, alignment: usize) {
        self.to.resize(self.to.len().next_multiple_of(alignment), 0);
    }

    fn number(&mut self, size: usize, count: usize) -> Result<(), String> {
        if count == 0 {
            return Ok(());
        }
        let bytes = self.from.take(size, size.saturating_mul(count))?;
        self.align(size);
        if self.from.big_endian {
            let turned = bytes.chunks(size).flat_map(|number| number.iter().rev());
            self.to.extend(turned);
        } else {
            self.to.extend(bytes);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::message::*;

    /// Writes version 2 in the way of [`Encoding`]; independent of the code above.
    #[derive(Default)]
    struct Writer {
        bytes: Vec<u8>,
        big_endian: bool,
        is_delimited: bool,
    }

    impl Writer {
        fn put(&mut self, little: &[u8]) {
            let alignment = little.len().min(4);
            while !self.bytes.len().is_multiple_of(alignment) {
                self.bytes.push(0xee);
            }
            if self.big_endian {
                self.bytes.extend(little.iter().rev());
            } else {
                self.bytes.extend(little);
            }
        }

        fn u32(&mut self, value: usize) {
            self.put(&u32::try_from(value).unwrap().to_le_bytes());
        }

        fn text(&mut self, text: &str) {
            self.u32(text.len() + 1);
            self.bytes.extend(text.as_bytes());
            self.bytes.push(0);
        }

        /// What `fill` writes, with its length before it.
        fn counted(&mut self, is_counted: bool, fill: impl FnOnce(&mut Self)) {
            if !is_counted {
                return fill(self);
            }
            self.u32(0);
            let begin = self.bytes.len();
            fill(self);
            let length = u32::try_from(self.bytes.len() - begin).unwrap();
            let length = if self.big_endian { length.to_be_bytes() } else { length.to_le_bytes() };
            self.bytes[begin - 4..begin].copy_from_slice(&length);
        }

        fn joint_state(mut self, state: &JointState) -> Vec<u8> {
            let is_delimited = self.is_delimited;
            self.counted(is_delimited, |writer| {
                writer.counted(is_delimited, |writer| {
                    writer.counted(is_delimited, |writer| {
                        writer.put(&state.header.stamp.sec.to_le_bytes());
                        writer.put(&state.header.stamp.nanosec.to_le_bytes());
                    });
                    writer.text(&state.header.frame_id);
                });
                writer.counted(true, |writer| {
                    writer.u32(state.name.len());
                    state.name.iter().for_each(|name| writer.text(name));
                });
                for values in [&state.position, &state.velocity, &state.effort] {
                    writer.u32(values.len());
                    values.iter().for_each(|value| writer.put(&value.to_le_bytes()));
                }
            });
            let low = 6 + 2 * u8::from(is_delimited) + u8::from(!self.big_endian);
            [vec![0, low, 0, 0], self.bytes].concat()
        }
    }

    fn state(frame: &str, names: &[&str]) -> JointState {
        JointState {
            header: Header::new(1_500_000_000, frame),
            name: names.iter().map(|name| (*name).to_owned()).collect(),
            position: (0..names.len()).map(|k| 0.25 + k as f64).collect(),
            velocity: Vec::new(),
            effort: vec![-7.5; names.len()],
        }
    }

    #[test]
    fn every_way_of_version_2_gives_the_same_message() {
        for frame in ["", "b", "base", "frame"] {
            for names in [&["stage"][..], &["x_axis", "y"], &["a", "bc", "def"]] {
                let state = state(frame, names);
                for (big_endian, is_delimited) in
                    [(false, false), (true, false), (false, true), (true, true)]
                {
                    let writer = Writer { big_endian, is_delimited, ..Writer::default() };
                    let bytes = writer.joint_state(&state);
                    assert_eq!(from_cdr::<JointState>(&bytes).unwrap(), state, "{bytes:02x?}");
                    let layout = TypeLayout::parse("sensor_msgs/JointState", "").unwrap();
                    assert_eq!(*layout.plain(&bytes).unwrap(), *to_cdr(&state).unwrap());
                    assert!(layout.text_if_it_fits(&bytes).is_some());
                }
            }
        }
    }

    #[test]
    fn what_a_newer_version_of_a_type_adds_is_left_out() {
        let mut bytes =
            Writer { is_delimited: true, ..Writer::default() }.joint_state(&state("b", &["stage"]));
        bytes.extend([1, 2, 3, 4]);
        let length = u32::from_le_bytes(bytes[4..8].try_into().unwrap()) + 4;
        bytes[4..8].copy_from_slice(&length.to_le_bytes());
        assert_eq!(from_cdr::<JointState>(&bytes).unwrap(), state("b", &["stage"]));
    }

    #[test]
    fn lists_of_parameters_and_unknown_encodings_are_refused() {
        let error = |low: u8| Encoding::of(&[0, low, 0, 0, 1]).unwrap_err();
        assert!(error(0x0b).contains("mutable") && error(0x03).contains("0x0003"));
        assert!(error(0x0c).contains("0x000c"));
        assert!(Encoding::of(&[0, 7]).unwrap_err().contains("2 bytes"));
        let wrong = [0, 9, 0, 0, 255, 255, 255, 255, 0, 0];
        assert!(from_cdr::<JointState>(&wrong).unwrap_err().to_string().contains("claims"));
    }

    proptest! {
        #[test]
        fn garbage_never_panics(
            body in proptest::collection::vec(any::<u8>(), 0..200),
            low in 6u8..10,
        ) {
            let bytes = [vec![0, low, 0, 0], body].concat();
            let _ = from_cdr::<JointTrajectory>(&bytes);
            let _ = from_cdr::<JointState>(&bytes);
            let _ = from_cdr::<DiagnosticArray>(&bytes);
        }
    }
}
