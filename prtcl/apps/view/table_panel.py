"""The page's folder for tables: a picture of the table, and a control for each number of its recipe."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from prtcl.apps.view.look import PRESETS, Look
from prtcl.apps.view.recipe import ANGLES, RANGES, Recipe
from prtcl.apps.view.state import linear_colour, picked_colour
from prtcl.apps.view.table_picture import picture
from prtcl.errors import PrtclError

NOTHING = "nothing"


class TablePanel:
    """Made inside the page's panel; shown while the part's look is a table.

    Parameters
    ----------
    gui : viser's
    """

    def __init__(self, gui: Any) -> None:
        blank = Recipe(Look().material)
        self.folder = gui.add_folder("Table", visible=False)
        self._drawn: Recipe | None = None
        with self.folder:
            self.image = gui.add_image(_blank_picture(blank), format="png")
            self.warning = gui.add_markdown("")
            sliders = (
                ("sharpen", "Sharpness", "of the highlight, in powers of two; the energy is kept"),
                (
                    "balance",
                    "Highlight share",
                    "moves energy from the base to the highlight, or (below 0) back",
                ),
                (
                    "fresnel",
                    "Edge rise",
                    "how much brighter the highlight gets at grazing angles; 1 as it is",
                ),
                ("strength", "Brightness", "all of it, times this"),
            )
            self._sliders = {
                name: gui.add_slider(label, *RANGES[name], 0.01, getattr(blank, name), hint=hint)
                for name, label, hint in sliders
            }
            self.tint = gui.add_rgb("Tint", picked_colour(blank.tint))
            self.other = gui.add_dropdown("Mix with", (NOTHING, *PRESETS))
            self._sliders["blend"] = gui.add_slider(
                "Mix", *RANGES["blend"], 0.01, 0.0, hint="share of the other"
            )
            self._sliders["paint"] = gui.add_slider(
                "Paint",
                *RANGES["paint"],
                0.05,
                0.0,
                hint="stops, inside the frame of the picture; the edge is soft",
            )
            self._ends = {
                "theta_h": gui.add_multi_slider("Half angles", *ANGLES, 0.25, blank.theta_h),
                "theta_d": gui.add_multi_slider("Difference", *ANGLES, 0.25, blank.theta_d),
            }
            self.conserve = gui.add_checkbox(
                "Conserve", False, hint="darken what would reflect more than it receives"
            )

    @property
    def controls(self) -> tuple[Any, ...]:
        """What a change of must be told."""
        return (*self._sliders.values(), *self._ends.values(), self.tint, self.other, self.conserve)

    def changed(self, recipe: Recipe, control: Any) -> Recipe:
        """A recipe after a control was touched, as it stands now.

        Raises
        ------
        InputError
            If its value is no number.
        """
        for name, one in (*self._sliders.items(), *self._ends.items()):
            if control is one:
                value: dict[str, Any] = {name: tuple(one.value) if name in self._ends else one.value}
                return replace(recipe, **value).cleaned()
        if control is self.tint:
            return replace(recipe, tint=linear_colour(self.tint.value)).cleaned()
        if control is self.other:
            preset = PRESETS.get(self.other.value)
            # Half of it, so that something is to be seen.
            share = recipe.blend or 0.5
            mixed = replace(recipe, other=None if preset is None else preset.material, blend=share)
            return mixed if preset is not None else replace(mixed, blend=0.0)
        return replace(recipe, conserve=bool(self.conserve.value))

    def show(self, look: Look, touched: Any = None) -> None:
        """Bring the controls to a look; the one that is being `touched` is left alone."""
        recipe = look.recipe if look.kind == "table" else None
        self.folder.visible = recipe is not None
        if recipe is None:
            return
        names = [name for name, preset in PRESETS.items() if preset.material is recipe.other]
        for control, value in (
            *((one, getattr(recipe, name)) for name, one in (*self._sliders.items(), *self._ends.items())),
            (self.tint, picked_colour(recipe.tint)), (self.other, (names or [NOTHING])[0]),
            (self.conserve, recipe.conserve),
        ):  # fmt: skip
            if control is not touched and control.value != value:
                control.value = value
        off = recipe.other is None
        if self._sliders["blend"].disabled != off:
            self._sliders["blend"].disabled = off

    def draw(self, look: Look) -> None:
        """Picture and warning of a look's table, if it is one and another than was drawn last."""
        recipe = look.recipe if look.kind == "table" else None
        if recipe is None or recipe == self._drawn:
            return
        try:
            table = recipe.table
        except PrtclError:
            return  # the loop tells
        self._drawn = recipe
        self.image.image = picture(table.bivariate, (recipe.theta_h, recipe.theta_d))
        self.warning.content = energy_line(table.energy)


def energy_line(energy: float) -> str:
    """What a table reflects at most, for people; a warning above 1."""
    share = f"reflects {100 * energy:.0f} % of the light at most"
    if energy <= 1.0 + 1e-9:
        return share.capitalize()
    return f"**Too bright: {share}.** No real surface does; turn on *Conserve*, or lower *Brightness*."


def _blank_picture(recipe: Recipe) -> Any:
    return picture(recipe.table.bivariate)
