"""No answer hangs on the last digits: of copies of one signal the same is chosen, and numbers stay as they are."""

import warnings

import numpy as np
import torch

from bench.diagnose.regression.generic import Folds, follow


def shaken(values, seed):
    """With each number off by some 1e-12 of itself."""
    noise = torch.randn(values.shape, generator=torch.Generator().manual_seed(seed), dtype=values.dtype)
    return values * (1 + 1e-12 * noise)


def test_of_two_copies_of_a_signal_the_same_is_taken_whatever_the_rounding():
    rng = np.random.default_rng(0)
    signal, other = rng.normal(size=(2, 4000))
    copies = np.stack([signal + 1e-6 * rng.normal(size=4000) for _ in range(6)], axis=1)
    rows = torch.from_numpy(np.c_[copies, other, signal + 0.3 * other + 0.1 * rng.normal(size=4000)])
    picks = []
    for seed in range(20):
        folds = [x.T @ x for x in np.array_split(shaken(rows, seed).numpy(), 4)]
        # What products in another order would make of them.
        picks.append(
            [c for c, _ in follow(Folds.of([g * (1 + 1e-9 * rng.normal(size=g.shape)) for g in folds], []), 0, 2)]
        )
    assert picks == [[0, 6]] * 20


def test_a_number_of_which_noise_leaves_less_than_nothing_is_passed_over_in_silence():
    """Its column, with the noise of the inputs taken off, has a negative square; what is kept is never divided by."""
    gram = np.diag([-1e9, 4.0, 9.0])
    gram[1, 2] = gram[2, 1] = 5.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert [c for c, _ in follow(Folds.of([gram, gram], [0]), 1, 2)] == [1]
