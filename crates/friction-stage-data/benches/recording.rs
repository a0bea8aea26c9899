//! How fast a recording is written: six topics as the stage sends them, as fast as possible and at
//! 10 kHz.
//!
//! `cargo bench -p friction-stage-data --bench recording` prints messages per second, the time of
//! one write (median, 99 %, longest: a chunk is compressed then) and bytes per message; for 10 kHz
//! also how much of one core it takes.

use std::path::Path;
use std::time::{Duration, Instant};

use friction_stage_data::bag::{BagError, BagOptions, BagWriter, Compression, OfferedQos, TopicId};
use friction_stage_data::message::{
    CdrError, ControllerState, Header, JointState, JointTrajectory, JointTrajectoryPoint,
    StageState, WrenchStamped, to_cdr,
};

const TOPICS: usize = 6;

/// CDR of one sample on six topics; times and values change from sample to sample as in a run.
fn sample(k: u64) -> Result<[Vec<u8>; TOPICS], CdrError> {
    let header = Header::new(k as i64 * 100_000, "stage");
    let phase = k as f64 * 1e-3;
    let noise = |salt: u64| (k.wrapping_add(salt).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40) as f64;
    let position = ((0.025e9 * phase.sin()).round() + (noise(1) % 3.0)) * 1e-9;
    let force = 40.0 * phase.cos() + noise(2) * 1e-8;
    Ok([
        to_cdr(&JointState {
            header: header.clone(),
            name: vec!["stage".into()],
            position: vec![position],
            velocity: vec![phase.cos() * 0.025],
            effort: vec![force],
        })?,
        to_cdr(&WrenchStamped::along_x(header.clone(), force))?,
        to_cdr(&WrenchStamped::along_x(header.clone(), force * 1.01))?,
        to_cdr(&JointTrajectory {
            header: header.clone(),
            joint_names: vec!["stage".into()],
            points: vec![JointTrajectoryPoint {
                positions: vec![0.025 * phase.sin()],
                velocities: vec![0.025 * phase.cos()],
                accelerations: vec![-0.025 * phase.sin()],
                ..Default::default()
            }],
        })?,
        to_cdr(&StageState {
            header: header.clone(),
            sample: k,
            position,
            velocity: phase.cos() * 0.025,
            acceleration: force / 40.0,
            motor_force: force,
            bristle_deflection: (0..4).map(|i| 1e-5 + noise(i) * 1e-12).collect(),
            guide_force: (0..4).map(|i| -13.5 + noise(i) * 1e-7).collect(),
            effect_name: vec!["cogging".into()],
            effect_force: vec![phase.sin()],
        })?,
        to_cdr(&ControllerState {
            header,
            sample: k,
            position,
            error: noise(3) * 1e-12,
            proportional: force * 0.5,
            integral: force * 0.25,
            derivative: force * 0.25,
            feedback: force,
            output: force,
            enabled: true,
            ..Default::default()
        })?,
    ])
}

fn open(
    directory: &Path,
    compression: Compression,
) -> Result<(BagWriter, [TopicId; TOPICS]), BagError> {
    let options = BagOptions { compression, ..Default::default() };
    let mut bag = BagWriter::create(directory, &options)?;
    let qos = OfferedQos::reliable(100);
    let ids = [
        bag.add_topic::<JointState>("/stage/encoder", &qos)?,
        bag.add_topic::<WrenchStamped>("/stage/force_cell", &qos)?,
        bag.add_topic::<WrenchStamped>("/stage/force", &qos)?,
        bag.add_topic::<JointTrajectory>("/stage/setpoint", &qos)?,
        bag.add_topic::<StageState>("/stage/state", &qos)?,
        bag.add_topic::<ControllerState>("/controller/state", &qos)?,
    ];
    Ok((bag, ids))
}

/// In us.
fn percentile(sorted_ns: &[u64], share: f64) -> f64 {
    sorted_ns[((sorted_ns.len() - 1) as f64 * share) as usize] as f64 * 1e-3
}

/// CPU time of this process, s.
fn cpu() -> f64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the pointer is to a live timespec
    unsafe { libc::clock_gettime(libc::CLOCK_PROCESS_CPUTIME_ID, &mut time) };
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let home = tempfile::tempdir()?;
    let samples = (0..100_000).map(sample).collect::<Result<Vec<_>, _>>()?;
    println!(
        "six topics, {} samples, as fast as possible; times of one write in us",
        samples.len()
    );
    println!("compression  messages/s   median      99 %   99.99 %   longest   bytes/message");
    for compression in [Compression::Zstd, Compression::Lz4, Compression::None] {
        let directory = home.path().join(format!("{compression:?}"));
        let (mut bag, ids) = open(&directory, compression)?;
        let mut times = Vec::with_capacity(samples.len() * TOPICS);
        let start = Instant::now();
        for (k, messages) in samples.iter().enumerate() {
            let time = k as u64 * 100_000;
            for (id, cdr) in ids.iter().zip(messages) {
                let begin = Instant::now();
                bag.write_cdr(*id, time, time, cdr)?;
                times.push(begin.elapsed().as_nanos() as u64);
            }
        }
        bag.finish()?;
        let elapsed = start.elapsed().as_secs_f64();
        let mut bytes = 0;
        for entry in std::fs::read_dir(&directory)? {
            bytes += entry?.metadata()?.len();
        }
        times.sort_unstable();
        println!(
            "{:11}  {:10.0}  {:7.2}  {:8.2}  {:8.1}  {:8.1}  {:14.1}",
            format!("{compression:?}"),
            times.len() as f64 / elapsed,
            percentile(&times, 0.5),
            percentile(&times, 0.99),
            percentile(&times, 0.9999),
            percentile(&times, 1.0),
            bytes as f64 / times.len() as f64
        );
    }
    let (mut bag, ids) = open(&home.path().join("paced"), Compression::Zstd)?;
    let period = Duration::from_micros(100);
    let ticks = 50_000u32;
    let (start, cpu_before) = (Instant::now(), cpu());
    let mut latest = Duration::ZERO;
    for k in 0..ticks {
        let due = period * k;
        if let Some(wait) = due.checked_sub(start.elapsed()) {
            std::thread::sleep(wait);
        }
        let time = u64::from(k) * 100_000;
        for (id, cdr) in ids.iter().zip(&samples[k as usize]) {
            bag.write_cdr(*id, time, time, cdr)?;
        }
        latest = latest.max(start.elapsed().saturating_sub(due));
    }
    let elapsed = start.elapsed().as_secs_f64();
    bag.finish()?;
    println!(
        "10 kHz x 6 topics for {elapsed:.2} s: {:.0} messages/s, {:.1} % of one core, at most \
         {:.2} ms behind",
        f64::from(ticks) * TOPICS as f64 / elapsed,
        100.0 * (cpu() - cpu_before) / elapsed,
        latest.as_secs_f64() * 1e3
    );
    Ok(())
}
