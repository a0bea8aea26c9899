//! An effect is one file: no other source of the workspace names it. The blind tests are apart:
//! they state each law a second time, on purpose.

use std::fs;
use std::path::{Path, PathBuf};

use friction_stage_core::plant::effects::ALL;

/// Rust files under a directory.
fn sources(directory: &Path, found: &mut Vec<PathBuf>) {
    let Ok(entries) = fs::read_dir(directory) else { return };
    for path in entries.map(|entry| entry.unwrap().path()) {
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

/// Lines of a source outside its test modules and comments, with their numbers. A module ends where
/// a line closes it at its own indentation.
fn code(text: &str) -> Vec<(usize, &str)> {
    let mut code = Vec::new();
    let mut lines = text.lines().enumerate().peekable();
    while let Some((number, line)) = lines.next() {
        let opens_module = |(_, next): &(usize, &str)| next.contains("mod ") && next.ends_with('{');
        if line.trim() == "#[cfg(test)]" && lines.peek().is_some_and(opens_module) {
            let end = format!("{}}}", &line[..line.len() - line.trim_start().len()]);
            lines.by_ref().find(|(_, line)| *line == end);
        } else if !line.trim_start().starts_with("//") {
            code.push((number + 1, line));
        }
    }
    code
}

#[test]
fn no_file_but_its_own_names_an_effect() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut all = Vec::new();
    sources(&root.join("src"), &mut all);
    for room in fs::read_dir(root.join("crates")).unwrap() {
        let room = room.unwrap();
        if room.file_name() != "blind-tests" {
            sources(&room.path().join("src"), &mut all);
        }
    }
    // All rooms were found: a search of nothing finds nothing.
    assert!(all.len() > 100, "{} files", all.len());
    let mut own = 0;
    let mut named = Vec::new();
    for path in &all {
        let text = fs::read_to_string(path).unwrap();
        for (number, line) in code(&text) {
            for effect in ALL.iter().filter(|effect| line.contains(&format!("\"{}\"", effect.name)))
            {
                let file = format!("effects/{}.rs", effect.name);
                if path.ends_with(&file) {
                    own += 1;
                } else {
                    named.push(format!("{}:{number}: {}", path.display(), line.trim()));
                }
            }
        }
    }
    assert!(own >= ALL.len(), "only {own} of {} name themselves", ALL.len());
    assert!(named.is_empty(), "{}", named.join("\n"));
}

#[test]
fn test_modules_and_comments_are_passed_over_and_what_follows_them_is_not() {
    let text = "a\n#[cfg(test)]\nmod tests {\n    fn b() {\n    }\n}\n// c\nd\n";
    assert_eq!(code(text), [(1, "a"), (8, "d")]);
}
