"""Whether an answer is right, where what is hidden is known: the only part that reads the
answers."""

from __future__ import annotations

from pathlib import Path

from data import Case, yaml_of

# Terms of the library that a law may show as, apart from ripples.
FAMILIES = {
    "constant_force": {"1"},
    "cable_chain": {"x", "1"},
    "quadratic_drag": {"v|v|", "v"},
    "asymmetric_friction": {"1", "sign^2 v", "v^2"},
    "position_dependent_friction": {"sign v", "x sign v", "x^2 sign v"},
}
# A ripple counts as found with a period of the grid that is no further from the truth than this.
NEAR = 0.125


def hidden_effects(case: Case, out: Path) -> list[tuple[str, dict]]:
    file = out / "answers" / f"{case.name}.yaml"
    effects = yaml_of(file.read_text())["effects"] if file.exists() else []
    return [pair for effect in effects for pair in effect.items()]


def explains(term: str, name: str, values: dict) -> bool:
    ripple = term.startswith(("sin ", "cos "))
    if name == "map":
        # It has no law: any term of the position may stand for it.
        return ripple or term in {"1", "x", "x^2", "x^3"}
    if name in ("cogging", "ball_passage"):
        period = 1e-3 * float(term.split()[1]) if ripple else 0.0
        return ripple and abs(period / values["period"] - 1) < NEAR
    return term in FAMILIES[name]


def judge_terms(terms: dict, hidden: list[tuple[str, dict]]) -> dict:
    """Of the hidden effects how many show in a term, and how many terms belong to none of them."""
    shown = [name for name, values in hidden if any(explains(t, name, values) for t in terms)]
    false = [t for t in terms if not any(explains(t, *effect) for effect in hidden)]
    return {"hidden": len(hidden), "shown": len(shown), "false_terms": len(false)}


def judge_verdict(answer: dict, hidden: list[tuple[str, dict]]) -> bool:
    """A verdict is right with the names of all that is hidden, or where it says that there is none.

    A force that follows no law has to be `unknown`, with the names of what else is hidden.
    """
    names = sorted(name for name, _ in hidden)
    if not names:
        return answer.get("verdict") == "none"
    if "map" in names:
        return answer.get("verdict") == "unknown" and sorted(answer["effects"]) == names
    return answer.get("verdict") == "found" and sorted(answer["effects"]) == names
