//! `friction-stage tune` from outside: what it writes is what the node's own parser loads.

use std::path::Path;
use std::process::{Command, Output};

use friction_stage::node::controller_settings;

fn tune(arguments: &[&str], out: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_friction-stage"))
        .arg("tune")
        .args(arguments)
        .arg("--out")
        .arg(out)
        .output()
        .unwrap()
}

#[test]
fn tuned_gains_are_loaded_by_the_controller_node_and_can_be_compared_again() {
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("tuning");
    let run = tune(&["guide_1", "--variants", "40", "--json"], &out);
    assert!(matches!(run.status.code(), Some(0 | 3)), "{run:?}");
    let summary: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
    let tuned = &summary["tunings"][1];
    assert!(tuned["worst"]["modulus_margin"].as_f64().unwrap() >= 0.5, "{tuned}");
    assert!(tuned["on_variants"]["ratio"].as_f64().unwrap() <= 1.0, "{tuned}");

    let file = out.join("controller.yaml");
    let settings = controller_settings::from_file(&file).unwrap();
    let gains = settings.gains;
    for (name, loaded) in [
        ("p", gains.p),
        ("i", gains.i),
        ("d", gains.d),
        ("lowpass_frequency", gains.lowpass_frequency),
        ("lowpass_damping", gains.lowpass_damping),
    ] {
        // JSON is read to a rounding.
        let written = tuned["gains"][name].as_f64().unwrap();
        assert!((loaded / written - 1.0).abs() < 1e-12, "{name}: {loaded}, {written}");
    }
    assert_eq!(settings.mass_feedforward, 40.0);

    let page = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert_eq!(page.matches("<svg").count(), 9);

    // The same variants, the same gains, the same results.
    let again = directory.path().join("again");
    let compare = ["guide_1", "--variants", "40", "--json", "--compare", file.to_str().unwrap()];
    let run = tune(&compare, &again);
    let summary: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
    assert_eq!(summary["tunings"][2]["on_variants"], summary["tunings"][1]["on_variants"]);
}

#[test]
fn bad_input_is_refused_with_what_is_wrong() {
    let directory = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        let path = directory.path().join(name);
        std::fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let wild = write(
        "wild.yaml",
        "/**:\n  ros__parameters:\n    tuning: gains\n    gains: {stage: {p: 1.0e9, d: 1.0e6}}\n",
    );
    let fine = include_str!("../launch_config/application_fine_step_clean.yaml");
    let slow =
        write("slow.yaml", &fine.replace("bandwidth: 60.0", "bandwidth: 60.0\n  rate: 300.0"));
    let unknown = write("unknown.yaml", "/**:\n  ros__parameters:\n    gain: 1.0\n");
    let cases: [(&[&str], &[&str]); 5] = [
        (&["guide_9"], &["guide_9", "did you mean"]),
        (&["guide_1", "--compare", &wild], &["wild.yaml", "beyond the limit of stability"]),
        (&["guide_1", "--application", &slow], &["300 Hz is too low", "720 Hz"]),
        (&["guide_1", "--compare", &unknown], &["gain"]),
        (&["guide_1", "--delay", "1"], &["between 0 and 0.05"]),
    ];
    for (index, (arguments, expected)) in cases.into_iter().enumerate() {
        let out = directory.path().join(format!("out_{index}"));
        let run = tune(arguments, &out);
        let told = String::from_utf8(run.stderr).unwrap();
        assert!(matches!(run.status.code(), Some(1 | 2)), "{arguments:?}: {told}");
        for words in expected {
            assert!(told.contains(words), "{arguments:?} gave {told:?} without {words:?}");
        }
        assert!(!out.join("controller.yaml").exists());
    }
}
