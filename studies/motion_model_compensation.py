"""The motion model's own error before and after compensation (paper, figure MM_Dis)."""

from bench.experiment.config import RunConfig
from bench.experiment.grid import attainable, grid, horizons, regularized
from bench.experiment.study import Study
from registry.contracts import Dataset
from studies.quadrotor_hybrid import SIZES


def runs(preset: str, dataset: Dataset) -> list[RunConfig]:
    """The hybrid, whose motion model is judged before its error is compensated, and the physics alone.

    Trained with the state-initialization cost (β = 1) and without: because the motion model starts from the measured
    state, the cost asks for an output model that compensates nothing at first.
    """
    size, mlp = SIZES[preset]
    both = [dataset.predicted_together()]
    hybrids = (f"Hybrid: {size} - {initializer}: {mlp}" for initializer in ("MLP", "MLP no L_si"))
    specs = (*hybrids, "physics", "constant", *attainable(dataset))
    made = grid(specs, dataset, horizons(preset), both)
    return regularized(made) if preset == "paper" else made


STUDY = Study(
    name="motion_model_compensation",
    title="the motion model inside the hybrid: its error before and after compensation",
    question=(
        "The paper finds that the motion model's error starts away from zero, which the output model must compensate "
        "from the first step on: hence its states need initialization."
    ),
    source='section "Hybrid Model of the Quadrotor", figure MM_Dis',
    default_dataset="pelican_twin",
    runs=runs,
    pairs=(("Hybrid: * - MLP*: *", "physics"), ("Hybrid: * - MLP no L_si: *", "Hybrid: * - MLP: *")),
    contrasts=(("velocity", "velocity_uncompensated"), ("body_rates", "body_rates_uncompensated")),
    paper_says=(
        "Mean errors of the motion model's output and of the compensated output: the uncompensated error is larger and "
        "not zero at the first step."
    ),
    presets={
        "smoke": "tiny networks, 40 updates, T = 5: seconds, for tests",
        "laptop": "1x50 in place of 4x200; the runs of quadrotor_hybrid again",
        "evening": "1x50 in place of 4x200; the runs of quadrotor_hybrid again",
        "paper": "4x200, MLP 5000; the runs of quadrotor_hybrid again",
    },
)
