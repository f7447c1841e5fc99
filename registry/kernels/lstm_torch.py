"""The stacked LSTM of `registry.kernels.lstm` in PyTorch: on any device, and where there is no compiler.

Models of one shape run side by side in batched products. An operation on a thin network costs its call: the loops over
time have as few as there can be, and what the way back needs of the gates alone is made for many steps at once.
"""

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from registry.kernels.lstm_history import Back, History, Shape, before
from registry.kernels.workspace import Reused


def run(
    inputs: Tensor,
    state: Tensor,
    forced: Tensor | None,
    weights: list[Tensor],
    mask: Tensor | None,
    delays: int,
) -> tuple[Tensor, Tensor]:
    """Run T steps: arguments and results as for `registry.kernels.lstm.lstm`, but for these.

    Args:
        inputs, state, forced, delays: see there; with a model dimension, and a batch of whole vectors.
        weights: input, recurrent, bias and peephole of every layer, then weight and bias of the read-out, if any.
        mask: (L, T, M, H, B) what dropout lets through; None: all.
    """
    done: tuple[Tensor, Tensor] = _LSTM.apply(inputs, state, forced, mask, delays, *weights)
    return done


class _Layer:
    """One layer's weights, laid out for the products."""

    def __init__(self, weights: tuple[Tensor, ...], leading: int, columns: int, batch: int) -> None:
        """
        Args:
            weights: input, recurrent, bias, peephole.
            leading: this many columns of the input weight come after the others.
            columns: with padding.
            batch: windows.
        """
        w_in, w_rec, bias, peephole = weights
        H, k, self.leading = w_rec.shape[-1], w_rec.shape[-1] + w_in.shape[-1], leading
        self.turn, self.k, self.H = k - leading, k, H
        self.w = torch.cat(
            [
                w_rec,
                w_in[..., leading:],
                w_in[..., :leading],
                bias.unsqueeze(-1),
                w_in.new_zeros(*bias.shape, columns - k - 1),
            ],
            -1,
        )
        # tanh x = 2σ(2x) − 1 is several times faster than `torch.tanh` on CPUs
        self.doubled = self.w.clone()
        self.doubled[:, 2 * H : 3 * H] *= 2
        self.i, self.f, self.o = peephole.unsqueeze(-1).unbind(1)  # (M, H, 1)
        self.i_f = peephole[:, :2, :, None].repeat(1, 1, 1, batch)  # a number for every lane: three times faster
        self.o_tanh = torch.stack([self.o, torch.full_like(self.o, 2)], 1).repeat(1, 1, 1, batch)

    def gradients(self, dw: Tensor, d_peephole: Tensor) -> list[Tensor]:
        """Of the four weights, from that of ``w`` and of the peepholes."""
        d_in = torch.cat([dw[..., self.turn : self.k], dw[..., self.H : self.turn]], -1)
        return [d_in, dw[..., : self.H], dw[..., self.k], d_peephole]


class _LSTM(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        inputs: Tensor,
        state: Tensor,
        forced: Tensor | None,
        mask: Tensor | None,
        delays: int,
        *weights: Tensor,
    ) -> tuple[Tensor, Tensor]:
        (M, B, T, m), D, L, H = inputs.shape, delays, len(weights) // 4, weights[1].shape[-1]
        n = weights[-2].shape[1] if len(weights) > 4 * L else 0
        s = Shape(M=M, B=B, T=T, m=m, n=n, D=D, L=L, H=H, masked=mask is not None)
        space = Reused((s, inputs.dtype, inputs.device), lambda: History(s, inputs))
        h = space.thing
        layers = [_Layer(weights[4 * i : 4 * i + 4], 0 if i else D * m, s.width(i), B) for i in range(L)]
        past_u, past_y, hidden, cell = state.split([(D - 1) * m, D * n, L * H, L * H], -1)
        for i in range(L):
            h.x[i][0, :, :H], h.c[i][0] = hidden[..., i * H : (i + 1) * H].mT, cell[..., i * H : (i + 1) * H].mT
            h.tanh_c[i].zero_()
        line = inputs.permute(2, 0, 3, 1).flip(0)
        if D > 1 and m:
            line = torch.cat([line, before(past_u, D - 1)])
        for d, rows in enumerate(h.u_rows):
            rows.copy_(line[d : d + T].flip(0))
        fed = h.fed
        wo, bo = inputs.new_zeros(M, s.outputs, H), inputs.new_zeros(M, s.outputs, 1)
        if n:
            wo[:, :n], bo[:, :n, 0] = weights[-2], weights[-1]
            fed[T:] = before(past_y, D)
        if forced is not None:
            fed = torch.cat([forced.permute(2, 0, 3, 1).flip(0), fed[T:]])
            for d, taps in enumerate(h.taps):
                taps.copy_(fed[d + 1 : d + 1 + T].flip(0))
        minus, own, up = inputs.new_tensor(-1.0), n > 0 and forced is None, inputs
        for t, step in enumerate(h.steps):
            if own:
                h.seen[t].copy_(h.windows[t])
            for i, (x, g, i_f, ifz, o_tanh, gi, gf, z, o, tanh_c, c0, c0_, c1, c1_, ahead, above, v) in enumerate(step):
                layer = layers[i]
                torch.bmm(layer.doubled, x, out=g)
                i_f.addcmul_(c0_, layer.i_f)
                ifz.sigmoid_()
                torch.add(minus, z, alpha=2, out=z)
                torch.mul(gf, c0, out=c1).addcmul_(gi, z)
                o_tanh.addcmul_(c1_, layer.o_tanh).sigmoid_()
                torch.add(minus, tanh_c, alpha=2, out=tanh_c)
                up = torch.mul(o, tanh_c, out=ahead)
                if mask is not None:
                    up = torch.mul(up, mask[i, t], out=v)
                if above is not None:
                    above.copy_(up)
            if n:
                torch.baddbmm(bo, wo, up, out=h.output_at[T - 1 - t])
        ctx.save_for_backward(*weights)
        ctx.set_materialize_grads(False)
        ctx.kept, ctx.forced = (space, layers, mask, wo), forced is not None
        ends = [x.permute(1, 3, 0, 2).flatten(-2) for x in (line[: D - 1], fed[:D])]
        ends += [x[T, :, :H].mT for x in h.x] + [c[T].mT for c in h.c]
        return h.fed[:T].flip(0).permute(1, 3, 0, 2).contiguous(), torch.cat(ends, -1)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Tensor | None, ...]:
        (given, ends), _ = grads, ctx.saved_tensors
        space, layers, mask, wo = ctx.kept
        h: History = space.thing
        s, inputs_too = h.s, ctx.needs_input_grad[0]
        back = Reused((Back, s, wo.dtype, wo.device), lambda: Back(s, wo))
        b = back.thing
        d_fed = b.y.new_zeros(s.T + s.D, s.M, s.n, s.B) if ctx.forced else b.y[:, :, : s.n]
        b.begin(given, ends, d_fed)
        woT, WT = wo.mT, [v.w.mT for v in layers]
        d_w = [torch.zeros_like(v.w) for v in layers]
        d_peephole = [wo.new_zeros(s.M, 3, s.H) for _ in layers]
        for first in reversed(range(0, s.T, s.chunk)):
            last = min(s.T, first + s.chunk)
            for i, v in enumerate(layers):
                b.meet(h, i, slice(first, last), v.i, v.f, v.o)
            for t in range(last - 1, first - 1, -1):
                step = b.steps[t - first]
                for i in range(s.L - 1, -1, -1):
                    d_o, d_ifz, dg, through, carried = step[i]
                    from_up: Tensor | None = b.below[i + 1] if i < s.L - 1 else None
                    d, dc = b.own[i], b.c[i]
                    if i == s.L - 1 and s.n:
                        if mask is None:
                            d = torch.baddbmm(d, woT, b.output_at[s.T - 1 - t], out=b.m)
                        else:
                            from_up = torch.bmm(woT, b.output_at[s.T - 1 - t])
                    if from_up is not None:
                        d = torch.add(from_up if mask is None else from_up * mask[i, t], d, out=b.m)
                    d_o.mul_(d)
                    dc.addcmul_(d, through)
                    d_ifz.mul_(dc.unsqueeze(1))
                    dc.mul_(carried)
                    torch.bmm(WT[i], dg, out=b.x[i])
                    d_w[i].baddbmm_(dg, h.steps[t][i][0].mT)
                if b.from_y is not None and not ctx.forced:
                    b.to_y[t].add_(b.from_y)
                elif b.from_y is not None and t < s.D:
                    d_fed[s.T - t : s.T - t + s.D].add_(b.from_y)
                if b.from_u is not None and (t < s.D - 1 or inputs_too):
                    b.to_u[t].add_(b.from_u)
            for i in range(s.L):
                d_peephole[i].add_(b.peephole_gradient(h, i, slice(first, last)))
        flat = [g for v, dw, d in zip(layers, d_w, d_peephole, strict=True) for g in v.gradients(dw, d)]
        if s.n:
            b.look(h)  # a row an output is summed: its order does not depend on M
            d_outputs = b.outputs.flatten(2)
            flat += [torch.bmm(d_outputs, b.tops.flatten(2).mT)[:, : s.n], d_outputs.sum(-1)[:, : s.n]]
        d_state = [x.permute(1, 3, 0, 2).flatten(-2) for x in (b.u[s.T :], d_fed[s.T :])]
        d_inputs = b.u[: s.T].flip(0).permute(1, 3, 0, 2) if inputs_too else None
        return d_inputs, torch.cat([*d_state, *(x.mT for x in (*b.own, *b.c))], -1), None, None, None, *flat
