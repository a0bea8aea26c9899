//! ROS 2 command line arguments: `--ros-args -r -p --params-file`.
//!
//! The command line of a process comes in, what it says about names, parameters and logging goes out, together with
//! the arguments that are not ROS's. The rules are rcl's (`rcl/arguments.h`): ROS arguments stand between
//! `--ros-args` and `--` (or the end), as often as wanted. Of several remappings of a name the first wins; of several
//! values of a parameter, or levels of a logger, the last one wins, wherever it stands.
//!
//! In one point rcl differs: there a value under a node's own section of a file wins over a later `-p name:=value`,
//! because equal sections are merged at the place of the first. Here the order on the command line alone decides.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use ros2_client::ParameterValue;

use super::params_file;
use crate::model::nearest;

/// What the ROS part of a command line says.
#[derive(Debug, Clone, Default)]
pub struct RosArguments {
    remaps: Vec<Remap>,
    assignments: Vec<Assignment>,
    log_levels: Vec<(Option<String>, LogLevel)>,
    rosout_logs: Option<bool>,
    stdout_logs: Option<bool>,
    enclave: Option<String>,
}

/// A value that the command line or a parameter file gives to a parameter, and where it stands.
#[derive(Debug, Clone, PartialEq)]
pub struct Override {
    pub value: ParameterValue,
    /// For messages: `-p control_rate:=1000.0` or `stage.yaml, line 4`.
    pub origin: String,
}

/// One parameter value for every node that the pattern fits.
#[derive(Debug, Clone)]
pub(super) struct Assignment {
    pub(super) node: NodePattern,
    pub(super) name: String,
    pub(super) value: ParameterValue,
    pub(super) origin: String,
}

/// Severity from which on a logger speaks, as `--log-level` takes it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LogLevel {
    Debug,
    Info,
    Warn,
    Error,
    Fatal,
}

impl From<LogLevel> for tracing::level_filters::LevelFilter {
    /// `fatal` has no counterpart in tracing and shows errors.
    fn from(level: LogLevel) -> Self {
        match level {
            LogLevel::Debug => Self::DEBUG,
            LogLevel::Info => Self::INFO,
            LogLevel::Warn => Self::WARN,
            LogLevel::Error | LogLevel::Fatal => Self::ERROR,
        }
    }
}

#[derive(Debug, Clone)]
struct Remap {
    /// Base name of the node that the rule is for; any node when absent.
    node: Option<String>,
    kind: RemapKind,
    to: String,
}

#[derive(Debug, Clone, PartialEq)]
enum RemapKind {
    NodeName,
    Namespace,
    Topic(String),
    Service(String),
    TopicOrService(String),
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
    #[error("`--params-file {path}`: cannot read it: {source}")]
    Unreadable { path: PathBuf, source: std::io::Error },
    #[error("{path}, line {line}: {problem}")]
    ParamsFile { path: PathBuf, line: u64, problem: String },
}

const REMAP: &str = "-r [NODE:]FROM:=TO, as in -r /stage/force:=/rig/force, -r __node:=rig or -r __ns:=/lab";
const PARAM: &str = "-p [NODE:]NAME:=VALUE, as in -p control_rate:=1000.0";
const PARAMS_FILE: &str = "--params-file FILE.yaml";
const LOG_LEVEL: &str = "--log-level [LOGGER:=]debug|info|warn|error|fatal";
const ENCLAVE: &str = "-e /ENCLAVE";
const VALUELESS: [&str; 6] = [
    "--enable-rosout-logs",
    "--disable-rosout-logs",
    "--enable-stdout-logs",
    "--disable-stdout-logs",
    "--enable-external-lib-logs",
    "--disable-external-lib-logs",
];
const WITH_VALUE: [&str; 9] =
    ["-r", "--remap", "-p", "--param", "--params-file", "--log-level", "--log-config-file", "-e", "--enclave"];

impl RosArguments {
    /// Splits a command line into what ROS says and the others, in their order. Parameter files are read.
    pub fn parse(arguments: impl Iterator<Item = String>) -> Result<(RosArguments, Vec<String>), ArgumentError> {
        Self::parse_with(arguments, |path| std::fs::read_to_string(path))
    }

    /// [`parse`](Self::parse), with parameter files read by the caller's function.
    pub fn parse_with(
        mut arguments: impl Iterator<Item = String>,
        read: impl Fn(&Path) -> std::io::Result<String>,
    ) -> Result<(RosArguments, Vec<String>), ArgumentError> {
        let mut ros = RosArguments::default();
        let mut others = Vec::new();
        let mut inside = false;
        while let Some(argument) = arguments.next() {
            match (inside, argument.as_str()) {
                (_, "--ros-args") => inside = true,
                (true, "--") => inside = false,
                (true, _) => ros.take(&argument, &mut arguments, &read)?,
                (false, _) => others.push(argument),
            }
        }
        Ok((ros, others))
    }

    fn take(
        &mut self,
        flag: &str,
        rest: &mut impl Iterator<Item = String>,
        read: impl Fn(&Path) -> std::io::Result<String>,
    ) -> Result<(), ArgumentError> {
        let mut value = |usage| rest.next().ok_or_else(|| ArgumentError::MissingValue { flag: flag.to_owned(), usage });
        match flag {
            "-r" | "--remap" => self.remaps.push(remap(flag, &value(REMAP)?)?),
            "-p" | "--param" => self.assignments.push(assignment(flag, &value(PARAM)?)?),
            "--params-file" => {
                let path = PathBuf::from(value(PARAMS_FILE)?);
                let text = read(&path).map_err(|source| ArgumentError::Unreadable { path: path.clone(), source })?;
                self.assignments.extend(params_file::parse(&path, &text)?);
            }
            "--log-level" => self.log_levels.push(log_level(&value(LOG_LEVEL)?)?),
            "--log-config-file" => {
                let file = value("--log-config-file FILE")?;
                return Err(ArgumentError::Value {
                    argument: format!("--log-config-file {file}"),
                    problem: "log configuration files are not supported; use --log-level".to_owned(),
                });
            }
            "-e" | "--enclave" => self.enclave = Some(value(ENCLAVE)?),
            "--enable-rosout-logs" => self.rosout_logs = Some(true),
            "--disable-rosout-logs" => self.rosout_logs = Some(false),
            "--enable-stdout-logs" => self.stdout_logs = Some(true),
            "--disable-stdout-logs" => self.stdout_logs = Some(false),
            // There is no external logging library to switch.
            "--enable-external-lib-logs" | "--disable-external-lib-logs" => {}
            _ => {
                let hint = nearest(flag, VALUELESS.into_iter().chain(WITH_VALUE));
                let note = if flag.contains(":=") {
                    "; remappings need -r, parameters need -p before them"
                } else if flag.starts_with('-') {
                    ""
                } else {
                    "; arguments that are not for ROS go before --ros-args or after --"
                };
                return Err(ArgumentError::Unknown { argument: flag.to_owned(), hint, note });
            }
        }
        Ok(())
    }

    /// Base name of the node: `-r __node:=NAME`, otherwise the given one.
    pub fn node_name(&self, default: &str) -> String {
        self.first(default, |kind| *kind == RemapKind::NodeName).unwrap_or(default).to_owned()
    }

    /// Namespace of the node with this (already remapped) base name: `-r __ns:=/NAMESPACE`, otherwise the given one.
    pub fn namespace(&self, node: &str, default: &str) -> String {
        self.first(node, |kind| *kind == RemapKind::Namespace).unwrap_or(default).to_owned()
    }

    /// Absolute name of a topic: `name` (absolute, relative or private `~/`) expanded for the node, then remapped.
    pub fn resolve(&self, node: &str, namespace: &str, name: &str) -> String {
        self.remapped(node, namespace, name, |kind| match kind {
            RemapKind::Topic(from) | RemapKind::TopicOrService(from) => Some(from),
            _ => None,
        })
    }

    /// Absolute name of a service, as [`resolve`](Self::resolve) does it for topics.
    pub fn resolve_service(&self, node: &str, namespace: &str, name: &str) -> String {
        self.remapped(node, namespace, name, |kind| match kind {
            RemapKind::Service(from) | RemapKind::TopicOrService(from) => Some(from),
            _ => None,
        })
    }

    /// What the command line and its files say about the parameters of the node with this fully qualified name.
    pub fn parameters_for(&self, fully_qualified_node_name: &str) -> BTreeMap<String, Override> {
        self.assignments
            .iter()
            .filter(|assignment| assignment.node.fits(fully_qualified_node_name))
            .map(|assignment| {
                let Assignment { name, value, origin, .. } = assignment.clone();
                (name, Override { value, origin })
            })
            .collect()
    }

    /// Level asked for the logger, or for all of them when it has none of its own.
    pub fn log_level(&self, logger: &str) -> Option<LogLevel> {
        let last = |wanted: Option<&str>| {
            self.log_levels.iter().rev().find(|(name, _)| name.as_deref() == wanted).map(|(_, level)| *level)
        };
        last(Some(logger)).or_else(|| last(None))
    }

    /// Whether logs go to `/rosout` (they do unless disabled).
    pub fn rosout_logs(&self) -> bool {
        self.rosout_logs.unwrap_or(true)
    }

    /// Whether logs go to the terminal (they do unless disabled).
    pub fn stdout_logs(&self) -> bool {
        self.stdout_logs.unwrap_or(true)
    }

    /// Security enclave, when one is named. Nothing here uses it.
    pub fn enclave(&self) -> Option<&str> {
        self.enclave.as_deref()
    }

    fn first(&self, node: &str, wanted: impl Fn(&RemapKind) -> bool) -> Option<&str> {
        self.remaps
            .iter()
            .find(|rule| rule.node.as_deref().is_none_or(|only| only == node) && wanted(&rule.kind))
            .map(|rule| rule.to.as_str())
    }

    fn remapped(
        &self,
        node: &str,
        namespace: &str,
        name: &str,
        from: impl Fn(&RemapKind) -> Option<&String>,
    ) -> String {
        let full = expand(node, namespace, name);
        match self.first(node, |kind| from(kind).is_some_and(|from| expand(node, namespace, from) == full)) {
            Some(to) => expand(node, namespace, to),
            None => full,
        }
    }
}

/// Fully qualified name of a node.
pub fn fully_qualified(namespace: &str, node: &str) -> String {
    format!("{}/{node}", namespace.trim_end_matches('/'))
}

fn expand(node: &str, namespace: &str, name: &str) -> String {
    match name.strip_prefix('~') {
        Some(rest) => fully_qualified(namespace, node) + rest,
        None if name.starts_with('/') => name.to_owned(),
        None => fully_qualified(namespace, name),
    }
}

fn remap(flag: &str, text: &str) -> Result<Remap, ArgumentError> {
    let malformed =
        |problem: String| ArgumentError::Malformed { argument: format!("{flag} {text}"), problem, usage: REMAP };
    let (left, to) = text.split_once(":=").ok_or_else(|| malformed("there is no `:=` in it".to_owned()))?;
    // [NODE:][rostopic://|rosservice://]FROM
    let (head, scheme, from) = match left.split_once("://") {
        Some((head, from)) => {
            let (node, scheme) = head.rsplit_once(':').map_or((None, head), |(node, scheme)| (Some(node), scheme));
            (node, Some(scheme), from)
        }
        None => left.split_once(':').map_or((None, None, left), |(node, from)| (Some(node), None, from)),
    };
    if let Some(node) = head {
        token(node).map_err(|problem| malformed(format!("node name `{node}` {problem}")))?;
    }
    let kind = match (scheme, from) {
        (None, "__node" | "__name") => {
            token(to).map_err(|problem| malformed(format!("node name `{to}` {problem}")))?;
            RemapKind::NodeName
        }
        (None, "__ns") => {
            let problem = if to.starts_with('/') { namespace_problem(to) } else { Some("must start with /".into()) };
            if let Some(problem) = problem {
                return Err(malformed(format!("namespace `{to}` {problem}")));
            }
            RemapKind::Namespace
        }
        _ => {
            for name in [from, to] {
                topic_name(name).map_err(|problem| malformed(format!("name `{name}` {problem}")))?;
            }
            match scheme {
                None => RemapKind::TopicOrService(from.to_owned()),
                Some("rostopic") => RemapKind::Topic(from.to_owned()),
                Some("rosservice") => RemapKind::Service(from.to_owned()),
                Some(other) => {
                    return Err(malformed(format!(
                        "unknown scheme `{other}://`, known are rostopic:// and rosservice://"
                    )));
                }
            }
        }
    };
    Ok(Remap { node: head.map(str::to_owned), kind, to: to.to_owned() })
}

fn assignment(flag: &str, text: &str) -> Result<Assignment, ArgumentError> {
    let origin = format!("{flag} {text}");
    let malformed = |problem: String| ArgumentError::Malformed { argument: origin.clone(), problem, usage: PARAM };
    let (left, value) = text.split_once(":=").ok_or_else(|| malformed("there is no `:=` in it".to_owned()))?;
    let (node, name) = left.rsplit_once(':').unwrap_or(("/**", left));
    let node = NodePattern::new(node).map_err(|problem| malformed(format!("node name `{node}` {problem}")))?;
    if name.is_empty() {
        return Err(malformed("the parameter has no name".to_owned()));
    }
    let value = params_file::value(value).map_err(|problem| ArgumentError::Value {
        argument: origin.clone(),
        problem: format!("the value {problem}"),
    })?;
    Ok(Assignment { node, name: name.to_owned(), value, origin })
}

fn log_level(text: &str) -> Result<(Option<String>, LogLevel), ArgumentError> {
    let (logger, level) = text.split_once(":=").map_or((None, text), |(logger, level)| (Some(logger), level));
    let level = match level.to_ascii_lowercase().as_str() {
        "debug" => LogLevel::Debug,
        "info" => LogLevel::Info,
        "warn" => LogLevel::Warn,
        "error" => LogLevel::Error,
        "fatal" => LogLevel::Fatal,
        other => {
            let hint = nearest(other, ["debug", "info", "warn", "error", "fatal"]);
            return Err(ArgumentError::Malformed {
                argument: format!("--log-level {text}"),
                problem: format!("unknown level `{level}`{hint}"),
                usage: LOG_LEVEL,
            });
        }
    };
    Ok((logger.map(str::to_owned), level))
}

/// Which nodes a section of a parameter file is for: names between slashes, `*` for one of them, `**` for any number.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct NodePattern(Vec<String>);

impl NodePattern {
    /// `pattern` is taken from the root, with or without its first slash. On error says what is wrong with it.
    pub(super) fn new(pattern: &str) -> Result<Self, String> {
        let tokens: Vec<String> = pattern.strip_prefix('/').unwrap_or(pattern).split('/').map(str::to_owned).collect();
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
                Some((first, rest)) if first == "**" => (0..=name.len()).any(|skipped| fit(rest, &name[skipped..])),
                Some((first, rest)) => {
                    name.split_first().is_some_and(|(part, left)| (first == "*" || first == part) && fit(rest, left))
                }
            }
        }
        let name: Vec<&str> = fully_qualified_node_name.trim_start_matches('/').split('/').collect();
        fit(&self.0, &name)
    }
}

/// What one part of a name may be made of.
fn token(token: &str) -> Result<(), String> {
    match token.chars().next() {
        None => return Err("has an empty part".to_owned()),
        Some(first) if first.is_ascii_digit() => return Err(format!("must not start a part with the digit {first}")),
        _ => {}
    }
    match token.chars().find(|c| !(c.is_ascii_alphanumeric() || *c == '_')) {
        Some('*') => Err("has a wildcard where none is possible".to_owned()),
        Some(bad) => Err(format!("must not contain `{bad}`, only letters, digits and `_`")),
        None => Ok(()),
    }
}

fn namespace_problem(namespace: &str) -> Option<String> {
    (namespace != "/").then(|| namespace[1..].split('/').find_map(|part| token(part).err())).flatten()
}

fn topic_name(name: &str) -> Result<(), String> {
    let relative = name.strip_prefix("~/").or_else(|| name.strip_prefix('/')).unwrap_or(name);
    relative.split('/').try_for_each(token)
}
