//! `~/identify_loop`: measures the loop of a running stage as a drive's autotuner does.
//!
//! A request becomes a plan of sines, worked out from the parameters. The node's loop adds them to
//! its force while it holds its position. The measurement ends at once where the stage is not as it
//! should be; the loop itself continues, so that the stage is held. The request gets what was
//! measured, writes it to a file and answers with the margins.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use futures::channel::mpsc::UnboundedSender;
use futures::future::BoxFuture;
use tokio::sync::oneshot;

use super::lock::lock;
use super::parameters::{ParameterSet, ParameterSpec, ParameterValues};
use friction_stage_core::control::{ControllerSettings, Reference, Terms};
use friction_stage_lab::{COHERENT, LoopProbe, LoopSine, Margins, MeasuredLoop};

/// Largest sine, as a part of the largest force. Assumed: leaves the controller most of the motor,
/// although its own force swings with up to twice the sine.
const LARGEST_SINE: f64 = 0.2;
/// Highest frequency, as a part of the sampling rate: 2.5 samples in a period. Assumed.
const HIGHEST: f64 = 0.4;
/// A measurement fails after this many times its planned time, and this much more.
const PATIENCE: (f64, Duration) = (10.0, Duration::from_secs(10));

/// The parameters of the service.
pub fn specs() -> [ParameterSpec; 8] {
    [
        ParameterSpec::boolean(
            "identify_loop.enabled",
            false,
            "whether ~/identify_loop may move the stage",
        ),
        ParameterSpec::double(
            "identify_loop.force",
            20.0,
            "amplitude of the sines; at most a fifth of the largest force",
        )
        .unit("N")
        .range(1e-6, 1e6),
        ParameterSpec::double("identify_loop.lowest", 10.0, "lowest frequency")
            .unit("Hz")
            .range(0.1, 10_000.0),
        ParameterSpec::double(
            "identify_loop.highest",
            400.0,
            "highest frequency; at most 0.4 of the rate",
        )
        .unit("Hz")
        .range(0.1, 10_000.0),
        ParameterSpec::integer(
            "identify_loop.points",
            20,
            "number of frequencies, even in their logarithm",
        )
        .range(3.0, 200.0),
        ParameterSpec::double("identify_loop.duration", 60.0, "longest time of a measurement")
            .unit("s")
            .range(0.1, 600.0),
        ParameterSpec::double(
            "identify_loop.error",
            1e-4,
            "largest position error of a measurement, which ends beyond it",
        )
        .unit("m")
        .range(1e-9, 1.0),
        ParameterSpec::string(
            "identify_loop.directory",
            "",
            "directory of the files; empty: where the node was started",
        ),
    ]
}

/// What is to be measured.
#[derive(Debug)]
pub struct Plan {
    sines: Vec<LoopSine>,
    /// N
    force: f64,
    /// Largest position error, m.
    error: f64,
    /// s
    duration: f64,
    directory: PathBuf,
}

/// A request to the node's loop, and who waits for what was measured.
#[derive(Debug)]
pub struct Wish {
    plan: Plan,
    reply: oneshot::Sender<Result<MeasuredLoop, String>>,
}

impl Wish {
    /// Answers that nothing is measured, and why.
    pub fn refuse(self, why: &str) {
        // Who asked may have gone.
        let _ = self.reply.send(Err(why.to_owned()));
    }
}

impl Plan {
    /// What the parameters of a controller ask for.
    fn of(values: &ParameterValues, settings: &ControllerSettings) -> Result<Plan, String> {
        if !values.boolean("identify_loop.enabled") {
            return Err("identify_loop.enabled is false: set it to true where the stage may be \
                        moved"
                .to_owned());
        }
        let force = values.double("identify_loop.force");
        let limit = LARGEST_SINE * settings.limits.1.min(-settings.limits.0);
        if force > limit {
            return Err(format!(
                "identify_loop.force is {force} N, must be at most {limit} N: a fifth of the \
                 largest force"
            ));
        }
        let (lowest, highest) =
            (values.double("identify_loop.lowest"), values.double("identify_loop.highest"));
        let most = HIGHEST * settings.rate;
        if !(lowest < highest && highest <= most) {
            return Err(format!(
                "identify_loop.lowest is {lowest} Hz and identify_loop.highest {highest} Hz: the \
                 first must be below the second, and the second at most {most} Hz, which is \
                 {HIGHEST} of the rate"
            ));
        }
        let count = usize::try_from(values.integer("identify_loop.points")).unwrap_or(3).max(3);
        let at = |k: usize| lowest * (highest / lowest).powf(k as f64 / (count - 1) as f64);
        let sines: Vec<LoopSine> =
            (0..count).map(|k| LoopSine { frequency: at(k), force }).collect();
        let duration = sines.iter().map(LoopSine::duration).sum();
        let longest = values.double("identify_loop.duration");
        if duration > longest {
            return Err(format!(
                "{count} frequencies from {lowest} Hz take {duration:.1} s, and \
                 identify_loop.duration allows {longest} s: take fewer, begin higher, or allow more"
            ));
        }
        let directory = PathBuf::from(values.string("identify_loop.directory"));
        if !(directory.as_os_str().is_empty() || directory.is_dir()) {
            return Err(format!(
                "identify_loop.directory is {}, which is no directory",
                directory.display()
            ));
        }
        Ok(Plan { sines, force, error: values.double("identify_loop.error"), duration, directory })
    }
}

/// A measurement that the node's loop carries out.
#[derive(Debug)]
pub struct Measurement {
    probe: LoopProbe,
    wish: Wish,
    /// Stamp of its first sample, ns.
    begin: Option<i64>,
    settings: ControllerSettings,
    reference: Reference,
}

/// What a measurement asks for after a sample.
pub enum Progress {
    /// This force is added to the controller's, N.
    Add(f64),
    Over,
    /// It ends here, and why.
    Failed(String),
}

impl Measurement {
    /// Begins with the next sample, for a controller that holds at `reference`.
    pub fn new(wish: Wish, settings: &ControllerSettings, reference: Reference) -> Measurement {
        let probe = LoopProbe::new(wish.plan.sines.clone(), settings.rate);
        Measurement { probe, wish, begin: None, settings: settings.clone(), reference }
    }

    /// Takes the sample at `stamp` (ns) with what the controller made of it.
    pub fn update(&mut self, stamp: i64, terms: &Terms, settings: &ControllerSettings) -> Progress {
        let at = self.probe.sine().map_or(0.0, |sine| sine.frequency);
        let failed = |why: String| Progress::Failed(format!("at {at:.1} Hz {why}"));
        if self.wish.reply.is_closed() {
            return failed("the request was cancelled".to_owned());
        }
        if !terms.holding || terms.reference.position != self.reference.position {
            return failed("a motion began".to_owned());
        }
        if *settings != self.settings {
            return failed(
                "the gains changed, by a parameter or because samples came late".to_owned(),
            );
        }
        let error = terms.error.abs();
        // Also where it is no number.
        if error.is_nan() || error > self.wish.plan.error {
            return failed(format!(
                "the position error was {:.3} µm, beyond identify_loop.error: take a smaller \
                 identify_loop.force, or begin higher",
                1e6 * error
            ));
        }
        let begin = *self.begin.get_or_insert(stamp);
        let time = (stamp - begin) as f64 * 1e-9;
        let force = self.probe.update(time, terms.position, terms.output);
        let total = terms.output + force;
        if terms.saturated || total < settings.limits.0 || total > settings.limits.1 {
            return failed(
                "the force was at its limit: take a smaller identify_loop.force".to_owned(),
            );
        }
        if self.probe.sine().is_none() { Progress::Over } else { Progress::Add(force) }
    }

    /// Answers with what was measured, or why it failed.
    pub fn end(self, failure: Option<String>) {
        let Measurement { probe, wish, settings, .. } = self;
        let result = match failure {
            None => {
                Ok(MeasuredLoop { settings, force: wish.plan.force, points: probe.into_points() })
            }
            Some(why) => Err(format!("the measurement ended: {why}")),
        };
        // Who asked may have gone.
        let _ = wish.reply.send(result);
    }
}

/// Answers the requests of the service: `settings` are what the parameters ask the controller for,
/// `wish` reaches the node's loop.
pub fn handler(
    parameters: Arc<Mutex<ParameterSet>>,
    settings: fn(&ParameterValues) -> ControllerSettings,
    name: String,
    wish: UnboundedSender<Wish>,
) -> impl FnMut() -> BoxFuture<'static, Result<String, String>> + Send {
    move || {
        let plan = {
            let parameters = lock(&parameters);
            Plan::of(&parameters, &settings(&parameters))
        };
        let (wish, name) = (wish.clone(), name.clone());
        Box::pin(async move {
            let plan = plan?;
            let directory = plan.directory.clone();
            let longest = PATIENCE.1 + Duration::from_secs_f64(PATIENCE.0 * plan.duration);
            let (reply, answer) = oneshot::channel();
            let ended = || "the node is shutting down".to_owned();
            wish.unbounded_send(Wish { plan, reply }).map_err(|_| ended())?;
            let measured = tokio::time::timeout(longest, answer).await.map_err(|_| {
                format!(
                    "the measurement did not end within {} s: do samples still come?",
                    longest.as_secs()
                )
            })?;
            let measured = measured.map_err(|_| ended())??;
            if let Some(point) = measured.points.iter().find(|point| !point.is_usable()) {
                return Err(format!(
                    "at {:.1} Hz no motion was measured: take a larger identify_loop.force, or see \
                     whether samples are missing",
                    point.frequency
                ));
            }
            let path = write(&measured, &directory, &name)?;
            Ok(format!("{}; {}", words(&measured), path.display()))
        })
    }
}

/// Writes a file named after node and date; one that exists is kept.
fn write(measured: &MeasuredLoop, directory: &Path, name: &str) -> Result<PathBuf, String> {
    let mut path = crate::directory::dated(directory, &format!("{name}_loop")).into_os_string();
    path.push(".json");
    let path = PathBuf::from(path);
    let failed = |error: &dyn std::fmt::Display| {
        format!("the loop was measured, but {} cannot be written: {error}", path.display())
    };
    let text = measured.to_json().map_err(|error| failed(&error))?;
    let mut file = std::fs::File::create_new(&path).map_err(|error| failed(&error))?;
    file.write_all(text.as_bytes()).map_err(|error| failed(&error))?;
    Ok(path)
}

/// The margins, in one line.
fn words(measured: &MeasuredLoop) -> String {
    let coherent = measured.points.iter().filter(|point| point.coherence > COHERENT).count();
    let count = measured.points.len();
    let of = format!("coherence above {COHERENT} at {coherent} of {count} frequencies");
    let Some(margins) = measured.margins() else {
        return format!("{of}, too few for margins: take a larger identify_loop.force");
    };
    let Margins { crossover, phase_margin, gain_margin, modulus_frequency, .. } = margins;
    let shown = |value: Option<f64>, unit: &str| {
        value.map_or("beyond what was measured".to_owned(), |value| format!("{value:.1} {unit}"))
    };
    format!(
        "crossover {}, phase margin {}, gain margin {}, largest |S| {:.1} dB at {:.1} Hz; {of}",
        shown(crossover, "Hz"),
        shown(phase_margin, "degrees"),
        shown(gain_margin.map(|factor| 20.0 * factor.log10()), "dB"),
        margins.peak_sensitivity_db(),
        modulus_frequency,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::node::controller_settings;
    use std::collections::BTreeMap;

    fn plan(changes: &[(&str, f64)]) -> Result<Plan, String> {
        let mut set = controller_settings::declared(&BTreeMap::new()).unwrap();
        set.set("identify_loop.enabled", ros2_client::ParameterValue::Boolean(true)).unwrap();
        for (name, value) in changes {
            set.set(name, ros2_client::ParameterValue::Double(*value)).unwrap();
        }
        Plan::of(&set, &controller_settings::settings(&set))
    }

    fn measurement() -> (
        Measurement,
        ControllerSettings,
        tokio::sync::oneshot::Receiver<Result<MeasuredLoop, String>>,
    ) {
        let settings = ControllerSettings::paper(40.0, 4000.0, 2000.0);
        let (reply, answer) = oneshot::channel();
        let wish = Wish { plan: plan(&[]).unwrap(), reply };
        (Measurement::new(wish, &settings, Reference::default()), settings, answer)
    }

    #[test]
    fn sines_are_even_in_their_logarithm_and_bounded() {
        let found = plan(&[]).unwrap();
        let ratios: Vec<f64> =
            found.sines.windows(2).map(|pair| pair[1].frequency / pair[0].frequency).collect();
        assert!(ratios.iter().all(|ratio| (ratio / ratios[0] - 1.0).abs() < 1e-9), "{ratios:?}");
        assert_eq!((found.sines.len(), found.sines[0].frequency), (20, 10.0));
        assert!(found.duration < 60.0);
        for (changes, reported) in [
            ([("identify_loop.force", 401.0)], "must be at most 400 N"),
            ([("identify_loop.highest", 1601.0)], "at most 1600 Hz"),
            ([("identify_loop.lowest", 0.1)], "identify_loop.duration allows 60 s"),
        ] {
            let error = plan(&changes).unwrap_err();
            assert!(error.contains(reported), "{error}");
        }
    }

    #[test]
    fn it_ends_where_force_error_gains_or_reference_are_not_as_they_should_be() {
        let good = Terms { holding: true, ..Terms::default() };
        let moved = Reference { position: 1e-6, ..Reference::default() };
        let cases = [
            (Terms { saturated: true, ..good }, "the force was at its limit"),
            (Terms { error: -2e-4, ..good }, "the position error was 200.000 µm"),
            (Terms { error: f64::NAN, ..good }, "the position error"),
            (Terms { holding: false, ..good }, "a motion began"),
            (Terms { reference: moved, ..good }, "a motion began"),
        ];
        for (bad, reported) in cases {
            let (mut measurement, settings, mut answer) = measurement();
            assert!(matches!(measurement.update(0, &good, &settings), Progress::Add(_)));
            let Progress::Failed(why) = measurement.update(250_000, &bad, &settings) else {
                panic!("{bad:?} was taken");
            };
            assert!(why.contains(reported), "{why}");
            measurement.end(Some(why));
            let ended = answer.try_recv().unwrap().unwrap_err();
            assert!(ended.contains("at 10.0 Hz") && ended.contains(reported), "{ended}");
        }
        // Close to the limit there is no room for the sine.
        let (mut measurement, settings, answer) = measurement();
        let high = Terms { output: 1995.0, ..good };
        let mut ends = |terms: &Terms| {
            (0..400).any(|k| {
                let found = measurement.update(k * 250_000, terms, &settings);
                matches!(found, Progress::Failed(why) if why.contains("at its limit"))
            })
        };
        assert!(!ends(&good) && ends(&high));
        // Gains that change, and who does not wait.
        let (mut measurement, settings, _answer) = self::measurement();
        let other = settings.slowed(0.5);
        assert!(matches!(measurement.update(0, &good, &other), Progress::Failed(_)));
        drop(answer);
        let (mut measurement, settings, answer) = self::measurement();
        drop(answer);
        assert!(matches!(measurement.update(0, &good, &settings), Progress::Failed(_)));
    }
}
