"""Quadrotors that Bullet moves, each with something hidden: folders as a user would bring them.

`pip install pybullet`, `python tests/bullet_vehicles.py DIR [NAME ...]`, then `bench diagnose DIR/NAME`. Bullet moves
bodies as it moves a game: velocity first, then the place by the new velocity, and forces that are given in the frame of
a rotor act along where that was a step before. Vehicle, drag and ground effect are those of gym-pybullet-drones.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pybullet
from simulated_folders import GRAVITY, QUADROTOR, describe_quadrotor, save, tracking

MASS, INERTIA, K_F, K_M = 0.027, (1.4e-5, 1.4e-5, 2.17e-5), 2.8816e-8, 7.2404e-10
"""Of a Crazyflie [kg], [kg m²], [N s²], [N m s²]."""
HUBS = [(0.028, -0.028, 0), (-0.028, -0.028, 0), (-0.028, 0.028, 0), (0.028, 0.028, 0)]
SPINS, RADIUS = [-1.0, 1.0, -1.0, 1.0], 0.0231
STEP, EVERY, SECONDS = 1 / 240, 2, 20
"""Between two commands and two steps [s]; steps from one sample to the next."""
VEHICLES: dict[str, dict[str, Any]] = {
    "bullet_nothing": {},
    "bullet_damping": {"damping": 0.04},
    "bullet_drag": {"drag": (9.1785e-7, 9.1785e-7, 10.311e-7)},
    "bullet_ground": {"ground": 11.37, "height": 0.2},
    "bullet_all": {"damping": 0.04, "drag": (9.1785e-7, 9.1785e-7, 10.311e-7)},
}
"""What is hidden: Bullet's own damping, d (1 + |v|) m v and d (1 + |ω|) I ω; drag [kg/rad] along world axes
times the sum of the rotor speeds; a rotor's thrust times 1 + c (r / 4 h)²."""


def flown(folder: Path, seed: int, damping: float = 0.0, drag: tuple[float, ...] = (0.0,) * 3, ground: float = 0.0,
          height: float = 1.5) -> None:  # fmt: skip
    """Six flights along sums of sines, logged at 120 Hz, of which every second command is filed."""
    x, y, _ = zip(*HUBS, strict=True)
    mixed = np.linalg.inv(np.array([[1.0] * 4, y, [-v for v in x], [s * K_M / K_F for s in SPINS]]))
    random = np.random.default_rng(seed)
    for run in range(6):
        world = pybullet.connect(pybullet.DIRECT)
        pybullet.setGravity(0, 0, -GRAVITY, physicsClientId=world)
        pybullet.setTimeStep(STEP, physicsClientId=world)
        body = vehicle(world, damping, height)
        turn, phase = 2 * np.pi * random.uniform(0.1, 0.45, (3, 3)), random.uniform(0, 6.28, (3, 3))
        size = np.array([[0.6], [0.6], [0.05 if ground else 0.3]]) * random.uniform(0.4, 1, (3, 3))
        yaw = random.uniform(0.05, 0.2)
        rows = []
        for k in range(round(SECONDS / STEP)):
            t = k * STEP
            place, quaternion = map(np.array, pybullet.getBasePositionAndOrientation(body, world))
            velocity, spin = map(np.array, pybullet.getBaseVelocity(body, world))
            turned = np.array(pybullet.getMatrixFromQuaternion(quaternion)).reshape(3, 3)
            s, c = np.sin(turn * t + phase), np.cos(turn * t + phase)
            path = np.add((size * (s - np.sin(phase))).sum(1), (0, 0, height))
            off, pace, bend = path - place, (size * turn * c).sum(1) - velocity, -(size * turn**2 * s).sum(1)
            heading, rates = 0.6 * np.sin(2 * np.pi * yaw * t), turned.T @ spin
            thrust, torque = tracking(turned, off, pace, bend, heading, rates, MASS, np.array(INERTIA))
            speed = np.sqrt(np.clip(mixed @ (thrust, *torque), 0.02, 0.15) / K_F)
            if k % EVERY == 0:
                seen = place + 1e-3 * random.normal(size=3), velocity + 5e-3 * random.normal(size=3)
                rows.append(
                    [t, *seen[0], *seen[1], *np.roll(quaternion, 1), *rates + 8e-3 * random.normal(size=3), *speed]
                )
            pushed(world, body, speed, ground)
            pull = turned.T @ (-np.array(drag) * speed.sum() * velocity)
            pybullet.applyExternalForce(body, 4, pull.tolist(), [0, 0, 0], pybullet.LINK_FRAME, world)
            pybullet.stepSimulation(world)
        pybullet.disconnect(world)
        save(folder, run, np.array(rows), QUADROTOR)
    describe_quadrotor(
        folder, round(1 / STEP / EVERY), "previous", mass=MASS, inertia=list(INERTIA), thrust_coefficient=K_F,
        torque_coefficient=K_M, rotor_positions=HUBS, rotor_directions=SPINS, rotor_radius=RADIUS,
    )  # fmt: skip


def vehicle(world: int, damping: float, height: float) -> int:
    """A body with four rotors and its middle as links without mass."""
    links, places = 5, [*(list(map(float, h)) for h in HUBS), [0.0, 0.0, 0.0]]
    none, level = [-1] * links, [[0.0, 0.0, 0.0, 1.0]] * links
    body: int = pybullet.createMultiBody(
        MASS, basePosition=[0, 0, height], linkMasses=[0.0] * links, linkCollisionShapeIndices=none,
        linkVisualShapeIndices=none, linkPositions=places, linkOrientations=level,
        linkInertialFramePositions=[[0.0] * 3] * links, linkInertialFrameOrientations=level,
        linkParentIndices=[0] * links, linkJointTypes=[pybullet.JOINT_FIXED] * links, linkJointAxis=[[0, 0, 1]] * links,
        physicsClientId=world,
    )  # fmt: skip
    pybullet.changeDynamics(
        body, -1, localInertiaDiagonal=INERTIA, linearDamping=damping, angularDamping=damping, physicsClientId=world
    )
    return body


def pushed(world: int, body: int, speed: np.ndarray, ground: float) -> None:
    """Let the rotors push and turn the body, each in its own frame."""
    frames = pybullet.getLinkStates(body, [0, 1, 2, 3], physicsClientId=world)
    for i, frame in enumerate(frames):
        force = K_F * speed[i] ** 2 * (1 + ground * (RADIUS / (4 * max(frame[0][2], 0.03))) ** 2)
        pybullet.applyExternalForce(body, i, [0, 0, force], [0, 0, 0], pybullet.LINK_FRAME, world)
    turning = K_M * float(np.dot(SPINS, speed**2))
    pybullet.applyExternalTorque(body, 4, [0, 0, turning], pybullet.LINK_FRAME, world)


if __name__ == "__main__":
    for i, (name, hidden) in enumerate(VEHICLES.items()):
        if len(sys.argv) < 3 or name in sys.argv[2:]:
            flown(Path(sys.argv[1]) / name, 300 + i, **hidden)
