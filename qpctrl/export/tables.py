"""The tables of an exported controller: what its modes are made of, as constant C data."""

from collections.abc import Mapping, Sequence

from qpctrl.explanation import KINDS
from qpctrl.export.mode_code import ModeCode, Span
from qpctrl.export.text import string, strings, table
from qpctrl.robot import Robot
from qpctrl.status import BY_CODE

OUTCOMES = (
    *(status.value for status in BY_CODE),
    "a task that needs a reference was given none; write all its inputs before entering the mode",
    "there is no such mode; the arm is held in the one before",
    "the controller was not started; call start with the measured configuration",
)
"""What the outcomes of an exported controller mean, by their codes."""


def tables_source(name: str, robot: Robot, modes: Sequence[ModeCode]) -> str:
    """Return the C source of the tables.

    Args:
        name: what the names of the exported controller begin with.
        robot: names the joints.
        modes: the modes in their order.
    """
    names = {
        "mode_names[{NAME}_MODES]": [mode.tick.mode.name for mode in modes],
        "joint_names[{NAME}_NV]": robot.joint_names,
        "actuator_names[{NAME}_NU]": robot.actuator_names,
        **{"kinds[]": KINDS, "outcomes[]": OUTCOMES},
    }
    words = [
        f"const char *const {name}_{key.format(NAME=name.upper())} = {{\n"
        + "".join(f"    {string(text)},\n" for text in texts)
        + "};\n"
        for key, texts in names.items()
    ]
    signature = "(const double **arg, double **res, long long *iw, double *w, int mem);"
    functions = [function.name() for mode in modes for function in mode.functions.values()]
    entries, first, arg, res = [], 0, 0, 0
    for mode in modes:
        entries.append(_entry(mode, modes, first, arg, res))
        first, arg, res = first + mode.size, arg + _args(mode), res + _results(mode)
    head = f"const {name}_mode {name}_modes[{name.upper()}_MODES] = {{\n"
    parts = [
        f'#include "{name}_tables.h"\n',
        "".join(f"int {function}{signature}\n" for function in functions),
        *(_arrays(name, mode, modes) for mode in modes),
        head + ",\n".join(entries) + "\n};\n",
        *words,
    ]
    return "\n".join(parts)


def sizes(modes: Sequence[ModeCode]) -> dict[str, int]:
    """Return the lengths of the arrays in the struct of a controller, by their names there."""
    functions = [function for mode in modes for function in mode.functions.values()]
    return {
        "N_ARG": sum(map(_args, modes)),
        "N_RES": sum(map(_results, modes)),
        "N_NUMBERS": sum(mode.size for mode in modes),
        "N_W": max(1, *(function.sz_w() for function in functions)),
        "N_IW": max(1, *(function.sz_iw() for function in functions)),
        "N_WORK": max(solver_work(*mode.qp) for mode in modes),
        "N_IWORK": max(solver_iwork(*mode.qp) for mode in modes),
    }


def solver_work(n: int, m: int, r: int) -> int:
    """Return the doubles that ``native/qp.c`` works in, with room to align them to 32 bytes."""
    f, ld = max(n - m, 0), -(-n // 4) * 4
    matrices = ld * (2 * n + 3 * m + f) + f * f
    return matrices + 4 * ld + 6 * f + 2 * m + r + 1 + 3


def solver_iwork(n: int, m: int, r: int) -> int:
    """Return the ints that ``native/qp.c`` works in."""
    return n + m + r + 1


def _arrays(name: str, mode: ModeCode, modes: Sequence[ModeCode]) -> str:
    """Return the arrays that the entry of a mode refers to."""
    word, rows = mode.word, mode.tick.rows
    pointers = [f"{{offsetof({name}_tick, {to}), {at}}}" for to, at in mode.pointers.items()]
    carries = [f"{{{i}, {s.start}, {s.to}, {s.length}}}" for i, s in _carries(mode, modes)]
    demanded = [f"{{{span.start}, {span.length}}}" for span in mode.demanded_spans]
    owners = [row.partition(" ")[2] for row in rows.inequality]
    x = mode.tick.memory.vector()
    return "\n".join(
        (
            *(table("int", f"places_{word}_{of}", places) for of, places in mode.bound.items()),
            table(f"{name}_pointer", f"pointers_{word}", pointers),
            table(f"{name}_carry", f"carries_{word}", carries or ["{0, 0, 0, 0}"]),
            table(f"{name}_span", f"demanded_{word}", demanded or ["{0, 0}"]),
            table("double", f"u_{word}", map(repr, mode.inputs.tolist())),
            table("double", f"x_{word}", map(repr, x.tolist() or [0.0])),
            strings(f"rows_{word}", rows.constraint or [""]),
            strings(f"owners_{word}", owners or [""]),
        )
    )


def _entry(mode: ModeCode, modes: Sequence[ModeCode], first: int, arg: int, res: int) -> str:
    """Return a mode's entry in the table of modes.

    Args:
        mode: the mode.
        modes: all modes.
        first: where its numbers begin among those of the controller.
        arg: where its pointers to arguments begin.
        res: where its pointers to results begin.
    """
    word, functions = mode.word, []
    for name, f in mode.functions.items():
        counts = f"{f.n_in()}, {f.n_out()}, places_{word}_{name}"
        functions.append(f"            {{{f.name()}, {arg}, {res}, {counts}}}")
        arg, res = arg + f.sz_arg(), res + f.sz_res()
    arrays = {
        **{name: f"{name}_{word}" for name in ("pointers", "carries", "demanded", "u", "x")},
        **{"row_names": f"rows_{word}", "owners": f"owners_{word}"},
    }
    counts_of = {
        "n_pointers": len(mode.pointers),
        "n_carries": len(_carries(mode, modes)),
        "n_demanded": len(mode.demanded_spans),
    }
    members = [
        f".tick = {{{_members(mode.sizes)}}}",
        f".first = {first}",
        ".functions = {\n" + ",\n".join(functions) + "\n        }",
        *(_members({key: value}) for key, value in arrays.items()),
        _members(counts_of),
        *(_members({key: value}) for key, value in mode.numbers.items()),
    ]
    return "    {\n        " + ",\n        ".join(members) + "\n    }"


def _members(values: Mapping[str, object]) -> str:
    return ", ".join(f".{name} = {value}" for name, value in values.items())


def _carries(mode: ModeCode, modes: Sequence[ModeCode]) -> list[tuple[int, Span]]:
    """Return what a mode takes over from others, each with the number of that mode."""
    others = [(i, other) for i, other in enumerate(modes) if other is not mode]
    return [(i, span) for i, other in others for span in mode.carried_from(other)]


def _args(mode: ModeCode) -> int:
    return sum(function.sz_arg() for function in mode.functions.values())


def _results(mode: ModeCode) -> int:
    return sum(function.sz_res() for function in mode.functions.values())
