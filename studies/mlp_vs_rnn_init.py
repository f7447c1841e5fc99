"""MLP against RNN initializers (paper, section "MLP vs RNN Initializers", figure HeliSizeCompareEuler)."""

from bench.experiment.config import RunConfig
from bench.experiment.grid import attainable, grid, horizons, regularized
from bench.experiment.study import Study
from registry.contracts import Dataset

SIZES = {
    "smoke": ("1x10", "20x10", "10x10"),
    "laptop": ("2x50", "200x10", "60x10"),
    "evening": ("2x50", "200x10", "92x10"),
    "paper": ("7x200", "15000x10", "2500x10"),
}
"""Predictor, MLP initializer, RNN initializer. The laptop's RNN has half the weights of its MLP (the paper's: three
quarters); the evening's has as many."""
BASELINES = ("constant", "linear")


def architectures(preset: str) -> tuple[str, ...]:
    """LSTM and LSTM TDL, each with both initializers, at the sizes of the preset."""
    size, mlp, rnn = SIZES[preset]
    return tuple(f"{p}: {size} - {i}" for p in ("LSTM", "LSTM TDL") for i in (f"MLP: {mlp}", f"RNN: {rnn}"))


def runs(preset: str, dataset: Dataset) -> list[RunConfig]:
    """The four architectures, inputs → all targets of the data at once: of vehicles the three rotational rates."""
    made = grid(
        (*architectures(preset), *BASELINES, *attainable(dataset)), dataset, horizons(preset), [dataset.predicted()]
    )
    return regularized(made) if preset == "paper" else made


STUDY = Study(
    name="mlp_vs_rnn_init",
    title="MLP against RNN initializers, LSTM with and without delay lines, inputs to three rotational rates",
    question=(
        "The paper finds that four large architectures predict the rates alike, that RNN initializers are better on "
        "longer horizons, and that delay lines help."
    ),
    source='section "MLP vs RNN Initializers", figure HeliSizeCompareEuler',
    default_dataset="helicopter_twin",
    runs=runs,
    pairs=(
        ("LSTM: * - RNN: *", "LSTM: * - MLP: *"),
        ("LSTM TDL: * - RNN: *", "LSTM TDL: * - MLP: *"),
        ("LSTM TDL: * - MLP: *", "LSTM: * - MLP: *"),
        ("LSTM TDL: * - RNN: *", "LSTM: * - RNN: *"),
    ),
    paper_says="Total RMSSE of the Euler rates at 0.4 s and 1.9 s: the four trained models behave similarly.",
    presets={
        "smoke": "tiny networks, 40 updates, T = 5: seconds, for tests",
        "laptop": "2x50 in place of 7x200; 2,000 updates at T = 40, 1,000 at T = 190, three seeds",
        "evening": "2x50, initializers of as many weights; 12,000 updates, at T = 190 8,000: two hours",
        "paper": "7x200, MLP 15000, RNN 2500; tiny weights, decay, dropout; 30,000 updates: days on a GPU",
    },
)
