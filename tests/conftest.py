"""Run the whole suite with array shapes and types checked at every call."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: two workers, two cores

from jaxtyping import install_import_hook

install_import_hook(["qpctrl", "tasks"], "strictness.check")


def pytest_unconfigure() -> None:
    """Let go of the cached solvers, whose binding complains of leaks at exit."""
    import gc

    import cases

    cases.given_controller.cache_clear()
    gc.collect()
