"""`prtcl view` in a headless browser: the page loads, a slider moves, the picture changes, nothing is an error.

Needs viser, Playwright and a Chromium (`$PRTCL_CHROMIUM`, or the first in PATH). `.ci/run` demands them with
PRTCL_REQUIRE_BROWSER=1. What needs no browser is in test_view.py.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from cases import write_skies

from prtcl.apps.view.table_picture import WIDTH
from prtcl.compute.choice import Seen
from prtcl.files.image import read_image

FOREIGN = "elsewhere.example"
RESOLVER = f"--host-resolver-rules=MAP {FOREIGN} 127.0.0.1"
PATIENCE = 60_000
"""Milliseconds that the page may take for anything: two busy cores, WebGL in software."""


def missing(what: str) -> None:
    if os.environ.get("PRTCL_REQUIRE_BROWSER", "0") not in ("", "0"):
        pytest.fail(f"{what}, and PRTCL_REQUIRE_BROWSER demands it", pytrace=False)
    pytest.skip(what)


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    try:
        import viser  # noqa: F401
        from playwright.sync_api import sync_playwright
    except ImportError as error:
        missing(f"{error.name} is not installed")
    path = os.environ.get("PRTCL_CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
    if not path:
        missing("there is no chromium in PATH")
    with sync_playwright() as playwright:
        # --no-sandbox: containers run as root.
        browser = playwright.chromium.launch(
            executable_path=path,
            args=[
                "--no-sandbox",
                "--enable-unsafe-swiftshader",
                f"--host-resolver-rules=MAP {FOREIGN} 127.0.0.1",
            ],
        )
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory, opencl_device: Seen) -> Iterator[tuple[str, Path]]:
    """Address and output folder of a running `prtcl view`: a ball on a table, two skies."""
    folder = tmp_path_factory.mktemp("view")
    ball = trimesh.creation.icosphere(subdivisions=4)
    table = trimesh.creation.box((4, 0.2, 4)).subdivide().subdivide().subdivide()
    table.apply_translation((0, -1.1, 0))
    trimesh.util.concatenate([ball, table]).export(folder / "ball.ply")
    (folder / "skies").mkdir()
    write_skies(folder / "skies", 32)
    command = [
        sys.executable, "-m", "prtcl", "view", str(folder / "ball.ply"), "--env", str(folder / "skies"),
        "-o", str(folder / "out"), "--port", "0", "--levels", "4", "--rays", "3", "--device", opencl_device.spec,
    ]  # fmt: skip
    with (folder / "stderr").open("w") as stderr:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr, text=True)
        assert process.stdout is not None
        line = process.stdout.readline()
        try:
            assert line.startswith("http://127.0.0.1:"), (folder / "stderr").read_text()
            yield line.split()[0], folder / "out"
            process.send_signal(signal.SIGINT)
            status = process.wait(30)
        finally:
            process.kill()
            process.stdout.close()
            process.wait()
    assert status == 0
    said = (folder / "stderr").read_text()
    assert "Traceback" not in said, said
    assert said.rstrip().endswith("prtcl view: ended"), said


class Tab:
    """A browser tab on the viewer, and what it logged."""

    def __init__(self, chromium: Any, url: str) -> None:
        self.context = chromium.new_context(viewport={"width": 900, "height": 650})
        self.page = self.context.new_page()
        self.wrong: list[str] = []
        self.page.on("console", lambda m: self.wrong.append(m.text) if m.type == "error" else None)
        self.page.on("pageerror", lambda error: self.wrong.append(str(error)))
        # viser draws on fewer pixels where frames come slowly, as they do without a GPU: pictures are then scaled down
        # and up again, at times of its choosing.
        self.page.goto(f"{url}/?fixedDpr=1")
        self.rest()

    def rest(self) -> None:
        """Wait until the picture is refined and stays so."""
        for _ in range(100):
            self.page.wait_for_selector("text=/\\d ms refined/", timeout=PATIENCE)
            before = self.page.inner_text("body")
            self.page.wait_for_timeout(1200)
            if self.page.inner_text("body") == before and " ms refined" in before:
                return
        pytest.fail("the picture never rests")

    def until(self, met: Callable[[], bool]) -> bool:
        """Whether something comes true: a busy machine's browser may draw what it was sent a little later."""
        for _ in range(40):
            if met():
                return True
            self.page.wait_for_timeout(500)
        return False

    def picture(self) -> Any:
        """Pixels of the canvas, once two looks at it are the same: what was sent may be drawn a little later."""
        canvas = self.page.locator("canvas").first
        shown = self.pixels(canvas)
        for _ in range(10):
            self.page.wait_for_timeout(400)
            before, shown = shown, self.pixels(canvas)
            if (shown == before).all():
                break
        return shown

    def pixels(self, shown: Any) -> Any:
        """Of an element of the page."""
        png = shown.screenshot()
        from PIL import Image

        return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(float)

    def slider(self, label: str) -> Any:
        """The thumb of the slider beside a label."""
        return self.page.locator(f"xpath=//label[text()='{label}']/following::*[@role='slider'][1]")

    def drag(self, label: str, pixels: int) -> None:
        """Move a slider's thumb by the mouse: viser takes arrow keys for the camera's, too."""
        thumb = self.slider(label)
        thumb.scroll_into_view_if_needed()
        box = thumb.bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        self.page.mouse.move(x, y)
        self.page.mouse.down()
        self.page.mouse.move(x + pixels, y, steps=5)
        self.page.mouse.up()

    def pick(self, label: str, option: str) -> None:
        """Choose from a dropdown."""
        self.page.locator(f"xpath=//label[text()='{label}']/following::input[1]").click()
        self.page.get_by_role("option", name=option, exact=True).click()

    def close(self) -> None:
        self.context.close()


def changed(a: Any, b: Any) -> float:
    """Mean difference of two pictures, of 255."""
    return float(np.abs(a - b).mean())


@pytest.fixture
def tab(chromium: Any, served: tuple[str, Path]) -> Iterator[Tab]:
    opened = Tab(chromium, served[0])
    yield opened
    opened.close()
    assert opened.wrong == []


def test_controls_change_the_picture(tab: Tab) -> None:
    first = tab.picture()
    assert first.std() > 10, "there is something to see"
    assert changed(tab.picture(), first) < 0.01, "it stands still"
    tab.pick("Preset", "polished gold")
    tab.rest()
    assert tab.until(lambda: changed(tab.picture(), first) > 1.0)
    gold = tab.picture()
    thumb = tab.slider("Roughness")
    was = float(thumb.get_attribute("aria-valuenow"))
    tab.drag("Roughness", 60)
    tab.rest()
    assert float(thumb.get_attribute("aria-valuenow")) > was + 0.1
    assert tab.until(lambda: changed(tab.picture(), gold) > 0.5)
    for name, pixels in (("Rotation", 60), ("Exposure", 10)):
        before = tab.picture()
        tab.drag(name, pixels)
        tab.rest()
        assert tab.until(lambda before=before: changed(tab.picture(), before) > 0.5), name
    before = tab.picture()
    tab.pick("Environment", "noon")
    tab.rest()
    assert tab.until(lambda: changed(tab.picture(), before) > 0.5)


def test_undo_gives_the_picture_back(tab: Tab) -> None:
    first = tab.picture()
    tab.pick("Preset", "copper")
    tab.rest()
    assert tab.until(lambda: changed(tab.picture(), first) > 1.0)
    tab.page.get_by_role("button", name="Undo").click()
    tab.rest()
    assert tab.until(lambda: changed(tab.picture(), first) < 0.01)


def test_a_material_is_edited_as_a_table(tab: Tab) -> None:
    """Into a table with no change to see, a slider that changes picture and plot, undo; then too bright, and a mix."""

    def plot() -> Any:
        shown = [one for one in tab.page.locator("img").all() if one.evaluate("x => x.naturalWidth") == WIDTH]
        assert len(shown) == 1
        return tab.pixels(shown[0])

    tab.pick("Preset", "red plastic")
    tab.rest()
    plastic = tab.picture()
    tab.pick("Kind", "table")
    tab.page.wait_for_selector("text=Sharpness", timeout=PATIENCE)
    tab.rest()
    table, first = tab.picture(), plot()
    assert changed(table, plastic) < 1.0, "the table is the material"
    assert tab.until(lambda: "Reflects 71 %" in tab.page.inner_text("body"))
    tab.drag("Sharpness", 40)
    tab.rest()
    assert tab.until(lambda: changed(tab.picture(), table) > 0.2)
    assert tab.until(lambda: changed(plot(), first) > 0.5)
    for _ in range(10):  # a busy machine may take one drag for several
        tab.page.get_by_role("button", name="Undo").click()
        tab.rest()
        if tab.slider("Sharpness").get_attribute("aria-valuenow") == "0":
            break
    assert tab.until(lambda: changed(tab.picture(), table) < 0.01)
    assert tab.until(lambda: changed(plot(), first) < 0.01)
    tab.drag("Brightness", 50)
    tab.page.wait_for_selector("text=/Too bright/", timeout=PATIENCE)
    tab.rest()
    before = tab.picture()
    tab.pick("Mix with", "gold")
    tab.rest()
    assert tab.until(lambda: changed(tab.picture(), before) > 0.5)


def test_the_camera_orbits(tab: Tab) -> None:
    first = tab.picture()
    tab.page.mouse.move(250, 300)
    tab.page.mouse.down()
    tab.page.mouse.move(400, 340, steps=5)
    tab.page.mouse.up()
    tab.rest()
    assert tab.until(lambda: changed(tab.picture(), first) > 1.0)
    # Over the top and over the bottom, where the eye stands on the axis it orbits.
    for far in (620, 10):
        before = tab.picture()
        tab.page.mouse.move(250, 300)
        tab.page.mouse.down()
        tab.page.mouse.move(250, far, steps=8)
        tab.page.mouse.up()
        tab.rest()
        assert tab.until(lambda before=before: changed(tab.picture(), before) > 1.0)
        assert "choose another" not in tab.page.inner_text("body")


def test_browsers_do_not_disturb_one_another(tab: Tab, chromium: Any, served: tuple[str, Path]) -> None:
    first = tab.picture()
    other = Tab(chromium, served[0])
    try:
        other.pick("Preset", "red plastic")
        other.pick("Environment", "noon")
        other.rest()
        assert tab.until(lambda first=first: changed(tab.picture(), first) < 0.01)
        assert changed(other.picture(), first) > 1.0
    finally:
        other.close()
    assert other.wrong == []


def test_saving(tab: Tab, served: tuple[str, Path]) -> None:
    tab.pick("Preset", "gold")
    tab.rest()
    tab.page.get_by_role("button", name="Material").last.click()
    tab.page.get_by_role("button", name="Image").click()
    tab.page.wait_for_selector("text=view-001.exr", timeout=PATIENCE)
    image = read_image(served[1] / "view-001.exr")
    assert np.isfinite(image).all()
    assert image[..., :3].max() > 0
    saved = json.loads((served[1] / "material-001.json").read_text())
    assert saved["materials"][0]["brdf"].startswith("ggx:alpha=0.2,")
    assert sorted(p.name for p in served[1].iterdir()) == [
        "material-001.json",
        "view-001.exr",
        "view-001.png",
    ]


def test_a_foreign_name_for_this_machine_gets_no_page(chromium: Any, served: tuple[str, Path]) -> None:
    """What another site could do, were its name to resolve to this machine: it is shown no control and no picture."""
    context = chromium.new_context()
    page = context.new_page()
    page.goto(served[0].replace("127.0.0.1", FOREIGN))
    page.wait_for_selector("text=prtcl", timeout=PATIENCE)
    page.wait_for_timeout(4000)
    assert "Preset" not in page.inner_text("body")
    page.goto(served[0])
    page.wait_for_selector("text=Preset", timeout=PATIENCE)
    context.close()
