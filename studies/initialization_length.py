"""How long a history: washout and MLP initialization from 5 to 40 samples (paper, two remarks in the text)."""

from bench.experiment.config import RunConfig
from bench.experiment.grid import attainable, grid, horizons
from bench.experiment.study import Study
from registry.contracts import Dataset

LENGTHS = (5, 10, 20, 40)
BASELINES = ("constant",)


def runs(preset: str, dataset: Dataset) -> list[RunConfig]:
    """One network for all targets, initialized from histories of four lengths in two ways."""
    size, width = ("1x10", 20) if preset == "smoke" else ("1x50", 60)
    specs = [f"LSTM: {size} - {i}{t}" for i in ("Washout: ", f"MLP: {width}x") for t in LENGTHS]
    return grid((*specs, *BASELINES, *attainable(dataset)), dataset, horizons(preset, 5), [dataset.predicted()])


STUDY = Study(
    name="initialization_length",
    title="length of the history: washout and MLP initialization from 5 to 40 samples, three rotational rates",
    question=(
        "The paper says that an efficient washout period is difficult to determine, and that the early peak of the "
        "error over 1.9 s may shrink when the initialization length grows."
    ),
    source='sections "NN-based Initialization vs. Washout" and "Black-box Modeling of the Helicopter"',
    default_dataset="helicopter_twin",
    runs=runs,
    pairs=(
        ("LSTM: * - MLP: *x40", "LSTM: * - MLP: *x10"),
        ("LSTM: * - Washout: 40", "LSTM: * - Washout: 10"),
        ("LSTM: * - MLP: *x10", "LSTM: * - Washout: 40"),
    ),
    paper_says="No figure: two remarks in the text, tested here by a sweep.",
    presets={
        "smoke": "tiny networks, 40 updates, T = 5: seconds, for tests",
        "laptop": "1x50; 2,000 updates at T = 40, 1,000 at T = 190, three seeds",
        "evening": "12,000 updates, at T = 190 8,000: two hours",
        "paper": "1x50; 30,000 updates, five seeds at both horizons: a night on two cores",
    },
)
