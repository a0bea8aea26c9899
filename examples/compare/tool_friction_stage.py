"""What `friction-stage identify` says of a recording.

It gets the files as they are, the reading of a force cell included where there is one, which the
other tools do not get. Its own figures are copied; the shared metric is worked out here from the
model that it wrote, by code that it does not share. Own figures count the noise of the cell, too.
"""

from __future__ import annotations

from pathlib import Path

from data import Case, Clock, ProgramFailed, run, yaml_of
from declared import NotEvaluated, Stage, residual
from metric import Motion, force_error


def identify(program: Path, case: Case, holdout: Motion, out: Path) -> dict:
    clock = Clock()
    result = out / "friction_stage" / case.name
    arguments = [
        "--model",
        case.model,
        "--train",
        case.train,
        "--holdout",
        case.holdout,
        "--out",
        result,
        "--force",
    ]
    if case.mapping:
        arguments += ["--mapping", case.mapping]
    # What a user gives to the other tools, too. EMPS: as the book has it, with the defaults.
    if case.name == "screw":
        arguments += [
            "--mass-tolerance",
            case.mass_tolerance,
            "--guide-tolerance",
            case.guide_tolerance,
        ]
    try:
        summary = run(program, "identify", *arguments)
    except ProgramFailed as error:
        clock.lap("load, fit and select")
        return {
            "tool": "friction-stage",
            "says": "refused",
            "error": str(error),
            "cpu": clock.parts,
        }
    clock.lap("load, fit and select")
    names = [effect["name"] for effect in summary["effects"]]
    answer = {
        "tool": "friction-stage",
        "says": summary["verdict"]
        + (": " + ", ".join(map(describe, summary["effects"])) if names else ""),
        "verdict": summary["verdict"],
        "effects": names,
        "own_holdout_force_rms": summary["errors"]["holdout"]["force_rms"],
        "warnings": summary.get("warnings", []),
        "findings": summary.get("findings", []),
        "cpu": clock.parts,
    }
    # All that was found, laws that explain a part only included.
    partial = result / "partial.yaml"
    found = partial if partial.exists() else result / "identified.yaml"
    model = Stage.of(yaml_of(found.read_text()))
    shift = summary["declared_parameters"].get("sensor_shift", {}).get("value", 0.0)
    try:
        # Its shift is how early the encoder reads.
        answer["holdout"] = force_error(holdout, residual(holdout, model, -shift)).as_dict()
    except NotEvaluated as law:
        answer["not_evaluated"] = str(law)
    return answer


# Shown with the name of an effect where it has them: key, factor, unit.
SHOWN = (
    ("amplitude", 1.0, "N"),
    ("period", 1e3, "mm"),
    ("stiffness", 1.0, "N/m"),
    ("coefficient", 1.0, "N s²/m²"),
    ("fraction", 100.0, "%"),
    ("mass", 1.0, "kg"),
    ("delay", 1e3, "ms"),
)


def describe(effect: dict) -> str:
    values = effect.get("parameters", {})
    said = []
    for key, factor, unit in SHOWN:
        value = values.get(key)
        value = value.get("value") if isinstance(value, dict) else value
        if isinstance(value, (int, float)) and value and effect["name"] != "distributed_bristles":
            said.append(f"{factor * value:.3g} {unit}")
    return " ".join([effect["name"], *said])
