"""The driver of a sweep: asks Optuna for configurations, hands them to workers, tells, stops what is not worth it."""

import shutil
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import optuna
import torch
from optuna.trial import FrozenTrial, TrialState

from bench.config import to_json
from bench.engine import key_of
from bench.executor import work_off
from bench.seeds import derive
from bench.sweep import trial
from bench.sweep.journal import Sweep, begun
from bench.sweep.space import configured
from registry.errors import BenchError


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
    """Train until ``trials`` are told.

    One trial a job, not several side by side: their shapes differ, and each is proposed from what the others told.

    Args:
        sweep: what is searched.
        study: from `begin`.
        folder: its folder, for checkpoints.
        trials: in all, those told before included.
        workers: processes.
        tick: called with shares of one trial's budget as they are done.
        ended: called with every trial that is told.
        cluster: address of a Dask scheduler whose workers do it instead.
    """
    torch.set_num_threads(1)  # the run key names the thread count
    driver = _Driver(sweep, study, folder, tick)
    jobs = driver.jobs(trials)
    with closing(work_off(jobs, workers, driver.hear, lambda t: f"trial {t.number}", cluster, ahead=1)) as done:
        for asked, outcome in done:
            driver.tell(asked, outcome)
            ended(study.get_trials(deepcopy=False)[asked.number])
    for left in (driver.partial, driver.stops):  # every trial is told: a checkpoint there is a killed driver's
        shutil.rmtree(left, ignore_errors=True)


class _Driver:
    """Asks and tells; knows which trials are in the hands of workers."""

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

    def jobs(self, trials: int) -> Iterator[tuple[optuna.Trial, Callable[..., trial.Outcome], tuple[Any, ...]]]:
        """Proposals, each made when a worker is free."""
        while (number := len(begun(self.study))) < trials:
            # A sampler of its own for every trial: proposals after a resume are those of an unbroken sweep.
            seed = derive(self.sweep.seed, f"proposal/{number}") % 2**32
            self.study.sampler = optuna.samplers.TPESampler(seed=seed)
            asked = self.study.ask(self.sweep.space)
            try:
                config = configured(self.sweep.configs, asked.params)
                key = key_of(config)
            except BenchError as error:
                self.tell(asked, trial.Outcome("impossible", problem=str(error)))
                continue
            asked.set_user_attr("spec", config.spec)
            self.out[asked.number], self.share[asked.number] = asked, 0.0
            paths = str(self._checkpoint(asked).resolve()), str((self.stops / str(asked.number)).resolve())
            yield asked, trial.work, (to_json(config), key, asked.number, *paths)

    def _checkpoint(self, asked: optuna.Trial) -> Path:
        """A trial that is asked for again goes on from the checkpoint of the one that was killed."""
        return self.partial / f"{asked.user_attrs.get('first', asked.number)}.safetensors"

    def hear(self, message: tuple[int, list[tuple[int, float]]]) -> None:
        """A worker has looked at the validation part."""
        number, curve = message
        asked = self.out.get(number)
        if asked is None or not curve:  # told already
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
        for left in self.partial.glob(f"{self._checkpoint(asked).name}*"):  # drafts of killed workers as well
            left.unlink(missing_ok=True)
        (self.stops / str(asked.number)).unlink(missing_ok=True)
