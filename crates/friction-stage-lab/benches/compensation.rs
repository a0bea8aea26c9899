//! What a compensation gains on stages that differ from the model within its intervals, against the
//! tuned PID with mass feedforward. `cargo bench -p friction-stage-lab --bench compensation`
//! prints the table of docs/how-to/tune-and-compensate.md; `-- 100` takes so many stages.

use friction_stage_core::control::{CompensationTermsOn, ControllerSettings, Point};
use friction_stage_core::model::{EffectParameters, GuideSource, ParameterValue, StageModel};
use friction_stage_lab::{
    Application, CompensationTrial, GuideTolerances, Objective, PaperMotion, Specimen, TrialRun,
    TuningPlan, variant_seed,
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

struct Case {
    name: &'static str,
    known: StageModel,
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
    vec![
        Case {
            name: "50 mm in 100 ms, guide_1",
            known: on("guide_1", vec![]),
            application: fast(),
            moves: there_and_back(),
        },
        Case {
            name: "50 mm in 100 ms, guide_2",
            known: on("guide_2", vec![]),
            application: fast(),
            moves: there_and_back(),
        },
        Case {
            name: "10 µm in 3 ms, guide_1",
            known: on("guide_1", vec![]),
            application: Application::fine_step(),
            moves: vec![(-0.05, 0.1, 0.6), (10e-6, 3e-3, 0.4), (-10e-6, 3e-3, 0.4)],
        },
        Case {
            name: "cogging and cable, slow and fast, guide_1",
            known: on("guide_1", effects),
            application: fast(),
            moves: vec![(0.1, 0.5, 0.4), (-0.1, 0.5, 0.4), (0.05, 0.1, 0.4)],
        },
        Case {
            name: "cogging, cable, distributed bristles",
            known: distributed,
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
    println!("{stages} stages each; with over without, median / 95 %\n");
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
        let motion = PaperMotion::of_moves(0.05, &case.moves).expect("they are possible");
        let pairs: Vec<(TrialRun, TrialRun)> = (0..stages)
            .into_par_iter()
            .map(|variant| {
                let real = drawn(&case.known, variant);
                trial(&case.known, real, &settings, &motion.points, variant)
                    .run()
                    .expect("every drawn stage can move")
            })
            .map(|(mut plain, mut with)| {
                plain.errors = Vec::new();
                with.errors = Vec::new();
                (plain, with)
            })
            .collect();
        // Of the moves that are judged: all but the first, which finds the bristles unloaded.
        let judged = |run: &TrialRun| run.moves[1..].to_vec();
        let peak =
            |run: &TrialRun| judged(run).iter().map(|one| one.peak_error).fold(0.0, f64::max);
        let settled = |run: &TrialRun| {
            let never = 2.0;
            let times = judged(run);
            times.iter().map(|one| one.settling[1].unwrap_or(never)).fold(2.5e-4, f64::max)
        };
        let line = |name: &str, of: &dyn Fn(&TrialRun) -> f64, unit: f64| {
            let mut ratios: Vec<f64> =
                pairs.iter().map(|(plain, with)| of(with) / of(plain)).collect();
            let worse = ratios.iter().filter(|ratio| **ratio > 1.0).count() as f64;
            let mut plain: Vec<f64> = pairs.iter().map(|(plain, _)| unit * of(plain)).collect();
            let mut with: Vec<f64> = pairs.iter().map(|(_, with)| unit * of(with)).collect();
            println!(
                "{name:34} {:8.3} {:8.3}   {:6.3} / {:6.3}   not worse in {:5.1} %",
                quantile(&mut plain, 0.5),
                quantile(&mut with, 0.5),
                quantile(&mut ratios, 0.5),
                quantile(&mut ratios, 0.95),
                100.0 * (1.0 - worse / pairs.len() as f64)
            );
        };
        println!("{}, p {:.3e} N/m", case.name, settings.gains.p);
        line("  peak error, µm", &peak, 1e6);
        line("  settled to 1 µm, ms", &settled, 1e3);
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
    let (plain, with) =
        trial(&known, drawn(&known, 3), &settings, &motion.points, 3).run().expect("it can move");
    println!(
        "60 s at rest, error from peak to peak after 10 s: {:.0} nm without, {:.0} nm with",
        swing(&plain),
        swing(&with)
    );
}
