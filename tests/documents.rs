//! README and book: their commands run as they stand, and print what stands below them.
//!
//! A page is run block by block in a directory that has what a checkout has:
//!
//! - `yaml` whose first line is `# NAME.yaml` is a file of that name,
//! - `sh` is run by bash; a node runs until its block ends,
//! - `text` is what the block of commands before it printed, line by line, whatever the blanks,
//! - `console`, where each command follows a `$`, is not run; the reader learns that in
//!   `docs/index.md`.

use std::os::unix::fs::{PermissionsExt as _, symlink};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use friction_stage::node::domain::OwnDomain;

/// What bash knows before it runs a block. `cargo run` starts the programs that the tests were
/// built with; exit code 3 is a warning and ends no script.
const PREAMBLE: &str = r#"
set -euo pipefail
friction-stage() {
    local code=0
    command friction-stage "$@" || code=$?
    [ $code -ne 3 ] || { touch "$RUNS/warned"; code=0; }
    return $code
}
node() {
    local run
    run=$(mktemp --directory --tmpdir="$RUNS")
    (
        env "$@" >"$run/log" 2>&1 &
        echo $! >"$run/pid"
        code=0
        wait $! || code=$?
        echo $code >"$run/code"
    ) >/dev/null 2>&1 &
}
stage_node() { node stage_node "$@"; }
controller_node() { node controller_node "$@"; }
cargo() {
    local program=friction-stage
    [ "$1 $2" = 'run --release' ]
    shift 2
    [ "${1-}" != --bin ] || { program=$2; shift 2; }
    [ "${1-}" != -- ] || shift
    "$program" "$@"
}
"#;

/// Files that a page takes for granted, made by bash: for pages on files of others.
const GIVEN: &[(&str, &str)] = &[(
    "docs/how-to/recordings-of-others.md",
    r#"
friction-stage demo recordings --out made
mv made/train BAG
mv made/check humble_bag
mv made/declared.yaml my_stage.yaml
cat >bag.yaml <<'EOF'
signals:
  position: {topic: /stage/encoder, field: "position[joint]"}
  force: {topic: /stage/force, field: wrench.force.x}
  force_cell: {topic: /stage/force_cell, field: wrench.force.x}
EOF
# To and fro by 40 mm at a held speed.
capture() {
    awk -v speed="$1" -v seconds="$2" -v step="$3" 'BEGIN {
        print "t (ms),x (mm),F (N)"
        turn = 40 / speed
        for (k = 0; k < 1000 * seconds; k += step) {
            phase = k / 1000 % (2 * turn)
            sign = phase < turn ? 1 : -1
            x = sign > 0 ? speed * phase - 20 : 60 - speed * phase
            printf "%d,%.6f,%.4f\n", k, x, sign * (12 + 0.02 * speed)
        }
    }'
}
capture 20 10 1 >drive.csv
{ capture 10 10 1; capture 40 10 1 | tail -n +2; } >runs.csv
# Another clock and half of the rate.
awk -F, 'NR == 1 { print "Time (s),Cell (N)" }
         NR > 1 && NR % 2 { printf "%.4f,%s\n", $1 / 1000 + 0.0002, $3 }' drive.csv >cell.csv
capture 1 4000 10 >day.csv
cat >day.yaml <<'EOF'
signals:
  time: {column: "t (ms)", unit: ms}
  position: {column: "x (mm)", unit: mm}
  force: {column: "F (N)"}
EOF
"#,
)];

/// How long a node may take until it says that it runs, and until it has ended.
const PATIENCE: Duration = Duration::from_secs(60);

/// A fenced block of a page.
struct Block {
    language: String,
    text: String,
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn blocks(page: &str) -> Vec<Block> {
    let text = std::fs::read_to_string(root().join(page)).unwrap();
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
            (None, None) => assert!(!line.contains("```"), "{page}: a fence within a line: {line}"),
        }
    }
    assert!(open.is_none(), "{page}: a block without an end");
    blocks
}

/// A directory that has what a checkout has after `cargo build --release`, and the runs in it.
struct Checkout {
    home: tempfile::TempDir,
    /// Where the next block begins.
    here: PathBuf,
    domain: OwnDomain,
}

impl Checkout {
    fn new() -> Checkout {
        let home = tempfile::tempdir().unwrap();
        let here = home.path().join("checkout");
        let programs = here.join("target/release");
        for directory in [&programs, &home.path().join("runs"), &home.path().join("bin")] {
            std::fs::create_dir_all(directory).unwrap();
        }
        for name in ["launch_config", "package.xml"] {
            symlink(root().join(name), here.join(name)).unwrap();
        }
        // Commands write into the directory of an example.
        let copied = Command::new("cp").arg("-r").arg(root().join("examples")).arg(&here).status();
        assert!(copied.unwrap().success());
        for (name, path) in [
            ("friction-stage", env!("CARGO_BIN_EXE_friction-stage")),
            ("stage_node", env!("CARGO_BIN_EXE_stage_node")),
            ("controller_node", env!("CARGO_BIN_EXE_controller_node")),
        ] {
            symlink(path, programs.join(name)).unwrap();
        }
        // What opens a page on a desktop, here for `--open`.
        let opener = home.path().join("bin/xdg-open");
        std::fs::write(&opener, "#!/bin/sh\necho \"$1\" >\"$RUNS/opened\"\n").unwrap();
        std::fs::set_permissions(&opener, std::fs::Permissions::from_mode(0o755)).unwrap();
        Checkout { home, here, domain: OwnDomain::take().unwrap() }
    }

    fn runs(&self) -> PathBuf {
        self.home.path().join("runs")
    }

    /// Runs a block; its standard output.
    fn run(&mut self, page: &str, block: &str) -> String {
        let home = self.home.path();
        let after = self.runs().join("directory");
        let script = format!("{PREAMBLE}{block}\npwd >\"$RUNS/directory\"\n");
        let programs = home.join("checkout/target/release");
        let path = format!("{}:{}:/usr/bin:/bin", home.join("bin").display(), programs.display());
        let output = Command::new("bash")
            .args(["-c", &script])
            .current_dir(&self.here)
            .env("PATH", path)
            .env("HOME", home)
            .env("RUNS", self.runs())
            .env("ROS_DOMAIN_ID", self.domain.number().to_string())
            .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
            .output()
            .unwrap();
        let errors = String::from_utf8_lossy(&output.stderr);
        self.end_nodes(page);
        assert!(output.status.success(), "{page}: {}\n{block}\n{errors}", output.status);
        self.here = std::fs::read_to_string(after).unwrap().trim_end().into();
        String::from_utf8_lossy(&output.stdout).into_owned()
    }

    /// Ends the nodes of a block with Ctrl-C once they run.
    fn end_nodes(&self, page: &str) {
        let mut nodes: Vec<PathBuf> = std::fs::read_dir(self.runs()).unwrap().map(path).collect();
        nodes.retain(|path| path.is_dir());
        let read =
            |node: &Path, of: &str| std::fs::read_to_string(node.join(of)).unwrap_or_default();
        let mut running = true;
        for node in &nodes {
            // The stage says its rates, the controller what it controls.
            running &= awaited(|| {
                let said = read(node, "log");
                let runs = said.contains(" Hz control, ") || said.contains(" controls ");
                runs || !read(node, "code").is_empty()
            });
        }
        for node in &nodes {
            if read(node, "code").is_empty() {
                let pid: i32 = read(node, "pid").trim().parse().unwrap();
                // SAFETY: its parent has not seen its end, so that the number is its own.
                unsafe { libc::kill(pid, libc::SIGINT) };
            }
        }
        for node in &nodes {
            running &= awaited(|| !read(node, "code").is_empty());
            assert_eq!(read(node, "code").trim(), "0", "{page}: {}", read(node, "log"));
            std::fs::remove_dir_all(node).unwrap();
        }
        assert!(running, "{page}: a node does not come up or does not end");
    }
}

fn path(entry: std::io::Result<std::fs::DirEntry>) -> PathBuf {
    entry.unwrap().path()
}

/// Whether something happens in time.
fn awaited(happens: impl Fn() -> bool) -> bool {
    let end = Instant::now() + PATIENCE;
    while !happens() {
        if Instant::now() > end {
            return false;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    true
}

fn runs_as_written(page: &str) {
    let words = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    let mut checkout = Checkout::new();
    if let Some((_, script)) = GIVEN.iter().find(|(known, _)| *known == page) {
        checkout.run(page, script);
    }
    let (mut printed, mut commands) = (None, 0);
    for block in blocks(page) {
        match block.language.as_str() {
            "yaml" => {
                let first = block.text.lines().next().unwrap_or_default();
                if let Some(name) = first.strip_prefix("# ").filter(|name| name.ends_with(".yaml"))
                {
                    std::fs::write(checkout.here.join(name), &block.text).unwrap();
                }
            }
            "sh" => {
                printed = Some(words(&checkout.run(page, &block.text)));
                commands += 1;
            }
            "console" => printed = None,
            "text" => {
                for line in block.text.lines() {
                    if let Some(printed) = &printed {
                        let line = words(line);
                        assert!(printed.contains(&line), "{page}: no `{line}` in:\n{printed}");
                    }
                }
            }
            _ => {}
        }
    }
    assert!(commands > 0, "{page} has no commands");
    let text = std::fs::read_to_string(root().join(page)).unwrap();
    let says_3 = words(&text).to_lowercase().contains("exit code 3");
    let warned = checkout.runs().join("warned").exists();
    assert!(
        says_3 || !warned,
        "{page}: a command ends with exit code 3, and the page does not say so"
    );
    let opens = |block: &Block| block.language == "sh" && block.text.contains("--open");
    let opened = checkout.runs().join("opened").exists();
    assert_eq!(blocks(page).iter().any(opens), opened, "{page}: --open");
}

/// A test of each page, and the list of them.
macro_rules! pages {
    ($($test:ident: $page:literal;)*) => {
        const PAGES: &[&str] = &[$($page),*];
        $(
            #[test]
            fn $test() {
                runs_as_written($page);
            }
        )*
    };
}

pages! {
    readme: "README.md";
    ros2: "docs/ros2.md";
    how_a_verdict_is_reached: "docs/explanation/verdict.md";
    add_an_effect: "docs/how-to/add-an-effect.md";
    bags: "docs/how-to/bags.md";
    foxglove_and_plotjuggler: "docs/how-to/foxglove-and-plotjuggler.md";
    laboratory: "docs/how-to/laboratory.md";
    look: "docs/how-to/look.md";
    own_ros2_stack: "docs/how-to/own-ros2-stack.md";
    own_stage: "docs/how-to/own-stage.md";
    recordings_of_others: "docs/how-to/recordings-of-others.md";
    several_axes: "docs/how-to/several-axes.md";
    sweep: "docs/how-to/sweep.md";
    tune_and_compensate: "docs/how-to/tune-and-compensate.md";
    a_stage_in_ten_minutes: "docs/tutorials/a-stage-in-ten-minutes.md";
    choose_a_guide: "docs/tutorials/choose-a-guide.md";
    closing_the_loop: "docs/tutorials/closing-the-loop.md";
    what_does_my_recording_say: "docs/tutorials/what-does-my-recording-say.md";
}

/// Pages whose commands need the Python package, and the tests of it that run them.
const RUN_BY_THE_WHEEL: [(&str, &str); 2] = [
    ("docs/how-to/data-frames.md", "test_documents.py"),
    ("docs/how-to/fleets.md", "test_fleet_bags.py"),
];

/// The pages that people write: what the program writes is compared with it elsewhere, decisions
/// and notes to others have no commands.
fn written_pages() -> Vec<String> {
    let mut pages = vec!["README.md".to_owned()];
    for directory in ["docs", "docs/tutorials", "docs/how-to", "docs/explanation"] {
        for path in std::fs::read_dir(root().join(directory)).unwrap().map(path) {
            if path.extension().is_some_and(|ending| ending == "md") {
                pages.push(path.strip_prefix(root()).unwrap().display().to_string());
            }
        }
    }
    pages
}

#[test]
fn every_command_of_every_page_is_run_or_marked() {
    for page in written_pages() {
        let mut has_commands = false;
        for block in blocks(&page) {
            match block.language.as_str() {
                "sh" => {
                    has_commands = true;
                    let is_prompt = |line: &str| line.starts_with("$ ");
                    assert!(!block.text.lines().any(is_prompt), "{page}:\n{}", block.text);
                }
                "console" => assert!(block.text.starts_with("$ "), "{page}:\n{}", block.text),
                "text" | "yaml" | "python" | "rust" | "xml" | "json" => {}
                other => panic!("{page}: nothing is known of a block `{other}`"),
            }
        }
        let wheel = RUN_BY_THE_WHEEL.iter().find(|(known, _)| *known == page);
        let runs = usize::from(PAGES.contains(&page.as_str())) + usize::from(wheel.is_some());
        assert_eq!(runs, usize::from(has_commands), "{page}: tests that run it");
        if let Some((_, test)) = wheel {
            let test = root().join("crates/friction-stage-python/tests").join(test);
            let text = std::fs::read_to_string(test).unwrap();
            assert!(text.contains(Path::new(&page).file_name().unwrap().to_str().unwrap()));
        }
    }
}

#[test]
fn the_page_of_a_new_effect_quotes_its_source() {
    let source = root().join("crates/friction-stage-core/src/plant/effects/quadratic_drag.rs");
    let source = std::fs::read_to_string(source).unwrap();
    let mut quotes = blocks("docs/how-to/add-an-effect.md");
    quotes.retain(|block| block.language == "rust");
    assert!(quotes.len() >= 6);
    for quote in quotes {
        assert!(source.contains(&quote.text), "not in quadratic_drag.rs:\n{}", quote.text);
    }
}
