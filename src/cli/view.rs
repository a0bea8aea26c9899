//! `friction-stage view`: recordings in the browser.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use serde_json::json;

use super::Outcome;
use crate::directory::{dated_file, may_replace};
use crate::made_by;
use friction_stage_data::signals::{self, Mapping};
use friction_stage_report::view::{ViewedRun, view_page};

/// Write a page that shows recordings: position, error and forces, several runs over each other.
///
/// The page is one file without a network: drag to zoom, point to read values, click a name to
/// switch a curve off. Takes rosbag2 directories and their files and tables, as `check` does; a
/// mapping says which topic and field, or column, is which signal.
#[derive(Debug, Clone, Args)]
#[command(
    after_help = "Examples:\n  friction-stage view recordings/train --open\n  friction-stage \
                        view monday tuesday --out both.html\n  friction-stage view drive.csv \
                        --mapping drive.yaml"
)]
pub struct ViewArgs {
    /// rosbag2 directories or their files, or tables
    #[arg(value_name = "BAG", num_args = 1.., required = true)]
    pub bags: Vec<PathBuf>,
    /// YAML file that says which topic and field, or column, is which signal
    #[arg(long, value_name = "FILE")]
    pub mapping: Option<PathBuf>,
    /// The page [default: named after the command and the date]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Replace the page of an earlier run
    #[arg(long)]
    pub force: bool,
    /// Open the page in the browser
    #[arg(long)]
    pub open: bool,
    /// Print JSON instead of text
    #[arg(long)]
    pub json: bool,
}

/// Runs the command; the path of the page goes to `out`.
pub fn run(args: &ViewArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let place = args.out.clone().unwrap_or_else(|| dated_file(Path::new(""), "view", ".html"));
    may_replace(Some(&place), args.force, "--out")?;
    let mapping = args.mapping.as_deref().map(Mapping::load).transpose()?;
    let runs: Vec<ViewedRun> = args
        .bags
        .iter()
        .map(|path| {
            let recording = signals::load(path, mapping.as_ref())?;
            Ok(ViewedRun { path: path.clone(), recording })
        })
        .collect::<anyhow::Result<_>>()?;
    let page = view_page(&runs)?;
    std::fs::write(&place, made_by::signed("view.html", &page))
        .with_context(|| format!("cannot write {}", place.display()))?;
    if args.json {
        writeln!(out, "{}", json!({"page": place}))?;
    } else {
        writeln!(out, "{}", place.display())?;
    }
    if args.open {
        // The page is written: that nothing here shows it is no failure of it.
        if let Err(error) = open::that_detached(&place) {
            let kind = error.kind();
            eprintln!("note: no browser could be started ({kind}): open the page in one yourself");
        }
    }
    Ok(Outcome::Done)
}
