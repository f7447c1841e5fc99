"""A package that is called as its main function: `bench.diagnose("flights")`, beside `bench.diagnose.compare`."""

import importlib
import inspect
import sys
from types import ModuleType
from typing import Any


class CallablePackage(ModuleType):
    """Calls the function that has the package's own name, in the module of that name in it; imported when called."""

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """See the function."""
        return self._function()(*args, **kwargs)

    @property
    def __signature__(self) -> inspect.Signature:
        return inspect.signature(self._function())

    def _function(self) -> Any:
        name = self.__name__.rpartition(".")[2]
        return getattr(importlib.import_module(f"{self.__name__}.{name}"), name)


def make_callable(package: str) -> None:
    """Let the imported package of this name be called."""
    sys.modules[package].__class__ = CallablePackage
