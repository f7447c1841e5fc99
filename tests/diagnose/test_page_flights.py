"""Whole recordings on the page: what is drawn is what was measured, one script that the browser may run, any names."""

import base64
import dataclasses
import hashlib
import re
from html import unescape
from pathlib import Path

import numpy as np
import pytest
import samples

from bench.diagnose.by_equation import EquationResult
from bench.diagnose.evidence import AFTER, Trace
from bench.diagnose.report import page
from bench.diagnose.result import Diagnosis

SCRIPT = Path(page.__file__).with_name("flights.js").read_text(encoding="utf-8")


def figures(d: Diagnosis) -> list[str]:
    return re.findall(r"<figure class=\"wide.*?</figure>", page.render(d), re.DOTALL)


def decoded(group: str) -> tuple[np.ndarray, np.ndarray]:
    """Times and values of a trace as its reader has to find them."""
    step, low, unit = map(float, re.findall(r'data-of="([^"]*)"', group)[0].split())
    moves = np.array(re.findall(r"-?\d+", re.findall(r' d="([^"]*)"', group)[0]), dtype=float).reshape(-1, 2)
    places = np.cumsum(moves, axis=0)
    return places[:, 0] * step, low + places[:, 1] * unit


def joined(trace: Trace, name: str) -> tuple[np.ndarray, np.ndarray]:
    at, y = zip(*trace.lines[name], strict=True)
    return np.concatenate(at), np.concatenate(y)


def test_a_drawn_line_holds_the_values_at_their_times_in_the_unit_of_its_axis() -> None:
    d = samples.named()
    (first, *_) = (f for f in figures(d) if 'of-0-0"' in f)
    drawings = re.findall(r'<svg class="panel drawn".*?</svg></svg>', first, re.DOTALL)
    assert len(drawings) == 3
    for drawing, trace in zip(drawings, d.evidence.flights[0].signals[0].traces, strict=True):
        assert f">{trace.channel[-1]} [m/s], rms error 0.32 → 0.034<" in drawing
        for name in ("measured", "nominal", AFTER):
            (group,) = re.findall(rf'<g class="trace" data-name="{name}".*?</g>', drawing)
            t, y = decoded(group)
            at, values = joined(trace, name)
            assert t == pytest.approx(0.01 * at)
            assert y == pytest.approx(values, abs=2e-3)
            # without the script, the transformation alone must put a value where the axis has it
            *_, up, _, low = map(float, re.findall(r"matrix\(([^)]*)\)", group)[0].split())
            ticks = re.findall(
                r'<text class="tick" x="([\d.]+)" y="([\d.]+)" text-anchor="(\w+)">([^<]*)</text>', drawing
            )
            frame = re.findall(r'<svg x="([\d.]+)" y="([\d.]+)"', drawing)[0]
            places = [(float(v.replace("−", "-")), float(y) - 4) for _, y, anchor, v in ticks if anchor == "end"]
            slope, offset = np.polyfit(*zip(*places, strict=True), 1)
            drawn = float(frame[1]) + low + up * np.cumsum([float(p[1]) for p in pairs(group)])
            assert drawn == pytest.approx(slope * y + offset, abs=0.2)


def pairs(group: str) -> list[tuple[str, str]]:
    numbers = re.findall(r"-?\d+", re.findall(r' d="([^"]*)"', group)[0])
    return list(zip(numbers[::2], numbers[1::2], strict=True))


def test_the_only_script_that_a_browser_runs_is_our_own() -> None:
    source = page.render(samples.named())
    (script,) = re.findall(r"<script>(.*?)</script>", source, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert script == SCRIPT and f"script-src 'sha256-{digest}'\">" in source
    assert "script-src" not in page.render(samples.nothing()) or samples.nothing().evidence.flights


def test_names_that_are_markup_stay_names() -> None:
    evil = '"><img src=x onerror=alert(1)></script><style>*{display:none}'
    d = samples.named()
    flights = tuple(dataclasses.replace(f, recording=f.recording + evil) for f in d.evidence.flights)
    signals = tuple(dataclasses.replace(s, name=s.name + evil, unit="V" + evil) for s in flights[0].signals)
    flights = (dataclasses.replace(flights[0], signals=signals), *flights[1:])
    source = page.render(dataclasses.replace(d, evidence=dataclasses.replace(d.evidence, flights=flights)))
    assert "<img src=x" not in source and evil not in source
    assert source.count("<script>") == source.count("</script>") == 1 and source.count("<style>") == 2
    assert evil in unescape(source)


def test_every_recording_and_signal_can_be_chosen_without_the_script() -> None:
    d = samples.named()
    source = page.render(d)
    assert "(fitted)" not in source
    for i, j in ((i, j) for i in range(2) for j in range(3)):
        rule = f".recorded:has(#recording-{i}:checked):has(#signal-{j}:checked) .of-{i}-{j}{{display:block}}"
        assert rule in source and f'class="wide of-{i}-{j}"' in source
    assert re.findall(r'id="(recording-\d|signal-\d)" checked', source) == ["recording-0", "signal-1"]
    assert all(f'for="{i}"' in source or f'id="{i}"' in source for i in ("recording-1", "signal-2"))


def test_a_flight_from_above_is_coloured_by_its_error() -> None:
    (plan,) = (f for f in figures(samples.named()) if 'of-0-2"' in f)
    before, after = re.findall(r'<svg class="panel drawn".*?</svg></svg>', plan, re.DOTALL)
    strokes = [set(re.findall(r"var\(--heat-(\d)\)", drawing)) for drawing in (before, after)]
    assert strokes == [{"1", "2", "3", "4"}, {"0"}]  # 0.1 to 0.6 m/s; all below 0.06
    assert "x [m]" in before and "y [m]" in before and "above 0.46 m/s" in plan
    # a metre is as long in x as in y: the ellipse of 3 by 2 m
    x, y = np.array(re.findall(r"[ML]([\d.]+) ([\d.]+)", before), dtype=float).T
    assert np.ptp(x) / np.ptp(y) == pytest.approx(1.5, rel=0.02)


def test_an_accelerometer_has_its_errors_axis_by_axis() -> None:
    d = samples.named()
    by = {**d.by_equation, "accelerations": EquationResult("specific_force", 0.5, "m/s^2", 0.7, 0.69, 0.1, 0.1, 0.01)}
    source = page.render(dataclasses.replace(d, by_equation=by))
    forces, accelerations, torques = (source.index(f"<h3>{s}") for s in ("Forces", "Accelerations", "Torques"))
    shown = source[accelerations:torques]
    assert "before [m/s²]" in shown and shown.count(">0.700<") >= 3 and shown.count(">0.100<") >= 3
    assert forces < accelerations and source.count("Axis by axis") == 1
