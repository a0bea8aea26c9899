//! What was found, in a few words: effects that are harmonics of each other are one.

use friction_stage_core::model::JointType;
use friction_stage_identify::FoundEffect;

use super::in_prefix;

/// Highest harmonic that is called one. Assumed: beyond it two periods fit by chance.
const HIGHEST: u32 = 9;
/// How far the ratio of two periods may be from a whole number where neither has an interval.
/// Assumed.
const NEAR: f64 = 0.002;

/// Effects that are one in words.
pub struct EffectGroup {
    /// Such as `cogging, 24.00 mm with its second harmonic`.
    pub phrase: String,
    /// The place of each effect in the list, with its harmonic: the fundamental, 1, first.
    pub members: Vec<(usize, u32)>,
}

/// The effects in words, such as `cogging, 24.00 mm with its second harmonic`.
pub fn effect_phrases(effects: &[FoundEffect], joint: JointType) -> Vec<String> {
    effect_groups(effects, joint).into_iter().map(|group| group.phrase).collect()
}

/// The effects, with those that are harmonics of each other as one.
pub fn effect_groups(effects: &[FoundEffect], joint: JointType) -> Vec<EffectGroup> {
    let mut reported = vec![false; effects.len()];
    // The longest period of a name is the fundamental.
    let mut order: Vec<usize> = (0..effects.len()).collect();
    order.sort_by(|a, b| {
        let period = |at: &usize| period(&effects[*at]).map_or(f64::INFINITY, |found| found.0);
        period(b).total_cmp(&period(a))
    });
    let mut by_place = Vec::new();
    for first in order {
        if reported[first] {
            continue;
        }
        reported[first] = true;
        let effect = &effects[first];
        let name = effect.name.replace('_', " ");
        let mut phrase = match (period(effect), &effect.coordinate) {
            (Some((value, _)), _) => {
                format!("{name}, {}", in_prefix_of_four(value, &joint.unit("m")))
            }
            (None, Some(coordinate)) => format!("{name} over {coordinate}"),
            (None, None) => match effect.parameters.get("frequency") {
                Some(found) => format!("{name}, {}", in_prefix_of_four(found.value, "Hz")),
                None => name,
            },
        };
        let mut members = vec![(first, 1)];
        for (at, other) in effects.iter().enumerate() {
            if !reported[at]
                && other.name == effect.name
                && other.side == effect.side
                && let Some(order) = harmonic(effect, other)
            {
                reported[at] = true;
                members.push((at, order));
            }
        }
        members.sort_by_key(|(_, order)| *order);
        let words: Vec<String> =
            members[1..].iter().map(|(_, order)| harmonic_name(*order)).collect();
        match words.as_slice() {
            [] => {}
            [one] => phrase += &format!(" with its {one} harmonic"),
            [some @ .., last] => {
                phrase += &format!(" with its {} and {last} harmonics", some.join(", "));
            }
        }
        by_place.push(EffectGroup { phrase, members });
    }
    by_place.sort_by_key(|group| group.members[0].0);
    by_place
}

/// Period and half of its interval.
fn period(effect: &FoundEffect) -> Option<(f64, f64)> {
    let found = effect.parameters.get("period")?;
    let half = found.ci95.map_or(0.0, |[low, high]| 0.5 * (high - low).abs());
    (found.value > 0.0).then_some((found.value, half))
}

/// Which harmonic of `first` the other is, if its period is a whole part of it within what the
/// intervals leave open.
fn harmonic(first: &FoundEffect, other: &FoundEffect) -> Option<u32> {
    let ((long, long_half), (short, short_half)) = (period(first)?, period(other)?);
    let ratio = long / short;
    let order = ratio.round();
    let open = NEAR.max(2.0 * (long_half / long).hypot(short_half / short));
    let whole = (ratio / order - 1.0).abs() <= open && order >= 2.0;
    (whole && order <= f64::from(HIGHEST)).then_some(order as u32)
}

/// Which harmonic one is: `second`.
pub fn harmonic_name(order: u32) -> String {
    const WORDS: [&str; 8] =
        ["second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth"];
    WORDS.get(order as usize - 2).map_or_else(|| format!("{order}th"), |word| (*word).to_owned())
}

/// As [`in_prefix`], to four digits: a pitch of 24 mm is known that well.
fn in_prefix_of_four(value: f64, unit: &str) -> String {
    let three = in_prefix(value, unit);
    let Some((_, unit)) = three.split_once(' ') else { return three };
    let scale = match unit.chars().next() {
        Some('m') if unit.len() > 1 => 1e3,
        Some('µ') => 1e6,
        Some('n') => 1e9,
        _ => 1.0,
    };
    let scaled = value * scale;
    let decimals = (3 - scaled.abs().log10().floor() as i32).clamp(0, 9) as usize;
    format!("{scaled:.decimals$} {unit}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use friction_stage_identify::FoundParameter;
    use std::collections::BTreeMap;

    fn cogging(period: f64, ci95: Option<[f64; 2]>) -> FoundEffect {
        let parameter = FoundParameter { value: period, unit: "m".into(), ci95 };
        FoundEffect {
            name: "cogging".into(),
            side: "motor".into(),
            coordinate: None,
            parameters: BTreeMap::from([("period".to_owned(), parameter)]),
            runner_up: None,
            rivals: Vec::new(),
        }
    }

    #[test]
    fn what_has_a_frequency_is_named_with_it() {
        let frequency = FoundParameter { value: 120.003, unit: "Hz".into(), ci95: None };
        let mode = FoundEffect {
            name: "structural_mode".into(),
            parameters: BTreeMap::from([("frequency".to_owned(), frequency)]),
            ..cogging(0.0, None)
        };
        assert_eq!(effect_phrases(&[mode], JointType::Prismatic), ["structural mode, 120.0 Hz"]);
    }

    #[test]
    fn harmonics_are_one_effect() {
        let members = |periods: &[f64]| -> Vec<Vec<(usize, u32)>> {
            let effects: Vec<_> = periods.iter().map(|period| cogging(*period, None)).collect();
            let groups = effect_groups(&effects, JointType::Prismatic);
            groups.into_iter().map(|group| group.members).collect()
        };
        assert_eq!(members(&[0.012, 0.024, 0.0137]), [vec![(1, 1), (0, 2)], vec![(2, 1)]]);
        let reported = |periods: &[f64]| {
            let effects: Vec<_> = periods.iter().map(|period| cogging(*period, None)).collect();
            effect_phrases(&effects, JointType::Prismatic)
        };
        assert_eq!(reported(&[0.024]), ["cogging, 24.00 mm"]);
        assert_eq!(reported(&[0.024, 0.012]), ["cogging, 24.00 mm with its second harmonic"]);
        assert_eq!(reported(&[0.008, 0.024]), ["cogging, 24.00 mm with its third harmonic"]);
        assert_eq!(
            reported(&[0.012, 0.024, 0.006]),
            ["cogging, 24.00 mm with its second and fourth harmonics"]
        );
        assert_eq!(reported(&[0.024, 0.0137]), ["cogging, 24.00 mm", "cogging, 13.70 mm"]);
        // What is known badly may be a harmonic.
        let wide = [cogging(0.024, None), cogging(0.0121, Some([0.0118, 0.0124]))];
        assert_eq!(effect_phrases(&wide, JointType::Prismatic).len(), 1);
        assert_eq!(effect_phrases(&[], JointType::Prismatic), Vec::<String>::new());
    }
}
