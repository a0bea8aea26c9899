//! Map: an empirical curve of force over position, velocity or time, for what no law explains.
//!
//! F(c) along +x on the carriage side (or, where the model says so, on the motor side): linear
//! between equidistant knots, constant beyond the ends; c position (m), velocity (m/s) or time (s
//! since the start). Where the model says `side: friction`, the curve is instead the part by which
//! Coulomb and static friction of all guides are higher, and with `side: viscous` that by which
//! their viscous friction is: no less than -1. With `side: mass` it is the mass that moves with the
//! carriage beyond its own, kg: F = -m(c) a. What is picked up moves as the carriage does already,
//! and what is put down takes its momentum with it (assumed). Source: none, which is the point.
//! Piecewise linear, so that each knot is the force there and a fit is linear in the knots. Over
//! the time it may jump by a height at one place: from there on it is higher than its knots say.
//! Over position the force has a potential; over velocity and time it has none. Not modelled:
//! dependence on two coordinates at once, a second jump.

use crate::model::{Coordinate, Curve, CurveSide, EffectParameters, Jump, ModelError};

use super::{
    Action, CurveValues, EffectDescriptor, EffectParameter, ForceLaw, FrictionLaw, FrictionTerms,
    MassLaw, Motion, Multiplicity, ParameterKind, RecordSpecific, Role, descriptor,
};
use crate::plant::guides::FrictionScale;

/// Values before the knots: coordinate, side, from, to, and the height and the place of the jump,
/// both 0 where there is none.
const HEAD: usize = 6;
const HEIGHT: usize = 4;
const AT: usize = 5;

/// Names of coordinates and sides, in the order of their numbers in a slice of values.
const COORDINATES: [&str; 3] = ["position", "velocity", "time"];
const SIDES: [&str; 5] = ["carriage", "motor", "friction", "viscous", "mass"];

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "map",
    role: Role::CarriageForce,
    law: "F, or a change of friction or mass, is values[(c - from) / (to - from)], linear between \
          equidistant knots, constant beyond; c position, velocity or time",
    source: "none: an empirical curve",
    telltale: "a force, a friction or a mass that repeats over one coordinate and follows no law \
               of the list",
    parameters: &[
        EffectParameter::required("coordinate", "", "what the curve runs over", (0.0, 2.0), 1.0)
            .of_kind(ParameterKind::Choice(&COORDINATES)),
        EffectParameter::optional("side", "", "what the curve is", (0.0, 4.0), 1.0, 0.0)
            .of_kind(ParameterKind::Choice(&SIDES)),
        EffectParameter::required("from", "m, m/s or s", "first knot", (-1e6, 1e6), 0.1),
        EffectParameter::required("to", "m, m/s or s", "last knot", (-1e6, 1e6), 0.1),
        EffectParameter::optional(
            "jump",
            "N or 1",
            "height of a jump; over the time only",
            (-1e6, 1e6),
            1.0,
            0.0,
        ),
        EffectParameter::optional("jump_at", "s", "its place", (-1e6, 1e6), 1.0, 0.0)
            .of_kind(ParameterKind::Instant),
    ],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[],
    check,
    free: |_, index| index >= HEAD,
    build: |values| {
        let curve = curve(values);
        match curve.side {
            CurveSide::Motor => Action::MotorForce(Box::new(Map::new(curve))),
            CurveSide::Carriage => Action::CarriageForce(Box::new(Map::new(curve))),
            CurveSide::Friction | CurveSide::Viscous => Action::Friction(Box::new(Map::new(curve))),
            CurveSide::Mass => Action::VaryingMass(Box::new(Map::new(curve))),
        }
    },
    // Identification draws curves by cross-validation, after all laws.
    proposal: None,
    starts: descriptor::as_proposed,
    curve: Some(CurveValues { curve, values, heights, role: |values| role(side(values)) }),
};

impl EffectParameters {
    /// An empirical curve.
    pub fn map(curve: Curve) -> EffectParameters {
        EffectParameters::of_curve(DESCRIPTOR.name, curve)
    }
}

/// The curve's vector of values.
fn values(curve: &Curve) -> Vec<f64> {
    let coordinate = match curve.coordinate {
        Coordinate::Position => 0.0,
        Coordinate::Velocity => 1.0,
        Coordinate::Time => 2.0,
    };
    let side = match curve.side {
        CurveSide::Carriage => 0.0,
        CurveSide::Motor => 1.0,
        CurveSide::Friction => 2.0,
        CurveSide::Viscous => 3.0,
        CurveSide::Mass => 4.0,
    };
    let Jump { at, height } = curve.jump.unwrap_or(Jump { at: 0.0, height: 0.0 });
    [coordinate, side, curve.from, curve.to, height, at]
        .into_iter()
        .chain(curve.values.iter().copied())
        .collect()
}

/// Places in a vector of values of the heights that make the curve: that of its jump, where there
/// is one, and those of its knots.
fn heights(values: &[f64]) -> Vec<usize> {
    (values[HEIGHT] != 0.0).then_some(HEIGHT).into_iter().chain(HEAD..values.len()).collect()
}

/// The inverse of [`values`].
fn curve(values: &[f64]) -> Curve {
    let coordinate = match values[0] {
        code if code < 0.5 => Coordinate::Position,
        code if code < 1.5 => Coordinate::Velocity,
        _ => Coordinate::Time,
    };
    let jump = (values[HEIGHT] != 0.0).then_some(Jump { at: values[AT], height: values[HEIGHT] });
    Curve {
        coordinate,
        side: side(values),
        from: values[2],
        to: values[3],
        values: values[HEAD..].to_vec(),
        jump,
    }
}

/// What the curve of these values is.
fn side(values: &[f64]) -> CurveSide {
    match values[1] {
        code if code < 0.5 => CurveSide::Carriage,
        code if code < 1.5 => CurveSide::Motor,
        code if code < 2.5 => CurveSide::Friction,
        code if code < 3.5 => CurveSide::Viscous,
        _ => CurveSide::Mass,
    }
}

fn role(side: CurveSide) -> Role {
    match side {
        CurveSide::Carriage => Role::CarriageForce,
        CurveSide::Motor => Role::MotorForce,
        CurveSide::Friction => Role::Friction(FrictionTerms::BRISTLES),
        CurveSide::Viscous => Role::Friction(FrictionTerms::VISCOUS),
        CurveSide::Mass => Role::VaryingMass,
    }
}

/// Where a motion is on a coordinate.
pub fn along(coordinate: Coordinate, motion: &Motion) -> f64 {
    match coordinate {
        Coordinate::Position => motion.position,
        Coordinate::Velocity => motion.velocity,
        Coordinate::Time => motion.time,
    }
}

fn check(values: &[f64]) -> Result<(), ModelError> {
    let refuse = |key: &str, value: f64, limit: String| {
        Err(ModelError::Value { key: key.to_owned(), value, limit })
    };
    if values.len() <= HEAD {
        return refuse(
            "effects.map (number of values)",
            0.0,
            "be at least 2, from and to finite".to_owned(),
        );
    }
    let (from, to, knots) = (values[2], values[3], &values[HEAD..]);
    if !from.is_finite() {
        return refuse("effects.map.from", from, "be finite".to_owned());
    }
    if !(to.is_finite() && to > from) {
        return refuse(
            "effects.map.to",
            to,
            format!("be finite and above `from`, which is {from}"),
        );
    }
    if knots.len() < 2 {
        return refuse(
            "effects.map.values (their number)",
            knots.len() as f64,
            "be at least 2".to_owned(),
        );
    }
    let curve = curve(values);
    if let Some(Jump { at, height }) = curve.jump {
        if !(at.is_finite() && height.is_finite()) {
            return refuse(
                "effects.map.jump",
                if at.is_finite() { height } else { at },
                "be finite".to_owned(),
            );
        }
        if curve.coordinate != Coordinate::Time {
            return refuse("effects.map.jump.at", at, "be given over the time only".to_owned());
        }
    }
    if curve.side.is_of_friction() {
        let limit = || "be at least -1, where no friction is left".to_owned();
        if let Some(index) = knots.iter().position(|value| *value < -1.0) {
            return refuse(&format!("effects.map.values[{index}]"), knots[index], limit());
        }
        if let Some(Jump { height, .. }) = curve.jump {
            let least =
                curve.corners().iter().map(|(_, value)| *value).fold(f64::INFINITY, f64::min);
            if least < -1.0 {
                return refuse(
                    "effects.map.jump.height",
                    height,
                    format!("{}: there it comes to {least}", limit()),
                );
            }
        }
    }
    match knots.iter().position(|value| !value.is_finite()) {
        Some(index) => {
            refuse(&format!("effects.map.values[{index}]"), knots[index], "be finite".to_owned())
        }
        None => Ok(()),
    }
}

#[derive(Debug)]
struct Map {
    curve: Curve,
    /// Knots per unit of the coordinate.
    density: f64,
    /// Integral of the force from the first knot to each, N times the unit of the coordinate.
    integral: Vec<f64>,
}

impl Map {
    fn new(curve: Curve) -> Map {
        let density = (curve.values.len() - 1) as f64 / (curve.to - curve.from);
        let mut integral = vec![0.0];
        for pair in curve.values.windows(2) {
            integral.push(integral[integral.len() - 1] + 0.5 * (pair[0] + pair[1]) / density);
        }
        Map { curve, density, integral }
    }

    fn at(&self, coordinate: f64) -> f64 {
        let (knot, part) = self.curve.locate(coordinate);
        let values = &self.curve.values;
        let jump =
            self.curve.jump.filter(|jump| coordinate >= jump.at).map_or(0.0, |jump| jump.height);
        values[knot] + part * (values[knot + 1] - values[knot]) + jump
    }
}

impl Map {
    fn along(&self, motion: &Motion) -> f64 {
        self.at(along(self.curve.coordinate, motion))
    }

    fn is_over_position(&self) -> bool {
        self.curve.coordinate == Coordinate::Position
    }
}

impl ForceLaw for Map {
    fn force(&mut self, motion: &Motion, _step: f64) -> f64 {
        self.along(motion)
    }

    fn stiffness(&self) -> f64 {
        if !self.is_over_position() {
            return 0.0;
        }
        self.density
            * self.curve.values.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max)
    }

    /// Minus the integral of the force over position from the first knot.
    fn stored_energy(&self, position: f64) -> f64 {
        if !self.is_over_position() {
            return 0.0;
        }
        let (knot, part) = self.curve.locate(position);
        let inside = self.integral[knot]
            + 0.5 * part * (self.curve.values[knot] + self.at(position)) / self.density;
        let beyond = position - position.clamp(self.curve.from, self.curve.to);
        -(inside + beyond * self.at(position))
    }
}

impl FrictionLaw for Map {
    fn scale(&mut self, motion: &Motion, _step: f64, scale: &mut FrictionScale) {
        let factor = 1.0 + self.along(motion);
        if self.curve.side == CurveSide::Viscous {
            scale.viscous *= factor;
        } else {
            scale.coulomb *= factor;
            scale.stat *= factor;
        }
    }
}

impl MassLaw for Map {
    fn mass(&self, motion: &Motion) -> f64 {
        self.along(motion)
    }

    fn least(&self) -> f64 {
        let values = self.curve.corners().into_iter().map(|(_, value)| value);
        values.fold(f64::INFINITY, f64::min)
    }
}

#[cfg(test)]
mod tests {
    use super::super::Effects;
    use super::*;
    use crate::model::StageModel;
    use crate::plant::Body;

    fn tent(coordinate: Coordinate) -> Curve {
        Curve {
            coordinate,
            side: CurveSide::Carriage,
            from: -0.1,
            to: 0.1,
            values: vec![1.0, 4.0, -2.0],
            jump: None,
        }
    }

    #[test]
    fn behind_its_jump_a_curve_is_higher() {
        let given = Curve { jump: Some(Jump { at: 0.05, height: 3.0 }), ..tent(Coordinate::Time) };
        assert_eq!(curve(&values(&given)), given);
        let mut map = Map::new(given);
        for (time, force) in [(0.0, 4.0), (0.0499, 1.006), (0.05, 4.0), (0.1, 1.0), (5.0, 1.0)] {
            let found = map.force(&Motion { time, ..Motion::default() }, 1e-4);
            assert!((found - force).abs() < 1e-12, "{time} s: {found} N, expected {force} N");
        }
    }

    #[test]
    fn force_is_linear_between_the_knots_and_constant_beyond() {
        let mut map = Map::new(tent(Coordinate::Velocity));
        for (velocity, force) in [
            (-0.5, 1.0),
            (-0.1, 1.0),
            (-0.05, 2.5),
            (0.0, 4.0),
            (0.05, 1.0),
            (0.1, -2.0),
            (3.0, -2.0),
        ] {
            let found = map
                .force(&Motion { velocity, position: 7.0, time: 9.0, ..Motion::default() }, 1e-4);
            assert!((found - force).abs() < 1e-12, "{velocity} m/s: {found} N, expected {force} N");
        }
    }

    #[test]
    fn on_the_side_of_friction_it_scales_coulomb_and_static_friction_and_pushes_nothing() {
        let given = Curve {
            side: CurveSide::Friction,
            from: 0.0,
            to: 2.0,
            values: vec![0.0, 0.4, -0.2],
            ..tent(Coordinate::Time)
        };
        assert_eq!(curve(&values(&given)), given);
        let mut effects = Effects::new(&[EffectParameters::map(given.clone())]).unwrap();
        assert_eq!(effects.advance(&Motion { time: 1.0, ..Motion::default() }, 1e-4), (0.0, 0.0));
        let mut map = Map::new(given.clone());
        for (time, expected) in [(0.0, 1.0), (0.5, 1.2), (1.0, 1.4), (2.0, 0.8), (5.0, 0.8)] {
            let motion = Motion { time, velocity: 0.1, ..Motion::default() };
            let mut scale = FrictionScale::ONE;
            map.scale(&motion, 1e-4, &mut scale);
            assert!(
                (scale.coulomb - expected).abs() < 1e-12 && (scale.stat - expected).abs() < 1e-12,
                "{time} s: {scale:?}"
            );
            assert_eq!(scale.viscous, 1.0);
        }
        let message =
            Effects::new(&[EffectParameters::map(Curve { values: vec![0.0, -1.5], ..given })])
                .unwrap_err();
        assert!(
            message.to_string().contains("-1.5") && message.to_string().contains("at least -1"),
            "{message}"
        );
    }

    #[test]
    fn on_the_side_of_viscous_friction_it_scales_that_alone() {
        let given = Curve {
            side: CurveSide::Viscous,
            from: -0.1,
            to: 0.1,
            values: vec![0.0, 0.6],
            ..tent(Coordinate::Position)
        };
        assert_eq!(curve(&values(&given)), given);
        let mut map = Map::new(given);
        let motion = Motion { position: 0.05, velocity: 0.1, ..Motion::default() };
        let mut scale = FrictionScale::ONE;
        map.scale(&motion, 1e-4, &mut scale);
        assert!((scale.viscous - 1.45).abs() < 1e-12, "{scale:?}");
        assert_eq!((scale.coulomb, scale.stat), (1.0, 1.0));
    }

    /// Put down after half a second: from then on the stage moves as one that never had it.
    #[test]
    fn a_mass_moves_with_the_carriage_while_it_is_there() {
        let step = 5e-5;
        let load = |values: Vec<f64>, jump| {
            let (coordinate, side) = (Coordinate::Time, CurveSide::Mass);
            EffectParameters::map(Curve { coordinate, side, from: 0.0, to: 1.0, values, jump })
        };
        let body = |mass: f64, effects: Vec<EffectParameters>| {
            Body::new(&StageModel { mass, effects, ..StageModel::default() }, step)
        };
        let mut put_down = body(
            40.0,
            vec![load(vec![10.0; 2], Some(Jump { at: 0.5 - 0.5 * step, height: -10.0 }))],
        )
        .unwrap();
        let (mut with, mut without) =
            (body(50.0, Vec::new()).unwrap(), body(40.0, Vec::new()).unwrap());
        put_down.advance(300.0, 10_000);
        with.advance(300.0, 10_000);
        assert_eq!((put_down.position(), put_down.velocity()), (with.position(), with.velocity()));
        without.set_state(put_down.position(), put_down.velocity(), put_down.guides().bristles());
        put_down.advance(-200.0, 4_000);
        without.advance(-200.0, 4_000);
        let (is, expected) = (put_down.position(), without.position());
        assert!((is - expected).abs() < 1e-9, "{is} m, {expected} m");
        let message = body(40.0, vec![load(vec![-30.0; 2], Some(Jump { at: 0.5, height: -11.0 }))])
            .unwrap_err();
        assert!(
            message.to_string().contains("41 kg") && message.to_string().contains("40 kg"),
            "{message}"
        );
    }

    #[test]
    fn over_position_the_force_is_the_slope_of_the_stored_energy() {
        let mut map = Map::new(tent(Coordinate::Position));
        for position in [-0.15, -0.07, 0.03, 0.099, 0.2] {
            let h = 1e-6;
            let slope =
                (map.stored_energy(position + h) - map.stored_energy(position - h)) / (2.0 * h);
            let force = map.force(&Motion { position, ..Motion::default() }, 1e-4);
            assert!((force + slope).abs() < 1e-4, "{position} m: {force} {slope}");
        }
    }

    #[test]
    fn values_are_the_curve_and_back() {
        let given =
            EffectParameters::map(Curve { side: CurveSide::Motor, ..tent(Coordinate::Time) });
        let values = DESCRIPTOR.values_of(&given).unwrap();
        assert_eq!(DESCRIPTOR.parameters_of(&values), given);
        assert_eq!(DESCRIPTOR.role_of(&values), Role::MotorForce);
    }

    #[test]
    fn impossible_curves_are_refused_with_the_numbers() {
        let jump = |height| Some(Jump { at: 0.05, height });
        let friction =
            Curve { side: CurveSide::Friction, values: vec![0.0, 0.4], ..tent(Coordinate::Time) };
        let cases: [(Curve, &[&str]); 7] = [
            (
                Curve { jump: jump(1.0), ..tent(Coordinate::Position) },
                &["effects.map.jump", "0.05", "time"],
            ),
            (
                Curve { jump: jump(f64::NAN), ..tent(Coordinate::Time) },
                &["effects.map.jump", "NaN"],
            ),
            (
                Curve { jump: jump(-1.5), ..friction },
                &["effects.map.jump.height", "-1.5", "at least -1", "-1.2"],
            ),
            (Curve { to: -0.2, ..tent(Coordinate::Position) }, &["effects.map.to", "-0.2", "-0.1"]),
            (Curve { from: f64::NAN, ..tent(Coordinate::Position) }, &["effects.map.from", "NaN"]),
            (
                Curve { values: vec![1.0], ..tent(Coordinate::Position) },
                &["values", "1", "at least 2"],
            ),
            (
                Curve { values: vec![1.0, f64::INFINITY], ..tent(Coordinate::Position) },
                &["values[1]", "inf"],
            ),
        ];
        for (curve, expected) in cases {
            let message = Effects::new(&[EffectParameters::map(curve)]).unwrap_err().to_string();
            for words in expected {
                assert!(message.contains(words), "{message:?} without {words:?}");
            }
        }
        let bare = EffectParameters::new("map", [("coordinate", 0.0), ("from", 0.0), ("to", 1.0)]);
        assert!(Effects::new(&[bare]).unwrap_err().to_string().contains("at least 2"));
        let law = EffectParameters {
            curve: Some(tent(Coordinate::Time)),
            ..EffectParameters::new("cogging", [("amplitude", 1.0), ("period", 0.01)])
        };
        assert!(Effects::new(&[law]).is_err());
    }
}
