"""Error against number of weights, MLFC and LSTM (paper, section "MLFC vs. LSTM", figure HeliSizeCompare)."""

from bench.experiment.config import RunConfig
from bench.experiment.grid import attainable, grid, horizons
from bench.experiment.study import Study
from registry.contracts import Dataset

SIZES = ("1x50 - MLP: 60x10", "2x50 - MLP: 100x10", "2x100 - MLP: 200x10")
"""Of MLFCs and their initializers."""
ARCHITECTURES = (
    *(f"MLFC: {size}" for size in SIZES),
    *(f"MLFC A_o: {size}" for size in SIZES),
    "MLFC serial: 2x50 - MLP: 100x10",
    "LSTM: 1x50 - MLP: 60x10",
    "LSTM: 2x50 - MLP: 100x10",
)
"""The read-out of an MLFC with A_o = 0 and, as the paper's equation has it, free: both are shown. One MLFC has its
layers in series, which tells what skip connections are worth."""
BASELINES = ("constant", "linear")


def runs(preset: str, dataset: Dataset) -> list[RunConfig]:
    """The architectures on each target channel, a MISO problem of its own."""
    axes = [(channel,) for channel in dataset.predicted_channels()]
    return grid((*ARCHITECTURES, *BASELINES, *attainable(dataset)), dataset, horizons(preset, 5), axes)


STUDY = Study(
    name="mlfc_vs_lstm",
    title="MLFC against LSTM, five sizes, error against number of weights, three rotational rates",
    question="The paper finds that LSTMs with fewer weights predict better than MLFCs with more.",
    source='section "MLFC vs. LSTM", figure HeliSizeCompare',
    default_dataset="helicopter_twin",
    runs=runs,
    pairs=(
        *((f"LSTM: {size} - *", f"{mlfc}: *") for size in ("1x50", "2x50") for mlfc in ("MLFC", "MLFC A_o")),
        *((f"MLFC A_o: {size}", f"MLFC: {size}") for size in SIZES),
        ("MLFC: 2x50 - *", "MLFC serial: 2x50 - *"),
    ),
    paper_says=(
        "RMSSE over the number of weights, one panel a rate: both LSTMs lie below all three MLFCs, also below the "
        "largest, which has more weights than either."
    ),
    presets={
        "smoke": "40 updates, T = 5: seconds, for tests",
        "laptop": "the paper's sizes; 2,000 updates at T = 40, 1,000 at T = 190, three seeds",
        "evening": "12,000 updates, at T = 190 8,000: two hours",
        "paper": "30,000 updates, five seeds at both horizons: a night on two cores",
    },
)
