//! The files of `launch_config/` are ones that the nodes take.

use std::path::{Path, PathBuf};

use friction_stage::node::arguments::RosArguments;
use friction_stage::node::parameters::{ParameterSet, ParameterSpec};
use friction_stage::node::{controller_settings, stage_settings};
use friction_stage_core::model::StageModel;
use friction_stage_core::plant::{Rates, Stage};

fn files(ending: &str) -> Vec<PathBuf> {
    let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("launch_config");
    let mut found: Vec<PathBuf> =
        std::fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path()).collect();
    found.retain(|path| path.to_str().unwrap().ends_with(ending));
    found.sort();
    found
}

#[test]
fn every_model_file_is_a_stage_that_moves() {
    let models: Vec<PathBuf> = files(".yaml")
        .into_iter()
        .filter(|path| {
            let name = path.file_name().unwrap().to_str().unwrap();
            name.starts_with("stage_") && !name.contains("params")
                || name.starts_with("measuring_rig")
        })
        .collect();
    assert!(models.len() >= 6, "{models:?}");
    for path in models {
        let model = StageModel::load(&path).unwrap_or_else(|error| panic!("{error}"));
        let rates = Rates::new(4000.0, 80_000.0).unwrap();
        let mut stage = Stage::new(&model, rates, 1)
            .unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        (0..400).for_each(|_| stage.advance(100.0));
        assert!(stage.state().position > 1e-4, "{}: {:?}", path.display(), stage.state());
    }
}

fn declare(path: &Path, node: &str, specs: Vec<ParameterSpec>) -> ParameterSet {
    let line = ["--ros-args", "--params-file", path.to_str().unwrap()].map(str::to_owned);
    let (arguments, _) =
        RosArguments::parse(line.into_iter()).unwrap_or_else(|error| panic!("{error}"));
    ParameterSet::declare(specs, &arguments.parameters_for(node))
        .unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn parameter_files_hold_parameters_that_the_nodes_have() {
    for path in files("params.yaml") {
        stage_settings::StageSettings::new(&declare(&path, "/stage", stage_settings::specs()))
            .unwrap();
        let controller = declare(&path, "/controller", controller_settings::specs());
        controller_settings::settings(&controller).check().unwrap();
    }
}

#[test]
fn reference_parameter_files_list_every_parameter_with_its_default() {
    let tables = [
        ("stage_params.yaml", "/stage", stage_settings::specs()),
        ("controller_params.yaml", "/controller", controller_settings::specs()),
    ];
    for (file, node, specs) in tables {
        let path = files(file).remove(0);
        let line = ["--ros-args", "--params-file", path.to_str().unwrap()].map(str::to_owned);
        let given = RosArguments::parse(line.into_iter()).unwrap().0.parameters_for(node);
        // What follows from the bandwidth must not be given beside it.
        for spec in specs.iter().filter(|spec| !controller_settings::DERIVED.contains(&spec.name)) {
            let found =
                given.get(spec.name).unwrap_or_else(|| panic!("{file} lacks {}", spec.name));
            // Numbers in the file are rounded for people.
            match (&found.value, &spec.default) {
                (
                    ros2_client::ParameterValue::Double(a),
                    ros2_client::ParameterValue::Double(b),
                ) => {
                    assert!(
                        (a - b).abs() <= 1e-4 * b.abs(),
                        "{file}: {} is {a}, default {b}",
                        spec.name
                    );
                }
                (a, b) => assert_eq!(a, b, "{file}: {}", spec.name),
            }
        }
    }
}
