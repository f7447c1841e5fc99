"""Every comparison of the paper is declared with the paper's architectures, at both horizons, with paired seeds."""

from collections import defaultdict
from dataclasses import replace

import pytest
import torch

from bench.experiment import study
from bench.experiment.config import RunConfig
from bench.experiment.datasets import choose
from bench.experiment.grid import matched
from bench.experiment.notation import parse
from bench.experiment.request import Options, request
from bench.training.data import prepare
from bench.training.model import build_scaled
from registry.contracts import Problem
from registry.core import DATASETS
from registry.errors import BenchError

PAPER = {  # as listed in the paper's section "Results and Discussions"
    "washout_vs_mlp": {
        "MLFC: 1x50 - MLP: 60x10",
        "MLFC: 1x50 - Washout: 10",
        "LSTM: 1x50 - MLP: 60x10",
        "LSTM: 1x50 - Washout: 10",
    },
    "mlfc_vs_lstm": {
        "MLFC: 1x50 - MLP: 60x10",
        "MLFC: 2x50 - MLP: 100x10",
        "MLFC: 2x100 - MLP: 200x10",
        "LSTM: 1x50 - MLP: 60x10",
        "LSTM: 2x50 - MLP: 100x10",
    },
    "mlp_vs_rnn_init": {
        "LSTM: 7x200 - MLP: 15000x10",
        "LSTM: 7x200 - RNN: 2500x10",
        "LSTM TDL: 7x200 - MLP: 15000x10",
        "LSTM TDL: 7x200 - RNN: 2500x10",
    },
    "helicopter_black_box": {
        "LSTM: 7x200 - MLP: 15000x10",
        "LSTM: 7x200 - RNN: 2500x10",
        "LSTM TDL: 7x200 - MLP: 15000x10",
        "LSTM TDL: 7x200 - RNN: 2500x10",
    },
    "quadrotor_black_box": {
        "Cascade: 7x200 - MLP: 15000x10",
        "Cascade: 7x200 - RNN: 2500x10",
        "Cascade TDL: 7x200 - MLP: 15000x10",
        "Cascade TDL: 7x200 - RNN: 2500x10",
    },
    "quadrotor_hybrid": {"Hybrid: 4x200 - MLP: 5000x10"},
    "motion_model_compensation": {"Hybrid: 4x200 - MLP: 5000x10"},
}
STUDIES = study.studies()


def test_no_comparison_of_the_paper_is_missing() -> None:
    assert PAPER.keys() <= STUDIES.keys()


@pytest.mark.parametrize("name", PAPER)
def test_the_paper_preset_has_the_papers_architectures(name: str) -> None:
    found = STUDIES[name]
    runs = found.runs("paper", DATASETS.get(found.default_dataset)())
    assert PAPER[name] <= {r.spec for r in runs}
    assert {r.horizon for r in runs} == {40, 190}
    assert {r.tau for r in runs} == {10}


@pytest.mark.parametrize("name", STUDIES)
@pytest.mark.parametrize("preset", study.PRESETS)
def test_seeds_are_paired_and_every_pair_is_there(name: str, preset: str) -> None:
    found = STUDIES[name]
    if preset not in found.presets:
        with pytest.raises(BenchError, match=f"{name} has no preset '{preset}'"):
            request(name, Options(preset=preset))
        return
    runs = found.runs(preset, DATASETS.get(found.default_dataset)())
    seeds = defaultdict(set)
    for run in runs:
        if run.predictor.training == "gradient":
            seeds[run.horizon, run.outputs].add((run.spec, run.seed))
    for drawn in seeds.values():
        specs, numbers = {s for s, _ in drawn}, {n for _, n in drawn}
        assert drawn == {(s, n) for s in specs for n in numbers} and len(numbers) >= (1 if preset == "laptop" else 2)
    specs = list(dict.fromkeys(r.spec for r in runs))
    for pair in found.pairs:
        assert list(matched([pair], specs)), pair


def test_more_seeds_of_a_study_are_its_runs_and_more() -> None:
    """What is recorded of the preset is not trained again, and what has no seed is run once."""
    preset, more = (request("washout_vs_mlp", Options(seeds=n)) for n in (None, 5))
    assert [c for c in more.configs if c.seed < 3] == preset.configs
    assert {c.seed for c in more.configs if c.spec.startswith("LSTM")} == set(range(5))
    assert {c.seed for c in more.configs if c.spec in ("linear", "constant")} == {0}
    assert more.title == f"{preset.title}, 5 seeds"


def test_some_configurations_of_a_study_are_its_own_runs() -> None:
    """The same runs, beside the baselines, under a title of their own."""
    whole, some = (request("mlfc_vs_lstm", Options(only=p)) for p in ((), ("MLFC A_o: *",)))
    assert [c for c in whole.configs if "A_o" in c.spec or c.predictor.training != "gradient"] == some.configs
    assert len({c.spec for c in some.configs}) == 3 + 3 and some.title == f"{whole.title}, only MLFC A_o: *"
    with pytest.raises(BenchError, match="no configuration like"):
        request("mlfc_vs_lstm", Options(only=("MLFC Ao: *",)))
    with pytest.raises(BenchError, match="--only belongs to a study"):
        request("LSTM: 1x50 - MLP: 60x10", Options(only=("LSTM*",)))


def test_the_black_box_starts_from_what_the_hybrid_starts_from() -> None:
    """With the attitude of its history, which the hybrid's physics begins with; the one without stands beside."""
    for preset in ("laptop", "evening", "paper"):
        runs = STUDIES["quadrotor_hybrid"].runs(preset, DATASETS.get("pelican_twin")())
        seen = {r.spec.partition(":")[0]: r.resolved().context for r in runs}
        assert set(seen["Hybrid"]) - {"position"} == set(seen["Cascade attitude"]) == {"attitude"}
        assert seen["Cascade"] == ()


def test_a_hybrid_without_the_state_cost_is_one_with_no_weight_on_it() -> None:
    """The same numbers as β = 0, by another name."""
    outputs = {"outputs": ("velocity", "body_rates"), "horizon": 5}
    named, plain = (
        RunConfig(*parse(f"Hybrid: 1x8 - {initializer}: 9x10"), DATASETS.get("pelican_twin")(), **outputs)
        for initializer in ("MLP no L_si", "MLP")
    )
    found = []
    for run in (named, replace(plain, training=replace(plain.training, beta=0.0)), plain):
        run = run.resolved()
        data = prepare(run)
        torch.manual_seed(0)
        model = build_scaled(run, data)
        windows = data.gather(data.validation.every(4).starts)
        found.append(model(*windows, 1.0, run.training.beta).item())
    assert found[0] == found[1] < found[2]


def test_patterns_name_configurations_and_not_their_relatives() -> None:
    specs = ["LSTM: 2x50 - MLP: 200x10", "LSTM: 2x50 - RNN: 60x10", "LSTM TDL: 2x50 - MLP: 200x10", "linear"]
    assert list(matched([("LSTM: * - RNN: *", "LSTM: * - MLP: *")], specs)) == [(specs[1], specs[0])]
    assert list(matched([(specs[0], "linear"), ("LSTM*", "linear")], specs)) == [
        (specs[0], "linear"),
        (specs[1], "linear"),
        (specs[2], "linear"),
    ]


def test_a_study_flies_the_twin_in_full_unless_told_otherwise() -> None:
    assert choose("pelican_twin", full=True).size == "full"  # type: ignore[attr-defined]
    assert choose("pelican_twin", {"size": "small"}, full=True).size == "small"  # type: ignore[attr-defined]
    assert choose("emps", full=True) == choose("emps")


def test_an_evening_has_what_gets_most_out_of_an_update() -> None:
    """Increments for black boxes, growing windows at T = 190."""
    runs = STUDIES["quadrotor_hybrid"].runs("evening", DATASETS.get("pelican_twin")())
    by_kind = {type(r.predictor).__name__: r for r in runs if r.horizon == 190}
    assert by_kind["Cascade"].predictor.increments and by_kind["CascadeAttitude"].predictor.increments
    assert by_kind["Hybrid"].training.first_horizon == 20
    assert {r.training.first_horizon for r in runs if r.horizon == 40} == {0}


@pytest.mark.parametrize("name", ["mlp_vs_rnn_init", "helicopter_black_box", "quadrotor_black_box", "quadrotor_hybrid"])
def test_large_networks_are_kept_from_overfitting_as_the_paper_says(name: str) -> None:
    found = STUDIES[name]
    for run in found.runs("paper", DATASETS.get(found.default_dataset)()):
        if run.predictor.training == "gradient":
            assert run.predictor.weight_scale == run.initializer.weight_scale == 0.1
            assert run.training.weight_decay > 0 and getattr(run.predictor, "dropout", 0.1) > 0
    assert all(r.training.weight_decay == 0 for r in found.runs("laptop", DATASETS.get(found.default_dataset)()))


def test_initializers_of_an_evening_have_as_many_weights() -> None:
    runs = STUDIES["mlp_vs_rnn_init"].runs("evening", DATASETS.get("helicopter_twin")())
    channels = Problem.plain(4, 3, 40, 10)
    counts = []
    for spec in dict.fromkeys(r.spec for r in runs if r.spec.startswith("LSTM: ")):
        run = next(r for r in runs if r.spec == spec)
        counts.append(run.initializer.build(run.predictor.build(channels), channels).weight_count())
    assert len(counts) == 2 and max(counts) / min(counts) < 1.05
