"""A published file that is not as it was published is noticed, whatever its kind, and nothing is judged by it."""

import re
import shutil
import subprocess
from pathlib import Path

import pyarrow as pa
import pyarrow.compute
import pyarrow.parquet as pq
import pytest
from test_cli_check import Bench, bench

from bench.api.check import check
from bench.claims import manifest
from bench.claims.manifest import Spoilt
from registry.errors import BenchError

__all__ = ["bench"]
PUBLISHED = Path(__file__).parent.parent / "results" / "published"
FILES = [p.relative_to(PUBLISHED) for p in sorted(PUBLISHED.rglob("*")) if p.is_file() and p.name != manifest.FILE]
KINDS = {path.suffix: path for path in FILES}


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Path(shutil.copytree(PUBLISHED, tmp_path_factory.mktemp("results") / "published"))


def alter(path: Path) -> None:
    """One number of a text or table, one byte of a picture. A kind that nobody thought of is an error."""
    if path.suffix == ".parquet":
        table = pq.read_table(path)
        name = next(f.name for f in table.schema if pa.types.is_floating(f.type))
        values = table[name].to_pylist()
        values[len(values) // 2] *= 1.001
        table = table.set_column(
            table.schema.get_field_index(name), name, pa.array(values, table.schema.field(name).type)
        )
        pq.write_table(table, path)
    elif path.suffix == ".png":
        flip(path)
    elif path.suffix in (".json", ".md", ".toml"):
        text = path.read_text(encoding="utf-8")
        number = re.search(r"\d\.\d+", text)
        assert number is not None
        last = number.end() - 1
        path.write_text(f"{text[:last]}{(int(text[last]) + 1) % 10}{text[last + 1 :]}", encoding="utf-8")
    else:
        raise AssertionError(f"{path}: files of this kind are published, and no test tampers with one")


def flip(path: Path) -> None:
    """One bit in the middle."""
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def test_what_is_published_is_as_it_was_published() -> None:
    assert manifest.spoilt(PUBLISHED) == []
    if shutil.which("sha256sum"):
        subprocess.run(["sha256sum", "--quiet", "-c", manifest.FILE], cwd=PUBLISHED, check=True)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_a_number_altered_in_any_kind_of_file(kind: str, published: Path, bench: Bench) -> None:
    path = published / KINDS[kind]
    before = path.read_bytes()
    alter(path)
    try:
        assert manifest.spoilt(published) == [Spoilt(KINDS[kind].as_posix(), "altered")]
        with pytest.raises(BenchError, match=r"altered: .*, one of 1 published files"):
            check(published=published)
        code, printed = bench("--published", published)
        assert code == 1 and str(path) in printed and "reproduced" not in printed
    finally:
        path.write_bytes(before)
    assert manifest.spoilt(published) == []


def test_one_bit_of_every_file(published: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(published, tmp_path / "published"))
    for name in FILES:
        flip(copy / name)
    assert manifest.spoilt(copy) == [Spoilt(name.as_posix(), "altered") for name in sorted(FILES, key=Path.as_posix)]


def test_files_that_went_or_came_and_a_list_that_was_altered(published: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(published, tmp_path / "published"))
    (copy / "claims.md").unlink()
    (copy / "more.md").write_text("0.5")
    assert [(s.name, s.how) for s in manifest.spoilt(copy)] == [("claims.md", "missing"), ("more.md", "not published")]
    listed = (copy / manifest.FILE).read_text()
    (copy / manifest.FILE).write_text(listed.replace(listed[:64], "0" * 64, 1))
    assert len(manifest.spoilt(copy)) == 3
    (copy / manifest.FILE).write_text("nonsense\n")
    with pytest.raises(BenchError, match="--seal"):
        manifest.spoilt(copy)


def test_publishing_keeps_the_list(published: Path, tmp_path: Path, bench: Bench) -> None:
    copy = Path(shutil.copytree(published, tmp_path / "published"))
    shutil.copy(copy / "claims.md", copy / "again.md")
    manifest.entered(copy / "again.md")
    assert manifest.spoilt(copy) == []
    (copy / "washout_vs_mlp" / "note.md").write_text("0.5")
    assert bench("--published", copy, "--seal")[0] == 0
    assert manifest.spoilt(copy) == []
    elsewhere = tmp_path / "table.md"
    elsewhere.write_text("0.5")
    assert manifest.entered(elsewhere) == elsewhere and not (tmp_path / manifest.FILE).exists()
