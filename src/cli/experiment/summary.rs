//! What an experiment found, as `summary.json` and as a table for people.

use std::io::Write;

use serde::Serialize;

use friction_stage_lab::{
    DahlCurves, DistributedFit, FastMove, FineStep, FrequencyResponse, HuntingResult, RigBias,
    Statement, StiffnessError, StribeckCurve, length,
};

/// Everything measured, by experiment; SI units.
#[derive(Debug, Default, Serialize)]
pub(super) struct Results {
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub stribeck: Vec<StribeckCurve>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub dahl: Vec<DahlCurves>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub frequency_response: Vec<FrequencyResponse>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub fast_move: Vec<FastMove>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub fine_step: Vec<FineStep>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub hunting: Vec<Hunting>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub rig: Vec<Rig>,
}

#[derive(Debug, Serialize)]
pub(super) struct Hunting {
    pub name: String,
    pub results: Vec<HuntingResult>,
}

#[derive(Debug, Serialize)]
pub(super) struct Rig {
    pub name: String,
    pub biases: Vec<RigBias>,
}

/// The stiffnesses of guide 1 that the paper states, with one bristle and with three.
#[derive(Debug, Serialize)]
pub(super) struct StiffnessFit {
    /// sigma0 of the single bristle that comes nearest, N/m.
    pub best_single_stiffness: f64,
    pub distributed: DistributedFit,
    pub errors: Vec<StiffnessError>,
}

#[derive(Debug, Serialize)]
pub(super) struct Summary<'a> {
    pub schema_version: u32,
    pub experiment: &'a str,
    pub version: &'static str,
    pub seed: u64,
    pub guides: Vec<&'a str>,
    #[serde(skip_serializing_if = "<[Statement]>::is_empty")]
    pub statements: &'a [Statement],
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stiffness_of_guide_1: Option<&'a StiffnessFit>,
    pub results: &'a Results,
    pub warnings: &'a [String],
}

impl Results {
    pub(super) fn merged(all: Vec<Results>) -> Results {
        let mut merged = Results::default();
        for one in all {
            merged.stribeck.extend(one.stribeck);
            merged.dahl.extend(one.dahl);
            merged.frequency_response.extend(one.frequency_response);
            merged.fast_move.extend(one.fast_move);
            merged.fine_step.extend(one.fine_step);
            merged.hunting.extend(one.hunting);
            merged.rig.extend(one.rig);
        }
        merged
    }
}

fn ms(time: Option<f64>) -> String {
    time.map_or("never".to_owned(), |seconds| format!("{:.1}", 1e3 * seconds))
}

impl Summary<'_> {
    /// The key figures; with statements, those alone.
    pub(super) fn print(&self, out: &mut dyn Write) -> std::io::Result<()> {
        for warning in self.warnings {
            writeln!(out, "warning: {warning}")?;
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
                    length(found.amplitude),
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
                        "{:.2} Hz at {:.2} um, damping {:.3}",
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
                "{:22} feedforward {:5.1} N s/m: peak {:6.2} um, 25 to 150 ms rms {:5.2} um, \
                 settles to 10/1/0.1 um in {ten}/{one}/{tenth} ms",
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
                    "{:22} feedforward {:5.1} N s/m: first step: peak {:5.2} um, settles to 1/0.1 \
                     um in {one}/{tenth} ms",
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

    fn print_statements(&self, out: &mut dyn Write) -> std::io::Result<()> {
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

    fn print_fit(&self, out: &mut dyn Write) -> std::io::Result<()> {
        let Some(fit) = self.stiffness_of_guide_1 else { return Ok(()) };
        writeln!(
            out,
            "\nguide 1      paper, N/m   lugre    best single   lugre + distributed_bristles"
        )?;
        for row in &fit.errors {
            writeln!(
                out,
                "{:>10} {:12.2e} {:+7.1} % {:+9.1} % {:+17.2} %",
                length(row.amplitude),
                row.stated,
                100.0 * row.catalogue,
                100.0 * row.best_single,
                100.0 * row.distributed
            )?;
        }
        Ok(())
    }
}
