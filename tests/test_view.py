"""The HTML page of a run: it draws, rotates and needs nothing else; mistakes are one line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from browser import console_errors, network_requests, open_page, picture, wait_for
from picture_runs import bad, write_run

from fem_snh.viewing import view


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_run(MPI.COMM_SELF, tmp_path_factory.mktemp("twisted"), "Q1")
    record = json.loads((folder / "run.json").read_text())
    record["versions"] = {"dolfinx": "0.5.2"}
    record["steps"][1] |= {"converged": False, "reason": "<DIVERGED>"}
    (folder / "run.json").write_text(json.dumps(record))
    return view.main(folder)


def is_drawn(image: np.ndarray) -> bool:
    """Whether more than a tenth of a picture is not white."""
    return bool(np.mean(image.min(axis=2) < 250) > 0.1)


def camera_position(browser: Any) -> np.ndarray:
    """Return where the viewer's camera is."""
    return np.array(browser.execute_script("return camera().position"))


def test_page_draws_and_rotates_without_errors_and_network(page):
    with open_page(page) as browser:
        from selenium.webdriver import ActionChains
        from selenium.webdriver.common.by import By

        viewer = browser.find_element(By.ID, "viewer")
        wait_for(lambda: is_drawn(picture(viewer)))
        before, position = picture(viewer), camera_position(browser)

        def drag() -> bool:
            """Drag over the body; vtk.js rotates if moves follow each other within 0.2 s."""
            mouse = ActionChains(browser, duration=10)
            mouse.move_to_element(viewer).click_and_hold()
            for _ in range(8):
                mouse.move_by_offset(15, 5)
            mouse.release().perform()
            return bool((picture(viewer) != before).mean() > 0.05)

        wait_for(drag)
        turned = camera_position(browser)
        assert is_drawn(picture(viewer))
        assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(position), rel=0.2)
        assert np.abs(turned - position).max() > 0.1

        state = browser.find_element(By.ID, "state")
        assert (state.get_attribute("max"), state.get_attribute("value")) == ("2", "2")
        before = picture(viewer)
        browser.execute_script(
            "arguments[0].value = 0; arguments[0].dispatchEvent(new Event('change'))", state
        )
        wait_for(lambda: is_drawn(picture(viewer)) and (picture(viewer) != before).mean() > 0.05)
        wait_for(lambda: np.allclose(camera_position(browser), turned))
        assert browser.find_element(By.ID, "label").text.startswith("angle 0")
        play = browser.find_element(By.ID, "play")
        play.click()
        assert play.text == "Pause"
        wait_for(lambda: play.text == "Play")
        assert state.get_property("value") == "2"
        wait_for(lambda: np.allclose(camera_position(browser), turned))
        rows = browser.find_elements(By.CSS_SELECTOR, "tbody tr.failed")
        assert ["<DIVERGED>" in row.text for row in rows] == [True]
        assert not console_errors(browser) and not network_requests(browser)


def test_page_holds_curves_steps_settings_and_versions(page):
    text = page.read_text(encoding="utf-8")
    assert text.count("<svg") == 1 and "<?xml" not in text
    for expected in ("<td>linear</td>", "material.nu", "<td>0.49</td>", "<td>0.5.2</td>"):
        assert expected.replace("<td>linear</td>", "<th>linear</th>") in text
    assert "<DIVERGED>" not in text and "&lt;DIVERGED&gt;" in text


def test_states_are_chosen_evenly():
    loads = [k / 100 for k in range(101)]
    chosen = view.choose_states(loads)
    assert len(chosen) == view.MAX_STATES and (chosen[0], chosen[-1]) == (0.0, 1.0)
    assert np.ptp(np.diff(chosen)) <= 0.011
    assert view.choose_states(loads[:5]) == loads[:5]


def test_mistakes_are_one_line(page, tmp_path):
    folder = page.parent
    assert "expected a file .html" in bad(view.main, folder, tmp_path / "a.png")
    assert "field = 'mises'" in bad(view.main, folder, None, "mises")
    assert "run.json" in bad(view.main, tmp_path)
    (tmp_path / "file").write_text("")
    assert "cannot write" in bad(view.main, folder, tmp_path / "file" / "a.html")
