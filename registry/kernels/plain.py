"""The kernels' equations in plain operations of one model: what `torch.export` can follow, and what ONNX can say.

The kernels beside this one pad, write into buffers and call C++. While a model is exported they pass their work to the
functions of the same name here, which take what they take, without a model dimension and without dropout. Steps are
the operator `scan`: one step is written down, whatever their number.
"""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor
from torch._higher_order_ops.scan import scan
from torch.nn import functional

Step = Callable[..., tuple[Tensor, Tensor]]
"""From the state (B, s) and a sample (B, ·) of each sequence to the output (B, n) and the state after it."""
exporting = torch.compiler.is_exporting


def steps(step: Step, state: Tensor, sequences: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    """Outputs (B, T, n) and the state (B, s) after T steps.

    Args:
        step: one of them.
        state: (B, s) before the first.
        sequences: (B, T, ·) each.
    """

    def one(state: Tensor, samples: tuple[Tensor, ...]) -> tuple[Tensor, Tensor]:
        output, after = step(state, *samples)
        return after.clone(), output.clone()  # `scan` wants nothing twice

    after, outputs = scan(one, state.contiguous(), tuple(s.movedim(1, 0).contiguous() for s in sequences))
    return outputs.movedim(0, 1), after


def _run(step: Step, state: Tensor, sequences: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    """`steps`, or the one step itself."""
    if sequences[0].shape[1] > 1:
        return steps(step, state, sequences)
    output, state = step(state, *(s[:, 0] for s in sequences))
    return output.unsqueeze(1), state


def lstm(
    inputs: Tensor, state: Tensor, forced: Tensor | None, weights: list[Tensor], delays: int, increments: bool = False
) -> tuple[Tensor, Tensor]:
    """See `registry.kernels.lstm.lstm`; weights as for `registry.kernels.lstm_torch.run`."""
    count, m, size = len(weights) // 4, inputs.shape[-1], weights[1].shape[-1]
    read = weights[4 * count :]
    n = len(read[0]) if read else 0
    sizes = [(delays - 1) * m, delays * n, *[size] * (2 * count)]

    def step(state: Tensor, u: Tensor, *measured: Tensor) -> tuple[Tensor, Tensor]:
        past_u, past_y, *states = state.split(sizes, -1)
        line = torch.cat([u, past_u], -1)
        x = torch.cat([line, past_y], -1)
        for i in range(count):
            into, back, bias, peephole = weights[4 * i : 4 * i + 4]
            c, (p_i, p_f, p_o) = states[count + i], peephole.unbind()
            g_i, g_f, g_c, g_o = (functional.linear(x, into, bias) + functional.linear(states[i], back)).chunk(4, -1)
            kept = torch.sigmoid(g_f + peephole_product(p_f, c)) * c
            states[count + i] = c = kept + torch.sigmoid(g_i + peephole_product(p_i, c)) * torch.tanh(g_c)
            states[i] = x = torch.sigmoid(g_o + peephole_product(p_o, c)) * torch.tanh(c)
        y = functional.linear(x, *read) if read else x[:, :0]
        y = y + past_y[:, :n] if increments else y
        line_y = torch.cat([*measured, past_y] if measured else [y, past_y], -1)
        return y, torch.cat([line[:, : sizes[0]], line_y[:, : sizes[1]], *states], -1)

    return _run(step, state, [inputs] if forced is None else [inputs, forced])


def peephole_product(weight: Tensor, cell: Tensor) -> Tensor:
    """W^c c of cells (…, H) by a diagonal (H,) or a whole matrix (H, H)."""
    return weight * cell if weight.dim() == 1 else functional.linear(cell, weight)


def gru(
    inputs: Tensor,
    state: Tensor,
    forced: Tensor | None,
    layers: Sequence[Sequence[Tensor]],
    read: tuple[Tensor, Tensor],
) -> tuple[Tensor, Tensor]:
    """See `registry.kernels.gru.gru`; the state is [fed-back output | hidden]."""
    n, size = len(read[0]), layers[0][1].shape[-1]

    def step(state: Tensor, u: Tensor, *measured: Tensor) -> tuple[Tensor, Tensor]:
        fed, *states = state.split([n, *[size] * len(layers)], -1)
        x = torch.cat([u, fed], -1)
        for i, (into, back, bias) in enumerate(layers):
            h = states[i]
            (x_r, x_z, x_v), (h_r, h_z, h_v) = (
                g.chunk(3, -1) for g in (functional.linear(x, into, bias), functional.linear(h, back))
            )
            z = torch.sigmoid(x_z + h_z)
            states[i] = x = z * h + (1 - z) * torch.tanh(x_v + torch.sigmoid(x_r + h_r) * h_v)
        y = functional.linear(x, *read)
        return y, torch.cat([measured[0] if measured else y, *states], -1)

    return _run(step, state, [inputs] if forced is None else [inputs, forced])


def mlfc(
    inputs: Tensor, state: Tensor, forced: Tensor | None, layers: list[Tensor], readout: Tensor
) -> tuple[Tensor, Tensor]:
    """See `registry.kernels.mlfc.mlfc`; the state is [fed-back output | hidden]."""
    n, size, m = len(readout), len(layers[0]), inputs.shape[-1]
    split = [torch.cat([w[:, : m + n], w[:, m + n + 1 :]], -1) for w in (*layers, readout)]
    biases = [w[:, m + n] for w in (*layers, readout)]

    def step(state: Tensor, u: Tensor, *measured: Tensor) -> tuple[Tensor, Tensor]:
        fed, *hidden = state.split([n, *[size] * len(layers)], -1)
        for i in range(len(layers)):
            hidden[i] = torch.tanh(functional.linear(torch.cat([u, fed, *hidden], -1), split[i], biases[i]))
        y = functional.linear(torch.cat([u, fed, *hidden], -1), split[-1], biases[-1])
        return y, torch.cat([measured[0] if measured else y, *hidden], -1)

    return _run(step, state, [inputs] if forced is None else [inputs, forced])


def mlp(x: Tensor, layers: list[tuple[Tensor, Tensor]]) -> Tensor:
    """See `registry.kernels.mlp.mlp`."""
    for weight, bias in layers[:-1]:
        x = torch.tanh(functional.linear(x, weight, bias))
    return functional.linear(x, *layers[-1])


def lstm_cell(flat: list[Tensor], below: Sequence[Tensor], hidden: Tensor, cell: Tensor) -> tuple[Tensor, Tensor]:
    """See `registry.kernels.lstm_cell.LSTMCell`, whose ``flat`` the weights are."""
    after, ones = [], torch.ones_like(hidden[0, :1])
    for i in range(len(hidden)):
        weight, (p_i, p_f, p_o) = flat[2 * i], flat[2 * i + 1].unbind()
        g_i, g_f, g_c, g_o = (weight @ torch.cat([hidden[i], *below, ones])).chunk(4)
        c = cell[i]
        c = torch.sigmoid(g_f + p_f * c) * c + torch.sigmoid(g_i + p_i * c) * torch.tanh(g_c / 2)
        h = torch.sigmoid(g_o + p_o * c) * torch.tanh(c)
        below = [h]
        after.append((h, c))
    hiddens, cells = zip(*after, strict=True)
    return torch.stack(hiddens), torch.stack(cells)


def rigid_body(x: Tensor, drive: Tensor, turning: Tensor, dt: float, gravity: float) -> Tensor:
    """See `registry.kernels.rigid_body.RigidBodyStep`.

    Args:
        x: (13, B) state.
        drive: (3, 4, B) thrust over mass and torque over inertia, at start, middle and end.
        turning: (7, 21) products of attitude and rates with the rates in their time derivatives.
        dt: length of the step [s].
        gravity: g [m/s²].
    """
    fall = torch.stack([torch.zeros_like(x[0]), torch.zeros_like(x[0]), torch.full_like(x[0], -gravity)])
    still = torch.zeros_like(x[6:10])
    slope = change = torch.zeros_like(x)
    for moment, ahead, share in ((0, 0.0, 1 / 6), (1, 0.5, 1 / 3), (1, 0.5, 1 / 3), (2, 1.0, 1 / 6)):
        now = x + dt * ahead * slope
        q, w = now[6:10], now[10:]
        up = (
            2 * (q[0] * q[2] + q[1] * q[3]),
            2 * (q[1] * q[2] - q[0] * q[3]),
            q[2] * q[2] + q[3] * q[3] - q[0] * q[0] - q[1] * q[1],
        )
        force = torch.stack(up) * (drive[moment, 0] / (q * q).sum(0)) + fall
        turned = turning @ (now[6:].unsqueeze(1) * w).flatten(0, 1) + torch.cat([still, drive[moment, 1:]])
        slope = torch.cat([now[3:6], force, turned])
        change = change + dt * share * slope
    end = x + change
    q = end[6:10]
    return torch.cat([end[:6], q * (q * q).sum(0).rsqrt(), end[10:]])
