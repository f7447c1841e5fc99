"""Quadrotors that MuJoCo puts together of bodies: rotors that spin, a box off the centre.

`pip install mujoco`, `python tests/mujoco_assemblies.py DIR [NAME ...]`, then `bench diagnose DIR/NAME`. No effect is
written down here: what rotors do by their inertia, where the centre of gravity lies, and how its frame moves about it
follow from the multibody dynamics of the simulator. Vehicle, flights and controller are those of `mujoco_machines`.
"""

import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco_machines import HOVER, HUBS, INERTIA, K_F, K_M, SPINS, WEIGHT, described, piloted, sensed
from simulated_folders import QUADROTOR, save

STEP, LAG = 1e-3, 0.03
"""Of the integration, and time constant of the motors [s]."""
ROTOR_MASS, BOX_AT, BOX = 0.01, (0.03, -0.02, -0.05), (5e-4, 4e-4, 3e-4)
"""[kg]; where the box is [m] and its moments of inertia over its mass [m²]."""
ASSEMBLIES: dict[str, dict[str, float]] = {
    "bodies_nothing": {},
    "bodies_rotors": {"rotor": 9e-5},
    "bodies_box": {"box": 0.1},
    "bodies_rotors_box": {"rotor": 9e-5, "box": 0.1},
}
"""What nobody states: a rotor's moment of inertia about its axis [kg m²], and the mass of a box [kg]."""


def assembled(rotor: float, box: float) -> Any:
    """The model; where rotors spin, the rest has what they lack of the stated mass and inertia."""
    sites = "".join(f'<site name="s{i}" pos="{x} {y} {z}"/>' for i, (x, y, z) in enumerate(HUBS))
    each, bodies = ROTOR_MASS if rotor else 0.0, ""
    inertia = np.array(INERTIA) - sum(each * np.array([y * y, x * x, x * x + y * y]) for x, y, _ in HUBS)
    inertia[:2] -= 2 * rotor
    gears = [0.0 if rotor else s * K_M / K_F for s in SPINS]
    motors = "".join(f'<motor site="s{i}" gear="0 0 1 0 0 {g}"/>' for i, g in enumerate(gears))
    if rotor:
        bodies += "".join(
            f'<body pos="{x} {y} {z}"><joint name="j{i}" type="hinge" axis="0 0 1"/>'
            f'<inertial pos="0 0 0" mass="{each}" diaginertia="{rotor / 2} {rotor / 2} {rotor}"/></body>'
            for i, (x, y, z) in enumerate(HUBS)
        )
        motors += "".join(f'<motor joint="j{i}"/>' for i in range(4))
    if box:
        bodies += (
            f'<body pos="{" ".join(map(str, BOX_AT))}"><inertial pos="0 0 0" mass="{box}" '
            f'diaginertia="{" ".join(str(box * k) for k in BOX)}"/></body>'
        )
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{STEP}" integrator="RK4"/><worldbody><body pos="0 0 3"><freejoint/><inertial '
        f'pos="0 0 0" mass="{WEIGHT - 4 * each}" diaginertia="{" ".join(map(str, inertia))}"/>{sites}{bodies}</body>'
        f"</worldbody><actuator>{motors}</actuator></mujoco>"
    )


def flown(folder: Path, seed: int, rotor: float = 0.0, box: float = 0.0) -> None:
    """Six flights of 20 s, logged at 100 Hz; a controller at 500 Hz knows the stated vehicle."""
    model, spins = assembled(rotor, box), np.array(SPINS)
    random = np.random.default_rng(seed)
    for run in range(6):
        data, rows, speed, command, pilot = mujoco.MjData(model), [], HOVER, HOVER, piloted(random)
        if rotor:
            data.qvel[6:10] = -spins * speed
        for k in range(20_000):
            t = k * STEP
            if k % 2 == 0:
                command = pilot(data, t)
            if rotor:  # it spins the other way round than its torque turns the vehicle
                speed = -spins * data.qvel[6:10]
                data.ctrl[4:] = -spins * (rotor / LAG * (command - speed) + K_M * speed**2)
                data.xfrc_applied[2:6, 3:] = np.outer(spins * K_M * speed**2, data.xmat[1].reshape(3, 3)[:, 2])
            else:
                speed = speed + (command - speed) * -np.expm1(-STEP / LAG)
            if k % 10 == 0:
                rows.append([*sensed(data, t, random), *speed + 0.5 * random.normal(size=4)])
            data.ctrl[:4] = K_F * speed**2
            mujoco.mj_step(model, data)
        save(folder, run, np.array(rows), QUADROTOR)
    described(folder)


if __name__ == "__main__":
    for i, (name, hidden) in enumerate(ASSEMBLIES.items()):
        if len(sys.argv) < 3 or name in sys.argv[2:]:
            flown(Path(sys.argv[1]) / name, 400 + i, **hidden)
