"""Stacked GRU with delayed output feedback: the whole sequence in one call, hand-written BPTT.

Equations: Cho et al. (2014), in the form of the first version of their paper (arXiv:1406.1078v1): the reset gate
acts after the recurrent product, so that one product a step serves all gates. With x_k the input of a layer,

    r = σ(W_r x_k + U_r h_{k−1} + b_r)        z = σ(W_z x_k + U_z h_{k−1} + b_z)
    v = tanh(W_v x_k + b_v + r ∘ U_v h_{k−1})  h_k = z ∘ h_{k−1} + (1 − z) ∘ v

Leading model dimension M and feature-major arrays as in `registry.kernels.lstm`.
"""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from registry.kernels import plain
from registry.kernels.pointwise import in_whole_vectors, pad16, sigmoid_grad, tanh_, tanh_grad


@dataclass(frozen=True)
class Layer:
    """Weights of one layer: input (M, 3H, K), recurrent (M, 3H, H), bias (M, 3H).

    Rows: reset gate r, update gate z, candidate v. The K columns of the first layer: inputs, then fed-back outputs.
    """

    input: Tensor
    recurrent: Tensor
    bias: Tensor


def gru(
    inputs: Tensor,
    fed: Tensor,
    hidden: Tensor,
    layers: list[Layer],
    output_weight: Tensor,
    output_bias: Tensor,
    forced: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Run T steps, of M models or, where no argument has a model dimension, of one.

    Args:
        inputs: (M, B, T, m).
        fed: (M, B, n) output before the run.
        hidden: (M, B, L·H) states before the run.
        layers: L layers.
        output_weight, output_bias: (M, n, H), (M, n) linear read-out of the last layer.
        forced: (M, B, T, n) outputs that are fed back in place of the network's own.

    Returns:
        outputs (M, B, T, n) and hidden (M, B, L·H) after the run.
    """
    if plain.exporting():
        weights = [(layer.input, layer.recurrent, layer.bias) for layer in layers]
        state = torch.cat([fed, hidden], -1)
        outputs, end = plain.gru(inputs, state, forced, layers=weights, read=(output_weight, output_bias))
        return outputs, end[..., fed.shape[-1] :]

    def run(*arrays: Any) -> tuple[Tensor, Tensor]:
        done: tuple[Tensor, Tensor] = _GRU.apply(*arrays[:-1], *arrays[-1])
        return done

    flat = [w for layer in layers for w in (layer.input, layer.recurrent, layer.bias)]
    return in_whole_vectors(run, (inputs, fed, hidden, forced), [output_weight, output_bias, *flat])


class _GRU(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        inputs: Tensor,
        fed: Tensor,
        hidden: Tensor,
        forced: Tensor | None,
        w_out: Tensor,
        b_out: Tensor,
        *flat: Tensor,
    ) -> tuple[Tensor, Tensor]:
        M, B, T, m = inputs.shape
        L, H, n = len(flat) // 3, flat[1].shape[-1], w_out.shape[-2]
        new: dict[str, Any] = {"dtype": inputs.dtype, "device": inputs.device}
        # operands of the product, rows of layer 0: [h | ỹ | u | 1 | 0..], of the others: [h | below | 1 | 0..];
        # its results: [r | z | U_v h | W_v x + b_v]
        X, W = [], []
        for i in range(L):
            w_in, w_rec, bias = flat[3 * i : 3 * i + 3]
            k = w_in.shape[-1]
            x = torch.zeros(T + 1, M, pad16(H + k + 1), B, **new)
            x[:, :, H + k] = 1
            x[0, :, :H] = hidden[..., i * H : (i + 1) * H].mT
            w = torch.zeros(M, 4 * H, x.shape[2], **new)
            w_in = torch.cat([w_in[..., m:], w_in[..., :m]], -1) if i == 0 else w_in
            w[:, : 3 * H, :H] = w_rec
            for rows, of in ((slice(2 * H), slice(2 * H)), (slice(3 * H, 4 * H), slice(2 * H, 3 * H))):
                w[:, rows, H : H + k], w[:, rows, H + k] = w_in[:, of], bias[:, of]
            X.append(x)
            W.append(w)
        X[0][:T, :, H + n : H + n + m] = inputs.permute(2, 0, 3, 1)
        X[0][0, :, H : H + n] = fed.mT
        if forced is not None:
            X[0][1:T, :, H : H + n] = forced[:, :, : T - 1].permute(2, 0, 3, 1)
        G = torch.empty(L, T, M, 4 * H, B, **new)
        Y = torch.empty(T, M, pad16(n), B, **new)
        wo, bo = torch.zeros(M, pad16(n), H, **new), torch.zeros(M, pad16(n), 1, **new)
        wo[:, :n], bo[:, :n, 0] = w_out, b_out
        for t in range(T):
            for i in range(L):
                g, h0, h1 = G[i, t], X[i][t][:, :H], X[i][t + 1][:, :H]
                torch.bmm(W[i], X[i][t], out=g)
                r, z, q, v = g.split(H, 1)
                g[:, : 2 * H].sigmoid_()
                tanh_(v.addcmul_(r, q))
                torch.sub(h0, v, out=h1).mul_(z).add_(v)
                if i + 1 < L:
                    X[i + 1][t][:, H : 2 * H] = h1
            torch.baddbmm(bo, wo, h1, out=Y[t])
            if forced is None and t + 1 < T:
                X[0][t + 1][:, H : H + n] = Y[t][:, :n]
        ctx.kept = (X, W, G, wo, n, m, forced is not None)
        last = torch.cat([x[T, :, :H] for x in X], 1).mT
        return Y[:, :, :n].permute(1, 3, 0, 2).contiguous(), last.contiguous()

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        dY_, dh_ = grads
        X, W, G, wo, n, m, was_forced = ctx.kept
        L, T, M, H4, B = G.shape
        H = H4 // 4
        new: dict[str, Any] = {"dtype": G.dtype, "device": G.device}
        dW, dwo = [torch.zeros_like(w) for w in W], torch.zeros_like(wo)
        dX = [torch.zeros_like(x[0]) for x in X]  # its first H rows: what reaches h_k from step k+1
        for i in range(L):
            dX[i][:, :H] = dh_[..., i * H : (i + 1) * H].mT
        dY = torch.zeros(T, M, wo.shape[1], B, **new)
        dY[:, :, :n] = dY_.permute(2, 0, 3, 1)
        dU = torch.empty(T, M, m, B, **new)
        dh, dg = torch.empty(M, H, B, **new), torch.empty(M, 4 * H, B, **new)
        dr, dz, dq, dv = dg.split(H, 1)
        WT, woT = [w.mT for w in W], wo.mT
        for t in range(T - 1, -1, -1):
            for i in range(L - 1, -1, -1):
                r, z, q, v = G[i, t].split(H, 1)
                h0 = X[i][t][:, :H]
                if i == L - 1:
                    torch.bmm(woT, dY[t], out=dh)
                    dwo.baddbmm_(dY[t], X[i][t + 1][:, :H].mT)
                else:
                    dh.copy_(dX[i + 1][:, H : 2 * H])
                dh.add_(dX[i][:, :H])
                torch.sub(h0, v, out=dz).mul_(dh)
                sigmoid_grad(dz, z, grad_input=dz)
                torch.mul(dh, z, out=dq)  # the share of h_{k−1}; dq is free until below
                torch.sub(dh, dq, out=dv)
                dh.copy_(dq)
                tanh_grad(dv, v, grad_input=dv)
                torch.mul(dv, q, out=dr)
                sigmoid_grad(dr, r, grad_input=dr)
                torch.mul(dv, r, out=dq)
                torch.bmm(WT[i], dg, out=dX[i])
                dX[i][:, :H].add_(dh)
                dW[i].baddbmm_(dg, X[i][t].mT)
            dU[t] = dX[0][:, H + n : H + n + m]
            if t and not was_forced:
                dY[t - 1, :, :n] += dX[0][:, H : H + n]
        out: list[Tensor | None] = []
        for i, d in enumerate(dW):
            k = n + m if i == 0 else H
            rows = torch.cat([d[:, : 2 * H, H:], d[:, 3 * H :, H:]], 1)  # of the input's weights and the bias
            d_in = rows[..., :k]
            out += [torch.cat([d_in[..., n:], d_in[..., :n]], -1) if i == 0 else d_in, d[:, : 3 * H, :H], rows[..., k]]
        d_hidden = torch.cat([x[:, :H] for x in dX], 1).mT
        # one contiguous row an output: the order of the sum does not depend on M
        d_bias = dY.permute(1, 2, 0, 3).flatten(-2).sum(-1)[:, :n]
        return (dU.permute(1, 3, 0, 2), dX[0][:, H : H + n].mT, d_hidden, None, dwo[:, :n], d_bias, *out)
