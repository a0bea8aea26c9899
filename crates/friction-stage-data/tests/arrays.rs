//! Files of arrays as recordings: `.mat` of every version, `.npz` and `.npy`.
//!
//! The files in `fixtures` were written by SciPy, h5py and NumPy (`make_arrays.py`).

use std::collections::BTreeMap;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use friction_stage_data::bag::BagReader;
use friction_stage_data::quality::RecordingCheck;
use friction_stage_data::signals::{
    Mapping, Proposal, Recording, SignalError, Window, import, load,
};
use proptest::prelude::*;
use tempfile::TempDir;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(name)
}

fn read(path: &Path, signals: &str) -> Result<Recording, SignalError> {
    load(path, Some(&Mapping::from_yaml(&format!("signals: {{{signals}}}"), "m.yaml").unwrap()))
}

fn position_mm(k: usize) -> f64 {
    let from_middle = k as f64 % 80.0 - 40.0;
    from_middle * from_middle / 4096.0
}

fn force(k: usize) -> f64 {
    k as f64 % 7.0 - 3.0
}

/// 200 rows at 1 kHz of position and force; the position to `error`, relative.
#[track_caller]
fn is_the_run(recording: &Recording, error: f64) {
    let trace = &recording.trace;
    assert_eq!((trace.len(), recording.rate.round()), (200, 1000.0));
    for k in 0..200 {
        let position = 1e-3 * position_mm(k);
        let difference = (trace.position[k] - position).abs();
        assert!(difference <= error * position, "row {k}: {} {position}", trace.position[k]);
        assert_eq!(trace.force[k], force(k), "row {k}");
    }
}

#[test]
fn arrays_of_every_kind_of_file_are_columns() {
    let plain = "time: {column: t}, position: {column: pos_mm, unit: mm}, force: {column: force}";
    let table = |row: &str| {
        let column = |k: usize| row.replace('k', &k.to_string());
        format!(
            "time: {{column: '{}'}}, position: {{column: '{}', unit: mm}}, force: {{column: '{}'}}",
            column(1),
            column(2),
            column(3)
        )
    };
    let cases: &[(&str, String)] = &[
        ("v6.mat", plain.into()),
        ("v7.mat", plain.into()),
        ("plain.npz", plain.into()),
        ("structs.mat", table("table(:,k)")),
        ("v73.mat", table("table(:,k)")),
        ("classes.mat", table("wide(k,:)")),
        (
            "structs.mat",
            "time: {column: run.t}, position: {column: run.pos_mm, unit: mm}, force: {column: \
             run.force}"
                .into(),
        ),
        (
            "v73.mat",
            "time: {column: t}, position: {column: pos_mm, unit: mm}, force: {column: run.force}"
                .into(),
        ),
        (
            "packed.npz",
            "time: {column: stamp_ns, unit: ns}, position: {column: 'data[:,0]', unit: mm}, \
             force: {column: 'data[:,1]'}"
                .into(),
        ),
        // both ways to count, in files of either
        (
            "packed.npz",
            "time: {column: stamp_ns, unit: ns}, position: {column: 'data(:,1)', unit: mm}, \
             force: {column: 'data(:, 2)'}"
                .into(),
        ),
        (
            "table.npy",
            "time: {column: '[:,0]'}, position: {column: '[:,1]', unit: mm}, force: {column: \
             '[:,2]'}"
                .into(),
        ),
        (
            "records.npy",
            "time: {column: t}, position: {column: x, unit: mm}, force: {column: force}".into(),
        ),
        (
            "times.npz",
            "time: {column: time}, position: {column: position}, force: {column: force}".into(),
        ),
    ];
    for (name, signals) in cases {
        let recording = read(&fixture(name), signals).unwrap();
        // two of them have the position as a float of 32 bits
        let error = if ["times.npz", "records.npy"].contains(name) { 1e-7 } else { 1e-15 };
        is_the_run(&recording, error);
        if name == &"packed.npz" || name == &"times.npz" {
            assert_eq!(recording.trace.origin_ns, 1_700_000_000_000_000_000, "to the nanosecond");
        }
    }
}

#[test]
fn names_of_our_own_columns_need_no_mapping() {
    is_the_run(&load(fixture("times.npz"), None).unwrap(), 1e-7);
    let check =
        RecordingCheck::new(&fixture("times.npz"), None, Window::default(), None, &mut |_| {})
            .unwrap();
    assert_eq!(check.data.unwrap().rows, 200);
}

#[test]
fn numbers_of_every_class_are_read() {
    for class in
        "int8 uint8 int16 uint16 int32 uint32 int64 uint64 float32 float64".split_whitespace()
    {
        let signals = format!("time: {{column: t}}, position: {{column: c_{class}}}");
        let recording = read(&fixture("classes.mat"), &signals).unwrap();
        let expected: Vec<f64> = (0..200).map(|k| f64::from(k % 100)).collect();
        assert_eq!(recording.trace.position, expected, "{class}");
    }
}

#[test]
fn a_mapping_is_proposed_and_the_rest_is_named() {
    let home = TempDir::new().unwrap();
    for (name, error, not_used) in [
        ("v7.mat", 1e-15, &["note (text)", "gains(:,1) (3 values)"][..]),
        ("v73.mat", 1e-15, &["note (text)"]),
        ("plain.npz", 1e-15, &["label (text)", "gains[:,0] (3 values)"]),
        ("structs.mat", 1e-15, &["cells (a cell array)", "z (complex numbers)"]),
        ("times.npz", 1e-7, &[]),
    ] {
        let proposal = Proposal::of(&fixture(name)).unwrap();
        assert_eq!(proposal.rate_hz.map(f64::round), Some(1000.0), "{name}");
        for words in not_used {
            assert!(proposal.not_used.iter().any(|other| other == words), "{name} {proposal:?}");
        }
        let yaml = proposal.to_yaml(name, &[]);
        assert!(!yaml.contains("csv:"), "{yaml}");
        let mapping = Mapping::from_yaml(&yaml, "m.yaml").unwrap();
        is_the_run(&load(fixture(name), Some(&mapping)).unwrap(), error);
        let bag = home.path().join(name);
        let report = import(&fixture(name), &mapping, &BTreeMap::new(), &bag, &mut |_| {}).unwrap();
        assert_eq!(report.rows, 200);
        is_the_run(&load(&bag, None).unwrap(), error);
        assert_eq!(BagReader::open(&bag).unwrap().message_count(), 400);
    }
}

#[test]
fn a_mapping_that_does_not_fit_is_refused_with_what_is_there() {
    let error = |name: &str, signals: &str| read(&fixture(name), signals).unwrap_err().to_string();
    let text = error("v7.mat", "time: {column: t}, position: {column: pos_m}");
    assert!(text.contains("pos_mm (200)") && text.contains("did you mean"), "{text}");
    let text = error("v7.mat", "time: {column: t}, position: {column: 'gains(:,1)'}");
    assert!(text.contains("t has 200") && text.contains("gains(:,1) has 3"), "{text}");
    let text = error("v7.mat", "time: {column: t}, position: {column: 2}");
    assert!(text.contains("have names"), "{text}");
    let text = error("v7.mat", "position: {column: pos_mm}");
    assert!(text.contains("time") && text.contains("rate"), "{text}");
    let text = error("times.npz", "time: {column: time}, position: {column: time}");
    assert!(text.contains("holds times"), "{text}");
    let text = error("v7.mat", "position: {topic: /a, field: b}");
    assert!(text.contains("a table") && text.contains("topics"), "{text}");
}

#[test]
fn other_files_and_versions_are_refused_with_what_would_do() {
    let home = TempDir::new().unwrap();
    let file = home.path().join("a.mat");
    let refused = |bytes: &[u8]| {
        fs::write(&file, bytes).unwrap();
        let error = Proposal::of(&file).unwrap_err().to_string();
        assert!(error.contains("a.mat"), "{error}");
        error
    };
    // MATLAB 4 has no header: type, rows, columns, imaginary, length of the name
    let version_4 = [0i32, 2, 1, 0, 2].map(i32::to_le_bytes).concat();
    assert!(refused(&version_4).contains("save -v7"));
    assert!(refused(b"").contains("save -v7"));
    let mut empty = fs::read(fixture("v6.mat")).unwrap();
    empty.truncate(128);
    assert!(refused(&empty).contains("no arrays"));
    assert!(refused(b"\x89HDF\r\n\x1a\n and nothing").contains("save -v7"));
    assert!(refused(b"PK\x03\x04 and nothing").contains("archive"));
    assert!(refused(b"\x93NUMPY\x01\x00\xff\xff{").contains("header"));
}

/// A header of NumPy, version 1.
fn npy(header: &str) -> Vec<u8> {
    let length = u16::try_from(header.len()).unwrap().to_le_bytes();
    [b"\x93NUMPY\x01\x00", &length[..], header.as_bytes()].concat()
}

#[test]
fn lengths_that_are_not_there_are_errors() {
    let home = TempDir::new().unwrap();
    let refused = |name: &str, bytes: &[u8], column: &str| {
        let file = home.path().join(name);
        fs::write(&file, bytes).unwrap();
        let mapping = format!("rate: 1\nsignals: {{position: {{column: '{column}'}}}}");
        let mapping = Mapping::from_yaml(&mapping, "m.yaml").unwrap();
        load(&file, Some(&mapping)).unwrap_err().to_string()
    };
    let shape = |shape: &str| {
        npy(&format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({shape}), }}\n"))
    };
    let error = refused("a.npy", &shape("1000000000000,"), "values");
    assert!(error.contains("1000000000000"), "{error}");
    let error = refused("a.npy", &shape("30000000,"), "values");
    assert!(error.contains("ends before"), "{error}");
    let error = refused("a.npy", &shape("18446744073709551615, 18446744073709551615"), "[:,0]");
    assert!(error.contains("no column"), "{error}");
    refused("a.npy", &shape("99999999999999999999999,"), "values");
    // MATLAB 5: dimensions, and the length of an element
    let whole = fs::read(fixture("v6.mat")).unwrap();
    let mut longer = whole.clone();
    longer[132..136].copy_from_slice(&u32::MAX.to_le_bytes());
    let error = refused("a.mat", &longer, "pos_mm");
    assert!(error.contains("byte 128") && error.contains("4294967295"), "{error}");
    let at = whole.windows(4).position(|bytes| bytes == 200i32.to_le_bytes()).unwrap();
    let mut wider = whole.clone();
    wider[at..at + 4].copy_from_slice(&(1i32 << 25).to_le_bytes());
    let error = refused("a.mat", &wider, "t");
    assert!(error.contains("declared"), "{error}");
    for length in (0..whole.len()).step_by(97) {
        refused("cut.mat", &whole[..length], "force");
    }
}

#[test]
fn what_unpacks_without_end_takes_no_memory() {
    let home = TempDir::new().unwrap();
    // 100 GB of zeros are declared, 2 GB are there
    let file = home.path().join("a.npz");
    let mut archive = zip::ZipWriter::new(fs::File::create(&file).unwrap());
    let options = zip::write::SimpleFileOptions::default()
        .compression_method(zip::CompressionMethod::Deflated);
    archive.start_file("x.npy", options).unwrap();
    let header = "{'descr': '<f8', 'fortran_order': False, 'shape': (12500000000,), }\n";
    archive.write_all(&npy(header)).unwrap();
    let zeros = vec![0; 1 << 20];
    (0..2048).for_each(|_| archive.write_all(&zeros).unwrap());
    archive.finish().unwrap();
    let error = load(
        &file,
        Some(&Mapping::from_yaml("rate: 1\nsignals: {position: {column: x}}", "m").unwrap()),
    );
    let error = error.unwrap_err().to_string();
    assert!(error.contains("12500000000") && error.contains("CSV"), "{error}");
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let peak = status.lines().find(|line| line.starts_with("VmHWM")).unwrap();
    let peak: u64 = peak.split_whitespace().nth(1).unwrap().parse().unwrap();
    assert!(peak < 1 << 20, "{peak} kB");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]
    #[test]
    fn flipped_bytes_never_panic(
        name in prop_oneof![
            Just("v6.mat"), Just("v7.mat"), Just("structs.mat"), Just("v73.mat"),
            Just("plain.npz"), Just("packed.npz"), Just("table.npy"), Just("records.npy"),
        ],
        flips in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 1..12),
        at_begin in any::<bool>(),
    ) {
        let home = TempDir::new().unwrap();
        let mut bytes = fs::read(fixture(name)).unwrap();
        let most = if at_begin { 700.min(bytes.len()) } else { bytes.len() };
        for (at, value) in flips {
            bytes[at.index(most)] = value;
        }
        let file = home.path().join(name);
        fs::write(&file, &bytes).unwrap();
        if let Ok(proposal) = Proposal::of(&file)
            && let Ok(mapping) = Mapping::from_yaml(&proposal.to_yaml(name, &[]), "m.yaml")
        {
            let _ = load(&file, Some(&mapping));
        }
        let _ = read(&file, "time: {column: t}, position: {column: pos_mm}");
    }
}

#[test]
fn objects_of_matlab_are_called_so_and_what_they_refer_to_is_not_listed() {
    let reported = Proposal::of(&fixture("objects.mat")).unwrap_err().to_string();
    for name in ["runs", "label"] {
        let said = format!("{name} (an object: save its columns as arrays, or in a struct)");
        assert!(reported.contains(&said), "{reported}");
    }
    assert!(!reported.contains("MCOS") && !reported.contains("refs"), "{reported}");
    let mapping = "rate: 1000\nsignals: {position: {column: runs}}";
    let mapping = Mapping::from_yaml(mapping, "m.yaml").unwrap();
    let reported = load(fixture("objects.mat"), Some(&mapping)).unwrap_err().to_string();
    assert!(reported.contains("an object"), "{reported}");
}
