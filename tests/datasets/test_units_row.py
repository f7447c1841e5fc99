"""A second row of units: read past, taken for the draft, and never mistaken for samples."""

from pathlib import Path

import numpy as np
import pytest

from registry.datasets.folder.dataset import Folder, check, draft
from registry.datasets.reading.tables import first_row, numbers, units
from registry.errors import BenchError
from registry.units import unit_of

UNITS = "ms,mm,mm,mm,deg,deg,[deg],°/s,deg/s,deg/sec,RPM,RPM,RPM,RPM,mV"
NAMES = "time,x,y,z,roll,pitch,yaw,p,q,r,m1_rpm,m2_rpm,m3_rpm,m4_rpm,vbat".replace("_rpm", "")


def rows(count: int = 50) -> str:
    return "".join(f"{10 * k},1000,{k},3,0,0,90,{k},0,180,60,60,60,{k},3900\n" for k in range(count))


def test_the_draft_has_the_units_of_the_row_and_the_samples_follow(tmp_path: Path) -> None:
    names = NAMES.replace("m1,m2,m3,m4", "rotor1,rotor2,rotor3,rotor4")
    (tmp_path / "a.csv").write_text(f"{names}\n{UNITS}\n{rows()}")
    text = draft(tmp_path)
    assert 'time_unit = "ms"' in text and "rate_hz = 100" in text
    (tmp_path / "dataset.toml").write_text(text)
    (r,) = check(tmp_path).recordings
    assert len(r) == 50
    np.testing.assert_allclose(r.pick(["position"])[0][:, 0], 1.0)
    np.testing.assert_allclose(r.pick(["body_rates"])[0][:, 2], np.pi)
    np.testing.assert_allclose(r.inputs[:, :3], 2 * np.pi)
    np.testing.assert_allclose(r.pick(["battery"])[0], 3.9)


def test_signals_of_ones_own_have_the_units_of_the_row(tmp_path: Path) -> None:
    samples = "".join(f"{k},{k % 3},7.{k % 10},20\n" for k in range(40))
    (tmp_path / "a.csv").write_text(f"t,pump,ph,temp\ns,L/min,-,°C\n{samples}")
    (tmp_path / "dataset.toml").write_text(draft(tmp_path))
    signals = Folder(str(tmp_path)).description.signals
    assert {n: s.unit for n, s in signals.items()} == {"pump": "L/min", "ph": "1", "temp": "degC"}
    assert "check every unit" not in (tmp_path / "dataset.toml").read_text()


@pytest.mark.parametrize("separator", [";", "\t"])
def test_files_with_commas_in_their_numbers_are_read(separator: str, tmp_path: Path) -> None:
    """As a spreadsheet saves them where a comma is the decimal sign; the time is told by its unit."""
    samples = "".join(f"{100 * k};{k % 3},5;7,{k % 10}\n" for k in range(40))
    (tmp_path / "a.csv").write_text(f"Zeit;Pumpe;pH\nms;L/min;-\n{samples}".replace(";", separator))
    text = draft(tmp_path)
    assert 'time = "Zeit"' in text and "rate_hz = 10 " in text and 'time_unit = "ms"' in text
    (tmp_path / "dataset.toml").write_text(text)
    (r,) = check(tmp_path).recordings
    np.testing.assert_allclose(r.pick(["Pumpe"])[0][:4, 0], [0.5, 1.5, 2.5, 0.5])
    np.testing.assert_allclose(r.pick(["pH"])[0][:4, 0], [7.0, 7.1, 7.2, 7.3])


def test_rows_are_counted_as_a_spreadsheet_does(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,x\ns,m\n0,1\n1,text\n")
    assert first_row(tmp_path / "a.csv") == 3
    with pytest.raises(BenchError, match="row 4: 'text'"):
        numbers(tmp_path / "a.csv", ["t", "x"])


def test_a_number_beyond_all_floats_is_none(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(f"t,x\ns,m\n0,1\n1,{'1' * 400}\n")
    with pytest.raises(BenchError, match=r"row 4: '1111.* not a finite number"):
        numbers(tmp_path / "a.csv", ["t", "x"])


@pytest.mark.parametrize("second", ["0,1", "1,1", "s,1", "nan,nan", ",", "s,idle", "s", "s,m,s"])
def test_what_may_be_samples_is_no_row_of_units(second: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(f"t,x\n{second}\n1,2\n")
    assert units(tmp_path / "a.csv") == {} and first_row(tmp_path / "a.csv") == 2


@pytest.mark.parametrize(
    ("text", "meant"),
    [("m/s²", "m/s^2"), ("[deg]", "deg"), ("°/s", "deg/s"), ("RPM", "rpm"), ("rad/sec", "rad/s"), ("m/s/s", "m/s^2")],
)
def test_units_as_people_write_them(text: str, meant: str) -> None:
    assert unit_of(text) == meant


@pytest.mark.parametrize("text", ["", "idle", "nan", "3", "m" * 30, "m^9^9^9", "__import__('os')"])
def test_what_is_no_unit(text: str) -> None:
    assert unit_of(text) == ""
