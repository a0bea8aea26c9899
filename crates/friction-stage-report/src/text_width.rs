//! How wide a text is in a drawing, which no browser has set yet.
//!
//! The widths are those of DejaVu Sans, the widest of the usual fonts without serifs: in another
//! one there is a little room left.

/// Size of a font of a drawing over that which the document states, by which plotters divides.
const STATED: f64 = 1.24;

/// Width of a text, px, in a font of this size of a drawing, px.
pub(crate) fn text_width(text: &str, size: f64) -> f64 {
    text.chars().map(part).sum::<f64>() * size / STATED
}

/// Width of a character as a part of the size of its font.
fn part(character: char) -> f64 {
    match character {
        'i' | 'j' | 'l' | '\'' | 'I' => 0.29,
        ' ' | '\u{a0}' | '.' | ',' | ':' | ';' | '|' | '/' => 0.33,
        'f' | 't' | 'r' | '(' | ')' | '-' | '[' | ']' => 0.40,
        'c' | 's' | 'z' | '\u{201c}' | '\u{201d}' => 0.53,
        'm' | 'w' | 'M' | 'W' | '%' | '\u{2026}' => 0.95,
        'N' | 'O' | 'Q' | 'H' | 'D' | 'G' | 'U' | '\u{d7}' | '\u{2212}' | '+' | '=' | '<' => 0.80,
        character if character.is_uppercase() => 0.69,
        _ => 0.62,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_is_as_wide_as_a_browser_sets_it() {
        // DejaVu Sans at 13/1.24 px, measured in chromium.
        for (text, width) in
            [("9.98 Hz at 0.04 N", 91.6), ("guide 1 (sealed)", 85.1), ("500", 20.0)]
        {
            let found = text_width(text, 13.0);
            assert!((0.95 * width..1.2 * width).contains(&found), "{text}: {found}");
        }
    }
}
