"""Error over the horizon of the helicopter's black-box models (paper, figure HeliMeanCompare)."""

from bench.experiment.config import RunConfig
from bench.experiment.grid import attainable, grid, horizons, regularized
from bench.experiment.study import Study
from registry.contracts import Dataset
from studies.mlp_vs_rnn_init import BASELINES, architectures


def runs(preset: str, dataset: Dataset) -> list[RunConfig]:
    """The four architectures on each signal of the chain: velocity and rotational rates."""
    problems = [(signal,) for signal in dataset.predicted_together()]
    made = grid((*architectures(preset), *BASELINES, *attainable(dataset)), dataset, horizons(preset), problems)
    return regularized(made) if preset == "paper" else made


STUDY = Study(
    name="helicopter_black_box",
    title="black-box models of the helicopter: mean error of every step, velocity and rotational rates",
    question=(
        "The paper finds that the mean error grows steadily over 0.4 s, that over 1.9 s it peaks early and then falls, "
        "and that delay lines with RNN initializers generally do best on the longer horizon."
    ),
    source='section "Black-box Modeling of the Helicopter", figure HeliMeanCompare',
    default_dataset="helicopter_twin",
    runs=runs,
    pairs=(
        ("LSTM TDL: * - RNN: *", "LSTM: * - MLP: *"),
        ("LSTM TDL: * - MLP: *", "LSTM: * - MLP: *"),
        ("LSTM: * - RNN: *", "LSTM: * - MLP: *"),
    ),
    paper_says=(
        "Mean of the error distribution at every step: rising at 0.4 s; at 1.9 s a peak in the early steps, "
        "attenuated later, less consistently for the rates."
    ),
    presets={
        "smoke": "tiny networks, 40 updates, T = 5: seconds, for tests",
        "laptop": "2x50 in place of 7x200; 2,000 updates at T = 40, 1,000 at T = 190, three seeds",
        "evening": "2x50, initializers of as many weights; 12,000 updates, at T = 190 8,000: two hours",
        "paper": "7x200, MLP 15000, RNN 2500; tiny weights, decay, dropout; 30,000 updates: days on a GPU",
    },
)
