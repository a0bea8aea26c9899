//! A control cycle allocates nothing: sensors, plant with effects, true state, controller.
//!
//! This file is a process of its own, so that its counting allocator sees no other test. It counts
//! this thread only: the test harness has threads of its own.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::hint::black_box;

use friction_stage_core::control::{
    Controller, ControllerSettings, Follower, ObserverSettings, Point, Trajectory,
};
use friction_stage_core::model::{Coordinate, Curve, CurveSide, EffectParameters, StageModel};
use friction_stage_core::plant::{Rates, Stage, effects};

/// The system's allocator, counting what this thread asks of it.
struct Counting;

thread_local! {
    static REQUESTS: Cell<u64> = const { Cell::new(0) };
}

fn count() {
    // Not counted while the thread is torn down.
    let _ = REQUESTS.try_with(|requests| requests.set(requests.get() + 1));
}

// SAFETY: every request goes on to the system's allocator as it came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count();
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        unsafe { System.realloc(pointer, layout, size) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count();
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Requests of this thread to the allocator, releases included, while `work` runs.
fn requests_during(work: impl FnOnce()) -> u64 {
    let before = REQUESTS.get();
    work();
    REQUESTS.get() - before
}

/// Every effect that there is, at its default values, or at its typical size where it has none.
fn every_effect() -> Vec<EffectParameters> {
    let curve = Curve {
        coordinate: Coordinate::Position,
        side: CurveSide::Carriage,
        from: 0.0,
        to: 0.05,
        values: vec![0.0, 1.0, -1.0],
        jump: None,
    };
    let effect = |effect: &&effects::EffectDescriptor| match effect.name {
        "map" => EffectParameters::map(curve.clone()),
        name => {
            let value =
                |parameter: &effects::EffectParameter| parameter.default.unwrap_or(parameter.scale);
            EffectParameters::new(
                name,
                effect.parameters.iter().map(|parameter| (parameter.name, value(parameter))),
            )
        }
    };
    effects::ALL.iter().map(effect).collect()
}

/// Runs 4000 cycles over a 50 mm move with a rest before and after it, controller beside it; the
/// requests counted.
fn requests_of_a_move(model: &StageModel) -> u64 {
    let rates = Rates::DEFAULT;
    let mut stage = Stage::new(model, rates, 1).unwrap();
    let settings = ControllerSettings {
        observer: Some(ObserverSettings {
            bandwidth: 30.0,
            limit: 100.0,
            mass: model.mass,
            delay: 1e-3,
            forward_delay: 0.7e-3,
        }),
        ..ControllerSettings::paper(model.mass, rates.control(), model.motor.force_limit)
    };
    let mut controller = Controller::new(settings).unwrap();
    let mut follower = Follower::new(f64::INFINITY);
    let trajectory = Trajectory::new(
        0,
        vec![Point::at_rest(50_000_000, 0.0), Point::at_rest(150_000_000, 50e-3)],
    )
    .unwrap();
    follower.follow(0, trajectory).unwrap();
    let mut travelled = 0.0f64;
    let requests = requests_during(|| {
        for _ in 0..4000 {
            let sample = stage.sample();
            let terms = controller.update(sample.time, sample.position, &mut follower);
            stage.advance(terms.output);
            travelled = travelled.max(black_box(stage.state()).position);
        }
    });
    assert!(travelled > 40e-3, "the stage moved {travelled} m only");
    requests
}

#[test]
fn the_allocator_counts() {
    assert_eq!(requests_during(|| drop(black_box(Box::new(1)))), 2);
    assert_eq!(requests_during(|| ()), 0);
}

#[test]
fn a_control_cycle_allocates_nothing() {
    assert_eq!(requests_of_a_move(&StageModel::default()), 0);
}

#[test]
fn effects_allocate_nothing_either() {
    let effects = every_effect();
    assert!(!effects.is_empty());
    // A stage has a limit on their number.
    for some in effects.chunks(effects::MAX_EFFECTS) {
        assert_eq!(
            requests_of_a_move(&StageModel { effects: some.to_vec(), ..StageModel::default() }),
            0
        );
    }
}

#[test]
fn the_measuring_rig_allocates_nothing() {
    let rates = Rates::new(4000.0, 200_000.0).unwrap();
    let mut stage = Stage::new(&StageModel::measuring_rig("guide_1").unwrap(), rates, 1).unwrap();
    let requests = requests_during(|| {
        for k in 0..4000 {
            black_box(stage.sample());
            stage.advance(30.0 * f64::from(k / 200).sin());
            black_box(stage.state());
        }
    });
    assert_eq!(requests, 0);
    assert!(stage.state().position.abs() > 1e-4, "{:?}", stage.state());
}
