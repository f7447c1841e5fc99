"""A call of the compiled core: a structure of sizes and addresses, and what they belong to; under autograd or not."""

import ctypes
from array import array
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from registry.kernels.native.library import Core
from registry.kernels.workspace import Workspace


class Call:
    """A function family ``{family}_{sizes,forward,backward}_{f,d}``; every array is of one type, f or d."""

    family: ClassVar[str]
    structure: ClassVar[type[ctypes.Structure]]

    def __init__(self, core: Core, like: Tensor, **sizes: float) -> None:
        """
        Args:
            core: the library.
            like: an array of the type of all.
            sizes: fields of the structure that are numbers.
        """
        self.core, self.like = core, like
        self.fields: Any = self.structure(**sizes)
        self.held: list[Any] = []
        self.weights: list[Tensor] = []
        self.kept: Workspace | None = None

    def point(self, name: str, x: Tensor | None, at: int | None = None) -> None:
        """Set a field (or its element ``at``) to an array, which is held until this object goes, or to null."""
        if x is not None:
            x = x.contiguous()
            self.held.append(x)
        self._set(name, None if x is None else x.data_ptr(), at)

    def table(self, name: str, entries: list[int]) -> None:
        """Set a field to a table of addresses and other whole numbers that C reads."""
        numbers = array("q", entries)
        self.held.append(numbers)
        self._set(name, numbers.buffer_info()[0], None)

    def read(self, weights: Sequence[Tensor], models: bool) -> None:
        """Set ``weights`` to a table of `Weight`: each model's without gaps, the models themselves may lie apart."""
        whole = [w.is_contiguous() or (models and w[0].is_contiguous()) for w in weights]
        self.weights = [w if one else w.contiguous() for w, one in zip(weights, whole, strict=True)]
        self.table("weights", [v for w in self.weights for v in (w.data_ptr(), w.stride(0))])

    def gradients(self) -> list[Tensor]:
        """Set ``gradients`` to a table of fresh arrays like the weights."""
        made = [torch.empty_like(w, memory_format=torch.contiguous_format) for w in self.weights]
        self.table("gradients", addresses(made))
        return made

    def new(self, name: str, shape: tuple[int, ...], at: int | None = None) -> Tensor:
        """A fresh array to be written."""
        x = self.like.new_empty(shape)
        self._set(name, x.data_ptr(), at)
        return x

    def _set(self, name: str, address: int | None, at: int | None) -> None:
        if at is None:
            setattr(self.fields, name, address)
        else:
            getattr(self.fields, name)[at] = address

    def run(self, what: str, models: int = 1) -> None:
        """Forward or backward, in work space of its own; what forward keeps is of this object."""
        self._call("sizes")
        if what == "forward":
            self.kept = Workspace(self.fields.kept_size * models, self.like)
            self.fields.kept = self.kept.address
        scratch = Workspace(self.fields.scratch_size, self.like)
        self.fields.scratch = scratch.address
        self._call(what)

    def forward(self) -> Any:
        """What it makes: an array, or several."""
        raise NotImplementedError

    def _call(self, what: str) -> None:
        kind = "f" if self.like.dtype == torch.float32 else "d"
        getattr(self.core.functions, f"{self.family}_{what}_{kind}")(ctypes.byref(self.fields))


class _Called(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, make: Callable[..., Call], count: int, *tensors: Tensor) -> Any:
        arrays, weights = tensors[:count], tensors[count:]
        ctx.save_for_backward(*weights)  # a change in place before the way back is an error
        ctx.set_materialize_grads(False)
        ctx.run = make(*arrays, weights=weights, keep=True)
        return ctx.run.forward()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Tensor | None, ...]:
        _ = ctx.saved_tensors
        return (None, None, *ctx.run.backward(*grads, inputs_too=ctx.needs_input_grad[2]))


def called(make: Callable[..., Call], arrays: Sequence[Tensor | None], weights: Sequence[Tensor]) -> Any:
    """What a call gives, with a way back where a gradient is wanted.

    Args:
        make: a kind of call, given ``*arrays``, ``weights`` and ``keep`` (for a way back). Its ``backward`` takes the
            gradients of what `Call.forward` gives (None: zero) and ``inputs_too``, whether that of the first array is
            wanted, and gives those of arrays and weights, in their order.
        arrays: they may want gradients; None: not given.
        weights: likewise.
    """
    if torch.is_grad_enabled() and any(x is not None and x.requires_grad for x in (*arrays, *weights)):
        return _Called.apply(make, len(arrays), *arrays, *weights)
    return make(*arrays, weights=weights, keep=False).forward()


def structure(sizes: str, numbers: str = "", arrays: str = "", pairs: str = "") -> tuple[tuple[str, Any], ...]:
    """Fields of a structure: integers, doubles, addresses (those among ``pairs`` twice), then the two work-space sizes.

    Args:
        sizes, numbers, arrays, pairs: names with spaces in between.
    """
    address: Any = ctypes.c_void_p
    return (
        *((n, ctypes.c_int64) for n in sizes.split()),
        *((n, ctypes.c_double) for n in numbers.split()),
        *((n, address * 2 if n in pairs.split() else address) for n in arrays.split()),
        ("kept", ctypes.c_void_p),
        ("scratch", ctypes.c_void_p),
        ("kept_size", ctypes.c_int64),
        ("scratch_size", ctypes.c_int64),
    )


def addresses(tensors: list[Tensor]) -> list[int]:
    """For a table of them."""
    return [x.data_ptr() for x in tensors]
