//! What a stage is: [`StageModel`] says everything about it and is what every other room reads.
//!
//! In comes YAML, out goes a checked description: mass, guides (by catalogue name or inline),
//! effects, motor, force cell, encoder and, for the measuring rig, the flexure coupling. Nothing
//! moves here and nothing reads a clock.

mod catalogue;
mod effect;
mod error;
mod guide;
mod joint;
mod stroke;

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

pub use catalogue::{
    Catalogue, CatalogueEntry, DistributedBristles, EffectiveStiffness, Provenance, Quantity,
};
pub use effect::locate;
pub use effect::{Coordinate, Curve, CurveSide, EffectParameters, Jump, ParameterValue};
pub use error::{ModelError, nearest};
pub use guide::{Guide, GuideSource, PartialGuide};
pub use joint::JointType;
pub use stroke::Stroke;

use crate::numerics::rounded;
use crate::{text_file, yaml};

/// Most guides that one stage may have: the plant integrates this many lanes at once.
pub const MAX_GUIDES: usize = 4;

/// A positioning stage: what the plant integrates, the node runs and identification reads and
/// writes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StageModel {
    /// Name for people; it does not change what the stage does.
    #[serde(default = "default_name")]
    pub name: String,
    /// Whether it moves along an axis or turns about one: then kg is kg m², N is N m, and m is rad
    /// in all that is said here.
    #[serde(default, skip_serializing_if = "JointType::is_prismatic")]
    pub joint: JointType,
    /// Moving mass of the carriage, kg (paper, section 4: 40 kg).
    #[serde(default = "default_mass")]
    pub mass: f64,
    /// One to four guides, each by catalogue name or with its own parameters.
    #[serde(default = "default_guides")]
    pub guides: Vec<GuideSource>,
    /// File with guides of one's own that `guides` may name in addition to the built-in ones,
    /// relative to the model file.
    ///
    /// Reading a model puts their parameters in the place of their names, and nothing here: a model
    /// in memory, in a bag or written by identification needs no other file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub catalogue: Option<PathBuf>,
    /// Effects beyond the LuGre guides, in the order in which they are reported.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub effects: Vec<EffectParameters>,
    /// How far the carriage can go; without it, there is no end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stroke: Option<Stroke>,
    /// The motor.
    #[serde(default)]
    pub motor: Motor,
    /// The force cell.
    #[serde(default)]
    pub force_cell: ForceCell,
    /// The encoder.
    #[serde(default)]
    pub encoder: Encoder,
    /// Present on the measuring rig: motor and carriage are two bodies with a flexure between them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coupling: Option<Coupling>,
}

/// The motor: an ideal force source with a limit, force positive along +x.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Motor {
    /// Largest force in either direction, N. Assumed: the 50 mm move in 100 ms of 40 kg needs 1155
    /// N at its peak.
    pub force_limit: f64,
}

/// The force cell between motor and carriage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ForceCell {
    /// Standard deviation of the reading, N (paper, section 1.2: 0.05 N repeatability; white and
    /// Gaussian is assumed).
    pub noise: f64,
}

/// The linear encoder of the carriage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Encoder {
    /// Size of one count, m (paper, section 1.2: 1 nm); 0 reads without quantisation.
    pub resolution: f64,
    /// Standard deviation before quantisation, m. Assumed: one count.
    pub noise: f64,
}

/// The flexure between motor and carriage of the measuring rig.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Coupling {
    /// Stiffness in driving direction, N/m (paper, section 1.2: about two orders of magnitude above
    /// the guide's Dahl stiffness).
    pub stiffness: f64,
    /// Damping, N s/m. Assumed.
    pub damping: f64,
    /// Moving mass on the motor side, kg. Assumed.
    pub motor_mass: f64,
}

fn default_name() -> String {
    "stage".to_owned()
}

fn default_mass() -> f64 {
    40.0
}

fn default_guides() -> Vec<GuideSource> {
    vec![GuideSource::Catalogue("guide_1".to_owned()); MAX_GUIDES]
}

impl Default for Motor {
    fn default() -> Self {
        Motor { force_limit: 2000.0 }
    }
}

impl Default for ForceCell {
    fn default() -> Self {
        ForceCell { noise: 0.05 }
    }
}

impl Default for Encoder {
    fn default() -> Self {
        Encoder { resolution: 1e-9, noise: 1e-9 }
    }
}

impl Default for StageModel {
    /// The stage of the paper: 40 kg on four guides of type 1.
    fn default() -> Self {
        StageModel {
            name: default_name(),
            joint: JointType::default(),
            mass: default_mass(),
            guides: default_guides(),
            catalogue: None,
            effects: Vec::new(),
            stroke: None,
            motor: Motor::default(),
            force_cell: ForceCell::default(),
            encoder: Encoder::default(),
            coupling: None,
        }
    }
}

impl StageModel {
    /// Stroke of the built-in stages to either side of position 0, m. Assumed: the moves of the
    /// paper are 50 mm long.
    pub const REACH: f64 = 0.4;

    /// The stage of the paper (40 kg, four guides) on one guide type of the catalogue, such as
    /// `guide_2`. It has the stroke of [`StageModel::REACH`] to either side.
    pub fn on_guides(guide: &str) -> StageModel {
        StageModel {
            stroke: Some(Stroke::symmetric(StageModel::REACH)),
            name: format!("stage on {guide}"),
            guides: vec![GuideSource::Catalogue(guide.to_owned()); MAX_GUIDES],
            ..StageModel::default()
        }
    }

    /// The measuring rig of the paper's section 1.2: one guide, a flexure 100 times as stiff as the
    /// guide.
    ///
    /// Masses and flexure damping are assumed: a size-25 carriage with its adapter weighs about 1
    /// kg, the motor's slider 5 kg.
    pub fn measuring_rig(guide: &str) -> Result<StageModel, ModelError> {
        let source = GuideSource::Catalogue(guide.to_owned());
        let stiffness = 100.0
            * source.resolve("guides[0]", &Catalogue::builtin(), JointType::Prismatic)?.stiffness;
        Ok(StageModel {
            name: format!("measuring rig with {guide}"),
            mass: 1.0,
            guides: vec![source],
            coupling: Some(Coupling { stiffness, damping: 300.0, motor_mass: 5.0 }),
            ..StageModel::default()
        })
    }

    /// The same stage or rig on the parallel bristles that the built-in catalogue has of its guide,
    /// `guide` by name (`distributed_bristles` with the LuGre parameters that belong to it).
    fn on_parallel_bristles(self, guide: &str) -> Result<StageModel, ModelError> {
        let (inline, effect) = Catalogue::builtin()
            .distributed_bristles(guide)
            .ok_or_else(|| ModelError::NoParallelBristles { guide: guide.to_owned() })?;
        Ok(StageModel {
            name: self.name + StageModel::PARALLEL_BRISTLES,
            guides: vec![GuideSource::Inline(inline); self.guides.len()],
            effects: vec![effect],
            ..self
        })
    }

    /// Reads and checks a model; `origin` names the text in errors (a bag, a parameter). A text
    /// that is no file opens none: a `catalogue` in it is refused.
    pub fn from_yaml(text: &str, origin: &str) -> Result<StageModel, ModelError> {
        StageModel::read(text, origin, None)
    }

    /// What after the name of a catalogue's guide asks for its bristles in parallel.
    pub const PARALLEL_BRISTLES: &str = "+distributed_bristles";

    /// The model that a user names: a guide of the catalogue for the stage on four of it,
    /// `rig:GUIDE` for the measuring rig with one, either with
    /// [`PARALLEL_BRISTLES`](StageModel::PARALLEL_BRISTLES) after the guide, or a model file. Its
    /// effects are not checked: [`model_named`](crate::plant::model_named) does that, too.
    pub fn named(name: &str) -> Result<StageModel, ModelError> {
        if let Some(plain) = name.strip_suffix(StageModel::PARALLEL_BRISTLES) {
            let guide = plain.strip_prefix("rig:").unwrap_or(plain);
            return StageModel::named(plain)?.on_parallel_bristles(guide);
        }
        if let Some(guide) = name.strip_prefix("rig:") {
            return StageModel::measuring_rig(guide);
        }
        if Catalogue::builtin().entry(name).is_some() {
            return Ok(StageModel::on_guides(name));
        }
        let path = Path::new(name);
        if path.extension().is_none() && path.components().count() == 1 && !path.exists() {
            // Not a file by its looks: the catalogue's error names the nearest model.
            let model = StageModel::on_guides(name);
            model.check().map_err(|error| error.with_nearest_model(name))?;
            return Ok(model);
        }
        StageModel::load(path)
    }

    /// Reads and checks a model file.
    pub fn load(path: &Path) -> Result<StageModel, ModelError> {
        let text = text_file::read(path)
            .map_err(|source| ModelError::Read { path: path.display().to_string(), source })?;
        let origin = path.display().to_string();
        StageModel::read(&text, &origin, path.parent()).map_err(|error| match error {
            // These name a file.
            ModelError::Yaml { .. }
            | ModelError::Empty { .. }
            | ModelError::CatalogueOutsideFile { .. }
            | ModelError::ReadCatalogue { .. }
            | ModelError::EmptyCatalogue { .. }
            | ModelError::DuplicateGuide { .. } => error,
            source => ModelError::InFile { origin, source: Box::new(source) },
        })
    }

    fn read(text: &str, origin: &str, directory: Option<&Path>) -> Result<StageModel, ModelError> {
        // Every key has a default, but a file that was cut off to nothing is no wish for all of
        // them.
        if text
            .lines()
            .all(|line| matches!(line.trim().as_bytes(), [] | [b'#', ..] | b"---" | b"..."))
        {
            return Err(ModelError::Empty { origin: origin.to_owned() });
        }
        let mut model: StageModel = yaml::read(text)
            .map_err(|message| ModelError::Yaml { origin: origin.to_owned(), message })?;
        match (model.catalogue.take(), directory) {
            (Some(path), Some(directory)) => model.guides_from(&directory.join(path))?,
            (Some(path), None) => {
                return Err(ModelError::CatalogueOutsideFile { origin: origin.to_owned(), path });
            }
            (None, _) => {}
        }
        model.check()?;
        Ok(model)
    }

    /// Puts the parameters of a catalogue file in the place of its names.
    fn guides_from(&mut self, path: &Path) -> Result<(), ModelError> {
        let own = Catalogue::load(path)?;
        let mut all = Catalogue::builtin();
        all.add(own.clone(), &path.display().to_string())?;
        for (index, source) in self.guides.iter_mut().enumerate() {
            let guide = source.resolve(&format!("guides[{index}]"), &all, self.joint)?;
            if matches!(source, GuideSource::Catalogue(name) if own.entry(name).is_some()) {
                *source = GuideSource::Inline(guide);
            }
        }
        Ok(())
    }

    /// The model as YAML that [`StageModel::from_yaml`] reads back to the same model.
    pub fn to_yaml(&self) -> Result<String, ModelError> {
        serde_saphyr::to_string(self)
            .map_err(|error| ModelError::Write { message: error.to_string() })
    }

    /// The model without sensor noise and without quantisation, for comparisons with an oracle.
    pub fn without_noise(mut self) -> StageModel {
        self.force_cell.noise = 0.0;
        self.encoder = Encoder { resolution: 0.0, noise: 0.0 };
        self
    }

    /// What the motor moves, kg: the carriage, and with a coupling the motor's own mass.
    pub fn moving_mass(&self) -> f64 {
        self.mass + self.coupling.as_ref().map_or(0.0, |coupling| coupling.motor_mass)
    }

    /// The guides' parameters, catalogue names resolved.
    pub fn resolved_guides(&self) -> Result<Vec<Guide>, ModelError> {
        let catalogue = Catalogue::builtin();
        self.guides
            .iter()
            .enumerate()
            .map(|(index, source)| {
                source.resolve(&format!("guides[{index}]"), &catalogue, self.joint)
            })
            .collect()
    }

    /// Refuses impossible values, with key, value and limit. Effects are checked by the plant,
    /// which knows their bounds.
    pub fn check(&self) -> Result<(), ModelError> {
        error::positive("mass", self.mass)?;
        if self.guides.is_empty() || self.guides.len() > MAX_GUIDES {
            return Err(ModelError::GuideCount { found: self.guides.len() });
        }
        for (index, guide) in self.resolved_guides()?.iter().enumerate() {
            guide.check(&format!("guides[{index}]"))?;
        }
        if let Some(stroke) = &self.stroke {
            stroke.check()?;
        }
        error::positive("motor.force_limit", self.motor.force_limit)?;
        error::not_negative("force_cell.noise", self.force_cell.noise)?;
        error::not_negative("encoder.resolution", self.encoder.resolution)?;
        error::not_negative("encoder.noise", self.encoder.noise)?;
        if let Some(coupling) = &self.coupling {
            error::positive("coupling.stiffness", coupling.stiffness)?;
            error::not_negative("coupling.damping", coupling.damping)?;
            error::positive("coupling.motor_mass", coupling.motor_mass)?;
        }
        Ok(())
    }

    /// What is allowed but deserves a word: what is assumed, and guides that are not passive, each
    /// kind once.
    pub fn notes(&self) -> Result<Vec<String>, ModelError> {
        Ok(self.assumptions().into_iter().chain(self.passivity_note()?).collect())
    }

    /// That some guides are not passive, in one note.
    pub fn passivity_note(&self) -> Result<Option<String>, ModelError> {
        let guides = self.resolved_guides()?;
        let of_note: Vec<(usize, &Guide, f64)> = guides
            .iter()
            .enumerate()
            .filter_map(|(index, guide)| Some((index, guide, guide.passive_above()?)))
            .collect();
        let Some((index, first, _)) = of_note.first() else { return Ok(None) };
        let alike = of_note.iter().all(|(_, guide, _)| guide == first);
        let (which, it) = match (of_note.len(), alike && of_note.len() == guides.len()) {
            (1, _) => (format!("guides[{index}] is"), "it"),
            (_, true) => ("the guides are".to_owned(), "each"),
            (_, false) => {
                let names: Vec<String> =
                    of_note.iter().map(|(index, ..)| format!("guides[{index}]")).collect();
                (format!("{} are", names.join(", ")), "each")
            }
        };
        // One value where they are alike.
        let shown = &of_note[..if alike { 1 } else { of_note.len() }];
        let listed = |of: &dyn Fn(&(usize, &Guide, f64)) -> f64| {
            let values: Vec<String> =
                shown.iter().map(|one| rounded(of(one), 4).to_string()).collect();
            values.join(", ")
        };
        Ok(Some(format!(
            "{which} not passive: viscous_friction is {} {unit}, passive above {} {unit} \
             (bristle_damping (Fs - Fc) / Fc); give {it} a damping_velocity, for example {} {}, to \
             let the bristle damping fade with speed",
            listed(&|one| one.1.viscous_friction),
            listed(&|one| one.2),
            listed(&|one| one.1.stribeck_velocity),
            self.joint.unit("m/s"),
            unit = self.joint.unit("N s/m"),
        )))
    }

    /// What the file does not say of its guides and is assumed, each kind once.
    pub fn assumptions(&self) -> Vec<String> {
        let guides = self.guides.iter().enumerate();
        guides
            .filter(|(index, source)| !self.guides[..*index].contains(source))
            .filter_map(|(index, source)| match source {
                GuideSource::Partial(guide) => {
                    Some(guide.assumption(&format!("guides[{index}]"), self.joint))
                }
                _ => None,
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn default_model_is_the_stage_of_the_paper() {
        let model = StageModel::default();
        assert_eq!(model.mass, 40.0);
        assert_eq!(model.resolved_guides().unwrap().len(), 4);
        model.check().unwrap();
    }

    #[test]
    fn a_guide_is_named_with_its_parallel_bristles() {
        for (name, guides) in
            [("guide_2+distributed_bristles", 4), ("rig:guide_2+distributed_bristles", 1)]
        {
            let model = StageModel::named(name).unwrap();
            assert_eq!((model.guides.len(), model.effects.len()), (guides, 1), "{name}");
            assert_eq!(model.effects[0].name, "distributed_bristles");
            model.check().unwrap();
        }
        for (name, words) in [
            ("guide_9+distributed_bristles", "did you mean `guide_"),
            ("guide_2+distributd_bristles", "did you mean `guide_2+distributed_bristles`"),
            (
                "guide_1+distributed_bristles+distributed_bristles",
                "no parallel bristles of `guide_1+",
            ),
        ] {
            let error = StageModel::named(name).unwrap_err().to_string();
            assert!(error.contains(words), "{name}: {error}");
        }
    }

    #[test]
    fn guides_that_are_not_passive_share_one_note() {
        let one = StageModel::on_guides("guide_1").notes().unwrap();
        assert!(one.len() == 1 && one[0].starts_with("the guides are not passive"), "{one:?}");
        let mut model = StageModel::default();
        let mut guides = model.resolved_guides().unwrap();
        guides[2].static_force += 1.0;
        guides[3].damping_velocity = Some(0.005);
        model.guides = guides.into_iter().map(GuideSource::Inline).collect();
        let notes = model.notes().unwrap();
        let [note] = notes.as_slice() else { panic!("{notes:?}") };
        for words in [
            "guides[0], guides[1], guides[2] are not passive",
            "passive above 220, 220, 286.7 N s/m",
        ] {
            assert!(note.contains(words), "{note}");
        }
    }

    #[test]
    fn a_guide_of_two_parameters_is_completed_and_says_how() {
        let text = "joint: revolute\nmass: 1e-4\nguides: [{coulomb_force: 0.02, viscous_friction: \
                    1e-3}]\n";
        let model = StageModel::from_yaml(text, "joint").unwrap();
        let guide = &model.resolved_guides().unwrap()[0];
        assert_eq!((guide.coulomb_force, guide.static_force), (0.02, 0.02));
        assert!((guide.static_force / guide.stiffness - 1e-3).abs() < 1e-12);
        let notes = model.notes().unwrap();
        assert_eq!(notes.len(), 1, "{notes:?}");
        let damping = "damping_velocity 0.1 rad/s";
        for words in ["guides[0]", "assumed", "stiffness 20 N m/rad", "static_force", damping] {
            assert!(notes[0].contains(words), "{notes:?}");
        }
        // What a user did not say is not written as if it had been.
        let written = model.to_yaml().unwrap();
        assert!(written.contains("revolute") && !written.contains("stiffness"), "{written}");
        assert_eq!(StageModel::from_yaml(&written, "again").unwrap(), model);
    }

    #[test]
    fn a_model_is_a_guide_a_rig_or_a_file() {
        let named = StageModel::named;
        assert_eq!(named("guide_3").unwrap().guides.len(), 4);
        assert_eq!(named("rig:guide_3").unwrap().guides.len(), 1);
        assert!(named("guide_9").unwrap_err().to_string().contains("did you mean `guide_"));
        assert!(named("missing.yaml").unwrap_err().to_string().contains("missing.yaml"));
    }

    #[test]
    fn model_survives_a_round_trip_through_yaml() {
        let mut model = StageModel::measuring_rig("guide_2").unwrap();
        model.guides = vec![GuideSource::Inline(model.resolved_guides().unwrap()[0].clone())];
        model
            .effects
            .push(EffectParameters::new("cogging", [("amplitude", 6.0), ("period", 0.1 + 0.2)]));
        let text = model.to_yaml().unwrap();
        assert_eq!(StageModel::from_yaml(&text, "round trip").unwrap(), model, "{text}");
    }

    #[test]
    fn a_model_file_names_guides_of_a_catalogue_beside_it_and_needs_it_no_more_once_read() {
        let directory = tempfile::tempdir().unwrap();
        let own = include_str!("../../../../launch_config/own_guide_catalogue.yaml");
        std::fs::create_dir(directory.path().join("guides")).unwrap();
        std::fs::write(directory.path().join("guides/own.yaml"), own).unwrap();
        let path = directory.path().join("stage.yaml");
        let load = |text: &str| {
            std::fs::write(&path, text).unwrap();
            StageModel::load(&path)
        };
        let model =
            load("catalogue: guides/own.yaml\nguides: [my_guide, guide_2, my_guide]\n").unwrap();
        let mine = Catalogue::from_yaml(own, "own.yaml").unwrap().guide("my_guide").unwrap();
        let two = Catalogue::builtin().guide("guide_2").unwrap();
        assert_eq!(model.resolved_guides().unwrap(), [mine.clone(), two, mine]);
        // Written out, as into a bag, it is read where the catalogue is not.
        assert_eq!(StageModel::from_yaml(&model.to_yaml().unwrap(), "bag").unwrap(), model);

        // A text that is no file, as one from a bag, opens none.
        let text = format!("catalogue: {}/guides/own.yaml\n", directory.path().display());
        let refused = StageModel::from_yaml(&text, "model.yaml in a bag").unwrap_err().to_string();
        assert!(refused.contains("only a model file may"), "{refused}");
        assert!(load(&text).is_ok());

        let message = |text: &str| load(text).unwrap_err().to_string();
        let unknown = message("catalogue: guides/own.yaml\nguides: [my_gide]\n");
        assert!(
            unknown.contains("did you mean `my_guide`") && unknown.contains("guide_1"),
            "{unknown}"
        );
        let nowhere = message("catalogue: own.yaml\n");
        assert!(nowhere.contains("catalogue") && nowhere.contains("own.yaml"), "{nowhere}");
        std::fs::write(directory.path().join("taken.yaml"), own.replace("my_guide", "guide_1"))
            .unwrap();
        let taken = message("catalogue: taken.yaml\n");
        assert!(taken.contains("taken.yaml") && taken.contains("`guide_1`"), "{taken}");
    }

    /// Each bad text with the words that its message must hold.
    #[test]
    fn bad_models_are_refused_with_key_value_limit_and_the_nearest_key() {
        let cases: &[(&str, &[&str])] = &[
            ("mas: 40", &["mas", "did you mean `mass`", "line 1"]),
            ("mass: -4", &["mass", "-4", "greater than 0"]),
            ("mass: .nan", &["mass", "NaN", "finite"]),
            ("mass: forty", &["line 1", "a number is expected"]),
            ("guides: [guide_7]", &["guides[0]", "guide_7", "did you mean `guide_"]),
            ("guides: []", &["1 to 4 guides", "0"]),
            ("guides: [guide_1, guide_1, guide_1, guide_1, guide_1]", &["1 to 4 guides", "5"]),
            ("guides: [{stifness: 1e5}]", &["stifness", "did you mean `stiffness`"]),
            ("guides: [{stiffness: 1e5}]", &["coulomb_force"]),
            ("guides: [{coulomb_force: -1}]", &["guides[0].coulomb_force", "greater than 0"]),
            ("joint: rotary", &["rotary", "revolute"]),
            (
                "guides: [{stiffness: 1e5, bristle_damping: 1, viscous_friction: 1, coulomb_force: \
                 5, static_force: 4, stribeck_velocity: 1e-3}]",
                &["guides[0].static_force", "4", "coulomb_force", "5"],
            ),
            ("encoder: {resolution: -1e-9}", &["encoder.resolution", "not be negative"]),
            ("motor: {force_limit: 0}", &["motor.force_limit", "greater than 0"]),
            (
                "effects: [{cogging: {amplitude: 1}, cable_chain: {}}]",
                &["one list entry holds one effect"],
            ),
            ("", &["test.yaml", "is empty", "`{}`"]),
            ("# only this\n---\n", &["is empty"]),
            ("guides: [guide_1", &["line 1"]),
            ("mass: 40\nmotor:\n  force_limit", &["line"]),
        ];
        for (text, expected) in cases {
            let message = StageModel::from_yaml(text, "test.yaml").unwrap_err().to_string();
            for words in *expected {
                assert!(message.contains(words), "{text:?} gave {message:?}, without {words:?}");
            }
        }
    }
}
