"""Run the whole suite with array shapes and types checked at every call."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: two workers, two cores

from jaxtyping import install_import_hook

install_import_hook(["qpctrl", "tasks"], "strictness.check")
