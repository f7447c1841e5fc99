"""What is measured: one row a network, size, batch and task."""

from dataclasses import dataclass

from bench.speed.floor import Product

INPUTS, OUTPUTS = 4, 3
"""Of the networks measured: four rotors or sticks, three rates."""
DELAYS = 10
TAU = 10
"""History of the initializers [samples]."""
RATES_AND_VELOCITY = 6
"""Outputs of the hybrid model."""


@dataclass(frozen=True)
class Row:
    """Networks of ``layers`` x ``hidden`` on windows of ``horizon`` steps."""

    model: str
    """"LSTM", "LSTM TDL", "MLFC" or "Hybrid"."""
    layers: int
    hidden: int
    horizon: int
    batch: int
    task: str = "train"
    """"train": forward, cost, backward and Adam; "step": an update of `bench.training.train` with everything around;
    "predict": a free run."""
    initializer: str = ""
    """Of a "step", as notation: "MLP: 100x10"."""
    models: int = 1
    """Trained side by side; times are those of all of them."""
    processes: int = 1
    """At once, each with its own model on one thread; times are those of a step of all of them."""
    quick: bool = False
    """Whether it belongs to a quick run."""

    @property
    def spec(self) -> str:
        """In the notation of the paper."""
        network = f"{self.model}: {self.layers}x{self.hidden}"
        return f"{network} - {self.initializer}" if self.initializer else network

    @property
    def manner(self) -> str:
        """Task, models side by side and processes, as text; empty: one model trains in one process."""
        if self.task == "step":
            return f"update, {self.initializer}"
        said = ["free run"] * (self.task == "predict")
        said += [f"{self.models} together"] * (self.models > 1) + [f"{self.processes} processes"] * (self.processes > 1)
        return ", ".join(said)

    @property
    def name(self) -> str:
        """One line that tells it from the others."""
        said = (f"{self.model} {self.layers}x{self.hidden}", f"T {self.horizon}", f"B {self.batch}", self.manner)
        return ", ".join(s for s in said if s)

    @property
    def products(self) -> list[Product]:
        """The matrix products of one model, for the floor."""
        h, t, states = self.hidden, self.horizon, self.layers * self.hidden * (1 if self.model == "MLFC" else 2)
        if self.model == "MLFC":
            made = [Product(INPUTS + OUTPUTS + self.layers * h, h, t)] * self.layers
        elif self.model == "Hybrid":
            made = [
                Product(columns + h, 4 * h, t)
                for seen in (INPUTS + RATES_AND_VELOCITY, 2 * INPUTS + RATES_AND_VELOCITY)
                for columns in (seen, *[h] * (self.layers - 1))
            ]
        else:
            seen = (INPUTS + OUTPUTS) * (DELAYS if self.model == "LSTM TDL" else 1)
            made = [Product(columns + h, 4 * h, t) for columns in (seen, *[h] * (self.layers - 1))]
        if self.initializer:
            kind, _, size = self.initializer.partition(": ")
            width = int(size.partition("x")[0])
            if kind == "MLP":
                made.append(Product(TAU * (INPUTS + OUTPUTS), width, 1))
            else:
                made.append(Product(INPUTS + OUTPUTS + width, 4 * width, TAU))
            made.append(Product(width, states, 1))
        return made


ROWS = (
    Row("LSTM", 1, 50, 40, 64, quick=True),
    Row("LSTM", 1, 50, 40, 256),
    Row("LSTM", 1, 50, 190, 64),
    Row("LSTM", 1, 50, 190, 256),
    Row("LSTM", 2, 50, 190, 256),
    Row("LSTM", 4, 200, 190, 256),
    Row("LSTM", 7, 200, 190, 256),
    Row("LSTM TDL", 2, 50, 40, 64, quick=True),
    Row("MLFC", 2, 100, 40, 256, quick=True),
    Row(model="LSTM", layers=2, hidden=50, horizon=40, batch=64, task="step", initializer="MLP: 100x10", quick=True),
    Row(model="LSTM", layers=2, hidden=50, horizon=40, batch=64, task="step", initializer="RNN: 50x10"),
    Row(model="LSTM TDL", layers=2, hidden=50, horizon=40, batch=64, task="step", initializer="MLP: 100x10"),
    Row("Hybrid", 4, 200, 190, 64),
    Row("LSTM", 1, 50, 40, 64, models=8),
    Row("LSTM", 1, 50, 40, 64, processes=2),
    Row("LSTM", 1, 50, 190, 256, "predict"),
)
SMALL = Row("Hybrid", 1, 20, 20, 32, quick=True)
"""In a quick run: that hybrids run at all."""
