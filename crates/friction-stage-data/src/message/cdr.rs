//! Messages to and from CDR, the byte format of ROS 2 on the wire and in bags.
//!
//! Four bytes of encapsulation (representation and options), then plain CDR (XCDR1), aligned from
//! the byte after them. That is what is written; XCDR2 is read, too.

use std::borrow::Cow;
use std::cell::RefCell;
use std::collections::HashMap;
use std::rc::Rc;

use byteorder::{BigEndian, LittleEndian};
use serde::Serialize;
use thiserror::Error;

use super::RosMessage;
use super::type_layout::TypeLayout;

/// Encapsulation of plain CDR, little endian.
const LITTLE_ENDIAN: [u8; 4] = [0, 1, 0, 0];

/// Largest message that is decoded, bytes: a list of empty texts takes six times its bytes in
/// memory. Assumed: far above the longest trajectory.
const LARGEST: usize = 16 << 20;

/// Why bytes are not the message that they should be.
#[derive(Debug, Error)]
pub enum CdrError {
    /// A message that cannot be written as CDR.
    #[error("{kind} does not encode: {source}")]
    Encode {
        /// Rust type of the message.
        kind: &'static str,
        /// What was met.
        source: cdr_encoding::Error,
    },
    /// Too short for the encapsulation.
    #[error("{length} bytes, but a CDR message begins with 4 bytes of encapsulation")]
    NoEncapsulation {
        /// Bytes that are there.
        length: usize,
    },
    /// Larger than any message of these types.
    #[error("{length} bytes, a message of {kind} has at most {LARGEST}")]
    TooLarge {
        /// Bytes that are there, encapsulation included.
        length: usize,
        /// Rust type that was asked for.
        kind: &'static str,
    },
    /// An encapsulation that is not read, or a message of it that does not fit its type.
    #[error("{kind}: {reason}")]
    Representation {
        /// Rust type that was asked for.
        kind: &'static str,
        /// What it is and what would be right.
        reason: String,
    },
    /// The content does not fit the type.
    #[error("{length} bytes do not decode as {kind}: {source}")]
    Content {
        /// Bytes that are there, encapsulation included.
        length: usize,
        /// Rust type that was asked for.
        kind: &'static str,
        /// What was met.
        source: cdr_encoding::Error,
    },
}

/// Encodes a message as plain CDR, little endian, with encapsulation.
pub fn to_cdr<M: Serialize>(message: &M) -> Result<Vec<u8>, CdrError> {
    let mut bytes = Vec::with_capacity(256);
    to_cdr_into(message, &mut bytes)?;
    Ok(bytes)
}

/// Encodes a message into `bytes`, which is cleared first: no allocation once it is large enough.
pub fn to_cdr_into<M: Serialize>(message: &M, bytes: &mut Vec<u8>) -> Result<(), CdrError> {
    bytes.clear();
    bytes.extend_from_slice(&LITTLE_ENDIAN);
    cdr_encoding::to_writer::<M, LittleEndian, _>(&mut *bytes, message)
        .map_err(|source| CdrError::Encode { kind: std::any::type_name::<M>(), source })
}

/// Decodes a message from CDR of either version and endianness. Bytes after the message (padding)
/// are ignored.
pub fn from_cdr<M: RosMessage>(bytes: &[u8]) -> Result<M, CdrError> {
    if bytes.len() < 4 {
        return Err(CdrError::NoEncapsulation { length: bytes.len() });
    }
    if bytes.len() > LARGEST {
        let kind = std::any::type_name::<M>();
        return Err(CdrError::TooLarge { length: bytes.len(), kind });
    }
    let plain = match bytes {
        [0, 0 | 1, ..] => Ok(Cow::Borrowed(bytes)),
        other => layout_of::<M>().and_then(|layout| Ok(layout.plain(other)?.into_owned().into())),
    };
    let plain: Cow<'_, [u8]> = plain
        .map_err(|reason| CdrError::Representation { kind: std::any::type_name::<M>(), reason })?;
    let decode = |body: &[u8]| match plain[1] {
        0 => cdr_encoding::from_bytes::<M, BigEndian>(body),
        _ => cdr_encoding::from_bytes::<M, LittleEndian>(body),
    };
    let body = &plain[4..];
    let decoded = decode(body).or_else(|error| match with_added_numbers::<M>(body) {
        // All of it: a message that was cut elsewhere is none of before.
        Some(whole) => decode(&whole).ok().filter(|(_, read)| *read == whole.len()).ok_or(error),
        None => Err(error),
    });
    match decoded {
        Ok((message, _)) => Ok(message),
        Err(source) => {
            Err(CdrError::Content { length: bytes.len(), kind: std::any::type_name::<M>(), source })
        }
    }
}

/// A message of before, and the numbers that were added to its type since, as 0.
fn with_added_numbers<M: RosMessage>(body: &[u8]) -> Option<Vec<u8>> {
    (M::ADDED_NUMBERS > 0).then(|| {
        let mut whole = body.to_vec();
        whole.resize(body.len().next_multiple_of(8) + 8 * M::ADDED_NUMBERS, 0);
        whole
    })
}

/// The layout of `M`, which is worked out once for each thread.
fn layout_of<M: RosMessage>() -> Result<Rc<TypeLayout>, String> {
    thread_local! {
        static LAYOUTS: RefCell<HashMap<&'static str, Rc<TypeLayout>>> = RefCell::default();
    }
    LAYOUTS.with_borrow_mut(|layouts| {
        let kind = std::any::type_name::<M>();
        if let Some(layout) = layouts.get(kind) {
            return Ok(Rc::clone(layout));
        }
        let layout = Rc::new(TypeLayout::parse(&M::type_name(), &M::definition())?);
        layouts.insert(kind, Rc::clone(&layout));
        Ok(layout)
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::message::*;

    fn joint_state() -> JointState {
        JointState {
            header: Header::new(1_500_000_000, "stage"),
            name: vec!["stage".into()],
            position: vec![0.025],
            velocity: vec![-0.5],
            effort: vec![12.0],
        }
    }

    #[test]
    fn encapsulation_is_little_endian_plain_cdr() {
        let clock = Clock { clock: Time { sec: 1, nanosec: 2 } };
        assert_eq!(to_cdr(&clock).unwrap(), [0, 1, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0]);
    }

    #[test]
    fn big_endian_is_read() {
        let bytes = [0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 2];
        let clock: Clock = from_cdr(&bytes).unwrap();
        assert_eq!(clock.clock, Time { sec: 1, nanosec: 2 });
    }

    #[test]
    fn doubles_are_aligned_to_eight_after_the_encapsulation() {
        // stamp 8, length of frame_id 4, "stage\0" 6, pad 6, then data at 24
        let message = WrenchStamped::along_x(Header::new(0, "stage"), 1.0);
        let bytes = to_cdr(&message).unwrap();
        assert_eq!(bytes.len(), 4 + 24 + 48);
        assert_eq!(bytes[28..36], 1.0f64.to_le_bytes());
    }

    #[test]
    fn messages_survive_the_round_trip() {
        let state = joint_state();
        assert_eq!(from_cdr::<JointState>(&to_cdr(&state).unwrap()).unwrap(), state);
        let truth = StageState {
            header: Header::new(-5, "stage"),
            sample: 7,
            effect_name: vec!["cogging".into(), "cable_chain".into()],
            effect_force: vec![1.0, -2.0],
            bristle_deflection: vec![1e-9; 4],
            ..Default::default()
        };
        assert_eq!(from_cdr::<StageState>(&to_cdr(&truth).unwrap()).unwrap(), truth);
    }

    #[test]
    fn other_representations_are_named() {
        let error = from_cdr::<Clock>(&[0, 17, 0, 0, 1, 2, 3, 4]).unwrap_err();
        assert!(error.to_string().contains("0x0011"), "{error}");
        let error = from_cdr::<Clock>(&[0, 1]).unwrap_err();
        assert!(error.to_string().starts_with("2 bytes"), "{error}");
        let error = from_cdr::<Clock>(&[0, 1, 0, 0, 1]).unwrap_err();
        assert!(error.to_string().contains("Clock"), "{error}");
    }

    #[test]
    fn an_absurd_length_fails_without_taking_memory() {
        let mut bytes = to_cdr(&joint_state()).unwrap();
        bytes[24..28].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(from_cdr::<JointState>(&bytes).is_err());
    }

    proptest! {
        #[test]
        fn garbage_never_panics(
            body in proptest::collection::vec(any::<u8>(), 0..300),
            little in any::<bool>(),
        ) {
            let mut bytes = vec![0, u8::from(little), 0, 0];
            bytes.extend(body);
            let _ = from_cdr::<JointState>(&bytes);
            let _ = from_cdr::<JointTrajectory>(&bytes);
            let _ = from_cdr::<StageState>(&bytes);
            let _ = from_cdr::<DiagnosticArray>(&bytes);
            let _ = from_cdr::<Float64MultiArray>(&bytes[2..]);
        }

        #[test]
        fn flipped_bytes_never_panic(at in 0usize..100, value in any::<u8>()) {
            let mut bytes = to_cdr(&joint_state()).unwrap();
            let at = at % bytes.len();
            bytes[at] = value;
            let _ = from_cdr::<JointState>(&bytes);
        }
    }
}
