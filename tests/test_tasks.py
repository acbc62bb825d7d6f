"""Each task against its formula, with references that are not zero."""

from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca
import numpy as np
import oracles
import pinocchio as pin
import pytest
from cases import ROBOTS, ROUND_OFF, SPACES, random_rotation, random_rows, states

from qpctrl import InputError, TaskSpace
from qpctrl.objective import Scene, Task
from qpctrl.space import FrameMotion
from qpctrl.spatial import SymbolicPose
from tasks import (
    ForceReference,
    ForceTask,
    MotionReference,
    MotionTask,
    PostureReference,
    PostureTask,
)

DIFFERENCE = 1e-7
"""Central differences with a step of 1e-5 of poses and twists of order 1."""

DT = 1e-3
ARM, SPACE = ROBOTS["arm_7"](), SPACES["arm_7"]
POINT = TaskSpace("tool", ("vx", "vy", "vz"))
FREE = np.zeros((0, 6))


MASS = 3.0
"""Of all that moves [kg]."""


class Bench:
    """A task written out alone: numbers in, objective, memory and signals out."""

    def __init__(self, task: Task, k: int = 0) -> None:
        self.task, n = task, task.space.n if task.space else 0
        space = task.space or SPACE
        q, v = ca.SX.sym("q", 7), ca.SX.sym("v", 7)
        R, p, V = ca.SX.sym("R", 3, 3), ca.SX.sym("p", 3), ca.SX.sym("V", 6)
        A, S, v_c = ca.SX.sym("A", k, n), ca.SX.sym("S", k, k), ca.SX.sym("v_c", k)
        dt, freeze = ca.SX.sym("dt"), ca.SX.sym("freeze")
        u = {key: ca.SX.sym(key, *np.shape(x)) for key, x in task.inputs().items()}
        x = {key: ca.SX.sym(key, *np.shape(x)) for key, x in task.memory().items()}
        motion = FrameMotion(space, SymbolicPose(R, p), V)
        scene = Scene(
            **{"q": q, "v": v, "dt": dt, "freeze": freeze, "motion": motion},
            **{"mass": ca.SX(MASS), "coordinates": lambda q: q, "motions": {space: motion}},
            **{"A": A, "v_c": v_c, "S": S, "Lambda_inv": ca.SX.eye(6)},
        )
        written = task.objective(scene, u, x)
        asked = {key: x for key, x in written.objective._asdict().items() if x is not None}
        outputs = {**asked, **written.memory}
        outputs |= {f"signal.{key}": value for key, value in written.signals.items()}
        self.names = list(outputs)
        arguments = [q, v, R, p, V, A, v_c, S, dt, freeze, *u.values(), *x.values()]
        values = [ca.densify(value) for value in outputs.values()]
        self.function = ca.Function("task", arguments, values)

    def __call__(
        self,
        *,
        X: pin.SE3 | None = None,
        V: np.ndarray | None = None,
        q: np.ndarray | None = None,
        v: np.ndarray | None = None,
        A: np.ndarray = FREE,
        v_c: np.ndarray | None = None,
        S: np.ndarray | None = None,
        freeze: bool = False,
        reference: Any = None,
        memory: Mapping[str, np.ndarray] | None = None,
    ) -> dict[str, np.ndarray]:
        """Return the parts of the objective, the memory after it and the signals, by name."""
        X = pin.SE3.Identity() if X is None else X
        S = np.eye(len(A)) if S is None else S
        u = {**self.task.inputs(), **(reference.arrays if reference else {})}
        x = {**self.task.memory(), **(memory or {})}
        n = self.task.space.n if self.task.space else 0
        state = [np.zeros(size) if s is None else s for s, size in ((q, 7), (v, 7))]
        twist = np.zeros(6) if V is None else V
        found = self.function(
            *state,
            X.rotation,
            X.translation,
            twist,
            A.reshape(len(A), n),
            np.zeros(len(A)) if v_c is None else v_c,
            S,
            DT,
            float(freeze),
            *u.values(),
            *x.values(),
        )
        found = found if isinstance(found, tuple) else (found,)
        return {
            key: np.array(value).squeeze() for key, value in zip(self.names, found, strict=True)
        }


def poses(count: int, seed: int = 0) -> list[tuple[pin.SE3, np.ndarray, MotionReference]]:
    """Return a pose, its twist, and a reference that moves and accelerates elsewhere."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        X = pin.SE3(random_rotation(int(rng.integers(1000))), rng.normal(size=3))
        X_WD = X * pin.exp6(0.5 * rng.normal(size=6))
        reference = MotionReference(
            X_WD=X_WD, V_des=rng.normal(size=6), V_dot_des=rng.normal(size=6)
        )
        found.append((X, rng.normal(size=6), reference))
    return found


# Motion ------------------------------------------------------------------------------------


def test_a_pose_may_be_given_as_an_array_which_is_not_copied() -> None:
    gains = {"K_p": np.full(6, 7.0)}
    for _, _, given in poses(3):
        pose = np.asfortranarray(given.X_WD.homogeneous[:3])
        laid_out = MotionReference(
            X_WD=pose, V_des=given.V_des, V_dot_des=given.V_dot_des, gains=gains
        )
        assert laid_out.arrays["X_WD"] is pose
        assert laid_out.arrays.keys() - given.arrays.keys() == {"K_p"}
        for name, value in given.arrays.items():
            assert np.array_equal(laid_out.arrays[name], value)
        assert laid_out.X_WD.isApprox(given.X_WD, 1e-15)


def test_a_motion_reference_is_at_rest_by_default_for_good() -> None:
    still = MotionReference(X_WD=pin.SE3.Identity())
    assert not np.any([still.V_des, still.V_dot_des])
    with pytest.raises(ValueError, match="read-only"):
        still.V_des[0] = 1.0


def test_feed_forward_is_the_rate_of_the_transported_twist() -> None:
    bench = Bench(MotionTask(space=SPACE, K_p=0, K_i=0, K_d=0))
    for X, V, reference in poses(10):
        expected = oracles.transport_rate(
            X, V, reference.X_WD, reference.V_des, reference.V_dot_des
        )
        found = bench(X=X, V=V, reference=reference)["a_cmd"]
        assert found == pytest.approx(expected, abs=DIFFERENCE)
        without = oracles.transported(X, reference.X_WD, reference.V_dot_des)
        assert np.abs(expected - without).max() > 1e-2  # ad_(Ad V_d) V is no small thing


def test_motion_feedback_is_pid_on_the_error_of_pose_and_transported_twist() -> None:
    K_p, K_i, K_d = np.arange(1.0, 7), np.arange(2.0, 8), np.arange(3.0, 9)
    bench = Bench(MotionTask(space=SPACE, K_p=K_p, K_i=K_i, K_d=K_d, integral_max=9.0))
    for X, V, reference in poses(10):
        before = np.linspace(-1, 1, 6)
        X_e = oracles.pose_error(X, reference.X_WD)
        V_e = oracles.transported(X, reference.X_WD, reference.V_des) - V
        integral = before + DT * X_e
        feed = oracles.transport_rate(X, V, reference.X_WD, reference.V_des, reference.V_dot_des)
        found = bench(X=X, V=V, reference=reference, memory={"integral": before})
        expected = feed + K_p * X_e + K_i * integral + K_d * V_e
        assert found["a_cmd"] == pytest.approx(expected, abs=10 * DIFFERENCE)
        assert found["integral"] == pytest.approx(integral, abs=ROUND_OFF)
        assert found["signal.X_e"] == pytest.approx(X_e, abs=ROUND_OFF)
        assert found["signal.V_e"] == pytest.approx(V_e, abs=ROUND_OFF)


def test_errors_along_the_rows_are_left_to_the_force_task() -> None:
    rng = np.random.default_rng(0)
    K_p, K_d = np.full(6, 100.0), np.full(6, 20.0)
    bench = Bench(MotionTask(space=SPACE, K_p=K_p, K_d=K_d), k=3)
    for X, V, reference in poses(5):
        A = random_rows(rng, 3, 6)
        X_e = oracles.without_components(A, oracles.pose_error(X, reference.X_WD))
        V_e = oracles.transported(X, reference.X_WD, reference.V_des) - V
        V_e = oracles.without_components(A, V_e)
        feed = oracles.transport_rate(X, V, reference.X_WD, reference.V_des, reference.V_dot_des)
        found = bench(X=X, V=V, A=A, reference=reference)
        assert found["a_cmd"] == pytest.approx(feed + K_p * X_e + K_d * V_e, abs=DIFFERENCE)
        assert found["integral"] == pytest.approx(np.clip(DT * X_e, -0.05, 0.05), abs=ROUND_OFF)


def test_a_space_without_rotation_follows_the_point_in_its_own_axes() -> None:
    bench = Bench(MotionTask(space=POINT, K_p=7.0, K_d=3.0))
    for X, V, turning in poses(5):
        still = np.array([1, 1, 1, 0, 0, 0])
        reference = MotionReference(
            X_WD=turning.X_WD, V_des=still * turning.V_des, V_dot_des=still * turning.V_dot_des
        )
        error = X.rotation.T @ (reference.X_WD.translation - X.translation)
        V_e = oracles.transported(X, reference.X_WD, reference.V_des)[:3] - V[:3]
        feed = oracles.transport_rate(X, V, reference.X_WD, reference.V_des, reference.V_dot_des)
        found = bench(X=X, V=V, A=np.zeros((0, 3)), reference=turning)["a_cmd"]
        assert found == pytest.approx(feed[:3] + 7 * error + 3 * V_e, abs=DIFFERENCE)


def test_the_motion_integral_saturates_on_both_sides_and_freezes() -> None:
    bench = Bench(MotionTask(space=SPACE, K_i=2.0, integral_max=0.3))
    reference = MotionReference(X_WD=pin.SE3(np.eye(3), np.array([1.0, -1.0, 0.5])))
    start = {"integral": np.array([0.2999, -0.2999, 0.1, 0, 0, 0])}
    grown = bench(reference=reference, memory=start)["integral"]
    assert grown == pytest.approx([0.3, -0.3, 0.1005, 0, 0, 0], abs=ROUND_OFF)
    frozen = bench(reference=reference, memory=start, freeze=True)["integral"]
    assert np.array_equal(frozen, start["integral"])


# Force -------------------------------------------------------------------------------------

ROWS_A = np.array([[0, 0, 2.0, 0, 0, 0], [0, 0, 0, 1.0, 0, 0], [0, 0, 0, 0, 0.5, 0]])
"""Push along z, moments about x and y, in units of their own."""

PUSHED = np.array([0, 0, 1, 1, 1, 0], dtype=bool)
F_REF = np.array([1.0, -2.0, 10.0, 0.3, -0.2, 0.1])
F_MEAS = np.array([0.7, 0.4, 8.0, 0.1, 0.5, -0.3])
CARRIED = np.where(PUSHED, F_MEAS, 0)
REFERENCE = ForceReference(F_ref=F_REF, F_meas=F_MEAS)
REACHED = {"F_des": F_REF}
"""Memory of a ramp that has ended."""


def test_feed_forward_alone_commands_the_set_point() -> None:
    found = Bench(ForceTask(space=SPACE), k=3)(A=ROWS_A, reference=REFERENCE, memory=REACHED)
    assert found["F_cmd"] == pytest.approx(F_REF, abs=ROUND_OFF)


def test_pi_adds_the_error_along_the_rows_and_its_integral() -> None:
    K_fp, K_fi = np.linspace(0.1, 0.6, 6), np.linspace(5, 10, 6)
    bench = Bench(ForceTask(space=SPACE, K_fp=K_fp, K_fi=K_fi), k=3)
    before = np.linspace(-1, 1, 6)
    found = bench(A=ROWS_A, reference=REFERENCE, memory={**REACHED, "integral": before})
    F_e = np.where(PUSHED, F_REF - F_MEAS, 0)  # outside the rows nothing can be pressed
    integral = before + DT * F_e
    assert found["integral"] == pytest.approx(integral, abs=ROUND_OFF)
    assert found["F_cmd"] == pytest.approx(F_REF + K_fp * F_e + K_fi * integral, abs=ROUND_OFF)


def test_the_third_law_damps_the_velocity_along_the_rows_in_their_own_inertia() -> None:
    rng = np.random.default_rng(2)
    root, V = rng.normal(size=(3, 3)), rng.normal(size=6)
    S = root @ root.T + np.eye(3)
    bench = Bench(ForceTask(space=SPACE, damping=12.0), k=3)
    v_c = np.array([0.3, -0.2, 0.5])
    found = bench(V=V, A=ROWS_A, v_c=v_c, S=S, reference=REFERENCE, memory=REACHED)
    brake = 12.0 * ROWS_A.T @ np.linalg.inv(S) @ (ROWS_A @ V - v_c)
    assert found["F_cmd"] == pytest.approx(F_REF - brake, abs=1e-9)
    assert F_REF[~PUSHED] == pytest.approx(found["F_cmd"][~PUSHED])  # free directions glide


def test_a_damped_force_takes_power_out() -> None:
    bench = Bench(ForceTask(space=SPACE, damping=5.0), k=3)
    V = np.array([0.3, 0.2, 0.1, -0.4, 0.5, 0.6])
    found = bench(V=V, A=ROWS_A)["F_cmd"]
    assert found @ V < 0


def test_the_set_point_runs_down_a_ramp_and_stops_at_the_reference() -> None:
    ramp = np.array([100.0, 100, 1000, 50, 50, 50])
    bench = Bench(ForceTask(space=SPACE, ramp=ramp), k=3)
    after = bench(A=ROWS_A, reference=REFERENCE)["F_des"]
    assert after == pytest.approx(np.sign(F_REF) * np.minimum(DT * ramp, np.abs(F_REF)))
    near = {"F_des": F_REF + np.array([0.01, -0.01, 0.5, 0, 0, 0])}
    assert bench(A=ROWS_A, reference=REFERENCE, memory=near)["F_des"] == pytest.approx(F_REF)


def test_what_the_rows_do_not_carry_is_filtered_and_fed_forward() -> None:
    cutoff = 20.0
    bench = Bench(ForceTask(space=SPACE, cutoff=cutoff), k=3)
    outside, F_ext = F_MEAS - CARRIED, np.zeros(6)
    for ticks in range(1, 60):
        found = bench(A=ROWS_A, reference=REFERENCE, memory={**REACHED, "F_ext": F_ext})
        F_ext = found["F_ext"]
        settled = 1 - np.exp(-2 * np.pi * cutoff * DT * ticks)
        assert F_ext == pytest.approx(settled * outside, abs=ROUND_OFF)
    assert not F_ext[PUSHED].any()


def test_a_cutoff_of_zero_ignores_the_wrench_outside_the_rows() -> None:
    found = Bench(ForceTask(space=SPACE, cutoff=0.0), k=3)(A=ROWS_A, reference=REFERENCE)
    assert not found["F_ext"].any()


def test_rows_that_are_mixed_carry_the_same_wrench() -> None:
    rng = np.random.default_rng(1)
    bench = Bench(ForceTask(space=SPACE, K_fp=0.3, K_fi=4.0), k=3)
    T = rng.normal(size=(3, 3)) + 2 * np.eye(3)
    one, other = (bench(A=A, reference=REFERENCE, memory=REACHED) for A in (ROWS_A, T @ ROWS_A))
    assert one["F_cmd"] == pytest.approx(other["F_cmd"], abs=ROUND_OFF)
    assert one["F_ext"] == pytest.approx(other["F_ext"], abs=ROUND_OFF)


def test_the_force_integral_saturates_on_both_sides_and_freezes() -> None:
    bench = Bench(ForceTask(space=SPACE, K_fi=1.0, integral_max=0.5), k=3)
    before = {**REACHED, "integral": np.array([0, 0, 0.4999, 0, -0.4999, 0])}
    grown = bench(A=ROWS_A, reference=REFERENCE, memory=before)["integral"]
    assert grown[2] == pytest.approx(0.5)
    assert grown[4] == pytest.approx(-0.5)
    frozen = bench(A=ROWS_A, reference=REFERENCE, memory=before, freeze=True)["integral"]
    assert np.array_equal(frozen, before["integral"])


def test_without_rows_everything_measured_is_outside_them() -> None:
    found = Bench(ForceTask(space=SPACE, K_fp=0.5, damping=9.0))(
        V=np.ones(6), reference=REFERENCE, memory=REACHED
    )
    follow = 1 - np.exp(-2 * np.pi * 50.0 * DT)
    assert found["F_ext"] == pytest.approx(follow * F_MEAS, abs=ROUND_OFF)
    assert found["F_cmd"] == pytest.approx(F_REF, abs=ROUND_OFF)  # no error without rows


def test_gains_that_come_with_the_reference_act_from_that_tick_on() -> None:
    bench = Bench(ForceTask(space=SPACE), k=3)
    reference = ForceReference(F_ref=F_REF, F_meas=F_MEAS, gains={"K_fp": np.full(6, 0.25)})
    found = bench(A=ROWS_A, reference=reference, memory=REACHED)["F_cmd"]
    assert found == pytest.approx(F_REF + 0.25 * np.where(PUSHED, F_REF - F_MEAS, 0), abs=ROUND_OFF)


def test_gains_of_a_motion_come_with_its_reference_too() -> None:
    X, V, _ = poses(1)[0]
    bench, held = Bench(MotionTask(space=SPACE, K_d=0.0)), X * pin.exp6(np.linspace(-0.4, 0.5, 6))
    found = [
        bench(X=X, V=V, reference=MotionReference(X_WD=held, gains={"K_p": np.full(6, gain)}))
        for gain in (0.0, 7.0)
    ]
    pulled = found[1]["a_cmd"] - found[0]["a_cmd"]
    assert pulled == pytest.approx(7.0 * oracles.pose_error(X, held), abs=1e-9)


# Posture -----------------------------------------------------------------------------------


def test_posture_is_pd_towards_its_configuration() -> None:
    q, v, rng = next(states(ARM, SPACE, 1))
    K_p, K_d, q_ref = np.arange(1.0, 8), np.arange(2.0, 9), rng.normal(size=7)
    bench = Bench(PostureTask(q_ref=np.zeros(7), K_p=K_p, K_d=K_d))
    found = bench(q=q, v=v, reference=PostureReference(q_ref=q_ref))["a_post"]
    assert found == pytest.approx(K_p * (q_ref - q) - K_d * v, abs=ROUND_OFF)


# Refusals ----------------------------------------------------------------------------------

GAINS: list[tuple[Callable[..., Task], str]] = [
    *(
        (lambda **kw: MotionTask(space=SPACE, **kw), g)
        for g in ("K_p", "K_i", "K_d", "integral_max")
    ),
    *(
        (lambda **kw: ForceTask(space=SPACE, **kw), g)
        for g in ("K_fp", "K_fi", "integral_max", "ramp")
    ),
    *((lambda **kw: PostureTask(q_ref=np.zeros(6), **kw), g) for g in ("K_p", "K_d")),
]


@pytest.mark.parametrize("bad", [-1.0, np.nan, np.inf, np.ones(5), np.array([1, 1, 1, 1, 1, -0.1])])
@pytest.mark.parametrize(("make", "gain"), GAINS)
def test_gains_that_cannot_be_are_refused_by_name(
    make: Callable[..., Task], gain: str, bad: Any
) -> None:
    with pytest.raises(InputError, match=rf"{gain}: got .*need"):
        make(**{gain: bad})


@pytest.mark.parametrize("gain", ["damping", "cutoff"])
@pytest.mark.parametrize("bad", [-1.0, np.nan, np.ones(6)])
def test_scalar_gains_of_the_force_task_are_refused_by_name(gain: str, bad: Any) -> None:
    with pytest.raises(InputError, match=rf"force\.{gain}: got .*need"):
        ForceTask(space=SPACE, **{gain: bad})


def test_a_configuration_that_is_not_finite_is_refused() -> None:
    with pytest.raises(InputError, match=r"posture\.q_ref: got .*finite"):
        PostureTask(q_ref=np.array([0.0, np.nan]))


def test_tasks_keep_their_own_copy_of_a_gain() -> None:
    K_p = np.full(6, 2.0)
    task = MotionTask(space=SPACE, K_p=K_p)
    K_p[:] = -1
    assert np.array_equal(task.inputs()["K_p"], np.full(6, 2.0))
