//! Speed of the plant: one internal step beside the same scheme in C, and whole closed-loop control
//! cycles.
//!
//! `cargo bench -p friction-stage-core --bench plant`. The C side, `benches/lugre.c`, is compiled
//! here with `$CC` (else `cc`) `-O3 -march=native`. Both integrate the forces of a recorded 50 mm
//! move with rests before and after, from reset, and must agree to 1e-12 m in every sample before
//! anything is timed. Criterion's figures are wall time; those of the summary are processor time of
//! alternating passes, so that what else runs on the machine hardly shows in the ratio.

// A bench reads the clock and the environment; the crate does not.
#![allow(clippy::disallowed_methods)]

use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::process::Command;

use criterion::{Criterion, Throughput};
use friction_stage_core::ClosedLoop;
use friction_stage_core::control::{Controller, ControllerSettings, Point, Trajectory};
use friction_stage_core::model::{Guide, GuideSource, MAX_GUIDES, StageModel};
use friction_stage_core::plant::{Body, Rates, Stage};
use libloading::Library;

/// Largest difference between C and Rust in position over the move, m.
const AGREEMENT: f64 = 1e-12;
/// Alternating passes over the move for medians and the ratio.
const PASSES: usize = 400;
/// Length of the move with its rests, s.
const DURATION: f64 = 0.4;

fn main() {
    let rates = Rates::DEFAULT;
    let guides = four_different_guides();
    let model = StageModel {
        guides: guides.iter().cloned().map(GuideSource::Inline).collect(),
        ..StageModel::default()
    };
    let forces = forces_of_the_move(&model, rates);
    let steps = forces.len() * rates.substeps() as usize;
    let mut rust = Body::new(&model, rates.physics().recip()).expect("the bench's model is valid");
    let mut c = match compile(&PathBuf::from(env!("CARGO_TARGET_TMPDIR"))) {
        Ok(library) => Some(CPlant::new(library, &model, &guides, rates)),
        Err(message) => {
            eprintln!("step/c and the ratio are left out: {message}");
            None
        }
    };
    if let Some(c) = &mut c {
        println!(
            "C and Rust agree to {:.1e} m over {steps} steps",
            check_agreement(&mut rust, c, &forces, rates)
        );
    }

    let mut criterion = Criterion::default().configure_from_args();
    let mut group = criterion.benchmark_group("step");
    group.throughput(Throughput::Elements(steps as u64));
    group.bench_function("rust", |bencher| bencher.iter(|| rust_pass(&mut rust, &forces, rates)));
    if let Some(c) = &mut c {
        group.bench_function("c", |bencher| bencher.iter(|| c.pass(&forces, rates)));
    }
    group.finish();
    let mut group = criterion.benchmark_group("cycle");
    group.throughput(Throughput::Elements(forces.len() as u64));
    group.bench_function("closed_loop", |bencher| {
        bencher.iter_batched_ref(
            || closed_loop(&model, rates),
            |closed_loop| closed_loop_pass(closed_loop, forces.len()),
            criterion::BatchSize::SmallInput,
        )
    });
    group.finish();
    criterion.final_summary();

    // `cargo test --benches` runs everything once, without `--bench`: nothing to time then.
    if std::env::args().any(|argument| argument == "--bench") {
        print_summary(&model, &mut rust, c.as_mut(), &forces, rates);
    }
}

/// The four guides of the accuracy tests' oracle.
fn four_different_guides() -> Vec<Guide> {
    #[derive(serde::Deserialize)]
    struct Case {
        guides: Vec<Guide>,
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/oracle/case.json");
    let text = std::fs::read_to_string(&path)
        .unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let case: Case =
        serde_json::from_str(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    assert_eq!(case.guides.len(), MAX_GUIDES, "{}", path.display());
    case.guides
}

/// 50 mm in 100 ms after 50 ms of rest, under the paper's controller; the rest after it is
/// `DURATION` less 150 ms.
fn closed_loop(model: &StageModel, rates: Rates) -> ClosedLoop {
    let stage = Stage::new(model, rates, 1).expect("the bench's model is valid");
    let settings = ControllerSettings::paper(model.mass, rates.control(), model.motor.force_limit);
    let point = |time, position| Point {
        time,
        position,
        velocity: Some(0.0),
        acceleration: Some(0.0),
        effort: 0.0,
    };
    let trajectory =
        Trajectory::new(0, vec![point(50_000_000, 0.0), point(150_000_000, 50e-3)]).expect("valid");
    ClosedLoop::new(
        stage,
        Controller::new(settings).expect("the paper's controller is valid"),
        trajectory,
    )
}

fn closed_loop_pass(closed_loop: &mut ClosedLoop, cycles: usize) -> f64 {
    let mut force = 0.0;
    for _ in 0..cycles {
        force = closed_loop.cycle().expect("the trajectory was checked").terms.output;
    }
    force
}

/// Motor force per control sample of the closed-loop move, N, sensor noise included.
fn forces_of_the_move(model: &StageModel, rates: Rates) -> Vec<f64> {
    let mut closed_loop = closed_loop(model, rates);
    let cycles = (DURATION * rates.control()) as usize;
    (0..cycles)
        .map(|_| closed_loop.cycle().expect("the trajectory was checked").terms.output)
        .collect()
}

fn rust_pass(body: &mut Body, forces: &[f64], rates: Rates) -> f64 {
    body.reset();
    for force in forces {
        body.advance(black_box(*force), rates.substeps());
    }
    body.position()
}

/// `struct stage` of lugre.c.
#[repr(C)]
#[derive(Clone, Copy)]
struct CStage {
    step: f64,
    inverse_mass: f64,
    viscous_friction: f64,
    stiffness: [f64; MAX_GUIDES],
    compliance: [f64; MAX_GUIDES],
    bristle_damping: [f64; MAX_GUIDES],
    coulomb_force: [f64; MAX_GUIDES],
    stribeck_force: [f64; MAX_GUIDES],
    exponent: [f64; MAX_GUIDES],
    bristle: [f64; MAX_GUIDES],
    position: f64,
    velocity: f64,
    cell_force: f64,
    start_elastic: f64,
    start_damping: f64,
    start_slip: f64,
}

/// The C plant with its state.
struct CPlant {
    at_rest: CStage,
    stage: CStage,
    start: unsafe extern "C" fn(*mut CStage),
    advance: unsafe extern "C" fn(*mut CStage, f64, u32),
    _library: Library,
}

impl CPlant {
    fn new(library: Library, model: &StageModel, guides: &[Guide], rates: Rates) -> CPlant {
        assert!(
            guides.iter().all(|guide| guide.damping_velocity.is_none()),
            "lugre.c knows constant bristle damping only"
        );
        let lanes = |value: fn(&Guide) -> f64| std::array::from_fn(|lane| value(&guides[lane]));
        let at_rest = CStage {
            step: rates.physics().recip(),
            inverse_mass: model.mass.recip(),
            viscous_friction: guides.iter().map(|guide| guide.viscous_friction).sum(),
            stiffness: lanes(|guide| guide.stiffness),
            compliance: lanes(|guide| guide.stiffness.recip()),
            bristle_damping: lanes(|guide| guide.bristle_damping),
            coulomb_force: lanes(|guide| guide.coulomb_force),
            stribeck_force: lanes(|guide| guide.static_force - guide.coulomb_force),
            exponent: lanes(|guide| -guide.stribeck_velocity.powi(-2)),
            bristle: [0.0; MAX_GUIDES],
            position: 0.0,
            velocity: 0.0,
            cell_force: 0.0,
            start_elastic: 0.0,
            start_damping: 0.0,
            start_slip: 0.0,
        };
        // SAFETY: the library was built from lugre.c, whose functions have these signatures; it
        // lives as long as they do.
        let (start, advance) = unsafe {
            (
                *library.get(b"lugre_start").expect("lugre.c defines it"),
                *library.get(b"lugre_advance").expect("lugre.c defines it"),
            )
        };
        CPlant { at_rest, stage: at_rest, start, advance, _library: library }
    }

    fn reset(&mut self) {
        self.stage = self.at_rest;
        // SAFETY: a valid stage of the layout that lugre.c declares.
        unsafe { (self.start)(&mut self.stage) }
    }

    fn advance(&mut self, force: f64, steps: u32) {
        // SAFETY: as above.
        unsafe { (self.advance)(&mut self.stage, force, steps) }
    }

    fn pass(&mut self, forces: &[f64], rates: Rates) -> f64 {
        self.reset();
        for force in forces {
            self.advance(black_box(*force), rates.substeps());
        }
        self.stage.position
    }
}

/// Compiles lugre.c into `directory` and loads it; the error says what is missing. A compiler that
/// refuses the file panics.
fn compile(directory: &Path) -> Result<Library, String> {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/lugre.c");
    let shared = directory.join(libloading::library_filename("lugre"));
    let compiler = std::env::var("CC").unwrap_or_else(|_| "cc".to_owned());
    std::fs::create_dir_all(directory)
        .map_err(|error| format!("{}: {error}", directory.display()))?;
    let output = Command::new(&compiler)
        .args(["-O3", "-march=native", "-shared", "-fPIC", "-o"])
        .args([&shared, &source])
        .arg("-lm")
        .output()
        .map_err(|error| {
            format!(
                "no C compiler: `{compiler}` does not start ({error}); install gcc or clang, \
                     or set CC"
            )
        })?;
    assert!(
        output.status.success(),
        "{compiler} cannot compile {}:\n{}",
        source.display(),
        String::from_utf8_lossy(&output.stderr)
    );
    // SAFETY: lugre.c has no initialisers.
    unsafe { Library::new(&shared) }.map_err(|error| format!("{}: {error}", shared.display()))
}

/// Largest difference in position over the move, m; panics beyond `AGREEMENT`. Bristles must agree
/// as well.
fn check_agreement(rust: &mut Body, c: &mut CPlant, forces: &[f64], rates: Rates) -> f64 {
    rust.reset();
    c.reset();
    let mut largest = 0.0f64;
    let mut reversals = 0;
    for (index, force) in forces.iter().enumerate() {
        let before = rust.velocity();
        rust.advance(*force, rates.substeps());
        c.advance(*force, rates.substeps());
        reversals += usize::from(before * rust.velocity() < 0.0);
        let bristles =
            rust.guides().bristles().iter().zip(&c.stage.bristle).map(|(rust, c)| rust - c);
        let difference = bristles
            .chain([rust.position() - c.stage.position])
            .map(f64::abs)
            .fold(0.0, |a, b| if b > a || b.is_nan() { b } else { a });
        assert!(
            difference <= AGREEMENT && rust.cell_force() == c.stage.cell_force,
            "sample {index}: C and Rust differ by {difference:e} m, at most {AGREEMENT:e} m: they \
             do not integrate the same scheme"
        );
        largest = largest.max(difference);
    }
    assert!(
        rust.position() > 49e-3 && reversals > 10,
        "the move must rest, slide and reverse: {reversals} reversals"
    );
    largest
}

fn print_summary(
    model: &StageModel,
    rust: &mut Body,
    c: Option<&mut CPlant>,
    forces: &[f64],
    rates: Rates,
) {
    let steps = forces.len() as f64 * f64::from(rates.substeps());
    let time = |pass: &mut dyn FnMut() -> f64| {
        let start = thread_time();
        black_box(pass());
        thread_time() - start
    };
    let (mut rust_times, mut c_times, mut ratios, mut loop_times) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut c = c;
    for pass in 0..PASSES {
        let mut rust_pass = || time(&mut || rust_pass(rust, forces, rates));
        if let Some(c) = c.as_deref_mut() {
            let mut c_pass = || time(&mut || c.pass(forces, rates));
            // The order alternates: neither side always follows the other.
            let (rust_time, c_time) = if pass % 2 == 0 {
                let rust_time = rust_pass();
                (rust_time, c_pass())
            } else {
                let c_time = c_pass();
                (rust_pass(), c_time)
            };
            rust_times.push(rust_time);
            c_times.push(c_time);
            ratios.push(rust_time / c_time);
        } else {
            rust_times.push(rust_pass());
        }
        let mut closed_loop = closed_loop(model, rates);
        loop_times.push(time(&mut || closed_loop_pass(&mut closed_loop, forces.len())));
    }
    let nanoseconds = |times: &mut Vec<f64>| quartiles(times).map(|time| time / steps * 1e9);
    println!(
        "\n{PASSES} alternating passes over {steps} steps, processor time, median [quartiles]:"
    );
    let [low, median, high] = nanoseconds(&mut rust_times);
    println!("  step, Rust     {median:7.1} ns [{low:.1}, {high:.1}]   (wanted: at most 100 ns)");
    if c.is_some() {
        let [low, median, high] = nanoseconds(&mut c_times);
        println!("  step, C        {median:7.1} ns [{low:.1}, {high:.1}]");
        let [low, median, high] = quartiles(&mut ratios);
        println!("  Rust / C       {median:7.3}    [{low:.3}, {high:.3}] (wanted: at most 1)");
    }
    let [low, median, high] = quartiles(&mut loop_times).map(|time| forces.len() as f64 / time);
    println!(
        "  closed loop    {median:7.0} cycles/s [{high:.0}, {low:.0}] (wanted: at least 600000)"
    );
}

/// Time that this thread has spent on a processor, s: other processes on the machine do not count.
fn thread_time() -> f64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: writes the time into the structure that it is given.
    let status = unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &mut time) };
    assert_eq!(status, 0, "{}", std::io::Error::last_os_error());
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Lower quartile, median, upper quartile.
fn quartiles(values: &mut [f64]) -> [f64; 3] {
    values.sort_by(f64::total_cmp);
    [1, 2, 3].map(|quarter| values[(values.len() - 1) * quarter / 4])
}
