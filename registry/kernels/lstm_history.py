"""What `registry.kernels.lstm_torch` writes: arrays, and a view of every piece that its loops touch.

Views cost as much as the operations of a thin network, so both are made once for all calls of a shape. Arrays are
feature-major (…, features, batch). Outputs and inputs are kept with those before the run, the latest first: the D taps
of a step are neighbours.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from registry.kernels.pointwise import pad16, sigmoid_grad, tanh_grad

CHUNK = 1 << 18
"""Numbers of a layer's gates that the way back takes at once, while they are in the cache."""


@dataclass(frozen=True)
class Shape:
    """Models, windows, steps, inputs, outputs, delays, layers and cells of a call."""

    M: int
    B: int
    T: int
    m: int
    n: int
    D: int
    L: int
    H: int
    masked: bool
    """Whether there is dropout."""

    @property
    def fed(self) -> int:
        """Rows of the first layer's operand before those of the inputs."""
        return self.H + self.D * self.n

    @property
    def outputs(self) -> int:
        """Rows of the read-out."""
        return pad16(self.n) if self.n else 0

    def entering(self, layer: int) -> int:
        """Rows that enter a layer."""
        return self.H if layer else self.D * (self.m + self.n)

    def width(self, layer: int) -> int:
        """Rows of a layer's operand."""
        return pad16(self.H + self.entering(layer) + 1)

    @property
    def chunk(self) -> int:
        """Steps that the way back takes at once; the same for any number of models."""
        return min(self.T, max(1, CHUNK // (4 * self.H * self.B)))


class History:
    """Of the way forward.

    x: operands (T + 1, M, K, B) of each layer's gate product, rows [m | D·ỹ | D·u | 1 | 0..] in the first layer and
    [m | what the layer below passes up | 1 | 0..] in the others. g: gates (T, M, 5H, B): i, f, z, o and, beside them,
    tanh c. c: cells (T + 1, M, H, B). y: outputs (T + D, M, .., B), v: what goes up after dropout (L, T, M, H, B).
    """

    def __init__(self, s: Shape, like: Tensor) -> None:
        M, B, T, L, H = s.M, s.B, s.T, s.L, s.H
        self.s, new = s, like.detach().new_empty
        self.x, self.g, self.c = [], [new(T, M, 5 * H, B) for _ in range(L)], [new(T + 1, M, H, B) for _ in range(L)]
        for i in range(L):
            k = H + s.entering(i)
            self.x.append(new(T + 1, M, s.width(i), B))
            self.x[i][:, :, k:] = 0
            self.x[i][:, :, k] = 1
        self.y, self.v = new(T + s.D, M, s.outputs, B), new(L, T, M, H, B if s.masked else 0)
        self.fed = self.y[:, :, : s.n]
        self.tanh_c = [g[:, :, 4 * H :] for g in self.g]
        self.u_rows = [self.x[0][:T, :, s.fed + d * s.m : s.fed + (d + 1) * s.m] for d in range(s.D)]
        taps = self.x[0][:T, :, H : s.fed].unflatten(2, (s.D, s.n)).transpose(1, 2) if s.n else None
        self.taps = [] if taps is None else list(taps.unbind(1))  # (T, M, n, B) each
        self.seen = [] if taps is None else list(taps.unbind(0))
        self.windows = [self.fed[T - t : T - t + s.D] for t in range(T)]
        self.output_at = self.y.unbind(0)
        self.tops = self.v[-1] if s.masked else self.x[-1][1:, :, :H]  # (T, M, H, B)
        self.steps = list(zip(*(self._views(i) for i in range(L)), strict=True))

    def _views(self, i: int) -> list[tuple[Tensor | None, ...]]:
        """What layer i touches, step by step."""
        H, x, g, c = self.s.H, self.x[i], self.g[i], self.c[i]
        gates = g.unflatten(2, (5, H))
        above = self.x[i + 1][: self.s.T, :, H : 2 * H].unbind(0) if i + 1 < self.s.L else [None] * self.s.T
        dropped = self.v[i].unbind(0)
        pieces = (x[:-1], g[:, :, : 4 * H], gates[:, :, :2], g[:, :, : 3 * H], gates[:, :, 3:])
        more = (*gates.unbind(2), c[:-1], c[:-1].unsqueeze(2), c[1:], c[1:].unsqueeze(2), x[1:, :, :H])
        return list(zip(*(p.unbind(0) for p in (*pieces, *more)), above, dropped, strict=True))


class Back:
    """Of the way back, a chunk of t steps at a time.

    dg: gradients of the gates before their nonlinearity (t, M, 4, H, B); x, c, m: of the operands (M, K, B), cells and
    outputs (M, H, B) where the way back now is; y, u: of outputs and inputs, kept like these.
    """

    def __init__(self, s: Shape, like: Tensor) -> None:
        M, B, T, H, t = s.M, s.B, s.T, s.H, s.chunk
        widths, self.s, new = [s.width(i) for i in range(s.L)], s, like.detach().new_zeros
        self.y, self.u = new(T + s.D, M, s.outputs, B), new(T + s.D - 1, M, s.m, B)
        self.x, self.c, self.m = [new(M, k, B) for k in widths], [new(M, H, B) for _ in widths], new(M, H, B)
        self.dg, self.slopes = [new(t, M, 4, H, B) for _ in widths], [new(2, t, M, H, B) for _ in widths]
        self.peepholes = new(M, 3, H, t, B)
        self.tops, self.outputs = new(M, H, T, B), new(M, s.outputs, T, B)
        self.output_at, self.own, self.below = (
            self.y.unbind(0),
            [x[:, :H] for x in self.x],
            [x[:, H : 2 * H] for x in self.x],
        )
        y_rows, u_rows = self.x[0][:, H : s.fed], self.x[0][:, s.fed : s.fed + s.D * s.m]
        self.from_y = y_rows.unflatten(1, (s.D, s.n)).transpose(0, 1) if s.n else None
        self.from_u = u_rows.unflatten(1, (s.D, s.m)).transpose(0, 1) if s.m else None
        self.to_y = [self.y[T - k : T - k + s.D, :, : s.n] for k in range(T)]
        self.to_u = [self.u[T - 1 - k : T - 1 - k + s.D] for k in range(T)]
        each = [
            zip(
                *(k.unbind(0) for k in (d[:, :, 3], d[:, :, :3], d.flatten(2, 3), *slopes)),
                strict=True,
            )
            for d, slopes in zip(self.dg, self.slopes, strict=True)
        ]
        self.steps = list(zip(*each, strict=True))

    def begin(self, given: Tensor | None, ends: Tensor | None, d_fed: Tensor) -> None:
        """From the gradients of the outputs (M, B, T, n) and of the state after the run; d_fed: of what is fed back."""
        s = self.s
        for x in (self.y, self.u, *self.x, *self.c):
            x.zero_()
        if s.n and given is not None:
            self.y[: s.T, :, : s.n] = given.permute(2, 0, 3, 1).flip(0)
        if ends is None:
            return
        u, y, hidden, cell = ends.split([(s.D - 1) * s.m, s.D * s.n, s.L * s.H, s.L * s.H], -1)
        if s.D > 1 and s.m:
            self.u[: s.D - 1] = before(u, s.D - 1)
        if s.n:
            d_fed[: s.D] += before(y, s.D)
        for i in range(s.L):
            rows = slice(i * s.H, (i + 1) * s.H)
            self.own[i].copy_(hidden[..., rows].mT), self.c[i].copy_(cell[..., rows].mT)

    def meet(self, h: History, i: int, steps: slice, peep_i: Tensor, peep_f: Tensor, peep_o: Tensor) -> None:
        """What the gradients of layer i are multiplied by at these steps.

        dg is set to dc / di, dc / df, dc / dz and dm / do, the slopes to dm / dc by both of its ways and to dc / dc of
        the step before.
        """
        t = steps.stop - steps.start
        (gi, gf, z, o, tc), c0 = h.g[i][steps].unflatten(2, (5, h.s.H)).unbind(2), h.c[i][steps]
        di, df, dz, do = self.dg[i][:t].unbind(2)
        through, carried = self.slopes[i][:, :t].unbind(0)
        sigmoid_grad(z, gi, grad_input=di)
        sigmoid_grad(c0, gf, grad_input=df)
        tanh_grad(gi, z, grad_input=dz)
        sigmoid_grad(tc, o, grad_input=do)
        tanh_grad(o, tc, grad_input=through).addcmul_(do, peep_o)
        torch.addcmul(gf, di, peep_i, out=carried).addcmul_(df, peep_f)

    def peephole_gradient(self, h: History, i: int, steps: slice) -> Tensor:
        """(M, 3, H) of layer i; a row a peephole is summed: its order does not depend on M."""
        c, t = h.c[i], steps.stop - steps.start
        dg, to = self.dg[i][:t].permute(1, 2, 3, 0, 4), self.peepholes[:, :, :, :t]
        torch.mul(dg[:, :2], side_by_side(c[steps]).unsqueeze(1), out=to[:, :2])
        torch.mul(dg[:, 3], side_by_side(c[steps.start + 1 : steps.stop + 1]), out=to[:, 2])
        return to.flatten(-2).sum(-1)

    def look(self, h: History) -> None:
        """What the read-out saw at every step, and the gradients of what it said."""
        self.tops.copy_(side_by_side(h.tops))
        self.outputs.copy_(side_by_side(self.y[: self.s.T].flip(0)))


def before(x: Tensor, count: int) -> Tensor:
    """(M, B, count·r) → (count, M, r, B)."""
    return x.unflatten(-1, (count, -1)).permute(2, 0, 3, 1)


def side_by_side(x: Tensor) -> Tensor:
    """(t, M, r, B) → (M, r, t, B)."""
    return x.permute(1, 2, 0, 3)
