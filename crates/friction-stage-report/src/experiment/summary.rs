//! What an experiment found, as `summary.json` and as a table for people.

use std::fmt::Write as _;

use serde::{Serialize, Serializer};

use crate::words::{Worded, all_words};
use friction_stage_core::model::JointType;
use friction_stage_data::quality::Severity;
use friction_stage_lab::{
    ExperimentFinding, ExperimentFindings, ExperimentPlan, ExperimentResults, OwnMove, Statement,
    StiffnessFit,
};

/// The whole file, `summary.json`.
#[derive(Debug, Serialize)]
pub struct ExperimentSummary<'a> {
    /// Version of the schema.
    pub schema_version: u32,
    /// Name of the experiment.
    pub experiment: &'a str,
    /// Version of the program.
    pub version: &'static str,
    /// Seed of the sensor noise.
    pub seed: u64,
    /// Names of the specimens.
    pub guides: Vec<&'a str>,
    /// Way and time of the moves, where they are not the paper's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub own_move: Option<OwnMove>,
    /// Statements of the paper with what the stage shows.
    #[serde(skip_serializing_if = "<[Statement]>::is_empty")]
    pub statements: &'a [Statement],
    /// The stated stiffnesses of guide 1, with one bristle and with several.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stiffness_of_guide_1: Option<&'a StiffnessFit>,
    /// Everything measured.
    #[serde(serialize_with = "without_points")]
    pub results: &'a ExperimentResults,
    /// What a user should know, each with a code.
    pub findings: Vec<Worded<'a, ExperimentFinding>>,
    /// The sentences of the findings.
    pub warnings: Vec<String>,
    /// What explains the results and asks for no action.
    pub notes: &'a [String],
    /// Whether recordings are in `bags/`.
    #[serde(skip)]
    pub has_bags: bool,
}

fn without_points<S: Serializer>(results: &ExperimentResults, to: S) -> Result<S::Ok, S::Error> {
    results.without_points().serialize(to)
}

fn ms(time: Option<f64>) -> String {
    time.map_or("never".to_owned(), |seconds| format!("{:.1}", 1e3 * seconds))
}

fn worded(finding: &ExperimentFinding) -> Worded<'_, ExperimentFinding> {
    Worded::new(finding.code(), Severity::Warning, finding, JointType::Prismatic)
}

impl<'a> ExperimentSummary<'a> {
    /// What a plan found, and whether it has left bags.
    pub fn new(
        plan: &'a ExperimentPlan,
        found: &'a ExperimentFindings,
        has_bags: bool,
    ) -> ExperimentSummary<'a> {
        ExperimentSummary {
            schema_version: 1,
            experiment: plan.experiment.name(),
            version: env!("CARGO_PKG_VERSION"),
            seed: plan.settings.seed,
            guides: plan.specimens.iter().map(|of| of.name.as_str()).collect(),
            own_move: plan.own_move,
            statements: &found.statements,
            stiffness_of_guide_1: found.stiffness_of_guide_1.as_ref(),
            results: &found.results,
            findings: found.findings.iter().map(worded).collect(),
            warnings: all_words(&found.findings, JointType::Prismatic),
            notes: &found.notes,
            has_bags,
        }
    }
}

impl ExperimentSummary<'_> {
    /// The key figures; with statements, those alone.
    pub fn text(&self) -> String {
        let mut out = String::new();
        // A string takes whatever is written.
        let _ = self.write(&mut out);
        out
    }

    fn write(&self, out: &mut String) -> std::fmt::Result {
        for warning in &self.warnings {
            writeln!(out, "warning: {warning}")?;
        }
        for note in self.notes {
            writeln!(out, "note: {note}")?;
        }
        if !self.statements.is_empty() {
            return self.print_statements(out);
        }
        let of = self.results;
        for curve in &of.stribeck {
            writeln!(
                out,
                "{:22} {:.2} N at 0.1 mm/s, least {:.2} N at {:.1} mm/s, {:.2} N s/m above 0.1 \
                 m/s{}",
                curve.name,
                curve.slow_force.value,
                curve.least_force.value,
                1e3 * curve.least_force_speed,
                curve.viscous_slope,
                if curve.falls { ", F(v) falls" } else { "" }
            )?;
        }
        for curves in &of.dahl {
            writeln!(
                out,
                "{:22} amplitude   stiffness   tip force   Dahl resonance, damping",
                curves.name
            )?;
            for (found, resonance) in curves.loops.iter().zip(&curves.resonances) {
                let damping = match found.area_is_resolved {
                    true => format!("{:.3}", resonance.damping.value),
                    false => "in the noise".to_owned(),
                };
                writeln!(
                    out,
                    "{:>32} {:9.3e} N/m {:8.3} N {:8.2} Hz, {damping}",
                    amplitude(found.amplitude),
                    found.stiffness.value,
                    found.tip_force.value,
                    resonance.frequency
                )?;
            }
        }
        for response in &of.frequency_response {
            writeln!(out, "{:22} mass line {:.2} kg", response.name, response.mass)?;
            for level in &response.levels {
                let found = level.resonance.map_or("no resonance".to_owned(), |r| {
                    format!(
                        "{:.2} Hz at {:.2} µm, damping {:.3}",
                        r.frequency,
                        1e6 * r.amplitude,
                        r.damping
                    )
                });
                writeln!(out, "{:>30.2} N: {found}", level.force)?;
            }
        }
        for found in &of.fast_move {
            let [ten, one, tenth] = found.forward.settling.map(ms);
            writeln!(
                out,
                "{:22} feedforward {:5.1} N s/m: peak {:6.2} µm, 25 to 150 ms rms {:5.2} µm, \
                 settles to 10/1/0.1 µm in {ten}/{one}/{tenth} ms",
                found.name,
                found.viscous_feedforward,
                1e6 * found.forward.peak_error,
                1e6 * found.wave_rms
            )?;
        }
        for found in &of.fine_step {
            if let Some(step) = found.steps.first() {
                let [_, one, tenth] = step.settling.map(ms);
                writeln!(
                    out,
                    "{:22} feedforward {:5.1} N s/m: first step: peak {:5.2} µm, settles to 1/0.1 \
                     µm in {one}/{tenth} ms",
                    found.name,
                    found.viscous_feedforward,
                    1e6 * step.peak_error
                )?;
            }
        }
        for hunting in &of.hunting {
            for result in &hunting.results {
                let what = result.cycle.map_or("comes to rest".to_owned(), |cycle| {
                    format!("hunts: {:.3} mm, {:.2} s", 1e3 * cycle.amplitude, cycle.period)
                });
                writeln!(
                    out,
                    "{:22} {:4} Hz, integral x {}: {what}",
                    hunting.name, result.bandwidth, result.integral
                )?;
            }
        }
        for rig in &of.rig {
            for row in &rig.biases {
                writeln!(
                    out,
                    "{:22} {:8} {:6} {:15}: stiffness {:+.2} %, behind the coupling {:+.2} %, area \
                     {:+.1} %",
                    rig.name,
                    row.property,
                    row.value,
                    row.unit,
                    100.0 * row.stiffness_bias,
                    100.0 * row.stiffness_bias_at_motor,
                    100.0 * row.area_bias
                )?;
            }
        }
        self.print_fit(out)
    }

    fn print_statements(&self, out: &mut String) -> std::fmt::Result {
        for statement in self.statements {
            let holds = if statement.holds { "yes" } else { "NO " };
            writeln!(out, "{holds}  {:12}  {}", statement.section, statement.paper)?;
            writeln!(out, "                   {}", statement.stage)?;
            if let Some(reason) = statement.reason {
                writeln!(out, "                   why: {reason}")?;
            }
        }
        let holding = self.statements.iter().filter(|statement| statement.holds).count();
        writeln!(out, "\n{holding} of {} statements hold", self.statements.len())?;
        self.print_fit(out)
    }

    fn print_fit(&self, out: &mut String) -> std::fmt::Result {
        let Some(fit) = self.stiffness_of_guide_1 else { return Ok(()) };
        writeln!(
            out,
            "\nguide 1      paper, N/m   lugre    best single   lugre + distributed_bristles"
        )?;
        for row in &fit.errors {
            writeln!(
                out,
                "{:>10} {:12.2e} {:+7.1} % {:+9.1} % {:+17.2} %",
                amplitude(row.amplitude),
                row.stated,
                100.0 * row.catalogue,
                100.0 * row.best_single,
                100.0 * row.distributed
            )?;
        }
        Ok(())
    }
}

/// An amplitude, m, in the unit in which it is a small whole number: `10 nm`, `420 µm`, `1 mm`.
fn amplitude(metres: f64) -> String {
    let (size, unit) = match metres {
        small if small < 0.9995e-6 => (1e-9, "nm"),
        small if small < 0.9995e-3 => (1e-6, "µm"),
        _ => (1e-3, "mm"),
    };
    format!("{:.0} {unit}", metres / size)
}

#[cfg(test)]
mod tests {
    #[test]
    fn amplitudes_have_a_unit_of_their_size() {
        let said = [10e-9, 1e-6, 420e-6, 1e-3, 2e-3].map(super::amplitude);
        assert_eq!(said, ["10 nm", "1 µm", "420 µm", "1 mm", "2 mm"]);
    }
}
