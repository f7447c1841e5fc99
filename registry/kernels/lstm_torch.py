"""The stacked LSTM of `registry.kernels.lstm` in PyTorch: on any device, and where there is no compiler.

Models of one shape run side by side in batched products. Arrays are feature-major (…, features, batch), so that every
gate is one contiguous block.
"""

from typing import Any

import torch
from torch import Tensor

from registry.kernels.pointwise import pad16, pad_batch, sigmoid_grad, tanh_, tanh_grad


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
        X, W = [], []
        for i in range(L):
            w_in, w_rec, bias = flat[4 * i : 4 * i + 3]
            k = w_in.shape[-1]
            K = pad16(H + k + 1)
            x = torch.zeros(T + 1, M, K, B, **new)
            x[:, :, H + k] = 1
            w = torch.zeros(M, 4 * H, K, **new)
            w[..., :H] = w_rec
            w[..., H : H + k] = torch.cat([w_in[..., m:], w_in[..., :m]], -1) if i == 0 else w_in
            w[..., H + k] = bias
            x[0, :, :H] = hidden[..., i * H : (i + 1) * H].mT
            X.append(x)
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
        G = torch.empty(L, T, M, 4 * H, B, **new)
        C = torch.empty(L, T + 1, M, H, B, **new)
        TC = torch.empty(L, T, M, H, B, **new)
        V = torch.empty(L, T, M, H, B, **new) if mask is not None else None  # what goes up, after dropout
        C[:, 0] = cell.unflatten(-1, (L, H)).permute(2, 0, 3, 1)
        n_pad = pad16(n) if n else 0
        Y = torch.empty(T, M, n_pad, B, **new)
        wo = torch.zeros(M, n_pad, H, **new)
        bo = torch.zeros(M, n_pad, 1, **new)
        if w_out is not None and b_out is not None:
            wo[:, :n], bo[:, :n, 0] = w_out, b_out
        peep_if = [flat[4 * i + 3][:, :2].reshape(M, 2 * H, 1) for i in range(L)]
        peep_o = [flat[4 * i + 3][:, 2].unsqueeze(-1) for i in range(L)]
        for t in range(T):
            for i in range(L):
                g, c0, c1, tc = G[i, t], C[i, t], C[i, t + 1], TC[i, t]
                torch.bmm(W[i], X[i][t], out=g)
                g[:, :H].addcmul_(c0, peep_if[i][:, :H])
                g[:, H : 2 * H].addcmul_(c0, peep_if[i][:, H:])
                g[:, : 2 * H].sigmoid_()
                tanh_(g[:, 2 * H : 3 * H])
                torch.mul(g[:, H : 2 * H], c0, out=c1).addcmul_(g[:, :H], g[:, 2 * H : 3 * H])
                o = g[:, 3 * H :].addcmul_(c1, peep_o[i]).sigmoid_()
                tanh_(tc.copy_(c1))
                up = torch.mul(o, tc, out=X[i][t + 1][:, :H])
                if V is not None and mask is not None:
                    up = torch.mul(up, mask[i, t], out=V[i, t])
                if i + 1 < L:
                    X[i + 1][t][:, H : 2 * H] = up
            if n:
                torch.baddbmm(bo, wo, up, out=Y[t])
                if forced is None:
                    for d in range(min(D, T - 1 - t)):
                        X[0][t + 1 + d][:, rows[d]] = Y[t][:, :n]
        ctx.save_for_backward(*flat)
        ctx.kept = (X, W, G, C, TC, V, mask, wo, D, n, m, forced is not None)
        last = torch.cat([x[T, :, :H] for x in X], 1).mT
        outputs = Y[:, :, :n].permute(1, 3, 0, 2)
        return outputs.contiguous(), last.contiguous(), C[:, T].permute(1, 3, 0, 2).flatten(-2).contiguous()

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        dY_, dh_, dc_ = grads
        flat = ctx.saved_tensors
        X, W, G, C, TC, V, mask, wo, D, n, m, was_forced = ctx.kept
        L, T, M, H4, B = G.shape
        H = H4 // 4
        new: dict[str, Any] = {"dtype": G.dtype, "device": G.device}
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
        d_peep = torch.zeros(L, 3, M, H, B, **new)
        WT, woT = [w.mT for w in W], wo.mT
        peep = [[flat[4 * i + 3][:, j].unsqueeze(-1) for j in range(3)] for i in range(L)]
        for t in range(T - 1, -1, -1):
            for i in range(L - 1, -1, -1):
                g, c0, tc, dc = G[i, t], C[i, t], TC[i, t], dC[i]
                gi, gf, gc, go = g[:, :H], g[:, H : 2 * H], g[:, 2 * H : 3 * H], g[:, 3 * H :]
                up = V[i, t] if V is not None else X[i][t + 1][:, :H]
                if i < L - 1:
                    dm.copy_(dX[i + 1][:, H : 2 * H])
                elif n:
                    torch.bmm(woT, dY[t], out=dm)
                    dwo.baddbmm_(dY[t], up.mT)
                else:
                    dm.zero_()
                if mask is not None:
                    dm.mul_(mask[i, t])
                dm.add_(dX[i][:, :H])
                tanh_grad(torch.mul(dm, go, out=do), tc, grad_input=do)
                dc.add_(do)
                sigmoid_grad(dm.mul_(tc), go, grad_input=do)
                dc.addcmul_(do, peep[i][2])
                sigmoid_grad(torch.mul(dc, gc, out=di), gi, grad_input=di)
                tanh_grad(torch.mul(dc, gi, out=dz), gc, grad_input=dz)
                sigmoid_grad(torch.mul(dc, c0, out=df), gf, grad_input=df)
                dc.mul_(gf).addcmul_(di, peep[i][0]).addcmul_(df, peep[i][1])
                d_peep[i, 0].addcmul_(di, c0)
                d_peep[i, 1].addcmul_(df, c0)
                d_peep[i, 2].addcmul_(do, C[i, t + 1])
                torch.bmm(WT[i], dg, out=dX[i])
                dW[i].baddbmm_(dg, X[i][t].mT)
            dU[t] = dX[0][:, H + D * n : H + D * n + m]
            for d in range(D):
                source, from_row = t - d - 1, dX[0][:, H + d * n : H + (d + 1) * n]
                if source < 0:
                    dfed[:, (d - t) * n : (d - t + 1) * n] += from_row
                elif not was_forced:
                    dY[source, :, :n] += from_row
        out: list[Tensor | None] = []
        for i in range(L):
            k = flat[4 * i].shape[-1]
            d_in = dW[i][..., H : H + k]
            if i == 0:
                d_in = torch.cat([d_in[..., k - m :], d_in[..., : k - m]], -1)
            out += [d_in, dW[i][..., :H], dW[i][..., H + k], d_peep[i].sum(-1).transpose(0, 1)]
        head: list[Tensor | None] = [None, None]
        if n:
            # one contiguous row an output: the order of the sum does not depend on M
            head = [dwo[:, :n], dY.permute(1, 2, 0, 3).flatten(-2).sum(-1)[:, :n]]
        d_hidden = torch.cat([x[:, :H] for x in dX], 1).mT
        d_cell = torch.cat(dC, 1).mT
        return (dU.permute(1, 3, 0, 2), dfed[:, : D * n].mT, d_hidden, d_cell, None, None, *head, *out)
