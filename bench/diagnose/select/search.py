"""A model and all its rivals on the training recordings, linearised, whitened, ready to choose from."""

from collections.abc import Callable, Collection, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.ndimage import convolve1d

from bench.diagnose.logs.noise import Noise, noise_of
from bench.diagnose.logs.sample import left_out, shortened
from bench.diagnose.logs.smoothing import Smoothing
from bench.diagnose.logs.subject import LogBatch, Subject
from bench.diagnose.regression.generic import Dictionary, Term, dictionary
from bench.diagnose.regression.least_squares import Normal
from bench.diagnose.regression.linearise import Linearization, directions
from bench.diagnose.regression.parameters import Prior, entries
from bench.diagnose.regression.rows import Products, Rows, noise_filters
from bench.diagnose.regression.test_functions import TestFunctions, stride_of
from bench.diagnose.regression.weak import mean_rates
from bench.diagnose.select.catalogue import acting_through, admissible
from bench.diagnose.select.subset import Fit, Subsets, acting, drowned
from bench.diagnose.settings import CALIBRATING, CHOOSING, SEARCHING
from bench.diagnose.simulate.free_run import default_steps
from bench.diagnose.simulate.teacher_forced import with_noise
from registry.contracts import Channel
from registry.core import EFFECTS
from registry.dynamics import Effect, InputEffect, PhysicsModel

_OF_INPUT = ("input", "input_rate")
"""Signals of the dictionary that noise of the inputs is in."""


@dataclass(frozen=True, eq=False)
class View:
    """A model linearised on the training recordings, whitened, with normal equations to choose from."""

    linear: Linearization
    dictionary: tuple[Term, ...]
    subsets: Subsets
    products: Products
    """Of all columns, dictionary included."""
    reach: tuple[frozenset[int], ...]
    """A dictionary term: the channels that it acts on."""
    explained: Mapping[int, float]
    """A channel: squared whitened residual that effects explain, those of the model too."""
    doubtful: frozenset[int]
    """Channels in which the model's own numbers are buried in noise of the inputs."""
    filters: tuple[np.ndarray, ...]
    """Whitening filters, a channel each."""
    of_states: bool = False
    """Whether what noise of the states makes of the columns is taken off."""

    @property
    def floor(self) -> float:
        """What noise leaves: one a row."""
        return float(self.subsets.normal.rows)

    def explainable(self) -> dict[int, float]:
        """A channel: squared whitened residual that the model leaves above the noise, or that was explained before."""
        losses = self.subsets.losses(self.subsets.fit()).sum(0)
        left = np.maximum(losses - self.floor / len(losses), 0.0)
        return {c: max(self.explained.get(c, 0.0), float(x)) for c, x in zip(self.linear.channels, left, strict=True)}

    def explained_where(self, gains: np.ndarray) -> float:
        """What is explained in the channels in which an effect acts that gains this much in each (channels,).

        A share of that tells whether it is relevant: beside torques that are off by far, a force is no less a force.
        """
        explained = list(self.explainable().values())
        return sum(explained[i] for i in acting(gains))

    def overcorrected(self, fit: Fit) -> bool:
        """Whether less than nothing is left, by more than chance: what was taken for noise of the inputs acts."""
        return fit.misfit < -CHOOSING.overcorrected * self.subsets.normal.scatter(fit.columns, fit.beta)

    @property
    def grams(self) -> tuple[np.ndarray, ...]:
        """A fold: normal equations of all columns, dictionary included."""
        return self.products.made()

    def light(self) -> "View":
        """Without what its dictionary's products are made of: with the next view of a model nobody asks for them."""
        return replace(self, products=Products())


@dataclass(frozen=True, eq=False)
class Look:
    """A model linearised on the training recordings, and again with their noise added once more."""

    linear: Linearization
    moved: Linearization | None
    dictionary: Dictionary | None
    noisy_dictionary: Dictionary | None
    of_states: bool = False
    """Whether noise of the states was added too, not of the inputs alone."""


class Search:
    """The steps of a discovery on one subject."""

    def __init__(
        self,
        subject: Subject,
        catalogue: Sequence[str] | None,
        tick: Callable[[str], None],
        noise: Noise | None = None,
        memory: int | None = None,
        long_windows: bool = False,
        as_stated: Collection[str] = (),
        longest: int = SEARCHING.longest,
    ) -> None:
        """Prepare.

        Args:
            subject: model and measurements.
            catalogue: ids of the effects to choose from; None: all.
            tick: called with what is being done.
            noise: default `noise.noise_of`.
            memory: order of the autoregression that whitens what is left; 0: all rows count alike, as in ordinary least
                squares; default: as the subject says, else `SEARCHING.memory`.
            long_windows: whether test functions are as long as a free run: of slow effects short ones show nothing but
                noise; so too where the subject says so.
            as_stated: names of constants that are never let go.
            longest: samples that are looked at, of all recordings together.
        """
        self.subject, self.catalogue, self.tick, self.as_stated = subject, catalogue, tick, frozenset(as_stated)
        self.memory = next(m for m in (memory, subject.memory, SEARCHING.memory) if m is not None)
        self.long_windows = long_windows or subject.long_windows
        logs = subject.of(subject.training)
        # Where the motion is slow against the sampling, a few samples a test function are enough.
        stride = max(1, stride_of(LogBatch.of(shortened(logs, longest))) // SEARCHING.fine)
        self.stack = LogBatch.of(shortened(logs, longest, stride, subject.model.held_channels(logs[0].inputs.shape[1])))
        self.notes = left_out(logs, self.stack.logs)
        self.stride = stride_of(self.stack)
        if self.long_windows:
            self.stride = max(self.stride, default_steps(self.stack.logs) // 2)
        self._made: dict[tuple[int, ...], TestFunctions] = {}
        self.noise = noise = noise or noise_of(subject)
        self.stack = replace(self.stack, noise=noise.processed)
        self._bent: dict[tuple[str, ...], bool] = {}
        self._all_noisy: LogBatch | None = None
        filters = [noise.smoothing_of(i).coarser(stride) for i in range(len(subject.model.state_channels))]
        self.smoothing = {c.name: f for c, f in zip(subject.model.state_channels, filters, strict=True)}
        drives = self.stack.inputs.shape[-1] - len(subject.model.extras)
        through = noise.input_weights if stride == 1 else noise.input_smoothing.coarser(stride).kernel()
        commanded = subject.model.input_hold == "previous"  # and known
        sigma = input_noise(self.stack, drives, through) * (not commanded)
        generator = np.random.default_rng(0)
        drawn = convolve1d(generator.normal(size=self.stack.inputs.shape) * sigma, through, axis=1)
        self.noisy = replace(self.stack, inputs=self.stack.inputs + torch.from_numpy(drawn)) if sigma.any() else None

    def of(self, subject: Subject) -> "Search":
        """The same recordings with something else known of the constants."""
        other = copy(self)
        other.subject = subject
        return other

    def smoothing_of(self, channel: Channel) -> Smoothing:
        """What a measured channel went through."""
        return self.smoothing.get(channel.name, Smoothing())

    def let_go(self, name: str | None) -> bool:
        """Whether there is a constant of this name to let go; nothing stated holds it from now on."""
        if name is None or name in self.as_stated:
            return False
        stated = [e for e in entries(self.subject.model, self.subject.uncertainty) if e.constant and e.name == name]
        text = ", ".join(f"{e.value:.3g}" for e in stated)
        note = (
            f"The stated {name.replace('_', ' ')} ({text} {stated[0].unit}) was let go: its equation wants it further "
            "off than its uncertainty, and would bend what it shares with others. What became of it stands among the "
            "constants."
        )
        uncertainty = {**self.subject.uncertainty, name: CALIBRATING.free}
        self.subject = replace(self.subject, uncertainty=uncertainty, notes=(*self.subject.notes, note))
        return True

    def own(self, model: PhysicsModel, settled: bool = False) -> Look:
        """Linearise ``model`` alone; ``settled``: in its numbers only, not in what each of its effects does."""
        return self._own(model, settled, self._bent.get(ids_of(model.effects), False))

    def _own(self, model: PhysicsModel, settled: bool, of_states: bool) -> Look:
        nominal, spread = self.subject.model, self.subject.uncertainty
        linear = directions(model, nominal, spread, self.stack, settled=settled)
        again = self._noisy(model) if of_states else self.noisy
        noisy = None if again is None else directions(model, nominal, spread, again, settled=settled, like=linear)
        return Look(linear, noisy and linear.moved(noisy), None, None, of_states)

    def bent(self, view: View) -> bool:
        """Whether noise of the states is found to bend numbers of a view's model by more than they are uncertain.

        A number that a fast state makes an equation of, such as the leakage of a pressure, is taken too small where
        the noise of that state is a fair share of it (errors in variables). Asked once for each set of effects, near
        the end of a fit; from then on what noise makes of the columns is taken off.
        """
        key = ids_of(view.linear.model.effects)
        if key in self._bent or self.stack.finer is not None or self.stack.means is not None:
            return False
        looks = (self._own(view.linear.model, True, of_states) for of_states in (False, True))
        plain, less = (self.views(look, like=view)[0].subsets for look in looks)
        fit, other, own = plain.fit(), less.fit(), len(plain.own)
        sigma = np.sqrt(np.diag(plain.covariance(fit)))[:own]
        self._bent[key] = bool((np.abs(other.beta - fit.beta)[:own] > SEARCHING.bent * sigma).any())
        return self._bent[key]

    def _noisy(self, model: PhysicsModel) -> LogBatch:
        """The recordings with the noise of states and inputs added once more; the same for every model."""
        if self._all_noisy is None:
            quiet = replace(self.noise, inputs=(0.0,) * len(self.noise.inputs))
            states = with_noise(model, self.stack, quiet)
            self._all_noisy = states if self.noisy is None else replace(states, inputs=self.noisy.inputs)
        return self._all_noisy

    def look(self, model: PhysicsModel, only: Collection[str] | None = None, broad: bool = True) -> Look:
        """Linearise ``model`` with every candidate.

        Args:
            model: with the effects found so far.
            only: of effects that are costly to try, those worth it; default all.
            broad: whether a dictionary of signals is looked at too; not needed near the right model, where the
                candidates leave only noise.
        """
        candidates = admissible(self.subject, model, self.catalogue)
        if only is not None:
            candidates = [(n, k) for n, k in candidates if n in only or not k.screen]
        nominal, spread = self.subject.model, self.subject.uncertainty
        pairs = acting_through(self.subject, model, self.catalogue)
        linear = directions(model, nominal, spread, self.stack, candidates, self.tick, pairs=pairs)
        words = dictionary(model, self.stack, linear.channels) if broad else None
        of_states = self._bent.get(ids_of(model.effects), False)
        noisy = self._noisy(model) if of_states else self.noisy
        if noisy is None:
            return Look(linear, None, words, None)
        # Of the costly candidates those that act on the inputs themselves carry the noise of these.
        touched = [(n, k) for n, k in candidates if of_states or not k.screen or issubclass(k, InputEffect)]
        moved = linear.moved(directions(model, nominal, spread, noisy, touched, pairs=pairs, like=linear))
        again = dictionary(model, noisy, linear.channels, like=words if of_states else None) if broad else None
        return Look(linear, moved, words, again, of_states)

    def views(self, look: Look, explained: Mapping[int, float] | None = None, like: View | None = None) -> list[View]:
        """Normal equations of a look through test functions: with the inputs' noise taken off, and as they are.

        Whitened as ``like`` is; default: by what is left.
        """
        tests, words = self.tests(look.linear), () if look.dictionary is None else look.dictionary.terms
        rows, count = look.linear.project(tests, look.dictionary), len(look.linear.columns)
        noisy = [count + i for i, t in enumerate(words) if look.of_states or t.signal in _OF_INPUT]
        noisy, again = [*range(count), *noisy], None
        if look.moved is not None:
            more = look.noisy_dictionary
            if more is not None and not look.of_states:
                more = more.following(_OF_INPUT)
            again = look.moved.project(tests, more)
        linear = replace(look.linear, columns=look.linear.columns.forgotten())
        reach, of_states = () if look.dictionary is None else look.dictionary.reach, look.of_states
        del look  # its columns take as much memory as the rows, and more than all that follows
        owed = None if again is None else rows.some(noisy).less(again)
        if like is None:
            prior = Prior.of(linear.own).loosened(linear.own)
            filters = noise_filters(rows, prior, self.memory, owed if of_states else None)
        else:
            filters = [like.filters[like.linear.channels.index(c)] for c in linear.channels]
        white = rows.whitened(filters)
        mine, some = white.some(range(count)), sum(white.counts())
        noise, drawn = (None, []) if owed is None else self._owed(owed.whitened(filters), linear, of_states)
        del again, owed
        products = Products(white)
        cleaned, normal = products, mine.normal()
        buried, doubtful = frozenset[int](), frozenset[int]()
        if noise is not None:
            cleaned = Products(white, [*noisy, rows.width], noise.sum(0) * some)
            noise = noise[:, [*range(count), -1]][..., [*range(count), -1]]
            buried, doubtful = drowned(linear, normal, noise * some, mine.power())

        def view(normal: Normal, products: Products, of_states: bool = False) -> View:
            return View(
                linear=linear,
                dictionary=tuple(words),
                subsets=Subsets(linear, normal, buried),
                products=products,
                reach=reach,
                explained=explained or {},
                doubtful=doubtful,
                filters=tuple(filters),
                of_states=of_states,
            )

        plain = view(normal, products)
        if noise is None:
            return [plain]
        less = view(normal.less(noise, drawn), cleaned, of_states)
        if (of_states and less.subsets.overdrawn) or less.overcorrected(less.subsets.fit()):
            return [plain]
        return [less] if of_states else [less, plain]

    def _owed(self, owed: Rows, linear: Linearization, of_states: bool) -> tuple[np.ndarray, list[np.ndarray]]:
        """What noise makes of the products: of a row (channels, c + 1, c + 1), and fold by fold of the columns alone.

        Noise of the states bends columns; what it leaves of the residual is the floor, and stays.
        """
        noise, drawn = owed.mean_gram(), owed.some(range(len(linear.columns))).folds()
        if of_states:
            by_inputs = self._squares(linear, linear.model, owed.filters, self.noisy)
            share = by_inputs.sum() / max(noise[:, -1, -1].sum(), 1e-300)
            noise[:, -1, -1] = by_inputs
            for gram in drawn:
                gram[-1, -1] *= share
        return noise, drawn

    def _squares(
        self, linear: Linearization, model: PhysicsModel, filters: Sequence[np.ndarray], noisy: LogBatch | None
    ) -> np.ndarray:
        """Mean square (channels,) of what noise that was added once more makes of a row's residual."""

        def rows(stack: LogBatch) -> Rows:
            rates = mean_rates(model, stack).numpy()[..., list(linear.channels)]
            bare = replace(linear, stack=stack, rates=rates, columns=linear.columns[:0])
            return bare.project(self.tests(linear))

        if noisy is None:
            return np.zeros(len(linear.channels))
        return rows(self.stack).less(rows(noisy)).whitened(filters).mean_gram()[:, -1, -1]

    def as_known(self, view: View) -> View:
        """The view with what is known of the constants now."""
        now = entries(view.linear.model, self.subject.uncertainty, self.subject.model)
        known = {e.label: e for e in now if e.constant}
        own = tuple(known[e.label] if e.constant else e for e in view.linear.own)
        linear = replace(view.linear, own=own)
        return replace(view, linear=linear, subsets=Subsets(linear, view.subsets.normal, view.subsets.buried))

    def tests(self, linear: Linearization) -> TestFunctions:
        """The test functions of what a model moves; made once for the same channels."""
        if linear.channels not in self._made:
            filters_of = [self.smoothing_of(linear.model.measured_channels[c]) for c in linear.channels]
            self._made[linear.channels] = TestFunctions.over(self.stack.logs, self.stride, filters_of)
        return self._made[linear.channels]

    def loss(self, view: View, model: PhysicsModel) -> float:
        """Squared residual that ``model`` leaves, whitened as in ``view``, and how far its constants lie from known."""
        rates = mean_rates(model, self.stack).numpy()[..., list(view.linear.channels)]
        if not np.isfinite(rates).all():
            return float("inf")  # unstable at this sampling rate
        bare = replace(view.linear, rates=rates, columns=view.linear.columns[:0])
        left = bare.project(self.tests(view.linear)).whitened(view.filters).normal()
        now = Prior.of(entries(model, self.subject.uncertainty, self.subject.model))
        total = float(left.total[-1, -1] + (now.precision * now.centre**2).sum())
        if view.of_states:  # a model that makes more of the noise leaves more, and is no worse for that
            noisy, here = self._noisy(model), view.linear.model
            more, less = (self._squares(view.linear, m, view.filters, noisy).sum() for m in (model, here))
            total -= float(more - less) * left.rows / len(view.linear.channels)
        return total


def ids_of(effects: Sequence[Effect]) -> tuple[str, ...]:
    """Ids of effects, in an order that is the same for the same effects."""
    return tuple(sorted(EFFECTS.name_of(type(e)) for e in effects))


def input_noise(stack: LogBatch, drives: int, through: np.ndarray) -> np.ndarray:
    """1σ (m,) of white noise in each input channel, before it went ``through`` a filter of these weights.

    From third differences: an upper bound where inputs are lively.
    """
    third = np.linalg.norm(np.convolve(through, [1.0, -3.0, 3.0, -1.0]))  # √20 without a filter
    rough = np.concatenate([np.diff(log.inputs.numpy(), n=3, axis=0) for log in stack.logs])
    sigma = rough.std(0) / third if len(rough) else np.zeros(stack.inputs.shape[-1])
    sigma[drives:] = 0.0
    return sigma
