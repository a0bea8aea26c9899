//! Guides fitted to emulated rigs: their parameters and intervals against the truth.

use friction_stage_core::model::{Guide, GuideSource, MAX_GUIDES, StageModel};
use friction_stage_lab::{
    GuideFit, QUICK_LOOPS, RigRecord, SPEEDS, Settings, Specimen, fit_guide, quick_loops, stribeck,
};
use rand::{RngExt, SeedableRng};
use rayon::prelude::*;

/// What `experiment stribeck` and `experiment dahl` record.
fn record(guide: &Guide, seed: u64) -> (RigRecord, RigRecord) {
    let guides = vec![GuideSource::Inline(guide.clone()); MAX_GUIDES];
    let specimen = Specimen::of_model(&StageModel { guides, ..StageModel::default() }).unwrap();
    let settings = |seed| Settings { seed, ..Settings::default() };
    let (_, runs) = stribeck(&specimen, &settings(seed), &SPEEDS, &|| ()).unwrap();
    let loops = quick_loops(&specimen, &settings(seed + 1_000_000), &QUICK_LOOPS).unwrap();
    (RigRecord::from(&runs), RigRecord::from(&loops))
}

/// A guide between half and double of guide 1 in each parameter, with 10 to 40 % more static
/// than Coulomb friction.
fn random_guide(seed: u64) -> Guide {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut around = |value: f64| value * 2f64.powf(random.random_range(-1.0..1.0));
    let (stiffness, bristle_damping) = (around(4.5e5), around(900.0));
    let (viscous_friction, coulomb_force) = (around(18.0), around(10.0));
    let stribeck_velocity = around(6e-3);
    Guide {
        stiffness,
        bristle_damping,
        viscous_friction,
        coulomb_force,
        static_force: coulomb_force * random.random_range(1.1..1.4),
        stribeck_velocity,
        stribeck_exponent: None,
        damping_velocity: None,
    }
}

/// Largest relative error, and for each parameter whether its interval holds the truth.
fn compare(guide: &Guide, fit: &GuideFit) -> (f64, Vec<bool>) {
    let truth = [
        guide.stiffness,
        guide.bristle_damping,
        guide.viscous_friction,
        guide.coulomb_force,
        guide.static_force,
        guide.stribeck_velocity,
    ];
    let parameters = fit.parameters();
    assert_eq!(parameters.len(), truth.len(), "{fit:?}");
    let error =
        parameters.iter().zip(truth).map(|((_, fitted), truth)| (fitted.value / truth - 1.0).abs());
    let held = parameters
        .iter()
        .zip(truth)
        .map(|((_, fitted), truth)| (fitted.ci95[0]..=fitted.ci95[1]).contains(&truth));
    (error.fold(0.0, f64::max), held.collect())
}

fn recover(seeds: std::ops::Range<u64>) -> (f64, [usize; 6]) {
    let compared = seeds.into_par_iter().map(|seed| {
        let guide = random_guide(seed);
        let (stribeck, dahl) = record(&guide, seed);
        let fit = fit_guide(&stribeck, &dahl, 1.0).unwrap();
        compare(&guide, &fit)
    });
    let (mut worst, mut held) = (0.0f64, [0; 6]);
    for (error, inside) in compared.collect::<Vec<_>>() {
        worst = worst.max(error);
        for (count, inside) in held.iter_mut().zip(inside) {
            *count += usize::from(inside);
        }
    }
    (worst, held)
}

#[test]
fn intervals_hold_the_truth_in_90_to_99_percent_of_100_rigs() {
    let (worst, held) = recover(0..100);
    println!(
        "largest error {:.2} %; intervals that hold the truth, of 100: {held:?}",
        100.0 * worst
    );
    assert!(worst < 0.03, "{worst}");
    assert!(held.iter().all(|count| (90..=99).contains(count)), "{held:?}");
}
