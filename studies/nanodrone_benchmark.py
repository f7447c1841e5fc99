"""The nano-drone benchmark: half a second of open-loop prediction on flights of an unseen kind."""

from dataclasses import replace

from bench.experiment.config import RunConfig, Training
from bench.experiment.grid import effort, grid
from bench.experiment.study import Study
from registry.contracts import Dataset
from registry.datasets.nanodrone import Nanodrone

LOAD = "Load hybrid: 1x24"
HISTORY = 50
"""Samples that the load hybrid reads; the other models read 10."""
SIZES = {"smoke": ("1x10", "20x10"), "laptop": ("1x50", "100x10"), "paper": ("4x200", "5000x10")}
"""Networks, MLP initializers."""
TRAINING = Training(
    updates=600, batch=512, learning_rate=6e-3, final_rate=0.01, weight_decay=0.05, clip=2.0, evaluate_every=100
)
"""Of the load hybrid, chosen with the random flights left out of training."""
BASELINES = ("constant", "linear", "physics")


def runs(preset: str, dataset: Dataset) -> list[RunConfig]:
    """The published kinds of models and the load hybrid, judged at every start and step h = 1 .. 50 of 10 ms."""
    size, mlp = SIZES[preset]
    networks = [f"{p}: {size} - MLP: {mlp}" for p in ("Cascade", "Hybrid")]
    both = [dataset.predicted_together()]
    spent = {"smoke": effort(2, 40), "laptop": effort(3, 800), "paper": effort(3, 30_000)}[preset]
    spent = replace(spent, test_stride=50 if preset == "smoke" else 1)
    own = spent if preset == "smoke" else replace(spent, training=TRAINING)
    made = grid((*networks, *BASELINES), dataset, {50: spent}, both)
    return made + [replace(run, history=HISTORY) for run in grid((LOAD,), dataset, {50: own}, both)]


STUDY = Study(
    name="nanodrone_benchmark",
    title="the nano-drone benchmark: 0.5 s of velocity and body rates on flights of an unseen kind",
    question=(
        "The benchmark compares physics, an MLP, an LSTM and a physics-plus-residual hybrid on melon, a trajectory "
        "that no model was trained on. The goal is one recurrent model that beats every published row and the linear "
        "baseline, in velocity and in body rates."
    ),
    source=Nanodrone.source,
    default_dataset="nanodrone",
    runs=runs,
    pairs=(
        ("Load hybrid: *", "linear"),
        ("Load hybrid: *", "physics"),
        ("Load hybrid: *", "Hybrid: * - MLP: *"),
        ("Load hybrid: *", "Cascade: * - MLP: *"),
        ("Hybrid: * - MLP: *", "Cascade: * - MLP: *"),
        ("linear", "constant"),
    ),
    paper_says=(
        "Mean Euclidean error summed over h = 1 .. 50: velocity 38.92 m/s (constant), 10.62 (physics), 12.58 (MLP), "
        "10.40 (hybrid), 16.72 (LSTM); body rates 29.09 rad/s (constant and physics, which holds them), 35.57 (MLP), "
        "28.99 (hybrid), 35.84 (LSTM).\n"
        "The goal here: at most 6.5 m/s and 18.5 rad/s. Hybrid and Cascade are this suite's own, not the benchmark's."
    ),
    presets={
        "smoke": "tiny networks, 40 updates, every 50th start: seconds, for tests",
        "laptop": "1x50, 800 updates; the load hybrid 600 of 512 windows; three seeds: minutes on two cores",
        "paper": "4x200, MLP 5000, 30,000 updates, beside the same load hybrid; three seeds: weeks on two cores",
    },
)
