"""The results of the comparison as tables of a document."""

from __future__ import annotations

import math


def markdown(results: list[dict]) -> str:
    results = sorted(results, key=order)
    parts = [
        "## What each tool says",
        said(results),
        "## What is left on the held-out record",
        left(results),
        "## Where the answer is known",
        score(results),
        "## CPU time",
        cost(results),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def order(result: dict) -> tuple:
    name, _, number = result["case"].partition("_")
    kinds = ["a", "b", "c", "d", "e", "f", "emps", "screw", "blind", "null"]
    return kinds.index(name), int(number or 0)


def rows(head: list[str], body: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *body]
    cells = ([cell.replace("|", "\\|") for cell in line] for line in lines)
    return "\n".join("| " + " | ".join(line) + " |" for line in cells)


def force(value: float | None, unit: float) -> str:
    return "-" if value is None or math.isnan(value) else f"{value / unit:.3g}"


def pair(found: dict | None, unit: float) -> str:
    """All rows (moving rows)."""
    error = (found or {}).get("holdout")
    if not error or error["all_rows"] is None or math.isnan(error["all_rows"]):
        return "-"
    return f"{force(error['all_rows'], unit)} ({force(error['moving_rows'], unit)})"


def unit_of(result: dict) -> float:
    return 1e-3 if result["case"] == "screw" else 1.0


def label(result: dict) -> str:
    return result["case"].replace("_", " ") + (", mN m" if result["case"] == "screw" else "")


def hidden(result: dict) -> str:
    if "hidden" not in result:
        return "not stated"
    return ", ".join(f"`{name}`" for name in result["hidden"]) or "nothing"


def terms(found: dict | None) -> str:
    if not found or "terms" not in found:
        return "-"
    names = list(found["terms"])
    if not names:
        return "no term"
    shown = ", ".join(names[:6])
    return f"{len(names)}: {shown}" + (", ..." if len(names) > 6 else "")


def said(results: list[dict]) -> str:
    body = []
    for result in results:
        ours, peer = result["friction_stage"], result["pysindy"]
        says = ours.get("says", "error")
        if ours.get("error"):
            says += ": " + ours["error"].rsplit("error: ", 1)[-1]
        simulator = result.get("mujoco", {})
        body.append(
            [
                label(result),
                hidden(result),
                says,
                terms(peer.get("found")),
                terms(peer.get("offered")),
                moved(simulator.get("declared")),
                moved(simulator.get("offered")),
            ]
        )
    return rows(
        [
            "recording",
            "hidden",
            "friction-stage",
            "PySINDy, terms found",
            "PySINDy, periods offered by hand",
            "MuJoCo, declared model",
            "MuJoCo, law offered by hand",
        ],
        body,
    )


def moved(found: dict | None) -> str:
    if not found:
        return "-"
    if "factors" not in found:
        return "error"
    error = found["window_position_rms_um"]
    text = f"windows {error['declared']:.3g} -> {error['fitted']:.3g} µm"
    if "spring" in found["factors"]:
        text += f", spring {found['factors']['spring']:.4g} N/m"
    for i in range(4):
        if f"sine{i}" in found["factors"]:
            size = math.hypot(found["factors"][f"sine{i}"], found["factors"][f"cosine{i}"])
            text += f", ripple {size:.3g} N"
    if found["at_bound"]:
        text += f"; at a bound: {', '.join(found['at_bound'])}"
    return text + ("" if found["converged"] else "; not converged")


def left(results: list[dict]) -> str:
    body = []
    for result in results:
        unit = unit_of(result)
        peer, simulator = result["pysindy"], result.get("mujoco", {})
        found, offered = peer.get("found", {}), peer.get("offered", {})
        body.append(
            [
                label(result),
                force(result["floor"], unit) if result["floor"] else "-",
                pair(result["grey_box"], unit),
                pair(result["friction_stage"], unit),
                pair(found, unit),
                pair({"holdout": found.get("holdout_refitted")}, unit),
                pair(offered, unit),
                pair({"holdout": offered.get("holdout_refitted")}, unit),
                pair(peer.get("raw_states"), unit),
                pair(simulator.get("declared"), unit),
                pair(simulator.get("offered"), unit),
            ]
        )
    return rows(
        [
            "recording",
            "encoder noise",
            "declared model, fitted",
            "friction-stage",
            "PySINDy, found",
            "and refitted",
            "PySINDy, offered",
            "and refitted",
            "PySINDy, raw states",
            "MuJoCo, declared",
            "MuJoCo, offered",
        ],
        body,
    )


def score(results: list[dict]) -> str:
    known = [r for r in results if "hidden" in r]
    if not known:
        return ""
    body = []
    for kind, of_kind in (
        ("something hidden", [r for r in known if r["hidden"]]),
        ("nothing hidden", [r for r in known if not r["hidden"]]),
    ):
        judged = [r["terms_judged"] for r in of_kind if "terms_judged" in r]
        shown = sum(j["shown"] for j in judged)
        of_all = sum(j["hidden"] for j in judged)
        body.append(
            [
                kind,
                str(len(of_kind)),
                f"{sum(r['right'] for r in of_kind)} of {len(of_kind)}",
                f"{shown} of {of_all}" if of_all else "-",
                str(sum(j["false_terms"] for j in judged)),
                f"{sum(not j['false_terms'] and j['shown'] == j['hidden'] for j in judged)}"
                f" of {len(judged)}",
            ]
        )
    return rows(
        [
            "recordings",
            "number",
            "friction-stage: verdict right",
            "PySINDy: effects that show in a term",
            "PySINDy: false terms",
            "PySINDy: all effects and no false term",
        ],
        body,
    )


def cost(results: list[dict]) -> str:
    def seconds(found: dict | None, part: str) -> float:
        return (found or {}).get("cpu", {}).get(part, 0.0)

    body = []
    for result in results:
        peer, simulator = result["pysindy"], result.get("mujoco", {})
        grey = result["grey_box"]["cpu"]
        line = [
            label(result),
            f"{grey['load']:.1f} / {grey['fit']:.1f}",
            f"{sum(result['friction_stage'].get('cpu', {}).values()):.1f}",
        ]
        for name, parts in (
            ("found", ("load", "select", "fit")),
            ("raw_states", ("load", "select")),
        ):
            found = peer.get(name)
            line.append(
                " / ".join(f"{seconds(found, part):.1f}" for part in parts) if found else "-"
            )
        fitted = simulator.get("declared")
        line.append(
            f"{seconds(fitted, 'load'):.1f} / {seconds(fitted, 'fit'):.1f}" if fitted else "-"
        )
        body.append(line)
    return rows(
        [
            "recording",
            "reading and grey box: load / fit",
            "friction-stage: load, fit and select",
            "PySINDy on the residual: load / select / refit",
            "PySINDy on raw states: load / select",
            "MuJoCo: load / fit",
        ],
        body,
    )
