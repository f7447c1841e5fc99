"""Other people's libraries, trained their own way on the training part of a run, for a processor time.

deepSI's SUBNET and tsfast's recurrent network, each with the defaults of its library but for what the benchmark says:
the samples before a simulation, and windows as long as everybody's. Both are in the extra `peers`.
"""

import contextlib
import io
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import torch

from bench.experiment.config import RunConfig
from bench.experiment.seeds import derive
from bench.training.split import choose_split, load, of_parts

Signals = tuple[np.ndarray, np.ndarray]
"""Inputs (N, m) and outputs (N, n), SI."""
Errors = dict[str, float | None]
EVERY = 25
"""Updates between two looks at the clock and at the validation part, which count."""
ENOUGH = 10_000_000
"""Updates that no budget allows."""


os.environ["TQDM_DISABLE"] = "1"


class Spent(KeyboardInterrupt):
    """The processor time is over: a stop by hand, which deepSI takes as the end of its training."""


def parts(config: RunConfig) -> tuple[list[Signals], list[Signals], dict[str, Signals]]:
    """Stretches that train, stretches that validate, and whole test recordings by name, as all others have them."""
    recordings, split = load(config.dataset).recordings, choose_split(config)
    train, validation, _ = of_parts(recordings, [r.valid for r in recordings], split)
    signals = {r.name: (r.pick(config.inputs)[0], r.pick(config.outputs)[0]) for r in recordings}

    def cut(masks: tuple[np.ndarray, ...]) -> list[Signals]:
        found = zip(recordings, masks, strict=True)
        return [(signals[r.name][0][mask], signals[r.name][1][mask]) for r, mask in found if mask.any()]

    return cut(train), cut(validation), {name: signals[name] for name in split.test}


def channels(config: RunConfig) -> tuple[str, ...]:
    """Names of what is predicted."""
    return tuple(c.name for c in load(config.dataset).recordings[0].pick(config.outputs)[1])


def judged(test: dict[str, Signals], tau: int, outputs: tuple[str, ...], simulate: Callable[..., np.ndarray]) -> Errors:
    """√(mean e²) of each channel over all of a test recording but its first τ samples, SI."""
    errors: Errors = {}
    for name, (u, y) in test.items():
        e = np.sqrt(np.square(simulate(u, y)[tau:] - y[tau:], dtype=np.float64).mean(0))
        errors |= {f"{c}@{name}": float(x) if np.isfinite(x) else None for c, x in zip(outputs, e, strict=True)}
    return errors


def deepsi_subnet(config: RunConfig, budget: float) -> tuple[float, int, Errors]:
    """CPU seconds, updates and simulation errors of `deepSI.SUBNET`, the weights of the best simulated validation."""
    import deepSI
    from deepSI import fitting

    train, validation, test = parts(config)
    tau, shortest = config.tau, min(len(u) for u, _ in validation)

    def wrapped(pairs: list[Signals], length: int | None = None) -> list[object]:
        return [fitting.Input_output_data(u=u[:length], y=y[:length]) for u, y in pairs]

    torch.manual_seed(derive(config.seed, "weights"))
    nu, ny, norm = deepSI.get_nu_ny_and_auto_norm(wrapped(train))
    model = deepSI.SUBNET(nu, ny, norm, na=tau, nb=tau)
    begun, updates = time.process_time(), 0

    def cost(*batch: object) -> torch.Tensor:
        nonlocal updates
        if time.process_time() - begun > budget:
            raise Spent
        updates += 1
        return fitting.compute_NMSE(*batch)

    with tempfile.TemporaryDirectory() as place, contextlib.redirect_stdout(io.StringIO()):
        fitting.get_checkpoint_dir = lambda: place + os.sep
        samples = sum(len(u) - tau - config.horizon + 1 for u, _ in train)
        deepSI.fit(
            model,
            wrapped(train),
            wrapped(validation, shortest),
            n_its=ENOUGH,
            T=config.horizon,
            batch_size=min(256, samples),
            val_freq=EVERY,
            loss_fun=cost,
        )
    spent = time.process_time() - begun

    def simulate(u: np.ndarray, y: np.ndarray) -> np.ndarray:
        arrays, _ = model.create_arrays(fitting.Input_output_data(u=u, y=y), T="sim")
        with torch.no_grad():  # as its own `simulate`, which takes no more than one input or output
            return np.concatenate([y[:tau], model(*(a.contiguous() for a in arrays))[0].numpy()])

    return spent, updates, judged(test, tau, channels(config), simulate)


def tsfast_gru(config: RunConfig, budget: float) -> tuple[float, int, Errors]:
    """CPU seconds, updates and simulation errors of `tsfast.RNNLearner`, the last weights."""
    from tsfast.training.learners import RNNLearner
    from tsfast.training.schedulers import sched_flat_cos
    from tsfast.tsdata import create_dls

    train, validation, test = parts(config)
    tau, updates = config.tau, 0
    columns = [f"u{i}" for i in range(train[0][0].shape[1])], [f"y{i}" for i in range(train[0][1].shape[1])]
    torch.manual_seed(derive(config.seed, "weights"))
    with tempfile.TemporaryDirectory() as place:
        files = {k: _written(Path(place), k, p, columns) for k, p in (("train", train), ("valid", validation))}
        loaders = create_dls(*columns, files, win_sz=tau + config.horizon)
        learner = RNNLearner(loaders, n_skip=tau, device=torch.device("cpu"), show_bar=False)
        begun = time.process_time()

        def rate(_: int) -> float:
            nonlocal updates
            share = (time.process_time() - begun) / budget
            if share > 1:
                raise Spent
            updates += 1
            return sched_flat_cos(share)

        with contextlib.suppress(Spent):
            learner.fit(ENOUGH, scheduler_fn=lambda optimizer, _: torch.optim.lr_scheduler.LambdaLR(optimizer, rate))
        spent = time.process_time() - begun
    model = learner.model.eval()

    def simulate(u: np.ndarray, y: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            found = model(torch.from_numpy(u).float().unsqueeze(0))
        return (found[0] if isinstance(found, tuple) else found).squeeze(0).numpy()

    return spent, updates, judged(test, tau, channels(config), simulate)


def _written(folder: Path, part: str, pairs: list[Signals], columns: tuple[list[str], list[str]]) -> list[str]:
    """Files in the library's own format."""
    made = []
    for i, pair in enumerate(pairs):
        file = folder / part / f"{i}.hdf5"
        file.parent.mkdir(exist_ok=True)
        with h5py.File(file, "w") as content:
            for names, values in zip(columns, pair, strict=True):
                for name, column in zip(names, values.T, strict=True):
                    content[name] = column.astype(np.float32)
        made.append(str(file))
    return made


LIBRARIES: dict[str, tuple[str, Callable[[RunConfig, float], tuple[float, int, Errors]]]] = {
    "deepSI SUBNET": ("deepSI", deepsi_subnet),
    "tsfast GRU": ("tsfast", tsfast_gru),
}
"""Row → module, and what trains and judges it."""
