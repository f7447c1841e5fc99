"""The driver of a sweep: configurations from Optuna to workers, results back, what is not worth it stopped.

Trials train side by side where all that is searched may differ there; elsewhere one trial is a job, proposed from what
the results of all before it.
"""

import math
import shutil
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import optuna
import torch
from optuna.trial import FrozenTrial, TrialState

from bench.execution.engine import GROUP, key_of
from bench.execution.executor import run_jobs
from bench.experiment.config import RunConfig, to_json
from bench.experiment.run_key import FREE
from bench.experiment.seeds import derive
from bench.sweep import trial
from bench.sweep.journal import Sweep, begun
from bench.sweep.space import configured
from bench.training.data import prepare
from bench.training.train import batchable
from registry.atomic_io import remove
from registry.errors import BenchError

Group = tuple[optuna.Trial, ...]


def search(
    sweep: Sweep,
    study: optuna.Study,
    folder: Path,
    trials: int,
    workers: int = 1,
    tick: Callable[[float], None] = lambda share: None,
    ended: Callable[[FrozenTrial], None] = lambda t: None,
    cluster: str | None = None,
) -> None:
    """Train until ``trials`` are finished.

    Args:
        sweep: what is searched.
        study: from `begin`.
        folder: its folder, for checkpoints.
        trials: in all, those finished before included.
        workers: processes.
        tick: called with shares of one trial's budget as they are done.
        ended: called with every trial that has finished.
        cluster: address of a Dask scheduler whose workers do it instead.
    """
    torch.set_num_threads(1)  # the run key names the thread count
    driver = _Driver(sweep, study, folder, tick)
    # Workers of a cluster come and go, so that there is no telling how many have to share the trials.
    jobs = driver.jobs(trials, 1 if cluster else trials_at_once(sweep), workers)
    with closing(run_jobs(jobs, workers, driver.on_progress, _named, cluster, ahead=1)) as done:
        for group, outcomes in done:
            for asked, outcome in zip(group, outcomes, strict=True):
                driver.tell(asked, outcome)
                ended(study.get_trials(deepcopy=False)[asked.number])
            driver.forget(group)
    for left in (driver.partial, driver.stops):  # every trial is finished: a checkpoint there is a killed driver's
        shutil.rmtree(left, ignore_errors=True)


def trials_at_once(sweep: Sweep) -> int:
    """Trials that train side by side at most.

    Raises:
        BenchError: the default does not fit its data.
    """
    return GROUP if set(sweep.space) <= set(FREE) and batchable(sweep.default, prepare(sweep.default)) else 1


def _named(group: Group) -> str:
    return f"trial {', '.join(str(t.number) for t in group)}"


class _Driver:
    """Proposes trials and enters their results; knows which ones workers have."""

    def __init__(self, sweep: Sweep, study: optuna.Study, folder: Path, tick: Callable[[float], None]) -> None:
        self.sweep, self.study, self.tick = sweep, study, tick
        self.partial, self.stops = folder / ".partial", folder / ".stop"
        self.out: dict[int, optuna.Trial] = {}
        self.share: dict[int, float] = {}
        for left in self.stops.glob("*"):
            left.unlink()
        for made in (self.partial, self.stops):
            with suppress(OSError):  # a full disk costs checkpoints and early ends; the journal says that it is full
                made.mkdir(exist_ok=True)

    def jobs(
        self, trials: int, together: int, workers: int
    ) -> Iterator[tuple[Group, Callable[..., list[trial.Outcome]], tuple[Any, ...]]]:
        """Proposals made when a worker is free: ``together`` at most, and no more than its share of what is left."""
        while (left := trials - len(begun(self.study))) > 0:
            size = min(together, math.ceil(left / workers))
            if proposed := [p for p in (self._propose(together > 1) for _ in range(size)) if p]:
                group, configs, keys = zip(*proposed, strict=True)
                numbers = [asked.number for asked in group]
                paths = str(self._checkpoint(group).resolve()), str(self.stops.resolve())
                yield group, trial.work, ([to_json(c) for c in configs], keys, numbers, *paths)

    def _propose(self, apart: bool) -> tuple[optuna.Trial, RunConfig, str] | None:
        """The next trial with its configuration and key; None where it cannot be, which is a result too.

        Args:
            apart: whether it keeps away from trials that are not finished yet.
        """
        # A sampler of its own for every trial: proposals after a resume are those of an unbroken sweep.
        seed = derive(self.sweep.seed, f"proposal/{len(begun(self.study))}") % 2**32
        chance = GROUP if apart else 10  # Optuna's own would leave the second group to chance as well
        self.study.sampler = optuna.samplers.TPESampler(seed=seed, n_startup_trials=chance, constant_liar=apart)
        asked = self.study.ask(self.sweep.space)
        try:
            config = configured(self.sweep.configs, asked.params)
            key = key_of(config)
        except BenchError as error:
            self.tell(asked, trial.Outcome("impossible", problem=str(error)))
            return None
        asked.set_user_attr("spec", config.spec)
        self.out[asked.number], self.share[asked.number] = asked, 0.0
        return asked, config, key

    def _checkpoint(self, group: Group) -> Path:
        """Trials that are asked for again go on from the checkpoint of those that were killed, if all are together."""
        names = "-".join(str(asked.user_attrs.get("first", asked.number)) for asked in group)
        return self.partial / f"{names}.safetensors"

    def forget(self, group: Group) -> None:
        """Remove the checkpoint of a group that is finished, and drafts of killed workers."""
        checkpoint = self._checkpoint(group)
        for left in (checkpoint, *self.partial.glob(f".{checkpoint.name}.*")):
            remove(left)

    def on_progress(self, message: tuple[int, list[tuple[int, float]]]) -> None:
        """A worker has looked at the validation part."""
        number, curve = message
        asked = self.out.get(number)
        if asked is None or not curve:  # finished already
            return
        self._advance(number, curve[-1][0] / self.sweep.default.training.updates)
        if len(self.sweep.objectives) == 1:
            self._report(asked, curve)
            if asked.should_prune():
                with suppress(OSError):
                    (self.stops / str(number)).touch()

    def _advance(self, number: int, share: float) -> None:
        self.tick(max(0.0, min(1.0, share) - self.share[number]))
        self.share[number] = max(self.share[number], min(1.0, share))

    @staticmethod
    def _report(asked: optuna.Trial, curve: list[tuple[int, float]]) -> None:
        known = set(asked.study.get_trials(deepcopy=False)[asked.number].intermediate_values)
        for update, value in curve:
            if update not in known and value == value and abs(value) != float("inf"):
                asked.report(value, update)

    def tell(self, asked: optuna.Trial, outcome: trial.Outcome) -> None:
        """Enter what came of a trial."""
        single = len(self.sweep.objectives) == 1
        if single:
            self._report(asked, outcome.curve)
        attributes = {
            name: getattr(outcome, name)
            for name in ("weights", "latency", "updates", "best_update", "seconds", "metrics", "curve", "problem")
        }
        for name, value in {**attributes, "status": outcome.status}.items():
            if value == value and value not in ("", {}, []):
                asked.set_user_attr(name, value)
        if outcome.status == "finished":
            self.study.tell(asked, [float(getattr(outcome, name)) for name in self.sweep.objectives])
        else:
            cut = single and outcome.status in ("pruned", "diverged") and outcome.curve
            self.study.tell(asked, state=TrialState.PRUNED if cut else TrialState.FAIL)
        self.out.pop(asked.number, None)
        if asked.number in self.share:
            self._advance(asked.number, 1.0)
        (self.stops / str(asked.number)).unlink(missing_ok=True)
