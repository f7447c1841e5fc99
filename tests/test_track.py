"""The MLflow mirror, read back with plain SQL: independent of the client that wrote it."""

import logging
import re
import signal
import socket
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from synthetic_records import resealed, synthetic_record

from bench.records.record import RunRecord
from bench.tracking import track
from bench.tracking.ui import chart_link, serve, server
from registry.errors import BenchError


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    return tmp_path_factory.mktemp("results")


@pytest.fixture(scope="module")
def records(results):
    runs = results / "runs"
    return [synthetic_record(runs, growth=0.5), synthetic_record(runs, seed=1, diverged=True, horizon=190)]


@pytest.fixture(scope="module")
def mirrored(results, records):
    return track.mirror([r.folder for r in records], track.default_uri(results), "washout_vs_mlp", "washout_vs_mlp")


def rows(results: Path, query: str, *values: str) -> list[tuple]:
    with sqlite3.connect(results / "mlflow.db") as database:
        return database.execute(query, values).fetchall()


def contents(results: Path) -> dict[str, list[tuple]]:
    tables = ("runs", "metrics", "params", "tags", "inputs", "datasets")
    return {t: sorted(rows(results, f"SELECT * FROM {t}"), key=str) for t in tables}


def test_per_step_curve_has_prediction_step_as_step(results, mirrored):
    curve = rows(
        results,
        "SELECT step, value FROM metrics WHERE run_uuid = ? AND key = ? ORDER BY step",
        mirrored.run_ids[0],
        "error_mean/body_rates.p T40 deg per s",
    )
    assert [s for s, _ in curve] == list(range(1, 41))
    np.testing.assert_allclose([v for _, v in curve], 0.5 * np.sqrt(np.arange(1, 41)))


def test_a_single_axis_is_not_drawn_again_as_its_norms(results, mirrored):
    names = {k for (k,) in rows(results, "SELECT DISTINCT key FROM metrics WHERE run_uuid = ?", mirrored.run_ids[0])}
    errors = {f"error_{s}/body_rates.p T40 deg per s" for s in track.CHARTED}
    assert names == errors | {"learning/train_loss", "learning/validation_loss", "rmsse", "rmsse.body_rates"}


def test_norms_are_drawn_where_several_axes_are_predicted(records):
    record = RunRecord(records[0].folder)
    second = record.steps[record.steps.norm == "axis"].assign(quantity="body_rates.q")
    record.__dict__["steps"] = pd.concat([record.steps, second])
    names = {name for name, _, _ in track.metrics(record)[0]}
    assert "error_mean/body_rates paper norm T40 deg per s" in names
    assert "error_mean/body_rates.q T40 deg per s" in names


def test_diverged_run_is_failed_and_its_infinite_points_are_named_not_drawn(results, mirrored):
    run = mirrored.run_ids[1]
    assert rows(results, "SELECT status FROM runs WHERE run_uuid = ?", run) == [("FAILED",)]
    assert rows(results, "SELECT count(*) FROM metrics WHERE value > 1e300 OR is_nan") == [(0,)]
    tags = dict(rows(results, "SELECT key, value FROM tags WHERE run_uuid = ?", run))
    assert tags["status"] == "diverged" and tags["diverged_at"] == "update 700"
    assert "error_mean/body_rates.p T190 deg per s: 1 points" in tags["not_finite"]
    key = "error_q95/body_rates.p T190 deg per s"
    assert rows(results, "SELECT max(step) FROM metrics WHERE run_uuid = ? AND key = ?", run, key) == [(189,)]


def test_run_carries_config_tags_dataset_and_files(results, records, mirrored):
    run, record = mirrored.run_ids[0], records[0]
    (name, status, start, end, artifacts) = rows(
        results, "SELECT name, status, start_time, end_time, artifact_uri FROM runs WHERE run_uuid = ?", run
    )[0]
    assert name == "LSTM: 1x50 - MLP: 60x10 | body_rates.p | T=40 | seed 0"
    assert (status, start, end) == ("FINISHED", record.provenance["started_ms"], record.provenance["finished_ms"])
    params = dict(rows(results, "SELECT key, value FROM params WHERE run_uuid = ?", run))
    assert params["training.updates"] == "1500" and params["predictor.name"] == "LSTM"
    assert params["outputs"] == '["body_rates.p"]'
    tags = dict(rows(results, "SELECT key, value FROM tags WHERE run_uuid = ?", run))
    assert tags["run_key"] == record.key and tags["study"] == "washout_vs_mlp" and tags["git"] == "0" * 40
    digest = record.summary["dataset_digest"]
    assert tags["dataset_digest"] == digest
    assert rows(results, "SELECT DISTINCT name, digest FROM datasets") == [("nanodrone", digest[:36])]
    folder = Path(artifacts.removeprefix("file://"))
    assert folder.is_relative_to(results / "mlartifacts")
    page = (folder / "error_per_step.html").read_text(encoding="utf-8")
    assert page.count("<figure>") == 1 and "|error| [deg/s]" in page and not re.search("https?://|<script", page)
    assert {p.name for p in (folder / "record").iterdir()} == {p.name for p in record.folder.iterdir()}


def test_mirroring_again_changes_nothing(results, records, mirrored):
    before = contents(results)
    again = track.mirror([r.folder for r in records], track.default_uri(results), "washout_vs_mlp", "washout_vs_mlp")
    assert again == mirrored
    assert contents(results) == before


def test_an_interrupted_mirroring_is_completed_without_duplicates(tmp_path, monkeypatch):
    record, uri = synthetic_record(tmp_path / "runs"), track.default_uri(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr("bench.tracking.records._dataset", lambda summary: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            track.mirror([record.folder], uri, "e")
    assert rows(tmp_path, "SELECT status FROM runs") == [("RUNNING",)]
    points = rows(tmp_path, "SELECT count(*) FROM metrics")
    # The record was made again in between: same numbers, other times.
    provenance = (record.folder / "provenance.json").read_text().replace("1700000000000", "1700000099999")
    (record.folder / "provenance.json").write_text(provenance)
    resealed(record.folder)
    track.mirror([record.folder], uri, "e")
    assert rows(tmp_path, "SELECT status FROM runs") == [("FINISHED",)]
    assert rows(tmp_path, "SELECT count(*) FROM metrics") == points


def test_study_files_replace_those_of_the_same_name(results, mirrored, tmp_path):
    uri, figure = track.default_uri(results), tmp_path / "figure.png"
    for content in (b"first", b"second"):
        figure.write_bytes(content)
        run = track.attach(uri, "washout_vs_mlp", "washout_vs_mlp", [figure])
    assert rows(results, "SELECT name FROM runs WHERE run_uuid = ?", run) == [("Report: washout_vs_mlp",)]
    assert rows(results, "SELECT count(*) FROM runs WHERE name LIKE 'Report%'") == [(1,)]
    (uri,) = rows(results, "SELECT artifact_uri FROM runs WHERE run_uuid = ?", run)[0]
    assert (Path(uri.removeprefix("file://")) / "figure.png").read_bytes() == b"second"


def test_a_dead_server_is_one_sentence_and_soon(records):
    with socket.socket() as taken:  # bound, never listening: connections are refused
        taken.bind(("127.0.0.1", 0))
        uri = f"http://127.0.0.1:{taken.getsockname()[1]}"
        began = time.monotonic()
        with pytest.raises(track.TrackingError, match=r"the records are safe, run `bench sync` later\.$") as error:
            track.mirror([records[0].folder], uri, "e")
    assert time.monotonic() - began < 60  # MLflow's own patience is minutes
    assert "\n" not in str(error.value)


def test_a_folder_as_address_and_a_damaged_database_are_sentences(tmp_path, records):
    with pytest.raises(BenchError, match="give sqlite"):
        track.prepare(str(tmp_path / "mlruns"))
    (tmp_path / "mlflow.db").write_text("this is no database, and long enough to be taken for one" * 20)
    with pytest.raises(track.TrackingError, match="bench sync"):
        track.mirror([records[0].folder], track.default_uri(tmp_path), "e")


def test_nothing_is_printed(tmp_path, capfd, caplog):
    record = synthetic_record(tmp_path / "runs")
    with caplog.at_level(logging.INFO):
        track.mirror([record.folder], track.default_uri(tmp_path), "quiet")
    assert capfd.readouterr() == ("", "")


def test_a_tracking_server_takes_the_same_records(tmp_path, records, capfd):
    uri = track.default_uri(tmp_path)
    track.prepare(uri)
    with server(uri, port=5700) as base_url:
        result = track.mirror([r.folder for r in records], base_url, "remote", "s")
        assert track.mirror([r.folder for r in records], base_url, "remote", "s") == result
        assert track.find_experiment(base_url, "remote") == track.find_experiment(base_url) == result.experiment_id
        assert chart_link(base_url, result.experiment_id).startswith(f"{base_url}/#/experiments/")
    assert rows(tmp_path, "SELECT name, status FROM runs ORDER BY start_time")[1][1] == "FAILED"
    assert (tmp_path / "mlartifacts" / result.experiment_id / result.run_ids[0]).is_dir()
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.1", int(base_url.rpartition(":")[2])), timeout=1)


def test_ui_prints_the_link_and_leaves_no_process_behind(results, mirrored):
    code = (
        "from pathlib import Path; from bench.tracking.ui import serve; "
        f"serve(Path({str(results)!r}), study='washout_vs_mlp')"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        link = process.stdout.readline().split()[1]
        assert f"/#/experiments/{mirrored.experiment_id}/runs?compareRunsMode=CHART" in link
        port = int(link.split("/#")[0].rpartition(":")[2])
        socket.create_connection(("127.0.0.1", port), timeout=1).close()
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=60) == 0
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.1", port), timeout=1)


def test_ui_says_when_nothing_is_tracked(results, mirrored):
    with pytest.raises(BenchError, match="No runs of 'other' are tracked"):
        serve(results, study="other")
