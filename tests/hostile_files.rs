//! Files that were made to do harm, or were damaged so that they do: each is reported or read, and
//! none makes a program panic, hang, take more than 1 GB, open another file, or move the terminal.

use std::collections::BTreeMap;
use std::io::Read as _;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use friction_stage_data::message::{Header, JointState, RosMessage, to_cdr};
use tempfile::TempDir;

/// Address space of a program, bytes.
const MEMORY: u64 = 1 << 30;
/// What a program may compute, s of a processor: a limit that other programs do not use up.
const PROCESSOR: u64 = 5;
/// What waits longer never ends: far above what the slowest machine needs.
const ENDLESS: Duration = Duration::from_secs(120);

struct Ended {
    code: Option<i32>,
    /// stdout and stderr.
    text: String,
}

/// Runs a program within [`MEMORY`] and [`PROCESSOR`]. It must end by itself, without a panic, and
/// print nothing that moves a terminal.
fn run(program: &str, arguments: &[&str]) -> Ended {
    let mut command = Command::new(program);
    command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    // SAFETY: only calls that may be made between fork and exec.
    unsafe {
        command.pre_exec(|| {
            let limit = libc::rlimit { rlim_cur: MEMORY, rlim_max: MEMORY };
            libc::setrlimit(libc::RLIMIT_AS, &limit);
            let limit = libc::rlimit { rlim_cur: PROCESSOR, rlim_max: PROCESSOR + 1 };
            libc::setrlimit(libc::RLIMIT_CPU, &limit);
            Ok(())
        });
    }
    let mut child = command.spawn().unwrap();
    let (mut out, mut err) = (child.stdout.take().unwrap(), child.stderr.take().unwrap());
    let errors = std::thread::spawn(move || {
        let mut text = Vec::new();
        err.read_to_end(&mut text).map(|_| text)
    });
    let output = std::thread::spawn(move || {
        let mut text = Vec::new();
        out.read_to_end(&mut text).map(|_| text)
    });
    let began = Instant::now();
    let status = loop {
        match child.try_wait().unwrap() {
            Some(status) => break status,
            None if began.elapsed() > ENDLESS => {
                child.kill().unwrap();
                panic!("{arguments:?} does not end");
            }
            None => std::thread::sleep(Duration::from_millis(5)),
        }
    };
    let bytes = [output.join().unwrap().unwrap(), errors.join().unwrap().unwrap()].concat();
    let text = String::from_utf8(bytes).expect("text");
    assert!(status.code().is_some(), "{arguments:?}: {status}\n{text}");
    assert!(!text.contains("panicked"), "{arguments:?}\n{text}");
    let moves =
        |c: char| c.is_control() && !matches!(c, '\n' | '\t') || "\u{202e}\u{2066}".contains(c);
    assert!(!text.contains(moves), "{arguments:?}: {text:?}");
    Ended { code: status.code(), text }
}

fn friction_stage(arguments: &[&str]) -> Ended {
    run(env!("CARGO_BIN_EXE_friction-stage"), arguments)
}

/// It is refused, or read with a warning, and says these words.
fn tells(ended: &Ended, words: &[&str]) {
    assert!(matches!(ended.code, Some(1..=3)), "{:?}\n{}", ended.code, ended.text);
    for word in words {
        assert!(ended.text.contains(word), "{word:?} is missing in:\n{}", ended.text);
    }
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

// --- records of MCAP, byte by byte

fn string(bytes: &[u8]) -> Vec<u8> {
    [&(bytes.len() as u32).to_le_bytes()[..], bytes].concat()
}

fn record(opcode: u8, parts: &[&[u8]]) -> Vec<u8> {
    let body = parts.concat();
    [&[opcode][..], &(body.len() as u64).to_le_bytes(), &body].concat()
}

fn schema(name: &str, definition: &str) -> Vec<u8> {
    let [name, definition] = [name, definition].map(|text| string(text.as_bytes()));
    record(3, &[&1u16.to_le_bytes(), &name, &string(b"ros2msg"), &definition])
}

fn channel(id: u16, topic: &str) -> Vec<u8> {
    let (topic, encoding) = (string(topic.as_bytes()), string(b"cdr"));
    record(4, &[&id.to_le_bytes(), &1u16.to_le_bytes(), &topic, &encoding, &0u32.to_le_bytes()])
}

fn message(time: u64, data: &[u8]) -> Vec<u8> {
    let times = [time, time].map(u64::to_le_bytes).concat();
    record(5, &[&1u16.to_le_bytes(), &0u32.to_le_bytes(), &times, data])
}

/// Log time and message of a sample.
fn sample(k: u64, position: f64, frame: &str, joint: &str) -> (u64, Vec<u8>) {
    let time = 1_000_000_000 + k * 1_000_000;
    let state = JointState {
        header: Header::new(time as i64, frame),
        name: vec![joint.to_owned()],
        position: vec![position],
        velocity: vec![0.0],
        effort: vec![1.0],
    };
    (time, to_cdr(&state).unwrap())
}

fn samples(position: impl Fn(u64) -> f64, frame: &str, joint: &str) -> Vec<u8> {
    let all = (0..400).map(|k| sample(k, position(k), frame, joint));
    all.flat_map(|(time, data)| message(time, &data)).collect()
}

/// A bag with its index, so that its signals are read.
fn whole_bag(
    home: &TempDir,
    type_name: &str,
    definition: &str,
    joint: &str,
    position: impl Fn(u64) -> f64,
) -> PathBuf {
    let path = home.path().join("whole.mcap");
    let file = std::fs::File::create(&path).unwrap();
    let mut writer = mcap::Writer::new(std::io::BufWriter::new(file)).unwrap();
    let schema = writer.add_schema(type_name, "ros2msg", definition.as_bytes()).unwrap();
    let channel = writer.add_channel(schema, "/stage/encoder", "cdr", &BTreeMap::new()).unwrap();
    for k in 0..400 {
        let (log_time, data) = sample(k, position(k), "stage", joint);
        let header = mcap::records::MessageHeader {
            channel_id: channel,
            sequence: k as u32,
            log_time,
            publish_time: log_time,
        };
        writer.write_to_known_channel(&header, &data).unwrap();
    }
    writer.finish().unwrap();
    path
}

fn plain(k: u64) -> f64 {
    1e-3 * (k as f64 * 0.05).sin()
}

fn encoder() -> Vec<u8> {
    let name = JointState::type_name();
    [schema(&name, &JointState::definition()), channel(1, "/stage/encoder")].concat()
}

fn bag(home: &TempDir, parts: &[Vec<u8>]) -> PathBuf {
    let path = home.path().join("bag.mcap");
    let header = record(1, &[&string(b"ros2"), &string(b"test")]);
    let end = [record(15, &[&[0; 4]]), record(2, &[&[0; 20]])].concat();
    let magic = mcap::MAGIC.to_vec();
    std::fs::write(&path, [magic.clone(), header, parts.concat(), end, magic].concat()).unwrap();
    path
}

/// The commands that read a bag, each of which may refuse it or warn; `check` with these words, if
/// there are any.
fn read_by_all(path: &Path, words: &[&str]) {
    let out = path.with_extension("out");
    let checked = friction_stage(&["check", text(path)]);
    if !words.is_empty() {
        tells(&checked, words);
    }
    for arguments in [
        &["check", "--json", text(path)][..],
        &["recover", text(path), "--out", text(&out)],
        &["replay", text(path), "--model", "guide_1"],
        &["replay", text(path)],
        &["view", text(path), "--out", text(&out.join("view"))],
    ] {
        friction_stage(arguments);
    }
}

/// A bag of so many chunks under zstd, each from 0 to 9 s with 50 MiB of zeros, of which the first
/// bytes do not compress.
fn bag_of_chunks(home: &TempDir, chunks: u32, incompressible: usize) -> PathBuf {
    let path = home.path().join("bag.mcap");
    let file = std::fs::File::create(&path).unwrap();
    let mut writer = mcap::WriteOptions::new()
        .compression(Some(mcap::Compression::Zstd))
        .chunk_size(None)
        .create(std::io::BufWriter::new(file))
        .unwrap();
    let schema = writer.add_schema("a/msg/B", "ros2msg", b"uint8[] data").unwrap();
    let channel = writer.add_channel(schema, "/zeros", "cdr", &BTreeMap::new()).unwrap();
    let mut state = 1u64;
    for sequence in 0..chunks {
        let mut data = vec![0; 50 << 20];
        data[..incompressible].fill_with(|| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 56) as u8
        });
        for (log_time, data) in [(0, &data[..4]), (9_000_000_000, &data[..])] {
            let channel_id = channel;
            let header =
                mcap::records::MessageHeader { channel_id, sequence, log_time, publish_time: 0 };
            writer.write_to_known_channel(&header, data).unwrap();
        }
        writer.flush().unwrap();
    }
    writer.finish().unwrap();
    path
}

#[test]
fn chunks_that_unpack_to_more_than_memory_are_damage() {
    let home = TempDir::new().unwrap();
    let path = bag_of_chunks(&home, 12, 0);
    assert!(std::fs::metadata(&path).unwrap().len() < 200_000);
    read_by_all(&path, &["chunks that unpack to at most 268435456 bytes together"]);
}

#[test]
fn chunks_that_lie_over_each_other_are_open_at_once_only_within_memory() {
    let home = TempDir::new().unwrap();
    // Enough that does not compress for all of it to be unpacked one after the other.
    let path = bag_of_chunks(&home, 12, 100_000);
    assert!(std::fs::metadata(&path).unwrap().len() > 1_000_000);
    read_by_all(&path, &["chunks whose times overlap to have at most 268435456 bytes together"]);
}

#[test]
fn lengths_beyond_what_is_left_are_damage() {
    let home = TempDir::new().unwrap();
    let beyond = 0xf509_0000u32.to_le_bytes();
    // A text and the data of an attachment, the name of a schema, the topic of a channel, pairs of
    // metadata, the compression of a chunk.
    for broken in [
        record(9, &[&[0; 16], &string(b"model.yaml"), &beyond, b"short"]),
        record(9, &[&[0; 16], &string(b"model.yaml"), &string(b""), &[0xff; 8], b"short"]),
        record(3, &[&2u16.to_le_bytes(), &beyond, b"short"]),
        record(4, &[&[2, 0, 1, 0], &beyond, b"short"]),
        record(12, &[&string(b"friction_stage"), &beyond, b"short"]),
        record(12, &[&string(b"friction_stage"), &string(&[&beyond[..], b"short"].concat())]),
        record(6, &[&[0; 28], &beyond, b"short"]),
    ] {
        let parts = [encoder(), broken, samples(plain, "stage", "stage")];
        read_by_all(&bag(&home, &parts), &["damaged", "a length beyond the"]);
    }
    // Within a message: of the frame, of the names, of a list.
    for data in [
        [&[0, 1, 0, 0][..], &[0; 8], &[0xff; 4]].concat(),
        [&[0, 1, 0, 0][..], &[0; 8], &[1, 0, 0, 0, 0, 0, 0, 0], &[0xff; 4]].concat(),
        [&[0, 9, 0, 0][..], &[0xff; 8]].concat(),
    ] {
        let parts = [encoder(), message(1, &data), samples(plain, "stage", "stage")];
        read_by_all(&bag(&home, &parts), &["do not decode"]);
    }
}

#[test]
fn definitions_without_an_end_are_told() {
    let home = TempDir::new().unwrap();
    let mapping = home.path().join("mapping.yaml");
    let field = "signals:\n  position: {topic: /stage/encoder, field: 'position[0]'}\n";
    std::fs::write(&mapping, field).unwrap();
    let between = "=".repeat(80);
    let part = |name: &str, fields: &str| format!("{between}\nMSG: own/{name}\n{fields}\n");
    let position = "float64[] position\n";
    let in_chain = |length: usize, many: &str| -> String {
        (0..length).map(|k| part(&format!("A{k}"), &format!("A{}{many} a", k + 1))).collect()
    };
    for (definition, words) in [
        (format!("A0 a\n{position}{}", in_chain(100_000, "")), "read are at most"),
        (
            format!("A0 a\n{position}{}{}", in_chain(100, ""), part("A100", "uint8 x")),
            "types inside each other",
        ),
        (format!("E[1000000000000] e\n{position}{}", part("E", "uint8[0] x")), "is no array type"),
        (
            format!("A0 a\n{position}{}{}", in_chain(20, "[1000000]"), part("A20", "uint8 x")),
            "more were expected at byte",
        ),
        (format!("Type inside\n{position}"), "contains itself"),
        (format!("uint8[99999999999999999999999] x\n{position}"), "is no array type"),
    ] {
        read_by_all(&whole_bag(&home, &JointState::type_name(), &definition, "stage", plain), &[]);
        let path = whole_bag(&home, "own/msg/Type", &definition, "stage", plain);
        let checked = friction_stage(&["check", text(&path), "--mapping", text(&mapping)]);
        tells(&checked, &[words]);
        read_by_all(&path, &[]);
    }
}

#[test]
fn many_channels_with_one_long_definition_are_refused() {
    let home = TempDir::new().unwrap();
    let long = format!("uint8 x\n#{}\n", "x".repeat(500_000));
    let channels = (1..4000).map(|id| channel(id, &format!("/topic_{id}")));
    let parts: Vec<_> = [schema("a/msg/B", &long)].into_iter().chain(channels).collect();
    read_by_all(&bag(&home, &parts), &["definitions of its 3999 topics"]);
}

#[test]
fn very_many_damaged_places_are_told_up_to_a_number() {
    let home = TempDir::new().unwrap();
    let broken = record(3, &[&[1]]);
    let path = bag(&home, &[encoder(), broken.repeat(50_000)]);
    let ended = friction_stage(&["check", text(&path)]);
    tells(&ended, &["1000 damaged places before it"]);
    assert!(ended.text.lines().count() < 1100);
    read_by_all(&path, &[]);
}

#[test]
fn a_model_in_a_bag_opens_no_file() {
    let home = TempDir::new().unwrap();
    let pipe = home.path().join("pipe");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let secret = home.path().join("secret.yaml");
    std::fs::write(&secret, "the answer is 42\n").unwrap();
    for file in [Path::new("/dev/zero"), &pipe, &secret] {
        let pairs = [string(b"seed"), string(b"1")].concat();
        let metadata = record(12, &[&string(b"friction_stage"), &string(&pairs)]);
        let model = format!("catalogue: {}\n", file.display());
        let attachment = record(
            9,
            &[
                &[0; 16],
                &string(b"model.yaml"),
                &string(b"application/yaml"),
                &(model.len() as u64).to_le_bytes(),
                model.as_bytes(),
                &[0; 4],
            ],
        );
        let parts = [metadata, attachment, encoder(), samples(plain, "stage", "stage")];
        let path = bag(&home, &parts);
        read_by_all(&path, &["only a model file may"]);
        let ended = friction_stage(&["replay", text(&path)]);
        tells(&ended, &["only a model file may"]);
        assert!(!ended.text.contains("42"), "{}", ended.text);
    }
}

#[test]
fn a_bag_opens_nothing_outside_its_directory() {
    let home = TempDir::new().unwrap();
    let outside = bag(&home, &[encoder(), samples(plain, "stage", "stage")]);
    let metadata = |name: &str| {
        format!(
            "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  \
             relative_file_paths: [{name:?}]\n"
        )
    };
    let directory = home.path().join("directory");
    for (name, words) in [
        ("../bag.mcap", "a bag's files lie in its own directory"),
        ("/etc/hostname", "a bag's files lie in its own directory"),
        ("/dev/zero", "a bag's files lie in its own directory"),
        ("directory_0.mcap", "is a link to"),
    ] {
        std::fs::create_dir(&directory).unwrap();
        std::fs::write(directory.join("metadata.yaml"), metadata(name)).unwrap();
        std::os::unix::fs::symlink(&outside, directory.join("directory_0.mcap")).unwrap();
        read_by_all(&directory, &[words]);
        std::fs::remove_dir_all(&directory).unwrap();
    }
    // Neither does one that only lies there.
    std::fs::create_dir(&directory).unwrap();
    std::os::unix::fs::symlink(&outside, directory.join("directory_0.mcap")).unwrap();
    read_by_all(&directory, &["is a link to"]);
}

#[test]
fn texts_of_files_do_nothing_to_a_terminal() {
    let home = TempDir::new().unwrap();
    let evil = "\u{1b}]0;owned\u{7}\u{1b}[31mred\u{9b}1m\u{202e}<script>";
    let topic = format!("/{evil}\nwarning: forged");
    let parts = [
        encoder(),
        record(
            3,
            &[
                &2u16.to_le_bytes(),
                &string(format!("evil/msg/{evil}").as_bytes()),
                &string(b"ros2msg"),
                &string(evil.as_bytes()),
            ],
        ),
        record(4, &[&[2, 0, 2, 0], &string(topic.as_bytes()), &string(b"cdr"), &[0; 4]]),
        samples(plain, evil, evil),
    ];
    let path = bag(&home, &parts);
    let ended = friction_stage(&["check", text(&path)]);
    tells(&ended, &["\\u001b", "\\u009b", "\\u202e"]);
    assert!(!ended.text.lines().any(|line| line.starts_with("warning: forged")), "{}", ended.text);
    read_by_all(&path, &["\\u001b"]);
    // JSON says the same, and is JSON.
    let json = friction_stage(&["check", "--json", text(&path)]).text;
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert!(json["topics"][1]["name"].as_str().unwrap().contains(evil));

    let table = home.path().join("table.csv");
    let rows: String = (0..50).map(|k| format!("0.{k:03},{k}\n")).collect();
    std::fs::write(&table, format!("time,{evil}\n{rows}")).unwrap();
    tells(&friction_stage(&["check", text(&table)]), &["<script>"]);
    let mapping = home.path().join("table.mapping.yaml");
    friction_stage(&["import", text(&table), "--write", text(&mapping)]);
    for yaml in [
        format!("{evil:?}: 1\n"),
        "\"\\e[31mkey\": 1\n".to_owned(),
        "guides: [\"\\e[31mguide\\x9b1m\"]\n".to_owned(),
        "effects:\n- \"\\e[31m\": {a: 1}\n".to_owned(),
        "signals:\n  \"\\e[31m\": {column: 1}\n".to_owned(),
    ] {
        let path = home.path().join("text.yaml");
        std::fs::write(&path, yaml).unwrap();
        friction_stage(&["model", text(&path)]);
        friction_stage(&["check", text(&table), "--mapping", text(&path)]);
        friction_stage(&["guides", "--catalogue", text(&path)]);
    }
}

#[test]
fn texts_of_files_are_no_markup_on_pages_and_in_figures() {
    let home = TempDir::new().unwrap();
    let evil = "</script><script>alert(1)</script><img src=x onerror=alert(2)>&\"'";
    let path = whole_bag(&home, &JointState::type_name(), &JointState::definition(), evil, plain);
    // A file has no `/` in its name.
    let table = home.path().join("<img src=x onerror=alert(3)>.csv");
    // There and back at two speeds.
    let (mut position, mut rows) = (0.0, String::new());
    for k in 0..8000 {
        let velocity = [0.01, -0.01, 0.02, -0.02][k / 2000];
        position += 1e-3 * velocity;
        let force = 5.0 * f64::signum(velocity) + 0.01 * (k % 3) as f64;
        rows += &format!("{},{position},{force}\n", 1e-3 * k as f64);
    }
    std::fs::write(&table, format!("time,position,force\n{rows}")).unwrap();
    let at = |name: &str| home.path().join(name);
    let page = at("page.html");
    let viewed = friction_stage(&["view", text(&path), text(&table), "--out", text(&page)]);
    assert_eq!(viewed.code, Some(0), "{}", viewed.text);
    let figure = at("<img src=x onerror=alert(4)>.svg");
    let curve = ["friction-curve", text(&table), "--figure", text(&figure)];
    let drawn = friction_stage(&curve);
    assert!(matches!(drawn.code, Some(0 | 3)), "{}", drawn.text);
    for written in [page, figure] {
        let text = std::fs::read_to_string(&written).unwrap();
        assert!(!text.contains("<img src") && !text.contains("<script>alert"));
        assert!(text.contains("alert(3)"), "{} does not name its file", written.display());
    }
}

/// Commands that read a text which a person wrote.
fn readers(path: &Path, table: &Path) -> Vec<Ended> {
    let out = path.with_extension("out");
    let node = |program: &str| {
        run(program, &["--ros-args", "--params-file", text(path), "-p", "no_such_parameter:=1"])
    };
    vec![
        friction_stage(&["model", text(path)]),
        friction_stage(&["check", text(table), "--mapping", text(path)]),
        friction_stage(&["guides", "--catalogue", text(path)]),
        friction_stage(&["select", "--application", text(path), "--out", text(&out)]),
        friction_stage(&["play", text(path), "--record", text(&out)]),
        node(env!("CARGO_BIN_EXE_stage_node")),
        node(env!("CARGO_BIN_EXE_controller_node")),
    ]
}

#[test]
fn texts_that_are_no_files_or_grow_without_end_are_refused() {
    let home = TempDir::new().unwrap();
    let table = home.path().join("table.csv");
    let rows: String = (0..50).map(|k| format!("0.{k:03},{k}\n")).collect();
    std::fs::write(&table, format!("time,position\n{rows}")).unwrap();
    let path = home.path().join("text.yaml");
    let pipe = home.path().join("pipe");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    for (target, words) in [
        (Path::new("/dev/zero"), "must be a regular file"),
        (&pipe, "must be a regular file"),
        (home.path(), "it is a directory"),
    ] {
        std::os::unix::fs::symlink(target, &path).unwrap();
        for ended in readers(&path, &table) {
            tells(&ended, &[words]);
        }
        std::fs::remove_file(&path).unwrap();
    }
    std::fs::File::create(&path).unwrap().set_len(1 << 33).unwrap();
    for ended in readers(&path, &table) {
        tells(&ended, &["more than 16777216 bytes"]);
    }
    let doubled = |k: usize| match k {
        0 => "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n".to_owned(),
        k => format!("a{k}: &a{k} [{}]\n", vec![format!("*a{}", k - 1); 10].join(", ")),
    };
    for yaml in [
        (0..12).map(doubled).collect::<String>(),
        format!("mass: {}", "[".repeat(200_000)),
        "{a: ".repeat(200_000),
        "- ".repeat(100_000),
        (0..2000).map(|k| format!("{}a:\n", " ".repeat(k))).collect(),
        (0..300_000).map(|k| format!("key_{k}: 1\n")).collect(),
        "---\n".repeat(300_000),
    ] {
        std::fs::write(&path, yaml).unwrap();
        for ended in readers(&path, &table) {
            tells(&ended, &["text.yaml"]);
        }
    }
}

#[test]
fn values_that_no_unit_can_mean_are_refused_with_their_place() {
    let home = TempDir::new().unwrap();
    let (table, mapping) = (home.path().join("table.csv"), home.path().join("mapping.yaml"));
    let signals = "signals:\n  time: {column: 1}\n  position: {column: 2}\n  force: {column: 3}\n";
    std::fs::write(&mapping, signals).unwrap();
    for value in ["1e308", "-1e200", "1e13"] {
        for (column, words) in [(1, "position"), (2, "force")] {
            let rows: String = (0..500)
                .map(|k| {
                    let mut cells = [format!("0.{k:04}"), format!("{k}e-6"), format!("{}", k % 7)];
                    if k == 250 {
                        cells[column] = value.to_owned();
                    }
                    cells.join(",") + "\n"
                })
                .collect();
            std::fs::write(&table, format!("t,x,f\n{rows}")).unwrap();
            let place = format!("line 252: column {}: {words}", column + 1);
            let table = text(&table);
            tells(&friction_stage(&["check", table, "--mapping", text(&mapping)]), &[&place]);
            let out = home.path().join(format!("{value}_{column}"));
            let import = ["import", table, "--mapping", text(&mapping), "--out", text(&out)];
            tells(&friction_stage(&import), &[&place]);
        }
    }
    let impossible = |k| if k == 250 { 1e308 } else { plain(k) };
    let (name, definition) = (JointState::type_name(), JointState::definition());
    let path = whole_bag(&home, &name, &definition, "stage", impossible);
    let words = ["message at 1250000000 ns", "1e308"];
    tells(&friction_stage(&["check", text(&path), "--model", "guide_1"]), &words);
    read_by_all(&path, &[]);
}
