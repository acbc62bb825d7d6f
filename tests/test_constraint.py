"""Pfaffian rows: exact Ȧ V, refusals, dependent rows, selections."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import oracles
import pinocchio as pin
import pytest
from cases import ROBOTS, ROUND_OFF, SPACES, Given, board, given_mode, states, tick

from qpctrl import Controller, FaceOnPlane, InputError, Mode, Pfaffian, Status, TaskSpace
from qpctrl.constraint import Constraint, PfaffianRows, Selection, row_function
from qpctrl.constraint.pfaffian import differentiate
from qpctrl.space import FrameMotion
from qpctrl.spatial import SymbolicPose

STEP = 1e-5
"""Step of the central differences."""

DIFFERENCE = 1e-8
"""Central differences with a step of 1e-5 on rows whose third derivatives are below 100."""

ARM, SPACE = ROBOTS["arm_7"](), SPACES["arm_7"]


def evaluate(constraint: Constraint, X_WF: pin.SE3, V: np.ndarray) -> list[np.ndarray]:
    """Return A, Ȧ V and v̇_c at the constraint's own inputs."""
    inputs = constraint.inputs().values()
    rows = row_function(constraint)(X_WF.rotation, X_WF.translation, V, *inputs)
    return [np.array(part) for part in rows]


def tool_motions(count: int) -> Iterator[tuple[pin.SE3, np.ndarray]]:
    """Yield poses and body twists of the arm's tool."""
    for q, v, _ in states(ARM, SPACE, count):
        terms = oracles.body_terms(ARM.model, q, v, "tool", SPACE.index)
        yield terms.X_WF, terms.V


@dataclass(frozen=True, kw_only=True, eq=False)
class OnSphere:
    """A constraint written by a user: the tool stays at its distance from a point."""

    center: np.ndarray
    space: TaskSpace = SPACE
    name: str = "sphere"
    row_names: tuple[str, ...] = ("radius",)
    unilateral: tuple[bool, ...] = (False,)

    def inputs(self) -> dict[str, np.ndarray]:
        """Return nothing: the centre does not move."""
        return {}

    def rows(self, motion: FrameMotion, u: Mapping[str, ca.SX]) -> PfaffianRows:
        """Return the direction away from the centre, in the tool frame."""

        def A(X: SymbolicPose) -> ca.SX:
            return ca.horzcat((X.p - ca.SX(self.center)).T @ X.R, ca.SX.zeros(1, 3))

        return differentiate(A, motion)

    def at(self, X: pin.SE3) -> np.ndarray:
        """Return A (6) numerically."""
        return np.r_[X.rotation.T @ (X.translation - self.center), np.zeros(3)]


def test_face_on_plane_has_the_rows_of_the_plane_in_the_tool_frame() -> None:
    plane = board(SPACE)
    for X_WF, V in tool_motions(5):
        A, _, _, v_c_dot = evaluate(plane, X_WF, V)
        assert np.allclose(A, oracles.face_rows(plane.R_WE, X_WF), atol=ROUND_OFF)
        assert not v_c_dot.any()


def test_the_rows_of_the_plane_change_as_finite_differences_say() -> None:
    plane, largest = board(SPACE), 0.0
    for X_WF, V in tool_motions(5):
        A_dot_V = evaluate(plane, X_WF, V)[1].ravel()
        ahead, behind = (
            oracles.face_rows(plane.R_WE, X_WF * pin.exp6(s * V)) for s in (STEP, -STEP)
        )
        expected = (ahead - behind) / (2 * STEP) @ V
        assert A_dot_V == pytest.approx(expected, abs=DIFFERENCE)
        largest = max(largest, np.abs(expected).max())
    assert largest > 0.1  # the rows do turn


def test_rows_that_depend_on_the_position_are_differentiated_too() -> None:
    sphere = OnSphere(center=np.array([0.4, -0.3, 0.2]))
    for X_WF, V in tool_motions(3):
        A, A_dot_V, *_ = evaluate(sphere, X_WF, V)
        assert A.ravel() == pytest.approx(sphere.at(X_WF), abs=ROUND_OFF)
        ahead, behind = (sphere.at(X_WF * pin.exp6(s * V)) for s in (STEP, -STEP))
        expected = (ahead - behind) / (2 * STEP) @ V
        assert A_dot_V.ravel() == pytest.approx([expected], abs=DIFFERENCE)


def test_a_tool_on_the_plane_stays_on_it_when_the_rows_hold() -> None:
    plane = board(SPACE)
    X_WF, twist = next(tool_motions(1))
    V = oracles.without_components(evaluate(plane, X_WF, twist)[0], twist)
    into_the_plane = plane.R_WE[:, 2] @ X_WF.rotation @ V[:3]
    turning = plane.R_WE.T @ X_WF.rotation @ V[3:]
    assert into_the_plane == pytest.approx(0, abs=ROUND_OFF)
    assert turning[:2] == pytest.approx([0, 0], abs=ROUND_OFF)
    assert abs(turning[2]) > 1e-2  # turning about the normal stays free


@pytest.mark.parametrize("shape", [(1, 5), (3, 7), (7, 6), (0, 6), (6,)])
def test_rows_of_another_width_are_refused_with_the_width_that_is_needed(shape: Any) -> None:
    with pytest.raises(InputError, match=r"need k×6 for the axes vx vy vz wx wy wz"):
        Pfaffian(space=SPACE, A=np.ones(shape))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_rows_that_are_not_finite_are_refused(bad: float) -> None:
    with pytest.raises(InputError, match="not finite"):
        Pfaffian(space=SPACE, A=np.array([[bad, 0, 0, 0, 0, 1.0]]))


def test_a_plane_needs_all_axes_and_a_rotation() -> None:
    with pytest.raises(InputError, match=r"face on plane needs the axes vx vy vz wx wy wz"):
        FaceOnPlane(space=TaskSpace("tool", ("vx", "vy")), R_WE=np.eye(3))
    with pytest.raises(InputError, match="need a rotation matrix"):
        FaceOnPlane(space=SPACE, R_WE=np.diag([1.0, 1.0, 2.0]))


def test_a_reflection_is_not_a_rotation() -> None:
    with pytest.raises(InputError, match="need a rotation matrix"):
        FaceOnPlane(space=SPACE, R_WE=np.diag([1.0, 1.0, -1.0]))


def test_only_the_push_of_a_plane_is_one_sided() -> None:
    plane = board(SPACE)
    assert dict(zip(plane.row_names, plane.unilateral, strict=True)) == {
        "vz": True,
        "wx": False,
        "wy": False,
    }


def test_a_selection_keeps_rows_names_and_sides() -> None:
    plane = board(SPACE)
    some = Selection(whole=plane, keep=(2, 0))
    motion = next(tool_motions(1))
    whole, kept = (evaluate(constraint, *motion) for constraint in (plane, some))
    for all_rows, some_rows in zip(whole, kept, strict=True):
        assert np.array_equal(all_rows[[2, 0]], some_rows)
    assert some.row_names == ("wy", "vz")
    assert some.unilateral == (False, True)
    assert some.name == plane.name
    assert some.space == plane.space


def with_rows(*constraints: Constraint) -> Mode:
    """Return the mode of given commands, with these constraints."""
    mode = given_mode(ARM, SPACE, 0)
    return Mode(name="contact", tasks=mode.tasks, constraints=constraints)


TWICE = np.array([[0, 0, 1.0, 0, 0, 0], [0, 1, 0, 1, 0, 0], [0, 2, 3, 2, 0, 0]])
"""The third row is three times the first and twice the second."""


def test_dependent_rows_are_refused_by_name() -> None:
    with pytest.raises(InputError, match=r"constraint row twice\.row2 depends.*'drop'"):
        Controller(ARM, [with_rows(Pfaffian(space=SPACE, A=TWICE, name="twice"))])


def test_a_row_that_another_constraint_has_already_is_refused_by_name() -> None:
    push = Pfaffian(space=SPACE, A=TWICE[:1], name="push")
    again = Pfaffian(space=SPACE, A=-2 * TWICE[:1], name="again")
    with pytest.raises(InputError, match=r"constraint row again\.row0 depends"):
        Controller(ARM, [with_rows(push, again)])


def test_dropping_dependent_rows_leaves_the_torque_of_the_rows_that_remain() -> None:
    twice = Pfaffian(space=SPACE, A=TWICE, name="twice")
    dropped = Controller(ARM, [with_rows(twice)], dependent_rows="drop")
    clean = Controller(ARM, [with_rows(Pfaffian(space=SPACE, A=TWICE[:2], name="twice"))])
    for q, v, rng in states(ARM, SPACE, 5):
        wanted = {
            "motion": Given(a_cmd=rng.normal(size=6)),
            "force": Given(F_cmd=10 * rng.normal(size=6)),
        }
        tau = [tick(c, q, v, wanted)[0].tau for c in (dropped, clean)]
        assert np.array_equal(*tau)
    assert dropped.engines["contact"].tick.rows.equality[:3] == ("twice.row0", "twice.row1")


def test_rows_that_become_dependent_on_the_way_are_named_and_not_used() -> None:
    free = np.vstack([TWICE[:2], [0, 0, 0, 0, 1.0, 0]])
    controller = Controller(ARM, [with_rows(Pfaffian(space=SPACE, A=free, name="rows"))])
    q, v, _ = next(states(ARM, SPACE, 1))
    command, report, _ = tick(controller, q, v, {"rows": Given(A=TWICE)})
    assert report.status is Status.DEPENDENT_ROWS
    assert report.dependent_rows == ("rows.row2",)
    assert "rows.row2" in report.explain()
    assert command.fallback
    assert np.isfinite(command.tau).all()


def test_rows_of_one_space_stack_in_the_order_of_the_constraints() -> None:
    first = Pfaffian(space=SPACE, A=TWICE[:1], name="first")
    second = Pfaffian(space=SPACE, A=TWICE[1:2], name="second")
    controller = Controller(ARM, [with_rows(first, second)])
    q, v, _ = next(states(ARM, SPACE, 1))
    tick(controller, q, v, {})
    assert np.array_equal(controller.engines["contact"].terms["A0"], TWICE[:2])
