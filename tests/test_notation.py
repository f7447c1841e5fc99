import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.experiment.notation import Label, label, parse, write
from registry.core import INITIALIZERS, PREDICTORS
from registry.errors import BenchError


@pytest.mark.parametrize(
    ("text", "canonical"),
    [
        ("LSTM: 2x50 - MLP: 100x10", "LSTM: 2x50 - MLP: 100x10"),
        ("lstm:2×50-mlp:100 × 10", "LSTM: 2x50 - MLP: 100x10"),
        ("  MLFC :  1 x 50  -  Washout :  10 ", "MLFC: 1x50 - Washout: 10"),
        ("LSTM TDL: 7x200 - RNN: 2500x10", "LSTM TDL: 7x200 - RNN: 2500x10"),
        ("LSTM - Washout", "LSTM: 1x50 - Washout: 10"),
        ("constant", "constant"),
    ],
)
def test_reads_the_papers_notation(text: str, canonical: str) -> None:
    assert write(*parse(text)) == canonical


@given(
    st.sampled_from(["LSTM", "LSTM TDL", "MLFC"]),
    st.integers(1, 20),
    st.integers(1, 2000),
    st.sampled_from(["MLP", "RNN"]),
    st.integers(1, 10000),
    st.integers(1, 10000),
)
def test_write_then_parse_is_the_identity(p: str, layers: int, hidden: int, i: str, width: int, tau: int) -> None:
    text = f"{p}: {layers}x{hidden} - {i}: {width}x{tau}"
    assert write(*parse(text)) == text
    assert label(text) == Label(p, f"{layers}x{hidden}", i, tau)


@pytest.mark.parametrize("name", PREDICTORS.names())
def test_a_label_tells_what_is_trained_by_gradient(name: str) -> None:
    kind = PREDICTORS.get(name)
    spec = write(kind(), INITIALIZERS.get("Washout")() if kind.stateful else None)
    assert label(spec).trained == (kind.training == "gradient")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("LSTN: 1x50 - MLP: 60x10", "did you mean LSTM"),
        ("LSTM: 1x50 - MLQ: 60x10", "did you mean MLP"),
        ("LSTM: 1xfifty - MLP: 60x10", "character 9"),
        ("LSTM: 0x50 - MLP: 60x10", "character 7"),
        ("PySINDy: 1x20", "has no size: options are set by name, as in --set predictor.delays=2"),
        ("LSTM: 50 - MLP: 60x10", "layers x hidden"),
        ("LSTM: 1x50 - Washout: 60x10", "expected history"),
        ("LSTM: 1x50", "names no initializer"),
        ("constant - MLP: 60x10", "no states to initialize"),
        ("LSTM: 1x50 - MLP: 60x10 - RNN: 5x5", "3 parts"),
        ("LSTM: 1x50 - : 60x10", "a name is missing"),
        ("", "empty"),
    ],
)
def test_a_wrong_one_says_where(text: str, says: str) -> None:
    with pytest.raises(BenchError, match=says):
        parse(text)
