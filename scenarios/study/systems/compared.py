"""A measure beside its closed form."""

from scenarios.study.system import Measures


def compared(name: str, found: float | None, closed: float | None, floor: float = 0.0) -> Measures:
    """Return a measure, its closed form and the relative distance of the two.

    Args:
        name: of the measure.
        found: its value; none: the rollout has no such quantity.
        closed: its closed form; none: it has none here.
        floor: what the distance is related to where the closed form is smaller.
    """
    gap = None
    if found is not None and closed is not None:
        gap = abs(found - closed) / max(abs(closed), floor)
    return {name: found, f"{name}_closed": closed, f"{name}_gap": gap}


def compared_words(name: str, words: str, closed: str = "closed form") -> dict[str, str]:
    """Return the words of what `compared` returns."""
    return {
        name: words,
        f"{name}_closed": f"{words}: {closed}",
        f"{name}_gap": f"{words}: relative distance from its closed form",
    }
