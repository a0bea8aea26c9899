//! Text tables as loggers, drives and spreadsheets write them: the same numbers come out whatever
//! the dialect.

use std::collections::BTreeMap;
use std::path::PathBuf;

use friction_stage_core::model::JointType;
use friction_stage_data::signals::{
    Mapping, Proposal, Recording, Signal, SignalError, SignalNote, Window, import, import_captures,
    load, load_part,
};
use proptest::prelude::*;

const ROWS: usize = 200;
const RATE: f64 = 1000.0;
const MAPPING: &str = "signals: {time: {column: t}, position: {column: x}, force: {column: u}}";

/// Position, m, and force, N, of row `k`; to 10 nm and 1 uN.
fn values(k: usize) -> (f64, f64) {
    let phase = 12.0 * k as f64 / RATE;
    (((0.05 * phase.sin()) * 1e8).round() / 1e8, ((20.0 * phase.cos()) * 1e6).round() / 1e6)
}

/// Rows of time, position and force with these marks; times in s.
fn rows(delimiter: &str, decimal: char, end: &str) -> String {
    (0..ROWS)
        .map(|k| {
            let (x, u) = values(k);
            let row = format!("{:.3}{delimiter}{x:.8}{delimiter}{u:.6}{end}", k as f64 / RATE);
            row.replace('.', &decimal.to_string())
        })
        .collect()
}

struct File {
    _directory: tempfile::TempDir,
    path: PathBuf,
}

fn file(name: &str, bytes: impl AsRef<[u8]>) -> File {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    File { _directory: directory, path }
}

fn read(name: &str, bytes: impl AsRef<[u8]>, mapping: &str) -> Result<Recording, SignalError> {
    let mapping = Mapping::from_yaml(mapping, "mapping.yaml").unwrap();
    load(&file(name, bytes).path, Some(&mapping))
}

/// Reads what must come out as the numbers of [`values`]; `rows` of them.
fn assert_read(name: &str, bytes: impl AsRef<[u8]>, mapping: &str, rows: usize) -> Recording {
    let recording = read(name, bytes, mapping).unwrap();
    assert_eq!(recording.trace.len(), rows);
    assert!((recording.rate - RATE).abs() < 1e-3, "{} Hz", recording.rate);
    for k in 0..rows {
        let (x, u) = values(k);
        assert!((recording.trace.position[k] - x).abs() < 1e-12, "row {k}");
        assert!((recording.trace.force[k] - u).abs() < 1e-9, "row {k}");
    }
    recording
}

fn error(bytes: impl AsRef<[u8]>, mapping: &str) -> String {
    match read("table.csv", bytes, mapping) {
        Ok(recording) => panic!("{} rows were read", recording.trace.len()),
        Err(error) => error.to_string(),
    }
}

#[test]
fn lines_above_the_names_and_units_below_are_found() {
    let rows = rows(",", '.', "\n");
    for above in [
        "t,x,u\n",
        "Date:,2020-07-08\nSampling period:,1.000\nt,x,u\n",
        "Trace 1\nDevice,ABC,rev 3,x\n\nt,x,u\n",
        "t,x,u\ns,m,N\n",
        "t,x,u\n[s],[m],[N]\n",
        "Scale:,0,True,100.0,0.5,-400.5\nScale:,1,True,20.0,-2.6,-77.3\n\nt,x,u\ns,m,N\n",
        "# written by a logger\n# t,x,u\n",
        "# 12 rows a page\nt,x,u\n",
        "\u{feff}t,x,u\n",
        "t,x,u,\n",
        "t , x , u \n",
        "\"t\",\"x\",\"u\"\n",
    ] {
        assert_read("table.csv", format!("{above}{rows}"), MAPPING, ROWS);
    }
    // Sixty lines of settings in the same number of columns as the table.
    let settings: String = (0..60).map(|k| format!("setting {k},value,a\n")).collect();
    assert_read("table.csv", format!("{settings}t,x,u\n{rows}"), MAPPING, ROWS);
    // A mapping may say it.
    let said = format!("csv: {{names_in_line: 2, data_from_line: 4}}\n{MAPPING}");
    assert_read("table.csv", format!("1,2,3\nt,x,u\n9,9,9\n{rows}"), &said, ROWS);
}

#[test]
fn delimiters_and_endings_are_found() {
    for (delimiter, decimal) in [
        (",", '.'),
        (";", '.'),
        (";", ','),
        ("\t", '.'),
        ("\t", ','),
        (" ", '.'),
        ("   ", '.'),
        ("|", '.'),
    ] {
        for end in ["\n", "\r\n", "\r"] {
            for name in ["table.csv", "table.txt", "table.dat", "table.LOG", "table"] {
                let text = ["t", "x", "u"].join(delimiter) + end + &rows(delimiter, decimal, end);
                assert_read(name, text, MAPPING, ROWS);
            }
        }
    }
    let aligned: String = (0..ROWS)
        .map(|k| format!("  {:8.3} {:14.8}  {:12.6}\n", k as f64 / RATE, values(k).0, values(k).1))
        .collect();
    assert_read("table.dat", format!("   t        x       u\n{aligned}"), MAPPING, ROWS);
    assert_read("table.csv", format!("sep=;\nt;x;u\n{}", rows(";", '.', "\n")), MAPPING, ROWS);
}

#[test]
fn a_delimiter_at_the_end_of_rows_is_no_column() {
    assert_read("t.csv", format!("t,x,u\n{}", rows(",", '.', ",\n")), MAPPING, ROWS);
    assert_read("t.csv", format!("t,x,u,\n{}", rows(",", '.', ",\n")), MAPPING, ROWS);
}

#[test]
fn names_that_wrap_in_their_quotes_are_names() {
    let comma = format!("\"t\n(s)\",\"x \r\n[m]\",\"u\n\n(N)\"\n{}", rows(",", '.', "\n"));
    let semicolon = format!("\"t\r(s)\";\"x;\r[m]\";u (N)\r{}", rows(";", ',', "\r"));
    for (text, x, line) in [(comma, "x [m]", 6), (semicolon, "x; [m]", 4)] {
        let (proposal, recording) = proposed("wrapped.csv", &text);
        // Lines as an editor counts them.
        assert_eq!((proposal.data_line, proposal.names_line), (line, Some(1)));
        let from = format!("{{names_in_line: 1, data_from_line: {}}}", line + 2);
        let asked = format!("csv: {from}\n{}", proposal.to_yaml("", &[]));
        let later = read("wrapped.csv", &text, &asked).unwrap();
        assert_eq!(later.trace.position[0], recording.trace.position[2]);
        let yaml = proposal.to_yaml("wrapped.csv", &[]);
        assert!(yaml.contains(x), "{yaml}");
        assert_eq!(recording.trace.len(), ROWS);
        assert!((recording.trace.position[7] - values(7).0).abs() < 1e-12);
    }
}

#[test]
fn thousands_are_read_or_refused_and_never_a_factor_of_1000() {
    let counts = |mark: &str| -> String {
        let rows: String = (0..ROWS)
            .map(|k| {
                // Counts of 10 nm.
                let counts = (values(k).0 * 1e8).round() as i64;
                let digits = counts.abs().to_string();
                let grouped = digits
                    .as_bytes()
                    .rchunks(3)
                    .rev()
                    .map(|group| std::str::from_utf8(group).unwrap())
                    .collect::<Vec<_>>()
                    .join(mark);
                let sign = if counts < 0 { "-" } else { "" };
                let force = format!("{:.6}", values(k).1).replace('.', ",");
                format!(
                    "{};{sign}{grouped};{force}\n",
                    format!("{:.3}", k as f64 / RATE).replace('.', ",")
                )
            })
            .collect();
        format!("t;x;u\n{rows}")
    };
    let scaled = MAPPING.replace("{column: x}", "{column: x, scale: 1.0e-8}");
    for mark in [".", " ", "'", "\u{a0}", "\u{202f}"] {
        for said in ["", "csv: {delimiter: \";\", decimal_comma: true}\n"] {
            assert_read("t.csv", counts(mark), &format!("{said}{scaled}"), ROWS);
        }
    }
    let said = format!("csv: {{decimal_comma: true}}\n{MAPPING}");
    let message = error("t;x;u\n0,001;0.5;1\n0,002;0.25;1\n0,003;0,5;1\n", &said);
    assert!(message.contains("\"0.5\"") && message.contains("decimal comma"), "{message}");
    // Nothing says whether 1,250 is 1.25 or 1250.
    let either: String = (1..50).map(|k| format!("{k};{k},250;{k}\n")).collect();
    let message = error(format!("t;x;u\n{either}"), MAPPING);
    assert!(message.contains("decimal_comma"), "{message}");
    let said = format!("csv: {{decimal_comma: true}}\n{MAPPING}");
    let recording = read("t.csv", format!("t;x;u\n{either}"), &said).unwrap();
    assert_eq!(recording.trace.position[1], 2.25);
}

#[test]
fn other_encodings_are_read() {
    let text = format!("t,x µm,u\n{}", rows(",", '.', "\r\n"));
    let mapping = "signals: {time: {column: 1}, position: {column: 2}, force: {column: 3}}";
    let latin: Vec<u8> = text.chars().map(|c| u8::try_from(u32::from(c)).unwrap()).collect();
    assert_read("latin1.csv", &latin, mapping, ROWS);
    assert_read("latin1.csv", &latin, &MAPPING.replace("column: x", "column: x µm"), ROWS);
    let units = |swap: bool| -> Vec<u8> {
        text.encode_utf16()
            .flat_map(|unit| if swap { unit.to_be_bytes() } else { unit.to_le_bytes() })
            .collect()
    };
    for swap in [false, true] {
        let mark = if swap { [0xfe, 0xff] } else { [0xff, 0xfe] };
        assert_read("utf16.csv", [&mark[..], &units(swap)].concat(), mapping, ROWS);
        assert_read("utf16.csv", units(swap), mapping, ROWS);
    }
}

#[test]
fn times_of_every_kind_are_read() {
    let with_times = |time: &dyn Fn(usize) -> String| -> String {
        let row = |k: usize| format!("{};{:.8};{:.6}\n", time(k), values(k).0, values(k).1);
        format!("t;x;u\n{}", (0..ROWS).map(row).collect::<String>())
    };
    let fraction = |k: usize| k as f64 / RATE;
    let times: [&dyn Fn(usize) -> String; 10] = [
        &|k| format!("15-Oct-2021 10:00:{:06.3}", fraction(k)),
        &|k| format!("1.Mai.2024 10:00:{:06.3}", fraction(k)),
        &|k| format!("{:.3} sec", fraction(k)),
        &|k| format!("2024-05-01T10:00:{:06.3}Z", fraction(k)),
        &|k| format!("2024-05-01 10:00:{:06.3}+02:00", fraction(k)),
        &|k| format!("01.05.2024 10:00:{:06.3}", fraction(k)),
        &|k| format!("5/1/2024 10:00:{:06.3} PM", fraction(k)),
        &|k| format!("10:00:{:06.3}", fraction(k)),
        // Over midnight.
        &|k| {
            if k < 100 {
                format!("23:59:{:06.3}", 59.9 + fraction(k))
            } else {
                format!("00:00:{:06.3}", fraction(k - 100))
            }
        },
        &|k| format!("17145576{:02}.{:03}", k / 1000, k % 1000),
    ];
    for time in times {
        assert_read("t.csv", with_times(time), MAPPING, ROWS);
    }
    let ticks =
        with_times(&|k| format!("{}", 1_714_557_600_000_000_000_u64 + 1_000_000 * k as u64));
    assert_read("t.csv", ticks, &MAPPING.replace("{column: t}", "{column: t, unit: ns}"), ROWS);
    let days = with_times(&|k| format!("{:.12}", 45_413.0 + fraction(k) / 86_400.0));
    let mapping = MAPPING.replace("{column: t}", "{column: t, unit: d}");
    let recording = read("t.csv", days, &mapping).unwrap();
    assert!((recording.rate - RATE).abs() < 1.0 && recording.trace.len() == ROWS);
}

#[test]
fn a_unit_that_the_file_gives_and_the_mapping_does_not_take_is_told() {
    let in_mm: String = (0..ROWS)
        .map(|k| format!("{:.3},{:.5},{:.6}\n", k as f64 / RATE, 1e3 * values(k).0, values(k).1))
        .collect();
    for names in ["t,x,u\ns,mm,A\n", "t,x,u\n[s],[mm],[A]\n", "t,x,u [A]\n,mm,\n"] {
        let mapping = "signals: {time: {column: 1}, position: {column: 2}, force: {column: 3}}";
        let recording = read("t.csv", format!("{names}{in_mm}"), mapping).unwrap();
        assert!((recording.trace.position[1] - 1e3 * values(1).0).abs() < 1e-9);
        let note = |signal, unit: &str, taken: &str| SignalNote::UnitOfFile {
            signal,
            unit: unit.into(),
            taken: taken.into(),
        };
        let notes = &recording.quality.notes;
        assert!(notes.contains(&note(Signal::Position, "mm", "m")), "{names} {notes:?}");
        assert!(notes.contains(&note(Signal::Force, "A", "N")), "{names} {notes:?}");
        assert_eq!(notes.len(), 2, "{notes:?}");
        let said = mapping
            .replace("column: 2", "column: 2, unit: mm")
            .replace("column: 3", "column: 3, scale: 1");
        let recording = assert_read("t.csv", format!("{names}{in_mm}"), &said, ROWS);
        assert_eq!(recording.quality.notes, []);
    }
}

#[test]
fn a_velocity_is_integrated_where_there_is_no_position() {
    // A drive's export without a position: ms, rpm, percent; 2 mm per turn.
    let lead = 2e-3;
    let rows: String = (0..ROWS)
        .map(|k| {
            let turns = 300.0 * (20.0 * k as f64 / RATE).sin();
            format!("{}.000;{turns:.9};{:.6}\n", k, values(k).1)
        })
        .collect();
    let text =
        format!("Date:;2020-07-08 21:54:05\n;Velocity actual;Torque actual\nms;rpm;%\n{rows}");
    let file = file("t.csv", text);
    let proposal = Proposal::of(&file.path).unwrap();
    let yaml = proposal.to_yaml("t.csv", &[]);
    assert!(yaml.contains("unit: \"rpm\"}") && yaml.contains("N m of 100 %"), "{yaml}");
    // As it is it is of the motor, in multiples of the rated torque.
    let motor = load(&file.path, Some(&Mapping::from_yaml(&yaml, "proposed").unwrap())).unwrap();
    assert_eq!(motor.joint, Some(JointType::Revolute));
    let said = yaml
        .replace("\"rpm\"}", &format!("\"rpm\", scale: {}}}", lead / std::f64::consts::TAU))
        .replace("\"%\", scale: 1}", "\"%\", scale: 200}")
        .replace("# CHECK", "# was to check");
    let recording = load(&file.path, Some(&Mapping::from_yaml(&said, "said").unwrap())).unwrap();
    assert_eq!(recording.quality.notes, [SignalNote::Integrated]);
    for (time, x) in recording.trace.time.iter().zip(&recording.trace.position) {
        // The integral of 300 rpm times the sine.
        let wanted = 300.0 * lead / 60.0 / 20.0 * (1.0 - (20.0 * time).cos());
        assert!((x - wanted).abs() < 1e-7, "{time} s: {x}, not {wanted}");
    }
    let bag = file.path.with_extension("bag");
    import(
        &file.path,
        &Mapping::from_yaml(&said, "said").unwrap(),
        &BTreeMap::new(),
        &bag,
        &mut |_| {},
    )
    .unwrap();
    let imported = load(&bag, None).unwrap();
    for (one, two) in imported.trace.position.iter().zip(&recording.trace.position) {
        assert!((one - two).abs() < 1e-12);
    }
}

#[test]
fn a_position_is_the_reference_less_the_following_error() {
    let rows: String = (0..ROWS)
        .map(|k| {
            let (x, u) = values(k);
            let error = 0.25 + 0.01 * (k % 3) as f64;
            format!("{:.3},{:.6},{error:.6},{u:.6}\n", k as f64 / RATE, 1e3 * x + error)
        })
        .collect();
    let text = format!("time [s],set_point [mm],position_error [mm],force [N]\n{rows}");
    let file = file("t.csv", text);
    let yaml = Proposal::of(&file.path).unwrap().to_yaml("t.csv", &[]);
    let mapping = Mapping::from_yaml(&yaml, "proposed").unwrap();
    let recording = load(&file.path, Some(&mapping)).unwrap();
    for k in 0..ROWS {
        assert!((recording.trace.position[k] - values(k).0).abs() < 1e-8, "{yaml}");
    }
}

#[test]
fn what_is_no_row_is_left_out_and_counted() {
    let rows = rows(",", '.', "\n");
    let whole = format!("t,x,u\n{rows}");
    let missing = |line: usize| {
        let short = |(k, row): (usize, &str)| {
            if k == line { row.rsplit_once(',').unwrap().0.to_owned() } else { row.to_owned() }
        };
        whole.lines().enumerate().map(short).collect::<Vec<_>>().join("\n")
    };
    for (text, rows, left_out, first_line) in [
        (missing(ROWS), ROWS - 1, 1, ROWS + 1),
        (format!("{whole}End of recording\n"), ROWS, 1, ROWS + 2),
        (format!("{whole}\nEnd\nFile,written,by\n"), ROWS, 2, ROWS + 3),
    ] {
        let recording = assert_read("t.csv", text, MAPPING, rows);
        let note = SignalNote::RowsLeftOut { rows: left_out, first_line: first_line as u64 };
        assert_eq!(recording.quality.notes, [note]);
    }
    let recording = read("t.csv", missing(100), MAPPING).unwrap();
    assert_eq!(recording.quality.notes, [SignalNote::RowsLeftOut { rows: 1, first_line: 101 }]);
    let na = whole.replacen(&format!("{:.6}", values(50).1), "N/A", 1);
    assert!(read("t.csv", na, MAPPING).unwrap().trace.force[50].is_finite(), "one is filled in");
}

#[test]
fn several_captures_are_refused_with_the_line() {
    let capture = rows(",", '.', "\n");
    for (text, line) in [
        (format!("t,x,u\n{capture}{capture}"), ROWS + 2),
        (format!("t,x,u\n{capture}t,x,u\n{capture}"), ROWS + 2),
        (format!("t,x,u\n{capture}\nTrigger 2\nt,x,u\n{capture}"), ROWS + 3),
        // The later one is longer.
        (format!("t,x,u\n0.0,1.0,2.0\n0.1,1.1,2.0\nTrigger 2\nt,x,u\n{capture}"), 4),
    ] {
        let message = error(&text, MAPPING);
        assert!(message.contains(&format!("line {line}:")), "{message}");
        assert!(message.contains("split"), "{message}");
    }
    // An 8-bit counter for a clock.
    let counter: String = (0..ROWS * 2).map(|k| format!("{},{},{}\n", k % 256, k, k)).collect();
    let message = error(format!("t,x,u\n{counter}"), MAPPING);
    assert!(message.contains("line 258") && message.contains("`rate`"), "{message}");
    // Rows that were written in another order by a few are no captures.
    let mut lines: Vec<&str> = capture.lines().collect();
    lines.swap(20, 21);
    let text = format!("t,x,u\n{}\n", lines.join("\n"));
    assert_read("t.csv", text, MAPPING, ROWS);
}

#[test]
fn a_name_that_two_columns_have_is_refused() {
    let message = error("t,x,x,u\n0,1,2,3\n1,1,2,3\n2,1,2,3\n", MAPPING);
    assert!(message.contains("columns 2 and 3") && message.contains("number"), "{message}");
}

#[test]
fn a_text_that_is_no_number_is_told_with_its_line() {
    let mut lines: Vec<String> = rows(",", '.', "\n").lines().map(str::to_owned).collect();
    lines[29] = "0.029,abc,1.0".into();
    let message = error(format!("Trace\n\nt,x,u\n{}\n", lines.join("\n")), MAPPING);
    assert!(message.contains("line 33: \"abc\" in column 2 (x)"), "{message}");
    // In the first row, too, with names above or without.
    lines[29] = "0.029,1.0,1.0".into();
    lines[0] = "0.000,overload,1.0".into();
    let message = error(format!("t,x,u\n{}\n", lines.join("\n")), MAPPING);
    assert!(message.contains("line 2: \"overload\" in column 2 (x)"), "{message}");
    let by_number = "signals: {time: {column: 1}, position: {column: 2}}";
    let message = error(lines.join("\n"), by_number);
    assert!(message.contains("line 1: \"overload\" in column 2"), "{message}");
    // An infinite value is a missing one.
    lines[0] = "0.000,inf,1.0".into();
    let text = format!("t,x,u\n{}\n", lines.join("\n"));
    let recording = read("t.csv", text, MAPPING).unwrap();
    let position = recording.quality.signal(Signal::Position).unwrap();
    assert_eq!((position.samples, position.not_finite), (ROWS as u64, 1));
}

/// What is proposed for a table, and the recording that the proposal gives without an edit.
fn proposed(name: &str, bytes: impl AsRef<[u8]>) -> (Proposal, Recording) {
    let file = file(name, bytes);
    let proposal = Proposal::of(&file.path).unwrap();
    let yaml = proposal.to_yaml(name, &[]);
    let mapping = Mapping::from_yaml(&yaml, "proposed").unwrap_or_else(|e| panic!("{e}\n{yaml}"));
    let recording = load(&file.path, Some(&mapping)).unwrap_or_else(|e| panic!("{e}\n{yaml}"));
    (proposal, recording)
}

#[test]
fn a_mapping_is_proposed_that_fits_without_an_edit_where_the_file_says_enough() {
    let values_of = |k: usize| [k as f64, 1e3 * values(k).0, values(k).1, 0.5 * k as f64];
    let table = |delimiter: &str, decimal: char| -> String {
        let row = |k: usize| {
            let fields = values_of(k).map(|v| format!("{v:.6}").replace('.', &decimal.to_string()));
            fields.join(delimiter) + "\n"
        };
        (0..ROWS).map(row).collect()
    };
    // Layouts after exports of drives and loggers; a column more than is needed.
    for (head, delimiter, decimal) in [
        ("t [ms],position [mm],force [N],temp [C]\n", ",", '.'),
        ("Time;Position actual value;Force;Status\nms;mm;N;-\n", ";", ','),
        ("Zeit (ms)\tIstposition (mm)\tKraft (N)\tT\n", "\t", ','),
        ("Date:;2020-07-08\nChannels:;3;a;b\n\nms;x;force;n\nms;mm;N;-\n", ";", '.'),
        ("# time pos force n\n# ms mm N -\n", " ", '.'),
    ] {
        let (proposal, recording) =
            proposed("t.txt", format!("{head}{}", table(delimiter, decimal)));
        assert!(proposal.signals.iter().all(|found| found.check.is_none()), "{proposal:#?}");
        assert!((recording.rate - RATE).abs() < 1e-6 && recording.trace.len() == ROWS);
        for k in 0..ROWS {
            let (x, u) = values(k);
            assert!((recording.trace.position[k] - x).abs() < 1e-9);
            assert!((recording.trace.force[k] - u).abs() < 1e-6);
        }
    }
}

#[test]
fn what_the_file_does_not_say_is_to_be_checked() {
    let rows: String = (0..ROWS)
        .map(|k| format!("{:.3};{:.8};{:.6}\n", k as f64 / RATE, values(k).0, values(k).1))
        .collect();
    let file = file("t.csv", format!("t;x;motor current [A]\n{rows}"));
    let proposal = Proposal::of(&file.path).unwrap();
    let check = |signal: Signal| {
        let found = proposal.signals.iter().find(|found| found.signal == signal).unwrap();
        found.check.clone().unwrap()
    };
    assert!(check(Signal::Position).contains("no unit"));
    assert!(check(Signal::Force).contains("N per A"));
    // As it is it is read with a warning.
    let yaml = proposal.to_yaml("t.csv", &[]);
    let recording = load(&file.path, Some(&Mapping::from_yaml(&yaml, "proposed").unwrap()));
    assert!(yaml.contains("current: {"), "{yaml}");
    let notes = recording.unwrap().quality.notes;
    let [SignalNote::Unconfirmed { marks }, SignalNote::NoForceConstant] = notes.as_slice() else {
        panic!("{notes:?}");
    };
    assert!(marks.len() == 3 && marks[2].contains("N per A"), "{marks:?}");
    // A bag of forces is not made of it.
    let mapping = Mapping::from_yaml(&yaml, "proposed").unwrap();
    let out = file.path.with_file_name("bag");
    let error =
        import(&file.path, &mapping, &BTreeMap::new(), &out, &mut |_| ()).unwrap_err().to_string();
    assert!(error.contains("signals.current") && error.contains("per A"), "{error}");
    assert!(!out.exists());
    // Without names the one that moves like a position is.
    let (proposal, _) = proposed("t.csv", &rows);
    let found = proposal.signals.iter().find(|found| found.signal == Signal::Position);
    assert_eq!(found.map(|found| found.column), Some(2), "{proposal:#?}");
}

/// Names as exports have them that say what a column is, and in which unit.
#[test]
fn a_quantity_over_its_unit_and_a_path_of_a_topic_are_names() {
    let row = |k: usize| format!("{k},{:.7},{:.6}\n", 1e3 * values(k).0, values(k).1);
    let rows: String = (0..ROWS).map(row).collect();
    for head in ["t/ms,x/mm,F/N", "Time / ms,s_x / mm,F_x / N", "t_ms,q_mm,f_N"] {
        let (proposal, recording) = proposed("t.csv", format!("{head}\n{rows}"));
        assert!(proposal.checks().is_empty(), "{head}: {:?}", proposal.checks());
        assert!((recording.trace.position[40] - values(40).0).abs() < 1e-9, "{head}");
        assert!((recording.trace.force[40] - values(40).1).abs() < 1e-6, "{head}");
    }
    for (head, force) in [
        ("__time,/stage/encoder/stage/position,/stage/force/wrench/force/x", 3),
        ("time,/joint_states/position[0],/joint_states/effort[0]", 3),
        ("stamp,axis.x.torque,axis.x.pos", 2),
    ] {
        let (proposal, _) = proposed("t.csv", format!("{head}\n{rows}"));
        let found = proposal.signals.iter().find(|found| found.signal == Signal::Force);
        assert_eq!(found.map(|found| found.column), Some(force), "{head}: {proposal:#?}");
    }
}

#[test]
fn whole_numbers_are_no_seconds_and_the_only_column_left_is_the_force_to_check() {
    for (step, rate) in [(1.0, RATE), (20.0, 50.0), (1000.0, RATE), (1e6, RATE)] {
        let row = |k: usize| format!("{} {:.8} {:.6}\n", step * k as f64, values(k).0, values(k).1);
        let rows: String = (0..ROWS).map(row).collect();
        for head in ["", "t x f\n"] {
            let (proposal, recording) = proposed("t.txt", format!("{head}{rows}"));
            assert!((recording.rate / rate - 1.0).abs() < 1e-6, "{step}: {} Hz", recording.rate);
            let what: Vec<&str> = proposal.checks().iter().map(|(what, _)| *what).collect();
            assert_eq!(what, ["time", "position", "force"], "{step}");
        }
    }
    let row = |k: usize| format!("{:.8},{:.6}\n", values(k).0, values(k).1);
    let rows: String = (0..ROWS).map(row).collect();
    let (proposal, _) = proposed("t.csv", format!("x,f\n{rows}"));
    assert_eq!(proposal.checks()[0].0, "rate");
}

/// Signals with stamps of their own in one table, as an outer join of them is written: a row is a
/// sample of one of them.
#[test]
fn an_empty_field_is_no_sample() {
    let of = |k: usize| {
        let (x, u) = values(k);
        let t = k as f64 / RATE;
        (t, x, u)
    };
    let text: String = (0..ROWS)
        .map(|k| {
            let (t, x, u) = of(k);
            format!("{t:.6},{x:.8},\n{:.6}, ,{u:.6}\n", t + 1e-5)
        })
        .collect();
    let recording = read("t.csv", format!("t,x,u\n{text}"), MAPPING).unwrap();
    assert_eq!((recording.trace.len(), recording.quality.valid_rows), (ROWS, ROWS));
    for signal in &recording.quality.signals {
        assert_eq!((signal.samples, signal.not_finite), (ROWS as u64, 0), "{signal:?}");
    }
    for k in 1..ROWS {
        assert!((recording.trace.position[k] - of(k).1).abs() < 1e-12, "row {k}");
    }
    // A force at a third of the rate of the position.
    let text: String = (0..ROWS)
        .map(|k| {
            let (t, x, u) = of(k);
            let u = if k % 3 == 0 { format!("{u:.6}") } else { String::new() };
            format!("{t:.6};{x:.8};{u}\n")
        })
        .collect();
    let recording = read("t.csv", format!("t;x;u\n{text}"), MAPPING).unwrap();
    assert_eq!((recording.trace.len(), recording.rate.round()), (ROWS, RATE));
    let force = recording.quality.signals.iter().find(|found| found.signal == Signal::Force);
    assert_eq!(
        force.map(|found| found.samples),
        Some(ROWS.div_ceil(3) as u64),
        "{:?}",
        recording.quality
    );
}

#[test]
fn rows_with_the_newest_first_are_refused_with_what_to_do() {
    let lines = rows(",", '.', "\n");
    let newest: String = lines.lines().rev().map(|line| format!("{line}\n")).collect();
    let text = format!("t,x,u\n{newest}");
    let reported = error(&text, MAPPING);
    assert!(
        reported.contains("newest row comes first") && reported.contains("line 4"),
        "{reported}"
    );
    let file = file("t.csv", format!("time,x_mm,f\n{newest}"));
    let proposal = Proposal::of(&file.path).unwrap();
    let (what, check) = proposal.checks()[0];
    assert!(what == "time" && check.contains("reverse the rows"), "{what}: {check}");
}

proptest! {
    #![proptest_config(ProptestConfig {
        failure_persistence: None,
        ..ProptestConfig::with_cases(200)
    })]

    #[test]
    fn a_dialect_changes_no_number(
        delimiter in prop::sample::select(vec![",", ";", "\t", "|", "  "]),
        comma in any::<bool>(),
        end in prop::sample::select(vec!["\n", "\r\n"]),
        above in prop::collection::vec("[A-Za-z][A-Za-z :=]{0,20}", 0..30),
        units in any::<bool>(),
        trailing in any::<bool>(),
        wide in any::<bool>(),
        numbers in prop::collection::vec((-1e3..1e3_f64, -1e-3..1e-3_f64), 20..80),
    ) {
        let comma = comma && delimiter != ",";
        let delimited = |fields: &[String]| {
            let last = if trailing && delimiter != "  " { delimiter } else { "" };
            fields.join(delimiter) + last + end
        };
        let words = |words: [&str; 3]| delimited(&words.map(str::to_owned));
        let mut text: String = above.iter().map(|line| format!("{line}{end}")).collect();
        text += &words(["t", "x", "u"]);
        if units {
            text += &words(["ms", "mm", "N"]);
        }
        for (k, (x, u)) in numbers.iter().enumerate() {
            let written = [format!("{k}.0"), format!("{x:e}"), format!("{u:.9}")];
            let mark = |text: String| if comma { text.replace('.', ",") } else { text };
            text += &delimited(&written.map(mark));
        }
        let bytes: Vec<u8> = if wide {
            [0xfeff].into_iter().chain(text.encode_utf16()).flat_map(u16::to_le_bytes).collect()
        } else {
            text.into_bytes()
        };
        let mapping = MAPPING
            .replace("{column: t}", "{column: t, unit: ms}")
            .replace("{column: x}", "{column: x, unit: mm}");
        let recording = read("t.csv", &bytes, &mapping).unwrap();
        prop_assert_eq!(recording.trace.len(), numbers.len());
        let mut read = vec![recording];
        // The proposed mapping reads the same where the file gives the units.
        if units {
            let file = file("t.csv", &bytes);
            let yaml = Proposal::of(&file.path).unwrap().to_yaml("t.csv", &[]);
            let proposed = Mapping::from_yaml(&yaml, "proposed").unwrap();
            let found = load(&file.path, Some(&proposed));
            prop_assert!(found.is_ok(), "{:?}\n{}", found.err(), yaml);
            read.extend(found);
        }
        for recording in read {
            prop_assert_eq!(recording.trace.len(), numbers.len());
            for (k, (x, u)) in numbers.iter().enumerate() {
                prop_assert!((recording.trace.position[k] - 1e-3 * x).abs() <= 1e-15);
                prop_assert!((recording.trace.force[k] - u).abs() <= 1e-9);
            }
        }
    }

    #[test]
    fn bytes_of_any_kind_are_read_or_refused(
        bytes in prop::collection::vec(
            prop_oneof![
                prop::sample::select(b"0123456789.,;\t -+eE:\"\n\rtxu#\xff\0".to_vec()),
                any::<u8>(),
            ],
            0..600,
        ),
    ) {
        // No panic, whatever it says.
        let _ = read("t.csv", &bytes, MAPPING);
        let _ = read("t.csv", &bytes, "rate: 10\nsignals: {position: {column: 1}}");
        let file = file("t.csv", &bytes);
        if let Ok(proposal) = Proposal::of(&file.path) {
            let yaml = proposal.to_yaml("t.csv", &[]);
            if proposal.has_motion() {
                prop_assert!(Mapping::from_yaml(&yaml, "proposed").is_ok(), "{}", yaml);
            }
        }
    }
}

/// Rows per capture that come of a file, and the first position of each.
fn captures(name: &str, text: &str) -> Result<Vec<(u64, f64)>, SignalError> {
    let file = file(name, text);
    let mapping = Mapping::from_yaml(MAPPING, "mapping.yaml").unwrap();
    let home = tempfile::tempdir().unwrap();
    let out = home.path().join("out");
    let reports = import_captures(&file.path, &mapping, &BTreeMap::new(), &out, &mut |_| {})?;
    let first = |bag: &std::path::Path| load(bag, None).unwrap().trace.position[0];
    for (index, report) in reports.iter().enumerate() {
        assert_eq!(report.bag, out.join(format!("capture_{}", index + 1)));
    }
    Ok(reports.iter().map(|report| (report.rows, first(&report.bag))).collect())
}

/// A capture of `count` rows whose position begins at `x` and whose times begin at `t`.
fn capture(count: usize, x: f64, t: f64) -> String {
    (0..count)
        .map(|k| format!("{:.3},{:.6},1.0\n", t + k as f64 * 1e-3, x + k as f64 * 1e-6))
        .collect()
}

#[test]
fn each_capture_of_a_file_is_a_bag() {
    // Times that start again, at 0 or elsewhere; captures of equal and of different length.
    for (lengths, begin) in [(vec![50, 50, 50], 0.0), (vec![30, 70, 41, 3, 90], 5.0)] {
        let text: String = lengths
            .iter()
            .enumerate()
            .map(|(index, count)| capture(*count, 0.1 * index as f64, begin))
            .collect();
        let expected: Vec<(u64, f64)> = lengths
            .iter()
            .enumerate()
            .map(|(index, count)| (*count as u64, (1e5 * index as f64).round() / 1e6))
            .collect();
        assert_eq!(captures("a.csv", &format!("t,x,u\n{text}")).unwrap(), expected);
        let reported = read("a.csv", format!("t,x,u\n{text}"), MAPPING).unwrap_err().to_string();
        assert!(reported.contains(&format!("line {}", lengths[0] + 2)), "{reported}");
        assert!(reported.contains("--split"), "{reported}");
    }
    // Names and units before each capture; times that continue, and times that start again.
    for begin in [0.0, 100.0] {
        let block = |x: f64, t: f64| format!("t,x,u\ns,m,N\n{}", capture(40, x, t));
        let text = format!("{}\n{}", block(0.0, 0.0), block(0.2, begin));
        assert_eq!(captures("b.csv", &text).unwrap(), [(40, 0.0), (40, 0.2)]);
        assert!(read("b.csv", &text, MAPPING).unwrap_err().to_string().contains("--split"));
    }
    // Another table is no capture of this one.
    let text = format!("t,x,u\n{}t,y,v\n{}", capture(40, 0.0, 0.0), capture(40, 0.2, 0.0));
    let reported = captures("c.csv", &text).unwrap_err().to_string();
    assert!(
        reported.contains("another capture or table") && reported.contains("line 42"),
        "{reported}"
    );
}

#[test]
fn one_wrong_time_is_no_capture() {
    let text = format!("t,x,u\n{}", capture(100, 0.0, 1.0)).replace("1.050,", "0.000,");
    assert_eq!(captures("a.csv", &text).unwrap().len(), 1);
    assert_eq!(
        captures("b.csv", &format!("t,x,u\n{}", capture(60, 0.0, 0.0))).unwrap(),
        [(60, 0.0)]
    );
}

#[test]
fn a_part_of_a_recording_is_the_rows_of_the_whole() {
    let mapping = "signals: {time: {column: t}, position: {column: x}, force: {column: u}, \
                   reference_position: {column: r}}";
    // The reference stands in every hundredth row.
    let text: String = (0..5000)
        .map(|k| {
            let (x, u) = values(k);
            let reference = if k % 100 == 3 { x } else { f64::NAN };
            format!("{:.3},{x:.8},{u:.6},{reference:.8}\n", 7.0 + k as f64 * 1e-3)
        })
        .collect();
    let file = file("long.csv", format!("t,x,u,r\n{text}"));
    let mapping = Mapping::from_yaml(mapping, "mapping.yaml").unwrap();
    let bag = file.path.with_file_name("bag");
    import(&file.path, &mapping, &BTreeMap::new(), &bag, &mut |_| {}).unwrap();
    for (source, mapping) in [(&file.path, Some(&mapping)), (&bag, None)] {
        let whole = load(source, mapping).unwrap();
        for (from, to, most, rows) in [
            (Some(1.0), Some(2.0), None, 1000..2001),
            (Some(4.0), None, None, 4000..5000),
            (None, Some(0.5), None, 0..501),
            (Some(1.0), None, Some(300), 1000..1300),
        ] {
            let part = load_part(source, mapping, Window { from, to, most }).unwrap();
            assert_eq!(part.trace.position, whole.trace.position[rows.clone()], "{from:?} {to:?}");
            assert_eq!(part.trace.force, whole.trace.force[rows.clone()], "{from:?} {to:?}");
            let reported = part.quality.notes.iter().find_map(|note| match note {
                SignalNote::OnlyPart { samples, .. } => Some(*samples),
                _ => None,
            });
            assert_eq!(reported, Some(rows.len() as u64));
            let same = |(a, b): (&f64, &f64)| a == b || a.is_nan() && b.is_nan();
            let reference = part.trace.reference_position.iter();
            let expected = &whole.trace.reference_position[rows];
            assert!(reference.zip(expected).all(same), "{:?}", &expected[..3]);
        }
    }
    let beyond = Window { from: Some(99.0), ..Window::default() };
    let reported = load_part(&file.path, Some(&mapping), beyond).unwrap_err().to_string();
    assert!(reported.contains("0 samples of position from 99 s to its end"), "{reported}");
}

#[test]
fn a_travel_without_a_unit_is_proposed_in_one_that_a_stage_can_have() {
    let rows = |scale: f64| -> String {
        let row = |k: usize| format!("{:.3},{:.8}\n", k as f64 / RATE, values(k).0 * scale);
        format!("time,position\n{}", (0..ROWS).map(row).collect::<String>())
    };
    // 0.1 m of travel.
    for (scale, unit) in [(1.0, "m"), (1e3, "mm"), (1e6, "um")] {
        let proposal = Proposal::of(&file("t.csv", rows(scale)).path).unwrap();
        let position = proposal.signals.iter().find(|s| s.signal == Signal::Position).unwrap();
        assert_eq!(position.unit.as_deref(), Some(unit));
        assert!(position.check.as_deref().unwrap().contains("no unit"), "{position:?}");
    }
}

#[test]
fn two_columns_with_decimal_commas_are_two_columns() {
    for delimiter in [";", "\t", " "] {
        let table = rows(delimiter, ',', "\n");
        // Time and position only.
        let two: String = table
            .lines()
            .map(|line| line.rsplit_once(delimiter).unwrap().0.to_owned() + "\n")
            .collect();
        let mapping = "signals: {time: {column: 1}, position: {column: 2}}";
        let recording = read("t.csv", format!("t{delimiter}x\n{two}"), mapping).unwrap();
        assert_eq!(recording.trace.len(), ROWS);
        assert!((0..ROWS).all(|k| (recording.trace.position[k] - values(k).0).abs() < 1e-12));
    }
}

/// The proposal for a table with these names and columns of `ROWS` values.
fn proposal_of(names: &str, columns: &[&dyn Fn(usize) -> f64]) -> Proposal {
    let row = |k: usize| {
        let fields: Vec<String> = columns.iter().map(|of| format!("{:.9}", of(k))).collect();
        fields.join(";") + "\n"
    };
    let rows: String = (0..ROWS).map(row).collect();
    Proposal::of(&file("t.csv", format!("{names}\n{rows}")).path).unwrap()
}

fn column_of(proposal: &Proposal, signal: Signal) -> Option<usize> {
    proposal.signals.iter().find(|found| found.signal == signal).map(|found| found.column)
}

fn check_of(proposal: &Proposal, what: &str) -> String {
    let of = proposal.checks().into_iter().filter(|(of, _)| *of == what);
    of.map(|(_, check)| check).collect::<Vec<_>>().join("; ")
}

#[test]
fn of_two_columns_of_a_quantity_the_measured_one_is_taken_and_a_doubt_is_said() {
    let (t, x, u) =
        (&|k: usize| k as f64 / RATE, &|k: usize| 1e3 * values(k).0, &|k: usize| values(k).1);
    let asked = &|k: usize| 1e3 * values(k).0 + 0.01;
    // What is asked for stands first.
    for (names, doubt) in [
        ("t [s];PositionSollwert [mm];PositionIstwert [mm];Kraft [N]", false),
        ("t [s];Lagesollwert [mm];Lageistwert [mm];Kraft [N]", false),
        ("t [s];Consigne [mm];Position mesur\u{e9}e [mm];Force [N]", false),
        ("t [s];PCMD [mm];PFBK [mm];Force [N]", false),
        ("t [s];Profile position [mm];Motor (Actual) Position [mm];Force [N]", false),
        ("t [s];Target [mm];CurrentPosition [mm];Force [N]", false),
        ("t [s];Position 1 [mm];Position 2 actual [mm];Force [N]", true),
    ] {
        let proposal = proposal_of(names, &[t, asked, x, u]);
        assert_eq!(column_of(&proposal, Signal::Position), Some(3), "{names}: {proposal:#?}");
        assert_eq!(column_of(&proposal, Signal::Force), Some(4), "{names}: {proposal:#?}");
        let check = check_of(&proposal, "position");
        assert_eq!(check.contains("or is it"), doubt, "{names}: {check}");
    }
    for names in ["t [s];encoder a [mm];encoder b [mm];F [N]", "t [s];x [mm];x [mm];F [N]"] {
        let proposal = proposal_of(names, &[t, x, x, u]);
        assert!(check_of(&proposal, "position").contains("or is it"), "{names}");
    }
}

#[test]
fn what_is_of_another_axis_is_to_be_checked() {
    let (t, x, u) = (&|k: usize| k as f64 / RATE, &|k: usize| values(k).0, &|k: usize| values(k).1);
    for names in [
        "time [s];Ax2 position [m];Ax1 force [N]",
        "time [s];/joint_states/x/position [m];/joint_states/y/effort [N]",
        "time [s];Drive3.ActPos [m];Drive4.Torque force [N]",
    ] {
        let check = check_of(&proposal_of(names, &[t, x, u]), "force");
        assert!(check.contains("another axis"), "{names}: {check}");
    }
    // That of the same axis comes first.
    let names = "time [s];Axis 1 force [N];Axis 2 force [N];Axis 2 position [m]";
    let proposal = proposal_of(names, &[t, u, u, x]);
    assert_eq!(column_of(&proposal, Signal::Force), Some(3), "{proposal:#?}");
}

/// A position is the reference less the following error, in whichever units.
#[test]
fn an_error_is_no_position() {
    for (names, size) in [
        ("t [s];Soll [mm];Schleppfehler [mm];F [N]", 1e3),
        ("t [s];Position Command [mm];Following Error [um];F [N]", 1e6),
        ("t [s];x_soll [mm];Schleppabstand [\u{b5}m];F [N]", 1e6),
    ] {
        let error = |k: usize| 1e-4 * (0.1 * k as f64).sin();
        let row = |k: usize| {
            let (x, u) = values(k);
            let asked = 1e3 * (x + error(k));
            format!("{:.6};{asked:.9};{:.9};{u:.6}\n", k as f64 / RATE, size * error(k))
        };
        let rows: String = (0..ROWS).map(row).collect();
        let (proposal, recording) = proposed("t.csv", format!("{names}\n{rows}"));
        assert!(check_of(&proposal, "position").contains("its sign?"), "{names}: {proposal:#?}");
        for k in 0..ROWS {
            let x = recording.trace.position[k];
            assert!((x - values(k).0).abs() < 1e-9, "{names}: {x} {}", values(k).0);
        }
    }
    // A pair of different kinds makes no position.
    let (t, x) = (&|k: usize| k as f64 / RATE, &|k: usize| values(k).0);
    let proposal = proposal_of("t [s];Soll [mm];Fehler [A];F [N]", &[t, x, x, &|k| values(k).1]);
    assert_eq!(column_of(&proposal, Signal::Position), None, "{proposal:#?}");
    let wrong = "signals: {position: {column: a, unit: mm, minus: b, minus_unit: A}}";
    let reported = Mapping::from_yaml(wrong, "m.yaml").unwrap_err().to_string();
    assert!(reported.contains("minus_unit") && reported.contains("same kind"), "{reported}");
}

#[test]
fn columns_with_a_clock_of_their_own_are_joined() {
    let slow = 4.0;
    // The force four times as fast as the position; where a column ends, its fields are empty.
    let row = |k: usize, at: [usize; 4]| {
        let force = values(k).1;
        let time = k as f64 / RATE;
        let mut fields = [const { String::new() }; 4];
        if k < ROWS / 4 {
            fields[at[0]] = format!("{:.6}", time * slow);
            fields[at[1]] = format!("{:.9}", 1e3 * values(4 * k).0);
        }
        fields[at[2]] = format!("{time:.6}");
        fields[at[3]] = format!("{force:.9}");
        fields.join(",") + "\n"
    };
    for (names, at) in [
        ("Time_1 [s],Position [mm],Time_2 [s],Force [N]", [0, 1, 2, 3]),
        ("t [s],F [N],t [s],x [mm]", [2, 3, 0, 1]),
        ("pos.t,pos.x_mm,force.t,force.F_N", [0, 1, 2, 3]),
        ("Weg [mm],Weg_t [s],Kraft [N],Kraft_t [s]", [1, 0, 3, 2]),
    ] {
        let rows: String = (0..ROWS).map(|k| row(k, at)).collect();
        let file = file("t.csv", format!("{names}\n{rows}"));
        let proposal = Proposal::of(&file.path).unwrap();
        let yaml = proposal.to_yaml(&file.path.display().to_string(), &[]);
        let mapping =
            Mapping::from_yaml(&yaml, "proposed").unwrap_or_else(|e| panic!("{e}: {yaml}"));
        let recording = load(&file.path, Some(&mapping)).unwrap_or_else(|e| panic!("{e}: {yaml}"));
        assert!((recording.rate - RATE / slow).abs() < 1e-6, "{names}: {}", recording.rate);
        for k in 1..ROWS / 4 - 1 {
            let (x, u) = values(4 * k);
            assert!((recording.trace.position[k] - x).abs() < 1e-8, "{names}: {k}");
            // Of a faster signal the mean over a row.
            assert!((recording.trace.force[k] - u).abs() < 1.0, "{names}: {k}");
        }
    }
    // Two times of the same rows are one clock.
    let names = "time [s];stamp [s];x [m];F [N]";
    let t = &|k: usize| k as f64 / RATE;
    let later = &|k: usize| k as f64 / RATE + 3.0;
    let proposal = proposal_of(names, &[t, later, &|k| values(k).0, &|k| values(k).1]);
    assert!(proposal.own_clocks.is_empty(), "{proposal:#?}");
}

#[test]
fn a_rate_that_the_file_says_counts_where_no_column_is_a_time() {
    for (line, rate) in [
        ("Sampling frequency [Hz];2000", 2000.0),
        ("Abtastrate: 4 kHz", 4000.0),
        ("Increment;5e-4", 2000.0),
        ("Sample interval = 250 us", 4000.0),
        ("Delta_X\t0.000500", 2000.0),
        ("Abtastrate\t4,5\tkHz", 4500.0),
        ("SampleRate,5000,5000,5000", 5000.0),
    ] {
        let rows: String =
            (0..ROWS).map(|k| format!("{:.9};{:.9}\n", values(k).0, values(k).1)).collect();
        let rows = if line.contains("4,5") { rows.replace('.', ",") } else { rows };
        let file = file("t.csv", format!("{line}\nposition [m];force [N]\n{rows}"));
        let proposal = Proposal::of(&file.path).unwrap();
        let stated = proposal.stated_rate.as_ref().map(|(rate, _)| *rate);
        assert_eq!(stated, Some(rate), "{line}: {proposal:#?}");
        assert!(check_of(&proposal, "rate").contains("line 1"), "{line}");
    }
    // The number of a row is no time.
    let counter = &|k: usize| k as f64;
    let names = "Sample;position [m];force [N]";
    let proposal = proposal_of(names, &[counter, &|k| values(k).0, &|k| values(k).1]);
    assert!(check_of(&proposal, "rate").contains("`Sample` counts the rows"), "{proposal:#?}");
}

#[test]
fn a_column_of_captures_and_a_time_that_goes_back_are_to_be_checked() {
    let (x, u) = (&|k: usize| values(k).0, &|k: usize| values(k).1);
    let of_run = |k: usize| (k / (ROWS / 2)) as f64;
    let names = "time [s];Run;position [m];force [N]";
    let proposal = proposal_of(names, &[&|k| k as f64 / RATE, &of_run, x, u]);
    assert!(check_of(&proposal, "table").contains("`Run` has 2 values"), "{proposal:#?}");
    // Rows of two axes in turn.
    let names = "time [s];Achse;position [m];force [N]";
    let in_turn = |k: usize| (k / 2) as f64 / RATE;
    let proposal = proposal_of(names, &[&in_turn, &|k| (k % 2) as f64, x, u]);
    assert!(check_of(&proposal, "time").contains("several axes"), "{proposal:#?}");
    assert!(check_of(&proposal, "table").contains("`Achse`"), "{proposal:#?}");
}

/// Position and force of a table that is read by the numbers of its columns: time, position, force.
fn by_numbers(text: &str, columns: [usize; 3]) -> Recording {
    let [t, x, u] = columns;
    let mapping = format!(
        "signals: {{time: {{column: {t}}}, position: {{column: {x}}}, force: {{column: {u}}}}}"
    );
    assert_read("t.txt", text, &mapping, ROWS)
}

#[test]
fn names_of_rows_have_no_name_themselves() {
    let table = |delimiter: &str, decimal: char, label: &dyn Fn(usize) -> String| -> String {
        let rows = rows(delimiter, decimal, "\n");
        rows.lines().enumerate().map(|(k, row)| label(k) + delimiter + row + "\n").collect()
    };
    let labels: [&dyn Fn(usize) -> String; 4] =
        [&|k| format!("\"{}\"", k + 1), &|k| (k + 1).to_string(), &|k| k.to_string(), &|k| {
            format!("\"row {k}\"")
        }];
    for label in labels {
        for (delimiter, decimal) in [(" ", '.'), (",", '.'), (";", ','), ("\t", '.')] {
            for names in [["t", "x", "u"], ["\"t\"", "\"x\"", "\"u\""]] {
                let text = names.join(delimiter) + "\n" + &table(delimiter, decimal, label);
                assert_read("t.txt", text, MAPPING, ROWS);
            }
        }
    }
    // A unit of time is that of a column that rises.
    let head = "t_ms,x,u\n";
    let row = |k: usize| format!("{},{:.8},{:.6},9\n", k, values(k).0, values(k).1);
    let milliseconds = format!("{head}{}", (0..ROWS).map(row).collect::<String>());
    // Nothing says which column has no name.
    let last = format!("t,x,u\n{}", rows(",", '.', ",7\n"));
    for (text, named) in [(&milliseconds, "t_ms"), (&last, "t")] {
        let reported =
            error(text, &MAPPING.replace("{column: t}", &format!("{{column: {named}}}")));
        assert!(reported.contains("line 1 has 3 names for 4 columns"), "{reported}");
        assert!(reported.contains("by number"), "{reported}");
        let proposal = Proposal::of(&file("t.csv", text).path).unwrap();
        assert!(proposal.columns.iter().all(|column| column.name.is_empty()), "{proposal:?}");
    }
    by_numbers(&last, [1, 2, 3]);
}

#[test]
fn names_are_those_with_units_or_the_nearest_that_say_no_other_thing() {
    let with = |head: &str, delimiter: &str, decimal: char| -> Vec<(String, String)> {
        let text = format!("{head}{}", rows(delimiter, decimal, "\n"));
        let proposal = Proposal::of(&file("t.txt", text).path).unwrap();
        assert_eq!(proposal.columns.len(), 3, "{head}");
        proposal.columns.into_iter().map(|column| (column.name, column.unit)).collect()
    };
    let named = |names: [&str; 3], units: [&str; 3]| -> Vec<(String, String)> {
        names.into_iter().zip(units).map(|(n, u)| (n.to_owned(), u.to_owned())).collect()
    };
    // Lines of each channel's settings between the names and the values.
    let head = "Rig 3\n\nt [s]\tx [m]\tu [N]\nSensor A\tSensor B\tSensor C\n\
                Rate = 1 Hz\tRate = 1 Hz\tRate = 1 Hz\n";
    let units = ["s", "m", "N"];
    assert_eq!(with(head, "\t", ','), named(["t [s]", "x [m]", "u [N]"], units));
    let head = "t (s);x (m);u (N)\nCal: 1;Cal: 2;Cal: 3\nslot 1;slot 2;slot 3\n";
    assert_eq!(with(head, ";", '.'), named(["t (s)", "x (m)", "u (N)"], units));
    // Lines of attributes, as Simulink writes them, and of types.
    let head = "t,x,u\n,Unit: m,Unit: N\n,Interp: linear,Interp: zoh\n";
    assert_eq!(with(head, ",", '.'), named(["t", "x", "u"], ["", "m", "N"]));
    for types in ["float;float;int32", "REAL;LREAL;BOOL", "double;double;double"] {
        let head = format!("t;x;u\ns;m;N\n{types}\n");
        assert_eq!(with(&head, ";", '.'), named(["t", "x", "u"], units), "{types}");
        let head = format!("t;x;u\n{types}\n");
        assert_eq!(with(&head, ";", '.'), named(["t", "x", "u"], [""; 3]), "{types}");
    }
    // Settings with names and units of their own above the names.
    let head = "Range [m],Load [N],Speed [m/s]\n1,2,3\nt,x,u\n";
    assert_eq!(with(head, ",", '.'), named(["t", "x", "u"], [""; 3]));
}

#[test]
fn empty_fields_at_the_end_are_no_columns() {
    for (names, end) in [("t,x,u", ",,,\n"), ("t,x,u,,,", ",,,\n"), ("t,x,u,,", "\n")] {
        let text = format!("Rig,3,,,\n{names}\n{}", rows(",", '.', end));
        assert_read("t.csv", &text, MAPPING, ROWS);
        let proposal = Proposal::of(&file("t.csv", &text).path).unwrap();
        assert_eq!(proposal.columns.len(), 3, "{names}");
    }
    // A column that has its first value later is one.
    let late: String = (0..ROWS)
        .map(|k| {
            let other = if k < ROWS - 20 { "," } else { "1.5,2.5" };
            format!("{:.3},{:.8},{:.6},{other}\n", k as f64 / RATE, values(k).0, values(k).1)
        })
        .collect();
    assert_read("t.csv", format!("t,x,u,a,b\n{late}"), MAPPING, ROWS);
}

#[test]
fn labels_in_the_first_field_name_the_lines_above() {
    let rows: String = (0..ROWS)
        .map(|k| format!(",{:.3},{:.8},{:.6}\n", k as f64 / RATE, values(k).0, values(k).1))
        .collect();
    for head in [
        "format,1.0\n\npath,t,x,u\ntype,,,\nunit,s,m,N\ntrace_values\n",
        "\"TraceName\",\"t  \",\"x \",\"u\"\n\"BlockSize\",3000,3000,3000\n\
         \"VUnit\",\"s\",\"m \",\"N\"\n\"Rate\",1.0E+03,1.0E+03,1.0E+03\n\
         \"HUnit\",\"s\",\"s\",\"s\"\n\"Time\",10:15:01.0,10:15:01.0,10:15:01.0\n\n",
        "Channel,t,x,u\nEinheit,s,m,N\nOffset,0,0,0\n",
    ] {
        let text = format!("{head}{rows}");
        let recording = assert_read("t.csv", &text, MAPPING, ROWS);
        assert_eq!(recording.quality.notes, [], "{head}");
        let proposal = Proposal::of(&file("t.csv", &text).path).unwrap();
        let units: Vec<&str> = proposal.columns.iter().map(|c| c.unit.as_str()).collect();
        assert_eq!(units, ["", "s", "m", "N"], "{head}");
    }
}

/// Settings in columns of their own, in the first rows, as older oscilloscopes write them.
#[test]
fn settings_beside_the_values_hide_no_row() {
    for settings in [
        &["Record Length,3000,Points", "Sample Interval,0.001,s", "Probe,1,"][..],
        &["Source,CH1,", "Scale,0.5,V", "Offset,0,V", "Delay,0.25,s", "Date,x,"],
    ] {
        let rows: String = (0..ROWS)
            .map(|k| {
                let (t, (x, u)) = (k as f64 / RATE, values(k));
                format!("{},{t:.3},{x:.8},{u:.6}\n", settings.get(k).unwrap_or(&",,"))
            })
            .collect();
        by_numbers(&rows, [4, 5, 6]);
    }
}

#[test]
fn rows_with_the_other_decimal_mark_are_never_left_out() {
    for (first, second) in [('.', ','), (',', '.')] {
        let half = |decimal: char, from: usize| -> String {
            let rows = rows(";", decimal, "\n");
            rows.lines().skip(from).take(90).map(|row| format!("{row}\n")).collect()
        };
        // In the first column only, at the end or the begin of the table.
        for turned in [0..40, 140..180] {
            let turned: String = rows(";", second, "\n")
                .lines()
                .zip(rows(";", first, "\n").lines())
                .take(180)
                .enumerate()
                .map(|(k, (row, other))| {
                    let time = if turned.contains(&k) { other } else { row };
                    let (time, _) = time.split_once(';').unwrap();
                    format!("{time};{}\n", row.split_once(';').unwrap().1)
                })
                .collect();
            let reported = error(format!("t;x;u\n{turned}"), MAPPING);
            assert!(reported.contains("decimal"), "{reported}");
        }
        let text = format!("t;x [m];u [N]\n{}{}", half(first, 0), half(second, 90));
        let mapping = MAPPING.replace("column: x", "column: 2").replace("column: u", "column: 3");
        let reported = error(&text, &mapping);
        assert!(reported.contains("decimal") || reported.contains("words"), "{reported}");
    }
}

#[test]
fn every_channel_may_have_a_column_of_times() {
    for (delimiter, decimal) in [("\t", ','), (";", '.')] {
        let line = |key: &str, of: [&str; 2]| [key, of[0], key, of[1]].join(delimiter) + "\n";
        let head = [
            line("Name", ["X", "F"]),
            line("SymbolName", ["x", "u"]),
            line("Unit", ["m", "N"]),
            line("Offset", ["0", "0"]),
            line("ScaleFactor", ["1", "1"]),
            "\n".to_owned(),
        ]
        .concat();
        let rows: String = (0..ROWS)
            .map(|k| {
                let (t, (x, u)) = (k as f64 / RATE, values(k));
                [format!("{t:.3}"), format!("{x:.8}"), format!("{t:.3}"), format!("{u:.6}")]
                    .join(delimiter)
                    .replace('.', &decimal.to_string())
                    + "\n"
            })
            .collect();
        let mapping = MAPPING.replace("{column: t}", "{column: 1}");
        let recording = assert_read("t.txt", format!("{head}{rows}"), &mapping, ROWS);
        assert_eq!(recording.quality.notes, []);
    }
}

#[test]
fn names_may_have_a_line_each() {
    let two: String =
        (0..ROWS).map(|k| format!("{:.8} {:.6}\n", values(k).0, values(k).1)).collect();
    for head in [
        "# DIM = 2\n# NAME0 = carriage in m\n# NAME1 = drive in N\n# END_HEADER\n",
        "% column 1: carriage in m\n% column 2: drive in N\n",
    ] {
        let mapping = "rate: 1000\nsignals: {position: {column: carriage in m}, \
                       force: {column: drive in N}}";
        let recording = assert_read("t.dat", format!("{head}{two}"), mapping, ROWS);
        assert_eq!(recording.quality.notes, []);
    }
}

#[test]
fn a_decimal_comma_is_likely_where_a_semicolon_separates() {
    let table = |delimiter: &str, of: &dyn Fn(usize) -> String| -> Proposal {
        let rows: String = (0..ROWS).map(|k| format!("{k}{delimiter}{}\n", of(k))).collect();
        let text = format!("t{delimiter}x\n{rows}");
        Proposal::of(&file("t.csv", text).path).unwrap()
    };
    let grouped = |k: usize, mark: char| match 7 * k {
        small @ ..1000 => small.to_string(),
        large => format!("{}{mark}{:03}", large / 1000, large % 1000),
    };
    for delimiter in [";", "\t"] {
        let proposal = table(delimiter, &|k| format!("{},{k:03}", 10 + k % 3));
        assert!(proposal.decimal_comma && proposal.either_decimal, "{delimiter}");
        let proposal = table(delimiter, &|k| format!("{}.{k:03}", 10 + k % 3));
        assert!(!proposal.decimal_comma && proposal.either_decimal, "{delimiter}");
        // Only numbers of four digits have the mark.
        for mark in [',', '.'] {
            let proposal = table(delimiter, &|k| grouped(k, mark));
            assert_eq!(proposal.decimal_comma, mark == '.', "{delimiter} {mark}");
            assert!(proposal.either_decimal, "{delimiter} {mark}");
            assert_eq!(proposal.columns[1].largest, Some(7.0 * 199.0), "{delimiter} {mark}");
        }
    }
}

#[test]
fn a_word_may_be_said_to_stand_for_no_value() {
    let rows = rows(";", '.', "\n");
    for word in ["OverRange", "+OVLD", "Sensor error"] {
        let text = format!("t;x;u\n{rows}").replacen(&format!("{:.6}", values(50).1), word, 1);
        let reported = error(&text, MAPPING);
        assert!(reported.contains("line 52:"), "{reported}");
        assert!(reported.contains(&format!("{word:?} in column 3 (u)")), "{reported}");
        assert!(reported.contains(&format!("csv: {{missing: [{word:?}]}}")), "{reported}");
        let said = format!("csv: {{missing: [x-x, {word:?}]}}\n{MAPPING}");
        let recording = read("t.csv", &text, &said).unwrap();
        let force = recording.quality.signal(Signal::Force).unwrap();
        assert_eq!((force.samples, force.not_finite), (ROWS as u64, 1));
        // In the first row, too.
        let text = format!("t;x;u\n{rows}").replacen(&format!("{:.6}", values(0).1), word, 1);
        assert_eq!(read("t.csv", &text, &said).unwrap().trace.len(), ROWS);
    }
    // What programs write for no number needs no word.
    for word in ["1.#QNAN", "nan(ind)", "#WERT!", "<NA>", "?", "\u{221e}"] {
        let text = format!("t;x;u\n{rows}").replacen(&format!("{:.6}", values(50).1), word, 1);
        let recording = read("t.csv", &text, MAPPING).unwrap();
        let force = recording.quality.signal(Signal::Force).unwrap();
        assert_eq!((force.samples, force.not_finite), (ROWS as u64, 1), "{word}");
    }
}

#[test]
fn times_of_day_with_a_third_colon_and_durations_are_read() {
    let times: [&dyn Fn(usize) -> String; 5] = [
        &|k| format!("10:00:00:{k:03}"),
        &|k| format!("23:59:59:{:06}", 1000 * k),
        &|k| format!("00:0{},{:03}", k / 1000, k % 1000),
        &|k| format!("59:12.{:04}", 10 * k),
        &|k| format!("{} days 00:00:00.{k:03}000", 3),
    ];
    for time in times {
        let row = |k: usize| format!("{};{:.8};{:.6}\n", time(k), values(k).0, values(k).1);
        let text = format!("t;x;u\n{}", (0..ROWS).map(row).collect::<String>());
        assert_read("t.csv", text, MAPPING, ROWS);
    }
}

#[test]
fn rows_that_begin_with_a_word_end_a_table() {
    let rows = rows(",", '.', "\n");
    for (footer, count) in [
        ("\nMin,-3.32,-20.4\nMax,50.0,19.2\nMean,20.1,0.01\n", 3),
        ("Statistics\nsum,1,2\n", 2),
        ("average,1.5,2.5\nwritten by,a logger,x\n7\n", 3),
    ] {
        let recording = assert_read("t.csv", format!("t,x,u\n{rows}{footer}"), MAPPING, ROWS);
        let notes = &recording.quality.notes;
        assert!(
            matches!(notes.as_slice(), [SignalNote::RowsLeftOut { rows, .. }] if *rows == count),
            "{footer}: {notes:?}"
        );
    }
    // Where rows follow it is an error as anywhere.
    let reported = error(format!("t,x,u\n{rows}Min,-3.32,-20.4\n9.0,1.0,2.0\n"), MAPPING);
    assert!(reported.contains("line 202: \"Min\" in column 1 (t)"), "{reported}");
    // The first column may be text that the mapping does not use.
    let marked: String = rows
        .lines()
        .enumerate()
        .map(|(k, row)| format!("{},{row}\n", if k % 50 == 7 { "mark" } else { "0" }))
        .collect();
    assert_read("t.csv", format!("event,t,x,u\n{marked}"), MAPPING, ROWS);
    // Settings between captures belong to none of them.
    let block =
        |x: f64| format!("Channels,2\nSamples,40,40\nUnit,m,N\nt,x,u\n{}", capture(40, x, 0.0));
    let text = format!("{}\n{}", block(0.0), block(0.2));
    assert_eq!(captures("b.csv", &text).unwrap(), [(40, 0.0), (40, 0.2)]);
    assert!(error(&text, MAPPING).contains("--split"));
}

#[test]
fn a_few_rows_with_names_of_their_own_are_settings() {
    let rows = rows(",", '.', "\n");
    for settings in [
        "Start,Speed,Limit\n10,100,50\n",
        "Channel,Slope,Offset\n1,0.5,0\n2,1.5,0.1\n3,1,0\n\n",
        "Kp,Ki,Kd\n1.0,2.0,3.0\n\nLow,High,Rate\n5,6,7\n\n",
        "Rig,4\nGain,1.5,2.5,3.5\n1,2,3\nCalibration,0.1\n\n\n",
    ] {
        assert_read("t.csv", format!("{settings}t,x,u\n{rows}"), MAPPING, ROWS);
    }
    // Rows that may go on, or as many as a recording has, are another capture.
    let many: String = (0..30).map(|k| format!("{k},1,2\n")).collect();
    for text in
        [format!("a,b,c\n-2,1,2\n-1,1,2\nt,x,u\n{rows}"), format!("a,b,c\n{many}t,x,u\n{rows}")]
    {
        let by_number = "signals: {time: {column: 1}, position: {column: 2}, force: {column: 3}}";
        let reported = error(&text, by_number);
        assert!(
            reported.contains("names_in_line: ") && reported.contains("data_from_line: "),
            "{reported}"
        );
    }
}

#[test]
fn a_file_that_is_no_text_is_told_by_what_it_is() {
    let zeros: Vec<u8> = (0..2000_u32).flat_map(|k| (0.1 * f64::from(k)).to_le_bytes()).collect();
    let begins: [(&[u8], &str); 9] = [
        (b"PK\x03\x04\x14\0", "save the sheet as CSV"),
        (b"\x1f\x8b\x08\0", "gzip"),
        (b"TDSm\x0e\0\0\0", "TDMS"),
        (b"MDF     4.10", "MDF"),
        (b"\x89HDF\r\n\x1a\n", "HDF5"),
        (b"SQLite format 3\0", "SQLite"),
        (b"%PDF-1.7\n", "PDF"),
        (b"\x93NUMPY\x01\0", ".npy"),
        (b"\x7fELF", "not a text file"),
    ];
    for (begin, what) in begins {
        let bytes = [begin, &zeros].concat();
        let reported = error(&bytes, MAPPING);
        assert!(reported.contains(what) && reported.contains("table.csv"), "{what}: {reported}");
        // A bag may be an SQLite database.
        let reported = Proposal::of(&file("a.dat", &bytes).path).unwrap_err().to_string();
        assert!(
            reported.contains(what) || reported.contains("a recording already"),
            "{what}: {reported}"
        );
    }
    // What fills up a block at the end, or a field of settings, is no binary file.
    let rows = rows(",", '.', "\n");
    let filled = [format!("Rig\0\0\0\0\nt,x,u\n{rows}").as_bytes(), &[0; 4096]].concat();
    assert_read("t.csv", filled, MAPPING, ROWS);
}

#[test]
fn a_refused_import_leaves_nothing_and_touches_nothing_of_others() {
    let lines = rows(",", '.', "\n");
    let mut broken: Vec<&str> = lines.lines().collect();
    broken.insert(ROWS / 2, "0.1,words,1.0");
    let file = file("t.csv", format!("t,x,u\n{}\n", broken.join("\n")));
    let mapping = Mapping::from_yaml(MAPPING, "m.yaml").unwrap();
    let out = file.path.with_file_name("bag");
    let reported = import(&file.path, &mapping, &BTreeMap::new(), &out, &mut |_| ()).unwrap_err();
    assert!(reported.to_string().contains("\"words\""), "{reported}");
    assert!(!out.exists());
    // What is there already stays as it is.
    std::fs::create_dir(&out).unwrap();
    std::fs::write(out.join("thesis.txt"), "mine").unwrap();
    assert!(import(&file.path, &mapping, &BTreeMap::new(), &out, &mut |_| ()).is_err());
    assert_eq!(std::fs::read_to_string(out.join("thesis.txt")).unwrap(), "mine");
    // Nor is a table without times a recording.
    let timeless: String =
        lines.lines().map(|l| format!(",{}\n", l.split_once(',').unwrap().1)).collect();
    let file = self::file("t.csv", format!("t,x,u\n{timeless}"));
    let out = file.path.with_file_name("timeless");
    let reported = import(&file.path, &mapping, &BTreeMap::new(), &out, &mut |_| ()).unwrap_err();
    assert!(reported.to_string().contains("signals.time"), "{reported}");
    assert!(!out.exists());
}

#[test]
fn exponents_in_a_row_are_words() {
    let text = format!("t,x,u\n{}0.5,1{},0\n", rows(",", '.', "\n"), "d-1".repeat(300_000));
    assert!(error(text, MAPPING).contains("column 2"));
}

#[test]
fn an_error_of_a_spreadsheet_in_the_first_column_is_no_comment() {
    let row = |k: usize| {
        let (x, u) = values(k);
        let first = if k % 3 == 1 { "#DIV/0!".to_owned() } else { format!("{u:.6}") };
        format!("{first},{:.3},{x:.9}\n", k as f64 / RATE)
    };
    let text = format!("u,t,x\n{}", (0..ROWS).map(row).collect::<String>());
    let recording = read("t.csv", text, MAPPING).unwrap();
    assert_eq!(recording.trace.len(), ROWS);
    assert!((recording.trace.position[1] - values(1).0).abs() < 1e-8);
}

#[test]
fn rows_above_a_table_are_told() {
    let text = format!("a,b,c\n1,2,3\n4,5,6\nt,x,u\n{}", rows(",", '.', "\n"));
    let notes = read("t.csv", text, MAPPING).unwrap().quality.notes;
    assert_eq!(notes, [SignalNote::RowsLeftOut { rows: 2, first_line: 2 }]);
}

#[test]
fn of_several_rates_that_of_the_samples_counts_and_a_time_stays() {
    let rows: String =
        (0..ROWS).map(|k| format!("{:.9};{:.9}\n", values(k).0, values(k).1)).collect();
    let stated = |above: &str| {
        let file = file("t.csv", format!("{above}\nposition [m];force [N]\n{rows}"));
        Proposal::of(&file.path).unwrap().stated_rate.map(|(rate, _)| rate)
    };
    assert_eq!(stated("Baud rate: 115200\nSample rate: 2000 Hz"), Some(2000.0));
    assert_eq!(stated("Baud rate: 115200\nPWM frequency: 16000 Hz"), Some(1000.0));
    let (t, x, u) = (&|k: usize| k as f64, &|k: usize| values(k).0, &|k: usize| values(k).1);
    let proposal = proposal_of("PWM frequency: 16000 Hz\ntime;position [m];force [N]", &[t, x, u]);
    assert_eq!(column_of(&proposal, Signal::Time), Some(1), "{proposal:#?}");
}

#[test]
fn marks_are_comments_and_no_part_of_a_name() {
    let marks = |text: &str| Mapping::from_yaml(text, "m.yaml").unwrap().unconfirmed;
    let with = |position: &str| format!("rate: 10\nsignals:\n  position: {position}\n");
    assert_eq!(marks(&with("{column: \"x # CHECK: unit\", unit: mm}")), Vec::<String>::new());
    assert_eq!(marks(&with("{column: 2, unit: mm}   # mm, as they say")), Vec::<String>::new());
    for comment in ["# CHECK: mm?", "#CHECK mm?", "#  CHECK: mm?"] {
        let text = with(&format!("{{column: \"it's x\", unit: mm}}   {comment}"));
        assert_eq!(marks(&text), ["position: mm?"], "{comment}");
    }
}

#[test]
fn many_columns_with_times_of_their_own_are_looked_at_in_time() {
    let names: Vec<String> = (0..2000).map(|k| format!("t_{k} [s],x_{k} [mm]")).collect();
    let row = |k: usize| vec![format!("{:.3},{:.3}", k as f64 / RATE, values(k).0); 2000].join(",");
    let text: String = (0..6).map(|k| row(k) + "\n").collect();
    let file = file("t.csv", format!("{}\n{text}", names.join(",")));
    let proposal = Proposal::of(&file.path).unwrap();
    assert_eq!(proposal.columns.len(), 4000);
}

#[test]
fn where_no_name_says_a_motion_one_is_proposed_by_how_it_moves() {
    // A time, noise, the position, and a force that steps; a second clock, and what is asked for.
    let row = |k: usize| {
        let (noise, (x, u)) = ((7919 * k % 101) as f64 / 50.0, values(k));
        let (step, clock) = (15.0 * u.signum() + noise, 17 + 2 * k);
        format!(
            "{:.3},{noise:.3},{:.6},{step:.6},{clock},{:.6}\n",
            k as f64 / RATE,
            1e3 * x,
            0.9 * x
        )
    };
    let rows: String = (0..ROWS).map(row).collect();
    for names in [
        "(Time),(A1),(A2),(A3),(A4),(target)",
        "Zeit,Kanal 1,Kanal 2,Kanal 3,Kanal 4,Sollwert",
        "t,one,two,three,four,command",
    ] {
        let table = file("t.csv", format!("{names}\n{rows}"));
        let proposal = Proposal::of(&table.path).unwrap();
        assert!(proposal.is_motion_guessed, "{names}");
        let position = proposal.signals.iter().find(|s| s.signal == Signal::Position).unwrap();
        let check = position.check.as_deref().unwrap();
        assert_eq!(position.column, 3, "{names}: {position:?}");
        assert!(check.contains("most like a position") && check.contains("or is it"), "{check}");
        // The mapping is whole, and what it lacks can be written where it says so.
        let yaml = proposal.to_yaml("t.csv", &[]);
        Mapping::from_yaml(&yaml, "proposed").unwrap();
        let force = yaml.lines().find(|line| line.starts_with("  # force: ")).unwrap();
        let name = names.split(',').nth(3).unwrap();
        let said = force.replacen("# ", "", 1).replace("NAME", &format!("\"{name}\""));
        let mapping = Mapping::from_yaml(&yaml.replace(force, &said), "proposed").unwrap();
        assert!(mapping.signals.contains_key(&Signal::Force), "{said}");
    }
    // Channels of an oscilloscope: the motion is sought before the force.
    let volts: String = (0..ROWS)
        .map(|k| {
            let (x, u) = values(k);
            format!("{:.3},{:.6},{:.3}\n", k as f64 / RATE, 1e3 * x, 15.0 * u.signum())
        })
        .collect();
    let scope = file("t.csv", format!("x-axis,A,B\nsecond,Volt,Volt\n{volts}"));
    let proposal = Proposal::of(&scope.path).unwrap();
    let place = |signal| proposal.signals.iter().find(|s| s.signal == signal).map(|s| s.column);
    assert_eq!((place(Signal::Position), place(Signal::Force)), (Some(2), Some(3)));
    // Names in brackets are names and no units.
    let text = format!("(T),(A),(X),(F),(C),(R)\n{rows}");
    let proposal = Proposal::of(&file("t.csv", text).path).unwrap();
    let position = proposal.signals.iter().find(|s| s.signal == Signal::Position).unwrap();
    assert_eq!((position.column, proposal.is_motion_guessed), (3, false));
    assert!(position.check.as_deref().unwrap().contains("gives no unit"), "{position:?}");
    // Where nothing moves there is a mapping all the same, which says what it lacks.
    let still: String = (0..ROWS).map(|k| format!("{:.3},1.5\n", k as f64 / RATE)).collect();
    let proposal = Proposal::of(&file("t.csv", format!("t,a\n{still}")).path).unwrap();
    assert!(!proposal.has_motion());
    assert!(proposal.to_yaml("t.csv", &[]).contains("# CHECK: no column moves"), "{proposal:?}");
}

#[test]
fn thousands_next_to_decimal_marks_are_in_doubt() {
    // Three digits behind a point in every row, and decimal commas elsewhere.
    let row = |k: usize, x: &str| {
        let row = format!("{:.3};{x};{:.6}\n", k as f64 / RATE, values(k).1);
        row.replace('.', ",").replace('_', ".")
    };
    let table = |x: &dyn Fn(usize) -> String| {
        let rows: String = (0..ROWS).map(|k| row(k, &x(k))).collect();
        file("t.csv", format!("t [s];x [mm];u [N]\n{rows}"))
    };
    let named = "signals: {time: {column: 1}, position: {column: 2, unit: mm}, force: {column: 3}}";
    let notes = |file: &File, mapping: &str| {
        let mapping = Mapping::from_yaml(mapping, "mapping.yaml").unwrap();
        load(&file.path, Some(&mapping)).unwrap().quality.notes
    };
    let doubt = SignalNote::ThousandsInDoubt { signal: Signal::Position, is_comma: false };
    let in_doubt = table(&|k| format!("{}_{:03}", 10 + k % 3, 5 * k));
    let proposal = Proposal::of(&in_doubt.path).unwrap();
    let position = proposal.signals.iter().find(|s| s.signal == Signal::Position).unwrap();
    let check = position.check.as_deref().unwrap();
    assert_eq!((position.scale, check.contains("1.234")), (Some(1.0), true), "{check}");
    assert!(notes(&in_doubt, named).contains(&doubt));
    assert!(!notes(&in_doubt, &named.replace("mm}", "mm, scale: 1}")).contains(&doubt));
    // One number that is read in one way only settles it.
    for sure in ["950", "12_345_678", "1_200,5"] {
        let settled = table(&|k| match k {
            7 => sure.to_owned(),
            k => format!("{}_{:03}", 10 + k % 3, 5 * k),
        });
        assert!(!notes(&settled, named).contains(&doubt), "{sure}");
        let proposal = Proposal::of(&settled.path).unwrap();
        assert!(!proposal.signals.iter().any(|found| found.scale.is_some()), "{sure}");
    }
    // The other way round: thousands commas in quotes, next to decimal points.
    let rows: String =
        (0..ROWS).map(|k| format!("{:.3},\"{},{k:03}\"\n", k as f64 / RATE, 10 + k % 3)).collect();
    let quoted = file("t.csv", format!("t,x\n{rows}"));
    let doubt = SignalNote::ThousandsInDoubt { signal: Signal::Position, is_comma: true };
    assert!(notes(&quoted, "signals: {time: {column: 1}, position: {column: 2}}").contains(&doubt));
}

/// A word for a missing value may be a number, in a column of whole times, too.
#[test]
fn a_number_that_stands_for_a_missing_time_is_none() {
    let row = |k: usize| {
        let time = if k == 50 { "-1".to_owned() } else { k.to_string() };
        format!("{time};{:.8};{:.6}\n", values(k).0, values(k).1)
    };
    let text = format!("t;x;u\n{}", (0..ROWS).map(row).collect::<String>());
    let mapping = MAPPING.replace("column: t", "column: t, unit: ms");
    let reported = error(text, &format!("csv: {{missing: [\"-1\"]}}\n{mapping}"));
    assert!(reported.contains("sample 51 has none"), "{reported}");
}

#[test]
fn seconds_and_nanoseconds_in_columns_of_their_own_are_one_time() {
    for (whole, part) in [
        ("sec", "nanosec"),
        ("/joint_states/header/stamp/sec", "/joint_states/header/stamp/nanosec"),
        (".header.stamp.secs", ".header.stamp.nsecs"),
    ] {
        let begin = 1_717_000_000_u64 * 1_000_000_000 + 900_000_000;
        let rows: String = (0..ROWS)
            .map(|k| {
                let (stamp, (x, u)) = (begin + 1_000_000 * k as u64, values(k));
                let (seconds, rest) = (stamp / 1_000_000_000, stamp % 1_000_000_000);
                format!("{seconds},{rest},x_axis,{x:.8},{u:.6}\n")
            })
            .collect();
        let table = file("joint.csv", format!("{whole},{part},frame_id,position,effort\n{rows}"));
        let proposal = Proposal::of(&table.path).unwrap();
        let yaml = proposal.to_yaml("joint.csv", &[]);
        assert!((proposal.rate_hz.unwrap() - RATE).abs() < 1e-3, "{yaml}");
        let recording =
            load(&table.path, Some(&Mapping::from_yaml(&yaml, "proposed").unwrap())).unwrap();
        assert_eq!(recording.trace.len(), ROWS, "{yaml}");
        assert!((recording.trace.time[ROWS - 1] - 0.199).abs() < 1e-12);
        assert_eq!(recording.trace.position[7], values(7).0);
    }
    let wrong = |text: &str| Mapping::from_yaml(text, "m.yaml").unwrap_err().to_string();
    let reported = wrong("signals: {time: {column: s, plus: ns}, position: {column: x}}");
    assert!(reported.contains("plus_unit: ns"), "{reported}");
    let reported = wrong("signals: {position: {column: x, plus: y, plus_unit: ns}}");
    assert!(reported.contains("`plus` adds a column of times"), "{reported}");
    let reported =
        wrong("signals: {time: {column: s, plus: y, plus_unit: mm}, position: {column: x}}");
    assert!(reported.contains("must be one of time"), "{reported}");
}

#[test]
fn clocks_of_windows_unnamed_stamps_and_tables_that_lie_on_their_side_are_told() {
    let table = |head: &str, time: &dyn Fn(usize) -> String| {
        let row = |k: usize| format!("{},{:.8},{:.6}\n", time(k), values(k).0, values(k).1);
        file("t.csv", format!("{head}{}", (0..ROWS).map(row).collect::<String>()))
    };
    let read = |table: &File| {
        let proposal = Proposal::of(&table.path).unwrap();
        let yaml = proposal.to_yaml("t.csv", &[]);
        let recording = load(&table.path, Some(&Mapping::from_yaml(&yaml, "p").unwrap())).unwrap();
        (proposal, recording)
    };
    // Ticks of 100 ns since 1601 and since the year 1.
    for begin in [133_612_345_678_901_234_u64, 638_500_000_000_000_000] {
        let ticks = table("ts,x [m],u [N]\n", &|k| (begin + 10_000 * k as u64).to_string());
        let (proposal, recording) = read(&ticks);
        assert!((recording.rate - RATE).abs() < 1.0, "{} Hz", recording.rate);
        assert!(proposal.checks()[0].1.contains("100 ns"), "{:?}", proposal.checks());
    }
    // Messages as `ros2 topic echo --csv` prints them.
    let stamp = |k: usize| format!("{},{}", 17 + (900 + k) / 1000, (900 + k) % 1000 * 1_000_000);
    let (proposal, recording) = read(&table("", &stamp));
    assert_eq!(recording.trace.len(), ROWS);
    assert!((recording.trace.time[ROWS - 1] - 0.199).abs() < 1e-12);
    assert!(proposal.checks()[0].1.contains("nanoseconds"), "{:?}", proposal.checks());
    // Seconds and milliseconds, or turns and counts, are not.
    for parts in [1000, 4096] {
        let table = table("", &|k| format!("{},{}", (990 + k) / parts, (990 + k) % parts));
        let proposal = Proposal::of(&table.path).unwrap();
        assert!(proposal.signals.iter().all(|found| found.plus.is_none()), "{parts}");
    }
    // The unit of a horizontal axis is of no other column.
    let scope = "Model,A1\nHorizontal Units,s\nSample Interval,1e-03\n\nTIME,CH1,CH2\n";
    let scope = table(scope, &|k| format!("{:.3}", k as f64 / RATE));
    let proposal = Proposal::of(&scope.path).unwrap();
    assert_eq!((proposal.units_line, proposal.columns[1].unit.as_str()), (None, ""));
    // A signal in each row.
    let turned = |of: &dyn Fn(usize) -> f64| -> String {
        (0..ROWS).map(|k| format!(",{:.6}", of(k))).collect()
    };
    let (x, u) = (turned(&|k| values(k).0), turned(&|k| values(k).1));
    let proposal = Proposal::of(&file("t.csv", format!("x{x}\nu{u}\n")).path).unwrap();
    let checks = proposal.checks();
    assert!(checks.iter().any(|(_, check)| check.contains("turn the table round")), "{checks:?}");
    // What is no table is quoted.
    let lines: String = (0..9).map(|k| format!("{{\"t\": {k}, \"x\": {k}}}\n")).collect();
    let reported = Proposal::of(&file("t.csv", lines).path).unwrap_err().to_string();
    assert!(reported.contains("line 9 is `{\"t\": 8"), "{reported}");
}

/// Times in whole digits that are no small part of the period: the rate is that of the samples, and
/// each value stands in the row of its number.
#[test]
fn a_uniform_rate_shows_behind_times_that_are_rounded() {
    let motion = |time: f64| 0.0446 * (3.0 * time).sin() + 0.002 * (11.0 * time).cos();
    let table = |rate: f64, decimals: usize, keep: &dyn Fn(usize) -> bool| -> String {
        let rows = (0..1200).filter(|k| keep(*k)).map(|k| {
            let time = k as f64 / rate;
            format!("{time:.decimals$},{:.8},{:.4}\n", motion(time), (5.0 * time).sin())
        });
        format!("t,x,u\n{}", rows.collect::<String>())
    };
    for (rate, decimals) in [
        (256.0, 3),
        (60.0, 3),
        (150.0, 3),
        (240.0, 3),
        (300.0, 3),
        (400.0, 3),
        (488.28125, 3),
        (600.0, 3),
        (700.0, 4),
        (1200.0, 4),
        (3000.0, 4),
        (8192.0, 5),
        (256.0, 4),
        (1000.0, 3),
    ] {
        let recording = read("t.csv", table(rate, decimals, &|_| true), MAPPING).unwrap();
        assert!((recording.rate / rate - 1.0).abs() < 1e-3, "{rate} Hz: {}", recording.rate);
        assert_eq!(recording.trace.len(), 1200, "{rate} Hz, {decimals} decimals");
        for k in [0, 1, 2, 599, 1198, 1199] {
            let (is, was) = (recording.trace.position[k], motion(k as f64 / rate));
            assert!((is - was).abs() < 1e-7, "{rate} Hz, row {k}: {is} {was}");
        }
    }
    // Samples that are missing from a uniform clock are no slower clock.
    let missing =
        |k: usize| k < 2 || !(7919 * k).is_multiple_of(13) && !(104_729 * k).is_multiple_of(5);
    let recording = read("t.csv", table(1000.0, 3, &missing), MAPPING).unwrap();
    assert!((recording.rate - 1000.0).abs() < 1e-6, "{} Hz", recording.rate);
    assert_eq!(recording.trace.len(), 1200);
}

#[test]
fn what_a_table_does_not_say_is_asked() {
    let checks = |text: String| -> (Vec<String>, Proposal) {
        let proposal = Proposal::of(&file("t.csv", text).path).unwrap();
        let checks = proposal.checks();
        let said = checks.iter().map(|(key, check)| format!("{key}: {check}")).collect();
        (said, proposal)
    };
    let has = |checks: &[String], words: &str| checks.iter().any(|check| check.contains(words));
    let rows = |of: &dyn Fn(usize) -> String| -> String {
        (0..ROWS).map(|k| format!("{:.3},{}\n", k as f64 / RATE, of(k))).collect()
    };
    let row = |k: usize| format!("{:.5},{:.5}", 1e3 * values(k).0, values(k).1);
    // An error of following in the words of any language, next to its reference.
    let error = |k: usize| format!("{:.5},{:.5},1.5", 1e-3 * row_of(k), row_of(k));
    for name in ["Droop [mm]", "位置偏差 [mm]", "PE [mm]"] {
        let head = format!("t [s],{name},Command position [mm],F [N]\n");
        let (said, _) = checks(format!("{head}{}", rows(&error)));
        assert!(has(&said, "of the reference only"), "{name}: {said:?}");
    }
    // A second position, whatever it is called.
    let two = |k: usize| format!("{:.5},{:.5}", 1e3 * values(k).0, 1.001e3 * values(k).0);
    let head = "t [s],Motor encoder [mm],Linear scale [mm]\n";
    let (said, _) = checks(format!("{head}{}", rows(&two)));
    assert!(has(&said, "or is it `Linear scale [mm]`"), "{said:?}");
    // Factors above the rows.
    let (said, _) = checks(format!("t,x,u\ns,mm,N\nScaleFactor,0.001,0.1\n{}", rows(&row)));
    assert!(has(&said, "factors or offsets"), "{said:?}");
    // More names than columns.
    let (said, _) = checks(format!("Index,Time [s],Pos [mm],Force [N]\n{}", rows(&row)));
    assert!(has(&said, "4 names for 3 columns"), "{said:?}");
    // Behind a time they stand in order.
    let (said, proposal) = checks(format!("Time [s],Pos [mm],Force [N],Remark\n{}", rows(&row)));
    assert_eq!((said.as_slice(), proposal.columns[1].name.as_str()), (&[][..], "Pos [mm]"));
    // A label in front of the names is no name.
    let text = format!("# fields: t x u\n{}", rows(&row).replace(',', " "));
    let (_, proposal) = checks(text);
    assert_eq!(proposal.columns[1].name, "x");
    // The first row may be the names of a table without names.
    let (said, _) = checks(format!("0,1,2\n{}", rows(&row)));
    assert!(has(&said, "counts the columns"), "{said:?}");
    // Cells that are blank where blanks separate.
    let blank = |k: usize| match k % 3 {
        0 => format!("{:.3}  {:.5}  20.5  {:.5}\n", k as f64 / RATE, row_of(k), values(k).1),
        _ => format!("{:.3}  {:.5}        {:.5}\n", k as f64 / RATE, row_of(k), values(k).1),
    };
    let text: String = (0..ROWS).map(blank).collect();
    let (said, _) = checks(format!("t  x  temp  u\n{text}"));
    assert!(has(&said, "where a cell is blank"), "{said:?}");
    // Rows of several joints, or of several signals.
    for (name, words) in [("joint", ["x_axis", "gripper"]), ("topic", ["/a/position", "/a/effort"])]
    {
        let of = |k: usize| format!("{},{:.5}", words[k % 2], row_of(k));
        let (said, _) = checks(format!("t [s],{name},value [mm]\n{}", rows(&of)));
        assert!(has(&said, words[1]) && has(&said, "files of their own"), "{said:?}");
    }
    let constant = |k: usize| format!("x_axis,{:.5}", row_of(k));
    let (said, _) = checks(format!("t [s],joint,value [mm]\n{}", rows(&constant)));
    assert!(!has(&said, "files of their own"), "{said:?}");
    // Names that are numbers are written as numbers of columns.
    let text =
        format!("t,2,1\ns,N,mm\n{}", rows(&|k| format!("{:.5},{:.5}", values(k).1, row_of(k))));
    let (_, proposal) = checks(text.clone());
    let mapping = Mapping::from_yaml(&proposal.to_yaml("t.csv", &[]), "p").unwrap();
    let recording = load(&file("t.csv", text).path, Some(&mapping)).unwrap();
    assert!((recording.trace.position[7] - values(7).0).abs() < 1e-8);
    // A torque next to a position in mm needs a factor, and the mapping can be read as it is.
    let (said, proposal) = checks(format!("t [s],x [mm],Torque [Nm]\n{}", rows(&row)));
    assert!(has(&said, "N per Nm"), "{said:?}");
    let yaml = proposal.to_yaml("t.csv", &[]);
    let mapping = Mapping::from_yaml(&yaml, "p").unwrap();
    assert_eq!(mapping.joint_type, Some(JointType::Prismatic), "{yaml}");
}

/// Position of row `k`, mm.
fn row_of(k: usize) -> f64 {
    1e3 * values(k).0
}

#[test]
fn tables_of_thousands_of_columns_are_looked_at_in_a_moment() {
    let line = |name: &str| -> String {
        (0..20_000)
            .map(|k| format!(",{:.3}", f64::from(k) * 1e-3))
            .fold(name.to_owned(), |a, b| a + &b)
    };
    let text = format!("{}\n{}\n{}\n", line("Time [s]"), line("Pos [mm]"), line("Force [N]"));
    let proposal = Proposal::of(&file("wide.csv", text).path).unwrap();
    assert!(proposal.checks().iter().any(|(_, check)| check.contains("turn the table round")));
}
