"""How far a study is, for a person who watches it."""

import contextlib
from collections.abc import Callable, Iterator

from rich import progress
from rich.console import Console

from scenarios.command import interactive
from scenarios.study.campaign import Progress
from scenarios.study.outcome import counts_text


@contextlib.contextmanager
def study_progress(name: str) -> Iterator[Callable[[Progress], None] | None]:
    """Yield what shows rollouts, rate, time left and outcomes to a person, if there is one."""
    if not interactive():
        yield None
        return
    columns = (
        *(progress.TextColumn("{task.description}"), progress.BarColumn()),
        *(progress.MofNCompleteColumn(), progress.TextColumn("{task.fields[rate]}")),
        *(progress.TextColumn("ETA"), progress.TimeRemainingColumn()),
        progress.TextColumn("{task.fields[outcomes]}"),
    )
    with progress.Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(name, total=None, rate="", outcomes="")

        def watch(found: Progress) -> None:
            speed = bar.tasks[0].speed
            rate = f"{speed:.2f} /s" if speed else ""
            bar.update(
                task,
                completed=found.done,
                total=found.rows,
                rate=rate,
                outcomes=outcomes_text(found),
            )

        yield watch


def outcomes_text(found: Progress) -> str:
    """Return the rows by class of outcome, in brackets; nothing if there are none."""
    said = counts_text(dict(sorted(found.outcomes.items())))
    return f" ({said})" if said else ""
