//! One key of a sweep with the values that it takes: a list, a range or a distribution.

use std::fmt;
use std::str::FromStr;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal, StandardUniform};
use serde::{Deserialize, Serialize};

use super::SweepError;
use crate::variant::variant_seed;

/// A key with the values that it takes: `model.mass=20,40`, `controller.bandwidth=40:80:5`,
/// `model.guides.stiffness=lognormal(17e6,0.1)`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axis {
    /// Dotted path, from `model`, `controller` or `motion` on.
    pub key: String,
    /// Its values.
    pub values: AxisValues,
}

/// A value of a key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum SweepValue {
    /// Yes or no.
    Flag(bool),
    /// A number, SI units.
    Number(f64),
    /// A name: of a guide, of a form of a law.
    Text(String),
}

/// The values of an axis. Numbers in the unit of the key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum AxisValues {
    /// These.
    List(Vec<SweepValue>),
    /// Evenly from one to the other, both included.
    Range {
        /// First value.
        from: f64,
        /// Last value.
        to: f64,
        /// How many, at least 2.
        count: u64,
        /// Evenly in the logarithm.
        logarithmic: bool,
    },
    /// Uniform between two values.
    Uniform {
        /// Lowest value.
        from: f64,
        /// Highest value.
        to: f64,
    },
    /// Uniform in the logarithm.
    LogUniform {
        /// Lowest value, above 0.
        from: f64,
        /// Highest value.
        to: f64,
    },
    /// Gaussian.
    Normal {
        /// Mean.
        mean: f64,
        /// Standard deviation.
        deviation: f64,
    },
    /// Log-normal: the median times e to the power of a Gaussian number.
    LogNormal {
        /// Median, above 0.
        median: f64,
        /// Relative standard deviation of the logarithm.
        deviation: f64,
    },
}

/// Most values of one axis.
const MOST: u64 = 1_000_000;
/// How the values may be given.
const FORMS: &str = "a list `1,2,3`, a range `from:to:count` or `from:to:count:log`, or one of \
                     uniform(from,to), loguniform(from,to), normal(mean,deviation), \
                     lognormal(median,relative deviation)";

impl fmt::Display for SweepValue {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            SweepValue::Flag(flag) => write!(formatter, "{flag}"),
            SweepValue::Number(number) => write!(formatter, "{number}"),
            SweepValue::Text(text) => formatter.write_str(text),
        }
    }
}

impl SweepValue {
    /// The number, where it is one.
    pub fn number(&self) -> Option<f64> {
        if let SweepValue::Number(number) = self { Some(*number) } else { None }
    }

    fn of(text: &str) -> SweepValue {
        match (text, text.parse::<f64>()) {
            ("true", _) => SweepValue::Flag(true),
            ("false", _) => SweepValue::Flag(false),
            (_, Ok(number)) => SweepValue::Number(number),
            _ => SweepValue::Text(text.to_owned()),
        }
    }
}

impl FromStr for Axis {
    type Err = SweepError;

    fn from_str(text: &str) -> Result<Axis, SweepError> {
        let refuse = |reason: String| SweepError::Axis { text: text.to_owned(), reason };
        let (key, values) = text
            .split_once('=')
            .map(|(key, values)| (key.trim(), values.trim()))
            .filter(|(key, values)| !key.is_empty() && !values.is_empty())
            .ok_or_else(|| refuse(format!("must be KEY=VALUES, with {FORMS}")))?;
        let values = values_of(values).map_err(refuse)?;
        let axis = Axis { key: key.to_owned(), values };
        axis.check()?;
        Ok(axis)
    }
}

fn values_of(text: &str) -> Result<AxisValues, String> {
    let number = |text: &str| {
        let text = text.trim();
        text.parse::<f64>().map_err(|_| format!("`{text}` is no number"))
    };
    if let Some((name, rest)) = text.split_once('(') {
        let inner = rest.strip_suffix(')').ok_or("the closing parenthesis is missing")?;
        let (one, other) =
            inner.split_once(',').ok_or_else(|| format!("{name} needs two numbers"))?;
        let (a, b) = (number(one)?, number(other)?);
        return match name.trim() {
            "uniform" => Ok(AxisValues::Uniform { from: a, to: b }),
            "loguniform" => Ok(AxisValues::LogUniform { from: a, to: b }),
            "normal" => Ok(AxisValues::Normal { mean: a, deviation: b }),
            "lognormal" => Ok(AxisValues::LogNormal { median: a, deviation: b }),
            other => Err(format!("`{other}` is no distribution: give {FORMS}")),
        };
    }
    let parts: Vec<&str> = text.split(':').collect();
    match parts[..] {
        [_] => {
            let values = text.split(',').map(|part| SweepValue::of(part.trim())).collect();
            Ok(AxisValues::List(values))
        }
        [from, to, count] | [from, to, count, "log"] => Ok(AxisValues::Range {
            from: number(from)?,
            to: number(to)?,
            count: count.trim().parse().map_err(|_| format!("`{count}` is no number of values"))?,
            logarithmic: parts.len() == 4,
        }),
        _ => Err(format!("give {FORMS}")),
    }
}

impl Axis {
    /// Refuses values that cannot be.
    pub fn check(&self) -> Result<(), SweepError> {
        let refuse = |reason: String| Err(SweepError::Values { key: self.key.clone(), reason });
        match &self.values {
            AxisValues::List(values) if values.is_empty() => refuse("has no values".to_owned()),
            AxisValues::List(values) => {
                let wrong = values.iter().find(|value| match value {
                    SweepValue::Number(number) => !number.is_finite(),
                    SweepValue::Text(text) => text.is_empty(),
                    SweepValue::Flag(_) => false,
                });
                if let Some(value) = wrong {
                    return refuse(format!("has the value `{value}`, must be finite"));
                }
                let numbers = values.iter().filter(|value| value.number().is_some()).count();
                if numbers != 0 && numbers != values.len() {
                    return refuse("mixes numbers and names".to_owned());
                }
                Ok(())
            }
            AxisValues::Range { from, to, count, logarithmic } => {
                if !(2..=MOST).contains(count) {
                    return refuse(format!("is a range of {count} values, must be 2 to {MOST}"));
                }
                self.interval(*from, *to, *logarithmic)
            }
            AxisValues::Uniform { from, to } => self.interval(*from, *to, false),
            AxisValues::LogUniform { from, to } => self.interval(*from, *to, true),
            AxisValues::Normal { mean, deviation } => {
                if !(mean.is_finite() && deviation.is_finite() && *deviation > 0.0) {
                    return refuse(format!(
                        "is normal({mean},{deviation}), the deviation must be greater than 0"
                    ));
                }
                Ok(())
            }
            AxisValues::LogNormal { median, deviation } => {
                let right = median.is_finite() && *median > 0.0 && *deviation > 0.0;
                if !(right && *deviation <= 2.0) {
                    return refuse(format!(
                        "is lognormal({median},{deviation}), the median must be greater than 0 \
                         and the relative deviation greater than 0 and at most 2"
                    ));
                }
                Ok(())
            }
        }
    }

    fn interval(&self, from: f64, to: f64, positive: bool) -> Result<(), SweepError> {
        let finite = from.is_finite() && to.is_finite() && from != to;
        if finite && (!positive || (from > 0.0 && to > 0.0)) {
            return Ok(());
        }
        let limit = if positive { "two numbers greater than 0" } else { "two finite numbers" };
        let reason = format!("runs from {from} to {to}, must be between {limit} that differ");
        Err(SweepError::Values { key: self.key.clone(), reason })
    }

    /// Whether each sample draws its value.
    pub fn is_drawn(&self) -> bool {
        !matches!(self.values, AxisValues::List(_) | AxisValues::Range { .. })
    }

    /// Values on the grid; 1 for a distribution.
    pub fn count(&self) -> u64 {
        match &self.values {
            AxisValues::List(values) => values.len() as u64,
            AxisValues::Range { count, .. } => *count,
            _ => 1,
        }
    }

    /// Whether its values are numbers.
    pub fn is_numeric(&self) -> bool {
        match &self.values {
            AxisValues::List(values) => values.iter().all(|value| value.number().is_some()),
            _ => true,
        }
    }

    /// The value at a place of the grid, or of a numbered sample. A draw depends on seed, key and
    /// number of the sample alone.
    pub fn value(&self, place: u64, seed: u64, sample: u64) -> SweepValue {
        let random =
            || ChaCha8Rng::seed_from_u64(variant_seed(seed, &format!("axis {}", self.key), sample));
        let part = |random: &mut ChaCha8Rng| -> f64 { StandardUniform.sample(random) };
        let gauss = |random: &mut ChaCha8Rng| -> f64 { StandardNormal.sample(random) };
        let logarithm = |from: f64, to: f64, part: f64| from * (part * (to / from).ln()).exp();
        SweepValue::Number(match &self.values {
            AxisValues::List(values) => {
                return values[(place as usize).min(values.len() - 1)].clone();
            }
            // Both ends exactly.
            AxisValues::Range { from, .. } if place == 0 => *from,
            AxisValues::Range { to, count, .. } if place + 1 >= *count => *to,
            AxisValues::Range { from, to, count, logarithmic } => {
                let part = place as f64 / (count - 1) as f64;
                if *logarithmic { logarithm(*from, *to, part) } else { from + (to - from) * part }
            }
            AxisValues::Uniform { from, to } => from + (to - from) * part(&mut random()),
            AxisValues::LogUniform { from, to } => logarithm(*from, *to, part(&mut random())),
            AxisValues::Normal { mean, deviation } => mean + deviation * gauss(&mut random()),
            AxisValues::LogNormal { median, deviation } => {
                median * (deviation * gauss(&mut random())).exp()
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(text: &str) -> Vec<f64> {
        let axis: Axis = text.parse().unwrap();
        (0..axis.count()).map(|at| axis.value(at, 1, 0).number().unwrap()).collect()
    }

    #[test]
    fn ranges_have_both_their_ends() {
        assert_eq!(numbers("model.mass=10:30:3"), [10.0, 20.0, 30.0]);
        let found = numbers("model.mass=1e-6:1e-2:5:log");
        for (found, expected) in found.iter().zip([1e-6f64, 1e-5, 1e-4, 1e-3, 1e-2]) {
            assert!((found / expected - 1.0).abs() < 1e-12, "{found}");
        }
        assert_eq!((found[0], found[4]), (1e-6, 1e-2));
        assert_eq!(numbers("a=3,1"), [3.0, 1.0]);
    }

    #[test]
    fn draws_have_the_moments_of_their_distribution_and_repeat() {
        let moments = |text: &str, of: fn(f64) -> f64| {
            let axis: Axis = text.parse().unwrap();
            let drawn: Vec<f64> =
                (0..20_000).map(|k| of(axis.value(0, 7, k).number().unwrap())).collect();
            assert_eq!(of(axis.value(0, 7, 3).number().unwrap()), drawn[3]);
            let mean = drawn.iter().sum::<f64>() / drawn.len() as f64;
            let squares = drawn.iter().map(|x| (x - mean).powi(2)).sum::<f64>();
            (mean, (squares / drawn.len() as f64).sqrt())
        };
        let near = |(mean, deviation): (f64, f64), m: f64, d: f64| {
            assert!((mean - m).abs() < 0.03 * d && (deviation / d - 1.0).abs() < 0.03);
        };
        near(moments("a=normal(60,5)", |x| x), 60.0, 5.0);
        near(moments("a=lognormal(17e6,0.1)", f64::ln), 17e6f64.ln(), 0.1);
        near(moments("a=uniform(2,4)", |x| x), 3.0, 2.0 / 12f64.sqrt());
        near(
            moments("a=loguniform(1,100)", f64::ln),
            100f64.ln() / 2.0,
            100f64.ln() / 12f64.sqrt(),
        );
    }

    #[test]
    fn values_that_cannot_be_are_refused_with_what_would_be_right() {
        for (text, words) in [
            ("model.mass", "KEY=VALUES"),
            ("model.mass=", "KEY=VALUES"),
            ("a=1:2", "from:to:count"),
            ("a=1:2:1", "2 to"),
            ("a=1:2:x", "no number of values"),
            ("a=0:2:3:log", "greater than 0"),
            ("a=gauss(1,2)", "no distribution"),
            ("a=normal(1", "parenthesis"),
            ("a=normal(1)", "two numbers"),
            ("a=normal(1,0)", "greater than 0"),
            ("a=lognormal(-1,0.1)", "greater than 0"),
            ("a=uniform(1,1)", "differ"),
            ("a=1,nan", "finite"),
            ("a=1,guide_1", "mixes"),
        ] {
            let error = text.parse::<Axis>().unwrap_err().to_string();
            assert!(error.contains(words), "{text}: {error}");
        }
    }
}
