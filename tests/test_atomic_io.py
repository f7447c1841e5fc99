"""A file that is replaced is the old one or the new one."""

import os
import signal
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from registry.atomic_io import replacing, write_text


@pytest.mark.parametrize("flushed", [True, False])
def test_what_fails_leaves_the_file_as_it_was_and_no_draft(tmp_path: Path, flushed: bool) -> None:
    path = tmp_path / "made" / "file.txt"
    with replacing(path, flushed) as draft:
        draft.write_text("old")
        assert not path.exists() and draft.parent == path.parent
    with pytest.raises(ZeroDivisionError), replacing(path, flushed) as draft:
        draft.write_text("half")
        print(1 / 0)
    assert path.read_text() == "old" and list(path.parent.iterdir()) == [path]


def test_a_kill_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    write_text(path, "old")
    code = (
        "import os, signal, sys; from pathlib import Path; from registry.atomic_io import replacing\n"
        "with replacing(Path(sys.argv[1])) as draft:\n"
        "    draft.write_text('half'); os.kill(os.getpid(), signal.SIGKILL)"
    )
    assert subprocess.run([sys.executable, "-c", code, str(path)], check=False).returncode == -signal.SIGKILL
    assert path.read_text() == "old"
    write_text(path, "new")
    assert path.read_text() == "new"


def test_any_name_and_the_usual_permissions(tmp_path: Path) -> None:
    path = tmp_path / ("ä" * 127)  # 254 bytes
    write_text(path, "x")
    (tmp_path / "plain").touch()
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE((tmp_path / "plain").stat().st_mode)
    assert sorted(os.listdir(tmp_path)) == sorted(["plain", path.name])
