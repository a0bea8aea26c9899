//! A loop that was measured on a running stage, next to that of the model: words, table, figures.

use std::fmt::Write as _;

use serde_json::{Value, json};

use friction_stage_core::control::ControllerSettings;
use friction_stage_core::model::{ModelError, StageModel};
use friction_stage_lab::{
    COHERENT, ComparedPoint, LoopComparison, Margins, MeasuredLoop, UNDISTORTED,
};

use crate::chart::{Axis, Chart, Style};
use crate::figure::FigureError;
use crate::page::{Align, Cell, Page, Table};
use crate::tuning::{COMPARED, beside, unwrapped};

/// Least modulus margin without a warning: |S| of at most 2, as `tune` keeps it.
const LEAST_MODULUS: f64 = 0.5;

/// A measured loop, what the model says of it, and the tuned controller on the measured stage.
#[derive(Clone, Debug)]
pub struct MeasuredReport {
    name: String,
    force: f64,
    comparison: LoopComparison,
    tuned: Option<Margins>,
}

/// Margins without `stable`, which measured frequencies alone do not show.
fn margins(found: Option<Margins>) -> Value {
    let mut value = json!(found);
    if let Value::Object(fields) = &mut value {
        fields.remove("stable");
    }
    value
}

impl MeasuredReport {
    /// The report of the loop in the file `name`.
    pub fn new(
        name: &str,
        measured: &MeasuredLoop,
        model: &StageModel,
        tuned: &ControllerSettings,
    ) -> Result<MeasuredReport, ModelError> {
        Ok(MeasuredReport {
            name: name.to_owned(),
            force: measured.force,
            comparison: measured.compare(model)?,
            tuned: measured.margins_with(tuned),
        })
    }

    /// For other programs.
    pub fn json(&self) -> Value {
        let response = |magnitude: f64, phase: f64| {
            let degrees = phase.to_degrees();
            json!({"magnitude": magnitude, "phase_degrees": degrees})
        };
        let points: Vec<Value> = self
            .comparison
            .points
            .iter()
            .map(|point| {
                let (measured, model) = (point.measured.open_loop, point.model);
                json!({
                    "frequency": point.measured.frequency,
                    "amplitude": point.measured.amplitude,
                    "coherence": point.measured.coherence,
                    "distortion": point.measured.distortion,
                    "measured": response(measured.norm(), measured.arg()),
                    "model": response(model.norm(), model.arg()),
                    "compared": point.counts(),
                })
            })
            .collect();
        let (magnitude, phase, count) = self.comparison.largest();
        json!({
            "file": self.name,
            "force": self.force,
            "margins": margins(self.comparison.measured),
            "model_margins": margins(self.comparison.model),
            "tuned_margins": margins(self.tuned),
            "largest_difference": {
                "points": count,
                "magnitude": magnitude,
                "phase_degrees": phase,
            },
            "points": points,
        })
    }

    /// What a user should know.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        if let Some(tuned) = &self.tuned
            && tuned.modulus_margin < LEAST_MODULUS
        {
            warnings.push(format!(
                "on the measured stage the tuned controller has a largest |S| of {:.1} dB, above \
                 6 dB: the model is not this stage",
                tuned.peak_sensitivity_db()
            ));
        }
        if let Some((frequency, difference)) = self.largest_relative_difference() {
            warnings.push(format!(
                "the computed loop does not describe the measured one (mass, delay, amplitude?): \
                 at {frequency:.1} Hz they are {difference:.1} times as far from each other as \
                 the computed one is from -1"
            ));
        }
        if self.comparison.measured.is_none() {
            warnings.push(format!(
                "{}: fewer than three frequencies have a coherence above {COHERENT}: measure with \
                 a larger force",
                self.name
            ));
        }
        warnings
    }

    /// Where measured and computed loop differ most, Hz, and their difference over the distance of
    /// the computed one from -1, if it is more than half. From one on the stability of one says
    /// nothing of the other (Doyle, Stein, IEEE TAC 26, 1981); half of it is assumed.
    fn largest_relative_difference(&self) -> Option<(f64, f64)> {
        let compared = self.comparison.points.iter().filter(|point| point.counts());
        compared
            .map(|point| {
                let difference = (point.measured.open_loop - point.model).norm();
                (point.measured.frequency, difference / (point.model + 1.0).norm())
            })
            .filter(|(_, difference)| *difference > 0.5)
            .max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// For a person.
    pub fn text(&self) -> String {
        let mut out = String::new();
        // A string takes whatever is written.
        let _ = self.write(&mut out);
        out
    }

    fn write(&self, out: &mut String) -> std::fmt::Result {
        writeln!(out, "{}", self.difference())?;
        writeln!(
            out,
            "{:42} {:>13} {:>22} {:>16} {:>13}",
            "", "crossover, Hz", "phase margin, degrees", "gain margin, dB", "|S|, dB"
        )?;
        for (name, margins) in self.rows() {
            let Some(margins) = margins else { continue };
            writeln!(
                out,
                "{name:42} {:>13} {:>22} {:>16} {:>13.1}",
                shown(margins.crossover),
                shown(margins.phase_margin),
                shown(margins.gain_margin.map(|factor| 20.0 * factor.log10())),
                margins.peak_sensitivity_db()
            )?;
        }
        Ok(())
    }

    fn rows(&self) -> [(&'static str, Option<Margins>); 3] {
        [
            ("measured loop", self.comparison.measured),
            ("the same controller on the model", self.comparison.model),
            ("tuned controller on the measured stage", self.tuned),
        ]
    }

    fn difference(&self) -> String {
        let (magnitude, phase, count) = self.comparison.largest();
        let of = self.comparison.points.len();
        if count == 0 {
            return format!(
                "At none of {of} frequencies has the measured loop a coherence above {COHERENT} \
                 and a distortion below {UNDISTORTED}"
            );
        }
        format!(
            "The measured loop differs from that of the model by at most {:.1} % and {phase:.1} \
             degrees at {count} of {of} frequencies (coherence above {COHERENT}, distortion below \
             {UNDISTORTED})",
            100.0 * magnitude
        )
    }

    /// The section of the page, and its figures.
    pub(crate) fn section(
        &self,
        page: &mut Page,
        figures: &mut Vec<(String, String)>,
    ) -> Result<(), FigureError> {
        page.section("Measured loop");
        page.text(&format!(
            "Sines of {} N on the running stage ({}), and what the model says for the same \
             controller and the amplitudes of the measurement. Drawn are the frequencies with a \
             coherence above {COHERENT}. {}.",
            self.force,
            self.name,
            self.difference()
        ));
        let points: Vec<&ComparedPoint> = self
            .comparison
            .points
            .iter()
            .filter(|point| point.measured.coherence > COHERENT)
            .collect();
        let frequency = |point: &ComparedPoint| point.measured.frequency;
        let along = |of: fn(&ComparedPoint) -> f64| -> Vec<(f64, f64)> {
            points.iter().map(|point| (frequency(point), of(point))).collect()
        };
        let of_model: Vec<(f64, f64)> = points
            .iter()
            .map(|point| frequency(point))
            .zip(unwrapped(points.iter().map(|point| point.model.arg().to_degrees())))
            .collect();
        let of_stage = points.iter().zip(&of_model).map(|(point, (frequency, near))| {
            (*frequency, beside(*near, point.measured.open_loop.arg().to_degrees()))
        });
        let mut gain = Chart::new("Measured loop: gain", "frequency, Hz", "open loop |L|")
            .logarithmic(true, true);
        gain.line("|L| = 1", Axis::Y, 1.0);
        let [model, measured] = COMPARED;
        gain.add("model", model, Style::Line, along(|point| point.model.norm()));
        gain.add(
            "measured",
            measured,
            Style::Marks,
            along(|point| point.measured.open_loop.norm()),
        );
        let mut phase = Chart::new("Measured loop: phase", "frequency, Hz", "phase, degrees")
            .logarithmic(true, false);
        phase.add("model", model, Style::Line, of_model.iter().copied());
        phase.add("measured", measured, Style::Marks, of_stage);
        phase.line("-180°", Axis::Y, -180.0);
        for (name, chart) in [("measured_gain", gain), ("measured_phase", phase)] {
            page.figure(&chart, "Where the marks lie on the line, the model is this stage.")?;
            figures.push((name.to_owned(), chart.svg()?));
        }
        let mut table = Table::new(&[
            ("loop", Align::Left),
            ("crossover, Hz", Align::Right),
            ("phase margin, degrees", Align::Right),
            ("gain margin, dB", Align::Right),
            ("largest |S|, dB", Align::Right),
            ("at, Hz", Align::Right),
        ]);
        for (name, margins) in self.rows() {
            let Some(margins) = margins else { continue };
            table.row([
                Cell::text(name),
                Cell::maybe(margins.crossover, 1),
                Cell::maybe(margins.phase_margin, 1),
                Cell::maybe(margins.gain_margin.map(|factor| 20.0 * factor.log10()), 1),
                Cell::number(margins.peak_sensitivity_db(), 1),
                Cell::number(margins.modulus_frequency, 0),
            ]);
        }
        page.table(&table);
        Ok(())
    }
}

fn shown(value: Option<f64>) -> String {
    value.map_or("-".to_owned(), |value| format!("{value:.1}"))
}
