//! The page on which a running stage is watched and moved. Its data come over a web socket from
//! whoever serves it.

use crate::interactive::{LIBRARY, LIBRARY_LICENCE, LIBRARY_STYLE};
use crate::page::{STYLE, escaped};

/// What the page shows of a stage from the start.
pub struct LiveStage<'a> {
    /// Name of the stage.
    pub name: &'a str,
    /// Bandwidth of its own position loop, Hz; none where another node controls it, which only that
    /// one can set.
    pub bandwidth: Option<f64>,
}

/// Draws what comes over the socket.
const SCRIPT: &str = include_str!("../assets/live.js");

/// The page; its socket is `/data` of the server that it comes from.
pub fn live_page(stage: &LiveStage) -> String {
    let name = escaped(stage.name);
    let (disabled, note) = match stage.bandwidth {
        Some(_) => ("", String::new()),
        None => (
            " disabled",
            "<p class=\"note neutral\">drive: force: another node controls this stage. With -p \
             drive:=servo it can be moved from here.</p>"
                .to_owned(),
        ),
    };
    let bandwidth = stage.bandwidth.unwrap_or(60.0);
    let most = (2.0 * bandwidth).max(150.0);
    // Only a stage that drives itself knows what it is to follow.
    let error = match stage.bandwidth {
        Some(_) => {
            "<div class=\"tile neutral\"><span>error, µm</span><output class=\"value\" \
             id=\"error\">\u{2013}</output></div>\n"
        }
        None => "",
    };
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta \
         name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<meta \
         name=\"color-scheme\" content=\"light dark\">\n<link rel=\"icon\" \
         href=\"data:,\">\n<title>{name}, live</title>\n<style>\n{LIBRARY_STYLE}{STYLE}</style>\n\
         </head>\n<body>\n<main>\n<header>\n<h1>{name}</h1>\n<p><span id=\"state\" \
         role=\"status\">connecting</span></p>\n</header>\n{note}<div class=\"tiles\">\n<div \
         class=\"tile neutral\"><span>position, mm</span><output class=\"value\" \
         id=\"position\">\u{2013}</output></div>\n{error}<div class=\"tile neutral\"><span>force, \
         N</span><output class=\"value\" id=\"force\">\u{2013}</output></div>\n</div>\n<div \
         class=\"controls\">\n<label>bandwidth <input type=\"range\" id=\"bandwidth\" min=\"1\" \
         max=\"{most}\" step=\"1\" value=\"{bandwidth}\"{disabled}> <output \
         id=\"bandwidth-value\"></output></label>\n<label>step <input type=\"range\" id=\"size\" \
         min=\"-7\" max=\"-2\" step=\"0.1\" value=\"-5\"{disabled}> <output \
         id=\"size-value\"></output></label>\n<button type=\"button\" id=\"back\"{disabled}>step \
         back</button>\n<button type=\"button\" id=\"forth\"{disabled}>step \
         forth</button>\n<button type=\"button\" id=\"record\" \
         aria-pressed=\"false\">record</button>\n<span id=\"said\" role=\"status\"></span>\n\
         </div>\n<div id=\"plots\"></div>\n</main>\n<script>\n/*\nuPlot \
         1.6.32\n{LIBRARY_LICENCE}\n*/\n{LIBRARY}</script>\n<script>\n{SCRIPT}</script>\n\
         </body>\n</html>\n"
    )
}
