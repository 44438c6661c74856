"""The page in a real browser: Chromium without a window, where there is one.

Pictures are compared as pixels: what is not drawn cannot be tested by looking at the code.
"""

from __future__ import annotations

import io
import math
import os
import re
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from report_tools import Registered

import tmchho
from tmchho.report.browser import find_browser

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pil = pytest.importorskip("PIL.Image")

Pixels = NDArray[np.int16]
_TWO_FRAMES = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    path = find_browser()
    if path is None:
        pytest.skip("neither Chromium, Chrome nor Edge is installed")
    # Drawn by the processor, because most machines that run tests have nothing else.
    arguments = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        arguments.append("--no-sandbox")
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=path, headless=True, args=arguments)
        yield opened
        opened.close()


Open = Callable[..., Any]


@pytest.fixture
def opened(browser: Any, registered: Registered) -> Iterator[Open]:
    """Open a page; at the end nothing was asked of any network, and nothing complained."""
    complaints: list[str] = []
    contexts = []

    def open_page(path: Path | None = None, before: str | None = None, **settings: Any) -> Any:
        path = path or registered.folder / "report.html"
        context = browser.new_context(**{"viewport": {"width": 1000, "height": 800}, **settings})
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))

        def asked(request: Any) -> None:
            if request.url != path.as_uri():
                complaints.append(request.url)

        page.on("request", asked)
        if before is not None:
            page.add_init_script(before)
        page.goto(path.as_uri(), wait_until="load", timeout=120_000)
        page.evaluate(_TWO_FRAMES)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert complaints == []


def pixels(page: Any) -> Pixels:
    page.evaluate(_TWO_FRAMES)
    # From within the page: a picture of the element would have the legend in it.
    page.evaluate("() => { const v = document.querySelector('.viewer').viewer; v.draw(); }")
    png = page.locator("canvas").screenshot()
    return np.asarray(pil.open(io.BytesIO(png)).convert("RGB"), dtype=np.int16)


def share_changed(before: Pixels, after: Pixels) -> float:
    return float((np.abs(before - after).max(axis=2) > 12).mean())


def test_the_view_is_not_blank_and_the_fallback_stays_hidden(opened: Open) -> None:
    page = opened()
    picture = pixels(page)
    ground = picture[2, 2]
    drawn = (np.abs(picture - ground).max(axis=2) > 40).mean()
    assert 0.05 < drawn < 0.95
    assert not page.locator(".fallback").is_visible()
    assert page.evaluate("performance.getEntriesByName('tmchho-first-draw').length") == 1


def test_every_layer_and_every_colour_shows(opened: Open) -> None:
    page = opened()
    everything = pixels(page)
    for number in range(2):
        box = page.locator(f'input[data-layer="{number}"]')
        box.uncheck()
        assert share_changed(everything, pixels(page)) > 0.01
        box.check()
    modes = page.eval_on_selector_all("input[data-mode]", "boxes => boxes.map(box => box.dataset.mode)")
    assert len(modes) == 5
    seen = {}
    for mode in modes:
        page.locator(f'input[data-mode="{mode}"]').check()
        seen[mode] = pixels(page)
        assert page.locator(f'[data-legend-of="{mode}"]').is_visible()
    for first in modes:
        for second in modes:
            assert first == second or share_changed(seen[first], seen[second]) > 0.01, (first, second)


def test_the_end_of_the_ramp_can_be_moved(opened: Open) -> None:
    page = opened()
    page.locator('input[data-mode="field0"]').check()
    before = pixels(page)
    page.locator("[data-upper]").fill("0.01")
    page.locator("[data-upper]").press("Enter")
    assert share_changed(before, pixels(page)) > 0.01
    assert "0.01" in page.locator('[data-legend-of="field0"] [data-high]').inner_text()


def test_the_source_goes_back_to_where_it_was(opened: Open) -> None:
    page = opened(reduced_motion="reduce")
    before = pixels(page)
    page.locator("input[data-before]").check()
    assert share_changed(before, pixels(page)) > 0.01
    page.locator("input[data-before]").uncheck()
    assert share_changed(before, pixels(page)) < 0.001


def test_mouse_wheel_and_keys_turn_move_and_zoom(opened: Open) -> None:
    page = opened()
    canvas = page.locator("canvas")
    canvas.scroll_into_view_if_needed()
    camera = "() => ({...document.querySelector('.viewer').viewer.camera})"
    box = canvas.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    start = page.evaluate(camera)
    page.mouse.move(x, y)
    page.mouse.wheel(0, 300)  # nobody has clicked the view yet: the page scrolls
    page.wait_for_timeout(200)
    assert page.evaluate(camera)["away"] == start["away"]
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 80, y + 30, steps=4)
    page.mouse.up()
    turned = page.evaluate(camera)
    assert turned["turn"] == pytest.approx(start["turn"] - 80 * 0.006)
    page.mouse.wheel(0, 100)
    page.wait_for_timeout(300)
    assert page.evaluate(camera)["away"] > turned["away"]
    canvas.press("ArrowLeft")
    assert page.evaluate(camera)["turn"] != turned["turn"]
    canvas.press("Shift+ArrowUp")
    assert page.evaluate(camera)["at"] != turned["at"]
    canvas.press("t")
    assert page.evaluate(camera)["tilt"] == pytest.approx(math.pi / 2)


def test_two_picked_points_are_those_of_the_file_and_so_is_their_distance(
    opened: Open, registered: Registered
) -> None:
    page = opened()
    canvas = page.locator("canvas")
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    status = page.locator("[data-status]")
    for share in (0.5, 0.6):
        page.mouse.click(box["x"] + share * box["width"], box["y"] + share * box["height"])
        page.wait_for_timeout(350)  # or the two would be a double click
    lines = status.inner_text().splitlines()
    assert len(lines) == 3
    places = [np.array(re.findall(r"[xyz] (-?[\d.]+)", line), dtype=float) for line in lines[:2]]
    said = float(re.findall(r"Distance ([\d.]+)", lines[2])[0])
    assert said == pytest.approx(np.linalg.norm(places[1] - places[0]), abs=0.01)
    assert said > 1
    fused = tmchho.read(registered.folder / "fused.laz").xyz
    for place in places:
        assert np.linalg.norm(fused - place, axis=1).min() < 0.02
    page.locator("[data-clear]").click()
    assert status.inner_text() == ""
    canvas.press("Enter")  # by keys alone: the point in the middle
    assert "A:" in status.inner_text()


def test_light_and_dark_follow_the_system_and_the_reader(opened: Open) -> None:
    ground = "() => getComputedStyle(document.body).backgroundColor"
    brightness = {}
    for scheme in ("light", "dark"):
        page = opened(color_scheme=scheme)
        brightness[scheme] = sum(map(int, re.findall(r"\d+", page.evaluate(ground))[:3]))
        assert abs(int(pixels(page)[2, 2].sum()) - brightness[scheme]) < 90
    assert brightness["dark"] < 150 < 600 < brightness["light"]
    page = opened(color_scheme="light")
    page.locator("[data-theme-choice]").select_option("dark")
    assert sum(map(int, re.findall(r"\d+", page.evaluate(ground))[:3])) == brightness["dark"]


@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_hangs_out_of_the_page(opened: Open, width: int) -> None:
    page = opened(viewport={"width": width, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.locator("canvas").bounding_box()["width"] > 0.8 * min(width, 900)


def test_without_webgl_the_page_says_so(opened: Open) -> None:
    page = opened(before="HTMLCanvasElement.prototype.getContext = () => null;")
    assert page.locator(".fallback").is_visible()
    assert not page.locator("canvas").is_visible()
    assert not page.locator(".controls").is_visible()


def test_the_keys_reach_all_controls_in_the_order_of_the_page(opened: Open) -> None:
    page = opened()
    tops = []
    for _ in range(30):
        page.keyboard.press("Tab")
        top = page.evaluate(
            "() => document.activeElement.getBoundingClientRect().top + scrollY + "
            "(document.activeElement.matches('.skip') ? -1e6 : 0)"
        )
        tops.append(top)
    assert all(after >= before - 60 for before, after in pairwise(tops)), tops


def test_on_paper_the_verdict_is_on_page_one(registered: Registered, tmp_path: Path, browser: Any) -> None:
    reader = pytest.importorskip("pypdf")
    page = browser.new_page()
    page.goto((registered.folder / "report.html").as_uri())
    page.pdf(path=tmp_path / "report.pdf", prefer_css_page_size=True)
    page.close()
    pages = reader.PdfReader(tmp_path / "report.pdf").pages
    assert 4 <= len(pages) <= 16
    first = pages[0].extract_text()
    assert "ACCEPTED" in first.upper()
    assert "What the verdict rests on" in first
    everything = "".join(sheet.extract_text() for sheet in pages)
    assert "Full screen" not in everything  # the 3D view is not for paper
    assert "voxel.voxel_size_m" in everything  # what is folded up on the screen is printed


def test_the_command_prints_the_same(registered: Registered, tmp_path: Path, browser: Any) -> None:
    reader = pytest.importorskip("pypdf")
    for name in ("result.json", "report_points.npz"):
        (tmp_path / name).write_bytes((registered.folder / name).read_bytes())
    files = tmchho.write_report(tmp_path, pdf=True)
    assert tmp_path / "report.pdf" in files
    assert "ACCEPTED" in reader.PdfReader(tmp_path / "report.pdf").pages[0].extract_text().upper()


def test_the_view_of_clouds_works_alike(opened: Open, registered: Registered, tmp_path: Path) -> None:
    path = tmchho.write_view([registered.folder / "fused.laz", registered.target], tmp_path / "view.html")
    page = opened(path)
    both = pixels(page)
    page.locator('input[data-layer="0"]').uncheck()
    assert share_changed(both, pixels(page)) > 0.01
    modes = page.eval_on_selector_all("input[data-mode]", "boxes => boxes.map(box => box.dataset.mode)")
    assert {"colour", "clouds", "height", "field0"} <= set(modes)
