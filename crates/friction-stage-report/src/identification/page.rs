//! The report of an identification as one page.

use super::figures::{FigureGroup, IdentificationFigure};
use super::model_file::{GUIDES_TOGETHER, identified_model_file};
use super::{chosen, travel};
use crate::error::ReportError;
use crate::page::{Align, Cell, Mark, Page, Table, Tile};
use crate::words::{
    EffectGroup, effect_groups, effect_phrases, four_digits, harmonic_name, short, times_noise,
};
use friction_stage_core::model::{CurveSide, JointType, StageModel};
use friction_stage_core::plant::EffectDescriptor;
use friction_stage_identify::{
    Criteria, Evidence, Hypothesis, Identification, Inseparable, NextExperiment, NominalParameter,
    Outcome, Record, Records, Selection, Summary, SummaryFinding, Tolerances, Verdict, in_digits,
    readable, side_name, taking_part,
};

/// Finding that says where a residual sits.
const RESIDUAL_LOCATION: &str = "residual_location";

/// What a candidate must explain on each record, in words.
const LEAST_SHARE: &str = "a fifth of what is left of either record (half beside a curve)";

/// The page: verdict, effects, errors, parameters, figures, candidates. `name` is what the user
/// calls the declared model.
pub fn identification_page(
    name: &str,
    identification: &Identification,
    records: &Records,
    summary: &Summary,
    figures: &[IdentificationFigure],
) -> Result<String, ReportError> {
    let (declared, identified) = (identification.declared(), identification.found_model());
    let selection = &identification.selection;
    let n = summary.joint.unit("N");
    let paths = |paths: &[std::path::PathBuf]| {
        paths.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ")
    };
    let (train, holdout) = (&records.train, &records.holdout);
    let mut page = Page::new(
        format!("What \u{201c}{}\u{201d} lacks", declared.name),
        format!(
            "declared model {name}, identified on {}, judged on {}",
            paths(&train.paths),
            paths(&holdout.paths)
        ),
    );
    page.section("Verdict");
    verdict(&mut page, selection, summary);
    page.section("Effects");
    effects(&mut page, selection, summary);
    page.section("Errors before and after");
    errors(&mut page, summary);
    page.section("Declared parameters");
    parameters(&mut page, declared, selection, summary, train.measured.rate)?;
    for (group, title) in [
        (FigureGroup::Comparison, "What the models miss"),
        (FigureGroup::Residual, "Residual"),
        (FigureGroup::Spectrum, "Spectra of the residual"),
    ] {
        page.section(title);
        for figure in figures.iter().filter(|figure| figure.group == group) {
            page.figure(&figure.chart, &figure.caption)?;
        }
    }
    page.section("Candidates");
    candidates(&mut page, selection, &n);
    if let Some(next) = &summary.next_experiment {
        page.section("Next experiment");
        next_experiment(&mut page, next, summary.joint);
    }
    page.section("Data and method");
    let record = |record: &Record| {
        let measured = &record.measured;
        format!(
            "{} samples at {:.3} Hz, {} rows compared at {:.1} Hz",
            measured.len(),
            measured.rate,
            measured.rows.len(),
            measured.lowpass.kept_rate()
        )
    };
    page.facts([
        ("program", format!("friction-stage {}", env!("CARGO_PKG_VERSION"))),
        ("train", record(train)),
        ("hold-out", record(holdout)),
        (
            "force",
            if train.measured.cell.is_some() {
                "cell and command"
            } else {
                "one force only: the sides cannot be told apart"
            }
            .to_owned(),
        ),
        (
            "noise floor of the residual",
            format!(
                "motor side {} {n}, carriage side {} {n}, from the noise of the sensors",
                short(selection.floor.motor),
                short(selection.floor.carriage)
            ),
        ),
        ("identified model", summary.model.clone()),
    ]);
    page.text(&format!(
        "Friction and effects are driven along the measured motion; measured and modelled forces \
         pass the same zero-phase lowpass. A candidate is fitted on the side where it acts, \
         together with what else moves that side; the one that is chosen is refitted with \
         everything, all declared parameters within their tolerances. It is kept only if it lowers \
         the error on the train record and on the hold-out, which no fit has seen, by more than \
         chance, the noise floor of the sensors and {LEAST_SHARE}; of laws that explain about the \
         same the simplest is taken.",
    ));
    page.subsection("Identified model");
    for note in identified.notes()? {
        page.note(Mark::Neutral, &note);
    }
    if identified.guides.len() > 1 {
        page.text(GUIDES_TOGETHER);
    }
    page.code(&identified_model_file(identified, summary)?);
    Ok(page.finish())
}

fn verdict(page: &mut Page, selection: &Selection, summary: &Summary) {
    let n = summary.joint.unit("N");
    let names = effect_phrases(&summary.effects, summary.joint).join("; ");
    let (mark, sentence) = match selection.verdict {
        Verdict::Found => (Mark::Good, format!("The declared model lacks: {names}.")),
        Verdict::None => {
            // The number of the table below.
            let left = summary.errors.holdout.force_rms.after;
            let left = left.unwrap_or_else(|| selection.errors_after.holdout().sqrt());
            let floor = times_noise(left, selection.floor.total());
            let open = selection.left_open.map_or(String::new(), |open| {
                format!("; after a fit to this train record {} {n} are open there", short(open))
            });
            let is_clean = open.is_empty() && !selection.leaves_more_than_usual();
            let mark = if is_clean { Mark::Good } else { Mark::Warning };
            let can = if is_clean { "show" } else { "can name" };
            let sentence = format!(
                "Nothing is missing that these data {can}: the refitted model leaves {} {n}, \
                 {floor}{open}.",
                short(left)
            );
            (mark, sentence)
        }
        Verdict::Unknown => (
            Mark::Warning,
            match selection.coordinate {
                Some(coordinate) => format!(
                    "No law of the list explains a force that depends on the {}; an empirical map \
                     stands for it. Found so far: {names}.",
                    coordinate.name()
                ),
                None if names.is_empty() => {
                    "A force is missing that no law of the list and no map explains: what is left \
                     is more than noise."
                        .to_owned()
                }
                None => format!(
                    "A force is missing that no law of the list and no map explains: what is left \
                     is more than noise. Found so far: {names}, which is not all of it."
                ),
            },
        ),
        Verdict::NotSeparable => (Mark::Warning, not_separable(selection, &names)),
    };
    if selection.stopped {
        page.note(
            Mark::Bad,
            "Partial report: the search was stopped before its end. The verdict is that of what \
             had been tried.",
        );
    }
    // What no law explains has a place, though it has no name: it stands in the same box.
    let is_place = |finding: &&SummaryFinding| {
        selection.verdict == Verdict::Unknown && finding.code == RESIDUAL_LOCATION
    };
    let places = summary.findings.iter().filter(is_place).map(|finding| finding.text.as_str());
    let lines = std::iter::once(sentence.as_str()).chain(places);
    page.notes(mark, lines.map(|line| ("verdict", line)));
    let (force, position) = (summary.errors.holdout.force_rms, summary.errors.holdout.position_rms);
    let number = |value: Option<f64>| {
        value.map_or_else(|| "\u{2013}".to_owned(), |value| format!("{value:.3}"))
    };
    let better = |change: friction_stage_identify::Change| match (change.before, change.after) {
        (Some(before), Some(after)) if after < before => Mark::Good,
        (Some(before), Some(after)) if after > before => Mark::Bad,
        _ => Mark::Neutral,
    };
    let tile = |name: &str, value: String, detail: String, mark: Mark| Tile {
        name: name.to_owned(),
        value,
        detail,
        mark,
    };
    page.tiles(&[
        tile(
            "verdict",
            summary.verdict.replace('_', " "),
            if names.is_empty() { "no effect added".to_owned() } else { names },
            mark,
        ),
        tile(
            "force residual, hold-out",
            format!("{} {n}", number(force.after)),
            format!(
                "before {} {n}, noise floor {} {n}",
                number(force.before),
                short(summary.floor.force_rms)
            ),
            better(force),
        ),
        tile(
            "position error, hold-out",
            travel(position.after, summary.joint),
            format!("before {}", travel(position.before, summary.joint)),
            better(position),
        ),
        tile(
            "explained share",
            if summary.effects.is_empty() {
                "\u{2013}".to_owned()
            } else {
                format!("{:.1} %", 100.0 * summary.explained_share)
            },
            "of the held-out residual above the noise floor".to_owned(),
            if summary.effects.is_empty() {
                Mark::Neutral
            } else if summary.explained_share >= 1.0 - Criteria::USUAL.left_at_most {
                Mark::Good
            } else {
                Mark::Warning
            },
        ),
    ]);
    let (notes, warnings): (Vec<_>, Vec<_>) = summary
        .findings
        .iter()
        .filter(|finding| !is_place(finding))
        .partition(|finding| finding.is_note());
    let parts = [("Warnings", warnings, Mark::Warning), ("Notes", notes, Mark::Neutral)];
    for (title, findings, mark) in parts {
        if !findings.is_empty() {
            page.subsection(title);
            let texts =
                findings.iter().map(|finding| (finding.code.as_str(), finding.text.as_str()));
            page.notes(mark, texts);
        }
    }
}

fn interval(ci95: Option<[f64; 2]>) -> String {
    ci95.map_or_else(
        || "\u{2013}".to_owned(),
        |[low, high]| {
            format!(
                "{} \u{2026} {}",
                in_digits(low, Some([low, high])),
                in_digits(high, Some([low, high]))
            )
        },
    )
}

fn next_experiment(page: &mut Page, next: &NextExperiment, joint: JointType) {
    let [m, n, speed] = ["m", "N", "m/s"].map(|unit| joint.unit(unit));
    page.text(&format!(
        "The motion that settles most of what these data leave open, within the limits: {}, {:.1} \
         s between {} and {} {m}, up to {} {speed} and {} {n}.",
        next.file,
        next.duration,
        short(next.stroke[0]),
        short(next.stroke[1]),
        short(next.peak_speed),
        short(next.peak_force)
    ));
    let mut table =
        Table::new(&[("piece", Align::Left), ("motion", Align::Left), ("s", Align::Right)]);
    for segment in &next.segments {
        table.row([
            Cell::text(segment.kind.replace('_', " ")),
            Cell::text(&segment.description),
            Cell::number(segment.duration, 1),
        ]);
    }
    page.table(&table);
    if let Some(coordinate) = &next.coordinate {
        page.text(&format!(
            "It passes again and again over the {coordinate} of the force that no law explains."
        ));
    }
    let columns = |what: &'static str| {
        Table::new(&[
            (what, Align::Left),
            ("present record", Align::Right),
            ("this motion", Align::Right),
            ("", Align::Left),
        ])
    };
    if !next.rivals.is_empty() {
        let mut table = columns("effect against rival");
        for rival in &next.rivals {
            let badge = if rival.separates {
                Cell::badge(Mark::Good, "separates")
            } else {
                Cell::badge(Mark::Warning, "does not separate")
            };
            table.row([
                Cell::text(format!("{} against {}", rival.effect, rival.rival)),
                Cell::number(rival.before, 2),
                Cell::number(rival.after, 2),
                badge,
            ]);
        }
        page.table(&table.captioned(
            "Rms of the force that one of the two has and the other, refitted, cannot imitate, \
             over the noise floor of the sensors.",
        ));
    }
    if !next.parameters.is_empty() {
        let mut table = columns("parameter, half width of its 95 % interval");
        for parameter in &next.parameters {
            let reach = |value: Option<f64>| {
                value.map_or_else(|| "\u{2013}".to_owned(), |value| format!("{value:.3e}"))
            };
            table.row([
                Cell::code(&parameter.name),
                Cell::text(reach(parameter.before)),
                Cell::text(reach(parameter.after)),
                Cell::text(if parameter.unit == "1" { "of the value" } else { &parameter.unit }),
            ]);
        }
        page.table(&table);
    }
    if !next.untested.is_empty() {
        let mut table = columns("effect of a usual size");
        for shown in &next.untested {
            table.row([
                Cell::code(&shown.effect),
                Cell::number(shown.before, 2),
                Cell::number(shown.after, 2),
                Cell::text(""),
            ]);
        }
        page.table(&table.captioned(
            "Rms of what it would leave that the model cannot imitate, over the noise floor of the \
             sensors: these the present record shows least.",
        ));
    }
}

fn effects(page: &mut Page, selection: &Selection, summary: &Summary) {
    let n = summary.joint.unit("N");
    if summary.effects.is_empty() {
        page.text("No effect was added to the declared model.");
        return;
    }
    let added: Vec<_> = selection
        .after
        .fitted
        .hypothesis
        .effects
        .iter()
        .skip(selection.before.hypothesis.effects.len())
        .collect();
    for EffectGroup { phrase, members } in effect_groups(&summary.effects, summary.joint) {
        let first = &summary.effects[members[0].0];
        let curve = added.get(members[0].0).and_then(|part| part.curve());
        let place = match curve.map(|curve| curve.side) {
            Some(CurveSide::Friction) => "change of Coulomb friction".to_owned(),
            Some(CurveSide::Viscous) => "change of viscous friction".to_owned(),
            Some(CurveSide::Mass) => "change of the moving mass".to_owned(),
            _ => format!("{} side", first.side),
        };
        page.subsection(&format!("{phrase}, {place}"));
        let descriptor = EffectDescriptor::find(&first.name).ok();
        if let Some(descriptor) = descriptor {
            page.facts([
                ("law", descriptor.law),
                ("source", descriptor.source),
                ("telltale", descriptor.telltale),
            ]);
        }
        let mut table = Table::new(&[
            ("parameter", Align::Left),
            ("value", Align::Right),
            ("unit", Align::Left),
            ("95 % interval", Align::Right),
        ]);
        for (index, order) in &members {
            let effect = &summary.effects[*index];
            for name in taking_part(effect) {
                let Some(parameter) = effect.parameters.get(name) else { continue };
                let chosen = chosen(&effect.name, name, parameter.value);
                let value = in_digits(parameter.value, parameter.ci95);
                table.row([
                    Cell::code(match order {
                        1 => name.to_owned(),
                        _ => format!("{name}, {} harmonic", harmonic_name(*order)),
                    }),
                    Cell::text(chosen.map_or(value, str::to_owned)),
                    Cell::text(if chosen.is_some() { "" } else { &parameter.unit }),
                    Cell::text(interval(parameter.ci95)),
                ]);
            }
        }
        page.table(&table);
        for (index, order) in &members {
            let Some(other) = &summary.effects[*index].runner_up else { continue };
            let which = match order {
                _ if members.len() == 1 => "its place".to_owned(),
                1 => "the place of the fundamental".to_owned(),
                _ => format!("the place of the {} harmonic", harmonic_name(*order)),
            };
            page.text(&format!(
                "Next best in {which}: {}, which would leave {:.4} {n} rms on the hold-out: {} \
                 times less likely, each record and side as one measurement.",
                other.name,
                other.holdout_force_rms,
                readable(other.times_less_likely)
            ));
        }
    }
    for Inseparable { effect, rival, correlation } in &selection.inseparable {
        page.note(
            Mark::Warning,
            &format!(
                "{effect} and {rival} explain these data equally, their forces are correlated \
                 by {correlation:.4}: all values, the mass among them, hold if it is {effect}."
            ),
        );
    }
}

/// Which laws explain the data equally, and which of them the model has.
fn not_separable(selection: &Selection, names: &str) -> String {
    let pairs = selection.inseparable.iter();
    let pairs: Vec<_> = pairs.map(|pair| format!("{} and {}", pair.effect, pair.rival)).collect();
    let which = match pairs.is_empty() {
        true => "Several laws explain the data equally".to_owned(),
        false => {
            let reported = pairs.join("; ").replace('_', " ");
            format!("These laws explain the data equally: {reported}")
        }
    };
    format!("{which}. The identified model has {names}.")
}

fn errors(page: &mut Page, summary: &Summary) {
    let [m, n] = ["m", "N"].map(|unit| summary.joint.unit(unit));
    let mut table = Table::new(&[
        ("record", Align::Left),
        ("figure of merit", Align::Left),
        ("before", Align::Right),
        ("after", Align::Right),
        ("change", Align::Right),
        ("", Align::Left),
    ]);
    for (record, errors) in
        [("train", &summary.errors.train), ("hold-out", &summary.errors.holdout)]
    {
        let rows = [
            (format!("force residual, {n} rms"), errors.force_rms, 1.0, 4),
            ("force residual, % of the force".to_owned(), errors.force_relative, 1.0, 3),
            (format!("position in closed loop, µ{m} rms"), errors.position_rms, 1e6, 4),
        ];
        for (name, change, scale, digits) in rows {
            let (share, badge) = match (change.before, change.after) {
                (Some(before), Some(after)) => {
                    let share = if before > 0.0 { 100.0 * (after / before - 1.0) } else { 0.0 };
                    let badge = if after > before {
                        Cell::badge(Mark::Bad, "worse")
                    } else if after < before {
                        Cell::badge(Mark::Good, "better")
                    } else {
                        Cell::badge(Mark::Neutral, "same")
                    };
                    (Cell::text(format!("{share:+.1} %")), badge)
                }
                _ => (Cell::number(f64::NAN, 0), Cell::badge(Mark::Neutral, "not known")),
            };
            table.row([
                Cell::text(record),
                Cell::text(name),
                Cell::maybe(change.before.map(|value| value * scale), digits),
                Cell::maybe(change.after.map(|value| value * scale), digits),
                share,
                badge,
            ]);
        }
    }
    page.table(&table.captioned(
        "Before: the declared model, refitted. After: the identified model. No fit has seen the \
         hold-out record.",
    ));
    page.text(&format!(
        "The declared sensor noise alone leaves a force residual of {} {} rms.",
        short(summary.floor.force_rms),
        summary.joint.unit("N")
    ));
}

fn parameters(
    page: &mut Page,
    declared: &StageModel,
    selection: &Selection,
    summary: &Summary,
    rate: f64,
) -> Result<(), ReportError> {
    let stated = Hypothesis::new(declared, Tolerances::default())?;
    let mut table = Table::new(&[
        ("parameter", Align::Left),
        ("declared", Align::Right),
        ("refitted without the effects found", Align::Right),
        ("identified", Align::Right),
        ("unit", Align::Left),
        ("95 % interval", Align::Right),
    ]);
    for known in NominalParameter::ALL {
        let Some(parameter) = summary.declared_parameters.get(known.name()) else { continue };
        let alone = selection.before.hypothesis.declared_value(known, rate);
        table.row([
            Cell::code(known.name()),
            Cell::text(readable(stated.declared_value(known, rate))),
            Cell::text(in_digits(alone, parameter.ci95)),
            Cell::text(in_digits(parameter.value, parameter.ci95)),
            Cell::text(&parameter.unit),
            Cell::text(interval(parameter.ci95)),
        ]);
    }
    for (name, parameter) in
        summary.declared_parameters.iter().filter(|(name, _)| name.contains('.'))
    {
        let in_words = |value: f64, number: String| {
            // The second effect of a kind has `_2` after its name.
            let (label, parameter) = name.split_once('.').unwrap_or((name, ""));
            let kind = label.trim_end_matches(|c: char| c.is_ascii_digit()).trim_end_matches('_');
            let word = chosen(label, parameter, value).or_else(|| chosen(kind, parameter, value));
            word.map_or(number, str::to_owned)
        };
        let of = |hypothesis: &Hypothesis| {
            let value = hypothesis.effect_value(name)?;
            Some(in_words(value, in_digits(value, parameter.ci95)))
        };
        table.row([
            Cell::code(name),
            Cell::text(of(&stated).unwrap_or_default()),
            Cell::text(of(&selection.before.hypothesis).unwrap_or_default()),
            Cell::text(in_words(parameter.value, in_digits(parameter.value, parameter.ci95))),
            Cell::text(&parameter.unit),
            Cell::text(interval(parameter.ci95)),
        ]);
    }
    page.table(&table.captioned(
        "Of the guides: the mean over all of them. sensor_shift is the time by which the force \
         readings lag the encoder; it is no part of the model.",
    ));
    Ok(())
}

/// The square of a unit; a product in brackets.
fn squared(unit: &str) -> String {
    match unit.contains(' ') {
        true => format!("({unit})\u{b2}"),
        false => format!("{unit}\u{b2}"),
    }
}

fn candidates(page: &mut Page, selection: &Selection, n: &str) {
    let labels = [
        format!("train, {n} rms"),
        format!("hold-out, {n} rms"),
        format!("gain on train, {}", squared(n)),
        format!("gain on hold-out, {}", squared(n)),
    ];
    if selection.evidence.is_empty() {
        page.text(
            "No candidate proposed itself: the residual shows nothing of any law in the list.",
        );
        return;
    }
    let rounds = selection.evidence.iter().map(|one| one.round).max().map_or(0, |last| last + 1);
    for round in 0..rounds {
        let mut tried: Vec<&Evidence> =
            selection.evidence.iter().filter(|one| one.round == round).collect();
        tried.sort_by(|a, b| b.holdout_gain.total_cmp(&a.holdout_gain));
        page.subsection(&format!("Round {}", round + 1));
        let mut table = Table::new(&[
            ("candidate", Align::Left),
            ("side", Align::Left),
            ("free", Align::Right),
            (&labels[0], Align::Right),
            (&labels[1], Align::Right),
            (&labels[2], Align::Right),
            (&labels[3], Align::Right),
            ("outcome", Align::Left),
        ]);
        for one in tried {
            let (mark, word) = match one.outcome {
                Outcome::Chosen => (Mark::Good, "chosen"),
                Outcome::TooSmall => (Mark::Neutral, "too little"),
                Outcome::Beaten => (Mark::Neutral, "another does better"),
                Outcome::Equal => (Mark::Warning, "as good as the chosen one"),
                Outcome::Pruned => (Mark::Warning, "chosen, later superfluous"),
            };
            table.row([
                Cell::code(one.name),
                Cell::text(side_name(one.side)),
                Cell::text(one.free.to_string()),
                Cell::number(one.errors.train().sqrt(), 4),
                Cell::number(one.errors.holdout().sqrt(), 4),
                Cell::text(four_digits(one.train_gain)),
                Cell::text(four_digits(one.holdout_gain)),
                Cell::badge(mark, word),
            ]);
        }
        page.table(&table);
    }
    page.text(&format!(
        "Candidates that are not in a round saw nothing of their kind in the residual. The gain is \
         the fall of the mean square of the missing force with the candidate; it is too little \
         where it is within chance, below the noise floor of the sensors, less than {LEAST_SHARE} \
         or in one place of the train record alone. Ripples of several guides that were chosen \
         together stand with the gain of all of them.",
    ));
}
