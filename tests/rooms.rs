//! Data goes one way: a room uses only the rooms below it, and the pure rooms touch neither clock nor file.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Rooms and the rooms that each may use.
const ALLOWED: &[(&str, &[&str])] = &[
    ("model", &[]),
    ("message", &[]),
    ("plant", &["model"]),
    ("control", &["model", "plant"]),
    ("lab", &["model", "plant", "control"]),
    ("bag", &["model", "message"]),
    ("identify", &["model", "plant", "control", "bag"]),
    ("report", &[]),
    ("node", &["model", "message", "plant", "control", "lab", "bag"]),
    ("cli", &["model", "message", "plant", "control", "lab", "bag", "identify", "report", "node"]),
    ("bin", &["cli", "node"]),
];

/// Rooms that compute and nothing else.
const PURE: &[&str] = &["plant", "control", "lab", "identify", "report"];
/// What a pure room does not do: read clocks, files, the environment, or start threads.
const IMPURE: &[&str] = &[
    "std::time::Instant",
    "SystemTime",
    "std::fs",
    "std::env",
    "std::net",
    "std::thread",
    "tokio",
    "thread_rng",
    "rand::rng(",
];

fn sources(directory: &Path) -> Vec<PathBuf> {
    std::fs::read_dir(directory)
        .unwrap()
        .flat_map(|entry| {
            let path = entry.unwrap().path();
            if path.is_dir() { sources(&path) } else { vec![path] }
        })
        .filter(|path| path.extension().is_some_and(|extension| extension == "rs"))
        .collect()
}

/// Code of each source file without comments, by room.
fn rooms() -> BTreeMap<String, Vec<(PathBuf, String)>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut rooms: BTreeMap<String, Vec<(PathBuf, String)>> = BTreeMap::new();
    for path in sources(&root) {
        let Some(room) = path.strip_prefix(&root).unwrap().parent().and_then(|parent| parent.iter().next()) else {
            continue;
        };
        let text = std::fs::read_to_string(&path).unwrap();
        let code: Vec<&str> = text.lines().filter(|line| !line.trim_start().starts_with("//")).collect();
        rooms.entry(room.to_str().unwrap().to_owned()).or_default().push((path, code.join("\n")));
    }
    rooms
}

#[test]
fn every_room_uses_only_the_rooms_below_it() {
    let rooms = rooms();
    let known: Vec<&str> = ALLOWED.iter().map(|(room, _)| *room).collect();
    assert_eq!(rooms.keys().map(String::as_str).filter(|room| !known.contains(room)).count(), 0, "{:?}", rooms.keys());
    for (room, allowed) in ALLOWED {
        for (path, code) in &rooms[*room] {
            for other in known.iter().filter(|other| *other != room && !allowed.contains(other)) {
                for prefix in ["crate", "friction_stage"] {
                    let used = format!("{prefix}::{other}::");
                    assert!(!code.contains(&used), "{} uses {used}, which {room} must not", path.display());
                }
            }
        }
    }
}

#[test]
fn pure_rooms_read_no_clock_and_no_file() {
    let rooms = rooms();
    for room in PURE {
        for (path, code) in &rooms[*room] {
            for word in IMPURE {
                assert!(!code.contains(word), "{} uses {word}", path.display());
            }
        }
    }
}

#[test]
fn only_the_node_room_knows_the_dds_library() {
    for (room, files) in rooms() {
        for (path, code) in files {
            let knows = code.contains("ros2_client::") || code.contains("rustdds::");
            assert!(!knows || room == "node", "{} uses the DDS library", path.display());
        }
    }
}
