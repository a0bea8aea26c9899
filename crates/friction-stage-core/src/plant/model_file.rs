//! Model files, checked whole: the effects of a model are known to the plant only.

use std::path::Path;

use super::effects::Effects;
use crate::model::{ModelError, StageModel};

/// As [`StageModel::named`]; impossible effects are refused, too.
pub fn model_named(name: &str) -> Result<StageModel, ModelError> {
    with_possible_effects(StageModel::named(name)?, name)
}

/// As [`StageModel::load`]; impossible effects are refused, too.
pub fn load_model(path: &Path) -> Result<StageModel, ModelError> {
    with_possible_effects(StageModel::load(path)?, &path.display().to_string())
}

fn with_possible_effects(model: StageModel, origin: &str) -> Result<StageModel, ModelError> {
    match Effects::new(&model.effects) {
        Ok(_) => Ok(model),
        Err(source) => {
            Err(ModelError::InFile { origin: origin.to_owned(), source: Box::new(source) })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_impossible_effect_is_refused_with_the_name_of_the_file() {
        let path = std::env::temp_dir().join(format!("effects-{}.yaml", std::process::id()));
        std::fs::write(&path, "effects:\n- cogging: {amplitude: 5}\n").unwrap();
        let name = path.display().to_string();
        for error in [model_named(&name).unwrap_err(), load_model(&path).unwrap_err()] {
            let reported = error.to_string();
            assert!(reported.starts_with(&format!("{name}: effects.cogging")), "{reported}");
        }
        std::fs::write(&path, "effects:\n- cogging: {amplitude: 5, period: 0.02}\n").unwrap();
        assert_eq!(load_model(&path).unwrap().effects.len(), 1);
        std::fs::remove_file(path).unwrap();
    }
}
