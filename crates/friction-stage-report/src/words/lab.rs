//! The words for what the laboratory finds.

use friction_stage_core::model::{JointType, StageModel};
use friction_stage_lab::{ExperimentFinding, GuideFitFinding, Omitted, Platform};

use super::Words;

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

#[cfg(test)]
mod tests {
    use friction_stage_lab::Omission;

    use super::*;

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
