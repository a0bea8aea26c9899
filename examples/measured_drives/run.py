#!/usr/bin/env python3
"""Exports of two real drives: proposed mappings, a check of every file, friction curves.

usage: run.py DATA OUT

DATA holds
  screw_drive/  scope exports of a servo drive on a lead screw with a plain nut
                (A. Mablekos-Alexiou, L. da Cruz, C. Bergeles, "Friction-inclusive modeling of
                sliding contact transmission systems in robotics", IEEE T-RO 2021)
  cranfield/    a ball screw in health and in want of lubrication (Cranfield University,
                doi 10.17862/cranfield.rd.5097649)

The files are not part of this repository. What a file does not say, and its mapping marks with
CHECK, is said here: the rated torque of the first drive, and that the current of the second counts
as the force, in A.
"""

import argparse
import csv
import itertools
import json
import os
import subprocess
import sys
from pathlib import Path

PROGRAM = os.environ.get("FRICTION_STAGE", "friction-stage")
# N m of 100 %, from the scope's description.
RATED_TORQUE = 9.84e-3


def run(*arguments: object) -> dict:
    """Runs a command with --json; warnings (exit code 3) are for a reader, not for this script."""
    command = [PROGRAM, *map(str, arguments), "--json"]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if done.returncode not in (0, 3):
        raise SystemExit(f"{' '.join(command)}: {done.stderr.strip()}")
    return json.loads(done.stdout)


def confirmed(file: Path, mapping: Path, *replace: tuple[str, str]) -> Path:
    """The proposed mapping with what the file does not say, and without its marks."""
    mapping.parent.mkdir(parents=True, exist_ok=True)
    mapping.unlink(missing_ok=True)
    run("import", file, "--write", mapping)
    text = mapping.read_text()
    for wrong, right in replace:
        if wrong not in text:
            raise SystemExit(
                f"{mapping} has no {wrong!r}: the file says it, or says something else"
            )
        text = text.replace(wrong, right)
    # What is said now is no longer to be checked.
    mapping.write_text(text.replace("# CHECK: ", "# was to check: "))
    return mapping


def with_interval(fitted: dict | None, scale: float = 1.0) -> str:
    if fitted is None:
        return "not seen"
    low, high = (scale * end for end in fitted["ci95"])
    return f"{scale * fitted['value']:.3g} [{low:.3g}, {high:.3g}]"


def screw_drive(data: Path, out: Path) -> None:
    files = sorted(data.rglob("*.csv"))
    steady = [file for file in files if "steady_state" in file.parts]
    usable = 0
    for file in files:
        name = "_".join(file.relative_to(data).with_suffix("").parts) + ".yaml"
        mapping = confirmed(
            file, out / "mappings" / name, ("scale: 1}", f"scale: {RATED_TORQUE}}}")
        )
        check = run("check", file, "--mapping", mapping)
        usable += check["data"]["valid_rows"] == check["data"]["rows"]
    print(
        f"screw drive: {len(files)} files, {usable} of them usable from the first row to the last"
    )
    curve = run(
        "friction-curve", *steady, "--mapping", mapping, "--figure", out / "screw_drive.svg"
    )
    found, fall = curve["curve"], curve["curve"]["stribeck"] or {}
    print(
        f"  {len(curve['runs'])} runs at {found['speeds']} speeds; no speed is held in "
        f"{len(curve['without_held_speed'])} files (stick-slip)"
    )
    print(f"  Coulomb friction   {with_interval(found['coulomb_force'], 1e3)} mN m")
    print(f"  break-away         {with_interval(fall.get('static_force'), 1e3)} mN m")
    print(f"  Stribeck velocity  {with_interval(fall.get('velocity'))} rad/s")
    print(f"  viscous friction   {with_interval(found['viscous_friction'], 1e6)} µN m s/rad")
    print(f"  constant torque    {with_interval(found['offset'], 1e3)} mN m")


def captures(file: Path) -> list[str]:
    """Load of each capture of a Cranfield file: a capture begins where the time goes back."""
    loads, before = [], float("inf")
    with open(file, newline="") as text:
        for row in csv.DictReader(text):
            time = float(row["time"])
            if time < before:
                loads.append(row["load"])
            before = time
    return loads


def cranfield(data: Path, out: Path) -> None:
    found = {}
    for name in ("normal", "lackLubrication1"):
        file = data / f"{name}.csv"
        mapping = confirmed(
            file,
            out / "mappings" / f"{name}.yaml",
            ('unit: "A"}', 'unit: "A", scale: 1}'),
        )
        bags = out / name
        reports = run("import", file, "--mapping", mapping, "--out", bags, "--split")
        loads = captures(file)
        if len(loads) != len(reports):
            raise SystemExit(f"{file}: {len(loads)} captures, but {len(reports)} bags")
        by_load = itertools.groupby(sorted(zip(loads, reports), key=lambda p: p[0]), lambda p: p[0])
        for load, group in by_load:
            of_load = [report["bag"] for _, report in group]
            found[name, load] = run("friction-curve", *of_load, "--magnitude")["curve"]
        print(f"{file.name}: {len(reports)} captures, {sum(r['rows'] for r in reports)} rows")
    print(
        "  current at the held speed, A    health                  want of lubrication     differs"
    )
    for load in sorted({load for _, load in found}, key=float):
        health, want = (
            found[name, load]["coulomb_force"] for name in ("normal", "lackLubrication1")
        )
        apart = want["ci95"][0] > health["ci95"][1] or want["ci95"][1] < health["ci95"][0]
        print(
            f"  load {load:>4} kgf                   {with_interval(health):22}  "
            f"{with_interval(want):22}  {'yes' if apart else 'not by these data'}"
        )


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("data", type=Path)
    arguments.add_argument("out", type=Path)
    given = arguments.parse_args()
    given.out.mkdir(parents=True)
    screw_drive(given.data / "screw_drive", given.out)
    cranfield(given.data / "cranfield", given.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
