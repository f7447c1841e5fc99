"""The chart page of MLflow as a newcomer sees it, read from the page itself."""

import os
import re
from itertools import product

import pytest
from synthetic_records import synthetic_record

from bench.tracking import track
from bench.tracking.ui import chart_link, server

SPECS = {
    "LSTM: 1x50 - MLP: 60x10": 0.5,
    "LSTM: 1x50 - Washout: 10": 0.8,
    "MLFC: 2x40 - MLP: 60x10": 0.6,
    "MLFC: 2x40 - Washout: 10": 0.9,
}
SEEDS = (0, 1, 2)
pytestmark = pytest.mark.ui


def card(browser, title: str):
    """The chart card of that title, drawn; None while it is not there."""
    from selenium.webdriver.common.by import By

    for found in browser.find_elements(By.CSS_SELECTOR, '[data-testid="experiment-view-compare-runs-card"]'):
        if title in (found.get_attribute("textContent") or ""):
            return found
    return None


def test_chart_page_draws_the_error_per_step_of_all_runs_together(tmp_path, browser):
    from selenium.webdriver.common.by import By
    from selenium.webdriver.support.ui import WebDriverWait

    # Twelve runs: without the stored view MLflow would draw ten.
    runs = product(SPECS.items(), ("body_rates.p", "body_rates.q"), SEEDS)
    folders = [
        synthetic_record(tmp_path / "runs", spec, output, seed, growth * (1 + 0.07 * seed)).folder
        for (spec, growth), output, seed in runs
    ]
    uri = track.default_uri(tmp_path)
    experiment_id = track.mirror(folders, uri, "washout_vs_mlp", "washout_vs_mlp").experiment_id
    with server(uri, port=5800) as base_url:
        browser.get(chart_link(base_url, experiment_id))
        wait = WebDriverWait(browser, 40)

        def curves(title: str) -> int:
            found = card(browser, title)
            lines = found.find_elements(By.CSS_SELECTOR, ".scatterlayer .js-line") if found else []
            return len({d for line in lines if "L" in (d := line.get_attribute("d") or "")})

        try:
            for output in ("p", "q"):
                wait.until(lambda _, o=output: curves(f"error_mean/body_rates.{o} T40 deg per s") == 12)
        finally:
            if path := os.environ.get("BENCH_SCREENSHOT"):
                browser.save_screenshot(path)
        page = browser.find_element(By.TAG_NAME, "body").text
        drawn = card(browser, "error_mean/body_rates.p T40 deg per s")
        for spec, seed in product(SPECS, SEEDS):
            name = f"{spec} | body_rates.p | T=40 | seed {seed}"
            assert name in page.splitlines()  # the list of runs
            assert name in drawn.text  # the legend
        sections = re.findall(r"^(error_mean|error_median|error_q95|learning|Model metrics)\b", page, re.M)
        assert sections[0] == "error_mean"
        ticks = [float(t.text) for t in drawn.find_elements(By.CSS_SELECTOR, ".xtick text")]
        assert max(ticks) == 40 and "Step" in drawn.text  # the axis is the prediction step
