//! A model, a motion as keys and values: dotted paths to what a sweep changes.

use serde_json::{Map, Value};

use super::SweepValue;
use friction_stage_core::model::nearest;
use friction_stage_core::plant::effects::ALL;

/// A path that leads nowhere: what is wrong with it.
pub(super) type NoSuchKey = String;

/// Keys that a description may lack, with the place that they belong to.
const OPTIONAL: [(&str, &str); 2] =
    [("guides", "damping_velocity"), ("guides", "stribeck_exponent")];

/// Sets the value at a dotted path. All entries of `guides` are meant unless one is numbered;
/// `effects` are named, or numbered where two have one name.
pub(super) fn set(document: &mut Value, path: &str, value: &SweepValue) -> Result<(), NoSuchKey> {
    let parts: Vec<&str> = path.split('.').collect();
    let known = keys_like(document, &parts);
    let missing = || {
        let near = nearest(path, known.iter().map(String::as_str));
        if near.is_empty() { format!("; there are {}", known.join(", ")) } else { near }
    };
    let value = match value {
        SweepValue::Flag(flag) => Value::from(*flag),
        SweepValue::Number(number) => Value::from(*number),
        SweepValue::Text(text) => Value::from(text.as_str()),
    };
    if change(document, "", &parts, &value) { Ok(()) } else { Err(missing()) }
}

/// Changes what a path names; whether there is such a thing. `place` is the name of the list or the
/// effect that this is in.
fn change(node: &mut Value, place: &str, parts: &[&str], value: &Value) -> bool {
    let Some((part, rest)) = parts.split_first() else {
        return match node {
            // A name in the place of numbers: the catalogue's guide.
            Value::Object(_) if place == "guides" && value.is_string() => {
                *node = value.clone();
                true
            }
            Value::Array(all) if place == "guides" && value.is_string() => {
                all.fill(value.clone());
                true
            }
            Value::Object(_) | Value::Array(_) => false,
            _ => {
                *node = value.clone();
                true
            }
        };
    };
    match node {
        Value::Object(map) => {
            if !map.contains_key(*part) && rest.is_empty() && may_have(place, part) {
                map.insert((*part).to_owned(), Value::Null);
            }
            map.get_mut(*part).is_some_and(|inner| change(inner, part, rest, value))
        }
        Value::Array(all) => {
            if let Ok(index) = part.parse::<usize>() {
                return all.get_mut(index).is_some_and(|entry| {
                    match (place, single(entry)) {
                        // The effect of this number, whatever its name.
                        ("effects", Some((name, inner))) => change(inner, &name, rest, value),
                        _ => change(entry, place, rest, value),
                    }
                });
            }
            match place {
                "guides" => {
                    // Every one, also those after one that lacks it.
                    let mut found = true;
                    for entry in all {
                        found &= change(entry, place, parts, value);
                    }
                    found
                }
                "effects" => {
                    let mut named = all
                        .iter_mut()
                        .filter_map(single)
                        .filter(|(name, _)| name == part)
                        .map(|(_, inner)| inner);
                    match (named.next(), named.next()) {
                        (Some(inner), None) => change(inner, part, rest, value),
                        _ => false,
                    }
                }
                _ => false,
            }
        }
        _ => false,
    }
}

/// The only entry of a map.
fn single(entry: &mut Value) -> Option<(String, &mut Value)> {
    let map: &mut Map<String, Value> = entry.as_object_mut()?;
    let mut entries = map.iter_mut();
    let (name, inner) = entries.next()?;
    entries.next().is_none().then(|| (name.clone(), inner))
}

/// Whether a place may have a key that is not given.
fn may_have(place: &str, key: &str) -> bool {
    OPTIONAL.contains(&(place, key))
        || ALL.iter().any(|effect| {
            effect.name == place && effect.parameters.iter().any(|known| known.name == key)
        })
}

/// All paths to values, each kind once.
fn leaves(node: &Value, path: &str, all: &mut Vec<String>) {
    let under = |key: &str| match path {
        "" => key.to_owned(),
        _ => format!("{path}.{key}"),
    };
    match node {
        Value::Object(map) => map.iter().for_each(|(key, inner)| leaves(inner, &under(key), all)),
        Value::Array(entries) if path == "guides" => {
            entries.iter().take(1).for_each(|entry| leaves(entry, path, all));
        }
        Value::Array(entries) if path == "effects" => {
            entries.iter().for_each(|entry| leaves(entry, path, all));
        }
        Value::Array(entries) => {
            for (index, entry) in entries.iter().enumerate() {
                leaves(entry, &under(&index.to_string()), all);
            }
        }
        _ => all.push(path.to_owned()),
    }
}

/// All paths to values that a path may mean: those of one entry where it numbers one.
fn keys_like(document: &Value, parts: &[&str]) -> Vec<String> {
    let entry = || {
        let [list, number, ..] = parts else { return None };
        let entry = document.get(*list)?.get(number.parse::<usize>().ok()?)?;
        // An effect is a map of its name.
        let entry = match *list {
            "effects" => entry.as_object()?.values().next()?,
            _ => entry,
        };
        Some((entry, format!("{list}.{number}")))
    };
    match entry() {
        Some((entry, path)) => {
            let mut all = Vec::new();
            leaves(entry, &path, &mut all);
            all
        }
        None => keys(document),
    }
}

/// All paths to values of a description.
pub(super) fn keys(document: &Value) -> Vec<String> {
    let mut all = Vec::new();
    leaves(document, "", &mut all);
    all
}
