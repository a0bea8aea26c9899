//! `friction-stage demo recordings`: recordings to try `identify` on.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;

use crate::cli::experiment::bags::write_topics;
use crate::cli::{Outcome, WrongArguments};
use crate::interrupt;
use friction_stage_core::model::StageModel;
use friction_stage_core::plant::load_model;
use friction_stage_core::text_file;
use friction_stage_lab::HiddenEffect;

/// File with what is hidden, not to be read by accident.
const ANSWER: &str = "answer.sealed";

/// Make recordings of a stage that has an effect which its declared model lacks.
///
/// Writes into a new directory: declared.yaml, what is known of the stage; train and check, two
/// recordings of it in closed loop (rosbag2, 14 and 9 s, 2 kHz); and a sealed file with the
/// answer, which --reveal prints. The stage is simulated in this process; mass and guides differ
/// from the declared ones within their tolerances.
#[derive(Debug, Clone, Args)]
#[command(
    after_help = "Examples:\n  friction-stage demo recordings\n  friction-stage identify --model \
                  recordings/declared.yaml --train recordings/train --holdout recordings/check \
                  --out result\n  friction-stage demo recordings --reveal\n  friction-stage demo \
                  recordings --seed 2 --out another   # another stage\n  friction-stage \
                  demo recordings --hide my_stage.yaml --out mine   # your own stage"
)]
pub(super) struct RecordingsArgs {
    /// Directory to make; it must not exist
    #[arg(long, value_name = "DIR", default_value = "recordings")]
    out: PathBuf,
    /// Which stage: effect, values and noise; with --hide mass, guides and noise
    #[arg(long, default_value_t = 1)]
    seed: u32,
    /// Model file of a stage whose effects are hidden, in place of one that the seed draws
    #[arg(long, value_name = "FILE")]
    hide: Option<PathBuf>,
    /// Print what is hidden in the recordings of --out, and make none
    #[arg(long, conflicts_with_all = ["seed", "hide"])]
    reveal: bool,
    /// Print JSON instead of text
    #[arg(long)]
    json: bool,
}

/// Runs the command; what it made goes to `out`.
pub(super) fn run(args: &RecordingsArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    if args.reveal {
        let (text, model) = unsealed(&args.out.join(ANSWER))?;
        match args.json {
            true => writeln!(out, "{}", serde_json::to_string_pretty(&model)?)?,
            false => write!(out, "{text}")?,
        }
        return Ok(Outcome::Done);
    }
    let place = args.out.display();
    if args.out.exists() {
        return Err(WrongArguments(format!(
            "{place} exists already: choose another --out, or --reveal what is hidden in it"
        ))
        .into());
    }
    interrupt::writes(&args.out);
    let seed = u64::from(args.seed);
    let made = match &args.hide {
        None => HiddenEffect::new(seed)?,
        Some(path) => {
            HiddenEffect::of(&to_hide(path)?, seed).with_context(|| path.display().to_string())?
        }
    };
    std::fs::create_dir_all(&args.out).with_context(|| format!("cannot create {place}"))?;
    let write = |name: &str, text: String| {
        let path = args.out.join(name);
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))
    };
    // Without a word of their origin: it would be the answer.
    for recording in [&made.train, &made.check] {
        write_topics(&args.out.join(&recording.name), recording, None)?;
    }
    write("declared.yaml", made.declared.to_yaml()?)?;
    write(ANSWER, sealed(&made.real.to_yaml()?))?;
    if args.json {
        let files = ["declared.yaml", "train", "check"].map(|name| args.out.join(name));
        let [model, train, holdout] = &files;
        let made = serde_json::json!({"model": model, "train": train, "holdout": holdout});
        writeln!(out, "{}", serde_json::to_string_pretty(&made)?)?;
        return Ok(Outcome::Done);
    }
    writeln!(
        out,
        "{place}: declared.yaml, train, check and the sealed answer\n\nWhat does the stage have \
         that its model lacks?\n  friction-stage identify --model {place}/declared.yaml --train \
         {place}/train --holdout {place}/check --out result\n\nThe answer:\n  \
         friction-stage demo recordings --out {place} --reveal"
    )?;
    Ok(Outcome::Done)
}

/// A model with something to hide.
fn to_hide(path: &Path) -> anyhow::Result<StageModel> {
    let model = load_model(path)?;
    if model.effects.is_empty() {
        let why = "it has no `effects`, so there is nothing to hide";
        return Err(WrongArguments(format!("{}: {why}", path.display())).into());
    }
    Ok(model)
}

/// A text in hexadecimal digits, 40 bytes a line.
fn sealed(text: &str) -> String {
    let line = |bytes: &[u8]| {
        bytes.iter().map(|byte| format!("{byte:02x}")).chain(["\n".to_owned()]).collect::<String>()
    };
    text.as_bytes().chunks(40).map(line).collect()
}

/// The model in a sealed file, as text and read.
fn unsealed(path: &Path) -> anyhow::Result<(String, StageModel)> {
    let text = text_file::read(path)
        .with_context(|| format!("cannot read {}: no answer is here", path.display()))?;
    let digits: Vec<char> = text.chars().filter(|digit| !digit.is_whitespace()).collect();
    let bytes: Option<Vec<u8>> = digits
        .chunks(2)
        .map(|pair| u8::from_str_radix(&pair.iter().collect::<String>(), 16).ok())
        .collect();
    let answer = bytes
        .and_then(|bytes| String::from_utf8(bytes).ok())
        .with_context(|| format!("{} is no answer that this command has sealed", path.display()))?;
    let model = StageModel::from_yaml(&answer, &path.display().to_string())?;
    Ok((answer, model))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_sealed_cannot_be_read_and_comes_back() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join(ANSWER);
        let text = "name: µ\neffects:\n- cogging: {amplitude: 5.0, period: 0.024}\n";
        std::fs::write(&path, sealed(text)).unwrap();
        assert!(!sealed(text).contains("cogging"));
        assert_eq!(unsealed(&path).unwrap().0, text);
        for broken in ["6", "zz", "ffff", "", "é"] {
            std::fs::write(&path, broken).unwrap();
            let reported = format!("{:#}", unsealed(&path).unwrap_err());
            assert!(reported.contains(ANSWER), "{reported}");
        }
    }
}
