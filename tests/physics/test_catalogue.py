"""The equations of the catalogue written down again in plain numpy, each effect alone and all of them at once."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from registry.core import EFFECTS
from registry.physics.quadrotor import Quadrotor

F64 = torch.float64
HUBS = np.array([[0.2, 0.01, 0.03], [-0.02, 0.21, 0.02], [-0.19, 0.0, 0.04], [0.01, -0.2, 0.03]])
SPIN = np.array([1.0, -1.0, 1.0, -1.0])
K_F, K_M, RADIUS, RHO, G = 9.9865e-6, 1.5978e-7, 0.127, 1.2, 9.81
MASS, INERTIA, GROUND = 1.0, (0.01, 0.012, 0.02), 0.05
BATTERY, TIME = 3.5, 40.0

SCALING = ("thrust_scale", "unequal_rotors", "worn_rotors", "battery_sag", "vortex_ring_state")
AIR = ("rotor_drag", "linear_drag", "parasitic_drag", "translational_lift", "inflow_thrust_loss", "ground_effect")
TURNING = ("blade_flapping", "rotor_gyroscopic_torque", "rotor_reaction_torque", "cog_offset", "rotational_damping")
OTHER = (
    "torque_bias",
    "rotor_misalignment",
    "inertia_products",
    "mass",
    "torque_scale",
    "suspended_load",
    "munk_moment",
    "recorded_point",
)
IDS = (*SCALING, *AIR, *TURNING, *OTHER)
ELSEWHERE = {"wind", "motor_lag", "input_delay"}
LEARNED = {"hidden_mode", "learned_term", "periodic_term"}
"""Which have no equation of their own."""


def catalogue(effects, state, speeds, slopes, wind, battery):
    """dx/dt (17,) with the load's swing at its end; ``effects``: {id: {parameter: value}}."""
    e3, p = np.array([0.0, 0.0, 1.0]), effects.get
    rotation, v, w, swing = Rotation.from_quat(state[6:10]).as_matrix(), state[3:6], state[10:13], state[13:]
    arm = np.array([*e.values()]) if (e := p("recorded_point")) else np.zeros(3)
    v_b = rotation.T @ (v - wind) - np.cross(w, arm)
    place = state[:3] - rotation @ arm
    hubs = HUBS
    if e := p("cog_offset"):
        hubs = HUBS - np.array([e["x"], e["y"], 0])
    v_hub = [v_b + np.cross(w, r) for r in hubs]

    thrust = K_F * speeds**2
    if e := p("thrust_scale"):
        thrust = thrust * (1 + e["eps"])
    if e := p("unequal_rotors"):
        thrust = thrust * [1 + e[f"eps_{i}"] for i in (1, 2, 3, 4)]
    drag = K_M * speeds**2
    if e := p("worn_rotors"):
        left = np.array([1 + e[f"eps_{i}"] for i in (1, 2, 3, 4)])
        thrust, drag = thrust * left, drag * left
    if e := p("battery_sag"):
        thrust = thrust * (1 + e["slope"] * (BATTERY - e["reference"]) if battery else 1 - e["rate"] * TIME)
    if e := p("vortex_ring_state"):
        x = max(-v_b[2] / np.sqrt(thrust.sum() / (2 * RHO * np.pi * RADIUS**2 * 4)), 0)
        thrust = thrust * (1 - e["a"] * x * np.exp(-(((x - 1) / 0.35) ** 2)))

    hub = [t * e3 for t in thrust]  # force at each hub
    force, torque = np.zeros(3), (SPIN * drag).sum() * e3
    for i in range(4):
        if e := p("rotor_drag"):
            hub[i] = hub[i] - e["k_d"] * speeds[i] * (v_hub[i] * [1, 1, 0])
        if e := p("translational_lift"):
            hub[i] = hub[i] + e["k_h"] * (v_hub[i][0] ** 2 + v_hub[i][1] ** 2) * e3
        if e := p("inflow_thrust_loss"):
            hub[i] = hub[i] - e["k_z"] * speeds[i] * v_hub[i][2] * e3
        if e := p("ground_effect"):
            height = max((place + rotation @ hubs[i])[2] - GROUND, 1.2 * RADIUS * np.sqrt(e["c"]) / 4)
            hub[i] = hub[i] + (thrust[i] / (1 - e["c"] * (RADIUS / (4 * height)) ** 2) - thrust[i]) * e3
        if e := p("blade_flapping"):
            torque = torque - e["k_flap"] * speeds[i] * np.cross(v_hub[i], e3)
    torque = torque + sum(np.cross(r, f) for r, f in zip(hubs, hub, strict=True))
    force = force + sum(hub)
    if e := p("linear_drag"):
        force = force - np.diag([e["d_x"], e["d_y"], e["d_z"]]) @ v_b
    if e := p("parasitic_drag"):
        force = force - np.diag([e["c_x"], e["c_y"], e["c_z"]]) @ v_b * np.linalg.norm(v_b)
    if e := p("rotor_misalignment"):
        force = force + thrust.sum() * np.array([e["a_y"], -e["a_x"], 0])
    if e := p("rotor_gyroscopic_torque"):
        torque = torque + e["rotor_inertia"] * (SPIN * speeds).sum() * np.cross(w, e3)
    if e := p("rotor_reaction_torque"):
        torque = torque + e["rotor_inertia"] * (SPIN * slopes).sum() * e3
    if e := p("rotational_damping"):
        torque = torque - np.array([e["d_x"], e["d_y"], e["d_z"]]) * w
    if e := p("torque_bias"):
        torque = torque + np.array([e["t_x"], e["t_y"], e["t_z"]])
    if e := p("munk_moment"):
        torque = torque + v_b[2] * np.array([-e["m_x"] * v_b[1], e["m_y"] * v_b[0], 0])

    mass, inertia = MASS, np.diag(INERTIA)
    if e := p("mass"):
        mass = mass + e["delta"]
    if e := p("inertia_products"):
        xy, xz, yz = e["J_xy"], e["J_xz"], e["J_yz"]
        inertia = inertia + np.array([[0, xy, xz], [xy, 0, yz], [xz, yz, 0]])
    acceleration, swinging = rotation @ force / mass - G * e3, []
    if e := p("suspended_load"):
        theta, rate = swing[:2], swing[2:]
        square = G / e["l"] * (1 + e["m_l"] / mass)
        swinging = [rate, -square * theta - acceleration[:2] / e["l"] - 2 * e["zeta"] * np.sqrt(square) * rate]
        down = e["carried"] * (acceleration[2] + G) * mass * e["m_l"] / (mass + e["m_l"])
        pull = np.array([*(e["m_l"] * G * theta), -down / e["carried"]])
        acceleration = acceleration + np.array([*pull[:2], -down]) / mass
        torque = torque + np.cross([0, 0, e["height"]], rotation.T @ pull)
    if e := p("torque_scale"):
        torque = torque * [1 + e["eps_x"], 1 + e["eps_y"], 1 + e["eps_z"]]
    spin = np.linalg.solve(inertia, torque - np.cross(w, inertia @ w))
    acceleration = acceleration + rotation @ (np.cross(spin, arm) + np.cross(w, np.cross(w, arm)))
    x, y, z, s = state[6:10]
    turning = 0.5 * np.array([[s, -z, y], [z, s, -x], [-y, x, s], [-x, -y, -z]]) @ w
    return np.concatenate([v, acceleration, turning, spin, *swinging])


def both(chosen, seed, wind=(0.0, 0.0), battery=True):
    """The derivative by the catalogue, by the model, and by the model without effects, at a random state."""
    rng = np.random.default_rng(seed)
    values = {
        name: {
            q.name: q.typical * (rng.uniform(0.5, 1.5) if q.uncertainty else 1)
            for q in EFFECTS.get(name).typical().parameters()
        }
        for name in chosen
    }
    tilt = Rotation.from_rotvec(rng.uniform(-0.3, 0.3, 3)).as_quat()
    pose = [*rng.normal(0, 1, 2), 0.2, *rng.normal(0, 2, 2), -3.5, *tilt, *rng.normal(0, 2, 3)]  # low, in descent
    swing = rng.normal(0, 0.1, 4 if "suspended_load" in chosen else 0)
    state = np.array([*pose, *swing])
    speeds, slopes = rng.uniform(350, 650, 4), rng.normal(0, 300, 4)
    expected = catalogue(values, state, speeds, slopes, np.array([*wind, 0.0]), battery)
    effects = [EFFECTS.get(name)(**values[name]) for name in chosen]
    if any(wind):
        effects.append(EFFECTS.get("wind")(w_x=wind[0], w_y=wind[1]))
    constants = {"inertia": INERTIA, "ground_z": GROUND, "rotor_positions": tuple(map(tuple, HUBS.tolist()))}
    signals, more = (("battery", "time"), [BATTERY, TIME]) if battery else (("time",), [TIME])
    inputs, rates = (torch.tensor([*x, *more], dtype=F64) for x in (speeds, slopes))
    full = Quadrotor(effects=tuple(effects), extras=signals, **constants)
    found = full.derivative(torch.tensor(state, dtype=F64), inputs, rates).numpy()
    bare = Quadrotor(extras=signals, **constants).derivative(torch.tensor(pose, dtype=F64), inputs, rates).numpy()
    return expected, found, bare


def test_the_catalogue_is_complete():
    quadrotor = {n for n in EFFECTS.names() if EFFECTS.get(n).suits(Quadrotor)}
    assert {*IDS, *ELSEWHERE} == quadrotor - LEARNED


@pytest.mark.parametrize("name", IDS)
def test_alone(name):
    for seed in range(3):
        expected, found, bare = both([name], seed)
        np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-11)
        assert np.abs(found[:13] - bare).max() > 1e-4, "the case must show the effect"


def test_battery_sag_with_time_alone():
    expected, found, bare = both(["battery_sag"], 0, battery=False)
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-11)
    assert np.abs(found - bare).max() > 0.1


@pytest.mark.parametrize("wind", [(0.0, 0.0), (2.0, -1.5)])
def test_all_at_once(wind):
    for seed in range(3):
        expected, found, _ = both(IDS, seed, wind)
        np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10)
