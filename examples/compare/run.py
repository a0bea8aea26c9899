#!/usr/bin/env python3
"""What friction-stage, PySINDy and MuJoCo's sysid say of the same recordings.

usage: run.py --program PATH/friction-stage --out DIR [--recordings DIR] [--only CASE...]

The recordings are those of FRICTION_STAGE_RECORDINGS or --recordings; what is missing there is
skipped. Ten blind cases and three without anything hidden are made with the program. Each case is
kept in DIR/cases, so that a run which was stopped continues; compare.json and compare.md hold all
cases of DIR.
"""

from __future__ import annotations

import os

# Threads that wait for each other use CPU time; set before numpy is imported.
for library in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(library, "1")

import argparse
import contextlib
import io
import json
import sys
import traceback
from datetime import date
from pathlib import Path

import tool_friction_stage
import tool_mujoco
import tool_pysindy
from blind import blind_cases
from data import Case, Clock, measured_cases, read, recordings_directory
from declared import Stage, fit, motion_of, residual
from judge import hidden_effects, judge_terms, judge_verdict
from metric import force_error, noise_floor
from table import markdown


TOOLS = ["friction_stage", "pysindy", "mujoco"]


def attempt(work, *arguments) -> dict:
    """What a tool returns, or the error it ended with."""
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            return work(*arguments)
    except Exception as error:  # Whatever a tool raises is its answer.
        traceback.print_exc()
        return {"error": f"{type(error).__name__}: {error}"}


def compare(program: Path, case: Case, out: Path, wanted: list[str], result: dict, save) -> dict:
    """The result of a case; what it has already is kept, and each tool's answer is saved."""
    declared = case.declared()
    stage = Stage.of(declared)
    clock = Clock()
    recordings = {
        which: read(program, case, which, out / "scratch") for which in ("train", "holdout")
    }
    train, holdout = (motion_of(recordings[which], case) for which in ("train", "holdout"))
    clock.lap("load")
    grey = fit(train, stage, case)
    clock.lap("fit")
    encoder = declared.get("encoder", {})
    result |= {
        "case": case.name,
        "band_hz": case.cutoff,
        "rows": {"train": len(train.position), "holdout": len(holdout.position)},
        "floor": noise_floor(
            holdout, stage.mass, encoder.get("noise", 0.0), encoder.get("resolution", 0.0)
        ),
        "declared_as_it_is": force_error(holdout, residual(holdout, stage)).as_dict(),
        "grey_box": {
            "holdout": force_error(holdout, residual(holdout, grey.stage, grey.shift)).as_dict(),
            "evaluations": grey.evaluations,
            "cpu": clock.parts,
        },
    }
    tools = {
        "friction_stage": (tool_friction_stage.identify, program, case, holdout, out),
        "pysindy": (tool_pysindy.compare, train, holdout, case, grey, stage),
        "mujoco": (tool_mujoco.compare, recordings["train"], train, holdout, case, grey, stage),
    }
    if case.name.startswith("null"):
        # It has no way to say that something is missing.
        del tools["mujoco"]
    for tool, work in tools.items():
        if tool in wanted and tool not in result:
            result[tool] = attempt(*work)
            save(result)
    if case.hidden is not None and "friction_stage" in result and "pysindy" in result:
        hidden = hidden_effects(case, out)
        result["hidden"] = [name for name, _ in hidden]
        result["right"] = judge_verdict(result["friction_stage"], hidden)
        if "found" in result["pysindy"]:
            result["terms_judged"] = judge_terms(result["pysindy"]["found"]["terms"], hidden)
    if all(tool in result for tool in tools):
        result["complete"] = True
    return result


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--program", type=Path, required=True, help="the program friction-stage")
    parser.add_argument("--out", type=Path, required=True, help="directory of the results")
    parser.add_argument("--recordings", type=Path, help="default: FRICTION_STAGE_RECORDINGS")
    parser.add_argument(
        "--only",
        nargs="+",
        metavar="CASE",
        help="a to f, emps, screw, blind_1 to blind_10, null_1 to null_3",
    )
    parser.add_argument(
        "--tools",
        nargs="+",
        choices=TOOLS,
        default=TOOLS,
        help="run these only; a later run adds the others",
    )
    parser.add_argument("--again", choices=TOOLS, help="run this tool again on cases that are kept")
    given = parser.parse_args()
    kept = given.out / "cases"
    kept.mkdir(parents=True, exist_ok=True)
    missing: list[str] = []
    cases = measured_cases(recordings_directory(given.recordings), missing)
    wanted = set(given.only) if given.only else None
    if missing:
        print(f"skipped, the recordings are not there: {', '.join(missing)}")
    cases = [case for case in cases if wanted is None or case.name in wanted]
    cases += blind_cases(given.program, given.out, wanted)
    for case in cases:
        file = kept / f"{case.name}.json"
        result = json.loads(file.read_text()) if file.exists() else {}
        if given.again:
            result.pop(given.again, None)
            result.pop("complete", None)
        elif "complete" in result:
            continue
        print(f"{case.name} ...", flush=True)

        def save(result: dict, file: Path = file) -> None:
            file.write_text(json.dumps(result, indent=1, default=float))

        save(compare(given.program, case, given.out, given.tools, result, save))
    results = [json.loads(file.read_text()) for file in sorted(kept.glob("*.json"))]
    results = [result for result in results if "friction_stage" in result and "pysindy" in result]
    text = markdown(results)
    (given.out / "compare.md").write_text(text)
    (given.out / "compare.json").write_text(
        json.dumps(
            {"date": date.today().isoformat(), "skipped": missing, "cases": results}, indent=1
        )
    )
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
