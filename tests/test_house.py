"""The house: who imports whom, how long things are, what is documented."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FLOORS = ("qpctrl", "tasks", "scenarios")
"""Imports go from a later one to an earlier one."""

ALLOWED = {floor: set(FLOORS[: i + 1]) for i, floor in enumerate(FLOORS)}
MODULE_LINES, FUNCTION_LINES = 300, 60
LIBRARY = ("qpctrl", "tasks")


def modules(*floors: str) -> list[Path]:
    """Return the Python files of these folders."""
    return sorted(path for floor in floors for path in (ROOT / floor).rglob("*.py"))


def parsed(path: Path) -> ast.Module:
    """Return the syntax tree."""
    return ast.parse(path.read_text(encoding="utf-8"))


def imported(path: Path) -> Iterator[str]:
    """Yield the top-level packages that a module imports, wherever in it."""
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield (node.module or "").split(".")[0]


def names(paths: list[Path]) -> list[str]:
    """Return paths from the root, to name the cases."""
    return [str(path.relative_to(ROOT)) for path in paths]


def each(*floors: str) -> pytest.MarkDecorator:
    """Parametrise over the modules of these folders."""
    paths = modules(*floors)
    return pytest.mark.parametrize("path", paths, ids=names(paths))


@each(*FLOORS)
def test_imports_go_down_the_floors(path: Path) -> None:
    floor = path.relative_to(ROOT).parts[0]
    ours = {*FLOORS, "tests", "cases", "oracles"} & set(imported(path))
    assert ours <= ALLOWED[floor], f"{path.name} imports {ours - ALLOWED[floor]}"


def test_every_floor_has_modules_and_imports_what_it_may() -> None:
    assert set(imported(ROOT / "tasks" / "force.py")) >= {"qpctrl", "casadi"}
    assert all(len(modules(floor)) > 1 for floor in FLOORS)


@each(*LIBRARY)
def test_the_library_knows_no_simulator_and_prints_nothing(path: Path) -> None:
    assert not {"mujoco", "rich", "tyro", "polars", "plotly"} & set(imported(path))
    calls = [node.func for node in ast.walk(parsed(path)) if isinstance(node, ast.Call)]
    assert "print" not in [call.id for call in calls if isinstance(call, ast.Name)]


@each(*FLOORS)
def test_one_module_alone_knows_the_solvers(path: Path) -> None:
    solvers = {"proxsuite", "qpsolvers", "daqp", "quadprog", "piqp", "clarabel"}
    if path != ROOT / "qpctrl" / "solver.py":
        assert not solvers & set(imported(path))


def test_the_plants_alone_know_mujoco_and_how_it_differs() -> None:
    users = {path.name for path in modules("scenarios") if "mujoco" in set(imported(path))}
    assert "plant_mujoco.py" in users
    assert not {"wiping.py", "scenario.py", "cli.py", "record.py"} & users


@each(*FLOORS)
def test_modules_and_functions_are_short(path: Path) -> None:
    lines = len(path.read_text(encoding="utf-8").splitlines())
    assert lines <= MODULE_LINES, f"{lines} lines"
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            length = (node.end_lineno or 0) - node.lineno + 1
            assert length <= FUNCTION_LINES, f"{node.name}: {length} lines"


def undocumented(node: ast.AST, inside: str = "") -> Iterator[str]:
    """Yield public classes, functions and methods without a docstring."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.ClassDef | ast.FunctionDef) and not child.name.startswith("_"):
            if not ast.get_docstring(child):
                yield f"{inside}{child.name}"
            if isinstance(child, ast.ClassDef):
                yield from undocumented(child, f"{child.name}.")


@each(*FLOORS)
def test_public_names_and_modules_are_documented(path: Path) -> None:
    tree = parsed(path)
    assert ast.get_docstring(tree), "module"
    assert not list(undocumented(tree))


@each(*FLOORS)
def test_public_functions_are_annotated(path: Path) -> None:
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
            bare = [
                a.arg for a in arguments if a.annotation is None and a.arg not in ("self", "cls")
            ]
            assert not bare, f"{node.name}: {bare}"
            assert node.returns is not None, node.name


@each(*FLOORS)
def test_input_is_not_checked_with_assert(path: Path) -> None:
    assert not [node for node in ast.walk(parsed(path)) if isinstance(node, ast.Assert)]


def test_the_tests_run_the_library_under_its_annotations() -> None:
    """The import hook is on: an integer array is no array of floats."""
    import numpy as np
    from jaxtyping import TypeCheckError

    from qpctrl.spatial import angular_first
    from tasks import PostureReference

    with pytest.raises(TypeCheckError):
        angular_first(np.arange(6))
    with pytest.raises(TypeCheckError):
        PostureReference(q_ref=np.arange(7))
