//! The page on which a running stage is watched and moved. Its data come over a web socket from
//! whoever serves it.

use friction_stage_core::model::{GuideSource, StageModel};

use crate::interactive::{CURVES, LIBRARY, LIBRARY_LICENCE, LIBRARY_STYLE};
use crate::page::{STYLE, escaped};
use crate::words::guide_label;

/// What the page shows of a stage from the start.
pub struct LiveStage<'a> {
    /// The stage.
    pub model: &'a StageModel,
    /// Bandwidth of its own position loop, Hz; none where another node controls it, which only that
    /// one can set.
    pub bandwidth: Option<f64>,
}

/// Draws what comes over the socket.
const SCRIPT: &str = include_str!("../assets/live.js");

/// The guides of a stage: `4 x guide 1 (sealed)`.
fn guides(model: &StageModel) -> String {
    let mut kinds: Vec<(String, usize)> = Vec::new();
    for guide in &model.guides {
        let label = match guide {
            GuideSource::Catalogue(name) => guide_label(name),
            GuideSource::Inline(_) | GuideSource::Partial(_) => "a guide of its own".to_owned(),
        };
        match kinds.iter_mut().find(|known| known.0 == label) {
            Some((_, count)) => *count += 1,
            None => kinds.push((label, 1)),
        }
    }
    let reported = kinds.into_iter().map(|(label, count)| format!("{count} \u{d7} {label}"));
    reported.collect::<Vec<_>>().join(", ")
}

/// A number that changes, with its unit; the script chooses the prefix.
fn tile(id: &str, name: &str, unit: &str) -> String {
    format!(
        "<div class=\"tile neutral\"><span>{name}, <b id=\"{id}-unit\">{unit}</b></span><output \
         class=\"value\" id=\"{id}\">\u{2013}</output></div>\n"
    )
}

/// The page; its socket is `/data` of the server that it comes from.
pub fn live_page(stage: &LiveStage) -> String {
    let (name, guides) = (escaped(&stage.model.name), escaped(&guides(stage.model)));
    let (disabled, note) = match stage.bandwidth {
        Some(_) => ("", String::new()),
        None => (
            " disabled",
            "<p class=\"note neutral\">drive: force: another node controls this stage. With -p \
             drive:=servo it can be moved from here.</p>"
                .to_owned(),
        ),
    };
    let joint = stage.model.joint;
    let bandwidth = stage.bandwidth.unwrap_or(60.0);
    let most = (2.0 * bandwidth).clamp(150.0, 1000.0);
    // Only a stage that drives itself knows what it is to follow.
    let error = match stage.bandwidth {
        Some(_) => tile("error", "error", &joint.unit("µm")),
        None => String::new(),
    };
    let position = tile("position", &joint.quantity("position"), &joint.unit("mm"));
    let force = tile("force", &joint.quantity("force"), &joint.unit("N"));
    let units = format!("data-length=\"{}\" data-force=\"{}\"", joint.unit("m"), joint.unit("N"));
    let quantities = format!(
        "data-position=\"{}\" data-torque=\"{}\"",
        joint.quantity("position"),
        joint.quantity("force")
    );
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta \
         name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<meta \
         name=\"color-scheme\" content=\"light dark\">\n<link rel=\"icon\" \
         href=\"data:,\">\n<title>{name}, live</title>\n<style>\n{LIBRARY_STYLE}{STYLE}</style>\n\
         </head>\n<body>\n<main>\n<header>\n<h1>{name}</h1>\n<p>{guides} \u{b7} <span id=\"state\" \
         role=\"status\">connecting</span></p>\n</header>\n{note}<div class=\"tiles\">\n\
         {position}{error}{force}</div>\n<div class=\"controls\">\n<label>bandwidth <input \
         type=\"range\" id=\"bandwidth\" min=\"1\" max=\"{most}\" step=\"1\" \
         value=\"{bandwidth}\"{disabled}> <output id=\"bandwidth-value\"></output></label>\n\
         <label>step <input type=\"range\" id=\"size\" min=\"-7\" max=\"-2\" step=\"0.1\" \
         value=\"-5\"{disabled}> <output id=\"size-value\"></output></label>\n<button \
         type=\"button\" id=\"back\"{disabled}>step back</button>\n<button type=\"button\" \
         id=\"forth\"{disabled}>step forth</button>\n<button type=\"button\" id=\"record\" \
         aria-pressed=\"false\">record</button>\n<span id=\"said\" role=\"status\"></span>\n\
         </div>\n<div id=\"plots\" {units} {quantities}></div>\n</main>\n<script>\n/*\nuPlot \
         1.6.32\n{LIBRARY_LICENCE}\n*/\n{LIBRARY}</script>\n<script>\n{CURVES}{SCRIPT}</script>\n\
         </body>\n</html>\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_says_on_which_guides_the_stage_is() {
        let mut model = StageModel::on_guides("guide_3");
        assert_eq!(guides(&model), "4 \u{d7} guide 3 (low-friction grease)");
        model.guides[0] = GuideSource::Catalogue("guide_1".to_owned());
        let page = live_page(&LiveStage { model: &model, bandwidth: Some(60.0) });
        assert!(page.contains("data-length=\"m\"") && page.contains(">µm</b>"));
        model.joint = friction_stage_core::model::JointType::Revolute;
        let rotary = live_page(&LiveStage { model: &model, bandwidth: Some(60.0) });
        assert!(rotary.contains("data-length=\"rad\" data-force=\"N m\""), "{rotary}");
        assert!(rotary.contains(">µrad</b>") && !rotary.contains(">µm</b>"));
        let words = "1 \u{d7} guide 1 (sealed), 3 \u{d7} guide 3 (low-friction grease)";
        assert!(page.contains(words), "{}", &page[page.find("<h1>").unwrap()..][..300]);
    }
}
