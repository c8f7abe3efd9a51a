"""One browser's page: its panel, its camera and its pictures, on viser. Nothing here is shared between pages.

Every value that comes from a page is put into its range before use, and names are looked up in the lists of the
command line; so a page that was tampered with gets other pictures and nothing else.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from prtcl.apps.view.look import ALPHA, KINDS, PRESETS, History, Look
from prtcl.apps.view.loop import WAITING, Loop
from prtcl.apps.view.saving import save_image, save_material
from prtcl.apps.view.state import STOPS, Eye, State, develop, linear_colour, picked_colour
from prtcl.apps.view.studio import FINE, Drawn, Quality
from prtcl.apps.view.table_panel import TablePanel
from prtcl.errors import PrtclError

CUSTOM = "custom"
FINER_JPEG, MOVING_JPEG = 92, 80


class Page:
    """The panel and the pictures of one client.

    Parameters
    ----------
    client : viser's handle
    looks : the materials it starts with, one for each of `parts`
    environments : names, the first is shown first
    folder : where it saves
    coloured : whether the mesh has colours of its own
    """

    def __init__(
        self, client: Any, loop: Loop, looks: tuple[Look, ...], parts: tuple[str, ...],
        environments: tuple[str, ...], rotate: float, folder: Path, coloured: bool,
    ) -> None:  # fmt: skip
        self.client, self.loop, self.parts, self.folder = client, loop, parts, folder
        self.history, self._environments = History(), environments
        state = State(eye_of(client.camera), looks, environments[0], rotate % 360.0)
        self._build(state, coloured)
        self.seat = loop.join(state, self._deliver, self._tell)
        client.camera.on_update(self._moved)

    # --- the panel ------------------------------------------------------------------------------------------

    def _build(self, state: State, coloured: bool) -> None:
        gui, look = self.client.gui, state.looks[0]
        self.notice = gui.add_markdown("Starting …")
        self.status = gui.add_markdown("")
        with gui.add_folder("Material"):
            self.part = gui.add_dropdown("Part", self.parts, visible=len(self.parts) > 1)
            self.preset = gui.add_dropdown("Preset", (CUSTOM, *PRESETS))
            kinds = KINDS if any(one.given for one in state.looks) else KINDS[:-1]
            self.kind = gui.add_dropdown(
                "Kind",
                kinds,
                initial_value=look.kind,
                hint="table: whatever it is now, to edit by its angles",
            )
            self.colour = gui.add_rgb("Colour", picked_colour(look.colour))
            self.painted = gui.add_checkbox(
                "Mesh's colours",
                look.painted,
                visible=coloured,
                hint="vertex colours and textures times this colour",
            )
            low, high = (math.sqrt(value) for value in ALPHA)
            self.roughness = gui.add_slider(
                "Roughness",
                round(low, 2),
                high,
                0.005,
                math.sqrt(look.alpha),
                hint="α = roughness², as in glTF and Blender",
            )
            self.specular = gui.add_slider(
                "Specular", 0.0, 1.0, 0.005, look.specular, hint="f0 of a dielectric, ks of blinn"
            )
            self.step = gui.add_button_group("History", ("Undo", "Redo"))
        self.table = TablePanel(gui)
        with gui.add_folder("Light"):
            self.environment = gui.add_dropdown("Environment", self._environments)
            self.rotate = gui.add_slider(
                "Rotation", 0.0, 360.0, 1.0, state.rotate, hint="degrees about the up axis"
            )
            self.exposure = gui.add_slider(
                "Exposure", -STOPS, STOPS, 0.05, 0.0, hint="stops; 0 suits the environment"
            )
        with gui.add_folder("Keep"):
            self.save = gui.add_button_group("Save", ("Image", "Material"))
            self.download = gui.add_checkbox("Download as well", False)
        self._show(look)
        looks = self.kind, self.colour, self.painted, self.roughness, self.specular
        for control, handler in (
            (self.part, self._chosen_part), (self.preset, self._chosen_preset), (self.environment, self._lit),
            (self.rotate, self._lit), (self.exposure, self._lit),
            *((control, self._dressed(control)) for control in looks),
        ):  # fmt: skip
            control.on_update(_from_page(handler))
        for control in self.table.controls:
            control.on_update(_from_page(self._edited(control)))
        self.step.on_click(_from_page(self._stepped))
        self.save.on_click(_from_page(self._saved))

    @property
    def _part(self) -> int:
        return self.parts.index(self.part.value) if self.part.value in self.parts else 0

    def _show(self, look: Look, touched: Any = None) -> None:
        """Bring the controls to a look; those that do not matter to its kind are greyed out.

        The one that is being `touched` is left alone: what comes back to it late would make it jump under the hand.
        """
        preset = next((name for name, one in PRESETS.items() if one.spec == look.spec), CUSTOM)
        for control, value in (
            (self.kind, look.kind), (self.colour, picked_colour(look.colour)), (self.painted, look.painted),
            (self.roughness, math.sqrt(look.alpha)), (self.specular, look.specular), (self.preset, preset),
        ):  # fmt: skip
            if control is not touched and control.value != value:
                control.value = value
        given = look.kind in ("as given", "table")
        for control, off in (
            (self.colour, given), (self.painted, given), (self.roughness, given or look.kind == "lambert"),
            (self.specular, look.kind not in ("dielectric", "blinn")),
        ):  # fmt: skip
            if control.disabled != off:
                control.disabled = off
        self.table.show(look, touched)

    def _chosen_part(self) -> None:
        look = self.seat.state.looks[self._part]
        self._show(look)
        self.table.draw(look)

    def _chosen_preset(self) -> None:
        if self.preset.value in PRESETS:
            before = self.seat.state.looks[self._part]
            preset = replace(PRESETS[self.preset.value], given=before.given, recipe=before.recipe)
            self._dress(preset, self.preset)

    def _dressed(self, control: Any) -> Callable[[], None]:
        def changed() -> None:
            before = self.seat.state.looks[self._part]
            # Only what was touched: a colour from the picker has eight bits, and need not be what was set.
            if control is self.kind:
                named = str(control.value)
                look = before.tabulated() if named == "table" else replace(before, kind=named)
            elif control is self.colour:
                look = replace(before, colour=linear_colour(control.value))
            elif control is self.painted:
                look = replace(before, painted=bool(control.value))
            elif control is self.roughness:
                look = replace(before, alpha=_square(control.value))
            else:
                look = replace(before, specular=float(control.value))
            self._dress(look.cleaned(), control)

        return changed

    def _edited(self, control: Any) -> Callable[[], None]:
        def changed() -> None:
            before = self.seat.state.looks[self._part]
            if before.kind == "table" and before.recipe is not None:
                try:
                    recipe = self.table.changed(before.recipe, control)
                except PrtclError:
                    return  # no number: not from this page's sliders
                self._dress(replace(before, recipe=recipe), control)

        return changed

    def _dress(self, look: Look, control: Any) -> None:
        part, before = self._part, self.seat.state.looks
        looks = (*before[:part], look, *before[part + 1 :])
        if looks != before:
            self.history.record(before, (part, control), time.monotonic())
            self.loop.update(self.seat, lambda state: replace(state, looks=looks))
        self._show(look, control)

    def _stepped(self) -> None:
        step = self.history.redo if self.step.value == "Redo" else self.history.undo
        looks = step(self.seat.state.looks)
        self.loop.update(self.seat, lambda state: replace(state, looks=looks))
        self._show(looks[self._part])

    def _lit(self) -> None:
        name, rotate, exposure = self.environment.value, self.rotate.value, self.exposure.value
        if name in self._environments and math.isfinite(rotate) and math.isfinite(exposure):
            exposure = min(STOPS, max(-STOPS, exposure))
            self.loop.update(
                self.seat,
                lambda s: replace(s, environment=name, rotate=rotate % 360.0, exposure=exposure),
            )

    async def _moved(self, camera: Any) -> None:
        eye = eye_of(camera)
        self.loop.update(self.seat, lambda state: replace(state, eye=eye))

    # --- saving ---------------------------------------------------------------------------------------------

    def _saved(self) -> None:
        if self.save.value == "Material":
            self._keep(lambda: save_material(self.folder, self.seat.state, self.parts))
        elif not self.loop.save(self.seat, self._save_image):
            self.client.add_notification(
                "Not saved",
                f"{WAITING} pictures are waiting already; press again once they are there",
                color="red",
            )

    def _save_image(self, state: State, drawn: Drawn) -> None:
        self._keep(lambda: save_image(self.folder, drawn.render, drawn.exposure + state.exposure))

    def _keep(self, save: Callable[[], list[Path]]) -> None:
        try:
            paths = save()
        except PrtclError as error:
            self.client.add_notification("Not saved", str(error), color="red")
            return
        names = ", ".join(path.name for path in paths)
        self.client.add_notification("Saved", f"{names} in {self.folder}", auto_close_seconds=8.0)
        if self.download.value:
            for path in paths:
                self.client.send_file_download(path.name, path.read_bytes())

    # --- pictures, on the loop's thread ---------------------------------------------------------------------

    def _deliver(self, state: State, quality: Quality, drawn: Drawn) -> None:
        start = time.perf_counter()
        picture = develop(drawn.render.image, drawn.exposure + state.exposure)
        jpeg = FINER_JPEG if quality is FINE else MOVING_JPEG
        self.client.scene.set_background_image(picture, format="jpeg", jpeg_quality=jpeg)
        self.status.content = described(quality, drawn, time.perf_counter() - start)
        self.table.draw(state.looks[self._part])
        self.client.flush()

    def _tell(self, text: str) -> None:
        self.notice.content = f"**{text}**" if text else ""


def described(quality: Quality, drawn: Drawn, developed: float) -> str:
    """Frame time and its stages, and the error to expect, for people."""
    report = drawn.render.report
    height, width = drawn.render.image.shape[:2]
    spent = {**report["seconds"], "develop": developed}
    stages = " · ".join(f"{name.replace('_', ' ')} {1000 * s:.0f}" for name, s in spent.items() if s >= 5e-4)
    error = (
        "not estimated: preview while the light is collected"
        if drawn.draft
        else f"{100 * report['expected_error']:.1f} % expected from the cuts"
    )
    return (
        f"**{1000 * (drawn.seconds + developed):.0f} ms** {quality.name}, {width} × {height}, "
        f"{report['points'].get('shade', 0):,} points\n\nError {error}\n\n{stages} ms"
        + "".join(f"\n\n{note}" for note in drawn.notes)
    )


def eye_of(camera: Any) -> Eye:
    """A page's camera, as viser has it."""
    # The camera's own upper edge, not the axis it orbits: looking down along that axis is a view like any other.
    position, target, up = (
        tuple(float(x) for x in vector)
        for vector in (camera.position, camera.look_at, upper_edge(camera.wxyz))
    )
    canvas = int(camera.image_width), int(camera.image_height)
    return Eye(position, target, up, float(camera.fov), canvas)  # type: ignore[arg-type]


def upper_edge(wxyz: Any) -> tuple[float, float, float]:
    """World direction of a picture's upper edge: (0, −1, 0), as viser's cameras have y down, turned by a quaternion."""
    w, x, y, z = (float(v) for v in wxyz)
    return -2 * (x * y - w * z), -(1 - 2 * (x * x + z * z)), -2 * (y * z + w * x)


def _from_page(handler: Callable[[], None]) -> Callable[[Any], Any]:
    """What viser calls: on its event loop, so that changes stay in order; not for values this program sets."""

    async def changed(event: Any) -> None:
        if event.client_id is not None:
            handler()

    return changed


def _square(roughness: float) -> float:
    """α of a roughness; what is no number stays one, for `Look.cleaned` to mend."""
    return float(roughness) ** 2 if abs(roughness) < 1e3 else math.nan
