//! Which motion would best settle what a recording leaves open?
//!
//! In come the result of a search, the record that it was made on, and limits for stroke, speed and
//! force; out goes a motion with what it is expected to settle. Candidates are short pieces of
//! motion, each simulated with the identified model. Along a piece the forces of the model and of a
//! rival differ by d; the rival may adapt its parameters within their bounds, to first order J, to
//! the present record and the new piece at once. What it cannot imitate, min |d - J p|^2, is the
//! evidence that the piece brings (T-optimality: Atkinson, Fedorov, Biometrika 62(1), 1975); for a
//! parameter it is the fall of its standard deviation (D-optimality, ibid.). Pieces are taken
//! greedily by evidence per second. Not covered: rivals that are not in the list of effects, and a
//! rival's behaviour far from its present fit.

mod agenda;
mod layout;
mod limits;
mod motion;
mod proposal;
mod questions;

use crate::record::measured::Measured;
use crate::search::{Selection, Verdict};
use agenda::Agenda;
use friction_stage_core::control::Point;
use friction_stage_core::model::StageModel;
use layout::Layout;
use motion::{Path, Segment};
use questions::Questions;

pub use limits::{DURATIONS, Limits, NextExperimentError};
pub use proposal::{NextExperiment, Plan, Planned, Separation, Sharpened, Shown};

/// Works out the motion that settles most of what the search on `train` left open.
pub fn plan(
    selection: &Selection,
    declared: &StageModel,
    train: &Measured,
    limits: Limits,
) -> Result<Plan, NextExperimentError> {
    let layout = Layout::new(selection, declared, train, limits)?;
    let stroke = layout.limits.stroke;
    let questions = Questions::new(selection, train)?;
    let nothing = || NextExperimentError::Nothing {
        low: limits.stroke.0,
        high: limits.stroke.1,
        speed: limits.speed,
        force: limits.force,
    };
    let candidates = agenda::candidates(&layout, &questions)?;
    let simplest = candidates.first().ok_or_else(nothing)?.segment;

    let agenda = Agenda::new(selection, &questions, train)?;
    let mut pieces = agenda.choose(&candidates, &layout.repeated(selection), &layout);
    // Nothing is open, or no motion tells: then for what the data have not shown.
    let settled = pieces.is_empty();
    if settled {
        pieces = agenda.choose_for_untested(&candidates, &layout);
    }
    if pieces.is_empty() {
        pieces = vec![simplest];
    }

    // Pieces that keep to the limits one by one may not do so behind each other.
    let (path, run) = loop {
        let path = layout.compose(&pieces, layout.middle());
        let way = layout.approach(layout.middle(), pieces[0].start(stroke)).seconds();
        match layout.simulate(&path, layout.middle(), way)? {
            Some(run) => break (path, run),
            None if pieces.len() > 1 => drop(pieces.pop()),
            None => return Err(nothing()),
        }
    };
    let new = questions.sums(&run.measured)?;
    let planned = |piece: &Segment| {
        let mut alone = Path::at(piece.start(stroke));
        piece.follow(&mut alone, layout.gentle);
        Planned {
            kind: piece.kind().to_owned(),
            description: piece.description(),
            duration: alone.seconds(),
        }
    };
    let unexplained = selection.coordinate.filter(|_| selection.verdict == Verdict::Unknown);
    Ok(Plan {
        next: NextExperiment {
            file: String::new(),
            duration: path.seconds(),
            stroke: [run.range.0, run.range.1],
            peak_speed: run.peak_speed,
            peak_force: run.peak_force,
            segments: pieces.iter().map(planned).collect(),
            rivals: agenda.separations(&new),
            parameters: agenda.sharpened(&new),
            untested: if settled { agenda.shown(&new) } else { Vec::new() },
            coordinate: unexplained.map(|coordinate| coordinate.name().to_owned()),
        },
        points: path.points,
    })
}

/// The motion as a `trajectory_msgs/JointTrajectory` in YAML, as `ros2 topic pub` and
/// `set_message_fields` take it, behind lines of comment. Numbers with a decimal point and without
/// an exponent, which every YAML reader takes for numbers.
pub fn trajectory_yaml(points: &[Point], joint: &str, comments: &[String]) -> String {
    let mut text: String = comments.iter().map(|line| format!("# {line}\n")).collect();
    text.push_str(&format!("joint_names: [{joint}]\npoints:\n"));
    for point in points {
        text.push_str(&format!("- positions: [{:.12}]\n", point.position));
        for (key, value) in [("velocities", point.velocity), ("accelerations", point.acceleration)]
        {
            if let Some(value) = value {
                text.push_str(&format!("  {key}: [{value:.12}]\n"));
            }
        }
        if point.effort != 0.0 {
            text.push_str(&format!("  effort: [{:.9}]\n", point.effort));
        }
        let (seconds, nanoseconds) =
            (point.time.div_euclid(1_000_000_000), point.time.rem_euclid(1_000_000_000));
        text.push_str(&format!("  time_from_start: {{sec: {seconds}, nanosec: {nanoseconds}}}\n"));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::agenda::MOST_UNTESTED;
    use super::motion::REST;
    use super::questions::Subject;
    use super::*;
    use crate::fit::{FitBudget, fit};
    use crate::hypothesis::{Hypothesis, Part, Sides};
    use crate::search::{Inseparable, Outcome};
    use crate::{Errors, Evidence, Selection, Tolerances};
    use friction_stage_core::control::{Controller, ControllerSettings, Follower, Trajectory};
    use friction_stage_core::plant::{EffectDescriptor, Rates, Side, Stage};
    use friction_stage_data::signals::Trace;

    fn limits() -> Limits {
        Limits { stroke: (-0.05, 0.05), speed: 1.0, force: 1500.0, duration: 20.0 }
    }

    #[test]
    fn impossible_limits_are_refused_with_what_would_be_right() {
        let model = StageModel::default();
        assert!(limits().check(&model).is_ok());
        let wrong = [
            (Limits { stroke: (0.05, -0.05), ..limits() }, ["upside down", "at least"]),
            (Limits { stroke: (0.0, 1e-5), ..limits() }, ["too short", "at least"]),
            (Limits { speed: 0.0, ..limits() }, ["speed is 0 m/s", "at least 1e-4"]),
            (Limits { speed: f64::NAN, ..limits() }, ["speed is NaN", "finite"]),
            (Limits { force: 20.0, ..limits() }, ["force is 20 N", "friction"]),
            (Limits { force: 1e4, ..limits() }, ["force is 10000 N", "motor.force_limit"]),
            (Limits { duration: 0.1, ..limits() }, ["may take 0.1 s", "between 2 and 3600"]),
        ];
        for (limits, words) in wrong {
            let reported = limits.check(&model).unwrap_err().to_string();
            for word in words {
                assert!(reported.contains(word), "{word:?} is not in {reported:?}");
            }
        }
    }

    #[test]
    fn the_trajectory_is_yaml_that_takes_every_number_for_a_number() {
        let mut path = Path::at(0.0);
        path.run(-1e-6, 1e-4, 1.0);
        path.oscillate(1e-6, 2.0, 1);
        let text = trajectory_yaml(&path.points, "stage", &["what it is for".to_owned()]);
        assert!(
            text.starts_with(
                "# what it is for\njoint_names: [stage]\npoints:\n- positions: [-0.000001000000]\n"
            ),
            "{text}"
        );
        for line in text.lines().filter(|line| line.contains("positions") || line.contains("ties"))
        {
            let number = line.split(['[', ']']).nth(1).unwrap();
            assert!(
                number.contains('.') && !number.contains('e') && number.parse::<f64>().is_ok(),
                "{line}"
            );
        }
        assert_eq!(text.matches("time_from_start").count(), path.points.len());
    }

    const RATE: f64 = 2000.0;

    /// A recording of a stage with hidden effects under our own controller.
    fn record(declared: &StageModel, hidden: &[(&str, &[(&str, f64)])], path: &Path) -> Measured {
        let mut model = declared.clone();
        model.effects = hidden
            .iter()
            .map(|(name, values)| {
                friction_stage_core::model::EffectParameters::new(name, values.iter().copied())
            })
            .collect();
        let mut stage = Stage::new(&model, Rates::new(RATE, 40_000.0).unwrap(), 5).unwrap();
        let mut controller =
            Controller::new(ControllerSettings::paper(40.0, RATE, 2000.0)).unwrap();
        let mut follower = Follower::new(f64::INFINITY);
        let mut trace = Trace::default();
        while trace.time.last().is_none_or(|time| *time < path.seconds()) {
            let sample = stage.sample();
            if trace.is_empty() {
                follower.hold(0, sample.position);
                follower.follow(0, Trajectory::new(0, path.points.clone()).unwrap()).unwrap();
            }
            let terms = controller.update(sample.time, sample.position, &mut follower);
            trace.push(&sample, &terms);
            stage.advance(terms.output);
        }
        Measured::new(&trace, declared, "the record").unwrap()
    }

    fn slow() -> Path {
        to_and_fro(0.004)
    }

    /// So gentle that the mass does not show.
    fn crawling() -> Path {
        to_and_fro(0.0005)
    }

    fn to_and_fro(way: f64) -> Path {
        let mut path = Path::at(0.0);
        for way in [2.0 * way, -3.0 * way, way] {
            path.to(1.5, way, 0.0, 0.0);
            path.rest(REST);
        }
        path
    }

    fn fast() -> Path {
        let mut path = Path::at(0.0);
        for way in [0.03, -0.03, 0.03, -0.03] {
            path.to(0.12, way, 0.0, 0.0);
            path.rest(REST);
        }
        path.run(0.02, 0.02, 5.0);
        path
    }

    fn part(name: &str, values: &[f64]) -> Part {
        Part { descriptor: EffectDescriptor::find(name).unwrap(), values: values.to_vec() }
    }

    /// What a search would say that has found these effects, with rivals that are as good.
    fn found(
        tolerances: Tolerances,
        declared: &StageModel,
        train: &Measured,
        effects: &[Part],
        rivals: &[Part],
        verdict: Verdict,
    ) -> Selection {
        let sides = Sides::BOTH;
        let hypothesis = Hypothesis::new(declared, tolerances).unwrap();
        let before = fit(&hypothesis, train, sides, FitBudget::COMPARED).unwrap();
        let with = effects
            .iter()
            .fold(before.hypothesis.clone(), |hypothesis, part| hypothesis.with(part.clone()));
        let after =
            fit(&with, train, sides, FitBudget::COMPARED).unwrap().estimate(train, sides).unwrap();
        let one = |part: &Part, outcome| Evidence {
            round: 0,
            name: part.descriptor.name,
            side: Side::Carriage,
            free: 1,
            part: part.clone(),
            errors: Errors::default(),
            train_gain: 1.0,
            holdout_gain: 1.0,
            fall: 1.0,
            outcome,
        };
        let evidence = effects.iter().map(|part| one(part, Outcome::Chosen));
        let evidence =
            evidence.chain(rivals.iter().map(|part| one(part, Outcome::Equal))).collect();
        // The rivals are those of the first effect, if there is one.
        let pairs = effects
            .iter()
            .take(1)
            .flat_map(|effect| rivals.iter().map(move |rival| (effect, rival)));
        let inseparable = pairs
            .map(|(effect, rival)| {
                let (effect, rival) = (effect.descriptor.name, rival.descriptor.name);
                Inseparable { effect, rival, correlation: 1.0 }
            })
            .collect();
        Selection {
            verdict,
            before,
            usable: after.fitted.hypothesis.clone(),
            after,
            errors_before: Errors::default(),
            errors_within_tolerance: None,
            errors_after: Errors::default(),
            evidence,
            coordinate: effects.iter().find_map(|part| part.curve().map(|curve| curve.coordinate)),
            runners_up: vec![None; effects.len()],
            inseparable,
            unproven: Vec::new(),
            floor: train.floor(declared),
            train_floor: train.floor(declared),
            wander_of_zero: None,
            declared_floor: train.declared_floor(declared),
            left_open: None,
            at_bound: false,
            stopped: false,
        }
    }

    #[test]
    fn gains_of_motor_and_cell_are_alike_in_slow_moves_and_told_apart_by_accelerations() {
        let declared = StageModel::default();
        let train = record(&declared, &[("motor_gain", &[("fraction", 0.03)])], &slow());
        let (motor, cell) = (part("motor_gain", &[0.03]), part("force_cell_gain", &[0.03]));
        let selection = found(
            Tolerances::default(),
            &declared,
            &train,
            &[motor],
            &[cell],
            Verdict::NotSeparable,
        );
        let limits = Limits { speed: 0.3, force: 700.0, duration: 5.0, ..limits() };
        let Plan { points, next } = plan(&selection, &declared, &train, limits).unwrap();
        let [rival] = next.rivals.as_slice() else { panic!("one rival: {next:?}") };
        assert_eq!(
            (rival.effect.as_str(), rival.rival.as_str()),
            ("motor_gain", "force_cell_gain")
        );
        assert!(rival.before < 2.0 && rival.after > 20.0 && rival.separates, "{next:#?}");
        // Within the limits, at the points and in between.
        assert!(next.peak_force <= limits.force && next.peak_speed <= limits.speed, "{next:#?}");
        assert!(
            next.stroke[0] >= limits.stroke.0 && next.stroke[1] <= limits.stroke.1,
            "{next:#?}"
        );
        assert!(
            next.duration < 2.0 * limits.duration && points.last().unwrap().velocity == Some(0.0),
            "{next:#?}"
        );
        // A limit that allows no more acceleration than the record had leaves the doubt, and says
        // so.
        let gentle = Limits { force: 90.0, speed: 0.02, ..limits };
        let next = plan(&selection, &declared, &train, gentle).unwrap().next;
        assert!(!next.rivals[0].separates, "{next:#?}");
    }

    #[test]
    fn what_the_tolerances_can_imitate_is_no_evidence() {
        let declared = StageModel::default();
        let train = record(&declared, &[], &slow());
        // Share of the force of 1 kg more that a model with this tolerance of its 40 kg cannot
        // imitate.
        let share = |mass: f64| {
            let tolerances = Tolerances { mass, ..Tolerances::default() };
            let selection = found(tolerances, &declared, &train, &[], &[], Verdict::None);
            let questions = Questions::new(&selection, &train).unwrap();
            let sums = questions.sums(&train).unwrap();
            let payload = questions
                .of(|subject| subject == Subject::Untested { effect: "payload" })
                .next()
                .unwrap();
            questions.separable(payload, &sums, &sums) / (sums.square[payload] / sums.rows as f64)
        };
        assert!(share(0.1) < 0.01, "{}", share(0.1));
        // 0.2 kg of 1 kg can be imitated: at least (0.8 - what friction takes on)^2 are left.
        assert!(share(0.005) > 0.2, "{}", share(0.005));
    }

    #[test]
    fn what_no_motion_tells_apart_is_not_promised() {
        let declared = StageModel::default();
        let train = record(&declared, &[("payload", &[("mass", 2.0)])], &fast());
        let (payload, scale) = (part("payload", &[2.0]), part("encoder_scale", &[-0.05]));
        let selection = found(
            Tolerances::default(),
            &declared,
            &train,
            &[payload],
            &[scale],
            Verdict::NotSeparable,
        );
        let next =
            plan(&selection, &declared, &train, Limits { duration: 6.0, ..limits() }).unwrap().next;
        assert!(!next.rivals.is_empty(), "{next:#?}");
        assert!(
            next.rivals.iter().all(|rival| !rival.separates && rival.after < 0.5 * rival.needed),
            "{next:#?}"
        );
    }

    #[test]
    fn a_mass_that_slow_moves_do_not_show_is_sharpened_by_accelerations() {
        let declared = StageModel::default();
        let train = record(&declared, &[], &crawling());
        let selection = found(Tolerances::default(), &declared, &train, &[], &[], Verdict::None);
        let next =
            plan(&selection, &declared, &train, Limits { duration: 5.0, ..limits() }).unwrap().next;
        let mass =
            next.parameters.iter().find(|one| one.name == "mass").expect("the mass is vague");
        let (before, after) = (mass.before.unwrap(), mass.after.unwrap());
        // A tolerance of 0.5 % is all that is known before.
        assert!(before > 0.0045 && after < 0.5 * before, "{next:#?}");
    }

    #[test]
    fn without_a_doubt_the_motion_shows_what_the_record_did_not() {
        let declared = StageModel::default();
        let train = record(&declared, &[], &slow());
        let selection = found(Tolerances::default(), &declared, &train, &[], &[], Verdict::None);
        let next =
            plan(&selection, &declared, &train, Limits { duration: 6.0, ..limits() }).unwrap().next;
        assert!(next.rivals.is_empty() && next.untested.len() == MOST_UNTESTED, "{next:#?}");
        // A structural mode is not seen in slow moves, which do not excite it.
        assert!(
            next.untested
                .iter()
                .any(|shown| shown.before < 0.5 && shown.after > 5.0 * shown.before),
            "{next:#?}"
        );
    }

    #[test]
    fn an_unexplained_force_over_position_is_passed_again_at_several_speeds_both_ways() {
        let declared = StageModel::default();
        let train = record(&declared, &[], &fast());
        let bump: Vec<f64> =
            [0.0, 0.0, 0.01, 0.03].into_iter().chain((0..9).map(|k| f64::from(k % 3))).collect();
        let mut selection = found(
            Tolerances::default(),
            &declared,
            &train,
            &[part("map", &bump)],
            &[],
            Verdict::Unknown,
        );
        selection.coordinate = Some(friction_stage_core::model::Coordinate::Position);
        let Plan { points, next } = plan(&selection, &declared, &train, limits()).unwrap();
        assert_eq!(next.coordinate.as_deref(), Some("position"));
        let passes: Vec<&Planned> =
            next.segments.iter().filter(|one| one.kind == "passes").collect();
        assert!(
            passes.len() >= 3 && passes[0].description.contains("from 10.0 mm to 30.0 mm"),
            "{next:#?}"
        );
        assert!(next.segments.iter().map(|one| one.duration).sum::<f64>() <= 20.0, "{next:#?}");
        let crossed = |sign: f64| {
            points.iter().filter(|one| one.velocity.is_some_and(|v| v * sign > 1e-3)).count()
        };
        assert!(crossed(1.0) >= 6 && crossed(-1.0) >= 6);
    }
}
