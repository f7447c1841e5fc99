"""Neural initialization against washout (paper, section "NN-based Initialization vs. Washout", figure HeliCompare)."""

from bench.experiment.config import RunConfig
from bench.experiment.grid import attainable, grid, horizons
from bench.experiment.study import Study
from registry.contracts import Dataset

ARCHITECTURES = (
    "MLFC: 1x50 - MLP: 60x10",
    "MLFC: 1x50 - Washout: 10",
    "LSTM: 1x50 - MLP: 60x10",
    "LSTM: 1x50 - Washout: 10",
)
FED_BACK = ("MLFC A_o: 1x50 - MLP: 60x10", "MLFC A_o: 1x50 - Washout: 10")
"""With the read-out as the paper's equation has it: A_o is free, where the MLFCs above have zero."""
OWN_FEEDBACK = ("MLFC: 1x50 - Washout own: 10", "LSTM: 1x50 - Washout own: 10")
"""The paper leaves open whether washout feeds back measured or predicted outputs: both are shown."""
BASELINES = ("constant", "linear")


def runs(preset: str, dataset: Dataset) -> list[RunConfig]:
    """Architectures and baselines on each target channel, a MISO problem of its own."""
    axes = [(channel,) for channel in dataset.predicted_channels()]
    return grid(
        (*ARCHITECTURES, *FED_BACK, *OWN_FEEDBACK, *BASELINES, *attainable(dataset)), dataset, horizons(preset, 5), axes
    )


STUDY = Study(
    name="washout_vs_mlp",
    title="neural (MLP) initialization against washout, small networks, three rotational rates",
    question=(
        "The paper finds that initializing the states by an MLP improves the immediate and the overall prediction "
        "over washout, and that the two meet when the prediction is long."
    ),
    source='section "NN-based Initialization vs. Washout", figure HeliCompare',
    default_dataset="helicopter_twin",
    runs=runs,
    pairs=(
        ("MLFC: 1x50 - MLP: 60x10", "MLFC: 1x50 - Washout: 10"),
        ("LSTM: 1x50 - MLP: 60x10", "LSTM: 1x50 - Washout: 10"),
        FED_BACK,
        ("MLFC: 1x50 - MLP: 60x10", "MLFC: 1x50 - Washout own: 10"),
        ("LSTM: 1x50 - MLP: 60x10", "LSTM: 1x50 - Washout own: 10"),
    ),
    presets={
        "smoke": "40 updates, T = 5: seconds, for tests",
        "laptop": "2,000 updates at T = 40, 1,000 at T = 190, three seeds: minutes on two cores",
        "evening": "12,000 updates, at T = 190 8,000: two hours",
        "paper": "30,000 updates, five seeds at both horizons: a night on two cores",
    },
)
