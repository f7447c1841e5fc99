"""A sweep: what is searched, and its trials as Optuna's journal keeps them, which is their record.

One driver writes the journal (`JOURNAL`, readable by optuna-dashboard). Nothing here looks at the test part.
"""

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import optuna
from optuna.distributions import distribution_to_json, json_to_distribution
from optuna.storages.journal import JournalFileBackend
from optuna.trial import FrozenTrial, TrialState

from bench.experiment.config import RunConfig, from_json, to_json
from bench.records.stamp import canonical
from bench.sweep.space import Space, default_params
from bench.training.data import prepare
from bench.training.split import choose_split, digest
from registry import atomic_io
from registry.errors import BenchError
from registry.regular_file import regular

JOURNAL, DEFINITION, RESULT, REPORT = "journal.log", "sweep.json", "result.json", "report.html"
"""Files of a sweep's folder: trials; what is searched; what came out; the page."""
OBJECTIVES = {
    "rmsse": "RMSSE on the validation part [standard deviations]",
    "weights": "weights [count]",
    "latency": "time of one prediction [ms]",
}
"""Name → with unit; the first is always one."""
ASKED_BY = {
    "title": "options",
    "configs": "configurations or --set",
    "space": "ranges of --search",
    "objectives": "--objective",
    "seed": "--seed",
    "data": "recordings",
}
"""What of a command makes the parts of a sweep's definition."""
STARTUP = 5
"""Trials that go to their end before any is pruned."""
LOST = ("impossible", "diverged")
"""Statuses of a trial that finished and counts as failed; any other failed one was killed with its driver."""

optuna.logging.set_verbosity(optuna.logging.WARNING)


@dataclass(frozen=True)
class Sweep:
    """What is searched."""

    title: str
    configs: tuple[RunConfig, ...]
    """To choose from; the first is the default, which is the first trial and what the best is compared with."""
    space: Space
    objectives: tuple[str, ...] = ("rmsse",)
    seed: int = 0
    """Of the proposals. A proposal is a function of it and of the trials finished before."""
    command: str = ""
    """That makes it again."""

    @property
    def default(self) -> RunConfig:
        """What the user named."""
        return self.configs[0]

    @cached_property
    def definition(self) -> dict[str, Any]:
        """Everything that trials of one sweep have in common; plain data."""
        return {
            "title": self.title,
            "configs": [to_json(c.resolved()) for c in self.configs],
            "space": {path: json.loads(distribution_to_json(d)) for path, d in self.space.items()},
            "objectives": list(self.objectives),
            "seed": self.seed,
            "data": digest(self.default.dataset),
        }

    def check(self) -> None:
        """Raise `BenchError` where there is nothing to search, no validation part, or the default does not fit."""
        if not self.space:
            raise BenchError(f"{self.default.spec} has nothing to search: name options with --search.")
        split = choose_split(self.default)
        if not split.validation:
            raise BenchError(
                f"{self.default.dataset.label} has no validation part, and a sweep is judged on nothing else: name "
                "recordings for it with --set validation=PATTERN."
            )
        prepare(self.default)


class _Journal(JournalFileBackend):
    """Optuna's; that it cannot be written is one sentence."""

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        try:
            super().append_logs(logs)
        except OSError as error:
            raise BenchError(
                f"The journal of the sweep, {self._file_path}, cannot be written: {error.strerror or error}; every "
                "finished trial is kept, and the same command with --resume goes on."
            ) from error


def begin(sweep: Sweep, folder: Path, resume: bool) -> optuna.Study:
    """The study in ``folder``, new or gone on with; trials that died with their driver are put back in line.

    Raises:
        BenchError: there is one and it is not to be resumed, or it is of something else; the folder cannot be written.
    """
    definition = folder / DEFINITION
    if definition.is_file():
        before = _definition(folder)
        if not resume:
            raise BenchError(f"There is a sweep in {folder}: go on with --resume, or give this one another --name.")
        now = json.loads(json.dumps(sweep.definition))
        changed = [words for part, words in ASKED_BY.items() if now[part] != before.get(part)]
        if changed:
            raise BenchError(
                f"The sweep in {folder} was begun with other {', '.join(changed)}: repeat its command "
                f"({before.get('command')}) with --resume, or give this one another --name."
            )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        atomic_io.clear(folder, ".")
        _mend(folder / JOURNAL)
        if not definition.is_file():
            atomic_io.write_text(definition, canonical({**sweep.definition, "command": sweep.command}))
        study = optuna.create_study(
            study_name=folder.name,
            storage=optuna.storages.JournalStorage(_Journal(str(folder / JOURNAL))),
            directions=["minimize"] * len(sweep.objectives),
            pruner=optuna.pruners.MedianPruner(STARTUP, n_warmup_steps=sweep.default.training.updates // 5),
            load_if_exists=True,
        )
    except OSError as error:
        raise BenchError(f"The sweep folder {folder} cannot be written: {error.strerror or error}.") from error
    put_back(study, sweep.space)
    if not study.trials and (params := default_params(sweep.space, sweep.configs)):
        _enqueue(study, params, {})
    return study


def sweeps(results: Path) -> Iterator[Path]:
    """The folders of all sweeps."""
    yield from (path.parent for path in sorted((results / "sweeps").glob(f"*/{DEFINITION}")))


def read(folder: Path) -> tuple[Sweep, list[str]]:
    """What is searched in a folder, and the keys of its finalists' records, none before the end.

    Raises:
        BenchError: a file is damaged.
    """
    kept = _definition(folder)
    try:
        space = {path: json_to_distribution(json.dumps(d)) for path, d in kept["space"].items()}
        configs = tuple(from_json(c) for c in kept["configs"])
        made = Sweep(kept["title"], configs, space, tuple(kept["objectives"]), kept["seed"], kept["command"])
        done = folder / RESULT
        return made, list(json.loads(done.read_text())["keys"]) if done.is_file() else []
    except (OSError, ValueError, TypeError, LookupError, ArithmeticError, AttributeError, RecursionError) as error:
        raise _damaged(folder, error) from error


def _definition(folder: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(regular(folder / DEFINITION).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError, RecursionError) as error:
        raise _damaged(folder, error) from error


def _damaged(folder: Path, error: Exception) -> BenchError:
    return BenchError(f"The sweep in {folder} is damaged ({error}): remove the folder and sweep again.")


def load(folder: Path) -> optuna.Study:
    """The study of a sweep as it stands, to be read."""
    storage = optuna.storages.JournalStorage(_Journal(str(folder / JOURNAL)))
    return optuna.load_study(study_name=folder.name, storage=storage)


def _mend(journal: Path) -> None:
    """Cut off a last line that a kill has torn, and remove the lock that it has left, under whichever name.

    Optuna gives a lock up by renaming it first, so that a kill may leave it as ``.lock<id>.rename`` too.
    """
    for lock in journal.parent.glob(journal.name + ".lock*"):
        lock.unlink(missing_ok=True)
    if journal.is_file():
        content = journal.read_bytes()
        if not content.endswith(b"\n"):
            os.truncate(journal, content.rfind(b"\n") + 1)


def put_back(study: optuna.Study, space: Space) -> None:
    """Trials left running by a killed driver are closed as failed, and asked for again with the same parameters.

    One that was waiting with its parameters may have been begun and have none of them yet.
    """
    for left in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        study.tell(left.number, state=TrialState.FAIL)
    every = study.get_trials(deepcopy=False)
    again = {t.user_attrs.get("again") for t in every}
    for t in every:
        params = {**t.user_attrs.get("asked", {}), **t.params}
        if was_killed(t) and t.number not in again and set(params) == set(space):
            _enqueue(study, params, {"again": t.number, "first": t.user_attrs.get("first", t.number)})


def _enqueue(study: optuna.Study, params: dict[str, Any], about: dict[str, Any]) -> None:
    study.enqueue_trial(params, {**about, "asked": params})


def was_killed(t: FrozenTrial) -> bool:
    """Whether a trial ended with its driver and not by itself."""
    return t.state == TrialState.FAIL and t.user_attrs.get("status") not in LOST


def begun(study: optuna.Study) -> list[FrozenTrial]:
    """Trials that run or have finished, each once however often it was killed."""
    return [t for t in study.get_trials(deepcopy=False) if t.state != TrialState.WAITING and not was_killed(t)]


def place(study: optuna.Study, trial: FrozenTrial) -> int:
    """The number that a trial would have if none had been killed."""
    order = sorted(t.user_attrs.get("first", t.number) for t in begun(study))
    return order.index(trial.user_attrs.get("first", trial.number))


def finished(study: optuna.Study) -> list[FrozenTrial]:
    """Trials of which the end is known."""
    return [t for t in begun(study) if t.state != TrialState.RUNNING]


def best(study: optuna.Study) -> FrozenTrial:
    """The trial with the smallest error.

    Raises:
        BenchError: none has come to its end.
    """
    done = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    if not done:
        reasons = {t.user_attrs.get("problem") or t.user_attrs.get("status") for t in finished(study)}
        raise BenchError(f"No trial of {study.study_name} has come to its end: {'; '.join(map(str, reasons))}.")
    return min(done, key=lambda t: (t.values[0], t.number))
