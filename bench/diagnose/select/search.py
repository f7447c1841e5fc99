"""A model and all its rivals on the training recordings, linearised, whitened, ready to choose from."""

from collections.abc import Callable, Collection, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.ndimage import convolve1d

from bench.diagnose.logs.noise import Noise, noise_of
from bench.diagnose.logs.sample import left_out, shortened, typical_length
from bench.diagnose.logs.smoothing import Smoothing
from bench.diagnose.logs.subject import LogBatch, Subject
from bench.diagnose.regression.generic import Dictionary, Folds, Term, dictionary, follow
from bench.diagnose.regression.least_squares import Normal, regularised, whitening
from bench.diagnose.regression.linearise import Linearization, directions
from bench.diagnose.regression.parameters import Prior, entries
from bench.diagnose.regression.rows import Crossings, Products, Rows
from bench.diagnose.regression.test_functions import TestFunctions
from bench.diagnose.regression.weak import mean_rates
from bench.diagnose.select.catalogue import acting_through, admissible
from bench.diagnose.select.subset import Fit, Subsets, acting
from bench.diagnose.settings import CALIBRATING, CHOOSING, SEARCHING
from bench.diagnose.simulate.free_run import default_steps
from registry.contracts import Channel
from registry.dynamics import InputEffect, PhysicsModel

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
    """A model linearised on the training recordings, and again with the inputs' noise added once more."""

    linear: Linearization
    moved: Linearization | None
    dictionary: Dictionary | None
    noisy_dictionary: Dictionary | None


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
        held = subject.model.input_hold == "previous"
        self.stack = LogBatch.of(shortened(logs, longest, stride, held))
        self.notes = left_out(logs, self.stack.logs)
        self.stride = stride_of(self.stack)
        if self.long_windows:
            self.stride = max(self.stride, default_steps(self.stack.logs) // 2)
        self._made: dict[tuple[int, ...], TestFunctions] = {}
        noise = noise or noise_of(subject)
        filters = [noise.smoothing_of(i).coarser(stride) for i in range(len(subject.model.state_channels))]
        self.smoothing = {c.name: f for c, f in zip(subject.model.state_channels, filters, strict=True)}
        drives = self.stack.inputs.shape[-1] - len(subject.model.extras)
        through = noise.input_weights if stride == 1 else noise.input_smoothing.coarser(stride).kernel()
        sigma = input_noise(self.stack, drives, through) * (not held)  # commands are known
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
        nominal, spread = self.subject.model, self.subject.uncertainty
        linear = directions(model, nominal, spread, self.stack, settled=settled)
        noisy = None if self.noisy is None else directions(model, nominal, spread, self.noisy, settled=settled)
        return Look(linear, noisy and linear.moved(noisy), None, None)

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
        if self.noisy is None:
            return Look(linear, None, words, None)
        # Of the costly candidates those that act on the inputs themselves carry their noise.
        touched = [(n, k) for n, k in candidates if not k.screen or issubclass(k, InputEffect)]
        moved = linear.moved(directions(model, nominal, spread, self.noisy, touched, pairs=pairs))
        return Look(linear, moved, words, dictionary(model, self.noisy, linear.channels) if broad else None)

    def views(self, look: Look, explained: Mapping[int, float] | None = None, like: View | None = None) -> list[View]:
        """Normal equations of a look through test functions: with the inputs' noise taken off, and as they are.

        Whitened as ``like`` is; default: by what is left.
        """
        tests, words = self.tests(look.linear), () if look.dictionary is None else look.dictionary.terms
        rows, count = look.linear.project(tests, look.dictionary), len(look.linear.columns)
        noisy = [*range(count), *(count + i for i, t in enumerate(words) if t.signal in _OF_INPUT)]
        again = None
        if look.moved is not None:
            of_input = None if look.noisy_dictionary is None else look.noisy_dictionary.following(_OF_INPUT)
            again = look.moved.project(tests, of_input)
        linear = replace(look.linear, columns=look.linear.columns.forgotten())
        reach = () if look.dictionary is None else look.dictionary.reach
        del look  # its columns take as much memory as the rows, and more than all that follows
        if like is None:
            filters = noise_filters(rows, Prior.of(linear.own).loosened(linear.own), self.memory)
        else:
            filters = [like.filters[like.linear.channels.index(c)] for c in linear.channels]
        white = rows.whitened(filters)
        mine, some = white.some(range(count)), sum(white.counts())
        owed = None if again is None else rows.some(noisy).less(again).whitened(filters)
        noise, drawn = (None, []) if owed is None else (owed.mean_gram(), owed.some(range(count)).folds())
        del again, owed
        products = Products(white)
        cleaned, normal = products, mine.normal()
        buried, doubtful = frozenset[int](), frozenset[int]()
        if noise is not None:
            cleaned = Products(white, [*noisy, rows.width], noise.sum(0) * some)
            noise = noise[:, [*range(count), -1]][..., [*range(count), -1]]
            by_channel = mine.power()
            power = by_channel.sum(0)[:count]
            drowned = some * noise.sum(0).diagonal()[:count] > SEARCHING.buried * power
            buried = frozenset(np.flatnonzero(drowned).tolist())
            buried -= _acting(Subsets(linear, normal), buried, some * noise, by_channel)
            hidden = [c for c in buried if c < len(linear.own)]
            doubtful = frozenset(i for c in hidden for i in np.flatnonzero(by_channel[:, c] > 0.1 * power[c]).tolist())

        def view(normal: Normal, products: Products) -> View:
            return View(
                linear=linear,
                dictionary=tuple(words),
                subsets=Subsets(linear, normal, buried),
                products=products,
                reach=reach,
                explained=explained or {},
                doubtful=doubtful,
                filters=tuple(filters),
            )

        plain = view(normal, products)
        if noise is None:
            return [plain]
        less = view(normal.less(noise, drawn), cleaned)
        return [plain] if less.overcorrected(less.subsets.fit()) else [less, plain]

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
        return float(left.total[-1, -1] + (now.precision * now.centre**2).sum())


def stride_of(stack: LogBatch) -> int:
    """Samples between test functions: short against the motion, long against the sampling."""
    x = np.zeros(tuple(stack.states.shape))
    for i, log in enumerate(stack.logs):
        x[i, : len(log)] = (log.states - log.states.mean(0)).numpy()
    power = (np.abs(np.fft.rfft(x, axis=1)) ** 2).sum(0)
    share = np.cumsum(power, axis=0) / np.maximum(power.sum(0), 1e-300)
    moving = np.flatnonzero(power.sum(0) > 0)
    fastest = max((int(np.searchsorted(share[:, c], 0.95)) for c in moving), default=1) / x.shape[1]  # cycles a sample
    return int(np.clip(round(0.15 / max(fastest, 1e-6)), 2, max(2, round(SEARCHING.stride / stack.dt))))


def _acting(subsets: Subsets, buried: Collection[int], noise: np.ndarray, power: np.ndarray) -> frozenset[int]:
    """Columns of effects that explain more than all noise of the inputs could that the model's own numbers let in.

    What was taken for noise moves the vehicle then: a controller that acts on a noisy sensor makes inputs as lively.

    Args:
        subsets: of rows from which no noise was taken off.
        buried: columns that are mostly noise of the inputs.
        noise: (channels, c + 1, c + 1) what it makes of the products of all rows.
        power: (channels, c + 1) of every column.
    """
    bare = subsets.fit()
    index = [*bare.columns, -1]
    vector = np.append(-bare.beta, 1.0)
    left = np.array([vector @ of[np.ix_(index, index)] @ vector for of in noise])
    found: set[int] = set()
    for start in (s for s in subsets.starts if set(s.columns) & set(buried)):
        own = start.columns[len(start.columns) - len(start.entries) :]
        acts = power[:, own].any(1)
        if bare.loss - subsets.fit([start]).loss > left[acts].sum() + subsets.penalty * len(own):
            found |= set(own)
    return frozenset(found)


def input_noise(stack: LogBatch, drives: int, through: np.ndarray) -> np.ndarray:
    """1σ (m,) of white noise in each input channel, before it went ``through`` a filter of these weights.

    From third differences: an upper bound where inputs are lively.
    """
    third = np.linalg.norm(np.convolve(through, [1.0, -3.0, 3.0, -1.0]))  # √20 without a filter
    rough = np.concatenate([np.diff(log.inputs.numpy(), n=3, axis=0) for log in stack.logs])
    sigma = rough.std(0) / third if len(rough) else np.zeros(stack.inputs.shape[-1])
    sigma[drives:] = 0.0
    return sigma


def noise_filters(rows: Rows, prior: Prior, memory: int = SEARCHING.memory) -> list[np.ndarray]:
    """Whitening filters, a channel each, of what is left when the model's numbers and the most telling columns fit.

    The numbers fit beside what is known of them: a free fit would give up one equation, call that noise, and believe it
    no more. Few columns, each worth its place on recordings not fitted: many would explain slow disturbances by chance,
    and what is left would be taken for all the noise there is.

    Args:
        rows: of the weak form; the model's numbers are the first columns.
        prior: of these.
        memory: order of the autoregression; 0: what is left is only scaled, so that where it stays on one side counts.
    """
    spread = [
        max(float(np.concatenate([log[c][:, -1] for log in rows.parts]).std()), 1e-300) for c in range(rows.channels)
    ]
    filters = [np.array([1 / s]) for s in spread]
    own = list(range(len(prior.low)))
    for _ in range(2):
        products = Crossings(rows.whitened(filters))
        columns = [*own, *_telling(products, prior)]
        more = len(columns) - len(own)
        none, free = np.zeros(more), np.full(more, np.inf)
        beta = np.zeros(rows.width)
        beta[columns] = regularised(
            np.asarray(sum(Folds.of(products, columns).products())),
            range(len(columns)),
            np.append(prior.precision, none),
            np.append(prior.centre, none),
            np.append(prior.low, -free),
            np.append(prior.high, free),
        )
        left = rows.residuals(beta)
        if memory:
            order = min(memory, max(1, typical_length(left) // 20))
            filters = [whitening([r[:, c] for r in left], order) for c in range(rows.channels)]
        else:
            filters = [np.array([1 / max(rms, 1e-300)]) for rms in _rms(left)]
    return filters


def _rms(left: Sequence[np.ndarray]) -> np.ndarray:
    """Root mean squares (channels,) of residuals (J, channels) of some logs."""
    return np.sqrt(np.mean(np.concatenate(left) ** 2, axis=0))


def _telling(products: Crossings, prior: Prior) -> list[int]:
    """Columns beyond the model's own numbers that tell most of what these leave; those at a bound stay there."""
    own = range(len(prior.low))
    total = np.asarray(sum(Folds.of(products, own).products()))
    beta = regularised(total, own, prior.precision, prior.centre, prior.low, prior.high)
    shift = np.zeros(len(products.squares))
    shift[list(own)] = -beta
    inside = [c for c in own if prior.low[c] < beta[c] < prior.high[c]]
    return [c for c, _ in follow(Folds.of(products, inside, shift), len(own), SEARCHING.telling)]
