//! The report of an identification: its summary, its page and its figures.

mod figures;
mod model_file;
mod next;
mod page;

use std::fmt::Write as _;
use std::path::Path;

use crate::words::{Words, effect_phrases, in_prefix, short};
use friction_stage_core::model::JointType;
use friction_stage_core::plant::EffectDescriptor;
use friction_stage_core::plant::effects::ParameterKind;
use friction_stage_identify::{Change, Identification, Records, Summary, in_digits, taking_part};

pub use figures::{FigureGroup, IdentificationFigure, identification_figures};
pub use model_file::{identified_model_file, usable_model_file};
pub use next::next_experiment_lines;
pub use page::identification_page;

/// The summary of an identification for other programs, with the words for its findings.
/// `model_file` is the name of the file with the identified model.
pub fn identification_summary(
    identification: &Identification,
    records: &Records,
    model_file: &str,
) -> Summary {
    let joint = identification.model.joint;
    identification.summary(records, model_file, &|finding| finding.words(joint))
}

/// A length, m, or an angle, rad, in a size that reads well.
fn travel(value: Option<f64>, joint: JointType) -> String {
    value.map_or_else(|| "\u{2013}".to_owned(), |value| in_prefix(value, &joint.unit("m")))
}

/// The word for the value of an effect's parameter, where it is a choice and no number.
fn chosen(effect: &str, parameter: &str, value: f64) -> Option<&'static str> {
    let known = EffectDescriptor::find(effect).ok()?;
    let known = known.parameters.iter().find(|known| known.name == parameter)?;
    match known.kind {
        ParameterKind::Choice(names) => names.get(value as usize).copied(),
        _ => None,
    }
}

/// The verdict with its numbers, as text for a person; ends with the path of the page.
pub fn identification_text(summary: &Summary, page: &Path) -> String {
    let joint = summary.joint;
    let force = joint.unit("N");
    let mut out = String::new();
    let _ = writeln!(out, "verdict: {}", summary.verdict);
    if !summary.effects.is_empty() {
        let phrases = effect_phrases(&summary.effects, joint).join("; ");
        let is_partial = summary.findings.iter().any(|finding| finding.code == "partial_laws");
        let what = if is_partial { "found so far" } else { "in the model now" };
        let _ = writeln!(out, "{what}: {phrases}");
    }
    for effect in &summary.effects {
        let _ = writeln!(out, "  {} ({} side)", effect.name, effect.side);
        for name in taking_part(effect) {
            let Some(parameter) = effect.parameters.get(name) else { continue };
            if let Some(word) = chosen(&effect.name, name, parameter.value) {
                let _ = writeln!(out, "    {name:18} {word}");
                continue;
            }
            let digits = |value: f64| in_digits(value, parameter.ci95);
            let interval = parameter.ci95.map_or_else(String::new, |[low, high]| {
                format!("  95 %: {} to {}", digits(low), digits(high))
            });
            let unit = if parameter.unit == "1" { "" } else { &parameter.unit };
            let _ = writeln!(out, "    {name:18} {} {unit}{interval}", digits(parameter.value));
        }
    }
    for (name, errors) in [("train", &summary.errors.train), ("hold-out", &summary.errors.holdout)]
    {
        let number = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), short);
        let _ = writeln!(
            out,
            "{name:9} force residual {} -> {} {force} ({} -> {} %){}",
            number(errors.force_rms.before),
            number(errors.force_rms.after),
            number(errors.force_relative.before),
            number(errors.force_relative.after),
            match errors.position_rms {
                Change { before: None, after: None } => String::new(),
                Change { before, after } => {
                    format!(", position {} -> {}", travel(before, joint), travel(after, joint))
                }
            }
        );
    }
    let _ = writeln!(
        out,
        "explained share {:.3} of the held-out residual above the noise floor of {} {force}",
        summary.explained_share,
        short(summary.floor.force_rms)
    );
    for (index, line) in summary
        .next_experiment
        .iter()
        .flat_map(|next| next_experiment_lines(next, joint))
        .enumerate()
    {
        let _ = writeln!(out, "{}{line}", if index == 0 { "" } else { "  " });
    }
    for finding in &summary.findings {
        let _ = writeln!(out, "{}: {}", finding.severity, finding.text);
    }
    let _ = writeln!(out, "{}", page.display());
    out
}
