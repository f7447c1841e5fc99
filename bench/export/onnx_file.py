"""A trained network with its initializer and scalers as one ONNX file."""

import json
import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from bench.records.record import RunRecord
from bench.training.model import Model
from bench.training.predict import load_model, signals
from registry.atomic_io import replacing, writing
from registry.contracts import Predictor
from registry.errors import BenchError
from registry.initializers.optimized import OptimizedInitializer
from registry.initializers.washout import WashoutInitializer
from registry.kernels import plain
from registry.predictors.baselines.linear import LinearPredictor
from registry.predictors.load_hybrid import LoadHybridPredictor
from registry.predictors.lru import LRUPredictor

INPUTS = "past_inputs", "past_outputs", "inputs"
"""Of the file: (batch, τ, m), (batch, τ, n + c) and (batch, T, m), SI; those without columns are left out."""
OUTPUT = "outputs"
"""(batch, T, n), SI."""
TRACED = 3, 4
"""Windows and steps of the example that is followed; the file takes any number of both."""
CHECKED = 8
"""Windows that the file is tried on."""
LIMIT = 1e-3
"""Largest difference with which a file is written [deviations of the outputs]: a hundred times what rounding makes."""
REFUSED = {
    OptimizedInitializer: "its start is sought by gradient for every window; take an MLP or RNN initializer",
    LRUPredictor: "its states are complex numbers, which ONNX does not calculate with",
    LinearPredictor: "every step is a regression of its own, no loop of one step",
    LoadHybridPredictor: "it takes its units out of the scalers as plain numbers while it runs",
}
Windows = tuple[Tensor, Tensor, Tensor]


class Step(nn.Module):
    """One step of a predictor, measured outputs fed back where they are given."""

    def __init__(self, predictor: Predictor) -> None:
        super().__init__()
        self.predictor = predictor

    def forward(self, state: Tensor, u: Tensor, measured: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """From the state (B, s), scaled inputs (B, m) and outputs (B, n) to outputs (B, n) and the state after them."""
        feedback = None if measured is None else measured.unsqueeze(1)
        outputs, state = self.predictor.rollout(u.unsqueeze(1), state, feedback)
        return outputs.squeeze(1), state


class Whole(nn.Module):
    """`Model.predict`, its runs of many steps as loops of one: all that a predictor remembers is in its state."""

    def __init__(self, model: Model, example: Windows) -> None:
        super().__init__()
        self.model, self.training, p = model, False, model.predictor
        self.asked: set[bool] = set()
        with _running(p, self._note):
            past = p.input_scaler(example[0]), p.scale_history(example[1])
            given = model.state(*past), past[0][:, -1], past[1][:, -1, : p.n_outputs]
        self.free = _traced(Step(p), *given[:2])
        self.fed = _traced(Step(p), *given) if True in self.asked else None

    def forward(self, past_inputs: Tensor, past_outputs: Tensor, inputs: Tensor) -> Tensor:
        """SI windows → SI outputs; see `Model.predict`."""
        p = self.model.predictor
        with _running(p, self._run):
            said: Tensor = p(inputs, self.model.state(p.input_scaler(past_inputs), p.scale_history(past_outputs)))
        return said

    def _note(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """`Predictor.rollout`; notes whether the initializer feeds measured outputs back."""
        self.asked.add(feedback is not None)
        return type(self.model.predictor).rollout(self.model.predictor, inputs, state, feedback)

    def _run(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """See `Predictor.rollout`."""
        if feedback is None:
            return plain.steps(self.free, state, [inputs])
        assert self.fed is not None
        return plain.steps(self.fed, state, [inputs, feedback])


@contextmanager
def _running(predictor: Predictor, run: Callable[..., tuple[Tensor, Tensor]]) -> Iterator[None]:
    """Within it ``run`` is the predictor's rollout."""
    vars(predictor)["rollout"] = run
    try:
        yield
    finally:
        del vars(predictor)["rollout"]


def _traced(step: Step, *example: Tensor) -> nn.Module:
    """The operations of a step, for any number of windows."""
    batch = torch.export.Dim("batch")
    shapes = {"state": {0: batch}, "u": {0: batch}} | ({"measured": {0: batch}} if len(example) > 2 else {})
    return torch.export.export(step, example, dynamic_shapes=shapes, strict=False).module()


def write(path: Path, record: RunRecord) -> float:
    """Write the file and hold it against `Model.predict` on made-up windows.

    Returns:
        the largest difference there, in units of the outputs' deviation in the training data.

    Raises:
        BenchError: ONNX is not installed, the run has no model, it cannot be exported, or there is no such file.
    """
    onnxruntime = _installed()
    model = load_model(record)
    _refuse(model, record.summary["spec"])
    program = _program(model, record)
    _describe(program.model, record)
    with writing(path), replacing(path) as draft:
        program.save(str(draft), external_data=False)
        apart = _difference(onnxruntime, draft, model, record)
        if not apart <= LIMIT:
            raise BenchError(
                f"{path} is not written: it is off `bench predict` by {apart:.1g} standard deviations: "
                f"{record.summary['spec']} keeps memory outside its state, or its free run is unstable."
            )
    return apart


def _installed() -> Any:
    try:
        import onnxruntime
        import onnxscript  # noqa: F401
    except ImportError as error:
        raise BenchError("--to onnx needs ONNX: pip install onnx onnxruntime onnxscript (the extra `onnx`).") from error
    return onnxruntime


def _refuse(model: Model, spec: str) -> None:
    """Say of models that are not one loop of one function of their history why they are none."""
    for part in model.modules():
        why = next((why for kind, why in REFUSED.items() if isinstance(part, kind)), "")
        if isinstance(part, WashoutInitializer) and part.start == "random":
            why = "its washout starts at random, so that no two files would agree"
        if why:
            raise BenchError(f"{spec} cannot be written as ONNX: {why}.")


def _program(model: Model, record: RunRecord) -> Any:
    """The file's content."""
    from onnx_ir.passes.common import RemoveUnusedNodesPass

    batch, horizon = torch.export.Dim("batch"), torch.export.Dim("horizon")
    quiet = logging.getLogger("torch.onnx")
    level = quiet.level
    quiet.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings(), torch.no_grad():
            warnings.simplefilter("ignore")
            example = _windows(model, record, *TRACED)
            made = torch.onnx.export(
                Whole(model, example),
                example,
                dynamo=True,
                input_names=list(INPUTS),
                output_names=[OUTPUT],
                dynamic_shapes=({0: batch}, {0: batch}, {0: batch, 1: horizon}),
                verbose=False,
            )
    except BenchError:
        raise
    except Exception as error:  # whatever a plug-in does that PyTorch does not follow
        found = error.__cause__ or error
        reason = next((line.strip(" .") for line in str(found).splitlines() if line.strip()), type(found).__name__)
        raise BenchError(
            f"{record.summary['spec']} cannot be written as ONNX: torch.onnx does not follow it ({reason})."
        ) from error
    finally:
        quiet.setLevel(level)
    assert made is not None
    RemoveUnusedNodesPass()(made.model)
    return made


def _windows(model: Model, record: RunRecord, windows: int, steps: int) -> Windows:
    """Made-up ones about the mean of the training data, the same each time; see `INPUTS`."""
    p, tau = model.predictor, record.summary["history"]
    draw = partial(torch.randn, generator=torch.Generator().manual_seed(0))
    level, measured = draw(windows, 1, p.n_inputs), draw(windows, 1, p.n_outputs)
    u = level + 0.1 * draw(windows, tau + steps, p.n_inputs)
    past = p.output_scaler.invert(0.5 * (measured + 0.1 * draw(windows, tau, p.n_outputs)))
    if p.context_scaler is not None:
        past = torch.cat([past, p.context_scaler.invert(0.1 * draw(windows, tau, p.n_context))], -1)
    u = p.input_scaler.invert(0.5 * u)
    return u[:, :tau], past, u[:, tau:]


def _describe(model: Any, record: RunRecord) -> None:
    """Say what the file is, in its metadata; leave out how it was traced, which names folders of this machine."""
    summary = record.summary
    inputs, outputs, context = signals(record)
    units = summary["units"]
    listed = {"inputs": inputs, "past_outputs": [*outputs, *context], "outputs": outputs}
    model.producer_name, model.producer_version = "multistep-bench", ""
    model.doc_string = (
        f"{summary['spec']} on {summary['dataset']}. From {summary['history']} measured samples (past_inputs, "
        f"past_outputs) and the inputs of any number of samples after them to the outputs there; SI units."
    )
    for graph in (model.graph, *(f.graph for f in model.functions.values())):
        for node in graph.all_nodes():
            node.metadata_props.clear()
            node.doc_string = None
    model.metadata_props.clear()
    model.metadata_props.update(
        {
            "run": record.key,
            "spec": summary["spec"],
            "dataset": summary["dataset"],
            "rate_hz": json.dumps(summary["rate_hz"]),
            "history": json.dumps(summary["history"]),
            "horizon": json.dumps(summary["horizon"]),
            "signals": json.dumps({k: [{"name": n, "unit": units[n]} for n in names] for k, names in listed.items()}),
        }
    )


def _difference(onnxruntime: Any, path: Path, model: Model, record: RunRecord) -> float:
    """See `write`."""
    windows = _windows(model, record, CHECKED, record.summary["horizon"])
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    wanted = {i.name for i in session.get_inputs()}
    given = {n: w.numpy() for n, w in zip(INPUTS, windows, strict=True) if n in wanted}
    said = torch.from_numpy(session.run([OUTPUT], given)[0])
    apart = (said - model.predict(*windows)) / model.predictor.output_scaler.scale
    return float(apart.abs().max())
