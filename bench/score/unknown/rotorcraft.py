"""Flights by RotorPy with something in them that no catalogue has."""

import numpy as np

from bench.score import case as first
from bench.score.case import Columns
from bench.score.multirotor import flights, hidden, references
from bench.score.multirotor.flights import Array, Moment
from bench.score.multirotor.measure import multiply
from bench.score.unknown.condition import UnknownCase


class StrangeMultirotor(hidden.HiddenMultirotor):
    """A multirotor on which hidden terms act, and a wave with a phase of its own in every flight (B,)."""

    def __init__(self, case: UnknownCase, phases: Array) -> None:
        super().__init__(first.parameters(case), first.all_effects(case), first.surroundings(case), first.charges(case))
        self.terms, self.phases = case.terms, phases
        self.wave = (case.wave_axis, case.swing[0], case.swing[1] * self.mass * self.g)

    def _followed(self, now: Moment) -> dict[str, Array]:
        """Signals that terms may follow (B,)."""
        place, velocity, rates = now.state[0:3], now.state[3:6], now.state[10:13]
        out = {"position.x": place[0], "position.y": place[1], "height": place[2], "time": now.t}
        out["thrust"] = self.thrust(now).sum(0)
        out |= {f"velocity.{a}": velocity[i] for i, a in enumerate("xyz")}
        out |= {f"body_velocity.{a}": now.air[i] for i, a in enumerate("xyz")}
        out |= {f"body_rates.{a}": rates[i] for i, a in enumerate("pqr")}
        return out

    def _pushes(self, now: Moment, prefix: str) -> Array:
        """All terms along axes called ``prefix`` + x, y, z: (3, B)."""
        out = np.zeros((3, now.state.shape[1]))
        mine = [t for t in self.terms if t.axis[:-1] == prefix]
        if mine:
            followed = self._followed(now)
            for term in mine:
                out["xyz".index(term.axis[-1])] += term.at(followed)
        axis, frequency, size = self.wave
        if axis[:-1] == prefix:
            out["xyz".index(axis[-1])] += size * np.cos(2 * np.pi * frequency * now.t + self.phases)
        return out

    def world_force(self, now: Moment) -> Array:
        """Of `hidden.HiddenMultirotor`, and the hidden terms along axes of the world [N]."""
        return np.asarray(super().world_force(now) + self._pushes(now, "world_force_"))

    def wrench(self, now: Moment) -> tuple[Array, Array]:
        """Force and torque (3, B), body frame, hidden terms included."""
        force, torque = super().wrench(now)
        return force + self._pushes(now, "force_"), torque + self._pushes(now, "torque_")


def logs(case: UnknownCase) -> list[Columns]:
    """Fly ``case`` and log it: a dictionary of columns a recording."""
    vehicle, parameters = first.VEHICLES[case.vehicle], first.parameters(case)
    rng = np.random.default_rng([case.flight_seed, 7])
    craft = StrangeMultirotor(case, rng.uniform(-np.pi, np.pi, case.recordings))
    commanded = case.drive == "rotor_command"
    stiff, damp = first.SLOW_GAINS if commanded else vehicle.gains
    parameters |= {"kp_att": np.full(3, stiff), "kd_att": np.full(3, damp), "mass": craft.mass, "k_eta": craft.k_eta}
    seconds, lowest = case.seconds + flights.WARM_UP, vehicle.lowest + (first.CLEARANCE if commanded else 0.0)
    wanted = [
        references.reference(np.random.default_rng([case.flight_seed, 2, i]), case.style, seconds, flights.STEP, lowest)
        for i in range(case.recordings)
    ]
    effects = first.all_effects(case)
    air = hidden.wind(rng, effects, 2 * len(wanted[0]) - 1, case.recordings, flights.STEP / 2)
    motors = hidden.motors(effects, case.drive, parameters["tau_m"])
    every = flights.EVERY if commanded else 1
    flown = flights.fly(craft, flights.Pilot(parameters), motors, np.stack(wanted, axis=2), air, every)
    return [_twisted(case, log) for log in first.clean(case, flown)]


def _twisted(case: UnknownCase, log: Columns) -> Columns:
    """What sensors show of attitude and rates that are turned about body z."""
    if not case.twist:
        return log
    c, s = np.cos(case.twist), np.sin(case.twist)
    half = np.array([[0.0, 0.0, np.sin(case.twist / 2), np.cos(case.twist / 2)]])
    attitude = multiply(log["attitude"], np.repeat(half, len(log["t"]), axis=0))
    p, q, r = log["body_rates"].T
    return log | {"attitude": attitude, "body_rates": np.stack([c * p + s * q, c * q - s * p, r], axis=1)}
