"""A haptic interface with one degree of freedom: a hand feels m s² + b s + k.

The textbook's figure of impedance control. A sum of sines pushes the interface; the ratio of
force to position at each frequency is the impedance that the hand feels.
Source: LynchPark2017 §11.7.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import Vector, Wrench, positive
from qpctrl.errors import InputError
from qpctrl.mode import Mode
from qpctrl.objective import Reference, Weighted
from scenarios.environment import Hand
from scenarios.metric import column, tick_metrics, whole_run_metrics
from scenarios.panel import Panel
from scenarios.plant import PlantState
from scenarios.plant_compliant import CompliantPlant
from scenarios.report_bode import Response, bode_figure
from scenarios.report_trace import Curve, curve_figure
from scenarios.scenario import Criterion, Directive, Experiment, Options, Outcome
from scenarios.slider import SPACE, slider
from tasks import ImpedanceReference, ImpedanceTask

DT = 1e-3  # s, the control period
SETTLE_TIME = 2.0  # s, until the start has decayed
WINDOW = 5.0  # s, a whole number of periods of every sine
POINTS = 15  # frequencies
CUTOFF = 300.0  # Hz, of the acceleration's filter
HOLD_GAP = 0.02  # of |Z|: torque is held for a tick, which takes k T / 2 from the damping
REST = pin.SE3.Identity()


class Sweep(NamedTuple):
    """What the hand felt at each frequency."""

    frequency: Vector
    """Frequencies [Hz]."""
    Z: Response
    """Measured impedance F/X [N/m]."""


class HapticGuide:
    """Holds the spring's rest position while the hand pushes."""

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do at ``state``, or none when the window is over."""
        if state.time >= SETTLE_TIME + WINDOW:
            return None
        phase = "settle" if state.time < SETTLE_TIME else "sweep"
        references: dict[str, Reference] = {"impedance": ImpedanceReference(X_WD=REST)}
        return Directive(phase, "impedance", references)


@dataclass(frozen=True, kw_only=True)
class Haptic:
    """Feel a virtual mass, spring and damper through an interface, at many frequencies at once."""

    name: ClassVar[str] = "haptic"
    summary: ClassVar[str] = "feel a virtual mass-spring-damper: measured Z(jω) and Y(jω)"

    mass: float = 1.0
    """Moving mass of the interface itself [kg]."""
    virtual_mass: float | None = None
    """Mass that the hand shall feel [kg]; default: the interface's own, no acceleration used."""
    stiffness: float = 400.0
    """Virtual stiffness k [N/m]."""
    damping: float = 20.0
    """Virtual damping b [N s/m]."""
    amplitude: float = 1.0
    """Amplitude of each sine of the hand's force [N]."""
    low: float = 0.4
    """Lowest frequency [Hz]."""
    high: float = 30.0
    """Highest frequency [Hz]."""

    def __post_init__(self) -> None:
        for name in ("mass", "stiffness", "amplitude", "low", "high", "damping"):
            positive(getattr(self, name), (), name)
        if self.virtual_mass is not None:
            positive(self.virtual_mass, (), "virtual_mass")
            heaviest = 2 * self.mass / (1 - np.exp(-2 * np.pi * CUTOFF * DT))
            if self.virtual_mass >= heaviest:
                raise InputError(
                    f"virtual_mass: got {self.virtual_mass}, need less than {heaviest:.4g} kg: the "
                    "measured acceleration is one tick old"
                )
        if not 1 / WINDOW <= self.low < self.high <= 0.1 / DT:
            raise InputError(
                f"low, high: got {self.low} and {self.high} Hz, need {1 / WINDOW:g} ≤ low < high "
                f"≤ {0.1 / DT:g} Hz"
            )

    @property
    def lateness(self) -> float:
        """What an acceleration that is late by a tick and a half and its filter costs [× |Z|]."""
        late = 1.5 * DT + 1 / (2 * np.pi * CUTOFF)
        off = 0.0 if self.virtual_mass is None else abs(1 - self.mass / self.virtual_mass)
        return float(off * 2 * np.pi * self.high * late)

    @property
    def frequencies(self) -> Vector:
        """Frequencies of the hand's force [Hz], whole periods of the window, log-spaced."""
        spaced = np.geomspace(self.low, self.high, POINTS)
        return np.unique(np.round(spaced * WINDOW)) / WINDOW

    def impedance(self, frequency: Vector) -> Response:
        """Return Z = m s² + b s + k [N/m] at s = jω."""
        s = 2j * np.pi * frequency
        m = self.mass if self.virtual_mass is None else self.virtual_mass
        return m * s**2 + self.damping * s + self.stiffness

    def push(self) -> Callable[[float], Wrench]:
        """Return the hand's push: time [s] → wrench of hand on robot (6) [N, Nm]."""
        omega, i = 2 * np.pi * self.frequencies, np.arange(len(self.frequencies))
        phase = -np.pi * i * (i + 1) / len(i)  # Schroeder's phases keep the peak of the sum low

        def wrench(time: float) -> Wrench:
            F = np.zeros(6)
            F[0] = self.amplitude * np.sin(omega * time + phase).sum()
            return F

        return wrench

    def prepare(self, options: Options) -> Experiment:
        """Return the experiment, ready to run."""
        joints = options.joints(slider(self.mass), DT)
        robot = joints.robot
        task = ImpedanceTask(
            space=SPACE, K_v=self.stiffness, B_v=self.damping, M_v=self.virtual_mass, cutoff=CUTOFF
        )
        controller = options.controller(
            robot, (Mode(name="impedance", tasks=(Weighted(task),)),), DT
        )
        return Experiment(
            robot=robot,
            controller=controller,
            plant=joints.drive(
                CompliantPlant(
                    robot,
                    SPACE.frame,
                    Hand(self.push()),
                    dt=joints.dt,
                    substeps=1,
                    armature=joints.armature,
                )
            ),
            guide=HapticGuide(),
            start_mode="impedance",
            q_start=robot.home,
            horizon=SETTLE_TIME + WINDOW + 1.0,
            geometry={},
        )

    def sweep(self, table: pl.DataFrame) -> Sweep:
        """Return the impedance that was measured, from the last window of the record."""
        force = -column(table, "wrench.fx")[1:]  # a wrench is one period old
        x, time = column(table, "q.x")[:-1], column(table, "time")[:-1]
        window = slice(-round(WINDOW / DT), None)
        f = self.frequencies
        turning = np.exp(-2j * np.pi * f[:, None] * time[None, window])
        return Sweep(f, (turning @ force[window]) / (turning @ x[window]))

    def metrics(self, table: pl.DataFrame) -> dict[str, float]:
        """Return how far the measured Z and Y are from the model, and the usual."""
        f, Z = self.sweep(table)
        share = Z / self.impedance(f)
        return {
            "impedance_gap_max": float(np.abs(share - 1).max()),
            "admittance_gap_max": float(np.abs(1 / share - 1).max()),
            "phase_gap_max_deg": float(np.degrees(np.abs(np.angle(share)).max())),
            **tick_metrics(table),
            **whole_run_metrics(table),
        }

    def judge(self, metrics: Mapping[str, float]) -> tuple[Criterion, ...]:
        """Return the scenario's own criteria on its metrics."""
        gap = HOLD_GAP + self.lateness
        limits = [
            ("impedance_gap_max", gap, "× |Z|"),
            ("admittance_gap_max", gap, "× |Y|"),
            ("fallback_ticks", 0.0, "ticks"),
            ("qp_law_gap_max", 1e-8, "× max |τ|"),
        ]
        return tuple(Criterion(name, metrics[name], limit, unit) for name, limit, unit in limits)

    def panels(self, outcome: Outcome) -> tuple[Panel, ...]:
        """Return Bode plots of impedance and admittance, and the push."""
        table = outcome.table
        f, Z = self.sweep(table)
        fine = np.geomspace(f[0], f[-1], 300)
        model = self.impedance(fine)
        words = "Dots: force over position as the hand felt it. Line: m s² + b s + k at s = jω."
        force = Curve("force of the hand", -column(table, "wrench.fx"))
        place = Curve("position", 1e3 * column(table, "q.x"))
        return (
            Panel("Z", "Impedance", words, bode_figure(f, Z, fine, model, "|Z| [N/m]"), True),
            Panel(
                "Y",
                "Admittance",
                "The same, position over force: Y = 1/Z.",
                bode_figure(f, 1 / Z, fine, 1 / model, "|Y| [m/N]"),
                True,
            ),
            Panel(
                "push",
                "Push of the hand",
                "All frequencies at once.",
                curve_figure(table, "force", "N", [force]),
            ),
            Panel(
                "place",
                "Position",
                "Answer of the interface.",
                curve_figure(table, "position", "mm", [place]),
            ),
        )
