//! Recordings: what is written comes back, what is cut off is found, nothing that is broken makes
//! the program panic.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use friction_stage_data::bag::{
    BagError, BagOptions, BagReader, BagWriter, Compression, OfferedQos, Provenance, recover,
};
use friction_stage_data::message::{
    Clock, ControllerState, Definition, Float64MultiArray, Header, JointState, JointTrajectory,
    JointTrajectoryPoint, RosMessage, Time, WrenchStamped, from_cdr, to_cdr,
};
use friction_stage_data::quality::check;
use friction_stage_data::signals::{Trace, load};
use friction_stage_report::words::{messages_text, recover_text};
use proptest::prelude::*;
use serde::{Deserialize, Serialize};
use tempfile::TempDir;

const MILLISECOND: i64 = 1_000_000;

fn encoder(time: i64, position: f64) -> JointState {
    JointState {
        header: Header::new(time, "stage"),
        name: vec!["stage".into()],
        position: vec![position],
        velocity: vec![0.5],
        effort: vec![12.0],
    }
}

fn force(time: i64, value: f64) -> WrenchStamped {
    WrenchStamped::along_x(Header::new(time, "stage"), value)
}

fn setpoint(time: i64, position: f64) -> JointTrajectory {
    JointTrajectory {
        header: Header::new(time, "stage"),
        joint_names: vec!["stage".into()],
        points: vec![JointTrajectoryPoint {
            positions: vec![position],
            velocities: vec![1.0],
            accelerations: vec![-2.0],
            ..Default::default()
        }],
    }
}

fn provenance() -> Provenance {
    Provenance {
        model_yaml: "mass: 40.0 # kg\n".into(),
        seed: "7".into(),
        version: "0.1.0".into(),
        arguments: "--guide 1 --name \"a b\"".into(),
        extra: BTreeMap::from([("host".into(), "bench".into())]),
    }
}

fn options() -> BagOptions {
    BagOptions { provenance: Some(provenance()), ..Default::default() }
}

/// A bag with `samples` samples at 1 kHz on four topics.
fn write_bag(directory: &Path, options: &BagOptions, samples: i64) {
    let mut bag = BagWriter::create(directory, options).unwrap();
    let qos = OfferedQos::reliable(100);
    let encoder_id = bag.add_topic::<JointState>("/stage/encoder", &qos).unwrap();
    let cell_id = bag.add_topic::<WrenchStamped>("/stage/force_cell", &qos).unwrap();
    let force_id = bag.add_topic::<WrenchStamped>("/stage/force", &qos).unwrap();
    let setpoint_id = bag.add_topic::<JointTrajectory>("/stage/setpoint", &qos).unwrap();
    for k in 0..samples {
        let time = k * MILLISECOND;
        let x = (k as f64 * 0.01).sin() * 0.025;
        bag.write(encoder_id, time as u64, &encoder(time, x)).unwrap();
        bag.write(cell_id, time as u64, &force(time, 10.0 * x)).unwrap();
        bag.write(setpoint_id, time as u64, &setpoint(time, x + 1e-6)).unwrap();
        bag.write(force_id, time as u64, &force(time, 11.0 * x)).unwrap();
    }
    bag.finish().unwrap();
}

fn mcap_file(directory: &Path) -> PathBuf {
    let name = directory.file_name().unwrap().to_string_lossy();
    directory.join(format!("{name}_0.mcap"))
}

/// Small chunks, so that a small file has many of them.
fn small_chunks() -> BagOptions {
    BagOptions { chunk_bytes: 2000, ..options() }
}

#[test]
fn what_is_written_comes_back() {
    for compression in [Compression::Zstd, Compression::Lz4, Compression::None] {
        let home = TempDir::new().unwrap();
        let directory = home.path().join("above").join("run");
        write_bag(&directory, &BagOptions { compression, ..options() }, 3000);
        let reader = BagReader::open(&directory).unwrap();
        assert!(reader.is_complete());
        assert_eq!(reader.message_count(), 12_000);
        assert_eq!(reader.declared_count(), Some(12_000));
        assert_eq!(reader.time_range(), Some((0, 2999 * MILLISECOND as u64)));
        let stored = reader.provenance().unwrap().clone();
        assert_eq!(stored.extra["host"], "bench");
        assert_eq!(stored.model_yaml, provenance().model_yaml);
        assert_eq!(stored.arguments, provenance().arguments);
        let topic = reader.topic("/stage/encoder").unwrap();
        assert_eq!(topic.type_name, "sensor_msgs/msg/JointState");
        assert_eq!(topic.messages, 3000);
        assert_eq!(topic.type_hash(), Some(JointState::TYPE_HASH));
        assert_eq!(topic.definition, JointState::definition().as_bytes());
        assert!(topic.offered_qos().unwrap().contains("depth: 100"));
        let mut last = 0;
        let mut samples = 0;
        for message in reader.messages() {
            let message = message.unwrap();
            assert!(message.log_time >= last);
            last = message.log_time;
            if message.topic.name == "/stage/encoder" {
                let time = samples * MILLISECOND;
                let x = (samples as f64 * 0.01).sin() * 0.025;
                assert_eq!(message.decode::<JointState>().unwrap(), encoder(time, x));
                assert_eq!(message.sequence, samples as u32);
                samples += 1;
            }
        }
        assert_eq!(samples, 3000);
    }
}

#[test]
fn messages_come_in_the_order_of_time_even_if_written_otherwise() {
    let home = TempDir::new().unwrap();
    let directory = home.path().join("run");
    let mut bag = BagWriter::create(&directory, &small_chunks()).unwrap();
    let a = bag.add_topic::<Clock>("/a", &OfferedQos::default()).unwrap();
    let b = bag.add_topic::<Clock>("/b", &OfferedQos::default()).unwrap();
    for k in 0..2000u64 {
        bag.write(a, 1000 + 2 * k, &Clock::default()).unwrap();
        // 200 behind, and in steps back and forth
        bag.write(b, 801 + 2 * (k ^ 7), &Clock::default()).unwrap();
    }
    bag.finish().unwrap();
    let times: Vec<u64> =
        BagReader::open(&directory).unwrap().messages().map(|m| m.unwrap().log_time).collect();
    assert_eq!(times.len(), 4000);
    assert!(times.is_sorted());
}

#[test]
fn a_topic_added_later_is_recorded_and_a_second_type_is_refused() {
    let home = TempDir::new().unwrap();
    let directory = home.path().join("run");
    let mut bag = BagWriter::create(&directory, &small_chunks()).unwrap();
    let clock = bag.add_topic::<Clock>("/clock", &OfferedQos::default()).unwrap();
    for k in 0..500 {
        bag.write(clock, k, &Clock::default()).unwrap();
    }
    let later = bag.add_topic::<Float64MultiArray>("/later", &OfferedQos::best_effort(1)).unwrap();
    bag.write(later, 500, &Float64MultiArray::default()).unwrap();
    assert_eq!(bag.add_topic::<Clock>("/clock", &OfferedQos::default()).unwrap(), clock);
    let error =
        bag.add_topic::<JointState>("/clock", &OfferedQos::default()).unwrap_err().to_string();
    assert!(error.contains("rosgraph_msgs/msg/Clock") && error.contains("JointState"), "{error}");
    bag.finish().unwrap();
    let reader = BagReader::open(&directory).unwrap();
    assert_eq!(reader.topic("/later").unwrap().messages, 1);
    assert_eq!(reader.message_count(), 501);
}

#[test]
fn a_dropped_writer_leaves_a_whole_recording() {
    let home = TempDir::new().unwrap();
    let directory = home.path().join("run");
    let mut bag = BagWriter::create(&directory, &options()).unwrap();
    let clock = bag.add_topic::<Clock>("/clock", &OfferedQos::default()).unwrap();
    bag.write(clock, 1, &Clock::default()).unwrap();
    drop(bag);
    let reader = BagReader::open(&directory).unwrap();
    assert!(reader.is_complete());
    assert_eq!(reader.declared_count(), Some(1));
}

#[test]
fn an_existing_directory_is_refused_and_left_alone() {
    let home = TempDir::new().unwrap();
    let directory = home.path().join("run");
    write_bag(&directory, &options(), 10);
    let before = std::fs::read(mcap_file(&directory)).unwrap();
    let error = BagWriter::create(&directory, &options()).err().unwrap();
    assert!(matches!(&error, BagError::Exists { path } if *path == directory));
    assert!(error.to_string().contains(directory.to_str().unwrap()));
    assert_eq!(std::fs::read(mcap_file(&directory)).unwrap(), before);
}

#[test]
fn a_place_that_takes_no_files_is_named_with_the_reason() {
    let home = TempDir::new().unwrap();
    let file = home.path().join("file");
    std::fs::write(&file, "x").unwrap();
    let error = BagWriter::create(file.join("run"), &options()).err().unwrap().to_string();
    assert!(error.contains("cannot create") && error.contains("file"), "{error}");
    // no process, root included, makes directories in /proc
    let error = BagWriter::create("/proc/friction_stage/run", &options()).err().unwrap();
    assert!(matches!(error, BagError::Create { .. }), "{error}");
}

#[test]
fn what_is_no_recording_is_said_so() {
    let home = TempDir::new().unwrap();
    let open = |path: &Path| BagReader::open(path).unwrap_err().to_string();
    assert!(open(&home.path().join("nothing")).contains("cannot read"));
    assert!(open(home.path()).contains("neither metadata.yaml nor a file *.mcap or *.db3"));
    let text = home.path().join("text.mcap");
    std::fs::write(&text, "hello, this is not an MCAP file").unwrap();
    let error = BagReader::open(&text).unwrap_err();
    assert_eq!(error.offset(), Some(0));
    assert!(
        error.to_string().contains("text.mcap") && error.to_string().contains("not an MCAP file")
    );
    let other = home.path().join("other");
    write_bag(&other, &options(), 1);
    let metadata = other.join("metadata.yaml");
    let yaml = std::fs::read_to_string(&metadata).unwrap();
    let named = |storage: &str| {
        let named = format!("storage_identifier: {storage}");
        std::fs::write(&metadata, yaml.replace("storage_identifier: mcap", &named)).unwrap();
    };
    named("sqlite3");
    assert!(BagReader::open(&other).unwrap().is_complete(), "the files say what they are");
    named("rosbag_v2");
    std::fs::write(mcap_file(&other), "#ROSBAG V2.0\n").unwrap();
    let message = open(&other);
    assert!(message.contains("rosbag_v2") && message.contains("ros2 bag convert"), "{message}");
    assert!(open(&mcap_file(&other)).contains("rosbags-convert"));
}

#[test]
fn metadata_has_the_layout_that_plays_from_humble_on() {
    let home = TempDir::new().unwrap();
    let directory = home.path().join("run");
    write_bag(&directory, &options(), 20);
    let text = std::fs::read_to_string(directory.join("metadata.yaml")).unwrap();
    let value: serde_json::Value = serde_saphyr::from_str(&text).unwrap();
    let information = &value["rosbag2_bagfile_information"];
    assert_eq!(information["version"], 5);
    assert_eq!(information["storage_identifier"], "mcap");
    assert_eq!(information["compression_format"], "");
    assert_eq!(information["compression_mode"], "");
    assert_eq!(information["message_count"], 80);
    assert_eq!(information["relative_file_paths"][0], "run_0.mcap");
    assert_eq!(information["files"][0]["path"], "run_0.mcap");
    assert_eq!(information["duration"]["nanoseconds"], 19 * MILLISECOND);
    let topic = &information["topics_with_message_count"][0];
    assert_eq!(topic["message_count"], 20);
    let qos = topic["topic_metadata"]["offered_qos_profiles"].as_str().unwrap();
    let profiles: serde_json::Value = serde_saphyr::from_str(qos).unwrap();
    assert_eq!(profiles[0]["reliability"], 1);
}

#[test]
fn a_file_cut_anywhere_reads_up_to_the_cut_and_recovers() {
    let home = TempDir::new().unwrap();
    let directory = home.path().join("run");
    write_bag(&directory, &small_chunks(), 100);
    let whole = std::fs::read(mcap_file(&directory)).unwrap();
    let original: Vec<Vec<u8>> =
        BagReader::open(&directory).unwrap().messages().map(|m| m.unwrap().to_vec()).collect();
    assert_eq!(original.len(), 400);
    let mut recovered_before = 0;
    for length in (8..whole.len()).step_by(whole.len() / 150) {
        let cut = home.path().join("cut");
        std::fs::create_dir(&cut).unwrap();
        std::fs::write(cut.join("cut_0.mcap"), &whole[..length]).unwrap();
        let reader = BagReader::open(&cut).unwrap();
        assert!(!reader.is_complete(), "cut at {length}");
        let mut kept = 0;
        let mut error = None;
        for message in reader.messages() {
            match message {
                Ok(message) => {
                    assert_eq!(*message, *original[kept]);
                    kept += 1;
                }
                Err(e) => error = Some(e),
            }
        }
        let error = error.expect("the end of a cut-off recording is an error");
        assert!(error.offset().unwrap() <= length as u64);
        assert!(error.to_string().contains("cut_0.mcap"));
        assert!(kept >= recovered_before, "a longer file has more in it");
        recovered_before = kept;
        let report = recover(&cut, None).unwrap();
        assert_eq!(report.messages, kept as u64);
        let known = reader.provenance().is_some();
        assert_eq!(report.lost_at_end_s, known.then_some(0.5));
        let output = report.output.unwrap();
        assert_eq!(output, home.path().join("cut_recovered"));
        let again = BagReader::open(&output).unwrap();
        assert!(again.is_complete());
        assert_eq!(again.messages().filter_map(Result::ok).count(), kept);
        assert_eq!(std::fs::read(cut.join("cut_0.mcap")).unwrap(), &whole[..length]);
        std::fs::remove_dir_all(&cut).unwrap();
        std::fs::remove_dir_all(&output).unwrap();
    }
    assert_eq!(recovered_before, 400, "a cut in the index alone loses no message");
}

#[test]
fn recovery_keeps_everything_beside_the_messages() {
    let home = TempDir::new().unwrap();
    let directory = home.path().join("run");
    write_bag(&directory, &small_chunks(), 200);
    let file = mcap_file(&directory);
    let bytes = std::fs::read(&file).unwrap();
    std::fs::write(&file, &bytes[..bytes.len() / 2]).unwrap();
    let report = recover(&directory, Some(&home.path().join("whole"))).unwrap();
    assert!(report.bytes_dropped > 0);
    let (old, new) =
        (BagReader::open(&directory).unwrap(), BagReader::open(home.path().join("whole")).unwrap());
    assert_eq!(new.provenance(), old.provenance());
    assert!(new.provenance().unwrap().model_yaml.contains("40.0"));
    assert_eq!(new.topics(), old.topics());
    for (a, b) in old.messages().filter_map(Result::ok).zip(new.messages()) {
        let b = b.unwrap();
        assert_eq!(*a, *b);
        assert_eq!(
            (a.log_time, a.publish_time, a.sequence),
            (b.log_time, b.publish_time, b.sequence)
        );
    }
    let text = recover_text(&report);
    assert!(text.contains("/stage/encoder") && text.contains("bytes dropped"), "{text}");
}

#[test]
fn a_whole_recording_is_left_alone() {
    let home = TempDir::new().unwrap();
    let directory = home.path().join("run");
    write_bag(&directory, &options(), 50);
    let report = recover(&directory, None).unwrap();
    assert_eq!(report.output, None);
    assert_eq!(report.messages, 200);
    assert!(!home.path().join("run_recovered").exists());
    // without its metadata.yaml it needs a new one
    std::fs::remove_file(directory.join("metadata.yaml")).unwrap();
    let report = recover(&directory, None).unwrap();
    let new = BagReader::open(report.output.unwrap()).unwrap();
    assert_eq!(new.declared_count(), Some(200));
}

#[test]
fn a_damaged_chunk_costs_its_own_messages_only() {
    let home = TempDir::new().unwrap();
    let directory = home.path().join("run");
    write_bag(&directory, &small_chunks(), 400);
    let file = mcap_file(&directory);
    let mut bytes = std::fs::read(&file).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle..middle + 4].fill(0xff);
    std::fs::write(&file, &bytes).unwrap();
    let report = recover(&directory, None).unwrap();
    assert_eq!(report.damage.len(), 1, "{:?}", report.damage);
    assert!(report.damage[0].offset <= middle as u64);
    assert!(report.messages > 1500 && report.messages < 1600, "{}", report.messages);
    let checked = check(&directory).unwrap();
    assert!(!checked.damage.is_empty() && !checked.findings.is_empty());
}

#[test]
fn a_broken_length_is_skipped_with_the_help_of_the_index() {
    let home = TempDir::new().unwrap();
    let directory = home.path().join("run");
    write_bag(&directory, &small_chunks(), 400);
    let file = mcap_file(&directory);
    let mut bytes = std::fs::read(&file).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let chunk = &summary.chunk_indexes[summary.chunk_indexes.len() / 2];
    let at = chunk.chunk_start_offset as usize;
    bytes[at + 5] = 0x7f;
    std::fs::write(&file, &bytes).unwrap();
    let report = recover(&directory, None).unwrap();
    assert_eq!(report.damage[0].offset, at as u64);
    assert!(report.damage[0].bytes >= chunk.chunk_length);
    assert!(report.messages > 1500 && report.messages < 1600, "{}", report.messages);
}

/// Opens, reads, checks and recovers whatever is there; panics are the only failure.
fn exercise(home: &Path, file: &Path) {
    if let Ok(reader) = BagReader::open(file) {
        let _ = reader.messages().filter(Result::is_err).count();
        let _ = reader.is_complete();
    }
    let _ = check(file);
    let _ = Trace::from_bag(file);
    let out = home.join("out");
    let _ = recover(file, Some(&out));
    let _ = std::fs::remove_dir_all(&out);
}

fn sample_file() -> &'static [u8] {
    static BYTES: std::sync::OnceLock<Vec<u8>> = std::sync::OnceLock::new();
    BYTES.get_or_init(|| {
        let home = TempDir::new().unwrap();
        let directory = home.path().join("run");
        write_bag(&directory, &small_chunks(), 60);
        std::fs::read(mcap_file(&directory)).unwrap()
    })
}

/// The same without compression and checksums, so that flipped bytes reach the records.
fn bare_file() -> &'static [u8] {
    static BYTES: std::sync::OnceLock<Vec<u8>> = std::sync::OnceLock::new();
    BYTES.get_or_init(|| {
        let mut bytes = std::io::Cursor::new(Vec::new());
        let mut writer = mcap::WriteOptions::new()
            .compression(None)
            .calculate_chunk_crcs(false)
            .calculate_data_section_crc(false)
            .calculate_summary_section_crc(false)
            .chunk_size(Some(1000))
            .create(&mut bytes)
            .unwrap();
        let definition = JointState::definition();
        let schema = writer
            .add_schema("sensor_msgs/msg/JointState", "ros2msg", definition.as_bytes())
            .unwrap();
        let channel =
            writer.add_channel(schema, "/stage/encoder", "cdr", &BTreeMap::new()).unwrap();
        for k in 0..50 {
            let header = mcap::records::MessageHeader {
                channel_id: channel,
                sequence: k,
                log_time: u64::from(k),
                publish_time: 0,
            };
            let cdr = to_cdr(&encoder(i64::from(k), 0.1)).unwrap();
            writer.write_to_known_channel(&header, &cdr).unwrap();
        }
        writer.finish().unwrap();
        drop(writer);
        bytes.into_inner()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn damaged_files_never_panic(
        bare in any::<bool>(),
        flips in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        cut in proptest::option::of(any::<prop::sample::Index>()),
    ) {
        let home = TempDir::new().unwrap();
        let mut bytes = if bare { bare_file() } else { sample_file() }.to_vec();
        for (index, value) in flips {
            let at = index.index(bytes.len());
            bytes[at] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        let file = home.path().join("bag.mcap");
        std::fs::write(&file, &bytes).unwrap();
        exercise(home.path(), &file);
    }

    #[test]
    fn garbage_never_panics(
        body in proptest::collection::vec(any::<u8>(), 0..400),
        signed in any::<bool>(),
    ) {
        let home = TempDir::new().unwrap();
        let file = home.path().join("bag.mcap");
        let mut bytes = if signed { mcap::MAGIC.to_vec() } else { Vec::new() };
        bytes.extend(body);
        std::fs::write(&file, &bytes).unwrap();
        exercise(home.path(), &file);
    }
}

#[test]
fn every_single_byte_can_be_wrong_without_a_panic() {
    let home = TempDir::new().unwrap();
    let file = home.path().join("bag.mcap");
    // largest lengths are where arithmetic overflows
    for at in (8..bare_file().len()).step_by(3) {
        let mut bytes = bare_file().to_vec();
        bytes[at] = 0xff;
        std::fs::write(&file, &bytes).unwrap();
        if let Ok(reader) = BagReader::open(&file) {
            let _ = reader.messages().count();
        }
    }
}

/// Runs this test binary again as `test` with `BAG_CHILD` set to `directory`.
fn child(test: &str, directory: &Path) -> Command {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command
        .args([test, "--exact", "--nocapture", "--test-threads=1"])
        .env("BAG_CHILD", directory)
        .stdin(Stdio::null())
        .stdout(Stdio::piped());
    command
}

fn wall_ns() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_nanos() as u64
}

#[test]
fn a_killed_recorder_loses_less_than_a_second() {
    if let Some(directory) = std::env::var_os("BAG_CHILD") {
        // the recorder: writes at about 1 kHz with wall times until it is killed
        let mut bag = BagWriter::create(PathBuf::from(directory), &options()).unwrap();
        let id = bag.add_topic::<JointState>("/stage/encoder", &OfferedQos::reliable(10)).unwrap();
        for k in 0u64.. {
            let now = wall_ns();
            bag.write(id, now, &encoder(now as i64, 1e-3)).unwrap();
            if k % 100 == 0 {
                println!("written {now}");
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }
    let home = TempDir::new().unwrap();
    let directory = home.path().join("run");
    let mut recorder =
        child("a_killed_recorder_loses_less_than_a_second", &directory).spawn().unwrap();
    let lines = BufReader::new(recorder.stdout.take().unwrap()).lines();
    // past two flushes, at a moment that has nothing to do with them
    let mut written =
        lines.map_while(Result::ok).filter_map(|l| l.split_once("written ")?.1.parse::<u64>().ok());
    let first = written.next().expect("the recorder writes");
    let last = written.find(|t| t - first > 1_200_000_000).expect("it goes on");
    recorder.kill().unwrap();
    let killed = wall_ns();
    recorder.wait().unwrap();
    let report = recover(&directory, None).unwrap();
    let (_, kept) = report.time_range.unwrap();
    let lost = killed.saturating_sub(kept) as f64 * 1e-9;
    assert!(lost < 1.0, "lost {lost} s");
    assert!(kept + 1_000_000_000 > last);
    assert_eq!(report.lost_at_end_s, Some(0.5));
    let reader = BagReader::open(report.output.unwrap()).unwrap();
    assert!(reader.is_complete());
    assert_eq!(reader.provenance().unwrap().model_yaml, provenance().model_yaml);
}

#[test]
fn a_full_disk_is_an_error_and_what_was_written_recovers() {
    if let Some(directory) = std::env::var_os("BAG_CHILD") {
        // a limit on the file size fails a write as a full disk does
        let limit = libc::rlimit { rlim_cur: 300_000, rlim_max: 300_000 };
        // SAFETY: both calls only change limits and signal handling of this process
        unsafe {
            assert_eq!(libc::setrlimit(libc::RLIMIT_FSIZE, &limit), 0);
            libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
        }
        let mut bag = BagWriter::create(
            PathBuf::from(directory),
            &BagOptions { compression: Compression::None, chunk_bytes: 20_000, ..options() },
        )
        .unwrap();
        let id = bag.add_topic::<JointState>("/stage/encoder", &OfferedQos::reliable(10)).unwrap();
        let error = (0..100_000)
            .find_map(|k| bag.write(id, k, &encoder(k as i64, 0.0)).err())
            .expect("the limit is reached");
        println!("first: {error}");
        let full = matches!(error, BagError::Full { .. });
        let second = bag.write(id, 0, &encoder(0, 0.0)).unwrap_err();
        println!("second: {second}");
        let third = bag.finish().unwrap_err();
        println!("finish: {third}");
        std::process::exit(if full { 42 } else { 1 });
    }
    let home = TempDir::new().unwrap();
    let directory = home.path().join("run");
    let output = child("a_full_disk_is_an_error_and_what_was_written_recovers", &directory)
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(42), "{text}");
    assert!(text.contains("no space left for") && text.contains("run_0.mcap"), "{text}");
    assert!(text.contains("second: recording to"), "{text}");
    let report = recover(&directory, None).unwrap();
    // of 300 kB at 140 B a message all but the last chunk
    assert!(report.messages > 1500, "{}", report.messages);
    assert!(BagReader::open(report.output.unwrap()).unwrap().is_complete());
}

/// A controller's state as recordings of version 0.2 and before have it: of another package, and
/// without the terms of a compensation.
#[derive(Clone, Default, Serialize, Deserialize)]
struct FormerState {
    header: Header,
    sample: u64,
    /// Reference, its velocity and acceleration, position, error, terms of the PID, feedforward,
    /// effort and output.
    numbers: [f64; 13],
    saturated: bool,
    enabled: bool,
    holding: bool,
    setpoint_stamp: Time,
}

impl RosMessage for FormerState {
    const PACKAGE: &'static str = "friction_stage";
    const NAME: &'static str = ControllerState::NAME;
    const TYPE_HASH: &'static str =
        "RIHS01_acc9f7b22c1a2d9c0fe8d2f91d772a8380b1d7381db6078f9a4600b1e8fda677";
    const TEXT: &'static str = "\
std_msgs/Header header
uint64 sample
float64 reference_position
float64 reference_velocity
float64 reference_acceleration
float64 position
float64 error
float64 proportional
float64 integral
float64 derivative
float64 feedback
float64 mass_feedforward
float64 viscous_feedforward
float64 effort
float64 output
bool saturated
bool enabled
bool holding
builtin_interfaces/Time setpoint_stamp
";
    const DEPENDENCIES: &'static [Definition] = ControllerState::DEPENDENCIES;
}

#[test]
fn a_setpoint_that_begins_later_is_no_fault_of_its_log_time() {
    let home = TempDir::new().unwrap();
    let directory = home.path().join("run");
    let mut bag = BagWriter::create(&directory, &options()).unwrap();
    let qos = OfferedQos::reliable(10);
    let encoder_id = bag.add_topic::<JointState>("/stage/encoder", &qos).unwrap();
    let setpoint_id = bag.add_topic::<JointTrajectory>("/stage/setpoint", &qos).unwrap();
    for k in 0..8000_i64 {
        let time = k * MILLISECOND;
        bag.write(encoder_id, time as u64, &encoder(time, k as f64 * 1e-6)).unwrap();
        // The same one twice, and one that is to begin at once.
        if let 1000 | 1500 = k {
            bag.write(setpoint_id, time as u64, &setpoint(5000 * MILLISECOND, 0.01)).unwrap();
        } else if k == 6000 {
            bag.write(setpoint_id, time as u64, &setpoint(0, 0.0)).unwrap();
        }
    }
    bag.finish().unwrap();
    assert_eq!(check(&directory).unwrap().findings, []);
}

#[test]
fn messages_by_the_name_that_their_package_had_are_read_and_recovered() {
    let home = TempDir::new().unwrap();
    let directory = home.path().join("run");
    let mut bag = BagWriter::create(&directory, &options()).unwrap();
    let qos = OfferedQos::reliable(10);
    let encoder_id = bag.add_topic::<JointState>("/stage/encoder", &qos).unwrap();
    let state_id = bag.add_topic::<FormerState>("/controller/state", &qos).unwrap();
    for k in 0..100i64 {
        let (stamp, position) = (k * MILLISECOND, k as f64 * 1e-6);
        bag.write(encoder_id, stamp as u64, &encoder(stamp, position)).unwrap();
        let header = Header::new(stamp, "stage");
        let mut state = FormerState { header, ..FormerState::default() };
        state.numbers[0] = position + 1e-3;
        state.setpoint_stamp = Time { sec: 7, nanosec: 8 };
        bag.write(state_id, stamp as u64, &state).unwrap();
    }
    bag.finish().unwrap();
    let recovered = home.path().join("recovered");
    recover(&directory, Some(&recovered)).unwrap();
    for directory in [directory, recovered] {
        let topic = BagReader::open(&directory).unwrap().topic("/controller/state").cloned();
        assert_eq!(topic.unwrap().type_name, "friction_stage/msg/ControllerState");
        let reader = BagReader::open(&directory).unwrap();
        for message in reader.messages().map(Result::unwrap) {
            if message.topic.name != "/controller/state" {
                continue;
            }
            let state: ControllerState = message.decode().unwrap();
            assert_eq!(state.setpoint_stamp, Time { sec: 7, nanosec: 8 });
            assert_eq!((state.bristles_feedforward, state.disturbance), (0.0, 0.0));
            // One that was cut is none of before.
            assert!(from_cdr::<ControllerState>(&message[..message.len() - 12]).is_err());
        }
        let report = check(&directory).unwrap();
        let state = report.topics.iter().find(|topic| topic.name == "/controller/state").unwrap();
        assert!(state.decoded && state.by_stamp && state.decode_failures == 0, "{state:?}");
        for trace in [Trace::from_bag(&directory).unwrap(), load(&directory, None).unwrap().trace] {
            assert!(trace.len() > 90);
            for (reference, position) in trace.reference_position.iter().zip(&trace.position) {
                assert!((reference - position - 1e-3).abs() < 1e-9, "{reference} {position}");
            }
        }
    }
}

#[test]
fn the_force_of_topic_hardware_is_that_of_the_sample_at_which_the_stage_took_it() {
    let home = TempDir::new().unwrap();
    let directory = home.path().join("run");
    let mut bag = BagWriter::create(&directory, &options()).unwrap();
    let qos = OfferedQos::reliable(10);
    let encoder_id = bag.add_topic::<JointState>("/stage/encoder", &qos).unwrap();
    let command_id = bag.add_topic::<JointState>("/stage/joint_commands", &qos).unwrap();
    for k in 0..100i64 {
        let stamp = k * MILLISECOND;
        bag.write(encoder_id, stamp as u64, &encoder(stamp, k as f64 * 1e-6)).unwrap();
        // The hardware's own clock is a tick behind at every third.
        let shown = if k % 3 == 1 { stamp - MILLISECOND } else { stamp };
        let command = JointState { effort: vec![k as f64], ..encoder(shown, 0.0) };
        bag.write(command_id, stamp as u64, &command).unwrap();
    }
    bag.finish().unwrap();
    for trace in [Trace::from_bag(&directory).unwrap(), load(&directory, None).unwrap().trace] {
        let expected: Vec<f64> = (0..trace.len()).map(|k| k as f64).collect();
        assert_eq!(trace.force, expected);
    }
    let report = check(&directory).unwrap();
    assert!(report.findings.is_empty(), "{:?}", report.findings);
}

#[test]
fn check_tells_rates_gaps_and_bad_values() {
    let home = TempDir::new().unwrap();
    let directory = home.path().join("run");
    let mut bag = BagWriter::create(&directory, &options()).unwrap();
    let qos = OfferedQos::reliable(10);
    let id = bag.add_topic::<JointState>("/stage/encoder", &qos).unwrap();
    let force_id = bag.add_topic::<WrenchStamped>("/stage/force", &qos).unwrap();
    for k in 0..1000i64 {
        // 20 samples missing after 500, one stamp repeated, one going back
        let stamp = match k {
            300 => 299,
            400 => 397,
            k if k > 500 => k + 20,
            k => k,
        } * MILLISECOND;
        let x = 1e-3 * (k as f64 * 0.02).sin();
        bag.write(id, k as u64 * 1_000_000, &encoder(stamp, x)).unwrap();
        let value = if k == 7 { f64::NAN } else { 1.0 };
        bag.write(force_id, k as u64 * 1_000_000, &force(k * MILLISECOND, value)).unwrap();
    }
    bag.write_cdr(force_id, 1_000_000_000, 1_000_000_000, &[0, 1, 0, 0, 9]).unwrap();
    bag.finish().unwrap();
    let report = check(&directory).unwrap();
    assert!(report.complete && report.has_provenance);
    assert_eq!(report.joints, ["stage"]);
    let encoder = &report.topics[0];
    assert_eq!((encoder.messages, encoder.repeated_stamps, encoder.backward_stamps), (1000, 1, 1));
    assert!((encoder.rate_hz.unwrap() - 1000.0).abs() < 1e-6);
    assert!((encoder.longest_gap_s.unwrap() - 0.021).abs() < 1e-9);
    // 2 ms after the repeated stamp, 4 ms after the one that goes back, 21 ms
    assert_eq!(encoder.gaps, 3);
    let force = &report.topics[1];
    assert_eq!((force.non_finite, force.decode_failures, force.gaps), (1, 1, 0));
    assert_eq!(force.jitter_s, Some(0.0));
    let text = messages_text(&report);
    for part in ["/stage/encoder", "1000.0", "stamps go back", "not finite", "do not decode"] {
        assert!(text.contains(part), "{part} is missing in\n{text}");
    }
    let json = serde_json::to_value(&report).unwrap();
    assert_eq!(json["topics"][0]["messages"], 1000);
}

#[test]
fn a_clean_recording_has_no_warnings() {
    let home = TempDir::new().unwrap();
    let directory = home.path().join("run");
    write_bag(&directory, &options(), 1000);
    let report = check(&directory).unwrap();
    assert_eq!(report.findings, []);
    assert_eq!(report.messages, 4000);
}

#[test]
fn a_trace_joins_the_signals_on_their_stamps() {
    let home = TempDir::new().unwrap();
    let directory = home.path().join("run");
    write_bag(&directory, &options(), 1000);
    let trace = Trace::from_bag(&directory).unwrap();
    assert_eq!(trace.len(), 1000);
    for k in 0..1000 {
        let x = (k as f64 * 0.01).sin() * 0.025;
        assert_eq!(trace.position[k], x);
        assert_eq!(trace.reference_position[k], x + 1e-6);
        assert_eq!(trace.reference_velocity[k], 1.0);
        assert_eq!(trace.reference_acceleration[k], -2.0);
        assert_eq!(trace.force_cell[k], 10.0 * x);
        assert_eq!(trace.force[k], 11.0 * x);
        assert!((trace.time[k] - k as f64 * 1e-3).abs() < 1e-12);
    }
    let csv = home.path().join("trace.csv");
    trace.write_csv(&csv).unwrap();
    // The table is read as any other.
    let read = load(&csv, None).unwrap().trace;
    assert_eq!(read.columns()[1..], trace.columns()[1..]);
}

#[test]
fn a_trace_takes_the_reference_from_the_controller_and_says_what_is_missing() {
    let home = TempDir::new().unwrap();
    let directory = home.path().join("run");
    let mut bag = BagWriter::create(&directory, &options()).unwrap();
    let qos = OfferedQos::reliable(10);
    let id = bag.add_topic::<JointState>("/stage/encoder", &qos).unwrap();
    let state_id = bag.add_topic::<ControllerState>("/controller/state", &qos).unwrap();
    for k in 0..3i64 {
        bag.write(id, k as u64, &encoder(k * MILLISECOND, 0.5)).unwrap();
        let state = ControllerState {
            header: Header::new(k * MILLISECOND, "stage"),
            reference_position: k as f64,
            output: 10.0 * k as f64,
            ..Default::default()
        };
        bag.write(state_id, k as u64, &state).unwrap();
    }
    bag.finish().unwrap();
    let trace = Trace::from_bag(&directory).unwrap();
    assert_eq!(trace.reference_position, [0.0, 1.0, 2.0]);
    // No topic of commands is recorded.
    assert_eq!(trace.force, [0.0, 10.0, 20.0]);
    assert!(trace.reference_velocity.iter().all(|velocity| *velocity == 0.0));

    let other = home.path().join("other");
    let mut bag = BagWriter::create(&other, &options()).unwrap();
    bag.add_topic::<Clock>("/clock", &qos).unwrap();
    bag.finish().unwrap();
    let error = Trace::from_bag(&other).unwrap_err().to_string();
    assert!(error.contains("/stage/encoder") && error.contains("/clock"), "{error}");
}

#[test]
fn the_commands_report_and_say_how_it_ended() {
    use friction_stage::cli::{Outcome, check as check_command, recover as recover_command};
    let home = TempDir::new().unwrap();
    let directory = home.path().join("run");
    write_bag(&directory, &small_chunks(), 100);
    let run_check = |json| {
        let mut out = Vec::new();
        let args = check_command::CheckArgs {
            bag: directory.clone(),
            model: None,
            mapping: None,
            part: Default::default(),
            json,
        };
        let outcome = check_command::run(&args, &mut out).unwrap();
        (outcome, String::from_utf8(out).unwrap())
    };
    let run_recover = || {
        let mut out = Vec::new();
        let args = recover_command::RecoverArgs { bag: directory.clone(), out: None, json: true };
        let outcome = recover_command::run(&args, &mut out).unwrap();
        let value: serde_json::Value = serde_json::from_slice(&out).unwrap();
        (outcome, value)
    };
    assert_eq!(run_check(false).0, Outcome::Done);
    assert_eq!(run_recover().0, Outcome::Done);
    let bytes = std::fs::read(mcap_file(&directory)).unwrap();
    std::fs::write(mcap_file(&directory), &bytes[..bytes.len() * 2 / 3]).unwrap();
    let (outcome, text) = run_check(true);
    assert_eq!(outcome, Outcome::Warnings);
    let value: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(value["complete"], false);
    let (outcome, value) = run_recover();
    assert_eq!(outcome, Outcome::Warnings);
    assert!(value["bytes_dropped"].as_u64().unwrap() > 0);
}
