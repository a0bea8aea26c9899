//! The words for what the laboratory finds.

use friction_stage_core::model::{JointType, StageModel};
use friction_stage_lab::{
    Drawback, ExperimentFinding, GuideFitFinding, Omitted, Platform, SelectionFinding,
};

use super::Words;
use crate::paper_motion::micrometres;

impl Words for GuideFitFinding {
    fn words(&self, _: JointType) -> String {
        match self {
            Self::WideInterval { parameter, value, share } => format!(
                "{parameter} is {value:.4e}, known to {:.0} % only (95 %): the recordings hardly \
                 show it",
                100.0 * share
            ),
            Self::HiddenDamping { damping, noise } => format!(
                "the bristle damping makes {damping:.3} N rms of the loops' force, the noise of \
                 the cell is {noise:.3} N: bristle_damping may lie outside its interval; make the \
                 loops quicker, as `experiment dahl` does for dahl_quick"
            ),
            Self::SeveralBristles { left, noise } => format!(
                "one bristle leaves {left:.3} N of the loops' force, the noise of the cell is \
                 {noise:.3} N: stiffness depends on the amplitude here, as for several bristles in \
                 parallel"
            ),
            Self::SmallLoop { span, break_away, least } => format!(
                "the largest loop spans {:.1} µm, break-away takes some {:.1} µm: make it at least \
                 {:.0} µm",
                1e6 * span,
                1e6 * break_away,
                1e6 * least
            ),
        }
    }
}

impl Words for ExperimentFinding {
    fn words(&self, _: JointType) -> String {
        match self {
            Self::LeftOut(omission) => match &omission.omitted {
                Omitted::Effects(names) => {
                    let platform = match omission.platform {
                        Platform::Rig => "rig",
                        Platform::Stage => "stage",
                    };
                    format!("{}: on the {platform} without {}", omission.model, names.join(", "))
                }
                Omitted::OtherGuides => {
                    format!("{}: its guides differ; on the rig is guides[0]", omission.model)
                }
            },
            Self::NoStatements => format!(
                "the paper's statements need guide_1, guide_2, guide_3 and guide_1{0}, or all \
                 three with {0}: no table",
                StageModel::PARALLEL_BRISTLES
            ),
        }
    }
}

impl Words for Drawback {
    fn words(&self, _: JointType) -> String {
        match self {
            Self::Excluded(obstacle) => obstacle.clone(),
            Self::PeakError { share, median, allowed } => format!(
                "its peak error is too large in {} of the variants: {:.2} µm at the median, {:.2} \
                 µm allowed",
                percent(*share),
                1e6 * median,
                1e6 * allowed
            ),
            Self::Settling { share, band, median, allowed } => {
                let settled = match median.is_finite() {
                    true => format!("{:.1} ms", 1e3 * median),
                    false => "not while watched".to_owned(),
                };
                format!(
                    "it settles too late in {} of the variants: to {} after {settled} at the \
                     median, {:.1} ms allowed",
                    percent(*share),
                    micrometres(*band),
                    1e3 * allowed
                )
            }
            Self::Saturated { share } => {
                format!("the motor reaches its limit in {} of the variants", percent(*share))
            }
            Self::LessMargin { best, peak_error, settling_time } => {
                let [peak, best_peak] = peak_error.map(|error| format!("{:.2} µm", 1e6 * error));
                let [time, best_time] = settling_time.map(|time| format!("{:.1} ms", 1e3 * time));
                match peak == best_peak && time == best_time {
                    true => format!(
                        "it meets the requirement as well and is hardly different from {best}: \
                         median peak error {peak}, settled after {time} with both"
                    ),
                    false => format!(
                        "it meets the requirement as well, with less margin: median peak error \
                         {peak} against {best_peak} of {best}, settled after {time} against \
                         {best_time}"
                    ),
                }
            }
            Self::Larger { best, parameters } => {
                let parameters: Vec<String> = parameters
                    .iter()
                    .map(|(name, own, other, unit)| {
                        format!("{name} ({own} against {other} {unit})")
                    })
                    .collect();
                format!("it has more {} than {best}", parameters.join(" and "))
            }
        }
    }
}

impl Words for SelectionFinding {
    fn words(&self, _: JointType) -> String {
        match self {
            Self::UnsafeChoice { guide, chance } => format!(
                "{guide} is the best, yet meets the requirement in {} of its variants only",
                percent(*chance)
            ),
            Self::LowFriction { guide, best, viscous_share, static_force, peak_error } => format!(
                "{guide} has {} of the viscous friction of {best}, but more static friction ({} \
                 against {} N), which decides here: its median peak error is {:.2} µm against \
                 {:.2} µm. Low friction in a data sheet is friction at speed",
                percent(*viscous_share),
                static_force[0],
                static_force[1],
                1e6 * peak_error[0],
                1e6 * peak_error[1]
            ),
        }
    }
}

/// A share in per cent: neither 0 % nor 100 % for what is not quite that.
fn percent(share: f64) -> String {
    match 100.0 * share {
        share if share > 0.0 && share < 0.1 => "less than 0.1 %".to_owned(),
        share if share < 100.0 && share > 99.9 => "more than 99.9 %".to_owned(),
        share => format!("{share:.1} %"),
    }
}

#[cfg(test)]
mod tests {
    use friction_stage_data::quality::Severity;
    use friction_stage_lab::Omission;

    use crate::words::Worded;

    use super::*;

    #[test]
    fn what_speaks_against_a_guide_is_said_with_its_numbers() {
        let cases = [
            (Drawback::Excluded("has no seals".to_owned()), "has no seals"),
            (
                Drawback::PeakError { share: 0.9999, median: 2e-6, allowed: 1.5e-6 },
                "in more than 99.9 % of the variants: 2.00 µm at the median, 1.50 µm allowed",
            ),
            (
                Drawback::Settling { share: 1.0, band: 1e-7, median: f64::INFINITY, allowed: 0.01 },
                "to 0.1 µm after not while watched at the median, 10.0 ms allowed",
            ),
            (Drawback::Saturated { share: 0.5 }, "in 50.0 % of the variants"),
            (
                Drawback::LessMargin {
                    best: "guide_2".to_owned(),
                    peak_error: [2e-6, 1e-6],
                    settling_time: [0.02, 0.02],
                },
                "less margin: median peak error 2.00 µm against 1.00 µm of guide_2",
            ),
            (
                Drawback::LessMargin {
                    best: "guide_2".to_owned(),
                    peak_error: [1e-6, 1.001e-6],
                    settling_time: [0.02, 0.02],
                },
                "hardly different from guide_2: median peak error 1.00 µm, settled after 20.0 ms",
            ),
            (
                Drawback::Larger {
                    best: "guide_2".to_owned(),
                    parameters: vec![("static friction", 18.5, 9.0, "N")],
                },
                "it has more static friction (18.5 against 9 N) than guide_2",
            ),
        ];
        for (drawback, words) in cases {
            let said = drawback.words(JointType::Prismatic);
            assert!(said.contains(words), "{said}");
        }
        let choice = SelectionFinding::UnsafeChoice { guide: "guide_2".to_owned(), chance: 0.85 };
        assert!(choice.words(JointType::Prismatic).contains("in 85.0 % of its variants only"));
    }

    #[test]
    fn other_programs_read_a_code_and_the_numbers() {
        let json = |finding: &ExperimentFinding| {
            let worded =
                Worded::new(finding.code(), Severity::Warning, finding, JointType::Prismatic);
            serde_json::to_value(worded).unwrap()
        };
        let none = json(&ExperimentFinding::NoStatements);
        assert_eq!(
            (&none["code"], &none["severity"]),
            (&"no_statements".into(), &"warning".into())
        );
        let found = json(&ExperimentFinding::LeftOut(Omission {
            platform: Platform::Rig,
            model: "mine".to_owned(),
            omitted: Omitted::Effects(vec!["cogging".to_owned()]),
        }));
        assert_eq!(found["code"], "effects_left_out");
        assert_eq!((&found["platform"], &found["model"]), (&"rig".into(), &"mine".into()));
        assert_eq!(found["omitted"]["effects"][0], "cogging");
    }

    #[test]
    fn each_finding_names_its_numbers() {
        let joint = JointType::Prismatic;
        let findings = [
            (
                GuideFitFinding::WideInterval { parameter: "stiffness", value: 2e5, share: 0.25 },
                ["stiffness is 2.0000e5", "25 %"],
            ),
            (GuideFitFinding::HiddenDamping { damping: 0.01, noise: 0.05 }, ["0.010 N", "0.050 N"]),
            (GuideFitFinding::SeveralBristles { left: 0.3, noise: 0.05 }, ["0.300 N", "0.050 N"]),
            (
                GuideFitFinding::SmallLoop { span: 2e-6, break_away: 1.5e-6, least: 6e-6 },
                ["spans 2.0 µm", "at least 6 µm"],
            ),
        ];
        for (finding, words) in findings {
            let said = finding.words(joint);
            assert!(words.iter().all(|part| said.contains(part)), "{said}");
        }
        let left_out = |platform, omitted| {
            let omission = Omission { platform, model: "mine".to_owned(), omitted };
            ExperimentFinding::LeftOut(omission).words(joint)
        };
        let effects = Omitted::Effects(vec!["cogging".to_owned(), "cable_chain".to_owned()]);
        assert_eq!(
            left_out(Platform::Rig, effects),
            "mine: on the rig without cogging, cable_chain"
        );
        assert!(left_out(Platform::Rig, Omitted::OtherGuides).contains("guides[0]"));
        let none = ExperimentFinding::NoStatements.words(joint);
        assert!(none.contains("guide_1+distributed_bristles, or all"), "{none}");
    }
}
