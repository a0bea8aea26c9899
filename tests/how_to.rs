//! The how-to pages are current: their commands run and print what stands there, and the code that
//! they quote is in the sources.

use std::path::{Path, PathBuf};
use std::process::Command;

/// A fenced block of a page.
struct Block {
    language: String,
    text: String,
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn blocks(page: &str) -> Vec<Block> {
    let text = std::fs::read_to_string(root().join("docs/how-to").join(page)).unwrap();
    let mut blocks = Vec::new();
    let mut open: Option<Block> = None;
    for line in text.lines() {
        match (line.strip_prefix("```"), open.take()) {
            (Some(_), Some(block)) => blocks.push(block),
            (Some(language), None) => {
                open = Some(Block { language: language.to_owned(), text: String::new() });
            }
            (None, Some(mut block)) => {
                block.text += line;
                block.text.push('\n');
                open = Some(block);
            }
            (None, None) => {}
        }
    }
    assert!(open.is_none(), "{page}: a block without an end");
    blocks
}

/// Runs the commands of friction-stage in a page, one after the other in one directory; what a
/// block of text after them says is printed by the last one, whatever the blanks.
fn runs_as_written(page: &str) {
    let home = tempfile::tempdir().unwrap();
    let (mut printed, mut commands, mut compared) = (String::new(), 0, 0);
    let words = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    for block in blocks(page) {
        match block.language.as_str() {
            "sh" => {
                for line in block.text.lines().filter(|line| line.starts_with("friction-stage ")) {
                    let arguments = line.split(" #").next().unwrap_or(line).split_whitespace();
                    let output = Command::new(env!("CARGO_BIN_EXE_friction-stage"))
                        .args(arguments.skip(1))
                        .current_dir(home.path())
                        .output()
                        .unwrap();
                    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
                    assert!(output.status.success(), "{page}: {line}\n{errors}");
                    printed = words(&String::from_utf8_lossy(&output.stdout));
                    commands += 1;
                }
            }
            "text" => {
                for line in block.text.lines() {
                    assert!(printed.contains(&words(line)), "{page}: no `{line}` in:\n{printed}");
                    compared += 1;
                }
            }
            _ => {}
        }
    }
    assert!(commands > 0 && compared > 0, "{page}: {commands} commands, {compared} lines");
}

#[test]
fn the_page_of_plotting_programs_runs() {
    runs_as_written("foxglove-and-plotjuggler.md");
}

#[test]
fn the_page_of_a_new_effect_runs_and_quotes_its_source() {
    runs_as_written("add-an-effect.md");
    let source: PathBuf =
        root().join("crates/friction-stage-core/src/plant/effects/quadratic_drag.rs");
    let source = std::fs::read_to_string(source).unwrap();
    let quotes: Vec<Block> =
        blocks("add-an-effect.md").into_iter().filter(|block| block.language == "rust").collect();
    assert!(quotes.len() >= 6);
    for quote in quotes {
        assert!(source.contains(&quote.text), "not in quadratic_drag.rs:\n{}", quote.text);
    }
}
