"""A board that falls away while it is wiped."""

from dataclasses import dataclass

import numpy as np

from qpctrl.arrays import Vector
from scenarios.plant import Plant, PlantState
from scenarios.plant_mujoco import MujocoPlant


@dataclass(kw_only=True, eq=False)
class FallingBoard:
    """A plant whose board falls away at once, some time after the first touch."""

    plant: Plant
    board: MujocoPlant
    """The plant that has the board, moved by its drives or not."""
    way_W: Vector
    """How far it falls (3) [m], in the world."""
    after: float
    """Time from the first touch to the fall [s]."""
    falls_at: float = np.inf
    """Time of the fall [s]."""
    fallen: bool = False

    def reset(self, q: Vector) -> PlantState:
        """Return the state at rest in ``q`` (nq), with the board where it was built."""
        if self.fallen:
            self.board.move_board(-self.way_W)
        self.falls_at, self.fallen = np.inf, False
        return self.plant.reset(q)

    def step(self, tau: Vector) -> PlantState:
        """Return the state after ``tau`` (nv) [Nm] has acted for one period."""
        state = self.plant.step(tau)
        if state.touching and self.falls_at == np.inf:
            self.falls_at = state.time + self.after
        if state.time >= self.falls_at and not self.fallen:
            self.board.move_board(self.way_W)
            self.fallen = True
        return state
