"""One joint in the inner tick: its loops, winding, rotor, gear and spring, as expressions.

Electrics exactly, mechanics semi-implicitly, Coulomb friction as the set-valued law that it is:
the rotor sticks until more than the break-away torque pulls at it.
"""

from collections.abc import Mapping

import casadi as ca

from qpctrl.spatial import SX
from scenarios.actuator.drive import JointDrive

STOP_STIFFNESS = 1e8
"""Of a hard stop [Nm/rad]: metal on metal."""

SAFE_MOBILITY = 2.0
"""Times the mobility of a joint that it is taken to have: up to this, the joints beside it may
add to what it has alone."""


class Joint:
    """The expressions of one joint, in the order in which a step computes them."""

    def __init__(
        self, drive: JointDrive, step: float, p: Mapping[str, SX], noise: Mapping[str, SX]
    ) -> None:
        self._drive, self._h, self._p, self._noise = drive, step, p, noise
        self._rigid = drive.rigid

    def step(self, x: Mapping[str, SX], tau_cmd: SX, q: SX, v: SX) -> dict[str, SX]:
        """Return the next state, the torque on the joint [Nm] and the voltage [V]."""
        p, h = self._p, self._h
        theta, omega = (q, v) if self._rigid else (x["theta"], x["omega"])
        twist = self._twist(theta - q)
        rate = omega - v
        twist_torque = self._twist_torque(x, twist, rate)
        measured = self._measured_torque(x, twist_torque, twist, q)
        wanted, torque_integral, asked_too_much = self._torque_loop(x, tau_cmd, measured, omega)
        winding = self._winding(x, wanted / p["k_t"], omega)
        if self._rigid:
            # the rotor is part of the joint's own inertia: see the plant's armature
            friction, bristle = self._rigid_friction(x["bristle"], omega)
            tau = p["k_t"] * winding["mean"] - friction
            delivered, omega_next = tau, omega
        else:
            tau = twist_torque
            omega_next, bristle = self._rotor(x, p["k_t"] * winding["mean"], twist_torque)
            inertial = p["J"] / (1 + p["K_p"]) * (omega_next - omega) / h
            delivered = tau + inertial  # as for who takes the apparent inertia for the joint's
        reading = measured if self._drive.has_torque_loop else p["k_t"] * winding["reading"]
        return {
            "current": winding["current"],
            "integral": winding["integral"],
            "theta": theta + h * omega_next,
            "omega": omega_next,
            "torque": reading,
            "torque_integral": torque_integral,
            "bristle": bristle,
            "rate": rate,
            "carried": tau,
            "delivered": x["delivered"] + delivered,
            "limited": x["limited"] + ca.fmax(asked_too_much, winding["limited"]),
            "tau": tau,
            "voltage": winding["voltage"],
        }

    def _twist(self, way: SX) -> SX:
        """Return how far gear, sensor and spring are twisted [rad]: what is left after the play."""
        half = self._p["half_play"]
        return way - ca.fmin(ca.fmax(way, -half), half)

    def _twist_torque(self, x: Mapping[str, SX], twist: SX, rate: SX) -> SX:
        """Return the torque [Nm] that gear, sensor and spring carry from motor to joint.

        Linearly implicit, so that nothing is too stiff for the step: the damper sees the mean rate
        of the step, the hard stop the twist at its end. Without them the rate changes by h e, as it
        did in the last step, and τ changes it by −h y τ; y is the mobility between motor and joint.
        """
        if self._rigid:
            return ca.SX(0)
        p, h = self._p, self._h
        y = 1 / p["J"] + SAFE_MOBILITY * p["mobility"]
        h_e = rate - x["rate"] + h * y * x["carried"]
        D, stop, past = p["d"], ca.SX(0), ca.SX(0)
        if self._drive.gear.backlash:
            D *= twist != 0
        if self._drive.spring:
            ahead = twist + h * (rate + h_e)
            past = ahead - ca.fmin(ca.fmax(ahead, -p["hard_stop"]), p["hard_stop"])
            stop = STOP_STIFFNESS * (past != 0)
        tau = p["k"] * twist + D * (rate + h_e / 2) + STOP_STIFFNESS * past
        return tau / (1 + h * y * (D / 2 + h * stop))

    def _measured_torque(self, x: Mapping[str, SX], tau: SX, twist: SX, q: SX) -> SX:
        """Return the filtered reading [Nm] of a strain gauge, or of the two ends of a spring."""
        p = self._p
        if self._drive.spring:
            near = _rounded(q, p["count"])
            far = _rounded(q + p["k"] / p["spring"] * twist, p["count"])
            reading = p["spring"] * (far - near)
        else:
            reading = tau + p["bias"] + p["torque_noise"] * self._noise["torque"]
            reading = _rounded(reading, p["torque_resolution"])
        return x["torque"] + p["alpha"] * (reading - x["torque"])

    def _torque_loop(
        self, x: Mapping[str, SX], tau_cmd: SX, measured: SX, omega: SX
    ) -> tuple[SX, SX, SX]:
        """Return torque wanted of the motor [Nm], the integral [Nm s], whether it is too much."""
        p, h = self._p, self._h
        slides = ca.tanh(omega / (3 * p["stribeck_speed"]))
        wanted = tau_cmd + p["feedforward"] * (p["coulomb"] * slides + p["viscous"] * omega)
        integral = x["torque_integral"]
        most = p["k_t"] * p["peak_current"]
        if self._drive.has_torque_loop:
            error, rate = tau_cmd - measured, (measured - x["torque"]) / h
            wanted += p["K_p"] * error + p["K_i"] * integral - p["K_d"] * rate
            winds_up = ca.logic_and(ca.fabs(wanted) > most, wanted * error > 0)
            integral += ca.if_else(winds_up, 0, h * error)
        return ca.fmin(ca.fmax(wanted, -most), most), integral, ca.fabs(wanted) > most

    def _winding(self, x: Mapping[str, SX], wanted: SX, omega: SX) -> dict[str, SX]:
        """Return current, its mean in the step, its reading, the voltage and the loop's integral.

        PI by pole placement: the zero of the controller cancels the winding's pole.
        """
        p = self._p
        reading = _rounded(
            x["current"] + p["current_noise"] * self._noise["current"], p["current_resolution"]
        )
        error, back = wanted - reading, p["k_t"] * omega
        asked = p["K_u"] * error + x["integral"] + back
        voltage = ca.fmin(ca.fmax(asked, -p["voltage"]), p["voltage"])
        limited = asked != voltage
        winds_up = ca.logic_and(limited, asked * error > 0)
        steady = (voltage - back) / p["R"]
        return {
            "current": steady + p["decay"] * (x["current"] - steady),
            "mean": steady + p["share"] * (x["current"] - steady),
            "integral": x["integral"] + ca.if_else(winds_up, 0, p["K_u_i"] * error),
            "reading": reading,
            "voltage": voltage,
            "limited": limited,
        }

    def _rotor(self, x: Mapping[str, SX], motor: SX, load: SX) -> tuple[SX, SX]:
        """Return speed [rad/s] and twist of the bristles [rad] after the step."""
        p, h, omega = self._p, self._h, x["omega"]
        level = self._level(omega)
        lossy = p["load_friction"] * ca.fabs(load)
        inertia = p["J"] + h * p["viscous"]
        bristle = x["bristle"]
        if self._drive.friction.bristle_stiffness:
            stretch = p["sigma_0"] * ca.fabs(omega) / ca.fmax(level, 1e-12)
            bristle = (bristle + h * omega) / (1 + h * stretch)
            rate = (bristle - x["bristle"]) / h
            load += p["sigma_0"] * bristle + p["sigma_1"] * rate
            level = ca.SX(0)
        free = (p["J"] * omega + h * (motor - load)) / inertia
        stops = h * (level + lossy) / inertia
        return free - ca.fmin(ca.fmax(free, -stops), stops), bristle

    def _rigid_friction(self, bristle: SX, v: SX) -> tuple[SX, SX]:
        """Return friction [Nm] of a joint without a rotor of its own, and the twist that holds it.

        What else pulls at the joint is not known here, so what sticks is held by bristles that
        are as stiff as the step allows: they neither creep nor swing.
        """
        p, h = self._p, self._h
        stops = 1 / (h * (p["mobility"] + 1e-9))  # Nm s/rad: stops it in a step
        level = self._level(v)
        most = 4 * h * level / stops
        bristle = ca.fmin(ca.fmax(bristle + h * v, -most), most)
        held = stops * (bristle / (4 * h) + v / 2)
        return ca.fmin(ca.fmax(held, -level), level) + p["viscous"] * v, bristle

    def _level(self, omega: SX) -> SX:
        """Return g(ω) [Nm]."""
        p = self._p
        rest = p["static"] - p["coulomb"]
        return p["coulomb"] + rest * ca.exp(-((omega / p["stribeck_speed"]) ** 2))


def _rounded(value: SX, step: SX) -> SX:
    return ca.if_else(step > 0, step * ca.floor(value / ca.fmax(step, 1e-300) + 0.5), value)
