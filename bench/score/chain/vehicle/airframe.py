"""Vehicles: what they weigh, where their rotors are and how far one built specimen differs from the drawing."""

from dataclasses import dataclass, replace

import numpy as np

Array = np.ndarray
GRAVITY, AIR_DENSITY = 9.81, 1.2


@dataclass(frozen=True)
class Airframe:
    """A quadrotor of rotors 1 to 4: front left, front right, rear right, rear left. SI."""

    mass: float
    inertia: tuple[float, float, float]
    thrust: float
    """k_f: thrust over rotor speed squared [N s²]."""
    drag: float
    """k_m: reaction torque over rotor speed squared [N m s²]."""
    hubs: tuple[tuple[float, float], ...]
    """(x, y) from the centre of gravity [m]."""
    turns: tuple[int, ...]
    """Sign of each rotor's reaction torque about body z."""
    radius: float
    """Of a rotor [m]."""
    power: float
    """Greatest thrust over hover thrust."""

    @property
    def hover(self) -> float:
        """Rotor speed that carries the weight [rad/s]."""
        return float(np.sqrt(self.mass * GRAVITY / 4 / self.thrust))


AIRFRAMES = {
    "survey": Airframe(
        mass=0.50,
        inertia=(3.4e-3, 4.1e-3, 6.6e-3),
        thrust=5.9e-6,
        drag=1.3e-7,
        hubs=((0.105, 0.125), (0.105, -0.125), (-0.135, -0.11), (-0.135, 0.11)),
        turns=(1, -1, 1, -1),
        radius=0.10,
        power=2.4,
    ),
    "racer": Airframe(
        mass=0.82,
        inertia=(2.3e-3, 2.9e-3, 4.4e-3),
        thrust=1.55e-6,
        drag=2.2e-8,
        hubs=((0.092, 0.115), (0.092, -0.115), (-0.092, -0.115), (-0.092, 0.115)),
        turns=(-1, 1, -1, 1),
        radius=0.066,
        power=4.5,
    ),
    "nano": Airframe(
        mass=0.036,
        inertia=(1.7e-5, 1.8e-5, 2.9e-5),
        thrust=2.4e-8,
        drag=1.6e-10,
        hubs=((0.0325, 0.0325), (0.0325, -0.0325), (-0.0325, -0.0325), (-0.0325, 0.0325)),
        turns=(1, -1, 1, -1),
        radius=0.024,
        power=1.9,
    ),
    "carrier": Airframe(
        mass=1.52,
        inertia=(2.7e-2, 3.1e-2, 5.3e-2),
        thrust=6.1e-6,
        drag=9.5e-8,
        hubs=((0.14, 0.21), (0.14, -0.21), (-0.12, -0.19), (-0.12, 0.19)),
        turns=(-1, 1, -1, 1),
        radius=0.125,
        power=2.6,
    ),
}
"""Four of them, two with front and rear arms of their own. Chosen between vehicle files that are public."""
BUILD = 0.08
"""Relative range within which a specimen's constants lie about the drawing's."""


def specimen(rng: np.random.Generator, name: str) -> Airframe:
    """One vehicle as it was built."""
    drawn, (mass, x, y, z, thrust, drag) = AIRFRAMES[name], (1 + rng.uniform(-BUILD, BUILD, 6)).tolist()
    inertia = (drawn.inertia[0] * x, drawn.inertia[1] * y, drawn.inertia[2] * z)
    return replace(
        drawn,
        mass=drawn.mass * mass,
        inertia=inertia,
        thrust=drawn.thrust * thrust,
        drag=drawn.drag * drag,
    )
