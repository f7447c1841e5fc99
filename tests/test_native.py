"""Both kernels of the LSTM against the equations step by step, the native hybrid against its loop, and the library."""

import logging
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import pytest
import test_hybrid
import torch
from networks import noise, vivid
from torch import Tensor

from registry.errors import BenchError
from registry.kernels import lstm_torch
from registry.kernels.lstm import Layer, lstm
from registry.kernels.native import library
from registry.kernels.pointwise import in_whole_vectors
from registry.predictors import hybrid

F32, F64 = torch.float32, torch.float64
KERNELS = ("native", "pytorch")


@contextmanager
def kernel(name: str) -> Iterator[None]:
    """What is asked of the environment when a kernel is first looked for."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BENCH_KERNEL", name)
        library._chosen.cache_clear()
        try:
            try:
                library.core()
            except BenchError as reason:
                pytest.skip(str(reason))
            yield
        finally:
            library._chosen.cache_clear()


@dataclass(frozen=True)
class Case:
    layers: int = 1
    cells: int = 5
    inputs: int = 3
    outputs: int = 2
    taps: int = 1
    batch: int = 3
    steps: int = 7
    models: int = 1
    forced: bool = False
    dropout: float = 0.0

    @property
    def sizes(self) -> list[int]:
        """Of the parts of a state: past inputs, past outputs, hidden and cell states."""
        states = self.layers * self.cells
        return [(self.taps - 1) * self.inputs, self.taps * self.outputs, states, states]

    def arrays(self, dtype: torch.dtype, seed: int = 0) -> dict[str, Tensor]:
        draw = torch.Generator().manual_seed(seed)
        M, B, T, L, H, n = self.models, self.batch, self.steps, self.layers, self.cells, self.outputs
        shapes = {"inputs": (M, B, T, self.inputs), "state": (M, B, sum(self.sizes))}
        for layer in range(L):
            k = H if layer else self.taps * (self.inputs + n)
            shapes |= {f"input{layer}": (M, 4 * H, k), f"recurrent{layer}": (M, 4 * H, H)}
            shapes |= {f"bias{layer}": (M, 4 * H), f"peephole{layer}": (M, 3, H)}
        if n:
            shapes |= {"output_weight": (M, n, H), "output_bias": (M, n), "forced": (M, B, T, n)}
        spread = {"inputs": 1.0, "state": 0.7, "forced": 1.0}
        made = {k: torch.randn(s, generator=draw, dtype=F64) * spread.get(k, 0.8 / H**0.5) for k, s in shapes.items()}
        return {k: x.to(dtype).requires_grad_(k != "forced") for k, x in made.items()}

    def layer(self, a: dict[str, Tensor], i: int) -> Layer:
        return Layer(a[f"input{i}"], a[f"recurrent{i}"], a[f"bias{i}"], a[f"peephole{i}"])

    def run(self, a: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        torch.manual_seed(5)
        layers = [self.layer(a, i) for i in range(self.layers)]
        forced = a["forced"] if self.forced else None
        head = (a.get("output_weight"), a.get("output_bias"))
        return lstm(a["inputs"], a["state"], layers, *head, forced, self.dropout, self.taps)

    def naive(self, a: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """The equations, a model, a step, a layer and a gate at a time, under autograd."""
        torch.manual_seed(5)
        size = (self.layers, self.steps, self.models, self.cells, self.batch + -self.batch % 32)
        keep = torch.full(size, 1 - self.dropout, dtype=a["inputs"].dtype)
        mask = torch.bernoulli(keep) / (1 - self.dropout) if self.dropout else keep
        runs = []
        for q in range(self.models):
            past_u, past_y, *states = a["state"][q].split(self.sizes, -1)
            m, c = (list(s.split(self.cells, -1)) for s in states)
            fed = list(past_y.split(self.outputs, -1)) if self.outputs else []
            driven = list(past_u.split(self.inputs, -1)) if self.inputs and self.taps > 1 else []
            outputs = []
            for t in range(self.steps):
                driven = [a["inputs"][q, :, t], *driven]
                below = torch.cat([*driven, *fed], -1)
                driven = driven[: self.taps - 1]
                for i in range(self.layers):
                    w, u, b, p = (x[q] for x in vars(self.layer(a, i)).values())
                    gi, gf, gz, go = (below @ w.T + m[i] @ u.T + b).split(self.cells, -1)
                    before = c[i]
                    c[i] = torch.sigmoid(gf + p[1] * before) * before + torch.sigmoid(gi + p[0] * before) * gz.tanh()
                    m[i] = torch.sigmoid(go + p[2] * c[i]) * c[i].tanh()
                    below = m[i] * mask[i, t, q, :, : self.batch].T
                if self.outputs:
                    outputs.append(below @ a["output_weight"][q].T + a["output_bias"][q])
                    fed = [a["forced"][q, :, t] if self.forced else outputs[-1], *fed][: self.taps]
            y = torch.stack(outputs, 1) if outputs else a["inputs"][q, ..., :0]
            runs.append((y, torch.cat([*driven, *fed, *m, *c], -1)))
        y, state = (torch.stack(x) for x in zip(*runs, strict=True))
        return y, state


CASES = [
    Case(),
    Case(layers=2, cells=8, taps=3, batch=33),
    Case(layers=3, cells=7, taps=10, batch=70, steps=4, models=2),
    Case(layers=2, cells=12, forced=True, steps=9),
    Case(layers=2, cells=4, taps=2, dropout=0.4, batch=40),
    Case(inputs=4, outputs=0, cells=50, batch=64, steps=6),
    Case(inputs=0, cells=1, batch=1, steps=1),
    Case(layers=2, inputs=29, taps=1, cells=30, batch=20, outputs=13, steps=5),
    Case(cells=50, steps=30, batch=64, outputs=3, inputs=4),
]


def gradients(run: Callable[[dict[str, Tensor]], tuple[Tensor, ...]], a: dict[str, Tensor]) -> dict[str, Tensor]:
    made = run(a)
    draw = torch.Generator().manual_seed(9)
    cost = sum((x * torch.randn(x.shape, generator=draw, dtype=F64).to(x)).sum() for x in made)
    names = [k for k, x in a.items() if x.requires_grad]
    return dict(
        zip(
            names,
            torch.autograd.grad(cost, [a[k] for k in names], allow_unused=True, materialize_grads=True),
            strict=True,
        )
    )


def distance(x: Tensor, exact: Tensor) -> float:
    return float((x.double() - exact).detach().norm() / exact.detach().norm()) if exact.numel() else 0.0


@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.parametrize("case", CASES, ids=range(len(CASES)))
def test_the_sequence_is_that_of_the_equations(case: Case, name: str) -> None:
    exact = case.arrays(F64)
    want, want_gradients = case.naive(exact), gradients(case.naive, exact)
    with kernel(name):
        for dtype, tolerance in ((F64, 1e-12), (F32, 1e-5)):
            if case.dropout and dtype == F32:
                continue  # other numbers are drawn
            a = case.arrays(dtype)
            for got, expected in zip(case.run(a), want, strict=True):
                assert got.dtype == dtype
                torch.testing.assert_close(got.double(), expected, rtol=0, atol=tolerance)
            found = gradients(case.run, a)
            own_error = gradients(case.naive, a) if dtype == F32 else {}
            for k, exact_gradient in want_gradients.items():
                allowed = 3 * distance(own_error[k], exact_gradient) + 1e-7 if dtype == F32 else 1e-10
                assert distance(found[k], exact_gradient) <= allowed, k


@pytest.mark.parametrize("name", KERNELS)
def test_nan_anywhere_comes_out(name: str) -> None:
    case = Case(layers=2, cells=6, taps=2, batch=5, steps=6)
    with kernel(name):
        for dtype in (F32, F64):
            for k, x in case.arrays(dtype).items():
                if k == "forced":
                    continue
                for place in (0, -1):
                    a = case.arrays(dtype)
                    with torch.no_grad():
                        a[k].view(-1)[place] = torch.nan
                    made = case.run(a)
                    assert any(m.isnan().any() for m in made), (k, place)
                    if len(x.shape) > 1 and x.shape[1] == case.batch:  # of one window
                        assert not any(m[:, 1:-1].isnan().any() for m in made), (k, place)
                    assert all(g.isnan().any() for n, g in gradients(case.run, a).items() if n.startswith("recurrent"))


@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.parametrize("batch", [64, 50])
def test_a_models_bits_do_not_depend_on_its_neighbours(batch: int, name: str) -> None:
    many = Case(layers=2, cells=9, taps=2, batch=batch, steps=12, models=9)
    with kernel(name):
        a = many.arrays(F32)
        whole, whole_gradients = many.run(a), gradients(many.run, a)
        for count in (1, 3):
            for first in range(0, 9, 4):
                part = replace(many, models=min(count, 9 - first))
                rows = slice(first, first + part.models)
                some = {k: x[rows].detach().requires_grad_(x.requires_grad) for k, x in a.items()}
                assert all(torch.equal(x, y[rows]) for x, y in zip(part.run(some), whole, strict=True))
                weights = torch.Generator().manual_seed(9)
                cost = sum(
                    (x * torch.randn(y.shape, generator=weights, dtype=F64).to(x)[rows]).sum()
                    for x, y in zip(part.run(some), whole, strict=True)
                )
                names = list(whole_gradients)
                found = torch.autograd.grad(cost, [some[k] for k in names])
                assert [
                    k for k, g in zip(names, found, strict=True) if not torch.equal(g, whole_gradients[k][rows])
                ] == []


@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.parametrize("forced", [False, True])
def test_one_model_needs_no_model_dimension(forced: bool, name: str) -> None:
    case = Case(layers=2, cells=9, taps=2, batch=20, forced=forced, dropout=0.3)
    with kernel(name):
        a = case.arrays(F32)
        one = {k: x[0].detach().requires_grad_(x.requires_grad) for k, x in a.items()}
        wide = one["recurrent1"].detach().repeat(1, 2)[:, :9].requires_grad_()  # rows without gaps, in a wider matrix
        one["recurrent1"] = wide
        assert all(torch.equal(x, y[0]) for x, y in zip(case.run(one), case.run(a), strict=True))
        whole = gradients(case.run, a)
        assert all(torch.equal(x, whole[k][0]) for k, x in gradients(case.run, one).items())


def test_work_space_that_was_used_before_changes_no_bit() -> None:
    small, large = Case(layers=2, cells=9, batch=50, taps=2), Case(layers=2, cells=10, batch=64, taps=2)
    with kernel("native"):
        a = small.arrays(F32)
        first, first_gradients = small.run(a), gradients(small.run, a)
        broken = large.arrays(F32)
        with torch.no_grad():
            broken["state"].fill_(torch.nan)
        gradients(large.run, broken)
        with torch.no_grad():
            free = small.run(a)
        assert all(torch.equal(x, y) for x, y in zip(free, first, strict=True))
        again = gradients(small.run, a)
        assert all(torch.equal(x, again[k]) for k, x in first_gradients.items())


def test_a_weight_changed_in_place_before_the_way_back_is_an_error() -> None:
    case = Case()
    with kernel("native"):
        a = case.arrays(F64)
        cost = case.run(a)[0].sum()
        with torch.no_grad():
            a["recurrent0"].mul_(2)
        with pytest.raises(RuntimeError, match="modified by an inplace operation"):
            cost.backward()


# ---------------------------------------------------------------------------------------------------- hybrid


@pytest.mark.parametrize("hold", ["linear", "previous"])
@pytest.mark.parametrize("entry", ["learned", "residual"])
@pytest.mark.parametrize("output", ["added", "alone", "none"])
@pytest.mark.parametrize("fed", [False, True])
def test_the_native_hybrid_is_the_loop(hold: str, entry: str, output: str, fed: bool) -> None:
    problem = replace(test_hybrid.QUADROTOR, input_hold=hold, rate=40.0)
    options = dict(layers=2, hidden=3, input_model=entry, output_model=output, fit_constants=True)
    p = vivid(test_hybrid.built("Hybrid", problem, **options), 0.3)
    past_u, past_y, u = test_hybrid.scaled(p, *test_hybrid.windows())
    state = test_hybrid.initialized(p, past_u, past_y).detach().requires_grad_()
    y = noise(*u.shape[:2], 6, seed=9) if fed else None
    u.requires_grad_()

    def all_of() -> list[Tensor]:
        made = p._run(u, state, y)
        cost = sum((x * noise(*x.shape, seed=i)).sum() for i, x in enumerate(made))
        wanted = [u, state, *p.parameters()]
        found = torch.autograd.grad(cost, wanted, allow_unused=True)
        with torch.no_grad():
            free = p._run(u, state, y)
        assert all(torch.equal(a, b) for a, b in zip(made, free, strict=True))
        return [*made, *(torch.zeros_like(w) if g is None else g for g, w in zip(found, wanted, strict=True))]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(hybrid, "core_for", lambda *tensors: None)
        want = all_of()
    with kernel("native"):
        got = all_of()
    for a, b in zip(got, want, strict=True):
        assert distance(a, b) < 1e-10


def test_nan_in_a_native_hybrid_comes_out() -> None:
    p = vivid(test_hybrid.built("Hybrid", hidden=3), 0.3)
    past_u, past_y, u = test_hybrid.scaled(p, *test_hybrid.windows())
    state = test_hybrid.initialized(p, past_u, past_y).detach()
    with kernel("native"):
        for at in range(state.shape[1]):
            broken = state.clone()
            broken[1, at] = torch.nan
            outputs, end = p.rollout(u, broken)
            assert outputs[1].isnan().any() or end[1].isnan().any(), at
            assert not outputs[[0, 2]].isnan().any() and not end[[0, 2]].isnan().any()


# --------------------------------------------------------------------------------------------------- library


@pytest.fixture
def fresh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty cache, and a library that is small."""
    sources = tmp_path / "sources"
    sources.mkdir()
    (sources / "small.cpp").write_text('extern "C" int answer() { return 42; }\n')
    monkeypatch.setattr(library, "_SOURCES", sources)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("BENCH_KERNEL", "auto")
    library._chosen.cache_clear()
    if library.core() is None:
        pytest.skip("no C++ compiler")
    for made in (tmp_path / "cache").rglob("*.so"):
        made.unlink()
    library._chosen.cache_clear()
    yield tmp_path
    library._chosen.cache_clear()


def built(folder: Path) -> list[Path]:
    return sorted((folder / "cache").rglob("*.so"))


def test_a_library_is_built_once_and_anew_when_something_changes(fresh: Path) -> None:
    found = library.core()
    assert found is not None and found.functions.answer() == 42 and library.name().startswith("native ")
    (one,) = built(fresh)
    stamp = one.stat().st_mtime_ns
    library._chosen.cache_clear()
    assert library.core() is not None and one.stat().st_mtime_ns == stamp
    (fresh / "sources" / "small.cpp").write_text('extern "C" int answer() { return 43; }\n')
    library._chosen.cache_clear()
    found = library.core()
    assert found is not None and found.functions.answer() == 43 and len(built(fresh)) == 2


def test_a_torn_library_is_built_anew(fresh: Path) -> None:
    library.core()
    (one,) = built(fresh)
    one.unlink()
    one.write_bytes(b"\x7fELF torn")
    library._chosen.cache_clear()
    found = library.core()
    assert found is not None and found.functions.answer() == 42


def broken_compiler(folder: Path, patch: pytest.MonkeyPatch) -> None:
    fake = folder / "c++"
    fake.write_text(
        '#!/bin/sh\n[ "$1" = --version ] && echo "c++ 1.0" && exit 0\necho "small.cpp:1: error: no" >&2; exit 1\n'
    )
    fake.chmod(0o755)
    patch.setenv("CXX", str(fake))


def no_cache(folder: Path, patch: pytest.MonkeyPatch) -> None:
    (folder / "file").write_text("")
    patch.setenv("XDG_CACHE_HOME", str(folder / "file"))


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda folder, patch: patch.setenv("CXX", "no-such-compiler"), r"no C\+\+ compiler \(no-such-compiler\)"),
        (broken_compiler, "does not compile it .*error: no"),
        (no_cache, "cannot be written"),
    ],
)
def test_without_a_library_pytorch_does_it_and_says_so_once(
    fresh: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, spoil: Callable, reason: str
) -> None:
    spoil(fresh, monkeypatch)
    case = Case()
    a = case.arrays(F64)
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            got = case.run(a)
    (said,) = caplog.messages
    assert re.search(f"slower PyTorch kernel: .*{reason}", said) and "\n" not in said
    assert library.name().startswith("pytorch ") and os.environ["BENCH_KERNEL"] == "pytorch"
    weights = [*vars(case.layer(a, 0)).values(), a["output_weight"], a["output_bias"]]
    run = partial(lstm_torch.run, mask=None, delays=case.taps)
    want = in_whole_vectors(run, (a["inputs"], a["state"], None), weights)
    assert all(torch.equal(x, y) for x, y in zip(got, want, strict=True))
    library._chosen.cache_clear()
    monkeypatch.setenv("BENCH_KERNEL", "native")
    with pytest.raises(BenchError, match=reason):
        library.core()


def test_a_kernel_that_does_not_exist_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BENCH_KERNEL", "natve")
    library._chosen.cache_clear()
    with pytest.raises(BenchError, match=r"BENCH_KERNEL='natve' is no kernel.*native"):
        library.core()
    library._chosen.cache_clear()


def test_two_processes_that_build_at_once_both_have_it(fresh: Path) -> None:
    slow = fresh / "g++"
    slow.write_text('#!/bin/sh\n[ "$1" != --version ] && sleep 0.5\nexec g++ "$@"\n')
    slow.chmod(0o755)
    code = (
        "import sys; from pathlib import Path; from registry.kernels.native import library\n"
        "library._SOURCES = Path(sys.argv[1]); print(library.core().functions.answer())"
    )
    command = [sys.executable, "-c", code, str(fresh / "sources")]
    both = [
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ | {"CXX": str(slow)})
        for _ in range(2)
    ]
    assert [p.communicate()[0] for p in both] == ["42\n", "42\n"]
    assert len(built(fresh)) == 1 and not list((fresh / "cache").rglob(".*.so.*"))
