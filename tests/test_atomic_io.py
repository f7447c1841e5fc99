"""A file that is replaced is the old one or the new one."""

import os
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from registry.atomic_io import replacing, write_text


@pytest.mark.parametrize("flushed", [True, False])
def test_what_fails_leaves_the_file_as_it_was_and_no_draft(tmp_path: Path, flushed: bool) -> None:
    path = tmp_path / "made" / "file.txt"
    with replacing(path, flushed) as draft:
        draft.write_text("old")
        assert not path.exists() and draft.parent.parent == path.parent
    with pytest.raises(ZeroDivisionError), replacing(path, flushed) as draft:
        draft.write_text("half")
        print(1 / 0)
    assert path.read_text() == "old" and list(path.parent.iterdir()) == [path]


KILLED = (
    "import sys; from pathlib import Path; from registry.atomic_io import replacing\n"
    "with replacing(Path(sys.argv[1])) as draft:\n"
    "    draft.write_text('half'); print('here', flush=True); sys.stdin.read()"
)


@pytest.fixture
def writer(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """A process that is writing a file, until it is killed."""
    command = [sys.executable, "-c", KILLED, str(tmp_path / "file.txt")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout and process.stdout.readline() == "here\n"
        yield process
        process.kill()


def test_a_kill_leaves_the_file_as_it_was_and_a_draft_for_the_next_to_remove(
    tmp_path: Path, writer: subprocess.Popen[str]
) -> None:
    path = tmp_path / "file.txt"
    write_text(path, "old")
    (draft,) = tmp_path.glob(".file.txt.*")  # not removed: somebody is at it
    assert (draft / path.name).read_text() == "half"
    writer.kill()
    writer.wait()
    assert path.read_text() == "old"
    write_text(path, "new")
    assert path.read_text() == "new" and list(tmp_path.iterdir()) == [path]


def test_nothing_but_a_draft_is_removed(tmp_path: Path) -> None:
    own = tmp_path / ".file.txt.20261124"
    linked = tmp_path / ".file.txt.abcdefgh.draft"
    (tmp_path / "elsewhere").mkdir()
    linked.symlink_to(tmp_path / "elsewhere")
    own.write_text("mine")
    write_text(tmp_path / "file.txt", "new")
    assert own.read_text() == "mine" and (tmp_path / "elsewhere").is_dir() and linked.is_symlink()


def test_any_name_and_the_usual_permissions(tmp_path: Path) -> None:
    path = tmp_path / ("ä" * 127)  # 254 bytes
    write_text(path, "x")
    (tmp_path / "plain").touch()
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE((tmp_path / "plain").stat().st_mode)
    assert sorted(os.listdir(tmp_path)) == sorted(["plain", path.name])
