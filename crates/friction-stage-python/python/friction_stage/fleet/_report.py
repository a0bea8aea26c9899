"""Reports over a data set: ranking and distributions of variants; per machine the trend of each
identified parameter, with outliers named. Polars reads a chunk at a time, so that memory does not
grow with the variants."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from numpy.typing import NDArray

from .. import _native
from ..errors import FleetError
from ._chunk import plan_of, sweep_plan_of
from ._dataset import file_name
from ._job import Job
from ._manifest import MANIFEST, Manifest, States, states
from ._place import Place
from ._trend import MAD_OF_NORMAL, TWO_SIDED_95, Trend, outliers, trend

if TYPE_CHECKING:
    import polars as pl

BINS_PER_DECADE = 40
LOWEST, HIGHEST = -12, 4
"""Decades of the distributions, of m and s."""
QUANTITIES = {"peak_error_m": "peak error", "settling_time_s": "settling time"}


@dataclass(frozen=True)
class Point:
    """A point of a sweep, or the whole of a job without one.

    Attributes:
        values: Of the swept keys.
        summary: As in ``summary.json`` of ``friction-stage select``.
        text: As ``friction-stage select`` prints it.
        counts: Of each quantity and guide, variants in each bin; bins are even over the logarithm.
        required: Largest value of each quantity that the application allows.
    """

    values: dict[str, float]
    summary: dict[str, Any]
    text: str
    counts: dict[str, dict[str, NDArray[np.int64]]]
    required: dict[str, float]


@dataclass(frozen=True)
class SweepSummary:
    """What a sweep says.

    Attributes:
        summary: As in ``summary.json`` of ``friction-stage sweep``.
        text: As ``friction-stage sweep`` prints it.
        figure: Its figure, SVG.
    """

    summary: dict[str, Any]
    text: str
    figure: str


@dataclass(frozen=True)
class MachineTrend:
    """A parameter over the recordings of a machine.

    Attributes:
        machine: Its name.
        parameter: Its owner (``declared`` or an effect) and its name.
        unit: Of the values.
        bags: The recordings, in the order of time.
        times: When, s since the epoch; the number of the recording where one has no time.
        values: Of the parameter.
        lows: Of the 95 % intervals; ``nan`` where there is none.
        highs: Of the same.
        trend: What they do.
    """

    machine: str
    parameter: str
    unit: str
    bags: list[str]
    times: NDArray[np.float64]
    values: NDArray[np.float64]
    lows: NDArray[np.float64]
    highs: NDArray[np.float64]
    trend: Trend


@dataclass
class Report:
    """What a data set says.

    Attributes:
        kind: ``variants``, ``sweep`` or ``bags``.
        out: URL of the data set.
        rows: In it.
        missing: Chunks that are not there.
        failed: Reason of each chunk that failed.
        points: Rankings and distributions of variants.
        sweep: What a sweep says.
        machines: Of bags: by name, with ``bags``, ``verdicts`` and ``effects``.
        trends: Of bags: each parameter of each machine.
        outliers: Of bags: what does not belong to the others, in sentences.
    """

    kind: str
    out: str
    rows: int
    missing: int
    failed: dict[int, str]
    points: list[Point] = field(default_factory=list)
    sweep: SweepSummary | None = None
    machines: dict[str, dict[str, Any]] = field(default_factory=dict)
    trends: list[MachineTrend] = field(default_factory=list)
    outliers: list[str] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        """As ``--json`` prints it."""
        common: dict[str, Any] = {
            "kind": self.kind,
            "out": self.out,
            "rows": self.rows,
            "missing": self.missing,
            "failed": {str(index): reason for index, reason in self.failed.items()},
        }
        if self.kind == "variants":
            return common | {"points": [{"values": p.values} | p.summary for p in self.points]}
        if self.sweep is not None:
            return common | {"sweep": self.sweep.summary}
        trends = [
            {
                "machine": one.machine,
                "parameter": one.parameter,
                "unit": one.unit,
                "bags": len(one.bags),
                "level": one.trend.level,
                "scatter": one.trend.scatter,
                "slope_per_s": one.trend.slope,
                "slope_ci95": one.trend.slope_ci95,
                "moves": one.trend.moves,
                "outliers": [one.bags[index] for index in one.trend.outliers],
            }
            for one in self.trends
        ]
        return common | {"machines": self.machines, "trends": trends, "outliers": self.outliers}

    def page(self) -> str:
        """A self-contained page. Needs matplotlib."""
        from ._page import page

        return page(self)

    def __str__(self) -> str:
        lines = []
        for point in self.points:
            if point.values:
                lines.append(", ".join(f"{key} {value:g}" for key, value in point.values.items()))
            lines.append(point.text.rstrip())
        if self.sweep is not None:
            lines.append(self.sweep.text.rstrip())
        for name, machine in self.machines.items():
            verdicts = ", ".join(f"{count} {what}" for what, count in machine["verdicts"].items())
            effects = ", ".join(f"{what} in {n}" for what, n in machine["effects"].items())
            lines.append(f"{name}: {machine['bags']} bags, {verdicts}; {effects or 'no effect'}")
        moving = [one for one in self.trends if one.trend.moves]
        lines += [f"{one.machine}: {one.parameter} {_per_day(one)}" for one in moving]
        lines += [f"outlier: {outlier}" for outlier in self.outliers]
        if self.missing:
            lines.append(f"{self.missing} chunks are missing, {len(self.failed)} of them failed")
        return "\n".join(lines)


def _per_day(one: MachineTrend) -> str:
    ci95 = one.trend.slope_ci95 or (0.0, 0.0)
    day = 86_400.0
    low, high = sorted((ci95[0] * day, ci95[1] * day))
    slope = (one.trend.slope or 0.0) * day
    return f"moves by {slope:.3g} {one.unit}/day (95 %: {low:.3g} to {high:.3g})"


def report(job: Job) -> Report:
    """Reads the data set of a job. Needs polars.

    Raises:
        FleetError: There is no data set, or nothing in it.
    """
    try:
        import polars  # noqa: F401
    except ImportError as error:
        raise FleetError("reports need: pip install friction-stage[polars,plot]") from error
    place = Place(job.out)
    manifest = Manifest.load(place)
    if manifest is None:
        raise FleetError(f"{place.url} has no {MANIFEST}: nothing was begun there")
    found = states(manifest, place)
    if not found.done:
        raise FleetError(f"no chunk of {place.url} is done")
    read = Report(
        kind=manifest.kind,
        out=place.url,
        rows=sum(found.done.values()),
        missing=len(manifest.chunks) - len(found.done),
        failed=dict(sorted((found.failed | found.foreign).items())),
    )
    if manifest.kind == "variants":
        read.points = _points(manifest, place, found)
    elif manifest.kind == "sweep":
        read.sweep = _sweep(manifest, place, found)
    else:
        _machines(read, place, found)
    return read


def _frames(place: Place, chunks: Iterator[int], columns: list[str]) -> Iterator[pl.DataFrame]:
    import polars as pl

    for chunk in chunks:
        yield pl.read_parquet(io.BytesIO(place.read(file_name(chunk))), columns=columns)


def _points(manifest: Manifest, place: Place, found: States) -> list[Point]:
    import polars as pl

    columns = ["guide", "peak_error_m", "settling_time_s", "saturated"]
    bins = (HIGHEST - LOWEST) * BINS_PER_DECADE
    points = []
    for number, point in enumerate(manifest.settings["points"]):
        plan = plan_of(manifest.settings, manifest.texts, number)
        ranking = plan.ranking()
        counts = {
            quantity: {guide: np.zeros(bins, dtype=np.int64) for guide in plan.guides}
            for quantity in QUANTITIES
        }
        chunks = [c for c in sorted(found.done) if manifest.chunks[c]["point"] == number]
        for chunk, frame in zip(chunks, _frames(place, iter(chunks), columns), strict=True):
            settling = frame["settling_time_s"].fill_null(float("nan")).to_numpy()
            ranking.add(
                manifest.chunks[chunk]["first"],
                frame["peak_error_m"].to_numpy(),
                settling,
                frame["saturated"].to_numpy(),
            )
            for quantity in QUANTITIES:
                place_of = (pl.col(quantity).log10() - LOWEST) * BINS_PER_DECADE
                whole = place_of.floor().clip(0, bins - 1).cast(pl.Int64)
                rows = (
                    frame.lazy()
                    .filter(pl.col(quantity) > 0.0)
                    .group_by("guide", whole.alias("bin"))
                    .len()
                    .collect()
                )
                for guide, bin_number, count in rows.iter_rows():
                    counts[quantity][guide][bin_number] += count
        if chunks:
            summary, text = ranking.conclude()
            asked = yaml.safe_load(manifest.texts[point["application"]])["requirement"]
            required = {
                "peak_error_m": float(asked["peak_error"]),
                "settling_time_s": float(asked["settling_time"]),
            }
            points.append(Point(dict(point["values"]), json.loads(summary), text, counts, required))
    return points


def _sweep(manifest: Manifest, place: Place, found: States) -> SweepSummary:
    import polars as pl

    tally = _native.SweepTally(sweep_plan_of(manifest.settings, manifest.texts))
    for chunk in sorted(found.done):
        frame = pl.read_parquet(io.BytesIO(place.read(file_name(chunk))))
        columns = {
            one.name: one.to_list()
            if one.dtype == pl.String
            else one.fill_null(float("nan")).to_numpy()
            if one.dtype == pl.Float64
            else one.to_numpy()
            for one in frame.iter_columns()
        }
        tally.add(manifest.chunks[chunk]["first"], columns)
    summary, text, figure = tally.conclude()
    return SweepSummary(json.loads(summary), text, figure)


def _machines(read: Report, place: Place, found: States) -> None:
    import polars as pl

    columns = ["bag", "machine", "recorded_s", "verdict", "effects", "parameters"]
    rows = pl.concat(list(_frames(place, iter(sorted(found.done)), columns)))
    rows = rows.sort("machine", "recorded_s", "bag", nulls_last=True)
    for (name,), of_machine in rows.group_by(["machine"], maintain_order=True):
        verdicts = of_machine.group_by("verdict").len().sort("len", "verdict", descending=True)
        effects = (
            of_machine.select(pl.col("effects").explode().drop_nulls().alias("effect"))
            .group_by("effect")
            .len()
            .sort("len", "effect", descending=True)
        )
        read.machines[str(name)] = {
            "bags": of_machine.height,
            "verdicts": dict(verdicts.iter_rows()),
            "effects": dict(effects.iter_rows()),
        }
        read.outliers += _strange_effects(str(name), of_machine)
    long = (
        rows.with_columns(
            time=pl.when(pl.col("recorded_s").null_count().over("machine") == 0)
            .then(pl.col("recorded_s"))
            .otherwise(pl.int_range(pl.len()).over("machine").cast(pl.Float64))
        )
        .explode("parameters")
        .filter(pl.col("parameters").is_not_null())
        .unnest("parameters")
        .with_columns(parameter=pl.concat_str("owner", "name", separator="."))
    )
    keys = ["machine", "parameter"]
    for (machine, parameter), of_one in long.group_by(keys, maintain_order=True):
        read.trends.append(_trend_of(str(machine), str(parameter), of_one))
    for one in read.trends:
        for index in one.trend.outliers:
            read.outliers.append(
                f"{one.bags[index]}: {one.parameter} is {one.values[index]:.4g} {one.unit}, that "
                f"of {one.machine} {one.trend.level:.4g} with a scatter of {one.trend.scatter:.2g}"
            )
    read.outliers += _strange_machines(read.trends)


def _trend_of(machine: str, parameter: str, rows: pl.DataFrame) -> MachineTrend:
    numbers = {
        name: rows[name].fill_null(float("nan")).to_numpy().astype(float)
        for name in ("time", "value", "low", "high")
    }
    sigmas = (numbers["high"] - numbers["low"]) / (2.0 * TWO_SIDED_95)
    return MachineTrend(
        machine=machine,
        parameter=parameter,
        unit=str(rows["unit"][0]),
        bags=rows["bag"].to_list(),
        times=numbers["time"],
        values=numbers["value"],
        lows=numbers["low"],
        highs=numbers["high"],
        trend=trend(numbers["time"], numbers["value"], sigmas),
    )


def _strange_effects(machine: str, rows: pl.DataFrame) -> list[str]:
    """Bags whose effects are not those that most recordings of their machine show."""
    sets = [(bag, tuple(sorted(effects))) for bag, effects in rows.select("bag", "effects").rows()]
    counts: dict[tuple[str, ...], int] = {}
    for _, effects in sets:
        counts[effects] = counts.get(effects, 0) + 1
    usual, most = max(counts.items(), key=lambda entry: entry[1])
    if 2 * most <= len(sets):
        return []
    effects_of_most = ", ".join(usual) or "no effect"
    return [
        f"{bag}: shows {', '.join(effects) or 'no effect'}, most of {machine} {effects_of_most}"
        for bag, effects in sets
        if effects != usual
    ]


def _strange_machines(trends: list[MachineTrend]) -> list[str]:
    """Machines whose level of a parameter is not that of the others."""
    messages = []
    for parameter in sorted({one.parameter for one in trends}):
        of_all = [one for one in trends if one.parameter == parameter]
        levels = np.array([one.trend.level for one in of_all])
        residuals = levels - np.median(levels)
        scatter = MAD_OF_NORMAL * float(np.median(np.abs(residuals)))
        own = np.array([one.trend.scatter for one in of_all])
        for index in outliers(residuals, scatter, own):
            one = of_all[index]
            messages.append(
                f"machine {one.machine}: {parameter} is {one.trend.level:.4g} {one.unit}, that of "
                f"the fleet {np.median(levels):.4g} with a scatter of {scatter:.2g}"
            )
    return messages
