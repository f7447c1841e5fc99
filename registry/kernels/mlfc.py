"""Multi-layer fully connected RNN: the whole sequence in one call, hand-written BPTT.

Equations: paper, eqs. LRLayer and layerinput. One buffer S holds [u_k | ỹ_{k−1} | 1 | y¹ .. y^L]; layers overwrite
their own rows in turn, so layer l reads y^j_k of the layers before it, y^j_{k−1} of itself and those after it: the
forward and backward skip connections of the paper are the plain content of S. Leading model dimension M and
feature-major arrays as in `registry.kernels.lstm`.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch import Tensor

from registry.kernels import plain
from registry.kernels.native import library
from registry.kernels.native import mlfc as native
from registry.kernels.native.call import called
from registry.kernels.pointwise import dropout_mask, in_whole_vectors, pad16, tanh_, tanh_grad


def mlfc(
    inputs: Tensor,
    fed: Tensor,
    hidden: Tensor,
    layers: list[Tensor],
    readout: Tensor,
    forced: Tensor | None = None,
    dropout: float = 0.0,
) -> tuple[Tensor, Tensor]:
    """Run T steps, of M models or, where no argument has a model dimension, of one.

    Args:
        inputs: (M, B, T, m).
        fed: (M, B, n) output before the run.
        hidden: (M, B, L·H) layer outputs before the run.
        layers: L weights (M, H, S) over the columns [u | ỹ | 1 | y¹ .. y^L] of the buffer, S = m + n + 1 + L·H.
        readout: (M, n, S) over the same columns.
        forced: (M, B, T, n) outputs that are fed back in place of the network's own.
        dropout: probability of dropping a layer output on its way to the read-out.

    Returns:
        outputs (M, B, T, n) and hidden (M, B, L·H) after the run.
    """
    if plain.exporting():
        outputs, end = plain.mlfc(inputs, torch.cat([fed, hidden], -1), forced, layers, readout)
        return outputs, end[..., fed.shape[-1] :]
    core, mask = library.core_for(inputs, fed, hidden, forced, readout, *layers), _mask(dropout, inputs, hidden)
    if core is not None:
        make = partial(native.MlfcCall, core, forced=forced, mask=mask)
        return called(make, (inputs, fed, hidden), [*layers, readout])

    def run(
        inputs: Tensor, fed: Tensor, hidden: Tensor, forced: Tensor | None, weights: list[Tensor]
    ) -> tuple[Tensor, Tensor]:
        done: tuple[Tensor, Tensor] = _MLFC.apply(inputs, fed, hidden, forced, mask, *weights)
        return done

    return in_whole_vectors(run, (inputs, fed, hidden, forced), [readout, *layers])


VJP = Callable[[Tensor, Tensor], tuple[Tensor, Tensor, list[Tensor]]]
"""From the gradients of outputs and hidden after a run to those of fed and hidden before it, of layers and readout."""


def mlfc_vjp(
    inputs: Tensor,
    fed: Tensor,
    hidden: Tensor,
    layers: list[Tensor],
    readout: Tensor,
    forced: Tensor | None = None,
    dropout: float = 0.0,
) -> tuple[Tensor, Tensor, VJP]:
    """`mlfc` on the compiled core without autograd, and its vector-Jacobian product, to be called at most once."""
    core = library.core_for(inputs, fed, hidden, forced, readout, *layers)
    assert core is not None
    mask = _mask(dropout, inputs, hidden)
    run = native.MlfcCall(
        core, inputs, fed, hidden=hidden, forced=forced, mask=mask, weights=[*layers, readout], keep=True
    )
    outputs, end = run.forward()

    def vjp(d_outputs: Tensor, d_end: Tensor) -> tuple[Tensor, Tensor, list[Tensor]]:
        _, d_fed, d_hidden, *gradients = run.backward(d_outputs, d_end)
        return d_fed, d_hidden, gradients

    return outputs, end, vjp


def _mask(dropout: float, inputs: Tensor, hidden: Tensor) -> Tensor | None:
    *lead, batch, steps, _ = inputs.shape
    return dropout_mask(dropout, inputs, steps, lead[0] if lead else 1, hidden.shape[-1], batch + -batch % 32)


class _MLFC(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        inputs: Tensor,
        fed: Tensor,
        hidden: Tensor,
        forced: Tensor | None,
        mask: Tensor | None,
        readout: Tensor,
        *layers: Tensor,
    ) -> tuple[Tensor, Tensor]:
        M, B, T, m = inputs.shape
        n, H, L = readout.shape[-2], layers[0].shape[-2], len(layers)
        first = m + n + 1  # row of y¹
        K = pad16(first + L * H)
        new: dict[str, Any] = {"dtype": inputs.dtype, "device": inputs.device}

        def padded(w: Tensor, rows: int) -> Tensor:
            out = torch.zeros(M, rows, K, **new)
            out[:, : w.shape[1], : w.shape[2]] = w
            return out

        W = [padded(w, H) for w in layers]
        wo = padded(readout, pad16(n))
        X = torch.zeros(L + 1, T, M, K, B, **new)  # S as layer l of step t sees it; [L]: as the read-out sees it
        S = torch.zeros(M, K, B, **new)
        S[:, m : m + n], S[:, m + n], S[:, first : first + L * H] = fed.mT, 1, hidden.mT
        U = inputs.permute(2, 0, 3, 1)
        Y = torch.empty(T, M, wo.shape[1], B, **new)
        H_out = torch.empty(T, M, L * H, B, **new)
        for t in range(T):
            S[:, :m] = U[t]
            for i in range(L):
                X[i, t] = S
                y = tanh_(torch.bmm(W[i], X[i, t]))
                S[:, first + i * H : first + (i + 1) * H] = y
            X[L, t] = S
            H_out[t] = S[:, first : first + L * H]
            if mask is not None:
                X[L, t, :, first : first + L * H].mul_(mask[t])
            torch.bmm(wo, X[L, t], out=Y[t])
            S[:, m : m + n] = Y[t][:, :n] if forced is None else forced[:, :, t].mT
        ctx.kept = (X, W, wo, H_out, mask, m, n, forced is not None)
        last = S[:, first : first + L * H].mT
        return Y[:, :, :n].permute(1, 3, 0, 2).contiguous(), last.contiguous()

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        dY_, dh_ = grads
        X, W, wo, H_out, mask, m, n, was_forced = ctx.kept
        L, (T, M, K, B), H = len(W), X.shape[1:], W[0].shape[1]
        first = m + n + 1
        new: dict[str, Any] = {"dtype": X.dtype, "device": X.device}
        dY = torch.zeros(T, M, wo.shape[1], B, **new)
        dY[:, :, :n] = dY_.permute(2, 0, 3, 1)
        dU = torch.empty(T, M, m, B, **new)
        dW, dwo = [torch.zeros_like(w) for w in W], torch.zeros_like(wo)
        dS, dR = torch.zeros(M, K, B, **new), torch.empty(M, K, B, **new)
        hidden_rows = slice(first, first + L * H)
        dS[:, hidden_rows] = dh_.mT
        dfed = torch.zeros(M, n, B, **new)
        for t in range(T - 1, -1, -1):
            torch.bmm(wo.mT, dY[t], out=dR)
            dwo.baddbmm_(dY[t], X[L, t].mT)
            if mask is not None:
                dR[:, hidden_rows].mul_(mask[t])
            dS.add_(dR)
            for i in range(L - 1, -1, -1):
                own = slice(first + i * H, first + (i + 1) * H)
                g = torch.empty(M, H, B, **new)
                tanh_grad(dS[:, own].contiguous(), H_out[t, :, i * H : (i + 1) * H], grad_input=g)
                dS[:, own] = 0
                dS.baddbmm_(W[i].mT, g)
                dW[i].baddbmm_(g, X[i, t].mT)
            dU[t] = dS[:, :m]
            if t == 0:
                dfed += dS[:, m : m + n]
            elif not was_forced:
                dY[t - 1, :, :n] += dS[:, m : m + n]
            dS[:, :first] = 0
        width = first + L * H
        return (
            dU.permute(1, 3, 0, 2),
            dfed.mT,
            dS[:, hidden_rows].mT,
            None,
            None,
            dwo[:, :n, :width],
            *(d[..., :width] for d in dW),
        )
