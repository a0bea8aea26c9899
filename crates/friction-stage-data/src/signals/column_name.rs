//! What the name of a column says: which quantity it is, whether it was measured or asked for, of
//! which axis, and in which unit.
//!
//! Names are those that drives, loggers and people give: words of several languages, compounds
//! (`Lageistwert`, `actPosition`), paths (`/joint_states/x/position`, `force.Data`), quantities
//! over their units (`x/mm`).

use super::unit::Unit;

/// Which quantity a name speaks of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Quantity {
    Time,
    Position,
    Velocity,
    Acceleration,
    /// A force or a torque.
    Force,
    /// The force of a sensor of its own.
    ForceCell,
    /// A current, which counts as the force of the motor.
    Current,
}

/// What a value is of a quantity.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    /// It is said to be measured.
    Measured,
    /// It is what was asked for.
    Asked,
    /// It follows from others, or is none of a motion: an error, a state, a temperature.
    Other,
    /// Nothing is said.
    Unsaid,
}

/// What a name says.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ColumnName {
    pub quantity: Option<Quantity>,
    pub role: Role,
    /// Whether it has a word at all.
    pub has_words: bool,
    /// Numbers and letters that tell an axis from others, in order.
    axis: Vec<String>,
}

/// A word of a name that says something: as it is, or with `*` where more may come before or after
/// it.
type Words = &'static [&'static str];

const TIME: Words = &[
    "t", "time*", "*time", "stamp", "*zeit*", "temps", "clock", "secs", "seconds", "sekunden",
    "tiempo", "tempo", "tijd",
];
const POSITION: Words = &[
    "x",
    "q",
    "qm",
    "*position*",
    "pos",
    "posn",
    "actpos",
    "setpos",
    "cmdpos",
    "posact",
    "posset",
    "pfbk",
    "pcmd",
    "encoder",
    "enc",
    "*displacement*",
    "travel",
    "stroke",
    "distance",
    "angle",
    "*lage",
    "lageist*",
    "lagesoll*",
    "lagewert*",
    "*weg",
    "*winkel*",
    "*verschiebung*",
    "deplacement",
    "course",
    "posicion",
    "posizione",
    "desplazamiento",
    "spostamento",
];
const VELOCITY: Words = &[
    "v",
    "vel",
    "*velocity*",
    "*speed*",
    "vfbk",
    "vcmd",
    "actvel",
    "setvel",
    "*geschwindigkeit*",
    "*drehzahl*",
    "vitesse",
    "velocidad",
    "velocita",
    "omega",
];
const ACCELERATION: Words = &["acc", "accel", "*acceleration*", "*beschleunigung*", "jerk", "ruck"];
const FORCE: Words = &[
    "*force*",
    "*torque*",
    "effort",
    "*kraft*",
    "moment",
    "*drehmoment*",
    "thrust",
    "trq",
    "tcmd",
    "tfbk",
    "fuerza",
    "forza",
    "couple",
    "fx",
    "fy",
    "fz",
];
const CELL: Words =
    &["cell", "*loadcell*", "*kraftsensor*", "*kraftaufnehmer*", "dynamometer", "messdose"];
const CURRENT: Words = &[
    "current",
    "curr",
    "iq",
    "icmd",
    "ifbk",
    "*strom*",
    "courant",
    "amp",
    "amps",
    "ampere",
    "amperes",
    "corriente",
];
/// Words and letters that name the drive of an axis, where no other word says a quantity.
const DRIVE: Words = &["f", "u", "i", "motor"];

const ASKED: Words = &[
    "set",
    "*setpoint*",
    "sp",
    "setpos",
    "setvel",
    "ref",
    "*reference*",
    "cmd",
    "*command*",
    "pcmd",
    "vcmd",
    "icmd",
    "tcmd",
    "cmdpos",
    "*demand*",
    "*desired*",
    "*target*",
    "*soll*",
    "nominal",
    "qg",
    "consigne",
    "profile",
    "trajectory",
    "traj",
    "planned",
    "interpolated",
    "goal",
    "posset",
];
const MEASURED: Words = &[
    "actual",
    "act",
    "actpos",
    "actvel",
    "posact",
    "ist",
    "*istwert*",
    "ist*",
    "meas",
    "measured",
    "*feedback*",
    "fbk",
    "fb",
    "pfbk",
    "vfbk",
    "ifbk",
    "tfbk",
    "mesure",
    "mesuree",
    "reel",
    "gemessen",
    "encoder",
    "enc",
    "sensor",
];
const OTHER: Words = &[
    "*error*",
    "err",
    "*deviation*",
    "lag",
    "following",
    "*schlepp*",
    "*abweichung*",
    "*fehler*",
    "ecart",
    "*difference*",
    "diff",
    "status",
    "temperature",
    "*temperatur*",
];

/// Words before a number that count axes, besides those for a quantity: other numbers are of
/// channels, parameters and types of devices.
const COUNTED: Words = &[
    "ax",
    "axis",
    "axes",
    "axe",
    "achse",
    "achsen",
    "joint",
    "joints",
    "gelenk",
    "drive",
    "antrieb",
    "motor",
    "stage",
    "slide",
    "schlitten",
    "eje",
    "asse",
];

/// Letters that axes have.
const AXES: &[&str] = &["x", "y", "z", "a", "b", "c", "u", "v", "w"];

fn is_one_of(word: &str, known: Words) -> bool {
    known.iter().any(|known| {
        let stem = known.trim_matches('*');
        match (known.starts_with('*'), known.ends_with('*')) {
            (true, true) => word.contains(stem),
            (true, false) => word.ends_with(stem),
            (false, true) => word.starts_with(stem),
            (false, false) => word == stem,
        }
    })
}

impl ColumnName {
    pub(super) fn of(name: &str) -> ColumnName {
        let bare = without_unit(name);
        // Of a path its last part that says something counts.
        let parts: Vec<Vec<String>> =
            bare.split(['/', '.', ':', '|', '>']).map(tokens).filter(|p| !p.is_empty()).collect();
        let last = |of: fn(&[String]) -> Option<Quantity>| {
            parts.iter().enumerate().rev().find_map(|(at, part)| Some((at, of(part)?)))
        };
        // A letter is a part of a vector, as in `force/x`, where a word says the quantity.
        let (at, quantity) = last(quantity_of_words)
            .or_else(|| last(quantity_of_letters))
            .map_or((None, None), |(at, quantity)| (Some(at), Some(quantity)));
        let all = || parts.iter().flatten();
        let says = |known: Words| all().any(|word| is_one_of(word, known));
        let role = if says(OTHER) {
            Role::Other
        } else if says(ASKED) || parts.iter().any(|part| ends_with_des(part)) {
            Role::Asked
        } else if says(MEASURED) {
            Role::Measured
        } else {
            Role::Unsaid
        };
        let is_word = |token: &String| token.chars().all(char::is_alphabetic);
        let mut axis = Vec::new();
        let mut before = "";
        for (index, part) in parts.iter().enumerate() {
            // The letter that says the quantity tells no axis.
            let mut own = (Some(index) == at).then(|| letter_of(part)).flatten();
            for token in part {
                let is_axis = AXES.contains(&token.as_str());
                let is_number = !is_word(token) && counts_axes(before);
                if is_axis && own.as_deref() == Some(token) {
                    own = None;
                } else if is_axis || is_number {
                    axis.push(token.clone());
                } else if let Some(letter) = force_axis(token) {
                    axis.push(letter.to_owned());
                }
                before = token;
            }
        }
        ColumnName { quantity, role, has_words: all().any(is_word), axis }
    }

    /// Whether both names tell their axis, and not the same one.
    pub(super) fn is_of_other_axis(&self, other: &ColumnName) -> bool {
        !self.axis.is_empty() && !other.axis.is_empty() && self.axis != other.axis
    }

    /// Whether both names tell the same axis.
    pub(super) fn is_of_same_axis(&self, other: &ColumnName) -> bool {
        !self.axis.is_empty() && self.axis == other.axis
    }
}

/// Whether a number behind a word tells an axis.
fn counts_axes(word: &str) -> bool {
    let quantities =
        [TIME, POSITION, VELOCITY, ACCELERATION, FORCE, CELL, CURRENT, DRIVE, ASKED, MEASURED];
    is_one_of(word, COUNTED) || quantities.iter().any(|known| is_one_of(word, known))
}

/// Whether a part of a name ends with `des` for `desired`, as `x_des`: before another word it is an
/// article in German and French.
fn ends_with_des(tokens: &[String]) -> bool {
    let words = tokens.iter().rfind(|token| token.chars().all(char::is_alphabetic));
    words.is_some_and(|word| word == "des")
}

/// The axis of a force along one, such as `Fx`.
fn force_axis(token: &str) -> Option<&str> {
    token.strip_prefix('f').filter(|axis| ["x", "y", "z"].contains(axis))
}

fn is_letter(token: &str) -> bool {
    token.chars().count() == 1
}

/// The quantity of a part of a name: its last word that is one. A current counts where nothing else
/// does, since `current` is also an adjective. A part that is `t` and nothing else is a time.
fn quantity_of_words(tokens: &[String]) -> Option<Quantity> {
    if tokens == ["t"] {
        return Some(Quantity::Time);
    }
    let words = || tokens.iter().rev().filter(|token| !is_letter(token));
    let of_word = |word: &String| {
        [
            (CELL, Quantity::ForceCell),
            (TIME, Quantity::Time),
            (ACCELERATION, Quantity::Acceleration),
            (VELOCITY, Quantity::Velocity),
            (FORCE, Quantity::Force),
            (POSITION, Quantity::Position),
        ]
        .into_iter()
        .find_map(|(known, quantity)| is_one_of(word, known).then_some(quantity))
    };
    let is_current = || words().any(|word| is_one_of(word, CURRENT));
    words().find_map(of_word).or_else(|| is_current().then_some(Quantity::Current))
}

/// The quantity of a part of a name without such a word: by its first letter that is one, as in
/// `F_x`, or by the word `motor`.
fn quantity_of_letters(tokens: &[String]) -> Option<Quantity> {
    let has_drive = tokens.iter().any(|token| !is_letter(token) && is_one_of(token, DRIVE));
    match letter_of(tokens).as_deref() {
        Some("t") => Some(Quantity::Time),
        Some("x" | "q") => Some(Quantity::Position),
        Some("v") => Some(Quantity::Velocity),
        Some("i") => Some(Quantity::Current),
        Some(_) => Some(Quantity::Force),
        None => has_drive.then_some(Quantity::Force),
    }
}

/// The first single letter that says a quantity.
fn letter_of(tokens: &[String]) -> Option<String> {
    let says = |word: &&String| {
        is_letter(word)
            && [TIME, POSITION, VELOCITY, DRIVE].iter().any(|known| is_one_of(word, known))
    };
    tokens.iter().find(says).cloned()
}

/// Words and numbers of a text, in small letters without accents: `posActual_mm2` has pos, actual,
/// mm, 2.
fn tokens(text: &str) -> Vec<String> {
    let mut tokens = vec![String::new()];
    let mut before = ' ';
    for c in text.chars() {
        let begins = c.is_uppercase() && before.is_lowercase();
        let changes = c.is_alphabetic() != before.is_alphabetic();
        if !c.is_alphanumeric() || begins || changes {
            tokens.push(String::new());
        }
        if c.is_alphanumeric() {
            let last = tokens.last_mut();
            last.into_iter().for_each(|token| token.extend(c.to_lowercase().map(plain)));
        }
        before = c;
    }
    tokens.retain(|token| !token.is_empty());
    tokens
}

/// A letter without its accent.
fn plain(c: char) -> char {
    match c {
        'à' | 'á' | 'â' | 'ã' => 'a',
        'è' | 'é' | 'ê' | 'ë' => 'e',
        'ì' | 'í' | 'î' | 'ï' => 'i',
        'ò' | 'ó' | 'ô' | 'õ' => 'o',
        'ù' | 'ú' | 'û' => 'u',
        'ç' => 'c',
        'ñ' => 'n',
        c => c,
    }
}

/// A name without the unit that it ends with, and what stands around it, or without what it has in
/// brackets at its end, such as the index of an array.
fn without_unit(name: &str) -> &str {
    let unit = unit_of_name(name);
    let is_closed = name.trim_end().ends_with([']', ')', '}', '>']);
    let begin = match unit.is_empty() {
        // A number in brackets tells the axis.
        true => name
            .rfind(['[', '(', '{', '<'])
            .filter(|at| is_closed && !name[*at..].chars().any(|c| c.is_ascii_digit())),
        false => name.rfind(unit),
    };
    let bare = begin.filter(|at| *at > 0).map_or(name, |at| &name[..at]);
    let bare = bare.trim_end_matches(|c: char| !c.is_alphanumeric());
    bare.strip_suffix(" in").unwrap_or(bare)
}

/// The unit that a name ends with, behind a mark or the word `in`: `t_ms`, `x/mm` (a quantity over
/// its unit, as DIN 1313 has it), `stroke, mm`, `F {kN}`, `Position..mm.`; empty where it has none.
pub(super) fn unit_of_name(name: &str) -> &str {
    let is_unit = |text: &str| {
        let is_letter = ["n", "a"].contains(&text);
        Unit::named(text).is_some() || !is_letter && unit_of_suffix(text).is_some()
    };
    let closing = |c: char| matches!(c, ']' | ')' | '}' | '>' | '_' | '.' | ' ');
    let name = name.trim_end_matches(closing);
    if is_unit(name) {
        return "";
    }
    if let Some(unit) = unit_of_letter(name) {
        return unit;
    }
    // The longest that is one: `v m/s`, not the `s` of it.
    name.char_indices()
        .filter(|(_, c)| matches!(c, '[' | '(' | '{' | '<' | '_' | '.' | ',' | '/' | ' '))
        .map(|(at, c)| (c, name[..at].trim(), name[at + c.len_utf8()..].trim()))
        .find(|(mark, before, unit)| {
            let quantity = before.trim_end_matches(|c: char| !c.is_alphanumeric());
            let is_over = *mark == '/';
            // What stands over the unit may be one itself: `stiffness_N/mm` is in N/mm.
            let last = quantity.rsplit(|c: char| !c.is_alphanumeric()).next().unwrap_or_default();
            // `m/s` is a unit over another one, and a path has words behind its strokes.
            let is_quantity = !quantity.is_empty()
                && !(is_over && (is_unit(last) || quantity.contains([' ', '/'])));
            let is_said = match mark {
                ' ' => quantity.ends_with(" in") || before.ends_with(','),
                // `x_d` is a desired one, `x_1` the first, `pos_in` an input.
                '_' | '.' => !["d", "h", "min", "g", "1", "in"].contains(unit),
                // A number in brackets is an index.
                _ => *unit != "1",
            };
            is_quantity && is_said && is_unit(unit)
        })
        .map_or("", |(.., unit)| unit)
}

/// The unit of a name that ends with a small letter for it: only behind a word for what is measured
/// in it, since `x_a` and `x_n` may be the actual and the nominal one.
fn unit_of_letter(name: &str) -> Option<&'static str> {
    let (quantity, letter) = name.rsplit_once('_')?;
    let quantity = quantity_of_words(&tokens(quantity))?;
    match (quantity, letter) {
        (Quantity::Force | Quantity::ForceCell, "n") => Some("n"),
        (Quantity::Current, "a") => Some("a"),
        _ => None,
    }
}

/// The unit that the last words of a name in small letters with strokes below stand for, such as
/// `m_s` or `n`.
pub(super) fn unit_of_suffix(suffix: &str) -> Option<&'static str> {
    const WRITTEN: &[(&str, &str)] = &[
        ("kn", "kN"),
        ("n", "N"),
        ("a", "A"),
        ("m_s", "m/s"),
        ("mm_s", "mm/s"),
        ("rad_s", "rad/s"),
        ("deg_s", "deg/s"),
        ("m_s2", "m/s^2"),
        ("mm_s2", "mm/s^2"),
    ];
    WRITTEN.iter().find(|(written, _)| *written == suffix).map(|(_, unit)| *unit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use Quantity::{Acceleration, Current, Force, ForceCell, Position, Time, Velocity};
    use Role::{Asked, Measured, Other, Unsaid};

    #[test]
    fn names_say_quantity_and_role() {
        for (name, quantity, role) in [
            ("t", Some(Time), Unsaid),
            ("Zeit [s]", Some(Time), Unsaid),
            ("force.Time", Some(Time), Unsaid),
            ("force.Data", Some(Force), Unsaid),
            ("force.t", Some(Time), Unsaid),
            ("/stage/force/wrench/force/x", Some(Force), Unsaid),
            ("/joint_states/x/position", Some(Position), Unsaid),
            ("posActual_mm", Some(Position), Measured),
            ("Lageistwert", Some(Position), Measured),
            ("PositionSollwert", Some(Position), Asked),
            ("Consigne de position", Some(Position), Asked),
            ("Position mesurée", Some(Position), Measured),
            ("Schleppabstand", None, Other),
            ("Position difference", Some(Position), Other),
            ("Motor (Actual) Position", Some(Position), Measured),
            ("CurrentPosition", Some(Position), Unsaid),
            ("CurrentAcceleration", Some(Acceleration), Unsaid),
            ("Motor Current (A)", Some(Current), Unsaid),
            ("Profile velocity", Some(Velocity), Asked),
            ("IL.CMD (Arms)", None, Asked),
            ("PFBK", Some(Position), Measured),
            ("Velocity actual value", Some(Velocity), Measured),
            ("Istdrehzahl", Some(Velocity), Measured),
            ("F_x", Some(Force), Unsaid),
            ("F_cell", Some(ForceCell), Unsaid),
            ("x", Some(Position), Unsaid),
            ("Status", None, Other),
            ("Momentanwert", None, Unsaid),
            ("Kraft-Sollwert", Some(Force), Asked),
            ("x_des", Some(Position), Asked),
            ("Position des Schlittens (mm)", Some(Position), Unsaid),
            ("position centimeters", Some(Position), Unsaid),
            ("Lagerkraft", Some(Force), Unsaid),
            ("a3", None, Unsaid),
        ] {
            let said = ColumnName::of(name);
            assert_eq!((said.quantity, said.role), (quantity, role), "{name}: {said:?}");
        }
    }

    #[test]
    fn names_tell_axes_apart() {
        let other = |a: &str, b: &str| ColumnName::of(a).is_of_other_axis(&ColumnName::of(b));
        for (a, b) in [
            ("Ax2 position", "Ax1 force"),
            ("/joint_states/x/position", "/joint_states/y/effort"),
            ("Axis1.SetPos", "Axis2.ActPos"),
            ("x1", "F2"),
            ("Fx", "Fy"),
            ("pos_2", "force_1"),
            ("q[1]", "q[2]"),
        ] {
            assert!(other(a, b), "{a} {b}");
        }
        for (a, b) in [
            ("position", "force 2"),
            ("x_mm", "F_N"),
            ("Ax2 position", "Ax2 force"),
            ("Channel 1: Position", "Channel 2: Torque"),
            ("Weg_WA20", "Kraft_S2M"),
            ("r2665 position", "r31 torque"),
            ("AI 1/Weg", "AI 2/Force"),
            ("x", "u"),
        ] {
            assert!(!other(a, b), "{a} {b}");
        }
    }

    #[test]
    fn a_unit_stands_behind_a_mark() {
        for (name, unit) in [
            ("t_ms", "ms"),
            ("x/mm", "mm"),
            ("v / (mm/s)", "mm/s"),
            ("stroke, mm", "mm"),
            ("Kraft, kN", "kN"),
            ("Weg in mm", "mm"),
            ("F {kN}", "kN"),
            ("Position..mm.", "mm"),
            ("x_mm_", "mm"),
            ("x_d", ""),
            ("velocity_m_s", "m_s"),
            ("force_cell_n", "n"),
            ("stiffness_N/mm", ""),
            ("velocity_cm/s", "cm/s"),
            ("pos_1", ""),
            ("x_n", ""),
            ("pos_in", ""),
            ("v m/s", ""),
            ("m/s", ""),
            ("rows per s", ""),
            ("time", ""),
            ("/axis/x/m", ""),
            ("force", ""),
        ] {
            assert_eq!(unit_of_name(name), unit, "{name}");
        }
    }
}
