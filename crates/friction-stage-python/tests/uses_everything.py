"""Every public name, for the type checker."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import friction_stage as fs
import numpy as np
from friction_stage import fleet
from numpy.typing import NDArray


def go_on(what: str, share: float) -> bool:
    return share < 2.0


def models() -> fs.Model:
    model: fs.Model = fs.Model.from_yaml("mass: 12.0")
    assert fs.Model.from_dict(model.to_dict()) == model
    rig: fs.Model = fs.Model.rig(fs.Model.guides()[0])
    names: list[str] = [rig.name, *rig.effects, *rig.notes]
    assert names
    return fs.Model.guide("guide_2").without_noise()


def simulations(model: fs.Model) -> fs.Trace:
    motion: fs.Motion = fs.Motion.of_moves([(0.01, 0.1, 0.1)], lead=0.1).stretched(1.5)
    other = fs.Motion(np.array([0.1, 0.2]), np.array([0.0, 1e-3]), np.zeros(2), np.zeros(2))
    both: float = motion.duration + other.duration
    controller = fs.Controller(model, bandwidth=50.0, viscous_feedforward=72.0)
    gains: tuple[float, float, float] = (controller.p, controller.i, controller.d)
    trace: fs.Trace = fs.simulate(
        model, motion, controller=controller, noise=True, seed=3, duration=both, progress=go_on
    )
    column: NDArray[np.float64] = trace.position + trace.error + trace.force + trace.force_cell
    move: fs.MoveResult = trace.moves[0]
    peak: float = move.peak_error + column[0] + gains[0]
    stage = fs.Stage(model, rate=trace.rate, noise=False, seed=1)
    sample: fs.Sample = stage.step(force=min(peak, stage.force_limit))
    values: list[float] = [sample.time, sample.position, sample.velocity, *stage.guide_forces]
    assert len(values) + sample.index > 0
    return trace


def recordings(trace: fs.Trace, directory: Path) -> fs.Verdict:
    trace.to_csv(directory / "run.csv")
    run: fs.Trace = fs.read_bag(directory / "run.csv", mapping=None)
    frame, columns = run.to_pandas(), run.to_polars()
    assert len(frame) == columns.height and run.plot().get_xlabel()
    report: dict[str, object] = fs.check(directory / "run.csv", model=run.model)
    assert report
    verdict: fs.Verdict = fs.identify(
        fs.Model.guide("guide_2"),
        [run, frame],
        {"time": trace.time, "position": trace.position, "force": trace.force},
        mass_tolerance=0.1,
        guide_tolerance=0.1,
        presliding_tolerance=0.5,
        next_experiment=fs.Limits(stroke=(-0.1, 0.1)),
        progress=go_on,
    )
    effects: list[fs.Effect] = verdict.effects
    parameters: dict[str, fs.Parameter] = verdict.declared_parameters
    texts: list[str] = [verdict.verdict, verdict.report_html(), *verdict.warnings]
    motion: fs.Motion | None = verdict.next_motion
    partial: fs.Model | None = verdict.partial_model
    assert verdict.verdict == "unknown" or partial is None
    assert effects and parameters and texts and motion
    verdict.save(directory)
    return verdict


def laboratory(application: Path, directory: Path) -> fs.GuideFit:
    stage = fs.Model.guide("guide_1")
    swept: fs.Sweep = fs.sweep(stage, {"model.mass": [30.0, 40.0]}, motion="fine-step", seed=2)
    assert len(swept) == 2 and len(swept["peak_error_m"]) == len(swept.to_pandas()) and str(swept)
    selection: fs.Selection = fs.select(application, guides=["guide_1"], variants=10, seed=2)
    choice: str | None = selection.choice
    remarks: list[str] = [*selection.warnings, *selection.notes]
    assert choice or selection.ranking or remarks or len(selection.to_pandas())
    runs: fs.ExperimentResult = fs.experiment("stribeck", guides=["guide_1"], recordings=True)
    loops = fs.experiment("dahl", models=[fs.Model.rig("guide_1")], amplitudes=[1e-4])
    first: fs.Trace = next(iter(runs.recordings.values()))
    fit: fs.GuideFit = fs.fit_guide(first, directory / "loops", mass=1.0)
    assert fit.to_catalogue("mine", seals=True) and loops.figures and loops.results
    return fit


def fleets(application: Path, bags: Path, out: Path) -> str:
    with ThreadPoolExecutor() as threads:
        result: fleet.FleetResult = fleet.map_variants(
            application,
            out / "variants",
            variants=100,
            sweep={"mass": [20.0, 40.0]},
            engine=threads,
        )
    axes: dict[str, list[float | str | bool]] = {"model.mass": [20.0, 40.0]}
    swept: fleet.FleetResult = fleet.map_sweep("guide_2", axes, out / "sweep", workers=2)
    points: fleet.Report = fleet.report(fleet.SweepJob("guide_2", axes, out / "sweep"))
    assert swept.is_complete and points.sweep is not None and points.sweep.summary
    one = fleet.Bag(bags / "first", machine="left", recorded=1.75e9)
    verdicts = fleet.identify_bags(
        [one, bags / "second", {"bag": bags / "third"}],
        out / "verdicts",
        model=fs.Model.guide("guide_2"),
        workers=2,
        progress=go_on,
    )
    failed: list[str] = [*result.failed.values(), *verdicts.failed.values()]
    assert not failed and result.is_complete and result.to_dict()
    job: fleet.Job = fleet.load_job(out / "job.yaml")
    jobs: list[fleet.Job] = [
        fleet.VariantsJob(application, out, variants=1000, seed=3, chunk=100),
        fleet.BagsJob(bags, out, model="guide_2"),
        job,
    ]
    for each in jobs:
        try:
            fleet.run(each, engine="dask", address="tcp://scheduler:8786")
            fleet.run_share(each, 0, tasks=10)
        except fleet.OtherJobError as error:
            return str(error)
        except fleet.FleetError:
            continue
    chunks: int = fleet.status(job).chunks
    found: fleet.Report = fleet.report(job)
    texts = [fleet.slurm("job.yaml", chunks), fleet.kubernetes("job.yaml", chunks, image="i")]
    return found.page() + "".join(texts)


def refusals() -> str:
    kinds: tuple[type[fs.FrictionStageError], ...] = (
        fs.ControllerError,
        fs.ExperimentError,
        fs.FitError,
        fs.IdentificationError,
        fs.ModelError,
        fs.MotionError,
        fs.RecordingError,
        fs.SelectionError,
        fs.SweepError,
    )
    try:
        fs.Model.guide("none")
    except kinds as error:
        return fs.__version__ + str(error)
    return ""
