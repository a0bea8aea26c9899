//! The guides that are known by name, each number with where it comes from.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::Guide;
use super::error::{ModelError, nearest};
use crate::{text_file, yaml};

/// Guides by name. The built-in catalogue holds the three guides of the paper; a user's own stand
/// beside them.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Catalogue {
    entries: BTreeMap<String, CatalogueEntry>,
}

/// One guide type: how it is built, its LuGre parameters and what was measured on it.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CatalogueEntry {
    /// What the guide is, in words.
    pub description: String,
    /// Whether it has seals.
    pub seals: bool,
    /// Its lubricant.
    pub lubricant: String,
    /// Whether a cage keeps the balls apart.
    pub cage: bool,
    /// Bristle stiffness sigma0, N/m.
    pub stiffness: Quantity,
    /// Bristle damping sigma1, N s/m.
    pub bristle_damping: Quantity,
    /// Viscous friction sigma2, N s/m.
    pub viscous_friction: Quantity,
    /// Coulomb friction Fc, N.
    pub coulomb_force: Quantity,
    /// Static friction Fs, N.
    pub static_force: Quantity,
    /// Stribeck velocity vs, m/s.
    pub stribeck_velocity: Quantity,
    /// What the paper states of the loops; one bristle cannot meet all of it.
    #[serde(default)]
    pub effective_stiffness: Vec<EffectiveStiffness>,
    /// Several bristles in parallel in place of the one, where more was measured than one can meet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distributed_bristles: Option<DistributedBristles>,
}

/// What the effect `distributed_bristles` and its guide need in place of a single bristle; what is
/// not given of the friction is that of the entry.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DistributedBristles {
    /// Bristle stiffness sigma0 of all elements together.
    pub stiffness: Quantity,
    /// Bristle damping sigma1 of all elements together.
    pub bristle_damping: Quantity,
    /// Viscous friction sigma2, N s/m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub viscous_friction: Option<Quantity>,
    /// Coulomb friction Fc, N.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coulomb_force: Option<Quantity>,
    /// Static friction Fs, N.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub static_force: Option<Quantity>,
    /// Part of the stiffness in element 1.
    pub stiffness_share_1: Quantity,
    /// Part of the friction level in element 1.
    pub strength_share_1: Quantity,
    /// Part of the stiffness in element 2.
    pub stiffness_share_2: Quantity,
    /// Part of the friction level in element 2.
    pub strength_share_2: Quantity,
    /// Part of the stiffness in element 3.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stiffness_share_3: Option<Quantity>,
    /// Part of the friction level in element 3.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub strength_share_3: Option<Quantity>,
}

/// A number with its unit and where it comes from.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Quantity {
    /// In its unit.
    pub value: f64,
    /// Unit of the value.
    pub unit: String,
    /// How far the source supports it.
    pub provenance: Provenance,
    /// Section of the paper, the derivation, the recordings, or what the assumption rests on.
    pub source: String,
    /// Ends of the 95 % confidence interval, in the same unit, where the number was fitted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ci95: Option<[f64; 2]>,
}

/// How far a number can be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Provenance {
    /// The paper's text gives the number.
    Stated,
    /// Follows from stated numbers; the source shows how.
    Derived,
    /// Chosen; the source says from what.
    Assumed,
    /// Fitted to recordings; the source names them.
    Measured,
}

/// A measured effective stiffness: total force over total position difference of a slow loop.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EffectiveStiffness {
    /// m
    pub amplitude: f64,
    /// N/m
    pub stiffness: f64,
    /// How far the source supports it.
    pub provenance: Provenance,
    /// Where it comes from.
    pub source: String,
}

impl Catalogue {
    /// The guides of the paper: `guide_1`, `guide_2`, `guide_3`.
    pub fn builtin() -> Catalogue {
        static BUILTIN: std::sync::LazyLock<Catalogue> = std::sync::LazyLock::new(|| {
            serde_saphyr::from_str(include_str!("catalogue.yaml"))
                .expect("the built-in catalogue is checked by a test")
        });
        BUILTIN.clone()
    }

    /// Reads a user's entries, in the form of the built-in ones; `origin` names the text in errors.
    ///
    /// Refused are a text without entries, units other than SI and guides that cannot be.
    pub fn from_yaml(text: &str, origin: &str) -> Result<Catalogue, ModelError> {
        let empty = || ModelError::EmptyCatalogue { origin: origin.to_owned() };
        // A text of comments only is no map, yet it is what an empty database looks like.
        if text
            .lines()
            .all(|line| matches!(line.trim().as_bytes(), [] | [b'#', ..] | b"---" | b"..."))
        {
            return Err(empty());
        }
        let catalogue: Catalogue = yaml::read(text)
            .map_err(|message| ModelError::Yaml { origin: origin.to_owned(), message })?;
        if catalogue.is_empty() {
            return Err(empty());
        }
        for (name, entry) in &catalogue.entries {
            let key = format!("{origin}: {name}");
            let bristles = entry.distributed_bristles.as_ref().map(DistributedBristles::quantities);
            for (quantity, name, unit) in
                entry.quantities().into_iter().chain(bristles.into_iter().flatten())
            {
                if quantity.unit != unit {
                    let key = format!("{key}.{name}");
                    return Err(ModelError::Unit {
                        key,
                        found: quantity.unit.clone(),
                        expected: unit,
                    });
                }
            }
            entry.guide().check(&key)?;
            if let Some(guide) = entry.distributed_guide() {
                guide.check(&format!("{key}.distributed_bristles"))?;
            }
        }
        Ok(catalogue)
    }

    /// Reads a file of a user's entries.
    pub fn load(path: &Path) -> Result<Catalogue, ModelError> {
        let text = text_file::read(path).map_err(|source| ModelError::ReadCatalogue {
            path: path.display().to_string(),
            source,
        })?;
        Catalogue::from_yaml(&text, &path.display().to_string())
    }

    /// The entries as YAML that [`Catalogue::from_yaml`] reads back.
    pub fn to_yaml(&self) -> Result<String, ModelError> {
        serde_saphyr::to_string(self)
            .map_err(|error| ModelError::Write { message: error.to_string() })
    }

    /// Puts the entries of `other` beside these; a name that is taken is refused. `origin` names
    /// where `other` comes from.
    pub fn add(&mut self, other: Catalogue, origin: &str) -> Result<(), ModelError> {
        for (name, entry) in other.entries {
            self.insert(name, entry, origin)?;
        }
        Ok(())
    }

    /// Puts one entry beside the others; a name that is taken is refused.
    pub fn insert(
        &mut self,
        name: String,
        entry: CatalogueEntry,
        origin: &str,
    ) -> Result<(), ModelError> {
        if self.entries.contains_key(&name) {
            return Err(ModelError::DuplicateGuide { origin: origin.to_owned(), name });
        }
        self.entries.insert(name, entry);
        Ok(())
    }

    /// Those of its guides that have one of these names.
    pub fn only(&self, names: &[impl AsRef<str>]) -> Result<Catalogue, ModelError> {
        let mut chosen = Catalogue::default();
        for name in names.iter().map(AsRef::as_ref) {
            let entry = self.entry(name).ok_or_else(|| ModelError::NotInCatalogue {
                name: name.to_owned(),
                hint: nearest(name, self.names()),
                known: self.names().collect::<Vec<_>>().join(", "),
            })?;
            chosen.insert(name.to_owned(), entry.clone(), "the chosen guides")?;
        }
        Ok(chosen)
    }

    /// Whether it has no guide.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Names and entries, in the order of the names.
    pub fn entries(&self) -> impl Iterator<Item = (&str, &CatalogueEntry)> {
        self.entries.iter().map(|(name, entry)| (name.as_str(), entry))
    }

    /// Names of the guides, in alphabetical order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.entries.keys().map(String::as_str)
    }

    /// The entry of a guide by name.
    pub fn entry(&self, name: &str) -> Option<&CatalogueEntry> {
        self.entries.get(name)
    }

    /// LuGre parameters of a guide by name.
    pub fn guide(&self, name: &str) -> Option<Guide> {
        self.entry(name).map(CatalogueEntry::guide)
    }
}

impl DistributedBristles {
    /// The quantities with their names and the units in which they must stand; `1` is a share.
    fn quantities(&self) -> impl Iterator<Item = (&Quantity, &'static str, &'static str)> {
        let given = [
            (Some(&self.stiffness), "distributed_bristles.stiffness", "N/m"),
            (Some(&self.bristle_damping), "distributed_bristles.bristle_damping", "N s/m"),
            (self.viscous_friction.as_ref(), "distributed_bristles.viscous_friction", "N s/m"),
            (self.coulomb_force.as_ref(), "distributed_bristles.coulomb_force", "N"),
            (self.static_force.as_ref(), "distributed_bristles.static_force", "N"),
            (Some(&self.stiffness_share_1), "distributed_bristles.stiffness_share_1", "1"),
            (Some(&self.strength_share_1), "distributed_bristles.strength_share_1", "1"),
            (Some(&self.stiffness_share_2), "distributed_bristles.stiffness_share_2", "1"),
            (Some(&self.strength_share_2), "distributed_bristles.strength_share_2", "1"),
            (self.stiffness_share_3.as_ref(), "distributed_bristles.stiffness_share_3", "1"),
            (self.strength_share_3.as_ref(), "distributed_bristles.strength_share_3", "1"),
        ];
        given.into_iter().filter_map(|(quantity, name, unit)| Some((quantity?, name, unit)))
    }
}

impl CatalogueEntry {
    /// The LuGre parameters, without where they come from.
    pub fn guide(&self) -> Guide {
        Guide {
            stiffness: self.stiffness.value,
            bristle_damping: self.bristle_damping.value,
            viscous_friction: self.viscous_friction.value,
            coulomb_force: self.coulomb_force.value,
            static_force: self.static_force.value,
            stribeck_velocity: self.stribeck_velocity.value,
            stribeck_exponent: None,
            damping_velocity: None,
        }
    }

    /// The LuGre parameters with which its parallel bristles belong; `None` where it has none.
    pub fn distributed_guide(&self) -> Option<Guide> {
        let of = self.distributed_bristles.as_ref()?;
        let own = self.guide();
        let given = |quantity: &Option<Quantity>, otherwise: f64| {
            quantity.as_ref().map_or(otherwise, |quantity| quantity.value)
        };
        Some(Guide {
            stiffness: of.stiffness.value,
            bristle_damping: of.bristle_damping.value,
            viscous_friction: given(&of.viscous_friction, own.viscous_friction),
            coulomb_force: given(&of.coulomb_force, own.coulomb_force),
            static_force: given(&of.static_force, own.static_force),
            ..own
        })
    }

    /// The quantities with their names and the units in which they must stand.
    fn quantities(&self) -> [(&Quantity, &'static str, &'static str); 6] {
        [
            (&self.stiffness, "stiffness", "N/m"),
            (&self.bristle_damping, "bristle_damping", "N s/m"),
            (&self.viscous_friction, "viscous_friction", "N s/m"),
            (&self.coulomb_force, "coulomb_force", "N"),
            (&self.static_force, "static_force", "N"),
            (&self.stribeck_velocity, "stribeck_velocity", "m/s"),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_entry_is_a_possible_guide() {
        let catalogue = Catalogue::builtin();
        assert_eq!(catalogue.names().collect::<Vec<_>>(), ["guide_1", "guide_2", "guide_3"]);
        for name in catalogue.names() {
            catalogue.guide(name).unwrap().check(name).unwrap();
        }
    }

    /// Stiffness of a slow loop of a guide on its parallel bristles, N/m: the sum of b Fs tanh(a
    /// sigma0 A / (b Fs)) / A over the elements.
    fn stiffness_on_bristles(name: &str, amplitude: f64) -> f64 {
        let (guide, effect) = Catalogue::builtin().distributed_bristles(name).unwrap();
        let shares = |kind: &str| -> [f64; 4] {
            let given = [1, 2, 3]
                .map(|element| effect.values[&format!("{kind}_share_{element}")].number().unwrap());
            let [one, two, three] = given;
            [one, two, three, 1.0 - given.iter().sum::<f64>()]
        };
        let carrying = shares("stiffness").into_iter().zip(shares("strength"));
        let force = |(a, b): (f64, f64)| {
            let strength = b * guide.static_force;
            strength * (a * guide.stiffness * amplitude / strength).tanh()
        };
        carrying.filter(|(_, b)| *b > 1e-9).map(force).sum::<f64>() / amplitude
    }

    #[test]
    fn distributed_bristles_meet_every_stiffness_that_the_paper_states() {
        let catalogue = Catalogue::builtin();
        let mut checked = 0;
        for (name, entry) in catalogue.entries() {
            for of in &entry.effective_stiffness {
                let found = stiffness_on_bristles(name, of.amplitude);
                assert!((found / of.stiffness - 1.0).abs() < 0.011, "{name}: {of:?}: {found}");
                checked += 1;
            }
        }
        assert_eq!(checked, 4);
        let [one, three] = ["guide_1", "guide_3"].map(|name| stiffness_on_bristles(name, 1e-6));
        assert!((three / one - 1.0).abs() < 0.01, "the lubricant: {three} and {one}");
    }

    /// Table 1: guide 2 is guide 1 without seals, so what the guides share are the same elements,
    /// and the seals hold 12 N (section 3).
    #[test]
    fn guide_2_on_its_bristles_is_guide_1_without_the_seals() {
        let catalogue = Catalogue::builtin();
        let of = |name: &str| catalogue.distributed_bristles(name).unwrap();
        let ((one, with), (two, without), (three, low)) =
            (of("guide_1"), of("guide_2"), of("guide_3"));
        assert!((one.static_force - two.static_force - 12.0).abs() < 0.01);
        for element in 1..=3 {
            let size = |guide: &Guide, effect: &super::super::EffectParameters| {
                let of = |kind: &str| {
                    effect.values[&format!("{kind}_share_{element}")].number().unwrap()
                };
                (of("stiffness") * guide.stiffness, of("strength") * guide.static_force)
            };
            let sealed = size(&one, &with);
            for (k, strength) in [size(&two, &without), size(&three, &low)] {
                assert!((k / sealed.0 - 1.0).abs() < 1e-3, "element {element}: {k} {sealed:?}");
                assert!((strength / sealed.1 - 1.0).abs() < 1e-3, "{element}: {strength}");
            }
        }
        for name in catalogue.names() {
            of(name).0.check(name).unwrap();
        }
    }

    /// The statements of the paper's sections 2 and 3 that a single bristle can meet.
    #[test]
    fn catalogue_meets_the_statements_of_the_paper() {
        let catalogue = Catalogue::builtin();
        let [one, two, three] =
            ["guide_1", "guide_2", "guide_3"].map(|name| catalogue.guide(name).unwrap());
        let close = |found: f64, stated: f64| (found / stated - 1.0).abs() < 0.01;
        assert!(close(one.effective_stiffness(1e-6), 4.5e5), "{}", one.effective_stiffness(1e-6));
        assert!(close(two.effective_stiffness(1e-6), 2.6e5), "{}", two.effective_stiffness(1e-6));
        assert!(
            close(three.effective_stiffness(1e-6), one.effective_stiffness(1e-6)),
            "lubricant hardly matters at 1 µm"
        );
        assert!(
            (one.static_force - two.static_force - 12.0).abs() < 0.5,
            "12 N lower break-away without seals"
        );
        // A guide has broken away where the bristle force of a sliding-free loop would exceed its
        // static friction.
        let broken_away = |guide: &Guide| guide.stiffness * 40e-6 > 1.5 * guide.static_force;
        assert!(broken_away(&two) && !broken_away(&one) && !broken_away(&three));
        assert_eq!(one.viscous_friction, two.viscous_friction, "roughly similar slopes");
        assert!(
            three.viscous_friction < one.viscous_friction && three.static_force > one.static_force
        );
        let falls = |guide: &Guide| {
            guide.steady_force(2.0 * guide.stribeck_velocity) < guide.steady_force(1e-6)
        };
        assert!(
            falls(&one) && falls(&three) && !falls(&two),
            "1 and 3 have a falling F(v), 2 has not"
        );
    }

    const OWN: &str = include_str!("../../../../launch_config/own_guide_catalogue.yaml");

    #[test]
    fn a_users_own_guides_stand_beside_the_papers_and_survive_yaml() {
        let mut catalogue = Catalogue::builtin();
        catalogue.add(Catalogue::from_yaml(OWN, "own.yaml").unwrap(), "own.yaml").unwrap();
        assert_eq!(catalogue.names().count(), 4);
        let again = Catalogue::from_yaml(&catalogue.to_yaml().unwrap(), "again").unwrap();
        for name in catalogue.names() {
            assert_eq!(again.guide(name), catalogue.guide(name), "{name}");
        }
        let message = catalogue
            .add(Catalogue::from_yaml(OWN, "own.yaml").unwrap(), "own.yaml")
            .unwrap_err()
            .to_string();
        assert!(message.contains("own.yaml") && message.contains("a name of its own"), "{message}");
    }

    #[test]
    fn a_bad_catalogue_is_refused_with_what_would_be_right() {
        let bad = |text: &str| Catalogue::from_yaml(text, "own.yaml").unwrap_err().to_string();
        for empty in ["", "# nothing yet\n", "{}", " ~", "null", "{ }"] {
            assert!(bad(empty).contains("own.yaml holds no guide"), "{}", bad(empty));
        }
        let message = bad(&OWN.replace("unit: N/m,", "unit: N/um,"));
        assert!(
            message.contains("stiffness") && message.contains("N/um") && message.contains("`N/m`"),
            "{message}"
        );
        let builtin = include_str!("catalogue.yaml");
        let message = bad(&builtin.replace(
            "stiffness: {value: 7.5462e5, unit: N/m",
            "stiffness: {value: 0.75462, unit: N/um",
        ));
        assert!(
            message.contains("guide_1.distributed_bristles.stiffness") && message.contains("N/um"),
            "{message}"
        );
        let message = bad(&builtin.replace(
            "coulomb_force: {value: 11.337, unit: N",
            "coulomb_force: {value: 21.337, unit: N",
        ));
        assert!(
            message.contains("guide_1.distributed_bristles") && message.contains("14.44"),
            "{message}"
        );
        let message = bad(&OWN.replace("static_force: {value: ", "static_force: {value: -"));
        assert!(
            message.contains("static_force") && message.contains("greater than 0"),
            "{message}"
        );
        let message = bad(&OWN.replace("stiffness:", "stifness:"));
        assert!(message.contains("did you mean `stiffness`"), "{message}");
    }
}
