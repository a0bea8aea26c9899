//! Bags of every storage: sqlite3 of any version, compressed by file and by message, with metadata
//! as others leave them, without definitions, damaged.
//!
//! The bags in `fixtures` were written by the Python package rosbags (`make_bags.py`); the others
//! are written here with the tables of rosbag2_storage_sqlite3 or the mcap crate.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use friction_stage_data::bag::{BagError, BagReader, recover};
use friction_stage_data::message::{Header, JointState, RosMessage, WrenchStamped, to_cdr};
use friction_stage_data::quality::{FileFinding, check};
use friction_stage_data::signals::{Mapping, Recording, SignalError, load};
use proptest::prelude::*;
use rusqlite::{Connection, params};
use tempfile::TempDir;

const BEGIN: i64 = 1_700_000_000_000_000_000;
const STEP: i64 = 10_000_000;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(name)
}

fn mapping() -> Mapping {
    Mapping::from_yaml(
        "joint: x_axis\nsignals:\n  position: {topic: /joint_states, field: 'position[joint]'}\n\
         \x20 force: {topic: /joint_states, field: 'effort[joint]'}\n",
        "m.yaml",
    )
    .unwrap()
}

fn position(k: usize) -> f64 {
    let from_middle = k as f64 % 20.0 - 10.0;
    from_middle * from_middle / 4096.0
}

fn force(k: usize) -> f64 {
    k as f64 % 7.0 - 3.0
}

fn joint_state(k: usize) -> JointState {
    JointState {
        header: Header::new(BEGIN + k as i64 * STEP, "base"),
        name: vec!["gripper".into(), "x_axis".into()],
        position: vec![7.0, position(k)],
        velocity: vec![],
        effort: vec![9.0, force(k)],
    }
}

/// The signals of `path` are those of [`joint_state`], `count` rows of them.
#[track_caller]
fn has_signals(path: &Path, count: usize) -> Recording {
    let recording = load(path, Some(&mapping())).unwrap();
    let rows: Vec<(f64, f64)> = (0..count).map(|k| (position(k), force(k))).collect();
    let trace = &recording.trace;
    let read: Vec<(f64, f64)> =
        trace.position.iter().copied().zip(trace.force.iter().copied()).collect();
    assert_eq!(read, rows, "{}", path.display());
    assert_eq!(trace.origin_ns, BEGIN);
    recording
}

/// Everything in a directory, by name.
fn contents(directory: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path());
    entries
        .map(|path| (path.file_name().unwrap().to_string_lossy().into(), fs::read(&path).unwrap()))
        .collect()
}

/// Tables of rosbag2_storage_sqlite3: 1 (Crystal, Dashing), 2 (Foxy), 3 (Humble), 4 (Iron and on).
fn tables(version: u32) -> String {
    let mut sql = String::new();
    if version >= 3 {
        sql += "CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
                CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, \
                metadata TEXT NOT NULL);";
        sql += &format!("INSERT INTO schema VALUES ({version}, 'humble');");
    }
    sql += "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, \
            serialization_format TEXT NOT NULL";
    if version >= 2 {
        sql += ", offered_qos_profiles TEXT NOT NULL";
    }
    if version >= 4 {
        sql += ", type_description_hash TEXT NOT NULL";
    }
    sql += ");";
    if version >= 4 {
        sql += "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, \
                encoding TEXT NOT NULL, encoded_message_definition TEXT NOT NULL, \
                type_description_hash TEXT NOT NULL);";
    }
    sql += "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, \
            timestamp INTEGER NOT NULL, data BLOB NOT NULL);
            CREATE INDEX timestamp_idx ON messages (timestamp ASC);";
    sql
}

struct Sqlite {
    connection: Connection,
    version: u32,
}

impl Sqlite {
    fn create(path: &Path, version: u32) -> Self {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        let connection = Connection::open(path).unwrap();
        connection.execute_batch(&tables(version)).unwrap();
        Self { connection, version }
    }

    fn topic(&self, id: i64, name: &str, kind: &str) {
        let more = ["", ", ''", ", ''", ", '', 'RIHS01_0'"][self.version as usize - 1];
        let sql = format!("INSERT INTO topics VALUES (?1, ?2, ?3, 'cdr'{more})");
        self.connection.execute(&sql, params![id, name, kind]).unwrap();
    }

    fn message(&self, topic: i64, time: i64, data: &[u8]) {
        let sql = "INSERT INTO messages (topic_id, timestamp, data) VALUES (?1, ?2, ?3)";
        self.connection.execute(sql, params![topic, time, data]).unwrap();
    }

    /// Joint states `range`, with 200 bytes each.
    fn joints(path: &Path, version: u32, range: std::ops::Range<usize>) -> Self {
        let file = Self::create(path, version);
        file.topic(1, "/joint_states", &JointState::type_name());
        file.connection.execute_batch("BEGIN").unwrap();
        for k in range {
            file.message(1, BEGIN + k as i64 * STEP + 500, &to_cdr(&joint_state(k)).unwrap());
        }
        file.connection.execute_batch("COMMIT").unwrap();
        file
    }
}

/// `metadata.yaml` as `ros2 bag record` of Humble writes it, with these lines for its own.
fn metadata(storage: &str, files: &[&str], more: &str) -> String {
    format!(
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: {storage}\n\
         \x20 relative_file_paths: [{}]\n{more}",
        files.join(", ")
    )
}

#[test]
fn bags_of_another_writer_are_read_in_every_storage_and_compression() {
    for storage in ["sqlite3", "mcap"] {
        for mode in ["none", "file", "message"] {
            let bag = fixture(&format!("{storage}_{mode}"));
            let before = contents(&bag);
            has_signals(&bag, 50);
            let report = check(&bag).unwrap();
            assert!(report.complete && report.damage.is_empty(), "{report:?}");
            assert_eq!((report.messages, report.findings.as_slice()), (100, &[][..]), "{bag:?}");
            assert_eq!(report.topics[0].messages, 50);
            // the files alone do as well
            let name = before.keys().find(|name| !name.ends_with(".yaml")).unwrap();
            has_signals(&bag.join(name), 50);
            // a type that only the definition in the bag tells
            let own = "signals: {position: {topic: /drive, field: current}}";
            let drive = load(&bag, Some(&Mapping::from_yaml(own, "m.yaml").unwrap())).unwrap();
            assert_eq!(drive.trace.position[..3], [0.0, 0.25, 0.5]);
            assert_eq!(contents(&bag), before, "reading writes nothing");
        }
    }
}

#[test]
fn sqlite_files_of_every_version_are_read() {
    let home = TempDir::new().unwrap();
    for version in 1..=4 {
        let file = home.path().join(format!("v{version} with % and ?/a_0.db3"));
        drop(Sqlite::joints(&file, version, 0..40));
        has_signals(&file, 40);
        let reader = BagReader::open(&file).unwrap();
        assert_eq!(reader.topics()[0].messages, 40);
        assert_eq!(reader.topics()[0].type_hash().is_some(), version == 4);
        assert_eq!(
            reader.time_range(),
            Some(((BEGIN + 500) as u64, (BEGIN + 39 * STEP + 500) as u64))
        );
        assert_eq!(contents(file.parent().unwrap()).len(), 1, "no journal, no log");
    }
}

#[test]
fn a_sqlite_bag_of_several_files_comes_in_the_order_of_time() {
    let home = TempDir::new().unwrap();
    drop(Sqlite::joints(&home.path().join("a_0.db3"), 3, 0..25));
    drop(Sqlite::joints(&home.path().join("a_1.db3"), 3, 25..50));
    // rows in another order than that of time, over more than a page
    let shuffled = Sqlite::joints(&home.path().join("a_2.db3"), 3, 50..50);
    shuffled.connection.execute_batch("BEGIN").unwrap();
    for k in (0..9000).map(|k| 50 + k * 7 % 9000) {
        let data = to_cdr(&joint_state(k)).unwrap();
        shuffled.message(1, BEGIN + k as i64 * STEP + 500, &data);
    }
    shuffled.connection.execute_batch("COMMIT").unwrap();
    drop(shuffled);
    let files = ["a_0.db3", "a_1.db3", "a_2.db3"];
    let counted = metadata("sqlite3", &files, "  message_count: 9050\n");
    fs::write(home.path().join("metadata.yaml"), counted).unwrap();
    has_signals(home.path(), 9050);
    let times: Vec<u64> =
        BagReader::open(home.path()).unwrap().messages().map(|m| m.unwrap().log_time).collect();
    assert!(times.is_sorted() && times.len() == 9050);
    assert_eq!(check(home.path()).unwrap().findings, []);
}

#[test]
fn a_sqlite_file_without_its_index_is_read_in_the_order_of_time() {
    let home = TempDir::new().unwrap();
    for (name, factor) in [("in_order.db3", 1), ("shuffled.db3", 7)] {
        let file = home.path().join(name);
        let bag = Sqlite::joints(&file, 3, 0..0);
        bag.connection.execute_batch("DROP INDEX timestamp_idx; BEGIN").unwrap();
        for k in (0..9000).map(|k| k * factor % 9000) {
            let data = to_cdr(&joint_state(k)).unwrap();
            bag.message(1, BEGIN + k as i64 * STEP + 500, &data);
        }
        bag.connection.execute_batch("COMMIT").unwrap();
        drop(bag);
        has_signals(&file, 9000);
        let reader = BagReader::open(&file).unwrap();
        assert!(reader.messages().map(|m| m.unwrap().log_time).is_sorted(), "{name}");
    }
}

#[test]
fn messages_of_one_time_all_come_once() {
    let home = TempDir::new().unwrap();
    let file = home.path().join("a_0.db3");
    let bag = Sqlite::joints(&file, 3, 0..0);
    bag.connection.execute_batch("BEGIN").unwrap();
    for k in 0..10_000i64 {
        bag.message(1, BEGIN, &k.to_le_bytes());
    }
    bag.connection.execute_batch("COMMIT").unwrap();
    drop(bag);
    let reader = BagReader::open(&file).unwrap();
    let read: Vec<i64> = reader
        .messages()
        .map(|message| i64::from_le_bytes(message.unwrap()[..].try_into().unwrap()))
        .collect();
    assert_eq!(read, (0..10_000).collect::<Vec<_>>());
}

#[test]
fn what_a_killed_recorder_left_in_its_log_is_read() {
    let home = TempDir::new().unwrap();
    let file = home.path().join("live/a_0.db3");
    let bag = Sqlite::joints(&file, 3, 0..10);
    bag.connection.pragma_update(None, "journal_mode", "wal").unwrap();
    for k in 10..30 {
        bag.message(1, BEGIN + k as i64 * STEP + 500, &to_cdr(&joint_state(k)).unwrap());
    }
    // as a kill leaves it: the file and the log, copied while the recorder has them open
    let copy = home.path().join("killed");
    fs::create_dir(&copy).unwrap();
    for name in ["a_0.db3", "a_0.db3-wal"] {
        fs::copy(file.with_file_name(name), copy.join(name)).unwrap();
    }
    let before = contents(&copy);
    has_signals(&copy.join("a_0.db3"), 30);
    assert_eq!(contents(&copy), before, "reading writes nothing");
}

#[test]
fn metadata_as_others_leave_them_are_read() {
    let home = TempDir::new().unwrap();
    drop(Sqlite::joints(&home.path().join("a_0.db3"), 3, 0..30));
    let yaml = home.path().join("metadata.yaml");
    let reindexed = "  duration: {nanoseconds: 0}\n  starting_time: {nanoseconds_since_epoch: \
                     9223372036854775807}\n  topics_with_message_count: []\n  files: []\n  \
                     custom_data: ~\n";
    let cases = [
        // `ros2 bag reindex`
        metadata("\"\"", &["a_0.db3"], reindexed),
        metadata("sqlite3", &["a_0.db3"], "  message_count: ~\n"),
        // versions before 4 name the directory, too, whatever it is called now
        metadata("sqlite3", &["old_name/a_0.db3"], "").replace("version: 5", "version: 3"),
        // version 9 with profiles as a list
        metadata(
            "sqlite3",
            &["a_0.db3"],
            "  message_count: 30\n  topics_with_message_count:\n  - topic_metadata: {name: \
             /joint_states, type: sensor_msgs/msg/JointState, serialization_format: cdr, \
             offered_qos_profiles: [{history: keep_last, depth: 3}], type_description_hash: \
             RIHS01_0}\n    message_count: 30\n  ros_distro: rolling\n",
        )
        .replace("version: 5", "version: 9"),
    ];
    for text in cases {
        fs::write(&yaml, &text).unwrap();
        has_signals(home.path(), 30);
        assert_eq!(check(home.path()).unwrap().findings, [], "{text}");
    }
    fs::write(&yaml, metadata("sqlite3", &["a_0.db3"], "  message_count: 31\n")).unwrap();
    let found = check(home.path()).unwrap().findings;
    assert_eq!(found, [FileFinding::MessageCount { declared: 31, read: 30 }]);
    // a file that is named and is not there
    fs::write(&yaml, metadata("sqlite3", &["a_0.db3", "a_1.db3"], "")).unwrap();
    let report = check(home.path()).unwrap();
    assert!(!report.complete && report.damage[0].path.ends_with("a_1.db3"), "{report:?}");
    // a file that was renamed
    fs::write(&yaml, metadata("sqlite3", &["b_0.db3"], "  message_count: 30\n")).unwrap();
    has_signals(home.path(), 30);
    assert_eq!(check(home.path()).unwrap().findings, []);
    // without metadata, and with broken ones
    for broken in [None, Some("rosbag2_bagfile_information: [")] {
        match broken {
            Some(text) => fs::write(&yaml, text).unwrap(),
            None => fs::remove_file(&yaml).unwrap(),
        }
        has_signals(home.path(), 30);
        assert_eq!(check(home.path()).unwrap().findings, [FileFinding::NoMetadata]);
    }
}

#[test]
fn compression_other_than_zstd_is_refused_with_what_would_do() {
    let home = TempDir::new().unwrap();
    drop(Sqlite::joints(&home.path().join("a_0.db3"), 3, 0..3));
    let packed = "  compression_format: lz4\n  compression_mode: MESSAGE\n";
    let yaml = metadata("sqlite3", &["a_0.db3"], packed);
    fs::write(home.path().join("metadata.yaml"), yaml).unwrap();
    let error = BagReader::open(home.path()).unwrap_err().to_string();
    assert!(error.contains("lz4") && error.contains("zstd"), "{error}");
}

#[test]
fn types_without_definition_are_known_or_said_to_be_missing() {
    let home = TempDir::new().unwrap();
    let file = home.path().join("a_0.db3");
    let bag = Sqlite::joints(&file, 3, 0..20);
    bag.topic(2, "/cell", "geometry_msgs/WrenchStamped");
    bag.topic(3, "/drive", "made_up_msgs/msg/Drive");
    bag.topic(4, "/speed", "std_msgs/msg/Float32");
    for k in 0..20i64 {
        let wrench = WrenchStamped::along_x(Header::new(BEGIN + k * STEP, "cell"), k as f64);
        bag.message(2, BEGIN + k * STEP, &to_cdr(&wrench).unwrap());
        bag.message(3, BEGIN + k * STEP, &[0, 1, 0, 0, 1, 2, 3, 4]);
        let speed = (k as f32 * 0.5).to_le_bytes();
        bag.message(4, BEGIN + k * STEP, &[&[0, 1, 0, 0], &speed[..]].concat());
    }
    drop(bag);
    let read = |topic: &str, field: &str| {
        let text = format!("signals: {{position: {{topic: {topic}, field: {field}}}}}");
        load(&file, Some(&Mapping::from_yaml(&text, "m.yaml").unwrap()))
    };
    assert_eq!(read("/cell", "wrench.force.x").unwrap().trace.position[7], 7.0);
    assert_eq!(read("/speed", "data").unwrap().trace.position[7], 3.5);
    let error = read("/drive", "current").unwrap_err().to_string();
    for words in ["/drive", "made_up_msgs", "no definition", "ros2 bag convert"] {
        assert!(error.contains(words), "{error}");
    }
    // what is recovered has the definitions
    let whole = recover(&file, Some(&home.path().join("whole"))).unwrap().output.unwrap();
    let reader = BagReader::open(&whole).unwrap();
    assert!(!reader.topic("/speed").unwrap().definition.is_empty());
    has_signals(&whole, 20);
}

/// An MCAP file with 30 joint states, in messages of these bytes.
fn mcap_file(
    path: &Path,
    schema: Option<(&str, &str, &str)>,
    bytes: impl Fn(usize) -> Vec<u8>,
) -> PathBuf {
    let mut writer = mcap::Writer::new(fs::File::create(path).unwrap()).unwrap();
    let schema = schema.map_or(0, |(name, encoding, text)| {
        writer.add_schema(name, encoding, text.as_bytes()).unwrap()
    });
    let channel = writer.add_channel(schema, "/joint_states", "cdr", &BTreeMap::new()).unwrap();
    for k in 0..30 {
        let log_time = (BEGIN + k as i64 * STEP) as u64;
        let header = mcap::records::MessageHeader {
            channel_id: channel,
            sequence: k as u32,
            log_time,
            publish_time: log_time,
        };
        writer.write_to_known_channel(&header, &bytes(k)).unwrap();
    }
    writer.finish().unwrap();
    path.to_owned()
}

fn plain(k: usize) -> Vec<u8> {
    to_cdr(&joint_state(k)).unwrap()
}

const ALONE: &str = "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] \
                     velocity\nfloat64[] effort\n";

#[test]
fn mcap_without_schemas_or_with_parts_of_them_is_read_for_known_types() {
    let home = TempDir::new().unwrap();
    let path = home.path().join("a_0.mcap");
    let name = "sensor_msgs/msg/JointState";
    for schema in [
        None,
        Some((name, "ros2msg", ALONE)),
        Some((name, "", "")),
        Some((name, "ros2msg", "")),
        Some((name, "ros2idl", "module sensor_msgs { module msg { struct JointState {}; }; };")),
        Some(("sensor_msgs/JointState", "ros2msg", ALONE)),
        Some(("own_msgs/msg/State", "ros2msg", ALONE)),
    ] {
        has_signals(&mcap_file(&path, schema, plain), 30);
    }
    let report = check(&mcap_file(&path, None, plain)).unwrap();
    assert_eq!(report.topics[0].type_name, name);
    assert!(report.topics[0].decoded && report.topics[0].decode_failures == 0);
    let FileFinding::TypeByMessages { type_name, .. } = &report.findings[0] else {
        panic!("{:?}", report.findings)
    };
    assert_eq!(type_name, name);
    // one joint, whose bytes fit other types, too
    let one = |k: usize| {
        to_cdr(&JointState {
            header: Header::new(BEGIN + k as i64 * STEP, ""),
            name: vec!["x_axis".into()],
            position: vec![position(k)],
            velocity: vec![0.0],
            effort: vec![force(k)],
        })
        .unwrap()
    };
    let several = mcap_file(&path, None, one);
    assert!(BagReader::open(&several).unwrap().topics()[0].fitting_types.len() > 1);
    has_signals(&several, 30);
    // without text only the field tells: a wrench is no twist
    let wrench = |k: usize| {
        let numbers = [position(k), 0.0, 0.0, 0.0, 0.0, force(k)];
        [&[0, 1, 0, 0][..], &numbers.map(f64::to_le_bytes).concat()].concat()
    };
    let several = mcap_file(&path, None, wrench);
    let field = |field: &str| {
        let text = format!("signals: {{position: {{topic: /joint_states, field: {field}}}}}");
        load(&several, Some(&Mapping::from_yaml(&text, "m.yaml").unwrap()))
    };
    assert_eq!(field("force.x").unwrap().trace.position[3], position(3));
    let error = field("linear.x").unwrap_err().to_string();
    assert!(error.contains("Twist or ") || error.contains("Accel or "), "{error}");
    // an unknown part, and another language
    let refused = |schema: (&str, &str, &str)| {
        load(mcap_file(&path, Some(schema), plain), Some(&mapping())).unwrap_err().to_string()
    };
    let error =
        refused(("own_msgs/msg/State", "ros2msg", "own_msgs/Part part\nfloat64[] position"));
    assert!(error.contains("own_msgs/Part") && error.contains("part"), "{error}");
    let error = refused(("own_msgs/msg/State", "ros2idl", "module own_msgs {};"));
    assert!(error.contains("ros2idl") && error.contains("ros2msg"), "{error}");
    // schema 0 with messages that are of no known type
    let path = mcap_file(&path, None, |k| vec![0, 1, 0, 0, k as u8, 2, 3]);
    let error = load(&path, Some(&mapping())).unwrap_err().to_string();
    assert!(error.contains("of which type") && error.contains("no known type"), "{error}");
    // metadata.yaml says it
    mcap_file(&path, None, plain);
    let topics = "  topics_with_message_count: [{message_count: 30, topic_metadata: {name: \
                  /joint_states, type: sensor_msgs/msg/JointState}}]\n";
    let yaml = metadata("mcap", &["a_0.mcap"], topics);
    fs::write(home.path().join("metadata.yaml"), yaml).unwrap();
    has_signals(home.path(), 30);
}

#[test]
fn messages_in_version_2_of_cdr_are_read() {
    let home = TempDir::new().unwrap();
    let path = home.path().join("a.mcap");
    // frame "base": stamp 8, length and text 9, pad 3 ... see OMG DDS-XTypes 1.3, 7.4.3
    let version_2 = |k: usize| {
        let stamp = Header::new(BEGIN + k as i64 * STEP, "").stamp;
        let mut bytes = vec![0, 7, 0, 0];
        bytes.extend(stamp.sec.to_le_bytes());
        bytes.extend(stamp.nanosec.to_le_bytes());
        bytes.extend(*b"\x05\0\0\0base\0\0\0\0");
        // names: bytes of the list, count, each with its length
        bytes.extend(*b"\x1b\0\0\0\x02\0\0\0\x08\0\0\0gripper\0\x07\0\0\0x_axis\0\0");
        for values in [&[7.0, position(k)][..], &[], &[9.0, force(k)]] {
            bytes.extend((values.len() as u32).to_le_bytes());
            values.iter().for_each(|value| bytes.extend(value.to_le_bytes()));
        }
        bytes
    };
    let schema = Some(("sensor_msgs/msg/JointState", "ros2msg", ALONE));
    has_signals(&mcap_file(&path, schema, version_2), 30);
    let report = check(&path).unwrap();
    assert_eq!((report.topics[0].decoded, report.topics[0].decode_failures), (true, 0));
    let parameters = |k: usize| [&[0, 0x0b, 0, 0][..], &version_2(k)[4..]].concat();
    let error =
        load(mcap_file(&path, schema, parameters), Some(&mapping())).unwrap_err().to_string();
    assert!(error.contains("0x000b") && error.contains("mutable"), "{error}");
}

#[test]
fn a_sqlite_file_cut_anywhere_reads_what_is_there_and_recovers() {
    let home = TempDir::new().unwrap();
    let file = home.path().join("whole/a_0.db3");
    drop(Sqlite::joints(&file, 3, 0..400));
    let whole = fs::read(&file).unwrap();
    let cut = home.path().join("cut.db3");
    let mut most = 0;
    for length in (16..whole.len()).step_by(whole.len() / 40) {
        fs::write(&cut, &whole[..length]).unwrap();
        let reader = match BagReader::open(&cut) {
            Ok(reader) => reader,
            Err(error) => {
                let text = error.to_string();
                assert!(matches!(error, BagError::Broken { .. }), "{text}");
                assert!(text.contains("cut.db3") && !text.to_lowercase().contains("malformed"));
                continue;
            }
        };
        assert!(!reader.is_complete(), "cut at {length}");
        assert_eq!(reader.damage()[0].offset, length as u64);
        let read: Vec<_> = reader.messages().filter_map(Result::ok).collect();
        let out = home.path().join(format!("recovered_{length}"));
        let report = recover(&cut, Some(&out)).unwrap();
        assert_eq!(report.messages, read.len() as u64);
        most = most.max(read.len());
    }
    assert!((300..400).contains(&most), "{most} of 400 messages before the last cut");
}

#[test]
fn damage_inside_a_sqlite_file_is_a_place_and_not_the_end() {
    let home = TempDir::new().unwrap();
    let file = home.path().join("a_0.db3");
    drop(Sqlite::joints(&file, 3, 0..2000));
    let mut bytes = fs::read(&file).unwrap();
    let page = 4096;
    // messages lie in pages in the order of rows: one in the middle of the file
    let at = bytes.len() / page / 2 * page;
    bytes[at..at + page].fill(0xff);
    fs::write(&file, &bytes).unwrap();
    let reader = BagReader::open(&file).unwrap();
    let (read, errors): (Vec<_>, Vec<_>) = reader.messages().partition(Result::is_ok);
    assert!(!errors.is_empty());
    assert!((1500..2000).contains(&read.len()), "{} of 2000 messages", read.len());
    let report = check(&file).unwrap();
    assert!(!report.complete && report.messages == read.len() as u64);
    let report = recover(&file, Some(&home.path().join("whole"))).unwrap();
    assert_eq!(report.messages, read.len() as u64);
    assert!(report.damage[0].found.contains("pages"), "{report:?}");
    let error = load(&file, Some(&mapping())).unwrap_err();
    assert!(matches!(error, SignalError::Bag(BagError::Broken { .. })), "{error}");
}

#[test]
fn a_message_that_cannot_be_read_costs_itself_alone() {
    let home = TempDir::new().unwrap();
    let file = home.path().join("a_0.db3");
    // in another order than that of time; the large one lies in pages of its own
    let bag = Sqlite::joints(&file, 3, 0..0);
    for k in (0..400).map(|k| k * 7 % 400) {
        let mut data = to_cdr(&joint_state(k)).unwrap();
        if k == 200 {
            data.resize(100_000, 0xab);
        }
        bag.message(1, BEGIN + k as i64 * STEP, &data);
    }
    drop(bag);
    let mut bytes = fs::read(&file).unwrap();
    let is_full = |page: &&mut [u8]| page[100..].iter().all(|byte| *byte == 0xab);
    let page = bytes.chunks_mut(4096).find(is_full).unwrap();
    // the next page of the message is none of the file
    page[..4].copy_from_slice(&u32::MAX.to_be_bytes());
    fs::write(&file, &bytes).unwrap();
    let reader = BagReader::open(&file).unwrap();
    let (read, errors): (Vec<_>, Vec<_>) = reader.messages().partition(Result::is_ok);
    assert_eq!((read.len(), errors.len()), (399, 1));
    let times: Vec<u64> = read.into_iter().map(|message| message.unwrap().log_time).collect();
    assert!(times.is_sorted_by(|a, b| a < b), "each once, in the order of time");
}

#[test]
fn a_database_of_something_else_is_refused_with_what_is_missing() {
    let home = TempDir::new().unwrap();
    let refused = |sql: &str| {
        let file = home.path().join("other.db3");
        let _ = fs::remove_file(&file);
        Connection::open(&file).unwrap().execute_batch(sql).unwrap();
        BagReader::open(&file).unwrap_err().to_string()
    };
    let error = refused("CREATE TABLE people(name TEXT)");
    assert!(error.contains("`topics`") && error.contains("other.db3"), "{error}");
    let error = refused(
        "CREATE TABLE topics(id INTEGER, name TEXT, type TEXT);
         CREATE TABLE messages(id INTEGER, topic_id INTEGER, data BLOB)",
    );
    assert!(error.contains("`timestamp`") && error.contains("`messages`"), "{error}");
    // a view that never ends is no table
    let error = refused(
        "CREATE TABLE topics(id INTEGER, name TEXT, type TEXT);
         CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n)
         SELECT id, 1 AS topic_id, id AS timestamp, x'00' AS data FROM n",
    );
    assert!(error.contains("`messages`"), "{error}");
    let error = refused(
        "CREATE TABLE topics(id INTEGER, name TEXT, type TEXT);
         INSERT INTO topics VALUES ('one', x'00', 7);
         CREATE TABLE messages(id INTEGER, topic_id INTEGER, timestamp INTEGER, data BLOB)",
    );
    assert!(error.contains("other values"), "{error}");
}

/// `size` zero bytes under zstd, after `begin`; a few kB.
fn bomb(begin: &[u8], size: u64) -> Vec<u8> {
    let mut encoder = zstd::Encoder::new(Vec::new(), 1).unwrap();
    std::io::Write::write_all(&mut encoder, begin).unwrap();
    std::io::copy(&mut std::io::Read::take(std::io::repeat(0), size), &mut encoder).unwrap();
    encoder.finish().unwrap()
}

/// Most memory that this process has had, bytes.
fn peak_memory() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmHWM")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<u64>().unwrap() * 1024
}

#[test]
fn what_unpacks_without_end_takes_no_memory() {
    let home = TempDir::new().unwrap();
    let file = home.path().join("a_0.db3.zstd");
    // no recording inside: refused before it is unpacked
    fs::write(&file, bomb(b"", 1 << 32)).unwrap();
    let error = BagReader::open(&file).unwrap_err();
    assert!(matches!(error, BagError::UnknownFormat { .. }), "{error}");
    // a recording that goes on as zeros
    fs::write(&file, bomb(mcap::MAGIC, 1 << 33)).unwrap();
    let error = BagReader::open(&file).unwrap_err();
    assert!(matches!(error, BagError::TooLarge { .. }), "{error}");
    assert!(error.to_string().contains("zstd -d"), "{error}");
    // messages of 2 GiB each
    let database = home.path().join("b_0.db3");
    let bag = Sqlite::joints(&database, 3, 0..3);
    let packed = bomb(&[0, 1, 0, 0], 1 << 31);
    (3..6).for_each(|k| bag.message(1, BEGIN + k * STEP + 500, &packed));
    drop(bag);
    let reader = BagReader::open(&database).unwrap();
    let (read, errors): (Vec<_>, Vec<_>) = reader.messages().partition(Result::is_ok);
    assert_eq!((read.len(), errors.len()), (3, 3));
    let error = errors[0].as_ref().unwrap_err().to_string();
    assert!(
        error.contains("at most 134217728 bytes") && error.contains("/joint_states"),
        "{error}"
    );
    assert!(peak_memory() < 1 << 30, "{} bytes", peak_memory());
}

#[test]
fn a_packed_file_that_was_cut_off_reads_up_to_the_cut() {
    let home = TempDir::new().unwrap();
    let whole = fs::read(fixture("mcap_file/mcap_file.mcap.zstd")).unwrap();
    let file = home.path().join("a_0.mcap.zstd");
    for length in [5, 20, whole.len() / 2, whole.len() - 1] {
        fs::write(&file, &whole[..length]).unwrap();
        match BagReader::open(&file) {
            Ok(reader) => assert!(!reader.is_complete(), "cut at {length}"),
            Err(error) => {
                let text = error.to_string();
                assert!(text.contains("a_0.mcap.zstd") && text.contains("unpack"), "{text}");
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn flipped_bytes_never_panic(
        name in prop_oneof![
            Just("sqlite3_none/sqlite3_none.db3"),
            Just("sqlite3_message/sqlite3_message.db3"),
            Just("sqlite3_file/sqlite3_file.db3.zstd"),
            Just("mcap_message/mcap_message.mcap"),
        ],
        flips in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 1..20),
    ) {
        let home = TempDir::new().unwrap();
        let mut bytes = fs::read(fixture(name)).unwrap();
        for (at, value) in flips {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        let file = home.path().join("a_0");
        fs::write(&file, &bytes).unwrap();
        if let Ok(reader) = BagReader::open(&file) {
            prop_assert!(reader.messages().take(10_000).count() < 10_000);
            let _ = load(&file, Some(&mapping()));
        }
    }
}
