"""What is put in where something else is expected, and how an answer is judged: a result or one sentence, within 20 s.

`tox -e fuzz` sets BENCH_FUZZ, the factor by which there are more inputs than in the fast tests; they are then drawn
from a seed that is printed (BENCH_FUZZ_SEED repeats it), and what fails is kept in .hypothesis.
"""

import copy
import json
import os
import random
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import click
from hypothesis import HealthCheck, seed, settings
from hypothesis import strategies as st

from bench.cli import cli
from registry.errors import BenchError

FACTOR = float(os.environ.get("BENCH_FUZZ", "0"))
SEED = int(os.environ.get("BENCH_FUZZ_SEED") or random.SystemRandom().randrange(2**32))
SECONDS = 20
IDLE = 0.02
"""Share of a core below which a process stands still."""

WORDS = ["nan", "inf", "-1e999", "1e308", "", '"', "\x00", "é", "\ufeff", "[", "]", "{", "}", "=", ",", "\n", "true"]
WORDS += ["../..", "/etc/passwd", "1" * 400, "-", "0x1", "'''", "99999999999999999999", "[" * 3000, "NaN", "null", "{}"]
WORDS += ["[/]", "[/red]x", "[bold]", "1e-320", "9" * 25, "~", ".", "/dev/zero", "%s", "{0}", "\\", "$HOME"]
EDITS = st.lists(
    st.tuples(
        st.floats(0, 1),
        st.one_of(st.binary(min_size=1, max_size=6), st.sampled_from([w.encode() for w in WORDS])),
        st.integers(0, 60),
    ),
    min_size=1,
    max_size=4,
)
"""Where, what is put there, how many bytes it replaces."""
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.sampled_from(WORDS) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)
"""Anything that JSON or TOML can hold."""


def cases(count: int) -> Callable[[Any], Any]:
    """As many inputs in the fast tests, the same each time; more of them, and others, by `tox -e fuzz`."""
    quiet = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
    if not FACTOR:
        return settings(max_examples=count, derandomize=True, database=None, deadline=None, suppress_health_check=quiet)
    more = settings(
        max_examples=max(1, int(FACTOR * count)), deadline=None, print_blob=True, suppress_health_check=quiet
    )
    return lambda test: seed(SEED)(more(test))


def edited(content: bytes, edits: list[tuple[float, bytes, int]]) -> bytes:
    """The content with every edit made."""
    for where, what, over in edits:
        at = int(where * len(content))
        content = content[:at] + what + content[at + over :]
    return content


@contextmanager
def in_time() -> Iterator[None]:
    """Raise where what is inside hangs: it computes for `SECONDS`, or stands still for as long.

    What other processes take of the machine is no fault of it.
    """
    began = looked = time.process_time()

    def late(*_: object) -> None:
        nonlocal looked
        now = time.process_time()
        if now - began > SECONDS or now - looked < IDLE * SECONDS:
            raise AssertionError(f"no answer after {now - began:.1f} s of computing, {SECONDS} s or more in all")
        looked = now
        signal.alarm(SECONDS)

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def one_sentence(action: Callable[[], object]) -> None:
    """Does it, or says in one line why not."""
    try:
        with in_time():
            action()
    except BenchError as error:
        said = str(error)
        assert said.strip() and "\n" not in said.rstrip("\n"), repr(said)
        assert len(said) <= 2000, said[:200]


def answers(arguments: list[str]) -> None:
    """Type a command; what is wrong with its options is raised as what is wrong with anything else."""
    try:
        cli.main(arguments, standalone_mode=False)
    except click.UsageError as error:
        raise BenchError(" ".join(error.format_message().split())[:2000]) from error
    except (click.exceptions.Exit, click.Abort, SystemExit):
        pass


@st.composite
def altered(draw: Callable[[Any], Any], plain: Any) -> Any:
    """A plain description with one or two of its values or names replaced, or taken from elsewhere in it."""
    made = copy.deepcopy(plain)
    for _ in range(draw(st.integers(1, 2))):
        at = made
        while True:
            keys = list(at) if isinstance(at, dict) else list(range(len(at)))
            if not keys:
                break
            key = draw(st.sampled_from(keys))
            if not isinstance(at[key], (dict, list)) or not at[key] or draw(st.integers(0, 3)) == 0:
                at[key] = copy.deepcopy(draw(st.one_of(VALUES, st.sampled_from(list(_leaves(plain))))))
                if isinstance(at, dict) and draw(st.integers(0, 4)) == 0:
                    value = at.pop(key)
                    at.update({draw(st.text(max_size=6) | st.sampled_from(list(_names(plain)))): value} if key else {})
                break
            at = at[key]
    return made


def _leaves(plain: Any) -> Iterator[Any]:
    yield plain
    for inner in plain.values() if isinstance(plain, dict) else plain if isinstance(plain, list) else ():
        yield from _leaves(inner)


def _names(plain: Any) -> Iterator[str]:
    for part in _leaves(plain):
        yield from part if isinstance(part, dict) else ()


def toml(plain: dict[str, Any]) -> str:
    """A table as TOML, a line a key; what TOML lacks is an empty text."""
    return "".join(f"{json.dumps(str(key))} = {_toml(value)}\n" for key, value in plain.items())


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(str(k))} = {_toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return repr(value) if isinstance(value, float) else json.dumps("" if value is None else value)
