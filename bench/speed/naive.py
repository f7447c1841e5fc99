"""The reference that speed is measured against: the equations, written as one would for autograd. Frozen.

A Linear for every gate or connection, a Python loop over the time steps, torch's autograd through all of it.
Nothing here is to be made faster.
"""

from collections.abc import Mapping

import torch
from torch import Tensor, nn


class NaiveCell(nn.Module):
    """One layer of LSTM cells with diagonal peepholes (paper, eq. LSTM)."""

    def __init__(self, columns: int, hidden: int) -> None:
        super().__init__()
        self.gates = nn.ModuleList(nn.Linear(columns + hidden, hidden) for _ in range(4))
        self.peephole = nn.ParameterList(torch.zeros(hidden) for _ in range(3))

    def forward(self, x: Tensor, m: Tensor, c: Tensor) -> tuple[Tensor, Tensor]:
        """Hidden and cell states (B, H) a step later, from what enters (B, K) and the states before."""
        z = torch.cat([x, m], 1)
        i = torch.sigmoid(self.gates[0](z) + self.peephole[0] * c)
        f = torch.sigmoid(self.gates[1](z) + self.peephole[1] * c)
        c = f * c + i * torch.tanh(self.gates[2](z))
        o = torch.sigmoid(self.gates[3](z) + self.peephole[2] * c)
        return o * torch.tanh(c), c


class NaiveLSTM(nn.Module):
    """Layers in series, a linear read-out, and the ``delays`` latest inputs and outputs at the first layer."""

    def __init__(self, inputs: int, outputs: int, layers: int, hidden: int, delays: int = 1) -> None:
        super().__init__()
        self.inputs, self.outputs, self.delays = inputs, outputs, delays
        self.cells = nn.ModuleList(
            NaiveCell(hidden if i else delays * (inputs + outputs), hidden) for i in range(layers)
        )
        self.out = nn.Linear(hidden, outputs)

    def load(self, weights: Mapping[str, Tensor]) -> "NaiveLSTM":
        """Take the weights of an `LSTM` predictor, named as in its ``state_dict``."""
        with torch.no_grad():
            for i, cell in enumerate(self.cells):
                assert isinstance(cell, NaiveCell)
                joined = torch.cat([weights[f"input_weight.{i}"], weights[f"recurrent_weight.{i}"]], 1).chunk(4)
                for gate, w, b in zip(cell.gates, joined, weights[f"bias.{i}"].chunk(4), strict=True):
                    assert isinstance(gate, nn.Linear)
                    gate.weight.copy_(w), gate.bias.copy_(b)
                for own, given in zip(cell.peephole, weights[f"peephole.{i}"], strict=True):
                    own.copy_(given)
            self.out.weight.copy_(weights["output_weight"]), self.out.bias.copy_(weights["output_bias"])
        return self

    def forward(self, inputs: Tensor, state: Tensor) -> Tensor:
        """Free run: inputs (B, T, m) and state (B, s), laid out as the predictor's, → outputs (B, T, n)."""
        layers, hidden, d = len(self.cells), self.out.in_features, self.delays
        sizes = [self.inputs] * (d - 1) + [self.outputs] * d + [hidden] * (2 * layers)
        pieces = list(state.split(sizes, 1))
        past_u, past_y = pieces[: d - 1], pieces[d - 1 : 2 * d - 1]
        m, c = pieces[2 * d - 1 : 2 * d - 1 + layers], pieces[2 * d - 1 + layers :]
        outputs = []
        for u in inputs.unbind(1):
            x = torch.cat([u, *past_u, *past_y], 1)
            for i, cell in enumerate(self.cells):
                m[i], c[i] = cell(x, m[i], c[i])
                x = m[i]
            y = self.out(x)
            outputs.append(y)
            past_u, past_y = [u, *past_u][: d - 1], [y, *past_y][:d]
        return torch.stack(outputs, 1)


class NaiveMLFC(nn.Module):
    """tanh layers with skip connections forward and backward (paper, eqs. LRLayer and layerinput)."""

    def __init__(self, inputs: int, outputs: int, layers: int, hidden: int) -> None:
        super().__init__()
        self.outputs, self.hidden = outputs, hidden
        self.entering = nn.ModuleList(nn.Linear(inputs + outputs, hidden) for _ in range(layers))
        self.joining = nn.ModuleList(
            nn.ModuleList(nn.Linear(hidden, hidden, bias=False) for _ in range(layers)) for _ in range(layers)
        )
        self.out = nn.Linear(layers * hidden, outputs)
        self.direct = nn.Linear(inputs, outputs, bias=False)

    def load(self, weights: Mapping[str, Tensor]) -> "NaiveMLFC":
        """Take the weights of an `MLFC` predictor, named as in its ``state_dict``."""
        seen = len(weights["input_weight.0"][0]) - self.hidden * (len(self.entering) - 1)
        with torch.no_grad():
            for i, (entering, joining) in enumerate(zip(self.entering, self.joining, strict=True)):
                assert isinstance(entering, nn.Linear) and isinstance(joining, nn.ModuleList)
                from_inputs, *others = weights[f"input_weight.{i}"].split(
                    [seen] + [self.hidden] * (len(joining) - 1), 1
                )
                others.insert(i, weights[f"feedback_weight.{i}"])
                entering.weight.copy_(from_inputs), entering.bias.copy_(weights[f"bias.{i}"])
                for own, given in zip(joining, others, strict=True):
                    assert isinstance(own, nn.Linear)
                    own.weight.copy_(given)
            self.out.weight.copy_(weights["output_weight"]), self.out.bias.copy_(weights["output_bias"])
            self.direct.weight.copy_(weights["direct_weight"])
        return self

    def forward(self, inputs: Tensor, state: Tensor) -> Tensor:
        """Free run: inputs (B, T, m) and state (B, s), laid out as the predictor's, → outputs (B, T, n)."""
        fed, *y = state.split([self.outputs] + [self.hidden] * len(self.entering), 1)
        outputs = []
        for u in inputs.unbind(1):
            x = torch.cat([u, fed], 1)
            for i, (entering, joining) in enumerate(zip(self.entering, self.joining, strict=True)):
                assert isinstance(joining, nn.ModuleList)
                a = entering(x)
                for weight, before in zip(joining, y, strict=True):
                    a = a + weight(before)
                y[i] = torch.tanh(a)
            fed = self.out(torch.cat(y, 1)) + self.direct(u)
            outputs.append(fed)
        return torch.stack(outputs, 1)
