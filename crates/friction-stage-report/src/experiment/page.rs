//! The page of an experiment, and the figures in it.

use super::summary::ExperimentSummary;
use crate::chart::{Chart, Scale, Style};
use crate::error::ReportError;
use crate::page::{Align, Cell, Mark, Page, Table, Tile};
use crate::paper_motion::settling_bands;
use crate::words::{PAPER, PAPER_WITH_TITLE, guide_label, in_prefix_short, short, signed_percent};
use friction_stage_core::model::{Guide, JointType};
use friction_stage_lab::{OwnMove, SETTLING_BANDS, Specimen};

use Align::{Left, Right};

/// What dashed curves are.
const LAW: &str = "law of the model";

/// A drawn figure of an experiment.
pub struct ExperimentFigure {
    /// Name of its file, without the ending.
    pub name: String,
    /// The drawing.
    pub svg: String,
}

/// The page of an experiment, and its figures as files of their own.
pub fn experiment_page(
    summary: &ExperimentSummary<'_>,
    specimens: &[Specimen],
) -> Result<(String, Vec<ExperimentFigure>), ReportError> {
    Report::new(summary).write(specimens)
}

struct Report<'a> {
    summary: &'a ExperimentSummary<'a>,
    page: Page,
    figures: Vec<ExperimentFigure>,
}

impl<'a> Report<'a> {
    fn new(summary: &'a ExperimentSummary<'a>) -> Report<'a> {
        let title = match summary.experiment {
            "paper" => format!("The statements of {PAPER}, on the stage"),
            name => format!("Experiment: {name}"),
        };
        let subtitle = format!(
            "friction-stage {} \u{b7} {} \u{b7} seed {} \u{b7} measured signals: encoder and force \
             cell, with their noise",
            summary.version,
            summary.guides.join(", "),
            summary.seed
        );
        Report { summary, page: Page::new(title, subtitle), figures: Vec::new() }
    }

    fn write(
        mut self,
        specimens: &[Specimen],
    ) -> Result<(String, Vec<ExperimentFigure>), ReportError> {
        self.statements();
        self.stiffness_fit()?;
        self.stribeck(specimens)?;
        self.dahl(specimens)?;
        self.frequency_response()?;
        self.fast_move()?;
        self.fine_step()?;
        self.hunting()?;
        self.rig()?;
        self.page.section("How it was run");
        self.page.facts([
            ("program", format!("friction-stage {}", self.summary.version)),
            ("guides", self.summary.guides.join(", ")),
            ("paper", PAPER_WITH_TITLE.to_owned()),
            ("seed of the sensor noise", self.summary.seed.to_string()),
            (
                "bags",
                match self.summary.has_bags {
                    true => {
                        "bags/: each holds its model, seed and rates; friction-stage replay BAG \
                             repeats it"
                    }
                    false => "none were written",
                }
                .to_owned(),
            ),
            ("numbers", "summary.json".to_owned()),
        ]);
        for warning in &self.summary.warnings {
            self.page.note(Mark::Warning, warning);
        }
        for note in self.summary.notes {
            self.page.note(Mark::Neutral, note);
        }
        Ok((self.page.finish(), self.figures))
    }

    fn figure(&mut self, name: &str, chart: &Chart, caption: &str) -> Result<(), ReportError> {
        let svg = chart.svg()?;
        self.page.figure(chart, caption)?;
        self.figures.push(ExperimentFigure { name: name.to_owned(), svg });
        Ok(())
    }

    fn statements(&mut self) {
        let statements = self.summary.statements;
        if statements.is_empty() {
            return;
        }
        let holding = statements.iter().filter(|statement| statement.holds).count();
        let mark = if holding == statements.len() { Mark::Good } else { Mark::Warning };
        let mut tiles = vec![Tile {
            name: "statements that hold".into(),
            value: format!("{holding} of {}", statements.len()),
            detail: "each with what the stage shows".into(),
            mark,
        }];
        if let Some(fit) = self.summary.stiffness_of_guide_1 {
            let worst = |of: fn(&friction_stage_lab::StiffnessError) -> f64| {
                100.0 * fit.errors.iter().map(|row| of(row).abs()).fold(0.0, f64::max)
            };
            let (best, after) = (worst(|row| row.best_single), worst(|row| row.distributed));
            tiles.push(Tile {
                name: "guide 1's stiffness, one bristle".into(),
                value: format!("{best:.0} % off"),
                detail: "largest error, best fit to three amplitudes".into(),
                mark: Mark::Bad,
            });
            tiles.push(Tile {
                name: "with distributed bristles".into(),
                value: format!("{after:.1} % off"),
                detail: "largest error, measured on the rig".into(),
                mark: if after < 2.0 { Mark::Good } else { Mark::Bad },
            });
        }
        self.page.tiles(&tiles);
        self.page.section("Statements");
        let mut table = Table::new(&[
            ("section", Left),
            ("the MI-Partners paper says", Left),
            ("the stage shows", Left),
            ("holds", Left),
        ]);
        for statement in statements {
            let badge = if statement.holds {
                Cell::badge(Mark::Good, "yes")
            } else {
                Cell::badge(Mark::Bad, "no")
            };
            table.row([
                Cell::text(statement.section),
                Cell::text(statement.paper),
                Cell::text(statement.stage.as_str()),
                badge,
            ]);
        }
        self.page.table(&table);
        for statement in statements {
            if let Some(reason) = statement.reason {
                self.page
                    .note(Mark::Warning, &format!("\u{201c}{}\u{201d}: {reason}", statement.paper));
            }
        }
    }

    fn stiffness_fit(&mut self) -> Result<(), ReportError> {
        let Some(fit) = self.summary.stiffness_of_guide_1 else { return Ok(()) };
        self.page.section("Three stiffnesses and one bristle");
        self.page.text(
            "The paper states three effective stiffnesses of guide 1. A single LuGre \
             bristle has k \
             = Fs tanh(\u{3c3}0 A/Fs)/A, so two of them fix the third. Bristles in parallel that \
             slip one after another meet all three: four in the catalogue.",
        );
        let mut table = Table::new(&[
            ("amplitude", Left),
            ("the MI-Partners paper, N/m", Right),
            ("lugre of the catalogue", Right),
            ("best single bristle", Right),
            ("lugre + distributed_bristles", Right),
        ]);
        let percent = |value: f64| Cell::text(signed_percent(value, 2));
        for row in &fit.errors {
            table.row([
                Cell::text(in_prefix_short(row.amplitude, "m")),
                Cell::text(format!("{:.2e}", row.stated)),
                percent(row.catalogue),
                percent(row.best_single),
                percent(row.distributed),
            ]);
        }
        self.page.table(&table);
        let mut chart = Chart::new(
            "Effective stiffness of guide 1",
            "amplitude, µm",
            "effective stiffness, N/m",
        )
        .logarithmic(true, true);
        let results = self.summary.results;
        for (colour, (name, label)) in
            [("guide 1", "one bristle"), ("guide 1 distributed", "in parallel")]
                .into_iter()
                .enumerate()
        {
            if let Some(curves) = results.dahl.iter().find(|curves| curves.name == name) {
                let points =
                    curves.loops.iter().map(|found| (1e6 * found.amplitude, found.stiffness.value));
                chart.add(label, colour, Style::Both, points);
            }
        }
        chart.add(
            PAPER,
            4,
            Style::Rings,
            fit.errors.iter().map(|row| (1e6 * row.amplitude, row.stated)),
        );
        self.figure(
            "stiffness_of_guide_1",
            &chart,
            &format!("What {PAPER} states (rings), one bristle, and bristles in parallel."),
        )
    }

    fn stribeck(&mut self, specimens: &[Specimen]) -> Result<(), ReportError> {
        let curves = &self.summary.results.stribeck;
        if curves.is_empty() {
            return Ok(());
        }
        self.page.section("Stribeck curve");
        self.page.text(
            "One guide on the rig at constant velocity, after the bristles have become steady. \
             Marks are means of the force cell in both directions; thin dashed lines are the \
             closed form F(v) = g(v) sign(v) + \u{3c3}2 v of the model.",
        );
        // The speeds of a Stribeck curve spread over decades, in both directions.
        let speeds = curves.iter().flat_map(|curve| &curve.points).map(|p| 1e3 * p.velocity.abs());
        let slowest = speeds.filter(|speed| *speed > 0.0).fold(f64::INFINITY, f64::min);
        let scale = if slowest.is_finite() { Scale::Asinh(slowest) } else { Scale::Linear };
        let mut whole =
            Chart::new("Friction over velocity", "velocity, mm/s", "friction, N").along(scale);
        let mut slow = Chart::new(
            "Friction over speed, mean of both directions",
            "speed, mm/s",
            "friction, N",
        )
        .logarithmic(true, false);
        let mut table = Table::new(&[
            ("guide", Left),
            ("at 0.1 mm/s, N", Right),
            ("least, N", Right),
            ("at, mm/s", Right),
            ("slope, N s/m", Right),
            ("level, N", Right),
            ("F(v)", Left),
        ]);
        for (colour, curve) in curves.iter().enumerate() {
            whole.add(
                guide_label(&curve.name),
                colour,
                Style::Both,
                curve.points.iter().map(|p| (1e3 * p.velocity, p.force.value)),
            );
            let half = curve.points.len() / 2;
            let pairs = (0..half).map(|k| {
                let (back, forth) = (curve.points[half - 1 - k], curve.points[half + k]);
                (
                    500.0 * (forth.velocity - back.velocity),
                    0.5 * (forth.force.value - back.force.value),
                )
            });
            slow.add(guide_label(&curve.name), colour, Style::Marks, pairs);
            if let Some(of) = specimens.iter().find(|of| of.name == curve.name) {
                let guide = of.guide()?;
                let speeds = (0..200).map(|k| 1e-4 * 10f64.powf(4.0 * f64::from(k) / 199.0));
                slow.add(
                    "",
                    colour,
                    Style::Dashed,
                    speeds.map(|v| (1e3 * v, guide.steady_force(v))),
                );
            }
            table.row([
                Cell::text(guide_label(&curve.name)),
                Cell::number(curve.slow_force.value, 3),
                Cell::number(curve.least_force.value, 3),
                Cell::number(1e3 * curve.least_force_speed, 1),
                Cell::number(curve.viscous_slope, 2),
                Cell::number(curve.viscous_level, 2),
                if curve.falls {
                    Cell::badge(Mark::Warning, "falls")
                } else {
                    Cell::badge(Mark::Good, "does not fall")
                },
            ]);
        }
        slow.dashed_are(LAW);
        self.figure(
            "stribeck_slow",
            &slow,
            &format!(
                "Stribeck curve, logarithmic in speed (Figure 3 of {PAPER}). Marks: measured; \
                 dashed: the law."
            ),
        )?;
        self.figure(
            "stribeck",
            &whole,
            &format!(
                "Stribeck curve, both directions. The axis is even up to {} mm/s, and logarithmic \
                 beyond.",
                short(slowest)
            ),
        )?;
        self.page.table(&table);
        Ok(())
    }

    fn dahl(&mut self, specimens: &[Specimen]) -> Result<(), ReportError> {
        let all = &self.summary.results.dahl;
        if all.is_empty() {
            return Ok(());
        }
        self.page.section("Dahl curves");
        self.page.text(
            "Slow loops of one guide on the rig. Stiffness: force difference over position \
             difference between the dwells at the tips. Thin and dashed: closed forms of the \
             bristles, k = Fs tanh(\u{3c3}0 A/Fs)/A and W = 4 A Fs \u{2212} 4 \
             (Fs\u{b2}/\u{3c3}0) tanh(\u{3c3}0 A/Fs).",
        );
        for (name, amplitude, scale, unit) in [
            ("dahl_40um_420um", 420e-6, 1e6, "µm"),
            ("dahl_40um", 40e-6, 1e6, "µm"),
            ("dahl_1um", 1e-6, 1e6, "µm"),
        ] {
            let amplitudes = match amplitude {
                420e-6 => "40 and 420 µm".to_owned(),
                one => in_prefix_short(one, "m"),
            };
            let mut chart = Chart::new(
                format!("Loops of {amplitudes}"),
                format!("position, {unit}"),
                "force, N",
            );
            for (colour, curves) in all.iter().enumerate() {
                for found in &curves.loops {
                    let wanted = (found.amplitude / amplitude - 1.0).abs() < 0.05
                        || amplitude == 420e-6 && (found.amplitude / 40e-6 - 1.0).abs() < 0.05;
                    if wanted {
                        let name = guide_label(&curves.name);
                        let first = chart.series.iter().all(|series| series.name != name);
                        let label = if first { name } else { String::new() };
                        let closed = found.points.iter().chain(found.points.first());
                        chart.add(label, colour, Style::Line, closed.map(|(x, f)| (scale * x, *f)));
                    }
                }
            }
            self.figure(
                name,
                &chart,
                &format!("Measured loops of {amplitudes} (averaged over the cycles)."),
            )?;
        }
        let mut stiffness =
            Chart::new("Effective stiffness", "amplitude, µm", "effective stiffness, N/m")
                .logarithmic(true, true);
        let mut area = Chart::new("Loop area", "amplitude, µm", "loop area, J per cycle")
            .logarithmic(true, true);
        let mut damping = Chart::new(
            "Damping ratio of the stage's Dahl resonance, from the loops",
            "amplitude, µm",
            "damping ratio",
        )
        .logarithmic(true, false);
        for (colour, curves) in all.iter().enumerate() {
            let name = &guide_label(&curves.name);
            let resolved = || {
                curves
                    .loops
                    .iter()
                    .zip(&curves.resonances)
                    .filter(|(found, _)| found.area_is_resolved)
            };
            stiffness.add(
                name,
                colour,
                Style::Marks,
                curves.loops.iter().map(|found| (1e6 * found.amplitude, found.stiffness.value)),
            );
            area.add(
                name,
                colour,
                Style::Marks,
                resolved().map(|(found, _)| (1e6 * found.amplitude, found.area.value)),
            );
            damping.add(
                name,
                colour,
                Style::Both,
                resolved().map(|(found, r)| (1e6 * found.amplitude, r.damping.value)),
            );
            let specimen = specimens.iter().find(|of| of.name == curves.name);
            if let Some(bristles) = specimen.map(Specimen::bristles).transpose()?.flatten() {
                let amplitudes: Vec<f64> =
                    (0..100).map(|k| 1e-8 * 10f64.powf(5.0 * f64::from(k) / 99.0)).collect();
                let curve = |law: &dyn Fn(f64) -> f64| -> Vec<(f64, f64)> {
                    amplitudes.iter().map(|a| (1e6 * a, law(*a))).collect()
                };
                let sum = |law: &dyn Fn(&Guide) -> f64| bristles.iter().map(law).sum::<f64>();
                let of_loops = curve(&|a| sum(&|bristle| bristle.effective_stiffness(a)));
                stiffness.add("", colour, Style::Dashed, of_loops);
                area.add(
                    "",
                    colour,
                    Style::Dashed,
                    curve(&|a| sum(&|bristle| bristle.loop_area(a))).into_iter().skip(30),
                );
            }
        }
        stiffness.dashed_are(LAW);
        area.dashed_are(LAW);
        self.figure(
            "dahl_stiffness",
            &stiffness,
            "Effective stiffness over amplitude; dashed: the law.",
        )?;
        self.figure(
            "dahl_area",
            &area,
            "Loop area over amplitude, where it stands out of the noise; dashed: the law.",
        )?;
        self.figure(
            "dahl_damping",
            &damping,
            "Equivalent damping W/(2\u{3c0} k A\u{b2}) of the hysteresis alone.",
        )?;
        let mut table = Table::new(&[
            ("guide", Left),
            ("amplitude", Left),
            ("stiffness, N/m", Right),
            ("standard error", Right),
            ("tip force, N", Right),
            ("loop area, J", Right),
            ("resonance, Hz", Right),
            ("damping ratio", Right),
        ]);
        for curves in all {
            for (found, resonance) in curves.loops.iter().zip(&curves.resonances) {
                let resolved = |text: String| {
                    Cell::text(if found.area_is_resolved { text } else { "\u{2013}".into() })
                };
                table.row([
                    Cell::text(guide_label(&curves.name)),
                    Cell::text(in_prefix_short(found.amplitude, "m")),
                    Cell::text(format!("{:.3e}", found.stiffness.value)),
                    Cell::text(format!(
                        "{:.2} %",
                        100.0 * found.stiffness.standard_error / found.stiffness.value
                    )),
                    Cell::number(found.tip_force.value, 3),
                    resolved(format!("{:.3e}", found.area.value)),
                    Cell::number(resonance.frequency, 2),
                    resolved(format!("{:.3}", resonance.damping.value)),
                ]);
            }
        }
        self.page.table(&table);
        Ok(())
    }

    fn frequency_response(&mut self) -> Result<(), ReportError> {
        let all = &self.summary.results.frequency_response;
        if all.is_empty() {
            return Ok(());
        }
        self.page.section("Frequency response");
        self.page.text(
            "The stage under a sinusoidal motor force, without a controller. Below the Dahl \
             resonance the response is that of the guides' stiffness, above it that of the mass. \
             With the amplitude the resonance falls and its damping grows.",
        );
        let pi2 = 2.0 * std::f64::consts::PI;
        let mut columns = vec![
            ("guide", Left),
            ("force, N", Right),
            ("amplitude, µm", Right),
            ("resonance, Hz", Right),
            ("damping ratio", Right),
        ];
        let has_loops = !self.summary.results.dahl.is_empty();
        if has_loops {
            columns.extend([("from the loops, Hz", Right), ("hysteresis, from the loops", Right)]);
        }
        let mut measured = Table::new(&columns);
        for (index, response) in all.iter().enumerate() {
            let mut chart = Chart::new(
                format!("Compliance: {}", guide_label(&response.name)),
                "frequency, Hz",
                "compliance |X/F|, m/N",
            )
            .logarithmic(true, true);
            for (colour, level) in response.levels.iter().enumerate() {
                let points = level
                    .points
                    .iter()
                    .map(|p| (p.frequency, p.stiffness.0.hypot(p.stiffness.1).recip()));
                chart.add(format!("{:.2} N", level.force), colour, Style::Both, points);
            }
            for level in &response.levels {
                // The largest amplitude and the smallest: those between would lie on them.
                let ends = [response.levels.first(), response.levels.last()];
                if let (Some(found), true) = (level.resonance, ends.contains(&Some(level))) {
                    let curve: Vec<_> = level
                        .points
                        .iter()
                        .map(|p| (p.frequency, p.stiffness.0.hypot(p.stiffness.1).recip()))
                        .collect();
                    if let Some(height) = between(&curve, found.frequency) {
                        let word = format!("{:.1} Hz at {:.2} N", found.frequency, level.force);
                        chart.label((found.frequency, height), word);
                    }
                }
            }
            let line = response.levels[0].points.iter();
            let mass =
                line.map(|p| (p.frequency, 1.0 / (response.mass * (pi2 * p.frequency).powi(2))));
            chart.add(
                format!("free mass, {:.2} kg", response.mass),
                4,
                Style::Dashed,
                mass.skip(8),
            );
            let name = format!("frequency_response_{}", index + 1);
            self.figure(
                &name,
                &chart,
                &format!(
                    "Stage on {}: response at four force amplitudes; thin and dashed: a free mass.",
                    guide_label(&response.name)
                ),
            )?;
            let mut phases = Chart::new(
                format!("Phase: {}", guide_label(&response.name)),
                "frequency, Hz",
                "phase of X/F, degrees",
            )
            .logarithmic(true, false);
            for (colour, level) in response.levels.iter().enumerate() {
                let points = level.points.iter().map(|p| (p.frequency, p.phase));
                phases.add(format!("{:.2} N", level.force), colour, Style::Both, points);
            }
            let least = response.levels.iter().flat_map(|level| &level.points);
            let least = least.map(|point| point.coherence).fold(1.0, f64::min);
            self.figure(
                &format!("frequency_response_phase_{}", index + 1),
                &phases,
                &format!(
                    "Stage on {}: phase of the position against the force; 0 is a spring, -180 a \
                     mass. The coherence is at least {least:.4}.",
                    response.name
                ),
            )?;
            let dahl = self.summary.results.dahl.iter().find(|curves| curves.name == response.name);
            for level in &response.levels {
                // Between two loops: straight lines over the logarithm of the amplitude.
                let predicted = level.resonance.zip(dahl).and_then(|(found, curves)| {
                    let pair = curves
                        .resonances
                        .windows(2)
                        .find(|p| (p[0].amplitude..p[1].amplitude).contains(&found.amplitude))?;
                    let u = (found.amplitude / pair[0].amplitude).ln()
                        / (pair[1].amplitude / pair[0].amplitude).ln();
                    let between = |a: f64, b: f64| a + u * (b - a);
                    Some((
                        between(pair[0].frequency, pair[1].frequency),
                        between(pair[0].damping.value, pair[1].damping.value),
                    ))
                });
                // A row takes as many cells as the table has columns.
                measured.row([
                    Cell::text(guide_label(&response.name)),
                    Cell::number(level.force, 2),
                    Cell::maybe(level.resonance.map(|r| 1e6 * r.amplitude), 2),
                    Cell::maybe(level.resonance.map(|r| r.frequency), 2),
                    Cell::maybe(level.resonance.map(|r| r.damping), 3),
                    Cell::maybe(predicted.map(|p| p.0), 2),
                    Cell::maybe(predicted.map(|p| p.1), 3),
                ]);
            }
        }
        self.page.table(&measured);
        self.page.text(if has_loops {
            "The slow loops show hysteresis only. At the resonance the bristle damping \u{3c3}1 \
             adds to it, which is the larger part at small amplitudes. A dash: the stage has \
             broken away and has no spring left, or no loops of its guide were measured."
        } else {
            "A dash: the stage has broken away and has no spring left."
        });
        Ok(())
    }

    fn fast_move(&mut self) -> Result<(), ReportError> {
        let all = &self.summary.results.fast_move;
        if all.is_empty() {
            return Ok(());
        }
        self.page.section("Fast move");
        self.page.text(&match self.summary.own_move {
            None => "50 mm in 100 ms after a return move and a rest; 60 Hz PID with lowpass and \
                     ideal mass feedforward."
                .to_owned(),
            Some(OwnMove { distance, duration }) => format!(
                "{} mm in {} ms after a return move and a rest; PID with lowpass and ideal mass \
                 feedforward.",
                distance * 1e3,
                duration * 1e3
            ),
        });
        for (fed, name, title) in [
            (false, "fast_move", "Fast move: position error"),
            (
                true,
                "fast_move_with_viscous_feedforward",
                "Fast move with viscous feedforward: position error",
            ),
        ] {
            let mut chart =
                Chart::new(title, "time after the start of the move, ms", "position error, µm");
            for (colour, found) in
                all.iter().filter(|found| (found.viscous_feedforward > 0.0) == fed).enumerate()
            {
                let part = found.points.iter().filter(|(t, _)| *t < 0.3);
                chart.add(
                    guide_label(&found.name),
                    colour,
                    Style::Line,
                    part.map(|(t, e)| (1e3 * t, 1e6 * e)),
                );
            }
            settling_bands(&mut chart, JointType::Prismatic);
            let caption = match (fed, self.summary.own_move.is_some()) {
                (true, false) => {
                    "With viscous feedforward the wave between 25 and 150 ms disappears."
                }
                (true, true) => "With viscous feedforward.",
                (false, true) => "Position error after the reference has started.",
                (false, false) => "As Figure 6 of the MI-Partners paper.",
            };
            self.figure(name, &chart, caption)?;
        }
        let mut settling = Chart::new(
            "Fast move: time to settle over the band",
            "band, µm",
            "time after arrival, ms",
        )
        .logarithmic(true, false);
        let mut table = Table::new(&[
            ("guide", Left),
            ("viscous feedforward, N s/m", Right),
            ("peak, µm", Right),
            ("return, µm", Right),
            ("rms 25 to 150 ms, µm", Right),
            ("settled to 10 µm, ms", Right),
            ("settled to 1 µm, ms", Right),
            ("settled to 0.1 µm, ms", Right),
        ]);
        for (index, found) in all.iter().enumerate() {
            if found.viscous_feedforward == 0.0 {
                let points = found
                    .settling_over_band
                    .iter()
                    .filter_map(|(band, time)| Some((1e6 * band, 1e3 * (*time)?)));
                settling.add(guide_label(&found.name), index / 2, Style::Both, points);
            }
            let [ten, one, tenth] =
                found.forward.settling.map(|time| Cell::maybe(time.map(|t| 1e3 * t), 1));
            table.row([
                Cell::text(guide_label(&found.name)),
                Cell::number(found.viscous_feedforward, 1),
                Cell::number(1e6 * found.forward.peak_error, 2),
                Cell::number(1e6 * found.return_move.peak_error, 2),
                Cell::number(1e6 * found.wave_rms, 2),
                ten,
                one,
                tenth,
            ]);
        }
        self.page.table(&table);
        self.figure("fast_move_settling", &settling, "Who settles first depends on the band.")
    }

    fn fine_step(&mut self) -> Result<(), ReportError> {
        let all = &self.summary.results.fine_step;
        if all.is_empty() {
            return Ok(());
        }
        self.page.section("Fine step");
        self.page.text(&match self.summary.own_move {
            None => {
                "10 µm in 3 ms, five in a row, after a return move and a rest. The guides work \
                     as springs here."
                    .to_owned()
            }
            Some(OwnMove { distance, duration }) => format!(
                "{} µm in {} ms, five in a row, after a return move and a rest.",
                distance * 1e6,
                duration * 1e3
            ),
        });
        for (fed, name) in [(false, "fine_step"), (true, "fine_step_with_viscous_feedforward")] {
            let title = if fed {
                "First fine step with viscous feedforward"
            } else {
                "First fine step: position error"
            };
            let mut chart =
                Chart::new(title, "time after the start of the step, ms", "position error, µm");
            for (colour, found) in
                all.iter().filter(|found| (found.viscous_feedforward > 0.0) == fed).enumerate()
            {
                let part = found.points.iter().filter(|(t, _)| *t < 0.2);
                chart.add(
                    guide_label(&found.name),
                    colour,
                    Style::Line,
                    part.map(|(t, e)| (1e3 * t, 1e6 * e)),
                );
            }
            settling_bands(&mut chart, JointType::Prismatic);
            let caption = match (fed, self.summary.own_move.is_some()) {
                (true, _) => "With viscous feedforward.",
                (false, true) => "Position error after the reference has started.",
                (false, false) => "As Figure 7 of the MI-Partners paper.",
            };
            self.figure(name, &chart, caption)?;
        }
        let mut table = Table::new(&[
            ("guide", Left),
            ("viscous feedforward, N s/m", Right),
            ("step", Right),
            ("peak, µm", Right),
            ("settled to 10 µm, ms", Right),
            ("settled to 1 µm, ms", Right),
            ("settled to 0.1 µm, ms", Right),
        ])
        .captioned(format!(
            "Time to settle into {} bands after the arrival of the reference",
            SETTLING_BANDS.len()
        ));
        for found in all {
            for (index, step) in found.steps.iter().enumerate() {
                let [ten, one, tenth] =
                    step.settling.map(|time| Cell::maybe(time.map(|t| 1e3 * t), 1));
                table.row([
                    Cell::text(guide_label(&found.name)),
                    Cell::number(found.viscous_feedforward, 1),
                    Cell::number((index + 1) as f64, 0),
                    Cell::number(1e6 * step.peak_error, 2),
                    ten,
                    one,
                    tenth,
                ]);
            }
        }
        self.page.table(&table);
        Ok(())
    }

    fn hunting(&mut self) -> Result<(), ReportError> {
        let all = &self.summary.results.hunting;
        if all.is_empty() {
            return Ok(());
        }
        self.page.section("Hunting");
        self.page.text(
            "The stage rests near its target where only the integrator can move it. At the 60 Hz \
             of the paper the guides' own stiffness keeps every stage at rest; with a softer \
             controller and more integral action a stage on guides with a falling F(v) may stick \
             and slip without end. Integral gain x 1: its corner at a tenth of the bandwidth, as \
             in the moves.",
        );
        let mut table = Table::new(&[
            ("guide", Left),
            ("bandwidth, Hz", Right),
            ("integral gain", Right),
            ("", Left),
            ("amplitude, mm", Right),
            ("period, s", Right),
        ]);
        for hunting in all {
            for result in &hunting.results {
                table.row([
                    Cell::text(guide_label(&hunting.name)),
                    Cell::number(result.bandwidth, 0),
                    Cell::text(format!("\u{d7} {}", result.integral)),
                    match result.cycle {
                        Some(_) => Cell::badge(Mark::Warning, "hunts"),
                        None => Cell::badge(Mark::Good, "comes to rest"),
                    },
                    Cell::maybe(result.cycle.map(|cycle| 1e3 * cycle.amplitude), 3),
                    Cell::maybe(result.cycle.map(|cycle| cycle.period), 2),
                ]);
            }
        }
        self.page.table(&table);
        let softest = all[0].results.len() - 1;
        let mut chart = Chart::new(
            format!(
                "Error at rest, {} Hz, integral gain \u{d7} {}",
                all[0].results[softest].bandwidth, all[0].results[softest].integral
            ),
            "time after the step, s",
            "position error, mm",
        );
        for (colour, hunting) in all.iter().enumerate() {
            let points = &hunting.results[softest].points;
            // What is judged; the way to the target before would hide a cycle.
            let judged = points[points.len() / 2..].iter().map(|(t, e)| (*t, 1e3 * e));
            chart.add(guide_label(&hunting.name), colour, Style::Line, judged);
        }
        self.figure(
            "hunting",
            &chart,
            "Position error with the softest controller, in the last half of the rest, by which it \
             is judged.",
        )
    }

    fn rig(&mut self) -> Result<(), ReportError> {
        let Some(first) = self.summary.results.rig.first() else { return Ok(()) };
        self.page.section("The rig's own bias");
        self.page.text(
            "Each row changes one property of the rig and measures what is known in closed form: \
             stiffness and area of a 1 µm loop, friction at 3 mm/s. The paper's rig has a \
             coupling 100 times as stiff as the guide and 0.05 N of noise.",
        );
        for rig in &self.summary.results.rig {
            self.page.subsection(&guide_label(&rig.name));
            let mut table = Table::new(&[
                ("changed", Left),
                ("to", Right),
                ("stiffness", Right),
                ("its standard error", Right),
                ("encoder at the motor", Right),
                ("loop area", Right),
                ("friction at 3 mm/s", Right),
                ("ripple, N", Right),
            ])
            .captioned("Percentages: measured less true, of the true value.");
            let percent = |value: Option<f64>| {
                Cell::text(value.map_or("\u{2013}".to_owned(), |value| signed_percent(value, 2)))
            };
            for row in &rig.biases {
                table.row([
                    Cell::text(row.property.as_ref()),
                    Cell::text(format!("{} {}", row.value, row.unit)),
                    percent(Some(row.stiffness_bias)),
                    Cell::text(format!("{:.2} %", 100.0 * row.stiffness_error)),
                    percent(Some(row.stiffness_bias_at_motor)),
                    percent(Some(row.area_bias)),
                    percent(row.friction_bias),
                    Cell::maybe(row.ripple, 3),
                ]);
            }
            self.page.table(&table);
        }
        self.page.subsection("Encoder and coupling");
        let mut chart = Chart::new(
            format!("Stiffness at 1 µm: {}", guide_label(&first.name)),
            "coupling over guide stiffness",
            "bias, %",
        )
        .logarithmic(true, false);
        let rows = || first.biases.iter().filter(|row| row.property == "coupling");
        chart.add(
            "encoder at the guide",
            0,
            Style::Both,
            rows().map(|r| (r.value, 100.0 * r.stiffness_bias)),
        );
        chart.add(
            "encoder at the motor",
            1,
            Style::Both,
            rows().map(|r| (r.value, 100.0 * r.stiffness_bias_at_motor)),
        );
        chart.add(
            "springs in series",
            1,
            Style::Dashed,
            rows().map(|r| (r.value, -100.0 / (1.0 + r.value))),
        );
        self.figure(
            "rig",
            &chart,
            "Why the encoder sits at the guide: read at the motor, guide and coupling are springs \
             in series.",
        )?;
        self.page.text(
            "Loop area: a servo of 60 Hz shakes the carriage by the encoder's noise about as fast \
             as a slow 1 µm loop moves, which relaxes the bristle and widens the loop; fast loops \
             are widened by the bristle damping. The experiment dahl therefore measures small \
             loops with a quiet 20 Hz servo.",
        );
        Ok(())
    }
}

/// Height of a curve at a place, by a straight line between its points on logarithmic axes.
fn between(curve: &[(f64, f64)], place: f64) -> Option<f64> {
    let around = curve.windows(2).find(|two| (two[0].0..=two[1].0).contains(&place))?;
    let (before, after) = (around[0], around[1]);
    let part = (place / before.0).ln() / (after.0 / before.0).ln();
    Some(before.1 * (after.1 / before.1).powf(part))
}
