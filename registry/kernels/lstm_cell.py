"""One time step of stacked peephole LSTM layers, with a hand-written gradient: for networks inside another loop.

The equations of `registry.kernels.lstm` for one model, feature-major (features, B). Where a network stands in a loop
with something else, the loop is the caller's; the weights are laid out for it once a call by `LSTMCell`.
"""

from typing import Any

import torch
from torch import Tensor

from registry.kernels import plain
from registry.kernels.lstm import Layer
from registry.kernels.pointwise import sigmoid_grad


class LSTMCell:
    """L layers of H cells, their weights side by side: columns [m | what enters | 1], gate rows i, f, c, o."""

    def __init__(self, layers: list[Layer]) -> None:
        """
        Args:
            layers: weights without a model dimension: input (4H, K), recurrent (4H, H), bias (4H,), peephole (3, H).
        """
        hidden = layers[0].recurrent.shape[-1]
        # σ serves for all gates, since tanh x = 2σ(2x) − 1: twice the rows of the cell's input.
        twice = layers[0].bias.new_ones(4 * hidden, 1)
        twice[2 * hidden : 3 * hidden] = 2
        self.flat = [
            w
            for layer in layers
            for w in (
                twice * torch.cat([layer.recurrent, layer.input, layer.bias.unsqueeze(-1)], -1),
                layer.peephole.unsqueeze(-1),
            )
        ]

    def __call__(self, entering: tuple[Tensor, ...], hidden: Tensor, cell: Tensor) -> tuple[Tensor, Tensor]:
        """Hidden and cell states (L, H, B) a step later.

        Args:
            entering: what enters the first layer, (K_i, B) each, one above the other.
            hidden, cell: (L, H, B) states before the step.
        """
        if plain.exporting():
            return plain.lstm_cell(self.flat, entering, hidden, cell)
        stepped: tuple[Tensor, Tensor] = _Cell.apply(len(entering), hidden, cell, *entering, *self.flat)
        return stepped


class _Cell(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, count: int, hidden: Tensor, cell: Tensor, *rest: Tensor) -> tuple[Tensor, Tensor]:
        below, flat = rest[:count], rest[count:]
        L, H, B = hidden.shape
        ones = hidden.new_ones(1, B)
        new_hidden, new_cell = torch.empty_like(hidden), torch.empty_like(cell)
        kept = []
        for i in range(L):
            w, peep = flat[2 * i], flat[2 * i + 1]
            x = torch.cat([hidden[i], *below, ones])
            g = w @ x
            c0, c1 = cell[i], new_cell[i]
            g[: 2 * H].view(2, H, B).addcmul_(c0, peep[:2])
            g[: 3 * H].sigmoid_()
            gi, gf, gc, go = g.split(H)
            torch.mul(gf, c0, out=c1).addcmul_(gi, gc, value=2).sub_(gi)
            go.addcmul_(c1, peep[2]).sigmoid_()
            s = torch.mul(c1, 2).sigmoid_()  # tanh c = 2s − 1
            m = torch.mul(go, s, out=new_hidden[i]).mul_(2).sub_(go)
            kept += [x, g, s]
            below = (m,)
        ctx.save_for_backward(cell, new_cell, *rest[count:], *kept)
        ctx.sizes = [len(r) for r in rest[:count]]
        return new_hidden, new_cell

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        d_hidden_out, d_cell_out = grads
        L, H, _ = d_hidden_out.shape
        cell, new_cell, *saved = ctx.saved_tensors
        flat, kept = saved[: 2 * L], saved[2 * L :]
        d_hidden, d_cell = torch.empty_like(cell), torch.empty_like(cell)
        d_flat: list[Tensor | None] = [None] * (2 * L)
        dm = d_hidden_out[L - 1]
        for i in range(L - 1, -1, -1):
            w, peep = flat[2 * i], flat[2 * i + 1]
            x, g, s = kept[3 * i : 3 * i + 3]
            gi, gf, gc, go = g.split(H)
            dg = torch.empty_like(g)
            di, df, dz, do = dg.split(H)
            # m = o (2s − 1)
            torch.mul(dm, s, out=do).mul_(2).sub_(dm)
            sigmoid_grad(do, go, grad_input=do)
            dc = sigmoid_grad(dm * go, s, grad_input=dz).mul(4).add_(d_cell_out[i]).addcmul_(do, peep[2])
            torch.mul(dc, gc, out=di).mul_(2).sub_(dc)  # of tanh = 2g − 1
            torch.mul(dc, cell[i], out=df)
            sigmoid_grad(dg[: 2 * H], g[: 2 * H], grad_input=dg[: 2 * H])
            torch.mul(dc, gi, out=dz).mul_(2)
            sigmoid_grad(dz, gc, grad_input=dz)
            torch.mul(dc, gf, out=d_cell[i]).addcmul_(di, peep[0]).addcmul_(df, peep[1])
            dx = w.T @ dg
            d_hidden[i] = dx[:H]
            if ctx.needs_input_grad[3 + len(ctx.sizes) + 2 * i]:
                d_flat[2 * i] = dg @ x.T
                d_flat[2 * i + 1] = torch.stack(
                    [(di * cell[i]).sum(-1), (df * cell[i]).sum(-1), (do * new_cell[i]).sum(-1)]
                ).unsqueeze(-1)
            if i:
                dm = d_hidden_out[i - 1] + dx[H:-1]
        entered = dx[H:-1].split(ctx.sizes)
        return None, d_hidden, d_cell, *entered, *d_flat
