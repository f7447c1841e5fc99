"""The stacked LSTM of `registry.kernels.lstm` a step at a time under autograd: every option of it, on any device.

The way back keeps each operation of each step: some five times the time and memory of the kernels beside it.
"""

from collections.abc import Callable

import torch
from torch import Tensor


def run(
    inputs: Tensor,
    state: Tensor,
    forced: Tensor | None,
    weights: list[Tensor],
    mask: Tensor | None,
    delays: int,
    increments: bool,
) -> tuple[Tensor, Tensor]:
    """Run T steps: arguments and results as for `registry.kernels.lstm_torch.run`, and ``increments``."""
    steps = inputs.shape[2]
    count, size, m = len(weights) // 4, weights[1].shape[-1], inputs.shape[-1]
    read = weights[4 * count :]
    n = read[0].shape[-2] if read else 0
    sizes = [(delays - 1) * m, delays * n, *[size] * (2 * count)]
    past_u, past_y, *states = state.mT.split(sizes, 1)  # feature-major: (M, features, B)
    made = []
    for t in range(steps):
        line = torch.cat([inputs[:, :, t].mT, past_u], 1)
        x = torch.cat([line, past_y], 1)
        for i in range(count):
            states[i], states[count + i] = _step(weights[4 * i : 4 * i + 4], x, states[i], states[count + i])
            x = states[i] if mask is None else states[i] * mask[i, t]
        y = torch.baddbmm(read[1].unsqueeze(-1), read[0], x) if read else x[:, :0]
        if increments:
            y = y + past_y[:, :n]
        made.append(y)
        fed = y if forced is None else forced[:, :, t].mT
        past_u, past_y = line[:, : sizes[0]], torch.cat([fed, past_y], 1)[:, : sizes[1]]
    end = torch.cat([past_u, past_y, *states], 1).mT
    return torch.stack(made, 1).permute(0, 3, 1, 2), end


def _step(layer: list[Tensor], x: Tensor, m: Tensor, c: Tensor) -> tuple[Tensor, Tensor]:
    """m_k and c_k (M, H, B) of one layer (paper, eq. LSTM)."""
    into, back, bias, peephole = layer
    p_i, p_f, p_o = (_looking(w) for w in peephole.unbind(1))
    g_i, g_f, g_c, g_o = (torch.baddbmm(bias.unsqueeze(-1), into, x) + torch.bmm(back, m)).chunk(4, 1)
    after = torch.sigmoid(g_f + p_f(c)) * c + torch.sigmoid(g_i + p_i(c)) * torch.tanh(g_c)
    return torch.sigmoid(g_o + p_o(after)) * torch.tanh(after), after


def _looking(weight: Tensor) -> Callable[[Tensor], Tensor]:
    """c ↦ W^c c, of a diagonal (M, H) or whole matrices (M, H, H)."""
    return (lambda c: weight.unsqueeze(-1) * c) if weight.dim() == 2 else (lambda c: torch.bmm(weight, c))
