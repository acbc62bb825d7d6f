"""The table of natural and artificial constraints: what is printed, read back and judged."""

import contextlib
import functools
import io
import json
import re
from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import oracles
import pinocchio as pin
import pytest

from qpctrl import constraint as constraints
from qpctrl.constraint import PoseConstraint, Surface, row_function
from scenarios.cli import main
from scenarios.constraint_catalogue import ENTRIES, Entry, at
from scenarios.constraint_table import constraint_table
from scenarios.constraint_words import conditioned, directions, equations, pushes
from scenarios.guided import FLANGE
from scenarios.robot_file import load_robot

ROUND_OFF = 1e-9
"""Numbers of order one through one 6×6 elimination; the entries' coefficients have few digits,
so that printing them loses nothing."""

TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")

each = pytest.mark.parametrize("name", list(ENTRIES))


# What is printed, and what the constraint itself says -------------------------------------


@functools.cache
def printed(*arguments: str) -> str:
    """Return what the command prints."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), pytest.raises(SystemExit) as exited:
        main(["constraints", *arguments])
    assert exited.value.code == 0
    return out.getvalue()


def told(name: str) -> dict[str, Any]:
    """Return the table as the command prints it for machines."""
    return json.loads(printed(name, "--json"))


class Contact(NamedTuple):
    """Rows of the constraint at the arm's home, from the constraint itself."""

    A: np.ndarray
    A_dot_V: np.ndarray
    v_c: np.ndarray
    sides: tuple[bool, ...]


def contact(name: str, V: np.ndarray | None = None) -> Contact:
    """Return the rows of an entry, along the axes of the tool, at its body twist ``V``."""
    entry, robot = ENTRIES[name], load_robot("fr3")
    X_WF = robot.pose(robot.home, "flange")
    if entry.build is None:
        return Contact(np.zeros((0, 6)), np.zeros(0), np.zeros(0), ())
    X_WE = X_WF * entry.X_EF.inverse()
    made = entry.build(X_WE)
    inputs = made.inputs()
    if name == "conveyor":  # 0.1 m/s along x of the board, 0.05 m/s against its z
        inputs["V_env"] = np.r_[X_WE.rotation @ [0.1, 0, -0.05], np.zeros(3)]
    V = np.zeros(6) if V is None else V
    rows = row_function(made)(X_WF.rotation, X_WF.translation, V, *inputs.values())
    A, A_dot_V, v_c, _ = (np.array(part) for part in rows)
    return Contact(A, A_dot_V.ravel(), v_c.ravel(), made.unilateral)


def shown_in(name: str) -> pin.SE3:
    """Return the pose of the tool in the frame of the table."""
    X_EF = ENTRIES[name].X_EF
    return pin.SE3(X_EF.rotation, 0 * X_EF.translation) if told(name)["origin"] == "tool" else X_EF


def read(text: str, letters: tuple[str, ...]) -> tuple[np.ndarray, str, float]:
    """Return coefficients (6), relation and right-hand side of a printed equation."""
    left, relation, right = re.fullmatch(r"(.*) ([=≥≤]) (\S+)", text).groups()
    coefficients = np.zeros(6)
    pieces = re.findall(r"([+-]?) ?([\d.]*) ?([vwfm][xyz])", left)
    assert "".join("".join(piece) for piece in pieces) == left.replace(" ", "")
    for sign, size, letter in pieces:
        coefficients[letters.index(letter)] += float(size or 1) * (-1 if sign == "-" else 1)
    return coefficients, relation, float(right)


def read_all(texts: list[str], letters: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return coefficients (m×6) and right-hand sides (m)."""
    found = [read(text, letters) for text in texts]
    assert all(relation == "=" for _, relation, _ in found)
    rows, right = [row for row, _, _ in found], [right for _, _, right in found]
    return np.array(rows).reshape(-1, 6), np.array(right)


# Every entry ------------------------------------------------------------------------------


@each
def test_the_free_motions_are_reciprocal_to_the_rows(name: str) -> None:
    A, k = contact(name).A, told(name)["k"]
    N = np.array(told(name)["N"]).reshape(-1, 6)
    assert N.shape == (6 - k, 6)
    for free in N:
        V = shown_in(name).actInv(pin.Motion(free)).vector
        assert pytest.approx(np.zeros(k), abs=ROUND_OFF) == A @ V
    if k < 6:
        assert np.linalg.matrix_rank(N) == 6 - k
    if k > 0:
        assert np.linalg.matrix_rank(A) == len(A) == k


@each
def test_the_printed_equations_hold_for_every_motion_on_the_constraint(name: str) -> None:
    rows, right = read_all(told(name)["twist"], TWIST)
    A, _, v_c, _ = contact(name)
    assert len(rows) == len(A)
    free = np.linalg.svd(A)[2][len(A) :]
    for z in np.random.default_rng(1).normal(size=(5, len(free))):
        V = np.linalg.pinv(A) @ v_c + z @ free
        shown = shown_in(name).act(pin.Motion(V)).vector
        assert rows @ shown == pytest.approx(right, abs=ROUND_OFF)
    assert not len(A) or np.linalg.matrix_rank(rows) == len(A)  # and so for no other motion


@each
def test_the_printed_equations_hold_for_every_wrench_of_the_constraint(name: str) -> None:
    rows, right = read_all(told(name)["wrench"], WRENCH)
    A = contact(name).A
    assert len(rows) == 6 - len(A)
    assert not right.any()
    for lam in np.random.default_rng(2).normal(size=(5, len(A))):
        shown = shown_in(name).act(pin.Force(A.T @ lam)).vector
        assert rows @ shown == pytest.approx(right, abs=ROUND_OFF)
    assert len(A) == 6 or np.linalg.matrix_rank(rows) == 6 - len(A)


@each
def test_what_can_only_be_pushed_is_said_with_the_right_sign(name: str) -> None:
    A, _, _, sides = contact(name)
    found = [read(text, WRENCH) for text in told(name)["one_sided"]]
    one_sided = np.flatnonzero(sides)
    assert len(found) == len(one_sided)
    for i, (row, relation, bound) in zip(one_sided, found, strict=True):
        assert (relation, bound) == ("≥", 0)
        for lam in np.random.default_rng(3).normal(size=(5, len(A))):
            shown = shown_in(name).act(pin.Force(A.T @ lam)).vector
            assert np.sign(row @ shown) == np.sign(lam[i])


@each
def test_each_direction_has_one_natural_and_one_artificial_constraint(name: str) -> None:
    table = told(name)
    natural = [row["natural"] for row in table["directions"]]
    assert sorted(natural) == sorted(table["twist"] + table["wrench"])
    chosen = [row["artificial"].split(" = any")[0] for row in table["directions"]]
    for i, (equation, letter) in enumerate(zip(natural, chosen, strict=True)):
        assert {equation[:2], letter} == {TWIST[i], WRENCH[i]}
        others = natural[:i] + natural[i + 1 :]
        assert not any(re.search(rf"\b{equation[:2]}\b", other) for other in others)


@each
def test_the_example_moves_on_the_constraint_as_the_task_chose(name: str) -> None:
    V = np.array(told(name)["V"])
    body = shown_in(name).actInv(pin.Motion(V)).vector
    A, A_dot_V, v_c, _ = contact(name, body)
    assert pytest.approx(v_c, abs=ROUND_OFF) == A @ body
    for axis, value in ENTRIES[name].motion.items():
        assert V[TWIST.index(axis)] == value
    rows = told(name)["rows"]
    assert np.ravel([row["A"] for row in rows]) == pytest.approx(A.ravel(), abs=ROUND_OFF)
    assert [row["A_dot_V"] for row in rows] == pytest.approx(A_dot_V, abs=ROUND_OFF)
    assert [row["v_c"] for row in rows] == pytest.approx(v_c, abs=ROUND_OFF)


@each
def test_condition_and_textbook_error_are_those_of_the_arm_at_home(name: str) -> None:
    table, robot = told(name), load_robot("fr3")
    motion = shown_in(name).actInv(pin.Motion(np.array(table["V"]))).vector
    A, A_dot_V, _, _ = contact(name, motion)
    terms = oracles.body_terms(robot.model, robot.home, np.zeros(7), "flange", FLANGE.index)
    if not len(A):
        assert (table["condition"], table["S_condition"]) == (None, None)
        return
    sizes = np.linalg.svd(A, compute_uv=False)
    assert table["singular_values"] == pytest.approx(sizes, abs=ROUND_OFF)
    assert table["condition"] == pytest.approx(sizes[0] / sizes[-1])
    S = np.linalg.eigvalsh(A @ terms.Lambda_inv @ A.T)
    assert table["S_condition"] == pytest.approx(S[-1] / S[0], rel=1e-9)
    rows = oracles.Rows(A=A, A_dot_V=A_dot_V, v_c_dot=np.zeros(len(A)))
    error = shown_in(name).act(pin.Force(oracles.curvature_wrench(terms, rows))).vector
    assert table["textbook_error"] == pytest.approx(error, abs=ROUND_OFF)


@each
def test_the_table_for_people_says_it_all_within_100_columns(name: str) -> None:
    said, table = printed(name), told(name)
    assert said.startswith(f"{name}, k = {table['k']}\n{table['words']}\n")
    assert max(len(line.rstrip()) for line in said.splitlines()) <= 100
    for row in table["directions"]:
        assert re.search(
            f"{row['name']} +{re.escape(row['natural'])} +{re.escape(row['artificial'])}", said
        )
    for row in table["rows"]:
        pattern = rf"^{re.escape(row['name'])} .* {row['unit']} +{row['lambda_unit']} +"
        pattern += "yes, λ ≥ 0" if row["unilateral"] else "no"
        assert re.search(pattern, said, re.MULTILINE)
    assert f"k = {table['k']}, free motions 6 - k = {table['free_motions']}" in said


# Answers written out by hand --------------------------------------------------------------


def zero(letters: str) -> list[str]:
    """Return ``vx = 0`` and so on."""
    return [f"{letter} = 0" for letter in letters.split()]


TEXTBOOK = {
    "free": ([], zero("fx fy fz mx my mz")),
    "point_on_plane": (zero("vz"), zero("fx fy mx my mz")),
    "edge_on_plane": (zero("vz wx"), zero("fx fy my mz")),
    "face_on_plane": (zero("vz wx wy"), zero("fx fy mz")),
    "crank": (zero("vx vz wx wy"), zero("fy mz")),
    "drawer": (zero("vy vz wx wy wz"), zero("fx")),
    "hinge": (zero("vx vy vz wx wy"), zero("mz")),
    "screw": (["vx = 0", "vy = 0", "vz - 0.02 wz = 0", "wx = 0", "wy = 0"], ["mz + 0.02 fz = 0"]),
    "embedded": (zero("vx vy vz wx wy wz"), []),
    "sphere": (zero("vz"), zero("fx fy mx my mz")),
    # a face that turns with the ball: a ball joint in its centre
    "sphere_face": (zero("vx vy vz"), zero("mx my mz")),
    "cylinder": (zero("vx"), zero("fy fz mx my mz")),
    # at (0.1, 0.05): the slope of z = 3 x²/2 − 2 y²/2 is (0.3, −0.1)
    "saddle": (
        ["vz - 0.3 vx + 0.1 vy = 0"],
        ["fx + 0.3 fz = 0", "fy - 0.1 fz = 0", *zero("mx my mz")],
    ),
    "conveyor": (["vz = -0.05", "wx = 0", "wy = 0"], zero("fx fy mz")),
}

CURVATURE = {
    "crank": 0.2**2 / 0.25,  # v²/r, outwards
    "sphere": -(0.2**2) / 0.25,  # the normal points inwards
    "cylinder": -(0.2**2) / 0.1,
    "saddle": -3 * 0.2**2 / np.sqrt(1 + 0.3**2 + 0.1**2),
}
"""Ȧ V of the first row on the example motion [m/s²]; all else is 0."""

UNITS = {"hinge": "m/s m/s m/s rad/s rad/s", "sphere_face": "m/s rad/s rad/s", "sphere": "m/s"}


@each
def test_the_equations_are_those_of_the_textbook(name: str) -> None:
    twist, wrench = TEXTBOOK[name]
    assert told(name)["twist"] == twist
    assert told(name)["wrench"] == wrench


@each
def test_the_example_shows_the_curvature_that_it_has(name: str) -> None:
    expected = np.zeros(told(name)["k"])
    expected[:1] = CURVATURE.get(name, 0.0)
    assert [row["A_dot_V"] for row in told(name)["rows"]] == pytest.approx(expected, abs=ROUND_OFF)
    assert ("it agrees with the QP" in printed(name)) == (name not in CURVATURE and name != "free")


@pytest.mark.parametrize("name", UNITS)
def test_a_row_has_the_unit_of_its_direction(name: str) -> None:
    assert [row["unit"] for row in told(name)["rows"]] == UNITS[name].split()


def test_the_eraser_reads_as_in_the_book() -> None:
    rows = [(row["natural"], row["artificial"]) for row in told("face_on_plane")["directions"]]
    assert rows == [
        ("fx = 0", "vx = any"),
        ("fy = 0", "vy = any"),
        ("vz = 0", "fz = any, ≥ 0 (can only be pushed)"),
        ("wx = 0", "mx = any"),
        ("wy = 0", "my = any"),
        ("mz = 0", "wz = any"),
    ]


def test_an_environment_that_moves_shows_how_fast() -> None:
    assert told("conveyor")["rows"][0]["v_c"] == pytest.approx(-0.05)
    assert "v_c = (-0.05, 0, 0)" in printed("conveyor")
    assert "A V = v_c" in printed("conveyor")
    assert "A V = 0" in printed("face_on_plane")


# Other constraints than those of the table ------------------------------------------------


def posed(c: ca.SX, p: ca.SX, *, one_sided: bool = False) -> Entry:
    """Return the entry of equations on the position of the tool."""
    R, here = ca.SX.sym("R", 3, 3), pin.SE3.Identity()
    return Entry(
        build=lambda X_WE: PoseConstraint(
            space=FLANGE, X_WE=X_WE, c=c, R=R, p=p, contact=here, one_sided=one_sided
        ),
        axes="any",
        X_EF=here,
        motion={},
        about="Equations of a user.",
    )


def test_an_edge_askew_gives_linear_combinations() -> None:
    askew = replace(ENTRIES["edge_on_plane"], X_EF=at(turn=(0, 0, np.degrees(np.arctan(0.75)))))
    table = constraint_table(askew, load_robot("fr3"))
    # the edge is along (−0.6, 0.8, 0); what lifts an end turns about (0.8, 0.6, 0)
    assert equations(table.twist, TWIST) == ["vz = 0", "wx + 0.75 wy = 0"]
    assert equations(table.wrench, WRENCH) == ["fx = 0", "fy = 0", "my - 0.75 mx = 0", "mz = 0"]


def test_a_plane_that_is_pushed_against_its_axis_bounds_the_force_from_above() -> None:
    p = ca.SX.sym("p", 3)
    table = constraint_table(posed(-p[2], p, one_sided=True), load_robot("fr3"))
    assert pushes(table) == ["fz ≤ 0"]
    assert directions(table)[2].artificial == "fz = any, ≤ 0 (can only be pushed)"


def test_two_walls_that_are_not_square_bound_a_sum_of_forces() -> None:
    p = ca.SX.sym("p", 3)
    walls = posed(ca.vertcat(p[2], p[2] + 0.5 * p[0]), p, one_sided=True)
    table = constraint_table(walls, load_robot("fr3"))
    # F = Aᵀ λ: fx = λ₁/2, fz = λ₀ + λ₁
    assert pushes(table) == ["fz - 2 fx ≥ 0", "fx ≥ 0"]
    assert directions(table)[2].artificial == "fz = any"
    assert directions(table)[0].artificial == "fx = any, ≥ 0 (can only be pushed)"


def test_rows_that_nearly_depend_on_each_other_are_called_ill_conditioned() -> None:
    p = ca.SX.sym("p", 3)
    robot = load_robot("fr3")
    close = constraint_table(posed(ca.vertcat(p[0], p[0] + 1e-5 * p[1]), p), robot)
    apart = constraint_table(posed(ca.vertcat(p[0], p[0] + 0.1 * p[1]), p), robot)
    assert "ill-conditioned" in conditioned(close)
    assert "ill-conditioned" not in conditioned(apart)


# The catalogue ----------------------------------------------------------------------------


def test_every_constraint_of_the_library_is_in_the_table() -> None:
    exported = {name: getattr(constraints, name) for name in constraints.__all__}
    kinds = {name for name, value in exported.items() if hasattr(value, "unilateral")}
    helpers = {"Constraint", "Pfaffian", "PoseConstraint", "Selection"}
    assert helpers < kinds
    shown = {
        type(entry.build(pin.SE3.Identity())).__name__ for entry in ENTRIES.values() if entry.build
    }
    assert kinds - helpers == shown
    shapes = {name for name in exported if name.islower()} - {"row_function"}
    assert shapes <= set(ENTRIES)


@each
def test_a_tool_on_a_surface_touches_it(name: str) -> None:
    entry = ENTRIES[name]
    made = entry.build(pin.SE3.Identity()) if entry.build else None
    if not isinstance(made, Surface):
        assert name not in ("sphere", "sphere_face", "cylinder", "saddle")
        return
    phi = ca.Function("phi", [made.p], [made.phi, ca.gradient(made.phi, made.p)])
    value, gradient = (np.array(part).ravel() for part in phi(entry.X_EF.translation))
    assert value == pytest.approx(0, abs=1e-15)
    into = entry.X_EF.rotation[:, 2] @ gradient / np.linalg.norm(gradient)
    assert into == pytest.approx(1) if made.face else into > 0.9


def test_without_a_name_all_are_listed() -> None:
    said = printed()
    assert max(len(line.rstrip()) for line in said.splitlines()) <= 100
    for name, entry in ENTRIES.items():
        assert re.search(rf"^ {name} +{told(name)['k']}  {entry.words[:9]}", said, re.MULTILINE)
        assert name in printed("--help")
    assert json.loads(printed("--json")) == {name: e.words for name, e in ENTRIES.items()}


def test_a_constraint_is_described_by_the_first_line_of_its_docstring() -> None:
    assert told("hinge")["words"] == (
        "A grasped cabinet door: rotation about the hinge is all that is left."
    )
    assert all(entry.words.endswith(".") and "\n" not in entry.words for entry in ENTRIES.values())
