"""Recordings with an answer that no tool sees, made with `friction-stage play`.

A seed draws a stage within its tolerances, how many effects it hides (none to two), which ones and
how large. Recordings are tables: the bags of `play` hold the model they were made with. What is
hidden is written to a directory of its own, which only the table at the end reads.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml

from data import Case, run, yaml_of

SEEDS = range(1, 11)
NULLS = range(1, 4)
RATE = 2000
GUIDE = {
    "stiffness": 4.5e5,
    "bristle_damping": 900.0,
    "viscous_friction": 18.0,
    "coulomb_force": 13.5,
    "static_force": 16.8,
    "stribeck_velocity": 0.005,
}
SENSORS = {"force_cell": {"noise": 0.05}, "encoder": {"resolution": 1e-9, "noise": 1e-9}}

# Position after each move, mm, its time, s, and the rest after it, s.
TRAIN = [
    (0.02, 0.2, 0.2),
    (0.0, 0.2, 0.2),
    (1.0, 0.5, 0.1),
    (-40.0, 1.6, 0.1),
    (30.0, 0.5, 0.2),
    (30.01, 0.1, 0.2),
    (-60.0, 1.2, 0.1),
    (70.0, 0.7, 0.2),
    (-70.0, 0.35, 0.3),
    (10.0, 2.2, 0.1),
    (9.97, 0.15, 0.2),
    (60.0, 0.4, 0.1),
    (-10.0, 0.9, 0.2),
    (50.0, 0.25, 0.2),
    (-50.0, 1.8, 0.1),
    (0.0, 0.5, 0.3),
]
CHECK = [
    (-20.0, 0.8, 0.2),
    (-20.03, 0.15, 0.2),
    (45.0, 1.1, 0.1),
    (-55.0, 0.6, 0.2),
    (20.0, 1.9, 0.1),
    (65.0, 0.4, 0.2),
    (-30.0, 0.45, 0.2),
    (0.0, 0.7, 0.3),
]

MAPPING = {
    "rate": RATE,
    "signals": {
        "time": {"column": "time_s"},
        "position": {"column": "position_m"},
        "reference_position": {"column": "reference_m"},
        "force": {"column": "force_n"},
        "force_cell": {"column": "force_cell_n"},
    },
}

# Laws and the ranges from which their values are drawn: sizes that they usually have, assumed.
LAWS = {
    "constant_force": {"amplitude": (1.0, 6.0)},
    "cable_chain": {"stiffness": (20.0, 100.0), "center": (-0.02, 0.02)},
    "cogging": {"amplitude": (1.0, 6.0), "period": (0.01, 0.032), "phase": (-3.0, 3.0)},
    "ball_passage": {"amplitude": (0.5, 2.0), "period": (0.007, 0.01), "phase": (-3.0, 3.0)},
    "asymmetric_friction": {"fraction": (0.05, 0.2), "viscous_fraction": (0.05, 0.2)},
    "quadratic_drag": {"coefficient": (10.0, 60.0)},
    "position_dependent_friction": {
        "fraction": (0.1, 0.3),
        "center": (-0.04, 0.04),
        "width": (0.01, 0.03),
    },
    # A force over the position that follows no law: knots drawn one by one.
    "map": {},
}


def draw(seed: int) -> tuple[dict, list[str]]:
    """The stage of a seed and the names of what it hides."""
    random = np.random.default_rng(1000 + seed)
    viscous = random.uniform(0.95, 1.05)
    guides = []
    for _ in range(4):
        friction, stiffness = random.uniform(0.95, 1.05, 2)
        guides.append(
            {
                **GUIDE,
                "stiffness": GUIDE["stiffness"] * stiffness,
                "viscous_friction": GUIDE["viscous_friction"] * viscous,
                "coulomb_force": GUIDE["coulomb_force"] * friction,
                "static_force": GUIDE["static_force"] * friction,
            }
        )
    names = list(random.choice(list(LAWS), random.choice([0, 1, 1, 1, 2]), replace=False))
    effects = []
    for name in map(str, names):
        values = {key: float(random.uniform(*ends)) for key, ends in LAWS[name].items()}
        if name == "map":
            knots = np.convolve(random.normal(0, 3.0, 14), [0.25, 0.5, 0.25], "valid")
            values = {
                "coordinate": "position",
                "from": -0.08,
                "to": 0.08,
                "values": [float(k) for k in knots],
            }
        effects.append({name: values})
    mass = 40.0 * random.uniform(0.997, 1.003)
    return {
        "name": "stage as it is",
        "mass": float(mass),
        "guides": plain(guides),
        "effects": effects,
        **SENSORS,
    }, [str(name) for name in names]


def plain(guides: list[dict]) -> list[dict]:
    return [{key: float(value) for key, value in guide.items()} for guide in guides]


def trajectory(moves: list[tuple[float, float, float]]) -> dict:
    points, time, position = [], 0.5, 0.0
    for target, duration, rest in [(0.0, 0.0, 0.0), *moves]:
        for wait, position in ((duration, 1e-3 * target), (rest, 1e-3 * target)):
            time += wait
            if wait or not points:
                second = int(time + 1e-9)
                points.append(
                    {
                        "positions": [position],
                        "velocities": [0.0],
                        "accelerations": [0.0],
                        "time_from_start": {"sec": second, "nanosec": round(1e9 * (time - second))},
                    }
                )
    return {"joint_names": ["stage"], "points": points}


def make(program: Path, out: Path, name: str, stage: dict, names: list[str], seed: int) -> Case:
    """The two recordings of a stage, unless an earlier run made them."""
    place, answers = out / "blind" / name, out / "answers"
    place.mkdir(parents=True, exist_ok=True)
    answers.mkdir(exist_ok=True)
    declared, mapping = place / "declared.yaml", place / "mapping.yaml"
    declared.write_text(
        yaml.safe_dump(
            {"name": "stage as declared", "mass": 40.0, "guides": plain([GUIDE] * 4), **SENSORS}
        )
    )
    mapping.write_text(yaml.safe_dump(MAPPING))
    answer = answers / f"{name}.yaml"
    tables = []
    for which, moves, noise in (("train", TRAIN, 2 * seed), ("check", CHECK, 2 * seed + 1)):
        motion, table = place / f"{which}_motion.yaml", place / f"{which}.csv"
        motion.write_text(yaml.safe_dump(trajectory(moves), default_flow_style=None, width=1000))
        tables.append(table)
        if not table.exists() or not answer.exists() or yaml_of(answer.read_text()) != stage:
            answer.write_text(yaml.safe_dump(stage))
            bag = answers / f"{name}_{which}"
            run(
                program,
                "play",
                motion,
                "--model",
                answer,
                "--record",
                bag,
                "--force",
                "--samples",
                table,
                "--rate",
                RATE,
                "--seed",
                noise,
            )
    return Case(
        name=name, model=declared, train=tables[0], holdout=tables[1], mapping=mapping, hidden=names
    )


def blind_cases(program: Path, out: Path, wanted: set[str] | None) -> list[Case]:
    cases = []
    for seed in SEEDS:
        if wanted is None or f"blind_{seed}" in wanted:
            stage, names = draw(seed)
            cases.append(make(program, out, f"blind_{seed}", stage, names, seed))
    for seed in NULLS:
        if wanted is None or f"null_{seed}" in wanted:
            stage, _ = draw(0)
            # One stage, and another seed of the noise of its sensors.
            cases.append(
                make(program, out, f"null_{seed}", {**stage, "effects": []}, [], 100 + seed)
            )
    return cases
