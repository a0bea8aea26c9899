//! Single fields of messages whose type is known only from the definition that the bag carries.
//!
//! What comes in is the text of a `ros2msg` schema, a path such as `points[only].positions[joint]`
//! and messages as CDR bytes; what goes out is a number per message. Fields before the wanted one
//! are skipped, those behind it not looked at; no memory is taken for what a message claims to
//! hold. Parts that the text lacks are those of [`known`]. Source of the layout: OMG DDS-XTypes
//! 1.3, 7.4.1 (plain CDR, version 1; [`xcdr2`](super::xcdr2) brings version 2 to it) and the
//! message definitions of ROS 2.
//!
//! Not read: schemas in `ros2idl`, and fields that stand behind a `wstring`, whose characters are
//! of two or four bytes depending on the middleware that wrote them.

use std::borrow::Cow;
use std::collections::HashMap;

use friction_stage_core::model::nearest;

use super::{known, xcdr2};

/// A message type with everything that it contains.
#[derive(Debug, Clone)]
pub(crate) struct TypeLayout {
    /// The type itself comes first.
    pub(super) messages: Vec<MessageType>,
}

#[derive(Debug, Clone)]
pub(super) struct MessageType {
    pub name: String,
    pub fields: Vec<Field>,
}

#[derive(Debug, Clone)]
pub(super) struct Field {
    pub name: String,
    pub kind: Kind,
    pub many: Many,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Bool,
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
    Text,
    WideText,
    Message(usize),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Many {
    One,
    Fixed(usize),
    Sequence,
}

impl Kind {
    fn of(name: &str) -> Option<Self> {
        Some(match name {
            "bool" => Self::Bool,
            "byte" | "char" | "uint8" => Self::U8,
            "int8" => Self::I8,
            "uint16" => Self::U16,
            "int16" => Self::I16,
            "uint32" => Self::U32,
            "int32" => Self::I32,
            "uint64" => Self::U64,
            "int64" => Self::I64,
            "float32" => Self::F32,
            "float64" => Self::F64,
            _ if name == "string" || name.starts_with("string<=") => Self::Text,
            _ if name == "wstring" || name.starts_with("wstring<=") => Self::WideText,
            _ => return None,
        })
    }

    /// Bytes of a number, which is also its alignment.
    pub fn size(self) -> Option<usize> {
        match self {
            Self::Bool | Self::U8 | Self::I8 => Some(1),
            Self::U16 | Self::I16 => Some(2),
            Self::U32 | Self::I32 | Self::F32 => Some(4),
            Self::U64 | Self::I64 | Self::F64 => Some(8),
            Self::Text | Self::WideText | Self::Message(_) => None,
        }
    }
}

/// Longest text of a definition, bytes. Assumed: those of ROS 2 have some kB with all their parts.
const LONGEST_TEXT: usize = 1 << 20;
/// Types inside each other. Assumed: the deepest messages of ROS 2 have fewer than ten.
const DEEPEST: usize = 64;
/// Largest message in version 2 of CDR, bytes: as version 1 it may take eight times as many.
const LARGEST_VERSION_2: usize = 16 << 20;

#[derive(Clone, Copy, PartialEq, Eq)]
enum Visit {
    Not,
    Inside,
    /// With so many types inside each other, itself included.
    Done(usize),
}

/// Where in a message a value stands.
#[derive(Debug, Clone)]
pub(crate) struct FieldPath {
    steps: Vec<Step>,
    /// Path to the names among which a `[joint]` is looked up.
    names: Option<usize>,
    /// The list of names that the array of the value goes along with, if the message has one.
    listed: Option<usize>,
}

impl FieldPath {
    /// The index of the element that the path ends on, if it is given by its number.
    pub fn element(&self) -> Option<usize> {
        match self.steps.last() {
            Some(Step::Element(index)) => Some(*index),
            _ => None,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    Field(usize),
    /// Element with this index.
    Element(usize),
    /// Element with the index of the joint among the names of the message.
    Joint,
    /// The element of an array of one; a message with another number of elements has no value.
    Only,
}

/// A value as it stands in the message.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Value {
    /// A number; integers beyond 2^53 are rounded.
    Number(f64),
    /// A whole number.
    Whole(i64),
    /// A time or duration, ns.
    Nanoseconds(i64),
}

impl Value {
    pub fn as_f64(self) -> f64 {
        match self {
            Self::Number(value) => value,
            Self::Whole(value) => value as f64,
            Self::Nanoseconds(value) => value as f64 * 1e-9,
        }
    }
}

/// How two types compare.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Sameness {
    /// Same names, kinds and order.
    Same,
    /// Same kinds and order: their messages look alike.
    OtherNames,
    /// Something else.
    Different,
}

impl TypeLayout {
    /// How another type differs from this one.
    pub fn compared(&self, other: &Self) -> Sameness {
        self.compared_inside(0, other, 0)
    }

    /// As deep as this type goes.
    fn compared_inside(&self, message: usize, other: &Self, as_message: usize) -> Sameness {
        let (own, others) = (&self.messages[message].fields, &other.messages[as_message].fields);
        if own.len() != others.len() {
            return Sameness::Different;
        }
        let compare = |(own, others): (&Field, &Field)| {
            let names = if own.name == others.name { Sameness::Same } else { Sameness::OtherNames };
            match (own.kind, others.kind) {
                _ if own.many != others.many => Sameness::Different,
                (Kind::Message(own), Kind::Message(others)) => {
                    names.max(self.compared_inside(own, other, others))
                }
                (own, others) if own == others => names,
                _ => Sameness::Different,
            }
        };
        own.iter().zip(others).map(compare).max().unwrap_or(Sameness::Same)
    }

    /// Reads the text that a bag stores with encoding `ros2msg`; an empty one stands for a known
    /// type. The error says what is wrong with it.
    pub fn parse(type_name: &str, text: &str) -> Result<Self, String> {
        if text.len() > LONGEST_TEXT {
            return Err(format!(
                "its definition has {} bytes, read are at most {LONGEST_TEXT}",
                text.len()
            ));
        }
        let mut sections = vec![(short_name(type_name), Vec::new())];
        let mut between = false;
        for line in field_lines(text) {
            if line.len() >= 3 && line.bytes().all(|b| b == b'=') {
                between = true;
            } else if let Some(name) = line.strip_prefix("MSG: ").filter(|_| between) {
                sections.push((short_name(name.trim()), Vec::new()));
                between = false;
            } else if let Some((_, lines)) = sections.last_mut() {
                lines.push(line);
            }
        }
        if sections[0].1.is_empty()
            && let Some(text) = known::fields(&sections[0].0)
        {
            sections[0].1 = field_lines(text).collect();
        }
        let mut index: HashMap<String, usize> =
            sections.iter().enumerate().rev().map(|(i, (name, _))| (name.clone(), i)).collect();
        let mut messages = Vec::new();
        while messages.len() < sections.len() {
            let (name, lines) = sections[messages.len()].clone();
            let package = name.split('/').next().unwrap_or("");
            let mut fields = Vec::new();
            for line in lines {
                let Some(FieldText { kind, many, field }) = FieldText::of(line, &name)? else {
                    continue;
                };
                let kind = match Kind::of(kind) {
                    Some(kind) => kind,
                    None => {
                        // `Header` alone is an old way to write std_msgs/Header
                        let names = if kind.contains('/') {
                            vec![short_name(kind)]
                        } else {
                            vec![format!("{package}/{kind}"), format!("std_msgs/{kind}")]
                        };
                        let part = names.iter().find_map(|name| index.get(name).copied());
                        let known = || {
                            let mut known = names.iter().map(|name| (name, known::fields(name)));
                            let (name, text) = known.find(|(_, text)| text.is_some())?;
                            sections.push((name.clone(), field_lines(text?).collect()));
                            index.insert(name.clone(), sections.len() - 1);
                            Some(sections.len() - 1)
                        };
                        match part.or_else(known) {
                            Some(message) => Kind::Message(message),
                            None => {
                                return Err(format!(
                                    "{name}: type `{kind}` of `{field}` is neither defined in the \
                                     bag nor known here"
                                ));
                            }
                        }
                    }
                };
                fields.push(Field { name: field.to_owned(), kind, many });
            }
            messages.push(MessageType { name, fields });
        }
        let layout = Self { messages };
        layout.height(0, 1, &mut vec![Visit::Not; layout.messages.len()])?;
        Ok(layout)
    }

    /// How many types a type has inside each other, itself included; it is that deep itself. ROS 2
    /// has no recursive types, a broken file may claim one.
    fn height(&self, message: usize, depth: usize, visits: &mut [Visit]) -> Result<usize, String> {
        let too_deep = || format!("it has more than {DEEPEST} types inside each other");
        match visits[message] {
            Visit::Done(height) if depth + height > DEEPEST + 1 => return Err(too_deep()),
            Visit::Done(height) => return Ok(height),
            Visit::Inside => {
                return Err(format!("{} contains itself", self.messages[message].name));
            }
            Visit::Not if depth > DEEPEST => return Err(too_deep()),
            Visit::Not => visits[message] = Visit::Inside,
        }
        let mut height = 1;
        for field in &self.messages[message].fields {
            if let Kind::Message(inner) = field.kind {
                height = height.max(1 + self.height(inner, depth + 1, visits)?);
            }
        }
        visits[message] = Visit::Done(height);
        Ok(height)
    }

    /// The message in plain CDR of version 1, which the other methods take. The error says why it
    /// cannot be read.
    pub fn plain<'a>(&self, message: &'a [u8]) -> Result<Cow<'a, [u8]>, String> {
        match xcdr2::Encoding::of(message)? {
            None => Ok(Cow::Borrowed(message)),
            Some(_) if message.len() > LARGEST_VERSION_2 => Err(format!(
                "it has {} bytes, in version 2 of CDR at most {LARGEST_VERSION_2} are read",
                message.len()
            )),
            Some(encoding) => xcdr2::to_version_1(self, encoding, message).map(Cow::Owned),
        }
    }

    /// How many bytes of text a message (CDR with encapsulation) has if it is of this type, as far
    /// as its bytes show: it ends where the type does, and its texts are texts. None if it is not.
    pub fn text_if_it_fits(&self, message: &[u8]) -> Option<usize> {
        let message = self.plain(message).ok()?;
        let mut cursor = Cursor::new(&message).ok()?;
        cursor.is_strict = true;
        for field in &self.messages[0].fields {
            self.skip(&mut cursor, field).ok()?;
        }
        // Writers fill up to four bytes.
        (cursor.body.len() - cursor.at < 4).then_some(cursor.text_bytes)
    }

    /// Finds a path such as `wrench.force.x`, `data[2]`, `position[joint]` or
    /// `points[only].positions[joint]`. The error says what is there instead.
    pub fn path(&self, text: &str) -> Result<FieldPath, String> {
        let mut steps = Vec::new();
        let mut kind = Kind::Message(0);
        let mut many = Many::One;
        for part in text.split('.') {
            let (name, brackets) = match part.find('[') {
                Some(at) => part.split_at(at),
                None => (part, ""),
            };
            let Kind::Message(message) = kind else {
                return Err(format!("`{name}` cannot stand behind a number"));
            };
            if many != Many::One {
                return Err(format!(
                    "`{name}` stands behind an array: say which element, as in `[0]`"
                ));
            }
            let message = &self.messages[message];
            let Some(index) = message.fields.iter().position(|f| f.name == name) else {
                let fields = || message.fields.iter().map(|f| f.name.as_str());
                return Err(format!(
                    "{} has no field `{name}`, its fields are {}{}",
                    message.name,
                    fields().collect::<Vec<_>>().join(", "),
                    nearest(name, fields())
                ));
            };
            steps.push(Step::Field(index));
            kind = message.fields[index].kind;
            many = message.fields[index].many;
            let mut rest = brackets;
            while !rest.is_empty() {
                let Some((element, behind)) =
                    rest.strip_prefix('[').and_then(|r| r.split_once(']'))
                else {
                    return Err(format!("`{part}`: an element is written as in `{name}[0]`"));
                };
                if many == Many::One {
                    return Err(format!("`{name}` is no array, it has no `[{element}]`"));
                }
                steps.push(match element {
                    "joint" => Step::Joint,
                    "only" => Step::Only,
                    number => Step::Element(number.parse().map_err(|_| {
                        format!(
                            "`[{number}]` is no element: give its number from 0, `joint` or `only`"
                        )
                    })?),
                });
                many = Many::One;
                rest = behind;
            }
        }
        if many != Many::One {
            return Err(format!(
                "`{text}` is an array: say which element, as in `{text}[0]` or `{text}[joint]`"
            ));
        }
        match kind {
            Kind::Text | Kind::WideText => return Err(format!("`{text}` is text, not a number")),
            Kind::Message(message) if !self.is_time(message) => {
                return Err(format!(
                    "`{text}` is a {}, not a number: its fields are {}",
                    self.messages[message].name,
                    self.messages[message]
                        .fields
                        .iter()
                        .map(|f| f.name.as_str())
                        .collect::<Vec<_>>()
                        .join(", ")
                ));
            }
            _ => {}
        }
        let list = self.messages[0].fields.iter().position(|f| {
            f.kind == Kind::Text
                && f.many != Many::One
                && ["name", "names", "joint_names"].contains(&f.name.as_str())
        });
        let names = if steps.contains(&Step::Joint) {
            let names = list;
            if names.is_none() {
                return Err(format!(
                    "{} has no list `name`, `names` or `joint_names` that `[joint]` could be found \
                     in: give the number",
                    self.messages[0].name
                ));
            }
            names
        } else {
            None
        };
        let is_element = matches!(steps[..], [_, Step::Element(_) | Step::Joint]);
        Ok(FieldPath { steps, names, listed: list.filter(|_| is_element) })
    }

    fn is_time(&self, message: usize) -> bool {
        let fields: Vec<(&str, Kind, Many)> = self.messages[message]
            .fields
            .iter()
            .map(|f| (f.name.as_str(), f.kind, f.many))
            .collect();
        fields == [("sec", Kind::I32, Many::One), ("nanosec", Kind::U32, Many::One)]
    }

    /// The value at `path` in a message (CDR with encapsulation); none if the message lacks it: an
    /// empty or shorter array, or a joint that is not in it. The error says where the message ends
    /// too early.
    pub fn value(
        &self,
        path: &FieldPath,
        joint: &str,
        message: &[u8],
    ) -> Result<Option<Value>, String> {
        self.value_in_array(path, joint, message).map(|(value, _)| value)
    }

    /// As [`value`](Self::value), with the number of elements of the last array on the way to it.
    pub fn value_in_array(
        &self,
        path: &FieldPath,
        joint: &str,
        message: &[u8],
    ) -> Result<(Option<Value>, Option<usize>), String> {
        let joint_index = match path.names {
            None => None,
            Some(names) => match self.index_of(names, joint, message)? {
                None => return Ok((None, None)),
                index => index,
            },
        };
        let mut elements = None;
        let mut cursor = Cursor::new(message)?;
        let (mut inside, mut at) = (0, 0);
        loop {
            let Some(Step::Field(wanted)) = path.steps.get(at).copied() else {
                // a path ends on a message only if that is a time
                let seconds = cursor.number(Kind::I32)?.as_f64() as i64;
                let nanoseconds = cursor.number(Kind::U32)?.as_f64() as i64;
                let stamp = Value::Nanoseconds(seconds * 1_000_000_000 + nanoseconds);
                return Ok((Some(stamp), elements));
            };
            at += 1;
            for field in &self.messages[inside].fields[..wanted] {
                self.skip(&mut cursor, field)?;
            }
            let field = &self.messages[inside].fields[wanted];
            if field.many != Many::One {
                let count = match field.many {
                    Many::Fixed(count) => count,
                    _ => cursor.count()?,
                };
                elements = Some(count);
                let index = match path.steps.get(at).copied() {
                    Some(Step::Element(index)) => Some(index),
                    Some(Step::Joint) => joint_index,
                    Some(Step::Only) => (count == 1).then_some(0),
                    _ => None,
                };
                at += 1;
                let Some(index) = index.filter(|&index| index < count) else {
                    return Ok((None, elements));
                };
                self.skip_elements(&mut cursor, field.kind, index)?;
            }
            match field.kind {
                Kind::Message(message) => inside = message,
                kind => return Ok((Some(cursor.number(kind)?), elements)),
            }
        }
    }

    /// Index of the joint in the list of names that is field `names`.
    fn index_of(&self, names: usize, joint: &str, message: &[u8]) -> Result<Option<usize>, String> {
        let (mut cursor, count) = self.names(names, message)?;
        for index in 0..count {
            if cursor.text()? == joint.as_bytes() {
                return Ok(Some(index));
            }
        }
        Ok(None)
    }

    /// The names in which `[joint]` of `path` is looked up; none for a path without `[joint]`.
    pub fn joints(&self, path: &FieldPath, message: &[u8]) -> Result<Vec<String>, String> {
        path.names.map_or(Ok(Vec::new()), |names| self.texts(names, message))
    }

    /// The names that the elements of the path's array have; none where the message has no list.
    pub fn listed(&self, path: &FieldPath, message: &[u8]) -> Result<Vec<String>, String> {
        path.listed.map_or(Ok(Vec::new()), |names| self.texts(names, message))
    }

    fn texts(&self, names: usize, message: &[u8]) -> Result<Vec<String>, String> {
        let (mut cursor, count) = self.names(names, message)?;
        (0..count).map(|_| Ok(String::from_utf8_lossy(cursor.text()?).into_owned())).collect()
    }

    /// Where the list of names that is field `names` begins, and how many they are.
    fn names<'a>(&self, names: usize, message: &'a [u8]) -> Result<(Cursor<'a>, usize), String> {
        let mut cursor = Cursor::new(message)?;
        for field in &self.messages[0].fields[..names] {
            self.skip(&mut cursor, field)?;
        }
        let count = match self.messages[0].fields[names].many {
            Many::Fixed(count) => count,
            _ => cursor.count()?,
        };
        Ok((cursor, count))
    }

    fn skip(&self, cursor: &mut Cursor<'_>, field: &Field) -> Result<(), String> {
        let count = match field.many {
            Many::One => 1,
            Many::Fixed(count) => count,
            Many::Sequence => cursor.count()?,
        };
        self.skip_elements(cursor, field.kind, count)
    }

    fn skip_elements(
        &self,
        cursor: &mut Cursor<'_>,
        kind: Kind,
        count: usize,
    ) -> Result<(), String> {
        if count == 0 {
            return Ok(());
        }
        match kind {
            Kind::Text => (0..count).try_for_each(|_| cursor.text().map(drop)),
            Kind::WideText => {
                Err("it stands behind a wstring, whose length in bytes is not known".into())
            }
            Kind::Message(message) => (0..count).try_for_each(|_| {
                let fields = &self.messages[message].fields;
                if fields.is_empty() {
                    // ROS 2 gives a message without fields one byte
                    cursor.take(1, 1).map(drop)
                } else {
                    fields.iter().try_for_each(|field| self.skip(cursor, field))
                }
            }),
            number => {
                let size = number.size().unwrap_or(1);
                cursor.take(size, size.saturating_mul(count)).map(drop)
            }
        }
    }
}

/// The lines of a definition without comments and without empty ones.
fn field_lines(text: &str) -> impl Iterator<Item = &str> {
    text.lines().map(|line| line.split('#').next().unwrap_or("").trim()).filter(|l| !l.is_empty())
}

/// A line of a definition: the type of the elements, how many, and the name.
struct FieldText<'a> {
    kind: &'a str,
    many: Many,
    field: &'a str,
}

impl<'a> FieldText<'a> {
    /// The field that a line of the type `name` defines; none for a constant.
    fn of(line: &'a str, name: &str) -> Result<Option<Self>, String> {
        let mut words = line.split_whitespace();
        let (Some(kind), Some(field)) = (words.next(), words.next()) else {
            return Err(format!("{name}: `{line}` is no field: it needs a type and a name"));
        };
        // a constant takes no place in the message; a default value neither
        if field.contains('=') || words.next().is_some_and(|word| word.starts_with('=')) {
            return Ok(None);
        }
        let (kind, many) = match kind.split_once('[') {
            None => (kind, Many::One),
            Some((kind, "]")) => (kind, Many::Sequence),
            Some((kind, bound)) if bound.starts_with("<=") && bound.ends_with(']') => {
                (kind, Many::Sequence)
            }
            // As in ROS 2, no array is empty: every value takes a byte at least.
            Some((base, length)) => match length.strip_suffix(']').and_then(|n| n.parse().ok()) {
                Some(length @ 1..) => (base, Many::Fixed(length)),
                _ => return Err(format!("{name}: `{kind}` is no array type")),
            },
        };
        Ok(Some(Self { kind, many, field }))
    }
}

/// `package/msg/Name` and `package/Name` as `package/Name`.
fn short_name(name: &str) -> String {
    match name.split_once("/msg/") {
        Some((package, name)) => format!("{package}/{name}"),
        None => name.to_owned(),
    }
}

/// Reads forward in the body of a CDR message.
pub(super) struct Cursor<'a> {
    pub body: &'a [u8],
    pub at: usize,
    pub big_endian: bool,
    /// Largest alignment, bytes: 8, in version 2 of CDR 4.
    pub most: usize,
    /// Whether a text must end with a zero and be UTF-8 without control characters.
    pub is_strict: bool,
    /// Bytes of text so far.
    pub text_bytes: usize,
}

impl<'a> Cursor<'a> {
    /// A message in plain CDR of version 1.
    fn new(message: &'a [u8]) -> Result<Self, String> {
        match (xcdr2::Encoding::of(message)?, message) {
            (None, [_, representation, _, _, body @ ..]) => Ok(Self {
                body,
                at: 0,
                big_endian: *representation == 0,
                most: 8,
                is_strict: false,
                text_bytes: 0,
            }),
            _ => Err("it is in version 2 of CDR".into()),
        }
    }

    pub fn take(&mut self, alignment: usize, length: usize) -> Result<&'a [u8], String> {
        let from = self.at.next_multiple_of(alignment.min(self.most));
        let bytes = from.checked_add(length).and_then(|to| self.body.get(from..to));
        let bytes = bytes.ok_or_else(|| {
            format!(
                "it ends after {} bytes, {length} more were expected at byte {from}",
                self.body.len()
            )
        })?;
        self.at = from + length;
        Ok(bytes)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let mut bytes = [0; N];
        bytes.copy_from_slice(self.take(N, N)?);
        if self.big_endian {
            bytes.reverse();
        }
        Ok(bytes)
    }

    pub fn length(&mut self) -> Result<usize, String> {
        Ok(u32::from_le_bytes(self.array()?) as usize)
    }

    /// Length of a sequence; not more than there are bytes left, since every element takes one at
    /// least.
    pub fn count(&mut self) -> Result<usize, String> {
        let count = self.length()?;
        let left = self.body.len() - self.at;
        if count > left {
            return Err(format!("it claims {count} elements in {left} bytes"));
        }
        Ok(count)
    }

    /// Bytes of a string, without its terminating zero.
    pub fn text(&mut self) -> Result<&'a [u8], String> {
        let length = self.count()?;
        let bytes = self.take(1, length)?;
        let text = bytes.strip_suffix(&[0]);
        let is_text = |text: &[u8]| {
            std::str::from_utf8(text)
                .is_ok_and(|text| text.chars().all(|c| !c.is_control() || c.is_whitespace()))
        };
        if self.is_strict && !text.is_some_and(is_text) {
            return Err("it has a text that is none".into());
        }
        self.text_bytes += text.map_or(0, <[u8]>::len);
        Ok(text.unwrap_or(bytes))
    }

    fn number(&mut self, kind: Kind) -> Result<Value, String> {
        Ok(match kind {
            Kind::Bool | Kind::U8 => Value::Whole(i64::from(u8::from_le_bytes(self.array()?))),
            Kind::I8 => Value::Whole(i64::from(i8::from_le_bytes(self.array()?))),
            Kind::U16 => Value::Whole(i64::from(u16::from_le_bytes(self.array()?))),
            Kind::I16 => Value::Whole(i64::from(i16::from_le_bytes(self.array()?))),
            Kind::U32 => Value::Whole(i64::from(u32::from_le_bytes(self.array()?))),
            Kind::I32 => Value::Whole(i64::from(i32::from_le_bytes(self.array()?))),
            Kind::I64 => Value::Whole(i64::from_le_bytes(self.array()?)),
            Kind::U64 => {
                let value = u64::from_le_bytes(self.array()?);
                i64::try_from(value).map_or(Value::Number(value as f64), Value::Whole)
            }
            Kind::F32 => Value::Number(f64::from(f32::from_le_bytes(self.array()?))),
            Kind::F64 => Value::Number(f64::from_le_bytes(self.array()?)),
            Kind::Text | Kind::WideText | Kind::Message(_) => return Err("it is no number".into()),
        })
    }
}

#[cfg(test)]
impl TypeLayout {
    /// Names and kinds of all fields in their order in a message.
    pub(crate) fn flat(&self) -> Vec<String> {
        fn walk(layout: &TypeLayout, message: usize, found: &mut Vec<String>) {
            for field in &layout.messages[message].fields {
                match field.kind {
                    Kind::Message(inner) => {
                        found.push(format!("{} {:?}", field.name, field.many));
                        walk(layout, inner, found);
                    }
                    kind => found.push(format!("{} {kind:?} {:?}", field.name, field.many)),
                }
            }
        }
        let mut found = Vec::new();
        walk(self, 0, &mut found);
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{
        Float64MultiArray, Header, JointState, JointTrajectory, JointTrajectoryPoint, RosMessage,
        WrenchStamped, to_cdr,
    };
    use proptest::prelude::*;

    fn definition<M: RosMessage>() -> TypeLayout {
        TypeLayout::parse(&M::type_name(), &M::definition()).unwrap()
    }

    fn read<M: RosMessage>(message: &M, path: &str) -> Option<Value> {
        let definition = definition::<M>();
        let path = definition.path(path).unwrap();
        definition.value(&path, "stage", &to_cdr(message).unwrap()).unwrap()
    }

    fn joints() -> JointState {
        JointState {
            header: Header::new(-1_700_000_000, "base"),
            name: vec!["axis_1".into(), "stage".into(), "gripper".into()],
            position: vec![1.0, 2.5, 3.0],
            velocity: vec![],
            effort: vec![7.0, 8.0, 9.0],
        }
    }

    #[test]
    fn fields_are_found_by_name_number_and_joint() {
        assert_eq!(read(&joints(), "position[joint]"), Some(Value::Number(2.5)));
        assert_eq!(read(&joints(), "effort[joint]"), Some(Value::Number(8.0)));
        assert_eq!(read(&joints(), "effort[0]"), Some(Value::Number(7.0)));
        assert_eq!(read(&joints(), "velocity[joint]"), None);
        assert_eq!(read(&joints(), "position[3]"), None);
        assert_eq!(read(&joints(), "header.stamp"), Some(Value::Nanoseconds(-1_700_000_000)));
        assert_eq!(read(&joints(), "header.stamp.sec"), Some(Value::Whole(-2)));
        let one = JointState { name: vec!["x".into()], position: vec![4.0], ..joints() };
        assert_eq!(read(&one, "position[joint]"), None);
        let another = JointState { name: vec!["x".into(), "y".into()], ..joints() };
        assert_eq!(read(&another, "position[joint]"), None);
        let wrench = WrenchStamped::along_x(Header::new(5, "stage"), -3.5);
        assert_eq!(read(&wrench, "wrench.force.x"), Some(Value::Number(-3.5)));
    }

    #[test]
    fn only_takes_a_list_of_one() {
        let point = JointTrajectoryPoint {
            positions: vec![0.5],
            accelerations: vec![-2.0],
            ..Default::default()
        };
        let mut trajectory = JointTrajectory {
            joint_names: vec!["stage".into()],
            points: vec![point.clone()],
            ..Default::default()
        };
        assert_eq!(read(&trajectory, "points[only].positions[joint]"), Some(Value::Number(0.5)));
        assert_eq!(read(&trajectory, "points[only].accelerations[0]"), Some(Value::Number(-2.0)));
        assert_eq!(read(&trajectory, "points[only].velocities[0]"), None);
        trajectory.points.push(point);
        assert_eq!(read(&trajectory, "points[only].positions[joint]"), None);
        assert_eq!(read(&trajectory, "points[1].positions[joint]"), Some(Value::Number(0.5)));
    }

    #[test]
    fn wrong_paths_are_told_with_what_is_there() {
        let error = |path: &str| definition::<JointState>().path(path).unwrap_err();
        assert!(error("positon[0]").contains("did you mean `position`"));
        assert!(error("position").contains("position[joint]"));
        assert!(
            error("header").contains("std_msgs/Header")
                && error("header").contains("stamp, frame_id")
        );
        assert!(error("header.frame_id").contains("text"));
        assert!(error("header[0].stamp").contains("no array"));
        assert!(error("position[x]").contains("`[x]`"));
        assert!(error("position[0].x").contains("behind a number"));
        let array = definition::<Float64MultiArray>();
        assert!(array.path("data[joint]").unwrap_err().contains("joint_names"));
        assert!(array.path("data[0]").is_ok());
    }

    #[test]
    fn definitions_of_others_are_read() {
        let text = "# Comment\nint32 KIND_A=1\nstring lower_case = \"a # b\"\nuint8 flags \
                    3\nbool[3] switches\n\
                    string<=10[<=2] words\nInner[] inner\nfloat32 value 1.5 # default\nempty/Empty \
                    nothing\nuint16 after\n\
                    ===\nMSG: other/Inner\nuint8 a\nint64 b\n===\nMSG: empty/Empty\n";
        let definition = TypeLayout::parse("other/msg/Outer", text).unwrap();
        let mut bytes = vec![0, 1, 0, 0, 9, 1, 0, 1];
        bytes.extend([1, 0, 0, 0, 3, 0, 0, 0, b'h', b'i', 0, 0xff]); // words, to 16
        bytes.extend([2, 0, 0, 0, 7, 0xff, 0xff, 0xff]); // count 2, then a at 20, pad to 24
        bytes.extend((-5i64).to_le_bytes()); // to 32
        bytes.extend([8, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff]); // a at 32, pad to 40
        bytes.extend(6i64.to_le_bytes()); // to 48
        bytes.extend(2.5f32.to_le_bytes()); // to 52
        bytes.extend([0, 0xff]); // empty message, pad to 54
        bytes.extend(513u16.to_le_bytes());
        let value =
            |path: &str| definition.value(&definition.path(path).unwrap(), "", &bytes).unwrap();
        assert_eq!(value("flags"), Some(Value::Whole(9)));
        assert_eq!(value("switches[2]"), Some(Value::Whole(1)));
        assert_eq!(value("inner[1].b"), Some(Value::Whole(6)));
        assert_eq!(value("inner[2].b"), None);
        assert_eq!(value("value"), Some(Value::Number(2.5)));
        assert_eq!(value("after"), Some(Value::Whole(513)));
    }

    #[test]
    fn unreadable_definitions_are_told() {
        let error = |text: &str| TypeLayout::parse("a/msg/B", text).unwrap_err();
        assert!(error("Unknown x").contains("`Unknown`"));
        assert!(error("float64").contains("type and a name"));
        assert!(error("float64[x] y").contains("array type"));
        assert!(error("B b").contains("contains itself"));
    }

    proptest! {
        #[test]
        fn garbage_never_panics(
            body in proptest::collection::vec(any::<u8>(), 0..200),
            text in "[a-z0-9 =<\\[\\]\\n/#]{0,80}",
        ) {
            let definition = definition::<JointTrajectory>();
            let path = definition.path("points[only].positions[joint]").unwrap();
            let mut bytes = vec![0, 1, 0, 0];
            bytes.extend(body);
            let _ = definition.value(&path, "stage", &bytes);
            let _ = TypeLayout::parse("a/msg/B", &text);
        }
    }
}
