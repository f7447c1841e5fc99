"""Masses on springs and quadrotors that MuJoCo moves, each with something hidden: folders as a user would bring them.

`pip install mujoco`, `python tests/mujoco_machines.py DIR [NAME ...]`, then `bench diagnose DIR/NAME`. The simulator
shares nothing with this project: its integrators, friction, limits, actuators and fluid forces are its own.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from simulated_folders import QUADROTOR, describe, describe_quadrotor, save, tracking

MASS, DAMPING, STIFFNESS = 2.0, 1.5, 80.0
"""Of the masses on springs [kg], [N s/m], [N/m]."""
SPRING = f'stiffness="{STIFFNESS}" damping="{DAMPING}"'
MACHINES: dict[str, dict[str, str]] = {
    "nothing": {},
    "coulomb": {"joint": 'frictionloss="1.2"'},
    "slope": {"gravity": "-.35 0 0"},
    "drag": {"option": 'density="400"'},
    "lag": {"motor": '<general joint="q" dyntype="filter" dynprm=".04" gainprm="1"/>'},
    "saturation": {"motor": '<motor joint="q" forcelimited="true" forcerange="-7 7"/>'},
    "stop": {"joint": 'range="-.12 .12" limited="true" solreflimit="-4000 -40"'},
}
"""What is hidden: attributes of the joint, the options or the actuator that the description does not state."""

WEIGHT, INERTIA, ARM, K_F, K_M = 1.1, (0.0085, 0.0092, 0.0155), 0.17, 9.5e-6, 1.6e-7
"""Of the quadrotors [kg], [kg m²], [m], [N s²], [N m s²]."""
HUBS, SPINS = [(ARM, -ARM, 0), (-ARM, -ARM, 0), (-ARM, ARM, 0), (ARM, ARM, 0)], [1.0, -1.0, 1.0, -1.0]
HOVER = np.full(4, (WEIGHT * 9.81 / 4 / K_F) ** 0.5)
AIR = 'density="1.2" viscosity="0.00002"'
VEHICLES: dict[str, dict[str, Any]] = {
    "hover_nothing": {},
    "hover_heavier": {"mass": 1.25 * WEIGHT},
    "hover_cog": {"centre": ".012 -.007 0"},
    "hover_worn": {"worn": (1.0, 0.9, 1.0, 1.0)},
    "hover_fluid": {"fluid": 'fluidshape="ellipsoid" fluidcoef="1 .25 1.5 0 0"', "option": AIR},
    "hover_wind": {"fluid": 'fluidshape="ellipsoid" fluidcoef="2 .25 1.5 0 0"', "option": f'{AIR} wind="4 -2 0"'},
}


def machine(folder: Path, steps: bool, rate: int, seed: int, joint: str = "", gravity: str = "0 0 0", option: str = "",
            motor: str = '<motor joint="q"/>') -> None:  # fmt: skip
    """Five recordings of 12 s of a mass of 2 kg, driven by tones that are linear between samples, or by held steps."""
    body = (
        f'<joint name="q" type="slide" axis="1 0 0" {SPRING} {joint}/><geom type="box" size=".1 .1 .05" mass="{MASS}"/>'
    )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="0.0005" integrator="implicitfast" gravity="{gravity}" {option}/>'
        f"<worldbody><body>{body}</body></worldbody><actuator>{motor}</actuator></mujoco>"
    )
    random, fine, t = np.random.default_rng(seed), round(1 / rate / 0.0005), np.arange(12 * rate + 1) / rate
    for run in range(5):
        tones = zip(random.uniform(0.2, 3.0, 5), random.uniform(0, 6.28, 5), strict=True)
        force = 3.2 * sum(np.sin(2 * np.pi * f * t + p) for f, p in tones)
        if steps:
            force = np.repeat(random.uniform(-12, 12, len(t)), round(0.4 * rate))[: len(t)]
        data, rows = mujoco.MjData(model), []
        for now, after, when in zip(force, force[1:], t, strict=False):
            rows.append((when, data.qpos[0], data.qvel[0], now))
            for k in range(fine):
                data.ctrl[0] = now if steps else now + (after - now) * k / fine
                mujoco.mj_step(model, data)
        table = np.array(rows)
        table[:, 1:3] += random.normal(size=(len(table), 2)) * (2e-4, 3e-3)
        save(folder, run, table, "t,x,v,f")
    signals = {"displacement": ('"x"', "m", ""), "speed": ('"v"', "m/s", ""), "force": ('"f"', "N", "")}
    physics = {"mass": MASS, "damping": DAMPING, "stiffness": STIFFNESS}
    hold = "previous" if steps else "linear"
    describe(folder, "oscillator", rate, drive="force", hold=hold, signals=signals, physics=physics)


def vehicle(folder: Path, seed: int, mass: float = WEIGHT, centre: str = "0 0 0", fluid: str = "", option: str = "",
            worn: tuple[float, ...] = (1.0,) * 4) -> None:  # fmt: skip
    """Six flights of 20 s at 100 Hz along sums of sines; a controller at 500 Hz knows the stated vehicle."""
    sites = "".join(f'<site name="s{i}" pos="{x} {y} {z}"/>' for i, (x, y, z) in enumerate(HUBS))
    motors = "".join(f'<motor site="s{i}" gear="0 0 1 0 0 {s * K_M / K_F}"/>' for i, s in enumerate(SPINS))
    inertia = " ".join(map(str, INERTIA))
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="0.001" integrator="RK4" {option}/><worldbody><body pos="0 0 3"><freejoint/>'
        f'<inertial pos="{centre}" mass="{mass}" diaginertia="{inertia}"/><geom type="ellipsoid" size=".2 .2 .06" '
        f'contype="0" conaffinity="0" {fluid}/>{sites}</body></worldbody><actuator>{motors}</actuator></mujoco>'
    )
    random = np.random.default_rng(seed)
    for run in range(6):
        data, rows, speed, pilot = mujoco.MjData(model), [], HOVER, piloted(random)
        for k in range(20_000):
            t = k * 1e-3
            if k % 2 == 0:
                speed = pilot(data, t)
            if k % 10 == 0:
                rows.append([*sensed(data, t, random), *speed])
            data.ctrl[:] = K_F * speed**2 * worn
            mujoco.mj_step(model, data)
        save(folder, run, np.array(rows), QUADROTOR)
    described(folder)


def described(folder: Path) -> None:
    """Write what is stated of the quadrotor."""
    describe_quadrotor(
        folder, 100, "linear", mass=WEIGHT, inertia=list(INERTIA), thrust_coefficient=K_F, torque_coefficient=K_M,
        rotor_positions=HUBS, rotor_directions=SPINS, rotor_radius=0.12,
    )  # fmt: skip


def sensed(data: Any, t: float, random: np.random.Generator) -> list[float]:
    """Columns of `QUADROTOR` before the rotor speeds, with noise."""
    seen = data.qpos[:3] + 1e-3 * random.normal(size=3), data.qvel[:3] + 5e-3 * random.normal(size=3)
    return [t, *seen[0], *seen[1], *data.qpos[3:7], *data.qvel[3:6] + 8e-3 * random.normal(size=3)]


def piloted(random: np.random.Generator) -> Callable[[Any, float], np.ndarray]:
    """Rotor speeds (4,) [rad/s] that follow a path of sums of sines, of the simulator's data and the time."""
    x, y, _ = zip(*HUBS, strict=True)
    mixed = np.linalg.inv(np.array([[1.0] * 4, y, [-v for v in x], [s * K_M / K_F for s in SPINS]]))
    turn, phase = 2 * np.pi * random.uniform(0.1, 0.5, (3, 3)), random.uniform(0, 6.28, (3, 3))
    size, yaw = np.array([[0.8], [0.8], [0.4]]) * random.uniform(0.4, 1, (3, 3)), random.uniform(0.05, 0.2)

    def command(data: Any, t: float) -> np.ndarray:
        s, c = np.sin(turn * t + phase), np.cos(turn * t + phase)
        path = np.add((size * (s - np.sin(phase))).sum(1), (0, 0, 3))
        return controlled(data, path, (size * turn * c).sum(1), -(size * turn**2 * s).sum(1), yaw * t, mixed)

    return command


def controlled(data: Any, path: Any, pace: Any, bend: Any, turns: float, mixed: np.ndarray) -> np.ndarray:
    """Rotor speeds (4,) [rad/s] that `tracking` asks for."""
    flat = np.zeros(9)
    mujoco.mju_quat2Mat(flat, data.qpos[3:7])
    heading = 0.6 * np.sin(2 * np.pi * turns)
    off, faster = path - data.qpos[:3], pace - data.qvel[:3]
    now, rates = flat.reshape(3, 3), data.qvel[3:6]
    thrust, torque = tracking(now, off, faster, bend, heading, rates, WEIGHT, np.array(INERTIA))
    return np.asarray(np.sqrt(np.clip(mixed @ (thrust, *torque), 0.15, 12) / K_F))


def main(folder: Path, names: list[str]) -> None:
    """Write what was asked for, or all: machines twice, driven by tones and by steps."""
    for i, (name, hidden) in enumerate(MACHINES.items()):
        for steps, rate in ((False, 50), (True, 200)):
            of = f"{name}_{'steps' if steps else 'tones'}"
            if not names or of in names:
                machine(folder / of, steps, rate, 100 + i, **hidden)
    for i, (name, hidden) in enumerate(VEHICLES.items()):
        if not names or name in names:
            vehicle(folder / name, 200 + i, **hidden)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
