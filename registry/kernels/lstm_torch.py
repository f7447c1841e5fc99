"""The stacked LSTM of `registry.kernels.lstm` in PyTorch: on any device, and where there is no compiler.

Models of one shape run side by side in batched products. Arrays are feature-major (…, features, batch), so that every
gate is one contiguous block.
"""

import math
from typing import Any

import torch
from torch import Tensor

from registry.kernels.pointwise import pad16, pad_batch, sigmoid_grad, tanh_grad
from registry.kernels.workspace import Workspace


def run(
    inputs: Tensor,
    fed: Tensor,
    hidden: Tensor,
    cell: Tensor,
    forced: Tensor | None,
    mask: Tensor | None,
    weights: list[Tensor],
) -> tuple[Tensor, Tensor, Tensor]:
    """Run T steps: arguments and results as for `registry.kernels.lstm.lstm`, but for the last two.

    Args:
        inputs, fed, hidden, cell, forced: see there.
        mask: (L, T, M, H, B') what dropout lets through, B' the batch as `pad_batch` leaves it; None: all.
        weights: input, recurrent, bias and peephole of every layer, then weight and bias of the read-out, if any.
    """
    batch, layers = inputs.shape[1], len(weights) // 4
    inputs, fed, hidden, cell = (pad_batch(x) for x in (inputs, fed, hidden, cell))
    forced = None if forced is None else pad_batch(forced)
    head = weights[4 * layers :] or (None, None)
    done: tuple[Tensor, Tensor, Tensor] = _LSTM.apply(
        inputs, fed, hidden, cell, forced, mask, *head, *weights[: 4 * layers]
    )
    outputs, hidden, cell = done
    return outputs[:, :batch], hidden[:, :batch], cell[:, :batch]


class _Views:
    """What a layer has at each step: gates g (4H rows) and parts of them, cells c, tanh of these, operands x."""

    def __init__(self, gates: Tensor, cells: Tensor, tanh_cells: Tensor, operands: Tensor) -> None:
        hidden = cells.shape[-2]
        rows = lambda first, last: gates[:, :, first * hidden : last * hidden].unbind(0)  # noqa: E731
        self.g, self.c, self.tc, self.x = (s.unbind(0) for s in (gates, cells, tanh_cells, operands))
        self.i, self.f, self.z, self.o = rows(0, 1), rows(1, 2), rows(2, 3), rows(3, 4)
        self.flat, self.ifz = rows(0, 2), rows(0, 3)
        self.i_f = gates[:, :, : 2 * hidden].unflatten(2, (2, hidden)).unbind(0)


class _LSTM(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        inputs: Tensor,
        fed: Tensor,
        hidden: Tensor,
        cell: Tensor,
        forced: Tensor | None,
        mask: Tensor | None,
        w_out: Tensor | None,
        b_out: Tensor | None,
        *flat: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor]:
        M, B, T, m = inputs.shape
        L, H = len(flat) // 4, flat[1].shape[-1]
        n = 0 if w_out is None else w_out.shape[-2]
        D = fed.shape[-1] // n if n else 0
        new: dict[str, Any] = {"dtype": inputs.dtype, "device": inputs.device}
        # operands of the gate product, rows of layer 0: [m | D·ỹ | u | 1 | 0..], of the others: [m | below | 1 | 0..]
        widths = [H + flat[4 * i].shape[-1] for i in range(L)]
        shapes: list[tuple[int, ...]] = [(T + 1, M, pad16(k + 1), B) for k in widths]
        shapes += [
            (L, T, M, 4 * H, B),
            (L, T + 1, M, H, B),
            (L, T, M, H, B),
            (L, T, M, H, B if mask is not None else 0),
        ]
        space = Workspace(sum(map(math.prod, shapes)), inputs.detach())
        *X, G, C, TC, V = space.parts(*shapes)  # V: what goes up, after dropout
        W = []
        for i, x in enumerate(X):
            w_in, w_rec, bias = flat[4 * i : 4 * i + 3]
            k, K = widths[i] - H, x.shape[2]
            x[:, :, H + k :] = 0
            x[:, :, H + k] = 1
            w = torch.zeros(M, 4 * H, K, **new)
            w[..., :H] = w_rec
            w[..., H : H + k] = torch.cat([w_in[..., m:], w_in[..., :m]], -1) if i == 0 else w_in
            w[..., H + k] = bias
            x[0, :, :H] = hidden[..., i * H : (i + 1) * H].mT
            W.append(w)
        rows = [slice(H + d * n, H + (d + 1) * n) for d in range(D)]
        X[0][:T, :, H + D * n : H + D * n + m] = inputs.permute(2, 0, 3, 1)
        for d in range(D):  # step t reads ỹ of d+1 steps before; until t > d that is one of ``fed``
            for t in range(min(d + 1, T)):
                X[0][t, :, rows[d]] = fed[..., (d - t) * n : (d - t + 1) * n].mT
        if forced is not None:
            y_fed = forced.permute(2, 0, 3, 1)  # (T, M, n, B)
            for d in range(min(D, T)):
                X[0][d + 1 : T, :, rows[d]] = y_fed[: T - d - 1]
        C[:, 0] = cell.unflatten(-1, (L, H)).permute(2, 0, 3, 1)
        n_pad = pad16(n) if n else 0
        Y = torch.empty(T, M, n_pad, B, **new)
        wo = torch.zeros(M, n_pad, H, **new)
        bo = torch.zeros(M, n_pad, 1, **new)
        if w_out is not None and b_out is not None:
            wo[:, :n], bo[:, :n, 0] = w_out, b_out
        twice = [torch.cat([w[:, : 2 * H], 2 * w[:, 2 * H : 3 * H], w[:, 3 * H :]], 1) for w in W]
        peep_if = [flat[4 * i + 3][:, :2].unsqueeze(-1) for i in range(L)]
        peep_o = [flat[4 * i + 3][:, 2].unsqueeze(-1) for i in range(L)]
        minus = torch.tensor(-1.0, **new)  # −1 + 2 σ(2x) = tanh x, several times faster than `torch.tanh` on CPUs
        ahead = [x[1:, :, :H].unbind(0) for x in X]
        above = [x[:, :, H : 2 * H].unbind(0) for x in X]
        steps = [_Views(G[i], C[i], TC[i], X[i]) for i in range(L)]
        taps = [X[0][:, :, r].unbind(0) for r in rows]
        Ys = Y.unbind(0)
        for t in range(T):
            for i, v in enumerate(steps):
                c0, c1, o, z, tc = v.c[t], v.c[t + 1], v.o[t], v.z[t], v.tc[t]
                torch.bmm(twice[i], v.x[t], out=v.g[t])
                v.i_f[t].addcmul_(c0.unsqueeze(1), peep_if[i])
                v.ifz[t].sigmoid_()
                torch.add(minus, z, alpha=2, out=z)
                torch.mul(v.f[t], c0, out=c1).addcmul_(v.i[t], z)
                o.addcmul_(c1, peep_o[i]).sigmoid_()
                torch.mul(c1, 2, out=tc).sigmoid_()
                torch.add(minus, tc, alpha=2, out=tc)
                up = torch.mul(o, tc, out=ahead[i][t])
                if mask is not None:
                    up = torch.mul(up, mask[i, t], out=V[i, t])
                if i + 1 < L:
                    above[i + 1][t].copy_(up)
            if n:
                torch.baddbmm(bo, wo, up, out=Ys[t])
                if forced is None:
                    for d in range(min(D, T - 1 - t)):
                        taps[d][t + 1 + d].copy_(Ys[t][:, :n])
        ctx.save_for_backward(*flat)
        ctx.kept, ctx.space = (X, W, V, steps, mask, wo, D, n, m, forced is not None), space
        last = torch.cat([x[T, :, :H] for x in X], 1).mT
        outputs = Y[:, :, :n].permute(1, 3, 0, 2)
        return outputs.contiguous(), last.contiguous(), C[:, T].permute(1, 3, 0, 2).flatten(-2).contiguous()

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        dY_, dh_, dc_ = grads
        flat = ctx.saved_tensors
        X, W, V, steps, mask, wo, D, n, m, was_forced = ctx.kept
        L, T = len(X), len(steps[0].g)
        M, H, B = steps[0].tc[0].shape
        new: dict[str, Any] = {"dtype": wo.dtype, "device": wo.device}
        dW = [torch.zeros_like(w) for w in W]
        dX = [torch.zeros_like(x[0]) for x in X]
        dC = list(dc_.unflatten(-1, (L, H)).permute(2, 0, 3, 1).clone(memory_format=torch.contiguous_format).unbind(0))
        for i in range(L):
            dX[i][:, :H] = dh_[..., i * H : (i + 1) * H].mT
        dY = torch.zeros(T, M, wo.shape[1], B, **new)
        dY[:, :, :n] = dY_.permute(2, 0, 3, 1)
        dU = torch.empty(T, M, m, B, **new)
        dfed = torch.zeros(M, max(D, 1) * n, B, **new)
        dwo, dm, dg = torch.zeros_like(wo), torch.empty(M, H, B, **new), torch.empty(M, 4 * H, B, **new)
        di, df, dz, do = dg.split(H, 1)
        d_if = dg[:, : 2 * H]
        d_i_f = d_if.unflatten(1, (2, H))
        through = torch.empty(M, H, B, **new)
        d_peep_if, d_peep_o = torch.zeros(L, M, 2, H, B, **new), torch.zeros(L, M, H, B, **new)
        WT, woT = [w.mT for w in W], wo.mT
        peep = [[flat[4 * i + 3][:, j].unsqueeze(-1) for j in range(3)] for i in range(L)]
        ups = (V[L - 1] if mask is not None else X[L - 1][1:, :, :H]).unbind(0)
        from_next, from_above = [x[:, :H] for x in dX], [x[:, H : 2 * H] for x in dX]
        from_taps = [dX[0][:, H + d * n : H + (d + 1) * n] for d in range(D)]
        given = dY.unbind(0)
        from_input = dX[0][:, H + D * n : H + D * n + m]
        for t in range(T - 1, -1, -1):
            for i in range(L - 1, -1, -1):
                v, dc = steps[i], dC[i]
                z, o, c0, tc = v.z[t], v.o[t], v.c[t], v.tc[t]
                if i < L - 1:
                    above: Tensor | None = from_above[i + 1]
                elif n:
                    above = torch.bmm(woT, given[t], out=dm)
                    dwo.baddbmm_(given[t], ups[t].mT)
                else:
                    above = None
                if above is None:
                    dm.copy_(from_next[i])
                elif mask is None:
                    torch.add(above, from_next[i], out=dm)
                else:
                    torch.mul(above, mask[i, t], out=dm).add_(from_next[i])
                tanh_grad(torch.mul(dm, o, out=through), tc, grad_input=through)
                dc.add_(through)
                sigmoid_grad(dm.mul_(tc), o, grad_input=do)
                dc.addcmul_(do, peep[i][2])
                torch.mul(dc, z, out=di)
                torch.mul(dc, c0, out=df)
                sigmoid_grad(d_if, v.flat[t], grad_input=d_if)
                tanh_grad(torch.mul(dc, v.i[t], out=dz), z, grad_input=dz)
                dc.mul_(v.f[t]).addcmul_(di, peep[i][0]).addcmul_(df, peep[i][1])
                d_peep_if[i].addcmul_(d_i_f, c0.unsqueeze(1))
                d_peep_o[i].addcmul_(do, v.c[t + 1])
                torch.bmm(WT[i], dg, out=dX[i])
                dW[i].baddbmm_(dg, v.x[t].mT)
            if ctx.needs_input_grad[0]:
                dU[t] = from_input
            for d in range(D):
                source = t - d - 1
                if source < 0:
                    dfed[:, (d - t) * n : (d - t + 1) * n] += from_taps[d]
                elif not was_forced:
                    given[source][:, :n] += from_taps[d]
        d_peep = torch.cat([d_peep_if.sum(-1), d_peep_o.sum(-1).unsqueeze(2)], 2)  # (L, M, 3, H)
        out: list[Tensor | None] = []
        for i in range(L):
            k = flat[4 * i].shape[-1]
            d_in = dW[i][..., H : H + k]
            if i == 0:
                d_in = torch.cat([d_in[..., k - m :], d_in[..., : k - m]], -1)
            out += [d_in, dW[i][..., :H], dW[i][..., H + k], d_peep[i]]
        head: list[Tensor | None] = [None, None]
        if n:
            # one contiguous row an output: the order of the sum does not depend on M
            head = [dwo[:, :n], dY.permute(1, 2, 0, 3).flatten(-2).sum(-1)[:, :n]]
        d_hidden = torch.cat([x[:, :H] for x in dX], 1).mT
        d_cell = torch.cat(dC, 1).mT
        d_inputs = dU.permute(1, 3, 0, 2) if ctx.needs_input_grad[0] else None
        return (d_inputs, dfed[:, : D * n].mT, d_hidden, d_cell, None, None, *head, *out)
