"""``VariantsJob``, ``SweepJob`` and ``BagsJob``: what a fleet is to compute, in Python or as a YAML
file."""

from __future__ import annotations

import difflib
import itertools
import json
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields
from typing import Any, TypeAlias

import fsspec  # type: ignore[import-untyped]

from .. import _native
from .._native import Controller, Model, Motion
from .._source import Path
from .._sweep import given_axes
from ..errors import FleetError
from . import _bag
from ._manifest import READERS, Manifest, digest

CHUNK = 20_000
"""Variants or points of a chunk: some seconds to minutes of one core, 2 MB."""
HOLDOUT_SHARE = 0.4
"""Of a recording, its last part, that no fit sees. Assumed."""


class _Inputs:
    """Texts that a job has read."""

    def __init__(self) -> None:
        self.texts: dict[str, str] = {}
        """By their SHA-256."""
        self.shas: dict[str, str] = {}
        """SHA-256 of each, by its name."""

    def keep(self, name: str, text: str) -> str:
        """Takes a text; its SHA-256 stands for it."""
        sha = digest(text.encode())
        self.texts[sha] = text
        self.shas[name] = sha
        return sha


@dataclass(frozen=True)
class VariantsJob:
    """Variants of a stage: an application over the guides of catalogues and their tolerances.

    Attributes:
        application: What the stage is to do and to reach: a YAML file, a string that holds it, or
            its keys.
        out: Directory of the results, a path or a URL of fsspec.
        variants: Over all guides, dealt to them in turn; as many for each point of the sweep.
        seed: Of tolerances and noise; a variant depends on seed, guide and its number only.
        catalogues: Files with guides of one's own, or strings that hold them.
        guides: Among these only.
        sweep: Keys of the application, such as ``controller.bandwidth``, each with the values that
            it takes; every combination is a point.
        chunk: Variants of a chunk.
    """

    application: Path | Mapping[str, Any]
    out: Path
    variants: int
    seed: int = 1
    catalogues: Sequence[Path] = ()
    guides: Sequence[str] = ()
    sweep: Mapping[str, Sequence[float]] = field(default_factory=dict)
    chunk: int = CHUNK

    def plan(self, chunks: bool = True) -> Manifest:
        """What is computed, with its inputs read; without ``chunks`` only what they share.

        Raises:
            FleetError, SelectionError, ModelError: With what is wrong.
        """
        if self.chunk < 1:
            raise FleetError(f"chunk is {self.chunk}, must be at least 1 variant")
        read = _Inputs()
        name, text = _text(self.application, "application")
        base = _mapping(text, name)
        points: list[dict[str, Any]] = []
        for values in _points(self.sweep):
            if values:
                label = f"{name} with " + ", ".join(f"{k} {v:g}" for k, v in values.items())
                sha = read.keep(label, json.dumps(_with(base, values, name)))
            else:
                sha = read.keep(name, text)
            points.append({"application": sha, "values": values})
        catalogues = [
            read.keep(*_text(catalogue, f"catalogue {number}"))
            for number, catalogue in enumerate(self.catalogues, 1)
        ]
        settings = {
            "variants": self.variants,
            "seed": self.seed,
            "chunk": self.chunk,
            "guides": list(self.guides),
            "catalogues": catalogues,
            "points": points,
        }
        for point in points:
            # Refuses here what every chunk would refuse.
            _native.Plan(
                read.texts[point["application"]],
                [read.texts[sha] for sha in catalogues],
                list(self.guides),
                self.seed,
                self.variants,
            )
        parts = [
            {"point": point, "first": first, "count": min(self.chunk, self.variants - first)}
            for point in range(len(points) if chunks else 0)
            for first in range(0, self.variants, self.chunk)
        ]
        return Manifest("variants", _native.__version__, settings, read.shas, parts, read.texts)


@dataclass(frozen=True)
class SweepJob:
    """A stage over the values of its keys.

    Attributes:
        model: The stage: a file, a string that holds it, a model, or the name of a guide, for the
            stage of the paper on it.
        axes: Keys, each with its values, as for ``sweep``.
        out: Directory of the results, a path or a URL of fsspec.
        motion: ``fine-step``, ``fast-move`` or a motion.
        controller: With all its gains; without, it follows the mass of each point.
        samples: Values that are drawn of the distributions at each place of the grid.
        seed: Of draws and noise; a point depends on seed and its number only.
        chunk: Points of a chunk.
    """

    model: Path | Model
    axes: Mapping[str, str | Sequence[float | str | bool]]
    out: Path
    motion: Motion | str = "fine-step"
    controller: Controller | None = None
    samples: int | None = None
    seed: int = 1
    chunk: int = CHUNK

    def plan(self, chunks: bool = True) -> Manifest:
        """What is computed, with its inputs read; without ``chunks`` only what they share.

        Raises:
            FleetError, SweepError, ModelError: With what is wrong.
        """
        if self.chunk < 1:
            raise FleetError(f"chunk is {self.chunk}, must be at least 1 point")
        model = self.model if isinstance(self.model, Model) else _model(os.fspath(self.model))
        plan = _native.SweepPlan(
            model, given_axes(self.axes), self.motion, self.controller, self.samples, self.seed
        )
        read = _Inputs()
        settings = {"plan": read.keep("the plan of the sweep", plan.to_json()), "chunk": self.chunk}
        parts = [
            {"first": first, "count": min(self.chunk, plan.points - first)}
            for first in range(0, plan.points if chunks else 0, self.chunk)
        ]
        return Manifest("sweep", _native.__version__, settings, read.shas, parts, read.texts)


@dataclass(frozen=True)
class Bag:
    """A recording of a fleet.

    Attributes:
        bag: Path or URL.
        model: What its stage is declared to be; without, that of the job.
        holdout: A recording that no fit sees; without, the last part of the bag.
        machine: What it was recorded on; without, the name of the directory that it is in.
        recorded: When, s since the epoch; without, what the recording says.
    """

    bag: Path
    model: Path | Model | None = None
    holdout: Path | None = None
    machine: str | None = None
    recorded: float | None = None


AnyBag: TypeAlias = "Bag | Path | Mapping[str, Any]"


@dataclass(frozen=True)
class BagsJob:
    """Recordings to identify, each a chunk.

    Attributes:
        bags: A directory with all that is in it, a glob, or a list of recordings.
        out: Directory of the results, a path or a URL of fsspec.
        model: What the stages are declared to be: a file, a string that holds it, a model, or the
            name of a guide, for the stage of the paper on it.
        mapping: As for ``read_bag``.
        holdout_share: Of each recording, its last part, that no fit sees.
        mass_tolerance: As for ``identify``.
        guide_tolerance: As for ``identify``.
        presliding_tolerance: As for ``identify``.
    """

    bags: Path | Sequence[AnyBag]
    out: Path
    model: Path | Model | None = None
    mapping: Path | None = None
    holdout_share: float = HOLDOUT_SHARE
    mass_tolerance: float | None = None
    guide_tolerance: float | None = None
    presliding_tolerance: float | None = None

    def plan(self, chunks: bool = True) -> Manifest:
        """What is computed, with its inputs read; without ``chunks`` only what they share.

        Raises:
            FleetError, RecordingError, ModelError: With what is wrong.
        """
        if not 0.0 < self.holdout_share < 1.0:
            raise FleetError(f"holdout_share is {self.holdout_share}, must be between 0 and 1")
        read = _Inputs()
        models: dict[str, str] = {}

        def model(source: Path | Model | None, bag: str) -> str:
            if source is None:
                raise FleetError(f"{bag} has no model: give it one, or one to the whole job")
            if isinstance(source, Model):
                return read.keep(f"model {source.name}", source.to_yaml())
            key = os.fspath(source)
            if key not in models:
                models[key] = read.keep(f"model {key}", _model(key).to_yaml())
            return models[key]

        parts: list[dict[str, Any]] = []
        for bag in self._bags() if chunks else []:
            url = _url(bag.bag)
            parts.append(
                {
                    "bag": url,
                    "holdout": None if bag.holdout is None else _url(bag.holdout),
                    "model": model(self.model if bag.model is None else bag.model, url),
                    "machine": bag.machine or _bag.machine_of(url),
                    "recorded": bag.recorded,
                }
            )
        with ThreadPoolExecutor(READERS) as readers:
            for part, prints in zip(parts, readers.map(_prints, parts), strict=True):
                part["sha256"] = prints
        mapping = None if self.mapping is None else read.keep(*_text(self.mapping, "mapping"))
        settings = {
            "mapping": mapping,
            "holdout_share": self.holdout_share,
            "mass_tolerance": self.mass_tolerance,
            "guide_tolerance": self.guide_tolerance,
            "presliding_tolerance": self.presliding_tolerance,
        }
        return Manifest("bags", _native.__version__, settings, read.shas, parts, read.texts)

    def _bags(self) -> list[Bag]:
        if isinstance(self.bags, (str, os.PathLike)):
            return [Bag(url) for url in _bag.find(os.fspath(self.bags))]
        if not self.bags:
            raise FleetError("bags is empty: name a directory, a glob or recordings")
        return [_one(bag, index) for index, bag in enumerate(self.bags)]


Job: TypeAlias = "VariantsJob | SweepJob | BagsJob"
KINDS: dict[str, type[VariantsJob] | type[SweepJob] | type[BagsJob]] = {
    "variants": VariantsJob,
    "sweep": SweepJob,
    "bags": BagsJob,
}
NEEDED = {
    "variants": ("application", "out", "variants"),
    "sweep": ("model", "axes", "out"),
    "bags": ("bags", "out"),
}


def load_job(path: Path) -> Job:
    """Reads a job file; paths in it that are not absolute are relative to it.

    Raises:
        FleetError: With the key and what would be right.
    """
    name = os.fspath(path)
    fs, inside = fsspec.core.url_to_fs(name)
    try:
        text = fs.cat_file(inside).decode()
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or error
        raise FleetError(f"cannot read the job {name}: {why}") from error
    content = _mapping(text, name)
    kind = content.pop("kind", None)
    if kind not in KINDS:
        raise FleetError(f"{name}: kind is {kind!r}, must be {' or '.join(KINDS)}")
    job = KINDS[kind]
    # A controller has no form as text.
    _known(content, [f.name for f in fields(job) if f.name != "controller"], name)
    for key in NEEDED[kind]:
        if content.get(key) is None:
            raise FleetError(f"{name}: {key} is missing")
    if content.get("motion", "") is None:
        raise FleetError(f"{name}: motion is empty, must be fine-step or fast-move")
    for key, value in content.items():
        _check(key, value, name)
    directory = fs.unstrip_protocol(inside).rpartition("/")[0]

    def absolute(where: Any) -> Any:
        if not isinstance(where, str) or "\n" in where or "://" in where:
            return where
        return where if os.path.isabs(where) else f"{directory}/{where}"

    def beside(where: Any) -> Any:
        return where if where in Model.guides() else absolute(where)

    for key in ("application", "out", "mapping"):
        if key in content:
            content[key] = absolute(content[key])
    if "catalogues" in content:
        content["catalogues"] = [absolute(one) for one in content["catalogues"]]
    if content.get("model") is not None:
        content["model"] = beside(content["model"])
    bags = content.get("bags")
    if isinstance(bags, str):
        content["bags"] = absolute(bags)
    elif bags is not None:
        found = []
        for index, bag in enumerate(bags):
            one = _one(bag, index, name)
            found.append(
                Bag(
                    absolute(one.bag),
                    None if one.model is None else beside(one.model),
                    absolute(one.holdout),
                    one.machine,
                    one.recorded,
                )
            )
        content["bags"] = found
    return job(**content)


def _known(content: Mapping[str, Any], known: Sequence[str], where: str) -> None:
    for key in content:
        if key not in known:
            near = difflib.get_close_matches(str(key), known, 1)
            hint = f"; did you mean {near[0]!r}?" if near else f"; known are {', '.join(known)}"
            raise FleetError(f"{where}: unknown key {key!r}{hint}")


NUMBERS = ("holdout_share", "mass_tolerance", "guide_tolerance", "presliding_tolerance")


def _check(key: str, value: Any, where: str) -> None:
    """Refuses what is of a wrong type."""

    def refuse(right: str) -> None:
        raise FleetError(f"{where}: {key} is {value!r}, must be {right}")

    if key in ("variants", "seed", "chunk") or (key == "samples" and value is not None):
        if type(value) is not int or value < (0 if key == "seed" else 1):
            refuse("a whole number" + ("" if key == "seed" else " of at least 1"))
    elif key in NUMBERS:
        if value is not None and not _is_number(value):
            refuse("a number")
    elif key in ("catalogues", "guides"):
        if not isinstance(value, list) or not all(isinstance(one, str) for one in value):
            refuse("a list of names")
    elif key == "sweep":
        if not isinstance(value, dict):
            refuse("a mapping from keys of the application to lists of values")
    elif key == "axes":
        if not (isinstance(value, dict) and all(map(_is_axis, value.items()))):
            refuse("a mapping from keys to lists of values or texts such as '20:60:5'")
    elif key == "bags":
        if not isinstance(value, (str, list)):
            refuse("a directory, a glob or a list")
    elif key == "application":
        if not isinstance(value, (str, dict)):
            refuse("a file or a mapping")
    elif value is not None and not isinstance(value, str):
        refuse("a path")


def _is_axis(axis: tuple[Any, Any]) -> bool:
    key, values = axis
    if not isinstance(values, list):
        return isinstance(key, str) and isinstance(values, str)
    return isinstance(key, str) and all(isinstance(v, (str, int, float)) for v in values)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _one(bag: AnyBag, index: int, where: str = "bags") -> Bag:
    if isinstance(bag, Bag):
        return bag
    if isinstance(bag, (str, os.PathLike)):
        return Bag(bag)
    here = f"{where}: bags[{index}]"
    if not isinstance(bag, Mapping) or "bag" not in bag:
        raise FleetError(f"{here} is {bag!r}, must be a path or have the key 'bag'")
    _known(bag, [f.name for f in fields(Bag)], here)
    recorded = bag.get("recorded")
    if recorded is not None and not _is_number(recorded):
        if not hasattr(recorded, "timestamp"):
            right = "seconds or a date and time"
            raise FleetError(f"{here}: recorded is {recorded!r}, must be {right}")
        recorded = recorded.timestamp()
    return Bag(**{**bag, "recorded": recorded})


def _url(where: Path) -> str:
    fs, path = fsspec.core.url_to_fs(os.fspath(where))
    return str(fs.unstrip_protocol(path))


def _prints(part: Mapping[str, Any]) -> dict[str, str | None]:
    """Fingerprints of a bag and of its hold-out."""
    found: dict[str, str | None] = {}
    for side in ("bag", "holdout"):
        try:
            found[side] = None if part[side] is None else _bag.fingerprint(part[side])
        except OSError:
            # Its chunk says what is wrong with it.
            found[side] = None
    return found


def _text(source: Path | Mapping[str, Any], what: str) -> tuple[str, str]:
    """A name for people and the text: of a file, of a string that holds it, or of keys."""
    if isinstance(source, Mapping):
        return what, json.dumps(dict(source))
    text = os.fspath(source)
    if "\n" in text or "{" in text:
        return what, text
    try:
        fs, path = fsspec.core.url_to_fs(text)
        return text, fs.cat_file(path).decode()
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or error
        raise FleetError(f"cannot read the {what} {text}: {why}") from error


def _model(source: str) -> Model:
    if source in Model.guides():
        return Model.guide(source)
    name, text = _text(source, "model")
    try:
        return Model.from_yaml(text)
    except ValueError as error:
        raise FleetError(f"{name}: {error}") from error


def _mapping(text: str, where: str) -> dict[str, Any]:
    import yaml

    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise FleetError(f"{where} is not YAML: {' '.join(str(error).split())}") from error
    if not isinstance(content, dict):
        raise FleetError(f"{where} holds no keys")
    return content


def _points(sweep: Mapping[str, Sequence[float]]) -> list[dict[str, float]]:
    for key, values in sweep.items():
        right = isinstance(values, (list, tuple)) and values and all(map(_is_number, values))
        if not right:
            raise FleetError(f"sweep: {key} is {values!r}, must be a list of numbers")
    keys = sorted(sweep)
    return [
        dict(zip(keys, map(float, values), strict=True))
        for values in itertools.product(*(sweep[key] for key in keys))
    ]


def _with(base: Mapping[str, Any], values: Mapping[str, float], where: str) -> dict[str, Any]:
    """The application with other values."""
    changed: dict[str, Any] = json.loads(json.dumps(base))
    for key, value in values.items():
        *sections, last = key.split(".")
        inner = changed
        for section in sections:
            inner = inner.setdefault(section, {})
            if not isinstance(inner, dict):
                raise FleetError(f"sweep: {key}: {section} has no keys in {where}")
        # Numbers that are whole stay so, such as the number of guides.
        inner[last] = int(value) if float(value).is_integer() else value
    return changed
