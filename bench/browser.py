"""What a browser gets of `prtcl view`, end to end: pictures a second and the delay of each, in headless Chromium.

    python bench/browser.py [--mesh stanford_bunny] [--environment modern_buildings_2] [-o bench/results/browser.json]

A picture counts when its message has arrived in the page; what Chromium needs to show it is not in these figures (here
it draws WebGL in software, on the same cores, which slows all the rest). Orbit: the mouse drags for four seconds.
Slider: roughness moves by a key, a step every 50 ms. Delay: one step from rest, to the first picture and to the refined
one, median of seven.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

import scenes

PICTURE = 2000
"""Bytes of a message that is a picture; those of the panel are smaller."""


class Tab:
    """The page, and when pictures arrived."""

    def __init__(self, browser: Any, url: str) -> None:
        self.pictures: list[tuple[float, int]] = []
        self.page = browser.new_context(viewport={"width": 1280, "height": 800}).new_page()
        self.page.on("websocket", lambda socket: socket.on("framereceived", self._came))
        self.page.goto(url)
        self.page.wait_for_selector("text=/ms refined/", timeout=300_000)
        self.rest()

    def _came(self, payload: Any) -> None:
        if len(payload) > PICTURE:
            self.pictures.append((time.perf_counter(), len(payload)))

    def rest(self) -> None:
        """Until nothing has come for two seconds."""
        while True:
            count = len(self.pictures)
            self.page.wait_for_timeout(2000)
            if len(self.pictures) == count:
                return

    def during(self, act: Any) -> dict[str, float]:
        """Pictures a second while something is done, and kilobytes a picture."""
        self.rest()
        self.pictures.clear()
        start = time.perf_counter()
        act()
        seconds = time.perf_counter() - start
        got = [size for at, size in self.pictures if at <= start + seconds]
        return {
            "pictures_per_second": len(got) / seconds,
            "kilobytes": sum(got) / max(1, len(got)) / 1e3,
            "seconds": seconds,
        }

    def orbit(self) -> None:
        self.page.mouse.move(400, 400)
        self.page.mouse.down()
        end = time.perf_counter() + 4.0
        step = 0
        while time.perf_counter() < end:
            step += 1
            self.page.mouse.move(400 + 3 * (step % 60), 400 + step % 30)
            self.page.wait_for_timeout(10)
        self.page.mouse.up()

    def focus(self, label: str) -> None:
        self.page.locator(f"xpath=//label[text()='{label}']/following::*[@role='slider'][1]").focus()

    def slide(self) -> None:
        end = time.perf_counter() + 4.0
        while time.perf_counter() < end:
            self.page.keyboard.press("ArrowRight")
            self.page.wait_for_timeout(50)

    def delays(self) -> dict[str, float]:
        first, last = [], []
        for n in range(7):
            self.rest()
            self.pictures.clear()
            start = time.perf_counter()
            self.page.keyboard.press("ArrowLeft" if n % 2 else "ArrowRight")
            self.page.wait_for_timeout(2500)
            first.append(self.pictures[0][0] - start)
            last.append(self.pictures[-1][0] - start)
        return {"first_picture_ms": 1e3 * median(first), "refined_ms": 1e3 * median(last)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mesh", default="stanford_bunny")
    parser.add_argument("--environment", default="modern_buildings_2")
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--screenshot", type=Path, help="also save the page as it is at the end")
    options = parser.parse_args()
    scenes.require_data()
    from playwright.sync_api import sync_playwright

    mesh, sky = scenes.mesh_path(options.mesh), scenes.environment_path(options.environment)
    command = [sys.executable, "-m", "prtcl", "view", str(mesh), "--env", str(sky), str(sky.parent), "--port", "0",
               "-o", tempfile.mkdtemp(), "--brdf", "ggx:alpha=0.3,f0=0.04,kd=0.4/0.2/0.1"]  # fmt: skip
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    line = process.stdout.readline()
    path = os.environ.get("PRTCL_CHROMIUM") or shutil.which("chromium")
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(
                executable_path=path, args=["--no-sandbox", "--enable-unsafe-swiftshader"]
            )
            tab = Tab(browser, line.split()[0])
            rows = {"orbit": tab.during(tab.orbit)}
            tab.focus("Roughness")
            rows["roughness"] = tab.during(tab.slide)
            tab.focus("Specular")
            rows["specular"] = tab.during(tab.slide)
            rows["one step"] = tab.delays()
            status = tab.page.inner_text("body").split("Material")[0].strip().splitlines()
            if options.screenshot is not None:
                tab.rest()
                tab.page.screenshot(path=options.screenshot)
            browser.close()
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(30)
    for name, row in rows.items():
        print(name, {k: round(v, 1) for k, v in row.items()})
    print(status)
    scenes.save(
        options.output, device=line.partition("(")[2].partition(",")[0], command="python bench/browser.py",
        mesh=options.mesh, environment=options.environment, page=[1280, 800], rows=rows, status=status,
    )  # fmt: skip


if __name__ == "__main__":
    main()
