"""A signal through a second- or first-order low-pass filter, and what the filter does when nobody drives it."""

from dataclasses import dataclass

import numpy as np
import scipy  # scipy.signal is imported when it is used: it takes longer than all else here


@dataclass(frozen=True)
class Pole:
    """Where the poles of a hidden mode are."""

    frequency: float
    """ω/2π [Hz]; of what relaxes 1/(2πT)."""
    damping: float
    """ζ; not looked at of what relaxes."""
    order: int
    """2: it swings, 1: it relaxes."""

    def turned(self, t: np.ndarray) -> np.ndarray:
        """e^{At} (n, order, order) at times (n,) [s], for the states z and ż/ω."""
        turn = 2 * np.pi * self.frequency
        if self.order == 1:
            return np.exp(-turn * t)[:, None, None]
        root = (1 - self.damping**2) ** 0.5
        c, s = np.cos(turn * root * t), np.sin(turn * root * t) / root
        rows = [[c + self.damping * s, s], [-s, c - self.damping * s]]
        out: np.ndarray = np.exp(-self.damping * turn * t)[:, None, None] * np.array(rows).transpose(2, 0, 1)
        return out

    def response(self, driver: np.ndarray, step: float) -> list[np.ndarray]:
        """What a unit of each gain does, [z − d, ż/ω] or [z − d], each (J, m), begun at rest.

        Args:
            driver: d (J, m), straight lines between its samples.
            step: from one to the next [s].
        """
        moved = driver - driver[0]
        step_matrix, now, then = _held(self, step)
        # One recursion for each state: its denominator is the characteristic polynomial of the step.
        denominator = np.poly(step_matrix) if self.order == 2 else np.array([1.0, -step_matrix[0, 0]])
        states = []
        for i in range(self.order):
            numerator = np.zeros(self.order + 1)
            if self.order == 1:
                numerator[:2] = then[0], now[0]
            else:
                # x = (zI − F)⁻¹ (z then + now) d, with adj(zI − F) = zI − adj'(F).
                adjugate = np.array([[step_matrix[1, 1], -step_matrix[0, 1]], [-step_matrix[1, 0], step_matrix[0, 0]]])
                numerator[:] = then[i], now[i] - (adjugate @ then)[i], -(adjugate @ now)[i]
            states.append(scipy.signal.lfilter(numerator, denominator, moved, axis=0))
        states[0] = states[0] - moved
        return states


def _held(pole: Pole, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """F (order, order), and what a driver does now and a step later (order,), linear between the two."""
    turn = 2 * np.pi * pole.frequency
    rates = np.array([[0.0, turn], [-turn, -2 * pole.damping * turn]]) if pole.order == 2 else np.array([[-turn]])
    matrix = pole.turned(np.array([step]))[0]
    steady = np.eye(pole.order)[:, 0]  # of a driver of one
    # Of a driver that ramps from 0 to 1 within the step: x(h) = steady − A⁻¹ (F − I) steady / h … with the sign of A.
    ramp = steady + np.linalg.solve(rates, (np.eye(pole.order) - matrix) @ steady) / step
    return matrix, (np.eye(pole.order) - matrix) @ steady - ramp, ramp
