"""Centre of mass, momentum and posture of a humanoid on both feet, measured on its plant."""

import functools
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import oracles_whole_body as whole
import pinocchio as pin
import pytest
from cases_whole_body import ANGULAR, Body, bodies, body, unlimited

from qpctrl import CentroidalSpace, Controller, InputError, Measurement, Mode, Status, Weighted
from tasks import (
    CentreOfMassReference,
    CentreOfMassTask,
    ForceTask,
    MomentumReference,
    MomentumTask,
    MotionTask,
    PostureReference,
    PostureTask,
)

DT = 1e-3
STEP = 1e-5
"""s, of a central difference."""

DIFFERENCE = 1e-5
"""N, Nm: a central difference of momenta of up to 20 that change within 0.1 s."""

UNMOVED = 1e-12
"""Relative: one sum in the same order."""

C_E = np.array([0.010, 0.020, -0.010])  # m
C_DOT = np.array([0.10, 0.0, -0.05])  # m/s
C_DDOT = np.array([0.5, -0.4, 0.3])  # m/s²
H = np.array([1.0, -1.0, 0.5])  # kg m²/s
H_DOT = np.array([3.0, 2.0, 1.0])  # Nm


def feet() -> Body:
    """Return the humanoid with nothing but its feet held."""
    return Body("humanoid", (), bodies()["humanoid"].grips[:2])


def standing(strong: float, weak: float, *tasks: Any, **posture: Any) -> Controller:
    """Return a controller of these tasks, and of posture and forces of another weight."""
    of = feet()
    forces = (ForceTask(space=grip.space, name=f"force {grip.name}") for grip in of.grips)
    lean = PostureTask(q_ref=of.robot.home, **posture)
    mode = Mode(
        name="stand",
        tasks=(
            *(Weighted(t, strong) for t in tasks),
            *(Weighted(t, weak) for t in (lean, *forces)),
        ),
        constraints=of.constraints(),
        metric="home",
    )
    return Controller(unlimited(of.robot), [mode])


@functools.cache
def state() -> tuple[np.ndarray, np.ndarray]:
    """Return a configuration off home and a velocity that keeps the feet where they are."""
    of, rng = feet(), np.random.default_rng(1)
    q = of.robot.integrate(of.robot.home, rng.uniform(-0.1, 0.1, of.robot.nv))
    v = 0.3 * rng.normal(size=of.robot.nv)
    return q, whole.along_free_directions(
        v, [whole.contact_of(of.robot.model, q, v, grip.held) for grip in of.grips]
    )


class Done(NamedTuple):
    """One tick, and what it does to the plant."""

    tau: np.ndarray
    a: np.ndarray
    h: np.ndarray
    """Momentum (6) before it [kg m/s, kg m²/s]."""
    h_dot: np.ndarray
    """Its rate (6) [N, Nm], by differences along the motion of the plant."""
    signals: dict[str, np.ndarray]


def step(controller: Controller, references: dict[str, Any]) -> Done:
    """Run one tick at `state`, and the plant with its torque and wrenches for an instant."""
    of, (q, v) = feet(), state()
    model, data = of.robot.model, of.robot.model.createData()
    memory = controller.start("stand", q)
    command, report, _ = controller.step("stand", Measurement(0.0, q, v), references, memory)
    assert (report.status, report.limited) == (Status.OK, False)
    contacts = [whole.contact_of(model, q, v, grip.held) for grip in of.grips]
    pushes = [(c, said.wrench) for c, said in zip(contacts, report.contacts, strict=True)]
    a = whole.accelerations(model, q, v, of.robot.B @ command.tau, pushes)
    ahead, behind = (
        pin.computeCentroidalMomentum(model, data, *whole.moved(model, q, v, a, t)).vector.copy()
        for t in (STEP, -STEP)
    )
    h = pin.computeCentroidalMomentum(model, data, q, v).vector.copy()
    tick, signals, at = controller.engines["stand"].tick, {}, 0
    for name, size in tick.signals.items():
        signals[name], at = report.signals[at : at + size].copy(), at + size
    return Done(command.tau, a, h, (ahead - behind) / (2 * STEP), signals)


def centre() -> np.ndarray:
    """Return the centre of mass at `state` [m]."""
    model = feet().robot.model
    return pin.centerOfMass(model, model.createData(), state()[0]).copy()


def wanted() -> dict[str, Any]:
    """Return references of both tasks, none of them where the robot is."""
    com = CentreOfMassReference(c_des=centre() + C_E, c_dot_des=C_DOT, c_ddot_des=C_DDOT)
    return {"centre of mass": com, "momentum": MomentumReference(h_des=H, h_dot_des=H_DOT)}


def test_the_plants_momentum_changes_as_commanded_when_its_weight_rules() -> None:
    """What other tasks take from it falls with the ratio of the weights, to nothing."""
    K_p, K_d, K = np.array([90.0, 100, 110]), np.array([18.0, 20, 22]), np.array([8.0, 10, 12])
    tasks = CentreOfMassTask(K_p=K_p, K_d=K_d), MomentumTask(K=K)
    m = pin.computeTotalMass(feet().robot.model)
    off = []
    for strong, weak in ((1e2, 1e-3), (1e3, 1e-4), (1e5, 1e-6)):
        done = step(standing(strong, weak, *tasks), wanted())
        c_ddot = C_DDOT + K_p * C_E + K_d * (C_DOT - done.h[:3] / m)
        command = np.r_[m * c_ddot, H_DOT + K * (H - done.h[3:])]
        assert np.abs(command).max() > 100  # N
        assert np.abs(command[3:]).max() > 15  # Nm
        off.append(np.abs(done.h_dot - command).max())
    assert off[0] > 0.01
    assert off[1] == pytest.approx(off[0] / 100, rel=0.05)
    assert off[2] <= DIFFERENCE + 1e-6 * off[0]


def test_the_centre_of_mass_accelerates_by_second_differences_of_its_place() -> None:
    """The linear momentum is that of the centre of mass, whose place is looked at here."""
    done = step(standing(1e5, 1e-6, CentreOfMassTask(), MomentumTask()), wanted())
    model, (q, v), t = feet().robot.model, state(), 1e-3
    data = model.createData()
    ahead, behind = (
        pin.centerOfMass(model, data, whole.moved(model, q, v, done.a, side * t)[0]).copy()
        for side in (1, -1)
    )
    measured = (ahead - 2 * centre() + behind) / t**2
    m = pin.computeTotalMass(model)
    command = C_DDOT + 100 * C_E + 20 * (C_DOT - done.h[:3] / m)
    assert measured == pytest.approx(command, abs=2e-4)  # m/s²; a t² of the fourth derivative
    assert np.abs(command).max() > 1
    assert done.signals["centre of mass.c"] == pytest.approx(centre(), abs=1e-12)
    assert done.signals["centre of mass.c_e"] == pytest.approx(C_E, abs=1e-12)
    assert done.signals["momentum.h"] == pytest.approx(done.h[3:], abs=1e-10)


def test_axes_that_the_task_lacks_are_left_to_others() -> None:
    level = CentreOfMassTask(space=CentroidalSpace(axes=("vx", "vy")))
    controller = standing(1e5, 1e-6, level)
    references = wanted()
    references.pop("momentum")
    done = step(controller, references)
    m = pin.computeTotalMass(feet().robot.model)
    command = m * (C_DDOT + 100 * C_E + 20 * (C_DOT - done.h[:3] / m))
    assert done.h_dot[:2] == pytest.approx(command[:2], abs=1e-3)
    assert abs(done.h_dot[2] - command[2]) > 10  # N
    other = {
        "centre of mass": CentreOfMassReference(
            c_des=centre() + C_E + [0, 0, 5.0], c_dot_des=C_DOT, c_ddot_des=C_DDOT
        )
    }
    assert np.array_equal(step(controller, other).tau, done.tau)


def test_without_a_reference_angular_momentum_decays() -> None:
    task = MomentumTask(K=np.array([5.0, 10.0, 20.0]))
    done = step(standing(1e5, 1e-6, task), {})
    assert np.abs(done.h[3:]).min() > 0.1
    assert done.h_dot[3:] == pytest.approx(-task.K * done.h[3:], abs=1e-4)


def test_a_posture_weighs_the_joints_as_they_are_at_home_and_the_base_with_nothing() -> None:
    robot = feet().robot
    model = standing(1.0, 1.0, MomentumTask()).engines["stand"].tick.model
    M_N = np.array(ca.DM(model.M_N))
    assert not M_N[:6].any()
    assert not M_N[:, :6].any()
    M = whole.mass_matrix(robot.model, robot.home)
    assert M_N[6:, 6:] == pytest.approx(M[6:, 6:], abs=1e-12)
    assert np.diag(M_N)[6:].min() > 1e-3


def test_a_posture_has_no_say_in_what_floats() -> None:
    of, quiet = feet(), {}
    robot = of.robot
    base = np.zeros(robot.nq)
    base[:7] = 1.0
    gains = [(20.0, 9.0), (20.0 + 500 * base, 9.0 + 300 * base)]
    for K_p, K_d in gains:
        controller = standing(1.0, 1.0, MomentumTask(), K_p=K_p, K_d=K_d)
        for far in (0.0, 3.0):
            turned = pin.SE3(pin.exp3(np.array([0.3, 0.2, far])), np.array([far, -far, 1.0]))
            q_ref = robot.home.copy()
            q_ref[:7] = pin.SE3ToXYZQUAT(turned)
            quiet[(K_d is gains[1][1], far)] = step(
                controller, {"posture": PostureReference(q_ref=q_ref)}
            ).tau
        bent = robot.home + 0.3 * (np.arange(robot.nq) == robot.nq - 1)
        moved = step(controller, {"posture": PostureReference(q_ref=bent)}).tau
        assert np.abs(moved - quiet[(K_d is gains[1][1], 0.0)]).max() > 0.01  # Nm
    one, *others = quiet.values()
    assert len(others) == 3
    for other in others:
        assert other == pytest.approx(one, rel=UNMOVED)


BAD = {
    "an angular axis": (
        lambda: CentreOfMassTask(space=CentroidalSpace(axes=("vx", "wz"))),
        r"centre of mass: got axes \('vx', 'wz'\), need some of \('vx', 'vy', 'vz'\)",
    ),
    "no axis": (lambda: CentroidalSpace(axes=()), r"axes: got \(\), need one or more"),
    "an unknown axis": (lambda: CentroidalSpace(axes=("hx",)), "unknown axis 'hx'"),
    "a negative gain": (lambda: CentreOfMassTask(K_d=-1.0), r"centre of mass\.K_d: got .*-1"),
    "gains of all axes": (
        lambda: CentreOfMassTask(space=CentroidalSpace(axes=("vx",)), K_p=np.ones(3)),
        r"centre of mass\.K_p: got shape \(3,\), need \(1,\)",
    ),
    "a gain that is none": (
        lambda: MomentumTask(K=np.array([1.0, np.nan, 1.0])),
        r"momentum\.K: got .*nan.*, need finite",
    ),
    "a pose of the centre of mass": (
        lambda: standing(1.0, 1.0, MotionTask(space=CentroidalSpace(axes=ANGULAR))),
        "for the centre of mass use CentreOfMassTask",
    ),
    "a posture as long as v": (
        lambda: standing(1.0, 1.0, PostureTask(q_ref=np.zeros(35), name="lean")),
        r"lean\.q_ref: got 35 values, need 36, the size of q",
    ),
}


@pytest.mark.parametrize("what", BAD)
def test_what_cannot_be_meant_is_refused_in_words(what: str) -> None:
    make, said = BAD[what]
    with pytest.raises(InputError, match=said):
        make()


def test_references_that_do_not_fit_are_refused_and_none_is_not_enough() -> None:
    controller = standing(1.0, 1.0, CentreOfMassTask())
    q, v = state()
    memory, now = controller.start("stand", q), Measurement(0.0, q, v)
    with pytest.raises(InputError, match="without a reference for task 'centre of mass'"):
        controller.step("stand", now, {}, memory)
    flat = {"centre of mass": CentreOfMassReference(c_des=np.zeros(2))}
    with pytest.raises(InputError, match=r"centre of mass\.c_des: got shape \(2,\), need \(3,\)"):
        controller.step("stand", now, flat, memory)


def test_the_masses_are_those_of_the_model() -> None:
    assert pin.computeTotalMass(body("humanoid").model) == pytest.approx(61.6, abs=1e-3)
