//! What a finished selection leaves: summary.json, the trade-off figure, the rows as Parquet, and
//! the table on stdout.

use std::io::Write;
use std::path::Path;

use anyhow::Context as _;

use super::Outcome;
use friction_stage_lab::{SelectionFinding, VariantRows};
use friction_stage_report::selection::{
    SelectionSummary, reasons, selection_text, trade_off_figure,
};

/// Ranks all rows of a directory, writes what belongs to them and tells the result on `out`.
pub fn finish(
    directory: &Path,
    rows: &VariantRows,
    json: bool,
    out: &mut dyn Write,
) -> anyhow::Result<Outcome> {
    let plan = &rows.sheet().plan;
    let (tallies, selection) = rows.ranked()?;
    let write = |name: &str, text: String| {
        let path = directory.join(name);
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))
    };
    let summary = serde_json::to_string_pretty(&SelectionSummary::new(&selection))?;
    write("summary.json", format!("{summary}\n"))?;
    write("trade_off.svg", trade_off_figure(plan, &tallies, &selection)?)?;
    #[cfg(feature = "parquet")]
    rows.write_parquet(&directory.join("variants.parquet"))?;
    if json {
        writeln!(out, "{summary}")?;
    } else {
        write!(out, "{}", selection_text(plan, &selection))?;
        let parquet = if cfg!(feature = "parquet") { ", variants.parquet" } else { "" };
        writeln!(
            out,
            "\n{}: summary.json, trade_off.svg, variants.csv{parquet}",
            directory.display()
        )?;
    }
    if selection.choice.is_none() {
        let best = &selection.ranking[0];
        anyhow::bail!(
            "no guide meets the requirement of `{}` in any variant; the nearest is {}: {}",
            plan.application.name,
            best.guide,
            reasons(best)
        );
    }
    Ok(Outcome::warned(selection.findings.iter().any(SelectionFinding::is_warning)))
}
