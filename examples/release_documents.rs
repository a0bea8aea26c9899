//! Man pages and completions of the three programs, for a release: `tools/release` calls it.
//!
//! `cargo run --release --example release_documents -- PROGRAMS OUT`: PROGRAMS is the directory
//! with the built programs, whose --help the pages of the nodes are made of.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Context as _;
use clap::CommandFactory as _;
use clap_complete::Shell;
use clap_mangen::Man;
use clap_mangen::roff::{Roff, bold, roman};
use friction_stage::cli::Arguments;

/// Where each shell looks for completions below a prefix, and the name that it looks for.
const SHELLS: [(Shell, &str, &str); 3] = [
    (Shell::Bash, "share/bash-completion/completions", "friction-stage"),
    (Shell::Zsh, "share/zsh/site-functions", "_friction-stage"),
    (Shell::Fish, "share/fish/vendor_completions.d", "friction-stage.fish"),
];

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let (Some(programs), Some(out)) = (arguments.next(), arguments.next()) else {
        anyhow::bail!("usage: release_documents PROGRAMS OUT");
    };
    let mut command = Arguments::command();
    for (shell, directory, name) in SHELLS {
        let mut text = Vec::new();
        clap_complete::generate(shell, &mut command, "friction-stage", &mut text);
        write(&out.join(directory).join(name), &text)?;
    }
    let manual = out.join("share/man/man1");
    command.build();
    page(&manual, &command, "friction-stage")?;
    for inner in command.get_subcommands().filter(|inner| !inner.is_hide_set()) {
        page(&manual, inner, &format!("friction-stage-{}", inner.get_name()))?;
    }
    for node in ["stage_node", "controller_node"] {
        let output = Command::new(programs.join(node))
            .arg("--help")
            .output()
            .with_context(|| format!("cannot start {}", programs.join(node).display()))?;
        let help = String::from_utf8(output.stdout)?;
        write(&manual.join(format!("{node}.1")), node_page(node, &help).as_bytes())?;
    }
    Ok(())
}

fn page(directory: &Path, command: &clap::Command, name: &str) -> anyhow::Result<()> {
    let mut text = Vec::new();
    // clap keeps names for as long as the program runs.
    let name: &'static str = name.to_owned().leak();
    Man::new(command.clone().name(name)).render(&mut text)?;
    write(&directory.join(format!("{name}.1")), &text)
}

/// The page of a node, which has no arguments but those of ROS: its help, line by line.
fn node_page(node: &str, help: &str) -> String {
    let mut page = Roff::new();
    page.control("TH", [node, "1"]);
    page.control("SH", ["NAME"]);
    let first = help.lines().find(|line| !line.trim().is_empty()).unwrap_or_default();
    page.text([bold(node), roman(format!(" - {}", first.trim()))]);
    page.control("SH", ["DESCRIPTION"]);
    page.control("nf", []);
    for line in help.lines() {
        page.text([roman(line)]);
    }
    page.control("fi", []);
    page.render()
}

fn write(path: &Path, text: &[u8]) -> anyhow::Result<()> {
    if let Some(directory) = path.parent() {
        std::fs::create_dir_all(directory)
            .with_context(|| format!("cannot create {}", directory.display()))?;
    }
    std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}
