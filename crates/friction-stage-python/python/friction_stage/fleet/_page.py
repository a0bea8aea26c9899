"""The self-contained page of a report: tables, and figures as SVG."""

from __future__ import annotations

import datetime
import importlib
import io
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import FleetError
from ._report import BINS_PER_DECADE, LOWEST, QUANTITIES, MachineTrend, Point, Report

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_FIGURES = 40
"""Machines that are drawn: those with outliers first, then those that move."""
MOST_PARAMETERS = 12
SHOWN_REASONS = 100
SCALES = {"peak_error_m": (1e6, "µm"), "settling_time_s": (1e3, "ms")}
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#555555")
"""Distinct with any colour vision (Okabe and Ito, 2008)."""

STYLE = """
:root { color-scheme: light dark; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 70rem; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; display: block; overflow-x: auto; }
th, td { padding: .25rem .75rem; text-align: right; border-bottom: 1px solid #8886; }
th:first-child, td:first-child, td.words { text-align: left; }
figure { margin: 1rem 0; overflow-x: auto; }
figure svg { min-width: 40rem; max-width: 100%; height: auto; }
@media screen and (prefers-color-scheme: dark) {
  figure svg { filter: invert(0.9) hue-rotate(180deg); }
}
li { overflow-wrap: anywhere; }
pre { overflow-x: auto; }
"""


def page(report: Report) -> str:
    """The page.

    Raises:
        FleetError: matplotlib is missing.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise FleetError("the page needs: pip install friction-stage[plot]") from error
    what = {"variants": "Variants", "sweep": "Sweep"}.get(report.kind, "Recordings")
    draw = {"variants": _variants, "sweep": _sweep}.get(report.kind, _bags)
    parts = [f"<h1>{what} of a fleet</h1>", f"<p>{report.rows} rows in {escape(report.out)}.</p>"]
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "fleet", "font.size": 9}):
        parts += draw(report)
    if report.missing:
        parts.append(f"<h2>Missing</h2><p>{report.missing} chunks are not there.</p>")
        reasons = list(report.failed.items())[:SHOWN_REASONS]
        parts.append(_list([f"chunk {index}: {reason}" for index, reason in reasons]))
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{what} of a fleet</title><style>{STYLE}</style></head>\n<body>\n"
        + "\n".join(parts)
        + "\n</body></html>\n"
    )


def _list(lines: list[str]) -> str:
    return "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"


def _table(head: list[str], rows: list[list[str]]) -> str:
    def row(cells: list[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    body = "".join(row(cells, "td") for cells in rows)
    return f"<table><thead>{row(head, 'th')}</thead><tbody>{body}</tbody></table>"


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    # The ground is that of the page, light or dark.
    return Figure(figsize=(width, height), layout="constrained", facecolor="none")


def _svg(figure: Figure, says: str) -> str:
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :]
    return f'<figure role="img" aria-label="{escape(says)}">{svg}</figure>'


def _sweep(report: Report) -> list[str]:
    if report.sweep is None:
        return []
    svg = report.sweep.figure
    svg = svg[svg.index("<svg") :]
    says = "peak error and time to settle over each axis"
    return [
        f"<pre>{escape(report.sweep.text.rstrip())}</pre>",
        f'<figure role="img" aria-label="{says}">{svg}</figure>',
    ]


def _variants(report: Report) -> list[str]:
    parts: list[str] = []
    for point in report.points:
        name = ", ".join(f"{key} = {value:g}" for key, value in point.values.items())
        choice = point.summary["choice"]
        parts.append(f"<h2>{escape(name or point.summary['application'])}</h2>")
        advice = f"Take {choice}." if choice else "No guide meets the requirement."
        parts.append(f"<p><strong>{escape(advice)}</strong></p>")
        parts.append(_ranking(point))
        parts.append(_svg(_distributions(point), "distribution of peak error and settling time"))
        if point.summary["warnings"]:
            parts.append(_list(point.summary["warnings"]))
    return parts


def _ranking(point: Point) -> str:
    def quantiles(of: dict[str, Any], scale: float) -> str:
        median, high = of["q50"], of["q95"]
        return " / ".join("never" if q is None else f"{q * scale:.3g}" for q in (median, high))

    rows = []
    for one in point.summary["ranking"]:
        low, high = one["chance_ci95"]
        chance = f"{100 * one['chance']:.1f} % ({100 * low:.1f} to {100 * high:.1f})"
        rows.append(
            [
                one["guide"] + (f" ({one['obstacle']})" if one["obstacle"] else ""),
                str(one["variants"]),
                chance,
                quantiles(one["peak_error"], 1e6),
                quantiles(one["settling_time"], 1e3),
            ]
        )
    head = [
        "guide",
        "variants",
        "meets the requirement (95 %)",
        "peak error, µm: median / 95 %",
        "settled after, ms: median / 95 %",
    ]
    return _table(head, rows)


def _distributions(point: Point) -> Figure:
    from matplotlib.ticker import LogLocator, NullFormatter

    figure = _figure(9.5, 3.2)
    for axes, (quantity, name) in zip(figure.subplots(1, 2), QUANTITIES.items(), strict=True):
        scale, unit = SCALES[quantity]
        bins = len(next(iter(point.counts[quantity].values())))
        edges = scale * 10.0 ** (LOWEST + np.arange(bins + 1) / BINS_PER_DECADE)
        # In the order of the ranking.
        order = [one["guide"] for one in point.summary["ranking"]]
        used = np.zeros(len(edges) - 1, dtype=bool)
        for colour, guide in zip(np.resize(COLOURS, len(order)), order, strict=True):
            counts = point.counts[quantity][guide]
            used |= counts > 0
            shares = 100.0 * counts / max(1, next(
                one["variants"] for one in point.summary["ranking"] if one["guide"] == guide
            ))  # fmt: skip
            axes.stairs(shares, edges, color=colour, label=guide, linewidth=1.4)
        if used.any():
            first, last = np.flatnonzero(used)[[0, -1]]
            axes.set_xlim(edges[max(first - 2, 0)], edges[min(last + 3, len(edges) - 1)])
        allowed = scale * point.required[quantity]
        axes.axvline(allowed, color="#000000", linestyle=":", linewidth=1.2, label="allowed")
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel(f"{name}, {unit}")
        axes.set_ylabel("share of the variants per bin, %")
        _plain(axes)
        axes.legend(frameon=False)
    return figure


def _plain(axes: Axes) -> None:
    axes.set_facecolor("none")
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25)


def _bags(report: Report) -> list[str]:
    parts = [f"<h2>Outliers</h2>{_list(report.outliers) if report.outliers else '<p>None.</p>'}"]

    def cells(counts: dict[str, int]) -> str:
        return ", ".join(f"{what} {count}" for what, count in counts.items()) or "none"

    of_machine: dict[str, list[MachineTrend]] = {name: [] for name in report.machines}
    for one in report.trends:
        of_machine[one.machine].append(one)

    def weight(name: str) -> tuple[int, int]:
        trends = of_machine[name]
        return (
            -sum(len(one.trend.outliers) for one in trends),
            -sum(one.trend.moves for one in trends),
        )

    ranked = sorted(report.machines, key=lambda name: (weight(name), name))
    rows = [
        [
            name,
            str(report.machines[name]["bags"]),
            cells(report.machines[name]["verdicts"]),
            cells(report.machines[name]["effects"]),
            ", ".join(one.parameter for one in of_machine[name] if one.trend.moves) or "nothing",
            str(-weight(name)[0]),
        ]
        for name in ranked
    ]
    head = ["machine", "bags", "verdicts", "effects", "what moves", "outliers"]
    parts.append("<h2>Machines</h2><p>Those with outliers first, then those that move.</p>")
    parts.append(_table(head, rows))
    parts.append("<h2>Distributions</h2><p>Of every recording of the fleet.</p>")
    parts.append(_svg(_fleet(report.trends), "distribution of each parameter over the fleet"))
    for name in ranked[:MOST_FIGURES]:
        parts.append(f"<h2>{escape(name)}</h2>")
        parts.append(_svg(_machine(of_machine[name]), f"trend of each parameter of {name}"))
    if len(ranked) > MOST_FIGURES:
        parts.append(f"<p>{len(ranked) - MOST_FIGURES} more machines are in the table.</p>")
    return parts


def _grid(count: int) -> tuple[Figure, list[Axes]]:
    columns = 3
    lines = -(-count // columns)
    figure = _figure(9.5, 2.3 * lines)
    every = list(np.ravel(figure.subplots(lines, columns, squeeze=False)))
    for spare in every[count:]:
        spare.set_axis_off()
    return figure, every[:count]


def _names(trends: list[MachineTrend]) -> list[str]:
    """The parameters of most recordings, in a stable order."""
    counts: dict[str, int] = {}
    for one in trends:
        counts[one.parameter] = counts.get(one.parameter, 0) + len(one.bags)
    most = sorted(counts, key=lambda name: (-counts[name], name))[:MOST_PARAMETERS]
    return sorted(most)


def _fleet(trends: list[MachineTrend]) -> Figure:
    from matplotlib.ticker import MaxNLocator

    names = _names(trends)
    figure, every = _grid(len(names))
    for axes, name in zip(every, names, strict=True):
        of_all = [one for one in trends if one.parameter == name]
        values = np.concatenate([one.values for one in of_all])
        axes.hist(values, bins="auto" if len(values) > 1 else 1, color=COLOURS[0])
        axes.set_xlabel(f"{name}, {of_all[0].unit}" if of_all[0].unit else name)
        axes.xaxis.set_major_locator(MaxNLocator(3))
        axes.ticklabel_format(axis="x", useOffset=False)
        axes.set_ylabel("recordings")
        axes.yaxis.set_major_locator(MaxNLocator(5, integer=True))
        _plain(axes)
    return figure


def _machine(trends: list[MachineTrend]) -> Figure:
    from matplotlib.ticker import MaxNLocator

    names = _names(trends)
    by_name = {one.parameter: one for one in trends}
    figure, every = _grid(len(names))
    for axes, name in zip(every, names, strict=True):
        one = by_name[name]
        dated = bool(one.times.min() > 1e8)
        when: Any = one.times
        if dated:
            when = [datetime.datetime.fromtimestamp(t, datetime.timezone.utc) for t in one.times]
        spread = np.vstack([one.values - one.lows, one.highs - one.values])
        spread = np.where(np.isfinite(spread), np.maximum(spread, 0.0), 0.0)
        axes.errorbar(
            when, one.values, yerr=spread, fmt="o", markersize=3, color=COLOURS[0], elinewidth=1
        )
        if one.trend.slope is not None:
            line = one.trend.level + one.trend.slope * (one.times - np.median(one.times))
            axes.plot(when, line, color=COLOURS[2] if one.trend.moves else "#999999", linewidth=1)
        for index in one.trend.outliers:
            axes.plot(when[index], one.values[index], "o", markersize=9, fillstyle="none",
                      color=COLOURS[1])  # fmt: skip
            axes.annotate(
                one.bags[index].rstrip("/").rpartition("/")[2],
                (when[index], one.values[index]),
                textcoords="offset points",
                xytext=(6, 6),
                fontsize=7,
                color=COLOURS[1],
            )
        if dated:
            dates: Any = importlib.import_module("matplotlib.dates")
            locator = dates.AutoDateLocator(minticks=2, maxticks=5)
            axes.xaxis.set_major_locator(locator)
            axes.xaxis.set_major_formatter(dates.ConciseDateFormatter(locator))
        else:
            axes.set_xlabel("recording")
            axes.set_xlim(one.times.min() - 0.5, one.times.max() + 0.5)
            axes.xaxis.set_major_locator(MaxNLocator(5, integer=True, min_n_ticks=1))
        # Beside the axes, a long name would lie on that of the row below.
        axes.set_title(f"{name}, {one.unit}" if one.unit else name, fontsize=8)
        axes.ticklabel_format(axis="y", useOffset=False)
        _plain(axes)
    return figure
