"""The files of an exported controller, as texts by their names."""

import re
from collections.abc import Mapping, Sequence
from importlib.resources import files
from importlib.resources.abc import Traversable
from string import Template

from qpctrl.compiler import NotCompiledError, generate
from qpctrl.controller import Controller
from qpctrl.errors import InputError
from qpctrl.export.header import mode_word, modes_header
from qpctrl.export.meaning import PRIVATE
from qpctrl.export.mode_code import ModeCode
from qpctrl.export.tables import tables_source
from qpctrl.export.text import Identifiers, check_name

SOURCES = ("controller.c", "tick.c", "qp.c")
"""Files of the folder ``native`` that are compiled; the headers that they include come along."""

RECORDING = "recording.bin"
"""Name of the recorded run beside the files."""

UNUSED = """\
#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

"""


def project_files(controller: Controller, name: str) -> dict[str, str]:
    """Return the files of a stand-alone controller in C99 by their names.

    It does what ``controller`` does when built with the solver ``active-set``, with its robot,
    modes, law and period; inputs have the defaults that they have there after a reset.

    Args:
        controller: what to export.
        name: what the names of all files and of everything in them begin with.

    Raises:
        InputError: a name that cannot be used, or a mode that cannot be written as C.
    """
    check_name(name)
    words, engines = Identifiers(), controller.engines
    for mode, engine in engines.items():
        if engine.tick.upper_levels:
            raise InputError(f"mode {mode!r} has strict priorities, which C has no solver for")
    modes = [ModeCode(controller, mode, name, words.add(mode).lower()) for mode in engines]
    runtime = _runtime(name)
    places = _input_words(name, modes, runtime)
    made = {
        **runtime,
        f"{name}_modes.h": modes_header(name, controller.robot, modes, places),
        f"{name}_tables.c": tables_source(name, controller.robot, modes),
        **{f"{name}_mode_{mode.word}.c": _generated(mode) for mode in modes},
    }
    values = {
        "sources": "\n    ".join(sorted(file for file in made if file.endswith(".c"))),
        "headers": " ".join(f"{name}{end}.h" for end in ("", "_modes", "_tick")),
        **_readme_values(controller, modes, places),
    }
    here = files("qpctrl") / "export"
    return {
        **made,
        "replay.c": _prefixed(_text(here / "replay.c"), name),
        "CMakeLists.txt": _filled(here / "CMakeLists.txt.in", name, values),
        "README.md": _filled(here / "README.md.in", name, values),
    }


def _runtime(name: str) -> dict[str, str]:
    """Return the files of ``native`` that a controller needs, under its own name."""
    native, found, wanted = files("qpctrl") / "native", {}, list(SOURCES)
    while wanted:
        file = wanted.pop()
        text = _text(native / file)
        found[_renamed(file, name)] = _prefixed(text, name)
        included = re.findall(r'#include "(.*)"', text)
        wanted += [i for i in included if i != "modes.h" and _renamed(i, name) not in found]
    return dict(sorted(found.items()))


def _renamed(file: str, name: str) -> str:
    stem, _, end = file.partition(".")
    return f"{name}.{end}" if stem in ("controller", "qpctrl") else f"{name}_{file}"


def _prefixed(text: str, name: str) -> str:
    """Return a text of ours whose names begin with ``name`` instead of ``qpctrl``."""
    text = re.sub(r'#include "(.*)"', lambda m: f'#include "{_renamed(m[1], name)}"', text)
    return re.sub(r"\bqpctrl_", f"{name}_", re.sub(r"\bQPCTRL_", f"{name.upper()}_", text))


def _input_words(
    name: str, modes: Sequence[ModeCode], runtime: Mapping[str, str]
) -> list[dict[str, str]]:
    """Return the constants of the places of each mode's inputs, by the names of these."""
    NAME = f"{name.upper()}_"
    used = {word for text in runtime.values() for word in re.findall(rf"\b{NAME}\w+", text)}
    words = Identifiers({*used, *(NAME + mode_word(mode) for mode in modes)})
    return [
        {
            key: words.add(f"{NAME}{mode.word}_{key}").upper()
            for key in mode.tick.inputs.names
            if key not in PRIVATE
        }
        for mode in modes
    ]


def _generated(mode: ModeCode) -> str:
    """Return the generated functions of a mode."""
    try:
        return UNUSED + generate(list(mode.functions.values()))
    except NotCompiledError as error:
        raise InputError(f"mode {mode.tick.mode.name!r} cannot be exported: {error}") from error


def _readme_values(
    controller: Controller, modes: Sequence[ModeCode], places: Sequence[Mapping[str, str]]
) -> dict[str, str]:
    """Return what the README says of this controller."""
    rows, first = [], modes[0]
    for mode, words in zip(modes, places, strict=True):
        needed = ", ".join(f"`{words[key]}`" for key in mode.demanded) or "nothing"
        rows.append(f"| `{mode.tick.mode.name}` | {needed} |")
    place = first.tick.inputs.place
    writes = [
        f"        std::copy_n({key.replace('.', '_')}, {place(key).stop - place(key).start}, "
        f"u + {places[0][key]});"
        for key in first.demanded
    ]
    return {
        "modes": "\n".join(rows),
        "mode": mode_word(first),
        "writes": "\n".join(writes) or "        // this mode needs no references",
        "joints": ", ".join(controller.robot.joint_names),
        "actuators": ", ".join(controller.robot.actuator_names),
        "period": f"{controller.dt * 1e3:g} ms",
        "law": controller.law,
    }


def _filled(template: Traversable, name: str, values: Mapping[str, str]) -> str:
    return Template(_text(template)).substitute(values, name=name, NAME=name.upper())


def _text(file: Traversable) -> str:
    return file.read_text(encoding="utf-8")
