//! Definitions of message types by name, for recordings that lack them.
//!
//! Our own messages come from their structs; of the common interfaces the fields are listed in
//! `common_types.txt`.

use std::collections::BTreeSet;

use super::type_layout::Sameness;
use super::*;

const COMMON: &str = include_str!("common_types.txt");
/// What stands before each type in [`COMMON`].
const BEGIN: &str = "MSG: ";

/// Own types, with their texts.
const OWN: [Definition; 2] = [Definition::of::<StageState>(), Definition::of::<ControllerState>()];

/// The fields of the type `package/Name`; its parts have definitions of their own.
pub(crate) fn fields(name: &str) -> Option<&'static str> {
    let name = current_type_name(name);
    let own = OWN.iter().find(|own| name.split_once('/') == Some((own.package, own.name)));
    own.map(|own| own.text).or_else(|| {
        let sections = COMMON.split(BEGIN).skip(1);
        let mut named = sections.filter_map(|section| section.split_once('\n'));
        let (_, text) = named.find(|(found, _)| *found == name.as_ref())?;
        Some(text.split_once("\n==").map_or(text, |(text, _)| text))
    })
}

/// The text that a bag stores for the type `package/Name`: its fields and those of its parts.
pub(crate) fn definition(name: &str) -> Option<String> {
    let mut text = fields(name)?.trim_end().to_owned() + "\n";
    let mut parts = vec![name.to_owned()];
    let mut at = 0;
    while let Some(part) = parts.get(at).cloned() {
        at += 1;
        let package = part.split('/').next().unwrap_or("");
        for line in fields(&part).unwrap_or("").lines() {
            let kind = line.split_whitespace().next().unwrap_or("").split('[').next();
            let kind = kind.unwrap_or("");
            let names = [kind.to_owned(), format!("{package}/{kind}")];
            let Some(name) = names.into_iter().find(|name| fields(name).is_some()) else {
                continue;
            };
            if !parts.contains(&name) {
                let fields = fields(&name).unwrap_or("").trim_end();
                text += &format!("{}\nMSG: {name}\n{fields}\n", "=".repeat(80));
                parts.push(name);
            }
        }
    }
    Some(text)
}

/// The definition that a recording should have for the type `package/msg/Name`, where it is known
/// and the stored one is damaged: it cannot be read, lacks parts, or calls fields of the same
/// layout by other names. A readable one of another layout is another version of the type.
pub(crate) fn mended(type_name: &str, encoding: &str, stored: &[u8]) -> Option<String> {
    let (package, name) = type_name.split_once("/msg/")?;
    let known = definition(&format!("{package}/{name}"))?;
    if encoding == "ros2idl" {
        return None;
    }
    let parts = |text: &str| -> BTreeSet<String> {
        let names = text.lines().filter_map(|line| line.strip_prefix(BEGIN));
        names.map(|name| full_name(name.trim())).collect()
    };
    let is_whole = || {
        let text = std::str::from_utf8(stored).ok()?;
        let layout = type_layout::TypeLayout::parse(type_name, text).ok()?;
        let own = type_layout::TypeLayout::parse(type_name, &known).ok()?;
        Some(match own.compared(&layout) {
            Sameness::Same => parts(text).is_superset(&parts(&known)),
            Sameness::OtherNames => false,
            Sameness::Different => true,
        })
    };
    let is_damaged = encoding != "ros2msg" || !is_whole().unwrap_or(false);
    is_damaged.then_some(known)
}

/// Names of all known types, as `package/Name`.
pub(crate) fn names() -> impl Iterator<Item = String> {
    let own = OWN.iter().map(|own| format!("{}/{}", own.package, own.name));
    let common = COMMON.lines().filter_map(|line| line.strip_prefix(BEGIN));
    own.chain(common.map(str::to_owned))
}

/// `package/msg/Name` for any way in which a name of a type is written.
pub(crate) fn full_name(name: &str) -> String {
    match name.split_once('/') {
        Some((package, name)) if !name.contains('/') => format!("{package}/msg/{name}"),
        _ => name.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::type_layout::TypeLayout;
    use super::*;

    fn same_layout<M: RosMessage>() {
        let layout = |text: &str| TypeLayout::parse(&M::type_name(), text).unwrap().flat();
        let name = format!("{}/{}", M::PACKAGE, M::NAME);
        assert_eq!(layout(""), layout(&M::definition()), "{name}");
        assert_eq!(layout(&definition(&name).unwrap()), layout(&M::definition()), "{name}");
    }

    #[test]
    fn every_known_type_is_whole() {
        assert!(names().count() > 80);
        for name in names() {
            let layout = TypeLayout::parse(&full_name(&name), "");
            assert!(layout.is_ok(), "{name}: {layout:?}");
        }
    }

    #[test]
    fn damaged_definitions_of_known_types_are_mended_and_other_versions_kept() {
        let name = JointState::type_name();
        let whole = definition("sensor_msgs/JointState").unwrap();
        assert_eq!(mended(&name, "ros2msg", whole.as_bytes()), None);
        assert_eq!(mended(&name, "ros2msg", JointState::definition().as_bytes()), None);
        let commented = format!("# as of old\n{}", JointState::definition());
        assert_eq!(mended(&name, "ros2msg", commented.as_bytes()), None);
        let without_parts = JointState::definition().split("===").next().unwrap().to_owned();
        for damaged in [
            whole.replace("position", "posit\u{1}on"),
            whole.replace("position", "positiom"),
            whole.replace("float64[] effort", "float64] effort"),
            whole.replace("nanosec", "nano\u{0}ec"),
            without_parts,
            whole.replace("MSG: std_msgs/Header", "MSG: std_msgs/Hxader"),
            String::new(),
        ] {
            assert_eq!(mended(&name, "ros2msg", damaged.as_bytes()), Some(whole.clone()));
        }
        let not_utf_8 = [whole.as_bytes(), &[0xff]].concat();
        assert_eq!(mended(&name, "ros2msg", &not_utf_8), Some(whole.clone()));
        assert_eq!(mended(&name, "ros2nsg", whole.as_bytes()), Some(whole.clone()));
        let other_version = whole.replace("float64[] effort", "float32[] effort");
        assert_eq!(mended(&name, "ros2msg", other_version.as_bytes()), None);
        assert_eq!(mended("own/msg/Type", "ros2msg", b"float64] x"), None);
    }

    #[test]
    fn own_types_are_known_by_their_former_name() {
        assert!(fields("friction_stage/StageState").is_some());
        assert_eq!(definition("friction_stage/StageState"), {
            definition("friction_stage_msgs/StageState")
        });
    }

    #[test]
    fn types_with_a_struct_have_its_layout() {
        same_layout::<JointState>();
        same_layout::<WrenchStamped>();
        same_layout::<JointTrajectory>();
        same_layout::<Float64MultiArray>();
        same_layout::<DiagnosticArray>();
        same_layout::<Clock>();
        same_layout::<StageState>();
        same_layout::<ControllerState>();
    }
}
