//! Values that a command line or a file gives to parameters, for which nodes, and why one is
//! refused.

use std::path::PathBuf;

use ros2_client::ParameterValue;

/// One parameter value for every node that the pattern fits.
#[derive(Debug, Clone)]
pub(super) struct Assignment {
    pub(super) node: NodePattern,
    pub(super) name: String,
    pub(super) value: ParameterValue,
    pub(super) origin: String,
}

/// Which nodes a section of a parameter file is for: names between slashes, `*` for one of them,
/// `**` for any number.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct NodePattern(Vec<String>);

impl NodePattern {
    /// `pattern` is taken from the root, with or without its first slash. On error says what is
    /// wrong with it.
    pub(super) fn new(pattern: &str) -> Result<Self, String> {
        let tokens: Vec<String> =
            pattern.strip_prefix('/').unwrap_or(pattern).split('/').map(str::to_owned).collect();
        for part in &tokens {
            if !matches!(part.as_str(), "*" | "**") {
                token(part)?;
            }
        }
        Ok(Self(tokens))
    }

    pub(super) fn fits(&self, fully_qualified_node_name: &str) -> bool {
        fn fit(pattern: &[String], name: &[&str]) -> bool {
            match pattern.split_first() {
                None => name.is_empty(),
                Some((first, rest)) if first == "**" => {
                    (0..=name.len()).any(|skipped| fit(rest, &name[skipped..]))
                }
                Some((first, rest)) => name
                    .split_first()
                    .is_some_and(|(part, left)| (first == "*" || first == part) && fit(rest, left)),
            }
        }
        let name: Vec<&str> =
            fully_qualified_node_name.trim_start_matches('/').split('/').collect();
        fit(&self.0, &name)
    }
}

/// What one part of a name may be made of.
pub(super) fn token(token: &str) -> Result<(), String> {
    match token.chars().next() {
        None => return Err("has an empty part".to_owned()),
        Some(first) if first.is_ascii_digit() => {
            return Err(format!("must not start a part with the digit {first}"));
        }
        _ => {}
    }
    match token.chars().find(|c| !(c.is_ascii_alphanumeric() || *c == '_')) {
        Some('*') => Err("has a wildcard where none is possible".to_owned()),
        Some(bad) => Err(format!("must not contain `{bad}`, only letters, digits and `_`")),
        None => Ok(()),
    }
}

/// Why a command line was refused: which argument, what is wrong with it, what would be right.
#[derive(Debug, thiserror::Error)]
pub enum ArgumentError {
    #[error("`{flag}` needs a value: {usage}")]
    MissingValue { flag: String, usage: &'static str },
    #[error("unknown ROS argument `{argument}`{hint}{note}")]
    Unknown { argument: String, hint: String, note: &'static str },
    #[error("`{argument}`: {problem}; expected {usage}")]
    Malformed { argument: String, problem: String, usage: &'static str },
    #[error("`{argument}`: {problem}")]
    Value { argument: String, problem: String },
    #[error("cannot read the parameter file {path}: {source}")]
    Unreadable { path: PathBuf, source: std::io::Error },
    #[error("{path}, line {line}: {problem}")]
    ParamsFile { path: PathBuf, line: u64, problem: String },
}
