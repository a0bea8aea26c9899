//! What a compensation gains on stages that differ from the model within its intervals, against the
//! tuned PID with mass feedforward. `cargo bench -p friction-stage-lab --bench compensation`
//! prints the tables of docs/how-to/tune-and-compensate.md; `-- 100` takes so many stages. The
//! disturbance observer is tried alone and with the compensation, also on stages with an effect
//! that the model does not have.

use friction_stage_core::control::{
    Compensation, CompensationTermsOn, ControllerSettings, ObserverSettings, Point,
};
use friction_stage_core::model::{EffectParameters, GuideSource, ParameterValue, StageModel};
use friction_stage_lab::{
    Application, CompensationTrial, GuideTolerances, LoopResponse, Margins, Objective, PaperMotion,
    SampledStage, Specimen, StageMotion, TrialRun, TuningPlan, loop_frequencies, variant_seed,
};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

/// Relative standard deviations of what identification finds, typical of its 95 % intervals over
/// two. Of amplitudes of effects as well.
const INTERVALS: GuideTolerances = GuideTolerances {
    stiffness: 0.03,
    bristle_damping: 0.1,
    viscous_friction: 0.02,
    coulomb_force: 0.01,
    static_force: 0.02,
    stribeck_velocity: 0.1,
    together: false,
};
const MASS: f64 = 0.002;
const EFFECTS: f64 = 0.02;
/// Bandwidth of the observer over the crossover of the tuned loop: where 1 - Q makes the
/// sensitivity larger, it is still small.
const OBSERVER: f64 = 0.2;

struct Case {
    name: &'static str,
    known: StageModel,
    /// Of the stage, beyond the model.
    unknown: Vec<EffectParameters>,
    application: Application,
    /// Distance, m, duration and rest after it, s.
    moves: Vec<(f64, f64, f64)>,
}

fn application(text: &str) -> Application {
    Application::from_yaml(text, "application").expect("it is one of ours")
}

fn cases() -> Vec<Case> {
    let fast =
        || application(include_str!("../../../launch_config/application_fast_move_clean.yaml"));
    let there_and_back = || vec![(0.05, 0.1, 0.6), (-0.05, 0.1, 0.6), (0.05, 0.1, 0.6)];
    let effects = vec![
        EffectParameters::new("cogging", [("amplitude", 6.0), ("period", 0.024), ("phase", 0.5)]),
        EffectParameters::new("cable_chain", [("stiffness", 100.0), ("center", 0.0)]),
    ];
    let on = |guide: &str, effects: Vec<EffectParameters>| StageModel {
        effects,
        ..StageModel::on_guides(guide)
    };
    let mut distributed =
        Specimen::named("guide_1+distributed_bristles").expect("the catalogue has them").stage;
    distributed.effects.extend(effects.iter().cloned());
    let late = |time_constant: f64, delay: f64| {
        let lag = [("time_constant", time_constant), ("delay", delay)];
        vec![EffectParameters::new("actuator_lag", lag)]
    };
    vec![
        Case {
            name: "50 mm in 100 ms, guide_1",
            known: on("guide_1", vec![]),
            unknown: vec![],
            application: fast(),
            moves: there_and_back(),
        },
        Case {
            name: "50 mm in 100 ms, guide_2",
            known: on("guide_2", vec![]),
            unknown: vec![],
            application: fast(),
            moves: there_and_back(),
        },
        Case {
            name: "50 mm in 100 ms, guide_1, motor 0.5 ms late",
            known: on("guide_1", late(2.5e-4, 2.5e-4)),
            unknown: vec![],
            application: fast(),
            moves: there_and_back(),
        },
        Case {
            name: "50 mm in 100 ms, guide_1, motor 1.5 ms late",
            known: on("guide_1", late(5e-4, 1e-3)),
            unknown: vec![],
            application: fast(),
            moves: there_and_back(),
        },
        Case {
            name: "50 mm in 100 ms, guide_1, motor 3 ms late",
            known: on("guide_1", late(1e-3, 2e-3)),
            unknown: vec![],
            application: fast(),
            moves: there_and_back(),
        },
        Case {
            name: "50 mm in 100 ms, guide_1, cogging and cable that are not known",
            known: on("guide_1", vec![]),
            unknown: effects.clone(),
            application: fast(),
            moves: there_and_back(),
        },
        Case {
            name: "10 µm in 3 ms, guide_1",
            known: on("guide_1", vec![]),
            unknown: vec![],
            application: Application::fine_step(),
            moves: vec![(-0.05, 0.1, 0.6), (10e-6, 3e-3, 0.4), (-10e-6, 3e-3, 0.4)],
        },
        Case {
            name: "cogging and cable, slow and fast, guide_1",
            known: on("guide_1", effects),
            unknown: vec![],
            application: fast(),
            moves: vec![(0.1, 0.5, 0.4), (-0.1, 0.5, 0.4), (0.05, 0.1, 0.4)],
        },
        Case {
            name: "cogging, cable, distributed bristles",
            known: distributed,
            unknown: vec![],
            application: fast(),
            moves: vec![(0.1, 0.5, 0.4), (-0.1, 0.5, 0.4), (0.05, 0.1, 0.4)],
        },
    ]
}

/// A stage whose parameters differ from the model's within their intervals.
fn drawn(known: &StageModel, variant: u64) -> StageModel {
    let mut random =
        rand_chacha::ChaCha8Rng::seed_from_u64(variant_seed(7, "compensation", variant));
    let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
    let guides = known.resolved_guides().expect("it is one of ours");
    let guides = guides.iter().map(|guide| GuideSource::Inline(INTERVALS.draw(guide, &mut normal)));
    let mut real = StageModel { guides: guides.collect(), ..known.clone() };
    real.mass *= (MASS * normal()).exp();
    for effect in &mut real.effects {
        for (name, value) in &mut effect.values {
            if let ParameterValue::Number(number) = value
                && ["amplitude", "stiffness"].contains(&name.as_str())
            {
                *number *= (EFFECTS * normal()).exp();
            }
        }
    }
    real
}

fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share).round() as usize]
}

fn main() {
    let stages = std::env::args().skip(1).find_map(|text| text.parse().ok()).unwrap_or(1000u64);
    println!(
        "{stages} stages each: median without | with compensation: median, ratio (median / 95 %), \
         not worse in | the same with the observer alone | with both\n"
    );
    for case in cases() {
        let plan = TuningPlan {
            model: case.known.clone(),
            application: case.application.clone(),
            objective: Objective::Both,
            unseen: 1,
            seed: 1,
        };
        let settings = match plan.run(None, &|_| ()) {
            Ok(tuning) => tuning.found().settings.clone(),
            Err(error) => panic!("{}: {error}", case.name),
        };
        let stage = |motion| {
            let rate = settings.rate;
            SampledStage::new(&case.known, rate, 0.0, motion, &loop_frequencies(rate))
                .expect("it is one of ours")
        };
        let stages_of_loop = [StageMotion::PlainMass, StageMotion::Amplitude(1e-6)].map(stage);
        let margins = |settings: &ControllerSettings| -> Margins {
            let all =
                stages_of_loop.each_ref().map(|one| LoopResponse::new(one, settings).margins());
            all.into_iter()
                .reduce(|a, b| if a.modulus_margin < b.modulus_margin { a } else { b })
                .expect("there are two")
        };
        let alone = margins(&settings);
        let mass = settings.mass_feedforward;
        let observer = ObserverSettings {
            bandwidth: OBSERVER * alone.crossover.expect("a tuned loop has one"),
            limit: ObserverSettings::LIMIT,
            mass,
            delay: 0.0,
            forward_delay: 0.0,
        };
        // Without a compensation, too, it reckons with the delay of the motor.
        let on = CompensationTermsOn { motor: false, ..CompensationTermsOn::ALL };
        let compensation = Compensation::new(&case.known, &settings, on).expect("it is known");
        let observer = compensation.informed(observer);
        let observed = ControllerSettings { observer: Some(observer), ..settings.clone() };
        let motion = PaperMotion::of_moves(0.05, &case.moves).expect("they are possible");
        let without_errors = |run: TrialRun| TrialRun { errors: Vec::new(), ..run };
        // Without and with the compensation, then both with the observer.
        let runs: Vec<[TrialRun; 4]> = (0..stages)
            .into_par_iter()
            .map(|variant| {
                let mut real = drawn(&case.known, variant);
                real.effects.extend(case.unknown.iter().cloned());
                let of = |settings: &ControllerSettings| {
                    let trial = trial(&case.known, real.clone(), settings, &motion.points, variant);
                    trial.run().expect("every drawn stage can move")
                };
                let ((a, b), (c, d)) = (of(&settings), of(&observed));
                [a, b, c, d].map(without_errors)
            })
            .collect();
        // Of the moves that are judged: all but the first, which finds the bristles unloaded.
        let judged = |run: &TrialRun| run.moves[1..].to_vec();
        let peak =
            |run: &TrialRun| judged(run).iter().map(|one| one.peak_error).fold(0.0, f64::max);
        let settled = |band: usize| {
            move |run: &TrialRun| {
                let (never, period) = (2.0, 2.5e-4);
                let times = run.moves[1..].iter().map(|one| one.settling[band].unwrap_or(never));
                times.fold(period, f64::max)
            }
        };
        let line = |name: &str, of: &dyn Fn(&TrialRun) -> f64, unit: f64| {
            let median = |which: usize| {
                let mut values: Vec<f64> = runs.iter().map(|run| unit * of(&run[which])).collect();
                quantile(&mut values, 0.5)
            };
            print!("{name:24} {:9.3}", median(0));
            for which in 1..4 {
                let mut ratios: Vec<f64> =
                    runs.iter().map(|run| of(&run[which]) / of(&run[0])).collect();
                let worse = ratios.iter().filter(|ratio| **ratio > 1.0).count() as f64;
                print!(
                    " | {:9.3} {:6.3} / {:6.3} {:5.1} %",
                    median(which),
                    quantile(&mut ratios, 0.5),
                    quantile(&mut ratios, 0.95),
                    100.0 * (1.0 - worse / runs.len() as f64)
                );
            }
            println!();
        };
        println!(
            "{}: p {:.3e} N/m, crossover {:.0} Hz, modulus margin {:.2}; observer {:.0} Hz, {:.2}",
            case.name,
            settings.gains.p,
            alone.crossover.unwrap_or(0.0),
            alone.modulus_margin,
            observer.bandwidth,
            margins(&observed).modulus_margin
        );
        line("  peak error, µm", &peak, 1e6);
        line("  settled to 1 µm, ms", &settled(1), 1e3);
        line("  settled to 0.1 µm, ms", &settled(2), 1e3);
        line("  rms error, µm", &|run| run.rms, 1e6);
    }
    at_rest();
}

fn trial(
    known: &StageModel,
    real: StageModel,
    settings: &ControllerSettings,
    points: &[Point],
    seed: u64,
) -> CompensationTrial {
    CompensationTrial {
        known: known.clone(),
        real,
        settings: settings.clone(),
        points: points.to_vec(),
        on: CompensationTermsOn::ALL,
        seed,
    }
}

/// A minute at rest after a move: whether anything hunts.
fn at_rest() {
    let known = StageModel::on_guides("guide_1");
    let settings = ControllerSettings::of_model(&known, 60.0, 4000.0);
    let motion = PaperMotion::of_moves(0.05, &[(0.05, 0.1, 60.0)]).expect("it is possible");
    let swing = |run: &TrialRun| {
        let late = run.errors.iter().filter(|(time, _)| *time > 10_000_000_000);
        let (low, high) = late.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (_, e)| {
            (low.min(*e), high.max(*e))
        });
        1e9 * (high - low)
    };
    let observer = ObserverSettings {
        bandwidth: OBSERVER * ControllerSettings::PAPER_BANDWIDTH,
        limit: ObserverSettings::LIMIT,
        mass: settings.mass_feedforward,
        delay: 0.0,
        forward_delay: 0.0,
    };
    let observed = ControllerSettings { observer: Some(observer), ..settings.clone() };
    for (settings, name) in [(settings, "without observer"), (observed, "with it")] {
        let (plain, with) = trial(&known, drawn(&known, 3), &settings, &motion.points, 3)
            .run()
            .expect("it can move");
        println!(
            "60 s at rest, {name}, error from peak to peak after 10 s: {:.0} nm without, {:.0} nm \
             with compensation",
            swing(&plain),
            swing(&with)
        );
    }
}
