"""What the inputs of a mode are, in words for the generated header.

Names, units and frames are those of docs/notation.md. F is the task frame, W the world, D the
desired frame, E the environment; a pose is the first three rows of its 4×4 matrix.
"""

from qpctrl.mode import Mode
from qpctrl.space import TaskSpace

PRIVATE = ("mu", "freeze", "limits.tau_last")
"""Inputs that the controller writes itself."""

MEANINGS = {
    "dt": "period of the loop [s]",
    "q_min": "lowest configuration [rad or m]",
    "q_max": "highest configuration [rad or m]",
    "v_max": "highest speed, both signs [rad/s or m/s]",
    "tau_max": "highest torque, both signs [Nm or N]",
    "tau_stall": "torque at rest that the supply voltage can drive [Nm or N]",
    "tau_droop": "torque lost to back-EMF per speed [Nm s/rad or N s/m]",
    "tau_rate": "highest torque rate [Nm/s or N/s]",
    "rates": "rates at which position and velocity limits may be closed in on [1/s]",
    "weight": "who gives way when a limit binds [1]",
    "X_WD": "desired pose in W, or whence F is seen: R_WD column by column, then p [1, m]",
    "V_des": "its body twist (v, w), in D [m/s, rad/s]",
    "V_dot_des": "derivative of that twist's components [m/s^2, rad/s^2]",
    "V_dot_meas": "measured derivative of the twist, in F [m/s^2, rad/s^2]",
    "accelerometer": "1 where V_dot_meas is measured, 0 to take the difference of two twists",
    "K_p": "stiffness per unit inertia [1/s^2]",
    "K_i": "integral gain per unit inertia [1/s^3]",
    "K_d": "damping per unit inertia [1/s]",
    "integral_max": "saturation of the integrator [m s, rad s or N s, Nm s]",
    "F_ref": "set-point of the wrench on the environment, in F [N, Nm]",
    "F_meas": "measured wrench of robot on environment, in F [N, Nm]",
    "K_fp": "proportional gain of force [1]",
    "K_fi": "integral gain of force [1/s]",
    "damping": "velocity damping along the rows of A [1/s]",
    "ramp": "fastest change of the set-point [N/s, Nm/s]",
    "cutoff": "cut-off of the filter on what is measured [Hz]",
    "M_v": "virtual mass [kg, kg m^2]",
    "B_v": "virtual damping [N s/m, Nm s/rad]",
    "K_v": "virtual stiffness [N/m, Nm/rad]",
    "q_ref": "posture to lean towards [rad or m]",
    "R_WE": "orientation of the plane in W, column by column; z points into it [1]",
    "X_WE": "pose of the environment in W: R_WE column by column, then p [1, m]",
    "X_shift": "displacement of the environment in W: R column by column, then p [1, m]",
    "V_env": "its body twist (v, w) [m/s, rad/s]",
    "V_dot_env": "derivative of that twist's components [m/s^2, rad/s^2]",
    "A": "Pfaffian rows on the twist [1]",
    "A_dot_V": "derivative of A times the twist [m/s^2, rad/s^2]",
    "v_c": "velocity of the environment along the rows [m/s, rad/s]",
    "v_c_dot": "acceleration of the environment along the rows [m/s^2, rad/s^2]",
    "c_des": "desired centre of mass in W [m]",
    "c_dot_des": "its velocity [m/s]",
    "c_ddot_des": "its acceleration [m/s^2]",
    "h_des": "desired momentum about the centre of mass, axes of W [kg m/s, kg m^2/s]",
    "h_dot_des": "its rate [N, Nm]",
    "K": "rate at which an error of the momentum decays [1/s]",
    "f_ref": "set-point of the internal force [N]",
    "f_meas": "measured internal force [N]",
    "r": "moment about the normal per normal force [m]",
    "half": "half the length and width of the footprint [m]",
    "limit": "highest force along the normal [N]",
}
"""By the last part of the input's name; an input that is not here is shown by its shape alone."""


def meaning(name: str) -> str:
    """Return what the input ``owner.name`` is; empty where that is not known."""
    owner, _, last = name.rpartition(".")
    if last == "mu" and owner:
        return "coefficient of friction [1]"
    return MEANINGS.get(last, "")


def owners(mode: Mode) -> dict[str, str]:
    """Return, for each owner of inputs in a mode, what it is and in which axes it works."""
    found = {"": "loop", "limits": "limits of the robot, one number a joint or actuator"}
    for task, _, _ in mode.tasks:
        found[task.name] = f"task {task.name}: {_axes(task.space)}"
    for constraint in mode.constraints:
        rows = ", ".join(constraint.row_names)
        found[constraint.name] = (
            f"constraint {constraint.name}, rows {rows}: {_axes(constraint.space)}"
        )
    for limit in mode.contact_limits:
        found[limit.name] = f"contact limit {limit.name}: {_axes(limit.space)}"
    return found | {"slack": "slack of the constraints"}


def demanded(mode: Mode) -> tuple[str, ...]:
    """Return the inputs without which a mode must not be entered.

    They are those of tasks that need a reference, but for the parameters of these tasks, which
    have values of their own.
    """
    return tuple(
        f"{task.name}.{key}"
        for task, _, _ in mode.tasks
        if task.needs_reference
        for key in task.inputs()
        if not hasattr(task, key)
    )


def _axes(space: TaskSpace | None) -> str:
    return f"frame {space.frame}, axes {' '.join(space.axes)}" if space else "joints"
