"""What stands before and in the columns of a table: comments, a commented header, dates in place of seconds."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from registry.datasets.folder.dataset import Folder, check, draft
from registry.datasets.reading.tables import first_row, header, numbers, units
from registry.errors import BenchError


def drafted(folder: Path) -> str:
    text = draft(folder)
    (folder / "dataset.toml").write_text(text)
    return text


def test_comments_before_the_header_are_read_past_and_rows_are_counted(tmp_path: Path) -> None:
    samples = "".join(f"{k / 50},{k % 3},{60 * k}\n" for k in range(40))
    (tmp_path / "a.csv").write_text(f"# rig 3, second floor\n# t is in s\nt,volts,rpm\n{samples}")
    assert "rate_hz = 50 " in drafted(tmp_path)
    signals = Folder(str(tmp_path)).description.signals
    assert {n: s.unit for n, s in signals.items()} == {"volts": "V", "rpm": "rpm"}
    (r,) = check(tmp_path).recordings
    assert len(r) == 40
    np.testing.assert_allclose(r.pick(["rpm"])[0][:3, 0], [0.0, 60.0, 120.0])
    (tmp_path / "a.csv").write_text("# one\n# two\nt,x\ns,m\n0,1\n1,text\n")
    assert first_row(tmp_path / "a.csv") == 5
    with pytest.raises(BenchError, match="row 6: 'text'"):
        numbers(tmp_path / "a.csv", ["t", "x"])


def test_a_header_that_is_a_comment_is_the_header(tmp_path: Path) -> None:
    values = np.column_stack([np.arange(40) / 20, np.arange(40) % 3, np.arange(40.0)])
    np.savetxt(tmp_path / "a.csv", values, delimiter=",", header="t,u,temp_C")
    assert header(tmp_path / "a.csv") == ["# t", "u", "temp_C"]
    text = drafted(tmp_path)
    assert 'time = "# t"' in text and "rate_hz = 20 " in text and 'input = ["u"]' in text and 'unit = "degC"' in text
    (r,) = check(tmp_path).recordings
    np.testing.assert_allclose(r.pick(["temp_C"])[0][:, 0], np.arange(40))


def test_units_may_follow_a_header_that_is_a_comment(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(
        "# logged by hand, once\n#t,u,y\nms,V,-\n" + "".join(f"{k},1,2\n" for k in range(5))
    )
    assert header(tmp_path / "a.csv") == ["#t", "u", "y"] and first_row(tmp_path / "a.csv") == 4
    assert units(tmp_path / "a.csv") == {"#t": "ms", "u": "V", "y": "1"}


def test_velocity_along_the_body_is_told_by_its_usual_letters_of_a_vehicle_only(tmp_path: Path) -> None:
    def written(*names: str) -> str:
        columns = {"t": np.arange(40) / 20, **{n: np.arange(40.0) for n in names}}
        pd.DataFrame(columns).to_csv(tmp_path / "a.csv", index=False)
        return draft(tmp_path)

    vehicle = written(*"uvwpqr", "m1_rpm", "m2_rpm", "m3_rpm", "m4_rpm")
    assert 'velocity = {columns = ["u", "v", "w"], unit = "m/s", frame = "body"}' in vehicle
    assert "# mass = …" in vehicle and "# rotor_radius = 0.127" in vehicle and "pwm_" not in vehicle
    down = written("north", "east", "down", *"uvwpqr")
    assert 'velocity = {columns = ["u", "v", "w"], unit = "m/s", frame = "frd"}' in down
    assert "velocity = " not in written(*"uvw", "flow")  # three valves


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_dates_are_seconds_since_the_first(ending: str, tmp_path: Path) -> None:
    """Across an hour that clocks show twice: only the offset tells them apart."""
    at = pd.date_range("2025-10-26T00:59:55Z", periods=40, freq="250ms").tz_convert("Europe/Berlin")
    table = pd.DataFrame({"timestamp": at, "valve": np.arange(40) % 5, "flow_lpm": np.arange(40.0)})
    if ending == "csv":
        table.assign(timestamp=[t.isoformat() for t in at]).to_csv(tmp_path / "a.csv", index=False)
    else:
        table.to_parquet(tmp_path / "a.parquet")
    text = drafted(tmp_path)
    assert "rate_hz = 4 " in text and "time_unit" not in text and 'unit = "L/min"' in text
    (r,) = check(tmp_path).recordings
    np.testing.assert_allclose(r.pick(["flow_lpm"])[0][:, 0], np.arange(40))


def test_a_date_that_is_none_is_told_by_its_row(tmp_path: Path) -> None:
    rows = "".join(f"2025-03-01T12:00:{k:02d}Z,{k}\n" for k in range(30)).replace("12:00:07Z", "noon")
    (tmp_path / "a.csv").write_text(f"time,x\n{rows}")
    with pytest.raises(BenchError, match="row 9: '2025-03-01Tnoon'"):
        numbers(tmp_path / "a.csv", ["time", "x"], time="time")
