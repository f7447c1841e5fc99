"""Pages in a real browser: script in every name is shown and not run."""

from pathlib import Path
from typing import Any

import pytest
import test_study_page
from diagnose import samples
from fuzz.test_names import fleet

from bench.diagnose.report import page
from bench.diagnose.result import VERDICTS
from bench.fleet import page as fleet_page

EVIL = "\"'><script>window.ran = 1</script><img src=x onerror='window.ran = 1'><svg onload='window.ran = 1'></svg>"

pytestmark = pytest.mark.ui


def shown(browser: Any, file: Path, source: str) -> tuple[bool, int, str]:
    """Whether a name on the page was run as script, how many elements names made, and all that the page says."""
    file.write_text(source, encoding="utf-8")
    browser.get(file.as_uri())
    return (
        browser.execute_async_script("setTimeout(arguments[0], 200, Boolean(window.ran))"),
        browser.execute_script("return document.querySelectorAll('[onerror], [onload]').length"),
        browser.execute_script("return document.documentElement.textContent"),
    )


def test_script_in_every_name(tmp_path: Path, browser: Any) -> None:
    """Of diagnoses of every verdict, of a fleet and of a study; a page that writes it as it is would run it."""
    assert shown(browser, tmp_path / "open.html", f"<title>x</title><p title='{EVIL}'>x</p>")[:2] == (True, 2)
    pages = {verdict: page.render(samples.hostile(samples.ALL[verdict](), EVIL)) for verdict in VERDICTS}
    pages["fleet"] = fleet_page.render(fleet(EVIL), EVIL)
    pages["study"], _ = test_study_page.hostile(tmp_path, EVIL)
    for name, source in pages.items():
        ran, elements, text = shown(browser, tmp_path / f"{name}.html", source)
        assert (ran, elements) == (False, 0), name
        assert "<script>window.ran = 1</script>" in text, name
