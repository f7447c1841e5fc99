"""Where a training stands, on disk: tensors and plain data in one safetensors file, replaced atomically."""

import json
import os
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
from torch import Tensor


class Checkpoint:
    """One file; a kill while it is written leaves the one before."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def save(self, tensors: dict[str, Tensor], state: dict[str, Any]) -> None:
        """Replace the checkpoint; a disk that is full or read-only costs the checkpoint, not the training."""
        draft = self.path.with_name(f"{self.path.name}.{os.getpid()}")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            safetensors.torch.save_file(
                {k: t.contiguous() for k, t in tensors.items()}, draft, {"state": json.dumps(state)}
            )
            os.replace(draft, self.path)
        except (OSError, safetensors.SafetensorError):
            draft.unlink(missing_ok=True)

    def load(self) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
        """Tensors and state; None where there is no checkpoint or an unreadable one."""
        try:
            with safetensors.safe_open(self.path, framework="pt") as f:
                return {k: f.get_tensor(k) for k in f.keys()}, json.loads(f.metadata()["state"])  # noqa: SIM118
        except (OSError, safetensors.SafetensorError, KeyError, TypeError, ValueError):
            return None
