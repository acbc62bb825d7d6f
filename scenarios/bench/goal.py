"""What the figures of a tick shall be. A goal that is missed is said, and fails nothing."""

from collections.abc import Sequence

from qpctrl.certificate import KKT_TOLERANCE
from scenarios.bench.growth import CUBIC, GOAL_US, Growth
from scenarios.bench.humanoid import HUMANOID
from scenarios.bench.row import Row
from scenarios.scenario import Criterion

TICK_US, TAIL_US, INTERPRETED_US = 5.0, 50.0, 60.0
HUMANOID_US, HUMANOID_INTERPRETED_US = 100.0, 400.0
SATURATED = 2.0
"""Ticks with limits active over those without."""
TSID = 0.45
"""Our tick over TSID's."""
SIMULATED = 0.05
"""Time of the core per simulated time."""


def goals(rows: Sequence[Row], grown: Sequence[Growth]) -> list[Criterion]:
    """Return the goals whose figures were measured."""
    found: list[Criterion] = []
    found += [c for row in rows if row.section == "tick" for c in _of_tick(row)]
    ratios = [float(row.facts["ratio"] or 0.0) for row in rows if row.section == "saturated"]
    if ratios:
        found.append(Criterion("saturated over unsaturated tick", max(ratios), SATURATED, ""))
    powers = [one.power for one in grown if one.compiled] or [one.power for one in grown]
    if powers:
        found.append(Criterion("largest power of n in a part's growth", max(powers), CUBIC, ""))
    for row in rows:
        if "realtime_factor" in row.facts and row.name.startswith("eraser"):
            factor = float(row.facts["realtime_factor"] or 0.0)
            name = "eraser, time of the core per simulated time"
            found.append(Criterion(name, 1 / factor, SIMULATED, ""))
        if row.section == "peer" and "ours_over_tsid" in row.facts:
            ratio = float(row.facts["ours_over_tsid"] or 0.0)
            variant = row.name.rpartition(", ")[2]
            found.append(Criterion(f"our tick over TSID's, {variant}", ratio, TSID, ""))
    return found


def _of_tick(row: Row) -> list[Criterion]:
    how, where = "compiled" if row.compiled else "interpreted", f"{row.name}, k = {row.k}"
    found = []
    if row.name == "fr3" and row.k == 3:
        most = TICK_US if row.compiled else INTERPRETED_US
        found.append(Criterion(f"{where}, {how} tick, median", row.median_us, most, "µs"))
        tail = row.timing.p999_kept_us or row.timing.p999_us
        if row.compiled and tail:
            found.append(Criterion(f"{where}, {how} tick, p99.9", tail, TAIL_US, "µs"))
        kkt = float(row.facts["kkt_max"] or 0.0)
        found.append(Criterion(f"{where}, {how} tick, KKT residual", kkt, KKT_TOLERANCE, ""))
    if row.name == HUMANOID:
        most = HUMANOID_US if row.compiled else HUMANOID_INTERPRETED_US
        found.append(Criterion(f"{where}, {how} tick, median", row.median_us, most, "µs"))
        kkt = float(row.facts["kkt_max"] or 0.0)
        found.append(Criterion(f"{where}, {how} tick, KKT residual", kkt, KKT_TOLERANCE, ""))
    if row.joints == 38 and row.compiled:
        found.append(Criterion(f"{where}, {how} tick, median", row.median_us, GOAL_US, "µs"))
    return found
