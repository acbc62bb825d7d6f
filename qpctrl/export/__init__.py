"""A controller as C99 files that need neither Python nor an allocation, and a recorded run."""

from qpctrl.export.project import RECORDING, project_files
from qpctrl.export.recording import Recording
from qpctrl.export.text import check_name, identifier

__all__ = ["RECORDING", "Recording", "check_name", "identifier", "project_files"]
