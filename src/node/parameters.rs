//! Declared parameters and the six parameter services.
//!
//! A node says as data which parameters it has ([`ParameterSpec`]). What the command line gives
//! comes in once ([`ParameterSet::declare`]), what other nodes ask for comes in through the
//! services ([`ParameterServer`]). Out go values that have the declared type, lie in the declared
//! range and passed the node's own checks. Nothing is converted: a parameter keeps the type of its
//! default, as in rclcpp.

use std::collections::BTreeMap;
use std::ops::Deref;
use std::sync::{Arc, Mutex, PoisonError};

use ros2_client::builtin_interfaces::Time;
use ros2_client::parameters::raw;
use ros2_client::qos::{Durability, History, WhenFull};
use ros2_client::{
    MessageTypeName, Name, Node, ParameterValue, Publisher, QosProfile, rcl_interfaces,
};

use super::arguments::Override;
use super::participant::Participant;
use super::service::{self, ServiceError, services};
use friction_stage_core::model::nearest;

/// Whether the node takes its time from `/clock`; every node has this parameter.
pub const USE_SIM_TIME: &str = "use_sim_time";

/// One parameter of a node: everything that a user may know about it.
#[derive(Debug, Clone)]
pub struct ParameterSpec {
    pub name: &'static str,
    /// The value without an override. Its type is the type of the parameter.
    pub default: ParameterValue,
    pub description: &'static str,
    /// SI unit; empty when there is none.
    pub unit: &'static str,
    /// Smallest and largest value, both allowed, of an integer or double. A double may be infinite
    /// only if its range is.
    pub range: Option<(f64, f64)>,
    /// The allowed strings; any string when empty.
    pub choices: &'static [&'static str],
    /// Can be given at start only.
    pub read_only: bool,
}

impl ParameterSpec {
    fn new(name: &'static str, default: ParameterValue, description: &'static str) -> Self {
        Self { name, default, description, unit: "", range: None, choices: &[], read_only: false }
    }

    pub fn boolean(name: &'static str, default: bool, description: &'static str) -> Self {
        Self::new(name, ParameterValue::Boolean(default), description)
    }

    pub fn integer(name: &'static str, default: i64, description: &'static str) -> Self {
        Self::new(name, ParameterValue::Integer(default), description)
    }

    pub fn double(name: &'static str, default: f64, description: &'static str) -> Self {
        Self::new(name, ParameterValue::Double(default), description)
    }

    pub fn string(name: &'static str, default: &str, description: &'static str) -> Self {
        Self::new(name, ParameterValue::String(default.to_owned()), description)
    }

    pub fn unit(self, unit: &'static str) -> Self {
        Self { unit, ..self }
    }

    pub fn range(self, min: f64, max: f64) -> Self {
        Self { range: Some((min, max)), ..self }
    }

    pub fn choices(self, choices: &'static [&'static str]) -> Self {
        Self { choices, ..self }
    }

    pub fn read_only(self) -> Self {
        Self { read_only: true, ..self }
    }

    /// What it takes: type, range or choices, default, and whether it can change while the node
    /// runs.
    pub fn values(&self) -> String {
        let unit = unit(self.unit);
        let mut reported = type_name(&self.default).to_owned();
        if let Some((min, max)) = self.range {
            let limit = |value: f64| match self.default {
                ParameterValue::Integer(_) => format!("{value}"),
                _ => format!("{value:?}"),
            };
            reported += &format!(", {} to {}{unit}", limit(min), limit(max));
        }
        if !self.choices.is_empty() {
            reported += &format!(", {}", self.choices.join(" or "));
        }
        reported += &match show(&self.default) {
            nothing if nothing.is_empty() => ", default none".to_owned(),
            default => format!(", default {default}{unit}"),
        };
        if self.read_only { reported + ", at start only" } else { reported }
    }

    /// Refuses a value of another type, out of range, not a number, or not among the choices.
    fn check(&self, value: &ParameterValue) -> Result<(), ParameterError> {
        let name = self.name;
        if value.to_parameter_type() != self.default.to_parameter_type() {
            let hint = match (&self.default, value) {
                (ParameterValue::Double(_), ParameterValue::Integer(given)) => {
                    format!("; write {given}.0")
                }
                (ParameterValue::String(_), ParameterValue::NotSet) => String::new(),
                (ParameterValue::String(_), given) => {
                    format!("; write '{}' in quotes", show(given))
                }
                _ => String::new(),
            };
            let (expected, got) = (type_name(&self.default), type_name(value));
            return Err(ParameterError::Type { name, expected, got, value: show(value), hint });
        }
        let number = match value {
            ParameterValue::Integer(value) => Some(*value as f64),
            ParameterValue::Double(value) => Some(*value),
            _ => None,
        };
        if let Some(number) = number {
            let reaches_infinity =
                self.range.is_some_and(|(min, max)| min.is_infinite() || max.is_infinite());
            if number.is_nan() || (number.is_infinite() && !reaches_infinity) {
                return Err(ParameterError::NotFinite {
                    name,
                    value: show(value),
                    unit: unit(self.unit),
                });
            }
            if let Some((min, max)) = self.range.filter(|(min, max)| number < *min || number > *max)
            {
                return Err(ParameterError::OutOfRange {
                    name,
                    value: show(value),
                    min,
                    max,
                    unit: unit(self.unit),
                });
            }
        }
        if let ParameterValue::String(given) = value
            && !self.choices.is_empty()
            && !self.choices.contains(&given.as_str())
        {
            let hint = nearest(given, self.choices.iter().copied());
            return Err(ParameterError::Choice {
                name,
                value: given.clone(),
                choices: self.choices.join(", "),
                hint,
            });
        }
        Ok(())
    }

    fn descriptor(&self) -> raw::ParameterDescriptor {
        let mut descriptor = raw::ParameterDescriptor {
            name: self.name.to_owned(),
            r#type: ParameterValue::to_parameter_type_raw(&self.default),
            description: match self.unit {
                "" => self.description.to_owned(),
                unit => format!("{} [{unit}]", self.description),
            },
            additional_constraints: match self.choices {
                [] => String::new(),
                choices => format!("one of: {}", choices.join(", ")),
            },
            read_only: self.read_only,
            dynamic_typing: false,
            floating_point_range: Vec::new(),
            integer_range: Vec::new(),
        };
        match (&self.default, self.range) {
            (ParameterValue::Integer(_), Some((min, max))) => {
                descriptor.integer_range = vec![raw::IntegerRange {
                    from_value: min as i64,
                    to_value: max as i64,
                    step: 0,
                }];
            }
            (ParameterValue::Double(_), Some((min, max))) => {
                descriptor.floating_point_range =
                    vec![raw::FloatingPointRange { from_value: min, to_value: max, step: 0.0 }];
            }
            _ => {}
        }
        descriptor
    }
}

/// Why a parameter was refused. At run time its text is the reason that the asking node gets.
#[derive(Debug, thiserror::Error)]
pub enum ParameterError {
    #[error("unknown parameter `{name}`{hint}; the node has {known}")]
    Unknown { name: String, hint: String, known: String },
    #[error("parameter `{name}` is of type {expected}, got the {got} {value}{hint}")]
    Type {
        name: &'static str,
        expected: &'static str,
        got: &'static str,
        value: String,
        hint: String,
    },
    #[error("parameter `{name}` must be a finite number, got {value}{unit}")]
    NotFinite { name: &'static str, value: String, unit: String },
    #[error("parameter `{name}` is {value}{unit}, must lie within {min} and {max}{unit}")]
    OutOfRange { name: &'static str, value: String, min: f64, max: f64, unit: String },
    #[error("parameter `{name}` is `{value}`{hint}; must be one of {choices}")]
    Choice { name: &'static str, value: String, choices: String, hint: String },
    #[error(
        "parameter `{name}` is read-only and keeps {current}; give it at start: -p {name}:={asked}"
    )]
    ReadOnly { name: &'static str, current: String, asked: String },
    #[error("parameter `{name}` is declared and cannot be deleted")]
    Deleted { name: &'static str },
    #[error("{reason}")]
    Refused { reason: String },
    #[error("{origin}: {source}")]
    Override { origin: String, source: Box<ParameterError> },
}

fn unit(unit: &str) -> String {
    if unit.is_empty() { String::new() } else { format!(" {unit}") }
}

fn type_name(value: &ParameterValue) -> &'static str {
    match value {
        ParameterValue::NotSet => "nothing",
        ParameterValue::Boolean(_) => "bool",
        ParameterValue::Integer(_) => "integer",
        ParameterValue::Double(_) => "double",
        ParameterValue::String(_) => "string",
        ParameterValue::ByteArray(_) => "byte array",
        ParameterValue::BooleanArray(_) => "bool array",
        ParameterValue::IntegerArray(_) => "integer array",
        ParameterValue::DoubleArray(_) => "double array",
        ParameterValue::StringArray(_) => "string array",
    }
}

/// The value as a user writes it.
fn show(value: &ParameterValue) -> String {
    match value {
        ParameterValue::NotSet => String::new(),
        ParameterValue::Boolean(value) => format!("{value}"),
        ParameterValue::Integer(value) => format!("{value}"),
        ParameterValue::Double(value) => format!("{value:?}"),
        ParameterValue::String(value) => value.clone(),
        ParameterValue::ByteArray(value) => format!("{value:?}"),
        ParameterValue::BooleanArray(value) => format!("{value:?}"),
        ParameterValue::IntegerArray(value) => format!("{value:?}"),
        ParameterValue::DoubleArray(value) => format!("{value:?}"),
        ParameterValue::StringArray(value) => format!("{value:?}"),
    }
}

/// Values of all parameters of a node, read by name and type.
#[derive(Debug, Clone)]
pub struct ParameterValues(BTreeMap<&'static str, ParameterValue>);

macro_rules! typed_getter {
    ($(#[$doc:meta])* $getter:ident, $kind:ident, $type:ty) => {
        $(#[$doc])*
        ///
        /// # Panics
        /// When the node declared no such parameter with this type: the name comes from the node's
        /// own code.
        pub fn $getter(&self, name: &str) -> $type {
            match self.0.get(name) {
                Some(ParameterValue::$kind(value)) => value.to_owned(),
                other => {
                    panic!("parameter `{name}` was read as {}, is {other:?}", stringify!($kind))
                }
            }
        }
    };
}

impl ParameterValues {
    typed_getter!(
        /// Value of a parameter declared with [`ParameterSpec::boolean`].
        boolean, Boolean, bool);
    typed_getter!(
        /// Value of a parameter declared with [`ParameterSpec::integer`].
        integer, Integer, i64);
    typed_getter!(
        /// Value, in the unit of the declaration, of a parameter declared with
        /// [`ParameterSpec::double`].
        double, Double, f64);
    typed_getter!(
        /// Value of a parameter declared with [`ParameterSpec::string`].
        string, String, String);

    /// Value of any parameter, if there is one of this name.
    pub fn get(&self, name: &str) -> Option<&ParameterValue> {
        self.0.get(name)
    }

    /// All names and values, sorted by name.
    pub fn iter(&self) -> impl Iterator<Item = (&'static str, &ParameterValue)> {
        self.0.iter().map(|(name, value)| (*name, value))
    }
}

type Check = dyn Fn(&ParameterValues) -> Result<(), String> + Send;
type OnChange = dyn FnMut(&[(&str, ParameterValue)], &ParameterValues) -> Result<(), String> + Send;
type Derive = dyn Fn(&ParameterValues) -> Vec<(&'static str, ParameterValue)> + Send;

/// The parameters of a node: what is declared, and the values that they have now.
pub struct ParameterSet {
    specs: Vec<ParameterSpec>,
    values: ParameterValues,
    checks: Vec<Box<Check>>,
    on_change: Vec<Box<OnChange>>,
    derive: Option<Box<Derive>>,
}

impl Deref for ParameterSet {
    type Target = ParameterValues;
    fn deref(&self) -> &ParameterValues {
        &self.values
    }
}

impl ParameterSet {
    /// Declares the parameters, and [`USE_SIM_TIME`] if it is not among them, with the values that
    /// the command line gives. An override of an unknown parameter, or a value that may not be, is
    /// refused.
    pub fn declare(
        mut specs: Vec<ParameterSpec>,
        overrides: &BTreeMap<String, Override>,
    ) -> Result<Self, ParameterError> {
        if specs.iter().all(|spec| spec.name != USE_SIM_TIME) {
            specs.push(ParameterSpec::boolean(USE_SIM_TIME, false, "take the time from /clock"));
        }
        specs.sort_by_key(|spec| spec.name);
        let values =
            ParameterValues(specs.iter().map(|spec| (spec.name, spec.default.clone())).collect());
        specs.iter().try_for_each(|spec| spec.check(&spec.default))?;
        let mut set =
            Self { specs, values, checks: Vec::new(), on_change: Vec::new(), derive: None };
        for (name, Override { value, origin }) in overrides {
            let placed = |source| ParameterError::Override {
                origin: origin.clone(),
                source: Box::new(source),
            };
            let spec = set.spec(name).map_err(placed)?;
            spec.check(value).map_err(placed)?;
            set.values.0.insert(spec.name, value.clone());
        }
        Ok(set)
    }

    /// Adds a rule over several parameters. It must hold now, and is asked with the values as they
    /// would become before any change; its error text is the reason that the user gets.
    pub fn check(
        mut self,
        rule: impl Fn(&ParameterValues) -> Result<(), String> + Send + 'static,
    ) -> Result<Self, ParameterError> {
        rule(&self.values).map_err(|reason| ParameterError::Refused { reason })?;
        self.checks.push(Box::new(rule));
        Ok(self)
    }

    /// Declares that some values follow from others: worked out now and with every change.
    pub fn derive(
        &mut self,
        rule: impl Fn(&ParameterValues) -> Vec<(&'static str, ParameterValue)> + Send + 'static,
    ) {
        self.values.0.extend(rule(&self.values));
        self.derive = Some(Box::new(rule));
    }

    /// Adds a listener that hears of a change after all checks and before it holds, with the values
    /// as they will be, and may still refuse it with a reason. It is called under the lock of the
    /// set, so it must not lock the set itself.
    pub fn on_change(
        &mut self,
        hook: impl FnMut(&[(&str, ParameterValue)], &ParameterValues) -> Result<(), String>
        + Send
        + 'static,
    ) {
        self.on_change.push(Box::new(hook));
    }

    /// Sets one parameter.
    pub fn set(&mut self, name: &str, value: ParameterValue) -> Result<(), ParameterError> {
        self.set_atomically(&[(name.to_owned(), value)])
    }

    /// Sets all of the parameters or, when one of them is refused, none. Of several values of one
    /// name the last holds. A value that holds already is no change, of a read-only parameter too:
    /// so a dump of the node can be loaded back.
    pub fn set_atomically(
        &mut self,
        changes: &[(String, ParameterValue)],
    ) -> Result<(), ParameterError> {
        let mut proposed = self.values.clone();
        let mut accepted: Vec<(&str, ParameterValue)> = Vec::with_capacity(changes.len());
        let mut kept = Vec::new();
        for (name, value) in changes {
            let spec = self.spec(name)?;
            if *value == ParameterValue::NotSet {
                return Err(ParameterError::Deleted { name: spec.name });
            }
            spec.check(value)?;
            let changed_before = accepted.iter().any(|(earlier, _)| *earlier == spec.name);
            if !changed_before && self.values.get(name) == Some(value) {
                kept.push((spec.name, value));
                continue;
            }
            if spec.read_only {
                let current = self.values.get(name).map(show).unwrap_or_default();
                return Err(ParameterError::ReadOnly {
                    name: spec.name,
                    current,
                    asked: show(value),
                });
            }
            proposed.0.insert(spec.name, value.clone());
            accepted.retain(|(earlier, _)| *earlier != spec.name);
            accepted.push((spec.name, value.clone()));
        }
        if accepted.is_empty() {
            return Ok(());
        }
        let refused = |reason| ParameterError::Refused { reason };
        self.checks.iter().try_for_each(|rule| rule(&proposed)).map_err(refused)?;
        if let Some(rule) = &self.derive {
            let derived = rule(&proposed);
            proposed.0.extend(derived);
        }
        if let Some((name, value)) =
            kept.iter().find(|(name, value)| proposed.get(name) != Some(*value))
        {
            let reason = format!(
                "{name} is {} and cannot stay so: it follows from what is set with it",
                show(value)
            );
            return Err(refused(reason));
        }
        self.on_change
            .iter_mut()
            .try_for_each(|hook| hook(&accepted, &proposed))
            .map_err(refused)?;
        self.values = proposed;
        Ok(())
    }

    /// The declarations, sorted by name.
    pub fn specs(&self) -> &[ParameterSpec] {
        &self.specs
    }

    fn spec(&self, name: &str) -> Result<&ParameterSpec, ParameterError> {
        self.specs.iter().find(|spec| spec.name == name).ok_or_else(|| ParameterError::Unknown {
            name: name.to_owned(),
            hint: nearest(name, self.specs.iter().map(|spec| spec.name)),
            known: self.specs.iter().map(|spec| spec.name).collect::<Vec<_>>().join(", "),
        })
    }

    /// Names below the prefixes, at most `depth` levels deep (0: any), with the prefixes met; as
    /// rclcpp lists them.
    fn list(&self, prefixes: &[String], depth: u64) -> rcl_interfaces::ListParametersResult {
        let levels = |name: &str| name.matches('.').count() as u64;
        let shallow = |name: &str| depth == 0 || levels(name) < depth;
        let below = |name: &str, prefix: &str| {
            name == prefix
                || name
                    .strip_prefix(prefix)
                    .and_then(|rest| rest.strip_prefix('.'))
                    .is_some_and(shallow)
        };
        let mut found =
            rcl_interfaces::ListParametersResult { names: Vec::new(), prefixes: Vec::new() };
        for spec in &self.specs {
            let name = spec.name;
            let wanted = if prefixes.is_empty() {
                shallow(name)
            } else {
                prefixes.iter().any(|p| below(name, p))
            };
            if !wanted {
                continue;
            }
            found.names.push(name.to_owned());
            if let Some((prefix, _)) = name.rsplit_once('.')
                && !found.prefixes.iter().any(|known| known == prefix)
            {
                found.prefixes.push(prefix.to_owned());
            }
        }
        found
    }

    fn describe(&self, name: &str) -> raw::ParameterDescriptor {
        match self.spec(name) {
            Ok(spec) => spec.descriptor(),
            Err(error) => raw::ParameterDescriptor {
                name: name.to_owned(),
                r#type: raw::ParameterType::NOT_SET,
                description: error.to_string(),
                additional_constraints: String::new(),
                read_only: true,
                dynamic_typing: false,
                floating_point_range: Vec::new(),
                integer_range: Vec::new(),
            },
        }
    }
}

services! { "rcl_interfaces":
    ListParameters(rcl_interfaces::ListParametersRequest) -> rcl_interfaces::ListParametersResponse,
    GetParameters(rcl_interfaces::GetParametersRequest) -> rcl_interfaces::GetParametersResponse,
    GetParameterTypes(rcl_interfaces::GetParameterTypesRequest)
        -> rcl_interfaces::GetParameterTypesResponse,
    DescribeParameters(rcl_interfaces::DescribeParametersRequest)
        -> rcl_interfaces::DescribeParametersResponse,
    SetParameters(rcl_interfaces::SetParametersRequest) -> rcl_interfaces::SetParametersResponse,
    SetParametersAtomically(rcl_interfaces::SetParametersRequest)
        -> rcl_interfaces::SetParametersAtomicallyResponse,
}

/// The six parameter services of a node, and its `/parameter_events`.
///
/// The node must have been made with `NodeOptions::start_parameter_services(false)`, or its Spinner
/// serves the same six names with ros2-client's own parameters.
pub struct ParameterServer {
    services: futures::future::BoxFuture<'static, ()>,
}

impl ParameterServer {
    /// Opens the services. They answer while [`run`](Self::run) runs.
    pub fn new(
        participant: &Participant,
        set: Arc<Mutex<ParameterSet>>,
    ) -> Result<Self, ServiceError> {
        let full_name = participant.node().fully_qualified_name();
        let name = |service: &str| format!("{full_name}/{service}");
        let events = Arc::new(Events::new(&mut participant.node())?);
        events.publish_new(&set);

        let list =
            service::serve::<ListParameters, _, _>(participant, &name("list_parameters"), {
                let set = set.clone();
                move |request| {
                    let result = locked(&set).list(&request.prefixes, request.depth);
                    std::future::ready(rcl_interfaces::ListParametersResponse { result })
                }
            })?;
        let get = service::serve::<GetParameters, _, _>(participant, &name("get_parameters"), {
            let set = set.clone();
            move |request| {
                let set = locked(&set);
                let value =
                    |name: &String| set.get(name).cloned().unwrap_or(ParameterValue::NotSet).into();
                std::future::ready(rcl_interfaces::GetParametersResponse {
                    values: request.names.iter().map(value).collect(),
                })
            }
        })?;
        let types = service::serve::<GetParameterTypes, _, _>(
            participant,
            &name("get_parameter_types"),
            {
                let set = set.clone();
                move |request| {
                    let set = locked(&set);
                    let kind = |name: &String| {
                        set.get(name).map_or(
                            raw::ParameterType::NOT_SET,
                            ParameterValue::to_parameter_type_raw,
                        )
                    };
                    std::future::ready(rcl_interfaces::GetParameterTypesResponse {
                        values: request.names.iter().map(kind).collect(),
                    })
                }
            },
        )?;
        let describe = service::serve::<DescribeParameters, _, _>(
            participant,
            &name("describe_parameters"),
            {
                let set = set.clone();
                move |request| {
                    let set = locked(&set);
                    std::future::ready(rcl_interfaces::DescribeParametersResponse {
                        values: request.names.iter().map(|name| set.describe(name)).collect(),
                    })
                }
            },
        )?;
        let set_each =
            service::serve::<SetParameters, _, _>(participant, &name("set_parameters"), {
                let (set, events) = (set.clone(), events.clone());
                move |request| {
                    let one_by_one = request
                        .parameter
                        .into_iter()
                        .map(|one| events.apply(&set, vec![one]))
                        .collect();
                    std::future::ready(rcl_interfaces::SetParametersResponse {
                        results: one_by_one,
                    })
                }
            })?;
        let set_all = service::serve::<SetParametersAtomically, _, _>(
            participant,
            &name("set_parameters_atomically"),
            {
                move |request| {
                    let result = events.apply(&set, request.parameter);
                    std::future::ready(rcl_interfaces::SetParametersAtomicallyResponse { result })
                }
            },
        )?;
        let services = Box::pin(async move {
            futures::join!(list, get, types, describe, set_each, set_all);
        });
        Ok(Self { services })
    }

    /// Answers requests for as long as it is polled.
    pub async fn run(self) {
        self.services.await;
    }
}

/// The set, also after a hook panicked under the lock: values are replaced in one step, so they are
/// whole.
fn locked(set: &Mutex<ParameterSet>) -> std::sync::MutexGuard<'_, ParameterSet> {
    set.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Tells everybody on `/parameter_events` what changed, stamped with the system time.
struct Events {
    publisher: Publisher<raw::ParameterEvent>,
    node: String,
}

impl Events {
    fn new(node: &mut Node) -> Result<Self, ServiceError> {
        const TOPIC: &str = "/parameter_events";
        // rmw_qos_profile_parameter_events. Fail: a frozen listener must not hold up the services.
        let qos = QosProfile::publisher_default()
            .reliability_reliable(WhenFull::Fail)
            .durability(Durability::Volatile)
            .history(History::KeepLast { depth: 1000 });
        let open = |node: &mut Node| {
            let name = Name::new("/", "parameter_events").map_err(|source| source.to_string())?;
            let kind = MessageTypeName::new("rcl_interfaces", "ParameterEvent");
            let topic =
                node.create_topic(&name, kind, &qos).map_err(|source| source.to_string())?;
            node.create_publisher(&topic, None).map_err(|source| source.to_string())
        };
        let publisher = open(node)
            .map_err(|problem| ServiceError::Create { name: TOPIC.to_owned(), problem })?;
        Ok(Self { publisher, node: node.fully_qualified_name() })
    }

    /// Sets the parameters together, publishes the change, and says how it went.
    fn apply(
        &self,
        set: &Mutex<ParameterSet>,
        parameters: Vec<raw::Parameter>,
    ) -> raw::SetParametersResult {
        let changes: Vec<(String, ParameterValue)> =
            parameters.iter().map(|one| (one.name.clone(), one.value.clone().into())).collect();
        let outcome = locked(set).set_atomically(&changes);
        match outcome {
            Ok(()) => {
                self.publish(Vec::new(), parameters);
                raw::SetParametersResult { successful: true, reason: String::new() }
            }
            Err(error) => raw::SetParametersResult { successful: false, reason: error.to_string() },
        }
    }

    fn publish_new(&self, set: &Mutex<ParameterSet>) {
        let parameter = |(name, value): (&str, &ParameterValue)| raw::Parameter {
            name: name.to_owned(),
            value: value.clone().into(),
        };
        let all = locked(set).iter().map(parameter).collect();
        self.publish(all, Vec::new());
    }

    fn publish(&self, new: Vec<raw::Parameter>, changed: Vec<raw::Parameter>) {
        if new.is_empty() && changed.is_empty() {
            return;
        }
        let event = raw::ParameterEvent {
            stamp: Time::now(),
            node: self.node.clone(),
            new_parameters: new,
            changed_parameters: changed,
            deleted_parameters: Vec::new(),
        };
        if let Err(error) = self.publisher.publish(event) {
            tracing::warn!("{}: a parameter event was not sent: {error}", self.node);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    fn specs() -> Vec<ParameterSpec> {
        vec![
            ParameterSpec::double("control_rate", 4000.0, "rate of the controller")
                .unit("Hz")
                .range(1.0, 1e5),
            ParameterSpec::double("physics_rate", 40000.0, "rate of the integration")
                .unit("Hz")
                .range(1.0, 1e6),
            ParameterSpec::string("mode", "realtime", "timing").choices(&["realtime", "lockstep"]),
            ParameterSpec::string("record", "", "directory"),
            ParameterSpec::integer("every", 1, "publish every Nth sample").range(1.0, 100.0),
            ParameterSpec::integer("seed", 1, "seed of the noise").read_only(),
            ParameterSpec::double("gains.stage.p", 0.0, "gain").unit("N/m"),
            ParameterSpec::double("gains.stage.u_clamp_max", f64::INFINITY, "limit")
                .unit("N")
                .range(0.0, f64::INFINITY),
            ParameterSpec::double("lowpass.damping", 0.7, "damping ratio"),
        ]
    }

    fn with(overrides: &[(&str, ParameterValue)]) -> Result<ParameterSet, ParameterError> {
        let overrides = overrides.iter().map(|(name, value)| {
            (
                name.to_string(),
                Override { value: value.clone(), origin: format!("-p {name}:={}", show(value)) },
            )
        });
        ParameterSet::declare(specs(), &overrides.collect())
    }

    fn set() -> ParameterSet {
        with(&[]).unwrap()
    }

    fn changes(changes: &[(&str, ParameterValue)]) -> Vec<(String, ParameterValue)> {
        changes.iter().map(|(name, value)| (name.to_string(), value.clone())).collect()
    }

    fn strings(all: &[&str]) -> Vec<String> {
        all.iter().map(|one| one.to_string()).collect()
    }

    #[test]
    fn overrides_replace_defaults() {
        let set = with(&[
            ("every", ParameterValue::Integer(5)),
            (USE_SIM_TIME, ParameterValue::Boolean(true)),
        ])
        .unwrap();
        assert_eq!((set.integer("every"), set.boolean(USE_SIM_TIME)), (5, true));
        assert_eq!((set.double("control_rate"), set.string("mode").as_str()), (4000.0, "realtime"));
    }

    #[test]
    fn a_wrong_value_is_refused_at_start_and_at_run_time_alike() {
        let double = ParameterValue::Double;
        let text = |text: &str| ParameterValue::String(text.to_owned());
        for (name, value, parts) in [
            (
                "contrl_rate",
                double(1.0),
                &["unknown parameter `contrl_rate`", "did you mean `control_rate`?"][..],
            ),
            ("xyzzy", double(1.0), &["unknown", "the node has control_rate, every"]),
            (
                "control_rate",
                ParameterValue::Integer(1000),
                &["type double", "the integer 1000", "write 1000.0"],
            ),
            ("record", ParameterValue::Integer(12), &["type string", "the integer 12", "'12'"]),
            ("every", double(2.0), &["type integer", "the double 2.0"]),
            ("control_rate", double(0.5), &["0.5 Hz", "within 1 and 100000 Hz"]),
            ("control_rate", double(f64::NAN), &["finite", "NaN Hz"]),
            ("gains.stage.p", double(f64::INFINITY), &["finite", "inf N/m"]),
            ("gains.stage.u_clamp_max", double(f64::NAN), &["finite", "NaN N"]),
            ("every", ParameterValue::Integer(101), &["101", "within 1 and 100"]),
            (
                "mode",
                text("lokstep"),
                &["`lokstep`", "did you mean `lockstep`?", "realtime, lockstep"],
            ),
        ] {
            let at_start = with(&[(name, value.clone())]).err().expect(name).to_string();
            let mut running = set();
            let at_run_time = running.set(name, value.clone()).expect_err(name).to_string();
            assert_eq!(at_start, format!("-p {name}:={}: {at_run_time}", show(&value)));
            for part in parts {
                assert!(at_run_time.contains(part), "`{at_run_time}` does not say `{part}`");
            }
            assert_eq!(running.get("control_rate"), Some(&double(4000.0)));
        }
    }

    #[test]
    fn infinity_is_a_value_where_the_range_reaches_it() {
        let mut set = set();
        set.set("gains.stage.u_clamp_max", ParameterValue::Double(300.0)).unwrap();
        set.set("gains.stage.u_clamp_max", ParameterValue::Double(f64::INFINITY)).unwrap();
        assert_eq!(set.double("gains.stage.u_clamp_max"), f64::INFINITY);
        let refused = set
            .set("gains.stage.u_clamp_max", ParameterValue::Double(f64::NEG_INFINITY))
            .unwrap_err();
        assert!(refused.to_string().contains("-inf N, must lie within 0 and inf N"), "{refused}");
    }

    #[test]
    fn read_only_parameters_are_set_at_start_only() {
        let mut set = with(&[("seed", ParameterValue::Integer(7))]).unwrap();
        let refused = set.set("seed", ParameterValue::Integer(8)).unwrap_err().to_string();
        assert_eq!(
            refused,
            "parameter `seed` is read-only and keeps 7; give it at start: -p seed:=8"
        );
        assert_eq!(set.integer("seed"), 7);
    }

    #[test]
    fn what_holds_already_can_be_set_again_read_only_too() {
        let mut set = with(&[("seed", ParameterValue::Integer(7))]).unwrap();
        let heard = std::sync::Arc::new(std::sync::atomic::AtomicUsize::new(0));
        let counted = heard.clone();
        set.on_change(move |_, _| {
            counted.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            Ok(())
        });
        let all: Vec<(String, ParameterValue)> = set
            .specs()
            .iter()
            .filter_map(|spec| Some((spec.name.to_owned(), set.values.get(spec.name)?.clone())))
            .collect();
        set.set_atomically(&all).unwrap();
        assert_eq!(heard.load(std::sync::atomic::Ordering::Relaxed), 0);
        // Of another type it is another value.
        set.set("seed", ParameterValue::Double(7.0)).unwrap_err();
    }

    #[test]
    fn a_declared_parameter_cannot_be_deleted() {
        let refused = set().set("every", ParameterValue::NotSet).unwrap_err();
        assert!(matches!(refused, ParameterError::Deleted { name: "every" }));
    }

    #[test]
    fn an_atomic_change_is_taken_whole_or_not_at_all() {
        let mut set = set();
        let both = |rate| {
            changes(&[
                ("every", ParameterValue::Integer(2)),
                ("control_rate", ParameterValue::Double(rate)),
            ])
        };
        set.set_atomically(&both(-1.0)).unwrap_err();
        assert_eq!((set.integer("every"), set.double("control_rate")), (1, 4000.0));
        set.set_atomically(&both(2000.0)).unwrap();
        assert_eq!((set.integer("every"), set.double("control_rate")), (2, 2000.0));
        set.set_atomically(&changes(&[
            ("every", ParameterValue::Integer(3)),
            ("every", ParameterValue::Integer(4)),
        ]))
        .unwrap();
        assert_eq!(set.integer("every"), 4);
    }

    fn multiple(values: &ParameterValues) -> Result<(), String> {
        let (physics, control) = (values.double("physics_rate"), values.double("control_rate"));
        if physics % control == 0.0 {
            Ok(())
        } else {
            Err(format!("{physics} is no multiple of {control}"))
        }
    }

    #[test]
    fn a_check_sees_the_values_as_they_would_become() {
        let mut set = set().check(multiple).unwrap();
        let refused = set.set("control_rate", ParameterValue::Double(3000.0)).unwrap_err();
        assert_eq!(refused.to_string(), "40000 is no multiple of 3000");
        set.set_atomically(&changes(&[
            ("control_rate", ParameterValue::Double(3000.0)),
            ("physics_rate", ParameterValue::Double(30000.0)),
        ]))
        .unwrap();
        assert_eq!(set.double("control_rate"), 3000.0);
    }

    #[test]
    fn a_check_must_hold_at_start() {
        let refused = with(&[("control_rate", ParameterValue::Double(3000.0))])
            .unwrap()
            .check(multiple)
            .err();
        assert!(matches!(refused, Some(ParameterError::Refused { .. })));
    }

    #[test]
    fn a_listener_hears_only_what_passed_and_may_refuse_it() {
        let heard = Arc::new(AtomicUsize::new(0));
        let mut set = set().check(multiple).unwrap();
        set.on_change({
            let heard = heard.clone();
            move |changes, _| {
                heard.fetch_add(1, Ordering::Relaxed);
                match changes {
                    [("every", ParameterValue::Integer(13))] => Err("not 13".to_owned()),
                    _ => Ok(()),
                }
            }
        });
        set.set("control_rate", ParameterValue::Double(3000.0)).unwrap_err();
        set.set("every", ParameterValue::Integer(0)).unwrap_err();
        assert_eq!(heard.load(Ordering::Relaxed), 0);
        assert_eq!(
            set.set("every", ParameterValue::Integer(13)).unwrap_err().to_string(),
            "not 13"
        );
        assert_eq!((heard.load(Ordering::Relaxed), set.integer("every")), (1, 1));
        set.set("every", ParameterValue::Integer(14)).unwrap();
        assert_eq!((heard.load(Ordering::Relaxed), set.integer("every")), (2, 14));
    }

    #[test]
    fn listing_follows_prefixes_and_depth() {
        let set = set();
        assert_eq!(set.list(&[], 0).names.len(), 10);
        assert_eq!(set.list(&[], 0).prefixes, ["gains.stage", "lowpass"]);
        assert_eq!(
            set.list(&[], 1).names,
            ["control_rate", "every", "mode", "physics_rate", "record", "seed", USE_SIM_TIME]
        );
        assert_eq!(
            set.list(&strings(&["gains"]), 0).names,
            ["gains.stage.p", "gains.stage.u_clamp_max"]
        );
        assert!(set.list(&strings(&["gains"]), 1).names.is_empty());
        assert_eq!(set.list(&strings(&["gains.stage"]), 1).names.len(), 2);
        assert_eq!(set.list(&strings(&["lowpass.damping", "ever"]), 0).names, ["lowpass.damping"]);
    }

    #[test]
    fn descriptors_say_what_was_declared() {
        let set = set();
        let rate = set.describe("control_rate");
        assert_eq!(
            (rate.description.as_str(), rate.r#type),
            ("rate of the controller [Hz]", raw::ParameterType::DOUBLE)
        );
        assert_eq!(
            (rate.floating_point_range[0].from_value, rate.floating_point_range[0].to_value),
            (1.0, 1e5)
        );
        assert!(rate.integer_range.is_empty() && !rate.read_only);
        assert_eq!(set.describe("every").integer_range[0].to_value, 100);
        assert_eq!(set.describe("mode").additional_constraints, "one of: realtime, lockstep");
        assert!(set.describe("seed").read_only);
        assert_eq!(set.describe("sed").r#type, raw::ParameterType::NOT_SET);
    }

    #[test]
    fn a_default_outside_of_its_own_range_is_refused() {
        let wrong =
            vec![ParameterSpec::integer("every", 0, "publish every Nth sample").range(1.0, 100.0)];
        let refused = ParameterSet::declare(wrong, &BTreeMap::new()).err();
        assert!(matches!(refused, Some(ParameterError::OutOfRange { name: "every", .. })));
    }
}
