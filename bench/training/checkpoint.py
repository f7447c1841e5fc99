"""Where a training stands, on disk: tensors and plain data in one safetensors file, replaced atomically."""

import hashlib
import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
from torch import Tensor

from registry.atomic_io import replacing


class Checkpoint:
    """One file; a kill while it is written leaves the one before.

    It is not flushed to the disk, which would cost a short training more than it is worth: a digest tells what a power
    cut has torn, and that training starts over.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def save(self, tensors: dict[str, Tensor], state: dict[str, Any]) -> None:
        """Replace the checkpoint; a disk that is full or read-only costs the checkpoint, not the training."""
        whole, text = {k: t.contiguous() for k, t in tensors.items()}, json.dumps(state)
        with suppress(OSError, safetensors.SafetensorError), replacing(self.path, flushed=False) as draft:
            # `save_file` writes to a draft of its own, which a kill would leave for good
            draft.write_bytes(safetensors.torch.save(whole, {"state": text, "digest": _digest(whole, text)}))

    def load(self) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
        """Tensors and state; None where there is no checkpoint or a torn one."""
        try:
            with safetensors.safe_open(self.path, framework="pt") as f:
                tensors, metadata = {k: f.get_tensor(k) for k in f.keys()}, f.metadata()  # noqa: SIM118
            return (
                (tensors, json.loads(metadata["state"]))
                if _digest(tensors, metadata["state"]) == metadata["digest"]
                else None
            )
        except (OSError, safetensors.SafetensorError, KeyError, TypeError, ValueError):
            return None


def _digest(tensors: dict[str, Tensor], state: str) -> str:
    found = hashlib.sha256(state.encode())
    for name in sorted(tensors):
        found.update(name.encode())
        found.update(tensors[name].numpy().tobytes())
    return found.hexdigest()
