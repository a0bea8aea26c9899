//! Parameter files, and the values in them: `/**:`, `node:` and `/ns/node:` sections with
//! `ros__parameters:` below.
//!
//! YAML text comes in, values with the node pattern that they are for and the line where they stand
//! go out. Nested keys below `ros__parameters` become one name with dots. Types are those of the
//! YAML text: `1` is an integer and `1.0` a double, and nothing is converted.

use std::fmt;
use std::path::Path;

use ros2_client::ParameterValue;
use serde::de::{Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};
use serde_saphyr::{NonFiniteFloatPolicy, Spanned};

use super::assignment::{ArgumentError, Assignment, NodePattern};
use friction_stage_core::yaml;

const PARAMETERS: &str = "ros__parameters";

/// All assignments of a parameter file, in the order of the text.
pub(super) fn parse(path: &Path, text: &str) -> Result<Vec<Assignment>, ArgumentError> {
    let node: Spanned<Node> =
        serde_saphyr::from_str_with_options(text, options()).map_err(|error| {
            let line = error.location().map_or(1, |place| place.line());
            at(path, line, yaml::problem_alone(&error, text))
        })?;
    let mut found = Vec::new();
    match node.value {
        Node::Map(entries) => sections(path, "", entries, &mut found)?,
        _ => {
            return Err(at(
                path,
                node.referenced.line(),
                "expected a mapping of node names, as in `/**:`".to_owned(),
            ));
        }
    }
    Ok(found)
}

/// The value of a `-p name:=value`. On error says what is wrong with it.
pub(super) fn value(text: &str) -> Result<ParameterValue, String> {
    let node: Node = serde_saphyr::from_str_with_options(text, options())
        .map_err(|error| format!("is not YAML: {}", yaml::problem_alone(&error, "")))?;
    parameter_value(node).map_err(|problem| problem.to_string())
}

fn sections(
    path: &Path,
    prefix: &str,
    entries: Entries,
    found: &mut Vec<Assignment>,
) -> Result<(), ArgumentError> {
    for (key, entry) in entries {
        let line = key.referenced.line();
        if key.value == PARAMETERS {
            if prefix.is_empty() {
                let problem = format!(
                    "`{PARAMETERS}` stands below no node; put `/**:` above it to mean every node"
                );
                return Err(at(path, line, problem));
            }
            let node = NodePattern::new(prefix).map_err(|problem| {
                at(path, line, format!("the name of the node, `{prefix}`, {problem}"))
            })?;
            match entry.value {
                Node::Map(entries) => parameters(path, &node, "", entries, found)?,
                Node::Null => {}
                _ => {
                    return Err(at(
                        path,
                        line,
                        format!("expected a mapping of parameters below `{PARAMETERS}`"),
                    ));
                }
            }
            continue;
        }
        let name = format!("{prefix}/{}", key.value.trim_start_matches('/'));
        match entry.value {
            Node::Map(entries) => sections(path, &name, entries, found)?,
            Node::Null => {
                return Err(at(
                    path,
                    line,
                    format!("`{}` has nothing below it, expected `{PARAMETERS}:`", key.value),
                ));
            }
            _ => {
                let problem =
                    format!("`{}` has a value, but stands outside of `{PARAMETERS}:`", key.value);
                return Err(at(path, line, problem));
            }
        }
    }
    Ok(())
}

fn parameters(
    path: &Path,
    node: &NodePattern,
    prefix: &str,
    entries: Entries,
    found: &mut Vec<Assignment>,
) -> Result<(), ArgumentError> {
    for (key, entry) in entries {
        let line = key.referenced.line();
        let name = if prefix.is_empty() { key.value } else { format!("{prefix}.{}", key.value) };
        if let Node::Map(entries) = entry.value {
            parameters(path, node, &name, entries, found)?;
            continue;
        }
        let value = parameter_value(entry.value).map_err(|problem| {
            at(path, line, format!("the value of parameter `{name}` {problem}"))
        })?;
        found.push(Assignment {
            node: node.clone(),
            name,
            value,
            origin: format!("{}, line {line}", path.display()),
        });
    }
    Ok(())
}

/// Why a YAML node is no parameter value; reads on from `the value ...`.
#[derive(Debug, thiserror::Error)]
enum ValueProblem {
    #[error("is missing; an empty string is written ''")]
    Missing,
    #[error(
        "is the mapping of {0} keys; expected a bool, an integer, a double, a string or a list of \
         one of them"
    )]
    Mapping(usize),
    #[error("is an empty list, which has no type")]
    EmptyList,
    #[error("is a list whose first item is a {0}; expected bools, integers, doubles or strings")]
    ListOf(&'static str),
    #[error("mixes {first} and {other} (item {item}) in a list; expected {first} throughout")]
    Mixed { first: &'static str, other: &'static str, item: usize },
    #[error("is {0}, beyond the 64-bit integers; largest is 9223372036854775807")]
    TooLarge(u64),
}

fn parameter_value(node: Node) -> Result<ParameterValue, ValueProblem> {
    Ok(match node {
        Node::Bool(value) => ParameterValue::Boolean(value),
        Node::Integer(value) => ParameterValue::Integer(value),
        Node::Double(value) => ParameterValue::Double(value),
        Node::Text(value) => ParameterValue::String(value),
        Node::Null => return Err(ValueProblem::Missing),
        Node::TooLarge(value) => return Err(ValueProblem::TooLarge(value)),
        Node::Map(entries) => return Err(ValueProblem::Mapping(entries.len())),
        Node::List(items) => {
            let first = items.first().ok_or(ValueProblem::EmptyList)?.kind();
            if let Some((item, other)) =
                items.iter().enumerate().find(|(_, item)| item.kind() != first)
            {
                return Err(ValueProblem::Mixed { first, other: other.kind(), item: item + 1 });
            }
            let mut list = Vec::new();
            for item in items {
                list.push(parameter_value(item)?);
            }
            // All of one kind: each collect takes every item.
            macro_rules! all {
                ($kind:ident) => {
                    list.into_iter()
                        .filter_map(
                            |v| if let ParameterValue::$kind(v) = v { Some(v) } else { None },
                        )
                        .collect()
                };
            }
            match first {
                "bool" => ParameterValue::BooleanArray(all!(Boolean)),
                "integer" => ParameterValue::IntegerArray(all!(Integer)),
                "double" => ParameterValue::DoubleArray(all!(Double)),
                "string" => ParameterValue::StringArray(all!(String)),
                other => return Err(ValueProblem::ListOf(other)),
            }
        }
    })
}

fn at(path: &Path, line: u64, problem: String) -> ArgumentError {
    ArgumentError::ParamsFile { path: path.to_owned(), line, problem }
}

fn options() -> serde_saphyr::Options {
    // As rcl's parser (libyaml, strtol with base 0): `.inf` and `.nan` are doubles, a leading 0 is
    // octal.
    serde_saphyr::options! {
        non_finite_float_policy: NonFiniteFloatPolicy::PassThrough,
        legacy_octal_numbers: true,
    }
}

type Entries = Vec<(Spanned<String>, Spanned<Node>)>;

/// Any YAML node, mappings in the order of the text and with their lines.
enum Node {
    Null,
    Bool(bool),
    Integer(i64),
    TooLarge(u64),
    Double(f64),
    Text(String),
    List(Vec<Node>),
    Map(Entries),
}

impl Node {
    fn kind(&self) -> &'static str {
        match self {
            Node::Null => "null",
            Node::Bool(_) => "bool",
            Node::Integer(_) | Node::TooLarge(_) => "integer",
            Node::Double(_) => "double",
            Node::Text(_) => "string",
            Node::List(_) => "list",
            Node::Map(_) => "mapping",
        }
    }
}

impl<'de> Deserialize<'de> for Node {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(NodeVisitor)
    }
}

struct NodeVisitor;

impl<'de> Visitor<'de> for NodeVisitor {
    type Value = Node;

    fn expecting(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        formatter.write_str("a YAML value")
    }
    fn visit_unit<E>(self) -> Result<Node, E> {
        Ok(Node::Null)
    }
    fn visit_bool<E>(self, value: bool) -> Result<Node, E> {
        Ok(Node::Bool(value))
    }
    fn visit_i64<E>(self, value: i64) -> Result<Node, E> {
        Ok(Node::Integer(value))
    }
    fn visit_u64<E>(self, value: u64) -> Result<Node, E> {
        Ok(i64::try_from(value).map_or(Node::TooLarge(value), Node::Integer))
    }
    fn visit_f64<E>(self, value: f64) -> Result<Node, E> {
        Ok(Node::Double(value))
    }
    fn visit_str<E>(self, value: &str) -> Result<Node, E> {
        Ok(Node::Text(value.to_owned()))
    }
    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Node, A::Error> {
        let mut list = Vec::new();
        while let Some(item) = items.next_element()? {
            list.push(item);
        }
        Ok(Node::List(list))
    }
    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<Node, A::Error> {
        let mut map = Vec::new();
        while let Some(entry) = entries.next_entry()? {
            map.push(entry);
        }
        Ok(Node::Map(map))
    }
}
