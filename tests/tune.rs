//! `friction-stage tune` from outside: what it writes is what the node's own parser loads.

use std::path::Path;
use std::process::{Command, Output};

use friction_stage::node::controller_settings;
use friction_stage_core::control::ControllerSettings;
use friction_stage_core::model::StageModel;
use friction_stage_core::plant::Rates;
use friction_stage_lab::{MeasuredLoop, Settings, measure_loop};

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
        let reported = String::from_utf8(run.stderr).unwrap();
        assert!(matches!(run.status.code(), Some(1 | 2)), "{arguments:?}: {reported}");
        assert!(!reported.contains(" { "), "{arguments:?} shows a structure: {reported}");
        for words in expected {
            assert!(reported.contains(words), "{arguments:?} gave {reported:?} without {words:?}");
        }
        assert!(!out.join("controller.yaml").exists());
    }
}

#[test]
fn a_measured_loop_is_shown_next_to_that_of_the_model() {
    let directory = tempfile::tempdir().unwrap();
    let model = StageModel::on_guides("guide_1");
    let lab = Settings { seed: 1, rates: Rates::DEFAULT };
    let settings = ControllerSettings::of_model(&model, 60.0, 4000.0);
    let frequencies = [20.0, 40.0, 60.0, 90.0, 140.0, 220.0, 350.0];
    let points = measure_loop(&model, &lab, &settings, 1e-6, &frequencies).unwrap();
    let measured = MeasuredLoop { settings, force: 20.0, points };
    let file = directory.path().join("loop.json");
    std::fs::write(&file, measured.to_json().unwrap()).unwrap();
    let path = file.to_str().unwrap();
    let out = directory.path().join("out");
    let run = tune(&["guide_1", "--variants", "1", "--measured", path, "--json"], &out);
    assert!(matches!(run.status.code(), Some(0 | 3)), "{run:?}");
    let summary: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
    let found = &summary["measured"];
    let largest = &found["largest_difference"];
    assert!(largest["points"].as_u64().unwrap() >= 5, "{found}");
    assert!(largest["magnitude"].as_f64().unwrap() < 0.02, "{found}");
    assert_eq!(found["points"].as_array().unwrap().len(), 7);
    // The tuned controller keeps its margin on the stage that is the model's.
    assert!(found["tuned_margins"]["modulus_margin"].as_f64().unwrap() > 0.5, "{found}");
    assert!(!summary["warnings"].to_string().contains("does not describe"), "{summary}");
    let page = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert_eq!(page.matches("<svg").count(), 11);
    assert!(out.join("measured_gain.svg").exists() && page.contains("Measured loop"));

    // As text; of another stage the margin is another one, which is said.
    let run =
        tune(&["guide_1", "--variants", "1", "--measured", path], &directory.path().join("t"));
    let text = String::from_utf8(run.stdout).unwrap();
    assert!(text.contains("tuned controller on the measured stage"), "{text}");

    let heavier = StageModel { mass: 2.5 * model.mass, ..model };
    let other = directory.path().join("heavier.yaml");
    std::fs::write(&other, heavier.to_yaml().unwrap()).unwrap();
    let arguments = [other.to_str().unwrap(), "--variants", "1", "--measured", path];
    let run = tune(&arguments, &directory.path().join("of_another"));
    assert_eq!(run.status.code(), Some(3), "{run:?}");
    let text = String::from_utf8(run.stdout).unwrap() + &String::from_utf8(run.stderr).unwrap();
    assert!(text.contains("does not describe the measured one"), "{text}");

    let bad = directory.path().join("bad.json");
    let text = measured.to_json().unwrap().replace("\"rate\": 4000.0", "\"rate\": 8000.0");
    for (text, reported) in [
        ("{}".to_owned(), "bad.json: not a measured loop: the key `schema_version` is missing"),
        (text, "bad.json was measured at 8000 Hz and the application is at 4000 Hz"),
    ] {
        std::fs::write(&bad, text).unwrap();
        let run = tune(&["guide_1", "--measured", bad.to_str().unwrap()], &out);
        let error = String::from_utf8_lossy(&run.stderr).into_owned();
        assert!(run.status.code() != Some(0) && error.contains(reported), "{error}");
    }
}
