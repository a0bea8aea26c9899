//! `friction-stage identify` on recordings of a stage whose hidden effects were not declared,
//! at the process boundary: verdict, effects, errors before and after, and what bad input gets.
//!
//! The recordings stand in `FRICTION_STAGE_RECORDINGS`, else in `../shared/measured`; where they
//! are absent the tests that need them say so and pass. What the recordings hide was inferred from
//! their residuals, down to the noise of the sensors; amplitude and period below are what the force
//! cell itself shows.

use std::f64::consts::PI;
use std::path::Path;
use std::process::{Command, Output};

use friction_stage_core::model::{Coordinate, Guide, GuideSource, JointType, StageModel};
use friction_stage_core::plant::EffectDescriptor;
use friction_stage_identify::{
    Criteria, FitBudget, Hypothesis, Measured, Part, Selection, Sides, Silent, Tolerances, Verdict,
    fit, search,
};
use serde_json::Value;

use blind_tests::effects::{
    ActuatorLag, CableChain, Cogging, ConstantForce, DistributedBristles, EncoderSde,
    ExternalVibration, ForceCellGain, QuadraticDrag, RailJoint, SaturatingBrake, StictionAging,
    StructuralMode, ViscousWarmUp,
};
use blind_tests::guides::Slip;
use blind_tests::programme::Programme;
use blind_tests::{Effect, GeneratedRun, Setup};

fn declared_model() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("launch_config/stage_measured_runs.yaml")
}

fn declared() -> StageModel {
    StageModel::load(&declared_model()).expect("the declared model")
}

/// Train and check record of an emulated run.
fn measured(run: &GeneratedRun) -> [Measured; 2] {
    let declared = declared();
    [&run.train, &run.check]
        .map(|columns| Measured::new(&columns.to_trace(), &declared, "a record").expect("data"))
}

/// What the search finds in an emulated run with effects that was not declared.
fn found_in(seed: u64, hidden: Vec<Effect>) -> Selection {
    let run = Setup::new(seed).with_all(hidden).generate().expect("a run");
    let [train, check] = measured(&run);
    search(&declared(), Tolerances::default(), &train, &check, &Silent).expect("a search")
}

fn identify(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_friction-stage"))
        .args(["identify", "--model"])
        .arg(declared_model())
        .args(arguments)
        .output()
        .expect("the program starts")
}

/// Summary of a run of the recordings with default settings, and the directory that it was written
/// to.
fn summary_of(run: &str) -> Option<(Value, tempfile::TempDir)> {
    let place = blind_tests::recordings::with("a/train")?;
    let out = tempfile::tempdir().expect("a directory for the results");
    let path = |record: &str| place.join(run).join(record).display().to_string();
    let output = identify(&[
        "--train",
        &path("train"),
        "--holdout",
        &path("check"),
        "--json",
        "--out",
        &out.path().display().to_string(),
    ]);
    assert!(
        matches!(output.status.code(), Some(0 | 3)),
        "{:?}: {}",
        output.status,
        String::from_utf8_lossy(&output.stderr)
    );
    Some((serde_json::from_slice(&output.stdout).expect("the summary is JSON"), out))
}

fn names(summary: &Value) -> Vec<&str> {
    summary["effects"]
        .as_array()
        .into_iter()
        .flatten()
        .filter_map(|effect| effect["name"].as_str())
        .collect()
}

fn assert_found(run: &str, verdict: &str, expected: &[&str], least_share: f64) {
    if let Some((summary, _out)) = summary_of(run) {
        assert_says(&summary, verdict, expected, least_share);
    }
}

fn assert_says(summary: &Value, verdict: &str, expected: &[&str], least_share: f64) {
    assert_eq!(summary["verdict"], verdict, "{summary:#}");
    assert_eq!(names(summary), expected, "{summary:#}");
    let share = summary["explained_share"].as_f64().expect("a share");
    assert!(share >= least_share, "{share}");
}

#[test]
fn a_recording_with_nothing_hidden_gets_none() {
    assert_found("b", "none", &[], 0.0);
}

/// A carriage at rest is shaken by what the controller makes of the encoder's noise, and its
/// bristles relax: 5 % in 8 s. Friction along the encoder's own motion missed 0.9 N of it, and
/// along the command of a motor that is late 0.11 N.
#[test]
fn a_rest_of_many_seconds_leaves_no_more_than_the_noise_of_the_sensors() {
    let lag = ActuatorLag { time_constant: 0.5e-3, delay: 0.0 };
    let declared = declared();
    let start = Hypothesis::new(&declared, Tolerances::default()).expect("a hypothesis");
    let descriptor = EffectDescriptor::find("actuator_lag").expect("a law");
    let late = start.with(Part { descriptor, values: vec![lag.time_constant, lag.delay] });
    for (hidden, start, floors) in
        [(vec![], start, 1.5), (vec![Box::new(lag) as Effect], late, Criteria::USUAL.noise_like)]
    {
        let setup = Setup { programme: Programme::Resting, guide_tolerance: 0.0, ..Setup::new(11) };
        let run = setup.with_all(hidden).generate().expect("a run");
        let [train, check] = measured(&run);
        let fitted = fit(&start, &train, Sides::BOTH, FitBudget::KEPT).expect("a fit");
        let missing = fitted.hypothesis.missing(&check, Sides::BOTH).expect("a residual").rms();
        let floor = check.floor(&declared).total();
        let effects = start.effects.len();
        assert!(
            missing < floors * floor,
            "{effects} effects: {missing} N rms, the noise leaves {floor} N"
        );
    }
}

/// What is too quick for a step of a control cycle: each law with the values that were hidden
/// leaves the sensors' noise, and a fit that starts beside them comes back to them. 1 % of the
/// mode's mass is a tenth of the noise.
#[test]
fn laws_that_change_within_a_cycle_leave_no_more_than_the_noise_of_the_sensors() {
    let hidden: [(Effect, &str, &[f64], usize, f64); 3] = [
        (
            Box::new(ExternalVibration::new(4.0, 90.0)),
            "external_vibration",
            &[4.0, 90.0, 0.0],
            0,
            1e-3,
        ),
        (
            Box::new(StructuralMode { mass: 2.0, frequency: 120.0, damping: 0.02 }),
            "structural_mode",
            &[2.0, 120.0, 0.02],
            1,
            2e-4,
        ),
        (
            Box::new(EncoderSde { amplitude: 2e-7, period: 15e-6, phase: 0.5 * PI }),
            "encoder_sde",
            &[2e-7, 15e-6, 0.0],
            0,
            2e-3,
        ),
    ];
    let declared = declared();
    for (effect, name, values, index, close) in hidden {
        let run = Setup { guide_tolerance: 0.0, ..Setup::new(13).with_all(vec![effect]) }
            .generate()
            .expect("a run");
        let train = Measured::new(&run.train.to_trace(), &declared, "a record").expect("data");
        let descriptor = EffectDescriptor::find(name).expect("a law");
        let start = Hypothesis::new(&declared, Tolerances::default()).expect("a hypothesis");
        let mut with = start.with(Part { descriptor, values: values.to_vec() });
        if name == "encoder_sde" {
            // The generator's error has a second harmonic, a quarter as large.
            with = with.with(Part { descriptor, values: vec![5e-8, 7.5e-6, 0.5 * PI] });
        } else if name == "external_vibration" {
            with = with.in_record(&train).expect("a phase");
        }
        let fitted = fit(&with, &train, Sides::BOTH, FitBudget::KEPT).expect("a fit");
        let (left, floor) = (fitted.missing.rms(), train.floor(&declared).total());
        assert!(left < 1.2 * floor, "{name}: {left} N rms, the noise leaves {floor} N");
        let found = fitted.hypothesis.effects[0].values[index];
        assert!(
            (found / values[index] - 1.0).abs() < close,
            "{name}: {found}, hidden was {}",
            values[index]
        );
    }
}

/// A law that explains nine tenths leaves a tenth: a narrow joint beside a tilt is no noise.
#[test]
fn a_joint_beside_a_tilt_is_not_passed_over() {
    let tilt = ConstantForce { mass: 40.0, tilt: 4e-3 };
    let joint = RailJoint { force: 5.0, center: -0.02, width: 2e-3 };
    let found = found_in(14, vec![Box::new(tilt), Box::new(joint)]);
    assert_eq!(found.verdict, Verdict::Unknown, "{:?} of {:?}", found.errors_after, found.floor);
    assert_eq!(found.coordinate, Some(Coordinate::Position));
    assert!(
        found.errors_after.holdout().sqrt() < 2.0 * found.floor.total(),
        "{:?}",
        found.errors_after
    );
}

/// A force over the velocity bends the guides before anybody draws it as a curve: drawn alone it
/// left 0.57 N.
#[test]
#[cfg_attr(
    debug_assertions,
    ignore = "minutes in the dev profile; runs with --release, as in tests/run"
)]
fn a_brake_that_saturates_gets_a_curve_that_leaves_little_more_than_noise() {
    let found = found_in(17, vec![Box::new(SaturatingBrake { force: 8.0, speed: 0.1 })]);
    assert_eq!((found.verdict, found.coordinate), (Verdict::Unknown, Some(Coordinate::Velocity)));
    let left = found.errors_after.holdout().sqrt();
    println!("{left:.4} N of {:.4} N", found.floor.total());
    assert!(left < 2.0 * found.floor.total(), "{:?} of {:?}", found.errors_after, found.floor);
}

/// What no law has hides a law that is there: beside the curve it is found, and the curve is drawn
/// again beside it.
#[test]
#[cfg_attr(
    debug_assertions,
    ignore = "minutes in the dev profile; runs with --release, as in tests/run"
)]
fn a_law_that_a_joint_hides_is_found_beside_the_curve() {
    let joint = RailJoint { force: 5.0, center: -0.03, width: 4e-3 };
    let warm_up = ViscousWarmUp { fraction: 0.3, work: 100.0 };
    let found = found_in(16, vec![Box::new(warm_up), Box::new(joint)]);
    assert_eq!((found.verdict, found.coordinate), (Verdict::Unknown, Some(Coordinate::Position)));
    let mut names: Vec<&str> =
        found.after.fitted.hypothesis.effects.iter().map(|part| part.descriptor.name).collect();
    names.sort_unstable();
    assert_eq!(names, ["map", "viscous_warm_up"], "share {}", found.explained_share());
    assert!(found.explained_share() > 0.99, "{}", found.explained_share());
}

/// A gain of the cell shows on both sides: a law that is fitted beside it on the carriage alone
/// would bend it. A small one shows on the motor side only, where a gain of the motor is the same.
#[test]
#[cfg_attr(
    debug_assertions,
    ignore = "minutes in the dev profile; runs with --release, as in tests/run"
)]
fn a_gain_of_the_cell_is_found_beside_a_mode_and_left_open_where_it_is_small() {
    let found = |gain: f64, others: Vec<Effect>| {
        let mut hidden: Vec<Effect> = vec![Box::new(ForceCellGain { fraction: gain })];
        hidden.extend(others);
        found_in(5, hidden)
    };
    let name = |part: &Part| part.descriptor.name;
    let mode = StructuralMode { mass: 0.3, frequency: 176.0, damping: 0.014 };
    let both = found(-0.009, vec![Box::new(mode)]);
    let names: Vec<&str> = both.after.fitted.hypothesis.effects.iter().map(name).collect();
    assert_eq!((both.verdict, names), (Verdict::Found, vec!["force_cell_gain", "structural_mode"]));
    assert!(
        (both.after.fitted.hypothesis.effects[0].values[0] + 0.009).abs() < 5e-5,
        "{:?}",
        both.after.fitted.hypothesis.effects
    );

    let small = found(1e-4, Vec::new());
    assert_eq!(small.verdict, Verdict::NotSeparable, "{:?}", small.after.fitted.hypothesis.effects);
    let mut rivals: Vec<&str> = small.after.fitted.hypothesis.effects.iter().map(name).collect();
    rivals.extend(small.inseparable.iter().map(|pair| pair.rival));
    rivals.sort_unstable();
    assert_eq!(rivals, ["force_cell_gain", "motor_gain"]);
    // One force with two names: what either takes out of motor and carriage is nearly the same.
    assert!(
        small.inseparable.iter().all(|pair| pair.correlation > 0.95),
        "{:?}",
        small.inseparable
    );
}

/// The literature has several forms of a law: that of the recording is found, and with it the
/// values.
#[test]
#[cfg_attr(
    debug_assertions,
    ignore = "minutes in the dev profile; runs with --release, as in tests/run"
)]
fn a_law_is_found_in_the_form_that_it_has() {
    let aging = StictionAging { rise: 0.25, time_constant: 0.3, length: 45e-6 };
    let bristles = DistributedBristles { spread: 2.5, elements: 4, slip: Slip::Sudden };
    let chain = CableChain { stiffness: 30.0, center: 0.04, hysteresis: 1.5, length: 4e-3 };
    // Name, form, one of the values, what it is, how close it comes.
    let hidden: [(Effect, &str, &str, f64, f64); 3] = [
        (Box::new(aging), "stiction_aging", "fraction", 0.25, 0.05),
        // Four springs of one stiffness.
        (Box::new(bristles), "distributed_bristles", "stiffness_share_1", 0.25, 0.05),
        (Box::new(chain), "cable_chain", "width", 4e-3, 0.02),
    ];
    for (effect, name, parameter, truth, close) in hidden {
        let found = found_in(51, vec![effect]);
        assert_eq!(
            found.verdict,
            Verdict::Found,
            "{name}: {:?}",
            found.after.fitted.hypothesis.effects
        );
        let part = &found.after.fitted.hypothesis.effects[0];
        let value = |name: &str| {
            part.values[part
                .descriptor
                .parameters
                .iter()
                .position(|one| one.name == name)
                .expect("a parameter")]
        };
        assert_eq!((part.descriptor.name, value("form")), (name, 1.0), "{part:?}");
        assert!((value(parameter) / truth - 1.0).abs() < close, "{part:?}");
    }
}

/// Without the drag grease that warms with the work looks as if it warmed with the distance, and
/// beside that form a drag makes the hold-out worse.
#[test]
#[cfg_attr(
    debug_assertions,
    ignore = "minutes in the dev profile; runs with --release, as in tests/run"
)]
fn a_law_is_found_beside_one_whose_form_is_right_only_with_it() {
    let warm_up = ViscousWarmUp { fraction: 0.29, work: 67.0 };
    let found = found_in(51, vec![Box::new(warm_up), Box::new(QuadraticDrag { force: 3.6 })]);
    let effects = &found.after.fitted.hypothesis.effects;
    assert_eq!(found.verdict, Verdict::Found, "{effects:?}");
    let names: Vec<&str> = effects.iter().map(|part| part.descriptor.name).collect();
    assert_eq!(names, ["viscous_warm_up", "quadratic_drag"], "{effects:?}");
    assert_eq!(effects[0].value_of("form"), Some(3.0), "{effects:?}");
    assert!((effects[0].values[0] / 0.29 - 1.0).abs() < 0.02, "{effects:?}");
    assert!((effects[1].values[0] / 3.6 - 1.0).abs() < 0.05, "{effects:?}");
}

/// What is found does not hang on the unit: the stage of 40 kg on a radius of 1.6 mm is an inertia
/// of 1e-4 kg m², and the pitch of its motor 2.4 turns.
#[test]
fn a_turning_joint_gets_what_the_same_motion_along_an_axis_gets() {
    const INERTIA: f64 = 1e-4;
    let (amplitude, period) = (6.0, 24e-3);
    let mut declared = declared();
    let radius = (INERTIA / declared.mass).sqrt();
    let run = Setup::new(61).with(Cogging::new(amplitude, period, 0.7)).generate().expect("a run");
    declared.joint = JointType::Revolute;
    declared.mass = INERTIA;
    for guide in &mut declared.guides {
        let GuideSource::Inline(guide) = guide else { panic!("the guides have parameters") };
        guide.stiffness *= radius * radius;
        guide.bristle_damping *= radius * radius;
        guide.viscous_friction *= radius * radius;
        guide.coulomb_force *= radius;
        guide.static_force *= radius;
        guide.stribeck_velocity /= radius;
    }
    declared.force_cell.noise *= radius;
    declared.encoder.noise /= radius;
    declared.encoder.resolution /= radius;
    let [train, check] = [&run.train, &run.check].map(|columns| {
        let mut trace = columns.to_trace();
        let motion = [
            &mut trace.reference_position,
            &mut trace.reference_velocity,
            &mut trace.reference_acceleration,
            &mut trace.position,
        ];
        motion.into_iter().flatten().for_each(|value| *value /= radius);
        let torques = [&mut trace.force_cell, &mut trace.force];
        torques.into_iter().flatten().for_each(|value| *value *= radius);
        Measured::new(&trace, &declared, "a record").expect("data")
    });
    let found = search(&declared, Tolerances::default(), &train, &check, &Silent).expect("found");
    let effects = &found.after.fitted.hypothesis.effects;
    assert_eq!(found.verdict, Verdict::Found, "{effects:?}");
    let [cogging] = effects.as_slice() else { panic!("{effects:?}") };
    assert_eq!(cogging.descriptor.name, "cogging");
    let value = |name: &str| cogging.value_of(name).expect("a parameter");
    assert!((value("amplitude") / (amplitude * radius) - 1.0).abs() < 0.01, "{cogging:?}");
    assert!((value("period") / (period / radius) - 1.0).abs() < 0.001, "{cogging:?}");
}

/// A guide with a third of the viscous friction was once found as a warm-up of -196 %.
#[test]
fn guides_of_another_friction_are_refused_with_what_it_is() {
    let run = Setup::new(52).generate().expect("a run");
    let mut declared = declared();
    let [train, check] = measured(&run);
    let other =
        Guide { viscous_friction: 5.0, ..declared.resolved_guides().expect("guides")[0].clone() };
    declared.guides = vec![GuideSource::Inline(other); 4];
    let reported = search(&declared, Tolerances::default(), &train, &check, &Silent)
        .expect_err("another guide")
        .to_string();
    assert!(
        reported.contains("other guides")
            && reported.contains("viscous_friction is 1")
            && reported.contains("declared 5"),
        "{reported}"
    );
}

/// Without a command the cell is the force, and its noise is on the carriage.
#[test]
fn a_recording_with_a_cell_and_no_command_gets_none_where_nothing_is_hidden() {
    let mut run = Setup::new(12).generate().expect("a run");
    for columns in [&mut run.train, &mut run.check] {
        columns.force.fill(f64::NAN);
    }
    let [train, check] = measured(&run);
    let found =
        search(&declared(), Tolerances::default(), &train, &check, &Silent).expect("a search");
    assert_eq!(found.verdict, Verdict::None, "{:?} of {:?}", found.errors_after, found.floor);
}

#[test]
fn a_force_that_no_law_has_gets_unknown_its_coordinate_and_a_model_that_loads() {
    let Some((summary, out)) = summary_of("f") else { return };
    assert_eq!(summary["verdict"], "unknown");
    assert_eq!(names(&summary), ["map"]);
    assert_eq!(summary["effects"][0]["coordinate"], "position");
    let errors = &summary["errors"]["holdout"]["force_rms"];
    let (before, after) =
        (errors["before"].as_f64().expect("before"), errors["after"].as_f64().expect("after"));
    assert!(after < 0.2 * before, "{before} -> {after}");
    let model = friction_stage_core::model::StageModel::load(&out.path().join("identified.yaml"))
        .expect("the model loads");
    assert_eq!(model.effects.len(), 1);
    let page = std::fs::read_to_string(out.path().join("report.html")).expect("a report");
    assert!(page.contains("<svg") && !page.contains("src=\"http") && !page.contains("href=\"http"));
}

#[test]
#[cfg_attr(
    debug_assertions,
    ignore = "minutes in the dev profile; runs with --release, as in tests/run"
)]
fn cogging_with_its_harmonic_is_found_on_the_motor_side() {
    let Some((summary, _out)) = summary_of("a") else { return };
    assert_says(&summary, "found", &["cogging", "cogging"], 0.99);
    let amplitude =
        summary["effects"][0]["parameters"]["amplitude"]["value"].as_f64().expect("an amplitude");
    let period = summary["effects"][0]["parameters"]["period"]["value"].as_f64().expect("a period");
    assert!(
        (amplitude - 6.0).abs() < 0.01 && (period - 0.024).abs() < 1e-6,
        "{amplitude} N, {period} m"
    );
}

#[test]
#[cfg_attr(
    debug_assertions,
    ignore = "minutes in the dev profile; runs with --release, as in tests/run"
)]
fn effects_on_the_carriage_are_found_alone_and_together() {
    assert_found("c", "found", &["cable_chain"], 0.99);
    assert_found("d", "found", &["distributed_bristles"], 0.99);
    assert_found("e", "found", &["viscous_warm_up", "ball_passage"], 0.99);
}

#[test]
fn bad_input_is_told_with_its_reason_and_the_right_exit_code() {
    let directory = tempfile::tempdir().expect("a directory");
    let out = directory.path().join("out").display().to_string();
    let table = |name: &str, rows: &mut dyn Iterator<Item = String>| {
        let path = directory.path().join(name);
        let text: String =
            std::iter::once("time,position,force\n".to_owned()).chain(rows).collect();
        std::fs::write(&path, text).expect("a file");
        path.display().to_string()
    };
    let short = table(
        "short.csv",
        &mut (0..10).map(|k| format!("{},{},1\n", f64::from(k) * 5e-4, f64::from(k) * 1e-4)),
    );
    let still =
        table("still.csv", &mut (0..4000).map(|k| format!("{},0,1\n", f64::from(k) * 5e-4)));
    let forceless = table(
        "forceless.csv",
        &mut (0..4000)
            .map(|k| format!("{},{},\n", f64::from(k) * 5e-4, 0.01 * (f64::from(k) * 0.01).sin())),
    );
    for (train, holdout, code, words) in [
        (&short, &still, 1, "rows"),
        (&still, &short, 1, "moves"),
        (&forceless, &short, 1, "force"),
        (&short, &short, 2, "both train and hold-out"),
    ] {
        let output = identify(&["--train", train, "--holdout", holdout, "--out", &out, "--force"]);
        let reported = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{reported}");
        assert!(reported.contains(words), "{words:?} is not in {reported:?}");
    }
    let output = identify(&["--train", "nowhere", "--holdout", &short, "--out", &out]);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("nowhere"));
}
