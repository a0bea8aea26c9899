//! ROS 2 command line arguments: `--ros-args -r -p --params-file`.
//!
//! The command line of a process comes in, what it says about names, parameters and logging goes
//! out, together with the arguments that are not ROS's. The rules are rcl's (`rcl/arguments.h`):
//! ROS arguments stand between `--ros-args` and `--` (or the end), as often as wanted. Of several
//! remappings of a name the first wins; of several values of a parameter, or levels of a logger,
//! the last one wins, wherever it stands.
//!
//! In one point rcl differs: there a value under a node's own section of a file wins over a later
//! `-p name:=value`, because equal sections are merged at the place of the first. Here the order on
//! the command line alone decides.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use ros2_client::ParameterValue;

pub use super::assignment::ArgumentError;
use super::assignment::{Assignment, NodePattern, token};
use super::params_file;
use friction_stage_core::model::nearest;
use friction_stage_core::text_file;

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

const REMAP: &str =
    "-r [NODE:]FROM:=TO, as in -r /stage/force:=/rig/force, -r __node:=rig or -r __ns:=/lab";
const PARAM: &str = "-p [NODE:]NAME:=VALUE, as in -p control_rate:=1000.0";
const PARAMS_FILE: &str = "--params-file FILE.yaml";
const LOG_LEVEL: &str = "--log-level [LOGGER:=]debug|info|warn|error|fatal";
const ENCLAVE: &str = "-e /ENCLAVE";
/// How each ROS argument that takes a value is written.
pub(super) const ROS_ARGUMENTS: [&str; 5] = [PARAM, PARAMS_FILE, REMAP, LOG_LEVEL, ENCLAVE];
const VALUELESS: [&str; 6] = [
    "--enable-rosout-logs",
    "--disable-rosout-logs",
    "--enable-stdout-logs",
    "--disable-stdout-logs",
    "--enable-external-lib-logs",
    "--disable-external-lib-logs",
];
const WITH_VALUE: [&str; 9] = [
    "-r",
    "--remap",
    "-p",
    "--param",
    "--params-file",
    "--log-level",
    "--log-config-file",
    "-e",
    "--enclave",
];

impl RosArguments {
    /// Splits a command line into what ROS says and the others, in their order. Parameter files are
    /// read.
    pub fn parse(
        arguments: impl Iterator<Item = String>,
    ) -> Result<(RosArguments, Vec<String>), ArgumentError> {
        Self::parse_with(arguments, text_file::read)
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
        let mut value = |usage| {
            rest.next().ok_or_else(|| ArgumentError::MissingValue { flag: flag.to_owned(), usage })
        };
        match flag {
            "-r" | "--remap" => self.remaps.push(remap(flag, &value(REMAP)?)?),
            "-p" | "--param" => self.assignments.push(assignment(flag, &value(PARAM)?)?),
            "--params-file" => {
                let path = PathBuf::from(value(PARAMS_FILE)?);
                let text = read(&path)
                    .map_err(|source| ArgumentError::Unreadable { path: path.clone(), source })?;
                self.assignments.extend(params_file::parse(&path, &text)?);
            }
            "--log-level" => self.log_levels.push(log_level(&value(LOG_LEVEL)?)?),
            "--log-config-file" => {
                let file = value("--log-config-file FILE")?;
                return Err(ArgumentError::Value {
                    argument: format!("--log-config-file {file}"),
                    problem: "log configuration files are not supported; use --log-level"
                        .to_owned(),
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

    /// Namespace of the node with this (already remapped) base name: `-r __ns:=/NAMESPACE`,
    /// otherwise the given one.
    pub fn namespace(&self, node: &str, default: &str) -> String {
        self.first(node, |kind| *kind == RemapKind::Namespace).unwrap_or(default).to_owned()
    }

    /// Absolute name of a topic: `name` (absolute, relative or private `~/`) expanded for the node,
    /// then remapped.
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

    /// What the command line and its files say about the parameters of the node with this fully
    /// qualified name.
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
            self.log_levels
                .iter()
                .rev()
                .find(|(name, _)| name.as_deref() == wanted)
                .map(|(_, level)| *level)
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

    /// Security enclave, when one is named. It has no effect, which the node says at its start.
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
        match self.first(node, |kind| {
            from(kind).is_some_and(|from| expand(node, namespace, from) == full)
        }) {
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
    let malformed = |problem: String| ArgumentError::Malformed {
        argument: format!("{flag} {text}"),
        problem,
        usage: REMAP,
    };
    let (left, to) =
        text.split_once(":=").ok_or_else(|| malformed("there is no `:=` in it".to_owned()))?;
    // [NODE:][rostopic://|rosservice://]FROM
    let (head, scheme, from) = match left.split_once("://") {
        Some((head, from)) => {
            let (node, scheme) =
                head.rsplit_once(':').map_or((None, head), |(node, scheme)| (Some(node), scheme));
            (node, Some(scheme), from)
        }
        None => {
            left.split_once(':').map_or((None, None, left), |(node, from)| (Some(node), None, from))
        }
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
            let problem = if to.starts_with('/') {
                namespace_problem(to)
            } else {
                Some("must start with /".into())
            };
            if let Some(problem) = problem {
                return Err(malformed(format!("namespace `{to}` {problem}")));
            }
            RemapKind::Namespace
        }
        _ => {
            for name in [from, to] {
                topic_name(name)
                    .map_err(|problem| malformed(format!("name `{name}` {problem}")))?;
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
    let malformed = |problem: String| ArgumentError::Malformed {
        argument: origin.clone(),
        problem,
        usage: PARAM,
    };
    let (left, value) =
        text.split_once(":=").ok_or_else(|| malformed("there is no `:=` in it".to_owned()))?;
    let (node, name) = left.rsplit_once(':').unwrap_or(("/**", left));
    let node = NodePattern::new(node)
        .map_err(|problem| malformed(format!("node name `{node}` {problem}")))?;
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
    let (logger, level) =
        text.split_once(":=").map_or((None, text), |(logger, level)| (Some(logger), level));
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

fn namespace_problem(namespace: &str) -> Option<String> {
    (namespace != "/")
        .then(|| namespace[1..].split('/').find_map(|part| token(part).err()))
        .flatten()
}

fn topic_name(name: &str) -> Result<(), String> {
    let relative = name.strip_prefix("~/").or_else(|| name.strip_prefix('/')).unwrap_or(name);
    relative.split('/').try_for_each(token)
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "\
# every node
/**:
  ros__parameters:
    use_sim_time: true
    every: 2
/lab/stage:
  ros__parameters:
    every: 3
    gains:
      stage: {p: 4.0e4, u_clamp_max: .inf}
lab:
  stage:
    ros__parameters:
      model: '12'
      names: [a, b]
/**/controller:
  ros__parameters:
    rate: 60.0
/*/stage:
  ros__parameters:
    seed: 0x10
stage:
  ros__parameters:
    every: 99
";

    fn parse(line: &str) -> Result<(RosArguments, Vec<String>), ArgumentError> {
        RosArguments::parse_with(line.split_whitespace().map(str::to_owned), |path| {
            match path.to_str() {
                Some("stage.yaml") => Ok(FILE.to_owned()),
                _ => Err(std::io::ErrorKind::NotFound.into()),
            }
        })
    }

    fn ros(line: &str) -> RosArguments {
        parse(line).unwrap_or_else(|error| panic!("{line}: {error}")).0
    }

    fn refusal(line: &str) -> String {
        match parse(line) {
            Ok(_) => panic!("{line} was accepted"),
            Err(error) => error.to_string(),
        }
    }

    fn value_of(arguments: &RosArguments, node: &str, name: &str) -> Option<ParameterValue> {
        arguments.parameters_for(node).remove(name).map(|found| found.value)
    }

    fn value(text: &str) -> ParameterValue {
        let arguments = ["--ros-args".to_owned(), "-p".to_owned(), format!("x:={text}")];
        let (ros, _) = RosArguments::parse(arguments.into_iter())
            .unwrap_or_else(|error| panic!("{text}: {error}"));
        value_of(&ros, "/n", "x").expect("x was given")
    }

    #[test]
    fn only_the_sections_after_ros_args_are_ros_arguments() {
        let (ros, others) = parse(
            "stage_node -v --ros-args -r a:=b -- --out x:=y --ros-args -p every:=2 \
                   --enable-rosout-logs",
        )
        .unwrap();
        assert_eq!(others, ["stage_node", "-v", "--out", "x:=y"]);
        assert_eq!(ros.resolve("n", "/", "a"), "/b");
        assert_eq!(value_of(&ros, "/n", "every"), Some(ParameterValue::Integer(2)));
        assert!(parse("stage_node -p every:=2 --").unwrap().0.parameters_for("/n").is_empty());
    }

    #[test]
    fn names_expand_below_namespace_and_node() {
        let ros = RosArguments::default();
        assert_eq!(ros.resolve("stage", "/", "encoder"), "/encoder");
        assert_eq!(ros.resolve("stage", "/lab", "encoder"), "/lab/encoder");
        assert_eq!(ros.resolve("stage", "/lab", "~/encoder"), "/lab/stage/encoder");
        assert_eq!(ros.resolve("stage", "/lab", "/clock"), "/clock");
        assert_eq!(ros.resolve_service("stage", "/", "~/reset"), "/stage/reset");
    }

    #[test]
    fn a_name_is_remapped_however_the_rule_spells_it() {
        for rule in ["~/force", "/lab/stage/force", "stage/force"] {
            let ros = ros(&format!("--ros-args -r {rule}:=~/thrust"));
            assert_eq!(ros.resolve("stage", "/lab", "~/force"), "/lab/stage/thrust", "{rule}");
            assert_eq!(ros.resolve("stage", "/lab", "~/forces"), "/lab/stage/forces", "{rule}");
        }
        assert_eq!(ros("--ros-args --remap /a:=b").resolve("n", "/lab", "/a"), "/lab/b");
    }

    #[test]
    fn of_two_remappings_the_first_that_fits_wins() {
        let ros = ros("--ros-args -r other:/a:=/x -r /a:=/y -r /a:=/z");
        assert_eq!(ros.resolve("n", "/", "/a"), "/y");
        assert_eq!(ros.resolve("other", "/", "/a"), "/x");
    }

    #[test]
    fn node_and_namespace_can_be_renamed_for_all_or_for_one() {
        let ros = ros("--ros-args -r stage:__node:=rig -r rig:__ns:=/lab/left -r __ns:=/elsewhere");
        assert_eq!(ros.node_name("stage"), "rig");
        assert_eq!(ros.node_name("controller"), "controller");
        assert_eq!(ros.namespace("rig", "/"), "/lab/left");
        assert_eq!(ros.namespace("controller", "/"), "/elsewhere");
        assert_eq!(fully_qualified("/lab/left", "rig"), "/lab/left/rig");
        assert_eq!(fully_qualified("/", "rig"), "/rig");
    }

    #[test]
    fn a_scheme_limits_a_rule_to_topics_or_services() {
        let ros = ros("--ros-args -r rostopic://a:=t -r stage:rosservice://a:=s");
        assert_eq!(
            (ros.resolve("stage", "/", "a"), ros.resolve_service("stage", "/", "a")),
            ("/t".into(), "/s".into())
        );
        assert_eq!(ros.resolve_service("other", "/", "a"), "/a");
    }

    #[test]
    fn values_have_the_type_that_yaml_gives_them() {
        assert_eq!(value("1"), ParameterValue::Integer(1));
        assert_eq!(value("010"), ParameterValue::Integer(8));
        assert_eq!(value("-0x10"), ParameterValue::Integer(-16));
        assert_eq!(value("1.0"), ParameterValue::Double(1.0));
        assert_eq!(value("1e3"), ParameterValue::Double(1000.0));
        assert_eq!(value("-.inf"), ParameterValue::Double(f64::NEG_INFINITY));
        assert!(matches!(value(".nan"), ParameterValue::Double(nan) if nan.is_nan()));
        assert_eq!(value("true"), ParameterValue::Boolean(true));
        assert_eq!(value("off"), ParameterValue::Boolean(false));
        assert_eq!(value("lockstep"), ParameterValue::String("lockstep".into()));
        assert_eq!(value("'1'"), ParameterValue::String("1".into()));
        assert_eq!(value("''"), ParameterValue::String(String::new()));
        assert_eq!(value("/tmp/a:=b"), ParameterValue::String("/tmp/a:=b".into()));
        assert_eq!(value("[1, 2]"), ParameterValue::IntegerArray(vec![1, 2]));
        assert_eq!(value("[1.0, .5]"), ParameterValue::DoubleArray(vec![1.0, 0.5]));
        assert_eq!(value("[true, no]"), ParameterValue::BooleanArray(vec![true, false]));
        assert_eq!(value("[a, '2']"), ParameterValue::StringArray(vec!["a".into(), "2".into()]));
    }

    #[test]
    fn sections_of_a_file_reach_the_nodes_that_they_name() {
        let ros = ros("--ros-args --params-file stage.yaml");
        let stage = |name| value_of(&ros, "/lab/stage", name);
        assert_eq!(stage("use_sim_time"), Some(ParameterValue::Boolean(true)));
        assert_eq!(stage("every"), Some(ParameterValue::Integer(3)));
        assert_eq!(stage("gains.stage.p"), Some(ParameterValue::Double(4e4)));
        assert_eq!(stage("gains.stage.u_clamp_max"), Some(ParameterValue::Double(f64::INFINITY)));
        assert_eq!(stage("model"), Some(ParameterValue::String("12".into())));
        assert_eq!(stage("names"), Some(ParameterValue::StringArray(vec!["a".into(), "b".into()])));
        assert_eq!(stage("seed"), Some(ParameterValue::Integer(16)));
        assert_eq!(stage("rate"), None);
        // `stage:` is /stage, `/*/stage` is exactly one level down, `/**/controller` any number of
        // them.
        assert_eq!(value_of(&ros, "/stage", "every"), Some(ParameterValue::Integer(99)));
        assert_eq!(value_of(&ros, "/stage", "seed"), None);
        assert_eq!(value_of(&ros, "/a/b/stage", "seed"), None);
        for controller in ["/controller", "/a/controller", "/a/b/controller"] {
            assert_eq!(
                value_of(&ros, controller, "rate"),
                Some(ParameterValue::Double(60.0)),
                "{controller}"
            );
        }
        assert_eq!(ros.parameters_for("/lab/stage")["every"].origin, "stage.yaml, line 8");
    }

    #[test]
    fn the_last_value_on_the_command_line_wins() {
        let value = |line| value_of(&ros(line), "/lab/stage", "every");
        assert_eq!(
            value("--ros-args --params-file stage.yaml -p every:=7"),
            Some(ParameterValue::Integer(7))
        );
        assert_eq!(
            value("--ros-args -p every:=7 --params-file stage.yaml"),
            Some(ParameterValue::Integer(3))
        );
        assert_eq!(
            value("--ros-args -p every:=7 -p /lab/stage:every:=8"),
            Some(ParameterValue::Integer(8))
        );
        assert_eq!(
            value("--ros-args -p every:=7 -p stage:every:=8"),
            Some(ParameterValue::Integer(7))
        );
    }

    #[test]
    fn logging_follows_the_last_level_and_switch() {
        let ros = ros("--ros-args --log-level WARN --log-level rig:=debug --log-level error \
             --disable-rosout-logs -e /x");
        assert_eq!(ros.log_level("rig"), Some(LogLevel::Debug));
        assert_eq!(ros.log_level("other"), Some(LogLevel::Error));
        assert_eq!(
            (ros.rosout_logs(), ros.stdout_logs(), ros.enclave()),
            (false, true, Some("/x"))
        );
        assert_eq!(RosArguments::default().log_level("rig"), None);
    }

    #[test]
    fn a_wrong_argument_is_named_with_what_would_be_right() {
        for (line, parts) in [
            ("-p", &["`-p` needs a value", "-p [NODE:]NAME:=VALUE"][..]),
            ("-p every=2", &["-p every=2", "no `:=`", "NAME:=VALUE"]),
            ("-p every:=", &["-p every:=", "missing", "''"]),
            ("-p :=2", &["-p :=2", "no name"]),
            ("-p x:=[1,2.0]", &["mixes integer and double (item 2)"]),
            ("-p x:=[]", &["empty list"]),
            ("-p x:=[[1],[2]]", &["list whose first item is a list"]),
            ("-p x:={a:1}", &["mapping of 1 keys"]),
            ("-p x:=[1", &["-p x:=[1", "is not YAML"]),
            ("-p x:=9223372036854775808", &["9223372036854775808", "64-bit"]),
            ("-p st*:x:=1", &["st*", "wildcard"]),
            ("-r a", &["-r a", "no `:=`", "FROM:=TO"]),
            ("-r a:=b-c", &["b-c", "must not contain `-`"]),
            ("-r a:=/b/", &["/b/", "empty part"]),
            ("-r 1a:=b", &["1a", "digit 1"]),
            ("-r __node:=a/b", &["a/b", "must not contain `/`"]),
            ("-r __ns:=lab", &["lab", "must start with /"]),
            ("-r rosaction://a:=b", &["rosaction://", "rostopic://"]),
            ("-r /foo/*:=/bar", &["/foo/*", "wildcard"]),
            ("--params-file missing.yaml", &["missing.yaml", "cannot read"]),
            ("--log-level wran", &["wran", "did you mean `warn`?"]),
            ("--parm x:=1", &["--parm", "did you mean `--param`?"]),
            ("x:=1", &["x:=1", "-r", "-p"]),
            ("record", &["record", "before --ros-args or after --"]),
        ] {
            let message = refusal(&format!("node --ros-args {line}"));
            for part in parts {
                assert!(message.contains(part), "{line}: `{message}` does not say `{part}`");
            }
        }
    }

    #[test]
    fn a_wrong_parameter_file_is_named_with_the_line() {
        for (text, line, problem) in [
            ("just text", 1, "expected a mapping of node names"),
            ("ros__parameters:\n  every: 2\n", 1, "`/**:`"),
            ("stage:\n  every: 2\n", 2, "outside of `ros__parameters:`"),
            ("stage:\n", 1, "nothing below it"),
            ("stage:\n  ros__parameters: 3\n", 2, "expected a mapping of parameters"),
            ("/**:\n  ros__parameters:\n    a: 1\n    b:\n", 4, "parameter `b` is missing"),
            (
                "/**:\n  ros__parameters:\n    g:\n      p: [1, x]\n",
                4,
                "`g.p` mixes integer and string",
            ),
            ("/**:\n  ros__parameters:\n    a: 1\n    a: 2\n", 4, "a second time"),
            ("/**:\n  ros__parameters:\n    a: [1\n", 3, "unclosed"),
            ("/**:\n  ros__parameters:\n    a: 1\n   b: 2\n", 4, "block mapping"),
            ("my-node:\n  ros__parameters:\n    a: 1\n", 2, "must not contain `-`"),
        ] {
            let arguments = ["--ros-args", "--params-file", "p.yaml"].map(str::to_owned);
            let error =
                match RosArguments::parse_with(arguments.into_iter(), |_| Ok(text.to_owned())) {
                    Ok(_) => panic!("accepted {text:?}"),
                    Err(error) => error.to_string(),
                };
            assert!(error.starts_with(&format!("p.yaml, line {line}: ")), "{text:?}: {error}");
            assert!(error.contains(problem), "{text:?}: {error}");
        }
    }

    #[test]
    fn an_empty_parameter_section_is_no_error() {
        for text in ["/**:\n  ros__parameters:\n", "/**:\n  ros__parameters: {}\n"] {
            let arguments = ["--ros-args", "--params-file", "p.yaml"].map(str::to_owned);
            let (ros, _) =
                RosArguments::parse_with(arguments.into_iter(), |_| Ok(text.to_owned())).unwrap();
            assert!(ros.parameters_for("/stage").is_empty());
        }
    }
}
