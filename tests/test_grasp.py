"""Two arms that squeeze a box: what the box feels, by Newton's law of the box alone."""

from typing import Any, NamedTuple

import numpy as np
import oracles_whole_body as whole
import pinocchio as pin
import pytest
from cases import Given
from cases_whole_body import bodies, body, commands, unlimited

from qpctrl import Controller, InputError, Measurement, Memory, Mode, Status, TaskSpace, Weighted
from qpctrl.contact import ContactPhase, FrictionCone, MaxForce, WrenchLimit
from tasks import GraspForceReference, GraspForceTask, MotionReference, MotionTask, PostureTask

DT = 1e-3
EXACT = 1e-8
"""N, Nm, of up to 60 N: a KKT residual of 1e-9 at most."""

LEFT, RIGHT = (grip.space for grip in bodies()["grasp"].grips)
BOX = TaskSpace("box")


def holding(limits: tuple[WrenchLimit, ...] = (), **gains: Any) -> Controller:
    """Return a controller that moves the box and squeezes it."""
    robot = unlimited(body("two_arms"))
    gains = {"ramp": 1e9, **gains}
    mode = Mode(
        name="hold",
        tasks=(
            Weighted(MotionTask(space=BOX, name="box")),
            Weighted(GraspForceTask(contacts=(LEFT, RIGHT), **gains), 10.0),
            Weighted(PostureTask(q_ref=robot.home)),
        ),
        constraints=bodies()["grasp"].constraints(),
        contact_limits=limits,
        metric="home",
    )
    return Controller(robot, [mode])


class Felt(NamedTuple):
    """What the box feels at one tick, in its axes."""

    left: np.ndarray
    """Wrench of the left hand about its contact (6) [N, Nm]."""
    right: np.ndarray
    e: np.ndarray
    """Direction from the left to the right hand (3)."""
    needed: np.ndarray
    """Force (3) [N] that its acceleration needs: m (a − g)."""
    turning: np.ndarray
    """Moment (3) [Nm] about its centre that its turning needs: I ω̇ + ω × I ω."""
    moment: np.ndarray
    """Moment (3) [Nm] of both hands about its centre."""

    @property
    def internal(self) -> np.ndarray:
        """(F₁ − F₂) / 2."""
        return (self.left - self.right) / 2


def felt(controller: Controller, q: np.ndarray, v: np.ndarray, report: Any) -> Felt:
    """Return what the box feels, from wrenches in the report and accelerations of the tick."""
    robot = controller.robot
    model, data = robot.model, robot.model.createData()
    a = controller.engines["hold"].parts.point[0][: robot.nv]
    pin.forwardKinematics(model, data, q, v, a)
    pin.updateFramePlacements(model, data)
    joint, frame = model.getJointId("box"), robot.frame_id("box")
    X_WO, inertia = data.oMi[joint], model.inertias[joint]
    V, A = data.v[joint], data.a[joint]
    gravity = X_WO.rotation.T @ model.gravity.linear
    classical = A.linear + np.cross(V.angular, V.linear)
    spin = inertia.inertia @ V.angular
    hands = [X_WO.actInv(data.oMf[robot.frame_id(f"{s}_pad")]) for s in ("left", "right")]
    assert X_WO.isApprox(data.oMf[frame])
    assert np.abs(inertia.lever).max() < 1e-12
    about_box = [X.act(pin.Force(c.wrench)) for X, c in zip(hands, report.contacts, strict=True)]
    left, right = (
        np.kron(np.eye(2), X.rotation) @ contact.wrench
        for X, contact in zip(hands, report.contacts, strict=True)
    )
    way = hands[1].translation - hands[0].translation
    return Felt(
        left,
        right,
        way / np.linalg.norm(way),
        inertia.mass * (classical - gravity),
        inertia.inertia @ A.angular + np.cross(V.angular, spin),
        (about_box[0] + about_box[1]).angular,
    )


def squeeze(f_ref: float, f_meas: float = 0.0) -> dict[str, Any]:
    """Return references that also move the box."""
    robot = body("two_arms")
    X_WD = robot.pose(robot.home, "box") * pin.exp6(np.array([0.01, 0.0, 0.02, 0.05, 0.02, 0.0]))
    return {
        "box": MotionReference(X_WD=X_WD, V_des=np.array([0.1, 0, 0.2, 0.1, 0, 0.3])),
        "grasp": GraspForceReference(f_ref=f_ref, f_meas=f_meas),
    }


@pytest.mark.parametrize("f_ref", [40.0, 15.0, -25.0])
def test_the_box_is_squeezed_as_commanded_and_carried_by_the_rest(f_ref: float) -> None:
    controller, of, rng = holding(), bodies()["grasp"], np.random.default_rng(2)
    for _ in range(5):
        q, v = of.state(rng)
        memory = controller.start("hold", q)
        _, report, _ = controller.step("hold", Measurement(0.0, q, v), squeeze(f_ref), memory)
        assert (report.status, report.limited) == (Status.OK, False)
        box = felt(controller, q, v, report)
        assert box.internal[:3] == pytest.approx(f_ref * box.e, abs=EXACT)
        assert box.internal[3:] == pytest.approx(np.zeros(3), abs=EXACT)
        assert (box.left + box.right)[:3] == pytest.approx(box.needed, abs=EXACT)
        assert box.moment == pytest.approx(box.turning, abs=EXACT)
        assert np.abs(box.needed).max() > 10
        assert np.abs(box.turning).max() > 0.01


def test_both_hands_press_into_a_box_at_rest_and_no_velocity_is_left_between_them() -> None:
    controller, robot = holding(), body("two_arms")
    memory, v = controller.start("hold", robot.home), np.zeros(robot.nv)
    still = {**squeeze(40.0), "box": MotionReference(X_WD=robot.pose(robot.home, "box"))}
    _, report, _ = controller.step("hold", Measurement(0.0, robot.home, v), still, memory)
    for contact in report.contacts:
        assert contact.wrench[2] == pytest.approx(40.0, abs=EXACT)  # z of a pad is into the box
    up = [
        (robot.pose(robot.home, f"{side}_pad").rotation @ contact.wrench[:3])[2]
        for side, contact in zip(("left", "right"), report.contacts, strict=True)
    ]
    assert up == pytest.approx([9.81, 9.81], abs=EXACT)  # half of 2 kg each
    a = controller.engines["hold"].parts.point[0][: robot.nv]
    assert np.abs(a).max() <= EXACT


def run(controller: Controller, ticks: list[tuple[dict[str, Any], ContactPhase]]) -> list[float]:
    """Return the force along the line between the hands at each tick [N]."""
    robot = controller.robot
    memory: Memory = controller.start("hold", robot.home)
    found, v = [], np.zeros(robot.nv)
    for i, (references, phase) in enumerate(ticks):
        now = Measurement(i * DT, robot.home, v, phase)
        _, report, memory = controller.step("hold", now, references, memory)
        box = felt(controller, robot.home, v, report)
        found.append(float(box.internal[:3] @ box.e))
    return found


def test_set_point_and_integral_follow_their_law_and_stay_within_bounds() -> None:
    K_fp, K_fi, most, ramp = 0.4, 30.0, 0.05, 500.0
    controller = holding(K_fp=K_fp, K_fi=K_fi, integral_max=most, ramp=ramp)
    rng, ticks, expected = np.random.default_rng(0), [], []
    f_des = integral = 0.0
    freeze = False
    for i in range(60):
        f_ref, f_meas = (30.0 if i < 40 else 10.0), float(rng.uniform(0, 20))
        phase = ContactPhase.LOSS if 10 <= i < 15 else ContactPhase.PRESS
        ticks.append((squeeze(f_ref, f_meas), phase))
        f_des += np.clip(f_ref - f_des, -ramp * DT, ramp * DT)
        integral += 0.0 if freeze else DT * (f_des - f_meas)
        integral = np.clip(integral, -most, most)
        expected.append(f_des + K_fp * (f_des - f_meas) + K_fi * integral)
        freeze = phase is ContactPhase.LOSS
    assert run(controller, ticks) == pytest.approx(expected, abs=EXACT)
    assert np.ptp(expected) > 10


def test_a_limit_of_one_hand_makes_the_grasp_give_way_and_says_so() -> None:
    limit = MaxForce(space=LEFT, limit=20.0, name="most")
    controller, robot = holding((limit,)), body("two_arms")
    memory = controller.start("hold", robot.home)
    now = Measurement(0.0, robot.home, np.zeros(robot.nv))
    _, report, _ = controller.step("hold", now, squeeze(40.0), memory)
    assert [row.name for row in report.active] == ["contact most.fz"]
    left = report.contacts[0]
    assert left.wrench[2] == pytest.approx(20.0, abs=EXACT)
    assert left.margins["most"] == pytest.approx(0.0, abs=EXACT)
    assert left.binding == ("most.fz",)
    lost = {of.task: of for of in report.yields}["grasp"]
    box = felt(controller, robot.home, now.v, report)
    assert lost.amount[:3] == pytest.approx(box.internal[:3] - 40.0 * box.e, abs=EXACT)
    axis, amount, unit = lost.largest()
    assert (axis, unit) == ("vy", "N")
    assert abs(amount) > 10
    assert "task grasp gave way" in report.explain()


def test_what_holds_by_friction_alone_falls_when_it_may_not_squeeze() -> None:
    """2 kg need 9.81 N of friction from each hand: μ cos(π/8) f."""
    friction = tuple(
        FrictionCone(space=space, mu=0.5, sides=8, name=f"friction {space.frame}")
        for space in (LEFT, RIGHT)
    )
    most = tuple(MaxForce(space=s, limit=10.0, name=f"most {s.frame}") for s in (LEFT, RIGHT))
    robot = body("two_arms")
    now = Measurement(0.0, robot.home, np.zeros(robot.nv))
    still = {**squeeze(40.0), "box": MotionReference(X_WD=robot.pose(robot.home, "box"))}
    falls = []
    for limits in (friction, (*friction, *most)):
        controller = holding(limits)
        _, report, _ = controller.step("hold", now, still, controller.start("hold", robot.home))
        assert report.status is Status.OK
        box = felt(controller, robot.home, now.v, report)
        falls.append(box.needed[2] / 2.0 - 9.81)  # m/s² of 2 kg
    can = 2 * 0.5 * np.cos(np.pi / 8) * 10.0 / 2.0 - 9.81
    assert falls[0] == pytest.approx(0.0, abs=1e-6)
    assert can - 1e-6 <= falls[1] <= can / 2  # some of it moments, with 10 N each
    assert falls[1] < -2


BAD = {
    "one hand twice": (lambda: GraspForceTask(contacts=(LEFT, LEFT)), "left_pad from box and left"),
    "hands in the world": (
        lambda: GraspForceTask(contacts=(TaskSpace("left_pad"), TaskSpace("right_pad"))),
        "need two hands seen from one object, got left_pad from None",
    ),
    "hands on two objects": (
        lambda: GraspForceTask(contacts=(LEFT, TaskSpace("right_pad", relative_to="table"))),
        "left_pad from box and right_pad from table",
    ),
    "some axes": (
        lambda: GraspForceTask(contacts=(TaskSpace("left_pad", ("vx",), "box"), RIGHT)),
        "grasp needs the axes vx vy vz wx wy wz, got vx",
    ),
    "a negative ramp": (lambda: holding(ramp=-1.0), r"grasp\.ramp: got -1"),
    "a hand seen from itself": (
        lambda: TaskSpace("box", relative_to="box"),
        "frame 'box' seen from itself",
    ),
}


@pytest.mark.parametrize("what", BAD)
def test_what_is_no_grasp_is_refused_in_words(what: str) -> None:
    make, said = BAD[what]
    with pytest.raises(InputError, match=said):
        make()


@pytest.mark.parametrize("kept", [0, 1])
def test_a_grasp_needs_a_constraint_on_both_contacts(kept: int) -> None:
    robot = body("two_arms")
    tasks = (GraspForceTask(contacts=(LEFT, RIGHT)), PostureTask(q_ref=robot.home))
    constraints = bodies()["grasp"].constraints()[:kept]
    loose = ("left_pad", "right_pad")[kept]
    with pytest.raises(InputError, match=f"task 'grasp' has no constraint on its contact '{loose}"):
        Mode(name="m", tasks=tuple(map(Weighted, tasks)), constraints=constraints)


@pytest.mark.parametrize(
    ("frame", "other", "said"),
    [
        ("box_bottom", "box", "'box_bottom' does not move seen from 'box'"),
        ("table", None, "'table' does not move"),
    ],
)
def test_a_frame_that_cannot_move_is_no_task_space(frame: str, other: Any, said: str) -> None:
    robot, space = body("two_arms"), TaskSpace(frame, relative_to=other)
    tasks = (MotionTask(space=space), MotionTask(space=BOX, name="box"))
    posture = PostureTask(q_ref=robot.home)
    mode = Mode(name="m", tasks=tuple(map(Weighted, (*tasks, posture))), metric="home")
    with pytest.raises(InputError, match=said):
        Controller(robot, [mode])


def test_a_number_that_is_none_stops_the_tick_and_a_wrong_name_the_caller() -> None:
    controller, robot = holding(), body("two_arms")
    memory, now = controller.start("hold", robot.home), np.zeros(robot.nv)
    given = squeeze(np.nan)
    command, report, _ = controller.step("hold", Measurement(0.0, robot.home, now), given, memory)
    assert report.status is Status.NOT_FINITE
    assert np.isfinite(command.tau).all()
    typo = {**squeeze(1.0), "grasp": Given(f_re=np.array(1.0))}
    with pytest.raises(InputError, match=r"did you mean 'grasp\.f_ref'"):
        controller.step("hold", Measurement(0.0, robot.home, now), typo, memory)


def test_the_internal_force_of_the_oracle_is_that_of_opposite_pushes() -> None:
    """Two opposite wrenches along the line between the hands have no sum."""
    of, rng = bodies()["grasp"], np.random.default_rng(4)
    q, v = of.state(rng)
    one, other = (whole.contact_of(of.robot.model, q, v, grip.held).motion for grip in of.grips)
    E_1, E_2 = whole.internal_map(one, other)
    way = other.X.translation - one.X.translation
    e = way / np.linalg.norm(way)
    push = np.r_[one.X.rotation.T @ e, np.zeros(3)], np.r_[other.X.rotation.T @ -e, np.zeros(3)]
    assert E_1 @ push[0] + E_2 @ push[1] == pytest.approx(np.r_[e, np.zeros(3)], abs=1e-12)


@pytest.mark.parametrize("law", ["qp", "hybrid"])
def test_the_metric_of_where_the_robot_is_squeezes_as_well(law: Any) -> None:
    of, rng = bodies()["grasp"], np.random.default_rng(2)
    controller = Controller(unlimited(of.robot), [of.mode(metric="inertia")], law=law)
    for _ in range(3):
        q, v = of.state(rng)
        memory = controller.start(of.model, q)
        given = commands(of, rng).references(of)
        command, report, _ = controller.step(of.model, Measurement(0.0, q, v), given, memory)
        assert (report.status, report.limited) == (Status.OK, False)
        assert report.law_gap < 1e-9
        assert np.abs(command.tau).max() < 1e3
