"""The code of the guide runs as printed, and prints what the page says."""

import contextlib
import io
import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[1] / "docs" / "guide.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```(?:\s+```text\n(.*?)```)?", PAGE, re.DOTALL)
PRINTED = 1e-3
"""Relative: the page shows four digits or more."""

ROUND_OFF = 1e-9
"""Below this two printed numbers are both zero."""

NUMBER = re.compile(r"-?\d+\.?\d*(?:e-?\d+)?")


def test_every_block_prints_what_the_page_says() -> None:
    namespace = {"__name__": "guide"}
    for code, said in BLOCKS:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(code, "docs/guide.md", "exec"), namespace)
        found = printed.getvalue()
        assert NUMBER.sub("#", found).split() == NUMBER.sub("#", said).split(), code
        numbers = [[float(n) for n in NUMBER.findall(text)] for text in (found, said)]
        assert numbers[0] == pytest.approx(numbers[1], rel=PRINTED, abs=ROUND_OFF)


def test_the_page_shows_most_of_what_it_runs() -> None:
    assert len(BLOCKS) >= 10
    assert sum(bool(said) for _, said in BLOCKS) >= 8
