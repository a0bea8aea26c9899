//! `friction-stage import`: a table as a bag of our own layout, and a mapping for one.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;

use super::progress::Progress;
use super::{Outcome, WrongArguments};
use crate::directory::{may_replace, set_aside};
use crate::interrupt;
use crate::made_by;
use friction_stage_core::text_file;
use friction_stage_data::signals::{self, Mapping, Proposal};
use friction_stage_report::words::{import_text, proposal_text};

/// Make a bag of our own layout from a table, or first a mapping for it.
///
/// Without --mapping it detects the layout of a text or lists the arrays, prints it, and writes a
/// mapping to confirm: the column and the unit of each signal. What the file does not say is marked
/// CHECK.
///
/// With --mapping and --out every row becomes one sample with its own time; values are brought to
/// SI, nothing is resampled. The bag plays with `ros2 bag play` and goes into check, replay and
/// identify.
///
/// Exit code: 0 done; 3 rows were left out, times go back, or the mapping has something to check;
/// 1 failed.
#[derive(Debug, Clone, Args)]
#[command(after_help = "Example:\n  friction-stage import drive.csv                  # writes \
                        drive.mapping.yaml\n  friction-stage import drive.csv --mapping \
                        drive.mapping.yaml --out drive\n  friction-stage import runs.csv \
                        --mapping runs.mapping.yaml --out runs --split\n  friction-stage import \
                        drive.csv cell.csv       # one mapping for both files\n\nA mapping:\n  \
                        signals:\n    time: {column: t_ms, unit: ms}\n    \
                        position: {column: x, unit: mm}\n    \
                        force: {column: u, scale: 35.15}   # N per V")]
pub struct ImportArgs {
    /// Table: CSV, TSV, columns between blanks; arrays in .mat, .npz, .npy
    #[arg(value_name = "FILE")]
    pub csv: PathBuf,
    /// Further tables of the same motion with clocks of their own, in the directory of FILE or
    /// below it: the mapping joins them
    #[arg(value_name = "OTHER", conflicts_with = "mapping")]
    pub others: Vec<PathBuf>,
    /// YAML file that says which column is which signal; without it one is proposed
    #[arg(long, value_name = "FILE", requires = "out")]
    pub mapping: Option<PathBuf>,
    /// Directory to make; it must not exist, unless --force replaces it
    #[arg(long, value_name = "BAG", requires = "mapping")]
    pub out: Option<PathBuf>,
    /// The file has several captures, one after the other: make a bag of each in the directory
    /// --out
    #[arg(long, requires = "mapping")]
    pub split: bool,
    /// Where to write the proposed mapping, instead of NAME.mapping.yaml here
    #[arg(long, value_name = "FILE", conflicts_with = "mapping")]
    pub write: Option<PathBuf>,
    /// Replace the bag or the mapping of an earlier run
    #[arg(long)]
    pub force: bool,
    /// Print JSON instead of text
    #[arg(long)]
    pub json: bool,
}

/// Runs the command; the report goes to `out`.
pub fn run(args: &ImportArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    match (&args.mapping, &args.out) {
        (Some(mapping), Some(bag)) => import(args, mapping, bag, out),
        _ => propose(args, out),
    }
}

fn import(
    args: &ImportArgs,
    mapping: &Path,
    bag: &Path,
    out: &mut dyn Write,
) -> anyhow::Result<Outcome> {
    let text =
        text_file::read(mapping).with_context(|| format!("cannot read {}", mapping.display()))?;
    let mapping = Mapping::from_yaml(&text, &mapping.display().to_string())?;
    let mut about = made_by::record();
    about.insert("mapping".to_owned(), text);
    for input in [Some(&args.csv), args.mapping.as_ref()].into_iter().flatten() {
        if bag
            .canonicalize()
            .is_ok_and(|bag| input.canonicalize().is_ok_and(|i| i.starts_with(bag)))
        {
            return Err(WrongArguments(format!(
                "{} is in {}: choose another --out",
                input.display(),
                bag.display()
            ))
            .into());
        }
    }
    if bag.is_file() {
        let place = bag.display();
        let why = format!("{place} is a file, a bag is a directory: choose another --out");
        return Err(WrongArguments(why).into());
    }
    let earlier = set_aside(bag, args.force, "--out")?;
    interrupt::writes(bag);
    let progress = Progress::endless("reading");
    let mut reported = |rows: u64| progress.say(format!("{:.1} million rows", rows as f64 * 1e-6));
    let reports = if args.split {
        signals::import_captures(&args.csv, &mapping, &about, bag, &mut reported)?
    } else {
        vec![signals::import(&args.csv, &mapping, &about, bag, &mut reported)?]
    };
    drop(progress);
    if reports.iter().all(|report| report.rows == 0) {
        std::fs::remove_dir_all(bag).with_context(|| format!("cannot remove {}", bag.display()))?;
        anyhow::bail!("{} has a header and no rows", args.csv.display());
    }
    earlier.discard()?;
    match reports.as_slice() {
        [report] if args.json && !args.split => {
            writeln!(out, "{}", serde_json::to_string_pretty(report)?)?;
        }
        reports if args.json => writeln!(out, "{}", serde_json::to_string_pretty(reports)?)?,
        reports => {
            for report in reports {
                write!(out, "{}", import_text(report))?;
            }
        }
    }
    let is_whole = reports
        .iter()
        .all(|report| report.without_time + report.not_later == 0 && report.notes.is_empty());
    Ok(Outcome::warned(!is_whole))
}

fn propose(args: &ImportArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let name = args.csv.file_stem().unwrap_or(args.csv.as_os_str()).to_string_lossy();
    let path = args.write.clone().unwrap_or_else(|| format!("{name}.mapping.yaml").into());
    may_replace(Some(&path), args.force, "--write")?;
    let proposal = Proposal::of(&args.csv)?;
    if proposal.is_motion_guessed || !proposal.has_motion() {
        for other in &args.others {
            let elsewhere = Proposal::of(other)?;
            if elsewhere.has_motion() && !elsewhere.is_motion_guessed {
                let (first, other) = (args.csv.display(), other.display());
                let why = format!("{first} says no motion, {other} does: name {other} first");
                return Err(WrongArguments(why).into());
            }
        }
    }
    let directory = args.csv.parent().unwrap_or(Path::new(""));
    let mut taken: Vec<_> = proposal.recorded().collect();
    let joined = args
        .others
        .iter()
        .map(|path| {
            let from_there = path.strip_prefix(directory).ok().with_context(|| {
                format!(
                    "{} is not in the directory of {} or below it: name the file with the motion \
                     first",
                    path.display(),
                    args.csv.display()
                )
            })?;
            let other = Proposal::beside(path, &taken)?;
            taken.extend(other.recorded());
            Ok((from_there.display().to_string(), other))
        })
        .collect::<anyhow::Result<Vec<(String, Proposal)>>>()?;
    let text = proposal.to_yaml(&args.csv.display().to_string(), &joined);
    let text = made_by::signed("mapping.yaml", &text);
    std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
    if args.json {
        match joined.as_slice() {
            [] => writeln!(out, "{}", serde_json::to_string_pretty(&proposal)?)?,
            joined => {
                let all: Vec<&Proposal> =
                    std::iter::once(&proposal).chain(joined.iter().map(|(_, p)| p)).collect();
                writeln!(out, "{}", serde_json::to_string_pretty(&all)?)?;
            }
        }
    } else {
        for (path, (_, other)) in args.others.iter().zip(&joined) {
            writeln!(out, "{}", proposal_text(other, path, None))?;
        }
        write!(out, "{}", proposal_text(&proposal, &args.csv, Some(&path)))?;
    }
    let mut proposals = std::iter::once(&proposal).chain(joined.iter().map(|(_, other)| other));
    let is_unsure = proposals.any(|proposal| !proposal.checks().is_empty());
    let is_one_clock = |(_, other): &(String, Proposal)| proposal.has_dates() && other.has_dates();
    Ok(Outcome::warned(is_unsure || !joined.iter().all(is_one_clock)))
}
