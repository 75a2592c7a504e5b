"""The HTML page of a run: it draws, rotates and needs nothing else; mistakes are one line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from browser import console_errors, network_requests, open_page, picture, wait_for
from picture_runs import write_run

from fem_snh.viewing import render

pytestmark = pytest.mark.one_debian


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_run(MPI.COMM_SELF, tmp_path_factory.mktemp("twisted"), "Q1")
    record = json.loads((folder / "run.json").read_text())
    record["versions"] = {"dolfinx": "0.5.2"}
    record["steps"][1] |= {"converged": False, "reason": "<DIVERGED>"}
    (folder / "run.json").write_text(json.dumps(record))
    return render.page(folder)


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
        choose(browser, state, 0)
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


def test_page_holds_steps_settings_and_versions(page):
    text = page.read_text(encoding="utf-8")
    for expected in ("<td>linear</td>", "material.nu", "<td>0.49</td>", "<td>0.5.2</td>"):
        assert expected.replace("<td>linear</td>", "<th>linear</th>") in text
    assert "<DIVERGED>" not in text and "&lt;DIVERGED&gt;" in text


def picked_values(browser: Any) -> dict[str, list[float]]:
    """Return the numbers of each line that the page shows for the picked point."""
    from selenium.webdriver.common.by import By

    lines = browser.find_element(By.ID, "picked").text.splitlines()
    return {
        name: [float(part) for part in values.replace(";", ",").replace("length", "").split(",")]
        for name, values in (line.split(": ") for line in lines)
    }


def choose(browser: Any, element: Any, value: object) -> None:
    browser.execute_script(
        "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('change'))",
        element, value,
    )  # fmt: skip


def test_click_shows_the_values_at_a_point(page):
    """Of the deformed body, at the point under the cursor; they follow the states and the view."""
    pyvista = pytest.importorskip("pyvista")
    with open_page(page) as browser:
        from selenium.webdriver import ActionChains
        from selenium.webdriver.common.by import By

        viewer, dot = (browser.find_element(By.ID, name) for name in ("viewer", "dot"))
        wait_for(lambda: is_drawn(picture(viewer)))
        assert not dot.is_displayed()
        aim = ActionChains(browser, duration=10).move_to_element_with_offset(viewer, 11, -17)
        aim.click().perform()
        wait_for(dot.is_displayed)
        found = picked_values(browser)
        assert list(found) == ["J (volume ratio)", "displacement", "at rest", "now"]
        *u, length = found["displacement"]
        rest, now = np.array(found["at rest"]), np.array(found["now"])
        assert now - rest == pytest.approx(u, abs=1e-4) and length == pytest.approx(
            np.hypot(*u[:2])
        )
        reader = pyvista.get_reader(page.parent / "fields.pvd")
        reader.set_active_time_value(1.0)
        mesh = reader.read().combine()
        there = pyvista.PolyData(rest[None]).sample(mesh)
        # Faces are drawn as triangles, which differ from bilinear interpolation.
        assert there["displacement"][0] == pytest.approx(u, abs=0.05)
        assert there["J"][0] == pytest.approx(found["J (volume ratio)"][0], rel=1e-4)
        box, frame = dot.rect, viewer.rect
        middle = [frame["x"] + frame["width"] / 2 + 11, frame["y"] + frame["height"] / 2 - 17]
        at = [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2]
        assert at == pytest.approx(middle, abs=3)

        choose(browser, browser.find_element(By.ID, "state"), 0)
        wait_for(lambda: picked_values(browser)["displacement"] == [0, 0, 0, 0])
        assert picked_values(browser)["at rest"] == pytest.approx(rest, abs=1e-4)
        corner = ActionChains(browser, duration=10)
        corner.move_to_element_with_offset(viewer, -200, -270).click().perform()
        wait_for(lambda: not dot.is_displayed())
        assert browser.find_element(By.ID, "picked").text.startswith("Click on the body")
        assert not console_errors(browser) and not network_requests(browser)


def test_curves_of_the_steps_are_beside_the_body(tmp_path):
    """Any column over any other; the points of stored states choose them."""
    folder = write_run(MPI.COMM_SELF, tmp_path, "Q1")
    record = json.loads((folder / "run.json").read_text())
    for number, step in enumerate(record["steps"]):
        step["reactions"] = {"top": [0.0, 0.0, float(number) - 0.5]}
        step["moments"] = {"top": [0.0, 0.0, 3.0 * number + 2]}
    record["steps"].insert(1, {"load": 0.75, "converged": True, "min_J": None} | {"newton": 5})
    record["units"] = "mm, N, MPa"
    (folder / "run.json").write_text(json.dumps(record))
    with open_page(render.page(folder)) as browser:
        from selenium.webdriver.common.by import By

        x, y, state = (browser.find_element(By.ID, name) for name in ("x", "y", "state"))

        def shown() -> list[str]:
            return [e.text for e in (y, x)], [
                option.text
                for axis in (y, x)
                for option in axis.find_elements(By.TAG_NAME, "option")
                if option.is_selected()
            ]

        names, selected = shown()
        assert selected == ["top.moment.z [N mm]", "angle"]
        assert all("newton" in name and "top.force.x [N]" in name for name in names)

        def read() -> list[str]:
            titles = browser.find_elements(By.CSS_SELECTOR, "#chart circle title")
            return [title.get_attribute("textContent") for title in titles]

        moment = "top.moment.z [N mm]"
        assert read() == [f"angle 1.5708\n{moment} 2", f"angle 3.1416\n{moment} 5"]
        option = next(o for o in y.find_elements(By.TAG_NAME, "option") if o.text == "newton")
        choose(browser, y, option.get_attribute("value"))
        assert [text.split("\n")[1] for text in read()] == ["newton 10", "newton 5", "newton 11"]
        circles = browser.find_elements(By.CSS_SELECTOR, "#chart circle")
        assert [c.get_attribute("class") for c in circles] == ["step stored", "step", "now"]
        circles[0].click()
        wait_for(lambda: state.get_property("value") == "1")
        circles = browser.find_elements(By.CSS_SELECTOR, "#chart circle")
        assert [c.get_attribute("class") for c in circles] == ["now", "step", "step stored"]
        assert browser.find_element(By.ID, "label").text.startswith("angle π/2")
        assert not console_errors(browser) and not network_requests(browser)
