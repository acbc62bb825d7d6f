"""The generated header of an exported controller: its sizes, modes and inputs, with their units."""

from collections.abc import Iterable, Iterator, Mapping, Sequence

from qpctrl.export.meaning import meaning, owners
from qpctrl.export.mode_code import ModeCode
from qpctrl.export.tables import sizes
from qpctrl.export.text import comment
from qpctrl.report import ACTIVE_DUAL
from qpctrl.robot import Robot
from qpctrl.tick import PIVOT_RATIO


def modes_header(
    name: str, robot: Robot, modes: Sequence[ModeCode], places: Sequence[Mapping[str, str]]
) -> str:
    """Return the header.

    Args:
        name: what the names of the exported controller begin with.
        robot: names the joints.
        modes: the modes in their order.
        places: for each mode the constants of the places of its inputs, by their names.
    """
    NAME = name.upper()
    guard = f"{NAME}_MODES_H"
    fixed = {"NQ": robot.nq, "NV": robot.nv, "NU": robot.nu, "MODES": len(modes), **sizes(modes)}
    parts = [
        comment(f"Sizes, modes and inputs of the controller {name}; written by qpctrl export."),
        f"#ifndef {guard}\n#define {guard}\n",
        *_orders(robot),
        comment(f"Order of tau: {', '.join(robot.actuator_names)}"),
        _enum((f"{NAME}_{key}", value) for key, value in fixed.items()),
        f"#define {NAME}_ACTIVE_DUAL {ACTIVE_DUAL!r}",
        f"#define {NAME}_PIVOT_RATIO {PIVOT_RATIO!r}\n",
        comment("Modes."),
        _enum((f"{NAME}_{mode_word(mode)}", i) for i, mode in enumerate(modes)),
        *(_inputs(name, mode, words) for mode, words in zip(modes, places, strict=True)),
        "#endif\n",
    ]
    return "\n".join(parts)


def _orders(robot: Robot) -> list[str]:
    """Return in which order configuration and velocities are."""
    q, v = robot.configuration_names, robot.joint_names
    orders = {"q and v": v} if q == v else {"q": q, "v": v}
    return [comment(f"Order of {what}: {', '.join(names)}") for what, names in orders.items()]


def mode_word(mode: ModeCode) -> str:
    """Return the constant of a mode's number, without the name in front."""
    return f"MODE_{mode.word.upper()}"


def _enum(values: Iterable[tuple[str, int]]) -> str:
    return "enum {\n" + ",\n".join(f"    {name} = {value}" for name, value in values) + "\n};\n"


def _inputs(name: str, mode: ModeCode, words: Mapping[str, str]) -> str:
    """Return where the inputs of one mode are."""
    head = (
        f"Inputs of mode {mode.tick.mode.name}: where each begins in what {name}_inputs returns. "
        "Matrices lie column by column."
    )
    needed = "Those marked ! are NaN until they are written, anew whenever the mode is entered."
    lines = [comment(head), *([comment(needed)] if mode.demanded else []), "enum {"]
    return "\n".join([*lines, *_places(mode, words), "};\n"])


def _places(mode: ModeCode, words: Mapping[str, str]) -> Iterator[str]:
    layout, titles, last = mode.tick.inputs, owners(mode.tick.mode), None
    shapes = {name: view.shape for name, view in layout.views(layout.vector()).items()}
    for name, word in words.items():
        owner = name.rpartition(".")[0]
        if owner != last:
            yield f"    {comment(titles.get(owner, owner))}"
            last = owner
        shape = "x".join(map(str, shapes[name])) or "1"
        said = f"{'! ' if name in mode.demanded else ''}({shape}) {meaning(name)}"
        end = "" if name == [*words][-1] else ","
        yield f"    {word} = {layout.place(name).start}{end} {comment(said)}"
