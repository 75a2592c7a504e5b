"""Debian's chromium without a window, driven by selenium: what a page logs, loads and shows."""

from __future__ import annotations

import io
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import numpy as np
import pytest
from PIL import Image

CHROMIUM, DRIVER = "/usr/bin/chromium", "/usr/bin/chromedriver"
#: WebGL is computed by the processor.
_ARGUMENTS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--window-size=1000,900",
)


@contextmanager
def open_page(path: Path) -> Iterator[Any]:
    """Open a file in the browser, which logs its console and its requests.

    The test is skipped where chromium is not installed, unless the environment has CI, which
    installs it.
    """
    if not (shutil.which(CHROMIUM) and shutil.which(DRIVER)) and "CI" not in os.environ:
        pytest.skip("needs a browser: apt install chromium chromium-driver")

    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for argument in _ARGUMENTS:
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    browser = webdriver.Chrome(options, webdriver.ChromeService(DRIVER))
    try:
        browser.get(path.resolve().as_uri())
        yield browser
    finally:
        browser.quit()


def console_errors(browser: Any) -> list[str]:
    """Return the warnings and errors of the console."""
    return [e["message"] for e in browser.get_log("browser") if e["level"] in ("WARNING", "SEVERE")]


def network_requests(browser: Any) -> list[str]:
    """Return the addresses that were asked for and are not in the page itself."""
    events = (json.loads(entry["message"])["message"] for entry in browser.get_log("performance"))
    addresses = [
        event["params"]["request"]["url"]
        for event in events
        if event["method"] == "Network.requestWillBeSent"
    ]
    inside = ("file:", "data:", "blob:", "about:")
    return [address for address in addresses if not address.startswith(inside)]


def picture(element: Any) -> np.ndarray:
    """Return a screenshot of an element, (height, width, 3) uint8."""
    return np.asarray(Image.open(io.BytesIO(element.screenshot_as_png)).convert("RGB"))


def wait_for(condition: Any, seconds: float = 60.0) -> None:
    """Wait until a condition is true; fail after some time."""
    end = monotonic() + seconds
    while not condition():
        assert monotonic() < end, f"not within {seconds:g} s"
        sleep(0.2)
