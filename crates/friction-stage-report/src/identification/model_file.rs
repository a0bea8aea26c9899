//! The model file of an identification: the model in the digits that its intervals deserve, and
//! these as comments.

use std::fmt::Write as _;

use serde_json::Value;

use friction_stage_core::model::{ModelError, StageModel};
use friction_stage_core::numerics::rounded;
use friction_stage_identify::{FoundParameter, Summary, in_digits};

use crate::error::ReportError;
use crate::words::effect_phrases;

/// Least and most significant digits of a number in the file: those of a single-precision number,
/// and those of which a double-precision number has some to spare.
const DIGITS: std::ops::RangeInclusive<f64> = 6.0..=12.0;
/// What the recording of a stage says of several guides.
pub(super) const GUIDES_TOGETHER: &str = "Of several guides the recording shows what they do \
                                          together: their mean is known, and what each of them \
                                          has is not.";

/// The identified model as a model file. Its numbers are rounded to a hundredth of the half width
/// of the narrowest interval, relative to the value; the intervals are comments at its beginning.
pub fn identified_model_file(model: &StageModel, summary: &Summary) -> Result<String, ReportError> {
    let mut text = format!("# verdict: {}\n", summary.verdict.replace('_', " "));
    if !summary.effects.is_empty() {
        let _ = writeln!(
            text,
            "# added: {}",
            effect_phrases(&summary.effects, summary.joint).join("; ")
        );
    }
    text += "# 95 % intervals:\n";
    for (name, found) in parameters(summary) {
        let value = in_digits(found.value, found.ci95);
        let unit = if found.unit == "1" { "" } else { &found.unit };
        let interval = match found.ci95 {
            Some(ci95) => {
                let [low, high] = ci95.map(|end| in_digits(end, found.ci95));
                format!("{low} to {high}")
            }
            None => "none".to_owned(),
        };
        let what = format!("{name} {value} {unit}");
        let _ = writeln!(text, "#   {:40} {interval}", what.trim_end());
    }
    if model.guides.len() > 1 {
        let _ = writeln!(text, "# {GUIDES_TOGETHER}");
    }
    // Values that are possible only as they are stay so.
    let few = in_few_digits(model, digits(summary));
    text += &lists_in_lines(&few.as_ref().unwrap_or(model).to_yaml()?);
    Ok(text)
}

/// The file of the model without the laws that explain a part only, which `partial` has.
pub fn usable_model_file(
    model: &StageModel,
    summary: &Summary,
    partial: &str,
) -> Result<String, ReportError> {
    let verdict = summary.verdict.replace('_', " ");
    let text = lists_in_lines(&model.to_yaml()?);
    Ok(format!(
        "# verdict: {verdict}\n# without the laws that explain a part only: see {partial}\n{text}"
    ))
}

/// Longest line of a list.
const LINE: usize = 100;

/// YAML with each list of numbers as `[1, 2, 3]` in as few lines as there may be: a map has
/// hundreds of values.
fn lists_in_lines(yaml: &str) -> String {
    let number = |line: &str| -> Option<String> {
        let value = line.trim_start().strip_prefix("- ")?;
        value.parse::<f64>().ok().map(|_| value.to_owned())
    };
    let mut text = String::with_capacity(yaml.len());
    let mut lines = yaml.lines().peekable();
    while let Some(line) = lines.next() {
        text += line;
        let key_indent = line.len() - line.trim_start().len();
        let mut numbers = Vec::new();
        if line.ends_with(':') {
            while let Some(value) = lines.peek().and_then(|next| number(next)) {
                numbers.push(value);
                lines.next();
            }
        }
        if !numbers.is_empty() {
            let indent = " ".repeat(key_indent + 2);
            let mut row = format!(" [{}", numbers[0]);
            let mut width = line.len() + row.len();
            for value in &numbers[1..] {
                row.push(',');
                if width + value.len() + 3 > LINE {
                    row += &format!("\n{indent}{value}");
                    width = indent.len() + value.len();
                } else {
                    row += &format!(" {value}");
                    width += value.len() + 2;
                }
            }
            text += &row;
            text.push(']');
        }
        text.push('\n');
    }
    text
}

/// Every number that was found, with its name.
fn parameters(summary: &Summary) -> impl Iterator<Item = (String, &FoundParameter)> {
    let declared = summary.declared_parameters.iter().map(|(name, found)| (name.clone(), found));
    let added = summary.effects.iter().flat_map(|effect| {
        let name = |parameter: &str| format!("{}.{parameter}", effect.name);
        effect.parameters.iter().map(move |(parameter, found)| (name(parameter), found))
    });
    declared.chain(added)
}

/// Significant digits in which no value moves by more than a hundredth of its interval's half
/// width.
fn digits(summary: &Summary) -> usize {
    let needed = |found: &FoundParameter| {
        let [low, high] = found.ci95?;
        let digits = (2.0 * found.value.abs() / (high - low)).log10().ceil() + 2.0;
        digits.is_finite().then_some(digits)
    };
    let most = parameters(summary).filter_map(|(_, found)| needed(found));
    most.fold(*DIGITS.start(), f64::max).min(*DIGITS.end()) as usize
}

fn in_few_digits(model: &StageModel, digits: usize) -> Result<StageModel, ModelError> {
    let failed = |error: serde_json::Error| ModelError::Write { message: error.to_string() };
    let mut value = serde_json::to_value(model).map_err(failed)?;
    round(&mut value, digits);
    // What is written is JSON, which is YAML.
    StageModel::from_yaml(&value.to_string(), "the identified model")
}

fn round(value: &mut Value, digits: usize) {
    match value {
        Value::Number(number) => {
            let short = number.as_f64().filter(|_| number.is_f64());
            let short = short.and_then(|of| serde_json::Number::from_f64(rounded(of, digits)));
            if let Some(short) = short {
                *number = short;
            }
        }
        Value::Array(values) => values.iter_mut().for_each(|value| round(value, digits)),
        Value::Object(values) => values.values_mut().for_each(|value| round(value, digits)),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_values_of_a_map_take_few_lines_and_are_read_again() {
        let values: Vec<String> = (0..256).map(|k| format!("{:.6}", f64::from(k).sin())).collect();
        let text = format!(
            "mass: 40.0\nguides: [guide_1]\nmotor: {{force_limit: 2000}}\neffects: [{{map: \
             {{coordinate: position, side: carriage, from: -0.1, to: 0.1, values: [{}]}}}}]\n",
            values.join(", ")
        );
        let model = StageModel::from_yaml(&text, "test").unwrap();
        let written = model.to_yaml().unwrap();
        assert!(written.lines().count() > 256);
        let compact = lists_in_lines(&written);
        assert!(compact.lines().count() < 70, "{compact}");
        assert!(compact.lines().all(|line| line.len() <= LINE), "{compact}");
        assert_eq!(StageModel::from_yaml(&compact, "test").unwrap(), model);
    }

    #[test]
    fn numbers_of_a_model_are_rounded_and_others_kept() {
        let text = "name: \"1.23456789012\"\nmass: 40.10001730835663\nguides: [guide_1]\nmotor: \
                    {force_limit: 2000}\neffects: [{cogging: {amplitude: 1.9999999, period: \
                    0.024}}]\n";
        let model = StageModel::from_yaml(text, "test").unwrap();
        let few = in_few_digits(&model, 6).unwrap();
        assert_eq!((few.mass, few.motor.force_limit), (40.1, 2000.0));
        assert_eq!(few.name, "1.23456789012");
        assert_eq!(few.guides, model.guides);
        let written = few.to_yaml().unwrap();
        assert!(
            written.contains("amplitude: 2.0") && written.contains("period: 0.024"),
            "{written}"
        );
        assert_eq!(in_few_digits(&model, 12).unwrap().mass, 40.1000173084);
    }
}
