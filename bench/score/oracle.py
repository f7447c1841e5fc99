"""How much of the error of a forecast each effect makes: the true vehicle flown on without it, from true states."""

import numpy as np

from bench.score.case import Case, all_effects, charges, nominal_parameters, parameters, surroundings
from bench.score.multirotor.flights import RATE, Array, Truth
from bench.score.multirotor.hidden import HiddenMultirotor, motors

HORIZON = 0.5
"""[s]."""
EVERY = 25
"""Samples between the starts of two windows."""
GROUPS = {"velocity": slice(3, 6), "body_rates": slice(10, 13)}


def forecast(case: Case, truth: Truth, removed: tuple[str, ...] = (), constants: str = "true") -> tuple[Array, Array]:
    """Forecasts and truth (T, 13, windows) over `HORIZON` from true states with true inputs, sampled at 100 Hz.

    Args:
        case: tells the vehicle.
        truth: its flights.
        removed: effects that the forecast does without.
        constants: "true", or "nominal" as the user is given them.
    """
    steps, dt = round(HORIZON * RATE), 1 / RATE
    effects = {k: v for k, v in all_effects(case).items() if k not in removed}
    starts = np.arange(0, len(truth.state) - steps - 1, EVERY)
    flights = truth.state.shape[2]
    k, b = (x.ravel() for x in np.meshgrid(starts, np.arange(flights), indexing="ij"))
    base = parameters(case) if constants == "true" else nominal_parameters(case)
    craft = HiddenMultirotor(base, effects, surroundings(case), charges(case)[b])
    turn = motors(effects, case.drive, base["tau_m"])
    wind = truth.wind - truth.wind
    if "gusts" in effects:
        wind = truth.wind.copy()
        if "wind" in removed:
            gone = all_effects(case)["wind"]
            wind[:, 0] -= gone["w_x"]
            wind[:, 1] -= gone["w_y"]
    elif "wind" in effects:
        wind[:, 0], wind[:, 1] = effects["wind"]["w_x"], effects["wind"]["w_y"]
    state = truth.state[k, : 13 + craft.own_states, b].T
    speed, out, true = truth.speed[k, :, b].T, [], []
    past = 6  # samples that the longest delay reaches back to
    history = [truth.command[np.maximum(k + j, 0), :, b].T for j in range(-past, steps + 1)]
    for j in range(steps):
        if case.drive == "rotor_speed":
            first, last = truth.speed[k + j, :, b].T, truth.speed[k + j + 1, :, b].T
            speeds, spins = [first, (first + last) / 2, last], [(last - first) / dt] * 3
        else:
            speeds, spins = turn.turn(speed, turn.delayed(history, (j + past) * dt, dt, dt), dt)
            speed = speeds[2]
        here, there = wind[k + j, :, b].T, wind[k + j + 1, :, b].T
        state = craft.step((k + j) * dt, state, speeds, spins, [here, (here + there) / 2, there], dt)
        out.append(state[:13])
        true.append(truth.state[k + j + 1, :13, b].T)
    return np.stack(out), np.stack(true)


def rmse(case: Case, truth: Truth, removed: tuple[str, ...] = (), constants: str = "true") -> dict[str, float]:
    """Root mean square error of velocity [m/s] and body rates [rad/s] over all steps of `forecast`, Euclidean."""
    out, true = forecast(case, truth, removed, constants)
    return {name: float(np.sqrt(((out - true)[:, at] ** 2).sum(1).mean())) for name, at in GROUPS.items()}


def scaled_square(case: Case, truth: Truth, removed: tuple[str, ...] = (), constants: str = "true") -> float:
    """Mean square error of velocity and body rates, each of the six over its standard deviation in the flights."""
    out, true = forecast(case, truth, removed, constants)
    outputs = np.r_[3:6, 10:13]
    scale = truth.state[:, outputs].std(axis=(0, 2))
    return float((((out - true)[:, outputs] / scale[:, None]) ** 2).mean())


def shares(case: Case, truth: Truth) -> dict[str, float]:
    """Of each hidden effect: (E²_without it − E²_true) / (E²_base model with nominal constants − E²_true)."""
    full = scaled_square(case, truth)
    whole = scaled_square(case, truth, tuple(case.effects), "nominal") - full
    return {name: (scaled_square(case, truth, (name,)) - full) / whole for name in case.effects}
