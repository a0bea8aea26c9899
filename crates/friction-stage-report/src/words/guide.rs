//! What a guide is, in words.

use friction_stage_core::model::Catalogue;

/// The name of a guide as figures and tables show it, with what it is where the built-in catalogue
/// knows it: `guide_3` is `guide 3 (low-friction grease)`.
pub fn guide_label(name: &str) -> String {
    let plain = name.replace('_', " ");
    let catalogue = Catalogue::builtin();
    let known = catalogue.entries().find_map(|(key, entry)| {
        let rest = plain.strip_prefix(&key.replace('_', " "))?;
        // `guide 10` is not `guide 1`.
        (rest.is_empty() || rest.starts_with(' ')).then_some((plain.len() - rest.len(), entry))
    });
    let Some((end, entry)) = known else { return plain };
    let what = match (entry.lubricant.as_str(), entry.seals) {
        ("standard", true) => "sealed".to_owned(),
        ("standard", false) => "unsealed".to_owned(),
        (lubricant, _) => format!("{lubricant} grease"),
    };
    format!("{} ({what}){}", &plain[..end], &plain[end..])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn guides_are_called_by_what_they_are() {
        assert_eq!(guide_label("guide_1"), "guide 1 (sealed)");
        assert_eq!(guide_label("guide 2"), "guide 2 (unsealed)");
        assert_eq!(guide_label("guide_3"), "guide 3 (low-friction grease)");
        assert_eq!(guide_label("guide 1 distributed"), "guide 1 (sealed) distributed");
        assert_eq!(guide_label("guide_10"), "guide 10");
        assert_eq!(guide_label("rail_of_mine"), "rail of mine");
    }
}
