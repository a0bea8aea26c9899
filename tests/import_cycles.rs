//! Files import only downwards: no cycle between the files of a room.
//!
//! Read are the paths that begin with `crate`, `super`, `self` or the name of a child module, in
//! `use` lines and elsewhere, outside of `#[cfg(test)]` modules. A path leads to the file of the
//! innermost module that it names, so that a child which takes an item from its parent while the
//! parent takes one from it counts as a cycle. Methods of a type that several files extend leave no
//! such path: they are not seen.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

type Imports = BTreeMap<String, BTreeSet<String>>;

#[test]
fn identification_imports_only_downwards() {
    assert_no_cycle("crates/friction-stage-identify/src", "");
}

#[test]
fn nodes_import_only_downwards() {
    assert_no_cycle("src", "node/");
}

#[test]
fn a_cycle_is_found_whatever_way_it_is_written() {
    let files = |second: &str| {
        BTreeMap::from([
            ("lib.rs".to_owned(), "mod a;\nmod b;\npub use a::A;\n".to_owned()),
            ("a/mod.rs".to_owned(), "use crate::b::{c::C, B as Other};\npub struct A;".to_owned()),
            ("b/mod.rs".to_owned(), "pub mod c;\npub struct B;".to_owned()),
            ("b/c.rs".to_owned(), second.to_owned()),
        ])
    };
    for second in [
        "use super::super::a::A;",
        "use crate::{\n    a::{A},\n};",
        "pub use crate::A;",
        "fn f(a: &crate::a::A) {}",
    ] {
        assert!(cycle(&imports(&files(second))).is_some(), "{second}");
    }
    for second in [
        "use friction_stage_core::a::A;",
        "// use crate::a::A;",
        "#[cfg(test)]\nmod tests {\n    use crate::a::A;\n}",
    ] {
        assert_eq!(cycle(&imports(&files(second))), None, "{second}");
    }
}

/// `below`: folder of the sources whose files are looked at.
fn assert_no_cycle(sources: &str, below: &str) {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join(sources);
    let mut files = BTreeMap::new();
    let mut folders = vec![root.clone()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("a folder of sources") {
            let path: PathBuf = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let name = path.strip_prefix(&root).expect("a file below").to_string_lossy();
                files.insert(name.into_owned(), fs::read_to_string(&path).expect("a source"));
            }
        }
    }
    let mut imports = imports(&files);
    imports.retain(|file, _| file.starts_with(below));
    assert!(imports.len() > 5, "{sources}/{below}: {} files", imports.len());
    if let Some(cycle) = cycle(&imports) {
        panic!("{sources}: {} import each other in a cycle", cycle.join(" -> "));
    }
}

/// For each file those that it imports from.
fn imports(files: &BTreeMap<String, String>) -> Imports {
    let modules: BTreeMap<Vec<&str>, &str> =
        files.keys().map(|file| (module_of(file), file.as_str())).collect();
    let of_file = |(file, text): (&String, &String)| {
        let own = module_of(file);
        let mut imported = BTreeSet::new();
        for path in paths(text) {
            let names: Vec<&str> = path.split("::").collect();
            let mut module = match names[0] {
                "crate" => Vec::new(),
                "super" => own[..own.len().saturating_sub(1)].to_vec(),
                "self" => own.clone(),
                child => [&own[..], &[child]].concat(),
            };
            if !modules.contains_key(&module) {
                continue;
            }
            for name in &names[1..] {
                if *name == "super" {
                    module.pop();
                } else if modules.contains_key(&[&module[..], &[name]].concat()) {
                    module.push(name);
                } else {
                    break;
                }
            }
            let target = modules[&module];
            if target != file {
                imported.insert(target.to_owned());
            }
        }
        (file.clone(), imported)
    };
    files.iter().map(of_file).collect()
}

fn module_of(file: &str) -> Vec<&str> {
    let stem = file.trim_end_matches(".rs");
    match stem.trim_end_matches("/mod") {
        "lib" | "main" => Vec::new(),
        stem => stem.split('/').collect(),
    }
}

/// Paths in a source, those of `use` with their braces resolved.
fn paths(text: &str) -> Vec<String> {
    let (mut found, mut rest) = (Vec::new(), String::new());
    let mut used: Option<String> = None;
    for line in text.split("#[cfg(test)]\nmod ").next().unwrap_or_default().lines() {
        let code = line.split("//").next().unwrap_or_default().trim();
        let begins = code
            .strip_prefix("use ")
            .or_else(|| {
                code.strip_prefix("pub").and_then(|code| code.split_once(" use ")).map(|at| at.1)
            })
            .or_else(|| code.strip_prefix("pub use "));
        match (&mut used, begins) {
            (Some(used), _) => used.push_str(code),
            (None, Some(code)) => used = Some(code.to_owned()),
            (None, None) => rest.push_str(&format!("{code}\n")),
        }
        if let Some(tree) = used.take_if(|used| used.ends_with(';')) {
            expand("", tree.trim_end_matches(';'), &mut found);
        }
    }
    let is_of_path = |c: char| c.is_alphanumeric() || c == '_' || c == ':';
    let inline = rest.split(|c| !is_of_path(c));
    found.extend(
        inline
            .filter(|path| ["crate::", "super::"].iter().any(|at| path.starts_with(at)))
            .map(str::to_owned),
    );
    found
}

/// The paths of a tree as `use` has it.
fn expand(before: &str, tree: &str, found: &mut Vec<String>) {
    let tree = tree.trim();
    let Some((head, inner)) = tree.split_once('{') else {
        let name = tree.split(" as ").next().unwrap_or_default();
        found.push(format!("{before}{name}"));
        return;
    };
    let inner = inner.strip_suffix('}').unwrap_or(inner);
    let (mut depth, mut from) = (0, 0);
    for (at, c) in inner.char_indices().chain([(inner.len(), ',')]) {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                if !inner[from..at].trim().is_empty() {
                    expand(&format!("{before}{head}"), &inner[from..at], found);
                }
                from = at + 1;
            }
            _ => {}
        }
    }
}

/// Files each of which imports from the next, and the last from the first.
fn cycle(imports: &Imports) -> Option<Vec<String>> {
    let mut left: Imports = imports.clone();
    loop {
        let within: BTreeSet<String> = left.keys().cloned().collect();
        let before = left.len();
        left.retain(|_, imported| imported.iter().any(|file| within.contains(file)));
        if left.len() == before {
            break;
        }
    }
    let mut way = vec![left.keys().next()?.clone()];
    loop {
        let next = left[way.last()?].iter().find(|file| left.contains_key(*file))?.clone();
        if let Some(start) = way.iter().position(|file| *file == next) {
            way.push(next);
            return Some(way.split_off(start));
        }
        way.push(next);
    }
}
