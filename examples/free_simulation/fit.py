"""Fits a model by free simulation: its position under the recorded forces against the recorded
position.

usage: fit.py RECORDING MAPPING MODEL OUT.yaml [--check RECORDING] [--program friction-stage]

Fitted are Coulomb and viscous friction of the guides and a constant force, which the model file
must have; the rest of the model is kept. An open-loop position drifts with the integral of every
error of the force, so it tells the slow part of the friction; the mass is what a comparison of
forces tells, as `identify` does. Needs numpy, scipy and PyYAML.
"""

import argparse
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import yaml
from scipy.optimize import least_squares

# Rows that are compared: every 20th, an open-loop position is slow.
EVERY = 20


def read(path: str) -> dict:
    """A model file; YAML 1.2 has numbers such as 4.5e5, which PyYAML leaves as text."""

    def numbers(value: object) -> object:
        if isinstance(value, dict):
            return {key: numbers(inner) for key, inner in value.items()}
        if isinstance(value, list):
            return [numbers(inner) for inner in value]
        try:
            return float(value) if isinstance(value, str) else value
        except ValueError:
            return value

    return numbers(yaml.safe_load(Path(path).read_text()))


def parameters(model: dict) -> np.ndarray:
    """Coulomb friction, viscous friction, constant force; refuses a model without them."""
    guides = model.get("guides") or []
    needed = ("coulomb_force", "static_force", "viscous_friction")
    if not guides or not all(
        isinstance(guide, dict) and guide.keys() >= set(needed) for guide in guides
    ):
        raise SystemExit(
            f"each guide of the model must be given by its parameters, {', '.join(needed)} "
            "among them"
        )
    values = [
        guides[0]["coulomb_force"],
        guides[0]["viscous_friction"],
        constant(model)["amplitude"],
    ]
    if 0.0 in values:
        raise SystemExit("what is fitted starts at the value of the model, which must not be 0")
    return np.array(values)


def constant(model: dict) -> dict:
    for effect in model.get("effects") or []:
        if "constant_force" in effect:
            return effect["constant_force"]
    raise SystemExit("the model has no constant_force to fit: give it one of 0.1 N, for example")


def with_parameters(model: dict, values: np.ndarray) -> dict:
    """The model with these values, as a copy; static friction keeps its ratio to the Coulomb
    friction."""
    model = yaml.safe_load(yaml.safe_dump(model))
    coulomb, viscous, force = map(float, values)
    for guide in model["guides"]:
        guide["static_force"] *= coulomb / guide["coulomb_force"]
        guide["coulomb_force"], guide["viscous_friction"] = coulomb, viscous
    constant(model)["amplitude"] = force
    return model


def position_errors(program: str, recording: str, mapping: str, model: dict) -> np.ndarray:
    """Replayed less recorded position, m, row by row; rows without a position are left out."""
    with tempfile.TemporaryDirectory() as directory:
        path, table = Path(directory, "model.yaml"), Path(directory, "replay.csv")
        path.write_text(yaml.safe_dump(model))
        command = [program, "replay", recording, "--mapping", mapping, "--model", str(path)]
        run = subprocess.run([*command, "--csv", str(table)], capture_output=True, text=True)
        # 3: done with warnings.
        if run.returncode not in (0, 3):
            raise SystemExit(run.stderr)
        columns = np.genfromtxt(table, delimiter=",", names=True)
    errors = columns["replayed_position"] - columns["recorded_position"]
    return errors[np.isfinite(errors)]


def rms(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name in ("recording", "mapping", "model", "out"):
        parser.add_argument(name)
    parser.add_argument("--check", help="a recording that the fit does not see")
    parser.add_argument("--program", default="friction-stage")
    arguments = parser.parse_args()
    declared = read(arguments.model)
    start = parameters(declared)

    def errors(recording: str, values: np.ndarray) -> np.ndarray:
        model = with_parameters(declared, values)
        return position_errors(arguments.program, recording, arguments.mapping, model)

    # Each value over the declared one; in mm, so that both are of order one.
    fit = least_squares(
        lambda shares: 1e3 * errors(arguments.recording, shares * start)[::EVERY],
        np.ones_like(start),
        # Friction keeps its sign, the force may turn round.
        bounds=([0.01, 0.01, -np.inf], np.inf),
        diff_step=1e-3,
        x_scale=0.1,
        xtol=1e-5,
        ftol=1e-5,
    )
    fitted = fit.x * start
    Path(arguments.out).write_text(
        yaml.safe_dump(with_parameters(declared, fitted), sort_keys=False)
    )
    print(f"{'':24}{'declared':>12}{'fitted':>12}")
    names = ("Coulomb friction, N", "viscous friction, N s/m", "constant force, N")
    for name, before, after in zip(names, start, fitted):
        print(f"{name:24}{before:12.4g}{after:12.4g}")
    for name, recording in (("train", arguments.recording), ("check", arguments.check)):
        if recording:
            before, after = (1e3 * rms(errors(recording, values)) for values in (start, fitted))
            print(f"{name + ', rms position, mm':24}{before:12.2f}{after:12.2f}")


if __name__ == "__main__":
    main()
